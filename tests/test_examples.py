"""The examples: complete, consistent with their recordings, and with the numbers of `expected.json` and of
their pages. What the commands find is held against the truth that a simulator wrote down, closed forms, or
another method."""

from __future__ import annotations

import importlib.util
import json
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import butter, decimate, filtfilt
from scipy.stats import chi2

from daest.cli.main import run
from daest.data.project import load_project
from daest.data.read import Signal, read_experiments
from daest.modelica.compile import compile_model
from daest.systems.linear.linearize import linearize
from daest.systems.linear.noise import noise_report
from daest.systems.simulation.simulate import simulate

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"
NAMES = sorted(folder.name for folder in EXAMPLES.iterdir() if (folder / "daest.toml").is_file())
WITH_RECORDING = ("report_servo", "servo", "zone")
WITH_TRUTH = ("report_servo", "servo")  # recordings in which nothing is hidden
MEASURED_ELSEWHERE = ("emps",)  # the recordings are not part of the project


def test_every_folder_is_an_example() -> None:
    assert {folder.name for folder in EXAMPLES.iterdir() if folder.is_dir()} == set(NAMES)
    assert {*WITH_RECORDING, *MEASURED_ELSEWHERE} <= set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_project_file_fits_the_model(name: str) -> None:
    project = load_project(EXAMPLES / name)
    assert project.source is not None and (project.folder / "README.md").is_file()
    flat = compile_model(project.source, project.class_name)
    assert set(project.inputs) <= {v.name for v in flat.inputs}
    assert {*project.outputs, *project.measurement_noise} <= {o.name for o in flat.outputs}
    assert set(project.parameters) <= {p.name for p in flat.parameters}
    assert any(p.estimate for p in flat.parameters)
    places = {*(v.name for v in flat.unknowns), *(w.name for w in flat.noises)}
    assert set(project.process_noise) <= places


@pytest.mark.parametrize("name", NAMES)
def test_noise_is_admissible_and_leaves_the_outputs_alone(name: str) -> None:
    project = load_project(EXAMPLES / name)
    flat = compile_model(project.source, project.class_name)
    report = noise_report(linearize(flat), at=tuple(project.process_noise))
    noises = (*report.annotated, *report.asked)
    assert noises
    assert all(place.admissible and not place.white_outputs for place in noises)


@pytest.mark.parametrize("name", WITH_RECORDING)
def test_recording_fits_the_model(name: str) -> None:
    project = load_project(EXAMPLES / name)
    flat = compile_model(project.source, project.class_name)
    inputs = [Signal(v.name, v.unit, project.inputs[v.name]) for v in flat.inputs]
    outputs = [Signal(o.name, o.unit, project.outputs[o.name]) for o in flat.outputs]
    (experiment,) = read_experiments(project.estimate, inputs, outputs)
    assert experiment.period is not None
    assert np.isfinite(experiment.outputs).all()


def test_servo_with_its_true_parameters_leaves_the_noise() -> None:
    """The residual of a simulation with the true parameters has the variance of the measurement noise, inside
    the 99.9 % band of chi-square; and the fit that the page of the example tells."""
    folder = EXAMPLES / "servo"
    flat = compile_model(folder / "Servo.mo")
    truth = json.loads((folder / "truth.json").read_text())
    theta = np.array([truth["parameters"].get(p.name, p.value) for p in flat.parameters])
    signals = [Signal(o.name, o.unit) for o in flat.outputs]
    (experiment,) = read_experiments([folder / "servo.csv"], [Signal("u", "V")], signals)
    error = experiment.outputs - simulate(flat, experiment, theta=theta, hold="zoh").outputs
    n = experiment.n_samples
    squares = np.sum(error**2, axis=0) / np.array(truth["noise"]) ** 2
    assert (chi2.ppf(0.0005, n) < squares).all() and (squares < chi2.ppf(0.9995, n)).all()
    spread = experiment.outputs - experiment.outputs.mean(axis=0)
    fit = 100 * (1 - np.linalg.norm(error, axis=0) / np.linalg.norm(spread, axis=0))
    np.testing.assert_allclose(fit, [98.49, 98.45], atol=0.005)


SPRING_FIRST = "  connect(gear.flange_b, spring.flange_a);\n  connect(gear.flange_b, damper.flange_a);\n"
DAMPER_FIRST = "  connect(gear.flange_b, damper.flange_a);\n  connect(gear.flange_b, spring.flange_a);\n"


