"""Values that the model holds and that another value would make as likely as an effect."""

from dataclasses import dataclass, replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from hidden_plants import INERTIA, NOISE, model, rotor_record, some_effects

from daest.diagnosis import examine as examine_module
from daest.diagnosis.answers import held_values as held_values_module
from daest.diagnosis.answers.decided import Decided
from daest.diagnosis.answers.held_values import OtherValue, other_value, value_besides
from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.evidence.stand import begin, halved
from daest.diagnosis.examine import _with_values
from daest.diagnosis.null_model.null_observer import run_null
from daest.diagnosis.options import DiagnoseOptions
from daest.diagnosis.screening import scores
from daest.diagnosis.screening.scores import value_scores
from daest.model.fit import FittedParameter
from daest.numerics.deadline import OutOfTimeError


@cache
def stand_with(held, intensity=NOISE):
    """A rotor of known speed whose inertia is `held` (None: estimated) while its damping is estimated, and on
    which a white torque acts."""
    flat = model("SpeedRotor")
    if held is not None:
        flat = replace(
            flat,
            parameters=tuple(
                replace(p, value=held, estimate=False) if p.name == "J" else p for p in flat.parameters
            ),
        )
    record, truth = rotor_record(600, seed=5, noise=intensity)
    noise = 0.02 * np.random.default_rng(5).standard_normal(600)
    speed = replace(record, outputs=(truth["w"] + noise)[:, None], output_names=("w",))
    return begin(flat, *halved((speed,), ()), DiagnoseOptions(hold="zoh"))


def test_an_inertia_that_was_looked_up_wrong_is_estimated():
    stand = stand_with(1.5 * INERTIA)
    run = run_null(stand.null)
    (first,) = value_scores(stand.null, run, ["J"])
    assert first.name == "J" and not first.alike and first.score > 5.0 and first.p_value < 1e-6
    found = other_value(stand, run)
    assert found is not None and found.held == 1.5 * INERTIA and found.delta_bic > 10.0
    assert not found.is_all  # a white torque acts
    assert found.parameter.value == pytest.approx(INERTIA, abs=4.0 * found.parameter.std_error)
    assert found.text.startswith("`J`, 0.") and found.text.endswith(
        " instead of the 0.75 kg.m2 that is given"
    )


@pytest.mark.slow
def test_with_another_value_nothing_is_left_where_the_model_then_simulates_to_the_noise():
    """An activation temperature of a reactor that was 17 % off had been "something dynamic, and fast"."""
    stand = stand_with(1.5 * INERTIA, 0.0)
    assert other_value(stand, run_null(stand.null)).is_all


@pytest.mark.parametrize(("share", "is_seen"), [(0.018, True), (0.0005, False)])
def test_a_value_that_others_nearly_do_is_still_asked_for(monkeypatch, share, is_seen):
    """Of the volume of a hydraulic motor the volume and leakage before it and the damping behind do all but
    1.8 %, which is 14 standard errors on unseen data."""
    stand = stand_with(1.5 * INERTIA)
    run = run_null(stand.null)
    projected = scores.projected

    def nearly_done(responses, directions):
        return projected(responses, directions)[0], np.full(len(responses), share)

    monkeypatch.setattr(scores, "projected", nearly_done)
    assert (value_scores(stand.null, run, ["J"])[0].score > 5.0) == is_seen


def test_a_value_is_asked_for_where_errors_of_a_simulation_add_up():
    """A wrong capacitor of a cell, whose charge adds up errors of its current, had been a gain of that."""
    stand = stand_with(1.5 * INERTIA)
    adding = replace(stand, reference=replace(stand.reference, adds_up=True))
    assert other_value(adding, run_null(stand.null)).parameter.name == "J"


def test_a_right_value_is_not_told():
    stand = stand_with(INERTIA)
    assert other_value(stand, run_null(stand.null)) is None


@pytest.mark.slow  # none where it is right: the test above
def test_no_value_is_looked_for_where_all_are_estimated():
    stand = stand_with(None)
    assert other_value(stand, run_null(stand.null)) is None


