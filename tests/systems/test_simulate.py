"""Simulation against independent integrations, and simulated noise against its theory."""

import casadi as ca
import numpy as np
import pytest
import scipy.linalg
from dae_models import FlatBuilder, cubic_loop, driven_position, pendulum, rc_pair, servo
from scipy.integrate import quad, solve_ivp
from scipy.stats import chi2

from daest.errors import ModelError, NumericalError
from daest.model.experiment import Experiment
from daest.report.documents.simulate import document, table
from daest.systems.linear.linearize import linearize
from daest.systems.linear.state_space import state_space, state_space_family
from daest.systems.reduction.reduce import reduce_index
from daest.systems.simulation.simulate import simulate

TIGHT = {"rtol": 1e-11, "atol": 1e-13}


def drive(seed, time):
    return np.random.default_rng(seed).standard_normal((time.size, 1))


def piecewise(rhs, time, u, x0, hold):
    """Independent integration, restarted at every sample."""
    states = [np.asarray(x0, dtype=float)]
    for k in range(time.size - 1):
        slope = (u[k + 1, 0] - u[k, 0]) / (time[k + 1] - time[k]) if hold == "foh" else 0.0

        def between(t, x, k=k, slope=slope):
            return rhs(x, u[k, 0] + slope * (t - time[k]))

        run = solve_ivp(between, (time[k], time[k + 1]), states[-1], method="DOP853", **TIGHT)
        states.append(run.y[:, -1])
    return np.array(states)


def servo_by_hand(x, u):
    """The report's servo, worked out on paper; state: rotor angle, rotor speed, disc angle, disc speed."""
    R, k, n, c, d, J1, J2 = 4.6, 0.06, 30.0, 0.0362, 5.43e-4, 3e-6, 3.66e-4
    torque = c * (x[2] - x[0] / n) + d * (x[3] - x[1] / n)
    return [x[1], (k * (u - k * x[1]) / R + torque / n) / J1, x[3], -torque / J2]


@pytest.mark.parametrize("hold", ["foh", "zoh"])
@pytest.mark.parametrize("spacing", ["even", "uneven"])
def test_servo_agrees_with_an_integration_of_the_equations_solved_by_hand(hold, spacing):
    time = np.linspace(0, 1.0, 41)
    if spacing == "uneven":
        time = np.sort(np.random.default_rng(0).uniform(0, 1.0, 41))
    u = drive(1, time)
    x0 = [0.2, 1.0, -0.1, 0.3]
    expected = piecewise(servo_by_hand, time, u, x0, hold)
    result = simulate(servo(), (time, u), hold=hold, x0=np.array(x0))
    np.testing.assert_allclose(result.states, expected, rtol=1e-8, atol=1e-8 * np.abs(expected).max())
    np.testing.assert_allclose(result["phi"], expected[:, 2], atol=1e-9)
    current = (u[:, 0] - 0.06 * expected[:, 1]) / 4.6
    np.testing.assert_allclose(np.abs(result["resistor.i"]), np.abs(current), atol=1e-8)


def test_pendulum_agrees_with_polar_coordinates():
    time = np.linspace(0, 3, 61)
    u = drive(2, time)
    angle = np.arctan2(0.6, 0.8)
    expected = piecewise(
        lambda p, f: [p[1], -9.81 * np.sin(p[0]) - 0.2 / 0.5 * p[1] + f * np.cos(p[0]) / 0.5],
        time, u, [angle, 0.0], "foh",
    )  # fmt: skip
    result = simulate(pendulum(), (time, u), rtol=1e-9)
    np.testing.assert_allclose(result["angle"], expected[:, 0], atol=1e-6)
    np.testing.assert_allclose(result["x"] ** 2 + result["y"] ** 2, 1.0, rtol=1e-9)


def test_nonlinear_loop_agrees_with_idas():
    time = np.linspace(0, 4, 21)
    x, z, q = ca.SX.sym("x"), ca.SX.sym("z"), ca.SX.sym("q")
    dae = {
        "x": x,
        "z": ca.vertcat(z, q),
        "ode": 0.3 - z,
        "alg": ca.vertcat(q + z**3 - x, q - z - 0.1 * ca.sin(q)),
    }
    solver = ca.integrator("reference", "idas", dae, 0, time[1:].tolist(), {"abstol": 1e-11, "reltol": 1e-11})
    expected = solver(x0=2.0, z0=[1.0, 1.0])["xf"].full().ravel()
    result = simulate(cubic_loop(), (time, np.full((21, 1), 0.3)), rtol=1e-9)
    np.testing.assert_allclose(result.states[1:, 0], expected, atol=1e-6)


