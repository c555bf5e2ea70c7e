"""`daest fleet`: one model, many machines."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote

import click

from daest.cli.given import Files, ParameterOptions, files, parameter_options
from daest.cli.options import (
    DataOptions,
    ModelOptions,
    cluster_option,
    example,
    format_option,
    jobs_option,
    model_options,
    output_option,
    require_cluster,
    seed_option,
    split_data_options,
)
from daest.cli.output import emit, keep_inputs, note, telling, whole_file, write_text
from daest.cli.progress import progress
from daest.errors import ConfigError, DaestError, DataError, Place

if TYPE_CHECKING:
    from daest.data.project import Project
    from daest.diagnosis.fleet import FleetOptions, Recorded
    from daest.model.flat import Model
    from daest.model.fleet import Machine

KEPT = "fleet.jsonl"  # in the folder of the results
PARQUET, CSV = ".parquet", ".csv"


@click.command(
    "fleet", epilog=example("daest fleet machines/ --model Servo.mo -o fleet.parquet --html fleet.html")
)
@files("[MODEL] RECORDINGS...")
@parameter_options
@click.option(
    "--effect", "effects", metavar="NAME", multiple=True, help="Try this effect alone (default: all)."
)
@click.option("--no-diagnose", is_flag=True, help="Tell which machines falsify the model, and not why.")
@click.option("--html", metavar="FILE", type=click.Path(path_type=Path), help="Write a page of all machines.")
@jobs_option
@cluster_option
@model_options
@split_data_options
@format_option
@output_option
@seed_option
def command(
    files: Files,
    parameters: ParameterOptions,
    effects: tuple[str, ...],
    no_diagnose: bool,
    html: Path | None,
    jobs: int,
    cluster: str | None,
    model_options: ModelOptions,
    data_options: DataOptions,
    form: str,
    output: Path | None,
    seed: int,
) -> None:
    """Identify the model for every machine, hold the fit against unseen data, and diagnose where that fails.

    RECORDINGS are files, one for each machine, or folders of them. The first half of each estimates
    (--split gives another share), the rest judges. A recording that cannot be read or fitted does not stop
    the others; machines that are done are kept in results/fleet.jsonl, and a run that was interrupted goes
    on.
    """
    from daest.cli.models import model_source
    from daest.diagnosis.fleet import HALF, FleetOptions, summary
    from daest.modelica.effects.catalogue import effect_library, find_effects, library_digest
    from daest.report.documents import fleet as documents
    from daest.report.page.render import fleet_page
    from daest.report.texts import fleet as texts

    began = time.perf_counter()
    project = model_options.project()
    recordings = machine_files(files.data)
    keep_inputs(output, [*(path for _, path in recordings), *files.models])
    require_cluster(cluster)
    source = model_source(project, files.model)
    flat = parameters.applied(model_options.load(project, source))
    folders = model_options.folders(project)
    for name in effects:
        find_effects(name, folders)
    options = FleetOptions(
        hold=data_options.told_hold(project, flat),
        split=data_options.preparation(project).split or HALF,
        diagnoses=not no_diagnose and flat.has_equations,
        effects=effects,
        seed=seed,
        jobs=jobs,
        cluster=cluster,
        library=effect_library(folders),
    )
    with progress() as tell:
        binary = b"" if flat.has_equations else source.read_bytes()
        task = Task(project, flat, data_options, options, binary, library_digest(folders))
        machines = _examined(task, recordings, tell)
    if all(machine.status == "failed" for machine in machines):
        raise ConfigError(
            "fleet-nothing",
            f"none of {len(machines)} machines could be examined; {machines[0].name}: {machines[0].message}",
            remedy="try daest identify with one of the recordings",
        )
    found = summary(machines)
    document = documents.document(found, flat.name, time.perf_counter() - began)
    is_table = output is not None and output.suffix.lower() in (PARQUET, CSV)
    with telling(lambda: emit(document, "fleet", form, None if is_table else output, texts.text)):
        if is_table and output is not None:
            _write_table(output, documents.columns(found))
            note(f"the table of the machines is in {output}")
        if html is not None:
            write_text(fleet_page(document), html)
            note(f"the page is {html}")


def machine_files(recordings: Sequence[Path]) -> list[tuple[str, Path]]:
    """Names of machines and their files: the stems, the value of the partition in a partitioned dataset
    (`machine=m1/part-0.parquet` is m1), or the paths where two are alike. Raises DataError `fleet-empty`, and
    `data-missing-file` for a file that was named and is not there."""
    from daest.data import FORMATS

    if not recordings:
        raise ConfigError(
            "data-not-given",
            "no recording is given",
            remedy="name the recordings of the machines, or folders of them",
        )
    files: list[Path] = []
    for path in recordings:
        if path.is_dir():
            files += sorted(p for p in path.rglob("*") if p.suffix.lower() in FORMATS and p.is_file())
        elif not path.exists():
            raise DataError("data-missing-file", "the recording does not exist", where=Place(str(path)))
        else:
            files.append(path)
    files = list(dict.fromkeys(files))
    if not files:
        raise DataError(
            "fleet-empty",
            f"there is no recording in {', '.join(str(path) for path in recordings)}",
            remedy=f"name files, or folders with files that end in {', '.join(sorted(FORMATS))}",
        )
    names = [_machine_name(path) for path in files]
    counted = Counter(names)
    return [(str(path) if counted[name] > 1 else name, path) for name, path in zip(names, files, strict=True)]


def _machine_name(path: Path) -> str:
    """The stem of a file, or the last value of the partition that it lies in."""
    _, is_partition, value = path.parent.name.partition("=")
    return unquote(value) if is_partition and value else path.stem


@dataclass(frozen=True)
class Task:
    """What is done with every file. `binary`: an FMU that carries no equations; `library`: a hash of the
    library of effects."""

    project: Project
    flat: Model
    data_options: DataOptions
    options: FleetOptions
    binary: bytes
    library: str


def _examined(task: Task, files: Sequence[tuple[str, Path]], tell: Callable[[str], None]) -> list[Machine]:
    """All machines in the order of the files; those that are done are not examined again."""
    from daest.diagnosis.fleet import FAILED, examine_fleet
    from daest.diagnosis.kept import run_digest
    from daest.diagnosis.kept_fleet import keep_machine, machines_done

    kept = task.project.results / KEPT
    digest = run_digest(task.flat, (), (), _decisive(task))
    keys = {name: _key(path, digest) for name, path in files}
    done = machines_done(kept)
    known = {name: replace(done[key], name=name) for name, key in keys.items() if key in done}
    todo = [(name, path) for name, path in files if name not in known]
    if known:
        note(f"{len(known)} of {len(files)} machines were done before, as {kept} has them")
    n_done = len(known)
    is_kept = True

    def arrived(machine: Machine) -> None:
        nonlocal n_done, is_kept
        n_done += 1
        tell(f"{n_done} of {len(files)} machines; {machine.name}: {machine.verdict or machine.status}")
        if machine.status == FAILED or not is_kept:
            return
        try:
            keep_machine(kept, keys[machine.name], machine)
        except OSError as problem:
            is_kept = False
            note(f"machines are not kept for a later run: {problem.strerror or problem}")

    for machine in examine_fleet(_recorded(task, todo), task.options, arrived):
        known[machine.name] = machine
    return [known[name] for name, _ in files]


def _decisive(task: Task) -> list[Any]:
    """All that a machine's result rests on besides the model, its recording and the program."""
    options, project = task.options, task.project
    columns = [sorted(given.items()) for given in (project.inputs, project.outputs, project.units)]
    preparation = replace(task.data_options.preparation(project), split=options.split)
    searched = (options.hold, options.diagnoses, options.effects, options.seed)
    return [*searched, preparation, project.time, *columns, task.binary, task.library]


