"""Names that somebody may have meant in place of one that does not exist."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import SequenceMatcher

LIKE = 0.65  # share of common letters from which names are alike: one letter of three wrong; judgement
WORSE = 0.15  # ratio by which a name may be less alike than the nearest one to be named beside it; judgement
BEGINS, LONG = 0.85, 6  # the same at the beginning of a name, and letters of one; judgement
EXTRA_LETTERS = 2  # that one of two names may have behind the other (`J`, `J1`); judgement


def near_names(name: str, candidates: Iterable[str], n: int = 3) -> list[str]:
    """The up to `n` candidates that are nearly written like `name`, nearest first, whatever their case; else
    those that are called so inside of a component (`spring.c` for `c`). Empty where none is near."""
    pool = list(dict.fromkeys(candidates))
    alike = {candidate: _likeness(name.lower(), candidate.lower()) for candidate in pool}
    best = max(alike.values(), default=0.0)
    near = [c for c in pool if alike[c] >= max(LIKE, best - WORSE)]
    if not near:
        near = [c for c in pool if c.lower().endswith("." + name.lower())]
    return sorted(near, key=lambda c: (-alike[c], -_likeness(name, c)))[:n]


def _likeness(a: str, b: str) -> float:
    """Share of common letters, 0 to 1; names that go on where the other ends are alike, and a long name that
    begins nearly as a shorter one does."""
    ratio = SequenceMatcher(None, a, b).ratio()
    goes_on = (a.startswith(b) or b.startswith(a)) and 0 < abs(len(a) - len(b)) <= EXTRA_LETTERS
    shorter = min(len(a), len(b))
    begins = SequenceMatcher(None, a[:shorter], b[:shorter]).ratio() if shorter >= LONG else 0.0
    return max(ratio, LIKE) if goes_on or begins >= BEGINS else ratio


def did_you_mean(name: str, candidates: Iterable[str], n: int = 3) -> str:
    """``Did you mean `a` or `b`? `` with a space behind it, for the up to `n` nearest names; empty where none
    is near."""
    near = near_names(name, candidates, n)
    return f"Did you mean {' or '.join(f'`{one}`' for one in near)}? " if near else ""


def nearest(name: str, candidates: Iterable[str]) -> str:
    """`did you mean ...?` for a name that does not exist, or the empty text."""
    near = near_names(name, candidates)
    return f"did you mean {', '.join(near)}?" if near else ""
