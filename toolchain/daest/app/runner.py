"""The process of a job: runs its `daest` lines one after the other, whatever becomes of the server.

    python -m daest.app.runner FOLDER JOB

`JOB/lines.json` holds the arguments of every line. Their output goes to `JOB/stdout` and `JOB/stderr`, and
`JOB/ended.json` says how each one ended, and when the last one did. The lock on `JOB/alive` tells that the
job goes on.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from daest.app.locks import locked
from daest.files import ended_at_death, whole_file

LINES, ENDED, ALIVE, STDOUT, STDERR = "lines.json", "ended.json", "alive", "stdout", "stderr"
DONE = (0, 1)  # exit codes after which the next line is run: done, and done with a check that failed
INTERRUPTED = 130
LOCK_SECONDS = 2.0  # to wait for a lock that others only look at
NICENESS = 5  # the page and other programs go first


def main(folder: Path, job: Path) -> int:
    """Run the job in `folder`; returns the last exit code."""
    held = _held(job / ALIVE)
    if held is None:
        return INTERRUPTED  # another process runs it
    os.write(held, b"1")  # an empty file is one that no process has held yet
    if hasattr(os, "nice"):
        os.nice(NICENESS)
    lines = json.loads((job / LINES).read_text(encoding="utf-8"))
    ends: list[dict[str, Any]] = []
    stop = _Stop()
    for number, line in enumerate(lines):
        began = time.time()
        code = INTERRUPTED if stop.is_asked else _ended(line, folder, job, stop)
        ends.append({"code": code, "seconds": time.time() - began})
        is_last = code not in DONE or number == len(lines) - 1
        with whole_file(job / ENDED) as temporary:
            told = {"lines": ends, "time": time.time() if is_last else None}
            temporary.write_text(json.dumps(told), encoding="utf-8")
        if is_last:
            break
    os.close(held)
    return ends[-1]["code"] if ends else 0


def _held(path: Path) -> int | None:
    """The lock of the job; whoever looks whether it is held holds it for a moment."""
    until = time.monotonic() + LOCK_SECONDS
    while (held := locked(path)) is None and time.monotonic() < until:
        time.sleep(0.01)
    return held


class _Stop:
    """Hands a request to end on to the command that runs; none is begun after it."""

    def __init__(self) -> None:
        self.is_asked = False
        self.tell: Callable[[], object] = lambda: None
        for name in ("SIGTERM", "SIGINT", "SIGHUP"):
            if hasattr(signal, name):
                signal.signal(getattr(signal, name), self._ask)

    def _ask(self, *_: object) -> None:
        self.is_asked = True
        self.tell()


def _ended(line: list[str], folder: Path, job: Path, stop: _Stop) -> int:
    command = [sys.executable, "-m", "daest", *line]
    with (job / STDOUT).open("ab") as out, (job / STDERR).open("ab") as err:
        process = subprocess.Popen(
            command, cwd=folder, stdin=subprocess.DEVNULL, stdout=out, stderr=err, start_new_session=True
        )
        stop.tell = process.terminate
        if stop.is_asked:
            process.terminate()
        with ended_at_death(process.pid):
            code = process.wait()
    return INTERRUPTED if code < 0 and stop.is_asked else code


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), Path(sys.argv[2])))
