"""Where the search of a nonlinear model starts: state scales, initial states, hold, further start points."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from daest.errors import DaestError
from daest.estimation.fitting.coordinates import Unknowns, objective, parameter_scale
from daest.estimation.fitting.records import n_observed, part_of
from daest.estimation.fitting.search import Evaluation, Found, Objective, minimise
from daest.estimation.fitting.setup import check_start, no_start
from daest.estimation.gates import FIT
from daest.estimation.linear.delay_starts import shapes_of_past
from daest.estimation.linear.hold_search import are_steps, moving_inputs, possible_holds, ranked_holds
from daest.estimation.nonlinear.gain_family import LONGEST_LOG
from daest.estimation.nonlinear.trajectories import TrajectoryProblem, integrated, prediction_errors
from daest.model.fit import IdentifyOptions
from daest.model.holds import SMOOTH, Hold
from daest.systems.events.integration import IntegrationError
from daest.systems.reduction.initialize import initial_point
from daest.systems.reduction.input_slopes import acting_slopes
from daest.systems.simulation.integrate import follows_curves

FIRST_LENGTH = 500  # samples of the fit that finds the initial state before the whole record is used
GROWN_LENGTHS = (50, 150)  # over which it is looked for before, for a second search of that fit
SHORT_SHARE = 4  # of a short record is such a part, ...
FEWEST_SHORT = 20  # ... but no fewer samples
SHORT_LENGTH = 100  # samples that also must show a direction as flat before it is called unidentifiable
INITIAL_ITERATIONS = 15
MEASURED_LENGTHS = (2, 10, 50)  # samples that are to show the initial states
MEASURED_STEPS = 6  # towards what they show
SIZES = 10.0 ** -np.arange(1.0, 10.0)  # of effects, relative to where they stand
HOLD_ITERATIONS = 6


def started(
    problem: TrajectoryProblem, enough: float = FIT.converged_gain
) -> tuple[TrajectoryProblem, np.ndarray]:
    """State scales from a first simulation, and initial states that fit the beginning of each experiment,
    searched until a step would gain less than `enough` in log-likelihood. Shapes: the search vector is
    (n_z,)."""
    problem, z = scaled(problem, unscaled_start(problem))
    return problem, fit_initial_states(problem, z, *limits(problem), enough)


def unscaled_start(problem: TrajectoryProblem) -> np.ndarray:
    """The start values of the unknowns with the initial states that the model asks for, in their units
    (n_z,)."""
    start = problem.unknowns.start
    return np.concatenate([start, consistent_states(problem, start).ravel()])


def called_back(problem: TrajectoryProblem, z: np.ndarray) -> list[np.ndarray]:
    """z with the initial states that are far off where the model says, which may have been fitted with other
    parameters in mind, and none has a slope to come back by; empty where there are none. Shapes: z (n_z,)."""
    n, n_states = len(problem.unknowns.coordinates), problem.n_states * len(problem.experiments)
    own = (consistent_states(problem, z[:n]) / problem.state_scale).ravel()
    is_far = np.abs(z[n : n + n_states] - own) > FIT.far_beginning
    if not np.any(is_far):
        return []
    back = z.copy()
    back[n : n + n_states][is_far] = own[is_far]
    return [back]


def with_sized_effects(problem: TrajectoryProblem) -> TrajectoryProblem:
    """The problem with all sizes of effects nearer to where these vanish, by powers of ten, if the model fits
    better there from its own initial state.

    A size of which nothing is known stands at the number of its class, which may be a million times too
    large: from there a search ends where the effect does something else. Of the sizes that fit about alike
    the largest are taken: at next to none, the data show no effect to search for.
    """
    parameters = problem.model.explicit.flat.parameters
    nulls = {p.name: p.null for p in parameters if p.null is not None}
    if not any(c.name in nulls and c.initial != nulls[c.name] for c in problem.unknowns.coordinates):
        return problem

    def misfit(tried: TrajectoryProblem) -> float:
        start = tried.unknowns.start
        try:
            z = np.concatenate([start, consistent_states(tried, start).ravel()])
        except DaestError:
            return np.inf
        found = objective(tried)(z, False)
        return np.inf if found is None else found.value

    sized = [problem, *(replace(problem, unknowns=_shrunk(problem.unknowns, nulls, by)) for by in SIZES)]
    misfits = [misfit(one) for one in sized]
    least = min(misfits)
    if not np.isfinite(misfits[0]):
        return sized[misfits.index(least)]
    enough = misfits[0] - FIT.gained_by_sizes * (misfits[0] - least)
    return next(one for one, value in zip(sized, misfits, strict=True) if value <= enough)


def _shrunk(unknowns: Unknowns, nulls: Mapping[str, float], by: float) -> Unknowns:
    return replace(
        unknowns,
        coordinates=tuple(
            replace(c, initial=value, scale=c.scale if c.is_log else parameter_scale(value, None))
            if c.name in nulls and (value := nulls[c.name] + by * (c.initial - nulls[c.name])) != c.initial
            else c
            for c in unknowns.coordinates
        ),
    )


def consistent_states(problem: TrajectoryProblem, z_parameters: np.ndarray) -> np.ndarray:
    """Initial states (n_experiments, n_states) that the model itself asks for."""
    explicit, theta = problem.model.explicit, problem.theta(z_parameters)
    return np.array([initial_point(explicit, theta, e.inputs[0])[0] for e in problem.experiments])


def scaled(problem: TrajectoryProblem, z: np.ndarray) -> tuple[TrajectoryProblem, np.ndarray]:
    """The problem with state scales read off a simulation, and z (given unscaled) in them. A state that rests
    in it, such as an unknown load, is scaled by what it does to the outputs. Shapes: z (n_z,)."""
    n = len(problem.unknowns.coordinates)
    errors = prediction_errors(problem, z)
    if errors is None:
        return problem, z
    size = np.max([np.max(np.abs(t.states), axis=0) for t in errors.trajectories], axis=0)
    # A state that rests at zero leaves it by rounding, which is no size to resolve it by.
    least = FIT.rounded_state * np.max(size[np.isfinite(size)], initial=0.0)
    rests = ~(np.isfinite(size) & (size > least))
    scale = np.where(rests, _scale_by_outputs(problem, z) if np.any(rests) else 1.0, size)
    x0 = z[n:].reshape(len(problem.experiments), scale.size) / scale
    return replace(problem, state_scale=scale), np.concatenate([z[:n], x0.ravel()])


def with_outgrown_scales(problem: TrajectoryProblem, z: np.ndarray) -> tuple[TrajectoryProblem, np.ndarray]:
    """The problem with larger scales of the states that have far outgrown theirs along its runs at z, and z
    in them.

    A scale is read off one simulation, in which an effect may do next to nothing. A step moves no unknown by
    more than a few scales, so that an initial value of hundreds of them holds up the whole search. Shapes: z
    (n_z,)."""
    n = len(problem.unknowns.coordinates)
    errors = prediction_errors(problem, z)
    if errors is None:
        return problem, z
    size = np.max([np.max(np.abs(t.states), axis=0) for t in errors.trajectories], axis=0)
    outgrown = np.isfinite(size) & (size > FIT.outgrown_scale * problem.state_scale)
    if not np.any(outgrown):
        return problem, z
    scale = np.where(outgrown, size, problem.state_scale)
    x0 = problem.initial_states(z) / scale
    return replace(problem, state_scale=scale), np.concatenate([z[:n], x0.ravel()])


def _scale_by_outputs(problem: TrajectoryProblem, z: np.ndarray) -> np.ndarray:
    """The initial value of each state that moves the outputs by as much as is left of them, on average over a
    record, in the scales of the problem; 1 for a state that moves none, such as one that a stiff law pulls to
    its place before the first sample is over. Shapes: z (n_z,); the scales (n_states,)."""
    here = objective(problem)(z, True)
    if here is None:
        return np.ones_like(problem.state_scale)
    n, n_experiments = len(problem.unknowns.coordinates), len(problem.experiments)
    own = np.diagonal(here.information)[n : n + n_experiments * problem.n_states]
    most = np.max(own.reshape(n_experiments, problem.n_states), axis=0)
    longest = max(n_observed([e]) for e in problem.experiments)
    return np.sqrt(longest / np.where(most > FIT.no_influence * longest, most, longest))


def fit_initial_states(
    problem: TrajectoryProblem,
    z: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    enough: float = FIT.converged_gain,
) -> np.ndarray:
    """z with the initial states within bounds that fit the first samples best, parameters held: each search
    ends where a step would gain less than `enough` in log-likelihood.

    They are looked for at once and over windows that grow, from where the first samples lead if the model
    fits better there. Over a long one the start of an arm that turns over may end whole turns away from what
    was measured: over a short one it cannot. Shapes: z, lower and upper (n_z,).
    """
    n = len(problem.unknowns.coordinates)

    def over(length: int) -> Objective:
        heads = tuple(part_of(e, 0, length) for e in problem.experiments)
        return objective(replace(problem, experiments=heads).held_at(z))

    def found_over(length: int, states: np.ndarray) -> Found | None:
        return minimise(over(length), states, lower[n:], upper[n:], INITIAL_ITERATIONS, enough)

    longest = max(e.n_samples for e in problem.experiments)
    shown = [as_measured(problem, z, lower, upper, sizes) for sizes in _sizes_of_outputs(problem)]
    states = _likeliest(problem, z, shown)
    ends = [found_over(FIRST_LENGTH, states)]
    grown_lengths = [length for length in GROWN_LENGTHS if length < longest]
    for length in grown_lengths:
        grown = found_over(length, states)
        states = states if grown is None else grown.z
    if grown_lengths:
        ends.append(found_over(FIRST_LENGTH, states))
    found = [end for end in ends if end is not None]
    best = min(found, key=lambda end: end.evaluation.value, default=None)
    return z if best is None else np.concatenate([z[:n], _as_far_as_seen(over(FIRST_LENGTH), best, z[n:])])


def _as_far_as_seen(likelihood: Objective, found: Found, begun: np.ndarray) -> np.ndarray:
    """The initial states that were `found`, without what the first samples do not tell from the start.

    A state that is gone before the second sample ends anywhere, as far as hundreds of scales off, and holds
    up a search that has to bring it back: no step moves an unknown by more than a few. Shapes: begun and the
    states (n_x,)."""
    way = found.z - begun
    if np.max(np.abs(way), initial=0.0) <= FIT.largest_step:
        return found.z
    rates, directions = np.linalg.eigh(found.evaluation.information)
    parts = directions.T @ way
    is_seen = rates * parts**2 / 2.0 > FIT.untold_start
    states = begun + directions @ np.where(is_seen, parts, 0.0)
    moved = likelihood(states, False)
    most = found.evaluation.value + begun.size * FIT.untold_start
    return states if moved is not None and moved.value < most else found.z


def _sizes_of_outputs(problem: TrajectoryProblem) -> list[np.ndarray]:
    """Their rms and, where one goes on and on, that of their steps between samples, each (n_y,). Beside an
    angle of a hundred turns half a turn is nothing, and what hangs on a stiff spring is millions."""
    steps = [np.diff(e.outputs, axis=0) for e in problem.experiments]
    known = [np.where(np.isfinite(one), one, 0.0) for one in steps]
    counts = np.maximum(sum(np.isfinite(one).sum(axis=0) for one in steps), 1)
    moved = np.sqrt(sum((one**2).sum(axis=0) for one in known) / counts)
    sizes = problem.output_sizes
    goes_on = moved < FIT.shown_at_once * sizes
    if not np.any(goes_on) or np.any(moved == 0.0):
        return [sizes]
    return [sizes, moved]


def as_measured(
    problem: TrajectoryProblem,
    z: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    sizes: np.ndarray,
) -> np.ndarray:
    """Initial states within bounds that the first samples of each experiment show, those that these do not
    show as in z: of one sample, then of windows that grow, every output in its own size of `sizes` (n_y,).
    Shapes: z, lower and upper (n_z,); the initial states (n_experiments * n_states,), in the scales of the
    problem."""
    n = len(problem.unknowns.coordinates)
    states = z[n:]
    for length in MEASURED_LENGTHS:
        heads = tuple(part_of(e, 0, length) for e in problem.experiments)
        short = replace(problem, experiments=heads).held_at(z)
        states = _nearest(short, sizes, states, lower[n:], upper[n:])
    return states


def _nearest(
    problem: TrajectoryProblem, sizes: np.ndarray, states: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> np.ndarray:
    """The end of Newton steps of the shortest way from the initial `states` of a problem without other
    unknowns, while they halve the error in `sizes` of the outputs. Shapes: sizes (n_y,), all others
    (n_experiments * n_states,)."""
    is_free = (lower < upper).reshape(len(problem.experiments), -1)
    begun, least = states, np.inf
    for _ in range(MEASURED_STEPS):
        try:
            made = integrated(problem, states, True)
        except IntegrationError:
            break
        pairs = zip(problem.experiments, made, strict=True)
        errors = [((e.outputs - t.outputs) / sizes).ravel() for e, t in pairs]
        size = float(np.sqrt(sum(np.nansum(error**2) for error in errors)))
        if not size <= 0.5 * least:
            break
        begun, least = states, size
        steps = []
        for run, free, error in zip(made, is_free, errors, strict=True):
            slopes = run.sensitivities * problem.state_scale / sizes[:, None] * free
            known = np.isfinite(error)
            rows = slopes.reshape(error.size, -1)[known]
            if not np.all(np.isfinite(rows)):
                return begun
            steps.append(np.linalg.lstsq(rows, error[known], rcond=FIT.shown_at_once)[0])
        states = np.clip(states + np.concatenate(steps), lower, upper)
    return begun


def _likeliest(problem: TrajectoryProblem, z: np.ndarray, shown: Sequence[np.ndarray]) -> np.ndarray:
    """The initial states, of those of z (n_z,) and those that are `shown`, that make the first samples
    likeliest; all (n_experiments * n_states,)."""
    given = z[len(problem.unknowns.coordinates) :]
    others = [states for states in shown if states is not given]
    if not others:
        return given
    heads = tuple(part_of(e, 0, FIRST_LENGTH) for e in problem.experiments)
    likelihood = objective(replace(problem, experiments=heads).held_at(z))
    made = [(likelihood(states, False), states) for states in (given, *others)]
    return min(
        ((one.value, states) for one, states in made if one is not None),
        key=lambda pair: pair[0],
        default=(0.0, given),
    )[1]


def begun_best(
    problem: TrajectoryProblem,
    z: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    iterations: int,
    *,
    is_near: bool = False,
) -> tuple[TrajectoryProblem, Found | None]:
    """The end of a search for the initial states that fit whole experiments best, of a problem that has no
    other unknowns, and the problem in the scales of this end; None where it cannot be simulated. Unless
    `is_near`, the first samples are fitted before.

    A recording that begins far from where the inputs alone would lead, or states that the outputs hardly see,
    would take hundreds of steps in the sizes that a simulation from rest shows. The shape of what a short
    delay holds is hardly seen, and in a size that is seen it is far beyond what the slopes of a law behind it
    tell: a search that sticks there begins anew with these shapes at rest. And where the first samples show
    a start that is far off, behind a sensor that bends or saturates, it begins anew amid what the run reaches
    later. Shapes: z, lower and upper (n_z,)."""
    grown = np.maximum(_scale_by_outputs(problem, z), 1.0)
    z = z / np.tile(grown, len(problem.experiments))
    problem = replace(problem, state_scale=problem.state_scale * grown)
    likelihood = objective(problem)

    def ended(begun: np.ndarray, low: np.ndarray, high: np.ndarray) -> Found | None:
        near = begun if is_near else fit_initial_states(problem, begun, low, high, FIT.agreement_gain)
        return minimise(likelihood, near, low, high, iterations, FIT.agreement_gain)

    ends = [ended(z, lower, upper)]
    shapes = np.tile(shapes_of_past(problem.model.explicit.state_names), len(problem.experiments))
    is_there = ends[0] is not None and ends[0].reason == "converged"
    if not is_there and np.any(shapes & (lower < upper)):
        resting = ended(*(np.where(shapes, 0.0, part) for part in (z, lower, upper)))
        ends.append(resting)
        if resting is not None:
            ends.append(minimise(likelihood, resting.z, lower, upper, iterations, FIT.agreement_gain))
    middle = None if is_near or ends[0] is None else _amid_the_run(problem, ends[0].z)
    if middle is not None:
        ends.append(ended(np.clip(middle, lower, upper), lower, upper))
    found = [end for end in ends if end is not None]
    return problem, min(found, key=lambda end: end.evaluation.value, default=None)


def _amid_the_run(problem: TrajectoryProblem, z: np.ndarray) -> np.ndarray | None:
    """The initial states (n_z,) amid those that the runs from z come to, where the first part of some
    recording is left with much larger errors of an output than the rest; None where none is."""
    errors = prediction_errors(problem, z)
    if errors is None or not any(_shows_its_start(one) for one in errors.errors):
        return None
    middle = np.array([np.median(one.states, axis=0) for one in errors.trajectories])
    return (middle / problem.state_scale).ravel() if np.isfinite(middle).all() else None


def _shows_its_start(errors: np.ndarray) -> bool:
    """Whether the first tenth of errors (n_samples, n_y) is much larger than the rest, at some output."""
    n = errors.shape[0] // 10
    if n == 0:
        return False
    known = np.where(np.isfinite(errors), errors, 0.0)
    first, rest = (np.sqrt(np.mean(np.square(part), axis=0)) for part in (known[:n], known[n:]))
    return bool(np.any(first > FIT.shown_start * rest))


def limits(problem: TrajectoryProblem) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of the search vector. Shapes: lower and upper bounds (n_z,)."""
    n_initial = len(problem.experiments) * problem.n_states
    initial = np.where(problem.held_starts.ravel(), 0.0, np.full(n_initial, FIT.state_range))
    logs = np.full(0 if problem.family is None else problem.family.n_logs, LONGEST_LOG)
    lower = np.concatenate([problem.unknowns.lower, -initial, -logs])
    upper = np.concatenate([problem.unknowns.upper, initial, logs])
    return lower, upper


