"""The one place that knows the shape of the compiler's output: rumoca's flat form -> `FlatSource`.

rumoca hands over nested dicts, one single-key dict per tree node (`{"Binary": {"op": "Add", …}}`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import product
from math import prod
from typing import Any, Literal, TypeGuard

from daest.errors import ModelError
from daest.modelica.forms.dialect import CONSTRUCTOR, MARK, OPERATORS
from daest.modelica.forms.modification_trees import unpacked
from daest.modelica.language import syntax as s
from daest.modelica.language.text import text

_BINARY = {
    "Add": "+",
    "Sub": "-",
    "Mul": "*",
    "Div": "/",
    "Exp": "^",
    "AddElem": ".+",
    "SubElem": ".-",
    "MulElem": ".*",
    "DivElem": "./",
    "ExpElem": ".^",
    "Eq": "==",
    "Neq": "<>",
    "Lt": "<",
    "Le": "<=",
    "Gt": ">",
    "Ge": ">=",
    "And": "and",
    "Or": "or",
}
_UNARY = {"Minus": "-", "DotMinus": "-", "Plus": "+", "DotPlus": "+", "Not": "not"}
_VARIABILITY: dict[str, Literal["constant", "parameter", "discrete", "continuous"]] = {
    "Constant": "constant",
    "Parameter": "parameter",
    "Discrete": "discrete",
}
_CAUSALITY: dict[str, Literal["input", "output", "local"]] = {"Input": "input", "Output": "output"}
_STATE_SELECT: dict[str, Literal["never", "avoid", "default", "prefer", "always"]] = {
    "Never": "never",
    "Avoid": "avoid",
    "Prefer": "prefer",
    "Always": "always",
}
_DISCRETE_TYPES = ("Boolean", "Integer", "String")


def flat_source(
    name: str, flat: dict[str, Any], texts: dict[int, tuple[str, bytes]], own: tuple[int, ...]
) -> s.FlatSource:
    """The flat form of model `name`; `texts` maps source numbers to file name and text, `own` is the number
    of the user's file."""
    return s.FlatSource(
        name=name,
        description=flat.get("model_description") or "",
        variables=tuple(_variable(v, flat) for v in flat["variables"].values()),
        equations=tuple(_equations(flat["equations"], flat["structured_equations"])),
        initial_equations=tuple(
            _equations(flat["initial_equations"], flat.get("initial_structured_equations", []))
        ),
        algorithms=tuple(_algorithm(section) for section in flat.get("algorithms", [])),
        functions={key: _function(value) for key, value in flat["functions"].items()},
        records=_records(flat),
        literals=dict(flat.get("enum_literal_ordinals", {})),
        structural=_structural(flat),
        initial_algorithms=tuple(_algorithm(section) for section in flat.get("initial_algorithms", [])),
        whens=tuple(_when_equation(chain) for chain in flat.get("when_chains", [])),
        marks=tuple(_marks(flat.get("assert_equations", []))),
        texts=texts,
        own=own,
    )


def _key(value: Any) -> str:
    return value if isinstance(value, str) else next(iter(value))


def span(value: dict[str, Any] | None) -> s.Span | None:
    return s.Span(value["source"], value["start"], value["end"]) if value else None


def _variable(v: dict[str, Any], flat: dict[str, Any]) -> s.FlatVariable:
    name = v["name"]
    type_name = flat["variable_type_names"].get(name, "Real")
    binding, given = unpacked(expression(v["binding"]) if v["binding"] else None)
    return s.FlatVariable(
        name=name,
        type_name=type_name,
        variability=_VARIABILITY.get(_key(v["variability"]), "continuous"),
        causality=_CAUSALITY.get(_key(v["causality"]), "local"),
        is_flow=bool(v["flow"]),
        is_final=bool(flat["variable_final_flags"].get(name)),
        is_discrete=bool(v["is_discrete_type"]) or type_name in _DISCRETE_TYPES or _is_enumeration(v, flat),
        is_top_level=_is_top_level(name, flat),
        dimensions=tuple(v["dims"]),
        start=given.get("start") or _declared(v["start"], v),
        fixed=tuple(v["fixed"] or ()),
        min=given.get("min") or _declared(v["min"], v),
        max=given.get("max") or _declared(v["max"], v),
        nominal=given.get("nominal") or _declared(v["nominal"], v),
        unit=_unit(given.get("unit")) or (v["unit"] if isinstance(v["unit"], str) else ""),
        description=v["description"] or "",
        state_select=_STATE_SELECT.get(v["state_select"], "default"),
        binding=binding,
        span=span(v["source_span"]),
        is_bus_member=bool(v.get("from_expandable_connector")),
    )