def _key(path: Path, digest: str) -> str:
    from daest.diagnosis.kept_fleet import recording_key

    try:
        return recording_key(path, digest)
    except OSError:
        return ""


def _recorded(task: Task, files: Iterable[tuple[str, Path]]) -> Iterator[Recorded]:
    """The recordings as they are read, one after the other."""
    from daest.cli.recordings import signals, words_of
    from daest.data.read import measured_names, read_experiments, select_outputs
    from daest.diagnosis.fleet import Recorded
    from daest.modelica.change import with_outputs

    project = task.project
    words = {**words_of(project, task.flat), "others": True}
    for name, path in files:
        try:
            preparation = task.data_options.preparation(project)
            experiment = read_experiments([path], *signals(task.flat, project), preparation, **words)[0]
            outputs = measured_names([experiment])
            yield Recorded(name, with_outputs(task.flat, outputs), select_outputs(experiment, outputs))
        except DaestError as problem:
            yield Recorded(name, error=problem)
        except OSError as problem:
            what = problem.strerror or str(problem)
            yield Recorded(name, error=DataError("data-unreadable-file", what, where=Place(str(path))))


def _write_table(path: Path, columns: dict[str, list[object]]) -> None:
    import pyarrow as pa
    from pyarrow import csv, parquet

    table = pa.table({name: pa.array(values) for name, values in columns.items()})
    with whole_file(path) as temporary:
        if path.suffix.lower() == PARQUET:
            parquet.write_table(table, temporary)
        else:
            csv.write_csv(table, temporary)
