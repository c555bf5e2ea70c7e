"""`daest compare`: models side by side on data that they have not seen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from daest.cli.given import Files, ParameterOptions, files, parameter_options
from daest.cli.options import (
    PLAIN,
    DataOptions,
    ModelOptions,
    cluster_option,
    data_options,
    draw,
    example,
    jobs_option,
    model_options,
    require_cluster,
    result_options,
    seed_option,
)
from daest.cli.output import emit, keep_inputs, note, telling
from daest.errors import ConfigError, Place
from daest.model.defaults import LEAST_NULL_RECORDS

if TYPE_CHECKING:
    import numpy as np

    from daest.data.project import Project
    from daest.diagnosis.comparison.trial import Candidate
    from daest.model.comparison import Comparison
    from daest.model.experiment import Experiment
    from daest.model.flat import Model
    from daest.model.holds import Hold


@click.command("compare", epilog=example("daest compare Servo.mo ServoFriction.mo run2.csv"))
@files("[MODEL]... [DATA]...", "model")
@parameter_options
@click.option("--refit", is_flag=True, help="Identify every model anew, on [data] estimate.")
@click.option(
    "--bootstrap",
    type=click.IntRange(min=LEAST_NULL_RECORDS),
    metavar="N",
    help=f"Calibrate the tests with N simulated records (at least {LEAST_NULL_RECORDS}), for short "
    "recordings.",
)
@jobs_option
@cluster_option
@click.option("--fail-below", type=float, metavar="PERCENT", help="Exit 1 if a model fits an output worse.")
@click.option("--fail-if-falsified", is_flag=True, help="Exit 1 if the data contradict a model.")
@model_options
@data_options
@result_options
@seed_option
def command(
    files: Files,
    parameters: ParameterOptions,
    refit: bool,
    bootstrap: int | None,
    jobs: int,
    cluster: str | None,
    fail_below: float | None,
    fail_if_falsified: bool,
    model_options: ModelOptions,
    data_options: DataOptions,
    form: str,
    output: Path | None,
    plot: Path | None,
    seed: int,
) -> int:
    """Error of every MODEL on the recordings DATA, in simulation and ahead of the data, with the parameters
    of its own fit; whether the data contradict it, and where it fails.

    Models and recordings are by default those of daest.toml.
    """
    from daest.diagnosis.comparison.compare import compare_models
    from daest.report.comparison_figure import comparison_figure
    from daest.report.documents import compare as documents
    from daest.report.texts import compare as texts

    project = model_options.project()
    models, data = files.models, files.data
    keep_inputs(output, files.all)
    _require_use(parameters, refit)
    require_cluster(cluster)
    chosen, experiments = opened(
        project, models, data, data_options, model_options, refit=refit, seed=seed, parameters=parameters
    )
    found = compare_models(
        chosen,
        experiments,
        bootstrap=bootstrap or 0,
        seed=seed,
        jobs=jobs,
        cluster=cluster,
    )
    with telling(lambda: emit(documents.document(found), "compare", form, output, texts.text)):
        keep_comparison(project, models, data, found)
        draw(plot, lambda: comparison_figure(found))
    too_low = fail_below is not None and _is_below(found, fail_below)
    falsified = fail_if_falsified and any(trial.verdict == "falsified" for trial in found.models)
    return int(too_low or falsified)


def keep_comparison(
    project: Project, models: Sequence[Path], data: Sequence[Path], found: Comparison
) -> None:
    """Leave the comparison in the results of the project, for `daest report`."""
    from daest.cli.models import model_source
    from daest.cli.results import keep, made_from, unseen_files
    from daest.report.documents import compare as documents

    sources = [model_source(project, path) for path in models] or [model_source(project, None)]
    origin = made_from(project, sources, unseen_files(project, data))
    keep(project, "comparison", "compare", documents.document(found), origin, documents.series(found))


def opened(
    project: Project,
    models: Sequence[Path],
    data: Sequence[Path],
    options: DataOptions,
    model_options: ModelOptions = PLAIN,
    *,
    refit: bool = False,
    seed: int = 0,
    parameters: ParameterOptions | None = None,
) -> tuple[list[Candidate], list[Experiment]]:
    """The models with the values of their fits, and the recordings that they are compared on."""
    from daest.cli.models import model_source, with_settings
    from daest.cli.recordings import unseen_data

    sources = [model_source(project, path) for path in models] or [model_source(project, None)]
    flats = [model_options.load(project, source) for source in sources]
    measured, experiments = unseen_data(flats[0], project, data, options)
    held = {} if parameters is None else parameters.held
    for name, value in held.items():
        if not any(_own({name: value}, flat) for flat in flats):
            with_settings(flats[0], {name: value})  # says which names there are
    candidates = []
    for source, flat in zip(sources, flats, strict=True):
        if refit:
            candidates.append(_refitted(project, source, flat, options, seed, parameters))
        else:
            candidate = _candidate(project, source, flat, options, experiments)
            candidates.append(replace(candidate, flat=with_settings(candidate.flat, _own(held, flat))))
    names = measured.output_names
    return [_on(each, names, source) for each, source in zip(candidates, sources, strict=True)], experiments


def _own(held: Mapping[str, float], flat: Model) -> dict[str, float]:
    """Those of the values whose parameters the model has."""
    known = set(flat.parameter_names)
    return {name: value for name, value in held.items() if name in known}


def _candidate(
    project: Project, source: Path, flat: Model, options: DataOptions, experiments: Sequence[Experiment]
) -> Candidate:
    from daest.cli.results import find_fit
    from daest.diagnosis.comparison.trial import Candidate

    fit = find_fit(project, source, flat)
    if fit is None:
        hold = options.chosen_hold(project, flat, experiments)
        return Candidate(flat.name, flat, 0, hold, notes=("no fit found: the values of the model are used",))
    hold = options.chosen_hold(project, flat, experiments, fit.document)
    return _with_fit(flat, fit.document, hold, (f"fit of {fit.path}", *fit.remarks))


def _refitted(
    project: Project,
    source: Path,
    flat: Model,
    options: DataOptions,
    seed: int,
    parameters: ParameterOptions | None,
) -> Candidate:
    from daest.cli.identify import identified, keep_fit
    from daest.model.fit import IdentifyOptions

    choice = IdentifyOptions(seed=seed)
    if parameters is not None:
        choice = parameters.among(choice)
    fit = identified(project, source, (), options, choice, flat=flat)
    try:
        keep_fit(project, fit)
    except ConfigError as problem:
        note(f"the fit of {flat.name} is not kept: {problem.what}")
    return _with_fit(flat, fit.document, fit.result.hold, ())


def _with_fit(flat: Model, document: Mapping[str, Any], hold: Hold, notes: tuple[str, ...]) -> Candidate:
    import numpy as np

    from daest.cli.results import fitted
    from daest.diagnosis.comparison.trial import Candidate

    names, cov = parameter_covariance(document)
    known = set(flat.parameter_names)
    kept = [i for i, name in enumerate(names) if name in known]
    return Candidate(
        name=flat.name,
        flat=fitted(flat, document),
        n_parameters=len(document["parameters"]),
        hold=hold,
        sampled=document.get("noise_model") or "white",
        notes=notes,
        parameter_names=tuple(names[i] for i in kept),
        parameter_cov=cov[np.ix_(kept, kept)] if kept else None,
        n_estimation=document.get("n_samples"),
    )


def parameter_covariance(document: Mapping[str, Any]) -> tuple[tuple[str, ...], np.ndarray]:
    """Names and covariance of the parameters of a fit that the data determined. Shapes: covariance (p, p)."""
    import numpy as np

    std = {
        name: entry["std_error"]
        for name, entry in document["parameters"].items()
        if isinstance(entry, Mapping) and entry.get("std_error") is not None
    }
    correlation = document.get("correlation") or {"names": [], "matrix": []}
    names = tuple(name for name in std if name in correlation["names"])
    index = [correlation["names"].index(name) for name in names]
    table = np.array(correlation["matrix"], dtype=float).reshape(len(correlation["names"]), -1)
    part = np.nan_to_num(table[np.ix_(index, index)]) if names else np.zeros((0, 0))
    np.fill_diagonal(part, 1.0)
    sizes = np.array([std[name] for name in names])
    return names, part * np.outer(sizes, sizes)


def _on(candidate: Candidate, names: Sequence[str], source: Path) -> Candidate:
    from daest.modelica.change import with_outputs

    missing = [name for name in names if name not in candidate.flat.output_names]
    if missing:
        raise ConfigError(
            "compare-missing-output",
            f"{candidate.name} has no output {', '.join(missing)}",
            where=Place(str(source)),
            remedy="compare models with the same outputs; [data] outputs in daest.toml can declare them",
        )
    return replace(candidate, flat=with_outputs(candidate.flat, names))


def _require_use(parameters: ParameterOptions, refit: bool) -> None:
    """Raises ConfigError `option-contradiction` for a choice of estimates where nothing is estimated."""
    if refit or not (parameters.estimate or parameters.prior):
        return
    raise ConfigError(
        "option-contradiction",
        "--estimate and --prior are given, and nothing is estimated",
        remedy="add --refit, or leave them out",
    )


def _is_below(comparison: Comparison, limit: float) -> bool:
    fits = [fit for trial in comparison.models for fit in trial.simulation.fit_percent.values()]
    return any(fit is None or fit < limit for fit in fits)
