"""The table of the calibration study that the documentation shows."""

import importlib.util
import json
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]


def loaded(path: str) -> ModuleType:
    """A module outside of the package."""
    name = Path(path).stem
    spec = importlib.util.spec_from_file_location(name, ROOT / path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def study():
    yield loaded("benchmarks/diagnosis_study.py")
    del sys.modules["diagnosis_study"]


@pytest.fixture(scope="module")
def generate():
    yield loaded("docs/generate.py")
    del sys.modules["generate"]


def some_run(
    study, case: str, verdict: str, claimed: tuple[str, ...] = (), right: bool = False, seed: int = 0
):
    group = next(c.group for c in study.CASES if c.name == case)
    size = study.SIZES[seed // 3 % 3]
    return study.Run(case, group, "rotor", "steps", size, seed, 1600, verdict, claimed, right, None, 0.5, 2.0)


def test_rates_count_and_have_exact_limits(study):
    calm = [some_run(study, "nothing-rotor", "nothing missing", seed=i) for i in range(9)]
    alarm = some_run(study, "nothing-servo", "supported", ("CoulombFriction at motor",), seed=9)
    hit = some_run(study, "rotor-coulomb", "supported", ("CoulombFriction at rotor.flange_a",), True, seed=6)
    miss = some_run(study, "rotor-drag", "nothing missing", seed=7)
    table = study.table([*calm, alarm, hit, miss])
    rates = {(r["group"], r["what"]): r for r in table["rates"]}
    named = rates["nothing missing", "an effect named"]
    # One of ten, by Clopper and Pearson: 0.25 % to 44.5 %.
    assert (named["hits"], named["runs"]) == (1, 10)
    assert (named["low"], named["high"]) == pytest.approx((0.0025, 0.4450), abs=1e-4)
    assert rates["one hidden effect", "right where claimed"]["runs"] == 1
    assert rates["one hidden effect", "right of all, size 1.0"]["hits"] == 1
    assert rates["one hidden effect", "right of all, size 1.0"]["runs"] == 2
    assert ("coloured external load", "an effect named") not in rates
    cases = {c["case"]: c for c in table["cases"]}
    assert cases["nothing-rotor"]["right"] is None
    assert cases["rotor-drag"] == {
        "case": "rotor-drag",
        "group": "one hidden effect",
        "runs": 1,
        "right": 0,
        "verdicts": {"nothing missing": 1},
    }
    assert "an effect named: 1/10 = 10.0 % (0.3 to 44.5 %)" in study.report([*calm, alarm, hit, miss])


@pytest.fixture
def compared(study):
    """Runs on which every other method named Coulomb friction."""
    names = dict.fromkeys(study.PEERS, "CoulombFriction")
    cases = ("nothing-rotor", "rotor-asymmetric", "rotor-drag")
    runs = [some_run(study, case, "nothing missing") for case in cases]
    return [replace(run, peers=names, peer_seconds=dict.fromkeys(names, 0.5)) for run in runs]


def test_peers_stand_beside(study, compared):
    """Asymmetric friction is spanned by Coulomb's and a constant: a right name for them."""
    peers = {(r["group"], r["what"]): (r["hits"], r["runs"]) for r in study.table(compared)["peers"]}
    assert peers["stepwise output error, 0.50 s", "names an effect that is not there"] == (1, 1)
    assert peers["stepwise output error, 0.50 s", "right effect of all"] == (1, 2)
    assert peers["daest, 2.00 s", "right effect of all"] == (0, 2)
    assert study.table([replace(run, peers={}) for run in compared])["peers"] == []


def test_the_page_shows_peers_where_they_ran(study, generate, compared, tmp_path, monkeypatch):
    monkeypatch.setattr(generate, "RATES", tmp_path / "rates.json")
    page = (ROOT / "docs" / "trust.md").read_text(encoding="utf-8")
    for runs, shown in ((compared, True), ([replace(run, peers={}) for run in compared], False)):
        generate.RATES.write_text(json.dumps(study.table(runs)), encoding="utf-8")
        text = generate.filled(page).replace("\u00a0", " ")
        assert ("## What others say" in text) is shown
        row = "| stepwise output error, 0.50 s | right effect of all | 2 | 50 % | 1.3 % to 99 % |"
        assert (row in text) is shown


def test_the_file_is_one_that_the_study_writes(study):
    kept = json.loads((ROOT / "docs" / "rates.json").read_text(encoding="utf-8"))
    fresh = study.table([some_run(study, "nothing-rotor", "nothing missing")])
    assert kept.keys() - {"measured"} == fresh.keys()
    assert all(rate.keys() == fresh["rates"][0].keys() for rate in kept["rates"])
    assert {case["case"] for case in kept["cases"]} <= {case.name for case in study.CASES}
    assert sum(case["runs"] for case in kept["cases"]) == kept["n_runs"]


def test_wrong_models_stand_on_the_page_with_their_limits(generate):
    kept = json.loads((ROOT / "docs" / "wrong_models_rates.json").read_text(encoding="utf-8"))
    for rate in (*kept["rates"], *(r for plant in kept["plants"].values() for r in plant)):
        assert 0 <= rate["hits"] <= rate["runs"] <= kept["n_runs"]
        assert rate["low"] <= rate["hits"] / rate["runs"] <= rate["high"]
    verdicts = [n for counts in kept["verdicts"].values() for n in counts.values()]
    assert sum(verdicts) == kept["n_runs"]
    page = generate.filled((ROOT / "docs" / "trust.md").read_text(encoding="utf-8"))
    first = kept["rates"][0]
    assert f"| all | {first['what']} | {first['runs']} | {first['hits']} |" in page
