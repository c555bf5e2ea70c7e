"""A cart whose force, or sensor, is late: the models and the recording of the tests of chains."""

from functools import cache
from pathlib import Path

import numpy as np

from daest.modelica.compile import compile_model
from daest.systems.reduction.reduce import reduce_index

SOURCE = Path(__file__).parent / "models" / "LateCart.mo"
PERIOD = 0.02


@cache
def cart(name):
    return reduce_index(compile_model(SOURCE, f"LateCart.{name}"))


def recording(n=40):
    """Steps that last a few samples."""
    rng = np.random.default_rng(2)
    return PERIOD * np.arange(n), np.repeat(rng.uniform(-20.0, 20.0, n // 6 + 1), 6)[:n, None]
