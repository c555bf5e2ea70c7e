"""An FMU is foreign code: whatever it does ends in one message, and in its own process."""

import os
import re
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
from ball_fmu import ball

from daest.errors import FmuError
from daest.fmu import runner as runner_module
from daest.fmu.drive import Drive
from daest.fmu.engine import Followed, Plan, engine_library
from daest.fmu.load import load_fmu
from daest.fmu.runner import Limits, Points, Runner

SHORT = Limits(seconds=1.0, memory=3 * 1024**3, written=4 * 1024**2)


def simulated(path, limits=SHORT):
    time_grid = np.linspace(0.0, 1.0, 11)
    none = np.zeros((10, 1))
    with Runner(load_fmu(path), limits) as runner:
        drive = Drive(time_grid, (4,), none, none, np.zeros(1), (5,))
        return runner.simulate(drive, ((), np.zeros((1, 0))))


TRAPS = {
    "CRASH": ("fmu-crashed", "SIGSEGV"),
    "ABORT": ("fmu-crashed", "SIGABRT"),
    "EXIT": ("fmu-exited", "exit status 3"),
    "HANG": ("fmu-hangs", "within 1 s"),
    "LOG": ("fmu-writes-too-much", "4 MB"),
    "PRINT": ("fmu-writes-too-much", "printed last: .*debug mode"),
}
CASES = [  # both kinds are watched alike
    pytest.param(trap, *told, kind, marks=pytest.mark.slow if trap != "CRASH" and kind[0] == "C" else ())
    for trap, told in TRAPS.items()
    for kind in ("ModelExchange", "CoSimulation")
]


@pytest.mark.parametrize(("trap", "code", "says", "kind"), CASES)
def test_what_an_fmu_does_ends_in_one_message(tmp_path, kind, trap, code, says):
    path = ball(tmp_path, kind, TRAP=trap)
    # On a busy machine 4 MB take longer than the second in which a hanging one is told.
    limits = SHORT if trap == "HANG" else replace(SHORT, seconds=8.0)
    began = time.monotonic()
    with pytest.raises(FmuError, match=says) as caught:
        simulated(path, limits)
    assert caught.value.code == code
    assert "simulated" in caught.value.what or "initialised" in caught.value.what
    assert caught.value.remedy
    assert time.monotonic() - began < 10.0


def test_memory_without_end(tmp_path):
    with pytest.raises(FmuError) as caught:
        simulated(ball(tmp_path, TRAP="MEMORY"), Limits(seconds=20.0, memory=1024**3))
    assert caught.value.code == "fmu-memory"


def test_refusal_in_the_words_of_the_fmu(tmp_path):
    found = simulated(ball(tmp_path, TRAP="REFUSE_ALL"))
    assert "no air at 0.5" in found.stopped.reason
    assert 0.4 <= found.stopped.time <= 0.6
    assert np.all(np.isnan(found.values))


@pytest.mark.parametrize(
    ("trap", "says"),
    [
        ("NOT_A_NUMBER", "CVode|finite"),
        ("NEVER_SETTLES", "does not end"),
        ("TERMINATES", "end of the simulation"),
    ],
)
def test_simulation_that_cannot_go_on(tmp_path, trap, says):
    found = simulated(ball(tmp_path, TRAP=trap))
    assert found.stopped is not None
    assert pytest.approx(0.5, abs=0.15) == found.stopped.time
    assert re.search(says, found.stopped.reason)


def test_a_new_process_after_a_crash_and_none_left_over(tmp_path):
    model = load_fmu(ball(tmp_path, TRAP="CRASH"))
    nowhere = Points((), np.zeros((1, 0)), np.zeros((1, 2)), np.zeros(1))
    late = Points((), np.zeros((1, 0)), np.zeros((1, 2)), np.ones(1))
    with Runner(model, SHORT) as runner:
        first = runner.evaluate(nowhere, (5,), rates=True).values
        folder = runner._process._folder.name
        child = runner._process._child
        with pytest.raises(FmuError):
            runner.evaluate(late, (5,), rates=True)
        assert child.poll() is not None
        assert not os.path.exists(folder)
        assert np.array_equal(runner.evaluate(nowhere, (5,), rates=True).values, first)


