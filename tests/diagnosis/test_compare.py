"""Comparison of models against the closed form of a first-order lag."""

import json
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from oscillator import OSCILLATOR, record
from scipy.integrate import solve_ivp

from daest.diagnosis.comparison.affine_trial import affine_model, affine_trial
from daest.diagnosis.comparison.compare import compare_models
from daest.diagnosis.comparison.trial import Candidate
from daest.estimation.fitting.records import part_of
from daest.estimation.identify import identify
from daest.model.experiment import Experiment
from daest.model.fit import IdentifyOptions
from daest.model.flat import FlatModel
from daest.model.parts import Equation, NoiseInput, Output, Parameter, Variable
from daest.modelica.change import with_values
from daest.modelica.compile import compile_model, compile_text
from daest.systems.reduction.reduce import reduce_index
from daest.systems.simulation.simulate import simulate

TIME_CONSTANT, GAIN, START, PERIOD = 0.5, 2.0, 0.7, 0.05


def lag(time_constant=TIME_CONSTANT, noise_std=None) -> FlatModel:
    x, dx, u, theta = ca.SX.sym("x"), ca.SX.sym("dx"), ca.SX.sym("u"), ca.SX.sym("theta", 2)
    return FlatModel(
        name="Lag",
        unknowns=(Variable("x", "V"),),
        inputs=(Variable("u", "V"),),
        noises=(),
        parameters=(Parameter("T", time_constant), Parameter("k", GAIN)),
        outputs=(Output("y", "V", noise_std=noise_std),),
        equations=(Equation("T*der(x) = k*u - x", "component", "lag"),),
        derivatives=dx,
        xi=x,
        u=u,
        w=ca.SX(0, 1),
        theta=theta,
        time=ca.SX.sym("t"),
        residual=theta[0] * dx - theta[1] * u + x,
        output_expressions=x,
    )


