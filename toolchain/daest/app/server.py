"""The server of the live page. It computes nothing: it reads the folder, starts commands and passes on what
the simulating process says, so that it always answers."""

from __future__ import annotations

import asyncio
import importlib
import json
import os
import re
import secrets
import shlex
import signal
import sys
import webbrowser
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Any

import tornado.httpserver
import tornado.netutil
import tornado.web
import tornado.websocket

from daest.app import actions
from daest.app.guard import LOOPBACK, POLICY, REPORT_POLICY, Guard, headers
from daest.app.jobs import SCRIPT, start, stop
from daest.app.locks import locked
from daest.app.simulator import Simulator
from daest.app.state import HOME, RECORDINGS, REPORT, Desk, preview, signature, state
from daest.app.story import keep_story
from daest.errors import ConfigError, DaestError, Place, printable
from daest.files import MODEL_SUFFIXES, whole_file

TOKEN_BYTES = 24
LOOK_SECONDS = 0.25  # between two looks at the folder
LARGEST_BODY = 256 << 20  # bytes of a file that is dropped onto the page
LOCK = "server"  # in the home of the page: locked by the server, with its address
KINDS = {".html": "text/html", ".js": "text/javascript", ".css": "text/css"}
SHARED = {"report.css": "style.css", "figures.js": "figures.js"}  # files of the report by their names here
PICTURES = "daest.app.pictures"  # its import takes a second, which the first page need not wait for
EFFECT = re.compile(r"[A-Za-z_][\w.]{0,199}")  # name of a class
NAME_LENGTH = 120  # characters of the name of a file that is dropped


@dataclass
class Pages:
    """The pages that are open, and the state that they were told last."""

    desk: Desk
    simulator: Simulator
    drawing: asyncio.Lock = field(default_factory=asyncio.Lock)  # one candidate at a time is simulated
    open: set[Live] = field(default_factory=set)
    signature: tuple[Any, ...] = ()
    text: str = ""

    async def look(self) -> None:
        """Tell all pages where the folder has changed."""
        loop = asyncio.get_running_loop()
        found = await loop.run_in_executor(None, signature, self.desk)
        if found == self.signature:
            return
        self.signature = found
        text = await loop.run_in_executor(None, _state_text, self.desk)
        if text != self.text:
            self.text = text
            for page in list(self.open):
                page.tell(text)


def _state_text(desk: Desk) -> str:
    return json.dumps({"kind": "state", "state": _finite(state(desk))}, allow_nan=False)


def _finite(value: Any) -> Any:
    """Without NaN and infinities, which JSON does not have."""
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_finite(entry) for entry in value]
    return None if isinstance(value, float) and value - value != 0.0 else value


class Own(tornado.web.RequestHandler):
    """What answers its own page alone. The first part of every path is the token."""

    def initialize(self, guard: Guard, desk: Desk, pages: Pages) -> None:
        self.guard, self.desk, self.pages = guard, desk, pages

    def prepare(self) -> None:
        why = self.guard.why_not(self.request, str(self.path_kwargs.pop("token", "")))
        if why is not None:
            raise tornado.web.HTTPError(403, reason=why)


class Guarded(Own):
    """A handler of requests, with the headers that keep the page to itself."""

    policy = POLICY

    def set_default_headers(self) -> None:
        for name, value in headers(self.policy).items():
            self.set_header(name, value)
        self.clear_header("Server")

    def write_error(self, status_code: int, **_: Any) -> None:
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(f"{status_code}: {self._reason}\n")

    def refuse(self, error: DaestError) -> None:
        self.set_status(409)
        self.write({"code": error.code, "what": printable(error.what), "remedy": printable(error.remedy)})

    @contextmanager
    def refusing(self, path: Path) -> Iterator[None]:
        """Answers with the DaestError of the block, or that `path` cannot be written."""
        try:
            yield
        except DaestError as problem:
            self.refuse(problem)
        except OSError as problem:
            self.refuse(_refused(path, problem))

    def asked(self) -> dict[str, Any]:
        """The JSON object of the request."""
        with suppress(ValueError, RecursionError):
            found = json.loads(self.request.body)
            if isinstance(found, dict):
                return found
        raise tornado.web.HTTPError(400, reason="a JSON object is expected")


class File(Guarded):
    """A file of the page itself."""

    def get(self, name: str = "") -> None:
        file = resources.files("daest.app").joinpath("site", name or "index.html")
        if not file.is_file():
            raise tornado.web.HTTPError(404, reason="there is no such file")
        self.set_header("Content-Type", f"{KINDS[Path(file.name).suffix]}; charset=utf-8")
        self.finish(file.read_bytes())


