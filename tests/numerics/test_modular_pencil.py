"""Dense and sparse exact arithmetic at infinity against each other, and numbers that doubles stand for."""

from fractions import Fraction

import numpy as np
import pytest

from daest.numerics.exact_numbers import prime, read_number, residue
from daest.numerics.exact_units import Entry, simple_in_other_units
from daest.numerics.modular_pencil import ModularPencil, SingularPencil, dense_infinity
from daest.numerics.sparse_infinity import factorise, sparse_infinity


def modular(E: np.ndarray, J: np.ndarray) -> ModularPencil:
    p = prime(0)
    rows, columns = np.nonzero((E != 0) | (J != 0))
    e, j = ([int(v) % p for v in matrix[rows, columns]] for matrix in (E, J))
    return ModularPencil(len(E), p, rows.tolist(), columns.tolist(), e, j)


@pytest.mark.parametrize("seed", range(30))
def test_sparse_and_dense_agree(seed):
    """Small integers, where values often cancel what the structure promises."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 16))
    E, J = (rng.integers(-1, 2, (n, n)) * (rng.random((n, n)) < share / n) for share in (2.0, 3.0))
    pencil = modular(E, J + np.diag(rng.integers(0, 2, n)))
    try:
        dense = dense_infinity(pencil)
    except SingularPencil:
        with pytest.raises(SingularPencil):
            sparse_infinity(pencil)
        return
    sparse = sparse_infinity(pencil)
    assert (sparse.n_dynamic, sparse.index, sparse.rank_of_e) == (
        dense.n_dynamic,
        dense.index,
        dense.rank_of_e,
    )
    np.testing.assert_array_equal(sparse.orders(), dense.orders())
    column = [(0, 2), (n - 1, 5)]
    for m in range(dense.index):
        np.testing.assert_array_equal(sparse.response(m, column), dense.response(m, column))


def test_values_that_cancel_the_structure_replace_equations():
    """x' + y' = x, x' + y' = 2 y: one mode, two by the structure."""
    found = sparse_infinity(modular(np.ones((2, 2), dtype=int), np.diag([1, 2])))
    assert (found.n_dynamic, found.index, len(found.rounds)) == (1, 1, 1)


def test_elimination_solves_both_ways():
    rng = np.random.default_rng(4)
    n, p = 12, prime(0)
    matrix = (rng.integers(-9, 10, (n, n)) * (rng.random((n, n)) < 0.4) + np.eye(n) * 11).astype(int)
    factors = factorise([{j: int(v) % p for j, v in enumerate(row) if v} for row in matrix], p)
    right = {1: 3, 7: p - 2}
    wanted = [right.get(i, 0) for i in range(n)]
    for found, applied in (
        (factors.solve(right), matrix),
        (factors.solve_transposed(right), matrix.T),
    ):
        products = [sum(int(a) * found.get(k, 0) for k, a in enumerate(row)) % p for row in applied]
        assert products == wanted


@pytest.mark.parametrize(
    ("number", "value"),
    [
        (0.1, Fraction(1, 10)),
        (1 / 30, Fraction(1, 30)),
        (0.1 + 0.2, Fraction(3, 10)),
        (3 * 1e-9, Fraction(3, 10**9)),
        (2 / 3 * 2.0**-40, Fraction(1, 3 * 2**39)),
        (-0.123456789012, Fraction(-123456789012, 10**12)),
    ],
)
def test_numbers_that_somebody_wrote(number, value):
    assert read_number(number).value == value and read_number(number).is_simple


def test_other_numbers_stand_for_themselves():
    for number in (np.pi, np.sqrt(2.0), 1.0 / 12345.0 / 67891.0):
        assert read_number(float(number)).value == Fraction(float(number))
        assert not read_number(float(number)).is_simple


def test_residues_are_those_of_fractions():
    p = prime(1)
    assert residue(Fraction(2, 3), p) * 3 % p == 2
    with pytest.raises(ZeroDivisionError):
        residue(Fraction(1, p), p)


def test_units_are_taken_out():
    """Rows, columns and time in any units: the ratios around every cycle are those of the integers."""
    rng = np.random.default_rng(2)
    n = 8
    A = rng.integers(-3, 4, (2, n, n)) * (rng.random((2, n, n)) < 0.5)
    rows, columns, time = 10.0 ** rng.uniform(-2, 2, n), 10.0 ** rng.uniform(-2, 2, n), 3.7412345
    entries = [
        Entry(i, j, float(A[k, i, j] * rows[i] * columns[j] * time**k), k)
        for k, i, j in np.argwhere(A).tolist()
    ]
    found = simple_in_other_units(entries)
    ratios = np.array([float(f) / A[e.power, e.row, e.column] for f, e in zip(found, entries, strict=True)])
    design = np.zeros((len(entries), 2 * n + 1))
    for k, entry in enumerate(entries):
        design[k, [entry.row, n + entry.column, 2 * n]] = 1, 1, entry.power
    rest = np.linalg.lstsq(design, np.log(np.abs(ratios)), rcond=None)[1]
    assert np.all(rest < 1e-20)


def test_no_units_make_a_cycle_of_pi_simple():
    corners = [(0, 0, 1.0), (0, 1, 2.0), (1, 0, 3.0), (1, 1, float(np.pi))]
    assert simple_in_other_units([Entry(i, j, value, 0) for i, j, value in corners]) is None
