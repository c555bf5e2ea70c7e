"""Text for the terminal: rich tables and paragraphs as a string of a given width."""

from __future__ import annotations

import functools
import io
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.style import Style
from rich.text import Text

from daest.lists import first_few

LEAST_P = 1e-12  # of a shown p-value
NARROWEST_TEXT = 8  # characters that a text keeps in a narrow terminal
LONGEST_NAME = 32  # characters of a word that are always kept together
JOINT = re.compile(r"(?<=[._/:,])(?=\w)|(?<=[a-z])(?=[A-Z])")  # where a longer name may be divided
GAPS = (3, 2)  # columns between two columns, of which the first is taken that fits


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
        whole = Paragraph(part.plain, 0, part.style) if isinstance(part, Text) else part
        console.print(whole, crop=False)
    lines = console.file.getvalue().splitlines()  # type: ignore[attr-defined]
    return "\n".join(line.rstrip() for line in lines) + "\n"


def as_text(parts: Callable[..., Iterable[RenderableType]]) -> Callable[..., str]:
    """What a command prints, `text(document, width=100, color=False)`: the `parts` of its document in lines
    of at most `width` characters."""

    @functools.wraps(parts)
    def text(document: Mapping[str, Any], width: int = 100, color: bool = False, **options: Any) -> str:
        return rendered(parts(document, **options), width, color)

    return text


@dataclass(frozen=True)
class Columns:
    """A table that cuts neither a word nor a number: cells wrap between words, names longer than LONGEST_NAME
    also inside, and where the narrowest form is too wide, every row stands upright, a line per cell."""

    names: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    left: frozenset[int]

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        for gap in GAPS:
            widths = self._widths(options.max_width, gap)
            if widths is not None:
                yield from self._flat(widths, " " * gap)
                return
        yield from self._upright(options.max_width)

    def _cells(self, index: int) -> list[str]:
        return [self.names[index], *(row[index] for row in self.rows)]

    def _narrowest(self, index: int) -> int:
        if index not in self.left:  # numbers stay on one line, their header may wrap
            words = (len(word) for word in self.names[index].split())
            return max(*words, *(len(row[index]) for row in self.rows), 0)
        return max((len(piece) for cell in self._cells(index) for piece in _pieces(cell)), default=0)

    def _widths(self, width: int, gap: int) -> list[int] | None:
        """Of the columns; None where they do not fit beside each other. What there is beyond the narrowest
        goes to the columns that lack most."""
        columns = range(len(self.names))
        narrowest = [self._narrowest(index) for index in columns]
        wanted = [max(len(cell.rstrip()) for cell in self._cells(index)) for index in columns]
        spare = width - gap * (len(self.names) - 1) - sum(narrowest)
        if spare < 0:
            return None
        widths = list(narrowest)
        while spare > 0 and any(widths[i] < wanted[i] for i in columns):
            index = max(
                columns, key=lambda i: wanted[i] / max(widths[i], 1) if widths[i] < wanted[i] else 0.0
            )
            widths[index], spare = widths[index] + 1, spare - 1
        return widths

    def _flat(self, widths: Sequence[int], gap: str) -> Iterator[Text]:
        head = self._lines(self.names, widths)
        lowered = max(map(len, head))
        yield from self._joined([[""] * (lowered - len(cell)) + cell for cell in head], widths, gap, "bold")
        yield Text("─" * (sum(widths) + len(gap) * (len(widths) - 1)), no_wrap=True, overflow="ignore")
        for row in self.rows:
            yield from self._joined(self._lines(row, widths), widths, gap, "")

    def _lines(self, row: Sequence[str], widths: Sequence[int]) -> list[list[str]]:
        return [_wrapped(cell, width) for cell, width in zip(row, widths, strict=True)]

    def _joined(
        self, cells: Sequence[Sequence[str]], widths: Sequence[int], gap: str, style: str
    ) -> Iterator[Text]:
        for parts in zip_longest(*cells, fillvalue=""):
            padded = (
                part.ljust(width) if index in self.left else part.rjust(width)
                for index, (part, width) in enumerate(zip(parts, widths, strict=True))
            )
            yield Text(gap.join(padded).rstrip(), style=style, no_wrap=True, overflow="ignore")

    def _upright(self, width: int) -> Iterator[Text]:
        label = max((len(name) for name in self.names), default=0)
        for number, row in enumerate(self.rows):
            if number:
                yield Text("")
            for name, cell in zip(self.names, row, strict=True):
                lines = _wrapped(cell.strip(), max(width - label - 2, NARROWEST_TEXT)) or [""]
                for i, line in enumerate(lines):
                    start = name.ljust(label) if i == 0 else " " * label
                    yield Text(f"{start}  {line}".rstrip(), no_wrap=True, overflow="ignore")


