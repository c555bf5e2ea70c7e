"""What a verdict rests on and consists of, and what its sentences share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from daest.diagnosis.gates import GATES
from daest.diagnosis.recordings.recorded_late import EarlierInputs
from daest.model.diagnosis import (
    Proof,
    Screen,
    Unproved,
    VerdictName,
)
from daest.model.fit import FitResult, error_ratios

WIDER_BAND = (
    "Excite the machine over a wider band of frequencies, and measure another quantity between input and "
    "output."
)
AGAIN = "Repeat the same experiment: what comes back in the same way belongs to the machine."
LONGER = (
    "Record longer and with larger amplitudes: the effect is small beside the noise and the loads of this "
    "record."
)
SEVERAL = (
    "More than one effect may be missing, each in the way of the other: put in what is known to be there "
    "(daest extend), and diagnose again. Else record longer, and with larger amplitudes."
)
OTHER_AMPLITUDES = "Excite the inputs at other amplitudes and speeds, where these laws differ."
FROM_ELSEWHERE = {  # what to do instead where the model has no input
    WIDER_BAND: "Begin from other states, and measure another quantity besides: no input drives the model.",
    OTHER_AMPLITUDES: "Begin from other states, closer to rest and further from it, where these laws differ.",
}


class Rest(Protocol):
    """What is left where no candidate is accepted, as the null hypothesis of a diagnosis tells it."""

    def is_explained(self, evidence: Evidence) -> bool:
        """Whether the null hypothesis explains the data, so that nothing is missing."""

    def verdict(self, evidence: Evidence) -> Decided:
        """The verdict where it does not."""


@dataclass(frozen=True)
class Evidence:
    """All that the verdict rests on. `fitted` are values of an earlier fit, `still` tells why unseen data
    confirm nothing (`reasons.unmoved`)."""

    baseline: FitResult
    screen: Screen
    proofs: tuple[Proof, ...]
    fitted: Mapping[str, float]
    rest: Rest
    told: FitResult | None = None  # of the model as it is, without coloured loads
    unproved: tuple[Unproved, ...] = ()
    is_closed: bool = False  # nothing can be put, or measured, between the parts of the model
    still: str = ""
    earlier: EarlierInputs = field(default_factory=EarlierInputs)
    clock: str = "s"  # what the model counts time in


@dataclass(frozen=True)
class Decided:
    """`is_by_colour`: that prediction errors are correlated in time is all that the verdict rests on.
    `is_of_starts`: that loads begin with the recordings is.
    `is_dynamic`: what is missing is a state, and no curve over any variable."""

    name: VerdictName
    message: str
    next_experiment: str = ""
    proofs: tuple[Proof, ...] = ()
    is_by_colour: bool = False
    is_of_starts: bool = False
    is_dynamic: bool = False


def reasons_told(near: Sequence[Proof]) -> str:
    """Why the first of the candidates that come near are not accepted."""
    return "; ".join(f"{p.candidate.label}: {p.reason}" for p in near[:2])


def foreseen_by(evidence: Evidence, named: Proof | None, limit: float = GATES.max_told_ratio) -> str:
    """The rejected candidates other than `named` whose error on unseen data is below `limit` times that of
    the model as it is, those about as good as the best of them, as a sentence; empty where there is none. An
    unknown load that is free enough takes the likelihood from a law that is right; a simulation has no such
    load. None that the data do not show: it stands for any other that does the same."""
    others = [p for p in evidence.proofs if p is not named and p.verdict == "rejected" and p.is_known]
    ratios = [error_ratio(evidence, proof) for proof in others]
    best = min(ratios, default=np.inf)
    if not best < limit:
        return ""
    found = [
        proof for proof, ratio in zip(others, ratios, strict=True) if ratio <= GATES.same_unseen_ratio * best
    ]
    labels = tuple(dict.fromkeys(p.candidate.label for p in found))
    names, verb = listed(labels), "foresees" if len(labels) == 1 else "foresee"
    return (
        f" {names} {verb} the validation data far better (error times {best:.2g}) and may be what acts "
        f"there, although {found[0].reason}."
    )


def error_ratio(evidence: Evidence, proof: Proof) -> float:
    """Error of the candidate on unseen data relative to that of the model as it is, of the output where it is
    largest; inf where it is unknown."""
    before, after = told_fits(evidence, proof)
    return max(error_ratios(before.simulated, after.simulated), default=np.inf)


def told_fits(evidence: Evidence, proof: Proof) -> tuple[FitResult, FitResult]:
    """The fits without and with the effect that are told, as in the table: without coloured loads where they
    are known so."""
    return evidence.told or evidence.baseline, proof.final or proof.fit


def listed(names: tuple[str, ...], most: int = 4) -> str:
    shown = list(names[:most])
    rest = len(names) - len(shown)
    if rest:
        shown.append(f"{rest} more")
    return shown[0] if len(shown) == 1 else ", ".join(shown[:-1]) + " and " + shown[-1]
