"""C code of functions over lanes, against CasADi's own values."""

import ctypes

import casadi as ca
import numpy as np
import pytest

from daest.numerics.compiler import build_shared, pointer, processor_flags, text_of
from daest.systems.simulation.lane_code import lane_function

N_POINTS = 16  # several blocks of lanes, whatever the processor
LOOP = """
void run(long n, const double *x, const double *p, double *out) {
  for (long first = 0; first < n; first += LANES) {
    lanes_t a[NX], r[NR];
    for (int l = 0; l < LANES; ++l)
      for (int i = 0; i < NX; ++i) a[i][l] = x[(first + l) * NX + i];
    lanes(a, p, r);
    for (int l = 0; l < LANES; ++l)
      for (int i = 0; i < NR; ++i) out[(first + l) * NR + i] = r[i][l];
  }
}
"""


def over_lanes(function, x, p):
    """Values (n_points, n_r) of the function (x, p) -> r by its code over lanes."""
    generator = ca.CodeGenerator("model.c")
    generator.add(function)
    sizes = f"#define NX {function.numel_in(0)}\n#define NR {function.numel_out(0)}\n"
    source = generator.dump() + text_of("lanes.c") + lane_function("lanes", function, (0,)) + sizes + LOOP
    flags = ("-O2", "-fno-math-errno", *processor_flags(widest=True))
    library = ctypes.CDLL(str(build_shared(source, "lanes", flags=flags)))
    out = np.empty((x.shape[0], function.numel_out(0)))
    library.run(ctypes.c_long(x.shape[0]), *map(pointer, (np.ascontiguousarray(x), p, out)))
    return out


def every_operation(x, p):
    a, b = x[0], x[1]
    inside = a / (1 + ca.fabs(a))
    return ca.vertcat(
        a + b, a - p, p * a, a / b, -a, a**2, a**3, 2 * a, 1 / b, ca.fabs(a) ** b, ca.exp(a), ca.tanh(a),
        ca.tanh(1e-9 * a), ca.log(ca.fabs(a)), ca.sqrt(ca.fabs(a)), ca.sin(a), ca.cos(a), ca.tan(a),
        ca.asin(inside), ca.acos(inside), ca.atan(a), ca.sinh(a), ca.cosh(a), ca.asinh(a),
        ca.acosh(1 + ca.fabs(a)), ca.atanh(inside), ca.erf(a), ca.log1p(ca.fabs(a)), ca.expm1(a),
        ca.floor(a), ca.ceil(a), ca.fabs(a),
        ca.sign(a), ca.sign(0 * a), a < b, a <= p, a == a, a != b, ca.logic_and(a > 0, b > 0),
        ca.logic_or(a > 0, b > 0), ca.logic_not(a > 0), ca.if_else(a > p, a, b), ca.if_else(p > 1, a, b),
        ca.fmin(a, b), ca.fmax(a, p), ca.atan2(a, b), ca.copysign(a, b), ca.hypot(a, b), ca.fmod(a, b), 7.5,
        ca.exp(p) * a, ca.tanh(p), ca.if_else(p > 1, 1, p),
    )  # fmt: skip


@pytest.fixture
def points():
    x = 3 * np.random.default_rng(0).standard_normal((N_POINTS, 2))
    x[0] = 0.0, 1.0
    return x


def test_every_operation(points):
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p")
    function = ca.Function("model", [x, p], [ca.densify(every_operation(x, p))])
    found = over_lanes(function, points, np.array([1.25]))
    known = np.array([function(point, 1.25).full().ravel() for point in points])
    np.testing.assert_allclose(found, known, rtol=4e-15, atol=1e-300)


def test_exponential_and_tanh_over_their_whole_range():
    x, p = ca.SX.sym("x"), ca.SX.sym("p")
    function = ca.Function("model", [x, p], [ca.vertcat(ca.exp(x), ca.tanh(x))])
    at = np.concatenate([np.linspace(-707, 708, 3001), np.logspace(-300, 1, 999)])
    at = np.concatenate([at, [-800.0, 800.0, np.nan, 0.0]])
    at = np.concatenate([at, np.zeros(-at.size % N_POINTS)])
    found = over_lanes(function, at[:, None], np.zeros(1))
    with np.errstate(over="ignore", under="ignore"):
        np.testing.assert_allclose(found[:, 0], np.exp(at), rtol=5e-16, atol=1e-307)
        np.testing.assert_allclose(found[:, 1], np.tanh(at), rtol=1e-15, atol=0)


def test_functions_that_are_no_scalar_operations_are_called_lane_by_lane(points):
    x, p = ca.MX.sym("x", 2), ca.MX.sym("p")
    matrix = ca.blockcat([[5 + x[0] ** 2, 1], [x[1], 4 + x[1] ** 2]])
    function = ca.Function("model", [x, p], [ca.densify(p * ca.solve(matrix, x))])
    found = over_lanes(function, points, np.array([2.0]))
    known = np.array([function(point, 2.0).full().ravel() for point in points])
    np.testing.assert_allclose(found, known, rtol=1e-14)
