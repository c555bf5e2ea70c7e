"""Evidence by simulation where errors add up: the records in pieces, each from an initial state of its own.

An angle that nothing holds drifts away from every simulation of a whole record, and tells little there of
what the model lacks; one sample ahead, beside unknown loads, a slow law is hardly seen. Over pieces in which
the machine shows all that it does, and which are short beside the record, a simulation has no time to drift.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from daest.diagnosis.built_in.settled import better_of, fit_by_simulation
from daest.diagnosis.evidence.free_starts import free_runs
from daest.diagnosis.evidence.open_loop import errors_in_pieces
from daest.diagnosis.evidence.stand import Stand, quiet
from daest.diagnosis.evidence.unseen import seen_modes, slowest_decay
from daest.diagnosis.null_model.null import Null, at_fit, grown
from daest.diagnosis.null_model.null_observer import NullObserver
from daest.diagnosis.screening.candidates import fed
from daest.estimation.fitting.records import part_of
from daest.estimation.fitting.result import agreement_of
from daest.model.diagnosis import Proof
from daest.model.experiment import Experiment
from daest.model.fit import Agreement, FittedInitialState
from daest.model.flat import with_equations
from daest.systems.reduction.reduce import reduce_index

FEWEST_PIECES, MOST_PIECES = 4, 10  # of the longest record
FEWEST_SAMPLES = 20  # of a piece


def in_pieces(stand: Stand, run: NullObserver) -> Stand | None:
    """The stand with its records in pieces, and the model as it is fitted to the simulation of these; None
    where they cannot be cut or simulated. `run` is the null's observer."""
    null, reference = stand.null, stand.reference
    n_samples = _length(run)
    if reference is None or not stand.validation or n_samples is None:
        return None
    experiments, unseen = _cut(null.experiments, n_samples), _cut(stand.validation, n_samples)
    alone = replace(null, experiments=experiments)
    with quiet():
        found = fit_by_simulation(alone, reference.fit, null.flat, experiments, unseen)
        fit = better_of(reference.fit, found)
        if fit.method != "oe":
            return None
        errors = errors_in_pieces(at_fit(alone, fit), unseen)
    if errors is None:
        return None
    known = replace(reference, fit=fit, foreseen=None, adds_up=False, simulated=errors, holding=())
    return replace(stand, null=alone, validation=unseen, reference=known)


def _length(run: NullObserver) -> int | None:
    """Samples of a piece: a part of the longest record, and no less than the slowest mode takes to turn round
    or to settle that the outputs see, beside those that keep errors; None where the records are too short for
    some of them."""
    experiments = run.null.experiments
    longest = max(experiments, key=lambda e: e.n_samples)
    least, most = (longest.n_samples // n for n in (MOST_PIECES, FEWEST_PIECES))
    modes = seen_modes(run, range(len(run.average.C)))
    lasting = modes[modes.real <= slowest_decay(experiments)]
    slowest = float(np.min(np.abs(lasting), initial=np.inf))
    period = float(longest.time[-1] - longest.time[0]) / max(longest.n_samples - 1, 1)
    wanted = int(np.ceil(2.0 * np.pi / (slowest * period))) if slowest > 0.0 else most
    return None if least < FEWEST_SAMPLES else min(max(wanted, least), most)


def _cut(experiments: Sequence[Experiment], n_samples: int) -> tuple[Experiment, ...]:
    """The records in pieces of at least so many samples."""
    pieces: list[Experiment] = []
    for record in experiments:
        edges = np.linspace(0, record.n_samples, max(1, record.n_samples // n_samples) + 1).astype(int)
        pieces += [part_of(record, a, b) for a, b in pairwise(edges)]
    return tuple(pieces)


def told_of_whole(stand: Stand, proof: Proof) -> Proof:
    """The proof of a law by its simulation in pieces, with that of the whole records for what is told of
    it."""
    if proof.final is None:
        return proof
    flat = with_equations(proof.flat, "a simulation").with_theta(proof.final.theta)
    explicit = reduce_index(flat)
    records = fed(stand.null.experiments, proof.candidate), fed(stand.validation, proof.candidate)
    model = grown(stand.null, flat, explicit, proof.final, records[0])
    parts = dict(zip(("estimation", "validation"), (_told(model, part) for part in records), strict=True))
    told = {name: part[0] for name, part in parts.items() if part is not None}
    starts = () if parts["estimation"] is None else parts["estimation"][1]
    final = replace(proof.final, simulated=told, one_step={}, initial_states=starts)
    return replace(proof, final=final)


def _told(
    model: Null, experiments: Sequence[Experiment]
) -> tuple[Agreement, tuple[FittedInitialState, ...]] | None:
    """The agreement of the simulation of whole records, and where it starts; None where it cannot be made."""
    runs = free_runs(model, experiments)
    if runs is None:
        return None
    errors = [e.outputs - run.outputs for e, run in zip(experiments, runs, strict=True)]
    found = agreement_of(model.flat.output_names, [e.outputs for e in experiments], errors)
    names = model.explicit.state_names
    unknown = np.full(len(names), np.nan)
    return found, tuple(
        FittedInitialState(e.name, names, run.states[0], unknown)
        for e, run in zip(experiments, runs, strict=True)
    )
