"""Effects that only rescale a model are told by its equations, whatever the recording."""

import numpy as np
import pytest

from daest.diagnosis.screening.absorbed import rescaling_sizes
from daest.diagnosis.screening.candidates import explicit_at_null, pairs
from daest.diagnosis.screening.size_slopes import sizes_of
from daest.modelica.compile import compile_model
from daest.modelica.effects.catalogue import find_effect
from daest.modelica.places.sites import sites

PENDULUM = """model Pendulum
  parameter Real J(unit = "kg.m2", min = 0) = 0.06;
  parameter Real G(unit = "N.m", min = 0) = 1;
  parameter Real b(unit = "N.m.s/rad", min = 0) = 0.05;
  input Real torque(unit = "N.m", start = 0);
  Real load(unit = "N.m");
  Real phi(unit = "rad"), w(unit = "rad/s");
  output Real angle(unit = "rad");
equation
  der(load) = -load;
  der(phi) = w;
  J*der(w) = torque - G*sin(phi) - b*w + load;
  angle = phi;
end Pendulum;
"""


@pytest.mark.parametrize(
    ("effect", "place", "estimated", "loads", "is_absorbed"),
    [
        ("Gain", "torque", ("J", "G", "b"), ("load",), True),
        ("Gain", "torque", ("J", "G", "b"), (), False),  # a load of a known size tells the scale
        ("Gain", "torque", ("J", "b"), ("load",), False),  # so does a known weight
        ("Gain", "angle", ("J", "G", "b"), ("load",), False),
        ("Rotational.ViscousFriction", "2:w", ("b",), ("load",), True),
        ("Rotational.ViscousFriction", "2:w", ("J",), ("load",), False),
        ("Unbalance", "2:w", ("G",), (), True),  # at the phase of the weight
        ("Rotational.CoulombFriction", "2:w", ("J", "G", "b"), ("load",), False),
    ],
)
def test_what_parameters_and_loads_do(tmp_path, effect, place, estimated, loads, is_absorbed) -> None:
    (tmp_path / "Pendulum.mo").write_text(PENDULUM)
    flat = compile_model(tmp_path / "Pendulum.mo")
    (candidate,) = [c for c in pairs([find_effect(effect)], sites(flat)) if c.site.name == place]
    explicit = explicit_at_null(flat, [candidate])
    sizes = [f"{candidate.name}.{p.name}" for p in candidate.effect.sizes]
    rng = np.random.default_rng(1)
    states = rng.normal(size=(50, explicit.n_states))
    inputs, derivatives = rng.normal(size=(50, 1)), np.zeros((50, explicit.rhs.numel_in(2)))
    found = rescaling_sizes(
        explicit, sizes_of(explicit, sizes), estimated, loads, states, inputs, derivatives
    )
    assert found.tolist() == [is_absorbed] * len(sizes)


def test_points_without_a_solution_of_a_loop_are_passed_over(tmp_path) -> None:
    """At half its speed the pump does not reach the level of the tank, and its flow is no number there."""
    (tmp_path / "Pump.mo").write_text("""model Pump
  parameter Real a(unit = "s2/m5", min = 0) = 4e5;
  parameter Real k(unit = "m2/s", min = 0) = 6e-4;
  input Real n(unit = "1", start = 1);
  Real l(unit = "m", start = 3);
  Real q(unit = "m3/s", start = 2e-3);
  Real h(unit = "m", start = 5);
  output Real level(unit = "m");
equation
  h = 10*n*n - a*q*q;
  h - l = 1e6*q*q;
  der(l) = q - k*l;
  level = l;
end Pump;
""")
    flat = compile_model(tmp_path / "Pump.mo")
    candidates = [c for c in pairs([find_effect("Gain")], sites(flat)) if c.site.name == "level"]
    explicit = explicit_at_null(flat, candidates)
    sizes = sizes_of(explicit, [f"{c.name}.{p.name}" for c in candidates for p in c.effect.sizes])
    states, inputs = np.full((50, explicit.n_states), 3.0), np.full((50, 1), 0.9)
    derivatives = np.zeros((50, explicit.rhs.numel_in(2)))
    found = rescaling_sizes(explicit, sizes, ["a", "k"], [], states, inputs, derivatives)
    assert found.tolist() == [False]
