"""The exported estimator in C against the filter of whole recordings; compilers' and sanitizers' silence."""

import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from daest.errors import EstimationError
from daest.estimation.estimator import estimator_model
from daest.estimation.filter import run_filter
from daest.fmu.estimator_code import estimator_files
from daest.model.estimates import FilterOptions, InitialState
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_model

COMPILER = shutil.which("gcc") or shutil.which("cc")
pytestmark = pytest.mark.skipif(COMPILER is None, reason="needs a C compiler")
STRICT = ("-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror")
SANITIZED = ("-g", "-fsanitize=address,undefined", "-fno-sanitize-recover")
# The speed of a mass is never measured, its absolute position never shows: a wheel turns freely beside it.
PLANT = """\
model Plant "A mass on a spring, and a wheel that no output sees; noise reaches an output directly"
  parameter Real m = 2.0;
  parameter Real c = 8.0;
  input Real u(start = 0);
  input Real w annotation(__Daest(noise = true, intensity = 0.05));
  input Real e annotation(__Daest(noise = true, intensity = 0.002));
  output Real y annotation(__Daest(std = 0.1));
  output Real force annotation(__Daest(std = 0.3));
  Real s; Real v; Real turn; Real pull "noisy";
equation
  der(s) = v;
  m*der(v) = u - c*s - 0.4*v + w;
  der(turn) = 0.1*s;
  pull = c*s + e;
  y = s;
  force = pull + 0.2*u;
end Plant;
"""


@pytest.fixture(scope="module")
def plant(tmp_path_factory):
    path = tmp_path_factory.mktemp("model") / "Plant.mo"
    path.write_text(PLANT)
    return compile_model(path)


