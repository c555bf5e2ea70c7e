"""The tables of the Modelica Standard Library (`CombiTable1D`, `CombiTable2D`, `CombiTimeTable`, `TimeTable`)
as expressions, of rows that stand in the model or in a file: the library reads them in C, or by a loop that
ends where time tells.

A table is a matrix whose first column is the abscissa. Between its rows values lie on straight lines or
cubics, or are constant; outside they go on, stay or repeat, as the library defines it (types `Smoothness` and
`Extrapolation` of Modelica.Blocks.Types)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from daest.modelica.forms.dialect import CONSTRUCTOR
from daest.modelica.language import values as v
from daest.modelica.language.operators import integer
from daest.modelica.language.table_files import Folders, read_table
from daest.modelica.language.values import Record, Scalar, Value

# Ordinals of Modelica.Blocks.Types.Smoothness.
LINEAR, AKIMA, CONSTANT, FRITSCH_BUTLAND, STEFFEN, MODIFIED_AKIMA = 1, 2, 3, 4, 5, 6
HOLD, LAST, PERIODIC, NONE = 1, 2, 3, 4  # ordinals of Modelica.Blocks.Types.Extrapolation
NEAR = 1e-9  # share of a period by which an instant may miss the end of one
NEVER = 1e60  # what the library gives as the next instant where there is none

_FILE = ("verboseRead", "delimiter", "nHeaderLines")
_FIELDS = {
    "ExternalCombiTable1D": (
        *("tableName", "fileName", "table", "columns", "smoothness", "extrapolation"),
        *_FILE,
    ),
    "ExternalCombiTable2D": ("tableName", "fileName", "table", "smoothness", "extrapolation", *_FILE),
    "ExternalCombiTimeTable": (
        *("tableName", "fileName", "table", "startTime", "columns"),
        *("smoothness", "extrapolation", "shiftTime", "timeEvents"),
        *_FILE,
    ),
}
_DEFAULTS: dict[str, Any] = {
    "extrapolation": LAST,
    "shiftTime": 0.0,
    "timeEvents": 1,
    "delimiter": ",",
    "nHeaderLines": 0,
}


_COEFFICIENTS = "Modelica.Blocks.Sources.TimeTable.getInterpolationCoefficients"


def is_table(name: str) -> bool:
    """Whether a function constructs or reads such a table."""
    return name == _COEFFICIENTS or _short(name) in {
        **_READERS,
        **dict.fromkeys(one + CONSTRUCTOR for one in _FIELDS),
    }


def results(name: str, arguments: Sequence[Value], folders: Folders) -> tuple[Value, ...]:
    """The results of the function; `folders` are those of files. Raises ValueError with what is not
    supported."""
    if name == _COEFFICIENTS:
        return _coefficients(*arguments)  # type: ignore[arg-type]
    short = _short(name)
    if short.endswith(CONSTRUCTOR):
        return (_constructed(_FIELDS[short.removesuffix(CONSTRUCTOR)], arguments, folders),)
    return (_READERS[short](*arguments),)


def _constructed(names: Sequence[str], arguments: Sequence[Value], folders: Folders) -> Record:
    """A table with its rows, wherever they stand."""
    given = dict(zip(names, arguments, strict=False))
    fields = {**{key: _DEFAULTS.get(key, 0.0) for key in names}, **given}
    file = fields["fileName"]
    if isinstance(file, str) and file not in ("NoName", ""):
        found = read_table(
            folders.file(file),
            str(fields["tableName"]),
            str(fields["delimiter"]),
            integer(v.constant(fields["nHeaderLines"])),
        )
        fields["table"] = found.astype(object)
    return Record(fields)


def _short(name: str) -> str:
    return name.rpartition(".")[2]


def _columns(table: Value, column: Value) -> tuple[np.ndarray, list[Scalar]]:
    """Abscissae and values of one column of a table."""
    assert isinstance(table, Record)
    matrix, columns = table.fields["table"], table.fields["columns"]
    matrix = _matrix(matrix)
    number = integer(v.constant(column))  # type: ignore[arg-type]
    chosen = integer(columns.flat[number - 1] if isinstance(columns, np.ndarray) else columns)
    if chosen > matrix.shape[1]:
        raise ValueError(f"the table has {matrix.shape[1]} columns, no number {chosen}")
    return _abscissae(matrix[:, 0], "column"), list(matrix[:, chosen - 1])


def _matrix(table: Value) -> np.ndarray:
    """The rows of a table. Raises ValueError where it has none, or says that a C function has them."""
    if not isinstance(table, np.ndarray) or table.ndim != 2 or table.size == 0:
        raise ValueError("the table has no rows: give `table`, or `fileName` where tableOnFile = true")
    return table


def _abscissae(values: Iterable[Scalar], what: str) -> np.ndarray:
    found = [v.constant(x) for x in values]
    if any(isinstance(x, ca.SX) for x in found):
        raise ValueError(f"the first {what} of a table must be numbers")
    made = np.array(found, dtype=float)
    if np.any(np.diff(made) < 0):
        raise ValueError(f"the first {what} of a table must not decrease")
    return made


def _kinds(table: Value) -> tuple[int, int]:
    assert isinstance(table, Record)
    smoothness, extrapolation = (int(v.constant(table.fields[k])) for k in ("smoothness", "extrapolation"))  # type: ignore[arg-type]
    return smoothness, extrapolation


def _value(table: Value, column: Value, u: Value) -> Value:
    """The value of a table at u."""
    x, y = _columns(table, column)
    smoothness, extrapolation = _kinds(table)
    if x.size == 1:
        return y[0]
    at: Any = u
    if extrapolation == PERIODIC and x[-1] > x[0]:
        period = x[-1] - x[0]
        at = at - period * ca.floor((at - x[0]) / period)
    return _piece(x, y, at, lambda i: at >= x[i], smoothness, extrapolation)


def _piece(
    x: np.ndarray,
    y: Sequence[Scalar],
    at: Any,
    is_past: Callable[[int], Any],
    smoothness: int,
    extrapolation: int,
) -> Any:
    """The curve at `at` on the piece that begins with the last row i for which `is_past(i)` holds. Where all
    rows stand at one place it is a step there."""
    starts = [i for i in range(x.size - 1) if x[i + 1] > x[i]]
    if not starts:
        return _if(is_past(x.size - 1), y[-1], y[0])
    slopes = [] if smoothness in (LINEAR, CONSTANT) else _slopes(x, y, smoothness)
    lines = [_cubic(x, y, slopes, i, at) if slopes else _line(x, y, i, at, smoothness) for i in starts]
    made: Any = lines[0]
    goes_on = extrapolation == LAST and smoothness != LINEAR
    if extrapolation == HOLD or goes_on:
        made = _if(is_past(0), made, _beyond(x, y, slopes, 0, at) if goes_on else y[0])
    for i, line in zip(starts[1:], lines[1:], strict=True):
        made = _if(is_past(i), line, made)
    if extrapolation == HOLD or goes_on or smoothness == CONSTANT:
        made = _if(is_past(x.size - 1), _beyond(x, y, slopes, -1, at) if goes_on else y[-1], made)
    return made


def _line(x: np.ndarray, y: Sequence[Scalar], i: int, at: Any, smoothness: int) -> Any:
    if smoothness == CONSTANT:
        return y[i]
    slope = v.divide(v.subtract(y[i + 1], y[i]), float(x[i + 1] - x[i]))
    return v.add(y[i], v.multiply(slope, at - float(x[i])))


def _cubic(x: np.ndarray, y: Sequence[Scalar], slopes: Sequence[ca.SX], i: int, at: Any) -> Any:
    """The cubic between rows i and i + 1 with the slopes there."""
    width, step = float(x[i + 1] - x[i]), at - float(x[i])
    low, mean = v.symbolic(y[i]), (v.symbolic(y[i + 1]) - v.symbolic(y[i])) / float(x[i + 1] - x[i])
    first, second = slopes[i], slopes[i + 1]
    square = (3 * mean - 2 * first - second) / width
    return low + step * (first + step * (square + step * (first + second - 2 * mean) / width**2))


def _beyond(x: np.ndarray, y: Sequence[Scalar], slopes: Sequence[ca.SX], end: int, at: Any) -> Any:
    """The straight line before the first row (`end` 0) or behind the last (-1): with the slope of the curve
    there, or through the two rows."""
    near = end + 1 if end == 0 else end - 1
    width = float(x[near] - x[end])
    mean = (v.symbolic(y[near]) - v.symbolic(y[end])) / width if width else ca.SX(0)
    return v.symbolic(y[end]) + (slopes[end] if slopes else mean) * (at - float(x[end]))


def _slopes(x: np.ndarray, y: Sequence[Scalar], smoothness: int) -> list[ca.SX]:
    """The slopes of a smooth curve at its rows (Akima 1970; Fritsch and Butland 1984; Steffen 1990). Raises
    ValueError where rows stand at one place."""
    widths = np.diff(x)
    if not np.all(widths > 0):
        raise ValueError(
            "a table with a smooth curve has two rows at one place: "
            "write smoothness = Modelica.Blocks.Types.Smoothness.LinearSegments"
        )
    means = [(v.symbolic(y[i + 1]) - v.symbolic(y[i])) / float(w) for i, w in enumerate(widths)]
    if len(means) == 1:
        return [means[0], means[0]]
    if smoothness in (AKIMA, MODIFIED_AKIMA):
        return _akima(means, smoothness == MODIFIED_AKIMA)
    rule = _fritsch_butland if smoothness == FRITSCH_BUTLAND else _steffen
    pairs = zip(pairwise(widths), pairwise(means), strict=True)
    inner = [ca.if_else(a * b > 0, rule(w, z, a, b), 0) for (w, z), (a, b) in pairs]
    return [means[0], *inner, means[-1]]


def _akima(means: list[ca.SX], is_modified: bool) -> list[ca.SX]:
    first, second, *_ = means
    last, before = means[-1], means[-2]
    d = [3 * first - 2 * second, 2 * first - second, *means, 2 * last - before, 3 * last - 2 * before]
    found = []
    for a, b, c, e in zip(d, d[1:], d[2:], d[3:], strict=False):
        left, right = ca.fabs(b - a), ca.fabs(e - c)
        if is_modified:
            left, right = left + ca.fabs(b + a) / 2, right + ca.fabs(e + c) / 2
        total = left + right
        weighted = (right * b + left * c) / ca.if_else(total > 0, total, 1)
        found.append(ca.if_else(total > 0, weighted, (b + c) / 2))
    return found


def _fritsch_butland(w: float, z: float, a: ca.SX, b: ca.SX) -> ca.SX:
    """The slope between two pieces of widths w and z whose mean slopes a and b have one sign."""
    return 3 * (w + z) * a * b / ((w + 2 * z) * b + (z + 2 * w) * a)


def _steffen(w: float, z: float, a: ca.SX, b: ca.SX) -> ca.SX:
    """As `_fritsch_butland`."""
    least = ca.fmin(ca.fabs(a), ca.fabs(b))
    return ca.sign(a) * ca.fmin(ca.fabs(a * z + b * w) / (w + z), 2 * least)


def _if(condition: Any, yes: Any, no: Any) -> Any:
    if isinstance(condition, ca.SX) and not condition.is_constant():
        return ca.if_else(condition, yes, no)
    return yes if bool(condition) else no


# Tables over two variables ---------------------------------------------------------------------------------


def _grid(table: Value) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The grids of u1 (n,) and u2 (m,), and the values between (n, m)."""
    assert isinstance(table, Record)
    matrix = _matrix(table.fields["table"])
    if min(matrix.shape) < 2:
        raise ValueError("a table over two variables needs two rows and two columns at least")
    return _abscissae(matrix[1:, 0], "column"), _abscissae(matrix[0, 1:], "row"), matrix[1:, 1:]


