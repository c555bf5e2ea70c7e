"""Filtering a recording: internal variables of random DAEs, the report's experiment, honest uncertainty."""

import json
from dataclasses import replace

import numpy as np
import pytest
from dense_gaussian import DenseRecord
from hand_models import REPORT_START, multisine, positioning_system, recording, servo
from numpy.testing import assert_allclose
from scipy.stats import binom

from daest.errors import EXPLANATIONS, EstimationError
from daest.estimation.filter import run_filter
from daest.estimation.filter_engines.stationary import stationary_filter
from daest.model.estimates import FilterOptions, InitialState
from daest.model.experiment import Experiment
from daest.model.linear import StateSpace
from daest.report.documents.filter import document, table
from daest.systems.linear.state_space import sample, state_space

RIG = {"d": 0.02, "c": 1.5, "J1": 6.3e-6, "J2": 0.02, "k": 0.06, "R": 4.6, "n": 30.0}
STD = np.array([0.02, 0.01])


def random_dae(seed):
    """A random DAE of index 2 with admissible noise in its standard form, mixed by random P and Q.

    E ξ' = J ξ + K u + B w with P E Q = diag(I, N), P J Q = diag(A, I). Returns the state space
    z1' = A z1 + B1 u + G1 w, ξ = Q1 z1 - Q2 (D1 u + G2 w), which holds as N D1 = 0 and
    N G2 = 0, and E, J, B.
    """
    rng = np.random.default_rng(seed)
    n1, n2, n_w, n_y = 3, 4, 2, 2
    A = rng.normal(size=(n1, n1)) - 2.0 * np.eye(n1)
    N = np.zeros((n2, n2))
    N[0, 1] = 1.0
    P, Q = rng.normal(size=(n1 + n2, n1 + n2)), rng.normal(size=(n1 + n2, n1 + n2))
    B1, G1 = rng.normal(size=(n1, 1)), rng.normal(size=(n1, n_w))
    D1, G2 = rng.normal(size=(n2, 1)), rng.normal(size=(n2, n_w))
    D1[1], G2[1] = 0.0, 0.0
    C = rng.normal(size=(n_y, n1 + n2))
    offset = rng.normal(size=n_y)
    X, U, W = Q[:, :n1], -Q[:, n1:] @ D1, -Q[:, n1:] @ G2
    ss = StateSpace(
        state_names=tuple(f"z{i}" for i in range(n1)),
        input_names=("u",),
        input_derivatives=(),
        noise_names=("w0", "w1"),
        output_names=("y0", "y1"),
        unknown_names=tuple(f"xi{i}" for i in range(n1 + n2)),
        A=A, B=B1, G=G1, b=rng.normal(size=n1),
        C=C @ X, D=C @ U, H=C @ W, d=offset,
        X=X, U=U, W=W, x0=np.zeros(n1 + n2),
    )  # fmt: skip
    E = np.linalg.solve(P, np.block([[np.eye(n1), np.zeros((n1, n2))], [np.zeros((n2, n1)), N]]))
    J = np.linalg.solve(P, np.block([[A, np.zeros((n1, n2))], [np.zeros((n2, n1)), np.eye(n2)]]))
    E, J = E @ np.linalg.inv(Q), J @ np.linalg.inv(Q)
    B = np.linalg.solve(P, np.vstack([G1, G2]))
    return ss, (E, J, B), rng


def dae_record(ss, rng, n_samples=14, missing=0.25):
    u, y = rng.normal(size=(n_samples, 1)), rng.normal(size=(n_samples, 2)) * 3.0
    y[rng.uniform(size=y.shape) < missing] = np.nan
    return Experiment("dae", 0.2 * np.arange(n_samples), u, y, ("u",), ("y0", "y1"))


