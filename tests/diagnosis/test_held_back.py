"""Dry friction of an axis whose speed comes late: each shows only beside the other. Simulated by LSODA."""

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from daest.diagnosis import diagnose as diagnosing
from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.hypotheses import together
from daest.diagnosis.improve import improve
from daest.diagnosis.options import DiagnoseOptions
from daest.diagnosis.refits import held_back as holding_back
from daest.diagnosis.refits.held_back import lags_in_the_way, laws_in_the_way
from daest.model.experiment import Experiment
from daest.model.fit import Agreement, FittedNoise, FittedParameter
from daest.modelica.compile import compile_text
from daest.modelica.effects.catalogue import effect_library

AXIS = """model Axis "An axis on a linear motor"
  parameter Real m(unit = "kg", min = 0) = 10 annotation(__Daest(estimate = true));
  parameter Real d(unit = "N.s/m", min = 0) = 20 annotation(__Daest(estimate = true));
  input Real F(unit = "N");
  output Real s(unit = "m", start = 0);
  output Real v(unit = "m/s", start = 0);
equation
  der(s) = v;
  m*der(v) = F - d*v;
end Axis;
"""
PERIOD, N, LATE, DRY = 0.004, 2400, 0.006, 8.0
EFFECTS = ("CoulombFriction", "Lag", "ConstantLoad", "QuadraticDrag")


@cache
def recorded(dry, n=N):
    rng = np.random.default_rng(42)
    time = PERIOD * np.arange(n)
    waves, phases = 2 * np.pi * np.linspace(0.2, 10.0, 25), rng.uniform(0, 2 * np.pi, 25)

    def force(t):
        return 17.0 * np.sin(np.multiply.outer(t, waves) + phases).sum(-1)

    def rates(t, x):
        return [x[1], (force(t) - 35.0 * x[1] - dry * np.tanh(x[1] / 1e-3)) / 12.0, (x[1] - x[2]) / LATE]

    x = solve_ivp(rates, (0, time[-1]), np.zeros(3), "LSODA", time, rtol=1e-8, atol=1e-10, max_step=PERIOD).y
    y = x[[0, 2]].T + rng.normal(0.0, [2e-5, 1e-3], (n, 2))
    return Experiment("run", time, force(time)[:, None], y, ("F",), ("s", "v"))


def axis():
    return compile_text(AXIS.encode(), Path("Axis.mo"))


def sizes(proofs):
    found = {}
    for proof in proofs:
        for size in proof.candidate.effect.sizes:
            value = next(p for p in proof.told.parameters if p.name == f"{proof.candidate.name}.{size.name}")
            found[proof.candidate.effect.name] = value
    return found


@pytest.mark.slow
def test_friction_behind_a_lag_is_found_beside_it():
    found = diagnose(axis(), effect_library(), [recorded(DRY)], options=DiagnoseOptions(effects=EFFECTS))
    accepted = [p for p in found.proofs if p.verdict == "supported"]
    assert found.verdict == "supported"
    assert [p.candidate.label for p in accepted] == ["CoulombFriction at 1:v", "Lag at v"]
    own = sizes(accepted)
    friction, lag = own["CoulombFriction"], own["Lag"]
    assert abs(friction.value - DRY) < 4 * friction.std_error < 0.5
    assert abs(lag.value - LATE) < 4 * lag.std_error + 2e-5
    assert "is missing besides: each of both shows only beside the other" in found.message


@pytest.mark.slow
def test_improve_adds_both():
    found = improve(axis(), effect_library(), [recorded(DRY)], options=DiagnoseOptions(effects=EFFECTS))
    added = [step.proof.candidate.effect.class_name for step in found.steps if step.proof is not None]
    assert [name.rpartition(".")[2] for name in added] == ["Lag", "CoulombFriction"]
    assert found.steps[1].remark == "only together with what follows"


