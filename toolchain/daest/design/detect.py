"""Experiments that show an effect of a given size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from daest.design.drawn import Drawn, Required
from daest.design.explainer import Explained, Explainer
from daest.design.loads import Absorbed, Bank, Evidence, Loads, Shown, shown
from daest.design.nonlinear_explainer import NonlinearExplainer
from daest.model.design import AimName, Expected

POWER = 0.95  # with which an effect is to be seen
LEAST = 1e-12  # evidence that stands for none
GROWTH = 1.5  # factor between the sizes by which the smallest one is enclosed
MOST_GROWTHS = 12
HALVINGS = 5  # of that factor
ASIDE = 0.1  # share by which a size is changed to tell what it does alone
NEAR = 1.1  # times: a response is in proportion to the size so far
ROUNDS = 6  # of the search for the smallest size, each with the response to the last one


@dataclass(frozen=True)
class DetectAim:
    """`null` is the model without the effect, through whose noises `loads` act, `effect` the one with it,
    whose coordinates are the sizes of the effect in the proportions `sizes`; `size` is the first of those
    that the input is designed for. An effect is seen where `required` is met by a recording whose other half
    has the same input."""

    null: Explainer
    effect: Explainer
    sizes: np.ndarray
    size: float
    required: Required
    loads: Loads
    _banks: dict[int, Bank] = field(default_factory=dict, repr=False, compare=False)

    name: AimName = "detect"
    higher_is_better: bool = True
    value_of: str = "expected evidence: twice the log-likelihood ratio that unknown loads leave"

    @property
    def driven(self) -> tuple[Explainer, ...]:
        return (self.null, self.effect)

    def merit(self, inputs: np.ndarray) -> float:
        found = self.evidence([inputs], self.size)
        return -np.inf if found is None else float(np.log(max(found.evidence, LEAST)))

    def gradient(self, inputs: np.ndarray) -> np.ndarray | None:
        return None

    def value(self, merit: float) -> float:
        return float(np.exp(merit))

    def expected(self, recordings: Sequence[np.ndarray]) -> Expected | None:
        aim = self._about_their_motion()
        found = aim.evidence(recordings, self.size)
        if found is None:
            return None
        power = aim.power(recordings, self.size)
        return Expected(max(found.evidence, 0.0), power=power, smallest_size=aim.smallest(recordings))

    def _about_their_motion(self) -> DetectAim:
        """The aim that has seen no input: how loads reach the errors of a nonlinear model is linear about the
        first motion that is asked for."""
        if not isinstance(self.null, NonlinearExplainer):
            return self
        return replace(self, null=replace(self.null, _kept={}), _banks={})

    def watching(self, driven: Sequence[Explainer]) -> DetectAim:
        return replace(self, null=driven[0], effect=driven[1], _banks={})

    def focused(self, inputs: np.ndarray) -> DetectAim:
        return self

    def evidence(self, recordings: Sequence[np.ndarray], size: float) -> Absorbed | None:
        """Twice the expected log-likelihood ratio of half recordings at a size, with the model refitted
        beside loads; None where it cannot be simulated. Shapes: recordings (n_samples, n_u) each."""
        whole = self._evidence(recordings, size)
        found = None if whole is None else whole.least()
        return found if found is not None and np.isfinite(found.evidence) else None

    def power(self, recordings: Sequence[np.ndarray], size: float) -> float:
        """Probability that the effect is named in recordings whose halves have these inputs each. Shapes:
        recordings (n_samples, n_u) each."""
        drawn = self._drawn(recordings, size)
        return 0.0 if drawn is None else drawn.power(1.0)

    def smallest(self, recordings: Sequence[np.ndarray]) -> float:
        """The size that is named with the power POWER; NaN where none is found. Shapes: recordings
        (n_samples, n_u) each."""
        size = self.size
        for _ in range(ROUNDS):
            drawn = self._drawn(recordings, size)
            share = np.nan if drawn is None else _smallest_share(drawn)
            size *= share
            if not np.isfinite(share) or 1.0 / NEAR < share < NEAR:
                break
        return size

    def _drawn(self, recordings: Sequence[np.ndarray], size: float) -> Drawn | None:
        whole = self._evidence(recordings, size)
        return None if whole is None else Drawn(whole, self.required)

    def _evidence(self, recordings: Sequence[np.ndarray], size: float) -> Evidence | None:
        parts, bank = self._shown(recordings, size), self._bank(recordings)
        return None if parts is None or bank is None else Evidence(bank, parts)

    def _bank(self, recordings: Sequence[np.ndarray]) -> Bank | None:
        n_samples = sum(inputs.shape[0] for inputs in recordings)
        if n_samples not in self._banks:
            model = self.null.error_model(recordings[0])
            if model is None:
                return None
            self._banks[n_samples] = Bank(model, self.loads, n_samples)
        return self._banks[n_samples]

    def _shown(self, recordings: Sequence[np.ndarray], size: float) -> list[Shown] | None:
        """What the null leaves of every recording with the effect; None where it cannot be simulated."""
        sizes = self.sizes * (size / self.sizes[0])
        found = []
        for inputs in recordings:
            whole = self._left(inputs, sizes)
            if whole is None:
                return None
            own = [whole.errors]
            if sizes.size > 1:
                others = [self._left(inputs, sizes * (1.0 + ASIDE * one)) for one in np.eye(sizes.size)]
                own = [other.errors - whole.errors for other in others if other is not None]
            found.append(shown(whole, own, len(self.null.output_names)))
        return found

    def _left(self, inputs: np.ndarray, sizes: np.ndarray) -> Explained | None:
        """A recording with an effect of these sizes, explained by the null."""
        z = np.array([c.searched(v) for c, v in zip(self.effect.coordinates, sizes, strict=True)])
        made = self.effect.outputs(inputs, self.effect.start(inputs, z))
        if not np.all(np.isfinite(made)):
            return None
        return self.null.explain(inputs, made, self.null.start(inputs))


def _smallest_share(drawn: Drawn) -> float:
    """The share of the size that is named with the power POWER; NaN where none is found."""
    high = 1.0
    for _ in range(MOST_GROWTHS):
        if drawn.power(high) >= POWER:
            break
        high *= GROWTH
    else:
        return float("nan")
    low = high / GROWTH
    for _ in range(MOST_GROWTHS if high == 1.0 else 0):
        if drawn.power(low) < POWER:
            break
        low, high = low / GROWTH, low
    for _ in range(HALVINGS):
        middle = float(np.sqrt(low * high))
        low, high = (low, middle) if drawn.power(middle) >= POWER else (middle, high)
    return high
