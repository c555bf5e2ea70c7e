"""The thresholds of what is said of recordings and of what is kept of them. The page on trust shows them.

They stand in the table `limits.txt`. Counts that only limit how long a look takes are no thresholds and stand
where they are used.
"""

from __future__ import annotations

from pathlib import Path

from daest.model.thresholds import read_thresholds

DATA = read_thresholds(Path(__file__).with_suffix(".txt"))
