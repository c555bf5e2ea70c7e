"""Identification: known truths, honest uncertainty, robustness, and every refusal."""

import json
from dataclasses import replace

import casadi as ca
import hand_models as hand
import numpy as np
import pytest
from scipy.signal import decimate, lfilter

from daest.errors import EXPLANATIONS, DaestError, EstimationError
from daest.estimation.fitting.identifiability import ROUNDING, std_errors
from daest.estimation.fitting.setup import check_records
from daest.estimation.identify import identify
from daest.model.experiment import Experiment
from daest.model.fit import IdentifyOptions, NoiseChoice
from daest.model.parts import Parameter
from daest.report.documents.fit import document
from daest.systems.linear.state_space import sample, state_space

TRUE = {"d": 0.0226, "c": 1.4367, "J1": 6.838e-6, "J2": 0.02054, "R": 4.316, "k": 0.0675, "n": 30.0}
NAMES = ("d", "c", "J1", "J2", "k")
UNKNOWN_NOISE = {"intensity": None, "estimate": True}
# One search: whether another start would end elsewhere is for test_optimum and the tests of starts below.
ONCE = IdentifyOptions(hold="foh", second_look=False)


def theta_of(family, values):
    return np.array([values[p.name] for p in family.parameters])


def simulated(seed, intensity=0.0, n_samples=1500, period=0.01, x0=(0.3, 0.1, -0.1, 0.5), values=TRUE):
    family = hand.servo(values, noise={"intensity": intensity})
    model = sample(state_space(family, theta_of(family, values)), period, "foh", np.array([intensity]))
    u = hand.multisine(n_samples, period, seed)[:, None]
    return hand.recording(model, u, [0.02, 0.01], 1000 + seed, x0=x0, name=f"run{seed}")


def rig(start=hand.RIG_START, noise=None, **given):
    return hand.servo({**TRUE, **start}, noise=noise, **given)


def errors(result, truth=TRUE):
    """(estimate - truth) / std_error by name."""
    return {p.name: (p.value - truth[p.name]) / p.std_error for p in result.parameters}


def squared_error(result, truth=TRUE):
    """Normalised squared error of all parameters together: chi-square with as many degrees of freedom."""
    error = np.array([p.value - truth[p.name] for p in result.parameters])
    std = np.array([p.std_error for p in result.parameters])
    p = error.size
    return float(error @ np.linalg.solve(result.correlation[:p, :p] * np.outer(std, std), error))


def known(shared_data, number):
    """(experiment, truth) of a servo_lab recording whose truth is known."""
    path = next((shared_data / "servo_lab" / "known").glob(f"k{number}_*.csv"))
    truth = json.loads(path.with_suffix(".json").read_text())["parameters"]
    return hand.read_csv(path, "time", {"u": "u"}, {"omega": "omega", "phi": "phi"}), truth


# Recordings with a known truth


@pytest.mark.parametrize("method", ["oe", pytest.param("pem", marks=pytest.mark.slow)])
def test_k1_parameters_within_three_standard_errors(shared_data, method):
    experiment, truth = known(shared_data, 1)
    family = hand.servo({**truth, **hand.RIG_START}, noise=UNKNOWN_NOISE if method == "pem" else None)
    result = identify(family, [experiment], IdentifyOptions(method=method, split=0.5))
    assert result.status == "converged"
    assert max(abs(e) for e in errors(result, truth).values()) < 3.0
    assert min(result.simulated["validation"].fit_percent.values()) >= 98.0
    assert result.weak_directions == ()
    # The rig's voltage is held between its samples.
    assert result.hold == "zoh"
    std = {n.name: n for n in result.noises if n.kind == "measurement"}
    assert std["omega"].value == pytest.approx(0.02, abs=4 * std["omega"].std_error)
    assert std["phi"].value == pytest.approx(0.01, abs=4 * std["phi"].std_error)


@pytest.mark.slow  # the hold that a record tells: test_holds.py
def test_k1_resampled_to_the_report_s_period_keeps_its_fit(shared_data):
    experiment, truth = known(shared_data, 1)
    columns = np.hstack([experiment.inputs, experiment.outputs])
    slow = np.column_stack([decimate(column, 5, ftype="fir", zero_phase=True) for column in columns.T])
    slow_experiment = Experiment(
        "k1", experiment.time[::5], slow[:, :1], slow[:, 1:], ("u",), ("omega", "phi")
    )
    family = hand.servo({**truth, **hand.RIG_START})
    result = identify(family, [slow_experiment], IdentifyOptions(split=0.5))
    assert result.hold == "foh"
    assert result.period == pytest.approx(0.05)
    assert min(result.simulated["validation"].fit_percent.values()) >= 97.5
    held = identify(family, [slow_experiment], IdentifyOptions(split=0.5, hold="zoh"))
    assert held.simulated["validation"].fit_percent["omega"] < 90.0


