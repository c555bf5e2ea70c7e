"""The parts of a report as values that the template writes out."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import SequenceMatcher
from typing import Any

from daest.lists import first_few
from daest.model.flat import Model
from daest.model.holds import hold_text
from daest.quantities import with_unit
from daest.report.console import number
from daest.report.documents.fit import FitDocument
from daest.report.documents.parts import facts
from daest.report.groups import component, of_component, owner
from daest.report.page import plots
from daest.report.page.material import Document, Material
from daest.report.page.plots import Plot

CLASS = "modelica"  # of the enclosing element


def added_lines(text: str, base: str) -> list[int]:
    """Numbers, from 1, of the lines of `text` that `base` does not have."""
    old, new = base.splitlines(), text.splitlines()
    blocks = SequenceMatcher(None, old, new, autojunk=False).get_matching_blocks()
    kept = {line for _, start, size in blocks for line in range(start, start + size)}
    return [i + 1 for i in range(len(new)) if i not in kept and new[i].strip()]


LEFT_OUT = "  // ..."  # unchanged lines between new ones


def addition(text: str, new: list[int]) -> str:
    """The lines `new` of the text, from 1; what is unchanged between them is a line of dots."""
    lines, parts, last = text.splitlines(), list[str](), None
    for row in new:
        between: list[str] = lines[last : row - 1] if last is not None else []
        parts += between if not any(line.strip() for line in between) else [LEFT_OUT]
        parts.append(lines[row - 1])
        last = row
    return "\n".join(parts)


def highlighted(text: str, new: list[int]) -> str:
    """HTML of a Modelica text with every character of it escaped; lines `new`, from 1, are marked."""
    from pygments import highlight
    from pygments.formatters import HtmlFormatter
    from pygments.lexers import ModelicaLexer

    return highlight(text, ModelicaLexer(), HtmlFormatter(cssclass=CLASS, hl_lines=new))


TESTS = {
    "whiteness": "whiteness",
    "input_independence": "independence of the inputs",
    "variable_independence": "independence of internal variables",
    "nis": "size (normalised innovations squared)",
}
DESIGNED = (("designed", "predicted"), ("present recordings", "present"), ("both", "together"))
MOST_DRAWN = 3000  # equations of a drawn structure
MOST_PLACES = 12  # of a list of places


@dataclass(frozen=True)
class Group:
    """A component with its equations, each as text and place in the source."""

    name: str
    equations: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Section:
    """A part of the page. `present` tells whether there is anything; if not, `made_by` says what makes it.
    `content` is what the template of this part reads."""

    id: str
    title: str
    made_by: str
    present: bool
    content: Mapping[str, Any] = field(default_factory=dict)
    plots: tuple[Plot, ...] = ()


def sections(material: Material) -> list[Section]:
    """All parts, the answer before what it rests on. Raises KeyError, TypeError or ValueError for a document
    that no command wrote."""
    return [
        _comparison(material),
        _failures(material.comparison),
        _diagnosis(material.diagnosis, material.ledger),
        _experiment(material),
        _improvement(material),
        _modelica(material),
        _estimation(material.fit),
        _residuals(material),
        _filter(material),
        _noise(material.noise),
        _model(material.flat),
        _origin(material),
    ]


@dataclass(frozen=True)
class Answer:
    """A sentence of the headline. `badges` stand before it, with their tones "good", "bad" or "verdict"."""

    label: str
    sentence: str
    badges: tuple[tuple[str, str], ...] = ()


TONES = {"supported": "good", "nothing missing": "good", "not falsified": "good", "falsified": "bad"}


def headline(material: Material) -> list[Answer]:
    """The answer at a glance: what is missing, what it brought, whether the data contradict the models."""
    found: list[Answer] = []
    if material.diagnosis is not None:
        message, verdict = material.diagnosis["message"].replace(" -> ", " → "), material.diagnosis["verdict"]
        found.append(Answer("what is missing", message, ((verdict, TONES.get(verdict, "verdict")),)))
    if material.ledger is not None:
        found.append(Answer("improvement", _ledger_sentence(material.ledger)))
    if material.comparison is not None:
        models = material.comparison["models"]
        verdicts = {m["verdict"] or "not tested" for m in models}
        badges = tuple((v, TONES.get(v, "verdict")) for v in sorted(verdicts)) if len(models) == 1 else ()
        found.append(Answer("data against model", _compared_sentence(material.comparison), badges))
    if material.fit is not None:
        found.append(Answer("fit", _fit_sentence(material.fit)))
    return found


def _compared_sentence(comparison: Document) -> str:
    """Errors of the first and the last model, and the verdicts."""
    models = comparison["models"]
    first, last = models[0], models[-1]
    errors = [
        f"{name}: error {number(first['rms'][name], 3)}"
        + (f" → {number(last['rms'][name], 3)}" if len(models) > 1 else "")
        + f" {unit}".rstrip()
        for name, unit in comparison["outputs"].items()
    ]
    verdicts = [f"{m['name']}: {m['verdict'] or 'not tested'}" for m in models]
    return f"{', '.join(errors)}. {'; '.join(verdicts)}"


def _fit_sentence(fit: Document) -> str:
    part = "validation" if "validation" in fit["fit_percent"] else "estimation"
    fits = [f"{name} {_percent(v)} %" for name, v in fit["fit_percent"].get(part, {}).items()]
    return f"{', '.join(fits)} of the {part} data simulated"


def _ledger_sentence(ledger: Document) -> str:
    added = [f"{s['added']} at {s['at']}" for s in ledger["steps"] if s["added"]]
    if not added:
        return f"Nothing added: {ledger['reason']}"
    first, last = (ledger["steps"][i]["rms"].get("validation", {}) for i in (0, -1))
    falls = [
        f"{name} from {number(first.get(name), 3)} to {number(last.get(name), 3)} {unit}"
        for name, unit in ledger["outputs"].items()
    ]
    return f"Added {', then '.join(added)}. Error on validation data: {'; '.join(falls)}"


def _model(flat: Model | None) -> Section:
    if flat is None:
        made_by = 'it takes a daest.toml with `[model] source = "..."`'
        return Section("model", "The model", made_by, False)
    groups: dict[str, list[tuple[str, str]]] = {}
    for equation in flat.equations:
        place = equation.place
        where = "" if place is None else f"{_file_name(place.file)}:{place.line or ''}".rstrip(":")
        groups.setdefault(component(equation.origin, equation.kind), []).append((equation.text, where))
    content = {
        "name": flat.name,
        "description": flat.description,
        "groups": [Group(name, tuple(rows)) for name, rows in groups.items()],
        "n": flat.n,
        "inputs": flat.inputs,
        "outputs": flat.outputs,
        "noises": flat.noises,
        "parameters": [p for p in flat.parameters if not p.is_memory],
        "unknowns": flat.unknowns,
    }
    return Section("model", "The model", "", True, content)


def _noise(document: Document | None) -> Section:
    title = "Where white noise may enter"
    if document is None:
        return Section("noise", title, "`daest noise` makes it", False)
    forbidden = [e for e in document["equations"] if not e["admissible"]]
    advice: dict[str, list[str]] = {}
    for equation in forbidden:
        advice.setdefault(equation["advice"], []).append(equation["text"])
    groups = [component(e["origin"], e.get("kind", "")) for e in document["equations"]]
    names = [u["name"] for u in document["structure"]["unknowns"]]
    columns = [owner(name) for name in names]
    content = {"document": document, "forbidden": forbidden, "advice": list(advice.items())}
    drawn = (plots.structure_plot(document, groups, columns),) if len(groups) <= MOST_DRAWN else ()
    return Section("noise", title, "", True, content, drawn)


def _estimation(fit: Document | None) -> Section:
    if fit is None:
        return Section("estimation", "Parameters and their uncertainty", "`daest identify` makes it", False)
    rows = [{"name": name, **p, "percent": _relative(p)} for name, p in fit["parameters"].items()]
    correlation = fit["correlation"]
    kept = [i for i, row in enumerate(correlation["matrix"]) if any(v is not None for v in row)]
    plot = plots.parameter_plot(fit)
    content = {
        "fit": fit,
        "facts": facts(FitDocument, fit),
        "hold": hold_text(fit["hold"]),
        "rows": rows,
        "names": [correlation["names"][i] for i in kept],
        "matrix": [[correlation["matrix"][i][j] for j in kept] for i in kept],
        "agreement": list(_agreement(fit)),
    }
    return Section(
        "estimation", "Parameters and their uncertainty", "", True, content, (plot,) if plot else ()
    )


def _agreement(fit: Document) -> Iterator[tuple[str, str, Any, Any, Any, Any]]:
    """Rows part, output, fit and rms of the simulation, fit and rms of the one-step predictions."""
    steps = fit["one_step"]
    for part, by_output in fit["fit_percent"].items():
        for output, percent in by_output.items():
            ahead = {kind: steps[kind].get(part, {}).get(output) for kind in ("fit_percent", "rms")}
            yield part, output, percent, fit["rms"][part][output], ahead["fit_percent"], ahead["rms"]


def _comparison(material: Material) -> Section:
    document, title = material.comparison, "Measured against model"
    if document is None:
        return Section("comparison", title, "`daest compare` makes it", False)
    drawn = tuple(plots.comparison_plots(document, material.comparison_series))
    spectra = tuple(plots.frequency_plots(document, material.comparison_series))
    content = {"document": document, "spectra": spectra, "rows": list(_compared(document))}
    return Section("comparison", title, "", True, content, drawn)


def _compared(document: Document) -> Iterator[dict[str, Any]]:
    """A row per model and output; `part` is the error as a share of the largest of its output, in percent."""
    for name, unit in document["outputs"].items():
        errors = [model["rms"][name] for model in document["models"]]
        largest = max((e for e in errors if e is not None), default=0.0)
        for m, (model, error) in enumerate(zip(document["models"], errors, strict=True)):
            part = 100.0 * error / largest if error is not None and largest > 0.0 else None
            yield {"m": m, "model": model, "output": name, "unit": unit, "rms": error, "part": part}


def _residuals(material: Material) -> Section:
    document, title = material.comparison, "What the errors say: residual tests"
    if document is None or not any(model["tests"] for model in document["models"]):
        return Section("residuals", title, "`daest compare` makes it", False)
    kinds = [kind for kind in TESTS if any(model["tests"].get(kind) for model in document["models"])]
    rows = [
        {
            "m": m,
            "model": model,
            "output": output,
            "tests": [model["tests"].get(kind, {}).get(output) for kind in kinds],
        }
        for m, model in enumerate(document["models"])
        for output in document["outputs"]
    ]
    drawn = tuple(plots.residual_plots(document, material.comparison_series))
    return Section("residuals", title, "", True, {"rows": rows, "tests": [TESTS[k] for k in kinds]}, drawn)


def _failures(document: Document | None) -> Section:
    title = "Where it fails"
    if document is None:
        return Section("failures", title, "`daest compare` makes it", False)
    rows = [
        {"m": m, "model": model, **finding}
        for m, model in enumerate(document["models"])
        for finding in model["where"]
    ]
    return Section("failures", title, "", True, {"rows": rows, "several": len(document["models"]) > 1})


def _filter(material: Material) -> Section:
    document, title = material.filter, "States and internal variables"
    if document is None:
        return Section("filter", title, "`daest filter` makes it", False)
    plot = plots.filter_plot(document, material.filter_series)
    return Section("filter", title, "", True, {"document": document}, (plot,) if plot else ())


def _diagnosis(document: Document | None, ledger: Document | None) -> Section:
    """The diagnosis, or that of the last round of an improvement."""
    title = "What is missing: the diagnosis"
    is_last = document is None and ledger is not None
    if document is None and ledger is not None:
        document = ledger.get("final")
    if document is None:
        return Section("diagnosis", title, "`daest diagnose` makes it", False)
    curve = document["disturbance"]
    drawn = [plots.screen_plot(document)]
    drawn += [plots.curve_plot("plot-curve", curve)] if curve else []
    content = {"document": document, "outputs": document["outputs"], "curve": curve, "is_last": is_last}
    return Section("diagnosis", title, "", True, content, tuple(plot for plot in drawn if plot))


def _experiment(material: Material) -> Section:
    document, title = material.design, "The next experiment"
    if document is None:
        return Section("experiment", title, "`daest design` makes it", False)
    parts = [(word, document[key]) for word, key in DESIGNED if document[key] is not None]
    content = {
        "document": document,
        "inputs": list(next((f["rms"] for f in document["families"] if f["rms"]), {})),
        "parts": [word for word, _ in parts],
        "rows": list(_promises([part for _, part in parts])),
    }
    drawn = [plots.input_plot(document, material.design_series), plots.power_plot(document)]
    return Section("experiment", title, "", True, content, tuple(plot for plot in drawn if plot))


def _promises(parts: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, list[float | None]]]:
    """Rows of what recordings bring: standard errors, log-likelihood ratios, the smallest size."""
    for name in parts[0]["std_errors"]:
        yield f"standard error of {name}", [part["std_errors"].get(name) for part in parts]
    for pair in parts[0]["log_likelihood_ratio"]:
        ratios = [part["log_likelihood_ratio"].get(pair) for part in parts]
        yield f"expected log-likelihood ratio of {pair}", ratios
    if any(part["smallest_size"] is not None for part in parts):
        yield "smallest size that is seen with 95 % power", [part["smallest_size"] for part in parts]


def _improvement(material: Material) -> Section:
    ledger, title = material.ledger, "The ledger: step by step"
    if ledger is None:
        return Section("ledger", title, "`daest improve` makes it", False)
    curves = [
        (i, step["disturbance"], plots.curve_plot(f"plot-curve-{i}", step["disturbance"]))
        for i, step in enumerate(ledger["steps"])
        if step.get("disturbance")
    ]
    content = {
        "document": ledger,
        "rows": [
            {**step, "sizes": _sizes(step, step), "last": _sizes(step, ledger["steps"][-1])}
            for step in ledger["steps"]
        ],
        "curves": curves,
    }
    return Section("ledger", title, "", True, content, tuple(plots.staircase_plots(ledger)))


def _sizes(step: Mapping[str, Any], model: Mapping[str, Any]) -> list[str]:
    """The parameters of the effect that a step added, as the `model` of a step has them."""
    if not step["component"]:
        return []
    own = of_component(model["parameters"], step["component"])
    return [f"{name} = {_with_error(p)}" for name, p in own.items()]


def _with_error(p: Mapping[str, Any]) -> str:
    error = "" if p["std_error"] is None else f" ± {p['std_error']:.2g}"
    return with_unit(f"{p['value']:.4g}{error}", p["unit"])


def _modelica(material: Material) -> Section:
    title = "The extended model as Modelica"
    texts = dict(material.sources) or _proposed(material.diagnosis)
    if not texts:
        made_by = "`daest improve` makes it, and `daest diagnose` where it finds an effect"
        if material.ledger is not None:
            unwritten = [s for s in material.ledger["steps"] if s["added"] and not s["model"]]
            made_by = "`daest improve` has found nothing to add"
            if unwritten:
                added = ", ".join(f"{s['added']} at {s['at']}" for s in unwritten)
                made_by = (
                    f"what `daest improve` has added ({added}) is not written: {unwritten[0]['model_reason']}"
                )
        return Section("modelica", title, made_by, False)
    base, shown = material.base or "", []
    for name, text in texts.items():
        new = added_lines(text, base)
        shown.append(
            {
                "name": name,
                "addition": highlighted(addition(text, new), []),
                "whole": highlighted(text, new),
                "new": new,
            }
        )
        base = text if material.sources else base
    return Section("modelica", title, "", True, {"texts": shown})


def _proposed(diagnosis: Document | None) -> dict[str, str]:
    """Models that a diagnosis proposes, by what they add."""
    if diagnosis is None:
        return {}
    found = {f"{c['effect']} at {c['at']}": c["model"] for c in diagnosis["candidates"] if c.get("model")}
    load = diagnosis.get("disturbance")
    if load and load.get("model"):
        found[f"a load at {load['place']} over {load['label']}"] = load["model"]
    return found


def _origin(material: Material) -> Section:
    content = {"versions": material.versions, "trace": material.trace}
    return Section("origin", "To do it again", "`daest identify` makes it", bool(material.versions), content)


def _relative(parameter: Mapping[str, Any]) -> float | None:
    if parameter["std_error"] is None or not parameter["value"]:
        return None
    return 100.0 * parameter["std_error"] / abs(parameter["value"])


def _percent(value: Any) -> str:
    return "-" if value is None or not math.isfinite(value) else f"{value:.1f}"


def _file_name(path: str) -> str:
    return path.replace("\\", "/").rpartition("/")[2]


def places(names: Sequence[str]) -> str:
    """Names with commas, the rest counted."""
    return first_few(names, MOST_PLACES)