@pytest.mark.parametrize(
    ("connections", "n_forbidden", "n_large", "small_norm"),
    [(SPRING_FIRST, 10, 7, 1 / 67), (DAMPER_FIRST, 9, 6, 1 / 60)],
    ids=["spring first", "damper first"],
)
def test_report_servo(
    tmp_path: Path, connections: str, n_forbidden: int, n_large: int, small_norm: float
) -> None:
    text = (EXAMPLES / "report_servo" / "Servo.mo").read_text()
    assert text.count(SPRING_FIRST) == 1
    model = tmp_path / "Servo.mo"
    model.write_text(text.replace(SPRING_FIRST, connections))
    dae = linearize(compile_model(model))
    report = noise_report(dae)
    assert (dae.n, report.n_dynamic, report.index) == (54, 4, 2)
    sizes = np.array(report.N_singular_values)
    assert sizes.shape == (50,)
    np.testing.assert_allclose(sizes[:2], [1.414, 1.000], atol=5e-4)
    assert not sizes[2:].any()
    forbidden = [place for place in report.places if not place.admissible]
    assert len(forbidden) == n_forbidden
    assert all(".phi" in place.name and ".tau" not in place.name for place in forbidden)
    small = [place.projection_norm for place in forbidden if place.projection_norm < 0.02]
    assert small == pytest.approx([small_norm] * 3, rel=2e-3)
    coarse = noise_report(dae, tolerance=0.02)
    assert sum(not place.admissible for place in coarse.places) == n_large


# By the commands


Command = Callable[..., dict]


@pytest.fixture
def command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    """Copies an example, and runs a command line with --format json in the copy."""

    def call(name: str, *arguments: str, code: int = 0) -> dict:
        folder = tmp_path / name
        if not folder.exists():
            shutil.copytree(EXAMPLES / name, folder, ignore=shutil.ignore_patterns("results"))
        monkeypatch.chdir(folder)
        capsys.readouterr()
        assert run([*arguments, "--format", "json"]) == code
        return json.loads(capsys.readouterr().out)

    return call


def expected(name: str) -> dict:
    return json.loads((EXAMPLES / name / "expected.json").read_text())


def model_of(name: str) -> str:
    (model,) = (EXAMPLES / name).glob("*.mo")
    return model.name


@pytest.mark.parametrize("name", NAMES)
def test_counts(command: Command, name: str) -> None:
    numbers = expected(name)
    dae = command(name, "linearize", model_of(name))
    assert [dae[key] for key in ("n_equations", "n_dynamic", "index")] == [
        numbers[key] for key in ("n_equations", "n_dynamic", "index")
    ]
    assert command(name, "noise", model_of(name))["n_forbidden"] == numbers["n_forbidden"]


def poles_by_hand(name: str, p: dict[str, float]) -> np.ndarray:
    """Poles of the examples from their equations of motion, solved for the derivatives by hand."""
    if name == "tank":
        return np.array([-p["upper.rho"] * p["upper.g"] / (p["A"] * p[r]) for r in ("R1", "R2")])
    if name == "zone":
        inside, outside = 1 / p["Rie"], 1 / p["Rea"]
        matrix = [[-inside / p["Ci"], inside / p["Ci"]], [inside / p["Ce"], -(inside + outside) / p["Ce"]]]
    elif name == "emps":
        return np.array([0.0, -p["Fv"] / p["M"]])
    elif name == "quarter_car":  # road, wheel and body: positions, then velocities
        c, d, t, m, b = p["c"], p["d"], p["c_tyre"], p["m_wheel"], p["m_body"]
        matrix = [
            [0, 0, 0, 0, 0],
            [0, 0, 0, 1, 0],
            [0, 0, 0, 0, 1],
            [t / m, -(t + c) / m, c / m, -d / m, d / m],
            [0, c / b, -c / b, d / b, -d / b],
        ]
    else:  # motor and disc behind the gear
        n = p["gear.ratio"]
        motor = n**2 * p["J1"]
        matrix = [
            [0, 0, 1, 0],
            [0, 0, 0, 1],
            [
                -p["c"] / motor,
                p["c"] / motor,
                -(p["d"] + n**2 * p["k"] ** 2 / p["R"]) / motor,
                p["d"] / motor,
            ],
            [p["c"] / p["J2"], -p["c"] / p["J2"], p["d"] / p["J2"], -p["d"] / p["J2"]],
        ]
    return np.linalg.eigvals(np.array(matrix, dtype=float))


@pytest.mark.parametrize("name", NAMES)
def test_poles(command: Command, name: str) -> None:
    dae = command(name, "linearize", model_of(name))
    found = np.array([complex(*pole) for pole in dae["poles"]])
    by_hand = poles_by_hand(name, {p["name"]: p["value"] for p in dae["parameters"]}).astype(complex)
    size = max(abs(by_hand))
    # The tank's two poles coincide: rounding errors move a double pole by their square root.
    tolerance = 1e-7 if name == "tank" else 1e-10
    np.testing.assert_allclose(
        np.sort_complex(np.round(found / size, 12)),
        np.sort_complex(np.round(by_hand / size, 12)),
        atol=tolerance,
    )


