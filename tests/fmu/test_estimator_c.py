"""The exported estimator in C against the filter of whole recordings; compilers' and sanitizers' silence."""

import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from daest.errors import EstimationError
from daest.estimation.filter import run_filter
from daest.estimation.streaming.estimator import estimator_model
from daest.estimation.streaming.online_filter import online_filter
from daest.fmu.estimator_code import estimator_files
from daest.fmu.estimator_nonlinear import arithmetic
from daest.model.estimates import FilterOptions, InitialState, Sample
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_model

COMPILER = shutil.which("gcc") or shutil.which("cc")
pytestmark = pytest.mark.skipif(COMPILER is None, reason="needs a C compiler")
CONVERSIONS = ("-Wconversion", "-Wsign-conversion", "-Wdouble-promotion")
STRICT = (
    "-std=c99", "-pedantic", "-Wall", "-Wextra", "-Wshadow", "-Wmissing-prototypes", *CONVERSIONS, "-Werror",
)  # fmt: skip
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


def built(model, folder: Path, *flags: str, is_float=False, change=("", "")) -> Path:
    """The replay, compiled; `change` replaces words of its main program."""
    folder.mkdir(exist_ok=True)
    for name, text in estimator_files(model, is_float=is_float).items():
        (folder / name).write_text(text.replace(*change) if change[0] and name == "main.c" else text)
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


@pytest.mark.parametrize("hold", [pytest.param("zoh", marks=pytest.mark.slow), "foh"])
def test_replay_is_the_filter_of_the_recording(plant, tmp_path, hold):
    """Unknown start of which a part never shows, noise in an output, missing outputs; equal steps."""
    model = estimator_model(plant, 0.1, "kalman", hold)
    assert model.form.held and model.form.start.sensitivity.shape == (3, 3)
    assert model.form.start.n_known == 2
    program = built(model, tmp_path / "c", *STRICT, "-O2")
    known = run_filter(plant, record(True), options=FilterOptions(hold=hold))
    agree(replayed(program, record(True)), known, 1e-9, model.values)


@pytest.fixture(scope="module")
def quiet(plant):
    """Variables that white noise reaches directly need the step to come, which a stream does not know."""
    return replace(plant, noises=(plant.noises[0], replace(plant.noises[1], intensity=0.0)))


@pytest.fixture(scope="module")
def sanitized(quiet, tmp_path_factory):
    return built(estimator_model(quiet, 0.1), tmp_path_factory.mktemp("sanitized"), *STRICT, *SANITIZED)


def test_uneven_steps_under_the_sanitizers(quiet, sanitized):
    known = run_filter(quiet, record(False))
    agree(replayed(sanitized, record(False)), known, 1e-8, ("s", "v", "turn", "y", "force"))


def test_stationary_start_and_chosen_variables(plant, tmp_path):
    model = estimator_model(plant, 0.1, only=("v", "force"), initial=InitialState.known(np.zeros(3), 0.5))
    program = built(model, tmp_path / "c", *STRICT, *SANITIZED)
    known = run_filter(
        plant, record(True), options=FilterOptions(initial=InitialState.known(np.zeros(3), 0.5))
    )
    found = replayed(program, record(True))
    agree(found, known, 1e-9, ("v", "force"))
    assert "s" not in found


def test_stationary_with_a_state_that_no_output_sees(plant, tmp_path):
    """The angle of the wheel is left out, on a stream and in C as in the filter of the recording."""
    experiment = record(True)
    known = run_filter(plant, experiment, "stationary")
    assert np.isinf(known.std[:, known.names.index("turn")]).all()
    online = online_filter(plant, 0.1, "stationary")
    memory, found = online.begin(), []
    for k, time in enumerate(experiment.time):
        memory, one = online.advance(memory, Sample(time, experiment.inputs[k], experiment.outputs[k]))
        found.append(one)
    std, values = np.array([one.std for one in found]), np.array([one.values for one in found])
    assert np.array_equal(np.isinf(std), np.isinf(known.std))
    assert np.isinf(std).any(axis=0).sum() == 1
    sure = np.isfinite(known.std[0])
    np.testing.assert_allclose(values[:, sure], known.values[:, sure], rtol=0, atol=1e-9)
    np.testing.assert_allclose(std[:, sure], known.std[:, sure], rtol=1e-8)
    model = estimator_model(plant, 0.1, "stationary")
    replay = replayed(built(model, tmp_path / "c", *STRICT, "-O1"), experiment)
    for i, name in enumerate(online.names):
        np.testing.assert_allclose(replay[name], values[:, i], rtol=0, atol=1e-9, err_msg=name)


