"""`daest extend`: a Modelica model that extends another by one effect."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from daest.cli import offered
from daest.cli.given import Files, files
from daest.cli.options import ModelOptions, example, format_option, model_options, output_option, set_option
from daest.cli.output import emit, keep_inputs, note, write_text
from daest.errors import ConfigError, ModelError

DIAGNOSIS = "diagnosis.json"  # among the results

if TYPE_CHECKING:
    from daest.data.project import Project
    from daest.model.effects import Effect, Site
    from daest.model.flat import Model


@click.command(
    "extend",
    epilog=example("daest extend Servo.mo --effect CoulombFriction --at motor -o new.mo"),
)
@files("[MODEL]", "model", None)
@click.option(
    "--effect",
    "effect_name",
    metavar="NAME",
    required=True,
    shell_complete=offered.effects,
    help="Effect; daest effects lists them.",
)
@click.option(
    "--at",
    "place",
    metavar="PLACE",
    required=True,
    shell_complete=offered.places,
    help="Connector, component, input, output or signal inside.",
)
@set_option
@click.option("--name", "component", metavar="NAME", help="Name of the effect's component.")
@click.option("--new-class", metavar="NAME", help="Name of the extended model (default: MODEL_EFFECT).")
@click.option(
    "--input",
    "signals",
    metavar="SIGNAL=NAME",
    multiple=True,
    help="Input of the new model that supplies a measured signal of the effect.",
)
@model_options
@format_option
@output_option
def command(
    files: Files,
    effect_name: str,
    place: str,
    settings: dict[str, float],
    component: str | None,
    new_class: str | None,
    signals: tuple[str, ...],
    model_options: ModelOptions,
    form: str,
    output: Path | None,
) -> None:
    """Write a Modelica file that holds MODEL and, last, a model that extends it by an effect.

    --set gives values of the effect's parameters, or new ones of the model's own; those of the effect that
    are not given are as daest diagnose has found them (results/diagnosis.json), else as the library has them.
    Without -o the file goes to stdout.
    """
    from daest.cli.models import model_source
    from daest.modelica.compile import compile_model
    from daest.modelica.effects.catalogue import find_effects
    from daest.modelica.effects.extend import extend_model
    from daest.modelica.places.sites import find_effect_site
    from daest.report.documents.effects import extension_document
    from daest.report.texts import extend as texts

    project = model_options.project()
    model = files.model
    source = model_source(project, model)
    if source.suffix != ".mo":
        raise ModelError(
            "effect-no-source",
            f"{'Base Modelica' if source.suffix == '.bmo' else 'an FMU'} cannot be extended",
            where=str(source),
            remedy="Name the .mo file that it was made from.",
        )
    to_file = output is not None and str(output) != "-"
    keep_inputs(output, [source])
    folders = model_options.folders(project)
    chosen = model_options.class_name or (project.class_name if model is None else None)
    flat = compile_model(source, chosen, folders)
    effect, site = find_effect_site(flat, find_effects(effect_name, folders), place)
    values, parameters = _values(settings, effect, flat)
    values = {**_diagnosed(project, flat, effect, site), **values}
    extension = extend_model(
        source,
        chosen,
        effect,
        site,
        component,
        values,
        new_class,
        inputs=_signals(signals, effect),
        parameters=parameters,
        libraries=folders,
        target=output if to_file else None,
    )
    if to_file:
        write_text(extension.text, output)
    document = extension_document(
        effect,
        site,
        extension.class_name,
        extension.component,
        extension.text,
        str(output) if to_file else None,
    )
    emit(document, "extend", form, None, texts.text)


def _diagnosed(project: Project, flat: Model, effect: Effect, site: Site) -> dict[str, float]:
    """The effect's parameters as the diagnosis of this model has found them there, its form included;
    none where it has not."""
    path = project.results / DIAGNOSIS
    if not path.is_file():
        return {}
    from daest.cli.results import read_document

    document = read_document(path)
    if (document.get("model") or {}).get("name") != flat.name:
        return {}
    places = {site.name, *site.aliases}
    for found in document.get("candidates", []):
        there = {found.get("at"), *found.get("equivalent_places", [])}
        if found.get("class") != effect.class_name or not places & there:
            continue
        known = {p.name for p in effect.parameters}
        sizes = {name: p["value"] for name, p in found["parameters"].items() if name in known}
        note(f"sizes as in {path}: {', '.join(f'{name} = {value:.4g}' for name, value in sizes.items())}")
        form = {name: value for name, value in found.get("settings", {}).items() if name in known}
        return {**form, **sizes}
    return {}


def _values(
    settings: dict[str, float], effect: Effect, flat: Model
) -> tuple[dict[str, float], dict[str, float]]:
    """Values of the effect's parameters, and those of the model's."""
    own = {p.name for p in effect.parameters}
    model = set(flat.parameter_names) - own
    values = {name: value for name, value in settings.items() if name not in model}
    return values, {name: value for name, value in settings.items() if name in model}


def _signals(given: Sequence[str], effect: Effect) -> dict[str, str]:
    """SIGNAL=NAME pairs of --input."""
    found: dict[str, str] = {}
    for text in given:
        signal, _, name = text.partition("=")
        if signal not in effect.inputs or not name:
            raise ConfigError(
                "option-assignment",
                f"--input {text}: not of the form SIGNAL=NAME",
                remedy=f"{effect.name} has the signals {', '.join(effect.inputs) or 'none'}",
            )
        found[signal] = name
    return found