@pytest.mark.parametrize("method", ["oe", pytest.param("pem", marks=pytest.mark.slow)])
def test_k7_knows_three_parameters_only_together(shared_data, method):
    experiment, truth = known(shared_data, 7)
    family = hand.servo({**truth, **hand.REPORT_START}, noise=UNKNOWN_NOISE if method == "pem" else None)
    result = identify(family, [experiment], IdentifyOptions(method=method, split=0.5))
    assert max(abs(e) for e in errors(result, truth).values()) < 3.0
    (weak,) = result.weak_directions
    assert weak.combination == {"d": 1.0, "c": 1.0, "J2": 1.0}
    assert 0.01 < weak.relative_std < 0.1
    assert "d, c and J2 are known only up to a common factor" in result.message


@pytest.mark.slow
def test_positioning_system_agrees_with_the_literature(shared_data):
    train, test = (
        hand.read_csv(
            shared_data / "emps" / name, "time_s", {"F": "motor_force_N"}, {"position": "position_m"}
        )
        for name in ("train.csv", "test_pulses.csv")
    )
    result = identify(hand.positioning_system(), [train], validation=[test])
    found = {p.name: p for p in result.parameters}
    assert result.status == "converged"
    # Without Coulomb friction the viscous one comes out about twice the published 203.5 N.s/m.
    assert 1.8 < found["Fv"].value / 203.5 < 2.2
    assert 85.0 < found["M"].value < 125.0
    assert found["offset"].value == pytest.approx(-3.16, abs=0.2)
    # Published: best linear state-space model 5.53 mm.
    assert result.simulated["validation"].rms["position"] < 5.53e-3
    assert any("not white" in note for note in result.notes)


@pytest.mark.slow
def test_positioning_system_by_maximum_likelihood_finds_the_mass(shared_data):
    path = shared_data / "emps" / "train.csv"
    train = hand.read_csv(path, "time_s", {"F": "motor_force_N"}, {"position": "position_m"})
    result = identify(hand.positioning_system(noise=True), [train])
    found = {p.name: p.value for p in result.parameters}
    assert found["M"] == pytest.approx(95.11, rel=0.08)
    assert 1.8 < found["Fv"] / 203.5 < 2.2


# Uncertainty


@pytest.mark.slow
def test_standard_errors_are_honest_with_measurement_noise():
    values = [
        squared_error(identify(rig(), [simulated(seed)], IdentifyOptions(hold="foh"))) for seed in range(20)
    ]
    # Mean of 20 chi-squares with 5 degrees of freedom: 5 with standard deviation 0.71.
    assert abs(np.mean(values) - 5.0) < 3 * 0.71


@pytest.mark.slow
@pytest.mark.parametrize("intensity", [0.0, 1e-4])
def test_standard_errors_are_honest_with_process_noise(intensity):
    options = IdentifyOptions(method="pem", hold="foh")
    values = [
        squared_error(identify(rig(noise=UNKNOWN_NOISE), [simulated(seed, intensity)], options))
        for seed in range(20)
    ]
    assert abs(np.mean(values) - 5.0) < 3 * 0.71


@pytest.mark.slow
def test_output_error_knows_that_process_noise_makes_it_uncertain():
    options = IdentifyOptions(method="oe", hold="foh")
    results = [identify(rig(), [simulated(seed, 1e-4, n_samples=8000)], options) for seed in range(20)]
    assert all(any("not white" in note for note in r.notes) for r in results)
    assert abs(np.mean([squared_error(r) for r in results]) - 5.0) < 3 * 0.71


def test_process_noise_is_found_with_its_size():
    result = identify(rig(noise=UNKNOWN_NOISE), [simulated(4, 1e-4, n_samples=4000)], ONCE)
    assert result.method == "pem"
    (load,) = [n for n in result.noises if n.kind == "process"]
    assert load.at_bound is None
    assert load.value == pytest.approx(1e-4, abs=4 * load.std_error)
    assert load.std_error < 0.2 * load.value