@pytest.mark.parametrize("seed", range(6))
def test_the_random_dae_is_solved_by_its_state_space(seed):
    ss, (E, J, B), _ = random_dae(seed)
    for s in (0.3, 1.0 + 2.0j):  # transfer from w to ξ through the DAE and through the state space
        through_dae = np.linalg.solve(s * E - J, B)
        through_states = ss.X @ np.linalg.solve(s * np.eye(3) - ss.A, ss.G) + ss.W
        assert_allclose(through_dae, through_states, rtol=1e-6, atol=1e-8 * np.max(np.abs(through_dae)))


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("is_known", [False, True])
def test_internal_variables_of_random_daes_equal_the_dense_joint_gaussian(seed, smooth, is_known):
    ss, _, rng = random_dae(seed)
    experiment = dae_record(ss, rng)
    intensity, R = np.array([[0.5, 0.2], [0.2, 0.4]]), np.array([[0.3, 0.1], [0.1, 0.2]])
    mean, cov = rng.normal(size=3), np.diag([1.0, 0.2, 3.0])
    initial = InitialState(mean, cov) if is_known else None
    result = run_filter(
        ss,
        experiment,
        "time-varying",
        FilterOptions(process_intensity=intensity, measurement_cov=R, smooth=smooth, initial=initial),
    )
    assert result.noise == "held"
    model = sample(ss, 0.2, "foh", intensity, R, "held")
    dense = DenseRecord(
        [model] * 13, experiment, mean if is_known else np.zeros(3), cov if is_known else None
    )
    for k in range(5, 14):
        target = ss.X @ dense.states[k] + ss.W @ dense.noises[k]
        posterior = dense.condition(target, 14 if smooth else k)
        expected = posterior.mean + ss.X @ dense.state_offsets[k] + ss.U @ experiment.inputs[k]
        assert_allclose(result.values[k, :7], expected, rtol=1e-8, atol=1e-8)
        assert_allclose(result.std[k, :7], np.sqrt(np.diagonal(posterior.cov)), rtol=1e-8)
        noise = dense.condition(dense.noises[k], 14 if smooth else k)
        assert_allclose(result.process_noise.values[k], noise.mean, rtol=1e-8, atol=1e-9)
        assert_allclose(result.process_noise.std[k], np.sqrt(np.diagonal(noise.cov)), rtol=1e-8)
    assert result.log_likelihood == pytest.approx(dense.log_likelihood(), rel=1e-8)


def simulated_servo(seed, n_samples=1500, x0=None, intensity=1e-4):
    family = servo(RIG, noise={"intensity": intensity})
    ss = state_space(family, np.array([p.value for p in family.parameters]))
    model = sample(ss, 0.01, "foh", np.array([intensity]), STD**2)
    u = multisine(n_samples, 0.01, seed)[:, None]
    return family, recording(model, u, STD, seed, x0)


@pytest.mark.slow
def test_the_normalised_innovations_are_in_their_band_in_most_of_20_runs():
    inside = 0
    for seed in range(20):
        family, experiment = simulated_servo(seed)
        nis = run_filter(
            family,
            experiment,
            "time-varying",
            FilterOptions(process_intensity=np.array([1e-4]), measurement_cov=STD**2),
        ).nis
        assert nis.n_innovations >= 2 * 1500 - 4
        inside += nis.inside
    assert inside >= binom.ppf(0.001, 20, 0.95)


def test_a_wrong_noise_level_leaves_the_band():
    family, experiment = simulated_servo(1)
    for factor in (0.8, 1.25):
        result = run_filter(
            family,
            experiment,
            "time-varying",
            FilterOptions(process_intensity=np.array([1e-4]), measurement_cov=(factor * STD) ** 2),
        )
        assert not result.nis.inside


