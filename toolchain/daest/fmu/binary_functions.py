"""Functions of an FMU's binary in the shapes that the estimators call."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import numpy as np

from daest.errors import DaestError

ARGUMENTS = ("x", "u", "v", "w", "theta", "t")
THETA = ARGUMENTS.index("theta")

# CasADi would print an error in a function of ours, and replace it: NaN stands for it, and the error waits.
_failures: list[DaestError] = []
# CasADi does not keep functions of ours alive.
_alive: list[Any] = []


def raise_failure() -> None:
    """Raise the error of a binary that was called from within CasADi, if there was one."""
    if _failures:
        failure = _failures[0]
        _failures.clear()
        raise failure


class _Callback(ca.Callback):
    """A numeric function as a CasADi function."""

    def __init__(
        self,
        name: str,
        inputs: Sequence[tuple[int, int]],
        outputs: Sequence[ca.Sparsity],
        evaluate: Callable[..., Sequence[np.ndarray]],
        jacobian: Callable[[], _Callback] | None = None,
    ) -> None:
        ca.Callback.__init__(self)
        self._inputs, self._outputs = list(inputs), list(outputs)
        self._evaluate, self._jacobian = evaluate, jacobian
        self._made: list[Any] = []
        self.construct(name, {})

    def get_n_in(self) -> int:
        return len(self._inputs)

    def get_n_out(self) -> int:
        return len(self._outputs)

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(*self._inputs[i])

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return self._outputs[i]

    def eval(self, arguments: Sequence[ca.DM]) -> list[ca.DM]:
        given = [np.array(a.full()) for a in arguments]
        try:
            found = self._evaluate(*given)
        except DaestError as failure:
            _failures.append(failure)
            found = [np.full(s.shape, np.nan) for s in self._outputs]
        return [
            ca.DM(np.asarray(value, dtype=float)) if sparsity.is_dense() else ca.DM(sparsity)
            for value, sparsity in zip(found, self._outputs, strict=True)
        ]

    def has_jacobian(self) -> bool:
        return self._jacobian is not None

    def get_jacobian(self, name: str, inames: Any, onames: Any, opts: Any) -> ca.Function:
        assert self._jacobian is not None
        made = self._jacobian()
        self._made.append(made)
        names_in, names_out = list(inames), list(onames)
        symbols = [ca.MX.sym(n, made.sparsity_in(i)) for i, n in enumerate(names_in)]
        return ca.Function(name, symbols, made.call(symbols), names_in, names_out)


def model_function(
    name: str,
    sizes: Sequence[int],
    n_rows: int,
    value: Callable[..., np.ndarray],
    slopes: Callable[..., Sequence[np.ndarray]] | None,
) -> ca.Function:
    """(x, u, v, w, theta, t) -> n_rows values, with Jacobians by `slopes` except those of theta, which are
    structurally zero: derivatives with respect to parameters are differences of whole results elsewhere."""
    shapes = [(size, 1) for size in sizes]
    column = ca.Sparsity.dense(n_rows, 1)

    def plain(arguments: Sequence[np.ndarray]) -> list[np.ndarray]:
        return [a.ravel() for a in arguments]

    def jacobian() -> _Callback:
        blocks = [
            ca.Sparsity(n_rows, size) if i == THETA else ca.Sparsity.dense(n_rows, size)
            for i, size in enumerate(sizes)
        ]
        return _Callback(
            f"slopes_{name}", [*shapes, (n_rows, 1)], blocks,
            lambda *a: slopes(*plain(a[:-1])) if slopes else (),
        )  # fmt: skip

    inner = _Callback(
        f"binary_{name}", shapes, [column], lambda *a: [value(*plain(a)).reshape(n_rows, 1)],
        jacobian if slopes else None,
    )  # fmt: skip
    _alive.append(inner)
    symbols = [ca.MX.sym(n, size) for n, size in zip(ARGUMENTS, sizes, strict=True)]
    return ca.Function(name, symbols, inner.call(symbols), list(ARGUMENTS), ["value"])


def parameter_function(
    n_theta: int,
    shapes: Sequence[tuple[int, ...]],
    matrices: Callable[[np.ndarray], Sequence[np.ndarray]],
) -> ca.Function:
    """theta -> matrices of the given shapes, without derivatives."""
    inner = _Callback(
        "binary_matrices",
        [(n_theta, 1)],
        [ca.Sparsity.dense(*s) for s in shapes],
        lambda a: matrices(a.ravel()),
    )
    _alive.append(inner)
    theta = ca.MX.sym("theta", n_theta)
    return ca.Function("matrices", [theta], inner.call([theta]))


class PointFunction:
    """A numeric function in the place of a CasADi one in the loops over samples: (x, ...) -> columns.

    Errors of the binary come through as they are.
    """

    def __init__(self, evaluate: Callable[..., Sequence[np.ndarray]]) -> None:
        self._evaluate = evaluate

    def call(self, arguments: Sequence[Any]) -> list[np.ndarray]:
        """Results (n, k) for k columns of arguments (m, k)."""
        tables = [_table(a) for a in arguments]
        columns = [
            self._evaluate(*(t[:, min(k, t.shape[1] - 1)] for t in tables)) for k in range(tables[0].shape[1])
        ]
        return [np.column_stack([np.ravel(c[j]) for c in columns]) for j in range(len(columns[0]))]

    def map(self, _: int) -> PointFunction:
        """The same function of columns of arguments."""
        return self


def _table(argument: Any) -> np.ndarray:
    """A column per point."""
    table = np.array(argument, dtype=float)
    return table.reshape(-1, 1) if table.ndim < 2 else table
