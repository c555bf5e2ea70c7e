"""`daest noise`: which equations may carry white noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import click

from daest.cli.kept import keep, made_from
from daest.cli.linear import load_linear
from daest.cli.models import model_source
from daest.cli.options import (
    class_options,
    example,
    format_option,
    output_option,
    plot_option,
    project_option,
    set_option,
)
from daest.cli.output import emit, keep_inputs
from daest.cli.pictures import draw
from daest.data.project import load_project
from daest.report.documents import noise as documents
from daest.report.structure_figure import noise_figure
from daest.report.texts import noise as texts
from daest.systems.noise import noise_report


@click.command("noise", epilog=example("daest noise Servo.mo", "daest noise Servo.mo --at disc.flange_b.tau"))
@click.argument("model", required=False, type=click.Path(path_type=Path))
@click.option(
    "--tolerance",
    type=click.FloatRange(min=0, min_open=True),
    metavar="X",
    help="Call equations admissible up to this projection norm (default: decided without units).",
)
@click.option("--at", "places", metavar="EQUATION|NAME", multiple=True, help="Ask for this place too.")
@set_option
@class_options
@project_option
@format_option
@output_option
@plot_option
def command(
    model: Path | None,
    tolerance: float | None,
    places: tuple[str, ...],
    settings: Mapping[str, float],
    class_name: str | None,
    libraries: Sequence[Path],
    project_file: Path | None,
    form: str,
    output: Path | None,
    plot: Path | None,
) -> int:
    """Say for every equation of MODEL whether white noise may act there.

    Exit code 1 if a noise of the model, or a place that was asked for with --at, is not admissible.
    """
    project = load_project(project_file)
    keep_inputs(output, [model])
    dae = load_linear(project, model, class_name, libraries, settings, None).dae
    report = noise_report(dae, at=places, tolerance=tolerance)
    draw(plot, lambda: noise_figure(dae, report))
    document = documents.document(report)
    origin = made_from(project, [model_source(project, model)])
    keep(project, "noise", "noise", {**document, "structure": documents.structure(dae)}, origin)
    emit(document, "noise", form, output, texts.text)
    return int(not report.all_admissible)
