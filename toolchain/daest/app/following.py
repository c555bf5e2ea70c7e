"""The process that simulates while a slider is dragged: a model with its recordings, JSON lines in and out.

The first line out tells the parameters, their ranges and what was measured. Every line in is a set of values,
answered by the simulated curves. It ends when its input does.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from daest.diagnosis.comparison.compare import follower
from daest.diagnosis.comparison.trial import Candidate, agreement
from daest.model.experiment import Experiment
from daest.model.parts import Parameter
from daest.report.page.plots import comparison_plots, thinned

MOST_POINTS = 1200  # of a curve: more than a screen has columns for a smallest and a largest value each
BAND = 1.96  # standard deviations to either side of a 95 % band
WIDTH = 20.0  # standard errors that a slider reaches to either side
LEAST_FACTOR, MOST_FACTOR = 2.0, 10.0  # that a slider of a logarithmic parameter spans to either side
LEAST_SHARE = 0.5  # of its value that a slider of a linear parameter spans to either side
SLOPE_STEP = 0.1  # standard errors, of the differences behind the band
Tell = Callable[[dict[str, Any]], None]


@dataclass(frozen=True)
class Following:
    """A candidate ready to be simulated at any values. `errors` are the standard errors by name."""

    candidate: Candidate
    experiments: Sequence[Experiment]
    simulate: Callable[[np.ndarray], tuple[np.ndarray, ...]]
    errors: Mapping[str, float]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return self.candidate.flat.parameters

    def theta(self, values: Mapping[str, Any]) -> np.ndarray:
        """The values of the candidate with those of the page; what is no number there changes nothing.
        Shapes: (n_theta,)."""
        given = {p.name: values.get(p.name) for p in self.parameters}
        return np.array(
            [v if isinstance(v := given[p.name], int | float) else p.value for p in self.parameters],
            dtype=float,
        )


def follow(
    candidate: Candidate,
    experiments: Sequence[Experiment],
    errors: Mapping[str, float],
    lines: Iterable[str],
    tell: Tell,
) -> None:
    """Answer every line until there are no more. A line is {"id", "values", "window", "recording"} or, for
    the band of the prediction, {"id", "band": true, "window", "recording"}."""
    found = Following(candidate, experiments, follower(candidate, experiments), errors)
    tell(described(found))
    for line in lines:
        asked = json.loads(line)
        tell(band(found, asked) if asked.get("band") else followed(found, asked))


def beside(model: Candidate, extended: Candidate, experiments: Sequence[Experiment]) -> dict[str, Any]:
    """A model and the same with a candidate on the data: errors, and the plot of the first recording."""
    flat, first = model.flat, experiments[0]
    simulated = [
        follower(one, experiments)(one.flat.theta_values)
        for one in (model, replace(extended, hold=model.hold))
    ]
    series = {"0.time": first.time, "0.measured": first.outputs}
    series |= {f"0.{m}.simulated": outputs[0] for m, outputs in enumerate(simulated)}
    models = [{"name": one.name, "where": []} for one in (model, extended)]
    units = {o.name: o.unit for o in flat.outputs}
    document = {"outputs": units, "models": models, "data": [first.name]}
    (plot,) = comparison_plots(document, series, ("as it is", "with it"))
    return {
        "rms": [agreement(flat, experiments, outputs).rms for outputs in simulated],
        "plot": {"label": plot.label, "note": plot.note, "item": plot.item},
    }


def described(found: Following) -> dict[str, Any]:
    """What the page has to know of the model and of the recordings."""
    flat = found.candidate.flat
    return {
        "kind": "followable",
        "model": flat.name,
        "parameters": [_slider(p, found.errors.get(p.name)) for p in flat.parameters],
        "outputs": [{"name": o.name, "unit": o.unit} for o in flat.outputs],
        "recordings": [
            {"name": e.name, "start": float(e.time[0]), "stop": float(e.time[-1])} for e in found.experiments
        ],
    }


def followed(found: Following, asked: Mapping[str, Any]) -> dict[str, Any]:
    """Curves and errors at the values that were asked for."""
    began = time.perf_counter()
    with np.errstate(all="ignore"):
        outputs = found.simulate(found.theta(asked.get("values", {})))
        told = agreement(found.candidate.flat, found.experiments, outputs)
    r = _recording(found, asked)
    shown = _shown(found.experiments[r], asked)
    return {
        "kind": "followed",
        "id": asked.get("id"),
        "rms": told.rms,
        "fit_percent": told.fit_percent,
        "curves": [_curve(found.experiments[r].time, column, shown) for column in outputs[r].T],
        "measured": [
            _curve(found.experiments[r].time, column, shown) for column in found.experiments[r].outputs.T
        ]
        if asked.get("measured")
        else None,
        "seconds": time.perf_counter() - began,
    }


def band(found: Following, asked: Mapping[str, Any]) -> dict[str, Any]:
    """Where the simulation lies with 95 % for all that the parameters are uncertain, to first order."""
    candidate, r = found.candidate, _recording(found, asked)
    shown = _shown(found.experiments[r], asked)
    names, cov = candidate.parameter_names, candidate.parameter_cov
    theta = candidate.flat.theta_values
    bands: list[Any] | None = None
    if names and cov is not None:
        index = [[p.name for p in found.parameters].index(name) for name in names]
        steps = SLOPE_STEP * np.sqrt(np.diagonal(cov))
        base = found.simulate(theta)[r]
        slopes = []
        for i, step in zip(index, steps, strict=True):
            moved = theta.copy()
            moved[i] += step
            slopes.append((found.simulate(moved)[r] - base) / step if step > 0.0 else np.zeros_like(base))
        spread = BAND * np.sqrt(np.maximum(np.einsum("itj,ik,ktj->tj", slopes, cov, slopes), 0.0))
        bands = [
            {
                "low": _curve(found.experiments[r].time, b - s, shown, b),
                "high": _curve(found.experiments[r].time, b + s, shown, b),
            }
            for b, s in zip(base.T, spread.T, strict=True)
        ]
    return {"kind": "band", "id": asked.get("id"), "bands": bands}


def _recording(found: Following, asked: Mapping[str, Any]) -> int:
    number = asked.get("recording", 0)
    return number if isinstance(number, int) and 0 <= number < len(found.experiments) else 0


def _shown(experiment: Experiment, asked: Mapping[str, Any]) -> slice:
    """The samples of the window that the page shows, and one to either side."""
    window = asked.get("window")
    if not isinstance(window, list) or len(window) != 2:
        return slice(None)
    first, last = np.searchsorted(experiment.time, np.array(window, dtype=float))
    return slice(max(int(first) - 1, 0), int(last) + 1)


def _curve(
    time_: np.ndarray, values: np.ndarray, shown: slice, like: np.ndarray | None = None
) -> dict[str, Any]:
    """Points of a curve, those that matter for the curve `like`; None where it is not finite."""
    t, y = time_[shown], values[shown]
    at = thinned(y if like is None else like[shown], MOST_POINTS)
    return {
        "x": np.round(t[at], 9).tolist(),
        "y": [None if v - v != 0.0 else float(f"{v:.7g}") for v in y[at]],
    }


def _slider(parameter: Parameter, error: float | None) -> dict[str, Any]:
    value = parameter.value
    is_log = value > 0.0 and (
        parameter.scale == "log" or (parameter.min is not None and parameter.min >= 0.0)
    )
    if is_log:
        factor = LEAST_FACTOR if error is None else math.exp(min(WIDTH * error / value, 10.0))
        factor = min(max(factor, LEAST_FACTOR), MOST_FACTOR)
        low, high = value / factor, value * factor
    else:
        half = max(WIDTH * (error or 0.0), LEAST_SHARE * abs(value)) or 1.0
        low, high = value - half, value + half
    return {
        "name": parameter.name,
        "unit": parameter.unit,
        "description": parameter.description,
        "value": value,
        "std_error": error,
        "estimated": parameter.estimate,
        "log": is_log,
        "low": low if parameter.min is None else max(low, min(parameter.min, value)),
        "high": high if parameter.max is None else min(high, max(parameter.max, value)),
    }
