"""Which effect an FMU without equations lacks, as far as that shows from outside.

Nothing can be put between the parts of a black box. What can be tried: a force, torque, voltage or flow at
one of its inputs that follows a law of one of its states or a recorded column, and what a sensor may do to an
output. The null hypothesis is the refitted model with a residual of any colour (an autoregression); every
candidate is scored on the whitened residual after the responses of parameters and initial states are
projected out, and the search over all of them is paid for. A slow effect looks like colour: what would
explain much of the residual as it is counts, too. The best are refitted and tried on validation data. A law
that leaves more than a tenth of what could be foreseen of the residual is refused: from outside, what acts
between the parts looks a little like many laws.
"""

from __future__ import annotations

import contextlib
import time as clock
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from daest.diagnosis.compare import compare_models
from daest.diagnosis.trial import Candidate
from daest.errors import EstimationError, NumericalError
from daest.estimation.fitted import fitted_model
from daest.estimation.identify import identify
from daest.fmu.binary_form import BinaryForm
from daest.fmu.drive import Drive
from daest.fmu.laws import LAWS, Law
from daest.model.experiment import Experiment
from daest.model.fit import FitResult, IdentifyOptions
from daest.model.flat import FlatModel
from daest.numerics.distributions import chi2, norm
from daest.systems.affine_dynamics import has_affine_dynamics
from daest.systems.integrate import Hold, IntegrationError, interval_inputs
from daest.systems.reduce import reduce_index

LEVEL = 0.01  # of the whole search
REFITTED = 3  # candidates by their score, and as many by the share of the residual that they would explain
LEAST_SHARE = 0.2  # of the residual, for these
MOST_LEFT = 0.1  # of what can be foreseen of the null's residual, in an effect that is accepted
CERTAIN = 3.0  # standard errors that a size must have
BEHIND = 3.0  # log-likelihood units within which a candidate is as good as the best
LEAST_GAIN = 0.02  # relative, of the validation error, that an effect must bring
MOST_ORDER = 8  # of the autoregression that whitens the residual
ABSORBED = 1e-6  # share of a response that parameters leave over, below which they do all that it does
SIGN_WIDTH = 0.02  # of the largest value of a state: the width of Coulomb friction
SHARES = (1.0, 0.3, 0.0)  # of the size that one step from the null gives, where a refit starts
STEP = 1e-3  # size of an effect against that of its input, when its response is computed
MOST_STATES = 12  # whose laws are tried
WHITE_LAGS = 20
POWER = 1.28  # standard deviations beyond the limit, at which an effect is seen in 90 of 100 recordings
MOST_EVALUATIONS = 15  # of a refit
STATE_LAWS = {
    "sign": "CoulombFriction",
    "linear": "ViscousFriction",
    "square": "QuadraticDrag",
    "cube": "HardeningSpring",
}
# Of the input itself; their sizes are half a width, and what is cut off the largest value.
INPUT_LAWS = {"dead zone": "DeadZone", "saturation": "Saturation"}
CUT = 0.2  # of the largest value: the saturation that a response is computed for


@dataclass(frozen=True)
class Trial:
    """One effect at an input or output. `law` is a law of `fmu.laws` of the state `variable`; `column` a
    recorded signal that is added to the input; `sensor` what happens to an output."""

    effect: str
    at: str
    number: int
    law: str = ""
    variable: str = ""
    column: str = ""
    sensor: str = ""
    shape: tuple[float, ...] = ()
    unit: str = ""

    @property
    def label(self) -> str:
        return f"{self.effect} at {self.at}" + (f" ({self.variable or self.column})" if self.reads else "")

    @property
    def reads(self) -> bool:
        return bool(self.variable or self.column)


@dataclass(frozen=True)
class Case:
    """The FMU at fitted values with its recordings: `columns` are recorded signals that are no inputs,
    `sizes` (n_x,) the largest values of the states."""

    flat: FlatModel
    form: BinaryForm
    hold: Hold
    experiments: tuple[Experiment, ...]
    names: tuple[str, ...]
    theta: np.ndarray
    starts: tuple[np.ndarray, ...]
    columns: tuple[str, ...]
    sizes: np.ndarray


