"""Machines that somebody has measured, diagnosed without a hint."""

from pathlib import Path

import pytest

import daest
from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.options import DiagnoseOptions
from daest.estimation.fitting.records import part_of
from daest.modelica.effects.catalogue import effect_library

MODELS = Path(__file__).parent / "models"
COUNTER = "pulley_speed_abs_ticks_per_s"


@pytest.mark.slow
def test_friction_of_a_geared_servo(shared_data):
    """Duclusaud et al. (2025) report that viscous and Coulomb friction do not do for this servo: the friction
    of its gear grows with the load."""
    signals = [
        daest.Signal("duty", "1", "load_raw_signed"),
        daest.Signal("supply", "V", "input_voltage_V"),
        daest.Signal("on", "1", "torque_enable"),
    ]
    file = shared_data / "bam_xl330" / "kp400_sin_time_square.csv"
    (whole,) = daest.read_experiments([file], signals, [daest.Signal("angle", "rad", "position_rad")])
    cut = int(0.6 * whole.n_samples)
    parts = [part_of(whole, *rows) for rows in ((0, cut), (cut, whole.n_samples))]
    flat = daest.compile_model(MODELS / "GearedServo.mo")
    found = diagnose(flat, effect_library(), parts[:1], parts[1:], DiagnoseOptions())
    accepted = [p for p in found.proofs if p.verdict != "rejected"]
    assert {p.candidate.effect.name for p in accepted} == {"LoadDependentFriction"}
    before, after = (fit.simulated["validation"].rms["angle"] for fit in (found.baseline, accepted[0].told))
    assert after < 0.6 * before


@pytest.mark.slow
def test_sensor_of_the_coupled_drives_shows_no_direction(shared_data, monkeypatch):
    """Wigren and Schoukens (2017): the counter of the pulley does not tell which way it turns. Friction,
    which the drives have as well, says much less. Compiled as users do: the search has several optima, and
    the other roundings of less effort lead it to one that foresees unseen data no better."""
    monkeypatch.delenv("DAEST_COMPILER_EFFORT", raising=False)
    folder = shared_data / "measured" / "coupled_drives"
    signals = ([daest.Signal("u", "V", "motor_voltage_sum_V")], [daest.Signal("w", "rad/s", COUNTER)])
    parts = [
        daest.read_experiments([folder / f"{level}_{part}.csv" for level in ("low", "high")], *signals)
        for part in ("train", "test")
    ]
    found = diagnose(daest.compile_model(folder / "Drives.mo"), effect_library(), *parts, DiagnoseOptions())
    accepted = [p for p in found.proofs if p.verdict != "rejected"]
    assert [p.candidate.label for p in accepted] == ["AbsoluteValueSensor at w"]
    rivals = [p for p in found.proofs if p.verdict == "rejected"]
    assert rivals and all(p.delta_bic < 0.5 * accepted[0].delta_bic for p in rivals)
