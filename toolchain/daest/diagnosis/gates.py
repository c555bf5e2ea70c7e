"""The thresholds of the diagnosis, each with its unit, its meaning and what set it.

`docs/trust.md` and `docs/theory.md` show the values from here. A count that only limits how long a search
takes is no gate and stands where it is used.

They stand in the table `gates.txt`.
"""

from __future__ import annotations

from pathlib import Path

from daest.model.thresholds import read_thresholds

GATES = read_thresholds(Path(__file__).with_suffix(".txt"))
