"""Laws that are added to inputs: compiled and in Python, against the law written into the equation."""

import numpy as np
import pytest
from ball_fmu import ball
from scipy.integrate import solve_ivp

from daest.fmu import binary_form
from daest.fmu.binary_form import BinaryForm
from daest.fmu.laws import KINDS, SIZED, Law

TIME = np.linspace(0.0, 2.0, 41)
FORCE = 9.81 + 3.0 * np.sin(3.0 * TIME)
COLUMN = np.cos(5.0 * TIME)
SHAPES = {"sign": (0.3,), "sine": (2.0, 0.5), "saturation": (1.0,)}
COLUMN_LAWS = ("recorded", "dead zone", "saturation")
STEP = 1e-2  # relative; the trajectories are good to 1e-7


def along(law, size):
    """h(t) with the law in the equation, by an independent integrator, straight between the samples."""

    def rate(t, x):
        read = np.interp(t, TIME, COLUMN) if law in COLUMN_LAWS else x[1]
        added = Law(law, 0, (), SHAPES.get(law, ()), size).value(np.array([read]), np.zeros(0))
        return [x[1], -9.81 - 0.1 * x[1] * abs(x[1]) + np.interp(t, TIME, FORCE) + added]

    options = {"method": "DOP853", "rtol": 1e-10, "atol": 1e-12, "max_step": 0.05}
    return solve_ivp(rate, (0.0, 2.0), [1.0, 0.0], t_eval=TIME, **options).y[0]


def followed(path, law, size, by_size):
    flat = BinaryForm(path).flat()
    column = 1 if law in COLUMN_LAWS else None
    u = np.column_stack([FORCE, COLUMN])
    reads = () if law == "constant" or law in COLUMN_LAWS else (1,)
    laws = (Law(law, 0, reads, SHAPES.get(law, ()), size, column),)
    drive = flat.given.drive(TIME, u[:-1], u[1:], u[-1], (5,))
    drive = type(drive)(**{**drive.__dict__, "laws": laws})
    found = flat.given.integrate_with_laws(
        flat, ("d",), drive, np.array([0.1, 0.7, 9.81]), np.array([1.0, 0.0]), np.ones(2),
        np.array([STEP * size]) if by_size else None,
    )  # fmt: skip
    return flat.given.method, found


@pytest.mark.parametrize("law", KINDS)
@pytest.mark.parametrize("compiled", [True, False])
def test_law_at_an_input(tmp_path, monkeypatch, law, compiled):
    if not compiled:
        monkeypatch.setattr(binary_form, "engine_library", lambda *_: None)
    size = 5e6 if law == "fourth power" else 0.4
    method, (_, outputs, slopes) = followed(ball(tmp_path), law, size, True)
    assert method.startswith("Radau IIA" if compiled else "CVODE")
    np.testing.assert_allclose(outputs[:, 0], along(law, size), atol=2e-5)
    step = STEP * size
    by_size = (along(law, size + step) - along(law, size - step)) / (2 * step)
    # The corners of the last two make both differences coarser.
    tolerance = 1e-2 if law in SIZED else 2e-3
    np.testing.assert_allclose(slopes[:, 0, 1], by_size, atol=tolerance * np.abs(by_size).max())
    assert slopes.shape == (41, 1, 4)  # by d, the size, and two initial states


def test_simulation_alone_has_no_slopes(tmp_path):
    _, (states, outputs, slopes) = followed(ball(tmp_path), "square", 0.4, False)
    assert slopes.shape == (41, 1, 0)
    np.testing.assert_array_equal(states[:, 0], outputs[:, 0])
