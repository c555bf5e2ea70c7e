"""Design: the input that serves an aim best within limits, what it is expected to bring, and what would bring
more."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from daest.design.aims import Aim, ParameterAim
from daest.design.detect import DetectAim
from daest.design.explainer import Explainer, likely
from daest.design.linear_explainer import LinearExplainer
from daest.design.prepared import Subject
from daest.design.rivals import RivalAim
from daest.design.safety import DRAWS, TOLERATED, Guard
from daest.design.search import FREE, SHARE_OF_FAMILIES, Budget, best_of_families, free_input
from daest.design.sensors import sensor_gains
from daest.design.signals import FAMILIES, KEEPS_LOWEST, first_half, slewed, within
from daest.errors import DaestError, EstimationError
from daest.model.design import FEWEST_STEPS, Design, Expected, Limits, Played, PowerPoint, SensorGain
from daest.model.experiment import Experiment
from daest.model.fit import WeakDirection
from daest.systems.linear.state_space import state_space, state_space_family

SECONDS = 20.0  # that a search may take
GROWN = 10.0  # logarithm of how much an unstable mode may grow over an experiment without safe ranges
LENGTHS = (0.5, 1.0, 2.0, 4.0)  # of the designed experiment, at which the power is told
AMPLITUDES = (0.25, 0.5)  # likewise
PROBES = ("steps", "multisine")  # families whose inputs show whether two rivals are one equation
REPEATED = (
    "the second half repeats the first, since daest diagnose keeps half of a recording for validation: what "
    "is expected is told of one half"
)
AGAIN = 0.5  # of the time of a first search, for a second one without hopeless pairs
LITTLE = 1.05  # times better: a sensor that brings less is not told
# Families that excite all frequencies at once. Two levels alone tell no law of the size of a load from one
# that does not know it: both are as large at every sample.
BROAD = ("multisine", "random binary")
CERTAIN = (
    0.999  # power from which an aim is reached: benchmarks/design_loop.py, where free inputs left more open
)
MOST_TOLD = 8  # sensors

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Task:
    """What is to be designed: the aim, the models that it drives, the limits, the inputs of the recordings
    that there are (each (n, n_u) at the period of the limits), and the noise of possible sensors by name.
    `commanded`: variables that a controller sets."""

    aim: Aim
    subjects: tuple[Subject, ...]
    limits: Limits
    recorded: tuple[np.ndarray, ...] = ()
    sensor_noise: Mapping[str, float] = field(default_factory=dict)
    seed: int = 0
    seconds: float = SECONDS
    commanded: tuple[str, ...] = ()
    is_short: bool = False  # families alone, and nothing of sensors and of both recordings together


def design(task: Task, progress: Progress = lambda _: None) -> Design:
    """The best input. Raises EstimationError `design-unstable`, `design-unsafe`, `design-same-equation` or
    `design-nothing`."""
    began = time.perf_counter()
    task, notes = _distinct(task)
    whole, task = task.limits, _halved(task)
    aim, limits = task.aim, task.limits
    draws = DRAWS if limits.safe else 0
    guard = Guard(aim.driven, limits.safe, tuple(likely(aim.driven[0], task.recorded, task.seed, draws)))
    _require_stable(task)
    guard = guard.with_room(limits)
    progress("trying the families of inputs")
    task, families = _first_families(task, guard, began, notes)
    aim = task.aim
    families, best = _searched(task, guard, families, began, progress)
    every = _played(guard, _inputs(best), limits, whole)
    inputs = every[: limits.time.size]
    notes += _notes(best, inputs, limits, is_repeated=whole != limits)
    progress("looking at what the best input would bring")
    expected = _required(aim.expected([inputs]))
    present = aim.expected(task.recorded) if task.recorded else None
    together = aim.expected([*task.recorded, inputs]) if task.recorded and not task.is_short else None
    sensors = () if task.is_short else _sensors(task, inputs, notes)
    left_open = _open(task, inputs)
    notes += _what_no_input_tells(task, left_open, sensors)
    found = Design(
        aim=aim.name,
        message="",
        value_of=aim.value_of,
        higher_is_better=aim.higher_is_better,
        limits=whole,
        inputs=every,
        families=tuple(families),
        expected=expected,
        present=present,
        together=together,
        open_directions=left_open,
        sensors=sensors,
        safety=guard.told(every),
        power=_powers(task, inputs, whole.length) if isinstance(aim, DetectAim) else (),
        notes=tuple(notes),
        seconds=time.perf_counter() - began,
    )
    return replace(found, message=told(found, aim))


def at_period(experiment: Experiment, names: Sequence[str], period: float) -> np.ndarray:
    """The recorded inputs (n, n_u), in that order, on straight lines at a period."""
    time_ = experiment.time - experiment.time[0]
    grid = period * np.arange(int(np.floor(time_[-1] / period + 1e-9)) + 1)
    return np.column_stack([np.interp(grid, time_, experiment.input(name)) for name in names])


def _first_families(task: Task, guard: Guard, began: float, notes: list[str]) -> tuple[Task, list[Played]]:
    """The best input of every family; of rivals, after those pairs are left out that no family tells
    apart."""
    share = (1.0 if task.is_short else SHARE_OF_FAMILIES) * task.seconds
    families = best_of_families(task.aim, task.limits, guard, task.seed, Budget(began + share))
    tried = [one.inputs for one in families if one.inputs is not None]
    if not isinstance(task.aim, RivalAim) or not tried:
        return task, families
    aim, hopeless = task.aim.hopeful(tried)
    if not hopeless:
        return task, families
    apart = "; ".join(label.replace(" | ", " from ") for label in hopeless)
    notes.append(f"no input of these families tells {apart}: designed for the other pairs")
    until = Budget(time.perf_counter() + AGAIN * share)
    return replace(task, aim=aim), best_of_families(aim, task.limits, guard, task.seed, until)


def _searched(
    task: Task, guard: Guard, families: list[Played], began: float, progress: Progress
) -> tuple[list[Played], Played]:
    aim, limits = task.aim, task.limits
    if families[0].inputs is None:
        reasons = "; ".join(dict.fromkeys(f"{p.family}: {p.reason}" for p in families))
        raise EstimationError(
            "design-nothing",
            f"no input within these limits can be played ({reasons})",
            remedy="widen the limits: --limit, --rate, --band or --length",
        )
    rich = _rich_enough(aim, families)
    if rich is not None:
        return [rich, *(one for one in families if one is not rich)], rich
    if task.is_short:
        return families, families[0]
    progress("improving the best of them by its gradient")
    free = free_input(aim, limits, guard, families[0], Budget(began + task.seconds))
    families = [*families, free]
    sign = -1.0 if aim.higher_is_better else 1.0
    families.sort(key=lambda p: (p.inputs is None, sign * p.value if p.inputs is not None else 0.0))
    return families, families[0]


def _rich_enough(aim: Aim, families: Sequence[Played]) -> Played | None:
    """A broad input that reaches the aim for certain, if there is one: what is gained beyond certainty is
    worth less than that a broad input also excludes laws that are not among the rivals."""
    if isinstance(aim, ParameterAim):
        return None
    for name in BROAD:
        for one in families:
            if one.family == name and one.inputs is not None and _power(aim, one.inputs) >= CERTAIN:
                return one
    return None


def _power(aim: Aim, inputs: np.ndarray) -> float:
    """Probability that the aim is reached by a recording whose halves have these inputs each."""
    if isinstance(aim, DetectAim):
        return aim.power([inputs], aim.size)
    expected = aim.expected([inputs])
    return 0.0 if expected is None else expected.power or 0.0


def _inputs(best: Played) -> np.ndarray:
    assert best.inputs is not None
    return best.inputs


def _required(found: Expected | None) -> Expected:
    if found is None:
        raise EstimationError(
            "design-nothing",
            "the designed input cannot be simulated with all likely parameters",
            remedy="give smaller ranges with --limit, or safe ranges for the variables that run away",
        )
    return found


def _halved(task: Task) -> Task:
    """The task of half the length, and with the first halves of the recordings, where `daest diagnose` is to
    judge: it keeps half of every recording for validation, and what it is to find must show in either
    half."""
    if isinstance(task.aim, ParameterAim):
        return task
    half = 0.5 * task.limits.length
    if half < FEWEST_STEPS * task.limits.period:
        return task
    recorded = tuple(first_half(inputs) for inputs in task.recorded)
    return replace(task, limits=replace(task.limits, length=half), recorded=recorded)


def _played(guard: Guard, inputs: np.ndarray, limits: Limits, whole: Limits) -> np.ndarray:
    """The input of the length `whole`: itself, or played again from its beginning; so small that it is safe
    and that the safe ranges hold with the probability that is asked for."""
    if limits != whole:
        again = np.tile(inputs, (2, 1))[: whole.time.size]
        columns = zip(whole.inputs, again.T, strict=True)
        again = np.column_stack([slewed(column, one.rate * whole.period) for one, column in columns])
        safe = guard.kept_safe(again, whole)
        if safe is None:
            raise EstimationError(
                "design-nothing",
                "the designed input leaves a safe range when it is played a second time",
                remedy="widen the safe ranges, or give a shorter --length",
            )
        inputs = safe
    return guard.calmed(inputs, whole)


def _notes(best: Played, inputs: np.ndarray, limits: Limits, *, is_repeated: bool) -> list[str]:
    twice = [REPEATED] if is_repeated else []
    if not limits.safe or (best.inputs is not None and np.allclose(inputs, best.inputs)):
        return twice
    return [
        *twice,
        f"made smaller, so that the safe ranges hold with a probability of {100 * (1 - TOLERATED):.0f} % "
        "over the uncertainty of the parameters",
    ]


def _require_stable(task: Task) -> None:
    """A model whose motion grows without bound tells of a motion that no machine would make."""
    if task.limits.safe:
        return
    for explainer in task.aim.driven:
        rate = _fastest_growth(explainer)
        if rate * task.limits.length > GROWN:
            raise EstimationError(
                "design-unstable",
                f"the model is unstable: a motion grows e-fold within {1.0 / rate:.3g} s, and the experiment "
                f"takes {task.limits.length:.4g} s",
                remedy="give the controller that holds the machine, --controller FILE.mo, and its reference "
                "is designed; or give safe ranges with --limit NAME=LOW,HIGH",
            )


def _fastest_growth(explainer: Explainer) -> float:
    """Largest real part of the poles [1/s], at the start of a nonlinear model."""
    explicit = explainer.explicit
    try:
        family = explainer.family if isinstance(explainer, LinearExplainer) else state_space_family(explicit)
        A = state_space(family, explicit.flat.theta_values).A
    except DaestError:
        return 0.0
    if not A.size or not np.all(np.isfinite(A)):
        return 0.0
    return float(np.max(np.linalg.eigvals(A).real))


def _distinct(task: Task) -> tuple[Task, list[str]]:
    """The task with one of all rivals that do the same within the limits, and what was left out."""
    aim, limits = task.aim, task.limits
    if not isinstance(aim, RivalAim):
        return task, []
    probes = [
        _probe(limits, family, task.seed)
        for family in PROBES
        if limits.band[0] == 0.0 or family in KEEPS_LOWEST
    ]
    groups = aim.groups(probes)
    said = [
        f"{', '.join(aim.labels[i] for i in group)} do the same within these limits: the first stands for all"
        for group in groups
        if len(group) > 1
    ]
    if len(groups) == 1:
        raise EstimationError(
            "design-same-equation",
            f"{', '.join(aim.labels)} do the same whatever is played within these limits, with other "
            "parameters: they are one equation there",
            remedy="widen the limits (both directions of motion, larger amplitudes), or measure something "
            "between their places",
        )
    first = [group[0] for group in groups]
    return replace(task, aim=aim.only(first), subjects=tuple(task.subjects[i] for i in first)), said


def _probe(limits: Limits, family: str, seed: int) -> np.ndarray:
    """An input of the family at a middle time scale."""
    shapes = list(FAMILIES[family](limits, seed))
    return within(limits, shapes[len(shapes) // 2].signal, keeps_form=family in KEEPS_LOWEST)


def _open(task: Task, inputs: np.ndarray) -> tuple[WeakDirection, ...]:
    if not isinstance(task.aim, ParameterAim):
        return ()
    return task.aim.open_directions([*task.recorded, inputs])


def _what_no_input_tells(
    task: Task, left_open: Sequence[WeakDirection], sensors: Sequence[SensorGain]
) -> list[str]:
    """A sentence for every combination of parameters that reaches no output, whatever is played."""
    outputs = ", ".join(y.name for y in task.subjects[0].flat.outputs)
    closing = [s.variables[0] for s in sensors if s.closes]
    said = []
    for direction in left_open:
        if np.isfinite(direction.relative_std):
            continue
        names = " · ".join(n if w == 1.0 else f"{n}^{w:.3g}" for n, w in direction.combination.items())
        remedy = f", or a sensor at {' or '.join(closing)}" if closing else ""
        said.append(
            f"no input tells {names}: scaled together like that, these parameters leave {outputs} as they "
            f"are; one of them known from elsewhere would do{remedy}"
        )
    return said


def _sensors(task: Task, inputs: np.ndarray, notes: list[str]) -> tuple[SensorGain, ...]:
    found = sensor_gains(task.aim, task.subjects, task.limits, inputs, task.sensor_noise, task.commanded)
    unknown = [name for name in task.sensor_noise if not any(name in one.variables for one in found)]
    if unknown:
        notes.append(f"no sensor at {', '.join(unknown)}: it does not move, or is no variable of the model")
    useful = [s for s in found if s.gain > LITTLE or s.closes or set(s.variables) & set(task.sensor_noise)]
    return tuple(useful[:MOST_TOLD])


def _powers(task: Task, inputs: np.ndarray, whole: float) -> tuple[PowerPoint, ...]:
    aim, limits = task.aim, task.limits
    assert isinstance(aim, DetectAim)
    middle = np.array([one.middle for one in limits.inputs])
    cases = [(length, 1.0) for length in LENGTHS] + [(1.0, amplitude) for amplitude in AMPLITUDES]
    found = []
    for length, amplitude in cases:
        played = middle + amplitude * (_of_length(inputs, length) - middle)
        expected = aim.expected([played])
        if expected is not None and expected.power is not None and expected.smallest_size is not None:
            point = (length * whole, amplitude, expected.power, expected.smallest_size)
            found.append(PowerPoint(*point))
    return tuple(found)


def _of_length(inputs: np.ndarray, share: float) -> np.ndarray:
    """The input cut, or played again from its beginning."""
    n = max(2, round(share * inputs.shape[0]))
    return np.tile(inputs, (int(np.ceil(share)), 1))[:n]


def told(found: Design, aim: Aim) -> str:
    """The design in a sentence."""
    best = found.families[0]
    ranges = ", ".join(
        f"{r.name} from {u.min():.3g} to {u.max():.3g} {r.unit}".rstrip()
        for r, u in zip(found.limits.inputs, found.inputs.T, strict=True)
    )
    how = _how(best, found.families)
    return f"Play {how} for {found.limits.length:.4g} s, {ranges}: {_promise(found, aim)}."


def _how(best: Played, families: Sequence[Played]) -> str:
    if best.family != FREE:
        return f"{best.family} ({best.shape})"
    return "the free input that the gradient found"


def _promise(found: Design, aim: Aim) -> str:
    expected, present = found.expected, found.present
    if isinstance(aim, RivalAim):
        pair = min(expected.log_likelihood_ratio, key=lambda p: expected.log_likelihood_ratio[p])
        text = (
            f"the closest pair, {pair}, is expected to differ by {expected.value:.3g} in log-likelihood "
            f"(told apart with {_percent(expected.power)})"
        )
        return text + ("" if present is None else f", against {present.value:.3g} in what is recorded")
    if isinstance(aim, DetectAim):
        size = expected.smallest_size
        text = f"an effect of {aim.size:.3g} is seen with {_percent(expected.power)}"
        text += "" if size is None or not np.isfinite(size) else f", and from {size:.3g} with 95 %"
        if present is None or present.smallest_size is None:
            return text
        return f"{text}; the present recording shows it from {present.smallest_size:.3g}"
    errors = [f"{n} ± {e:.2g}" for n, e in expected.std_errors.items() if e is not None]
    unknown = [n for n, e in expected.std_errors.items() if e is None]
    text = f"expected standard errors {', '.join(errors)}" if errors else "no parameter is determined alone"
    text += f" ({', '.join(unknown)} stay open)" if errors and unknown else ""
    if present is None:
        return text
    better = present.value / expected.value
    if better < 1.0:
        return f"{text}; the present recording is {1.0 / better:.2g} times better"
    return f"{text}; {better:.2g} times better than the present recording"


def _percent(power: float | None) -> str:
    return "-" if power is None else f"{100.0 * power:.0f} % probability"
