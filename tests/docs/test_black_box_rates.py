"""The calibration of the diagnosis of FMUs: its records, its counts, the file that the docs show."""

import json
import sys

import numpy as np
import pytest
from test_rates import ROOT, loaded


@pytest.fixture(scope="module")
def study():
    sys.path.insert(0, str(ROOT / "benchmarks"))
    yield loaded("benchmarks/black_box_study.py")
    sys.path.remove(str(ROOT / "benchmarks"))
    del sys.modules["black_box_study"], sys.modules["diagnosis_study"]


def some_run(study, case, verdict, claimed=(), right=False, seed=0):
    group = next(c.group for c in study.CASES if c.name == case)
    size = study.SIZES[seed // 3 % 3]
    return study.Run(case, group, "steps", size, seed, 1600, verdict, tuple(claimed), right, 0.5, 2.0)


def test_rates_of_each_group(study):
    runs = [
        some_run(study, "nothing", "nothing missing"),
        some_run(study, "nothing", "supported", ["Lag at phi"], seed=1),
        some_run(study, "supply", "supported", ["MeasuredInput at u (sag)"], True, seed=6),
        some_run(study, "supply", "external disturbance", seed=7),
        some_run(study, "hardening", "external disturbance"),
    ]
    rates = {(r["group"], r["what"]): (r["hits"], r["runs"]) for r in study.table(runs)["rates"]}
    assert rates["nothing missing", "an effect named"] == (1, 2)
    assert rates["effect at the input or an output", "right where claimed"] == (1, 1)
    assert rates["effect at the input or an output", "right of all, size 1.0"] == (1, 2)
    assert rates["effect between the parts", "another law named"] == (0, 1)
    assert ("coloured external load", "an effect named") not in rates


def test_faults_of_sensors_are_in_the_records(study):
    """A record with the fault, less the same record without."""
    for name, fault in (("offset-omega", [0.05, 0.0]), ("drift-phi", [0.0, 0.05])):
        case = next(c for c in study.CASES if c.name == name)
        whole = study.record(case, "steps", 0.5, 200, 3)
        plain = study.servo_truth(case, "steps", 0.5, 200, 3).experiment
        np.testing.assert_allclose((whole.outputs - plain.outputs)[-1], fault, atol=1e-12)


@pytest.mark.slow
def test_a_record_of_each_kind(study):
    assert study.one_run(("nothing", 6, 1600)).verdict == "nothing missing"
    assert study.one_run(("supply", 6, 1600)).is_right
    assert not study.one_run(("unbalance-disc", 6, 1600)).claimed


def test_the_file_is_one_that_the_study_writes(study):
    kept = json.loads((ROOT / "docs" / "black_box_rates.json").read_text(encoding="utf-8"))
    fresh = study.table([some_run(study, "nothing", "nothing missing")])
    assert kept.keys() - {"measured"} == fresh.keys()
    assert [case["case"] for case in kept["cases"]] == [case.name for case in study.CASES]
    assert sum(case["runs"] for case in kept["cases"]) == kept["n_runs"]