def test_recording_is_matched_by_name_and_x0_by_variable():
    time = np.array([0.0, 0.1, 0.3])
    values = np.array([[9.0, 1.0], [9.0, 2.0], [9.0, 3.0]])
    recording = Experiment("r", time, values, np.full((3, 1), np.nan), ("other", "u"), ("y",))
    result = simulate(rc_pair(), recording, x0={"v1": 0.5})
    np.testing.assert_array_equal(result.inputs[:, 0], [1.0, 2.0, 3.0])
    np.testing.assert_allclose(result.states[0], [0.5, 1.0], rtol=1e-13)
    with pytest.raises(ModelError) as caught:
        simulate(servo(), Experiment("r", time, values[:, :1], np.full((3, 1), np.nan), ("v",), ("y",)))
    assert caught.value.code == "simulation-input"


def speed_driven():
    """A mass whose speed is the input: the force needs u'."""
    b = FlatBuilder("SpeedDriven")
    u = b.input("u")
    for name in ("s", "v", "f"):
        b.unknown(name)
    b.equation("der(s) = v", b.der("s"), b["v"])
    b.equation("v = u", b["v"], u)
    b.equation("f = 2*der(v)", b["f"], 2 * b.der("v"))
    b.output("f", b["f"])
    return b.build()


def test_first_derivative_of_an_input_is_its_central_difference_at_the_samples():
    time = np.array([0.0, 1.0, 3.0, 4.0])
    u = np.array([[0.0], [1.0], [0.0], [2.0]])
    result = simulate(speed_driven(), (time, u))
    np.testing.assert_allclose(result["f"], [2.0, 1.0, 7.0 / 3.0, 4.0], rtol=1e-12)
    np.testing.assert_allclose(result["s"], [0.0, 0.5, 1.5, 2.5], rtol=1e-12)


def test_derivatives_that_samples_do_not_have_are_refused_with_the_equation():
    time, u = np.arange(3.0), np.zeros((3, 1))
    with pytest.raises(ModelError) as caught:
        simulate(driven_position(), (time, u))
    assert caught.value.code == "input-derivative-order"
    assert "s1 = u" in caught.value.what
    with pytest.raises(ModelError) as caught:
        simulate(speed_driven(), (time, u), hold="zoh")
    assert caught.value.code == "input-derivative-hold"
    assert "v = u" in caught.value.what


def test_states_of_a_noisy_run_have_the_stationary_covariance():
    flat = rc_pair()
    # Samples so far apart that they are independent: the slowest time constant is 1.6 s.
    time = 40.0 * np.arange(2001)
    result = simulate(flat, (time, np.zeros((time.size, 1))), noise=True, seed=5)
    ss = state_space(state_space_family(flat), flat.theta_values)
    P = scipy.linalg.solve_continuous_lyapunov(ss.A, -1e-3 * ss.G @ ss.G.T)
    x = result.states[1:]
    whitened = np.linalg.solve(np.linalg.cholesky(P), x.T)
    n = x.shape[0]
    for statistic in (*(whitened**2).sum(axis=1), ((whitened[0] + whitened[1]) ** 2).sum() / 2):
        assert chi2.ppf(0.001, n) < statistic < chi2.ppf(0.999, n)
    error = (result["y"] - result["v2"])[1:] / 0.05
    assert chi2.ppf(0.001, n) < (error**2).sum() < chi2.ppf(0.999, n)


def integrated_noise(damping):
    """x' = w, z' = w - z - damping z^3, and a = w inside the model."""
    b = FlatBuilder("Integrated")
    w = b.noise("w", 0.5)
    for name in ("x", "z", "a"):
        b.unknown(name, start=0.0)
    b.equation("a = w", b["a"], w)
    b.equation("der(x) = a", b.der("x"), b["a"])
    b.equation("der(z) = a - z", b.der("z"), b["a"] - b["z"] - damping * b["z"] ** 3)
    b.output("z", b["z"])
    return b.build()


