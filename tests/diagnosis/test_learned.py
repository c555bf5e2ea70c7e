"""Learned loads: the curve of what no effect explains, estimated as a part of the model and written as
Modelica."""

from dataclasses import replace
from functools import cache

import casadi as ca
import numpy as np
import pytest
from hidden_plants import MODELS, library, model, rotor_record

from daest.diagnosis.answers import learned
from daest.diagnosis.answers.learned import (
    _no_better,
    learned_load,
    load_sign,
    said,
    with_curve,
    with_formula,
)
from daest.diagnosis.answers.written import simulated_rms, written_load
from daest.diagnosis.evidence.stand import begin, without_noises
from daest.diagnosis.null_model.loads import load_places
from daest.diagnosis.null_model.null_observer import run_null
from daest.diagnosis.options import DiagnoseOptions
from daest.diagnosis.screening.free_forms import free_forms
from daest.errors import EstimationError
from daest.model.diagnosis import Curve
from daest.modelica.compile import compile_text
from daest.modelica.effects.attach import attach
from daest.modelica.places.sites import sites
from daest.systems.reduction.reduce import reduce_index


def friction(phi):
    """N.m; depends on the angle, which no effect describes."""
    return 0.2 * (1.0 + 0.8 * np.sin(phi))


@cache
def bumpy():
    """Stand, run and form of a record with that friction, half of it for validation."""
    whole, _ = rotor_record(2000, seed=12, coulomb=friction)
    stand = begin(model(), [whole], [], DiagnoseOptions(hold="zoh"))
    run = run_null(stand.null)
    return stand, run, free_forms(stand.null, run)[0]


def found_load():
    stand, run, form = bumpy()
    return learned_load(stand.null, run, stand.baseline, form, stand.validation)


refitted = cache(found_load)


@pytest.mark.slow
def test_refit_finds_the_true_curve_and_parameters():
    found = refitted()
    curve = found.curve
    assert (curve.variable, curve.sign_of, curve.period) == ("rotor.phi", "rotor.w", 2.0 * np.pi)
    error = (curve.y + friction(curve.x)) / curve.std
    assert np.mean(np.abs(error) < 2.0) >= 0.8 and np.max(np.abs(error)) < 3.5
    assert np.max(curve.std) < 0.03
    values = {p.name: p for p in found.fit.parameters}
    for name, true in (("J", 0.5), ("d", 0.3)):
        assert values[name].value == pytest.approx(true, rel=0.05)
        assert abs(values[name].value - true) < 3.0 * values[name].std_error
    # What the null's parameters took from the curve they have given back.
    assert found.theta["d"] < 0.6 * bumpy()[0].baseline.theta["d"]


def test_validation_error_falls_and_is_said():
    found = refitted()
    before, after = found.before["phi"], found.after["phi"]
    assert before == bumpy()[0].baseline.simulated["validation"].rms["phi"]
    assert after < before / 5.0
    assert said(found) == (
        f" With the curve, refitted, in the model: validation error (rms) phi {before:.3g} -> {after:.3g}."
    )


def test_formula_is_told_where_the_data_show_a_coefficient():
    found = refitted()
    assert with_formula(found).formula is not None
    vague = replace(found, fit=None, curve=replace(found.curve, std=10.0 * np.abs(found.curve.y) + 1.0))
    assert with_formula(vague).formula is None


def test_a_curve_that_does_not_help_is_called_a_hint():
    found = replace(refitted(), before={"phi": 0.1, "w": None}, after={"phi": 0.2})
    assert said(found).endswith("phi 0.1 -> 0.2, no better: take the curve as a hint, not as a model.")
    assert said(replace(found, after={"phi": None})) == ""
    loose = replace(found.curve, std=np.abs(found.curve.y))
    assert said(replace(found, curve=loose)).endswith("with parameters refitted with it.")


