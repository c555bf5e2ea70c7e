"""`daest diagnose`: which physical effect a model lacks, where, and how sure that is."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from daest.cli import offered
from daest.cli.given import Files, ParameterOptions, files, parameter_options
from daest.cli.options import (
    PLAIN,
    DataOptions,
    ModelOptions,
    cluster_option,
    draw,
    example,
    gathered,
    jobs_option,
    listed_names,
    model_options,
    require_cluster,
    result_options,
    seed_option,
    split_data_options,
    time_limit_option,
)
from daest.cli.output import emit, keep_inputs, note, telling, whole_file
from daest.cli.progress import progress
from daest.errors import DaestError, EstimationError, FmuError, ModelError

if TYPE_CHECKING:
    from daest.cli.results import KeptFit
    from daest.data.project import Project
    from daest.diagnosis.answers.written import Written
    from daest.diagnosis.options import DiagnoseOptions
    from daest.model.diagnosis import Diagnosis
    from daest.model.effects import Effect
    from daest.model.experiment import Experiment
    from daest.model.flat import Model
    from daest.model.holds import Hold

RESULT = "diagnosis.json"
KEPT = "diagnosis"  # folder of the refits that are done
HALF = 0.5

Parts = tuple["list[Experiment]", "list[Experiment]"]  # recordings for estimation and for validation


@dataclass(frozen=True)
class Search:
    """What the command line says about the search: names of effects and places, where refits run, seed."""

    effects: tuple[str, ...] = ()
    places: tuple[str, ...] = ()
    jobs: int = 1
    cluster: str | None = None
    seed: int = 0


# Samples for estimation up to which recordings are diagnosed again as they are.
MOST_AS_RECORDED = 50_000
MANY_SAMPLES = 15_000  # for estimation, from which a hint tells how to come to an answer sooner, ...
MANY_TIMES = 4  # ... at that many of the recordings' own periods, where they do not tell which is sufficient
AS_RECORDED = (
    "errors that stay correlated in time may come from the coarser period: diagnosed at the recordings' own"
)
WITHOUT_UNITS = (
    "no variable of the model has a unit: friction, springs, leaks and all other laws of mechanics, "
    'circuits, heat and fluids have no place, and are not tried; declare units, as in Real v(unit = "m/s")'
)
NONE_ESTIMATED = (
    "no parameter is estimated, so that a value of the model that is off looks like a missing effect: name "
    "the unknown ones by --estimate"
)
OTHERS_HELD = (
    "--estimate holds {names}, estimated without it: a value that is off there looks like a missing effect; "
    "to estimate a parameter besides them, write estimate = true under [parameters] of daest.toml"
)

search_options = gathered(
    "search",
    Search,
    click.option(
        "--effect",
        "effects",
        metavar="NAME",
        multiple=True,
        shell_complete=offered.effects,
        callback=lambda _ctx, _param, given: listed_names(given),
        help="Try this effect (several: repeat, or with commas; default: all).",
    ),
    click.option(
        "--at",
        "places",
        metavar="PLACE",
        multiple=True,
        shell_complete=offered.places,
        help="Try this place (default: all).",
    ),
    jobs_option,
    cluster_option,
    seed_option,
)


@dataclass(frozen=True)
class Case:
    """A model with its recordings, and what it is searched for. `as_recorded` makes the same with the
    recordings at their own period, where these are coarser."""

    project: Project
    source: Path
    class_name: str | None
    folders: tuple[Path, ...]
    flat: Model
    estimation: list[Experiment]
    validation: list[Experiment]
    library: tuple[Effect, ...]
    options: DiagnoseOptions
    recordings: tuple[Path, ...] = ()
    remarks: tuple[str, ...] = ()  # on the earlier fit that is held against the data, and on the data
    as_recorded: Callable[[], Case] | None = None


@click.command("diagnose", epilog=example("daest diagnose Servo.mo run1.csv --split 0.5 --fix R=4.6"))
@files("[MODEL] [DATA]...")
@parameter_options
@time_limit_option("refit no further law, and tell what those say that were")
@search_options
@model_options
@split_data_options
@result_options
def command(
    files: Files,
    parameters: ParameterOptions,
    time_limit: float,
    search: Search,
    model_options: ModelOptions,
    data_options: DataOptions,
    form: str,
    output: Path | None,
    plot: Path | None,
) -> None:
    """Whether the model lacks a physical effect, where, and which one of the library.

    MODEL and the recordings DATA are by default those of daest.toml; columns that the model does not use are
    tried, too. Without validation data the second half of every recording validates. The result is written
    to results/diagnosis.json; an interrupted run goes on where it was.
    """
    from daest.report.diagnosis_figures import diagnosis_figure
    from daest.report.texts import diagnose as texts

    project = model_options.project()
    keep_inputs(output, files.all)
    case = opened(
        project,
        files.model,
        files.data,
        data_options,
        search,
        model_options,
        is_extended=False,
        parameters=parameters,
    )
    case, diagnosis = diagnosed(replace(case, options=replace(case.options, time_limit=time_limit).begun()))
    document = written_document(case, diagnosis)
    with telling(lambda: emit(document, "diagnose", form, output, texts.text)):
        keep_diagnosis(project, document, origin(case))
        draw(plot, lambda: diagnosis_figure(diagnosis, document["outputs"]))


def opened(
    project: Project,
    model: Path | None,
    data: Sequence[Path],
    data_choice: DataOptions,
    search: Search,
    model_options: ModelOptions = PLAIN,
    is_extended: bool = True,
    parameters: ParameterOptions | None = None,
) -> Case:
    """The model (default: that of daest.toml), its recordings, and the search with its names checked. A model
    that `is_extended` must have equations.

    Raises ModelError `effect-unknown`, `effect-place` or `effect-fit`, FmuError `fmu-no-equations`, and
    ConfigError of `workers`.
    """
    from daest.cli.models import chosen_class, model_source
    from daest.cli.recordings import training_data
    from daest.cli.results import training_files
    from daest.data.prepare import split_all
    from daest.diagnosis.screening.clipping import clips_of
    from daest.modelica.effects.catalogue import effect_library

    require_cluster(search.cluster)
    source = model_source(project, model)
    loaded = model_options.load(project, source)
    if not loaded.has_equations and is_extended:
        raise FmuError(
            "fmu-no-equations",
            "an FMU without equations cannot be extended",
            where=str(source),
            remedy="use the Modelica source, or an FMU of daest export; daest diagnose tells what shows from "
            "outside",
        )
    chosen = loaded if parameters is None else parameters.applied(loaded)
    others = [] if parameters is None else _left_out(loaded, parameters)
    if others:
        note(OTHERS_HELD.format(names=", ".join(others)))
    flat, estimation, validation = training_data(chosen, project, data, data_choice)
    if not validation:
        note("no validation data: the second half of every recording validates")
        halves = replace(data_choice.preparation(project), split=HALF)
        estimation, validation = split_all(estimation, halves)
    folders = model_options.folders(project)
    library, class_name = effect_library(folders), chosen_class(project, source, model_options.class_name)
    read = tuple(training_files(project, data))

    def case_of(parts: Parts, options: DiagnoseOptions, remarks: tuple[str, ...] = ()) -> Case:
        return _resumable(
            Case(project, source, class_name, folders, flat, *parts, library, options, read, remarks)
        )

    recorded = estimation, validation
    known_hold = data_choice.known_hold(project, flat, [*estimation, *validation])
    if not loaded.has_equations:
        names = _named_effects(search, folders)
        return case_of(recorded, _engine_options(search, names, search.places, known_hold))
    drive = _sufficient(flat, estimation, validation, project, data_choice)
    fit = _earlier_fit(project, source, loaded, drive.estimation)
    options = _options(flat, folders, search, drive.hold, fit)
    options = replace(options, clipped=clips_of([*estimation, *validation]), held=drive.held)
    straight = _straight(flat, drive.hold) if drive.held is None else ()
    remarks = (*(() if fit is None else fit.remarks), *drive.remarks, *straight)
    if fit is None and flat.parameters and not any(p.estimate for p in flat.parameters):
        note(NONE_ESTIMATED)
    units = [x.unit for x in flat.unknowns] + [u.unit for u in flat.inputs] + [y.unit for y in flat.outputs]
    if not any(units):
        note(WITHOUT_UNITS)
    case = case_of((drive.estimation, drive.validation), options, remarks)
    if drive.estimation is estimation or sum(e.n_samples for e in estimation) > MOST_AS_RECORDED:
        return case
    finer = replace(options, hold=known_hold, held=None)
    return replace(case, as_recorded=lambda: case_of(recorded, finer, (*remarks, AS_RECORDED)))


def _left_out(loaded: Model, parameters: ParameterOptions) -> list[str]:
    """The parameters that the model or daest.toml marks and --estimate does not name; those of --fix are held
    on purpose."""
    if not parameters.estimate:
        return []
    named = {*parameters.estimate, *parameters.fix}
    return [p.name for p in loaded.parameters if p.estimate and p.name not in named]


def _resumable(case: Case) -> Case:
    """The case whose refits are kept, so that an interrupted search goes on from them."""
    from daest.diagnosis.kept import KeptProofs, run_digest
    from daest.modelica.effects.catalogue import library_digest

    options = case.options
    binary = b"" if case.flat.has_equations else case.source.read_bytes()
    decisive = (
        options.effects, options.places, options.hold, options.seed, binary, library_digest(case.folders)
    )  # fmt: skip
    run = run_digest(case.flat, case.estimation, case.validation, decisive)
    return replace(
        case, options=replace(options, keeper=KeptProofs(case.project.results / KEPT, run, whole_file))
    )


def _straight(flat: Model, hold: Hold | None) -> tuple[str, ...]:
    """A remark where inputs cannot be held."""
    from daest.systems.reduction.input_slopes import acting_slopes, slope_note
    from daest.systems.reduction.reduce import dynamics

    if hold is not None:
        return ()
    derivatives = acting_slopes(dynamics(flat))
    remarks = slope_note(flat.input_names, [d.index for d in derivatives])
    for remark in remarks:
        note(remark)
    return remarks


@dataclass(frozen=True)
class _Drive:
    """Recordings and what their inputs do between the samples; `held` are those to take instead if the inputs
    of much finer recordings were held, where that is not known."""

    estimation: list[Experiment]
    validation: list[Experiment]
    hold: Hold | None
    held: tuple[list[Experiment], list[Experiment]] | None = None
    remarks: tuple[str, ...] = ()


def _sufficient(
    flat: Model,
    estimation: list[Experiment],
    validation: list[Experiment],
    project: Project,
    data_choice: DataOptions,
) -> _Drive:
    """The recordings; coarser, and on straight lines, where they are much finer than their outputs move and
    no period is asked for, with a remark that says so."""
    from daest.data.prepare import clear_period, resample, sufficient_period
    from daest.model.holds import FOH, ZOH

    hold = data_choice.known_hold(project, flat, [*estimation, *validation])
    if data_choice.preparation(project).period is not None:
        return _Drive(estimation, validation, hold)
    period = sufficient_period(estimation, validation)
    if period is not None:  # only then are the modes worth their linearisation
        period = sufficient_period(estimation, validation, _natural_frequencies(flat))
    own = estimation[0].period
    if period is None:
        n_samples = sum(e.n_samples for e in estimation)
        if n_samples > MANY_SAMPLES:
            coarser = clear_period(estimation, _natural_frequencies(flat))
            coarser = coarser or MANY_TIMES * (own or estimation[0].median_step)
            note(
                f"{n_samples} samples: to refit a law that bends on so many may take minutes; try "
                f"--resample {coarser:.4g} or a part (--to) first"
            )
        return _Drive(estimation, validation, hold)
    remark = (
        f"nothing in the outputs moves as fast as the recordings are sampled ({own:.4g} s): diagnosed at "
        f"{period:.4g} s, behind an anti-alias filter (--resample {own:.4g} keeps them as they are)"
    )
    note(remark)

    def coarse(hold: Hold) -> tuple[list[Experiment], list[Experiment]]:
        return [resample(e, period, hold) for e in estimation], [
            resample(e, period, hold) for e in validation
        ]

    if hold is not None:
        return _Drive(*coarse(hold), FOH, remarks=(remark,))
    return _Drive(*coarse(FOH), None, coarse(ZOH), (remark,))


def _natural_frequencies(flat: Model) -> list[float]:
    """Of the modes of the model at its start [Hz]; none where it cannot be linearised there."""
    import numpy as np

    from daest.systems.linear.state_space import state_space, state_space_family

    try:
        A = state_space(state_space_family(flat), flat.theta_values).A
    except DaestError:
        return []
    if not np.all(np.isfinite(A)):
        return []
    return [float(rate) / (2.0 * np.pi) for rate in np.abs(np.linalg.eigvals(A)) if rate > 0.0]


def _options(
    flat: Model, folders: Sequence[Path], search: Search, hold: Hold | None, fit: KeptFit | None
) -> DiagnoseOptions:
    """Options of the search, and the values of an earlier fit."""
    from daest.cli.results import parameter_values

    effects, places = _known(flat, search, folders)
    known = set(flat.parameter_names)
    values = {} if fit is None else parameter_values(fit.document)
    fitted = {name: value for name, value in values.items() if name in known}
    return replace(_engine_options(search, effects, places, hold), fitted=fitted)


def _engine_options(
    search: Search, effects: Sequence[str], places: Sequence[str], hold: Hold | None
) -> DiagnoseOptions:
    from daest.diagnosis.options import DiagnoseOptions

    return DiagnoseOptions(
        effects=tuple(effects),
        places=tuple(places),
        hold=hold,
        seed=search.seed,
        jobs=search.jobs,
        cluster=search.cluster,
    )


def _named_effects(search: Search, folders: Sequence[Path]) -> list[str]:
    """The effects of the search as the library calls them. Raises ModelError `effect-unknown`."""
    from daest.modelica.effects.catalogue import find_effects

    return [own for name in search.effects for own in _names(name, find_effects(name, folders))]


def _known(flat: Model, search: Search, folders: Sequence[Path]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of the effects and of the places as the search has them."""
    from daest.modelica.effects.catalogue import find_effects
    from daest.modelica.places.sites import find_effect_site, find_site

    groups = [find_effects(name, folders) for name in search.effects]
    for group in groups:
        if not search.places:
            _require_a_place(flat, group)
    places: list[str] = []
    for place in search.places:
        if not groups:
            places += [", ".join(part.strip() for part in place.split(",")), find_site(flat, place).name]
        for group in groups:
            places.append(find_effect_site(flat, group, place)[1].name)
    return tuple(dict.fromkeys(_named_effects(search, folders))), tuple(dict.fromkeys(places))