class Drawing(Guarded):
    """The drawing library, and what the page shares with the report."""

    def get(self, name: str) -> None:
        if name in SHARED:
            shared = SHARED[name]
            self.set_header("Content-Type", f"{KINDS[Path(shared).suffix]}; charset=utf-8")
            self.finish(resources.files("daest.report.page").joinpath(shared).read_bytes())
            return
        import bokeh

        self.set_header("Content-Type", "text/javascript; charset=utf-8")
        self.set_header("Cache-Control", "private, max-age=86400")
        folder = Path(bokeh.__file__).parent / "server" / "static" / "js"
        self.finish((folder / "bokeh.min.js").read_bytes())


class State(Guarded):
    """The state of the folder, for pages without a socket and for scripts."""

    async def get(self) -> None:
        loop = asyncio.get_running_loop()
        text = await loop.run_in_executor(None, _state_text, self.desk)
        self.set_header("Content-Type", "application/json")
        self.finish(text)


class Plots(Guarded):
    """Plots, which `function` of `daest.app.pictures` makes in a thread of its own; none of nothing."""

    function = ""

    def subject(self) -> Any:
        """What is drawn."""
        return self.desk

    async def get(self) -> None:
        subject = self.subject()
        loop = asyncio.get_running_loop()
        plots = await loop.run_in_executor(None, _drawn, self.function, subject) if subject else []
        self.write({"plots": plots})


def _drawn(function: str, subject: Any) -> list[dict[str, Any]]:
    return getattr(importlib.import_module(PICTURES), function)(subject)


class Pictures(Plots):
    """Plots of the comparison."""

    function = "comparison_pictures"


class Recordings(Plots):
    """Plots of the recordings, with what the check has found."""

    function = "recording_pictures"


class Sliders(Plots):
    """Empty plots for what the simulating process tells."""

    function = "following_pictures"

    def subject(self) -> Any:
        told = self.pages.simulator.introduced
        return json.loads(told) if told else None


class Effect(Guarded):
    """The law of an effect, as daest effects tells it."""

    async def get(self) -> None:
        name = str(self.get_query_argument("name", ""))
        if not EFFECT.fullmatch(name):
            raise tornado.web.HTTPError(404, reason="there is no such effect")
        process = await _begun(self.desk.folder, ["effects", name, "--format", "json"])
        out, _ = await process.communicate()
        if process.returncode != 0:
            raise tornado.web.HTTPError(404, reason="there is no such effect")
        effect = json.loads(out)["effects"][0]
        self.write({key: effect[key] for key in ("name", "law", "description", "documentation")})


class Beside(Guarded):
    """The current model and the same with a candidate, simulated on the data by a process of their own."""

    async def get(self) -> None:
        asked = {key: str(self.get_query_argument(key, "")) for key in ("effect", "at")}
        try:
            base, extended = self.desk.beside(asked)
        except DaestError as problem:
            self.refuse(problem)
            return
        except OSError as problem:
            self.refuse(_refused(self.desk.home, problem))
            return
        async with self.pages.drawing:
            said = await self._said(["app", "--follow", base, "--beside", extended])
        if said is None:
            raise tornado.web.HTTPError(404, reason="the model cannot be simulated with it")
        line = f"daest compare {shlex.quote(base)} {shlex.quote(extended)}"
        self.set_header("Content-Type", "application/json")
        self.finish(json.dumps({**_finite(json.loads(said)), "line": line}, allow_nan=False))

    def on_connection_close(self) -> None:
        """The page looks elsewhere: what it asked for need not be finished."""
        if self.process is not None and self.process.returncode is None:
            with suppress(ProcessLookupError):
                self.process.kill()

    process: asyncio.subprocess.Process | None = None

    async def _said(self, arguments: list[str]) -> bytes | None:
        self.process = await _begun(self.desk.folder, arguments)
        out, _ = await self.process.communicate()
        return out if self.process.returncode == 0 else None


async def _begun(folder: Path, arguments: list[str]) -> asyncio.subprocess.Process:
    """A `daest` line in a process whose stdout is read."""
    return await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "daest", *arguments),
        cwd=folder,
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.DEVNULL,
    )


class Run(Guarded):
    """A click: starts its lines, or shows them where `dry` is asked for."""

    def post(self) -> None:
        asked = self.asked()
        with self.refusing(self.desk.home):
            self.write(clicked(self.desk, asked))


