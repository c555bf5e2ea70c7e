"""Short formulas for curves whose law is known."""

import numpy as np
import pytest

from daest.diagnosis.answers.formulas import formula
from daest.model.diagnosis import Curve

SPEEDS = np.array([-9.0, -6.0, -3.5, -1.5, -0.1, 0.1, 1.2, 3.0, 5.0, 8.0])
ANGLES = np.linspace(0.0, 5.8, 10)
LAWS = [
    ("rad/s", SPEEDS, lambda v: -0.15 * np.sign(v), {"sign(v)": (-0.15, "N.m")}),
    (
        "rad/s",
        SPEEDS,
        lambda v: -0.15 * np.sign(v) - 0.02 * v * np.abs(v),
        {"sign(v)": (-0.15, "N.m"), "v*abs(v)": (-0.02, "N.m.s2/rad2")},
    ),
    ("rad", SPEEDS / 3.0, lambda v: -0.05 * v**3, {"v^3": (-0.05, "N.m/rad3")}),
    ("rad", ANGLES, lambda v: 0.2 + 0.1 * np.cos(v), {"1": (0.2, "N.m"), "cos(v)": (0.1, "N.m")}),
    (
        "m",
        ANGLES,
        lambda v: 0.3 - 0.2 * np.maximum(v - ANGLES[4], 0.0),
        {"1": (0.3, "N.m"), f"max(v - {ANGLES[4]:.4g}, 0)": (-0.2, "N")},
    ),
]


def curve(x, y, std=0.004, sign_of=""):
    return Curve("v", sign_of, 0.1 if sign_of else 0.0, 0.0, x, y, np.full(x.size, std))


def noisy(x, y, seed):
    return y + 0.004 * np.random.default_rng(seed).standard_normal(x.size)


@pytest.mark.parametrize(("unit", "x", "law", "wanted"), LAWS)
def test_law_of_the_grammar_comes_back_with_its_numbers_and_units(unit, x, law, wanted):
    for seed in range(2):
        found = formula(curve(x, noisy(x, law(x), seed)), "N.m", unit)
        assert {c.term for c in found.coefficients} == set(wanted)
        for c in found.coefficients:
            value, of = wanted[c.term]
            assert abs(c.value - value) < 4.0 * c.std_error and c.unit == of
        assert found.left < 0.1 and found.n_numbers <= len(wanted) + 1


def test_friction_that_depends_on_the_place_keeps_the_sign_of_the_speed():
    y = -0.2 * (1.0 + 0.8 * np.sin(ANGLES))
    found = formula(curve(ANGLES, y, sign_of="rotor.w"), "N.m", "rad")
    assert found.text.startswith("sign(rotor.w)*(") and "sin(v)" in found.text


def test_no_formula_for_what_is_no_law():
    noise = 0.1 * np.random.default_rng(3).standard_normal(SPEEDS.size)
    assert formula(curve(SPEEDS, noise), "N.m", "rad/s") is None
    assert formula(curve(SPEEDS, np.zeros(SPEEDS.size)), "N.m", "rad/s") is None
    unknown = curve(SPEEDS, np.sign(SPEEDS), std=np.nan)
    assert formula(unknown, "N.m", "rad/s") is None


def test_a_root_has_no_unit_of_whole_exponents():
    x = np.linspace(0.1, 9.0, 9)
    found = formula(curve(x, -0.3 * np.sqrt(x)), "m3/s", "Pa")
    assert [(c.term, c.unit) for c in found.coefficients] == [("sqrt(abs(v))", "")]


def test_slope_that_a_damper_shares_counts_for_little():
    free = 20.0 * SPEEDS  # what any damping would make of it
    cov = np.outer(free, free) + 0.01**2 * np.eye(SPEEDS.size)
    std = np.sqrt(np.diag(cov))
    loose = Curve("v", "", 0.0, 0.0, SPEEDS, -0.2 * np.sign(SPEEDS) + 0.6 * SPEEDS, std)
    assert formula(loose, "N.m", "rad/s") is None
    found = formula(loose, "N.m", "rad/s", cov / np.outer(std, std))
    (sign,) = [c for c in found.coefficients if c.term == "sign(v)"]
    assert abs(sign.value + 0.2) < 4.0 * sign.std_error < 0.2
