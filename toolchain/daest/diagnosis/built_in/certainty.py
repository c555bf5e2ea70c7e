"""How well the data determine the parameters of a law, alone or beside a parameter of the model."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from daest.diagnosis.gates import GATES
from daest.diagnosis.screening.candidates import scaled_shapes
from daest.model.diagnosis import Candidate
from daest.model.effects import EffectParameter
from daest.model.fit import FitResult, FittedParameter
from daest.quantities import is_unit_expression, over_power


@dataclass(frozen=True)
class KnownProduct:
    """The product of a size and a parameter of the model, `name` (`a*k`), or their ratio (`c/J`), where the
    data determine that and not the size."""

    name: str
    value: float
    std_error: float
    unit: str


def certainty_of(
    candidate: Candidate,
    told: FitResult,
    own: FittedParameter,
    declared: EffectParameter,
    before: FitResult,
    gain: float = 0.0,
) -> float:
    """How many standard errors a parameter of a law is off its null. A size counts by its ratio to a
    parameter of the model, too, where that cannot vanish: torques whose scale no sensor tells are as
    uncertain as this scale, each of them, and none of them is zero for that. Not by one to a parameter that
    was known `before` the law was there: the law then only takes its place, and their difference is all that
    is known. Nor the size of a law that changes the order of the model, whose ratios to other times are no
    scales; but where it may change places with another time, the likelihood ratio tells: of two equal lags
    the slope over their difference is nothing and the standard error of either is infinite, while the model
    without one of them may be out of the question. That ratio is of the `gain` in log-likelihood that the law
    brings, beside unknown loads as it may be: so the product with that time, as the estimates that are told
    have it, must be as certain besides, and both as much as a time constant is asked for. The bend of a
    signal counts by its product with any parameter, known before or not: a thrust with the square of a
    command has no other gain, and relative to that its bend may be anything, while the
    product is certain. 0 where nothing is known."""
    null, error = declared.null or 0.0, own.std_error
    if error is None:
        return 0.0
    alone = abs(own.value - null) / error if error else np.inf
    scales = _beside_scales(candidate, told, own, declared)
    if candidate.effect.is_dynamic:
        likely = float(np.sqrt(2.0 * max(gain, 0.0)))
        trading = max((min(likely, 1.0 / spread) for _, spread in scales), default=0.0)
        return max(alone, trading if trading >= GATES.min_dynamic_significance else 0.0)
    beside = (1.0 / spread for scale, spread in scales if is_bend(declared) or not _is_blurred(scale, before))
    return max(alone, *beside, 0.0)


def known_products(candidate: Candidate, told: FitResult) -> tuple[KnownProduct, ...]:
    """For each size of a law that is not significant alone, what is known best beside a parameter of the
    model that is no more certain; none where that is not significant either."""
    declared = {f"{candidate.name}.{p.name}": p for p in candidate.effect.sizes}
    found = []
    for own in (p for p in told.parameters if p.name in declared and p.std_error):
        size = declared[own.name]
        if abs(own.value - (size.null or 0.0)) >= GATES.min_significance * (own.std_error or 0.0):
            continue
        beside = [
            (spread, scale)
            for scale, spread in _beside_scales(candidate, told, own, size)
            if spread * GATES.min_significance <= 1.0
        ]
        if beside:
            spread, scale = min(beside, key=lambda one: one[0])
            found.append(_product(own, scale, spread, 1 if _is_by_product(candidate, size) else -1))
    return tuple(found)


def _product(own: FittedParameter, scale: FittedParameter, spread: float, power: int) -> KnownProduct:
    value = own.value * scale.value**power
    is_spelled = is_unit_expression(own.unit) and is_unit_expression(scale.unit)
    return KnownProduct(
        f"{own.name.partition('.')[2]}{'*' if power > 0 else '/'}{scale.name}",
        value,
        abs(value) * spread,
        over_power(own.unit, scale.unit, -power) if is_spelled else "",
    )


def is_bend(declared: EffectParameter) -> bool:
    """Whether a size bends a signal: it counts by its product with a gain."""
    return declared.signal_unit == "1/u"


def _is_by_product(candidate: Candidate, declared: EffectParameter) -> bool:
    """Whether a size counts by its product with a parameter of the model, and not by their ratio."""
    return is_bend(declared) or candidate.effect.is_dynamic


def bends(candidate: Candidate) -> bool:
    """Whether a law is a bend of its signal: at a place along it, or everywhere. A dead zone is not, whose
    one side is an offset."""
    return bool(scaled_shapes(candidate)) or any(is_bend(p) for p in candidate.effect.sizes)


def _beside_scales(
    candidate: Candidate, told: FitResult, own: FittedParameter, declared: EffectParameter
) -> Iterator[tuple[FittedParameter, float]]:
    """The parameters of the model that cannot vanish, each with the standard error of the logarithm of its
    ratio to a size; for a bend all of them, with that of their product: a gain may vanish beside it. For a
    law that changes the order of the model those that the data do not tell apart from it, with that of their
    product."""
    if declared.role != "size" or declared.null or not own.value:
        return
    power = 1.0 if _is_by_product(candidate, declared) else -1.0
    names, cov = told.covariance()
    known = dict(zip(names, range(len(names)), strict=True))
    for p in told.parameters if own.name in known else ():
        if p.name.startswith(f"{candidate.name}.") or p.name not in known:
            continue
        cannot_vanish = p.min is not None and p.min >= 0.0 < p.value
        if not cannot_vanish and not (is_bend(declared) and p.value):
            continue
        if candidate.effect.is_dynamic and not _may_change_places(own, p):
            continue
        both = [known[own.name], known[p.name]]
        relative = np.array([1.0 / own.value, power / p.value])
        relative = relative * _without_choice(told, own, p)
        variance = float(relative @ cov[np.ix_(both, both)] @ relative)
        variance += _of_choice(told, own, p, power) ** 2
        if variance > 0.0:
            yield p, float(np.sqrt(variance))


def _without_choice(told: FitResult, *parameters: FittedParameter) -> np.ndarray:
    """Which share (k,) of the standard errors of `parameters` is left without what they include for the
    choice beside another estimate: between two ends of a valley either parameter is far from where it was,
    and their product where it was."""
    of_choice = np.array([0.0 if told.choice is None else told.choice.of(p) for p in parameters])
    whole = np.array([p.std_error for p in parameters], dtype=float)
    return np.sqrt(np.clip(1.0 - (of_choice / np.where(whole > 0.0, whole, np.inf)) ** 2, 0.0, None))


def _of_choice(told: FitResult, own: FittedParameter, scale: FittedParameter, power: float) -> float:
    """What the choice beside another estimate adds to the relative standard error of a product (power 1) or
    a ratio (-1)."""
    if told.choice is None:
        return 0.0
    there = told.choice.beside[scale.name]
    if power < 0 and not there:
        return np.inf
    other = told.choice.beside[own.name] * there**power
    return told.choice.share * abs(1.0 - other / (own.value * scale.value**power))


def _may_change_places(own: FittedParameter, other: FittedParameter) -> bool:
    """Whether two times are one within the standard error of either."""
    errors = own.std_error, other.std_error
    return own.unit == other.unit and all(
        error is not None and abs(own.value - other.value) <= error for error in errors
    )


def _is_blurred(parameter: FittedParameter, before: FitResult) -> bool:
    """Whether a parameter of the model is far less certain with a law than it was `before`."""
    first = next((p for p in before.parameters if p.name == parameter.name), None)
    if first is None or not first.std_error or not first.value or parameter.std_error is None:
        return False
    now, then = parameter.std_error / abs(parameter.value), first.std_error / abs(first.value)
    return now > GATES.max_blurred * then and now > 1.0 / GATES.min_significance