def test_process_noise_that_is_not_there_is_said_to_be_absent():
    result = identify(rig(noise=UNKNOWN_NOISE), [simulated(4)], ONCE)
    (load,) = [n for n in result.noises if n.kind == "process"]
    assert load.at_bound == "min"
    assert load.std_error is None
    assert "no process noise at load.tau" in result.message


def test_given_noises_stay_as_they_are():
    options = replace(
        ONCE,
        process_noise={"load.tau": NoiseChoice(2e-4, False)},
        measurement_noise={"phi": NoiseChoice(0.013, False)},
    )
    result = identify(rig(noise=UNKNOWN_NOISE), [simulated(4, 1e-4)], options)
    noises = {n.name: n for n in result.noises}
    assert noises["load.tau"].value == 2e-4
    assert not noises["load.tau"].estimated
    assert noises["phi"].value == 0.013
    assert noises["omega"].estimated


# Start values, bounds, records


@pytest.mark.slow  # test_arx.py, test_far_starts.py
@pytest.mark.parametrize("method", ["oe", pytest.param("pem", marks=pytest.mark.slow)])
@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3))])
def test_start_values_off_by_ten_lead_to_the_same_optimum(seed, method):
    noise = UNKNOWN_NOISE if method == "pem" else None
    far = {
        n: TRUE[n] * 10.0**sign
        for n, sign in zip(NAMES, np.random.default_rng(seed).choice([-1, 1], 5), strict=True)
    }
    options = IdentifyOptions(method=method, hold="foh")
    near, reached = (identify(rig(start, noise), [simulated(seed)], options) for start in (TRUE, far))
    assert reached.status == "converged"
    assert reached.log_likelihood == pytest.approx(near.log_likelihood, abs=0.01)
    assert [p.initial for p in reached.parameters] == pytest.approx([far[n] for n in NAMES])


@pytest.mark.slow
def test_more_starts_are_repeatable_and_reported():
    options = IdentifyOptions(starts=3, seed=5, hold="foh")
    first, again = (identify(rig(), [simulated(2)], options) for _ in range(2))
    assert first.start_log_likelihoods == again.start_log_likelihoods
    assert len(first.start_log_likelihoods) >= 3
    assert list(first.start_log_likelihoods) == sorted(first.start_log_likelihoods, reverse=True)
    assert "starts reached this likelihood" in first.message


def test_a_bound_that_binds_is_flagged():
    result = identify(
        rig(), [simulated(2, n_samples=600)], replace(ONCE, bounds={"c": (None, 1.4)}, start={"c": 1.3})
    )
    found = {p.name: p for p in result.parameters}
    assert found["c"].value == pytest.approx(1.4)
    assert found["c"].at_bound == "max"
    assert found["c"].std_error is None
    assert found["J1"].at_bound is None
    assert "At a bound: c (max)" in result.message


def test_a_parameter_that_the_data_drive_to_zero_is_at_its_bound():
    # The record grows (a = -0.05), the model allows decay only.
    family = hand.family_from(
        [("x", "1")], ["u"], [], ["y"], [Parameter("a", 0.3, min=0.0, estimate=True)],
        lambda x, u, w, p: ca.vertcat(-p[0] * x[0] + u[0]), lambda x, u, w, p: x[0],
    )  # fmt: skip
    rng = np.random.default_rng(0)
    u = rng.standard_normal((400, 1))
    model = sample(state_space(family, np.array([-0.05])), 0.05)
    run = hand.recording(model, u, [0.01], 1, outputs=("y",))
    result = identify(family, [run], IdentifyOptions(hold="foh"))
    (a,) = result.parameters
    assert a.value < 1e-3
    assert a.at_bound == "min"
    assert a.std_error is None
    assert "At a bound: a (min)" in result.message
    assert result.weak_directions == ()


def test_experiments_together_tell_more_than_each():
    runs = [simulated(seed, x0=(seed, 0.1 * seed, -0.2, 0.0)) for seed in (1, 2, 3)]
    together = identify(rig(), runs, ONCE)
    alone = identify(rig(), runs[:1], ONCE)
    assert [s.experiment for s in together.initial_states] == ["run1", "run2", "run3"]
    for state, run in zip(together.initial_states, (1, 2, 3), strict=True):
        assert abs(state.values[0] - run) < 4 * state.std_errors[0]
    for p, q in zip(together.parameters, alone.parameters, strict=True):
        assert p.std_error < q.std_error
    assert max(abs(e) for e in errors(together).values()) < 4.0
    assert together.n_samples == 4500