@pytest.mark.parametrize("name", ["tank", "quarter_car"])
def test_simulation_of_a_step(command: Command, name: str) -> None:
    """A constant input: the levels follow the closed form of two equal lags; on a road that rises steadily
    the body rises without acceleration, and the suspension is as long as at rest."""
    command(name, "linearize", model_of(name))  # copies the example
    time = np.linspace(0.0, 200.0 if name == "tank" else 20.0, 2001)
    size = 1e-4 if name == "tank" else 0.1
    column = "q" if name == "tank" else "v_road"
    rows = "\n".join(f"{t:.6g},{size}" for t in time)
    Path("step.csv").write_text(f"time,{column}\n{rows}\n")
    values, loud = simulated(name), simulated(name, "--noise", "--seed", "1")
    if name == "tank":
        pressure, lag = 998.0 * 9.80665, 0.01 * 2e7 / (998.0 * 9.80665)
        level = size * 2e7 / pressure * (1.0 - (1.0 + time / lag) * np.exp(-time / lag))
        np.testing.assert_allclose(values["level"], level, atol=1e-9)
    else:
        assert abs(values["a_body"]).max() > 0.1
        assert abs(values["a_body"][-1]) < 1e-9 and abs(values["deflection"][-1]) < 1e-9
    outputs = [output for output in values if output not in ("time", column)]
    assert outputs and all(np.std(loud[output] - values[output]) > 0 for output in outputs)


def simulated(name: str, *options: str) -> dict[str, np.ndarray]:
    """Columns by name that `daest simulate` writes for the input of step.csv."""
    assert run(["simulate", model_of(name), "--inputs", "step.csv", "-o", "out.csv", *options]) == 0
    header = Path("out.csv").read_text().splitlines()[0].split(",")
    columns = np.loadtxt("out.csv", delimiter=",", skiprows=1).T
    return {title.split(" [")[0]: column for title, column in zip(header, columns, strict=True)}


@pytest.mark.slow  # test_readme.py
@pytest.mark.parametrize("name", WITH_TRUTH)
def test_identify_finds_the_truth(command: Command, name: str) -> None:
    truth = json.loads((EXAMPLES / name / "truth.json").read_text())["parameters"]
    fit = command(name, "identify")
    assert fit["status"] == "converged"
    for parameter, found in fit["parameters"].items():
        sign = -1.0 if name == "report_servo" and parameter == "k" else 1.0  # the amplifier's poles
        assert abs(found["value"] - sign * truth[parameter]) < 3 * found["std_error"], parameter
    assert fit["fit_percent"]["validation"] == pytest.approx(expected(name)["fit_percent"], abs=0.1)
    assert min(fit["fit_percent"]["validation"].values()) >= 98.0
    combinations = [set(direction["combination"]) for direction in fit["weak_directions"]]
    assert combinations == ([{"d", "c", "J2"}] if name == "report_servo" else [])


@pytest.mark.slow  # the filter after a fit: test_readme.py
def test_servo_filter_tells_the_speed_from_the_angle(command: Command) -> None:
    command("servo", "identify")
    summary = command("servo", "filter", "--measure", "phi", "-o", "estimates.csv")
    # At the start the speed is unknown; after that the sensor's own noise of 0.02 rad/s is all that is left.
    assert summary["compared"]["omega"]["fit_percent"] > 97.0
    assert summary["nis"]["inside"]


@pytest.mark.slow
def test_zone_lacks_the_sun(command: Command) -> None:
    """The room heated by the sun: without that effect the simulation explains half of the record only, and
    the filter notices."""
    fit = command("zone", "identify")
    assert fit["fit_percent"]["validation"]["T_room"] == pytest.approx(
        expected("zone")["fit_percent"]["T_room"], abs=1.0
    )
    assert not command("zone", "filter")["nis"]["inside"]


def inverse_model(path: Path) -> np.ndarray:
    """Mass, viscous friction and constant load by least squares of force = M a + Fv v + offset: position
    filtered without delay, differences, and the rest low-passed and thinned to 40 Hz."""
    table = np.genfromtxt(path, delimiter=",", names=True)
    period = float(np.median(np.diff(table["time_s"])))
    position = filtfilt(*butter(4, 100.0 * 2.0 * period), table["position_m"])
    speed = np.gradient(position, period)
    regressors = [np.gradient(speed, period), speed, np.ones_like(speed)]
    thinned = [decimate(column[200:-200], 25) for column in (*regressors, table["motor_force_N"])]
    return np.linalg.lstsq(np.column_stack(thinned[:3]), thinned[3], rcond=None)[0]


