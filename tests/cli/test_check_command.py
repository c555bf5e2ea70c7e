"""`daest check`, and the warnings of commands that read recordings."""

import json

import numpy as np
import pytest
from lag_data import recording, write_csv


def test_a_good_recording(folder, daest):
    code, out, _ = daest("check", "run1.csv", "run2.csv", "--model", "Lag.mo", "--format", "json")
    document = json.loads(out)
    assert code == 0 and document["schema"] == "daest/check/1" and document["n_warnings"] == 0
    first = document["recordings"][0]
    assert [c["role"] for c in first["columns"]] == ["input", "output"]
    assert first["period"] == 0.05 and first["findings"] == []
    code, out, _ = daest("check", "run1.csv")
    assert code == 0 and "400 samples every 0.05 s" in out and "nothing found" in out


def test_wrong_polarity_is_told_by_the_model(folder, daest):
    time, u, y = recording(400, 1)
    write_csv(folder / "bad.csv", time, u, -y)
    assert daest("check", "bad.csv")[0] == 0
    code, out, _ = daest("check", "bad.csv", "--model", "Lag.mo")
    assert code == 1 and "check-polarity" in out and "y moves against the model" in out
    _, _, err = daest("identify", "Lag.mo", "bad.csv")
    assert "warning[check-polarity]: bad: y moves against the model" in err


def test_a_sensor_that_loses_the_sign_is_told_by_the_model(folder, daest):
    time, u, y = recording(400, 1)
    for name, values, told in (
        ("lost", np.abs(y), 1),
        ("raised", y - y.min(), 0),
        ("cut", np.maximum(y, 0.0), 0),
    ):
        write_csv(folder / f"{name}.csv", time, u, values)
        code, out, _ = daest("check", f"{name}.csv", "--model", "Lag.mo")
        assert ("check-sign-lost" in out) == told, (name, out)
        assert code == told or not told


DECAY = """model Decay
  parameter Real T(unit = "s") = 20 annotation(__Daest(estimate = true));
  output Real y(unit = "1") annotation(__Daest(std = 0.01));
  Real x(unit = "1", start = 1);
equation
  T*der(x) = -LAW;
  y = x;
end Decay;
"""


@pytest.mark.parametrize(("law", "code"), [("x", 0), ("2*sqrt(x)", 1)])  # a carriage and a tank
def test_what_starts_the_other_way_has_no_wrong_polarity(folder, daest, law, code):
    (folder / "Decay.mo").write_text(DECAY.replace("LAW", law))
    time = np.arange(60) * 0.05
    noise = 1e-3 * np.random.default_rng(3).standard_normal(60)
    rows = np.column_stack([time, -np.exp(-time / 2.0) + noise])
    np.savetxt(folder / "back.csv", rows, delimiter=",", header="time [s],y", comments="")
    found, out, _ = daest("check", "back.csv", "--model", "Decay.mo")
    assert found == code and ("check-polarity" in out) == (code == 1), out


@pytest.mark.parametrize(
    ("factor", "told"),
    [
        (180.0 / np.pi, "times as large as in the model"),
        (1e-3, "times as small as in the model"),
        (0.1, None),  # a gain that starts far off
        (6.0, None),
    ],
)
def test_another_unit_is_told_by_the_model(folder, daest, factor, told):
    time, u, y = recording(400, 1)
    write_csv(folder / "bad.csv", time, u, factor * y)
    code, out, _ = daest("check", "bad.csv", "--model", "Lag.mo")
    assert (code == 1 and "check-scale" in out and told in out) if told else code == 0


TURNING = """model Turning
  input Real u(unit = "V");
  output Real n(unit = "1");
  parameter Real k(unit = "1/(V.s)") = 100 annotation(__Daest(estimate = true));
equation
  der(n) = k*u;
end Turning;
"""


