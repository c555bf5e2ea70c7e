"""Signals that come late, seen in the innovations. Simulated by LSODA, interval by interval."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from daest.diagnosis.built_in.late_signals import _chosen, late_responses, late_signals
from daest.diagnosis.built_in.trials import Trial
from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.null_model.loads import load_sites
from daest.diagnosis.null_model.null import fit_null
from daest.diagnosis.null_model.null_observer import run_null
from daest.diagnosis.options import DiagnoseOptions
from daest.diagnosis.refits import course
from daest.diagnosis.screening.candidates import pairs
from daest.model.diagnosis import Screen, Screened
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_text
from daest.modelica.effects.catalogue import effect_library, find_effect
from daest.modelica.places.sites import sites

ROOM = b"""model Room
  parameter Real C(unit = "J/K", min = 0) = 1e6 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real G(unit = "W/K", min = 0) = 60 annotation(__Daest(estimate = true, scale = "log"));
  input Real P(unit = "W");
  input Real Ta(unit = "K");
  Real T(unit = "K", start = 290);
  output Real y(unit = "K");
equation
  C*der(T) = P - G*(T - Ta);
  y = T;
end Room;
"""
PERIOD = 300.0


def recorded(lag: float = 0.0, wall: float = 0.0, sensor: float = 0.0, n: int = 500) -> Experiment:
    """A heater late by `lag` [s], a thermometer by `sensor` [s], and a wall behind it of `wall` [W/K]."""
    rng = np.random.default_rng(4)
    time = PERIOD * np.arange(n)
    heat = 3000.0 * np.repeat(rng.integers(0, 2, n // 5), 5)
    outdoor = 275.0 + 4.0 * np.sin(2 * np.pi * time / 86400.0)
    state, found = np.array([290.0, 285.0, heat[0], 290.0]), []

    def rates(t, z, k):
        into = (wall * (z[1] - z[0]) + (z[2] if lag else heat[k]) - 50.0 * (z[0] - outdoor[k])) / 1.2e6
        late = (heat[k] - z[2]) / (lag or 1e9), (z[0] - z[3]) / (sensor or 1e9)
        return [into, wall * (z[0] - z[1]) / 2e7, *late]

    for k in range(n):
        found.append(state[3] if sensor else state[0])
        run = solve_ivp(rates, (0.0, PERIOD), state, "LSODA", args=(k,), rtol=1e-8, atol=1e-8)
        state = run.y[:, -1]
    told = np.array(found) + rng.normal(0.0, 0.01, n)
    inputs = np.column_stack([heat, outdoor])
    return Experiment("run", time, inputs, told[:, None], ("P", "Ta"), ("y",))


def _room():
    return compile_text(ROOM, Path("Room.mo"))


def null_of(record: Experiment):
    flat = _room()
    return fit_null(flat, load_sites(flat), [record], "zoh")


def late_at(*places: str):
    effects = [find_effect(f"Signals.{name}") for name in ("Lag", "Delay")]
    found = pairs(effects, sites(compile_text(ROOM, Path("Room.mo"))))
    return [c for c in found if not places or c.label in places]


@pytest.mark.parametrize(
    ("label", "late"), [("Lag at P", {"lag": 700.0}), ("Lag at y", {"sensor": 700.0}), ("Delay at P", {})]
)
def test_response_is_what_a_late_signal_does_to_the_innovations(label, late):
    """The same noise with and without it, through one observer."""
    on_time, delayed = recorded(n=200), recorded(**late, n=200)
    if not late:
        inputs = on_time.inputs.copy()
        inputs[:, 0] = np.append(np.full(2, inputs[0, 0]), inputs[:-2, 0])
        behind = replace(on_time, inputs=inputs)
    null = null_of(on_time)
    run = run_null(null)
    time = 700.0 if late else 2 * PERIOD
    (response,) = late_responses(null, run, late_at(label), [time]) @ np.kron(
        np.eye(200), np.linalg.inv(run.root)
    )
    errors = [
        (one.observed[0].whitened @ np.linalg.inv(one.root).T).ravel()
        for one in (run, run_null(replace(null, experiments=(delayed if late else behind,))))
    ]
    change = errors[1] - errors[0] if late else errors[0] - errors[1]
    begin = 10  # a start away from rest is not that of the recording
    assert np.linalg.norm((change - response)[begin:]) < 0.1 * np.linalg.norm(change[begin:])


@pytest.mark.slow  # the tests above and below
def test_late_heater_is_seen_beside_a_wall_that_drifts():
    null = null_of(recorded(lag=700.0, wall=150.0))
    found = late_signals(null, run_null(null), late_at())
    (lag, *_) = found.lags
    assert lag.candidate.label == "Lag at P"
    assert 0.4 < lag.sizes[0] / 700.0 < 2.5
    assert not lag.alike


def test_signals_that_the_sensors_see_alike_are_one_trial():
    """Two heaters that are always switched together."""
    text = ROOM.replace(b"  input Real P", b'  input Real Q(unit = "W");\n  input Real P')
    flat = compile_text(text.replace(b"P - G", b"P + Q - G"), Path("Room.mo"))
    record = recorded(lag=700.0)
    heat, outdoor = record.inputs.T
    inputs = np.column_stack([0.4 * heat, 0.6 * heat, outdoor])
    both = replace(record, inputs=inputs, input_names=("Q", "P", "Ta"))
    null = fit_null(flat, load_sites(flat), [both], "zoh")
    found = late_signals(null, run_null(null), pairs([find_effect("Signals.Lag")], sites(flat)))
    (lag, *_) = found.lags
    assert {lag.candidate.label, *(c.label for c in lag.alike)} == {"Lag at P", "Lag at Q"}


def test_nothing_is_late():
    null = null_of(recorded())
    found = late_signals(null, run_null(null), late_at())
    assert not found.lags and not found.dead_times
    assert late_signals(null, run_null(null), ()) == found


@pytest.mark.slow
def test_late_heater_and_the_wall_are_found_beside_each_other():
    """Alone, a late thermometer makes the recordings likelier than a late heater: it rounds what the wall
    does. Beside the wall the heater does, by a log-likelihood of more than 500."""
    record, unseen = (recorded(lag=700.0, wall=150.0, n=n) for n in (500, 700))
    flat = compile_text(ROOM, Path("Room.mo"))
    found = diagnose(flat, effect_library(), [record], [unseen], DiagnoseOptions(hold="zoh"))
    accepted = {p.candidate.label: p for p in found.proofs if p.verdict == "supported"}
    late = accepted.pop("Lag at P", None)
    assert late is not None and len(accepted) == 1, found.message
    (store,) = accepted.values()
    found_at = {p.name: p for p in late.told.parameters}
    lag, wall = found_at[f"{late.candidate.name}.T"], found_at[f"{store.candidate.name}.G"]
    # A wall that touches the weather by a share is one that does not, where that is nothing.
    share = found_at.get(f"{store.candidate.name}.share")
    assert store.candidate.effect.name == "ExtraHeatCapacity" or share.value < 3 * share.std_error
    assert abs(lag.value - 700.0) < 3 * lag.std_error < 5.0
    assert abs(wall.value - 150.0) < 3 * wall.std_error < 1.0


def test_a_lag_is_tried_once_where_its_largest_response_is_none_of_a_late_signal():
    """Of a slow signal a little of a response to much may lead: that time is no trial besides."""
    (lag,) = pairs([find_effect("Signals.Lag")], [one for one in sites(_room()) if one.name == "P"])
    shaped = [replace(lag, name=f"{lag.name}_{i}") for i in (1, 2, 3)]
    times, shares = {shaped[0].name: 9600.0, shaped[1].name: 600.0, shaped[2].name: 300.0}, (0.02, 0.9, 0.9)
    entries = [
        Screened(one, 9.0, (share,), 0.0, False, 0.1) for one, share in zip(shaped, shares, strict=True)
    ]
    found = Screen(tuple(entries), np.eye(3), 0.0, 3, ())
    chosen = _chosen(found, {name: Trial(lag, (T,), ()) for name, T in times.items()})
    assert [trial.sizes for trial in chosen.lags] == [(600.0,)] and not chosen.dead_times


@pytest.mark.parametrize(("law", "n_tried"), [("Lag", 1), ("Delay", 0)])
def test_an_accepted_lag_is_asked_against_the_dead_time_at_its_signal(monkeypatch, law, n_tried):
    candidates = pairs([find_effect(f"Signals.{name}") for name in ("Lag", "Delay")], sites(_room()))
    accepted = next(one for one in candidates if one.label == f"{law} at P")
    best = SimpleNamespace(candidate=accepted, sizes=(700.0,))
    for name, made in (("ranked", lambda proofs: proofs), ("best_accepted", lambda _: best)):
        monkeypatch.setattr(course, name, made)
    asked = []
    stages = SimpleNamespace(prepared=asked.extend, proved=lambda _, proofs: ((), ()))
    one = object.__new__(course.Course)
    object.__setattr__(one, "candidates", candidates)
    object.__setattr__(one, "options", DiagnoseOptions())
    assert one._with_dead_time_for_lag(stages, [best]) == [best]
    assert [(trial.candidate.label, trial.sizes) for trial in asked] == [("Delay at P", (700.0,))] * n_tried
