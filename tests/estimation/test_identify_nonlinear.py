"""Nonlinear identification on records of an independent simulator with set-valued friction."""

import dataclasses
import math
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from nonlinear_models import experiment_of, explicit_from, setup_of

import daest.estimation.nonlinear.identify_nonlinear as identify_nonlinear_module
from daest.errors import DaestError, EstimationError
from daest.estimation.fitting.coordinates import Unknowns, parameter_coordinate
from daest.estimation.fitting.records import part_of
from daest.estimation.identify import identify
from daest.estimation.nonlinear import nonlinear_start, trajectories
from daest.estimation.nonlinear.identify_nonlinear import WarmStart, identify_nonlinear, search_on
from daest.model.experiment import Experiment
from daest.model.fit import IdentifyOptions
from daest.model.parts import Equation
from daest.modelica.compile import compile_text
from daest.systems.events.integration import IntegrationError
from daest.systems.reduction.reduce import reduce_index
from daest.systems.simulation.integrate import integrate, integrator
from daest.systems.simulation.simulate import simulate

TRUE = {"J": 0.5, "d": 0.3, "stick": 0.15}
PERIOD, SUBSTEPS, SENSOR = 0.05, 50, 0.005
OPTIONS = IdentifyOptions(hold="zoh")


@cache
def rotor(extra=()):
    """J w' = u - d w - stick tanh(w/0.005) + noise, angle measured."""

    def rhs(x, u, w, theta, t):
        friction = theta[2] * ca.tanh(x[1] / 0.005)
        return [x[1], (u[0] + w[0] - theta[1] * x[1] - friction) / theta[0]]

    return explicit_from(
        ("phi", "w"), {**TRUE, **dict(extra)}, rhs, {"angle": lambda x, u, theta: x[0]}, ("torque",)
    )


