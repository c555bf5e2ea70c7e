"""What is minimised, of a predictor that counts its runs."""

from dataclasses import dataclass, field

import numpy as np

from daest.estimation.fitting.coordinates import Unknowns, objective


@dataclass(frozen=True)
class Run:
    negative_log_likelihood: float


@dataclass(frozen=True)
class Parabola:
    """A predictor whose likelihood is |z|² / 2."""

    unknowns: Unknowns = field(default_factory=lambda: Unknowns((), np.zeros(0), np.zeros(0), np.ones(1)))
    runs: list = field(default_factory=list)

    def predict(self, z, with_slopes=False):
        self.runs.append(with_slopes)
        return Run(float(z @ z) / 2)

    def derivatives(self, found, z):
        return z.copy(), np.eye(z.size)

    def tied(self, likelihood):
        return likelihood


def test_a_point_with_slopes_is_not_run_again():
    predictor = Parabola()
    first, again = objective(predictor), objective(predictor)
    z = np.array([1.0, 2.0])
    found = first(z, True)
    assert again(z.copy(), True) is found
    value = again(z, False)
    assert value.value == found.value and value.gradient.size == 0
    assert predictor.runs == [True]


def test_another_point_or_predictor_is_run():
    one, other = Parabola(), Parabola()
    z = np.array([1.0, 2.0])
    objective(one)(z, True)
    assert objective(one)(2.0 * z, True).value == 10.0
    objective(one)(z, True)
    objective(other)(z, True)
    assert one.runs == [True, True, True] and other.runs == [True]
    z[0] = 3.0  # the caller goes on with the same array
    assert objective(other)(z, True).value == 6.5
