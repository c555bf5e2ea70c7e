"""Inputs of one model of which one is held between samples and the other runs straight."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from daest.data.prepare import resample
from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.options import DiagnoseOptions
from daest.errors import ConfigError, ModelError
from daest.estimation.filter import run_filter
from daest.estimation.identify import identify
from daest.estimation.linear.hold_search import are_steps, moving_inputs, ranked_holds
from daest.model.estimates import FilterOptions
from daest.model.experiment import Experiment
from daest.model.fit import IdentifyOptions
from daest.model.holds import checked_hold, held_inputs, mixed_hold
from daest.modelica.compile import compile_text
from daest.modelica.effects.catalogue import effect_library
from daest.systems.linear.state_space import (
    sample,
    sample_derivatives,
    state_space,
    state_space_derivatives,
    state_space_family,
)
from daest.systems.simulation.simulate import simulate

ROOM = """model Room "A room that a relay heats; `r` is how much better moving air conducts"
  parameter Real C(unit = "J/K") = 4e6 annotation(__Daest(estimate = true));
  parameter Real G(unit = "W/K") = 300 annotation(__Daest(estimate = true));
  parameter Real r(unit = "W/K3") = 0;
  input Real P(unit = "W") "heating";
  input Real To(unit = "K") "outside";
  output Real T(unit = "K", start = 290, fixed = true);
equation
  C*der(T) = P - G*(T - To)LAW;
