"""Modelica source to `FlatModel`: the public face of this room."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

from daest.errors import ModelError
from daest.model.flat import FlatModel
from daest.modelica.change import declare, with_values
from daest.modelica.compiling.compiler import Job, compile_source, modification, with_room
from daest.modelica.compiling.inner_values import with_inner_values
from daest.modelica.flat.assemble import assemble
from daest.modelica.flat.parameters import is_parameter
from daest.modelica.forms.bus_members import expandable_connectors
from daest.modelica.forms.constraining import (
    with_bases,
    with_common_bases,
    with_constrained_redeclarations,
    with_constraining_modifications,
)
from daest.modelica.forms.dialect import Names, adapted, with_named_classes, without_broken, without_quotes
from daest.modelica.forms.excerpt import adapted_text, excerpt, may_extend, with_modifications
from daest.modelica.forms.modifications import check_modifications
from daest.modelica.forms.operator_names import check_operator_names
from daest.modelica.forms.outer_variables import without_outer_variables
from daest.modelica.forms.package_aliases import with_imported_packages
from daest.modelica.forms.redeclarations import (
    with_default_packages,
    with_redeclared_components,
    with_redeclared_parts,
)
from daest.modelica.forms.sizes import with_integer_constants
from daest.modelica.language import failures
from daest.modelica.language import syntax as s
from daest.modelica.language.components import Classes
from daest.modelica.language.library import (
    Roots,
    chosen_libraries,
    library_entries,
    library_name,
    library_roots,
    readable_roots,
)
from daest.modelica.language.outline import class_heads, tokens
from daest.modelica.language.source import read_source, select_class
from daest.modelica.language.table_files import Folders

__all__ = ["compile_model", "compile_text", "declare", "with_values"]


def compile_model(
    path: str | Path,
    class_name: str | None = None,
    libraries: Sequence[str | Path] = (),
    overrides: Mapping[str, float] | None = None,
) -> FlatModel:
    """The equation list of a Modelica model.

    `class_name` may be left out when the file holds one model that is not partial, or one that the others are
    parts of. `libraries` are folders that contain libraries; MODELICAPATH and the bundled library are
    searched after them. `overrides` are parameter values; those of Integer, Boolean and structural
    parameters compile the model again. Raises ModelError.

        >>> flat = daest.compile_model("Servo.mo")
        >>> len(flat.equations), flat.output_names
        (65, ('omega', 'phi'))
    """
    path = Path(path)
    return compile_text(read_source(path), path, class_name, libraries, overrides)


def compile_text(
    text: bytes,
    path: Path,
    class_name: str | None = None,
    libraries: Sequence[str | Path] = (),
    overrides: Mapping[str, float] | None = None,
) -> FlatModel:
    """As `compile_model`, of a text that stands, or is going to stand, in file `path`. Raises what
    `compile_model` raises."""
    text, names = without_quotes(text)
    name = _chosen_class(text, names, path, class_name)
    text = with_own_forms(text, path, name)
    folders = library_roots(libraries)
    bases: dict[str, str] = {}
    while True:
        try:
            return _with_part(text, path, name, names, folders, overrides, bases)
        except failures.Unfitting as problem:
            part = _excerpt(folders, text, path, bases)
            if part is None or problem.name in bases:
                raise
            if not may_extend(text, part, problem.name, problem.wanted):
                raise
            bases[problem.name] = problem.wanted


def with_own_forms(text: bytes, path: Path, name: str) -> bytes:
    """The text with what its own classes alone decide as the compiler takes it; `name` is the class that is
    compiled. Raises ModelError for what the compiler would lose."""
    check_operator_names(text, path)
    text = with_integer_constants(with_imported_packages(text), _own_classes(text))
    text = _with_constraints(without_broken(text, path, name), path)
    return with_named_classes(text, path, name)


def _with_part(
    text: bytes,
    path: Path,
    name: str,
    names: Names,
    folders: Sequence[Path],
    overrides: Mapping[str, float] | None,
    bases: Mapping[str, str],
) -> FlatModel:
    """As `compile_text`, of class `name`, with the part of the libraries that it needs, or else with all of
    them; `bases` are further base classes of classes."""
    text = with_bases(text, bases)
    part = _excerpt(folders, text, path, bases)
    if part is not None:
        own = adapted_text(text, part) if part.folders else text
        job = Job(path, own, name, part, names=names)
        try:
            return with_room(lambda: _compile(job, dict(overrides or {})))
        except ModelError as problem:
            # What no file of the library declares is missing in the whole of it, too.
            if problem.code not in _MISSING or failures.is_missing_in_library(problem):
                raise
    text = with_own_modifications(text)
    whole = Job(path, text, name, readable_roots(folders, text, path), names=names)
    return with_room(lambda: _compile(whole, dict(overrides or {})))


def with_own_modifications(text: bytes) -> bytes:
    """The text with its modifications as the compiler takes them, as far as its own classes tell."""
    return with_modifications(text, _own_classes)


def _with_constraints(text: bytes, path: Path) -> bytes:
    """The text with what constraining classes say where the compiler does not see it."""
    text = with_redeclared_components(text, _own_classes(text))
    text = with_default_packages(text, _own_classes(text))
    text = with_redeclared_parts(text, path, _own_classes(text))
    text = with_common_bases(text, _own_classes(text)) if b"redeclare" in text else text
    text = with_constrained_redeclarations(text, path, _own_classes(text))
    return with_constraining_modifications(text)


def _own_classes(text: bytes) -> Classes:
    """The classes of the text alone."""
    own = {head.name for head in class_heads(text)}
    return Classes(lambda full: text if full in own else None)


# Errors that an excerpt of a library may cause by what it lacks.
_MISSING = ("model-unknown-class", "model-unknown-name", "model-kind")


def _excerpt(
    folders: Sequence[Path], text: bytes, path: Path, bases: Mapping[str, str] = MappingProxyType({})
) -> Roots | None:
    """The part of the libraries that the text needs; None where it uses all of the bundled one alone."""
    bundled = [folder for folder in folders if (folder / "Daest" / "package.mo").is_file()]
    others = [folder for folder in folders if folder not in bundled]
    entries = [entry for _, chosen, _ in chosen_libraries(others, text, path) for entry in chosen]
    known = {library_name(entry) for entry in entries}
    words = {token.text for token in tokens(text) if token.kind == "name"}
    if known & words:
        return excerpt(entries, bundled, text, path, bases)
    if adapted(with_own_modifications(text)) != text or expandable_connectors(text):
        return excerpt([], bundled, text, path)
    # A text that names no library is compiled in no time where the compiler has not to look at any.
    is_named = any(library_name(entry) in words for folder in bundled for entry in library_entries(folder))
    return None if is_named else Roots((), {})


def _chosen_class(text: bytes, names: Names, path: Path, wanted: str | None) -> str:
    """The class to compile. Of Base Modelica it is the model that is called as the package around it."""
    if not names.shown:
        return select_class(text, path, wanted)
    heads = class_heads(text)
    own = [head.name for head in heads if head.name == f"{heads[0].name}.{heads[0].name}" and head.is_model]
    only = own[0] if own else select_class(text, path, None)
    if wanted not in (None, names.model(only)):
        raise ModelError(
            "model-unknown-class",
            f"there is no model `{wanted}` in {path}",
            where=str(path),
            remedy=f"The file has: {names.model(only)}.",
        )
    return only


def _compile(job: Job, overrides: dict[str, float]) -> FlatModel:
    try:
        job, source = _settled(job)
        if not job.names.shown:
            check_modifications(source, job.text, job.class_name, str(job.path))
        flat = assemble(source, str(job.path))
        structural = _structural(source, flat, overrides)
        if structural:
            job, source = _settled(replace(job, modification=modification(structural)))
            flat = assemble(source, str(job.path))
    except RecursionError:
        raise ModelError(
            "model-nesting",
            "an expression or a chain of definitions nests too deeply",
            where=str(job.path),
            remedy="Split it over several variables.",
        ) from None
    return with_values(flat, {name: value for name, value in overrides.items() if name not in structural})


def _settled(job: Job) -> tuple[Job, s.FlatSource]:
    """The flat source of the job, in which `outer` components see what the `inner` ones are given."""
    source = compile_source(job)
    settled = with_inner_values(source, job)
    found = source if settled is job else compile_source(settled)
    return settled, replace(without_outer_variables(found), folders=_folders(job))


def _folders(job: Job) -> Folders:
    """Where the model's files with tables are: beside its file, in its own package, and in the libraries."""
    entries = [entry for folder in job.roots.folders for entry in library_entries(folder)]
    entries += job.roots.origins.values()
    own = [folder for folder in job.path.resolve().parents if (folder / "package.mo").is_file()]
    libraries = {library_name(one): one.parent if one.is_file() else one for one in (*entries, *own[-1:])}
    return Folders(job.path.parent, tuple(libraries.items()))


