"""Recordings as other tools write them: the same numbers out of every form."""

import importlib.util

import numpy as np
import pytest
import scipy.io

from daest.data.prepare import Preparation
from daest.data.read import Signal, read_experiments, read_table
from daest.errors import DataError

TIME = np.array([0.0, 0.5, 1.5, 2.0])
U = np.array([1.25, -2.5, 0.0, 1e-3])
PHI = np.array([180.0, -90.0, 45.5, 0.25])
INPUTS = [Signal("u", "V")]
OUTPUTS = [Signal("phi", "rad")]


def read(path, **options):
    return read_experiments([path], INPUTS, OUTPUTS, Preparation(), **options)[0]


def assert_plain(experiment):
    """The recording above, the angle having been in degrees."""
    assert experiment.time == pytest.approx(TIME)
    assert experiment.inputs[:, 0] == pytest.approx(U)
    assert experiment.outputs[:, 0] == pytest.approx(np.deg2rad(PHI))


def rows(separator=",", decimal="."):
    cells = [[repr(float(v)).replace(".", decimal) for v in row] for row in zip(TIME, U, PHI, strict=True)]
    return "".join(separator.join(row) + "\n" for row in cells)


HEAD = "time,u,phi [deg]\n"
FORMS = {
    "plain": HEAD + rows(),
    "decimal comma": HEAD.replace(",", ";") + rows(";", ","),
    "decimal comma and tab": HEAD.replace(",", "\t") + rows("\t", ","),
    "decimal comma in quotes": HEAD + '"' + rows('","', ",").replace("\n", '"\n"').rstrip('"'),
    "bar": HEAD.replace(",", "|") + rows("|"),
    "white space": "time  u  phi [deg]\n" + rows("   "),
    "units row": "time,u,phi\ns,V,deg\n" + rows(),
    "units row in brackets": "time,u,phi\n[s],[V],[deg]\n" + rows(),
    "units row with a gap": "time,u,phi\n(s),-,(deg)\n" + rows(),
    "quoted header": '"time","u","phi [deg]"\n' + rows(),
    "unit in round brackets": "time (s),u(V),phi (deg)\n" + rows(),
    "comments": "# Rig 7\n# 2026-11-21\n" + HEAD + "# start\n" + rows() + "# end\n",
    "header in a comment": "# made by savetxt\n# time u phi[deg]\n" + rows(" "),
    "percent": "% a\n" + HEAD + rows(),
    "lines above the header": "Recorder;4711\nOperator;\n\n" + HEAD.replace(",", ";") + rows(";"),
    "padded lines above the header": "Rate;100;\nName;Rig;7\n" + HEAD.replace(",", ";") + rows(";", ","),
    "Excel's first line": "sep=;\n" + HEAD.replace(",", ";") + rows(";", ","),
    "separator at the end": "time,u,phi [deg],\n" + rows().replace("\n", ",\n"),
    "separator at the end of rows": HEAD + rows().replace("\n", ",\n"),
    "carriage returns": (HEAD + rows()).replace("\n", "\r"),
    "milliseconds": "time_ms,u,phi [deg]\n"
    + "".join(f"{1000 * t},{u},{y}\n" for t, u, y in zip(TIME, U, PHI, strict=True)),
}


@pytest.mark.parametrize("form", FORMS)
def test_text(tmp_path, form):
    path = tmp_path / "run.csv"
    path.write_text(FORMS[form], newline="")
    assert_plain(read(path))


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "cp1252"])
def test_encodings(tmp_path, encoding):
    path = tmp_path / "run.csv"
    path.write_bytes((HEAD.replace("deg", "°") + rows()).encode(encoding))
    experiment = read(path)
    assert_plain(experiment)
    assert any("Windows-1252" in note for note in experiment.notes) == (encoding == "cp1252")


