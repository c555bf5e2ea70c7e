"""Fixtures that several rooms share."""

import os
import shutil
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

# As the commands do: small matrices, and two test processes beside each other.
for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
# Tests of processes ask for them; in the others they would only have to start.
os.environ["DAEST_JOBS"] = "1"


@pytest.fixture(autouse=True)
def no_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    """Text as wide as in a pipe: pytest tells its worker processes the width of its own terminal."""
    monkeypatch.delenv("COLUMNS", raising=False)


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of measured and simulated recordings beside the project; tests that need it skip without
    it."""
    folder = Path(__file__).resolve().parents[1].parent / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("the recordings beside the project are not here")
    return folder


@pytest.fixture(scope="session")
def browser():
    """A headless Chromium; tests that need one skip without it."""
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    found = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    with sync_api.sync_playwright() as playwright:
        try:
            launched = playwright.chromium.launch(executable_path=found, args=["--no-sandbox"])
        except sync_api.Error:
            pytest.skip("no Chromium is installed")
        yield launched
        launched.close()


@dataclass
class WatchedPage:
    """A page of a browser without a network; `complaints` of its console, and addresses it asked for."""

    page: Any
    scheme: str
    width: int
    complaints: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)

    @property
    def loaded_from_outside(self) -> list[str]:
        return [url for url in self.requests if not url.startswith(("file:", "data:"))]

    @property
    def scroll_width(self) -> int:
        """Width of the content: that of the window where nothing stands out."""
        return self.page.evaluate("document.documentElement.scrollWidth")


@pytest.fixture(params=["light", "dark"])
def scheme(request) -> str:
    return request.param


@pytest.fixture(params=[1280, 390])
def watched(request, browser, scheme):
    """A page of a screen and of a telephone, light and dark."""
    width = request.param
    context = browser.new_context(color_scheme=scheme, viewport={"width": width, "height": 800}, offline=True)
    found = WatchedPage(context.new_page(), scheme, width)
    is_complaint = ("error", "warning")
    found.page.on("console", lambda m: found.complaints.append(m.text) if m.type in is_complaint else None)
    found.page.on("pageerror", lambda e: found.complaints.append(str(e)))
    found.page.on("request", lambda r: found.requests.append(r.url))
    yield found
    context.close()
