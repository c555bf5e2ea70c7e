"""The notebook of the servo example runs from its first to its last cell, and finds the truth."""

import json
import shutil
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

SERVO = Path(__file__).resolve().parents[1] / "examples" / "servo"


@pytest.fixture(scope="module")
def executed(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tutorial") / "servo"
    shutil.copytree(SERVO, folder, ignore=shutil.ignore_patterns("results"))
    notebook = nbformat.read(folder / "tutorial.ipynb", as_version=4)
    NotebookClient(notebook, timeout=120, resources={"metadata": {"path": str(folder)}}).execute()
    return notebook


def outputs(notebook, kind):
    """What cells show in the form `kind`, by the source of the cell."""
    return {
        cell.source: output.data[kind]
        for cell in notebook.cells
        if cell.cell_type == "code"
        for output in cell.outputs
        if kind in output.get("data", {})
    }


def test_it_is_kept_without_outputs():
    notebook = nbformat.read(SERVO / "tutorial.ipynb", as_version=4)
    nbformat.validate(notebook)
    assert not any(cell.outputs for cell in notebook.cells if cell.cell_type == "code")


def test_no_cell_complains(executed):
    streams = [
        o for c in executed.cells if c.cell_type == "code" for o in c.outputs if o.output_type == "stream"
    ]
    assert not streams


def test_values_show_themselves(executed):
    shown = outputs(executed, "text/html")
    tables = [source.splitlines()[-1] for source, html in shown.items() if "<table" in html]
    assert {"dae", "daest.noise_report(dae)", "fit", "comparison"} <= set(tables)
    assert len(outputs(executed, "image/png")) == 2


def test_it_finds_what_it_says(executed):
    shown = outputs(executed, "text/html")
    (fit,) = (html for source, html in shown.items() if source.endswith("\nfit"))
    truth = json.loads((SERVO / "truth.json").read_text())["parameters"]
    for name in ("k", "c", "d", "J2"):
        value = float(fit.partition(f"<td>{name}</td><td>")[2].partition("<")[0])
        assert value == pytest.approx(truth[name], rel=0.01)
    (comparison,) = (html for source, html in shown.items() if source.endswith("\ncomparison"))
    assert "not falsified" in comparison
    (compared,) = (t for s, t in outputs(executed, "text/plain").items() if "estimate.compared" in s)
    assert "omega" in compared and float(compared.partition(": '")[2].partition(" ")[0]) > 95
