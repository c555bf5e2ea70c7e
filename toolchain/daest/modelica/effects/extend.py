"""The extended model as Modelica text: `extends`, a component of the effect, and its connections."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import casadi as ca
import numpy as np

from daest.errors import ModelError
from daest.model.effects import Domain, Effect, EffectParameter, Placement, Site
from daest.model.flat import FlatModel
from daest.modelica.compile import compile_text
from daest.modelica.compiling.compiler import modification
from daest.modelica.effects.attach import (
    attach,
    component_name,
    free_name,
    given_source,
    names_of,
    one_by_one,
    supplied,
)
from daest.modelica.effects.catalogue import effect_model
from daest.modelica.effects.opened import (
    NotOpened,
    is_used_elsewhere,
    opened_balance,
    opened_force,
    opened_input,
    opened_mesh,
    opened_output,
    opened_signal,
    output_binding,
    term_connector,
    with_loop_written_out,
)
from daest.modelica.effects.opened_parameters import (
    aliases,
    is_used_otherwise,
    opened_parameter,
    owner_of,
    without_subscripts,
)
from daest.modelica.effects.own_copies import with_own_class
from daest.modelica.effects.unrolled import with_connects_written_out
from daest.modelica.flat.connectors import connectors_of
from daest.modelica.language.outline import (
    ClassHead,
    ConnectClause,
    class_heads,
    class_tokens,
    connect_clauses,
    extends_clauses,
    find_base,
    tokens,
    within,
)
from daest.modelica.language.source import read_source, select_class
from daest.modelica.language.text import number_text, times_text
from daest.modelica.places.balances import balances, converted_text
from daest.modelica.places.internal_forces import internal_forces
from daest.modelica.places.joints import joint, needs_joint
from daest.modelica.places.meshes import meshes
from daest.modelica.places.place_units import units_at
from daest.modelica.places.sites import sites
from daest.modelica.places.terminals import terminals

__all__ = ["CurveText", "Extension", "extend_by_curve", "extend_model"]

_MARGIN = 110
_SUBSCRIPTS = re.compile(r"\[([\d,]+)\]")
_LOADS = {
    "rotational": ("Daest.Effects.Rotational.LearnedTorque", "flange"),
    "translational": ("Daest.Effects.Translational.LearnedForce", "flange"),
    "electrical": ("Daest.Effects.Electrical.LearnedCurrent", "pin"),
    "thermal": ("Daest.Effects.Thermal.LearnedHeatFlow", "port"),
    "hydraulic": ("Daest.Effects.Hydraulic.LearnedFlow", "port"),
    "amount": ("Daest.Effects.Amounts.LearnedInflow", "port"),
}  # class of a learned load, and its connector
_LEARNED = "learned"
_CONNECTION = re.compile(r"connect\((.+), (.+)\);")
_INPUT = "Daest.Blocks.Interfaces.RealInput"


@dataclass(frozen=True)
class Extension:
    """What `extend_model` makes: the text of a file that holds the original classes and, last, the extended
    one.

    `flat` is that text compiled, `added` the text of the new class alone, `component` the effect's name in
    it, `effect` that of its class.
    """

    text: str
    class_name: str
    added: str
    component: str
    flat: FlatModel
    effect: str


@dataclass(frozen=True)
class CurveText:
    """A load at the node of connector `place`: straight lines through (x_knots, y) over the variable `x` of
    the model, times tanh(s/s_s) if the variable `s` is named; repeated if `period` is not 0."""

    place: str
    x: str
    x_knots: Sequence[float]
    y: Sequence[float]
    s: str = ""
    s_s: float = 0.0
    period: float = 0.0


@dataclass
class _Draft:
    """Parts of the new class."""

    values: dict[str, str] = field(default_factory=dict)  # in the modification of the extends clause, by name
    changes: list[str] = field(default_factory=list)  # what else stands there
    declarations: list[str] = field(default_factory=list)
    equations: list[str] = field(default_factory=list)

    @property
    def modifications(self) -> list[str]:
        return [modification(self.values), *self.changes] if self.values else self.changes

    def connect(self, left: str, right: str) -> None:
        self.equations.append(f"connect({left}, {right});")

    @property
    def connections(self) -> dict[int, tuple[str, str]]:
        """The ends of the connections by their numbers among the equations."""
        found = ((i, _CONNECTION.fullmatch(text)) for i, text in enumerate(self.equations))
        return {i: (match[1], match[2]) for i, match in found if match}

    def replace(self, clause: ConnectClause) -> None:
        self.changes.append(f"break connect({clause.left}, {clause.right})")


@dataclass(frozen=True)
class _Original:
    """The model that is extended: its source, and what it compiles to."""

    path: Path
    source: bytes
    head: ClassHead
    flat: FlatModel
    libraries: Sequence[str | Path] = ()

    def changed(self, source: bytes) -> _Original:
        """With another text, of which a copy will be written."""
        flat = compile_text(source, self.path, self.head.name, self.libraries)
        head = next(h for h in class_heads(source) if h.name == self.head.name)
        return replace(self, source=source, head=head, flat=flat)

    def clauses(self) -> list[ConnectClause]:
        """Connect clauses of the class and of the classes of the file that it extends."""
        return self._clauses(self.head)

    def _clauses(self, head: ClassHead) -> list[ConnectClause]:
        words, heads = class_tokens(self.source, head), class_heads(self.source)
        found = connect_clauses(words)
        gone = {pair for clause in extends_clauses(words) for pair in clause.broken}
        for clause in extends_clauses(words):
            base = find_base(heads, head.name, clause.base)
            if base is not None:
                found += [one for one in self._clauses(base) if one.pair not in gone]
        return found

    def refusal(self, what: str, remedy: str, code: str = "effect-not-writable") -> ModelError:
        return ModelError(code, what, where=str(self.path), remedy=remedy)


def extend_model(
    path: str | Path,
    class_name: str | None,
    effect: Effect,
    site: Site,
    name: str | None = None,
    values: Mapping[str, float] | None = None,
    new_name: str | None = None,
    *,
    inputs: Mapping[str, str] | None = None,
    input_units: Mapping[str, str] | None = None,
    parameters: Mapping[str, float] | None = None,
    held: Collection[str] = (),
    libraries: Sequence[str | Path] = (),
    target: str | Path | None = None,
) -> Extension:
    """The model with `effect` at `site`, as Modelica that extends it and compiles.

    `name`, `values` and `inputs` are as in `attach`, `input_units` as in `Placement`; `parameters` are new
    values of the model's own parameters; those of the effect that are `held` are final, and so not estimated;
    `new_name` is the name of the new class (default: MODEL_EFFECT, numbered if taken); `target` is the file
    that the text is meant for. The equations are those of `attach`. Raises ModelError as `attach` does, and
    `effect-input-used` or `effect-not-writable` where Modelica cannot express it.

        >>> daest.extend_model("Servo.mo", None, effect, site).class_name
        'Servo_CoulombFriction'
    """
    original = _original(Path(path), class_name, libraries)
    flat = original.flat
    attach(flat, effect, site, name, values, inputs)  # for its checks
    component = name or component_name(effect, names_of(flat))
    placement = Placement(effect, site, component, values or {}, inputs or {}, input_units or {})
    draft = _Draft(*_changes(parameters or {}, original))
    units = units_at(flat, effect, site, inputs=placement.inputs)
    supplied_inputs = {x.name: x.unit for x in flat.inputs}
    for one in one_by_one(placement, names_of(flat)):
        shared = component if one.name != component else ""
        draft.declarations.append(_declaration(one, units, held, shared))
        if not effect.is_of_variable:
            supplied_inputs = _supply(draft, one, supplied_inputs)
        original = _connect(draft, one, original)
    own_name = _class_name(original, effect.name, new_name)
    place = f"in {site.aliases[0]}" if site.kind == "equation" else f"at {site.name}"
    about = f"{effect.name} {_quoted(place)}"
    return _extension(original, draft, own_name, about, component, effect.name, libraries, target)


def extend_by_curve(
    path: str | Path,
    class_name: str | None,
    load: CurveText,
    *,
    parameters: Mapping[str, float] | None = None,
    libraries: Sequence[str | Path] = (),
    target: str | Path | None = None,
) -> Extension:
    """The model with the load of a curve at a node, as Modelica that extends it and compiles.

    `parameters`, `libraries` and `target` are as in `extend_model`. Raises ModelError `effect-not-writable`
    where the node cannot be reached from outside, and what compiling raises.
    """
    original = _original(Path(path), class_name, libraries)
    nodes = [s for s in sites(original.flat) if s.kind in ("node", "equation")]
    node = next((s for s in nodes if load.place in (s.name, *s.connectors, *s.aliases)), None)
    if node is None or node.domain not in _LOADS:
        raise original.refusal(
            f"a load at `{load.place}` cannot be written: it is no connector and no balance of the model",
            "Choose a place of those that `daest effects --model` lists.",
        )
    ends: tuple[str, ...] = (load.place, *node.connectors)
    if node.kind == "equation":
        original, end = _opened_balance(original, node.name, node.domain)
        ends = (end,)
    component = free_name(_LEARNED, names_of(original.flat))
    draft = _Draft(*_changes(parameters or {}, original))
    load_class, connector = _LOADS[node.domain]
    draft.declarations.append(_curve_declaration(load_class, component, load))
    draft.connect(f"{component}.{connector}", _reachable(original, ends))
    own_name = _class_name(original, _LEARNED.capitalize(), None)
    about = f"a load at {load.place} over {load.x}"
    kind = load_class.rpartition(".")[2]
    return _extension(original, draft, own_name, about, component, kind, libraries, target)


def _original(path: Path, class_name: str | None, libraries: Sequence[str | Path]) -> _Original:
    source = read_source(path)
    chosen = select_class(source, path, class_name)
    head = next(h for h in class_heads(source) if h.name == chosen)
    return _Original(path, source, head, compile_text(source, path, chosen, libraries), libraries)


def _changes(parameters: Mapping[str, float], original: _Original) -> tuple[dict[str, str], list[str]]:
    """New values of the model's parameters, as they stand in the modification of the extends clause: by their
    names, and with the bound that one had to pass."""
    flat = original.flat
    known = {p.name: p for p in flat.parameters if "." not in p.name}
    passed: dict[str, str] = {}
    for name, value in parameters.items():
        low, high = (known[name].min, known[name].max) if name in known else (None, None)
        if low is not None and value < low:
            passed[name] = "min"
        elif high is not None and value > high:
            passed[name] = "max"
    texts = {name: number_text(float(value)) for name, value in parameters.items()}
    bounds = {n: f"{n}({bound} = {texts[n]})" for n, bound in passed.items() if "[" not in n}
    bounds |= {
        without_subscripts(n): f"{without_subscripts(n)}(each {b} = {texts[n]})"
        for n, b in passed.items()
        if "[" in n
    }
    values = {name: text for name, text in texts.items() if "[" not in name}
    arrays = dict.fromkeys(without_subscripts(name) for name in texts if "[" in name)
    values |= {name: _array_text(name, parameters, original) for name in arrays}
    inside = {name: text for name, text in values.items() if name not in bounds}
    return inside, [f"{bound} = {values[n]}" for n, bound in bounds.items()]


def _array_text(array: str, parameters: Mapping[str, float], original: _Original) -> str:
    """The values of an array of parameters, new ones and those of the model, `{1.0, 2.5}`."""
    known = {p.name: p.value for p in original.flat.parameters}
    found = _elements(known, array)
    text = _in_braces({at: number_text(float(parameters.get(n, known[n]))) for at, n in found.items()})
    if text is None:
        raise original.refusal(
            f"the values of `{array}` cannot be written: some of its elements are computed",
            "Give its elements names of their own, or set them in the model.",
        )
    return text


def _elements(names: Iterable[str], array: str) -> dict[tuple[int, ...], str]:
    """Those of the names that are elements of an array, by their indices; a scalar has none."""
    return {
        tuple(int(i) for part in _SUBSCRIPTS.findall(name) for i in part.split(",")): name
        for name in names
        if without_subscripts(name) == array
    }


def _in_braces(texts: Mapping[tuple[int, ...], str]) -> str | None:
    """The texts of the elements of an array as one; None where some are missing."""
    size = tuple(max(column) for column in zip(*texts, strict=True))
    return _nested([texts[at] for at in sorted(texts)], size) if len(texts) == np.prod(size) else None


def _nested(texts: Sequence[str], size: Sequence[int]) -> str:
    """The texts, the last index first, in braces as often as there are indices."""
    if not size:
        return texts[0]
    step = len(texts) // size[0]
    rows = (_nested(texts[i : i + step], size[1:]) for i in range(0, len(texts), step))
    return f"{{{', '.join(rows)}}}"


def _extension(
    original: _Original,
    draft: _Draft,
    name: str,
    about: str,
    component: str,
    effect: str,
    libraries: Sequence[str | Path],
    target: str | Path | None,
) -> Extension:
    """The text of class `name`, compiled."""
    source = original.source
    _join(draft, original, component)
    added = _class_text(name, original, about, draft)
    text = added if within(source) else source.decode().replace("\r\n", "\n").rstrip() + "\n\n" + added
    # A file of the original's name would take its place among the files of the library.
    beside = original.path.with_name(f"{name}.mo") if within(source) else original.path
    file = Path(target or beside)
    compiled = compile_text(text.encode(), file, name, _roots(original, libraries))
    return Extension(text, name, added, component, compiled, effect)


def _join(draft: _Draft, original: _Original, component: str) -> None:
    """Joints in the connections to connectors that call their variables otherwise than the library."""
    known = connectors_of(original.flat.unknowns)
    odd = {name: one for name, one in known.items() if needs_joint(original.flat, one)}
    classes: dict[tuple[str, ...], str] = {}
    for i, (left, right) in draft.connections.items():
        ends = [end for end in (left, right) if end in odd]
        if not ends:
            continue
        (end,), (other,) = ends, [one for one in (left, right) if one not in ends]
        made = joint(
            original.source,
            original.head.name,
            original.flat,
            odd[end],
            f"{component}_joint{i or ''}",
            classes,
        )
        if made is None:
            raise original.refusal(
                f"the class of the connector `{end}` is not in this file",
                "Put the effect into a class of the file that declares the connector.",
            )
        draft.declarations.append(made.text)
        draft.equations[i] = f"connect({other}, {made.port});"
        draft.connect(made.own, end)


def _roots(original: _Original, libraries: Sequence[str | Path]) -> tuple[str | Path, ...]:
    """A file of a package in a folder is not copied: its library is needed."""
    depth = len(within(original.source).split(".")) if within(original.source) else 0
    return (original.path.resolve().parents[depth], *libraries) if depth else tuple(libraries)


# The class --------------------------------------------------------------------------------------------------


def _class_name(original: _Original, suffix: str, wanted: str | None) -> str:
    taken = {h.name for h in class_heads(original.source)} | names_of(original.flat)
    if wanted is not None:
        if wanted in taken or not _is_identifier(wanted):
            what = "is taken" if wanted in taken else "is no name of a class"
            raise original.refusal(
                f"the name `{wanted}` {what}", "Choose another name for the extended model.", "effect-name"
            )
        return wanted
    base = f"{original.head.name.rpartition('.')[2]}_{suffix}"
    return free_name(base, taken)


def _is_identifier(name: str) -> bool:
    words = list(tokens(name.encode()))
    return len(words) == 1 and words[0].kind == "name"


def _class_text(name: str, original: _Original, about: str, draft: _Draft) -> str:
    lines = [f'model {name} "{original.head.name.rpartition(".")[2]} with {about}"']
    lines += _extends(original.head.name, draft.modifications)
    lines += [f"  {line}" for declaration in draft.declarations for line in declaration.split("\n")]
    lines += ["equation", *(f"  {equation}" for equation in draft.equations), f"end {name};", ""]
    return "\n".join(lines)


def _extends(base: str, changes: Sequence[str]) -> list[str]:
    line = f"  extends {base}({', '.join(changes)});" if changes else f"  extends {base};"
    if len(line) <= _MARGIN:
        return [line]
    return [f"  extends {base}(", *(f"    {change}," for change in changes[:-1]), f"    {changes[-1]});"]


def _declaration(
    placement: Placement, units: Mapping[str, str], held: Collection[str] = (), shared: str = ""
) -> str:
    """`Daest.Effects.Rotational.CoulombFriction coulombFriction(tau_c = 0.006) "Dry friction: …";`, or with
    the parameters of the component `shared`."""
    effect, site = placement.effect, placement.site
    changes = ["useSupport = true"] if _is_across(placement) else []
    for parameter in effect.parameters:
        source = given_source(parameter, site)
        if source and parameter.name not in placement.values:
            changes.append(f"{parameter.name} = {source}")
    changes += _shared(placement, units, shared) if shared else _assignments(placement, units, held)
    modified = f"({', '.join(changes)})" if changes else ""
    head = f"{effect.class_name} {placement.name}{modified}"
    about = f'"{_quoted(effect.description)}";'
    return f"{head} {about}" if len(head) + len(about) < _MARGIN - 3 else f"{head}\n  {about}"


def _is_across(placement: Placement) -> bool:
    return placement.effect.attach == "connector" and placement.site.kind == "component"


def _assignments(placement: Placement, units: Mapping[str, str], held: Collection[str]) -> list[str]:
    """`tau_c = 0.006`, with the unit where it is that of the signal; the elements of an array in one list,
    those without a value at their start."""
    arrays: dict[str, list[str]] = {}
    found: list[str] = []
    for parameter in placement.effect.parameters:
        array, _, index = parameter.name.partition("[")
        value = placement.values.get(parameter.name)
        unit = _unit_told(placement, parameter, units)
        if index:
            start = parameter.start if value is None else value
            arrays.setdefault(array + _with_unit(unit, "each "), []).append(number_text(float(start)))
        elif value is not None:
            final = "final " if parameter.name in held else ""
            found.append(f"{final}{parameter.name}{_with_unit(unit)} = {number_text(float(value))}")
        elif unit:
            found.append(parameter.name + _with_unit(unit))
    changed = {name.partition("[")[0] for name in placement.values if "[" in name}
    given = [name for name in arrays if name.partition("(")[0] in changed]
    return found + [f"{name} = {{{', '.join(arrays[name])}}}" for name in given]


def _shared(placement: Placement, units: Mapping[str, str], component: str) -> list[str]:
    """`tau_c = coulombFriction.tau_c` for every parameter, final: that of the other component alone is
    estimated."""
    found: dict[str, str] = {}
    for parameter in placement.effect.parameters:
        if given_source(parameter, placement.site) and parameter.name not in placement.values:
            continue
        array, _, index = parameter.name.partition("[")
        unit = _unit_told(placement, parameter, units)
        found[array] = f"final {array}{_with_unit(unit, 'each ' if index else '')} = {component}.{array}"
    return list(found.values())


def _unit_told(placement: Placement, parameter: EffectParameter, units: Mapping[str, str]) -> str:
    """The unit of a parameter where it is that of the place, and not the one of its class."""
    known = units[parameter.name]
    counts_by_place = bool(placement.site.connectors) or placement.site.domain == "amount"
    is_of_place = parameter.signal_unit or (counts_by_place and known != parameter.unit)
    return known if is_of_place else ""


def _with_unit(unit: str, each: str = "") -> str:
    return f'({each}unit = "{unit}")' if unit else ""


def _quoted(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"')


def _curve_declaration(class_name: str, component: str, load: CurveText) -> str:
    """The component with its modifiers, one to a line."""
    changes = [f"x = {load.x}"]
    if load.s:
        changes += [f"s = {load.s}", f"s_s = {number_text(load.s_s)}"]
    if load.period:
        changes.append(f"period = {number_text(load.period)}")
    changes += [_array("x_knots", load.x_knots), _array("y", load.y)]
    follows = f"{load.x} and the sign of {load.s}" if load.s else load.x
    body = ",\n  ".join(changes)
    return f'{class_name} {component}(\n  {body})\n  "Load that follows {follows}";'


def _array(name: str, values: Sequence[float]) -> str:
    """`name = {…}`, broken where the line is full."""
    text = f"{name} = {{{', '.join(number_text(float(v)) for v in values)}}}"
    return "\n    ".join(textwrap.wrap(text, _MARGIN - 8, break_long_words=False, break_on_hyphens=False))


# Connections ------------------------------------------------------------------------------------------------


def _supply(draft: _Draft, placement: Placement, inputs: Mapping[str, str]) -> dict[str, str]:
    """Inputs of the new model for the effect's signals, where none of `inputs` (units by name) has that name:
    those with the new ones."""
    known = dict(inputs)
    signals = {x.name: x for x in effect_model(placement.effect).unknowns}
    for name in placement.effect.inputs:
        wanted = placement.inputs.get(name, f"{placement.name}_{name}")
        signal = signals[name]
        if wanted not in known:
            known[wanted] = placement.unit_of(name, signal.unit)
            unit = f'unit = "{known[wanted]}", ' if known[wanted] else ""
            about = _quoted(signal.description)
            draft.declarations.append(f'{_INPUT} {wanted}({unit}start = 0) "{about}";')
        change = supplied(known[wanted], signal.unit)
        if change.is_identity:
            draft.connect(wanted, f"{placement.name}.{name}")
        else:
            draft.equations.append(f"{placement.name}.{name} = {converted_text(wanted, change)};")
    return known


def _connect(draft: _Draft, placement: Placement, original: _Original) -> _Original:
    """The model whose text the effect is put into: the original, or that with a place opened for it."""
    effect, site, name = placement.effect, placement.site, placement.name
    if site.kind == "node":
        draft.connect(f"{name}.{effect.connectors[0]}", _reachable(original, (site.name, *site.connectors)))
    elif site.kind in ("component", "pair"):
        first, second = ("support", effect.connectors[0]) if _is_across(placement) else effect.connectors
        a, b = (_reachable(original, (end,)) for end in site.connectors)
        draft.connect(f"{name}.{first}", a)
        draft.connect(f"{name}.{second}", b)
    elif site.kind == "connector":
        original = _in_series(draft, placement, original)
    elif site.kind == "equation":
        original, end = _opened_for(original, site.name, site.domain)
        draft.connect(f"{name}.{effect.connectors[0]}", _reachable(original, (end,)))
    elif site.kind == "exchange":
        for own, part in zip(effect.connectors, site.name.split(", "), strict=True):
            if part in original.flat.input_names:
                draft.connect(f"{name}.{own}", _prescribed(draft, original.flat, name, part))
                continue
            original, end = _opened_for(original, part, site.domain)
            draft.connect(f"{name}.{own}", end)
    elif site.kind == "force":
        original = _beside_force(draft, placement, original)
    elif site.kind == "mesh":
        original = _in_mesh(draft, placement, original)
    elif site.kind == "terminal":
        original = _at_terminal(draft, placement, original)
    elif site.kind == "input":
        original = _behind_input(draft, placement, original)
    elif site.kind == "output":
        original = _before_output(draft, placement, original)
    elif site.kind == "signal":
        original = _behind_signal(draft, placement, original)
    else:
        original = _instead(draft, placement, original)
    return original


def _prescribed(draft: _Draft, flat: FlatModel, name: str, variable: str) -> str:
    """The port of a new component whose temperature is the input `variable`."""
    unit = next(one.unit for one in flat.inputs if one.name == variable)
    package = "Celsius" if unit == "degC" else "Sources"
    source = free_name(f"{name}_surroundings", names_of(flat))
    kind = f"Daest.Thermal.HeatTransfer.{package}.PrescribedTemperature"
    draft.declarations.append(f'{kind} {source} "Temperature that is measured";')
    draft.equations.append(f"{source}.T = {variable};")
    return f"{source}.port"


def _opened_for(original: _Original, place: str, domain: Domain) -> tuple[_Original, str]:
    """As `_opened_balance`, of a place as the model named it before others were opened, which changes the
    numbers of its equations."""
    known = [balance.name(original.flat) for balance in balances(original.flat)]
    return _opened_balance(original, _renumbered(place, known), domain)


def _renumbered(place: str, known: Sequence[str]) -> str:
    """The name of a place by which the model knows it, whose equations may have other numbers since others
    were opened."""

    def without_numbers(name: str) -> list[str]:
        return [part.rpartition(":")[2] for part in name.split(", ")]

    if place in known:
        return place
    return next(name for name in known if without_numbers(name) == without_numbers(place))


def _with_rows_alone(original: _Original, rows: Sequence[int]) -> _Original:
    """The model whose equations of these numbers stand for themselves: the first loop around one of them is
    written out, which changes the numbers."""
    for row in rows:
        with _opening(original, f"the equation {original.flat.equations[row].text}"):
            source = with_loop_written_out(original.source, original.flat, row)
        if source != original.source:
            return original.changed(source)
    return original


def _opened_balance(original: _Original, place: str, domain: Domain) -> tuple[_Original, str]:
    """The model with a connector at a bare equation, and that connector."""
    flat = original.flat
    balance = next(b for b in balances(flat) if b.name(flat) == place)
    owner = flat.equations[balance.row].origin
    if "." in owner:
        raise original.refusal(
            f"the equation {flat.equations[balance.row].text} lies inside of the component `{owner}`",
            "Put the effect into the class of the component, or write the balance in the model itself.",
        )
    end = term_connector(flat, (balance.row,), domain)
    if end is not None:
        return original, end
    alone = original if owner else _with_rows_alone(original, [balance.row])
    if alone is not original:
        return _opened_for(alone, place, domain)
    with _opening(original, f"the equation {flat.equations[balance.row].text}"):
        source, end = opened_balance(original.source, flat, balance, domain, names_of(flat))
    return original.changed(source), end


def _beside_force(draft: _Draft, placement: Placement, original: _Original) -> _Original:
    """The model with a connector at a force between bodies, where the effect sits; the other end of an effect
    with two is fixed."""
    flat, name, domain = original.flat, placement.name, placement.site.domain
    known = {force.name(flat): force for force in internal_forces(flat)}
    force = known[_renumbered(placement.site.name, list(known))]
    end = term_connector(flat, (entry.row for entry in force.entries), domain)
    if end is None:
        alone = _with_rows_alone(original, [entry.row for entry in force.entries])
        if alone is not original:
            return _beside_force(draft, placement, alone)
        with _opening(original, f"the equation {flat.equations[force.entries[0].row].text}"):
            source, end = opened_force(original.source, flat, force, names_of(flat))
        original = original.changed(source)
    *fixed, own = placement.effect.connectors
    for one in fixed:
        held = free_name(f"{name}_end", names_of(flat))
        draft.declarations.append(f'Daest.Mechanics.{domain.capitalize()}.Components.Fixed {held} "At rest";')
        draft.connect(f"{name}.{one}", f"{held}.flange")
    draft.connect(f"{name}.{own}", end)
    return original


def _in_mesh(draft: _Draft, placement: Placement, original: _Original) -> _Original:
    """The model with the effect in series in a mesh that an equation describes."""
    flat = original.flat
    known = {mesh.name(flat): mesh for mesh in meshes(flat)}
    place = known[_renumbered(placement.site.name, list(known))]
    alone = _with_rows_alone(original, [place.row])
    if alone is not original:
        return _in_mesh(draft, placement, alone)
    with _opening(original, f"the equation {flat.equations[place.row].text}"):
        source, term = opened_mesh(original.source, flat, place, names_of(flat))
    draft.changes.append(f"{term}(is_used = true)")
    ends = ("p", "n") if place.domain == "electrical" else ("port_a", "port_b")
    for own, end in zip(placement.effect.connectors, ends, strict=True):
        draft.connect(f"{placement.name}.{own}", f"{term}.{end}")
    return original.changed(source)


def _at_terminal(draft: _Draft, placement: Placement, original: _Original) -> _Original:
    """The model with the effect in series at an output voltage at which an input current flows."""
    place = next(one for one in terminals(original.flat) if one.name(original.flat) == placement.site.name)
    current, output = place.current_name(original.flat), original.flat.outputs[place.output].name
    original, bound = _bound(output, original)
    if not bound:
        raise original.refusal(f"the output `{output}` is connected", "Give it by an equation.")
    term = free_name(f"{current}_term", names_of(original.flat))
    about = f"In series with {current} at {output}"
    flow, drop = times_text(place.per_flow, current), times_text(place.per_drop, f"{term}.total")
    draft.declarations.append(f'Daest.Terms.Voltage {term}(i = {flow}, is_used = true) "{about}";')
    draft.changes.append(f"{output} = ({bound}) {'+' if place.sign > 0 else '-'} {drop}")
    for own, pin in zip(placement.effect.connectors, ("p", "n"), strict=True):
        draft.connect(f"{placement.name}.{own}", f"{term}.{pin}")
    return original


@contextmanager
def _opening(original: _Original, shown: str, code: str = "effect-not-writable") -> Iterator[None]:
    """Text that cannot be opened becomes a ModelError of what `shown` tells."""
    try:
        if within(original.source):
            raise NotOpened("stands in a file of a package, which stays as it is")
        yield
    except NotOpened as reason:
        raise original.refusal(
            f"nothing can be put into {shown}: it {reason}",
            "Write it as one equation of a model in a file of its own.",
            code,
        ) from None


def _reachable(original: _Original, connectors: Iterable[str]) -> str:
    """The first of the connectors that a connect clause of the model may name: its own, or one of a
    component."""
    names = list(connectors)
    for name in names:
        if name.count(".") <= 1:
            return name
    raise original.refusal(
        f"`{names[0]}` lies inside of a component and has no connection to the outside",
        "Choose a connector of the model's own components, or give the component a connector.",
    )


def _in_series(draft: _Draft, placement: Placement, original: _Original) -> _Original:
    first, second = placement.effect.connectors
    original, connector = _named(original, (placement.site.name, *placement.site.aliases))
    if not connector:
        raise original.refusal(
            f"no connect clause of {original.path.name} names `{placement.site.name}`",
            "Put the effect where the model itself makes the connection, or into the component that does.",
        )
    for clause in _clauses_of(connector, original):
        draft.replace(clause)
        other = clause.right if clause.left == connector else clause.left
        draft.connect(other, f"{placement.name}.{first}")
    draft.connect(f"{placement.name}.{second}", connector)
    return original


def _behind_input(draft: _Draft, placement: Placement, original: _Original) -> _Original:
    name = placement.site.name
    original, _ = _named(original, (name,))
    flat, clauses = original.flat, _clauses_of(name, original)
    symbol = flat.u[flat.input_names.index(name)]
    used = set(ca.jacobian_sparsity(flat.residual, symbol).row())
    equations = [flat.equations[i] for i in sorted(used) if flat.equations[i].kind != "connection"]
    is_in_outputs = bool(ca.depends_on(flat.output_expressions, symbol))
    if equations or is_in_outputs or not clauses:
        shown = f"the input `{name}`" + (f", used in {equations[0].text}" if equations else "")
        with _opening(original, shown, "effect-input-used"):
            source, variable = opened_input(original.source, flat, name, names_of(flat))
        original = original.changed(source)
        draft.changes.append(f"{variable} = {placement.name}.y")
        draft.equations.append(f"{placement.name}.u = {name};")
    else:
        draft.connect(name, f"{placement.name}.u")
    for clause in clauses:
        draft.replace(clause)
        draft.connect(f"{placement.name}.y", clause.right if clause.left == name else clause.left)
    return original


def _behind_signal(draft: _Draft, placement: Placement, original: _Original) -> _Original:
    """The effect between a signal inside of the model and what uses it: the connections of a block's output,
    or the equations."""
    name, flat = placement.site.name, original.flat
    if "." not in name:
        own = [e for e in flat.equations if e.kind != "connection"]
        of_rate = [e for e in own if f"der({name})" in e.text]
        given = next((e for e in own if e.text.partition(" = ")[0] == name), *of_rate[:1])
        with _opening(original, f"the equation {given.text}"):
            source, variable = opened_signal(original.source, flat, name, given, names_of(flat))
        draft.changes.append(f"{variable} = {placement.name}.y")
        draft.equations.append(f"{placement.name}.u = {name};")
        return original.changed(source)
    original, found = _named(original, (name,))
    if not found:
        raise original.refusal(
            f"no connect clause of {original.path.name} names `{name}`",
            "Put the effect into the component that makes the connection.",
        )
    draft.connect(name, f"{placement.name}.u")
    for clause in _clauses_of(name, original):
        draft.replace(clause)
        draft.connect(f"{placement.name}.y", clause.right if clause.left == name else clause.left)
    return original


def _instead(draft: _Draft, placement: Placement, original: _Original) -> _Original:
    """The model whose equations take the effect's result for a parameter: one of the model or of a record, or
    one of a component, whose class is copied into the file where it stands in a library."""
    name, result = placement.site.name, f"{placement.name}.y"
    same = aliases(original.flat, name)
    opened: list[str] = []
    for array in dict.fromkeys(without_subscripts(one) for one in same):
        with _opening(original, f"the parameter `{name}`"):
            made = _parameter_opened(original, name, next(n for n in same if without_subscripts(n) == array))
        if made is not None:
            draft.values[made[1]] = _instead_of_elements(original, same, array, result)
            original = made[0]
            opened.append(made[1])
    if not same or is_used_otherwise(original.flat, name, opened):
        raise original.refusal(
            f"{placement.effect.name} at `{name}` cannot be written: a component takes it as a parameter, "
            "which does not change with time",
            "Declare it in the class of the component as a variable.",
        )
    draft.equations.append(f"{placement.name}.u = {name};")
    for own in placement.effect.inputs:
        draft.equations.append(f"{placement.name}.{own} = {placement.inputs[own]};")
    return original


def _parameter_opened(original: _Original, name: str, alias: str) -> tuple[_Original, str] | None:
    """The model whose equations use a parameter, or an alias of it, through a variable, and that; None where
    no equation of the class uses it. A class of a library is copied for that. Raises NotOpened."""
    try:
        original = _with_own_class(original, name, alias)
        made = opened_parameter(original.source, original.flat, name, alias)
        return None if made is None else (original.changed(made[0]), made[1])
    except ModelError:  # of a text that the user has not written
        raise NotOpened("is used where nothing may change with time") from None


def _with_own_class(original: _Original, name: str, alias: str) -> _Original:
    """The model in whose file the class of the component that uses a parameter stands itself."""
    owner = without_subscripts(owner_of(original.flat, name, alias))
    if not owner:
        return original
    libraries = _roots(original, original.libraries)
    text = with_own_class(original.source, original.path, original.head.name, owner, libraries)
    return original if text == original.source else original.changed(text)


def _instead_of_elements(original: _Original, same: Collection[str], array: str, result: str) -> str:
    """What takes the place of a parameter or an array of such: the `result` for those that are the `same`."""
    flat = original.flat
    names = (*flat.parameter_names, *(p.name for p in flat.derived_parameters))
    found = _elements(names, array)
    text = _in_braces({at: result if name in same else name for at, name in found.items()})
    if text is None:
        raise original.refusal(
            f"`{array}` cannot change as a whole: some of its elements are no parameters",
            "Give its elements names of their own.",
        )
    return text


def _before_output(draft: _Draft, placement: Placement, original: _Original) -> _Original:
    name = placement.site.name
    original, bound = _bound(name, original)
    if bound:
        draft.changes.append(f"{name} = {placement.name}.y")
        draft.equations.append(f"{placement.name}.u = {bound};")
        return original
    for clause in _clauses_of(name, original):
        draft.replace(clause)
        draft.connect(clause.left if clause.right == name else clause.right, f"{placement.name}.u")
    draft.connect(f"{placement.name}.y", name)
    return original


def _named(original: _Original, names: Sequence[str]) -> tuple[_Original, str]:
    """The model, and the first of `names` that its connect clauses name, once its loops of them are written
    out where none does; empty for none."""
    name = next((name for name in names if _clauses_of(name, original)), "")
    if name or not any("[" in name for name in names):
        return original, name
    written = with_connects_written_out(original.source, original.head)
    if written == original.source:
        return original, ""
    original = original.changed(written)
    return original, next((name for name in names if _clauses_of(name, original)), "")


def _clauses_of(name: str, original: _Original) -> list[ConnectClause]:
    return [c for c in original.clauses() if name in c.pair]


def _bound(name: str, original: _Original) -> tuple[_Original, str]:
    """The model whose output has a binding that no equation uses, and the text of that; empty where the
    output is connected."""
    original, connected = _named(original, (name,))
    if connected:
        return original, ""
    bound = _binding(name, original)
    if not bound or _is_used(name, original):
        with _opening(original, f"the output `{name}`", "effect-input-used"):
            source = opened_output(original.source, original.flat, name, names_of(original.flat))
        original = original.changed(source)
        bound = _binding(name, original)
    return original, bound


def _is_used(name: str, original: _Original) -> bool:
    """Whether an equation takes the value of the output, which an effect before it must not change."""
    try:
        return is_used_elsewhere(original.source, original.flat, name)
    except NotOpened:
        return False


def _binding(name: str, original: _Original) -> str:
    """The text of `expr` in `extends Base(y = expr)`, of the last class that says so, or in `output Real y(…)
    = expr "…";`; empty where there is none."""
    modified = _modified(name, original, original.head)
    if modified:
        return modified
    try:
        return output_binding(original.source, original.flat, name)
    except NotOpened:
        return ""


def _modified(name: str, original: _Original, head: ClassHead) -> str:
    """The binding that the class of `head`, or one that it extends, gives a variable where it extends."""
    for clause in extends_clauses(class_tokens(original.source, head)):
        if name in clause.bound:
            first, last = clause.bound[name]
            return original.source[first:last].decode()
        base = find_base(class_heads(original.source), head.name, clause.base)
        found = "" if base is None else _modified(name, original, base)
        if found:
            return found
    return ""
