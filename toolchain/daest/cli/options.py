"""Options that several commands share, so that they are spelt and explained alike everywhere.

The option --plot writes the pictures of all commands.
"""

from __future__ import annotations

import functools
import math
import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar, cast

import click

from daest.cli import offered
from daest.cli.output import whole_file
from daest.errors import ConfigError
from daest.model.defaults import TIME_LIMIT
from daest.model.parts import Prior

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from daest.data.prepare import Preparation
    from daest.data.project import Project
    from daest.model.experiment import Experiment
    from daest.model.flat import Model
    from daest.model.holds import Hold

FORMATS = (".png", ".svg", ".pdf")

TOLD_HOLD = "[data] hold in daest.toml"


def checked(_ctx: click.Context, parameter: click.Parameter, given: Path | None) -> Path | None:
    """The file of a picture. Raises ConfigError `plot-format` before anything is computed."""
    if given is None or given.suffix.lower() in FORMATS:
        return given
    raise ConfigError(
        "plot-format",
        f"{parameter.opts[-1]} {given}: no picture is written as '{given.suffix or given.name}'",
        remedy=f"give a name that ends in {', '.join(FORMATS[:-1])} or {FORMATS[-1]}",
    )


def no_picture(_ctx: click.Context, parameter: click.Parameter, given: Path | None) -> Path | None:
    """The file of a result, which is text or JSON. Raises ConfigError `plot-format` for that of a picture."""
    if given is None or given.suffix.lower() not in FORMATS:
        return given
    raise ConfigError(
        "plot-format",
        f"{parameter.opts[0]} {given}: the result is written as text or JSON, not as a picture",
        remedy="where a command draws its result, --plot gives the file of the picture",
    )


def draw(plot: Path | None, make: Callable[[], Figure]) -> None:
    """Write the figure that `make` returns, in the format of the suffix, where a picture was asked for."""
    if plot is None:
        return
    from daest.report.figures import save

    figure = make()
    with whole_file(plot) as temporary:
        save(figure, temporary)


Command = TypeVar("Command", bound=Callable[..., Any])


def example(*lines: str) -> str:
    """Epilog of a command: `lines` below the word Example, each on a line of its own."""
    return "\b\nExample:\n" + "\n".join(f"  {line}" for line in lines)


def one_of(names: Callable[[], Iterable[str]]) -> Callable[..., list[str]]:
    """Completion of an argument that is one of `names()`."""
    return lambda _context, _parameter, begun: [name for name in names() if name.startswith(begun)]


def hold_form(_ctx: click.Context, parameter: click.Parameter, given: str | None) -> str | None:
    """A hold as `daest.model.holds` defines it; whether its names are inputs is seen with the model."""
    if given is None:
        return None  # a Tab need not wait for NumPy
    from daest.model.holds import is_hold

    if not is_hold(given):
        raise click.BadParameter(
            f"'{given}' is none of zoh, foh, smooth and zoh(NAME, ...).", param=parameter
        )
    return given


def _stacked(*decorators: Callable[[Any], Any]) -> Callable[[Command], Command]:
    def apply(function: Command) -> Command:
        for decorator in reversed(decorators):
            function = decorator(function)
        return function

    return apply


def gathered(
    name: str, kind: Callable[..., Any], *options: Callable[[Any], Any]
) -> Callable[[Command], Command]:
    """The options as one argument `name` of the command: `kind`, called with the value of each."""

    def apply(function: Command) -> Command:
        def call(*arguments: Any, **values: Any) -> Any:
            own = {key: values.pop(key) for key in names}
            return function(*arguments, **{name: kind(**own)}, **values)

        functools.update_wrapper(call, function)
        before = len(getattr(call, "__click_params__", []))
        applied: Any = _stacked(*options)(call)
        # click keeps the options of a command in this list until it builds the command.
        names = [option.name for option in applied.__click_params__[before:]]
        return cast(Command, applied)

    return apply


@dataclass(frozen=True)
class ModelOptions:
    """Where a command finds its model beside the name of the file: class, libraries and project file."""

    class_name: str | None = None
    libraries: tuple[Path, ...] = ()
    project_file: Path | None = None

    def project(self) -> Project:
        """The project file, or an empty project. Raises what `load_project` raises."""
        from daest.data.project import load_project

        return load_project(self.project_file)

    def folders(self, project: Project) -> tuple[Path, ...]:
        """The folders of libraries of the command line, then those of daest.toml."""
        return (*self.libraries, *project.libraries)

    def load(
        self, project: Project, given: Path | None, settings: Mapping[str, float] | None = None
    ) -> Model:
        """The model of the command line, else that of the project. See `load_model`."""
        from daest.cli.models import load_model

        return load_model(project, given, self.class_name, self.libraries, settings)


