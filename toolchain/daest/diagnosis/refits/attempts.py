"""The attempts at one candidate: from the screen, at places that look alike, gently, by shooting."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np

from daest.diagnosis.built_in.settled import FAILURES
from daest.diagnosis.built_in.trials import (
    GENTLE,
    Prepared,
    at_full_size,
    from_simulation,
    has_kinks,
    prepare,
    started_at,
)
from daest.diagnosis.evidence.proof import (
    Searched,
    has_lost_its_way,
    is_below_null,
    may_be_likelier,
    shortened,
)
from daest.diagnosis.evidence.ranking import least_hope, says_less
from daest.diagnosis.evidence.reasons import is_place, reach_of
from daest.diagnosis.evidence.stand import quiet
from daest.diagnosis.gates import GATES
from daest.diagnosis.refits.in_use import is_hopeless_in_use, shown_in_use
from daest.diagnosis.refits.search import (
    Search,
    as_prepared,
    at_other_places,
    end_of_search,
    judged_end,
    likeliest_judged,
)
from daest.diagnosis.screening.candidates import fed, scaled_shapes
from daest.estimation.identify import identify
from daest.model.diagnosis import Proof
from daest.model.fit import IdentifyOptions

BLUNTER = 3.0  # a kink whose searches have all lost their way is rounded over so much more than in the screen
BACK = 0.5  # of what a variable reaches, to which a place beyond that is put back
ITERATIONS = 15  # of the simulation's fit from which one is tried again


def proof_by_attempts(search: Search, prepared: Prepared) -> Proof:
    """The proof of a candidate. Where its refit fails, it is tried again at places that the sensors do not
    tell from its own, unless it only loses its way, which it would there, too; then from a small and gentle
    effect, from that beside the null as it was refitted, and with blunter kinks; one that is `by_shooting`,
    from a simulation's fit alone. One that replaces a sensor is tried at its full size first. Of several ends
    the likeliest is judged. Raises the error of the first attempt."""
    errors: list[Exception] = []
    with quiet():
        for ends in _tried(search, prepared, errors):
            best = likeliest_judged(search, ends, errors)
            if best is None:
                continue
            best = _found_again(search, prepared, best)
            if prepared.trial.is_seen_in_use and best.verdict == "rejected":
                says_no_more = says_less(search.leader, best.candidate, best.fit)
                is_hopeless = says_no_more or is_hopeless_in_use(search, prepared)
                return best if is_hopeless else shown_in_use(search, prepared, best)
            return best
    raise errors[0]


def found_somehow(search: Search, prepared: Prepared) -> Proof:
    """The proof of a candidate, by shooting where a search from the screen does not find it. Raises the error
    of the first attempt."""
    proof, error = None, None
    try:
        proof = proof_by_attempts(search, prepared)
    except FAILURES as failure:
        error = failure
    if proof is not None and not is_below_null(proof):
        return proof
    with suppress(*FAILURES):
        again = proof_by_attempts(search, replace(prepared, by_shooting=True))
        proof = again if proof is None else max(proof, again, key=lambda p: p.delta_log_likelihood)
    if proof is None:
        assert error is not None
        raise error
    return proof


def _tried(search: Search, prepared: Prepared, errors: list[Exception]) -> Iterator[list[Searched]]:
    """The ends of the attempts so far, whenever one of them has not lost its way, and at last; with the
    `errors` of those that failed."""
    ends: list[Searched] = []
    at_full = () if prepared.by_shooting else at_full_size(search.stand.null, prepared)
    elsewhere = at_other_places(search, prepared)
    for attempt in (*at_full, *_attempts(search, prepared, elsewhere)):
        if ends and attempt in elsewhere:
            continue
        try:
            end = end_of_search(search, attempt())
        except FAILURES as error:
            errors.append(error)
            continue
        ends.append(end)
        with suppress(*FAILURES):
            ends += [end_of_search(search, again) for again in _back_within_reach(search, end)]
        if attempt not in at_full and not has_lost_its_way(end, prepared.simulation):
            yield ends
    yield ends


def _back_within_reach(search: Search, end: Searched) -> list[Prepared]:
    """The candidate from where its search has `end`ed, with the places along a variable that have gone beyond
    all that this reaches, as one of two stops, put back to half of the reach; none where none has gone there,
    or the end is hopeless. Beyond the reach a likelihood is flat: a search that has stepped over its end does
    not come back."""
    candidate, fit = end.prepared.trial.candidate, end.refit.fit
    back = {}
    for p in filter(is_place, scaled_shapes(candidate)):
        name, reach = f"{candidate.name}.{p.name}", reach_of(candidate, p)
        if name in end.prepared.names and 0.0 < GATES.max_place * reach < abs(fit.theta[name]):
            back[name] = float(np.copysign(BACK * reach, p.grid[0]))
    if not back or fit.log_likelihood < least_hope(search.leader, candidate):
        return []
    values = {name: fit.theta[name] for name in end.prepared.names} | back
    return [replace(started_at(end.prepared, values), simulation=None)]


def _found_again(search: Search, prepared: Prepared, best: Proof) -> Proof:
    """The proof, or that from its estimates without loads, where it has lost a parameter: the one that makes
    the recordings and the unseen data likelier together."""
    stand, again = search.stand, from_simulation(prepared, best)
    if again is None:
        return best
    try:
        end = end_of_search(search, again)
        if end.refit.fit.log_likelihood < least_hope(search.leader, again.trial.candidate):
            return best  # it would be judged in brief
        unseen = fed(stand.validation, prepared.trial.candidate)
        if not may_be_likelier(stand.null, end, best, unseen, stand.reference):
            return best
        proof = judged_end(search, end)
    except FAILURES:
        return best
    return max(best, proof, key=lambda p: p.delta_log_likelihood + p.confirmed.gain)


def _attempts(
    search: Search, prepared: Prepared, elsewhere: Sequence[Callable[[], Prepared]]
) -> Iterator[Callable[[], Prepared]]:
    if prepared.by_shooting:
        yield partial(_by_shooting, search, prepared)
        return
    if prepared.simulation is not None:
        # Its loads may be as large as those of the null, or hardly there.
        starts = (replace(prepared, simulation=None), prepared)
        needs_none = prepared.simulation.log_likelihood > search.stand.baseline.log_likelihood
        for start in reversed(starts) if needs_none else starts:
            yield partial(as_prepared, start)
        yield from _small_ones(search, prepared)
        return
    yield partial(as_prepared, prepared)
    if prepared.similar is not None:
        return
    yield from elsewhere
    yield from _small_ones(search, prepared)


def _small_ones(search: Search, prepared: Prepared) -> Iterator[Callable[[], Prepared]]:
    """Makers of the candidate as a small and gentle effect, to which the null is near beside its loads: from
    the null, from that as it was refitted, and with its kinks rounded more widely than in the screen.

    The gains of the filter are those of one average linearisation. Across a sharp kink that is an average of
    two machines, one that sticks and one that slips, and right for neither: the likelihood falls as soon as
    there is any of the law, however true it is, and every search ends below the null. A blunt one has gains
    that suit it; how sharp it is may be fitted once the law is found."""
    null, trial = search.stand.null, prepared.trial
    small = partial(prepare, null.flat, null.estimated, trial, share=GENTLE)
    yield partial(small, sharper=1.0)
    yield partial(_beside_refit, search, prepared)
    if has_kinks(trial.candidate):
        yield partial(small, sharper=BLUNTER)


def _beside_refit(search: Search, prepared: Prepared) -> Prepared:
    """The candidate as a gentle effect where the refit of the null has ended: a law that contains the null
    need not end below it, but does where its search, from where that refit has started, stops on the way."""
    null, baseline = search.stand.null, search.stand.baseline
    flat = null.flat.with_theta(baseline.theta)
    gentle = prepare(flat, null.estimated, prepared.trial, share=GENTLE, sharper=1.0)
    return replace(gentle, refit=baseline)


def _by_shooting(search: Search, prepared: Prepared) -> Prepared:
    """The candidate started from the best simulation, of long recordings from that of their first parts.
    Raises what `identify` raises."""
    null = search.stand.null
    quick = null.shortest_times
    options = IdentifyOptions(
        method="oe",
        estimate=prepared.names,
        fix=quick,
        hold=null.hold,
        max_iterations=ITERATIONS,
        second_look=False,  # the refit from there looks for itself
    )
    experiments = shortened(fed(null.experiments, prepared.trial.candidate))
    fit = identify(prepared.flat, experiments, options)
    values = {name: fit.theta[name] for name in prepared.names}
    return replace(prepared, flat=prepared.flat.with_theta(values), explicit=None)
