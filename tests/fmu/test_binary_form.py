"""FMUs of other tools as models: simulation with events, identification, filters, comparison."""

from pathlib import Path

import numpy as np
import pytest
from ball_fmu import ball, fall
from fmu_archives import changed

from daest.diagnosis.comparison.compare import compare_models
from daest.diagnosis.comparison.trial import Candidate
from daest.errors import FmuError, ModelError
from daest.estimation.filter import run_filter
from daest.estimation.identify import identify
from daest.fmu.binary_model import BinaryDynamics, BinaryModel, binary_model
from daest.fmu.export import export_fmu
from daest.model.estimates import FilterOptions
from daest.model.experiment import Experiment
from daest.model.fit import IdentifyOptions
from daest.model.flat import ExplicitModel, FlatModel
from daest.modelica.change import declare, with_noises
from daest.modelica.compile import compile_model
from daest.systems.linear.linearize import has_affine_dynamics, is_affine_model, linearize
from daest.systems.linear.state_space import family_along
from daest.systems.reduction.initialize import initial_point
from daest.systems.reduction.reduce import dynamics
from daest.systems.simulation.integrate import integrator
from daest.systems.simulation.local_linear import local_model
from daest.systems.simulation.simulate import simulate, values_along

TIME = np.linspace(0.0, 2.0, 81)
FORCE = 9.81 + 3.0 * np.sin(3.0 * TIME) + 2.0 * np.cos(7.0 * TIME)


@pytest.fixture(scope="module")
def foreign(tmp_path_factory):
    return binary_model(ball(tmp_path_factory.mktemp("ball")))


def recording(noise=0.0, seed=1, d=0.25):
    h = fall(TIME, FORCE, d=d)[0]
    y = h + noise * np.random.default_rng(seed).standard_normal(h.size)
    return Experiment("run", TIME, FORCE[:, None], y[:, None], ("u",), ("y",))


def test_names_units_and_values(foreign):
    assert [v.name for v in foreign.unknowns] == ["h", "v", "y", "w"]
    assert [(p.name, p.value, p.min) for p in foreign.parameters] == [
        ("d", 0.1, 0.0),
        ("e", 0.7, None),
        ("g", 9.81, None),
    ]
    assert [(o.name, o.unit) for o in foreign.outputs] == [("y", "m")]
    assert not is_affine_model(foreign)


def test_simulation_equals_an_independent_integrator(foreign):
    found = simulate(foreign, (TIME, FORCE[:, None]))
    h, v = fall(TIME, FORCE)
    assert np.allclose(found["y"], h, atol=1e-6)
    assert np.allclose(found["w"], 2 * v, atol=1e-5)
    assert np.allclose(found["v"], v, atol=1e-5)


def test_start_values_and_parameters_reach_the_fmu(foreign):
    theta = np.array([0.4, 0.7, 3.0])
    found = simulate(foreign, (TIME, FORCE[:, None]), theta=theta, x0={"h": 5.0})
    assert np.allclose(found["y"], fall(TIME, FORCE, d=0.4, g=3.0, h0=5.0)[0], atol=1e-5)


def test_state_event_and_time_event(tmp_path):
    bounce = binary_model(ball(tmp_path, BOUNCE=1))
    grid = np.linspace(0.0, 1.0, 41)
    theta = np.array([0.0, 0.5, 10.0])
    found = simulate(bounce, (grid, np.zeros((41, 1))), theta=theta)
    first = np.sqrt(2.0 / 10.0)
    speed = 0.5 * 10.0 * first
    after = grid - first
    expected = np.where(after < 0, 1.0 - 5.0 * grid**2, speed * after - 5.0 * after**2)
    seen = grid < first + 2 * speed / 10.0
    assert np.allclose(found["y"][seen], expected[seen], atol=1e-5)
    (tmp_path / "t").mkdir()
    switch = binary_model(ball(tmp_path / "t", SWITCH=1))
    grid = np.linspace(0.0, 2.0, 9)  # t = 1 is a sample; 1.1 would not be
    found = simulate(switch, (grid + 0.1, np.zeros((9, 1))), theta=np.array([0.0, 0.7, 2.0]))
    late = np.maximum(grid + 0.1 - 1.0, 0.0)
    expected = 1.0 - grid**2 + 2.0 * late**2
    assert np.allclose(found["y"], expected, atol=1e-5)


