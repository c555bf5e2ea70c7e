"""Exported FMUs against the standard's validator, exact solutions and finite differences."""

import tempfile
import zipfile

import casadi as ca
import fmpy
import fmu_models as models
import numpy as np
import pytest
from fmu_archives import member
from fmu_instance import open_instance

from daest.errors import FmuError
from daest.fmu.export import export_fmu, validate
from daest.fmu.instance import Refusal
from daest.fmu.load import load_fmu
from daest.model.flat import FlatModel
from daest.model.parts import Equation, Output, Parameter, Variable

STOP, INTERVAL = 4.0, 0.05


def simulate(path, start_values, outputs):
    return fmpy.simulate_fmu(
        str(path),
        stop_time=STOP,
        output_interval=INTERVAL,
        relative_tolerance=1e-10,
        start_values=start_values,
        output=outputs,
    )


@pytest.mark.parametrize("tuned", [{}, {"J2": 0.9}, {"n": 3.0, "c": 7.0}])
def test_simulation_equals_the_matrix_exponential(drive_fmu, tuned):
    result = simulate(
        drive_fmu, {"tau": 0.2, **tuned}, ["gear.phi", "disc.phi", "disc.w", "y", "_residual[7]"]
    )
    exact = models.drive_response(result["time"], 0.2, 0.0, 0.1, **tuned)
    assert np.abs(result["gear.phi"] - exact[:, 0]).max() < 1e-6
    assert np.abs(result["disc.phi"] - exact[:, 2]).max() < 1e-6
    assert np.abs(result["disc.w"] - exact[:, 3]).max() < 1e-6
    assert np.allclose(result["y"], np.rad2deg(result["disc.phi"]), rtol=1e-14)
    assert np.abs(result["_residual[7]"]).max() < 1e-12
    assert np.ptp(result["disc.w"]) > 0.1  # the drive really moves


def test_tuning_changes_the_result_and_the_calculated_parameter(drive_fmu):
    base = simulate(drive_fmu, {"tau": 0.2}, ["disc.w", "k_total"])
    tuned = simulate(drive_fmu, {"tau": 0.2, "J2": 0.9, "n": 4.0}, ["disc.w", "k_total"])
    assert np.abs(base["disc.w"] - tuned["disc.w"]).max() > 0.01
    assert (base["k_total"][0], tuned["k_total"][0]) == (15.0, 12.0)


def test_nonlinear_time_dependent_model_equals_radau(tank_fmu):
    result = simulate(tank_fmu, {"u": 0.25}, ["level", "q"])
    level = models.tank_response(result["time"], 0.25)
    assert np.abs(result["level"] - level).max() < 1e-6
    assert np.abs(result["q"] - 0.3 * np.sqrt(level**2 + 0.01)).max() < 1e-6


def test_validator_is_silent_and_names_are_structured(drive_fmu, tank_fmu):
    for path in (drive_fmu, tank_fmu):
        assert validate(path) == ()
        assert 'variableNamingConvention="structured"' in member(path, "modelDescription.xml")


def test_names_outside_the_structured_convention_are_flat_and_valid(tmp_path):
    flat = models.tank()
    renamed = FlatModel(**{**flat.__dict__, "outputs": (Output("level über alles"),)})
    path = tmp_path / "flat.fmu"
    assert export_fmu(renamed, path).validation == ()
    assert 'variableNamingConvention="flat"' in member(path, "modelDescription.xml")


def test_description_tells_units_starts_bounds_and_noise(drive_fmu):
    model = load_fmu(drive_fmu)
    J2, tau, w, k = (model.named(n) for n in ("J2", "tau", "w", "k_total"))
    assert (J2.causality, J2.variability, J2.start, J2.min, J2.unit) == (
        "parameter",
        "tunable",
        0.5,
        1e-9,
        "kg.m2",
    )
    assert (tau.causality, tau.start, tau.min, tau.max, tau.nominal) == ("input", 0.0, -1.0, 1.0, 0.1)
    assert (w.causality, w.start, w.description) == ("input", 0.0, "Torque noise")
    assert (k.causality, k.unit) == ("calculatedParameter", "N.m/rad")
    assert model.named("der(disc.w)").unit == "rad/s2"
    assert model.named("disc.phi").start == 0.1
    assert model.named("_residual[3]").description == "Residual of motor.J*motor.a = tau + w - torque"
    assert model.variables[model.outputs[0]].name == "disc.w"


