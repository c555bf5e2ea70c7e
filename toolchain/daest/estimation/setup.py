"""What is fitted, whatever predicts: unknown parameters, recordings, and which noises are known."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from daest.errors import EstimationError
from daest.estimation.checks import check_bounds, check_records, known_name
from daest.estimation.coordinates import Unknowns, coordinate_with_prior, parameter_coordinate
from daest.estimation.records import in_model_order, part_of
from daest.model.experiment import Experiment
from daest.model.fit import IdentifyOptions, Method, NoiseChoice
from daest.model.linear import StateSpaceFamily
from daest.model.parts import prior_unused
from daest.systems.sample import slope_note


@dataclass(frozen=True)
class Setup:
    """`unknowns` are parameters alone; the recordings have the model's order of signals. `intensity` (n_w,)
    and `std` (n_y,) are those of the noises, NaN where unknown, with those that are estimated, (n_w,) and
    (n_y,) bool. `notes` are what the user is told besides."""

    unknowns: Unknowns
    experiments: tuple[Experiment, ...]
    method: Method
    intensity: np.ndarray
    estimate_intensity: np.ndarray
    std: np.ndarray
    estimate_std: np.ndarray
    options: IdentifyOptions
    validation: tuple[Experiment, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def given_std(self) -> np.ndarray:
        """(n_y,), NaN where estimated."""
        return np.where(self.estimate_std, np.nan, self.std)

    @property
    def has_free_size(self) -> bool:
        """Whether all noises can grow by a common factor."""
        held = self.intensity[~self.estimate_intensity]
        return bool(np.all(np.isnan(self.given_std)) and np.all(np.nan_to_num(held) == 0.0))

    @property
    def n_observed(self) -> int:
        """Measured values of all recordings."""
        return sum(int(np.isfinite(e.outputs).sum()) for e in self.experiments)


def setup_of(
    family: StateSpaceFamily,
    experiments: Sequence[Experiment],
    validation: Sequence[Experiment],
    options: IdentifyOptions,
) -> Setup:
    """The choices of the model, overruled by the options. Raises EstimationError and DataError of unknown
    names, bounds, priors, and recordings that are missing or too short."""
    estimated, held_back = _divided(tuple(experiments), tuple(validation), options.split)
    recordings = tuple(in_model_order(e, family) for e in estimated)
    intensity, process = _noise_choices(
        [n.name for n in family.noises],
        [NoiseChoice(n.intensity, n.estimate or n.intensity is None) for n in family.noises],
        options.process_noise,
        "noise",
    )
    std, measurement = _noise_choices(
        [o.name for o in family.outputs],
        [NoiseChoice(o.noise_std, o.estimate_noise or o.noise_std is None) for o in family.outputs],
        options.measurement_noise,
        "output",
    )
    method: Method = options.method or ("pem" if family.noises else "oe")
    measured = np.array(
        [any(np.isfinite(e.outputs[:, j]).any() for e in recordings) for j in range(std.size)], dtype=bool
    )
    std = np.where(~measured & np.isnan(std), 1.0, std)
    unknowns = _unknowns(family, options, np.where(np.isnan(std), 1.0, std))
    n_noises = int(np.sum(measurement & measured)) + (int(np.sum(process)) if method == "pem" else 0)
    check_records(family, recordings, len(unknowns.coordinates) + n_noises)
    silent = [o.name for o, m in zip(family.outputs, measured, strict=True) if not m]
    return Setup(
        unknowns,
        recordings,
        method,
        intensity,
        process,
        std,
        measurement & measured,
        options,
        tuple(in_model_order(e, family) for e in held_back),
        (*_hold_note(family, options), *(f"output {name} has no measured value" for name in silent)),
    )


def _divided(
    experiments: tuple[Experiment, ...], validation: tuple[Experiment, ...], split: float | None
) -> tuple[tuple[Experiment, ...], tuple[Experiment, ...]]:
    """Estimation and validation records; error `split-out-of-range`."""
    if split is None:
        return experiments, validation
    if not 0.0 < split < 1.0:
        raise EstimationError(
            "split-out-of-range",
            f"the split {split:g} leaves nothing to estimate from or nothing to validate with",
            remedy="give a number between 0 and 1",
        )
    cuts = [max(1, round(split * e.n_samples)) for e in experiments]
    first = tuple(part_of(e, 0, cut) for e, cut in zip(experiments, cuts, strict=True))
    rest = tuple(part_of(e, cut, e.n_samples) for e, cut in zip(experiments, cuts, strict=True))
    return first, (*rest, *validation)


def _hold_note(family: StateSpaceFamily, options: IdentifyOptions) -> tuple[str, ...]:
    if options.hold is not None:
        return ()
    return slope_note([v.name for v in family.inputs], [i for i, _ in family.input_derivatives])


def _unknowns(family: StateSpaceFamily, options: IdentifyOptions, std: np.ndarray) -> Unknowns:
    """The coordinates of the unknown parameters among all of them, with fixed and start values put in; `std`
    stands for the measurement noises until they are found."""
    known = [p.name for p in family.parameters]
    theta = np.array([p.value for p in family.parameters], dtype=float)
    for name, value in {**options.start, **options.fix}.items():
        theta[known_name(name, known, "parameter")] = value
    for name in options.bounds:
        known_name(name, known, "parameter")
    names = options.estimate
    if names is None:
        names = tuple(p.name for p in family.parameters if p.estimate)
    names = tuple(n for n in names if n not in options.fix)
    for name in options.prior:
        known_name(name, known, "parameter")
        if name not in names:
            raise prior_unused(name)
    indices = [known_name(n, known, "parameter") for n in names]
    if not names:
        raise EstimationError(
            "identify-nothing-to-estimate",
            "no parameter is marked as unknown",
            remedy="mark it in the model (__Daest(estimate = true)) or in daest.toml ([parameters] "
            "NAME = { estimate = true }), or name it (--estimate NAME)",
        )
    coordinates = []
    for name, index in zip(names, indices, strict=True):
        parameter = family.parameters[index]
        bounds = options.bounds.get(name, (parameter.min, parameter.max))
        coordinate = parameter_coordinate(family, name, float(theta[index]), bounds)
        check_bounds(coordinate)
        coordinates.append(coordinate_with_prior(coordinate, options.prior.get(name, parameter.prior)))
    return Unknowns(tuple(coordinates), theta, np.zeros(len(family.noises)), std)


def _noise_choices(
    names: list[str], defaults: Iterable[NoiseChoice], given: Mapping[str, NoiseChoice], what: str
) -> tuple[np.ndarray, np.ndarray]:
    """Values, NaN where unknown, and which are estimated, of the model overruled by the options."""
    choices = list(defaults)
    for name, choice in given.items():
        i = known_name(name, names, what)
        value = choices[i].value if choice.value is None else choice.value
        estimate = choices[i].estimate if choice.estimate is None else choice.estimate
        choices[i] = NoiseChoice(value, bool(estimate) or value is None)
    values = np.array([np.nan if c.value is None else c.value for c in choices], dtype=float)
    return values, np.array([bool(c.estimate) for c in choices], dtype=bool)
