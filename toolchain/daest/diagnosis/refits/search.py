"""The search for one candidate: what all of them share, its end, and the judgement of the best end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

from daest.diagnosis.built_in.settled import FAILURES
from daest.diagnosis.built_in.trials import Prepared, moved, prepare
from daest.diagnosis.evidence.proof import Searched, proof_of, searched
from daest.diagnosis.evidence.stand import Stand
from daest.diagnosis.null_model.null_observer import NullObserver
from daest.diagnosis.screening.candidates import fed
from daest.diagnosis.screening.disturbance import SmoothedLoad
from daest.model.diagnosis import FreeForm, Proof

MOST_PLACES = 5  # that the sensors see alike, where a refit is tried again


@dataclass(frozen=True)
class Search:
    """What every refit of a round needs; the `leader` is the best supported candidate of earlier stages. A
    law is simulated over the records of `pieces`, where those of the stand are too long for that."""

    stand: Stand
    run: NullObserver
    load: SmoothedLoad | None
    form: FreeForm | None
    n_screened: int
    leader: Proof | None = None
    pieces: Stand | None = None

    def among_more(self, n_screened: int) -> Search:
        """The search over so many candidates besides."""
        return replace(self, n_screened=self.n_screened + n_screened)

    @property
    def stand_in_use(self) -> Stand:
        """The stand over whose records laws are simulated."""
        return self.stand if self.pieces is None else self.pieces


def end_of_search(search: Search, prepared: Prepared) -> Searched:
    stand = search.stand
    experiments = fed(stand.null.experiments, prepared.trial.candidate)
    return searched(stand.null, stand.baseline, prepared, experiments, search.leader)


def judged_end(search: Search, found: Searched) -> Proof:
    stand = search.stand
    return proof_of(
        stand.null,
        stand.baseline,
        found,
        fed(stand.validation, found.prepared.trial.candidate),
        search.run,
        search.load,
        search.n_screened,
        search.leader,
        search.form,
        stand.reference,
    )


def likeliest_judged(search: Search, ends: list[Searched], errors: list[Exception]) -> Proof | None:
    """The proof of the likeliest of some ends that can be judged; None where none can, which leaves none of
    them in `ends`."""
    while ends:
        best = max(ends, key=lambda end: end.gain)
        try:
            return judged_end(search, best)
        except FAILURES as error:
            errors.append(error)
            ends.remove(best)
    return None


def at_other_places(search: Search, prepared: Prepared) -> list[Callable[[], Prepared]]:
    """The candidate at the other places where the sensors would see it alike."""
    null, trial = search.stand.null, prepared.trial
    numbers = range(min(len(trial.alike), MOST_PLACES))
    return [partial(prepare, null.flat, null.estimated, moved(trial, number)) for number in numbers]


def as_prepared(prepared: Prepared) -> Prepared:
    return prepared
