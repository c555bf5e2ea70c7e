"""The linear DAE as text: sizes, poles, transfer functions and which entries depend on parameters."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rich.console import RenderableType
from rich.text import Text

from daest.report.console import as_text, heading, indented, listed, number, table


@as_text
def text(document: Mapping[str, Any], symbolic: bool = False) -> Iterator[RenderableType]:
    """With `symbolic` the entries that depend on parameters, as expressions."""
    yield Text(
        f"{document['n_equations']} equations, {document['n_dynamic']} dynamic, index {document['index']} "
        f"(source: {document['source']})"
    )
    for key in ("inputs", "outputs", "noises"):
        yield indented(f"{key}: {listed(_names(document[key]))}")
    if document.get("cross_check") is not None:
        yield indented(
            f"cross-check between sources: largest difference {number(document['cross_check'], 2)}"
        )
    for note in document.get("notes", ()):
        yield indented(note)
    yield heading("Parameters")
    yield table(
        ("name", "value", "unit", "min", "max", "estimated"),
        (
            (
                p["name"],
                number(p["value"], 6),
                p["unit"],
                number(p["min"]),
                number(p["max"]),
                "yes" if p["estimate"] else "",
            )
            for p in document["parameters"]
        ),
        text_columns=(0, 2, 5),
    )
    yield heading("Poles")
    yield indented(", ".join(_complex(pole) for pole in document["poles"]) or "none")
    if document["transfer_functions"]:
        yield heading("Transfer functions")
        for entry in document["transfer_functions"]:
            yield indented(f"{entry['input']} -> {entry['output']}:  {_ratio(entry)}")
    for decision in document["decisions"]:
        if decision["warning"]:
            yield indented(f"doubtful rank: {decision['warning']}")
    if document["theta"] and not symbolic:
        count = len(document["theta"])
        depend = "entries depend" if count > 1 else "entry depends"
        yield indented(f"{count} {depend} on parameters: see --symbolic")
    elif document["theta"]:
        yield heading(f"Entries that depend on parameters ({len(document['theta'])})")
        yield table(
            ("entry", "expression", "parameters"),
            (
                (
                    f"{e['matrix']}[{e['row']}, {e['column']}]",
                    e["expression"],
                    ", ".join(e["parameters"]),
                )
                for e in document["theta"]
            ),
            text_columns=(0, 1, 2),
        )


def _names(entries: Sequence[Any]) -> list[str]:
    return [entry if isinstance(entry, str) else entry["name"] for entry in entries]


def _complex(pole: Sequence[float]) -> str:
    real, imaginary = pole
    if not imaginary:
        return number(real, 6)
    sign = "-" if imaginary < 0 else "+"
    return f"{number(real, 6)} {sign} {number(abs(imaginary), 6)}i"


def _ratio(entry: Mapping[str, Any]) -> str:
    if not any(entry["num"]):
        return "0"
    return f"({_polynomial(entry['num'])}) / ({_polynomial(entry['den'])})"


def _polynomial(coefficients: Sequence[float]) -> str:
    """Highest power first."""
    order = len(coefficients) - 1
    terms = []
    for position, value in enumerate(coefficients):
        if not value and order:
            continue
        power = order - position
        factor = "" if power == 0 else "s" if power == 1 else f"s^{power}"
        shown = "" if factor and value == 1.0 else number(value, 5)
        terms.append(" ".join(part for part in (shown, factor) if part))
    return " + ".join(terms).replace("+ -", "- ") or "0"
