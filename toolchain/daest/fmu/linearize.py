"""E ξ' = J ξ + K u + B w from an FMU, by the best way that it offers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from daest.errors import ConfigError, FmuError
from daest.fmu.load import load_fmu, symbolic_model
from daest.fmu.points import DIFFERENCE_FLOOR, difference
from daest.fmu.residual_form import linearize_residuals
from daest.fmu.runner import Runner
from daest.fmu.semi_explicit import linearize_semi_explicit
from daest.model.flat import FlatModel
from daest.model.fmu import FmuModel
from daest.model.linear import LinearDAE

SOURCES = ("symbolic", "fmi-ls-dae", "directional derivatives", "finite differences")


def linearize_fmu(
    path: str | Path,
    theta: np.ndarray | None = None,
    at: Mapping[str, float] | None = None,
    source: str | None = None,
    runner: Runner | None = None,
) -> LinearDAE:
    """The linear DAE of an FMU at the parameters `theta` (all of them, in the FMU's order; None: its start
    values).

    `at` maps unknowns, inputs and `der(name)` to the operating point; what is left out is at its start value
    or zero. `source` is one of `SOURCES`; None takes the first that the FMU offers: "symbolic" (the model
    inside), "fmi-ls-dae" (residuals of the binary: the same unknowns and equations), "directional
    derivatives" or "finite differences" (x' = f, 0 = z - g over all continuous variables). `runner` is the
    process of the FMU's binary to use; None: a new one. Directional derivatives are compared with finite
    differences, and not used where they are wrong; the result tells. Errors: those of `load_fmu` and of the
    binary (`fmu-without-binary`, `fmu-call-failed`), `fmu-source`. Shapes: theta (n_theta,).

        >>> daest.linearize_fmu("Servo.fmu").source
        'symbolic'
    """
    model = load_fmu(path)
    if source is not None and source not in SOURCES:
        raise ConfigError(
            "fmu-source", f"There is no source `{source}`.", remedy=f"Choose among {', '.join(SOURCES)}."
        )
    chosen = source or available_sources(model)[0]
    if chosen == "symbolic":
        return _symbolic(path, theta, at)
    values = _parameter_values(model, theta)
    if chosen == "fmi-ls-dae":
        return linearize_residuals(model, values, at, runner)
    return linearize_semi_explicit(model, values, at, chosen == "directional derivatives", runner)


def available_sources(model: FmuModel) -> tuple[str, ...]:
    """The sources that the FMU offers, best first."""
    offers = {
        "symbolic": model.has_symbolic_model,
        "fmi-ls-dae": model.manifest is not None and bool(model.manifest.residuals),
        "directional derivatives": model.provides_directional_derivatives,
        "finite differences": True,
    }
    return tuple(name for name in SOURCES if offers[name])


def cross_check_fmu(
    path: str | Path,
    theta: np.ndarray | None = None,
    at: Mapping[str, float] | None = None,
    known: Sequence[LinearDAE] = (),
) -> dict[str, float]:
    """The largest relative difference between each pair of sources that can be compared, and `largest` of
    them.

    Compared are E, J, K, B, C, D, H and the offsets, entry by entry against the largest entry of the
    equation. Empty if the FMU offers only one source, or has no binary that runs here. `known`: linear DAEs
    at the same point that need not be computed again. Shapes: theta (n_theta,).
    """
    model = load_fmu(path)
    found: dict[str, float] = {}
    offers = available_sources(model)
    ready: dict[str, LinearDAE] = {dae.source: dae for dae in known}
    with Runner(model) as runner:
        for first, second in (("symbolic", "fmi-ls-dae"), ("directional derivatives", "finite differences")):
            if first in offers and second in offers:
                try:
                    one, other = (
                        ready.get(name) or linearize_fmu(path, theta, at, name, runner)
                        for name in (first, second)
                    )
                except FmuError as problem:
                    if problem.code in ("fmu-without-binary", "fmu-binary-not-loaded"):
                        continue
                    raise
                if one.source != other.source:
                    floor = DIFFERENCE_FLOOR if second == "finite differences" else 0.0
                    found[f"{first} - {second}"] = matrices_apart(one, other, floor)
    return {**found, "largest": max(found.values())} if found else {}


def matrices_apart(one: LinearDAE, other: LinearDAE, floor: float = 0.0) -> float:
    """Largest difference between two linear DAEs in the same equations and unknowns, relative to the row.

    `floor` as in `difference`.
    """
    return difference(_matrices(one), _matrices(other), floor)


def _matrices(dae: LinearDAE) -> list[np.ndarray]:
    """All that stands in the rows of the equations, and in those of the outputs."""
    E, J = (m if isinstance(m, np.ndarray) else m.toarray() for m in (dae.E, dae.J))
    return [
        np.column_stack([E, J, dae.K, dae.B, dae.offset]),
        np.column_stack([dae.C, dae.D, dae.H, dae.output_offset]),
    ]


def _symbolic(path: str | Path, theta: np.ndarray | None, at: Mapping[str, float] | None) -> LinearDAE:
    from daest.systems.linear.linearize import linearize

    flat: FlatModel | None = symbolic_model(path)
    if flat is None:
        raise FmuError(
            "fmu-no-symbolic-model",
            "The FMU carries no symbolic model.",
            where=str(path),
            remedy="Use its binary: --source fmi-ls-dae.",
        )
    return linearize(flat, theta, at)


def _parameter_values(model: FmuModel, theta: np.ndarray | None) -> np.ndarray:
    values = [model.variables[vr].start or 0.0 for vr in model.parameters] if theta is None else theta
    values = np.asarray(values, dtype=float)
    if values.shape != (len(model.parameters),):
        raise ValueError(f"theta has shape {values.shape}, expected {(len(model.parameters),)}")
    return values
