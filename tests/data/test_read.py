"""Reading recordings: values, units and times against what was written; every kind of bad file has its
message."""

import numpy as np
import pytest
import scipy.io

from daest.data.prepare import Preparation
from daest.data.read import Signal, measured_names, read_experiments, read_table, select_outputs
from daest.data.stream import line_format
from daest.data.table import Part
from daest.errors import ConfigError, DataError

U = Signal("u", "V")
PHI = Signal("phi", "rad")
OMEGA = Signal("omega", "rad/s")


def write(tmp_path, text, name="run.csv"):
    path = tmp_path / name
    path.write_text(text)
    return path


def read(path, inputs=(U,), outputs=(PHI,), **options):
    return read_experiments([path], inputs, outputs, Preparation(**options))[0]


def error_of(path, inputs=(U,), outputs=(PHI,), **options):
    with pytest.raises(DataError) as caught:
        read(path, inputs, outputs, **options)
    return caught.value


def test_files_of_the_same_name_are_told_apart(tmp_path):
    paths = []
    for part in ("a", "b", "c"):
        (tmp_path / part).mkdir()
        name = "run.csv" if part != "c" else "other.csv"
        paths.append(write(tmp_path / part, "time,u,phi\n0,1,2\n1,2,3\n", name))
    names = [experiment.name for experiment in read_experiments(paths, [U], [PHI])]
    assert names == [str(paths[0]), str(paths[1]), "other"]


def test_values_units_and_missing_samples(tmp_path):
    path = write(tmp_path, "time [ms],u [mV],phi [deg],note\n0,1000,180,a\n10,2000,,b\n30,3000,-90,c\n")
    experiment = read(path)
    assert experiment.time == pytest.approx([0.0, 0.01, 0.03], rel=1e-12)
    assert experiment.inputs[:, 0] == pytest.approx([1.0, 2.0, 3.0], rel=1e-12)
    assert experiment.outputs[[0, 2], 0] == pytest.approx([np.pi, -np.pi / 2], rel=1e-12)
    assert np.isnan(experiment.outputs[1, 0])
    assert experiment.period is None and experiment.extra == {}
    assert any("phi [deg]" in note and "rad" in note for note in experiment.notes)
    assert any("1 of 3 samples are missing" in note for note in experiment.notes)


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_separators_blank_lines_and_byte_order_mark(tmp_path, separator):
    text = "\ufefftime_s,u,phi\r\n0,1,2\r\n\r\n1,3,4\r\n\r\n".replace(",", separator)
    experiment = read(write(tmp_path, text))
    assert experiment.time.tolist() == [0.0, 1.0]
    assert experiment.outputs[:, 0].tolist() == [2.0, 4.0]


def test_mapping_extra_columns_and_array_names(tmp_path):
    path = write(tmp_path, "time,motor_force_N,x[1],T[degC],wind\n0,1,5,20,7\n1,2,6,21,8\n")
    inputs = [Signal("f", "N", "motor_force_N")]
    outputs = [Signal("x[1]", "m"), Signal("T", "K"), Signal("unseen", "m")]
    experiment = read(path, inputs, outputs)
    assert experiment.inputs[:, 0].tolist() == [1.0, 2.0]
    assert experiment.outputs[:, 0].tolist() == [5.0, 6.0]
    assert experiment.outputs[:, 1] == pytest.approx([293.15, 294.15])
    assert np.isnan(experiment.outputs[:, 2]).all()
    assert list(experiment.extra) == ["wind"]
    assert measured_names([experiment]) == ("x[1]", "T")
    only = select_outputs(experiment, ["T"])
    assert only.output_names == ("T",) and only.outputs.shape == (2, 1) and "x[1]" in only.extra


def test_a_minus_before_a_column_turns_its_sign(tmp_path):
    path = write(tmp_path, "time,u,T_wall [degC],drag\n0,1,20,7\n1,2,21,8\n")
    inputs, outputs = [Signal("u", "V", "-u")], [Signal("T", "K", "T_wall"), Signal("f", "N", "- drag")]
    (experiment,) = read_experiments([path], inputs, outputs, others=False)
    assert experiment.inputs[:, 0].tolist() == [-1.0, -2.0]
    assert experiment.outputs[:, 1].tolist() == [-7.0, -8.0]
    assert experiment.outputs[:, 0] == pytest.approx([293.15, 294.15])
    assert any("'u' with its sign turned" in note for note in experiment.notes)
    line = line_format("time,u,T_wall [degC],drag", "stdin", inputs, outputs)
    sample = line.sample("0,1,20,7", 2)
    assert sample.inputs.tolist() == [-1.0] and sample.outputs.tolist() == [293.15, -7.0]


