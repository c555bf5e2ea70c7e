"""The effect library: Modelica classes marked `__Daest(effect = true, …)`, read as a catalogue.

All classes are compiled together, as components of one model, and taken apart again; the result is kept in
the cache folder under the hash of every file of the libraries, so that it is done once per change of a
library. The bundled classes have a catalogue of their own: one's own are compiled alone.
"""

from __future__ import annotations

import contextlib
import hashlib
import pickle
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import casadi as ca

from daest.cache import cache_folder, forget_unused, keep_content, kept_content, was_used
from daest.errors import ModelError, Place
from daest.machine import version
from daest.model.effects import Attachment, Effect, EffectParameter, ParameterRole
from daest.model.flat import FlatModel
from daest.model.parts import DerivedParameter, Equation, NoiseInput, Parameter, Variable
from daest.modelica.compiling.compiler import Job, compile_source, with_room
from daest.modelica.flat.assemble import assemble
from daest.modelica.flat.connectors import connectors_of
from daest.modelica.language import syntax as s
from daest.modelica.language.library import bundled_root, library_roots, readable_roots, stamp
from daest.modelica.language.outline import ClassHead, class_heads, class_tokens, offset_of, tokens
from daest.modelica.language.parse import Annotation, annotation_of
from daest.modelica.language.source import read_source
from daest.modelica.language.text import text
from daest.near import did_you_mean, near_names

__all__ = ["EffectModel", "effect_library", "effect_model", "find_effect", "find_effects", "library_digest"]

# What stands in the texts of an effect's equations for the name of its component and a dot.
OWN = "@."

_MARK = re.compile(rb"__Daest\s*\(\s*effect\b")
_BASE = re.compile(rb"\bextends\s+(?:\w+\.)*(\w+)")
_CATALOGUE = "Daest__Catalogue"
_SIGNALS: tuple[Attachment, ...] = ("signal", "input", "output", "parameter")
_ATTACHMENTS: tuple[Attachment, ...] = ("connector", "parallel", "series", *_SIGNALS)
_ROLES: tuple[ParameterRole, ...] = ("size", "shape", "sharpness", "given")
_SIGNAL_UNITS = ("", "u", "u/s", "1/u", "1/(u.s)", "z", "1/z")
MOST_KEPT = 100  # catalogues of effects in the cache
_KEYS = (
    "effect",
    "attach",
    "law",
    "dynamic",
    "inputs",
    "outside",
    "sum_of",
    "grounded",
    "one_way",
    "of_store",
    "turns",
    "driving",
    "of_gas",
    "of_equation",
    "rival",
)
_DOCUMENTATION = re.compile(r'Documentation\s*\(\s*info\s*=\s*"((?:[^"\\]|\\.)*)"', re.DOTALL)
_TAG = re.compile(r"<[^>]*>")


@dataclass(frozen=True)
class EffectModel:
    """The equations of an effect with open connectors; its signals (`u`, `y`) and inputs are unknowns.

    `function` maps (derivatives, xi, w, theta, time) to (residual, initial residual, derived values) in the
    order of `equations`, `initial_equations` and `derived`. In their texts `OWN` stands before the effect's
    own names.
    """

    unknowns: tuple[Variable, ...]
    noises: tuple[NoiseInput, ...]
    parameters: tuple[Parameter, ...]
    derived: tuple[DerivedParameter, ...]
    equations: tuple[Equation, ...]
    initial_equations: tuple[Equation, ...]
    function: ca.Function


@dataclass(frozen=True)
class _Entry:
    """An effect with its equations, and those with its support connected if it has one."""

    effect: Effect
    model: EffectModel
    across: EffectModel | None


@dataclass(frozen=True)
class _Source:
    """A marked class: its text and its annotation."""

    file: str
    text: bytes
    head: ClassHead
    annotation: Annotation
    documentation: str

    def entry(self, key: str) -> Any:
        return _value(self.annotation.entries.get(key))

    def error(self, key: str, what: str, remedy: str) -> ModelError:
        where = self.annotation.places.get(key, self.annotation.place)
        return ModelError("effect-annotation", f"`{self.head.name}`: {what}", where=where, remedy=remedy)


