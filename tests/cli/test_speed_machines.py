"""Machines that only measure speeds, a model that needs the slope of its input, and an arm whose observer
runs away: recordings that somebody brought, diagnosed with their own project files."""

import json
import shutil

import pytest


def brought(shared_data, folder, tmp_path):
    return shutil.copytree(shared_data / folder, tmp_path / "project")


@pytest.fixture
def diagnosed(daest, monkeypatch):
    """The document of `daest diagnose` in a folder."""

    def call(folder, *arguments):
        monkeypatch.chdir(folder)
        daest("diagnose", *arguments, "--format", "json", "-o", "diagnosis.json")
        return json.loads((folder / "diagnosis.json").read_text())

    return call


@pytest.mark.slow
def test_fan_of_a_motor_is_found_beside_an_angle_that_no_sensor_sees(shared_data, tmp_path, diagnosed):
    folder = brought(shared_data, "user_machines/fan_drive", tmp_path)
    found = diagnosed(folder, "--effect", "QuadraticDrag", "--to", "5")
    (drag,) = [c for c in found["candidates"] if c["verdict"] == "supported"]
    assert drag["parameters"]["k"]["value"] == pytest.approx(6.5e-7, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("model", ["Drives.mo", "DrivesBare.mo"])
def test_drives_reach_a_verdict(model, shared_data, tmp_path, diagnosed, daest):
    folder = brought(shared_data, "measured/coupled_drives", tmp_path)
    project = (folder / "daest.toml").read_text().replace("Drives.mo", model)
    noise = "load" if model == "DrivesBare.mo" else "disturbance.w"
    (folder / "daest.toml").write_text(project.replace('"disturbance.w"', f'"{noise}"'))
    found = diagnosed(folder, "--effect", "CoulombFriction")
    assert found["verdict"] and found["screen"]["n_screened"] >= 2
    daest("identify", "--method", "pem", "--format", "json", "-o", "fit.json")
    fit = json.loads((folder / "fit.json").read_text())
    sees_all = model == "DrivesBare.mo"
    assert fit["unseen_states"] == (
        [] if sees_all else ["a common change of motor.phi and pulley.phi (in the ratio 1 : 1)"]
    )


@pytest.mark.slow
def test_friction_of_a_suspension_is_found_without_a_word_on_the_hold(shared_data, tmp_path, diagnosed):
    """The slope of the road would act by the damping of the tyre, which is zero: the road may be held."""
    folder = brought(shared_data, "car_lab", tmp_path)
    arguments = ("c1.csv", "--model", "QuarterCar.mo", "--effect", "CoulombFriction", "--to", "20")
    found = diagnosed(folder, *arguments)
    best = found["candidates"][0]
    assert (best["effect"], best["at"], best["verdict"]) == ("CoulombFriction", "strut", "supported")
    assert not any("derivative of input" in note for note in found["notes"])


@pytest.mark.slow
def test_arm_whose_observer_runs_away_with_friction_is_judged(shared_data, tmp_path, diagnosed):
    folder = brought(shared_data, "measured/quarter_drone", tmp_path)
    assert diagnosed(folder, "--effect", "CoulombFriction")["verdict"]


@pytest.mark.slow
@pytest.mark.parametrize("axis", ["axis1", "axis4"])
def test_axis_of_a_robot_has_dry_friction(shared_data, tmp_path, diagnosed, axis):
    """A least-squares fit of the drive's torque goes from 69.5 to 76.8 % with dry friction on axis 1, and
    from 33.7 to 50.8 % on axis 4. On axis 1 a spring that relaxes does as much, of which no size is known."""
    folder = brought(shared_data, "measured/kuka_axes", tmp_path)
    shutil.copy(folder / f"{axis}.toml", folder / "daest.toml")
    found = diagnosed(folder)["candidates"]
    accepted = {one["effect"] for one in found if one["verdict"] in ("supported", "not separable")}
    assert "CoulombFriction" in accepted and accepted <= {"CoulombFriction", "RelaxingSpring"}