def test_many_simulations_in_one_request_are_as_if_alone(tmp_path):
    model = load_fmu(ball(tmp_path))
    grid = np.linspace(0.0, 0.4, 9)
    none = np.zeros((8, 1))
    drive = Drive(grid, (4,), none, none, np.zeros(1), (5, 6))
    sets, starts = np.array([[0.1], [0.4], [0.1]]), np.array([[1.0, 0.0], [2.0, 1.0], [3.0, -1.0]])
    with Runner(model, SHORT) as runner:
        together = runner.simulate(drive, ((7,), sets), starts)
        alone = [runner.simulate(drive, ((7,), s[None]), x[None]) for s, x in zip(sets, starts, strict=True)]
    for k, single in enumerate(alone):
        assert np.array_equal(together.values[k], single.values[0])
    assert not np.array_equal(together.values[0], together.values[1])


def follow_plan(n_x=2):
    library = engine_library(2, n_x, 1, 0, 1)
    assert library is not None
    none = np.zeros(0)
    return Plan(
        str(library), none, np.ones(n_x), np.full(n_x, 1e-8), 100_000, False, np.zeros((0, 6)),
        np.zeros((1, 0)),
    )  # fmt: skip


@pytest.mark.parametrize("way", ["ModelExchange", "CoSimulation", "compiled"])
def test_the_limit_is_for_a_call_and_not_for_the_many_of_a_step(tmp_path, way):
    """Its many calls of a few to 60 ms take longer than the limit of a second, each of them does not."""
    kind = "CoSimulation" if way == "CoSimulation" else "ModelExchange"
    path = ball(tmp_path, kind, SLOW={"ModelExchange": 20_000, "CoSimulation": 1000, "compiled": 8_000}[way])
    limits = Limits(seconds=1.0)
    if way == "compiled":
        drive = Drive(np.array([0.0, 1.0]), (4,), np.zeros((1, 1)), np.zeros((1, 1)), np.zeros(1), (5,))
        with Runner(load_fmu(path), limits) as runner:
            began = time.monotonic()
            found = runner.follow(drive, ((), np.zeros((1, 0))), np.array([1.0, 0.0]), follow_plan())
        assert isinstance(found, Followed) and np.all(np.isfinite(found.values))
        assert time.monotonic() - began > 1.2
    else:
        assert simulated(path, limits).stopped is None


def test_all_requests_together_have_a_limit_and_are_told_of(tmp_path, monkeypatch):
    path = ball(tmp_path, SLOW=20_000)
    heard = []
    monkeypatch.setattr(runner_module, "WORD_SECONDS", 0.3)
    monkeypatch.setattr(runner_module.listeners, "tell", heard.append)
    with pytest.raises(FmuError) as caught:
        simulated(path, Limits(total=1.0))
    assert caught.value.code == "fmu-too-long"
    assert heard and re.fullmatch(r"ball\.fmu has worked \d s, on 1 requests", heard[0])


@pytest.mark.parametrize("kind", ["ModelExchange", pytest.param("CoSimulation", marks=pytest.mark.slow)])
def test_an_fmu_that_draws_random_numbers_ends_a_search(tmp_path, kind):
    model = load_fmu(ball(tmp_path, kind, RANDOM=5))
    grid, none = np.linspace(0.0, 1.0, 11), np.zeros((10, 1))
    drive = Drive(grid, (4,), none, none, np.zeros(1), (5,))
    with Runner(model, SHORT) as runner:
        runner.simulate(drive, ((7,), np.array([[0.1]])))  # a single one is as good as any
        with pytest.raises(FmuError) as caught:
            runner.simulate(drive, ((7,), np.array([[0.2], [0.3]])))
    assert caught.value.code == "fmu-not-repeatable"


@pytest.mark.parametrize("text", ["none", "-1", "0", "inf"])
def test_limits_from_the_environment(monkeypatch, text):
    monkeypatch.setenv("DAEST_FMU_SECONDS", "7")
    monkeypatch.setenv("DAEST_FMU_MEMORY", "500")
    assert Limits.from_environment() == Limits(7.0, 500_000_000)
    monkeypatch.setenv("DAEST_FMU_SECONDS", text)
    with pytest.raises(FmuError, match="DAEST_FMU_SECONDS") as caught:
        Limits.from_environment()
    assert caught.value.code == "fmu-limit"


def test_command_ends_with_one_message_and_leaves_files_alone(tmp_path):
    path = ball(tmp_path, TRAP="CRASH")
    (tmp_path / "in.csv").write_text("time,u\n" + "".join(f"{0.1 * k},0\n" for k in range(11)))
    (tmp_path / "out.csv").write_text("precious")
    command = [sys.executable, "-m", "daest", "simulate", str(path), "--inputs", "in.csv", "-o", "out.csv"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 2
    assert "error[fmu-crashed]" in done.stderr
    assert "Traceback" not in done.stderr
    assert (tmp_path / "out.csv").read_text() == "precious"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["ball.fmu", "in.csv", "out.csv"]