def in_toml(name):
    """On the command line a name would be estimated alone, and all others held."""
    return f"(`{name} = {{ estimate = true }}` under [parameters] of daest.toml)"


@dataclass(frozen=True)
class Law:
    delta_bic: float
    verdict: str = "supported"
    reason: str = ""
    is_by_use: bool = False
    candidate = SimpleNamespace(label="FlexibleAppendage at w", n_unknowns=5)
    fit = SimpleNamespace(log_likelihood=40.0)
    told: object = None
    not_separable_from: tuple[str, ...] = ()
    given_values: tuple[str, ...] = ()


def test_values_that_do_the_same_are_told_together(monkeypatch):
    stand = stand_with(1.5 * INERTIA)
    run = run_null(stand.null)
    twice = value_scores(stand.null, run, ["J", "J"])
    assert [one.alike for one in twice] == [("J",), ("J",)]
    monkeypatch.setattr(
        "daest.diagnosis.answers.held_values.value_scores",
        lambda *_: [replace(twice[0], alike=("m", "rotor.J"))],
    )
    assert other_value(stand, run).text.endswith(" (or of `m` or `rotor.J`, which the sensors see alike)")


def test_of_values_that_do_the_same_the_likeliest_search_counts(monkeypatch):
    """Two capacitors and a resistance of a ladder: the search with the one that shows most had ended 48 of
    log-likelihood below that with the other."""
    stand = stand_with(1.5 * INERTIA)
    others = [p.name for p in stand.null.flat.parameters if p.name != "J"][:1]
    ends = {"J": 10.0, others[0]: 58.0}
    monkeypatch.setattr(
        held_values_module,
        "refit",
        lambda _flat, _explicit, names, *_, **__: SimpleNamespace(log_likelihood=ends[names[-1]]),
    )
    name, fit = held_values_module._likeliest(stand, ("J", *others, "unknown"))
    assert name == others[0] and fit.log_likelihood == 58.0


def test_a_value_that_shows_nearly_as_much_is_estimated_too(monkeypatch):
    """The stiffness of a tyre, 20 % off, showed 0.8 % less than its friction, of which the search ended less
    likely, while the torque came late: a share of the torque in the speed of the wheel had been told."""
    stand = stand_with(1.5 * INERTIA)
    run = run_null(stand.null)
    (own,) = value_scores(stand.null, run, ["J"])
    asked: list[tuple[str, ...]] = []
    likeliest = held_values_module._likeliest
    monkeypatch.setattr(
        held_values_module, "_likeliest", lambda stand, names: asked.append(names) or likeliest(stand, ("J",))
    )
    for share in (0.95, 0.85):
        nearly = [replace(own, name="a", score=own.score / share), own]
        monkeypatch.setattr(held_values_module, "value_scores", lambda *_, found=nearly: found)
        assert other_value(stand, run).parameter.name == "J"
    assert asked == [("a", "J"), ("a",)]


@pytest.mark.parametrize(
    ("delta_bic", "ratio", "law_ratio", "is_rival"),
    [
        (100.0, 0.2, 0.2, True),
        (95.0, 0.2, 0.2, True),  # as likely, by what two laws are one answer
        (90.0, 0.2, 0.2, False),
        (90.0, 0.15, 0.2, True),  # less likely, and better in simulation
        (100.0, 0.3, 0.2, False),  # likelier, and worse in simulation
        (111.0, 0.3, 0.2, True),  # far likelier, and better than the model as it is
        (111.0, 0.95, 0.2, False),
        (111.0, 0.95, 0.8, True),  # what else is missing spoils the simulation of both
        (111.0, 1.05, 0.8, False),
        (109.0, 0.95, 0.8, False),
        (145.0, 1.0, 0.2, True),  # 10 + 5 ln 300 more: it is off beside the law, too
        (145.0, 1.05, 0.2, False),
        (138.0, 1.0, 0.2, False),
        (5.0, 0.1, 0.2, False),  # hardly pays for its parameter
    ],
)
def test_a_value_is_an_answer_beside_a_law_as_another_law_would_be(delta_bic, ratio, law_ratio, is_rival):
    parameter = FittedParameter("R", 84.0, 0.2, 35.0, "Ohm", 0.0, None, False)
    other = OtherValue(parameter, 35.0, delta_bic, (ratio,))
    null = stand_with(INERTIA).null
    assert other.says_as_much_as(Law(100.0), None, null, (law_ratio,)) == is_rival