@dataclass(frozen=True)
class _Catalogue:
    """The entries by class name; `key` is the hash of all that decides them, `seen` a stamp of the files."""

    seen: str
    key: str
    entries: Mapping[str, _Entry]


_kept: dict[tuple[str, ...], _Catalogue] = {}


def effect_library(libraries: Sequence[str | Path] = ()) -> tuple[Effect, ...]:
    """All effects of the bundled library and of the folders `libraries` and MODELICAPATH, sorted by domain
    as the bundled library has them. Raises ModelError for a class that does not compile or whose annotation
    is wrong.

        >>> sorted({effect.domain for effect in daest.effect_library()})
        ['amount', 'electrical', 'hydraulic', 'rotational', 'signal', 'thermal', 'translational']
    """
    return tuple(entry.effect for entry in _catalogue(_names(libraries), check=True).values())


def library_digest(libraries: Sequence[str | Path] = ()) -> str:
    """A hash of all that decides `effect_library`: the files of the libraries, and the programs."""
    names = _names(libraries)
    _catalogue(names, check=True)
    return _kept[names].key


def find_effects(name: str, libraries: Sequence[str | Path] = ()) -> tuple[Effect, ...]:
    """The effects of that class name, full or short; the mechanical ones exist in two domains.

    Raises ModelError `effect-unknown` with the nearest names."""
    known = effect_library(libraries)
    found = tuple(e for e in known if e.class_name == name or e.class_name.endswith("." + name))
    if found:
        return found
    short = {e.name.lower(): e.name for e in known}
    near = near_names(name.rpartition(".")[2].lower(), short, 3)
    hint = f"Did you mean {' or '.join(short[one] for one in near)}? " if near else ""
    if name.endswith((".mo", ".fmu")):
        hint = f"A model is named by --model {name}. "
    raise ModelError(
        "effect-unknown", f"there is no effect `{name}`", remedy=hint + "daest effects lists them all."
    )


def find_effect(name: str, libraries: Sequence[str | Path] = ()) -> Effect:
    """The one effect of that class name. Raises ModelError `effect-unknown`, and `effect-ambiguous` if
    several domains have one.

        >>> effect = daest.find_effect("Daest.Effects.Rotational.CoulombFriction")
        >>> effect.law
        'tau = -tau_c*tanh(w/w_s)'
    """
    found = find_effects(name, libraries)
    if len(found) > 1:
        raise ModelError(
            "effect-ambiguous",
            f"`{name}` may be {' or '.join(e.class_name for e in found)}",
            remedy=f"Give more of the name: {'.'.join(found[0].class_name.split('.')[-2:])}, say.",
        )
    return found[0]


def effect_model(effect: Effect, across: bool = False) -> EffectModel:
    """The equations of `effect`; `across` with its connector `support` instead of a fixed housing."""
    entry = _catalogue(effect.libraries, check=False)[effect.class_name]
    if across and entry.across is not None:
        return entry.across
    return entry.model


def adds_a_constant(effect: Effect) -> bool:
    """Whether a constant is all that an effect adds, whatever anything does: a load, a zero that is off."""
    if len(effect.parameters) != 1 or not effect.sizes:
        return False
    slope, time, rest = _slope(effect)
    return not ca.depends_on(slope, ca.vertcat(time, rest))


def adds_a_ramp(effect: Effect) -> bool:
    """Whether what an effect adds runs with the time, whatever anything else does."""
    if len(effect.parameters) != 1 or not effect.sizes:
        return False
    slope, time, rest = _slope(effect)
    return ca.depends_on(slope, time) and not ca.depends_on(slope, rest)


def equations_of(effect: Effect) -> tuple[ca.SX, ...]:
    """The residual of the equations of an effect, and what it is made of: derivatives, unknowns, noises,
    parameters and the time."""
    function = effect_model(effect).function
    symbols = function.sx_in()
    return function(*symbols)[0], *symbols


