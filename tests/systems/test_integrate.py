"""Radau integration with sensitivities: scipy with variational equations, finite differences, the interpreted
engine."""

import casadi as ca
import numpy as np
import pytest
from dae_models import FlatBuilder
from flat_models import Draft
from scipy.integrate import solve_ivp

from daest.errors import ModelError
from daest.systems.events.integration import Correction, IntegrationError
from daest.systems.reduction.reduce import reduce_index
from daest.systems.simulation.integrate import integrate, integrator, interval_inputs

PARAMETERS = {"J": 0.02, "d": 0.05, "c": 2.0, "stick": 0.3, "width": 0.01}
NAMES = ("J", "c", "stick")
PERIOD = 0.02


def friction_oscillator(**values):
    """Inertia on a spring with Coulomb friction smoothed over `width`: stiff by d + stick/width over J."""
    draft = Draft("Friction", parameters={**PARAMETERS, **values}, unknowns=["phi", "w"], inputs=["u"])
    draft.outputs = {"angle": "phi", "torque": "c*phi + stick*tanh(w/width)"}
    draft.equation("der(phi) = w")
    draft.equation("J*der(w) = u - c*phi - d*w - stick*tanh(w/width)")
    return reduce_index(draft.flat())


def recording(n=60, seed=0):
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.5, 1.5, n)) * PERIOD
    return time, np.repeat(rng.uniform(-2, 2, n), 4)[:n, None]


def input_at(time, u, hold, k, t):
    share = 0.0 if hold == "zoh" else (t - time[k]) / (time[k + 1] - time[k])
    return u[k, 0] + share * (u[min(k + 1, time.size - 1), 0] - u[k, 0])


def by_scipy(explicit, time, u, hold, x0, tolerance=1e-9):
    """States and ∂(states)/∂(NAMES, x0) by the variational equations, interval by interval."""
    x, U, V, W, theta, t = explicit.rhs.sx_in()
    f = explicit.rhs(x, U, V, W, theta, t)
    columns = [list(PARAMETERS).index(name) for name in NAMES]
    slopes = ca.Function("slopes", [x, U, theta], [f, ca.jacobian(f, x), ca.jacobian(f, theta)[:, columns]])
    values, n, p = explicit.flat.theta_values, x0.size, len(NAMES)

    def rate(s, z, k):
        f, A, F = (np.array(part) for part in slopes(z[:n], input_at(time, u, hold, k, s), values))
        S = z[n:].reshape(n, p + n)
        change = A @ S
        change[:, :p] += F
        return np.concatenate([f.ravel(), change.ravel()])

    z = np.concatenate([x0, np.hstack([np.zeros((n, p)), np.eye(n)]).ravel()])
    rows = [z]
    for k in range(time.size - 1):
        span = (time[k], time[k + 1])
        z = solve_ivp(rate, span, z, "LSODA", args=(k,), rtol=tolerance, atol=tolerance * 1e-2).y[:, -1]
        rows.append(z)
    table = np.array(rows)
    return table[:, :n], table[:, n:].reshape(-1, n, p + n)


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_states_and_sensitivities_are_those_of_scipy(hold):
    explicit = friction_oscillator()
    time, u = recording(12)
    x0 = np.array([0.1, -0.2])
    states, S = by_scipy(explicit, time, u, hold, x0)
    engine = integrator(explicit, NAMES)
    assert engine.library is not None
    for rtol, allowed in ((1e-6, 1e-5), (1e-9, 1e-7)):
        found = integrate(
            engine, time, u, explicit.flat.theta_values, x0, hold=hold, sensitivities=True, rtol=rtol
        )
        assert np.max(np.abs(found.states - states)) < allowed
        angle = found.sensitivities[:, 0]
        scale = np.max(np.abs(S[:, 0]), axis=0)
        assert np.max(np.abs(angle - S[:, 0]) / scale) < 1e3 * allowed


