"""A body on a spring and a damper between it and a moving ground: whose rate acts only by the damper."""

import numpy as np
import pytest
from flat_models import Draft

from daest.errors import ModelError
from daest.estimation.identify import identify
from daest.model.experiment import Experiment
from daest.model.fit import IdentifyOptions
from daest.systems.linear.state_space import stacked_inputs, state_space, state_space_family
from daest.systems.reduction.input_slopes import acting_slopes, acting_slopes_of, theta_in_use
from daest.systems.reduction.reduce import reduce_index
from daest.systems.simulation.integrate import input_bends, inputs_at_ends
from daest.systems.simulation.simulate import simulate

TIME = 0.01 * np.arange(400)


def shaken(d=0.0, cubic=0.0):
    draft = Draft(
        "Shaken",
        parameters={"m": 2.0, "c": 80.0, "d": d, "c3": cubic, "b": 1.0},
        unknowns=["s", "v", "s_rel", "v_rel"],
        inputs=["z"],
    )
    draft.outputs = {"y": "s"}
    for text in ("s_rel = z - s", "v_rel = der(s_rel)", "der(s) = v"):
        draft.equation(text)
    draft.equation("m*der(v) = c*s_rel + d*v_rel + c3*s_rel**3 - b*v")
    return draft.flat()


def held_ground(seed=1):
    return np.repeat(np.random.default_rng(seed).normal(size=40), 10)[:, None]


def recorded(flat, u, hold):
    moved = simulate(flat, (TIME, u), hold=hold)
    y = moved.outputs + 0.01 * np.random.default_rng(2).normal(size=moved.outputs.shape)
    return Experiment("shaken", TIME, u, y, ("z",), ("y",))


@pytest.mark.parametrize(("d", "cubic"), [(0.0, 0.0), (0.0, 5.0), (3.0, 0.0), (3.0, 5.0)])
def test_rate_of_the_ground_acts_by_the_damper_alone(d, cubic):
    explicit = reduce_index(shaken(d, cubic))
    assert len(explicit.input_derivatives) == 1
    assert len(acting_slopes(explicit)) == (d != 0.0)
    assert len(acting_slopes(explicit, ("d",))) == 1
    if cubic == 0.0:
        family = state_space_family(explicit)
        for names in ((), ("d",)):
            ss = state_space(family, theta_in_use(family.parameters, names))
            assert len(acting_slopes_of(ss)) == (d != 0.0 or names == ("d",))


@pytest.mark.parametrize("cubic", [0.0, 5.0])
def test_held_ground_moves_the_body_and_leaves_the_rate_untold(cubic):
    u = held_ground()
    result = simulate(shaken(cubic=cubic), (TIME, u), hold="zoh")
    # The same by ten steps a sample: the ground then jumps within a tenth of one.
    fine = np.linspace(0.0, TIME[-1], 10 * (TIME.size - 1) + 1)
    ground = u[np.minimum((fine / 0.01 + 1e-6).astype(int), TIME.size - 1)]
    other = simulate(shaken(cubic=cubic), (fine, ground), hold="foh")
    assert np.allclose(result["s"], other["s"][::10], atol=0.06 * np.std(other["s"]))
    assert np.all(np.isnan(result["v_rel"]))
    assert np.all(np.isfinite(result["s_rel"]))


@pytest.mark.parametrize("cubic", [pytest.param(0.0, marks=pytest.mark.slow), 5.0])
def test_hold_is_chosen_where_the_rate_does_not_act(cubic):
    record = recorded(shaken(cubic=cubic), held_ground(), "zoh")
    fit = identify(shaken(cubic=cubic), [record], IdentifyOptions(estimate=("c",)))
    assert fit.hold == "zoh"
    assert not any("derivative" in note for note in fit.notes)
    assert abs(fit.theta["c"] - 80.0) < 4.0 * fit.parameters[0].std_error
    both = identify(shaken(cubic=cubic), [record], IdentifyOptions(estimate=("c", "d"), start={"d": 0.5}))
    assert both.hold == "foh"
    assert any("derivative of input z" in note for note in both.notes)


