"""`daest init`: the written project is one that the reader understands, and nothing is overwritten."""

import json

import pytest

from daest.data.project import load_project


def test_written_project_is_read_back(folder, daest):
    code, out, _ = daest("init", "Lag.mo", "run1.csv")
    assert code == 0
    assert "wrote daest.toml for Lag" in out and "input u: u" in out and "estimated parameters: T, k" in out
    project = load_project()
    assert project.source.resolve() == folder / "Lag.mo"
    assert [path.resolve() for path in project.estimate] == [folder / "run1.csv"]
    assert project.preparation.split == 0.5
    assert project.inputs == {"u": "u"} and project.outputs == {"y": "y"}
    assert project.parameters["T"].estimate and project.parameters["T"].value == 0.4
    assert project.parameters["T"].min == 0 and project.parameters["k"].min is None
    assert project.measurement_noise["y"].size == 0.02


@pytest.mark.parametrize(("n_rows", "split"), [(40, 0.5), (61, 0.82), (120, 0.5)])
def test_more_than_half_of_a_short_recording_estimates_where_that_is_enough(folder, daest, n_rows, split):
    """Half of 61 samples are too few to diagnose from, and of 40 all are."""
    lines = (folder / "run1.csv").read_text().splitlines()[: n_rows + 1]
    (folder / "short.csv").write_text("\n".join(lines) + "\n")
    assert len(lines) == n_rows + 1 and daest("init", "Lag.mo", "short.csv")[0] == 0
    assert load_project().preparation.split == split
    said = "the first half estimates" if split == 0.5 else "the first 82%, since half is too short, estimate,"
    assert said in (folder / "daest.toml").read_text()


def test_share_that_estimates_is_one_of_the_time(folder, daest):
    """Of 81 samples that get ever rarer, as in a test of a well, most are in the first half of the time."""
    rows = [f"{1.04**k:.4f},{0.1 * k},{0.2 * k}" for k in range(81)]
    (folder / "well.csv").write_text("\n".join(["time,u,y", *rows]) + "\n")
    assert daest("init", "Lag.mo", "well.csv")[0] == 0
    assert load_project().preparation.split == 0.5


OVEN = """model Oven
  parameter Real C(unit = "J/K") = 400;
  parameter Real G(unit = "W/K") = 0.5;
  input Real P(unit = "W");
  Real T(unit = "degC", start = 20) "Temperature inside";
  Real Q(unit = "W") "Loss";
equation
  Q = G*(T - 20);
  C*der(T) = P - Q;
end Oven;
"""


def test_variables_that_columns_are_called_like_are_outputs_of_a_model_without(folder, daest):
    (folder / "Oven.mo").write_text(OVEN)
    rows = [f"{10 * k},{100 * (k < 40)},{20 + k * 0.3:.2f},{k % 3}" for k in range(120)]
    (folder / "oven.csv").write_text("\n".join(["time,P_W,T_degC,door", *rows]) + "\n")
    code, out, _ = daest("init", "Oven.mo", "oven.csv")
    assert code == 0 and "output T: T_degC, please check" in out and "check-unusable" not in out
    project = load_project()
    assert project.outputs == {"T": "T_degC"} and list(project.measurement_noise) == ["T"]


DECAY = """model Decay
  parameter Real T(unit = "s") = 0.3;
  output Real y(unit = "V", start = 1, fixed = false);
equation
  T*der(y) = -y;
end Decay;
"""