def looped_oscillator():
    """The friction depends on the load that it changes: a Newton iteration finds both at every point."""
    draft = Draft(
        "Loop", parameters={**PARAMETERS, "width": 0.1}, unknowns=["phi", "w", "f", "push"], inputs=["u"]
    )
    draft.outputs = {"angle": "phi", "push": "push"}
    draft.equation("der(phi) = w")
    draft.equation("J*der(w) = push - d*w")
    draft.equation("push = u - c*phi - f")
    draft.equation("f = stick*tanh(w/width)*(1 + 0.5*tanh(push))")
    return reduce_index(draft.flat())


def chain(*, rubbed, slips=False):
    """Three inertias on springs, the first `rubbed` of them with friction: so many rates have slopes that
    change along a step; if it `slips`, those of all six have."""
    unknowns = [f"{name}{i}" for i in range(3) for name in ("phi", "w")]
    draft = Draft("Chain", parameters={**PARAMETERS, "width": 0.1}, unknowns=unknowns, inputs=["u"])
    draft.outputs = {"angle": "phi2", "torque": "c*(phi0 - phi1)"}
    for i in range(3):
        left = "u - c*phi0" if i == 0 else f"c*(phi{i - 1} - phi{i})"
        right = f" - c*(phi{i} - phi{i + 1})" if i < 2 else ""
        friction = f" - stick*tanh(w{i}/width)" if i < rubbed else ""
        draft.equation(f"der(phi{i}) = w{i}" + (f" - 0.5*sin(phi{i})" if slips else ""))
        draft.equation(f"J*der(w{i}) = {left}{right} - d*w{i}{friction}")
    return reduce_index(draft.flat())


ENGINES = {
    "one rate": lambda: friction_oscillator(width=0.1),
    "loop": looped_oscillator,
    "one of six": lambda: chain(rubbed=1),
    "two of six": lambda: chain(rubbed=2),
    "all": lambda: chain(rubbed=3, slips=True),
}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow if name in ("one of six", "two of six") else ())
        for name in ENGINES
    ],
)
def test_sensitivities_of_outputs_are_finite_differences(name):
    explicit = ENGINES[name]()
    time, u = recording()
    n = explicit.n_states
    theta, x0 = explicit.flat.theta_values, np.array([0.1, -0.2, 0.3, 0.4, -0.1, 0.2])[:n]
    engine = integrator(explicit, NAMES)
    found = integrate(engine, time, u, theta, x0, hold="foh", sensitivities=True, rtol=1e-8)
    h = 1e-6
    for d in range(len(NAMES) + n):
        step, shift = np.zeros(theta.size), np.zeros(n)
        if d < len(NAMES):
            step[list(PARAMETERS).index(NAMES[d])] = h
        else:
            shift[d - len(NAMES)] = h
        up, down = (
            integrate(engine, time, u, theta + s * step, x0 + s * shift, hold="foh", rtol=1e-10).outputs
            for s in (1, -1)
        )
        slope = (up - down) / (2 * h)
        assert np.allclose(found.sensitivities[:, :, d], slope, atol=1e-4 * np.max(np.abs(slope)))


def test_stiff_friction_takes_few_steps():
    """With a stiffness of 1e5 per second an explicit method would need two thousand steps per interval."""
    explicit = friction_oscillator(width=1e-4)
    time, u = recording(15)
    x0 = np.array([0.1, 0.0])
    found = integrate(integrator(explicit), time, u, explicit.flat.theta_values, x0, hold="zoh")
    states, _ = by_scipy(explicit, time, u, "zoh", x0, 1e-8)
    assert np.max(np.abs(found.states[:, 0] - states[:, 0])) < 1e-4
    assert found.n_steps < 50 * time.size


@pytest.mark.parametrize("hold", ["zoh", "foh"])
@pytest.mark.parametrize("corrected", [False, True])
def test_interpreted_engine_gives_the_same(hold, corrected):
    explicit = friction_oscillator(width=2.0)  # the interpreted engine has fixed steps
    time, u = recording(24)
    y = np.random.default_rng(1).standard_normal((time.size, 2))
    y[5] = np.nan
    correction = Correction(y, np.array([[0.3, 0.0], [0.2, 0.1]])) if corrected else None
    runs = [
        integrate(
            integrator(explicit, NAMES, compiled=compiled),
            time,
            u,
            explicit.flat.theta_values,
            np.array([0.1, -0.2]),
            hold=hold,
            sensitivities=True,
            rtol=1e-9,
            correction=correction,
        )
        for compiled in (True, False)
    ]
    assert np.allclose(runs[0].outputs, runs[1].outputs, atol=1e-4)
    scale = np.max(np.abs(runs[0].sensitivities), axis=(0, 1))
    assert np.max(np.abs(runs[0].sensitivities - runs[1].sensitivities) / scale) < 1e-3


