"""Linear response of an affine FlatModel by one dense solve per frequency: slow, short, no part of daest."""

from __future__ import annotations

import casadi as ca
import numpy as np

from daest.model.flat import FlatModel


def matrices(flat: FlatModel) -> dict[str, np.ndarray]:
    """The matrices of E ξ' = J ξ + K u + B w + offset, y = C ξ + D u + H w + output_offset, by these names,
    dense, at the model's parameter values."""
    symbols = {"E": flat.derivatives, "J": flat.xi, "K": flat.u, "B": flat.w}
    found = {name: ca.jacobian(flat.residual, symbol) for name, symbol in symbols.items()}
    outputs = {"C": flat.xi, "D": flat.u, "H": flat.w}
    found |= {name: ca.jacobian(flat.output_expressions, symbol) for name, symbol in outputs.items()}
    found |= {"offset": flat.residual, "output_offset": flat.output_expressions}
    arguments = [flat.derivatives, flat.xi, flat.u, flat.w, flat.theta, flat.time]
    zeros = [np.zeros(symbol.numel()) for symbol in arguments[:4]]
    values = ca.Function("matrices", arguments, list(found.values()))(*zeros, flat.theta_values, 0.0)
    dense = {name: np.asarray(value.full()) for name, value in zip(found, values, strict=True)}
    for name in ("J", "K", "B", "offset"):
        dense[name] = -dense[name]
    dense["offset"], dense["output_offset"] = dense["offset"].ravel(), dense["output_offset"].ravel()
    return dense


def response(flat: FlatModel, s: complex) -> dict[tuple[str, str], complex]:
    """The transfer functions from every input and noise to every output at s, by (source, output)."""
    m = matrices(flat)
    drive = np.hstack([m["K"], m["B"]])
    values = m["C"] @ np.linalg.solve(s * m["E"] - m["J"], drive) + np.hstack([m["D"], m["H"]])
    sources = [v.name for v in (*flat.inputs, *flat.noises)]
    return {
        (source, output.name): values[i, j]
        for i, output in enumerate(flat.outputs)
        for j, source in enumerate(sources)
    }


def rest(flat: FlatModel, inputs: dict[str, float]) -> dict[str, float]:
    """Outputs and unknowns in the steady state without noise, with the given inputs (others are 0).

    Where parts may rest anywhere, the smallest values are taken."""
    m = matrices(flat)
    u = np.array([inputs.get(v.name, 0.0) for v in flat.inputs])
    drive = m["K"] @ u + m["offset"]
    xi = np.linalg.lstsq(-m["J"], drive, rcond=None)[0]
    np.testing.assert_allclose(m["J"] @ xi, -drive, atol=1e-8 * (1 + np.abs(drive).max()))
    y = m["C"] @ xi + m["D"] @ u + m["output_offset"]
    names = [v.name for v in (*flat.unknowns, *flat.outputs)]
    return dict(zip(names, [*xi.tolist(), *y.tolist()], strict=True))


def finite_modes(flat: FlatModel) -> np.ndarray:
    """The finite eigenvalues of the pencil, sorted: reciprocals of the non-zero ones of (J - a E)^-1 E, whose
    nilpotent part is removed by powers instead of by the size of eigenvalues."""
    m = matrices(flat)
    shift = 0.7  # no eigenvalue of the models that are tested
    step = np.linalg.solve(m["J"] - shift * m["E"], m["E"])
    power = np.linalg.matrix_power(step, 4)  # index 4 at most
    left, sizes, _ = np.linalg.svd(power)
    rank = int(np.sum(sizes > 1e-10 * sizes[0]))
    image = left[:, :rank]
    return np.sort_complex(shift + 1 / np.linalg.eigvals(image.T @ step @ image))
