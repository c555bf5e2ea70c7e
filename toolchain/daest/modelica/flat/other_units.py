"""What quantities are in other base units: what changes as a product of units does has their unit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from daest.quantities import dimensions

SCALES = {  # another size of every base unit; no power of one is a power of others
    "[mass]": 1.31,
    "[length]": 2.17,
    "[time]": 1.73,
    "[temperature]": 1.49,
    "[current]": 2.71,
    "[substance]": 1.87,
    "[luminosity]": 2.39,
}


def in_other_units(units: Sequence[str], scales: Mapping[str, float]) -> np.ndarray:
    """What one of each of n units is in the changed base units, (n,); a quantity without a unit stays."""
    known = {unit: power_of(scales, dimensions(unit) or {}) for unit in set(units)}
    return np.array([known[unit] for unit in units])


def power_of(scales: Mapping[str, float], exponents: Mapping[str, float]) -> float:
    return float(np.prod([scales.get(d, 1.0) ** e for d, e in exponents.items()]))
