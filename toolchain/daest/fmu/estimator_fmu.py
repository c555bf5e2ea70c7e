"""An estimator as a Co-Simulation FMU, FMI 3.0 or 2.0: the C code of `estimator_code` behind the
standard's interface.
"""

from __future__ import annotations

import hashlib
import time
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Literal

import daest
from daest.fmu.description import build_description, model_identifier, xml_text
from daest.fmu.estimator_code import EstimatorModel, estimator_files
from daest.fmu.export import FLAGS, write_archive
from daest.fmu.sources import SHARED
from daest.model.fmu import EstimatorExport
from daest.numerics.compiler import Platform, build_shared, native_platform, platform_named, text_of

Version = Literal["2.0", "3.0"]
Causality = Literal["independent", "input", "output", "parameter"]
_ONLY_2 = {"variableNamingConvention": "flat", "numberOfEventIndicators": "0"}
_VARIABILITY = {"independent": "continuous", "input": "discrete", "output": "discrete"}


@dataclass(frozen=True)
class FmuVariable:
    """A scalar of the FMU. `start` None: calculated. `is_flag`: a Boolean. `is_tunable`: a parameter that may
    change between steps."""

    name: str
    reference: int
    causality: Causality
    description: str
    start: float | None = None
    is_flag: bool = False
    is_tunable: bool = False


def export_estimator_fmu(
    model: EstimatorModel,
    path: Path,
    platforms: Sequence[str] | None = None,
    version: Version = "3.0",
) -> EstimatorExport:
    """Write the FMU to `path`, whole or not at all, and validate it.

    `platforms` as in `export_fmu`. Errors: FmuError `no-c-compiler`, `compilation-failed`,
    `fmu-platform-unknown`, `fmu-not-written`, and those of `estimator_files`.
    """
    began = time.perf_counter()
    targets = [platform_named(p) for p in platforms] if platforms else [native_platform()]
    variables = fmu_variables(model)
    texts = _sources(model, variables, version)
    token = f"{{{hashlib.sha256(repr(sorted(texts.items())).encode()).hexdigest()[:32]}}}"
    texts["estimator_fmu.h"] = _header(model, variables, token)
    identifier = f"{model_identifier(model.name)}_estimator"
    description = _description(model, variables, identifier, token, version)
    archive = {"modelDescription.xml": description.encode()}
    main = "fmi3.c" if version == "3.0" else "fmi2.c"
    archive |= {f"sources/{name}": text.encode() for name, text in texts.items()}
    if version == "3.0":
        archive["sources/buildDescription.xml"] = build_description(identifier, main).encode()
    for target in targets:
        included = {name: text for name, text in texts.items() if name != main}
        library = build_shared(texts[main], identifier, FLAGS, files=included, target=target)
        archive[f"binaries/{_folder(target, version)}/{identifier}{target.suffix}"] = library.read_bytes()
    validation = write_archive(path, archive)
    return EstimatorExport(
        path, model.name, "fmu", version, tuple(_folder(t, version) for t in targets), model.inputs,
        model.outputs, model.values, validation, time.perf_counter() - began,
    )  # fmt: skip


def fmu_variables(model: EstimatorModel) -> list[FmuVariable]:
    """All variables with their value references, which count from 0 in this order: time, inputs, measured
    outputs, flags, parameters, start, estimates."""
    return [
        FmuVariable(name, reference, causality, text, start, is_flag, is_tunable)
        for reference, (name, causality, text, start, is_flag, is_tunable) in enumerate(_listed(model))
    ]


_Row = tuple[str, Causality, str, float | None, bool, bool]


def _listed(model: EstimatorModel) -> Iterator[_Row]:
    taken = {*model.inputs, *model.outputs}
    flat = model.flat
    yield "time", "independent", "time [s]", None, False, False
    for variable in flat.inputs:
        yield variable.name, "input", f"input [{variable.unit}]", variable.start or 0.0, False, False
    for output in flat.outputs:
        yield output.name, "input", f"measured output [{output.unit}]", 0.0, False, False
    for name in model.outputs:
        yield f"valid_{name}", "input", f"whether {name} was measured at this time", 1.0, True, False
    if model.is_tunable:
        for parameter, value in zip(flat.parameters, model.theta, strict=True):
            name = parameter.name if parameter.name not in taken else f"parameter.{parameter.name}"
            yield name, "parameter", f"parameter [{parameter.unit}]", float(value), False, True
    for name, value in zip(model.noises, model.intensity, strict=True):
        yield f"intensity.{name}", "parameter", "two-sided spectral density", float(value), False, True
    for name, value in zip(model.outputs, model.std, strict=True):
        yield f"noise_std.{name}", "parameter", "standard deviation of one sample", float(value), False, True
    yield "start_known", "parameter", "whether the start below holds; else it is unknown", 0.0, True, False
    for name, unit in zip(model.state_names, model.state_units, strict=True):
        yield f"start.{name}", "parameter", f"state before the first sample [{unit}]", 0.0, False, False
    for name, scale in zip(model.state_names, model.scale, strict=True):
        yield f"start.{name}.std", "parameter", "its standard deviation", float(scale), False, False
    names = [name if name not in taken else f"estimate.{name}" for name in model.values]
    for name in names:
        yield name, "output", "estimate", None, False, False
    for name in model.values:
        yield f"{name}.std", "output", "standard deviation of the estimate", None, False, False
    for name in model.outputs:
        yield f"innovation.{name}", "output", "measured minus predicted", None, False, False
    yield "nis", "output", "normalised innovations squared", None, False, False
    yield "log_likelihood", "output", "of all samples so far", None, False, False
    yield "sample_time", "output", "time of the sample that the estimates belong to [s]", None, False, False


