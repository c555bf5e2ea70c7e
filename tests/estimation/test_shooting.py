"""Multiple shooting against the truth where single shooting fails, and against independent least squares."""

from functools import cache

import casadi as ca
import numpy as np
import pytest
from nonlinear_models import experiment_of, explicit_from, oscillator, setup_of
from scipy.linalg import expm, null_space
from scipy.optimize import least_squares

from daest.estimation.fitting.coordinates import Unknowns, objective, parameter_coordinate
from daest.estimation.fitting.search import minimise
from daest.estimation.nonlinear import nonlinear_search
from daest.estimation.nonlinear.identify_nonlinear import identify_nonlinear
from daest.estimation.nonlinear.shooting import _Closing, _Tied, search_by_shooting, shooting_of, start_of
from daest.estimation.nonlinear.trajectories import TrajectoryProblem
from daest.model.fit import IdentifyOptions
from daest.systems.simulation.integrate import integrator
from daest.systems.simulation.simulate import simulate


def pendulum():
    """J w' = u - d w - mgl sin(phi), angle measured."""
    return explicit_from(
        ("phi", "w"),
        {"J": 1.0, "d": 0.05, "mgl": 9.0},
        lambda x, u, w, p, t: [x[1], (u[0] - p[1] * x[1] - p[2] * ca.sin(x[0])) / p[0]],
        {"angle": lambda x, u, p: x[0]},
    )


