"""Experiments that tell rival models apart.

A rival is refitted to what another one would give: what it cannot follow is the expected log-likelihood ratio
(T-optimality; Atkinson and Fedorov 1975), the least over all pairs and over likely parameters of the truth.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from daest.design.explainer import STEPS, Explainer, distance
from daest.model.design import AimName, Expected

SAME = 1e-7  # share of the squared signals, in noise, by which two models differ that are one equation
LEAST = 1e-12  # log-likelihood that stands for none


@dataclass(frozen=True)
class RivalAim:
    """`labels` and `driven` name and hold the rivals; `truths` likely parameters of each, z (p,). A rival is
    told from the truth where it loses more than `margin` in log-likelihood. `orders` are the pairs (truth,
    rival) that are looked at, None for all."""

    labels: tuple[str, ...]
    driven: tuple[Explainer, ...]
    truths: tuple[tuple[np.ndarray, ...], ...]
    margin: float
    orders: tuple[tuple[int, int], ...] | None = None

    name: AimName = "rivals"
    higher_is_better: bool = True
    value_of: str = "expected log-likelihood ratio of the closest pair"

    def merit(self, inputs: np.ndarray) -> float:
        """From the fitted parameters of every rival; the refits are estimated by one projection."""
        found = [distance(other, inputs, made, _nothing(other)) for _, _, other, made in self._pairs(inputs)]
        return float(np.log(max(min(found), LEAST))) if np.all(np.isfinite(found)) else -np.inf

    def gradient(self, inputs: np.ndarray) -> np.ndarray | None:
        return None

    def value(self, merit: float) -> float:
        return float(np.exp(merit))

    def expected(self, recordings: Sequence[np.ndarray]) -> Expected | None:
        """With the rivals refitted; of the closest pair the least over likely parameters of the truth."""
        ratios: dict[str, float] = {}
        for i, j in self._chosen():
            label = self._label(i, j)
            ratio = self._ratio(i, j, self.truths[i][0], recordings)
            ratios[label] = min(ratios.get(label, np.inf), ratio)
        if not ratios or not np.all(np.isfinite(list(ratios.values()))):
            return None
        closest = min(ratios, key=lambda label: ratios[label])
        for i, j in self._chosen():
            if self._label(i, j) == closest:
                others = [self._ratio(i, j, z, recordings) for z in self.truths[i][1:]]
                ratios[closest] = min([ratios[closest], *filter(np.isfinite, others)])
        worst = min(ratios.values())
        return Expected(worst, log_likelihood_ratio=ratios, power=self.power(worst))

    def power(self, ratio: float) -> float:
        """Probability that the truth is ahead by the margin: under it the ratio is normal with that mean, and
        its variance is twice the mean."""
        return float(ndtr((ratio - self.margin) / np.sqrt(2.0 * ratio))) if ratio > LEAST else 0.0

    def watching(self, driven: Sequence[Explainer]) -> RivalAim:
        return replace(self, driven=tuple(driven))

    def groups(self, probes: Sequence[np.ndarray]) -> list[list[int]]:
        """The rivals that do the same with all these inputs, when refitted, together."""
        found: list[list[int]] = []
        for i in range(len(self.driven)):
            home = next((g for g in found if all(self._is_same(g[0], i, inputs) for inputs in probes)), None)
            if home is None:
                found.append([i])
            else:
                home.append(i)
        return found

    def only(self, chosen: Sequence[int]) -> RivalAim:
        """The aim for these rivals alone."""
        labels, driven = tuple(self.labels[i] for i in chosen), tuple(self.driven[i] for i in chosen)
        return RivalAim(labels, driven, tuple(self.truths[i] for i in chosen), self.margin)

    def _is_same(self, i: int, j: int, inputs: np.ndarray) -> bool:
        truth, other = self.driven[i], self.driven[j]
        made = truth.outputs(inputs, truth.start(inputs))
        explained = other.explain(inputs, np.zeros_like(made), other.start(inputs))
        left = distance(other, inputs, made, _nothing(other), STEPS)
        return explained is not None and 0.0 <= left < 0.5 * SAME * float(np.sum(explained.errors**2))

    def hopeful(self, tried: Sequence[np.ndarray]) -> tuple[RivalAim, tuple[str, ...]]:
        """The aim without the pairs that none of these inputs is expected to tell apart by the margin, and
        their labels; the same aim where that would leave none. A pair that no input tells apart would else
        decide which input is the best one for all others."""
        largest: dict[str, float] = {}
        for inputs in tried:
            least: dict[str, float] = {}
            for i, j, other, made in self._pairs(inputs):
                label = self._label(i, j)
                ratio = distance(other, inputs, made, _nothing(other))
                least[label] = min(least.get(label, np.inf), ratio)
            largest = {label: max(ratio, largest.get(label, -np.inf)) for label, ratio in least.items()}
        hopeless = tuple(label for label, ratio in largest.items() if ratio < self.margin)
        if not hopeless or len(hopeless) == len(largest):
            return self, ()
        left = tuple((i, j) for i, j in self._chosen() if self._label(i, j) not in hopeless)
        return replace(self, orders=left), hopeless

    def focused(self, inputs: np.ndarray) -> RivalAim:
        """The aim for the pair alone that is closest with this input."""
        found = [
            (distance(other, inputs, made, _nothing(other)), (i, j))
            for i, j, other, made in self._pairs(inputs)
        ]
        return replace(self, orders=(min(found)[1],))

    def _chosen(self) -> list[tuple[int, int]]:
        if self.orders is not None:
            return list(self.orders)
        count = range(len(self.driven))
        return [(i, j) for i in count for j in count if i != j]

    def _pairs(self, inputs: np.ndarray) -> Iterator[tuple[int, int, Explainer, np.ndarray]]:
        order = self._chosen()
        truths = {i: self.driven[i] for i, _ in order}
        outputs = {i: one.outputs(inputs, one.start(inputs)) for i, one in truths.items()}
        for i, j in order:
            yield i, j, self.driven[j], outputs[i]

    def _label(self, i: int, j: int) -> str:
        return " | ".join(sorted((self.labels[i], self.labels[j])))

    def _ratio(self, i: int, j: int, z: np.ndarray, recordings: Sequence[np.ndarray]) -> float:
        """Of all recordings, with the truth i at z and the rival j refitted to each of them."""
        truth, other = self.driven[i], self.driven[j]
        total = 0.0
        for inputs in recordings:
            made = truth.outputs(inputs, truth.start(inputs, z))
            total += distance(other, inputs, made, _nothing(other), STEPS)
        return total


def _nothing(explainer: Explainer) -> np.ndarray:
    p = len(explainer.coordinates)
    return np.zeros((p, p))
