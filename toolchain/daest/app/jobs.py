"""Work that the page has started: `daest` lines in processes of their own, which outlive the server.

All that is known of a job stands in its folder, so that another server finds it as it is.
"""

from __future__ import annotations

import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from daest.app.locks import is_held
from daest.app.runner import ALIVE, DONE, ENDED, INTERRUPTED, LINES, STDERR, STDOUT
from daest.errors import ConfigError
from daest.files import whole_file

ABOUT = "job.json"
SCRIPT = "session.sh"
MOST_KEPT = 100  # jobs; the oldest leave
START_SECONDS = 20.0  # until a process that was started holds its lock
TAIL = 4000  # characters of what a job has said that are shown
Line = Sequence[str]
Status = Literal["running", "done", "failed", "stopped", "lost"]


@dataclass(frozen=True)
class Job:
    """A job as its folder tells it. "lost": its process was ended by force."""

    number: int
    action: str
    lines: tuple[tuple[str, ...], ...]
    began: float
    status: Status
    ended: float | None
    codes: tuple[int, ...]
    said: str  # the end of its stderr
    result: str  # the end of its stdout

    def document(self) -> dict[str, Any]:
        return {
            "number": self.number,
            "action": self.action,
            "lines": [shown(line) for line in self.lines],
            "began": self.began,
            "ended": self.ended,
            "status": self.status,
            "codes": list(self.codes),
            "said": self.said,
            "result": self.result,
        }


def shown(line: Line) -> str:
    """The line as it is typed into a shell."""
    return shlex.join(["daest", *line])


def start(project: Path, home: Path, action: str, lines: Sequence[Line]) -> int:
    """Start a job in the folder `project`; its files go to `home`/jobs. Returns its number.

    Raises ConfigError `app-busy` where another job goes on, and OSError.
    """
    if any(job.status == "running" for job in jobs(home)):
        raise ConfigError(
            "app-busy",
            "another command works in this folder",
            remedy="wait until it has ended, or stop it",
        )
    number, folder = _new(home)
    (folder / LINES).write_text(json.dumps([list(line) for line in lines]), encoding="utf-8")
    arguments = [sys.executable, "-m", "daest.app.runner", str(project), str(folder)]
    process = subprocess.Popen(
        arguments,
        cwd=project,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    about = {"action": action, "began": time.time(), "pid": process.pid}
    with whole_file(folder / ABOUT) as temporary:
        temporary.write_text(json.dumps(about), encoding="utf-8")
    _record(home, lines)
    for old in _numbers(home)[:-MOST_KEPT]:
        shutil.rmtree(_folder(home, old), ignore_errors=True)
    return number


def stop(home: Path, number: int) -> None:
    """Ask a job to end as Ctrl-C does; one that has ended is left alone."""
    folder = _folder(home, number)
    about = _read(folder / ABOUT)
    if about is not None and is_held(folder / ALIVE):
        os.kill(int(about["pid"]), signal.SIGTERM)


def jobs(home: Path) -> list[Job]:
    """All jobs that are kept, oldest first."""
    return [found for number in _numbers(home) if (found := _job(home, number)) is not None]


def _job(home: Path, number: int) -> Job | None:
    folder = _folder(home, number)
    about, lines, ended = _read(folder / ABOUT), _read(folder / LINES), _read(folder / ENDED)
    if about is None or lines is None:
        return None
    codes = tuple(entry["code"] for entry in (ended or {}).get("lines", ()))
    return Job(
        number=number,
        action=str(about["action"]),
        lines=tuple(tuple(line) for line in lines),
        began=float(about["began"]),
        status=_status(folder, float(about["began"]), codes if (ended or {}).get("time") else ()),
        ended=(ended or {}).get("time"),
        codes=codes,
        said=_tail(folder / STDERR),
        result=_tail(folder / STDOUT),
    )


def _status(folder: Path, began: float, codes: Sequence[int]) -> Status:
    """`codes` are those of a job that has ended."""
    if codes:
        if codes[-1] in DONE:
            return "done"
        return "stopped" if codes[-1] == INTERRUPTED else "failed"
    if is_held(folder / ALIVE):
        return "running"
    if (_read(folder / ENDED) or {}).get("time"):
        return "running"  # it has just ended: the next look reads how
    is_new = not _was_held(folder / ALIVE) and time.time() - began < START_SECONDS
    return "running" if is_new else "lost"


def _was_held(path: Path) -> bool:
    """Whether the process of the job has come to hold the lock; it makes the file a moment before."""
    try:
        return path.stat().st_size > 0
    except FileNotFoundError:
        return False


def _new(home: Path) -> tuple[int, Path]:
    """The number and folder of a new job, which no other server takes at the same time."""
    number = max(_numbers(home), default=0) + 1
    while True:
        folder = _folder(home, number)
        try:
            folder.mkdir(parents=True)
            return number, folder
        except FileExistsError:
            number += 1


def _folder(home: Path, number: int) -> Path:
    return home / "jobs" / f"{number:04d}"


def _numbers(home: Path) -> list[int]:
    folder = home / "jobs"
    return sorted(int(p.name) for p in folder.iterdir() if p.name.isdigit()) if folder.is_dir() else []


def _record(home: Path, lines: Sequence[Line]) -> None:
    """Add the lines to the script of the session, which does all of it again."""
    path = home / SCRIPT
    is_new = not path.exists()
    with path.open("a", encoding="utf-8") as stream:
        if is_new:
            stream.write(
                "#!/bin/sh\n# What was done on the live page; run it in the folder of the project.\n"
            )
        stream.writelines(f"{shown(line)}\n" for line in lines)


def _read(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


def _tail(path: Path) -> str:
    try:
        with path.open("rb") as stream:
            stream.seek(0, os.SEEK_END)
            stream.seek(max(0, stream.tell() - TAIL))
            return stream.read().decode("utf-8", errors="replace")
    except OSError:
        return ""
