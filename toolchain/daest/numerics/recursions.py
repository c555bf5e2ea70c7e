"""Linear recursions x[k+1] = A x[k] + drive[k] over many samples, without a Python step per sample.

With a C compiler, `recursions.c` takes the steps of models with few states. Else the samples are cut into
blocks. What the drive of a block does to the block's last state is one matrix product over all blocks; the
states at block starts then follow the same recursion with A^length and one sample per block (solved by the
same function); a second product fills the blocks. Only powers A^i with i up to the number of samples occur,
so an unstable A loses nothing that the plain loop would not lose.
"""

from __future__ import annotations

import ctypes
import functools
from dataclasses import dataclass

import numpy as np

from daest.numerics.compiler import FAST, effort, loaded, pointer, processor_flags, text_of

MOST_COMPILED = 16  # states; of more, blocked products are faster
FEW = 8  # states up to which the steps are in one library, and those for more in another
UNROLLED = (2, 3, 4, 6, 8)  # states for which slopes of gains are compiled by themselves
SHORT = 48  # up to this many samples the plain loop is as fast as blocks
BLOCK_COLUMNS = 32  # columns (states times samples) of a block: the product costs this many steps per number
SHORTEST_BLOCK = 4  # samples; models with many states take wider blocks instead of shorter ones


def linear_recursion(A: np.ndarray, drive: np.ndarray, x0: np.ndarray) -> np.ndarray:
    """States of x[k+1] = A x[k] + drive[k] with x[0] = x0.

    A (n, n); drive (..., n_steps, n); x0 (..., n). Returns states (..., n_steps + 1, n) with
    states[..., 0, :] = x0. Leading axes are independent right-hand sides of the same A and are broadcast.
    States that leave the range of floating point become inf or NaN, as in the plain loop.
    """
    A = np.asarray(A, dtype=float)
    drive = np.asarray(drive, dtype=float)
    x0 = np.asarray(x0, dtype=float)
    n = A.shape[0]
    lead = np.broadcast_shapes(drive.shape[:-2], x0.shape[:-1])
    n_steps = drive.shape[-2]
    states = np.empty((*lead, n_steps + 1, n))
    states[..., 0, :] = x0
    if n and n_steps:
        drive = np.broadcast_to(drive, (*lead, n_steps, n))
        with np.errstate(over="ignore", invalid="ignore"):
            each = drive.reshape(-1, n_steps, n), states.reshape(-1, n_steps + 1, n)
            if not _compiled(A, *each):
                _fill(A, *each)
    return states


def varying_recursion(A: np.ndarray, drive: np.ndarray, x0: np.ndarray | float = 0.0) -> np.ndarray:
    """States (k, n_steps + 1, n) of x[i+1] = A[i] x[i] + drive[i] from x0: A (n_steps, n, n), drive (k,
    n_steps, n), x0 (k, n)."""
    states = np.empty((drive.shape[0], drive.shape[1] + 1, drive.shape[2]))
    states[:, 0] = x0
    if _compiled(A, drive, states):
        return states
    for i in range(A.shape[0]):
        states[:, i + 1] = states[:, i] @ A[i].T + drive[:, i]
    return states


@dataclass(frozen=True)
class GainChange:
    """What the gains of a time-varying Kalman filter change by in p directions, with the matrices that they
    come from; C (n_y, n) of all outputs, those that were not `observed` (n_samples, n_y) count as cleared.

    Φ, and the slopes of Φ, Q and S12, are constant or have an axis of n_samples - 1 steps in front of the
    matrix; slopes have p in front of all. K, S and P are those of every sample, `start` (p, n, n) is the
    slope of the first P.
    """

    Phi: np.ndarray
    C: np.ndarray
    dPhi: np.ndarray
    dC: np.ndarray
    dQ: np.ndarray
    dR: np.ndarray
    dS12: np.ndarray
    observed: np.ndarray
    K: np.ndarray
    S: np.ndarray
    P: np.ndarray
    start: np.ndarray

    def compiled(self) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """Slopes of K (p, n_samples, n, n_y), S (p, n_samples, n_y, n_y) and P (p, n_samples, n, n); None
        without a C compiler, or for more states or outputs than that is made for."""
        (n_samples, n, n_y), p = self.K.shape, len(self.start)
        fits = 0 < max(n, n_y) <= MOST_COMPILED and p > 0 and n_samples > 1
        library = _gain_library(n) if fits else None
        if library is None:
            return None
        dK, dS, dP = (np.empty((p, n_samples, *size)) for size in ((n, n_y), (n_y, n_y), (n, n)))
        dP[:, 0] = self.start
        parts = (self.Phi, self.C, self.dPhi, self.dC, self.dQ, self.dR, self.dS12)
        tables = [np.ascontiguousarray(part, dtype=float) for part in parts]
        made = [np.ascontiguousarray(part, dtype=float) for part in (self.K, np.linalg.inv(self.S), self.P)]
        varies = np.array(
            [self.Phi.ndim > 2, *(x.ndim > 3 for x in (self.dPhi, self.dQ, self.dS12))], dtype=int
        )
        seen = np.ascontiguousarray(self.observed, dtype=np.uint8)
        library.daest_gain_slopes(
            *(ctypes.c_long(size) for size in (p, n_samples, n, n_y)),
            *map(pointer, (*tables, varies, seen, *made, dP, dS, dK)),
        )
        return dK, dS, dP


