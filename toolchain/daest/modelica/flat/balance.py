"""Models whose equations and unknowns differ in number: which ones are concerned."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import casadi as ca
import numpy as np
import scipy.sparse as sp

from daest.errors import ModelError, Place
from daest.lists import first_few
from daest.model.parts import Equation
from daest.modelica.flat.scope import Element
from daest.numerics.matching import find_defect

# How many equations and unknowns a message lists.
_LISTED = 8


def unbalanced(
    equations: Sequence[Equation],
    unknowns: Sequence[Element],
    residual: ca.SX,
    xi: ca.SX,
    derivatives: ca.SX,
    where: str,
) -> ModelError:
    """The error for `len(equations) != len(unknowns)`, naming the parts of the Dulmage-Mendelsohn
    decomposition that have too few or too many equations."""
    missing = len(unknowns) - len(equations)
    what = f"the model has {_count(len(equations), 'equation')} for {_count(len(unknowns), 'unknown')}"
    under, over = _concerned(residual, xi, derivatives)
    if missing > 0:
        open_inputs = [unknowns[j] for j in under if unknowns[j].variable.causality == "input"]
        if open_inputs:
            return _open_input(open_inputs, missing, what, where)
        names = _listed([unknowns[j].name for j in under])
        what += f": {missing} too few. These unknowns are not all determined: {names}"
        remedy = "Add the missing equations, connect open connectors, or declare given signals as inputs."
        return ModelError("model-unbalanced", what, where=where, remedy=remedy)
    if (deep := _deep_connection(equations)) is not None:
        return _reaches_inside(*deep, -missing, what, where)
    listed = "\n".join(
        f"    {one.text}    ({_origin(one)})" for one in (equations[i] for i in over[:_LISTED])
    )
    names = _listed(
        sorted({unknowns[j].name for i in over for j in _unknowns_of(i, residual, xi, derivatives)})
    )
    what += f": {-missing} too many. These equations compete for {names or 'no unknown at all'}:\n{listed}"
    written = [equations[i] for i in over if equations[i].kind != "unconnected"]
    place: Place | str | None = written[-1].place if written else None
    remedy = "Remove an equation, or a binding of a variable that an equation determines as well."
    if len(written) < len(over):
        remedy += " What is given at a connector comes from a source that is connected to it."
    return ModelError("model-unbalanced", what, where=place or where, remedy=remedy)


def _origin(equation: Equation) -> str:
    """Where an equation comes from: one that nobody has written, by the connector that is left open."""
    if equation.kind == "unconnected":
        return f"nothing is connected to `{equation.origin}`"
    return str(equation.place or equation.origin)


def _count(n: int, word: str) -> str:
    return f"{n} {word}" + ("" if n == 1 else "s")


def _open_input(inputs: Sequence[Element], missing: int, what: str, where: str) -> ModelError:
    names = _listed([element.name for element in inputs])
    return ModelError(
        "model-unbalanced",
        f"{what}: nothing gives a value to {names}",
        where=where,
        remedy="Connect it, bind it (`source(V = u)`), or mark a noise by __Daest(noise = true).",
    )


def _deep_connection(equations: Sequence[Equation]) -> tuple[Equation, str] | None:
    """The sum of flows of a connection that reaches a connector inside of a component, which another
    connection balances already, with that connector."""
    sums = [one for one in equations if one.kind == "flow"]
    ends = [(one.origin or "").split(", ") for one in sums]
    counts = Counter(end for group in ends for end in group)
    for one, group in zip(sums, ends, strict=True):
        parts = [end.split(".") for end in group]
        owners = list(zip(*(part[:-1] for part in parts), strict=False))
        level = next((i for i, names in enumerate(owners) if len(set(names)) > 1), len(owners))
        for end, part in zip(group, parts, strict=True):
            if len(part) > level + 2 and counts[end] > 1:
                return one, end
    return None


def _reaches_inside(equation: Equation, end: str, surplus: int, what: str, where: str) -> ModelError:
    owner = end.rsplit(".", 2)[0]
    return ModelError(
        "model-unbalanced",
        f"{what}: {surplus} too many. A connection reaches `{end}` inside of `{owner}`, where it is "
        f"connected already: its flow is balanced twice, in `{equation.text}` once more",
        where=equation.place or where,
        remedy=f"Give the class of `{owner}` a connector of its own for it, and connect that one.",
    )


def _listed(names: Sequence[str]) -> str:
    return first_few([f"`{name}`" for name in names], _LISTED)


def _incidence(residual: ca.SX, xi: ca.SX, derivatives: ca.SX) -> sp.csr_array:
    found = sp.csr_array((residual.numel(), xi.numel()))
    for variables in (xi, derivatives):
        pattern = ca.jacobian_sparsity(residual, variables)
        entries = (np.ones(pattern.nnz()), (np.array(pattern.row()), np.array(pattern.get_col())))
        found = found + sp.csr_array(sp.coo_array(entries, shape=found.shape))
    return sp.csr_array(found)


def _concerned(residual: ca.SX, xi: ca.SX, derivatives: ca.SX) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Unknowns of the part with too few equations, and equations of the part with too many."""
    incidence = _incidence(residual, xi, derivatives)
    size = max(incidence.shape)
    square = sp.csr_array(
        (
            incidence.data,
            incidence.indices,
            np.append(incidence.indptr, [incidence.nnz] * (size - incidence.shape[0])),
        ),
        shape=(size, size),
    )
    defect = find_defect(square)
    if defect is None:
        return (), ()
    under = tuple(j for j in defect.under_columns if j < xi.numel())
    over = tuple(i for i in defect.over_rows if i < residual.numel())
    return under, over


def _unknowns_of(row: int, residual: ca.SX, xi: ca.SX, derivatives: ca.SX) -> list[int]:
    incidence = _incidence(residual[row], xi, derivatives)
    return [int(j) for j in incidence.indices]
