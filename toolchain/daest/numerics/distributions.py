"""Tails and quantiles of distributions, on `scipy.special`.

They have the names and the values of `scipy.stats`, whose import alone takes most of a second.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import special


class chi2:
    """The chi-squared distribution of `df` degrees of freedom."""

    @staticmethod
    def sf(x: Any, df: Any) -> Any:
        """P(X > x)."""
        return special.chdtrc(df, np.maximum(x, 0.0))

    @staticmethod
    def logsf(x: Any, df: Any) -> Any:
        """log P(X > x), -inf where that is below the smallest number."""
        with np.errstate(divide="ignore"):
            return np.log(chi2.sf(x, df))

    @staticmethod
    def ppf(p: Any, df: Any) -> Any:
        """x with P(X ≤ x) = p."""
        return 2.0 * special.gammaincinv(np.divide(df, 2.0), p)

    @staticmethod
    def isf(p: Any, df: Any) -> Any:
        """x with P(X > x) = p."""
        return special.chdtri(df, p)


class norm:
    """The standard normal distribution."""

    @staticmethod
    def sf(x: Any) -> Any:
        """P(X > x)."""
        return special.ndtr(np.negative(x))

    @staticmethod
    def ppf(p: Any) -> Any:
        """x with P(X ≤ x) = p."""
        return special.ndtri(p)

    @staticmethod
    def isf(p: Any) -> Any:
        """x with P(X > x) = p."""
        return -special.ndtri(p)


class beta:
    """The beta distribution with the parameters `a` and `b`."""

    @staticmethod
    def sf(x: Any, a: Any, b: Any) -> Any:
        """P(X > x)."""
        return special.betaincc(a, b, np.clip(x, 0.0, 1.0))
