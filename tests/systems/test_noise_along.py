"""Noise verdicts along a trajectory: a place that is admissible at the start and not later, the pendulum in
Cartesian coordinates all around, and models that need no trajectory."""

from pathlib import Path

import numpy as np
import pytest
from flat_models import Draft, report_servo

from daest.errors import NumericalError
from daest.modelica.compile import compile_model, compile_text
from daest.systems.linear.linearize import linearize
from daest.systems.linear.noise import noise_report
from daest.systems.simulation.noise_along import noise_along

PENDULUM = Path(__file__).parents[1] / "estimation" / "models" / "Pendulum.mo"


def opening():
    """p = x^2 v + x and q = der(p): while x = 0, a noise in v reaches nothing; later it is differentiated."""
    m = Draft(
        "Opening",
        unknowns=["x", "z", "v", "p", "q"],
        inputs=["u"],
        starts={"x": 0.0, "z": 1.0},
        noises={"w": 1.0},
    )
    for text in ("der(x) = u - x", "der(z) = -z", "v = z + w", "p = x**2*v + x", "q = der(p)"):
        m.equation(text)
    return m.flat()


def test_admissible_at_the_start_and_forbidden_later():
    flat = opening()
    assert noise_report(linearize(flat)).places[2].admissible  # at the start values alone
    time = np.linspace(0.0, 5.0, 101)
    u = np.where(time < 1.0, 0.0, 1.0)[:, None]  # x leaves zero after 1 s
    found = noise_along(flat, (time, u), at=[2, "z"], hold="zoh", points=21)
    place = found.places[2]
    assert found.annotated[0].forbidden_share == place.forbidden_share  # w is on this equation
    assert place.at_start and place.is_mixed and not found.all_admissible
    assert place.first_time == pytest.approx(1.25)
    assert place.forbidden_share == pytest.approx(16 / 21)
    assert "q" in place.verdict.differentiated
    assert found.asked[0] == place
    assert found.places[1].admissible and not found.same_everywhere
    assert len(found.times) == 21 and found.unjudged == ()
    assert 2 in found.generic.forbidden and found.generic_points == 16


def test_pendulum_all_around():
    flat = compile_model(PENDULUM)
    time = 0.02 * np.arange(150)
    u = np.where(time < 0.5, -8.0, 0.0)[:, None]
    found = noise_along(flat, (time, u), hold="zoh")
    assert found.all_admissible and found.annotated[0].name == "w"
    assert found.structures == ((2, 3),)
    assert (found.generic.n_dynamic, found.generic.index) == (2, 3)
    assert found.generic_points == len(found.times)
    assert set(found.generic.forbidden) == {i for i, p in enumerate(found.places) if not p.admissible}
    texts = [e.text for e in flat.equations]
    constraint = next(i for i, text in enumerate(texts) if "L" in text and "der" not in text)
    assert found.places[constraint].forbidden_share == 1.0


def test_an_affine_model_is_the_same_everywhere():
    flat = report_servo()
    time = np.linspace(0, 1, 11)
    found = noise_along(flat, (time, np.zeros((11, 1))))
    report = noise_report(linearize(flat))
    assert found.same_everywhere and found.times == (0.0,)
    assert [p.admissible for p in found.places] == [p.admissible for p in report.places]


def test_points_where_the_model_is_singular_are_named(monkeypatch):
    flat, seen = opening(), []

    def singular_early(*args, **options):
        seen.append(options)
        if len(seen) < 3:
            raise NumericalError("pencil-singular", "the pencil is singular")
        return linearize(*args, **options)

    monkeypatch.setattr("daest.systems.simulation.noise_along.linearize", singular_early)
    time = np.linspace(0.0, 5.0, 101)
    found = noise_along(flat, (time, np.ones((101, 1))), hold="zoh", points=5)
    assert [t for t, _ in found.unjudged] == [0.0, 1.25] and "singular" in found.unjudged[0][1]
    assert not found.all_admissible and len(found.times) == 3
    seen.clear()
    with pytest.raises(NumericalError) as caught:
        noise_along(flat, (time[:2], np.ones((2, 1))), hold="zoh", points=2)
    assert caught.value.code == "noise-nowhere-regular"


SWITCHED = """model Switched "Noise that a rate sees while a switch is on"
  Real x(start = 0, fixed = true);
  Real z(start = 1, fixed = true);
  Real v;
  Real p;
  Real q;
  Boolean on(start = false, fixed = true);
  input Real u;
  input Real w annotation(__Daest(noise = true, intensity = 0.01));
  output Real y = x;
equation
  der(x) = u - x;
  der(z) = -z;
  v = z + w;
  p = (if on then 1 else 0)*v + x;
  q = der(p);
  when u > 0.5 then
    on = true;
  elsewhen u < 0.5 then
    on = false;
  end when;
end Switched;
"""


def test_every_mode_that_occurs_is_judged():
    flat = compile_text(SWITCHED.encode(), Path("Switched.mo"))
    assert {p.name for p in linearize(flat).parameters} == set()  # what a switch holds is a number
    time = np.arange(41) * 0.05
    u = np.where((time > 0.82) & (time < 1.12), 1.0, 0.0)[:, None]  # 6 of 41 samples
    found = noise_along(flat, (time, u), hold="zoh", points=5)
    off, on = found.modes
    assert (off.mode, on.mode) == ("on = 0", "on = 1")
    assert on.share == pytest.approx(6 / 41) and off.share == pytest.approx(35 / 41)
    assert 0.85 <= on.first_time < 0.91  # a sample at an event shows what was before it
    assert off.forbidden == () and on.forbidden == ("w",)  # q = p' contains w' while the switch is on
    assert on.n_forbidden > off.n_forbidden
    assert not found.all_admissible and found.annotated[0].at_start