end Room;
"""
DT, N = 600.0, 300


def room(tmp_path, law=""):
    return compile_text(ROOM.replace("LAW", law).encode(), tmp_path / "Room.mo")


@cache
def recording(noise=0.0, r=0.0, seed=1, n=N):
    """By scipy, interval by interval: the heating stays, the outside temperature runs on."""
    rng = np.random.default_rng(seed)
    time = DT * np.arange(n)
    P = np.repeat(rng.choice([0.0, 2000.0, 5000.0], n), rng.integers(1, 6, n))[:n]
    To = 278 + 5 * np.sin(2 * np.pi * time / 86400) + np.cumsum(rng.normal(size=n))
    T = [291.0]
    for k in range(n - 1):

        def rate(t, x, k=k):
            off = x - To[k] - (To[k + 1] - To[k]) * t / DT
            return (P[k] - 260 * off - r * off**3) / 4.3e6

        T.append(solve_ivp(rate, (0, DT), [T[-1]], rtol=1e-10, atol=1e-10).y[0, -1])
    y = np.array(T) + noise * rng.normal(size=n)
    return Experiment("run", time, np.column_stack([P, To]), y[:, None], ("P", "To"), ("T",))


@pytest.mark.parametrize("law", ["", " - r*(T - To)^3"])
def test_simulation_is_that_of_scipy(tmp_path, law):
    data = recording(r=0.4 if law else 0.0)
    flat = room(tmp_path, law)
    flat = flat.with_theta({"C": 4.3e6, "G": 260.0, "r": 0.4 if law else 0.0})
    run = simulate(flat, data, hold="zoh(P)", x0={"T": 291.0}, rtol=1e-9)
    np.testing.assert_allclose(run["T"], data.outputs[:, 0], rtol=0, atol=1e-5)
    for other in ("zoh", "foh", "zoh(To)"):
        run = simulate(flat, data, hold=other, x0={"T": 291.0})
        assert np.max(np.abs(run["T"] - data.outputs[:, 0])) > 0.05


@pytest.mark.parametrize("law", ["", pytest.param(" - r*(T - To)^3", marks=pytest.mark.slow)])
def test_identification_takes_the_right_hold_and_finds_the_truth(tmp_path, law):
    r = 0.4 if law else 0.0
    flat = room(tmp_path, law).with_theta({"r": r})
    fit = identify(flat, [recording(0.01, r)])
    assert fit.hold == "zoh(P)"
    for name, truth in (("C", 4.3e6), ("G", 260.0)):
        found = next(p for p in fit.parameters if p.name == name)
        assert abs(found.value - truth) < 4 * found.std_error
    given = identify(flat, [recording(0.01, r)], IdentifyOptions(hold="zoh(To, P)"))
    assert given.hold == "zoh"
    assert given.log_likelihood < fit.log_likelihood - 100


@pytest.mark.parametrize("kind", ["time-varying", "ekf", "ukf"])
def test_filters_know_what_each_input_does(tmp_path, kind):
    """Where the model and its inputs are right, the innovations are the noise of the sensor."""
    law = "" if kind == "time-varying" else " - r*(T - To)^3"
    values = {"C": 4.3e6, "G": 260.0, "r": 0.4 if law else 0.0}
    flat = room(tmp_path, law).with_theta(values)
    flat = replace(flat, outputs=(replace(flat.outputs[0], noise_std=0.01),))
    data = recording(0.01, values["r"])
    sizes = [
        np.std(run_filter(flat, data, kind, FilterOptions(hold=hold)).innovations[20:])
        for hold in ("zoh(P)", "zoh", "foh")
    ]
    assert sizes[0] == pytest.approx(0.01, rel=0.15)
    assert min(sizes[1:]) > 1.5 * sizes[0]


def test_slopes_of_sampled_matrices_are_finite_differences(tmp_path):
    family = state_space_family(room(tmp_path))
    theta = np.array([4.3e6, 260.0, 0.0])
    exact = state_space_derivatives(family, theta, ["G"])
    found = sample_derivatives(state_space(family, theta), exact, DT, "zoh(P)")
    step = np.array([0.0, 1e-3, 0.0])
    ahead, back = (sample(state_space(family, theta + s * step), DT, "zoh(P)") for s in (1, -1))
    for name in ("input_now", "input_next"):
        slope = (getattr(ahead, name) - getattr(back, name)) / 2e-3
        np.testing.assert_allclose(getattr(found, name)[0], slope, rtol=1e-6, atol=1e-15)
    assert ahead.input_next[0, 0] == 0.0 < ahead.input_next[0, 1]


def test_a_coarser_recording_knows_each_input(tmp_path):
    """What was held comes half a period later, what ran straight does not."""
    data = recording()
    found = resample(data, 3 * DT, "zoh(P)")
    held, straight = (resample(data, 3 * DT, hold) for hold in ("zoh", "foh"))
    assert np.array_equal(found.inputs[:, 0], held.inputs[:, 0])
    assert np.array_equal(found.inputs[:, 1], straight.inputs[:, 1])
    assert not np.allclose(held.inputs, straight.inputs)


@pytest.mark.slow
def test_nothing_is_missing_where_inputs_differ_in_their_hold(tmp_path):
    """Nor does a column drive the room that the model does not know."""
    data = recording(0.01, n=500)
    wind = np.abs(np.random.default_rng(4).normal(size=500))
    columns = [replace(data, extra={"wind": wind})]
    found = diagnose(room(tmp_path), effect_library(()), columns, options=DiagnoseOptions())
    assert found.verdict == "nothing missing"
    tried = {entry.candidate.effect.name for entry in found.screen.entries}
    assert "MeasuredHeatGain" in tried


def test_names_are_inputs(tmp_path):
    flat = room(tmp_path)
    with pytest.raises(ConfigError) as caught:
        identify(flat, [recording()], IdentifyOptions(hold="zoh(p)"))
    assert caught.value.code == "option-hold"
    assert "did you mean P?" in str(caught.value)
    with pytest.raises(ConfigError, match="no hold of inputs"):
        checked_hold("held", ("P",))
    assert checked_hold("zoh( To,P )", ("P", "To")) == "zoh"
    assert held_inputs("zoh(u[1, 2], v)", ("u[1, 2]", "v", "w")).tolist() == [True, True, False]
    assert mixed_hold({"b", "a"}, ("a", "b", "c")) == "zoh(a, b)"


def test_the_slope_of_an_input_that_runs_straight_is_there(tmp_path):
    text = "model M\n input Real u, v;\n Real x = u;\n output Real y = der(x) + v;\nend M;\n"
    flat = compile_text(text.encode(), tmp_path / "M.mo")
    inputs = np.column_stack([np.arange(5.0) ** 2, np.ones(5)])
    run = simulate(flat, (np.arange(5.0), inputs), hold="zoh(v)")
    np.testing.assert_allclose(run["y"][1:4], 2.0 * np.arange(1.0, 4.0) + 1.0)
    with pytest.raises(ModelError, match="time derivative of input u"):
        simulate(flat, (np.arange(5.0), inputs), hold="zoh(u)")


def test_of_many_inputs_the_roughest_are_asked():
    """One that stands still can be held or not, and one that hardly moves nearly so."""
    n, rng = 50, np.random.default_rng(0)
    names = ("still", *(f"u{i}" for i in range(8)), "ramp")
    columns = [np.ones(n), *rng.normal(size=(8, n)), np.arange(n)]
    data = Experiment("r", np.arange(float(n)), np.column_stack(columns), np.ones((n, 1)), names, ("y",))
    found = moving_inputs([data], names)
    assert len(found) == 6 and set(found) <= {f"u{i}" for i in range(8)}
    assert list(found) == sorted(found)
    assert moving_inputs([data], ("still", "ramp")) == ("ramp",)


def test_inputs_that_differ_must_gain_more():
    """One look at each input, and no mixture for a little."""
    gains = {"foh": 0.0, "zoh": 5.0, "zoh(b, c)": 7.0, "zoh(a, c)": 20.0, "zoh(a)": 19.0}
    asked = []

    def likelihood(hold):
        asked.append(hold)
        return gains.get(hold)

    assert ranked_holds(("a", "b", "c"), likelihood)[0] == "zoh(a, c)"
    assert asked == ["foh", "zoh", "zoh(b, c)", "zoh(a, c)", "zoh(a)"]
    assert ranked_holds(("a",), lambda hold: {"foh": 1.0, "zoh": 0.0}[hold]) == ["foh", "zoh"]
    assert ranked_holds(("a", "b"), lambda hold: None) == []


@pytest.mark.parametrize(
    ("values", "asked", "best"),
    [
        ({"foh": 1.0, "zoh": 0.0, "smooth": 5.0}, ["foh", "zoh", "smooth"], "smooth"),
        ({"foh": 1.0, "zoh": 0.0, "smooth": 0.5, "zoh(a)": 0.0, "zoh(b)": 0.0}, None, "foh"),
        ({"foh": 0.0, "zoh": 1.0, "zoh(a)": 0.0, "zoh(b)": 0.0}, None, "zoh"),
    ],
)
def test_smooth_inputs_are_asked_for_where_straight_lines_lead(values, asked, best):
    seen = []

    def likelihood(hold):
        seen.append(hold)
        return values[hold]

    assert ranked_holds(("a", "b"), likelihood, ("foh", "zoh", "smooth"))[0] == best
    assert asked is None or seen == asked


def test_smooth_inputs_of_a_search_that_has_them_are_compared():
    values = {"foh": 1.0, "zoh": 0.0, "smooth": 5.0}
    assert ranked_holds((), values.__getitem__, ("smooth", "foh", "zoh")) == ["smooth", "foh", "zoh"]


@pytest.mark.parametrize("seed", range(6))
def test_recorded_steps_are_held_unless_straight_lines_fit_better(tmp_path, seed):
    """A resistance before a capacitor takes half a sample: R + T/(2 C) with held currents fits as R does with
    straight lines, and only the steps of the record tell which it is."""
    text = """model Cell
  parameter Real C(unit = "F") = 130 annotation(__Daest(estimate = true));
  parameter Real R(unit = "Ohm") = 0.006 annotation(__Daest(estimate = true));
  input Real i(unit = "A");
  output Real v(unit = "V") annotation(__Daest(std = 0.002));
  Real x(unit = "V", start = 1);
