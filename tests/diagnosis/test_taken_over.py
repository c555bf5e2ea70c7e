"""Unknown loads that take over what the inputs do: a strut with a damper that is harder one way, whose force
acts on two bodies, while loads can act on one alone; or what the model itself does."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from daest.diagnosis.evidence import stand as stands
from daest.diagnosis.evidence.stand import begin
from daest.diagnosis.options import DiagnoseOptions
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_text

CAR = b"""model Car
  parameter Real ms(unit = "kg", min = 0) = 300 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real c(unit = "N/m", min = 0) = 15000 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real d(unit = "N.s/m", min = 0) = 1000 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real ct(unit = "N/m", min = 0) = 150000 annotation(__Daest(estimate = true, scale = "log"));
  input Real road(unit = "m");
  output Real a(unit = "m/s2");
  output Real travel(unit = "m");
  Real zs(unit = "m"), zu(unit = "m"), vs(unit = "m/s"), vu(unit = "m/s"), F(unit = "N");
equation
  der(zs) = vs;
  der(zu) = vu;
  F = c*(zu - zs) + d*(vu - vs);
  ms*der(vs) = F;
  40*der(vu) = ct*(road - zu) - F;
  a = der(vs);
  travel = zs - zu;
end Car;
"""


def recording(n: int = 2400) -> Experiment:
    rng, time = np.random.default_rng(5), 0.005 * np.arange(n)
    road = np.zeros(n)
    for k in range(n - 1):
        road[k + 1] = 0.997 * road[k] + 0.0042 * rng.normal()
    road = np.convolve(road, np.ones(5) / 5.0, "same")

    def rates(t, x):
        zs, zu, vs, vu = x
        force = 16000.0 * (zu - zs) + 1100.0 * (vu - vs) + 500.0 * min(vu - vs, 0.0)
        return [vs, vu, force / 290.0, (160000.0 * (np.interp(t, time, road) - zu) - force) / 40.0]

    x = solve_ivp(rates, (0, time[-1]), [0.0] * 4, t_eval=time, rtol=1e-7, atol=1e-9, max_step=0.004).y
    a = np.array([rates(t, one)[2] for t, one in zip(time, x.T, strict=True)])
    y = np.column_stack([a, x[0] - x[1]])
    y += [0.02, 0.01] * y.std(axis=0) * rng.normal(size=y.shape)
    return Experiment("run", time, road[:, None], y, ("road",), ("a", "travel"))


@pytest.mark.slow
def test_parameters_stay_at_the_simulation_where_loads_take_over_what_the_input_does():
    """Free beside the load, the model fits less than a third of either output; by simulation it fits most."""
    flat = compile_text(CAR, Path("Car.mo"))
    stand = begin(flat, [recording()], (), DiagnoseOptions(jobs=1, hold="foh"))
    assert stand.null.estimated == () and not stand.reference.adds_up
    fit = stand.told.simulated["estimation"].fit_percent
    assert fit["a"] > 80.0 and fit["travel"] > 60.0
    values = {p.name: p.value for p in stand.null.flat.parameters}
    assert abs(values["ct"] / 160000.0 - 1.0) < 0.05 and abs(values["ms"] / 290.0 - 1.0) < 0.05


def simulated(errors, is_adrift=True):
    """A model with these errors of an angle and a speed in the data of the fit, of which it fits nothing."""
    rms = SimpleNamespace(rms=dict(zip("yw", errors, strict=True)), fit_percent=dict.fromkeys("yw", 2.0))
    fit = SimpleNamespace(simulated={"estimation": rms}, theta={}, log_likelihood=0.0)
    return SimpleNamespace(adds_up=is_adrift, fit=fit)


@pytest.mark.parametrize(
    ("fitted", "is_adrift", "is_taken"),
    [
        ((0.02, 1.9), False, True),  # the angle is followed, and the noise of the speed is left
        ((0.02, 1.9), True, False),  # an angle that nothing holds: the values stand for what is missing
        ((0.2, 3.3), False, False),  # the speed has become worse
        ((0.4, 2.0), False, False),
    ],
)
def test_values_of_a_simulation_are_taken_by_the_product_of_its_errors(
    monkeypatch, fitted, is_adrift, is_taken
):
    """A noisy speed beside an angle."""
    flat = compile_text(CAR, Path("Car.mo"))
    before, after = simulated((0.6, 3.0)), simulated(fitted, is_adrift)
    null = SimpleNamespace(
        estimated=("ms",), experiments=(), hold="foh", fit=before.fit, explicit=None, alone=None
    )
    monkeypatch.setattr(stands, "falls_over", lambda *_: False)
    references = [before, after]
    monkeypatch.setattr(stands, "identify", lambda *given: after.fit)
    monkeypatch.setattr(stands, "_told_fits", lambda null, validation: (before.fit, references.pop(0)))
    found = stands._fitted(flat, lambda flat, near: null, lambda null: ())[2]
    assert found is (after if is_taken else before)


def test_values_that_foresee_worse_are_not_held(monkeypatch):
    """A pendulum with an offset that turns over: the fit of its simulation turns over elsewhere."""
    flat = compile_text(CAR, Path("Car.mo"))
    before, after = simulated((0.6, 3.0)), simulated((0.02, 1.9), False)
    for reference, unseen in ((before, 1.0), (after, 4.0)):
        reference.fit.simulated["validation"] = SimpleNamespace(rms={"y": unseen, "w": 3.0})
    null = SimpleNamespace(
        estimated=("ms",), experiments=(), hold="foh", fit=before.fit, explicit=None, alone=None
    )
    monkeypatch.setattr(stands, "falls_over", lambda *_: False)
    references = [before, after]
    monkeypatch.setattr(stands, "identify", lambda *given: after.fit)
    monkeypatch.setattr(stands, "_told_fits", lambda null, validation: (before.fit, references.pop(0)))
    assert stands._fitted(flat, lambda flat, near: null, lambda null: ())[2] is before


def fit_of(log_likelihood, length=0.4):
    """The end of a search with one parameter."""
    length = SimpleNamespace(name="l", value=length, at_bound=None)
    theta = {"l": length.value}
    return SimpleNamespace(
        log_likelihood=log_likelihood, status="converged", parameters=(length,), theta=theta
    )


@pytest.mark.parametrize(
    ("without_loads", "again", "taken"),
    [
        (150.0, 160.0, 160.0),  # the loads do what gravity does
        (150.0, 90.0, 100.0),  # the other end is less likely
        (105.0, 160.0, 100.0),  # loads that buy nothing
    ],
)
def test_a_null_less_likely_than_without_its_loads_is_searched_for_again(
    monkeypatch, without_loads, again, taken
):
    null = SimpleNamespace(fit=fit_of(100.0))
    reference = SimpleNamespace(fit=fit_of(without_loads, length=0.2))
    monkeypatch.setattr(stands, "_told_fits", lambda null, validation: ("baseline", "reference"))

    def near(values):
        assert values == {"l": 0.2}
        return SimpleNamespace(fit=fit_of(again))

    found = stands._not_astray(null, "before", reference, near, lambda null: ())
    assert found[0].fit.log_likelihood == taken
    assert found[1:] == (("baseline", "reference") if taken == again else ("before", reference))
