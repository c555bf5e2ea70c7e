"""A heater behind a lag, switched on once when the recording begins: its lag looks like a load that decays
from then on. Simulated by the closed solution."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from daest.diagnosis.answers import unexplained
from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.evidence import load_starts, noise_level
from daest.diagnosis.evidence.stand import without_noises
from daest.diagnosis.null_model.loads import load_sites
from daest.diagnosis.null_model.null import fit_null
from daest.estimation.identify import identify
from daest.model.diagnosis import Diagnosis
from daest.model.experiment import Experiment
from daest.model.fit import IdentifyOptions
from daest.model.holds import FOH
from daest.modelica.compile import compile_model
from daest.modelica.effects.catalogue import effect_library

HEATER = """model Heater
  parameter Real C(unit = "J/K", min = 0) = 8 annotation(__Daest(estimate = true));
  parameter Real U(unit = "W/K", min = 0) = 0.05 annotation(__Daest(estimate = true));
  parameter Real T_ambient(unit = "degC") = 21;
  input Real P(unit = "W");
  output Real T(unit = "degC", start = 21);
equation
  C*der(T) = U*(T_ambient - T) + P;
end Heater;
"""
C, U, LAG = 5.0, 0.03, 17.0


def _warmed(lag: float, powers: list[float], each: int = 600) -> Experiment:
    """The heater with one power after the other, `each` that many seconds, and sensor noise of 0.1 degC."""
    rate = U / C
    time, T, heat = [], [], []
    above, late = 0.0, 0.0
    for number, power in enumerate(powers):
        t = np.arange(each, dtype=float)
        slow, fast = np.exp(-rate * t), np.exp(-t / lag) if lag else np.zeros_like(t)
        # What the heater still holds back or gives back from before decays by exp(-t/lag).
        held = (late - power) / C / (rate - 1.0 / lag) * (fast - slow) if lag else 0.0
        T.append(21.0 + above * slow + power / U * (1.0 - slow) + held)
        heat.append(np.full(each, power))
        time.append(t + each * number)
        end = np.exp(-rate * each), np.exp(-each / lag) if lag else 0.0
        kept = (late - power) / C / (rate - 1.0 / lag) * (end[1] - end[0]) if lag else 0.0
        above = above * end[0] + power / U * (1.0 - end[0]) + kept
        late = power + (late - power) * end[1]
    noise = np.random.default_rng(5).normal(0.0, 0.1, each * len(powers))
    outputs = (np.concatenate(T) + noise)[:, None]
    return Experiment("warmed", np.concatenate(time), np.concatenate(heat)[:, None], outputs, ("P",), ("T",))


def _diagnosed(folder: Path, experiment: Experiment, *names: str) -> Diagnosis:
    """With effects of these names, or with all."""
    (folder / "Heater.mo").write_text(HEATER)
    effects = [effect for effect in effect_library() if not names or effect.name in names]
    return diagnose(compile_model(folder / "Heater.mo"), effects, [experiment])


@pytest.mark.parametrize(
    "names", [("Lag", "Delay", "HeatLoss"), pytest.param((), marks=pytest.mark.slow)], ids=["some", "all"]
)
def test_one_step_of_a_heater_behind_a_lag(tmp_path: Path, names: tuple[str, ...]) -> None:
    """A dead time of ten states could follow the transient by how its states begin."""
    found = _diagnosed(tmp_path, _warmed(LAG, [2.0]), *names)
    assert found.verdict == "supported"
    assert found.proofs[0].candidate.label == "Lag at P"
    T = found.proofs[0].told.theta[f"{found.proofs[0].candidate.name}.T"]
    assert pytest.approx(LAG, rel=0.1) == T


@pytest.mark.slow  # what is told: test_load_that_no_law_takes_over_is_told
def test_a_load_that_begins_with_the_recording_is_no_silence(tmp_path: Path) -> None:
    """The same where only lags are tried that the data do not support: that something is there is said."""
    experiment = _warmed(LAG, [2.0])
    (tmp_path / "Heater.mo").write_text(HEATER)
    effects = [effect for effect in effect_library() if effect.name == "Drift"]
    found = diagnose(compile_model(tmp_path / "Heater.mo"), effects, [experiment])
    assert found.verdict == "external disturbance"
    assert "begins with the recording" in found.message


@pytest.mark.parametrize("lag", [LAG, 0.0])
def test_simulation_that_rests_on_how_loads_begin(tmp_path: Path, lag: float) -> None:
    """Loads whose noises vanish simulate the lag as well as they predict it. Without them the model does
    not."""
    (tmp_path / "Heater.mo").write_text(HEATER)
    flat = compile_model(tmp_path / "Heater.mo")
    experiment = _warmed(lag, [2.0])
    null = fit_null(without_noises(flat), load_sites(flat), [experiment], FOH)
    without = identify(flat, [experiment], IdentifyOptions(method="oe", hold=FOH))
    assert load_starts.rests_on_starts(null, null.fit, without) == (lag > 0.0)


@pytest.mark.parametrize("rests", [False, True])
def test_simulation_that_rests_on_how_loads_begin_is_no_silence(
    monkeypatch: pytest.MonkeyPatch, rests: bool
) -> None:
    monkeypatch.setattr(noise_level, "rests_on_starts", lambda null, fit, without: rests)
    with_loads, without = _simulated_to(0.28), _simulated_to(1.5)
    experiment = SimpleNamespace(outputs=np.zeros((400, 1)))
    null = SimpleNamespace(experiments=[experiment])
    assert noise_level.simulates_to_noise(null, with_loads, without) != rests
    assert noise_level.simulates_to_noise(null, with_loads, with_loads)


def _simulated_to(error: float) -> SimpleNamespace:
    """A fit that predicts to 0.28, and simulates to that error."""
    simulated, one_step = (
        {data: SimpleNamespace(rms={"i": rms}) for data in noise_level.RECORDED} for rms in (error, 0.28)
    )
    return SimpleNamespace(simulated=simulated, one_step=one_step)


@pytest.mark.slow  # nothing missing: test_diagnose.py
def test_one_step_of_a_heater_without_lag(tmp_path: Path) -> None:
    assert _diagnosed(tmp_path, _warmed(0.0, [2.0])).verdict == "nothing missing"


@pytest.mark.slow
def test_several_steps_tell_the_lag(tmp_path: Path) -> None:
    found = _diagnosed(tmp_path, _warmed(LAG, [2.0, 0.5, 3.0, 1.0, 2.5, 0.0], each=200))
    assert found.verdict != "nothing missing"
    assert "Lag" in found.message


ROLL_OUT = """model RollOut
  parameter Real m(unit = "kg") = 1520;
  parameter Real f0(unit = "N", min = 0) = 150 annotation(__Daest(estimate = true));
  parameter Real f1(unit = "N.s/m", min = 0) = 5 annotation(__Daest(estimate = true));
  Real v(unit = "m/s", start = 30);
  output Real speed(unit = "m/s") = v annotation(__Daest(std = 0.03));
