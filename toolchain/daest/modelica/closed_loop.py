"""A model in the loop of a controller: the controller's outputs are the model's inputs, its inputs are
variables of the model, and what is left of its inputs are references that an experiment can move."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import casadi as ca

from daest.errors import ModelError
from daest.model.flat import FlatModel, events_refused
from daest.model.parts import DerivedParameter, Equation, NoiseInput, Parameter, Variable
from daest.near import near_names

CONTROLLER = "controller"  # the component that the controller is in the closed loop
Part = TypeVar("Part", Variable, Parameter, DerivedParameter, NoiseInput)
ROLE = (
    "A controller has an output for every input of the model that it moves, an input for every variable "
    "of the model that it reads, called as they are there, and an input for its reference."
)


@dataclass(frozen=True)
class _Signals:
    """Names of the model's inputs that the controller moves, and of the controller's inputs that it gets from
    the model and from outside."""

    driven: tuple[str, ...]
    read: tuple[str, ...]
    references: tuple[str, ...]


def closed_loop(flat: FlatModel, controller: FlatModel) -> FlatModel:
    """The model with its controller as component `controller`. Driven inputs become unknowns under their own
    names; outputs and unknown parameters stay those of the model. The controller reads what the model says,
    without the noise of a measurement.

    Raises ModelError `controller-fit` where their names do not meet, or nothing is left to be moved, and
    `events-not-supported`.
    """
    if flat.events is not None or controller.events is not None:
        raise events_refused("the loop of a controller")
    shared = _signals(flat, controller)
    known = dict(zip(flat.unknown_names, ca.vertsplit(flat.xi), strict=True))
    known |= dict(zip(flat.output_names, ca.vertsplit(flat.output_expressions), strict=True))
    inputs = dict(zip(flat.input_names, ca.vertsplit(flat.u), strict=True))
    asked = dict(zip(controller.input_names, ca.vertsplit(controller.u), strict=True))
    theirs = [asked[name] for name in shared.read]
    ours = [(known | inputs)[name] for name in shared.read]

    def told(expression: ca.SX) -> ca.SX:
        """An expression of the controller in the symbols of the whole."""
        return ca.substitute(expression, ca.vertcat(*theirs, controller.time), ca.vertcat(*ours, flat.time))

    formulas = ca.vertsplit(told(controller.output_expressions))
    made = dict(zip(controller.output_names, formulas, strict=True))
    moved = [v for v in flat.inputs if v.name in shared.driven]
    left = [v for v in flat.inputs if v.name not in shared.driven]
    references = [v for v in controller.inputs if v.name in shared.references]
    ties = [Equation(f"{v.name} = {CONTROLLER}.{v.name}", "connection", CONTROLLER) for v in moved]
    return replace(
        flat,
        unknowns=(*flat.unknowns, *moved, *(_named(v) for v in controller.unknowns)),
        inputs=(*left, *references),
        noises=(*flat.noises, *(_named(w) for w in controller.noises)),
        parameters=(*flat.parameters, *(replace(_named(p), estimate=False) for p in controller.parameters)),
        derived_parameters=(*flat.derived_parameters, *(_named(p) for p in controller.derived_parameters)),
        equations=(*flat.equations, *ties, *(_within(e) for e in controller.equations)),
        initial_equations=(*flat.initial_equations, *(_within(e) for e in controller.initial_equations)),
        derivatives=ca.vertcat(flat.derivatives, ca.SX.sym("der", len(moved)), controller.derivatives),
        xi=ca.vertcat(flat.xi, *(inputs[v.name] for v in moved), controller.xi),
        u=ca.vertcat(*(inputs[v.name] for v in left), *(asked[v.name] for v in references)),
        w=ca.vertcat(flat.w, controller.w),
        theta=ca.vertcat(flat.theta, controller.theta),
        residual=ca.vertcat(
            flat.residual, *(inputs[v.name] - made[v.name] for v in moved), told(controller.residual)
        ),
        initial_residual=ca.vertcat(flat.initial_residual, told(controller.initial_residual)),
        derived_values=ca.vertcat(flat.derived_values, told(controller.derived_values)),
    )


def _signals(flat: FlatModel, controller: FlatModel) -> _Signals:
    inputs = flat.input_names
    readable = set(flat.unknown_names) | set(flat.output_names) | set(inputs)
    driven = controller.output_names
    strangers = [name for name in driven if name not in inputs]
    if strangers or not driven:
        near = near_names(strangers[0], inputs, 1) if strangers else []
        what = f"its output {strangers[0]} is no input of {flat.name}" if strangers else "it has no output"
        raise _unfit(controller, what, f"did you mean {near[0]}? {ROLE}" if near else ROLE)
    asked = controller.input_names
    read = tuple(name for name in asked if name in readable and name not in driven)
    references = tuple(name for name in asked if name not in read)
    if not read:
        raise _unfit(controller, f"it reads no variable of {flat.name}", ROLE)
    if not references and set(inputs) == set(driven):
        raise _unfit(controller, "it has no input for a reference, so that nothing could be played", ROLE)
    clash = next((name for name in references if name in driven), None)
    if clash is not None:
        raise _unfit(controller, f"{clash} is an input and an output of it", ROLE)
    return _Signals(driven, read, references)


def _unfit(controller: FlatModel, what: str, remedy: str) -> ModelError:
    return ModelError(
        "controller-fit",
        f"the controller {controller.name} does not fit the model: {what}",
        where=controller.source or controller.name,
        remedy=remedy,
    )


def _named(part: Part) -> Part:
    """A part of the controller under the name that it has in the closed loop."""
    return replace(part, name=f"{CONTROLLER}.{part.name}")


def _within(equation: Equation) -> Equation:
    return replace(equation, origin=f"{CONTROLLER}.{equation.origin}" if equation.origin else CONTROLLER)
