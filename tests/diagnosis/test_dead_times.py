"""Dead times found by shifts of a recording. Simulated by LSODA."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from test_bent_models import ARM

from daest.diagnosis.built_in.chosen import chosen_candidates
from daest.diagnosis.built_in.dead_times import best_shift, shifted_back
from daest.diagnosis.comparison.compare import follower
from daest.diagnosis.comparison.trial import Candidate
from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.null_model.loads import load_sites
from daest.diagnosis.null_model.null import fit_null
from daest.diagnosis.options import DiagnoseOptions
from daest.diagnosis.screening.candidates import attached, pairs, with_shapes
from daest.model.effects import Site
from daest.model.experiment import Experiment
from daest.model.fit import IdentifyOptions
from daest.modelica.compile import compile_text
from daest.modelica.effects.catalogue import effect_library
from daest.modelica.places.sites import sites

PERIOD, TRUE = 0.04, {"k": 0.8, "d": 0.3}


def recorded(dead_input: float = 0.0, dead_output: float = 0.0, n: int = 700) -> Experiment:
    """A pendulum, its voltage or its angle late [s]."""
    rng = np.random.default_rng(3)
    voltage = np.repeat(rng.uniform(-3.5, 3.5, n // 25), 25)
    time = PERIOD * np.arange(n)

    def rates(t: float, z: np.ndarray) -> list[float]:
        late = int((t - dead_input) / PERIOD + 1e-9)
        return [z[1], (TRUE["k"] * voltage[max(late, 0)] - TRUE["d"] * z[1] - 4.0 * np.sin(z[0])) / 0.1]

    run = solve_ivp(rates, (0.0, time[-1]), [0.0, 0.0], "LSODA", time, max_step=PERIOD / 2, rtol=1e-8)
    angle = np.interp(time - dead_output, time, run.y[0]) + rng.normal(0.0, 2e-3, n)
    return Experiment("run", time, voltage[:, None], angle[:, None], ("u",), ("y",))


def signal(name: str) -> Site:
    return next(s for s in sites(compile_text(ARM, Path("Arm.mo"))) if s.name == name and s.kind != "node")


def test_shift_is_that_of_one_signal():
    record = recorded(n=100)
    by_input = shifted_back(record, signal("u"), 2 * PERIOD)
    assert np.array_equal(by_input.outputs, record.outputs)
    np.testing.assert_allclose(by_input.inputs[2:], record.inputs[:-2])
    by_output = shifted_back(record, signal("y"), 3 * PERIOD)
    assert np.array_equal(by_output.inputs, record.inputs)
    np.testing.assert_allclose(by_output.outputs[:-3], record.outputs[3:])
    assert np.all(np.isnan(by_output.outputs[-2:]))


@pytest.mark.parametrize(
    ("name", "dead"),
    [pytest.param("u", {"dead_input": 0.16}, marks=pytest.mark.slow), ("y", {"dead_output": 0.16})],
)
def test_likeliest_shift_is_the_dead_time(name, dead):
    flat, record = compile_text(ARM, Path("Arm.mo")), recorded(**dead, n=275)
    null = fit_null(flat, load_sites(flat), [record], "zoh")
    options = IdentifyOptions(
        method="oe", estimate=("k", "d"), fix=null.shortest_times, hold="zoh", shooting=1
    )
    found = best_shift(null, signal(name), [0.12, 0.16, 0.2], options)
    assert found is not None and found.delay == 0.16
    assert found.theta["k"] == pytest.approx(TRUE["k"], rel=0.03)
    assert found.theta["d"] == pytest.approx(TRUE["d"], rel=0.1)


@pytest.mark.slow
def test_dead_time_beside_a_pendulum() -> None:
    flat = compile_text(ARM, Path("Arm.mo"))
    options = DiagnoseOptions(effects=("Lag", "Delay", "CoulombFriction"), hold="zoh")
    found = diagnose(flat, effect_library(), [recorded(dead_input=0.16, n=1400)], (), options)
    named = {
        (p.candidate.effect.name, p.candidate.site.name) for p in found.proofs if p.verdict != "rejected"
    }
    assert ("Delay", "u") in named, found.message


ROLL_OUT = """
model RollOut
  parameter Real m(unit = "kg") = 76;
  parameter Real f0(unit = "N") = 4;
  Real v(unit = "m/s", start = 8);
  output Real speed(unit = "m/s");
