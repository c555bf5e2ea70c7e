"""What is told beside a verdict: limits of sensors that were taken as given, parameters that were held, and
those that went far from what the model gives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from daest.diagnosis.evidence.reasons import told_number
from daest.diagnosis.evidence.stand import Stand
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import are_driven_off
from daest.diagnosis.screening.clipping import share_at_limit
from daest.model.diagnosis import Diagnosis, Proof, VerdictName
from daest.model.fit import FittedParameter
from daest.model.parts import Parameter
from daest.quantities import with_unit

_WITH_OFFSET = ("degC", "degF")


def limit_told(stand: Stand, proof: Proof) -> str:
    """How the recordings show that a sensor cuts."""
    output = proof.candidate.site.name
    limit = proof.candidate.shape["limit"]
    share = share_at_limit(stand.null.experiments, output, limit)
    return f"{output} stays at {limit:.6g} in {100.0 * share:.2g} % of the samples, where its noise ends"


def told_whole(found: Diagnosis, stand: Stand, limits: Sequence[Proof]) -> Diagnosis:
    """The diagnosis with what was taken as given beside it, the `limits` of sensors and parameters that were
    held, and the parameters that went far."""
    found = _beside_limits(found, stand, limits)
    told = (found.message, held_told(stand), far_off_told(found, stand.declared.parameters))
    return replace(found, message=" ".join(text for text in told if text))


def held_told(stand: Stand) -> str:
    """Which parameters were held, since others do all that they do; empty where none was."""
    values = {p.name: p.value for p in stand.declared.parameters}
    told = "; ".join(_held_one_told(names, values[names[0]]) for names in stand.tied)
    return f"{told}." if told else ""


def _held_one_told(names: Sequence[str], value: float) -> str:
    if len(names) == 1:
        return f"Free initial states do all that {names[0]} does: it was held at {value:.4g}"
    return (
        f"{', '.join(names)} can change together without any effect on the measured outputs: {names[0]} was "
        f"held at {value:.4g}, and sizes may be in proportion to it (--fix one that is known)"
    )


def _beside_limits(found: Diagnosis, stand: Stand, limits: Sequence[Proof]) -> Diagnosis:
    """The diagnosis of a model that was given the limits of its sensors, with these told."""
    if not limits:
        return found
    told = "; ".join(limit_told(stand, proof) for proof in limits)
    text = f"The recordings show that a sensor cuts: {told}. The model was given that limit"
    if found.verdict in ("nothing missing", "parameters off"):
        name: VerdictName = "supported"
        labels = ", ".join(proof.candidate.label for proof in limits)
        message = f"{labels}; supported. {text}; beside it: {found.message}"
    else:
        name, message = found.verdict, f"{found.message} {text}, and what is said is beside it."
    return replace(found, verdict=name, message=message, proofs=(*limits, *found.proofs))


def far_off_told(found: Diagnosis, declared: Sequence[Parameter]) -> str:
    """Which parameters of the fit that is told have gone so far from the values that the model declares,
    beyond its limits or to the other sign, that they may stand in for what is missing; empty where none
    has."""
    named = next((p for p in found.proofs if p.verdict != "rejected"), None)
    told = found.baseline if named is None else named.told
    fitted = {p.name: p for p in told.parameters}
    pairs = [(fitted[p.name], p) for p in declared if p.estimate and p.name in fitted]
    off = [_far_told(one, given) for one, given in pairs if _is_far_off(one, given)]
    if not off:
        return ""
    return (
        f"Far from what the model gives: {', '.join(off)}. What is so far off may stand in for what is "
        "missing: hold what is known (--fix) and ask again."
    )


def _is_far_off(one: FittedParameter, given: Parameter) -> bool:
    """Whether a fit leads a parameter beyond a limit that it was released from, surely to the other sign, or
    one that counts by ratios far away. A small value whose uncertainty reaches the given one is not far from
    it."""
    low, high = given.min, given.max
    if (low is not None and one.value < low) or (high is not None and one.value > high):
        return True
    if _has_turned(one, given):
        return True
    reach = GATES.changed_significance * (one.std_error or 0.0)
    is_near = abs(one.value) < abs(given.value) and abs(one.value - given.value) <= reach
    counts_by_ratio = given.scale == "log" or (low is not None and low >= 0.0)
    return counts_by_ratio and not is_near and are_driven_off({one.name: one.value}, {one.name: given.value})


def _has_turned(one: FittedParameter, given: Parameter) -> bool:
    """Whether the sign of a parameter is surely another one than that given, which that of a physical
    constant seldom is. The zero of a temperature in degC is one as any other."""
    if not one.std_error or given.unit in _WITH_OFFSET:
        return False
    return one.value * given.value < 0.0 and abs(one.value) > GATES.changed_significance * one.std_error


def _far_told(one: FittedParameter, given: Parameter) -> str:
    return f"{one.name} = {told_number(one)} instead of {with_unit(f'{given.value:.4g}', one.unit)}"
