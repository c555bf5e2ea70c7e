"""Five hundred actions on one server: its memory, descriptors and processes stay as they are."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from lag_data import PROJECT, write_lag
from served import Served, awaited
from tornado.httpclient import HTTPRequest
from tornado.websocket import websocket_connect

from daest.cli.main import run

pytestmark = [pytest.mark.slow, pytest.mark.skipif(sys.platform != "linux", reason="looks into /proc")]
N_ACTIONS = int(os.environ.get("DAEST_SOAK", "500"))
EVERY = 50  # actions between two looks
GROWTH = 1.10  # of the memory behind the first quarter


async def followed(server: Served, number: int) -> None:
    """A page that opens, moves a slider three times and closes."""
    request = HTTPRequest(server.address.replace("http", "ws") + "api/live")
    request.headers["Origin"] = f"http://{server.host}"
    page = await websocket_connect(request)
    seen: list[str] = []
    await page.write_message(json.dumps({"hello": True}))
    for i in range(3):
        await page.write_message(
            json.dumps({"id": i, "values": {"T": 0.4 + 0.001 * (number % 50) + 0.01 * i}})
        )
        while True:
            found = json.loads(await page.read_message())
            seen.append(found["kind"])
            if found["kind"] == "followed" and found["id"] == i:
                break
    assert "state" in seen and "unfollowed" not in seen
    page.close()


def act(server: Served, number: int, content: bytes) -> None:
    own = {"Origin": f"http://{server.host}"}
    match number % 6:
        case 0:
            assert server.ask("GET", "")[0] == server.ask("GET", "drawing/bokeh.js")[0] == 200
        case 1:
            assert server.state()["story"]["current"] == 0
        case 2:
            assert json.loads(server.ask("GET", "api/pictures")[2])["plots"]
        case 3:
            assert server.click(action="identify", locked={"T": 0.5}, dry=True)[0] == 200
            assert server.click(action="stand", step=0)[0] == 200
        case 4:
            assert server.ask("PUT", "api/drop?name=run2.csv", content, **own)[0] == 200
            assert server.ask("GET", "none")[0] == 404
        case 5:
            awaited(followed(server, number))


def looked(pid: int) -> tuple[int, int, int]:
    """Pages of memory, open descriptors and children of the server."""
    return (
        int(Path(f"/proc/{pid}/statm").read_text().split()[1]),
        len(os.listdir(f"/proc/{pid}/fd")),
        len(Path(f"/proc/{pid}/task/{pid}/children").read_text().split()),
    )


def test_five_hundred_actions(tmp_path, monkeypatch):
    write_lag(tmp_path)
    (tmp_path / "daest.toml").write_text(PROJECT)
    monkeypatch.chdir(tmp_path)
    assert run(["identify"]) == 0 and run(["compare"]) == 0
    content = (tmp_path / "run2.csv").read_bytes()
    command = [sys.executable, "-m", "daest", "app", "--no-browser", str(tmp_path)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        server = Served(tmp_path, process.stdout.readline().strip())
        seen = []
        for number in range(N_ACTIONS):
            act(server, number, content)
            if number % EVERY == EVERY - 1:
                seen.append(looked(process.pid))
    finally:
        process.terminate()
        assert process.wait(20) == 0
        process.stdout.close()
    settled = seen[len(seen) // 4 :]
    assert settled[-1][0] < GROWTH * settled[0][0], seen
    assert max(d for _, d, _ in settled) <= settled[0][1] + 2, seen
    assert max(c for _, _, c in settled) <= 2, seen
    print(seen)
