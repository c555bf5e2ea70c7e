"""Effects that only rescale a model are told by its equations, whatever the recording."""

import numpy as np
import pytest

from daest.diagnosis.absorbed import rescaling_sizes
from daest.diagnosis.candidates import explicit_at_null, pairs
from daest.diagnosis.size_slopes import sizes_of
from daest.modelica.compile import compile_model
from daest.modelica.effects import find_effect
from daest.modelica.sites import sites

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