def _pieces(text: str) -> list[str]:
    """Words, and parts of those that are longer than LONGEST_NAME: at dots, underlines and capitals."""
    found: list[str] = []
    for word in text.split():
        found += [word] if len(word) <= LONGEST_NAME else [p for p in JOINT.split(word) if p]
    return found


def _wrapped(text: str, width: int) -> list[str]:
    """Lines of at most `width`, unless a word alone is longer. The indent of the text stays."""
    if len(text.rstrip()) <= width:
        return [text.rstrip()]
    indent = text[: len(text) - len(text.lstrip())]
    lines, line = [], indent
    for word in text.split():
        joined = f"{line} {word}" if line.strip() else line + word
        if len(joined) <= width:
            line = joined
            continue
        if line.strip():
            lines.append(line)
        line = indent
        for piece in _pieces(word) if len(word) + len(indent) > width else [word]:
            if len(line + piece) > width and line.strip():
                lines.append(line)
                line = indent
            line += piece
    return [*lines, line]


def table(
    columns: Sequence[str],
    rows: Iterable[Sequence[str]],
    text_columns: Iterable[int] = (0,),
) -> Columns:
    """A table whose columns are right-aligned except for `text_columns`."""
    return Columns(tuple(columns), tuple(tuple(row) for row in rows), frozenset(text_columns))


@dataclass(frozen=True)
class Paragraph:
    """Text that wraps between words, behind a margin; a word that is longer than a line stays whole."""

    text: str
    margin: int = 0
    style: str | Style = ""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        for line in self.text.split("\n"):
            for part in _wrapped(line, max(options.max_width - self.margin, NARROWEST_TEXT)):
                yield Text(" " * self.margin + part, style=self.style, no_wrap=True, overflow="ignore")


def heading(text: str) -> Paragraph:
    """A line that stands above a part of a text."""
    return Paragraph(f"\n{text}", style="bold")


def indented(text: str) -> Paragraph:
    """What stands below a line, moved to the right."""
    return Paragraph(text, 2)


def number(value: Any, digits: int = 4) -> str:
    """`digits` significant digits; - for a missing value."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "-"
    return f"{value + 0.0:.{digits}g}"  # no minus before a zero


def probability(p_value: float | None, digits: int = 2) -> str:
    """`p = 0.03`, or below LEAST_P only that it is less: so far out no distribution is known, and 0 would be
    none."""
    if p_value is not None and p_value < LEAST_P:
        return f"p < {LEAST_P:.0e}"
    return f"p = {number(p_value, digits)}"


def percent(value: Any) -> str:
    """A fit in percent with two decimals; - for a missing value."""
    return "-" if value is None or not math.isfinite(value) else f"{value:.2f}"


def bracketed(unit: str | None) -> str:
    return f"[{unit}]" if unit else ""


def listed(names: Sequence[str], most: int = 12, total: int | None = None, *, separator: str = ", ") -> str:
    """Names with commas or another separator; beyond `most` the rest is counted. `total`: how many there are,
    if not all are given."""
    return first_few(names, most, total, separator=separator) if names else "none"