@pytest.mark.parametrize(
    ("delta_bic", "ratios", "law", "is_aside"),
    [
        (107.0, (0.2, 0.2), Law(100.0), True),
        (105.0, (0.2, 0.2), Law(100.0), False),  # as likely, by what two laws are one answer
        (150.0, (0.2, 0.21), Law(100.0), False),  # one output is simulated worse
        (150.0, (), Law(100.0), False),
        (62.0, (0.2, 0.2), Law(900.0, is_by_use=True), True),  # 2*(40 - 10) - 5 ln 600 beside loads
        (20.0, (0.2, 0.2), Law(900.0, is_by_use=True), False),
    ],
)
def test_a_law_that_only_stands_for_a_value_is_put_aside(delta_bic, ratios, law, is_aside):
    """A cabin of another mass had been a flexible part on the sheave."""
    stand = stand_with(INERTIA)
    baseline = replace(stand.baseline, log_likelihood=10.0)
    parameter = FittedParameter("m1", 721.0, 1.0, 600.0, "kg", 0.0, None, False)
    other = OtherValue(parameter, 600.0, delta_bic, ratios)
    assert other.puts_aside(law, baseline, stand.null, (0.2, 0.2)) == is_aside


def test_the_verdict_is_then_that_parameters_are_off():
    parameter = FittedParameter("m1", 721.0, 1.0, 600.0, "kg", 0.0, None, False)
    other = OtherValue(parameter, 600.0, 200.0, (0.2,))
    law, refused = Law(100.0), Law(50.0, "rejected", "it says little")
    decided = Decided("supported", "A law.", "", (law, refused))
    found = examine_module._by_value(decided, law, other)
    assert found.name == "parameters off"
    assert "Another one of `m1`, 721 ± 1 kg instead of the 600 kg that is given, explains" in found.message
    assert found.message.endswith(f"than FlexibleAppendage at w: estimate it, too {in_toml('m1')}.")
    assert [p.verdict for p in found.proofs] == ["rejected", "rejected"]
    assert "another value of `m1`" in found.proofs[0].reason and found.proofs[1] is refused


def test_no_law_is_claimed_before_given_values_are_asked_for_though_the_time_is_up():
    """A round of `improve` that ended with its time had added a law that stood for a value 20 % off."""
    parameter = FittedParameter("B", 12.0, 0.05, 10.0, "1", 0.0, None, False)
    other = OtherValue(parameter, 10.0, 200.0, (0.2,))
    stand, late = stand_with(INERTIA), DiagnoseOptions(until=0.0)
    decided = Decided("supported", "A law.", "", (Law(-1e3, told=stand.told),))
    found, _ = _with_values(stand, lambda: other, None, decided, late, lambda _: None)
    assert found.name == "parameters off"

    def too_long():
        raise OutOfTimeError

    same, said = _with_values(stand, too_long, None, decided, late, lambda _: None)
    assert same is decided and said.startswith(" The time was up before it was known whether another")
    none = Decided("external disturbance", "A load.", "", ())
    same, said = _with_values(stand, lambda: pytest.fail("asked"), None, none, late, lambda _: None)
    assert same is none and not said


