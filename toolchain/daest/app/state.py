"""What the page shows, read from the files of the folder: there is no other state."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from daest.app.actions import CHECK, PLAIN, Standing, candidate, lines, rivals
from daest.app.jobs import SCRIPT, jobs, shown
from daest.app.story import (
    Step,
    Story,
    comparison_file,
    diagnosis_file,
    read_story,
    rivals_file,
    step_errors,
)
from daest.data import FORMATS
from daest.data.project import FILE_NAME, Project, load_project
from daest.errors import ConfigError, DaestError
from daest.files import MODEL_SUFFIXES, whole_file
from daest.report.page.sections import added_lines

HOME = "results/app"  # from the folder of the project on
REPORT = "report.html"
BESIDE = "beside"  # folder of candidates as they were opened, in HOME
NAME_LENGTH = 100  # characters of the name of such a file
RECORDINGS = tuple(FORMATS)
MOST_FILES = 200  # of a folder that are offered
MOST_JOBS = 12  # that are shown
LARGEST = 64_000_000  # bytes of a document that is read


@dataclass(frozen=True)
class Desk:
    """The folder of a project, and where the page keeps its own files."""

    folder: Path

    @property
    def home(self) -> Path:
        return self.folder / HOME

    def project(self) -> Project | None:
        """None where there is no daest.toml. Raises DaestError."""
        path = self.folder / FILE_NAME
        return load_project(path) if path.exists() else None

    def story(self) -> Story:
        """Raises DaestError."""
        project = self.project()
        source = "" if project is None or project.source is None else self.named(project.source)
        return read_story(self.home, source)

    def named(self, path: Path) -> str:
        """A file as the commands in the folder call it."""
        try:
            return path.resolve().relative_to(self.folder.resolve()).as_posix()
        except ValueError:
            return str(path)

    def files(self) -> tuple[str, ...]:
        """Names of models and recordings in the folder, without those that look like options."""
        try:
            with os.scandir(self.folder) as entries:
                names = sorted(e.name for e in entries if e.is_file() and not e.name.startswith(("-", ".")))
        except OSError:
            return ()
        return tuple(n for n in names if n.lower().endswith((*MODEL_SUFFIXES, *RECORDINGS)))[:MOST_FILES]

    def standing(self) -> Standing:
        """Raises DaestError."""
        story = self.story()
        fit = self.fit(story)
        return Standing(
            folder=self.folder,
            home=HOME,
            story=story,
            parameters=tuple((fit or {}).get("theta", {})),
            diagnosis=self.diagnosis(story.step),
            files=self.files(),
        )

    def read(self, name: str) -> dict[str, Any] | None:
        """A document of the page's own."""
        return read_json(self.home / name)

    def kept(self, name: str, step: Step) -> dict[str, Any] | None:
        """A document that a command left in `results/`, if it was made from the model of the step."""
        document = read_json(self.folder / "results" / f"{name}.json") or {}
        files = (document.get("made_from") or {}).get("files", [])
        models = [file["path"] for file in files if file["role"] == "model"]
        return document if models == [step.model] else None

    def diagnosis(self, step: Step) -> dict[str, Any] | None:
        """The newest diagnosis of the model of a step, whether it was made here or on the command line."""
        return self.kept("diagnosis", step) or self.read(diagnosis_file(step.number))

    def beside(self, asked: Mapping[str, Any]) -> tuple[str, str]:
        """The current model, and the same with a candidate of its diagnosis, which is written anew. Raises
        DaestError and OSError."""
        standing = self.standing()
        found = candidate(asked, standing.diagnosis)
        if not found.get("model"):
            raise ConfigError(
                "app-request",
                f"{found['effect']} at {found['at']} cannot be written as Modelica",
                remedy=found.get("model_reason") or "open another candidate",
            )
        name = "".join(c if c.isalnum() else "_" for c in f"{found['effect']}_{found['at']}")
        target = self.home / BESIDE / f"{name[:NAME_LENGTH]}.mo"
        target.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(target) as temporary:
            temporary.write_text(found["model"], encoding="utf-8")
        return standing.story.step.model, f"{HOME}/{BESIDE}/{target.name}"

    def simulated(self) -> tuple[str, tuple[Any, ...]]:
        """The current model, and what changes whenever its simulation may. Raises DaestError."""
        model = self.story().step.model
        results = self.folder / "results"
        files = (
            self.folder / model,
            self.folder / FILE_NAME,
            results / "fit.json",
            *results.glob("fits/*.json"),
        )
        return model, tuple(stat_of(file) for file in files)

    def fit(self, story: Story) -> dict[str, Any] | None:
        """The fit of the current model that was kept last."""
        results = self.folder / "results"
        for path in (results / "fit.json", *sorted(results.glob("fits/*.json"))):
            document = read_json(path)
            if document and self._is_of(document, story.step.model):
                return document
        return None

    def _is_of(self, document: Mapping[str, Any], model: str) -> bool:
        key = document.get("model")
        return isinstance(key, Mapping) and key.get("source") == model


