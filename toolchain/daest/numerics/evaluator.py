"""CasADi functions called with arrays, many times: their results are written in place, without CasADi's own
matrices in between, which cost more than the evaluation of a small model."""

from __future__ import annotations

from typing import Any

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
