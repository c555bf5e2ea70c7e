"""The documents of the effect library and of an extended model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, NotRequired, TypedDict

from daest.model.effects import Effect, EffectParameter, Site

_Class = TypedDict("_Class", {"class": str})
_From = TypedDict("_From", {"from": NotRequired[str | None]})


class EffectParameterEntry(_From):
    name: str
    unit: str
    description: str
    role: NotRequired[str]
    start: float | None
    null: NotRequired[float | None]
    min: float | None
    max: float | None
    grid: NotRequired[list[float]]
    grid_relative_to: NotRequired[str | None]
    estimate: bool


class SiteEntry(TypedDict):
    name: str
    kind: str
    aliases: list[str]


class EffectEntry(_Class):
    name: str
    domain: str
    description: str
    law: str
    attach: str
    sits: str
    connectors: NotRequired[list[str]]
    inputs: list[str]
    dynamic: bool
    n_states: NotRequired[int]
    parameters: list[EffectParameterEntry]
    documentation: NotRequired[str]
    places: NotRequired[list[SiteEntry] | None]


class EffectsDocument(TypedDict):
    """The library of physical effects."""

    model: str | None
    effects: list[EffectEntry]


class ExtendDocument(_Class):
    """A model extended by one effect."""

    effect: str
    at: str
    component: str
    parameters: list[str]
    path: str | None
    model: Annotated[str, "Modelica text"]


# Where an effect can sit, by how it is attached.
SITS = {
    "connector": "at a connector",
    "parallel": "parallel to a component",
    "series": "in series with a connector",
    "signal": "behind an input or before an output",
    "input": "behind an input",
    "output": "before an output",
    "parameter": "in place of a parameter",
}


def document(
    effects: Sequence[Effect], places: Mapping[str, Sequence[Site]] | None = None, model: str | None = None
) -> EffectsDocument:
    """What `daest effects --format json` prints. `places` are the sites of `model` by class name of the
    effect; `places` of an effect is null where no model is given."""
    return {"model": model, "effects": [_effect(effect, places) for effect in effects]}


def extension_document(
    effect: Effect, site: Site, class_name: str, component: str, text: str, path: str | None
) -> ExtendDocument:
    """What `daest extend --format json` prints: the new class, its text, and the file if one was written."""
    return {
        "class": class_name,
        "effect": effect.name,
        "at": site.name,
        "component": component,
        "parameters": [f"{component}.{p.name}" for p in effect.parameters if p.estimate],
        "path": path,
        "model": text,
    }


def _effect(effect: Effect, places: Mapping[str, Sequence[Site]] | None) -> EffectEntry:
    sites = None if places is None else places.get(effect.class_name, ())
    return {
        "name": effect.name,
        "class": effect.class_name,
        "domain": effect.domain,
        "description": effect.description,
        "law": effect.law,
        "attach": effect.attach,
        "sits": _sits(effect),
        "connectors": list(effect.connectors),
        "inputs": list(effect.inputs),
        "dynamic": effect.is_dynamic,
        "n_states": effect.n_states,
        "parameters": [_parameter(p) for p in effect.parameters],
        "documentation": effect.documentation,
        "places": None
        if sites is None
        else [{"name": s.name, "kind": s.kind, "aliases": list(s.aliases)} for s in sites],
    }


def _sits(effect: Effect) -> str:
    text = SITS[effect.attach]
    return f"{text} or across a component" if effect.has_support else text


def _parameter(parameter: EffectParameter) -> EffectParameterEntry:
    return {
        "name": parameter.name,
        "unit": parameter.unit,
        "description": parameter.description,
        "role": parameter.role,
        "start": parameter.start,
        "null": parameter.null,
        "min": parameter.min,
        "max": parameter.max,
        "grid": list(parameter.grid),
        "grid_relative_to": parameter.scale_of or None,
        "from": parameter.given_from or None,
        "estimate": parameter.estimate,
    }
