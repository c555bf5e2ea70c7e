"""The linear estimator of `estimator_code`: a Kalman filter, its matrices as functions of the parameters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import casadi as ca
import numpy as np

from daest.fmu.estimator_code import EstimatorModel, generated, numbers, starting
from daest.model.linear import StateSpaceFamily

_FIXED = ("estimator.h", "estimator.c", "main.c")
_MATRICES = ("A", "B", "G", "b", "C", "D", "H", "d")


@dataclass(frozen=True)
class EstimatorStart:
    """The first state: mean (n,), cov (n, n), sensitivity (n, q) to the unknown part, of which the outputs
    determine the first `n_known`; `log_density` of the flat prior."""

    mean: np.ndarray
    cov: np.ndarray
    sensitivity: np.ndarray
    n_known: int
    log_density: float


@dataclass(frozen=True)
class LinearForm:
    """The matrices of a linear model and its start; `held`: white noise reaches an output."""

    family: StateSpaceFamily
    held: bool
    start: EstimatorStart

    @property
    def word(self) -> str:
        return "A Kalman filter"

    @property
    def is_tunable(self) -> bool:
        """Whether the matrices are computed from the parameters, or are numbers."""
        return bool(self.family.matrices.is_a("SXFunction"))

    @property
    def sizes(self) -> dict[str, int]:
        return {
            "EST_NQ": self.start.sensitivity.shape[1],
            "EST_NP": self.start.n_known,
            "EST_HELD": int(self.held),
        }

    @property
    def constants(self) -> dict[str, str]:
        return {}

    def program(self) -> dict[str, str]:
        room = files("daest.fmu").joinpath("estimator")
        return {name: room.joinpath(name).read_text(encoding="utf-8") for name in _FIXED}

    def functions(self, model: EstimatorModel) -> str:
        start = self.start
        arrays = [("MEAN", start.mean), ("COV", start.cov), ("SENS", start.sensitivity)]
        lines = [
            "memcpy(e->sens, START_SENS, sizeof e->sens);",
            f"e->n_known = {start.n_known};",
            f"e->n_open = {start.sensitivity.shape[1] - start.n_known};",
            f"e->log_density = (est_real){float(start.log_density)!r};",
        ]
        declared = [numbers(f"static const est_real START_{name}", value) for name, value in arrays]
        return "\n".join([*declared, self._matrices(model), starting(model, lines)])

    def _matrices(self, model: EstimatorModel) -> str:
        """`estimator_matrices`: computed from the parameters, or numbers."""
        function = self._matrix_function(model)
        names = (*_MATRICES, "V")
        if not model.is_tunable:
            values = [np.array(value).ravel() for value in function.call([model.theta])]
            arrays = [
                numbers(f"static const est_real FIXED_{n}", v) for n, v in zip(names, values, strict=True)
            ]
            copies = [f"    memcpy(m->{n}, FIXED_{n}, sizeof m->{n});" for n in names]
            head = "int estimator_matrices(const est_real *theta, EstMatrices *m) {\n    (void)theta;"
            return "\n".join([*arrays, head, *copies, "    return EST_OK;", "}"])
        results = ", ".join(f"m->{name}" for name in names)
        return f"""{generated([function])}
int estimator_matrices(const est_real *theta, EstMatrices *m) {{
    const est_real *arg[1];
    est_real *res[{len(names)}] = {{{results}}};
    arg[0] = theta;
    return daest_matrices(arg, res, 0, 0, 0) ? EST_NOT_FINITE : EST_OK;
}}"""

    def _matrix_function(self, model: EstimatorModel) -> ca.Function:
        """theta -> the matrices row by row, V last; of the chosen variables."""
        family = self.family
        kind: Any = ca.SX if model.is_tunable else ca.MX
        theta = kind.sym("theta", family.matrices.numel_in(0))
        A, B, G, b, C, D, H, d, X, U, W, x0 = family.matrices.call([theta], True, False)
        unknowns = family.unknown_names
        rows = []
        for name in model.values:
            if name in unknowns:
                i = unknowns.index(name)
                rows.append(ca.horzcat(X[i, :], W[i, :], U[i, :], x0[i]))
            else:
                i = model.outputs.index(name)
                rows.append(ca.horzcat(C[i, :], H[i, :], D[i, :], d[i]))
        V = ca.vertcat(*rows)
        flat = [ca.densify(ca.vec(ca.densify(m).T)) for m in (A, B, G, b, C, D, H, d, V)]
        return ca.Function("daest_matrices", [theta], flat)

    def cost(self, model: EstimatorModel) -> dict[str, int]:
        sizes = model.sizes
        return {
            "memory": _numbers_kept(sizes),
            "stack": _stack(sizes),
            "operations": _operations(sizes),
            "resampling": _sampling(sizes),
        }


def _numbers_kept(s: Mapping[str, int]) -> int:
    """Numbers in `Estimator`."""
    n, nb, w, y, v, q, p = (s[f"EST_{k}"] for k in ("NX", "NUB", "NW", "NY", "NV", "NQ", "NP"))
    matrices = n * (n + nb + w + 1) + y * (n + nb + w + 1) + v * (n + w + nb + 1)
    sampled = 2 * n * n + 2 * n * nb + n + y * y + n * y + w * y + w
    update = y * (1 + q + y + n) + p * (p + 1)
    return (
        matrices
        + sampled
        + update
        + n * (n + q + 1)
        + p * (p + 1)
        + 2 * v
        + 4 * y
        + nb
        + w
        + s["EST_NTHETA"]
        + 10
    )


def _stack(s: Mapping[str, int]) -> int:
    """Numbers in the arrays of the deepest function."""
    n, nb, w, y, q, p = (s[f"EST_{k}"] for k in ("NX", "NUB", "NW", "NY", "NQ", "NP"))
    sampling = 6 * n * n + n * nb + n * w
    predict = 5 * n * n + 5 * n * y + y * y + n * (q + 1)
    told = 2 * (n + w) * y + (n + w) * (q + 1) + 2 * q * q + q + y * (q + 4 * y + n) + 2 * p * p + p
    return max(sampling, predict, told + 2 * q * q + q)


def _operations(s: Mapping[str, int]) -> int:
    """Multiplications of update, prediction and telling once the start is known."""
    n, nb, w, y, v = (s[f"EST_{k}"] for k in ("NX", "NUB", "NW", "NY", "NV"))
    z = n + w
    update = y * n * (n + y + 1) + y**3
    predict = 2 * n**3 + 5 * n * n * y + 4 * n * y * y + n * (n + 2 * nb + y)
    told = z * y * (n + 2 * y) + v * (n * n + z * (y + 2) + nb)
    return 2 * update + predict + told


def _sampling(s: Mapping[str, int]) -> int:
    n = s["EST_NX"]
    return 2 * 12 * n**3 + 5 * n**3 * 4 + n * n * s["EST_NUB"] * 2