def diagnose_black_box(
    flat: FlatModel,
    estimation: Sequence[Experiment],
    validation: Sequence[Experiment],
    hold: Hold | None = None,
    seed: int = 0,
) -> dict[str, Any]:
    """The document of `daest diagnose` for an FMU. EstimationError `diagnose-gaps` for missing samples."""
    began = clock.perf_counter()
    form = flat.given
    assert isinstance(form, BinaryForm)
    _refuse_gaps([*estimation, *validation])
    quiet = replace(flat, noises=(), w=type(flat.w)(0, 1))
    baseline = identify(quiet, estimation, IdentifyOptions(method="oe", hold=hold, seed=seed), validation)
    case = _case(quiet, form, baseline, tuple(estimation))
    residuals, slopes = _residuals(case), _parameter_slopes(case)
    trials = candidates(case)
    responses = [_response(case, trial) for trial in trials]
    screened = _screen(trials, responses, residuals, slopes)
    tried = _case(quiet, form, baseline, tuple(validation))
    proofs = _proofs(case, tried, _worth_a_refit(screened), residuals, len(trials))
    verdict, message, experiment = _verdict(
        proofs, lambda: _is_white(residuals) or _is_noise_of(flat, baseline, estimation)
    )
    return {
        "verdict": verdict,
        "message": f"{message} {_limits_of_the_box(case)}",
        "baseline": {
            "fit_percent": {k: dict(a.fit_percent) for k, a in baseline.simulated.items()},
            "rms": {k: dict(a.rms) for k, a in baseline.simulated.items()},
        },
        "candidates": proofs,
        "screen": {
            "p_value": min((s["p_value"] for s in screened), default=1.0),
            "n_screened": len(screened),
            "best": [{k: v for k, v in s.items() if k not in ("trial", "absorbed")} for s in screened[:20]],
            "skipped": [],
        },
        "places": [],
        "disturbance": None,
        "next_experiment": experiment,
        "seconds": clock.perf_counter() - began,
    }