@pytest.mark.parametrize("damping", [0.0, 0.3])
def test_internal_variables_carry_the_mean_noise_of_the_interval(damping):
    time = np.cumsum(np.random.default_rng(3).choice([0.1, 0.25], 300))
    result = simulate(integrated_noise(damping), (time, np.zeros((300, 0))), noise=True, seed=8)
    assert result.method.startswith("matrix exponential" if damping == 0.0 else "local linearisation")
    steps = np.diff(time)
    # x and the mean noise are fully correlated; the root of a singular covariance is exact to sqrt(eps).
    np.testing.assert_allclose(np.diff(result["x"]), result["a"][:-1] * steps, rtol=0, atol=1e-7)
    statistic = (result["a"][:-1] ** 2 * steps / 0.5).sum()
    assert chi2.ppf(0.001, 299) < statistic < chi2.ppf(0.999, 299)


@pytest.mark.slow
def test_nonlinear_noise_has_the_stationary_density_of_its_potential():
    time = 1.0 * np.arange(801)
    result = simulate(integrated_noise(2.0), (time, np.zeros((time.size, 0))), noise=True, seed=4)
    z = result["z"][10::2]  # relaxation within one second: nearly independent

    def weight(power):
        # dz = -(z + 2 z^3) dt + dw, intensity 0.5: density ~ exp(-2 V / 0.5), V = z^2/2 + z^4/2
        return quad(lambda v: v**power * np.exp(-4.0 * (v**2 / 2 + v**4 / 2)), -np.inf, np.inf)[0]

    second, fourth = weight(2) / weight(0), weight(4) / weight(0)
    spread = np.sqrt((fourth - second**2) / z.size)
    # The linearisation over a quarter second biases the variance by some percent.
    assert abs(np.mean(z**2) - second) < 3.5 * spread + 0.05 * second


def test_noise_that_reaches_an_output_is_held_over_a_sample():
    b = FlatBuilder("Direct")
    w = b.noise("w", 0.2)
    x = b.unknown("x", start=0.0)
    b.equation("der(x) = w - x", b.der("x"), w - x)
    b.output("y", x + w)
    time = 0.5 * np.arange(400)
    result = simulate(b.build(), (time, np.zeros((400, 0))), noise=True, seed=1)
    assert "held" in result.method
    np.testing.assert_allclose(result["y"], result["x"] + result["w"], rtol=1e-12)
    decay = np.exp(-0.5)
    expected = decay * result["x"][:-1] + (1 - decay) * result["w"][:-1]
    np.testing.assert_allclose(result["x"][1:], expected, atol=1e-12)


def test_the_seed_repeats_a_run_and_intensities_are_needed():
    flat = rc_pair()
    time, u = 0.1 * np.arange(50), np.zeros((50, 1))
    first, again, other = (simulate(flat, (time, u), noise=True, seed=s) for s in (3, 3, 4))
    np.testing.assert_array_equal(first.outputs, again.outputs)
    assert not np.array_equal(first.outputs, other.outputs)
    b = FlatBuilder("Silent")
    w, x = b.noise("w"), b.unknown("x")
    b.equation("der(x) = w - x", b.der("x"), w - x)
    silent = b.build()
    with pytest.raises(ModelError) as caught:
        simulate(silent, (time, np.zeros((50, 0))), noise=True)
    assert caught.value.code == "noise-intensity-missing"
    loud = simulate(silent, (time, np.zeros((50, 0))), noise=True, seed=1, intensities={"w": 1.0})
    assert np.std(loud["x"]) > 0.01


def test_a_simulation_that_breaks_down_names_the_time():
    b = FlatBuilder("Blowup")
    x = b.unknown("x", start=1.0, fixed=True)
    b.equation("der(x) = x^2", b.der("x"), x**2)  # x = 1 / (1 - t)
    time = np.linspace(0, 2, 21)
    with pytest.raises(NumericalError) as caught:
        simulate(b.build(), (time, np.zeros((21, 0))))
    assert caught.value.code == "simulation-failed"
    assert "t = 0.9" in caught.value.what or "t = 1" in caught.value.what


