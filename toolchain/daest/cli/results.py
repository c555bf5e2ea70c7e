"""The folder `results/`: what commands keep there for later ones, documents with their origin and series
beside them; and the fingerprint of the model that a fit was made of, which tells how the model at hand
differs.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from daest import __version__
from daest.cache import hash_of
from daest.cli.output import (
    CHOOSE_FOLDER,
    IMPROVED,
    LATEST,
    LEDGER,
    Document,
    note,
    to_json,
    whole_file,
    with_schema,
)
from daest.data.project import Project
from daest.errors import ConfigError, Place
from daest.estimation.fitting.fitted import with_fit_values
from daest.files import why_no_file
from daest.machine import version
from daest.model.flat import FlatModel, Model
from daest.model.holds import Hold, checked_hold

KEPT_ELSEWHERE = "work in a copy of the project, in a folder that can be written"
BY_MODEL = "fits"  # one fit per model, so that compare finds each one's


@dataclass(frozen=True)
class KeptFit:
    """The fit of a model with its file; `remarks` say where the model has changed since."""

    path: Path
    document: Document
    remarks: tuple[str, ...] = ()


def save_fit(
    project: Project, source: Path, flat: Model, document: Mapping[str, Any], origin: Mapping[str, Any]
) -> Path:
    """Write the fit as results/fit.json and as the fit of this model; returns the first. `flat` is the model
    before the fit, and `origin` says what the fit was made from."""
    key = {**_model_key(project, source, flat.name), "fingerprint": model_fingerprint(flat, source)}
    marked = {**document, "model": key, "made_from": origin}
    for path in reversed(_fit_files(project.results, flat.name)):
        write_document(marked, "identify", path, KEPT_ELSEWHERE)
    return project.results / LATEST


def write_document(
    document: Mapping[str, Any], command: str, path: Path, remedy: str = CHOOSE_FOLDER
) -> None:
    """Write the document of a command as JSON. Raises ConfigError `output-unwritable` with the remedy."""
    with whole_file(path, remedy) as temporary:
        temporary.write_text(to_json(with_schema(document, command)), encoding="utf-8")


def find_fit(project: Project, source: Path, flat: Model) -> KeptFit | None:
    """The fit of this very model, beside daest.toml or beside the model; None if there is none. `flat` is the
    model before the fit.

    Raises ConfigError `results-unreadable` for a damaged file.
    """
    folders = dict.fromkeys([project.results, source.parent / "results"])
    for folder in folders:
        files = _fit_files(folder, flat.name)
        for i, path in enumerate(files):
            if path.is_file():
                document = read_document(path)
                if _is_of(document, folder.parent, source, flat.name):
                    return KeptFit(path, document, _remarks(document, source, flat, files[i:]))
    return None


def last_hold(project: Project, names: Sequence[str]) -> Hold | None:
    """The hold of the inputs `names` in the last fit of any model of the project, or in the last search for
    what it lacks; None where there is none, it is of other inputs, or its file is damaged."""
    files = [path for name in (LATEST, f"{IMPROVED}/{LEDGER}") if (path := project.results / name).is_file()]
    for path in sorted(files, key=lambda path: -path.stat().st_mtime_ns):
        with suppress(ConfigError):
            hold = checked_hold(read_document(path).get("hold"), names, str(path))
            if hold is not None:
                return hold
    return None


def _fit_files(results: Path, name: str) -> tuple[Path, Path]:
    return results / LATEST, results / BY_MODEL / f"{name}.json"


def _remarks(document: Document, source: Path, flat: Model, files: Sequence[Path]) -> tuple[str, ...]:
    """What has changed since the fit in the first of `files`, with the remedy; none where nothing has."""
    changes = differences(document["model"].get("fingerprint", {}), model_fingerprint(flat, source))
    if not changes:
        return ()
    removed = " and ".join(str(path) for path in files if path.is_file())
    return (
        f"{flat.name} has changed since the fit {files[0]}, whose values are used: {'; '.join(changes)}; run "
        f"daest identify again, or remove {removed} to use the values of the model",
    )


def read_document(path: Path) -> Document:
    """A JSON document. Raises ConfigError `results-unreadable`."""
    why = why_no_file(path)  # reading a pipe would wait for somebody to write
    try:
        if why is not None:
            raise ValueError(f"it {why}")
        document = json.loads(path.read_text(encoding="utf-8"))
        if isinstance(document, dict):
            return document
        what = "not a JSON object"
    except (OSError, ValueError) as error:
        what = getattr(error, "strerror", None) or str(error)
    except RecursionError:
        what = "it is nested too deeply"
    raise ConfigError(
        "results-unreadable",
        f"the file cannot be read: {what}",
        where=Place(str(path)),
        remedy="check the path; a damaged result is written anew by daest identify",
    )


def with_fit(project: Project, source: Path, flat: Model) -> tuple[Model, KeptFit | None]:
    """The model with its fit, if there is one, which is told on stderr. Raises what `find_fit` raises."""
    fit = find_fit(project, source, flat)
    if fit is None:
        note("no fit found: the parameters and the noise of the model are used")
        return flat, None
    note(f"parameters and noise of {fit.path}")
    for remark in fit.remarks:
        note(remark)
    return fitted(flat, fit.document), fit


def fitted(flat: Model, document: Mapping[str, Any]) -> Model:
    """The model with all parameters of a fit, held ones too, and its noises, as `fitted_model`."""
    noise = document.get("noise", {})
    intensity = {name: entry["intensity"] for name, entry in noise.get("process", {}).items()}
    std = {name: entry["std"] for name, entry in noise.get("measurement", {}).items()}
    return with_fit_values(flat, document.get("method"), parameter_values(document), intensity, std)


def parameter_values(document: Mapping[str, Any]) -> dict[str, float]:
    """Values by name: `theta` {name: number} of a fit, and `parameters` {name: {value}} or {name: number}."""
    found = {}
    for name, entry in {**document.get("theta", {}), **document.get("parameters", {})}.items():
        value = entry.get("value") if isinstance(entry, Mapping) else entry
        if isinstance(value, int | float):
            found[name] = float(value)
    return found


def _model_key(project: Project, source: Path, name: str) -> dict[str, str]:
    return {"name": name, "source": os.path.relpath(source.resolve(), project.folder.resolve())}


def _is_of(document: Document, folder: Path, source: Path, name: str) -> bool:
    key = document.get("model", {})
    recorded = folder / key.get("source", "")
    # A model that was moved is known by its name alone.
    return key.get("name") == name and (not recorded.is_file() or recorded.resolve() == source.resolve())


MOST_NAMED = 4  # parameters


def model_fingerprint(flat: Model, source: Path) -> dict[str, Any]:
    """Values of all parameters before the fit, and digests of the equations and of every output.

    Comments, bounds, marks and noises do not count: a fit stays right when they change. Of an FMU without
    equations the file counts.
    """
    values = {p.name: p.value for p in flat.parameters}
    if not isinstance(flat, FlatModel):
        return {"values": values, "equations": hash_of(source), "outputs": {}}
    texts = [e.text for e in (*flat.equations, *flat.initial_equations)]
    texts += [f"{d.name} = {d.expression}" for d in flat.derived_parameters]
    expressions = [str(flat.output_expressions[i]) for i in range(len(flat.outputs))]
    digests = {y.name: _digest([text]) for y, text in zip(flat.outputs, expressions, strict=True)}
    return {"values": values, "equations": _digest(texts), "outputs": digests}


def differences(then: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """How a model differs from what it was, one phrase each; none where `then` is no fingerprint."""
    if not {"values", "equations", "outputs"} <= then.keys():
        return []
    moved = [
        f"{name} is {now['values'][name]:g} and was {value:g}"
        for name, value in then["values"].items()
        if now["values"].get(name, value) != value
    ]
    if len(moved) > MOST_NAMED:
        moved = [*moved[:MOST_NAMED], f"{len(moved) - MOST_NAMED} more values"]
    equations = ["its equations are others"] if then["equations"] != now["equations"] else []
    outputs = [
        f"the output {name} is another"
        for name, digest in then["outputs"].items()
        if now["outputs"].get(name, digest) != digest
    ]
    return [*moved, *equations, *outputs]


def _digest(texts: Sequence[str]) -> str:
    return hashlib.sha256("\n".join(texts).encode()).hexdigest()


PACKAGES = ("casadi", "numpy", "rumoca", "scipy")  # those that numbers may depend on


def keep(
    project: Project,
    name: str,
    command: str,
    document: Mapping[str, Any],
    origin: Mapping[str, Any],
    series: Mapping[str, np.ndarray] | None = None,
) -> None:
    """Write results/NAME.json, and the series as results/NAME.npz, beside a daest.toml; nothing without one.

    A folder that cannot be written is no reason to fail: the result itself goes elsewhere. The series may
    have any shape.
    """
    if project.file is None:
        return
    try:
        if series is not None:
            with whole_file(project.results / f"{name}.npz") as temporary, temporary.open("wb") as stream:
                np.savez_compressed(stream, **series)  # type: ignore[arg-type]
        write_document({**document, "made_from": origin}, command, project.results / f"{name}.json")
    except ConfigError as problem:
        note(f"not kept for daest report: {problem.what}")


def made_from(project: Project, models: Sequence[Path], recordings: Iterable[Path] = ()) -> dict[str, Any]:
    """Versions of the programs and fingerprints of the files that a result depends on; paths count from the
    folder of daest.toml."""
    files = [("model", path) for path in models] + [("data", path) for path in recordings]
    files += [] if project.file is None else [("project", project.file)]
    return {
        "daest": __version__,
        "python": platform.python_version(),
        "packages": {name: version(name) for name in PACKAGES},
        "files": [_file(project, role, path) for role, path in files if path.is_file()],
    }


def training_files(project: Project, given: Sequence[Path]) -> list[Path]:
    """The recordings of a command that estimates: `given`, else those of daest.toml."""
    return [*(given or project.estimate), *project.validate]


def unseen_files(project: Project, given: Sequence[Path]) -> list[Path]:
    """The recordings of a command that tries a model: `given`, else those of daest.toml."""
    return list(given or project.validate or project.estimate)


def _file(project: Project, role: str, path: Path) -> dict[str, Any]:
    relative = os.path.relpath(path.resolve(), project.folder.resolve())
    return {
        "role": role,
        "path": Path(relative).as_posix(),
        "sha256": hash_of(path),
        "bytes": path.stat().st_size,
    }