@pytest.mark.parametrize("cubic", [0.0, 5.0])
def test_ground_under_a_damper_runs_straight_without_a_word(cubic):
    u = np.sin(2.0 * TIME + 3.0 * np.sin(0.9 * TIME))[:, None]
    fit = identify(
        shaken(3.0, cubic), [recorded(shaken(3.0, cubic), u, "foh")], IdentifyOptions(estimate=("c",))
    )
    assert (fit.hold, fit.status) == ("foh", "converged")
    assert abs(fit.theta["c"] - 80.0) < 4.0 * fit.parameters[0].std_error


@pytest.mark.parametrize("cubic", [0.0, 5.0])
def test_a_damper_is_not_estimated_under_a_ground_that_is_held(cubic):
    record = recorded(shaken(cubic=cubic), held_ground(), "zoh")
    options = IdentifyOptions(estimate=("c", "d"), start={"d": 0.5}, hold="zoh")
    with pytest.raises(ModelError) as refused:
        identify(shaken(cubic=cubic), [record], options)
    assert refused.value.code == "input-derivative-hold"


def test_acceleration_that_no_loop_contains_may_be_missing():
    """A source of motion computes its acceleration, which nothing needs; the slip of dry friction behind a
    spring is found by iterations that do not contain it."""
    draft = Draft(
        "Rubbing",
        parameters={"c": 80.0, "d": 2.0, "f": 5.0},
        unknowns=["s", "v", "z_s", "w", "a"],
        inputs=["z"],
    )
    draft.outputs = {"y": "s"}
    for text in ("w = der(z_s)", "a = der(w)", "z_s = z", "v = der(s)"):
        draft.equation(text)
    draft.equation("d*v + f*tanh(v) + v**3 = c*(z - s)")
    explicit = reduce_index(draft.flat())
    assert max(d.order for d in explicit.input_derivatives) == 2
    assert not acting_slopes(explicit)


def test_slopes_of_straight_inputs_are_those_of_linear_models_at_samples_and_of_the_lines_between():
    explicit = reduce_index(shaken(3.0, 5.0))
    time = np.cumsum(np.random.default_rng(5).uniform(0.005, 0.02, 300))
    u = np.random.default_rng(6).normal(size=(300, 1))
    start, end = inputs_at_ends(explicit, time, u, "foh")
    at_samples = stacked_inputs(u, time, ((0, 1),))
    assert np.allclose(start, at_samples[:-1]) and np.allclose(end, at_samples[1:])
    bent = input_bends(explicit, time, u, "foh")
    assert bent is not None and not bent[:, :, 0].any() and not bent[:, 1].any()
    mean = 0.5 * (start + end)[:, 1] + bent[:, 0, 1] / 6.0
    assert np.allclose(mean, np.diff(u[:, 0]) / np.diff(time))
    assert input_bends(explicit, time, u, "zoh") is None


def pushed(cubic):
    """A force that speeds up a mass and bends with its speed, whose readings alternate."""
    draft = Draft("Pushed", parameters={"p": 2.0, "q": cubic}, unknowns=["F", "v"], inputs=["w"])
    draft.outputs = {"y": "F"}
    draft.equation("v = w")
    draft.equation("F = p*der(v) + q*v**3")
    return draft.flat()


@pytest.mark.parametrize("cubic", [0.0, 1e-9])
def test_rate_of_a_jittery_input_is_the_same_whether_the_model_bends_or_not(cubic):
    w = np.repeat(np.random.default_rng(7).normal(size=200), 2)[:, None]
    force = 2.0 * np.gradient(w[:, 0], TIME)[:, None]
    assert np.allclose(simulate(pushed(cubic), (TIME, w), hold="foh").outputs, force, atol=1e-6)
    noisy = force + np.random.default_rng(8).normal(size=force.shape)
    fit = identify(
        pushed(cubic),
        [Experiment("pushed", TIME, w, noisy, ("w",), ("y",))],
        IdentifyOptions(estimate=("p",), hold="foh"),
    )
    assert fit.theta["p"] == pytest.approx(2.0, abs=0.01)
