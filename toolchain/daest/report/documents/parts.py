"""Entries that the documents of linear models share."""

from __future__ import annotations

import math
from typing import Any

from daest.model.flat import Equation
from daest.model.linear import RankDecision
from daest.numerics.ranks import warning


def equation_entry(index: int, equation: Equation) -> dict[str, Any]:
    """`index` counts from 0, as the rows of E do; `place` is `file:line`, None where it is not known."""
    place = equation.place
    where = None if place is None else f"{place.file}:{place.line}" if place.line is not None else place.file
    return {
        "index": index,
        "text": equation.text,
        "kind": equation.kind,
        "origin": equation.origin,
        "place": where,
    }


def decision_entry(decision: RankDecision) -> dict[str, Any]:
    """A rank decision; `gap` is None where nothing but zeros was dropped, `warning` None where it is
    clear."""
    return {
        "what": decision.what,
        "singular_values": list(decision.singular_values),
        "threshold": decision.threshold,
        "rank": decision.rank,
        "gap": decision.gap if math.isfinite(decision.gap) else None,
        "warning": warning(decision) or None,
    }
