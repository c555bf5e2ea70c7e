"""What the ledger of `daest improve` says of effects that were added before others."""

from daest.report.texts.improve import text


def step(number, component=None, **parameters):
    own = {
        name: {"value": value, "std_error": error, "unit": "W/K", "at_bound": None}
        for name, (value, error) in parameters.items()
    }
    return {
        "added": component and "HeatLoss",
        "at": component and f"node{number}",
        "component": component,
        "equivalent_places": [],
        "rms": {"validation": {"T": 1.0 / (number + 1)}},
        "delta_bic": None,
        "parameters": own,
        "remark": "supported",
        "model": f"step{number}.mo",
        "model_reason": "",
    }


def ledger(*steps):
    final = {"next_experiment": "", "candidates": [], "baseline": {}}
    return {
        "steps": steps,
        "outputs": {"T": "K"},
        "reason": "nothing is missing.",
        "searched": {"effects": [], "places": []},
        "final": final,
        "folder": "",
    }


def test_sizes_of_earlier_effects_are_told_beside_later_ones():
    first = step(1, "loss", **{"loss.G": (32.2, 7.1)})
    second = step(2, "loss2", **{"loss.G": (18.1, 0.1), "loss2.G": (18.2, 0.2)})
    said = " ".join(text(ledger(step(0), first, second)).split())
    assert "step 1: G = 32.2 ± 7.1 W/K" in said and "step 2: G = 18.2 ± 0.2 W/K" in said
    assert "in the last model: HeatLoss at node1: G = 18.1 ± 0.1 W/K" in said


def test_single_effect_is_told_once():
    said = text(ledger(step(0), step(1, "loss", **{"loss.G": (32.2, 7.1)})))
    assert "in the last model" not in said


def test_product_that_is_known_where_the_size_is_not_is_told():
    bent = step(1, "bend", **{"bend.a": (1.5, 6.2)})
    bent["known_products"] = {"a*k": {"value": 0.0043, "std_error": 0.0001, "unit": "N.m"}}
    said = " ".join(text(ledger(step(0), bent)).split())
    assert "step 1: a = 1.5 ± 6.2 W/K, a*k = 0.0043 ± 0.0001 N.m; supported" in said
