"""modelDescription.xml and the manifests of an exported FMU."""

from __future__ import annotations

import dataclasses
import json
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from typing import Any

import casadi as ca
import numpy as np

from daest.fmu.layout import (
    DAE_MODE,
    DAE_MODE_NAME,
    INDICATOR_NAME,
    RESIDUAL_NAME,
    TIME,
    Layout,
    derivative_name,
)
from daest.fmu.sources import WRAPPER
from daest.fmu.units import base_unit, derivative_unit

DAE_FOLDER = "extra/org.fmi-standard.fmi-ls-dae"
DAE_VERSION = "1.0.0-alpha.1"
MANIFEST = "fmi-ls-manifest.xml"
MANIFEST_NAMESPACE = "http://fmi-standard.org/fmi-ls-manifest"

# Vendor annotations: what FMI has no attribute for, as JSON.
EQUATION, INPUT, NOISE, PARAMETER, OUTPUT, UNKNOWN = (
    "daest.equation",
    "daest.input",
    "daest.noise",
    "daest.parameter",
    "daest.output",
    "daest.unknown",
)

_QUOTED = r"'(?:[A-Za-z0-9_!#$%&()*+,\-./:;<>=?@\[\]^{}|~ ]|\\['\"?\\abfnrtv])+'"
_PART = rf"(?:[A-Za-z_][A-Za-z0-9_]*|{_QUOTED})(?:\[\d+(?:,\d+)*\])?"
_PATH = rf"{_PART}(?:\.{_PART})*"
_STRUCTURED = re.compile(rf"{_PATH}|der\({_PATH}(?:,\d+)?\)")
_FORBIDDEN = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def model_identifier(name: str) -> str:
    """The last part of the model name as a C identifier: the name of the library."""
    identifier = re.sub(r"[^A-Za-z0-9_]", "_", name.rsplit(".", 1)[-1]) or "model"
    return identifier if not identifier[0].isdigit() else f"_{identifier}"


# ------------------------------------------------------------------------------------------- variables


def _float(parent: ET.Element, name: str, reference: int, **attributes: Any) -> ET.Element:
    """A Float64 variable; attributes that are None or empty are left out."""
    element = ET.SubElement(parent, "Float64", name=name, valueReference=str(reference))
    for key, value in attributes.items():
        if value not in (None, ""):
            element.set(key, repr(float(value)) if isinstance(value, (int, float)) else _clean(str(value)))
    return element


def _clean(text: str) -> str:
    """XML has no way to write control characters."""
    return _FORBIDDEN.sub("?", text)


def _annotate(element: ET.Element, kind: str, facts: dict[str, Any]) -> None:
    """Keep the facts that differ from nothing at all, as JSON in a vendor annotation."""
    told = {
        key: value for key, value in facts.items() if value is not None and value is not False and value != ""
    }
    if told:
        annotations = element.find("Annotations")
        if annotations is None:
            annotations = ET.SubElement(element, "Annotations")
        annotation = ET.SubElement(annotations, "Annotation", type=kind)
        annotation.text = _clean(json.dumps(told, ensure_ascii=False))


def _place(item: Any) -> dict[str, Any] | None:
    """The source line of a variable or equation."""
    return {k: v for k, v in dataclasses.asdict(item.place).items() if v is not None} if item.place else None


def _bounds(item: Any) -> dict[str, Any]:
    nominal = abs(item.nominal) if item.nominal else None
    return {"unit": item.unit, "min": item.min, "max": item.max, "nominal": nominal}


def _variables(layout: Layout, state_start: np.ndarray) -> ET.Element:
    parent = ET.Element("ModelVariables")
    _float(
        parent, "time", TIME, causality="independent", variability="continuous", unit="s", description="Time"
    )
    has_events = layout.flat.events is not None
    if not has_events:
        _add_dae_switch(parent)
    start = dict(zip(layout.states, (float(x) for x in state_start), strict=True))
    _add_unknowns(parent, layout, start)
    _add_derivatives(parent, layout, start)
    _add_inputs(parent, layout)
    _add_parameters(parent, layout)
    _add_outputs(parent, layout)
    if has_events:
        _add_indicators(parent, layout)
    else:
        _add_residuals(parent, layout)
    return parent


def _add_dae_switch(parent: ET.Element) -> None:
    ET.SubElement(
        parent,
        "Boolean",
        name=DAE_MODE_NAME,
        valueReference=str(DAE_MODE),
        causality="structuralParameter",
        variability="tunable",
        start="false",
        description="true: DAE mode as defined by fmi-ls-dae",
    )


def _exact_or_calculated(reference: int, start: dict[int, float]) -> dict[str, Any]:
    """States start from a given value, all else is calculated."""
    if reference in start:
        return {"initial": "exact", "start": start[reference]}
    return {"initial": "calculated"}


