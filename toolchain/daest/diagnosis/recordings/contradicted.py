"""Recordings that contradict the model whatever it lacks: a sensor that is mounted the other way round, or
counts in another unit, two columns that stand in each other's place, and a set point in the place of what
drives the machine.

No effect of a library turns a signal round, and one that seems to is not what is missing. Where the model as
it is simulates the mended recording, and not the one that was given, all that is to be said is what to mend.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from daest.data.check import mostly_copied
from daest.data.contradictions import (
    LONGEST,
    Contradiction,
    Exchange,
    OtherClock,
    all_mended,
    contradictions,
    exchanges,
    inputs_without_sign,
    other_clock,
    perhaps_turned,
)
from daest.data.set_points import SetPoint, set_points
from daest.diagnosis.built_in.settled import FAILURES
from daest.diagnosis.evidence.stand import quiet, scaled, without_noises
from daest.diagnosis.gates import GATES
from daest.diagnosis.recordings.faulty import EMPTY
from daest.estimation.identify import identify
from daest.model.diagnosis import Diagnosis, Screen
from daest.model.experiment import Experiment
from daest.model.fit import FitResult, IdentifyOptions, ratios_by_output
from daest.model.flat import FlatModel, Model
from daest.model.holds import Hold
from daest.modelica.flat.clock import clock_unit

MOST_PAIRS = 10  # of columns that are exchanged


def contradicted(
    flat: Model, experiments: Sequence[Experiment], validation: Sequence[Experiment], hold: Hold | None
) -> Diagnosis | None:
    """What is to be mended in the recordings before anything can be said of missing effects; None where they
    do not contradict the model, or a simulation does not show that this is why it does not match."""
    began = time.perf_counter()
    found = contradictions(flat, experiments[0]) if experiments else []
    # Of an FMU, or a model with events, the fits that tell of pairs take longer than what they may save.
    is_quick = isinstance(flat, FlatModel) and flat.events is None
    likely = found or (perhaps_turned(flat, experiments[0]) if is_quick and experiments else [])
    pairs = exchanges(flat, experiments)[:MOST_PAIRS] if is_quick and experiments and not found else []
    clock = _other_clock(flat, experiments) if is_quick and not found else None
    followed = set_points(flat, experiments[0].first(LONGEST)) if experiments and not found else []
    copied = [finding for e in experiments for finding in mostly_copied(e)]
    signless = inputs_without_sign(flat, experiments[0]) if experiments and not found else {}
    if not (likely or pairs or followed or copied or signless) and clock is None:
        return None
    silent = without_noises(flat) if isinstance(flat, FlatModel) else flat
    options = IdentifyOptions(method="oe", hold=hold, second_look=False)
    with quiet(), suppress(*FAILURES):
        # What is told of these hangs on no scale of the parameters.
        if isinstance(silent, FlatModel) and is_quick and (followed or copied):
            silent, _ = scaled(silent, experiments)
        given = identify(silent, experiments, options, validation=validation)
        if copied:
            what = "; ".join(dict.fromkeys(finding.sentence for finding in copied))
            message = f"The recording tells nothing of the machine: {what}."
            return _nothing_claimed(given, message, EMPTY, time.perf_counter() - began)
        if signless:
            what = "; ".join(f"{name} {text}" for name, text in signless.items())
            message = f"The recording contradicts the model: {what}."
            how = f"Record {' and '.join(signless)} with its sign, and diagnose again."
            return _nothing_claimed(given, message, how, time.perf_counter() - began)
        told = _mended(silent, given, experiments, likely, options) if likely else None
        if not (found or told):
            told = _counted_in(silent, given, experiments, clock) if clock else None
            told = told or _exchanged(silent, given, experiments, pairs)
        seconds = time.perf_counter() - began
        if not told and followed:
            return _of_set_points(given, followed, seconds)
        return told and _told(given, *told, seconds)
    return None


def _mended(
    silent: Model,
    given: FitResult,
    experiments: Sequence[Experiment],
    found: Sequence[Contradiction],
    options: IdentifyOptions,
) -> tuple[FitResult, str, str] | None:
    """The fit without what was found, what is told of it, and how to mend it, where the model follows what is
    mended, and not what was given; else None."""
    try:
        better = identify(silent, [all_mended(e, found) for e in experiments], options)
    except FAILURES:
        return None
    gain = better.log_likelihood + _of_scales(experiments, found) - given.log_likelihood
    return (better, *_what(found)) if gain > len(found) and _is_why(given, better, found) else None


def _other_clock(flat: Model, experiments: Sequence[Experiment]) -> OtherClock | None:
    """The longer unit of time in which a model that tells none is nearer to the first of the recordings."""
    if not (isinstance(flat, FlatModel) and experiments and clock_unit(flat) == "s"):
        return None
    return other_clock(flat, experiments[0])


def _counted_in(
    silent: Model, given: FitResult, experiments: Sequence[Experiment], clock: OtherClock
) -> tuple[FitResult, str, str] | None:
    """The fit with time in another unit, what is told of it, and how to mend it, where the recordings are
    simulated far better so whatever the values of the parameters; else None."""
    options = IdentifyOptions(method="oe", hold=given.hold, second_look=False)
    try:
        better = identify(silent, [clock.mended(e) for e in experiments], options)
    except FAILURES:
        return None
    ratios = ratios_by_output(given.simulated, better.simulated, "estimation").values()
    gain = better.log_likelihood - given.log_likelihood
    if gain <= GATES.min_late_gain or max(ratios, default=1.0) >= GATES.max_told_ratio:
        return None
    how = (
        f"Give the parameters of the model units that tell its time, as kW.{clock.unit}/K for a capacity "
        f"beside kW, or write its equations for seconds."
    )
    return better, f"the model counts time in {clock.unit}, and the recording was read in s", how


def _exchanged(
    silent: Model, given: FitResult, experiments: Sequence[Experiment], pairs: Sequence[Exchange]
) -> tuple[FitResult, str, str] | None:
    """The fit with the columns of one of the `pairs` exchanged, what is told of it, and how to mend it, where
    a simulation of the recordings as they are misses an output and all that this concerns are simulated far
    better with these two the other way round; else None."""
    if all(_followed(given, list(given.simulated["estimation"].fit_percent))):
        return None
    least = given.log_likelihood + GATES.min_late_gain
    options = IdentifyOptions(method="oe", hold=given.hold, second_look=False, least=least)
    for pair in pairs:
        with suppress(*FAILURES):
            better = identify(silent, [pair.mended(e) for e in experiments], options)
            is_told = pair.is_of_one_unit or _follows(better, pair)
            if better.log_likelihood > least and is_told and _are_better(given, better, pair):
                one, other = pair.signals
                how = f"Exchange the columns of {one} and {other} in daest.toml, or the signals in the model."
                return better, f"{one} and {other} stand in each other's place", how
    return None


def _follows(better: FitResult, pair: Exchange) -> bool:
    """Whether the model follows the outputs of a pair, of inputs all outputs, the other way round: numbers in
    two units are of two sizes, and an error that is smaller for that tells nothing."""
    outputs = better.simulated["estimation"].fit_percent
    return all(_followed(better, [name for name in outputs if name in pair.signals] or list(outputs)))


def _followed(fit: FitResult, names: Sequence[str]) -> list[bool]:
    """Whether a simulation follows each of the outputs `names`."""
    percents = fit.simulated["estimation"].fit_percent
    return [(percents[name] or 0.0) > GATES.min_driven_fit for name in names]


def _are_better(given: FitResult, better: FitResult, pair: Exchange) -> bool:
    """Whether the outputs of a pair are simulated far better the other way round, and the others not worse;
    of inputs all outputs far better. A third sensor may be followed as it is. Of two outputs in two units the
    product of both errors counts: the numbers of either are beside another one's before and after."""
    ratios = ratios_by_output(given.simulated, better.simulated, "estimation")
    own = [ratio for name, ratio in ratios.items() if name in pair.signals]
    others = [ratio for name, ratio in ratios.items() if name not in pair.signals]
    if len(own) == 2 and not pair.is_of_one_unit:
        own = [float(np.sqrt(np.prod(own)))]
    far = max(own or others, default=1.0) < GATES.max_told_ratio
    return far and all(ratio < 1.0 + GATES.clear_unseen_error for ratio in (*own, *others))