@pytest.mark.parametrize(("n_rows", "is_whole"), [(120, True), (30, False)])
def test_last_of_several_runs_that_nothing_drives_validates_as_a_whole(folder, daest, n_rows, is_whole):
    """Of a frame that swings out, both second halves hold the frame at rest; what is left without the last
    run must be enough to diagnose from."""
    (folder / "Decay.mo").write_text(DECAY)
    rows = [f"{0.01 * k:.2f},{0.97**k:.5f}" for k in range(n_rows)]
    for name in ("a.csv", "b.csv"):
        (folder / name).write_text("\n".join(["time,y", *rows]) + "\n")
    assert daest("init", "Decay.mo", "a.csv", "b.csv")[0] == 0
    project = load_project()
    assert [path.name for path in project.estimate] == (["a.csv"] if is_whole else ["a.csv", "b.csv"])
    assert [path.name for path in project.validate] == (["b.csv"] if is_whole else [])
    assert (project.preparation.split is None) == is_whole
    # A driven model, or a single run, is divided as ever.
    assert daest("init", "Decay.mo", "a.csv", "-p", "one.toml")[0] == 0
    assert load_project(folder / "one.toml").preparation.split is not None
    assert daest("init", "Lag.mo", "run1.csv", "run2.csv", "-p", "driven.toml")[0] == 0
    assert load_project(folder / "driven.toml").preparation.split == 0.5


def test_recordings_for_validation_are_known_by_their_names(folder, daest):
    (folder / "run_Test2.csv").write_text((folder / "run1.csv").read_text())
    (folder / "latest.csv").write_text((folder / "run1.csv").read_text())
    assert daest("init", "Lag.mo", "run_Test2.csv", "run1.csv", "latest.csv")[0] == 0
    project = load_project()
    assert [path.name for path in project.estimate] == ["run1.csv", "latest.csv"]
    assert [path.name for path in project.validate] == ["run_Test2.csv"]
    assert project.preparation.split is None
    assert daest("init", "Lag.mo", "run_Test2.csv", "-p", "alone.toml")[0] == 0
    assert [path.name for path in load_project(folder / "alone.toml").estimate] == ["run_Test2.csv"]


def test_existing_file_is_kept(folder, daest):
    (folder / "daest.toml").write_text("# mine\n")
    code, out, err = daest("init", "Lag.mo")
    assert code == 2 and out == "" and "config-exists" in err and "daest.toml" in err
    assert (folder / "daest.toml").read_text() == "# mine\n"
    assert daest("init", "Lag.mo", "-p", "other/daest.toml")[0] == 0
    assert load_project(folder / "other" / "daest.toml").source.resolve() == folder / "Lag.mo"


def test_columns_are_proposed_and_doubts_are_said(folder, daest):
    text = (folder / "run1.csv").read_text().replace("time,u,y", "time,U_V,ch2 [mV]")
    (folder / "odd.csv").write_text(text)
    code, out, _ = daest("init", "Lag.mo", "odd.csv", "--format", "json")
    document = json.loads(out)
    assert code == 0 and document["schema"] == "daest/init/1"
    assert document["inputs"] == {"u": "U_V"} and document["outputs"] == {"y": "ch2"}
    assert document["estimate"] == ["T", "k"]
    assert document["doubtful"] == ["u", "y"]
    assert "matched by unit: please check" in (folder / "daest.toml").read_text()
    assert load_project().outputs == {"y": "ch2"}


def test_a_unit_that_is_not_understood_is_said_where_no_column_fits(folder, daest):
    text = (folder / "run1.csv").read_text().replace("time,u,y", "time,a,b [Voltz]")
    (folder / "odd.csv").write_text(text)
    _, out, _ = daest("init", "Lag.mo", "odd.csv")
    assert "unit of b: 'Voltz' is not understood" in out and "unit of a" not in out


def test_what_fits_nothing_is_left_to_the_user(folder, daest):
    text = (folder / "run1.csv").read_text().replace("time,u,y", "time,a,b")
    (folder / "odd.csv").write_text(text)
    _, out, _ = daest("init", "Lag.mo", "odd.csv")
    assert "input u: NO COLUMN FITS, please complete daest.toml" in out
    assert "check-unusable" not in out
    assert '# u = "?"' in (folder / "daest.toml").read_text()
    assert load_project().inputs == {}


