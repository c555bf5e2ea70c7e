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


def test_what_is_known_of_a_size_beside_another_parameter_is_told():
    product = {"value": 0.2179, "std_error": 0.024, "unit": "A"}
    first = step(1, "spring", **{"spring.tau_h": (0.0017, 0.034)}) | {"known_products": {"tau_h/k": product}}
    said = " ".join(text(ledger(step(0), first)).split())
    assert "tau_h = 0.0017 ± 0.034 W/K, tau_h/k = 0.2179 ± 0.024 A; supported" in said


def test_the_signal_that_feeds_an_effect_is_told():
    fed = step(1, "crosstalk") | {"added": "Crosstalk", "inputs": {"z": "load"}}
    said = " ".join(text(ledger(step(0), fed)).split())
    assert "Added Crosstalk (load) at node1" in said and "Crosstalk (load) node1" in said