def exact(n_samples):
    """Time, held input and response from the initial value START."""
    u = np.repeat(np.random.default_rng(0).normal(size=n_samples // 5 + 1), 5)[:n_samples]
    x, keep = np.full(n_samples, START), np.exp(-PERIOD / TIME_CONSTANT)
    for i in range(1, n_samples):
        x[i] = keep * x[i - 1] + (1 - keep) * GAIN * u[i - 1]
    return PERIOD * np.arange(n_samples), u, x


def experiment(time, u, y):
    return Experiment("run", time, u[:, None], y[:, None], ("u",), ("y",))


def test_true_model_simulates_the_record_from_its_own_initial_value():
    time, u, x = exact(200)
    y = x.copy()
    y[20:40] = np.nan
    trial = compare_models([Candidate("lag", lag(), 2, "zoh")], [experiment(time, u, y)]).models[0]
    # Where nothing was measured the model still says what it was.
    assert trial.simulated[0][:, 0] == pytest.approx(x, abs=1e-9)
    assert trial.simulation.fit_percent["y"] == pytest.approx(100.0, abs=1e-6)


def test_wrong_model_is_judged_by_the_measured_samples():
    time, u, x = exact(300)
    y = x + 0.05 * np.random.default_rng(1).standard_normal(300)
    candidates = [Candidate("wrong", lag(5.0), 2, "zoh"), Candidate("true", lag(), 2, "zoh")]
    wrong, true = compare_models(candidates, [experiment(time, u, y)]).models
    for trial in (wrong, true):
        error = y - trial.simulated[0][:, 0]
        assert trial.simulation.rms["y"] == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-9)
        spread = np.linalg.norm(y - y.mean())
        fit = 100 * (1 - np.linalg.norm(error) / spread)
        assert trial.simulation.fit_percent["y"] == pytest.approx(fit, rel=1e-9)
    assert true.simulation.fit_percent["y"] > wrong.simulation.fit_percent["y"]
    assert true.bic < wrong.bic


def test_likelihood_without_process_noise_is_that_of_independent_errors():
    time, u, x = exact(300)
    y = x + 0.05 * np.random.default_rng(1).standard_normal(300)
    trial = compare_models(
        [Candidate("true", lag(noise_std=0.05), 2, "zoh")], [experiment(time, u, y)]
    ).models[0]
    error = y - trial.simulated[0][:, 0]
    expected = -0.5 * np.sum((error / 0.05) ** 2) - 300 * np.log(0.05 * np.sqrt(2 * np.pi))
    assert trial.log_likelihood == pytest.approx(expected, rel=1e-9)
    assert trial.bic == pytest.approx(2 * np.log(300) - 2 * expected, rel=1e-9)


@pytest.mark.parametrize("delay", [0, 1])
@pytest.mark.parametrize(
    ("time_constant", "verdict", "cause"),
    [(0.5, "not falsified", "closed loop."), (0.4, "falsified", "the model lacks something.")],
)
def test_feedback_falsifies_no_right_model(time_constant, verdict, cause, delay):
    """A controller that answers to the measured value of the same sample, or of the one before."""
    rng = np.random.default_rng(3)
    n, x, keep = 2000, 0.0, np.exp(-PERIOD / TIME_CONSTANT)
    u, y, e = np.repeat(rng.normal(size=n // 20), 20), np.zeros(n), 0.1 * rng.normal(size=n)
    for k in range(n):
        y[k] = x + e[k]
        u[k] -= y[k - delay]
        x = keep * x + (1 - keep) * GAIN * u[k]
    run = experiment(PERIOD * np.arange(n), u, y)
    (trial,) = compare_models([Candidate("Lag", lag(time_constant, 0.1), 2, "zoh")], [run]).models
    assert trial.verdict == verdict
    (remark,) = [note for note in trial.notes if note.startswith("the inputs follow the errors of y: ")]
    assert cause in remark


def test_nonlinear_model_is_simulated_from_its_own_initial_value():
    """T x' = -x³ without input has the solution x = 1/sqrt(1/x0² + 2 t/T)."""
    linear = lag()
    x = linear.xi
    cubic = replace(linear, residual=linear.theta[0] * linear.derivatives - 0.0 * linear.u + x**3)
    time = 0.05 * np.arange(100)
    truth = 1.0 / np.sqrt(1.0 / START**2 + 2.0 * time / TIME_CONSTANT)
    y = truth.copy()
    y[10:15] = np.nan
    trial = compare_models([Candidate("cubic", cubic, 1)], [experiment(time, 0.0 * time, y)]).models[0]
    # The integrator works at a relative tolerance of 1e-8.
    assert trial.simulated[0][:, 0] == pytest.approx(truth, abs=1e-5)
    assert trial.simulation.fit_percent["y"] > 99.99
    # Without process noise the prediction is the simulation.
    assert np.array_equal(trial.predicted[0], trial.simulated[0])


ARM = """model Arm "An arm with a pendulum on its end"
  input Real u(unit = "V");
  output Real phi(unit = "rad", start = 0);
  output Real psi(unit = "rad", start = 0);
  Real w(unit = "rad/s", start = 0), r(unit = "rad/s", start = 0);
equation
  der(phi) = w;
  der(w) = 12*(u - w);
  der(psi) = r;
  der(r) = -50*sin(psi) - 0.3*r + 2*der(w) + psi*w^2;
end Arm;
"""


def test_record_that_begins_where_its_inputs_do_not_lead_is_simulated_from_there():
    """An arm at 1 rad whose pendulum swings out: the input is a thousandth of that, and a run from rest
    shows sizes of the states that are no scale for their starts."""
    time = 0.005 * np.arange(900.0)
    u = 1e-3 * np.sin(3.0 * time)

    def rates(t, x):
        rate = 12.0 * (1e-3 * np.sin(3.0 * t) - x[1])
        swing = -50.0 * np.sin(x[2]) - 0.3 * x[3] + 2.0 * rate + x[2] * x[1] ** 2
        return [x[1], rate, x[3], swing]

    x = solve_ivp(rates, (0.0, time[-1]), [1.0, 0.05, 0.3, -0.5], t_eval=time, rtol=1e-9, atol=1e-12).y
    run = Experiment("run", time, u[:, None], x[[0, 2]].T, ("u",), ("phi", "psi"))
    trial = compare_models(
        [Candidate("arm", compile_text(ARM.encode(), Path("Arm.mo")), 0, "foh")], [run]
    ).models[0]
    # Straight lines between the samples of the sine differ from it by 1e-7 of its size.
    assert trial.simulation.rms["phi"] < 1e-6 and trial.simulation.rms["psi"] < 1e-6


def test_error_of_predictions_grows_as_the_covariance_says():
    """Wiener process x' = w: the variance h steps ahead of a stationary filter is P + (h - 1) q T + R."""
    q, r, n = 0.04, 0.1, 20000
    linear = lag()
    w = ca.SX.sym("w")
    wiener = replace(
        linear,
        noises=(NoiseInput("w", intensity=q),),
        w=w,
        residual=linear.derivatives - 0.0 * linear.u - w,
        outputs=(Output("y", "V", noise_std=r),),
    )
    rng = np.random.default_rng(0)
    x = np.cumsum(np.sqrt(q * PERIOD) * rng.standard_normal(n))
    run = experiment(PERIOD * np.arange(n), np.zeros(n), x + r * rng.standard_normal(n))
    trial = compare_models([Candidate("wiener", wiener, 0, "zoh")], [run]).models[0]
    step = q * PERIOD
    P = (step + np.sqrt(step**2 + 4 * step * r**2)) / 2  # of x[k|k-1]
    for horizon in trial.growth:
        expected = P + (horizon.steps - 1) * step + r**2
        # The longest horizon has some n / steps independent errors.
        tolerance = 4 * np.sqrt(horizon.steps / n) + 0.02
        assert horizon.rms["y"] ** 2 == pytest.approx(expected, rel=tolerance)
        assert horizon.seconds == pytest.approx(horizon.steps * PERIOD)
    assert [h.steps for h in trial.growth] == [1, 3, 10, 30, 100, 300]
    assert trial.verdict == "not falsified"


def hardening(tmp_path, cubic):
    path = tmp_path / f"Oscillator{cubic:g}.mo"
    path.write_text(OSCILLATOR.format(extra=f" - {cubic}*x^3"))
    return compile_model(path, "Oscillator")


@pytest.mark.slow  # test_switching.py
def test_nonlinear_models_are_predicted_tested_and_ranked(tmp_path):
    """A cubic spring: its own model is not falsified, a linear one is; BIC and the error fall."""
    true, linear = hardening(tmp_path, 8.0), hardening(tmp_path, 0.0)
    run = record(true, 600, 5)
    trials = compare_models(
        [Candidate("linear", linear, 3, "zoh"), Candidate("cubic", true, 4, "zoh")], [run]
    ).models
    assert [trial.verdict for trial in trials] == ["falsified", "not falsified"]
    assert trials[1].bic < trials[0].bic - 100
    for output in ("y", "v"):
        assert trials[1].one_step.rms[output] < trials[0].one_step.rms[output]
    assert trials[1].growth[0].rms == pytest.approx(trials[1].one_step.rms)
    # Measurement noise 0.05 and what the process noise adds, at most 1e-3 / (2 a b); 200 starts: ±5 % each.
    for horizon in trials[1].growth[1:]:
        assert 0.05 * 0.85 < horizon.rms["y"] < np.sqrt(0.05**2 + 2.5e-4) * 1.15
    assert trials[0].growth[-1].rms["y"] > 1.5 * trials[1].growth[-1].rms["y"]


@pytest.mark.slow
def test_uncertain_parameters_of_a_nonlinear_model_widen_its_tests(tmp_path):
    """What a parameter that is hardly known does to the errors is no fault of the model."""
    true = hardening(tmp_path, 8.0)
    name = true.parameters[0].name
    moved = with_values(true, {name: 1.1 * true.parameters[0].value})
    cov = np.array([[(0.1 * true.parameters[0].value) ** 2]])
    known = Candidate("moved", moved, 1, "zoh")
    unsure = replace(known, parameter_names=(name,), parameter_cov=cov)
    sure, wide = compare_models([known, unsure], [record(true, 300, 7)]).models
    for output, test in wide.tests["variable_independence"].items():
        assert test.statistic < sure.tests["variable_independence"][output].statistic


def test_linear_model_has_the_same_likelihood_through_either_way(tmp_path):
    """A cubic term of size zero cannot be told from none, but may be computed by the nonlinear way."""
    linear, nominal = hardening(tmp_path, 0.0), hardening(tmp_path, 1e-9)
    run = record(linear, 600, 6)
    exact, observed = compare_models(
        [Candidate("linear", linear, 3, "zoh"), Candidate("nominal", nominal, 3, "zoh")], [run]
    ).models
    assert observed.log_likelihood == pytest.approx(exact.log_likelihood, abs=0.5)
    assert observed.one_step.rms["y"] == pytest.approx(exact.one_step.rms["y"], rel=1e-3)
    for kind, by_output in exact.tests.items():
        for output, test in by_output.items():
            assert observed.tests[kind][output].statistic == pytest.approx(test.statistic, rel=0.05)


def test_inputs_are_matched_by_name_for_every_candidate(tmp_path):
    linear, cubic = hardening(tmp_path, 0.0), hardening(tmp_path, 8.0)
    run = record(cubic, 120, 7)
    more = replace(run, inputs=np.column_stack([np.full(120, 9.0), run.inputs]), input_names=("other", "u"))
    for model in (linear, cubic):
        candidate = [Candidate("m", model, 0, "zoh")]
        once, again = (compare_models(candidate, [e]).models[0] for e in (run, more))
        assert once.simulation == again.simulation


@pytest.mark.slow  # measured where: test_where.py
def test_servo_without_fault_passes_and_friction_is_located(shared_data):
    """Coulomb friction at the motor of a linear servo model shows while the shaft is slow."""
    folder = shared_data / "servo_lab" / "known"
    source = Path(__file__).parents[2] / "examples" / "servo" / "Servo.mo"
    verdicts = {}
    for name in ("k1_nothing_hidden", "k2_coulomb_friction_motor"):
        table = np.genfromtxt(folder / f"{name}.csv", delimiter=",", names=True)
        truth = json.loads((folder / f"{name}.json").read_text())["parameters"]
        flat = compile_model(source)
        flat = with_values(flat, {"R": truth["R"]})
        whole = Experiment(
            name, table["time"], table["u"][:, None], np.column_stack([table["omega"], table["phi"]]),
            ("u",), ("omega", "phi"),
        )  # fmt: skip
        half = len(table) // 2
        estimation, validation = part_of(whole, 0, half), part_of(whole, half, len(table))
        fit = identify(flat, [estimation], IdentifyOptions(hold="zoh"))
        values = {n.name: n.value for n in fit.noises}
        fitted = replace(
            with_values(flat, fit.theta),
            noises=tuple(replace(w, intensity=values[w.name]) for w in flat.noises),
            outputs=tuple(replace(y, noise_std=values[y.name]) for y in flat.outputs),
        )
        candidate = Candidate(name, fitted, len(fit.parameters), fit.hold, n_estimation=fit.n_samples)
        verdicts[name] = compare_models([candidate], [validation]).models[0]
    free, rubbing = verdicts.values()
    assert free.verdict == "not falsified" and not free.where
    assert rubbing.verdict == "falsified"
    regions = [f for f in rubbing.where if f.kind == "region" and f.error == "one-step"]
    assert regions[0].variable == "omega" and regions[0].low == -regions[0].high
    assert regions[0].share > 1.3 * regions[0].expected


@pytest.mark.slow  # tests/estimation/test_bootstrap.py
def test_bootstrap_in_processes_is_the_same_to_the_last_bit(monkeypatch):
    monkeypatch.setattr("daest.numerics.parallel.START_SECONDS", -np.inf)
    time, u, x = exact(120)
    record = experiment(time, u, x + 0.02 * np.random.default_rng(4).standard_normal(120))
    candidate = Candidate("Lag", lag(noise_std=0.02), 2, "zoh")
    tests = [
        compare_models([candidate], [record], bootstrap=10, jobs=jobs).models[0].tests for jobs in (1, 2)
    ]
    assert tests[0] and tests[0] == tests[1]


HEATED = Path(__file__).parents[1] / "systems" / "models" / "HeatedServo.mo"


def test_lost_power_is_no_reason_to_leave_the_exact_way(monkeypatch):
    monkeypatch.delattr("daest.diagnosis.comparison.compare.nonlinear_trial")
    flat = compile_model(HEATED, "HeatedServo.Circuit")
    time = 0.01 * np.arange(300)
    u = np.sign(np.sin(7.0 * time + 0.1))
    y = simulate(flat, (time, u[:, None]), hold="zoh").outputs[:, 0]
    y += 0.01 * np.random.default_rng(0).standard_normal(time.size)
    recording, candidate = experiment(time, u, y), Candidate("servo", flat, 0, "zoh")
    found = compare_models([candidate], [recording]).models[0]
    assert found.verdict == "not falsified"
    assert found.simulation.rms["y"] == pytest.approx(0.01, rel=0.15)
    trial = affine_trial(candidate, [recording], affine_model(reduce_index(flat)))
    column = trial.variable_names.index
    current, power = (trial.simulated_variables[0][:, column(name)] for name in ("hot.i", "hot.LossPower"))
    assert power == pytest.approx(2.0 * (1.0 + 0.004 * (350.0 - 300.15)) * current**2, rel=1e-9)


@pytest.mark.parametrize("is_start", [True, False])
def test_size_of_the_noise_contradicts_a_model_only_where_it_is_more_than_the_start_of_an_estimate(is_start):
    time, u, x = exact(2000)
    y = x + 0.05 * np.random.default_rng(1).standard_normal(2000)
    model = lag(noise_std=0.08)
    model = replace(model, outputs=(replace(model.outputs[0], estimate_noise=is_start),))
    trial = compare_models([Candidate("lag", model, 0, "zoh")], [experiment(time, u, y)]).models[0]
    assert trial.verdict == ("not falsified" if is_start else "falsified")
    assert ("y" in trial.tests["nis"]) is not is_start
    assert any("no fit" in note for note in trial.notes) is is_start
