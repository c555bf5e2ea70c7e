"""What a recording tells of the values from which loops of equations are solved."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import singledispatch
from typing import Any

import numpy as np

from daest.model.experiment import Experiment
from daest.model.flat import FlatModel, Model
from daest.model.parts import Variable


def begun_as_recorded(model: Model, recordings: Sequence[Experiment]) -> Any:
    """The model whose loops of equations are solved from where the first recording begins: a loop may have
    several solutions, and the machine was in one of them."""
    return _guessed(model, _first_values(recordings[0])) if recordings else model


def _first_values(recording: Experiment) -> dict[str, float]:
    """Of inputs and outputs that a recording has, the first value that is a number."""
    columns = dict(zip(recording.input_names, recording.inputs.T, strict=True))
    columns |= dict(zip(recording.output_names, recording.outputs.T, strict=True))
    numbers = {name: values[np.isfinite(values)] for name, values in columns.items()}
    return {name: float(values[0]) for name, values in numbers.items() if values.size}


@singledispatch
def _guessed(model: Model, _values: Mapping[str, float]) -> Any:
    """The model, unchanged: one without equations solves its own loops."""
    return model


@_guessed.register
def _guessed_in_equations(flat: FlatModel, values: Mapping[str, float]) -> FlatModel:
    place = {flat.xi[i].name(): i for i in range(flat.n)}
    guesses: list[float | None] = [None] * flat.n
    for i, output in enumerate(flat.outputs):
        expression = flat.output_expressions[i]
        if output.name in values and expression.is_symbolic() and expression.name() in place:
            guesses[place[expression.name()]] = values[output.name]
    inputs = [values.get(v.name) for v in flat.inputs]
    return replace(flat, unknowns=_with(flat.unknowns, guesses), inputs=_with(flat.inputs, inputs))


def _with(variables: Sequence[Variable], guesses: Sequence[float | None]) -> tuple[Variable, ...]:
    return tuple(replace(v, guess=guess) for v, guess in zip(variables, guesses, strict=True))