equation
  m*der(v) = -f0;
  speed = v;
end RollOut;
"""


@pytest.mark.parametrize("n_outputs", [1, 2])
def test_what_runs_by_itself_is_not_late(n_outputs):
    """Behind a dead time it is as it would be with another start; of two sensors one may be late."""
    text = ROLL_OUT
    if n_outputs == 2:
        text = text.replace("equation", '  output Real wheel(unit = "m/s");\nequation\n  wheel = v;')
    names, time = ("speed", "wheel")[:n_outputs], np.arange(50.0)
    record = Experiment("run", time, np.zeros((50, 0)), np.ones((50, n_outputs)), (), names)
    places = sites(compile_text(text.encode(), Path("RollOut.mo")))
    found = chosen_candidates(effect_library(), places, [record], DiagnoseOptions())
    late = {c.site.name for c in found if c.effect.name == "Delay"}
    assert late == (set() if n_outputs == 1 else set(names))
    assert "Lag" in {c.effect.name for c in found}


DRIVEN_ROLL_OUT = ROLL_OUT.replace("  Real v", '  input Real f(unit = "N");\n  Real v').replace(
    "-f0", "f - f0"
)


@pytest.mark.parametrize("forces", [(0.0, 0.0), (-3.0, 5.0), (0.0, 5.0)])
def test_what_is_zero_is_not_late(forces):
    """A lag at an input of zero dies out from its own start; what keeps another level was switched on."""
    places = sites(compile_text(DRIVEN_ROLL_OUT.encode(), Path("RollOut.mo")))
    time, outputs = np.arange(50.0), np.ones((50, 1))
    rest = [Experiment("run", time, np.full((50, 1), f), outputs, ("f",), ("speed",)) for f in forces]

    def late(records):
        found = chosen_candidates(effect_library(), places, records, DiagnoseOptions())
        assert "Gain at f" in {c.label for c in found}
        return {c.label for c in found if c.effect.name in ("Lag", "Delay") and c.is_of_recorded}

    at_force = {"Lag at f", "Delay at f"}
    assert late(rest) == {"Lag at speed", *(at_force if any(forces) else ())}, "as late from another start"
    moved = replace(rest[0], inputs=np.where(time > 25.0, 1.0, forces[0])[:, None])
    assert late([moved, rest[1]]) == {*at_force, "Lag at speed", "Delay at speed"}


def test_sensor_that_is_hardly_ever_read_has_no_law():
    """Through six samples of a sensor goes a drift as well as the growth that they show."""
    text = ROLL_OUT.replace("equation", '  output Real wheel(unit = "m/s");\nequation\n  wheel = v;')
    places = sites(compile_text(text.encode(), Path("RollOut.mo")))
    outputs = np.ones((60, 2))
    outputs[np.arange(60) % 10 > 0, 1] = np.nan
    record = Experiment("run", np.arange(60.0), np.zeros((60, 0)), outputs, (), ("speed", "wheel"))

    def at_sensors(records, **asked):
        found = chosen_candidates(effect_library(), places, records, DiagnoseOptions(**asked))
        return {c.site.name for c in found if c.site.kind == "output"}

    assert at_sensors([record]) == {"speed"}
    assert at_sensors([record] * 4) == {"speed", "wheel"}, "all recordings together read it often enough"
    assert at_sensors([record], places=("wheel",)) == {"wheel"}, "who asks for it gets it"


@pytest.mark.parametrize("levels", [(4.0, 12.0), (4.0, 8.0, 12.0)])
def test_two_levels_of_an_input_show_no_bend(levels):
    """A line goes through two points, whatever the law; an offset is still told by a dead zone."""
    places = sites(compile_text(DRIVEN_ROLL_OUT.encode(), Path("RollOut.mo")))
    time, outputs = np.arange(50.0), np.ones((50, 1))
    records = [Experiment("run", time, np.full((50, 1), f), outputs, ("f",), ("speed",)) for f in levels]
    found = chosen_candidates(effect_library(), places, records, DiagnoseOptions())
    at_force = {c.effect.name for c in found if c.site.name == "f" and c.site.kind == "input"}
    assert {"Gain", "Offset", "DeadZone", "Lag"} <= at_force
    bent = {"Saturation", "OneSidedLimit", "QuadraticGain"} & at_force
    assert len(bent) == (0 if len(levels) == 2 else 3)


@pytest.mark.parametrize("period", [0.01, 40.0])
def test_what_swings_does_so_no_faster_than_samples_tell(period):
    """A search that loses its way else makes the period ever shorter."""
    time = period * np.arange(50.0)
    record = Experiment("run", time, np.zeros((50, 0)), np.ones((50, 1)), (), ("speed",))
    flat = compile_text(ROLL_OUT.encode(), Path("RollOut.mo"))
    found = chosen_candidates(
        effect_library(), sites(flat), [record], DiagnoseOptions(effects=("FlexibleAppendage",))
    )
    shaped, _ = with_shapes(flat, found, time, {"v": np.ones(50)}, np.zeros((50, 0)))
    assert shaped and all(c.shape["T"] >= 2.0 * period for c in shaped)
    grown = attached(flat, shaped[:1])
    (own,) = (p for p in grown.parameters if p.name == f"{shaped[0].name}.T")
    assert own.min == pytest.approx(2.0 * period) and own.min <= own.value


def test_candidates_have_names_that_no_component_of_the_model_has():
    places = sites(compile_text(ROLL_OUT.encode(), Path("RollOut.mo")))
    found = pairs(effect_library(), places)
    assert [c.name for c in found[:4]] == ["effect_1", "effect_2", "effect_3", "effect_4"]
    later = pairs(effect_library(), places, taken={"effect_1", "effect_3_2", "car"})
    assert [c.name for c in later[:2]] == ["effect_2", "effect_4"]


CHAMBER = """
model Chamber "a module heats a chamber with a second store: late, and less than its output says"
  input Real u;
  output Real oven(unit = "degC");
  Real heat;
  Real T(unit = "K", start = 297);
  Real late;
  Real behind(unit = "K");
