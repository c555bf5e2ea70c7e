"""The model kept near its given values, where what it lacks drives its parameters off.

A stiffening spring in series with one of the model makes this one a thousand times as stiff, and the mass
behind it as heavy, until nothing moves there: no law at that place has anything to do then, and the screens
name others. Near the values that the model was given, laws do what they would do in the machine.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace

from daest.diagnosis.built_in.settled import FAILURES
from daest.diagnosis.evidence.open_loop import ITERATIONS
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import Null, simulation_options
from daest.estimation.identify import identify
from daest.model.fit import FitResult
from daest.model.parts import Parameter


def fit_near_given(null: Null, given: Mapping[str, float]) -> FitResult | None:
    """The best simulation of the model with every estimated parameter near its `given` value; None where
    there is none."""
    near = {name: value for name, value in given.items() if name in null.estimated}
    parameters = tuple(_kept(p, near[p.name]) if p.name in near else p for p in null.flat.parameters)
    options = replace(simulation_options(null, null.estimated, ITERATIONS), start=near)
    with suppress(*FAILURES):
        return identify(replace(null.flat, parameters=parameters), null.experiments, options)
    return None


def _kept(parameter: Parameter, given: float) -> Parameter:
    """The parameter with limits near its `given` value, where that has a size, within those that it has."""
    if not given:
        return parameter
    low, high = sorted((given / GATES.near_given, given * GATES.near_given))
    low = low if parameter.min is None else max(low, parameter.min)
    high = high if parameter.max is None else min(high, parameter.max)
    return replace(parameter, value=given, min=low, max=high)
