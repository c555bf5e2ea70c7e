"""FMU archives and descriptions that nobody wrote: a value or one message, never a fault."""

import io
import os
import re
import zipfile

import numpy as np
from ball_fmu import DESCRIPTION
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from daest.errors import DaestError
from daest.fmu.load import load_fmu, symbolic_model
from daest.fmu.semi_explicit import semi_explicit_form

TEXT = DESCRIPTION.replace("KIND", "ModelExchange").replace("INDICATORS", "1")
WORDS = (
    "0", "-1", "1e400", "nan", "99999999999999999999", "", "²", "x" * 300, "\N{SNOWMAN}", "true", "<",
    "&amp;", "input", "output", "parameter", "independent", "tunable", "discrete", "2.0", "3.0", "1.0",
    "ModelExchange", "CoSimulation", "Real", "Integer", "Float64", "Dimension", "Unknown", "Outputs", "../x",
    "4294967296",
)  # fmt: skip
TAGS = sorted(set(re.findall(r"<([A-Za-z]+)", TEXT)))
EXAMPLES = int(os.environ.get("DAEST_FUZZ", "50"))
RELAXED = settings(
    max_examples=EXAMPLES, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def tried(path):
    """What is done with an FMU before its binary is loaded."""
    try:
        model = load_fmu(path)
        semi_explicit_form(model)
        symbolic_model(path)
        return "read"
    except DaestError as error:
        assert error.what
        return error.code


def edited(seed, count):
    """The description, still well-formed, with values and names of elements replaced."""
    rng, text = np.random.default_rng(seed), TEXT
    for _ in range(count):
        if rng.random() < 0.8:
            places = [m.span(1) for m in re.finditer(r'="([^"]*)"', text)]
            start, end = places[rng.integers(len(places))]
            new = WORDS[rng.integers(len(WORDS))].replace("<", "&lt;")
            text = text[:start] + new + text[end:]
        else:
            old, new = (TAGS[i] for i in rng.integers(len(TAGS), size=2))
            text = re.sub(rf"(</?){old}\b", rf"\1{new}", text)
    return text


def archive_of(text):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", text)
        archive.writestr("binaries/linux64/ball.so", b"nothing")
    return stream.getvalue()


@RELAXED
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 4))
def test_values_of_a_description_replaced(tmp_path, seed, count):
    path = tmp_path / "f.fmu"
    path.write_bytes(archive_of(edited(seed, count)))
    tried(path)


@RELAXED
@given(where=st.integers(0, len(TEXT) - 1), length=st.integers(0, 40), new=st.text(max_size=20))
def test_parts_of_a_description_replaced(tmp_path, where, length, new):
    path = tmp_path / "f.fmu"
    text = TEXT[:where] + new + TEXT[where + length :]
    path.write_bytes(archive_of(text.encode("utf-8", "surrogatepass")))
    tried(path)


@RELAXED
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 30), cut=st.floats(0.0, 1.0))
def test_bytes_of_an_archive_changed(tmp_path, seed, count, cut):
    rng = np.random.default_rng(seed)
    content = bytearray(archive_of(TEXT))
    for _ in range(count):
        content[rng.integers(len(content))] = rng.integers(256)
    path = tmp_path / "f.fmu"
    path.write_bytes(bytes(content[: max(1, int(cut * len(content)))] if cut < 0.5 else content))
    tried(path)


@RELAXED
@given(name=st.text(min_size=1, max_size=30))
def test_names_of_members(tmp_path, name):
    path = tmp_path / "f.fmu"
    try:
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("modelDescription.xml", TEXT)
            archive.writestr(name, b"x")
    except (UnicodeEncodeError, ValueError, IndexError):
        return  # zipfile does not write it
    tried(path)
