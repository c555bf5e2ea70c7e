"""Commands and outputs that a text shows: each `console` block runs and must print what it says."""

import re
import shlex
from collections.abc import Callable, Sequence

import pytest

FENCE = re.compile(r"```(\w+)[^\n]*\n(.*?)```", re.DOTALL)
NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?(?![\w.])")
RELATIVE = 0.02  # other versions of numerical libraries may move the last shown digits


def fenced(text: str, language: str) -> list[str]:
    return [body for name, body in FENCE.findall(text) if name == language]


def says_the_same(stated: str, printed: str) -> bool:
    """Equal words, and numbers that agree to RELATIVE."""
    if NUMBER.sub("#", " ".join(stated.split())) != NUMBER.sub("#", " ".join(printed.split())):
        return False
    pairs = zip(NUMBER.findall(stated), NUMBER.findall(printed), strict=True)
    return all(float(a) == pytest.approx(float(b), rel=RELATIVE) for a, b in pairs)


def missing(stated: list[str], printed: list[str]) -> str | None:
    """The first stated line that does not follow in what was printed; `...` stands for any lines."""
    position, may_skip = 0, False
    for line in stated:
        if line.strip() == "...":
            may_skip = True
            continue
        while position < len(printed) and not says_the_same(line, printed[position]):
            if not may_skip:
                return line
            position += 1
        if position == len(printed):
            return line
        position, may_skip = position + 1, False
    return None


def checked_commands(text: str, run: Callable[[Sequence[str]], int], printed: Callable[[], str]) -> list[str]:
    """Run the console blocks of `text` one after the other in the current folder: each ends with 0, and
    prints what the block says. `printed` is what was printed since it was last called. Returns the names of
    the commands."""
    names = []
    for block in fenced(text, "console"):
        prompt, *stated = block.splitlines()
        program, name, *options = shlex.split(prompt.removeprefix("$ "))
        assert prompt.startswith("$ ") and program == "daest"
        printed()
        assert run([name, *options]) == 0
        lines = [line for line in printed().splitlines() if line.strip()]
        assert missing([line for line in stated if line.strip()], lines) is None
        names.append(name)
    return names