def test_mat_file_with_struct(tmp_path):
    time = np.arange(5) * 0.1
    path = tmp_path / "run.mat"
    scipy.io.savemat(path, {"log": {"time": time, "u": time**2, "phi": -time}, "gain": 3.0, "title": "a run"})
    experiment = read(path)
    assert experiment.inputs[:, 0] == pytest.approx(time**2)
    assert experiment.outputs[:, 0] == pytest.approx(-time)
    assert experiment.period == pytest.approx(0.1)


def test_parquet_file_or_what_to_install(tmp_path):
    path = tmp_path / "run.parquet"
    try:
        import pandas as pd
    except ImportError:
        path.write_bytes(b"PAR1")
        assert error_of(path).code == "data-needs-pyarrow"
        return
    pd.DataFrame({"time": [0.0, 1.0], "u [mV]": [1.0, 2.0], "phi": [3.0, np.nan]}).to_parquet(path)
    experiment = read(path)
    assert experiment.inputs[:, 0] == pytest.approx([1e-3, 2e-3])
    assert np.isnan(experiment.outputs[1, 0])
    table = read_table(path, Part(("phi",)))
    assert [column.name for column in table.columns] == ["time", "phi"]


BAD_FILES = [
    ("", "data-empty-file", "empty"),
    ("\n\n", "data-empty-file", "empty"),
    (",,\n,,\n", "data-empty-file", "empty"),
    ("0,1,2\n1,2,3\n", "data-no-header", ":1"),
    ("t,u,phi\n0,1,2\n1,2,3\n", "data-no-time", "t, u, phi"),
    ("time,time_ms,u,phi\n0,0,1,2\n1,1,2,3\n", "data-two-time-columns", "time, time_ms"),
    ("time,u,phi\n0,1,2\n2,1,2\n1,1,2\n", "data-time-not-increasing", ":4"),
    ("time,u,phi\n0,1,2\n0,1,2\n1,1,2\n", "data-time-duplicate", ":3"),
    ("time,u,phi\n0,1,2\n,1,2\n1,1,2\n", "data-time-missing", ":3:1"),
    ("time,u,u,phi\n0,1,2,3\n1,1,2,3\n", "data-duplicate-column", "'u'"),
    ("time,U,phi\n0,1,2\n1,1,2\n", "data-unknown-column", "did you mean U?"),
    ("time,u,angle\n0,1,2\n1,1,2\n", "data-no-output", "angle"),
    ("time,u,phi\n0,1,2\n1,1,n.a.\n", "data-text", ":3:3"),
    ("time,u,phi\n0,1,2\n1,\"1,5\",3\n", "data-text", "'1,5'"),
    ("time,u [A],phi\n0,1,2\n1,1,2\n", "unit-incompatible", "'u' [V]"),
    ("time,u [wobble],phi\n0,1,2\n1,1,2\n", "unit-unknown", "wobble"),
    ("time,u,phi\n0,,2\n1,1,2\n", "data-input-gap", ":2:2"),
    ("time,u,phi\n0,1,inf\n1,1,2\n", "data-infinite", ":2:3"),
    ("time,u,phi\n0,1,2\n1,1\n", "data-ragged-row", ":3"),
    ("time,u,phi\n0,1,2\n", "data-too-few-rows", "1 row"),
    ("time,u,phi\n", "data-too-few-rows", "0 row"),
    ("hello world\n", "data-no-time", "hello world"),
    ("time,u,phi\n0,1,\n1,1,\n", "data-all-missing", "phi"),
]  # fmt: skip


@pytest.mark.parametrize(("text", "code", "mentions"), BAD_FILES, ids=[bad[1] for bad in BAD_FILES])
def test_bad_file(tmp_path, text, code, mentions):
    path = write(tmp_path, text)
    error = error_of(path)
    assert error.code == code
    assert mentions in str(error)
    assert "run.csv" in str(error)
    assert "help: " in str(error)


def test_all_problems_of_a_file_at_once(tmp_path):
    path = write(tmp_path, "time,u [A],phi,omega\n0,1,x,1\n1,2,y,2\n2,3,4,5\n")
    message = str(error_of(path, outputs=(PHI, Signal("speed", "rad/s", "omeg"))))
    assert "several-problems" in message
    assert "4 problems" in message
    assert "run.csv:2:3" in message and "run.csv:3:3" in message
    assert "unit-incompatible" in message
    assert "did you mean omega?" in message


