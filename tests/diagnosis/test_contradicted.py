"""Recordings that contradict the model whatever it lacks: turned signals, and other units."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from oscillator import OSCILLATOR, record

from daest.data import contradictions as recorded
from daest.data.contradictions import Contradiction, Exchange, contradictions, exchanges
from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.improve import improve
from daest.diagnosis.recordings import contradicted as module
from daest.diagnosis.recordings.contradicted import contradicted
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_text
from daest.numerics.deadline import check
from daest.systems.simulation.simulate import simulate

Y, V = 0, 1


@pytest.fixture(scope="module")
def case():
    flat = compile_text(OSCILLATOR.format(extra="").encode(), Path("Oscillator.mo"))
    stiff = tuple(replace(p, estimate=p.estimate and p.name != "b") for p in flat.parameters)
    return replace(flat, parameters=stiff), record(flat, 600, 1)


def test_a_turned_input_with_which_no_simulation_ends_is_no_contradiction(monkeypatch) -> None:
    def endless(*_) -> float:
        while True:
            check()

    monkeypatch.setattr(recorded, "_relative_error", endless)
    assert recorded._error_within(0.05, None, None, None) == np.inf


def times(experiment, column, factor):
    outputs = experiment.outputs.copy()
    outputs[:, column] *= factor
    return replace(experiment, outputs=outputs)


def against(experiment):
    return replace(experiment, inputs=-experiment.inputs)


@pytest.mark.parametrize(
    ("spoilt", "signal", "how"),
    [
        (lambda e: times(e, V, -1.0), "v", "Turn the sign of v"),
        (against, "u", "Turn the sign of u"),
        (lambda e: times(e, Y, 180.0 / np.pi), "y", "Give the unit of y"),
    ],
)
def test_what_is_to_be_mended_is_told_and_nothing_is_claimed(case, spoilt, signal, how):
    flat, experiment = case
    found = diagnose(flat, (), [spoilt(experiment)])
    assert found.verdict == "cannot tell" and not found.proofs
    assert found.message.startswith(f"The recording contradicts the model: {signal} ")
    assert how in found.next_experiment
    rounds = improve(flat, (), [spoilt(experiment)])
    assert len(rounds.steps) == 1 and rounds.reason == found.message
    assert rounds.last.next_experiment == found.next_experiment


def test_nothing_is_claimed_where_most_of_an_input_is_the_output(case):
    flat, experiment = case
    u = experiment.inputs.copy()
    u[100:, 0] = experiment.outputs[100:, Y]
    found = diagnose(flat, (), [replace(experiment, inputs=u)])
    assert found.verdict == "cannot tell" and not found.proofs
    assert "y is the same as the input u to the last digit" in found.message
    assert "empty" in found.next_experiment


@pytest.mark.parametrize("factor, is_told", [(-1.0, True), (1.0, False)])
def test_a_turned_sensor_beside_an_unknown_resonance_is_told_by_the_fits(case, factor, is_told):
    """Three times softer, the oscillator would move against a healthy sensor as well as against a turned one:
    that no value of a parameter tells, the fits of both do."""
    flat, experiment = case
    unknown = replace(flat, parameters=tuple(replace(p, estimate=True) for p in flat.parameters))
    spoilt = times(experiment, V, factor)
    assert not contradictions(unknown, spoilt), "nothing is certain without a fit"
    found = contradicted(unknown, [spoilt], (), None)
    assert (found is not None) == is_told
    assert found is None or "v moves against the model" in found.message


LINE = b"""model Line "Coil between two voltages"
  parameter Real L(unit = "H", min = 0) = 3e-3 annotation(__Daest(estimate = true));
  parameter Real R(unit = "Ohm", min = 0) = 0.3 annotation(__Daest(estimate = true));
  input Real u(unit = "V");
  input Real e(unit = "V");
  output Real i(unit = "A", start = 0);
  output Real p(unit = "V") "At a tap";
equation
  L*der(i) = u - e - R*i;
  p = 0.7*u + 0.3*e;