def _what(found: Sequence[Contradiction]) -> tuple[str, str]:
    """What is told of contradictions, and how to mend them."""
    return "; ".join(f"{one.signal} {one.text}" for one in found), " ".join(_how(one) for one in found)


def _of_scales(experiments: Sequence[Experiment], found: Sequence[Contradiction]) -> float:
    """What the density of the samples gains by the scale alone of outputs that are mended: in degrees a
    reading is 57 times as far spread as in radians, and each of its samples that much less dense."""
    known = [
        (e.outputs[:, e.output_names.index(c.signal)], c)
        for c in found
        for e in experiments
        if c.signal in e.output_names
    ]
    return sum(float(np.isfinite(values).sum()) * np.log(abs(c.factor)) for values, c in known)


def _is_why(given: FitResult, better: FitResult, found: Sequence[Contradiction]) -> bool:
    """Whether the model follows what was mended, and not as it was given; one of several inputs may leave
    some of the outputs as they are."""
    outputs = better.simulated["estimation"].fit_percent
    turned = [one.signal for one in found if one.signal in outputs]
    names = turned or list(outputs)
    as_given = _followed(given, names)
    return all(_followed(better, names)) and not (any(as_given) if turned else all(as_given))


def _told(given: FitResult, better: FitResult, what: str, how: str, seconds: float) -> Diagnosis:
    fits = ", ".join(
        f"{name} {given.simulated['estimation'].fit_percent[name] or 0.0:.0f} -> {percent or 0.0:.0f} %"
        for name, percent in better.simulated["estimation"].fit_percent.items()
    )
    message = (
        f"The recording contradicts the model: {what}. Mended, it is simulated by the model as it is (fit "
        f"{fits}). What else is missing can be told of the mended recording."
    )
    return _nothing_claimed(given, message, how, seconds)


