"""Samples that stand in two recordings: what estimates would validate as well."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from daest.data.limits import DATA
from daest.model.experiment import Experiment, Finding

_FACTOR = np.uint64(0x9E3779B97F4A7C15)  # odd, of hashes modulo 2**64


def repeated_findings(seen: Sequence[Experiment], unseen: Sequence[Experiment]) -> list[tuple[str, Finding]]:
    """The `unseen` recordings by name whose samples stand among those `seen` of others, too, and a finding
    about each. What repeats within one is its input, and the machine with it."""
    found = []
    for recording in unseen:
        name = recording.name.removesuffix(" (validation)")
        others = {one.name.removesuffix(" (estimation)"): one for one in seen}
        for other in (one for one in others if one != name):
            repeated = repeated_rows(_values(others[other]), _values(recording))
            if repeated.any():
                found.append((name, _finding(recording, other, repeated)))
    return found


def repeated_rows(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Which rows of `second` (m, k) stand in `first` (n, k) as well, (m,) of bool: as parts of stretches that
    are long, change all along and have many different rows: a machine at rest gives equal rows anywhere, and
    one that hunts between few steps of its sensor gives the same orders of them by chance."""
    length = int(DATA.repeated_stretch)
    repeated = np.zeros(len(second), dtype=bool)
    if min(len(first), len(second)) < length or first.shape[1] != second.shape[1]:
        return repeated
    rows = np.ascontiguousarray(np.concatenate([first, second]) + 0.0)  # + 0.0: no negative zero
    # As bytes, in which a missing value equals another.
    as_bytes = rows.view(np.dtype((np.void, rows.itemsize * rows.shape[1]))).ravel()
    numbers = np.unique(as_bytes, return_inverse=True)[1].ravel()
    here, there = numbers[: len(first)], numbers[len(first) :]
    is_there = np.isin(_stretches(there, length), _stretches(here, length))
    starts = np.flatnonzero(is_there & _moves(there, length))
    starts = np.array(
        [at for at in starts if np.unique(there[at : at + length]).size >= DATA.repeated_rows], dtype=int
    )
    for offset in range(length):
        repeated[starts + offset] = True
    return repeated


def _values(recording: Experiment) -> np.ndarray:
    return np.column_stack([recording.inputs, recording.outputs])


def _stretches(numbers: np.ndarray, length: int) -> np.ndarray:
    """A hash of every stretch of `length` numbers (n,): (n - length + 1,)."""
    hashes = np.zeros(numbers.size - length + 1, dtype=np.uint64)
    for offset in range(length):
        hashes = hashes * _FACTOR + numbers[offset : offset + hashes.size].astype(np.uint64)
    return hashes


def _moves(numbers: np.ndarray, length: int) -> np.ndarray:
    """Of which stretches half of the steps or more are changes."""
    changes = np.append(0, np.cumsum(np.diff(numbers) != 0))
    return changes[length - 1 :] - changes[: changes.size - length + 1] >= length // 2


def _finding(recording: Experiment, other: str, repeated: np.ndarray) -> Finding:
    n, at = int(repeated.sum()), float(recording.time[np.argmax(repeated)])
    text = (
        f"has {n} of the {repeated.size} samples that validate in common with {other}, which estimates: they "
        "are not unseen, and confirm whatever is fitted; leave one of the two out"
    )
    return Finding("check-repeated", "warning", None, text, at, n, subject="the recording")
