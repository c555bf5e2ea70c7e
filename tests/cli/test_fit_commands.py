"""`daest identify`, `compare` and `filter` on the lag: true parameters, files found again, refusals."""

import csv
import json

import numpy as np
import pytest
from lag_data import LAG, NOISE, PROJECT, TRUE, recording, write_csv


@pytest.fixture
def fitted(folder, daest):
    """The folder after an identification; its data are held between samples."""
    (folder / "daest.toml").write_text(PROJECT)
    assert daest("identify", "--hold", "zoh")[0] == 0
    return folder


def test_identify_finds_the_truth(folder, daest):
    code, out, _ = daest("identify", "run1.csv", "--model", "Lag.mo", "--hold", "zoh", "--format", "json")
    document = json.loads(out)
    assert code == 0 and document["schema"] == "daest/identify/1" and document["status"] == "converged"
    for name, true in TRUE.items():
        found = document["parameters"][name]
        assert abs(found["value"] - true) < 4 * found["std_error"]
        assert found["std_error"] < 0.01 * true
    assert document["noise"]["measurement"]["y"]["std"] == pytest.approx(NOISE, rel=4 / np.sqrt(800))
    assert json.loads((folder / "results" / "fit.json").read_text())["parameters"] == document["parameters"]


def test_project_supplies_everything_and_text_says_it(fitted, daest):
    code, out, err = daest("identify", "--hold", "zoh", "--plot", "fit.png")
    assert code == 0 and "results/fit.json" in err
    for words in ("Parameters", "std error", "validation", "estimation", "hold zoh"):
        assert words in out
    assert "\x1b" not in out
    assert (fitted / "fit.png").read_bytes().startswith(b"\x89PNG")


def test_fix_and_estimate(folder, daest):
    options = ("--model", "Lag.mo", "--hold", "zoh", "--format", "json")
    fixed = json.loads(daest("identify", "run1.csv", "--fix", "k=2", *options)[1])
    assert list(fixed["parameters"]) == ["T"] and fixed["theta"]["k"] == 2.0
    only = json.loads(daest("identify", "run1.csv", "--estimate", "k", *options)[1])
    assert list(only["parameters"]) == ["k"]


def test_prior_of_the_project_and_of_the_command(folder, daest):
    project = PROJECT + "[parameters]\nT = { prior = { mean = 0.1, std = 1e-6 } }\n"
    (folder / "daest.toml").write_text(project)
    document = json.loads(daest("identify", "--hold", "zoh", "--format", "json")[1])
    assert document["parameters"]["T"]["prior"] == {"mean": 0.1, "std": 1e-6}
    assert document["parameters"]["T"]["value"] == pytest.approx(0.1, rel=1e-4)
    assert document["parameters"]["k"]["prior"] is None
    code, out, _ = daest("identify", "--hold", "zoh", "--prior", "T=0.2,1e-6")
    assert code == 0 and "prior 0.2 ± 1e-06" in out


@pytest.mark.parametrize(
    ("given", "code"),
    [
        ("T", "option-assignment"),
        ("T=0.1", "option-assignment"),
        ("T=0.1,nan", "option-assignment"),
        ("=0.1,0.1", "option-assignment"),
        ("T=0.1,0", "prior-std"),
        ("nothing=0.1,1", "unknown-parameter"),
    ],
)
def test_bad_prior(folder, daest, given, code):
    exit_code, out, err = daest("identify", "run1.csv", "--model", "Lag.mo", "--prior", given)
    assert exit_code == 2 and f"error[{code}]" in err and not out


def test_profile_in_text_json_and_picture(fitted, daest):
    code, out, err = daest("identify", "--hold", "zoh", "--profile", "T", "--profile-plot", "profile.png")
    assert code == 0 and "Profile likelihood" in out and "95 %" in out
    assert "profile of T (1 of 1)" in err
    assert (fitted / "profile.png").read_bytes().startswith(b"\x89PNG")
    document = json.loads(daest("identify", "--hold", "zoh", "--profile", "all", "--format", "json")[1])
    assert set(document["profiles"]) == set(TRUE)
    for name, profile in document["profiles"].items():
        found = document["parameters"][name]
        assert profile["lower"] < found["value"] < profile["upper"]
        width = profile["upper"] - profile["lower"]
        assert width == pytest.approx(2 * 1.96 * found["std_error"], rel=0.1)


