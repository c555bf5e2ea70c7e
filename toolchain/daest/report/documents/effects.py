"""The documents of the effect library and of an extended model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, NotRequired, TypedDict

from daest.model.effects import Effect, EffectParameter, Site
from daest.report.documents.parts import Of, entry

_Class = TypedDict("_Class", {"class": Annotated[str, Of("class_name")]})
_From = TypedDict("_From", {"from": NotRequired[Annotated[str | None, Of("given_from")]]})


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
    grid_relative_to: NotRequired[Annotated[str | None, Of("scale_of")]]
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
    dynamic: Annotated[bool, Of("is_dynamic")]
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
    "signal": "behind an input, before an output or at a signal inside",
    "input": "behind an input or at a signal inside",
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
    names = [f"{component}.{p.name}" for p in effect.parameters if p.estimate]
    made = {"class": class_name, "effect": effect.name, "at": site.name, "path": path, "model": text}
    return entry(ExtendDocument, effect, component=component, parameters=names, **made)


def _effect(effect: Effect, places: Mapping[str, Sequence[Site]] | None) -> EffectEntry:
    return entry(
        EffectEntry,
        effect,
        sits=_sits(effect),
        parameters=[_parameter(p) for p in effect.parameters],
        places=None if places is None else places.get(effect.class_name, ()),
    )


def _sits(effect: Effect) -> str:
    text = SITS[effect.attach]
    return f"{text} or across a component" if effect.has_support else text


def _parameter(parameter: EffectParameter) -> EffectParameterEntry:
    others = {"grid_relative_to": parameter.scale_of or None, "from": parameter.given_from or None}
    return entry(EffectParameterEntry, parameter, **others)