def test_written_model_is_the_fitted_one():
    stand, _, form = bumpy()
    found = refitted()
    written = written_load(MODELS / "Rotor.mo", None, found)
    assert written.reason == "" and written.extension.class_name == "Rotor_Learned"
    flat = written.extension.flat
    mine = with_curve(without_noises(model()), stand.null.places[form.load].row, found.curve)
    theirs, own = reduce_index(without_noises(flat)), reduce_index(valued(mine, found.theta))
    assert theirs.state_names == own.state_names
    rng = np.random.default_rng(0)
    for _ in range(50):
        x, u = rng.normal(0.0, (9.0, 0.5)), rng.normal(size=1)
        rates = [e.rhs(x, u, [], [], e.flat.theta_values, 0.0).full().ravel() for e in (theirs, own)]
        np.testing.assert_allclose(*rates, rtol=1e-5, atol=1e-6)  # values are written with eight digits
    errors = simulated_rms(flat, ["phi"], {}, stand.validation, "zoh")
    assert errors["phi"] == pytest.approx(found.after["phi"], rel=0.1)


def valued(flat, theta):
    """The model with the values `theta`."""
    own = tuple(replace(p, value=theta.get(p.name, p.value)) for p in flat.parameters)
    return replace(flat, parameters=own)


@pytest.mark.parametrize("period", [0.0, 2.5])
def test_curve_is_that_of_straight_lines(period):
    x, y = np.array([-0.5, 0.2, 0.4, 1.5]), np.array([1.0, -2.0, 0.5, 0.7])
    curve = Curve("rotor.phi", "", 0.0, period, x, y, y)
    flat = without_noises(model())
    row = load_places(flat, [s for s in sites(flat) if s.kind == "node"])[0].row
    grown = with_curve(flat, row, curve)
    assert [p.name for p in grown.parameters[-4:]] == [f"learned.y[{i}]" for i in (1, 2, 3, 4)]
    load = ca.Function("load", [grown.xi, grown.theta], [flat.residual[row] - grown.residual[row]])
    at = [v.name for v in grown.unknowns].index("rotor.phi")
    for value in np.linspace(-7.0, 7.0, 201):
        xi = np.zeros(grown.n)
        xi[at] = value
        true = np.interp(value, x, y, period=period or None)
        assert float(load(xi, grown.theta_values)) == pytest.approx(true, abs=1e-12)


def test_knots_are_added_where_there_is_room_and_data():
    x = np.array([0.0, 1.0, 1.1, 3.0, 4.0])
    course = np.concatenate([np.linspace(0.0, 1.0, 40), np.linspace(1.0, 1.1, 40), np.linspace(1.1, 3.0, 40)])
    curve = Curve("rotor.phi", "", 0.0, 0.0, x, x**2, x)
    finer = learned._finer(curve, course)
    assert finer.x == pytest.approx([0.0, 0.5, 1.0, 1.1, 2.05, 3.0, 4.0], abs=0.03)
    np.testing.assert_allclose(finer.y, np.interp(finer.x, x, x**2))
    turned = learned._finer(replace(curve, period=5.0), np.linspace(-20.0, -15.0, 300))
    assert turned.x.size == 9 and turned.x[-1] == pytest.approx(4.5, abs=0.03)
    assert turned.y[-1] == pytest.approx(8.0, abs=0.5)  # on the way from 16 back to 0


INSIDE = """\
model Whole
  model Part
    Daest.Mechanics.Rotational.Interfaces.Flange_b out;
    Daest.Mechanics.Rotational.Components.Inertia small(J = 1);
    Daest.Mechanics.Rotational.Components.SpringDamper spring(c = 3, d = 1);
  equation
    connect(small.flange_b, spring.flange_a);
    connect(spring.flange_b, out);
  end Part;
  Part part;
  Daest.Mechanics.Rotational.Components.Inertia large(J = 2);
  output Real angle = part.small.phi + large.phi;
equation
  connect(part.out, large.flange_a);
end Whole;
"""


def test_sign_of_a_load_is_known_where_parameters_are_factors_of_what_flows():
    """A model in per unit, beside a law that an earlier round has put in."""
    text = """model Choke
  parameter Real l(unit = "s") = 0.01;
  parameter Real r(unit = "1") = 0.4;
  input Real u(unit = "1");
  output Real i(unit = "1", start = 0);
equation
  l*der(i) = u - r*i;
end Choke;
"""
    flat = compile_text(text.encode(), MODELS / "Choke.mo", "Choke")
    loss = next(e for e in library() if e.class_name.endswith("FirstOrderLoss"))
    (site,) = [s for s in sites(flat) if s.kind == "equation" and s.domain == "amount"]
    both = attach(flat, loss, site)
    row = next(k for k, e in enumerate(both.equations) if "der(i)" in e.text)
    assert load_sign(both, row) == load_sign(flat, 0) == 1.0


