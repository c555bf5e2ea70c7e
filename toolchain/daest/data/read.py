"""From files to experiments: columns matched with model signals by name, values in the model's units."""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from daest.data import FORMATS
from daest.data.csv_file import ALL
from daest.data.faults import unevenness
from daest.data.limits import DATA
from daest.data.prepare import Preparation, on_clock, prepare
from daest.data.table import (
    Column,
    Part,
    Table,
    counted_column,
    frame_table,
    in_seconds,
    is_frame,
    raise_collected,
    time_unit,
    with_seconds,
)
from daest.errors import DataError, Place
from daest.files import why_no_file
from daest.lists import first_few
from daest.model.experiment import Experiment
from daest.near import nearest
from daest.quantities import Conversion, conversion, in_base_units, may_count_turns

MOST_NAMED = 8  # recordings of a folder that a message lists

_FEWEST_ROWS = 2
_TEXTS_SHOWN = 3  # of one column; the rest is counted
_NUMBERS = "write numbers with a decimal point; leave the cell empty if the value is missing"
_TIME_FORMS = "write all times as numbers with a decimal point, or as dates such as 2026-11-21 08:15:00"


@dataclass(frozen=True)
class Signal:
    """A model signal looked for in data: its model name, its unit there ("" is unknown), and the column that
    holds it (None: the column of the same name, which an output may lack). A minus before the column turns
    its sign: `-torque` of a sensor that is mounted the other way."""

    name: str
    unit: str = ""
    column: str | None = None

    @property
    def header(self) -> str:
        """The column that is looked for."""
        return self.name if self.column is None else self.column.removeprefix("-").lstrip()

    @property
    def sign(self) -> float:
        return -1.0 if self.column is not None and self.column.startswith("-") else 1.0


def read_experiments(
    paths: Sequence[Any],
    inputs: Sequence[Signal],
    outputs: Sequence[Signal],
    preparation: Preparation | None = None,
    *,
    outputs_required: bool = True,
    time: str | None = None,
    units: Mapping[str, str] | None = None,
    others: bool = True,
    clock: str = "s",
) -> list[Experiment]:
    """One experiment per file, with every signal of `inputs` and `outputs` in that order and in its unit.

    It is named after its file, by the whole path where two files have the same name. A pandas DataFrame, an
    xarray Dataset or a mapping of arrays may stand in place of a path; those are called `data 1`, `data 2` by
    their position.
    `time` names the column of the time where it is not called so, `units` the units of columns whose header
    has none. Not `others`: columns that are no signal need not be read, and then are not in `extra`.
    `clock` is the unit of the time of the experiments, and of the window of `preparation`: that in which the
    model counts. A column of the time that does not tell its unit is taken as it stands.

    An output that a file has no column for is all NaN there, unless a column was named for it. Raises
    DataError with all problems of a file at once: missing columns, units that do not fit, texts, time that
    does not increase, gaps in inputs; and `data-no-output` if `outputs_required` and a file has none of them.

        >>> outputs = [daest.Signal("omega", "rad/s"), daest.Signal("phi", "rad")]
        >>> (record,) = daest.read_experiments(["servo.csv"], [daest.Signal("u", "V")], outputs)
        >>> record.n_samples, record.period
        (8000, 0.01)
    """
    preparation = preparation or Preparation()
    # Readers cut in seconds.
    cut = (preparation.start, preparation.stop) if clock == "s" else (None, None)
    part = Part(None, *cut, time, units or {})
    if not others:
        part = replace(part, names=tuple(signal.header for signal in (*inputs, *outputs)))
    experiments = [
        _matched(
            counted_in(clock, with_units(table, units or {}), time),
            inputs,
            outputs,
            preparation,
            outputs_required,
            time,
        )
        for table in (read_source(source, position, part) for position, source in enumerate(paths, 1))
    ]
    stems = [experiment.name for experiment in experiments]
    return [
        replace(experiment, name=str(path)) if stems.count(experiment.name) > 1 else experiment
        for experiment, path in zip(experiments, paths, strict=True)
    ]


def read_table(path: Path, part: Part = ALL) -> Table:
    """The columns of a file of any kind that is read, or the wanted `part` where its kind can be read in
    part. Raises DataError if it is missing, unreadable or empty."""
    if (why := why_no_file(path)) is not None:
        raise DataError(
            "data-missing-file",
            f"the recording {why}",
            where=Place(str(path)),
            remedy=_other_recordings(path),
        )
    known = FORMATS.get(path.suffix.lower())
    if known is None:
        raise DataError(
            "data-unknown-format",
            f"files of kind '{path.suffix}' are not read",
            where=Place(str(path)),
            remedy=f"give one of {', '.join(sorted(FORMATS))}",
        )
    file, function = known
    return getattr(importlib.import_module(f"daest.data.{file}"), function)(path, part)


