"""Transfer functions and state space: report (10), python-control, and C (sE - J)⁻¹ K itself."""

import numpy as np
import pytest
from flat_models import SERVO, Draft, library_servo, report_servo, servo_polynomials

from daest.systems.linear.linearize import linearize
from daest.systems.linear.split import split
from daest.systems.linear.transfer import poles, transfer_functions


def functions(flat):
    dae = linearize(flat)
    return {(g.input, g.output): g for g in transfer_functions(dae, split(dae))}


def make(*equations, unknowns, outputs, inputs=("u",), **more):
    m = Draft("Small", unknowns=unknowns.split(), inputs=list(inputs), outputs=outputs, **more)
    for text in equations:
        m.equation(text)
    return m.flat()


@pytest.mark.parametrize("n_draws", [4, pytest.param(15, marks=pytest.mark.slow)])
@pytest.mark.parametrize("model", [report_servo, pytest.param(library_servo, marks=pytest.mark.slow)])
def test_report_equation_10_at_random_parameters(model, n_draws):
    rng = np.random.default_rng(10)
    for _ in range(n_draws):
        values = {name: value * rng.uniform(0.3, 3.0) for name, value in SERVO.items()}
        num, den = servo_polynomials(**values)
        found = functions(model(**values))
        speed, angle = found["u", "omega"], found["u", "phi"]
        np.testing.assert_allclose(speed.num, np.array(num) / den[0], rtol=1e-9)
        np.testing.assert_allclose(speed.den, np.array(den) / den[0], rtol=1e-9)
        # To the angle: one more pole at 0, and the disc behind spring and damper takes J2 s² away.
        np.testing.assert_allclose(angle.num, np.array(num[1:]) / den[0], rtol=1e-9)
        np.testing.assert_allclose(angle.den, np.append(den, 0.0) / den[0], rtol=1e-9)


def test_signs_of_the_report():
    num, den = servo_polynomials(**SERVO)
    assert all(c > 0 for c in num) and all(c > 0 for c in den)  # k < 0: positive voltage turns it forward
    # (11): k ≈ 11180 / (6128 · (-30)) from the constant terms of (9) = those of (10).
    assert den[-1] / (num[-1] * -30) == pytest.approx(SERVO["k"])


def test_poles_of_the_form():
    form = split(linearize(report_servo()))
    got = poles(form)
    want = np.sort_complex(np.append(np.roots(servo_polynomials(**SERVO)[1]), 0.0))
    np.testing.assert_allclose(got, want, rtol=1e-9, atol=1e-12)
    assert np.count_nonzero(got == 0) == 1


def test_against_the_descriptor_system_itself():
    dae = linearize(library_servo())
    found = transfer_functions(dae, split(dae))
    for s in (0.01 + 0.02j, 1.0 + 3.0j, 50j, 400.0 - 20.0j):
        want = dae.C @ np.linalg.solve(s * dae.E - dae.J, dae.K) + dae.D
        got = np.array([g(s) for g in found]).reshape(2, 1)
        np.testing.assert_allclose(got, want, rtol=1e-9)


def test_against_python_control():
    control = pytest.importorskip("control")
    rng = np.random.default_rng(4)
    A, B, C = rng.normal(size=(6, 6)), rng.normal(size=(6, 2)), rng.normal(size=(3, 6))
    D = rng.normal(size=(3, 2))
    m = Draft("Random", unknowns=[f"x{i}" for i in range(6)], inputs=["u0", "u1"])
    for i in range(6):
        terms = [f"({float(A[i, j])!r})*x{j}" for j in range(6)]
        terms += [f"({float(B[i, j])!r})*u{j}" for j in range(2)]
        m.equation(f"der(x{i}) = " + " + ".join(terms))
    for i in range(3):
        terms = [f"({float(C[i, j])!r})*x{j}" for j in range(6)]
        terms += [f"({float(D[i, j])!r})*u{j}" for j in range(2)]
        m.outputs[f"y{i}"] = " + ".join(terms)
    found = functions(m.flat())
    system = control.ss(A, B, C, D)
    for s in (0.3j, 1.0 + 1.0j, 20j):
        want = system(s)
        for (u, y), g in found.items():
            assert len(g.den) == 7
            assert g(s) == pytest.approx(want[int(y[1:]), int(u[1:])], rel=1e-8)


