"""Linearisation against finite differences of the residual, closed forms and the report's counts."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
import scipy.sparse as sp
from flat_models import SERVO, Draft, report_servo

from daest.errors import ConfigError, NumericalError
from daest.systems.linear.linearize import (
    MATRIX_NAMES,
    is_affine_model,
    linear_dae_function,
    linearize,
    operating_point,
    theta_entries,
)
from daest.systems.linear.state_space import state_space, state_space_family


def pendulum() -> Draft:
    m = Draft(
        "Pendulum",
        parameters={"m": 0.5, "l": 0.4, "g": 9.81, "d": 0.1},
        inputs=["u"],
        noises={"w": 1e-3},
        starts={"phi": 0.3},
    )
    m.unknowns += ["phi", "omega", "tau"]
    for text in (
        "der(phi) = omega",
        "m*l**2*der(omega) = tau - d*omega + u*cos(phi) + w*exp(omega)",
        "tau = -m*g*l*sin(phi)",
    ):
        m.equation(text)
    m.outputs = {"height": "l - l*cos(phi)", "torque": "tau + u"}
    return m


def residual_at(flat, derivatives, xi, u, w, theta=None):
    function = ca.Function(
        "F",
        [flat.derivatives, flat.xi, flat.u, flat.w, flat.theta, flat.time],
        [flat.residual, flat.output_expressions],
    )
    theta = flat.theta_values if theta is None else theta
    return [np.array(value).ravel() for value in function(derivatives, xi, u, w, theta, 0.0)]


def test_matrices_agree_with_finite_differences_of_the_residual():
    flat = pendulum().flat()
    at = {"phi": 0.7, "omega": -0.2, "tau": -0.4, "u": 0.1}
    dae = linearize(flat, at=at)
    point = operating_point(flat, at)
    args = [point.derivatives, point.xi, point.u, np.zeros(1)]
    step = 1e-6
    for position, (matrix, sign, output) in enumerate(
        [(dae.E, 1, None), (dae.J, -1, dae.C), (dae.K, -1, dae.D), (dae.B, -1, dae.H)]
    ):
        for column in range(len(args[position])):
            values = []
            for direction in (step, -step):
                moved = [a.copy() for a in args]
                moved[position][column] += direction
                values.append(residual_at(flat, *moved))
            slope_f, slope_h = ((up - down) / (2 * step) for up, down in zip(*values, strict=True))
            np.testing.assert_allclose(sign * matrix[:, column], slope_f, atol=1e-8)
            if output is not None:
                np.testing.assert_allclose(output[:, column], slope_h, atol=1e-8)


def test_offsets_make_the_linear_model_exact_at_the_operating_point():
    flat = pendulum().flat()
    at = {"phi": 0.7, "omega": -0.2, "tau": -0.4, "u": 0.1, "der(omega)": 2.0}
    dae = linearize(flat, at=at)
    point = operating_point(flat, at)
    F, h = residual_at(flat, point.derivatives, point.xi, point.u, np.zeros(1))
    linear = dae.E @ point.derivatives - dae.J @ point.xi - dae.K @ point.u - dae.offset
    np.testing.assert_allclose(linear, F, atol=1e-14)
    np.testing.assert_allclose(dae.C @ point.xi + dae.D @ point.u + dae.output_offset, h, atol=1e-14)


def test_nonlinear_model_without_operating_point_says_so():
    flat = pendulum().flat()
    dae = linearize(flat)
    assert not dae.is_affine
    assert any("start values" in note for note in dae.notes)
    assert dae.J[2, 0] == pytest.approx(-0.5 * 9.81 * 0.4 * np.cos(0.3))
    assert linearize(flat, at={"phi": 0.3}).notes == ()


def test_affine_model_does_not_depend_on_the_operating_point():
    flat = report_servo()
    dae, moved = linearize(flat), linearize(flat, at={"disc.phi": 3.0, "u": 2.0})
    assert dae.is_affine and is_affine_model(flat) and not is_affine_model(pendulum().flat())
    for name in ("E", "J", "K", "B", "C", "D", "H", "offset", "output_offset"):
        np.testing.assert_array_equal(getattr(dae, name), getattr(moved, name))


def test_counts_and_signs_of_the_servo():
    dae = linearize(report_servo())
    assert dae.E.shape == (54, 54)
    assert np.count_nonzero(dae.E) == 6
    row = [e.text for e in dae.equations].index("R*resistor.i = resistor.v")
    columns = {v.name: i for i, v in enumerate(dae.unknowns)}
    # E ξ' = J ξ and F = lhs - rhs, so J = -∂F/∂ξ.
    assert dae.J[row, columns["resistor.i"]] == -SERVO["R"]
    assert dae.J[row, columns["resistor.v"]] == 1.0
    source = [e.text for e in dae.equations].index("source.v = u")
    assert dae.K[source, 0] == 1.0 and np.count_nonzero(dae.K) == 1
    assert not np.any(dae.offset)


def test_constants_go_into_the_offset():
    m = Draft("Lift", parameters={"g": 9.81}, unknowns=["h", "v"], outputs={"y": "h + 2"})
    for text in ("der(h) = v", "der(v) = -g"):
        m.equation(text)
    dae = linearize(m.flat())
    assert dae.is_affine
    np.testing.assert_allclose(dae.offset, [0.0, -9.81])
    np.testing.assert_allclose(dae.output_offset, [2.0])


def test_coefficients_that_depend_on_time_are_not_affine():
    m = Draft("Drifting", unknowns=["x"])
    m.equation("der(x) = -time*x")
    dae = linearize(m.flat())
    assert not dae.is_affine
    assert any("t = 0 s" in note for note in dae.notes)


def test_matrices_at_a_time():
    m = Draft("Drifting", unknowns=["x"], parameters={"k": 3.0, "r": 0.1}, outputs={"y": "x*(1 + time)"})
    m.equation("der(x) = -k*(1 + r*time)*x")
    dae = linearize(m.flat(), at={"time": 5.0})
    np.testing.assert_allclose(dae.J, [[-4.5]])
    np.testing.assert_allclose(dae.C, [[6.0]])
    assert any("t = 5 s" in note for note in dae.notes)
    family = state_space_family(m.flat(), at={"time": 5.0})
    np.testing.assert_allclose(state_space(family, m.flat().theta_values).A, [[-4.5]])
    entry = next(e for e in theta_entries(m.flat(), {"time": 5.0}) if e.matrix == "J")
    assert entry.parameters == ("k", "r") and "5" in entry.expression


@pytest.mark.parametrize("step", [ca.sign, ca.floor, lambda x: ca.if_else(x > 0, 1.0, -1.0)])
def test_steps_are_not_affine(step):
    m = Draft("Step", unknowns=["x"], inputs=["u"], parameters={"k": 2.0})
    m.equation("der(x) = u - k*x")
    flat = m.flat()
    assert is_affine_model(flat)
    assert is_affine_model(replace(flat, residual=flat.residual * (2.0 + step(flat.theta))))
    for signal in (flat.xi, flat.u, flat.derivatives):
        assert not is_affine_model(replace(flat, residual=flat.residual + step(signal)))


def test_derivatives_in_theta_are_exact():
    flat = report_servo()
    function = linear_dae_function(flat)
    theta = flat.theta_values
    slope = function.factory("slope", ["theta"], ["jac:J:theta"])(theta)
    rng = np.random.default_rng(0)
    direction = rng.normal(size=theta.size) * theta
    step = 1e-3
    plus, minus = (function(theta + s * direction)[MATRIX_NAMES.index("J")].full() for s in (step, -step))
    want = (plus - minus) / (2 * step)  # J is affine in each parameter of the servo
    np.testing.assert_allclose((slope @ direction).full().reshape(54, 54, order="F"), want, atol=1e-9)


def test_theta_entries_are_in_model_names():
    entries = {(e.matrix, e.row, e.column): e for e in theta_entries(report_servo())}
    dae = linearize(report_servo())
    rows = [e.text for e in dae.equations]
    columns = [v.name for v in dae.unknowns]
    spring = entries["J", rows.index("spring.tau = c*spring.phi_rel"), columns.index("spring.phi_rel")]
    assert (spring.expression, spring.parameters) == ("c", ("c",))
    assert all(e.parameters for e in entries.values())
    nonlinear = theta_entries(pendulum().flat())
    inertia = next(e for e in nonlinear if e.matrix == "E" and e.parameters == ("l", "m"))
    l, m = 0.4, 0.5
    assert eval(inertia.expression, {"sq": lambda x: x * x, "l": l, "m": m}) == pytest.approx(m * l**2)


def test_theta_argument_replaces_the_values():
    flat = report_servo()
    theta = flat.theta_values * 2
    dae = linearize(flat, theta)
    assert [p.value for p in dae.parameters] == theta.tolist()
    assert np.max(np.abs(dae.J)) == 60.0  # the gear ratio, doubled


def test_large_models_are_sparse():
    m = Draft("Long")
    for i in range(600):
        m.unknowns.append(f"x{i}")
        m.equation(f"der(x{i}) = -x{i}")
    dae = linearize(m.flat())
    assert sp.issparse(dae.E) and dae.J.nnz == 600


def test_unknown_name_in_the_operating_point():
    with pytest.raises(ConfigError) as caught:
        linearize(pendulum().flat(), at={"psi": 1.0})
    assert caught.value.code == "operating-point-unknown-name"


def test_division_by_zero_names_the_equation():
    m = Draft("Root", unknowns=["x"])
    m.equation("der(x) = sqrt(x)")
    with pytest.raises(NumericalError) as caught:
        linearize(m.flat(), at={"x": 0.0})
    assert caught.value.code == "linearization-not-finite"
    assert "sqrt(x)" in caught.value.what and "Root.mo:1" in str(caught.value)


def compiled_text(text: str):
    from pathlib import Path

    from daest.modelica.compile import compile_text

    return compile_text(text.encode(), Path("M.mo"))


def test_what_nobody_reads_may_have_no_slope():
    linear = linearize(
        compiled_text(
            "model M\n  Real x(start = 0), z(start = 0);\n  Real size;\nequation\n  der(x) = -2*x;\n"
            "  der(z) = -z;\n  size = sqrt(x^2 + z^2);\nend M;\n"
        )
    )
    assert np.all(np.isfinite(linear.J))
    assert any("size" in note for note in linear.notes)


def test_what_somebody_reads_must_have_a_slope():
    with pytest.raises(NumericalError) as caught:
        linearize(
            compiled_text(
                "model M\n  Real x(start = 0), z(start = 0);\n  Real size;\nequation\n"
                "  der(x) = -2*x + size;\n  der(z) = -z;\n  size = sqrt(x^2 + z^2);\nend M;\n"
            )
        )
    assert caught.value.code == "linearization-not-finite"


def test_small_constants_are_no_zeros_at_the_operating_point():
    linear = linearize(
        compiled_text(
            "model M\n  Real x(start = 0);\n  Real least = 2e-14;\n  Real y;\nequation\n"
            "  der(x) = -x*abs(x) + y;\n  y = x/least;\nend M;\n"
        )
    )
    assert np.abs(linear.J).max() == pytest.approx(1 / 2e-14)


def test_where_start_values_leave_out_a_constraint_the_start_of_the_simulation_is_taken():
    """a = b + 1 holds from the start on, which the start values do not say: 1/d would be infinite."""
    m = Draft("Tied", starts={"b": 0.0})
    m.unknowns += ["a", "b", "v", "d", "e"]
    for text in ("a = b + 1", "der(a) = v", "der(b) = -e", "d = a - b", "e = (a + b)/d"):
        m.equation(text)
    found = linearize(m.flat())
    assert any("where its simulation begins" in note for note in found.notes)
    row = [equation.text for equation in found.equations].index("e = (a + b)/d")
    names = [x.name for x in found.unknowns]
    assert np.asarray(found.J)[row, names.index("d")] == pytest.approx(-1.0)  # -(a + b)/d^2 at 1, 0


@pytest.mark.parametrize(
    ("law", "at", "is_told"),
    [
        ("sign(a - b)*sqrt(abs(a - b))", None, True),
        ("sign(a - b)*sqrt(abs(a - b))", {"a": 1.2}, False),
        ("(a - b)*abs(a - b)", None, False),
        ("(a - 1)*sqrt(abs(a - b))", None, False),  # the slope over b falls to zero along both
    ],
)
def test_a_slope_that_is_infinite_at_the_start_values_is_told(law, at, is_told):
    """Two tanks that start at one level seem to be apart: the slope of the root counts as zero."""
    text = (
        "model M\n  input Real u;\n  Real a(start = 1);\n  Real b(start = 1);\n  Real q;\nequation\n"
        f"  q = {law};\n  der(a) = u - q;\n  der(b) = q - 0.1*b;\nend M;\n"
    )
    notes = [note for note in linearize(compiled_text(text), at=at).notes if "no finite slope" in note]
    assert len(notes) == is_told
    assert all("over a, b at the start values" in note for note in notes)
