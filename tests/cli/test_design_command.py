"""`daest design`: the file that is played, what is told of it, and limits that allow nothing."""

import json

import numpy as np
import pytest

SHORT = ("--length", "10", "--seconds", "2")


@pytest.fixture
def fitted(folder, daest):
    code, _, err = daest("identify", "run1.csv", "--model", "Lag.mo")
    assert code == 0, err
    return folder


def played(path):
    rows = np.genfromtxt(path, delimiter=",", skip_header=1)
    return path.read_text().splitlines()[0], rows


def test_an_input_that_can_be_played_and_identified(fitted, daest):
    limits = ("--limit", "u=-1.5,1", "--rate", "u=8")
    code, out, err = daest(
        "design", "run1.csv", "--model", "Lag.mo", *limits, *SHORT, "-o", "input.csv", "--format", "json"
    )
    assert code == 0, err
    found = json.loads(out)
    assert found["aim"] == "parameters"
    assert found["input"] == {
        "columns": ["time [s]", "u [V]"],
        "period": 0.05,
        "length": 10.0,
        "hold": found["input"]["hold"],
        "file": "input.csv",
    }
    header, rows = played(fitted / "input.csv")
    assert header == "time [s],u [V]"
    np.testing.assert_allclose(rows[:, 0], 0.05 * np.arange(201), atol=1e-12)
    assert rows[:, 1].min() >= -1.5 - 1e-8 and rows[:, 1].max() <= 1.0 + 1e-8
    assert np.max(np.abs(np.diff(rows[:, 1]))) <= 8 * 0.05 + 1e-8
    errors = [found[part]["std_errors"] for part in ("present", "predicted", "together")]
    assert all(set(part) == {"T", "k"} for part in errors)
    assert all(errors[2][name] < min(errors[0][name], errors[1][name]) for name in ("T", "k"))
    assert {f["name"] for f in found["families"]} >= {"free", "steps", "multisine", "chirp", "random binary"}
    assert (fitted / "results" / "design.json").is_file()
    # The file goes through the other commands as a recording of inputs.
    code, out, err = daest("simulate", "Lag.mo", "--inputs", "input.csv", "-o", "-")
    assert code == 0, err
    assert len(out.splitlines()) == 202


def test_a_fit_on_smooth_curves_is_designed_for_on_straight_lines(folder, daest):
    assert daest("identify", "run1.csv", "--model", "Lag.mo", "--hold", "smooth")[0] == 0
    assert json.loads((folder / "results" / "fit.json").read_text())["hold"] == "smooth"
    code, out, err = daest("design", "run1.csv", "--model", "Lag.mo", *SHORT, "--format", "json")
    assert code == 0, err
    assert json.loads(out)["input"]["hold"] == "foh"


def test_predicted_errors_are_those_of_the_fit_along_the_recording(fitted, daest):
    """The present recording is the one that was fitted: its errors are known from there."""
    code, out, _ = daest("design", "run1.csv", "--model", "Lag.mo", *SHORT, "--format", "json")
    present = json.loads(out)["present"]["std_errors"]
    fit = json.loads((fitted / "results" / "fit.json").read_text())["parameters"]
    assert code == 0
    for name, error in present.items():
        assert error == pytest.approx(fit[name]["std_error"], rel=0.02)


def test_text_and_picture(fitted, daest):
    code, out, err = daest(
        "design", "run1.csv", "--model", "Lag.mo", "--parameters", "T", *SHORT, "--limit", "y=-2,2",
        "--plot", "design.png",
    )  # fmt: skip
    assert code == 0, err
    for words in ("Play ", "Inputs that were compared", "Expected standard errors", "Safe ranges"):
        assert words in out
    assert (fitted / "design.png").stat().st_size > 5000


REFUSED = [
    (("--limit", "u=2,2"), "design-limit"),
    (("--limit", "u=3"), "option-assignment"),
    (("--limit", "v=0,1"), "design-limit-unknown"),
    (("--rate", "u=-1"), "design-limit"),
    (("--band", "30,40"), "design-limit"),
    (("--length", "0.1"), "design-too-short"),
    (("--rivals",), "design-no-rivals"),
    (("--rivals", "--parameters", "T"), "design-one-aim"),
    (("--parameters", "tau"), "unknown-parameter"),
    (("--limit", "y=5,6"), "design-unsafe"),
]


def test_what_is_refused(folder, daest):
    """Each with one message, and no file."""
    for arguments, code in REFUSED:
        status, out, err = daest("design", "run1.csv", "--model", "Lag.mo", *arguments, "-o", "input.csv")
        assert (status, out) == (2, ""), arguments
        assert f"error[{code}]" in err and "help:" in err, err
        assert not (folder / "input.csv").exists()
    status, _, err = daest("design", "--model", "Lag.mo", "--limit", "u=-1,1")
    assert status == 2 and "error[design-limits-unknown]" in err
    status, _, err = daest("design", "--model", "Lag.mo", "--length", "5", "--period", "0.05")
    assert status == 2 and "error[design-limit]" in err


def test_without_a_recording(folder, daest):
    own = ("--limit", "u=-1,1", "--length", "5", "--period", "0.05", "--seconds", "1")
    code, out, err = daest("design", "--model", "Lag.mo", *own, "--format", "json")
    assert code == 0, err
    found = json.loads(out)
    assert found["present"] is None and found["predicted"]["std_errors"]["k"] > 0.0


UNSTABLE = """\
model Fall "Unstable, and one without an input"
  parameter Real a(unit = "1/s") = 4 annotation(__Daest(estimate = true));
  input Real u(start = 0);
  output Real y annotation(__Daest(std = 0.1));
  Real x(start = 0, fixed = true);
equation
  der(x) = a*x + u;
  y = x;
end Fall;
"""


HOLD = """\
model Hold
  input Real y;
  input Real r(unit = "m");
  output Real u = 8*(r - y);
end Hold;
"""


def test_models_that_no_experiment_suits(folder, daest):
    (folder / "Fall.mo").write_text(UNSTABLE)
    own = ("--length", "10", "--period", "0.05", "--seconds", "1")
    status, _, err = daest("design", "--model", "Fall.mo", "--limit", "u=-1,1", *own)
    assert status == 2 and "error[design-unstable]" in err and "--controller" in err
    (folder / "Hold.mo").write_text(HOLD)
    (folder / "fall.csv").write_text(
        "time,u,y\n" + "".join(f"{0.05 * k},{k % 3 - 1},0\n" for k in range(200))
    )
    loop = ("--controller", "Hold.mo", "--limit", "r=-1,1", "-o", "input.csv")
    status, out, err = daest("design", "fall.csv", "--model", "Fall.mo", *loop, *own)
    assert status == 0 and "no column 'r'" in err, err
    assert played(folder / "input.csv")[0] == "time [s],r [m]"
    assert "u          -1 to 1" in out  # what was recorded is what the machine can play
    alone = UNSTABLE.replace("Fall", "Alone").replace("  input Real u(start = 0);\n", "").replace("+ u", "")
    (folder / "Alone.mo").write_text(alone)
    status, _, err = daest("design", "--model", "Alone.mo", *own)
    assert status == 2 and "error[design-no-input]" in err
