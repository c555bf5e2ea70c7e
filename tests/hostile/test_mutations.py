"""Mutations of everything that is read; DAEST_FUZZ sets how many. `mutations.py` is the command for many."""

import os
from collections import Counter

import pytest
from mutations import DAMAGED, PAST, tried, whole_process

N = int(os.environ.get("DAEST_FUZZ", "60"))
N_PROCESSES = N // 60


def test_mutations_end_well_or_with_one_message(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = Counter(tried(number, tmp_path) for number in range(N))
    ways = {mutation for mutation, _ in found}
    assert ways == {way.__name__ for way in (*DAMAGED, *PAST)}
    past = sum(n for (mutation, _), n in found.items() if mutation in {way.__name__ for way in PAST})
    assert past >= N // 3


@pytest.mark.parametrize("number", range(N_PROCESSES))
def test_whole_processes(tmp_path, number):
    whole_process(number, tmp_path)
