"""Texts and figures: what they say, and that they fit where they are shown."""

import numpy as np
import pytest

from daest.model.comparison import Comparison, ModelTrial
from daest.model.experiment import Experiment
from daest.model.fit import Agreement
from daest.report.arrays import csv_text
from daest.report.comparison_figure import comparison_figure
from daest.report.console import indented, listed, number, percent, rendered, table
from daest.report.documents import compare as documents
from daest.report.figures import save
from daest.report.texts import compare as texts


@pytest.fixture
def comparison():
    time = np.arange(50) * 0.1
    y = np.column_stack([np.sin(time), np.cos(time)])
    y[3, 0] = np.nan
    run = Experiment("run", time, np.zeros((50, 1)), y, ("u",), ("a", "b"))
    agreement = Agreement({"a": 90.123, "b": None}, {"a": 0.1, "b": None})
    trials = [
        ModelTrial(name, k, agreement, agreement, -1.0, float("nan"), (0.9 * y,), (y,), notes)
        for name, k, notes in (("First", 2, ()), ("Second", 3, ("a remark",)))
    ]
    return Comparison((run,), ("a", "b"), ("rad", ""), tuple(trials))


def test_comparison_text_has_a_row_per_output_and_model(comparison):
    text = texts.text(documents.document(comparison), width=100)
    rows = [line.split() for line in text.splitlines()]
    assert ["a", "First", "2", "90.12", "0.1", "90.12", "0.1", "rad"] in rows
    assert ["b", "Second", "3", "-", "-", "-", "-"] in rows
    assert "Second: a remark" in text


@pytest.mark.parametrize("width", [60, 80, 100, 200])
def test_tables_fit_the_terminal_and_keep_numbers_whole(width):
    rows = [("a.very.long.component.name.of.a.variable", "1.23457e-06", "0.0123", "N.m.s/rad", "90.12")]
    text = rendered([table(("name", "estimate", "std error", "unit", "fit %"), rows, (0, 3))], width, False)
    assert max(map(len, text.splitlines())) <= width
    for value in ("1.23457e-06", "0.0123", "90.12"):
        assert value in text


def test_names_are_kept_together():
    rows = [("LoadDependentFriction", "gear.flange_b and three more", "0.238", "0.217", "286.5", "rejected")]
    columns = ("effect", "place", "omega [rad/s]", "phi [rad]", "BIC gain", "verdict")
    assert "LoadDependentFriction" in rendered([table(columns, rows, (0, 1, 5))], 72, False)


@pytest.mark.parametrize("width", [60, 80, 140])
def test_no_word_is_divided(width):
    """Whatever the width, every word of every cell stands on one line of its own table."""
    rows = [
        (
            "spring.flange_b.phi = disc.flange_a.phi",
            "PartialCompliant.mo:9",
            "7.9e-12",
            "not supported",
            "3.1",
        ),
        ("12", "Flange_a.mo:3", "-1.2345e+06", "cannot tell from these data", "-"),
    ]
    columns = ("equation", "place in the model", "norm", "verdict of the last test", "BIC gain")
    text = rendered([table(columns, rows, (0, 1, 3))], width, False)
    assert max(map(len, text.splitlines())) <= width
    words = [word for row in (columns, *rows) for cell in row for word in cell.split()]
    assert not [word for word in words if word not in text.split()]


def test_where_columns_do_not_fit_rows_stand_upright():
    columns = ("a", "b")
    text = rendered([table(columns, [("1.23457e-06", "9.87654e+10"), ("2", "3")], ())], 20, False)
    assert text.splitlines() == ["a  1.23457e-06", "b  9.87654e+10", "", "a  2", "b  3"]


def test_a_word_longer_than_the_line_stays_whole():
    name = "x" * 90
    assert name in rendered([indented(f"see {name} there")], 60, False).split()


def test_colour_only_when_asked():
    parts = [table(("name",), [("x[1]",)])]
    assert "\x1b" not in rendered(parts, 80, False)
    assert "\x1b" in rendered(parts, 80, True)
    assert "x[1]" in rendered(parts, 80, False)


def test_numbers_and_lists():
    assert number(None) == number(float("nan")) == percent(None) == percent(float("nan")) == "-"
    assert number(-0.0) == "0" and number(-2) == "-2"
    assert number(1234.5678, 6) == "1234.57" and percent(98.456) == "98.46"
    assert listed([]) == "none" and listed(list("abc"), 2) == "a, b and 1 more"


def test_csv_reads_back_to_the_same_numbers():
    rows = np.array([[0.1, 1 / 3, np.nan], [0.2, np.inf, -2.0]])
    lines = csv_text(["time", "a", "f(b, c)"], rows).splitlines()
    assert lines == ['time,a,"f(b, c)"', "0.1,0.333333333,", "0.2,,-2"]


def test_comparison_figure_shows_data_models_and_errors(comparison, tmp_path):
    figure = comparison_figure(comparison)
    errors_of_a, errors_of_b, *axes = figure.get_axes()
    assert [errors_of_a.get_xlabel(), errors_of_b.get_xlabel()] == ["rms error, a [rad]", "rms error, b [1]"]
    names = [tick.get_text() for tick in errors_of_a.get_yticklabels()]
    assert names == [f"{i}  {model.name}" for i, model in enumerate(comparison.models, 1)]
    assert [ax.get_ylabel() for ax in axes] == ["a [rad]", "error [rad]", "b [1]", "error [1]"]
    assert axes[-1].get_xlabel() == "time [s]"
    measured, first, second = axes[0].get_lines()
    assert measured.get_linestyle() == "None" and measured.get_label() == "measured"
    assert first.get_label() == "1 (89.8 %)" and second.get_color() != first.get_color()
    assert np.nanmax(np.abs(first.get_ydata() - 0.9 * measured.get_ydata())) < 1e-12
    error = axes[1].get_lines()[0].get_ydata()
    assert np.nanmax(np.abs(error - 0.1 * measured.get_ydata())) < 1e-12
    save(figure, tmp_path / "c.png")
    assert (tmp_path / "c.png").stat().st_size > 10_000
