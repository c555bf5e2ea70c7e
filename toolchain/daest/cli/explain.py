"""`daest explain`: what a message means."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from daest.cli.options import example, format_option, one_of, output_option
from daest.cli.output import emit
from daest.errors import EXPLANATIONS, ConfigError
from daest.near import near_names


@click.command("explain", epilog=example("daest explain data-time-not-increasing"))
@click.argument("code", required=False, shell_complete=one_of(lambda: EXPLANATIONS))
@format_option
@output_option
def command(code: str | None, form: str, output: Path | None) -> None:
    """Explain the message CODE (the word in brackets behind "error"), or list all codes."""
    emit({"codes": _chosen(code)}, "explain", form, output, _text)


def _chosen(code: str | None) -> dict[str, str]:
    if code is None:
        return dict(sorted(EXPLANATIONS.items()))
    if code not in EXPLANATIONS:
        close = near_names(code, EXPLANATIONS, n=3)
        remedy = f"did you mean {', '.join(close)}?" if close else "daest explain lists all codes"
        raise ConfigError(
            "explain-unknown-code", f"there is no message with the code '{code}'", remedy=remedy
        )
    return {code: EXPLANATIONS[code]}


def _text(document: Mapping[str, Any], width: int, color: bool) -> str:
    from daest.report.console import Paragraph, indented, rendered

    parts = [
        part
        for code, text in document["codes"].items()
        for part in (Paragraph(code), indented(text), Paragraph(""))
    ]
    return rendered(parts[:-1], width, color)
