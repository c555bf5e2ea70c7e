"""C text of CasADi functions."""

from __future__ import annotations

import re
from collections.abc import Sequence

import casadi as ca

_EXPORTED = re.compile(r"CASADI_SYMBOL_EXPORT\s[\w\s*]*?(\w+)\(")


def generated(functions: Sequence[ca.Function]) -> str:
    """The C text of functions, each under its own name, without what CasADi's loader asks of each (sizes,
    names, sparsity, memory): code of this project calls the functions themselves, and two fifths of the
    compilation were for the rest."""
    generator = ca.CodeGenerator("model.c")
    for function in functions:
        generator.add(function)
    wanted = {function.name() for function in functions}
    blocks = generator.dump().split("\n\n")
    return "\n\n".join(block for block in blocks if _exported(block) in (None, *wanted))


def _exported(block: str) -> str | None:
    """The name of the function that a block of the text defines for others; None where it is no such one."""
    found = _EXPORTED.match(block.lstrip("\n"))
    return found and found[1]
