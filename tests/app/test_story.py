"""The user's story in a real browser: fit, compare, move a slider, search, open, add, take back, report."""

import json
import shutil
from dataclasses import dataclass
from pathlib import Path

import pytest
from cart_data import CART, recording, write_recording
from served import served

from daest.app.state import HOME

pytestmark = pytest.mark.browser
LONG = 900_000  # ms that a search may take on a busy machine
FRICTIONS = ("CoulombFriction", "StribeckFriction")
MOST_TABS = 120  # from one end of a page to the other
PROJECT = '[model]\nsource = "Cart.mo"\n[data]\nestimate = ["rub.csv"]\nsplit = 0.6\nhold = "zoh"\n'


def settled(page, number: int) -> None:
    """Wait until the job of this number has ended."""
    page.wait_for_selector(f"#work .job[data-number='{number}']:not(.running)", timeout=LONG)


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


@dataclass(frozen=True)
class Machine:
    """A machine whose recordings show what its model lacks: the files, the project that the user completes,
    an output and a parameter, names of effects that say it and a part of their laws, how much of the error is
    left when the effect is in, and the size that is then estimated."""

    folder: Path
    project: str
    output: str
    parameter: str
    effects: tuple[str, ...]
    law: str
    left: float
    size: str
    reach: tuple[float, float]


@pytest.fixture
def cart_with_friction(tmp_path) -> Machine:
    (tmp_path / "Cart.mo").write_text(CART)
    write_recording(tmp_path / "rub.csv", recording(1000, 4, friction=0.5))
    return Machine(tmp_path, PROJECT, "s", "c", FRICTIONS, "*tanh(", 0.2, "f_c", (0.45, 0.55))


@pytest.fixture
def carriage(tmp_path, shared_data) -> Machine:
    """Measured: the carriage of the EMPS benchmark, force of the motor in, position out."""
    example = Path(__file__).resolve().parents[2] / "examples" / "emps"
    for path in (example / "Emps.mo", *(shared_data / "emps" / f"{n}.csv" for n in ("train", "test_pulses"))):
        shutil.copy(path, tmp_path)
    project = (example / "daest.toml").read_text()
    # Free integration over 25 s says little of a carriage whose position is controlled; the friction does.
    return Machine(tmp_path, project, "position", "M", FRICTIONS, "*tanh(", 1.2, "f_c", (19.0, 22.0))


@pytest.fixture
def servo_hidden(tmp_path) -> Machine:
    example = Path(__file__).resolve().parents[2] / "examples" / "servo_hidden"
    for name in ("Servo.mo", "servo.csv"):
        shutil.copy(example / name, tmp_path)
    project = (example / "daest.toml").read_text()
    # The friction that is missing besides lets the size of the spring move a little until it is in, too.
    return Machine(tmp_path, project, "omega", "c", ("HardeningSpring",), "^3", 0.75, "c3", (24.0, 32.0))


def press(page, locator, key: str = "Enter") -> None:
    """Go to an element by Tab alone, as who has no mouse does, and press a key there."""
    locator.wait_for()
    for _ in range(MOST_TABS):
        if locator.evaluate("e => e === document.activeElement"):
            page.keyboard.press(key)
            return
        page.keyboard.press("Tab")
    raise AssertionError(f"Tab does not reach {locator}")


def button(page, name: str):
    return page.get_by_role("button", name=name).first


def part(page, name: str):
    return page.locator("#parts a", has_text=name)


@pytest.mark.slow
@pytest.mark.parametrize("machine", ["cart_with_friction", "carriage", "servo_hidden"])
def test_the_whole_story_by_keyboard(machine, request, window):
    """From two files to the report, on a simulated and on a measured recording, without a mouse."""
    found = request.getfixturevalue(machine)
    with served(found.folder) as server:
        opened(window, server)
        press(window, button(window, "Set up"))
        window.wait_for_selector("h3:has-text('The recordings')")
        settled(window, 1)
        window.wait_for_selector("#start :is(.badge, .findings)")
        (found.folder / "daest.toml").write_text(found.project)  # the user completes what was written

        window.wait_for_selector("text=Fit and compare")
        press(window, button(window, "Fit and compare"))
        settled(window, 2)
        press(window, part(window, "Compare"))
        window.wait_for_selector("#compare .pictures[data-drawn]:not([data-drawn='0'])")
        first = errors(found.folder, 0)
        assert f"{first[found.output]:.3g}"[:4] in window.inner_text("#compare table")

        press(window, part(window, "Parameters"))
        move_a_slider(window, found)

        press(window, part(window, "What is missing"))
        press(window, button(window, "Search for what is missing"))
        window.wait_for_selector("text=Stop the search")
        settled(window, 3)
        window.wait_for_selector(".candidate")
        candidate = window.locator(".candidate").first
        added = candidate.locator("strong").inner_text().split()[0]
        assert added in found.effects
        press(window, candidate.locator("summary"))
        candidate.get_by_role("button", name="Add it").wait_for()
        assert found.law in candidate.inner_text() or "*sign(" in candidate.inner_text()
        assert "extends " in candidate.inner_text() and "daest extend" in candidate.inner_text()
        window.wait_for_selector(".candidate .pictures[data-drawn]")  # the model with it, on the data
        press(window, candidate.get_by_role("button", name="Add it"))
        settled(window, 4)
        window.wait_for_selector(f"text=Take {added} back")
        second = errors(found.folder, 1)
        assert second[found.output] < found.left * first[found.output]
        fitted = json.loads((found.folder / "results" / "fit.json").read_text())["parameters"]
        (size,) = (p["value"] for name, p in fitted.items() if name.endswith(f".{found.size}"))
        assert found.reach[0] < size < found.reach[1]
        assert window.locator("svg.stairs").first.get_attribute("aria-label").count(",") == 1

        press(window, button(window, f"Take {added} back"))
        window.wait_for_selector("text=a branch not taken")
        press(window, button(window, f"{added} at"))
        window.wait_for_selector(f"text=Take {added} back")

        press(window, part(window, "Doubt"))
        press(window, part(window, "Report"))
        press(window, button(window, "Write the report"))
        settled(window, 5)
        window.wait_for_selector("text=Open the report")
        script = server.ask("GET", "session.sh")[2].decode().splitlines()
    assert window.complaints == []
    assert [line.split()[1] for line in script[2:]] == [
        "init", "check", "identify", "compare", "diagnose", "extend", "identify", "compare", "report"
    ]  # fmt: skip
    assert (found.folder / "report.html").is_file()
    assert (found.folder / HOME / "models" / f"1_{added}.mo").is_file()


def move_a_slider(page, machine: Machine) -> None:
    """By the arrow keys; the error and the line that gives it follow, and go back."""
    error = f"td[data-error={machine.output}]"
    slider = page.locator(f"input[data-parameter={machine.parameter}]")
    page.wait_for_selector("#parameters .pictures[data-frames]")
    before = page.inner_text(error)
    press(page, slider, "ArrowRight")
    for _ in range(49):
        page.keyboard.press("ArrowRight")
    differs = "([cell, text]) => (document.querySelector(cell).textContent === text) === {}"
    page.wait_for_function(differs.format("false"), arg=[error, before])
    assert f"--set {machine.parameter}=" in page.inner_text("#simulate-line")
    press(page, button(page, "Back to the fit"))
    page.wait_for_function(differs.format("true"), arg=[error, before])


def errors(folder: Path, step: int) -> dict[str, float]:
    document = json.loads((folder / HOME / "steps" / f"{step}.json").read_text())
    return document["models"][-1]["rms"]
