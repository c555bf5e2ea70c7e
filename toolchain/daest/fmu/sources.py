"""C sources of an FMU: generated functions (model.c) and constants (model.h) beside the fixed wrapper
(fmi3.c).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from daest.errors import FmuError
from daest.fmu.layout import Layout
from daest.model.events import Events
from daest.systems.events.event_functions import EventFunctions
from daest.systems.events.event_update import EventUpdate, Mode

WRAPPER = "fmi3"
EVENTS = "events.c"
SHARED = "fmi3_shared.h"  # which the wrapper includes


_AT_EVENTS = ("model_at", "model_roots", "model_clock")


def model_functions(layout: Layout) -> list[ca.Function]:
    """The functions that the wrapper calls, by the names that it knows; three of them in the FMU's two modes.

    ODE mode: (x, u, v, w, theta, t) -> model_rhs ẋ, model_variables ξ, model_derivatives (the dynamic part of
    ξ'), model_outputs y, model_derived (calculated parameters). DAE mode: (ξ' dynamic, ξ, u, w, theta, t) ->
    model_residual F, model_dae_outputs y.
    """
    explicit, flat = layout.explicit, layout.flat
    dynamic = list(layout.dynamic)
    symbols: list[Any] = explicit.rhs.sx_in() if explicit.rhs.is_a("SXFunction") else explicit.rhs.mx_in()
    theta = symbols[4]
    derived = ca.Function("derived", [flat.theta], [flat.derived_values])
    functions = [
        ca.Function("model_rhs", symbols, [explicit.rhs(*symbols)]),
        ca.Function("model_variables", symbols, [explicit.variables(*symbols)]),
        ca.Function("model_derivatives", symbols, [explicit.variable_derivatives(*symbols)[dynamic]]),
        ca.Function("model_outputs", symbols, [explicit.outputs(*symbols)]),
        ca.Function("model_derived", symbols, [derived(theta)]),
    ]
    some = ca.SX.sym("derivatives", len(dynamic))
    every = ca.SX.zeros(flat.n)
    every[dynamic] = some
    residual, outputs = ca.substitute(
        [ca.densify(flat.residual), ca.densify(flat.output_expressions)], [flat.derivatives], [every]
    )
    arguments = [some, flat.xi, flat.u, flat.w, flat.theta, flat.time]
    functions += [
        ca.Function("model_residual", arguments, [residual]),
        ca.Function("model_dae_outputs", arguments, [outputs]),
    ]
    return [_dense(f) for f in functions]


def _events_from_scratch(layout: Layout) -> EventFunctions:
    """The events in functions without a guess of their loops, which a caller of the FMU does not give."""
    return EventFunctions(replace(layout.explicit, near=None, near_variables=None, near_derivatives=None))


def event_functions(layout: Layout) -> list[ca.Function]:
    """What the model does at events: model_at, everything at one instant; model_roots, the event indicators;
    model_clock, what moves with time alone."""
    if layout.flat.events is None:
        return []
    functions = _events_from_scratch(layout)
    roots, _ = functions.roots()
    pairs = (("model_at", functions.whole), ("model_roots", roots), ("model_clock", functions.along_time))
    return [_named(name, function) for name, function in pairs]


def _named(name: str, function: ca.Function) -> ca.Function:
    symbols: list[Any] = function.sx_in() if function.is_a("SXFunction") else function.mx_in()
    results = function(*symbols)
    return ca.Function(name, symbols, list(results) if isinstance(results, tuple) else [results])


def _dense(function: ca.Function) -> ca.Function:
    """The same function with a dense result: the wrapper reads every entry."""
    if function.sparsity_out(0).is_dense():
        return function
    symbols: list[Any] = function.sx_in() if function.is_a("SXFunction") else function.mx_in()
    return ca.Function(function.name(), symbols, [ca.densify(function(*symbols))])


def model_code(functions: Sequence[ca.Function]) -> str:
    """model.c: the functions and their forward derivatives as C."""
    generator = ca.CodeGenerator("model", {"with_header": False})
    for function in functions:
        generator.add(function)
        if function.n_out() == 1 and function.name() not in _AT_EVENTS:
            generator.add(function.forward(1))
    return code_of(generator.dump)


def code_of(generate: Callable[[], str]) -> str:
    """The C code that `generate` makes; its failure is the FmuError `fmu-code-generation`."""
    try:
        return generate()
    except RuntimeError as problem:
        raise FmuError(
            "fmu-code-generation",
            f"No C code can be generated for this model: {str(problem).splitlines()[-1]}",
            remedy="Simplify the algebraic loop that the message names, or report it.",
        ) from problem


def model_header(layout: Layout, state_start: np.ndarray, token: str) -> str:
    """model.h: sizes, value references and start values. Shapes: state_start (n_states,)."""
    explicit, flat = layout.explicit, layout.flat
    sizes = {
        "N_X": explicit.n_states,
        "N_XI": flat.n,
        "N_DXI": len(layout.dynamic),
        "N_U": len(flat.inputs),
        "N_V": len(explicit.input_derivatives),
        "N_W": len(flat.noises),
        "N_THETA": len(flat.parameters),
        "N_DERIVED": len(flat.derived_parameters),
        "N_Y": len(flat.outputs),
        "N_ROOTS": layout.n_indicators,
    }
    references = {
        "VR_TIME": 0,
        "VR_DAE_MODE": 1,
        "VR_XI": layout.xi_base,
        "VR_DXI": layout.derivative_base,
        "VR_U": layout.input_base,
        "VR_V": layout.input_derivative_base,
        "VR_W": layout.noise_base,
        "VR_THETA": layout.parameter_base,
        "VR_DERIVED": layout.derived_base,
        "VR_Y": layout.output_base,
        "VR_RESIDUAL": layout.residual_base,
        "VR_INDICATOR": layout.indicator_base,
    }
    lines = [f"#define HAS_EVENTS {int(flat.events is not None)}"]
    lines += [f"#define {name} {value}u" for name, value in (sizes | references).items()]
    lines.append(f'#define INSTANTIATION_TOKEN "{token}"')
    lines += [
        _array("fmi3ValueReference", "STATE", [f"{vr}u" for vr in layout.states]),
        _array("fmi3ValueReference", "STATE_RATE", [f"{vr}u" for vr in layout.rates]),
        _array("double", "STATE_START", _numbers(state_start)),
        _array("double", "STATE_NOMINAL", _numbers(state_nominals(layout))),
        _array("double", "INPUT_START", _numbers([v.start or 0.0 for v in flat.inputs])),
        _array("double", "PARAMETER_START", _numbers(flat.theta_values)),
        _array("unsigned char", "IS_MEMORY", [str(int(p.is_memory)) for p in flat.parameters]),
    ]
    if flat.events is not None:
        lines += _event_tables(layout, flat.events, state_start)
    return "\n".join(lines) + "\n"


def _event_tables(layout: Layout, events: Events, state_start: np.ndarray) -> list[str]:
    """Sizes and tables of what happens at events; the names are those of `model.events`."""
    functions = _events_from_scratch(layout)
    n_ubar = layout.explicit.rhs.numel_in(1) + layout.explicit.rhs.numel_in(2)
    mode = Mode(layout.flat.theta_values, np.zeros(0), np.zeros(0))
    ubar = np.zeros(n_ubar)
    ubar[: len(layout.flat.inputs)] = [v.start or 0.0 for v in layout.flat.inputs]
    start = EventUpdate(functions, state_start, mode, ubar, 0.0)
    moved = [start.state_behind(one.unknown) if one.is_real else (0, 1.0) for one in events.assignments]
    restarted = [start.state_behind(one.unknown) for one in events.restarts]
    n = len(events.activations)
    before = [int(j in one.before) for one in events.activations for j in range(n)]
    sizes = {
        "N_RELATIONS": len(events.relations),
        "N_WHOLES": len(events.whole_parts),
        "N_CONDITIONS": events.conditions.numel(),
        "N_ACTIVE": n,
        "N_TICKS": events.ticks.numel(),
        "N_ASSIGNED": len(events.assignments),
        "N_MEMORIES": len(events.memories),
        "N_RESTARTS": len(events.restarts),
        "N_STARTS": len(events.start_slots),
    }
    tables: list[tuple[str, str, Sequence[float]]] = [
        ("int", "RELATION_SLOT", [one.slot for one in events.relations]),
        ("unsigned char", "RELATION_IS_STRICT", [int(one.is_strict) for one in events.relations]),
        ("int", "WHOLE_SLOT", [one.slot for one in events.whole_parts]),
        ("unsigned char", "IS_TIMED", [int(one) for one in functions.timed]),
        ("unsigned", "ROOT_OWNER", [int(one) for one in functions.roots()[1]]),
        ("unsigned", "ACTIVE_FIRST", [one.first for one in events.activations]),
        ("unsigned", "ACTIVE_LAST", [one.last for one in events.activations]),
        ("unsigned char", "ACTIVE_BEFORE", before),
        ("int", "ASSIGNED_SLOT", [one.slot for one in events.assignments]),
        ("int", "ASSIGNED_UNKNOWN", [one.unknown for one in events.assignments]),
        ("unsigned", "ASSIGNED_STATE", [state for state, _ in moved]),
        ("double", "ASSIGNED_SHARE", [share for _, share in moved]),
        ("int", "MEMORY_SLOT", [one.slot for one in events.memories]),
        ("unsigned", "RESTART_UNKNOWN", [one.unknown for one in events.restarts]),
        ("unsigned", "RESTART_STATE", [state for state, _ in restarted]),
        ("double", "RESTART_SHARE", [share for _, share in restarted]),
        ("int", "START_SLOT", events.start_slots),
    ]
    return [
        *(f"#define {name} {value}u" for name, value in sizes.items()),
        f"#define INITIAL_SLOT {events.initial_slot}",
        *(_array(kind, name, [repr(value) for value in values]) for kind, name, values in tables),
    ]


def state_nominals(layout: Layout) -> list[float]:
    """The size of each state: the nominal of its unknown, else 1; never 0."""
    nominal = {layout.xi_base + i: v.nominal for i, v in enumerate(layout.flat.unknowns)}
    return [abs(nominal.get(vr) or 1.0) for vr in layout.states]


def _numbers(values: Sequence[float] | np.ndarray) -> list[str]:
    return [repr(float(v)) for v in values]


def _array(kind: str, name: str, entries: list[str]) -> str:
    """A constant C array with one spare element, because C has none of size zero."""
    return f"static const {kind} {name}[{len(entries) + 1}] = {{{', '.join([*entries, '0'])}}};"