def _surface(table: Value, u1: Value, u2: Value) -> Value:
    """The value of a table at (u1, u2): along u2 in each row, then between the rows."""
    x1, x2, values = _grid(table)
    smoothness, extrapolation = _kinds(table)
    if smoothness not in (LINEAR, CONSTANT):
        raise ValueError("a smooth surface over two variables is not supported: write linear segments")
    if extrapolation == PERIODIC:
        raise ValueError("a table over two variables that repeats is not supported")

    def along(x: np.ndarray, y: Sequence[Scalar], at: Any) -> Any:
        return y[0] if x.size == 1 else _piece(x, y, at, lambda i: at >= x[i], smoothness, extrapolation)

    return along(x1, [along(x2, list(row), u2) for row in values], u1)


def _ends(table: Value, last: int) -> np.ndarray:
    """The first (`last` 0) or last (-1) abscissae of u1 and u2 (2,)."""
    x1, x2, _ = _grid(table)
    return np.array([float(x1[last]), float(x2[last])], dtype=object)


# Tables over time -------------------------------------------------------------------------------------------


def _clock(table: Value, time: Value) -> tuple[np.ndarray, Any, Any, Any]:
    """Instants of the rows; the time of the table; how much that is behind, and when the table begins."""
    assert isinstance(table, Record)
    knots, _ = _columns(table, 1)
    shift, start = (v.constant(table.fields[key]) for key in ("shiftTime", "startTime"))  # type: ignore[arg-type]
    return knots, v.subtract(time, shift), shift, start  # type: ignore[arg-type]