def _unit(node: s.Node | None) -> str:
    return str(node.value) if isinstance(node, s.Constant) else ""


def _is_top_level(name: str, flat: dict[str, Any]) -> bool:
    outer = name.split(".")[0].split("[")[0]
    return "." not in name or outer in flat.get("top_level_connectors", ())


def _is_enumeration(v: dict[str, Any], flat: dict[str, Any]) -> bool:
    effective = flat.get("effective_types", {}).get(str(v["type_id"]), {})
    return effective.get("canonical_type") in flat.get("enumeration_types", [])


def _declared(value: dict[str, Any] | None, v: dict[str, Any]) -> s.Node | None:
    """The attribute, or None for the default that the compiler fills in (it carries the span of the
    variable)."""
    if not value:
        return None
    node = expression(value)
    filled_in = isinstance(node, s.Constant) and node.span == span(v["source_span"])
    return None if filled_in else node


def _records(flat: dict[str, Any]) -> dict[str, tuple[str, ...]]:
    types = flat.get("record_types", {})
    found = {}
    for name, instance in flat.get("record_instances", {}).items():
        record = types.get(str(instance["type_def_id"]))
        if record is not None:
            found[name] = tuple(f["name"] for f in record["fields"])
    return found


def _structural(flat: dict[str, Any]) -> frozenset[str]:
    selections = flat.get("parameter_branch_selections", [])
    return frozenset(".".join(path) for choice in selections for path in choice["references"])


def _first_span(value: Any) -> s.Span | None:
    """The first statement or equation span below `value`; spans of referenced declarations do not count."""
    if isinstance(value, dict):
        if isinstance(value.get("span"), dict):
            return span(value["span"])
        inner: Iterable[Any] = (v for k, v in value.items() if k != "component_ref")
    elif isinstance(value, list):
        inner = value
    else:
        return None
    return next((found for found in map(_first_span, inner) if found is not None), None)


# Equations --------------------------------------------------------------------------------------------------


def _equations(rows: list[dict[str, Any]], families: list[dict[str, Any]]) -> Iterable[s.FlatEquation]:
    """All equations; the inner points of a large for-loop come from the loop's template, for the compiler
    fills in their rows with a placeholder."""
    expanded = {family["first_equation_index"]: family for family in families if _has_placeholders(family)}
    at = 0
    while at < len(rows):
        family = expanded.get(at)
        if family is None:
            yield _equation(rows[at], rows[at]["residual"])
            at += 1
        else:
            yield from _family(family, rows[at])
            n_points = prod(len(_values(binder)) for binder in family["domain"]["binders"])
            at += n_points * family["equations_per_point"]


def _has_placeholders(family: dict[str, Any]) -> bool:
    return not family.get("interiors_materialized", True) and bool(family.get("template"))


def _values(binder: dict[str, Any]) -> range:
    step = binder.get("step", 1)
    return range(binder["lower"], binder["upper"] + (1 if step > 0 else -1), step)


def _family(family: dict[str, Any], row: dict[str, Any]) -> Iterable[s.FlatEquation]:
    bodies = [_equation(row | {"span": family["span"]}, body) for body in family["template"]["body"]]
    named = [[(b["display_name"], value) for value in _values(b)] for b in family["domain"]["binders"]]
    for point in product(*named):
        for body in bodies:
            yield replace(body, bound=point)


def _equation(row: dict[str, Any], residual: dict[str, Any]) -> s.FlatEquation:
    kind, origin = _origin(row["origin"], residual)
    left, right = _sides(expression(residual), kind)
    return s.FlatEquation(left, right, kind, origin, span(row.get("span")))


def _sides(residual: s.Node, kind: str) -> tuple[s.Node, s.Node | None]:
    if kind == "flow":
        return residual, None
    if _is_difference(residual):
        return residual.left, residual.right
    if isinstance(residual, s.Conditional):
        values = [value for _, value in residual.branches] + [residual.otherwise]
        differences = [value for value in values if _is_difference(value)]
        if len(differences) == len(values):
            return _branch_sides(residual, [d.left for d in differences]), _branch_sides(
                residual, [d.right for d in differences]
            )
    return residual, None


def _is_difference(node: s.Node) -> TypeGuard[s.Binary]:
    return isinstance(node, s.Binary) and node.operator == "-"