def test_profile_of_an_unknown_name(fitted, daest):
    code, out, err = daest("identify", "--profile", "nothing")
    assert code == 2 and "error[profile-not-estimated]" in err and not out


def test_split_takes_the_place_of_validation_files(fitted, daest):
    document = json.loads(daest("identify", "--split", "0.5", "--hold", "zoh", "--format", "json")[1])
    assert document["n_samples"] == 200
    assert document["fit_percent"]["validation"]["y"] > 95


def test_compare_uses_the_fit_and_refuses_below(fitted, daest):
    code, out, _ = daest("compare", "Lag.mo", "--data", "run2.csv", "--format", "json", "--plot", "c.svg")
    document = json.loads(out)
    assert code == 0 and document["schema"] == "daest/compare/1"
    model = document["models"][0]
    # All that is left is the measurement noise.
    y = recording(300, 2)[2]
    assert model["rms"]["y"] == pytest.approx(NOISE, rel=0.2)
    assert model["fit_percent"]["y"] == pytest.approx(100 * (1 - NOISE / np.std(y)), abs=1.0)
    assert model["n_parameters"] == 2 and document["table"][0]["rms"] == model["rms"]
    assert "<svg" in (fitted / "c.svg").read_text()
    assert daest("compare", "Lag.mo", "--data", "run2.csv", "--fail-below", "90")[0] == 0
    assert daest("compare", "Lag.mo", "--data", "run2.csv", "--fail-below", "99.9")[0] == 1


def test_compare_two_models_each_with_its_own_fit(fitted, daest):
    (fitted / "Gain.mo").write_text(
        LAG.replace("Lag", "Gain").replace("T*der(x) = k*u - x", "0.001*T*der(x) = k*u - x")
    )
    code, out, _ = daest("compare", "Gain.mo", "Lag.mo", "--data", "run2.csv", "--format", "json")
    gain, lag = json.loads(out)["models"]
    assert code == 0 and (gain["name"], lag["name"]) == ("Gain", "Lag")
    assert gain["n_parameters"] == 0 and any("no fit found" in text for text in gain["notes"])
    assert lag["fit_percent"]["y"] > gain["fit_percent"]["y"]
    _, text, _ = daest("compare", "Gain.mo", "Lag.mo", "--data", "run2.csv")
    assert "Gain" in text and "Lag" in text and "simulation fit %" in text


def test_refit_estimates_every_model(fitted, daest):
    (fitted / "results" / "fit.json").unlink()
    (fitted / "results" / "fits" / "Lag.json").unlink()
    before = json.loads(daest("compare", "Lag.mo", "--data", "run2.csv", "--format", "json")[1])
    after = json.loads(
        daest("compare", "Lag.mo", "--data", "run2.csv", "--refit", "--hold", "zoh", "--format", "json")[1]
    )
    assert before["models"][0]["n_parameters"] == 0 and after["models"][0]["n_parameters"] == 2
    assert after["models"][0]["fit_percent"]["y"] > before["models"][0]["fit_percent"]["y"]


def test_filter_writes_estimates_with_std(fitted, daest):
    code, out, err = daest("filter", "run2.csv", "--format", "json")
    document = json.loads(out)
    assert code == 0 and document["schema"] == "daest/filter/1" and "estimates.csv" in err
    rows = list(csv.DictReader((fitted / "results" / "estimates.csv").open()))
    assert len(rows) == 300 and list(rows[0])[:3] == ["time", "x", "x.std"]
    code, out, _ = daest("filter", "run2.csv", "--only", "x", "--smooth", "-o", "-")
    assert code == 0 and out.splitlines()[0] == "time,x,x.std" and len(out.splitlines()) == 301


def test_filter_needs_the_size_of_every_noise(folder, daest):
    (folder / "Lag.mo").write_text(LAG.replace(" annotation(__Daest(std = 0.02))", ""))
    status, _, err = daest("filter", "run1.csv", "--model", "Lag.mo")
    assert status == 2 and "error[filter-noise-unknown]" in err and "[noise.measurement]" in err
    assert not (folder / "results").exists()


