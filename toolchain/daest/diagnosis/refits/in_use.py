"""A candidate by its simulation: its fit in open loop, at the place that the screen may not tell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial

from daest.diagnosis.built_in.settled import FAILURES
from daest.diagnosis.built_in.trials import GENTLE, Prepared, prepare
from daest.diagnosis.evidence.open_loop import ITERATIONS as IN_USE
from daest.diagnosis.evidence.open_loop import fitted_in_use, is_far_behind, rivals_in_use, speaks_for
from daest.diagnosis.evidence.pieces import told_of_whole
from daest.diagnosis.evidence.proof import (
    Reference,
    Searched,
    by_simulation,
    has_lost_its_way,
    simulated_at,
    used_by,
)
from daest.diagnosis.evidence.reasons import not_determined, too_wide
from daest.diagnosis.evidence.stand import Stand, quiet
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import grown
from daest.diagnosis.refits.search import (
    Search,
    as_prepared,
    at_other_places,
    end_of_search,
    likeliest_judged,
)
from daest.diagnosis.screening.candidates import fed
from daest.estimation.fitting.records import longest_duration
from daest.model.diagnosis import InUse, Proof
from daest.model.fit import FitResult

FIRST_IN_USE = 5  # iterations of a simulation's fit, after which it may be far behind the leader


def shown_in_use(
    search: Search,
    prepared: Prepared,
    beside: Proof,
    accepted: Proof | None = None,
    known: FitResult | None = None,
) -> Proof:
    """The proof of a candidate by its simulation; that `beside` the loads where a simulation does not show
    it. `accepted` is a law that does show there what the candidate may be, `known` the best simulation of the
    candidate at its own place, if it is.

    The screen tells places apart by what a law of hardly any size does there. A dead zone of finite width
    before a pump that cannot draw is not one behind the sensor: of the places that the screen sees alike,
    the one with the likeliest simulation is taken, and those that simulate as well are equivalent."""
    stand = search.stand_in_use
    if stand.reference is None or stand.reference.simulated is None:
        return beside
    found: list[tuple[Prepared, FitResult]] = [] if known is None else [(prepared, known)]
    for make in [*([] if found else [None]), *at_other_places(search, prepared)]:
        with suppress(*FAILURES):
            here = prepared if make is None else make()
            fit = _fitted_there(stand, stand.reference, here, found[:1])
            if fit is not None:
                found.append((here, fit))
    if not found:
        return beside
    most = max(fit.log_likelihood for _, fit in found)
    best, *others = [pair for pair in found if pair[1].log_likelihood >= most - GATES.same_fit]
    there, fit = best
    candidate = there.trial.candidate
    proof = beside if candidate.site == beside.candidate.site else _beside_loads(search, there)
    if proof is None:
        return beside
    null = replace(stand.null, experiments=fed(stand.null.experiments, candidate))
    validation = fed(stand.validation, candidate)
    shown = by_simulation(null, there, proof, fit, validation, stand.reference, search.n_screened, accepted)
    if shown.verdict == "rejected":
        return beside
    shown = replace(shown, equivalent=tuple(other.trial.candidate.site.name for other, _ in others))
    return shown if search.pieces is None else told_of_whole(search.stand, shown)


def with_simulation(stand: Stand, prepared: Prepared, proof: Proof) -> Proof:
    """The proof with what its simulation says at its estimates without loads, which may be fitted to
    predictions: those were taken since they simulate no worse."""
    if stand.reference is None or proof.final is None:
        return proof
    candidate = proof.candidate
    null = replace(stand.null, experiments=fed(stand.null.experiments, candidate))
    validation = fed(stand.validation, candidate)
    used = simulated_at(null, prepared, proof.final, validation, stand.reference)
    return replace(proof, in_use=used)


@dataclass(frozen=True)
class InOpenLoop:
    """The best simulation of a candidate over the records or pieces of them, and what that says of it: the
    model with `n_own` more parameters, of which the records determine one at least where `is_known`."""

    prepared: Prepared
    fit: FitResult
    used: InUse
    n_own: int
    is_known: bool

    @property
    def is_clear(self) -> bool:
        """Whether it takes most of the error of unseen data away, by more than chance."""
        return self.used.ratio < GATES.max_most_ratio and speaks_for(self.used, self.n_own)

    @property
    def is_near(self) -> bool:
        """Whether it pays for its parameters, and simulates unseen data clearly better."""
        is_better = self.bic > GATES.min_bic_gain and self.used.ratio < GATES.max_clear_ratio
        return self.is_known and is_better

    @property
    def bic(self) -> float:
        return self.used.bic(self.n_own)

    def rivals(self, accepted: Proof | None) -> bool:
        """Whether it says as much as a law that is accepted by its simulation, if there is one: which of both
        it is is no question of chance."""
        return accepted is not None and rivals_in_use(
            self.used, self.n_own, accepted.in_use, accepted.candidate.n_unknowns
        )


def tried_in_open_loop(search: Search, prepared: Prepared) -> InOpenLoop | None:
    """What the simulation over the records of the search says of a candidate; None where there is none, or a
    few iterations gain nothing that would pay for its parameters."""
    stand = search.stand_in_use
    if stand.reference is None:
        return None
    with quiet():
        first = _fitted_in_use(stand, stand.reference, prepared, iterations=FIRST_IN_USE)
        if first is None or _in_open_loop(stand, stand.reference, prepared, first).bic <= 0.0:
            return None
        fit = _fitted_in_use(stand, stand.reference, prepared) or first
        return _in_open_loop(stand, stand.reference, prepared, fit)


def _in_open_loop(stand: Stand, reference: Reference, prepared: Prepared, fit: FitResult) -> InOpenLoop:
    candidate = prepared.trial.candidate
    null = replace(stand.null, experiments=fed(stand.null.experiments, candidate))
    used = used_by(null, prepared, fit, fed(stand.validation, candidate), reference)
    is_known = not not_determined(candidate, fit, reference.fit, gain=used.gain)
    n_own = prepared.n_unknowns(null.estimated)
    return InOpenLoop(prepared, fit, used, n_own, is_known)


def proof_in_open_loop(
    search: Search, found: InOpenLoop, beside: Proof | None, accepted: Proof | None = None
) -> Proof | None:
    """The proof of a candidate by its simulation, where that is clear, or says as much as that of an
    `accepted` law; else that `beside` loads, which may not be known before, with what the simulation says.
    None where it cannot be refitted."""
    with quiet():
        beside = beside or _beside_loads(search, found.prepared)
        if beside is None:
            return None
        shown = beside
        if found.is_clear or found.rivals(accepted):
            shown = shown_in_use(search, found.prepared, beside, accepted, known=found.fit)
        if shown.verdict != "rejected":
            return shown
        if _is_too_wide(search.stand_in_use, found):
            return beside
        lasts = longest_duration(search.stand_in_use.null.experiments)
        refused = replace(beside, final=found.fit, in_use=replace(found.used, piece=lasts))
        return refused if search.pieces is None else told_of_whole(search.stand, refused)


def _is_too_wide(stand: Stand, found: InOpenLoop) -> bool:
    """Whether a law is play that is wider than its signal: that comes near by the starts of its follower, and
    is nothing to be told."""
    prepared, candidate = found.prepared, found.prepared.trial.candidate
    experiments = fed(stand.null.experiments, candidate)
    model = grown(stand.null, prepared.flat, prepared.reduced(), found.fit, experiments)
    return bool(too_wide(model, candidate, found.fit))


def _beside_loads(search: Search, prepared: Prepared) -> Proof | None:
    """The proof of a candidate beside the loads, from a gentle effect where the search loses its way; None
    where it cannot be refitted."""
    null = search.stand.null
    gentle = partial(prepare, null.flat, null.estimated, prepared.trial, share=GENTLE, sharper=1.0)
    ends: list[Searched] = []
    for start in (partial(as_prepared, prepared), gentle):
        with suppress(*FAILURES):
            ends.append(end_of_search(search, start()))
            if not has_lost_its_way(ends[-1]):
                break
    return likeliest_judged(search, ends, [])


def _fitted_there(
    stand: Stand,
    reference: Reference,
    here: Prepared,
    first: Sequence[tuple[Prepared, FitResult]],
) -> FitResult | None:
    """The best simulation of a law at one of its places: from where it ends at the `first` one, if there is
    one and it does the same here; else from its own starts."""
    if first:
        with suppress(*FAILURES):
            again = _fitted_in_use(stand, reference, here, _as_begun(first[0], here))
            if again and abs(again.log_likelihood - first[0][1].log_likelihood) < GATES.same_fit:
                return again
    return _fitted_in_use(stand, reference, here)


def _as_begun(first: tuple[Prepared, FitResult], here: Prepared) -> dict[str, float]:
    """The parameters of a law at another place, at the values that simulate best at the `first` one."""
    own, other = (one.trial.candidate.name for one in (here, first[0]))
    names = {name: name.replace(f"{own}.", f"{other}.", 1) for name in here.names}
    return {name: first[1].theta[before] for name, before in names.items() if before in first[1].theta}


def is_hopeless_in_use(search: Search, prepared: Prepared) -> bool:
    """Whether a few iterations leave the simulation of a candidate far behind that of the leader, of what it
    is fitted to and of unseen data alike: the rest of its search would be in vain."""
    stand, leader = search.stand, search.leader
    if leader is None or leader.final is None or leader.adds_up or stand.reference is None:
        return False
    try:
        first = _fitted_in_use(stand, stand.reference, prepared, iterations=FIRST_IN_USE)
    except FAILURES:
        return False
    return first is not None and is_far_behind(first.simulated, leader.final.simulated)


def _fitted_in_use(
    stand: Stand,
    reference: Reference,
    prepared: Prepared,
    begun: Mapping[str, float] | None = None,
    iterations: int = IN_USE,
) -> FitResult | None:
    """The best simulation of a candidate, or the one from where it has `begun`, if that is known; None where
    there is none."""
    candidate = prepared.trial.candidate
    return fitted_in_use(
        stand.null,
        prepared.flat,
        prepared.names,
        [f"{candidate.name}.{p.name}" for p in candidate.effect.sizes],
        reference.start_in_use,
        fed(stand.null.experiments, candidate),
        fed(stand.validation, candidate),
        begun,
        iterations,
    )
