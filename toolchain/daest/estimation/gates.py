"""The thresholds of fits and filters: when searches end, what is told of the unknowns, and what is in doubt.

The page on trust shows them. Counts that only limit how long a search takes, and the points that it tries,
are no thresholds and stand where they are used. z are the coordinates of the search.

They stand in the table `gates.txt`.
"""

from __future__ import annotations

from pathlib import Path

from daest.model.thresholds import read_thresholds

FIT = read_thresholds(Path(__file__).with_suffix(".txt"))
