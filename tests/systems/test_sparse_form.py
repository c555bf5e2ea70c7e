"""The sparse form and its verdicts against the dense ones, and against ordered QZ where that can tell."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg as sla
import scipy.sparse as sp

import daest
from daest.errors import ModelError, NumericalError
from daest.numerics.laurent import expand_at_infinity, inverse_columns, inverse_rows
from daest.systems.linear.noise import noise_report
from daest.systems.linear.sparse_form import sparse_form
from daest.systems.linear.split import split
from daest.systems.linear.standard_form import standard_form
from daest.systems.linear.transfer import poles, transfer_functions

MODELS = sorted(Path(__file__).parents[2].glob("examples/*/*.mo"))
LARGE = Path(__file__).parent / "models"


def large(name: str, n: int):
    return daest.linearize(daest.compile_model(LARGE / f"{name}.mo", overrides={"n": n}))


def assert_same_reports(dense, sparse):
    assert (sparse.n_dynamic, sparse.index, sparse.n_forbidden) == (
        dense.n_dynamic,
        dense.index,
        dense.n_forbidden,
    )
    for a, b in zip((*dense.places, *dense.annotated), (*sparse.places, *sparse.annotated), strict=True):
        assert dataclasses.replace(a, projection_norm=0.0) == dataclasses.replace(b, projection_norm=0.0)
        assert b.projection_norm == pytest.approx(a.projection_norm, abs=1e-10)
    np.testing.assert_allclose(sparse.N_singular_values, dense.N_singular_values, atol=1e-7)


LARGER = (
    ("Grid", 3),
    ("Gears", 4),
    ("Resistors", 6),
    ("Chain", 7),
    ("Ladder", 12),
    ("Resistors", 12),
    ("Rigid", 12),
    ("Gears", 6),
)


@pytest.mark.parametrize("path", MODELS, ids=lambda path: path.parent.name)
def test_verdicts_on_every_example(path):
    dae = daest.linearize(daest.compile_model(path))
    assert_same_reports(noise_report(dae, split(dae)), noise_report(dae, sparse_form(dae)))


@pytest.mark.parametrize(
    ("name", "n"),
    [
        ("Chain", 5),
        pytest.param("Ladder", 6, marks=pytest.mark.slow),
        ("Rigid", 6),
        *(pytest.param(name, n, marks=pytest.mark.slow) for name, n in LARGER),
    ],
)
def test_verdicts_poles_and_transfer_functions_of_arrays(name, n):
    dae = large(name, n)
    dense, sparse = split(dae), sparse_form(dae)
    assert_same_reports(noise_report(dae, dense), noise_report(dae, sparse))
    a, b = poles(dense), poles(sparse)
    np.testing.assert_allclose(np.sort_complex(b), np.sort_complex(a), rtol=1e-6, atol=1e-6)
    s = 0.3 + 2j
    exact = np.linalg.solve(s * sp.csr_array(dae.E).toarray() - sp.csr_array(dae.J).toarray(), dae.K)
    for function in transfer_functions(dae, sparse):
        assert function(s) == pytest.approx(complex((dae.C @ exact + dae.D)[0, 0]), rel=1e-5, abs=1e-12)


FURTHER = (("Chain", 7), ("Rigid", 12), ("Gears", 6))


@pytest.mark.parametrize(
    ("name", "n"), [("Grid", 3), *(pytest.param(*case, marks=pytest.mark.slow) for case in FURTHER)]
)
def test_projection_norms_from_one_inverse(name, n, monkeypatch):
    monkeypatch.setattr("daest.systems.linear.nilpotent.SELECTED", 1)
    dae = large(name, n)
    assert_same_reports(noise_report(dae, split(dae)), noise_report(dae, sparse_form(dae)))


def test_the_form_satisfies_its_equations():
    dae = large("Chain", 40)
    form, E, J = sparse_form(dae), sp.csr_array(dae.E), sp.csr_array(dae.J)
    P1, Q1 = form.left_dynamic, form.right_dynamic
    assert abs(P1 @ E @ Q1 - sp.eye_array(form.n_dynamic)).max() < 1e-12
    assert abs(J @ Q1 - E @ Q1 @ form.A).max() < 1e-9
    assert abs(Q1[form.states] - sp.eye_array(form.n_dynamic)).max() < 1e-12


SEEDS = [pytest.param(seed, marks=pytest.mark.slow if seed >= 6 else ()) for seed in range(12)]


@pytest.mark.parametrize("seed", SEEDS)
def test_random_sparse_pencils(seed):
    """Coefficients at infinity of scattered index-1 to 3 pencils, against the inverse at two large s."""
    rng = np.random.default_rng(seed)
    E, J = scattered_pencil(rng)
    expansion = expand_at_infinity(sp.csr_array(E), sp.csr_array(J))
    everything = np.arange(len(E))
    powers = range(-6, expansion.highest_power + 1)
    columns = inverse_columns(expansion, everything, list(powers))
    rows = inverse_rows(expansion, everything, list(powers))
    s = 300.0
    total = sum(columns[m].toarray() * s**m for m in powers)
    exact = np.linalg.inv(s * E - J)
    np.testing.assert_allclose(total, exact, atol=1e-9 * np.abs(exact).max())
    for m in powers:
        np.testing.assert_allclose(rows[m].toarray(), columns[m].toarray(), atol=1e-9)
    finite = np.abs(sla.eig(J, E, homogeneous_eigvals=True)[0])
    assert expansion.degree == np.count_nonzero(finite[1] > 1e-5 * finite[0])


def scattered_pencil(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """diag of oscillators and nilpotent blocks, coupled above the diagonal, rows and columns shuffled."""
    finite = [np.array([[-0.2, 1.0], [-1.0, -0.2]])] * int(rng.integers(1, 4))
    sizes = rng.integers(1, 4, 3)
    A, N = sla.block_diag(*finite), sla.block_diag(*[np.eye(size, k=1) for size in sizes])
    E = sla.block_diag(np.eye(len(A)), N)
    J = sla.block_diag(A, np.eye(len(N)))
    n = len(E)
    couple = np.triu((rng.random((n, n)) < 0.15) * rng.uniform(0.5, 2.0, (n, n)), 1)
    left, right = np.eye(n) + couple, np.eye(n)
    shuffled = rng.permutation(n), rng.permutation(n)
    return (left @ E @ right)[shuffled[0]][:, shuffled[1]], (left @ J @ right)[shuffled[0]][:, shuffled[1]]


def test_values_that_cancel_the_structure_are_told():
    E = sp.csr_array(np.array([[1.0, 1.0], [1.0, 1.0]]))  # structurally two modes, E is singular
    with pytest.raises(NumericalError) as caught:
        expand_at_infinity(E, sp.csr_array(np.array([[1.0, 0.0], [0.0, 2.0]])))
    assert caught.value.code == "system-jacobian-singular"


def test_a_large_model_whose_structure_misleads_is_split_densely():
    dae = combined(large("Ladder", 45))
    assert dae.n >= 500
    with pytest.raises(NumericalError):
        sparse_form(dae)
    form = standard_form(dae)
    assert (form.n_dynamic, form.index) == (46, 1)


def combined(dae):
    """The model and, unconnected, x' + y' = x, x' + y' = 2 y: one mode, two by its structure."""
    E = sp.block_diag([dae.E, np.ones((2, 2))], format="csr")
    J = sp.block_diag([dae.J, np.diag([1.0, 2.0])], format="csr")
    pad = {name: np.vstack([getattr(dae, name), np.zeros((2, getattr(dae, name).shape[1]))]) for name in "KB"}
    unknowns = tuple(dataclasses.replace(dae.unknowns[0], name=name) for name in "xy")
    return dataclasses.replace(
        dae,
        equations=(*dae.equations, *dae.equations[:2]),
        unknowns=(*dae.unknowns, *unknowns),
        E=sp.csr_array(E),
        J=sp.csr_array(J),
        C=np.hstack([dae.C, np.zeros((len(dae.C), 2))]),
        offset=np.append(dae.offset, [0.0, 0.0]),
        **pad,
    )


def test_a_large_singular_model_names_the_equations(monkeypatch):
    monkeypatch.setattr("daest.systems.linear.split.ITERATED", 100)
    dae = large("Ladder", 45)
    E, J = sp.lil_array(dae.E), sp.lil_array(dae.J)
    J[[7]] = J[[8]] + J[[9]]
    E[[7]] = E[[8]] + E[[9]]
    with pytest.raises(ModelError) as caught:
        standard_form(dataclasses.replace(dae, E=sp.csr_array(E), J=sp.csr_array(J)))
    assert caught.value.code == "pencil-singular"
    assert all(dae.equations[i].text in str(caught.value) for i in (7, 8, 9))


def test_too_large_for_dense_algebra_is_said_before_it_starts(monkeypatch):
    monkeypatch.setattr("daest.systems.linear.standard_form.DENSE_LIMIT", 400)
    with pytest.raises(ModelError) as caught:
        standard_form(combined(large("Ladder", 45)))
    assert caught.value.code == "model-too-large" and "GB" in str(caught.value)


@pytest.mark.parametrize("seed", SEEDS)
def test_verdicts_of_random_sparse_pencils(seed):
    E, J = scattered_pencil(np.random.default_rng(seed))
    plain, n = large("Ladder", 8), len(E)
    dae = dataclasses.replace(
        plain,
        equations=plain.equations[:n],
        unknowns=plain.unknowns[:n],
        E=sp.csr_array(E),
        J=sp.csr_array(J),
        K=plain.K[:n],
        B=np.eye(n)[:, :0],
        C=plain.C[:, :n],
        offset=plain.offset[:n],
    )
    assert_same_reports(noise_report(dae, split(dae)), noise_report(dae, sparse_form(dae)))


def test_exact_verdicts_of_a_large_model():
    """Sparse exact arithmetic at the numbers and for almost all of them, and noise and inputs by columns."""
    dae = large("Chain", 33)
    report = noise_report(dae, form := standard_form(dae))
    assert dae.n > 500 and form.exact is not None and form.exact.reading == "parameters"
    found = (report.generic.index, report.generic.n_dynamic, len(report.generic.forbidden))
    assert found == (report.index, report.n_dynamic, report.n_forbidden) == (3, 66, 231)
    assert (report.differences, report.undecided) == ((), ())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "n", "numbers"),
    [("Chain", 588, (10002, 1176, 3, 4116)), ("Rigid", 1428, (10012, 2, 3, 5715))],
)
def test_ten_thousand_equations_within_twenty_seconds(name, n, numbers):
    import time

    dae = large(name, n)
    started = time.process_time()  # what others do on the machine does not count
    report = noise_report(dae)
    assert time.process_time() - started < 20.0
    assert (len(report.places), report.n_dynamic, report.index, report.n_forbidden) == numbers


def test_long_reaches_are_counted_and_named_on_request():
    """Noise on an equation of a rigid train reaches hundreds of unknowns: the first hundred are named."""
    dae = large("Rigid", 72)
    plain = noise_report(dae)
    longest = max(range(dae.n), key=lambda i: plain.places[i].n_differentiated)
    place = plain.places[longest]
    assert place.n_differentiated > 200 and len(place.differentiated) == 100
    (full,) = noise_report(dae, at=[longest]).asked
    assert len(full.differentiated) == full.n_differentiated == place.n_differentiated
    assert full.differentiated[:100] == place.differentiated