def products_along(rows: np.ndarray, matrices: np.ndarray) -> np.ndarray:
    """Every row (k, m, n) by the matrix of its sample (m, p, n): (k, m, p)."""
    k, m, n = rows.shape
    p = matrices.shape[1]
    library = _library(n > FEW) if 0 < max(n, p) <= MOST_COMPILED and n and p else None
    if library is None:
        return np.matmul(rows.transpose(1, 0, 2), matrices.transpose(0, 2, 1)).transpose(1, 0, 2)
    rows, matrices = (np.ascontiguousarray(part, dtype=float) for part in (rows, matrices))
    out = np.empty((k, m, p))
    sizes = (ctypes.c_long(size) for size in (k, m, n, p))
    library.daest_products(*sizes, pointer(rows), pointer(matrices), ctypes.c_long(p * n), pointer(out))
    return out


def _compiled(A: np.ndarray, drive: np.ndarray, states: np.ndarray) -> bool:
    """Whether the compiled steps have filled states[:, 1:] (n_rhs, n_steps + 1, n); A (n, n), or one per
    step."""
    n_rhs, n_steps, n = drive.shape
    library = _library(n > FEW) if 0 < n <= MOST_COMPILED and n_steps > SHORT else None
    if library is None or not states.flags.c_contiguous:
        return False
    A, drive = (np.ascontiguousarray(part, dtype=float) for part in (A, drive))
    stride = ctypes.c_long(0 if A.ndim == 2 else n * n)
    sizes = (ctypes.c_long(size) for size in (n_rhs, n_steps, n))
    library.daest_recursion(*sizes, pointer(A), stride, pointer(drive), pointer(states))
    return True


@functools.lru_cache
def _library(is_large: bool) -> ctypes.CDLL | None:
    """The compiled steps for few states or for more; None without a C compiler."""
    return _part("daest_recursion", "daest_products", flags=("-DLARGE",) if is_large else ())


@functools.lru_cache
def _gain_library(n: int) -> ctypes.CDLL | None:
    """The compiled slopes of gains for `n` states; None without a C compiler."""
    return _part("daest_gain_slopes", flags=(f"-DSTATES={n if n in UNROLLED else 0}",))


def _part(*names: str, flags: tuple[str, ...] = ()) -> ctypes.CDLL | None:
    """A part of `recursions.c` with the functions `names`; None without a C compiler."""
    source = text_of("recursions.c")
    library = loaded(source, "recursions", (effort(source, "-O2"), *FAST, *processor_flags(), *flags))
    if library is not None:
        for name in names:
            getattr(library, name).restype = None
    return library


def _fill(A: np.ndarray, drive: np.ndarray, states: np.ndarray) -> None:
    """Write states[:, 1:] of every right-hand side, given states[:, 0]; arrays (n_rhs, n_steps (+1), n)."""
    n_rhs, n_steps, n = drive.shape
    length = max(SHORTEST_BLOCK, BLOCK_COLUMNS // n)
    powers = _powers(A, length) if n_steps > SHORT else None
    if powers is None or not np.all(np.isfinite(powers)):
        _step(A, drive, states)
        return
    n_blocks = n_steps // length
    covered = n_blocks * length
    blocks = _in_blocks(np.ascontiguousarray(drive), n_blocks, length)
    starts = np.empty((n_rhs, n_blocks, n))
    starts[:, 0] = states[:, 0]
    # Last state of a block from its own drive: Σ A^(length-1-i) drive[i].
    ends = blocks[:, :-1] @ powers[length - 1 :: -1].transpose(0, 2, 1).reshape(length * n, n)
    _fill(powers[length], ends, starts)
    filled = _in_blocks(states[:, 1:], n_blocks, length)
    np.matmul(blocks, _response(powers), out=filled)
    filled += starts @ powers[1:].transpose(2, 0, 1).reshape(n, length * n)
    _step(A, drive[:, covered:], states[:, covered:])


def _in_blocks(rows: np.ndarray, n_blocks: int, length: int) -> np.ndarray:
    """View (n_rhs, n_blocks, length n) of the first rows (n_rhs, n_steps, n); samples must be adjacent."""
    n = rows.shape[2]
    strides = (rows.strides[0], length * n * rows.itemsize, rows.itemsize)
    return np.lib.stride_tricks.as_strided(rows, (rows.shape[0], n_blocks, length * n), strides)


def _powers(A: np.ndarray, length: int) -> np.ndarray:
    """A^0 … A^length, shape (length + 1, n, n)."""
    powers = np.empty((length + 1, *A.shape))
    powers[0] = np.eye(A.shape[0])
    for i in range(length):
        powers[i + 1] = powers[i] @ A
    return powers


def _response(powers: np.ndarray) -> np.ndarray:
    """Block Toeplitz matrix T with states = drive @ T inside a block of zero start, (length n, length n)."""
    length, n = powers.shape[0] - 1, powers.shape[1]
    response = np.zeros((length, n, length, n))
    for i in range(length):
        response[i, :, i:, :] = powers[: length - i].transpose(2, 0, 1)
    return response.reshape(length * n, length * n)


def _step(A: np.ndarray, drive: np.ndarray, states: np.ndarray) -> None:
    """The recursion sample by sample, all right-hand sides together."""
    for k in range(drive.shape[1]):
        states[:, k + 1] = states[:, k] @ A.T + drive[:, k]
