"""Pictures of the live page for the documentation: the story on examples/servo_hidden in Chromium.

    python benchmarks/app_pictures.py                       # all of them, some minutes
    python benchmarks/app_pictures.py --only start report   # without the search

It needs playwright and an installed Chromium, and prints the machine and the time from each click to what it
shows.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from daest.data.examples import copy_example
from daest.machine import described

TARGET = Path(__file__).resolve().parents[1] / "docs" / "how-to"
SIZE = {"width": 1100, "height": 760}  # px
LONG = 1_200_000  # ms that a search may take on a busy machine
SETTLE = 1500  # ms until a plot stands still


FRAMES = 150  # pictures of the simulation that follows a slider
DRAG = """async ([wanted, longest]) => {
  const pictures = document.querySelector("#parameters .pictures"), slider = document.querySelector("input[data-parameter]");
  let painted = 0, last = pictures.dataset.frames, moves = 0, ended = false;
  const look = () => { if (pictures.dataset.frames !== last) { last = pictures.dataset.frames; painted += 1; } if (!ended) requestAnimationFrame(look); };
  requestAnimationFrame(look);
  const began = performance.now();
  await new Promise(done => {
    const timer = setInterval(() => {
      slider.value = 500 + Math.round(250 * Math.sin(0.15 * moves++));
      slider.dispatchEvent(new Event("input", {bubbles: true}));
      if (painted >= wanted || performance.now() - began > longest) { clearInterval(timer); ended = true; done(); }
    }, 16);
  });
  return {painted, seconds: (performance.now() - began) / 1000};
}"""  # noqa: E501


class Story:
    """The clicks on a page of `folder`, each with its picture in TARGET."""

    def __init__(self, page: object, address: str, folder: Path) -> None:
        self.page, self.address, self.folder = page, address, folder

    def at(self, part: str) -> None:
        self.page.goto("about:blank")
        self.page.goto(f"{self.address}#{part}")
        self.page.wait_for_selector("html[data-ready=true]")

    def click(self, part: str, name: str, seen: str) -> None:
        """Click a button and wait until its job has ended and its result is seen."""
        self.at(part)
        began = time.perf_counter()
        self.page.get_by_role("button", name=name).first.click()
        self.page.wait_for_selector("#work .job.running")
        self.page.wait_for_selector("#work .job:not(.running)", timeout=LONG)
        self.page.wait_for_selector(seen, timeout=LONG)
        print(f"{name}: {time.perf_counter() - began:.1f} s from the click to what it shows", flush=True)

    def shoot(self, name: str) -> None:
        self.page.wait_for_timeout(SETTLE)
        self.page.screenshot(path=str(TARGET / f"app-{name}.png"))

    def start(self) -> None:
        self.click("start", "Check", "#start .pictures[data-drawn]:not([data-drawn='0'])")
        self.page.locator("#start h3").first.scroll_into_view_if_needed()
        self.page.evaluate("document.querySelector('#start .pictures').scrollIntoView({block: 'end'})")
        self.shoot("start")

    def compare(self) -> None:
        self.click("compare", "Fit and compare", "#compare .pictures[data-drawn]:not([data-drawn='0'])")
        self.shoot("compare")

    def parameters(self) -> None:
        self.at("parameters")
        self.page.wait_for_selector("#parameters .pictures[data-frames]")
        self.page.wait_for_timeout(SETTLE)
        self.follow()
        self.shoot("parameters")

    def follow(self) -> None:
        """Move a slider to and fro, sixty times a second, and count what is painted meanwhile."""
        found = self.page.evaluate(DRAG, [FRAMES, LONG])
        rate = found["painted"] / found["seconds"]
        print(
            f"slider: {found['painted']} pictures in {found['seconds']:.1f} s, {rate:.1f} a second",
            flush=True,
        )
        self.page.get_by_role("button", name="Back to the fit").click()

    def candidate(self) -> None:
        self.click("missing", "Search for what is missing", ".candidate")
        found = self.page.locator(".candidate").first
        found.locator("summary").click()
        found.get_by_role("button", name="Add it").wait_for()
        self.page.wait_for_selector(".candidate .pictures[data-drawn]", timeout=LONG)
        found.evaluate("e => e.scrollIntoView()")
        self.shoot("candidate")

    def missing(self) -> None:
        self.at("missing")
        self.page.locator(".candidate").first.locator("summary").click()
        began = time.perf_counter()
        self.page.get_by_role("button", name="Add it").first.click()
        self.page.wait_for_selector("#work .job.running")
        self.page.wait_for_selector("#work .job:not(.running)", timeout=LONG)
        print(f"Add it: {time.perf_counter() - began:.1f} s from the click to the fitted model", flush=True)
        self.shoot("missing")

    def report(self) -> None:
        self.click("report", "Write the report", "text=Open the report")
        self.page.goto((self.folder / "report.html").as_uri())
        self.shoot("report")


PICTURES: dict[str, Callable[[Story], None]] = {
    "start": Story.start,
    "compare": Story.compare,
    "parameters": Story.parameters,
    "candidate": Story.candidate,
    "missing": Story.missing,
    "report": Story.report,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=PICTURES, default=list(PICTURES))
    chosen = parser.parse_args().only
    from playwright.sync_api import sync_playwright

    print(described())
    with tempfile.TemporaryDirectory() as work, sync_playwright() as playwright:
        folder = Path(work) / "servo_hidden"
        copy_example("servo_hidden", folder)
        command = [sys.executable, "-m", "daest", "app", str(folder), "--no-browser"]
        server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        found = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
        browser = playwright.chromium.launch(executable_path=found, args=["--no-sandbox"])
        try:
            assert server.stdout is not None
            page = browser.new_page(viewport=SIZE)
            story = Story(page, server.stdout.readline().strip(), folder)
            for name in chosen:
                PICTURES[name](story)
        finally:
            browser.close()
            server.terminate()
            server.wait()


if __name__ == "__main__":
    main()
