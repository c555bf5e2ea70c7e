"""Filter a recording with a nonlinear model: every internal variable, constraints, unknown starts."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from nonlinear_models import experiment_of, friction_servo, linear_servo, oscillator

from daest.errors import EstimationError
from daest.estimation.filter import run_filter
from daest.model.estimates import FilterOptions, InitialState
from daest.modelica.compile import compile_model
from daest.systems.linear.state_space import state_space_family
from daest.systems.reduction.initialize import initial_point
from daest.systems.reduction.reduce import reduce_index
from daest.systems.reduction.redundant import matching_states, needs_redundant_states, redundant_model
from daest.systems.simulation.integrate import integrate, integrator
from daest.systems.simulation.simulate import simulate

KINDS = ("ekf", "ukf", "particle")
INTENSITY, STD = np.array([1e-2, 1e-3]), np.array([0.1, 0.05])


def servo_record(explicit, n=400, seed=0):
    time = 0.005 * np.arange(n)
    u = 3.0 * np.sign(np.sin(2 * np.pi * 1.3 * time))[:, None]
    names = [w.name for w in explicit.flat.noises]
    sim = simulate(
        explicit,
        (time, u),
        hold="zoh",
        noise=True,
        seed=seed,
        intensities=dict(zip(names, INTENSITY, strict=True)),
    )
    y = sim.outputs + STD * np.random.default_rng(seed).standard_normal(sim.outputs.shape)
    return sim, experiment_of(explicit, time, u, y)


# What is smoothed is what was filtered.
@pytest.mark.slow  # test_ekf.py, test_ukf.py
@pytest.mark.parametrize("smooth", [False, True])
def test_agrees_with_the_filter_of_linear_models(smooth):
    explicit = linear_servo()
    _, experiment = servo_record(explicit)
    initial = InitialState.known(np.zeros(4), 0.3)
    known = run_filter(
        state_space_family(explicit),
        experiment,
        "time-varying",
        FilterOptions(
            process_intensity=INTENSITY, measurement_cov=STD**2, smooth=smooth, initial=initial, hold="zoh"
        ),
    )
    for kind in ("ekf", "ukf"):
        found = run_filter(
            explicit,
            experiment,
            kind,
            FilterOptions(
                process_intensity=INTENSITY,
                smooth=smooth,
                initial=initial,
                hold="zoh",
                measurement_cov=STD**2,
            ),
        )
        assert found.names == known.names
        assert np.max(np.abs(found.values - known.values) / known.std) < 1e-7
        assert np.allclose(found.std, known.std, rtol=1e-7)
        assert found.log_likelihood == pytest.approx(known.log_likelihood, abs=1e-6)
        assert found.nis.mean == pytest.approx(known.nis.mean, rel=1e-7)
        assert (found.nis.low, found.nis.high) == (known.nis.low, known.nis.high)
        scale = known.process_noise.std
        assert np.max(np.abs(found.process_noise.values - known.process_noise.values) / scale) < 1e-6
        assert np.allclose(found.process_noise.std, known.process_noise.std, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_standard_deviations_are_those_of_the_errors(kind):
    """Normalised errors of a friction servo from an unknown start: their mean square is 1 within the band
    that correlated errors allow."""
    explicit = friction_servo()
    squares, nis = [], []
    for seed in range(3):
        sim, experiment = servo_record(explicit, seed=seed)
        found = run_filter(
            explicit,
            experiment,
            kind,
            FilterOptions(
                process_intensity=INTENSITY,
                hold="zoh",
                n_particles=400,
                seed=seed,
                initial=InitialState.known(np.zeros(4), 0.1) if kind == "particle" else None,
                measurement_cov=STD**2,
            ),
        )
        columns = [found.names.index(name) for name in sim.variable_names]
        error = (found.values[:, columns] - sim.variables) / found.std[:, columns]
        squares.append(np.mean(error[20:] ** 2))
        nis.append(found.nis.mean)
    assert 0.6 < np.mean(squares) < 1.6
    assert 0.9 < np.mean(nis) < 1.1
    if kind == "particle":
        assert found.effective_sample_size.shape == experiment.time.shape
        assert any("Effective sample size" in message for message in found.messages)


def test_unused_outputs_are_compared_and_gaps_are_bridged():
    explicit = friction_servo()
    _, experiment = servo_record(explicit)
    experiment.outputs[100:130, 1] = np.nan
    found = run_filter(
        explicit,
        experiment,
        "ekf",
        FilterOptions(
            process_intensity=INTENSITY, measure=["angle"], smooth=True, hold="zoh", measurement_cov=STD**2
        ),
    )
    assert found.measure == ("angle",) and found.innovations.shape == (400, 1)
    assert np.isnan(found.innovations[100:130]).all()
    speed = found.std[:, found.names.index("speed")]
    expected = np.sqrt(np.mean(speed**2) + STD[0] ** 2)
    assert found.compared["speed"].rms == pytest.approx(expected, rel=0.3)
    angle = found.names.index("phi")
    assert found.std[115, angle] > 1.05 * found.std[60, angle]


@pytest.mark.slow  # test_ekf.py, test_ukf.py, test_particle.py
def test_no_compiler_gives_the_same():
    explicit = friction_servo()
    _, whole = servo_record(explicit, n=12)
    for kind in KINDS:
        compiled, plain = (
            run_filter(
                explicit,
                whole,
                kind,
                FilterOptions(
                    process_intensity=INTENSITY,
                    hold="zoh",
                    n_particles=20,
                    seed=0,
                    longest=0.005,
                    initial=InitialState.known(np.zeros(4), 0.1),
                    compiled=with_compiler,
                    measurement_cov=STD**2,
                ),
            )
            for with_compiler in (True, False)
        )
        assert np.allclose(compiled.values, plain.values, rtol=1e-6, atol=1e-9)
        assert np.allclose(compiled.std, plain.std, rtol=1e-5, atol=1e-9)


def test_bad_requests_are_named():
    explicit = oscillator()
    experiment = experiment_of(explicit, 0.1 * np.arange(10), np.zeros((10, 1)), np.zeros((10, 1)))
    with pytest.raises(EstimationError) as output:
        run_filter(
            explicit,
            experiment,
            "ekf",
            FilterOptions(process_intensity=np.ones(1), measure=["nothing"], measurement_cov=np.ones(1)),
        )
    assert output.value.code == "filter-unknown-output"
    with pytest.raises(EstimationError) as start:
        run_filter(
            explicit,
            experiment,
            "ekf",
            FilterOptions(
                process_intensity=np.ones(1),
                initial=InitialState.known(np.zeros(3)),
                measurement_cov=np.ones(1),
            ),
        )
    assert start.value.code == "filter-initial-state"


# ---- pendulum in Cartesian coordinates, index 3 ----


def pendulum():
    flat = compile_model(Path(__file__).parent / "models" / "Pendulum.mo")
    return flat, reduce_index(flat), redundant_model(flat)


@cache
def full_turns(period=0.02, n=500, push=-8.0):
    """A push that takes the pendulum over the top; angles from the equation in polar coordinates."""
    from scipy.integrate import solve_ivp

    flat, _, _ = pendulum()
    values = {p.name: p.value for p in flat.parameters}
    m, L, d = values["m"], values["L"], values["d"]
    time = period * np.arange(n)
    u = np.zeros((n, 1))
    u[:25] = push

    def rate(t, s, force):
        return [s[1], (-m * 9.81 * np.sin(s[0]) - d * L * s[1] + force * np.cos(s[0])) / (m * L)]

    angle = np.empty((n, 2))
    angle[0] = np.arctan2(0.6, 0.8), 0.0
    for first, last in ((0, 25), (25, n - 1)):  # the force stays
        t = time[first : last + 1]
        given = {"t_eval": t, "args": (u[first, 0],), "rtol": 1e-11, "atol": 1e-12}
        angle[first : last + 1] = solve_ivp(rate, (t[0], t[-1]), angle[first], "DOP853", **given).y.T
    return time, u, angle


def start_of(chosen, redundant, theta, u0):
    x0, xi = initial_point(chosen, theta, u0)
    arguments = (u0, np.zeros(0), np.zeros(len(chosen.flat.noises)), theta, 0.0)
    return matching_states(chosen, redundant, x0, xi, arguments)


def test_pendulum_in_cartesian_coordinates_turns_over_on_its_constraint():
    flat, chosen, redundant = pendulum()
    assert needs_redundant_states(flat)
    assert chosen.n_states == 2 and redundant.n_states == 4
    time, u, angle = full_turns()
    assert np.ptp(angle[:, 0]) > 2 * np.pi  # a full turn and more
    theta = flat.theta_values
    x0 = start_of(chosen, redundant, theta, u[0])
    engine = integrator(redundant, ("m", "d"))
    found = integrate(engine, time, u, theta, x0, hold="zoh", sensitivities=True, rtol=1e-8)
    nothing = np.zeros((1, time.size))
    residual = redundant.invariants(found.states.T, u.T, [], nothing, theta, time[None]).full()
    assert np.max(np.abs(residual)) < 1e-8
    x, y = found.states[:, 0], found.states[:, 1]
    assert np.max(np.abs(x - np.sin(angle[:, 0]))) < 1e-5
    assert np.max(np.abs(y + np.cos(angle[:, 0]))) < 1e-5
    h = 1e-5
    ends = [
        integrate(engine, time, u, theta + h * np.eye(theta.size)[0] * s, x0, hold="zoh", rtol=1e-10).outputs
        for s in (1, -1)
    ]
    slope = (ends[0] - ends[1]) / (2 * h)
    assert np.allclose(found.sensitivities[:, :, 0], slope, atol=1e-3 * np.max(np.abs(slope)))


def test_simulation_passes_where_a_choice_of_states_is_singular():
    flat, _, _ = pendulum()
    time, u, angle = full_turns()
    found = simulate(flat, (time, u), hold="zoh")
    assert found.state_names == ("x", "y", "vx", "vy") and "projected" in found.method
    names = list(found.variable_names)
    x, y = (found.variables[:, names.index(name)] for name in ("x", "y"))
    assert np.max(np.abs(x**2 + y**2 - 1.0)) < 1e-8
    assert np.max(np.abs(x - np.sin(angle[:, 0]))) < 1e-5


def test_interpreted_projection_gives_the_same():
    flat, chosen, redundant = pendulum()
    time, u, _ = full_turns(n=40)
    theta = flat.theta_values
    x0 = start_of(chosen, redundant, theta, u[0])
    runs = [
        integrate(
            integrator(redundant, ("m",), compiled=compiled),
            time,
            u,
            theta,
            x0,
            hold="zoh",
            sensitivities=True,
            rtol=1e-9,
        )
        for compiled in (True, False)
    ]
    assert np.allclose(runs[0].states, runs[1].states, atol=1e-7)
    assert np.allclose(runs[0].sensitivities, runs[1].sensitivities, atol=1e-5)


# A smoother runs its filter first; of particles it takes long.
TURNS = [
    pytest.param(smooth, kind, marks=pytest.mark.slow if not smooth or kind == "particle" else ())
    for smooth in (False, True)
    for kind in KINDS
]


@pytest.mark.parametrize(("smooth", "kind"), TURNS)
def test_pendulum_is_filtered_through_full_turns(kind, smooth):
    _, chosen, _ = pendulum()
    time, u, angle = full_turns()
    truth = np.column_stack([np.sin(angle[:, 0]), -np.cos(angle[:, 0])])
    std = np.full(2, 0.02)
    y = truth + std * np.random.default_rng(0).standard_normal(truth.shape)
    start = InitialState.known(np.array([0.6, 0.0]), 0.05)
    found = run_filter(
        chosen,
        experiment_of(chosen, time, u, y),
        kind,
        FilterOptions(
            process_intensity=np.array([1e-3]),
            smooth=smooth,
            hold="zoh",
            initial=start,
            n_particles=400 if smooth else 200,  # trajectories drawn backwards from 200 meet in one particle
            seed=1,
            measurement_cov=std**2,
        ),
    )
    columns = [found.names.index(name) for name in ("x", "y")]
    error = found.values[:, columns] - truth
    assert np.sqrt(np.mean(error**2)) < 0.4 * 0.02
    # Of two coordinates one is hardly uncertain at a time: the error is measured along the circle.
    along = np.sum(error * np.column_stack([np.cos(angle[:, 0]), np.sin(angle[:, 0])]), axis=1)
    spread = np.sqrt(np.sum(found.std[:, columns] ** 2, axis=1))
    assert (
        0.3 < np.sqrt(np.mean((along / spread) ** 2)) < 1.3
    )  # the truth has no process noise: a little too wide
    assert 0.8 < found.nis.mean < 1.2
    radius = np.hypot(*found.values[:, columns].T)
    # A mean over particles lies inside the circle by half the variance along it; Gaussian estimates are on
    # it.
    assert np.max(np.abs(radius - 1.0)) < (2e-3 if kind == "particle" else 1e-9)
    assert any("constraints" in message for message in found.messages)


def test_pendulum_from_an_unknown_start():
    _, chosen, _ = pendulum()
    time, u, angle = full_turns()
    truth = np.column_stack([np.sin(angle[:, 0]), -np.cos(angle[:, 0])])
    y = truth + 0.02 * np.random.default_rng(1).standard_normal(truth.shape)
    experiment = experiment_of(chosen, time, u, y)
    for kind in ("ekf", "ukf"):
        found = run_filter(
            chosen,
            experiment,
            kind,
            FilterOptions(process_intensity=np.array([1e-3]), hold="zoh", measurement_cov=np.full(2, 4e-4)),
        )
        columns = [found.names.index(name) for name in ("x", "y")]
        assert np.sqrt(np.mean((found.values[50:, columns] - truth[50:]) ** 2)) < 0.4 * 0.02


def test_a_fixed_choice_of_states_is_kept():
    assert not needs_redundant_states(friction_servo().flat)