def _branch_sides(residual: s.Conditional, sides: list[s.Node]) -> s.Node:
    """One side of an if-equation: the side itself where all branches share it, else an if-expression."""
    if all(side == sides[0] for side in sides):
        return sides[0]
    conditions = [condition for condition, _ in residual.branches]
    return s.Conditional(tuple(zip(conditions, sides[:-1], strict=True)), sides[-1], residual.span)


_Kind = Literal["component", "connection", "flow", "unconnected", "binding"]


def _origin(origin: dict[str, Any], residual: dict[str, Any]) -> tuple[_Kind, str]:
    key = _key(origin)
    value = origin[key]
    if key == "Connection":
        return "connection", f"{_parent(value['lhs'])}, {_parent(value['rhs'])}"
    if key == "FlowSum":
        return "flow", ", ".join(dict.fromkeys(_parent(name) for name in _names(residual)))
    if key == "UnconnectedFlow":
        return "unconnected", _parent(value["variable"])
    if key == "Binding":
        return "binding", _parent(value["variable"])
    return "component", str(value.get("component", ""))


def _parent(name: str) -> str:
    """`a.flange` of `a.flange.phi`; a connector that is itself a variable (`u`) stands for itself."""
    head, dot, _ = name.rpartition(".")
    return head if dot else name


def _names(node: Any) -> Iterable[str]:
    if isinstance(node, dict):
        if "VarRef" in node:
            yield node["VarRef"]["name"]["name"]
            return
        for value in node.values():
            yield from _names(value)
    elif isinstance(node, list):
        for value in node:
            yield from _names(value)


# Expressions ------------------------------------------------------------------------------------------------


def expression(node: dict[str, Any]) -> s.Node:
    """The tree of one expression. Raises ModelError for a kind of node that has no meaning here."""
    kind, value = next(iter(node.items()))
    if kind not in _EXPRESSIONS:
        raise ModelError(
            "model-unsupported",
            f"an expression of the kind `{kind}` is not supported",
            remedy="Write it with operators, functions and if-expressions.",
        )
    return _EXPRESSIONS[kind](value, span(value.get("span")))


def _expressions(nodes: Iterable[dict[str, Any]]) -> tuple[s.Node, ...]:
    return tuple(expression(node) for node in nodes)


def _subscript(node: dict[str, Any]) -> s.Node:
    kind, value = next(iter(node.items()))
    if kind == "Index":
        return s.Constant(value["value"], span(value.get("span")))
    if kind == "Expr":
        return expression(value["expr"])
    return s.Colon(span(value.get("span")))


def _subscripts(nodes: Iterable[dict[str, Any]]) -> tuple[s.Node, ...]:
    return tuple(_subscript(node) for node in nodes)


def _literal(value: dict[str, Any], at: s.Span | None) -> s.Node:
    return s.Constant(next(iter(value["value"].values())), at)


def _name(value: dict[str, Any], at: s.Span | None) -> s.Node:
    return s.Name(value["name"]["name"], _subscripts(value["subscripts"]), at)


def _binary(value: dict[str, Any], at: s.Span | None) -> s.Node:
    left, right = expression(value["lhs"]), expression(value["rhs"])
    if isinstance(right, s.Call) and right.function.endswith(CONSTRUCTOR):
        return right  # of an object, which the text for the compiler multiplies by one
    return s.Binary(_BINARY[value["op"]], left, right, at)


def _unary(value: dict[str, Any], at: s.Span | None) -> s.Node:
    return s.Unary(_UNARY[value["op"]], expression(value["rhs"]), at)


def _builtin(value: dict[str, Any], at: s.Span | None) -> s.Node:
    name = value["function"]
    return s.Call(name[0].lower() + name[1:], _expressions(value["args"]), builtin=True, span=at)


def _call(value: dict[str, Any], at: s.Span | None) -> s.Call:
    constructor = bool(value.get("is_constructor"))
    name = value["name"]["name"]
    if name in OPERATORS:
        return s.Call(OPERATORS[name], _expressions(value["args"]), builtin=True, span=at)
    return s.Call(name, _expressions(value["args"]), constructor=constructor, span=at)


def _conditional(value: dict[str, Any], at: s.Span | None) -> s.Node:
    branches = tuple((expression(c), expression(v)) for c, v in value["branches"])
    return s.Conditional(branches, expression(value["else_branch"]), at)


