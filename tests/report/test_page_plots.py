"""Plots of the page: long recordings stay small and are thinned with a note, and thinning loses no peak."""

import base64
import gzip
import json

import numpy as np
import pytest

from daest.report.page.plots import (
    comparison_plots,
    filter_plot,
    frequency_plots,
    model_labels,
    residual_plots,
    telling_window,
)
from daest.report.page.sections import added_lines, addition

N = 200_000
SPIKE = 123_457
GZIP = b"\x1f\x8b"


@pytest.fixture(scope="module")
def long():
    """Two models with three outputs on two long recordings; the first error has one spike."""
    rng = np.random.default_rng(0)
    outputs = {"a": "V", "b": "rad", "c": ""}
    agreement = dict.fromkeys(outputs, 1.0)
    models = [{"name": name, "where": [], "growth": [], "rms": agreement} for name in ("M", "N")]
    series = {}
    for r in range(2):
        measured = rng.standard_normal((N, 3))
        series[f"{r}.time"], series[f"{r}.measured"] = np.arange(N) * 1e-3, measured
        for m in range(2):
            series[f"{r}.{m}.simulated"] = measured + 0.1 * rng.standard_normal((N, 3))
    series["0.0.simulated"][SPIKE, 0] += 50.0
    return {"data": ["one", "two"], "outputs": outputs, "models": models}, series


def arrays(item: str) -> list[np.ndarray]:
    """All arrays that stand in the JSON of a plot."""
    found = []

    def walk(value):
        if isinstance(value, dict):
            if value.get("type") == "ndarray":
                data = base64.b64decode(value["array"]["data"])
                data = gzip.decompress(data) if data[:2] == GZIP else data
                found.append(np.frombuffer(data, value["dtype"]))
            for inner in value.values():
                walk(inner)
        elif isinstance(value, list):
            for inner in value:
                walk(inner)

    walk(json.loads(item))
    return found


@pytest.mark.slow
def test_long_recordings_make_no_large_page(long):
    document, series = long
    plots = [*comparison_plots(document, series), *frequency_plots(document, series)]
    assert sum(len(plot.item) for plot in plots) < 4_000_000
    assert [plot.id for plot in plots[:2]] == ["plot-compare-0", "plot-compare-1"]
    assert "200000 samples" in plots[0].note


def test_a_spike_of_one_sample_is_drawn_where_it_is(long):
    first = next(comparison_plots(*long))
    drawn = arrays(first.item)
    assert any(a.size and np.nanmin(a) < -45.0 for a in drawn)
    assert any(a.size and np.any(np.isclose(a, SPIKE * 1e-3)) for a in drawn)


def test_short_recordings_are_whole():
    time = np.arange(100) * 0.1
    document = {"series": [{"name": "x", "unit": "V", "measured": True, "used": True}], "smoothed": False}
    values = np.sin(time)[:, None]
    series = {"time": time, "values": values, "std": np.full((100, 1), 0.1), "measured": values}
    plot = filter_plot(document, series)
    assert plot is not None and plot.note == ""
    assert any(a.size == 100 and np.allclose(a, values[:, 0], atol=1e-6) for a in arrays(plot.item))


def growing(rms: dict[str, float], first: float) -> dict:
    """A model whose errors grow from `first` to those of its simulation."""
    steps = [{"seconds": t, "rms": dict.fromkeys(rms, first * t / 0.1)} for t in (0.1, 1.0)]
    return {"name": f"A_long_name_{first}", "where": [], "growth": steps, "rms": rms}


def test_several_models_are_numbers_in_legends_and_one_has_its_name(long):
    document, _ = long
    assert model_labels(document) == ["1", "2"]
    assert model_labels({**document, "models": document["models"][:1]}) == ["M"]


@pytest.mark.parametrize(("first", "scale"), [(1e-5, "LogScale"), (0.05, "LinearScale")])
def test_errors_of_predictions_and_of_the_simulation_are_in_range(first, scale):
    models = [growing({"y": 0.3}, first), growing({"y": 0.2}, first)]
    document = {"data": ["run"], "outputs": {"y": "m"}, "models": models}
    (plot,) = residual_plots(document, {"0.time": np.arange(10) * 0.1})
    (root,) = json.loads(plot.item)["doc"]["roots"]
    attributes = root["attributes"]
    assert attributes["y_scale"]["name"] == scale
    limits = attributes["y_range"]["attributes"]
    assert limits["end"] > 0.3 and limits.get("start", 0.0) < first


def test_the_window_that_is_shown_by_itself_is_the_one_with_the_largest_errors():
    time, small = np.arange(5000) * 0.01, np.full(5000, 0.1)
    large = small.copy()
    large[3100:3200] = 5.0
    found = telling_window(time, [small, large])
    assert found.start <= 3100 and found.stop >= 3200 and found.stop - found.start == 400
    assert telling_window(time, [1e-9 * small, 1e-9 * large]) == found
    gap = large.copy()
    gap[:1000] = np.nan
    assert telling_window(time, [gap]).start > 2700
    assert telling_window(time[:100], [large[:100]]) is None
    assert telling_window(time, [np.zeros(5000)]) == slice(0, 400)


def test_only_what_is_new_stands_in_the_addition():
    base = "model A\n  Real x;\nequation\n  x = 1;\n  x = 2;\nend A;\n"
    text = base.replace("  x = 1;", "  x + t = 1;").replace("model A\n", "model A\n  Real t;\n\n  Real s;\n")
    new = added_lines(text, base)
    assert addition(text, new).splitlines() == ["  Real t;", "", "  Real s;", "  // ...", "  x + t = 1;"]
    assert addition(text, []) == ""
