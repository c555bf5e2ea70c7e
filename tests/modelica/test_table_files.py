"""Tables in files: what is read of them, and models that name them as those of the Standard Library do."""

import re
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from scipy.interpolate import RegularGridInterpolator

from daest.errors import ModelError
from daest.modelica.compile import compile_text
from daest.modelica.forms.dialect import adapted
from daest.modelica.language.table_files import Folders, TableFileError, read_table
from daest.systems.simulation.simulate import simulate

TEXT = """#1
# two tables
double torque(4,3)   # rows of speed
  0  0    1
  1, 2.5; 3
  2 1e-1  5  # of the third
  3 0 7
float map(3, 3)
0 1 2
1 10 20 3 30 50
"""
TORQUE = [[0, 0, 1], [1, 2.5, 3], [2, 0.1, 5], [3, 0, 7]]
MAP = [[0, 1, 2], [1, 10, 20], [3, 30, 50]]


def write(folder: Path, name: str, text: str = TEXT) -> Path:
    (folder / name).write_text(text)
    return folder / name


def test_text(tmp_path):
    file = write(tmp_path, "tables.txt")
    assert read_table(file, "torque").tolist() == TORQUE
    assert read_table(file, "map").tolist() == MAP


def test_csv_and_matlab(tmp_path):
    file = write(tmp_path, "one.csv", "speed;torque\n0;1\n2;3\n")
    assert read_table(file, "any", ";", 1).tolist() == [[0, 1], [2, 3]]
    for version in ("4", "5"):
        scipy.io.savemat(tmp_path / "two.mat", {"torque": np.array(TORQUE)}, format=version)
        assert read_table(tmp_path / "two.mat", "torque").tolist() == TORQUE


@pytest.mark.parametrize(
    ("name", "text", "said", "remedy"),
    [
        ("a.txt", TEXT, "there is no table `speed`", "torque, map"),
        ("a.txt", "", "there is no table `speed`", "begins with"),
        ("a.txt", "double speed(2,2)\n1 2\n3", "has 3 numbers for 2 x 2", "size"),
        ("a.txt", "double speed(2,2)\n1 2\n3\nfloat b(1,1)\n4\n", "has 3 numbers for 2 x 2", "size"),
        ("a.txt", "double speed(2,2)\n1 2\n3 x\n", "line 3: could not convert", "numbers"),
        ("a.txt", "double speed(1,2)\n1 nan\n", "no numbers", "gaps"),
        ("a.csv", "a,b\n1,2\n", "could not convert", "nHeaderLines"),
        ("a.mat", "no such thing", "MATLAB", "anew"),
        ("", "", "is a folder", "file"),
        ("missing.txt", None, "does not exist", "beside the file of the model"),
    ],
)
def test_what_cannot_be_read_is_told(tmp_path, name, text, said, remedy):
    if text and name:
        write(tmp_path, name, text)
    elif name == "a.txt":
        write(tmp_path, name, "")
    with pytest.raises(TableFileError, match=re.escape(said)) as caught:
        read_table(tmp_path / name, "speed")
    assert remedy in caught.value.remedy


def test_names_of_files(tmp_path):
    folders = Folders(tmp_path, (("Lib", tmp_path / "lib"),))
    assert folders.file("a/b.txt") == tmp_path / "a" / "b.txt"
    assert folders.file("modelica://Lib/Resources/b.txt") == tmp_path / "lib" / "Resources" / "b.txt"
    with pytest.raises(TableFileError, match="library of `modelica://Other"):
        folders.file("modelica://Other/b.txt")


