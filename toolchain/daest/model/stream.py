"""A stream: one sample goes in, one estimate comes out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Sample:
    """One line of a stream: time in seconds, inputs (n_u,) and outputs (n_y,) in the order and the units of
    the model; NaN marks a missing output."""

    time: float
    inputs: np.ndarray
    outputs: np.ndarray


@dataclass(frozen=True)
class Estimate:
    """What is known after one sample.

    `values`, `std` (n_v,) of the filter's `names`: NaN and inf where the outputs so far say nothing.
    `innovations` (n_y,): output minus its prediction from the past, NaN where it is missing or could not be
    predicted; `whitened` (n_y,): the same with unit covariance, each output given those before it. `nis` is
    the sum of the squares of `whitened` over `nis_dof` outputs. `log_likelihood`: of all samples so far, NaN
    until they determine the unknown start.
    """

    time: float
    values: np.ndarray
    std: np.ndarray
    innovations: np.ndarray
    whitened: np.ndarray
    nis: float
    nis_dof: int
    log_likelihood: float
