"""A dead time at an input takes exact steps apart from what it drives: against LSODA of SciPy, and the
integration of all states together."""

from itertools import pairwise

import numpy as np
import pytest
from late_cart import PERIOD, cart, recording
from scipy.integrate import solve_ivp

from daest.estimation.nonlinear.shooting import _with_states
from daest.systems.events.integration import Correction
from daest.systems.reduction.initialize import initial_point
from daest.systems.simulation.driven_chain import driven_chain, driving
from daest.systems.simulation.integrate import ChainIntegrator, integrate, integrator

NAMES = ("m", "T", "a")


def run(model, time, u, theta, x0, **options):
    given = {"hold": "zoh", "state_scale": np.where(np.abs(x0) > 0.5, 20.0, 1.0), "max_steps": 10**7}
    return integrate(model, time, u, theta, x0, **(given | options))


def start(explicit, u):
    """With the chain in the middle of something."""
    x0 = initial_point(explicit, explicit.flat.theta_values, u[0])[0]
    x0[driven_chain(explicit).members] = np.linspace(3.0, -1.0, 10)
    return x0


def by_scipy(explicit, time, u, theta, x0):
    u = u[:, 0]

    def rates(t, x, level):
        return np.array(explicit.rhs(x, level, [], [], theta, t)).ravel()

    states = [x0]
    for (a, b), level in zip(pairwise(time), u[:-1], strict=True):
        made = solve_ivp(rates, (a, b), states[-1], "LSODA", rtol=1e-10, atol=1e-11, args=(level,))
        states.append(made.y[:, -1])
    return np.array(states)


def test_the_chain_of_a_dead_time_is_found():
    chain = driven_chain(cart("Base"))
    names = cart("Base").state_names
    assert [names[i] for i in chain.rest] == ["s", "v"]
    assert chain.members.size == 10 and np.allclose(chain.seen, 1.0)
    assert [cart("Base").flat.parameters[i].name for i in chain.by] == ["T"]
    assert not chain.is_shown and not chain.alone and driven_chain(cart("Accelerated")).is_shown


def test_no_chain_that_is_driven_by_states_or_seen_as_two_signals():
    assert driven_chain(cart("Behind")) is None
    twice = driven_chain(cart("Twice"))
    assert twice is None or twice.members.size == 10


@pytest.mark.slow  # all states together: below; scipy: test_integrate.py
@pytest.mark.parametrize("name", ["Base", "Accelerated"])
def test_states_and_outputs_are_those_of_scipy(name):
    explicit, (time, u) = cart(name), recording(20)
    theta, x0 = explicit.flat.theta_values, start(explicit, u)
    states = by_scipy(explicit, time, u, theta, x0)
    made = run(integrator(explicit), time, u, theta, x0, rtol=1e-8)
    known = driven_chain(explicit)
    # The chain is exact; what it drives feels a straight line of the same integrals.
    assert np.allclose(made.states[:, known.members], states[:, known.members], rtol=0.0, atol=1e-7)
    assert np.allclose(made.states[:, known.rest], states[:, known.rest], rtol=0.0, atol=1e-5)
    shown = [explicit.outputs(x, u[i], [], [], theta, 0.0) for i, x in enumerate(states)]
    reached = np.max(np.abs(np.array(shown)), axis=0).ravel()
    assert np.all(np.abs(made.outputs - np.array(shown)[..., 0]) < 1e-5 * reached)


@pytest.mark.parametrize(
    ("hold", "T"),
    [("zoh", 0.013), ("foh", 0.002), ("smooth", 0.09), pytest.param("zoh", 0.09, marks=pytest.mark.slow)],
)
def test_sensitivities_are_those_of_all_states_together(hold, T):
    explicit, (time, u) = cart("Accelerated"), recording()
    theta, x0 = explicit.flat.theta_values.copy(), start(explicit, u)
    theta[[p.name for p in explicit.flat.parameters].index("T")] = T
    model = integrator(explicit, NAMES)
    assert isinstance(model, ChainIntegrator)
    options = {"hold": hold, "sensitivities": True}
    made = run(model, time, u, theta, x0, rtol=1e-8, **options)
    known = run(model.stepped, time, u, theta, x0, rtol=1e-8, **options)
    assert made.sensitivities.shape == known.sensitivities.shape == (40, 2, 3 + 12)
    size = np.max(np.abs(known.sensitivities), axis=0)
    # A start that is forgotten within a part of a sample leaves next to nothing to be told.
    size = np.maximum(size, 1e-3 * size.max(axis=1, keepdims=True))
    assert np.max(np.abs(made.sensitivities - known.sensitivities) / size) < 1e-3


def test_an_observer_corrects_what_is_driven_and_its_sensitivities():
    explicit, (time, u) = cart("Base"), recording()
    theta, x0 = explicit.flat.theta_values, start(explicit, u)
    rng = np.random.default_rng(4)
    y = 0.1 * np.sin(3.0 * time)[:, None] + 0.01 * rng.standard_normal((time.size, 1))
    y[7] = np.nan
    gain = np.zeros((12, 1))
    gain[driven_chain(explicit).rest] = [[0.3], [2.0]]
    model = integrator(explicit, NAMES)
    varying = np.linspace(0.5, 1.5, time.size)[:, None, None] * gain
    for one in (Correction(y, gain, gain[None]), Correction(y, varying)):
        options = {"correction": one, "sensitivities": True, "rtol": 1e-8}
        made, known = (run(m, time, u, theta, x0, **options) for m in (model, model.stepped))
        assert made.n_steps < known.n_steps / 4
        assert np.allclose(made.outputs, known.outputs, rtol=0.0, atol=1e-6)
        told = [0, 1, 2, *(3 + driven_chain(explicit).rest), *range(15, known.sensitivities.shape[2])]
        size = np.max(np.abs(known.sensitivities[..., told]), axis=0)
        difference = (made.sensitivities - known.sensitivities)[..., told]
        assert np.max(np.abs(difference) / size) < 1e-3


