"""E, J, K, B, C from FMUs: through the residuals of the binary, and without them."""

import sys
import zipfile
from pathlib import Path

import fmu_models as models
import numpy as np
import pytest
from fmu_archives import changed, member

from daest.errors import ConfigError, FmuError
from daest.fmu import semi_explicit, serialization
from daest.fmu.binary_model import binary_model
from daest.fmu.description import DAE_FOLDER, MANIFEST
from daest.fmu.linearize import available_sources, cross_check_fmu, linearize_fmu, matrices_apart
from daest.fmu.load import load_fmu
from daest.fmu.points import difference
from daest.fmu.runner import Evaluated
from daest.numerics.compiler import build_shared
from daest.systems.linear.linearize import linear_dae_function, linearize

TIGHT = 1e-12


@pytest.fixture
def stripped(drive_fmu, tmp_path):
    return changed(drive_fmu, tmp_path / "stripped.fmu", drop=[serialization.FOLDER])


def test_binary_alone_gives_the_same_dae_as_the_model(stripped):
    flat = models.geared_drive()
    expected, found = linearize(flat), linearize_fmu(stripped)
    assert found.source == "fmi-ls-dae"
    for name in ("E", "J", "K", "B", "C", "D", "H", "offset", "output_offset"):
        assert np.allclose(getattr(found, name), getattr(expected, name), rtol=1e-15, atol=0.0), name
    for name in ("equations", "unknowns", "inputs", "noises", "outputs", "parameters", "is_affine"):
        assert getattr(found, name) == getattr(expected, name), name


@pytest.mark.parametrize(
    "numbers", [(3,), pytest.param((0, 1, 2, 4), marks=pytest.mark.slow)], ids=["one", "others"]
)
def test_parameter_derivatives_of_the_binary_equal_the_symbolic_ones(stripped, numbers):
    flat = models.geared_drive()
    theta = flat.theta_values
    jacobian = linear_dae_function(flat).jacobian()
    exact = jacobian(theta, *linear_dae_function(flat)(theta))
    assert theta.size == 5
    for i in numbers:
        step = 1e-4 * theta[i]
        up, down = (linearize_fmu(stripped, theta + s * np.eye(5)[i]) for s in (step, -step))
        for k, name in enumerate(("E", "J", "K")):
            difference = (getattr(up, name) - getattr(down, name)) / (2 * step)
            assert np.allclose(difference.ravel("F"), exact[k].toarray()[:, i], atol=1e-9), name


@pytest.mark.parametrize(
    ("fixture", "build"),
    [pytest.param("drive_fmu", models.geared_drive, marks=pytest.mark.slow), ("tank_fmu", models.tank)],
)
def test_residuals_without_directional_derivatives_are_differenced(request, tmp_path, fixture, build):
    path = request.getfixturevalue(fixture)
    silent = member(path, "modelDescription.xml").replace('providesDirectionalDerivatives="true"', "")
    copy = changed(path, tmp_path / "silent.fmu", replace={"modelDescription.xml": silent.encode()})
    found, expected = linearize_fmu(copy, source="fmi-ls-dae"), linearize(build())
    assert found.is_affine == expected.is_affine
    assert matrices_apart(found, expected, floor=1e-6) < 1e-7


def test_row_that_is_zero_in_truth_does_not_spoil_the_comparison():
    exact = np.array([[3.0, 4.0], [0.0, 0.0]])
    noisy = exact + np.array([[1e-11, 0.0], [-1e-12, 2e-12]])
    assert difference([exact], [noisy]) == 1.0
    assert difference([exact], [noisy], floor=1e-6) < 1e-6


def test_new_parameter_values_reach_every_source(drive_fmu):
    theta = np.array([0.05, 0.7, 9.0, 0.4, 2.0])
    expected = linearize(models.geared_drive(), theta)
    for source in ("symbolic", "fmi-ls-dae"):
        assert matrices_apart(linearize_fmu(drive_fmu, theta, source=source), expected) < TIGHT


