"""The examples that are shipped with daest: where they are, what they show, and copying one."""

from __future__ import annotations

import os
import re
import shutil
from dataclasses import dataclass
from pathlib import Path

import daest
from daest.data.project import FILE_NAME, load_project
from daest.errors import ConfigError, Place
from daest.near import nearest

_DESCRIPTION = re.compile(r'^\s*model\s+\w+\s+"((?:[^"\\]|\\.)*)"', re.MULTILINE)
_RESULTS = "results"


@dataclass(frozen=True)
class Example:
    """A folder with a model and a daest.toml; `has_recording` tells whether the data it names are there."""

    name: str
    folder: Path
    description: str
    has_recording: bool


def examples() -> list[Example]:
    """All shipped examples that have a daest.toml, by name. Raises ConfigError `examples-missing`."""
    root = _root()
    return [
        Example(folder.name, folder, _description(folder), _has_recording(folder))
        for folder in sorted(root.iterdir())
        if (folder / FILE_NAME).is_file()
    ]


def copy_example(name: str, target: Path) -> Example:
    """Copy the example `name` to the new folder `target`, without results of earlier runs.

    Raises ConfigError `example-unknown`, `example-folder-exists`, or `output-unwritable`.
    """
    known = {example.name: example for example in examples()}
    if name not in known:
        raise ConfigError(
            "example-unknown",
            f"there is no example '{name}'",
            remedy=nearest(name, known) or f"there are {', '.join(known)}",
        )
    if target.exists():
        raise ConfigError(
            "example-folder-exists",
            "the folder exists and is not overwritten",
            where=Place(str(target)),
            remedy="remove it, or call daest demo in another folder",
        )
    try:
        shutil.copytree(
            known[name].folder, target, ignore=shutil.ignore_patterns(_RESULTS, "__pycache__", "*.fmu")
        )
    except OSError as error:
        shutil.rmtree(target, ignore_errors=True)
        raise ConfigError(
            "output-unwritable",
            f"the example cannot be copied: {error.strerror or 'some files could not be written'}",
            where=Place(str(target)),
            remedy="call daest demo in a folder that can be written",
        ) from error
    return known[name]


def _root() -> Path:
    package = Path(daest.__file__).parent
    # Inside the installed package, else beside the sources of a checkout.
    for root in (package / "examples", package.parents[1] / "examples"):
        if root.is_dir():
            return root
    raise ConfigError(
        "examples-missing",
        "the examples are not part of this installation",
        remedy="install daest again, or copy the folder examples from its source",
    )


def _has_recording(folder: Path) -> bool:
    project = load_project(folder)
    return bool(project.estimate) and all(path.is_file() for path in (*project.estimate, *project.validate))


def _description(folder: Path) -> str:
    """The title of the example's page and what its model says of itself, which may begin alike."""
    title = (folder / "README.md").read_text(encoding="utf-8").partition("\n")[0].lstrip("# ")
    texts = (model.read_text(encoding="utf-8") for model in sorted(folder.glob("*.mo")))
    model = next((match[1] for match in map(_DESCRIPTION.search, texts) if match), title)
    return model if model.startswith(title) else f"{title}. {model}"


def demo_folder(name: str, here: Path) -> Path:
    """Where a copy of the example belongs that is made in the folder `here`: in it, but beside the checkout
    of daest where `here` lies in one."""
    checkout = next((folder for folder in (here, *here.parents) if _is_checkout(folder)), None)
    return Path(name) if checkout is None else Path(os.path.relpath(checkout.parent / name, here))


def _is_checkout(folder: Path) -> bool:
    return (folder / "pyproject.toml").is_file() and (folder / "toolchain" / "daest").is_dir()