equation
  C*der(x) = i;
  v = x + R*i;
end Cell;
"""
    rng = np.random.default_rng(seed)
    time = 0.5 * np.arange(1200)
    i = np.repeat(rng.uniform(-10, 10, 50), 24)
    x = 1 + np.concatenate([[0.0], np.cumsum(i)[:-1]]) * 0.5 / 150
    v = x + 0.009 * i + 0.002 * rng.standard_normal(1200)
    data = Experiment("steps", time, i[:, None], v[:, None], ("i",), ("v",))
    fit = identify(compile_text(text.encode(), tmp_path / "Cell.mo"), [data])
    (R,) = (p for p in fit.parameters if p.name == "R")
    assert fit.hold == "zoh" and abs(R.value - 0.009) < 4 * R.std_error


def test_steps_are_told_from_courses():
    time = np.arange(40.0)
    courses = np.column_stack([np.repeat(np.arange(10.0), 4), np.sin(time)])
    data = Experiment("r", time, courses, time[:, None], ("s", "m"), ("y",))
    assert are_steps([data], ("s",)) and not are_steps([data], ("s", "m")) and not are_steps([data], ())
    values = {"foh": 1.0, "zoh": 0.0}
    assert ranked_holds(("s",), values.get) == ["foh", "zoh"]
    assert ranked_holds(("s",), values.get, in_steps=True) == ["zoh", "foh"]
    assert ranked_holds(("s",), {"foh": 50.0, "zoh": 0.0}.get, in_steps=True)[0] == "foh"
