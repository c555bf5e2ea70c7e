"""Standard form of the report's servo, of the same servo from library components, and of broken models."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg as sla
import scipy.sparse as sp
from flat_models import SERVO, Draft, library_servo, report_servo, servo_polynomials

from daest.errors import ModelError
from daest.numerics.pencils import split_pencil
from daest.systems.linear.linearize import linearize
from daest.systems.linear.split import split


def assert_rebuilt(dae, form, relative=1e-9):
    first = sla.block_diag(np.eye(form.n_dynamic), form.N)
    second = sla.block_diag(form.A, np.eye(dae.n - form.n_dynamic))
    for matrix, target in ((dae.E, first), (dae.J, second)):
        matrix = matrix.toarray() if sp.issparse(matrix) else matrix
        error = np.linalg.norm(form.left @ matrix @ form.right - target)
        assert error <= relative * np.linalg.norm(target)
    assert not np.any(np.linalg.matrix_power(form.N, form.index))


@pytest.mark.parametrize("star", [False, True])
def test_the_reports_model(star):
    dae = linearize(report_servo(star))
    form = split(dae)
    assert (dae.n, form.n_dynamic, form.N.shape, form.index) == (54, 4, (50, 50), 2)
    values = np.linalg.svd(form.N, compute_uv=False)
    np.testing.assert_allclose(values[:2], [1.41, 1.00], atol=0.005)  # the report gives two digits
    np.testing.assert_allclose(values[:2], [1.414, 1.000], atol=0.0005)
    assert values[2] < 1e-12
    assert_rebuilt(dae, form)
    assert all(d.gap > 1e6 for d in form.decisions)


@pytest.mark.parametrize("make", [report_servo, library_servo])
def test_poles_are_those_of_the_four_state_model(make):
    dae = linearize(make())
    form = split(dae)
    poles = np.sort_complex(np.linalg.eigvals(form.A))
    want = np.sort_complex(np.append(np.roots(servo_polynomials(**SERVO)[1]), 0.0))
    np.testing.assert_allclose(poles, want, rtol=1e-8, atol=1e-8)


def test_library_components_have_index_three():
    dae = linearize(library_servo())
    form = split(dae)
    assert (dae.n, form.index, form.n_dynamic) == (70, 3, 4)
    assert_rebuilt(dae, form)
    dense = split_pencil(dae.E, dae.J)
    assert (dense.index, dense.n_dynamic) == (3, 4)


def test_parameters_over_many_orders_of_magnitude():
    rng = np.random.default_rng(2)
    for _ in range(3):
        values = {name: value * 10.0 ** rng.uniform(-2, 2) for name, value in SERVO.items()}
        for make, index in ((report_servo, 2), (library_servo, 3)):
            form = split(linearize(make(**values)))
            assert (form.index, form.n_dynamic) == (index, 4), values
            # The characteristic polynomial at a point of the size of the poles; stiffness costs digits here.
            _, den = servo_polynomials(**values)
            s = (den[-1] / den[0]) ** (1 / 3) * np.exp(0.5j)
            want = s * np.polyval(den, s) / den[0]
            got = np.linalg.det(s * np.eye(4) - form.A)
            assert got == pytest.approx(want, rel=1e-6), values


def test_states_are_unknowns_of_the_model():
    dae = linearize(report_servo())
    form = split(dae)
    differentiated = np.any(dae.E != 0, axis=0)
    for unit in np.eye(4):
        is_state = np.all(form.right[:, :4] == unit, axis=1)
        names = [dae.unknowns[i].name for i in np.flatnonzero(is_state & differentiated)]
        assert len(names) >= 1
        assert set(names) <= {
            "motor.phi",
            "emf.flange.phi",
            "motor.w",
            "damper.phi_rel",
            "disc.phi",
            "disc.w",
        }


def test_infinite_part_is_orthonormal_off_the_dynamic_subspace():
    form = split(linearize(report_servo()))
    basis = sla.orth(form.right[:, :4])
    off = form.right[:, 4:] - basis @ (basis.T @ form.right[:, 4:])
    np.testing.assert_allclose(off.T @ off, np.eye(50), atol=1e-10)


def test_scaled_equations_and_unknowns():
    dae = linearize(library_servo())
    rng = np.random.default_rng(6)
    plain = np.sort_complex(np.linalg.eigvals(split(dae).A))
    for _ in range(4):
        rows, columns = (10.0 ** rng.uniform(-6, 6, dae.n) for _ in range(2))
        scaled = replace(dae, E=rows[:, None] * dae.E * columns, J=rows[:, None] * dae.J * columns)
        form = split(scaled)
        assert (form.index, form.n_dynamic) == (3, 4)
        poles = np.sort_complex(np.linalg.eigvals(form.A))
        np.testing.assert_allclose(poles, plain, rtol=1e-8, atol=1e-8)


def test_structurally_singular_model_names_both_parts():
    m = Draft("Broken", unknowns=["x", "y", "z"])
    for text in ("der(x) = -x", "y = 2*x", "y = 3*x"):
        m.equation(text)
    with pytest.raises(ModelError) as caught:
        split(linearize(m.flat()))
    error = caught.value
    assert error.code == "structurally-singular"
    assert "y = 2*x" in error.what and "z" in error.what
    assert "Broken.mo:2" in str(error)


def test_dependent_equations_are_named_with_weights():
    m = Draft("Twice", unknowns=["a", "b", "c", "x"])
    for text in ("der(x) = -x + a", "a + b = x", "2*a + 2*b + c = 2*x", "c = 0*a"):
        m.equation(text)
    with pytest.raises(ModelError) as caught:
        split(linearize(m.flat()))
    error = caught.value
    assert error.code == "pencil-singular"
    for text in ("a + b = x", "2*a + 2*b + c = 2*x", "c = 0*a"):
        assert text in error.what
    assert "der(x)" not in error.what.split("\n", 1)[1]


def test_equations_that_one_parameter_value_makes_dependent_are_told_apart():
    m = Draft("Special", parameters={"g": 2.0, "k": 3.0}, unknowns=["a", "b", "x"])
    for text in ("der(x) = -k*x + a", "a + b = x", "g*a + 2*b = 2*x"):
        m.equation(text)
    with pytest.raises(ModelError) as caught:
        split(linearize(m.flat()))
    error = caught.value
    assert error.code == "pencil-singular" and error.what.startswith("at these values of the parameters ")
    last = error.what.splitlines()[-1]
    assert last.endswith("they do (index 1, 1 dynamic modes); g = 2 is a special value")
    assert split(linearize(replace(m, parameters={"g": 2.5, "k": 3.0}).flat())).index == 1
    m.equations[-1] = replace(m.equations[-1], text="2*a + 2*b = 2*x")
    with pytest.raises(ModelError) as caught:
        split(linearize(m.flat()))
    assert "at these values" not in caught.value.what and "special" not in caught.value.what


def test_dynamic_equations_can_be_dependent_too():
    m = Draft("DynamicTwice", unknowns=["x", "y", "z"])
    for text in ("der(x) + der(y) = -x - y", "2*der(x) + 2*der(y) = -2*x - 2*y", "z = x - y"):
        m.equation(text)
    with pytest.raises(ModelError) as caught:
        split(linearize(m.flat()))
    assert caught.value.code == "pencil-singular"
    assert "2*der(x)" in caught.value.what


def chain(n: int) -> Draft:
    """n masses in a row between walls, accelerations and spring forces as unknowns."""
    m = Draft("Chain", parameters={"c": 4.0, "m": 2.0})
    for i in range(n):
        m.unknowns += [f"x{i}", f"v{i}", f"a{i}", f"f{i}"]
        before = f"x{i} - x{i - 1}" if i else f"x{i}"
        after = f"f{i + 1}" if i + 1 < n else f"-c*x{i}"
        for text in (
            f"v{i} = der(x{i})",
            f"a{i} = der(v{i})",
            f"f{i} = c*({before})",
            f"m*a{i} = {after} - f{i}",
        ):
            m.equation(text)
    return m


def test_sparse_model_of_600_equations():
    n = 150
    dae = linearize(chain(n).flat())
    assert sp.issparse(dae.E)
    form = split(dae)
    # Closed form: fixed-fixed chain of n masses, ω_j = 2 sqrt(c/m) sin(jπ / (2(n+1))).
    want = 2 * np.sqrt(2.0) * np.sin(np.arange(1, n + 1) * np.pi / (2 * (n + 1)))
    got = np.sort(np.abs(np.linalg.eigvals(form.A).imag))[::2]
    assert (form.n_dynamic, form.index) == (2 * n, 1)
    np.testing.assert_allclose(got, np.sort(want), rtol=1e-8)