def turning(seed=0, n=800):
    """A motor drives the pendulum through thirty turns; 20 s at 25 ms."""
    explicit = pendulum()
    rng = np.random.default_rng(seed)
    time = 0.025 * np.arange(n)
    u = np.repeat(rng.choice([-6.0, 6.0, 0.0, 9.0], n // 40), 40)[:, None]
    y = simulate(explicit, (time, u), hold="zoh").outputs
    return explicit, experiment_of(explicit, time, u, y + 0.02 * rng.standard_normal(y.shape))


def unknowns_of(explicit, **start):
    coordinates = tuple(parameter_coordinate(explicit.flat, n, v, (0.0, None)) for n, v in start.items())
    return Unknowns(coordinates, explicit.flat.theta_values, np.zeros(0), np.ones(1))


def fit_of(explicit, experiments, shooting=None, hold="zoh", profile=(), second_look=True, **start):
    n_w = len(explicit.flat.noises)
    return identify_nonlinear(
        explicit, setup_of(unknowns_of(explicit, **start), experiments, "oe", np.full(n_w, np.nan),
        np.ones(n_w, dtype=bool), np.array([np.nan]),
        IdentifyOptions(hold=hold, shooting=shooting, profile=profile, second_look=second_look)),
    )  # fmt: skip


def problem_of(explicit, experiments, **start):
    unknowns = unknowns_of(explicit, **start)
    model = integrator(explicit, unknowns.parameter_names())
    return TrajectoryProblem(
        model, tuple(experiments), "zoh", unknowns, np.ones(explicit.n_states), np.array([np.nan])
    )


FAR = [{"J": 1.5, "d": 0.3, "mgl": 4.0}, {"J": 2.5, "d": 0.01, "mgl": 20.0}]


@pytest.mark.parametrize(
    "start",
    [
        pytest.param(FAR[0], id="light", marks=pytest.mark.slow),
        pytest.param(FAR[1], id="heavy", marks=pytest.mark.slow),
    ],
)
def test_pendulum_through_many_turns_is_found_from_a_far_start(start):
    explicit, experiment = turning()
    assert np.ptp(experiment.outputs) > 20 * 2 * np.pi
    truth = dict(zip(("J", "d", "mgl"), explicit.flat.theta_values, strict=True))
    single = fit_of(explicit, [experiment], 1, second_look=False, **start)
    assert single.simulated["estimation"].rms["angle"] > 0.2
    fit = fit_of(explicit, [experiment], second_look=False, **start)
    assert fit.status == "converged" and "found by multiple shooting (20 segments)" in fit.notes
    for p in fit.parameters:
        assert abs(p.value - truth[p.name]) < 4.0 * p.std_error and p.std_error < 0.01 * p.value
    assert fit.simulated["estimation"].rms["angle"] == pytest.approx(0.02, rel=4 / np.sqrt(1600))
    assert fit.log_likelihood > single.log_likelihood + 1000.0


@pytest.mark.slow
@pytest.mark.parametrize("start", FAR, ids=("light", "heavy"))
def test_a_second_look_leads_to_where_shooting_does(start):
    explicit, experiment = turning()
    led = fit_of(explicit, [experiment], 1, **start)
    fit = fit_of(explicit, [experiment], second_look=False, **start)
    assert led.status == "converged" and led.log_likelihood == pytest.approx(fit.log_likelihood, abs=0.01)


@pytest.mark.slow  # any number of segments: the tests below
def test_shooting_ends_where_an_easy_single_search_does():
    explicit = oscillator()
    rng = np.random.default_rng(1)
    time = 0.05 * np.arange(500)
    u = np.repeat(rng.choice([-6.0, 6.0], 25), 20)[:, None]
    y = simulate(explicit, (time, u), hold="zoh").outputs + 0.02 * rng.standard_normal((500, 1))
    y[100:120] = np.nan
    start = {"k": 3.5, "d": 0.6, "k3": 1.5}
    single, several = (fit_of(explicit, [experiment_of(explicit, time, u, y)], n, **start) for n in (1, 7))
    assert several.log_likelihood == pytest.approx(single.log_likelihood, abs=1e-3)
    for a, b in zip(single.parameters, several.parameters, strict=True):
        assert a.value == pytest.approx(b.value, abs=0.01 * a.std_error)
        assert a.std_error == pytest.approx(b.std_error, rel=1e-3)
    assert not single.notes and several.notes == ("found by multiple shooting (7 segments)",)


def swinging(start):
    """A pendulum with dry and viscous friction swings until it stands still: 4 s at 5 ms from the angle
    `start`, integrated with set-valued friction; and the model, with the sign of the speed rounded."""
    explicit = explicit_from(
        ("phi", "w"),
        {"J": 0.006, "d": 0.01, "tau_c": 0.01, "zero": -0.02},
        lambda x, u, w, p, t: [
            x[1],
            (-p[1] * x[1] - p[2] * ca.tanh(x[1] / 0.02) - 0.48 * ca.sin(x[0] - p[3])) / p[0],
        ],
        {"angle": lambda x, u, p: x[0]},
    )
    n, step, substeps = 800, 0.005, 50
    h, phi, w = step / substeps, start, 0.0
    y = np.zeros((n, 1))
    for k in range(n):
        y[k] = phi
        for _ in range(substeps):
            free = w + h * (-0.006 * w - 0.48 * np.sin(phi + 0.03)) / 0.0068
            after = np.sign(free) * max(abs(free) - h * 0.012 / 0.0068, 0.0)
            phi, w = phi + h * (w + after) / 2, after
    y += 1e-3 * np.random.default_rng(0).standard_normal(y.shape)
    return explicit, experiment_of(explicit, step * np.arange(n), np.zeros((n, 1)), y)


@pytest.mark.parametrize(
    ("start", "shooting"),
    [
        (-0.95, 1),
        pytest.param(-0.95, None, marks=pytest.mark.slow),
        pytest.param(-1.2, 1, marks=pytest.mark.slow),
        pytest.param(-1.2, None, marks=pytest.mark.slow),
    ],
)
def test_a_search_that_loses_a_parameter_finds_it_again(start, shooting):
    """Dry and viscous friction take each other's place on the way."""
    explicit, experiment = swinging(start)
    begin = {"J": 0.006, "d": 0.01, "tau_c": 0.01}
    found = fit_of(explicit, [experiment], shooting=shooting, **begin)
    assert found.simulated["estimation"].rms["angle"] < 0.012
    for name, true in (("J", 0.0068), ("d", 0.006), ("tau_c", 0.012)):
        assert found.theta[name] == pytest.approx(true, rel=0.1)


@pytest.mark.slow
def test_two_records_are_cut_apart():
    explicit, first = turning(0, 400)
    _, second = turning(1, 320)
    problem = problem_of(explicit, [first, second], J=1.0, d=0.05, mgl=9.0)
    shooting = shooting_of(problem, 4)
    assert shooting.groups == ((0, 1, 2, 3), (4, 5, 6, 7))
    assert shooting.pairs == [(0, 1), (1, 2), (2, 3), (4, 5), (5, 6), (6, 7)]
    seen = [np.isfinite(e.outputs[:, 0]).sum() for e in shooting.problem.experiments]
    assert sum(seen[:4]) == 400 and sum(seen[4:]) == 320
    for i, j in shooting.pairs:
        a, b = shooting.problem.experiments[i], shooting.problem.experiments[j]
        assert a.time[-1] == b.time[0]
    fit = fit_of(explicit, [first, second], 10, second_look=False, J=1.5, d=0.3, mgl=4.0)
    assert fit.theta["mgl"] == pytest.approx(9.0, rel=0.02) and len(fit.initial_states) == 2


def test_objective_and_gaps_have_the_slopes_of_their_values():
    explicit, experiment = turning(2, 200)
    shooting = shooting_of(problem_of(explicit, [experiment], J=1.2, d=0.1, mgl=7.0), 4)
    tied, rng, h = _Tied(shooting), np.random.default_rng(0), 1e-5
    z = np.concatenate([shooting.problem.unknowns.start, rng.standard_normal(8)])
    here = tied.at(z)
    assert here.gaps.shape == (6,) and here.ties.shape == (6, 11)
    around = [(tied.at(z + h * e, False), tied.at(z - h * e, False)) for e in np.eye(z.size)]
    numeric = np.array([(b.evaluation.value - a.evaluation.value) / (2 * h) for b, a in around])
    assert here.evaluation.gradient == pytest.approx(numeric, rel=1e-3, abs=1e-4 * np.max(np.abs(numeric)))
    ties = np.column_stack([(b.gaps - a.gaps) / (2 * h) for b, a in around])
    assert here.ties == pytest.approx(ties, rel=1e-3, abs=1e-4 * np.max(np.abs(ties)))


def test_step_is_the_best_of_those_that_close_the_linearised_gaps():
    explicit, experiment = turning(2, 200)
    shooting = shooting_of(problem_of(explicit, [experiment], J=1.2, d=0.1, mgl=7.0), 4)
    z = np.concatenate([shooting.problem.unknowns.start, np.random.default_rng(0).standard_normal(8)])
    here, wide = _Tied(shooting).at(z), np.full(z.size, 1e9)
    closing = _Closing(here, 3, (-wide, wide))
    closing.solve(1e-13)
    assert here.ties @ closing.step == pytest.approx(-here.gaps, abs=1e-8 * np.max(np.abs(here.gaps)))
    # The same by a basis of the directions in which no gap opens.
    basis, H = null_space(here.ties), here.evaluation.information
    least = np.linalg.lstsq(here.ties, -here.gaps)[0]
    inside = np.linalg.solve(basis.T @ H @ basis, -basis.T @ (here.evaluation.gradient + H @ least))
    assert closing.step == pytest.approx(least + basis @ inside, rel=1e-5, abs=1e-6)
    assert here.ties @ closing.back(here.gaps) == pytest.approx(-here.gaps, rel=1e-8)


# A model so unstable that no simulation follows it: exp(2 · 20) = 2e17


RATE, GAIN, SENSOR = 2.0, 1.0, 0.01
PERIOD, SAMPLES = 0.05, 400


def unstable_record(seed=0):
    """x' = a x + b u, kept near zero by feedback of the measurement and moved by steps."""
    rng = np.random.default_rng(seed)
    steps = np.repeat(rng.choice([-1.0, 1.0], SAMPLES // 20), 20)
    flow = expm(np.array([[RATE, GAIN], [0.0, 0.0]]) * PERIOD)
    x, u, y = 0.1, np.zeros(SAMPLES), np.zeros(SAMPLES)
    for k in range(SAMPLES):
        y[k] = x + SENSOR * rng.standard_normal()
        u[k] = -6.0 * y[k] + 3.0 * steps[k]
        x = flow[0] @ [x, u[k]]
    explicit = explicit_from(
        ("x",), {"a": RATE, "b": GAIN}, lambda x, u, w, p, t: [p[0] * x[0] + p[1] * u[0]],
        {"y": lambda x, u, p: x[0]},
    )  # fmt: skip
    return explicit, experiment_of(explicit, PERIOD * np.arange(SAMPLES), u[:, None], y[:, None])


def backwards(u, y):
    """Least squares over a, b and the last state: backwards in time the model is stable."""

    def residuals(z):
        flow = expm(np.array([[z[0], z[1]], [0.0, 0.0]]) * PERIOD)
        x, found = z[2], np.zeros(y.size)
        found[-1] = x
        for k in range(y.size - 2, -1, -1):
            x = (x - flow[0, 1] * u[k]) / flow[0, 0]
            found[k] = x
        return y - found

    found = least_squares(residuals, [RATE, GAIN, y[-1]], jac="3-point", x_scale=[1.0, 1.0, 0.1])
    scale = np.mean(found.fun**2)
    return found.x, np.sqrt(scale * np.diagonal(np.linalg.inv(found.jac.T @ found.jac)))


@cache
def unstable_fit():
    """The recording, and its fit that was asked for a profile."""
    explicit, experiment = unstable_record()
    return experiment, fit_of(explicit, [experiment], profile=("a",), a=3.0, b=0.5)


@pytest.mark.slow
def test_other_holds_of_an_unstable_model_are_searched_from_the_given_values_too(monkeypatch):
    """The wrong hold may end far away from them: a balanced arm was a hundred times as heavy, for good."""
    explicit, experiment = unstable_record()
    begun, shot = set(), nonlinear_search._shot

    def told(problem, z, *rest):
        begun.add((problem.hold, tuple(z[:2])))
        return shot(problem, z, *rest)

    monkeypatch.setattr(nonlinear_search, "_shot", told)
    fit = fit_of(explicit, [experiment], hold=None, second_look=False, a=3.0, b=0.5)
    given = tuple(np.log([3.0, 0.5]))
    assert len(begun) == 2 and ("foh", given) in begun and fit.hold == "zoh"


def test_unstable_model_is_identified_from_joined_segments():
    experiment, fit = unstable_fit()
    values, errors = backwards(experiment.inputs[:, 0], experiment.outputs[:, 0])
    assert fit.status == "converged" and any("too unstable" in note for note in fit.notes)
    for p, value, error in zip(fit.parameters, values, errors, strict=False):
        assert p.value == pytest.approx(value, abs=0.02 * error)
        assert p.std_error == pytest.approx(error, rel=0.02)
    assert fit.simulated["estimation"].rms["y"] == pytest.approx(SENSOR, rel=0.15)
    (state,) = fit.initial_states
    assert state.values[0] == pytest.approx(0.1, abs=4 * state.std_errors[0]) and state.std_errors[0] < SENSOR


def test_unstable_model_has_no_profile_but_says_so():
    _, fit = unstable_fit()
    assert not fit.profiles and any(note.startswith("no profile likelihood") for note in fit.notes)


def test_continuous_solution_starts_where_the_record_does():
    explicit, experiment = turning()
    problem = problem_of(explicit, [experiment], J=1.5, d=0.3, mgl=4.0)
    cut = search_by_shooting(problem, np.concatenate([problem.unknowns.start, np.zeros(2)]), 20, 60)
    z = start_of(cut.shooting, cut.found.z)
    assert z.size == 5
    assert problem.unknowns.natural(z[:3]) == pytest.approx([1.0, 0.05, 9.0], rel=0.02)
    assert z[3:] * cut.shooting.problem.state_scale == pytest.approx([0.0, 0.0], abs=0.05)


@pytest.mark.parametrize("n_segments", [1, 2, 6])
def test_any_number_of_segments_ends_where_a_search_without_cuts_does(n_segments):
    explicit, experiment = turning(0, 80)
    problem = problem_of(explicit, [experiment], J=1.2, d=0.1, mgl=7.0)
    start, free = np.concatenate([problem.unknowns.start, np.zeros(2)]), np.full(5, np.inf)
    whole = minimise(objective(problem), start, -free, free, 200)
    cut = search_by_shooting(problem, start, n_segments, 60)
    assert cut.is_continuous and cut.found.reason == "converged"
    assert cut.found.evaluation.value == pytest.approx(whole.evaluation.value, abs=1e-3)
