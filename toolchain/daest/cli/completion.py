"""`daest completion`: commands, options and names completed by the shell."""

from __future__ import annotations

import click

from daest.cli.options import example, format_option
from daest.cli.output import emit

SHELLS = ("bash", "zsh", "fish")
VARIABLE = "_DAEST_COMPLETE"  # click's name for what the script sets


@click.command(
    "completion",
    epilog=example("daest completion fish > daest.fish", 'eval "$(daest completion bash)"'),
)
@click.argument("shell", type=click.Choice(SHELLS))
@format_option
def command(shell: str, form: str) -> None:
    """Print the script that makes SHELL complete daest's commands, options and names.

    For good: the line with eval in ~/.bashrc (zsh: ~/.zshrc); for fish the file in
    ~/.config/fish/completions.
    """
    from click.shell_completion import get_completion_class

    from daest.cli.main import cli

    kind = get_completion_class(shell)
    assert kind is not None
    script = kind(cli, {}, "daest", VARIABLE)
    text = script.source_template % script.source_vars()
    emit({"shell": shell, "script": text}, "completion", form, None, lambda *_, **__: text)
