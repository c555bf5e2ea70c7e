"""`daest filter`: states and all internal variables with their uncertainty."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from daest.cli.follow import (
    StreamOptions,
    needs_stream,
    open_stream,
    refuse_whole,
    stream_options,
    told_at_the_end,
    write_estimates,
)
from daest.cli.given import Files, files
from daest.cli.options import (
    DataOptions,
    ModelOptions,
    data_options,
    draw,
    example,
    kind_option,
    measure_option,
    model_options,
    result_options,
    seed_option,
    set_option,
)
from daest.cli.output import emit, keep_inputs, note, telling, write_text
from daest.cli.progress import progress
from daest.errors import ConfigError
from daest.estimation.filters import FILTERS, usual_filter
from daest.model.defaults import PARTICLES

if TYPE_CHECKING:
    from daest.data.project import Project
    from daest.estimation.filter_engines.filter_cost import FilterCost, Way
    from daest.model.estimates import FilterOptions, FilterResult
    from daest.model.experiment import Experiment
    from daest.model.flat import Model
    from daest.model.holds import Hold

ESTIMATES = "estimates.csv"
LONG = 10.0  # seconds from which on progress is shown


@click.command(
    "filter",
    epilog=example(
        "daest filter Servo.mo run2.csv --measure phi --smooth -o estimates.csv",
        "tail -f machine.csv | daest filter Servo.mo --follow --state machine.npz",
    ),
)
@files("[MODEL] [DATA]")
@set_option
@measure_option
@kind_option(FILTERS)
@click.option(
    "--particles",
    type=click.IntRange(min=2),
    metavar="N",
    default=PARTICLES,
    help=f"Number of particles of a particle filter (default: {PARTICLES}).",
)
@click.option("--smooth", is_flag=True, help="Estimate from the whole recording instead of the past.")
@click.option("--only", metavar="NAME", multiple=True, help="Write this variable alone.")
@click.option(
    "--follow",
    is_flag=True,
    help="Take samples as they come, from stdin or from a file that grows (CSV or JSON lines), and write one "
    "estimate each to stdout.",
)
@stream_options
@model_options
@data_options
@result_options
@seed_option
def command(
    files: Files,
    settings: Mapping[str, float],
    measure: tuple[str, ...],
    kind: str | None,
    particles: int,
    smooth: bool,
    only: tuple[str, ...],
    follow: bool,
    stream: StreamOptions,
    model_options: ModelOptions,
    data_options: DataOptions,
    form: str,
    output: Path | None,
    plot: Path | None,
    seed: int,
) -> None:
    """Estimate every variable of MODEL from the recording DATA (default: those of daest.toml), and write the
    estimates as CSV.

    The table goes to results/estimates.csv or the file of -o, a summary to stdout. Parameters and noise are
    those of results/fit.json. With --follow there is no recording: every sample of stdin, or of the file DATA
    that grows, gives one line on stdout at once (CSV, or JSON with --format json).
    """
    model, data = files.model, files.recording
    if follow:
        refuse_whole({"--smooth": smooth, "-o": output is not None, "--plot": plot is not None})
        opened = open_stream(
            model_options.project(), model, model_options, data_options, data, measure, kind, stream, settings
        )
        with told_at_the_end(opened.tally):
            write_estimates(opened, only, form)
        return
    needs_stream(stream)
    from daest.cli.models import model_source
    from daest.cli.results import keep, made_from, unseen_files
    from daest.model.estimates import FilterOptions
    from daest.report.arrays import csv_text
    from daest.report.documents import filter as documents
    from daest.report.result_figures import filter_figure
    from daest.report.texts import filter as texts
    from daest.systems.linear.linearize import is_affine_model

    project = model_options.project()
    keep_inputs(output, files.all)
    prepared = _prepared(project, model, model_options, data, data_options, settings)
    flat, experiment = prepared.flat, prepared.experiment
    chosen = kind or usual_filter(is_affine_model(flat), flat.events is not None)
    options = FilterOptions(
        measure=measure or None, smooth=smooth, hold=prepared.hold, n_particles=particles, seed=seed
    )
    result = _estimated(flat, experiment, chosen, options)
    text = csv_text(*documents.table(result, list(only) or None))
    if output is not None and str(output) == "-":
        draw(plot, lambda: filter_figure(result, experiment, only))
        write_text(text, output)
        return
    document = {**documents.document(result), "notes": list(prepared.remarks)}
    names = documents.shown(result, experiment, only)
    origin = made_from(project, [model_source(project, model)], unseen_files(project, [data] if data else []))
    described = {**document, "series": documents.described(result, experiment, names)}
    target = output or project.results / ESTIMATES
    with telling(lambda: emit(document, "filter", form, None, texts.text)):
        write_text(text, target)
        note(f"the estimates are in {target}")
        draw(plot, lambda: filter_figure(result, experiment, only))
        keep(project, "filter", "filter", described, origin, documents.series(result, experiment, names))


def _estimated(flat: Model, experiment: Experiment, kind: str, options: FilterOptions) -> FilterResult:
    from daest.estimation.filter import run_filter
    from daest.estimation.filter_engines.filter_cost import LARGE, way_of_filter
    from daest.estimation.fitting.profile import silent
    from daest.systems.linear.linearize import is_affine_model
    from daest.systems.linear.state_space import state_space_family

    if not FILTERS[kind].is_linear or flat.events is not None:
        return run_filter(flat, experiment, kind, options)
    if not is_affine_model(flat):
        note(f"the {kind} filter sees the model linearised at its operating point; --kind ekf does not")
    family = state_space_family(flat)
    n_states = len(family.state_names)
    way = way_of_filter(kind, experiment, options.measure, options.smooth)
    cost = _tell_cost(n_states, flat.n, len(experiment.time), way)
    with progress() if n_states >= LARGE and cost.seconds > LONG else nullcontext(silent) as tell:
        return run_filter(family, experiment, kind, options, tell)


def _tell_cost(n_states: int, n_unknowns: int, n_samples: int, way: Way) -> FilterCost:
    """The cost of a filter, told on stderr before it starts where the model is large."""
    from daest.estimation.filter_engines.filter_cost import LARGE, filter_cost

    cost = filter_cost(n_states, n_unknowns, n_samples, way)
    if n_states >= LARGE:
        cheaper = "" if way == "stationary" else "; --kind stationary takes less"
        note(
            f"{n_states} states and {n_samples} samples: this takes about {max(cost.seconds, 1):.0f} s and "
            f"{max(cost.bytes / 1e9, 0.1):.1f} GB of memory{cheaper}"
        )
    return cost


@dataclass(frozen=True)
class _Prepared:
    """The fitted model with its measured outputs, the recording, the hold, and what is to be said of the
    fit."""

    flat: Model
    experiment: Experiment
    hold: Hold
    remarks: tuple[str, ...]


def _prepared(
    project: Project,
    model: Path | None,
    model_options: ModelOptions,
    data: Path | None,
    options: DataOptions,
    settings: Mapping[str, float],
) -> _Prepared:
    from daest.cli.models import model_source, with_settings
    from daest.cli.recordings import unseen_data
    from daest.cli.results import with_fit

    source = model_source(project, model)
    flat, fit = with_fit(project, source, model_options.load(project, source))
    flat = with_settings(flat, settings)
    # What is estimated from a recording needs no part that the model has not seen.
    flat, experiments = unseen_data(flat, project, [data] if data else [], options, splits_windows=False)
    if len(experiments) > 1:
        names = ", ".join(experiment.name for experiment in experiments)
        raise ConfigError(
            "filter-one-recording",
            f"a filter runs over one recording, and daest.toml names {len(experiments)}: {names}",
            remedy=f"name one of them: daest filter {(project.validate or project.estimate)[-1]}",
        )
    hold = options.chosen_hold(project, flat, experiments, fit.document if fit else None)
    return _Prepared(flat, experiments[0], hold, () if fit is None else fit.remarks)
