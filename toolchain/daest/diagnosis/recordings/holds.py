"""The hold of the inputs that the other one may be better than: between samples, or on straight lines."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from daest.diagnosis.evidence.free_starts import free_runs, misfit
from daest.diagnosis.evidence.ranking import best_accepted, best_start
from daest.diagnosis.evidence.stand import Stand
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import Null, open_hold, open_inputs, refitted, with_other_hold
from daest.diagnosis.options import DiagnoseOptions
from daest.diagnosis.screening.candidates import fed
from daest.errors import DaestError
from daest.estimation.linear.hold_search import with_turned
from daest.model.diagnosis import Diagnosis, Proof
from daest.model.flat import with_equations
from daest.model.holds import FOH, SMOOTH, Hold, hold_text
from daest.systems.reduction.reduce import reduce_index

AGAIN = "with the effect, {} after all: once more"
BACK = "that says less: on as if {}"
IN_VAIN = "nothing was accepted: once more as if {}"


class HeldOtherwiseError(Exception):
    """With the best of the first refits, `proofs`, the inputs were held as `hold` has it: the others would be
    refitted in vain."""

    def __init__(self, hold: Hold, proofs: Sequence[Proof]) -> None:
        super().__init__(hold_text(hold))
        self.hold, self.proofs = hold, tuple(proofs)


@dataclass(frozen=True)
class Holds:
    """Asks candidates for the other hold, each once: `known` are the answers, by the name of the candidate
    and its log-likelihood."""

    stand: Stand
    options: DiagnoseOptions
    known: dict[tuple[tuple[str, float], ...], Hold | None] = field(default_factory=dict)

    def better(self, proofs: Sequence[Proof]) -> Hold | None:
        """As `better_hold`."""
        key = tuple((p.candidate.name, p.fit.log_likelihood) for p in _asked(proofs))
        if key not in self.known:
            self.known[key] = better_hold(self.stand, proofs)
        return self.known[key]

    def watched(self, proofs: Sequence[Proof]) -> None:
        """Raises HeldOtherwiseError where the other hold is the better one, and there is time for it."""
        hold = None if self.options.is_over else self.better(proofs)
        if hold is not None:
            raise HeldOtherwiseError(hold, proofs)


def better_hold(stand: Stand, proofs: Sequence[Proof]) -> Hold | None:
    """The other hold, where one of the candidates that are asked fits better with it."""
    asked = [(p, p.fit.log_likelihood) for p in _asked(proofs)]
    asked += [(p, max(asked[0][1], p.fit.log_likelihood)) for p in _runner_up(proofs)]
    return next((hold for p, ll in asked if (hold := _better_hold_of(stand.null, p, ll)) is not None), None)


def _asked(proofs: Sequence[Proof]) -> list[Proof]:
    """The best accepted candidate, or else the most likely, which unseen data may refuse for nothing but the
    wrong hold; and a likelier lag or delay that is refused for what is dynamic beside it: half a sample of
    delay at the inputs is."""
    best = best_start(proofs)
    if best is None:
        return []
    likelier = [p for p in proofs if p.comes_near and p.fit.log_likelihood > best.fit.log_likelihood]
    return [best, *sorted(likelier, key=lambda p: -p.fit.log_likelihood)[:1]]


def _runner_up(proofs: Sequence[Proof]) -> list[Proof]:
    """The most likely candidate after the best, if that is accepted by its simulation alone, whose evidence
    is that of few samples: of laws that are much alike it prefers the one that bends to the hold as it is, as
    a share of an input in an output does."""
    best = best_accepted(proofs)
    if best is None or not best.is_by_use:
        return []
    others = [p for p in proofs if p is not best and not p.comes_near]
    return sorted(others, key=lambda p: -p.fit.log_likelihood)[:1]


def _better_hold_of(null: Null, asked: Proof, before: float) -> Hold | None:
    """Another hold, where the recordings are likelier with it beside the law of a proof than the
    log-likelihood `before`."""
    names = tuple(p.name for p in asked.fit.parameters)
    flat = with_equations(asked.flat, "a refit")
    explicit = reduce_index(flat)
    least = before + GATES.min_hold_gain
    found: dict[Hold, float] = {}
    for other in _otherwise(null, asked):
        other = replace(other, experiments=fed(other.experiments, asked.candidate))
        with suppress(DaestError):
            hopeless = asked.fit.log_likelihood - GATES.hopeless_log_likelihood
            fit = refitted(flat, explicit, names, other, hopeless=hopeless).fit
            found[other.recorded_hold or other.hold] = fit.log_likelihood
    best = max(found, key=lambda hold: found[hold], default=None)
    return best if best is not None and found[best] > least else None


def _otherwise(null: Null, asked: Proof) -> Iterator[Null]:
    """The null with the inputs held otherwise, where that is open beside the law of a proof: with the other
    hold, and where something dynamic is left of a lag, with that of one input turned. That of each was told
    without the lag, which half a sample of delay at one of them is a part of."""
    other = open_hold(null, asked.delta_log_likelihood)
    if other is not None:
        yield with_other_hold(null)
    names = open_inputs(null, asked.delta_log_likelihood) if asked.comes_near else ()
    for hold in (with_turned(null.hold, name, names) for name in names):
        if hold != other:
            yield replace(null, hold=hold, recorded_hold=hold)


def unsettled_hold(stand: Stand, found: Diagnosis) -> Hold | None:
    """The other hold, where something is missing, no candidate was accepted, and the data have not clearly
    refused it: with the wrong hold half a sample of delay is left, and the right law is refused for that. Not
    so between straight lines and smooth curves, or where a load was learned that keeps its hold."""
    if {stand.null.hold, stand.null.other_hold} == {FOH, SMOOTH}:
        return None
    learned = found.learned
    if learned is not None and learned.keeps_hold and not learned.against:
        return None
    hold = open_hold(stand.null) if is_unsettled(found) else None
    return None if hold is None or are_alike(stand.null) else hold


def are_alike(null: Null) -> bool:
    """Whether the model simulates the experiments alike with either hold of the inputs, loads at rest and
    initial states free, so that no law makes one of them likelier: an input that changes once, or slowly, is
    the same on straight lines as held. The noise of the sensors is the measure."""
    runs = free_runs(null, null.experiments)
    if runs is None:
        return False
    other = with_other_hold(null)
    simulated = tuple(
        replace(one, outputs=np.where(np.isnan(one.outputs), np.nan, run.outputs))
        for one, run in zip(other.experiments, runs, strict=True)
    )
    apart = misfit(other, simulated, null.starting_std)
    return apart is not None and apart / 2.0 < GATES.min_hold_gain


def is_unsettled(found: Diagnosis) -> bool:
    """Whether something is missing, and no candidate was accepted."""
    return best_accepted(found.proofs) is None and found.verdict not in ("nothing missing", "parameters off")


def says_more(proofs: Sequence[Proof], first: Sequence[Proof], stand: Stand) -> bool:
    """Whether a candidate was accepted that fits better than the model as it is with the hold of `stand`, and
    than those of the `first` proofs, with that hold, of which nobody can tell what they are but something
    dynamic."""
    best = best_accepted(proofs)
    dynamic = [p.fit.log_likelihood for p in first if p.is_any_dynamics]
    least = max([stand.baseline.log_likelihood, *dynamic]) + GATES.min_hold_gain
    return best is not None and best.fit.log_likelihood > least


def says_as_much(proofs: Sequence[Proof], first: Sequence[Proof]) -> bool:
    """Whether an accepted candidate is at least as likely as the one of the `first` proofs, with whose law
    the other hold looked better: in a search of its own that hold may have no use for the law."""
    before, best = best_accepted(first), best_accepted(proofs)
    if before is None or best is None:
        return before is None
    return best.fit.log_likelihood >= before.fit.log_likelihood