def _slope(effect: Effect) -> tuple[ca.SX, ca.SX, ca.SX]:
    """What the equations of an effect change with its parameters, the time, and all else that they hold."""
    residual, derivatives, xi, w, theta, time = equations_of(effect)
    return ca.jacobian(residual, theta), time, ca.veccat(derivatives, xi, w, theta)


def _names(libraries: Sequence[str | Path]) -> tuple[str, ...]:
    return tuple(str(Path(folder).expanduser().resolve()) for folder in libraries)


# Keeping ----------------------------------------------------------------------------------------------------


def _catalogue(libraries: tuple[str, ...], check: bool) -> Mapping[str, _Entry]:
    """The entries by class name; `check` looks whether a file has changed since they were read."""
    kept = _kept.get(libraries)
    if kept is not None and not check:
        return kept.entries
    roots = library_roots(libraries)
    # Names, sizes and times of the files: to read hundreds of them at every question takes ten times as long.
    seen = stamp(roots)
    if kept is None or kept.seen != seen:
        files = [(root, file) for root in roots for file in sorted(root.rglob("*.mo"))]
        key = _key(files)
        is_same = kept is not None and kept.key == key
        entries = kept.entries if kept is not None and is_same else _stored(key, roots, files, libraries)
        kept = _kept[libraries] = _Catalogue(seen, key, entries)
    return kept.entries


def _key(files: Iterable[tuple[Path, Path]]) -> str:
    """Hash of everything that decides the catalogue."""
    found = hashlib.sha256()
    for package in ("daest", "casadi", "rumoca"):
        found.update(f"{package} {version(package)}\n".encode())
    found.update(Path(__file__).read_bytes())
    for root, file in files:
        content = file.read_bytes()
        found.update(f"{root} {file.relative_to(root)} {len(content)}\n".encode())
        found.update(content)
    return found.hexdigest()


def _stored(
    key: str, roots: tuple[Path, ...], files: Sequence[tuple[Path, Path]], libraries: tuple[str, ...]
) -> Mapping[str, _Entry]:
    kept = cache_folder() / "effects" / f"{key}.pickle"
    content = kept_content(kept)
    if content is not None:
        with contextlib.suppress(Exception):  # written by another version: it is made again
            was_used(kept)
            return pickle.loads(content)
    *own, last = roots
    if own and last == bundled_root():
        bundled = [(root, file) for root, file in files if root == last]
        entries = _stored(_key(bundled), (last,), bundled, ())
        entries = {
            name: replace(entry, effect=replace(entry.effect, libraries=libraries))
            for name, entry in entries.items()
        }
        entries |= _read(roots, [file for root, file in files if root != last], libraries)
    else:
        entries = _read(roots, [file for _, file in files], libraries)
    entries = dict(sorted(entries.items(), key=_order))
    keep_content(kept, pickle.dumps(entries))
    forget_unused(kept.parent, MOST_KEPT)
    return entries


# Reading ----------------------------------------------------------------------------------------------------


def _read(roots: tuple[Path, ...], files: Sequence[Path], libraries: tuple[str, ...]) -> dict[str, _Entry]:
    """The effects that the files hold."""
    sources = [source for file in files for source in _marked(file)]
    if not sources:
        return {}
    unique = {source.head.name: source for source in reversed(sources)}
    ordered = [unique[name] for name in dict.fromkeys(source.head.name for source in sources)]
    parts = _parts(_all_together(ordered, roots))
    entries = [_entry(i, source, parts, libraries) for i, source in enumerate(ordered)]
    return {entry.effect.class_name: entry for entry in entries}


def _order(item: tuple[str, _Entry]) -> tuple[int, str]:
    domains = ("rotational", "translational", "electrical", "thermal", "hydraulic", "amount", "signal")
    return domains.index(item[1].effect.domain), item[0]


def _marked(file: Path) -> Iterable[_Source]:
    if _MARK.search(file.read_bytes()) is None:
        return
    content = read_source(file)
    for head in class_heads(content):
        start = _class_annotation(content, head)
        annotation = annotation_of(str(file), content, start) if start is not None else None
        if start is None or not annotation or not annotation.flag("effect", False):
            continue
        found = _DOCUMENTATION.search(content[start:].decode())
        source = _Source(str(file), content, head, annotation, _plain(found[1]) if found else "")
        _check(source)
        yield source


