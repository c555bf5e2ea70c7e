"""The notebook of the servo example runs from its first to its last cell, and finds the truth."""

import json
import shutil
from dataclasses import dataclass
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

SERVO = Path(__file__).resolve().parents[1] / "examples" / "servo"


@dataclass
class Shown:
    """What a cell shows: the last value as text and as HTML, its figures, and what it prints."""

    source: str
    text: str
    html: str
    n_figures: int
    printed: str


@pytest.fixture(scope="module")
def copied(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tutorial") / "servo"
    shutil.copytree(SERVO, folder, ignore=shutil.ignore_patterns("results"))
    return folder


@pytest.fixture(scope="module")
def shown(copied):
    """The cells one after the other in a shell of this process."""
    import matplotlib.pyplot as plt
    from IPython.core.interactiveshell import InteractiveShell
    from IPython.utils.capture import capture_output

    notebook = nbformat.read(copied / "tutorial.ipynb", as_version=4)
    shell, cells = InteractiveShell(), []
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(copied)
        for cell in notebook.cells:
            if cell.cell_type != "code":
                continue
            plt.close("all")
            with capture_output() as captured:
                result = shell.run_cell(cell.source)
            result.raise_error()
            data, _ = shell.display_formatter.format(result.result)
            text, html = data.get("text/plain", ""), data.get("text/html", "")
            printed = captured.stderr if result.result is not None else captured.stdout + captured.stderr
            cells.append(Shown(cell.source, text, html, len(plt.get_fignums()), printed))
    plt.close("all")
    return cells


def test_it_is_kept_without_outputs():
    notebook = nbformat.read(SERVO / "tutorial.ipynb", as_version=4)
    nbformat.validate(notebook)
    assert not any(cell.outputs for cell in notebook.cells if cell.cell_type == "code")


@pytest.mark.slow
def test_it_runs_in_a_kernel(copied):
    notebook = nbformat.read(copied / "tutorial.ipynb", as_version=4)
    NotebookClient(notebook, timeout=120, resources={"metadata": {"path": str(copied)}}).execute()
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    assert not [output for output in outputs if output.output_type == "stream"]
    assert len([output for output in outputs if "image/png" in output.get("data", {})]) == 2


@pytest.mark.slow
def test_no_cell_complains(shown):
    assert [cell.printed for cell in shown if cell.printed] == []


@pytest.mark.slow
def test_values_show_themselves(shown):
    tables = {cell.source.splitlines()[-1] for cell in shown if "<table" in cell.html}
    assert {"dae", "daest.noise_report(dae)", "fit", "comparison"} <= tables
    assert sum(cell.n_figures for cell in shown) == 2


@pytest.mark.slow
def test_it_finds_what_it_says(shown):
    (fit,) = (cell.html for cell in shown if cell.source.endswith("\nfit"))
    truth = json.loads((SERVO / "truth.json").read_text())["parameters"]
    for name in ("k", "c", "d", "J2"):
        value = float(fit.partition(f"<td>{name}</td><td>")[2].partition("<")[0])
        assert value == pytest.approx(truth[name], rel=0.01)
    (comparison,) = (cell.html for cell in shown if cell.source.endswith("\ncomparison"))
    assert "not falsified" in comparison
    (compared,) = (cell.text for cell in shown if "estimate.compared" in cell.source)
    assert "omega" in compared and float(compared.partition(": '")[2].partition(" ")[0]) > 95
