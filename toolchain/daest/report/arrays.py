"""Matrices and names of a linear DAE as a NumPy or a MATLAB file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from daest.model.linear import LinearDAE


def save_arrays(dae: LinearDAE, path: Path) -> None:
    """All matrices and offsets, the parameter values, and the names of rows and columns, in .npz or .mat."""
    arrays: dict[str, Any] = {
        "E": _dense(dae.E),
        "J": _dense(dae.J),
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
        "unknowns": [unknown.name for unknown in dae.unknowns],
        "inputs": [variable.name for variable in dae.inputs],
        "noises": [noise.name for noise in dae.noises],
        "outputs": [output.name for output in dae.outputs],
        "parameters": [parameter.name for parameter in dae.parameters],
    }
    if path.suffix == ".npz":
        arrays.update({key: np.array(value, dtype=str) for key, value in names.items()})
        np.savez(path, **arrays)
        return
    from scipy.io import savemat

    savemat(path, {**arrays, **{key: np.array(value, dtype=object) for key, value in names.items()}})


def _dense(matrix: object) -> np.ndarray:
    return matrix if isinstance(matrix, np.ndarray) else matrix.toarray()  # type: ignore[attr-defined]