def test_single_precision(plant, tmp_path):
    """Late in a long run, too, where a float no longer resolves the steps."""
    model = estimator_model(plant, 0.1)
    program = built(model, tmp_path / "c", *STRICT, "-O1", is_float=True)
    experiment = record(True)
    known = run_filter(plant, experiment)
    for shift in (0.0, 1e6):
        found = replayed(program, replace(experiment, time=experiment.time + shift))
        late = slice(20, None)
        i = known.names.index("v")
        assert np.max(np.abs(found["v"][late] - known.values[late, i]) / known.std[late, i]) < 1e-2


def test_knobs_change_parameters_and_noise(plant, tmp_path):
    """theta, intensity and noise_std take effect by estimator_tuned."""
    knobs = "e.theta[1] = 6.0; e.intensity[0] = 0.2; e.noise_std[0] = 0.05;"
    tuned = f"estimator_init(&e); {knobs} estimator_tuned(&e);"
    program = built(
        estimator_model(plant, 0.1), tmp_path / "c", *STRICT, change=("estimator_init(&e);", tuned)
    )
    other = plant.with_theta({"c": 6.0})
    other = replace(
        other,
        noises=(replace(plant.noises[0], intensity=0.2), plant.noises[1]),
        outputs=(replace(plant.outputs[0], noise_std=0.05), plant.outputs[1]),
    )
    assert plant.parameters[1].name == "c"
    agree(replayed(program, record(True)), run_filter(other, record(True)), 1e-9, ("s", "v"))


def test_replay_refuses_what_is_no_recording(sanitized):
    broken = {"": 2, "time,y\n": 2, "u,y\n": 2, "time,u,y\n0,1\n": 2, "time,u,y\n0,,1\n": 2}
    for text, status in {**broken, "time,u,y\n1,1,1\n1,1,1\n": 1}.items():
        done = subprocess.run([sanitized], input=text, capture_output=True, text=True)
        assert done.returncode == status and done.stderr and "Sanitizer" not in done.stderr


# An algebraic loop that needs Newton's iteration; a pendulum whose states are tied by its constraint.
NONLINEAR = {
    "Diode": """\
model Diode
  parameter Real R = 2.0;
  input Real u(start = 0);
  input Real w annotation(__Daest(noise = true, intensity = 0.01));
  output Real y annotation(__Daest(std = 0.05));
  Real v(nominal = 1); Real i(start = 0.1); Real q(nominal = 1);
equation
  der(v) = i - 0.3*v + w;
  u - v = R*i + sinh(i);
  der(q) = i - 0.2*q;
  y = v + 0.1*q;
end Diode;
""",
    "Pendulum": """\
model Pendulum
  parameter Real L = 1.0;
  input Real u(start = 0);
  input Real w annotation(__Daest(noise = true, intensity = 0.01));
  output Real y annotation(__Daest(std = 0.05));
  Real px(start = 0.5, nominal = 1); Real py(start = -0.866, nominal = 1);
  Real vx(nominal = 1); Real vy(nominal = 1); Real F(start = 9);
equation
  der(px) = vx;
  der(py) = vy;
  der(vx) = -F*px/L + u + w - 0.1*vx;
  der(vy) = -F*py/L - 9.81 - 0.1*vy;
  px^2 + py^2 = L^2;
  y = px;
end Pendulum;
""",
}
# Not F: it contains white noise, whose mean over the step to come a stream does not know.
TOLD = {"Diode": ("v", "i", "q", "y"), "Pendulum": ("px", "py", "vx", "vy", "y")}


