"""The data check as text: numbers stay whole in a narrow terminal, and every finding is a line."""

import numpy as np

from daest.data.check import check_table
from daest.data.table import Column, Table
from daest.report.documents.check import document
from daest.report.texts.check import text


def test_numbers_stay_whole_at_60_columns():
    time = 0.01 * np.arange(500)
    rng = np.random.default_rng(1)
    noisy = 1234.5 * np.sin(3 * time) + rng.normal(size=500)
    noisy[200] = 1e5
    columns = (Column("time", "s", time), Column("a_long_name_of_a_column", "rad/s", noisy))
    check = check_table(Table("run.csv", columns, None), {"a_long_name_of_a_column": "output"})
    shown = text(document([check]), width=60)
    assert all(len(line) <= 60 for line in shown.splitlines())
    assert "500 samples every 0.01 s" in shown and "warning[check-outliers]" in shown
    row = next(line for line in shown.splitlines() if "output" in line).split()
    low, high, step, noise = row[-4:]
    assert (high, step) == ("1e+05", "-") and float(low) < -1200 and float(noise) > 0.5


def test_roles_stand_where_a_model_gives_them():
    time = 0.01 * np.arange(500)
    check = check_table(Table("run.csv", (Column("time", "s", time), Column("y", "V", time)), None), {})
    assert "role" not in text(document([check]))