def _class_annotation(content: bytes, head: ClassHead) -> int | None:
    """Byte offset of the annotation of a class: the last one that is a statement of its own."""
    before, found = ";", None
    for token in class_tokens(content, head):
        if token.text == "annotation" and before in (";", "equation", "algorithm"):
            found = token.start
        before = token.text
    return found


def _plain(documentation: str) -> str:
    return " ".join(_TAG.sub(" ", documentation.replace('\\"', '"')).split())


def _check(source: _Source) -> None:
    for key in source.annotation.entries:
        if key not in _KEYS:
            hint = did_you_mean(key, _KEYS, 1)
            raise source.error(
                key, f"`{key}` has no meaning for an effect", f"{hint}Known: {', '.join(_KEYS)}."
            )
    if source.entry("attach") not in _ATTACHMENTS:
        raise source.error(
            "attach", "attach is missing or unknown", f"Write attach = one of {', '.join(_ATTACHMENTS)}."
        )
    if not isinstance(source.entry("law"), str):
        raise source.error("law", "law is missing", 'Write law = "tau = -d*w", say.')
    turns = source.entry("turns")
    if turns is not None and (isinstance(turns, bool | str | tuple) or turns <= 0):
        raise source.error("turns", "turns is no number above 0", "Write turns = 30, say.")
    if source.entry("outside") not in (None, "input", "output"):
        raise source.error("outside", "outside is unknown", 'Write outside = "input" or "output".')


def _value(node: s.Node | None) -> Any:
    """What an annotation entry says: number, text, flag, or a tuple of them; None for anything else."""
    match node:
        case s.Constant(value):
            return value
        case s.Unary("-", s.Constant(value)) if not isinstance(value, str):
            return -value
        case s.Array(elements):
            return tuple(_value(element) for element in elements)
    return None


# Compiling --------------------------------------------------------------------------------------------------


def _signals(source: _Source) -> tuple[str, ...]:
    """Inputs of the class that the catalogue has to supply."""
    own = ("u",) if source.entry("attach") in _SIGNALS else ()
    return (*own, *(source.entry("inputs") or ()))


def _all_together(sources: Sequence[_Source], roots: tuple[Path, ...]) -> FlatModel:
    """One model with all classes, and once more with their supports: those that their texts tell of, and
    where these tell wrongly, those that classes compiled without them turn out to have."""
    told = _told_supported(sources, roots)
    with contextlib.suppress(ModelError):
        flat = _flat(_catalogue_text(sources, told), roots)
        if _supported(flat, sources) == told:
            return flat
    plain = _compiled(sources, [False] * len(sources), roots)
    return _compiled(sources, _supported(plain, sources), roots)


def _compiled(sources: Sequence[_Source], supported: Sequence[bool], roots: tuple[Path, ...]) -> FlatModel:
    """One model with all classes as components e0, e1, … and, with support, a0, a1, …"""
    try:
        return _flat(_catalogue_text(sources, supported), roots)
    except ModelError:
        for source, has_support in zip(sources, supported, strict=True):
            _alone(source, has_support, roots)  # raises for the class at fault
        raise


def _alone(source: _Source, has_support: bool, roots: tuple[Path, ...]) -> None:
    try:
        _flat(_catalogue_text([source], [has_support]), roots)
    except ModelError as problem:
        remedy = problem.remedy
        if problem.code == "model-unbalanced":
            remedy += ' Name its signal inputs in the annotation: inputs = {"u"}.'
        raise ModelError(
            problem.code,
            f"effect `{source.head.name}`: {problem.what}",
            where=Place(source.file) if isinstance(problem.where, str) else problem.where,
            remedy=remedy,
        ) from None


