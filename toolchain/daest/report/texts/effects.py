"""The effect library as text: a table of all effects, or everything about one."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from rich.console import RenderableType
from rich.text import Text

from daest.report.console import as_text, bracketed, heading, indented, listed, number, table

_SHOWN_ALONE = 3  # effects that are shown in full; more become a table


@as_text
def text(document: Mapping[str, Any]) -> Iterator[RenderableType]:
    if len(document["effects"]) <= _SHOWN_ALONE:
        for effect in document["effects"]:
            yield from _one(effect)
        return
    for domain in dict.fromkeys(effect["domain"] for effect in document["effects"]):
        yield heading(domain)
        chosen = [effect for effect in document["effects"] if effect["domain"] == domain]
        rows = [(e["name"], e["law"], ", ".join(_sizes(e)), _where(e)) for e in chosen]
        yield table(("effect", "law", "size", "sits"), rows, text_columns=(0, 1, 2, 3))
    yield Text("\ndaest effects NAME shows one of them; daest extend puts it into a model.")


def _sizes(effect: Mapping[str, Any]) -> list[str]:
    """Names and units of the sizes; those of an array once."""
    found = {p["name"].partition("[")[0]: p["unit"] for p in effect["parameters"] if p["role"] == "size"}
    return [f"{name} {bracketed(unit)}".strip() for name, unit in found.items()]


def _where(effect: Mapping[str, Any]) -> str:
    if effect["places"] is None:
        return str(effect["sits"])
    return listed([place["name"] for place in effect["places"]], most=4)


def _one(effect: Mapping[str, Any]) -> Iterator[RenderableType]:
    yield heading(f"{effect['name']} ({effect['class']})")
    yield Text(effect["description"])
    yield indented(f"law: {effect['law']}")
    yield indented(f"sits {effect['sits']}")
    if effect["places"] is not None:
        yield indented(f"places in this model: {listed([p['name'] for p in effect['places']])}")
    if effect["inputs"]:
        kind = "variables of the model" if effect["attach"] == "parameter" else "measured signals"
        yield indented(f"{kind}: {', '.join(effect['inputs'])}")
    yield Text("")
    rows = [_parameter(p) for p in effect["parameters"]]
    columns = ("parameter", "role", "start", "min", "max", "unit", "meaning")
    yield table(columns, rows, text_columns=(0, 1, 5, 6))
    if effect["documentation"]:
        yield Text(f"\n{effect['documentation']}")


def _parameter(parameter: Mapping[str, Any]) -> tuple[str, ...]:
    about = parameter["description"]
    if parameter["from"]:
        about += f" (from {parameter['from']} of the component)"
    values = [number(parameter[key]) for key in ("start", "min", "max")]
    return (parameter["name"], parameter["role"], *values, parameter["unit"], about)