end Line;
"""


@pytest.fixture(scope="module")
def line():
    """Two voltages that nearly hold each other up."""
    flat, rng, time = compile_text(LINE, Path("Line.mo")), np.random.default_rng(5), 1e-4 * np.arange(1000)
    wave = np.sin(100 * np.pi * time)
    u = 150 * wave * np.repeat(1 + 0.1 * rng.normal(size=20), 50)
    e = 150 * wave + 6 * np.sin(500 * np.pi * time)
    experiment = Experiment("run", time, np.column_stack([u, e]), np.zeros((1000, 2)), ("u", "e"), ("i", "p"))
    made = simulate(flat, experiment, theta=np.array([2.1e-3, 0.5])).outputs
    return flat, replace(experiment, outputs=made + [0.2, 0.3] * rng.normal(size=(1000, 2)))


def test_one_of_several_inputs_that_acts_the_other_way_is_told(line):
    flat, experiment = line
    assert contradictions(flat, experiment) == []
    spoilt = replace(experiment, inputs=experiment.inputs * [1.0, -1.0])
    (one,) = contradictions(flat, spoilt)
    assert one.signal == "e" and one.is_turned and "acts against the model" in one.text
    assert np.array_equal(one.mended(spoilt).inputs, experiment.inputs)
    found = diagnose(flat, (), [spoilt])
    assert found.verdict == "cannot tell" and not found.proofs
    assert "Turn the sign of e" in found.next_experiment


VESSELS = b"""model Vessels "One runs into the other; each has an inflow, and heat is recorded in kW"
  parameter Real k1(unit = "1/s", min = 0) = 0.05 annotation(__Daest(estimate = true));
  parameter Real k2(unit = "1/s", min = 0) = 0.02 annotation(__Daest(estimate = true));
  input Real q1(unit = "kg/s");
  input Real q2(unit = "kg/s");
  input Real P(unit = "kW");
  output Real m1(unit = "kg", start = 0);
  output Real m2(unit = "kg", start = 0);
equation
  der(m1) = q1 - k1*m1 - 0.01*P;
  der(m2) = q2 + k1*m1 - k2*m2;
end Vessels;
"""


@pytest.fixture(scope="module")
def vessels():
    flat, rng, time = compile_text(VESSELS, Path("Vessels.mo")), np.random.default_rng(3), np.arange(600.0)
    inputs = np.repeat(rng.uniform(0.0, 1.0, (30, 3)), 20, axis=0)
    names = ("q1", "q2", "P"), ("m1", "m2")
    experiment = Experiment("run", time, inputs, np.zeros((600, 2)), *names)
    made = simulate(flat, experiment, theta=np.array([0.08, 0.03])).outputs
    return flat, replace(experiment, outputs=made + 0.1 * rng.normal(size=(600, 2)))


def test_pairs_are_of_signals_in_one_unit_that_change(vessels):
    flat, experiment = vessels
    assert [one.signals for one in exchanges(flat, [experiment])] == [("q1", "q2"), ("m1", "m2")]
    still = replace(experiment, inputs=experiment.inputs * [1.0, 0.0, 1.0])
    assert [one.signals for one in exchanges(flat, [still])] == [("m1", "m2")]
    moved = Exchange(("m1", "m2")).mended(experiment)
    assert np.array_equal(moved.outputs, experiment.outputs[:, ::-1]) and moved.inputs is experiment.inputs


@pytest.mark.parametrize("signals", [("q1", "q2"), ("m1", "m2")])
def test_two_columns_in_the_place_of_each_other_are_told(vessels, signals):
    flat, experiment = vessels
    spoilt = Exchange(signals).mended(experiment)
    found = diagnose(flat, (), [spoilt])
    assert found.verdict == "cannot tell" and not found.proofs
    assert f"{signals[0]} and {signals[1]} stand in each other's place" in found.message
    assert f"Exchange the columns of {signals[0]} and {signals[1]}" in found.next_experiment


def test_columns_in_two_units_in_the_place_of_each_other_are_told(case):
    """A way and a speed: their numbers are beside each other's, and tell by what they do alone."""
    flat, experiment = case
    assert exchanges(flat, [experiment]) == []
    spoilt = Exchange(("y", "v")).mended(experiment)
    assert exchanges(flat, [spoilt]) == [Exchange(("y", "v"), is_of_one_unit=False)]
    told = contradicted(flat, [spoilt], [spoilt], None)
    assert told is not None and "y and v stand in each other's place" in told.message