equation
  m*der(v) = -f0 - f1*v;
end RollOut;
"""


def _rolled(number: int, start: float) -> Experiment:
    """A car that rolls out against 190 N + 4 N.s/m v + 0.39 N.s2/m2 v²: v is a tangent of the time."""
    rng = np.random.default_rng(number)
    time = 0.2 * np.arange(420.0)
    a, b, c = 0.39 / 1520, 4.0 / 1520, 190.0 / 1520
    w = np.sqrt(4 * a * c - b * b)
    angle = np.arctan((2 * a * start + b) / w) - w * (time - time[0]) / 2
    v = (w * np.tan(angle) - b) / (2 * a)
    outputs = (v + rng.normal(0.0, 0.028, time.size))[:, None]
    return Experiment(f"run{number}", time, np.empty((time.size, 0)), outputs, (), ("speed",))


@pytest.mark.slow
def test_loads_whose_starts_are_certain_together_only_are_no_silence(tmp_path: Path) -> None:
    """The drag of a car that rolls out without any input looks like a load that decays in every run; other
    parameters make the start of each uncertain."""
    (tmp_path / "RollOut.mo").write_text(ROLL_OUT)
    runs = [_rolled(number, start) for number, start in enumerate((33.5, 31.0, 24.0, 34.0))]
    effects = [effect for effect in effect_library() if effect.name in ("Drift", "Offset")]
    found = diagnose(compile_model(tmp_path / "RollOut.mo"), effects, runs)
    assert found.verdict != "nothing missing"


@pytest.mark.slow  # test_one_step_of_a_heater_behind_a_lag
def test_law_takes_the_place_of_loads_that_begin_with_the_recordings(tmp_path: Path) -> None:
    (tmp_path / "RollOut.mo").write_text(ROLL_OUT)
    runs = [_rolled(number, start) for number, start in enumerate((33.5, 24.0, 34.0))]
    effects = [effect for effect in effect_library() if effect.name in ("QuadraticDrag", "Offset")]
    found = diagnose(compile_model(tmp_path / "RollOut.mo"), effects, runs)
    law, fit = found.proofs[0].candidate, found.proofs[0].told
    assert found.verdict == "supported" and law.effect.name == "QuadraticDrag"
    drag = next(p for p in fit.parameters if p.name == f"{law.name}.k")
    assert drag.std_error is not None and abs(drag.value - 0.39) < 3 * drag.std_error < 0.1


def test_load_that_no_law_takes_over_is_told() -> None:
    load = SimpleNamespace(place="body", unit="W", time_constant=17.0)
    decided = unexplained._of_starts(
        SimpleNamespace(proofs=(), clock="s"), [SimpleNamespace(load=load, value=2.0)]
    )
    assert decided.name == "external disturbance"
    assert "a load at body that begins with the recording (2 W, gone by" in decided.message


def test_starts_that_make_nothing_likelier_are_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """A treadmill that sticks: its load of 22.7 N stood many standard errors off zero and bought 1.4."""
    asked: list[float] = []
    monkeypatch.setattr(load_starts, "from_nowhere", lambda null, bought: asked.append(bought) or ("start",))
    assert load_starts.starts_from_nowhere(None, 1.4, 2.6) == ()
    assert load_starts.starts_from_nowhere(None, 40.0, 2.5) == ("start",)
    assert asked == [37.5]