def test_document_and_table():
    explicit = reduce_index(rc_pair())
    result = simulate(explicit, (np.array([0.0, 1.0]), np.array([[1.0], [2.0]])))
    content = document(result)
    assert content["outputs"] == ["y"] and content["states"] == ["v1", "v2"]
    assert content["trajectories"]["v2"] == result["v2"].tolist()
    assert content["units"]["i1"] == "A"
    header, rows = table(result)
    assert header == ["time [s]", "u [V]", "y"]
    np.testing.assert_array_equal(rows, np.column_stack([result.time, result["u"], result["y"]]))
    header, rows = table(result, all_variables=True)
    assert header == ["time [s]", "u [V]", "y", "v1 [V]", "v2 [V]", "i1 [A]", "i2 [A]"]
    assert rows.shape == (2, 7)


def brushed_motor(order):
    """u = R i + drop + k w with a brush voltage that hardly bends, its three equations in this order."""
    b = FlatBuilder("Brushed")
    u, resistance, k = b.input("u"), b.parameter("R", 4.2), b.parameter("k", 0.06)
    w, i, drop, source = b.unknown("w", start=0.0, fixed=True), b.unknown("i"), b.unknown("v"), b.unknown("s")
    b.equation("1e-3 der(w) = k i", 1e-3 * b.der("w"), k * i)
    loop = [
        ("s = R i + v + k w", source, resistance * i + drop + k * w),
        ("v = 0.65 tanh(i/0.01)", drop, 0.65 * ca.tanh(i / 0.01)),
        ("s = u", source, u),
    ]
    for position in order:
        b.equation(*loop[position])
    b.output("y", i)
    return b.build()


def test_a_law_that_flattens_out_is_solved_wherever_its_equation_stands():
    time = np.linspace(0, 2.0, 101)
    u = np.sin(5 * time)[:, None] * np.linspace(1.5, 0.2, 101)[:, None]
    first, *others = (
        simulate(brushed_motor(order), (time, u)) for order in [(0, 1, 2), (1, 0, 2), (2, 1, 0)]
    )
    for other in others:
        np.testing.assert_allclose(other.outputs, first.outputs, atol=1e-9)
    residual = u[:, 0] - 4.2 * first["i"] - 0.65 * np.tanh(first["i"] / 0.01) - 0.06 * first["w"]
    np.testing.assert_allclose(residual, 0.0, atol=1e-9)


@pytest.mark.parametrize("guess", [0.0, 5.0, -3.0])
def test_a_loop_is_closed_from_a_poor_start(guess):
    b = FlatBuilder("Poor")
    u = b.input("u")
    b.unknown("x", start=0.0, fixed=True)
    i = b.unknown("i", start=guess)
    b.equation("der(x) = i", b.der("x"), i)
    b.equation("u = 4 i + 0.65 tanh(1000 i)", u, 4 * i + 0.65 * ca.tanh(1000 * i))
    b.output("y", i)
    explicit = reduce_index(b.build())
    for value in (0.01, 0.5, 3.0, -0.3):
        found = float(explicit.outputs(0, value, [], [], [], 0))
        assert abs(4 * found + 0.65 * np.tanh(1000 * found) - value) < 1e-9


def test_a_long_simulation_tells_and_can_be_ended(monkeypatch):
    monkeypatch.setattr("daest.numerics.watched.SECONDS", 0.2)
    told = []

    def tell(text):
        told.append(text)
        if len(told) == 2:
            raise KeyboardInterrupt

    b = FlatBuilder("Swing")
    phi, w = b.unknown("phi", start=1.0, fixed=True), b.unknown("w", start=0.0, fixed=True)
    b.equation("der(phi) = w", b.der("phi"), w)
    b.equation("der(w) = -sin(phi)", b.der("w"), -ca.sin(phi))
    b.output("y", phi)
    time = np.array([0.0, 1e7])  # more than a million turns
    with pytest.raises(KeyboardInterrupt):
        simulate(b.build(), (time, np.zeros((2, 0))), tell=tell)
    assert len(told) == 2 and "of 1e+07 s" in told[0]


@pytest.mark.parametrize("value", [np.inf, np.nan])
def test_parameters_are_finite(value):
    flat = servo()
    theta = flat.theta_values
    theta[0] = value
    for use in (
        lambda: linearize(flat, theta),
        lambda: simulate(flat, (np.arange(3.0), np.zeros((3, 1))), theta=theta),
    ):
        with pytest.raises(ModelError, match=rf"{flat.parameters[0].name}.*not a finite number") as caught:
            use()
        assert caught.value.code == "parameter-outside-bounds"
