"""Models of which no output shows a scale: a strong motor with a heavy rotor, a weak one with a light one."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hidden_plants import MODELS, model, rotor_record, some_effects

from daest.diagnosis.answers.told_beside import held_told
from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.evidence.stand import begin
from daest.diagnosis.options import DiagnoseOptions
from daest.estimation.identify import absorbed_parameters, tied_parameters
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_text
from daest.systems.simulation.simulate import simulate


@cache
def scale_free():
    """The rotor with an unknown constant of its motor."""
    text = (MODELS / "Rotor.mo").read_text().replace("connect(u, drive.tau);", "drive.tau = k*u;")
    constant = '  parameter Real k(min = 0) = 0.7 annotation(__Daest(estimate = true, scale = "log"));\n'
    head, rest = text.split("\n", 1)
    return compile_text(f"{head}\n{constant}{rest}".encode(), Path("Rotor.mo"))


@cache
def rubbing_record():
    return rotor_record(1200, seed=2, coulomb=lambda phi: 0.15)[0]


@pytest.mark.slow
def test_one_parameter_is_held_of_those_that_change_together():
    stand = begin(scale_free(), [rubbing_record()], [], DiagnoseOptions(hold="zoh"))
    assert [set(names) for names in stand.tied] == [{"J", "d", "k"}]
    held, _, least = stand.tied[0]
    assert held in ("J", "k"), "the friction is known least, even where the others are known"
    assert f"{held} was held at" in held_told(stand) and held not in stand.null.estimated
    free = {p.name: p for p in stand.null.flat.parameters}
    given = {p.name: p for p in scale_free().parameters}
    assert free[held].value == given[held].value
    assert free[least].min is None and free[least].estimate, "it may have to pass its bound at this scale"


def test_nothing_is_held_where_every_parameter_shows():
    stand = begin(model(), [rubbing_record()], [], DiagnoseOptions(hold="zoh"))
    assert stand.tied == () and stand.null.estimated == ("J", "d") and held_told(stand) == ""


@pytest.mark.slow  # what is held: the tests above and below
def test_law_is_found_in_proportion_to_what_was_held():
    laws = some_effects("CoulombFriction", "Unbalance", "ConstantLoad")
    found = diagnose(scale_free(), laws, [rubbing_record()], (), DiagnoseOptions(hold="zoh"))
    assert found.verdict == "supported" and "was held at" in found.message
    law, fit = found.proofs[0], found.proofs[0].told
    assert law.candidate.effect.name == "CoulombFriction"
    assert fit.theta[f"{law.candidate.name}.tau_c"] / fit.theta["k"] == pytest.approx(0.15, rel=0.1)


@pytest.mark.slow  # what changes together: above
def test_small_friction_does_not_hide_what_changes_with_it():
    """Beside the friction of the motor's own voltage its change is by far the largest one."""
    text = (
        (MODELS / "Rotor.mo").read_text().replace("connect(u, drive.tau);", "drive.tau = k*(u - k*rotor.w);")
    )
    constant = '  parameter Real k(min = 0) = 0.7 annotation(__Daest(estimate = true, scale = "log"));\n'
    head, rest = text.replace("d(min = 0) = 0.3", "d(min = 0) = 1e-7").split("\n", 1)
    flat = compile_text(f"{head}\n{constant}{rest}".encode(), Path("Rotor.mo"))
    assert set(tied_parameters(flat, [rubbing_record()], "foh")) == {"J", "d", "k"}
    stand = begin(flat, [rubbing_record()], [], DiagnoseOptions(hold="zoh"))
    assert len(stand.tied) == 1 and stand.tied[0][0] not in stand.null.estimated


LIFT = b"""model Lift "Height by integrating twice, its zero unknown"
  parameter Real h0(unit = "m") = 3 annotation(__Daest(estimate = true));
  parameter Real k = 1.2 annotation(__Daest(estimate = true));
  input Real a(unit = "m/s2");
  output Real y(unit = "m") annotation(__Daest(std = 0.05));
  Real h(unit = "m", start = 0, fixed = true); Real v(unit = "m/s", start = 0, fixed = true);
equation
  der(h) = v;
  der(v) = k*a;
  y = h0 + h;
end Lift;
"""


def test_parameter_is_held_that_a_free_initial_state_makes_up_for():
    flat = compile_text(LIFT, Path("Lift.mo"))
    time = 0.1 * np.arange(300.0)
    a = np.repeat(np.random.default_rng(4).normal(size=30), 10)[:, None]
    y = simulate(flat.with_theta({"k": 1.0}), (time, a), hold="zoh").outputs
    y = y + 0.05 * np.random.default_rng(5).standard_normal(y.shape)
    record = Experiment("ride", time, a, y, ("a",), ("y",))
    assert absorbed_parameters(flat, [record], "foh") == ("h0",)
    stand = begin(flat, [record], [], DiagnoseOptions(hold="zoh"))
    assert stand.tied == (("h0",),) and stand.null.estimated == ("k",)
    assert held_told(stand) == "Free initial states do all that h0 does: it was held at 3."
