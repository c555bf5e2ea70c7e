"""`daest export`: a model as an FMU."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from daest.cli.export_estimator import (
    EstimatorOptions,
    estimator_options,
    export_estimator,
    needs_estimator,
    require_fmu_name,
)
from daest.cli.given import Files, files
from daest.cli.options import ModelOptions, example, format_option, model_options, output_option, set_option
from daest.cli.output import emit, keep_inputs, note, whole_file

if TYPE_CHECKING:
    from daest.data.project import Project


@click.command(
    "export",
    epilog=example(
        "daest export Servo.mo -o servo.fmu --platform linux64,win64",
        "daest export Servo.mo --estimator --only disc.w --c estimator/",
    ),
)
@files("[MODEL]", "model", None)
@click.option(
    "--platform", "platforms", metavar="LIST", help="linux64, win64, darwin64 (default: this machine's)."
)
@click.option(
    "--compiler",
    type=click.Choice(["rumoca", "omc"]),
    default="rumoca",
    help="omc: let OpenModelica make the FMU, or with -o NAME.bmo Base Modelica.",
)
@estimator_options
@set_option
@model_options
@format_option
@output_option
def command(
    files: Files,
    platforms: str | None,
    compiler: str,
    estimator: EstimatorOptions,
    settings: dict[str, float],
    model_options: ModelOptions,
    form: str,
    output: Path | None,
) -> None:
    """Write MODEL as an FMI 3.0 Model Exchange FMU: tunable parameters, its DAE, its equations as
    expressions.

    The file is MODEL.fmu here, or the one named with -o. With --estimator it is a Co-Simulation FMU that
    takes inputs and measured outputs and gives estimates (MODEL_estimator.fmu), or C99 in the folder of --c.
    """
    from daest.cli.models import model_source
    from daest.errors import ConfigError
    from daest.fmu.export import export_fmu
    from daest.model.flat import with_equations
    from daest.report.documents import export as documents
    from daest.report.texts import export as texts

    project = model_options.project()
    model = files.model
    source = model_source(project, model)
    chosen = [name.strip() for name in platforms.split(",") if name.strip()] if platforms else None
    if estimator.wanted:
        flat = with_equations(model_options.load(project, source, settings), "an export")
        export_estimator(project, source, flat, estimator, chosen, form, output)
        return
    needs_estimator(estimator)
    target = output or Path(source.with_suffix(".fmu").name)
    if str(target) == "-":
        raise ConfigError("export-to-stdout", "an FMU is a file, not a text", remedy="name it: -o model.fmu")
    keep_inputs(target, [source])
    if compiler == "omc":
        _export_by_omc(source, project, model_options, target, bool(platforms or settings))
        return
    require_fmu_name(target)
    flat = with_equations(model_options.load(project, source, settings), "an export")
    result = export_fmu(flat, target, chosen)
    emit(documents.document(result), "export", form, None, texts.text)


def _export_by_omc(
    source: Path, project: Project, options: ModelOptions, target: Path, has_options: bool
) -> None:
    """Write what OpenModelica makes of the model: an FMU, or Base Modelica under a name in .bmo."""
    from daest.cli.models import chosen_class
    from daest.errors import ConfigError
    from daest.modelica.compiling.omc import OmcJob, base_modelica_by_omc, fmu_by_omc
    from daest.modelica.language.source import read_source, select_class

    if has_options:
        raise ConfigError(
            "omc-options",
            "--platform and --set are not passed on to OpenModelica",
            remedy="leave them out: set values in the model, and build on the other platform",
        )
    if source.suffix == ".fmu":
        raise ConfigError(
            "model-unknown-format",
            f"'{source.name}' is no source that OpenModelica could compile",
            remedy="give the Modelica file that it was made from",
        )
    text = read_source(source)
    name = select_class(text, source, chosen_class(project, source, options.class_name))
    job = OmcJob(source, text, name, options.folders(project))
    content = base_modelica_by_omc(job) if target.suffix == ".bmo" else fmu_by_omc(job)
    with whole_file(target) as temporary:
        temporary.write_bytes(content)
    note(f"OpenModelica made {target}")
