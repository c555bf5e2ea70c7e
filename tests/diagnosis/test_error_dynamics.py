"""Error dynamics of an observer against differences of its own runs."""

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from hidden_plants import model, rotor_record

from daest.diagnosis.evidence.stand import begin
from daest.diagnosis.null_model.error_dynamics import average_dynamics, dynamics_along
from daest.diagnosis.null_model.null_observer import error_covariance, run_null
from daest.diagnosis.options import DiagnoseOptions
from daest.estimation.nonlinear.observer import average_model
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_text
from daest.modelica.effects.attach import attach
from daest.modelica.effects.catalogue import effect_library
from daest.modelica.places.sites import sites
from daest.systems.events.integration import Correction
from daest.systems.reduction.reduce import reduce_index
from daest.systems.simulation.integrate import integrate, integrator

PUSH = 1e-5  # N.m


def rubbing(sharpness):
    """The rotor with friction over a soft sign, so that differences of runs are exact."""
    effect = next(e for e in effect_library() if e.class_name.endswith("Rotational.CoulombFriction"))
    site = next(s for s in sites(model()) if s.name == "rotor.flange_a")
    return attach(model(), effect, site, "rub", {"tau_c": 0.15, "w_s": sharpness})


def null_of(flat, record):
    stand = begin(flat, [record], [], DiagnoseOptions(hold="foh"))
    return stand.null, run_null(stand.null)


def pushed(null, run, torque):
    """Predicted outputs of the observer with a further torque (n_samples,) on straight lines."""
    explicit = null.explicit
    experiment = null.experiments[0]
    row = run.state_names.index(null.loads[0].name)
    entry = run.average.A[:, row].copy()
    entry[row] = 0.0
    arguments = explicit.rhs.sx_in()
    extra = ca.SX.sym("push")
    x, u, v, w, theta, t = arguments
    with_push = [x, ca.vertcat(u, extra), v, w, theta, t]
    grown = replace(
        explicit,
        flat=replace(
            explicit.flat,
            inputs=(*explicit.flat.inputs, replace(explicit.flat.inputs[0], name="push")),
            u=ca.vertcat(explicit.flat.u, ca.SX.sym("push")),
        ),
        rhs=ca.Function("rhs", with_push, [explicit.rhs(*arguments) + ca.DM(entry) * extra]),
        outputs=ca.Function("outputs", with_push, [explicit.outputs(*arguments)]),
    )
    x0 = np.array([null.initial_states[0][name] for name in explicit.state_names])
    return integrate(
        integrator(grown),
        experiment.time,
        np.column_stack([experiment.inputs, torque]),
        null.theta,
        x0,
        hold="foh",
        correction=Correction(experiment.outputs, run.gain),
        rtol=1e-9,
    ).outputs, entry


def relative_errors(flat, missing=None):
    """Of the response to a small torque, against the difference of two runs: by the error dynamics along the
    recording, and by those of the average slopes. The samples `missing` are none."""
    record = rotor_record(400, seed=5, coulomb=lambda phi: 0.15)[0]
    if missing is not None:
        outputs = record.outputs.copy()
        outputs[missing] = np.nan
        record = replace(record, outputs=outputs)
    null, run = null_of(flat, record)
    torque = PUSH * np.sin(1.3 * null.experiments[0].time)
    (up, entry), (down, _) = pushed(null, run, torque), pushed(null, run, -torque)
    g = torque[:, None] * entry
    drive, expected = np.stack([g[:-1], g[1:]])[None], (up - down) / 2.0
    course = np.stack([torque[:-1], torque[1:]])[None]
    alike = run.dynamics[0].errors(drive), run.dynamics[0].errors_along(course, entry)
    np.testing.assert_allclose(*alike, atol=1e-12 * np.max(np.abs(expected)))
    return [
        np.max(np.abs(dynamics.errors(drive)[0] - expected)) / np.max(np.abs(expected))
        for dynamics in (run.dynamics[0], average_dynamics(run.average).watched(run.gain))
    ]


