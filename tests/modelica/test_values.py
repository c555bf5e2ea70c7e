"""Scalars of expressions: numbers and symbols."""

import casadi as ca
import pytest

from daest.modelica.language.values import power


@pytest.mark.parametrize(
    ("a", "b", "value", "by_a"),
    [(2, 3, 8, 12), (-2, 3, -8, 12), (-2, 2, 4, -4), (0, 1, 0, 1), (0, 2, 0, 0), (-1e-20, 14, 0, 0)],
)
def test_a_power_of_symbols_has_slopes_where_its_base_is_zero(a, b, value, by_a):
    x, n = ca.SX.sym("x"), ca.SX.sym("n")
    made = power(x, n)
    found, slopes = ca.Function("f", [x, n], [made, ca.jacobian(made, ca.vertcat(x, n))])(a, b)
    assert float(found) == pytest.approx(value, abs=1e-200)
    assert float(slopes[0]) == pytest.approx(by_a, abs=1e-200)
    assert slopes.is_regular()


def test_a_negative_number_has_no_fractional_power():
    x, n = ca.SX.sym("x"), ca.SX.sym("n")
    assert not ca.Function("f", [x, n], [power(x, n)])(-2, 0.5).is_regular()
    with pytest.raises(ValueError, match="not real"):
        power(-2.0, 0.5)