def _add_unknowns(parent: ET.Element, layout: Layout, start: dict[int, float]) -> None:
    for i, unknown in enumerate(layout.flat.unknowns):
        reference = layout.xi_base + i
        element = _float(
            parent,
            unknown.name,
            reference,
            causality="output" if reference in layout.output_references else "local",
            variability="continuous",
            description=unknown.description,
            **_bounds(unknown),
            **_exact_or_calculated(reference, start),
        )
        rate = dict(zip(layout.rates, layout.states, strict=True)).get(reference)
        if rate is not None:
            element.set("derivative", str(rate))
        facts = {
            "start": unknown.start,
            "fixed": unknown.fixed,
            "flow": unknown.is_flow,
            "state_select": None if unknown.state_select == "default" else unknown.state_select,
            "place": _place(unknown),
            "without_start": reference in start and unknown.start is None,
        }
        _annotate(element, UNKNOWN, facts)
        if reference in layout.output_references:
            _annotate_output(element, layout, layout.output_references.index(reference))


def _add_derivatives(parent: ET.Element, layout: Layout, start: dict[int, float]) -> None:
    """der(x) of the equations, then states and rates that the index reduction added."""
    names = {v.name: v for v in layout.flat.unknowns}
    of_rate = dict(zip(layout.rates, layout.states, strict=True))
    entries: list[tuple[str, int, int | None]] = [
        (derivative_name(layout.flat.unknowns[k].name), layout.derivative_base + j, layout.xi_base + k)
        for j, k in enumerate(layout.dynamic)
    ]
    entries += [
        (name, layout.extra_base + j, of_rate.get(layout.extra_base + j))
        for j, name in enumerate(layout.extra_names)
    ]
    for name, reference, of in entries:
        base, order = base_and_order(name)
        unit = derivative_unit(names[base].unit, order) if base in names else ""
        _float(
            parent,
            name,
            reference,
            causality="local",
            variability="continuous",
            unit=unit,
            derivative=None if of is None else str(of),
            description=f"Time derivative of {base}" if order == 1 else f"Time derivative {order} of {base}",
            **_exact_or_calculated(reference, start),
        )


def base_and_order(name: str) -> tuple[str, int]:
    """`der(x,2)` -> (`x`, 2); a name that is no derivative has order 0."""
    inner = name.removeprefix("der(").removesuffix(")")
    base, comma, order = inner.rpartition(",")
    return (
        (base, int(order))
        if comma and order.isdigit() and name.startswith("der(")
        else (inner, int(inner != name))
    )


def _add_inputs(parent: ET.Element, layout: Layout) -> None:
    flat = layout.flat
    common = {"causality": "input", "variability": "continuous"}
    for i, given in enumerate(flat.inputs):
        attributes = {
            **common,
            "start": given.start or 0.0,
            "description": given.description,
            **_bounds(given),
        }
        element = _float(parent, given.name, layout.input_base + i, **attributes)
        _annotate(element, INPUT, {"place": _place(given), "without_start": given.start is None})
    for i, name in enumerate(layout.input_derivative_names):
        base, order = base_and_order(name)
        unit = next(derivative_unit(v.unit, order) for v in flat.inputs if v.name == base)
        text = f"Time derivative of the input {base}, which the model needs"
        reference = layout.input_derivative_base + i
        _float(parent, name, reference, **common, start=0.0, unit=unit, description=text)
    for i, noise in enumerate(flat.noises):
        text = noise.description
        reference = layout.noise_base + i
        element = _float(
            parent, noise.name, reference, **common, start=0.0, unit=noise.unit, description=text
        )
        facts = {
            "white": True,
            "intensity": noise.intensity,
            "estimate": noise.estimate,
            "place": _place(noise),
        }
        _annotate(element, NOISE, facts)


def _add_parameters(parent: ET.Element, layout: Layout) -> None:
    for i, parameter in enumerate(layout.flat.parameters):
        if parameter.is_memory:
            if i in layout.shown_memory:
                _float(
                    parent,
                    parameter.name,
                    layout.parameter_base + i,
                    causality="local",
                    variability="discrete",
                    initial="calculated",
                    description=parameter.description.removesuffix(" between events"),
                )
            continue
        element = _float(
            parent,
            parameter.name,
            layout.parameter_base + i,
            causality="parameter",
            variability="tunable",
            initial="exact",
            start=parameter.value,
            description=parameter.description,
            **_bounds(parameter),
        )
        scale = None if parameter.scale == "auto" else parameter.scale
        facts = {"estimate": parameter.estimate, "scale": scale, "place": _place(parameter)}
        _annotate(element, PARAMETER, facts)
    for i, derived in enumerate(layout.flat.derived_parameters):
        _float(
            parent,
            derived.name,
            layout.derived_base + i,
            causality="calculatedParameter",
            variability="tunable",
            initial="calculated",
            unit=derived.unit,
            description=derived.description or f"= {derived.expression}",
        )


