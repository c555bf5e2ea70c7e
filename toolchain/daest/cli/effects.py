"""`daest effects`: the library of physical effects that a model may lack."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from daest.cli.options import ModelOptions, example, format_option, model_options, output_option
from daest.cli.output import emit
from daest.files import MODEL_SUFFIXES

if TYPE_CHECKING:
    from daest.model.effects import Effect, Site
    from daest.model.flat import Model


@click.command("effects", epilog=example("daest effects", "daest effects CoulombFriction --model Servo.mo"))
@click.argument("named", metavar="[NAME] [MODEL]", nargs=-1)
@click.option(
    "--model",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="List its places, too; with or without this word (default: daest.toml).",
)
@model_options
@format_option
@output_option
def command(
    named: tuple[str, ...],
    model: Path | None,
    model_options: ModelOptions,
    form: str,
    output: Path | None,
) -> None:
    """List the effects with their laws and parameters, or show the one called NAME.

    With a model (or a daest.toml here) the places of that model where each can sit are listed. Classes of
    one's own are read from the folders of -L.
    """
    from daest.report.documents import effects as documents
    from daest.report.texts import effects as texts

    model, name = _sorted(named, model)
    project = model_options.project()
    folders = model_options.folders(project)
    chosen = _chosen(name, folders)
    places = None
    if model is not None or project.source is not None:
        places = _places(model_options.load(project, model), chosen)
    source = model or project.source
    document = documents.document(chosen, places, None if source is None else str(source))
    emit(document, "effects", form, output, texts.text)


def _sorted(named: tuple[str, ...], model: Path | None) -> tuple[Path | None, str | None]:
    """The model and the effect of a command line, in any order. Raises ConfigError `files-too-many`."""
    from daest.cli.given import Files
    from daest.errors import ConfigError

    models = tuple(Path(word) for word in named if word.lower().endswith(MODEL_SUFFIXES))
    names = [word for word in named if not word.lower().endswith(MODEL_SUFFIXES)]
    if len(names) > 1:
        raise ConfigError(
            "files-too-many",
            f"this command takes one effect, and {', '.join(names)} are given",
            remedy="name one effect, or none for all of them",
        )
    return Files((*models, *([model] if model else []))).model, names[0] if names else None


def _chosen(name: str | None, folders: tuple[Path, ...]) -> list[Effect]:
    """All effects, or those of a name: the mechanical ones exist for two domains."""
    from daest.modelica.effects.catalogue import effect_library, find_effects

    return list(effect_library(folders) if name is None else find_effects(name, folders))


def _places(flat: Model, chosen: list[Effect]) -> dict[str, list[Site]]:
    from daest.modelica.places.sites import fits, sites

    known = sites(flat)
    return {effect.class_name: [site for site in known if fits(effect, site)] for effect in chosen}
