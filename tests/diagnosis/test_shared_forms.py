"""The explicit form of a model with effects is made once for models that differ in values alone."""

from dataclasses import replace
from typing import Any

import numpy as np

from daest.diagnosis.screening import candidates
from daest.diagnosis.screening.candidates import attached, explicit_at_null, pairs
from daest.model.flat import ExplicitModel
from daest.modelica.compile import compile_model
from daest.modelica.effects.catalogue import find_effect
from daest.modelica.places.sites import sites
from daest.systems.reduction.reduce import reduce_index

ROTOR = """model Rotor
  parameter Real J(unit = "kg.m2", min = 0) = 0.06;
  parameter Real b(unit = "N.m.s/rad", min = 0) = 0.05;
  input Real torque(unit = "N.m", start = 0);
  Real w(unit = "rad/s");
  output Real speed(unit = "rad/s");
equation
  J*der(w) = torque - b*w;
  speed = w;
end Rotor;
"""


def test_other_values_share_the_form_and_keep_their_values(tmp_path, monkeypatch) -> None:
    (tmp_path / "Rotor.mo").write_text(ROTOR)
    flat = compile_model(tmp_path / "Rotor.mo")
    found = pairs([find_effect("Rotational.CoulombFriction"), find_effect("Gain")], sites(flat))
    shaped = [replace(c, shape={p.name: p.start for p in c.effect.parameters if p.grid}) for c in found]
    explicit_at_null(flat, shaped)

    other = flat.with_theta({"J": 0.2, "b": 0.01})
    moved = [replace(c, shape={name: 3.0 * value for name, value in c.shape.items()}) for c in shaped]
    assert any(c.shape for c in moved)
    made: list[tuple] = []

    def counted(*arguments: Any, **options: Any) -> ExplicitModel:
        made.append(arguments)
        return reduce_index(*arguments, **options)

    monkeypatch.setattr(candidates, "reduce_index", counted)
    shared = explicit_at_null(other, moved)
    assert not made

    alone = reduce_index(attached(other, moved))
    assert shared.state_names == alone.state_names
    assert [(p.name, p.value) for p in shared.flat.parameters] == [
        (p.name, p.value) for p in alone.flat.parameters
    ]
    x, w = np.full(alone.n_states, 0.7), np.zeros(alone.rhs.numel_in(3))
    v = np.zeros(alone.rhs.numel_in(2))

    def rates(explicit: ExplicitModel) -> np.ndarray:
        return np.array(explicit.rhs(x, 0.4, v, w, explicit.flat.theta_values, 0.0))

    np.testing.assert_allclose(rates(shared), rates(alone), rtol=1e-12)

    explicit_at_null(other, moved[:1])
    assert len(made) == 1
