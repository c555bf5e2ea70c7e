"""`daest app`: the live page of a project."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import click

from daest.cli.options import example, format_option
from daest.cli.output import emit


@click.command("app", epilog=example("daest app servo", "daest app --port 8765 --no-browser"))
@click.argument("folder", required=False, type=click.Path(path_type=Path), default=Path("."))
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=0,
    metavar="N",
    help="Listen there, on this machine alone (default: any that is free).",
)
@click.option("--no-browser", is_flag=True, help="Print the address, and open no browser.")
@click.option("--follow", "model", metavar="MODEL", hidden=True, type=click.Path(path_type=Path))
@click.option("--beside", "extended", metavar="MODEL", hidden=True, type=click.Path(path_type=Path))
@format_option
def command(
    folder: Path, port: int, no_browser: bool, model: Path | None, extended: Path | None, form: str
) -> None:
    """Open the project in FOLDER (default: here) as a page in the browser.

    Compare, move parameters, search for what is missing, add it, and watch the error fall. Every click is a
    daest command, which the page shows; its results are files of the folder. The first line of stdout is the
    address, which holds a secret. Ctrl-C ends the page; work that runs goes on.
    """
    if model is not None and extended is not None:
        _beside(model, extended)
        return
    if model is not None:
        _follow(model)
        return
    from daest.app.server import serve

    def tell(address: str) -> None:
        document = {"address": address, "folder": str(folder.resolve())}
        emit(document, "app", form, None, lambda *_, **__: f"{address}\n")

    serve(folder, port, not no_browser, tell)


def _follow(model: Path) -> None:
    """Simulate the model at the values that lines on stdin name: what the server starts for the sliders."""
    from daest.app.following import follow
    from daest.cli.compare import opened
    from daest.cli.options import DataOptions
    from daest.data.project import load_project

    (candidate,), experiments = opened(load_project(None), [model], (), DataOptions())
    variances = () if candidate.parameter_cov is None else candidate.parameter_cov.diagonal()
    errors = {
        name: float(variance) ** 0.5
        for name, variance in zip(candidate.parameter_names, variances, strict=True)
    }
    follow(candidate, experiments, errors, sys.stdin, lambda answer: print(json.dumps(answer), flush=True))


def _beside(model: Path, extended: Path) -> None:
    """Simulate a model and the same with a candidate on the data: what the server starts for a candidate that
    is opened."""
    from daest.app.following import beside
    from daest.cli.compare import opened
    from daest.cli.options import DataOptions
    from daest.data.project import load_project

    (base, other), experiments = opened(load_project(None), [model, extended], (), DataOptions())
    print(json.dumps(beside(base, other, experiments)), flush=True)
