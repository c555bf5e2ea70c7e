"""`daest schema`: the JSON Schema of what a command prints with --format json."""

from __future__ import annotations

import json
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import click

from daest.cli.options import example, format_option, one_of, output_option
from daest.cli.output import emit, write_text
from daest.errors import ConfigError

# Documents that do not stand in a file of their command's name.
ELSEWHERE = {
    "app": "project:AppDocument",
    "completion": "project:CompletionDocument",
    "demo": "project:DemoDocument",
    "explain": "project:ExplainDocument",
    "extend": "effects:ExtendDocument",
    "identify": "fit:FitDocument",
    "improve": "diagnose:ImproveDocument",
    "init": "project:InitDocument",
    "report": "project:ReportDocument",
    "schema": "project:SchemaDocument",
}


def schema_names() -> list[str]:
    """Commands whose documents have a schema: all of them."""
    from daest.cli.main import COMMANDS

    return sorted(COMMANDS)


def schema_of(name: str) -> dict[str, Any]:
    """The schema of a command's document. Raises ConfigError `schema-unknown`."""
    from daest.report.schema import document_schema

    if name not in schema_names():
        raise ConfigError(
            "schema-unknown",
            f"there is no command '{name}' that prints a document",
            remedy=f"there are {', '.join(schema_names())}",
        )
    module, _, document = ELSEWHERE.get(name, f"{name}:{name.capitalize()}Document").partition(":")
    return document_schema(name, getattr(import_module(f"daest.report.documents.{module}"), document))


@click.command("schema", epilog=example("daest schema identify -o identify.schema.json"))
@click.argument("name", metavar="COMMAND", required=False, shell_complete=one_of(schema_names))
@format_option
@output_option
def command(name: str | None, form: str, output: Path | None) -> None:
    """Print the JSON Schema of what COMMAND prints with --format json, or list those that there are.

    Keys that a schema requires stay; others may be added.
    """
    chosen = schema_names() if name is None else [name]
    schemas = {each: schema_of(each) for each in chosen}
    if name is not None and form == "text":
        write_text(json.dumps(schemas[name], indent=2, ensure_ascii=False) + "\n", output)
    else:
        emit({"schemas": schemas}, "schema", form, output, _list)


def _list(document: Mapping[str, Any], width: int, color: bool) -> str:
    from daest.report.console import rendered, table

    rows = [(name, schema["title"]) for name, schema in document["schemas"].items()]
    return rendered([table(("command", "what it prints"), rows, (0, 1))], width, color)