# As the tables of the Standard Library call their C code.
LIBRARY = {
    "package.mo": "package Modelica\nend Modelica;\n",
    "Blocks/package.mo": "within Modelica;\npackage Blocks\nend Blocks;\n",
    "Utilities.mo": """within Modelica;
package Utilities
  package Files
    function loadResource input String uri; output String file;
    external "C" file = Load(uri); end loadResource;
  end Files;
  package Strings
    function length input String string; output Integer result;
    external "C" result = Length(string); end length;
    function findLast input String string; input String searchString; input Integer startIndex = 0;
      input Boolean caseSensitive = true; output Integer index;
    algorithm index := 0; while index < 3 loop index := index + 1; end while; end findLast;
  end Strings;
end Utilities;
""",
    "Blocks/Types.mo": """within Modelica.Blocks;
package Types
  class ExternalCombiTable1D extends ExternalObject;
    function constructor input String tableName; input String fileName; input Real table[:, :];
      input Integer columns[:]; input Integer smoothness; input Integer extrapolation;
      input Boolean verboseRead = true; input String delimiter = ","; input Integer nHeaderLines = 0;
      output ExternalCombiTable1D externalTable;
    external "C" externalTable = ModelicaStandardTables_CombiTable1D_init(tableName); end constructor;
    function destructor input ExternalCombiTable1D externalTable;
    external "C" ModelicaStandardTables_CombiTable1D_close(externalTable); end destructor;
  end ExternalCombiTable1D;
  class ExternalCombiTable2D extends ExternalObject;
    function constructor input String tableName; input String fileName; input Real table[:, :];
      input Integer smoothness; input Integer extrapolation;
      input Boolean verboseRead = true; input String delimiter = ","; input Integer nHeaderLines = 0;
      output ExternalCombiTable2D externalTable;
    external "C" externalTable = ModelicaStandardTables_CombiTable2D_init(tableName); end constructor;
    function destructor input ExternalCombiTable2D externalTable;
    external "C" ModelicaStandardTables_CombiTable2D_close(externalTable); end destructor;
  end ExternalCombiTable2D;
end Types;
""",
    "Blocks/Tables.mo": """within Modelica.Blocks;
package Tables
  function getTable1DValue input Types.ExternalCombiTable1D tableID; input Integer icol; input Real u;
    output Real y;
  external "C" y = ModelicaStandardTables_CombiTable1D_getValue(tableID, icol, u); end getTable1DValue;
  function getTable2DValue input Types.ExternalCombiTable2D tableID; input Real u1; input Real u2;
    output Real y;
  external "C" y = ModelicaStandardTables_CombiTable2D_getValue(tableID, u1, u2); end getTable2DValue;
  block Table1D
    parameter Boolean tableOnFile = false;
    parameter Real table[:, :] = fill(0.0, 0, 2);
    parameter String tableName = "NoName"; parameter String fileName = "NoName";
    parameter Integer columns[:] = {2}; parameter Integer extrapolation = 2;
    Real u; Real y;
    final parameter Boolean isCsvExt = if tableOnFile then
      Modelica.Utilities.Strings.findLast(fileName, ".csv", caseSensitive=false) + 3
      == Modelica.Utilities.Strings.length(fileName) else false;
  protected
    parameter Types.ExternalCombiTable1D tableID = Types.ExternalCombiTable1D(
      if tableOnFile then if isCsvExt then "Values" else tableName else "NoName",
      if tableOnFile and fileName <> "NoName"
        and not Modelica.Utilities.Strings.isEmpty(fileName) then fileName else "NoName",
      table, columns, 1, extrapolation);
  equation
    y = getTable1DValue(tableID, 1, u);
  end Table1D;
  block Table2D
    parameter String tableName = "NoName"; parameter String fileName = "NoName";
    parameter Integer extrapolation = 2;
    Real u1; Real u2; Real y;
  protected
    parameter Types.ExternalCombiTable2D tableID =
      Types.ExternalCombiTable2D(tableName, fileName, fill(0.0, 0, 2), 1, extrapolation);
  equation
    y = getTable2DValue(tableID, u1, u2);
  end Table2D;
end Tables;
""",
}


def run(folder: Path, declarations: str, time: np.ndarray):
    libraries = folder / "libraries"
    for name, content in {**LIBRARY, "Resources/tables.txt": TEXT}.items():
        (libraries / "Modelica" / name).parent.mkdir(parents=True, exist_ok=True)
        write(libraries / "Modelica", name, content)
    text = f"model M\n  output Real y;\n{declarations}\nend M;\n"
    flat = compile_text(text.encode(), folder / "M.mo", None, [libraries])
    return simulate(flat, (time, np.zeros((time.size, 0)))).outputs[:, 0]


TIME = np.linspace(0, 4, 33)


@pytest.mark.parametrize(
    "file",
    ['"tables.txt"', 'Modelica.Utilities.Files.loadResource("modelica://Modelica/Resources/tables.txt")'],
)
def test_a_curve_from_a_file(tmp_path, file):
    write(tmp_path, "tables.txt")
    found = run(
        tmp_path,
        f'  Modelica.Blocks.Tables.Table1D t(tableOnFile = true, tableName = "torque", columns = {{3}},\n'
        f"    fileName = {file});\nequation\n  t.u = time;\n  y = t.y;",
        TIME,
    )
    assert found == pytest.approx(1 + 2 * TIME, abs=1e-9)


@pytest.mark.parametrize("extrapolation", [1, 2])
def test_a_surface_from_a_file(tmp_path, extrapolation):
    write(tmp_path, "tables.txt")
    found = run(
        tmp_path,
        f'  Modelica.Blocks.Tables.Table2D t(tableName = "map", fileName = "tables.txt",\n'
        f"    extrapolation = {extrapolation});\n"
        "equation\n  t.u1 = time;\n  t.u2 = 0.5 + time/2;\n  y = t.y;",
        TIME,
    )
    known = RegularGridInterpolator(
        ([1, 3], [1, 2]), [[10, 20], [30, 50]], bounds_error=False, fill_value=None
    )
    points = np.c_[TIME, 0.5 + TIME / 2]
    if extrapolation == 1:
        points = np.c_[np.clip(points[:, 0], 1, 3), np.clip(points[:, 1], 1, 2)]
    assert found == pytest.approx(known(points), abs=1e-9)


def test_a_missing_file_is_told_with_the_place_of_the_table(tmp_path):
    with pytest.raises(ModelError) as caught:
        run(
            tmp_path,
            '  Modelica.Blocks.Tables.Table2D t(tableName = "map", fileName = "no.txt");\n'
            "equation\n  t.u1 = time;\n  t.u2 = 1;\n  y = t.y;",
            TIME,
        )
    assert caught.value.code == "model-table-file" and "no.txt does not exist" in caught.value.what
    assert caught.value.where.file.endswith("Tables.mo")


def test_a_function_and_a_condition_of_the_user_mean_what_they_say(compiled):
    """Names as the library has them: nothing of the user's own text is left out."""
    text = (
        "model M\n  function find\n    input Real x;\n    output Real y;\n  algorithm\n    y := 2*x;\n"
        "  end find;\n  Real x = time;\n  output Real y = find(x);\nend M;"
    )
    assert simulate(compiled(text), (TIME, np.zeros((TIME.size, 0)))).outputs[:, 0] == pytest.approx(2 * TIME)
    condition = b"if useFile and not Modelica.Utilities.Strings.isEmpty(fileName) then 1 else 2"
    assert adapted(condition) == condition
