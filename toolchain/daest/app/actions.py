"""From a click to the `daest` lines that do it. Only what stands here can be started from the page, with
names that the project itself has brought forth."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from daest.app.story import NAME, RIVALS, Story, comparison_file, diagnosis_file, rivals_file
from daest.errors import ConfigError

CHECK = "check.json"
DESIGNED = "next_input.csv"  # the input that tells apart what the diagnosis leaves, or the parameters
MOST_RIVALS = 4  # that are laid over each other
DIGITS = 6  # of the size of an effect, which the fit that follows starts from
Lines = list[list[str]]
Asked = Mapping[str, Any]


@dataclass(frozen=True)
class Standing:
    """What a click meets: the folder, the home of the page as seen from it, the story, the names of the
    model's parameters, the diagnosis of the current model, and the files that may be named."""

    folder: Path
    home: str
    story: Story
    parameters: tuple[str, ...]
    diagnosis: Mapping[str, Any] | None
    files: tuple[str, ...]

    @property
    def model(self) -> str:
        return self.story.step.model

    def chosen(self) -> list[str]:
        """The option that names the current model, where it is not that of daest.toml."""
        return [] if self.story.current == 0 else ["--model", self.model]


def lines(action: str, asked: Asked, standing: Standing) -> Lines:
    """The lines of an action. Raises ConfigError `app-request` for anything that the page does not ask."""
    if action not in ACTIONS:
        raise _refused(f"there is no action '{action}'")
    return ACTIONS[action](asked, standing)


def candidate(asked: Asked, diagnosis: Mapping[str, Any] | None) -> Mapping[str, Any]:
    """The candidate of the diagnosis that a request names. Raises ConfigError `app-request`."""
    for found in (diagnosis or {}).get("candidates", []):
        if found["effect"] == asked.get("effect") and found["at"] == asked.get("at"):
            return found
    raise _refused("the diagnosis has no such candidate")


def _init(asked: Asked, standing: Standing) -> Lines:
    model, data = asked.get("model"), asked.get("data")
    for name in (model, data):
        if name not in standing.files:
            raise _refused(f"the folder has no file '{name}'")
    return [["init", str(model), str(data), "--format", "json"], *_check(asked, standing)]


def _check(_: Asked, standing: Standing) -> Lines:
    return [["check", "-o", f"{standing.home}/{CHECK}"]]


def _identify(asked: Asked, standing: Standing) -> Lines:
    fixed = []
    for name, value in _values(asked.get("locked"), standing).items():
        fixed += ["--fix", f"{name}={value!r}"]
    return [["identify", *standing.chosen(), *fixed], *_compare(asked, standing)]


def _compare(_: Asked, standing: Standing) -> Lines:
    path = standing.story.path()
    named = [] if len(path) == 1 else [step.model for step in path]
    target = f"{standing.home}/{comparison_file(standing.story.current)}"
    return [["compare", *named, "-o", target]]


def _diagnose(_: Asked, standing: Standing) -> Lines:
    target = f"{standing.home}/{diagnosis_file(standing.story.current)}"
    return [["diagnose", *standing.chosen(), "-o", target]]


def _add(asked: Asked, standing: Standing) -> Lines:
    """`standing` has the new step already."""
    step = standing.story.step
    parent = standing.story.steps[step.parent or 0]
    found = candidate(asked, standing.diagnosis)
    return [
        _extend(found, [] if parent.number == 0 else [parent.model], step.model),
        ["identify", "--model", step.model],
        *_compare(asked, standing),
    ]


def _extend(found: Mapping[str, Any], model: list[str], target: str) -> list[str]:
    """The line that writes a model with a candidate in it."""
    sizes: list[str] = []
    for name, entry in found["parameters"].items():
        if isinstance(entry["value"], int | float) and math.isfinite(entry["value"]):
            sizes += ["--set", f"{name}={entry['value']:.{DIGITS}g}"]
    effect = ["--effect", str(found.get("class", found["effect"])), "--at", str(found["at"])]
    return ["extend", *model, *effect, *sizes, "-o", target]


def rivals(diagnosis: Mapping[str, Any] | None) -> list[Mapping[str, Any]]:
    """The candidates that a diagnosis could not tell apart and that can be written as models, best first;
    empty where there are no two of them."""
    candidates = (diagnosis or {}).get("candidates", [])
    found = [one for one in candidates if one["verdict"] != "rejected" and one.get("model")]
    return found[:MOST_RIVALS] if len(found) > 1 else []


def _rivals(_: Asked, standing: Standing) -> Lines:
    """Every rival as a model, all of them refitted and compared."""
    number = standing.story.current
    written, files = [], []
    for i, found in enumerate(rivals(standing.diagnosis), 1):
        files.append(f"{standing.home}/{RIVALS}/{number}_{i}_{NAME.sub('_', str(found['effect']))}.mo")
        written.append(_extend(found, [] if number == 0 else [standing.model], files[-1]))
    if not files:
        raise _refused("the diagnosis left no two candidates")
    target = f"{standing.home}/{rivals_file(number)}"
    return [*written, ["compare", standing.model, *files, "--refit", "-o", target]]


ACTIONS: dict[str, Callable[[Asked, Standing], Lines]] = {
    "init": _init,
    "check": _check,
    "identify": _identify,
    "compare": _compare,
    "diagnose": _diagnose,
    "design": lambda _, standing: [["design", *standing.chosen(), "-o", DESIGNED]],
    "add": _add,
    "rivals": _rivals,
    "improve": lambda _, standing: [["improve", *standing.chosen()]],
    "noise": lambda *_: [["noise"]],
    "report": lambda *_: [["report"]],
}

PLAIN = (
    "check",
    "identify",
    "compare",
    "diagnose",
    "design",
    "improve",
    "noise",
    "report",
)  # that need no choice


def _values(given: Any, standing: Standing) -> dict[str, float]:
    """Values of parameters of the model by name."""
    if given is None:
        return {}
    if not isinstance(given, dict):
        raise _refused("values by name are expected")
    for name, value in given.items():
        if name not in standing.parameters:
            raise _refused(f"the model has no parameter '{name}'")
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise _refused(f"the value of '{name}' is no number")
    return {name: float(value) for name, value in given.items()}


def _refused(what: str) -> ConfigError:
    return ConfigError("app-request", what, remedy="load the page again")
