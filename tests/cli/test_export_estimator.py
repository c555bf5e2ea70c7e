"""`daest export --estimator`: files, the fit that they come from, refusals."""

import json

import pytest
from lag_data import PROJECT
from test_follow import NOISY


@pytest.fixture
def noisy(folder):
    (folder / "Noisy.mo").write_text(NOISY)
    return folder


def test_c_and_fmu_of_a_model(noisy, daest):
    run = ("export", "Noisy.mo", "--estimator", "--step", "0.05", "--only", "x")
    code, out, err = daest(*run, "--c", "code", "--float", "--format", "json")
    assert code == 0, err
    document = json.loads(out)
    assert document["estimates"] == ["x"] and document["fmi_version"] is None
    files = {path.name for path in (noisy / "code").iterdir()}
    code_files = {"estimator.c", "estimator.h", "estimator_model.c", "estimator_sizes.h", "main.c"}
    assert files == {*code_files, "README.md"}
    assert "0.05 s" in (noisy / "code" / "README.md").read_text()
    assert "ESTIMATOR_FLOAT" in (noisy / "code" / "estimator_sizes.h").read_text()
    code, out, err = daest(*run, "--kind", "stationary", "-o", "e.fmu", "--fmi", "2.0")
    assert code == 0 and "FMI 2.0" in out and "validator: no message" in out
    assert (noisy / "e.fmu").is_file()


def test_the_fit_tells_period_and_values(folder, daest):
    (folder / "daest.toml").write_text(PROJECT)
    assert daest("identify", "--hold", "zoh", "--format", "json")[0] == 0
    fit = json.loads((folder / "results" / "fit.json").read_text())
    code, _, err = daest("export", "--estimator", "--c", "code")
    assert code == 0 and "results/fit.json" in err
    text = (folder / "code" / "estimator_model.c").read_text()
    assert repr(fit["parameters"]["T"]["value"]) in text
    assert f"e->period = (est_real){fit['period']!r}" in text
    assert "#define EST_FOH 0" in (folder / "code" / "estimator_sizes.h").read_text()


@pytest.mark.parametrize(
    ("options", "code"),
    [
        (("--estimator",), "estimator-option"),
        (("--step", "0.1"), "estimator-option"),
        (("--estimator", "--step", "0.1", "--float"), "estimator-option"),
        (("--estimator", "--step", "0.1", "--only", "z"), "filter-unknown-variable"),
        (("--estimator", "--step", "0.1", "-o", "e.txt"), "export-suffix"),
    ],
)
def test_refusals(noisy, daest, options, code):
    before = sorted(noisy.iterdir())
    ended, _, err = daest("export", "Noisy.mo", *options)
    assert ended == 2 and f"error[{code}]" in err
    assert sorted(noisy.iterdir()) == before
