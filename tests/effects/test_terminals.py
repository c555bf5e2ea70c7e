"""Effects in series at an output voltage at which an input current flows, against the voltage by hand."""

from pathlib import Path

import numpy as np
import pytest
from effect_rig import in_steps

from daest.diagnosis.null_model.loads import load_sites
from daest.modelica.compile import compile_model, compile_text
from daest.modelica.effects.attach import attach
from daest.modelica.effects.catalogue import find_effect
from daest.modelica.effects.extend import extend_model
from daest.modelica.places.sites import find_site, fits, sites
from daest.systems.simulation.simulate import simulate

CELL = """model Cell
  parameter Real R(unit = "Ohm") = 0.02;
  input Real i(unit = "A");
  Real z(start = 0.9, fixed = true);
  output Real u(unit = "V"){binding};
equation
  9000*der(z) = -i;{equation}
end Cell;
"""
VOLTAGE = "3.2 + 0.9*z - R*i"
FORMS = {
    "equation": CELL.format(binding="", equation=f"\n  u = {VOLTAGE};"),
    "binding": CELL.format(binding=f" = {VOLTAGE}", equation=""),
    "measured": CELL.format(binding=';\n  Real v(unit = "V")', equation=f"\n  v = {VOLTAGE};\n  u = v;"),
    "charged": CELL.format(binding="", equation=f"\n  u = {VOLTAGE.replace('- R', '+ R')};"),
}
TIME = np.linspace(0.0, 60.0, 31)
RELAXED = 0.015 * 5.0 * (1.0 - np.exp(-TIME / 36.0))
DROP = 0.1 * np.tanh(5.0 / 0.3)


def voltage(sign=-1.0, more=0.0):
    return 3.2 + 0.9 * (0.9 - 5.0 * TIME / 9000) + sign * (0.02 * 5.0 + more)


@pytest.mark.parametrize("form", FORMS)
def test_relaxation_is_put_in_series(tmp_path, form):
    path = tmp_path / "Cell.mo"
    path.write_text(FORMS[form])
    flat, effect = compile_model(path), find_effect("Electrical.VoltageRelaxation")
    site = find_site(flat, "u:i", effect)
    assert site.kind == "terminal" and fits(effect, site)
    values = {"R": 0.015, "T": 36.0}
    written = extend_model(path, None, effect, site, values=values)
    for model in (attach(flat, effect, site, values=values), written.flat):
        found = simulate(model, (TIME, np.full((31, 1), 5.0))).outputs[:, 0]
        expected = voltage(1.0 if form == "charged" else -1.0, RELAXED)
        assert found == pytest.approx(expected, abs=1e-6)


def test_drop_is_in_volts_beside_millivolts_and_milliamperes(tmp_path):
    path = tmp_path / "Cell.mo"
    path.write_text(
        'model Cell parameter Real R(unit = "Ohm") = 0.02; input Real i(unit = "mA");\n'
        'output Real u(unit = "mV"); equation u = 3200 - R*i; end Cell;\n'
    )
    flat, effect = compile_model(path), find_effect("Electrical.BrushVoltageDrop")
    site, values = find_site(flat, "u:i", effect), {"V_b": 0.1, "i_s": 0.3}
    written = extend_model(path, None, effect, site, values=values)
    for model in (attach(flat, effect, site, values=values), written.flat):
        found = simulate(model, (TIME, np.full((31, 1), 300.0))).outputs[:, 0]
        assert found == pytest.approx(3200.0 - 6.0 - 100.0 * np.tanh(1.0), rel=1e-6)


@pytest.mark.slow  # test_inner_signals.py, test_meshes.py
def test_two_effects_at_one_terminal_add_up(tmp_path):
    path = tmp_path / "Cell.mo"
    path.write_text(FORMS["equation"])
    steps = [("BrushVoltageDrop", {"V_b": 0.1, "i_s": 0.3}), ("TemperatureDependentResistance", {"r": 0.0})]
    expected, made = in_steps(tmp_path, path, "Cell", [(f"Electrical.{n}", "u:i", v) for n, v in steps])
    for one in (expected, made.flat):
        found = simulate(one, (TIME, np.full((31, 1), 5.0))).outputs[:, 0]
        assert found == pytest.approx(voltage(more=DROP), rel=1e-6)


@pytest.mark.parametrize("law", ["u = 3.2 + 0.9*z", "u = 3.2 - R*i*z"])
def test_output_that_no_constant_resistance_ties_to_the_current_is_no_terminal(law):
    text = CELL.format(binding="", equation=f"\n  {law};")
    assert not [s for s in sites(compile_text(text.encode(), Path("Cell.mo"))) if s.kind == "terminal"]


def test_a_terminal_takes_no_load():
    flat = compile_text(FORMS["equation"].encode(), Path("Cell.mo"))
    assert [site.name for site in load_sites(flat)] == ["0:z"]
