"""Where a simulation of unseen data begins."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from daest.diagnosis.evidence.free_starts import _searched_start
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_text
from daest.systems.reduction.reduce import reduce_index
from daest.systems.simulation.integrate import integrator

ROOT = b"""
model Outlet "an outlet of an empty tank: its root has no slope"
  input Real u;
  output Real y;
  Real level(start = 0);
equation
  der(level) = u - level;
  y = sqrt(level);
end Outlet;
"""


def test_a_start_without_slopes_is_told_as_it_is() -> None:
    flat = compile_text(ROOT, Path("Outlet.mo"))
    time, zero = np.arange(20.0), np.zeros((20, 1))
    record = Experiment("run", time, zero, zero + 0.1, ("u",), ("y",))
    null: Any = SimpleNamespace(theta=flat.theta_values, hold="zoh")
    model = integrator(reduce_index(flat))
    begin, free = np.zeros(1), np.ones(1, dtype=bool)
    found = _searched_start(null, model, record, np.zeros((1, 1)), np.eye(1), begin, free, 20)
    np.testing.assert_allclose([found.error, found.state[0]], [0.01, 0.0])