def _add_outputs(parent: ET.Element, layout: Layout) -> None:
    for i, (output, reference) in enumerate(zip(layout.flat.outputs, layout.output_references, strict=True)):
        if reference < layout.output_base:
            continue  # an unknown that was declared an output stands among the unknowns
        element = _float(
            parent,
            output.name,
            reference,
            causality="output",
            variability="continuous",
            initial="calculated",
            unit=output.unit,
            description=output.description,
        )
        _annotate_output(element, layout, i)


def _annotate_output(element: ET.Element, layout: Layout, index: int) -> None:
    output = layout.flat.outputs[index]
    # The index is told even when it is all there is to tell: the order of outputs is that of the model.
    facts = {
        "order": index + 1,
        "noise_std": output.noise_std,
        "fixed_noise": not output.estimate_noise,
        "description": output.description if element.get("description") != output.description else None,
        "place": _place(output),
    }
    _annotate(element, OUTPUT, facts)


def _add_indicators(parent: ET.Element, layout: Layout) -> None:
    for i in range(layout.n_indicators):
        _float(
            parent,
            INDICATOR_NAME.format(i + 1),
            layout.indicator_base + i,
            causality="local",
            variability="continuous",
            initial="calculated",
            description="Event indicator",
        )


def _add_residuals(parent: ET.Element, layout: Layout) -> None:
    for i, equation in enumerate(layout.flat.equations):
        element = _float(
            parent,
            RESIDUAL_NAME.format(i + 1),
            layout.residual_base + i,
            causality="local",
            variability="continuous",
            initial="calculated",
            description=f"Residual of {equation.text}",
        )
        facts = {
            "text": equation.text,
            "kind": equation.kind,
            "origin": equation.origin,
            "place": _place(equation),
        }
        _annotate(element, EQUATION, facts)


# ------------------------------------------------------------------------------------------- structure


def _dependencies(function: ca.Function, groups: Sequence[Sequence[int]]) -> list[list[int]]:
    """For each row of the function's result, the value references it depends on; `groups` are those of its
    arguments."""
    rows: list[list[int]] = [[] for _ in range(function.numel_out(0))]
    for argument, references in enumerate(groups):
        if not references or not rows:
            continue
        for row, column in zip(*function.jac_sparsity(0, argument).get_triplet(), strict=True):
            rows[row].append(references[column])
    return rows


def _ode_groups(layout: Layout) -> list[tuple[int, ...]]:
    flat = layout.flat
    return [
        layout.states,
        layout.references(layout.input_base, len(flat.inputs)),
        layout.references(layout.input_derivative_base, len(layout.explicit.input_derivatives)),
        layout.references(layout.noise_base, len(flat.noises)),
        layout.references(layout.parameter_base, len(flat.parameters)),
        (TIME,),
    ]


def _dae_groups(layout: Layout) -> list[tuple[int, ...]]:
    ode = _ode_groups(layout)
    derivatives = layout.references(layout.derivative_base, len(layout.dynamic))
    return [derivatives, layout.references(layout.xi_base, layout.flat.n), ode[1], *ode[3:]]


def _unknown(parent: ET.Element, kind: str, reference: int, dependencies: Iterable[int]) -> None:
    text = " ".join(map(str, sorted(set(dependencies))))
    ET.SubElement(parent, kind, valueReference=str(reference), dependencies=text)


def _structure(layout: Layout, functions: dict[str, ca.Function]) -> ET.Element:
    parent = ET.Element("ModelStructure")
    groups = _ode_groups(layout)
    outputs = list(
        zip(layout.output_references, _dependencies(functions["model_outputs"], groups), strict=True)
    )
    rates = list(zip(layout.rates, _dependencies(functions["model_rhs"], groups), strict=True))
    derived = _dependencies(functions["model_derived"], groups)
    hidden = {layout.parameter_base + i for i, p in enumerate(layout.flat.parameters) if p.is_memory}
    for one in (*(known for _, known in outputs + rates), *derived):
        one[:] = [reference for reference in one if reference not in hidden]
    for reference, known in outputs:
        _unknown(parent, "Output", reference, known)
    for reference, known in rates:
        _unknown(parent, "ContinuousStateDerivative", reference, known)
    parameters = list(zip(layout.references(layout.derived_base, len(derived)), derived, strict=True))
    for reference, known in outputs + rates + parameters:
        if reference not in layout.states:
            _unknown(parent, "InitialUnknown", reference, known)
    for reference in layout.references(layout.indicator_base, layout.n_indicators):
        ET.SubElement(parent, "EventIndicator", valueReference=str(reference))
    return parent


