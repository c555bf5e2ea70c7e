"""Who may speak to the server of the live page, and what it may touch."""

import json
import socket
from pathlib import Path

import pytest
from served import awaited, served
from tornado.httpclient import HTTPClientError, HTTPRequest
from tornado.websocket import websocket_connect

from daest.app.server import keep_dropped
from daest.errors import ConfigError

PAGES = ("", "app.js", "app.css", "drawing/bokeh.js", "drawing/report.css", "api/state", "api/pictures")


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    folder = tmp_path_factory.mktemp("project")
    (folder / "secret.txt").write_text("not for the page")
    (folder / "report.html").write_text("<script>1</script>")
    with served(folder) as found:
        yield found


def test_it_answers_its_own_page(server):
    for page in PAGES:
        status, headers, body = server.ask("GET", page)
        assert status == 200 and body, page
        assert headers["Cache-Control"] in ("no-store", "private, max-age=86400")
        assert "default-src 'none'" in headers["Content-Security-Policy"]
        assert headers["X-Content-Type-Options"] == "nosniff" and headers["Referrer-Policy"] == "no-referrer"


def test_it_listens_on_loopback_alone(server):
    port = int(server.host.rpartition(":")[2])
    # The other addresses of this machine: none of them answers on the port.
    for address in {found[4][0] for found in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)}:
        if not address.startswith("127."):
            with socket.socket() as other, pytest.raises(OSError):
                other.settimeout(2.0)
                other.connect((address, port))
    with socket.socket() as other:  # 127.0.0.2 is loopback, but not where it listens
        other.settimeout(2.0)
        assert other.connect_ex(("127.0.0.2", port)) != 0


@pytest.mark.parametrize("path", ["/", "/x/", "/x/api/state", "/" + 32 * "A" + "/", "/api/state"])
def test_without_the_token_nothing_is_told(server, path):
    status, _, body = server.ask("GET", path)
    assert status == 403 and b"token" in body


def test_another_name_for_this_machine_is_refused(server):
    """As a page does whose name was bent to 127.0.0.1."""
    port = server.host.rpartition(":")[2]
    for host in ("evil.example", f"evil.example:{port}", "127.0.0.1", f"127.0.0.1:{int(port) + 1}"):
        assert server.ask("GET", "api/state", Host=host)[0] == 403
    assert server.ask("GET", "api/state", Host=f"localhost:{port}")[0] == 200


@pytest.mark.parametrize(
    "origin", [None, "null", "http://evil.example", "https://127.0.0.1", "http://127.0.0.1"]
)
def test_other_pages_cannot_click(server, origin):
    headers = {} if origin is None else {"Origin": origin}
    for method, path in (("POST", "api/run"), ("PUT", "api/drop?name=a.csv")):
        assert server.ask(method, path, b'{"action": "check"}', **headers)[0] == 403
    assert not (server.folder / "a.csv").exists() and not server.state()["jobs"]


def test_other_pages_cannot_listen(server):
    async def connect(origin: str) -> str:
        request = HTTPRequest(server.address.replace("http", "ws") + "api/live", headers={"Origin": origin})
        connection = await websocket_connect(request)
        text = await connection.read_message()
        connection.close()
        return str(text)

    with pytest.raises(HTTPClientError, match="403"):
        awaited(connect("http://evil.example"))
    assert json.loads(awaited(connect(f"http://{server.host}")))["kind"] == "state"


@pytest.mark.parametrize(
    "path", ["secret.txt", "../secret.txt", "..%2fsecret.txt", "%2e%2e/secret.txt", "drawing/../secret.txt",
             "report.html/../secret.txt", "site/app.js", "server.py", "__init__.py"]
)  # fmt: skip
def test_no_other_file_is_served(server, path):
    status, _, body = server.ask("GET", path)
    assert status == 404 and b"not for the page" not in body


def test_a_report_has_an_origin_of_its_own(server):
    status, headers, body = server.ask("GET", "report.html")
    assert status == 200 and body == b"<script>1</script>"
    assert "sandbox allow-scripts" in headers["Content-Security-Policy"]
    assert "allow-same-origin" not in headers["Content-Security-Policy"]


def test_a_link_to_another_report_is_not_followed(tmp_path):
    (tmp_path / "secret.html").write_text("not for the page")
    folder = tmp_path / "project"
    folder.mkdir()
    (folder / "report.html").symlink_to(tmp_path / "secret.html")
    with served(folder) as found:
        assert found.ask("GET", "report.html")[0] == 404


@pytest.mark.parametrize(
    "name",
    ["", ".", "..", "../a.csv", "/tmp/a.csv", "a/b.csv", "a\\b.csv", "-o.csv", ".a.csv", "a\n.csv", "a\0.csv",
     121 * "a" + ".csv", "daest.toml", "a.sh", "a.html", "a"],
)  # fmt: skip
def test_names_of_dropped_files(tmp_path, name):
    folder = tmp_path / "project"
    folder.mkdir()
    with pytest.raises(ConfigError) as caught:
        keep_dropped(folder, name, b"1")
    assert caught.value.code == "app-file"
    assert list(tmp_path.rglob("*")) == [folder]


def test_dropped_files_replace_nothing(tmp_path):
    keep_dropped(tmp_path, "run 1.csv", b"time\n0\n")
    keep_dropped(tmp_path, "run 1.csv", b"time\n0\n")
    with pytest.raises(ConfigError, match="another file"):
        keep_dropped(tmp_path, "run 1.csv", b"time\n1\n")
    Path(tmp_path / "link.csv").symlink_to(tmp_path / "nowhere")
    with pytest.raises(ConfigError, match="another file"):
        keep_dropped(tmp_path, "link.csv", b"")
    assert (tmp_path / "run 1.csv").read_bytes() == b"time\n0\n" and len(list(tmp_path.iterdir())) == 2


def test_no_candidate_is_simulated_that_no_diagnosis_has(server):
    for asked in ("effect=x&at=y", "effect=../../etc/passwd&at=.", ""):
        assert server.ask("GET", f"api/beside?{asked}")[0] == 409
    assert not (server.folder / "results" / "app" / "beside").exists()


def test_what_is_no_request(server):
    own = {"Origin": f"http://{server.host}"}
    for body in (b"", b"[]", b"{", b"[" * 100_000):
        assert server.ask("POST", "api/run", body, **own)[0] == 400
    for asked in (
        {"action": "rm"}, {"action": ["check"]}, {"action": "init", "model": "../x.mo", "data": "a.csv"},
        {"action": "identify", "locked": {"--jobs": 1}}, {"action": "identify", "locked": [1]},
        {"action": "add", "effect": "A", "at": "b"}, {"action": "stand", "step": 7}, {"action": "stand"},
        {"action": "stop", "job": True}, {},
    ):  # fmt: skip
        status, told = server.click(**asked)
        assert (status, told["code"]) == (409, "app-request"), asked
    assert not server.state()["jobs"]
