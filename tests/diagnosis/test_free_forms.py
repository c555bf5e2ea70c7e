"""Loads as curves over model variables: the right variable, the true curve, and no relation where none is."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hidden_plants import PERIOD, model, quiet, rotor_null, rotor_record, some_effects
from scipy.stats import kstest

from daest.diagnosis.evidence.stand import without_noises
from daest.diagnosis.null_model.null import fit_null
from daest.diagnosis.null_model.null_observer import run_null
from daest.diagnosis.screening.candidates import pairs
from daest.diagnosis.screening.free_forms import _basis, forms_of, free_forms, internal_variables, keep_forms
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_model
from daest.modelica.effects.attach import attach
from daest.modelica.places.sites import sites


@cache
def pushed(seed=11):
    record, truth = rotor_record(1000, seed=seed, load=(0.2, 1.0), noise=0.0)
    return *rotor_null(record), truth


@cache
def bumpy():
    """Friction that depends on the angle, which no effect describes."""
    record, truth = rotor_record(1000, seed=12, coulomb=lambda phi: 0.2 * (1.0 + 0.8 * np.sin(phi)))
    return *rotor_null(record), truth


def test_external_load_and_quiet_record_follow_nothing():
    for null, run in (pushed()[:2], quiet()):
        assert free_forms(null, run)[0].p_value > 1e-3


def test_observer_whose_errors_grow_without_end_tells_nothing(monkeypatch):
    """A bent signal may leave one gain that holds nowhere: what a load does grows beyond all numbers."""
    null, run, _ = pushed()
    monkeypatch.setattr(
        type(run.dynamics[0]),
        "errors_along",
        lambda _, courses, entry: np.full((len(courses), 1000, 1), np.inf),
    )
    with np.errstate(invalid="ignore"):
        assert free_forms(null, run) == ()


@pytest.mark.slow
def test_p_values_are_uniform_or_larger_when_nothing_is_related():
    """Of one form over many records, so that they are independent."""
    found = []
    for seed in range(20, 32):
        null, run, _ = pushed(seed)
        forms = free_forms(null, run)
        form = next(f for f in forms if f.label == "u")
        found.append(min(1.0, form.p_value / len(forms)) if form.p_value < 1.0 else 1.0)
    assert kstest(found, "uniform", alternative="greater").pvalue > 1e-3


@pytest.mark.parametrize("scale", [0.2, 3.0])
def test_load_in_proportion_to_an_input_is_no_relation(scale):
    """All torques but that of the input are too small, or too large: parameters and load may mend that."""
    null, _, _ = pushed()
    values = {p.name: scale * p.value for p in null.fit.parameters if p.name in ("J", "d")}
    moved = tuple(replace(p, value=values.get(p.name, p.value)) for p in null.fit.parameters)
    off = replace(null, flat=null.flat.with_theta(values), fit=replace(null.fit, parameters=moved))
    assert next(f for f in free_forms(off, run_null(off)) if f.label == "u").p_value == 1.0


def test_friction_that_depends_on_the_angle_is_found_with_its_curve():
    null, run, truth = bumpy()
    form = free_forms(null, run)[0]
    assert (form.variable, form.sign_of) == ("rotor.phi", "rotor.w")
    assert form.p_value < 1e-6
    assert (form.place, form.unit, form.variable_unit) == ("rotor.flange_a", "N.m", "rad")
    values = {p.name: p.value for p in null.fit.parameters}
    phi, w = truth["phi"], truth["w"]
    # Refitted parameters have taken their part of the friction.
    left = -0.2 * (1 + 0.8 * np.sin(phi)) * np.tanh(w / 0.02)
    left += (values["d"] - 0.3) * w + (values["J"] - 0.5) * np.gradient(w, PERIOD)
    true = harmonics(form.x) @ np.linalg.lstsq(harmonics(phi) * np.sign(w)[:, None], left, rcond=None)[0]
    assert np.mean(np.abs(form.w - true) < 3.0 * form.std) >= 0.85
    assert np.corrcoef(form.w, true)[0, 1] > 0.8


def harmonics(x):
    return np.column_stack([np.ones_like(x), *(f(k * x) for k in (1, 2, 3) for f in (np.cos, np.sin))])


def test_search_can_be_restricted():
    null, run, _ = bumpy()
    assert {f.label for f in free_forms(null, run, ["u", "rotor.w"])} == {
        "u",
        "rotor.w",
        "u and the sign of rotor.w",
    }


def test_forms_that_are_kept_are_those_of_their_null_alone():
    null, run, _ = bumpy()
    kept = free_forms(null, run)[:1]
    keep_forms(null, kept)
    assert forms_of(null, run) is kept
    assert len(forms_of(replace(null), run)) > 1


@pytest.mark.slow  # loads are none: the test below
def test_what_a_delay_keeps_of_its_signal_is_no_variable():
    record, _ = rotor_record(100, seed=1)
    (late, *_) = pairs(some_effects("Delay"), [s for s in sites(model()) if s.name == "u"])
    flat = attach(model(), late.effect, late.site, "late")
    null = fit_null(without_noises(flat), [s for s in sites(flat) if s.kind == "node"], (record,), "zoh")
    assert any("memory" in name for name in null.explicit.flat.unknown_names)
    assert not any("memory" in name for name in internal_variables(null, run_null(null)))


BODY = """model Body
  input Daest.Units.SI.Temperature T_air;
  output Daest.Units.SI.Temperature T_core;
  parameter Daest.Units.SI.ThermalConductance G = 0.7 annotation(__Daest(estimate = true));
  Daest.Thermal.HeatTransfer.Components.HeatCapacitor body(C = 700);
  Daest.Thermal.HeatTransfer.Components.ThermalConductor surface(G = G);
  Daest.Thermal.HeatTransfer.Sources.PrescribedTemperature air;