def _array(value: dict[str, Any], at: s.Span | None) -> s.Node:
    """`{a, b}`, or a matrix: of several rows, `[a; b]`, or of one, `[a, b]`."""
    parts = _expressions(value["elements"])
    if value.get("kind") == "Horizontal":
        return s.Array((s.Array(parts, span=at),), True, at)
    if value.get("kind") == "Vertical":
        rows = [part.elements[0] if isinstance(part, s.Array) and part.is_matrix else part for part in parts]
        return s.Array(tuple(rows), True, at)
    return s.Array(parts, bool(value.get("is_matrix")), at)


def _tuple(value: dict[str, Any], at: s.Span | None) -> s.Node:
    return s.Tuple(tuple(None if "Empty" in e else expression(e) for e in value["elements"]), at)


def _range(value: dict[str, Any], at: s.Span | None) -> s.Node:
    step = expression(value["step"]) if value.get("step") else None
    return s.Range(expression(value["start"]), step, expression(value["end"]), at)


def _comprehension(value: dict[str, Any], at: s.Span | None) -> s.Node:
    iterators = tuple((index["name"], expression(index["range"])) for index in value["indices"])
    return s.Comprehension(expression(value["expr"]), iterators, at)


def _index(value: dict[str, Any], at: s.Span | None) -> s.Node:
    return s.Index(expression(value["base"]), _subscripts(value["subscripts"]), at)


def _field(value: dict[str, Any], at: s.Span | None) -> s.Node:
    return s.Field(expression(value["base"]), value["field"], at)


_EXPRESSIONS: dict[str, Callable[[dict[str, Any], s.Span | None], s.Node]] = {
    "Literal": _literal,
    "VarRef": _name,
    "Binary": _binary,
    "Unary": _unary,
    "BuiltinCall": _builtin,
    "FunctionCall": _call,
    "If": _conditional,
    "Array": _array,
    "Tuple": _tuple,
    "Range": _range,
    "ArrayComprehension": _comprehension,
    "Index": _index,
    "FieldAccess": _field,
    # String(x) stands in messages of assertions, which are not looked at.
    "StringConversion": lambda _value, at: s.Constant("", at),
}


# Functions --------------------------------------------------------------------------------------------------


def _algorithm(section: dict[str, Any]) -> s.FlatAlgorithm:
    origin = section.get("origin") or {}
    component: Any = next(iter(origin.values()), {}) if isinstance(origin, dict) else {}
    name = component.get("component", "") if isinstance(component, dict) else ""
    return s.FlatAlgorithm(_statements(section["statements"]), name, _first_span(section))


def _function(value: dict[str, Any]) -> s.Function:
    return s.Function(
        name=value["name"],
        inputs=tuple(_function_variable(v) for v in value["inputs"]),
        outputs=tuple(_function_variable(v) for v in value["outputs"]),
        locals=tuple(_function_variable(v) for v in value["locals"]),
        body=_statements(value["body"]),
        is_external=value.get("external") is not None,
    )


def _function_variable(value: dict[str, Any]) -> s.FunctionVariable:
    default = expression(value["default"]) if value.get("default") else None
    shape = _subscripts(value["shape_expr"])
    if not shape:  # `type Vector = Real[3]` has a size of its own
        sizes = (value.get("effective_type") or {}).get("dimensions") or ()
        shape = tuple(s.Constant(size) if isinstance(size, int) and size > 0 else s.Colon() for size in sizes)
    return s.FunctionVariable(value["name"], value["type_name"], shape, default)


def _statements(nodes: Iterable[dict[str, Any]] | None) -> tuple[s.Statement, ...]:
    return tuple(made for node in nodes or () for made in _statement(node))


def _statement(node: dict[str, Any]) -> Iterable[s.Statement]:
    kind, value = next(iter(node.items()))
    if kind != "Empty":
        yield _STATEMENTS.get(kind, _unknown_statement(kind))(value, span(value.get("span")))


def _unknown_statement(kind: str) -> Callable[[dict[str, Any], s.Span | None], s.Statement]:
    return lambda _value, at: s.Refused(kind.lower(), at)


def _target(reference: dict[str, Any]) -> s.Name:
    *path, last = reference["parts"]
    name = ".".join([*map(_component, path), last["ident"]])
    return s.Name(name, _subscripts(last["subs"]), span(reference.get("span")))


def _component(part: dict[str, Any]) -> str:
    """`s[1]`, a component on the way to a variable."""
    indices = [text(node) for node in _subscripts(part["subs"])]
    return part["ident"] + (f"[{','.join(indices)}]" if indices else "")


def _assignment(value: dict[str, Any], at: s.Span | None) -> s.Statement:
    return s.Assign(_target(value["comp"]), expression(value["value"]), at)