@pytest.mark.slow  # their likelihood: test_likelihood.py
def test_missing_and_dropped_samples_are_no_obstacle():
    complete = simulated(6, 1e-4, n_samples=350)
    rng = np.random.default_rng(0)
    holes = np.where(rng.random(complete.outputs.shape) < 0.1, np.nan, complete.outputs)
    kept = np.sort(rng.choice(np.arange(350), 325, replace=False))
    dropped = replace(
        complete, time=complete.time[kept], inputs=complete.inputs[kept], outputs=complete.outputs[kept]
    )
    incomplete = (replace(complete, outputs=holes), dropped)
    for experiment in incomplete:
        result = identify(rig(noise=UNKNOWN_NOISE), [experiment], replace(ONCE, method="pem"))
        assert max(abs(e) for e in errors(result).values()) < 3.5
    # Output error does not know the process noise, which moves all of its estimates alike.
    whole, *others = (
        identify(rig(), [experiment], replace(ONCE, method="oe")) for experiment in (complete, *incomplete)
    )
    for result in others:
        for p, q in zip(result.parameters, whole.parameters, strict=True):
            assert abs(p.value - q.value) < 2.0 * q.std_error


@pytest.mark.slow  # their likelihood: test_likelihood.py
def test_uneven_samples_are_identified():
    family = hand.servo(TRUE)
    rng = np.random.default_rng(1)
    n = 200
    time = np.cumsum(rng.uniform(0.005, 0.02, n))
    ss = state_space(family, theta_of(family, TRUE))
    u = 6.0 * np.sin(np.outer(time, [1.3, 4.1, 9.7, 17.0])).sum(axis=1)[:, None] / 4
    x, states = np.array([0.3, 0.1, -0.1, 0.5]), []
    for k in range(n):
        states.append(x)
        if k < n - 1:
            step = sample(ss, time[k + 1] - time[k])
            x = step.transition @ x + step.input_now @ u[k] + step.input_next @ u[k + 1]
    y = np.array(states) @ ss.C.T + [0.02, 0.01] * rng.standard_normal((n, 2))
    uneven = Experiment("uneven", time, u, y, ("u",), ("omega", "phi"))
    result = identify(rig(), [uneven], replace(ONCE, hold=None))
    assert result.period is None
    assert result.hold == "foh"
    assert max(abs(e) for e in errors(result).values()) < 3.5


def test_one_output_is_enough_when_the_other_was_not_recorded():
    run = simulated(3, n_samples=2000)
    only_phi = replace(run, outputs=run.outputs[:, 1:], output_names=("phi",))
    result = identify(rig(estimate=("c", "J2", "d")), [only_phi], ONCE)
    assert max(abs(e) for e in errors(result).values()) < 3.5
    assert result.simulated["estimation"].fit_percent["omega"] is None
    assert "output omega has no measured value" in result.notes


@pytest.mark.slow  # test_shooting.py
def test_an_unstable_plant_is_identified_by_prediction():
    # ẋ = a x + u + w with a > 0, in the loop u = -3 x + r: a simulation drifts away, the predictor follows.
    family = hand.family_from(
        [("x", "1")], ["u"], [("w", UNKNOWN_NOISE)], ["y"], [Parameter("a", 1.0, estimate=True)],
        lambda x, u, w, p: ca.vertcat(p[0] * x[0] + u[0] + w[0]), lambda x, u, w, p: x[0],
    )  # fmt: skip
    model = sample(state_space(family, np.array([1.7])), 0.05, "zoh", np.array([0.05]))
    rng = np.random.default_rng(3)
    x, rows = 0.0, []
    for _ in range(800):
        u = -3.0 * x + rng.standard_normal()
        rows.append((u, x + 0.01 * rng.standard_normal()))
        noise = np.sqrt(model.process_cov[0, 0]) * rng.standard_normal()
        x = model.transition[0, 0] * x + model.input_now[0, 0] * u + noise
    table = np.array(rows)
    experiment = Experiment("loop", 0.05 * np.arange(800), table[:, :1], table[:, 1:], ("u",), ("y",))
    result = identify(family, [experiment], IdentifyOptions(hold="zoh"))
    (a,) = result.parameters
    assert abs(a.value - 1.7) < 3.5 * a.std_error
    assert a.std_error < 0.2


