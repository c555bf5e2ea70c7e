"""`daest noise`: which equations may carry white noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from daest.cli.given import Files, files
from daest.cli.options import (
    DataOptions,
    ModelOptions,
    draw,
    example,
    model_options,
    result_options,
    set_option,
)
from daest.cli.output import emit, keep_inputs
from daest.errors import ConfigError, Place

if TYPE_CHECKING:
    from daest.data.project import Project
    from daest.model.flat import FlatModel
    from daest.model.noise import NoiseAlong


@click.command("noise", epilog=example("daest noise Servo.mo", "daest noise Servo.mo --at disc.flange_b.tau"))
@files("[MODEL] [DATA]", "model", "--along")
@click.option(
    "--tolerance",
    type=click.FloatRange(min=0, min_open=True),
    metavar="X",
    help="Call equations admissible up to this projection norm (default: decided without units).",
)
@click.option("--at", "places", metavar="EQUATION|NAME", multiple=True, help="Ask for this place too.")
@set_option
@model_options
@result_options
def command(
    files: Files,
    tolerance: float | None,
    places: tuple[str, ...],
    settings: Mapping[str, float],
    model_options: ModelOptions,
    form: str,
    output: Path | None,
    plot: Path | None,
) -> int:
    """Say for every equation of MODEL whether white noise may act there.

    With a recording DATA a nonlinear model is judged along its simulation under those inputs, too.

    Exit code 1 if a noise of the model, or a place that was asked for with --at, is not admissible, at the
    operating point or anywhere along the recording.
    """
    from daest.cli.linear import load_linear
    from daest.cli.models import model_source
    from daest.cli.results import keep, made_from
    from daest.report.documents import noise as documents
    from daest.report.structure_figure import noise_figure
    from daest.report.texts import noise as texts
    from daest.systems.linear.noise import noise_report

    project = model_options.project()
    keep_inputs(output, files.all)
    model, along = files.model, files.recording
    linear = load_linear(project, model, model_options, settings, None)
    dae = linear.dae
    report = noise_report(dae, at=places, tolerance=tolerance)
    judged = None if along is None else _along(project, linear.flat, along, places, tolerance)
    draw(plot, lambda: noise_figure(dae, report))
    document = documents.document(report, judged)
    origin = made_from(project, [model_source(project, model)])
    keep(project, "noise", "noise", {**document, "structure": documents.structure(dae)}, origin)
    emit(document, "noise", form, output, texts.text)
    return int(not report.all_admissible or (judged is not None and not judged.all_admissible))


def _along(
    project: Project,
    flat: FlatModel | None,
    data: Path,
    places: Sequence[str],
    tolerance: float | None,
) -> NoiseAlong:
    """Raises ConfigError `noise-along-needs-equations` for an FMU without equations."""
    from daest.cli.recordings import driving_data
    from daest.systems.simulation.noise_along import noise_along

    if flat is None:
        raise ConfigError(
            "noise-along-needs-equations",
            "the FMU carries no equations, which verdicts along a trajectory need",
            where=Place(str(data)),
            remedy="give the .mo file, or an FMU that daest exported",
        )
    options = DataOptions()
    recording = driving_data(flat, project, [data], options)[0]
    hold = options.chosen_hold(project, flat, [recording])
    return noise_along(flat, recording, places, hold=hold, tolerance=tolerance)
