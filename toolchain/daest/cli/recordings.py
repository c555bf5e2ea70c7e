"""The recordings of a command: from the command line, else from daest.toml, matched with the model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from daest.cli.options import DataOptions
from daest.cli.output import note, warn
from daest.data.check import ANGLES, check_experiment
from daest.data.contradictions import model_findings
from daest.data.match import clock_findings
from daest.data.prepare import Preparation, prepare, split_all
from daest.data.project import Project
from daest.data.read import (
    Signal,
    measured_names,
    read_experiments,
    read_table,
    select_outputs,
    with_units,
)
from daest.data.repeated import repeated_findings
from daest.errors import ConfigError
from daest.model.experiment import Experiment
from daest.model.flat import Model
from daest.modelica.change import with_outputs
from daest.modelica.flat.clock import model_clock
from daest.modelica.flat.guesses import begun_as_recorded


def training_data(
    flat: Model, project: Project, paths: Sequence[Path], options: DataOptions, *, others: bool = True
) -> tuple[Model, list[Experiment], list[Experiment]]:
    """The model with its measured outputs alone, the recordings for estimation and those for validation; not
    `others`: without the columns that are no signal of the model.

    A split on the command line takes the place of [data] validate. Raises ConfigError `data-not-given`.
    """
    preparation = options.preparation(project)
    estimation_paths = list(paths) or list(project.estimate)
    require_recordings(estimation_paths)
    validation_paths = [] if preparation.split is not None else list(project.validate)
    experiments = _read(flat, project, [*estimation_paths, *validation_paths], preparation, others)
    flat, experiments = _measured(flat, experiments)
    for finding in model_findings(flat, experiments[0]):
        warn(finding.code, f"{experiments[0].name}: {finding.sentence}")
    n = len(estimation_paths)
    estimation, validation = split_all(experiments[:n], preparation)
    validation = validation + experiments[n:]
    for name, finding in repeated_findings(estimation, validation):
        warn(finding.code, f"{name}: {finding.sentence}")
    return flat, estimation, validation


def unseen_data(
    flat: Model,
    project: Project,
    paths: Sequence[Path],
    options: DataOptions,
    *,
    splits_windows: bool = True,
) -> tuple[Model, list[Experiment]]:
    """The model with its measured outputs alone, and the recordings that it is tried on: `paths`, else
    [data] validate, else the later part of the split, else [data] estimate. Not `splits_windows`: what
    --from and --to cut out is taken as a whole."""
    preparation = options.preparation(project)
    chosen = list(paths) or list(project.validate) or list(project.estimate)
    require_recordings(chosen)
    is_whole = options.has_window and not splits_windows
    validates = not paths and not project.validate and preparation.split is not None and not is_whole
    if not paths:
        part = "the validation part of " if validates else "the window of " if is_whole else ""
        note(f"using {part}{', '.join(str(path) for path in chosen)}")
    whole = preparation if validates else replace(preparation, split=None)
    flat, experiments = _measured(flat, _read(flat, project, chosen, whole))
    return flat, split_all(experiments, whole)[1] if validates else experiments


def driving_data(
    flat: Model, project: Project, paths: Sequence[Path], options: DataOptions
) -> list[Experiment]:
    """Recordings that drive a simulation: outputs may be missing."""
    preparation = replace(options.preparation(project), split=None)
    chosen = list(paths) or list(project.estimate)
    require_recordings(chosen)
    return read_experiments(
        chosen,
        *signals(flat, project),
        preparation,
        outputs_required=False,
        others=False,
        **words_of(project, flat),
    )


def require_recordings(paths: Sequence[Path]) -> None:
    """Raises ConfigError `data-not-given` where there are none."""
    if not paths:
        raise ConfigError(
            "data-not-given",
            "no recording is given",
            remedy='name a .csv file, or write [data] estimate = ["run.csv"] in daest.toml',
        )


def _read(
    flat: Model, project: Project, paths: Sequence[Path], preparation: Preparation, others: bool = True
) -> list[Experiment]:
    """The recordings, looked at as they are, then prepared; remarks and warnings go to stderr."""
    raw = replace(preparation, period=None, detrend="none")
    experiments = []
    words = words_of(project, flat)
    read = read_experiments(paths, *signals(flat, project), raw, others=others, **words)
    measured = measured_names(read)  # what no recording holds is told once, for all of them
    _tell_clock(words["clock"], project, paths)
    angles = {output.name: output.unit for output in flat.outputs if output.unit in ANGLES}
    for experiment in read:
        used = select_outputs(experiment, measured)
        for finding in check_experiment(used, words["clock"], angles).warnings:
            warn(finding.code, f"{experiment.name}: {finding.sentence}")
        prepared = prepare(experiment, preparation)
        for remark in prepared.notes:
            note(f"{experiment.name}: {remark}")
        experiments.append(prepared)
    return experiments


def _tell_clock(clock: str, project: Project, paths: Sequence[Path]) -> None:
    """Where the `clock` of the model is hours, and recordings tell the unit of their time: that they are read
    in hours. The columns are read again for that, of such models alone. What holds of several recordings is
    told once."""
    told: dict[tuple[str, str], list[str]] = {}
    for path in paths if clock != "s" else ():
        table = with_units(read_table(path), project.units)
        for finding in clock_findings(table, clock, project.time):
            told.setdefault((finding.code, finding.sentence), []).append(path.stem)
    for (_, sentence), names in told.items():
        note(f"{', '.join(names)}: {sentence}")


def measured_recordings(
    flat: Model, project: Project, paths: Sequence[Path], window: Preparation
) -> tuple[Model, list[Experiment]]:
    """The recordings as they are in the `window`, and the model with its measured outputs alone. Says
    nothing."""
    only = Preparation(start=window.start, stop=window.stop)
    experiments = read_experiments(paths, *signals(flat, project), only, **words_of(project, flat))
    names = measured_names(experiments)
    flat = begun_as_recorded(with_outputs(flat, names), experiments)
    return flat, [select_outputs(experiment, names) for experiment in experiments]


def words_of(project: Project, flat: Model) -> dict[str, Any]:
    """What daest.toml says about the columns of every file, and the unit of the time of the model."""
    return {"time": project.time, "units": project.units, "clock": model_clock(flat)}


def signals(flat: Model, project: Project) -> tuple[list[Signal], list[Signal]]:
    """The inputs and the outputs that are looked for in data."""
    inputs = [Signal(v.name, v.unit, project.inputs.get(v.name)) for v in flat.inputs]
    outputs = [Signal(y.name, y.unit, project.outputs.get(y.name)) for y in flat.outputs]
    return inputs, outputs


def _measured(flat: Model, experiments: list[Experiment]) -> tuple[Model, list[Experiment]]:
    names = measured_names(experiments)
    unseen = [output.name for output in flat.outputs if output.name not in names]
    if unseen:
        note(f"not in the data, and not used: {', '.join(unseen)}")
    flat = begun_as_recorded(with_outputs(flat, names), experiments)
    return flat, [select_outputs(experiment, names) for experiment in experiments]
