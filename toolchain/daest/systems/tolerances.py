"""The tolerances of the solvers: integration, initial values, constraints. The page on trust shows them.

They stand in the table `tolerances.txt`.
"""

from __future__ import annotations

from pathlib import Path

from daest.model.thresholds import read_thresholds

SOLVER = read_thresholds(Path(__file__).with_suffix(".txt"))
