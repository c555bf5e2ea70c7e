"""`daest simulate`: a model under recorded inputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from daest.cli.given import Files, files
from daest.cli.options import (
    DataOptions,
    ModelOptions,
    data_options,
    draw,
    example,
    model_options,
    result_options,
    seed_option,
    set_option,
)
from daest.cli.output import emit, keep_inputs, note, write_text
from daest.cli.progress import progress

if TYPE_CHECKING:
    from daest.model.experiment import Simulation

# Names of variables without finite values that are told.
MOST_LOST = 5


@click.command("simulate", epilog=example("daest simulate Servo.mo run1.csv -o out.csv"))
@files("[MODEL] [DATA]", "model", "--inputs")
@click.option("--noise", is_flag=True, help="Add process and measurement noise with their intensities.")
@click.option(
    "--all", "all_variables", is_flag=True, help="Write every internal variable, not the outputs alone."
)
@set_option
@model_options
@data_options
@result_options
@seed_option
def command(
    files: Files,
    noise: bool,
    all_variables: bool,
    settings: Mapping[str, float],
    model_options: ModelOptions,
    data_options: DataOptions,
    form: str,
    output: Path | None,
    plot: Path | None,
    seed: int,
) -> None:
    """Drive MODEL with the inputs of the recording DATA, and write its outputs as CSV.

    Both are by default those of daest.toml.

    Parameters are those of results/fit.json if it is a fit of this model, else those of the model.
    """
    from daest.cli.models import model_source, with_settings
    from daest.cli.recordings import driving_data
    from daest.cli.results import find_fit, fitted
    from daest.modelica.flat.clock import model_clock
    from daest.modelica.flat.guesses import begun_as_recorded
    from daest.report.result_figures import simulation_figure
    from daest.systems.simulation.simulate import simulate

    project = model_options.project()
    keep_inputs(output, files.all)
    source = model_source(project, files.model)
    flat = model_options.load(project, source)
    fit = find_fit(project, source, flat)
    if fit is not None:
        note(f"parameters of {fit.path}")
        flat = fitted(flat, fit.document)
    flat = with_settings(flat, settings)
    inputs = files.recording
    recording = driving_data(flat, project, [inputs] if inputs else [], data_options)[0]
    flat = begun_as_recorded(flat, [recording])
    chosen = data_options.chosen_hold(project, flat, [recording], fit.document if fit else None)
    with progress() as tell:
        result = simulate(flat, recording, hold=chosen, noise=noise, seed=seed if noise else None, tell=tell)
    draw(plot, lambda: simulation_figure(result, recording))
    _write(result, form, output, all_variables, model_clock(flat), () if fit is None else fit.remarks)


def _write(
    result: Simulation,
    form: str,
    output: Path | None,
    all_variables: bool,
    clock: str,
    remarks: Sequence[str],
) -> None:
    from daest.report.arrays import csv_text
    from daest.report.documents import simulate as documents

    note(f"{result.n_samples} samples, {result.method}, hold {result.hold}")
    remarks = (*remarks, *_what_is_missing(result, all_variables))
    for remark in remarks:
        note(remark)
    if form == "json":
        document = {**documents.document(result), "notes": list(remarks)}
        emit(document, "simulate", form, output, lambda *_args, **_options: "")
    else:
        write_text(csv_text(*documents.table(result, all_variables, clock)), output)


def _what_is_missing(result: Simulation, all_variables: bool) -> list[str]:
    """Remarks on a table without outputs, and on values that are no numbers."""
    import numpy as np

    found = []
    if not result.output_names:
        others = f"--all writes its {len(result.variable_names)} variables" if result.variable_names else ""
        remedy = others or "nothing in it is continuous"
        found += [] if all_variables and others else [f"the model has no outputs that are numbers: {remedy}"]
    names = (*result.output_names, *(result.variable_names if all_variables else ()))
    lost = [name for name in dict.fromkeys(names) if not np.all(np.isfinite(result[name]))]
    if lost:
        first = min(int(np.argmin(np.isfinite(result[name]))) for name in lost)
        found.append(f"no finite values from t = {result.time[first]:g} s on: {', '.join(lost[:MOST_LOST])}")
    return found
