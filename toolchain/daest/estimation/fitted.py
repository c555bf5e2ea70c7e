"""The model that a fit leaves: its parameters and noises put into the equations."""

from __future__ import annotations

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
    sizes = {(noise.kind, noise.name): noise.value for noise in fit.noises}
    none = 0.0 if fit.method == "oe" else None
    return replace(
        flat.with_theta(fit.theta),
        noises=tuple(
            replace(w, intensity=sizes.get(("process", w.name), w.intensity if none is None else none))
            for w in flat.noises
        ),
        outputs=tuple(
            replace(y, noise_std=sizes.get(("measurement", y.name), y.noise_std)) for y in flat.outputs
        ),
    )
