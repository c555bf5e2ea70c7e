"""`daest export --compiler omc`, against a program that writes down what it was asked for and answers as
OpenModelica 1.28 does: no OpenModelica is needed."""

import sys
from pathlib import Path

import pytest

MODEL = "model M\n  input Real u(start = 0);\n  Real x;\nequation\n  der(x) = u - x;\nend M;\n"

FAKE = """#!{python}
import pathlib, sys
script = pathlib.Path(sys.argv[1]).read_text()
pathlib.Path({record!r}).write_text(script)
said = {said!r}
if said and ({always} or 'disableDirectionalDerivatives' in script):
    print('true\\n""\\n"' + said.replace('"', chr(92) + '"') + '"')
    pathlib.Path('model.bmo').write_text('')
    sys.exit({status})
is_fmu = 'fileNamePrefix="model"' in script
pathlib.Path('model.fmu' if is_fmu else 'model.bmo').write_text('an FMU' if is_fmu else "package 'M'")
"""

NO_NETWORK = """Error: Curl error for URL https://libraries.example/index.json: Couldn't resolve host name
Error: Failed to download package index https://libraries.example/index.json to file index.json.
"""


@pytest.fixture
def omc(tmp_path, monkeypatch):
    """Puts a fake omc in place; returns a function (said, status, always) -> file that will hold the script.
    It complains `always`, or only about directional derivatives."""

    def install(said: str = "", status: int = 0, always: bool = True) -> Path:
        record, program = tmp_path / "asked.mos", tmp_path / "bin" / "omc"
        program.parent.mkdir(exist_ok=True)
        text = FAKE.format(python=sys.executable, record=str(record), said=said, status=status, always=always)
        program.write_text(text)
        program.chmod(0o755)
        monkeypatch.setenv("OMC", str(program))
        monkeypatch.delenv("MODELICAPATH", raising=False)
        (tmp_path / "M.mo").write_text(MODEL)
        monkeypatch.chdir(tmp_path)
        return record

    return install


def test_an_fmu(omc, daest, tmp_path):
    record = omc()
    (tmp_path / "my libs").mkdir()
    code, _, _ = daest("export", "M.mo", "--compiler", "omc", "-L", "my libs", "-o", "m.fmu")
    assert code == 0 and (tmp_path / "m.fmu").read_bytes() == b"an FMU"
    lines = record.read_text().splitlines()
    assert lines[0].startswith(f'setModelicaPath("{tmp_path / "my libs"}:')
    assert lines[0].endswith('" + ":" + getModelicaPath());')
    assert lines[1:] == [
        f'loadFile("{tmp_path / "M.mo"}");',
        'setCommandLineOptions("-d=-disableDirectionalDerivatives");',
        'buildModelFMU(M, version="2.0", fmuType="me", fileNamePrefix="model");',
        "getErrorString();",
    ]


def test_base_modelica(omc, daest, tmp_path):
    record = omc()
    assert daest("export", "M.mo", "--compiler", "omc", "-o", "m.bmo")[0] == 0
    assert (tmp_path / "m.bmo").read_text() == "package 'M'"
    assert 'setCommandLineOptions("--baseModelica");' in record.read_text()


def test_libraries_that_the_model_names_are_loaded(omc, daest, tmp_path):
    """OpenModelica loads none by itself: not the bundled one, not a class in the file beside this one."""
    record = omc()
    for library in ("Unused", "Blocks 1.0.0", "Blocks 2.0.0"):
        (tmp_path / "libs" / library).mkdir(parents=True)
        (tmp_path / "libs" / library / "package.mo").write_text(f"package {library.split()[0]} end;")
    (tmp_path / "Motor.mo").write_text("model Motor end Motor;")
    (tmp_path / "Other.mo").write_text("model Other end Other;")
    (tmp_path / "M.mo").write_text(
        "model M\n  import Daest.Units.SI;\n  Motor m;\n  Blocks.Gain g;\nend M;\n"
    )
    (tmp_path / "daest.toml").write_text('[model]\nsource = "M.mo"\nlibraries = ["libs"]\n')
    assert daest("export", "--compiler", "omc")[0] == 0
    lines = record.read_text().splitlines()
    assert lines[2:5] == [
        "loadModel(Blocks);",
        "loadModel(Daest);",
        f'loadFile("{tmp_path / "Motor.mo"}");',
    ]
    path = lines[0].removeprefix('setModelicaPath("').partition('"')[0].split(":")
    assert path[0] == str(tmp_path / "libs") and (Path(path[-1]) / "Daest" / "package.mo").is_file()


def test_the_standard_library_of_openmodelica_is_loaded(omc, daest, tmp_path):
    record = omc()
    (tmp_path / "M.mo").write_text("model M Modelica.Blocks.Sources.Sine s; end M;")
    assert daest("export", "M.mo", "--compiler", "omc")[0] == 0
    assert record.read_text().splitlines()[2] == "loadModel(Modelica);"


