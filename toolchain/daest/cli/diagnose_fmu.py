"""`daest diagnose` for an FMU without equations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daest.cli.output import note
from daest.errors import ConfigError

if TYPE_CHECKING:
    from daest.cli.options import DataOptions
    from daest.data.project import Project

HALF = 0.5


def black_box_document(
    project: Project,
    model: Path | None,
    data: Sequence[Path],
    data_choice: DataOptions,
    searched: Sequence[str],
    seed: int,
) -> tuple[dict[str, Any], dict[str, Any]] | None:
    """The document of the diagnosis of an FMU without equations, and what it was made from; None for any
    other model. ConfigError `diagnose-fmu-search` for names of effects and places."""
    from daest.cli.kept import made_from, training_files
    from daest.cli.models import load_model, model_source
    from daest.cli.recordings import training_data
    from daest.data.prepare import split_all

    source = model_source(project, model)
    if source.suffix != ".fmu":
        return None
    flat = load_model(project, source)
    if flat.given is None:
        return None
    if searched:
        raise ConfigError(
            "diagnose-fmu-search",
            f"{', '.join(searched)} cannot be searched for in an FMU without equations",
            where=str(source),
            remedy="leave out --effect and --at: all that can be tried from outside is tried",
        )
    from daest.diagnosis.black_box import diagnose_black_box

    flat, estimation, validation = training_data(flat, project, data, data_choice)
    if not validation:
        note("no validation data: the second half of every recording validates")
        halves = replace(data_choice.preparation(project), split=HALF)
        estimation, validation = split_all(estimation, halves)
    found = diagnose_black_box(flat, estimation, validation, data_choice.known_hold(project), seed)
    content = {
        **found,
        "model": {"name": flat.name, "source": str(source)},
        "data": [e.name for e in estimation],
        "validated_on": [e.name for e in validation],
        "outputs": {o.name: o.unit for o in flat.outputs},
        "searched": {"effects": [], "places": []},
    }
    return content, made_from(project, [source], training_files(project, data))
