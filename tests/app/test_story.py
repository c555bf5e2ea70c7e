"""The user's story in a real browser: fit, compare, move a slider, search, open, add, take back, report."""

import json
from pathlib import Path

import pytest
from cart_data import CART, recording, write_recording
from served import served

from daest.app.state import HOME

pytestmark = pytest.mark.browser
LONG = 300_000  # ms that a search may take on a busy machine
PROJECT = '[model]\nsource = "Cart.mo"\n[data]\nestimate = ["rub.csv"]\nsplit = 0.6\nhold = "zoh"\n'


def settled(page, number: int) -> None:
    """Wait until the job of this number has ended."""
    page.wait_for_selector(f"#work .job[data-number='{number}']:not(.running)", timeout=LONG)


@pytest.fixture(scope="module")
def cart(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("cart")
    (folder / "Cart.mo").write_text(CART)
    write_recording(folder / "rub.csv", recording(1000, 4, friction=0.5))
    return folder


@pytest.fixture(scope="module")
def window(browser):
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    context.set_default_timeout(60_000)
    page = context.new_page()
    page.complaints = []
    page.on("pageerror", lambda e: page.complaints.append(str(e)))
    page.on("console", lambda m: page.complaints.append(m.text) if m.type == "error" else None)
    yield page
    context.close()


def opened(page, server, part: str = "") -> None:
    page.goto("about:blank")
    page.goto(server.address + part)
    page.wait_for_selector("html[data-ready=true]")


def test_an_empty_folder_waits_for_a_model_and_a_recording(tmp_path, window):
    """Names of files are text, whatever stands in them."""
    odd = "<img src=x onerror=document.title='broken'>.csv"
    with served(tmp_path) as server:
        opened(window, server)
        assert "A model and a recording" in window.inner_text("#start")
        window.set_input_files("input[type=file]", [
            {"name": "Cart.mo", "mimeType": "text/plain", "buffer": CART.encode()},
            {"name": odd, "mimeType": "text/csv", "buffer": b"time,F,s\n0,0,0\n"},
            {"name": "wrong.sh", "mimeType": "text/plain", "buffer": b"true"},
        ])  # fmt: skip
        window.wait_for_selector("#trouble:not([hidden])")
        assert "wrong.sh" in window.inner_text("#trouble")
        window.wait_for_selector("select[data-key=data]")
        assert window.locator("option", has_text="onerror").count() == 1
        assert window.locator("img").count() == 0 and "broken" not in window.title()
    assert sorted(p.name for p in tmp_path.iterdir() if p.is_file()) == [odd, "Cart.mo"]
    # The browser itself tells of what was refused, and of nothing else; the next test begins without it.
    assert len(window.complaints) == 1 and "409" in window.complaints.pop()


@pytest.mark.slow
def test_the_whole_story(cart, window):
    with served(cart) as server:
        opened(window, server)
        window.get_by_role("button", name="Set up").click()
        window.wait_for_selector("h3:has-text('The recordings')")
        settled(window, 1)
        assert "no fault found" in window.inner_text("#start") or "warning" in window.inner_text("#start")
        (cart / "daest.toml").write_text(PROJECT)  # the user completes what was written

        window.wait_for_selector("text=60 %")
        window.get_by_role("button", name="Fit and compare").click()
        settled(window, 2)
        window.click("text=Compare")
        window.wait_for_selector("#compare .pictures[data-drawn]:not([data-drawn='0'])")
        first = errors(cart, 0)
        assert f"{first['s']:.3g}"[:4] in window.inner_text("#compare table")

        window.click("text=Parameters")
        window.wait_for_selector("input[data-parameter=c]")
        window.wait_for_selector("#parameters .pictures[data-frames]")
        before = window.inner_text("td[data-error=s]")
        slider = window.locator("input[data-parameter=c]")
        slider.focus()
        for _ in range(50):
            window.keyboard.press("ArrowRight")
        window.wait_for_function(
            "before => document.querySelector('td[data-error=s]').textContent !== before", arg=before
        )
        assert "--set c=" in window.inner_text("#simulate-line")
        window.get_by_role("button", name="Back to the fit").click()
        window.wait_for_function(
            "before => document.querySelector('td[data-error=s]').textContent === before", arg=before
        )

        window.click("text=What is missing")
        window.get_by_role("button", name="Search for what is missing").click()
        window.wait_for_selector("text=Stop the search")
        settled(window, 3)
        window.wait_for_selector(".candidate")
        found = window.locator(".candidate", has=window.locator("summary .badge.good")).first
        added = found.locator("strong").inner_text().split()[0]
        assert added.endswith("Friction")
        found.locator("summary").click()
        found.get_by_role("button", name="Add it").wait_for()
        assert "f = -f_c*" in found.inner_text()  # its law
        assert "extends Cart" in found.inner_text() and "daest extend" in found.inner_text()
        found.get_by_role("button", name="Add it").click()
        settled(window, 4)
        window.wait_for_selector(f"text=Take {added} back")
        second = errors(cart, 1)
        assert second["s"] < 0.2 * first["s"]
        assert window.locator("svg.stairs").get_attribute("aria-label").count(",") == 1

        window.get_by_role("button", name=f"Take {added} back").click()
        window.wait_for_selector("text=a branch not taken")
        window.get_by_role("button", name=f"{added} at").first.click()
        window.wait_for_selector(f"text=Take {added} back")

        window.click("text=Doubt")
        window.click("#parts >> text=Report")
        window.get_by_role("button", name="Write the report").click()
        settled(window, 5)
        window.wait_for_selector("text=Open the report")
        script = server.ask("GET", "session.sh")[2].decode().splitlines()
    assert window.complaints == []
    assert [line.split()[1] for line in script[2:]] == [
        "init", "check", "identify", "compare", "diagnose", "extend", "identify", "compare", "report"
    ]  # fmt: skip
    assert (cart / "report.html").is_file() and (cart / HOME / "models" / f"1_{added}.mo").is_file()


def errors(folder: Path, step: int) -> dict[str, float]:
    document = json.loads((folder / HOME / "steps" / f"{step}.json").read_text())
    return document["models"][-1]["rms"]
