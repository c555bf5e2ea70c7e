"""Syntax trees of Modelica expressions and statements, and the flat source that the compiler hands over.

These are plain values. `adapter` makes them from the compiler's output, `parse` from annotation text;
`text` prints them, `expressions` and `functions` give them their meaning.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any, Literal

from daest.modelica.language.table_files import Folders


@dataclass(frozen=True, slots=True)
class Span:
    """Bytes `start` to `end` of the source file with the compiler's number `source`."""

    source: int
    start: int
    end: int


@dataclass(frozen=True, slots=True)
class Constant:
    value: float | int | bool | str
    span: Span | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class Name:
    """A reference such as `spring.c` or `x[2]`; `name` may carry the indices of component arrays."""

    name: str
    subscripts: tuple[Node, ...] = ()
    span: Span | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class Unary:
    operator: str  # "-", "+", "not"
    operand: Node
    span: Span | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class Binary:
    operator: str  # Modelica's spelling: "+", ".*", "and", "<=" …
    left: Node
    right: Node
    span: Span | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class Call:
    """A call of a built-in operator (`builtin`), of a function, or of a record constructor."""

    function: str
    arguments: tuple[Node, ...]
    builtin: bool = False
    constructor: bool = False
    span: Span | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class Conditional:
    """`if c1 then v1 elseif … else otherwise`."""

    branches: tuple[tuple[Node, Node], ...]
    otherwise: Node
    span: Span | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class Array:
    """`{a, b}`, or a row list `[a, b; c, d]` where `is_matrix`."""

    elements: tuple[Node, ...]
    is_matrix: bool = False
    span: Span | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class Tuple:
    """`(a, b)` on the left of a call with several results; None stands for an omitted result."""

    elements: tuple[Node | None, ...]
    span: Span | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class Range:
    start: Node
    step: Node | None
    stop: Node
    span: Span | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class Comprehension:
    """`{element for i in range, …}`."""

    element: Node
    iterators: tuple[tuple[str, Node], ...]
    span: Span | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class Index:
    base: Node
    subscripts: tuple[Node, ...]
    span: Span | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class Field:
    base: Node
    name: str
    span: Span | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class Colon:
    """A whole dimension, `x[:]`."""

    span: Span | None = field(default=None, compare=False)


Node = (
    Constant
    | Name
    | Unary
    | Binary
    | Call
    | Conditional
    | Array
    | Tuple
    | Range
    | Comprehension
    | Index
    | Field
    | Colon
)


@dataclass(frozen=True, slots=True)
class Assign:
    target: Name
    value: Node
    span: Span | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class AssignCall:
    """`(a, b) := f(x)`; None stands for an omitted result."""

    targets: tuple[Name | None, ...]
    call: Call
    span: Span | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class For:
    iterators: tuple[tuple[str, Node], ...]
    body: tuple[Statement, ...]
    span: Span | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class While:
    condition: Node
    body: tuple[Statement, ...]
    span: Span | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class If:
    branches: tuple[tuple[Node, tuple[Statement, ...]], ...]
    otherwise: tuple[Statement, ...]
    span: Span | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class Jump:
    kind: Literal["return", "break"]
    span: Span | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class Assert:
    condition: Node
    message: Node
    span: Span | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class Refused:
    """A statement without a meaning here (`when`, `reinit`); `what` is its name."""

    what: str
    span: Span | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class Reinit:
    """`reinit(target, value)` of a when-equation."""

    target: Name
    value: Node
    span: Span | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class When:
    """`when c1 then … elsewhen c2 then …`, of an algorithm or among the equations."""

    branches: tuple[tuple[Node, tuple[Statement, ...]], ...]
    span: Span | None = field(default=None, compare=False)


Statement = Assign | AssignCall | For | While | If | Jump | Assert | Refused | Reinit | When


@dataclass(frozen=True, slots=True)
class FunctionVariable:
    """An input, output or local variable of a function; `shape` holds one node per dimension (Colon:
    unknown)."""

    name: str
    type_name: str
    shape: tuple[Node, ...]
    default: Node | None


