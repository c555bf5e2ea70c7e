"""Compiling: the report's servo, inputs, outputs, noises, parameters, start values."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
import scipy.linalg

from daest.errors import ModelError
from daest.model.flat import FlatModel
from daest.modelica.compile import compile_model

MODELS = Path(__file__).parent / "models"
Compile = Callable[..., FlatModel]


@pytest.fixture(scope="module")
def servo() -> FlatModel:
    return compile_model(MODELS / "Servo54.mo")


def _matrices(flat: FlatModel) -> tuple[np.ndarray, np.ndarray]:
    theta = flat.theta_values
    residual = [ca.jacobian(flat.residual, variables) for variables in (flat.derivatives, flat.xi)]
    E, F = (ca.Function("f", [flat.theta], [matrix])(theta).full() for matrix in residual)
    return E, -F


def test_the_servo_of_components_has_54_equations_with_or_without_named_outputs(
    servo: FlatModel, compiled: Compile
) -> None:
    assert servo.n == 54
    text = (MODELS / "Servo54.mo").read_text()
    lines = [line for line in text.splitlines() if not line.strip().startswith("output")]
    without = compiled("\n".join(lines), "Servo54.Servo")
    assert without.n == 54
    assert without.outputs == ()


def test_the_servo_has_four_modes_that_are_those_of_its_physics(servo: FlatModel) -> None:
    """Finite eigenvalues against the 4-state model written by hand (angles before and after the spring)."""
    E, J = _matrices(servo)
    alpha, beta = scipy.linalg.eigvals(J, E, homogeneous_eigvals=True)
    # Eigenvalues beyond 1e5/s are infinite ones scattered by rounding: the motor's own pole is near -260/s.
    is_finite = np.abs(alpha) < 1e5 * np.abs(beta)
    finite = alpha[is_finite] / beta[is_finite]
    k, R, n, J1, J2, c, d = 0.06, 4.6, 30.0, 3.0e-6, 3.66e-4, 0.0362, 5.43e-4
    inertia = J1 * n**2
    A = np.array(
        [
            [0, 1, 0, 0],
            [-c / inertia, -(d + (k * n) ** 2 / R) / inertia, c / inertia, d / inertia],
            [0, 0, 0, 1],
            [c / J2, d / J2, -c / J2, -d / J2],
        ]
    )
    expected = np.linalg.eigvals(A)
    assert finite.shape == (4,)
    # The same polynomial: a comparison that needs no order of the eigenvalues.
    np.testing.assert_allclose(np.poly(finite), np.poly(expected), rtol=1e-9, atol=1e-6)


def test_equations_tell_text_origin_kind_and_place(servo: FlatModel) -> None:
    by_text = {equation.text: equation for equation in servo.equations}
    own = by_text["motor.J*motor.a = motor.flange_a.tau + motor.flange_b.tau"]
    assert (own.kind, own.origin) == ("component", "motor")
    source = (MODELS / "Servo54.mo").read_text().splitlines()
    assert own.place is not None and own.place.line is not None
    assert source[own.place.line - 1].strip() == "J*a = flange_a.tau + flange_b.tau;"
    flow = by_text["emf.flange.tau + motor.flange_a.tau = 0"]
    angles = by_text["emf.flange.phi = motor.flange_a.phi"]
    for equation, kind in ((flow, "flow"), (angles, "connection")):
        assert (equation.kind, equation.origin) == (kind, "emf.flange, motor.flange_a")
        assert equation.place is not None and equation.place.line is not None
        assert source[equation.place.line - 1].strip() == "connect(emf.flange, motor.flange_a);"
    assert by_text["disc.flange_b.tau = 0"].kind == "unconnected"
    assert by_text["source.v = u"].kind == "component"


def test_parameters_bounds_annotations_and_derived_ones(servo: FlatModel) -> None:
    parameters = {p.name: p for p in servo.parameters}
    assert list(parameters) == ["J1", "resistor.R", "emf.k", "disc.J", "gear.ratio", "spring.c", "damper.d"]
    assert parameters["J1"].estimate and parameters["J1"].scale == "log"
    assert not parameters["disc.J"].estimate
    assert parameters["disc.J"].min == 0 and parameters["disc.J"].unit == "kg.m2"
    assert [(p.name, p.expression) for p in servo.derived_parameters] == [("motor.J", "J1")]
    value = ca.Function("f", [servo.theta], [servo.derived_values])(servo.theta_values)
    assert float(value) == 3.0e-6


def test_outputs_that_name_an_expression_are_no_unknowns(servo: FlatModel) -> None:
    assert [y.name for y in servo.outputs] == ["omega", "phi"]
    assert not {"omega", "phi"} & {x.name for x in servo.unknowns}
    values = np.arange(1.0, servo.n + 1)
    h = ca.Function("h", [servo.xi], [servo.output_expressions])(values).full().ravel()
    index = {x.name: i for i, x in enumerate(servo.unknowns)}
    assert h[0] == pytest.approx(values[index["motor.w"]] / 30)
    assert h[1] == values[index["disc.phi"]]


def test_an_output_that_the_model_needs_stays_an_unknown(compiled: Compile) -> None:
    flat = compiled(
        "model M output Real x(start = 1), y, z, v; equation der(x) = -y; y = 2*x; 3*z = x; v = der(x); "
        "end M;"
    )
    # x is differentiated, y occurs twice, z has the coefficient 3, v would name a derivative.
    assert [v.name for v in flat.unknowns] == ["x", "y", "z", "v"]
    assert [o.name for o in flat.outputs] == ["x", "y", "z", "v"]
    assert str(flat.output_expressions) == "[x, y, z, v]"


@pytest.mark.slow
def test_speed_of_the_servo() -> None:
    """Expression building included; the best of three, for other programs may be running."""
    seconds = []
    for _ in range(3):
        start = time.perf_counter()
        compile_model(MODELS / "Servo54.mo")
        seconds.append(time.perf_counter() - start)
    assert min(seconds) < 0.3


@pytest.mark.slow
def test_large_arrays_grow_linearly(compiled: Compile) -> None:
    text = (
        "model N parameter Integer n = 100; Real x[n](each start = 1), y[n]; equation y = 3*x + x;"
        " for i in 1:n loop der(x[i]) = if i == 1 then -y[i] else x[i-1] - x[i]; end for; end N;"
    )
    seconds = {}
    for n in (200, 1600):
        start = time.perf_counter()
        assert compiled(text, overrides={"n": n}).n == 2 * n
        seconds[n] = time.perf_counter() - start
    # 8 times the size in quadratic time would take 64 times as long.
    assert seconds[1600] < 24 * seconds[200]


def test_loops_whose_inner_rows_the_compiler_leaves_out(compiled: Compile) -> None:
    """rumoca gives placeholders for the inner points of a loop; every row must be the written one."""
    flat = compiled(
        "model M parameter Integer n = 7; Real x[n]; equation"
        " for i in 1:n loop der(x[i]) = i*(if i > 1 then x[i-1] else time) - x[i]^2; end for; end M;"
    )
    assert [e.text for e in flat.equations][4] == "der(x[5]) = 5*x[4] - x[5]^2"
    x, slope, t = np.linspace(1, 2, 7), np.linspace(-1, 1, 7), 0.3
    residual = ca.Function("r", [flat.derivatives, flat.xi, flat.time], [flat.residual])
    before = np.concatenate([[t], x[:-1]])
    expected = slope - (np.arange(1, 8) * before - x**2)
    np.testing.assert_allclose(residual(slope, x, t).full().ravel(), expected, rtol=1e-14)


def test_noise_inputs_in_components_with_and_without_default(compiled: Compile) -> None:
    text = """model M
      connector F Real phi; flow Real tau(unit="N.m"); end F;
      model Noise F flange; parameter Real intensity = 1e-3;
        input Real w(unit="N.m", start=0)%s annotation(__Daest(noise=true, intensity=2*intensity,
        estimate=true));
      equation flange.tau = -w; end Noise;
      model Inertia F flange; parameter Real J=1; Real w; equation w=der(flange.phi); J*der(w)=flange.tau;
      end Inertia;
      Inertia i; Noise a, b(intensity = 5); input Real v annotation(__Daest(noise = true, intensity = 0.25));
      Real x(start = 0, fixed = true);
    equation connect(i.flange, a.flange); connect(i.flange, b.flange); der(x) = -x + v; end M;"""
    for default in ("", " = 0"):
        flat = compiled(text % default)
        noises = [(w.name, w.intensity, w.estimate, w.unit) for w in flat.noises]
        assert noises == [
            ("a.w", 2e-3, True, "N.m"),
            ("b.w", 10.0, True, "N.m"),
            ("v", 0.25, False, ""),
        ]
        assert flat.inputs == ()
        slope = ca.Function(
            "f", [flat.derivatives, flat.xi, flat.w, flat.theta], [ca.jacobian(flat.residual, flat.w)]
        )
        assert slope.sparsity_out(0).nnz() == 3


def test_parameter_sorting(compiled: Compile) -> None:
    flat = compiled(
        """model M
        parameter Real a = 2, b = a^2; final parameter Real c = 3; final parameter Real d = a + 1;
        constant Real g = 9.81; parameter Real tab[3] = {1, a, 3}; parameter Integer n = 2;
        parameter Real e = 2*n; parameter Real L = 4; parameter Integer m = integer(L/2);
        Real x[m](start = {b, 2}, each fixed = true), y(start = 7, fixed = true);
        equation for i in 1:m loop der(x[i]) = -b*c*d*g*tab[i]; end for; der(y) = -e*y*L; end M;"""
    )
    assert {p.name: p.value for p in flat.parameters} == {"a": 2, "tab[1]": 1, "tab[3]": 3, "e": 4}
    derived = {p.name: p.expression for p in flat.derived_parameters}
    assert derived == {"b": "a^2", "d": "a + 1", "tab[2]": "a"}
    # L decides the size of x, so it is a number in the equations; a start that depends on a is an initial
    # equation.
    assert [(x.name, x.start, x.fixed) for x in flat.unknowns] == [
        ("x[1]", 4.0, False),
        ("x[2]", 2.0, True),
        ("y", 7.0, True),
    ]
    initial = ca.Function("i", [flat.xi, flat.theta], [flat.initial_residual])
    assert [e.text for e in flat.initial_equations] == ["x[1] = {b, 2}"]
    assert float(initial([10, 0, 0], [3, 1, 3, 4])) == pytest.approx(10 - 3**2)
    residual = ca.Function("r", [flat.derivatives, flat.xi, flat.theta], [flat.residual])
    values = residual([0, 0, 0], [0, 0, 5], [3, 1, 3, 4]).full().ravel()
    np.testing.assert_allclose(values, [9 * 3 * 4 * 9.81 * 1, 9 * 3 * 4 * 9.81 * 3, 4 * 5 * 4])


def test_overrides_of_tunable_and_structural_parameters(compiled: Compile) -> None:
    text = """model M model A parameter Integer n = 1; parameter Real k = 1; Real x[n](each start = 1);
      equation der(x) = -k*x; end A; A a(n = 2); parameter Boolean on = true; Real y;
      equation y = if on then sum(a.x) else 0; end M;"""
    flat = compiled(text, overrides={"a.n": 4, "a.k": 3.5, "on": 0})
    assert [x.name for x in flat.unknowns] == ["a.x[1]", "a.x[2]", "a.x[3]", "a.x[4]", "y"]
    assert {p.name: p.value for p in flat.parameters} == {"a.k": 3.5}
    assert flat.equations[-1].text == "y = 0"


def test_connector_inputs_and_array_inputs_and_outputs(compiled: Compile) -> None:
    flat = compiled(
        """model M connector RealInput = input Real; connector RealOutput = output Real;
        RealInput u[2](each unit = "V"); RealOutput y[2](each unit = "m"); Real x(start = 0, fixed = true);
        equation der(x) = u[1] - x; y = {x, 2*x + u[2]}; end M;"""
    )
    assert [(u.name, u.unit) for u in flat.inputs] == [("u[1]", "V"), ("u[2]", "V")]
    assert [(y.name, y.unit) for y in flat.outputs] == [("y[1]", "m"), ("y[2]", "m")]
    assert flat.n == 1
    h = ca.Function("h", [flat.xi, flat.u], [flat.output_expressions])(3.0, [1.0, 0.5])
    np.testing.assert_array_equal(h.full().ravel(), [3.0, 6.5])


def test_byte_order_mark_and_windows_line_ends(compiled: Compile) -> None:
    text = b"\xef\xbb\xbfmodel M\r\n  Real x(start = 1);\r\nequation\r\n  der(x) = -x;\r\nend M;\r\n"
    flat = compiled(text)
    place = flat.equations[0].place
    assert place is not None and (place.line, place.column) == (4, 3)


def test_neighbouring_files_disturb_only_where_they_are_needed(tmp_path: Path) -> None:
    (tmp_path / "A.mo").write_text("model A Real x(start = 1); equation der(x) = -x; end A;")
    (tmp_path / "Copy.mo").write_text("model A Real x(start = 1); equation der(x) = -3*x; end A;")
    assert compile_model(tmp_path / "A.mo").equations[0].text == "der(x) = -x"
    (tmp_path / "Copy.mo").unlink()
    (tmp_path / "B.mo").write_text("model B A a; end B;")
    assert compile_model(tmp_path / "B.mo").equations[0].text == "der(a.x) = -a.x"


def test_a_file_of_a_package_folder_and_libraries(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "lib" / "Pk"
    package.mkdir(parents=True)
    (package / "package.mo").write_text("within ;\npackage Pk\nend Pk;\n")
    (package / "A.mo").write_text(
        "within Pk;\nmodel A\n  Real x(start = 1);\nequation\n  der(x) = -x;\nend A;\n"
    )
    (package / "B.mo").write_text("within Pk;\nmodel B\n  A a;\nend B;\n")
    inside = compile_model(package / "B.mo")
    assert inside.name == "Pk.B"
    user = tmp_path / "User.mo"
    user.write_text("model User\n  Pk.B b;\nend User;\n")
    flat = compile_model(user, libraries=[tmp_path / "lib"])
    place = flat.equations[0].place
    assert place is not None and Path(place.file).name == "A.mo" and place.line == 5
    monkeypatch.setenv("MODELICAPATH", str(tmp_path / "lib"))
    assert compile_model(user).n == 1


def test_initial_equations(compiled: Compile) -> None:
    flat = compiled(
        "model M Real x(start = 1), z; output Real y = 2*x; initial equation x = 3*z; y = 4; equation"
        " der(x) = -x; z = x^2; end M;"
    )
    assert [e.text for e in flat.initial_equations] == ["x = 3*z", "y = 4"]
    initial = ca.Function("i", [flat.xi], [flat.initial_residual])
    np.testing.assert_allclose(initial([5.0, 1.0]).full().ravel(), [5 - 3, 10 - 4])


def test_a_parameter_without_value_takes_its_start_with_a_warning(compiled: Compile) -> None:
    with pytest.warns(UserWarning, match="`q` has no value"):
        flat = compiled("model M parameter Real q(start = 3); Real x; equation x = q; end M;")
    assert flat.parameters[0].value == 3


def test_a_literal_and_a_constant_by_import(compiled):
    """The compiler does not find a literal of an enumeration by its import."""
    flat = compiled(
        """package P
  type Init = enumeration(fixed, free);
  constant Real g = 9.81;
  model Part
    parameter Init init = Init.free;
    parameter Real start = if init == Init.fixed then 2 else 3;
    Real x(start = start, fixed = true);
  equation
    der(x) = -x;
  end Part;
  model M
    import P.Init.fixed;
    import P.g;
    Part p(init=fixed);
    Real y = 2*g;
  end M;
end P;
""",
        "P.M",
    )
    assert {x.name: x.start for x in flat.unknowns}["p.x"] == 2


def test_a_name_with_an_umlaut_is_shown(compiled):
    with pytest.raises(ModelError) as caught:
        compiled("model M\n  Real größe;\nequation\n  größe = 1;\nend M;\n")
    assert str(caught.value.where).endswith(":2:10")
    assert "outside of ASCII" in caught.value.what