@pytest.mark.parametrize(
    ("header", "told"), [("Timestamp", "check-time-unit"), ("Timestamp [s]", "check-scale")]
)
def test_in_a_doubtful_unit_of_time_no_scale_is_told(folder, daest, header, told):
    """The pulses of an encoder, with the milliseconds of an Arduino: read as seconds they seem few."""
    (folder / "Turning.mo").write_text(TURNING)
    time = np.arange(300) * 20
    u = np.where(time // 500 % 2, -1.0, 1.0)
    n = 100.0 * np.concatenate([[0.0], np.cumsum(u[:-1])]) * 0.02
    write_csv(folder / "turning.csv", time, u, n)
    text = (folder / "turning.csv").read_text().partition("\n")[2]
    (folder / "turning.csv").write_text(f"{header},u,n\n{text}")
    daest("init", "Turning.mo", "turning.csv")
    _, out, _ = daest("check")
    assert {code for code in ("check-time-unit", "check-scale") if code in out} == {told}


@pytest.mark.parametrize(
    ("decay", "duty", "told"),
    [
        (0.0, np.abs, True),
        (0.0, lambda u: -np.abs(u), True),
        (0.0, np.positive, False),
        (1.0, np.abs, False),  # what drains comes back by itself
        (0.0, lambda u: np.maximum(u, 0.0), False),  # and so does what drains in the machine alone
    ],
)
def test_a_duty_that_was_recorded_without_its_sign_is_told_by_the_model(folder, daest, decay, duty, told):
    (folder / "Turning.mo").write_text(TURNING.replace("k*u", f"k*u - {decay}*n"))
    time = np.arange(300) * 0.02
    u = np.where(np.arange(300) // 50 % 2, -1.0, 1.0) * (np.arange(300) % 50 > 10)
    n = np.concatenate([[0.0], np.cumsum(u[:-1])]) * 2.0
    write_csv(folder / "turning.csv", time, duty(u), n, "time,u,n")
    _, out, _ = daest("check", "turning.csv", "--model", "Turning.mo")
    assert ("check-sign-lost" in out) is told, out
    assert not told or "without its sign" in " ".join(out.split())


def test_what_identify_would_refuse_is_a_finding(folder, daest):
    text = (folder / "run1.csv").read_text()
    (folder / "bad.csv").write_text(text.replace("time,u,y", "time,u [A],y").replace("\n0.15,", "\n0.1,", 1))
    code, out, _ = daest("check", "bad.csv", "--model", "Lag.mo", "--format", "json")
    found = {f["code"]: f for f in json.loads(out)["recordings"][0]["findings"]}
    assert code == 1 and set(found) == {"check-unusable", "check-clock-duplicate", "check-clock-gap"}
    assert found["check-unusable"]["text"].startswith("the recording cannot be used")
    assert found["check-unusable"]["text"].endswith(
        "; correct the unit in the column header, or the unit in the model"
    )
    assert found["check-clock-duplicate"]["time"] == 0.1


def test_every_missing_column_is_a_finding(folder, daest):
    columns = 'inputs = { u = "drive" }\noutputs = { y = "answer" }'
    (folder / "daest.toml").write_text(f'[model]\nsource = "Lag.mo"\n[data]\n{columns}\n')
    code, out, _ = daest("check", "run1.csv", "--format", "json")
    texts = [f["text"] for f in json.loads(out)["recordings"][0]["findings"]]
    assert code == 1 and [t.split("'")[1] for t in texts] == ["drive", "answer"]
    assert all("map it in daest.toml" in t and "\n" not in t for t in texts)


def test_identify_warns_and_goes_on(folder, daest):
    time, u, y = recording(400, 1)
    y[[100, 250]] += 40.0
    write_csv(folder / "bad.csv", time, u, y)
    code, out, err = daest("identify", "bad.csv", "--model", "Lag.mo", "--format", "json")
    assert code == 0 and json.loads(out)["schema"] == "daest/identify/1"
    assert "warning[check-outliers]: bad: y has 2 outlier(s)" in err
    _, _, err = daest("compare", "Lag.mo", "--data", "bad.csv")
    assert "warning[check-outliers]" in err
    # The look is at the recording as it is: resampling would hide the outliers.
    _, _, err = daest("compare", "Lag.mo", "--data", "bad.csv", "--resample", "0.1")
    assert "warning[check-outliers]" in err


def test_no_recording_and_no_time(folder, daest):
    code, _, err = daest("check")
    assert code == 2 and "data-not-given" in err
    write_csv(folder / "bad.csv", np.arange(3.0), np.arange(3.0), np.arange(3.0), "a,u,y")
    code, _, err = daest("check", "bad.csv")
    assert code == 2 and "data-no-time" in err


def test_rows_of_one_time_are_one_finding(folder, daest):
    text = (folder / "run1.csv").read_text()
    (folder / "bad.csv").write_text(text.replace("\n0.15,", "\n0.1,", 1).replace("\n0.2,", "\n0.1,", 1))
    code, out, _ = daest("check", "bad.csv", "--model", "Lag.mo", "--format", "json")
    found = [f for f in json.loads(out)["recordings"][0]["findings"] if f["code"] == "check-unusable"]
    assert code == 1 and len(found) == 1 and "stands still at 0.1;" in found[0]["text"]


def test_samples_that_estimate_and_validate_are_told(folder, daest):
    time, u, y = recording(400, 1)
    write_csv(folder / "whole.csv", time, u, y)
    write_csv(folder / "part.csv", time[:300], u[:300], y[:300])
    recordings = 'estimate = ["whole.csv"]\nvalidate = ["run2.csv", "part.csv"]'
    (folder / "daest.toml").write_text(f'[model]\nsource = "Lag.mo"\n[data]\n{recordings}\n')
    code, out, _ = daest("check", "--format", "json")
    found = {one["name"]: [f["code"] for f in one["findings"]] for one in json.loads(out)["recordings"]}
    assert code == 1 and found == {"whole": [], "run2": [], "part": ["check-repeated"]}


def test_a_model_that_cannot_be_used_is_refused(folder, daest):
    (folder / "Free.mo").write_text("""model Free
  input Real u;
  output Real y = x;
  Real x(start = 0), z;
equation
  der(x) = u - x + z;
  z = z + 0*x;
end Free;
""")
    code, out, err = daest("check", "run1.csv", "--model", "Free.mo")
    assert code == 2 and out == "" and "structurally-singular" in err and "Free.mo:7:3" in err


def test_a_result_is_no_picture(folder, daest):
    code, _, err = daest("check", "run1.csv", "-o", "found.png")
    assert code == 2 and "plot-format" in err and "--plot" in err and not (folder / "found.png").exists()


def test_without_a_model_the_time_is_what_its_dates_its_name_or_its_unit_tell(folder, daest):
    rows = range(20)
    for header, value, is_told in (
        ("Zeitstempel", lambda i: f"21.11.2026 08:{i:02d}:00", True),
        ("t [min]", lambda i: f"{i}", True),
        ("Dauer (min)", lambda i: f"{i}", True),
        ("level", lambda i: f"{60 * i}", False),
    ):
        lines = [f"{header},u,T", *(f"{value(i)},{i % 3},{20 + 5 * i % 7 + i}" for i in rows)]
        (folder / "log.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
        code, out, err = daest("check", "log.csv")
        assert (code == 0 and "20 samples every 60 s" in out) == is_told, (header, out, err)
        assert ("data-no-time" in err) != is_told
