"""The command `daest`: finds the command, and turns every outcome into an exit code.

0: done. 1: done, and a check that was asked for failed. 2: could not do it. 130: interrupted from the
keyboard. Commands are imported when they are called, so that `daest --help` loads nothing numerical.
"""

from __future__ import annotations

import gc
import importlib
import os
import platform
import signal
import sys
import traceback
import warnings
from collections.abc import Sequence
from typing import Any, NoReturn

import click

from daest import __version__
from daest.cli.streams import FULL, leave_stdout, prepare_streams, say
from daest.errors import ConfigError, DaestError, Place

# Name -> one line of help; the module is daest.cli.NAME and holds `command`. In the order in which they are
# used.
COMMANDS = {
    "init": "Write a daest.toml for a model and a recording.",
    "check": "Look for faults in recordings, before a model is fitted.",
    "demo": "Copy a shipped example into a folder and run it.",
    "export": "Write a model as an FMU that carries its DAE.",
    "linearize": "E, J, K, B, C, D of a model, with names, units and places.",
    "noise": "Which equations may carry white noise, which may not, and why.",
    "simulate": "Drive a model with recorded inputs, with noise if wanted.",
    "identify": "Estimate parameters with their uncertainty from recordings.",
    "filter": "States and all internal variables with their uncertainty.",
    "watch": "Whether a model still holds for the machine that runs beside it.",
    "compare": "How well models predict data that they have not seen.",
    "effects": "The library of physical effects, and where each can sit.",
    "diagnose": "Which physical effect a model lacks, and where.",
    "design": "The next experiment: what to play, and what it will tell.",
    "fleet": "One model for many machines: fits, verdicts, groups, the odd ones.",
    "extend": "Write a Modelica model that extends another by one effect.",
    "improve": "Add what is missing, effect by effect, as Modelica models.",
    "app": "The live page: compare, find what is missing, add it, watch the error fall.",
    "report": "One HTML page of everything that has been found out.",
    "explain": "Explain a message by its code.",
    "schema": "The JSON Schema of what a command prints.",
    "completion": "Completion of commands, options and names by the shell.",
}
HELP_OPTIONS = ["-h", "--help"]
# Threads inside the linear algebra of small matrices cost more than they bring. Read when numpy loads.
for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
# Objects between two searches for garbage: of what imports make, which is most of a short command, none is.
GARBAGE_AFTER = 100_000
TRACEBACK_VARIABLE = "DAEST_TRACEBACK"


class LazyGroup(click.Group):
    """A group that knows its commands by name and imports one only to run it or to show its help."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        command: click.Command = importlib.import_module(f"daest.cli.{cmd_name}").command
        # click keeps the help option of a command as it was first asked for, with or without this group.
        command.context_settings.setdefault("help_option_names", HELP_OPTIONS)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and not args[0].startswith("-") and args[0] not in COMMANDS:
            from daest.near import near_names

            close = near_names(args[0], COMMANDS, n=1)
            hint = f"Did you mean '{close[0]}'?" if close else f"Known are {', '.join(COMMANDS)}."
            ctx.fail(f"No command '{args[0]}'. {hint}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


def _version(ctx: click.Context, _: click.Parameter, is_wanted: bool) -> None:
    if is_wanted and not ctx.resilient_parsing:
        from daest.machine import processor, versions

        click.echo(f"daest {__version__}\n{versions()}\n{platform.platform()}, {processor()}")
        ctx.exit()


@click.command(
    cls=LazyGroup,
    context_settings={"help_option_names": HELP_OPTIONS},
    epilog="Example: daest identify run.csv --model Servo.mo. Every command shows its own with -h.",
)
@click.option(
    "--version",
    is_flag=True,
    callback=_version,
    expose_value=False,
    is_eager=True,
    help="Show the version, and on what it runs.",
)
def cli() -> None:
    """From a Modelica model and a recording to parameters, states and the physics that the model lacks."""
    from daest.numerics.compiler import tell_of_compilations
    from daest.numerics.memory import keep_freed_memory

    keep_freed_memory()
    tell_of_compilations(say)


def main() -> NoReturn:
    """Entry point of the command line."""
    gc.set_threshold(GARBAGE_AFTER)
    prepare_streams()
    for name in ("SIGTERM", "SIGHUP"):  # a program that is asked to end tidies up as after Ctrl-C
        if hasattr(signal, name) and signal.getsignal(getattr(signal, name)) is signal.SIG_DFL:
            signal.signal(getattr(signal, name), _interrupted)
    status = run(sys.argv[1:])
    gc.freeze()  # what is left is not worth a last search, which takes as long as loading a library
    sys.exit(status)


def run(arguments: Sequence[str]) -> int:
    """Run one command line and return its exit code. Errors stand on stderr, without traceback."""
    warnings.showwarning = _show_warning
    try:
        result = cli.main(list(arguments), prog_name="daest", standalone_mode=False)
        sys.stdout.flush()
        return result if isinstance(result, int) else 0
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.ctx.get_help() if error.ctx else error.format_message())
        return 0
    except click.ClickException as error:
        error.show()
        return 2
    except DaestError as error:
        return _failed(error)
    except (KeyboardInterrupt, click.Abort):
        click.echo("interrupted", err=True)
        return 130
    except BrokenPipeError:
        leave_stdout()
        return 0
    except OSError as error:
        return _failed(_refused(error))
    except Exception as error:
        return _failed(_internal(error))


def _failed(error: DaestError) -> int:
    say(str(error))
    if _wants_traceback():
        click.echo(traceback.format_exc(), err=True)
    return 2


def _interrupted(*_: object) -> NoReturn:
    raise KeyboardInterrupt


def _refused(error: OSError) -> DaestError:
    """What the operating system refused, where no command knows more about it."""
    reason = error.strerror or str(error)
    if error.filename is None and error.errno in FULL:
        leave_stdout()
        remedy = "make room, or write to another place"
        return ConfigError("output-unwritable", f"the result cannot be written: {reason}", remedy=remedy)
    if error.filename is None:
        return _internal(error)
    return ConfigError(
        "file-refused",
        f"the system refuses a file or folder: {reason}",
        where=Place(str(error.filename)),
        remedy="check the name, the links on the way to it and your rights",
    )


def _internal(error: Exception) -> DaestError:
    what = f"{type(error).__name__}: {error}".splitlines()[0]
    remedy = f"this is a fault of daest; the traceback is shown with {TRACEBACK_VARIABLE}=1"
    return DaestError("internal-error", what, remedy=remedy)


def _wants_traceback() -> bool:
    return os.environ.get(TRACEBACK_VARIABLE, "0") not in ("", "0")


def _show_warning(message: Warning | str, category: type[Warning], *_: Any, **__: Any) -> None:
    if issubclass(category, RuntimeWarning) and not _wants_traceback():
        return  # of NumPy on numbers that overflow: what comes of them is told in words of the model
    say(f"warning: {message}")
