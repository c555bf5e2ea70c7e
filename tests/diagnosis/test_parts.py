"""A law that is the sum of two others, beside these with sizes of their own."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import pytest
from hidden_plants import library, model, rotor_null, rotor_record, some_effects

from daest.diagnosis.answers.parts import parts_of
from daest.diagnosis.built_in.trials import Trial, prepare
from daest.diagnosis.null_model.null import refitted
from daest.diagnosis.screening.candidates import pairs
from daest.modelica.places.sites import sites

FRICTION = 0.12  # N.m


@cache
def one_sided(load):
    """The null of a rotor with dry friction and a constant `load` [N.m], and the law that is their sum."""
    record, _ = rotor_record(800, seed=4, coulomb=lambda phi: FRICTION, torque=lambda w, phi: -load)
    null, _ = rotor_null(record)
    every = pairs(some_effects("AsymmetricFriction"), sites(model()))
    candidate = next(c for c in every if c.site.name == "rotor.flange_a")
    candidate = replace(candidate, shape={"direction": 1.0, "w_s": 0.01})
    prepared = prepare(null.flat, null.estimated, Trial(candidate, (2.0 * FRICTION,), ()))
    fit = refitted(prepared.flat, prepared.reduced(), prepared.names, null).fit
    sizes = (fit.theta[f"{candidate.name}.tau_d"],)
    return null, SimpleNamespace(candidate=candidate, fit=fit, sizes=sizes, is_by_use=False)


def test_friction_and_a_load_of_another_size_are_not_their_sum():
    parts = parts_of(*one_sided(0.05), library())
    assert parts.puts_aside and not parts.says_as_much
    assert parts.labels == ("CoulombFriction at rotor.flange_a", "ConstantLoad at rotor.flange_a")
    values = [float(text.split(" = ")[1].split()[0]) for text in parts.told.split(" and ")]
    assert values == pytest.approx([FRICTION, 0.05], abs=0.015)


@pytest.mark.slow
def test_friction_in_one_direction_stays_what_it_is():
    parts = parts_of(*one_sided(FRICTION), library())
    assert not parts.puts_aside and not parts.says_as_much and parts.more < 0.0


def test_law_that_is_no_sum_has_no_parts():
    null, law = one_sided(FRICTION)
    alone = replace(law.candidate, effect=replace(law.candidate.effect, sum_of=()))
    assert parts_of(null, SimpleNamespace(**{**vars(law), "candidate": alone}), library()) is None
    assert parts_of(null, SimpleNamespace(**{**vars(law), "is_by_use": True}), library()) is None
