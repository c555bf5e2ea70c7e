"""The binaries of an FMU for several platforms: what they export and what they need, read by LIEF."""

import importlib.util
import zipfile

import pytest

from daest.fmu.export import export_fmu
from daest.modelica.compile import compile_text
from daest.numerics.compiler import PLATFORMS

lief = pytest.importorskip("lief")
pytestmark = pytest.mark.skipif(importlib.util.find_spec("ziglang") is None, reason="needs the ziglang wheel")

NAMES = ("linux64", "win64", "darwin64", "linux-arm64", "darwin-arm64")
PENDULUM = b"""model Pendulum
  input Real u(unit = "N.m");
  output Real phi(start = 0.1, fixed = true);
  Real w(start = 0, fixed = true);
equation
  der(phi) = w;
  der(w) = u - sin(phi) - exp(-w^2)*w + tanh(w);
end Pendulum;
"""

# What every FMI 3 importer of Model Exchange looks up, whatever the model can do.
NEEDED = [
    "fmi3GetVersion",
    "fmi3InstantiateModelExchange",
    "fmi3InstantiateCoSimulation",
    "fmi3FreeInstance",
    "fmi3EnterInitializationMode",
    "fmi3ExitInitializationMode",
    "fmi3EnterEventMode",
    "fmi3EnterContinuousTimeMode",
    "fmi3SetTime",
    "fmi3SetContinuousStates",
    "fmi3GetContinuousStates",
    "fmi3GetContinuousStateDerivatives",
    "fmi3GetFloat64",
    "fmi3SetFloat64",
    "fmi3GetDirectionalDerivative",
    "fmi3GetNumberOfContinuousStates",
    "fmi3CompletedIntegratorStep",
    "fmi3Terminate",
    "fmi3Reset",
    "fmi3SetDebugLogging",
]

SYSTEM = {
    "linux": ("libc.so.6", "libm.so.6", "ld-linux-aarch64.so.1"),
    "windows": ("KERNEL32.dll", "api-ms-win-crt-"),
    "darwin": ("/usr/lib/libSystem.B.dylib",),
}


@pytest.fixture(scope="module")
def binaries(tmp_path_factory):
    """The parsed binary of each platform, by the FMI name of the platform."""
    folder = tmp_path_factory.mktemp("platforms")
    flat = compile_text(PENDULUM, folder / "Pendulum.mo")
    export_fmu(flat, folder / "p.fmu", platforms=NAMES)
    with zipfile.ZipFile(folder / "p.fmu") as archive:
        archive.extractall(folder)
    parsed = {}
    for platform in PLATFORMS:
        if platform.short_name in NAMES:
            (file,) = (folder / "binaries" / platform.tuple_name).iterdir()
            assert file.suffix == platform.suffix
            parsed[platform.tuple_name] = lief.parse(str(file))
    return parsed


def exported(binary) -> set[str]:
    if isinstance(binary, lief.PE.Binary):
        return {entry.name for entry in binary.get_export().entries}
    prefix = "_" if isinstance(binary, lief.MachO.Binary) else ""
    return {symbol.name.removeprefix(prefix) for symbol in binary.exported_symbols}


def libraries(binary) -> set[str]:
    if isinstance(binary, lief.PE.Binary):
        return {entry.name for entry in binary.imports}
    if isinstance(binary, lief.MachO.Binary):
        own = lief.MachO.LoadCommand.TYPE.ID_DYLIB
        return {library.name for library in binary.libraries if library.command != own}
    return {str(name) for name in binary.libraries}


@pytest.mark.parametrize("name", [p.tuple_name for p in PLATFORMS if p.short_name in NAMES])
def test_exports_and_libraries(binaries, name):
    binary = binaries[name]
    names = exported(binary)
    assert set(NEEDED) <= names
    assert {n for n in names if not n.startswith("fmi3")} <= {"_mh_dylib_header", "__dso_handle"}
    system = SYSTEM[name.partition("-")[2]]
    needed = libraries(binary)
    assert needed and all(library.startswith(system) for library in needed)


@pytest.mark.parametrize("name", ["x86_64-linux", "aarch64-linux"])
def test_every_function_comes_from_a_library_that_is_named(binaries, name):
    imported = {symbol.name for symbol in binaries[name].imported_symbols}
    assert "sin" in imported and "libm.so.6" in libraries(binaries[name])


def test_an_old_system_will_do(binaries):
    versions = {
        tuple(int(part) for part in version.name.removeprefix("GLIBC_").split("."))
        for requirement in binaries["aarch64-linux"].symbols_version_requirement
        for version in requirement.get_auxiliary_symbols()
    }
    assert versions and max(versions) <= (2, 17)
