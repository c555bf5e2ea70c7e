"""Free forms: does an unexplained load follow some variable of the model, whatever the law?

A load at a place is written as a curve over one variable, or over one variable with the sign of a speed, on a
few basis functions. Like the effects of the screen, the basis functions at size zero are sent through the
observer's error dynamics, and what refitted parameters would do is projected out: the score test of each form
is calibrated, the loads of the null and a constant load being part of the hypothesis.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from daest.data.limits import DATA
from daest.diagnosis.comparison.trial import variables_along
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import Null
from daest.diagnosis.null_model.null_observer import NullObserver
from daest.diagnosis.screening.responses import loads_rescaled, nuisance, responses_along
from daest.diagnosis.screening.scores import projected, projection, spread_under
from daest.model.diagnosis import FreeForm
from daest.model.experiment import Experiment
from daest.model.holds import interval_ends
from daest.modelica.flat.delays import is_memory_of_delay
from daest.numerics.statistics import chi2

KNOTS = 8  # of a curve, with equally many samples between each two
HARMONICS = 3  # of an angle that turns round
TURN = 2.0 * np.pi
N_ANGLES = 16  # at which the curve over a turn is shown
SPEED_UNITS = ("rad/s", "m/s")
ANGLE_UNIT = "rad"
AT_ONCE = 64  # courses that are sent along a recording together: what fits into memory
SAME = 1e-9  # share of its size, within which a variable is the same with loads as without
JUMP = 3.0  # times that, where the curve is shown beside its jump

Apart = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]  # what no parameter explains, and its share
Spread = Callable[[np.ndarray], np.ndarray]  # of the scores of unit responses
Key = tuple[int, str, str]  # load, variable, speed whose sign multiplies the curve


@dataclass(frozen=True)
class Basis:
    """Basis functions along one experiment, at the corrected states and then at the predicted ones (k,
    2 n_samples), and their values (k, m) at the abscissae x (m,) that show the curve."""

    course: np.ndarray
    x: np.ndarray
    shown: np.ndarray
    over_a_turn: bool = False


_known: deque[tuple[Null, tuple[FreeForm, ...]]] = deque(maxlen=2)
"""All forms of what was examined last: a pair of effects is proved beside the same null once more."""


def keep_forms(null: Null, forms: tuple[FreeForm, ...]) -> None:
    """Keep all forms of a null, wherever they were found."""
    _known.appendleft((null, forms))


def forms_of(null: Null, run: NullObserver) -> tuple[FreeForm, ...]:
    """All forms of a null and its observer `run`, those that are kept where they are."""
    for other, forms in tuple(_known):
        if other is null:
            return forms
    return free_forms(null, run)


def free_forms(null: Null, run: NullObserver, variables: Iterable[str] | None = None) -> tuple[FreeForm, ...]:
    """All forms at all places of loads, the one that says most first. `variables` restricts the search."""
    tables = _tables(null, run)
    wanted = None if variables is None else set(variables)
    shared = [
        (name, speed)
        for name, speed in (tables[0] if tables else {})
        if all((name, speed) in table for table in tables)
        and (wanted is None or (name in wanted and (not speed or speed in wanted)))
    ]
    parameters, spread = nuisance(run, len(null.estimated)), spread_under(run.whitened)
    # All together: the walk along the recordings costs nearly the same for one course and for many.
    courses = [
        np.vstack([np.ones((1, 2 * e.n_samples)), *(table[key].course for key in shared)])
        for e, table in zip(null.experiments, tables, strict=True)
    ]
    ends = np.cumsum([1, *(tables[0][key].course.shape[0] for key in shared)])
    rescaling, forms = loads_rescaled(null, run), []
    for index in range(len(null.loads)):
        whole = _responses(null, run, index, courses)
        if not np.all(np.isfinite(whole)):
            continue  # one gain holds nowhere in what bends so much: what a load does grows without end
        constant, *parts = np.split(whole, ends[:-1])
        known = np.vstack([parameters, constant])  # a constant load follows nothing
        apart, rescaled = projection(known), projection(np.vstack([known, rescaling]))
        for (name, speed), responses in zip(shared, parts, strict=True):
            key, basis = (index, name, speed), tables[0][name, speed]
            line = _line(basis, speed) @ responses
            # A load in proportion to an input is a gain of it, which parameters and loads may be together.
            beside = projection(np.vstack([known, line])) if _is_in(rescaled, line) else apart
            forms.append(_tested(null, key, basis, responses, beside, run.whitened, spread))
    corrected = [replace(f, p_value=min(1.0, len(forms) * f.p_value)) for f in forms]
    return tuple(sorted(corrected, key=_rank))


def _line(basis: Basis, speed: str) -> np.ndarray:
    """Weights (1, k) of the functions of a basis whose sum is the variable itself; none (0, k) where that is
    no curve of the basis."""
    if speed or basis.over_a_turn:
        return np.zeros((0, basis.shown.shape[0]))
    return np.linalg.lstsq(basis.shown.T, basis.x)[0][None]


def _is_in(apart: Apart, line: np.ndarray) -> bool:
    """Whether next to nothing of the response (1, m) is left apart from known ones."""
    return bool(line.size) and float(apart(line)[1].item()) < GATES.absorbed_share


def _rank(form: FreeForm) -> float:
    """One variable is said before two where it says nearly as much."""
    return -form.log_likelihood_gain * (GATES.two_variables if form.sign_of else 1.0)


def covers(null: Null, run: NullObserver, form: FreeForm, response: np.ndarray) -> float:
    """Share of a law's score (squared) that the free form also explains, given its response (1, m) on the
    whitened innovations: 1 where the law is a special case of the form."""
    named = [name for name in (form.variable, form.sign_of) if name]
    courses = [table[form.variable, form.sign_of].course for table in _tables(null, run, named)]
    responses = _responses(null, run, form.load, courses)
    directions = nuisance(run, len(null.estimated))
    curve = _frame(responses) @ responses
    alone, left = (projected(response, d)[0] for d in (directions, np.vstack([directions, curve])))
    return 1.0 - min(_score(left, run.whitened) / max(_score(alone, run.whitened), 1e-12), 1.0)


def _score(rest: np.ndarray, white: np.ndarray) -> float:
    size = float(np.sum(rest**2))
    return float((rest @ white).item() ** 2 / size) if size > 0.0 else 0.0


def _frame(responses: np.ndarray) -> np.ndarray:
    """F (r, k), such that the rows of F · responses are orthonormal and span the responses (k, m), but for
    directions whose eigenvalue is below GATES.form_rank times the largest."""
    size, turn = np.linalg.eigh(responses @ responses.T)
    usable = size > GATES.form_rank * size.max(initial=0.0)
    return (turn[:, usable] / np.sqrt(size[usable])).T


def _responses(null: Null, run: NullObserver, index: int, courses: Sequence[np.ndarray]) -> np.ndarray:
    """Responses (k, m) of the whitened innovations to loads of the given courses (k, 2 n_samples), one array
    per experiment."""
    row = run.state_names.index(null.loads[index].name)
    entry = run.average.A[:, row].copy()
    entry[row] = 0.0  # the load's own decay
    parts = []
    for number, (experiment, course) in enumerate(zip(null.experiments, courses, strict=True)):
        corrected, predicted = np.split(course, 2, axis=1)
        ends = np.stack([corrected[:, :-1], predicted[:, 1:]], axis=1)
        rows = [slice(first, first + AT_ONCE) for first in range(0, len(ends), AT_ONCE)]
        parts.append(np.vstack([responses_along(run, number, experiment, ends[r], entry) for r in rows]))
    return np.concatenate(parts, axis=1)


def _tables(null: Null, run: NullObserver, named: Sequence[str] = ()) -> list[dict[tuple[str, str], Basis]]:
    """Basis functions of every experiment by variable and speed; of variables that are alike, the `named`."""
    units = {v.name: v.unit for v in (*null.flat.unknowns, *null.flat.inputs)}
    courses = [internal_variables(null, run, i, named) for i in range(len(null.experiments))]
    shared = [name for name in courses[0] if all(name in c for c in courses)]
    limits = {name: np.concatenate([c[name] for c in courses]) for name in shared}
    tables = []
    for number, course in enumerate(courses):
        predicted = _predicted_variables(null, run, number)
        both = {name: np.concatenate([course[name], predicted[name]]) for name in shared}
        tables.append(_bases(both, limits, units, len(courses)))
    return tables


def _bases(
    variables: Mapping[str, np.ndarray],
    whole: Mapping[str, np.ndarray],
    units: Mapping[str, str],
    n_records: int,
) -> dict[tuple[str, str], Basis]:
    widths = {
        n: GATES.soft_sign * float(np.sqrt(np.mean(whole[n] ** 2)))
        for n in variables
        if units.get(n) in SPEED_UNITS and np.min(whole[n]) < 0.0 < np.max(whole[n])
    }
    speeds = {name: np.tanh(variables[name] / width) for name, width in widths.items()}
    found = {}
    for name, x in variables.items():
        basis = _basis(x, whole[name], units.get(name, ""), n_records)
        if name in widths:
            basis = _with_jump(basis, x, widths[name])
        if basis.x.size < 2:
            continue
        found[name, ""] = basis
        for speed, sign in speeds.items():
            if speed != name:
                found[name, speed] = replace(basis, course=basis.course * sign)
    return found


def _basis(x: np.ndarray, whole: np.ndarray, unit: str, n_records: int) -> Basis:
    """Harmonics of an angle that turns round, else hat functions between quantiles, which are shown as far as
    the variable usually comes in so many recordings."""
    if unit == ANGLE_UNIT and np.ptp(whole) > TURN:
        angles = np.arange(N_ANGLES) * TURN / N_ANGLES
        return Basis(_harmonics(x), angles, _harmonics(angles), over_a_turn=True)
    knots = np.unique(np.quantile(whole, np.linspace(0.0, 1.0, KNOTS)))
    eye, ends = np.eye(knots.size), _usual(whole, n_records)
    inside = np.clip(knots, *ends)
    shown = inside if np.all(np.diff(inside) > 0.0) else knots
    course, lines = (np.array([np.interp(points, knots, row) for row in eye]) for points in (x, shown))
    return Basis(course, shown, lines)


def _usual(whole: np.ndarray, n_records: int) -> tuple[float, float]:
    """The range of a variable (n,) without what lies far beyond all other samples and comes once a recording,
    as the first sample of a start does, or as rarely as a fault: further than the mean distance of two knots,
    in which every seventh sample lies."""
    ordered = np.sort(whole)
    rare = max(n_records, int(DATA.rare * whole.size))
    if 2 * rare >= whole.size - 1:
        return float(ordered[0]), float(ordered[-1])
    low, high = float(ordered[rare]), float(ordered[-1 - rare])
    far = (high - low) / (KNOTS - 1)
    return (
        low if low - ordered[0] > far else float(ordered[0]),
        high if ordered[-1] - high > far else float(ordered[-1]),
    )


def _with_jump(basis: Basis, x: np.ndarray, width: float) -> Basis:
    """The curve over a speed with a jump at zero, as friction has it."""
    edges = [side for side in (-JUMP * width, JUMP * width) if basis.x[0] < side < basis.x[-1]]
    shown = np.sort(np.append(basis.x, edges))
    lines = np.array([np.interp(shown, basis.x, row) for row in basis.shown])
    return Basis(
        np.vstack([basis.course, np.tanh(x / width)]), shown, np.vstack([lines, np.tanh(shown / width)])
    )


def _harmonics(x: np.ndarray) -> np.ndarray:
    orders = np.arange(1, HARMONICS + 1)[:, None]
    return np.vstack([np.ones_like(x)[None], np.cos(orders * x), np.sin(orders * x)])


def _tested(
    null: Null,
    key: Key,
    basis: Basis,
    responses: np.ndarray,
    apart: Apart,
    white: np.ndarray,
    spread: Spread,
) -> FreeForm:
    index, variable, speed = key
    frame = _frame(responses)
    rest, _ = apart(frame @ responses)
    # In directions of unit response, what is left of one is its sine against the parameters' directions.
    values, vectors = np.linalg.eigh(rest @ rest.T)
    kept = values > GATES.absorbed_share**2
    unit, _ = apart((vectors[:, kept] / np.sqrt(values[kept])).T @ frame @ responses)
    z = unit @ white / spread(unit) if np.any(kept) else np.zeros(0)
    statistic, degrees = float(z @ z), max(int(kept.sum()), 1)
    # The curve at the null's parameters: what they took stays theirs.
    weights = frame.T @ (frame @ responses @ white)
    cov = frame.T @ frame
    units = {v.name: v.unit for v in (*null.flat.unknowns, *null.flat.inputs)}
    return FreeForm(
        load=index,
        place=null.loads[index].place,
        variable=variable,
        sign_of=speed,
        unit=null.loads[index].unit,
        variable_unit=units.get(variable, ""),
        statistic=statistic,
        degrees=degrees,
        p_value=float(chi2.sf(statistic, degrees)),
        x=basis.x,
        w=weights @ basis.shown,
        std=np.sqrt(np.einsum("im,ij,jm->m", basis.shown, cov, basis.shown)),
        over_a_turn=basis.over_a_turn,
    )


def internal_variables(
    null: Null, run: NullObserver, experiment: int = 0, named: Sequence[str] = ()
) -> dict[str, np.ndarray]:
    """Every distinct internal variable along the filtered trajectory, by name (n_samples,), as the model
    without the loads has it: a variable that contains the load would explain the load. What a delay keeps of
    its signal is no quantity that anybody could record, and stands for none."""
    explicit = null.explicit
    one = null.experiments[experiment]
    values = _variables_at(null, one, run.observed[experiment].filtered, one.inputs)
    loads = {load.name for load in null.loads}
    found: dict[str, np.ndarray] = dict(zip(one.input_names, one.inputs.T, strict=True))
    seen = [_normalised(x) for x in found.values()]
    # Of proportional variables the `named` come first, then states, then those without the loads, over which
    # a curve can be fitted, then motions before torques and flows.
    own, loaded = set(explicit.state_names), _with_loads(null, run, experiment, values)
    in_order = sorted(
        zip(explicit.flat.unknowns, values, loaded, strict=True),
        key=lambda one: (one[0].name not in named, one[0].name not in own, one[2], one[0].is_flow),
    )
    for variable, row, _ in in_order:
        if variable.name in loads or is_memory_of_delay(variable.name):
            continue
        if not np.all(np.isfinite(row)) or np.ptp(row) == 0.0:
            continue
        shape = _normalised(row)
        if variable.name in named or all(abs(shape @ other) < 1.0 - GATES.same_course for other in seen):
            found[variable.name] = row
            seen.append(shape)
    return found


def _predicted_variables(null: Null, run: NullObserver, number: int) -> dict[str, np.ndarray]:
    """All internal variables and inputs at the end of the interval before every sample, by name."""
    one = null.experiments[number]
    held = np.vstack([one.inputs[:1], interval_ends(one.inputs, null.hold, one.input_names)])
    values = _variables_at(null, one, run.observed[number].predicted, held)
    names = null.explicit.flat.unknown_names
    return dict(zip(names, values, strict=True)) | dict(zip(one.input_names, held.T, strict=True))


def _variables_at(null: Null, one: Experiment, states: np.ndarray, inputs: np.ndarray) -> np.ndarray:
    """All internal variables (n, n_samples) without the loads."""
    loads = {load.name for load in null.loads}
    unloaded = states * [name not in loads for name in null.explicit.state_names]
    moved = replace(one, inputs=inputs)
    return variables_along(null.explicit, null.theta, moved, null.hold, unloaded).T


def _with_loads(null: Null, run: NullObserver, number: int, values: np.ndarray) -> list[bool]:
    """Which internal variables contain loads, as the rate of a store does, given the `values` (n, n_samples)
    of all without them along the filtered trajectory."""
    one, states = null.experiments[number], run.observed[number].filtered
    with_loads = variables_along(null.explicit, null.theta, one, null.hold, states).T
    sizes = np.max(np.abs(values), axis=1) + np.max(np.abs(with_loads), axis=1)
    return [bool(x) for x in np.max(np.abs(with_loads - values), axis=1) > SAME * sizes]


def _normalised(x: np.ndarray) -> np.ndarray:
    centred = x - x.mean()
    size = np.linalg.norm(centred)
    return centred / size if size > 0.0 else centred
