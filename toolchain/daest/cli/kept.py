"""What commands keep in `results/` for later ones: documents with their origin, and series beside them."""

from __future__ import annotations

import hashlib
import os
import platform
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from daest import __version__
from daest.cli.output import to_json, whole_file, with_schema
from daest.data.project import Project
from daest.errors import ConfigError

PACKAGES = ("casadi", "numpy", "rumoca", "scipy")  # those that numbers may depend on
BLOCK = 1 << 20  # bytes


def keep(
    project: Project,
    name: str,
    command: str,
    document: Mapping[str, Any],
    origin: Mapping[str, Any],
    series: Mapping[str, np.ndarray] | None = None,
) -> None:
    """Write results/NAME.json, and the series as results/NAME.npz, beside a daest.toml; nothing without one.

    A folder that cannot be written is no reason to fail: the result itself goes elsewhere.
    """
    if project.file is None:
        return
    from daest.cli.output import note

    content = with_schema({**document, "made_from": origin}, command)
    try:
        if series is not None:
            with whole_file(project.results / f"{name}.npz") as temporary, temporary.open("wb") as stream:
                np.savez_compressed(stream, **series)  # type: ignore[arg-type]
        with whole_file(project.results / f"{name}.json") as temporary:
            temporary.write_text(to_json(content), encoding="utf-8")
    except ConfigError as problem:
        note(f"not kept for daest report: {problem.what}")


def made_from(project: Project, models: Sequence[Path], recordings: Iterable[Path] = ()) -> dict[str, Any]:
    """Versions of the programs and fingerprints of the files that a result depends on; paths count from the
    folder of daest.toml."""
    from importlib import metadata

    files = [("model", path) for path in models] + [("data", path) for path in recordings]
    files += [] if project.file is None else [("project", project.file)]
    return {
        "daest": __version__,
        "python": platform.python_version(),
        "packages": {name: metadata.version(name) for name in PACKAGES},
        "files": [_file(project, role, path) for role, path in files if path.is_file()],
    }


def fingerprint(path: Path) -> str:
    """SHA-256 of the content of a file."""
    digest = hashlib.sha256()
    with path.open("rb") as stream:
        while block := stream.read(BLOCK):
            digest.update(block)
    return digest.hexdigest()


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
        "sha256": fingerprint(path),
        "bytes": path.stat().st_size,
    }