def test_a_library_named_by_its_own_folder(omc, daest, tmp_path):
    record = omc()
    (tmp_path / "libs" / "Blocks").mkdir(parents=True)
    (tmp_path / "libs" / "Blocks" / "package.mo").write_text("package Blocks end Blocks;")
    (tmp_path / "M.mo").write_text("model M Blocks.Gain g; end M;")
    assert daest("export", "M.mo", "--compiler", "omc", "-L", "libs/Blocks")[0] == 0
    lines = record.read_text().splitlines()
    assert lines[0].startswith(f'setModelicaPath("{tmp_path / "libs"}:') and lines[2] == "loadModel(Blocks);"


def test_a_class_of_a_package_is_loaded_with_the_package(omc, daest, tmp_path):
    record = omc()
    (tmp_path / "P" / "Q").mkdir(parents=True)
    (tmp_path / "P" / "package.mo").write_text("package P end P;")
    (tmp_path / "P" / "Q" / "package.mo").write_text("within P; package Q end Q;")
    (tmp_path / "P" / "Q" / "M.mo").write_text("within P.Q; " + MODEL)
    assert daest("export", "P/Q/M.mo", "--compiler", "omc", "-o", "m.fmu")[0] == 0
    lines = record.read_text().splitlines()
    assert lines[1] == f'loadFile("{tmp_path / "P" / "package.mo"}");'
    assert lines[-2].startswith("buildModelFMU(P.Q.M, ")


@pytest.mark.parametrize("status", [0, 1])
@pytest.mark.parametrize("target", ["m.fmu", "m.bmo"])
def test_its_complaint_is_shown_and_nothing_is_written(omc, daest, tmp_path, status, target):
    omc("Error: class M not found in scope", status)
    (tmp_path / target).write_text("mine")
    code, _, err = daest("export", "M.mo", "--compiler", "omc", "-o", target)
    assert code == 2 and "omc-failed" in err and "class M not found" in err
    assert (tmp_path / target).read_text() == "mine"


def test_complaints_alone_are_shown_each_once_at_the_place_of_the_first(omc, daest, tmp_path):
    place = f"[{tmp_path / 'M.mo'}:3:3-3:9:writable] "
    complaint = place + 'Error: Type mismatch in binding of "x".\n'
    omc(
        "Warning: The initial conditions are not fully specified.\n"
        + NO_NETWORK * 20
        + complaint * 2
        + "Notification: Use of -d=bltdump tells more.\n"
    )
    code, _, err = daest("export", "M.mo", "--compiler", "omc", "-o", "m.fmu")
    assert code == 2 and err.splitlines()[1:3] == [complaint.strip(), "  --> M.mo:3:3"]


def test_of_the_log_of_the_c_compiler_the_errors_are_shown(omc, daest):
    log = "".join(f"[ {i}%] Building C object {i}.c.o\n" for i in range(60))
    omc(f"Error: Error building simulator. Build log: cmd\n{log}model.c:7:10: fatal error: no file\n{log}")
    code, _, err = daest("export", "M.mo", "--compiler", "omc", "-o", "m.fmu")
    assert code == 2 and "Building C object" not in err and "model.c:7:10: fatal error: no file" in err


@pytest.mark.parametrize(
    ("said", "code"),
    [("Error: Error building simulator. Log: ...", 0), ("Error: Too few equations", 2)],
)
def test_directional_derivatives_that_do_not_build_are_left_out(omc, daest, tmp_path, said, code):
    record = omc(said, always=False)
    assert daest("export", "M.mo", "--compiler", "omc", "-o", "m.fmu")[0] == code
    assert ("disableDirectionalDerivatives" in record.read_text()) == (code == 2)


def test_without_omc(omc, daest, monkeypatch, tmp_path):
    omc()
    monkeypatch.setenv("OMC", str(tmp_path / "nowhere"))
    code, _, err = daest("export", "M.mo", "--compiler", "omc")
    assert code == 2 and "omc-missing" in err and not (tmp_path / "M.fmu").exists()


def test_options_that_would_be_lost(omc, daest):
    omc()
    code, _, err = daest("export", "M.mo", "--compiler", "omc", "--platform", "win64")
    assert code == 2 and "omc-options" in err


def test_base_modelica_is_a_model_of_every_command(daest, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lag.bmo").write_text(
        "//! base 0.1.0\npackage 'Lag'\n  model 'Lag'\n    input Real 'u'(start = 0.0);\n"
        "    output Real 'motor.w';\n  equation\n    der('motor.w') = 'u' - 3.0 * 'motor.w';\n"
        "  end 'Lag';\nend 'Lag';\n"
    )
    code, out, _ = daest("linearize", "lag.bmo")
    assert code == 0 and "outputs: motor.w" in out and "u -> motor.w:  (1) / (s + 3)" in out
    code, _, err = daest("extend", "lag.bmo", "--effect", "Offset", "--at", "motor.w")
    assert code == 2 and "Base Modelica cannot be extended" in err


def test_an_fmu_is_no_source(omc, daest, tmp_path):
    omc()
    (tmp_path / "m.fmu").write_bytes(b"PK\x03\x04\xff")
    code, _, err = daest("export", "m.fmu", "--compiler", "omc", "-o", "n.fmu")
    assert code == 2 and "model-unknown-format" in err and not (tmp_path / "n.fmu").exists()
