"""Hypotheses of which effects are missing, step by step, and which of two is the better one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from daest.diagnosis.built_in.certainty import certainty_of
from daest.diagnosis.evidence.stand import Stand
from daest.diagnosis.evidence.unseen import is_better, is_likelier
from daest.diagnosis.gates import GATES
from daest.diagnosis.options import DiagnoseOptions, Progress
from daest.estimation.fitting.records import n_observed
from daest.model.diagnosis import Diagnosis, Proof, Step
from daest.model.effects import Effect
from daest.model.fit import FitResult, error_ratios

MOST_PATHS = 2  # hypotheses that are pursued side by side
OUT_OF_TIME = "The time was up"


@dataclass(frozen=True)
class Hypothesis:
    """A hypothesis: the model with the effects of `steps`. `last` and `reason` are those of its end."""

    stand: Stand
    steps: tuple[Step, ...]
    last: Diagnosis | None = None
    reason: str = ""

    @property
    def bic(self) -> float:
        """Up to a constant that all paths share."""
        fit = self.stand.baseline
        n = n_observed(self.stand.null.experiments)
        return float(len(fit.parameters) * np.log(n) - 2.0 * fit.log_likelihood)

    def ended(self, last: Diagnosis, reason: str) -> Hypothesis:
        return replace(self, last=last, reason=reason)


@dataclass(frozen=True)
class Task:
    """What the rounds of all paths share; `root` is the model as it is, with the limits of its sensors, and
    `first` the steps up to it."""

    root: Stand
    first: tuple[Step, ...]
    library: Sequence[Effect]
    options: DiagnoseOptions
    most_effects: int
    progress: Progress


def label_of(step: Step) -> str:
    return "" if step.proof is None else step.proof.candidate.label


def labels_of(path: Hypothesis) -> tuple[str, ...]:
    return tuple(label_of(step) for step in path.steps if step.proof is not None)


def remark_on(proof: Proof) -> str:
    inside = [proof.inside] if proof.inside and proof.inside not in proof.not_separable_from else []
    others, same = ", ".join([*proof.not_separable_from, *inside]), ", ".join(proof.same_as)
    said = f"not separable from {others}" if others else "supported"
    return f"{said}, and the same equation as {same}" if same else said


def is_accepted(path: Hypothesis) -> bool:
    last = path.steps[-1].proof
    return last is not None and last.verdict != "rejected"


def doubtful_steps(steps: Sequence[Step]) -> list[int]:
    """Earlier steps whose effects have lost the certainty of all their sizes."""
    return uncertain_steps(steps[:-1], steps[-1].fit)


def uncertain_steps(steps: Sequence[Step], fit: FitResult) -> list[int]:
    """Steps whose effects have no size that is certain in the `fit`, alone or beside a parameter."""
    sizes = {p.name: p for p in fit.parameters}
    found = []
    for number, step in enumerate(steps):
        if step.proof is None or step.diagnosis is None:
            continue
        candidate = step.proof.candidate
        now = [(p, sizes.get(f"{candidate.name}.{p.name}")) for p in candidate.effect.sizes]
        before, gain = steps[number - 1].fit, step.proof.delta_log_likelihood
        if all(
            one is None or certainty_of(candidate, fit, one, p, before, gain) < GATES.still_needed
            for p, one in now
        ):
            found.append(number)
    return found


def leading(paths: Sequence[Hypothesis]) -> list[Hypothesis]:
    """The paths that may still turn out to be the best, the best first; at most MOST_PATHS."""
    best = paths[0]
    for path in paths[1:]:
        best = path if _is_ahead(path, best) else best
    others = [path for path in paths if path is not best and not _is_ahead(best, path)]
    others.sort(key=lambda path: path.bic)
    return [best, *others[: MOST_PATHS - 1]]


def _is_ahead(one: Hypothesis, other: Hypothesis) -> bool:
    """Whether a hypothesis is clearly better: by the errors of its simulation of unseen data, or, where these
    do not differ clearly, by its likelihood; not by what it owes to an effect of whose size nothing is known
    any more. One of fewer effects need not be clearly likelier: three laws do what two others do."""
    if error_ratio(other, one) < GATES.max_rival_error:
        return True
    if error_ratio(one, other) < GATES.max_rival_error:
        return False
    least = 0.0 if len(one.steps) < len(other.steps) else GATES.min_bic_gain
    return one.bic < other.bic - least and not doubtful_steps(one.steps)


def simulates_worse(path: Hypothesis, other: Hypothesis) -> bool:
    """Whether the other model simulates unseen data worse."""
    return error_ratio(path, other) > 1.0 / GATES.max_round_ratio


def error_ratio(before: Hypothesis, after: Hypothesis) -> float:
    """Errors on unseen data of the second model relative to those of the first; 1 where the whole simulation
    is dead reckoning, or unknown."""
    reference = before.stand.reference
    if reference is not None and reference.adds_up:
        return 1.0
    return _together(error_ratios(before.stand.told.simulated, after.stand.told.simulated))


def _together(ratios: Sequence[float]) -> float:
    """The rms of ratios of errors; 1 where none is known."""
    return float(np.sqrt(np.mean(np.square(ratios)))) if ratios else 1.0


def helps(before: FitResult, best: Proof) -> bool:
    """Whether unseen data are foreseen better at some horizon or likelier, or the simulation error on
    validation data falls for some output and rises for none by as much, or falls clearly for all together:
    beside a second effect that is still missing, one of them may rise by a few per cent, not by a tenth."""
    if "validation" not in before.simulated or "validation" not in best.told.simulated:
        return True
    ratios = error_ratios(before.simulated, best.told.simulated)
    falls = bool(ratios) and min(ratios) < GATES.max_round_ratio and max(ratios) < 1.0 / GATES.max_round_ratio
    grows_little = max(ratios, default=0.0) <= 1.0 / GATES.max_clear_ratio
    falls = falls or (_together(ratios) <= GATES.max_clear_ratio and grows_little)
    return falls or any(is_better(one) for one in best.ahead) or is_likelier(best.confirmed)
