"""What a filter gets, and what it returns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from daest.errors import EstimationError
from daest.model.estimates import FilterOptions
from daest.model.experiment import Experiment
from daest.model.flat import Dynamics, Model
from daest.model.linear import StateSpace, StateSpaceFamily
from daest.systems.linear.linearize import is_affine_model
from daest.systems.linear.state_space import state_space, state_space_family
from daest.systems.reduction.reduce import dynamics

AnyModel = Model | Dynamics | StateSpaceFamily | StateSpace


def linear_refused(name: str) -> EstimationError:
    """The error for a filter of one linear model, where the model has events."""
    return EstimationError(
        "filter-events",
        f"the {name} filter sees one linear model, and the model changes at events (when, reinit, pre, "
        "sample)",
        remedy="use ekf, ukf or particle, which follow the events",
    )


@dataclass(frozen=True)
class FilterModel:
    """A model with numbers for its parameters and its noise, in the forms that filters take. Each form is
    made when it is first asked for and serves all recordings.

    theta (n_parameters,); intensity (n_w, n_w): two-sided spectral densities of the white noises; cov (n_y,
    n_y): of one sample of the measurement noises, both in the order of the model.
    """

    model: AnyModel
    theta: np.ndarray
    intensity: np.ndarray
    cov: np.ndarray

    @classmethod
    def of(cls, model: AnyModel, options: FilterOptions) -> FilterModel:
        """The model with the numbers of `options`, its own where these give none. Raises EstimationError
        `filter-noise-unknown`."""
        parts = _parts(model)
        if isinstance(parts, StateSpace):
            theta = np.zeros(0)
            processes: list[tuple[str, float | None]] = [(name, None) for name in parts.noise_names]
            sensors: list[tuple[str, float | None]] = [(name, None) for name in parts.output_names]
        else:
            theta = np.array([p.value for p in parts.parameters])
            processes = [(w.name, w.intensity) for w in parts.noises]
            sensors = [(y.name, y.noise_std) for y in parts.outputs]
        process, measurement = options.process_intensity, options.measurement_cov
        if process is None:
            process = _known(processes, "intensity", "process")
        if measurement is None:
            measurement = _known(sensors, "std", "measurement") ** 2
        return cls(
            model,
            theta if options.theta is None else np.asarray(options.theta, dtype=float),
            square(process, len(processes)),
            square(measurement, len(sensors)),
        )

    @property
    def flat(self) -> Model | None:
        """The model, unless it was given as matrices."""
        parts = _parts(self.model)
        return parts if isinstance(parts, Model) else None

    @property
    def output_names(self) -> tuple[str, ...]:
        parts = _parts(self.model)
        return parts.output_names if isinstance(parts, StateSpace) else tuple(y.name for y in parts.outputs)

    @property
    def noise_names(self) -> tuple[str, ...]:
        parts = _parts(self.model)
        return parts.noise_names if isinstance(parts, StateSpace) else tuple(w.name for w in parts.noises)

    @property
    def units(self) -> dict[str, str]:
        """Of the variables, by name; empty for a model in state space, which has none."""
        parts = _parts(self.model)
        if isinstance(parts, StateSpace):
            return {}
        outputs = {y.name: y.unit for y in parts.outputs}
        return outputs | {v.name: v.unit for v in parts.unknowns}

    @property
    def noise_units(self) -> tuple[str, ...]:
        parts = _parts(self.model)
        return (
            ("",) * len(parts.noise_names)
            if isinstance(parts, StateSpace)
            else tuple(w.unit for w in parts.noises)
        )

    @property
    def is_affine(self) -> bool:
        if self.flat is not None:
            return is_affine_model(self.flat)
        return not isinstance(self.model, StateSpaceFamily) or self.model.is_affine

    @cached_property
    def linear(self) -> StateSpace:
        """The model linearised at its operating point; itself where it is affine."""
        if isinstance(self.model, StateSpace):
            return self.model
        family = self.model if isinstance(self.model, StateSpaceFamily) else state_space_family(self.model)
        return state_space(family, self.theta)

    @cached_property
    def explicit(self) -> Dynamics:
        """ẋ = f(x, u, w, θ, t). Raises EstimationError `filter-linear-model` for a model that is given as
        matrices."""
        if isinstance(self.model, Dynamics):
            return self.model
        if self.flat is None:
            raise EstimationError(
                "filter-linear-model",
                "this filter needs the equations of the model, and it was given as matrices",
                remedy="give the model of compile_model, or use the time-varying filter",
            )
        return dynamics(self.flat)

    def independent_noise(self) -> tuple[np.ndarray, np.ndarray]:
        """Intensities (n_w,) and measurement variances (n_y,). Raises EstimationError
        `filter-noise-correlated` where one noise depends on another."""
        for what, square in (("process", self.intensity), ("measurement", self.cov)):
            if np.any(square != np.diag(np.diagonal(square))):
                raise EstimationError(
                    "filter-noise-correlated",
                    f"this filter takes independent {what} noises, and a full matrix was given",
                    remedy="give one number per noise, or use the time-varying filter",
                )
        return np.diagonal(self.intensity).copy(), np.diagonal(self.cov).copy()


@dataclass(frozen=True)
class Case:
    """A model and one recording of it. `measure` are the outputs to use; `tell` is called with texts about
    the progress."""

    model: FilterModel
    experiment: Experiment
    measure: tuple[str, ...]
    options: FilterOptions
    tell: Callable[[str], None]

    @property
    def measured(self) -> Experiment:
        """The recording without the outputs that are not used."""
        outputs = self.experiment.outputs_of(self.measure)
        return replace(self.experiment, outputs=outputs, output_names=self.measure)


@dataclass(frozen=True)
class Estimates:
    """What a filter finds.

    values, std (n_samples, n_v) of the variables `names`; noise_values, noise_std (n_samples, n_w) of the
    process noise, mean of each interval; innovations (n_samples, n_used), one column per used output; nis:
    sum of all normalised innovations squared, over `n_innovations` of them. `noise` "held": white noise was
    held over each sample. `steady_sample`: the first with nearly the stationary gain, None if there is none.
    `effective` (n_samples,): effective sample sizes of a particle filter. `messages`: sentences for the user.
    """

    names: tuple[str, ...]
    values: np.ndarray
    std: np.ndarray
    noise_values: np.ndarray
    noise_std: np.ndarray
    innovations: np.ndarray
    nis: float
    n_innovations: int
    log_likelihood: float
    noise: Literal["white", "held"] = "white"
    steady_sample: int | None = None
    effective: np.ndarray | None = None
    messages: tuple[str, ...] = ()


def _parts(model: AnyModel) -> Model | StateSpaceFamily | StateSpace:
    return model.flat if isinstance(model, Dynamics) else model


def _known(sizes: Sequence[tuple[str, float | None]], what: str, section: str) -> np.ndarray:
    unknown = [name for name, size in sizes if size is None]
    if unknown:
        raise EstimationError(
            "filter-noise-unknown",
            f"the {section} noise of {', '.join(unknown)} has no {what}",
            remedy="estimate it with daest identify, or give it in daest.toml: "
            f'[noise.{section}] "{unknown[0]}" = {{ {what} = ... }}',
        )
    return np.array([size for _, size in sizes], dtype=float)


def square(value: np.ndarray, size: int) -> np.ndarray:
    """A covariance (size, size), also of one that is given by its diagonal (size,)."""
    value = np.asarray(value, dtype=float)
    return np.diag(value) if value.ndim == 1 else value.reshape(size, size)