def _names(name: str, group: Sequence[Effect]) -> list[str]:
    """What the search calls the effects: by name, unless more of a class name than that was given."""
    return [name] if name == group[0].name else [effect.class_name for effect in group]


def _require_a_place(flat: Model, group: Sequence[Effect]) -> None:
    from daest.modelica.places.sites import fits, sites

    if any(fits(effect, site) for site in sites(flat) for effect in group):
        return
    domains = " or ".join(dict.fromkeys(effect.domain for effect in group))
    raise ModelError(
        "effect-fit",
        f"{group[0].name} ({domains}) fits nowhere in {flat.name}",
        remedy="Give another effect; daest effects --model MODEL lists where each fits.",
    )


def _earlier_fit(
    project: Project, source: Path, flat: Model, estimation: Sequence[Experiment]
) -> KeptFit | None:
    """A fit of this model to other recordings, whose values these data may contradict."""
    from daest.cli.results import find_fit

    found = find_fit(project, source, flat)
    if found is None:
        return None
    if _recordings(found.document.get("initial_state", {})) & _recordings(e.name for e in estimation):
        return None
    note(f"the values of {found.path} are held against the data")
    for remark in found.remarks:
        note(remark)
    return found


def _recordings(names: Iterable[str]) -> set[str]:
    """Names of the recordings, of which a split makes parts."""
    return {name.removesuffix(" (estimation)") for name in names}


