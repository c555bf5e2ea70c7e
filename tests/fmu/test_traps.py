"""What FMUs of other tools do wrong or do otherwise, each with a small FMU that does it."""

import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from ball_fmu import DESCRIPTION, ball
from fmu_archives import changed
from tank_fmu import K, U, Y, levels, tank

from daest.errors import FmuError
from daest.fmu.drive import Drive
from daest.fmu.linearize import linearize_fmu
from daest.fmu.load import load_fmu
from daest.fmu.runner import Points, Runner
from daest.numerics.compiler import build_shared

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="built for Linux")


def test_error_state_ends_with_the_point_that_caused_it(tmp_path):
    levels_asked = np.array([[1.0], [-1.0], [4.0], [-2.0], [0.25]])
    points = Points((U,), np.full((5, 1), 2.0), levels_asked, np.zeros(5))
    with Runner(load_fmu(tank(tmp_path))) as runner:
        found = runner.evaluate(points, (Y,), ((K,), np.array([[0.5], [1.0]])), rates=True)
    assert "no level below zero" in found.problem
    good = [0, 2, 4]
    for values, k in zip(found.values, (0.5, 1.0), strict=True):
        assert np.all(np.isnan(values[[1, 3]]))
        h = levels_asked[good, 0]
        np.testing.assert_allclose(values[good], np.column_stack([2 * h, 2 - k * np.sqrt(h)]), rtol=1e-14)


def test_directional_derivatives_that_are_not_declared_are_not_asked_for(tmp_path):
    found = linearize_fmu(tank(tmp_path))
    names = [unknown.name for unknown in found.unknowns]
    J = found.J[:, names.index("h")]
    assert J[0] == pytest.approx(-0.25, rel=1e-6)  # -k / (2 sqrt(h)) at h = 1


@pytest.mark.parametrize("only_once", [False, True])
def test_many_simulations_of_an_fmu_with_one_instance(tmp_path, only_once):
    time = np.linspace(0.0, 2.0, 21)
    inflow = np.full((20, 1), 0.3)
    drive = Drive(time, (U,), inflow, inflow, inflow[0], (Y,))
    values = np.array([[0.5], [0.9], [0.5]])
    model = load_fmu(tank(tmp_path, only_once))
    assert model.only_once == only_once
    with Runner(model) as runner:
        found = runner.simulate(drive, ((K,), values))
        again = runner.simulate(drive, ((K,), values[1:]))
    assert found.stopped is None and again.stopped is None
    for k, simulated in zip(values[:, 0], found.values, strict=True):
        np.testing.assert_allclose(simulated[:, 0], 2 * levels(k, time), rtol=1e-6)
    np.testing.assert_allclose(again.values, found.values[1:], rtol=1e-12)


def test_clock_that_nobody_would_tick_is_refused(tmp_path):
    clock = '<Clock name="every10ms" valueReference="9" causality="CAUSALITY" intervalVariability="HOW"/>'
    for causality, how in (("input", "triggered"), ("local", "constant")):
        more = clock.replace("CAUSALITY", causality).replace("HOW", how)
        with pytest.raises(FmuError, match="every10ms") as caught:
            load_fmu(tank(tmp_path, more=more))
        assert caught.value.code == "fmu-clocked"
    told = clock.replace("CAUSALITY", "output").replace("HOW", "triggered")
    assert load_fmu(tank(tmp_path, more=told)).inputs == (U,)


@pytest.mark.parametrize("causality", ["input", "output"])
def test_array_inputs_and_outputs_are_refused_by_name(tmp_path, causality):
    array = (
        f'<Float64 name="field" valueReference="8" causality="{causality}"><Dimension start="2"/></Float64>'
    )
    with pytest.raises(FmuError, match="`field` is an array") as caught:
        load_fmu(tank(tmp_path, more=array))
    assert caught.value.code == "fmu-array-variable"


def test_inner_arrays_are_left_out_with_a_note(tmp_path):
    array = '<Float64 name="table" valueReference="8" causality="parameter"><Dimension start="2"/></Float64>'
    model = load_fmu(tank(tmp_path, more=array))
    assert model.parameters == (K,) and "table" in model.notes[0]


