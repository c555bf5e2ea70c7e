"""Long files and whole commands: rows of `speed.py`."""

from __future__ import annotations

import re
import shutil
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from timed import Row, children, in_turn, process

from daest.data.check import check_table
from daest.data.read import read_table
from daest.data.table import Part

EXAMPLE = Path(__file__).parents[1] / "examples" / "servo" / "Servo.mo"
MANY = 100_000  # variables of an FMU


def table_rows(folder: Path, n_rows: int, repeat: int) -> Iterator[Row]:
    import pyarrow as pa
    from pyarrow import csv

    rng, k, path = np.random.default_rng(0), np.arange(n_rows), folder / "long.csv"
    u = np.sin(1e-3 * k)
    signals = (1e-3 * k, u, u + 0.1 * rng.standard_normal(n_rows), np.cos(1e-4 * k))
    columns = [pa.array(np.round(values, 5)) for values in signals]
    csv.write_csv(
        pa.table(columns, ["time", "u", "omega", "phi"]), path, csv.WriteOptions(quoting_header="none")
    )
    import pandas as pd

    runs = [lambda: check_table(read_table(path)), lambda: pd.read_csv(path)]
    ours, theirs = in_turn(runs, repeat)
    yield Row(f"check of {n_rows} rows of CSV", "s", ours, "pandas reads them", theirs)
    (part,) = in_turn([lambda: read_table(path, Part(None, None, 5.0))], repeat)
    yield Row(f"the first 5000 of {n_rows} rows of CSV", "s", part)


def process_rows(folder: Path, repeat: int) -> Iterator[Row]:
    fmu = folder / "servo.fmu"
    process(["-m", "daest", "export", str(EXAMPLE), "-o", str(fmu)])()
    words = {"_DAEST_COMPLETE": "bash_complete", "COMP_WORDS": "daest identify --esti", "COMP_CWORD": "2"}
    linearize = ["-m", "daest", "linearize", str(fmu)]
    runs = [
        process(["-c", "import numpy, scipy.linalg, scipy.sparse, casadi"]),
        with_empty_cache(linearize, folder / "emptied"),
        process(linearize, DAEST_CACHE=str(folder / "filled")),
        process(["-m", "daest"], **words),
        process(["-m", "daest", "--help"]),
    ]
    runs.append(process(["-m", "daest", "linearize", str(with_many_variables(fmu, folder / "many.fmu"))]))
    loads, *found = children(runs, repeat)
    names = (
        "`daest linearize servo.fmu`, first",
        "`daest linearize servo.fmu`, again",
        "one Tab",
        "`daest --help`",
        f"the same FMU with {MANY} variables",
    )
    for name, seconds in zip(names, found, strict=True):
        yield Row(f"{name}, whole process", "s", seconds, "loading the libraries", loads)


def with_empty_cache(arguments: list[str], cache: Path) -> Callable[[], object]:
    """A process that finds nothing of an earlier one."""
    run = process(arguments, DAEST_CACHE=str(cache))

    def run_afresh() -> object:
        shutil.rmtree(cache, ignore_errors=True)
        return run()

    return run_afresh


def with_many_variables(fmu: Path, target: Path) -> Path:
    """The FMU with `MANY` further names of its first output."""
    with zipfile.ZipFile(fmu) as old, zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():
            content = old.read(name)
            if name == "modelDescription.xml":
                reference = re.search(rb'valueReference="(\d+)"[^>]*causality="output"', content)
                assert reference is not None
                row = b'<Float64 name="part[%d].x" valueReference="%s" causality="local"/>\n'
                rows = b"".join(row % (i, reference[1]) for i in range(MANY))
                content = content.replace(b"</ModelVariables>", rows + b"</ModelVariables>")
            new.writestr(name, content)
    return target
