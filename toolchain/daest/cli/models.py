"""The model of a command: from the command line, else from daest.toml, with what daest.toml says about it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from daest.data.project import NoiseSetting, ParameterSetting, Project
from daest.data.table import raise_collected
from daest.errors import ConfigError, DaestError, ModelError, Place
from daest.files import FOLDER, why_no_file
from daest.model.flat import Model
from daest.model.parts import Parameter
from daest.near import nearest

_MODELICA = (".mo", ".bmo")
_FMU = ".fmu"


def model_source(project: Project, given: Path | None) -> Path:
    """The model file. Raises ConfigError `model-not-given`, `model-missing` or `model-unknown-format`."""
    source = given if given is not None else project.source
    if source is None:
        raise ConfigError(
            "model-not-given",
            "no model is given",
            remedy='name a .mo or .fmu file, or write [model] source = "Servo.mo" in daest.toml',
        )
    if source.suffix not in (*_MODELICA, _FMU):
        raise ConfigError(
            "model-unknown-format",
            f"'{source.name}' is neither a .mo, a .bmo nor a .fmu file",
            where=Place(str(source)),
            remedy="give a Modelica or Base Modelica file, or an FMU",
        )
    if (why := why_no_file(source)) is not None:
        beside = source.parent.glob("*.*") if why_no_file(source.parent) == FOLDER else ()
        neighbours = [entry.name for entry in beside if entry.name != source.name]
        raise ConfigError(
            "model-missing",
            f"the model file {why}",
            where=Place(str(source)),
            remedy=nearest(source.name, neighbours) or "check the path; it counts from the current folder",
        )
    return source


def load_model(
    project: Project,
    given: Path | None,
    class_name: str | None = None,
    libraries: Sequence[Path] = (),
    settings: Mapping[str, float] | None = None,
) -> Model:
    """The model with daest.toml and then `settings` (parameter values) applied.

    For a model that is not the one of daest.toml, its [parameters] and
    [noise] apply where the names exist.
    """
    source = model_source(project, given)
    own = _is_own(project, source)
    flat = _load(source, chosen_class(project, source, class_name), [*libraries, *project.libraries])
    _warn_of_units(flat)
    flat = configured(flat, project, strict=own, is_another=project.source is not None and not own)
    return with_settings(flat, settings or {})


def with_settings(flat: Model, settings: Mapping[str, float]) -> Model:
    """The model with the values of --set. Raises ModelError for a name that is no tunable parameter."""
    from daest.modelica.change import with_values

    return with_values(flat, dict(settings)) if settings else flat


def chosen_class(project: Project, source: Path, class_name: str | None) -> str | None:
    """The class of the command line, else that of daest.toml if `source` is its model."""
    return class_name or (project.class_name if _is_own(project, source) else None)


def _is_own(project: Project, source: Path) -> bool:
    return project.source is not None and source.resolve() == project.source.resolve()


def _warn_of_units(flat: Model) -> None:
    from daest.cli.output import warn
    from daest.model.flat import FlatModel
    from daest.modelica.flat.connected_units import contradictions, sentence

    found = contradictions(flat) if isinstance(flat, FlatModel) else ()
    if found:
        warn("unit-contradiction", sentence(found))


def configured(flat: Model, project: Project, *, strict: bool, is_another: bool = False) -> Model:
    """The model with [data] outputs, [parameters] and [noise] of daest.toml.

    If `strict`, all unknown names are reported in one ConfigError; otherwise they are ignored. Where it
    `is_another` model than that of daest.toml, its own values stay where starts are told: an extended model
    has fitted ones.
    """
    file = str(project.file)
    problems: list[DaestError] = []
    flat = _with_declared(flat, project, problems)
    settings = project.parameters
    if is_another:
        settings = {name: replace(s, value=None) if s.is_start else s for name, s in settings.items()}
    flat = _with_parameters(flat, settings, file, problems)
    if strict:
        raise_collected(problems, file)
    return flat


def _load(source: Path, class_name: str | None, libraries: Sequence[Path]) -> Model:
    if source.suffix in _MODELICA:
        from daest.modelica.compile import compile_model

        return compile_model(source, class_name, tuple(libraries))
    from daest.fmu.load import symbolic_model

    flat = symbolic_model(source)
    if flat is None:
        from daest.cli.output import note
        from daest.fmu.binary_model import binary_model
        from daest.fmu.runner import listeners

        listeners.tell = note
        model = binary_model(source)
        for remark in model.form.model.notes:
            note(remark)
        return model
    return flat


def _with_declared(flat: Model, project: Project, problems: list[DaestError]) -> Model:
    """[data] outputs, which then are the only ones, and [noise], with the problems of the names added to
    `problems`."""
    from daest.modelica.change import declare

    intensities = {noise.name: noise.intensity for noise in flat.noises}
    steps: list[dict[str, Any]] = [{"outputs": [name]} for name in project.outputs]
    for name, setting in project.process_noise.items():
        size = intensities.get(name) if setting.size is None else setting.size
        steps += [{"noises": {name: size}}, *_estimated(name, setting)]
    for name, setting in project.measurement_noise.items():
        steps += [] if setting.size is None else [{"noise_std": {name: setting.size}}]
        steps += _estimated(name, setting)
    outputs: list[str] = []
    for step in steps:
        try:
            changed = declare(flat, **step)
        except ModelError as error:
            problems.append(
                ConfigError(error.code, error.what, where=Place(str(project.file)), remedy=error.remedy)
            )
            continue
        if "outputs" in step:
            outputs += step["outputs"]
            # All together until the noises are known: they may belong to any.
            present = flat.output_names
            flat = declare(flat, outputs=list(dict.fromkeys([*present, *outputs])))
        else:
            flat = changed
    return declare(flat, outputs=outputs) if outputs else flat


def _estimated(name: str, setting: NoiseSetting) -> list[dict[str, Any]]:
    return [] if setting.estimate is None else [{"estimate_noise": {name: setting.estimate}}]


def _with_parameters(
    flat: Model, settings: Mapping[str, ParameterSetting], file: str, problems: list[DaestError]
) -> Model:
    names = flat.parameter_names
    for name in settings:
        if name not in names:
            problems.append(
                ConfigError(
                    "config-unknown-parameter",
                    f"[parameters] names '{name}', which is no tunable parameter of {flat.name}",
                    where=Place(file),
                    remedy=nearest(name, names) or f"it has {', '.join(names)}",
                )
            )
    parameters = tuple(
        _with_setting(parameter, settings[parameter.name], file, problems)
        if parameter.name in settings
        else parameter
        for parameter in flat.parameters
    )
    return replace(flat, parameters=parameters)


def _with_setting(
    parameter: Parameter, setting: ParameterSetting, file: str, problems: list[DaestError]
) -> Parameter:
    changed = replace(
        parameter,
        value=parameter.value if setting.value is None else setting.value,
        estimate=parameter.estimate if setting.estimate is None else setting.estimate,
        min=parameter.min if setting.min is None else setting.min,
        max=parameter.max if setting.max is None else setting.max,
        scale=parameter.scale if setting.scale is None else setting.scale,
        prior=setting.prior or parameter.prior,
    )
    below = changed.min is not None and changed.value < changed.min
    above = changed.max is not None and changed.value > changed.max
    if below or above:
        problems.append(
            ConfigError(
                "parameter-outside-bounds",
                f"'{changed.name}' = {changed.value:g} lies outside its bounds "
                f"{'-inf' if changed.min is None else f'{changed.min:g}'} to "
                f"{'inf' if changed.max is None else f'{changed.max:g}'}",
                where=Place(file),
                remedy="move the start or the bound",
            )
        )
    return changed