def dae_manifest(layout: Layout, functions: dict[str, ca.Function]) -> str:
    """The manifest of fmi-ls-dae in the shape of its draft 1.0.0-alpha.1, fully implicit: all rows are
    residuals.

    That draft promises semi-explicit systems of index 1 only; the unreduced DAE has no state derivative that
    the FMU computes by itself, so the list of state derivatives is empty, as other exporters of implicit DAEs
    write it.
    """
    ET.register_namespace("fmi-ls", MANIFEST_NAMESPACE)
    root = ET.Element("fmiDAEManifest")
    _name_standard(
        root, "org.fmi-standard.fmi-ls-dae", DAE_VERSION, "Layered standard for DAE support in FMI."
    )
    ET.SubElement(root, "EnableDAEParameter", valueReference=str(DAE_MODE))
    algebraic = [layout.xi_base + i for i in range(layout.flat.n) if i not in layout.dynamic]
    if algebraic:
        parent = ET.SubElement(root, "AlgebraicVariables")
        for reference in algebraic:
            ET.SubElement(parent, "AlgebraicVariable", valueReference=str(reference))
    structure = ET.SubElement(root, "ModelStructure")
    groups = _dae_groups(layout)
    outputs = _dependencies(functions["model_dae_outputs"], groups)
    for reference, known in zip(layout.output_references, outputs, strict=True):
        _unknown(structure, "Output", reference, known)
    for i, known in enumerate(_dependencies(functions["model_residual"], groups)):
        _unknown(structure, "Residual", layout.residual_base + i, known)
    return xml_text(root)


def symbolic_manifest() -> str:
    """The manifest of the folder with the serialized symbolic model."""
    ET.register_namespace("fmi-ls", MANIFEST_NAMESPACE)
    root = ET.Element("fmiLayeredStandardManifest")
    _name_standard(root, "org.daest.symbolic-model", "1.0.0", "Symbolic model, serialized by CasADi")
    return xml_text(root)


def _name_standard(root: ET.Element, name: str, version: str, description: str) -> None:
    for key, value in (("name", name), ("version", version), ("description", description)):
        root.set(f"{{{MANIFEST_NAMESPACE}}}fmi-ls-{key}", value)


# ----------------------------------------------------------------------------------------------- files


def _unit_definitions(variables: ET.Element) -> ET.Element | None:
    names = sorted({v.get("unit") or "" for v in variables} - {""})
    if not names:
        return None
    parent = ET.Element("UnitDefinitions")
    for name in names:
        element = ET.SubElement(parent, "Unit", name=name)
        unit = base_unit(name)
        if unit is not None:
            base = ET.SubElement(element, "BaseUnit", {k: str(v) for k, v in unit.exponents.items()})
            if unit.factor != 1.0:
                base.set("factor", repr(unit.factor))
            if unit.offset != 0.0:
                base.set("offset", repr(unit.offset))
    return parent


def model_description(
    layout: Layout, functions: dict[str, ca.Function], state_start: np.ndarray, token: str, version: str
) -> str:
    """modelDescription.xml. `state_start` (n_states,) are the start values of the states."""
    flat = layout.flat
    variables = _variables(layout, state_start)
    names = [v.get("name") or "" for v in variables]
    root = ET.Element(
        "fmiModelDescription",
        fmiVersion="3.0",
        modelName=_clean(flat.name),
        instantiationToken=token,
        generationTool=f"daest {version}",
        variableNamingConvention="structured" if all(map(_STRUCTURED.fullmatch, names)) else "flat",
    )
    if flat.description:
        root.set("description", _clean(flat.description))
    ET.SubElement(
        root,
        "ModelExchange",
        modelIdentifier=model_identifier(flat.name),
        canGetAndSetFMUState="true",
        canSerializeFMUState="true",
        providesDirectionalDerivatives="true",
    )
    units = _unit_definitions(variables)
    if units is not None:
        root.append(units)
    categories = ET.SubElement(root, "LogCategories")
    ET.SubElement(categories, "Category", name="logStatusError", description="What could not be done")
    ET.SubElement(root, "DefaultExperiment", startTime="0.0")
    root.append(variables)
    root.append(_structure(layout, functions))
    return xml_text(root)


def build_description(identifier: str, main: str = f"{WRAPPER}.c") -> str:
    """sources/buildDescription.xml: how to compile the sources, of which `main` includes the others, on a
    platform that the FMU has no binary for."""
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ET.SubElement(root, "BuildConfiguration", modelIdentifier=identifier)
    file_set = ET.SubElement(configuration, "SourceFileSet", language="C99")
    ET.SubElement(file_set, "SourceFile", name=main)
    return xml_text(root)


def xml_text(root: ET.Element) -> str:
    """The document, indented, behind its XML declaration."""
    ET.indent(root, "  ")
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"
