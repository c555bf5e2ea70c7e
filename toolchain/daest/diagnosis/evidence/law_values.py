"""What a proof says of its law beside others: its own values, its gain, and its errors on unseen data."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from daest.diagnosis.gates import GATES
from daest.model.diagnosis import Ahead, Candidate, Proof
from daest.model.effects import EffectParameter
from daest.model.fit import FittedParameter, error_ratios, most_lasting


def leaves_load_and_errors(proof: Proof) -> bool:
    """Whether a law that is judged beside loads leaves them as they were, and errors of a simulation of
    unseen data that last."""
    return not proof.is_by_use and proof.explained < GATES.min_explained and errors_last(proof)


def is_simpler(lag: Candidate, law: Candidate) -> bool:
    """Whether a lag has fewer parameters than a law, or as many as one by which something follows late in
    another way: play has a width, a coil an inductance."""
    few, many = len(lag.estimated), len(law.estimated)
    return few < many or (few == many and not (law.is_of_signal and law.is_dynamic))


def open_shapes(proof: Proof, significance: float = 1.0) -> list[FittedParameter]:
    """The lengths and times of a law, which cannot be below zero, that are within so many standard errors of
    it."""
    own = {
        f"{proof.candidate.name}.{p.name}"
        for p in proof.candidate.effect.parameters
        if p.role == "shape" and p.min is not None and p.min >= 0.0
    }
    return [
        p
        for p in told_of_effect(proof)
        if p.name in own and p.std_error and p.value <= significance * p.std_error
    ]


def is_size(proof: Proof, parameter: FittedParameter) -> bool:
    """Whether a parameter of a law is one of its sizes."""
    sizes = {f"{proof.candidate.name}.{p.name}" for p in proof.candidate.effect.sizes}
    return parameter.name in sizes


def told_of_effect(proof: Proof) -> list[FittedParameter]:
    return [p for p in proof.told.parameters if p.name in proof.candidate.estimated]


def is_less_known(one: Proof, other: Proof) -> bool:
    """Whether no size of a law is told to stand off zero, but by its ratio to a parameter of the model, and
    one of another law is."""
    (here, there) = ([p for p in told_of_effect(law) if is_size(law, p)] for law in (one, other))
    return all(map(is_undetermined, here)) and not all(map(is_undetermined, there))


def is_undetermined(p: FittedParameter) -> bool:
    """Whether an estimate rests at a bound, or does not stand off zero."""
    return bool(p.at_bound) or abs(p.value) < GATES.min_significance * (p.std_error or np.inf)


def agree(a: FittedParameter, b: FittedParameter) -> bool:
    """Whether two estimates are within one standard error of their difference."""
    return abs(a.value - b.value) <= np.hypot(a.std_error or 0.0, b.std_error or 0.0)


def values_of_model(proof: Proof) -> list[FittedParameter]:
    """The parameters but those of the effect, which each law counts in its own unit."""
    own = f"{proof.candidate.name}."
    return [p for p in proof.fit.parameters if not p.name.startswith(own)]


def ahead_of(best: Sequence[Ahead], one: Sequence[Ahead]) -> dict[int, float]:
    """Errors of predictions of unseen data relative to those of the best law, by horizon in samples, where
    both are known."""
    known = {a.samples: a.ratio for a in best}
    return {a.samples: a.ratio / known[a.samples] for a in one if a.samples in known}


def unseen_ratio(best: Proof, one: Proof) -> float:
    """Error of `one` on unseen data relative to that of `best`: of the whole simulation, or of predictions at
    the longest horizon where the simulation is dead reckoning. inf where it is unknown, or an output gets
    worse. A law that is better by no more than a constant load is not better: where it is known, that with
    one counts (`with_steady_error`)."""
    if one.adds_up:
        ahead = ahead_of(best.ahead, one.ahead)
        return ahead[max(ahead)] if ahead else np.inf
    ratios = error_ratios(best.told.simulated, one.told.simulated)
    if not ratios or max(ratios) > 1.0 + GATES.same_unseen_error:
        return np.inf
    whole = float(np.sqrt(np.mean(np.square(ratios))))
    if best.steady_error and one.steady_error is not None:
        return max(whole, one.steady_error / best.steady_error)
    return whole


def own_sizes(proof: Proof) -> list[FittedParameter]:
    """The parameters of a law, but for sizes that are all that there can be: they were no choice."""
    whole = _whole_sizes(proof)
    own = f"{proof.candidate.name}."
    return [p for p in proof.fit.parameters if p.name.startswith(own) and p not in whole]


def _whole_sizes(proof: Proof) -> list[FittedParameter]:
    """Sizes that are all that there can be as far as the data tell, and far from nothing: all of an excess is
    cut."""
    fitted = {p.name: p for p in proof.fit.parameters}
    sizes = ((fitted.get(f"{proof.candidate.name}.{p.name}"), p) for p in proof.candidate.effect.sizes)
    return [p for p, declared in sizes if p is not None and _is_whole(p, declared)]


def _is_whole(size: FittedParameter, declared: EffectParameter) -> bool:
    if declared.max is None or size.at_bound == "max":
        return declared.max is not None
    error = GATES.min_significance * (size.std_error or np.inf)
    return declared.max - size.value <= error < size.value - (declared.null or 0.0)


def bic_beside(proof: Proof) -> float:
    """The BIC gain of a law beside others: with sizes that are all that there can be held there, which costs
    the likelihood half of the square of their distance in standard errors."""
    whole = _whole_sizes(proof)
    if not whole or not proof.candidate.n_unknowns:
        return proof.delta_bic
    each = (2.0 * proof.delta_log_likelihood - proof.delta_bic) / proof.candidate.n_unknowns
    maxima = {f"{proof.candidate.name}.{p.name}": p.max for p in proof.candidate.effect.sizes}
    return proof.delta_bic + sum(each - _distance(p, maxima[p.name]) ** 2 for p in whole)


def _distance(size: FittedParameter, maximum: float | None) -> float:
    """Standard errors between a size and the largest there can be."""
    if size.at_bound or maximum is None or not size.std_error:
        return 0.0
    return (maximum - size.value) / size.std_error


def n_chosen(proof: Proof) -> int:
    """How many parameters a fit with a law had to choose."""
    return len(proof.fit.parameters) - len(_whole_sizes(proof))


def errors_last(proof: Proof) -> bool:
    """Whether what a simulation of unseen data leaves lasts: something else is missing, or acts besides."""
    return most_lasting(proof.told.simulated)[1] >= GATES.told_rest
