"""Tables whose rows stand in the model, against numpy.interp."""

from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scipy.interpolate import Akima1DInterpolator, PchipInterpolator

from daest.modelica.compile import compile_text
from daest.modelica.flat import tables
from daest.modelica.language.table_files import Folders
from daest.modelica.language.values import from_flat
from daest.systems.simulation.simulate import simulate


def called(name: str, arguments):
    """The one result of a function that reads no file."""
    return tables.results(name, arguments, Folders())[0]


ROWS = [(0.0, 1.0), (1.0, 3.0), (1.0, 0.0), (2.5, 2.0)]


def table(name: str, smoothness: int = tables.LINEAR, extrapolation: int = tables.LAST, **more: float):
    rows = from_flat([x for row in ROWS for x in row], (4, 2))
    columns = from_flat([2], (1,))
    if name == "ExternalCombiTable1D":
        given = ["NoName", "NoName", rows, columns, smoothness, extrapolation]
    else:
        given = ["NoName", "NoName", rows, more.get("start", 0.0), columns, smoothness, extrapolation]
        given.append(more.get("shift", 0.0))
    return called(f"Modelica.Blocks.Types.{name}_constructor", given)


def at(function: str, made, points: np.ndarray) -> np.ndarray:
    u = ca.SX.sym("u")
    value = called(function, [made, 1, u])
    return ca.Function("value", [u], [value])(points[None, :]).full().ravel()


def exact(u: np.ndarray) -> np.ndarray:
    first, second = 1 + 2 * u, (u - 1) * 2 / 1.5
    return np.where(u < 1, first, second)


def test_straight_lines_that_go_on():
    u = np.array([-1.0, 0.0, 0.4, 0.999, 1.001, 2.5, 4.0])
    assert at("getTable1DValue", table("ExternalCombiTable1D"), u) == pytest.approx(exact(u))


def test_values_that_stay():
    made = table("ExternalCombiTable1D", extrapolation=tables.HOLD)
    assert at("getTable1DValue", made, np.array([-3.0, 0.5, 9.0])) == pytest.approx([1, 2, 2])


def test_steps():
    """Outside of the rows the library goes on through the first two and the last two of them."""
    made = table("ExternalCombiTable1D", smoothness=tables.CONSTANT)
    assert at("getTable1DValue", made, np.array([-1, 0.5, 1.5, 2.5, 4])) == pytest.approx([-1, 1, 0, 2, 4])
    made = table("ExternalCombiTable1D", smoothness=tables.CONSTANT, extrapolation=tables.HOLD)
    assert at("getTable1DValue", made, np.array([-1, 0.5, 3])) == pytest.approx([1, 1, 2])


X = np.array([-1.0, 0.0, 0.5, 2.0, 2.7, 4.0, 4.5, 6.0])
Y = np.array([0.0, 0.2, 0.2, 0.2, 3.0, 4.0, 3.5, -1.0])
INSIDE = np.linspace(-1, 6, 141)


def smooth(kind: int, extrapolation: int = tables.LAST) -> np.ndarray:
    rows, columns = from_flat(list(np.c_[X, Y].ravel()), (X.size, 2)), from_flat([2], (1,))
    given = ["NoName", "NoName", rows, columns, kind, extrapolation]
    return called("Modelica.Blocks.Types.ExternalCombiTable1D_constructor", given)


@pytest.mark.parametrize(("kind", "method"), [(tables.AKIMA, "akima"), (tables.MODIFIED_AKIMA, "makima")])
def test_smooth_curves_are_those_of_scipy(kind, method):
    known = Akima1DInterpolator(X, Y, method=method)
    assert at("getTable1DValue", smooth(kind), INSIDE) == pytest.approx(known(INSIDE), abs=1e-12)
    slope = known.derivative()(X[[0, -1]])
    outside = at("getTable1DValue", smooth(kind), np.array([-3.0, 7.0]))
    assert outside == pytest.approx([Y[0] - 2 * slope[0], Y[-1] + slope[1]])
    stays = at("getTable1DValue", smooth(kind, tables.HOLD), np.array([-3.0, 7.0]))
    assert stays == pytest.approx(Y[[0, -1]])


def test_a_monotone_curve_is_that_of_scipy_between_its_end_pieces():
    """The library takes the first and the last mean slope at the ends, scipy a parabola."""
    known = PchipInterpolator(X, Y)
    inner = INSIDE[(X[1] < INSIDE) & (X[-2] > INSIDE)]
    assert at("getTable1DValue", smooth(tables.FRITSCH_BUTLAND), inner) == pytest.approx(known(inner))
    ends = at("getTable1DValue", smooth(tables.FRITSCH_BUTLAND), np.array([-2.0, 7.0]))
    assert ends == pytest.approx([Y[0] - 0.2, Y[-1] - 3.0])


def test_a_curve_of_steffen_by_hand():
    """Slopes at 2.7: mean 4 and 1/1.3, twice the smaller one; at 4: zero."""
    value = at("getTable1DValue", smooth(tables.STEFFEN), np.array([3.35]))
    first, mean, width = 2 / 1.3, 1 / 1.3, 1.3
    weighted = (4 * width + mean * 0.7) / (width + 0.7)
    assert weighted > first
    by_hand = 0.5 * (3.0 + 4.0) + width / 8 * (first - 0.0)  # the middle of a cubic with its end slopes
    assert value == pytest.approx([by_hand])


def test_a_smooth_curve_over_a_step_is_refused():
    with pytest.raises(ValueError, match="LinearSegments"):
        at("getTable1DValue", table("ExternalCombiTable1D", smoothness=2), np.zeros(1))


