"""C sources of an FMU: generated functions (model.c) and constants (model.h) beside the fixed wrapper
(fmi3.c).
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files
from typing import Any

import casadi as ca
import numpy as np

from daest.errors import FmuError
from daest.fmu.layout import Layout

WRAPPER = "fmi3"


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
        generator.add(function.forward(1))
    try:
        return generator.dump()
    except RuntimeError as problem:
        raise FmuError(
            "fmu-code-generation",
            f"No C code can be generated for this model: {str(problem).splitlines()[-1]}",
            remedy="Simplify the algebraic loop that the message names, or report it.",
        ) from problem


def model_header(layout: Layout, state_start: np.ndarray, token: str) -> str:
    """model.h: sizes, value references and start values."""
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
    }
    lines = [f"#define {name} {value}u" for name, value in (sizes | references).items()]
    lines.append(f'#define INSTANTIATION_TOKEN "{token}"')
    lines += [
        _array("fmi3ValueReference", "STATE", [f"{vr}u" for vr in layout.states]),
        _array("fmi3ValueReference", "STATE_RATE", [f"{vr}u" for vr in layout.rates]),
        _array("double", "STATE_START", _numbers(state_start)),
        _array("double", "STATE_NOMINAL", _numbers(state_nominals(layout))),
        _array("double", "INPUT_START", _numbers([v.start or 0.0 for v in flat.inputs])),
        _array("double", "PARAMETER_START", _numbers(flat.theta_values)),
    ]
    return "\n".join(lines) + "\n"


def state_nominals(layout: Layout) -> list[float]:
    """The size of each state: the nominal of its unknown, else 1; never 0."""
    nominal = {layout.xi_base + i: v.nominal for i, v in enumerate(layout.flat.unknowns)}
    return [abs(nominal.get(vr) or 1.0) for vr in layout.states]


def _numbers(values: Sequence[float] | np.ndarray) -> list[str]:
    return [repr(float(v)) for v in values]


def _array(kind: str, name: str, entries: list[str]) -> str:
    """A constant C array with one spare element, because C has none of size zero."""
    return f"static const {kind} {name}[{len(entries) + 1}] = {{{', '.join([*entries, '0'])}}};"


def wrapper_code() -> str:
    """fmi3.c, the fixed part."""
    return files("daest.fmu").joinpath("wrapper.c").read_text(encoding="utf-8")