def _call_statement(value: dict[str, Any], at: s.Span | None) -> s.Statement:
    call = s.Call(value["comp"]["name"], _expressions(value["args"]), span=at)
    targets = tuple(_target(t) if t and t.get("parts") else None for t in value["outputs"])
    return s.AssignCall(targets, call, at)


def _for(value: dict[str, Any], at: s.Span | None) -> s.Statement:
    iterators = tuple((index["ident"], expression(index["range"])) for index in value["indices"])
    return s.For(iterators, _statements(value["equations"]), at)


def _while(value: dict[str, Any], at: s.Span | None) -> s.Statement:
    block = value["block"]
    return s.While(expression(block["cond"]), _statements(block["stmts"]), at)


def _if(value: dict[str, Any], at: s.Span | None) -> s.Statement:
    branches = tuple((expression(b["cond"]), _statements(b["stmts"])) for b in value["cond_blocks"])
    return s.If(branches, _statements(value.get("else_block")), at)


def _assert(value: dict[str, Any], at: s.Span | None) -> s.Statement:
    return s.Assert(expression(value["condition"]), expression(value["message"]), at)


def _when(value: dict[str, Any], at: s.Span | None) -> s.Statement:
    return s.When(tuple((expression(b["cond"]), _statements(b["stmts"])) for b in value["blocks"]), at)


def _ended(_value: dict[str, Any], at: s.Span | None) -> s.Statement:
    """`terminate(…)`: a recording decides how long a simulation takes."""
    return s.Assert(s.Constant(True), s.Constant(""), at)


_STATEMENTS: dict[str, Callable[[dict[str, Any], s.Span | None], s.Statement]] = {
    "Assignment": _assignment,
    "FunctionCall": _call_statement,
    "For": _for,
    "While": _while,
    "If": _if,
    "Assert": _assert,
    "When": _when,
    "Terminate": _ended,
    "Return": lambda _value, at: s.Jump("return", at),
    "Break": lambda _value, at: s.Jump("break", at),
}


# Assertions that stand for algorithm sections ---------------------------------------------------------------


def _marks(assertions: Iterable[dict[str, Any]]) -> Iterable[s.Mark]:
    """The marks among assertions: `"daest:3" + String(a) + String(b)`."""
    for assertion in assertions:
        parts = _summands(assertion["message"])
        first = parts[0].get("Literal", {}).get("value", {}).get("String", "")
        if first.startswith(MARK):
            values = [expression(part["StringConversion"]["value"]) for part in parts[1:]]
            number, *names = first.removeprefix(MARK).split(",")
            meant = dict(zip(names, values, strict=True))
            yield s.Mark(int(number), _key_component(assertion["origin"]), meant)


def _summands(node: dict[str, Any]) -> list[dict[str, Any]]:
    if "Binary" not in node:
        return [node]
    return [*_summands(node["Binary"]["lhs"]), *_summands(node["Binary"]["rhs"])]


def _key_component(origin: dict[str, Any]) -> str:
    value = next(iter(origin.values()))
    return str(value.get("component", "")) if isinstance(value, dict) else ""


# When-equations ---------------------------------------------------------------------------------------------


def _when_equation(chain: dict[str, Any]) -> s.When:
    blocks = [chain["first"], *chain.get("else_when", [])]
    branches = tuple((expression(b["condition"]), _when_body(b["equations"])) for b in blocks)
    return s.When(branches, _first_span(chain))


def _when_body(equations: Iterable[dict[str, Any]]) -> tuple[s.Statement, ...]:
    return tuple(_when_part(next(iter(equation)), next(iter(equation.values()))) for equation in equations)


def _when_part(kind: str, value: dict[str, Any]) -> s.Statement:
    at = span(value.get("span"))
    if kind == "Assign":
        return s.Assign(s.Name(value["target"], (), at), expression(value["value"]), at)
    if kind == "Reinit":
        return s.Reinit(s.Name(value["state"], (), at), expression(value["value"]), at)
    if kind == "Assert":
        return s.Assert(expression(value["condition"]), s.Constant(""), at)
    if kind == "Terminate":
        return _ended(value, at)
    if kind == "Conditional":
        branches = tuple((expression(c), _when_body(body)) for c, body in value["branches"])
        return s.If(branches, _when_body(value.get("else_branch") or ()), at)
    if kind == "FunctionCallOutputs":
        call = expression(value["function"])
        if isinstance(call, s.Call):
            return s.AssignCall(tuple(s.Name(name, (), at) for name in value["outputs"]), call, at)
    return s.Refused(kind.lower(), at)
