"""Sentences about a law that was refitted: its size, what it removes, what it leaves, how sure it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from daest.diagnosis.answers.decided import Evidence, error_ratio, foreseen_by, listed, told_fits
from daest.diagnosis.evidence.reasons import is_significant, told_values
from daest.diagnosis.evidence.refused_beside import is_straight_there
from daest.diagnosis.evidence.unseen import is_likelier, is_silent
from daest.diagnosis.gates import GATES
from daest.model.diagnosis import (
    Proof,
)
from daest.model.fit import FitResult, most_lasting, ratios_by_output
from daest.quantities import is_temperature, spoken_duration


def supported(evidence: Evidence, proof: Proof) -> str:
    return f"{proof.candidate.label}: {told_values(proof)}; supported." + told_of(evidence, proof)


def told_of(evidence: Evidence, proof: Proof) -> str:
    """What is to be said of a law beside its values."""
    text = ""
    if proof.equivalent:
        text += f" The sensors cannot tell it from the same effect at {listed(proof.equivalent)}."
    if proof.same_as:
        text += f" On these recordings it is the same equation as {listed(proof.same_as)}."
    text += _of_both(evidence, proof) + _of_recorded_potential(proof)
    if proof.left is not None and is_significant(proof.left, proof.delta_log_likelihood):
        text += f" Something else is missing besides: what is left follows {proof.left.label}."
    ratio = error_ratio(evidence, proof)
    told = errors_told(evidence, proof) + importance_told(evidence, proof) + _left_over(evidence, proof)
    told += certainty_told(evidence, proof)
    return text + told + foreseen_by(evidence, proof, GATES.max_told_ratio * min(ratio, 1.0))


def _of_recorded_potential(proof: Proof) -> str:
    """That what is recorded beside the machine may answer to the same cause, where the law is an exchange
    with it; empty for other laws."""
    effect, columns = proof.candidate.effect, proof.candidate.inputs
    if effect.domain != "thermal" or not any(map(is_temperature, effect.input_units)):
        return ""
    name = listed(tuple(columns.values()))
    return f" What warms {name} as well, and is not recorded, would look alike."


def _of_both(evidence: Evidence, proof: Proof) -> str:
    """That a signal is off in gain and offset together, where a law without its bend says more of it than the
    one of both that is accepted; empty where none does."""
    likelier = [
        p
        for p in evidence.proofs
        if is_straight_there(p, proof) and p.delta_bic > proof.delta_bic + GATES.same_bic
    ]
    if not likelier:
        return ""
    both = max(likelier, key=lambda p: p.delta_bic)
    says = f"{both.candidate.label} says more (BIC {both.delta_bic - proof.delta_bic:.0f})"
    return f" Gain and offset are off together: {says}, but {both.reason}."


def importance_told(evidence: Evidence, proof: Proof) -> str:
    """How much the effect matters: share of the error on unseen data that it removes, at the horizon where it
    removes most, and in the whole simulation."""
    parts = []
    if proof.ahead:
        best = min(proof.ahead, key=lambda one: one.ratio)
        ahead = spoken_duration(best.seconds, evidence.clock)
        parts.append(f"{_removed(best.ratio)} of the error of predictions {ahead} ahead")
    if proof.is_by_use and proof.in_use.piece:
        over = spoken_duration(proof.in_use.piece, evidence.clock)
        removed = _removed(proof.in_use.ratio)
        parts.append(f"{removed} of the error of simulations over {over}, each from a start of its own,")
    ratio = error_ratio(evidence, proof)
    is_larger = np.isfinite(ratio) and ratio > 1.0 + GATES.same_unseen_error
    if np.isfinite(ratio) and not is_larger:
        least, output = _most_removed(evidence, proof)
        parts.append(
            f"{_removed(least)} of {'that' if parts else 'the error'} of the whole simulation{output}"
        )
    text = f" Importance: it removes {' and '.join(parts).removesuffix(',')}." if parts else ""
    if is_larger:
        text += f" The error of the whole simulation gets {ratio:.3g} times larger"
        text += ": nothing holds what is measured, so that it adds up" if proof.adds_up else ""
        text += _removed_of_steady(evidence, proof) + "."
    return text


def _removed_of_steady(evidence: Evidence, proof: Proof) -> str:
    """The share that the effect removes of the error of an output beside those that add up; empty where there
    is none that gets smaller."""
    before, after = told_fits(evidence, proof)
    ratios = _of_steady(proof, ratios_by_output(before.simulated, after.simulated)) if proof.adds_up else {}
    name = min(ratios, key=ratios.__getitem__, default="")
    if not name or ratios[name] > 1.0 - GATES.same_unseen_error:
        return ""
    return f"; that of {name}, which does not, gets {_removed(ratios[name])} smaller"


def _most_removed(evidence: Evidence, proof: Proof) -> tuple[float, str]:
    """Error of the candidate on unseen data relative to that of the model as it is, of the output where it is
    smallest, and which one that is; empty where it is the only one."""
    before, after = told_fits(evidence, proof)
    ratios = ratios_by_output(before.simulated, after.simulated)
    name = min(ratios, key=ratios.__getitem__)
    return ratios[name], f" of {name}" if len(ratios) > 1 else ""


def _left_over(evidence: Evidence, proof: Proof) -> str:
    """A sentence on the output of which a simulation with the effect leaves most, beside its noise; empty
    where it leaves little more, or the errors of all outputs add up."""
    after = told_fits(evidence, proof)[1]
    ratios = _of_steady(proof, ratios_by_output(after.one_step, after.simulated))
    name = max(ratios, key=ratios.__getitem__, default="")
    if name and GATES.told_rest <= ratios[name] < np.inf:
        return (
            f" What a simulation leaves of {name} is {ratios[name]:.2g} times its error one sample ahead: "
            "something else is missing, or acts besides."
        )
    return _lasting(proof, after, GATES.told_rest)


def _of_steady(proof: Proof, ratios: Mapping[str, float]) -> dict[str, float]:
    """The ratios of the outputs whose errors do not add up."""
    return {name: one for name, one in ratios.items() if not proof.adds_up or name in proof.holding}


def spoilt(evidence: Evidence, proof: Proof) -> tuple[str, float]:
    """The output of which a simulation of unseen data gets clearly worse with the effect, though that of all
    together does not, and how many times; no name where there is none, or errors add up. Where all get worse
    for a constant that is missing besides, the gates of the proof have judged that."""
    before, after = told_fits(evidence, proof)
    ratios = _of_steady(proof, ratios_by_output(before.simulated, after.simulated))
    name = max(ratios, key=ratios.__getitem__, default="")
    whole = float(np.sqrt(np.mean(np.square(list(ratios.values()))))) if ratios else np.inf
    in_pieces = proof.is_by_use and proof.in_use.piece
    if in_pieces or whole > 1.0 + GATES.max_simulated_loss or ratios[name] <= 1.0 / GATES.max_clear_ratio:
        return "", 1.0
    return name, ratios[name]


def _lasting(proof: Proof, after: FitResult, limit: float) -> str:
    """A sentence on the output whose errors in a simulation of unseen data last longest; empty where none is
    more than `limit` times its part without memory, or they add up. The error one sample ahead says nothing
    of it where no load can take the place of what is missing: the noise of the sensor then stands for it."""
    name, ratio = most_lasting(after.simulated)
    if proof.adds_up or ratio < limit:
        return ""
    return (
        f" What a simulation leaves of {name} lasts: it is {ratio:.2g} times its part without memory, "
        "so that something else is missing, or acts besides, or the noise of that sensor is slow."
    )


def left_by_set(evidence: Evidence, accepted: Sequence[Proof]) -> str:
    """What is to be said of the simulations with laws that are not told apart: their errors, and what every
    one of them leaves, which may be since none of them is what acts."""
    text = errors_told(evidence, accepted[0])
    left = [
        _left_over(evidence, p) or _lasting(p, told_fits(evidence, p)[1], GATES.told_rest_of_set)
        for p in accepted
    ]
    return text + (f"{left[0]} It may be none of them." if all(left) else "")


def nearest_in_pieces(proofs: Sequence[Proof], clock: str = "s") -> str:
    """A sentence on the law that simulations of pieces of the records show best, where none is accepted;
    empty where there is none. One whose size nobody knows lives on how its states begin: a mass of nothing
    that swings is a sine of any origin."""
    is_open = all(p.verdict == "rejected" for p in proofs)
    known = [p for p in proofs if is_open and p.in_use.piece and _has_known_size(p)]
    best = max(known, key=lambda p: p.in_use.bic(p.candidate.n_unknowns), default=None)
    if best is None:
        return ""
    return (
        f" In simulations over {spoken_duration(best.in_use.piece, clock)}, each from a start of its own, "
        f"{best.candidate.label} comes nearest ({told_values(best)}): it removes "
        f"{_removed(best.in_use.ratio)} of their error on unseen data."
    )


def _has_known_size(proof: Proof) -> bool:
    """Whether any size of a law has a standard error."""
    own = {f"{proof.candidate.name}.{size.name}" for size in proof.candidate.effect.sizes}
    return any(p.std_error is not None for p in proof.told.parameters if p.name in own)


def _removed(ratio: float) -> str:
    return f"{100.0 * max(1.0 - ratio, 0.0):.0f} %"


def certainty_told(evidence: Evidence, proof: Proof) -> str:
    """How sure the effect is, however little it matters."""
    text = f" Certainty: BIC gain {proof.delta_bic:.3g} over {evidence.screen.n_screened} candidates"
    if proof.ahead:
        surest = max(proof.ahead, key=lambda one: one.certainty)
        better = surest.certainty > 0.0
        text += ", unseen data foreseen "
        text += f"better by {surest.certainty:.2g} standard errors" if better else "no better"
    elif proof.is_by_use:
        text += f", unseen data simulated better by {proof.in_use.certainty:.2g} standard errors"
    if is_silent(proof.confirmed):
        text += ", though unseen data hardly show it"
    elif is_likelier(proof.confirmed):
        text += f", and likelier by {proof.confirmed.certainty:.2g}"
    return text + "."


def errors_told(evidence: Evidence, proof: Proof) -> str:
    """Validation errors before and after, per output."""
    before, after = (fit.simulated.get("validation") for fit in told_fits(evidence, proof))
    if before is None or after is None:
        return ""
    parts = [
        f"{name} {b:.3g} -> {after.rms[name]:.3g}"
        for name, b in before.rms.items()
        if b is not None and after.rms.get(name) is not None
    ]
    return f" Validation error (rms): {', '.join(parts)}." if parts else ""
