"""`daest identify`: parameters with their uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from daest.cli.given import Files, ParameterOptions, files, parameter_options
from daest.cli.options import (
    PLAIN,
    DataOptions,
    ModelOptions,
    checked,
    cluster_option,
    draw,
    example,
    jobs_option,
    model_options,
    require_cluster,
    result_options,
    seed_option,
    split_data_options,
)
from daest.cli.output import emit, keep_inputs, note, telling
from daest.cli.progress import progress
from daest.model.defaults import LEAST_REFITS

if TYPE_CHECKING:
    from daest.data.project import Project
    from daest.model.experiment import Experiment
    from daest.model.fit import FitResult, IdentifyOptions
    from daest.model.flat import Model
    from daest.report.documents.fit import FitDocument


@dataclass(frozen=True)
class Identified:
    """A fit with its document, and what it was made from; `loaded` is the model before the recordings said
    which outputs are measured."""

    result: FitResult
    document: FitDocument
    flat: Model
    loaded: Model
    source: Path
    recordings: list[Path]
    estimation: list[Experiment]
    validation: list[Experiment]


@click.command("identify", epilog=example("daest identify Servo.mo run1.csv --split 0.5 --fix R=4.6"))
@files("[MODEL] [DATA]...")
@parameter_options
@click.option(
    "--method",
    type=click.Choice(["oe", "pem"]),
    help="Output error, or prediction error (default: pem if the model has process noise).",
)
@click.option(
    "--likelihood",
    type=click.Choice(["observer", "ekf"]),
    default="observer",
    help="One-step predictions of a nonlinear model: constant gain, or extended Kalman filter.",
)
@click.option(
    "--profile",
    metavar="NAME",
    multiple=True,
    help="Profile likelihood of this parameter, or of all: an interval without any assumption of its shape.",
)
@click.option(
    "--profile-plot",
    metavar="FILE",
    type=click.Path(path_type=Path),
    callback=checked,
    help="Draw the profiles (.png, .svg or .pdf).",
)
@click.option(
    "--shooting",
    metavar="SEGMENTS",
    type=click.IntRange(min=1),
    help="Multiple shooting of a nonlinear model (default: where a search over the whole record fails).",
)
@click.option(
    "--starts",
    type=click.IntRange(min=1),
    metavar="N",
    default=1,
    help="Number of start points (default: 1, and more when the residuals are not white).",
)
@click.option(
    "--bootstrap",
    type=click.IntRange(min=LEAST_REFITS),
    metavar="N",
    help="Intervals from refits of N recordings that the fitted model makes, noise included.",
)
@jobs_option
@cluster_option
@model_options
@split_data_options
@result_options
@seed_option
def command(
    files: Files,
    parameters: ParameterOptions,
    method: Any,
    likelihood: Any,
    profile: tuple[str, ...],
    profile_plot: Path | None,
    shooting: int | None,
    starts: int,
    bootstrap: int | None,
    jobs: int,
    cluster: str | None,
    model_options: ModelOptions,
    data_options: DataOptions,
    form: str,
    output: Path | None,
    plot: Path | None,
    seed: int,
) -> None:
    """Estimate parameters of MODEL from the recordings DATA (default: those of daest.toml).

    The result is written to results/fit.json, where filter, compare and simulate find it.
    """
    from daest.estimation.fitting.profile import ALL
    from daest.model.fit import IdentifyOptions
    from daest.report.texts import identify as texts

    project = model_options.project()
    keep_inputs(output, files.all)
    options = IdentifyOptions(
        method=method,
        likelihood=likelihood,
        profile=profile or ((ALL,) if profile_plot is not None else ()),
        shooting=shooting,
        starts=starts,
        seed=seed,
        jobs=jobs,
        cluster=cluster,
    )
    options = parameters.among(options)
    require_cluster(cluster)
    found = identified(
        project,
        files.model,
        files.data,
        data_options,
        options,
        model_options,
        bootstrap=bootstrap or 0,
        others=plot is not None,
    )
    with telling(lambda: emit(found.document, "identify", form, output, texts.text)):
        keep_fit(project, found)
        if plot is not None:
            _draw(found, plot)
        if profile_plot is not None:
            _draw_profiles(found, profile_plot)


def identified(
    project: Project,
    model: Path | None,
    data: Sequence[Path],
    data_options: DataOptions,
    options: IdentifyOptions | None = None,
    model_options: ModelOptions = PLAIN,
    flat: Model | None = None,
    *,
    bootstrap: int = 0,
    others: bool = True,
) -> Identified:
    """Identify the model (default: that of daest.toml) from the recordings; not `others`: columns that are no
    signal of the model are not read."""
    from daest.cli.models import model_source
    from daest.cli.recordings import training_data
    from daest.cli.results import training_files
    from daest.estimation.fitting.profile import silent
    from daest.estimation.identify import identify
    from daest.model.fit import IdentifyOptions
    from daest.modelica.flat.clock import model_clock
    from daest.report.documents import fit as documents

    source = model_source(project, model)
    if flat is None:
        flat = model_options.load(project, source)
    loaded = flat
    flat, estimation, validation = training_data(loaded, project, data, data_options, others=others)
    hold = data_options.known_hold(project, flat, [*estimation, *validation])
    options = replace(options or IdentifyOptions(), hold=hold)
    is_long = bool(options.profile or bootstrap or options.starts > 1)
    with progress() if is_long else nullcontext(silent) as tell:
        result = identify(flat, estimation, options, validation, tell)
        if bootstrap:
            from daest.estimation.bootstrap import with_bootstrap

            result = with_bootstrap(result, flat, estimation, options, bootstrap, tell)
    if not result.is_converged:
        note(f"not converged: {result.message}")
    recordings = training_files(project, data)
    document = documents.document(result, model_clock(flat))
    return Identified(result, document, flat, loaded, source, recordings, estimation, validation)


def keep_fit(project: Project, found: Identified) -> None:
    """Leave the fit in the results of the project. Raises ConfigError `output-unwritable`."""
    from daest.cli.results import made_from, save_fit

    origin = made_from(project, [found.source], found.recordings)
    path = save_fit(project, found.source, found.loaded, found.document, origin)
    note(f"the fit is in {path}")


def _draw_profiles(found: Identified, plot: Path) -> None:
    from daest.report.result_figures import profile_figure

    draw(plot, lambda: profile_figure(found.result))


def _draw(found: Identified, plot: Path) -> None:
    from daest.diagnosis.comparison.compare import compare_models
    from daest.diagnosis.comparison.trial import fitted_candidate
    from daest.report.result_figures import fit_figure

    candidate = fitted_candidate(found.flat, found.result)
    comparison = compare_models([candidate], found.validation or found.estimation)
    draw(plot, lambda: fit_figure(found.result, comparison))
