"""ARX models, continuous-time transfer functions from data, and start values by matching them: report
(9)-(11).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from daest.estimation.fitting.coordinates import Unknowns
from daest.estimation.fitting.records import Record
from daest.estimation.fitting.search import Evaluation, minimise
from daest.estimation.gates import FIT
from daest.estimation.linear.linear_predictors import Problem
from daest.model.linear import StateSpace, StateSpaceFamily
from daest.numerics.exponential import transition_integrals
from daest.numerics.recursions import linear_recursion
from daest.numerics.riccati import unobservable_subspace
from daest.systems.linear.state_space import state_space, state_space_derivatives

LONG_ORDER = 40  # of the ARX model whose frequency response stands for the data
SAMPLES_PER_COEFFICIENT = 8
FREQUENCIES = 80  # logarithmic, from LOWEST_CYCLES per record to HIGHEST_SHARE of the Nyquist frequency
LOWEST_CYCLES = 3.0
HIGHEST_SHARE = 0.8
REFINEMENTS = 30  # passes of the instrumental-variable refinement
MATCH_WEIGHT = 1e4  # of the relative squared mismatch, so that the search stops at 1e-5 of it
MATCH_STARTS = 20
SHORT_MATCH = 8  # iterations from every start; the best MATCH_FINALISTS then go on
MATCH_FINALISTS = 3
MATCH_SPREAD = np.log(10.0)
MATCH_ITERATIONS = 40


@dataclass(frozen=True)
class LongArx:
    """y[k] = Σ a_i y[k-i] + Σ b_i u[k-i] + constant, order LONG_ORDER or less, one output.

    `a` (order,), `b` (order + 1, n_u); `period` [s]. `fit_percent` is that of its one-step prediction.
    """

    a: np.ndarray
    b: np.ndarray
    period: float
    fit_percent: float

    def response(self, omega: np.ndarray) -> np.ndarray:
        """Frequency response (n_frequencies, n_u) at omega [rad/s]."""
        delays = np.exp(-1j * self.period * np.outer(omega, np.arange(self.b.shape[0])))
        return (delays @ self.b) / (1.0 - delays[:, 1:] @ self.a)[:, None]


def fit_long_arx(record: Record, output: int, order: int | None = None) -> LongArx:
    """Least squares; the order is limited by the number of samples. Missing outputs are bridged by straight
    lines, which is good enough for start values. The record must have a period.
    """
    n_u = record.inputs.shape[1]
    order = order or max(2, min(LONG_ORDER, record.n_samples // (SAMPLES_PER_COEFFICIENT * (1 + n_u))))
    y, u, n_samples = _bridged(record, output), record.inputs, record.n_samples
    columns = [y[order - i : n_samples - i] for i in range(1, order + 1)]
    for i in range(order + 1):
        columns += [u[order - i : n_samples - i, j] for j in range(n_u)]
    table = np.column_stack([*columns, np.ones(n_samples - order)])
    target = y[order:]
    scale = np.linalg.norm(table, axis=0)
    scale[scale == 0.0] = 1.0
    solved = np.linalg.lstsq(table / scale, target, rcond=None)[0] / scale
    b = solved[order : order + n_u * (order + 1)].reshape(order + 1, n_u)
    return LongArx(solved[:order], b, float(record.period or 0.0), _fit(target, table @ solved))


def transfer_function(
    record: Record, output: int, orders: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray, float]:
    """num and den (highest power first, den[0] = 1) from the only input to `output`, as (9) of the report,
    and the percentage that its simulation fits.

    First a fit of `orders` (poles, zeros) to the frequency response of a long ARX model, then the refined
    instrumental-variable method on prefiltered signals (Young & Jakeman), which is free of the bias that
    measurement noise gives a short ARX model.
    """
    omega, weight = _frequencies(record)
    response = fit_long_arx(record, output).response(omega)[:, 0]
    num, den = _rational_fit(omega, response, weight[:, 0], *orders)
    return _refined(record, output, num, den, omega[0])


def matched_start(problem: Problem, seed: int = 0) -> np.ndarray | None:
    """Start point (in z) by matching ARX models of the longest record; None where that is not possible.

    The report's way to k, (10)-(11), for any parameters: the sum over inputs, outputs and frequencies of
    |G(iω, θ) - G_arx(iω)|², weighted by the input's power and relative to each output, is minimised from the
    model's values and from seeded points around them. Cheap: no simulation.
    """
    record = max(problem.records, key=lambda r: r.n_samples)
    if record.period is None or not problem.family.inputs or not problem.unknowns.start.size:
        return None
    proper = record.inputs[:, : len(problem.family.inputs)]  # their derivatives in time follow them
    return _match(problem.family, replace(record, inputs=proper), problem.unknowns, seed)


def physical_orders(ss: StateSpace, output: int) -> tuple[int, int]:
    """Poles and zeros of the transfer function from the first input to `output`, after cancellations."""
    seen, _ = unobservable_subspace(ss.A, ss.C[output : output + 1])
    back = np.linalg.pinv(seen)
    A, B, C = seen @ ss.A @ back, seen @ ss.B[:, :1], ss.C[output : output + 1] @ back
    driven, _ = unobservable_subspace(A.T, B.T)
    poles = driven.shape[0]
    if ss.D[output, 0] != 0.0:
        return poles, poles
    moment, size = B, 1.0
    for degree in range(1, poles + 1):
        if abs((C @ moment).item()) > 1e-9 * size * float(np.linalg.norm(C)):
            return poles, poles - degree
        size = float(np.linalg.norm(moment)) * float(np.linalg.norm(A))
        moment = A @ moment
    return poles, 0


def _bridged(record: Record, output: int) -> np.ndarray:
    """The output with straight lines over missing samples."""
    seen = record.observed[:, output]
    return np.interp(record.time, record.time[seen], record.outputs[seen, output])


def _frequencies(record: Record) -> tuple[np.ndarray, np.ndarray]:
    """ω (n,) [rad/s] and the power of every input around each, (n, n_ū), from its periodogram.

    Each ω is the centre of the power in its cell: an input of few sinusoids says nothing between them.
    """
    period = float(record.period or 0.0)
    lowest = 2 * np.pi * LOWEST_CYCLES / (record.n_samples * period)
    omega = np.geomspace(lowest, HIGHEST_SHARE * np.pi / period, FREQUENCIES)
    window = np.hanning(record.n_samples)[:, None]
    spectrum = np.abs(np.fft.rfft((record.inputs - record.inputs.mean(axis=0)) * window, axis=0)) ** 2
    grid = 2 * np.pi * np.fft.rfftfreq(record.n_samples, period)
    edges = np.concatenate([[omega[0]], np.sqrt(omega[1:] * omega[:-1]), [omega[-1] * 1.01]])
    cell = np.digitize(grid, edges) - 1
    inside = (cell >= 0) & (cell < FREQUENCIES)
    power = np.zeros((FREQUENCIES, record.inputs.shape[1]))
    np.add.at(power, cell[inside], spectrum[inside])
    total, moment = np.zeros(FREQUENCIES), np.zeros(FREQUENCIES)
    np.add.at(total, cell[inside], spectrum[inside].sum(axis=1))
    np.add.at(moment, cell[inside], spectrum[inside].sum(axis=1) * grid[inside])
    omega = np.where(total > 0.0, moment / np.where(total > 0.0, total, 1.0), omega)
    return omega, power / np.maximum(power.sum(axis=0), np.finfo(float).tiny)


def _rational_fit(
    omega: np.ndarray, response: np.ndarray, weight: np.ndarray, poles: int, zeros: int
) -> tuple[np.ndarray, np.ndarray]:
    """Sanathanan-Koerner iteration for num/den of given degrees, in a normalised frequency."""
    unit = float(np.sqrt(omega[0] * omega[-1]))
    s = 1j * omega / unit
    powers = s[:, None] ** np.arange(poles + 1)
    root, den = np.sqrt(weight), np.concatenate([np.zeros(poles), [1.0]])
    num = np.zeros(zeros + 1)
    previous = np.ones(omega.size)
    for _ in range(REFINEMENTS):
        factor = (root / previous)[:, None]
        table = np.hstack([powers[:, : zeros + 1], -response[:, None] * powers[:, :poles]]) * factor
        target = response * powers[:, poles] * factor[:, 0]
        solved = np.linalg.lstsq(
            np.vstack([table.real, table.imag]), np.hstack([target.real, target.imag]), rcond=None
        )
        num, den = solved[0][: zeros + 1], np.concatenate([solved[0][zeros + 1 :], [1.0]])
        previous = np.maximum(np.abs(powers @ den), np.finfo(float).tiny)
    num = num * unit ** (poles - np.arange(zeros + 1))
    den = den * unit ** (poles - np.arange(poles + 1))
    return num[::-1], den[::-1]


def _refined(
    record: Record, output: int, num: np.ndarray, den: np.ndarray, lowest: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Instrumental variables on signals filtered by 1/den, until den settles; the best simulation seen wins.

    Initial conditions and a constant enter as free responses of the filter, so that none has to be known.
    """
    y, seen = record.outputs[:, output], record.observed[:, output]
    poles, zeros = den.size - 1, num.size - 1
    best = (num, den, -np.inf)
    for _ in range(REFINEMENTS):
        den = _stable(den, FIT.slowest_pole * lowest)
        u_filtered, free = _filtered(record.inputs[:, 0], den, float(record.period or 0.0))
        model_y = u_filtered[:, poles - zeros :] @ num
        nuisance = np.linalg.lstsq(free[seen], (y - model_y)[seen], rcond=None)[0]
        fit = _fit(y[seen], (model_y + free @ nuisance)[seen])
        if fit > best[2]:
            best = (num, den, fit)
        y_filtered, _ = _filtered(
            np.where(seen, y, model_y + free @ nuisance), den, float(record.period or 0.0)
        )
        instrument, _ = _filtered(model_y + free @ nuisance, den, float(record.period or 0.0))
        table = np.hstack([-y_filtered[:, 1:], u_filtered[:, poles - zeros :], free])
        instruments = np.hstack([-instrument[:, 1:], u_filtered[:, poles - zeros :], free])
        scale = np.linalg.norm(instruments, axis=0)
        scale[scale == 0.0] = 1.0
        moments = (instruments / scale).T @ np.column_stack([table / scale, y_filtered[:, 0]])
        solved = np.linalg.lstsq(moments[:, :-1], moments[:, -1], rcond=None)[0] / scale
        before, den = den, np.concatenate([[1.0], solved[:poles]])
        num = solved[poles : poles + zeros + 1]
        if not np.all(np.isfinite(solved)) or np.all(
            np.abs(den - before) <= FIT.refined_denominator * np.abs(den)
        ):
            break
    return best