DRIVEN = b"""model Driven "What turns by an angle at a speed"
  parameter Real l(unit = "m", min = 0) = 2 annotation(__Daest(estimate = true));
  input Real a(unit = "rad");
  input Real v(unit = "m/s");
  output Real r(unit = "rad/s", start = 0);
  output Real s(unit = "m", start = 0);
equation
  der(r) = a*v/l - r/a*1e-3;
  der(s) = v;
end Driven;
"""


def test_pair_with_which_a_model_cannot_be_simulated_leaves_the_others():
    flat, time = compile_text(DRIVEN, Path("Driven.mo")), 0.1 * np.arange(300.0)
    inputs = np.column_stack([0.5 + 0.4 * np.sin(time), np.where(time < 5.0, 0.0, 3.0)])
    experiment = Experiment("run", time, inputs, np.zeros((300, 2)), ("a", "v"), ("r", "s"))
    made = simulate(flat, experiment).outputs
    spoilt = Exchange(("r", "s")).mended(replace(experiment, outputs=made))
    assert [one.signals for one in exchanges(flat, [spoilt])] == [("r", "s")]


def test_columns_stand_in_each_others_place_beside_a_third_that_is_followed_as_it_is():
    text = VESSELS.replace(
        b"equation",
        b"""  parameter Real k3(unit = "1/s", min = 0) = 0.2
    annotation(__Daest(estimate = true));
  output Real m3(unit = "kg", start = 0);
equation
  der(m3) = P - k3*m3;""",
    )
    flat, rng, time = compile_text(text, Path("Vessels.mo")), np.random.default_rng(4), np.arange(600.0)
    inputs = np.repeat(rng.uniform(0.0, 1.0, (30, 3)), 20, axis=0)
    names = ("q1", "q2", "P"), ("m1", "m2", "m3")
    experiment = Experiment("run", time, inputs, np.zeros((600, 3)), *names)
    made = simulate(flat, experiment, theta=np.array([0.08, 0.03, 0.25])).outputs
    spoilt = replace(experiment, outputs=made[:, [1, 0, 2]] + 0.1 * rng.normal(size=(600, 3)))
    told = contradicted(flat, [spoilt], [spoilt], None)
    assert told is not None and "m1 and m2 stand in each other's place" in told.message


def test_columns_are_not_in_each_others_place_where_something_else_is_wrong(vessels):
    flat, experiment = vessels
    assert contradicted(flat, [experiment], [experiment], None) is None
    drained = replace(experiment, outputs=np.minimum(experiment.outputs, [5.0, 60.0]))
    assert contradicted(flat, [drained], [drained], None) is None


@pytest.mark.parametrize(("gain", "is_told"), [(-2300.0, True), (-2500.0, False)])
def test_likelihoods_in_two_units_are_compared_per_unit(case, monkeypatch, gain, is_told):
    """A sensor in radians that is taken for degrees: 600 samples in degrees are less likely by 600 log(57)
    for that alone, which is no reason to leave it at radians."""
    flat, experiment = case
    name = experiment.output_names[V]
    one = Contradiction(name, 180.0 / np.pi, "is 57.3 times as small as in the model")
    assert 2300.0 < experiment.n_samples * np.log(180.0 / np.pi) < 2500.0

    def fit(log_likelihood, percent):
        simulated = {
            "estimation": SimpleNamespace(fit_percent=dict.fromkeys(experiment.output_names, percent))
        }
        return SimpleNamespace(log_likelihood=log_likelihood, simulated=simulated)

    fits = iter([fit(0.0, 40.0), fit(gain, 95.0)])
    monkeypatch.setattr(module, "contradictions", lambda *_: [one])
    monkeypatch.setattr(module, "identify", lambda *_, **__: next(fits))
    monkeypatch.setattr(module, "_told", lambda *_: "told")
    assert contradicted(flat, [experiment], [experiment], None) == ("told" if is_told else None)


