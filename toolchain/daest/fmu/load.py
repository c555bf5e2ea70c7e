"""FMU -> FmuModel: read the description of a Model Exchange FMU (FMI 2.0 and 3.0), from any tool."""

from __future__ import annotations

import functools
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

from daest.errors import FmuError, printable
from daest.fmu import serialization
from daest.fmu.archive import open_archive
from daest.fmu.description import DAE_FOLDER, MANIFEST
from daest.model.flat import FlatModel
from daest.model.fmu import DaeManifest, FmuModel, FmuVariable, Residual

DESCRIPTION = "modelDescription.xml"
# Beyond these an XML document is not parsed: it would take longer than ten seconds. 600 000 tags are about
# 170 000 variables of FMI 2.
MOST_TAGS = 600_000
LONGEST_TAG = 2 * 1024**2
_SHOWN_NAMES = 10  # of variables that are left out
_LIBRARY_SUFFIXES = (".so", ".dll", ".dylib")
# Which of several variables with one value reference gives its name to them all.
_RANK = {"output": 0, "input": 1, "parameter": 2, "calculatedParameter": 3, "local": 4, "independent": 5}
# Defaults of FMI where the file says nothing.
_VARIABILITY = {"parameter": "fixed", "calculatedParameter": "fixed", "structuralParameter": "fixed"}


def load_fmu(path: str | Path) -> FmuModel:
    """What the FMU at `path` says about itself. Validator messages do not matter here; what is used is
    checked.

    Errors (FmuError): those of `open_archive`; `fmu-without-description`; `fmu-xml` (not well-formed, or with
    a document type, which only attacks need); `fmu-fmi-1`; `fmu-version`; `fmu-scheduled-only`;
    `fmu-array-variable`; `fmu-clocked`; `fmu-inconsistent`.

        >>> daest.load_fmu("Servo.fmu").model_name
        'Servo'
    """
    with open_archive(path) as archive:
        if DESCRIPTION not in archive.names:
            raise FmuError(
                "fmu-without-description",
                f"The archive has no {DESCRIPTION}, so it is no FMU.",
                where=str(path),
                remedy="Export it again.",
            )
        manifest_name = f"{DAE_FOLDER}/{MANIFEST}"
        manifest = archive.read(manifest_name) if manifest_name in archive.names else None
        return _described(str(path), tuple(archive.names), archive.read(DESCRIPTION), manifest)


@functools.lru_cache(maxsize=2)
def _described(path: str, names: tuple[str, ...], description: bytes, manifest: bytes | None) -> FmuModel:
    """The model of an archive with these members. One command asks several times, and a hundred thousand
    variables take a second each time."""
    root = parse_xml(description, f"{path}:{DESCRIPTION}")
    model = _model(Path(path), root, names)
    if manifest is None:
        return model
    return replace(model, manifest=_manifest(parse_xml(manifest, f"{path}:{DAE_FOLDER}/{MANIFEST}"), root))


def symbolic_model(path: str | Path) -> FlatModel | None:
    """The symbolic model that travels inside an FMU of `daest export`; None if there is none.

    FmuError `symbolic-model-damaged` if it is there and cannot be trusted.

        >>> daest.symbolic_model("Servo.fmu").name
        'Servo'
    """
    with open_archive(path) as archive:
        names = {
            name: f"{serialization.FOLDER}/{name}"
            for name in (serialization.WORDS, serialization.EXPRESSIONS)
        }
        if not set(names.values()) <= set(archive.names):
            return None
        texts = {name: archive.text(member, serialization.LARGEST_FILE) for name, member in names.items()}
    return serialization.deserialize(texts, str(path))


def parse_xml(data: bytes, where: str) -> ET.Element:
    """The root of an XML document without document type (entities could name files or grow without end) that
    is not made to keep its reader busy. FmuError `fmu-xml`, `fmu-too-large`."""
    _check_bulk(data, where)
    parser = ET.XMLParser(target=_Tree(where))
    try:
        parser.feed(data)
        return parser.close()
    except (ET.ParseError, ValueError, LookupError) as problem:
        raise FmuError(
            "fmu-xml", f"The XML is not well-formed: {problem}.", where=where, remedy="Export the FMU again."
        ) from problem


class _Tree(ET.TreeBuilder):
    def __init__(self, where: str) -> None:
        super().__init__()
        self._where = where

    def doctype(self, *_: object) -> None:
        raise FmuError("fmu-xml", "The XML declares a document type, which no FMU needs.", where=self._where)


