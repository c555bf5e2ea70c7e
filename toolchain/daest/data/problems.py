"""Problems of files: several of one file told in one message, and those that all formats have."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from daest.errors import DaestError, DataError, Place

MOST_SHOWN = 12


def raise_collected(problems: Sequence[DaestError], source: str) -> None:
    """Return if there is no problem; raise the only one; or raise one error of the same class that lists all
    of them.

    The class and, if all agree, the code are those of the first problem, else the code is `several-problems`.
    """
    if not problems:
        return
    if len(problems) == 1:
        raise problems[0]
    first = problems[0]
    same = all(problem.code == first.code for problem in problems)
    lines = [f"{len(problems)} problems in {source}"]
    lines += [_indented(problem) for problem in problems[:MOST_SHOWN]]
    if len(problems) > MOST_SHOWN:
        lines.append(f"  ... and {len(problems) - MOST_SHOWN} more")
    code = first.code if same else "several-problems"
    raise type(first)(code, "\n".join(lines), problems=problems)


def empty_file(path: Path, what: str) -> DataError:
    """DataError `data-empty-file` of a file of rows; `what` says that it is empty."""
    return DataError(
        "data-empty-file",
        what,
        where=Place(str(path)),
        remedy="a recording needs a header row and at least two rows of numbers",
    )


def unreadable_file(path: Path, what: str, remedy: str) -> DataError:
    """DataError `data-unreadable-file`."""
    return DataError("data-unreadable-file", what, where=Place(str(path)), remedy=remedy)


def _indented(problem: DaestError) -> str:
    return "\n".join("  " + line for line in str(problem).splitlines())