def test_nominals_of_zero_count_as_one(tmp_path):
    found = simulate(binary_model(ball(tmp_path, TRAP="ZERO_NOMINALS")), (TIME, FORCE[:, None]))
    assert np.allclose(found["y"], fall(TIME, FORCE)[0], atol=1e-5)


def test_output_error_finds_the_parameter(foreign):
    fit = identify(foreign, [recording(0.005)], IdentifyOptions(method="oe", estimate=("d",), hold="foh"))
    (d,) = fit.parameters
    assert fit.is_converged
    assert abs(d.value - 0.25) < 4 * d.std_error
    assert 0.0 < d.std_error < 0.02


@pytest.mark.slow
def test_prediction_error_with_noise_on_a_state_derivative(foreign):
    model = declare(foreign, noises={"der(v)": 0.01})
    options = IdentifyOptions(method="pem", estimate=("d",), hold="foh", second_look=False)
    fit = identify(model, [recording(0.005)], options)
    (d,) = fit.parameters
    assert abs(d.value - 0.25) < 5 * d.std_error + 0.05


@pytest.mark.parametrize("kind", [pytest.param("ekf", marks=pytest.mark.slow), "ukf"])
def test_filter_of_a_nonlinear_fmu(foreign, kind):
    model = declare(foreign, noises={"der(v)": 1e-4})
    data = recording(0.01, d=0.1)
    found = run_filter(
        dynamics(model),
        data,
        kind,
        FilterOptions(process_intensity=np.array([1e-4]), longest=np.inf, measurement_cov=np.array([1e-4])),
    )
    column = found.names.index("v")
    error = (found.values[:, column] - fall(TIME, FORCE)[1])[20:]
    assert np.sqrt(np.mean(error**2)) < 0.1
    assert np.mean(np.abs(error) < 3 * found.std[20:, column]) > 0.9


def test_comparison_tells_the_wrong_model_from_the_right_one(foreign):
    right = with_noises(foreign, {})
    data = [recording(0.005, d=0.1)]
    wrong = type(right)(**{**right.__dict__, "parameters": tuple(
        type(p)(**{**p.__dict__, "value": 0.6}) if p.name == "d" else p for p in right.parameters
    )})  # fmt: skip
    found = compare_models([Candidate("right", right, 0), Candidate("wrong", wrong, 0)], data)
    errors = [model.simulation.rms["y"] for model in found.models]
    assert errors[0] < 0.01 < errors[1]
    assert found.models[1].verdict == "falsified"


def test_noise_has_its_places(foreign):
    with pytest.raises(ModelError, match="no place") as caught:
        declare(foreign, noises={"d": 1.0})
    assert caught.value.code == "noise-place-unknown"


def test_co_simulation_simulates_and_identifies_and_refuses_the_rest(tmp_path):
    model = binary_model(ball(tmp_path, "CoSimulation"))
    assert [v.name for v in model.unknowns] == ["h", "v", "y", "w"]
    found = simulate(model, (TIME, FORCE[:, None]))
    assert np.allclose(found["y"], fall(TIME, FORCE)[0], atol=3e-3)
    fit = identify(model, [recording(0.005)], IdentifyOptions(method="oe", estimate=("d",), hold="foh"))
    (d,) = fit.parameters
    assert abs(d.value - 0.25) < 4 * d.std_error + 0.01
    comparison = compare_models([Candidate("ball", model, 0)], [recording(0.005, d=0.1)])
    assert comparison.models[0].simulation.rms["y"] < 0.01
    options = FilterOptions(measurement_cov=np.array([0.01]))
    for refused in (lambda: linearize(model), lambda: run_filter(model, recording(), "ekf", options)):
        with pytest.raises(FmuError) as caught:
            refused()
        assert caught.value.code == "fmu-co-simulation-only"