def test_manifest_lists_every_equation_with_what_it_depends_on(drive_fmu):
    model = load_fmu(drive_fmu)
    manifest = model.manifest
    assert len(manifest.residuals) == 9
    assert {model.variables[vr].name for vr in manifest.algebraic} == {
        "motor.a",
        "gear.tau",
        "torque",
        "spring.tau",
    }
    torque_balance = manifest.residuals[2]
    names = {model.variables[vr].name for vr in torque_balance.dependencies}
    assert names == {"motor.a", "torque", "tau", "w", "J1"}


def _central(instance, known, references, step=1e-5):
    value = instance.get([known])[0]
    instance.set([known], [value + step])
    above = instance.get(references)
    instance.set([known], [value - step])
    below = instance.get(references)
    instance.set([known], [value])
    return (above - below) / (2 * step)


@pytest.mark.parametrize("dae_mode", [False, True])
@pytest.mark.parametrize("name", ["drive_fmu", "tank_fmu"])
def test_directional_derivatives_equal_finite_differences(request, name, dae_mode):
    model = load_fmu(request.getfixturevalue(name))
    residuals = [r.value_reference for r in model.manifest.residuals]
    rates = [vr for vr, v in model.variables.items() if v.derivative_of is not None]
    inner = [
        vr for vr, v in model.variables.items() if v.causality == "local" and vr not in residuals + rates
    ]
    if dae_mode:
        knowns = [*model.inputs, *model.parameters, *inner, *rates]
        unknowns = [*residuals, *model.outputs]
    else:
        knowns = [*model.inputs, *model.parameters, *model.states]
        unknowns = [*model.derivatives, *model.outputs, *inner]
    rng = np.random.default_rng(7)
    with open_instance(model, dae_mode=dae_mode) as instance:
        settable = [vr for vr in knowns if vr not in model.parameters]
        instance.set(settable, rng.uniform(0.5, 1.5, len(settable)))
        instance.set_time(0.7)
        largest = 0.0
        for known in knowns:
            exact = instance.directional(unknowns, known)
            assert np.allclose(exact, _central(instance, known, unknowns), rtol=1e-6, atol=1e-6)
            largest = max(largest, np.abs(exact).max())
    assert largest > 0.1


def test_dae_mode_reads_the_residual_of_the_given_point(tank_fmu):
    model = load_fmu(tank_fmu)
    vr = {
        name: model.named(name).value_reference
        for name in ("h[1]", "q", "der(h[1])", "_residual[1]", "_residual[2]")
    }
    with open_instance(model, dae_mode=True) as instance:
        instance.set_time(0.4)
        instance.set([vr["h[1]"], vr["q"], vr["der(h[1])"], *model.inputs], [0.3, 0.2, -1.5, 0.6])
        found = instance.get([vr["_residual[1]"], vr["_residual[2]"]])
    expected = [2.0 * -1.5 - (np.sin(0.4) * 0.6 - 0.2), 0.2 - 0.3 * np.sqrt(0.3**2 + 0.01)]
    assert np.allclose(found, expected, rtol=1e-14)


def test_algebraic_variables_cannot_be_set_in_ode_mode(tank_fmu):
    model = load_fmu(tank_fmu)
    with (
        open_instance(model) as instance,
        pytest.raises(Refusal, match="cannot be set in this mode"),
    ):
        instance.set([model.named("q").value_reference], [1.0])


