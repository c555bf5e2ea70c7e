"""The document of `daest identify`: JSON content of a FitResult."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from daest.model.fit import Agreement, Bootstrap, FitResult, FittedNoise, FittedParameter, Profile

SCHEMA = "daest/identify/1"


def document(result: FitResult) -> dict[str, Any]:
    """JSON-ready summary of an identification; what the data do not determine is None.

    `theta` repeats all parameters of the model, so that later commands need no other file. The standard
    deviation of a direction that is not determined at all is None.
    """
    return {
        "schema": SCHEMA,
        "status": result.status,
        "message": result.message,
        "method": result.method,
        "parameters": {p.name: _parameter(p) for p in result.parameters},
        "theta": dict(result.theta),
        "noise": {
            kind: {n.name: _noise(n) for n in result.noises if n.kind == kind}
            for kind in ("process", "measurement")
        },
        "noise_model": result.noise_model,
        "initial_state": {
            s.experiment: _states(s.names, s.values, s.std_errors) for s in result.initial_states
        },
        "correlation": {
            "names": list(result.correlation_names),
            "matrix": [[_number(v) for v in row] for row in result.correlation],
        },
        "weak_directions": [
            {"combination": dict(d.combination), "relative_std": _number(d.relative_std)}
            for d in result.weak_directions
        ],
        "weak_threshold": result.weak_threshold,
        "log_likelihood": _number(result.log_likelihood),
        "start_log_likelihoods": [_number(v) for v in result.start_log_likelihoods],
        **_agreement(result.simulated),
        "one_step": _agreement(result.one_step),
        "n_samples": result.n_samples,
        "n_iterations": result.n_iterations,
        "seconds": result.seconds,
        "period": result.period,
        "hold": result.hold,
        "notes": list(result.notes),
        "unseen_states": list(result.unseen_states),
        "profiles": {p.name: _profile(p) for p in result.profiles},
        "bootstrap": result.bootstrap and _bootstrap(result.bootstrap),
    }


def _bootstrap(b: Bootstrap) -> dict[str, Any]:
    return {
        "level": b.level,
        "n": len(b.estimates),
        "n_failed": b.n_failed,
        "parameters": {
            name: {
                "lower": float(b.lower[i]),
                "upper": float(b.upper[i]),
                "mean": float(np.mean(b.estimates[:, i])),
                "std": float(np.std(b.estimates[:, i], ddof=1)),
            }
            for i, name in enumerate(b.names)
        },
    }


def _profile(p: Profile) -> dict[str, Any]:
    return {
        "level": p.level,
        "lower": p.lower,
        "upper": p.upper,
        "lower_end": p.lower_end,
        "upper_end": p.upper_end,
        "threshold": p.threshold,
        "values": p.values.tolist(),
        "drops": p.drops.tolist(),
    }


def _parameter(p: FittedParameter) -> dict[str, Any]:
    return {
        "value": p.value,
        "std_error": _number(p.std_error),
        "initial": p.initial,
        "unit": p.unit,
        "min": p.min,
        "max": p.max,
        "at_bound": p.at_bound,
        "prior": p.prior and {"mean": p.prior.mean, "std": p.prior.std},
    }


def _noise(noise: FittedNoise) -> dict[str, Any]:
    quantity = "intensity" if noise.kind == "process" else "std"
    return {
        quantity: noise.value,
        "std_error": _number(noise.std_error),
        "unit": noise.unit,
        "estimated": noise.estimated,
        "at_bound": noise.at_bound,
    }


def _states(names: tuple[str, ...], values: Any, errors: Any) -> dict[str, Any]:
    return {
        name: {"value": _number(value), "std_error": _number(error)}
        for name, value, error in zip(names, values, errors, strict=True)
    }


def _agreement(parts: dict[str, Agreement]) -> dict[str, Any]:
    return {
        "fit_percent": {part: dict(a.fit_percent) for part, a in parts.items()},
        "rms": {part: dict(a.rms) for part, a in parts.items()},
    }


def _number(value: Any) -> float | None:
    """A float, None for what JSON cannot say."""
    return None if value is None or not math.isfinite(value) else float(value)
