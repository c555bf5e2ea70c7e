"""Laws that are one: the same equation under two names, or the same effect at two places."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import starmap

import casadi as ca

from daest.diagnosis.evidence.law_values import agree, own_sizes, told_of_effect, values_of_model
from daest.diagnosis.gates import GATES
from daest.model.diagnosis import Proof
from daest.model.effects import Effect
from daest.model.fit import FittedParameter
from daest.modelica.effects.catalogue import equations_of
from daest.systems.linear.linearize import is_affine


@cache
def is_linear_law(effect: Effect) -> bool:
    """Whether the equations of an effect are linear in its variables."""
    residual, derivatives, xi, w, _, time = equations_of(effect)
    return is_affine(residual, ca.vertcat(derivatives, xi, w), time)


def is_same_load(one: Proof, other: Proof) -> bool:
    """Whether a parameter that changes with a variable does what a law of the same variable does: what a
    temperature of the surroundings gains with the speed of a fan is a heat flow in proportion to that. The
    parameter itself makes up for the middle of the variable, and is another one."""
    a, b = one.candidate, other.candidate
    if a.effect.is_of_variable == b.effect.is_of_variable or len(own_sizes(one)) != len(own_sizes(other)):
        return False
    apart = abs(one.delta_log_likelihood - other.delta_log_likelihood)
    return set(a.inputs.values()) == set(b.inputs.values()) and apart <= GATES.same_fit


def is_same_equation(one: Proof, other: Proof) -> bool:
    """Whether two laws do the same under two names: as a heat flow into a node and a gain in proportion to
    it; or as an offset and a dead zone of which the recordings show one side alone. Two searches for one end
    a little apart beside the loads, and without these at the same values, with sizes that are as certain."""
    if is_same_load(one, other):
        return True
    apart = abs(one.delta_log_likelihood - other.delta_log_likelihood)
    if apart <= GATES.same_equation:
        return _has_same_values(one, other)
    if apart > GATES.same_equation_share * other.delta_log_likelihood:
        return False
    one, other = (replace(p, fit=p.told) for p in (one, other))
    sizes = list(zip(own_sizes(one), own_sizes(other), strict=False))
    return bool(sizes) and _has_same_values(one, other) and all(starmap(_are_as_certain, sizes))


def is_other_form(one: Proof, best: Proof) -> bool:
    """Whether two laws are two forms of one finding: a parameter that changes with the same variable."""
    a, b = one.candidate, best.candidate
    of_variable = a.effect.is_of_variable and b.effect.is_of_variable
    return of_variable and a.site == b.site and a.inputs == b.inputs


def _has_same_values(one: Proof, other: Proof) -> bool:
    """Whether two laws with as many sizes leave the parameters of the model where they are."""
    values, others = (values_of_model(p) for p in (one, other))
    return len(own_sizes(one)) == len(own_sizes(other)) and all(
        abs(a.value - b.value) <= GATES.same_equation * (a.std_error or 0.0)
        for a, b in zip(values, others, strict=True)
    )


def _are_as_certain(a: FittedParameter, b: FittedParameter) -> bool:
    """Whether two sizes, each in its own unit, are as many standard errors off zero."""
    one, other = (abs(p.value) / p.std_error if p.std_error else 0.0 for p in (a, b))
    return abs(one - other) <= GATES.same_equation * max(one, other)


def is_same_beside_a_load(richer: Proof, simple: Proof) -> bool:
    """Whether a law goes beyond one for the same quantity by parameters that only make up for a constant
    load: where each recording has one, both foresee unseen data alike."""
    if simple.steady_error is None or richer.steady_error is None:
        return False
    units, others = ([p.unit for p in law.candidate.effect.sizes] for law in (richer, simple))
    return (
        units == others
        and len(own_sizes(richer)) > len(own_sizes(simple))
        and richer.steady_error > (1.0 - GATES.same_unseen_error) * simple.steady_error
    )


def is_twin(one: Proof, other: Proof) -> bool:
    """Whether two laws are the same effect at two places that the data hardly tell apart, with the same
    estimates: which effect it is is known, where it is not."""
    is_near = abs(one.delta_log_likelihood - other.delta_log_likelihood) <= GATES.same_fit_elsewhere
    return is_near and _is_same_law(one, other)


def is_same_where_alike(refused: Proof, best: Proof) -> bool:
    """Whether a refused law is the accepted one at a place where the sensors see it alike, with the same
    estimates. What makes it likelier is then where the unknown loads come in, before or behind it, and it is
    no other explanation."""
    return is_where_alike(refused, best) and _is_same_law(refused, best)


def is_where_alike(one: Proof, other: Proof) -> bool:
    """Whether two laws are at two places where the sensors see them alike."""
    here, there = one.candidate.site.name, other.candidate.site.name
    return here in other.equivalent or there in one.equivalent


def _is_same_law(one: Proof, other: Proof) -> bool:
    """Whether two laws are the same effect with the same estimates, wherever it is."""
    if one.candidate.effect.class_name != other.candidate.effect.class_name:
        return False
    values, others = ({p.name.rpartition(".")[2]: p for p in told_of_effect(law)} for law in (one, other))
    return values.keys() == others.keys() and all(
        a.unit == others[name].unit and agree(a, others[name]) for name, a in values.items()
    )
