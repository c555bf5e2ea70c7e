"""Models of which no output shows a scale: a strong motor with a heavy rotor, a weak one with a light one."""

from functools import cache
from pathlib import Path

import pytest
from hidden_plants import MODELS, model, rotor_record, some_effects

from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.options import DiagnoseOptions
from daest.diagnosis.stand import begin, kept_told
from daest.modelica.compile import compile_text


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


def test_one_parameter_is_kept_near_its_value_of_those_that_change_together():
    stand = begin(scale_free(), [rubbing_record()], [], DiagnoseOptions(hold="zoh"))
    assert [set(names) for names in stand.tied] == [{"J", "d", "k"}]
    kept = stand.tied[0][0]
    assert kept in ("J", "k"), "the friction is known least, even where the others are known"
    assert f"{kept} was kept near" in kept_told(stand)
    given = next(p.value for p in scale_free().parameters if p.name == kept)
    assert stand.null.fit.theta[kept] == pytest.approx(given, rel=0.5)


def test_nothing_is_kept_where_every_parameter_shows():
    stand = begin(model(), [rubbing_record()], [], DiagnoseOptions(hold="zoh"))
    assert stand.tied == () and stand.null.estimated == ("J", "d") and kept_told(stand) == ""


def test_law_is_found_in_proportion_to_what_was_kept():
    laws = some_effects("CoulombFriction", "Unbalance", "ConstantLoad")
    found = diagnose(scale_free(), laws, [rubbing_record()], (), DiagnoseOptions(hold="zoh"))
    assert found.verdict == "supported" and "was kept near" in found.message
    law, fit = found.proofs[0], found.proofs[0].told
    assert law.candidate.effect.name == "CoulombFriction"
    assert fit.theta[f"{law.candidate.name}.tau_c"] / fit.theta["k"] == pytest.approx(0.15, rel=0.1)
