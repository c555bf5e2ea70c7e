"""Values that the model holds, of which another one would say what an effect says.

Resistances, masses and gains that were looked up are off, and an effect that does the same as another value
would stand for that: the leakage of a capacitor for the resistance of a coil. The innovations tell what such
a value would do to them, as they do of the size of an effect; the one that shows most is estimated, and
judged on the terms of a refitted effect.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from daest.data.template import toml_key
from daest.diagnosis.answers.decided import listed
from daest.diagnosis.built_in.settled import FAILURES
from daest.diagnosis.evidence.noise_level import is_at_noise
from daest.diagnosis.evidence.proof import bic_gain
from daest.diagnosis.evidence.reasons import told_number
from daest.diagnosis.evidence.stand import Stand, reference_of
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import Null, refit
from daest.diagnosis.null_model.null_observer import NullObserver, run_null
from daest.diagnosis.screening.candidates import with_law
from daest.diagnosis.screening.scores import value_scores
from daest.model.diagnosis import Proof
from daest.model.fit import FitResult, FittedParameter, error_ratios
from daest.model.parts import Parameter
from daest.quantities import with_unit

VALUE_BESIDES = (
    " Another value of `{name}`{others} than the {given} that is given would take most of what is left: it "
    "may be off, and the sizes told here with it. Estimate it, too ({how}), and diagnose again."
)
MOST_ALIKE = 3  # values that show alike, of which each is estimated


@dataclass(frozen=True)
class OtherValue:
    """A parameter that is held at the value `held`, as it was estimated: the gain in BIC over the null, and
    the errors of simulated unseen data to those of the model as it is. Other values of those `alike` do the
    same. `is_all`: with it the model simulates all recordings to their noise."""

    parameter: FittedParameter
    held: float
    delta_bic: float
    ratios: tuple[float, ...]
    alike: tuple[str, ...] = ()
    is_all: bool = False

    @property
    def answer(self) -> str:
        """What it is, and what it was."""
        return f"another value of {self.text}"

    @property
    def given(self) -> tuple[str, ...]:
        """The parameter, which a user gives a value."""
        return (self.parameter.name,)

    @property
    def remedy(self) -> str:
        """How the other value is taken."""
        return f"estimate it, too ({in_project(self.parameter.name)})"

    @property
    def advice(self) -> str:
        """What is to be done before an effect is believed."""
        return f"{self.remedy} before an effect is believed"

    @property
    def settled_by(self) -> str:
        """What tells it from an effect."""
        return (
            "Estimate it, too, and diagnose again: what is missing besides shows then. A measurement of "
            f"`{self.parameter.name}` by itself settles it."
        )

    def says_as_much_as(
        self, law: Proof, baseline: FitResult, null: Null, law_ratios: Sequence[float]
    ) -> bool:
        """Whether it is an answer beside an accepted law: as likely, or less so where the law simulates
        unseen data with more error (as of two laws). One that is far likelier need but simulate them with
        less error than the model as it is, and with no more where the law leaves most of the error of every
        output itself, or where the value is certainly off beside the law, too: what else is missing may spoil
        its simulation."""
        if not self.ratios or self.delta_bic < GATES.min_bic_gain:
            return False
        pairs = list(zip(self.ratios, law_ratios, strict=False))
        gain = _beside_loads(law, baseline, null)
        if self.delta_bic >= gain + GATES.min_bic_gain:
            leaves_most = min(law_ratios, default=np.inf) > GATES.max_most_ratio
            is_spoilt = leaves_most or self._is_off_beside(law, gain, null)
            most = 1.0 + GATES.same_unseen_error if is_spoilt else GATES.max_rival_error
            if max(self.ratios) < most:
                return True
        if self.delta_bic >= gain - GATES.same_bic:
            return all(own * GATES.max_rival_error <= other for own, other in pairs)
        return bool(pairs) and all(own < GATES.max_rival_error * other for own, other in pairs)

    def _is_off_beside(self, law: Proof, gain: float, null: Null) -> bool:
        """Whether the model with another value is so much likelier than with the law, whose gain in BIC is
        `gain`, that it must be so beside the law, too: with both it is no less likely than with the value
        alone, for the price of the law's parameters. Not of a law that only its simulation shows."""
        price = -bic_gain(0.0, law.candidate.n_unknowns, null)
        return not law.is_by_use and self.delta_bic >= gain + price + GATES.min_bic_gain

    def puts_aside(self, law: Proof, baseline: FitResult, null: Null, law_ratios: Sequence[float]) -> bool:
        """Whether an accepted law only stands for it, as for a likelier law: beside loads it is preferred by
        what tells laws apart, and simulates no output of unseen data worse."""
        pairs = list(zip(self.ratios, law_ratios, strict=False))
        is_no_worse = all(own <= (1.0 + GATES.same_unseen_error) * other for own, other in pairs)
        gain = _beside_loads(law, baseline, null)
        return bool(pairs) and is_no_worse and self.delta_bic > gain + GATES.same_bic

    @property
    def says_much(self) -> bool:
        """Whether it is the nearest answer where no law is accepted: unseen data are simulated clearly
        better."""
        is_better = bool(self.ratios) and max(self.ratios) < GATES.max_clear_ratio
        return is_better and self.delta_bic >= GATES.min_bic_gain

    @property
    def text(self) -> str:
        """The value, and that which is given."""
        held = with_unit(f"{self.held:.4g}", self.parameter.unit)
        told = f"`{self.parameter.name}`, {told_number(self.parameter)} instead of the {held} that is given"
        others = " or ".join(f"`{name}`" for name in self.alike)
        return f"{told} (or of {others}, which the sensors see alike)" if others else told


