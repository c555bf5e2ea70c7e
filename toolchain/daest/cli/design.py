"""`daest design`: the next experiment, as an input to play."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from daest.cli.given import Files, files
from daest.cli.options import (
    DataOptions,
    ModelOptions,
    assignments,
    data_options,
    draw,
    example,
    gathered,
    listed_names,
    model_options,
    result_options,
    seed_option,
    set_option,
)
from daest.cli.output import emit, keep_inputs, note, whole_file, write_text
from daest.cli.progress import progress
from daest.errors import ConfigError

if TYPE_CHECKING:
    import numpy as np

    from daest.data.project import Project
    from daest.design.design import Task
    from daest.design.effects import Loop
    from daest.model.design import Criterion, Design, Limits
    from daest.model.experiment import Experiment
    from daest.model.flat import Model
    from daest.model.holds import Hold

RESULT = "design.json"
NOT_THERE = "data-unknown-column"  # of recordings that do not hold the reference
STEPS_OF_PERIOD = 4  # digits of a period that is read off a recording


@dataclass(frozen=True)
class Wish:
    """What the command line asks for."""

    rivals: bool = False
    parameters: tuple[str, ...] = ()
    detect: str | None = None
    place: str | None = None
    size: float | None = None
    criterion: Criterion = "D"
    length: float | None = None
    step: float | None = None
    limits: tuple[str, ...] = ()
    rates: tuple[str, ...] = ()
    band: str | None = None
    sensors: tuple[str, ...] = ()
    seconds: float = 20.0
    alone: bool = False
    controller: Path | None = None


wish_options = gathered(
    "wish",
    Wish,
    click.option("--rivals", is_flag=True, help='Tell apart what "cannot tell" of daest diagnose left.'),
    click.option(
        "--parameters",
        metavar="NAME",
        multiple=True,
        help="Know these parameters better (several: repeat, or with commas).",
    ),
    click.option("--detect", metavar="EFFECT", help="See this effect of the library."),
    click.option("--at", "place", metavar="PLACE", help="Where the effect of --detect sits."),
    click.option("--size", type=float, metavar="SIZE", help="Size of the effect of --detect."),
    click.option(
        "--criterion",
        type=click.Choice(["D", "A", "worst"]),
        default="D",
        help="Volume, mean square or worst direction of the errors of --parameters (default: D).",
    ),
    click.option("--length", type=float, metavar="SECONDS", help="Length (default: that of the recording)."),
    click.option(
        "--period", "step", type=float, metavar="SECONDS", help="Period at which the input is played."
    ),
    click.option(
        "--limit",
        "limits",
        metavar="NAME=LOW,HIGH",
        multiple=True,
        help="Range of an input (default: the recorded one), or safe range of any variable.",
    ),
    click.option(
        "--rate", "rates", metavar="NAME=RATE", multiple=True, help="Fastest change of an input [1/s]."
    ),
    click.option("--band", metavar="LOW,HIGH", help="Frequencies of the inputs [Hz]."),
    click.option(
        "--sensor",
        "sensors",
        metavar="NAME=STD",
        multiple=True,
        help="A sensor that could be added, and its noise.",
    ),
    click.option(
        "--controller",
        type=click.Path(path_type=Path),
        metavar="FILE",
        help="Modelica model of the controller that stays in the loop: its reference is designed.",
    ),
    click.option(
        "--alone", is_flag=True, help="Design --parameters as if there were no recording to add to."
    ),
    click.option(
        "--seconds", type=float, default=20.0, metavar="SECONDS", help="Time for the search (default: 20)."
    ),
)


@click.command("design", epilog=example("daest design --parameters d,c --limit u=-5,5 -o input.csv"))
@files("[MODEL] [DATA]...")
@set_option
@wish_options
@model_options
@data_options
@result_options
@seed_option
def command(
    files: Files,
    settings: Mapping[str, float],
    wish: Wish,
    model_options: ModelOptions,
    data_options: DataOptions,
    form: str,
    output: Path | None,
    plot: Path | None,
    seed: int,
) -> None:
    """The input that the next recording should have, as a CSV file (-o) to be played.

    DATA are recordings that there are (default: those of daest.toml): they give the ranges of the inputs, the
    period and the length where no option does, and what is known already. Parameters and noise are those of
    results/fit.json. Without --rivals, --parameters or --detect the aim is what results/diagnosis.json leaves
    open, else all parameters.

    A machine that runs away when left alone is designed for in the loop of --controller: what is played is
    its reference.
    """
    from daest.design.design import design
    from daest.report.arrays import csv_text
    from daest.report.documents import design as documents
    from daest.report.result_figures import design_figure
    from daest.report.texts import design as texts

    project = model_options.project()
    keep_inputs(output, files.all)
    with progress() as show:
        task = _task(project, files, settings, wish, model_options, data_options, seed)
        found = design(task, show)
    file = None if output is None or str(output) == "-" else str(output)
    document = {**documents.document(found, file), "model": task.subjects[0].flat.name}
    if output is not None:
        write_text(csv_text(*documents.table(found)), output)
    if str(output) != "-":
        emit(document, "design", form, None, texts.text)
    _keep(project, document, found)
    draw(plot, lambda: design_figure(found))


def _keep(project: Project, document: Mapping[str, Any], found: Design) -> None:
    """Leave the design among the results, and its input beside it, where `daest report` looks."""
    import numpy as np

    from daest.cli.results import write_document

    series = (project.results / RESULT).with_suffix(".npz")
    with whole_file(series) as temporary, temporary.open("wb") as stream:
        np.savez_compressed(stream, time=found.limits.time, inputs=found.inputs)
    write_document(document, "design", project.results / RESULT)


def _task(
    project: Project,
    files: Files,
    settings: Mapping[str, float],
    wish: Wish,
    model_options: ModelOptions,
    data_options: DataOptions,
    seed: int,
) -> Task:
    from daest.cli.models import model_source, with_settings
    from daest.cli.results import find_fit, fitted
    from daest.design.design import Task
    from daest.model.holds import causal_hold

    source = model_source(project, files.model)
    loaded = model_options.load(project, source, settings)
    fit = find_fit(project, source, loaded)
    flat = loaded
    if fit is not None:
        note(f"parameters and noise of {fit.path}")
        flat = with_settings(fitted(flat, fit.document), settings)
    loop = _loop(wish, model_options, project)
    measured, driven, recordings, played = _recordings(flat, loop, project, files.data, data_options)
    # Nothing plays a curve: what is designed runs straight between its values.
    hold = causal_hold(data_options.chosen_hold(project, driven, recordings, fit.document if fit else None))
    limits = _limits(driven, recordings, wish, hold)
    recorded = _recorded_inputs(driven, played, limits)
    folders = model_options.folders(project)
    aim, subjects = _aim(project, measured, loop, limits, recorded, wish, folders, seed)
    sensors = assignments(wish.sensors, "--sensor")
    commanded = tuple(v.name for v in measured.inputs if v not in driven.inputs)
    return Task(aim, subjects, limits, recorded, sensors, seed, wish.seconds, commanded)


def _loop(wish: Wish, options: ModelOptions, project: Project) -> Loop:
    """Puts a model into the loop of --controller; without one the model stays as it is."""
    if wish.controller is None:
        return lambda flat: flat
    from daest.cli.models import model_source
    from daest.model.flat import with_equations
    from daest.modelica.closed_loop import closed_loop
    from daest.modelica.compile import compile_model

    controller = compile_model(model_source(project, wish.controller), None, options.folders(project))
    return lambda flat: closed_loop(with_equations(flat, "the loop of a controller"), controller)


def _recordings(
    flat: Model, loop: Loop, project: Project, data: Sequence[Path], options: DataOptions
) -> tuple[Model, Model, list[Experiment], list[Experiment]]:
    """The model with the outputs that are measured, the same in the loop of its controller, the recordings,
    and those of them that hold what is played; without recordings all outputs count as measured."""
    from daest.cli.recordings import training_data
    from daest.errors import DataError
    from daest.modelica.change import with_outputs

    driven = loop(flat)
    if not data and not project.estimate:
        return flat, driven, [], []
    try:
        kept, estimation, validation = training_data(driven, project, data, options, others=False)
        recordings = played = [*estimation, *validation]
    except DataError as problem:
        if driven is flat or problem.code != NOT_THERE:
            raise
        note(f"{problem.what}: what the recording tells of the parameters is not counted")
        kept, estimation, validation = training_data(flat, project, data, options, others=False)
        recordings, played = [*estimation, *validation], []
    names = kept.output_names
    return with_outputs(flat, names), with_outputs(driven, names), recordings, played


def _limits(flat: Model, recordings: Sequence[Experiment], wish: Wish, hold: Hold) -> Limits:
    """Limits of the command line, and of the recordings where it gives none. Raises ConfigError
    `design-limits-unknown` or `option-assignment`."""
    from daest.model.design import Limits, Range
    from daest.modelica.flat.clock import model_clock

    given = dict(_range(text) for text in wish.limits)
    rates = assignments(wish.rates, "--rate")
    inputs = []
    for variable in flat.inputs:
        low, high, rate = _shown(variable.name, recordings)
        low, high = given.pop(variable.name, (low, high))
        inputs.append(Range(variable.name, variable.unit, low, high, rates.pop(variable.name, rate)))
    units = {v.name: v.unit for v in flat.unknowns} | {y.name: y.unit for y in flat.outputs}
    _require_known([*given, *rates], units, flat)
    played = set(flat.input_names)
    moved = dict.fromkeys(n for e in recordings for n in e.input_names if n not in played)  # by a controller
    given = {name: _shown(name, recordings)[:2] for name in moved} | given
    safe = tuple(Range(name, units[name], low, high) for name, (low, high) in given.items())
    longest = max((e.time[-1] - e.time[0] for e in recordings), default=None)
    length = wish.length if wish.length is not None else longest
    period = wish.step if wish.step is not None else _period(recordings)
    if length is None or period is None:
        raise ConfigError(
            "design-limits-unknown",
            "without a recording nothing tells how long and how finely the input may be played",
            remedy="give --length and --period in seconds, or a recording",
        )
    band = 0.0, float("inf")
    if wish.band is not None:
        band = _two_numbers(wish.band, f"--band {wish.band}", "--band 0,10")
    return Limits(tuple(inputs), float(length), float(period), safe, band, hold, model_clock(flat))


def _shown(name: str, recordings: Sequence[Experiment]) -> tuple[float, float, float]:
    """Lowest and highest value and fastest change of an input in the recordings; NaN where none holds it."""
    import numpy as np

    columns = [(e.time, e.input(name)) for e in recordings if name in e.input_names]
    if not columns:
        return float("nan"), float("nan"), float("inf")
    rates = [float(np.max(np.abs(np.diff(u) / np.diff(t)), initial=0.0)) for t, u in columns]
    low, high = (float(f([f(u) for _, u in columns])) for f in (min, max))
    return low, high, max(rates) or float("inf")


def _period(recordings: Sequence[Experiment]) -> float | None:
    steps = [e.median_step for e in recordings if e.n_samples > 1]
    return float(f"{min(steps):.{STEPS_OF_PERIOD}g}") if steps else None


def _require_known(names: Sequence[str], units: Mapping[str, str], flat: Model) -> None:
    from daest.near import nearest

    known = [*units, *flat.input_names]
    for name in names:
        if name not in units:
            raise ConfigError(
                "design-limit-unknown",
                f"--limit and --rate name '{name}', which is no variable of {flat.name}",
                remedy=nearest(name, known) or f"its inputs are {', '.join(flat.input_names)}",
            )


def _recorded_inputs(flat: Model, recordings: Sequence[Experiment], limits: Limits) -> tuple[np.ndarray, ...]:
    from daest.design.design import at_period

    names = flat.input_names
    return tuple(at_period(e, names, limits.period) for e in recordings)


def _aim(
    project: Project,
    flat: Model,
    loop: Loop,
    limits: Limits,
    recorded: tuple[np.ndarray, ...],
    wish: Wish,
    folders: Sequence[Path],
    seed: int,
) -> tuple[Any, tuple[Any, ...]]:
    from daest.cli.design_aims import effect_aim, parameter_aim, rivals_of, survivors

    if sum((wish.rivals, bool(wish.parameters), wish.detect is not None)) > 1:
        raise ConfigError(
            "design-one-aim",
            "--rivals, --parameters and --detect are different aims",
            remedy="give one of them",
        )
    if wish.detect is not None:
        return effect_aim(project, flat, limits, recorded, wish.detect, wish.place, wish.size, folders, loop)
    if wish.rivals or (not wish.parameters and survivors(project)):
        return rivals_of(project, flat, limits, recorded, folders, seed, loop)
    names = listed_names(wish.parameters)
    return parameter_aim(loop(flat), limits, () if wish.alone else recorded, names, wish.criterion)


def _range(text: str) -> tuple[str, tuple[float, float]]:
    name, _, values = text.partition("=")
    return name.strip(), _two_numbers(values, f"--limit {text}", "--limit u=-5,5")


def _two_numbers(values: str, what: str, remedy: str) -> tuple[float, float]:
    try:
        low, high = (float(value) for value in values.split(","))
    except ValueError:
        low = high = float("nan")
    if low != low or high != high:
        raise ConfigError("option-assignment", f"{what}: not two numbers", remedy=f"for example {remedy}")
    return low, high