def measured_names(experiments: Sequence[Experiment]) -> tuple[str, ...]:
    """Names of the outputs that have at least one value in at least one experiment, in the order of the
    first."""
    return tuple(
        name
        for i, name in enumerate(experiments[0].output_names)
        if any(np.isfinite(experiment.outputs[:, i]).any() for experiment in experiments)
    )


def select_outputs(experiment: Experiment, names: Sequence[str]) -> Experiment:
    """The experiment with the outputs `names` alone, in that order; the others move to `extra`."""
    dropped = {
        name: experiment.outputs[:, i]
        for i, name in enumerate(experiment.output_names)
        if name not in names and np.isfinite(experiment.outputs[:, i]).any()
    }
    return replace(
        experiment,
        outputs=experiment.outputs_of(names),
        output_names=tuple(names),
        extra={**experiment.extra, **dropped},
    )


def _other_recordings(path: Path) -> str:
    """What may be meant by a path where no recording is: a near name, else the recordings of its folder."""
    names = [entry.name for entry in path.parent.iterdir()] if path.parent.is_dir() else []
    others = sorted(name for name in names if name != path.name)
    recordings = [name for name in others if Path(name).suffix.lower() in FORMATS]
    if (near := nearest(path.name, others)) or not recordings:
        return near or "check the path; it counts from the current folder"
    listed = ", ".join(recordings[:MOST_NAMED]) + (", ..." if len(recordings) > MOST_NAMED else "")
    return f"there are {listed} in that folder"


def read_source(source: Any, position: int = 1, part: Part = ALL) -> Table:
    """The table of a file, or of data in memory, which are called by their position. Raises DataError."""
    return frame_table(source, f"data {position}") if is_frame(source) else read_table(Path(source), part)


def with_units(table: Table, units: Mapping[str, str]) -> Table:
    """The table with `units` (by column name) added to columns whose header has none, or counts something
    in a time (`n [1/min]`), of which they say what (rpm). Units of columns that the table does not have are
    ignored. Raises DataError `data-unit-twice`."""
    problems = [
        DataError(
            "data-unit-twice",
            f"the header gives '{c.name}' the unit '{c.unit}', [data.units] '{units[c.name]}'",
            where=table.place(None, c),
            remedy="keep one of them",
        )
        for c in table.columns
        if c.name in units
        and c.unit not in (None, units[c.name])
        and not may_count_turns(c.unit, units[c.name])
    ]
    raise_collected(problems, table.file)
    return replace(table, columns=tuple(replace(c, unit=units.get(c.name, c.unit)) for c in table.columns))


def counted_in(clock: str, table: Table, time: str | None = None) -> Table:
    """The table with its column of the time in `clock`, the unit in which a model counts, where it tells its
    unit or holds dates."""
    column = counted_column(table, clock, time)
    if column is None:
        return table
    dated = with_seconds(column)
    if dated.texts:  # which are told where the time is read
        return table
    values = in_seconds(dated) / in_base_units(clock)
    # In "s" numbers are read as they stand, whatever they count.
    counted = replace(dated, values=values, unit="s")
    return replace(table, columns=tuple(counted if c is column else c for c in table.columns))


def _matched(
    table: Table,
    inputs: Sequence[Signal],
    outputs: Sequence[Signal],
    preparation: Preparation,
    outputs_required: bool,
    time: str | None,
) -> Experiment:
    time_in, note = _in_their_gaps(find_time(table, time))
    table = replace(table, notes=(*table.notes, note)) if note else table
    problems = _time_problems(table, time_in)
    matched: dict[str, Column] = {}
    match_all(table, inputs, outputs, matched, problems, outputs_required)
    raise_collected(problems, table.file)
    return _experiment(table, time_in, matched, inputs, outputs, preparation)


