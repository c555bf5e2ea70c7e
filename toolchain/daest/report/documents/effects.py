"""The documents of the effect library and of an extended model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from daest.model.effects import Effect, EffectParameter, Site

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
) -> dict[str, Any]:
    """What `daest effects --format json` prints. `places` are the sites of `model` by class name of the
    effect; `places` of an effect is null where no model is given."""
    return {"model": model, "effects": [_effect(effect, places) for effect in effects]}


def extension_document(
    effect: Effect, site: Site, class_name: str, component: str, text: str, path: str | None
) -> dict[str, Any]:
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


def _effect(effect: Effect, places: Mapping[str, Sequence[Site]] | None) -> dict[str, Any]:
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
        else [{"name": s.name, "kind": s.kind, "aliases": s.aliases} for s in sites],
    }


def _sits(effect: Effect) -> str:
    text = SITS[effect.attach]
    return f"{text} or across a component" if effect.has_support else text


def _parameter(parameter: EffectParameter) -> dict[str, Any]:
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
