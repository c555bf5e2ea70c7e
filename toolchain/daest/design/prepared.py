"""A model with its values and noises, made ready to be driven by designed inputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from daest.design.explainer import Explainer
from daest.design.linear_explainer import LinearExplainer
from daest.design.nonlinear_explainer import NonlinearExplainer
from daest.errors import EstimationError
from daest.estimation.fitting.coordinates import Coordinate, Unknowns, parameter_coordinate
from daest.estimation.fitting.setup import known_name
from daest.model.flat import Dynamics, ExplicitModel, Model
from daest.model.holds import Hold
from daest.systems.linear.linearize import has_affine_dynamics
from daest.systems.linear.state_space import state_space_family
from daest.systems.reduction.reduce import dynamics
from daest.systems.reduction.redundant import good_everywhere
from daest.systems.simulation.integrate import integrator

NO_NOISE = "design-no-noise"


@dataclass(frozen=True)
class Subject:
    """A model to be driven: `flat` with the values of its fit and sizes of its noises, the names of its
    unknown parameters, and whether the sizes of the noises are unknown too."""

    flat: Model
    names: tuple[str, ...]
    unknown_noise: bool = False


def estimated_names(flat: Model) -> tuple[str, ...]:
    """The parameters that the model marks as unknown."""
    return tuple(p.name for p in flat.parameters if p.estimate)


def explainer(subject: Subject, period: float, hold: Hold) -> Explainer:
    """The model ready to be driven at a period. Raises EstimationError `design-no-noise` where an output has
    no noise, `unknown-parameter`, and ModelError of the reduction."""
    flat = _with_noise(subject.flat)
    explicit = dynamics(flat)
    if isinstance(explicit, ExplicitModel) and has_affine_dynamics(explicit):
        unknowns = _unknowns(subject, flat, with_noises=subject.unknown_noise)
        return LinearExplainer(explicit, unknowns, period, hold, family=state_space_family(explicit))
    return _nonlinear(subject, flat, explicit, period, hold)


def _nonlinear(
    subject: Subject, flat: Model, explicit: Dynamics, period: float, hold: Hold
) -> NonlinearExplainer:
    unknowns = _unknowns(subject, flat, with_noises=False)
    model = integrator(good_everywhere(explicit), subject.names)
    return NonlinearExplainer(model.explicit, unknowns, period, hold, model=model)


def with_rows(prepared: Explainer, rows: Sequence[int]) -> Explainer:
    """The same model with these outputs alone measured."""
    assert isinstance(prepared, LinearExplainer | NonlinearExplainer)
    return replace(prepared, rows=tuple(rows), _kept={})


def _with_noise(flat: Model) -> Model:
    """The model; noises of the process that have no size are none."""
    for output in flat.outputs:
        if not output.noise_std:
            raise EstimationError(
                NO_NOISE,
                f"nothing is known of the measurement noise of {output.name}",
                where=output.name,
                remedy="fit the model to a recording first (daest identify), or give it a size in "
                f"daest.toml: [noise.measurement] {output.name} = {{ std = ... }}",
            )
    if not flat.outputs:
        raise EstimationError(
            NO_NOISE, "the model has no measured output", remedy="declare what you measure as outputs"
        )
    return replace(flat, noises=tuple(replace(w, intensity=w.intensity or 0.0) for w in flat.noises))


def _unknowns(subject: Subject, flat: Model, *, with_noises: bool) -> Unknowns:
    known = flat.parameter_names
    chosen = [flat.parameters[known_name(name, known, "parameter")] for name in subject.names]
    coordinates = [parameter_coordinate(flat, p.name, p.value, (p.min, p.max)) for p in chosen]
    intensity = np.array([w.intensity for w in flat.noises], dtype=float)
    std = np.array([y.noise_std for y in flat.outputs], dtype=float)
    if with_noises and np.any(intensity > 0.0):
        sized = [(i, w) for i, w in enumerate(flat.noises) if w.intensity]
        coordinates += [_size(w.name, "process", i, w.intensity or 0.0) for i, w in sized]
        coordinates += [
            _size(y.name, "measurement", i, y.noise_std or 0.0) for i, y in enumerate(flat.outputs)
        ]
    return Unknowns(tuple(coordinates), flat.theta_values, intensity, std)


def _size(name: str, kind: str, index: int, value: float) -> Coordinate:
    return Coordinate(
        name=name,
        kind="process" if kind == "process" else "measurement",
        index=index,
        initial=float(value),
        is_log=True,
        scale=1.0,
        lower=0.0,
        upper=np.inf,
    )