def _check_bulk(data: bytes, where: str) -> None:
    """Refuse what would be parsed for minutes: too many elements, or one that goes on and on."""
    n_tags, longest = data.count(b"<"), max(map(len, data.split(b"<", MOST_TAGS)))
    if n_tags <= MOST_TAGS and longest <= LONGEST_TAG:
        return
    what = f"{n_tags} tags" if n_tags > MOST_TAGS else f"a tag, comment or text of {longest} bytes"
    raise FmuError(
        "fmu-too-large",
        f"The XML has {what}; {MOST_TAGS} tags of up to {LONGEST_TAG} bytes are read.",
        where=where,
        remedy="Export the FMU with the variables of interest alone: tools can leave out protected ones.",
    )


# ------------------------------------------------------------------------------------------- the model


def _model(path: Path, root: ET.Element, names: Sequence[str]) -> FmuModel:
    version = root.get("fmiVersion", "")
    _check_version(path, root, version)
    exchange, kind = _interface(root, path)
    reader = _read_fmi2 if version.startswith("2") else _read_fmi3
    variables, rates, notes = reader(root, path)
    _check_names(variables, path)
    merged = _merge(variables)
    if kind == "co-simulation":
        rates = ()  # what it says about states cannot be set or read
    _check_rates(rates, variables, path)
    states = tuple(merged[rate].derivative_of for rate in rates)
    identifier = exchange.get("modelIdentifier", "")
    provides = exchange.get(
        "providesDirectionalDerivatives", exchange.get("providesDirectionalDerivative", "false")
    )
    symbolic = {f"{serialization.FOLDER}/{n}" for n in (serialization.WORDS, serialization.EXPRESSIONS)}
    return FmuModel(
        path=path,
        fmi_version=version,
        model_name=printable(root.get("modelName", "")),
        model_identifier=identifier,
        token=root.get("instantiationToken", root.get("guid", "")),
        variables=merged,
        states=tuple(s for s in states if s is not None),
        derivatives=rates,
        inputs=_with_causality(merged, "input"),
        outputs=_with_causality(merged, "output"),
        parameters=_with_causality(merged, "parameter"),
        platforms=_platforms(names, identifier),
        provides_directional_derivatives=provides in ("true", "1"),
        n_event_indicators=_event_indicators(root),
        manifest=None,
        has_symbolic_model=symbolic <= set(names),
        notes=notes,
        kind=kind,
        reports_steps=_reports_steps(exchange, version),
        only_once=exchange.get("canBeInstantiatedOnlyOncePerProcess", "false") in ("true", "1"),
    )


def _interface(root: ET.Element, path: Path) -> tuple[ET.Element, Literal["exchange", "co-simulation"]]:
    """Model Exchange where the FMU has it, else Co-Simulation."""
    exchange, simulation = root.find("ModelExchange"), root.find("CoSimulation")
    if exchange is not None:
        return exchange, "exchange"
    if simulation is not None:
        return simulation, "co-simulation"
    raise FmuError(
        "fmu-scheduled-only",
        "The FMU offers neither Model Exchange nor Co-Simulation.",
        where=str(path),
        remedy="Export it for Model Exchange.",
    )


def _reports_steps(exchange: ET.Element, version: str) -> bool:
    if version.startswith("2"):
        return exchange.get("completedIntegratorStepNotNeeded", "false") not in ("true", "1")
    return exchange.get("needsCompletedIntegratorStep", "false") in ("true", "1")


def _check_version(path: Path, root: ET.Element, version: str) -> None:
    if version.startswith("1"):
        raise FmuError(
            "fmu-fmi-1",
            "The FMU is of FMI 1.0, which has no derivatives with respect to inputs and states.",
            where=str(path),
            remedy="Export it as FMI 2.0 or 3.0 for Model Exchange.",
        )
    # Drafts (3.0-beta.3) name their functions otherwise.
    if root.tag != "fmiModelDescription" or not re.fullmatch(r"[23]\.\d+(\.\d+)?", version):
        raise FmuError(
            "fmu-version",
            f"FMI version `{printable(version)}` is not known.",
            where=str(path),
            remedy="Use FMI 2.0 or 3.0.",
        )


def _event_indicators(root: ET.Element) -> int:
    told = root.get("numberOfEventIndicators", "")
    return int(told) if _is_count(told) else len(root.findall("ModelStructure/EventIndicator"))


def _platforms(names: Iterable[str], identifier: str) -> tuple[str, ...]:
    """Folders below binaries/ that really hold the library: some FMUs carry an empty one."""
    found = set()
    for name in names:
        parts = name.split("/")
        if (
            len(parts) == 3
            and parts[0] == "binaries"
            and parts[2] in {identifier + s for s in _LIBRARY_SUFFIXES}
        ):
            found.add(parts[1])
    return tuple(sorted(found))


def _with_causality(variables: Mapping[int, FmuVariable], causality: str) -> tuple[int, ...]:
    return tuple(vr for vr, v in variables.items() if v.causality == causality)


