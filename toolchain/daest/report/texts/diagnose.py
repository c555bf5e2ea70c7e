"""A diagnosis as text: the answer first, then the candidates, the places, and what to record next."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rich.console import RenderableType
from rich.text import Text

from daest.lists import first_few
from daest.quantities import with_unit
from daest.report.console import as_text, heading, indented, number, probability, table

LEAST_GAIN = 1.0  # of log-likelihood: a load that buys less is not listed
BAND = 1.96  # standard deviations to either side of a 95 % band
MOST_SCREENED = 6  # of the screen, where no candidate was refitted
WITH_CURVE = ("unknown effect",)  # verdicts that rest on the curve of the load
MOST_GROUP = 3  # places of a group that are named


@as_text
def text(document: Mapping[str, Any]) -> Iterator[RenderableType]:
    yield Text(f"{document['verdict'].capitalize()}.", style="bold")
    yield indented(document["message"])
    yield from restriction(document["searched"])
    if document["next_experiment"]:
        yield indented(f"Next: {document['next_experiment']}")
    if document["candidates"]:
        yield heading("Candidates, refitted (rms errors of the simulation on validation data)")
        yield from candidates(document)
        yield from remark(document)
    if document["screen"]["n_screened"]:
        yield heading(f"Screen: {document['screen']['n_screened']} candidates")
        yield from _screen(document["screen"])
    loaded = [p for p in document["places"] if (p["log_likelihood_gain"] or 0.0) > LEAST_GAIN]
    if loaded:
        yield heading("Where an unexplained load would act")
        yield _places(loaded)
    if document["verdict"] in WITH_CURVE and _is_curve(document["disturbance"]):
        yield from _disturbance(document["disturbance"])
    yield indented(f"{number(document['seconds'], 3)} s")


def restriction(searched: Mapping[str, Sequence[str]]) -> Iterator[RenderableType]:
    """Words for a search that was restricted by name: the library was not searched for the rest."""
    effects, places = ", ".join(searched["effects"]), ", ".join(searched["places"])
    if effects or places:
        at = f" at {places}" if places else ""
        yield indented(f"Only {effects or 'effects'}{at} was searched for.")


def candidates(document: Mapping[str, Any]) -> Iterator[RenderableType]:
    """The candidates that were refitted, and what is to be said of each."""
    yield _refitted(document)
    for candidate in document["candidates"]:
        yield from _remarks(candidate)


def _refitted(document: Mapping[str, Any]) -> RenderableType:
    """Validation errors of the model as it is, and with each of the candidates."""
    outputs = document["outputs"]
    first = ("the model as it is", "", *_errors(document["baseline"], outputs), "", "", "")
    rows = [
        (
            _named(c),
            c["at"],
            *_errors(c, outputs),
            number(c["delta_bic"]),
            "-" if c["explained"] is None else f"{100 * c['explained']:.0f} %",
            c["verdict"],
        )
        for c in document["candidates"]
    ]
    errors = [f"{name} [{unit or '1'}]" for name, unit in outputs.items()]
    columns = ("effect", "place", *errors, "BIC gain", "explained", "verdict")
    return table(columns, [first, *rows], text_columns=(0, 1, len(columns) - 1))


def remark(document: Mapping[str, Any]) -> Iterator[RenderableType]:
    """How the errors of the model as it is were found, where that is not as in a comparison."""
    if "remark" in document["baseline"]:
        yield indented(document["baseline"]["remark"])


def _errors(entry: Mapping[str, Any], outputs: Mapping[str, str]) -> list[str]:
    errors = entry["rms"].get("validation", {})
    return [number(errors.get(name), 3) for name in outputs]


def fed(name: str, entry: Mapping[str, Any]) -> str:
    """The `name` of an effect with the signals that feed it, if an entry of a document has any."""
    signals = ", ".join(entry.get("inputs", {}).values())
    return f"{name} ({signals})" if signals else name


def _named(candidate: Mapping[str, Any]) -> str:
    return fed(candidate["effect"], candidate)


def _label(candidate: Mapping[str, Any]) -> str:
    return f"{_named(candidate)} at {candidate['at']}"


def size(name: str, parameter: Mapping[str, Any]) -> str:
    error = "" if parameter["std_error"] is None else f" ± {number(parameter['std_error'], 2)}"
    told = with_unit(f"{number(parameter['value'])}{error}", parameter["unit"])
    return f"{name} = {told}"


def _remarks(candidate: Mapping[str, Any]) -> Iterator[RenderableType]:
    told = candidate["parameters"] | candidate.get("known_products", {})
    sizes = ", ".join(size(name, p) for name, p in told.items())
    said = [candidate["reason"]] if candidate["reason"] else []
    if candidate["not_separable_from"]:
        said.append(f"not separable from {', '.join(candidate['not_separable_from'])}")
    if candidate["equivalent_places"]:
        said.append(f"the sensors see it alike at {grouped(candidate['equivalent_places'])}")
    if candidate["model_reason"]:
        said.append(f"no Modelica model: {candidate['model_reason']}")
    parts = [part for part in (sizes, *said) if part]
    yield indented(f"{_label(candidate)}: {'; '.join(parts)}" if parts else _label(candidate))


def _screen(screen: Mapping[str, Any]) -> Iterator[RenderableType]:
    rows = [
        (
            _label(e),
            number(e["score"], 3),
            number(e["p_value"], 2),
            f"{number(e['detectable'], 2)} {e['unit'] if e['unit'] != '1' else ''}".rstrip(),
        )
        for e in _distinct(screen["best"])[:MOST_SCREENED]
    ]
    if rows:
        yield table(("effect at place", "score", "p (corrected)", "would be seen from"), rows)
    reasons = dict.fromkeys(s["reason"] for s in screen["skipped"])
    for reason in reasons:
        count = sum(s["reason"] == reason for s in screen["skipped"])
        yield indented(f"{count} not screened: {reason}")


def _distinct(entries: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """The best shape of every effect at every place."""
    found: dict[str, Mapping[str, Any]] = {}
    for entry in entries:
        found.setdefault(_label(entry), entry)
    return list(found.values())


def _places(places: Sequence[Mapping[str, Any]]) -> RenderableType:
    rows = [
        (grouped(p["group"]), number(p["log_likelihood_gain"]), number(p["size"], 3), p["unit"])
        for p in sorted(places, key=lambda p: -(p["log_likelihood_gain"] or 0.0))
    ]
    return table(("place", "log-likelihood gain", "size", "unit"), rows, text_columns=(0, 3))


def grouped(names: Sequence[str]) -> str:
    return first_few(names, MOST_GROUP)


def _is_curve(disturbance: Mapping[str, Any] | None) -> bool:
    """Whether a load follows a variable anywhere beyond the band of its curve, or one refitted is told."""
    if disturbance is None or disturbance.get("learned"):
        return disturbance is not None
    return any(s is None or abs(w) > BAND * s for _, w, s in disturbance["curve"])


def _disturbance(disturbance: Mapping[str, Any]) -> Iterator[RenderableType]:
    yield heading(
        f"Unexplained load at {disturbance['place']} follows {disturbance['label']} "
        f"({probability(disturbance['p_value'], 1)})"
    )
    units = disturbance["variable_unit"] or "1", disturbance["unit"] or "1"
    learned = disturbance.get("learned")
    rows = [
        (number(x, 3), number(w, 3), "-" if s is None else number(BAND * s, 2))
        for x, w, s in (learned or disturbance)["curve"]
    ]
    yield table(
        (f"{disturbance['variable']} [{units[0]}]", _load_label(disturbance, units[1]), "± 95 %"), rows, ()
    )
    yield from _learned(disturbance)


def _learned(disturbance: Mapping[str, Any]) -> Iterator[RenderableType]:
    """Where the model with the curve is, and how the curve was found."""
    learned = disturbance.get("learned")
    if not learned:
        return
    how = (
        "refitted in the model" if learned["refitted"] else "read off the residuals, since no refit succeeded"
    )
    parameters = ", ".join(size(name, p) for name, p in learned["model_parameters"].items())
    yield indented(f"The curve was {how}" + (f", with {parameters}." if parameters else "."))
    if disturbance["model"]:
        yield indented("The extended model is `disturbance.model` of the json result (--format json).")
    elif disturbance["model_reason"]:
        yield indented(f"No Modelica model: {disturbance['model_reason']}")


def _load_label(disturbance: Mapping[str, Any], unit: str) -> str:
    sign_of = disturbance["sign_of"]
    return f"load [{unit}] where {sign_of} > 0" if sign_of else f"load [{unit}]"
