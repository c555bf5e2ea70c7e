"""`daest improve`: diagnose, add the effect, and again, until nothing is missing or nothing helps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from daest.cli.diagnose import AS_RECORDED, search_options
from daest.cli.given import Files, ParameterOptions, files, parameter_options
from daest.cli.options import (
    DataOptions,
    ModelOptions,
    draw,
    example,
    format_option,
    model_options,
    plot_option,
    split_data_options,
    time_limit_option,
)
from daest.cli.output import IMPROVED, LEDGER, emit, note, telling, write_text
from daest.cli.progress import progress
from daest.errors import ConfigError, DaestError, Place
from daest.files import passing_folder
from daest.model.defaults import MOST_EFFECTS

if TYPE_CHECKING:
    from daest.cli.diagnose import Case, Search
    from daest.diagnosis.answers.written import Written
    from daest.model.diagnosis import Improvement
    from daest.model.holds import Hold

PICTURE = "staircase.png"
CLOSE = 0.05  # relative difference of errors up to which a written model counts as the one that was fitted


@click.command("improve", epilog=example("daest improve Servo.mo run1.csv --split 0.5 --fix R=4.6"))
@files("[MODEL] [DATA]...")
@parameter_options
@click.option(
    "--max-effects",
    type=click.IntRange(min=1),
    default=MOST_EFFECTS,
    metavar="N",
    help=f"Stop after N effects (default: {MOST_EFFECTS}).",
)
@time_limit_option("tell the best model so far")
@search_options
@click.option(
    "-o",
    "--output",
    "folder",
    metavar="DIR",
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder of the models and the ledger (default: results/improve).",
)
@model_options
@split_data_options
@format_option
@plot_option
def command(
    files: Files,
    parameters: ParameterOptions,
    max_effects: int,
    time_limit: float,
    search: Search,
    folder: Path | None,
    model_options: ModelOptions,
    data_options: DataOptions,
    form: str,
    plot: Path | None,
) -> None:
    """Add missing effects one by one until nothing is missing or nothing helps.

    The folder gets the models step1_EFFECT.mo, step2_EFFECT.mo, ..., each extending the former, ledger.json
    and staircase.png, the error on validation data from step to step. An effect that no library holds is
    offered as a curve in unknown_effect.mo, and is the last step where it simulates unseen data better.
    """
    from daest.cli.diagnose import opened, origin
    from daest.report.diagnosis_figures import staircase_figure
    from daest.report.texts import improve as texts

    project = model_options.project()
    folder = folder or project.results / IMPROVED
    _require_own(folder)
    case = opened(
        project,
        files.model,
        files.data,
        data_options,
        search,
        model_options,
        parameters=parameters,
    )
    case = replace(case, options=replace(case.options, time_limit=time_limit))
    document, models = improved(case, folder, max_effects)
    shown = {**document, "folder": ""}
    with telling(lambda: emit(shown, "improve", form, None, texts.text)):
        _write(document, origin(case), models, folder)
        shown["folder"] = str(folder)
        draw(plot, lambda: staircase_figure(document))


def _require_own(folder: Path) -> None:
    """Refuse a folder with other content. Raises ConfigError `improve-folder`."""
    if not folder.is_dir() or (folder / LEDGER).is_file() or not any(folder.iterdir()):
        return
    raise ConfigError(
        "improve-folder",
        "the folder holds other files",
        where=Place(str(folder)),
        remedy="name a new or empty folder with -o",
    )


def improved(case: Case, folder: Path, most_effects: int) -> tuple[dict[str, Any], dict[str, str]]:
    """Improve the model; returns the document, and the texts of the models by the name of their file in
    `folder`."""
    from daest.cli.diagnose import context
    from daest.diagnosis.answers.written import LOAD_FILE, is_step, offered_load, with_names, written_steps
    from daest.diagnosis.improve import improve
    from daest.model.flat import with_equations
    from daest.report.documents.diagnose import improvement_document

    flat = with_equations(case.flat, "an extended model")
    with progress() as show:

        def found_in(case: Case) -> Improvement:
            return improve(
                flat, case.library, case.estimation, case.validation, case.options, most_effects, show
            )

        found = found_in(case)
        if found.last.is_by_colour and len(found.steps) == 1 and case.as_recorded is not None:
            note(AS_RECORDED)
            finer = case.as_recorded()
            finer = replace(finer, options=replace(finer.options, time_limit=case.options.time_limit))
            again = found_in(finer)
            if not again.last.is_by_colour or len(again.steps) > 1:
                case, found = finer, again
        show("writing the models")
        with passing_folder("daest-") as passing:
            models, names = written_steps(case.source, case.class_name, found, passing, case.folders)
            load = offered_load(case.source, case.class_name, found, models, names, passing, case.folders)
        unseen = _unseen(case, found.recorded_hold)
        written = models | ({len(found.steps): load} if is_step(load, found.last) else {})
        errors = _simulated(unseen, found, written)
    files = _files(models, found)
    document = {
        **with_names(improvement_document(found, files, load=load), names),
        **context(case),
        "folder": str(folder),
        "unknown_effect": None if load is None or load.extension is None else LOAD_FILE,
        "hold": found.recorded_hold if case.flat.inputs else None,
    }
    if document["unknown_effect"]:
        document["reason"] += f" The model with the curve is offered as {LOAD_FILE}."
    document["final"]["outputs"] = document["outputs"]
    for number, step in enumerate(document["steps"]):
        step["model_reason"] = written[number].reason if number in written else ""
        step["model_rms"] = errors.get(number)
        _compare(number, step)
    texts = {files[number]: models[number].text or "" for number in files}
    if load is not None and load.extension is not None:
        texts[LOAD_FILE] = load.extension.text
    return document, texts


def _unseen(case: Case, hold: Hold | None) -> Case:
    """The case with the validation data of the recordings' hold."""
    from daest.diagnosis.null_model.null import as_recorded

    held = case.options.held
    if held is None or hold is None:
        return case
    return replace(case, validation=list(as_recorded(case.validation, held[1], hold)))