def _bases(model: EstimatorModel) -> dict[str, int]:
    """First value reference of each group, in the order of `_listed`."""
    n_x, n_u, n_w, n_y, n_v, n_theta = (
        model.sizes[f"EST_{key}"] for key in ("NX", "NU", "NW", "NY", "NV", "NTHETA")
    )
    groups = (
        ("TIME", 1), ("U", n_u), ("Y", n_y), ("VALID", n_y), ("THETA", n_theta), ("INTENSITY", n_w),
        ("NOISE_STD", n_y), ("START_KNOWN", 1), ("START", n_x), ("START_STD", n_x), ("VALUE", n_v),
        ("STD", n_v), ("INNOVATION", n_y), ("NIS", 1), ("LOG_LIKELIHOOD", 1), ("SAMPLE_TIME", 1),
    )  # fmt: skip
    found, next_one = {}, 0
    for name, count in groups:
        found[f"VR_{name}"] = next_one
        next_one += count
    return found


def _sources(model: EstimatorModel, variables: Sequence[FmuVariable], version: Version) -> dict[str, str]:
    room = files("daest.fmu").joinpath("estimator")
    code = estimator_files(model)
    main = "fmi3.c" if version == "3.0" else "fmi2.c"
    own = {name: room.joinpath(name).read_text(encoding="utf-8") for name in (main, "instance.h")}
    if version == "3.0":
        own[SHARED] = text_of(SHARED, "daest.fmu")
    return {
        **{name: text for name, text in code.items() if name != "main.c"},
        **own,
        "estimator_fmu.h": _header(model, variables, ""),
    }


def _header(model: EstimatorModel, variables: Sequence[FmuVariable], token: str) -> str:
    bases = _bases(model)
    assert bases["VR_SAMPLE_TIME"] == variables[-1].reference
    lines = [f"#define {name} {value}u" for name, value in bases.items()]
    lines += [
        f'#define INSTANTIATION_TOKEN "{token}"',
        f'#define MODEL_NAME "{model_identifier(model.name)}"',
    ]
    return "\n".join(lines) + "\n"


def _folder(target: Platform, version: Version) -> str:
    """Name of the folder of a platform in the archive."""
    return target.tuple_name if version == "3.0" else target.short_name


def _description(
    model: EstimatorModel, variables: Sequence[FmuVariable], identifier: str, token: str, version: Version
) -> str:
    """modelDescription.xml. FMI 2 differs in some names, wraps each type into a ScalarVariable, and counts
    the variables of its structure from 1."""
    is_3 = version == "3.0"
    root = ET.Element(
        "fmiModelDescription", fmiVersion=version, modelName=f"{model.name}.Estimator",
        description=f"State estimator of {model.name}", generationTool=f"daest {daest.__version__}",
    )  # fmt: skip
    root.attrib.update({"instantiationToken": token} if is_3 else {"guid": token, **_ONLY_2})
    kind = ET.SubElement(
        root, "CoSimulation", modelIdentifier=identifier, canHandleVariableCommunicationStepSize="true"
    )
    for ability in ("canGetAndSetFMU", "canSerializeFMU"):
        kind.set(f"{ability}{'State' if is_3 else 'state'}", "true")
    if not is_3:
        kind.set("canNotUseMemoryManagementFunctions", "true")
    ET.SubElement(root, "DefaultExperiment", startTime="0", stepSize=repr(float(model.period)))
    parent = ET.SubElement(root, "ModelVariables")
    for v in variables:
        attributes = {
            "name": v.name, "valueReference": str(v.reference), "causality": v.causality,
            "variability": _variability(v),
        }  # fmt: skip
        start = {} if v.start is None else {"start": _start(v)}
        if v.causality == "output":
            attributes["initial"] = "calculated"
        attributes["description"] = v.description
        if is_3:
            ET.SubElement(parent, "Boolean" if v.is_flag else "Float64", {**attributes, **start})
        else:
            scalar = ET.SubElement(parent, "ScalarVariable", attributes)
            ET.SubElement(scalar, "Boolean" if v.is_flag else "Real", start)
    structure = ET.SubElement(root, "ModelStructure")
    outputs = [(i, v) for i, v in enumerate(variables, 1) if v.causality == "output"]
    for role in ("Output", "InitialUnknown"):
        listed = structure if is_3 else ET.SubElement(structure, f"{role}s")
        for index, v in outputs:
            which = {"valueReference": str(v.reference)} if is_3 else {"index": str(index)}
            ET.SubElement(listed, role if is_3 else "Unknown", {**which, "dependencies": ""})
    return xml_text(root)


def _variability(variable: FmuVariable) -> str:
    if variable.causality == "parameter":
        return "tunable" if variable.is_tunable else "fixed"
    return _VARIABILITY[variable.causality]


def _start(variable: FmuVariable) -> str:
    assert variable.start is not None
    return ("true" if variable.start else "false") if variable.is_flag else repr(float(variable.start))
