"""Documents and files of models too large for rows of zeros; what a large filter tells beforehand."""

import json
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.io import loadmat

import daest as package
from daest.cli import filter as filter_command

LADDER = Path(__file__).parents[1] / "systems" / "models" / "Ladder.mo"
SECTIONS = 45


def ladder(folder: Path) -> Path:
    file = folder / "Ladder.mo"
    file.write_text(LADDER.read_text().replace("n = 10", f"n = {SECTIONS}"))
    return file


@pytest.mark.slow
def test_triplets_and_files(daest, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    dae = package.linearize(package.compile_model(ladder(tmp_path)))
    code, out, _ = daest("linearize", "Ladder.mo", "--format", "json")
    document = json.loads(out)
    assert code == 0 and document["matrix_format"] == "triplets" and document["n_equations"] == dae.n > 500
    for name in ("E", "J", "K", "C"):
        entry, matrix = document[name], sp.csr_array(getattr(dae, name))
        rebuilt = sp.csr_array((entry["value"], (entry["row"], entry["column"])), shape=entry["shape"])
        assert abs(rebuilt - matrix).max() == 0.0 and 0.0 not in entry["value"]
    assert len(document["poles"]) == SECTIONS and len(document["transfer_functions"]) == 1

    assert daest("linearize", "Ladder.mo", "-o", "l.npz")[0] == 0
    with np.load("l.npz") as arrays:
        places = (arrays["J_row"], arrays["J_column"])
        rebuilt = sp.csr_array((arrays["J_value"], places), shape=arrays["J_shape"])
    assert abs(rebuilt - dae.J).max() == 0.0
    assert daest("linearize", "Ladder.mo", "-o", "l.mat")[0] == 0
    assert abs(sp.csr_array(loadmat("l.mat")["E"]) - dae.E).max() == 0.0


@pytest.mark.slow  # test_linear_commands.py; large: tests/systems/test_sparse_form.py
def test_noise_document(daest, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    ladder(tmp_path)
    code, out, _ = daest("noise", "Ladder.mo", "--format", "json")
    document = json.loads(out)
    assert (code, document["n_dynamic"], document["index"], document["n_forbidden"]) == (0, SECTIONS, 1, 0)
    assert daest("noise", "Ladder.mo")[0] == 0


def test_a_large_filter_tells_its_cost(capsys):
    filter_command._tell_cost(149, 2000, 1000, "stored")
    assert capsys.readouterr().err == ""
    filter_command._tell_cost(1000, 10000, 1000, "stored")
    told = capsys.readouterr().err
    assert "1000 states and 1000 samples" in told and "GB" in told and "--kind stationary" in told
    assert float(told.split(" and ")[-1].split(" GB")[0]) > 8.0  # a covariance of 8 MB per sample
