"""Reading FMUs of any tool, and refusing what is none."""

import re
import zipfile

import numpy as np
import pytest
from fmu_archives import changed, member

from daest.errors import FmuError
from daest.fmu.linearize import linearize_fmu
from daest.fmu.load import load_fmu
from daest.fmu.runner import Points, Runner

DESCRIPTION = "modelDescription.xml"
MANIFEST = "extra/org.fmi-standard.fmi-ls-dae/fmi-ls-manifest.xml"


def fmu_with(tmp_path, description, **more):
    path = tmp_path / "m.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(DESCRIPTION, description)
        for name, content in more.items():
            archive.writestr(name, content)
    return path


def fmi3(body="", variables="", exchange='<ModelExchange modelIdentifier="m"/>', structure=""):
    return (
        f'<fmiModelDescription fmiVersion="3.0" modelName="m" instantiationToken="t">{exchange}{body}'
        f'<ModelVariables><Float64 name="time" valueReference="0" causality="independent"/>{variables}'
        f"</ModelVariables><ModelStructure>{structure}</ModelStructure></fmiModelDescription>"
    )


def code(path):
    with pytest.raises(FmuError) as caught:
        load_fmu(path)
    assert caught.value.what
    return caught.value.code


def ask(path):
    """Load the binary and ask it for nothing."""
    with Runner(load_fmu(path)) as runner:
        runner.evaluate(Points((), np.zeros((1, 0)), np.zeros((1, 0)), np.zeros(1)), ())


def test_files_that_are_no_fmu(tmp_path):
    assert code(tmp_path / "nowhere.fmu") == "fmu-missing-file"
    (tmp_path / "empty.fmu").write_bytes(b"")
    assert code(tmp_path / "empty.fmu") == "fmu-empty-file"
    (tmp_path / "text.fmu").write_text("model Servo end Servo;")
    assert code(tmp_path / "text.fmu") == "fmu-not-an-archive"
    with zipfile.ZipFile(tmp_path / "other.fmu", "w") as archive:
        archive.writestr("readme.txt", "hello")
    assert code(tmp_path / "other.fmu") == "fmu-without-description"


def test_archive_that_was_cut_off(drive_fmu, tmp_path):
    (tmp_path / "cut.fmu").write_bytes(drive_fmu.read_bytes()[:5000])
    assert code(tmp_path / "cut.fmu") == "fmu-not-an-archive"


def test_member_with_wrong_bytes(drive_fmu, tmp_path):
    content = bytearray(drive_fmu.read_bytes())
    content[200:260] = bytes(60)
    (tmp_path / "bits.fmu").write_bytes(bytes(content))
    assert code(tmp_path / "bits.fmu") == "fmu-damaged"


@pytest.mark.parametrize("name", ["../evil.so", "/etc/evil", "a/../../evil", "..\\evil.dll", "C:/evil.dll"])
def test_paths_that_leave_the_folder(tmp_path, name):
    assert code(fmu_with(tmp_path, fmi3(), **{name: "x"})) == "fmu-unsafe-path"


def test_decompression_bomb(tmp_path):
    path = tmp_path / "bomb.fmu"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(DESCRIPTION, fmi3())
        archive.writestr("resources/zeros", bytes(80 * 1024**2))
    assert path.stat().st_size < 200_000
    assert code(path) == "fmu-too-large"


@pytest.mark.parametrize(
    "description",
    [
        "<fmiModelDescription",
        '<!DOCTYPE a [<!ENTITY b "c">]><fmiModelDescription fmiVersion="3.0">&b;</fmiModelDescription>',
        '<!DOCTYPE a SYSTEM "file:///etc/passwd"><fmiModelDescription fmiVersion="3.0"/>',
        "",
    ],
)
def test_xml_that_is_not_accepted(tmp_path, description):
    assert code(fmu_with(tmp_path, description)) == "fmu-xml"