def clicked(desk: Desk, asked: dict[str, Any]) -> dict[str, Any]:
    """Do what a click asks for. Raises DaestError and OSError."""
    if not desk.folder.is_dir():
        raise _gone(desk.folder)
    action, is_dry = str(asked.get("action")), bool(asked.get("dry"))
    if action == "stop":
        stop(desk.home, _number(asked.get("job")))
        return {"lines": []}
    if action == "stand":
        keep_story(desk.home, desk.story().standing_at(_number(asked.get("step"))))
        return {"lines": []}
    standing = desk.standing()
    if action == "add":
        found = actions.candidate(asked, standing.diagnosis)
        standing = replace(standing, story=standing.story.added(HOME, found["effect"], found["at"]))
    lines = actions.lines(action, asked, standing)
    if is_dry:
        return {"lines": preview(lines)}
    number = start(desk.folder, desk.home, action, lines)
    if action == "add":
        keep_story(desk.home, standing.story)
    return {"lines": preview(lines), "job": number}


def _number(value: Any) -> int:
    if isinstance(value, int) and not isinstance(value, bool):
        return value
    raise ConfigError("app-request", "a number is expected", remedy="load the page again")


class Drop(Guarded):
    """A file that is dropped onto the page: kept in the folder of the project, never over another one."""

    def put(self) -> None:
        name = str(self.get_query_argument("name", ""))
        with self.refusing(self.desk.folder / "file"):
            if not self.desk.folder.is_dir():
                raise _gone(self.desk.folder)
            keep_dropped(self.desk.folder, name, self.request.body)
            self.write({"name": name})


def keep_dropped(folder: Path, name: str, content: bytes) -> None:
    """Write a file under its plain name. Raises ConfigError `app-file` and OSError."""
    is_plain = name == Path(name).name and name.isprintable() and not name.startswith((".", "-"))
    if not is_plain or "\\" in name or not 0 < len(name) <= NAME_LENGTH:
        raise _file(name, "its name is not one of a file in this folder", "give it a plain name")
    if not name.lower().endswith((*MODEL_SUFFIXES, *RECORDINGS)):
        raise _file(
            name, "it is neither a model nor a recording", f"drop {', '.join((*MODEL_SUFFIXES, *RECORDINGS))}"
        )
    target = folder / name
    if os.path.lexists(target):
        if target.is_file() and target.read_bytes() == content:
            return
        raise _file(name, "the folder has another file of that name", "rename one of them")
    with whole_file(target) as temporary:
        temporary.write_bytes(content)


def _file(name: str, why: str, remedy: str) -> ConfigError:
    return ConfigError("app-file", f"'{name}' is not taken: {why}", remedy=remedy)


class Report(Guarded):
    """The report of the folder, in an origin of its own."""

    policy = REPORT_POLICY

    def get(self) -> None:
        self.clear_header("X-Frame-Options")
        path = self.desk.folder / REPORT
        if not path.is_file() or path.is_symlink():
            raise tornado.web.HTTPError(404, reason="there is no report yet")
        self.set_header("Content-Type", "text/html; charset=utf-8")
        self.finish(path.read_bytes())


class Script(Guarded):
    """The lines of all clicks as a script."""

    def get(self) -> None:
        path = self.desk.home / SCRIPT
        self.set_header("Content-Type", "text/x-shellscript; charset=utf-8")
        self.set_header("Content-Disposition", 'attachment; filename="session.sh"')
        self.finish(path.read_bytes() if path.is_file() else b"")


class Live(Own, tornado.websocket.WebSocketHandler):
    """What one page is told while it is open."""

    def check_origin(self, origin: str) -> bool:
        return self.guard.is_own(origin)

    def open(self, *_: str, **__: str) -> None:
        self.pages.open.add(self)
        if self.pages.text:
            self.tell(self.pages.text)

    def tell(self, text: str) -> None:
        with suppress(tornado.websocket.WebSocketClosedError):
            self.write_message(text)

    def on_message(self, message: str | bytes) -> None:
        """A question to the simulating process."""
        with suppress(ValueError, RecursionError, DaestError, OSError):
            question = json.loads(message)
            if isinstance(question, dict):
                model, stamps = self.desk.simulated()
                self.pages.simulator.ask((model, *stamps), ["app", "--follow", model], question, self.tell)

    def on_close(self) -> None:
        self.pages.open.discard(self)
        self.pages.simulator.forget(self.tell)


