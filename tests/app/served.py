"""A server of the live page in a thread of the tests, and requests to it as programs and pages send them."""

import asyncio
import http.client
import json
import threading
from collections.abc import Coroutine, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from daest.app.server import listening
from daest.app.state import Desk


@dataclass(frozen=True)
class Served:
    """A server of `folder` at `address`."""

    folder: Path
    address: str

    @property
    def host(self) -> str:
        return urlsplit(self.address).netloc

    @property
    def path(self) -> str:
        return urlsplit(self.address).path

    def ask(
        self, method: str, path: str, body: bytes | None = None, **headers: str
    ) -> tuple[int, dict[str, str], bytes]:
        """Status, headers and body of the answer to `path`, whole where it begins with a slash."""
        connection = http.client.HTTPConnection(self.host, timeout=30)
        try:
            given = {key.replace("_", "-"): value for key, value in headers.items()}
            whole = path if path.startswith("/") else self.path + path
            connection.request(method, whole, body, given)
            answer = connection.getresponse()
            return answer.status, dict(answer.getheaders()), answer.read()
        finally:
            connection.close()

    def click(self, **asked: Any) -> tuple[int, dict[str, Any]]:
        """What a click of the page is answered."""
        body = json.dumps(asked).encode()
        status, _, found = self.ask("POST", "api/run", body, Origin=f"http://{self.host}")
        return status, json.loads(found)

    def state(self) -> dict[str, Any]:
        return json.loads(self.ask("GET", "api/state")[2])["state"]


def awaited(coroutine: Coroutine[Any, Any, Any]) -> Any:
    """What a coroutine returns, in a thread of its own: a browser of the tests keeps a loop in theirs."""
    with ThreadPoolExecutor(1) as pool:
        return pool.submit(asyncio.run, coroutine).result()


@contextmanager
def served(folder: Path) -> Iterator[Served]:
    told: list[str] = []
    begun, ended = threading.Event(), threading.Event()

    async def work() -> None:
        async with listening(Desk(folder)) as address:
            told.append(address)
            begun.set()
            await asyncio.get_running_loop().run_in_executor(None, ended.wait)

    thread = threading.Thread(target=lambda: asyncio.run(work()))
    thread.start()
    try:
        assert begun.wait(20.0)
        yield Served(folder, told[0])
    finally:
        ended.set()
        thread.join()