def _merge(variables: Iterable[FmuVariable]) -> dict[int, FmuVariable]:
    """One variable per value reference: the one of highest rank, with the other names as aliases."""
    groups: dict[int, list[FmuVariable]] = {}
    for variable in variables:
        groups.setdefault(variable.value_reference, []).append(variable)
    return {reference: _merged(group) for reference, group in groups.items()}


def _merged(group: Sequence[FmuVariable]) -> FmuVariable:
    if len(group) == 1:
        return group[0]
    first, *others = sorted(group, key=lambda v: _RANK.get(v.causality, len(_RANK)))
    annotations: dict[str, str] = {}
    for variable in reversed((first, *others)):
        annotations |= variable.annotations
    return replace(
        first,
        aliases=(*first.aliases, *(name for v in others for name in (v.name, *v.aliases))),
        derivative_of=next((v.derivative_of for v in (first, *others) if v.derivative_of is not None), None),
        start=next((v.start for v in (first, *others) if v.start is not None), None),
        unit=next((v.unit for v in (first, *others) if v.unit), ""),
        nominal=next((v.nominal for v in (first, *others) if v.nominal), None),
        annotations=annotations,
    )


def _check_names(variables: Iterable[FmuVariable], path: Path) -> None:
    """Each name belongs to one variable: otherwise nobody could say which one a recording is of."""
    known: dict[str, int] = {}
    for variable in variables:
        for name in (variable.name, *variable.aliases):
            if known.setdefault(name, variable.value_reference) != variable.value_reference or not name:
                what = f"two variables are called `{name}`" if name else "a variable has no name"
                raise FmuError(
                    "fmu-inconsistent",
                    f"In the FMU {what}.",
                    where=str(path),
                    remedy="Report it to the tool that wrote the FMU, and export it again.",
                )


# ------------------------------------------------------------------------------------------- variables


def _read_fmi3(root: ET.Element, path: Path) -> tuple[list[FmuVariable], tuple[int, ...], tuple[str, ...]]:
    types = {t.get("name"): t for t in root.findall("TypeDefinitions/Float64Type")}
    clocks = _own_clocks(root, path)
    variables, skipped = [], []
    rates = tuple(
        _integer(e, "valueReference", path) for e in root.findall("ModelStructure/ContinuousStateDerivative")
    )
    for element in root.findall("ModelVariables/Float64"):
        variable = _variable(element, element, types, path)
        if element.find("Dimension") is not None or element.get("clocks"):
            if variable.value_reference in rates or variable.causality in ("input", "output"):
                raise FmuError(
                    "fmu-array-variable",
                    f"`{variable.name}` is an array or clocked; only scalar continuous ones can be used.",
                    where=str(path),
                    remedy="Export the FMU with scalar variables.",
                )
            skipped.append(variable.name)
            continue
        aliases = tuple(printable(a.get("name", "")) for a in element.findall("Alias"))
        variables.append(replace(variable, aliases=aliases))
    notes = [f"array or clocked variables of the FMU are left out: {_listed(skipped)}"] if skipped else []
    if clocks:
        notes.append(f"the FMU ticks its clocks by itself, as events: {_listed(clocks)}")
    return variables, rates, tuple(notes)


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:_SHOWN_NAMES]) + (", ..." if len(names) > _SHOWN_NAMES else "")


def _own_clocks(root: ET.Element, path: Path) -> list[str]:
    """Names of the clocks that the FMU ticks by itself, which tell of its events. Those that the importer has
    to tick are refused: what belongs to them would stand still."""
    clocks = root.findall("ModelVariables/Clock")
    for clock in clocks:
        if clock.get("causality") == "input" or clock.get("intervalVariability") not in (None, "triggered"):
            raise FmuError(
                "fmu-clocked",
                f"`{printable(clock.get('name', ''))}` is a clock that somebody else has to tick, which "
                "daest does not.",
                where=str(path),
                remedy="Export the FMU without clocks: with sampling inside, or continuous.",
            )
    return [printable(clock.get("name", "")) for clock in clocks]


def _read_fmi2(root: ET.Element, path: Path) -> tuple[list[FmuVariable], tuple[int, ...], tuple[str, ...]]:
    """FMI 2 counts variables from 1 in its structure; references are per type, and only Real ones matter."""
    types = {t.get("name"): t.find("Real") for t in root.findall("TypeDefinitions/SimpleType")}
    scalars = root.findall("ModelVariables/ScalarVariable")
    by_index: dict[int, FmuVariable] = {}
    for index, element in enumerate(scalars, start=1):
        real = element.find("Real")
        if real is not None:
            by_index[index] = _variable(element, real, types, path)
    for index, variable in by_index.items():
        if variable.derivative_of is not None:
            state = by_index.get(variable.derivative_of)
            by_index[index] = replace(variable, derivative_of=state.value_reference if state else None)
    unknowns = root.findall("ModelStructure/Derivatives/Unknown")
    rates = tuple(
        by_index[i].value_reference for u in unknowns if (i := _integer(u, "index", path)) in by_index
    )
    return list(by_index.values()), rates, ()