def application(guard: Guard, desk: Desk, pages: Pages) -> tornado.web.Application:
    own = {"guard": guard, "desk": desk, "pages": pages}
    routes: tuple[tuple[str, type[tornado.web.RequestHandler]], ...] = (
        ("", File),
        (r"(?P<name>[a-z]+\.(?:js|css))", File),
        (r"drawing/(?P<name>bokeh\.js|figures\.js|report\.css)", Drawing),
        ("api/state", State),
        ("api/pictures", Pictures),
        ("api/recordings", Recordings),
        ("api/sliders", Sliders),
        ("api/effect", Effect),
        ("api/beside", Beside),
        ("api/run", Run),
        ("api/drop", Drop),
        ("api/live", Live),
        ("session.sh", Script),
        ("report.html", Report),
    )
    return tornado.web.Application(
        [(f"/(?P<token>[\\w-]+)/{path}", handler, own) for path, handler in routes],
        default_handler_class=Nothing,
        default_handler_args=own,
        log_function=lambda _: None,
        websocket_ping_interval=20,
    )


class Nothing(Guarded):
    """Any other path."""

    def prepare(self) -> None:
        why = self.guard.why_not(self.request, self.request.path.strip("/").partition("/")[0])
        raise tornado.web.HTTPError(404 if why is None else 403, reason=why or "there is no such page")


def serve(folder: Path, port: int, is_opened: bool, tell: Callable[[str], None]) -> None:
    """Serve the folder until the program is asked to end. `tell` gets the address; `is_opened` opens it in a
    browser.

    Raises ConfigError `app-folder`, `app-running`, `app-port`, `output-unwritable`.
    """
    if not folder.is_dir():
        raise ConfigError(
            "app-folder",
            "there is no such folder",
            where=Place(str(folder)),
            remedy="name the folder of a project, or an empty one; daest demo servo makes one",
        )
    desk = Desk(folder.resolve())
    held = _claimed(desk.home)
    try:
        asyncio.run(_serving(desk, port, is_opened, tell, held))
    finally:
        os.close(held)


def _claimed(home: Path) -> int:
    """The lock of this server on the folder. Raises ConfigError `app-running`, `output-unwritable`."""
    try:
        home.mkdir(parents=True, exist_ok=True)
        held = locked(home / LOCK)
    except OSError as problem:
        raise _refused(home, problem) from problem
    if held is None:
        address = (home / LOCK).read_text(encoding="ascii", errors="replace").strip()
        raise ConfigError(
            "app-running",
            "another daest app serves this folder",
            where=Place(str(home.parents[1])),
            remedy=f"open {address or 'its address'}, or end it with Ctrl-C",
        )
    return held


async def _serving(desk: Desk, port: int, is_opened: bool, tell: Callable[[str], None], held: int) -> None:
    ended = asyncio.Event()
    loop = asyncio.get_running_loop()
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        if hasattr(signal, name):
            with suppress(NotImplementedError):
                loop.add_signal_handler(getattr(signal, name), ended.set)
    async with listening(desk, port) as address:
        os.ftruncate(held, 0)
        os.write(held, address.encode())
        tell(address)
        if is_opened:
            webbrowser.open(address)
        await ended.wait()


@asynccontextmanager
async def listening(desk: Desk, port: int = 0) -> AsyncIterator[str]:
    """Serve the folder inside the block; yields the address. Raises ConfigError `app-port`."""
    try:
        sockets = tornado.netutil.bind_sockets(port, LOOPBACK)
    except OSError as problem:
        raise ConfigError(
            "app-port",
            f"the port {port} is refused: {problem.strerror or problem}",
            remedy="another program listens there, or it needs rights: name another one with --port",
        ) from problem
    guard = Guard(secrets.token_urlsafe(TOKEN_BYTES), sockets[0].getsockname()[1])
    pages = Pages(desk, Simulator(desk.folder))
    server = tornado.httpserver.HTTPServer(
        application(guard, desk, pages), max_buffer_size=LARGEST_BODY, max_body_size=LARGEST_BODY
    )
    server.add_sockets(sockets)
    looking = asyncio.create_task(_every(LOOK_SECONDS, pages.look))
    warming = asyncio.get_running_loop().run_in_executor(None, importlib.import_module, PICTURES)
    try:
        yield guard.address()
    finally:
        looking.cancel()
        pages.simulator.end()
        server.stop()
        for page in list(pages.open):
            page.close()
        await warming


async def _every(seconds: float, work: Callable[[], Awaitable[None]]) -> None:
    while True:
        with suppress(OSError, ValueError):
            await work()
        await asyncio.sleep(seconds)


def _gone(folder: Path) -> ConfigError:
    return ConfigError(
        "app-folder-gone",
        "the folder of the project has gone",
        where=Place(str(folder)),
        remedy="put it back, or end daest app and start it in another folder",
    )


def _refused(path: Path, problem: OSError) -> ConfigError:
    return ConfigError(
        "output-unwritable",
        f"the folder cannot be written: {problem.strerror or problem}",
        where=Place(str(path)),
        remedy="work in a copy of the project, in a folder that can be written",
    )