def _catalogue_text(sources: Sequence[_Source], supported: Sequence[bool]) -> bytes:
    declarations, connections = [], []
    for i, (source, has_support) in enumerate(zip(sources, supported, strict=True)):
        components = [f"e{i}"] + ([f"a{i}"] if has_support else [])
        for component in components:
            change = "(useSupport = true)" if component.startswith("a") else ""
            declarations.append(f"  {source.head.name} {component}{change};")
            for name in _signals(source):
                declarations.append(f"  input Real {component}_{name};")
                connections.append(f"  {component}.{name} = {component}_{name};")
    lines = [f"model {_CATALOGUE}", "  import Daest.Units.SI;", *declarations, "equation", *connections]
    return "\n".join([*lines, f"end {_CATALOGUE};"]).encode()


def _flat(content: bytes, roots: tuple[Path, ...]) -> FlatModel:
    file = Path(f"{_CATALOGUE}.mo")
    job = Job(file, content, _CATALOGUE, readable_roots(roots, content, file))
    return with_room(lambda: assemble(compile_source(job), str(job.path)))


def _supported(flat: FlatModel, sources: Sequence[_Source]) -> list[bool]:
    """Whether a class attached at a connector has a support for its housing (parameter `useSupport`)."""
    having = {name.partition(".")[0] for name in flat.unknown_names if name.endswith("_support")}
    return [source.entry("attach") == "connector" and f"e{i}" in having for i, source in enumerate(sources)]


def _told_supported(sources: Sequence[_Source], roots: tuple[Path, ...]) -> list[bool]:
    """The same as the texts tell it: the file of the class speaks of `useSupport`, or extends a class whose
    file does."""
    texts = {str(file): file.read_bytes() for root in roots for file in root.rglob("*.mo")}
    bases = {file: {name.decode() for name in _BASE.findall(content)} for file, content in texts.items()}
    found = {file for file, content in texts.items() if b"useSupport" in content}
    more = found
    while more:
        names = {Path(file).stem for file in more}
        more = {file for file in texts.keys() - found if bases[file] & names}
        found |= more
    return [source.entry("attach") == "connector" and source.file in found for source in sources]


# Taking apart -----------------------------------------------------------------------------------------------


@dataclass
class _Part:
    """Positions, in the model of the catalogue, of what belongs to one component."""

    unknowns: list[int]
    noises: list[int]
    parameters: list[int]
    derived: list[int]
    equations: list[int]
    initial: list[int]


def _parts(flat: FlatModel) -> dict[str, EffectModel]:
    """The model of each component. Rows of unconnected connectors and of the catalogue's own signals are
    dropped."""
    parts: dict[str, _Part] = {}

    def part(name: str) -> _Part:
        return parts.setdefault(name.partition(".")[0], _Part([], [], [], [], [], []))

    for i, unknown in enumerate(flat.unknowns):
        part(unknown.name).unknowns.append(i)
    for i, noise in enumerate(flat.noises):
        part(noise.name).noises.append(i)
    for i, parameter in enumerate(flat.parameters):
        part(parameter.name).parameters.append(i)
    for i, derived in enumerate(flat.derived_parameters):
        part(derived.name).derived.append(i)
    for i, equation in enumerate(flat.equations):
        if equation.kind != "unconnected" and equation.origin:
            part(equation.origin).equations.append(i)
    for i, equation in enumerate(flat.initial_equations):
        part(equation.origin).initial.append(i)
    return {name: _part_model(name, one, flat) for name, one in parts.items()}


def _part_model(name: str, part: _Part, flat: FlatModel) -> EffectModel:
    def local(item: Any) -> Any:
        return replace(item, name=item.name.removeprefix(f"{name}."))

    def local_equation(equation: Equation) -> Equation:
        return replace(
            equation,
            text=_marked_text(equation.text, name),
            origin=", ".join(o.removeprefix(name).removeprefix(".") for o in equation.origin.split(", ")),
        )

    function = ca.Function(
        "effect",
        [
            flat.derivatives[part.unknowns],
            flat.xi[part.unknowns],
            flat.w[part.noises],
            flat.theta[part.parameters],
            flat.time,
        ],
        [
            flat.residual[part.equations],
            flat.initial_residual[part.initial],
            flat.derived_values[part.derived],
        ],
    )
    return EffectModel(
        unknowns=tuple(local(flat.unknowns[i]) for i in part.unknowns),
        noises=tuple(_local_noise(flat.noises[i], name) for i in part.noises),
        parameters=tuple(local(flat.parameters[i]) for i in part.parameters),
        derived=tuple(_local_derived(flat.derived_parameters[i], name) for i in part.derived),
        equations=tuple(local_equation(flat.equations[i]) for i in part.equations),
        initial_equations=tuple(local_equation(flat.initial_equations[i]) for i in part.initial),
        function=function,
    )