def diagnosed(case: Case) -> tuple[Case, Diagnosis]:
    """The diagnosis, and the case that it is of: where nothing but a correlation of the errors in time speaks
    for a missing effect, and the filter of coarser recordings may have made that, the one at the period of
    the recordings, if it says more. Raises what the engine raises, and EstimationError `diagnose-unseen`."""
    from daest.diagnosis.diagnose import diagnose

    def found_in(case: Case) -> Diagnosis:
        return diagnose(case.flat, case.library, case.estimation, case.validation, case.options, show)

    with progress() as show:
        found = found_in(case)
        if found.is_by_colour and case.as_recorded is not None and not case.options.is_over:
            note(AS_RECORDED)
            finer = case.as_recorded()
            finer = replace(finer, options=replace(finer.options, until=case.options.until))
            again = found_in(finer)
            if not again.is_by_colour:
                case, found = finer, again
    _require_seen(case, found)
    return case, found


def _require_seen(case: Case, found: Diagnosis) -> None:
    """Where a place was named, silence about it must not be taken for an answer."""
    entries = found.screen.entries
    if not case.options.places or not entries or not all(e.absorbed for e in entries):
        return
    places = ", ".join(dict.fromkeys(e.candidate.site.name for e in entries))
    outputs = ", ".join(case.flat.output_names)
    raise EstimationError(
        "diagnose-unseen",
        f"the outputs {outputs} tell nothing about an effect at {places}: it does not reach them, or the "
        "estimated parameters would do the same",
        remedy="measure a motion, force or current nearer to the place, or fix parameters that are known",
    )


