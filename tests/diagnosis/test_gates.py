"""The thresholds of diagnosis, fit, solvers and data: each is told whole, each is used, and none changes."""

import re
from dataclasses import FrozenInstanceError
from pathlib import Path

import pytest

import daest.diagnosis
from daest.data.limits import DATA
from daest.diagnosis.gates import GATES
from daest.estimation.gates import FIT
from daest.model.thresholds import STUDIES, read_thresholds
from daest.systems.tolerances import SOLVER

ROOMS = Path(daest.__file__).parent
ROOT = Path(__file__).resolve().parents[2]


SETS = {"GATES": GATES, "FIT": FIT, "SOLVER": SOLVER, "DATA": DATA}


@pytest.mark.parametrize("gates", SETS.values(), ids=SETS)
def test_every_gate_has_a_unit_a_meaning_and_what_set_it(gates):
    for name, value, unit, meaning, study in gates.rows():
        assert value > 0 and unit and len(meaning.split()) > 3, name
        known = study in (*STUDIES.values(), "definition") or re.search(r"\bbenchmarks/(\w+\.py)", study)
        assert known or re.match(r"(distribution|analysis): \w|.* \(\d{4}\): \w", study), name


@pytest.mark.parametrize("gates", SETS.values(), ids=SETS)
def test_the_studies_that_set_gates_are_there(gates):
    named = {file for *_, study in gates.rows() for file in re.findall(r"\bbenchmarks/\w+\.py", study)}
    assert [file for file in named if not (ROOT / file).is_file()] == []


@pytest.mark.parametrize("word", SETS)
def test_the_gates_are_those_that_are_used(word):
    """Type checkers do not know the names of a table."""
    text = "".join(file.read_text(encoding="utf-8") for file in ROOMS.rglob("*.py"))
    used = set(re.findall(rf"\b{word}\.(\w+)", text))
    assert used == {name for name, *_ in SETS[word].rows()}


def test_none_can_be_changed_on_the_way():
    with pytest.raises(FrozenInstanceError):
        GATES.min_bic_gain = 1.0


def test_a_row_with_a_part_too_few_is_refused(tmp_path):
    table = tmp_path / "gates.txt"
    table.write_text(
        "# name | value\nstudied = benchmarks/study.py\n\nlimit | 3 | samples | that are enough | studied\n"
    )
    assert list(read_thresholds(table).rows()) == [
        ("limit", 3, "samples", "that are enough", "benchmarks/study.py")
    ]
    table.write_text("limit | 3 | samples | that are enough\n")
    with pytest.raises(ValueError, match="unpack"):
        read_thresholds(table)
