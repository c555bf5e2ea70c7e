"""Staircase splitting against pencils of prescribed Weierstrass structure."""

from dataclasses import dataclass

import numpy as np
import pytest
import scipy.linalg as sla

from daest.errors import NumericalError
from daest.numerics.pencils import equilibrate, split_pencil, staircase

REBUILT = 1e-9  # relative, asked for by the specification


@dataclass
class Prescribed:
    E: np.ndarray
    J: np.ndarray
    A: np.ndarray
    blocks: list[int]  # sizes of the nilpotent Jordan blocks

    @property
    def index(self) -> int:
        return max(self.blocks, default=0)


def turned(rng: np.random.Generator, n: int, condition: float) -> np.ndarray:
    """Random matrix with log-uniform singular values between 1 and `condition`."""
    left, right = (np.linalg.qr(rng.normal(size=(n, n)))[0] for _ in range(2))
    return (left * np.exp(rng.uniform(0, np.log(condition), n))) @ right


def finite_block(rng: np.random.Generator, kind: int, n: int) -> np.ndarray:
    A = rng.normal(size=(n, n))
    if kind == 1:  # zero modes
        A[:, :2] = 0.0
    elif kind == 2:  # one defective multiple eigenvalue
        A = -2.0 * np.eye(n) + np.eye(n, k=1)
    elif kind == 3:  # the same oscillator several times
        A = sla.block_diag(*[np.array([[-0.1, 1.0], [-1.0, -0.1]])] * (n // 2), *[[0.0]] * (n % 2))
        A = A.reshape(n, n)
    return A


def prescribed(seed: int, condition: float = 100.0, scales: float = 0.0) -> Prescribed:
    """Size to 60, index 0 to 4, several nilpotent blocks; rows and columns scaled by 10^±scales."""
    rng = np.random.default_rng(seed)
    index = seed % 5
    n_finite = int(rng.integers(0, 30)) if index else int(rng.integers(1, 30))
    others = [int(rng.integers(1, index + 1)) for _ in range(rng.integers(0, 6))] if index else []
    blocks = [index, *others] if index else []
    A = finite_block(rng, int(rng.integers(0, 4)), n_finite)
    N = sla.block_diag(*[np.eye(b, k=1) for b in blocks]) if blocks else np.zeros((0, 0))
    n = n_finite + sum(blocks)
    left, right = turned(rng, n, condition), turned(rng, n, condition)
    rows, columns = (10.0 ** rng.uniform(-scales, scales, n) for _ in range(2))
    E = left @ sla.block_diag(np.eye(n_finite), N) @ right
    J = left @ sla.block_diag(A, np.eye(sum(blocks))) @ right
    return Prescribed(rows[:, None] * E * columns, rows[:, None] * J * columns, A, blocks)


@pytest.mark.parametrize("condition", [10.0, 1000.0])
@pytest.mark.parametrize("scales", [0.0, 6.0])
@pytest.mark.parametrize("n_pencils", [25, pytest.param(100, marks=pytest.mark.slow)])
def test_index_counts_and_rebuilding_of_random_pencils(n_pencils, condition, scales):
    for seed in range(n_pencils):
        case = prescribed(seed, condition, scales)
        form = split_pencil(case.E, case.J)
        n_infinite = sum(case.blocks)
        assert (form.index, form.n_dynamic) == (case.index, len(case.A)), seed
        first = sla.block_diag(np.eye(form.n_dynamic), form.N)
        second = sla.block_diag(form.A, np.eye(n_infinite))
        for matrix, target in ((case.E, first), (case.J, second)):
            error = np.linalg.norm(form.left @ matrix @ form.right - target)
            assert error <= REBUILT * np.linalg.norm(target), seed
        assert not np.any(np.linalg.matrix_power(form.N, form.index)) or form.index == 0
        assert min(d.gap for d in form.decisions) > 1e6, seed


@pytest.mark.parametrize("seed", range(0, 100, 7))
def test_spectrum_and_nilpotent_structure(seed):
    case = prescribed(seed)
    form = split_pencil(case.E, case.J)
    # Coefficients of the characteristic polynomial do not suffer from defective eigenvalues as these do.
    s = 0.3 + 0.7j
    got = np.linalg.slogdet(s * np.eye(len(case.A)) - form.A)
    want = np.linalg.slogdet(s * np.eye(len(case.A)) - case.A)
    assert got[1] == pytest.approx(want[1], rel=1e-8, abs=1e-8)
    assert got[0] == pytest.approx(want[0], abs=1e-8)
    # Weyr characteristic: dim ker N^k counts the blocks, block by block min(size, k).
    for k in range(1, form.index + 1):
        values = np.linalg.svd(np.linalg.matrix_power(form.N, k), compute_uv=False)
        nullity = len(values) - np.sum(values > 1e-8 * max(1.0, values.max(initial=0.0)))
        assert nullity == sum(min(size, k) for size in case.blocks)


def test_ordinary_differential_equation():
    rng = np.random.default_rng(3)
    E, J = rng.normal(size=(5, 5)), rng.normal(size=(5, 5))
    form = split_pencil(E, J)
    assert (form.index, form.n_dynamic, form.N.shape) == (0, 5, (0, 0))
    np.testing.assert_allclose(
        np.sort_complex(np.linalg.eigvals(form.A)),
        np.sort_complex(np.linalg.eigvals(np.linalg.solve(E, J))),
        rtol=1e-9,
    )


def test_purely_algebraic_and_empty():
    form = split_pencil(np.zeros((3, 3)), np.diag([1.0, 2.0, 3.0]))
    assert (form.index, form.n_dynamic) == (1, 0)
    assert not np.any(form.N)
    assert split_pencil(np.zeros((0, 0)), np.zeros((0, 0))).index == 0


def test_scaling_by_powers_of_two_changes_no_decision_and_no_pole():
    case = prescribed(4)
    rng = np.random.default_rng(5)
    rows, columns = (2.0 ** rng.integers(-20, 20, len(case.E)) for _ in range(2))
    plain = split_pencil(case.E, case.J)
    scaled = split_pencil(rows[:, None] * case.E * columns, rows[:, None] * case.J * columns)
    assert (scaled.index, scaled.n_dynamic) == (plain.index, plain.n_dynamic)
    s = 1.7
    assert np.linalg.det(s * np.eye(plain.n_dynamic) - scaled.A) == pytest.approx(
        np.linalg.det(s * np.eye(plain.n_dynamic) - plain.A), rel=1e-8
    )


def test_staircase_is_orthogonal_and_block_triangular():
    case = prescribed(8)
    stair = staircase(case.E, case.J)
    n = len(case.E)
    for matrix in (stair.left, stair.right):
        np.testing.assert_allclose(matrix.T @ matrix, np.eye(n), atol=1e-13)
    np.testing.assert_allclose(
        stair.left.T @ case.E @ stair.right, stair.E, atol=1e-12 * np.linalg.norm(case.E)
    )
    assert stair.sizes == tuple(sum(b > k for b in case.blocks) for k in range(case.index))
    assert not np.any(stair.E[: stair.n_finite, stair.n_finite :])


@pytest.mark.parametrize("kind", ["dependent rows", "zero column", "polynomial null vector"])
def test_singular_pencil_is_refused(kind):
    rng = np.random.default_rng(11)
    E, J = rng.normal(size=(6, 6)), rng.normal(size=(6, 6))
    if kind == "dependent rows":
        E[5], J[5] = E[:5].sum(axis=0), J[:5].sum(axis=0)
    elif kind == "zero column":
        E[:, 2] = J[:, 2] = 0.0
    else:  # Kronecker blocks L1 and L1', turned: no constant null vector on either side
        E, J = np.zeros((3, 3)), np.zeros((3, 3))
        E[0, 0] = J[0, 1] = 1.0
        E[1, 2] = J[2, 2] = 1.0
        left, right = turned(rng, 3, 10.0), turned(rng, 3, 10.0)
        E, J = left @ E @ right, left @ J @ right
    with pytest.raises(NumericalError) as caught:
        split_pencil(E, J)
    assert caught.value.code == "pencil-singular"


def test_equilibration_recovers_scales():
    case = prescribed(9, condition=10.0, scales=8.0)
    scaling = equilibrate(case.E, case.J)
    E = scaling.time * scaling.rows[:, None] * case.E * scaling.columns
    J = scaling.rows[:, None] * case.J * scaling.columns
    size = np.maximum(np.abs(E), np.abs(J))
    assert np.max(size.max(axis=0)) / np.min(size.max(axis=0)) < 1e3
    assert np.array_equal(scaling.rows, 2.0 ** np.round(np.log2(scaling.rows)))
