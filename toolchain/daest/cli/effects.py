"""`daest effects`: the library of physical effects that a model may lack."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from daest.cli.options import ModelOptions, example, format_option, model_options, output_option
from daest.cli.output import emit

if TYPE_CHECKING:
    from daest.model.effects import Effect, Site
    from daest.model.flat import Model


@click.command("effects", epilog=example("daest effects", "daest effects CoulombFriction --model Servo.mo"))
@click.argument("name", required=False)
@click.option("--model", metavar="MODEL", type=click.Path(path_type=Path), help="List its places, too.")
@model_options
@format_option
@output_option
def command(
    name: str | None,
    model: Path | None,
    model_options: ModelOptions,
    form: str,
    output: Path | None,
) -> None:
    """List the effects with their laws and parameters, or show the one called NAME.

    With --model (or a daest.toml here) the places of that model where each can sit are listed. Classes of
    one's own are read from the folders of -L.
    """
    from daest.report.documents import effects as documents
    from daest.report.texts import effects as texts

    project = model_options.project()
    folders = (*model_options.libraries, *project.libraries)
    chosen = _chosen(name, folders)
    places = None
    if model is not None or project.source is not None:
        places = _places(model_options.load(project, model), chosen)
    source = model or project.source
    document = documents.document(chosen, places, None if source is None else str(source))
    emit(document, "effects", form, output, texts.text)


def _chosen(name: str | None, folders: tuple[Path, ...]) -> list[Effect]:
    """All effects, or those of a name: the mechanical ones exist for two domains."""
    from daest.modelica.effects import effect_library, find_effects

    return list(effect_library(folders) if name is None else find_effects(name, folders))


def _places(flat: Model, chosen: list[Effect]) -> dict[str, list[Site]]:
    from daest.modelica.sites import fits, sites

    known = sites(flat)
    return {effect.class_name: [site for site in known if fits(effect, site)] for effect in chosen}
