"""`daest init`: a daest.toml for a model and a recording."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from daest.cli.given import Files, ParameterOptions, files, parameter_options
from daest.cli.options import ModelOptions, example, format_option, model_options
from daest.cli.output import emit, whole_file

if TYPE_CHECKING:
    import numpy as np

    from daest.data.match import Match
    from daest.data.table import Table
    from daest.errors import DataError
    from daest.model.experiment import DataCheck
    from daest.model.flat import Model
    from daest.report.documents.project import InitDocument


@click.command("init", epilog=example("daest init Servo.mo run1.csv", "daest identify"))
@files("MODEL [DATA]...")
@model_options
@parameter_options
@format_option
def command(
    files: Files,
    model_options: ModelOptions,
    parameters: ParameterOptions,
    form: str,
) -> None:
    """Write a commented daest.toml for MODEL and the recordings DATA.

    Columns are matched with inputs and outputs by name, or proposed by description and unit; of a model
    without outputs, those are matched that are called like its variables. Where the model marks no parameter
    as unknown, those with a unit (all where none has one) that it declares itself are proposed, or else those
    that it gives to its components, of such that no recording could tell apart the first. An existing file is
    not touched.
    """
    from daest.cli.check import checked
    from daest.cli.models import model_source
    from daest.data.match import match_columns, propose_time
    from daest.data.project import FILE_NAME, Project, load_project
    from daest.data.read import Signal, read_table
    from daest.data.template import Draft, project_text
    from daest.errors import DataError
    from daest.modelica.change import with_outputs
    from daest.modelica.flat.clock import model_clock

    file = model_options.project_file or Path(FILE_NAME)
    _refuse_existing(file)
    model, data = model_source(Project(Path()), files.model), files.data
    source = model_options.load(Project(Path()), model)
    flat, proposed = _chosen(source, parameters, model.read_bytes() if model.suffix == ".mo" else b"")
    tables = [read_table(path) for path in data]
    inputs = [Signal(v.name, v.unit) for v in flat.inputs]
    if tables and not flat.outputs and (measured := _called_like_columns(flat, tables[0])):
        flat = with_outputs(flat, measured)
    outputs = [Signal(y.name, y.unit) for y in flat.outputs]
    matches = match_columns([*inputs, *outputs], tables[0], _described(flat), _equal(flat)) if tables else []
    draft = Draft(
        flat,
        _relative(model, file),
        model_options.class_name,
        tuple(_relative(path, file) for path in model_options.libraries),
        tuple(_relative(path, file) for path in data),
        tuple(matches[: len(inputs)]),
        tuple(matches[len(inputs) :]),
        tuple(column.header for column in tables[0].columns) if tables else (),
        propose_time(tables[0]) if tables else None,
        _units_to_check(matches, tables[0]) if tables else {},
        frozenset({*parameters.held, *(parameters.prior or {}), *_other_choice(source, flat)}),
        proposed,
        _split(tables, is_driven=bool(inputs)),
        model_clock(flat),
    )
    with whole_file(file) as temporary:
        temporary.write_text(project_text(draft), encoding="utf-8")
    project = load_project(file)
    try:
        checks = [checked(path, project, flat) for path in data]
    except DataError as error:
        raise _with_file(error, file) from error
    emit(_document(file, draft, checks, tables), "init", form, None, _text)


def _with_file(error: DataError, file: Path) -> DataError:
    """The error of a recording that cannot be checked, with the `file` that was written for it before."""
    from daest.errors import DataError

    remedy = f"{error.remedy}; {file} is written: complete it, or remove it before the next daest init"
    return DataError(
        error.code, error.what, where=error.where, remedy=remedy.removeprefix("; "), problems=error.problems
    )


def _units_to_check(matches: Sequence[Match], table: Table) -> dict[str, str]:
    """The units of columns whose header names none, as their names and their neighbours tell."""
    from daest.data.match import named_time_unit, named_units, other_temperatures

    return {
        **named_units(matches, table),
        **other_temperatures(matches, table),
        **named_time_unit(table),
    }


def _split(tables: Sequence[Table], *, is_driven: bool) -> float | None:
    """The share of the recordings that estimates: half, or more of them where that is too short to diagnose
    from, and the whole is not. None where the last one is to validate as a whole: of several runs in which
    nothing drives the machine, each ends at rest, and second halves tell of that alone."""
    from daest.diagnosis.evidence.stand import is_enough, least_share

    times = [_times(table) for table in tables if table.columns]
    if not is_driven and len(tables) > 1 and is_enough([time.size for time in times[:-1]]):
        return None
    return least_share([time for time in times if time.size]) or 0.5


def _times(table: Table) -> np.ndarray:
    """When the rows (n,) of a table were recorded, in its own unit; their numbers where no column tells."""
    import numpy as np

    from daest.data.match import propose_time
    from daest.data.table import time_column, with_seconds

    column = time_column(table, propose_time(table))
    time = np.arange(table.columns[0].values.size) if column is None else with_seconds(column).values
    return time if np.all(np.diff(time) > 0) else np.arange(time.size)


def _refuse_existing(file: Path) -> None:
    from daest.errors import ConfigError, Place

    if file.exists():
        raise ConfigError(
            "config-exists",
            "the file exists and is not overwritten",
            where=Place(str(file)),
            remedy="remove it, or write another one with -p FILE",
        )


def _chosen(source: Model, parameters: ParameterOptions, text: bytes) -> tuple[Model, tuple[str, ...]]:
    """The model with the parameters that the command line chooses, and which of the estimated ones are a
    proposal, by the `text` of its file; empty for an FMU."""
    from daest.modelica.change import declare

    proposed = () if parameters.estimate else _proposed(source, text)
    flat = parameters.applied(declare(source, estimate=proposed) if proposed else source)
    return flat, tuple(p.name for p in flat.parameters if p.estimate and p.name in proposed)


def _proposed(flat: Model, text: bytes) -> tuple[str, ...]:
    """What to estimate where the model marks nothing: the parameters that it declares itself (no part of a
    component) and the fields of its records, or else those that its `text` gives to its components, with a
    unit and a value other than zero. What is zero is the place of something, and a number without a unit is a
    ratio that somebody chose, unless no parameter has one, or all inputs and outputs are in "1": in per unit,
    every quantity is. What stands in no equation is a start, say, and
    starts are free. Of those that the equations know only together, the first are proposed."""
    from daest.model.flat import FlatModel
    from daest.modelica.forms.modifications import declared_records, modified_names
    from daest.modelica.places.sites import used_parameters

    if any(parameter.estimate for parameter in flat.parameters):
        return ()
    used = set(flat.parameter_names)
    if isinstance(flat, FlatModel) and flat.events is None:
        used = set(used_parameters(flat))
    noises = {f"{noise.name.rpartition('.')[0]}.intensity" for noise in flat.noises}
    with_unit = {p.name for p in flat.parameters if p.unit not in ("", "1")}
    units = {*(u.unit for u in flat.inputs), *(y.unit for y in flat.outputs)}
    if units == {"1"}:
        with_unit |= {p.name for p in flat.parameters if p.unit == "1"}
    told = with_unit or set(flat.parameter_names)
    may_be = [
        p.name
        for p in flat.parameters
        if p.value != 0.0 and not p.is_memory and p.name in (used & told) - noises
    ]
    own = tuple(name for name in may_be if "." not in name)
    records, given = declared_records(text, flat.name), modified_names(text, flat.name)
    own += tuple(name for name in may_be if "." in name and name.partition(".")[0] in records)
    return _told_apart(flat, own or tuple(name for name in may_be if name in given))


def _told_apart(flat: Model, names: tuple[str, ...]) -> tuple[str, ...]:
    """Without those that the equations know only together with earlier ones."""
    from daest.errors import DaestError
    from daest.model.flat import FlatModel
    from daest.systems.reduction.known_together import told_apart
    from daest.systems.reduction.reduce import reduce_index

    if not isinstance(flat, FlatModel) or flat.events is not None:
        return names
    try:
        return told_apart(reduce_index(flat), names)
    except DaestError:
        return names


def _other_choice(source: Model, flat: Model) -> set[str]:
    """Parameters that the model marks as unknown and that are not to be estimated."""
    return {
        before.name
        for before, after in zip(source.parameters, flat.parameters, strict=True)
        if before.estimate and not after.estimate
    }


def _called_like_columns(flat: Model, table: Table) -> list[str]:
    """The unknowns after whom columns are called, but for case and a trailing unit: what is measured of a
    model that declares no output. Of those inside components only such as a column names in full, since
    the last parts of their names (`w`) are those of many."""
    from daest.data.match import match_columns
    from daest.data.read import Signal

    named = {name for column in table.columns for name in (column.name, column.header)}
    signals = [Signal(v.name, v.unit) for v in flat.inputs]
    signals += [Signal(v.name, v.unit) for v in flat.unknowns if "." not in v.name or v.name in named]
    matches = match_columns(signals, table)[len(flat.inputs) :]
    return [match.signal.name for match in matches if match.how in ("name", "similar name")]


def _equal(flat: Model) -> dict[str, str]:
    """What outputs are, by name: the expression in unknowns that they name (`y1 = T1`)."""
    from daest.model.flat import FlatModel

    if not isinstance(flat, FlatModel):
        return {}
    return {y.name: str(flat.output_expressions[i]) for i, y in enumerate(flat.outputs)}


def _described(flat: Model) -> dict[str, str]:
    """What the model says in words of its inputs and outputs, by name; of an output that names an unknown
    (`y1 = T1`) what it says of that, too."""
    of_unknowns = {v.name: f"{v.name} {v.description}" for v in flat.unknowns}
    inputs = {v.name: v.description for v in flat.inputs}
    equal = _equal(flat)
    outputs = {y.name: f"{y.description} {of_unknowns.get(equal.get(y.name, ''), '')}" for y in flat.outputs}
    return {**inputs, **outputs}


def _relative(path: Path, file: Path) -> str:
    return Path(os.path.relpath(path.resolve(), file.resolve().parent)).as_posix()


def _document(file: Path, draft: Any, checks: Sequence[DataCheck], tables: Sequence[Table]) -> InitDocument:
    from daest.quantities import is_known_unit
    from daest.report.documents.parts import entry
    from daest.report.documents.project import Clock, RecordedFinding

    is_complete = all(match.column is not None for match in (*draft.inputs, *draft.outputs))
    return {
        "file": str(file),
        "model": draft.flat.name,
        "inputs": {match.signal.name: match.column for match in draft.inputs},
        "outputs": {match.signal.name: match.column for match in draft.outputs},
        "doubtful": [m.signal.name for m in (*draft.inputs, *draft.outputs) if m.how not in (None, "name")],
        "estimate": [p.name for p in draft.flat.parameters if p.estimate],
        "proposed": list(draft.proposed),
        "noises": draft.flat.noise_names,
        "time": draft.time,
        "units": dict(draft.units),
        "unread_units": {
            column.name: column.unit
            for column in (tables[0].columns if tables and not is_complete else ())
            if column.unit and not is_known_unit(column.unit)
        },
        "recordings": [entry(Clock, check) for check in checks],
        "findings": [
            entry(RecordedFinding, finding, recording=check.name)
            for check in checks
            for finding in check.findings
            # What has no column yet cannot be used, which is no fault of the recording.
            if is_complete or finding.code != "check-unusable"
        ],
    }


def _text(document: Mapping[str, Any], width: int, color: bool) -> str:
    from daest.report.console import Paragraph, rendered
    from daest.report.texts.check import clock_words

    lines = [f"wrote {document['file']} for {document['model']}"]
    for kind in ("inputs", "outputs"):
        for name, column in document[kind].items():
            doubt = ", please check" if name in document["doubtful"] else ""
            chosen = f"{column}{doubt}" if column else f"NO COLUMN FITS, please complete {document['file']}"
            lines.append(f"  {kind[:-1]} {name}: {chosen}")
    if document["time"] is not None:
        lines.append(f"  time: {document['time']}, please check")
    for column, unit in document["units"].items():
        lines.append(f"  unit of {column}: {unit}, please check")
    for column, unit in document["unread_units"].items():
        lines.append(f"  unit of {column}: '{unit}' is not understood, write it as in N.m, W/(m2.K), degC, 1")
    for recording in document["recordings"]:
        lines.append(f"  {recording['name']}: {clock_words(recording)}")
    marked = ", ".join(document["estimate"]) or f"NONE MARKED, see [parameters] of {document['file']}"
    doubt = " (the model marks none), please check" if document["proposed"] else ""
    lines.append(f"  estimated parameters: {marked}{doubt}")
    lines += [f"  {f['level']}[{f['code']}]: {f['recording']}: {f['text']}" for f in document["findings"]]
    return rendered(map(Paragraph, lines), width, color)
