"""Libraries as users have them: several versions, byte order marks, models inside of them; what is kept of a
compilation. The Modelica Standard Library itself where DAEST_TEST_MSL names the folder that holds it."""

import os
from pathlib import Path

import numpy as np
import pytest

import daest
from daest.modelica.compiling import compiler
from daest.modelica.language.library import BYTE_ORDER_MARK, readable_roots
from daest.systems.linear.split import split
from daest.systems.linear.transfer import poles

MODEL = """model M
  input Real u(start = 0);
  Tiny.Parts.Lag lag(u = u);
  output Real y = lag.y;
  annotation(uses(Tiny(version = "1.0.0")));
end M;
"""

SERVO = """model Servo
  import {0}.Mechanics.Rotational;
  import {0}.Electrical.Analog;
  input Real u(unit = "V");
  output Real phi(unit = "rad") = disc.phi;
  Analog.Sources.SignalVoltage source;
  Analog.Basic.Resistor resistor(R = 4.6);
  Analog.Basic.RotationalEMF emf(k = 0.06);
  Analog.Basic.Ground ground;
  Rotational.Components.Inertia motor(J = 6.3e-6);
  Rotational.Components.IdealGear gear(ratio = 30);
  Rotational.Components.SpringDamper spring(c = 1.5, d = 0.02);
  Rotational.Components.Inertia disc(J = 0.02);
equation
  source.v = u;
  connect(source.p, resistor.p);
  connect(resistor.n, emf.p);
  connect(emf.n, ground.p);
  connect(source.n, ground.p);
  connect(emf.flange, motor.flange_a);
  connect(motor.flange_b, gear.flange_a);
  connect(gear.flange_b, spring.flange_a);
  connect(spring.flange_b, disc.flange_a);
end Servo;
"""


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("DAEST_CACHE", str(tmp_path / "cache"))


def write_library(folder: Path, version: str, seconds: float, mark: bytes = b"") -> None:
    """A library of three files, Tiny.Parts.Lag, whose time constant tells the version."""
    files = {
        "package.mo": f'within ;\npackage Tiny\n  annotation(version = "{version}");\nend Tiny;\n',
        "package.order": "Parts\n",
        "Parts/package.mo": "within Tiny;\npackage Parts\nend Parts;\n",
        "Parts/package.order": "Lag\n",
        "Parts/Lag.mo": "within Tiny.Parts;\nmodel Lag\n  input Real u(start = 0);\n  output Real y;\n"
        f'  parameter Real T(unit = "s") = {seconds};\nequation\n  T*der(y) + y = u;\nend Lag;\n',
    }
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        is_code = name.endswith(".mo")
        (folder / name).write_bytes((mark if is_code else b"") + content.encode())


def time_constant(model: Path, root: Path) -> float:
    flat = daest.compile_model(model, libraries=[root])
    return next(p.value for p in flat.parameters if p.name.endswith("T"))


def test_byte_order_marks_are_taken_off_in_a_copy(tmp_path):
    write_library(tmp_path / "lib" / "Tiny", "1.0.0", 3.0, BYTE_ORDER_MARK)
    (tmp_path / "M.mo").write_bytes(BYTE_ORDER_MARK + MODEL.encode())
    assert time_constant(tmp_path / "M.mo", tmp_path / "lib") == 3.0
    flat = daest.compile_model(tmp_path / "M.mo", libraries=[tmp_path / "lib"])
    places = {e.place.file for e in flat.equations if e.place is not None and "Lag" in str(e.place.file)}
    assert places == {str(tmp_path / "lib" / "Tiny" / "Parts" / "Lag.mo")}  # the user's file, not the copy
    assert (tmp_path / "lib/Tiny/Parts/Lag.mo").read_bytes().startswith(BYTE_ORDER_MARK)


@pytest.mark.parametrize(("uses", "seconds"), [("1.0.0", 2.0), ("2.0.0", 5.0), ("9.9.9", 5.0)])
def test_the_version_that_the_model_uses_else_the_highest(tmp_path, uses, seconds):
    write_library(tmp_path / "lib" / "Tiny 1.0.0", "1.0.0", 2.0)
    write_library(tmp_path / "lib" / "Tiny 2.0.0", "2.0.0", 5.0)
    (tmp_path / "M.mo").write_text(MODEL.replace("1.0.0", uses))
    assert time_constant(tmp_path / "M.mo", tmp_path / "lib") == seconds


def test_a_model_inside_one_of_two_versions(tmp_path):
    write_library(tmp_path / "lib" / "Tiny 1.0.0", "1.0.0", 2.0)
    write_library(tmp_path / "lib" / "Tiny 2.0.0", "2.0.0", 5.0)
    assert time_constant(tmp_path / "lib/Tiny 1.0.0/Parts/Lag.mo", tmp_path / "lib") == 2.0


