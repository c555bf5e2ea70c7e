"""`import daest`: files or data in memory in, values that print as the command does."""

import shutil
from pathlib import Path

import numpy as np
import pytest

import daest
from daest.cli.main import run
from daest.diagnosis.comparison.trial import fitted_candidate

ROOT = Path(__file__).resolve().parents[1]
LAG = """\
model Lag "First-order lag"
  parameter Real T(unit = "s", min = 0) = 0.4 "Time constant" annotation(__Daest(estimate = true));
  parameter Real k(unit = "1") = 1.0 "Gain";
  input Real u(unit = "V", start = 0) "Drive";
  output Real y(unit = "V") "Response" annotation(__Daest(std = 0.02));
  Real x(unit = "V", start = 0, fixed = true) "State";
equation
  T*der(x) = k*u - x;
  y = x;
end Lag;
"""
TIME_CONSTANT, PERIOD = 0.5, 0.05


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Lag.mo and the recording of a lag with k = 1, solved exactly."""
    folder = tmp_path_factory.mktemp("front")
    (folder / "Lag.mo").write_text(LAG)
    rng = np.random.default_rng(3)
    u = np.repeat(rng.normal(size=50), 8)
    y, keep = np.zeros(u.size), np.exp(-PERIOD / TIME_CONSTANT)
    for i in range(1, u.size):
        y[i] = keep * y[i - 1] + (1 - keep) * u[i - 1]
    table = np.column_stack([PERIOD * np.arange(u.size), u, y + 0.02 * rng.standard_normal(u.size)])
    np.savetxt(folder / "run.csv", table, delimiter=",", header="time,u,y", comments="", fmt="%.10g")
    return folder


@pytest.fixture(scope="module")
def fit(folder):
    return daest.identify(folder / "Lag.mo", folder / "run.csv", hold="zoh")


def arrays(folder):
    table = np.loadtxt(folder / "run.csv", delimiter=",", skiprows=1)
    return dict(zip(("time", "u", "y"), table.T, strict=True))


def test_a_path_a_frame_and_arrays_are_the_same_recording(folder, fit):
    assert abs(fit.theta["T"] - TIME_CONSTANT) < 4 * fit.parameters[0].std_error
    flat = daest.compile_model(folder / "Lag.mo")
    pandas = pytest.importorskip("pandas")
    for data in (arrays(folder), pandas.read_csv(folder / "run.csv"), [folder / "run.csv"]):
        assert daest.identify(flat, data, hold="zoh").theta == fit.theta


def test_results_print_what_the_command_prints(folder, fit, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    shutil.rmtree("results", ignore_errors=True)
    assert run(["identify", "Lag.mo", "run.csv", "--hold", "zoh"]) == 0
    told = capsys.readouterr().out.splitlines()
    printed = str(fit).splitlines()
    # The second line tells how long it took.
    assert [line for i, line in enumerate(printed) if i != 1] == [
        line for i, line in enumerate(told) if i != 1
    ]
    assert run(["noise", "Lag.mo"]) == 0
    assert str(daest.noise("Lag.mo")) == capsys.readouterr().out.rstrip("\n")
    assert run(["compare", "Lag.mo", "run.csv"]) == 0
    told = capsys.readouterr().out
    assert str(daest.compare("Lag.mo", "run.csv", fit)).splitlines()[:5] == told.splitlines()[:5]


def test_a_fit_is_judged_with_the_uncertainty_of_its_estimates(folder, fit):
    """As compare and fleet judge it: without, sound models fail the tests too often."""
    names, covariance = fit.covariance()
    assert np.sqrt(np.diagonal(covariance)) == pytest.approx([p.std_error for p in fit.parameters])
    candidate = fitted_candidate(daest.compile_model(folder / "Lag.mo"), fit)
    assert candidate.parameter_names == names == tuple(p.name for p in fit.parameters)
    assert candidate.n_estimation == fit.n_samples and candidate.n_parameters == len(names)


def test_columns_of_other_names(folder, fit):
    data = arrays(folder)
    other = {"t": data["time"], "volt [mV]": 1e3 * data["u"], "level": data["y"]}
    source = daest.Source(inputs={"u": "volt"}, outputs={"y": "level"}, time="t")
    assert daest.identify(folder / "Lag.mo", other, source=source, hold="zoh").theta["T"] == pytest.approx(
        fit.theta["T"], rel=1e-6
    )
    run = daest.simulate(folder / "Lag.mo", other, source=daest.Source(inputs={"u": "volt"}, time="t"))
    assert run.n_samples == data["time"].size


def test_filter_and_check(folder, fit):
    estimate = daest.filter(folder / "Lag.mo", folder / "run.csv", fit)
    assert "filter, log-likelihood" in str(estimate)
    check = daest.check(arrays(folder))
    assert check.n_samples == 400 and "samples every 0.05 s" in str(check)


def test_diagnose_takes_what_was_taken_before(folder, monkeypatch):
    """Both forms reach the engine with the same values; the second half validates."""
    calls = []
    monkeypatch.setattr("daest.diagnosis.diagnose.diagnose", lambda *given: calls.append(given))
    library = daest.effect_library()
    daest.diagnose(folder / "Lag.mo", folder / "run.csv", places=("u",))
    flat = daest.compile_model(folder / "Lag.mo")
    data = daest.read_experiments([folder / "run.csv"], [daest.Signal("u", "V")], [daest.Signal("y", "V")])
    daest.diagnose(flat, library[:2], data, data, places=("u",))
    (_, all_effects, first, rest, options, _), (_, two, whole, other, _, _) = calls
    assert len(all_effects) == len(library) and tuple(two) == tuple(library[:2])
    assert first[0].n_samples + rest[0].n_samples == whole[0].n_samples == other[0].n_samples
    assert options.places == ("u",)


def test_wrong_words_are_answered(folder):
    with pytest.raises(TypeError, match="no option 'splitt'; did you mean 'split'"):
        daest.identify(folder / "Lag.mo", folder / "run.csv", splitt=0.5)
    with pytest.raises(daest.DaestError, match="one recording, and 2 are given"):
        daest.check([folder / "run.csv", folder / "run.csv"])
    with pytest.raises(daest.DaestError, match="the arrays have the sizes: time 3, u 2"):
        daest.check({"time": [0, 1, 2], "u": [0, 1]})


def test_nothing_private_is_shown():
    assert set(dir(daest)) == {*daest.__all__, "__version__"}
    assert "daest.Source" in daest.identify.__doc__ or "`source`" in daest.identify.__doc__


def test_the_page_runs(tmp_path, monkeypatch, capsys):
    from console_blocks import fenced

    monkeypatch.chdir(tmp_path)
    shutil.copy(ROOT / "examples" / "servo" / "Servo.mo", tmp_path)
    with (ROOT / "examples" / "servo" / "servo.csv").open() as file:
        (tmp_path / "servo.csv").write_text("".join(next(file) for _ in range(601)))
    page = (ROOT / "docs" / "how-to" / "python.md").read_text(encoding="utf-8")
    scope = {}
    for block in fenced(page, "python"):
        exec(compile(block, "python.md", "exec"), scope)
    assert len(scope["speed"]) == 600 and "Parameters" in capsys.readouterr().out