def test_correction_is_the_observer_between_samples():
    """x += gain (y - h(x)) at every sample, missing outputs left out, against the loop by scipy."""
    explicit = friction_oscillator(width=0.2)
    time, u = recording(20)
    rng = np.random.default_rng(2)
    y, gain = rng.standard_normal((20, 2)), rng.uniform(0, 0.3, (20, 2, 2))
    y[7, 1] = y[9] = np.nan
    theta, x = explicit.flat.theta_values, np.array([0.1, -0.2])
    found = integrate(
        integrator(explicit), time, u, theta, x, hold="foh", rtol=1e-10, correction=Correction(y, gain)
    )
    for k in range(20):
        assert np.allclose(found.states[k], x, atol=1e-7)
        h = np.array(explicit.outputs(x, u[k], [], [], theta, time[k])).ravel()
        there = np.isfinite(y[k])
        x = x + gain[k][:, there] @ (y[k] - h)[there]
        if k + 1 < 20:
            x = solve_ivp(
                lambda t, s, k=k: np.array(
                    explicit.rhs(s, input_at(time, u, "foh", k, t), [], [], theta, t)
                ).ravel(),
                (time[k], time[k + 1]),
                x,
                "LSODA",
                rtol=1e-10,
                atol=1e-12,
            ).y[:, -1]


def test_gain_enters_the_sensitivities():
    explicit = friction_oscillator(width=0.2)
    time, u = recording(30)
    y = np.random.default_rng(1).standard_normal((30, 2))
    correction = Correction(y, np.array([[0.3, 0.0], [0.2, 0.1]]))
    theta, x0, engine = explicit.flat.theta_values, np.array([0.1, -0.2]), integrator(explicit, NAMES)
    found = integrate(
        engine, time, u, theta, x0, hold="zoh", sensitivities=True, rtol=1e-9, correction=correction
    )
    step = np.zeros(theta.size)
    step[2] = h = 1e-5
    up, down = (
        integrate(
            engine, time, u, theta + s * step, x0, hold="zoh", rtol=1e-10, correction=correction
        ).outputs
        for s in (1, -1)
    )
    slope = (up - down) / (2 * h)
    assert np.allclose(found.sensitivities[:, :, 1], slope, atol=1e-5 * np.max(np.abs(slope)))


def test_one_sample_and_no_inputs():
    draft = Draft("Decay", parameters={"a": 2.0}, unknowns=["x"])
    draft.outputs = {"y": "x"}
    draft.equation("der(x) = -a*x")
    explicit = reduce_index(draft.flat())
    engine = integrator(explicit, ("a",))
    theta = explicit.flat.theta_values
    single = integrate(engine, np.array([0.0]), np.zeros((1, 0)), theta, np.ones(1), sensitivities=True)
    assert single.outputs[0, 0] == 1.0 and np.array_equal(single.sensitivities[0, 0], [0.0, 1.0])
    time = np.array([0.0, 0.3, 1.0])
    found = integrate(engine, time, np.zeros((3, 0)), theta, np.ones(1), sensitivities=True, rtol=1e-9)
    assert np.allclose(found.outputs[:, 0], np.exp(-2 * time), atol=1e-8)
    assert np.allclose(found.sensitivities[:, 0, 0], -time * np.exp(-2 * time), atol=1e-7)


@pytest.mark.parametrize("compiled", [True, False])
def test_a_solution_that_escapes_is_reported_with_its_time(compiled):
    """x' = x², x(0) = 1 goes to infinity at t = 1."""
    draft = Draft("Escape", parameters={"a": 1.0}, unknowns=["x"])
    draft.outputs = {"y": "x"}
    draft.equation("der(x) = a*x*x")
    explicit = reduce_index(draft.flat())
    with pytest.raises(IntegrationError) as failed:
        integrate(
            integrator(explicit, compiled=compiled),
            np.linspace(0, 2, 21),
            np.zeros((21, 0)),
            explicit.flat.theta_values,
            np.ones(1),
        )
    assert failed.value.code == "integration-failed"
    assert 0.8 <= failed.value.time <= 1.3