def test_noise_free_data_give_the_exact_parameters():
    family = hand.servo(TRUE)
    model = sample(state_space(family, theta_of(family, TRUE)), 0.01)
    u = hand.multisine(800, 0.01, 1)[:, None]
    result = identify(rig(), [hand.recording(model, u, [0.0, 0.0], 0)], ONCE)
    for p in result.parameters:
        assert p.value == pytest.approx(TRUE[p.name], rel=1e-4)


@pytest.mark.slow
def test_starts_that_agree_end_the_search_for_a_better_optimum():
    result = identify(rig(), [with_slow_noise()], IdentifyOptions(method="oe", hold="foh"))
    assert any("not white" in note for note in result.notes)
    assert len(result.start_log_likelihoods) == 4 and "4 of 4 starts" in result.message


@pytest.mark.slow
def test_starts_that_are_asked_for_are_all_tried():
    options = IdentifyOptions(method="oe", hold="foh", starts=3)
    assert len(identify(rig(), [with_slow_noise()], options).start_log_likelihoods) >= 3


def with_slow_noise():
    """Slow noise on the sensors leaves coloured residuals at the only optimum there is."""
    quiet = simulated(1, n_samples=250)
    rng = np.random.default_rng(0)
    slow = lfilter([1.0], [1.0, -0.95], 0.02 * rng.standard_normal(quiet.outputs.shape), axis=0)
    return replace(quiet, outputs=quiet.outputs + slow)


@pytest.mark.slow  # tests/cli/test_schemas.py
def test_document_is_plain_json_without_nan(shared_data):
    experiment, truth = known(shared_data, 7)
    family = hand.servo({**truth, **hand.REPORT_START}, noise=UNKNOWN_NOISE)
    result = identify(family, [experiment], replace(ONCE, split=0.5))
    content = document(result)
    assert json.loads(json.dumps(content, allow_nan=False)) == content
    assert set(content["parameters"]["J1"]) == {
        "value", "std_error", "initial", "unit", "min", "max", "at_bound", "prior",
    }  # fmt: skip
    assert set(content["fit_percent"]) == {"estimation", "validation"}
    assert set(content["one_step"]["rms"]["validation"]) == {"omega", "phi"}
    assert content["theta"]["R"] == truth["R"]


# Refusals


def without_influence():
    parameters = [Parameter("a", 1.0, estimate=True), Parameter("idle", 2.0, min=0.0, estimate=True)]
    return hand.family_from(
        [("x", "1")], ["u"], [], ["y"], parameters,
        lambda x, u, w, p: ca.vertcat(-p[0] * x[0] + u[0]), lambda x, u, w, p: x[0],
    )  # fmt: skip


def offset_of_a_store():
    """The voltage of a battery: the charge at the start does all that the offset does."""
    parameters = [Parameter("k", 1.3, min=0.0, estimate=True), Parameter("offset", 3.1, estimate=True)]
    return hand.family_from(
        [("x", "1")], ["u"], [], ["y"], parameters,
        lambda x, u, w, p: ca.vertcat(u[0]), lambda x, u, w, p: p[1] + p[0] * x[0],
    )  # fmt: skip


def product_only():
    parameters = [Parameter(n, 1.0, min=0.0, estimate=True) for n in ("a", "b")]
    return hand.family_from(
        [("x", "1")], ["u"], [], ["y"], parameters,
        lambda x, u, w, p: ca.vertcat(-p[0] * p[1] * x[0] + u[0]), lambda x, u, w, p: x[0],
    )  # fmt: skip


def overflowing():
    return hand.family_from(
        [("x", "1")], ["u"], [], ["y"], [Parameter("a", 1e5, estimate=True)],
        lambda x, u, w, p: ca.vertcat(p[0] * x[0] + u[0]), lambda x, u, w, p: x[0],
    )  # fmt: skip


def single(n_samples=300, seed=0):
    rng = np.random.default_rng(seed)
    u = rng.standard_normal((n_samples, 1))
    return Experiment(
        "run", 0.1 * np.arange(n_samples), u, rng.standard_normal((n_samples, 1)), ("u",), ("y",)
    )


def blank(experiment):
    return replace(experiment, outputs=np.full_like(experiment.outputs, np.nan))


