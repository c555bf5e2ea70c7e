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
from daest.systems.local_linear import LocalModel

_WORK = ("arg", "res", "iw", "w")
_PARTS = ("project.c", "local_filter.c")  # of numerics, which nonlinear.c includes


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
            text = numerics.joinpath(name).read_text(encoding="utf-8")
            main = main.replace(f'#include "{name}"\n', text if self.local.hold or name != _PARTS[0] else "")
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

    def cost(self, model: EstimatorModel) -> dict[str, int | None]:
        s = {key.removeprefix("EST_"): value for key, value in model.sizes.items()}
        n, ubar, w, y, v = (s[key] for key in ("NX", "NUB", "NW", "NY", "NV"))
        substep = (12 + 10 + 2 * 3) * n * n + n * w + (2 + 2 * 11 + 2 * 3) * n + 64
        points = (2 * n + 1) * (2 * n + y) + n * n + n * y if s["UKF"] else 0
        work = 2 * substep + points + v * (n + w) + s["SZ_W"] + s["SZ_IW"] + s["SZ_ARG"] + s["SZ_RES"]
        return {
            "memory": n * (n + 1) + 2 * v + 2 * y + ubar + w + s["NTHETA"] + 10,
            "stack": work + 4 * n * n + 6 * n,
            "operations": None,
            "resampling": None,
        }

    def _parts(self) -> list[ca.Function]:
        return [f for f in (self.local.flow, self.local.see, self.local.hold, self.inside) if f is not None]