def test_saved_state_brings_the_instance_back(drive_fmu):
    model = load_fmu(drive_fmu)
    with open_instance(model) as instance:
        instance.set_states(np.array([0.1, 0.2, 0.3, 0.4]))
        before = instance.rates()
        saved = instance._unit.getFMUState()
        bytes_of_state = instance._unit.serializeFMUState(saved)
        instance.set_states(np.zeros(4))
        assert not np.array_equal(instance.rates(), before)
        instance._unit.setFMUState(instance._unit.deserializeFMUState(bytes_of_state))
        assert np.array_equal(instance.rates(), before)
        instance._unit.freeFMUState(saved)


def test_two_instances_do_not_share_values(drive_fmu):
    model = load_fmu(drive_fmu)
    with open_instance(model) as one, open_instance(model) as other:
        one.set(model.parameters, [1.0] * 5)
        assert other.get(model.parameters).tolist() == [0.02, 0.5, 3.0, 0.2, 5.0]


def differentiator() -> FlatModel:
    """x = k u, v = der(x): the explicit form needs der(u)."""
    x, v, dx, dv, u, k = (ca.SX.sym(n) for n in ("x", "v", "dx", "dv", "u", "k"))
    return FlatModel(
        name="Differentiator",
        unknowns=(Variable("x"), Variable("v")),
        inputs=(Variable("u", "V"),),
        noises=(),
        parameters=(Parameter("k", 2.0),),
        outputs=(Output("y"),),
        equations=(Equation("v = der(x)", "component", ""), Equation("x = k*u", "component", "")),
        derivatives=ca.vertcat(dx, dv),
        xi=ca.vertcat(x, v),
        u=u,
        w=ca.SX(0, 1),
        theta=k,
        time=ca.SX.sym("t"),
        residual=ca.vertcat(v - dx, x - k * u),
        output_expressions=v,
    )


def test_needed_input_derivative_is_an_input(tmp_path):
    path = tmp_path / "d.fmu"
    result = export_fmu(differentiator(), path)
    assert result.input_derivatives == ("der(u)",)
    assert result.validation == ()
    model = load_fmu(path)
    assert model.named("der(u)").unit == "V/s"
    with open_instance(model) as instance:
        instance.set([model.named("der(u)").value_reference], [3.0])
        assert instance.get([model.named("y").value_reference]) == 6.0


def test_same_model_gives_the_same_bytes(tmp_path):
    for name in ("a.fmu", "b.fmu"):
        export_fmu(models.tank(), tmp_path / name)
    assert (tmp_path / "a.fmu").read_bytes() == (tmp_path / "b.fmu").read_bytes()


def test_sources_travel_with_the_binary_and_hold_no_temporary_path(drive_fmu):
    with zipfile.ZipFile(drive_fmu) as archive:
        names = archive.namelist()
        contents = b"".join(archive.read(n) for n in names)
    assert {"sources/fmi3.c", "sources/model.c", "sources/model.h", "sources/buildDescription.xml"} <= set(
        names
    )
    assert tempfile.gettempdir().encode() not in contents


def test_failed_export_leaves_the_old_file_alone(tmp_path, monkeypatch):
    path = tmp_path / "old.fmu"
    path.write_bytes(b"precious")

    def refuse(*_, **__):
        raise FmuError("compilation-failed", "no")

    monkeypatch.setattr("daest.fmu.export.build_shared", refuse)
    with pytest.raises(FmuError):
        export_fmu(models.tank(), path)
    assert path.read_bytes() == b"precious"
    assert list(tmp_path.iterdir()) == [path]


def test_folder_that_does_not_exist_is_refused(tmp_path):
    with pytest.raises(FmuError) as caught:
        export_fmu(models.tank(), tmp_path / "no" / "x.fmu")
    assert caught.value.code == "fmu-not-written"


def test_clashing_names_are_refused(tmp_path):
    flat = models.tank()
    clash = FlatModel(**{**flat.__dict__, "parameters": (Parameter("q", 2.0), Parameter("k", 0.3))})
    with pytest.raises(FmuError, match="`q`") as caught:
        export_fmu(clash, tmp_path / "x.fmu")
    assert caught.value.code == "fmu-name-twice"
