"""Bare equations, inputs and outputs opened for effects: the text of a model changed so that a class that
extends it can put something in. Nothing in it changes as long as nothing is put in.

- A balance such as `m*der(v) = F - d*v` takes up the sum of what is connected to a component of Daest.Terms:
  `m*der(v) + v_term.total = F - d*v`; so does an equation `F = c*(s1 - s2)` of a force between bodies. In
  the class of a component it has a connector of that class, too, which the model can reach.
- A sum of voltages such as `u = R*i + Ke*w` takes up that over what is put in series: `u = R*i + Ke*w +
  i_term.total`; where `i = (u - Ke*w)/R` is written, `u` becomes `(u - i_term.total)`.
- The equations use an input through a variable of its own, whose binding an extension replaces.
- An equation `y = …` of an output becomes its binding; an output that the equations use otherwise, as
  `der(y) = …`, is bound to a variable of its own that takes its place in them.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

from daest.errors import Place
from daest.model.effects import Domain
from daest.model.flat import FlatModel
from daest.model.parts import Equation, Variable
from daest.modelica.effects.attach import free_name
from daest.modelica.effects.unrolled import without_loop
from daest.modelica.flat.connectors import connectors_of, outside_of_term
from daest.modelica.flat.factors import Entry, factor_text
from daest.modelica.language.components import expression_end
from daest.modelica.language.outline import (
    CLOSE,
    OPEN,
    ClassHead,
    Edit,
    Token,
    arguments,
    class_heads,
    class_tokens,
    closing,
    depths,
    edited,
    offset_of,
)
from daest.modelica.places.balances import (
    Balance,
    converted_text,
    needs_position,
    potential_change,
    temperatures,
)
from daest.modelica.places.internal_forces import InternalForce
from daest.modelica.places.joints import PORTS
from daest.modelica.places.meshes import Mesh
from daest.modelica.places.place_units import balance_entry
from daest.modelica.places.sites import BEHIND_OUTPUT

_TERMS: dict[Domain, tuple[str, str, str]] = {
    "translational": ("Force", "s", "flange"),
    "rotational": ("Torque", "phi", "flange"),
    "thermal": ("HeatFlow", "T", "port"),
    "hydraulic": ("VolumeFlow", "p", "port"),
    "electrical": ("Current", "v", "pin"),
    "amount": ("Inflow", "amount", "port"),
}  # class in Daest.Terms, the potential that it is given, its connector
_OF_SPEED: dict[Domain, tuple[str, str]] = {
    "translational": ("ForceOfSpeed", "v"),
    "rotational": ("TorqueOfSpeed", "w"),
}
_IN_SERIES: dict[Domain, tuple[str, str]] = {  # the class, and the flow along the path that it is given
    "electrical": ("Voltage", "i"),
    "hydraulic": ("PressureDrop", "q"),
}
_NAME = re.compile(r"(?<![\w.])[A-Za-z_][\w.\[\]]*")  # in the text of an equation
_TOTAL = "total"  # the variable of a term that stands in the equation
_NOTHING = re.compile(r" \+ 0(?![\w.])")  # of the terms of other elements of an equation of vectors
_SECTIONS = ("equation", "algorithm", "then", "else", "loop")
_BLOCKS = ("if", "for", "when", "while")


class NotOpened(Exception):
    """The text is of a form that cannot be opened; the message says why, as the end of "it …"."""


# Balances ---------------------------------------------------------------------------------------------------


def term_connector(flat: FlatModel, rows: Iterable[int], domain: Domain) -> str | None:
    """The connector of the component of Daest.Terms that stands in these equations already, and in no other
    one of the model itself; of equations of a component that of its own beside it."""
    wanted = set(rows)
    owner = flat.equations[min(wanted)].origin
    named = {i: _NAME.findall(e.text) for i, e in enumerate(flat.equations) if e.origin == owner}
    for end, connector in connectors_of(flat.unknowns).items():
        total = f"{end.rpartition('.')[0]}.{_TOTAL}"
        holding = {i for i, names in named.items() if total in names}
        if connector.domain == domain and holding == wanted:
            return outside_of_term(end) if owner else end
    return None


def opened_balance(
    source: bytes, flat: FlatModel, balance: Balance, domain: Domain, taken: Iterable[str]
) -> tuple[bytes, str]:
    """The text with a component of Daest.Terms in the equation of `balance`, and the connector of that
    component. Raises NotOpened."""
    owner = flat.equations[balance.row].origin
    within = f"{owner}." if owner else ""
    known = [x.name.removeprefix(within) for x in flat.unknowns] if owner else taken
    name = free_name(f"{_plain(balance.potential(flat).name.removeprefix(within))}_term", known)
    entries, end = (balance_entry(flat, balance, domain),), _end(name, domain)
    term = _term(flat, balance, domain, name)
    if not owner:
        return _with_terms(source, flat, entries, term), end
    outside = outside_of_term(end)
    term = replace(term, owner=owner, port=f'{PORTS[domain]} {outside} "Connects to {name}";')
    return _with_terms(source, flat, entries, term, f"connect({end}, {outside});"), f"{owner}.{outside}"


def with_loop_written_out(source: bytes, flat: FlatModel, number: int) -> bytes:
    """The text in which the equation of that number stands for itself: a loop around it is written out.
    Raises NotOpened."""
    equation = flat.equations[number]
    n_alike = sum(one.place == equation.place for one in flat.equations)
    if n_alike == 1:
        return source
    start = _offset(source, flat, equation.place)
    _, words = class_at(source, start)
    at = next(i for i, w in enumerate(words) if w.start == start)
    text = without_loop(source, words, at, n_alike)
    return source if text is None else text


def opened_force(
    source: bytes, flat: FlatModel, force: InternalForce, taken: Iterable[str]
) -> tuple[bytes, str]:
    """The text with a component of Daest.Terms beside the force between bodies, and the connector of that
    component. Raises NotOpened."""
    motion = force.motion_text(flat)
    if motion is None:
        raise NotOpened("acts on a body with a factor that is neither a number nor a parameter")
    held = force.bodies[0][0].variable if force.variable is None else force.variable
    name = free_name(f"{_plain(flat.unknowns[held].name)}_term", taken)
    kind, potential, _ = _TERMS[force.domain]
    if not force.has_positions:
        kind, potential = _OF_SPEED[force.domain]
    about = f"Beside {flat.equations[force.entries[0].row].text}"
    term = _Term(name, f"{kind} {name}({potential} = {motion})", about)
    return _with_terms(source, flat, force.entries, term), _end(name, force.domain)


def opened_mesh(source: bytes, flat: FlatModel, mesh: Mesh, taken: Iterable[str]) -> tuple[bytes, str]:
    """The text with a component of Daest.Terms in series in a mesh, and the name of that component, which is
    a wire unless it is told to be used. Raises NotOpened."""
    name = free_name(f"{_plain(mesh.term_name(flat))}_term", taken)
    current = mesh.current_text(flat, f"{name}.{_TOTAL}")
    if current is None:
        raise NotOpened("holds a current that cannot be written")
    about = f"In series in {flat.equations[mesh.row].text}"
    kind, flow = _IN_SERIES[mesh.domain]
    term = _Term(name, f"{kind} {name}({flow} = {current})", about)
    if mesh.source is None:
        return _with_terms(source, flat, (Entry(mesh.row, mesh.sign, mesh.factor),), term), name
    voltage, _ = mesh.source
    row = _row_at(source, flat, mesh.row)
    uses = _uses([*row.left, *row.right], voltage, -1)
    if not uses:
        raise NotOpened(f"does not name `{voltage}`, from which the voltage would be taken")
    edits = [Edit(w.start, w.end, mesh.lowered(voltage, f"{name}.{_TOTAL}")) for w in uses]
    return edited(source, [*edits, declared_first(source, row.words, *term.lines)]), name


@dataclass(frozen=True)
class _Term:
    """A component of Daest.Terms: its name, its class with name and modification, and what it is for. In the
    class of the component `owner`, if there is one, with the declaration of a `port` of that."""

    name: str
    declared: str
    about: str
    owner: str = ""
    port: str = ""

    @property
    def lines(self) -> tuple[str, ...]:
        about = self.about.replace("\\", "\\\\").replace('"', '\\"')
        line = self.own(f'Daest.Terms.{self.declared} "{about}";')
        return (line, self.port) if self.port else (line,)

    def own(self, text: str) -> str:
        """The text with the names by which the class of the owner calls its variables."""
        return re.sub(rf"(?<![\w.]){re.escape(self.owner)}\.", "", text) if self.owner else text

    def is_within(self, text: str) -> bool:
        """Whether the class of the owner has all that a text names."""
        return not self.owner or all(name.startswith(f"{self.owner}.") for name in _NAME.findall(text))


def _end(name: str, domain: Domain) -> str:
    return f"{name}.{_TERMS[domain][2]}"


def _with_terms(
    source: bytes, flat: FlatModel, entries: Sequence[Entry], term: _Term, connection: str = ""
) -> bytes:
    """The text with the sum of the term in every row of the `entries`, on the left where the sign is
    positive, and with a `connection` before the first of them."""
    rows = [(_row_at(source, flat, entry.row), entry) for entry in entries]
    if len({row.head for row, _ in rows}) > 1:
        raise NotOpened("stands in equations of several classes")
    edits: list[Edit] = []
    for row, entry in rows:
        added = entry.term(f"{term.name}.{_TOTAL}", flat)
        if added is None:
            raise NotOpened("is divided by what cannot be written")
        if not term.is_within(factor_text(entry.factor, flat) or ""):
            raise NotOpened("is divided by what the class of its component does not name")
        added = term.own(added)
        # A binding has nothing on its left that a term could be added to.
        is_left = entry.sign > 0 and bool(row.left)
        mark = "-" if entry.sign > 0 and not is_left else "+"
        elements = ["0"] * row.n_elements
        elements[row.element] = added
        shown = f"{{{', '.join(elements)}}}" if row.n_elements > 1 else added
        edits += _with_term(row.left if is_left else row.right, f"{mark} {shown}")
    if connection:
        edits.append(_before(source, rows[0][0], connection))
    return edited(source, [*edits, declared_first(source, rows[0][0].words, *term.lines)])


def _before(source: bytes, row: _Row, statement: str) -> Edit:
    """A statement before the equation of a row."""
    if not row.left:
        raise NotOpened("is a binding, beside which no connection stands")
    start = row.left[0].start
    before = source[source.rfind(b"\n", 0, start) + 1 : start].decode()
    behind = " " if before.strip() else f"\n{before}"
    return Edit(start, start, f"{statement}{behind}")


@dataclass(frozen=True)
class _Row:
    """The tokens of an equation left and right of its equality sign, those of a binding all on the right,
    in the class of `head` with its `words`: the one of that `element` of an equation of vectors."""

    head: ClassHead
    words: list[Token]
    left: list[Token]
    right: list[Token]
    element: int = 0
    n_elements: int = 1


def _row_at(source: bytes, flat: FlatModel, number: int) -> _Row:
    """The equation of that number in the text. Raises NotOpened."""
    equation = flat.equations[number]
    start = _offset(source, flat, equation.place)
    places = [(e.place, e.origin) for e in flat.equations]
    alike = [i for i, one in enumerate(places) if one == places[number]]
    head, words = class_at(source, start)
    if len(alike) > 1 and not _is_of_vectors(flat, words, start, number):
        raise NotOpened("stands for several equations (a loop, or an array of more than one index)")
    if equation.kind != "binding":
        return _Row(head, words, *_sides(words, start), alike.index(number), len(alike))
    name = equation.text.partition(" = ")[0]
    at = next((i for i, w in enumerate(words) if w.start >= start and w.text == name), None)
    bound = [] if at is None else _binding_behind(words, at)
    if not bound:
        raise NotOpened("is a declaration whose binding cannot be found in the text")
    return _Row(head, words, [], bound)


def _is_of_vectors(flat: FlatModel, words: Sequence[Token], start: int, number: int) -> bool:
    """Whether the equation, one of several at byte `start`, is an element of one of vectors: not of a loop,
    and the rates in it have one index each."""
    at = next((i for i, w in enumerate(words) if w.start == start), 0)
    rates = re.findall(r"der\(([^()]+)\)", flat.equations[number].text)
    is_equation = flat.equations[number].kind != "binding" and words[at - 1].text not in _BLOCKS
    return is_equation and bool(rates) and all(re.fullmatch(r"[\w.]+\[\d+\]", rate) for rate in rates)


def _term(flat: FlatModel, balance: Balance, domain: Domain, name: str) -> _Term:
    variable, text = balance.potential(flat), flat.equations[balance.row].text
    kind, potential, _ = _TERMS[domain]
    shown = variable.name
    if needs_position(domain) and balance.position >= 0:
        shown = flat.unknowns[balance.position].name
    elif needs_position(domain):
        kind, potential = _OF_SPEED[domain]
    shown = converted_text(shown, potential_change(flat, balance, temperatures(flat)))
    plain = _NOTHING.sub("", text)
    return _Term(name, f"{kind} {name}({potential} = {shown})", f"Term of {plain}")


def _sides(words: Sequence[Token], start: int) -> tuple[list[Token], list[Token]]:
    """The tokens left and right of the equality sign of the equation that begins at byte `start`."""
    at = next((i for i, w in enumerate(words) if w.start == start), None)
    while at and words[at - 1].text not in (";", *_SECTIONS):
        at -= 1  # the place of `(a + b)*c = d` is told without its first bracket
    if at is None or not _stands_alone(words, at):
        raise NotOpened("stands inside of if, for or when")
    statement = _statement(words, at)
    depth = dict(depths(statement))
    middle = [i for i, w in enumerate(statement) if w.text == "=" and depth[i] == 0]
    if len(middle) != 1:
        raise NotOpened("has no left and right side")
    end = next(
        (
            i
            for i, w in enumerate(statement)
            if depth[i] == 0 and i > middle[0] and (w.kind == "text" or w.text == "annotation")
        ),
        len(statement),
    )
    return list(statement[: middle[0]]), list(statement[middle[0] + 1 : end])


def _with_term(side: Sequence[Token], term: str) -> list[Edit]:
    """The side with a term behind it, `+ x`; one that is an if-expression goes into brackets."""
    depth = dict(depths(side))
    is_open = any(w.text == "if" and depth[i] == 0 for i, w in enumerate(side))
    first, last = side[0].start, side[-1].end
    if not is_open:
        return [Edit(last, last, f" {term}")]
    return [Edit(first, first, "("), Edit(last, last, f") {term}")]


# Inputs and outputs -----------------------------------------------------------------------------------------


def opened_input(source: bytes, flat: FlatModel, name: str, taken: Iterable[str]) -> tuple[bytes, str]:
    """The text whose equations use the input through a variable of its own, and the name of that variable.
    Connect clauses stay. Raises NotOpened."""
    return _used_through(source, flat, next(v for v in flat.inputs if v.name == name), taken)


def opened_signal(
    source: bytes, flat: FlatModel, name: str, given: Equation, taken: Iterable[str]
) -> tuple[bytes, str]:
    """The text in which all equations but the one that gives a variable of the model or its rate, or its
    declaration, use it through another one, and the name of that one. Raises NotOpened."""
    symbol = next(v for v in flat.unknowns if v.name == name)
    if given.kind == "binding":
        return _used_through(source, flat, symbol, taken)
    begin = _offset(source, flat, given.place)
    _, words = class_at(source, begin)
    at = next(i for i, w in enumerate(words) if w.start == begin)
    if not _stands_alone(words, at):
        raise NotOpened("does not stand for itself")
    return _used_through(source, flat, symbol, taken, [w.start for w in _statement(words, at)])


def _used_through(
    source: bytes, flat: FlatModel, symbol: Variable, taken: Iterable[str], given: Collection[int] = ()
) -> tuple[bytes, str]:
    """The text whose equations use `symbol` through a variable of its own, and the name of that variable; the
    equation whose words begin at the bytes `given` stays."""
    name, start = symbol.name, _offset(source, flat, symbol.place)
    head, words = class_at(source, start)
    used = free_name(f"{name}_used", taken)
    line = used_declaration(used, name, symbol.unit)
    uses = [w for w in all_uses(source, head, words, name, start) if w.start not in given]
    edits = [Edit(w.start, w.end, used) for w in uses]
    if not edits:
        raise NotOpened("is used by no equation of the class that declares it")
    return edited(source, [*edits, declared_first(source, words, line)]), used


def used_declaration(used: str, name: str, unit: str, sizes: str = "") -> str:
    """The declaration of the variable `used` through which equations use what is called `name`; `[n]` are the
    `sizes` of an array."""
    each = "each " if sizes else ""
    modifier = f'({each}unit = "{unit}")' if unit else ""
    return f'Real {used}{sizes}{modifier} = {name} "{name} as the equations use it";'


def _uses(words: Sequence[Token], name: str, declared: int) -> list[Token]:
    """Tokens that use the variable: not its declaration, a part of another name, the name of an argument or
    of what a modification `(T(start = 290))` or `(final T = 290)` is of, a connection or an annotation."""
    found: list[Token] = []
    path = re.findall(r"\.|[^.]+", name)
    skipped = 0  # brackets of an annotation or a connection that are open
    for i, word in enumerate(words):
        before, after = words[i - 1].text if i else "", words[i + 1].text if i + 1 < len(words) else ""
        if skipped or (word.text == "(" and before in ("annotation", "connect")):
            skipped += (word.text in OPEN) - (word.text in CLOSE)
            continue
        is_argument = after == "(" or (after == "=" and before in ("(", ",", "each", "final"))
        if word.text != path[0] or before == "." or word.start == declared or is_argument:
            continue
        run = words[i : i + len(path)]
        if [one.text for one in run] == path:
            found.append(replace(word, text=name, end=run[-1].end))
    return found


def _extends(source: bytes, derived: ClassHead, base: ClassHead) -> bool:
    words = class_tokens(source, derived)
    last = base.name.rpartition(".")[2]
    names = [[n.text for n in words[i : i + 8]] for i, w in enumerate(words) if w.text == "extends"]
    return any(last in around for around in names)


def is_used_elsewhere(source: bytes, flat: FlatModel, name: str) -> bool:
    """Whether equations of the class that declares the output use it, be it that which gives it. Raises
    NotOpened."""
    head, words, at = _output(source, flat, name)
    return bool(all_uses(source, head, words, words[at].text, words[at].start))


def opened_output(source: bytes, flat: FlatModel, name: str, taken: Iterable[str]) -> bytes:
    """The text in which the output has a binding and no equation uses it: its equation `name = …`, or else a
    variable that takes its place in all equations. Raises NotOpened."""
    head, words, at = _output(source, flat, name)
    uses = all_uses(source, head, words, words[at].text, words[at].start)
    starts = [i for i, w in enumerate(words) if w.text == name and i != at and _begins(words, i)]
    is_equation = len(starts) == 1 and words[starts[0] + 1].text == "=" and _stands_alone(words, starts[0])
    if not is_equation or len(uses) > 1:
        inner = free_name(f"{name}{BEHIND_OUTPUT}", taken)
        return edited(source, _with_variable_behind(source, words, at, inner, uses))
    _, right = _sides(words, words[starts[0]].start)
    statement = _statement(words, starts[0])
    behind = next((w for w in words if w.start >= statement[-1].end), statement[-1])
    text = source[right[0].start : right[-1].end].decode()
    place = _behind_declarator(words, at)
    begin = source.rfind(b"\n", 0, statement[0].start) + 1
    first = begin if not source[begin : statement[0].start].strip() else statement[0].start
    end = behind.end + (source[behind.end : behind.end + 1] == b"\n" and first == begin)
    return edited(source, [Edit(place, place, f" = {text}"), Edit(first, end, "")])


def _output(source: bytes, flat: FlatModel, name: str) -> tuple[ClassHead, list[Token], int]:
    """The class that declares the output, its tokens and the index of its name among them."""
    output = next(y for y in flat.outputs if y.name == name)
    start = _offset(source, flat, output.place)
    head, words = class_at(source, start)
    return head, words, next(i for i, w in enumerate(words) if w.start == start)


def all_uses(source: bytes, head: ClassHead, words: Sequence[Token], name: str, declared: int) -> list[Token]:
    """Tokens that use the variable `name`, declared at a byte, in the class of `head`, whose tokens are
    `words`, and in the classes of the file that extend it; of a field of a record those of the dotted name in
    one."""
    heads = class_heads(source)
    derived: list[ClassHead] = [head]
    for one in derived:  # grows on the way
        derived += [h for h in heads if h not in derived and _extends(source, h, one)]
    others = [_uses(class_tokens(source, other), name, -1) for other in derived[1:]]
    return [*_uses(words, name, declared), *(token for uses in others for token in uses)]


def _with_variable_behind(
    source: bytes, words: Sequence[Token], at: int, inner: str, uses: Sequence[Token]
) -> list[Edit]:
    """Edits that declare the variable `inner` with the attributes of the output at `at`, put it in the place
    of its `uses` and bind the output to it. Raises NotOpened."""
    name, end = words[at], _behind_declarator(words, at)
    behind = next(i for i, w in enumerate(words) if w.start >= end)
    bound = _binding_behind(words, at)
    after = words[behind + len(bound) + bool(bound)].text
    if after == "," or words[at - 1].text in (",", "]") or words[at + 1].text == "[":
        raise NotOpened(f"is not given by one equation `{name.text} = …`, nor declared in a line of its own")
    attributes = arguments(words, at + 1) if words[at + 1].text == "(" else []
    of_start = [i for i, one in enumerate(attributes) if one[0].text in ("start", "fixed", "stateSelect")]
    told = [source[one[0].start : one[-1].end].decode() for one in attributes]
    kept = [text for i, text in enumerate(told) if i not in of_start]
    modifier = f"({', '.join(told)})" if told else ""
    left = f"({', '.join(kept)})" if kept else ""
    given = f" = {source[bound[0].start : bound[-1].end].decode()}" if bound else ""
    kind = _type_of_output(source, words, at)
    line = f'{kind} {inner}{modifier}{given} "{name.text} as the equations have it";'
    last = bound[-1].end if bound else end
    edits = [Edit(w.start, w.end, inner) for w in uses]
    return [*edits, Edit(name.end, last, f"{left} = {inner}"), declared_first(source, words, line)]


def output_binding(source: bytes, flat: FlatModel, name: str) -> str:
    """The text of `expr` in `output Real y(…) = expr "…";`; empty where the output has none. Raises
    NotOpened."""
    _, words, at = _output(source, flat, name)
    bound = _binding_behind(words, at)
    return source[bound[0].start : bound[-1].end].decode() if bound else ""


def _binding_behind(words: Sequence[Token], at: int) -> list[Token]:
    """The expression that a declaration binds the identifier at `at` to; empty where there is none."""
    end = _behind_declarator(words, at)
    rest = [w for w in words if w.start >= end]
    return rest[1 : expression_end(rest, 1)] if rest and rest[0].text == "=" else []


def _type_of_output(source: bytes, words: Sequence[Token], at: int) -> str:
    """The type behind the prefix `output` of a declaration; Real for that of a connector."""
    begin = max((i for i, w in enumerate(words[:at]) if w.text in (";", *_SECTIONS)), default=0)
    prefix = next((i for i in range(begin, at) if words[i].text == "output"), None)
    return "Real" if prefix is None else source[words[prefix + 1].start : words[at - 1].end].decode()


def _behind_declarator(words: Sequence[Token], at: int) -> int:
    """The byte behind an identifier and its modification."""
    end = at + 1
    while end < len(words) and words[end].text in OPEN:
        end = closing(words, end)
    return words[end - 1].end


# Text -------------------------------------------------------------------------------------------------------


def _offset(source: bytes, flat: FlatModel, place: Place | None) -> int:
    if place is None or place.line is None or place.file != flat.source:
        raise NotOpened("stands in another file")
    return offset_of(source, place)


def class_at(source: bytes, start: int) -> tuple[ClassHead, list[Token]]:
    """The class that holds the token at byte `start`, and its tokens."""
    for head in reversed(class_heads(source)):
        if head.start < start:
            words = class_tokens(source, head)
            if any(w.start == start for w in words):
                return head, words
    raise NotOpened("cannot be found in the text")


def declared_first(source: bytes, words: Sequence[Token], *lines: str) -> Edit:
    """Declarations as the first of the class, behind its name and description."""
    at = 0
    while at + 1 < len(words) and (words[at + 1].kind == "text" or words[at + 1].text == "+"):
        at += 1
    behind = words[at + 1].start if at + 1 < len(words) else words[at].end
    before = source[source.rfind(b"\n", 0, behind) + 1 : behind].decode()
    indent = "  " if before.strip() else before
    return Edit(words[at].end, words[at].end, "".join(f"\n{indent}{line}" for line in lines))


def _begins(words: Sequence[Token], at: int) -> bool:
    """Whether a statement begins there."""
    return at > 0 and (words[at - 1].text == ";" or words[at - 1].text in _SECTIONS)


def _stands_alone(words: Sequence[Token], at: int) -> bool:
    """Whether the statement is an equation of the class itself, not of a loop or a branch."""
    depth = 0
    section = ""
    for i, word in enumerate(words[: at + 1]):
        if word.text in ("equation", "algorithm"):
            section = word.text if i == 0 or words[i - 1].text != "initial" else "initial"
        if word.text in _BLOCKS and words[i - 1].text == "end":
            depth -= 1
        elif word.text in _BLOCKS and _begins(words, i):
            depth += 1
    return section == "equation" and depth == 0 and words[at].text not in (*_BLOCKS, "connect")


def _statement(words: Sequence[Token], at: int) -> list[Token]:
    end = next((i for i in range(at, len(words)) if words[i].text == ";"), len(words))
    return list(words[at:end])


def _plain(name: str) -> str:
    return "".join(c if c.isalnum() else "_" for c in name).strip("_")
