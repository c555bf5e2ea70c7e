"""From the name of a place in a model to the equations it means."""

from __future__ import annotations

import re
from collections.abc import Sequence

from daest.errors import ModelError
from daest.model.flat import FlatModel
from daest.model.linear import LinearDAE
from daest.model.parts import Equation, Variable
from daest.near import near_names


def resolve_place(model: FlatModel | LinearDAE, name: str) -> list[int]:
    """Indices of the equations that `name` means: one for most names, more where a name is ambiguous on
    purpose.

    A name is the index of an equation; a flow variable (its flow sum, or the equation of its open
    connector); a connector with one flow variable; or a variable that one equation defines, as `x = …`,
    `der(x) = …` or `… = der(x)`. Raises ModelError that lists the equations which mention the name.
    """
    equations = model.equations
    if re.fullmatch(r"\d+", name.strip()):
        return [_index(int(name), equations)]
    flows = [x.name for x in model.unknowns if x.is_flow]
    wanted = _flow_of_connector(name, flows) or name
    if wanted in flows:
        return _flow_equations(wanted, equations)
    if wanted not in model.unknown_names:
        raise _unknown(name, model.unknowns, equations)
    defining = [i for i, equation in enumerate(equations) if _defines(equation.text, wanted)]
    if len(defining) == 1:
        return defining
    raise _ambiguous(name, equations, defining)


def _index(index: int, equations: Sequence[Equation]) -> int:
    if index < len(equations):
        return index
    raise ModelError(
        "model-place",
        f"there is no equation {index}",
        remedy=f"Equations are numbered from 0 to {len(equations) - 1}.",
    )


def _flow_of_connector(name: str, flows: Sequence[str]) -> str | None:
    """The flow variable of connector `name` if it has exactly one."""
    inside = [flow for flow in flows if flow.rpartition(".")[0] == name]
    return inside[0] if len(inside) == 1 else None


def _flow_equations(name: str, equations: Sequence[Equation]) -> list[int]:
    sums = [
        i
        for i, equation in enumerate(equations)
        if equation.kind in ("flow", "unconnected") and _mentions(equation.text, name)
    ]
    if sums:
        return sums
    raise _ambiguous(name, equations, [])


def _defines(text: str, name: str) -> bool:
    left, _, right = text.partition(" = ")
    return left in (name, f"der({name})") or right == f"der({name})"


def _mentions(text: str, name: str) -> bool:
    return re.search(rf"(?<![\w.]){re.escape(name)}(?![\w.\[])", text) is not None


def _ambiguous(name: str, equations: Sequence[Equation], defining: Sequence[int]) -> ModelError:
    listed = list(defining) or [i for i, equation in enumerate(equations) if _mentions(equation.text, name)]
    how = f"{len(defining)} equations define" if defining else "no equation defines"
    return ModelError(
        "model-place",
        f"{how} `{name}`",
        remedy="Name an equation by its index:\n" + _listing(listed, equations),
    )


def _unknown(name: str, unknowns: Sequence[Variable], equations: Sequence[Equation]) -> ModelError:
    mentioning = [i for i, equation in enumerate(equations) if _mentions(equation.text, name)]
    if mentioning:
        return _ambiguous(name, equations, [])
    near = near_names(name, [x.name for x in unknowns], 3)
    hint = f"Did you mean {', '.join(f'`{one}`' for one in near)}? " if near else ""
    return ModelError(
        "model-place",
        f"`{name}` is no variable of the model",
        remedy=f"{hint}A place is a flow variable, a connector, a variable that an equation defines, "
        "or an index.",
    )


def _listing(indices: Sequence[int], equations: Sequence[Equation]) -> str:
    return "\n".join(f"    {i}: {equations[i].text}" for i in indices)