def test_filter_runs_over_one_recording(folder, daest):
    (folder / "daest.toml").write_text(
        PROJECT.replace('validate = ["run2.csv"]', 'validate = ["run1.csv", "run2.csv"]')
    )
    status, _, err = daest("filter")
    assert status == 2 and "error[filter-one-recording]" in err and "run1, run2" in err
    assert "daest filter run2.csv" in err


def test_filter_takes_the_whole_of_a_window(fitted, daest):
    """Of a split recording, the part that identification has not seen; a window as it is asked for."""
    text = PROJECT.replace('validate = ["run2.csv"]', "split = 0.5")
    (fitted / "daest.toml").write_text(text)
    for options, first, last in (((), "10", "19.95"), (("--from", "5", "--to", "12"), "5", "12")):
        assert daest("filter", *options)[0] == 0
        rows = list(csv.DictReader((fitted / "results" / "estimates.csv").open()))
        assert (rows[0]["time"], rows[-1]["time"]) == (first, last)


def test_an_output_that_no_recording_holds_is_told_once(folder, daest):
    two = LAG.replace(
        "  Real x(", '  output Real z(unit = "V") "Not measured" annotation(__Daest(std = 0.02));\n  Real x('
    )
    (folder / "Lag.mo").write_text(two.replace("  y = x;", "  y = x;\n  z = 2*x;"))
    status, _, err = daest("compare", "Lag.mo", "run1.csv")
    assert status == 0 and "not in the data, and not used: z" in err and "no value" not in err


def test_models_without_common_outputs_are_not_compared(folder, daest):
    (folder / "Other.mo").write_text(LAG.replace("Lag", "Other").replace(" y", " z"))
    status, _, err = daest("compare", "Lag.mo", "Other.mo", "--data", "run1.csv")
    assert status == 2 and "error[compare-missing-output]" in err and "Other.mo" in err


def test_filter_figure_and_text(fitted, daest):
    code, out, _ = daest("filter", "--plot", "f.pdf")
    assert code == 0 and "normalised innovations squared" in out
    assert (fitted / "f.pdf").read_bytes().startswith(b"%PDF")


REFUSALS = [
    (["identify"], "model-not-given", "[model] source"),
    (["identify", "--model", "Lag.mo"], "data-not-given", "[data] estimate"),
    (["identify", "none.csv", "--model", "Lag.mo"], "data-missing-file", "run1.csv"),
    (["identify", "run1.csv", "--model", "Lag.mo", "--fix", "k"], "option-assignment", "--fix"),
    (["identify", "run1.csv", "--model", "Lag.mo", "--fix", "kk=1"], "unknown-parameter", "k"),
    (["identify", "run1.csv", "--model", "Lag.mo", "--split", "2"], "option-split", "between 0 and 1"),
    (["identify", "run1.csv", "--model", "Lag.mo", "--resample", "0.01"], "option-resample", "shorter"),
    (["identify", "run1.csv", "--model", "Lag.mo", "--class", "Lig"], "model-unknown-class", "Lag"),
    (["identify", "short.csv", "--model", "Lag.mo"], "identify-too-few-samples", "unknowns"),
    (["identify", "still.csv", "--model", "Lag.mo"], "identify-constant-input", "constant"),
    (["compare", "Lag.mo"], "data-not-given", "recording"),
    (["filter", "run1.csv", "--model", "Lag.mo", "--measure", "z"], "filter-unknown-output", "z"),
    (["filter", "run1.csv", "--model", "Lag.mo", "--only", "z"], "filter-unknown-variable", "z"),
]


@pytest.mark.parametrize(("arguments", "code", "mentions"), REFUSALS, ids=[r[1] for r in REFUSALS])
def test_refusals(folder, daest, arguments, code, mentions):
    time, u, y = recording(4, 3)
    write_csv(folder / "short.csv", time, u, y)
    time, u, y = recording(100, 3)
    write_csv(folder / "still.csv", time, np.ones_like(u), y)
    before = sorted(path.name for path in folder.iterdir())
    status, out, err = daest(*arguments)
    assert status == 2 and out == ""
    assert f"error[{code}]" in err and mentions in err and "help: " in err
    assert sorted(path.name for path in folder.iterdir()) == before


