"""Safe ranges: inputs are made smaller until the model stays within them, and the probability that the
machine leaves them is told."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from daest.design.explainer import Explainer
from daest.errors import EstimationError
from daest.estimation.fitting.setup import known_name
from daest.model.design import Limits, Range, Safety

SMALLEST = 0.02  # of the amplitude: an input that is not safe at this size is given up
HALVINGS = 6  # of the interval in which the largest safe amplitude lies
DRAWS = 40  # of the parameters, for the probability of leaving a safe range
TOLERATED = 0.05  # probability of leaving a safe range beyond which the input is made smaller
CALMER = 0.85  # times the amplitude, at a time
MOST_CALMED = 12


@dataclass(frozen=True)
class Guard:
    """The models that are driven, the safe ranges of their variables, and likely search coordinates of the
    first model (none where nothing is known). `rest` (n_u,): inputs at which the machine is safe; None: not
    looked for."""

    driven: tuple[Explainer, ...]
    ranges: tuple[Range, ...]
    likely: tuple[np.ndarray, ...] = ()
    rest: np.ndarray | None = None

    def rest_of(self, limits: Limits) -> np.ndarray:
        """The inputs (n_u,) around which others are made smaller: `rest`, else where machines rest."""
        return np.array([one.rest for one in limits.inputs]) if self.rest is None else self.rest

    def columns(self, explainer: Explainer) -> list[int]:
        names = [*explainer.output_names, *explainer.variable_names]
        return [known_name(one.name, names, "variable") for one in self.ranges]

    def reach(self, explainer: Explainer, inputs: np.ndarray, z: np.ndarray | None = None) -> np.ndarray:
        """Lowest and highest values (n_ranges, 2); NaN where the model cannot be simulated."""
        at = explainer.start(inputs, z)
        every = np.hstack([explainer.outputs(inputs, at), explainer.variables(inputs, at)])
        found = every[:, self.columns(explainer)]
        return np.column_stack([found.min(axis=0), found.max(axis=0)])

    def is_safe(self, inputs: np.ndarray) -> bool:
        return not self.ranges or all(self._holds(self.reach(one, inputs)) for one in self.driven)

    def kept_safe(self, inputs: np.ndarray, limits: Limits) -> np.ndarray | None:
        """The input, as much smaller around the rest as the safe ranges ask for; None where no size is
        safe."""
        if self.is_safe(inputs):
            return inputs
        rest = self.rest_of(limits)
        low, high = SMALLEST, 1.0
        if not self.is_safe(rest + low * (inputs - rest)):
            return None
        for _ in range(HALVINGS):
            share = 0.5 * (low + high)
            low, high = (share, high) if self.is_safe(rest + share * (inputs - rest)) else (low, share)
        return rest + low * (inputs - rest)

    def probabilities(self, inputs: np.ndarray) -> np.ndarray:
        """Share of likely parameters with which the first model leaves each range, (n_ranges,); NaN where
        nothing is known."""
        if not self.likely or not self.ranges:
            return np.full(len(self.ranges), np.nan)
        reaches = [self.reach(self.driven[0], inputs, z) for z in self.likely]
        return np.asarray(np.mean([~self._inside(reach) for reach in reaches], axis=0))

    def told(self, inputs: np.ndarray) -> tuple[Safety, ...]:
        if not self.ranges:
            return ()
        reach = self.reach(self.driven[0], inputs)
        chances = self.probabilities(inputs)
        return tuple(
            Safety(one, float(low), float(high), float(chance))
            for one, (low, high), chance in zip(self.ranges, reach, chances, strict=True)
        )

    def calmed(self, inputs: np.ndarray, limits: Limits) -> np.ndarray:
        """The input, made smaller until the probability of leaving a range is tolerated."""
        rest = self.rest_of(limits)
        for _ in range(MOST_CALMED):
            if not np.any(self.probabilities(inputs) > TOLERATED):
                break
            inputs = rest + CALMER * (inputs - rest)
        return inputs

    def with_room(self, limits: Limits) -> Guard:
        """The guard with the inputs at which the models stay in the safe ranges: at rest, else the middle of
        the ranges of the inputs. Raises EstimationError `design-unsafe` where neither is safe."""
        rest = np.array([one.rest for one in limits.inputs])
        middle = np.array([one.middle for one in limits.inputs])
        for held in (rest, middle):
            if self.is_safe(np.tile(held, (limits.time.size, 1))):
                return replace(self, rest=held)
        self._refuse(rest, limits)
        return self

    def _refuse(self, held: np.ndarray, limits: Limits) -> None:
        told = ", ".join(f"{value:.4g}" for value in held)
        for explainer in self.driven:
            reach = self.reach(explainer, np.tile(held, (limits.time.size, 1)))
            for one, (low, high), inside in zip(self.ranges, reach, self._inside(reach), strict=True):
                if not inside:
                    raise EstimationError(
                        "design-unsafe",
                        f"{one.name} leaves {one.low:.4g} to {one.high:.4g} {one.unit} although the inputs "
                        f"rest at {told}: it runs from {low:.4g} to {high:.4g}",
                        where=one.name,
                        remedy="widen the safe range, move the ranges of the inputs, or design for the "
                        "reference of a controller (--controller FILE.mo)",
                    )

    def _holds(self, reach: np.ndarray) -> bool:
        return bool(np.all(self._inside(reach)))

    def _inside(self, reach: np.ndarray) -> np.ndarray:
        low = np.array([one.low for one in self.ranges])
        high = np.array([one.high for one in self.ranges])
        return (reach[:, 0] >= low) & (reach[:, 1] <= high)
