"""Values that an `inner` component gives to its parameters, written into its class.

The compiler decides `if` equations, sizes and conditional components by the parameters of an `outer`
component. It takes their values from the declaration in the class and does not see how the `inner` component
is modified: with `inner System system(dynamics = Dynamics.SteadyState)` the default of `dynamics` decides,
without a word. So the defaults of Boolean, Integer and enumeration parameters are replaced by the values that
the model gives, in the text that the compiler reads, and the model is compiled again.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import takewhile
from pathlib import Path

from daest.cache import cache_folder
from daest.errors import ModelError
from daest.modelica.compiling.compiler import Job
from daest.modelica.flat.parameters import is_parameter
from daest.modelica.flat.reading import Reading
from daest.modelica.language import syntax as s
from daest.modelica.language.components import expression_end
from daest.modelica.language.library import Roots, kept_folder, library_entries, stamp, write_file
from daest.modelica.language.outline import NO_CODE, closing, place_of, tokens

_OUTER = re.compile(rb"\bouter\s+(?:(?:replaceable|parameter)\s+)?\.?[A-Za-z_][\w.]*\s+([A-Za-z_]\w*)")


@dataclass(frozen=True)
class _Default:
    """The value of a parameter in its declaration: bytes `start` to before `end` of a source, both behind the
    name where it has none, and what it is to be."""

    source: int
    start: int
    end: int
    value: str


def with_inner_values(source: s.FlatSource, job: Job) -> Job:
    """The job with the values of `inner` components as defaults of their classes; `job` itself where they are
    that already. Raises ModelError `model-inner` where two components of one class have different values."""
    shared = _outer_names(source)
    given = [x for x in source.variables if _is_of(x, shared)] if shared else []
    changed = [x for x in given if _is_modified(x, source)]
    if not changed:
        return job
    edits: dict[tuple[int, int], _Default] = {}
    reading = Reading(source)
    for variable in changed:
        value = _literal(variable, source, reading)
        if value is None or _says(variable, source, value):
            continue
        _refuse_another(variable, value, source, reading)
        found = _default(variable, source, value)
        edits[found.source, found.start] = found
    return _edited(job, source, sorted(edits.values(), key=lambda one: -one.start)) if edits else job


def _outer_names(source: s.FlatSource) -> frozenset[str]:
    """Names of the components that some class declares as `outer`."""
    texts = (text for _, text in source.texts.values() if b"outer" in text)
    return frozenset(name.decode() for text in texts for name in _OUTER.findall(NO_CODE.sub(b" ", text)))


def _is_of(variable: s.FlatVariable, shared: frozenset[str]) -> bool:
    """Whether the variable is a Boolean, Integer or enumeration parameter of an `inner` component."""
    if not is_parameter(variable) or not variable.is_discrete or variable.type_name == "String":
        return False
    component = variable.name.rpartition(".")[0].rpartition(".")[2]
    return component in shared and not variable.dimensions and variable.span is not None


def _is_modified(variable: s.FlatVariable, source: s.FlatSource) -> bool:
    """Whether the value stands elsewhere than in the declaration."""
    at = getattr(variable.binding, "span", None)
    declared = variable.span
    if at is None or declared is None or declared.source not in source.texts:
        return False
    start, end = _value_range(source.texts[declared.source][1], declared.end)
    return not (at.source == declared.source and start <= at.start and at.end <= end)


def _value_range(text: bytes, behind: int) -> tuple[int, int]:
    """Where the value of a declaration stands whose name ends at `behind`; empty where there is none."""
    words = list(takewhile(lambda word: word.text != ";", tokens(text, behind)))
    at = closing(words, 0) if words and words[0].text == "(" else 0
    if at >= len(words) or words[at].text != "=":
        end = words[at - 1].end if at else behind
        return end, end
    return words[at].end, words[expression_end(words, at + 1) - 1].end


def _default(variable: s.FlatVariable, source: s.FlatSource, value: str) -> _Default:
    assert variable.span is not None
    number = variable.span.source
    start, end = _value_range(source.texts[number][1], variable.span.end)
    return _Default(number, start, end, value)


def _says(variable: s.FlatVariable, source: s.FlatSource, value: str) -> bool:
    """Whether the declaration has this value already; of a literal the end of its name is enough."""
    found = _default(variable, source, value)
    written = re.sub(rb"\s", b"", source.texts[found.source][1][found.start : found.end]).decode()
    return bool(written) and f".{value}".endswith(f".{written.removeprefix('.')}")


def _literal(variable: s.FlatVariable, source: s.FlatSource, reading: Reading) -> str | None:
    """The value as Modelica text; None where it cannot be told without the start of a simulation."""
    if variable.type_name not in ("Boolean", "Integer"):
        return _enumerated(variable, source)
    try:
        value = reading.numeric.lookup(variable.name)
    except ModelError:
        return None
    if not isinstance(value, bool | int | float):
        return None
    return ("true" if value else "false") if variable.type_name == "Boolean" else str(int(value))


def _enumerated(variable: s.FlatVariable, source: s.FlatSource) -> str | None:
    """The literal that a chain of parameters leads to."""
    by_name = {x.name: x for x in source.variables}
    node = variable.binding
    for _ in range(len(by_name)):
        if not isinstance(node, s.Name) or node.subscripts:
            return None
        if node.name in source.literals:
            return node.name
        if node.name not in by_name:
            return None
        node = by_name[node.name].binding
    return None


def _refuse_another(variable: s.FlatVariable, value: str, source: s.FlatSource, reading: Reading) -> None:
    """Raises ModelError where another component of the class has another value than this one."""
    for other in source.variables:
        if other.span != variable.span or other.name == variable.name:
            continue
        if _literal(other, source, reading) != value:
            file, text = source.texts[variable.span.source] if variable.span else ("", b"")
            raise ModelError(
                "model-inner",
                f"`{variable.name}` = {value}, `{other.name}` is another: of a parameter that `outer` "
                "components read the compiler that is built in knows one value in a class",
                where=place_of(file, text, variable.span.end if variable.span else 0),
                remedy="Copy the class under another name for one of the two, or give both the same value.",
            )


# The text that is compiled ----------------------------------------------------------------------------------


def _edited(job: Job, source: s.FlatSource, edits: Sequence[_Default]) -> Job:
    """The job with the edits, of which the last in a file comes first."""
    roots, text = job.roots, job.text
    by_file: dict[Path, bytes] = {}
    for edit in edits:
        name, known = source.texts[edit.source]
        if edit.source in source.own:
            text = _replaced(text, edit)
        else:
            file = job.roots.readable(Path(name))
            by_file[file] = _replaced(by_file.get(file, known), edit)
    for folder in job.roots.folders:
        inside = {file: made for file, made in by_file.items() if file.is_relative_to(folder)}
        roots = _with_files(roots, folder, inside) if inside else roots
    return replace(job, text=text, roots=roots)


def _replaced(text: bytes, edit: _Default) -> bytes:
    """The text with the value; lines keep their numbers."""
    old = text[edit.start : edit.end]
    sign = b"" if old else b" ="
    return (
        text[: edit.start] + sign + b" " + edit.value.encode() + b"\n" * old.count(b"\n") + text[edit.end :]
    )


def _with_files(roots: Roots, folder: Path, changed: Mapping[Path, bytes]) -> Roots:
    """The roots with a copy of `folder` in which files are `changed`."""
    digest = hashlib.sha256(stamp([folder]).encode())
    for file, text in sorted(changed.items()):
        digest.update(str(file).encode() + b"\0" + text)
    root = cache_folder() / "libraries" / f"inner-{digest.hexdigest()[:32]}"

    def fill(draft: Path) -> None:
        for file in [*folder.rglob("*.mo"), *folder.rglob("package.order")]:
            write_file(draft / file.relative_to(folder), changed.get(file) or file.read_bytes())

    kept_folder(root, fill)
    origins: dict[str, Path] = {}
    for made, entry in roots.origins.items():
        is_inside = Path(made).is_relative_to(folder)
        origins[str(root / Path(made).relative_to(folder)) if is_inside else made] = entry
    for entry in library_entries(folder):
        origins.setdefault(str(root / entry.relative_to(folder)), entry)
    return replace(
        roots, folders=tuple(root if one == folder else one for one in roots.folders), origins=origins
    )
