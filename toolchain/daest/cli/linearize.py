"""`daest linearize`: the linear DAE of a model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from daest.cli.given import Files, files
from daest.cli.options import (
    ModelOptions,
    draw,
    example,
    model_options,
    result_options,
    set_option,
)
from daest.cli.output import emit, keep_inputs, note, whole_file

if TYPE_CHECKING:
    from daest.cli.linear import Linear
    from daest.model.linear import SparseForm, StandardForm
    from daest.report.documents.linearize import LinearizeDocument
    from daest.systems.linear.transfer import TransferFunction

ARRAYS = (".npz", ".mat")


@click.command("linearize", epilog=example("daest linearize servo.fmu --set k=0.06 -o servo.npz"))
@files("[MODEL]", "model", None)
@set_option
@click.option(
    "--at",
    metavar="FILE.json",
    type=click.Path(path_type=Path),
    help="Parameters of a fit, and the operating point of a nonlinear model.",
)
@click.option(
    "--symbolic", is_flag=True, help="Show the expressions of the entries that depend on parameters."
)
@click.option("--source", "route", metavar="SOURCE", help="For an FMU: where the matrices come from.")
@model_options
@result_options
def command(
    files: Files,
    settings: Mapping[str, float],
    at: Path | None,
    symbolic: bool,
    route: str | None,
    model_options: ModelOptions,
    form: str,
    output: Path | None,
    plot: Path | None,
) -> None:
    """E, J, K, B, C, D of MODEL (a .mo file or any FMU), with names, units and places; poles, transfer
    functions.

    With -o and a name in .npz or .mat the matrices are written as arrays.
    """
    from daest.cli.linear import load_linear
    from daest.report.arrays import save_arrays
    from daest.report.frequency_figure import linear_figure
    from daest.report.texts import linearize as texts
    from daest.systems.linear.standard_form import standard_form
    from daest.systems.linear.transfer import poles, transfer_functions

    project = model_options.project()
    model = files.model
    keep_inputs(output, [model, at])
    linear = load_linear(project, model, model_options, settings, at, route)
    standard = standard_form(linear.dae)
    functions = transfer_functions(linear.dae, standard)
    document = _document(linear, standard, functions)
    draw(plot, lambda: linear_figure(functions, poles(standard), document["units"]))
    if output is not None and output.suffix in ARRAYS:
        with whole_file(output) as temporary:
            save_arrays(linear.dae, temporary)
        note(f"the matrices are in {output}")
        output = None
    emit(document, "linearize", form, output, partial(texts.text, symbolic=symbolic))


def _document(
    linear: Linear, standard: StandardForm | SparseForm, functions: Sequence[TransferFunction]
) -> LinearizeDocument:
    from daest.report.documents import linearize as documents
    from daest.systems.linear.linearize import theta_entries

    theta = theta_entries(linear.flat, linear.at) if linear.flat is not None else []
    return documents.document(linear.dae, standard, functions, theta, linear.cross_check)
