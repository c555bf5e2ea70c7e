"""Effects with states of their own are screened where the model has these states already."""

from daest.diagnosis.screening.candidates import keeping_order, pairs
from daest.modelica.compile import compile_model
from daest.modelica.effects.catalogue import find_effect
from daest.modelica.places.sites import sites
from daest.systems.reduction.reduce import reduce_index

CIRCUIT = """model Circuit
  Daest.Blocks.Interfaces.RealInput u(unit = "V");
  Daest.Electrical.Analog.Sources.SignalVoltage source;
  Daest.Electrical.Analog.Basic.Resistor resistor(R = 1);
  Daest.Electrical.Analog.Basic.{part};
  Daest.Electrical.Analog.Basic.Ground ground;
equation
  connect(u, source.v);
  connect(source.p, resistor.p);
  connect(resistor.n, part.p);
  connect(part.n, source.n);
  connect(source.n, ground.p);
end Circuit;
"""


def kept(tmp_path, part: str, effect: str) -> set[bool]:
    (tmp_path / "Circuit.mo").write_text(CIRCUIT.format(part=part))
    flat = compile_model(tmp_path / "Circuit.mo")
    found = keeping_order(flat, reduce_index(flat), pairs([find_effect(effect)], sites(flat)))
    # The current through the ground is none.
    return {c.is_dynamic for c in found if c.site.name != "ground.p"}


def test_an_inductance_beside_another_one(tmp_path) -> None:
    for effect in ("Inductance", "SaturatingInductance"):
        assert kept(tmp_path, "Inductor part(L = 1e-3)", effect) == {False}
        assert kept(tmp_path, "Resistor part(R = 2)", effect) == {True}
    assert kept(tmp_path, "Inductor part(L = 1e-3)", "Lag") == {True}
