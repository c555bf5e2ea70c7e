"""Standard form (21) of a linear DAE: structural reduction first, a dense staircase on what is left.

Equations without derivatives are solved for as many unknowns (sparse, pivots on well-scaled coefficients),
which leaves a core with as many equations as contain derivatives. The core goes through `numerics.pencils`;
putting the eliminated unknowns back is exact: they only add a column block to N.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg as sla
import scipy.sparse as sp
import scipy.sparse.linalg as spla

from daest.errors import DaestError, ModelError, NumericalError
from daest.model.linear import LinearDAE, RankDecision, SparseForm, StandardForm, Structure
from daest.model.parts import Variable
from daest.numerics.elimination import choose_pivots
from daest.numerics.laurent import expand_at_infinity
from daest.numerics.modular_pencil import DenseInfinity, SingularPencil
from daest.numerics.pencils import Scaling, apply_scaling, split_pencil, unit_scaling
from daest.numerics.precise_pencil import precise_form
from daest.numerics.ranks import decide_rank, default_tolerance, warning
from daest.systems.linear.exact_structure import ExactStructure, exact_structure, generic_structure
from daest.systems.linear.generic_verdict import special_values
from daest.systems.reduction.expand import Signature, check_structure

LISTED = 8
"""Equations or unknowns that an error message lists before it says how many more there are."""

ITERATED = 1000
"""From this many equations on the null vector of a singular pencil is found by inverse iteration."""

INVERSE_ITERATIONS = 4

VANISHES = 1e-9
"""Norm of the combination of scaled equations that counts as zero in `null_vector`."""

NULL_VECTOR_SHARE = 0.05
"""Equations with at least this part of the largest entry of a null vector are named."""

WORST_BASIS = 1e6
"""Condition up to which z2 is made orthonormal off the dynamic subspace; that many digits of P and N are
lost."""


PRECISE_LIMIT = 200
"""Up to this many equations many digits are to be had: some 2 s."""

CHEAP_LIMIT = 100
"""Up to this many equations many digits cost little: 0.04 s for 54, 0.15 s for 100."""

NEARLY_ZERO = 1e-2
"""Part of the largest singular value below which one that counts takes digits of the fast modes. Of 150 dense
pencils with a pole near -1/eps, eps from 1e-9 to 0.1, poles were up to 2.7 times worse than by QZ; with 1e-5
here, three were worse by more than ten times."""

PURE_ROUNDING = (0.5, 1.0 / 12.0)
"""Rounding errors alone leave a singular value of (a + b n) eps times the norm: singular matrices turned by
random ones of 6 to 30 rows have 0.3 to 2 eps."""

LARGEST_GROWTH = 1e10
"""Entry by entry a matrix with a smaller ρ(|M⁻¹| |M|) stays regular under relative changes of 1e-10."""


@dataclass(frozen=True)
class Reduction:
    """Equations without derivatives solved for the `solved` unknowns: a pencil of the size of the rest.

    In the scaled pencil, with rows (core, free) and columns (rest, solved),
    E = [[E22, E21], [0, 0]], J = [[J22, J21], [J12, J11]] and J11 regular: the core is
    E22 - E21 J11⁻¹ J12 and J22 - J21 J11⁻¹ J12. `inverse` is J11⁻¹, `dependence` is J11⁻¹ J12.
    """

    scaling: Scaling
    core_rows: np.ndarray
    free_rows: np.ndarray
    rest: np.ndarray
    solved: np.ndarray
    inverse: np.ndarray
    dependence: np.ndarray
    E21: sp.csr_array
    J21: sp.csr_array
    core_E: np.ndarray
    core_J: np.ndarray


def split(dae: LinearDAE, tolerance: float | None = None) -> StandardForm:
    """P E Q = diag(I, N), P J Q = diag(A, I), ξ = Q z: report (5) and (21), in the sign of `StandardForm`.

    z1 are unknowns of the model (rows of Q that form an identity), chosen by column-pivoted QR; z2 is scaled
    so that its norm is the distance of ξ from the subspace of z1, which makes the singular values of N
    numbers of the model. Exact arithmetic decides on index and modes; with `tolerance` floating point does,
    and it goes to the rank decisions, relative to the norm of the scaled core.

    Raises ModelError `structurally-singular` with the equations and unknowns concerned, and `pencil-singular`
    with the combination of equations that vanishes.

        >>> form = daest.split(dae)
        >>> form.n_dynamic, form.index
        (4, 3)
    """
    _check_structure(dae)
    try:
        exact = exact_structure(dae) if tolerance is None else None
    except SingularPencil as error:
        raise dependent_equations(dae) from error
    try:
        form = _by_values(dae, tolerance)
    except DaestError:
        if exact is None or not decides(dae, exact) or not isinstance(exact.infinity, DenseInfinity):
            raise
        return _by_structure(dae, exact, None)
    if exact is None:
        return replace(form, doubts=doubtful_decisions(form.decisions) if tolerance is None else ())
    same_modes = form.n_dynamic == exact.n_dynamic
    if same_modes and form.index == exact.index:
        doubts = () if exact.is_certain else doubtful_decisions(form.decisions)
        form = replace(form, exact=exact, doubts=doubts)
        if is_nearly_deficient(form) and dae.n <= CHEAP_LIMIT and decides(dae, exact):
            return _with_more_digits(dae, exact, form)
        return form
    if not decides(dae, exact) or not (exact.is_certain or _survives_rounding(dae, exact, form)):
        return replace(form, doubts=disagreement(exact, form))
    if same_modes:
        return replace(form, index=exact.index, exact=exact, doubts=disagreement(exact, form))
    if not isinstance(exact.infinity, DenseInfinity):
        return replace(form, doubts=(*disagreement(exact, form), *doubtful_decisions(form.decisions)))
    return _by_structure(dae, exact, form)


def _with_more_digits(dae: LinearDAE, exact: ExactStructure, form: StandardForm) -> StandardForm:
    """The same form and states of many digits; as it is where doubles have lost what the pivots rest on."""
    try:
        return replace(_by_structure(dae, exact, form), doubts=form.doubts)
    except NumericalError:
        return form


def _survives_rounding(dae: LinearDAE, exact: ExactStructure, by_values: StandardForm) -> bool:
    """Whether what floating point dropped, against exact arithmetic, was more than rounding errors: numbers
    larger than these, or small ones of a pencil whose entries are orders of magnitude apart."""
    if has_generic_modes(dae, exact):
        return True
    return any(
        max(decision.singular_values[decision.rank :]) > _pure_rounding(decision)
        for decision in by_values.decisions
        if decision.rank < len(decision.singular_values)
    )


def _pure_rounding(decision: RankDecision) -> float:
    """What rounding errors alone may leave of a singular value, from a threshold of 256 n eps."""
    n = max(len(decision.singular_values), 1)
    eps = float(np.finfo(float).eps)
    return (PURE_ROUNDING[0] + PURE_ROUNDING[1] * n) * eps * decision.threshold / default_tolerance(n)


def has_generic_modes(dae: LinearDAE, exact: ExactStructure) -> bool:
    """Whether the number of modes is that of almost all numbers in the same places, and relative changes of
    the size of rounding errors cannot alter it: the system Jacobian is far from singular entry by entry.

    That distance is 1 / ρ(|Â0⁻¹| |Â0|), ρ the spectral radius, whatever rows and columns are scaled by
    (J. Demmel, SIAM J. Matrix Anal. 13, 1992).
    """
    scaling = unit_scaling(dae.E, dae.J)
    E, J = apply_scaling(scaling, sp.csr_array(dae.E), sp.csr_array(dae.J))
    try:
        expansion = expand_at_infinity(E, J, 0.0)
    except NumericalError:
        return False
    jacobian = expansion.jacobian.matrix.toarray()
    try:
        growth = np.abs(np.linalg.inv(jacobian)) @ np.abs(jacobian)
    except np.linalg.LinAlgError:
        return False
    is_far = bool(np.abs(np.linalg.eigvals(growth)).max(initial=0.0) < LARGEST_GROWTH)
    return is_far and expansion.degree == exact.n_dynamic


def is_nearly_deficient(form: StandardForm) -> bool:
    """Whether a rank counts a singular value so small that the digits of the fast modes hang on it."""
    return any(
        decision.rank
        and decision.singular_values[decision.rank - 1] < NEARLY_ZERO * decision.singular_values[0]
        for decision in form.decisions
        if len(decision.singular_values) >= decision.rank
    )


def decides(dae: LinearDAE, exact: ExactStructure) -> bool:
    """Whether exact arithmetic has the last word: not where the numbers themselves are results of rounding,
    as at an operating point that was solved for, or out of the binary of an FMU."""
    return exact.is_certain or (dae.is_affine and dae.source == "symbolic")


def disagreement(exact: Structure, form: StandardForm | SparseForm | None) -> tuple[str, ...]:
    """The doubt where numbers that may be rounded decide otherwise exactly than in floating point."""
    if exact.is_certain or (form and (form.index, form.n_dynamic) == (exact.index, exact.n_dynamic)):
        return ()
    found = f"index {form.index} and {form.n_dynamic} modes" if form else "a singular pencil"
    return (
        f"taken at every digit, the numbers of the model give index {exact.index} and {exact.n_dynamic} "
        f"modes; in floating point, where differences of the size of rounding errors are none, {found}",
    )


def doubtful_decisions(decisions: Sequence[RankDecision]) -> tuple[str, ...]:
    """The rank decisions of floating point that another threshold near by would turn."""
    return tuple(filter(None, map(warning, decisions)))


def _by_values(dae: LinearDAE, tolerance: float | None) -> StandardForm:
    """Every rank by singular values."""
    try:
        return _by_singular_values(dae, tolerance)
    except np.linalg.LinAlgError as error:
        raise _ill_conditioned("the finite modes cannot be told from the algebraic part") from error


def _ill_conditioned(what: str) -> NumericalError:
    return NumericalError(
        "standard-form-ill-conditioned",
        what,
        remedy="check the parameters for values that are many orders of magnitude too large or too small",
    )


def _by_singular_values(dae: LinearDAE, tolerance: float | None) -> StandardForm:
    try:
        reduction = reduce_structure(dae, tolerance)
        core = split_pencil(reduction.core_E, reduction.core_J, tolerance)
    except NumericalError as error:
        if error.code != "pencil-singular":
            raise
        raise dependent_equations(dae) from error
    form = _expand(reduction, core, tolerance)
    return _finished(form, dae, reduction.scaling)


def _by_structure(dae: LinearDAE, exact: ExactStructure, by_values: StandardForm | None) -> StandardForm:
    """The standard form that exact arithmetic prescribes: of many digits where the pencil is small, else by
    a staircase of known levels."""
    scaling = unit_scaling(dae.E, dae.J)
    E, J = apply_scaling(scaling, sp.csr_array(dae.E), sp.csr_array(dae.J))
    decisions = by_values.decisions if by_values else ()
    doubts = disagreement(exact, by_values)
    if dae.n > PRECISE_LIMIT or not isinstance(exact.infinity, DenseInfinity):
        try:
            form = _unscaled(split_pencil(E, J, sizes=exact.level_sizes), scaling)
            return replace(_finished(form, dae, scaling), exact=exact, doubts=doubts)
        except np.linalg.LinAlgError as error:
            raise _ill_conditioned(f"{exact.n_dynamic} modes leave no digits in floating point") from error
    weights = _state_weights(dae, exact, by_values)
    found = precise_form(sp.csr_array(E).toarray(), sp.csr_array(J).toarray(), exact.infinity, weights)
    form = StandardForm(found.left, found.right, found.A, found.N, exact.index, decisions, exact, doubts)
    form = _scale_infinite(_in_units(_unscaled(form, scaling), scaling.columns[found.states]))
    return replace(form, poles=found.poles * scaling.time)


def _state_weights(dae: LinearDAE, exact: ExactStructure, by_values: StandardForm | None) -> np.ndarray:
    """(n,) what a row of Q1 is worth as a state: the states that there are already, or by preference."""
    weights = np.zeros(dae.n)
    candidates = _candidates(dae)
    if by_values is None or by_values.n_dynamic != exact.n_dynamic:
        weights[candidates] = [_preference(dae.unknowns[i]) for i in candidates]
        return weights
    Q1 = by_values.right[candidates, : by_values.n_dynamic]
    for unit in np.eye(by_values.n_dynamic):
        weights[candidates[np.flatnonzero(np.all(unit == Q1, axis=1))[:1]]] = 1.0
    return weights


def _in_units(form: StandardForm, units: np.ndarray) -> StandardForm:
    """The form with `units` · z1 in place of z1."""
    left, right = form.left.copy(), form.right.copy()
    left[: units.size] *= units[:, None]
    right[:, : units.size] /= units
    return replace(form, left=left, right=right, A=units[:, None] * form.A / units)


def _unscaled(form: StandardForm, scaling: Scaling) -> StandardForm:
    left = scaling.rows * form.left
    left[: form.n_dynamic] *= scaling.time
    right = scaling.columns[:, None] * form.right
    return replace(form, left=left, right=right, A=form.A * scaling.time, N=form.N / scaling.time)


def _finished(form: StandardForm, dae: LinearDAE, scaling: Scaling) -> StandardForm:
    form = _name_dynamic(form, dae, scaling.columns)
    return _scale_infinite(_solve_left(form, dae, scaling.rows))


def _check_structure(dae: LinearDAE) -> None:
    """Raise ModelError when no assignment of equations to unknowns exists (Dulmage-Mendelsohn)."""
    J, E = sp.coo_array(sp.csr_array(dae.J)), sp.coo_array(sp.csr_array(dae.E))
    rows = np.concatenate([J.coords[0], E.coords[0]])[np.concatenate([J.data, E.data]) != 0]
    columns = np.concatenate([J.coords[1], E.coords[1]])[np.concatenate([J.data, E.data]) != 0]
    sigma = Signature(rows, columns, np.zeros(rows.size, dtype=int), dae.n)
    check_structure(sigma, dae.equations, dae.unknowns, "the model")


def dependent_equations(dae: LinearDAE) -> ModelError:
    """The error of a singular pencil, naming the equations of the null vector of sE - J at a random s."""
    scaling = unit_scaling(dae.E, dae.J)
    vector = sla.svd(_at_random_point(dae).toarray())[0][:, -1] if dae.n < ITERATED else null_vector(dae)
    vector = np.ones(dae.n) if vector is None else vector
    weights = vector * scaling.rows
    weights = weights / np.max(np.abs(weights))
    share = np.abs(vector) / np.max(np.abs(vector))
    order = [int(i) for i in np.argsort(-share, kind="stable") if share[i] >= NULL_VECTOR_SHARE]
    places = [dae.equations[i].place for i in order]
    here, elsewhere, remedy = _where_dependent(dae)
    return ModelError(
        "pencil-singular",
        "\n".join(
            [
                f"{here}the equations do not determine the unknowns: det(sE - J) is zero for every s, "
                "because this sum of equations vanishes (weights before the equations):",
                *_weighted(dae, weights, order),
                *elsewhere,
            ]
        ),
        where=next((place for place in places if place is not None), None),
        remedy=remedy,
    )


def _where_dependent(dae: LinearDAE) -> tuple[str, list[str], str]:
    """Beginning, last lines and remedy of the message: whether the equations depend on each other at these
    parameter values alone."""
    generic = generic_structure(dae)
    if generic is None:
        return "", [], "one of these equations repeats the others, or contradicts them: remove or correct it"
    regular = (
        f"for almost every other value of the parameters they do (index {generic.index}, "
        f"{generic.n_dynamic} dynamic modes); {special_values(dae, lambda _: True)}"
    )
    remedy = "change that value, or leave out the equations that it makes dependent"
    return "at these values of the parameters ", [regular], remedy


def _at_random_point(dae: LinearDAE) -> sp.csr_array:
    """sE - J of the scaled pencil at a random s: any s that is no pole would do."""
    E, J = sp.csr_array(dae.E), sp.csr_array(dae.J)
    E, J = apply_scaling(unit_scaling(E, J), E, J)
    return sp.csr_array(np.random.default_rng(0).uniform(0.5, 2.0) * E - J)


def null_vector(dae: LinearDAE) -> np.ndarray | None:
    """The combination of equations (n,), scaled, that vanishes at a random s; None if there is none.

    Inverse iteration with the sparse factors of a slightly disturbed matrix; a null vector leaves
    `VANISHES` at most.
    """
    matrix = _at_random_point(dae)
    rng = np.random.default_rng(1)
    disturbed = matrix + sp.diags_array(VANISHES * 0.1 * rng.uniform(0.5, 1.0, dae.n))
    try:
        factors = spla.splu(sp.csc_array(disturbed))
    except RuntimeError:  # a zero pivot all the same: no vector can be computed this way
        return None
    vector = rng.normal(size=dae.n)
    for _ in range(INVERSE_ITERATIONS):
        vector = factors.solve(factors.solve(vector), trans="T")
        vector /= np.linalg.norm(vector)
    return vector if np.linalg.norm(matrix.T @ vector) <= VANISHES else None


def _weighted(dae: LinearDAE, weights: np.ndarray, order: list[int]) -> list[str]:
    """One line `weight  text  (place)` per equation, at most `LISTED`."""
    lines = []
    for i in order[:LISTED]:
        place = dae.equations[i].place
        lines.append(f"    {weights[i]:+.3g}  {dae.equations[i].text}" + (f"  ({place})" if place else ""))
    return lines + ([f"    … and {len(order) - LISTED} more"] if len(order) > LISTED else [])


def reduce_structure(dae: LinearDAE, tolerance: float | None = None) -> Reduction:
    """Solve the equations without derivatives for as many unknowns, sparse; undifferentiated ones first.

    Raises NumericalError `pencil-singular` when these equations are linearly dependent.
    """
    E, J = sp.csr_array(dae.E), sp.csr_array(dae.J)
    E.eliminate_zeros()
    scaling = unit_scaling(E, J)
    E, J = apply_scaling(scaling, E, J)
    n = dae.n
    is_free = np.diff(sp.csr_array(E).indptr) == 0
    has_derivative = np.diff(sp.csc_array(E).indptr) > 0
    zero = default_tolerance(n) if tolerance is None else tolerance
    pivots = choose_pivots(J, np.flatnonzero(is_free), has_derivative, zero)
    if pivots.dependent_rows.size:
        raise NumericalError(
            "pencil-singular",
            f"{pivots.dependent_rows.size} equations without derivatives are combinations of others.",
        )
    free, solved = pivots.rows, pivots.columns
    core_rows = np.flatnonzero(~is_free)
    rest = np.setdiff1d(np.arange(n), solved)
    inverse, dependence = _solve_free(J[free][:, solved], J[free][:, rest])
    E21, J21 = E[core_rows][:, solved], J[core_rows][:, solved]
    return Reduction(
        scaling,
        core_rows,
        free,
        rest,
        solved,
        inverse,
        dependence,
        E21,
        J21,
        _difference(sp.csr_array(E[core_rows][:, rest]).toarray(), E21, dependence),
        _difference(sp.csr_array(J[core_rows][:, rest]).toarray(), J21, dependence),
    )


def _solve_free(J11: sp.csr_array, J12: sp.csr_array) -> tuple[np.ndarray, np.ndarray]:
    """J11⁻¹ and J11⁻¹ J12; what rounding could have made, eps |J11⁻¹| |J11| |result|, is zero.

    Zeros must be exact here: a rounding error alone in a column of E would pass for a derivative.
    """
    if J11.shape[0] == 0:
        return np.zeros((0, 0)), np.zeros(J12.shape)
    inverse = spla.splu(sp.csc_array(J11)).solve(np.eye(J11.shape[0]))
    propagation = np.abs(inverse) @ abs(J11)
    results = []
    for value in (inverse, inverse @ J12):
        rounding = default_tolerance(1) * (propagation @ np.abs(value))
        results.append(np.where(np.abs(value) > rounding, value, 0.0))
    return results[0], results[1]


def _difference(block: np.ndarray, factor: sp.csr_array, dependence: np.ndarray) -> np.ndarray:
    """block - factor · dependence; entries that cancel to rounding are zero."""
    value = block - factor @ dependence
    size = np.abs(block) + abs(factor) @ np.abs(dependence)
    return np.where(np.abs(value) > default_tolerance(1) * size, value, 0.0)


def _expand(reduction: Reduction, core: StandardForm, tolerance: float | None) -> StandardForm:
    """Standard form of the whole model from the one of its core.

    With core rows E = [I, 0, F; 0, N_c, G], where [F; G] = P_c E21 are the columns of the solved unknowns and
    their rows of E are zero, the columns -F take F out, and N = [[N_c, G], [0, 0]].
    """
    n1, n_core, n_free = core.n_dynamic, core.left.shape[0], reduction.free_rows.size
    coupling = core.left @ reduction.E21.toarray()
    F, G = coupling[:n1], coupling[n1:]
    inverse = reduction.inverse
    left = np.zeros((n_core + n_free, n_core + n_free))
    left[:n_core, reduction.core_rows] = core.left
    left[:n_core, reduction.free_rows] = -(core.left @ (reduction.J21 @ inverse))
    left[:n1, reduction.free_rows] += core.A @ F @ inverse
    left[n_core:, reduction.free_rows] = inverse
    right = np.zeros_like(left)
    right[reduction.rest, :n_core] = core.right
    right[reduction.rest, n_core:] = -core.right[:, :n1] @ F
    right[reduction.solved] = -reduction.dependence @ right[reduction.rest]
    right[reduction.solved, np.arange(n_core, n_core + n_free)] += 1.0
    N = np.zeros((n_core - n1 + n_free,) * 2)
    N[: n_core - n1, : n_core - n1] = core.N
    N[: n_core - n1, n_core - n1 :] = G
    rows, columns = _lengths(core.left[n1:], axis=1), _lengths(core.right[:, n1:], axis=0)
    size_of_N = np.outer(rows * np.linalg.norm(reduction.core_E), columns)
    size_of_G = np.outer(rows, _lengths(reduction.E21.toarray(), axis=0))
    index, decisions = _index(core, G, size_of_N, size_of_G, tolerance)
    scaling = reduction.scaling
    left[:n1] *= scaling.time
    return StandardForm(
        left * scaling.rows,
        scaling.columns[:, None] * right,
        core.A * scaling.time,
        N / scaling.time,
        index,
        decisions,
    )


def _lengths(matrix: np.ndarray, axis: int) -> np.ndarray:
    return np.linalg.norm(matrix, axis=axis) if matrix.size else np.zeros(matrix.shape[1 - axis])


def _index(
    core: StandardForm, G: np.ndarray, size_of_N: np.ndarray, size_of_G: np.ndarray, tolerance: float | None
) -> tuple[int, tuple[RankDecision, ...]]:
    """Nilpotency index of [[N_c, G], [0, 0]]: that of N_c, or one more if N_c^(index-1) G is not zero.

    `size_of_N` and `size_of_G` (in their shapes) bound N = P2 E Q2 and G = P2 E21 by the lengths of rows and
    columns: rounding errors of the factors are relative to these, for N or G itself may be nothing but such.
    """
    if G.shape[1] == 0:
        return core.index, core.decisions
    if core.index == 0:
        return 1, core.decisions
    zero = default_tolerance(max(G.shape)) if tolerance is None else tolerance
    power = np.linalg.matrix_power(core.N, core.index - 1) @ G
    sizes = np.linalg.matrix_power(np.abs(core.N), core.index - 1) @ np.abs(G)
    disturbed = np.linalg.matrix_power(np.abs(core.N) + zero * size_of_N, core.index - 1)
    error = disturbed @ (np.abs(G) + zero * size_of_G) - sizes
    norm = float(sla.norm(error / zero + sizes))
    what = f"N^{core.index}, eliminated unknowns"
    decision = decide_rank(what, sla.svdvals(power), max(G.shape), norm, tolerance)
    return core.index + (1 if decision.rank else 0), (*core.decisions, decision)


def _name_dynamic(form: StandardForm, dae: LinearDAE, scales: np.ndarray) -> StandardForm:
    """Choose z1 among the unknowns that occur differentiated: E Q1 has full rank, so they suffice.

    `scales` of the unknowns make the choice independent of units; among equals it favours what the model
    prefers as a state, and variables of components over those of their connectors. Entries of Q1 that are
    rounding errors in these scales become zero, so that unconnected states stay unconnected.
    """
    n1 = form.n_dynamic
    if n1 == 0:
        return form
    rows = _state_rows(form.right[:, :n1] / scales[:, None], dae)
    right = form.right.copy()
    scaled = form.right[rows, :n1] / scales[rows, None]  # well conditioned, whatever the units
    relative = np.linalg.solve(scaled.T, form.right[:, :n1].T).T
    sizes = np.abs(relative)
    is_rounding = sizes <= default_tolerance(n1) * sizes.max(axis=1, keepdims=True)
    Q1 = np.where(is_rounding, 0.0, relative) / scales[rows]
    Q1[rows] = np.eye(n1)
    right[:, :n1] = Q1
    return replace(form, right=right)


def _state_rows(basis: np.ndarray, dae: LinearDAE) -> np.ndarray:
    """Rows of a basis (n, n_dynamic) of the finite subspace, in scaled unknowns, that are to be states."""
    candidates = _candidates(dae)
    preference = np.array([_preference(dae.unknowns[i]) for i in candidates])
    _, _, order = sla.qr((preference[:, None] * basis[candidates]).T, pivoting=True)
    return np.sort(candidates[order[: basis.shape[1]]])


def _candidates(dae: LinearDAE) -> np.ndarray:
    """Unknowns that occur differentiated."""
    return np.flatnonzero(np.diff(sp.csc_array(dae.E).indptr) > 0)


def _preference(unknown: Variable) -> float:
    """Weight of an unknown as a state; factors of two and four, so that conditioning still decides."""
    selected = {"never": 0.25, "avoid": 0.5, "default": 1.0, "prefer": 2.0, "always": 4.0, "kept": 8.0}
    return selected[unknown.state_select] * 0.5 ** max(unknown.name.count(".") - 1, 0)


def _solve_left(form: StandardForm, dae: LinearDAE, row_scales: np.ndarray) -> StandardForm:
    """P = [E Q1, J Q2]⁻¹ and A = P1 J Q1, by one sparse LU of the scaled matrix.

    P is unique once Q is chosen. Solving for it anew, in the units of the model, keeps its small rows and
    its zeros, which products of orthogonal matrices blur to the size of the largest entries. What
    rounding could have made, eps |P| |M| |P| in P and relative to the sums in A, becomes zero.

    Raises NumericalError `standard-form-ill-conditioned` when [E Q1, J Q2] is singular to rounding.
    """
    if not dae.n:
        return form
    n1 = form.n_dynamic
    E, J = sp.csr_array(dae.E), sp.csr_array(dae.J)
    M = np.hstack([E @ form.right[:, :n1], J @ form.right[:, n1:]])
    M *= row_scales[:, None]
    column_scales = np.exp2(-np.round(np.log2(np.abs(M).max(axis=0))))
    try:
        inverse = spla.splu(sp.csc_array(M * column_scales)).solve(np.eye(dae.n))
    except RuntimeError as error:  # the way in which SuperLU tells of a zero pivot
        raise _ill_conditioned(
            f"the {n1} finite modes that the rank decisions leave cannot be told from the algebraic part"
        ) from error
    size = np.abs(inverse)
    rounding = default_tolerance(1) * (size @ np.abs(M * column_scales) @ size)
    inverse = np.where(size > rounding, inverse, 0.0)
    left = column_scales[:, None] * inverse * row_scales
    A = left[:n1] @ (J @ form.right[:, :n1])
    size = np.abs(left[:n1]) @ (abs(J) @ np.abs(form.right[:, :n1]))
    return replace(form, left=left, A=np.where(np.abs(A) > default_tolerance(dae.n) * size, A, 0.0))


def _scale_infinite(form: StandardForm) -> StandardForm:
    """Choose z2 such that |z2| is the distance of ξ from the range of Q1 (orthonormal in that quotient).

    This is the form that the generalized Schur decomposition with the finite eigenvalues first leads to; N is
    then unique up to a rotation, and its singular values belong to the model as it stands. Where units are
    too far apart for that (`WORST_BASIS`), the form is returned as it is.
    """
    n1 = form.n_dynamic
    Q1, Q2 = sla.qr(form.right[:, :n1], mode="economic")[0] if n1 else form.right[:, :0], form.right[:, n1:]
    if Q2.shape[1] == 0:
        return form
    R = sla.qr(Q2 - Q1 @ (Q1.T @ Q2), mode="r")[0][: Q2.shape[1]]
    if not np.all(np.diag(R)) or _skeel_condition(R) > WORST_BASIS:
        return form
    left, right = form.left.copy(), form.right.copy()
    left[n1:] = R @ left[n1:]
    right[:, n1:] = sla.solve_triangular(R, Q2.T, trans="T").T
    N = sla.solve_triangular(R, (R @ form.N).T, trans="T").T
    return replace(form, left=left, right=right, N=np.where(np.triu(np.ones_like(N), 1) > 0, N, 0.0))


def _skeel_condition(R: np.ndarray) -> float:
    """Largest row sum of |R⁻¹| |R| for a triangular R: a condition number that does not see row scaling."""
    inverse = sla.solve_triangular(R, np.eye(len(R)))
    return float(np.max(np.abs(inverse) @ np.abs(R).sum(axis=1)))
