"""`daest filter` on a nonlinear model: kinds, default, summary and table."""

import csv
import json

import numpy as np
import pytest
from lag_data import write_csv

TANK = """\
model Tank "Outflow by the square root of the level"
  parameter Real a = 0.5 "Outflow";
  input Real u(start = 1) "Inflow";
  input Real w annotation(__Daest(noise = true, intensity = 1e-3));
  output Real y = h annotation(__Daest(std = 0.02));
  Real h(start = 1, fixed = true) "Level";
  Real q "Outflow";
equation
  der(h) = u - q + w;
  q = a*sqrt(h);
end Tank;
"""


@pytest.fixture
def tank(folder):
    (folder / "Tank.mo").write_text(TANK)
    rng = np.random.default_rng(0)
    time, level = 0.1 * np.arange(200), np.empty(200)
    u = np.repeat(rng.uniform(0.3, 1.2, 20), 10)
    level[0] = 1.0
    for k in range(199):
        h = level[k]
        for _ in range(20):
            h += 0.005 * (u[k] - 0.5 * np.sqrt(h)) + np.sqrt(0.005 * 1e-3) * rng.standard_normal()
        level[k + 1] = h
    write_csv(folder / "run.csv", time, u, level + 0.02 * rng.standard_normal(200))
    return folder, level


@pytest.mark.parametrize(
    ("options", "kind"),
    [
        ((), "ekf"),
        (("--kind", "ukf"), "ukf"),
        (("--kind", "particle", "--particles", "300", "--seed", "3"), "particle"),
    ],
)
def test_estimates_with_uncertainty(tank, daest, options, kind):
    folder, level = tank
    code, out, _ = daest(
        "filter", "run.csv", "--model", "Tank.mo", "--hold", "zoh", "--format", "json", *options
    )
    document = json.loads(out)
    assert code == 0 and document["kind"] == kind
    assert 0.7 < document["nis"]["mean"] < 1.3
    assert (document["effective_sample_size"] is None) == (kind != "particle")
    with open(folder / "results" / "estimates.csv") as file:
        rows = list(csv.DictReader(file))
    found, std = (np.array([float(row[name]) for row in rows]) for name in ("h", "h.std"))
    assert np.sqrt(np.mean((found - level) ** 2)) < 0.02
    assert 0.6 < np.sqrt(np.mean(((found - level) / std)[5:] ** 2)) < 1.5
    outflow = np.array([float(row["q"]) for row in rows])
    assert np.allclose(outflow, 0.5 * np.sqrt(found), atol=1e-3)


def test_linear_filter_of_a_nonlinear_model_says_what_it_does(tank, daest):
    code, out, err = daest(
        "filter", "run.csv", "--model", "Tank.mo", "--hold", "zoh", "--kind", "time-varying"
    )
    assert code == 0 and "linearised at its operating point" in err
    code, out, _ = daest("filter", "run.csv", "--model", "Tank.mo", "--hold", "zoh")
    assert code == 0 and out.startswith("ekf filter") and "steady" not in out
