"""Whatever stands in a recording or in daest.toml: a table or a project, else one message; never a crash."""

import os

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from daest.cli.main import run
from daest.data.check import check_table
from daest.data.project import Project, load_project
from daest.data.read import read_table
from daest.errors import EXPLANATIONS, ConfigError, DataError

# More with DAEST_FUZZ=10000.
EXAMPLES = int(os.environ.get("DAEST_FUZZ", "25"))
fuzz = settings(
    max_examples=EXAMPLES, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck)
)

CELLS = st.one_of(
    st.floats(width=32).map(str),
    st.integers(-5, 5).map(str),
    st.sampled_from(["", "nan", "1,5", "-", "x", '"', "V", "[s]", "2026-11-21", "1e999", "#", "sep=;", "٣"]),
    st.text(max_size=4),
)
SEPARATORS = st.sampled_from([",", ";", "\t", "|", " "])
NAMES = st.sampled_from(["time", "time [ms]", "time_s", "u", "phi [rad]", "y (deg)", "", "#time", "1"])


@st.composite
def recordings(draw):
    """Bytes that look like a CSV file, more or less."""
    separator = draw(SEPARATORS)
    names = draw(st.lists(NAMES, min_size=1, max_size=4))
    regular = draw(st.booleans())
    rows = [names]
    for i in range(draw(st.integers(0, 6))):
        width = len(names) if regular else draw(st.integers(0, 5))
        cells = draw(st.lists(CELLS, min_size=width, max_size=width))
        rows.append([str(0.1 * i), *cells[1:]] if regular and cells else cells)
    text = draw(st.sampled_from(["\n", "\r\n", "\r"])).join(separator.join(row) for row in rows)
    encoding = draw(st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "cp1252"]))
    return text.encode(encoding, "replace")


KEYS = st.sampled_from(
    ["model", "data", "parameters", "noise", "process", "source", "estimate", "split", "inputs", "min", "x"]
)
VALUES = st.recursive(
    st.one_of(
        st.sampled_from(["true", "1", "-1.5", "nan", "inf", '"a"', "'Lag.mo'", "2026-11-21", "x", '"'])
    ),
    lambda inner: st.one_of(
        st.lists(inner, max_size=2).map(lambda items: f"[{', '.join(items)}]"),
        st.dictionaries(KEYS, inner, max_size=2).map(
            lambda table: "{" + ", ".join(f"{k} = {v}" for k, v in table.items()) + "}"
        ),
    ),
    max_leaves=4,
)
LINES = st.one_of(
    st.tuples(KEYS, VALUES).map(" = ".join),
    KEYS.map("[{}]".format),
    st.tuples(KEYS, KEYS).map("[{0[0]}.{0[1]}]".format),
    st.text(max_size=8),
)


def read_or_refuse(path):
    try:
        check_table(read_table(path))
    except DataError as error:
        assert error.code in EXPLANATIONS and error.what


@fuzz
@given(raw=st.one_of(recordings(), st.binary(max_size=200)))
def test_csv(tmp_path_factory, raw):
    path = tmp_path_factory.getbasetemp() / "fuzz.csv"
    path.write_bytes(raw)
    read_or_refuse(path)


@fuzz
@given(
    raw=st.binary(max_size=300), start=st.sampled_from([b"", b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM"])
)
def test_mat(tmp_path_factory, raw, start):
    path = tmp_path_factory.getbasetemp() / "fuzz.mat"
    path.write_bytes(start + raw)
    read_or_refuse(path)


@fuzz
@given(lines=st.lists(LINES, max_size=8), raw=st.binary(max_size=5))
def test_toml(tmp_path_factory, lines, raw):
    path = tmp_path_factory.getbasetemp() / "fuzz.toml"
    path.write_bytes("\n".join(lines).encode("utf-8", "replace") + raw)
    try:
        assert isinstance(load_project(path), Project)
    except ConfigError as error:
        assert error.code in EXPLANATIONS and str(path) in str(error)


@fuzz
@given(raw=recordings(), lines=st.lists(LINES, max_size=4))
def test_exit_codes(tmp_path_factory, raw, lines):
    folder = tmp_path_factory.getbasetemp()
    (folder / "fuzz.csv").write_bytes(raw)
    (folder / "fuzz.toml").write_text("\n".join(lines), "utf-8", "replace")
    assert run(["check", str(folder / "fuzz.csv")]) in (0, 1, 2)
    assert run(["check", str(folder / "fuzz.csv"), "-p", str(folder / "fuzz.toml")]) in (0, 1, 2)


def test_no_internal_error(tmp_path_factory, capsys):
    test_exit_codes(tmp_path_factory)
    captured = capsys.readouterr()
    assert "internal-error" not in captured.err and "Traceback" not in captured.err
