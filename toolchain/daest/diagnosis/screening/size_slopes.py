"""Slopes of laws over the sizes of effects, of one effect in several shapes at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from daest.model.flat import ExplicitModel


@dataclass(frozen=True)
class Sizes:
    """Sizes of effects by their `names` (k) in a model, one as often as its effect has shapes, and the number
    `at` (k,) of the `values` (n_values, n_theta) of the model's parameters at which its slope is wanted."""

    names: tuple[str, ...]
    at: np.ndarray
    values: np.ndarray


def sizes_of(explicit: ExplicitModel, names: Sequence[str]) -> Sizes:
    """All at the parameters of the model."""
    return Sizes(tuple(names), np.zeros(len(names), dtype=int), explicit.flat.theta_values[None])


def slopes_over(explicit: ExplicitModel, law: ca.SX, theta: ca.SX, sizes: Sizes) -> ca.SX:
    """∂law/∂sizes (n_rows, k), `theta` (n_theta, 1) being the symbols of the parameters in the law."""
    known = {p.name: i for i, p in enumerate(explicit.flat.parameters)}
    place = {name: i for i, name in enumerate(dict.fromkeys(sizes.names))}
    slopes = ca.jacobian(law, ca.vertcat(ca.SX(0, 1), *(theta[known[name]] for name in place)))
    parts, order = [ca.SX(law.numel(), 0)], []
    for number, values in enumerate(sizes.values):
        own = np.flatnonzero(sizes.at == number).tolist()
        columns = slopes[:, [place[sizes.names[i]] for i in own]]
        parts.append(ca.substitute(columns, theta, ca.SX(values)))
        order += own
    return ca.horzcat(*parts)[:, np.argsort(order).tolist()]
