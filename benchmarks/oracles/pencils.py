"""Verdicts on random pencils sE - J against exact rational arithmetic, by another algorithm.

The oracle knows Wong's subspaces alone (K. Wong, J. Differential Equations 16, 1974; T. Berger, A. Ilchmann,
S. Trenn, LAA 436, 2012), in rational numbers: V = lim of V := J⁻¹(E V) has the dimension of the modes, the
steps that W := E⁻¹(J W) grows are the index, and b is admissible where it lies in E V + J ker E.

    python benchmarks/oracles/pencils.py [--count 2000] [--seed 1]
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
import scipy.linalg as sla
from flint import fmpq, fmpq_mat

from daest.errors import DaestError
from daest.machine import described
from daest.model.linear import LinearDAE
from daest.model.parts import Equation, Variable
from daest.systems.linear.noise import noise_report

LARGEST = 40
HIGHEST_INDEX = 8


@dataclass(frozen=True)
class Truth:
    """What holds exactly; `index` -1 for a singular pencil."""

    index: int
    n_dynamic: int
    forbidden: tuple[int, ...]


@dataclass(frozen=True)
class Case:
    """A pencil with its kind, how it was scaled, and the exact numbers that the truth is to be told of."""

    kind: str
    scaling: str
    E: np.ndarray
    J: np.ndarray
    exact_E: np.ndarray
    exact_J: np.ndarray


def rational(matrix: np.ndarray) -> fmpq_mat:
    """The matrix of the doubles, each at its binary value."""
    pairs = [Fraction(float(value)).as_integer_ratio() for value in matrix.ravel()]
    return fmpq_mat(*matrix.shape, [fmpq(a, b) for a, b in pairs])


def null_space(matrix: fmpq_mat) -> fmpq_mat:
    """Columns that span it."""
    reduced, rank = matrix.rref()
    n = matrix.ncols()
    pivots = [next(j for j in range(n) if reduced[i, j] != 0) for i in range(rank)]
    free = [j for j in range(n) if j not in set(pivots)]
    basis = fmpq_mat(n, len(free))
    for k, j in enumerate(free):
        basis[j, k] = 1
        for i, pivot in enumerate(pivots):
            basis[pivot, k] = -reduced[i, j]
    return basis


def beside(left: fmpq_mat, right: fmpq_mat) -> fmpq_mat:
    rows = [[*a, *b] for a, b in zip(left.tolist(), right.tolist(), strict=True)]
    return fmpq_mat(left.nrows(), left.ncols() + right.ncols(), [value for row in rows for value in row])


def independent_columns(matrix: fmpq_mat) -> fmpq_mat:
    reduced, rank = matrix.transpose().rref()
    rows = reduced.tolist()[:rank]
    return fmpq_mat(rank, matrix.nrows(), [value for row in rows for value in row]).transpose()


def preimage(matrix: fmpq_mat, space: fmpq_mat) -> fmpq_mat:
    """All x with matrix x in the span of the columns of `space`."""
    solutions = null_space(beside(matrix, space)).tolist()[: matrix.ncols()]
    width = len(solutions[0]) if solutions else 0
    return independent_columns(fmpq_mat(matrix.ncols(), width, [value for row in solutions for value in row]))


def truth(E: np.ndarray, J: np.ndarray) -> Truth:
    """By Wong's subspaces."""
    E, J = rational(E), rational(J)
    n = E.nrows()
    V = fmpq_mat(n, n, [fmpq(int(i == j)) for i in range(n) for j in range(n)])
    while (smaller := preimage(J, E * V)).ncols() < V.ncols():
        V = smaller
    W, index = fmpq_mat(n, 0), 0
    while (larger := preimage(E, J * W)).ncols() > W.ncols():
        W, index = larger, index + 1
    if V.ncols() + W.ncols() != n or beside(V, W).rank() < n:
        return Truth(-1, 0, ())
    across = null_space(beside(E * V, J * null_space(E)).transpose()).tolist()
    forbidden = [k for k in range(n) if any(value != 0 for value in across[k])]
    return Truth(index, V.ncols(), tuple(forbidden))


def integers(rng: np.random.Generator, shape: tuple[int, ...], density: float) -> np.ndarray:
    values = rng.integers(1, 4, shape) * rng.choice([-1, 1], shape)
    return np.where(rng.random(shape) < density, values, 0).astype(float)