def _marked_text(text: str, component: str) -> str:
    return re.sub(rf"(?<![\w.]){component}\.", OWN, text)


def _local_noise(noise: NoiseInput, component: str) -> NoiseInput:
    prefix = f"{component}."
    return replace(
        noise,
        name=noise.name.removeprefix(prefix),
        intensity_parameter=noise.intensity_parameter.removeprefix(prefix),
    )


def _local_derived(derived: DerivedParameter, component: str) -> DerivedParameter:
    return replace(
        derived,
        name=derived.name.removeprefix(f"{component}."),
        expression=_marked_text(derived.expression, component),
    )


def _entry(i: int, source: _Source, parts: Mapping[str, EffectModel], libraries: tuple[str, ...]) -> _Entry:
    model, across = parts[f"e{i}"], parts.get(f"a{i}")
    connectors = connectors_of(model.unknowns)
    signals = source.entry("attach") in _SIGNALS
    _check_connectors(source, list(connectors))
    parameters = tuple(_parameter(p, source) for p in model.parameters)
    units = {x.name: x.unit for x in model.unknowns}
    effect = Effect(
        name=source.head.name.rpartition(".")[2],
        class_name=source.head.name,
        domain="signal" if signals else next(iter(connectors[name].domain for name in connectors)),
        attach=source.entry("attach"),
        law=source.entry("law"),
        description=_description(source),
        parameters=parameters,
        connectors=("u", "y") if signals else tuple(connectors),
        is_dynamic=source.annotation.flag("dynamic", False),
        n_states=_own_states(model, parameters, _signals(source)),
        has_support=across is not None,
        inputs=tuple(source.entry("inputs") or ()),
        input_units=tuple(units.get(name, "") for name in source.entry("inputs") or ()),
        outside=source.entry("outside") or "",
        sum_of=tuple(source.entry("sum_of") or ()),
        grounded=source.entry("grounded") or "",
        one_way=source.entry("one_way") or "",
        is_of_store=source.annotation.flag("of_store", False),
        most_turns=source.entry("turns"),
        is_of_driving=source.annotation.flag("driving", False),
        is_of_gas=source.annotation.flag("of_gas", False),
        is_of_equation=source.annotation.flag("of_equation", False),
        is_rival=source.annotation.flag("rival", False),
        documentation=source.documentation,
        libraries=libraries,
    )
    if effect.attach == "parameter" and not _is_formula(model, effect.inputs):
        raise source.error(
            "attach",
            'attach = "parameter" needs one equation `y = …`',
            "Write it without other variables than u and the declared inputs.",
        )
    if not effect.sizes:
        raise source.error(
            "effect", "no parameter makes the effect vanish", 'Mark one: __Daest(role = "size", null = 0).'
        )
    return _Entry(effect, model, across)


def _is_formula(model: EffectModel, inputs: Sequence[str]) -> bool:
    names = [x.name for x in model.unknowns]
    return sorted(names) == sorted(["u", "y", *inputs]) and model.equations[0].text.startswith(f"{OWN}y = ")


def _check_connectors(source: _Source, connectors: Sequence[str]) -> None:
    attach = source.entry("attach")
    wanted = 0 if attach in _SIGNALS else 1 if attach == "connector" else 2
    if len(connectors) != wanted:
        raise source.error(
            "attach",
            f'attach = "{attach}" needs {wanted} connectors, it has {len(connectors)}',
            "Physical connectors have the variables phi and tau, s and f, v and i, T and Q_flow, or p and q.",
        )


def _description(source: _Source) -> str:
    after_name = source.head.start + len(source.head.name.rpartition(".")[2])
    following = next(iter(tokens(source.text, after_name)))
    return following.text[1:-1] if following.kind == "text" else ""


