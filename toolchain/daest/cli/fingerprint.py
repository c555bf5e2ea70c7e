"""What a fit was made of: the fingerprint of a model, and how the model at hand differs from it."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from daest.cli.kept import fingerprint
from daest.model.flat import FlatModel, Model

MOST_NAMED = 4  # parameters


def model_fingerprint(flat: Model, source: Path) -> dict[str, Any]:
    """Values of all parameters before the fit, and digests of the equations and of every output.

    Comments, bounds, marks and noises do not count: a fit stays right when they change. Of an FMU without
    equations the file counts.
    """
    values = {p.name: p.value for p in flat.parameters}
    if not isinstance(flat, FlatModel):
        return {"values": values, "equations": fingerprint(source), "outputs": {}}
    texts = [e.text for e in (*flat.equations, *flat.initial_equations)]
    texts += [f"{d.name} = {d.expression}" for d in flat.derived_parameters]
    expressions = [str(flat.output_expressions[i]) for i in range(len(flat.outputs))]
    digests = {y.name: _digest([text]) for y, text in zip(flat.outputs, expressions, strict=True)}
    return {"values": values, "equations": _digest(texts), "outputs": digests}


def differences(then: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """How a model differs from what it was, one phrase each; none where `then` is no fingerprint."""
    if not {"values", "equations", "outputs"} <= then.keys():
        return []
    moved = [
        f"{name} is {now['values'][name]:g} and was {value:g}"
        for name, value in then["values"].items()
        if now["values"].get(name, value) != value
    ]
    if len(moved) > MOST_NAMED:
        moved = [*moved[:MOST_NAMED], f"{len(moved) - MOST_NAMED} more values"]
    equations = ["its equations are others"] if then["equations"] != now["equations"] else []
    outputs = [
        f"the output {name} is another"
        for name, digest in then["outputs"].items()
        if now["outputs"].get(name, digest) != digest
    ]
    return [*moved, *equations, *outputs]


def _digest(texts: Sequence[str]) -> str:
    return hashlib.sha256("\n".join(texts).encode()).hexdigest()