def test_missing_model_or_data_writes_nothing(folder, daest):
    code, _, err = daest("init", "Lug.mo")
    assert code == 2 and "model-missing" in err and "did you mean Lag.mo?" in err
    code, _, err = daest("init", "Lag.mo", "run3.csv")
    assert code == 2 and "data-missing-file" in err and "run1.csv" in err
    assert not (folder / "daest.toml").exists()


def test_time_and_units_are_found(folder, daest):
    rows = (folder / "run1.csv").read_text().splitlines()[1:]
    lines = [f"{t},{1000 * float(u)},{y}" for t, u, y in (row.split(",") for row in rows)]
    (folder / "odd.csv").write_text("\n".join(["t,u_mV,y", *lines]))
    code, out, _ = daest("init", "Lag.mo", "odd.csv", "--format", "json")
    document = json.loads(out)
    assert code == 0 and document["time"] == "t" and document["units"] == {"u_mV": "mV"}
    assert document["findings"] == []
    project = load_project()
    assert project.time == "t" and project.units == {"u_mV": "mV"} and project.inputs == {"u": "u_mV"}
    code, out, err = daest("identify", "--format", "json")
    assert code == 0, err
    assert abs(json.loads(out)["parameters"]["k"]["value"] - 2.0) < 0.05


def test_other_temperatures_are_in_the_unit_of_those_of_the_model(folder, daest):
    """A column that no signal has, without a unit, may be what a law needs."""
    (folder / "Room.mo").write_text(
        'model Room input Real T_out(unit = "degC"); output Real T(unit = "degC");'
        ' parameter Real tau(unit = "s") = 9; equation tau*der(T) = T_out - T; end Room;'
    )
    rows = "".join(f"{0.1 * k:.1f},{k % 3},{k % 5},{k % 7},{k % 2}\n" for k in range(40))
    for header, expected in (
        ("T_out,T,T_next,Torque", {"T_next": "degC"}),
        ("T_out [K],T [K],Tn,x", {"Tn": "K"}),
    ):
        (folder / "room.csv").write_text(f"time [s],{header}\n{rows}")
        (folder / "daest.toml").unlink(missing_ok=True)
        code, out, err = daest("init", "Room.mo", "room.csv", "--format", "json")
        assert code == 0, err
        assert json.loads(out)["units"] == expected == load_project().units


def test_faults_of_the_recording_are_told_at_once(folder, daest):
    text = (folder / "run1.csv").read_text().replace("\n0.15,", "\n0.1,", 1)
    (folder / "bad.csv").write_text(text)
    code, out, _ = daest("init", "Lag.mo", "bad.csv")
    assert code == 0 and "warning[check-clock-duplicate]: bad: the clock" in out


def test_a_recording_without_time_leaves_a_file_that_asks_for_it_and_is_told_of(folder, daest):
    rows = (folder / "run1.csv").read_text().splitlines()[1:]
    lines = [f"{row.rpartition(',')[0].partition(',')[2]},{k % 7}" for k, row in enumerate(rows)]
    (folder / "bare.csv").write_text("\n".join(["u,y", *lines]))
    code, _, err = daest("init", "Lag.mo", "bare.csv")
    assert (
        code == 2 and "data-no-time" in err and "daest.toml is written: complete it" in " ".join(err.split())
    )
    assert '# time = "?"' in (folder / "daest.toml").read_text() and load_project().time is None


def test_what_is_to_be_checked_or_completed_is_told(folder, daest):
    (folder / "odd.csv").write_text((folder / "run1.csv").read_text().replace("time,u,y", "time,u_drive,y"))
    model = (folder / "Lag.mo").read_text().replace("estimate = true", "estimate = false")
    (folder / "Lag.mo").write_text(model)
    _, out, _ = daest("init", "Lag.mo", "odd.csv")
    assert "input u: u_drive, please check" in out and "output y: y\n" in out
    assert "estimated parameters: T (the model marks none), please check" in out
    numbers = model.replace('unit = "s", ', "").replace(
        "  parameter Real", '  parameter Real z(unit = "m") = 0;\n  parameter Real', 1
    )
    (folder / "Lag.mo").write_text(numbers)
    _, out, _ = daest("init", "Lag.mo", "odd.csv", "-p", "none/daest.toml")
    assert "estimated parameters: NONE MARKED, see [parameters] of none/daest.toml" in out
    code, _, err = daest("identify", "-p", "none/daest.toml")
    assert code == 2 and "[parameters] NAME = { estimate = true }" in err