@pytest.mark.parametrize("raw", [b"time,u,phi\n0,1,2\n1,\x81,2\n", b"time,u,phi\n0,1,\x002\n", b"\xff\xfe0"])
def test_what_is_no_text(tmp_path, raw):
    path = tmp_path / "run.csv"
    path.write_bytes(raw)
    with pytest.raises(DataError) as caught:
        read(path)
    assert caught.value.code == "data-encoding"


BAD = {
    "unit twice": ("time,u,phi [rad]\ns,V,deg\n0,1,2\n1,1,2\n", "data-unit-twice", "'phi'"),
    "thousands": ("time;u;phi\n0;1.234,5;2\n1;1,5;2\n", "data-text", "1.234,5"),
    "thousands in quotes": ('time,u,phi\n0,"1,234",2\n1,"2,345",2\n', "data-text", "1,234"),
    "underscore": ("time,u,phi\n0,1_0,2\n1,1,2\n", "data-text", "1_0"),
    "names alone in a comment": ("# time,u\n0,1,2\n1,1,2\n", "data-no-header", ":2"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_not_guessed(tmp_path, name):
    text, code, words = BAD[name]
    path = tmp_path / "run.csv"
    path.write_text(text)
    with pytest.raises(DataError) as caught:
        read(path)
    assert caught.value.code == code and words in str(caught.value)


def test_how_a_file_was_read_is_said(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("Recorder;4711\ntime;u;phi\ns;V;deg\n" + rows(";", ","))
    notes = "; ".join(read(path).notes)
    assert "decimal comma" in notes and "1 line(s) above the header" in notes and "row below" in notes


@pytest.mark.parametrize("end", [",", ", ", ""])
@pytest.mark.parametrize("names", [",CH1,CH2", "x-axis,1,2", "time,CH1,CH2"])
def test_an_oscilloscope_names_its_channels_above_their_units(tmp_path, names, end):
    """Only rows of numbers end with a separator, and the first column has a unit of time for a name."""
    path = tmp_path / "scope.csv"
    numbers = [f"{k * 1e-3:.5e},{k % 2:.2e},{-k:.2e}{end}" for k in range(-3, 9)]
    path.write_text("\n".join([names, "Second,Volt,Volt", *numbers]) + "\n")
    table = read_table(path)
    assert [c.name for c in table.columns] == [names.split(",")[0] or "time", *names.split(",")[1:]]
    assert [c.unit for c in table.columns] == ["Second", "Volt", "Volt"]
    assert [len(c.values) for c in table.columns] == [12, 12, 12] and table.columns[0].values[0] == -3e-3


def test_missing_values_have_several_spellings(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("time,u,phi\n0,1,NaN\n1,1,NA\n2,1,\n3,1,null\n4,1,2\n")
    assert np.isnan(read(path).outputs[:, 0]).tolist() == [True, True, True, True, False]


@pytest.mark.parametrize(
    "stamps",
    [
        ("2026-11-21T08:00:00", "2026-11-21T08:00:00.5", "2026-11-21T08:00:01.5", "2026-11-21T08:00:02"),
        ("2026-11-21 23:59:59Z", "2026-11-21 23:59:59.5Z", "2026-11-22 00:00:00.5Z", "2026-11-22 00:00:01Z"),
        ("08:00:00", "08:00:00.5", "08:00:01.5", "08:00:02"),
        ("23:59:59", "23:59:59.5", "00:00:00.5", "00:00:01"),
        ("31.12.2026 23:59:59", "31.12.2026 23:59:59.5", "1.1.2027 0:00:00.5", "1.1.2027 0:00:01"),
        (
            "3/9/2026 11:59:59 AM",
            "3/9/2026 11:59:59.5 AM",
            "3/9/2026 12:00:00.5 PM",
            "3/9/2026 12:00:01 p.m.",
        ),
        ("02/28/26 23:59:59", "02/28/26 23:59:59.5", "03/01/26 0:00:00.5", "03/01/26 0:00:01"),
        ("2026/11/21 08:00:00", "2026/11/21 08:00:00.5", "2026/11/21 08:00:01.5", "2026/11/21 08:00:02"),
    ],
)
def test_dates_are_times(tmp_path, stamps):
    path = tmp_path / "run.csv"
    values = zip(stamps, U, PHI, strict=True)
    path.write_text("time,u,phi [deg]\n" + "".join(f"{t},{u},{y}\n" for t, u, y in values))
    assert_plain(read(path))


def test_days_and_months_that_may_be_either_are_refused(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("time,u,phi [deg]\n1/2/2026,1,1\n1/3/2026,1,1\n1/4/2026,1,1\n")
    with pytest.raises(DataError) as caught:
        read(path)
    assert "dates such as 2026-11-21 08:15:00" in str(caught.value)


def test_the_time_may_have_another_name(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text("t [min],u,phi [deg]\n" + rows())
    experiment = read(path, time="t")
    assert experiment.time == pytest.approx(60 * TIME) and experiment.extra == {}
    with pytest.raises(DataError) as caught:
        read(path, time="tt")
    assert caught.value.code == "data-unknown-column" and "did you mean t?" in str(caught.value)


def test_matlab_matrices_and_odd_lengths_are_told(tmp_path):
    path = tmp_path / "run.mat"
    scipy.io.savemat(path, {"data": np.ones((30, 4)), "note": "text"})
    with pytest.raises(DataError) as caught:
        read_table(path)
    assert caught.value.what == "the MATLAB file holds no numeric vector, but data (30 x 4)"
    assert "time = data(:, 1)" in caught.value.remedy
    time = 0.1 * np.arange(30)
    scipy.io.savemat(path, {"time": time, "y": time, "u": time[:-2]})
    with pytest.raises(DataError) as caught:
        read_experiments([path], [Signal("u", "V")], [Signal("y", "V")])
    assert caught.value.what == "'u' for that input is no column: it has 28 values, where most have 30"


def test_matlab_version_7_3(tmp_path):
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "run.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        group = file.create_group("log")
        for name, values in (("time", TIME), ("u", U), ("phi", np.deg2rad(PHI))):
            group.create_dataset(name, data=values[None, :])
        file.create_dataset("gain", data=[[3.0]])
        file.create_dataset("#refs#/a", data=TIME)
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    assert_plain(read(path))


@pytest.mark.parametrize(("suffix", "start"), [(".mat", b"\x89HDF\r\n\x1a\n"), (".xlsx", b"PK\x03\x04")])
def test_damaged_archives(tmp_path, suffix, start):
    path = tmp_path / f"run{suffix}"
    path.write_bytes(start + bytes(600))
    with pytest.raises(DataError) as caught:
        read(path)
    assert caught.value.code == "data-unreadable-file"


@pytest.mark.parametrize(
    ("module", "name", "head", "code"),
    [
        ("h5py", "run.mat", b"\x89HDF\r\n\x1a\n", "data-needs-h5py"),
        ("openpyxl", "run.xlsx", b"P", "data-needs-openpyxl"),
    ],
)
def test_what_to_install(tmp_path, monkeypatch, module, name, head, code):
    monkeypatch.setitem(__import__("sys").modules, module, None)
    (tmp_path / name).write_bytes(head)
    with pytest.raises(DataError) as caught:
        read(tmp_path / name)
    assert caught.value.code == code and "pip install" in str(caught.value)


def result_file(path, names, units, transposed):
    """A result as Modelica tools write it (layout of the Dymola user manual): phi as alias of -q."""
    info = np.array([[0, 2, 2, 2, 1], [1, 2, 3, -3, 2], [0, 0, 0, 0, 0], [-1, -1, -1, -1, 0]])
    data_2 = np.array([TIME, U, -np.deg2rad(PHI)])
    # The event at 0.5 s stands twice: before it and after it.
    data_2 = np.insert(data_2, 1, [0.5, 9.0, 9.0], axis=1)
    data_1 = np.array([[0.0, 2.0], [7.0, 7.0]])

    def texts(words):
        width = max(map(len, words))
        grid = np.array([list(word.ljust(width)) for word in words])
        # scipy writes characters in the order of the memory.
        return np.ascontiguousarray(grid.T) if transposed else grid

    aclass = ["Atrajectory", "1.1", "", "binTrans" if transposed else "binNormal"]
    width = max(map(len, aclass))
    content = {
        "Aclass": np.array([list(word.ljust(width)) for word in aclass]),
        "name": texts(names),
        "description": texts(units),
        "dataInfo": info if transposed else info.T,
        "data_1": data_1 if transposed else data_1.T,
        "data_2": data_2 if transposed else data_2.T,
    }
    scipy.io.savemat(path, content, format="4")


@pytest.mark.parametrize("transposed", [True, False])
def test_result_of_a_modelica_tool(tmp_path, transposed):
    path = tmp_path / "Servo_res.mat"
    units = ["Time in [s]", "Voltage [V]", "", "Angle [rad|deg]", "a parameter [1]"]
    result_file(path, ["time", "u", "q", "phi", "gain"], units, transposed)
    experiment = read(path)
    assert_plain(experiment)
    assert list(experiment.extra) == ["q"] and any("events" in note for note in experiment.notes)


def test_damaged_result(tmp_path):
    path = tmp_path / "Servo_res.mat"
    result_file(path, ["time", "u"], ["", ""], True)
    content = scipy.io.loadmat(path, chars_as_strings=False)
    content["dataInfo"][1, :] = 40
    scipy.io.savemat(path, {k: v for k, v in content.items() if not k.startswith("__")}, format="4")
    with pytest.raises(DataError) as caught:
        read(path)
    assert caught.value.code == "data-unreadable-file"


@pytest.mark.skipif(importlib.util.find_spec("openpyxl") is None, reason="openpyxl is not installed")
def test_excel(tmp_path):
    import openpyxl

    book = openpyxl.Workbook()
    book.active.title = "Notes"
    sheet = book.create_sheet("Run")
    sheet.append(["Recorded by", "me"])
    sheet.append(["time", "u", "phi"])
    sheet.append(["s", "V", "deg"])
    for row in zip(TIME, U, PHI, strict=True):
        sheet.append(list(map(float, row)))
    book.save(tmp_path / "run.xlsx")
    experiment = read(tmp_path / "run.xlsx")
    assert_plain(experiment)
    assert any("sheet 'Run'" in note for note in experiment.notes)


def test_frames(tmp_path):
    pd = pytest.importorskip("pandas")
    frame = pd.DataFrame({"time": TIME, "u": U, "phi [deg]": PHI})
    assert_plain(read(frame))
    assert_plain(read(frame.set_index("time")))
    dated = frame.set_index(pd.Timestamp("2026-11-21") + pd.to_timedelta(TIME, unit="s"))
    assert_plain(read(dated.drop(columns="time")))
    objects = frame.astype(object)
    objects.loc[2, "phi [deg]"] = None
    assert np.isnan(read(objects).outputs[2, 0])
    both = read_experiments([frame, frame], INPUTS, OUTPUTS)
    assert [experiment.name for experiment in both] == ["data 1", "data 2"]
    with pytest.raises(DataError) as caught:
        read(frame.rename(columns={"u": "v"}))
    assert caught.value.code == "data-unknown-column" and "data 1" in str(caught.value)


def test_datasets():
    xr = pytest.importorskip("xarray")
    data = xr.Dataset({"u": ("time", U), "phi": ("time", PHI, {"units": "deg"})}, {"time": TIME})
    assert_plain(read(data))
    dated = data.assign_coords(time=np.datetime64("2026-11-21") + (1e3 * TIME).astype("timedelta64[ms]"))
    assert_plain(read(dated))
    with pytest.raises(DataError) as caught:
        read(data.expand_dims("run"))
    assert caught.value.code == "data-frame"