def test_a_recording_that_contradicts_nothing_is_looked_into(case):
    flat, experiment = case
    assert contradictions(flat, experiment) == []
    assert contradicted(flat, [experiment], [experiment], None) is None


def test_what_the_mended_recording_does_not_show_is_no_contradiction(case):
    """Noise that moves against the model a little better than with it."""
    flat, experiment = case
    rng = np.random.default_rng(2)
    spoilt = times(experiment, V, -1.0)
    size = 1.2 * np.std(spoilt.outputs[:, V])
    spoilt = replace(spoilt, outputs=spoilt.outputs + np.outer(rng.normal(size=600), [0.0, size]))
    assert [one.signal for one in contradictions(flat, spoilt)] == ["v"]
    assert contradicted(flat, [spoilt], [spoilt], None) is None


FLASK = b"""model Flask "Acid into a flask whose surplus of acid at the start nobody knows"
  parameter Real c(unit = "mol/l", min = 0) = 0.005 annotation(__Daest(estimate = true));
  input Real q(unit = "1/s");
  Real x(unit = "mol/l", start = 0.003, fixed = false);
  output Real pH(unit = "1");
equation
  der(x) = q*(2*c - x);
  pH = -log10(x/2 + sqrt(x^2/4 + 1e-14));
end Flask;
"""


def test_a_start_on_the_other_side_is_none_with_any_of_the_parameter_values():
    """A feed of a tenth, into lye for acid: with the model's feed its curve bends the other way from both
    starts."""
    time, rate, feed = np.arange(681.0), 3.59 / 1700, 0.000535
    x = 2 * feed + (-0.0045 - 2 * feed) * np.exp(-rate * time)
    ph = -np.log10(x / 2 + np.sqrt(x**2 / 4 + 1e-14))
    acid = Experiment("acid", time, np.full((time.size, 1), rate), ph[:, None], ("q",), ("pH",))
    assert contradictions(compile_text(FLASK, Path("Flask.mo")), acid) == []


AERATION = b"""model Aeration "Air bubbles through water"
  parameter Real k(unit = "1/umol", min = 0) = 2e-5 annotation(__Daest(estimate = true, scale = "log"));
  input Real air(unit = "umol/s");
  output Real c(unit = "mg/l", start = 0, fixed = false);
equation
  der(c) = k*air*(8.9 - c);
end Aeration;
"""


def test_what_rises_with_the_model_is_not_turned_where_it_only_bends_otherwise():
    """Oxygen that sulfite takes up at first: it rises late, where the model rises at once."""
    time = np.arange(0.0, 305.0, 5.0)
    rises = 6.0 / (1 + np.exp(-(time - 250.0) / 60.0))
    air = np.full((time.size, 1), 200.0)
    experiment = Experiment("water", time, air, rises[:, None], ("air",), ("c",))
    assert contradictions(compile_text(AERATION, Path("Aeration.mo")), experiment) == []


WARMED = b"""model Warmed "Water that a motor warms"
  parameter Real G(unit = "W/K", min = 0) = 0.5 annotation(__Daest(estimate = true, scale = "log"));
  input Real T_motor(unit = "degC");
  output Real T(unit = "degC", start = 27, fixed = true);
equation
  3e5*der(T) = G*(T_motor - T);
end Warmed;
"""

MELTING = b"""model Melting "Ice that a flow of brine melts"
  parameter Real UA(unit = "W/K", min = 0) = 7000 annotation(__Daest(estimate = true, scale = "log"));
  input Real T_in(unit = "degC");
  output Real share(start = 0.95, fixed = true);
equation
  1e9*der(share) = -UA*T_in;
end Melting;
"""