equation
  late = delay(u, 1.3);
  6.5*der(heat) = late - 0.001*late*sqrt(late^2 + 0.2^2) - heat;
  2.5*der(T) = 0.03*heat - 0.2*(T - 293.7) - 1.5*behind;
  23*der(behind) = 23*der(T) - behind;
  oven = T - 273.15;
end Chamber;
"""


def test_a_late_input_before_a_law_that_bends_begins_where_it_did():
    """What a short delay holds is hardly seen: the search for it had stuck at 18 times the noise."""
    rng = np.random.default_rng(0)
    records = [chamber_record(rng, most) for most in (205.0, 190.0)]
    model = compile_text(CHAMBER.encode(), Path("Chamber.mo"))
    found = follower(Candidate("Chamber", model, 0, "zoh"), records)(model.theta_values)
    errors = [float(np.std(r.outputs - simulated)) for r, simulated in zip(records, found, strict=True)]
    np.testing.assert_allclose(errors, 0.005, rtol=0.15)


def chamber_record(rng: np.random.Generator, most: float) -> Experiment:
    """Two controlled steps, of outputs up to `most`, by Euler's rule in steps of 10 ms."""
    u, y = np.zeros((120, 1)), np.zeros((120, 1))
    past = [20.0] * 130
    oven, store, heat = 23.9, 24.2, -10.0
    for k, goal in enumerate(np.repeat([25.0, 26.0], 60)):
        y[k] = oven + rng.normal(0.0, 0.005)
        u[k] = np.clip(30.0 + 208.0 * (goal - oven), 5.0, most)
        for _ in range(100):
            past.append(float(u[k, 0]))
            late = past.pop(0)
            flow = 0.03 * heat - 0.2 * (oven - 20.55) - 1.5 * (oven - store)
            store += 0.01 * (oven - store) / 23.0
            oven += 0.01 * flow / 2.5
            heat += 0.01 * (late - 0.001 * late * np.hypot(late, 0.2) - heat) / 6.5
    return Experiment("run", np.arange(120.0), u, y, ("u",), ("oven",))
