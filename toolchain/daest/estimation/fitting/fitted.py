"""The model that a fit leaves: its parameters and noises put into the equations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from daest.model.fit import FitResult
from daest.model.flat import Model


def fitted_model(flat: Model, fit: FitResult) -> Model:
    """The model with all parameters of the fit, process intensities and measurement standard deviations.

    An output-error fit has no process noise, and then the model has none. Names present in
    only one of them are ignored.

        >>> bool(daest.fitted_model(flat, fit).theta_values[4] == fit.theta["R"])
        True
    """
    intensity, std = (
        {noise.name: noise.value for noise in fit.noises if noise.kind == kind}
        for kind in ("process", "measurement")
    )
    return with_fit_values(flat, fit.method, fit.theta, intensity, std)


def with_fit_values(
    flat: Model,
    method: str | None,
    theta: Mapping[str, float],
    intensity: Mapping[str, float],
    std: Mapping[str, float],
) -> Model:
    """The same of values by name: parameters, process intensities and measurement standard deviations."""
    without = 0.0 if method == "oe" else None
    return replace(
        flat.with_theta(theta),
        noises=tuple(
            replace(w, intensity=intensity.get(w.name, w.intensity if without is None else without))
            for w in flat.noises
        ),
        outputs=tuple(replace(y, noise_std=std.get(y.name, y.noise_std)) for y in flat.outputs),
    )
