"""Maximum likelihood with process noise: gradient, known truths, and the coverage that output error does not
have."""

from dataclasses import replace

import numpy as np
import pytest
from nonlinear_models import experiment_of, friction_servo, oscillator, setup_of
from scipy.stats import chi2

from daest.estimation.filter_engines.filter_task import record
from daest.estimation.fitting.coordinates import Coordinate, Unknowns, objective
from daest.estimation.gates import FIT
from daest.estimation.nonlinear.ekf_likelihood import (
    EkfProblem,
    identify_by_ekf,
    with_substeps,
)
from daest.estimation.nonlinear.identify_nonlinear import identify_nonlinear
from daest.model.fit import IdentifyOptions
from daest.systems.simulation.local_linear import local_model
from daest.systems.simulation.simulate import simulate

TRUE = np.array([4.0, 0.5, 2.0])
INTENSITY, STD = 0.3, 0.02


def recordings(seed, n=600, count=1):
    """Duffing oscillator with white force noise, driven by a random binary force."""
    explicit = oscillator()
    rng = np.random.default_rng(seed)
    found = []
    for number in range(count):
        time = 0.05 * np.arange(n)
        u = np.repeat(rng.choice([-6.0, 6.0], n // 20), 20)[:, None]
        options = {"noise": True, "seed": 1000 * seed + number, "intensities": {"w": INTENSITY}}
        y = simulate(explicit, (time, u), hold="zoh", **options).outputs
        found.append(experiment_of(explicit, time, u, y + STD * rng.standard_normal(y.shape)))
    return explicit, found


def parameters():
    starts = {"k": 3.0, "d": 0.8, "k3": 1.0}
    return tuple(
        Coordinate(n, "parameter", i, v, True, 1.0, 0.0, np.inf) for i, (n, v) in enumerate(starts.items())
    )


def identified(function, method, explicit, experiments, validation=()):
    unknowns = Unknowns(parameters(), explicit.flat.theta_values, np.array([0.1]), np.array([0.05]))
    nothing = np.array([np.nan])
    options = IdentifyOptions(hold="zoh", second_look=False)
    return function(
        explicit,
        setup_of(unknowns, experiments, method, nothing, np.array([True]), nothing, options, validation),
    )


def test_objective_has_the_gradient_of_its_value():
    explicit, experiments = recordings(0, n=100, count=2)
    coordinates = (
        *parameters(),
        Coordinate("w", "process", 0, 0.2, True, 1.0, 1e-6, 1e6),
        Coordinate("y", "measurement", 0, 0.03, True, 1.0, 1e-6, 1e6),
    )
    unknowns = Unknowns(coordinates, explicit.flat.theta_values, np.array([0.1]), np.array([0.05]))
    model = local_model(explicit, unknowns.parameter_names(), tangents=True)
    records = tuple(record(model, e.time, e.inputs, e.outputs, "zoh") for e in experiments)
    problem = EkfProblem(model, records, unknowns, np.array([1.0, 2.0]), 0.02)
    evaluate = objective(problem)
    z = np.concatenate([unknowns.start, [0.1, 0.0, -0.1, 0.2]])
    found, h = evaluate(z, True), 1e-5
    assert found.value == pytest.approx(evaluate(z, False).value, abs=1e-9)
    for i, step in enumerate(h * np.eye(z.size)):
        slope = (evaluate(z + step, False).value - evaluate(z - step, False).value) / (2 * h)
        assert found.gradient[i] == pytest.approx(slope, rel=1e-6, abs=1e-6 * np.max(np.abs(found.gradient)))
    assert np.all(np.linalg.eigvalsh(found.information) > 0.0)
    assert np.all(found.information[5:7, 7:] == 0.0)  # initial states of different records


def test_a_point_that_cannot_be_filtered_has_no_value():
    explicit, experiments = recordings(0, n=60)
    unknowns = Unknowns(
        (replace(parameters()[2], lower=-np.inf, is_log=False),),
        explicit.flat.theta_values,
        np.array([0.1]),
        np.array([0.05]),
    )
    model = local_model(explicit, ("k3",), tangents=True)
    records = tuple(record(model, e.time, e.inputs, e.outputs, "zoh") for e in experiments)
    problem = EkfProblem(model, records, unknowns, np.ones(2))
    assert objective(problem)(np.array([-1e9, 1.0, 0.0]), False) is None


def test_substeps_are_refined_until_the_likelihood_stays():
    explicit, experiments = recordings(0, n=100)
    coarse = replace(experiments[0], time=40.0 * experiments[0].time)
    unknowns = Unknowns(parameters(), explicit.flat.theta_values, np.array([0.3]), np.array([0.05]))
    model = local_model(explicit, unknowns.parameter_names(), tangents=True)
    z = np.concatenate([np.log(TRUE), [0.1, 0.0]])

    def problem(e):
        return EkfProblem(model, (record(model, e.time, e.inputs, e.outputs, "zoh"),), unknowns, np.ones(2))

    found = with_substeps(problem(experiments[0]), z)
    assert found is not None
    halved = replace(found, longest=min(found.longest, 0.05) / 2)
    values = [objective(each)(z, False).value for each in (found, halved)]
    assert abs(values[0] - values[1]) < FIT.substep_change * (1 + 100 / 1000)
    assert with_substeps(problem(coarse), z) is None  # far too coarse a record for the model


@pytest.mark.slow
def test_finds_parameters_and_noises():
    explicit, experiments = recordings(1, n=1500, count=2)
    found = identified(identify_by_ekf, "pem", explicit, experiments[:1], experiments[1:])
    assert found.status == "converged"
    for parameter, true in zip(found.parameters, TRUE, strict=True):
        assert abs(parameter.value - true) < 4 * parameter.std_error
        assert parameter.std_error < 0.1 * true
    process, measurement = found.noises
    assert (process.kind, measurement.kind) == ("process", "measurement")
    assert abs(np.log(process.value / INTENSITY)) < 4 * process.std_error / process.value
    assert abs(measurement.value - STD) < 4 * measurement.std_error
    assert found.one_step["validation"].fit_percent["y"] > 90.0
    assert found.simulated["validation"].rms["y"] > 3 * found.one_step["validation"].rms["y"]
    assert np.all(np.isfinite(found.initial_states[0].std_errors))
    observer = identified(identify_nonlinear, "pem", explicit, experiments[:1])
    assert found.log_likelihood >= observer.log_likelihood - 0.5


def stuck_friction_identified(skipped=0):
    """Size of sharp friction from a record without its first `skipped` samples: it begins in motion."""
    explicit = friction_servo(stiffening=0.0, width=0.02)
    n = 400
    time = 0.005 * np.arange(n)
    u = 3.0 * np.sin(2 * np.pi * np.arange(n) * 0.005)[:, None]
    y = simulate(explicit, (time, u), hold="zoh").outputs
    y = y + np.array([0.02, 0.01]) * np.random.default_rng(0).standard_normal(y.shape)
    names = [p.name for p in explicit.flat.parameters]
    stick = Coordinate("stick", "parameter", names.index("stick"), 0.015, True, 1.0, 0.0, np.inf)
    unknowns = Unknowns((stick,), explicit.flat.theta_values, np.full(2, 1e-6), np.array([0.02, 0.01]))
    rest = slice(skipped, None)
    return identify_by_ekf(
        explicit,
        setup_of(
            unknowns,
            [experiment_of(explicit, time[rest], u[rest], y[rest])],
            "pem",
            np.full(2, 1e-6),
            np.zeros(2, dtype=bool),
            np.array([0.02, 0.01]),
            IdentifyOptions(hold="zoh", second_look=False),
        ),
    )


@pytest.mark.slow  # test_sharp_friction.py
def test_sharp_friction_is_averaged_over_what_is_known_of_the_speed():
    found = stuck_friction_identified()
    assert any("extended Kalman filter" in note for note in found.notes)
    assert found.parameters[0].value == pytest.approx(0.02, rel=0.1)


def test_simulation_begins_where_it_fits_best():
    found = stuck_friction_identified(skipped=130)
    assert any("extended Kalman filter" in note for note in found.notes)
    rms = found.simulated["estimation"].rms
    assert list(rms.values()) == pytest.approx([0.02, 0.01], rel=0.1)


@pytest.mark.slow
def test_a_record_too_coarse_for_the_model_is_left_to_the_observer(monkeypatch):
    explicit, experiments = recordings(0, n=300)
    monkeypatch.setattr("daest.estimation.nonlinear.ekf_likelihood.FIT", replace(FIT, rough_substeps=0.0))
    found = identified(identify_by_ekf, "pem", explicit, experiments)
    assert any("not smooth enough" in note for note in found.notes)
    observer = identified(identify_nonlinear, "pem", explicit, experiments)
    assert [p.value for p in found.parameters] == [p.value for p in observer.parameters]


def test_output_error_is_left_alone():
    explicit, experiments = recordings(2, n=200)
    first, second = (
        identified(f, "oe", explicit, experiments) for f in (identify_nonlinear, identify_by_ekf)
    )
    assert [p.value for p in first.parameters] == [p.value for p in second.parameters]


@pytest.mark.slow
def test_process_noise_matters():
    """20 records: the errors of maximum likelihood, weighted by their covariance, are chi-square; those of
    output error with the covariance of independent residuals are far outside the same band."""
    runs, p = 20, TRUE.size
    low, high = chi2.ppf([0.001, 0.999], runs * p)
    sums = {"ml": 0.0, "oe": 0.0}
    for seed in range(runs):
        explicit, experiments = recordings(seed)
        for name, function, method in (("ml", identify_by_ekf, "pem"), ("oe", identify_nonlinear, "oe")):
            found = identified(function, method, explicit, experiments)
            std = np.array([q.std_error for q in found.parameters])
            cov = found.correlation[:p, :p] * np.outer(std, std)
            error = np.array([q.value for q in found.parameters]) - TRUE
            sums[name] += float(error @ np.linalg.solve(cov, error))
    assert low < sums["ml"] < high
    assert sums["oe"] > high
