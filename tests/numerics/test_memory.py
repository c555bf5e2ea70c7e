"""Freed memory that stays: arrays that are made again and again take no new pages of the system."""

import resource
import subprocess
import sys

import pytest

COUNT = """
import resource
import numpy as np
{before}
def faults():
    for _ in range(20):
        [np.ones(400_000) for _ in range(10)]
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt
first = faults()
print(faults() - first)
"""
KEEP = "from daest.numerics.memory import keep_freed_memory; keep_freed_memory()"


def new_pages(before):
    done = subprocess.run(
        [sys.executable, "-c", COUNT.format(before=before)], capture_output=True, check=True
    )
    return int(done.stdout)


@pytest.mark.skipif(sys.platform != "linux", reason="asks the GNU C library")
def test_arrays_find_the_memory_of_those_before_them():
    pages = 400_000 * 8 // resource.getpagesize()
    assert new_pages("") > 10 * pages  # of 200 arrays
    assert new_pages(KEEP) < pages
