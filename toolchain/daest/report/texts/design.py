"""The next experiment as text."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from rich.console import RenderableType
from rich.text import Text

from daest.report.console import as_text, bracketed, heading, indented, listed, number, table

MOST_ALIASES = 2  # of a sensor that are named


@as_text
def text(document: Mapping[str, Any]) -> Iterator[RenderableType]:
    played = document["input"]
    yield Text(document["message"])
    where = f"in {played['file']}" if played["file"] else "not written; -o input.csv writes it"
    columns = ", ".join(played["columns"])
    yield indented(f"{columns} every {number(played['period'])} s, hold {played['hold']}: {where}")
    for note in document["notes"]:
        yield indented(note)
    yield heading("Inputs that were compared")
    yield _families(document)
    yield indented(f"value: {document['value_of']}")
    yield from _expected(document)
    for direction in document["open_directions"]:
        yield heading("Still told only together")
        yield indented(_direction(direction))
    yield from _sensors(document)
    yield from _safe(document)
    yield from _power(document)


def _families(document: Mapping[str, Any]) -> RenderableType:
    names = list(next((f["rms"] for f in document["families"] if f["rms"]), {}))
    rows = [
        (
            f["name"],
            number(f["value"], 3),
            *(number(f["rms"].get(n), 3) for n in names),
            f["shape"] or f["reason"],
        )
        for f in document["families"]
    ]
    columns = ("family", "value", *(f"rms of {n}" for n in names), "shape")
    return table(columns, rows, text_columns=(0, len(columns) - 1))


def _expected(document: Mapping[str, Any]) -> Iterator[RenderableType]:
    predicted, present, together = (document[key] for key in ("predicted", "present", "together"))
    parts = [part for part in (present, predicted, together) if part is not None]
    names = ("present", "designed", "both") if present is not None else ("designed",)
    if predicted["std_errors"]:
        yield heading("Expected standard errors")
        rows = [
            (name, *(number(part["std_errors"].get(name), 3) for part in parts))
            for name in predicted["std_errors"]
        ]
        yield table(("parameter", *names), rows)
    if predicted["log_likelihood_ratio"]:
        yield heading("Expected log-likelihood ratio, of the least favourable likely parameters")
        rows = [
            (pair, *(number(part["log_likelihood_ratio"].get(pair), 3) for part in parts))
            for pair in predicted["log_likelihood_ratio"]
        ]
        yield table(("pair", *names), rows)
    if predicted["smallest_size"] is not None:
        yield heading("Smallest size that is seen with 95 % power")
        yield table(names, [tuple(number(part["smallest_size"], 3) for part in parts)], text_columns=())


def _direction(direction: Mapping[str, Any]) -> str:
    names = " · ".join(
        name if weight == 1.0 else f"{name}^{number(weight)}"
        for name, weight in direction["combination"].items()
    )
    if direction["relative_std"] is None:
        return f"{names}: no input can tell them apart with these sensors"
    return f"{names}: common factor known to {number(100.0 * direction['relative_std'], 2)} %"


def _sensors(document: Mapping[str, Any]) -> Iterator[RenderableType]:
    if not document["sensors"]:
        return
    yield heading("What one more sensor would bring")
    rows = []
    for sensor in document["sensors"]:
        others = listed(sensor["same_as"], MOST_ALIASES) if sensor["same_as"] else ""
        gain = "determines them" if sensor["closes"] else number(sensor["gain"], 3)
        noise = f"{number(sensor['std'], 2)} {bracketed(sensor['unit'])}".strip()
        rows.append((sensor["variable"], noise, number(sensor["value"], 3), gain, others))
    yield table(("variable", "noise", "value", "times better", "the same as"), rows, text_columns=(0, 4))


def _safe(document: Mapping[str, Any]) -> Iterator[RenderableType]:
    if not document["safe"]:
        return
    yield heading("Safe ranges")
    rows = [
        (
            name,
            f"{number(s['limit'][0])} to {number(s['limit'][1])}",
            f"{number(s['reaches'][0])} to {number(s['reaches'][1])}",
            s["unit"],
            "-" if s["probability"] is None else f"{100 * s['probability']:.0f} %",
        )
        for name, s in document["safe"].items()
    ]
    yield table(("variable", "limit", "reaches", "unit", "leaves it with"), rows, text_columns=(0, 3))


def _power(document: Mapping[str, Any]) -> Iterator[RenderableType]:
    if not document["power"]:
        return
    yield heading("Power against length and amplitude")
    rows = [
        (
            number(p["length"]),
            f"{100 * p['amplitude']:.0f} %",
            f"{100 * p['power']:.0f} %",
            number(p["smallest_size"], 3),
        )
        for p in document["power"]
    ]
    yield table(("length [s]", "amplitude", "power", "seen from"), rows, text_columns=())