def test_nonlinear_model_at_a_point(tank_fmu):
    at = {"h[1]": 0.9, "q": 0.1, "u": 0.5, "der(h[1])": 0.2}
    expected = linearize(models.tank(), at=at)
    found = linearize_fmu(tank_fmu, at=at, source="fmi-ls-dae")
    assert not found.is_affine
    assert matrices_apart(found, expected) < TIGHT
    assert found.J[1, 0] == pytest.approx(0.3 * 0.9 / np.sqrt(0.9**2 + 0.01), rel=1e-14)


def test_start_values_are_used_and_told_when_no_point_is_given(tank_fmu):
    found = linearize_fmu(tank_fmu, source="fmi-ls-dae")
    assert matrices_apart(found, linearize(models.tank())) < TIGHT
    assert "start values" in found.notes[0]


def test_unknown_name_in_the_operating_point(tank_fmu):
    for source in ("symbolic", "fmi-ls-dae", "directional derivatives"):
        with pytest.raises(ConfigError, match="nonsense") as caught:
            linearize_fmu(tank_fmu, at={"nonsense": 1.0}, source=source)
        assert caught.value.code == "operating-point-unknown-name"


def test_unknown_source(tank_fmu):
    with pytest.raises(ConfigError, match="guess") as caught:
        linearize_fmu(tank_fmu, source="guess")
    assert caught.value.code == "fmu-source"


@pytest.mark.parametrize("source", ["directional derivatives", "finite differences"])
def test_semi_explicit_form_has_the_poles_and_the_gain_of_the_plant(drive_fmu, source):
    dae = linearize_fmu(drive_fmu, source=source)
    A, B = models.drive_state_space()
    assert dae.source == source
    assert dae.is_affine
    s = 0.7 + 2.0j
    transfer = dae.C @ np.linalg.solve(s * dae.E - dae.J, dae.K)
    expected = np.linalg.solve(s * np.eye(4) - A, B)
    assert transfer[0, 0] == pytest.approx(expected[3], rel=1e-9)
    assert transfer[1, 0] == pytest.approx(expected[2] * 180 / np.pi, rel=1e-9)


def test_sources_agree(drive_fmu, tank_fmu):
    for path in (drive_fmu, tank_fmu):
        found = cross_check_fmu(path)
        assert found["symbolic - fmi-ls-dae"] < TIGHT
        assert found["directional derivatives - finite differences"] < 1e-8
        assert found["largest"] == max(v for k, v in found.items() if k != "largest")


def test_cross_check_sees_a_wrong_symbolic_model(drive_fmu, tmp_path):
    flat = models.geared_drive()
    wrong = type(flat)(**{**flat.__dict__, "residual": flat.residual * 1.001})
    files = {f"{serialization.FOLDER}/{n}": t.encode() for n, t in serialization.serialize(wrong).items()}
    found = cross_check_fmu(changed(drive_fmu, tmp_path / "wrong.fmu", replace=files))
    assert found["largest"] == pytest.approx(1e-3, rel=0.01)


OSCILLATOR = """<fmiModelDescription fmiVersion="2.0" modelName="oscillator" guid="{oscillator}">
<ModelExchange modelIdentifier="oscillator" providesDirectionalDerivative="DECLARED"/>
<TypeDefinitions><SimpleType name="Length"><Real unit="m" nominal="0"/></SimpleType></TypeDefinitions>
<ModelVariables>
<ScalarVariable name="x1" valueReference="0"><Real declaredType="Length" start="1"/></ScalarVariable>
<ScalarVariable name="der(x1)" valueReference="2"><Real derivative="1"/></ScalarVariable>
<ScalarVariable name="count" valueReference="0" variability="discrete"><Integer/></ScalarVariable>
<ScalarVariable name="x2" valueReference="1"><Real/></ScalarVariable>
<ScalarVariable name="der(x2)" valueReference="3"><Real derivative="4"/></ScalarVariable>
<ScalarVariable name="u" valueReference="4" causality="input"><Real start="0"/></ScalarVariable>
<ScalarVariable name="u_alias" valueReference="4" causality="input"><Real start="0"/></ScalarVariable>
<ScalarVariable name="y" valueReference="5" causality="output"><Real/></ScalarVariable>
<ScalarVariable name="z" valueReference="6"><Real/></ScalarVariable>
<ScalarVariable name="k" valueReference="7" causality="parameter" variability="tunable">
<Real start="4"/></ScalarVariable>
</ModelVariables>
<ModelStructure><Outputs><Unknown index="8"/></Outputs>
<Derivatives><Unknown index="2"/><Unknown index="5"/></Derivatives></ModelStructure>
</fmiModelDescription>"""