@pytest.mark.slow
def test_emps_agrees_with_the_inverse_model(command: Command, shared_data: Path) -> None:
    command("emps", "linearize", "Emps.mo")  # copies the example
    for name in ("train.csv", "test_pulses.csv"):
        shutil.copy(shared_data / "emps" / name, name)
    fit = command("emps", "identify")
    mass, friction, load = inverse_model(Path("train.csv"))
    # Published with Coulomb friction: Fv = 203.5 N.s/m; without it about twice as much.
    assert friction / 203.5 == pytest.approx(2.0, abs=0.1)
    found = {name: p["value"] for name, p in fit["parameters"].items()}
    assert found["Fv"] == pytest.approx(friction, rel=0.01)
    assert found["offset"] == pytest.approx(load, rel=0.02)
    # Coulomb friction acts as fast as an acceleration when the motion turns; the two methods weigh it
    # differently.
    assert found["M"] == pytest.approx(mass, rel=0.07)
    assert fit["fit_percent"]["validation"] == pytest.approx(expected("emps")["fit_percent"], abs=0.5)


@pytest.mark.slow
def test_emps_improves_by_dry_friction_and_by_damping_that_knows_the_direction(
    command: Command, shared_data: Path
) -> None:
    """Published: Fc = 20.39 N, and a better fit with a friction that differs between the directions."""
    command("emps", "linearize", "Emps.mo")  # copies the example
    for name in ("train.csv", "test_pulses.csv"):
        shutil.copy(shared_data / "emps" / name, name)
    ledger = command("emps", "improve")
    nominal, dry, damped = ledger["steps"][:3]
    assert nominal["added"] is None and dry["added"] == "CoulombFriction"
    assert dry["parameters"][f"{dry['component']}.f_c"]["value"] == pytest.approx(20.39, rel=0.1)
    assert dry["parameters"]["M"]["value"] == pytest.approx(95.11, rel=0.05)
    assert damped["added"].startswith("Asymmetric")
    errors = [step["rms"]["validation"]["position"] for step in ledger["steps"]]
    assert errors == sorted(errors, reverse=True) and len(set(errors)) == len(errors)
    assert errors[2] < 5e-3 < errors[0]  # 25 s of dead reckoning from a start that is not known
    told = (EXAMPLES / "emps" / "README.md").read_text()
    assert all(f"{1e3 * error:#.3g} mm" in told for error in errors)


# The filter experiment of the report, section 3.4.2


@pytest.fixture(scope="module")
def experiment():
    """The script of the example, and what it finds with the true parameters."""
    path = EXAMPLES / "report_servo" / "filter_experiment.py"
    specification = importlib.util.spec_from_file_location("filter_experiment", path)
    script = importlib.util.module_from_spec(specification)
    sys.modules["filter_experiment"] = script  # dataclasses look their module up
    specification.loader.exec_module(script)
    values = json.loads(path.with_name("truth.json").read_text())["parameters"]
    values["k"] = -values["k"]  # the model has the amplifier's poles reversed
    values.pop("n")
    return script, script.trials(script.model(values), script.read(path.with_name("servo.csv")))


def test_from_rest_both_filters_are_as_good(experiment) -> None:
    _, (rest, _, _) = experiment
    assert rest.error(rest.varying) == pytest.approx(rest.error(rest.stationary), rel=0.02)


def test_after_a_wrong_start_the_time_varying_filter_wins_in_the_transient(experiment) -> None:
    _, (_, wrong, _) = experiment
    assert wrong.error(wrong.varying) < 0.85 * wrong.error(wrong.stationary)


def test_both_filters_are_equal_in_the_long_run(experiment) -> None:
    _, (_, _, late) = experiment
    assert late.error(late.varying) == pytest.approx(late.error(late.stationary), rel=1e-3)
    assert late.error(late.varying) < 0.025  # the noise of the speed sensor is 0.02 rad/s


def test_the_figure_is_written(experiment, tmp_path: Path) -> None:
    script, trials = experiment
    script.draw(trials, tmp_path / "figures.png")
    assert (tmp_path / "figures.png").stat().st_size > 10_000


def test_the_script_takes_a_fit(experiment, tmp_path: Path, monkeypatch, capsys) -> None:
    script, _ = experiment
    fit = tmp_path / "fit.json"
    fit.write_text(json.dumps({"parameters": {"k": {"value": -0.0523}, "J1": {"value": 6.29e-6}}}))
    monkeypatch.setattr(sys, "argv", ["filter_experiment.py", "--fit", str(fit), "--set", "J2=4.4e-4"])
    script.main()
    assert "long after the wrong start (figure 10)" in capsys.readouterr().out