def test_the_speed_is_found_from_the_angle_alone():
    family, experiment = simulated_servo(2)
    result = run_filter(
        family,
        experiment,
        "time-varying",
        FilterOptions(process_intensity=np.array([1e-4]), measurement_cov=STD**2, measure=["phi"]),
    )
    assert result.measure == ("phi",) and set(result.compared) == {"omega"}
    index = result.names.index("omega")
    error = experiment.outputs[:, 0] - result.values[:, index]
    expected = np.sqrt(result.std[:, index] ** 2 + STD[0] ** 2)
    late = slice(200, None)
    assert np.mean(np.abs(error[late]) < 1.96 * expected[late]) == pytest.approx(0.95, abs=0.03)
    compared = result.compared["omega"]
    assert compared.fit_percent > 95.0
    assert compared.n_samples <= experiment.n_samples
    smoothed = run_filter(
        family,
        experiment,
        "time-varying",
        FilterOptions(
            process_intensity=np.array([1e-4]), measurement_cov=STD**2, measure=["phi"], smooth=True
        ),
    )
    smoothed_error = experiment.outputs[:, 0] - smoothed.values[:, index]
    assert np.mean(smoothed_error[late] ** 2) < np.mean(error[late] ** 2)
    assert np.all(smoothed.std[late] <= result.std[late] * (1 + 1e-9))


def test_after_a_wrong_start_time_varying_wins_in_the_transient_and_equals_stationary_later():
    """Report section 3.4.2, figures 8 to 10: true start far from zero, both filters start from zero."""
    start = np.array([0.0, 1.5, 2.0, -4.0])
    family, experiment = simulated_servo(4, x0=start)
    guess = InitialState.known(np.zeros(4), [5.0, 2.0, 2.0, 5.0])
    unknown = FilterOptions(
        process_intensity=np.array([1e-4]), measurement_cov=STD**2, measure=["phi"], initial=None
    )
    guessed = replace(unknown, initial=guess)
    varying = run_filter(family, experiment, "time-varying", guessed)
    stationary = run_filter(family, experiment, "stationary", guessed)
    index = varying.names.index("omega")
    measured = experiment.outputs[:, 0]
    transient = slice(3, 60)
    error = [np.sqrt(np.mean((measured - r.values[:, index])[transient] ** 2)) for r in (varying, stationary)]
    assert error[0] < 0.5 * error[1]
    assert varying.steady_after is not None and varying.steady_after < 6.0
    assert_allclose(varying.values[-100:], stationary.values[-100:], atol=1e-6)
    assert_allclose(varying.std[-100:], stationary.std[-100:], rtol=1e-6)
    zero = run_filter(family, experiment, "time-varying", unknown)
    assert_allclose(zero.values[-100:], varying.values[-100:], atol=1e-6)


@pytest.mark.parametrize(("intensity", "forgets"), [(1e-4, True), (1e-14, False)])
def test_a_stationary_filter_that_keeps_its_start_says_so(intensity, forgets):
    family, experiment = simulated_servo(4, x0=np.array([0.0, 1.5, 2.0, -4.0]))
    result = run_filter(
        family,
        experiment,
        "stationary",
        FilterOptions(process_intensity=np.array([intensity]), measurement_cov=STD**2),
    )
    assert forgets != any("forgets a wrong start" in message for message in result.messages)
    start_left = np.abs(result.innovations[-100:] / STD).max() > 6.0
    assert start_left != forgets


