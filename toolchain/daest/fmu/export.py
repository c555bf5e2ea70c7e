"""Modelica model -> FMU: FMI 3.0 Model Exchange, with the unreduced DAE and the symbolic model inside.

A model with events becomes an FMU with event indicators, time events and discrete variables, in ODE mode
alone."""

from __future__ import annotations

import hashlib
import time
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np

import daest
from daest.errors import FmuError
from daest.files import whole_file
from daest.fmu import description, serialization, sources
from daest.fmu.layout import Layout, layout
from daest.fmu.serialization import portable
from daest.model.flat import ExplicitModel, FlatModel
from daest.model.fmu import ExportResult
from daest.numerics.compiler import Platform, build_shared, native_platform, platform_named, text_of
from daest.systems.events.modes import in_starting_mode
from daest.systems.reduction.initialize import initial_point
from daest.systems.reduction.reduce import reduce_index

# -O1 compiles generated straight-line code several times faster than -O2 and runs as fast; contraction into
# fused multiply-adds would make results differ between processors.
FLAGS = ("-O1", "-ffp-contract=off", "-fvisibility=hidden")
# All files of the archive carry this time, so that the same model gives the same bytes.
_ARCHIVE_TIME = (1980, 1, 1, 0, 0, 0)
_COMPRESSION_LEVEL = 6


def export_fmu(
    flat: FlatModel,
    path: str | Path,
    platforms: Sequence[str] | None = None,
    explicit: ExplicitModel | None = None,
) -> ExportResult:
    """Write the FMU of `flat` to `path`, whole or not at all.

    `platforms` are names such as `linux64`, `win64`, `darwin64` (default: this machine's). `explicit` is the
    index-reduced form, computed when it is not given. Input derivatives that it needs become inputs `der(u)`.
    The same model, compiler and platforms give the same bytes.
    Errors: FmuError `no-c-compiler`, `compilation-failed`, `fmu-platform-unknown`, `fmu-name-twice`,
    `fmu-not-written`; ModelError of the index reduction and of the initial point.

        >>> daest.export_fmu(flat, "Servo.fmu").n_states
        4
    """
    began = time.perf_counter()
    flat = portable(flat)
    targets = [platform_named(p) for p in platforms] if platforms else [native_platform()]
    starting = in_starting_mode(flat)
    reduced = explicit or reduce_index(starting)
    state_start, _ = initial_point(replace(reduced, flat=starting))
    explicit = replace(reduced, flat=flat)
    made = layout(explicit)
    archive = _archive(made, state_start, targets)
    validation = write_archive(Path(path), archive)
    return ExportResult(
        path=Path(path),
        model_name=flat.name,
        platforms=tuple(t.tuple_name for t in targets),
        n_equations=flat.n,
        structural_index=explicit.structural_index,
        n_differentiations=explicit.n_differentiations,
        states=explicit.state_names,
        inputs=flat.input_names,
        input_derivatives=made.input_derivative_names,
        noises=flat.noise_names,
        outputs=flat.output_names,
        parameters=tuple(v.name for v in flat.parameters if not v.is_memory),
        validation=validation,
        seconds=time.perf_counter() - began,
    )


def validate(path: str | Path) -> tuple[str, ...]:
    """The messages of fmpy's validator; none for a file that conforms to the standard."""
    from fmpy.validation import validate_fmu

    return tuple(str(problem) for problem in validate_fmu(str(path)))


def _archive(made: Layout, state_start: np.ndarray, targets: Sequence[Platform]) -> dict[str, bytes]:
    """Every file of the FMU: path inside the archive -> content."""
    functions = {f.name(): f for f in sources.model_functions(made)}
    has_events = made.flat.events is not None
    symbolic = {} if has_events else serialization.serialize(made.flat)
    code = sources.model_code([*functions.values(), *sources.event_functions(made)])
    version = daest.__version__
    token = _token(code, *symbolic.values(), sources.model_header(made, state_start, ""), version)
    header = sources.model_header(made, state_start, token)
    identifier = description.model_identifier(made.flat.name)
    texts = {
        "modelDescription.xml": description.model_description(made, functions, state_start, token, version),
        "sources/buildDescription.xml": description.build_description(identifier),
        f"sources/{sources.WRAPPER}.c": text_of("wrapper.c", "daest.fmu"),
        f"sources/{sources.SHARED}": text_of(sources.SHARED, "daest.fmu"),
        "sources/model.c": code,
        "sources/model.h": header,
    }
    if has_events:
        texts[f"sources/{sources.EVENTS}"] = text_of(sources.EVENTS, "daest.fmu")
    else:
        texts |= _without_events(made, functions, symbolic)
    files = {name: text.encode() for name, text in texts.items()}
    beside = {"model.c": code, "model.h": header, sources.EVENTS: text_of(sources.EVENTS, "daest.fmu")}
    beside[sources.SHARED] = text_of(sources.SHARED, "daest.fmu")
    for target in targets:
        library = build_shared(
            text_of("wrapper.c", "daest.fmu"),
            identifier,
            FLAGS,
            files=beside,
            target=target,
        )
        files[f"binaries/{target.tuple_name}/{identifier}{target.suffix}"] = library.read_bytes()
    return files


def _without_events(
    made: Layout, functions: Mapping[str, ca.Function], symbolic: Mapping[str, str]
) -> dict[str, str]:
    """The unreduced DAE and the symbolic model."""
    return {
        f"{description.DAE_FOLDER}/{description.MANIFEST}": description.dae_manifest(made, dict(functions)),
        f"{serialization.FOLDER}/{description.MANIFEST}": description.symbolic_manifest(),
        **{f"{serialization.FOLDER}/{name}": text for name, text in symbolic.items()},
    }


def _token(*texts: str) -> str:
    """The instantiation token: the hash of everything that makes the model what it is."""
    digest = hashlib.sha256()
    for text in texts:
        digest.update(text.encode() + b"\0")
    return f"{{{digest.hexdigest()[:32]}}}"


def write_archive(path: Path, content: Mapping[str, bytes]) -> tuple[str, ...]:
    """Write the archive, whole or not at all; what the validator says of it. Raises FmuError
    `fmu-not-written`."""
    try:
        with whole_file(path) as temporary:
            _archived(temporary, content)
            return validate(temporary)
    except OSError as problem:
        raise _not_written(path, problem) from problem


def _archived(path: Path, content: Mapping[str, bytes]) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in sorted(content, key=lambda n: (n != "modelDescription.xml", n)):
            entry = zipfile.ZipInfo(name, _ARCHIVE_TIME)
            entry.external_attr = 0o644 << 16
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, content[name], compresslevel=_COMPRESSION_LEVEL)


def _not_written(path: Path, problem: OSError) -> FmuError:
    return FmuError(
        "fmu-not-written", f"The FMU cannot be written: {problem.strerror or problem}.", where=str(path),
        remedy="Choose another file with -o.",
    )  # fmt: skip
