"""Machines of a fleet that are done, one JSON line each, so that an interrupted run goes on where it was."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from daest.model.fleet import Machine

BLOCK = 1 << 20  # bytes


def recording_key(path: Path, digest: str) -> str:
    """A hash of the recording and of what the run rests on, see `diagnosis.kept.run_digest`. Raises
    OSError."""
    found = hashlib.sha256(digest.encode())
    with path.open("rb") as file:
        while block := file.read(BLOCK):
            found.update(block)
    return found.hexdigest()[:32]


def machines_done(path: Path) -> dict[str, Machine]:
    """The machines of the file by their keys; lines that are damaged (the last one of a run that was killed)
    count as not done."""
    found: dict[str, Machine] = {}
    try:
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return found
    for line in lines:
        try:
            entry = json.loads(line)
            key = entry.pop("key")
            found[key] = _machine(entry)
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
            continue
    return found


def keep_machine(path: Path, key: str, machine: Machine) -> None:
    """Append the machine to the file. Raises OSError."""
    text = json.dumps({"key": key, **vars(machine)}, ensure_ascii=False) + "\n"
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a+b") as file:
        if file.tell() and not _ends_a_line(file):
            file.write(b"\n")
        file.write(text.encode())


def _ends_a_line(file: Any) -> bool:
    file.seek(-1, os.SEEK_END)
    ends = file.read(1) == b"\n"
    file.seek(0, os.SEEK_END)
    return bool(ends)


def _machine(entry: Mapping[str, Any]) -> Machine:
    parameters = {name: (float(value), float(error)) for name, (value, error) in entry["parameters"].items()}
    return Machine(**{**entry, "parameters": parameters, "places": tuple(entry["places"])})
