"""A parameter opened for effects: the text of a model changed so that its equations use the parameter through
a variable, whose binding a class that extends it replaces.

The parameter may be one of the model, an element of an array (the whole array gets a variable), a field of a
record, or one of a component whose class stands in the same file (`own_copies` puts it there): the class of
that component gets the variable, `Real k_used = k`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence

import casadi as ca

from daest.errors import Place
from daest.model.flat import FlatModel
from daest.model.parts import DerivedParameter, Parameter
from daest.modelica.effects.attach import free_name, names_of
from daest.modelica.effects.opened import NotOpened, all_uses, class_at, declared_first, used_declaration
from daest.modelica.language.outline import Edit, Token, closing, edited, offset_of

_LOCAL = re.compile(r"([A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*)(\[[\d,]+\])?")
_SUBSCRIPTS = re.compile(r"\[[\d,]+\]")


def aliases(flat: FlatModel, name: str) -> list[str]:
    """The parameter, and those of components that are it, as `tank.k` of `Tank tank(k = k)`; none where
    something else is computed from it."""
    symbol, values = _symbol(flat, name), ca.vertsplit(flat.derived_values)
    derived = [p for p in zip(flat.derived_parameters, values, strict=True) if ca.depends_on(p[1], symbol)]
    is_alone = all(ca.is_equal(value, symbol) for _, value in derived)
    return [name, *(p.name for p, _ in derived)] if is_alone else []


def opened_parameter(source: bytes, flat: FlatModel, name: str, alias: str) -> tuple[bytes, str] | None:
    """The text whose equations use the parameter `name`, or an alias of it, through a variable, and the name
    of that without subscripts, `tank.k_used` for `tank[2].k`. A modification `(k = k)` stays where the
    parameter has aliases. None where no equation of its class uses it, or that stands in another file. Raises
    NotOpened."""
    owner = owner_of(flat, name, alias)
    known = _LOCAL.fullmatch(alias.removeprefix(f"{owner}.") if owner else alias)
    if known is None or ("." in known[1] and known[2]):
        raise NotOpened("is a field of an array of records, or an element of one")
    local, is_element = known[1], bool(known[2])
    known_as: list[Parameter | DerivedParameter] = [*flat.parameters, *flat.derived_parameters]
    symbol = next(p for p in known_as if p.name == alias)
    place = symbol.place if "." not in local else _place_of_use(flat, name, owner)
    if place is None or place.file != flat.source:
        return None
    start = offset_of(source, place)
    head, words = class_at(source, start)
    uses = all_uses(source, head, words, local, -1 if "." in local else start)
    if len(aliases(flat, name)) > 1:
        uses = [use for use in uses if not _is_modification(source, use)]
    if not uses:
        return None
    used = free_name(f"{local.replace('.', '_')}_used", _names_in(flat, owner))
    line = used_declaration(used, local, symbol.unit, _sizes(source, words, start) if is_element else "")
    edits = [Edit(use.start, use.end, used) for use in uses]
    text = edited(source, [*edits, declared_first(source, words, line)])
    return text, f"{without_subscripts(owner)}.{used}" if owner else used


def is_used_otherwise(flat: FlatModel, name: str, variables: Iterable[str]) -> bool:
    """Whether anything but the bindings of the `variables` (without subscripts) depends on the parameter."""
    allowed = set(variables)
    by = {without_subscripts(flat.equations[row].text.partition(" = ")[0]) for row in _rows(flat, name)}
    return not by <= allowed or bool(ca.depends_on(flat.output_expressions, _symbol(flat, name)))


def without_subscripts(name: str) -> str:
    """`wall.R` of `wall[2].R[1]`: what a modification changes as a whole."""
    return _SUBSCRIPTS.sub("", name)


def _symbol(flat: FlatModel, name: str) -> ca.SX:
    return flat.theta[flat.parameter_names.index(name)]


def _rows(flat: FlatModel, name: str) -> list[int]:
    return sorted(set(ca.jacobian_sparsity(flat.residual, _symbol(flat, name)).row()))


def owner_of(flat: FlatModel, name: str, alias: str) -> str:
    """The innermost component around an alias of the parameter whose equations use it; empty for none."""
    found = (_common(flat.equations[row].origin, alias) for row in _rows(flat, name))
    return max(found, key=len, default="")


def _common(origin: str, name: str) -> str:
    """The component that an equation of `origin` and a parameter share."""
    shared: list[str] = []
    for part, other in zip(origin.split("."), name.split(".")[:-1], strict=False):
        if part != other:
            break
        shared.append(part)
    return ".".join(shared)


def _place_of_use(flat: FlatModel, name: str, owner: str) -> Place | None:
    """Where a class uses a field of one of its records: an equation of the component, or an output."""
    symbol = _symbol(flat, name)
    places = [flat.equations[row].place for row in _rows(flat, name) if flat.equations[row].origin == owner]
    outputs = zip(flat.outputs, ca.vertsplit(flat.output_expressions), strict=True)
    places += [y.place for y, expression in outputs if not owner and ca.depends_on(expression, symbol)]
    return places[0] if places else None


def _is_modification(source: bytes, use: Token) -> bool:
    """Whether it is the whole of what an argument is given, `tank(k = k)`."""
    before = re.search(rb"[(,]\s*(?:each\s+|final\s+)*\w+\s*=\s*$", source[: use.start]) is not None
    return before and source[use.end :].lstrip()[:1] in (b",", b")")


def _names_in(flat: FlatModel, owner: str) -> Iterator[str]:
    """The names that the class of a component, or the model, declares."""
    if not owner:
        yield from names_of(flat)
    within = f"{owner}."
    parameters = (*flat.parameter_names, *(p.name for p in flat.derived_parameters))
    for name in (*flat.unknown_names, *parameters, *(e.origin for e in flat.equations)):
        if name.startswith(within):
            yield without_subscripts(name.removeprefix(within).partition(".")[0])


def _sizes(source: bytes, words: Sequence[Token], start: int) -> str:
    """`[n]` of the declaration `R[n]` at byte `start`."""
    at = next(i for i, word in enumerate(words) if word.start == start) + 1
    if words[at].text != "[":
        raise NotOpened("is an element of an array that the type declares")
    return source[words[at].start : words[closing(words, at) - 1].end].decode()
