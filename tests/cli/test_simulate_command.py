"""`daest simulate` against the closed form of the lag."""

import csv
import json

import numpy as np
import pytest


def table_of(text):
    rows = list(csv.reader(text.splitlines()))
    values = np.array([[float(cell) if cell else np.nan for cell in row] for row in rows[1:]])
    return dict(zip(rows[0], values.T, strict=True))


def step_file(folder, n_samples=20):
    lines = ["time,u", *(f"{0.1 * k:.6g},1" for k in range(n_samples))]
    (folder / "step.csv").write_text("\n".join(lines) + "\n")


def test_step_response(folder, daest):
    step_file(folder)
    code, out, err = daest("simulate", "Lag.mo", "--inputs", "step.csv", "--set", "T=0.5", "--set", "k=2")
    table = table_of(out)
    assert code == 0 and "20 samples" in err
    assert list(table) == ["time [s]", "u [V]", "y [V]"]
    assert table["y [V]"] == pytest.approx(2 * (1 - np.exp(-table["time [s]"] / 0.5)), abs=1e-8)


def test_all_variables_and_json(folder, daest):
    step_file(folder)
    table = table_of(daest("simulate", "Lag.mo", "--inputs", "step.csv", "--all")[1])
    assert table["x [V]"] == pytest.approx(table["y [V]"])
    code, out, _ = daest("simulate", "Lag.mo", "--inputs", "step.csv", "--format", "json")
    document = json.loads(out)
    assert code == 0 and document["schema"] == "daest/simulate/1"
    assert document["trajectories"]["y"] == pytest.approx(table["y [V]"])


def test_noise_is_repeatable(folder, daest):
    step_file(folder, 2000)
    runs = [
        table_of(daest("simulate", "Lag.mo", "--inputs", "step.csv", "--noise", "--seed", seed)[1])["y [V]"]
        for seed in ("3", "3", "4")
    ]
    assert np.array_equal(runs[0], runs[1]) and not np.array_equal(runs[0], runs[2])
    # The annotation says 0.02 V; an estimate from 1800 samples is within 4 of its own standard deviations.
    assert np.std(runs[0][200:] - 1.0) == pytest.approx(0.02, rel=4 / np.sqrt(2 * 1800))


def test_output_file(folder, daest):
    step_file(folder)
    code, out, _ = daest("simulate", "Lag.mo", "--inputs", "step.csv", "-o", "out.csv")
    assert code == 0 and out == ""
    assert list(table_of((folder / "out.csv").read_text())) == ["time [s]", "u [V]", "y [V]"]


@pytest.mark.parametrize(
    ("arguments", "code", "mentions"),
    [
        (["Lag.mo", "--inputs", "none.csv"], "data-missing-file", "none.csv"),
        (["Lag.mo"], "data-not-given", "recording"),
        ([], "model-not-given", "model"),
        (["Lag.modelica", "--inputs", "step.csv"], "model-unknown-format", "Lag.modelica"),
        (["Lag.mo", "--inputs", "step.csv", "--set", "Tau=3"], "parameter-unknown", "Tau"),
        (["Lag.mo", "--inputs", "step.csv", "--set", "T=-3"], "parameter-outside-bounds", "T"),
        (["Lag.mo", "--inputs", "step.csv", "--set", "T"], "option-assignment", "--set"),
        (["Lag.mo", "--inputs", "step.csv", "--from", "9"], "data-window-empty", "1.9"),
        (["Lag.mo", "--inputs", "step.csv", "-p", "no.toml"], "config-missing", "no.toml"),
        (["Lag.mo", "--inputs", "step.csv", "-o", "step.csv"], "output-is-input", "step.csv"),
    ],
)
def test_refusals(folder, daest, arguments, code, mentions):
    step_file(folder)
    before = (folder / "step.csv").read_text()
    status, out, err = daest("simulate", *arguments)
    assert status == 2 and out == ""
    assert f"error[{code}]" in err and mentions in err and "help: " in err
    assert (folder / "step.csv").read_text() == before
