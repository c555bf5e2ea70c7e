"""Poles and transfer functions of a linear DAE in standard form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as sla

from daest.model.linear import LinearDAE, Matrix, SparseForm, StandardForm
from daest.numerics.exponential import balanced
from daest.numerics.pencils import split_pencil
from daest.systems.linear.noise_gains import in_outputs, noise_gains

EXACT = 1e-10
"""Part of the norm of a channel's scaled matrices up to which a coupling counts as zero: it must be rounding,
as only exact pole-zero cancellations are taken out."""


HIGHEST_ORDER = 200
"""Up to this many finite modes transfer functions are formed: coefficients of higher polynomials say nothing
in double precision."""


@dataclass(frozen=True)
class TransferFunction:
    """G(s) = num(s) / den(s) from one input to one output; coefficients with the highest power first.

    Minimal: poles that this input does not reach or this output does not show are cancelled. `den` is monic;
    `num` has a higher degree than `den` where the output contains derivatives of the input.
    """

    input: str
    output: str
    num: tuple[float, ...]
    den: tuple[float, ...]

    def __call__(self, s: complex) -> complex:
        return complex(np.polyval(self.num, s) / np.polyval(self.den, s))


def poles(form: StandardForm | SparseForm) -> np.ndarray:
    """Finite eigenvalues of sE - J, sorted by real and imaginary part; complex, shape (n_dynamic,).

    >>> daest.poles(form).real.round(1).tolist()
    [-133.9, -1.5, -1.5, 0.0]
    """
    if isinstance(form, StandardForm) and form.poles is not None:
        return np.sort_complex(form.poles)
    return np.sort_complex(_eigenvalues(_dense(form.A)))


def transfer_functions(dae: LinearDAE, form: StandardForm | SparseForm) -> list[TransferFunction]:
    """One minimal transfer function per input and output, inputs outermost.

    The rational part is C Q1 (sI - A)⁻¹ P1 K, reduced per channel; -C Q2 N^i P2 K are the coefficients of s^i
    of the polynomial part, plus D. None at all for models of more than `HIGHEST_ORDER` modes.

        >>> [(g.input, g.output, len(g.den)) for g in daest.transfer_functions(dae, form)]
        [('u', 'omega', 4), ('u', 'phi', 5)]
    """
    if form.n_dynamic > HIGHEST_ORDER:
        return []
    A = _dense(form.A)
    B1, C1 = form.left_dynamic @ dae.K, dae.C @ form.right_dynamic
    gains = noise_gains(dae, form)
    result = []
    for j, u in enumerate(dae.inputs):
        polynomial = [in_outputs(dae.C, gains.part(i, dae.K[:, j])) for i in range(len(gains.maps))]
        polynomial[0] = polynomial[0] + dae.D[:, j]
        for i, y in enumerate(dae.outputs):
            num, den = _channel(A, B1[:, j], C1[i], np.array([part[i] for part in polynomial]))
            result.append(TransferFunction(u.name, y.name, num, den))
    return result


def _channel(
    A: np.ndarray, b: np.ndarray, c: np.ndarray, polynomial: np.ndarray
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """(num, den) of c (sI - A)⁻¹ b + Σ polynomial[i] s^i."""
    A, b, c = _minimal(A, b, c)
    den = np.poly(_eigenvalues(A)).real if len(b) else np.ones(1)
    num = _numerator(A, b, c, float(polynomial[0]), den)
    for i, coefficient in enumerate(polynomial[1:], start=1):
        if coefficient != 0.0:
            num = np.polyadd(num, np.polymul(coefficient * den, np.eye(1, i + 1)[0]))
    return tuple(num.tolist()), tuple(den.tolist())


def _numerator(A: np.ndarray, b: np.ndarray, c: np.ndarray, d: float, den: np.ndarray) -> np.ndarray:
    """Numerator of c (sI - A)⁻¹ b + d from its zeros, the finite eigenvalues of the system pencil.

    The gain comes from the value at a point of the mean size of poles and zeros, off the real axis.
    """
    n = len(b)
    if n == 0:
        return np.array([d])
    E = np.diag([1.0] * n + [0.0])
    zeros = _eigenvalues(split_pencil(E, np.block([[A, b[:, None]], [-c[None, :], np.array([[-d]])]])).A)
    sizes = np.abs(np.concatenate([_eigenvalues(A), zeros]))
    s = np.exp(np.log(sizes[sizes > 0]).mean() + 1j) if sizes.any() else np.exp(1j)
    value = c @ np.linalg.solve(s * np.eye(n) - A, b) + d
    monic = np.poly(zeros).real if zeros.size else np.ones(1)
    return float((value * np.polyval(den, s) / np.polyval(monic, s)).real) * monic


def _dense(matrix: Matrix) -> np.ndarray:
    return matrix if isinstance(matrix, np.ndarray) else matrix.toarray()


def _eigenvalues(A: np.ndarray) -> np.ndarray:
    """Eigenvalues; those that are zero to rounding, relative to the norm of the balanced matrix, are zero."""
    if A.size == 0:
        return np.empty(0, complex)
    values = np.linalg.eigvals(A).astype(complex)
    rounding = 64.0 * len(A) * np.finfo(float).eps * np.linalg.norm(balanced(A)[0], 2)
    return np.where(np.abs(values) <= rounding, 0.0, values)


def _minimal(A: np.ndarray, b: np.ndarray, c: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The part of (A, b, c) that is reachable from b and visible in c, in balanced coordinates."""
    if A.size:
        # With b and c: what a state means to them decides on its scale, too. A coupling that is zero but for
        # rounding would hide a state that has no other.
        system = balanced(np.block([[A, b[:, None]], [c[None, :], np.zeros((1, 1))]]))[0]
        A, b, c = system[:-1, :-1], system[:-1, -1], system[-1, :-1]
    A, b, c = _reachable(A, b, c)
    A, c, b = _reachable(A.T, c, b)
    return A.T, b, c


def _reachable(A: np.ndarray, b: np.ndarray, c: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The reachable part of (A, b): Hessenberg form with b = |b| e1, cut at the first subdiagonal that is
    zero."""
    n = len(b)
    if n == 0 or not np.any(b) or not np.any(c):
        return np.empty((0, 0)), np.empty(0), np.empty(0)
    first, _ = sla.qr(b[:, None])
    H, Q = sla.hessenberg(first.T @ A @ first, calc_q=True)
    Q = first @ Q
    small = np.abs(np.diag(H, -1)) <= EXACT * np.linalg.norm(H, 2)
    m = int(np.argmax(small)) + 1 if small.any() else n
    return H[:m, :m], (Q.T @ b)[:m], (c @ Q)[:m]