@pytest.mark.parametrize("method", ["oe", pytest.param("pem", marks=pytest.mark.slow)])
def test_linear_model_through_its_binary_equals_its_equations(drive_fmu, tmp_path, method):
    import fmu_models as models

    source = models.geared_drive()
    path = changed(drive_fmu, tmp_path / "alone.fmu", drop=["extra/"])
    alone = binary_model(path)
    assert is_affine_model(alone)
    grid = np.linspace(0.0, 2.0, 101)
    torque = np.sin(5.0 * grid)[:, None]
    expected, found = simulate(source, (grid, torque)), simulate(alone, (grid, torque))
    assert np.allclose(found.outputs, expected.outputs, rtol=1e-9, atol=1e-9 * np.abs(expected.outputs).max())
    noisy = expected.outputs + 0.01 * np.random.default_rng(0).standard_normal(expected.outputs.shape)
    data = Experiment("run", grid, torque, noisy, ("tau",), ("disc.w", "y"))
    options = IdentifyOptions(method=method, estimate=("c",), hold="foh")
    one, other = (identify(m, [data], options) for m in (source, alone))
    assert other.parameters[0].value == pytest.approx(one.parameters[0].value, rel=1e-4)
    assert other.log_likelihood == pytest.approx(one.log_likelihood, abs=1e-3)


@pytest.mark.slow  # test_modelica_models.py
def test_exported_nonlinear_model_alone_equals_its_equations(tmp_path):
    import fmu_models as models

    source = models.tank()
    export_fmu(source, tmp_path / "full.fmu")
    alone = binary_model(changed(tmp_path / "full.fmu", tmp_path / "alone.fmu", drop=["extra/"]))
    grid = np.linspace(0.0, 10.0, 101)
    flow = 0.3 + 0.2 * np.cos(grid)[:, None]
    expected, found = simulate(source, (grid, flow)), simulate(alone, (grid, flow))
    curved = [simulate(one, (grid, flow), hold="smooth") for one in (source, alone)]
    assert np.max(np.abs(curved[0].outputs - expected.outputs)) > 1e-5 * np.ptp(expected.outputs)
    np.testing.assert_allclose(curved[1].outputs, curved[0].outputs, rtol=1e-5, atol=1e-6)
    assert np.allclose(found.outputs, expected.outputs, atol=1e-6)
    assert np.allclose(found["q"], expected["q"], atol=1e-6)


def test_nonlinear_variable_that_no_state_reads_leaves_the_exact_way(tmp_path):
    """Power that is lost in resistors: the states follow linear laws, as in the source."""
    path = Path(__file__).parents[1] / "systems" / "models" / "HeatedServo.mo"
    source = compile_model(path, "HeatedServo.Circuit")
    export_fmu(source, tmp_path / "full.fmu")
    alone = binary_model(changed(tmp_path / "full.fmu", tmp_path / "alone.fmu", drop=["extra/"]))
    assert not is_affine_model(alone) and has_affine_dynamics(dynamics(alone))
    seen = declare(alone, outputs=["hot.LossPower"])
    assert not has_affine_dynamics(dynamics(seen))
    grid = np.linspace(0.0, 2.0, 101)
    voltage = np.sin(5.0 * grid)[:, None]
    expected, found = simulate(source, (grid, voltage)), simulate(alone, (grid, voltage))
    assert found.method == expected.method and found.method.startswith("matrix exponential")
    for name in ("winding.w", "hot.LossPower"):
        assert np.allclose(found[name], expected[name], atol=1e-9 * np.abs(expected[name]).max())


@pytest.mark.parametrize(
    "question",
    [
        linearize, is_affine_model, dynamics, with_noises, initial_point, integrator, values_along,
        family_along, local_model, has_affine_dynamics,
    ],
)  # fmt: skip
def test_both_kinds_of_models_answer(question):
    """What `model/flat.py` names: each is answered by the classes themselves, not by what refuses."""
    ours, refused = {FlatModel, ExplicitModel}, question.dispatch(object)
    foreign = {BinaryModel, BinaryDynamics}
    for kinds in (ours, foreign):
        assert len({question.dispatch(kind) for kind in kinds} - {refused}) == 1