def oscillator(tmp_path, forgets_alias, declared="true", *flags):
    """An FMI 2.0 FMU with stale aliases, an event iteration, and wrong derivatives if `forgets_alias`."""
    if not sys.platform.startswith("linux"):
        pytest.skip("built for Linux")
    source = (Path(__file__).parent / "fmi2_oscillator.c").read_text()
    library = build_shared(source, "oscillator", ("-O1", f"-DFORGETS_ALIAS={int(forgets_alias)}", *flags))
    path = tmp_path / "oscillator.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", OSCILLATOR.replace("DECLARED", declared))
        archive.write(library, "binaries/linux64/oscillator.so")
    return path


EXACT_A = np.array(
    [[0.0, 1.0, 0.0, 0.0], [-4.0, 0.0, 0.0, 0.0], [1.0, 0.0, -1.0, 0.0], [1.0, 2.0, 0.0, -1.0]]
)


@pytest.mark.parametrize(
    ("forgets_alias", "declared", "source"),
    [
        (False, "true", "directional derivatives"),
        (True, "true", "finite differences"),
        (True, "false", "finite differences"),
    ],
)
def test_fmu_of_another_tool(tmp_path, forgets_alias, declared, source):
    dae = linearize_fmu(oscillator(tmp_path, forgets_alias, declared))
    assert dae.source == source
    assert [v.name for v in dae.unknowns] == ["x1", "x2", "y", "z"]
    assert [v.name for v in dae.inputs] == ["u"]
    assert dae.unknowns[0].unit == "m"
    assert np.allclose(dae.E, np.diag([1.0, 1.0, 0.0, 0.0]))
    assert np.allclose(dae.J, EXACT_A, atol=1e-8)
    assert np.allclose(dae.K, [[0.0], [1.0], [0.0], [0.0]], atol=1e-8)
    assert np.allclose(dae.C, [[0.0, 0.0, 1.0, 0.0]])
    told = any("wrong" in note for note in dae.notes)
    assert told == (forgets_alias and declared == "true")


@pytest.mark.parametrize(
    "habit", [1, 2, pytest.param(3, marks=pytest.mark.slow)], ids=["refused", "wrong", "no-number"]
)
def test_directional_derivatives_are_taken_without_those_of_internal_variables(tmp_path, habit):
    path = oscillator(tmp_path, False, "true", f"-DPROMISED_ALONE={habit}")
    dae = linearize_fmu(path)
    assert dae.source == "directional derivatives"
    assert any("internal variables" in note for note in dae.notes)
    assert np.array_equal(dae.J[:3], EXACT_A[:3])  # the FMU's own have no rounding
    assert np.allclose(dae.J[3], EXACT_A[3], atol=1e-8)
    assert not binary_model(path).form.trusts_directional


def test_parameters_reach_the_fmu_of_another_tool(tmp_path):
    dae = linearize_fmu(oscillator(tmp_path, False), theta=np.array([9.0]))
    assert dae.J[1, 0] == -9.0
    assert dae.parameters[0].value == 9.0


def test_fmu_of_another_tool_has_no_residuals(tmp_path):
    path = oscillator(tmp_path, False)
    assert available_sources(load_fmu(path)) == ("directional derivatives", "finite differences")
    for source, code in (("fmi-ls-dae", "fmu-without-residuals"), ("symbolic", "fmu-no-symbolic-model")):
        with pytest.raises(FmuError) as caught:
            linearize_fmu(path, source=source)
        assert caught.value.code == code


