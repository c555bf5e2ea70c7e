"""A dead time of a sensor takes exact steps behind the machine: against the integration of all states
together."""

import numpy as np
import pytest
from late_cart import PERIOD, cart, recording

from daest.systems.events.integration import Correction
from daest.systems.reduction.initialize import initial_point
from daest.systems.simulation.integrate import (
    TrailingIntegrator,
    integrate,
    integrate_all,
    integrator,
    record,
)
from daest.systems.simulation.trailing_chain import trailing_chain

NAMES = ("m", "T", "k")


def run(model, time, u, theta, x0, **options):
    given = {"hold": "zoh", "rtol": 1e-8, "max_steps": 10**7}
    return integrate(model, time, u, theta, x0, **(given | options))


def start(explicit, u):
    """With the chain in the middle of something."""
    x0 = initial_point(explicit, explicit.flat.theta_values, u[0])[0]
    x0[trailing_chain(explicit).members] = np.linspace(0.03, -0.01, 10)
    return x0


def are_close(made, known, share=1e-3):
    size = np.max(np.abs(known), axis=0)
    # A start that is forgotten within a part of a sample leaves next to nothing to be told.
    size = np.maximum(size, 1e-3 * size.max(axis=-1, keepdims=True))
    return bool(np.max(np.abs(made - known) / size) < share)


def test_the_chain_of_a_dead_time_is_found():
    chain = trailing_chain(cart("Behind"))
    assert [cart("Behind").state_names[i] for i in chain.rest] == ["s", "v"]
    assert chain.members.size == 10 and chain.model.n_states == 2
    assert [cart("Behind").flat.parameters[i].name for i in chain.by] == ["T"]
    assert np.allclose(chain.shown, 1.0) and np.max(chain.drive) == 1.0


@pytest.mark.parametrize("name", ["Base", "Accelerated", "Twice", "Direct"])
def test_no_chain_that_something_feels_or_that_the_input_drives(name):
    assert trailing_chain(cart(name)) is None


@pytest.mark.parametrize(("hold", "T"), [("zoh", 0.013), ("foh", 0.002), ("smooth", 0.09)])
def test_states_and_sensitivities_are_those_of_all_states_together(hold, T):
    explicit, (time, u) = cart("Behind"), recording()
    theta, x0 = explicit.flat.theta_values.copy(), start(explicit, u)
    theta[[p.name for p in explicit.flat.parameters].index("T")] = T
    model = integrator(explicit, NAMES)
    assert isinstance(model, TrailingIntegrator)
    options = {"hold": hold, "sensitivities": True}
    made, known = (run(m, time, u, theta, x0, **options) for m in (model, model.stepped))
    # Of the polynomials of the window, those of high degree are small beside what passes through it.
    assert np.allclose(made.states, known.states, rtol=0.0, atol=1e-5 * np.max(np.abs(known.states)))
    assert are_close(made.outputs, known.outputs, 1e-5)
    assert made.sensitivities.shape == known.sensitivities.shape == (40, 1, 3 + 12)
    assert are_close(made.sensitivities, known.sensitivities)


def test_an_observer_corrects_the_machine_and_the_chain():
    explicit, (time, u) = cart("Behind"), recording()
    theta, x0 = explicit.flat.theta_values, start(explicit, u)
    rng = np.random.default_rng(4)
    y = 0.1 * np.sin(3.0 * time)[:, None] + 0.01 * rng.standard_normal((time.size, 1))
    y[7] = np.nan
    gain = rng.uniform(0.05, 0.3, (12, 1))
    model = integrator(explicit, NAMES)
    varying = np.linspace(0.5, 1.5, time.size)[:, None, None] * gain
    for one in (Correction(y, gain, gain[None]), Correction(y, varying)):
        options = {"correction": one, "sensitivities": True}
        made, known = (run(m, time, u, theta, x0, **options) for m in (model, model.stepped))
        assert made.n_steps < known.n_steps / 2
        assert are_close(made.states, known.states, 1e-4)
        assert are_close(made.sensitivities, known.sensitivities)


def test_by_initial_states_alone_and_without_slopes():
    explicit, (time, u) = cart("Behind"), recording()
    theta, x0 = explicit.flat.theta_values, start(explicit, u)
    model = integrator(explicit, NAMES)
    whole = run(model, time, u, theta, x0, sensitivities=True)
    alone = run(model, time, u, theta, x0, sensitivities=True, by_parameter=False)
    assert np.allclose(alone.sensitivities, whole.sensitivities[:, :, 3:], rtol=1e-9, atol=1e-12)
    assert np.allclose(run(model, time, u, theta, x0).outputs, whole.outputs, rtol=1e-12)


def test_uneven_times_are_integrated_together():
    explicit, (time, u) = cart("Behind"), recording(30)
    theta, x0 = explicit.flat.theta_values, start(explicit, u)
    model = integrator(explicit, NAMES)
    late = time + np.where(np.arange(time.size) > 5, 0.3 * PERIOD, 0.0)
    made, known = (run(m, late, u, theta, x0) for m in (model, model.stepped))
    assert np.array_equal(made.states, known.states)


def test_several_records_follow_each_other():
    explicit, (time, u) = cart("Behind"), recording(30)
    theta, x0 = explicit.flat.theta_values, start(explicit, u)
    model = integrator(explicit, NAMES)
    gain = np.full((12, 1), 0.1)
    parts = [(slice(0, 12), x0), (slice(12, 30), 0.5 * x0)]
    records = [record(explicit, time[rows], u[rows], "zoh") for rows, _ in parts]
    corrections = [Correction(0.01 * time[rows][:, None], gain) for rows, _ in parts]
    starts = np.array([begun for _, begun in parts])
    both = integrate_all(model, records, theta, starts, corrections, sensitivities=True)
    for made, (rows, begun), one in zip(both, parts, corrections, strict=True):
        options = {"correction": one, "sensitivities": True, "rtol": 1e-6, "max_steps": None}
        alone = run(model, time[rows], u[rows], theta, begun, **options)
        # The length of a sample interval is that of the first record, to rounding.
        assert np.allclose(made.outputs, alone.outputs, rtol=0.0, atol=1e-9)
        assert np.allclose(made.sensitivities, alone.sensitivities, rtol=0.0, atol=1e-7)


def test_a_copy_is_made_anew_and_fewer_parameters_take_the_same_code():
    explicit = cart("Behind")
    more, fewer = integrator(explicit, NAMES), integrator(explicit, NAMES[:1])
    assert fewer.beside is more.beside and fewer.names == NAMES[:1]
    make, arguments = more.__reduce__()
    assert isinstance(make(*arguments), TrailingIntegrator) and make(*arguments).names == NAMES
    assert more.method(1e-6, "zoh").startswith("exact steps of 10 states behind")
