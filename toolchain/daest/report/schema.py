"""JSON Schemas (draft 2020-12) of documents, from the typed dictionaries that describe them.

A key is required unless it is `NotRequired`; other keys may stand beside those that a dictionary names. A
text in `Annotated` becomes the description.
"""

from __future__ import annotations

import types
from collections.abc import Mapping
from typing import (
    Annotated,
    Any,
    Literal,
    NotRequired,
    Union,
    get_args,
    get_origin,
    get_type_hints,
    is_typeddict,
)

DIALECT = "https://json-schema.org/draft/2020-12/schema"
PLAIN = {str: "string", float: "number", int: "integer", bool: "boolean", type(None): "null"}

Schema = dict[str, Any]


def document_schema(command: str, document: type) -> Schema:
    """The schema of what `command` prints: a `document` (a TypedDict, whose docstring is the title) with the
    key `schema`. Dictionaries within it stand in `$defs` by their names."""
    identity = f"daest/{command}/1"
    definitions: dict[str, tuple[type, Schema]] = {}
    body = _object(document, definitions)
    return {
        "$schema": DIALECT,
        "$id": identity,
        "title": (document.__doc__ or "").partition("\n")[0].rstrip("."),
        "type": "object",
        "required": ["schema", *body["required"]],
        "properties": {"schema": {"const": identity}, **body["properties"]},
        "$defs": {name: schema for name, (_, schema) in sorted(definitions.items())},
    }


def _object(document: type, definitions: dict[str, tuple[type, Schema]]) -> Schema:
    hints = get_type_hints(document, include_extras=True)
    properties = {key: _value(_bare(hint), definitions) for key, hint in hints.items()}
    required = [key for key, hint in hints.items() if get_origin(hint) is not NotRequired]
    return {"type": "object", "required": required, "properties": properties}


def _bare(hint: Any) -> Any:
    return get_args(hint)[0] if get_origin(hint) is NotRequired else hint


def _value(hint: Any, definitions: dict[str, tuple[type, Schema]]) -> Schema:
    origin, arguments = get_origin(hint), get_args(hint)
    if hint is Any:
        return {}
    if hint in PLAIN:
        return {"type": PLAIN[hint]}
    if is_typeddict(hint):
        return _reference(hint, definitions)
    if origin is Annotated:
        words = next((one for one in arguments[1:] if isinstance(one, str)), None)
        return {**_value(arguments[0], definitions), **({"description": words} if words else {})}
    if origin is Literal:
        return {"enum": list(arguments)}
    if origin is list:
        return {"type": "array", "items": _value(arguments[0], definitions)}
    if origin in (dict, Mapping):
        entries = _value(arguments[1], definitions)
        return {"type": "object", "additionalProperties": entries} if entries else {"type": "object"}
    if origin in (Union, types.UnionType):
        return _any_of([_value(argument, definitions) for argument in arguments])
    raise TypeError(f"no JSON form is known for {hint}")


def _any_of(choices: list[Schema]) -> Schema:
    if all(set(choice) == {"type"} for choice in choices):
        return {"type": [choice["type"] for choice in choices]}
    return {"anyOf": choices}


def _reference(document: type, definitions: dict[str, tuple[type, Schema]]) -> Schema:
    name = document.__name__
    known, _ = definitions.get(name, (document, {}))
    if known is not document:
        raise TypeError(f"two dictionaries of one document are called {name}")
    if name not in definitions:
        definitions[name] = (document, {})  # it may contain itself
        definitions[name] = (document, _object(document, definitions))
    return {"$ref": f"#/$defs/{name}"}