@pytest.mark.slow
def test_a_lag_alone_is_told_as_one():
    options = DiagnoseOptions(effects=("CoulombFriction", "Lag"))
    found = diagnose(axis(), effect_library(), [recorded(0.0, 1200)], options=options)
    assert all(p.verdict == "rejected" for p in found.proofs)
    assert "Something dynamic is missing, and it is fast: Lag at v" in found.message


FURNACE = """model Furnace "A heated body that loses heat through its wall"
  parameter Real C(unit = "J/K", min = 0) = 4000 annotation(__Daest(estimate = true));
  parameter Real G(unit = "W/K", min = 0) = 2 annotation(__Daest(estimate = true));
  input Real P(unit = "W");
  output Real T(unit = "degC");
  Daest.Thermal.HeatTransfer.Components.HeatCapacitor body(C = C);
  Daest.Thermal.HeatTransfer.Components.ThermalConductor wall(G = G);
  Daest.Thermal.HeatTransfer.Sources.PrescribedHeatFlow heater;
  Daest.Thermal.HeatTransfer.Celsius.FixedTemperature hall(T = 22);
  Daest.Thermal.HeatTransfer.Celsius.TemperatureSensor thermocouple;
equation
  heater.Q_flow = P;
  connect(heater.port, body.port);
  connect(body.port, wall.port_a);
  connect(wall.port_b, hall.port);
  connect(thermocouple.port, body.port);
  T = thermocouple.T;
end Furnace;
"""