def test_by_initial_states_alone():
    explicit, (time, u) = cart("Base"), recording(40)
    theta, x0 = explicit.flat.theta_values, start(explicit, u)
    model = integrator(explicit, NAMES)
    whole = run(model, time, u, theta, x0, sensitivities=True)
    alone = run(model, time, u, theta, x0, sensitivities=True, by_parameter=False)
    assert np.allclose(alone.sensitivities, whole.sensitivities[:, :, 3:], rtol=1e-12, atol=1e-15)


def test_outputs_that_are_states_of_the_chain():
    explicit, (time, u) = _with_states(cart("Base")), recording(40)
    theta, x0 = explicit.flat.theta_values, start(cart("Base"), u)
    model = integrator(explicit, NAMES)
    assert isinstance(model, ChainIntegrator) and len(model.chain.alone) == 10
    options = {"sensitivities": True, "rtol": 1e-8, "hold": "foh"}
    made, known = (run(m, time, u, theta, x0, **options) for m in (model, model.stepped))
    assert np.allclose(made.outputs, known.outputs, rtol=0.0, atol=1e-5)
    size = np.maximum(np.max(np.abs(known.sensitivities), axis=(0, 1)), 1e-9)
    assert np.max(np.abs(made.sensitivities - known.sensitivities) / size) < 1e-3


UNEVEN = {
    "one": np.where(np.arange(119) == 5, 1.03, 1.0),
    "multiples": np.array([1.0, 1.0, 3.0, 1.0, 2.0])[np.arange(119) % 5],
    "jitter": np.random.default_rng(6).uniform(0.8, 1.2, 119),
}


@pytest.mark.parametrize("kind", ["one", "multiples", "jitter"])
def test_uneven_steps_are_those_of_all_states_together(kind):
    explicit, (_, u) = cart("Accelerated"), recording(120)
    time = np.append(0.0, np.cumsum(PERIOD * UNEVEN[kind]))
    theta, x0 = explicit.flat.theta_values, start(explicit, u)
    model = integrator(explicit, NAMES)
    options = {"sensitivities": True, "rtol": 1e-8}
    made, known = (run(m, time, u, theta, x0, **options) for m in (model, model.stepped))
    assert made.n_steps < known.n_steps / 2
    assert np.allclose(made.states, known.states, rtol=0.0, atol=1e-5)
    size = np.max(np.abs(known.sensitivities), axis=0)
    size = np.maximum(size, 1e-3 * size.max(axis=1, keepdims=True))
    assert np.max(np.abs(made.sensitivities - known.sensitivities) / size) < 1e-3


def test_a_gap_and_a_gain_on_the_chain_are_integrated_together():
    explicit, (time, u) = cart("Base"), recording(30)
    theta, x0 = explicit.flat.theta_values, start(explicit, u)
    model = integrator(explicit, NAMES)
    late = time + np.where(np.arange(time.size) > 5, 5.0 * PERIOD, 0.0)
    made, known = (run(m, late, u, theta, x0) for m in (model, model.stepped))
    assert np.array_equal(made.states, known.states)
    every = Correction(np.zeros((time.size, 1)), np.full((12, 1), 0.1))
    made, known = (run(m, time, u, theta, x0, correction=every) for m in (model, model.stepped))
    assert np.array_equal(made.states, known.states)


def test_more_parameters_take_the_same_code_and_a_copy_is_made_anew():
    explicit = cart("Base")
    more, fewer = integrator(explicit, NAMES), integrator(explicit, NAMES[:1])
    assert fewer.beside is more.beside and fewer.names == NAMES[:1]
    make, arguments = more.__reduce__()
    assert isinstance(make(*arguments), ChainIntegrator) and make(*arguments).names == NAMES
    assert more.method(1e-6, "zoh").startswith("exact steps of 10 states")


def test_records_on_one_clock_take_the_steps_of_one_matrix(monkeypatch):
    """Each by itself, with that matrix; one for every sample takes far longer."""
    explicit, (_, u) = cart("Base"), recording(40)
    chain, theta = driven_chain(explicit), explicit.flat.theta_values
    columns, counts = [explicit.flat.parameter_names.index("T")], (25, 14)
    starts = np.linspace(3.0, -1.0, 20).reshape(2, 10)
    lengths = [np.full(n, PERIOD) for n in counts]
    given = [(u[: n + 1][:-1], u[: n + 1][1:], None) for n in counts]
    joined = (*(np.concatenate([one[i] for one in given]) for i in (0, 1)), None)
    monkeypatch.delattr("daest.systems.simulation.driven_chain.varying_recursion")
    both = driving(chain, theta, columns, lengths, joined, starts)
    alone = [
        driving(chain, theta, columns, [own], one, start[None])
        for own, one, start in zip(lengths, given, starts, strict=True)
    ]
    assert np.allclose(both.states, np.vstack([one.states for one in alone]), rtol=1e-12, atol=1e-14)
    slopes = np.concatenate([one.slopes for one in alone], axis=1)
    assert np.allclose(both.slopes, slopes, rtol=1e-12, atol=1e-14)