equation
  air.T = T_air;
  connect(air.port, surface.port_a);
  connect(surface.port_b, body.port);
  T_core = body.T;
end Body;
"""


def test_of_proportional_variables_a_rate_which_contains_the_load_is_the_last(tmp_path):
    """A body that one flow of heat warms: what follows its rate follows that flow, or its temperatures."""
    (tmp_path / "Body.mo").write_text(BODY)
    flat = compile_model(tmp_path / "Body.mo")
    air = 300.0 + 20.0 * np.sin(np.arange(200) / 9.0)
    core = np.full(200, 300.0)
    for k in range(199):
        core[k + 1] = core[k] + 10.0 * 0.7 / 700.0 * (air[k] - core[k])
    noise = 0.01 * np.random.default_rng(0).normal(size=200)
    record = Experiment(
        "run", 10.0 * np.arange(200), air[:, None], (core + noise)[:, None], ("T_air",), ("T_core",)
    )
    null = fit_null(without_noises(flat), [s for s in sites(flat) if s.kind == "node"], (record,), "zoh")
    names = internal_variables(null, run_null(null))
    assert "body.der_T" not in names and any(name.startswith("surface.") for name in names)


def test_variables_do_not_contain_the_load():
    null, run, _ = pushed()
    variables = internal_variables(null, run)
    assert "u" in variables and "load_1" not in variables
    assert np.std(run.observed[0].filtered[:, run.state_names.index("load_1")]) > 0.05
    # Without the load the rotor obeys J a = u - d w.
    values = {p.name: p.value for p in null.fit.parameters}
    torque = values["J"] * variables["rotor.a"] + values["d"] * variables["rotor.w"]
    assert torque == pytest.approx(variables["u"], abs=1e-9)


def test_curve_is_shown_where_all_but_the_start_is():
    """A flow from the first sample of a cold house had stretched the axis to five times what it did later."""
    later = np.linspace(0.0, 1.0, 400)
    for first, ends in ((-5.0, (0.0, 1.0)), (6.0, (0.0, 1.0)), (-0.05, (-0.05, 1.0))):
        whole = np.append(later, first)
        basis = _basis(whole, whole, "W", 1)
        assert basis.x[[0, -1]] == pytest.approx(ends, abs=0.01)
        # The curve itself goes on to that sample, and is shown as it is.
        knots = np.quantile(whole, np.linspace(0.0, 1.0, 8))
        assert knots @ basis.shown == pytest.approx(basis.x)
        assert knots @ basis.course == pytest.approx(whole)