def _experiment(
    table: Table,
    time_in: Column,
    matched: dict[str, Column],
    inputs: Sequence[Signal],
    outputs: Sequence[Signal],
    preparation: Preparation,
) -> Experiment:
    problems: list[DataError] = []
    notes: list[str] = []
    time = in_seconds(time_in)
    keep = _window(table, time, preparation)
    missing = np.full(time.shape, np.nan)

    def gather(signals: Sequence[Signal]) -> np.ndarray:
        columns = [
            _values(table, matched[s.name], s, problems, notes) if s.name in matched else missing
            for s in signals
        ]
        return np.column_stack(columns)[keep] if columns else np.empty((int(keep.sum()), 0))

    u, y = gather(inputs), gather(outputs)
    for i, signal in enumerate(inputs):
        _check_gaps(table, matched.get(signal.name), u[:, i], np.nonzero(keep)[0], problems)
    for i, signal in enumerate(outputs):
        _check_output(table, matched.get(signal.name), y[:, i], notes, problems)
    raise_collected(problems, table.file)
    used = {column.position or column.name for column in (*matched.values(), time_in)}
    others = [
        column
        for column in table.columns
        if (column.position or column.name) not in used and column.name and not column.texts
    ]
    extra = {column.name: column.values[keep] for column in others}
    experiment = Experiment(
        Path(table.file).stem,
        time[keep],
        u,
        y,
        tuple(signal.name for signal in inputs),
        tuple(signal.name for signal in outputs),
        extra,
        (*table.notes, *notes),
        {column.name: column.unit for column in others if column.unit},
        {s.name: reading(s, matched[s.name].unit) for s in (*inputs, *outputs) if s.name in matched},
    )
    return prepare(on_clock(experiment), preparation)


def within(table: Table, start: float | None, stop: float | None, time: str | None = None) -> Table:
    """The rows of the table from `start` to `stop` [s] (None: open). Raises DataError where there is no time,
    and `data-window-empty`."""
    if start is None and stop is None:
        return table
    seconds = in_seconds(find_time(table, time))
    rows = np.nonzero(_window(table, seconds, Preparation(start=start, stop=stop)))[0]
    at = {int(row): i for i, row in enumerate(rows)}
    columns = tuple(
        replace(c, values=c.values[rows], texts=tuple((at[row], text) for row, text in c.texts if row in at))
        for c in table.columns
    )
    lines = None if table.lines is None else np.asarray(table.lines)[rows]
    return replace(table, columns=columns, lines=lines)


def find_time(table: Table, name: str | None = None) -> Column:
    """The time column, with dates converted to seconds: the column `name` if it is given, otherwise the only
    column whose name says that it is the time. Raises DataError `data-no-time`, `data-two-time-columns` or
    `data-unknown-column`."""
    if name is None:
        return with_seconds(_time_column(table))
    column = table.find(name)
    if column is None:
        raise DataError(
            "data-unknown-column",
            f"there is no column '{name}' (named for the time); the columns are {', '.join(table.names)}",
            where=table.place(),
            remedy=nearest(name, table.names) or 'name another: [data] time = "column" in daest.toml',
        )
    return with_seconds(column)


def _time_column(table: Table) -> Column:
    times = [column for column in table.columns if time_unit(column) is not None]
    if len(times) == 1:
        return times[0]
    if times:
        raise DataError(
            "data-two-time-columns",
            f"several columns are the time: {', '.join(column.header for column in times)}",
            where=table.place(None, times[1]),
            remedy="keep one and rename the others",
        )
    raise DataError(
        "data-no-time",
        f"there is no column 'time' or 'time_s'; the columns are {', '.join(table.names)}",
        where=table.place(),
        remedy=nearest("time", table.names).replace("did you mean", "rename the column of the seconds: is it")
        or "call the column with the seconds 'time' (or 'time [ms]'), or name it: [data] time = \"column\"",
    )


def _time_problems(table: Table, column: Column) -> list[DataError]:
    problems = _text_problems(table, column, _TIME_FORMS)
    unreadable = {row for row, _ in column.texts}
    gaps = [int(row) for row in np.nonzero(~np.isfinite(column.values))[0] if int(row) not in unreadable]
    for row in gaps[:_TEXTS_SHOWN]:
        problems.append(
            DataError(
                "data-time-missing",
                "the time of this row is missing",
                where=table.place(row, column),
                remedy="give every row its time",
            )
        )
    if column.values.size < _FEWEST_ROWS:
        problems.append(_too_few(table, column.values.size))
    if not problems:
        problems += _order_problems(table, column)
    return problems