def test_no_finite_derivative_is_reported():
    explicit = friction_oscillator()
    time, u = recording()
    with pytest.raises(IntegrationError) as failed:
        integrate(integrator(explicit), time, u, np.full(5, np.nan), np.zeros(2))
    assert failed.value.time == time[0]


def differentiating(order):
    """A model that needs derivatives of its input: the input prescribes the position of a mass."""
    draft = Draft("Driven", parameters={"m": 2.0}, unknowns=["x", "v", "a", "f"], inputs=["u"])
    draft.outputs = {"force": "f"}
    for text in (
        ("x = u", "v = der(x)", "a = der(v)") if order == 2 else ("v = u", "a = der(v)", "der(x) = v")
    ):
        draft.equation(text)
    draft.equation("m*a = f")
    return reduce_index(draft.flat())


def test_slopes_of_inputs_where_the_model_needs_them():
    time = np.array([0.0, 0.1, 0.3])
    u = np.array([[1.0], [2.0], [0.0]])
    start, end = interval_inputs(differentiating(1), time, u, "foh")
    assert np.allclose(start, [[1.0, 10.0], [2.0, 10.0 / 3.0]])
    assert np.allclose(end, [[2.0, 10.0 / 3.0], [0.0, -10.0]])
    with pytest.raises(ModelError) as held:
        interval_inputs(differentiating(1), time, u, "zoh")
    assert held.value.code == "input-derivative-hold"
    with pytest.raises(ModelError) as second:
        interval_inputs(differentiating(2), time, u, "foh")
    assert second.value.code == "input-derivative-order"


def test_unknown_parameter_is_named():
    with pytest.raises(ModelError) as unknown:
        integrator(friction_oscillator(), ("nothing",))
    assert unknown.value.code == "unknown-parameter"


def test_what_was_compiled_for_more_parameters_serves_the_first_ones():
    explicit = friction_oscillator()
    more = integrator(explicit, NAMES)
    time, u = recording()

    def run(model, of):
        theta = of.flat.theta_values
        return integrate(model, time, u, theta, np.array([0.1, 0.0]), hold="zoh", sensitivities=True)

    apart = friction_oscillator()
    for names in ((), NAMES[:1], NAMES):
        fewer, alone = integrator(explicit, names), integrator(apart, names)
        assert fewer.library is more.library and fewer.names == names
        found, expected = run(fewer, explicit), run(alone, apart)
        assert found.sensitivities.shape == expected.sensitivities.shape
        np.testing.assert_array_equal(found.sensitivities, expected.sensitivities)
    assert integrator(explicit, NAMES[1:]).library is not more.library
    assert integrator(explicit).names == ()


@pytest.mark.parametrize("starts", [{}, {"x": 1.0}])
def test_start_beside_a_variable_that_bends(starts):
    b = FlatBuilder("Pair")
    for name in ("x", "v", "energy"):
        b.unknown(name, start=starts.get(name), fixed=name in starts)
    b.equation("der(x) = v", b.der("x"), b["v"])
    b.equation("der(v) = -x", b.der("v"), -b["x"])
    b.equation("energy = v*v", b["energy"], b["v"] * b["v"])
    explicit = reduce_index(b.build())
    time, theta = np.array([0.0, 0.5]), explicit.flat.theta_values
    found = integrate(integrator(explicit), time, np.zeros((2, 0)), theta, np.eye(2)[0])
    swing = dict(zip(explicit.state_names, np.eye(2)[0], strict=True))
    x, v = swing["x"], swing["v"]
    expected = {"x": x * np.cos(0.5) + v * np.sin(0.5), "v": v * np.cos(0.5) - x * np.sin(0.5)}
    np.testing.assert_allclose(found.states[-1], [expected[n] for n in explicit.state_names], rtol=1e-9)
