"""`daest filter --follow`: samples from stdin or from a growing file, one estimate each, restarts, bad
lines."""

import csv
import io
import json
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from lag_data import PROJECT, recording, write_csv

NOISY = """\
model Noisy "Lag with a disturbance"
  parameter Real T(unit = "s", min = 0) = 0.5;
  input Real u(unit = "V", start = 0);
  input Real w annotation(__Daest(noise = true, intensity = 0.01));
  output Real y(unit = "V") annotation(__Daest(std = 0.02));
  Real x(unit = "V", start = 0, fixed = true);
equation
  T*der(x) = 2*u - x + w;
  y = x;
end Noisy;
"""


@pytest.fixture
def noisy(folder):
    (folder / "Noisy.mo").write_text(NOISY)
    return folder


@pytest.fixture
def follow(daest, monkeypatch):
    """Run `daest filter --follow --model Noisy.mo` on a text as stdin."""

    def call(text, *arguments):
        monkeypatch.setattr("sys.stdin", io.StringIO(text))
        return daest("filter", "--follow", "--model", "Noisy.mo", *arguments)

    return call


def table(text):
    rows = list(csv.DictReader(io.StringIO(text)))
    return {name: np.array([float(row[name] or "nan") for row in rows]) for name in rows[0]}


def with_gaps(path):
    """run1.csv with every tenth output missing and twenty rows cut out."""
    lines = path.read_text().splitlines()
    kept = lines[:100] + lines[120:]
    return (
        "\n".join(line.rsplit(",", 1)[0] + "," if i % 10 == 5 else line for i, line in enumerate(kept)) + "\n"
    )


def test_a_stream_is_filtered_as_its_recording(noisy, daest, follow):
    text = with_gaps(noisy / "run1.csv")
    (noisy / "gaps.csv").write_text(text)
    assert daest("filter", "gaps.csv", "--model", "Noisy.mo", "-o", "known.csv")[0] == 0
    code, out, err = follow(text)
    assert code == 0, err
    found, known = table(out), table((noisy / "known.csv").read_text())
    assert found["x"].size == 380
    for name in ("time", "x", "x.std"):
        np.testing.assert_allclose(found[name], known[name], rtol=2e-8, atol=1e-9)
    assert "380 samples; latency" in err


def test_json_lines_restart_where_they_were(noisy, follow):
    lines = (noisy / "run1.csv").read_text().splitlines()
    whole = table(follow("\n".join(lines) + "\n")[1])
    objects = [dict(zip(("time", "u", "y"), map(float, line.split(",")), strict=True)) for line in lines[1:]]
    as_json = [json.dumps(o) + "\n" for o in objects]
    options = ("--state", "memory.npz", "--step", "0.05", "--format", "json", "--only", "x")
    found = []
    for part in (as_json[:150], as_json[140:]):
        code, out, err = follow("".join(part), *options)
        assert code == 0, err
        found += [json.loads(line) for line in out.splitlines()]
    assert "going on after 7.45 s" in err and "10 were done before" in err
    assert [f["time"] for f in found] == pytest.approx(list(whole["time"]))
    values = [f["estimates"]["x"]["value"] for f in found]
    np.testing.assert_allclose(values, whole["x"], rtol=1e-10)
    assert list(found[0]["estimates"]) == ["x"] and found[-1]["nis"] > 0
    code, _, err = follow("".join(as_json), "--state", "memory.npz", "--step", "0.05", "--kind", "stationary")
    assert code == 2 and "error[stream-state]" in err


def test_lines_that_are_no_samples_are_told_and_left_out(noisy, follow):
    lines = (noisy / "run1.csv").read_text().splitlines()
    clean = table(follow("\n".join(lines[:40] + lines[44:60]) + "\n")[1])
    bad = [*lines[:40], "2,x,1", "2,1", lines[39], "2,,1", *lines[44:60], "3," + 2_000_000 * "9"]
    code, out, err = follow("\n".join(bad) + "\n")
    assert code == 0
    assert err.count("warning[stream-line]") == 5 and "5 lines were no samples" in err
    assert "stdin:41: this line is no sample: u is 'x'" in err
    found = table(out)
    np.testing.assert_array_equal(found["x"], clean["x"])


