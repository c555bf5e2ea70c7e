"""Verdicts by exact arithmetic: against rational numbers, for almost every θ and at special values."""

import sys
from pathlib import Path

import numpy as np
import pytest
from flat_models import Draft, report_servo

from daest.model.noise import GenericVerdict
from daest.systems.linear.exact_structure import exact_structure, generic_structure
from daest.systems.linear.linearize import linearize
from daest.systems.linear.noise import noise_report
from daest.systems.linear.split import split
from daest.systems.linear.transfer import poles

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks" / "oracles"))
import pencils

COUNTER = [
    "-der(x1) + der(x7) = -x4",
    "2*der(x2) = 2*x3 + x6",
    "-der(x4) + der(x5) = x4 + x7 + 3*x8",
    "2*der(x3) + 2*der(x5) = x3 - x5",
    "der(x5) = x2 - x4 + x5 + x8",
    "0 = 2*x7",
    "der(x4) = 0",
    "2*der(x6) = -2*x2 + 2*x4",
]


def model(equations, unknowns, **options):
    draft = Draft("Exact", unknowns=unknowns, **options)
    for text in equations:
        draft.equation(text)
    return linearize(draft.flat())


def verdict(report):
    forbidden = tuple(i for i, place in enumerate(report.places) if not place.admissible)
    return pencils.Truth(report.index, report.n_dynamic, forbidden)


def test_eight_integer_equations_of_index_one():
    dae = model(COUNTER, [f"x{i}" for i in range(1, 9)])
    report = noise_report(dae)
    assert verdict(report) == pencils.truth(dae.E, dae.J)
    assert (report.index, report.n_forbidden, report.undecided, report.differences) == (1, 0, (), ())
    assert not any(report.N_singular_values)
    assert report.generic == GenericVerdict("numbers", 1, report.n_dynamic, (), ())


def assert_judged(cases):
    """No wrong verdict without a doubt; doubts only where entries were scaled one by one."""
    outcomes = [(case, pencils.judged(case)) for case in cases]
    for case, (outcome, want, said) in outcomes:
        assert outcome.startswith("right") or "doubt told" in outcome, (case.kind, case.scaling, want, said)
    in_units = [outcome for case, (outcome, *_) in outcomes if not case.scaling.endswith("entries")]
    assert sum(outcome != "right" for outcome in in_units) <= 0.01 * len(in_units)


def test_random_pencils_against_rational_numbers():
    assert_judged(pencils.cases(40, seed=7, largest=13))


@pytest.mark.slow
def test_two_thousand_random_pencils_against_rational_numbers():
    assert_judged(pencils.cases(2000, seed=8))


def test_a_tolerance_is_told_from_the_exact_verdict():
    report = noise_report(linearize(report_servo()), tolerance=0.02)
    assert (report.n_forbidden, len(report.generic.forbidden)) == (7, 10)
    (difference,) = report.differences
    assert difference.what == "equations" and len(difference.equations) == 3
    assert "0.0149" in difference.reason and "0.02" in difference.reason


def test_a_parameter_that_is_zero_is_named():
    report = noise_report(
        model(["C*der(v) = i", "R*i = u - v", "u = 1"], ["v", "i", "u"], parameters={"C": 0.0, "R": 2.0})
    )
    assert (report.index, report.n_dynamic, report.generic.n_dynamic) == (1, 0, 1)
    (difference,) = report.differences
    assert difference.what == "n_dynamic" and difference.reason == "C = 0 is a special value"


def test_two_parameters_that_are_equal_are_named():
    """At C1 = C2 the derivatives are those of a constant: a mode less."""
    equations = ["C1*der(v) + C2*der(w) = -v", "v + w = u", "u = 1"]
    report = noise_report(model(equations, ["v", "w", "u"], parameters={"C1": 0.3, "C2": 0.3}))
    assert (report.n_dynamic, report.generic.n_dynamic) == (0, 1)
    (difference,) = [d for d in report.differences if d.what == "n_dynamic"]
    assert difference.reason == "C1 = 0.3 and C2 = 0.3 are special values"


@pytest.mark.parametrize(
    ("pair", "parameters"),
    [
        (("n", "1/n"), {"n": 3.0}),  # a gear and its inverse
        (("n*n", "1/n*(1/n)"), {"n": 0.7}),
        (("a + b", "1/(a + b)"), {"a": 0.1, "b": 0.2}),
        (("sqrt(a)", "sqrt(a)/a"), {"a": 2.0}),
        (("exp(a)", "exp(-a)"), {"a": 0.4}),
        (("sin(a)*sin(a)", "1/(1 - cos(a)*cos(a))"), {"a": 0.4}),
    ],
)
def test_relations_of_parameters_hold_for_almost_all_of_them(pair, parameters):
    """p times q is one: the derivatives of the first two equations are the same combination."""
    p, q = pair
    dae = model(
        [f"({p})*der(x) + der(y) = -x", f"der(x) + ({q})*der(y) = y"], ["x", "y"], parameters=parameters
    )
    for structure in (generic_structure(dae), exact_structure(dae)):
        assert (structure.index, structure.n_dynamic) == (1, 1)
    form = split(dae)
    assert (form.index, form.n_dynamic, form.doubts) == (1, 1, ())


def test_decimal_numbers_that_add_up():
    """0.1 + 0.2 - 0.3 is zero, though not in floating point."""
    dae = model(["(a + b - 0.3)*der(x) = -x + y", "y = 1"], ["x", "y"], parameters={"a": 0.1, "b": 0.2})
    assert dae.E[0, 0] != 0.0
    report = noise_report(dae)
    assert (report.n_dynamic, report.generic.n_dynamic) == (0, 1)


def test_digits_that_may_be_rounding_errors_leave_it_undecided():
    turn = np.linalg.qr(np.random.default_rng(0).standard_normal((4, 4)))[0]
    E = turn @ np.diag([1.0, 1.0, 1.0, 0.0]) @ turn.T  # singular but for rounding
    J = turn @ np.random.default_rng(1).standard_normal((4, 4))
    report = noise_report(pencils.linear_dae(E, J))
    assert (report.index, report.n_dynamic, report.generic) == (1, 3, None)
    assert any("every digit" in doubt for doubt in report.undecided)


@pytest.mark.parametrize("eps", [1e-3, 1e-5, 1e-7])
def test_fast_poles_of_a_nearly_higher_index(eps):
    """A double pole at -1/eps in a dense pencil, turned at random; the truth by 1000 binary digits."""
    from flint import acb_mat, arb_mat, ctx

    rng = np.random.default_rng(3)
    left, right = (np.linalg.qr(rng.standard_normal((6, 6)))[0] for _ in range(2))
    E, J = np.eye(6), -np.eye(6)
    E[4:, 4:] = [[eps, 1.0], [0.0, eps]]
    J[:4, :4] = rng.standard_normal((4, 4))
    E, J = left @ E @ right, left @ J @ right
    with ctx.workprec(1000):
        ratio = arb_mat(6, 6, J.ravel().tolist()).inv() * arb_mat(6, 6, E.ravel().tolist())
        want = np.sort_complex([complex(1 / value) for value in acb_mat(ratio).eig(algorithm="approx")])
    found = np.sort_complex(poles(split(pencils.linear_dae(E, J))))
    np.testing.assert_allclose(found, want, rtol=1e-9)