@pytest.mark.slow  # what is looked for beside a lag: the tests above and below
def test_radiation_is_found_behind_a_slow_thermocouple():
    """The lag alone foresees unseen data worse, so that what it leaves is not even looked at."""
    area, late, period, n = 0.03, 25.0, 10.0, 900
    rng = np.random.default_rng(8)
    power, x, y = np.repeat(rng.uniform(0.0, 2600.0, n // 60), 60), np.array([22.0, 22.0]), np.empty(n)
    for k in range(n):
        y[k] = x[1] + 0.5 * rng.standard_normal()
        for _ in range(10):
            lost = 1.5 * (x[0] - 22.0) + area * 5.670374e-8 * ((x[0] + 273.15) ** 4 - 295.15**4)
            x = x + period / 10 * np.array([(power[k] - lost) / 4500.0, (x[0] - x[1]) / late])
    record = Experiment("run", period * np.arange(n), power[:, None], y[:, None], ("P",), ("T",))
    options = DiagnoseOptions(effects=("Lag", "Radiation", "ConstantHeatGain"), hold="zoh")
    found = diagnose(
        compile_text(FURNACE.encode(), Path("Furnace.mo")), effect_library(), [record], options=options
    )
    accepted = [p for p in found.proofs if p.verdict == "supported"]
    assert [p.candidate.effect.name for p in accepted] == ["Radiation", "Lag"]
    own = sizes(accepted)
    assert own["Radiation"].value == pytest.approx(area, rel=0.01)
    assert own["Lag"].value == pytest.approx(late, rel=0.05)


@pytest.mark.parametrize("error, is_looked_beside", [(0.06, False), (1.4, True)])
def test_lag_is_looked_beside_where_it_leaves_errors_far_above_the_noise(error, is_looked_beside):
    lag = SimpleNamespace(
        verdict="rejected",
        candidate=SimpleNamespace(
            label="Lag at T",
            is_dynamic=True,
            is_of_signal=True,
            effect=SimpleNamespace(n_states=1),
            is_of_parameter=False,
        ),
        delta_bic=400.0,
        left=SimpleNamespace(p_value=0.5, log_likelihood_gain=1.0),
        fit=SimpleNamespace(noises=[FittedNoise("T", "measurement", 0.05, None, "degC", True, None)]),
        told=SimpleNamespace(simulated={"validation": Agreement({"T": None}, {"T": error})}),
    )
    assert lags_in_the_way(SimpleNamespace(proofs=(lag,))) == ([lag] if is_looked_beside else [])
    # One of another signal that is less likely has held nothing back where this one leaves nothing.
    far = SimpleNamespace(simulated={"validation": Agreement({"T": None}, {"T": 1.4})})
    less = SimpleNamespace(**{**vars(lag), "delta_bic": 50.0, "told": far})
    assert (less in lags_in_the_way(SimpleNamespace(proofs=(lag, less)))) == is_looked_beside
    # A law that explains far less than the lag does not stand in its way; any other that is accepted does.
    law = SimpleNamespace(
        verdict="not separable",
        candidate=SimpleNamespace(
            is_dynamic=False, is_of_signal=False, is_of_parameter=False, effect=SimpleNamespace(n_states=0)
        ),
        delta_bic=150.0,
        is_by_use=False,
        is_known=True,
        told=lag.told,
        not_separable_from=("Lag at T",),
    )
    found = SimpleNamespace(proofs=(law, lag), baseline=lag.told)
    assert (lag in lags_in_the_way(found)) == is_looked_beside
    law.not_separable_from = ("Lag at P",)
    assert lags_in_the_way(found) == []
    # A likelier one that is refused does so, but for one with states of which the data show too little.
    law.verdict, law.delta_bic = "rejected", 500.0
    assert lags_in_the_way(found) == []
    law.is_known = False
    assert lags_in_the_way(found) == []
    law.candidate.effect.n_states = 1
    assert (lag in lags_in_the_way(found)) == is_looked_beside


@dataclass(frozen=True)
class Second:
    proofs: tuple
    message: str


@dataclass(frozen=True)
class Told:
    """A proof, as far as a diagnosis beside a lag looks at it."""

    candidate: SimpleNamespace
    told: SimpleNamespace
    fit: SimpleNamespace  # beside loads
    verdict: str = "supported"
    final: object = None


@pytest.mark.parametrize(
    ("time", "std", "error", "adds_up", "is_told"),
    [
        (0.02, 0.001, 0.5, False, True),
        (0.0002, 0.001, 0.5, False, False),  # nothing is left of the lag
        (0.02, None, 0.5, False, False),
        (0.02, 0.001, 1.1, False, False),  # unseen data are simulated worse than without both
        (0.02, 0.001, 1.1, True, True),
    ],
)
def test_lag_and_law_are_told_where_both_are_there_and_matter(time, std, error, adds_up, is_told):
    def simulated(value, *parameters):
        unseen = Agreement({"y": None}, {"y": value})
        return SimpleNamespace(simulated={"validation": unseen}, parameters=parameters)

    size = FittedParameter("lag_1.T", time, std, time, "s", None, None, None)
    effect = SimpleNamespace(sizes=[SimpleNamespace(name="T")], parameters=())
    alone, beside = simulated(1.0, size), simulated(error, size)
    lag = Told(SimpleNamespace(name="lag_1", effect=effect, label="Lag at y", estimated=()), alone, alone)
    law = Told(SimpleNamespace(name="law_1", label="Friction at y"), beside, beside)
    stand = SimpleNamespace(told=simulated(1.0), reference=SimpleNamespace(adds_up=adds_up))
    second = Second((law,), "What is said.")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(holding_back, "told_values", lambda _: "T = 0.02 s")
        found = holding_back.with_both(second, lag, stand, Second((), ""))
        # A law that stands without the lag leaves more errors, or no more, by itself.
        far = Told(SimpleNamespace(name="law_2", label="Drag at y"), simulated(2.0 * error), simulated(1.0))
        near = replace(far, told=simulated(1.2 * error))
        kept = [holding_back.with_both(second, lag, stand, Second((one,), "")) for one in (far, near)]
        again = replace(far, candidate=law.candidate)  # the law was accepted without the lag, too
        known = holding_back.with_both(second, lag, stand, Second((again,), ""))
    assert (found is not None) == is_told
    assert [one is not None for one in kept] == [is_told, False]
    assert found is None or [p.candidate.name for p in found.proofs] == ["law_1", "lag_1"]
    assert found is None or "each of both shows only beside the other" in found.message
    assert known is None or "it shows only beside the other" in known.message


@pytest.mark.parametrize(("upper", "lower", "is_told"), [(0.3, -0.3, True), (-13.2, 12.7, False)])
def test_stops_that_leave_no_room_beside_another_law_are_not_told(upper, lower, is_told):
    size = FittedParameter("stop.c", 1.0, 0.01, 1.0, "N.m/rad", None, None, None)
    theta = {"stop.phi_max": upper, "stop.phi_min": lower}
    unseen = {"validation": Agreement({"y": None}, {"y": 0.5})}
    both = SimpleNamespace(simulated=unseen, parameters=(size,), theta=theta)
    stops = next(e for e in effect_library() if e.name == "EndStop")
    stop = Told(SimpleNamespace(name="stop", effect=stops, label="EndStop at w", estimated=()), both, both)
    law = Told(SimpleNamespace(name="law_1", label="Torque at w"), both, both)
    before = SimpleNamespace(simulated={"validation": Agreement({"y": None}, {"y": 1.0})}, parameters=())
    stand = SimpleNamespace(told=before, reference=SimpleNamespace(adds_up=False))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(holding_back, "told_values", lambda _: "c = 1 N.m/rad")
        found = holding_back.with_both(Second((law,), ""), stop, stand, Second((), ""))
    assert (found is not None) is is_told


@pytest.mark.parametrize(
    ("simulated", "std", "foreseen", "is_gone"),
    [
        (0.42, 0.15, 0.416, False),  # told roughly, and what predictions tell
        (0.42, 0.15, 0.70, True),
        (0.05, 0.15, 0.10, True),  # within its error of nothing
    ],
)
def test_short_lag_that_a_simulation_tells_roughly_is_not_gone(simulated, std, foreseen, is_gone):
    """A drum on which a wheel rolls out for minutes: that its speed is the mean over the last turn is seen in
    the predictions, and hardly in the whole of the run."""
    lag = SimpleNamespace(
        candidate=SimpleNamespace(name="lag_1", effect=SimpleNamespace(sizes=[SimpleNamespace(name="T")]))
    )
    told, beside = (
        SimpleNamespace(parameters=[FittedParameter("lag_1.T", value, error, value, "s", None, None, None)])
        for value, error in ((simulated, std), (foreseen, 0.01))
    )
    assert holding_back._is_gone(lag, SimpleNamespace(told=told, fit=beside)) == is_gone


def test_no_second_lag_beside_one_that_has_let_no_law_in(monkeypatch):
    """Two unproven lags, which trade with each other, would let almost any law in."""
    tried = []
    monkeypatch.setattr(together, "lags_in_the_way", lambda found: ["lag of the input", "lag of the output"])
    monkeypatch.setattr(together, "with_unproven", lambda task, path, found, lag, _: tried.append(lag) or [])
    task = SimpleNamespace(options=DiagnoseOptions(), first=(), most_effects=5)
    for is_unproven, expected in ((False, ["lag of the input"]), (True, [])):
        path = SimpleNamespace(steps=(SimpleNamespace(is_unproven=is_unproven),))
        assert together.beside_another(task, path, None, None) == []
        assert tried == expected
        tried.clear()


def test_a_lag_is_looked_beside_with_the_inputs_held_otherwise_too(monkeypatch):
    """As improve does: the radiation of an oven behind a late heater had been found by that alone."""
    stand = SimpleNamespace(null=SimpleNamespace(fit=None, other_hold="zoh", other_fit="known"))
    nothing, both = (
        SimpleNamespace(proofs=proofs, is_of_starts=False, told=told)
        for proofs, told in (((), "nothing"), (("lag", "radiation"), "both"))
    )
    begun: list[object] = []

    def begin(*of):
        begun.append(of[3].tried)
        assert of[3].known == (None if of[3].tried is None else "known"), "its fit is not made again"
        return stand

    def examine(*_, wants_law=False):
        assert wants_law is (begun == [None, "zoh"]), "without a law the second one is of no use"
        return nothing

    def beside_another(*_):
        return both if begun == [None, "zoh"] else None

    for name, made in {
        "begin": begin,
        "limited": lambda one, *_: (one, ()),
        "examine": examine,
        "_beside_another": beside_another,
        "led_elsewhere": lambda *_: None,
        "known_values": lambda _: {},
        "unsettled_hold": lambda *_: "zoh",
        "says_more": lambda proofs, *_: bool(proofs),
        "told_whole": lambda found, *_: found,
        "Holds": lambda *_: SimpleNamespace(better=lambda _: None, watched=None),
    }.items():
        monkeypatch.setattr(diagnosing, name, made)
    found = diagnosing._from_inside(None, (), (), (), DiagnoseOptions(), lambda _: None)
    assert found.told == "both" and begun == [None, "zoh"]


LINE = """model Line "Pump, pipe and vessel under air"
  parameter Real L(unit="kg/m4") = 3.2e8 "Inertia of the water in the pipe";
  parameter Real R(unit="Pa.s/m3", min=0) = 4e7 "Pipe" annotation(__Daest(estimate = true));
  parameter Real C(unit="m3/Pa", min=0) = 3e-7 "Vessel" annotation(__Daest(estimate = true));
  input Real pp(unit="Pa") "Behind the pump";
  input Real qd(unit="m3/s") "Demand";
  output Real q(unit="m3/s");
  output Real p(unit="Pa", start=2.5e5);
equation
  L*der(q) = pp - p - R*q;
  C*der(p) = q - qd;
end Line;
"""


@cache
def line_recorded():
    """A pipe whose resistance grows with the square of its flow, and a constant flow that is drawn."""
    rng, period, n = np.random.default_rng(8), 0.2, 4000
    pump = np.repeat(rng.uniform(1.5e5, 4e5, n // 100), 100)
    drawn = np.repeat(rng.choice([0.0, 5e-4, 1e-3, 1.5e-3], n // 80), 80)
    x, y = np.array([1e-3, 2.5e5]), np.empty((n, 2))

    def rates(t, x, u):
        q, p = x
        return [(u[0] - p - 2e7 * q - 5e10 * q * abs(q)) / 3.2e8, (q - u[1] - 4e-4) / 3e-7]

    for k in range(n):
        y[k] = x + rng.normal(0.0, [1e-5, 1e3])
        span = (0, period)
        x = solve_ivp(rates, span, x, "LSODA", args=((pump[k], drawn[k]),), rtol=1e-8, atol=[1e-9, 1e-2]).y[
            :, -1
        ]
    u = np.column_stack([pump, drawn])
    return Experiment("run", period * np.arange(n), u, y, ("pp", "qd"), ("q", "p"))


@pytest.mark.slow  # which law is looked beside, and what is asked of it: the tests below
@pytest.mark.parametrize("find", [diagnose, improve])
def test_law_whose_size_another_one_spoils_is_found_beside_it(find):
    """The constant is simulated by any size of the square, which alone is of no certain size; an offset of
    the flow, which is less likely by far, had been told in their place."""
    effects = ("Orifice", "ConstantFlow", "Offset", "Gain")
    flat = compile_text(LINE.encode(), Path("Line.mo"))
    found = find(
        flat, effect_library(), [line_recorded()], options=DiagnoseOptions(effects=effects, hold="zoh")
    )
    if find is improve:
        own = sizes([step.proof for step in found.steps[1:]])
    else:
        own = sizes([p for p in found.proofs if p.verdict == "supported"])
    assert set(own) == {"Orifice", "ConstantFlow"}
    assert own["ConstantFlow"].value == pytest.approx(-4e-4, rel=0.01)
    if find is diagnose:
        assert own["Orifice"].value == pytest.approx(5e10, rel=0.02)


@pytest.mark.parametrize(
    ("changed", "is_looked_beside"),
    [
        ({}, True),
        ({"is_vague": False}, False),  # something speaks against it
        ({"is_vague": False, "is_open": True}, True),
        ({"delta_bic": 150.0}, False),  # no likelier than what is accepted
        ({"explained": 0.3}, False),
        ({"std": 3.0}, False),  # of no certain size beside loads, either
        ({"left": 0.06}, False),  # what is accepted leaves nothing
    ],
)
def test_law_is_looked_beside_where_it_is_far_likelier_than_what_is_accepted(changed, is_looked_beside):
    what = {"is_vague": True, "is_open": False, "delta_bic": 800.0, "explained": 0.9, "std": 0.1, "left": 1.4}
    what |= changed
    size = FittedParameter("law.k", 5.0, what["std"], 5.0, "1", None, None, None)
    noise = FittedNoise("p", "measurement", 0.05, None, "Pa", True, None)
    law = SimpleNamespace(
        verdict="rejected",
        candidate=SimpleNamespace(
            name="law",
            is_dynamic=False,
            is_of_parameter=False,
            effect=SimpleNamespace(sizes=[SimpleNamespace(name="k")]),
        ),
        is_vague=what["is_vague"],
        is_open=what["is_open"],
        is_by_use=False,
        delta_bic=what["delta_bic"],
        explained=what["explained"],
        fit=SimpleNamespace(parameters=[size], noises=[noise]),
    )
    accepted = SimpleNamespace(
        verdict="supported",
        candidate=law.candidate,
        delta_bic=180.0,
        fit=law.fit,
        told=SimpleNamespace(simulated={"validation": Agreement({"p": None}, {"p": what["left"]})}),
    )
    found = SimpleNamespace(proofs=(accepted, law))
    assert laws_in_the_way(found) == ([law] if is_looked_beside else [])


@pytest.mark.parametrize(
    ("alone", "verdict", "is_needed"),
    [
        (0.5, "supported", True),
        (0.6, "rejected", True),  # unseen data are simulated worse without the lag
        (0.5, "rejected", False),  # of a pendulum above magnets that swings out
    ],
)
def test_a_lag_beside_which_a_law_was_found_is_asked_for_beside_that(monkeypatch, alone, verdict, is_needed):
    def fit(error):
        return SimpleNamespace(simulated={"validation": Agreement({"y": None}, {"y": error})}, theta={})

    names = {"lag": SimpleNamespace(label="Lag at y"), "law": SimpleNamespace(label="Torque at w")}
    lag, law = (Told(names[name], fit(0.5), fit(0.5), "rejected") for name in ("lag", "law"))
    proved = {"Lag at y": replace(lag, verdict=verdict), "Torque at w": replace(law, told=fit(alone))}
    monkeypatch.setattr(holding_back, "proved_again", lambda _, proof, __: proved[proof.candidate.label])
    monkeypatch.setattr(holding_back, "accept", lambda *_: None)
    assert holding_back.is_needed_beside(None, lag, law, DiagnoseOptions()) is is_needed


def test_what_is_said_of_a_lag_that_nothing_proves():
    law, lag, other = (
        Told(SimpleNamespace(label=label), None, None) for label in ("Torque", "Lag at y", "Play")
    )
    lag, other = (replace(one, verdict="rejected") for one in (lag, other))
    both = (law, replace(lag, verdict="supported"), other)
    said = "Torque; supported. Lag at y (T = 1 s) is missing besides: each shows only beside the other."
    found = holding_back.without(Second(both, said), Refused(**vars(lag)))
    assert [(p.candidate.label, p.verdict) for p in found.proofs] == [
        ("Torque", "supported"),
        ("Lag at y", "rejected"),
        ("Play", "rejected"),
    ]
    assert found.message.startswith("Torque; supported. With Lag at y in the model besides")


@dataclass(frozen=True)
class Refused(Told):
    """A proof that tells why it was refused."""

    reason: str = ""