@pytest.mark.parametrize(
    ("text", "options", "code"),
    [
        ("", (), "stream-empty"),
        ("time,u,y\n", (), "stream-empty"),
        ("time,u\n0,1\n", (), "data-no-output"),
        ("time,y\n0,1\n", (), "data-unknown-column"),
        ("u,y\n0,1\n", (), "data-no-time"),
        ("time,u [m],y\n0,1,1\n", (), "unit-incompatible"),
        ('{"time": 0, "u": 1\n', (), "stream-line"),
        ("time,u,y\n0,1,1\n1,1,1\n", ("--only", "z"), "filter-unknown-variable"),
        ("time,u,y\n0,1,1\n1,1,1\n", ("--measure", "z"), "filter-unknown-output"),
        ("time,u,y\n0,1,1\n1,1,1\n", ("--smooth",), "stream-option"),
        ("time,u,y\n0,1,1\n1,1,1\n", ("--kind", "particle"), "stream-option"),
    ],
)
def test_refusals(noisy, follow, text, options, code):
    ended, out, err = follow(text, *options)
    assert ended == 2 and f"error[{code}]" in err
    assert out == "" or code == "filter-unknown-variable"


def test_options_of_streams_need_one(noisy, daest):
    code, _, err = daest("filter", "run1.csv", "--model", "Noisy.mo", "--step", "0.1")
    assert code == 2 and "error[stream-option]" in err


def test_units_and_separators(noisy, follow):
    lines = (noisy / "run1.csv").read_text().splitlines()[:50]
    plain = table(follow("\n".join(lines) + "\n")[1])
    rows = [[float(cell) for cell in line.split(",")] for line in lines[1:]]
    other = "time [ms];u [mV];y\n" + "".join(
        f"{1e3 * t:.10g};{1e3 * u:.12g};{y:.12g}\n".replace(".", ",") for t, u, y in rows
    )
    found = table(follow(other)[1])
    np.testing.assert_allclose(found["x"], plain["x"], rtol=1e-9, atol=1e-9)


def test_a_file_that_grows(noisy):
    """In a process of its own: a writer appends rows in pieces, the estimates come before the next ones."""
    lines = (noisy / "run1.csv").read_text().splitlines(keepends=True)[:120]
    path = noisy / "growing.csv"
    path.write_text("".join(lines[:3]))
    command = [sys.executable, "-m", "daest", "filter", "growing.csv", "--follow", "--model", "Noisy.mo"]
    with subprocess.Popen(
        [*command, "--idle", "2"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=noisy
    ) as process:
        seen = [process.stdout.readline() for _ in range(3)]  # header, two samples

        def write():
            with path.open("a") as file:
                for line in lines[3:]:
                    file.write(line[:4])
                    file.flush()
                    time.sleep(0.001)
                    file.write(line[4:])
                    file.flush()

        writer = threading.Thread(target=write)
        writer.start()
        rest = process.stdout.read()
        writer.join()
        assert process.wait() == 0, process.stderr.read()
    assert len(seen + rest.splitlines()) == 120
    assert table("".join(seen) + rest)["x"].size == 119


@pytest.mark.slow
def test_memory_stays_bounded(noisy):
    """50 000 samples more do not take more memory: one number kept of each would be 1600 kB."""
    script = (
        "import io, resource, sys\nfrom daest.cli.main import run\n"
        "def lines(n):\n"
        "    yield 'time,u,y\\n'\n"
        "    for k in range(n): yield f'{0.05 * k:.10g},{k % 7},{k % 3}\\n'\n"
        "class Stdin(io.StringIO):\n"
        "    def __iter__(self): return lines(int(sys.argv[1]))\n"
        "sys.stdin = Stdin(); sys.stdout = open('/dev/null', 'w')\n"
        "code = run(['filter', '--follow', '--model', 'Noisy.mo'])\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, file=sys.stderr)\n"
        "raise SystemExit(code)\n"
    )
    peaks = []
    for n in (5_000, 55_000):
        done = subprocess.run(
            [sys.executable, "-c", script, str(n)], cwd=noisy, stderr=subprocess.PIPE, text=True, check=True
        )
        peaks.append(int(done.stderr.split()[-1]))
    assert peaks[1] - peaks[0] < 1_000  # kB


def test_the_lag_of_the_project(folder, daest, monkeypatch):
    """A fit by output error has no process noise; daest.toml names the model."""
    (folder / "daest.toml").write_text(PROJECT)
    assert daest("identify", "--hold", "zoh")[0] == 0
    write_csv(folder / "new.csv", *recording(100, 7))
    assert daest("filter", "new.csv", "-o", "known.csv")[0] == 0
    monkeypatch.setattr("sys.stdin", io.StringIO((folder / "new.csv").read_text()))
    code, out, err = daest("filter", "--follow")
    assert code == 0 and "results/fit.json" in err
    known = table((folder / "known.csv").read_text())
    np.testing.assert_allclose(table(out)["x"], known["x"], rtol=1e-7, atol=1e-8)
