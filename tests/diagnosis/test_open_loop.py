"""Evidence in open loop: how it counts, and a slow law that an observer hides."""

import numpy as np
import pytest

from daest.diagnosis.open_loop import InUse, Simulated, in_use


def lasting(n, seed, memory=0.9, size=1.0):
    rng = np.random.default_rng(seed)
    course = np.zeros(n)
    for k in range(1, n):
        course[k] = memory * course[k - 1] + np.sqrt(1.0 - memory**2) * rng.standard_normal()
    return size * course[:, None]


def simulated(size, seed, memory=0.9, n=2000):
    return Simulated((lasting(n, seed, memory, size),), (lasting(n, seed + 1, memory, size),))


def test_errors_that_last_count_as_few_samples():
    white, slow = (in_use(simulated(2.0, 1, m), simulated(1.0, 3, m)) for m in (0.0, 0.95))
    assert white.n_independent == pytest.approx(2000, rel=0.35)
    # Of squares: n (1 - a²)/(1 + a²)
    assert slow.n_independent == pytest.approx(2000 * (1 - 0.95**2) / (1 + 0.95**2), rel=0.4)
    assert white.ratio == pytest.approx(0.5, rel=0.1) and slow.ratio == pytest.approx(0.5, rel=0.3)
    assert white.gain > 5 * slow.gain > 0 and white.certainty > slow.certainty > 2.5
    assert white.speaks_for(1) and slow.speaks_for(1)


@pytest.mark.parametrize("memory", [0.0, 0.95])
def test_a_law_that_does_nothing_is_seldom_better_in_use(memory):
    found = [in_use(simulated(1.0, 10 * i, memory), simulated(1.0, 10 * i + 5, memory)) for i in range(60)]
    certainties = np.array([one.certainty for one in found])
    assert abs(certainties.mean()) < 0.4 and 0.7 < certainties.std() < 1.3
    assert sum(one.speaks_for(1) for one in found) <= 2


def test_what_is_not_known_says_nothing():
    nothing = in_use(None, simulated(1.0, 1))
    assert nothing == InUse() and not nothing.speaks_for(1)
    fitted = simulated(1.0, 1)
    gone = Simulated(fitted.fitted, (np.full((2000, 1), np.nan),))
    assert in_use(fitted, gone) == InUse()


def test_worse_on_one_side_is_no_evidence():
    better_fitted = Simulated(simulated(0.5, 3).fitted, simulated(1.1, 3).unseen)
    assert not in_use(simulated(1.0, 1), better_fitted).speaks_for(1)