def in_project(name: str) -> str:
    """How a parameter is estimated besides those that are: on the command line it would be alone.

    >>> in_project("spring.c")
    '`"spring.c" = { estimate = true }` under [parameters] of daest.toml'
    """
    return f"`{toml_key(name)} = {{ estimate = true }}` under [parameters] of daest.toml"


def _beside_loads(law: Proof, baseline: FitResult, null: Null) -> float:
    """The gain in BIC of an accepted law beside the loads, also of one that its simulation shows."""
    if not law.is_by_use:
        return law.delta_bic
    own = law.fit.log_likelihood - baseline.log_likelihood
    return bic_gain(own, law.candidate.n_unknowns, null)


def other_value(stand: Stand, run: NullObserver) -> OtherValue | None:
    """The held value that shows most in the innovations, estimated, or of those that show nearly as much the
    likeliest; None where none shows, another one cannot be estimated, or is not certainly another."""
    return most_telling(stand, run, list(_held(stand)))


def _held(stand: Stand) -> dict[str, Parameter]:
    """The parameters that a user gave a value, by name: not those that are held since others do the same."""
    tied = {name for names in stand.tied for name in names}
    given = [p for p in stand.declared.parameters if not (p.estimate or p.is_memory or p.name in tied)]
    return {p.name: p for p in given}


def most_telling(stand: Stand, run: NullObserver, names: Sequence[str]) -> OtherValue | None:
    """That of the values `names` that shows most in the innovations, estimated, as `other_value` tells it."""
    null = stand.null
    if not names or stand.reference is None:
        return None
    scores = {one.name: one for one in value_scores(null, run, names)}
    first = next(iter(scores.values()))
    if first.p_value >= GATES.screen_level:
        return None
    near = [one.name for one in scores.values() if one.score >= GATES.near_value_score * first.score]
    found = _likeliest(stand, tuple(dict.fromkeys((first.name, *first.alike, *near))))
    if found is None:
        return None
    name, fit = found
    held = next(p.value for p in null.flat.parameters if p.name == name)
    freed = replace(null, fit=replace(null.fit, parameters=(*null.fit.parameters, *fit.parameters[-1:])))
    after = None
    with suppress(*FAILURES):
        after = reference_of(freed, fit, stand.validation)
    if after is None:
        return None
    told = next((p for p in after.fit.parameters if p.name == name), None)
    if told is None or not told.std_error or told.at_bound:
        return None
    if abs(told.value - held) < GATES.min_significance * told.std_error:
        return None
    gain = fit.log_likelihood - stand.baseline.log_likelihood
    ratios = error_ratios(stand.told.simulated, after.fit.simulated)
    alike = scores[name].alike
    is_all = is_at_noise(null, fit, after.fit)
    return OtherValue(told, held, bic_gain(gain, 1, null), tuple(ratios), alike, is_all)


def value_besides(stand: Stand, law: Proof) -> str:
    """A sentence on the held value of which another one would take most of what the load follows that an
    accepted law leaves; empty where none does, or what is left follows nothing. The law has its right name
    then, and sizes that are off by many of their standard errors. What a second effect leaves no value
    says."""
    held = _held(stand)
    if law.left is None or law.left.p_value >= GATES.rest_level or not held:
        return ""
    with suppress(*FAILURES):
        model = with_law(stand.null, law)
        first, *_ = value_scores(model, run_null(model), list(held))
        is_most = first.score**2 / 2.0 >= GATES.min_share_of_left * law.left.log_likelihood_gain
        if first.p_value < GATES.missing_level and is_most:
            return VALUE_BESIDES.format(
                name=first.name,
                others=f" (or of {listed(first.alike)}, which does the same)" if first.alike else "",
                given=with_unit(f"{held[first.name].value:.4g}", held[first.name].unit),
                how=in_project(first.name),
            )
    return ""


def _likeliest(stand: Stand, names: Sequence[str]) -> tuple[str, FitResult] | None:
    """The refit with the one of `names` that ends likeliest: what is the same equation is not the same way to
    it. None where none can be refitted."""
    null, ends = stand.null, []
    known = {p.name for p in null.flat.parameters}
    for name in [name for name in names if name in known][:MOST_ALIKE]:
        with suppress(*FAILURES):
            wanted = (*null.estimated, name)
            ends.append((name, refit(null.flat, null.explicit, wanted, null, validation=stand.validation)))
    return max(ends, key=lambda end: end[1].log_likelihood, default=None)
