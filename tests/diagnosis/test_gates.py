"""The thresholds of diagnosis, fit and solvers: each is told whole, each is used, and none changes."""

import re
from dataclasses import FrozenInstanceError
from pathlib import Path

import pytest

import daest.diagnosis
from daest.diagnosis.gates import BOXES, FLEXIBLE, GATES, SIMULATED, WRONG
from daest.estimation.gates import FIT
from daest.model.thresholds import JUDGEMENT, ROUNDING
from daest.systems.tolerances import SOLVER

ROOMS = Path(daest.__file__).parent


SETS = {"GATES": GATES, "FIT": FIT, "SOLVER": SOLVER}


@pytest.mark.parametrize("gates", SETS.values(), ids=SETS)
def test_every_gate_has_a_unit_a_meaning_and_what_set_it(gates):
    for name, value, unit, meaning, study in gates.rows():
        assert value > 0 and unit and len(meaning.split()) > 3, name
        known = study in (SIMULATED, BOXES, WRONG, FLEXIBLE, JUDGEMENT, ROUNDING, "definition")
        assert known or re.match(r"(distribution|analysis): \w|.* \(\d{4}\): \w", study), name


@pytest.mark.parametrize("word", SETS)
def test_every_gate_is_used(word):
    text = "".join(file.read_text(encoding="utf-8") for file in ROOMS.rglob("*.py"))
    used = set(re.findall(rf"\b{word}\.(\w+)", text))
    assert [name for name, *_ in SETS[word].rows() if name not in used] == []


def test_none_can_be_changed_on_the_way():
    with pytest.raises(FrozenInstanceError):
        GATES.min_bic_gain = 1.0