def test_large_fmus_keep_their_outputs_only(tmp_path, monkeypatch):
    monkeypatch.setattr(semi_explicit, "MOST_VARIABLES", 1)
    dae = linearize_fmu(oscillator(tmp_path, False))
    assert [v.name for v in dae.unknowns] == ["x1", "x2", "y"]
    assert "only its outputs are kept" in dae.notes[0]


SEMI_EXPLICIT = """<fmiModelDescription fmiVersion="3.0" modelName="m" instantiationToken="t">
<ModelExchange modelIdentifier="m" providesDirectionalDerivatives="true"/><ModelVariables>
<Float64 name="time" valueReference="0" causality="independent"/>
<Float64 name="x" valueReference="1" start="0.5"/><Float64 name="der(x)" valueReference="2" derivative="1"/>
<Float64 name="a" valueReference="3"/><Float64 name="u" valueReference="4" causality="input" start="0"/>
<Float64 name="y" valueReference="5" causality="output"/><Float64 name="r" valueReference="6"/>
</ModelVariables><ModelStructure><ContinuousStateDerivative valueReference="2"/></ModelStructure>
</fmiModelDescription>"""
SEMI_EXPLICIT_MANIFEST = """<fmiDAEManifest><EnableDAEParameter valueReference="9"/><AlgebraicVariables>
<AlgebraicVariable valueReference="3"/></AlgebraicVariables><ModelStructure>
<ContinuousStateDerivative valueReference="2"/><Residual valueReference="6"/>
</ModelStructure></fmiDAEManifest>"""


# Rows: x', y, r of the fake below. Columns: x, a, u, 1.
TABLE = {2: (-3.0, 1.0, 0.0, 7.0), 5: (1.0, 1.0, 0.0, 0.0), 6: (-2.0, 1.0, 5.0, -1.0)}
COLUMNS = {1: 0, 3: 1, 4: 2}


class SemiExplicitRunner:
    """x' = -3 x + a + 7, 0 = r = a - 2 x + 5 u - 1, y = x + a, as an importer sees it in DAE mode."""

    def __init__(self, model):
        self.model = model

    def evaluate(self, points, read, parameters, *, dae_mode):
        assert dae_mode
        rows = np.zeros((len(points.times), 4))
        rows[:, 3] = 1.0
        for reference, column in COLUMNS.items():
            rows[:, column] = points.values[:, points.set.index(reference)]
        return Evaluated((rows @ np.array([TABLE[r] for r in read]).T)[None])

    def differentiate(self, points, unknowns, knowns, parameters, *, dae_mode):
        assert dae_mode
        table = [[TABLE[u][COLUMNS[k]] for k in knowns] for u in unknowns]
        return np.array(table).reshape(1, 1, len(unknowns), len(knowns))


def test_semi_explicit_manifest_of_another_tool(tmp_path):
    path = tmp_path / "m.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", SEMI_EXPLICIT)
        archive.writestr(f"{DAE_FOLDER}/{MANIFEST}", SEMI_EXPLICIT_MANIFEST)
    dae = linearize_fmu(path, runner=SemiExplicitRunner(load_fmu(path)))
    assert dae.source == "fmi-ls-dae"
    assert [v.name for v in dae.unknowns] == ["x", "a"]
    assert np.array_equal(dae.E, [[1.0, 0.0], [0.0, 0.0]])
    # E ξ' = J ξ + K u + offset: der(x) = -3 x + a + 7 and 0 = 2 x - a - 5 u + 1
    assert np.array_equal(dae.J, [[-3.0, 1.0], [2.0, -1.0]])
    assert np.array_equal(dae.K, [[0.0], [-5.0]])
    assert np.array_equal(dae.offset, [7.0, 1.0])
    assert np.array_equal(dae.C, [[1.0, 1.0]])