@cache
def record(n, seed, noise):
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(-1.0, 1.0, n // 20 + 1), 20)[:n]
    dt = PERIOD / SUBSTEPS
    kicks = rng.standard_normal((n, SUBSTEPS)) * np.sqrt(noise * dt) / TRUE["J"]
    w = phi = 0.0
    y = np.zeros(n)
    # Numbers of Python: those of numpy take many times as long here.
    for k, (push, shocks) in enumerate(zip(u.tolist(), kicks.tolist(), strict=True)):
        y[k] = phi
        for kick in shocks:
            free = w + dt * (push - TRUE["d"] * w) / TRUE["J"] + kick
            after = math.copysign(max(abs(free) - dt * TRUE["stick"] / TRUE["J"], 0.0), free)
            phi, w = phi + dt * (w + after) / 2.0, after
    y += SENSOR * rng.standard_normal(n)
    return experiment_of(rotor(), PERIOD * np.arange(n), u[:, None], y[:, None])


def unknowns_of(explicit, **start):
    coordinates = tuple(
        parameter_coordinate(explicit.flat, name, value, (None, None)) for name, value in start.items()
    )
    return Unknowns(coordinates, explicit.flat.theta_values, np.zeros(1), np.zeros(1))


def identified(experiments, method, intensity=np.nan, explicit=None, validation=(), options=OPTIONS, **start):
    explicit = explicit or rotor()
    unknowns = unknowns_of(explicit, **(start or {"J": 0.8, "d": 0.5, "stick": 0.05}))
    return identify_nonlinear(
        explicit,
        setup_of(
            unknowns,
            experiments,
            method,
            np.array([intensity]),
            np.array([np.isnan(intensity)]),
            np.array([np.nan]),
            options,
            validation,
        ),
    )


@cache
def noisy_fit(method):
    """Of a recording with process noise."""
    return identified([record(1200, 2, 2e-4)], method)


def refit(experiments, warm, **start):
    explicit = rotor()
    options = IdentifyOptions(hold="zoh")
    return search_on(explicit, unknowns_of(explicit, **start), experiments, np.array([True]), options, warm)


def assert_true(fit, tolerance):
    for p in fit.parameters:
        assert p.value == pytest.approx(TRUE[p.name], rel=tolerance), p.name
        assert abs(p.value - TRUE[p.name]) < 4.0 * p.std_error, p.name


def test_output_error_finds_friction_without_process_noise():
    fit = identified([record(500, 1, 0.0)], "oe")
    assert_true(fit, 0.03)
    assert fit.method == "oe" and fit.status == "converged"
    # The model creeps where the simulator sticks: a little more than the noise of the sensor.
    assert SENSOR * 0.95 < fit.simulated["estimation"].rms["angle"] < SENSOR * 1.2


def test_search_by_simulation_ends_where_it_will_not_come_to_what_is_of_use():
    quick = dataclasses.replace(OPTIONS, second_look=False, shooting=1)
    whole = identified([record(300, 1, 0.0)], "oe", options=quick)
    reached = dataclasses.replace(quick, least=whole.log_likelihood - 1.0)
    assert identified([record(300, 1, 0.0)], "oe", options=reached).theta == whole.theta
    missed = dataclasses.replace(quick, least=whole.log_likelihood + 1e4)
    short = identified([record(300, 1, 0.0)], "oe", options=missed)
    assert short.status != "converged" and short.log_likelihood < whole.log_likelihood


def test_rough_start_leads_to_the_same_fit():
    quick = dataclasses.replace(OPTIONS, second_look=False, shooting=1)
    whole = identified([record(300, 1, 0.0)], "oe", options=quick)
    rough = identified([record(300, 1, 0.0)], "oe", options=dataclasses.replace(quick, rtol=1e-5))
    for one, other in zip(whole.parameters, rough.parameters, strict=True):
        assert abs(one.value - other.value) < 0.1 * one.std_error


def test_prediction_error_finds_friction_and_noises_with_process_noise():
    fit = noisy_fit("pem")
    assert_true(fit, 0.1)
    levels = {n.name: n.value for n in fit.noises}
    # The average linearisation takes friction for damping, which asks for up to twice the noise.
    assert 1.5e-4 < levels["torque"] < 5e-4
    assert levels["angle"] == pytest.approx(SENSOR, rel=0.15)
    assert fit.one_step["estimation"].rms["angle"] < fit.simulated["estimation"].rms["angle"]


@pytest.mark.slow
def test_prediction_error_is_the_better_estimate_with_process_noise():
    """Likelihoods of the same data: the simulation does not know the noise of the process."""
    assert noisy_fit("pem").log_likelihood > noisy_fit("oe").log_likelihood + 100.0


def test_validation_tells_simulation_and_prediction_apart():
    whole = record(1200, 2, 2e-4)
    fit = identified([part_of(whole, 0, 600)], "pem", validation=[part_of(whole, 600, 1200)])
    simulated, predicted = fit.simulated["validation"], fit.one_step["validation"]
    assert predicted.rms["angle"] < 2.0 * SENSOR < simulated.rms["angle"]
    assert simulated.fit_percent["angle"] > 80.0 and predicted.fit_percent["angle"] > 98.0


def test_prediction_errors_fall_back_to_the_start_values_where_the_model_can_be_run(monkeypatch):
    """Short fits of the hold may lead to where a parameter does nothing; the way back is to the start."""
    seen = {}

    def moved(problem, z, options):
        seen["start"] = z
        return problem, z + 1e-3

    def checked(setup, problem, z, home):
        seen["z"], seen["home"] = z, home
        raise EstimationError("identify-no-start", "seen")

    monkeypatch.setattr(identify_nonlinear_module, "with_hold", moved)
    monkeypatch.setattr(identify_nonlinear_module, "_checked_start", checked)
    with pytest.raises(EstimationError, match="seen"):
        identified([record(300, 2, 2e-4)], "pem")
    assert np.array_equal(seen["home"], seen["start"]) and not np.array_equal(seen["z"], seen["home"])


def test_warm_start_ends_where_a_cold_one_does():
    experiments = [record(1200, 2, 2e-4)]
    cold = noisy_fit("pem")
    warm = WarmStart(np.array([1e-4]), np.array([0.006]), ({"phi": 0.0, "w": 0.0},))
    again = refit(experiments, warm, J=0.45, d=0.35, stick=0.1)
    assert again.fit.log_likelihood > cold.log_likelihood - 3.0
    assert_true(again.fit, 0.1)
    # How well it agrees with the data is told where that is asked for.
    assert not again.fit.simulated and not again.simulated().one_step
    judged = again.judged(experiments)
    assert judged.one_step["estimation"].rms["angle"] == pytest.approx(
        cold.one_step["estimation"].rms["angle"], rel=1e-2
    )
    assert judged.simulated["validation"].rms["angle"] > judged.one_step["validation"].rms["angle"]


def test_hopeless_warm_start_is_not_pursued():
    experiments = [record(800, 1, 0.0)]
    state = ({"phi": 0.0, "w": 0.0},)
    short = WarmStart(np.array([1e-4]), np.array([0.005]), state, hopeless=np.inf)
    whole = WarmStart(np.array([1e-4]), np.array([0.005]), state)
    fits = [refit(experiments, w, J=0.8, d=0.5, stick=0.05).fit for w in (short, whole)]
    assert fits[0].log_likelihood <= fits[1].log_likelihood + 1e-6


def test_states_that_stood_beside_loads_are_looked_for_first(monkeypatch):
    """Beside a load that is gone the rotor stood far from where it begins, and turned fast: before the first
    iteration it is where it begins."""
    monkeypatch.setattr(identify_nonlinear_module, "ROUGH_ITERATIONS", 0)
    experiments = [record(800, 1, 0.0)]
    far = ({"phi": 500.0, "w": -90.0},)
    fits = {}
    for alone in (True, False):
        warm = WarmStart(np.array([1e-4]), np.array([0.005]), far, is_rough=True, stand_beside=alone)
        fits[alone] = refit(experiments, warm, J=0.45, d=0.35, stick=0.1).fit
    assert fits[True].log_likelihood > fits[False].log_likelihood + 100.0
    known = WarmStart(np.array([1e-4]), np.array([0.005]), ({"phi": 0.0, "w": 0.0},), is_rough=True)
    near = [
        refit(experiments, dataclasses.replace(known, stand_beside=alone), J=0.45, d=0.35, stick=0.1).fit
        for alone in (True, False)
    ]
    assert near[0].log_likelihood == near[1].log_likelihood


@pytest.mark.parametrize(("intensity", "wins"), [(1e-4, False), (1e-1, True)])
def test_second_start_shows_over_a_part_of_the_recordings_whether_it_can_win(monkeypatch, intensity, wins):
    """With next to no noise of the process, where the first start had it right, and where it had far too
    much."""
    lengths = []
    together = identify_nonlinear_module._together

    def counted(setup, problem, *others):
        lengths.append(problem.experiments[0].n_samples)
        return together(setup, problem, *others)

    monkeypatch.setattr(identify_nonlinear_module, "_together", counted)
    monkeypatch.setattr(identify_nonlinear_module, "ROUGH_ITERATIONS", 3)
    experiments = [record(800, 2, 0.0 if wins else 2e-4)]
    warm = WarmStart(np.array([intensity]), np.array([0.006]), ({"phi": 0.0, "w": 0.0},), is_rough=True)
    found = []
    for fewest in (100, np.inf):
        monkeypatch.setattr(identify_nonlinear_module, "FEWEST_IN_SHORT", fewest)
        found.append(refit(experiments, warm, J=0.45, d=0.35, stick=0.1).fit.log_likelihood)
    assert lengths == ([800, 200, 800] if wins else [800, 200]) + [800, 800]
    assert found[0] == found[1]


@pytest.mark.slow  # two records: test_shooting.py
def test_two_records_have_initial_states_of_their_own():
    whole = record(800, 1, 0.0)
    fit = identified([part_of(whole, 0, 400), part_of(whole, 400, 800)], "oe")
    assert_true(fit, 0.05)
    first, second = fit.initial_states
    assert first.values[0] == pytest.approx(0.0, abs=4 * SENSOR)
    assert second.values[0] == pytest.approx(whole.outputs[400, 0], abs=4 * SENSOR)


@pytest.mark.slow  # linear: test_identify.py
def test_missing_samples_are_left_out():
    whole = record(800, 1, 0.0)
    y = whole.outputs.copy()
    y[100:200] = np.nan
    fit = identified([experiment_of(rotor(), whole.time, whole.inputs, y)], "oe")
    assert_true(fit, 0.05)


def test_parameter_without_influence_is_named():
    explicit = rotor((("idle", 1.0),))
    with pytest.raises(EstimationError) as caught:
        identified([record(400, 1, 0.0)], "oe", explicit=explicit, J=0.5, idle=1.0)
    assert caught.value.code == "identify-no-influence" and "idle" in caught.value.what


def test_parameters_that_change_together_are_named():
    def rhs(x, u, w, theta, t):
        return [x[1], u[0] + w[0] - theta[0] * theta[1] * ca.tanh(x[1])]

    explicit = explicit_from(
        ("phi", "w"), {"a": 1.0, "b": 0.5}, rhs, {"angle": lambda x, u, theta: x[0]}, ("torque",)
    )
    with pytest.raises(EstimationError) as caught:
        identified([record(400, 1, 0.0)], "oe", explicit=explicit, a=1.0, b=0.5)
    assert caught.value.code == "identify-unidentifiable" and caught.value.where == "a, b"


def test_model_that_cannot_be_integrated_is_an_error():
    def rhs(x, u, w, theta, t):
        return [x[1], ca.sqrt(-1.0 - theta[0] * x[0] ** 2) + u[0] + w[0]]

    explicit = explicit_from(("phi", "w"), {"a": 1.0}, rhs, {"angle": lambda x, u, theta: x[0]}, ("torque",))
    with pytest.raises(EstimationError) as caught:
        identified([record(400, 1, 0.0)], "oe", explicit=explicit, a=1.0)
    assert caught.value.code == "identify-no-start"


def simulated(explicit, n=300, noise=0.005, seed=0, period=PERIOD, drive=1.0):
    rng = np.random.default_rng(seed)
    time = period * np.arange(n)
    u = np.repeat(rng.uniform(0.0, drive, n // 20), 20)[:, None]
    y = simulate(explicit, (time, u), hold="zoh").outputs
    return experiment_of(explicit, time, u, y + noise * rng.standard_normal(y.shape))


def test_search_steps_back_from_values_where_the_model_fails(monkeypatch):
    """Beyond the root the rate is no number; the first step of the search leads there."""

    def rhs(x, u, w, theta, t):
        return [u[0] + w[0] - ca.sqrt(theta[0]) * x[0]]

    explicit = explicit_from(("x",), {"a": 0.1}, rhs, {"y": lambda x, u, theta: x[0]}, ("torque",))
    experiment = simulated(explicit)
    failed = []
    run = trajectories.integrated

    def counted(problem, z, *more):
        try:
            return run(problem, z, *more)
        except IntegrationError:
            failed.append(problem.theta(z)[0])
            raise

    monkeypatch.setattr(trajectories, "integrated", counted)
    fit = identified([experiment], "oe", explicit=explicit, a=3.0)
    assert failed and max(failed) < 0.0
    (a,) = fit.parameters
    assert fit.status == "converged" and abs(a.value - 0.1) < 4.0 * a.std_error < 0.01


def test_mass_that_vanishes_on_the_way_is_told_with_its_time():
    """J cos(phi) is zero at a quarter turn, which the motion reaches at the start values."""

    def rhs(x, u, w, theta, t):
        return [x[1], (u[0] + w[0]) / (theta[0] * ca.cos(x[0]))]

    explicit = explicit_from(("phi", "w"), {"J": 0.5}, rhs, {"y": lambda x, u, theta: x[0]}, ("torque",))
    time = PERIOD * np.arange(200)
    record = experiment_of(explicit, time, np.ones((200, 1)), np.zeros((200, 1)))
    with pytest.raises(EstimationError) as caught:
        identify_nonlinear(
            explicit,
            setup_of(
                unknowns_of(explicit, J=0.5),
                [record],
                "oe",
                np.array([np.nan]),
                np.array([True]),
                np.array([np.nan]),
                IdentifyOptions(hold="zoh", shooting=1),
            ),
        )
    assert caught.value.code == "identify-no-start"
    assert "stopped at t = " in caught.value.what and "singularity" in caught.value.what


def test_start_without_consistent_values_is_told():
    """No x makes exp(x) + 1 = 0."""
    flat = explicit_from(
        ("x",), {"a": 1.0}, lambda x, u, w, p, t: [u[0] + w[0] - p[0] * x[0]], {"y": lambda x, u, p: x[0]},
        ("torque",),
    ).flat  # fmt: skip
    impossible = dataclasses.replace(
        flat,
        initial_equations=(Equation("exp(x) + 1 = 0", "component", ""),),
        initial_residual=ca.exp(flat.xi[0]) + 1.0,
    )
    explicit = reduce_index(impossible)
    time = PERIOD * np.arange(100)
    record = experiment_of(explicit, time, np.ones((100, 1)), np.zeros((100, 1)))
    with pytest.raises(DaestError) as caught:
        identified([record], "oe", explicit=explicit, a=1.0)
    # Newton's method runs to where the slope vanishes, too: there the condition contradicts the model.
    assert caught.value.code in ("initial-not-solved", "initial-overdetermined")
    assert "exp(x) + 1 = 0" in caught.value.what and caught.value.remedy


TANK = """
model Tank
  input Real u;
  parameter Real R(min = 0) = 1 annotation(__Daest(estimate = true));
  parameter Real k(min = 0) = 1 annotation(__Daest(estimate = true));
  parameter Real rim(min = 0) = 3 annotation(__Daest(estimate = true));
  Real h(start = 0, fixed = true);
  output Real y = h annotation(__Daest(std = 0.01));
equation
  der(h) = u - h/R - k*max(h - rim, 0);
end Tank;
"""


def test_law_that_the_start_values_never_reach_waits_for_the_other_parameters():
    flat = compile_text(TANK.encode(), Path("Tank.mo"))
    rng = np.random.default_rng(5)
    time, flow = 0.1 * np.arange(400), np.repeat(rng.uniform(0.2, 1.8, 20), 20)[:, None]
    theta, truth = {p.name: i for i, p in enumerate(flat.parameters)}, flat.theta_values.copy()
    for name, value in {"R": 4.0, "k": 2.0, "rim": 3.2}.items():
        truth[theta[name]] = value
    run = integrate(integrator(reduce_index(flat)), time, flow, truth, np.zeros(1), hold="zoh")
    measured = run.outputs + rng.normal(0.0, 0.01, run.outputs.shape)
    fit = identify(
        flat, [Experiment("tank", time, flow, measured, ("u",), ("y",))], IdentifyOptions(hold="zoh")
    )
    for name, value in {"R": 4.0, "k": 2.0, "rim": 3.2}.items():
        (found,) = (p for p in fit.parameters if p.name == name)
        assert abs(found.value - value) < 4.0 * found.std_error and found.std_error < 0.1 * value
    assert any("k, rim did nothing at the start values" in note for note in fit.notes)


def test_a_load_at_rest_is_scaled_by_what_it_does_to_the_outputs() -> None:
    """In units of 1 N.m a search would creep towards a load of thousands, and not see one of thousandths."""
    for size in (1e-3, 1e4):
        explicit = explicit_from(
            ("w", "load"),
            {"J": size, "d": size},
            lambda x, u, w, p, t: [(u[0] - p[1] * x[0] + x[1]) / p[0], -0.1 * x[1]],
            {"y": lambda x, u, p: x[0]},
        )
        time = 0.1 * np.arange(200)
        u = size * np.sin(time)
        y = 0.7 * np.sin(time - 0.8)[:, None]
        unknowns = Unknowns((), np.array([size, size]), np.zeros(0), np.ones(1))
        problem = trajectories.TrajectoryProblem(
            integrator(explicit), (experiment_of(explicit, time, u[:, None], y),), "zoh", unknowns,
            np.ones(2), np.array([np.nan]),
        )  # fmt: skip
        found, _ = nonlinear_start.scaled(problem, np.r_[problem.unknowns.start, 0.0, 0.0])
        assert 0.1 * size < found.state_scale[1] < 10.0 * size


def test_a_state_at_rest_is_not_resolved_to_its_rounding(monkeypatch: pytest.MonkeyPatch) -> None:
    """A load that stays at zero but for rounding would set a tolerance of its own, and its search steps as
    short as that asks for. A charge of picocoulombs beside volts is no rounding."""

    @dataclasses.dataclass(frozen=True)
    class Problem:
        unknowns: SimpleNamespace
        experiments: tuple[None, ...]
        state_scale: np.ndarray

    states = np.array([[0.0, 0.0, 0.0, 0.0], [-0.2, 90.0, 3e-23, 1e-12]])
    runs = SimpleNamespace(trajectories=[SimpleNamespace(states=states)])
    monkeypatch.setattr(nonlinear_start, "prediction_errors", lambda problem, z: runs)
    monkeypatch.setattr(nonlinear_start, "objective", lambda problem: lambda z, slopes: None)
    problem = Problem(SimpleNamespace(coordinates=()), (None,), np.ones(4))
    found, z = nonlinear_start.scaled(problem, np.array([0.1, 9.0, 1e-24, 0.0]))  # type: ignore[arg-type]
    np.testing.assert_allclose(found.state_scale, [0.2, 90.0, 1.0, 1e-12])
    np.testing.assert_allclose(z, [0.5, 0.1, 1e-24, 0.0])


def test_scale_of_a_state_follows_when_it_has_far_outgrown_it() -> None:
    """The force of a spring that did nothing in the simulation which the scales are read off."""
    explicit = explicit_from(
        ("w", "z"),
        {"d": 1.0},
        lambda x, u, w, p, t: [-p[0] * x[0] + u[0], -x[1]],
        {"y": lambda x, u, p: x[0]},
    )
    time = 0.1 * np.arange(50)
    record = experiment_of(explicit, time, np.sin(time)[:, None], np.sin(time)[:, None])
    unknowns = Unknowns((), np.array([1.0]), np.zeros(0), np.ones(1))
    problem = trajectories.TrajectoryProblem(
        integrator(explicit), (record,), "zoh", unknowns, np.array([0.5, 1.0]), np.array([np.nan])
    )
    z = np.array([0.2, 700.0])
    found, moved = nonlinear_start.with_outgrown_scales(problem, z)
    np.testing.assert_allclose(found.state_scale, [0.5, 700.0])
    np.testing.assert_allclose(found.initial_states(moved), problem.initial_states(z))
    # One that is a few scales large keeps them: another scale is another path of the search.
    same, kept = nonlinear_start.with_outgrown_scales(problem, np.array([0.2, 5.0]))
    assert same is problem and kept[1] == 5.0
