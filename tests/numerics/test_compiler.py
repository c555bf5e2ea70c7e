"""Finding a compiler, and keeping what it made."""

import contextvars
import ctypes
import os

import fmu_models as models
import pytest

from daest.errors import FmuError
from daest.fmu.export import export_fmu
from daest.fmu.load import load_fmu
from daest.numerics import compiler
from daest.systems.reduction.reduce import reduce_index
from daest.systems.simulation.integrate import integrator

SOURCE = "double twice(double x) { return FACTOR * x; }"


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("DAEST_CACHE", str(tmp_path / "cache"))


def test_compiles_once_for_the_same_text(monkeypatch):
    first = compiler.build_shared(SOURCE, "twice", ("-O1", "-DFACTOR=2"))
    assert ctypes.CDLL(str(first)).twice is not None
    monkeypatch.setattr(compiler, "_compile", lambda *_: pytest.fail("compiled again"))
    assert compiler.build_shared(SOURCE, "twice", ("-O1", "-DFACTOR=2")) == first


def test_other_flags_give_another_library():
    libraries = []
    for factor in (2, 3):
        path = compiler.build_shared(SOURCE, "twice", ("-O1", f"-DFACTOR={factor}"))
        function = ctypes.CDLL(str(path)).twice
        function.restype, function.argtypes = ctypes.c_double, [ctypes.c_double]
        libraries.append(function(5.0))
    assert libraries == [10.0, 15.0]


def test_libraries_share_an_object(tmp_path):
    common = compiler.build_object("double half(double x) { return FACTOR * x; }", "half", ("-DFACTOR=0.5",))
    other = compiler.build_object("double half(double x) { return FACTOR * x; }", "half", ("-DFACTOR=0.25",))
    source = "double half(double); double quarter(double x) { return half(half(x)); }"
    results = []
    for part in (common, other):
        function = ctypes.CDLL(str(compiler.build_shared(source, "quarter", objects=(part,)))).quarter
        function.restype, function.argtypes = ctypes.c_double, [ctypes.c_double]
        results.append(function(4.0))
    assert results == [1.0, 0.25]


def test_models_of_the_same_sizes_share_the_integrator(tmp_path):
    explicit = reduce_index(models.tank())
    for names in ([], [explicit.flat.parameters[0].name]):
        assert integrator(explicit, names).library is not None
    built = tmp_path / "cache" / "compiled"
    assert len(list(built.glob("*/radau.o"))) == 1
    assert len(list(built.glob(f"*/integrator{compiler.native_platform().suffix}"))) == 2


def test_compiler_complaint_is_shown():
    with pytest.raises(FmuError, match="FACTOR") as caught:
        compiler.build_shared(SOURCE, "twice")
    assert caught.value.code == "compilation-failed"


def test_no_compiler_says_what_to_install(monkeypatch):
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(compiler, "_zig", lambda: None)
    with pytest.raises(FmuError, match="No C compiler") as caught:
        compiler.find_compiler()
    assert caught.value.code == "no-c-compiler"
    assert "pip install daest[compiler]" in caught.value.remedy


def test_export_without_compiler_writes_nothing(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(compiler, "_zig", lambda: None)
    with pytest.raises(FmuError) as caught:
        export_fmu(models.tank(), tmp_path / "t.fmu")
    assert caught.value.code == "no-c-compiler"
    assert not (tmp_path / "t.fmu").exists()


def test_variable_cc_comes_first(monkeypatch):
    monkeypatch.setenv("CC", "sh -c")
    assert compiler.find_compiler().command[0].endswith("sh")
    assert compiler.find_compiler().command[1:] == ("-c",)


def test_unknown_platform_lists_the_known_ones():
    with pytest.raises(FmuError, match="amiga") as caught:
        compiler.platform_named("amiga")
    assert "win64" in caught.value.remedy


def test_unwritable_cache_does_not_stop_the_work(monkeypatch, tmp_path):
    """Nor is anything taken away from the folder for temporary files, which serves instead."""
    blocked, others = tmp_path / "file", tmp_path / "temporary" / "old"
    blocked.write_text("")
    others.mkdir(parents=True)
    (others / "large").write_bytes(bytes(1000))
    os.utime(others, (0, 0))
    monkeypatch.setattr("tempfile.tempdir", str(others.parent))
    compiler._spare_folder.cache_clear()
    monkeypatch.setenv("DAEST_CACHE", str(blocked / "below"))
    monkeypatch.setattr(compiler, "MOST_KEPT", 1)
    assert compiler.build_shared(SOURCE, "twice", ("-DFACTOR=2",)).is_file()
    compiler._spare_folder.cache_clear()
    assert (others / "large").stat().st_size == 1000


def test_cache_follows_the_environment(monkeypatch, tmp_path):
    monkeypatch.delenv("DAEST_CACHE")
    monkeypatch.setattr(compiler.sys, "platform", "linux")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert compiler.cache_folder() == tmp_path / "daest"


@pytest.mark.slow
def test_one_archive_for_three_systems(tmp_path, monkeypatch):
    pytest.importorskip("ziglang")
    monkeypatch.delenv("DAEST_CACHE")  # zig needs minutes for a new system; the user's cache keeps the result
    path = tmp_path / "t.fmu"
    result = export_fmu(models.tank(), path, platforms=("linux64", "win64", "darwin64"))
    assert result.validation == ()
    assert load_fmu(path).platforms == ("x86_64-darwin", "x86_64-linux", "x86_64-windows")


def test_long_code_is_optimised_less(monkeypatch):
    lines = [1, compiler.ASKED_LINES + 1, compiler.OPTIMISED_LINES + 1]
    for asked, efforts in (
        ("Og", ["-Og", "-Og", "-O0"]),
        ("O1", ["-O1", "-O1", "-O0"]),
        ("rm", ["-O3", "-O1", "-O0"]),
        ("", ["-O3", "-O1", "-O0"]),
    ):
        monkeypatch.setenv("DAEST_COMPILER_EFFORT", asked)
        assert [compiler.effort("x\n" * n, "-O3") for n in lines] == efforts


def test_a_long_compilation_is_told_once():
    heard = []
    source = "int answer(void) { return 42; }\n" + "\n" * compiler.TOLD_LINES

    def build():
        compiler.tell_of_compilations(heard.append)
        for _ in range(2):
            compiler.build_shared(source, "long", ("-O0",))
        compiler.build_shared("int short_one(void) { return 1; }\n", "short", ("-O0",))

    contextvars.copy_context().run(build)
    assert len(heard) == 1 and "lines of C" in heard[0]