def test_unreachable_and_invisible_modes_are_cancelled():
    flat = make(
        "der(a) = -a + u",
        "der(b) = -2*b",
        "der(c) = -3*c + a",
        unknowns="a b c",
        outputs={"y": "a + b", "z": "c", "nothing": "b"},
    )
    found = functions(flat)
    np.testing.assert_allclose(found["u", "y"].den, [1.0, 1.0])
    np.testing.assert_allclose(found["u", "y"].num, [1.0])
    np.testing.assert_allclose(found["u", "z"].den, [1.0, 4.0, 3.0])
    assert found["u", "nothing"].num == (0.0,) and found["u", "nothing"].den == (1.0,)


def test_weakly_coupled_modes_are_kept():
    flat = make("der(a) = -a + u", "der(b) = -2*b + 1e-6*a", unknowns="a b", outputs={"y": "b"})
    g = functions(flat)["u", "y"]
    np.testing.assert_allclose(g.den, [1.0, 3.0, 2.0], rtol=1e-10)
    np.testing.assert_allclose(g.num, [1e-6], rtol=1e-9)


@pytest.mark.parametrize("rounding", [7e-31, 1e-20])
@pytest.mark.parametrize("integrated", [True, False])
def test_couplings_that_are_zero_but_for_rounding_hide_nothing(rounding, integrated):
    """An oscillator pushes a body, and the body, by rounding alone, another oscillator."""
    position = ["der(p) = 3*q"] if integrated else []
    flat = make(
        "der(a) = v",
        "der(v) = -21*a - 0.8*v + u",
        "der(q) = -5*a - 0.2*v",
        "der(s) = w",
        f"der(w) = -20*s - 1.5*w + {rounding}*q + f",
        *position,
        unknowns="a v q s w" + " p" * integrated,
        inputs=("u", "f"),
        outputs={"a": "a", "q": "q", "s": "s"},
    )
    first, second, free = [1.0, 0.8, 21.0], [1.0, 1.5, 20.0], [0.0] * (1 + integrated)
    want = np.sort_complex(np.concatenate([np.roots(first), np.roots(second), free]))
    np.testing.assert_allclose(poles(split(linearize(flat))), want, rtol=1e-12)
    found = functions(flat)
    for channel, num, den in (
        (("u", "a"), [1.0], first),
        (("u", "q"), [-0.2, -5.0], [*first, 0.0]),
        (("f", "s"), [1.0], second),
    ):
        np.testing.assert_allclose(found[channel].num, num, rtol=1e-11)
        np.testing.assert_allclose(found[channel].den, den, rtol=1e-11, atol=1e-13)
    assert found["f", "a"].num == found["f", "q"].num == (0.0,)
    assert abs(found["u", "s"](1.0)) <= rounding


def test_feedthrough_and_zero_at_the_origin():
    flat = make("der(x) = -x + u", "y = u - x", unknowns="x y", outputs={"out": "y"})
    g = functions(flat)["u", "out"]
    np.testing.assert_allclose(g.num, [1.0, 0.0], atol=1e-14)
    np.testing.assert_allclose(g.den, [1.0, 1.0], rtol=1e-12)


def test_improper_function_keeps_its_polynomial_part():
    flat = make(
        "x = u", "v = der(x)", "a = der(v)", "der(z) = -z + u", unknowns="x v a z", outputs={"y": "2*a + z"}
    )
    g = functions(flat)["u", "y"]
    # 2 s² + 1/(s + 1)
    np.testing.assert_allclose(g.num, [2.0, 2.0, 0.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(g.den, [1.0, 1.0], rtol=1e-12)


def test_model_without_dynamics():
    flat = make("a + b = u", "a - b = 0", unknowns="a b", outputs={"y": "a"})
    g = functions(flat)["u", "y"]
    assert (g.num, g.den) == ((0.5,), (1.0,))
    assert poles(split(linearize(flat))).size == 0
