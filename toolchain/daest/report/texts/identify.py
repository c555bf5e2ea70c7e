"""The fit report: parameters with their uncertainty, what the data cannot tell, and how well the model
fits."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from rich.console import RenderableType
from rich.text import Text

from daest.report.console import as_text, heading, indented, number, percent, table
from daest.report.documents.fit import FitDocument
from daest.report.documents.parts import facts

STRONG_CORRELATION = 0.95  # from here on a pair is listed


@as_text
def text(document: Mapping[str, Any]) -> Iterator[RenderableType]:
    yield Text(document["message"])
    period = document.get("period")
    yield indented(
        f"{document['n_samples']} samples"
        + (f" at {number(period, 6)} {document.get('clock', 's')}" if period else ", uneven times")
        + ", ".join(["", f"hold {document['hold']}", *facts(FitDocument, document)])
    )
    for note in document.get("notes", ()):
        yield indented(note)
    yield heading("Parameters")
    yield _parameters(document["parameters"])
    if document.get("profiles"):
        yield heading("Profile likelihood")
        yield _profiles(document)
    if document.get("bootstrap"):
        yield heading(_bootstrap_title(document["bootstrap"]))
        yield _bootstrap(document)
    yield heading("Noise")
    yield _noise(document["noise"])
    for direction in document["weak_directions"]:
        yield heading("The data cannot tell these apart")
        yield indented(_direction(direction))
    pairs = _strong_pairs(document["correlation"])
    if pairs:
        yield heading("Strong correlations")
        yield indented(", ".join(f"{a} and {b}: {value:.3f}" for a, b, value in pairs))
    yield heading("Fit")
    yield _fits(document)


def _parameters(parameters: Mapping[str, Mapping[str, Any]]) -> RenderableType:
    return table(
        ("name", "estimate", "std error", "%", "unit", "start", ""),
        (
            (
                name,
                number(p["value"], 6),
                number(p["std_error"], 2),
                _relative(p),
                p["unit"],
                number(p["initial"]),
                _remark(p),
            )
            for name, p in parameters.items()
        ),
        text_columns=(0, 4, 6),
    )


def _profiles(document: Mapping[str, Any]) -> RenderableType:
    """Intervals of the profiles; an end that was not found says why."""
    parameters = document["parameters"]
    return table(
        ("name", "from", "estimate", "to", "unit", "level", ""),
        (
            (
                name,
                number(p["lower"], 6),
                number(parameters[name]["value"], 6),
                number(p["upper"], 6),
                parameters[name]["unit"],
                f"{100 * p['level']:g} %",
                ", ".join(
                    f"{side} {_END_TEXTS[p[end]]}"
                    for side, end in (("below", "lower_end"), ("above", "upper_end"))
                    if p[end] in _END_TEXTS
                ),
            )
            for name, p in document["profiles"].items()
        ),
        text_columns=(0, 4, 6),
    )


def _bootstrap_title(found: Mapping[str, Any]) -> str:
    failed = f", {found['n_failed']} more came to no end" if found["n_failed"] else ""
    return f"Bootstrap: {found['n']} refits of simulated recordings{failed}"


def _bootstrap(document: Mapping[str, Any]) -> RenderableType:
    """Percentile intervals, and where the estimates lie on average."""
    parameters, found = document["parameters"], document["bootstrap"]
    return table(
        ("name", "from", "estimate", "to", "mean", "std", "unit", "level"),
        (
            (
                name,
                number(p["lower"], 6),
                number(parameters[name]["value"], 6),
                number(p["upper"], 6),
                number(p["mean"], 6),
                number(p["std"], 2),
                parameters[name]["unit"],
                f"{100 * found['level']:g} %",
            )
            for name, p in found["parameters"].items()
        ),
        text_columns=(0, 6),
    )


_END_TEXTS = {
    "open": "open: the data set no limit",
    "bound": "limited by its bound",
    "failed": "the model cannot be evaluated further out",
}


def _remark(p: Mapping[str, Any]) -> str:
    remarks = [f"at its {p['at_bound']}"] if p["at_bound"] else []
    prior = p.get("prior")
    remarks += [f"prior {number(prior['mean'])} ± {number(prior['std'], 2)}"] if prior else []
    return ", ".join(remarks)


def _relative(p: Mapping[str, Any]) -> str:
    if p["std_error"] is None or not p["value"]:
        return "-"
    percent = 100.0 * p["std_error"] / abs(p["value"])
    return number(percent, 2 if percent < 100.0 else 3)


def _noise(noise: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> RenderableType:
    return table(
        ("name", "", "size", "std error", "unit", ""),
        (
            (
                name,
                quantity,
                number(n[quantity]),
                number(n["std_error"], 2),
                _noise_unit(n["unit"], quantity),
                f"at its {n['at_bound']}" if n["at_bound"] else "" if n["estimated"] else "given",
            )
            for kind, quantity in (("process", "intensity"), ("measurement", "std"))
            for name, n in noise[kind].items()
        ),
        text_columns=(0, 1, 4, 5),
    )


def _noise_unit(unit: str, quantity: str) -> str:
    """The unit of a standard deviation is that of the signal; that of an intensity is unit² s."""
    if quantity == "std":
        return unit
    if unit in ("", "1"):
        return "s"
    return f"({unit})2.s" if "." in unit or "/" in unit else f"{unit}2.s"


def _direction(direction: Mapping[str, Any]) -> str:
    product = " · ".join(
        name if exponent == 1 else f"{name}^{number(exponent, 3)}"
        for name, exponent in direction["combination"].items()
    )
    relative = direction["relative_std"]
    size = "without limit" if relative is None else f"by a factor of 1 ± {number(relative, 2)}"
    return f"along {product} everything may move {size}"


def _strong_pairs(correlation: Mapping[str, Any]) -> list[tuple[str, str, float]]:
    names, matrix = correlation["names"], correlation["matrix"]
    return [
        (names[i], names[j], matrix[i][j])
        for i in range(len(names))
        for j in range(i)
        if matrix[i][j] is not None and abs(matrix[i][j]) >= STRONG_CORRELATION
    ]


def _fits(document: Mapping[str, Any]) -> RenderableType:
    one_step = document["one_step"]
    return table(
        ("data", "output", "simulation fit %", "rms", "one-step fit %", "rms"),
        (
            (
                part,
                output,
                percent(fit),
                number(document["rms"][part][output]),
                percent(one_step["fit_percent"][part][output]),
                number(one_step["rms"][part][output]),
            )
            for part, fits in document["fit_percent"].items()
            for output, fit in fits.items()
        ),
        text_columns=(0, 1),
    )