def _in_their_gaps(column: Column) -> tuple[Column, str]:
    """The time with rows that have the time of their neighbour put back into the gap beside it, and a note;
    as it is, and no note, where one of them has no such gap, they are not rare, or the clock is uneven."""
    time = column.values
    if time.size <= DATA.clock_steps or not np.all(np.isfinite(time)):
        return column, ""
    steps = np.diff(time)
    still = np.flatnonzero(steps == 0)
    if not still.size or still.size > DATA.rare * time.size or np.any(steps < 0):
        return column, ""
    counts = steps / np.median(steps)
    near = np.where(np.abs(counts - np.round(counts)) <= DATA.lost_samples, np.round(counts), 0)
    placed = time.copy()
    for i in still:
        before, after = (near[j] if 0 <= j < near.size else 0 for j in (i - 1, i + 1))
        if (before, after) not in ((2, 1), (1, 2)):
            return column, ""
        late = i if before == 2 else i + 1
        placed[late] = 0.5 * (time[late - 1] + time[late + 1])
    if unevenness(placed) > DATA.uneven_clock:
        return column, ""
    shown = first_few([f"{time[i]:.10g}" for i in still], _TEXTS_SHOWN)
    note = (
        f"the time stands still at {shown}, where a step beside it leaves out a row: that row is taken "
        "in the middle of that step"
    )
    return replace(column, values=placed), note


def _order_problems(table: Table, column: Column) -> list[DataError]:
    """One problem for each row that is not after the one before; one that counts the others where they are
    too many to be told."""
    bad = np.nonzero(np.diff(column.values) <= 0)[0] + 1
    shown = bad[:1] if bad.size > _TEXTS_SHOWN else bad
    others = f" (and in {bad.size - 1} more rows)" if bad.size > shown.size else ""
    problems = []
    for row in shown:
        before, now = column.values[row - 1], column.values[row]
        how = "stands still at" if now == before else f"goes back from {before:.10g} to"
        code = "data-time-duplicate" if now == before else "data-time-not-increasing"
        problems.append(
            DataError(
                code,
                f"the time {how} {now:.10g}{others}",
                where=table.place(int(row), column),
                remedy="sort the rows, remove rows of equal time; two recordings belong in two files",
            )
        )
    return problems


def match_all(
    table: Table,
    inputs: Sequence[Signal],
    outputs: Sequence[Signal],
    matched: dict[str, Column],
    problems: list[DataError],
    outputs_required: bool = True,
) -> None:
    """Find the columns of all signals and add them to `matched`; what hinders is added to `problems`. An
    output may be absent where no column is named for it, all of them where they are not required."""
    for signal in inputs:
        _match(table, signal, "input", matched, problems)
    for signal in outputs:
        if signal.column is not None or table.find(signal.name) is not None:
            _match(table, signal, "output", matched, problems)
    if outputs_required and not any(signal.name in matched for signal in outputs) and not problems:
        problems.append(_no_output(table, outputs))


def _match(
    table: Table, signal: Signal, kind: str, matched: dict[str, Column], problems: list[DataError]
) -> None:
    wanted = signal.header
    column = table.find(wanted)
    if column is None:
        problems.append(_unknown_column(table, signal, kind, wanted))
        return
    matched[signal.name] = column
    problems += _text_problems(table, column)
    if column.unit is not None and signal.unit:
        try:
            conversion(column.unit, signal.unit)
        except DataError as error:
            what = (
                f"column '{column.header}' does not fit {kind} '{signal.name}' [{signal.unit}]: {error.what}"
            )
            problems.append(DataError(error.code, what, where=table.place(None, column), remedy=error.remedy))


def _unknown_column(table: Table, signal: Signal, kind: str, wanted: str) -> DataError:
    if wanted != signal.name:
        mapped = f" (the column named in daest.toml for {kind} '{signal.name}')"
    else:
        mapped = f" for that {kind}" + ("" if signal.column is None else ", as it is named in daest.toml")
    if wanted in table.left_out:
        return DataError(
            "data-unknown-column",
            f"'{wanted}'{mapped} is no column: {table.left_out[wanted]}",
            where=table.place(),
            remedy="save vectors of equal length, one value for each time",
        )
    hint = nearest(wanted, table.names)
    section = "inputs" if kind == "input" else "outputs"
    return DataError(
        "data-unknown-column",
        f"there is no column '{wanted}'{mapped}; the columns are {', '.join(table.names)}",
        where=table.place(),
        remedy=f"{hint + ' ' if hint else ''}map it in daest.toml: [data] {section} = "
        f'{{ "{signal.name}" = "column" }}',
    )