@pytest.mark.parametrize("smooth", [False, True])
def test_the_stationary_filter_leaves_out_what_no_output_sees(smooth):
    """Long after the start it says what the time-varying filter says, of the speeds and of the twist."""
    family, experiment = simulated_servo(5)
    both = [
        run_filter(
            family,
            experiment,
            kind,
            FilterOptions(
                process_intensity=np.array([1e-4]), measurement_cov=STD**2, measure=["omega"], smooth=smooth
            ),
        )
        for kind in ("stationary", "time-varying")
    ]
    angles = [both[0].names.index(name) for name in ("shaft.phi", "phi")]
    seen = [i for i in range(len(both[0].names)) if np.isfinite(both[1].std[-1, i])]
    assert len(seen) >= 2 and not set(angles) & set(seen)
    assert np.all(np.isnan(both[0].values[:, angles])) and np.all(np.isinf(both[0].std[:, angles]))
    middle = slice(both[0].time.size // 2, -both[0].time.size // 8)
    stationary, varying = ((r.values[middle, seen], r.std[middle, seen]) for r in both)
    assert np.max(np.abs(stationary[0] - varying[0]) / np.maximum(varying[1], 1e-12)) < 0.05
    assert_allclose(stationary[1], varying[1], rtol=1e-3, atol=1e-9)
    assert any("shaft.phi, phi" in message for message in both[0].messages)


def test_an_angle_that_nothing_measures_gets_no_number():
    family, experiment = simulated_servo(5)
    result = run_filter(
        family,
        experiment,
        "time-varying",
        FilterOptions(process_intensity=np.array([1e-4]), measurement_cov=STD**2, measure=["omega"]),
    )
    angles = [result.names.index(name) for name in ("shaft.phi", "phi")]
    others = [result.names.index(name) for name in ("omega", "disc.w")]
    assert np.all(np.isnan(result.values[:, angles])) and np.all(np.isinf(result.std[:, angles]))
    assert np.all(np.isfinite(result.values[-1, others]))
    assert len(result.messages) == 1 and "shaft.phi, phi" in result.messages[0]
    assert np.isnan(result.compared["phi"].fit_percent) and result.steady_after is None
    known = InitialState.known(np.zeros(4), 0.1)
    given = run_filter(
        family,
        experiment,
        "time-varying",
        FilterOptions(
            process_intensity=np.array([1e-4]), measurement_cov=STD**2, measure=["omega"], initial=known
        ),
    )
    assert np.all(np.isfinite(given.values)) and given.std[-1, angles[0]] > 0.05
    assert any("uncertainty" in message for message in given.messages)


def test_uneven_and_missing_samples():
    rng = np.random.default_rng(0)
    family = positioning_system()
    time = np.cumsum(rng.choice([0.01, 0.02, 0.035], size=500))
    force = 50.0 * np.sin(2.0 * time)
    ss = state_space(family, np.array([p.value for p in family.parameters]))
    x, states = np.array([0.1, 0.0]), []
    for k in range(500):
        states.append(x)
        if k < 499:
            m = sample(ss, time[k + 1] - time[k], "foh", np.zeros(0), np.ones(1))
            x = m.transition @ x + m.input_now[:, 0] * force[k] + m.input_next[:, 0] * force[k + 1] + m.drift
    states = np.array(states)
    y = states[:, :1] + 0.001 * rng.standard_normal((500, 1))
    y[100:150] = np.nan
    experiment = Experiment("uneven", time, force[:, None], y, ("F",), ("position",))
    result = run_filter(
        family,
        experiment,
        "time-varying",
        FilterOptions(process_intensity=np.zeros(0), measurement_cov=np.array([1e-6]), smooth=True),
    )
    rounding = 1e-12  # without process noise the speed is known better than it can be computed
    assert np.all(np.abs(result.values[:, :2] - states) < 5 * result.std[:, :2] + rounding)
    assert result.std[-1, 0] < 5e-4
    assert result.nis.n_innovations == 500 - 50 - 2
    assert result.nis.inside


def test_the_report_plant_with_the_report_noise():
    """Report (55): intensity 0.1 on every state and R2 = 0.1, the angle alone; a stationary filter exists."""
    values = {**REPORT_START, "R": 4.5, "n": 30.0}
    family = servo(values)
    ss = state_space(family, np.array([p.value for p in family.parameters]))
    everywhere = replace(
        ss,
        G=np.eye(4), H=np.zeros((2, 4)), W=np.zeros((4, 4)), noise_names=tuple("abcd"),
    )  # fmt: skip
    model = sample(everywhere, 0.05, "foh", np.full(4, 0.1), np.full(2, 0.1))
    angle = replace(
        model,
        output=model.output[1:], feedthrough=model.feedthrough[1:], output_offset=model.output_offset[1:],
        measurement_cov=model.measurement_cov[1:, 1:], cross_cov=model.cross_cov[:, 1:],
        noise_measurement_cov=model.noise_measurement_cov[:, 1:],
    )  # fmt: skip
    assert np.max(np.abs(np.linalg.eigvals(stationary_filter(angle, ss.state_names).closed_loop))) < 1.0


def test_unknown_outputs_are_refused_with_the_known_ones():
    family, experiment = simulated_servo(6, 50)
    for name in ("speed", "shaft.phi"):
        with pytest.raises(EstimationError) as caught:
            run_filter(
                family,
                experiment,
                "time-varying",
                FilterOptions(process_intensity=np.array([1e-4]), measurement_cov=STD**2, measure=[name]),
            )
        assert caught.value.code == "filter-unknown-output" and "omega, phi" in caught.value.remedy
        assert caught.value.code in EXPLANATIONS


def test_document_and_table():
    family, experiment = simulated_servo(7, 300)
    result = run_filter(
        family,
        experiment,
        "time-varying",
        FilterOptions(process_intensity=np.array([1e-4]), measurement_cov=STD**2, measure=["phi"]),
    )
    content = json.loads(json.dumps(document(result), allow_nan=False))
    for key in ("kind", "log_likelihood", "nis", "compared", "process_noise", "steady_after"):
        assert key in content
    assert set(content["nis"]) >= {"mean", "low", "high", "inside"}
    assert content["process_noise"]["names"] == ["load.tau"]
    header, rows = table(result)
    assert header[:3] == ["time", "omega", "omega.std"] and rows.shape == (300, len(header))
    assert np.all(np.isnan(rows[0, [1, 2]]))  # one angle does not tell a speed
    assert not np.any(np.isinf(rows))
    header, rows = table(result, ["disc.w"])
    assert header == ["time", "disc.w", "disc.w.std"]
    assert_allclose(rows[-1, 1], result.values[-1, result.names.index("disc.w")])
    with pytest.raises(EstimationError, match=r"disc\.v") as caught:
        table(result, ["disc.v"])
    assert "disc.w" in caught.value.remedy
    unobserved = run_filter(
        family,
        experiment,
        "time-varying",
        FilterOptions(process_intensity=np.array([1e-4]), measurement_cov=STD**2, measure=["omega"]),
    )
    content = json.loads(json.dumps(document(unobserved), allow_nan=False))
    assert content["undetermined"] == ["shaft.phi", "phi"]
    assert content["compared"]["phi"]["fit_percent"] is None


def test_outputs_that_are_no_unknowns_are_estimated_too():
    family, experiment = simulated_servo(8, 300)
    ss = state_space(family, np.array([p.value for p in family.parameters]))
    hidden = replace(ss, unknown_names=ss.unknown_names[1:], X=ss.X[1:], U=ss.U[1:], W=ss.W[1:], x0=ss.x0[1:])
    result = run_filter(
        hidden,
        experiment,
        "time-varying",
        FilterOptions(process_intensity=np.array([1e-4]), measurement_cov=STD**2, measure=["phi"]),
    )
    full = run_filter(
        ss,
        experiment,
        "time-varying",
        FilterOptions(process_intensity=np.array([1e-4]), measurement_cov=STD**2, measure=["phi"]),
    )
    assert result.names == ("shaft.phi", "phi", "disc.w", "omega")
    assert_allclose(result.values[5:, 3], full.values[5:, 0], rtol=1e-9)


def test_the_angle_of_the_recorded_rig_tells_its_speed(shared_data):
    from hand_models import read_csv

    folder = shared_data / "servo_lab" / "known"
    truth = json.loads((folder / "k1_nothing_hidden.json").read_text())["parameters"]
    experiment = read_csv(
        folder / "k1_nothing_hidden.csv", "time", {"u": "u"}, {"omega": "omega", "phi": "phi"}
    )
    family = servo(truth, noise={"intensity": 1e-9})
    result = run_filter(
        family,
        experiment,
        "time-varying",
        FilterOptions(
            process_intensity=np.array([1e-9]), measurement_cov=STD**2, measure=["phi"], hold="zoh"
        ),
    )
    assert result.nis.inside
    assert result.compared["omega"].fit_percent > 98.0
    assert result.compared["omega"].rms < 1.1 * STD[0]