UNMARKED = """model Box "A room"
  parameter Real C(unit = "J/K") = 4e5;
  parameter Real G(unit = "W/K") = 30;
  parameter Real Tref(unit = "K") = 0;
  parameter Real share = 0.5;
  input Real Ta(unit = "degC") "Outdoor temperature";
  input Real P(unit = "W");
  Real Troom(unit = "degC", start = 18) "Office";
  output Real y(unit = "degC");
equation
  C*der(Troom) = share*P - G*(Troom - Ta - Tref);
  y = Troom;
end Box;
"""


@pytest.fixture
def box(folder):
    (folder / "Box.mo").write_text(UNMARKED)
    (folder / "box.csv").write_text(
        "timestamp,T_hall_degC,T_office_degC,Toutdoor_degC,heater_kW\n"
        + "".join(f"2026-03-02T00:{k:02d}:00,{17 + k % 3},{18 + k % 5},{2 + k % 2},1.5\n" for k in range(40))
    )
    return folder


def test_descriptions_name_columns_and_parameters_are_proposed(box, daest):
    document = json.loads(daest("init", "Box.mo", "box.csv", "--format", "json")[1])
    assert document["inputs"] == {"Ta": "Toutdoor_degC", "P": "heater_kW"}
    assert document["outputs"] == {"y": "T_office_degC"}
    assert {"Ta", "y"} <= set(document["doubtful"])
    # Neither what is zero nor a ratio.
    assert document["estimate"] == document["proposed"] == ["C", "G"]
    assert "The model marks none as unknown" in (box / "daest.toml").read_text()
    assert load_project().parameters["C"].estimate


def test_in_per_unit_every_parameter_is_a_quantity(folder, daest):
    (folder / "Bath.mo").write_text(
        """model Bath
  parameter Real l(unit = "s") = 0.01;
  parameter Real r(unit = "1") = 0.4;
  input Real u(unit = "1");
  output Real i(unit = "1", start = 0, fixed = true);
equation
  l*der(i) = u - r*i;
end Bath;
"""
    )
    (folder / "bath.csv").write_text("t,u,i\n" + "".join(f"{k / 100},{k % 3},{k % 5}\n" for k in range(40)))
    document = json.loads(daest("init", "Bath.mo", "bath.csv", "--format", "json")[1])
    assert document["proposed"] == ["l", "r"]


COMPONENTS = """model Wall
  Daest.Thermal.HeatTransfer.Sources.PrescribedHeatFlow heater;
  Daest.Thermal.HeatTransfer.Components.HeatCapacitor room(C = 4e5);
  Daest.Thermal.HeatTransfer.Components.ThermalConductor wall(G = 30);
  Daest.Thermal.HeatTransfer.Sources.FixedTemperature outside;
  Daest.Noise.WhiteHeatFlow wind(intensity = 10);
  input Real P(unit = "W");
  output Real T(unit = "K");
equation
  heater.Q_flow = P;
  connect(heater.port, room.port);
  connect(wind.port, room.port);
  connect(room.port, wall.port_a);
  connect(wall.port_b, outside.port);
  T = room.T;
end Wall;
"""


def test_what_a_model_gives_its_components_is_proposed_where_it_has_nothing_of_its_own(box, daest):
    (box / "Wall.mo").write_text(COMPONENTS)
    document = json.loads(daest("init", "Wall.mo", "box.csv", "--format", "json")[1])
    # Not what stands at the default of its class, nor a noise, which is estimated as one.
    assert document["estimate"] == document["proposed"] == ["room.C", "wall.G"]


