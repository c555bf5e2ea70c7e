"""Models that designs are tried on, compiled once."""

from functools import cache
from pathlib import Path

import numpy as np

from daest.design.prepared import Subject, estimated_names, explainer
from daest.model.design import Limits, Range
from daest.modelica.compile import compile_model

MODELS = Path(__file__).parent / "models"
PERIOD = 0.05


@cache
def flat(name):
    return compile_model(MODELS / f"{name}.mo")


@cache
def driven(name, unknown_noise=False, hold="zoh"):
    model = flat(name)
    return explainer(Subject(model, estimated_names(model), unknown_noise), PERIOD, hold)


def limits(length=20.0, low=-4.0, high=4.0, **others):
    return Limits(
        (Range("F", "N", low, high, others.pop("rate", np.inf)),), length, PERIOD, hold="zoh", **others
    )