def stat_of(path: Path) -> tuple[str, int, int] | None:
    try:
        about = path.stat()
    except OSError:
        return None
    return str(path), about.st_mtime_ns, about.st_size


def read_json(path: Path) -> dict[str, Any] | None:
    """A JSON object; None where there is none, or none that can be read."""
    try:
        if path.stat().st_size > LARGEST:
            return None
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None


def signature(desk: Desk) -> tuple[Any, ...]:
    """Changes whenever something changes that the page shows."""
    return tuple(_stamps(desk))


def _stamps(desk: Desk) -> Iterator[tuple[str, int, int]]:
    results = desk.folder / "results"
    folders = (desk.folder, results, results / "fits", results / "diagnosis", results / "improve", desk.home)
    own = tuple(desk.home / name for name in ("models", "steps", "diagnoses", "rivals"))
    last = sorted((desk.home / "jobs").glob("*"))[-2:]
    for folder in (*folders, *own, *last):
        try:
            with os.scandir(folder) as entries:
                for entry in sorted(entries, key=lambda e: e.name):
                    about = entry.stat()
                    # A folder counts by its content; its own times change with temporary files.
                    if not entry.is_dir() and not entry.name.startswith(".daest-"):
                        yield f"{folder}/{entry.name}", about.st_mtime_ns, about.st_size
        except OSError:
            yield str(folder), 0, 0


def state(desk: Desk) -> dict[str, Any]:
    """Everything that the page shows but its pictures."""
    if not desk.folder.is_dir():
        return {"gone": True, "folder": str(desk.folder)}
    found: dict[str, Any] = {"gone": False, "folder": str(desk.folder), "title": desk.folder.resolve().name}
    found["files"] = list(desk.files())
    found["check"] = desk.read(CHECK)
    found["jobs"] = [job.document() for job in jobs(desk.home)[-MOST_JOBS:]]
    found["script"] = _text(desk.home / SCRIPT)
    found["has_report"] = (desk.folder / REPORT).is_file()
    found["error"] = None
    found["project"] = None
    try:
        project, story = desk.project(), desk.story()
    except DaestError as problem:
        return {**found, "error": str(problem)}
    found["project"] = None if project is None else _project(desk, project)
    found["story"] = _story(desk, story)
    found["fit"] = desk.fit(story)
    found["comparison"] = _comparison(desk, story)
    found["diagnosis"] = _diagnosis(desk, story.step)
    earlier = [_diagnosis(desk, step) for step in story.path()[-2::-1]]
    found["earlier"] = next((one for one in earlier if one), None)
    found["design"] = _design(read_json(desk.folder / "results" / "design.json"))
    found["rivals"] = _rivals(desk, story)
    found["arrived"] = _arrived(desk)
    found["commands"] = _commands(desk)
    found["ledger"] = _ledger(read_json(desk.folder / "results" / "improve" / "ledger.json"))
    return found


def _commands(desk: Desk) -> dict[str, list[str]]:
    """The lines of the actions that need no more than a click."""
    standing = desk.standing()
    names = (*PLAIN, "rivals") if rivals(standing.diagnosis) else PLAIN
    return {name: preview(lines(name, {}, standing)) for name in names}


def _project(desk: Desk, project: Project) -> dict[str, Any]:
    return {
        "file": FILE_NAME,
        "source": None if project.source is None else desk.named(project.source),
        "class": project.class_name,
        "estimate": [desk.named(path) for path in project.estimate],
        "validate": [desk.named(path) for path in project.validate],
        "split": project.preparation.split,
        "inputs": dict(project.inputs),
        "outputs": dict(project.outputs),
        "text": _text(desk.folder / FILE_NAME),
    }


