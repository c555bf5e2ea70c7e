"""The loop s[k+1], o[k] = step(s[k], d[k], c) over a recording, with exact tangents, without Python per sample.

A step is written once as a CasADi SX function; it is compiled when there is a C compiler and run by CasADi's
own accumulator (`mapaccum`) when there is none.
"""

from __future__ import annotations

import ctypes
import functools
from dataclasses import dataclass
from importlib import resources

import casadi as ca
import numpy as np

from daest.errors import FmuError
from daest.fmu.compiler import build_shared

_WORK = ("arg", "res", "iw", "w")


@dataclass(frozen=True)
class Fold:
    """A step (s, d, c) -> (s_next, o), its tangent, and the compiled loop (None: interpreted)."""

    step: ca.Function
    tangent: ca.Function  # (s, d, c, ds, dc) -> (ds_next, do)
    library: ctypes.CDLL | None


def fold(s: ca.SX, d: ca.SX, c: ca.SX, s_next: ca.SX, o: ca.SX, *, compiled: bool = True) -> Fold:
    """The loop for column expressions: state s, data d of a sample, constants c, next state and output."""
    s_next, o = ca.densify(s_next), ca.densify(o)
    ds, dc = ca.SX.sym("ds", s.numel()), ca.SX.sym("dc", c.numel())
    result = ca.vertcat(s_next, o)
    change = ca.densify(ca.jtimes(result, ca.vertcat(s, c), ca.vertcat(ds, dc)))
    n_s = s.numel()
    step = ca.Function("daest_step", [s, d, c], [s_next, o])
    tangent = ca.Function("daest_tangent", [s, d, c, ds, dc], [change[:n_s], change[n_s:]])
    library = None
    if compiled:
        try:
            library = _compile(step, tangent)
        except FmuError as error:
            if error.code != "no-c-compiler":
                raise
    return Fold(step, tangent, library)


def _compile(step: ca.Function, tangent: ca.Function) -> ctypes.CDLL:
    generator = ca.CodeGenerator("step.c")
    generator.add(step)
    generator.add(tangent)
    sizes = {"NS": step.numel_in(0), "ND": step.numel_in(1), "NC": step.numel_in(2), "NO": step.numel_out(1)}
    constants = [*sizes.items()]
    for prefix, function in (("STEP", step), ("TANGENT", tangent)):
        constants += [(f"{prefix}_{work.upper()}", getattr(function, f"sz_{work}")()) for work in _WORK]
    header = "".join(f"#define {name} {value}\n" for name, value in constants)
    driver = resources.files("daest.numerics").joinpath("fold.c").read_text()
    return _load(generator.dump() + header + driver)


@functools.lru_cache(maxsize=64)
def _load(source: str) -> ctypes.CDLL:
    # A generated step is one long straight line of code: optimising it further costs compile time for little.
    return ctypes.CDLL(str(build_shared(source, "fold", flags=("-O1",))))


def run_fold(loop: Fold, s0: np.ndarray, data: np.ndarray, constants: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Outputs (n_samples, n_o) and final state for data (n_samples, n_d)."""
    out, _, s_end = run_fold_tangents(loop, s0, data, constants, np.empty((0, s0.size)), np.empty((0, constants.size)))
    return out, s_end


def run_fold_tangents(
    loop: Fold, s0: np.ndarray, data: np.ndarray, constants: np.ndarray, ds0: np.ndarray, dc: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Outputs (n_samples, n_o), their tangents (n_samples, n_directions, n_o) and the final state, along
    directions of the initial state ds0 (n_directions, n_s) and of the constants dc (n_directions, n_c)."""
    run = _run_interpreted if loop.library is None else _run_compiled
    return run(loop, *(np.array(a, dtype=float, order="C") for a in (s0, data, constants, ds0, dc)))


def _run_compiled(
    loop: Fold, s: np.ndarray, data: np.ndarray, constants: np.ndarray, ds: np.ndarray, dc: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    assert loop.library is not None
    n, n_o, directions = data.shape[0], loop.step.numel_out(1), ds.shape[0]
    out, dout = np.empty((n, n_o)), np.empty((n, directions, n_o))
    pointers = [a.ctypes.data_as(ctypes.c_void_p) for a in (s, data, constants, out, ds, dc, dout)]
    status = loop.library.daest_fold(
        ctypes.c_long(n), *pointers[:4], ctypes.c_int(directions), *pointers[4:]
    )
    if status == 1:
        raise MemoryError("no memory for the work arrays of a recursion")
    return out, dout, s


def _run_interpreted(
    loop: Fold, s: np.ndarray, data: np.ndarray, constants: np.ndarray, ds: np.ndarray, dc: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    n, n_s, directions = data.shape[0], s.size, ds.shape[0]
    whole = _accumulator(loop, n, directions)
    columns = np.tile(np.concatenate([constants, dc.ravel()])[:, None], (1, n))
    states, outputs = whole(np.concatenate([s, ds.ravel()]), data.T, columns)
    outputs = np.array(outputs).T
    n_o = loop.step.numel_out(1)
    return outputs[:, :n_o], outputs[:, n_o:].reshape(n, directions, n_o), np.array(states)[:n_s, -1]


@functools.lru_cache(maxsize=16)
def _accumulator(loop: Fold, n: int, directions: int) -> ca.Function:
    n_s, n_d, n_c = loop.step.numel_in(0), loop.step.numel_in(1), loop.step.numel_in(2)
    whole, d = ca.MX.sym("s", n_s * (1 + directions)), ca.MX.sym("d", n_d)
    constants = ca.MX.sym("c", n_c * (1 + directions))
    s, c = whole[:n_s], constants[:n_c]
    s_next, o = loop.step(s, d, c)
    nexts, outs = [s_next], [o]
    for j in range(1, directions + 1):
        ds, do = loop.tangent(s, d, c, whole[j * n_s : (j + 1) * n_s], constants[j * n_c : (j + 1) * n_c])
        nexts.append(ds)
        outs.append(do)
    step = ca.Function("step_with_tangents", [whole, d, constants], [ca.vertcat(*nexts), ca.vertcat(*outs)])
    return step.mapaccum("along_record", n)