def test_a_model_beside_the_libraries_of_its_folder(tmp_path):
    write_library(tmp_path / "Tiny", "1.0.0", 2.0)
    (tmp_path / "M.mo").write_text(MODEL)
    assert time_constant(tmp_path / "M.mo", tmp_path) == 2.0


def test_the_first_folder_wins(tmp_path, monkeypatch):
    write_library(tmp_path / "first" / "Tiny", "1.0.0", 2.0)
    write_library(tmp_path / "second" / "Tiny", "1.0.0", 5.0)
    (tmp_path / "M.mo").write_text(MODEL)
    monkeypatch.setenv("MODELICAPATH", str(tmp_path / "second"))
    assert time_constant(tmp_path / "M.mo", tmp_path / "first") == 2.0
    assert time_constant(tmp_path / "M.mo", tmp_path / "second") == 5.0


def test_folders_without_trouble_are_used_as_they_are(tmp_path):
    write_library(tmp_path / "lib" / "Tiny", "1.0.0", 2.0)
    roots = readable_roots([tmp_path / "lib"], MODEL.encode(), tmp_path / "M.mo")
    assert roots.folders == (tmp_path / "lib",) and not (tmp_path / "cache").exists()


def test_a_compilation_is_kept_until_a_file_changes(tmp_path, monkeypatch):
    write_library(tmp_path / "lib" / "Tiny", "1.0.0", 2.0)
    (tmp_path / "M.mo").write_text(MODEL)
    calls = []
    session = compiler._session
    monkeypatch.setattr(compiler, "_session", lambda *job: calls.append(1) or session(*job))
    assert [time_constant(tmp_path / "M.mo", tmp_path / "lib") for _ in range(3)] == [2.0] * 3
    assert len(calls) == 1
    write_library(tmp_path / "lib" / "Tiny", "1.0.0", 25.0)
    assert time_constant(tmp_path / "M.mo", tmp_path / "lib") == 25.0
    for entry in (tmp_path / "cache" / "flat").iterdir():
        entry.write_bytes(b"\x80damaged")
    assert time_constant(tmp_path / "M.mo", tmp_path / "lib") == 25.0


def test_a_copy_in_another_folder_is_not_compiled_again(tmp_path, monkeypatch):
    text = "model M\n  Real x(start = 1);\nequation\n  der(x) = -x;\nend M;\n"
    needy = text.replace("Real", "Length")
    for folder in ("first", "second"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "M.mo").write_text(text)
        (tmp_path / folder / "N.mo").write_text(needy.replace("M", "N"))
        (tmp_path / folder / "Length.mo").write_text(f'type Length = Real(unit = "{folder[0]}");\n')
    calls = []
    session = compiler._session
    monkeypatch.setattr(compiler, "_session", lambda *job: calls.append(1) or session(*job))
    for folder in ("first", "second"):
        place = daest.compile_model(tmp_path / folder / "M.mo").equations[0].place
        assert place is not None and place.file == str(tmp_path / folder / "M.mo")
    assert len(calls) == 1
    # What stands beside a file counts where the file needs it.
    for folder in ("first", "second"):
        assert daest.compile_model(tmp_path / folder / "N.mo").unknowns[0].unit == folder[0]


def test_what_is_kept_does_not_grow_without_end(tmp_path, monkeypatch):
    (tmp_path / "M.mo").write_text("model M\n  Real x(start = 1);\nequation\n  der(x) = -x;\nend M;\n")
    daest.compile_model(tmp_path / "M.mo")
    (first,) = (tmp_path / "cache" / "flat").iterdir()
    monkeypatch.setattr(compiler, "KEPT_BYTES", first.stat().st_size * 3 // 2)
    os.utime(first, (0, 0))
    (tmp_path / "M.mo").write_text("model M\n  Real y(start = 1);\nequation\n  der(y) = -y;\nend M;\n")
    daest.compile_model(tmp_path / "M.mo")
    (left,) = (tmp_path / "cache" / "flat").iterdir()
    assert left.name != first.name


@pytest.mark.skipif("DAEST_TEST_MSL" not in os.environ, reason="DAEST_TEST_MSL names no library folder")
def test_the_servo_from_the_modelica_standard_library(tmp_path):
    reports = {}
    for name, libraries in (("Modelica", [os.environ["DAEST_TEST_MSL"]]), ("Daest", [])):
        (tmp_path / f"{name}.mo").write_text(SERVO.format(name))
        dae = daest.linearize(daest.compile_model(tmp_path / f"{name}.mo", libraries=libraries))
        report = daest.noise_report(dae)
        verdicts = {e.text: place.admissible for e, place in zip(dae.equations, report.places, strict=True)}
        reports[name] = poles(split(dae)), verdicts
    np.testing.assert_allclose(reports["Modelica"][0], reports["Daest"][0], rtol=1e-8)
    shared = set(reports["Modelica"][1]) & set(reports["Daest"][1])
    assert len(shared) > 45
    assert all(reports["Modelica"][1][text] == reports["Daest"][1][text] for text in shared)
