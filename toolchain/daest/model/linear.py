"""Linear values: the DAE, its standard form, its state space and its sampled model.

Letters are those of Gerdin & Schön: E ξ' = J ξ + K u + B w, y = C ξ + D u + e. J is the state matrix and K
the input matrix; an inertia is never called J here, nor a Kalman gain K. Models are affine: `offset` columns
carry the constants (a gravity load, say), E ξ' = J ξ + K u + B w + offset.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, Protocol, TypeAlias

import casadi as ca
import numpy as np
import scipy.sparse as sp

from daest.model.holds import Hold
from daest.model.parts import Equation, Named, NoiseInput, Output, Parameter, Variable
from daest.model.shown import Listing, Shown, package

Matrix: TypeAlias = np.ndarray | sp.csr_array


@dataclass(frozen=True)
class LinearDAE(Named, Shown):
    """E ξ' = J ξ + K u + B w + offset;  y = C ξ + D u + H w + output_offset + e, at one θ and operating
    point.

    Shapes: E, J (n, n); K (n, n_u); B (n, n_w); C (n_y, n); D (n_y, n_u); H (n_y, n_w); offset (n,);
    output_offset (n_y,). E and J may be sparse. Rows are `equations`, columns of E and J are `unknowns`.
    """

    equations: tuple[Equation, ...]
    unknowns: tuple[Variable, ...]
    inputs: tuple[Variable, ...]
    noises: tuple[NoiseInput, ...]
    outputs: tuple[Output, ...]
    parameters: tuple[Parameter, ...]  # with the values the matrices were computed at
    E: Matrix
    J: Matrix
    K: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    H: np.ndarray
    offset: np.ndarray
    output_offset: np.ndarray
    source: Literal["symbolic", "fmi-ls-dae", "directional derivatives", "finite differences"] = "symbolic"
    is_affine: bool = True  # False: this is the linearisation of a nonlinear model at the operating point
    notes: tuple[str, ...] = ()  # what the reader should know, such as an operating point that was assumed
    family: ca.Function | None = (
        None  # θ -> E, J, K, B, …, of which the matrices are the values at `parameters`
    )

    @property
    def n(self) -> int:
        return len(self.equations)

    def tables(self) -> tuple[Listing, ...]:
        title = f"E ξ' = J ξ + K u + B w of {len(self.equations)} equations ({self.source})"
        rows = tuple((p.name, p.value, p.unit, p.estimate) for p in self.parameters)
        return (Listing(title, ("parameter", "value", "unit", "estimate"), rows),)


@dataclass(frozen=True)
class RankDecision:
    """A rank that was decided: `rank` singular values exceed `threshold`; `gap` is the ratio of the smallest
    kept to the largest dropped one (inf when nothing was dropped or the dropped ones are exactly zero).
    `is_exact`: exact arithmetic decided on the rank, and the singular values only show what they make of it.
    """

    what: str
    singular_values: tuple[float, ...]
    threshold: float
    rank: int
    gap: float
    is_exact: bool = False


class Structure(Protocol):
    """What exact arithmetic says of a pencil sE - J (see `systems.exact_structure`).

    `reading`: of the `numbers` in E and J, of the equations at the values of their `parameters`, or of the
    equations at almost every θ (`generic`). `is_certain`: no number was, or may have been, rounded.
    """

    @property
    def reading(self) -> Literal["numbers", "parameters", "generic"]: ...

    @property
    def is_certain(self) -> bool: ...

    @property
    def n_dynamic(self) -> int: ...

    @property
    def index(self) -> int: ...

    @property
    def level_sizes(self) -> tuple[int, ...]:
        """Dimensions by which ker N, ker N², … grow (the Weyr characteristic of the infinite eigenvalue)."""

    @property
    def rank_of_n(self) -> int: ...

    @property
    def orders(self) -> np.ndarray:
        """(n,) the highest derivative of a noise on each equation in any unknown; 0: none."""

    def reached(self, m: int) -> np.ndarray | None:
        """Which entries (n, n) of the coefficient of s^m in (sE - J)⁻¹ are not zero; None: too many."""

    def response(self, m: int, b: np.ndarray) -> np.ndarray | None:
        """Which entries (n,) of that coefficient times b (n,) are not zero; None where b is no column of B
        or K."""


@dataclass(frozen=True)
class StandardForm:
    """P E Q = diag(I, N), P J Q = diag(A, I), P K = [B1; D1]: Gerdin & Schön (5) and (21), ξ = Q z.

    Sign convention of this package: E ξ' = J ξ + K u, so z1' = A z1 + B1 u and N z2' = z2 + D1 u, that is
    z2 = -Σ N^i D1 u^(i), i = 0 … index-1. (The report writes E x' + F x = B w with F = -J; its N and D differ
    from these by sign.) `left` is P and `right` is Q, both (n, n). `index` is the nilpotency index of N
    (0 for an ODE: N is empty).
    """

    left: np.ndarray
    right: np.ndarray
    A: np.ndarray  # (n_dynamic, n_dynamic)
    N: np.ndarray  # (n - n_dynamic, n - n_dynamic), nilpotent
    index: int
    decisions: tuple[RankDecision, ...]
    exact: Structure | None = None  # that decided on index and n_dynamic, or agrees with them
    doubts: tuple[str, ...] = ()  # what neither exact arithmetic nor the singular values could decide
    poles: np.ndarray | None = None  # (n_dynamic,) where more digits were computed than A holds

    @property
    def n_dynamic(self) -> int:
        return self.A.shape[0]

    @property
    def left_dynamic(self) -> np.ndarray:
        """P1, the rows of P that belong to z1: (n_dynamic, n)."""
        return self.left[: self.n_dynamic]

    @property
    def right_dynamic(self) -> np.ndarray:
        """Q1, the columns of Q that belong to z1: (n, n_dynamic)."""
        return self.right[:, : self.n_dynamic]


@dataclass(frozen=True)
class GroupedMatrix:
    """A large matrix whose rows, and columns, come in groups of multiples of each other: entry (j, i) is
    row_factor[j] · core[row_group[j], column_group[i]] · column_factor[i], zero where a group is -1."""

    core: sp.csc_array  # one row and one column for each group
    row_group: np.ndarray
    row_factor: np.ndarray
    column_group: np.ndarray
    column_factor: np.ndarray

    @cached_property
    def row_members(self) -> sp.csr_array:
        """The rows j of every group: the stored entries of row `row_group[j]`, in increasing order."""
        used = np.flatnonzero(self.row_group >= 0)
        order = used[np.argsort(self.row_group[used], kind="stable")]
        counts = np.bincount(self.row_group[used], minlength=self.core.shape[0])
        pointers = np.concatenate([[0], np.cumsum(counts)])
        shape = (self.core.shape[0], self.row_group.size)
        return sp.csr_array((np.ones(order.size, dtype=bool), order, pointers), shape=shape)


@dataclass(frozen=True)
class SparseForm:
    """What the standard form says of a large model, without a basis for z2: z1' = A z1 + P1 b w and
    ξ = Q1 z1 + Σ maps[i] b w^(i), maps[i] = -Q2 N^i P2, for any column b.

    z1 are the unknowns `states` (rows of Q1 that form an identity). `maps[0]` holds only the rows of unknowns
    that outputs contain, and the columns of equations that inputs, noises or offsets enter.
    """

    states: np.ndarray
    left_dynamic: sp.csr_array  # P1 (n_dynamic, n)
    right_dynamic: sp.csr_array  # Q1 (n, n_dynamic)
    A: sp.csr_array  # (n_dynamic, n_dynamic)
    maps: tuple[GroupedMatrix, ...]  # `index` of them, (n, n) each; from maps[1] on all of the same groups
    index: int
    decisions: tuple[RankDecision, ...]
    exact: Structure | None = None  # as in `StandardForm`
    doubts: tuple[str, ...] = ()

    @property
    def n_dynamic(self) -> int:
        return self.A.shape[0]


@dataclass(frozen=True)
class StateSpace(Shown):
    """ẋ = A x + B ū + G w + b,  y = C x + D ū + H w + d + e,  ξ = X x + U ū + W w + x0.

    ū = (u, v) stacks the inputs and the input derivatives `input_derivatives` [(input, order)]. Shapes: A (n,
    n), B (n, n_ū), G (n, n_w), b (n,), C (n_y, n), D (n_y, n_ū), H (n_y, n_w), d (n_y,), X (n_ξ, n), U (n_ξ,
    n_ū), W (n_ξ, n_w), x0 (n_ξ,).
    """

    state_names: tuple[str, ...]
    input_names: tuple[str, ...]
    input_derivatives: tuple[tuple[int, int], ...]
    noise_names: tuple[str, ...]
    output_names: tuple[str, ...]
    unknown_names: tuple[str, ...]
    A: np.ndarray
    B: np.ndarray
    G: np.ndarray
    b: np.ndarray
    C: np.ndarray
    D: np.ndarray
    H: np.ndarray
    d: np.ndarray
    X: np.ndarray
    U: np.ndarray
    W: np.ndarray
    x0: np.ndarray

    def to_control(self) -> Any:
        """The `control.StateSpace` of python-control from ū to y, with the names of states, inputs and
        outputs; an input derivative is called `der(u)`.

        Noise and the constants b and d have no place there. Raises ConfigError `needs-package`.
        """
        derivatives = [f"{'der(' * k}{self.input_names[i]}{')' * k}" for i, k in self.input_derivatives]
        return package("control", "control").ss(
            self.A,
            self.B,
            self.C,
            self.D,
            states=list(self.state_names),
            inputs=[*self.input_names, *derivatives],
            outputs=list(self.output_names),
            name="daest",
        )

    def tables(self) -> tuple[Listing, ...]:
        poles = np.linalg.eigvals(self.A)
        rows = tuple((float(p.real), float(p.imag)) for p in poles)
        title = (
            f"States {', '.join(self.state_names)}; inputs {', '.join(self.input_names)}; "
            f"outputs {', '.join(self.output_names)}"
        )
        return (Listing(title, ("pole, real part", "imaginary part"), rows),)


@dataclass(frozen=True)
class StateSpaceFamily(Named):
    """θ -> StateSpace with exact derivatives, built once per model.

    `matrices` maps theta (all parameters, n_θ) to (A, B, G, b, C, D, H, d, X, U, W, x0) as DMs.
    `jacobian(names)` functions are made by `systems.state_space`; see there. `at` is the operating point of
    the linearisation for nonlinear models (None when the model is affine).
    """

    state_names: tuple[str, ...]
    state_units: tuple[str, ...]
    unknowns: tuple[Variable, ...]
    inputs: tuple[Variable, ...]
    input_derivatives: tuple[tuple[int, int], ...]
    noises: tuple[NoiseInput, ...]
    outputs: tuple[Output, ...]
    parameters: tuple[Parameter, ...]
    matrices: ca.Function
    is_affine: bool
    # (theta, columns) -> ∂M/∂θ_columns for every matrix; None: by CasADi.
    derivatives: Callable[[np.ndarray, tuple[int, ...]], list[np.ndarray]] | None = None


@dataclass(frozen=True)
class DiscreteModel:
    """x[k+1] = Φ x[k] + Γ0 ū[k] + Γ1 ū[k+1] + γ + w̃[k],  y[k] = C x[k] + D ū[k] + d + ẽ[k].

    cov(w̃) = process_cov (n, n), cov(ẽ) = measurement_cov (n_y, n_y), E w̃ ẽᵀ = cross_cov (n, n_y): report
    (47). Γ1 is zero for zero-order hold. `period` in seconds. The noise itself is estimated through w̄[k],
    the mean of w(t) over the sample (w held over a sample is its own mean): noise_cov = cov(w̄) (n_w, n_w),
    noise_process_cov = E w̄ w̃ᵀ (n_w, n), noise_measurement_cov = E w̄ ẽᵀ (n_w, n_y), the R12 of (52).
    """

    transition: np.ndarray  # Φ
    input_now: np.ndarray  # Γ0
    input_next: np.ndarray  # Γ1
    drift: np.ndarray  # γ
    output: np.ndarray  # C
    feedthrough: np.ndarray  # D
    output_offset: np.ndarray  # d
    process_cov: np.ndarray
    measurement_cov: np.ndarray
    cross_cov: np.ndarray
    noise_cov: np.ndarray
    noise_process_cov: np.ndarray
    noise_measurement_cov: np.ndarray
    period: float
    hold: Hold
