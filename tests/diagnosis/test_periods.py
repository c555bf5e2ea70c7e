"""The number of periods of an effect in a turn, from the innovations along the motion."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hidden_plants import model, some_effects

import daest
from daest.diagnosis.evidence import reasons
from daest.diagnosis.screening.candidates import most_likely_length, most_likely_periods, pairs, with_shapes
from daest.modelica.places.sites import sites
from daest.systems.reduction.reduce import reduce_index


@pytest.mark.parametrize("n", [2, 7, 20, 36])
def test_periods_are_found_under_noise(n: int) -> None:
    angle = np.cumsum(0.03 + 0.02 * np.sin(np.arange(2000) / 90.0))
    noise = np.random.default_rng(n).standard_normal((2000, 2))
    noise[:, 1] += 0.5 * np.sin(n * angle + 0.4)
    assert most_likely_periods(angle, noise) == n


@pytest.mark.parametrize("n", [9, 60, 180, 400])
def test_periods_are_found_within_a_part_of_a_turn(n: int) -> None:
    angle = 12.0 / n * np.sin(np.arange(2000) / 150.0) + 4.0 / n * np.sin(np.arange(2000) / 61.0)
    noise = np.random.default_rng(n).standard_normal((2000, 2))
    noise[:, 1] += 0.5 * np.sin(n * angle + 0.4)
    found = most_likely_periods(angle, noise)
    # Within a quarter of a period over the whole way, from where a fit comes to it.
    assert found is not None and abs(found - n) * np.ptp(angle) < 0.26 * 2.0 * np.pi


@pytest.mark.parametrize(("part", "is_fitted"), [(0.3, True), (4.0, False)])
def test_the_number_of_periods_is_fitted_where_no_whole_turn_tells_it(part: float, is_fitted: bool) -> None:
    flat, n = model("BareRotor"), 30
    time = np.arange(2000) / 100.0
    angle = part * np.sin(time) + 0.3 * part * np.sin(2.7 * time)
    states = {
        name: angle if name.endswith("phi") else np.zeros(2000) for name in reduce_index(flat).state_names
    }
    noise = np.random.default_rng(n).standard_normal((2000, 1))
    noise[:, 0] += np.sin(n * angle + 0.4)
    shaped, _ = with_shapes(
        flat,
        pairs(some_effects("CoggingTorque"), sites(flat)),
        time,
        states,
        np.zeros((2000, len(flat.inputs))),
        noise,
    )
    found = {c.shape["n"]: f"{c.name}.n" in c.estimated for c in shaped if c.shape["n"] > 12}
    assert set(found.values()) == {is_fitted}
    assert all(abs(number - n) * np.ptp(angle) < 0.26 * 2.0 * np.pi for number in found)


def test_one_period_in_a_turn_is_a_weight_and_none_of_them() -> None:
    angle = np.linspace(0.0, 40.0, 2000)
    torque = np.sin(angle + 0.4)[:, None] + 0.1 * np.sin(5 * angle)[:, None]
    assert most_likely_periods(angle, torque) == 5


def test_motion_that_resolves_no_period_tells_none() -> None:
    white = np.random.default_rng(0).standard_normal((500, 1))
    assert most_likely_periods(np.zeros(500), white) is None
    assert most_likely_periods(np.linspace(0.0, 2000.0, 500), white) is None


@pytest.mark.parametrize("length", [0.004, 0.011, 0.03])
def test_length_of_a_period_along_a_way_is_found_under_noise(length: float) -> None:
    way = 0.05 * np.sin(np.arange(3000) / 120.0) + 0.02 * np.sin(np.arange(3000) / 47.0)
    noise = np.random.default_rng(int(1e4 * length)).standard_normal((3000, 2))
    noise[:, 1] += 0.5 * np.sin(2.0 * np.pi * way / length + 0.4)
    found = most_likely_length(way, noise)
    assert found is not None
    # Within a quarter of a period over the whole way, from where a search comes to it.
    assert abs(np.ptp(way) / found - np.ptp(way) / length) < 0.26


def test_way_that_resolves_no_period_tells_no_length() -> None:
    white = np.random.default_rng(0).standard_normal((500, 1))
    assert most_likely_length(np.zeros(500), white) is None
    assert most_likely_length(np.tile([0.0, 1.0], 250), white) is None


def test_cogging_says_over_which_variable_it_repeats() -> None:
    effect = daest.find_effect("Daest.Effects.Rotational.CoggingTorque")
    assert {p.name: p.periods_over for p in effect.parameters if p.periods_over} == {"n": "phi"}
    effect = daest.find_effect("Daest.Effects.Translational.CoggingForce")
    assert {p.name: p.periods_over for p in effect.parameters if p.periods_over} == {"p": "s"}


@pytest.mark.parametrize(
    "way, is_shown", [((-0.02, 0.02), True), ((0.0, 0.04), True), ((0.0, 0.025), False), ((0.1, 0.12), False)]
)
def test_a_period_is_told_from_recordings_that_show_all_of_it(
    monkeypatch: pytest.MonkeyPatch, way: tuple[float, float], is_shown: bool
) -> None:
    """A period of 30 mm. Where the way begins is of no matter to a law with a phase, nor how far from there
    it leads: what lies 0.1 m away and moves by 20 mm shows two thirds of the period."""
    values = np.linspace(*way, 50)
    effect = daest.find_effect("Daest.Effects.Translational.CoggingForce")
    candidate = SimpleNamespace(name="cogging", effect=effect)
    fit = SimpleNamespace(theta={"cogging.p": 0.03})
    monkeypatch.setattr(reasons, "grown", lambda *_: None)
    monkeypatch.setattr(reasons, "largest_values", lambda _: {"cogging.s": float(np.max(np.abs(values)))})
    monkeypatch.setattr(reasons, "values_along", lambda *_: values[None])
    model: Any = SimpleNamespace(flat=None, explicit=None, experiments=())
    found = reasons.without_form(model, cast(Any, candidate), cast(Any, fit))
    assert ("too little of its form" in found) != is_shown