@pytest.mark.slow  # nonlinear: below
def test_response_of_an_affine_model_is_the_difference_of_two_runs():
    along, average = relative_errors(model())
    assert along < 1e-3 and average == along


@pytest.mark.parametrize("sharpness", [0.05, pytest.param(0.2, marks=pytest.mark.slow)])
def test_response_of_a_rubbing_model_is_the_difference_of_two_runs(sharpness):
    along, average = relative_errors(rubbing(sharpness))
    assert along < 0.01
    assert average > 5.0 * along and average > 0.05


@pytest.mark.parametrize("hidden", [{}, pytest.param({"coulomb": lambda phi: 0.15}, marks=pytest.mark.slow)])
def test_outputs_show_the_errors_of_the_states(hidden):
    flat = rubbing(0.2) if hidden else model()
    null, run = null_of(flat, rotor_record(400, seed=3, **hidden)[0])
    dynamics, rng = run.dynamics[0], np.random.default_rng(1)
    n, m = len(run.state_names), null.experiments[0].n_samples
    drive, direct = rng.normal(size=(2, 2, m - 1, n)), rng.normal(size=(2, m, 1))
    C = np.broadcast_to(dynamics.open_loop.C, (m, 1, n))
    shown = np.einsum("kmn,myn->kmy", dynamics.state_errors(drive, direct), C)
    assert np.allclose(dynamics.errors(drive, direct), shown + direct)


@pytest.mark.slow
def test_error_at_the_start_goes_on_as_one_that_a_drive_has_left():
    null, run = null_of(model(), rotor_record(400, seed=3)[0])
    dynamics, n, m = run.dynamics[0], len(run.state_names), null.experiments[0].n_samples
    drive = np.zeros((1, 2, m - 1, n))
    drive[0, :, 0] = np.arange(1.0, n + 1.0)
    (later,) = dynamics.state_errors(drive, np.zeros((1, m, 1)))
    begun = dynamics.from_start(m)
    assert np.array_equal(begun[:, 0], np.eye(n)) and np.any(later[1])
    assert np.allclose(later[1:], np.einsum("i,imn->mn", later[1], begun)[:-1])


SINGULAR = """model Singular "A capacity that shrinks to nothing at x = 1"
  parameter Real T(unit = "s") = 1;
  input Real u(unit = "1");
  output Real y(unit = "1") annotation(__Daest(std = 0.01));
  Real x(unit = "1", start = 0);
equation
  T*(1 - x)*der(x) = u - x;
  y = x;
end Singular;
"""


def test_where_a_filtered_state_meets_a_singularity_errors_are_those_of_the_average():
    explicit = reduce_index(compile_text(SINGULAR.encode(), Path("Singular.mo")))
    time, u = 0.1 * np.arange(6), np.full((6, 1), 2.0)
    far, near = np.full((6, 1), 0.1), np.full((6, 1), 0.99)
    average = average_model(explicit, np.ones(1), time, far, u)
    records = tuple(Experiment(name, time, u, far, ("u",), ("y",)) for name in ("far", "near"))
    found = dynamics_along(explicit, average, records, [far, near], [far, near], "zoh", 1e-6)
    constant = average_dynamics(average)
    assert found[0].transition.shape == (5, 1, 1)
    np.testing.assert_array_equal(found[1].transition, constant.transition)


@pytest.mark.slow
def test_observer_does_not_correct_where_a_sample_is_missing():
    along, _ = relative_errors(rubbing(0.3), slice(0, None, 3))
    assert along < 1e-3


def test_errors_of_sensors_that_are_read_at_different_times_are_independent():
    rng = np.random.default_rng(3)
    errors = rng.standard_normal((400, 2)) @ np.array([[2.0, 1.0], [0.0, 1.0]])
    whole = error_covariance(errors)
    np.testing.assert_allclose(whole, errors.T @ errors / 400)
    errors[::2, 0], errors[1::2, 1] = np.nan, np.nan
    apart = error_covariance(errors)
    assert apart[0, 1] == 0.0
    np.testing.assert_allclose(np.diagonal(apart), np.diagonal(whole), rtol=0.2)
