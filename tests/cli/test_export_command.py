"""`daest export`, and other commands on the exported FMU."""

import json
import zipfile

import pytest
from lag_data import TRUE

from daest.errors import FmuError
from daest.numerics.compiler import find_compiler


@pytest.fixture(autouse=True)
def compiler():
    try:
        find_compiler()
    except FmuError as error:
        pytest.skip(str(error))


def test_fmu_is_written_and_described(folder, daest):
    code, out, _ = daest("export", "Lag.mo", "--format", "json")
    document = json.loads(out)
    assert code == 0 and document["schema"] == "daest/export/1"
    assert document["path"] == "Lag.fmu" and document["validation"] == []
    assert document["inputs"] == ["u"] and document["outputs"] == ["y"] and document["states"] == ["x"]
    assert "modelDescription.xml" in zipfile.ZipFile(folder / "Lag.fmu").namelist()
    code, out, _ = daest("export", "Lag.mo", "-o", "other.fmu", "--set", "T=0.7")
    assert code == 0 and "wrote other.fmu" in out and "validator: no message" in out


def test_identify_reads_the_equations_from_the_fmu(folder, daest):
    assert daest("export", "Lag.mo")[0] == 0
    code, out, _ = daest("identify", "run1.csv", "--model", "Lag.fmu", "--hold", "zoh", "--format", "json")
    found = json.loads(out)["parameters"]
    assert code == 0
    for name, true in TRUE.items():
        assert abs(found[name]["value"] - true) < 4 * found[name]["std_error"]


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["Lag.mo", "-o", "-"], "export-to-stdout"),
        (["Lag.mo", "-o", "Lag.txt"], "export-suffix"),
        (["Lag.mo", "--platform", "amiga"], "fmu-platform-unknown"),
        (["Lag.mo", "-o", "Lag.mo"], "output-is-input"),
        (["Lag.mo", "--set", "z=1"], "parameter-unknown"),
        (["Nothing.mo"], "model-missing"),
    ],
)
def test_refusals(folder, daest, arguments, code):
    before = sorted(path.name for path in folder.iterdir())
    status, out, err = daest("export", *arguments)
    assert status == 2 and out == "" and f"error[{code}]" in err and "help: " in err
    assert sorted(path.name for path in folder.iterdir()) == before