def walked(made, until: float) -> list[tuple[float, float]]:
    """Instants and values of a table over time, from event to event: at its end, then just behind it."""
    t, following, value = ca.SX.sym("t"), ca.SX.sym("next"), []
    after = ca.Function("next", [t], [called("getNextTimeEvent", [made, t])])
    reading = called("getTimeTableValue", [made, 1, t, following, following])
    read = ca.Function("read", [t, following], [reading])
    now = 0.0
    while now < until:
        end = float(after(now))
        for instant in (now, min(end, until)):
            value.append((instant, float(read(instant, end))))
        now = end
    return value


def test_rows_over_time_are_events():
    found = walked(table("ExternalCombiTimeTable"), 2.5)
    assert np.array(found) == pytest.approx(np.array([(0, 1), (1, 3), (1, 0), (2.5, 2)]))


def test_a_table_repeats():
    made = table("ExternalCombiTimeTable", extrapolation=tables.PERIODIC)
    once = [(0, 1), (1, 3), (1, 0), (2.5, 2)]
    twice = [*once, *((t + 2.5, y) for t, y in once)]
    assert np.array(walked(made, 5.0)) == pytest.approx(np.array(twice))


def test_a_table_begins_later():
    made = table("ExternalCombiTimeTable", start=0.5, shift=0.5)
    exact = np.array([(0, 0), (0.5, 0), (0.5, 1), (1.5, 3)])
    assert np.array(walked(made, 1.5)) == pytest.approx(exact)


@pytest.mark.parametrize("extrapolation", [tables.HOLD, tables.LAST, tables.PERIODIC])
def test_rows_at_one_place_are_a_step(extrapolation):
    rows, columns = from_flat([20.0, 0.0, 20.0, 1.0], (2, 2)), from_flat([2], (1,))
    given = ["NoName", "NoName", rows, columns, tables.CONSTANT, extrapolation]
    made = called("Modelica.Blocks.Types.ExternalCombiTable1D_constructor", given)
    assert at("getTable1DValue", made, np.array([0.0, 19.9, 20.0, 30.0])) == pytest.approx([0, 0, 1, 1])


def test_a_time_table_of_one_instant_steps_at_its_event():
    rows, columns = from_flat([20.0, 0.0, 20.0, 1.0], (2, 2)), from_flat([2], (1,))
    given = ["NoName", "NoName", rows, 0.0, columns, tables.CONSTANT, tables.HOLD, 0.0]
    made = called("Modelica.Blocks.Types.ExternalCombiTimeTable_constructor", given)
    t = ca.SX.sym("t")
    following = called("getNextTimeEvent", [made, t])
    values = [called("getTimeTableValue", [made, 1, t, f, 0.0]) for f in (20.0, following)]
    both = ca.Function("both", [t], [following, *values])
    assert [float(one) for one in both(5.0)] == [20.0, 0.0, 0.0]
    assert float(both(20.5)[2]) == 1.0


LIBRARY = """package Modelica package Blocks package Sources block TimeTable
  function getInterpolationCoefficients input Real table[:, 2]; input Real offset; input Real start;
    input Real t; input Integer last; input Real eps; input Real shift;
    output Real a; output Real b; output Real following; output Integer next;
  algorithm next := last; a := 0; b := 0; following := 0;
    while next < size(table, 1) and t >= table[next, 1] loop next := next + 1; end while;
  end getInterpolationCoefficients;
  parameter Real table[:, 2] = [0, 1; 1, 3; 1, 0; 2.5, 2]; parameter Real offset = 0.5;
  parameter Real startTime = 0.2; parameter Real shiftTime = 0.1; parameter Real timeScale = 1;
  Real y; discrete Real a; discrete Real b; Integer last(start = 1);
  discrete Real nextEvent(start = 0, fixed = true); discrete Real nextScaled(start = 0, fixed = true);
algorithm
  when {time >= pre(nextEvent), initial()} then
    (a, b, nextScaled, last) := getInterpolationCoefficients(table, offset, startTime/timeScale,
      time/timeScale, last, 1e-13, shiftTime/timeScale);
    nextEvent := nextScaled*timeScale;
  end when;
equation y = a*time/timeScale + b; end TimeTable; end Sources; end Blocks;
model M Blocks.Sources.TimeTable table(timeScale = 2); Real x(start = 0, fixed = true);
equation der(x) = table.y; end M; end Modelica;"""


def test_a_time_table_of_the_library_against_straight_lines():
    """Its loop over rows, which ends where time tells, is replaced by a formula: scaled by 2, shifted by 0.1,
    zero before 0.2, lines that go on behind the last row."""
    flat = compile_text(LIBRARY.encode(), Path("Modelica.mo"), "Modelica.M")
    t = np.linspace(0, 7, 141) + 0.003
    made = simulate(flat, (np.r_[0.0, t], np.zeros((t.size + 1, 0))), rtol=1e-10)
    y = made.variables[1:, list(made.variable_names).index("table.y")]
    expected = np.where(t < 0.2, 0.5, 0.5 + exact((t - 0.1) / 2))
    assert y == pytest.approx(expected, abs=1e-9)


def test_a_time_table_whose_rows_go_back_is_refused():
    rows = from_flat([0.0, 1.0, 2.0, 3.0, 1.0, 0.0], (3, 2))
    name = "Modelica.Blocks.Sources.TimeTable.getInterpolationCoefficients"
    with pytest.raises(ValueError, match="must not decrease"):
        tables.results(name, [rows, 0.0, 0.0, ca.SX.sym("t"), 1, 1e-13, 0.0], Folders())
