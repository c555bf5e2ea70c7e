"""The nonlinear estimator of `estimator_code`: the extended or unscented Kalman filter of
`numerics/local_filter.c` with the functions of the model.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.resources import files

import casadi as ca
import numpy as np

from daest.fmu.estimator_code import EstimatorModel, generated, numbers, starting
from daest.fmu.sources import code_of
from daest.systems.simulation.local_linear import LocalModel

_WORK = ("arg", "res", "iw", "w")
RADIUS, ORDER, LEFT_OUT = 0.25, 12, 1e-16  # those of substep.c
_PARTS = ("substep.c", "project.c", "local_filter.c")  # of numerics, which nonlinear.c includes


@dataclass(frozen=True)
class NonlinearForm:
    """`local`: the model, interpreted; `inside`: (x, u, v, w, theta, t) -> the chosen variables and their
    slopes by x and w, row by row; `mean` (n,), `cov` (n, n): the first state; `nominal` (n,): sizes of the
    states, by which a projection weighs them; `longest` [s]: of the substeps; `weights` of sigma points,
    None: extended."""

    local: LocalModel
    inside: ca.Function
    mean: np.ndarray
    cov: np.ndarray
    nominal: np.ndarray
    longest: float
    weights: tuple[float, ...] | None

    @property
    def word(self) -> str:
        return f"An {'extended' if self.weights is None else 'unscented'} Kalman filter"

    @property
    def is_tunable(self) -> bool:
        return True

    @property
    def sizes(self) -> dict[str, int]:
        hold = self.local.hold
        return {
            "EST_NONLINEAR": 1,
            "EST_UKF": int(self.weights is not None),
            "EST_NG": 0 if hold is None else hold.numel_out(0),
            **{f"EST_SZ_{w.upper()}": max(getattr(f, f"sz_{w}")() for f in self._parts()) for w in _WORK},
        }

    @property
    def constants(self) -> dict[str, str]:
        weights = self.weights or (0.0,) * 4
        return {
            "EST_LONGEST": repr(float(self.longest)),
            "EST_WEIGHTS": f"{{{', '.join(repr(float(w)) for w in weights)}}}",
        }

    def program(self) -> dict[str, str]:
        room, numerics = files("daest.fmu").joinpath("estimator"), files("daest.numerics")
        main = room.joinpath("nonlinear.c").read_text(encoding="utf-8")
        for name in _PARTS:
            is_used = self.local.hold is not None or name != "project.c"
            text = numerics.joinpath(name).read_text(encoding="utf-8") if is_used else ""
            main = main.replace(f'#include "{name}"\n', text)
        fixed = {name: room.joinpath(name).read_text(encoding="utf-8") for name in ("estimator.h", "main.c")}
        return {**fixed, "estimator.c": main}

    def functions(self, model: EstimatorModel) -> str:
        """Raises FmuError `fmu-code-generation`."""
        arrays = [("MEAN", self.mean), ("COV", self.cov)]
        declared = [numbers(f"static const est_real START_{name}", value) for name, value in arrays]
        declared += ["extern const est_real estimator_nominal[];"]
        declared += [numbers("const est_real estimator_nominal", self.nominal)]
        text = code_of(lambda: generated(self._parts()))
        return "\n".join([*declared, text, starting(model, ())])

    def cost(self, model: EstimatorModel) -> dict[str, int]:
        s = {key.removeprefix("EST_"): value for key, value in model.sizes.items()}
        n, ubar, w, y, v = (s[key] for key in ("NX", "NUB", "NW", "NY", "NV"))
        substep = (1 + 2 * 2 + 2 * 3) * n * n + n * w + (2 + 2 * 2 + 2 * 3) * n + 64
        points = (2 * n + 1) * (2 * n + y) + 3 * n * n + n * y if s["UKF"] else 0
        work = 2 * substep + points + v * (n + w) + s["SZ_W"] + s["SZ_IW"] + s["SZ_ARG"] + s["SZ_RES"]
        return {
            "memory": n * (n + 1) + 2 * v + 2 * y + ubar + w + s["NTHETA"] + 10,
            "stack": work + 5 * n * n + n * w + 8 * n + y * (n + 1),
            "operations": self._operations(model),
        }

    def _operations(self, model: EstimatorModel) -> int:
        """Multiplications, and operations of the functions of the model, of a sample after the expected step,
        as at the start: a faster motion takes more doublings of the step."""
        n, w, y, v = (model.sizes[f"EST_{key}"] for key in ("NX", "NW", "NY", "NV"))
        flow, see, hold, inside = (arithmetic(f) for f in (*self._asked(), self.inside))
        substeps = max(1, int(np.ceil(model.period / self.longest * (1.0 - 1e-9))))
        doublings, order, order_of_cov = self._series(model, model.period / substeps)
        powers = order * (n**3 + n**2)
        mean = (order - 1) * (2 * n**2 + 6 * n) + (powers if doublings else 0)
        mean += doublings * (n**3 + 3 * n**2 + n)
        spread = (order_of_cov - 1) * (n**3 + 2 * n * n) + 2 * w * n**2 + mean + (0 if doublings else powers)
        spread += doublings * 2 * n**3
        noise = substeps * (2 * flow + mean + spread)
        told = inside + v * (n * n + n + 2 * w)
        if self.weights is None:
            return noise + substeps * 2 * n**3 + 2 * hold + see + y * (3 * n**2 + 4 * n) + told
        points = 2 * n + 1
        moved = noise + (points - 1) * substeps * (flow + mean) + points * (4 * n * n + n)
        seen = points * (see + hold * 2 + y + 2 * y * y + 2 * n * y) + y**3 // 6 + n * y * y + n * n * y
        return moved + 2 * (n**3 // 6 + 2 * n * n) + seen + told

    def _asked(self) -> tuple[ca.Function | None, ...]:
        return self.local.flow, self.local.see, self.local.hold

    def _series(self, model: EstimatorModel, step: float) -> tuple[int, int, int]:
        """Doublings of a substep, and terms of the series of mean and covariance, as `substep.c` chooses
        them at the start."""
        flow = self.local.flow
        u = [np.zeros(flow.numel_in(1)), np.zeros(flow.numel_in(2))]
        A = np.array(flow(self.mean, *u, model.theta, 0.0, self.cov)[1]).reshape(len(self.mean), -1)
        size = (
            float(min(np.abs(A).sum(axis=0).max(initial=0.0), np.abs(A).sum(axis=1).max(initial=0.0))) * step
        )
        doublings = int(np.clip(np.ceil(np.log2(size / RADIUS)), 0, None)) if size > RADIUS else 0
        size /= 2.0**doublings
        return doublings, _terms(size), _terms(2.0 * size)

    def _parts(self) -> list[ca.Function]:
        return [f for f in (self.local.flow, self.local.see, self.local.hold, self.inside) if f is not None]


def arithmetic(function: ca.Function | None) -> int:
    """Operations of an SX function: all but reading, writing and constants."""
    if function is None:
        return 0
    moves = (ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST, ca.OP_PARAMETER, ca.OP_ASSIGN)
    return sum(function.instruction_id(k) not in moves for k in range(function.n_instructions()))


def _terms(size: float) -> int:
    """Terms after which those of a series with growth `size` are negligible."""
    term = 1.0
    for k in range(1, ORDER):
        term *= size / (k + 1)
        if term < LEFT_OUT:
            return k
    return ORDER
