"""The comparison of models as text."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from rich.console import RenderableType
from rich.text import Text

from daest.quantities import spoken_duration
from daest.report.console import as_text, heading, indented, number, percent, table

_TESTS = {
    "whiteness": "white",
    "input_independence": "independent of the inputs",
    "variable_independence": "independent of the variables",
    "nis": "of the predicted size",
}


@as_text
def text(document: Mapping[str, Any]) -> Iterator[RenderableType]:
    models = document["models"]
    yield Text(f"On {', '.join(document['data'])}")
    rows = (_row(model, output, unit) for output, unit in document["outputs"].items() for model in models)
    columns = ("output", "model", "parameters", "simulation fit %", "rms", "one-step fit %", "rms", "unit")
    yield table(columns, rows, text_columns=(0, 1, 7))
    if len(models) > 1:
        yield from _falling(document)
    if any(model["growth"] for model in models):
        yield from _growth(document)
    for model in models:
        yield from _judgement(model)


def _row(model: Mapping[str, Any], output: str, unit: str) -> tuple[str, ...]:
    one_step = model["one_step"]
    return (
        output,
        model["name"],
        str(model["n_parameters"]),
        percent(model["fit_percent"].get(output)),
        number(model["rms"].get(output)),
        percent(one_step["fit_percent"].get(output)),
        number(one_step["rms"].get(output)),
        unit,
    )


def _falling(document: Mapping[str, Any]) -> Iterator[RenderableType]:
    """From the first model to the last: simulation error and BIC."""
    first, last = document["table"][0], document["table"][-1]
    for output in document["outputs"]:
        before, after = first["rms"].get(output), last["rms"].get(output)
        if before and after:
            ratio = before / after
            change = f"{ratio:.3g} times smaller" if ratio >= 1.0 else f"{1.0 / ratio:.3g} times larger"
            change = "the same" if f"{ratio:.3g}" == "1" else change
            yield indented(f"{output}: simulation error {change} from {first['model']} to {last['model']}")
    ranked = [row for row in document["table"] if row["bic"] is not None and row["bic"] == row["bic"]]
    if len(ranked) > 1:
        best = min(ranked, key=lambda row: row["bic"])
        others = [f"{row['model']} +{row['bic'] - best['bic']:.4g}" for row in ranked if row is not best]
        yield indented(f"BIC: {best['model']} is best, {', '.join(others)}")


def _growth(document: Mapping[str, Any]) -> Iterator[RenderableType]:
    seconds = dict.fromkeys(h["seconds"] for model in document["models"] for h in model["growth"])
    yield heading("rms error of predictions over")
    rows = []
    for output, unit in document["outputs"].items():
        for model in document["models"]:
            ahead = {h["seconds"]: h["rms"].get(output) for h in model["growth"]}
            cells = (number(ahead.get(s), 3) for s in seconds)
            rows.append((output, model["name"], *cells, number(model["rms"].get(output), 3), unit))
    columns = ("output", "model", *map(spoken_duration, seconds), "whole", "unit")
    yield table(columns, rows, text_columns=(0, 1, len(columns) - 1))


def _judgement(model: Mapping[str, Any]) -> Iterator[RenderableType]:
    if model["verdict"] is not None:
        yield heading(f"{model['name']}: {model['verdict']}")
    rows = [
        (_TESTS.get(kind, kind), output, *_test(test))
        for kind, by_output in model["tests"].items()
        for output, test in by_output.items()
    ]
    if rows:
        columns = ("one-step errors are", "output", "statistic", "limit", "p", "")
        yield table(columns, rows, text_columns=(0, 1, 5))
    for finding in model["where"]:
        yield indented(finding["text"])
    for remark in model["notes"]:
        yield indented(f"{model['name']}: {remark}")


def _test(test: Mapping[str, Any]) -> tuple[str, ...]:
    band = test.get("band")
    limit = number(test["limit"]) if band is None else f"{number(band[0])} to {number(band[1])}"
    return number(test["statistic"]), limit, number(test["p_value"], 2), "" if test["pass"] else "no"
