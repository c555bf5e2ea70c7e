"""Matrices and names of a linear DAE as a NumPy or a MATLAB file."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse as sp

from daest.model.linear import LinearDAE, Matrix


def save_arrays(dae: LinearDAE, path: Path) -> None:
    """All matrices and offsets, the parameter values, and the names of rows and columns, in .npz or .mat.

    E and J of a large model are sparse: a sparse matrix in .mat, in .npz the arrays `E_shape`, `E_row`,
    `E_column` and `E_value` in place of `E`.
    """
    arrays: dict[str, Any] = {
        **_sparse_or_dense("E", dae.E, path.suffix),
        **_sparse_or_dense("J", dae.J, path.suffix),
        "K": dae.K,
        "B": dae.B,
        "C": dae.C,
        "D": dae.D,
        "H": dae.H,
        "offset": dae.offset,
        "output_offset": dae.output_offset,
        "theta": np.array([parameter.value for parameter in dae.parameters]),
    }
    names = {
        "equations": [equation.text for equation in dae.equations],
        "unknowns": dae.unknown_names,
        "inputs": dae.input_names,
        "noises": dae.noise_names,
        "outputs": dae.output_names,
        "parameters": dae.parameter_names,
    }
    if path.suffix == ".npz":
        arrays.update({key: np.array(value, dtype=str) for key, value in names.items()})
        np.savez(path, **arrays)
        return
    from scipy.io import savemat

    savemat(path, {**arrays, **{key: np.array(value, dtype=object) for key, value in names.items()}})


def _sparse_or_dense(name: str, matrix: Matrix, suffix: str) -> dict[str, Any]:
    if isinstance(matrix, np.ndarray):
        return {name: matrix}
    if suffix == ".mat":
        return {name: sp.csc_matrix(matrix)}
    entries = sp.coo_array(matrix)
    return {
        f"{name}_shape": np.array(matrix.shape),
        f"{name}_row": entries.coords[0],
        f"{name}_column": entries.coords[1],
        f"{name}_value": entries.data,
    }


def csv_text(header: Sequence[str], rows: np.ndarray) -> str:
    """A CSV table; `rows` (n_samples, n_columns), the first column the time with 12 significant digits, the
    others with 9; values that are not finite are empty cells."""
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerow(header)
    formats = ["%.12g", *["%.9g"] * (rows.shape[1] - 1)]
    whole = ",".join(formats) + "\n"
    for row, is_whole in zip(rows.tolist(), np.isfinite(rows[:, 1:]).all(axis=1).tolist(), strict=True):
        if is_whole:
            buffer.write(whole % tuple(row))
        else:
            cells = [form % v if -np.inf < v < np.inf else "" for form, v in zip(formats, row, strict=True)]
            buffer.write(",".join((f"{row[0]:.12g}", *cells[1:])) + "\n")
    return buffer.getvalue()
