"""What is wrong with a text that is no TOML, and how to mend it, in place of what the parser says of it."""

from __future__ import annotations

import re
from dataclasses import dataclass

_AT = re.compile(r" \(at (?:line (?P<line>\d+), column (?P<column>\d+)|end of document)\)$")
_ASSIGNED = re.compile(r"^\s*(?P<key>[^=#]+?)\s*=\s*(?P<value>[^#]*?)\s*(?:#.*)?$")
_COMMA = re.compile(r"=\s*-?\d+,\d+\s*(?:#|$)")
_FLAGS = {"yes": "true", "no": "false", "on": "true", "off": "false", "True": "true", "False": "false"}


@dataclass(frozen=True)
class Fault:
    """What is wrong, how to mend it, and where: line and column count from 1, None where the text ends."""

    what: str
    remedy: str
    line: int | None
    column: int | None


def fault(message: str, text: str) -> Fault:
    """The fault behind `message`, which tomllib raised for `text`."""
    at = _AT.search(message)
    said = _AT.sub("", message)
    lines = text.splitlines()
    line = int(at["line"]) if at is not None and at["line"] else None
    column = int(at["column"]) if at is not None and at["column"] else None
    line = line or len(lines) or None
    shown = lines[line - 1] if line is not None and line <= len(lines) else ""
    what, remedy = _of_line(said, shown) or _of_message(said)
    return Fault(what, remedy, line, column)


def _of_line(said: str, shown: str) -> tuple[str, str] | None:
    """The usual slips, which the line itself tells better than the parser."""
    assigned = _ASSIGNED.match(shown)
    if said.startswith("Unescaped") or ("\\" in shown and "hex" in said):
        return (
            "a backslash in a text has a meaning of its own",
            'write paths with /, as in "data/run1.csv", or in single quotes',
        )
    if _COMMA.search(shown):
        return "a number has a comma", "write a point: 1.5"
    if assigned is None:
        return None
    key, value = assigned["key"], assigned["value"]
    if not value:
        return f"'{key}' has no value", f"write one behind the =, or put # before {key}"
    if value in _FLAGS:
        return f"'{value}' is no value", f"write {key} = {_FLAGS[value]}"
    if said == "Invalid value" and re.match(r"[A-Za-z_./~]", value):
        return f"the text {value} has no quotes", f'write {key} = "{value}"'
    return None


_QUOTES = "a text or a name with a dot, a space or a sign stands in quotes"
_FAULTS = (
    ("Expected '=' after a key", "a name has no value", f"write NAME = VALUE; {_QUOTES}"),
    ("Invalid value", "this is no value", 'values are 1.5, "text", true, false, ["list"] or { name = 1.5 }'),
    ("Invalid statement", "this is neither [section] nor NAME = VALUE", "put # before a remark"),
    ("Invalid initial character", "this is no name", f"write NAME = VALUE; {_QUOTES}"),
    ("Cannot overwrite", "a name stands here that has a value already", "keep one of the two"),
    ("Duplicate inline", "a name stands twice in { }", "keep one of the two"),
    ("Cannot redefine|Cannot mutate", "a name stands here that has a value already", "keep one of the two"),
    ("Cannot declare", "a section stands twice", "move the lines of the second into the first"),
    ("Unclosed array", "a list is not closed", "write commas between its elements and ] behind the last"),
    ("Unclosed inline", "a { is not closed on its line", "write it on one line, with } at its end"),
    ("Unterminated|Expected \"'\"|character '.n'", "a text is not closed", "write its quote at its end, too"),
    ("character", "a character stands here that no text may hold", "remove it, and type the line again"),
    ("Expected newline", "something stands behind a value", f"write one NAME = VALUE a line; {_QUOTES}"),
    ("Expected '\\]", "the name of a section is not closed", f"write [section]; {_QUOTES}"),
    ("date", "this is no date", "write dates in quotes"),
)


def _of_message(said: str) -> tuple[str, str]:
    for pattern, what, remedy in _FAULTS:
        if re.search(pattern, said):
            return what, remedy
    return f"not valid TOML: {said}", "see https://toml.io for the syntax"