@dataclass(frozen=True, slots=True)
class Function:
    name: str
    inputs: tuple[FunctionVariable, ...]
    outputs: tuple[FunctionVariable, ...]
    locals: tuple[FunctionVariable, ...]
    body: tuple[Statement, ...]
    is_external: bool


@dataclass(frozen=True, slots=True)
class FlatVariable:
    """A declared component of a primitive type. `dimensions` is () for a scalar. Attributes are nodes, None
    where the source gives none."""

    name: str
    type_name: str
    variability: Literal["constant", "parameter", "discrete", "continuous"]
    causality: Literal["input", "output", "local"]
    is_flow: bool
    is_final: bool
    is_discrete: bool  # Boolean, Integer, enumeration or String
    is_top_level: bool  # declared by the model itself, or inside a connector of the model
    dimensions: tuple[int, ...]
    start: Node | None
    fixed: tuple[bool, ...]
    min: Node | None
    max: Node | None
    nominal: Node | None
    unit: str
    description: str
    state_select: Literal["never", "avoid", "default", "prefer", "always"]
    binding: Node | None
    span: Span | None
    is_bus_member: bool = False  # of an expandable connector


def real_variable(name: str, span: Span | None) -> FlatVariable:
    """A scalar Real variable of which nothing else is declared."""
    return FlatVariable(
        name, "Real", "continuous", "local", False, False, False, False, (), None, (), None, None, None, "",
        "", "default", None, span,
    )  # fmt: skip


@dataclass(frozen=True, slots=True)
class FlatEquation:
    """`left = right` (right None: `left = 0`), scalar or array; `origin` is the component, or the
    connectors."""

    left: Node
    right: Node | None
    kind: Literal["component", "connection", "flow", "unconnected", "binding"]
    origin: str
    span: Span | None
    bound: tuple[tuple[str, int], ...] = ()  # values of the for-iterators that occur in the nodes


@dataclass(frozen=True, slots=True)
class FlatAlgorithm:
    """An algorithm section of component `origin`."""

    body: tuple[Statement, ...]
    origin: str
    span: Span | None


@dataclass(frozen=True, slots=True)
class Mark:
    """The place of a hidden algorithm section, by its number, in `component`, and what names mean there."""

    number: int
    component: str
    meant: dict[str, Node]


@dataclass(frozen=True)
class FlatSource:
    """What the compiler knows about one model."""

    name: str
    description: str
    variables: tuple[FlatVariable, ...]
    equations: tuple[FlatEquation, ...]
    initial_equations: tuple[FlatEquation, ...]
    algorithms: tuple[FlatAlgorithm, ...]
    functions: dict[str, Function]
    records: dict[str, tuple[str, ...]]  # component of a record type -> its fields
    literals: dict[str, int]  # enumeration literal -> ordinal
    structural: frozenset[str]  # parameters that sizes, loops or branches were decided on
    initial_algorithms: tuple[FlatAlgorithm, ...]
    whens: tuple[When, ...] = ()  # the when-equations
    marks: tuple[Mark, ...] = ()  # where algorithm sections are hidden from the compiler
    settled: frozenset[str] = frozenset()  # variables that keep the value that the start gives them
    texts: dict[int, tuple[str, bytes]] = field(default_factory=dict)  # source number -> file name, text
    own: tuple[int, ...] = ()  # the number of the file that was asked for
    folders: Folders = field(default_factory=Folders)  # where files with tables are looked for


def nodes(tree: object) -> Iterator[Any]:
    """All nodes, statements and declarations of a tree, or of a tuple of trees, the outer ones first, in the
    order of the text."""
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        if isinstance(node, tuple):
            waiting += reversed(node)
        elif is_dataclass(node) and not isinstance(node, Span):
            yield node
            waiting += [getattr(node, one.name) for one in reversed(fields(node))]


def rebuilt(node: Any, change: Callable[[Any], Any]) -> Any:
    """A node, statement or tuple of them, with what `change` makes of each of its parts."""
    if isinstance(node, tuple):
        return tuple(change(part) for part in node)
    if not is_dataclass(node) or isinstance(node, Span | Constant):
        return node
    kind: Any = type(node)
    return kind(*(change(getattr(node, one.name)) for one in fields(node)))
