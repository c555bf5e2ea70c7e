"""The noise report as text: which equations may carry white noise."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import PurePath
from typing import Any

from rich.console import RenderableType
from rich.text import Text

from daest.report.console import as_text, heading, indented, listed, number, table

FEW = 8  # equations up to which each that may carry noise is shown with its text
MOST_NAMES = 24  # places that are named; the rest is counted
SUMS = ("flow", "unconnected")  # kinds of equations that are named by their first flow
HOW = (
    "such a name or number goes behind --at, or into daest.toml: "
    '[noise.process] "{name}" = {{ estimate = true }}'
)


@as_text
def text(document: Mapping[str, Any]) -> Iterator[RenderableType]:
    """The answers first: verdicts on what was declared and asked for, and where noise may be put; then the
    equations that may not carry any, and what all this rests on."""
    yield Text(
        f"{document['n_equations']} equations, {document['n_dynamic']} dynamic, index {document['index']}; "
        f"{_forbidden(document['n_forbidden'])}"
    )
    yield from _exact(document)
    yield from _declared(document)
    yield from _admissible([e for e in document["equations"] if e["admissible"]])
    if "along" in document:
        yield from _along(document["along"], document["n_equations"])
    yield from _refused([e for e in document["equations"] if not e["admissible"]])
    yield from _decisions(document)


def _declared(document: Mapping[str, Any]) -> Iterator[RenderableType]:
    """Verdicts on the noises of the model, and on the places that were asked for."""
    if not document["annotated"] and not document["asked"]:
        yield heading("Noise of the model")
        yield indented("none: declare it in the model (Daest.Noise) or in daest.toml ([noise.process])")
    for key, title in (("annotated", "Noise of the model"), ("asked", "Places that were asked for")):
        if document[key]:
            yield heading(title)
            yield _noises(document[key])
            for advice in dict.fromkeys(entry["advice"] for entry in document[key] if entry["advice"]):
                yield indented(advice)


def _admissible(equations: Sequence[Mapping[str, Any]]) -> Iterator[RenderableType]:
    """Where white noise may be put: sums of flows by the name of a flow, other equations by their numbers."""
    if not equations:
        return
    yield heading("White noise may act here")
    if len(equations) <= FEW:
        for equation in equations:
            yield indented(f"{equation['index']}: {equation['text']}")
        yield indented(HOW.format(name=equations[0]["index"]))
        return
    sums = {e["index"]: e["text"].split()[0] for e in equations if e["kind"] in SUMS}
    components: dict[str, list[str]] = {}
    for equation in equations:
        if equation["index"] not in sums:
            components.setdefault(equation["origin"] or "the model", []).append(str(equation["index"]))
    if sums:
        yield indented(f"at connectors: {listed(list(dict.fromkeys(sums.values())), MOST_NAMES, len(sums))}")
    if components:
        inside = [f"{name} {', '.join(numbers)}" for name, numbers in components.items()]
        yield indented(f"in equations, by their numbers: {listed(inside, MOST_NAMES, separator='; ')}")
    yield indented(HOW.format(name=next(iter(sums.values()), equations[0]["index"])))


def _refused(equations: Sequence[Mapping[str, Any]]) -> Iterator[RenderableType]:
    if not equations:
        return
    yield heading("No white noise here")
    yield table(
        ("eq", "equation", "place", "norm", "would contain differentiated noise"),
        (
            (
                str(e["index"]),
                e["text"],
                _short(e["place"]) or e["origin"],
                number(e["projection_norm"], 3),
                listed(e["differentiated"], 3, e["n_differentiated"]),
            )
            for e in equations
        ),
        text_columns=(1, 2, 4),
    )
    yield from _advice(equations)


def _decisions(document: Mapping[str, Any]) -> Iterator[RenderableType]:
    """Singular values and ranks that the verdicts rest on."""
    yield heading("Rank decisions")
    singular = [value for value in document["N_singular_values"] if value]
    if document["N_singular_values"] or document["index"] < 2:
        yield indented(f"singular values of N: {listed([number(value) for value in singular])}")
    yield table(
        ("what", "rank", "threshold", "gap"),
        (
            (d["what"], str(d["rank"]), number(d["threshold"], 2), number(d["gap"], 2) if d["gap"] else "inf")
            for d in document["decisions"]
        ),
    )


NAMES = {"index": "index", "n_dynamic": "dynamic modes", "equations": "equations", "noises": "noises"}


EXACTLY = {"parameters": "for almost every value of the parameters", "numbers": "by exact arithmetic"}


def _exact(document: Mapping[str, Any]) -> Iterator[RenderableType]:
    """What holds exactly, and for almost every θ; where it is otherwise here, and what is undecided."""
    generic = document["generic"]
    if generic is not None:
        is_general = generic["of"] == "parameters"
        if document["differs"]:
            scope = EXACTLY[generic["of"]] + f": index {generic['index']}, {generic['n_dynamic']} dynamic, "
            scope += f"{len(generic['forbidden'])} equations without white noise; otherwise here:"
        else:
            scope = "decided by exact arithmetic"
            scope += "; the same for almost every value of the parameters" if is_general else ""
        yield indented(scope)
    for difference in document["differs"]:
        which = listed([str(i) for i in difference["equations"]] or difference["noises"])
        yield indented(f"  {NAMES[difference['what']]}{' ' if which else ''}{which}: {difference['reason']}")
    for doubt in document["undecided"]:
        yield indented(f"UNDECIDED: {doubt}")


def _forbidden(n: int) -> str:
    if n == 0:
        return "all of them may carry white noise"
    return f"{n} equation{'s' if n > 1 else ''} may not carry white noise"


def _along(along: Mapping[str, Any], n_equations: int) -> Iterator[RenderableType]:
    """Verdicts along a trajectory."""
    yield heading("Along the trajectory")
    if along["same_everywhere"]:
        yield indented("The model is affine: the verdicts hold everywhere.")
        return
    times = along["times"]
    structures = listed([f"{s['n_dynamic']} dynamic, index {s['index']}" for s in along["structures"]])
    always = n_equations - len(along["equations"])
    yield indented(
        f"{len(times)} points, t = {number(times[0])} to {number(times[-1])} s: {structures}; {always} of "
        f"{n_equations} equations may carry white noise at all of them"
    )
    if along["generic"] is not None:
        generic, points = along["generic"], along["generic_points"]
        where = "at all of them" if points == len(times) else f"at {points} of them, the others are special"
        yield indented(
            f"{EXACTLY[generic['of']]}: index {generic['index']}, {generic['n_dynamic']} dynamic, "
            f"{len(generic['forbidden'])} equations without white noise ({where})"
        )
    if len(along["modes"]) > 1:
        yield from _modes(along["modes"])
    for point in along["unjudged"]:
        yield indented(f"t = {number(point['time'])} s could not be judged: {point['reason']}")
    mixed = [e for e in along["equations"] if e["forbidden_share"] < 1.0]
    named = [*along["annotated"], *along["asked"]]
    if mixed or named:
        yield table(
            ("eq or noise", "", "not admissible", "first at", "largest norm", "would be differentiated in"),
            (
                (
                    str(e.get("index", "")) or e["name"],
                    e["name"] if "index" in e else "",
                    f"{100 * e['forbidden_share']:.0f} %" if e["forbidden_share"] else "never",
                    "" if e["first_time"] is None else f"{number(e['first_time'], 3)} s",
                    number(e["largest_norm"], 3),
                    listed(e["differentiated"], 3, e["n_differentiated"]),
                )
                for e in (*mixed, *named)
            ),
            text_columns=(0, 1, 5),
        )


def _modes(modes: Sequence[Mapping[str, Any]]) -> Iterator[RenderableType]:
    """One line per mode of a model with events."""
    yield table(
        ("mode", "share", "first at", "structure", "eqs without", "not admissible"),
        (
            (
                mode["mode"],
                f"{100 * mode['share']:.0f} %",
                f"{number(mode['first_time'], 3)} s",
                listed([f"{s['n_dynamic']} dynamic, index {s['index']}" for s in mode["structures"]])
                or "singular",
                str(mode["n_forbidden"]),
                ", ".join(mode["forbidden"]) or "none",
            )
            for mode in modes
        ),
        text_columns=(0, 3, 5),
    )


def _advice(forbidden: Sequence[Mapping[str, Any]]) -> Iterator[RenderableType]:
    """Every advice once, behind the numbers of the equations that it is for."""
    equations: dict[str, list[str]] = {}
    for entry in forbidden:
        if entry["advice"]:
            equations.setdefault(entry["advice"], []).append(str(entry["index"]))
    for advice, numbers in equations.items():
        yield indented(f"{', '.join(numbers)}: {advice}")


def _short(place: str | None) -> str:
    """The place without its folder; the document keeps the whole of it."""
    return PurePath(place).name if place else ""


def _noises(entries: Sequence[Mapping[str, Any]]) -> RenderableType:
    return table(
        ("name", "equations", "admissible", "white outputs"),
        (
            (
                entry["name"],
                ", ".join(map(str, entry["equations"])),
                "yes" if entry["admissible"] else "NO",
                ", ".join(entry["white_outputs"]),
            )
            for entry in entries
        ),
        text_columns=(0, 1, 2, 3),
    )
