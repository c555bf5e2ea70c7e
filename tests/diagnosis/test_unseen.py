"""What two models foresee of unseen data, compared where they differ."""

from types import SimpleNamespace

import numpy as np
import pytest

from daest.diagnosis.unseen import Foreseen, compared, is_better, is_worse, judged
from daest.model.diagnosis import Ahead
from daest.model.fit import Agreement


def errors(rng, sizes):
    """(n_stretches, 10, 1)"""
    return rng.standard_normal((len(sizes), 10, 1)) * np.asarray(sizes)[:, None, None]


def test_better_worse_and_chance():
    rng = np.random.default_rng(1)
    base = errors(rng, [1.0] * 40)
    large = Foreseen({10: base + 1.0})
    small = Foreseen({10: base})
    (one,) = compared(large, small, 0.1)
    assert one.samples == 10 and one.seconds == pytest.approx(1.0)
    assert is_better(one) and not is_worse(one) and one.ratio == pytest.approx(1 / np.sqrt(2), rel=0.1)
    (back,) = compared(small, large, 0.1)
    assert is_worse(back) and not is_better(back)
    found = [compared(Foreseen({1: errors(rng, [1.0] * 40)}), Foreseen({1: errors(rng, [1.0] * 40)}), 1.0)[0]
             for _ in range(100)]  # fmt: skip
    assert sum(is_better(a) for a in found) <= 3 and sum(is_worse(a) for a in found) <= 3
    assert compared(None, small, 1.0) == () == compared(small, None, 1.0)


def test_effect_that_acts_seldom_is_judged_where_it_acts():
    rng = np.random.default_rng(2)
    rest = errors(rng, [1.0] * 200)
    without = rest.copy()
    without[:8] += 4.0
    (one,) = compared(Foreseen({10: without}), Foreseen({10: rest}), 1.0)
    assert is_better(one) and one.ratio < 0.35, "not the 0.8 of the whole record"


def fit_with(rms):
    return SimpleNamespace(simulated={"validation": Agreement({"y": None}, {"y": rms})})


def ahead(ratio, certainty):
    return Ahead(1, 0.1, ratio, certainty)


@pytest.mark.parametrize(
    "steps, whole, adds_up, reason",
    [
        ([ahead(0.8, 5.0)], 0.95, False, ""),
        ([ahead(0.995, 5.0), ahead(0.9, 1.0)], 0.99, False, "no better"),
        ([ahead(0.8, 5.0), ahead(1.2, -4.0)], 0.5, False, "1.2 times worse over 0.1 s"),
        ([ahead(0.8, 5.0)], 1.5, False, "simulation of unseen data gets 1.5 times worse"),
        ([ahead(0.8, 5.0)], 1.5, True, ""),  # dead reckoning
        ([ahead(1.0, 0.0)], 1.5, True, "1.5 times worse"),
        ([], 0.8, False, ""),
    ],
)
def test_unseen_data_must_be_foreseen_as_well_at_all_horizons_and_better_at_one(
    steps, whole, adds_up, reason
):
    found, is_clear, _ = judged(steps, fit_with(1.0), fit_with(whole), adds_up)
    assert reason in found and bool(reason) == bool(found) and is_clear == (not reason)