def test_a_value_is_an_answer_where_it_says_as_much_as_any_law_that_is_not_told_apart(monkeypatch):
    """The yield of a fermenter, 10 % off beside an inflow, had not been named beside a gain of its sensor,
    which simulates as well, for a richer law that simulates a little better."""
    parameter = FittedParameter("Y", 0.506, 0.001, 0.53, "1", 0.0, None, False)
    other = OtherValue(parameter, 0.53, 98.0, (0.5,))
    ratios = {"richer": [0.2], "alike": [0.5]}
    monkeypatch.setattr(examine_module, "error_ratios", lambda _, simulated: ratios[simulated])
    laws = tuple(Law(100.0, "not separable", told=SimpleNamespace(simulated=name)) for name in ratios)
    decided = Decided("cannot tell", "One of two laws is missing.", "", laws)

    def asked():
        options = DiagnoseOptions()
        return _with_values(stand_with(INERTIA), lambda: other, None, decided, options, lambda _: None)[0]

    found = asked()
    assert found.message.startswith("One of two laws is missing. Another value of `Y`, 0.506")
    assert [p.given_values for p in found.proofs] == [("Y",), ("Y",)]
    ratios["alike"] = [0.3]
    assert asked() is decided


@pytest.mark.parametrize(
    ("share", "is_told"), [pytest.param(1.2, True, marks=pytest.mark.slow), (1.0, False)]
)
def test_a_value_that_is_off_is_told_beside_the_law_whose_size_it_spoils(share, is_told):
    """The stiffness of leaves beside a mass given 12 % off was 12 standard errors off, without a word."""
    flat = model("SpeedRotor")
    held = [
        replace(p, value=share * INERTIA, estimate=False) if p.name == "J" else p for p in flat.parameters
    ]
    record, truth = rotor_record(1200, seed=3, coulomb=lambda phi: 0.2, noise=0.0)
    noise = 0.01 * np.random.default_rng(3).standard_normal(1200)
    speed = replace(record, outputs=(truth["w"] + noise)[:, None], output_names=("w",))
    options, effects = DiagnoseOptions(hold="zoh"), some_effects("CoulombFriction")
    found = diagnose(replace(flat, parameters=tuple(held)), effects, (speed,), (), options)
    assert found.verdict == "supported"
    assert ("Another value of `J` than the 0.6 kg.m2 that is given would take" in found.message) == is_told


def test_the_sentence_names_both_values():
    parameter = FittedParameter("R", 84.0, 0.2, 35.0, "Ohm", 0.0, None, False)
    other = OtherValue(parameter, 35.0, 100.0, (0.2,))
    decided = Decided("external disturbance", "A load.", "", ())
    stand = stand_with(INERTIA)
    same, said = _with_values(stand, lambda: other, None, decided, DiagnoseOptions(), lambda _: None)
    assert same is decided
    assert said == (
        " Another value of `R`, 84 ± 0.2 Ohm instead of the 35 Ohm that is given, comes near: estimate it, "
        f"too {in_toml('R')}."
    )
    none, said = _with_values(
        stand,
        lambda: other,
        None,
        replace(decided, name="nothing missing"),
        DiagnoseOptions(),
        lambda _: None,
    )
    assert none.name == "nothing missing" and said == ""
    # Where nothing is left with it, it is the answer, also beside errors of a simulation that add up.
    whole = replace(other, is_all=True)
    found, said = _with_values(stand, lambda: whole, None, decided, DiagnoseOptions(), lambda _: None)
    assert found.name == "parameters off" and said == ""
    assert found.message.endswith(f"no effect is missing: estimate it, too {in_toml('R')}.")
    # Where errors of a simulation add up, that another value simulates better says little.
    adding = replace(stand, reference=replace(stand.reference, adds_up=True))
    assert _with_values(adding, lambda: other, None, decided, DiagnoseOptions(), lambda _: None) == (
        decided,
        "",
    )


@pytest.mark.parametrize("p_value, is_told", [(1e-9, True), (0.2, False)])
def test_no_value_takes_most_of_what_is_left_where_that_follows_nothing(monkeypatch, p_value, is_told):
    """Beside the friction of a servo that leaves the noise, its gear had seemed to be off."""
    stand = stand_with(INERTIA)
    strong = scores.ScoredValue("J", 9.0, 1e-15)
    monkeypatch.setattr(held_values_module, "with_law", lambda null, _law: null)
    monkeypatch.setattr(held_values_module, "value_scores", lambda *_: [strong])
    law = SimpleNamespace(left=SimpleNamespace(p_value=p_value, log_likelihood_gain=12.0))
    assert ("`J`" in value_besides(stand, law)) == is_told
