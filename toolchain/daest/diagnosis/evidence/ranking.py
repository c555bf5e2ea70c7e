"""Proofs beside each other: which is best, which cannot be told from it, which could still compete."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from daest.diagnosis.built_in.trials import Trial
from daest.diagnosis.evidence.law_values import bic_beside, is_less_known, n_chosen, unseen_ratio
from daest.diagnosis.evidence.reasons import is_significant
from daest.diagnosis.evidence.refused_beside import (
    refuse,
    what_refuses_all,
    without_hopeless,
    without_imitations,
    without_outrun,
)
from daest.diagnosis.evidence.rival_laws import (
    is_contradicted,
    is_doubted,
    is_far_nearer,
    is_idle,
    is_of_the_kink,
    is_vague,
    may_be_instead,
    may_be_of_the_kink,
)
from daest.diagnosis.evidence.same_laws import (
    is_linear_law,
    is_other_form,
    is_same_beside_a_load,
    is_same_equation,
    is_twin,
)
from daest.diagnosis.gates import GATES
from daest.model.diagnosis import Candidate, Proof, Screen
from daest.model.effects import Effect
from daest.model.fit import FitResult


def could_compete(trial: Trial, best: Proof | None, screen: Screen) -> bool:
    """Whether a candidate may come near the best accepted one, to judge by their scores.

    Where the best leaves nothing, its response is all that is missing, and a candidate whose response has the
    correlation ρ with it gains about ρ² of what it gains. Where it leaves a part of the load, one whose
    places, such as those of stops, the screen has only tried on a grid may say more than it does there. One
    that the screen sees better than the best itself has not been beaten.
    """
    if best is None or best.left is None or is_significant(best.left, best.delta_log_likelihood):
        return True
    if may_be_of_the_kink(best, trial.candidate):
        return True
    names = [entry.candidate.name for entry in screen.entries]
    if not {best.candidate.name, trial.candidate.name} <= set(names):
        return True
    own, other = names.index(best.candidate.name), names.index(trial.candidate.name)
    if screen.entries[other].score > screen.entries[own].score:
        return True
    correlation = screen.correlation[own, other]
    is_shaped = any(p.estimate and p.role == "shape" for p in trial.candidate.effect.parameters)
    if is_shaped and best.explained < GATES.all_explained and correlation**2 >= GATES.min_alike_response:
        return True
    return bool((1.0 - correlation**2) * best.delta_log_likelihood < GATES.hopeless_log_likelihood)


def least_hope(leader: Proof | None, candidate: Candidate) -> float:
    """The log-likelihood below which the refit of another `candidate` is not pursued."""
    if leader is None or may_be_of_the_kink(leader, candidate):
        return -np.inf
    return leader.fit.log_likelihood - GATES.hopeless_log_likelihood


def says_less(leader: Proof | None, candidate: Candidate, fit: FitResult) -> bool:
    """Whether a law with more parameters than the leader ended less likely at the leader's place: a loop that
    closes within no length is dry friction, and takes long to be simulated."""
    if leader is None or leader.candidate.site != candidate.site:
        return False
    is_richer = len(candidate.estimated) > len(leader.candidate.estimated)
    return is_richer and fit.log_likelihood < leader.fit.log_likelihood


def ranked(proofs: Sequence[Proof]) -> tuple[Proof, ...]:
    """Best first. Accepted candidates that are rivals of the best (`rival_laws`) are not separable from it:
    of them, those come first that foresee unseen data clearly better, then the likeliest. Where a refused one
    is far more likely, none is the explanation."""
    kept = without_outrun(without_imitations(proofs))
    compared = _on_one_basis(without_hopeless(kept))
    order = sorted(compared, key=lambda p: (p.verdict == "rejected", -bic_beside(p)))
    accepted = [p for p in order if p.verdict == "supported"]
    if not accepted:
        return tuple(order)
    best = _simplest(accepted)
    instead = what_refuses_all(order, best)
    if instead:
        refused = (p if p.verdict == "rejected" else refuse(p, instead) for p in order)
        return tuple(sorted(refused, key=lambda p: -p.delta_bic))
    beside = _Beside.of(best, accepted, order)
    return tuple(sorted(map(beside.judged, order), key=partial(_place, best)))


@dataclass(frozen=True)
class _Beside:
    """How laws stand to the best one: `rivals` of it, and itself; the `same` equation, or another form of one
    finding; what says no more beside a constant load; the same effect at another place (`twins`); and what
    says as much with more parameters (`idle`)."""

    best: Proof
    rivals: Sequence[Proof]
    same: Sequence[Proof]
    forms: Sequence[Proof]
    beside_a_load: Sequence[Proof]
    twins: Sequence[Proof]
    idle: Sequence[Proof]

    @classmethod
    def of(cls, best: Proof, accepted: Sequence[Proof], order: Sequence[Proof]) -> _Beside:
        """How all in `order` stand to the `best` of those that are `accepted`."""
        others = [p for p in accepted if p is not best]
        same, _ = _parted(others, best, is_same_equation)
        close = [p for p in accepted if p not in same and may_be_instead(p, best)]
        forms, close = _parted(close, best, is_other_form)
        beside_a_load, close = _parted(close, best, is_same_beside_a_load)
        twins, close = _parted(close, best, is_twin)
        idle, close = _parted(close, best, is_idle)
        told = [*close, *forms, *beside_a_load, *twins]
        doubted = [p for p in order if p not in told and is_doubted(p, best)]
        return cls(best, [*close, *doubted], same, forms, beside_a_load, twins, idle)

    def judged(self, proof: Proof) -> Proof:
        """The proof with its verdict beside the best one."""
        if proof in self.rivals:
            return self._left_open(proof)
        return proof if proof.verdict == "rejected" else refuse(proof, self._why_not(proof))

    def _left_open(self, proof: Proof) -> Proof:
        """A rival, which is the answer where it is the only one."""
        others = tuple(p.candidate.label for p in self.rivals if p is not proof)
        alike, same = (self.twins, [*self.same, *self.forms]) if proof is self.best else ([], [])
        places = [p.candidate.site.name for p in alike if p.candidate.site.name not in proof.equivalent]
        return replace(
            proof,
            equivalent=(*proof.equivalent, *places),
            not_separable_from=others,
            verdict="not separable" if others else "supported",
            reason="",
            same_as=(*proof.same_as, *(p.candidate.label for p in same)),
        )

    def _why_not(self, proof: Proof) -> str:
        label = self.best.candidate.label
        if proof in self.twins:
            return f"the data do not tell it from the same effect at {self.best.candidate.site.name}"
        if proof in self.forms:
            return f"the data do not tell it from {label}"
        if proof in self.beside_a_load:
            return f"beside a constant load it says no more than {label}"
        if proof in self.idle:
            return f"{label} says as much with fewer parameters"
        if proof in self.same:
            return f"it is the same equation as {label}"
        worse = bic_beside(self.best) - bic_beside(proof)
        if worse < 0.0:
            return f"{label} says nearly as much with fewer parameters"
        return f"{label} explains the data better (BIC {worse:.0f})"


def _parted(
    laws: Sequence[Proof], best: Proof, is_such: Callable[[Proof, Proof], bool]
) -> tuple[list[Proof], list[Proof]]:
    """Those of the `laws`, but the `best`, that stand to it in a way, and all others."""
    found = [p for p in laws if p is not best and is_such(p, best)]
    return found, [p for p in laws if p not in found]


def _on_one_basis(proofs: Sequence[Proof]) -> list[Proof]:
    """Where a law is accepted for what its simulation gains, all that are accepted count by that: with an
    observer, much of the same law goes into the loads, and its gain is another one. An open law that its
    simulation shows more clearly than all of them is then accepted, too, whatever it leaves for the loads.

    All count for as many independent samples, the fewest of any. How many a law has goes with how long its
    errors last: one that leaves slow ones alone would gain less than one that leaves more of every kind."""
    if not any(p.is_by_use and p.verdict != "rejected" for p in proofs):
        return list(proofs)
    known = [p.in_use for p in proofs if _is_compared(p) and p.in_use.n_independent]
    fewest = min(used.n_independent for used in known), min(used.n_unseen for used in known)
    found = [_by_use(p, *fewest) if _is_compared(p) else p for p in proofs]
    pairs = list(zip(proofs, found, strict=True))
    least = GATES.same_bic + max(
        new.delta_bic for old, new in pairs if old.verdict != "rejected" and new.is_by_use
    )
    return [old if old.verdict == "rejected" and new.delta_bic <= least else new for old, new in pairs]


def _is_compared(proof: Proof) -> bool:
    """Whether a law counts by its simulation where laws do: one that is accepted, or open and shown by it."""
    return proof.verdict != "rejected" or (proof.is_open and proof.is_shown)


def _by_use(proof: Proof, n_independent: float, n_unseen: float) -> Proof:
    """The proof with the evidence of its simulation for that many independent samples; as it is where that
    is unknown."""
    if not proof.in_use.n_independent:
        return proof
    used = replace(proof.in_use.by_output, n_independent=n_independent, n_unseen=n_unseen)
    return replace(
        proof,
        delta_log_likelihood=used.gain,
        delta_bic=used.bic(proof.candidate.n_unknowns),
        verdict="supported",
        reason="",
        is_by_use=True,
    )


def _place(best: Proof, proof: Proof) -> tuple[bool, bool, float, int, float, float, float]:
    """What a proof is ranked by, smallest first. Of laws that foresee unseen data clearly better and alike,
    the one with the fewest parameters of any kind is first; of those whose simulation says as much, the one
    that takes more of the load. One of which no size is known comes behind the simple law that it might
    be."""
    is_same = is_vague(proof, best) and not is_far_nearer(proof, best)
    is_blurred = is_same and is_less_known(proof, best)
    ratio = 1.0 if proof.verdict == "rejected" or is_same else unseen_ratio(best, proof)
    n_parameters = len(proof.candidate.effect.parameters) if ratio < GATES.max_rival_error else 0
    ratio = round(min(ratio, GATES.max_rival_error), 2)
    is_as_likely = proof.is_by_use and proof.verdict != "rejected"
    step = round(bic_beside(proof) / GATES.same_bic) * GATES.same_bic if is_as_likely else bic_beside(proof)
    explained = proof.explained if is_as_likely else 0.0
    order = (ratio, n_parameters, -step, -explained, -bic_beside(proof))
    return proof.verdict == "rejected", is_blurred, *order


def best_accepted(proofs: Sequence[Proof]) -> Proof | None:
    """The first of `ranked` proofs that is accepted, be it separable from others or not; None where all are
    rejected."""
    return next((p for p in proofs if p.verdict != "rejected"), None)


def _plainest(same: Sequence[Proof]) -> Proof:
    """The one with the fewest parameters of any kind, then with the fewest connectors, since what runs over
    is lost as long as nothing tells where it goes, and then one that is linear: a loss of heat is radiation
    where that shows."""

    def n_parts(effect: Effect) -> tuple[int, int]:
        return len(effect.parameters), len(effect.connectors)

    fewest = min(n_parts(p.candidate.effect) for p in same)
    alike = [p for p in same if n_parts(p.candidate.effect) == fewest]
    if len({p.candidate.effect.class_name for p in alike}) == 1:
        return alike[0]
    return next((p for p in alike if is_linear_law(p.candidate.effect)), alike[0])


def _simplest(accepted: Sequence[Proof]) -> Proof:
    """The best by BIC, or one at the same place with fewer parameters that gains nearly as much: with much
    data, the way in which a law is rounded is significant, too (`is_of_the_kink`). Of laws that are the same
    on these data, the plainest."""
    same = [p for p in accepted if p is accepted[0] or is_same_equation(p, accepted[0])]
    best = _plainest(same)
    simpler = [
        p
        for p in accepted
        if is_same_beside_a_load(best, p)
        or is_of_the_kink(best, p)
        or (
            p.candidate.site == best.candidate.site
            and n_chosen(p) < n_chosen(best)
            and (
                p.delta_log_likelihood > GATES.min_simpler_gain * best.delta_log_likelihood
                or is_vague(best, p)
                or is_contradicted(best, p)
            )
        )
    ]
    return min(simpler, key=n_chosen, default=best)


def leader_of(proofs: Sequence[Proof]) -> Proof | None:
    """The most likely candidate that is supported."""
    supported = [p for p in proofs if p.verdict == "supported"]
    return max(supported, key=lambda p: p.fit.log_likelihood, default=None)


def is_settled(proofs: Sequence[Proof]) -> bool:
    """Whether the best candidate is accepted and leaves little that follows a variable."""
    best = best_accepted(proofs)
    if best is None or best.left is None:
        return False
    return not is_significant(best.left, best.delta_log_likelihood)


def most_likely(proofs: Sequence[Proof]) -> Proof | None:
    return max(
        (p for p in proofs if p.delta_bic > GATES.min_bic_gain), key=lambda p: p.delta_bic, default=None
    )


def best_start(proofs: Sequence[Proof]) -> Proof | None:
    """The candidate from which a richer law would start: the best accepted one, or the most likely of those
    that say too little."""
    return best_accepted(proofs) or most_likely(proofs)


def leaves_something(proof: Proof) -> bool:
    """Whether the rest of the load follows a variable a little more than by chance: a richer law may do."""
    return proof.left is None or proof.left.p_value < GATES.richer_level
