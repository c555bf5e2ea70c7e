"""Laws of the library at inputs: compiled and in Python, against the law written into the equation."""

import casadi as ca
import numpy as np
import pytest
from ball_fmu import ball
from scipy.integrate import solve_ivp

from daest.errors import ModelError
from daest.fmu import binary_form
from daest.fmu.binary_model import binary_model
from daest.fmu.drive import STEPS, Law
from daest.fmu.outside import input_law, program_of, sensor_fault
from daest.modelica.effects.catalogue import effect_library, find_effect
from daest.systems.events.integration import Run
from daest.systems.tolerances import SOLVER

TIME = np.linspace(0.0, 2.0, 41)
FORCE = 9.81 + 3.0 * np.sin(3.0 * TIME)
COLUMN = np.cos(5.0 * TIME)
STEP = 1e-2  # relative; the trajectories are good to 1e-7
SIZE = 0.4
# What the classes say, written once more: v is what is read, s the size, m the largest magnitude of v.
FORMULAS = {
    "ConstantLoad": lambda v, s, m: -s,
    "CoulombFriction": lambda v, s, m: -s * np.tanh(v / (0.01 * m)),
    "ViscousFriction": lambda v, s, m: -s * v,
    "QuadraticDrag": lambda v, s, m: -s * v * np.sqrt(v**2 + (0.01 * m) ** 2),
    "HardeningSpring": lambda v, s, m: -s * v**3,
    "Unbalance": lambda v, s, m: -s * np.sin(v),
    "MeasuredInput": lambda v, s, m: s * v,
    "DeadZone": lambda v, s, m: (np.hypot(v - s / 2, 0.01 * m) - np.hypot(v + s / 2, 0.01 * m)) / 2,
    "Saturation": lambda v, s, m: (
        -(2 * v + np.hypot(v - m + s, 0.01 * m) - np.hypot(v + m - s, 0.01 * m)) / 2
    ),
}
LARGEST = 1.0


def of_name(name):
    return input_law(next(e for e in effect_library() if e.name == name and e.outside))


def along(name, size, reads):
    """h(t) with the law in the equation, by an independent integrator, straight between the samples."""

    def rate(t, x):
        read = x[1] if reads == "state" else np.interp(t, TIME, COLUMN)
        added = FORMULAS[name](read, size, LARGEST)
        return [x[1], -9.81 - 0.1 * x[1] * abs(x[1]) + np.interp(t, TIME, FORCE) + added]

    options = {"method": "DOP853", "rtol": 1e-10, "atol": 1e-12, "max_step": 0.05}
    return solve_ivp(rate, (0.0, 2.0), [1.0, 0.0], t_eval=TIME, **options).y[0]


@pytest.fixture(scope="module")
def flat(tmp_path_factory):
    """The falling ball."""
    return binary_model(ball(tmp_path_factory.mktemp("ball")))


def followed(flat, name, size, by_size):
    law = of_name(name)
    u = np.column_stack([FORCE, COLUMN])
    column = 1 if law.reads in ("recorded", "signal") else None
    reads = 1 if law.reads == "state" else None
    laws = (Law(program_of(law.function(LARGEST)), 0, reads, column, size),)
    theta, x0, scale, rtol = np.array([0.1, 0.7, 9.81]), np.array([1.0, 0.0]), np.ones(2), SOLVER.search_rtol
    atol = rtol * SOLVER.atol_of_scale * scale
    directions = 4 if by_size else 0
    run = Run(
        TIME, u[:-1], u[1:], u[-1], None, theta, x0, directions, 1, 0, rtol, atol, scale, None, 10_000, None
    )  # fmt: skip
    steps = np.array([STEP * size])
    found = flat.form.integrate(flat, ("d",), run, laws=laws, size_steps=steps)
    return flat.form.method, found


# Every second one, and by the interpreter one: what differs there is the loop around it.
COMPILED = [
    pytest.param(name, compiled, marks=pytest.mark.slow if i % 2 or (i and not compiled) else ())
    for i, name in enumerate(FORMULAS)
    for compiled in (True, False)
]


@pytest.mark.parametrize(("name", "compiled"), COMPILED)
def test_law_at_an_input(flat, monkeypatch, name, compiled):
    if not compiled:
        monkeypatch.setattr(binary_form, "engine_library", lambda *_: None)
    method, (_, outputs, slopes) = followed(flat, name, SIZE, True)
    assert method.startswith("Radau IIA" if compiled else "CVODE")
    reads = of_name(name).reads
    np.testing.assert_allclose(outputs[:, 0], along(name, SIZE, reads), atol=2e-5)
    step = STEP * SIZE
    by_size = (along(name, SIZE + step, reads) - along(name, SIZE - step, reads)) / (2 * step)
    np.testing.assert_allclose(slopes[:, 0, 1], by_size, atol=1e-4 + 5e-3 * np.abs(by_size).max())
    assert slopes.shape == (41, 1, 4)  # by d, the size, and two initial states


def test_every_effect_that_is_marked_can_be_tried():
    marked = [e for e in effect_library() if e.outside]
    assert {e.name for e in marked if e.outside == "input"} == set(FORMULAS)
    t = np.linspace(5.0, 6.0, 101)
    y = t**2
    slopes = {e.name: sensor_fault(e).along(y, t) for e in marked if e.outside == "output"}
    wanted = {"Offset": np.ones(101), "Drift": t - 5.0, "Gain": y, "Lag": -2.0 * t}
    assert set(slopes) == set(wanted)
    for name, slope in slopes.items():
        np.testing.assert_allclose(slope[1:-1], wanted[name][1:-1], rtol=1e-9, atol=1e-12)


def test_programs_compute_what_casadi_does():
    v, s = ca.SX.sym("v"), ca.SX.sym("s")
    parts = [
        v + s, v - s, v * s, v / s, -v, v**2, 2 * v, 1 / v, ca.fabs(v) ** s, ca.sqrt(s), ca.exp(v), ca.log(s),
        ca.sin(v), ca.cos(v), ca.tan(v), ca.atan(v), ca.tanh(v), ca.fabs(v), ca.sign(v), ca.fmin(v, s),
        ca.fmax(v, s), ca.if_else(v < s, v, s), ca.if_else(v <= s, s, v), v**3,
    ]  # fmt: skip
    used = set()
    for part in parts:
        function = ca.Function("part", [v, s], [part])
        program = program_of(function)
        used |= {step[0] for step in program}
        for at in (-1.3, 0.7):
            assert Law(program, 0, size=1.1).value(at) == pytest.approx(float(function(at, 1.1)), rel=1e-14)
    assert {"add", "where", "not", "power", "at most"} <= {list(STEPS)[i] for i in used if i < len(STEPS)}


@pytest.mark.parametrize(
    "name",
    [
        "Daest.Effects.Rotational.Backlash",
        pytest.param("Daest.Effects.Rotational.LuGreFriction", marks=pytest.mark.slow),
    ],
)
def test_effects_of_another_form_are_refused(name):
    with pytest.raises(ModelError) as caught:
        input_law(find_effect(name))
    assert caught.value.code == "effect-law-outside" and caught.value.remedy


@pytest.mark.slow
def test_simulation_alone_has_no_slopes(flat):
    _, (states, outputs, slopes) = followed(flat, "QuadraticDrag", SIZE, False)
    assert slopes.shape == (41, 1, 0)
    np.testing.assert_array_equal(states[:, 0], outputs[:, 0])
