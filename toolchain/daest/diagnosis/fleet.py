"""Many machines, one model: identify each, hold the fit against unseen data, diagnose where it fails."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice

import numpy as np

from daest.data.prepare import Preparation, hold_after, split_all
from daest.diagnosis.comparison.compare import compare_models
from daest.diagnosis.comparison.trial import fitted_candidate
from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.gates import GATES
from daest.diagnosis.options import DiagnoseOptions
from daest.errors import DaestError
from daest.estimation.identify import identify
from daest.model.diagnosis import Diagnosis, Proof
from daest.model.effects import Effect
from daest.model.experiment import Experiment
from daest.model.fit import FitResult, IdentifyOptions
from daest.model.flat import Model
from daest.model.fleet import Fleet, Group, Machine, Odd, Spread
from daest.numerics.parallel import Outcome, workers

HALF = 0.5  # of every recording estimates, where nothing else is said
BATCH = 256  # recordings that are in memory at a time
FEWEST = 8  # machines that have a middle
FAILED = "failed"
HOLDS = "not falsified"


@dataclass(frozen=True)
class FleetOptions:
    """How machines are examined: `hold` is that of the recordings before they are resampled, None takes the
    better one; the first share `split` of every recording estimates, the rest judges; not `diagnoses`:
    falsified models are told as such. Machines are examined in `jobs` processes, or on the Dask `cluster` at
    an address."""

    hold: str | None = None
    split: float = HALF
    diagnoses: bool = True
    effects: tuple[str, ...] = ()
    seed: int = 0
    jobs: int = 1
    cluster: str | None = None
    library: tuple[Effect, ...] = field(default=(), repr=False)


@dataclass(frozen=True)
class Recorded:
    """The recording of a machine with the model of its measured outputs, or the error of reading it."""

    name: str
    flat: Model | None = None
    experiment: Experiment | None = None
    error: DaestError | None = None


def examine_fleet(
    recorded: Iterable[Recorded],
    options: FleetOptions,
    arrived: Callable[[Machine], object] = lambda machine: None,
) -> Iterator[Machine]:
    """The machines in their order; `arrived` hears of each as soon as it is done. `recorded` is read BATCH at
    a time, so that a fleet may be larger than the memory. No machine stops the others. Raises ConfigError of
    `workers`."""
    rest = iter(recorded)
    with workers(options.jobs, options.cluster) as pool:
        while batch := list(islice(rest, BATCH)):
            tasks = [(one, options) for one in batch]

            def tell(number: int, outcome: Outcome[Machine], batch: Sequence[Recorded] = batch) -> None:
                arrived(_machine(batch[number], outcome))

            for one, outcome in zip(batch, pool.map(examine, tasks, arrived=tell), strict=True):
                yield _machine(one, outcome)


def examine(task: tuple[Recorded, FleetOptions]) -> Machine:
    """One machine: its fit, the verdict on unseen data, and what is missing where that falsifies it. Raises
    what the fit and the diagnosis raise."""
    one, options = task
    began = time.perf_counter()
    if one.error is not None:
        raise one.error
    assert one.flat is not None and one.experiment is not None
    estimation, validation = split_all([one.experiment], Preparation(split=options.split))
    hold = hold_after([one.experiment], options.hold)
    wanted = IdentifyOptions(hold=hold, seed=options.seed, jobs=1)
    fit = identify(one.flat, estimation, wanted, validation)
    machine = _fitted_machine(one.name, fit, _verdict(one.flat, fit, validation))
    if machine.verdict == "falsified" and options.diagnoses:
        machine = _diagnosed(machine, one.flat, estimation, validation, fit, options)
    return Machine(**{**vars(machine), "seconds": time.perf_counter() - began})


def _verdict(flat: Model, fit: FitResult, validation: Sequence[Experiment]) -> str | None:
    """That of the tests of the fit on unseen data; None for a model with events, which has no one-step
    errors."""
    if flat.events is not None:
        return None
    return compare_models([fitted_candidate(flat, fit)], validation).models[0].verdict


def summary(machines: Sequence[Machine]) -> Fleet:
    """Groups of machines with the same missing effect, and the spread of the parameters over the others."""
    return Fleet(tuple(machines), _groups(machines), _spread(machines), _odd(machines))


def _machine(one: Recorded, outcome: Outcome[Machine]) -> Machine:
    if outcome.error is None:
        return outcome.get()
    error = outcome.error
    what = (
        f"{error.code}: {error.what}" if isinstance(error, DaestError) else f"{type(error).__name__}: {error}"
    )
    return Machine(one.name, FAILED, what.splitlines()[0])


def _fitted_machine(name: str, fit: FitResult, verdict: str | None) -> Machine:
    agreement = fit.simulated.get("validation") or fit.simulated["estimation"]
    return Machine(
        name,
        fit.status,
        fit.message,
        {p.name: (_number(p.value), _number(p.std_error)) for p in fit.parameters},
        {output: _number(value) for output, value in agreement.fit_percent.items()},
        verdict,
    )


def _number(value: float | None) -> float:
    return float("nan") if value is None else float(value)


def _diagnosed(
    machine: Machine,
    flat: Model,
    estimation: Sequence[Experiment],
    validation: Sequence[Experiment],
    fit: FitResult,
    options: FleetOptions,
) -> Machine:
    wanted = DiagnoseOptions(hold=fit.hold, seed=options.seed, jobs=1, effects=options.effects)
    try:
        found = diagnose(flat, options.library, estimation, validation, wanted)
    except DaestError as problem:
        return Machine(**{**vars(machine), "message": f"{problem.code}: {problem.what}".splitlines()[0]})
    return _with_effect(machine, found)


def _with_effect(machine: Machine, found: Diagnosis) -> Machine:
    best = next((p for p in found.proofs if p.verdict == "supported"), None)
    told = {**vars(machine), "verdict": found.verdict, "message": found.message}
    if best is None:
        return Machine(**told)
    size = _size(best)
    return Machine(
        **{
            **told,
            "effect": best.candidate.effect.name,
            "at": best.candidate.site.name,
            "size": size,
            "size_unit": best.candidate.size_unit,
            "places": tuple(best.equivalent),
        }
    )


def _size(proof: Proof) -> float | None:
    name = f"{proof.candidate.name}.{proof.candidate.effect.sizes[0].name}"
    return next((float(p.value) for p in proof.told.parameters if p.name == name), None)


def _groups(machines: Sequence[Machine]) -> tuple[Group, ...]:
    """Places that sensors cannot tell apart are one, called by the one that most machines name."""
    groups: list[tuple[str, set[str], list[Machine]]] = []
    for machine in machines:
        if machine.effect is None or machine.at is None:
            continue
        places = {machine.at, *machine.places}
        for effect, known, members in groups:
            if effect == machine.effect and known & places:
                known |= places
                members.append(machine)
                break
        else:
            groups.append((machine.effect, places, [machine]))
    found = []
    for effect, _, members in groups:
        named = [str(m.at) for m in members]
        found.append(Group(effect, max(sorted(set(named)), key=named.count), tuple(m.name for m in members)))
    return tuple(sorted(found, key=lambda group: -len(group.machines)))


def _whole(machines: Sequence[Machine]) -> list[Machine]:
    """Machines whose parameters mean something: fitted, and nothing is missing."""
    return [m for m in machines if m.status != FAILED and m.verdict in (HOLDS, None, "nothing missing")]


def _spread(machines: Sequence[Machine]) -> dict[str, Spread]:
    found = {}
    for name, values, errors, _ in _columns(machines):
        std = float(np.std(values, ddof=1)) if values.size > 1 else float("nan")
        known = errors[np.isfinite(errors)]
        own = float(np.sqrt(np.mean(known**2))) if known.size else float("nan")
        found[name] = Spread(float(np.mean(values)), std, own, int(values.size))
    return found


def _odd(machines: Sequence[Machine]) -> tuple[Odd, ...]:
    found = []
    for name, values, errors, names in _columns(machines):
        if values.size < FEWEST:
            continue
        middle = float(np.median(values))
        width = GATES.normal_deviation * float(np.median(np.abs(values - middle)))
        total = np.sqrt(width**2 + np.where(np.isfinite(errors), errors, 0.0) ** 2)
        distance = np.abs(values - middle) / np.where(total > 0, total, np.inf)
        found += [
            Odd(names[i], name, float(values[i]), float(distance[i]))
            for i in np.flatnonzero(distance > GATES.odd_machine)
        ]
    return tuple(sorted(found, key=lambda odd: -odd.distance))


def _columns(machines: Sequence[Machine]) -> Iterator[tuple[str, np.ndarray, np.ndarray, list[str]]]:
    """Each parameter with its values, standard errors and machines."""
    whole = _whole(machines)
    for name in dict.fromkeys(name for machine in whole for name in machine.parameters):
        having = [m for m in whole if name in m.parameters and np.isfinite(m.parameters[name][0])]
        values = np.array([m.parameters[name][0] for m in having])
        errors = np.array([m.parameters[name][1] for m in having])
        if values.size:
            yield name, values, errors, [m.name for m in having]
