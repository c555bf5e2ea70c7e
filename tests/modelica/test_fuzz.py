"""Damaged Modelica text never crashes, hangs or ends with a wrong code: it compiles, or is refused with a
message. DAEST_FUZZ sets the number of texts per test."""

import os
import time
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from daest.cli.main import run
from daest.errors import DaestError
from daest.modelica.compile import compile_text

N_TEXTS = int(os.environ.get("DAEST_FUZZ", "12"))
SECONDS = 30.0
"""Nothing may take longer, on a busy machine."""

ROOT = Path(__file__).parents[2]
SOURCES = [
    path.read_text() for path in sorted([*ROOT.glob("tests/*/models/*.mo"), *ROOT.glob("examples/*/*.mo")])
]
BASE_SOURCES = [path.read_text() for path in sorted(ROOT.glob("tests/*/models/*.bmo"))]
BASE_WORDS = ["'", "'mass.", ".s'", "[1]", "'Drive'", "//! base 0.1.0", "package 'Other'", "model 'M'"]
WORDS = [
    *(
        "model",
        "end",
        "equation",
        "algorithm",
        "connect",
        "der",
        "if",
        "then",
        "else",
        "elseif",
        "for",
        "loop",
    ),
    *("in", "when", "while", "(", ")", "[", "]", "{", "}", ";", ",", "=", ":=", "+", "-", "*", "/", "^"),
    *(
        ".",
        '"',
        "//",
        "/*",
        "*/",
        "1e999",
        "0",
        "-1",
        "1/0",
        '"text"',
        "Real",
        "Integer",
        "parameter",
        "constant",
    ),
    *("input", "output", "flow", "extends", "each", "final", "annotation(__Daest(noise = true))", "import"),
    *("within", "package", "function", "record", "break", "\ufeff", "\0", "é", ""),
]

fuzzed = settings(
    max_examples=N_TEXTS,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)


@st.composite
def damaged(draw, sources=SOURCES, words=WORDS) -> bytes:
    """A model of the tests with some pieces cut, doubled, moved, or replaced by words of the language."""
    text = draw(st.sampled_from(sources))
    for _ in range(draw(st.integers(1, 4))):
        start = draw(st.integers(0, len(text)))
        stop = min(len(text), start + draw(st.integers(0, 40)))
        piece = draw(st.sampled_from(["", text[start:stop] * 2, *words]))
        text = text[:start] + piece + text[stop:]
    return text.encode()


def check(content: bytes) -> None:
    started = time.monotonic()
    try:
        compile_text(content, Path("Fuzz.mo"))
    except DaestError as problem:
        assert problem.what and problem.code
        assert problem.code != "internal-error"
    assert time.monotonic() - started < SECONDS


@fuzzed
@given(damaged())
def test_damaged_models(content):
    check(content)


@fuzzed
@given(damaged(sources=BASE_SOURCES, words=[*WORDS, *BASE_WORDS]))
def test_damaged_base_modelica(content):
    check(content)


@fuzzed
@given(st.lists(st.sampled_from(WORDS), max_size=60))
def test_words_in_any_order(words):
    check(" ".join(["model M", *words]).encode())


@fuzzed
@given(st.binary(max_size=300))
def test_bytes_through_the_command(content):
    file = Path("Fuzz.mo")
    file.write_bytes(content)
    assert run(["linearize", str(file)]) == 2


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