def test_missing_file_names_the_nearest(tmp_path):
    write(tmp_path, "time,u\n0,1\n1,1\n", "run1.csv")
    error = error_of(tmp_path / "run2.csv")
    assert error.code == "data-missing-file" and "run1.csv" in error.remedy
    assert error_of(tmp_path).code == "data-missing-file"
    assert error_of(write(tmp_path, "x", "run.docx")).code == "data-unknown-format"


def test_damaged_mat_file(tmp_path):
    path = tmp_path / "run.mat"
    path.write_bytes(b"not a mat file at all" * 20)
    assert error_of(path).code == "data-unreadable-file"


def test_window_is_cut_before_gaps_are_judged(tmp_path):
    path = write(tmp_path, "time,u,phi\n0,,1\n0.1,1,2\n0.2,2,3\n0.3,3,4\n")
    experiment = read(path, start=0.1, stop=0.2)
    assert experiment.time == pytest.approx([0.1, 0.2])
    assert experiment.outputs[:, 0].tolist() == [2.0, 3.0]
    assert error_of(path, start=5.0).code == "data-window-empty"


def test_what_is_added_to_temperatures_is_said(tmp_path):
    """Degrees above a room, which a model has in K, are no degrees Celsius."""
    path = write(tmp_path, "time,u,T [degC],v [mV]\n0,1,0,7\n1,2,3,8\n2,2,4,9\n")
    experiment = read(path, outputs=(Signal("T", "K"), Signal("v", "V")))
    assert experiment.outputs[0, 0] == pytest.approx(273.15)
    heat, voltage = (note for note in experiment.notes if "converted" in note)
    assert heat.endswith("converted to K, 273.15 added (a difference of temperatures is in K)")
    assert voltage.endswith("converted to V")


def test_rounded_time_stamps_are_uniform_but_jitter_is_kept(tmp_path):
    rounded = "".join(f"{k * 0.001 + 3e-8 * (k % 3):.9f},{k},{k}\n" for k in range(50))
    assert read(write(tmp_path, "time,u,phi\n" + rounded)).period == pytest.approx(0.001, rel=1e-6)
    uneven = "".join(f"{k * 0.001 + 3e-5 * (k % 3):.9f},{k},{k}\n" for k in range(50))
    assert read(write(tmp_path, "time,u,phi\n" + uneven)).period is None


def test_long_recording_is_read_whole(shared_data):
    signals = [Signal("f", "N", "motor_force_N")], [Signal("x", "mm", "position_m")]
    experiment = read(shared_data / "emps" / "train.csv", *signals)
    assert experiment.n_samples == 24841
    assert experiment.period == pytest.approx(1e-3)


def test_options_out_of_range():
    for options in ({"period": 0.0}, {"period": float("nan")}, {"split": 1.0}, {"split": 0.0}):
        with pytest.raises(ConfigError):
            Preparation(**options)


@pytest.mark.parametrize(("row", "to"), [(301, 1), (301, -1)])
def test_a_row_with_the_time_of_its_neighbour_beside_a_gap_is_put_into_it(tmp_path, row, to):
    """As a recorder writes that comes late once."""
    time = np.round(np.arange(1000) * 0.01, 3)
    wrong = time.copy()
    wrong[row] = time[row + to]
    path = tmp_path / "run.csv"
    np.savetxt(path, np.column_stack([wrong, time, time]), delimiter=",", header="time,u,phi", comments="")
    experiment = read(path)
    np.testing.assert_allclose(experiment.time, time, atol=1e-9)
    np.testing.assert_array_equal(experiment.outputs[:, 0], time)
    assert any(f"stands still at {time[row + to]:.10g}, where" in note for note in experiment.notes)


def late_once(time):
    return np.where(np.arange(time.size) == 300, time[301], time)


@pytest.mark.parametrize(
    ("fault", "code"),
    [
        (lambda t: np.insert(t, 300, t[300]), "duplicate"),  # a row twice, and no gap
        (lambda t: np.where(np.arange(t.size) % 100 == 1, np.roll(t, 1), t), "duplicate"),  # too often
        (lambda t: late_once(t)[:302], "duplicate"),  # at the end: nobody knows which of the two is late
        (lambda t: late_once(t + 0.3 * t**2), "duplicate"),  # uneven
        (lambda t: np.where(np.arange(t.size) == 300, np.roll(t, 2), t), "not-increasing"),
    ],
)
def test_other_rows_of_equal_time_are_refused(tmp_path, fault, code):
    time = fault(np.round(np.arange(1000) * 0.01, 3))
    path = tmp_path / "run.csv"
    np.savetxt(path, np.column_stack([time, time, time]), delimiter=",", header="time,u,phi", comments="")
    with pytest.raises(DataError) as caught:
        read(path)
    assert caught.value.code == f"data-time-{code}"