def _parameter(parameter: Parameter, source: _Source) -> EffectParameter:
    annotation = _annotation_of(parameter)
    entries = {key: _value(node) for key, node in annotation.entries.items()}
    role = entries.get("role", "shape")
    if role not in _ROLES:
        raise annotation.error("role", f"role of `{parameter.name}`", f"Choose one of {', '.join(_ROLES)}.")
    signal_unit = entries.get("unit", "")
    if signal_unit not in _SIGNAL_UNITS:
        raise annotation.error(
            "unit",
            f"unit of `{parameter.name}`",
            'Write "u" for the unit of the signal, "u/s" for that per second, "1/u" for one over it, '
            '"1/(u.s)" for one over it per second; "z" and "1/z" are those of a variable that a parameter '
            "changes with.",
        )
    null = entries.get("null", 0 if role == "size" else None)
    grid = entries.get("grid", ())
    if not isinstance(grid, tuple) or any(not isinstance(v, int | float) for v in grid):
        raise annotation.error(
            "grid", f"grid = {text(annotation.entries['grid'])} is no list of numbers", "Write {0.1, 1}."
        )
    proof = entries.get("proof")
    if not isinstance(proof, int | float | None):
        raise annotation.error("proof", f"proof of `{parameter.name}` is no number", "Write proof = 0.1.")
    return EffectParameter(
        name=parameter.name,
        unit=parameter.unit,
        description=parameter.description,
        start=parameter.value,
        min=parameter.min,
        max=parameter.max,
        null=None if null is None else float(null),
        role=role,
        grid=tuple(float(v) for v in grid),
        given_from=str(entries.get("from", "")),
        scale_of=str(entries.get("of", "")),
        estimate=parameter.estimate,
        required=bool(entries.get("required", False)),
        signal_unit=signal_unit,
        periods_over=str(entries.get("periods", "")),
        proof=None if proof is None else float(proof),
    )


def _annotation_of(parameter: Parameter) -> Annotation:
    if parameter.place is None or parameter.place.line is None:
        return Annotation()
    content = read_source(Path(parameter.place.file))
    return annotation_of(parameter.place.file, content, offset_of(content, parameter.place))


def _own_states(model: EffectModel, parameters: Sequence[EffectParameter], signals: Sequence[str]) -> int:
    """How many variables are differentiated that the connectors, signals and their derivatives do not
    determine, without the sizes: where `v = R*x` and R = 0, v does not tell x."""
    n = len(model.unknowns)
    derivatives, xi = ca.SX.sym("d", n), ca.SX.sym("x", n)
    w, theta = ca.SX.sym("w", len(model.noises)), ca.SX.sym("p", len(model.parameters))
    residual = model.function(derivatives, xi, w, theta, ca.SX.sym("t"))[0]
    at_null = [p.start if p.null is None else p.null for p in parameters]
    both = ca.vertcat(xi, derivatives)
    rows = _variables_of(residual, both)
    rows_at_null = _variables_of(ca.substitute(residual, theta, ca.DM(at_null)), both)
    potentials = {c.potential for c in connectors_of(model.unknowns).values()}
    known = potentials | {i for i, unknown in enumerate(model.unknowns) if unknown.name in signals}
    known |= {i + n for i in known}
    while True:
        single = [
            left
            for used, used_at_null in zip(rows, rows_at_null, strict=True)
            if len(left := used - known) == 1 and left <= used_at_null
        ]
        found = {i for left in single for i in left if i < n} - known
        if not found:
            break
        known |= found | {i + n for i in found}
    differentiated = {column - n for used in rows for column in used if column >= n}
    return len({i for i in differentiated if i not in known})


def _variables_of(residual: ca.SX, variables: ca.SX) -> list[set[int]]:
    """Of each row of the residual the numbers of the variables in it."""
    pattern = ca.jacobian_sparsity(residual, variables)
    rows: list[set[int]] = [set() for _ in range(residual.numel())]
    for row, column in zip(pattern.row(), pattern.get_col(), strict=True):
        rows[row].add(column)
    return rows
