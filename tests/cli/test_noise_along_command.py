"""`daest noise --along`: verdicts at the points of a recording."""

import json

import numpy as np
import pytest

OPENING = """model Opening "While x is zero the noise reaches nothing; later it is differentiated"
  input Real u(start = 0);
  input Real w annotation(__Daest(noise = true, intensity = 1));
  Real x(start = 0, fixed = true);
  Real z(start = 1, fixed = true);
  Real v, p, q;
  output Real y = x annotation(__Daest(std = 0.1));
equation
  der(x) = u - x;
  der(z) = -z;
  v = z + w;
  p = x^2*v + x;
  q = der(p);
end Opening;
"""


@pytest.fixture
def opening(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "Opening.mo").write_text(OPENING, encoding="utf-8")
    time = np.linspace(0.0, 5.0, 101)
    table = np.column_stack([time, np.where(time < 1.0, 0.0, 1.0)])
    np.savetxt(tmp_path / "run.csv", table, delimiter=",", header="time,u", comments="")
    return tmp_path


def test_noise_that_is_admissible_at_the_start_alone_is_1(opening, daest):
    assert daest("noise", "Opening.mo")[0] == 0
    code, out, _ = daest("noise", "Opening.mo", "--along", "run.csv")
    assert code == 1
    assert "Along the trajectory" in out and "25 points" in out
    _, out, _ = daest("noise", "Opening.mo", "--along", "run.csv", "--at", "z", "--format", "json")
    along = json.loads(out)["along"]
    (w,) = along["annotated"]
    assert w["name"] == "w" and w["admissible_at_start"] and not w["admissible"]
    assert 0.5 < w["forbidden_share"] < 1.0 and 1.0 < w["first_time"] < 1.5
    assert w["differentiated"] == ["q"]
    assert len(along["asked"]) >= 1 and not along["all_admissible"]


def test_affine_model_holds_everywhere(opening, daest):
    (opening / "Lag.mo").write_text(
        "model Lag input Real u(start = 0); output Real y(start = 0, fixed = true) "
        "annotation(__Daest(std = 0.1)); equation der(y) = u - y; end Lag;",
        encoding="utf-8",
    )
    code, out, _ = daest("noise", "Lag.mo", "--along", "run.csv")
    assert code == 0 and "affine: the verdicts hold everywhere" in out


def test_a_recording_without_the_input_is_refused(opening, daest):
    (opening / "other.csv").write_text("time,voltage\n0,1\n1,1\n", encoding="utf-8")
    code, _, err = daest("noise", "Opening.mo", "--along", "other.csv")
    assert code == 2 and "error[data-unknown-column]" in err
