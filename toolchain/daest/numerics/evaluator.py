"""CasADi functions called with arrays, many times: their results are written in place, without CasADi's own
matrices in between, which cost more than the evaluation of a small model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import casadi as ca
import numpy as np


class _InPlace:
    """A function whose arguments stand in `here` and the non-zeros of whose results in `values`: CasADi holds
    no more than their addresses."""

    def __init__(self, function: ca.Function) -> None:
        buffer: Any
        buffer, self.run = cast(Any, function).buffer()
        self.buffer = buffer
        self.here = [np.zeros(function.numel_in(i)) for i in range(function.n_in())]
        self.values = [np.zeros(function.nnz_out(i)) for i in range(function.n_out())]
        for i, argument in enumerate(self.here):
            if argument.size:
                buffer.set_arg(i, memoryview(argument.data))
        for i, value in enumerate(self.values):
            if value.size:
                buffer.set_res(i, memoryview(value.data))


class Evaluator:
    """A function with dense arguments and results. Not for several threads at once."""

    def __init__(self, function: ca.Function) -> None:
        self.function = function
        self._place = _InPlace(function)
        shapes = (function.size_out(i) for i in range(function.n_out()))
        self._results = [
            v.reshape(shape, order="F") for v, shape in zip(self._place.values, shapes, strict=True)
        ]

    def __call__(self, *arguments: np.ndarray | float) -> list[np.ndarray]:
        """Results as arrays of two dimensions. An argument is a column of numbers: a matrix column by column.
        Raises RuntimeError where the function fails."""
        for there, given in zip(self._place.here, arguments, strict=True):
            there[:] = given
        self._place.run()
        if self._place.buffer.ret():
            raise RuntimeError(f"{self.function.name()} failed")
        return [result.copy() for result in self._results]


def along(function: ca.Function, arguments: Sequence[np.ndarray]) -> list[np.ndarray]:
    """The non-zeros (n_samples, nnz) of every result of a function, in the order of its sparsity, at the rows
    of its arguments (n_samples, n); one of a single dimension (n,) is the same at all samples.

    Sample by sample into one place: a function mapped over samples takes longer to make than its values, and
    wants hundreds of parameters once for every sample.
    """
    n_samples = next(len(argument) for argument in arguments if argument.ndim == 2)
    rows = _AtRows(function, arguments)
    results = [np.zeros((n_samples, value.size)) for value in rows.values]
    for k in range(n_samples):
        rows.evaluate(k)
        for value, result in zip(rows.values, results, strict=True):
            result[k] = value
    return results


def repeated(function: ca.Function, start: np.ndarray, arguments: Sequence[np.ndarray]) -> np.ndarray:
    """States (n_samples + 1, n) from the `start` (n,) on, of a function that tells the next one by the state
    before, its first argument, and the rows of the others, as in `along`."""
    n_samples = next(len(argument) for argument in arguments if argument.ndim == 2)
    rows = _AtRows(function, [start, *arguments])
    states = np.empty((n_samples + 1, start.size))
    states[0] = start
    for k in range(n_samples):
        rows.evaluate(k)
        rows.here[0][:] = states[k + 1] = rows.values[0]
    return states


class _AtRows(_InPlace):
    """A function at rows of its arguments."""

    def __init__(self, function: ca.Function, arguments: Sequence[np.ndarray]) -> None:
        super().__init__(function)
        self._moving = []
        for place, argument in zip(self.here, arguments, strict=True):
            if not place.size:
                continue
            if argument.ndim == 2:
                self._moving.append((place, argument))
            else:
                place[:] = argument

    def evaluate(self, k: int) -> None:
        for place, argument in self._moving:
            place[:] = argument[k]
        self.run()