def _simulated(
    case: Case, found: Improvement, models: Mapping[int, Written]
) -> dict[int, dict[str, float | None]]:
    """Errors of the written models on the validation data, by the number of the step, without those that
    cannot be simulated. While another process simulates, this one gets ready to draw."""
    from daest.diagnosis.answers.written import simulated_rms
    from daest.numerics.parallel import called, workers

    names, made = case.flat.output_names, {i: w.extension for i, w in models.items() if w.extension}
    holds = [*(step.fit.hold for step in found.steps), found.steps[-1].fit.hold]  # the last: of a curve
    tasks = [
        partial(simulated_rms, one.flat, names, models[i].columns, case.validation, holds[i])
        for i, one in made.items()
    ]
    errors = {}
    with workers(case.options.jobs) as pool:
        pool.begin(called, tasks)
        if tasks:
            import_module("matplotlib.figure")  # a second, which the picture takes in any case
        for (number, one), outcome in zip(made.items(), pool.map(called, tasks), strict=True):
            if isinstance(outcome.error, DaestError):
                note(f"{one.class_name} cannot be simulated: {outcome.error.what}")
            else:
                errors[number] = outcome.get()
    return errors


def _compare(number: int, step: dict[str, Any]) -> None:
    """Say so where a file does not do what was found."""
    for name, error in (step["model_rms"] or {}).items():
        expected = step["rms"]["validation"].get(name)
        if error is None or expected is None or abs(error - expected) > CLOSE * expected:
            of_file, of_fit = (f"{one:.4g}" if one is not None else "unknown" for one in (error, expected))
            note(f"the model of step {number} has the error {of_file} of {name}, the fit {of_fit}")


def _files(models: dict[int, Written], found: Improvement) -> dict[int, str]:
    from daest.diagnosis.answers.written import step_file

    return {
        number: step_file(number, proof.candidate)
        for number, written in models.items()
        if written.extension is not None and (proof := found.steps[number].proof) is not None
    }


def _write(
    document: dict[str, Any],
    made_from: dict[str, Any],
    texts: dict[str, str],
    folder: Path,
) -> None:
    """Models (by name of the file), picture and, last, the ledger; files of an earlier ledger that have no
    successor go."""
    from daest.cli.results import write_document
    from daest.report.diagnosis_figures import staircase_figure

    earlier = _earlier_files(folder)
    for name, text in texts.items():
        write_text(text, folder / name)
    draw(folder / PICTURE, lambda: staircase_figure(document))
    write_document({**document, "made_from": made_from}, "improve", folder / LEDGER)
    for name in earlier - set(texts):
        (folder / name).unlink(missing_ok=True)


def _earlier_files(folder: Path) -> set[str]:
    """Models that the ledger of an earlier run names."""
    from daest.cli.results import read_document

    if not (folder / LEDGER).is_file():
        return set()
    ledger = read_document(folder / LEDGER)
    names = {step.get("model") for step in ledger.get("steps", []) if isinstance(step, dict)}
    names.add(ledger.get("unknown_effect"))
    return {name for name in names if isinstance(name, str) and Path(name).name == name}
