"""Play between what moves and what is told of it. Simulated by steps of a play operator."""

from types import SimpleNamespace

import numpy as np
import pytest

from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.evidence import reasons
from daest.diagnosis.options import DiagnoseOptions
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_model
from daest.modelica.effects.catalogue import effect_library

MOTOR = """model Motor
  parameter Real J(unit = "kg.m2", min = 0) = 0.3;
  parameter Real k(unit = "N.m/V", min = 0) = 1 annotation(__Daest(estimate = true));
  parameter Real d(unit = "N.m.s/rad", min = 0) = 0.4 annotation(__Daest(estimate = true));
  input Real u(unit = "V");
  output Real w(unit = "rad/s") annotation(__Daest(std = 0.05));
  Real speed(unit = "rad/s", start = 0);
equation
  J*der(speed) = k*u - d*speed;
  w = speed;
end Motor;
"""
FAN = """model Fan
  parameter Real J(unit = "kg.m2", min = 0) = 0.3;
  parameter Real k(unit = "N.m/V", min = 0) = 1 annotation(__Daest(estimate = true));
  parameter Real d(unit = "N.m.s2/rad2", min = 0) = 0.1 annotation(__Daest(estimate = true));
  input Real u(unit = "V");
  output Real w(unit = "rad/s") annotation(__Daest(std = 0.05));
  Real speed(unit = "rad/s", start = 10);
equation
  J*der(speed) = k*u - d*speed*abs(speed);
  w = speed;
end Fan;
"""
EFFECTS = ("Play", "Lag", "CoulombFriction")


def played(signal: np.ndarray, width: float) -> np.ndarray:
    """The follower (n_samples,) of a signal in a play of that width, which it begins in the middle of."""
    follower, result = signal[0], []
    for value in signal:
        follower = min(max(follower, value - 0.5 * width), value + 0.5 * width)
        result.append(follower)
    return np.array(result)


def recorded(width_u: float, width_w: float) -> Experiment:
    """Straight lines between samples of the voltage, in which the machine is followed in twenty steps."""
    rng, n_steps, dt = np.random.default_rng(3), 20, 0.02
    time = dt * np.arange(700.0)
    fine = np.arange(time.size * n_steps) * dt / n_steps
    sines = ((4.0, 0.13), (3.0, 0.4), (2.0, 1.1))
    voltage = sum(a * np.sin(2.0 * np.pi * f * time + rng.uniform(0.0, 6.0)) for a, f in sines)
    pushed = played(np.interp(fine, time, voltage), width_u)
    speed, w = 0.0, []
    kept = np.exp(-0.6 / 0.3 * dt / n_steps)
    for value in pushed:
        w.append(speed)
        speed = kept * speed + (1.0 - kept) * 2.0 / 0.6 * value
    told = played(np.array(w), width_w)[::n_steps] + 0.05 * rng.normal(size=time.size)
    return Experiment("run", time, voltage[:, None], told[:, None], ("u",), ("w",))


@pytest.mark.parametrize(
    ("place", "width"),
    [
        pytest.param("w", 2.0, marks=pytest.mark.slow),  # the same law at an input: below
        pytest.param("u", 0.6, marks=pytest.mark.slow),
        pytest.param("", 0.0, marks=pytest.mark.slow),  # nothing missing: test_diagnose.py
    ],
)
def test_play_of_a_sensor_or_an_actuator_is_found(tmp_path, place: str, width: float) -> None:
    (tmp_path / "Motor.mo").write_text(MOTOR)
    record = recorded(width if place == "u" else 0.0, width if place == "w" else 0.0)
    model = compile_model(tmp_path / "Motor.mo")
    found = diagnose(model, effect_library(), [record], (), DiagnoseOptions(effects=EFFECTS))
    if not place:
        assert found.verdict == "nothing missing", found.message
        return
    assert found.verdict == "supported", found.message
    best = found.proofs[0]
    assert best.candidate.label == f"Play at {place}"
    own = next(p for p in best.told.parameters if p.name == f"{best.candidate.name}.width")
    assert own.value == pytest.approx(width, rel=0.05)