@pytest.mark.parametrize(
    ("text", "driven", "measured"),
    [
        (WARMED, lambda s: 90.0 - s, lambda s: 27.0 + 0.4 * (1 - np.exp(-3 * s))),
        (MELTING, lambda s: 3.0 + s, lambda s: 0.95 - 0.8 * s + 0.15 * s * (s - 1)),
    ],
    ids=["another unit", "turned"],
)
def test_what_goes_along_with_the_model_and_bends_otherwise_contradicts_nothing(text, driven, measured):
    """A loss that the model lacks bends what is nearly a straight line in it, and so does a conductance that
    falls: what is left without the trend is many times as large, or turned, and is not the recording."""
    share = np.linspace(0.0, 1.0, 400)
    flat = compile_text(text, Path("Model.mo"))
    names = (flat.inputs[0].name,), (flat.outputs[0].name,)
    experiment = Experiment("run", 5000 * share, driven(share)[:, None], measured(share)[:, None], *names)
    assert contradictions(flat, experiment) == []


HOURS = """model Store
  parameter Real C(unit="kJ/K") = 250;
  parameter Real G(unit="kW/K", min=0) = 0.1 annotation(__Daest(estimate=true, scale="log"));
  input Real P(unit="kW");
  output Real T(unit="degC", start=20, fixed=true) annotation(__Daest(std=0.1));
equation
  C/3600*der(T) = P - G*(T - 20);
end Store;
"""


@pytest.mark.parametrize(("seconds", "unit"), [(3600.0, "h"), (86400.0, "d"), (1.0, "")])
def test_a_model_that_counts_time_in_hours_without_telling_it_is_told(seconds, unit):
    """A store of wax, read in seconds: its heat per kelvin was said to be 7532 and not 2.1 kJ/K."""
    flat = compile_text(HOURS.encode(), Path("Store.mo"))
    rng = np.random.default_rng(1)
    time, P = 0.02 * np.arange(400), np.repeat(rng.uniform(0.0, 9.0, 20), 20)[:, None]
    T = simulate(flat.with_theta({"G": 0.13}), (time, P), hold="zoh").outputs
    noisy = T + 0.1 * rng.standard_normal(T.shape)
    found = contradicted(flat, [Experiment("run", seconds * time, P, noisy, ("P",), ("T",))], [], None)
    assert (found is not None) == bool(unit)
    if found is not None:
        assert f"the model counts time in {unit}, and the recording was read in s" in found.message


TURNING = b"""model Turning
  input Real u(unit = "1");
  output Real n(unit = "rad") = phi;
  parameter Real k(unit = "N.m") = 1 annotation(__Daest(estimate = true));
  parameter Real J(unit = "kg.m2") = 0.01;
  parameter Real d(unit = "N.m.s/rad") = 0.2 annotation(__Daest(estimate = true));
  Real phi(unit = "rad", start = 0);
  Real w(unit = "rad/s", start = 0);
equation
  der(phi) = w;
  J*der(w) = k*u - d*w;
end Turning;
"""


@pytest.mark.parametrize(("duty", "is_told"), [(np.abs, True), (np.positive, False)])
def test_of_a_duty_without_its_sign_nothing_is_claimed(duty, is_told):
    """A winch whose controller writes the size of its duty, and the direction to a pin of its own."""
    flat = compile_text(TURNING, Path("Turning.mo"))
    time, way = 0.02 * np.arange(400), np.where(np.arange(400) // 100 % 2, -1.0, 1.0)
    u = (way * (np.arange(400) % 100 < 60))[:, None]
    n = simulate(flat, (time, u), hold="zoh").outputs + 1e-3 * np.random.default_rng(1).normal(size=(400, 1))
    found = contradicted(flat, [Experiment("run", time, duty(u), n, ("u",), ("n",))], [], None)
    assert (found is not None) == is_told
    assert found is None or (found.verdict == "cannot tell" and "without its sign" in found.message)