def _of_set_points(given: FitResult, found: Sequence[SetPoint], seconds: float) -> Diagnosis:
    """What is told of inputs that are set points: no law that was found with one would be the machine's."""
    what = "; ".join(f"{one.input} {one.text}" for one in found)
    message = (
        f"The recording contradicts the model: {what}. What would be found missing with it may be the "
        "controller's."
    )
    names = list(dict.fromkeys(one.input for one in found))
    one = found[0]
    how = (
        f"Record what the controller gives the machine in place of {' and '.join(names)}, or write the "
        f"controller into the model, with {one.input} in the unit of {one.output}. If the machine itself has "
        "this gain, give the parameters values that have it, too."
    )
    return _nothing_claimed(given, message, how, seconds)


def _nothing_claimed(given: FitResult, message: str, how: str, seconds: float) -> Diagnosis:
    return Diagnosis(
        verdict="cannot tell",
        message=message,
        baseline=given,
        proofs=(),
        screen=Screen((), np.zeros((0, 0)), 1.0, 0, ()),
        places=(),
        disturbance=None,
        validation=given.simulated.get("validation"),
        next_experiment=how,
        seconds=seconds,
        has_loads=False,
    )


def _how(one: Contradiction) -> str:
    if one.is_turned:
        return f"Turn the sign of {one.signal}, by a minus before its column in daest.toml, or in the model."
    return f"Give the unit of {one.signal}, in the header of its column or under [data] units in daest.toml."