def test_library_that_the_binary_needs_is_named(tmp_path):
    absent = tmp_path / "libabsent_runtime.so.3"
    stub = build_shared(
        "int absent(void) { return 1; }", "stub", ("-O1", "-Wl,-soname,libabsent_runtime.so.3")
    )
    absent.write_bytes(stub.read_bytes())
    source = "int absent(void); " + (Path(__file__).parent / "fmi2_ball.c").read_text() + NEEDS
    library = build_shared(source, "ball", ("-O1", "-Wl,--no-as-needed", str(absent)))
    path = tmp_path / "ball.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        text = DESCRIPTION.replace("KIND", "ModelExchange").replace("INDICATORS", "0")
        archive.writestr("modelDescription.xml", text)
        archive.write(library, "binaries/linux64/ball.so")
    absent.unlink()
    nowhere = Points((), np.zeros((1, 0)), np.zeros((1, 0)), np.zeros(1))
    with (
        Runner(load_fmu(path)) as runner,
        pytest.raises(FmuError, match=r"libabsent_runtime\.so\.3") as caught,
    ):
        runner.evaluate(nowhere, ())
    assert caught.value.code == "fmu-binary-not-loaded" and "library" in caught.value.remedy


NEEDS = "\nint needs_it(void) { return absent(); }\n"


def test_functions_that_nobody_calls_may_be_missing(tmp_path):
    source = (Path(__file__).parent / "fmi3_tank.c").read_text()
    for name in ("fmi3SerializeFMUState", "fmi3GetAdjointDerivative", "fmi3GetNominalsOfContinuousStates"):
        assert name in source
        source = source.replace(f"REFUSE({name})", "").replace(f"{name}(", f"other_{name}(")
    path = changed(tank(tmp_path), tmp_path / "less.fmu", drop=["binaries/"], replace={
        "binaries/x86_64-linux/tank.so": build_shared(source, "tank", ("-O1", "-DONLY_ONCE=0")).read_bytes()
    })  # fmt: skip
    time = np.linspace(0.0, 2.0, 21)
    inflow = np.full((20, 1), 0.3)
    with Runner(load_fmu(path)) as runner:
        found = runner.simulate(Drive(time, (U,), inflow, inflow, inflow[0], (Y,)), ((), np.zeros((1, 0))))
    np.testing.assert_allclose(found.values[0][:, 0], 2 * levels(0.5, time), rtol=1e-6)


def test_binary_that_wears_out_goes_on_in_a_new_process(tmp_path):
    """It crashes at its fifth instance; more than five in one request are too many."""
    model = load_fmu(ball(tmp_path, WEARS_OUT=5))
    time, held = np.linspace(0.0, 1.0, 3), np.zeros((2, 1))
    drive = Drive(time, (4,), held, held, held[0], (5,))
    values = np.array([[0.1], [0.2], [0.3]])
    with Runner(model) as runner:
        first, second = (runner.simulate(drive, ((7,), values), np.ones((3, 2))).values for _ in range(2))
        np.testing.assert_array_equal(first, second)
        with pytest.raises(FmuError) as caught:
            runner.simulate(drive, ((7,), np.linspace(0.1, 0.5, 7)[:, None]), np.ones((7, 2)))
    assert caught.value.code == "fmu-crashed"


@pytest.mark.parametrize("told", [pytest.param("", marks=pytest.mark.slow), 'start="4"'])
def test_operating_point_is_the_start_of_the_fmu_and_not_of_its_description(tmp_path, told):
    """The level starts at 1, whatever the description says; at 0, without a word, there is no slope."""
    path = tank(tmp_path)
    with zipfile.ZipFile(path) as archive:
        text = archive.read("modelDescription.xml").decode()
    stated = 'name="h" valueReference="1" start="1"'
    assert stated in text
    text = text.replace(stated, f'name="h" valueReference="1" {told}').encode()
    other = changed(path, tmp_path / "other.fmu", replace={"modelDescription.xml": text})
    assert linearize_fmu(other).J[0, 0] == pytest.approx(-0.25, rel=1e-6)  # -k / (2 sqrt(h))
    assert linearize_fmu(other, at={"h": 4.0}).J[0, 0] == pytest.approx(-0.125, rel=1e-6)
