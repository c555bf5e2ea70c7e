"""`daest export --estimator`: the estimator of a fitted model as an FMU, or as C."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from daest.cli.options import TOLD_HOLD, gathered, hold_form
from daest.cli.output import emit, keep_inputs, whole_file
from daest.errors import ConfigError

if TYPE_CHECKING:
    from daest.data.project import Project
    from daest.fmu.estimator_code import EstimatorModel
    from daest.model.flat import Model
    from daest.model.fmu import EstimatorExport
    from daest.model.holds import Hold


@dataclass(frozen=True)
class EstimatorOptions:
    """What the command line says of an estimator; `wanted` without which the others make no sense."""

    wanted: bool = False
    kind: Any = None
    only: tuple[str, ...] = ()
    folder: Path | None = None
    is_float: bool = False
    version: Literal["2.0", "3.0"] = "3.0"
    step: float | None = None
    hold: Hold | None = None


estimator_options = gathered(
    "estimator",
    EstimatorOptions,
    click.option("--estimator", "wanted", is_flag=True, help="Export a state estimator of the fitted model."),
    click.option(
        "--kind",
        type=click.Choice(["stationary", "kalman", "ekf", "ukf"]),
        help="Kind of the estimator (default: kalman, ekf for a nonlinear model).",
    ),
    click.option("--only", metavar="NAME", multiple=True, help="Estimate this variable alone."),
    click.option(
        "--c", "folder", metavar="FOLDER", type=click.Path(path_type=Path), help="Write C99 there, no FMU."
    ),
    click.option("--float", "is_float", is_flag=True, help="With --c: single precision."),
    click.option(
        "--fmi",
        "version",
        type=click.Choice(["2.0", "3.0"]),
        default="3.0",
        help="Version of FMI.",
    ),
    click.option(
        "--step",
        type=click.FloatRange(min=0.0, min_open=True),
        metavar="SECONDS",
        help="Expected time between two samples (default: that of the fit).",
    ),
    click.option(
        "--hold",
        metavar="HOLD",
        callback=hold_form,
        help="Inputs between samples: held (zoh), on straight lines (foh), or some held (zoh(NAME, ...)); "
        "default: as in the fit, but straight where that has smooth curves, which need later samples.",
    ),
)


def needs_estimator(options: EstimatorOptions) -> None:
    """Refuse options of an estimator where none is asked for. Raises ConfigError `estimator-option`."""
    given = {
        "--kind": options.kind, "--only": options.only, "--c": options.folder, "--float": options.is_float,
        "--step": options.step, "--hold": options.hold, "--fmi 2.0": options.version == "2.0",
    }  # fmt: skip
    wrong = [name for name, value in given.items() if value]
    if wrong:
        raise ConfigError(
            "estimator-option",
            f"{', '.join(wrong)} belongs to an estimator",
            remedy="add --estimator, or leave it out",
        )


def require_fmu_name(target: Path) -> None:
    """Raises ConfigError `export-suffix` for a file that is not called as an FMU."""
    if target.suffix.lower() != ".fmu":
        raise ConfigError(
            "export-suffix", f"an FMU is not called '{target.name}'", remedy="give a name that ends in .fmu"
        )


def export_estimator(
    project: Project,
    source: Path,
    flat: Model,
    options: EstimatorOptions,
    platforms: list[str] | None,
    form: str,
    output: Path | None,
) -> None:
    """Write the estimator of `flat` with its fit, if there is one, and tell what was written."""
    from daest.cli.results import with_fit
    from daest.estimation.streaming.estimator import estimator_model
    from daest.model.holds import FOH, checked_hold
    from daest.report.documents import export as documents
    from daest.report.texts import export as texts

    flat, found = with_fit(project, source, flat)
    fit = {} if found is None else found.document
    names = flat.input_names
    given = ((options.hold, "--hold"), (project.hold, TOLD_HOLD), (fit.get("hold"), "the fit"))
    hold = next((checked_hold(one, names, where) for one, where in given if one), None) or FOH
    period = options.step or fit.get("period")
    if not isinstance(period, int | float):
        raise ConfigError(
            "estimator-option",
            "nothing tells how often the estimator is called",
            remedy="give the expected time between two samples with --step, or run daest identify first",
        )
    model = estimator_model(flat, float(period), options.kind, hold, options.only)
    if options.folder is not None:
        written = _write_c(model, options.folder, options.is_float)
    else:
        written = _write_fmu(model, source, output, options, platforms)
    emit(documents.document(written), "export", form, None, texts.text)


def _write_fmu(
    model: EstimatorModel,
    source: Path,
    output: Path | None,
    options: EstimatorOptions,
    platforms: list[str] | None,
) -> EstimatorExport:
    from daest.fmu.estimator_fmu import export_estimator_fmu

    if options.is_float:
        raise ConfigError(
            "estimator-option", "an FMU computes in double precision", remedy="use --float with --c FOLDER"
        )
    target = output or Path(f"{source.stem}_estimator.fmu")
    require_fmu_name(target)
    keep_inputs(target, [source])
    return export_estimator_fmu(model, target, platforms, options.version)


def _write_c(model: EstimatorModel, folder: Path, is_float: bool) -> EstimatorExport:
    from daest.fmu.estimator_code import estimator_files
    from daest.fmu.estimator_readme import readme
    from daest.model.fmu import EstimatorExport

    began = time.perf_counter()
    texts = {**estimator_files(model, is_float=is_float), "README.md": readme(model, is_float=is_float)}
    for name, text in texts.items():
        with whole_file(folder / name, "name another folder with --c") as temporary:
            temporary.write_text(text, encoding="utf-8")
    return EstimatorExport(
        folder, model.name, "c", None, (), model.inputs, model.outputs, model.values, (),
        time.perf_counter() - began,
    )  # fmt: skip