def sparse(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Scattered small integers: whatever index comes of it."""
    return integers(rng, (n, n), rng.uniform(1.0, 2.5) / n), integers(rng, (n, n), rng.uniform(1.5, 3.0) / n)


def scattered(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Scattered integers where half of the equations are static."""
    E, J = sparse(rng, n)
    E[rng.permutation(n)[: n // 2]] = 0.0
    return E, J + np.diag(integers(rng, (n,), 0.7))


def chains(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Chains of differentiators of one to eight unknowns and oscillators, coupled by sums of rows and of
    columns, shuffled."""
    sizes, left = [], n - 2 * int(rng.integers(0, max(1, n // 4)))
    n_dynamic = n - left
    while left:
        sizes.append(int(min(left, rng.integers(1, HIGHEST_INDEX + 1))))
        left -= sizes[-1]
    N = sla.block_diag(*[np.eye(size, k=1) for size in sizes]) if sizes else np.zeros((0, 0))
    E = sla.block_diag(np.eye(n_dynamic), N)
    J = sla.block_diag(integers(rng, (n_dynamic, n_dynamic), 0.3), np.eye(n - n_dynamic))
    for axis in (0, 1):
        for _ in range(int(rng.integers(n // 2, 2 * n))):
            i, j = rng.choice(n, 2, replace=False)
            factor = float(rng.choice([-2, -1, 1, 2]))
            for matrix in (E, J):
                view = matrix if axis == 0 else matrix.T
                view[i] += factor * view[j]
    return shuffled(rng, E, J)


def constrained(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Masses and springs with constraints on positions, velocities or accelerations: q' = v, M v' = f."""
    n_c = max(1, n // 8)
    m = (n - n_c) // 2
    G = integers(rng, (n_c, m), 2.5 / m)
    M, K, D = (
        np.diag(rng.integers(1, 4, m).astype(float)),
        integers(rng, (m, m), 2 / m),
        integers(rng, (m, m), 0.1),
    )
    size = 2 * m + n_c
    E, J = np.zeros((size, size)), np.zeros((size, size))
    E[:m, :m], J[:m, m : 2 * m] = np.eye(m), np.eye(m)
    E[m : 2 * m, m : 2 * m], J[m : 2 * m, :m], J[m : 2 * m, m : 2 * m] = M, -K - K.T, -D
    J[m : 2 * m, 2 * m :] = G.T
    for i in range(n_c):
        target, columns = [(J, slice(0, m)), (J, slice(m, 2 * m)), (E, slice(m, 2 * m))][int(rng.integers(3))]
        target[2 * m + i, columns] = G[i]
    return shuffled(rng, E, J)


def network(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Graph of capacitors, inductors and resistors: voltages of nodes, currents of branches."""
    nodes = max(2, n // 3)
    branches = n - nodes
    A = np.zeros((nodes, branches))
    for k in range(branches):
        start, end = rng.choice(nodes + 1, 2, replace=False)  # the last node is the ground
        A[start if start < nodes else end, k] = 1.0
        if start < nodes and end < nodes:
            A[end, k] = -1.0
    E, J = np.zeros((n, n)), np.zeros((n, n))
    J[:nodes, nodes:] = A
    for k in range(branches):
        row, value = nodes + k, float(rng.integers(1, 4))
        kind = rng.choice(["capacitor", "inductor", "resistor"])
        own = E if kind == "capacitor" else J
        own[row, :nodes] = value * A[:, k] if kind != "inductor" else A[:, k]
        (E if kind == "inductor" else J)[row, nodes + k] = value if kind != "capacitor" else 1.0
    return E, J


def coupled(rng: np.random.Generator, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Two systems of different kinds with a few couplings between them."""
    first, second = rng.choice(len(PLAIN), 2)
    parts = [PLAIN[first](rng, max(4, n // 2)), PLAIN[second](rng, max(4, n - n // 2))]
    E, J = (sla.block_diag(*matrices) for matrices in zip(*parts, strict=True))
    couplings = integers(rng, J.shape, 3.0 / J.size)
    return shuffled(rng, E, J + couplings)


def shuffled(rng: np.random.Generator, E: np.ndarray, J: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    order = np.ix_(rng.permutation(len(E)), rng.permutation(len(E)))
    return E[order], J[order]


Maker = Callable[[np.random.Generator, int], tuple[np.ndarray, np.ndarray]]
PLAIN: tuple[Maker, ...] = (sparse, scattered, chains, constrained, network)
KINDS: tuple[Maker, ...] = (*PLAIN, coupled)
SCALINGS = ("none", "units", "scaled", "decimal units", "entries", "binary entries")
MOST_DIGITS = 16
"""Unknowns of a pencil with entries of 16 digits at most: rational numbers grow long in larger ones."""


def cases(count: int, seed: int, largest: int = LARGEST) -> Iterator[Case]:
    """Regular pencils of all kinds and scalings in turn; singular ones are left out.

    Scaled rows, columns and time do not change the truth, which is that of the integers; entries that are
    scaled one by one are other numbers, and the truth is that of their doubles.
    """
    rng = np.random.default_rng(seed)
    made = 0
    while made < count:
        maker, scaling = KINDS[made % len(KINDS)], SCALINGS[made // len(KINDS) % len(SCALINGS)]
        most = min(largest, MOST_DIGITS) if scaling == "entries" else largest
        E, J = maker(rng, int(rng.integers(4, most + 1)))
        shift = rng.integers(2, 10**6)
        if (rational(shift * E - J)).det() == 0:
            continue
        made += 1
        scaled_E, scaled_J = scale(rng, scaling, E, J)
        exact = (scaled_E, scaled_J) if scaling.endswith("entries") else (E, J)
        yield Case(maker.__name__, scaling, scaled_E, scaled_J, *exact)


def scale(
    rng: np.random.Generator, scaling: str, E: np.ndarray, J: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    n = len(E)
    if scaling == "none":
        return E, J
    if scaling == "entries":
        return E * 10.0 ** rng.uniform(-4, 4, E.shape), J * 10.0 ** rng.uniform(-4, 4, J.shape)
    if scaling == "binary entries":
        return E * np.exp2(rng.integers(-13, 14, E.shape)), J * np.exp2(rng.integers(-13, 14, J.shape))
    if scaling == "decimal units":
        rows, columns = (10.0 ** rng.integers(-9, 10, n) for _ in range(2))
        return rows[:, None] * E * columns, rows[:, None] * J * columns
    width = 9 if scaling == "units" else 4
    rows, columns = (10.0 ** rng.uniform(-width, width, n) for _ in range(2))
    time_unit = 10.0 ** rng.uniform(-3, 3)
    return rows[:, None] * (E * time_unit) * columns, rows[:, None] * J * columns


def linear_dae(E: np.ndarray, J: np.ndarray) -> LinearDAE:
    """With nothing but equations and unknowns."""
    n, none = len(E), np.zeros((len(E), 0))
    return LinearDAE(
        equations=tuple(Equation(f"equation {i}", "component", "pencil") for i in range(n)),
        unknowns=tuple(Variable(f"x{i}") for i in range(n)),
        inputs=(),
        noises=(),
        outputs=(),
        parameters=(),
        E=E,
        J=J,
        K=none,
        B=none,
        C=none.T,
        D=np.zeros((0, 0)),
        H=np.zeros((0, 0)),
        offset=np.zeros(n),
        output_offset=np.zeros(0),
    )


def judged(case: Case) -> tuple[str, Truth, str]:
    """(outcome, the truth, what was said): right, right with a doubt, WRONG with a doubt, or WRONG."""
    want = truth(case.exact_E, case.exact_J)
    try:
        report = noise_report(linear_dae(case.E, case.J))
    except DaestError as error:
        return f"refused: {error.code}", want, str(error)
    got = Truth(
        report.index, report.n_dynamic, tuple(i for i, p in enumerate(report.places) if not p.admissible)
    )
    is_right, is_doubtful = got == want, bool(report.undecided)
    outcome = ("right" if is_right else "WRONG") + (", doubt told" if is_doubtful else "")
    return outcome, want, f"{got} {report.undecided}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    print(described(), flush=True)
    table: dict[str, Counter[str]] = {}
    indices: Counter[int] = Counter()
    started = time.perf_counter()
    for number, case in enumerate(cases(arguments.count, arguments.seed)):
        outcome, want, said = judged(case)
        indices[want.index] += 1
        for key in (case.kind, f"scaling: {case.scaling}", "all"):
            table.setdefault(key, Counter())[outcome] += 1
        if outcome.startswith(("WRONG", "refused")):
            print(f"case {number}, {case.kind}, {case.scaling}: {want}, said {said}")
    outcomes = sorted({outcome for counts in table.values() for outcome in counts})
    width = max(map(len, table)) + 2
    print(f"{'':{width}}" + "".join(f"{outcome:>28}" for outcome in outcomes))
    for key in sorted(table):
        print(f"{key:{width}}" + "".join(f"{table[key][outcome]:28d}" for outcome in outcomes))
    print("pencils of each index:", dict(sorted(indices.items())))
    print(f"{time.perf_counter() - started:.0f} s")


if __name__ == "__main__":
    main()
