"""One thread for the linear algebra of many small matrices, where a second one only waits."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np  # noqa: F401  (loads its library of linear algebra)
import scipy.linalg  # noqa: F401  (and this one its own)
from threadpoolctl import ThreadpoolController  # type: ignore[import-untyped]


@contextmanager
def one_thread() -> Iterator[None]:
    """Numpy and scipy work in one thread to the end of the block, or of the function that this decorates."""
    with _libraries().limit(limits=1):
        yield


@functools.lru_cache(maxsize=1)
def _libraries() -> ThreadpoolController:
    """Those of linear algebra in this process: to look for them takes longer than a small simulation."""
    return ThreadpoolController()