def _filtered(signal: np.ndarray, den: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """(s^n, …, s, 1) / den(s) of a signal with straight lines between samples, (n_samples, n + 1); and
    the free responses of the filter with a constant, (n_samples, n + 1).
    """
    n = den.size - 1
    if not n:
        return signal[:, None], np.ones((signal.size, 1))
    unit = float(np.max(np.abs(np.roots(den)))) or 1.0
    # States s^(n-1) … 1 over den, each scaled by a power of `unit`, so that the matrix has entries of one
    # size.
    A = np.zeros((n, n))
    A[0] = -den[1:] / unit ** np.arange(1, n + 1)
    A[1:, :-1] += np.eye(n - 1)
    integrals = transition_integrals(A * unit, period)
    first, ramp = integrals.first[:, 0] * unit, integrals.second[:, 0] * unit
    drives = np.zeros((n + 1, signal.size - 1, n))
    drives[0] = np.outer(signal[:-1], first - ramp) + np.outer(signal[1:], ramp)
    starts = np.vstack([np.zeros((1, n)), np.eye(n)])
    states = linear_recursion(integrals.transition, drives, starts)
    lower = states[0] / unit ** np.arange(1, n + 1)
    highest = signal - lower @ den[1:]
    free = np.column_stack([states[1:, :, -1].T, np.ones(signal.size)])
    return np.column_stack([highest, lower]), free


def _stable(den: np.ndarray, slowest: float) -> np.ndarray:
    """The polynomial with its roots mirrored into the left half plane, at least `slowest` inside."""
    roots = np.roots(den)
    return np.atleast_1d(np.real(np.poly(-np.maximum(np.abs(roots.real), slowest) + 1j * roots.imag)))


def _match(family: StateSpaceFamily, record: Record, unknowns: Unknowns, seed: int) -> np.ndarray | None:
    omega, weight = _frequencies(record)
    outputs = [j for j in range(len(family.outputs)) if record.n_observed[j] > 4 * LONG_ORDER]
    if not outputs:
        return None
    target = np.stack([_measured_response(family, record, unknowns.theta, j, omega) for j in outputs])
    size = np.sum(weight * np.abs(target) ** 2, axis=(1, 2))
    root = np.sqrt(MATCH_WEIGHT * weight / np.where(size > 0.0, size, 1.0)[:, None, None])
    names = unknowns.parameter_names()

    def objective(z: np.ndarray, with_slopes: bool) -> Evaluation | None:
        theta = unknowns.values(z)[0]
        with np.errstate(all="ignore"):
            ss = state_space(family, theta)
            derivatives = state_space_derivatives(family, theta, names) if with_slopes else None
            response, slopes = _response(ss, derivatives, omega)
        error = (response[outputs] - target) * root
        value = float(np.sum(np.abs(error) ** 2) / 2)
        if not np.isfinite(value):
            return None
        if slopes is None:
            return Evaluation(value)
        jacobian = (slopes[:, outputs] * root).reshape(len(names), -1) * unknowns.slopes(z)[:, None]
        if not np.all(np.isfinite(jacobian)):
            return None
        return Evaluation(
            value, np.real(jacobian.conj() @ error.ravel()), np.real(jacobian.conj() @ jacobian.T)
        )

    rng = np.random.default_rng(seed)
    lower, upper, start = unknowns.lower, unknowns.upper, unknowns.start
    others = start + rng.uniform(-MATCH_SPREAD, MATCH_SPREAD, (MATCH_STARTS, start.size))
    short = [minimise(objective, z, lower, upper, SHORT_MATCH) for z in (start, *others)]
    best = sorted((f for f in short if f is not None), key=lambda f: f.evaluation.value)[:MATCH_FINALISTS]
    ended = [minimise(objective, f.z, lower, upper, MATCH_ITERATIONS) or f for f in best]
    return min(ended, key=lambda f: f.evaluation.value).z if ended else None


def _measured_response(
    family: StateSpaceFamily, record: Record, theta: np.ndarray, output: int, omega: np.ndarray
) -> np.ndarray:
    """Frequency response (n_ω, n_u) that the data show: of the refined transfer function where it
    explains them, else of the long ARX model.
    """
    ss = state_space(family, theta)
    if len(family.inputs) == 1 and not ss.input_derivatives:
        num, den, fit = transfer_function(record, output, physical_orders(ss, output))
        if fit > FIT.good_transfer:
            s = 1j * omega
            return (np.polyval(num, s) / np.polyval(den, s))[:, None]
    return fit_long_arx(record, output).response(omega)


def _response(
    ss: StateSpace, derivatives: dict[str, np.ndarray] | None, omega: np.ndarray
) -> tuple[np.ndarray, np.ndarray | None]:
    """G(iω) (n_y, n_ω, n_u) of the inputs proper, and its derivatives (p, n_y, n_ω, n_u).

    An input derivative of order r adds (iω)^r times its column.
    """
    s = 1j * omega
    n, n_u = ss.A.shape[0], ss.B.shape[1] - len(ss.input_derivatives)
    spread = np.zeros((omega.size, ss.B.shape[1], n_u), dtype=complex)
    spread[:, :n_u] = np.eye(n_u)
    for column, (source, order) in enumerate(ss.input_derivatives, start=n_u):
        spread[:, column, source] = s**order
    resolvent = np.linalg.inv(s[:, None, None] * np.eye(n) - ss.A)
    states = resolvent @ (ss.B @ spread)
    response = ss.C @ states + ss.D @ spread
    if derivatives is None:
        return response.transpose(1, 0, 2), None
    left = ss.C @ resolvent
    dA, dB = derivatives["A"][:, None], derivatives["B"][:, None]
    inner = dA @ states + dB @ spread
    slopes = left @ inner + derivatives["C"][:, None] @ states + derivatives["D"][:, None] @ spread
    return response.transpose(1, 0, 2), slopes.transpose(0, 2, 1, 3)


def _fit(measured: np.ndarray, modelled: np.ndarray) -> float:
    spread = np.linalg.norm(measured - measured.mean()) or 1.0
    return float(100.0 * (1.0 - np.linalg.norm(measured - modelled) / spread))
