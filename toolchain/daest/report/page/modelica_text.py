"""Modelica as highlighted HTML, with the lines that are new marked."""

from __future__ import annotations

from difflib import SequenceMatcher

CLASS = "modelica"  # of the enclosing element


def added_lines(text: str, base: str) -> list[int]:
    """Numbers, from 1, of the lines of `text` that `base` does not have."""
    old, new = base.splitlines(), text.splitlines()
    blocks = SequenceMatcher(None, old, new, autojunk=False).get_matching_blocks()
    kept = {line for _, start, size in blocks for line in range(start, start + size)}
    return [i + 1 for i in range(len(new)) if i not in kept and new[i].strip()]


LEFT_OUT = "  // ..."  # unchanged lines between new ones


def addition(text: str, new: list[int]) -> str:
    """The lines `new` of the text, from 1; what is unchanged between them is a line of dots."""
    lines, parts, last = text.splitlines(), list[str](), None
    for number in new:
        between: list[str] = lines[last : number - 1] if last is not None else []
        parts += between if not any(line.strip() for line in between) else [LEFT_OUT]
        parts.append(lines[number - 1])
        last = number
    return "\n".join(parts)


def highlighted(text: str, new: list[int]) -> str:
    """HTML of a Modelica text with every character of it escaped; lines `new`, from 1, are marked."""
    from pygments import highlight
    from pygments.formatters import HtmlFormatter
    from pygments.lexers import ModelicaLexer

    return highlight(text, ModelicaLexer(), HtmlFormatter(cssclass=CLASS, hl_lines=new))