def _next_event(table: Value, time: Value) -> Value:
    """The next row behind an instant; they are the events of the table."""
    knots, t, shift, start = _clock(table, time)
    knots = np.unique(knots)
    width = float(knots[-1] - knots[0])
    made: Any = NEVER
    if _kinds(table)[1] == PERIODIC and width > 0:
        turn = ca.floor((t - knots[0]) / width + NEAR)
        local = t - width * turn
        made = knots[-1]
        for knot in knots[-2:0:-1]:
            made = ca.if_else(local < knot - NEAR * width, knot, made)
        made = made + width * turn + shift
    else:
        for knot in knots[::-1]:
            made = ca.if_else(t < knot - SAME * max(width, 1.0), knot + shift, made)
    return ca.if_else(time < start, start, made)


def _coefficients(
    table: Value, offset: Scalar, start: Scalar, time: Scalar, last: Scalar, eps: float, shift: Scalar
) -> tuple[Value, ...]:
    """Slope and intercept of the line of a TimeTable at an event, the next event, and the number of the row
    that ends the piece: `getInterpolationCoefficients` of the Standard Library, whose loop goes on from
    the row `last`. Rows stand in the order of time, so that it ends where one from the first row does."""
    if not isinstance(table, np.ndarray) or table.ndim != 2 or table.shape[0] == 0:
        raise ValueError("the table has no rows")
    x, y = ([v.symbolic(one) for one in column] for column in (table[:, 0], table[:, 1]))
    if any(v.constant(b < a) == 1.0 for a, b in pairwise(x) if (b < a).is_constant()):
        raise ValueError("the first column of a table must not decrease")
    now, base, begin, behind, row_before = map(v.symbolic, (time, offset, start, shift, last))
    slack = eps * ca.fabs(now)
    early = ca.vertcat(0, base, begin, row_before)
    if len(x) == 1:
        given = ca.vertcat(0, base + y[0], now - slack, row_before)
    else:
        lines = [_straight(x, y, row, eps) for row in range(1, len(x))]
        given = ca.vertcat(*lines[-1], now - slack, len(x))
        for row in range(len(x) - 2, -1, -1):
            here = ca.vertcat(*lines[max(row, 1) - 1], x[row] + behind, max(row, 1) + 1)
            given = ca.if_else(now + slack - behind < x[row], here, given)
        given[1] = given[1] + base - given[0] * behind
    chosen = ca.if_else(now + slack < begin, early, given)
    return tuple(chosen[i] for i in range(4))


