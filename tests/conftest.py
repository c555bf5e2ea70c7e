"""Fixtures that several rooms share."""

import contextlib
import gc
import os
import shutil
import signal
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from daest.cache import cache_folder

# As the commands do: small matrices, and two test processes beside each other.
for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
# Objects made between two looks of the garbage collector: with 700, reading all sources of the package takes
# three times as long.
gc.set_threshold(20_000, 20, 20)
# A shell that starts the tests in the background lets them ignore Ctrl-C, `nohup` the end of the terminal,
# and all that they start with them.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) == signal.SIG_IGN:
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
# Tests of processes ask for them; in the others they would only have to start.
os.environ["DAEST_JOBS"] = "1"
# Hundreds of small models run for milliseconds: compiling them takes longer.
os.environ.setdefault("DAEST_COMPILER_EFFORT", "Og")

# The tests start some hundred processes. Where Python may not leave compiled modules beside their sources,
# each of them, and each worker of xdist, would compile all anew: it finds them in the cache instead.
if os.environ.pop("PYTHONDONTWRITEBYTECODE", None):
    os.environ["PYTHONPYCACHEPREFIX"] = sys.pycache_prefix = str(cache_folder() / "bytecode")
    sys.dont_write_bytecode = False
    with contextlib.suppress(OSError):
        os.makedirs(sys.pycache_prefix, exist_ok=True)
# What the first worker leaves in that folder once it has compiled all; the others wait for it so long [s].
COMPILED, MOST_WAITED = "tests-are-compiled", 120.0


# `pytest -m quick`: rooms and files whose tests take milliseconds, for the minute between two edits.
QUICK = (
    "cli/test_check_command",
    "cli/test_connected_units",
    "cli/test_export_command",
    "cli/test_frame",
    "cli/test_linear_commands",
    "cli/test_progress",
    "cli/test_recordings",
    "cli/test_simulate_command",
    "data",
    "diagnosis/test_disturbance",
    "diagnosis/test_loads",
    "diagnosis/test_verdict",
    "effects/test_learned_loads",
    "effects/test_sites",
    "estimation/test_arx",
    "estimation/test_ekf",
    "estimation/test_filter",
    "estimation/test_fitted",
    "estimation/test_jumps",
    "estimation/test_kalman",
    "estimation/test_large_filter",
    "estimation/test_likelihood",
    "estimation/test_nonlinear_bad_input",
    "estimation/test_observer",
    "estimation/test_search",
    "estimation/test_smoother",
    "estimation/test_trajectories",
    "estimation/test_ukf",
    "fmu/test_export",
    "fmu/test_load",
    "fmu/test_platforms",
    "fmu/test_serialization",
    "fmu/test_units",
    "library",
    "modelica",
    "numerics",
    "report/test_check_text",
    "report/test_documents_linear",
    "report/test_schema",
    "report/test_texts_and_figures",
    "systems",
    "test_errors",
    "test_house",
    "test_public_names",
    "test_quantities",
)
NOT_QUICK = (
    "data/test_check",
    "data/test_fuzz",
    "modelica/test_apart",
    "modelica/test_clocks",
    "modelica/test_complex",
    "modelica/test_delays",
    "modelica/test_excerpt",
    "modelica/test_fuzz",
    "modelica/test_messages",
    "modelica/test_roots",
    "numerics/test_compiler",
    "numerics/test_distributions",
    "numerics/test_parallel",
    "systems/test_dae_test_set",
    "systems/test_exact_structure",
    "systems/test_hybrid",
    "systems/test_input_slopes",
    "systems/test_integrate",
    "systems/test_noise_along",
    "systems/test_sensor_laws",
    "systems/test_sparse_form",
)


@cache
def is_quick(file: Path) -> bool:
    name = file.relative_to(Path(__file__).resolve().parent).with_suffix("").as_posix()
    return (name in QUICK or name.partition("/")[0] in QUICK) and name not in NOT_QUICK


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """`-m quick` does not even import the other files."""
    is_other = collection_path.name.startswith("test_") and not is_quick(collection_path)
    return True if config.option.markexpr == "quick" and is_other else None


def pytest_collection(session: pytest.Session) -> None:
    """Where nothing is compiled yet, the first worker of xdist does it: 12 s of the processor for each of the
    others otherwise."""
    worker = getattr(session.config, "workerinput", {}).get("workerid", "gw0")
    if worker == "gw0" or not sys.pycache_prefix or not os.access(sys.pycache_prefix, os.W_OK):
        return
    end = time.monotonic() + MOST_WAITED
    while not Path(sys.pycache_prefix, COMPILED).exists() and time.monotonic() < end:
        time.sleep(0.1)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the quick tests: those of quick files that are not slow."""
    for item in items:
        if is_quick(item.path) and item.get_closest_marker("slow") is None:
            item.add_marker(pytest.mark.quick)


def pytest_collection_finish() -> None:
    """What is there now stays until the end: the garbage collector need not look at it again."""
    if sys.pycache_prefix:
        with contextlib.suppress(OSError):
            Path(sys.pycache_prefix, COMPILED).touch()
    gc.collect()
    gc.freeze()


def pytest_unconfigure() -> None:
    gc.unfreeze()  # else modules of native code complain at the end that they are still there


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
    complaints: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)

    @property
    def loaded_from_outside(self) -> list[str]:
        return [url for url in self.requests if not url.startswith(("file:", "data:"))]

    def fits(self) -> bool:
        """Whether the content becomes as wide as the window, and nothing stands out: a page that follows the
        window moves for a moment."""
        is_as_wide = "document.documentElement.scrollWidth === window.innerWidth"
        return bool(self.page.wait_for_function(is_as_wide, timeout=5_000).json_value())

    def screens(self) -> Iterator[tuple[int, str]]:
        """Show what is loaded on a screen and on a telephone, light and dark: (width [px], scheme)."""
        for width in (1280, 390):
            self.page.set_viewport_size({"width": width, "height": 800})
            for scheme in ("light", "dark"):
                self.page.emulate_media(color_scheme=scheme)
                yield width, scheme


@pytest.fixture
def watched(browser):
    context = browser.new_context(offline=True)
    found = WatchedPage(context.new_page())
    is_complaint = ("error", "warning")
    found.page.on("console", lambda m: found.complaints.append(m.text) if m.type in is_complaint else None)
    found.page.on("pageerror", lambda e: found.complaints.append(str(e)))
    found.page.on("request", lambda r: found.requests.append(r.url))
    yield found
    context.close()


@pytest.fixture(autouse=True, scope="session")
def compiler_by_copy() -> Iterator[None]:
    """The compiler works in a copy of the test process, although other tests have left threads of native code
    behind: they never ran the compiler, and a new process for each compilation takes five times as long."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("daest.modelica.compiling.apart._may_copy", lambda: sys.platform == "linux")
        yield
