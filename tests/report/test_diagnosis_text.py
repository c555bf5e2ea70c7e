"""What `daest diagnose` prints of an unexplained load."""

import pytest

from daest.report.texts.diagnose import text


def diagnosis(*loads):
    curve = [(float(x), w, 0.1) for x, w in enumerate(loads)]
    labels = {"place": "strip", "label": "x", "variable": "x", "unit": "N", "variable_unit": "m"}
    return {
        "verdict": "unknown effect",
        "message": "Something dynamic is missing.",
        "searched": {"effects": [], "places": []},
        "next_experiment": "",
        "candidates": [],
        "screen": {"n_screened": 0},
        "places": [],
        "disturbance": {**labels, "sign_of": None, "p_value": 1.0, "curve": curve},
        "seconds": 1.0,
    }


@pytest.mark.parametrize(("loads", "is_told"), [((0.0, 0.0, 0.1), False), ((0.0, 0.5, 1.0), True)])
def test_load_within_its_band_follows_nothing(loads, is_told):
    """What is missing then is dynamic, or noise: a table of zeros would say that a curve was found."""
    assert ("follows x" in text(diagnosis(*loads))) == is_told
