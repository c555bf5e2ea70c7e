"""`daest compare`: tests, verdict, growth and places in its document; exit codes; refusals."""

import json

import numpy as np
import pytest
from lag_data import LAG, PERIOD, TRUE, write_csv


@pytest.fixture
def models(folder):
    """Lag.mo with its true parameters, and Slow.mo, whose time constant is wrong."""
    true = LAG.replace("= 0.4", f"= {TRUE['T']}").replace("= 1.0", f"= {TRUE['k']}")
    (folder / "Lag.mo").write_text(true)
    slow = true.replace("Lag", "Slow").replace(f"= {TRUE['T']}", "= 0.8")
    (folder / "Slow.mo").write_text(slow)
    return folder


def document(daest, *arguments):
    code, out, _ = daest("compare", *arguments, "--data", "run2.csv", "--hold", "zoh", "--format", "json")
    return code, json.loads(out)


def test_true_model_passes_and_wrong_one_is_falsified(models, daest):
    code, found = document(daest, "Slow.mo", "Lag.mo")
    slow, true = found["models"]
    assert code == 0 and [slow["verdict"], true["verdict"]] == ["falsified", "not falsified"]
    for model in (slow, true):
        assert set(model["tests"]) >= {"whiteness", "input_independence", "nis"}
        for by_output in model["tests"].values():
            for test in by_output.values():
                assert set(test) >= {"statistic", "limit", "p_value", "pass"}
    assert not slow["tests"]["input_independence"]["y"]["pass"]
    assert true["feedback"]["y"]["pass"]
    assert [row["verdict"] for row in found["table"]] == ["falsified", "not falsified"]
    assert found["table"][0]["rms"]["y"] > 2 * found["table"][1]["rms"]["y"]
    assert any("no process noise" in note for note in true["notes"])


def test_exit_code_follows_the_verdict(models, daest):
    assert document(daest, "Lag.mo", "--fail-if-falsified")[0] == 0
    assert document(daest, "Slow.mo", "--fail-if-falsified")[0] == 1
    assert document(daest, "Slow.mo")[0] == 0
    assert document(daest, "Lag.mo", "Slow.mo", "--fail-if-falsified", "--fail-below", "10")[0] == 1


@pytest.mark.slow
def test_bootstrap_needs_enough_records_and_repeats(models, daest):
    status, _, err = daest("compare", "Lag.mo", "--data", "run2.csv", "--bootstrap", "20")
    assert status == 2 and "99" in err
    first, again = (document(daest, "Lag.mo", "--bootstrap", "99", "--seed", "3")[1] for _ in range(2))
    assert first == again and first["models"][0]["verdict"] == "not falsified"


def test_bootstrap_refuses_an_unknown_noise(models, daest):
    text = (models / "Lag.mo").read_text().replace(" annotation(__Daest(std = 0.02))", "")
    (models / "Lag.mo").write_text(text)
    status, out, err = daest("compare", "Lag.mo", "--data", "run2.csv", "--bootstrap", "99")
    assert status == 2 and not out and "error[compare-bootstrap-noise]" in err and "y" in err


@pytest.mark.slow
def test_unused_column_can_tell_where_the_error_is(models, daest):
    """While a door is open the gain is 1.4 times larger."""
    n = 2000
    rng = np.random.default_rng(7)
    u = np.repeat(rng.normal(size=n // 8 + 1), 8)[:n]
    door = np.repeat(rng.random(n // 50) < 0.25, 50).astype(float)
    y, keep = np.zeros(n), np.exp(-PERIOD / TRUE["T"])
    for i in range(1, n):
        y[i] = keep * y[i - 1] + (1 - keep) * TRUE["k"] * (1 + 0.4 * door[i - 1]) * u[i - 1]
    y += 0.02 * rng.standard_normal(n)
    path = write_csv(models / "run2.csv", PERIOD * np.arange(n), u, y)
    lines = path.read_text().splitlines()
    path.write_text(
        "\n".join([lines[0] + ",door", *(f"{a},{b:g}" for a, b in zip(lines[1:], door, strict=True))])
    )
    _, found = document(daest, "Lag.mo")
    first = found["models"][0]["where"][0]
    assert (first["kind"], first["variable"], first["output"]) == ("region", "door", "y")
    assert first["share_of_error"] > 0.6 > 0.35 > first["expected_share"]
    _, text, _ = daest("compare", "Lag.mo", "--data", "run2.csv", "--hold", "zoh", "--plot", "c.png")
    assert first["text"] in text and "Lag: falsified" in text
    assert (models / "c.png").stat().st_size > 10_000


def test_a_start_of_daest_toml_is_none_of_another_model(models, daest):
    """As those of `daest init` stand beside a model that `daest improve` has written with fitted values."""
    start = "[parameters]\nT = { estimate = true, start = 0.8 }\n"
    (models / "daest.toml").write_text(f'[model]\nsource = "Slow.mo"\n\n{start}')
    assert [one["verdict"] for one in document(daest, "Slow.mo", "Lag.mo")[1]["models"]] == [
        "falsified",
        "not falsified",
    ]
    (models / "daest.toml").write_text(f'[model]\nsource = "Lag.mo"\n\n{start}')
    assert document(daest, "Lag.mo")[1]["models"][0]["verdict"] == "falsified"  # of its own it is


def test_models_without_a_fit_are_driven_as_the_last_fit_was(models, daest):
    """What inputs do between samples is none of the model: one that `daest improve` has written is compared
    with the fitted one on the same terms."""
    assert daest("identify", "Slow.mo", "--data", "run1.csv", "--hold", "zoh", "--fix", "T=0.8")[0] == 0
    code, out, _ = daest("compare", "Lag.mo", "--data", "run2.csv", "--format", "json")
    assert code == 0 and json.loads(out)["table"] == document(daest, "Lag.mo")[1]["table"]
    (models / "results" / "fit.json").unlink()
    (models / "results" / "improve").mkdir()
    (models / "results" / "improve" / "ledger.json").write_text('{"hold": "zoh"}')
    code, out, _ = daest("compare", "Lag.mo", "--data", "run2.csv", "--format", "json")
    assert code == 0 and json.loads(out)["table"] == document(daest, "Lag.mo")[1]["table"]
