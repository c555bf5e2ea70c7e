"""State-space matrices as functions of the parameters, sampled exactly, and their exact derivatives.

StateSpace -> DiscreteModel as in report (43)-(45), (47): inputs between the samples are constant (zoh),
straight lines (foh) or cubic curves (smooth). White noise is integrated exactly (Van Loan), or held over a
sample as in (43) with the variance intensity/period that gives it the same power.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial, singledispatch
from threading import get_ident
from typing import Any, Literal

import casadi as ca
import numpy as np

from daest.errors import ModelError
from daest.model.flat import Dynamics, ExplicitModel, FlatModel, Model
from daest.model.holds import FOH, SMOOTH, ZOH, Hold, held_inputs, spline_slopes
from daest.model.linear import DiscreteModel, StateSpace, StateSpaceFamily
from daest.numerics.evaluator import Evaluator
from daest.numerics.exponential import (
    CUBIC,
    STRAIGHT,
    TransitionIntegrals,
    beside,
    covariance_integral,
    covariance_integral_derivatives,
    transition_integral_derivatives,
    transition_integrals,
)
from daest.systems.linear.linearize import has_affine_dynamics, is_affine_model, operating_point
from daest.systems.reduction.initialize import initial_point
from daest.systems.reduction.input_slopes import acting_slopes_of, no_input_derivative
from daest.systems.reduction.reduce import dynamics

Noise = Literal["white", "held"]


@dataclass(frozen=True)
class SampledDerivatives:
    """Derivatives of the fields of DiscreteModel with the same names; the first axis counts the p
    directions.
    """

    transition: np.ndarray  # (p, n, n)
    input_now: np.ndarray  # (p, n, n_ū)
    input_next: np.ndarray  # (p, n, n_ū)
    drift: np.ndarray  # (p, n)
    output: np.ndarray  # (p, n_y, n)
    feedthrough: np.ndarray  # (p, n_y, n_ū)
    output_offset: np.ndarray  # (p, n_y)
    process_cov: np.ndarray  # (p, n, n)
    measurement_cov: np.ndarray  # (p, n_y, n_y), without the derivative of the given measurement_cov
    cross_cov: np.ndarray  # (p, n, n_y)


def sample(
    ss: StateSpace,
    period: float,
    hold: Hold = "foh",
    process_intensity: np.ndarray | None = None,
    measurement_cov: np.ndarray | None = None,
    noise: Noise = "white",
) -> DiscreteModel:
    """Sample `ss` with `period` [s].

    `process_intensity` (n_w,) or (n_w, n_w): two-sided intensity of w, zero when not given. `measurement_cov`
    (n_y, n_y) or (n_y,): covariance of e, zero when not given. `noise` "white" integrates w exactly; "held"
    holds w over a sample, (43)-(45), cov(w) = intensity / period, and is needed where w reaches an output
    directly (H w), since sampled white noise has no finite variance.

    An input derivative of order 1 is, with foh, the slope of the interval; its effect on the states is
    moved into the columns of the input, and the columns of the derivative in Γ0 and Γ1 are zero. In y = D
    ū its column stays: ū comes from `stacked_inputs`. With smooth inputs, cubic curves between values and
    slopes, ū has the slopes of all of them (`space_for`). Errors (ModelError): `input-derivative-order`,
    `input-derivative-hold`, `output-white-noise`.

        >>> daest.sample(ss, 0.01, "zoh").transition.shape
        (4, 4)
    """
    _check_input_derivatives(ss, hold)
    ss = space_for(ss, hold)
    intensity = _square(process_intensity, ss.G.shape[1])
    _check_direct_noise(ss, intensity, noise)
    integrals = transition_integrals(ss.A, period, integral_count(hold))
    now, following = _input_matrices(ss.B, integrals, ss, period, hold)
    noise_cov = intensity / period
    held = integrals.first @ ss.G
    if noise == "held":
        process_cov = held @ noise_cov @ held.T
    else:
        process_cov = covariance_integral(ss.A, ss.G @ intensity @ ss.G.T, period)
    direct = ss.H if noise == "held" else np.zeros_like(ss.H)
    return DiscreteModel(
        transition=integrals.transition,
        input_now=now,
        input_next=following,
        drift=integrals.first @ ss.b,
        output=ss.C,
        feedthrough=ss.D,
        output_offset=ss.d,
        process_cov=process_cov,
        measurement_cov=_square(measurement_cov, ss.C.shape[0]) + direct @ noise_cov @ direct.T,
        cross_cov=held @ noise_cov @ direct.T,
        noise_cov=noise_cov,
        noise_process_cov=noise_cov @ held.T,
        noise_measurement_cov=noise_cov @ direct.T,
        period=period,
        hold=hold,
    )


def sample_derivatives(
    ss: StateSpace,
    derivatives: dict[str, np.ndarray],
    period: float,
    hold: Hold = "foh",
    process_intensity: np.ndarray | None = None,
    intensity_derivatives: np.ndarray | None = None,
    noise: Noise = "white",
) -> SampledDerivatives:
    """Exact derivatives of `sample` in p directions.

    `derivatives` maps the names of the StateSpace matrices (at least A, B, G, b, C, D, H, d) to arrays
    with a first axis of length p; `intensity_derivatives` (p, n_w, n_w) are those of the intensity, zero
    when not given.
    """
    dA, dG, db = (derivatives[name] for name in ("A", "G", "b"))
    dH, padded = derivatives["H"], space_for(ss, hold)
    added = padded.B.shape[1] - ss.B.shape[1]
    dB, dD = (np.pad(derivatives[name], ((0, 0), (0, 0), (0, added))) for name in ("B", "D"))
    ss = padded
    p, n_w = dA.shape[0], ss.G.shape[1]
    intensity = _square(process_intensity, n_w)
    dW = np.zeros((p, n_w, n_w)) if intensity_derivatives is None else intensity_derivatives
    count = integral_count(hold)
    integrals = transition_integrals(ss.A, period, count)
    change = transition_integral_derivatives(ss.A, dA, period, count)
    now, following = _input_matrices(ss.B, change, ss, period, hold)
    now_b, following_b = _input_matrices(dB, integrals, ss, period, hold)
    held, dheld = integrals.first @ ss.G, change.first @ ss.G + integrals.first @ dG
    if noise == "held":
        dprocess = _product_change(held, intensity, held, dheld, dW, dheld) / period
        dmeasurement = _product_change(ss.H, intensity, ss.H, dH, dW, dH) / period
        dcross = _product_change(held, intensity, ss.H, dheld, dW, dH) / period
    else:
        Q, dQ = ss.G @ intensity @ ss.G.T, _product_change(ss.G, intensity, ss.G, dG, dW, dG)
        dprocess = covariance_integral_derivatives(ss.A, Q, dA, dQ, period) if n_w else np.zeros_like(dA)
        n_y = ss.C.shape[0]
        dmeasurement, dcross = np.zeros((p, n_y, n_y)), np.zeros((p, ss.A.shape[0], n_y))
    return SampledDerivatives(
        transition=change.transition,
        input_now=now + now_b,
        input_next=following + following_b,
        drift=change.first @ ss.b + (integrals.first @ db[..., None])[..., 0],
        output=derivatives["C"],
        feedthrough=dD,
        output_offset=derivatives["d"],
        process_cov=dprocess,
        measurement_cov=dmeasurement,
        cross_cov=dcross,
    )


@dataclass(frozen=True)
class SampledSteps:
    """A model sampled with k periods: fields as those of DiscreteModel with an axis of k. `slopes` has an
    axis of k behind that of the directions in what depends on the period."""

    transition: np.ndarray
    input_now: np.ndarray
    input_next: np.ndarray
    drift: np.ndarray
    process_cov: np.ndarray
    slopes: SampledDerivatives | None


def sample_steps(
    ss: StateSpace,
    periods: np.ndarray,
    hold: Hold,
    derivatives: dict[str, np.ndarray] | None,
    process_intensity: np.ndarray | None = None,
    intensity_derivatives: np.ndarray | None = None,
) -> SampledSteps | None:
    """`sample` and `sample_derivatives` with white noise for all `periods` (k,) [s] at once, which lie within
    an octave; None where they must be sampled one by one."""
    made = None if hold == SMOOTH else beside(ss.A, periods, integral_count(hold))
    if made is None:
        return None
    _check_input_derivatives(ss, hold)
    intensity = _square(process_intensity, ss.G.shape[1])
    _check_direct_noise(ss, intensity, "white")
    integrals = made.integrals()
    now, following = _input_matrices(ss.B, integrals, ss, periods[:, None], hold)
    Q = ss.G @ intensity @ ss.G.T
    covariances = made.covariances(Q) if Q.any() else np.zeros_like(integrals.transition)
    slopes = None
    if derivatives is not None:
        change = made.derivatives(derivatives["A"])
        slopes = _slopes_of_steps(ss, integrals, change, periods, hold, derivatives)
        dW = np.zeros((1, *intensity.shape)) if intensity_derivatives is None else intensity_derivatives
        dQ = _product_change(ss.G, intensity, ss.G, derivatives["G"], dW, derivatives["G"])
        if Q.any() or dQ.any():
            moved = made.covariance_derivatives(Q, derivatives["A"], dQ)
            slopes = replace(slopes, process_cov=np.swapaxes(moved, 0, 1))
    drift = integrals.first @ ss.b
    return SampledSteps(integrals.transition, now, following, drift, covariances, slopes)


def _slopes_of_steps(
    ss: StateSpace,
    integrals: TransitionIntegrals,
    change: TransitionIntegrals,
    periods: np.ndarray,
    hold: Hold,
    derivatives: dict[str, np.ndarray],
) -> SampledDerivatives:
    """Those of `sample_steps`, from the `integrals` (k, n, n) and what they `change` by (k, p, n, n)."""
    held, T = _with_directions(integrals), periods[:, None, None]
    now, following = _input_matrices(ss.B, change, ss, T, hold)
    now_b, following_b = _input_matrices(derivatives["B"], held, ss, T, hold)
    drift = change.first @ ss.b + (held.first @ derivatives["b"][..., None])[..., 0]
    n_y, n = ss.C.shape
    p, k = derivatives["A"].shape[0], periods.size
    return SampledDerivatives(
        transition=np.swapaxes(change.transition, 0, 1),
        input_now=np.swapaxes(now + now_b, 0, 1),
        input_next=np.swapaxes(following + following_b, 0, 1),
        drift=np.swapaxes(drift, 0, 1),
        output=derivatives["C"],
        feedthrough=derivatives["D"],
        output_offset=derivatives["d"],
        process_cov=np.zeros((p, k, n, n)),
        measurement_cov=np.zeros((p, n_y, n_y)),
        cross_cov=np.zeros((p, k, n, n_y)),
    )


def _with_directions(integrals: TransitionIntegrals) -> TransitionIntegrals:
    """With an axis for directions behind that of the periods."""
    parts = (integrals.transition, integrals.first, integrals.second)
    transition, first, second = (part[:, None] for part in parts)
    return TransitionIntegrals(transition, first, second)


def stacked_inputs(
    inputs: np.ndarray,
    time: np.ndarray,
    input_derivatives: tuple[tuple[int, int], ...],
    hold: Hold = FOH,
) -> np.ndarray:
    """ū = (u, v) (n_samples, n_u + n_v): v are slopes of the inputs over `time` [s], of splines where they
    are smooth, else by central differences.
    """
    if not input_derivatives:
        return inputs
    if len(time) < 2:
        return np.hstack([inputs, np.zeros((len(time), len(input_derivatives)))])
    sources = [i for i, _ in input_derivatives]
    if hold == SMOOTH:
        return np.hstack([inputs, spline_slopes(inputs, time)[:, sources]])
    slopes = np.column_stack([np.gradient(inputs[:, i], time) for i in sources])
    return np.hstack([inputs, slopes])


def integral_count(hold: Hold) -> int:
    """How many integrals of the transition matrix the inputs between samples take."""
    return CUBIC if hold == SMOOTH else STRAIGHT


def _input_matrices(
    B: np.ndarray, integrals: TransitionIntegrals, ss: StateSpace, period: float | np.ndarray, hold: Hold
) -> tuple[np.ndarray, np.ndarray]:
    """Γ0 and Γ1 for B (..., n, n_ū); linear in B and in `integrals`, so it serves derivatives as well. Many
    periods have axes for those of the integrals but the last."""
    if hold == SMOOTH:
        assert isinstance(period, float)
        return _smooth_matrices(B, integrals, ss, period)
    whole = integrals.first @ B
    if hold == ZOH:
        return whole, np.zeros_like(whole)
    following = integrals.second @ B
    following[..., np.flatnonzero(held_inputs(hold, ss.input_names))] = 0.0
    now = whole - following
    n_u = B.shape[-1] - len(ss.input_derivatives)
    for column, (source, _) in enumerate(ss.input_derivatives, start=n_u):
        # v = (u[k+1] - u[k]) / period over the whole interval.
        now[..., source] -= whole[..., column] / period
        following[..., source] += whole[..., column] / period
        now[..., column] = following[..., column] = 0.0
    return now, following


def _smooth_matrices(
    B: np.ndarray, integrals: TransitionIntegrals, ss: StateSpace, period: float
) -> tuple[np.ndarray, np.ndarray]:
    """Γ0 and Γ1 of inputs on cubic curves between their values and slopes at the samples (Hermite): with r
    from 0 to 1, u = (1 - 3r² + 2r³) u0 + (r - 2r² + r³) T u̇0 + (3r² - 2r³) u1 + (r³ - r²) T u̇1, and its
    derivative where the model needs that."""
    n_u = B.shape[-1] - len(ss.input_derivatives)
    constant, linear, square, cube = (
        whole @ B for whole in (integrals.first, integrals.second, *integrals.more)
    )
    rise = 3.0 * square - 2.0 * cube
    now, following = np.zeros_like(constant), np.zeros_like(constant)
    now[..., :n_u], following[..., :n_u] = (constant - rise)[..., :n_u], rise[..., :n_u]
    slope_now, slope_next = period * (linear - 2.0 * square + cube), period * (cube - square)
    by_rate = 6.0 * (linear - square) / period
    rate_now, rate_next = constant - 4.0 * linear + 3.0 * square, 3.0 * square - 2.0 * linear
    for column, (source, order) in enumerate(ss.input_derivatives, start=n_u):
        if order > 1:
            continue
        now[..., column] = slope_now[..., source] + rate_now[..., column]
        following[..., column] = slope_next[..., source] + rate_next[..., column]
        now[..., source] -= by_rate[..., column]
        following[..., source] += by_rate[..., column]
    return now, following


def _product_change(
    left: np.ndarray, W: np.ndarray, right: np.ndarray, dleft: np.ndarray, dW: np.ndarray, dright: np.ndarray
) -> np.ndarray:
    """d(left W rightᵀ) for (p, ...) directions."""
    outer = left @ W @ np.swapaxes(dright, -1, -2)
    return dleft @ W @ right.T + outer + left @ dW @ right.T


def _square(value: np.ndarray | None, size: int) -> np.ndarray:
    """Covariance or intensity as a (size, size) matrix; a vector is a diagonal."""
    if value is None:
        return np.zeros((size, size))
    value = np.asarray(value, dtype=float)
    return np.diag(value) if value.ndim == 1 else value


def _check_input_derivatives(ss: StateSpace, hold: Hold) -> None:
    for source, order in acting_slopes_of(ss):
        if order > 1 or held_inputs(hold, ss.input_names)[source]:
            raise no_input_derivative(ss.input_names[source], order, hold)


def _check_direct_noise(ss: StateSpace, intensity: np.ndarray, noise: Noise) -> None:
    if noise == "held" or not ss.H.size:
        return
    direct = np.abs(ss.H @ intensity @ ss.H.T).diagonal() > 0.0
    if np.any(direct):
        output = ss.output_names[int(np.flatnonzero(direct)[0])]
        raise ModelError(
            "output-white-noise",
            f"output {output} contains white noise directly, so that a sample of it has no finite variance",
            where=output,
            remedy="hold the noise over a sample (noise = held), or filter it before it reaches the output",
        )


def family_for(family: StateSpaceFamily, hold: Hold) -> StateSpaceFamily:
    """The family whose inputs ū suit a hold: for smooth inputs the first derivatives of all are among them,
    by most of which nothing moves."""
    added = _lacking(family.input_derivatives, len(family.inputs)) if hold == SMOOTH else ()
    if not added:
        return family
    derivatives = family.derivatives
    return replace(
        family,
        input_derivatives=family.input_derivatives + added,
        matrices=_padded(family.matrices, len(added)),
        derivatives=None if derivatives is None else partial(_padded_derivatives, derivatives, len(added)),
    )


def space_for(ss: StateSpace, hold: Hold) -> StateSpace:
    """The state space whose inputs ū suit a hold, as `family_for`."""
    added = _lacking(ss.input_derivatives, len(ss.input_names)) if hold == SMOOTH else ()
    if not added:
        return ss
    B, D, U = (np.pad(m, ((0, 0), (0, len(added)))) for m in (ss.B, ss.D, ss.U))
    return replace(ss, input_derivatives=ss.input_derivatives + added, B=B, D=D, U=U)


def _lacking(known: tuple[tuple[int, int], ...], n_u: int) -> tuple[tuple[int, int], ...]:
    """The first derivatives of n_u inputs that are not among those known."""
    return tuple((i, 1) for i in range(n_u) if (i, 1) not in known)


DRIVEN = ("B", "D", "U")  # the matrices with a column for each of ū


@lru_cache(maxsize=32)
def _padded(matrices: ca.Function, count: int) -> ca.Function:
    """The matrices with so many columns of zeros behind those of ū."""
    kind: Any = ca.SX if matrices.is_a("SXFunction") else ca.MX
    theta = kind.sym("theta", matrices.size1_in(0))
    found = [
        ca.horzcat(m, kind.zeros(m.size1(), count)) if name in DRIVEN else m
        for name, m in zip(MATRICES, matrices.call([theta]), strict=True)
    ]
    return ca.Function("matrices", [theta], found, ["theta"], list(MATRICES))


def _padded_derivatives(
    derivatives: Callable[[np.ndarray, tuple[int, ...]], list[np.ndarray]],
    count: int,
    theta: np.ndarray,
    columns: tuple[int, ...],
) -> list[np.ndarray]:
    return [
        np.concatenate([m, np.zeros((*m.shape[:2], count))], axis=2) if name in DRIVEN else m
        for name, m in zip(MATRICES, derivatives(theta, columns), strict=True)
    ]


MATRICES = ("A", "B", "G", "b", "C", "D", "H", "d", "X", "U", "W", "x0")
VECTORS = frozenset({"b", "d", "x0"})
DENSE = 100_000  # entries up to which a matrix is computed with its zeros, which takes less time
CACHED_DERIVATIVES = 32  # (family, names) pairs whose compiled derivative functions are kept


def state_space_family(model: Model | Dynamics, at: Mapping[str, float] | None = None) -> StateSpaceFamily:
    """θ -> matrices of ẋ = A x + B ū + G w + b, y = C x + D ū + H w + d, ξ = X x + U ū + W w + x0, ū = (u,
    v).

    Exact for affine models. A nonlinear model is linearised at the operating point `at` (values of states and
    inputs by name; those not named come from the consistent initial point at the inputs' start values, or at
    those with which a recording begins where there is none), with w = 0, v = 0 and t = 0; the offsets make
    the linear model exact at that point, for every θ. Where ẋ and y are affine (`is_affine` of the result),
    only ξ depends on that point.

        >>> family = daest.state_space_family(explicit)
        >>> family.noise_names
        ('disturbance.w',)
    """
    return family_along(model if isinstance(model, Dynamics) else dynamics(model), at)


@singledispatch
def family_along(explicit: Dynamics, at: Mapping[str, float] | None = None) -> StateSpaceFamily:
    """`state_space_family` of the dynamics of a model."""
    raise NotImplementedError(type(explicit).__name__)


@family_along.register
def _of_equations(explicit: ExplicitModel, at: Mapping[str, float] | None = None) -> StateSpaceFamily:
    x, u, time = _point_of_matrices(explicit, at)
    return family_of(explicit, _matrix_function(explicit, x, u, time), has_affine_dynamics(explicit))


def family_without_variables(explicit: ExplicitModel) -> StateSpaceFamily:
    """The family of a model with affine dynamics, without the matrices of its internal variables, which no
    run reads. Raises what `initial_point` raises, for these variables lead to the start."""
    x, u, time = _point_of_matrices(explicit, None)
    arguments: Any = explicit.rhs.sx_in() if explicit.is_symbolic else explicit.rhs.mx_in()
    kind: Any = ca.SX if explicit.is_symbolic else ca.MX
    bare = replace(explicit, variables=ca.Function("variables", arguments, [kind.zeros(0)]))
    return family_of(bare, _matrix_function(bare, x, u, time), is_affine=True)


def _point_of_matrices(
    explicit: ExplicitModel, at: Mapping[str, float] | None
) -> tuple[np.ndarray, np.ndarray, float]:
    """States (n_x,), inputs (n_u,) and time [s] where the matrices are taken; zeros if these are the same
    everywhere."""
    if is_affine_model(explicit.flat):
        return np.zeros(explicit.n_states), np.zeros(len(explicit.flat.inputs)), 0.0
    return _operating_point(explicit, at)


def family_of(
    explicit: Dynamics,
    matrices: ca.Function,
    is_affine: bool,
    derivatives: Callable[[np.ndarray, tuple[int, ...]], list[np.ndarray]] | None = None,
) -> StateSpaceFamily:
    """The family of an explicit model with its names; the functions as `StateSpaceFamily` has them. Shapes:
    theta (n_theta,); a derivative of a matrix (n, m) is (n_columns, n, m)."""
    flat = explicit.flat
    return StateSpaceFamily(
        state_names=explicit.state_names,
        state_units=explicit.state_units,
        unknowns=flat.unknowns,
        inputs=flat.inputs,
        input_derivatives=tuple((d.index, d.order) for d in explicit.input_derivatives),
        noises=flat.noises,
        outputs=flat.outputs,
        parameters=flat.parameters,
        matrices=matrices,
        is_affine=is_affine,
        derivatives=derivatives,
    )


def _operating_point(
    explicit: ExplicitModel, at: Mapping[str, float] | None
) -> tuple[np.ndarray, np.ndarray, float]:
    """States, inputs and time; with the inputs at which a recording begins where loops of equations have no
    solution at those of the model, as where a pump that stands still lifts no water."""
    point = operating_point(explicit.flat, at)
    at = at or {}
    if all(name in at for name in explicit.state_names):
        return np.array([at[name] for name in explicit.state_names]), point.u, point.time
    u = point.u
    try:
        x, _ = initial_point(explicit, u0=u, t0=point.time)
    except ModelError as error:
        u = _recorded_inputs(explicit.flat, point.u, at)
        if error.code != "initial-not-solved" or np.array_equal(u, point.u):
            raise
        x, _ = initial_point(explicit, u0=u, t0=point.time)
    states = [at.get(name, value) for name, value in zip(explicit.state_names, x, strict=True)]
    return np.array(states), u, point.time


def _recorded_inputs(flat: FlatModel, u: np.ndarray, at: Collection[str]) -> np.ndarray:
    """The inputs `u` (n_u,) with what a recording tells of those that are not given, neither by the model nor
    in `at`."""
    is_given = [v.guess is None or v.start is not None or v.name in at for v in flat.inputs]
    guesses = [np.nan if v.guess is None else v.guess for v in flat.inputs]
    return np.where(is_given, u, guesses)


def _matrix_function(explicit: ExplicitModel, x0: np.ndarray, u0: np.ndarray, time: float) -> ca.Function:
    """theta -> (A, B, G, b, C, D, H, d, X, U, W, x0), Jacobians at (x0, u0, v = 0, w = 0, time)."""
    kind: Any = ca.SX if explicit.rhs.is_a("SXFunction") else ca.MX
    arguments = [kind.sym(name, explicit.rhs.size1_in(i)) for i, name in enumerate(explicit.rhs.name_in())]
    x, u, v, w, theta, _ = arguments
    inputs = ca.vertcat(u, v)
    slopes = []
    for function in (explicit.rhs, explicit.outputs, explicit.variables):
        value = function(*arguments)
        by_x, by_input, by_w = (ca.jacobian(value, part) for part in (x, inputs, w))
        offset = value - ca.mtimes(by_x, x) - ca.mtimes(by_input, inputs)
        slopes += [by_x, by_input, by_w, offset]
    general = ca.Function(
        "general", arguments, [ca.densify(part) if part.numel() <= DENSE else part for part in slopes]
    )
    parameter = kind.sym("theta", theta.numel())
    point = [x0, u0, np.zeros(v.numel()), np.zeros(w.numel()), parameter, time]
    return ca.Function("matrices", [parameter], general(*point), ["theta"], list(MATRICES))


def state_space(family: StateSpaceFamily, theta: np.ndarray) -> StateSpace:
    """The matrices at theta, shape (n_parameters,), in the order of `family.parameters`.

    >>> ss = daest.state_space(family, flat.theta_values)
    >>> ss.A.shape, ss.C.shape
    ((4, 4), (2, 4))
    """
    values = dict(zip(MATRICES, _values(family.matrices, theta), strict=True))
    for name in VECTORS:
        values[name] = values[name][:, 0]
    return StateSpace(
        state_names=family.state_names,
        input_names=family.input_names,
        input_derivatives=family.input_derivatives,
        noise_names=family.noise_names,
        output_names=family.output_names,
        unknown_names=family.unknown_names,
        **values,
    )


def state_space_derivatives(
    family: StateSpaceFamily, theta: np.ndarray, names: Sequence[str]
) -> dict[str, np.ndarray]:
    """∂M/∂θ_i for every matrix M of `StateSpace` by name, shape (n_names, *M.shape), exact.

    The derivative function is built at the first call for a family and these names and kept. Raises
    ModelError `unknown-parameter`.
    """
    columns = tuple(family.parameter_columns(names))
    if family.derivatives is not None:
        found = zip(MATRICES, family.derivatives(theta, columns), strict=True)
        return {name: m[:, :, 0] if name in VECTORS else m for name, m in found}
    (stacked,) = _values(_derivative_function(family.matrices, columns), theta)
    stacked = stacked.T
    result, start = {}, 0
    for i, name in enumerate(MATRICES):
        n_rows, n_columns = family.matrices.size_out(i)
        part = stacked[:, start : start + n_rows * n_columns]
        start += n_rows * n_columns
        # CasADi stacks columns: the last axis of this reshape runs over rows.
        matrix = part.reshape(len(columns), n_columns, n_rows).transpose(0, 2, 1)
        result[name] = matrix[:, :, 0] if name in VECTORS else matrix
    return result


def _values(function: ca.Function, theta: np.ndarray) -> list[np.ndarray]:
    """The results of a function of theta, as arrays of two dimensions."""
    evaluator = _evaluator(function, get_ident())
    return [m.full() for m in function.call([theta])] if evaluator is None else evaluator(theta)


@lru_cache(maxsize=CACHED_DERIVATIVES)
def _evaluator(function: ca.Function, thread: int) -> Evaluator | None:
    """What evaluates symbolic expressions with dense results: a search asks hundreds of times, and CasADi's
    own matrices cost ten times the evaluation. One for each thread: it has one place for its results."""
    is_dense = all(function.sparsity_out(i).is_dense() for i in range(function.n_out()))
    return Evaluator(function) if is_dense and function.is_a("SXFunction") else None


@lru_cache(maxsize=CACHED_DERIVATIVES)
def _derivative_function(matrices: ca.Function, columns: tuple[int, ...]) -> ca.Function:
    """theta -> Jacobian of all matrix entries, column by column, matrix after matrix, in the chosen
    parameters."""
    kind: Any = ca.SX if matrices.is_a("SXFunction") else ca.MX
    theta = kind.sym("theta", matrices.size1_in(0))
    chosen = kind.sym("chosen", len(columns))
    inserted = kind(theta)
    inserted[list(columns)] = chosen
    stacked = ca.vertcat(*(ca.vec(m) for m in matrices.call([inserted])))
    jacobian = ca.jacobian(stacked, chosen)
    general = ca.Function("general", [chosen, theta], [ca.densify(jacobian)])
    return ca.Function("derivatives", [theta], [general(theta[list(columns)], theta)])
