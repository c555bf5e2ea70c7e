"""Sizes of effects that start far from the truth: the number of a class says nothing about a machine."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from daest.estimation.identify import identify
from daest.model.experiment import Experiment
from daest.model.fit import IdentifyOptions
from daest.modelica.compile import compile_text

MODEL = """model Duffing
  parameter Real c(unit = "N/m") = 100 annotation(__Daest(estimate = true));
  parameter Real c3(unit = "N/m3", min = 0) = 1e9
    annotation(__Daest(estimate = true, role = "size", null = 0));
  input Real f(unit = "N");
  output Real s(unit = "m", start = 0);
  Real v(unit = "m/s", start = 0);
equation
  der(s) = v;
  der(v) = f - c*s - 2*v - c3*s^3;
end Duffing;
"""
BIAS = """  parameter Real b(unit = "N") = 20
    annotation(__Daest(estimate = true, role = "size", null = 0));
  input"""
TRUTH = {"c": 120.0, "c3": 4000.0}


@cache
def recording() -> Experiment:
    """From scipy; straight lines between the samples of the force."""
    rng, time = np.random.default_rng(3), 0.02 * np.arange(400.0)
    force = np.convolve(np.repeat(rng.normal(size=40), 10) * 20.0, np.ones(4) / 4.0, "same")

    def rates(t, x):
        f = np.interp(t, time, force)
        return [x[1], f - TRUTH["c"] * x[0] - 2.0 * x[1] - TRUTH["c3"] * x[0] ** 3]

    s = solve_ivp(rates, (0, time[-1]), [0, 0], t_eval=time, rtol=1e-8, atol=1e-10, max_step=0.02).y[0]
    s += 0.001 * rng.normal(size=time.size)
    return Experiment("run", time, force[:, None], s[:, None], ("f",), ("s",))


@pytest.mark.parametrize("start", [pytest.param(1e9, marks=pytest.mark.slow), 1e3])
def test_a_size_of_which_nothing_is_known_is_found(start):
    flat = compile_text(MODEL.replace("1e9", f"{start}").encode(), Path("Duffing.mo"))
    fit = identify(flat, [recording()], IdentifyOptions(method="oe"))
    assert fit.is_converged and fit.hold == "foh"
    for parameter in fit.parameters:
        assert abs(parameter.value - TRUTH[parameter.name]) < 4.0 * parameter.std_error
    assert fit.simulated["estimation"].rms["s"] == pytest.approx(0.001, rel=0.1)


def test_a_size_that_a_wrong_model_does_not_ask_for_is_still_searched_for():
    # With seven times the true stiffness, next to no cubic spring and no load fit best.
    text = MODEL.replace("1e9", "20000.0").replace('c(unit = "N/m") = 100', 'c(unit = "N/m") = 800')
    flat = compile_text(
        text.replace("c3*s^3", "c3*s^3 - b", 1).replace("  input", BIAS, 1).encode(), Path("D.mo")
    )
    fit = identify(flat, [recording()], IdentifyOptions(method="oe", hold="foh"))
    found = {p.name: p for p in fit.parameters}
    assert fit.is_converged
    assert abs(found["c3"].value - TRUTH["c3"]) < 4.0 * found["c3"].std_error
    assert found["c3"].initial == 20000.0  # what was given is told, not where the search began
    assert found["b"].initial == 20.0
