"""The simulating process from the side of the server: asked by pages, answered in time or not at all."""

from __future__ import annotations

import asyncio
import json
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

LONGEST_LINE = 64 << 20  # bytes of an answer
IDLE_SECONDS = 300.0  # without a question, after which the process goes
SAID = 2000  # characters of what a process has said before it ended
Answer = Callable[[str], None]
Key = tuple[Any, ...]


class Simulator:
    """One process for the model that stands; of the questions of a page the newest alone is answered."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._waiting: dict[Answer, dict[str, Any]] = {}
        self._asked = asyncio.Event()
        self._work: asyncio.Task[None] | None = None
        self._key: Key = ()
        self.introduced = ""
        self._process: asyncio.subprocess.Process | None = None

    def ask(self, key: Key, arguments: list[str], question: dict[str, Any], answer: Answer) -> None:
        """Ask the process of `key` (the model and its values), which the `arguments` of daest start; one of
        another key is ended."""
        if key != self._key or self._work is None or self._work.done():
            self.end()
            self._key = key
            self._work = asyncio.create_task(self._working(arguments))
        elif question.get("hello") and self.introduced:
            answer(self.introduced)
        self._waiting[answer] = question
        self._asked.set()

    def forget(self, answer: Answer) -> None:
        """A page has gone."""
        self._waiting.pop(answer, None)

    def end(self) -> None:
        if self._work is not None:
            self._work.cancel()
        if self._process is not None:
            with suppress(ProcessLookupError):
                self._process.kill()
        self._work, self._process, self.introduced = None, None, ""

    async def _working(self, arguments: list[str]) -> None:
        process = await asyncio.create_subprocess_exec(
            sys.executable,
            "-m",
            "daest",
            *arguments,
            cwd=self.folder,
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            limit=LONGEST_LINE,
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
        )
        self._process = process
        said: list[bytes] = []
        listening = asyncio.create_task(_heard(process, said))
        try:
            await self._conversation(process)
        except (OSError, ValueError, asyncio.IncompleteReadError):
            pass
        finally:
            if process.returncode is None:
                with suppress(ProcessLookupError):
                    process.kill()
            await asyncio.shield(process.wait())
            listening.cancel()
        text = b"".join(said).decode("utf-8", "replace")[-SAID:]
        lost = json.dumps({"kind": "unfollowed", "what": text.strip() or "the simulation has ended"})
        for answer in list(self._waiting):
            answer(lost)
        self._waiting.clear()

    async def _conversation(self, process: asyncio.subprocess.Process) -> None:
        """Ends when the process does, or when nobody has asked for long."""
        assert process.stdin is not None and process.stdout is not None
        first = await process.stdout.readline()
        if not first:
            return
        self.introduced = first.decode().strip()
        for answer in list(self._waiting):
            answer(self.introduced)
        while True:
            if not self._waiting:
                self._asked.clear()
                try:
                    await asyncio.wait_for(self._asked.wait(), IDLE_SECONDS)
                except TimeoutError:
                    return
            answer, question = next(iter(self._waiting.items()))
            del self._waiting[answer]
            if question.get("hello"):
                continue
            process.stdin.write(json.dumps(question).encode() + b"\n")
            await process.stdin.drain()
            line = await process.stdout.readline()
            if not line:
                self._waiting[answer] = question
                return
            answer(line.decode().strip())


async def _heard(process: asyncio.subprocess.Process, said: list[bytes]) -> None:
    assert process.stderr is not None
    while line := await process.stderr.readline():
        said.append(line)
        del said[:-50]