def _worth_a_refit(screened: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The best by score if any is significant, since one step from the null ranks like laws badly; and those
    that would explain most of the residual as it is, which a filter for its colour would take for colour."""
    found = [s for s in screened if not s["absorbed"]]
    by_score = found[:REFITTED] if found and found[0]["p_value"] < LEVEL else []
    by_share = sorted((s for s in found if s["share"] >= LEAST_SHARE), key=lambda s: -s["share"])[:REFITTED]
    return [*by_score, *(s for s in by_share if not any(s is other for other in by_score))]


def _is_noise_of(flat: FlatModel, baseline: FitResult, estimation: Sequence[Experiment]) -> bool:
    """Whether white noise where the model declares it, fitted by maximum likelihood, leaves nothing that the
    tests of a comparison find in the same data. Asked of linear models, where it is exact."""
    if not flat.noises or not has_affine_dynamics(reduce_index(flat)):
        return False
    try:
        fit = identify(flat, estimation, IdentifyOptions(method="pem", hold=baseline.hold))
        return compare_models([_with_its_fit(flat, fit)], estimation).models[0].verdict == "not falsified"
    except NumericalError:
        return False


def _with_its_fit(flat: FlatModel, fit: FitResult) -> Candidate:
    """The fitted model, with what its tests must know of the parameters."""
    known = {p.name: p.std_error for p in fit.parameters if p.std_error and p.name in fit.correlation_names}
    rows = [fit.correlation_names.index(name) for name in known]
    stds = np.array(list(known.values()))
    return Candidate(
        flat.name, fitted_model(flat, fit), len(fit.parameters), fit.hold, fit.noise_model,
        parameter_names=tuple(known),
        parameter_cov=fit.correlation[np.ix_(rows, rows)] * np.outer(stds, stds) if known else None,
        n_estimation=fit.n_samples,
    )  # fmt: skip


def _refuse_gaps(experiments: Sequence[Experiment]) -> None:
    for experiment in experiments:
        if not np.all(np.isfinite(experiment.outputs)):
            raise EstimationError(
                "diagnose-gaps",
                f"{experiment.name} has missing samples, and the residual of a black box is whitened in time",
                remedy="choose a part without gaps (--from, --to), or resample it",
            )


def _case(
    flat: FlatModel, form: BinaryForm, baseline: FitResult, experiments: tuple[Experiment, ...]
) -> Case:
    theta = np.array([baseline.theta[p.name] for p in flat.parameters])
    fitted = {s.experiment: s.values for s in baseline.initial_states}
    starts = []
    for e in experiments:
        u = np.zeros(len(form.form.drivers))
        u[: e.inputs.shape[1]] = e.inputs[0]
        known = fitted.get(e.name)
        starts.append(form.start(flat, theta, u, float(e.time[0]), {}) if known is None else known)
    case = Case(
        flat,
        form,
        baseline.hold,
        experiments,
        tuple(p.name for p in baseline.parameters),
        theta,
        tuple(starts),
        tuple(
            c
            for c in experiments[0].extra
            if all(np.all(np.isfinite(e.extra.get(c, np.nan))) for e in experiments)
        ),
        np.ones(len(form.form.states)),
    )
    runs = [_course(case, i).states for i in range(len(experiments))]
    case = replace(case, sizes=np.max([np.max(np.abs(x), axis=0) for x in runs], axis=0))
    return case if all(e.name in fitted for e in experiments) else _with_fitted_starts(case)


def candidates(case: Case) -> list[Trial]:
    """Every law at every input, and every fault of a sensor at every output."""
    states = case.flat.unknowns[: len(case.form.form.states)][:MOST_STATES]
    trials = []
    for number, u in enumerate(case.flat.inputs):
        trials.append(Trial("ConstantLoad", u.name, number, "constant", unit=u.unit))
        for state, size in zip(states, case.sizes, strict=False):
            if size <= 0.0 or not np.isfinite(size):
                continue
            for law, effect in STATE_LAWS.items():
                shape = (SIGN_WIDTH * float(size),) if law == "sign" else ()
                trials.append(Trial(effect, u.name, number, law, state.name, shape=shape))
            if state.unit == "rad":
                trials.append(Trial("Gravity", u.name, number, "sine", state.name, shape=(1.0, 0.0)))
        largest = max(float(np.max(np.abs(e.inputs[:, number]))) for e in case.experiments)
        for law, effect in INPUT_LAWS.items():
            trials.append(Trial(effect, u.name, number, law, shape=(largest,), unit=u.unit))
        for column in case.columns:
            trials.append(Trial("MeasuredInput", u.name, number, "recorded", column=column))
    for number, y in enumerate(case.flat.outputs):
        for sensor, effect in (("offset", "Offset"), ("drift", "Drift"), ("gain", "Gain"), ("lag", "Lag")):
            trials.append(Trial(effect, y.name, number, sensor=sensor, unit=y.unit))
    return trials


# ------------------------------------------------------------------------------------------ simulation


@dataclass(frozen=True)
class _Course:
    """A simulation of one recording: outputs (n, n_y), states (n, n_x), slopes (n, n_y, d) of the outputs by
    the parameters of the case, the size of the trial if there is one, and the initial states."""

    outputs: np.ndarray
    states: np.ndarray
    slopes: np.ndarray


def _course(
    case: Case, i: int, trial: Trial | None = None, size: float = 0.0, slopes: bool = False
) -> _Course:
    """Recording i with `size` of the trial. Raises IntegrationError."""
    form, n_x = case.form, case.starts[i].size
    laws = () if trial is None or not trial.law else (_law(case, trial, size),)
    read = tuple((*form.form.states, *form.form.variables)[row] for row in form.output_rows(case.flat))
    request = replace(_request(case, case.experiments[i]), read=read, laws=laws)
    steps = np.array([_size_step(case, trial)]) if laws and trial is not None else np.zeros(0)
    scale = np.maximum(np.abs(case.starts[i]), 1.0)
    states, outputs, found = form.integrate_with_laws(
        case.flat, case.names, request, case.theta, case.starts[i], scale, steps if slopes else None
    )
    if trial is None or not trial.sensor:
        return _Course(outputs, states, found)
    time = case.experiments[i].time
    sensed = outputs + size * _fault(outputs, time, trial)
    if slopes:
        by_size = _fault(outputs, time, trial)[:, :, None]
        constant = _fault(np.zeros_like(outputs), time, trial)
        faults = [_fault(found[:, :, d], time, trial) - constant for d in range(found.shape[2])]
        found = found + size * np.stack(faults, axis=2)
        at = found.shape[2] - n_x
        found = np.concatenate([found[:, :, :at], by_size, found[:, :, at:]], axis=2)
    return _Course(sensed, states, found)


def _request(case: Case, e: Experiment) -> Drive:
    """What drives a recording: inputs, and the recorded columns that are none behind them."""
    u0, u1 = interval_inputs(case.form.explicit(case.flat), e.time, e.inputs, case.hold)
    last = np.hstack([e.inputs[-1], u1[-1, e.inputs.shape[1] :]])
    columns = np.column_stack([e.extra[name] for name in case.columns] or [np.zeros((e.time.size, 0))])
    ends = columns[:-1] if case.hold == "zoh" else columns[1:]
    return case.form.drive(
        e.time, np.hstack([u0, columns[:-1]]), np.hstack([u1, ends]), np.hstack([last, columns[-1]]), ()
    )


def _fault(y: np.ndarray, time: np.ndarray, trial: Trial) -> np.ndarray:
    """What a unit of the fault of a sensor adds to the outputs (n, n_y)."""
    own = y[:, trial.number]
    faults = {
        "offset": np.ones_like(own),
        "drift": time - time[0],
        "gain": own,
        "lag": -np.gradient(own, time),
    }
    added = np.zeros_like(y)
    added[:, trial.number] = faults[trial.sensor]
    return added


def _law(case: Case, trial: Trial, size: float) -> Law:
    if trial.column:
        column = len(case.form.form.inputs) + case.columns.index(trial.column)
        return Law(trial.law, trial.number, (), (), size, column)
    if trial.law in INPUT_LAWS:
        return Law(trial.law, trial.number, (), trial.shape, size, trial.number)
    names = [v.name for v in case.flat.unknowns]
    reads = (case.form.form.states[names.index(trial.variable)],) if trial.variable else ()
    return Law(trial.law, trial.number, reads, trial.shape, size)


def _residuals(case: Case, trial: Trial | None = None, size: float = 0.0) -> list[np.ndarray]:
    return [e.outputs - _course(case, i, trial, size).outputs for i, e in enumerate(case.experiments)]


def _parameter_slopes(case: Case) -> list[np.ndarray]:
    """∂ŷ/∂(parameters, initial states of all recordings), (d, n, n_y) per recording."""
    p, n_x = len(case.names), case.starts[0].size
    tables = []
    for i in range(len(case.experiments)):
        own = _course(case, i, slopes=True).slopes.transpose(2, 0, 1)
        table = np.zeros((p + n_x * len(case.experiments), *own.shape[1:]))
        table[:p] = own[:p]
        table[p + i * n_x : p + (i + 1) * n_x] = own[p:]
        tables.append(table)
    return tables


def _response(case: Case, trial: Trial) -> list[np.ndarray]:
    """∂ŷ/∂size per recording at size 0, (n, n_y); of a saturation, which has none there, a difference."""
    alone = replace(case, names=())
    tables = []
    for i, e in enumerate(case.experiments):
        try:
            if trial.law == "saturation":
                cut = CUT * trial.shape[0]
                found = _course(alone, i, trial, cut).outputs - _course(alone, i).outputs
                tables.append(found / (cut or 1.0))
                continue
            tables.append(_course(alone, i, trial, slopes=True).slopes[:, :, 0])
        except IntegrationError:
            tables.append(np.zeros(e.outputs.shape))
    return tables


def _size_step(case: Case, trial: Trial) -> float:
    """A size at which the effect is small against its input or output."""
    if trial.sensor:
        return STEP
    spread = max(float(np.std(e.inputs[:, trial.number])) for e in case.experiments)
    spread = spread or max(float(np.max(np.abs(e.inputs[:, trial.number]))) for e in case.experiments) or 1.0
    if trial.column:
        largest = max(float(np.max(np.abs(e.extra[trial.column]))) for e in case.experiments)
    elif trial.variable:
        names = [v.name for v in case.flat.unknowns]
        v = case.sizes[names.index(trial.variable)]
        largest = abs(float(LAWS[trial.law](np.array([v]), np.array(trial.shape))))
    else:
        largest = 1.0
    return STEP * spread / (largest or 1.0)


# ---------------------------------------------------------------------------------------------- screen


def _autoregression(residuals: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Coefficients of the whitening filter of every output, order by BIC."""
    filters = []
    for j in range(residuals[0].shape[1]):
        best: tuple[float, np.ndarray] | None = None
        for order in range(MOST_ORDER + 1):
            rows = [_lagged(e[:, j], order) for e in residuals if e.shape[0] > 4 * MOST_ORDER]
            if not rows:
                break
            X, y = np.vstack([r[0] for r in rows]), np.concatenate([r[1] for r in rows])
            a = np.linalg.lstsq(X, y, rcond=None)[0] if order else np.zeros(0)
            variance = float(np.mean((y - X @ a) ** 2)) + np.finfo(float).tiny
            bic = y.size * np.log(variance) + order * np.log(y.size)
            if best is None or bic < best[0]:
                best = (bic, np.concatenate([[1.0], -a]))
        filters.append(np.ones(1) if best is None else best[1])
    return filters


def _lagged(e: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the last `order` values before each sample from MOST_ORDER on, and these samples."""
    columns = [e[MOST_ORDER - k : e.size - k] for k in range(1, order + 1)]
    X = np.column_stack(columns) if columns else np.zeros((e.size - MOST_ORDER, 0))
    return X, e[MOST_ORDER:]


def _white(tables: Sequence[np.ndarray], filters: Sequence[np.ndarray]) -> np.ndarray:
    """All recordings and outputs whitened, one after the other, (m,)."""
    parts = []
    for table in tables:
        for j, taps in enumerate(filters):
            parts.append(np.convolve(table[:, j], taps)[: table.shape[0]][MOST_ORDER:])
    return np.concatenate(parts)


def _screen(
    trials: Sequence[Trial], responses: Sequence[list[np.ndarray]],
    residuals: Sequence[np.ndarray], slopes: Sequence[np.ndarray],
) -> list[dict[str, Any]]:  # fmt: skip
    """Scores of all trials on the whitened residual, best first, p-values corrected for the search; and the
    share of the residual, as it is, that one step from the null would explain."""
    filters = _autoregression(residuals)
    spreads = _spreads(residuals, filters)
    weights = _weights(residuals, spreads)
    e = _white(residuals, filters) * weights
    base = np.array([_white([t[k] for t in slopes], filters) * weights for k in range(slopes[0].shape[0])])
    basis = _orthonormal(base)
    left = e - basis @ (basis.T @ e)
    shares = _shares(responses, residuals, slopes, spreads)
    seen_from = float(norm.isf(LEVEL / 2 / len(trials))) + POWER
    entries = []
    for trial, response, share in zip(trials, responses, shares, strict=True):
        s = _white(response, filters) * weights
        own = s - basis @ (basis.T @ s)
        size, whole = float(np.linalg.norm(own)), float(np.linalg.norm(s))
        absorbed = not np.isfinite(size) or size**2 <= ABSORBED * whole**2 or size == 0.0
        score = 0.0 if absorbed else float(own @ left) / size
        p = min(1.0, len(trials) * 2 * float(norm.sf(abs(score))))
        entries.append(
            {
                "effect": trial.effect, "at": _at(trial), "score": abs(score), "p_value": p,
                "sizes": {"size": 0.0 if absorbed else score / size},
                "detectable": None if absorbed else seen_from / size,
                "share": share, "unit": trial.unit, "trial": trial, "absorbed": absorbed,
            }
        )  # fmt: skip
    return sorted(entries, key=lambda s: -s["score"])


def _shares(
    responses: Sequence[list[np.ndarray]], residuals: Sequence[np.ndarray], slopes: Sequence[np.ndarray],
    spreads: np.ndarray,
) -> list[float]:  # fmt: skip
    """Shares of the squared residual, in units of `spreads`, that responses explain beyond the parameters."""

    def row(tables: Sequence[np.ndarray]) -> np.ndarray:
        return np.concatenate([(table / spreads).ravel() for table in tables])

    basis = _orthonormal(np.array([row([t[k] for t in slopes]) for k in range(slopes[0].shape[0])]))
    e = row(residuals)
    left = e - basis @ (basis.T @ e)
    found = []
    for response in responses:
        own = row(response)
        own = own - basis @ (basis.T @ own)
        sizes = float(own @ own) * float(left @ left)
        found.append(float(own @ left) ** 2 / sizes if np.isfinite(sizes) and sizes > 0 else 0.0)
    return found


def _at(trial: Trial) -> str:
    return f"{trial.at} ({trial.variable or trial.column})" if trial.reads else trial.at


def _spreads(residuals: Sequence[np.ndarray], filters: Sequence[np.ndarray]) -> np.ndarray:
    """Standard deviations of the whitened residual of every output, (n_y,)."""
    found = [
        np.std(np.concatenate([np.convolve(e[:, j], taps)[: e.shape[0]][MOST_ORDER:] for e in residuals]))
        for j, taps in enumerate(filters)
    ]
    return np.array([s or 1.0 for s in found])


def _weights(residuals: Sequence[np.ndarray], spreads: np.ndarray) -> np.ndarray:
    """1 / standard deviation of the whitened residual of every output, in the order of `_white`."""
    parts = [np.full(e.shape[0] - MOST_ORDER, 1.0 / s) for e in residuals for s in spreads]
    return np.concatenate(parts)


def _orthonormal(rows: np.ndarray) -> np.ndarray:
    """Columns that span the rows (d, m); directions below 1e-9 of the largest are none."""
    sizes = np.linalg.norm(rows, axis=1)
    kept = rows[(sizes > 0) & np.isfinite(sizes)]
    if not kept.size:
        return np.zeros((rows.shape[1], 0))
    u, s, _ = np.linalg.svd((kept / np.linalg.norm(kept, axis=1)[:, None]).T, full_matrices=False)
    return u[:, s > 1e-9 * s[0]]


# ----------------------------------------------------------------------------------------------- proof


def _proofs(
    case: Case, validation: Case, entries: Sequence[dict[str, Any]], residuals: Sequence[np.ndarray],
    n_trials: int,
) -> list[dict[str, Any]]:  # fmt: skip
    """Of all entries; an effect that the FMU cannot be simulated with is none."""
    found: list[dict[str, Any]] = []
    if entries:
        with contextlib.suppress(IntegrationError):
            without = _rms(_with_fitted_starts(validation))
            for entry in entries:
                with contextlib.suppress(IntegrationError):
                    found.append(_proof(case, validation, without, entry, residuals, n_trials))
    return found


def _proof(
    case: Case, validation: Case, without: Sequence[float], entry: dict[str, Any],
    residuals: Sequence[np.ndarray], n_trials: int,
) -> dict[str, Any]:  # fmt: skip
    """The effect put at its place and refitted with all parameters, and tried on validation data, whose rms
    errors are those `without` it so far."""
    trial: Trial = entry["trial"]
    fitted, size, std_error, errors = _refitted(case, trial, entry["sizes"]["size"])
    gain = _log_likelihood(errors) - _log_likelihood(residuals)
    n = sum(e.size for e in errors)
    tried = _with_fitted_starts(replace(validation, theta=fitted.theta), trial, size)
    with_effect = _rms(tried, trial, size)
    better = float(np.mean([1 - a / b for a, b in zip(with_effect, without, strict=True) if b > 0]))
    names = [o.name for o in case.flat.outputs]
    left = [float(r) for r in np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0))]
    share = _foreseen(errors, residuals) / (_foreseen(residuals, errors) or 1.0)
    reason = ""
    if 2 * gain <= np.log(n) + 2 * np.log(n_trials):
        reason = "it gains no more likelihood than chance would in such a search"
    elif std_error is None or abs(size) < CERTAIN * std_error:
        reason = "its size cannot be told from zero"
    elif better <= LEAST_GAIN:
        reason = "it does not lower the error on validation data"
    elif share > MOST_LEFT:
        reason = f"it leaves {share:.0%} of what can be foreseen of the residual, more than {MOST_LEFT:.0%}"
    return {
        "effect": trial.effect, "class": "", "at": _at(trial), "equivalent_places": [], "inputs": {},
        "parameters": {"size": {"value": size, "std_error": std_error, "unit": trial.unit or ""}},
        "model_parameters": {
            name: {"value": float(fitted.theta[[p.name for p in case.flat.parameters].index(name)]),
                   "std_error": None, "unit": ""} for name in case.names
        },
        "fit_percent": {},
        "rms": {
            "estimation": dict(zip(names, left, strict=True)),
            "validation": dict(zip(names, with_effect, strict=True)),
        },
        "delta_log_likelihood": gain, "delta_bic": 2 * gain - float(np.log(n)), "p_value": entry["p_value"],
        "explained": max(0.0, better),
        "verdict": "rejected" if reason else "supported",
        "reason": reason,
        "not_separable_from": [], "model": None,
        "model_reason": "an FMU cannot be extended from outside; the law is told above",
    }  # fmt: skip


def _foreseen(errors: Sequence[np.ndarray], others: Sequence[np.ndarray]) -> float:
    """How much of the residual could be foreseen from its own past: its mean square beyond that of the
    innovations, in units of the latter, over all outputs. As innovations counts the smaller of both."""
    floors = [_spreads(some, _autoregression(some)) ** 2 for some in (errors, others)]
    squares = np.mean(np.concatenate(errors) ** 2, axis=0)
    return float(np.sum(np.maximum(squares / np.minimum(*floors) - 1.0, 0.0)))


def _refitted(case: Case, trial: Trial, size: float) -> tuple[Case, float, float | None, list[np.ndarray]]:
    """Parameters, initial states and size together by least squares weighted with the residual's spread."""
    known = [p.name for p in case.flat.parameters]
    columns = [known.index(name) for name in case.names]
    n_p, n_x = len(columns), case.starts[0].size
    starts = [
        np.maximum(np.abs(x), 1e-3 * max(1.0, float(np.max(np.abs(x), initial=0.0)))) for x in case.starts
    ]
    sizes = [abs(float(case.theta[c])) or 1.0 for c in columns]
    scales = np.concatenate([sizes, [abs(size) or _size_step(case, trial)], *starts])
    spread = np.std(np.concatenate(_residuals(case)), axis=0)
    spread = np.where(spread > 0, spread, 1.0)

    def at(z: np.ndarray) -> tuple[Case, float]:
        values = z * scales
        theta = case.theta.copy()
        theta[columns] = values[:n_p]
        x0 = tuple(np.split(values[n_p + 1 :], len(case.experiments)))
        return replace(case, theta=theta, starts=x0), float(values[n_p])

    def errors(z: np.ndarray) -> np.ndarray:
        moved, own = at(z)
        try:
            found = _residuals(moved, trial, own)
        except IntegrationError:
            found = [np.full(e.outputs.shape, 1e3 * np.max(np.abs(e.outputs))) for e in case.experiments]
        return np.concatenate([(e / spread).ravel() for e in found])

    def jacobian(z: np.ndarray) -> np.ndarray:
        moved, own = at(z)
        blocks = []
        for i in range(len(case.experiments)):
            slopes = _course(moved, i, trial, own, slopes=True).slopes / spread[None, :, None]
            block = np.zeros((slopes.shape[0] * slopes.shape[1], z.size))
            first = n_p + 1 + i * n_x
            block[:, : n_p + 1] = slopes[:, :, : n_p + 1].reshape(len(block), -1)
            block[:, first : first + n_x] = slopes[:, :, n_p + 1 :].reshape(len(block), -1)
            blocks.append(-block * scales)
        return np.vstack(blocks)

    # One step from the null may be far off, and even unstable: a part of it, or none, is the better start.
    sizes_at = [share * size for share in SHARES]
    if trial.law == "saturation":
        sizes_at = [share * trial.shape[0] for share in (0.5 * CUT, CUT, 2.0 * CUT)]
    starts_at = [np.concatenate([case.theta[columns], [at], *case.starts]) for at in sizes_at]
    z0 = min((z / scales for z in starts_at), key=lambda z: float(np.sum(errors(z) ** 2)))
    bounds = np.full((2, z0.size), np.inf) * np.array([[-1.0], [1.0]])
    for k, c in enumerate(columns):
        low, high = case.flat.parameters[c].min, case.flat.parameters[c].max
        bounds[0, k] = -np.inf if low is None else low / scales[k]
        bounds[1, k] = np.inf if high is None else high / scales[k]
    # The solver needs room between the start and a bound.
    room = 1e-6 * np.where(np.isfinite(bounds), np.abs(bounds) + 1.0, 0.0)
    z0 = np.clip(z0, bounds[0] + room[0], bounds[1] - room[1])
    found = least_squares(errors, z0, jacobian, bounds=tuple(bounds), max_nfev=MOST_EVALUATIONS)
    fitted, size = at(found.x)
    cov = np.linalg.pinv(found.jac.T @ found.jac) * 2 * found.cost / max(found.fun.size - z0.size, 1)
    std_error = float(np.sqrt(max(cov[n_p, n_p], 0.0)) * scales[n_p])
    return fitted, size, std_error, _residuals(fitted, trial, size)


def _with_fitted_starts(case: Case, trial: Trial | None = None, size: float = 0.0) -> Case:
    """The initial states that fit every recording best, parameters held."""
    if not case.starts or not case.starts[0].size:
        return case
    alone = replace(case, names=())
    starts = []
    for i, e in enumerate(case.experiments):
        n_x, spread = case.starts[i].size, np.std(e.outputs, axis=0)
        spread = np.where(spread > 0, spread, 1.0)

        def at(x0: np.ndarray, i: int = i) -> Case:
            moved = list(alone.starts)
            moved[i] = x0
            return replace(alone, starts=tuple(moved))

        def errors(
            x0: np.ndarray, i: int = i, e: Experiment = e, at: Any = at, spread: np.ndarray = spread
        ) -> np.ndarray:
            return ((e.outputs - _course(at(x0), i, trial, size).outputs) / spread).ravel()

        def jacobian(
            x0: np.ndarray, i: int = i, at: Any = at, n_x: int = n_x, spread: np.ndarray = spread
        ) -> np.ndarray:
            slopes = _course(at(x0), i, trial, size, slopes=True).slopes[:, :, -n_x:]
            return -(slopes / spread[None, :, None]).reshape(-1, n_x)

        # No trust region around a start that knows nothing of this recording.
        found = least_squares(errors, case.starts[i], jacobian, method="lm", x_scale="jac", max_nfev=30)
        starts.append(found.x)
    return replace(case, starts=tuple(starts))


def _rms(case: Case, trial: Trial | None = None, size: float = 0.0) -> list[float]:
    errors = np.concatenate(_residuals(case, trial, size))
    return [float(r) for r in np.sqrt(np.mean(errors**2, axis=0))]


def _log_likelihood(errors: Sequence[np.ndarray]) -> float:
    """Gaussian, of the innovations of the autoregression of the errors, up to a constant."""
    total = 0.0
    for j, taps in enumerate(_autoregression(errors)):
        white = np.concatenate([np.convolve(e[:, j], taps)[: e.shape[0]][MOST_ORDER:] for e in errors])
        total -= 0.5 * white.size * np.log(np.mean(white**2) + np.finfo(float).tiny)
    return float(total)


# --------------------------------------------------------------------------------------------- verdict


def _verdict(proofs: list[dict[str, Any]], is_explained: Callable[[], bool]) -> tuple[str, str, str]:
    """Verdict, message and what to record next. `is_explained`, asked where no effect is supported: the
    residual is white, or that of declared noise."""
    proofs.sort(key=lambda p: -p["delta_log_likelihood"])
    supported = [p for p in proofs if p["verdict"] == "supported"]
    if supported:
        best = supported[0]
        close = []
        for other in supported[1:]:
            behind = best["delta_log_likelihood"] - other["delta_log_likelihood"]
            if behind < BEHIND:
                close.append(other)
            else:
                other["verdict"] = "rejected"
                other["reason"] = f"{_name(best)} explains more: {behind:.1f} log-likelihood units"
        size = best["parameters"]["size"]
        text = f"{_name(best)}, size {size['value']:.4g} ± {size['std_error']:.2g}"
        if not close:
            return "supported", f"{text}: the data ask for it, and it predicts better.", ""
        for p in (best, *close):
            p["verdict"] = "not separable"
            p["not_separable_from"] = [_name(q) for q in (best, *close) if q is not p]
        return (
            "cannot tell",
            f"{text}, or {', '.join(map(_name, close))}: the data cannot tell them apart.",
            "excite the inputs at other amplitudes and speeds, where these laws differ",
        )
    if is_explained():
        return (
            "nothing missing",
            "What the refitted FMU leaves is white, or what its own white noise would leave, and no effect "
            "fits it.",
            "",
        )
    return (
        "external disturbance",
        "The residual is coloured, and no law that can be tried from outside explains it: a load from "
        "outside, or something inside the FMU.",
        "measure what may act on the plant, and add the column to the recording",
    )


def _name(proof: dict[str, Any]) -> str:
    return f"{proof['effect']} at {proof['at']}"


def _is_white(residuals: Sequence[np.ndarray]) -> bool:
    """Ljung-Box of every output, all together at LEVEL."""
    p_values = []
    for j in range(residuals[0].shape[1]):
        statistic, lags = 0.0, 0
        for e in residuals:
            x, n = e[:, j] - e[:, j].mean(), e.shape[0]
            power = float(x @ x)
            if n <= 2 * WHITE_LAGS or power == 0.0:
                continue
            r = np.array([x[k:] @ x[:-k] for k in range(1, WHITE_LAGS + 1)]) / power
            statistic += n * (n + 2) * float(np.sum(r**2 / (n - np.arange(1, WHITE_LAGS + 1))))
            lags += WHITE_LAGS
        p_values.append(float(chi2.sf(statistic, lags)) if lags else 1.0)
    return min(p_values) >= LEVEL / len(p_values)


def _limits_of_the_box(case: Case) -> str:
    inputs = ", ".join(v.name for v in case.flat.inputs) or "none"
    outputs = ", ".join(o.name for o in case.flat.outputs)
    return (
        f"(A black box: what acts together with the inputs {inputs}, as a law of a state or a recorded "
        f"column, and faults of the sensors of {outputs} could be tried; nothing between its parts.)"
    )
