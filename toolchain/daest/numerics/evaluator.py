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
        self._results = [np.zeros(function.numel_out(i)) for i in range(function.n_out())]
        self._shapes = [function.size_out(i) for i in range(function.n_out())]
        for i, argument in enumerate(self._arguments):
            if argument.size:
                buffer.set_arg(i, memoryview(argument.data))
        for i, result in enumerate(self._results):
            if result.size:
                buffer.set_res(i, memoryview(result.data))

    def __call__(self, *arguments: np.ndarray | float) -> list[np.ndarray]:
        """Results as arrays of two dimensions. Raises RuntimeError where the function fails."""
        for there, given in zip(self._arguments, arguments, strict=True):
            there[...] = np.reshape(given, -1, order="F") if np.ndim(given) > 1 else given
        self._run()
        if self._buffer.ret():
            raise RuntimeError(f"{self.function.name()} failed")
        return [
            result.reshape(shape, order="F").copy()
            for result, shape in zip(self._results, self._shapes, strict=True)
        ]
