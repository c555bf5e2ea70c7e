"""The parts of a law that is a sum of others, each with a size of its own.

Dry friction in one direction is dry friction in both and a constant load of half its size. Where both act,
each as large as it is, the sum is the one law that comes near, and takes their place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from daest.diagnosis.built_in.settled import FAILURES
from daest.diagnosis.evidence.proof import bic_gain
from daest.diagnosis.evidence.reasons import told_value
from daest.diagnosis.evidence.stand import quiet
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import Null, refitted
from daest.model.diagnosis import Candidate, Proof
from daest.model.effects import Effect
from daest.model.fit import FitResult
from daest.model.flat import FlatModel
from daest.modelica.effects.attach import attach
from daest.systems.reduction.reduce import reduce_index

HALF = 0.5  # of the size of a sum, from which its parts are begun


@dataclass(frozen=True)
class Parts:
    """The laws beside each other of which another one is the sum, as they were refitted: `told` with their
    sizes, and by how much BIC they gain more than the sum."""

    labels: tuple[str, ...]
    told: str
    more: float
    are_known: bool  # every size by itself

    @property
    def puts_aside(self) -> bool:
        """Whether the sum stands for its parts: they are clearly likelier, and none of them is nothing."""
        return self.are_known and self.more >= GATES.min_bic_gain

    @property
    def says_as_much(self) -> bool:
        """Whether the parts and their sum are one answer: likelier than by chance, and not clearly."""
        return self.are_known and 0.0 < self.more < GATES.min_bic_gain

    @property
    def text(self) -> str:
        return f"{self.told}, of which it is the sum, beside each other and with sizes of their own"


def parts_of(null: Null, law: Proof, library: Sequence[Effect]) -> Parts | None:
    """The parts of an accepted `law`, refitted beside each other and the unknown loads at its place; None
    where it is no sum, is accepted for what its simulation gains, or they cannot be refitted."""
    own = law.candidate.effect
    here = {e.name: e for e in library if e.domain == own.domain}
    effects = [here[name] for name in own.sum_of if name in here]
    if not effects or len(effects) != len(own.sum_of) or law.is_by_use:
        return None
    parts = [
        replace(law.candidate, effect=e, name=f"{law.candidate.name}_part{i}", shape={})
        for i, e in enumerate(effects)
    ]
    found = [fit for sign in (1.0, -1.0) if (fit := _fitted(null, law, parts, sign)) is not None]
    best = max(found, key=lambda fit: fit.log_likelihood, default=None)
    if best is None:
        return None
    n_more = sum(len(part.estimated) for part in parts) - len(law.candidate.estimated)
    more = bic_gain(best.log_likelihood - law.fit.log_likelihood, n_more, null)
    sizes = [p for p in best.parameters if any(p.name in part.estimated for part in parts)]
    are_known = all(abs(p.value) >= GATES.min_significance * (p.std_error or float("inf")) for p in sizes)
    told = [
        f"{part.label} ({', '.join(told_value(p) for p in sizes if p.name in part.estimated)})"
        for part in parts
    ]
    return Parts(tuple(part.label for part in parts), " and ".join(told), more, are_known)


def _fitted(null: Null, law: Proof, parts: Sequence[Candidate], sign: float) -> FitResult | None:
    """The fit of the model with all `parts`, from half of the size of their sum, those that may be negative
    with that `sign`, and with kinks as sharp as those of the sum; None where there is none."""
    theta, own = law.fit.theta, law.candidate
    kinks = {
        p.name: theta[f"{own.name}.{p.name}"]
        for p in own.effect.parameters
        if p.role == "sharpness" and f"{own.name}.{p.name}" in theta
    }
    names: tuple[str, ...] = null.estimated
    try:
        flat: FlatModel = null.flat.with_theta({name: theta[name] for name in null.estimated})
        for part in parts:
            begun = {
                p.name: HALF * law.sizes[0] * (sign if p.min is None else 1.0) for p in part.effect.sizes
            }
            given = {p.name for p in part.effect.parameters}
            values = {**{name: value for name, value in kinks.items() if name in given}, **begun}
            flat = attach(flat, part.effect, part.site, part.name, values, part.inputs, part.input_units)
            names = (*names, *part.estimated)
        with quiet():
            return refitted(flat, reduce_index(flat), names, replace(null, fit=law.fit)).fit
    except FAILURES:
        return None
