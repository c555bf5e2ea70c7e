"""What a command line gives: models and recordings in any order, and values of parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from daest.cli import offered
from daest.cli.options import Command, assignments, gathered, listed_names, priors, set_option
from daest.data import FORMATS
from daest.errors import ConfigError
from daest.files import MODEL_SUFFIXES
from daest.model.parts import Prior

if TYPE_CHECKING:
    from daest.model.fit import IdentifyOptions
    from daest.model.flat import Model

Kind = Literal["model", "data"]


@dataclass(frozen=True)
class Files:
    """The models and the recordings of a command line."""

    models: tuple[Path, ...] = ()
    data: tuple[Path, ...] = ()

    @property
    def model(self) -> Path | None:
        """The only model, None where none is given. Raises ConfigError `files-too-many`."""
        return _only(self.models, "model")

    @property
    def recording(self) -> Path | None:
        """The only recording, None where none is given. Raises ConfigError `files-too-many`."""
        return _only(self.data, "recording")

    @property
    def all(self) -> tuple[Path, ...]:
        return (*self.models, *self.data)


def _only(paths: tuple[Path, ...], what: str) -> Path | None:
    distinct = tuple(dict.fromkeys(paths))
    if len(distinct) > 1:
        raise ConfigError(
            "files-too-many",
            f"this command takes one {what}, and {', '.join(map(str, distinct))} are given",
            remedy=f"name one {what}",
        )
    return distinct[0] if distinct else None


def kind_of(path: Path, otherwise: Kind) -> Kind:
    """Whether a file is a model or a recording, by its suffix."""
    suffix = path.suffix.lower()
    if suffix in MODEL_SUFFIXES:
        return "model"
    return "data" if suffix in FORMATS else otherwise


def files(
    shown: str, otherwise: Kind = "data", recordings: str | None = "--data"
) -> Callable[[Command], Command]:
    """The files of a command as one argument `files`: any order, or by --model and `recordings`.

    `shown` is how the usage names the arguments, and a file of an unknown kind is taken for `otherwise`. A
    command without `recordings` takes models alone.
    """

    def kind(named: Iterable[Path], model: Iterable[Path], data: Iterable[Path] = ()) -> Files:
        kinds = [(path, "model" if recordings is None else kind_of(path, otherwise)) for path in named]
        return Files(
            (*(path for path, kind in kinds if kind == "model"), *model),
            (*(path for path, kind in kinds if kind == "data"), *data),
        )

    path = click.Path(path_type=Path)
    options = [
        click.argument("named", metavar=shown, nargs=-1, type=path),
        click.option(
            "--model",
            metavar="FILE",
            multiple=True,
            type=path,
            help="Model: a .mo, .bmo or .fmu file, with or without this word (default: daest.toml).",
        ),
    ]
    if recordings is not None:
        names = dict.fromkeys((recordings, "--data"))
        options.append(
            click.option(
                *names,
                "data",
                metavar="FILE",
                multiple=True,
                type=path,
                help="Recording, with or without this word (default: daest.toml).",
            )
        )
    return gathered("files", kind, *options)


@dataclass(frozen=True)
class ParameterOptions:
    """What a command line says of parameters. Raises ConfigError `option-contradiction` where a parameter is
    to be held and to be estimated."""

    settings: Mapping[str, float]
    fix: Mapping[str, float]
    estimate: tuple[str, ...] = ()
    prior: Mapping[str, Prior] | None = None

    def __post_init__(self) -> None:
        for name in self.fix:
            other = "--estimate" if name in self.estimate else "--set" if name in self.settings else None
            if other is not None:
                raise ConfigError(
                    "option-contradiction",
                    f"{name} is named by --fix and by {other}",
                    remedy="--fix holds a parameter, --set gives a start value where it is estimated",
                )

    @property
    def held(self) -> dict[str, float]:
        """Values that --set and --fix give."""
        return {**self.settings, **self.fix}

    def among(self, options: IdentifyOptions) -> IdentifyOptions:
        """The options of an identification with these values and this choice."""
        return replace(
            options,
            estimate=self.estimate or None,
            start=dict(self.settings),
            fix=dict(self.fix),
            prior=dict(self.prior or {}),
        )

    def applied(self, flat: Model) -> Model:
        """The model with these values, and with these parameters alone to be estimated. Raises ModelError
        for a name that is no tunable parameter, and EstimationError `prior-unused`."""
        from daest.modelica.change import with_choice, with_values

        if self.held:
            flat = with_values(flat, self.held)
        return with_choice(flat, self.estimate or None, tuple(self.fix), self.prior or {})


parameter_options = gathered(
    "parameters",
    ParameterOptions,
    set_option,
    click.option(
        "--fix",
        metavar="NAME=VALUE",
        shell_complete=offered.assigned_parameters,
        multiple=True,
        callback=lambda _ctx, _param, given: assignments(given, "--fix"),
        help="Hold a parameter at a value.",
    ),
    click.option(
        "--estimate",
        metavar="NAME",
        shell_complete=offered.parameters,
        multiple=True,
        callback=lambda _ctx, _param, given: listed_names(given),
        help="Estimate this parameter (several: repeat, or with commas; default: those that the model or "
        "daest.toml marks).",
    ),
    click.option(
        "--prior",
        metavar="NAME=MEAN,STD",
        shell_complete=offered.assigned_parameters,
        multiple=True,
        callback=lambda _ctx, _param, given: priors(given),
        help="What is known of a parameter beforehand (lognormal where it is searched on a log scale).",
    ),
)