def test_model_problem_is_told_with_file_and_line(folder, daest):
    (folder / "Lag.mo").write_text(LAG.replace("y = x;", "y = = x;"))
    status, _, err = daest("identify", "run1.csv", "--model", "Lag.mo")
    assert status == 2 and "Lag.mo:9" in err


def test_damaged_result_is_named(fitted, daest):
    (fitted / "results" / "fit.json").write_text("{")
    status, _, err = daest("filter", "run2.csv")
    assert status == 2 and "error[results-unreadable]" in err and "fit.json" in err


def test_project_errors_are_collected(folder, daest):
    more = "[parameters]\nTT = { value = 1 }\nT = { start = -1 }\n[noise.measurement]\nz = { std = 1 }\n"
    (folder / "daest.toml").write_text(PROJECT + more)
    status, _, err = daest("identify")
    assert status == 2
    codes = ("config-unknown-parameter", "parameter-outside-bounds", "output-unknown")
    for words in (*codes, "did you mean T?"):
        assert words in err


def test_names_and_units_are_mapped(folder, daest):
    time, u, y = recording(400, 1)
    write_csv(folder / "log.csv", 1000 * time, 1000 * u, y, "time [ms],volt [mV],out")
    (folder / "daest.toml").write_text(
        '[model]\nsource = "Lag.mo"\n[data]\nestimate = ["log.csv"]\n'
        'inputs = { u = "volt" }\noutputs = { x = "out" }\nhold = "zoh"\n'
    )
    code, out, err = daest("identify", "--format", "json")
    document = json.loads(out)
    assert code == 0 and "converted to V" in err
    assert list(document["rms"]["estimation"]) == ["x"] and document["hold"] == "zoh"
    assert document["parameters"]["T"]["value"] == pytest.approx(TRUE["T"], rel=0.02)


@pytest.mark.slow
def test_bootstrap_in_text_and_json(fitted, daest):
    code, out, err = daest("identify", "--hold", "zoh", "--bootstrap", "39", "--jobs", "1")
    assert code == 0 and "Bootstrap: 39 refits of simulated recordings" in out
    assert "refits of simulated recordings (39 of 39)" in err
    arguments = ("identify", "--hold", "zoh", "--bootstrap", "39", "--jobs", "2", "--format", "json")
    document = json.loads(daest(*arguments)[1])
    assert document["bootstrap"]["n"] == 39 and document["bootstrap"]["n_failed"] == 0
    for name, found in document["parameters"].items():
        interval = document["bootstrap"]["parameters"][name]
        assert interval["lower"] < found["value"] < interval["upper"]
        assert interval["std"] == pytest.approx(found["std_error"], rel=0.5)


@pytest.mark.slow  # test_diagnose_command.py
def test_cluster_that_is_not_there(fitted, daest, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("daest.numerics.parallel.CONNECT_SECONDS", 0.5)
    code, out, err = daest("identify", "--hold", "zoh", "--cluster", "tcp://127.0.0.1:9")
    assert code == 2 and not out and err.startswith("error[cluster-unreachable]")
    assert "--> tcp://127.0.0.1:9" in err and "dask scheduler" in err


def test_resampled_recordings_keep_what_is_known_of_their_inputs(folder, daest):
    def fit(*options):
        return json.loads(daest("identify", "run1.csv", "--model", "Lag.mo", "--format", "json", *options)[1])

    held = fit("--hold", "zoh")
    own = fit("--hold", "zoh", "--resample", "0.05")
    assert own["hold"] == "zoh" and own["log_likelihood"] == held["log_likelihood"]
    for name, true in TRUE.items():
        coarse = fit("--hold", "zoh", "--resample", "0.1")["parameters"][name]
        assert abs(coarse["value"] - true) < 4 * coarse["std_error"]
        assert coarse["std_error"] < 2 * held["parameters"][name]["std_error"]
    assert (
        "straight lines; --hold zoh"
        in daest("identify", "run1.csv", "--model", "Lag.mo", "--resample", "0.1")[2]
    )
