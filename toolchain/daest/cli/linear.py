"""The linear DAE of a command: from the equations of a model, or through the binary of an FMU."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from daest.cli.models import model_source
from daest.cli.options import ModelOptions
from daest.cli.results import parameter_values, read_document
from daest.data.project import Project
from daest.errors import ConfigError, Place
from daest.model.flat import FlatModel, with_equations
from daest.model.linear import LinearDAE
from daest.near import nearest


@dataclass(frozen=True)
class Linear:
    """A linear DAE with the equations that it came from, if there are any, its operating point, and the
    relative differences between the sources of an FMU that could be compared."""

    dae: LinearDAE
    flat: FlatModel | None
    at: Mapping[str, float] | None
    cross_check: Mapping[str, float]


def operating_values(path: Path | None) -> tuple[dict[str, float], dict[str, float] | None]:
    """Parameter values and operating point of a --at file: `parameters` as in a fit, `at` {name: value}.

    The operating point is None where the file has none. Raises ConfigError `results-unreadable` or
    `at-without-values`.
    """
    if path is None:
        return {}, None
    document = read_document(path)
    point = document.get("at")
    values = parameter_values(document)
    is_point = isinstance(point, Mapping) and all(isinstance(v, int | float) for v in point.values())
    if (point is not None and not is_point) or (point is None and not values):
        raise ConfigError(
            "at-without-values",
            "the file holds neither parameters nor an operating point",
            where=Place(str(path)),
            remedy='give results/fit.json, or {"parameters": {"c": 1.5}, "at": {"disc.phi": 0.1}}',
        )
    return values, {str(k): float(v) for k, v in point.items()} if isinstance(point, Mapping) else None


def load_linear(
    project: Project,
    model: Path | None,
    options: ModelOptions,
    settings: Mapping[str, float],
    at: Path | None,
    route: str | None = None,
) -> Linear:
    """The linear DAE of the model (default: that of daest.toml) at `settings` over those of the file `at`.

    `route` is the source of the matrices of an FMU (see `linearize_fmu`). Raises ConfigError
    `parameter-unknown`.
    """
    source = model_source(project, model)
    values, point = operating_values(at)
    values = {**values, **settings}
    if source.suffix == ".fmu":
        return _of_fmu(source, values, point, route)
    flat = with_equations(options.load(project, source, values), "the linear DAE")
    from daest.systems.linear.linearize import continuous_part, linearize

    return Linear(linearize(flat, at=point), flat, continuous_part(flat, point), {})


def _of_fmu(
    source: Path, values: Mapping[str, float], point: Mapping[str, float] | None, route: str | None
) -> Linear:
    from daest.fmu.kept_check import kept_cross_check
    from daest.fmu.linearize import linearize_fmu
    from daest.fmu.load import load_fmu, symbolic_model

    model = load_fmu(source)
    names = [model.variables[reference].name for reference in model.parameters]
    starts = [model.variables[reference].start or 0.0 for reference in model.parameters]
    _check_names(values, names, source)
    theta = np.array([values.get(name, start) for name, start in zip(names, starts, strict=True)])
    dae = linearize_fmu(source, theta, point, route)
    return Linear(dae, symbolic_model(source), point, kept_cross_check(source, theta, point, [dae]))


def _check_names(values: Mapping[str, float], names: Sequence[str], source: Path) -> None:
    for name in values:
        if name not in names:
            raise ConfigError(
                "parameter-unknown",
                f"the FMU has no parameter '{name}'",
                where=Place(str(source)),
                remedy=nearest(name, names) or f"it has {', '.join(names)}",
            )
