"""The option --plot of the commands: what is written, and what is refused before anything is computed."""

import pytest

COMMANDS = {
    "identify": ("run1.csv", "--model", "Lag.mo"),
    "compare": ("Lag.mo", "--data", "run2.csv"),
    "filter": ("run2.csv", "--model", "Lag.mo"),
    "noise": ("Lag.mo",),
    "linearize": ("Lag.mo",),
    "simulate": ("Lag.mo", "--inputs", "run1.csv", "-o", "out.csv"),
}


# One function saves all figures: every command in one format and one command in every format show it. The
# workflow of tests/docs draws a comparison.
DRAWN = [
    pytest.param(
        command,
        suffix,
        marks=() if command == "simulate" or (suffix == "png" and command != "compare") else pytest.mark.slow,
    )
    for command in COMMANDS
    for suffix in ("png", "svg", "pdf")
]


@pytest.mark.parametrize(("command", "suffix"), DRAWN)
def test_every_command_draws(folder, daest, command, suffix):
    if command == "filter":
        assert daest("identify", "run1.csv", "--model", "Lag.mo")[0] == 0
    code, _, err = daest(command, *COMMANDS[command], "--plot", f"out.{suffix}")
    assert code == 0, err
    start = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}[suffix]
    assert (folder / f"out.{suffix}").read_bytes().startswith(start)


@pytest.mark.parametrize("command", [*COMMANDS, "diagnose", "improve"])
def test_unknown_formats_are_refused_at_once(folder, daest, command):
    before = sorted(folder.iterdir())
    code, out, err = daest(command, "--plot", "out.jpg")
    assert code == 2 and "error[plot-format]" in err and ".svg" in err and out == ""
    assert sorted(folder.iterdir()) == before