def test_other_kinds_of_fmu(tmp_path):
    assert code(fmu_with(tmp_path, '<fmiModelDescription fmiVersion="1.0"/>')) == "fmu-fmi-1"
    for version in ("9.0", "3.0-beta.3", "2"):
        text = f'<fmiModelDescription fmiVersion="{version}"/>'
        assert code(fmu_with(tmp_path, text)) == "fmu-version"
    only_scheduled = fmi3(exchange='<ScheduledExecution modelIdentifier="m"/>')
    assert code(fmu_with(tmp_path, only_scheduled)) == "fmu-scheduled-only"


def test_co_simulation_has_no_linear_model(tmp_path):
    only_cs = fmu_with(tmp_path, fmi3(exchange='<CoSimulation modelIdentifier="m"/>'))
    assert load_fmu(only_cs).kind == "co-simulation"
    with pytest.raises(FmuError) as caught:
        linearize_fmu(only_cs)
    assert caught.value.code == "fmu-co-simulation-only"


def test_array_states_are_refused_by_name(tmp_path):
    variables = (
        '<Float64 name="x" valueReference="1" start="1 2 3"><Dimension start="3"/></Float64>'
        '<Float64 name="der(x)" valueReference="2" derivative="1"><Dimension start="3"/></Float64>'
    )
    structure = '<ContinuousStateDerivative valueReference="2"/>'
    path = fmu_with(tmp_path, fmi3(variables=variables, structure=structure))
    assert code(path) == "fmu-array-variable"


def test_state_derivative_without_state(tmp_path):
    path = fmu_with(tmp_path, fmi3(structure='<ContinuousStateDerivative valueReference="7"/>'))
    assert code(path) == "fmu-inconsistent"


def test_file_that_changes_is_read_again(tmp_path):
    first = load_fmu(fmu_with(tmp_path, fmi3(variables='<Float64 name="a" valueReference="1"/>')))
    assert load_fmu(first.path) is first
    second = load_fmu(fmu_with(tmp_path, fmi3(variables='<Float64 name="b" valueReference="1"/>')))
    assert (first.variables[1].name, second.variables[1].name) == ("a", "b")


def test_aliases_are_merged_by_value_reference(tmp_path):
    variables = (
        '<Float64 name="x" valueReference="1" start="2" nominal="0"><Alias name="position"/></Float64>'
        '<Float64 name="der(x)" valueReference="2" derivative="1"/>'
        '<Float64 name="y" valueReference="1" causality="output"/>'
        '<Float64 name="y2" valueReference="1" causality="output"/>'
    )
    path = fmu_with(
        tmp_path, fmi3(variables=variables, structure='<ContinuousStateDerivative valueReference="2"/>')
    )
    model = load_fmu(path)
    assert model.outputs == model.states == (1,)
    assert model.named("position").name == "y"
    assert (model.named("x").start, model.named("x").nominal) == (2.0, None)


def test_directional_derivatives_as_the_file_declares_them(tmp_path):
    declared = '<ModelExchange modelIdentifier="m" providesDirectionalDerivatives="true"/>'
    assert load_fmu(fmu_with(tmp_path, fmi3(exchange=declared))).provides_directional_derivatives
    assert not load_fmu(fmu_with(tmp_path, fmi3())).provides_directional_derivatives


def test_library_folders_count_only_with_the_library(tmp_path):
    folders = {"binaries/x86_64-linux/other.so": b"", "binaries/x86_64-windows/m.dll": b""}
    assert load_fmu(fmu_with(tmp_path, fmi3(), **folders)).platforms == ("x86_64-windows",)


def test_missing_binary_names_the_platforms_there_are(drive_fmu, tmp_path):
    path = changed(
        drive_fmu,
        tmp_path / "w.fmu",
        drop=["binaries/"],
        replace={"binaries/x86_64-windows/GearedDrive.dll": b""},
    )
    with pytest.raises(FmuError, match="x86_64-windows") as caught:
        linearize_fmu(path, source="fmi-ls-dae")
    assert caught.value.code == "fmu-without-binary"
    assert linearize_fmu(path).source == "symbolic"  # which needs none


