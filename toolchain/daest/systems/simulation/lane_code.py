"""C code of a CasADi function for several points at once: one lane of a vector holds one point.

Functions of scalar operations are written operation by operation, on vectors where an operand differs between
the lanes and on plain numbers elsewhere. Others, and those with an operation that is not known here, are
called for one lane after the other.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

_INFIX = {ca.OP_ADD: "+", ca.OP_SUB: "-", ca.OP_MUL: "*", ca.OP_DIV: "/"}
_COMPARED = {ca.OP_LT: "<", ca.OP_LE: "<=", ca.OP_EQ: "==", ca.OP_NE: "!=", ca.OP_AND: "&&", ca.OP_OR: "||"}
_BINARY = {
    ca.OP_POW: "pow", ca.OP_CONSTPOW: "pow", ca.OP_FMIN: "fmin", ca.OP_FMAX: "fmax", ca.OP_FMOD: "fmod",
    ca.OP_ATAN2: "atan2", ca.OP_COPYSIGN: "copysign", ca.OP_HYPOT: "hypot",
}  # fmt: skip
_UNARY = {
    getattr(ca, f"OP_{name.upper()}"): name
    for name in (
        "exp", "log", "sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh",
        "acosh", "atanh", "floor", "ceil", "fabs", "erf", "log1p", "expm1",
    )
}  # fmt: skip
_SHORT = {
    ca.OP_NEG: "(-{0})", ca.OP_SQ: "({0} * {0})", ca.OP_TWICE: "(2.0 * {0})", ca.OP_INV: "(1.0 / {0})",
    ca.OP_ASSIGN: "{0}", ca.OP_LIFT: "{0}",
}  # fmt: skip
_TESTED = {
    ca.OP_SIGN: "({0} > 0.0 ? 1.0 : {0} < 0.0 ? -1.0 : {0})",
    ca.OP_NOT: "({0} == 0.0 ? 1.0 : 0.0)",
    ca.OP_IF_ELSE_ZERO: "({0} != 0.0 ? {1} : 0.0)",
    **{operation: f"({{0}} {sign} {{1}} ? 1.0 : 0.0)" for operation, sign in _COMPARED.items()},
}


class _Unknown(Exception):
    """An operation without a form for lanes."""


def lane_function(name: str, function: ca.Function, lanes: Sequence[int]) -> str:
    """The C function `name`, whose arguments number `lanes` are vectors (`const lanes_t *`), the others plain
    numbers (`const double *`), and all results vectors (`lanes_t *`). The text of CasADi for `function`, and
    `numerics/lanes.c`, stand before it. All its arguments and results are dense."""
    kinds = [("lanes_t" if i in lanes else "double", f"a{i}") for i in range(function.n_in())]
    arguments = [f"const {kind} *{argument}" for kind, argument in kinds]
    results = [f"lanes_t *r{i}" for i in range(function.n_out())]
    try:
        body = _operations(function, lanes)
    except _Unknown:
        body = _one_by_one(function, lanes)
    lines = [f"static void {name}({', '.join(arguments + results)}) {{", *(f"  {line}" for line in body), "}"]
    return "\n".join(lines) + "\n"


def _operations(function: ca.Function, lanes: Sequence[int]) -> list[str]:
    """Every operation of an SX function as one declaration; raises _Unknown."""
    if not function.is_a("SXFunction"):
        raise _Unknown
    lines: list[str] = []
    work: dict[int, tuple[str, bool]] = {}  # place in the work vector -> C variable, whether it has lanes
    for k in range(function.n_instructions()):
        operation, target = function.instruction_id(k), function.instruction_output(k)
        source = function.instruction_input(k)
        if operation == ca.OP_OUTPUT:
            value, wide = work[source[0]]
            lines.append(f"r{target[0]}[{target[1]}] = {value if wide else f'SPREAD({value})'};")
            continue
        if operation == ca.OP_CONST:
            value, wide = _number(function.instruction_constant(k)), False
        elif operation == ca.OP_INPUT:
            value, wide = f"a{source[0]}[{source[1]}]", source[0] in lanes
        else:
            value, wide = _operation(operation, [work[place] for place in source])
        lines.append(f"const {'lanes_t' if wide else 'double'} v{k} = {value};")
        work[target[0]] = (f"v{k}", wide)
    return lines


def _operation(operation: int, operands: list[tuple[str, bool]]) -> tuple[str, bool]:
    """A C expression, and whether it has lanes."""
    names, wide = [name for name, _ in operands], any(wide for _, wide in operands)
    if operation in _INFIX:
        return f"{names[0]} {_INFIX[operation]} {names[1]}", wide
    if operation in _SHORT:
        return _SHORT[operation].format(*names), wide
    if operation in _TESTED:
        if not wide:
            return _TESTED[operation].format(*names), False
        # Each lane by itself: the operands differ between them.
        each = [f"{name}[i]" if has_lanes else name for name, has_lanes in operands]
        return f"EACH({_TESTED[operation].format(*each)})", True
    called = _UNARY.get(operation) or _BINARY.get(operation)
    if called is None:
        raise _Unknown
    if not wide:
        return f"{called}({', '.join(names)})", False
    if called in ("exp", "tanh", "sqrt", "fabs"):
        return f"lanes_{called}({names[0]})", True
    each = [f"{name}[i]" if has_lanes else name for name, has_lanes in operands]
    return f"EACH({called}({', '.join(each)}))", True


def _number(value: float) -> str:
    if value != value:
        return "NAN"
    if value in (float("inf"), float("-inf")):
        return "INFINITY" if value > 0 else "-INFINITY"
    return f"({value!r})"


def _one_by_one(function: ca.Function, lanes: Sequence[int]) -> list[str]:
    """The function that CasADi wrote, lane by lane."""
    sizes = {w: getattr(function, f"sz_{w}")() for w in ("arg", "res", "iw", "w")}
    n_in, n_out = function.n_in(), function.n_out()
    lines = [
        f"const double *arg[{sizes['arg'] + n_in}];",
        f"double *res[{sizes['res'] + n_out}];",
        f"casadi_int iw[{sizes['iw'] + 1}];",
        f"double w[{sizes['w'] + 1}];",
    ]
    lines += [f"double x{i}[{function.numel_in(i) + 1}];" for i in lanes]
    lines += [f"double y{i}[{function.numel_out(i) + 1}];" for i in range(n_out)]
    lines.append("for (int l = 0; l < LANES; ++l) {")
    lines += [f"  for (int i = 0; i < {function.numel_in(i)}; ++i) x{i}[i] = a{i}[i][l];" for i in lanes]
    lines += [f"  arg[{i}] = {'x' if i in lanes else 'a'}{i};" for i in range(n_in)]
    lines += [f"  res[{i}] = y{i};" for i in range(n_out)]
    lines.append(f"  const int failed = {function.name()}(arg, res, iw, w, 0);")
    lines += [
        f"  for (int i = 0; i < {function.numel_out(i)}; ++i) r{i}[i][l] = failed ? NAN : y{i}[i];"
        for i in range(n_out)
    ]
    return [*lines, "}"]
