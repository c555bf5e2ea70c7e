"""`daest report`: one HTML page of what stands in `results/`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from daest.cli.options import ModelOptions, example, format_option, model_options
from daest.cli.output import IMPROVED, LATEST, LEDGER, emit, keep_inputs, note, write_text
from daest.errors import ConfigError, DaestError, Place

if TYPE_CHECKING:
    import numpy as np

    from daest.data.project import Project
    from daest.model.flat import Model
    from daest.report.documents.project import ReportDocument
    from daest.report.page.material import Traced
    from daest.report.page.sections import Section

PAGE = "report.html"
# Part of the page -> document in results/, and the command that writes it.
DOCUMENTS = {
    "noise": ("noise.json", "noise"),
    "fit": (LATEST, "identify"),
    "comparison": ("comparison.json", "compare"),
    "filter": ("filter.json", "filter"),
    "diagnosis": ("diagnosis.json", "diagnose"),
    "design": ("design.json", "design"),
    "ledger": (f"{IMPROVED}/{LEDGER}", "improve"),
}


@click.command("report", epilog=example("daest report -o report.html"))
@click.option(
    "-o",
    "--output",
    metavar="FILE",
    type=click.Path(path_type=Path, allow_dash=True),
    help=f"Write the page there; - is stdout (default: {PAGE} beside daest.toml).",
)
@model_options
@format_option
def command(output: Path | None, model_options: ModelOptions, form: str) -> None:
    """Write one HTML page of the project: model, noise, estimates, comparison, diagnosis, what was added.

    It shows what the other commands have left in results/, says which one makes what is missing, and opens
    without a network. It stands beside daest.toml, unless -o names another place.
    """
    project = model_options.project()
    output = output or project.folder / PAGE
    keep_inputs(output, [project.source, *project.estimate, *project.validate])
    text, parts, remarks = report_page(project, model_options)
    write_text(text, output)
    for remark in remarks:
        note(remark)
    if str(output) != "-":
        emit({**_document(output, text, parts), "notes": list(remarks)}, "report", form, None, _summary)


def report_page(project: Project, options: ModelOptions) -> tuple[str, Sequence[Section], tuple[str, ...]]:
    """HTML of the report, its parts, and remarks on the model. Raises ConfigError `report-nothing`,
    `results-unreadable`."""
    from daest.report.page.material import Material
    from daest.report.page.render import page
    from daest.report.page.sections import sections

    documents = _documents(project)
    if not documents and project.source is None:
        raise ConfigError(
            "report-nothing",
            "there is neither a daest.toml with a model nor a result to report on",
            where=Place(str(project.results)),
            remedy="go to the folder of the project, or name its daest.toml with -p; daest init writes one",
        )
    flat, remarks = _model(project, options)
    ledger = documents.get("ledger")
    material = Material(
        title=project.folder.resolve().name if flat is None else flat.name,
        version=_version(),
        flat=flat,
        base=_text(project.source),
        sources=_sources(project, ledger),
        comparison_series=_series(project, "comparison", documents),
        filter_series=_series(project, "filter", documents),
        design_series=_series(project, "design", documents),
        trace=_trace(project, documents),
        versions=_versions(documents),
        remarks=remarks,
        **documents,
    )
    try:
        parts = sections(material)
        return page(material, parts), parts, remarks
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        raise ConfigError(
            "results-unreadable",
            f"a document is not of the form that daest writes: {type(error).__name__} {error}",
            where=Place(str(project.results)),
            remedy="run the commands again that made the documents there",
        ) from error


def _document(output: Path, text: str, parts: Sequence[Section]) -> ReportDocument:
    return {
        "path": str(output),
        "bytes": len(text.encode()),
        "parts": [
            {"id": p.id, "title": p.title, "present": p.present, "missing": p.made_by or None} for p in parts
        ],
    }


def _summary(document: Mapping[str, Any], width: int, color: bool) -> str:
    from daest.report.console import Paragraph, indented, rendered

    missing = [part for part in document["parts"] if not part["present"]]
    lines = [Paragraph(f"The report is in {document['path']} ({document['bytes'] / 1e6:.1f} MB).")]
    lines += [indented(f"not in it: {part['title']}; {part['missing'].replace('`', '')}") for part in missing]
    return rendered(lines, width, color)


def _documents(project: Project) -> dict[str, dict[str, Any]]:
    from daest.cli.results import read_document

    paths = {part: project.results / name for part, (name, _) in DOCUMENTS.items()}
    return {part: read_document(path) for part, path in paths.items() if path.is_file()}


def _model(project: Project, options: ModelOptions) -> tuple[Model | None, tuple[str, ...]]:
    """The model with the values of its fit, or why there is none."""
    from daest.cli.results import find_fit, fitted

    if project.source is None:
        return None, ()
    try:
        flat = options.load(project, None)
        fit = find_fit(project, project.source, flat)
    except DaestError as problem:
        return None, (f"The model cannot be read: {problem.what}",)
    return (flat, ()) if fit is None else (fitted(flat, fit.document), fit.remarks)


def _series(project: Project, part: str, documents: Mapping[str, dict[str, Any]]) -> dict[str, np.ndarray]:
    """The arrays beside a document. Raises ConfigError `results-unreadable`."""
    if part not in documents:
        return {}
    import zipfile

    import numpy as np

    path = project.results / f"{part}.npz"
    try:
        with np.load(path, allow_pickle=False) as stored:
            return {name: stored[name] for name in stored.files}
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise ConfigError(
            "results-unreadable",
            f"the series cannot be read: {error}",
            where=Place(str(path)),
            remedy=f"write them anew with daest {DOCUMENTS[part][1]}",
        ) from error


def _sources(project: Project, ledger: Mapping[str, Any] | None) -> dict[str, str]:
    """The models of an improvement, by file name, that still stand beside its ledger."""
    if ledger is None:
        return {}
    folder = project.results / "improve"
    names = [*(step.get("model") for step in ledger.get("steps", [])), ledger.get("unknown_effect")]
    texts = {name: _text(folder / name) for name in names if name and Path(name).name == name}
    return {name: text for name, text in texts.items() if text is not None}


def _text(path: Path | None) -> str | None:
    if path is None or path.suffix != ".mo" or not path.is_file():
        return None
    return path.read_text(encoding="utf-8-sig", errors="replace")


def _versions(documents: Mapping[str, dict[str, Any]]) -> dict[str, dict[str, str]]:
    found = {}
    for part, document in documents.items():
        origin = document.get("made_from")
        if origin:
            versions = {"daest": origin["daest"], "Python": origin["python"], **origin["packages"]}
            found[f"daest {DOCUMENTS[part][1]}"] = versions
    return found


def _trace(project: Project, documents: Mapping[str, dict[str, Any]]) -> tuple[Traced, ...]:
    """The files behind the results, each content once, with what has become of it."""
    from daest.cache import hash_of
    from daest.report.page.material import Traced

    used: dict[tuple[str, str, str], list[str]] = {}
    for part, document in documents.items():
        for file in document.get("made_from", {}).get("files", []):
            used.setdefault((file["role"], file["path"], file["sha256"]), []).append(DOCUMENTS[part][1])
    traced = []
    for (role, path, digest), commands in sorted(used.items()):
        now = project.folder / path
        state = "missing" if not now.is_file() else "same" if hash_of(now) == digest else "changed"
        traced.append(Traced(role, path, digest, state, tuple(commands)))
    return tuple(traced)


def _version() -> str:
    from daest import __version__

    return __version__
