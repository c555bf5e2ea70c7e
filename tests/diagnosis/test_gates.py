"""The thresholds of the diagnosis: each is told whole, each is used, and none can be changed on the way."""

import re
from dataclasses import FrozenInstanceError
from pathlib import Path

import pytest

import daest.diagnosis
from daest.diagnosis.gates import BOXES, FLEXIBLE, GATES, JUDGEMENT, ROUNDING, SIMULATED, WRONG

ROOMS = Path(daest.__file__).parent


def test_every_gate_has_a_unit_a_meaning_and_what_set_it():
    for name, value, unit, meaning, study in GATES.rows():
        assert value > 0 and unit and len(meaning.split()) > 3, name
        known = study in (SIMULATED, BOXES, WRONG, FLEXIBLE, JUDGEMENT, ROUNDING, "definition")
        assert known or re.match(r"distribution: \w|.* \(\d{4}\): \w", study), name


def test_every_gate_is_used():
    text = "".join(file.read_text(encoding="utf-8") for file in ROOMS.rglob("*.py"))
    unused = [name for name, *_ in GATES.rows() if not re.search(rf"GATES\.{name}\b", text)]
    assert unused == []


def test_none_can_be_changed_on_the_way():
    with pytest.raises(FrozenInstanceError):
        GATES.min_bic_gain = 1.0
