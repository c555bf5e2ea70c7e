"""The models that were tried on the page: a tree of steps, each with one effect more than its parent.

The tree stands in `story.json`, the errors of a step in the comparison that was made when it was added. A
step that is taken back stays in the tree, as a branch not taken.
"""

from __future__ import annotations

import json
import re
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from daest.errors import ConfigError, Place
from daest.files import whole_file

FILE = "story.json"
MODELS, STEPS, DIAGNOSES, RIVALS = "models", "steps", "diagnoses", "rivals"  # folders
NAME = re.compile(r"[^A-Za-z0-9_]")


@dataclass(frozen=True)
class Step:
    """A model: the one of daest.toml (number 0), or `parent` with the effect `added` at the place `at`.
    `model` counts from the folder of the project."""

    number: int
    parent: int | None
    model: str
    added: str | None = None
    at: str | None = None
    time: float = 0.0


@dataclass(frozen=True)
class Story:
    """All steps; `current` is the one that commands work on."""

    steps: tuple[Step, ...]
    current: int = 0

    @property
    def step(self) -> Step:
        return self.steps[self.current]

    def path(self) -> list[Step]:
        """From the first model to the current one."""
        found = [self.step]
        while found[0].parent is not None:
            found.insert(0, self.steps[found[0].parent])
        return found

    def added(self, home: str, effect: str, at: str) -> Story:
        """With a new step below the current one, which becomes the current one."""
        number = len(self.steps)
        model = f"{home}/{MODELS}/{number}_{NAME.sub('_', effect)}.mo"
        step = Step(number, self.current, model, effect, at, time.time())
        return Story((*self.steps, step), number)

    def standing_at(self, number: int) -> Story:
        """With another current step. Raises ConfigError `app-request`."""
        if not 0 <= number < len(self.steps):
            raise ConfigError("app-request", f"there is no step {number}", remedy="load the page again")
        return replace(self, current=number)


def read_story(home: Path, source: str) -> Story:
    """The story of a project whose model is `source`; a new one where there is none, or of another model.

    Raises ConfigError `results-unreadable` for a damaged file.
    """
    path = home / FILE
    if not path.is_file():
        return Story((Step(0, None, source),))
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        steps = tuple(Step(**entry) for entry in content["steps"])
        story = Story(steps, int(content["current"]))
        _check(story)
    except (OSError, ValueError, KeyError, TypeError, IndexError, RecursionError) as error:
        raise ConfigError(
            "results-unreadable",
            f"the steps of the page cannot be read: {type(error).__name__}",
            where=Place(str(path)),
            remedy="remove the file; the models beside it stay",
        ) from error
    return story if steps[0].model == source else Story((Step(0, None, source),))


def _check(story: Story) -> None:
    """Raises ValueError for steps that no page has written: numbers in order, parents before children."""
    for number, step in enumerate(story.steps):
        is_rooted = step.parent is None if number == 0 else step.parent in range(number)
        if step.number != number or not is_rooted or not isinstance(step.model, str):
            raise ValueError("steps out of order")
    if story.current not in range(len(story.steps)):
        raise ValueError("no current step")


def keep_story(home: Path, story: Story) -> None:
    """Raises OSError."""
    content = {"current": story.current, "steps": [asdict(step) for step in story.steps]}
    with whole_file(home / FILE) as temporary:
        temporary.write_text(json.dumps(content, indent=1), encoding="utf-8")


def comparison_file(number: int) -> str:
    """Where the comparison of a step with its predecessors stands, from the home of the page on."""
    return f"{STEPS}/{number}.json"


def rivals_file(number: int) -> str:
    """Where the comparison of the rivals of a step's diagnosis stands, from the home of the page on."""
    return f"{RIVALS}/{number}.json"


def diagnosis_file(number: int) -> str:
    return f"{DIAGNOSES}/{number}.json"


def step_errors(document: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """What a step's own comparison says of its model, the last one in it."""
    if not document or not document.get("models"):
        return None
    model = document["models"][-1]
    return {"rms": model["rms"], "fit_percent": model["fit_percent"], "verdict": model["verdict"]}
