"""The ledger of `daest improve` as text: what was added, how the error fell, and why it stopped."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rich.console import RenderableType
from rich.text import Text

from daest.model.holds import Hold, hold_text
from daest.report.console import as_text, heading, indented, number, table
from daest.report.groups import of_component
from daest.report.texts import diagnose


@as_text
def text(document: Mapping[str, Any]) -> Iterator[RenderableType]:
    yield Text(f"{_summary(document)}.", style="bold")
    yield indented(f"Stopped: {document['reason']}")
    yield from diagnose.restriction(document["searched"])
    if document["final"]["next_experiment"]:
        yield indented(f"Next: {document['final']['next_experiment']}")
    yield heading("Ledger (rms errors of the simulation on validation data)")
    yield _ledger(document)
    for i, step in enumerate(document["steps"]):
        yield from _remarks(i, step, is_last=step is document["steps"][-1])
    yield from _in_the_end(document["steps"])
    yield from _held(document.get("hold"))
    yield from diagnose.remark(document["final"])
    if document["folder"]:
        yield indented(f"models, ledger.json and staircase.png are in {document['folder']}")
    if document["final"]["candidates"]:
        yield heading("In the last round")
        yield from diagnose.candidates(document["final"])


def _summary(document: Mapping[str, Any]) -> str:
    added = [f"{_added(step)} at {step['at']}" for step in document["steps"] if step["added"]]
    return f"Added {', then '.join(added)}" if added else "Nothing added"


def _added(step: Mapping[str, Any]) -> str:
    """The effect of a step; empty where it added none."""
    return diagnose.fed(step["added"] or "", step)


def _ledger(document: Mapping[str, Any]) -> RenderableType:
    outputs = document["outputs"]
    rows = [
        (
            str(i),
            _added(step) or "the model as it is",
            step["at"] or "",
            *(number(step["rms"].get("validation", {}).get(o), 3) for o in outputs),
            number(step.get("delta_bic")),
        )
        for i, step in enumerate(document["steps"])
    ]
    errors = [f"{name} [{unit or '1'}]" for name, unit in outputs.items()]
    return table(("", "added", "place", *errors, "BIC gain"), rows, text_columns=(0, 1, 2))


def _remarks(i: int, step: Mapping[str, Any], is_last: bool) -> Iterator[RenderableType]:
    """Size of the effect that was added, and what else is to be said of the step. A size that nothing tells
    before a later effect is there is told in the last model alone."""
    if step["added"] is None:
        return
    products = (diagnose.size(name, p) for name, p in step.get("known_products", {}).items())
    sizes = ", ".join(filter(None, (_sizes(step, step, is_last), *products)))
    alike = diagnose.grouped(step["equivalent_places"])
    seen = f"; the sensors see it alike at {alike}" if alike else ""
    file = step["model"] or f"not written: {step['model_reason']}"
    told = f"{sizes}; {step['remark']}" if sizes else step["remark"]
    yield indented(f"step {i}: {told}{seen}; {file}")


def _held(hold: Hold | None) -> Iterator[RenderableType]:
    """What the inputs do between the samples, as the data chose it or the project says: a dead time is told
    half a sample longer on straight lines than on held inputs."""
    if hold is not None:
        words = hold_text(hold)
        yield indented(f"{words[0].upper()}{words[1:]} (hold {hold}).")


def _in_the_end(steps: Sequence[Mapping[str, Any]]) -> Iterator[RenderableType]:
    """The sizes of the earlier effects beside the later ones."""
    earlier = [step for step in steps if step["added"]][:-1]
    told = [
        f"{_added(step)} at {step['at']}: {sizes}" for step in earlier if (sizes := _sizes(step, steps[-1]))
    ]
    if told:
        yield indented(f"in the last model: {'; '.join(told)}")


def _sizes(step: Mapping[str, Any], model: Mapping[str, Any], every: bool = True) -> str:
    """The parameters of the effect that a step has added, as the `model` of a step has them: `every` one, or
    those with an uncertainty."""
    own = of_component(model["parameters"], step["component"])
    told = {name: p for name, p in own.items() if every or p["std_error"] is not None}
    return ", ".join(diagnose.size(name, p) for name, p in told.items())