def _structural(source: s.FlatSource, flat: FlatModel, overrides: Mapping[str, float]) -> dict[str, str]:
    """Modelica text of the overrides that need another compilation: of parameters that stand in the
    equations as numbers. Raises ModelError for one that cannot be modified."""
    changeable = set(flat.parameter_names) | {p.name for p in flat.derived_parameters}
    variables = {x.name: x for x in source.variables if is_parameter(x)}
    return {
        name: _literal(variables[name], value)
        for name, value in overrides.items()
        if name in variables and name not in changeable
    }


def _literal(variable: s.FlatVariable, value: float) -> str:
    if variable.is_final or variable.variability == "constant" or "[" in variable.name or variable.dimensions:
        kind = (
            "final"
            if variable.is_final
            else "a constant"
            if variable.variability == "constant"
            else "an array"
        )
        raise ModelError(
            "parameter-fixed",
            f"`{variable.name}` is {kind} and cannot be set from outside",
            remedy="Change it in the model.",
        )
    if variable.type_name == "Boolean":
        return "true" if value else "false"
    if variable.type_name == "Integer" and not float(value).is_integer():
        raise ModelError(
            "parameter-fixed",
            f"`{variable.name}` is an Integer; {value:g} is none",
            remedy="Give a whole number.",
        )
    return str(int(value)) if variable.is_discrete else repr(float(value))
