"""`daest fleet`: a broken file stops nothing, a second run does nothing again, the tables say the same."""

import json

import numpy as np
import pytest
from lag_data import PERIOD, write_csv
from pyarrow import parquet

from daest.cli.fleet import machine_files
from daest.diagnosis import fleet as engine
from daest.diagnosis.fleet import summary
from daest.model.fleet import Machine


def machine_record(T, k, seed, n=300, curve=0.0):
    """The lag with its own T and k; `curve`: a hardening that the model does not know."""
    rng = np.random.default_rng(seed)
    time = PERIOD * np.arange(n)
    u = np.repeat(rng.normal(size=n // 8 + 1), 8)[:n]
    x, fine = np.zeros(n), 50
    for i in range(1, n):
        value = x[i - 1]
        for _ in range(fine):
            value += PERIOD / fine / T * (k * u[i - 1] - value - curve * value**3)
        x[i] = value
    return time, u, x + 0.02 * rng.standard_normal(n)


@pytest.fixture(scope="module")
def records():
    rng = np.random.default_rng(0)
    values = [(0.5 * np.exp(0.1 * rng.standard_normal()), 2.0) for _ in range(3)]
    whole = {f"m{i}": machine_record(T, k, i) for i, (T, k) in enumerate(values)}
    return {**whole, "bent": machine_record(0.5, 2.0, 7, curve=1.0)}, values


@pytest.fixture
def machines(folder, records):
    """A folder of recordings; one is no recording, one lacks the input."""
    place = folder / "machines"
    place.mkdir()
    for name, record in records[0].items():
        write_csv(place / f"{name}.csv", *record)
    (place / "broken.csv").write_text("\0\1\2")
    (place / "lame.csv").write_text("time,y\n0,1\n1,2\n2,1\n")
    return folder


RUN = ("fleet", "machines", "--model", "Lag.mo", "--hold", "zoh", "--no-diagnose", "--jobs", "1")


def test_a_fleet(machines, records, daest):
    code, out, err = daest(*RUN, "--format", "json", "--html", "fleet.html")
    assert code == 0, err
    document = json.loads(out)
    found = {machine["name"]: machine for machine in document["machines"]}
    assert list(found) == ["bent", "broken", "lame", "m0", "m1", "m2"] and document["n_failed"] == 2
    assert "data-" in found["broken"]["message"] and "data-unknown-column" in found["lame"]["message"]
    for i, (T, k) in enumerate(records[1]):
        machine = found[f"m{i}"]
        assert machine["verdict"] == "not falsified" and machine["status"] == "converged"
        for name, true in (("T", T), ("k", k)):
            estimate = machine["parameters"][name]
            assert abs(estimate["value"] - true) < 4 * estimate["std_error"]
    assert found["bent"]["verdict"] == "falsified"
    spread = document["spread"]["T"]
    estimates = [found[f"m{i}"]["parameters"]["T"]["value"] for i in range(3)]
    assert spread["mean"] == pytest.approx(np.mean(estimates)) and spread["n"] == 3
    assert spread["std"] == pytest.approx(np.std(estimates, ddof=1))
    assert spread["mean_std_error"] < spread["std"]
    page = (machines / "fleet.html").read_text()
    assert '<th scope="row">m1</th>' in page and "src=" not in page


def test_what_is_done_is_not_done_again(machines, daest, monkeypatch):
    assert daest(*RUN)[0] == 0
    kept = machines / "results" / "fleet.jsonl"
    lines = kept.read_text().splitlines()
    assert len(lines) == 4
    kept.write_text("\n".join([*lines[:3], lines[3][:40]]))  # killed while it wrote
    examined = []
    plain = engine.examine
    monkeypatch.setattr(engine, "examine", lambda task: examined.append(task[0].name) or plain(task))
    code, out, err = daest(*RUN, "-o", "fleet.parquet")
    assert code == 0 and "3 of 6 machines were done before" in err
    assert len(examined) == 3 and {"broken", "lame"} < set(examined)
    assert "6 machines with Lag" in out and "2 failed" in out
    table = parquet.read_table(machines / "fleet.parquet").to_pydict()
    assert table["name"] == ["bent", "broken", "lame", "m0", "m1", "m2"]
    assert table["T"][3] > 0 and table["T.std_error"][3] > 0 and table["T"][1] is None
    assert table["verdict"][0] == "falsified"
    (machines / "machines" / "m0.csv").write_text((machines / "machines" / "m1.csv").read_text())
    examined.clear()
    assert daest(*RUN)[0] == 0 and "m0" not in examined  # its content is known under another name


def test_what_decides_the_answer_makes_it_anew(machines, daest, monkeypatch):
    """Another option, another column, another start of a state; not another line of the model."""
    examined = []

    def quick(task):
        examined.append(task[0].name)
        return Machine(task[0].name, "converged")

    monkeypatch.setattr(engine, "examine", quick)
    model = machines / "Lag.mo"
    text = model.read_text()

    def is_anew(*options):
        examined.clear()
        code, _, err = daest("fleet", "machines/m0.csv", "--model", "Lag.mo", "--jobs", "1", *options)
        assert code == 0, err
        return bool(examined)

    assert is_anew() and not is_anew()
    assert is_anew("--no-diagnose") and is_anew("--hold", "foh") and is_anew("--split", "0.4")
    assert is_anew("--fix", "k=2") and is_anew("--prior", "k=2,0.1") and not is_anew("--fix", "k=2")
    model.write_text("// moved\n" + text)
    assert not is_anew()
    model.write_text(text.replace("start = 0, fixed", "start = 0.1, fixed"))
    assert is_anew()
    model.write_text(text)
    (machines / "daest.toml").write_text('[data]\nunits = { y = "mV" }\n')
    assert is_anew() and not is_anew()


def test_refusals(machines, daest):
    code, _, err = daest("fleet", "nowhere", "--model", "Lag.mo")
    assert code == 2 and "data-missing-file" in err
    (machines / "empty").mkdir()
    code, _, err = daest("fleet", "empty", "--model", "Lag.mo")
    assert code == 2 and "fleet-empty" in err
    code, _, err = daest("fleet", "machines/lame.csv", "machines/broken.csv", "--model", "Lag.mo")
    assert code == 2 and "fleet-nothing" in err


def test_names_of_machines(tmp_path):
    """Stems, partitions of a dataset, and paths where two would be called alike."""
    paths = ["a.csv", "machine=m 1/part-0.parquet", "machine=m%202/part-0.parquet", "x/b.csv", "y/b.csv"]
    for path in paths:
        (tmp_path / path).parent.mkdir(exist_ok=True)
        (tmp_path / path).write_text("")
    found = machine_files([tmp_path])
    twice = [str(tmp_path / path) for path in ("x/b.csv", "y/b.csv")]
    assert sorted(name for name, _ in found) == sorted(["a", "m 1", "m 2", *twice])
    assert {path for _, path in found} == {tmp_path / path for path in paths}


def test_groups_and_odd_ones():
    """Places that sensors cannot tell apart are one group; parameters of machines that lack something do not
    count."""
    rng = np.random.default_rng(1)
    whole = [
        Machine(f"w{i}", "converged", parameters={"J": (1.0 + 0.05 * rng.standard_normal(), 0.01)},
                verdict="not falsified")
        for i in range(30)
    ]  # fmt: skip
    whole[4] = Machine("w4", "converged", parameters={"J": (2.0, 0.01)}, verdict="not falsified")
    lacking = [
        Machine(f"x{i}", "converged", parameters={"J": (9.0, 0.01)}, verdict="supported", effect="Friction",
                at=at, places=places)
        for i, (at, places) in enumerate([("a", ("b",)), ("b", ()), ("b", ("a",)), ("c", ())])
    ]  # fmt: skip
    fleet = summary([*whole, *lacking])
    assert [(g.at, g.machines) for g in fleet.groups] == [("b", ("x0", "x1", "x2")), ("c", ("x3",))]
    assert [odd.machine for odd in fleet.odd] == ["w4"]
    assert fleet.spread["J"].n == 30 and fleet.spread["J"].mean_std_error == pytest.approx(0.01)
