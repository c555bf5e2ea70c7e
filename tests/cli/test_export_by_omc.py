"""`daest export --compiler omc`, against a program that writes down what it was asked for: no OpenModelica is
needed. What it makes of real models is not tested here."""

import sys
from pathlib import Path

import pytest

MODEL = "model M\n  input Real u(start = 0);\n  Real x;\nequation\n  der(x) = u - x;\nend M;\n"

FAKE = """#!{python}
import pathlib, sys
script = pathlib.Path(sys.argv[1]).read_text()
pathlib.Path({record!r}).write_text(script)
if {fails}:
    print('Error: class M not found in scope')
    sys.exit({status})
is_fmu = 'fileNamePrefix="model"' in script
pathlib.Path('model.fmu' if is_fmu else 'model.bmo').write_text('an FMU' if is_fmu else "package 'M'")
"""


@pytest.fixture
def omc(tmp_path, monkeypatch):
    """Puts a fake omc in place; returns a function (fails, status) -> file that will hold the script."""

    def install(fails: bool = False, status: int = 0) -> Path:
        record, program = tmp_path / "asked.mos", tmp_path / "bin" / "omc"
        program.parent.mkdir(exist_ok=True)
        text = FAKE.format(python=sys.executable, record=str(record), fails=fails, status=status)
        program.write_text(text)
        program.chmod(0o755)
        monkeypatch.setenv("OMC", str(program))
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
    assert lines[0] == f'setModelicaPath("{tmp_path / "my libs"}" + ":" + getModelicaPath());'
    assert lines[1] == f'loadFile("{tmp_path / "M.mo"}");'
    assert lines[3] == 'buildModelFMU(M, version="2.0", fmuType="me", fileNamePrefix="model");'
    assert lines[-1] == "getErrorString();"


def test_base_modelica(omc, daest, tmp_path):
    record = omc()
    assert daest("export", "M.mo", "--compiler", "omc", "-o", "m.bmo")[0] == 0
    assert (tmp_path / "m.bmo").read_text() == "package 'M'"
    assert 'setCommandLineOptions("--baseModelica");' in record.read_text()


@pytest.mark.parametrize("status", [0, 1])
def test_its_complaint_is_shown_and_nothing_is_written(omc, daest, tmp_path, status):
    omc(fails=True, status=status)
    (tmp_path / "m.fmu").write_text("mine")
    code, _, err = daest("export", "M.mo", "--compiler", "omc", "-o", "m.fmu")
    assert code == 2 and "omc-failed" in err and "class M not found" in err
    assert (tmp_path / "m.fmu").read_text() == "mine"


def test_without_omc(omc, daest, monkeypatch, tmp_path):
    omc()
    monkeypatch.setenv("OMC", str(tmp_path / "nowhere"))
    code, _, err = daest("export", "M.mo", "--compiler", "omc")
    assert code == 2 and "omc-missing" in err and not (tmp_path / "M.fmu").exists()


def test_options_that_would_be_lost(omc, daest):
    omc()
    code, _, err = daest("export", "M.mo", "--compiler", "omc", "--platform", "win64")
    assert code == 2 and "omc-options" in err
