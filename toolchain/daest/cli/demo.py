"""`daest demo`: a shipped example, copied and run."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from daest.cli.options import DataOptions, ModelOptions, example, format_option, one_of
from daest.cli.output import emit, note

if TYPE_CHECKING:
    from daest.report.documents.noise import NoiseDocument
    from daest.report.documents.project import DemoDocument


def _names() -> list[str]:
    from daest.data.examples import examples

    return [example.name for example in examples()]


@click.command("demo", epilog=example("daest demo servo"))
@click.argument("name", required=False, shell_complete=one_of(_names))
@format_option
def command(name: str | None, form: str) -> None:
    """Copy the example NAME into a new folder NAME, identify its parameters, compare it with its data.

    Without NAME, list the examples. Of an example without a recording, the noise report is shown. In a
    checkout of daest the new folder is made beside the checkout.
    """
    from daest.data.examples import examples

    if name is None:
        entries = [
            {"name": e.name, "description": e.description, "has_recording": e.has_recording}
            for e in examples()
        ]
        emit({"examples": entries}, "demo", form, None, _list_text)
    else:
        emit(_run(name), "demo", form, None, _run_text)


def _run(name: str) -> DemoDocument:
    from daest.cli.compare import keep_comparison, opened
    from daest.cli.identify import identified, keep_fit
    from daest.data.examples import copy_example, demo_folder
    from daest.data.project import load_project
    from daest.diagnosis.comparison.compare import compare_models
    from daest.report.documents import compare as documents

    folder = demo_folder(name, Path.cwd())
    if not copy_example(name, folder).has_recording:
        note(f"copied to {folder}; it has no recording to identify from, see its README.md")
        return {"folder": str(folder), "identify": None, "compare": None, "noise": _noise(folder)}
    note(f"copied to {folder}; the same by hand: cd {folder}; daest identify; daest compare")
    project = load_project(folder)
    fit = identified(project, None, (), DataOptions())
    keep_fit(project, fit)
    comparison = compare_models(*opened(project, (), (), DataOptions()))
    keep_comparison(project, (), (), comparison)
    note(
        f"what next: cd {folder}; daest diagnose (what the model lacks); daest report (all of it in one page)"
    )
    return {
        "folder": str(folder),
        "identify": fit.document,
        "compare": documents.document(comparison),
        "noise": None,
    }


def _noise(folder: Path) -> NoiseDocument:
    """The noise report of the example's model."""
    from daest.cli.linear import load_linear
    from daest.data.project import load_project
    from daest.report.documents import noise as documents
    from daest.systems.linear.noise import noise_report

    return documents.document(
        noise_report(load_linear(load_project(folder), None, ModelOptions(), {}, None).dae)
    )


def _list_text(document: Mapping[str, Any], width: int, color: bool) -> str:
    from daest.report.console import rendered, table

    rows = [
        (entry["name"], "yes" if entry["has_recording"] else "no", entry["description"])
        for entry in document["examples"]
    ]
    return rendered([table(("example", "recording", "what it is"), rows, (0, 1, 2))], width, color)


def _run_text(document: Mapping[str, Any], width: int, color: bool) -> str:
    from daest.report.texts import compare, identify, noise

    if document["noise"] is not None:
        return noise.text(document["noise"], width, color)
    return "\n".join(
        (
            identify.text(document["identify"], width, color),
            compare.text(document["compare"], width, color),
        )
    )