@pytest.mark.parametrize("method", ["oe", "pem"])
def test_offset_that_the_initial_state_makes_is_refused(method):
    """It is no way to go: rounding led a search along it to any value."""
    record = single(2000)
    charge = 0.1 * np.cumsum(record.inputs, axis=0)
    measured = replace(record, outputs=3.1 + 1.3 * charge + 0.01 * record.outputs)
    with pytest.raises(EstimationError) as caught:
        identify(offset_of_a_store(), [measured], IdentifyOptions(method=method))
    assert caught.value.code == "identify-no-influence" and "offset" in caught.value.what


@pytest.mark.parametrize(("first", "is_told"), [(0.0, True), (1.0, False)])
def test_a_step_before_the_first_sample_is_told_from_a_machine_that_hunts(first, is_told):
    """A motor that reaches its speed within 15 of 1500 samples and hunts between steps of its sensor."""
    noise = np.random.default_rng(0).choice([0.9, 1.0], size=1500)
    way = (1.0 - first) * np.exp(-np.arange(1500) / 5.0)
    record = replace(simulated(1), inputs=np.full((1500, 1), 2.0))
    outputs = np.tile((noise - way)[:, None], (1, record.outputs.shape[1]))
    if is_told:
        check_records(rig(), [replace(record, outputs=outputs)], 5)
        return
    with pytest.raises(EstimationError) as caught:
        check_records(rig(), [replace(record, outputs=outputs)], 5)
    assert caught.value.code == "identify-constant-input"


REFUSALS = {
    "identify-no-data": lambda: identify(rig(), []),
    "identify-too-few-samples": lambda: identify(rig(), [simulated(1, n_samples=5)]),
    "identify-constant-input": lambda: identify(
        rig(), [replace(simulated(1), inputs=np.full((1500, 1), 2.0))]
    ),
    "identify-no-influence": lambda: identify(without_influence(), [single()]),
    "identify-unidentifiable": lambda: identify(product_only(), [single()]),
    "identify-no-output": lambda: identify(rig(), [blank(simulated(1))]),
    "identify-no-start": lambda: identify(overflowing(), [single()]),
    "identify-nothing-to-estimate": lambda: identify(rig(estimate=()), [simulated(1)]),
    "start-outside-bounds": lambda: identify(rig(), [simulated(1)], IdentifyOptions(start={"c": -1.0})),
    "unknown-parameter": lambda: identify(rig(), [simulated(1)], IdentifyOptions(estimate=("J3",))),
    "unknown-noise": lambda: identify(
        rig(noise=UNKNOWN_NOISE), [simulated(1)], IdentifyOptions(process_noise={"load": NoiseChoice(1.0)})
    ),
    "unknown-output": lambda: identify(
        rig(), [simulated(1)], IdentifyOptions(measurement_noise={"psi": NoiseChoice(1.0)})
    ),
    "split-out-of-range": lambda: identify(rig(), [simulated(1)], IdentifyOptions(split=1.5)),
    "data-input-missing": lambda: identify(rig(), [replace(simulated(1), input_names=("voltage",))]),
    "data-input-gap": lambda: identify(
        rig(), [replace(simulated(1), inputs=np.where(np.arange(1500)[:, None] == 7, np.nan, 1.0))]
    ),
}


@pytest.mark.parametrize("code", REFUSALS)
def test_what_cannot_be_identified_is_refused_by_name(code):
    with pytest.raises(DaestError) as caught:
        REFUSALS[code]()
    assert caught.value.code == code
    assert code in EXPLANATIONS
    assert caught.value.remedy


def test_refusals_name_what_is_wrong():
    with pytest.raises(EstimationError) as caught:
        identify(without_influence(), [single()])
    assert "idle" in caught.value.what
    assert "a" not in caught.value.what.split()[-1]
    with pytest.raises(EstimationError) as caught:
        identify(product_only(), [single()])
    assert "a, b" in caught.value.what
    with pytest.raises(EstimationError) as caught:
        identify(rig(), [simulated(1)], IdentifyOptions(estimate=("J3",)))
    assert "J1" in caught.value.remedy


def test_no_standard_error_is_below_the_rounding_of_its_value():
    values = np.array([2.0, 3.0, 5.0, 0.0])
    cov = np.diag([1e-50, 0.01, -1.0, 4.0])
    floor, usual, unknown, at_zero = std_errors(cov, values)
    assert floor == pytest.approx(2.0 * ROUNDING)
    assert (usual, unknown, at_zero) == (pytest.approx(0.1), None, 2.0)
