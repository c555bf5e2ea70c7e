"""Recordings that contradict the model whatever it lacks: a sensor that is mounted the other way round, or
counts in another unit.

No effect of a library turns a signal round, and one that seems to is not what is missing. Where the model as
it is simulates the mended recording, and not the one that was given, all that is to be said is what to mend.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from daest.data.contradictions import Contradiction, all_mended, contradictions
from daest.diagnosis.gates import GATES
from daest.diagnosis.settled import FAILURES
from daest.diagnosis.stand import quiet, without_noises
from daest.estimation.identify import identify
from daest.model.diagnosis import Diagnosis, Screen
from daest.model.experiment import Experiment
from daest.model.fit import FitResult, IdentifyOptions
from daest.model.flat import FlatModel, Model
from daest.model.holds import Hold


def contradicted(
    flat: Model, experiments: Sequence[Experiment], validation: Sequence[Experiment], hold: Hold | None
) -> Diagnosis | None:
    """What is to be mended in the recordings before anything can be said of missing effects; None where they
    do not contradict the model, or a simulation does not show that this is why it does not match."""
    began = time.perf_counter()
    found = contradictions(flat, experiments[0]) if experiments else []
    if not found:
        return None
    mended = [all_mended(e, found) for e in experiments]
    silent = without_noises(flat) if isinstance(flat, FlatModel) else flat
    with quiet(), suppress(*FAILURES):
        options = IdentifyOptions(method="oe", hold=hold, second_look=False)
        given = identify(silent, experiments, options, validation=validation)
        better = identify(silent, mended, options)
        if better.log_likelihood > given.log_likelihood + len(found) and _is_why(given, better, found):
            return _told(given, better, found, time.perf_counter() - began)
    return None


def _is_why(given: FitResult, better: FitResult, found: Sequence[Contradiction]) -> bool:
    """Whether the model follows what was mended, and not as it was given; one of several inputs may leave
    some of the outputs as they are."""
    outputs = better.simulated["estimation"].fit_percent
    turned = [one.signal for one in found if one.signal in outputs]
    names = turned or list(outputs)

    def follows(fit: FitResult) -> list[bool]:
        percents = fit.simulated["estimation"].fit_percent
        return [(percents[name] or 0.0) > GATES.min_driven_fit for name in names]

    as_given = follows(given)
    return all(follows(better)) and not (any(as_given) if turned else all(as_given))


def _told(given: FitResult, better: FitResult, found: Sequence[Contradiction], seconds: float) -> Diagnosis:
    texts = "; ".join(f"{one.signal} {one.text}" for one in found)
    fits = ", ".join(
        f"{name} {given.simulated['estimation'].fit_percent[name] or 0.0:.0f} -> {percent or 0.0:.0f} %"
        for name, percent in better.simulated["estimation"].fit_percent.items()
    )
    message = (
        f"The recording contradicts the model: {texts}. Mended, it is simulated by the model as it is (fit "
        f"{fits}). What else is missing can be told of the mended recording."
    )
    return Diagnosis(
        verdict="cannot tell",
        message=message,
        baseline=given,
        proofs=(),
        screen=Screen((), np.zeros((0, 0)), 1.0, 0, ()),
        places=(),
        disturbance=None,
        validation=given.simulated.get("validation"),
        next_experiment=" ".join(_how(one) for one in found),
        seconds=seconds,
        has_loads=False,
    )


def _how(one: Contradiction) -> str:
    if one.is_turned:
        return f"Turn the sign of {one.signal}, by a minus before its column in daest.toml, or in the model."
    return f"Give the unit of {one.signal}, in the header of its column or under [data] units in daest.toml."
