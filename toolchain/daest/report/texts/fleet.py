"""A fleet as text: what was found, groups, spread of the parameters, and the machines that need a look."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Any

from rich.console import RenderableType
from rich.text import Text

from daest.report.console import as_text, heading, indented, listed, number, percent, table

MOST_ROWS = 40  # machines in the table; the others are in the file of -o


@as_text
def text(document: Mapping[str, Any]) -> Iterator[RenderableType]:
    machines = document["machines"]
    found = Counter(m["verdict"] or "no verdict" for m in machines if m["status"] != "failed")
    counted = ", ".join(f"{count} {verdict}" for verdict, count in found.most_common())
    yield Text(
        f"{len(machines)} machines with {document['model']}: {counted or 'none could be examined'}; "
        f"{document['n_failed']} failed"
    )
    if document["groups"]:
        yield heading("Missing effects")
        rows = [
            (g["effect"], g["at"], str(len(g["machines"])), listed(g["machines"], most=6))
            for g in document["groups"]
        ]
        yield table(("effect", "at", "machines", ""), rows, text_columns=(0, 1, 3))
    if document["spread"]:
        yield heading("Parameters of the machines that nothing is missing from")
        sizes = [
            (name, number(s["mean"]), number(s["std"]), number(s["mean_std_error"]), str(s["n"]))
            for name, s in document["spread"].items()
        ]
        columns = ("parameter", "mean", "std over the fleet", "own std error", "machines")
        yield table(columns, sizes, text_columns=(0,))
    if document["odd"]:
        yield heading("Odd ones")
        odd = [
            (o["machine"], o["parameter"], number(o["value"]), f"{o['distance']:.1f}")
            for o in document["odd"][:MOST_ROWS]
        ]
        yield table(("machine", "parameter", "value", "distance"), odd, text_columns=(0, 1))
    yield heading("Machines")
    yield from _machines(machines)


def _machines(machines: list[Mapping[str, Any]]) -> Iterator[RenderableType]:
    failed = [m for m in machines if m["status"] == "failed"]
    missing = [m for m in machines if m["effect"] is not None]
    others = [m for m in machines if m["status"] != "failed" and m["effect"] is None]
    shown = (failed + missing + others)[:MOST_ROWS]
    yield table(("machine", "fit %", "verdict", "missing"), [_row(m) for m in shown], text_columns=(0, 2, 3))
    if len(machines) > len(shown):
        yield indented(f"and {len(machines) - len(shown)} more: all are in the file of -o")


def _row(machine: Mapping[str, Any]) -> tuple[str, ...]:
    if machine["status"] == "failed":
        return machine["name"], "", "failed", machine["message"]
    fits = ", ".join(percent(value) for value in machine["fit_percent"].values())
    if machine["effect"] is None:
        return machine["name"], fits, machine["verdict"] or "no verdict", ""
    size = "" if machine["size"] is None else f" ({number(machine['size'])} {machine['size_unit']})"
    return machine["name"], fits, machine["verdict"], f"{machine['effect']} at {machine['at']}{size}"