RECORD = """package Rooms
  record Wall
    parameter Real G(unit = "W/K") = 30;
    parameter Real share(unit = "1") = 0.5;
  end Wall;
  model Room
    parameter Wall wall(share = 0.4);
    parameter Real C(unit = "J/K") = 4e5;
    input Real P(unit = "W");
    output Real T(unit = "degC", start = 18);
  equation
    C*der(T) = wall.share*P - wall.G*T;
  end Room;
end Rooms;
"""


def test_fields_of_records_that_a_model_declares_are_its_own(box, daest):
    (box / "Rooms.mo").write_text(RECORD)
    document = json.loads(daest("init", "Rooms.mo", "box.csv", "--format", "json")[1])
    assert document["proposed"] == ["wall.G", "C"]


@pytest.mark.parametrize(("capacity", "clock"), [("J/K", "s"), ("W.h/K", "h")])
def test_the_unit_of_cuts_is_that_in_which_the_model_counts_time(box, daest, capacity, clock):
    (box / "Box.mo").write_text(UNMARKED.replace("J/K", capacity))
    assert daest("init", "Box.mo")[0] == 0
    assert f"# from, to [{clock}], resample [{clock}]," in (box / "daest.toml").read_text()


def test_a_parameter_that_is_nothing_but_a_start_is_not_proposed(box, daest):
    text = (box / "Box.mo").read_text()
    begun = text.replace(
        "  parameter Real share", '  parameter Real T0(unit = "K") = 18;\n  parameter Real share'
    )
    (box / "Box.mo").write_text(begun.replace("start = 18", "start = T0"))
    assert "T0" not in json.loads(daest("init", "Box.mo", "box.csv", "--format", "json")[1])["proposed"]


def test_parameters_chosen_on_the_command_line_are_written(box, daest):
    options = ["--fix", "C=5e5", "--set", "G=20", "--estimate", "G", "--estimate", "share"]
    code, out, err = daest("init", "Box.mo", "box.csv", *options, "--prior", "share=0.5,0.1")
    assert code == 0, err
    assert "estimated parameters: G, share\n" in out
    written = load_project().parameters
    assert (written["C"].value, written["C"].estimate) == (5e5, False)
    assert (written["G"].value, written["G"].estimate) == (20, True)
    assert written["share"].prior.std == 0.1 and "Tref" not in written
    (box / "daest.toml").unlink()
    assert "estimated parameters: T\n" in daest("init", "Lag.mo", "--fix", "k=3")[1]
    assert load_project().parameters["k"].estimate is False


def test_of_parameters_that_cancel_the_first_are_proposed(folder, daest):
    """Of m and d of a falling body, d/m is known."""
    units = {"m": "kg", "g": "m/s2", "d": "N.s/m"}
    parameters = "".join(f'  parameter Real {name}(unit = "{unit}") = 2;\n' for name, unit in units.items())
    text = f"model Fall\n{parameters}  output Real y;\nequation\n  m*der(y) = m*g - d*y;\nend Fall;\n"
    (folder / "Fall.mo").write_text(text)
    code, out, _ = daest("init", "Fall.mo", "run1.csv", "--format", "json")
    assert code == 0 and json.loads(out)["estimate"] == ["m", "g"] == json.loads(out)["proposed"]


def test_a_model_without_units_has_its_numbers_proposed_and_is_told_what_it_lacks(folder, daest):
    (folder / "Bare.mo").write_text("""model Bare
  parameter Real T = 0.4; parameter Real k = 2; parameter Real u0 = 0;
  input Real u; output Real y = x; Real x(start = 0);
equation
  T*der(x) = k*(u - u0) - x;
end Bare;
""")
    code, out, _ = daest("init", "Bare.mo", "run1.csv", "run2.csv", "--format", "json")
    assert code == 0 and json.loads(out)["proposed"] == ["T", "k"]
    code, _, err = daest("diagnose", "--effect", "Gain")
    assert code == 0 and "no variable of the model has a unit" in err and "Real v(unit" in err
