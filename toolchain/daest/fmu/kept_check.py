"""The comparison of an FMU's sources, kept in the cache: its binary starts a process, which takes longer than
all else that a linearisation does."""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import casadi as ca
import numpy as np

import daest
from daest.cache import cache_folder, forget_unused, hash_of, keep_content, kept_content, was_used
from daest.fmu.linearize import cross_check_fmu
from daest.model.linear import LinearDAE
from daest.numerics.compiler import native_platform

MOST_KEPT = 500  # comparisons
DECIDING = ("fmu", "numerics", "systems")  # folders of daest whose code decides what is found


def kept_cross_check(
    path: Path, theta: np.ndarray, at: Mapping[str, float] | None, known: Sequence[LinearDAE]
) -> dict[str, float]:
    """`cross_check_fmu`, or what it found before of an FMU with the same content at the same point. What it
    raises is not kept. Shapes: theta (n_theta,)."""
    folder = cache_folder() / "cross_checks"
    file = folder / f"{_key(path, theta, at)}.json"
    content = kept_content(file)
    if content is not None:
        was_used(file)
        return dict(json.loads(content))
    found = cross_check_fmu(path, theta, at, known)
    if found:  # where nothing could be compared, a compiler or a variable may be missing that comes later
        keep_content(file, json.dumps(found).encode())
        forget_unused(folder, MOST_KEPT)
    return found


def _key(path: Path, theta: np.ndarray, at: Mapping[str, float] | None) -> str:
    """Hash of everything that decides the comparison."""
    point = None if at is None else sorted(at.items())
    versions = daest.__version__, np.__version__, ca.CasadiMeta.version(), native_platform().tuple_name
    found = hashlib.sha256(json.dumps([hash_of(path), theta.tolist(), point, *versions]).encode())
    root = Path(daest.__file__).parent
    for file in sorted(file for folder in DECIDING for file in (root / folder).rglob("*.py")):
        with contextlib.suppress(OSError):
            found.update(file.read_bytes())
    return found.hexdigest()