PLAIN = ModelOptions()  # of a command without these options


@dataclass(frozen=True)
class DataOptions:
    """The options on data of the command line. None: use the value in daest.toml."""

    start: float | None = None
    stop: float | None = None
    period: float | None = None
    detrend: Literal["none", "mean", "linear"] | None = None
    split: float | None = None
    hold: Hold | None = None

    @property
    def has_window(self) -> bool:
        return self.start is not None or self.stop is not None

    def preparation(self, project: Project) -> Preparation:
        """Options of the command line before those of daest.toml."""
        from daest.data.prepare import Preparation

        given = project.preparation
        return Preparation(
            start=given.start if self.start is None else self.start,
            stop=given.stop if self.stop is None else self.stop,
            period=given.period if self.period is None else self.period,
            detrend=given.detrend if self.detrend is None else self.detrend,
            split=given.split if self.split is None else self.split,
            hold=self.hold or project.hold,
        )

    def chosen_hold(
        self,
        project: Project,
        flat: Model,
        recordings: Sequence[Experiment],
        fit: Mapping[str, Any] | None = None,
    ) -> Hold:
        """The known hold, else that of the fit, else that of the last fit, or search for what is missing,
        of another model of the same machine, else straight lines: what inputs do between samples is none of
        the model. Raises as `known_hold`."""
        from daest.cli.results import last_hold
        from daest.model.holds import FOH, checked_hold

        names = flat.input_names
        kept = last_hold(project, names) if fit is None else fit.get("hold")
        return self.known_hold(project, flat, recordings) or checked_hold(kept, names, "the fit") or FOH

    def known_hold(self, project: Project, flat: Model, recordings: Sequence[Experiment]) -> Hold | None:
        """What the inputs do between the samples of `recordings` (`hold_after`); None if unknown. Raises as
        `told_hold`."""
        from daest.data.prepare import hold_after

        return hold_after(recordings, self.told_hold(project, flat))

    def told_hold(self, project: Project, flat: Model) -> Hold | None:
        """What the inputs did between the samples of the recordings as they are: the option, else what
        daest.toml says; None if unknown. Raises ConfigError `option-hold` where it names what is no input of
        `flat`."""
        from daest.model.holds import checked_hold

        hold, where = self.hold, "--hold"
        if hold is None:
            hold, where = project.hold, TOLD_HOLD
        return checked_hold(hold, flat.input_names, where)


_project_option = click.option(
    "-p",
    "--project",
    "project_file",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Project file (default: daest.toml here, if there is one).",
)
format_option = click.option(
    "--format",
    "form",
    type=click.Choice(["text", "json"]),
    default="text",
    help="Text for reading, or one JSON document (default: text).",
)
output_option = click.option(
    "-o",
    "--output",
    metavar="FILE",
    type=click.Path(path_type=Path, allow_dash=True),
    callback=no_picture,
    help="Write the result there; - is stdout.",
)
seed_option = click.option(
    "--seed",
    type=click.IntRange(min=0),
    metavar="N",
    default=0,
    help="Seed of all random numbers (default: 0).",
)
jobs_option = click.option(
    "--jobs",
    type=click.IntRange(min=1),
    metavar="N",
    envvar="DAEST_JOBS",
    callback=lambda _ctx, _param, given: given or os.cpu_count() or 1,
    help="Fits at a time on this machine (default: DAEST_JOBS, else one per core).",
)
cluster_option = click.option(
    "--cluster", metavar="ADDRESS", help="Fit on the Dask cluster at this address instead (tcp://HOST:8786)."
)
_class_options = (
    click.option("--class", "class_name", metavar="NAME", help="Class to use if the file holds several."),
    click.option(
        "-L",
        "--library",
        "libraries",
        metavar="DIR",
        multiple=True,
        type=click.Path(path_type=Path),
        help="Folder of Modelica libraries; those of MODELICAPATH are read, too.",
    ),
)
model_options = gathered("model_options", ModelOptions, *_class_options, _project_option)
set_option = click.option(
    "--set",
    "settings",
    metavar="NAME=VALUE",
    shell_complete=offered.assigned_parameters,
    multiple=True,
    callback=lambda _ctx, _param, given: assignments(given, "--set"),
    help="Value of a parameter; where it is estimated, the start.",
)
measure_option = click.option(
    "--measure",
    metavar="OUTPUT",
    shell_complete=offered.outputs,
    multiple=True,
    help="Use this output alone; daest filter compares the other measured ones with their estimates.",
)


