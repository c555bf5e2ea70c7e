"""CasADi functions called with arrays, many times: their results are written in place, without CasADi's own
matrices in between, which cost more than the evaluation of a small model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import casadi as ca
import numpy as np


class Evaluator:
    """A function with dense arguments and results. Not for several threads at once."""

    def __init__(self, function: ca.Function) -> None:
        self.function = function
        buffer: Any
        buffer, self._run = function.buffer()
        self._buffer = buffer
        self._arguments = [np.zeros(function.numel_in(i)) for i in range(function.n_in())]
        results = [np.zeros(function.numel_out(i)) for i in range(function.n_out())]
        for i, argument in enumerate(self._arguments):
            if argument.size:
                buffer.set_arg(i, memoryview(argument.data))
        for i, result in enumerate(results):
            if result.size:
                buffer.set_res(i, memoryview(result.data))
        self._results = [result.reshape(function.size_out(i), order="F") for i, result in enumerate(results)]

    def __call__(self, *arguments: np.ndarray | float) -> list[np.ndarray]:
        """Results as arrays of two dimensions. An argument is a column of numbers: a matrix column by column.
        Raises RuntimeError where the function fails."""
        for there, given in zip(self._arguments, arguments, strict=True):
            there[:] = given
        self._run()
        if self._buffer.ret():
            raise RuntimeError(f"{self.function.name()} failed")
        return [result.copy() for result in self._results]


def along(function: ca.Function, arguments: Sequence[np.ndarray]) -> list[np.ndarray]:
    """The non-zeros (n_samples, nnz) of every result of a function, in the order of its sparsity, at the rows
    of its arguments (n_samples, n); one of a single dimension (n,) is the same at all samples.

    Sample by sample into one place: a function mapped over samples takes longer to make than its values, and
    wants hundreds of parameters once for every sample.
    """
    buffer, run = cast(Any, function).buffer()
    n_samples = next(len(argument) for argument in arguments if argument.ndim == 2)
    here = [np.zeros(function.numel_in(i)) for i in range(function.n_in())]
    moving = []
    for i, (place, argument) in enumerate(zip(here, arguments, strict=True)):
        if not place.size:
            continue
        buffer.set_arg(i, memoryview(place.data))
        if argument.ndim == 2:
            moving.append((place, argument))
        else:
            place[:] = argument
    values = [np.zeros(function.nnz_out(i)) for i in range(function.n_out())]
    results = [np.zeros((n_samples, value.size)) for value in values]
    for i, value in enumerate(values):
        if value.size:
            buffer.set_res(i, memoryview(value.data))
    for k in range(n_samples):
        for place, argument in moving:
            place[:] = argument[k]
        run()
        for value, result in zip(values, results, strict=True):
            result[k] = value
    return results
