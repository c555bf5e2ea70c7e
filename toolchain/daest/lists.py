"""Lists in sentences."""

from __future__ import annotations

from collections.abc import Sequence


def first_few(texts: Sequence[str], most: int, total: int | None = None, *, separator: str = ", ") -> str:
    """The first `most` of some texts, and how many more there are; `total` where not all are given.

    >>> first_few(["a", "b", "c", "d"], 2)
    'a, b and 2 more'
    """
    rest = (len(texts) if total is None else total) - min(most, len(texts))
    shown = separator.join(texts[:most])
    return f"{shown} and {rest} more" if rest > 0 else shown
