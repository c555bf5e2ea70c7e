"""Values that the model holds and that another value would make as likely as an effect."""

from dataclasses import replace

import numpy as np
import pytest
from hidden_plants import INERTIA, model, rotor_record

from daest.diagnosis import examine as examine_module
from daest.diagnosis.examine import _with_values
from daest.diagnosis.held_values import OtherValue, other_value
from daest.diagnosis.options import DiagnoseOptions
from daest.diagnosis.screen import run_null, value_scores
from daest.diagnosis.stand import begin, halved
from daest.model.fit import FittedParameter


def stand_with(held):
    """A rotor of known speed whose inertia is `held` (None: estimated) while its damping is estimated."""
    flat = model("SpeedRotor")
    if held is not None:
        flat = replace(
            flat,
            parameters=tuple(
                replace(p, value=held, estimate=False) if p.name == "J" else p for p in flat.parameters
            ),
        )
    record, truth = rotor_record(600, seed=5)
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
    assert found.parameter.value == pytest.approx(INERTIA, abs=4.0 * found.parameter.std_error)
    assert found.text.startswith("`J`, 0.") and found.text.endswith(
        " instead of the 0.75 kg.m2 that is given"
    )


def test_a_right_value_is_not_told():
    stand = stand_with(INERTIA)
    assert other_value(stand, run_null(stand.null)) is None


def test_no_value_is_looked_for_where_all_are_estimated():
    stand = stand_with(None)
    assert other_value(stand, run_null(stand.null)) is None


class Law:
    def __init__(self, delta_bic):
        self.delta_bic = delta_bic


def test_values_that_do_the_same_are_told_together(monkeypatch):
    stand = stand_with(1.5 * INERTIA)
    run = run_null(stand.null)
    twice = value_scores(stand.null, run, ["J", "J"])
    assert [one.alike for one in twice] == [("J",), ("J",)]
    monkeypatch.setattr(
        "daest.diagnosis.held_values.value_scores", lambda *_: [replace(twice[0], alike=("m", "rotor.J"))]
    )
    assert other_value(stand, run).text.endswith(" (or of `m` or `rotor.J`, which the sensors see alike)")


@pytest.mark.parametrize(
    ("delta_bic", "ratio", "law_ratio", "is_rival"),
    [
        (100.0, 0.2, 0.2, True),
        (95.0, 0.2, 0.2, True),  # as likely, by what two laws are one answer
        (90.0, 0.2, 0.2, False),
        (90.0, 0.15, 0.2, True),  # less likely, and better in simulation
        (100.0, 0.3, 0.2, False),  # likelier, and worse in simulation
        (5.0, 0.1, 0.2, False),  # hardly pays for its parameter
    ],
)
def test_a_value_is_an_answer_beside_a_law_as_another_law_would_be(delta_bic, ratio, law_ratio, is_rival):
    parameter = FittedParameter("R", 84.0, 0.2, 35.0, "Ohm", 0.0, None, False)
    other = OtherValue(parameter, 35.0, delta_bic, (ratio,))
    assert other.says_as_much_as(Law(100.0), (law_ratio,)) == is_rival


def test_the_sentence_names_both_values(monkeypatch):
    parameter = FittedParameter("R", 84.0, 0.2, 35.0, "Ohm", 0.0, None, False)
    other = OtherValue(parameter, 35.0, 100.0, (0.2,))
    monkeypatch.setattr(examine_module, "other_value", lambda *_: other)
    decided = examine_module.verdicts.Decided("external disturbance", "A load.", "", ())
    stand = stand_with(INERTIA)
    same, said = _with_values(stand, None, decided, DiagnoseOptions(), lambda _: None)
    assert same is decided
    assert said == (
        " Another value of `R`, 84 ± 0.2 Ohm instead of the 35 Ohm that is given, comes near: estimate it "
        "(--estimate R)."
    )
    none, said = _with_values(
        stand, None, replace(decided, name="nothing missing"), DiagnoseOptions(), lambda _: None
    )
    assert none.name == "nothing missing" and said == ""