def record(even, n=160, seed=0):
    rng = np.random.default_rng(seed)
    time = 0.1 * np.arange(n) if even else np.cumsum(rng.uniform(0.03, 0.4, n))
    u = np.repeat(rng.normal(size=n // 8), 8)[:, None]
    y = np.column_stack([np.sin(time), 8 * np.sin(time)]) + rng.normal(size=(n, 2)) * (0.1, 0.4)
    y[rng.uniform(size=y.shape) < 0.2] = np.nan
    return Experiment("r", time, u, y, ("u",), ("y", "force"))


def built(model, folder: Path, *flags: str, is_float=False) -> Path:
    folder.mkdir(exist_ok=True)
    for name, text in estimator_files(model, is_float=is_float).items():
        (folder / name).write_text(text)
    command = [COMPILER, *flags, "estimator.c", "estimator_model.c", "main.c", "-lm", "-o", "replay"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0 and done.stderr == "", done.stderr
    return folder / "replay"


def replayed(program: Path, experiment: Experiment) -> dict[str, np.ndarray]:
    header = ["time", *(f"{name} [1]" for name in (*experiment.input_names, *experiment.output_names))]
    table = np.column_stack([experiment.time, experiment.inputs, experiment.outputs])
    lines = [",".join("" if np.isnan(v) else repr(float(v)) for v in row) for row in table]
    text = "\n".join([",".join(header), *lines]) + "\n"
    done = subprocess.run([program], input=text, capture_output=True, text=True)
    assert done.returncode == 0 and done.stderr == "", done.stderr
    rows = [line.split(",") for line in done.stdout.replace('"', "").splitlines()]
    values = np.array([[float(cell or "nan") for cell in row] for row in rows[1:]])
    return dict(zip(rows[0], values.T, strict=True))


def agree(found, known, tolerance, names):
    for name in names:
        i = known.names.index(name)
        is_open = np.isinf(known.std[:, i])
        assert np.array_equal(np.isnan(found[name]), is_open), name
        values, std = known.values[~is_open, i], known.std[~is_open, i]
        scale = max(np.max(np.abs(values), initial=0.0), np.max(std, initial=0.0), 1e-300)
        np.testing.assert_allclose(
            found[name][~is_open], values, atol=tolerance * scale, rtol=0, err_msg=name
        )
        np.testing.assert_allclose(found[f"{name}.std"][~is_open], std, atol=tolerance * scale, rtol=0)
    innovations = np.column_stack([found[f"innovation.{name}"] for name in known.output_names])
    scale = np.nanmax(np.abs(known.innovations))
    np.testing.assert_allclose(innovations, known.innovations, atol=tolerance * scale, rtol=0)
    assert found["log_likelihood"][-1] == pytest.approx(known.log_likelihood, rel=tolerance)
    assert np.nansum(found["nis"]) / known.nis.n_innovations == pytest.approx(known.nis.mean, rel=tolerance)


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_replay_is_the_filter_of_the_recording(plant, tmp_path, hold):
    """Unknown start of which a part never shows, noise in an output, missing outputs; equal steps."""
    model = estimator_model(plant, 0.1, "kalman", hold)
    assert model.held and model.start.sensitivity.shape == (3, 3) and model.start.n_known == 2
    program = built(model, tmp_path / "c", *STRICT, "-O2")
    known = run_filter(plant, record(True), options=FilterOptions(hold=hold))
    agree(replayed(program, record(True)), known, 1e-9, model.values)


def test_uneven_steps_under_the_sanitizers(plant, tmp_path):
    """Variables that white noise reaches directly need the step to come, which a stream does not know."""
    quiet = replace(plant, noises=(plant.noises[0], replace(plant.noises[1], intensity=0.0)))
    model = estimator_model(quiet, 0.1)
    program = built(model, tmp_path / "c", *STRICT, *SANITIZED)
    known = run_filter(quiet, record(False))
    agree(replayed(program, record(False)), known, 1e-8, ("s", "v", "turn", "y", "force"))


def test_stationary_start_and_chosen_variables(plant, tmp_path):
    outputs = replace(plant, noises=(plant.noises[0], replace(plant.noises[1], intensity=0.0)))
    with pytest.raises(EstimationError, match="turn"):
        estimator_model(outputs, 0.1, "stationary")  # the wheel never settles
    model = estimator_model(plant, 0.1, only=("v", "force"), initial=InitialState.known(np.zeros(3), 0.5))
    program = built(model, tmp_path / "c", *STRICT, *SANITIZED)
    known = run_filter(
        plant, record(True), options=FilterOptions(initial=InitialState.known(np.zeros(3), 0.5))
    )
    found = replayed(program, record(True))
    agree(found, known, 1e-9, ("v", "force"))
    assert "s" not in found


def test_single_precision(plant, tmp_path):
    """Late in a long run, too, where a float no longer resolves the steps."""
    model = estimator_model(plant, 0.1)
    program = built(model, tmp_path / "c", *STRICT, "-O2", is_float=True)
    experiment = record(True)
    known = run_filter(plant, experiment)
    for shift in (0.0, 1e6):
        found = replayed(program, replace(experiment, time=experiment.time + shift))
        late = slice(20, None)
        i = known.names.index("v")
        assert np.max(np.abs(found["v"][late] - known.values[late, i]) / known.std[late, i]) < 1e-2


def test_knobs_change_parameters_and_noise(plant, tmp_path):
    """theta, intensity and noise_std take effect by estimator_tuned."""
    model = estimator_model(plant, 0.1)
    folder = built(model, tmp_path / "c", *STRICT).parent
    main = (folder / "main.c").read_text()
    knobs = "e.theta[1] = 6.0; e.intensity[0] = 0.2; e.noise_std[0] = 0.05;"
    tuned = f"estimator_init(&e); {knobs} estimator_tuned(&e);"
    (folder / "main.c").write_text(main.replace("estimator_init(&e);", tuned))
    command = [COMPILER, *STRICT, "estimator.c", "estimator_model.c", "main.c", "-lm", "-o", "replay"]
    subprocess.run(command, cwd=folder, check=True)
    other = plant.with_theta({"c": 6.0})
    other = replace(
        other,
        noises=(replace(plant.noises[0], intensity=0.2), plant.noises[1]),
        outputs=(replace(plant.outputs[0], noise_std=0.05), plant.outputs[1]),
    )
    assert plant.parameters[1].name == "c"
    agree(replayed(folder / "replay", record(True)), run_filter(other, record(True)), 1e-9, ("s", "v"))


def test_replay_refuses_what_is_no_recording(plant, tmp_path):
    program = built(estimator_model(plant, 0.1), tmp_path / "c", *SANITIZED)
    broken = {"": 2, "time,y\n": 2, "u,y\n": 2, "time,u,y\n0,1\n": 2, "time,u,y\n0,,1\n": 2}
    for text, status in {**broken, "time,u,y\n1,1,1\n1,1,1\n": 1}.items():
        done = subprocess.run([program], input=text, capture_output=True, text=True)
        assert done.returncode == status and done.stderr and "Sanitizer" not in done.stderr


def test_nonlinear_models_are_refused(tmp_path):
    path = tmp_path / "Tank.mo"
    path.write_text(
        "model Tank\n  input Real u;\n  output Real y annotation(__Daest(std = 0.1));\n  Real h(start = 1);\n"
        "equation\n  der(h) = u - sqrt(h);\n  y = h;\nend Tank;\n"
    )
    with pytest.raises(EstimationError, match="nonlinear"):
        estimator_model(compile_model(path), 0.1)
