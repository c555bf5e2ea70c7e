"""`daest init`: the written project is one that the reader understands, and nothing is overwritten."""

import json

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


def test_existing_file_is_kept(folder, daest):
    (folder / "daest.toml").write_text("# mine\n")
    code, out, err = daest("init", "Lag.mo")
    assert code == 2 and out == "" and "config-exists" in err and "daest.toml" in err
    assert (folder / "daest.toml").read_text() == "# mine\n"
    assert daest("init", "Lag.mo", "-p", "other/daest.toml")[0] == 0
    assert load_project(folder / "other" / "daest.toml").source.resolve() == folder / "Lag.mo"


def test_columns_are_proposed_and_doubts_are_said(folder, daest):
    text = (folder / "run1.csv").read_text().replace("time,u,y", "time,U_V,response [mV]")
    (folder / "odd.csv").write_text(text)
    code, out, _ = daest("init", "Lag.mo", "odd.csv", "--format", "json")
    document = json.loads(out)
    assert code == 0 and document["schema"] == "daest/init/1"
    assert document["inputs"] == {"u": "U_V"} and document["outputs"] == {"y": "response"}
    assert document["estimate"] == ["T", "k"]
    assert document["doubtful"] == ["u", "y"]
    assert "matched by unit: please check" in (folder / "daest.toml").read_text()
    assert load_project().outputs == {"y": "response"}


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


def test_faults_of_the_recording_are_told_at_once(folder, daest):
    text = (folder / "run1.csv").read_text().replace("\n0.15,", "\n0.1,", 1)
    (folder / "bad.csv").write_text(text)
    code, out, _ = daest("init", "Lag.mo", "bad.csv")
    assert code == 0 and "warning[check-clock-duplicate]: bad: the clock" in out


def test_what_is_to_be_checked_or_completed_is_told(folder, daest):
    (folder / "odd.csv").write_text((folder / "run1.csv").read_text().replace("time,u,y", "time,u_drive,y"))
    model = (folder / "Lag.mo").read_text().replace("estimate = true", "estimate = false")
    (folder / "Lag.mo").write_text(model)
    _, out, _ = daest("init", "Lag.mo", "odd.csv")
    assert "input u: u_drive, please check" in out and "output y: y\n" in out
    assert "estimated parameters: NONE MARKED, see [parameters] of daest.toml" in out
    code, _, err = daest("identify")
    assert code == 2 and "[parameters] NAME = { estimate = true }" in err
