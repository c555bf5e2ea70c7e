"""Text for the terminal: rich tables and paragraphs as a string of a given width."""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Sequence
from typing import Any

from rich import box
from rich.console import Console, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

NARROWEST_TEXT = 8  # characters that a column of text keeps in a narrow terminal
LONGEST_NAME = 24  # characters of a word that are kept together where that is asked for


def rendered(parts: Iterable[RenderableType], width: int, color: bool) -> str:
    """The parts below each other; without colour there is no control sequence in the text."""
    console = Console(
        file=io.StringIO(),
        width=width,
        force_terminal=color,
        color_system="standard" if color else None,
        markup=False,
        highlight=False,
        emoji=False,
        legacy_windows=False,
    )
    for part in parts:
        console.print(part)
    lines = console.file.getvalue().splitlines()  # type: ignore[attr-defined]
    return "\n".join(line.rstrip() for line in lines) + "\n"


def table(
    columns: Sequence[str],
    rows: Iterable[Sequence[str]],
    text_columns: Iterable[int] = (0,),
    whole_columns: Iterable[int] = (),
) -> Table:
    """A table whose columns are right-aligned except for `text_columns`.

    Where it does not fit, headers and texts wrap; numbers are never broken, nor are the words of
    `whole_columns` up to LONGEST_NAME.
    """
    left, whole, cells = set(text_columns), set(whole_columns), [tuple(row) for row in rows]
    result = Table(box=box.SIMPLE_HEAD, pad_edge=False, show_edge=False)
    for index, name in enumerate(columns):
        widest = max((len(row[index]) for row in cells), default=0)
        words = (len(word) for row in cells for word in row[index].split())
        narrowest = min(max(words, default=0), LONGEST_NAME) if index in whole else NARROWEST_TEXT
        result.add_column(
            name,
            justify="left" if index in left else "right",
            overflow="fold",
            min_width=min(widest, narrowest) if index in left else widest,
            header_style="bold",
        )
    for row in cells:
        result.add_row(*row)
    return result


def heading(text: str) -> Text:
    return Text(f"\n{text}", style="bold")


def indented(text: str) -> Padding:
    return Padding(Text(text), (0, 0, 0, 2))


def number(value: Any, digits: int = 4) -> str:
    """`digits` significant digits; - for a missing value."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "-"
    return f"{value:.{digits}g}"


def percent(value: Any) -> str:
    """A fit in percent with two decimals; - for a missing value."""
    return "-" if value is None or not math.isfinite(value) else f"{value:.2f}"


def bracketed(unit: str | None) -> str:
    return f"[{unit}]" if unit else ""


def listed(names: Sequence[str], most: int = 12, total: int | None = None) -> str:
    """Names with commas; beyond `most` the rest is counted. `total`: how many there are, if not all are
    given."""
    total = len(names) if total is None else total
    if not names:
        return "none"
    shown = ", ".join(names[:most])
    return shown if total <= most else f"{shown} and {total - most} more"