def time_limit_option(what: str) -> Callable[[Command], Command]:
    """--time-limit, after which a command does `what`."""
    return click.option(
        "--time-limit",
        type=click.FloatRange(min=0.0, min_open=True),
        default=TIME_LIMIT,
        metavar="SECONDS",
        help=f"After this time {what}; the same command goes on from there (default: {TIME_LIMIT:.0f} s).",
    )


def kind_option(kinds: Iterable[str]) -> Callable[[Command], Command]:
    """--kind, one of the `kinds` of filters."""
    return click.option(
        "--kind",
        type=click.Choice(tuple(kinds)),
        help="Kind of filter (default: time-varying for a linear model, ekf for a nonlinear one).",
    )


plot_option = click.option(
    "--plot",
    metavar="FILE",
    type=click.Path(path_type=Path),
    callback=checked,
    help="Draw the result (.png, .svg or .pdf).",
)
result_options = _stacked(format_option, output_option, plot_option)
hold_option = click.option(
    "--hold",
    metavar="HOLD",
    callback=hold_form,
    help="Inputs between samples: held (zoh), on straight lines (foh), on smooth curves (smooth), or those "
    "named held and the others straight (zoh(NAME, ...)), in the recording: after --resample they run "
    "straight. Default: that of daest.toml or of the fit; identify, diagnose and improve take what fits "
    "best; otherwise foh.",
)
_window_options = (
    click.option("--from", "start", type=float, metavar="TIME", help="Use the recording from here on [s]."),
    click.option("--to", "stop", type=float, metavar="TIME", help="Use the recording up to here [s]."),
)
_data_options = (
    *_window_options,
    click.option(
        "--resample",
        "period",
        type=float,
        metavar="PERIOD",
        help="New sampling period [s], anti-alias filtered (default: that of the recording).",
    ),
    click.option(
        "--detrend",
        type=click.Choice(["none", "mean", "linear"]),
        help="Remove mean or trend of all signals (default: as daest.toml says, else none).",
    ),
    hold_option,
)
_split_option = click.option(
    "--split",
    type=float,
    metavar="SHARE",
    help="Share for estimation; the rest validates, e.g. 0.5 (default: as daest.toml says, else all of it).",
)
window_options = gathered("data_options", DataOptions, *_window_options)
data_options = gathered("data_options", DataOptions, *_data_options)
split_data_options = gathered("data_options", DataOptions, *_data_options, _split_option)


def require_cluster(address: str | None) -> None:
    """Reach the cluster, if one was given, before any long work. Raises ConfigError `cluster-unreachable`,
    `cluster-differs` or `cluster-without-dask`."""
    if address is None:
        return
    from daest.numerics.parallel import workers

    with workers(1, address):
        return


_COMMA = re.compile(r",(?![^\[]*\])")  # not that of an index: a[1,2] is one name


def listed_names(texts: Iterable[str]) -> tuple[str, ...]:
    """The names of an option that may be repeated, and may hold several with commas."""
    return tuple(name.strip() for text in texts for name in _COMMA.split(text) if name.strip())


def assignments(given: tuple[str, ...], option: str) -> dict[str, float]:
    """NAME=VALUE pairs of an option that may be repeated. Raises ConfigError `option-assignment`."""
    return dict(_assignment(text, option) for text in given)


def priors(given: tuple[str, ...]) -> dict[str, Prior]:
    """NAME=MEAN,STD of --prior, which may be repeated. Raises ConfigError `option-assignment`."""
    return dict(_prior(text) for text in given)


def _prior(text: str) -> tuple[str, Prior]:
    name, _, values = text.partition("=")
    try:
        mean, std = (float(value) for value in values.split(","))
    except ValueError:
        mean = std = math.nan
    if not name.strip() or not (math.isfinite(mean) and math.isfinite(std)):
        raise ConfigError(
            "option-assignment",
            f"--prior {text}: not of the form NAME=MEAN,STD",
            remedy="for example --prior spring.c=0.04,0.002",
        )
    return name.strip(), Prior(mean, std)


def _assignment(text: str, option: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not name.strip() or not math.isfinite(number):
        raise ConfigError(
            "option-assignment",
            f"{option} {text}: not of the form NAME=VALUE",
            remedy=f"for example {option} spring.c=0.04",
        )
    return name.strip(), number
