"""Archives and descriptions that are made to fill memory or time: refused, or read, within ten seconds."""

import subprocess
import sys
import time

import pytest
from hostile_archives import (
    DESCRIPTION,
    HEAD,
    TAIL,
    archive,
    deep,
    described,
    liar,
    long_directory,
    variables,
)

from daest.errors import FmuError
from daest.fmu.archive import open_archive
from daest.fmu.load import load_fmu

SECONDS = 10.0
MANY = 1_000_000
MEGABYTE = 1 << 20


def code_of(path) -> str:
    began = time.monotonic()
    try:
        load_fmu(path)
        code = "read"
    except FmuError as error:
        assert error.what and "\x1b" not in str(error)
        code = error.code
    assert time.monotonic() - began < SECONDS
    return code


@pytest.mark.parametrize(
    ("text", "code"),
    [
        pytest.param(
            lambda: variables((f"x{i}", i) for i in range(MANY)), "fmu-too-large", marks=pytest.mark.slow
        ),
        pytest.param(
            lambda: f"{HEAD}<!--{'x' * (100 * MEGABYTE)}-->{TAIL}", "fmu-too-large", marks=pytest.mark.slow
        ),
        pytest.param(
            lambda: f"{HEAD}<a {' '.join(f'a{i}=' + repr('1') for i in range(MANY))}/>{TAIL}",
            "fmu-too-large",
            marks=pytest.mark.slow,
        ),
        (lambda: f"{HEAD}<LogCategories>{'<x/>' * MANY}</LogCategories>{TAIL}", "fmu-too-large"),
        (lambda: variables((f"x{i}", 7) for i in range(30_000)), "read"),  # all are one variable
        (lambda: deep(100_000), "read"),
        (lambda: variables([("x", 1), ("x", 2)]), "fmu-inconsistent"),
        (lambda: variables([("", 1)]), "fmu-inconsistent"),
        (lambda: "<!DOCTYPE a [<!ENTITY b 'c'>]>" + variables([("&b;", 1)]), "fmu-xml"),
    ],
    ids=["variables", "comment", "attributes", "tags", "aliases", "depth", "twins", "nameless", "entity"],
)
def test_descriptions(tmp_path, text, code):
    assert code_of(described(tmp_path / "a.fmu", text())) == code


def test_names_cannot_write_to_the_terminal(tmp_path):
    """Characters that XML forbids are refused by the parser; others are shown as escapes."""
    odd = "a&#10;error[x]: b\u202e\u009b31mc\u200b"
    path = described(tmp_path / "a.fmu", variables([(odd, 1)]).replace('modelName="M"', f'modelName="{odd}"'))
    model = load_fmu(path)
    assert model.variables[1].name == "a\\nerror[x]: b\\u202e\\x9b31mc\\u200b" == model.model_name
    assert code_of(described(tmp_path / "b.fmu", variables([("\x1b[31m", 1)]))) == "fmu-xml"


@pytest.mark.parametrize("stated", [1000, 3 * 1024 * MEGABYTE])
def test_an_archive_that_lies_about_sizes(tmp_path, stated):
    """It holds 3 GB of zeros; a process with 600 MB of memory answers."""
    path = liar(tmp_path / "a.fmu", DESCRIPTION, 3 * 1024 * MEGABYTE, stated)
    script = (
        "import resource, sys\n"
        "from daest.errors import FmuError\n"
        "from daest.fmu.load import load_fmu\n"
        "resource.setrlimit(resource.RLIMIT_DATA, (600 << 20, 600 << 20))\n"
        "try:\n    load_fmu(sys.argv[1])\nexcept FmuError as error:\n    print(error.code)\n"
    )
    began = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-c", script, str(path)], capture_output=True, text=True, check=False
    )
    assert done.stdout.strip() in ("fmu-damaged", "fmu-too-large"), done.stderr
    assert time.monotonic() - began < SECONDS


def test_unpacked_content_is_counted(tmp_path, monkeypatch):
    """Two members that are small by the directory's word, and together above the limit."""
    monkeypatch.setattr("daest.fmu.archive.LARGEST_TOTAL", 3 * MEGABYTE)
    path = archive(tmp_path / "a.fmu", {f"resources/{i}": bytes(2 * MEGABYTE) for i in range(2)})
    monkeypatch.setattr("daest.fmu.archive._check_size", lambda *_: None)
    with pytest.raises(FmuError) as caught, open_archive(path) as opened:
        opened.unpack(tmp_path / "out", ("resources/",))
    assert caught.value.code == "fmu-too-large"


def test_a_directory_without_end(tmp_path):
    assert code_of(long_directory(tmp_path / "a.fmu", 1_000_000)) == "fmu-too-large"


@pytest.mark.parametrize("name", ["../x", "/x", "a/../../x", "C:/x", "..\\x"])
def test_paths_that_lead_outside(tmp_path, name):
    path = archive(tmp_path / "a.fmu", {DESCRIPTION: variables([("x", 1)]), name: b"x"})
    assert code_of(path) == "fmu-unsafe-path"
