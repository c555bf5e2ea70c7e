"""A mass on a mount of Bouc and Wen: the state of its loop moves itself in a way that is not linear."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.options import DiagnoseOptions
from daest.diagnosis.screening.candidates import attached, pairs
from daest.diagnosis.screening.grown_states import brought_rows, with_integrals
from daest.model.experiment import Experiment
from daest.model.flat import FlatModel
from daest.modelica.compile import compile_text
from daest.modelica.effects.catalogue import effect_library, find_effect
from daest.modelica.places.sites import find_site
from daest.systems.reduction.reduce import reduce_index

MODEL = """model Rig
  parameter Real m(unit = "kg", min = 0) = 2.2 annotation(__Daest(estimate = true));
  parameter Real c(unit = "N.s/m", min = 0) = 20 annotation(__Daest(estimate = true));
  parameter Real k(unit = "N/m", min = 0) = 8e4 annotation(__Daest(estimate = true));
  input Real F(unit = "N");
  output Real y(unit = "m");
  Daest.Mechanics.Translational.Sources.Force force(f = F);
  Daest.Mechanics.Translational.Components.Mass mass(m = m);
  Daest.Mechanics.Translational.Components.SpringDamper mount(c = k, d = c);
  Daest.Mechanics.Translational.Components.Fixed wall;
equation
  connect(force.flange, mass.flange_a);
  connect(mass.flange_b, mount.flange_a);
  connect(mount.flange_b, wall.flange);
  y = mass.s;
end Rig;
"""
M, D, K, F_H, S_H = 2.0, 10.0, 5e4, 60.0, 1.2e-3
PERIOD, SUBSTEPS = 1.0 / 750.0, 20


def flat_model() -> FlatModel:
    return compile_text(MODEL.encode(), Path("Rig.mo"))


@cache
def moved(gamma: float, n: int = 1500) -> tuple[np.ndarray, np.ndarray]:
    """The force (n,) in steps, and position, velocity and place on the loop (n, 3), by the classical method
    of Runge and Kutta."""
    force = np.repeat(np.random.default_rng(3).uniform(-80.0, 80.0, n // 6), 6)

    def rates(x: np.ndarray, u: float) -> np.ndarray:
        s, v, z = x
        turned = (v - abs(v) * z - gamma * v * abs(z)) / S_H
        return np.array([v, (u - D * v - K * s - F_H * z) / M, turned])

    x, found, h = np.zeros(3), [], PERIOD / SUBSTEPS
    for u in force:
        found.append(x)
        for _ in range(SUBSTEPS):
            a = rates(x, u)
            b = rates(x + 0.5 * h * a, u)
            c = rates(x + 0.5 * h * b, u)
            x = x + h / 6.0 * (a + 2.0 * b + 2.0 * c + rates(x + h * c, u))
    return force, np.array(found)


@pytest.mark.parametrize("gamma", [1.0, -1.4])
def test_loop_follows_the_motion_of_the_model(gamma: float) -> None:
    flat = flat_model()
    force, truth = moved(gamma)
    effect = find_effect("Daest.Effects.Translational.BoucWenSpring")
    (candidate,) = pairs([effect], [find_site(flat, "mount")])
    grown = attached(flat, (candidate,))
    values = {f"{candidate.name}.s_h": S_H, f"{candidate.name}.gamma": gamma, f"{candidate.name}.v_s": 1e-3}
    explicit = reduce_index(grown.with_theta(values))
    rows = brought_rows(explicit, flat.unknown_names)
    assert [explicit.state_names[i] for i in rows] == [f"{candidate.name}.z"]
    known = {"s": truth[:, 0], "v": truth[:, 1]}
    time = PERIOD * np.arange(force.size)
    states = np.column_stack(
        [known.get(name.rpartition(".")[2], np.zeros(force.size)) for name in explicit.state_names]
    )
    inputs = (force[None], np.zeros((explicit.rhs.numel_in(2), force.size)))
    # The mount is longer where the mass is nearer to the wall.
    z = with_integrals(explicit, rows, time, states, inputs)[:, rows[0]]
    assert np.std(z + truth[:, 2]) < 0.1 * np.std(truth[:, 2])


@pytest.mark.slow  # its motion: the test above
@pytest.mark.parametrize(("gamma", "name"), [(1.0, "BoucWenSpring"), (0.0, "HystereticSpring")])
def test_loop_is_found(gamma: float, name: str) -> None:
    """Friction with bristles and a cogging force had been told for that of Bouc and Wen."""
    force, truth = moved(gamma)
    y = truth[:, 0] + 5e-6 * np.random.default_rng(4).standard_normal(force.size)
    time = PERIOD * np.arange(force.size)
    record = Experiment("moved", time, force[:, None], y[:, None], ("F",), ("y",))
    names = ("BoucWenSpring", "HystereticSpring", "HardeningSpring", "CoulombFriction")
    library = [effect for effect in effect_library() if effect.name in names]
    found = diagnose(flat_model(), library, [record], options=DiagnoseOptions(hold="zoh"))
    law = found.proofs[0]
    assert found.verdict == "supported" and law.candidate.effect.name == name
    told = {p.name.rpartition(".")[2]: p for p in law.told.parameters}
    assert told["f_h"].value == pytest.approx(F_H, abs=4.0 * told["f_h"].std_error)
    assert told["f_h"].std_error < 0.05 * F_H