def _check_rates(rates: tuple[int, ...], variables: Iterable[FmuVariable], path: Path) -> None:
    present = {v.value_reference for v in variables}
    known = {v.value_reference for v in variables if v.derivative_of in present}
    missing = [vr for vr in rates if vr not in known]
    if missing:
        raise FmuError(
            "fmu-inconsistent",
            f"The state derivative with value reference {missing[0]} names no state.",
            where=str(path),
            remedy="Report it to the tool that wrote the FMU.",
        )


def _variable(
    element: ET.Element, real: ET.Element, types: Mapping[str | None, ET.Element | None], path: Path
) -> FmuVariable:
    declared = types.get(real.get("declaredType"))

    def attribute(key: str) -> str | None:
        value = real.get(key)
        return declared.get(key) if value is None and declared is not None else value

    causality = element.get("causality", "local")
    derivative = real.get("derivative")
    return FmuVariable(
        name=printable(element.get("name", "")),
        value_reference=_integer(element, "valueReference", path),
        causality=causality,
        variability=element.get("variability", _VARIABILITY.get(causality, "continuous")),
        initial=element.get("initial"),
        unit=printable(attribute("unit") or ""),
        description=printable(element.get("description", "")),
        start=_number(real.get("start")),
        min=_number(attribute("min")),
        max=_number(attribute("max")),
        nominal=_number(attribute("nominal")) or None,
        derivative_of=int(derivative) if derivative and _is_count(derivative) else None,
        annotations=_annotations(element),
    )


def _annotations(element: ET.Element) -> dict[str, str]:
    if element.find("Annotations") is None:  # which is asked in no time
        return {}
    return {a.get("type", ""): a.text or "" for a in element.findall("Annotations/Annotation")}


def _is_count(text: str) -> bool:
    """A number that FMI allows as value reference, index or count: 32 bits, digits of ASCII."""
    return text.isascii() and text.isdigit() and len(text) <= 10 and int(text) < 2**32


def _integer(element: ET.Element, key: str, path: Path) -> int:
    text = element.get(key, "")
    if not _is_count(text):
        name = printable(element.get("name") or element.tag)
        raise FmuError(
            "fmu-inconsistent",
            f"`{name}` has no valid {key}.",
            where=str(path),
            remedy="Export the FMU again.",
        )
    return int(text)


def _number(text: str | None) -> float | None:
    """The number, or None where there is none or a list (arrays)."""
    try:
        return float(text) if text is not None else None
    except ValueError:
        return None


# -------------------------------------------------------------------------------------------- fmi-ls-dae


def _manifest(manifest: ET.Element, description: ET.Element) -> DaeManifest:
    """The manifest in any of the shapes of the drafts: with and without namespace and `Formulation`
    elements.
    """
    for element in manifest.iter():
        element.tag = element.tag.rpartition("}")[2]
    version = next((v for k, v in manifest.attrib.items() if k.endswith("fmi-ls-version")), "")
    algebraic = tuple(
        _references(e.get("valueReference"))[0]
        for e in manifest.iter("AlgebraicVariable")
        if e.get("valueReference")
    )
    residuals = []
    for element in manifest.findall("ModelStructure/Residual"):
        # Several formulations are the same equation, differentiated; the first is the equation itself.
        formulation = element.find("Formulation")
        chosen = formulation if formulation is not None else element
        references = _references(chosen.get("valueReference"))
        if references:
            known = chosen.get("dependencies")
            residuals.append(Residual(references[0], None if known is None else _references(known)))
    return DaeManifest(
        version=version,
        enable=_enable(manifest, description),
        algebraic=algebraic,
        residuals=tuple(residuals),
        derivatives=tuple(
            r
            for e in manifest.findall("ModelStructure/ContinuousStateDerivative")
            for r in _references(e.get("valueReference"))
        ),
    )


def _references(text: str | None) -> tuple[int, ...]:
    return tuple(int(r) for r in re.findall(r"\b[0-9]{1,10}\b", text or ""))


def _enable(manifest: ET.Element, description: ET.Element) -> int | None:
    """The value reference of the switch: an element since August 2026, before that an attribute with its
    name.
    """
    for tag in ("EnableDAEParameter", "EnableDAE"):
        element = manifest.find(tag)
        if element is not None:
            references = _references(element.get("valueReference"))
            return references[0] if references else None
    named = next((v for k, v in manifest.attrib.items() if k.endswith("enableDAEModeVariable")), None)
    if named is None:
        return None
    for boolean in description.findall("ModelVariables/Boolean"):
        if named in (boolean.get("name"), boolean.get("valueReference")):
            references = _references(boolean.get("valueReference"))
            return references[0] if references else None
    return None