@pytest.fixture(scope="module", params=NONLINEAR)
def nonlinear(request, tmp_path_factory):
    """A model, samples with uneven steps of which some are missing, and a known start."""
    path = tmp_path_factory.mktemp("model") / f"{request.param}.mo"
    path.write_text(NONLINEAR[request.param])
    rng, n = np.random.default_rng(0), 100
    time = np.cumsum(rng.uniform(0.03, 0.2, n))
    u = np.repeat(rng.normal(size=n // 5), 5)[:, None]
    y = 0.5 * np.sin(time)[:, None] + 0.05 * rng.normal(size=(n, 1))
    y[rng.uniform(size=y.shape) < 0.2] = np.nan
    experiment = Experiment("r", time, u, y, ("u",), ("y",))
    mean = np.array([0.5, 0.0]) if request.param == "Pendulum" else np.full(2, 0.1)
    return compile_model(path), experiment, InitialState.known(mean, 0.2)


# One kind, hold and model; the others among the slow tests.
@pytest.mark.parametrize(
    ("nonlinear", "kind", "hold"),
    [
        pytest.param("Diode", "ekf", "foh", marks=pytest.mark.slow),
        ("Pendulum", "ukf", "zoh"),
        pytest.param("Diode", "ukf", "zoh", marks=pytest.mark.slow),
        pytest.param("Pendulum", "ekf", "foh", marks=pytest.mark.slow),
    ],
    indirect=["nonlinear"],
)
def test_nonlinear_replay_is_the_filter_of_the_recording(nonlinear, tmp_path, kind, hold):
    flat, experiment, initial = nonlinear
    wanted = FilterOptions(initial=initial, hold=hold, longest=0.025)
    known = run_filter(flat, experiment, kind, wanted)
    model = estimator_model(flat, 0.1, kind, hold, initial=initial, longest=0.025)
    assert model.form.word == f"An {'extended' if kind == 'ekf' else 'unscented'} Kalman filter"
    found = replayed(built(model, tmp_path / "c", *STRICT, *SANITIZED), experiment)
    for name in TOLD[flat.name]:
        i = known.names.index(name)
        np.testing.assert_allclose(found[name], known.values[:, i], rtol=1e-9, atol=1e-9, err_msg=name)
        if (flat.name, kind) != ("Pendulum", "ukf"):  # sigma points move onto the circle afterwards
            np.testing.assert_allclose(found[f"{name}.std"], known.std[:, i], rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(found["innovation.y"], known.innovations[:, 0], rtol=0, atol=1e-9)
    assert found["log_likelihood"][-1] == pytest.approx(known.log_likelihood, rel=1e-9)
    assert np.nansum(found["nis"]) / known.nis.n_innovations == pytest.approx(known.nis.mean, rel=1e-9)


@pytest.mark.slow  # of a linear model: test_single_precision
@pytest.mark.parametrize("nonlinear", ["Diode", "Pendulum"], indirect=True)
def test_nonlinear_single_precision(nonlinear, tmp_path):
    flat, experiment, initial = nonlinear
    model = estimator_model(flat, 0.1, initial=initial, longest=0.025)
    assert model.form.word == "An extended Kalman filter"
    found = replayed(built(model, tmp_path / "c", *STRICT, "-O1", is_float=True), experiment)
    known = run_filter(flat, experiment, "ekf", FilterOptions(initial=initial, longest=0.025))
    i = known.names.index("y")
    assert np.max(np.abs(found["y"] - known.values[:, i]) / known.std[:, i]) < 1e-2


@pytest.mark.parametrize(
    "nonlinear", ["Diode", pytest.param("Pendulum", marks=pytest.mark.slow)], indirect=True
)
def test_what_a_nonlinear_step_costs(nonlinear):
    """The functions of the model count, and every substep of the expected step does."""
    flat, _, initial = nonlinear
    costs = {}
    for kind in ("ekf", "ukf"):
        for period in (0.025, 0.1):
            only = ("v",) if flat.name == "Diode" else ("y",)
            model = estimator_model(flat, period, kind, initial=initial, longest=0.025, only=only)
            costs[kind, period] = model.form.cost(model)["operations"]
        assert arithmetic(model.form.local.flow) > 10
        assert 3 * costs[kind, 0.025] < costs[kind, 0.1] < 4 * costs[kind, 0.025]
    assert costs["ukf", 0.1] > 2 * costs["ekf", 0.1]


def test_a_nonlinear_model_has_no_kalman_filter(nonlinear):
    with pytest.raises(EstimationError, match="nonlinear"):
        estimator_model(nonlinear[0], 0.1, "kalman")


MIXED = """\
model Mixed "A room that is heated by steps beside an outside temperature that drifts"
  parameter Real C = 40;
  input Real P, To;
  input Real w annotation(__Daest(noise = true, intensity = 0.05));
  output Real y annotation(__Daest(std = 0.1));
  Real T(start = 20);
equation
  C*der(T) = P - 3*(T - To)LAW + w;
  y = T;
end Mixed;
"""


@pytest.mark.parametrize(
    ("law", "kind"), [("", "kalman"), pytest.param(" - 0.02*(T - To)^3", "ekf", marks=pytest.mark.slow)]
)
def test_each_input_does_what_the_hold_says(tmp_path, law, kind):
    (tmp_path / "Mixed.mo").write_text(MIXED.replace("LAW", law))
    flat, rng, n = compile_model(tmp_path / "Mixed.mo"), np.random.default_rng(3), 80
    time = 0.5 * np.arange(n)
    u = np.column_stack([rng.choice([0.0, 40.0], n), 10 + np.cumsum(rng.normal(size=n))])
    y = 15 + np.cumsum(rng.normal(size=(n, 1)), axis=0)
    experiment, start = Experiment("r", time, u, y, ("P", "To"), ("y",)), InitialState.known([15.0], 0.2)
    longest = {"longest": 0.125} if law else {}

    def known(hold):
        options = FilterOptions(hold=hold, initial=start, **longest)
        run = run_filter(flat, experiment, "ekf" if law else "time-varying", options)
        return run.values[:, run.names.index("T")]

    model = estimator_model(flat, 0.5, kind, "zoh(P)", initial=start, **longest)
    found = replayed(built(model, tmp_path / "c", *STRICT, *SANITIZED), experiment)["T"]
    np.testing.assert_allclose(found, known("zoh(P)"), rtol=1e-9)
    assert np.max(np.abs(found - known("foh"))) > 0.01