def written_document(case: Case, diagnosis: Diagnosis) -> dict[str, Any]:
    """The document of the diagnosis with the models that it found."""
    from daest.diagnosis.answers.written import written_load
    from daest.report.documents.diagnose import document

    load = None
    if diagnosis.learned is not None:
        load = written_load(case.source, case.class_name, diagnosis.learned, case.folders)
    return {**document(diagnosis, models_of(case, diagnosis), load), **context(case)}


def keep_diagnosis(project: Project, document: Mapping[str, Any], origin: Mapping[str, Any]) -> None:
    """Leave the diagnosis in the results of the project. Raises ConfigError `output-unwritable`."""
    from daest.cli.results import KEPT_ELSEWHERE, write_document

    path = project.results / RESULT
    write_document({**document, "made_from": origin}, "diagnose", path, KEPT_ELSEWHERE)
    note(f"the diagnosis is in {path}")


def models_of(case: Case, diagnosis: Diagnosis) -> dict[str, Written]:
    """Extended models of the candidates that are not rejected, by candidate name."""
    from daest.diagnosis.answers.written import Written, written_proof
    from daest.diagnosis.without_equations.black_box import NO_TEXT

    if not case.flat.has_equations:
        return {proof.candidate.name: Written(None, NO_TEXT) for proof in diagnosis.proofs}
    return {
        proof.candidate.name: written_proof(case.source, case.class_name, proof, case.folders)
        for proof in diagnosis.proofs
        if proof.verdict != "rejected"
    }


def origin(case: Case) -> dict[str, Any]:
    """Versions, and fingerprints of the model and of the recordings."""
    from daest.cli.results import made_from

    return made_from(case.project, [case.source], case.recordings)


def context(case: Case) -> dict[str, Any]:
    """What a result was made from."""
    return {
        "model": {"name": case.flat.name, "source": str(case.source)},
        "data": [e.name for e in case.estimation],
        "validated_on": [e.name for e in case.validation],
        "outputs": {o.name: o.unit for o in case.flat.outputs},
        "searched": {"effects": list(case.options.effects), "places": list(case.options.places)},
        "notes": list(case.remarks),
    }
