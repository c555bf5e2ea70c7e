"""Noise verdicts for almost every θ beside those at one θ, and the reason where they differ."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

from daest.model.linear import LinearDAE, Structure
from daest.model.noise import Difference, GenericVerdict, NoiseReport
from daest.systems.linear.exact_structure import ExactStructure, generic_structure

MOST_RELEASED = 60
"""Up to this many parameters are released one by one to find the ones that make a verdict special."""

INEXACT = (
    "the numbers here are results of rounding (an operating point that was solved for, or the binary of an "
    "FMU), and what is as small as rounding errors counts as zero"
)


def compared(
    dae: LinearDAE, report: NoiseReport, generic: Structure | None, exact: Structure | None
) -> tuple[GenericVerdict | None, tuple[Difference, ...]]:
    """The verdict of `generic`, and where and why `report` differs, `exact` being the structure at its θ."""
    if not isinstance(generic, ExactStructure):
        return None, ()
    here = exact if isinstance(exact, ExactStructure) else None
    found = GenericVerdict(
        of="parameters" if generic.reading == "generic" else "numbers",
        index=generic.index,
        n_dynamic=generic.n_dynamic,
        forbidden=tuple(generic.forbidden),
        noises=tuple(_forbidden_noises(dae, generic)),
    )
    differences = [
        *_of_structure(report, found),
        *_of_equations(report, found, here),
        *_of_noises(dae, report, found, here),
    ]
    if not any(difference.reason == "" for difference in differences):
        return found, tuple(differences)
    reason = INEXACT
    if here is not None:
        reason = special_values(dae, lambda released: not released.agrees(here))
    return found, tuple(Difference(d.what, d.reason or reason, d.equations, d.noises) for d in differences)


def _forbidden_noises(dae: LinearDAE, structure: ExactStructure) -> list[str]:
    orders = zip(dae.noises, structure.noise_orders, strict=True)
    return [noise.name for noise, order in orders if order]


def _of_structure(report: NoiseReport, generic: GenericVerdict) -> Iterator[Difference]:
    """Without a reason: `special_values` is to tell it."""
    if report.index != generic.index:
        yield Difference("index", "")
    if report.n_dynamic != generic.n_dynamic:
        yield Difference("n_dynamic", "")


def _of_equations(
    report: NoiseReport, generic: GenericVerdict, exact: ExactStructure | None
) -> Iterator[Difference]:
    found = {i for i, place in enumerate(report.places) if not place.admissible}
    special = found if exact is None else set(exact.forbidden)
    if special != set(generic.forbidden):
        yield Difference("equations", "", tuple(sorted(special ^ set(generic.forbidden))))
    by_tolerance = tuple(sorted(found ^ special))
    if by_tolerance:
        norms = [report.places[i].projection_norm for i in by_tolerance]
        yield Difference("equations", _tolerance_reason(report, norms), by_tolerance)


def _of_noises(
    dae: LinearDAE, report: NoiseReport, generic: GenericVerdict, exact: ExactStructure | None
) -> Iterator[Difference]:
    found = {place.name for place in report.annotated if not place.admissible}
    special = found if exact is None else set(_forbidden_noises(dae, exact))
    if special != set(generic.noises):
        yield Difference("noises", "", noises=tuple(sorted(special ^ set(generic.noises))))
    by_tolerance = tuple(sorted(found ^ special))
    if by_tolerance:
        norms = [place.projection_norm for place in report.annotated if place.name in by_tolerance]
        yield Difference("noises", _tolerance_reason(report, norms), noises=by_tolerance)


def _tolerance_reason(report: NoiseReport, norms: Iterable[float]) -> str:
    small, large = min(norms), max(norms)
    span = f"norm {small:.3g}" if large - small <= 1e-3 * large else f"norms {small:.3g} to {large:.3g}"
    return (
        f"projection {span}, beside the tolerance {report.tolerance:g}: exactly, any norm above zero forbids"
    )


def special_values(dae: LinearDAE, is_other: Callable[[ExactStructure], bool]) -> str:
    """Which parameters, released alone, give a structure that `is_other`, in words."""
    special = []
    for i, parameter in enumerate(dae.parameters[:MOST_RELEASED]):
        released = generic_structure(dae, [i])
        if released is not None and is_other(released):
            special.append(f"{parameter.name} = {parameter.value:g}")
    if not special:
        return "the values of several parameters together are special"
    return f"{' and '.join(special)} {'is a special value' if len(special) == 1 else 'are special values'}"
