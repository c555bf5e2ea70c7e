"""Two filter stages in one circuit: effects whose states are driven by currents that only a loop of equations
tells, beside others whose states follow the model."""

from functools import cache

import numpy as np
import pytest
from scipy.linalg import expm

from daest.diagnosis.null_model.null import fit_null
from daest.diagnosis.null_model.null_observer import run_null
from daest.diagnosis.refits.dynamic_fits import best_dynamic, best_simulation, dynamic_fits
from daest.diagnosis.screening.candidates import attachable, pairs
from daest.diagnosis.screening.grown_states import brought_rows
from daest.diagnosis.screening.screen import screen
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_model
from daest.modelica.effects.catalogue import effect_library
from daest.modelica.places.sites import sites

STAGES = """model Stages
  parameter Real C1(unit = "F", min = 0) = 1e-7 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real C2(unit = "F", min = 0) = 2e-7 annotation(__Daest(estimate = true, scale = "log"));
  Daest.Blocks.Interfaces.RealInput u(unit = "V");
  Daest.Blocks.Interfaces.RealOutput y(unit = "V");
  Daest.Electrical.Analog.Sources.SignalVoltage source;
  Daest.Electrical.Analog.Basic.Resistor r1(R = 1e4);
  Daest.Electrical.Analog.Basic.Resistor r2(R = 1e4);
  Daest.Electrical.Analog.Basic.Capacitor c1(C = C1);
  Daest.Electrical.Analog.Basic.Capacitor c2(C = C2);
  Daest.Electrical.Analog.Basic.Ground ground;
equation
  connect(u, source.v);
  connect(source.p, r1.p);
  connect(r1.n, c1.p);
  connect(c1.p, r2.p);
  connect(r2.n, c2.p);
  connect(c1.n, ground.p);
  connect(c2.n, ground.p);
  connect(source.n, ground.p);
  y = c2.v;
end Stages;
"""
STORING = ("VoltageRelaxation", "TemperatureDependentResistance")


@cache
def circuit(tmp):
    path = tmp / "Stages.mo"
    path.write_text(STAGES)
    return compile_model(path)


def candidates(flat, *names):
    return pairs([e for e in effect_library() if e.name in names], sites(flat))


def record(n=400, T=1e-3, late=0):
    """Exact over a sample, with a random two-level input that acts `late` samples after it is recorded."""
    rng = np.random.default_rng(3)
    u = np.repeat(rng.choice([-1.0, 1.0], n // 8), 8)
    A = np.array([[-2e3, 1e3], [5e2, -5e2]])
    over = expm(T * np.block([[A, np.array([[1e3], [0.0]])], [np.zeros((1, 3))]]))
    x = np.zeros((n, 2))
    for k in range(n - 1):
        x[k + 1] = over[:2, :2] @ x[k] + over[:2, 2] * u[max(k - late, 0)]
    y = x[:, 1:] + 0.002 * rng.standard_normal((n, 1))
    return Experiment("stages", T * np.arange(n), u[:, None], y, ("u",), ("y",))


def test_loop_that_drives_the_states_of_effects_leaves_them_where_they_are(tmp_path):
    flat = circuit(tmp_path)
    known = [v.name for v in flat.unknowns]
    chosen, _, grown = attachable(flat, candidates(flat, "TemperatureDependentResistance"))
    assert not grown.is_symbolic and len(chosen) > 1
    assert brought_rows(grown, known) == []
    chosen, _, grown = attachable(flat, candidates(flat, "VoltageRelaxation"))
    assert brought_rows(grown, known) == [2 + i for i in range(len(chosen))]


@pytest.mark.slow  # above
def test_states_that_follow_the_model_are_screened_beside_others_that_do_not(tmp_path):
    flat = circuit(tmp_path)
    nodes = [s for s in sites(flat) if s.kind == "node"]
    null = fit_null(flat, nodes, (record(),), "zoh")
    found = screen(null, run_null(null), candidates(flat, *STORING, "Leakage"))
    assert {e.candidate.effect.name for e in found.entries} >= {"VoltageRelaxation", "Leakage"}
    left = {label.split(" at ")[0] for label, reason in found.skipped if "follow" in reason}
    assert left == {"TemperatureDependentResistance"}


@pytest.mark.slow
def test_delay_of_a_sample_is_found_in_a_machine_of_milliseconds(tmp_path):
    """The library's own start, a hundredth of a second, is longer than all that happens here."""
    flat = circuit(tmp_path)
    nodes = [s for s in sites(flat) if s.kind == "node"]
    null = fit_null(flat, nodes, (record(late=1),), "zoh")
    fits = dynamic_fits(null, candidates(flat, "Delay", "Lag"), best_simulation(null))
    first = best_dynamic(null, [fits])[0].trial
    assert first.candidate.effect.name == "Delay"
    assert abs(first.sizes[0] - 1e-3) < 2e-4