def _story(desk: Desk, story: Story) -> dict[str, Any]:
    on_path = {step.number for step in story.path()}
    steps = []
    for step in story.steps:
        steps.append(
            {
                "number": step.number,
                "parent": step.parent,
                "model": step.model,
                "added": step.added,
                "at": step.at,
                "current": step.number == story.current,
                "on_path": step.number in on_path,
                "errors": _errors(desk, step),
                "lines": _difference(desk, story, step.number),
            }
        )
    return {"current": story.current, "steps": steps}


def _errors(desk: Desk, step: Step) -> dict[str, Any] | None:
    """Of the comparison that was made with the step; of the first model also of one made without the page."""
    own = desk.read(comparison_file(step.number))
    if own is None and step.number == 0:
        own = desk.kept("comparison", step)
    return step_errors(own)


def _difference(desk: Desk, story: Story, number: int) -> list[dict[str, Any]]:
    """The lines that a step adds to the model of its parent."""
    step = story.steps[number]
    if step.parent is None:
        return []
    text = _text(desk.folder / step.model)
    return new_lines(text, _text(desk.folder / story.steps[step.parent].model))


def new_lines(text: str, base: str) -> list[dict[str, Any]]:
    """Lines of `text` that `base` does not have, with their numbers."""
    rows = text.splitlines()
    return [{"number": i, "text": rows[i - 1]} for i in added_lines(text, base)]


def _comparison(desk: Desk, story: Story) -> dict[str, Any] | None:
    """The comparison that was kept last; `current` tells whether it is of the current path."""
    document = read_json(desk.folder / "results" / "comparison.json")
    if document is None or not document.get("models"):
        return None
    own = desk.read(comparison_file(story.current))
    names = [model["name"] for model in document["models"]]
    return {**document, "current": own is not None and names == [model["name"] for model in own["models"]]}


def _rivals(desk: Desk, story: Story) -> dict[str, Any] | None:
    """The errors of the rivals of the current step, and whether they are what was compared last."""
    own = desk.read(rivals_file(story.current))
    if own is None or not own.get("models"):
        return None
    last = read_json(desk.folder / "results" / "comparison.json") or {}
    names = [[model["name"] for model in one.get("models", [])] for one in (own, last)]
    errors = [{"name": model["name"], "rms": model["rms"]} for model in own["models"]]
    return {"models": errors, "outputs": own["outputs"], "shown": names[0] == names[1]}


def _diagnosis(desk: Desk, step: Step) -> dict[str, Any] | None:
    """The diagnosis of the model of a step, with the lines that each candidate adds to it."""
    document = desk.diagnosis(step)
    if document is None:
        return None
    base = _text(desk.folder / step.model)
    candidates = []
    for found in document["candidates"]:
        text = found.pop("model", None)
        candidates.append({**found, "lines": new_lines(text, base) if text else []})
    document.pop("made_from", None)
    return {**document, "candidates": candidates}


def _arrived(desk: Desk) -> list[dict[str, Any]]:
    """Candidates that the run of the newest refit has brought so far, oldest first."""
    folder = desk.folder / "results" / "diagnosis"
    try:
        files = sorted(folder.glob("*.json"), key=lambda file: file.stat().st_mtime)
    except OSError:
        return []
    found = []
    for file in files:
        about = (read_json(file) or {}).get("about")
        if isinstance(about, dict):
            found.append({**about, "time": file.stat().st_mtime})
    return [entry for entry in found if entry["run"] == found[-1]["run"]]


def _design(document: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """What the experiment that was designed last would bring."""
    if document is None or "message" not in document:
        return None
    return {"message": document["message"], "file": (document.get("input") or {}).get("file")}


def _ledger(document: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """What `daest improve` did, without the models."""
    if document is None:
        return None
    keys = ("added", "at", "rms", "verdict", "model")
    steps = [{key: step.get(key) for key in keys} for step in document.get("steps", [])]
    final = document.get("final", {})
    return {
        "steps": steps,
        "reason": document.get("reason", ""),
        "outputs": document.get("outputs", {}),
        "verdict": final.get("verdict"),
        "message": final.get("message"),
    }


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig", errors="replace") if path.is_file() else ""
    except OSError:
        return ""


def preview(lines: list[list[str]]) -> list[str]:
    """Lines as they are shown before they are run."""
    return [shown(line) for line in lines]