def _straight(x: Sequence[ca.SX], y: Sequence[ca.SX], row: int, eps: float) -> tuple[ca.SX, ca.SX]:
    """Slope and intercept of the line that ends in a row; of a step, the value behind it."""
    width = x[row] - x[row - 1]
    is_step = width <= eps * ca.fabs(x[row])
    slope = ca.if_else(is_step, 0, (y[row] - y[row - 1]) / ca.if_else(is_step, 1, width))
    return slope, ca.if_else(is_step, y[row], y[row - 1] - slope * x[row - 1])


SAME = 1e-13  # share of a table's length by which an instant may miss a row


def _time_value(table: Value, column: Value, time: Value, following: Value, before: Value) -> Value:
    """The value at an instant, on the piece that ends with the `following` event: the piece does not change
    before the event does. Zero before the table begins."""
    knots, t, shift, start = _clock(table, time)
    _, y = _columns(table, column)
    smoothness, extrapolation = _kinds(table)
    if knots.size == 1:
        return y[0]
    end: Any = following - shift
    width = float(knots[-1] - knots[0])
    if extrapolation == PERIODIC and width > 0:
        turn = ca.ceil((end - knots[0]) / width - NEAR) - 1
        t, end = t - width * turn, end - width * turn
    made = _piece(knots, y, t, lambda i: end > knots[i] + NEAR * (width or 1.0), smoothness, extrapolation)
    # The event at the beginning ends the time before it.
    return ca.if_else(following <= start, 0.0, made)


_READERS: dict[str, Callable[..., Value]] = {
    "getTable1DValue": _value,
    "getTable1DValueNoDer": _value,
    "getTable1DValueNoDer2": _value,
    "getTable1DAbscissaUmin": lambda table: float(_columns(table, 1)[0][0]),
    "getTable1DAbscissaUmax": lambda table: float(_columns(table, 1)[0][-1]),
    "getTable2DValue": _surface,
    "getTable2DValueNoDer": _surface,
    "getTable2DValueNoDer2": _surface,
    "getTable2DAbscissaUmin": lambda table: _ends(table, 0),
    "getTable2DAbscissaUmax": lambda table: _ends(table, -1),
    "getTimeTableValue": _time_value,
    "getTimeTableValueNoDer": _time_value,
    "getTimeTableValueNoDer2": _time_value,
    "getTimeTableTmin": lambda table: float(_columns(table, 1)[0][0]),
    "getTimeTableTmax": lambda table: float(_columns(table, 1)[0][-1]),
    "getNextTimeEvent": _next_event,
}