def _no_output(table: Table, outputs: Sequence[Signal]) -> DataError:
    """That no column is an output of the model."""
    names = ", ".join(signal.name for signal in outputs) or "none at all"
    return DataError(
        "data-no-output",
        f"no column is an output of the model (outputs: {names}; columns: {', '.join(table.names)})",
        where=table.place(),
        remedy='name the columns in daest.toml: [data] outputs = { "model name" = "column" }',
    )


def _text_problems(table: Table, column: Column, remedy: str = _NUMBERS) -> list[DataError]:
    problems = []
    for row, text in column.texts[:_TEXTS_SHOWN]:
        more = len(column.texts) - _TEXTS_SHOWN
        last = row == column.texts[:_TEXTS_SHOWN][-1][0] and more > 0
        problems.append(
            DataError(
                "data-text",
                f"column '{column.header}' holds the text '{text}' where a number is expected"
                + (f" (and {more} more such cells)" if last else ""),
                where=table.place(row, column),
                remedy=remedy,
            )
        )
    return problems


def _window(table: Table, time: np.ndarray, preparation: Preparation) -> np.ndarray:
    # The ends are included although the times may come from a rounded decimal: 1e-9 of the last time.
    slack = 1e-9 * float(np.max(np.abs(time), initial=0.0))
    keep = np.ones(time.shape, dtype=bool)
    if preparation.start is not None:
        keep &= time >= preparation.start - slack
    if preparation.stop is not None:
        keep &= time <= preparation.stop + slack
    if keep.sum() < _FEWEST_ROWS:
        raise DataError(
            "data-window-empty",
            f"{int(keep.sum())} rows lie between --from and --to; the recording reaches from "
            f"{time[0]:.6g} s to {time[-1]:.6g} s",
            where=Place(table.file),
            remedy="choose a window inside the recording",
        )
    return keep


def _values(
    table: Table, column: Column, signal: Signal, problems: list[DataError], notes: list[str]
) -> np.ndarray:
    infinite = np.nonzero(np.isinf(column.values))[0]
    if infinite.size:
        problems.append(
            DataError(
                "data-infinite",
                f"column '{column.header}' is infinite in {infinite.size} row(s)",
                where=table.place(int(infinite[0]), column),
                remedy="leave the cell empty if the value is missing",
            )
        )
    change = reading(signal, column.unit)
    if signal.sign < 0.0:
        notes.append(f"{signal.name}: column '{column.header}' with its sign turned")
    if not replace(change, scale=abs(change.scale)).is_identity:
        notes.append(f"{signal.name}: column '{column.header}' converted to {signal.unit}{_added(change)}")
    return change(column.values)


def _added(change: Conversion) -> str:
    """What a conversion adds, which a temperature above another one does not take."""
    if not change.offset:
        return ""
    return f", {change.offset:.6g} added (a difference of temperatures is in K)"


def reading(signal: Signal, unit: str | None) -> Conversion:
    """What makes of numbers in a `unit` (None: not known) those of the signal, its sign included. Raises
    DataError where the units do not fit."""
    plain = conversion(unit, signal.unit) if unit is not None and signal.unit else Conversion()
    return Conversion(signal.sign * plain.scale, signal.sign * plain.offset)


def _check_gaps(
    table: Table, column: Column | None, values: np.ndarray, rows: np.ndarray, problems: list[DataError]
) -> None:
    if column is None:
        return
    gaps = np.nonzero(np.isnan(values))[0]
    if gaps.size:
        problems.append(
            DataError(
                "data-input-gap",
                f"input column '{column.header}' lacks {gaps.size} of {values.size} values",
                where=table.place(int(rows[gaps[0]]), column),
                remedy="inputs must be known at every time: fill the gaps, or cut with --from and --to",
            )
        )


def _check_output(
    table: Table, column: Column | None, values: np.ndarray, notes: list[str], problems: list[DataError]
) -> None:
    if column is None:
        return
    n_missing = int(np.isnan(values).sum())
    if n_missing == values.size:
        problems.append(
            DataError(
                "data-all-missing",
                f"output column '{column.header}' holds no value",
                where=table.place(None, column),
                remedy="remove the column, or choose a window with --from and --to that holds values",
            )
        )
    elif n_missing:
        notes.append(f"{column.name}: {n_missing} of {values.size} samples are missing")


def _too_few(table: Table, n_rows: int) -> DataError:
    return DataError(
        "data-too-few-rows",
        f"the recording has {n_rows} row(s) of numbers",
        where=table.place(),
        remedy=f"at least {_FEWEST_ROWS} are needed, and for an estimate more samples than parameters",
    )
