"""What each input does between samples, in commands and in daest.toml."""

import json

import numpy as np
import pytest

ROOM = """model Room
  parameter Real T(unit = "s", min = 0) = 3000 annotation(__Daest(estimate = true));
  parameter Real R(unit = "K/W", min = 0) = 0.002 annotation(__Daest(estimate = true));
  input Real P(unit = "W") "heating";
  input Real To(unit = "K") "outside";
  output Real y(unit = "K");
  Real x(unit = "K", start = 290, fixed = true);
equation
  T*der(x) = R*P + To - x;
  y = x;
end Room;
"""
TRUE = {"T": 4000.0, "R": 0.003}


@pytest.fixture
def room(tmp_path, monkeypatch):
    """A project whose recording follows from the closed form: P is held, To runs straight."""
    monkeypatch.chdir(tmp_path)
    rng, n, step = np.random.default_rng(2), 400, 600.0
    time, keep = step * np.arange(n), np.exp(-step / TRUE["T"])
    P, To = np.repeat(rng.choice([0.0, 3000.0], n // 2), 2), 280 + np.cumsum(rng.normal(size=n))
    ramp = 1 - (1 - keep) * TRUE["T"] / step
    x = np.full(n, 290.0)
    for k in range(n - 1):
        held = (1 - keep) * (TRUE["R"] * P[k] + To[k])
        x[k + 1] = keep * x[k] + held + ramp * (To[k + 1] - To[k])
    y = x + 0.02 * rng.normal(size=n)
    rows = "\n".join(",".join(f"{value:.9g}" for value in row) for row in zip(time, P, To, y, strict=True))
    (tmp_path / "run.csv").write_text(f"time [s],P [W],To [K],y [K]\n{rows}\n")
    (tmp_path / "Room.mo").write_text(ROOM)
    (tmp_path / "daest.toml").write_text('[model]\nsource = "Room.mo"\n[data]\nestimate = ["run.csv"]\n')
    return tmp_path


def test_identify_finds_the_hold_and_later_commands_take_it(room, daest):
    code, out, err = daest("identify", "--format", "json")
    assert code == 0, err
    fit = json.loads(out)
    assert fit["hold"] == "zoh(P)"
    for name, truth in TRUE.items():
        assert abs(fit["parameters"][name]["value"] - truth) < 4 * fit["parameters"][name]["std_error"]
    assert "hold zoh(P)" in daest("identify")[1]
    assert "hold zoh(P)" in daest("simulate", "run.csv", "-o", "simulated.csv")[2]
    assert "hold foh" in daest("simulate", "run.csv", "--hold", "foh", "-o", "simulated.csv")[2]
    assert daest("filter", "run.csv", "-o", "estimates.csv")[0] == 0


def test_the_project_says_it(room, daest):
    file = room / "daest.toml"
    file.write_text(file.read_text() + 'hold = "zoh(To)"\n')
    assert json.loads(daest("identify", "--format", "json")[1])["hold"] == "zoh(To)"
    assert json.loads(daest("identify", "--hold", "zoh(P, To)", "--format", "json")[1])["hold"] == "zoh"


@pytest.mark.parametrize("command", ["identify", "compare", "diagnose"])
@pytest.mark.parametrize(("hold", "told"), [("zoh(p)", "did you mean P?"), ("held", "zoh(NAME, ...)")])
def test_what_is_no_hold_is_refused(room, daest, command, hold, told):
    code, out, err = daest(command, "--hold", hold)
    assert (code, out) == (2, "")
    assert told in err
    assert "--hold" in err


def test_a_wrong_name_in_the_project_is_refused(room, daest):
    file = room / "daest.toml"
    file.write_text(file.read_text() + 'hold = "zoh(heating)"\n')
    code, _, err = daest("simulate", "run.csv", "-o", "simulated.csv")
    assert code == 2
    assert "error[option-hold]" in err
    assert "[data] hold in daest.toml" in err
