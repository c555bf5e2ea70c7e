"""`daest check`: what is wrong with recordings, before a model is fitted to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import click

from daest.cli.given import Files, files
from daest.cli.options import (
    DataOptions,
    ModelOptions,
    example,
    format_option,
    model_options,
    output_option,
    window_options,
)
from daest.cli.output import emit, keep_inputs, note
from daest.errors import DaestError

if TYPE_CHECKING:
    from daest.data.prepare import Preparation
    from daest.data.project import Project
    from daest.model.experiment import DataCheck, Experiment, Finding, Role
    from daest.model.flat import Model

    Compared: TypeAlias = tuple[DataCheck, Experiment | None]


@click.command("check", epilog=example("daest check run1.csv", "daest check Servo.mo run1.csv --from 10"))
@files("[MODEL] [DATA]...")
@window_options
@model_options
@format_option
@output_option
def command(
    files: Files,
    data_options: DataOptions,
    model_options: ModelOptions,
    form: str,
    output: Path | None,
) -> int:
    """Look for faults in the recordings DATA (default: those of daest.toml).

    Gaps and jumps of the clock, saturation, stuck sensors, outliers, drop-outs, coarse steps, lags between
    columns. With a model also units that do not fit, and outputs of the wrong polarity; with an FMU, how
    it is confined on this machine. Exit code 1 if there is a warning.
    """
    from daest.cli.recordings import require_recordings
    from daest.report.documents import check as documents
    from daest.report.texts import check as texts

    project = model_options.project()
    paths = list(files.data) or [*project.estimate, *project.validate]
    require_recordings(paths)
    keep_inputs(output, paths)
    model = files.model
    is_given = model is not None or project.source is not None
    flat = model_options.load(project, model) if is_given else None
    if flat is not None and flat.has_equations:
        _require_determined(flat)
    elif flat is not None:
        _tell_walls()
    window = data_options.preparation(project)
    n_seen = len(paths) if files.data else len(project.estimate)
    pairs: list[Compared] = []
    for path in paths:
        check, recording = _compared(path, project, flat, window)
        pairs.append((check, recording if n_seen < len(paths) else None))  # else nobody asks for it again
    checks = [*(check for check, _ in pairs[:n_seen]), *_with_repeated(pairs[:n_seen], pairs[n_seen:])]
    emit(documents.document(checks), "check", form, output, texts.text)
    return int(any(check.warnings for check in checks))


def _with_repeated(seen: Sequence[Compared], unseen: Sequence[Compared]) -> list[DataCheck]:
    """The checks of the recordings that validate, with the samples that they share with those that are
    `seen`."""
    from daest.data.repeated import repeated_findings

    estimating, validating = ([one for _, one in pairs if one is not None] for pairs in (seen, unseen))
    repeated = repeated_findings(estimating, validating)
    return [
        replace(check, findings=(*check.findings, *(f for name, f in repeated if name == check.name)))
        for check, _ in unseen
    ]


def _require_determined(flat: Model) -> None:
    """Refuse a model with which no recording can be used. Raises ModelError `structurally-singular`."""
    from daest.model.flat import FlatModel
    from daest.systems.reduction.expand import expand, find_aliases

    if isinstance(flat, FlatModel):
        expand(flat, find_aliases(flat))


def _tell_walls() -> None:
    """How the FMU of the model is confined on this machine."""
    from daest.fmu.sandbox import VARIABLE, Walls, chosen_mode, tried_walls

    is_off = chosen_mode() == "off"
    walls = Walls() if is_off else tried_walls()
    note(walls.sentence() + (f" ({VARIABLE} is off)" if is_off else ""))


def checked(path: Path, project: Project, flat: Model | None, window: Preparation | None = None) -> DataCheck:
    """The check of one file, or of its part in the `window`, against the model if there is one. Raises
    DataError where it cannot be read."""
    return _compared(path, project, flat, window)[0]


def _compared(
    path: Path, project: Project, flat: Model | None, window: Preparation | None = None
) -> Compared:
    """As `checked`, and the recording as the model takes it; None where it cannot, or without a model."""
    from daest.cli.recordings import signals
    from daest.data.check import check_table
    from daest.data.match import clock_findings, told_time, unitless_findings
    from daest.data.read import counted_in, read_table, with_units, within
    from daest.modelica.flat.clock import model_clock

    window = window or project.preparation
    clock = "s" if flat is None else model_clock(flat)
    as_told = with_units(read_table(path), project.units)
    table = within(counted_in(clock, as_told, project.time), window.start, window.stop, project.time)
    if flat is None:
        return check_table(table, {}, project.time or told_time(table)), None
    inputs, outputs = signals(flat, project)
    roles: dict[str, Role] = dict.fromkeys((signal.header for signal in inputs), "input")
    roles.update(dict.fromkeys((signal.header for signal in outputs), "output"))
    units = {signal.header: signal.unit for signal in (*inputs, *outputs)}
    check = check_table(table, roles, project.time, clock, units)
    doubts = unitless_findings(table, [*inputs, *outputs])
    doubts += clock_findings(as_told, clock, project.time)
    against, recording = _against(path, project, flat, window)
    if any(one.code == "check-time-unit" and one.level == "warning" for one in check.findings):
        # In another unit of time whatever adds up is as many times as large.
        against = [one for one in against if one.code != "check-scale"]
    return replace(check, findings=(*against, *doubts, *check.findings)), recording


def _against(
    path: Path, project: Project, flat: Model, window: Preparation
) -> tuple[Sequence[Finding], Experiment | None]:
    """What the model says about a recording, and that; what makes it unreadable is one of the findings."""
    from daest.cli.recordings import measured_recordings
    from daest.data.contradictions import model_findings

    try:
        measured, experiments = measured_recordings(flat, project, [path], window)
    except DaestError as error:
        # Rows that share their fault and their time have one text: their places are not told here.
        return list(dict.fromkeys(_unusable(problem) for problem in error.problems or (error,))), None
    return model_findings(measured, experiments[0]), experiments[0]


def _unusable(problem: DaestError) -> Finding:
    from daest.model.experiment import Finding

    text = f"cannot be used with the model: {problem.what}"
    if problem.remedy:
        text += f"; {problem.remedy}"
    return Finding("check-unusable", "warning", None, text, subject="the recording")
