"""An estimator beside the machine: one sample goes in, one estimate comes out, in bounded memory.

`OnlineFilter` is what a stream, a watch and an export see; `online_kalman` and `online_gaussian` are the
filters behind it. What a filter remembers between two samples is a value of arrays, so that a run can be kept
in a file and go on where it was.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from daest.model.estimates import Estimate, Sample

Memory = Any  # a frozen dataclass of arrays and numbers that belongs to one kind of filter


class OnlineFilter(Protocol):
    """A filter that takes samples one by one, with names in its order; `notes` are sentences for the user."""

    @property
    def kind(self) -> str: ...

    @property
    def names(self) -> tuple[str, ...]: ...

    @property
    def units(self) -> tuple[str, ...]: ...

    @property
    def input_names(self) -> tuple[str, ...]: ...

    @property
    def output_names(self) -> tuple[str, ...]: ...

    @property
    def notes(self) -> tuple[str, ...]: ...

    def begin(self) -> Memory:
        """What is remembered before the first sample."""

    def advance(self, memory: Memory, sample: Sample) -> tuple[Memory, Estimate]:
        """The memory after `sample`, whose time must be later than that of the sample before, and the
        estimate."""

    def stored(self, memory: Memory) -> dict[str, np.ndarray]:
        """The memory as named arrays of numbers. Their shapes are those of the model."""

    def restored(self, arrays: Mapping[str, np.ndarray]) -> Memory:
        """The memory of `stored`. Raises ValueError for arrays of another model. Each must have the shape
        that it had there."""


def checked_arrays(
    arrays: Mapping[str, np.ndarray], shapes: Mapping[str, tuple[int | None, ...]]
) -> dict[str, np.ndarray]:
    """The arrays by name if each has its shape (None: any length). Raises ValueError."""
    found = {}
    for name, shape in shapes.items():
        if name not in arrays:
            raise ValueError(f"there is no '{name}'")
        value = np.asarray(arrays[name], dtype=float)
        if value.ndim != len(shape) or any(
            wanted not in (None, size) for wanted, size in zip(shape, value.shape, strict=True)
        ):
            raise ValueError(f"'{name}' has shape {value.shape}")
        found[name] = value
    return found
