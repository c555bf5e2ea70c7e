"""Which candidates a diagnosis looks at."""

import numpy as np

from daest.data.read import Signal, read_experiments
from daest.diagnosis.built_in.chosen import MEASURED_INPUT, chosen_candidates, temperatures_of
from daest.diagnosis.options import DiagnoseOptions
from daest.modelica.compile import compile_model
from daest.modelica.effects.catalogue import effect_library
from daest.modelica.places.sites import sites

ROOM = """model Room
  input Real T_a(unit = "UNIT");
  output Real y(unit = "degC");
  parameter Real tau(unit = "s") = 100;
  Real T(unit = "degC", start = 20);
equation
  tau*der(T) = T_a - T;
  y = T;
end Room;
"""


def test_no_recorded_temperature_is_added_to_a_temperature(tmp_path):
    time = np.arange(50.0)
    rows = np.column_stack([time, np.sin(time), 20 + np.cos(time), 20 + np.sin(0.3 * time), time % 7])
    header = "time [s],T_a,y [degC],T_next [degC],wind [m/s]"
    np.savetxt(tmp_path / "run.csv", rows, delimiter=",", header=header, comments="")

    def tried(unit: str) -> set[tuple[str, str]]:
        (tmp_path / "Room.mo").write_text(ROOM.replace("UNIT", unit))
        flat = compile_model(tmp_path / "Room.mo")
        records = read_experiments([tmp_path / "run.csv"], [Signal("T_a", unit)], [Signal("y", "degC")])
        assert records[0].extra_units == {"T_next": "degC", "wind": "m/s"}
        options, known = DiagnoseOptions(), temperatures_of(flat)
        found = chosen_candidates(effect_library(), sites(flat), records, options, temperatures=known)
        return {(c.inputs["z"], c.site.name) for c in found if c.effect.class_name == MEASURED_INPUT}

    assert tried("degC") == {("wind", "T_a"), ("wind", "y")}
    # What no temperature drives may be a rise above the one that is recorded.
    assert ("T_next", "y") in tried("1")


def test_column_supplies_laws_of_its_unit(tmp_path):
    """A wind is no temperature, and a temperature is neither a wind nor a flow of heat; what has no unit may
    be anything but a temperature."""
    (tmp_path / "Room.mo").write_text(ROOM.replace("UNIT", "degC"))
    flat = compile_model(tmp_path / "Room.mo")
    time = np.arange(50.0)
    rows = np.column_stack([time, np.sin(time), 20 + np.cos(time), np.sin(0.3 * time), time % 7, time % 5])
    header = "time [s],T_a,y [degC],T_next [degC],wind [m/s],other"
    np.savetxt(tmp_path / "run.csv", rows, delimiter=",", header=header, comments="")
    records = read_experiments([tmp_path / "run.csv"], [Signal("T_a", "degC")], [Signal("y", "degC")])
    found = chosen_candidates(effect_library(), sites(flat), records, DiagnoseOptions())
    thermal = [c for c in found if c.effect.domain == "thermal" and c.inputs]
    assert {(c.effect.name, *c.inputs.values()) for c in thermal} == {
        ("MeasuredSurroundings", "T_next"),
        ("MeasuredHeatFlow", "wind"),
        ("MeasuredHeatFlow", "other"),
        ("MeasuredHeatGain", "other"),
    }
    (next_door,) = (c for c in thermal if c.effect.name == "MeasuredSurroundings")
    assert next_door.input_units == {"u": "degC"}
