"""Which variable of an exported FMU has which name and value reference."""

from __future__ import annotations

import re
from dataclasses import dataclass

import casadi as ca

from daest.errors import FmuError
from daest.model.flat import ExplicitModel, FlatModel
from daest.systems.events.event_functions import EventFunctions

TIME = 0
DAE_MODE = 1
_FIRST = 2

DAE_MODE_NAME = "_dae_mode"
RESIDUAL_NAME = "_residual[{}]"
INDICATOR_NAME = "_indicator[{}]"
_BASES = (
    "xi_base",
    "derivative_base",
    "input_base",
    "input_derivative_base",
    "noise_base",
    "parameter_base",
    "derived_base",
    "output_base",
    "residual_base",
    "extra_base",
)
_DERIVATIVE = re.compile(r"der\((?P<name>.*?)(?:,\s*(?P<order>\d+))?\)")


@dataclass(frozen=True)
class Layout:
    """Value references of a model. Each group is contiguous and starts at its `*_base`.

    `dynamic` are the unknowns (index) whose derivatives stand in the equations: their `der(name)` are
    variables. `states` and `rates` are the value references of the ODE's states and of their derivatives:
    unknowns and derivatives of unknowns where there are such, else variables of their own (`extra_names`).
    `output_references` is that of the unknown where an unknown was declared an output.
    """

    explicit: ExplicitModel
    dynamic: tuple[int, ...]
    xi_base: int
    derivative_base: int
    input_base: int
    input_derivative_base: int
    noise_base: int
    parameter_base: int
    derived_base: int
    output_base: int
    residual_base: int
    extra_base: int
    states: tuple[int, ...]
    rates: tuple[int, ...]
    extra_names: tuple[str, ...]
    output_references: tuple[int, ...]
    n_indicators: int = 0  # event indicators

    @property
    def indicator_base(self) -> int:
        return self.extra_base + len(self.extra_names)

    @property
    def shown_memory(self) -> tuple[int, ...]:
        """The parameters that are discrete variables of the model; others that events change stay inside."""
        events = self.flat.events
        return () if events is None else tuple(one.slot for one in events.assignments if one.slot >= 0)

    @property
    def flat(self) -> FlatModel:
        return self.explicit.flat

    @property
    def input_derivative_names(self) -> tuple[str, ...]:
        """`der(u)`, `der(u,2)`, …: inputs of the FMU that the index reduction needs."""
        names = self.flat.input_names
        return tuple(derivative_name(names[d.index], d.order) for d in self.explicit.input_derivatives)

    def references(self, base: int, count: int) -> tuple[int, ...]:
        return tuple(range(base, base + count))


def derivative_name(name: str, order: int = 1) -> str:
    """`der(x)`; `der(x,2)` for the second derivative; the derivative of `der(x)` is `der(x,2)`."""
    match = _DERIVATIVE.fullmatch(name)
    if match:
        name, order = match["name"], order + int(match["order"] or 1)
    return f"der({name})" if order == 1 else f"der({name},{order})"


def dynamic_unknowns(flat: FlatModel) -> tuple[int, ...]:
    """Indices of the unknowns whose derivatives occur in the equations."""
    occurs = ca.which_depends(flat.residual, flat.derivatives, 1, False) if flat.n else []
    return tuple(i for i, found in enumerate(occurs) if found)


def layout(explicit: ExplicitModel) -> Layout:
    """Value references for all variables of `explicit`. FmuError `fmu-name-twice` if two would share a
    name.
    """
    flat = explicit.flat
    dynamic = dynamic_unknowns(flat)
    sizes = (
        flat.n,
        len(dynamic),
        len(flat.inputs),
        len(explicit.input_derivatives),
        len(flat.noises),
        len(flat.parameters),
        len(flat.derived_parameters),
        len(flat.outputs),
        flat.n,
    )
    bases = [_FIRST]
    for size in sizes:
        bases.append(bases[-1] + size)
    known = {v.name: bases[0] + i for i, v in enumerate(flat.unknowns)}
    known |= {derivative_name(flat.unknowns[k].name): bases[1] + j for j, k in enumerate(dynamic)}
    extra: list[str] = []

    def reference(name: str) -> int:
        if name not in known:
            known[name] = bases[-1] + len(extra)
            extra.append(name)
        return known[name]

    states = tuple(reference(name) for name in explicit.state_names)
    rates = tuple(reference(derivative_name(name)) for name in explicit.state_names)
    unknown_names = {v.name: i for i, v in enumerate(flat.unknowns)}
    outputs = tuple(
        bases[0] + unknown_names[o.name] if o.name in unknown_names else bases[7] + i
        for i, o in enumerate(flat.outputs)
    )
    made = Layout(
        explicit=explicit,
        dynamic=dynamic,
        **dict(zip(_BASES, bases, strict=True)),
        states=states,
        rates=rates,
        extra_names=tuple(extra),
        output_references=outputs,
        n_indicators=0 if flat.events is None else EventFunctions(explicit).roots()[1].size,
    )
    _check_names(made)
    return made


def _check_names(made: Layout) -> None:
    flat = made.flat
    names = ["time", DAE_MODE_NAME, *made.input_derivative_names, *made.extra_names]
    names += [derivative_name(flat.unknowns[k].name) for k in made.dynamic]
    names += [RESIDUAL_NAME.format(i + 1) for i in range(flat.n)]
    names += [INDICATOR_NAME.format(i + 1) for i in range(made.n_indicators)]
    for group in (flat.unknowns, flat.inputs, flat.noises, flat.parameters, flat.derived_parameters):
        names += [item.name for item in group]
    names += [
        o.name for o, vr in zip(flat.outputs, made.output_references, strict=True) if vr >= made.output_base
    ]
    twice = sorted({name for name in names if names.count(name) > 1}) if len(set(names)) < len(names) else []
    if twice:
        raise FmuError(
            "fmu-name-twice",
            f"Two variables of the FMU would have the name `{twice[0]}`.",
            where=flat.source or flat.name,
            remedy="Rename one of them in the model.",
        )
