"""Whether a simulation is as good as a prediction from sample to sample: then nothing is left to explain."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from daest.diagnosis.evidence.load_starts import rests_on_starts
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import Null
from daest.model.fit import FitResult

RECORDED = ("estimation", "validation")


def simulates_to_noise(null: Null, fit: FitResult, told: FitResult | None) -> bool:
    """Whether the simulation is as good as the one-step prediction of `fit`, with the loads of the `null`, on
    data it has not seen and on those of the fit, which may show more: then nothing acts on the machine that
    the model does not know, whatever small loads the likelihood likes to have. `told` is the fit without
    those. Not where it is that good only by how the loads begin."""
    if told is not None and is_at_noise(null, fit, told):
        return True
    return is_at_noise(null, fit, fit) and not (told is not None and rests_on_starts(null, fit, told))


def is_at_noise(null: Null, fit: FitResult, simulating: FitResult) -> bool:
    """Whether `simulating` does so to the one-step errors of `fit` in all recordings; not where none are
    known."""
    return all(_is_so(simulating, _one_step_errors(null, fit, data), data) for data in RECORDED)


def _one_step_errors(null: Null, fit: FitResult, data: str) -> dict[str, float]:
    """Of each output the one-step error on `data`; empty where there are none. It is at most that on the data
    of the fit and what chance may add: an observer may take long to find the start of unseen data. On the
    data of the fit that much is added: the loads were fitted to them."""
    one_step = fit.one_step
    if data not in one_step:
        return {}
    fitted = one_step["estimation"].rms if "estimation" in one_step else {}
    found: dict[str, float] = {}
    for column, (name, unseen) in enumerate(one_step[data].rms.items()):
        n = sum(int(np.isfinite(e.outputs[:, column]).sum()) for e in null.experiments)
        own = fitted.get(name)
        # The ratio of two rms values of n normal errors each has the standard deviation 1 / sqrt(n).
        limit = np.inf if own is None or n == 0 else own * (1.0 + GATES.min_significance / np.sqrt(n))
        if unseen is not None:
            found[name] = float(limit if data == "estimation" else min(unseen, limit))
    return found


def _is_so(simulating: FitResult, noise: Mapping[str, float], data: str) -> bool:
    simulated = simulating.simulated.get(data)
    return (
        bool(noise)
        and simulated is not None
        and all(
            rms is not None and rms <= GATES.max_to_noise * noise.get(name, 0.0)
            for name, rms in simulated.rms.items()
        )
    )