def at_rest(
    problem: TrajectoryProblem, z: np.ndarray, rests: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """z and its bounds, all (n_z,), of a problem with initial states alone, where those that `rests`
    (n_experiments, n_states) tells begin at zero."""
    lower, upper, begun = (np.where(rests.ravel(), 0.0, part) for part in (*limits(problem), z))
    return begun, lower, upper


def with_hold(
    problem: TrajectoryProblem, z: np.ndarray, options: IdentifyOptions
) -> tuple[TrajectoryProblem, np.ndarray]:
    """The given hold, or the one with the higher likelihood after short fits. Shapes: z (n_z,)."""
    names, asked = asked_holds(problem, options)
    if len(asked) < 2:
        return problem, z
    ends: dict[Hold, Found] = {}
    in_steps = are_steps(problem.experiments, names)
    ranked = ranked_holds(names, _short_fits(problem, z, ends), asked, in_steps)
    return (replace(problem, hold=ranked[0]), ends[ranked[0]].z) if ranked else (problem, z)


def _short_fits(
    problem: TrajectoryProblem, z: np.ndarray, ends: dict[Hold, Found], goal: float = np.inf
) -> Callable[[Hold], float | None]:
    """The likelihood of a hold after a short fit from z, whose end is put among `ends`, where those that are
    there already are not fitted again. One that will not come down to the `goal` ends early."""

    def likelihood(hold: Hold) -> float | None:
        if hold not in ends:
            other = objective(replace(problem, hold=hold))
            found = minimise(other, z, *limits(problem), HOLD_ITERATIONS, goal=goal)
            if found is None:
                return None
            ends[hold] = found
        return -ends[hold].evaluation.value

    return likelihood


def _needs_slopes(problem: TrajectoryProblem) -> bool:
    unknowns = problem.unknowns
    return bool(acting_slopes(problem.model.explicit, unknowns.parameter_names(), unknowns.theta))


def asked_holds(
    problem: TrajectoryProblem, options: IdentifyOptions
) -> tuple[tuple[str, ...], tuple[Hold, ...]]:
    """The inputs that move, and the holds of all alike to choose from; none where the hold is given."""
    inputs = problem.model.explicit.flat.inputs
    if options.hold is not None or not inputs:
        return (), ()
    names = moving_inputs(problem.experiments, [one.name for one in inputs])
    asked = possible_holds(problem.experiments, names, _needs_slopes(problem))
    if not follows_curves(problem.model.explicit):
        asked = tuple(hold for hold in asked if hold != SMOOTH)
    return names, asked


def with_other_hold(
    problem: TrajectoryProblem, found: Found, options: IdentifyOptions
) -> tuple[Hold, np.ndarray] | None:
    """A hold that was not taken, and z, where a short fit from the end of a search with
    it is likelier than that: far from the truth, holds are compared by what none explains. All inputs are
    turned, and one alone. None where the hold is given, or right. Shapes: z (n_z,)."""
    names, asked = asked_holds(problem, options)
    if len(asked) < 2:
        return None
    ends = {problem.hold: found}
    first = tuple(dict.fromkeys([problem.hold, *asked]))
    in_steps = are_steps(problem.experiments, names)
    fits = _short_fits(problem, found.z, ends, found.evaluation.value)
    best = ranked_holds(names, fits, first, in_steps)[0]
    return None if best == problem.hold else (best, ends[best].z)


def check_nonlinear_start(problem: TrajectoryProblem, z: np.ndarray, may_be_cut: bool) -> None:
    """Errors of `check_start`. An unstable simulation drowns every direction but one in its growth: a
    direction is flat only if a short piece agrees. Where the record may be cut, the piece is enough.
    Shapes: z (n_z,)."""
    observed = n_observed(problem.experiments)
    whole, piece = whole_and_piece(problem, z)
    if whole is None and may_be_cut:
        whole, observed = piece, n_observed(_piece_of(problem).experiments)
    if whole is None:
        raise no_start(_failure(problem, z))
    check_start(problem.unknowns, whole, observed, piece)


def whole_and_piece(problem: TrajectoryProblem, z: np.ndarray) -> tuple[Evaluation | None, Evaluation | None]:
    """What the whole records and short pieces of them say of the parameters at z (n_z,)."""
    whole, piece = (_of_parameters(part, z) for part in (problem, _piece_of(problem)))
    return whole, piece


def _piece_of(problem: TrajectoryProblem) -> TrajectoryProblem:
    """The first samples of every record, and no more than a part of one that is short itself."""
    pieces = (min(SHORT_LENGTH, max(e.n_samples // SHORT_SHARE, FEWEST_SHORT)) for e in problem.experiments)
    parts = zip(problem.experiments, pieces, strict=True)
    return replace(problem, experiments=tuple(part_of(e, 0, n) for e, n in parts))


def _failure(problem: TrajectoryProblem, z: np.ndarray) -> str:
    """Why the model cannot be simulated at z; empty when it can, but to no finite likelihood."""
    try:
        integrated(problem, z)
    except IntegrationError as error:
        return error.what
    return ""


def _of_parameters(problem: TrajectoryProblem, z: np.ndarray) -> Evaluation | None:
    """The start without the rows of the initial states."""
    start = objective(problem)(z, True)
    n = len(problem.unknowns.coordinates)
    return start and Evaluation(start.value, start.gradient[:n], start.information[:n, :n])


def further_starts(problem: TrajectoryProblem, z: np.ndarray, options: IdentifyOptions) -> list[np.ndarray]:
    """Random parameters around z, with initial states refitted. All of them have the shape (n_z,)."""
    rng = np.random.default_rng(options.seed)
    lower, upper = limits(problem)
    spread = problem.unknowns.spread
    result = []
    for _ in range(options.starts - 1):
        moved = z.copy()
        moved[: spread.size] += rng.uniform(-spread, spread)
        result.append(fit_initial_states(problem, np.clip(moved, lower, upper), lower, upper))
    return result