def test_binary_that_is_no_library(drive_fmu, tmp_path):
    model = load_fmu(drive_fmu)
    name = f"binaries/{model.platforms[0]}/GearedDrive.so"
    if name not in zipfile.ZipFile(drive_fmu).namelist():
        pytest.skip("libraries end otherwise on this system")
    path = changed(drive_fmu, tmp_path / "b.fmu", replace={name: b"not a library"})
    with pytest.raises(FmuError) as caught:
        ask(path)
    assert caught.value.code == "fmu-binary-not-loaded"


def test_binary_of_another_model_is_refused(drive_fmu, tmp_path):
    text = member(drive_fmu, DESCRIPTION)
    other = re.sub(r'instantiationToken="[^"]*"', 'instantiationToken="{other}"', text)
    path = changed(drive_fmu, tmp_path / "t.fmu", replace={DESCRIPTION: other.encode()})
    with pytest.raises(FmuError, match="token") as caught:
        ask(path)
    assert caught.value.code == "fmu-call-failed"


ALGEBRAIC = '<AlgebraicVariables><AlgebraicVariable valueReference="3"/></AlgebraicVariables>'
NESTED = (
    '<ModelStructure><Residual><Formulation valueReference="9" index="2" dependencies="0 3"/>'
    '<Formulation valueReference="10"/></Residual><Residual><Formulation valueReference="10"/></Residual>'
    "</ModelStructure>"
)
FLAT = (
    '<ModelStructure><Residual valueReference="9" dependencies="0 3"/><Residual valueReference="10"/>'
    "</ModelStructure>"
)
SPACES = 'xmlns:f="urn:a" f:fmi-ls-version="0.0.1"'
FIRST_ROOT = "fmiLayeredStandardManifest"
DRAFTS = {
    "spring 2026": f'<{FIRST_ROOT} xmlns="urn:a" {SPACES}>{ALGEBRAIC}{NESTED}</{FIRST_ROOT}>',
    "with attribute": f'<{FIRST_ROOT} enableDAEModeVariable="_dae_mode" {SPACES}>{ALGEBRAIC}{NESTED}'
    f"</{FIRST_ROOT}>",
    "August 2026": f'<fmi-ls-dae xmlns="urn:a" {SPACES}><EnableDAE valueReference="1"/>{ALGEBRAIC}{NESTED}'
    "</fmi-ls-dae>",
    "September 2026": f'<fmiDAEManifest {SPACES}><EnableDAEParameter valueReference="1"/>{ALGEBRAIC}{FLAT}'
    "</fmiDAEManifest>",
}


@pytest.mark.parametrize("draft", DRAFTS)
def test_manifests_of_all_drafts(tank_fmu, tmp_path, draft):
    manifest = DRAFTS[draft].encode()
    found = load_fmu(changed(tank_fmu, tmp_path / "m.fmu", replace={MANIFEST: manifest})).manifest
    assert found.version == "0.0.1"
    assert found.algebraic == (3,)
    assert [r.value_reference for r in found.residuals] == [9, 10]
    assert [r.dependencies for r in found.residuals] == [(0, 3), None]
    assert found.enable == (None if draft == "spring 2026" else 1)


def test_what_a_co_simulation_fmu_says_of_states_does_not_matter(tmp_path):
    """A rate without a state is an error where states can be seen alone."""
    rate = '<Float64 name="rate" valueReference="1" causality="local"/>'
    structure = '<ContinuousStateDerivative valueReference="1"/>'
    hidden = fmi3(variables=rate, structure=structure, exchange='<CoSimulation modelIdentifier="m"/>')
    assert load_fmu(fmu_with(tmp_path, hidden)).states == ()
    assert code(fmu_with(tmp_path, fmi3(variables=rate, structure=structure))) == "fmu-inconsistent"
