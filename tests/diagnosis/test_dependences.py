"""Parameters that change with a variable of the model: a vessel that narrows as its pressure rises."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from hidden_plants import library, model
from scipy.integrate import solve_ivp
from test_proof import proved

from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.evidence.reasons import may_be_a_bend
from daest.diagnosis.evidence.stand import begin, halved
from daest.diagnosis.null_model.null_observer import run_null
from daest.diagnosis.options import DiagnoseOptions
from daest.diagnosis.refits.dependences import (
    _combined,
    dependence_screen,
    dependences,
    refused_where_errors_last,
)
from daest.model.effects import Site
from daest.model.experiment import Experiment
from daest.modelica.change import declare
from daest.modelica.compile import compile_model
from daest.modelica.effects.attach import attach
from daest.modelica.places.sites import changeable

PERIOD, N, NOISE, MIDDLE = 0.05, 800, 0.5, 90.0


@cache
def record(share, load=0.0):
    """Pressures while the resistance of the arteries grows by the `share` of it with their pressure, or with
    a flow besides that wanders with the standard deviation `load`."""
    rng = np.random.default_rng(8)
    time = PERIOD * np.arange(N)
    flow = np.maximum(0.0, np.sin(7.0 * time)) * np.repeat(rng.choice([120.0, 220.0, 350.0, 450.0], 20), 40)
    leak = np.zeros(N)
    for k in range(1, N):
        leak[k] = 0.97 * leak[k - 1] + 0.24 * load * rng.standard_normal()
    p = [np.array([80.0, 80.0])]
    for k in range(N - 1):

        def rates(_, x, k=k):
            between = (x[0] - x[1]) / 0.11
            out = x[1] / (0.95 * (1.0 + share * (x[1] - MIDDLE)))
            return [(flow[k] - between) / 1.1, (between - out + leak[k]) / 1.7]

        p.append(solve_ivp(rates, (0.0, PERIOD), p[-1], rtol=1e-8).y[:, -1])
    measured = np.array(p) + NOISE * rng.standard_normal((N, 2))
    return Experiment("record", time, flow[:, None], measured, ("q",), ("aorta", "arteries"))


def stand_of(share, load=0.0):
    return begin(model("Artery"), *halved((record(share, load),), ()), DiagnoseOptions(hold="zoh"))


def test_every_parameter_is_tried_beside_every_variable_from_the_middle_of_this():
    stand = stand_of(0.006)
    found = dependences(stand.null, run_null(stand.null), stand.declared, library())
    effects = ("DriftingParameter", *(f"DependentParameter ({x})" for x in ("p1", "p2", "q")))
    assert {c.label for c in found} == {f"{e} at {p}" for e in effects for p in ("C1", "C2", "R1", "R2")}
    p2 = np.mean(record(0.006).outputs[: N // 2, 1])
    (middle,) = {c.shape["z_0"] for c in found if c.inputs.get("z") == "p2"}
    assert middle == pytest.approx(p2, abs=2.0)


def screened(stand):
    run = run_null(stand.null)
    return dependence_screen(stand.null, run, dependences(stand.null, run, stand.declared, library()), seed=0)


@pytest.mark.slow
def test_the_dependence_that_is_there_leads_the_screen_and_none_does_beside_a_load():
    found = screened(stand_of(0.006))
    assert found.entries[0].candidate.label == "DependentParameter (p2) at R2"
    assert found.p_value < 1e-6
    assert screened(stand_of(0.0, 30.0)).p_value > 0.05


@pytest.mark.slow
def test_a_dependence_is_named_where_no_law_of_the_library_leaves_as_little():
    found = diagnose(model("Artery"), library(), (record(0.006),), options=DiagnoseOptions(hold="zoh"))
    (proof,) = [p for p in found.proofs if p.verdict == "supported"]
    assert proof.candidate.label == "DependentParameter (p2) at R2"
    (rate,) = [p for p in proof.told.parameters if p.name.endswith(".r")]
    at_middle = 0.006 / (1.0 + 0.006 * (proof.candidate.shape["z_0"] - MIDDLE))
    assert rate.value == pytest.approx(at_middle, abs=4.0 * rate.std_error)


@pytest.mark.parametrize(("lasts", "is_kept"), [(True, False), (False, True)])
def test_a_dependence_that_leaves_errors_that_last_comes_near_alone(monkeypatch, lasts, is_kept):
    """Beside friction and a lag that are seen only together, a stiffness that goes with the speed."""
    monkeypatch.setattr("daest.diagnosis.refits.dependences.errors_last", lambda proof: lasts)
    _, friction = proved()
    changing = replace(friction, candidate=replace(friction.candidate, site=Site("J", "parameter", "signal")))
    kept, other = refused_where_errors_last([changing, friction])
    assert (kept.verdict == "supported") is is_kept and other is friction


def test_constants_of_nature_do_not_change(tmp_path):
    (tmp_path / "Fall.mo").write_text("""model Fall
  parameter Real g(unit = "m/s2") = 9.80665; parameter Real g_moon(unit = "m/s2") = 1.62;
  parameter Real sigma(unit = "W/(m2.K4)") = 5.67e-8; parameter Real R(unit = "kJ/(kmol.K)") = 8.314;
  parameter Real k(unit = "1/s") = 9.81; parameter Real a(unit = "m/s2") = 9.81;
  input Real u(unit = "m/s2"); output Real v(unit = "m/s", start = 0);
equation
  der(v) = g - g_moon - k*v + u + a*(sigma/5.67e-8 - R/8.314);
end Fall;
""")
    flat = declare(compile_model(tmp_path / "Fall.mo"), estimate=("a",))
    assert {site.name for site in changeable(flat)} == {"g_moon", "k", "a"}


def test_an_output_of_several_variables_is_one_that_parameters_may_change_with(tmp_path):
    """The stroke of a spring between two heights; not a height in mm, nor a sensor that was put in."""
    (tmp_path / "Strut.mo").write_text("""model Strut
  parameter Real c(unit = "N/m") = 100; parameter Real m(unit = "kg") = 1;
  input Real road(unit = "m"); output Real stroke(unit = "mm"); output Real height(unit = "mm");
  Real z(unit = "m", start = 0); Real v(unit = "m/s", start = 0);
equation
  der(z) = v; m*der(v) = c*(road - z); stroke = 1000*(road - z); height = 1000*z;
end Strut;
""")
    flat = compile_model(tmp_path / "Strut.mo")
    assert _combined(SimpleNamespace(flat=flat)) == ["stroke"]
    (offset,) = (effect for effect in library() if effect.name == "Offset")
    with_sensor = attach(flat, offset, Site("stroke", "output", "signal"))
    assert _combined(SimpleNamespace(flat=with_sensor)) == []


@pytest.mark.parametrize(
    ("name", "rms", "may_be"),
    [("EndStop", 2.0, True), ("EndStop", 1.05, False), ("CoulombFriction", 2.0, False)],
)
def test_a_stop_that_leaves_errors_that_last_may_be_a_smooth_bend(name, rms, may_be):
    effect = next(one for one in library() if one.class_name == f"Daest.Effects.Translational.{name}")
    told = SimpleNamespace(simulated={"validation": SimpleNamespace(rms={"y": rms}, white={"y": 1.0})})
    assert may_be_a_bend(SimpleNamespace(candidate=SimpleNamespace(effect=effect), told=told)) is may_be
