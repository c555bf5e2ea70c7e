"""Models with heat ports and lost power, which only look nonlinear: their laws, simulation and identification
against closed forms and against a quadrature of SciPy."""

from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from daest.estimation.identify import identify
from daest.model.experiment import Experiment
from daest.model.fit import IdentifyOptions
from daest.modelica.compile import compile_model
from daest.systems.linear.linearize import has_affine_dynamics, is_affine_model, linearize
from daest.systems.linear.noise import noise_report
from daest.systems.linear.state_space import state_space, state_space_family
from daest.systems.reduction.reduce import reduce_index
from daest.systems.simulation.simulate import simulate

SOURCE = Path(__file__).parent / "models" / "HeatedServo.mo"
HOT = 2.0 * (1.0 + 0.004 * (350.0 - 300.15))  # ohms
R, L, K, J = HOT + 1.0, 0.1, 0.5, 0.02


@cache
def circuit(name="Circuit"):
    return compile_model(SOURCE, f"HeatedServo.{name}")


def drive(n=200, period=0.01):
    time = period * np.arange(n)
    return time, np.sign(np.sin(7.0 * time + 0.1))[:, None]


def test_settled_unknowns_and_lost_power_leave_the_dynamics_affine():
    flat = circuit()
    assert flat.n == 23 and not is_affine_model(flat)
    assert has_affine_dynamics(reduce_index(flat))
    ss = state_space(state_space_family(flat), flat.theta_values)
    assert ss.state_names == ("hot.i", "winding.w")
    assert np.allclose(ss.A, [[-R / L, -K / L], [K / J, 0.0]], rtol=1e-14)
    assert np.allclose(ss.B, [[1.0 / L], [0.0]], rtol=1e-14) and not ss.b.any()


def test_an_output_that_is_no_affine_function_is_seen():
    assert not has_affine_dynamics(reduce_index(circuit("Measured")))


def test_nonlinear_variables_of_an_exact_simulation():
    flat, (time, u) = circuit(), drive()
    found = simulate(flat, (time, u), hold="zoh")
    assert found.method.startswith("matrix exponential")

    def rates(t, x):
        level = u[min(int(t / 0.01 + 1e-9), len(u) - 1), 0]
        return [(level - R * x[0] - K * x[1]) / L, K * x[0] / J]

    x = [np.zeros(2)]
    for a, b in pairwise(time):
        x.append(solve_ivp(rates, (a, b - 1e-12), x[-1], rtol=1e-11, atol=1e-12).y[:, -1])
    i = np.array(x)[:, 0]
    column = found.variable_names.index
    assert np.allclose(found.variables[:, column("hot.i")], i, atol=1e-8)
    assert np.allclose(found.variables[:, column("hot.LossPower")], HOT * i**2, atol=1e-8)
    assert np.ptp(HOT * i**2) > 0.1


def test_identification_takes_the_exact_way(monkeypatch):
    monkeypatch.delattr("daest.estimation.identify._nonlinear_fit")
    flat, (time, u) = circuit(), drive(400)
    clean = simulate(flat, (time, u), hold="zoh").outputs
    y = clean + 0.01 * np.random.default_rng(3).standard_normal(clean.shape)
    start = {"winding.J": 0.03, "winding.k": 0.4}
    options = IdentifyOptions(start=start, estimate=tuple(start), hold="zoh")
    fit = identify(flat, [Experiment("run", time, u, y, ("u",), ("y",))], options)
    for parameter in fit.parameters:
        true = {"winding.J": J, "winding.k": K}[parameter.name]
        assert abs(parameter.value - true) < 4 * parameter.std_error < 0.1 * true


def test_equations_stay_those_of_the_user():
    report = noise_report(linearize(circuit()))
    assert len(report.places) == 23 and report.n_dynamic == 2
    by_text = {place.name: place.admissible for place in report.places}
    assert by_text["hot.v = hot.R_actual*hot.i"]
