"""What to record next where candidates could not be told apart: computed from their models, in a
sentence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from daest.design.design import Task, at_period, design
from daest.design.effects import Rival, leaving, rival_aim
from daest.diagnosis.gates import GATES
from daest.errors import DaestError
from daest.estimation.fitting.records import longest_duration
from daest.model.design import Design, Limits, Range
from daest.model.diagnosis import Proof
from daest.model.experiment import Experiment
from daest.model.flat import Model
from daest.model.holds import Hold, causal_hold
from daest.quantities import is_of

SECONDS = 4.0  # that the search for the experiment may take
LONGEST = 4000  # samples of a designed experiment, so that the search comes to something
MARGIN = 0.5 * GATES.same_bic  # log-likelihood by which candidates are told apart
BEYOND = 1.0  # times the recorded range of an output, by which an input may drive it beyond either end
MOST = 4  # candidates that are looked at, best first
ONE_SIDED = ("K", "Pa", "mol/m3", "kg/m3")  # units of quantities that have no other direction
COMMAND = "daest design --rivals -o input.csv writes the input, and looks longer for a better one."


@dataclass(frozen=True)
class Asked:
    """The candidates that are left, the recordings, and how their inputs run between the samples."""

    proofs: Sequence[Proof]
    experiments: Sequence[Experiment]
    hold: Hold
    seed: int = 0


def computed(asked: Asked, otherwise: str) -> str:
    """The input that tells the candidates apart best, and what it is expected to bring: within the recorded
    ranges of the inputs, else in both directions; `otherwise` where fewer than two candidates can be driven,
    or nothing comes of it."""
    left = [p for p in asked.proofs if p.verdict != "rejected" and not p.candidate.inputs][:MOST]
    if len(left) < 2 or not left[0].flat.inputs:
        return otherwise
    limits = _limits(asked, left[0].flat)
    found = _designed(left, asked, limits)
    if found is not None and found.expected.value > MARGIN:
        return _said(found)
    declared = {one.name: (one.min, one.max) for one in left[0].flat.inputs}
    inputs = tuple(_both_ways(one, *declared[one.name]) for one in limits.inputs)
    safe = tuple(_both_ways(one) for one in limits.safe)
    both = replace(limits, inputs=inputs, safe=safe)
    wider = None if inputs == limits.inputs else _designed(left, asked, both)
    if wider is not None and wider.expected.value > MARGIN:
        names = ", ".join(one.name for one in both.inputs)
        said = _said(wider)
        return f"Within the recorded range of {names} no input tells them apart; in both directions: {said}"
    if found is None and wider is None:
        return otherwise
    return (
        "No input of the recorded amplitude, rate and length was found that tells them apart "
        f"({MARGIN:g} in log-likelihood are needed). {otherwise}"
    )


def _both_ways(one: Range, least: float | None = None, most: float | None = None) -> Range:
    """The range in both directions of zero, for a quantity that has them, within the `least` and `most` that
    the model declares. A share or a ratio of which no negative value was recorded may have none: an opening,
    a gear."""
    is_share = one.unit == "1" and one.low >= 0.0
    if is_share or any(is_of(one.unit, unit) for unit in ONE_SIDED):
        return one
    largest = max(abs(one.low), abs(one.high))
    low = -largest if least is None else max(least, -largest)
    high = largest if most is None else min(most, largest)
    return replace(one, low=min(low, one.low), high=max(high, one.high))


def _designed(left: Sequence[Proof], asked: Asked, limits: Limits) -> Design | None:
    """None where nothing within the limits makes a difference."""
    names = [one.name for one in limits.inputs]
    recorded = [at_period(e, names, limits.period) for e in asked.experiments]
    try:
        aim, subjects = rival_aim([_rival(p) for p in left], limits, recorded, MARGIN, asked.seed, draws=0)
        task = Task(aim, subjects, limits, tuple(recorded), seed=asked.seed, seconds=SECONDS, is_short=True)
        return design(task)
    except DaestError:
        return None


def _rival(proof: Proof) -> Rival:
    told = proof.told
    flat = leaving(proof.flat.with_theta(told.theta), told.simulated["estimation"].rms)
    return Rival(proof.candidate.label, flat, tuple(p.name for p in told.parameters))


def _limits(asked: Asked, flat: Model) -> Limits:
    """What was recorded: the ranges and rates of the inputs, the length of the longest recording, and the
    ranges of the outputs with room beside them."""
    experiments = asked.experiments
    period = min(e.median_step for e in experiments)
    longest = longest_duration(experiments)
    inputs = []
    for variable in flat.inputs:
        values = [e.input(variable.name) for e in experiments]
        rates = [
            np.max(np.abs(np.diff(u) / np.diff(e.time))) for u, e in zip(values, experiments, strict=True)
        ]
        low, high = float(min(map(np.min, values))), float(max(map(np.max, values)))
        inputs.append(Range(variable.name, variable.unit, low, high, float(max(rates)) or np.inf))
    around = (_around(i, flat, experiments) for i in range(len(flat.outputs)))
    safe = tuple(one for one in around if one.low < one.high)
    return Limits(tuple(inputs), min(longest, LONGEST * period), period, safe, hold=causal_hold(asked.hold))


def _around(index: int, flat: Model, experiments: Sequence[Experiment]) -> Range:
    """The range of an output in which models of the machine are believed: what was recorded, as wide again at
    either end. A model that runs away tells candidates apart that a machine never would."""
    values = np.concatenate([e.outputs[:, index] for e in experiments])
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    beyond = BEYOND * (high - low)
    return Range(flat.outputs[index].name, flat.outputs[index].unit, low - beyond, high + beyond)


def _said(found: Design) -> str:
    alike = "".join(f" {note[:1].upper()}{note[1:]}." for note in found.notes)
    return f"{found.message}{alike} {COMMAND}"