@pytest.mark.parametrize("name", ["Rotor", pytest.param("TwoMass", marks=pytest.mark.slow), "Whole"])
def test_sign_of_a_load_is_that_of_a_torque_into_the_node(name):
    flat = compile_text(INSIDE.encode(), MODELS / "Whole.mo", name) if name == "Whole" else model(name)
    flat = without_noises(flat)
    torque = next(e for e in library() if e.class_name.endswith("Rotational.ConstantLoad"))
    nodes = [s for s in sites(flat) if s.kind == "node" and s.domain == "rotational"]
    assert load_places(flat, nodes)
    for place in load_places(flat, nodes):
        residual = ca.SX(flat.residual)
        residual[place.row] -= 0.1 * load_sign(flat, place.row)
        pushed = attach(
            flat, torque, next(n for n in nodes if n.name == place.names[0]), values={"tau_0": -0.1}
        )
        rates = []
        for one in (replace(flat, residual=residual), pushed):
            e = reduce_index(one)
            x, u = np.linspace(0.1, 0.4, e.n_states), np.zeros(len(one.inputs))
            v = np.zeros(e.rhs.numel_in(2))
            rates.append(e.rhs(x, u, v, [], e.flat.theta_values, 0.0).full().ravel())
        np.testing.assert_allclose(*rates, rtol=1e-12)


def test_without_a_refit_the_curve_is_that_of_the_form(monkeypatch):
    def failing(*_, **__):
        raise EstimationError("identify-diverged", "no")

    monkeypatch.setattr(learned, "refit", failing)
    found, form = found_load(), bumpy()[2]
    assert found.fit is None and found.sign == 1.0
    np.testing.assert_array_equal(found.curve.y, form.w)
    np.testing.assert_array_equal(found.curve.std, form.std)
    assert found.theta["J"] == bumpy()[0].null.fit.theta["J"]
    written = written_load(MODELS / "Rotor.mo", None, found)
    simulated = simulated_rms(written.extension.flat, ["phi"], {}, bumpy()[0].validation, "zoh")
    assert found.after["phi"] == pytest.approx(simulated["phi"], rel=0.1)
    assert said(found).startswith(" With the curve in the model: validation error (rms) phi 0.")


def test_load_over_what_depends_on_it_at_once_is_not_built_in():
    stand, run, form = bumpy()
    acceleration = replace(form, variable="rotor.a", sign_of="", over_a_turn=False)
    assert learned_load(stand.null, run, stand.baseline, acceleration, stand.validation) is None


def test_what_cannot_be_written_has_a_reason(tmp_path):
    assert "an FMU holds equations" in written_load(tmp_path / "Rotor.fmu", None, refitted()).reason
    form = replace(refitted().form, place="somewhere.flange")
    written = written_load(MODELS / "Rotor.mo", None, replace(refitted(), form=form))
    assert written.text is None and "a load at `somewhere.flange` cannot be written" in written.reason


def test_load_over_a_speed_that_held_inputs_do_not_have_is_not_built_in():
    """The other hold is tried beside a curve over the slope of an input, of which a held one has none."""
    stand, run, form = bumpy()
    sloped = replace(form, sign_of="actuator.v")
    assert learned_load(stand.null, run, stand.baseline, sloped, stand.validation) is None


@pytest.mark.parametrize(
    ("after", "is_no_better"),
    [
        ({"y": 0.01395}, True),
        ({"y": 0.0139}, True),
        ({"y": 0.0135}, False),
        ({"y": None}, False),
        ({}, False),
    ],
)
def test_a_curve_without_a_refit_must_simulate_unseen_data_better(after, is_no_better):
    """White noise between two filters was an effect that follows the output, with an error of 13.9 mV that
    the curve left as it was."""
    assert bool(_no_better({"y": 0.01394}, after)) == is_no_better
