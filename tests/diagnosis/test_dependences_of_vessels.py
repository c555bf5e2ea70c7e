"""Parameters that change in a stirred vessel: where a law comes near, and where another one is there."""

from types import SimpleNamespace

import numpy as np
import pytest
from hidden_plants import library, model
from scipy.integrate import solve_ivp

from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.evidence.same_laws import is_same_load
from daest.diagnosis.options import DiagnoseOptions
from daest.model.experiment import Experiment

PERIOD, N, NOISE = 10.0, 900, 0.05


def record(seed, speeds, conductance=lambda n, t: 6.0, heat=lambda n: 0.0):
    """Temperatures while the heating has steps and the stirrer the `speeds`, one at each sample; the wall has
    the `conductance` of speed and time, and the stirrer gives off the `heat` of its speed."""
    rng = np.random.default_rng(seed)
    time = PERIOD * np.arange(N)
    power = np.repeat(rng.uniform(50.0, 400.0, N // 45), 45)
    values = [35.0]
    for k in range(N - 1):

        def rate(t, x, k=k):
            n = speeds[k]
            return (power[k] + heat(n) - conductance(n, t) * (x - 18.0)) / 5000.0

        values.append(solve_ivp(rate, (time[k], time[k + 1]), [values[-1]], rtol=1e-8).y[0, -1])
    measured = np.array(values)[:, None] + NOISE * rng.standard_normal((N, 1))
    inputs = np.column_stack((power, speeds))
    return Experiment(f"record{seed}", time, inputs, measured, ("P", "n"), ("T",))


def steps(seed):
    return np.repeat(np.random.default_rng(seed).uniform(100.0, 400.0, N // 75), 75)


def verdict_of(*records):
    return diagnose(model("StirredVessel"), library(), records, options=DiagnoseOptions(hold="zoh"))


def supported(found):
    (proof,) = [p for p in found.proofs if p.verdict == "supported"]
    return proof


@pytest.mark.slow
def test_a_conductance_that_grows_with_the_speed_is_more_than_a_heat_flow_that_does():
    def alternating(middle):
        return middle + 30.0 * np.sign(np.sin(PERIOD * np.arange(N) / 700.0))

    def conductance(n, t):
        return 6.0 * (1.0 + 0.003 * (n - 200.0))

    two = [record(seed, alternating(middle), conductance) for seed, middle in ((120, 120.0), (121, 320.0))]
    proof = supported(verdict_of(*two))
    assert proof.candidate.label == "DependentParameter (n) at G"


@pytest.mark.slow
def test_a_conductance_that_falls_with_time_is_more_than_a_zero_that_drifts():
    proof = supported(verdict_of(record(109, steps(5), lambda n, t: 6.0 * (1.0 - 0.35 * t / (PERIOD * N)))))
    assert proof.candidate.label == "DriftingParameter at G"


@pytest.mark.slow
def test_heat_that_grows_with_the_speed_is_no_jacket_that_warms_with_it():
    found = verdict_of(record(201, steps(6), heat=lambda n: 120.0 * (n / 400.0) ** 3))
    told = [p for p in found.proofs if p.verdict != "rejected"]
    assert any(p.candidate.label.startswith("MeasuredHeat") for p in told)
    assert not any(p.candidate.site.name == "Tj" for p in told)


def a_proof(gain, variable, is_of_variable):
    candidate = SimpleNamespace(
        name="law", inputs={"z": variable}, effect=SimpleNamespace(is_of_variable=is_of_variable, sizes=())
    )
    fit = SimpleNamespace(parameters=())
    return SimpleNamespace(candidate=candidate, fit=fit, delta_log_likelihood=gain)


def test_a_parameter_that_changes_does_what_a_law_of_the_same_variable_does_where_both_gain_the_same():
    law = a_proof(100.0, "n", is_of_variable=False)
    assert is_same_load(a_proof(100.1, "n", is_of_variable=True), law)
    assert not is_same_load(a_proof(103.0, "n", is_of_variable=True), law)
    assert not is_same_load(a_proof(100.1, "P", is_of_variable=True), law)
    assert not is_same_load(a_proof(100.1, "n", is_of_variable=False), law)