@pytest.mark.slow
def test_play_of_an_input_that_is_held_is_seen_in_a_machine_that_bends(tmp_path) -> None:
    """A play of no width forgets in which direction its signal went, before the next step shows it."""
    rng, dt, n_steps = np.random.default_rng(4), 0.05, 20
    voltage = np.repeat(rng.uniform(2.0, 14.0, 40), 20)
    speed, told = 10.0, []
    for value in played(voltage, 2.0):
        told.append(speed)
        for _ in range(n_steps):  # the middle of a step is a second order
            half = speed + 0.5 * dt / n_steps * (1.2 * value - 0.12 * speed * abs(speed)) / 0.3
            speed += dt / n_steps * (1.2 * value - 0.12 * half * abs(half)) / 0.3
    measured = np.array(told) + 0.05 * rng.normal(size=voltage.size)
    record = Experiment(
        "run", dt * np.arange(voltage.size), voltage[:, None], measured[:, None], ("u",), ("w",)
    )
    (tmp_path / "Fan.mo").write_text(FAN)
    options = DiagnoseOptions(effects=EFFECTS, hold="zoh")
    found = diagnose(compile_model(tmp_path / "Fan.mo"), effect_library(), [record], (), options)
    assert found.verdict == "supported", found.message
    best = found.proofs[0]
    assert best.candidate.label == "Play at u"
    own = next(p for p in best.told.parameters if p.name == f"{best.candidate.name}.width")
    assert abs(own.value - 2.0) < 4.0 * own.std_error and own.std_error < 0.06


def followed(signal: np.ndarray, width: float, rounding: float) -> np.ndarray:
    """What comes out of the law of the library (n_samples,), pushed along in a tenth of a sample."""
    x, result = signal[0], []
    for value in signal:
        for _ in range(20):
            z = value - x
            ends = np.hypot(z - width / 2, rounding) + np.hypot(z + width / 2, rounding)
            y = value - width * z / ends
            x += 0.5 * (y - x)
        result.append(y)
    return np.array(result)


@pytest.mark.parametrize(("rounding", "is_play"), [(0.001, True), (0.1, False)])
def test_follower_that_creeps_within_the_width_is_no_play(
    monkeypatch, rounding: float, is_play: bool
) -> None:
    """A square wave behind a play of half its size: with round kinks it relaxes within thirty samples."""
    signal = np.tile(np.repeat([0.0, 1.0], 50), 4)
    along = np.stack([signal, followed(signal, 0.5, rounding)])
    monkeypatch.setattr(reasons, "_along", lambda *_: along)
    effect = next(e for e in effect_library() if e.name == "Play")
    candidate = SimpleNamespace(effect=effect, name="play")
    model = SimpleNamespace(experiments=[SimpleNamespace(n_samples=signal.size)])
    told = SimpleNamespace(theta={"play.width": 0.5})
    assert (reasons.creeping(model, candidate, told) == "") is is_play


@pytest.mark.parametrize(("width", "is_told"), [(0.9, True), (2.2, False)])
def test_play_that_is_wider_than_its_signal_is_not_told(monkeypatch, width: float, is_told: bool) -> None:
    """Of a heater that is on or off, where each piece of a record begins with a follower of its own."""
    signal = np.tile(np.repeat([0.0, 1.0], 50), 4)
    monkeypatch.setattr(reasons, "_along", lambda *_: np.stack([signal, signal]))
    effect = next(e for e in effect_library() if e.name == "Play")
    told = SimpleNamespace(theta={"play.width": width})
    candidate = SimpleNamespace(effect=effect, name="play")
    assert (reasons.too_wide(None, candidate, told) == "") is is_told


@pytest.mark.parametrize(("a", "is_told"), [(0.3, True), (-0.06, True), (-0.097, False)])
def test_a_gain_that_turns_its_signal_back_is_not_told(monkeypatch, a: float, is_told: bool) -> None:
    """A flow that decays from 10: with -0.06 its summit is at 8.3 and nearly all comes through at 10, with
    -0.097 it is at 5.2 and next to nothing does."""
    signal = 10.0 * np.exp(-0.05 * np.arange(100.0))
    along = np.stack([signal, signal + a * signal * np.abs(signal)])
    monkeypatch.setattr(reasons, "_along", lambda *_: along)
    effect = next(e for e in effect_library() if e.name == "QuadraticGain")
    candidate = SimpleNamespace(effect=effect, name="bend")
    assert (reasons.turned_back(None, candidate, None) == "") is is_told
