"""What changed: a small constant torque beside what the recording before it tells of unknown loads."""

import pytest
from hidden_plants import model, rotor_record, some_effects

from daest.diagnosis.changed import diagnose_change
from daest.diagnosis.evidence.stand import without_noises
from daest.diagnosis.null_model.loads import load_sites
from daest.diagnosis.null_model.null import slowest_load
from daest.diagnosis.options import DiagnoseOptions

SIZE = 0.02
OPTIONS = DiagnoseOptions(hold="zoh", jobs=1)


def diagnosed(before, after, **words):
    return diagnose_change(
        model(), some_effects("ConstantLoad", "CoulombFriction"), before, after, OPTIONS, **words
    )


@pytest.mark.slow
def test_a_small_torque_is_named_beside_the_loads_that_were_there_before():
    after, _ = rotor_record(600, seed=12, torque=lambda w, phi: -SIZE)
    assert diagnosed(None, after).verdict == "external disturbance"
    found = diagnosed(rotor_record(400, seed=11)[0], after)
    (proof,) = (p for p in found.proofs if p.verdict == "supported")
    assert proof.candidate.effect.name == "ConstantLoad" and "Before the change" in found.message
    (size,) = (p for p in proof.told.parameters if p.name.endswith("tau_0"))
    assert abs(size.value - SIZE) < 3.0 * size.std_error < SIZE


@pytest.mark.slow
def test_a_load_from_outside_gets_no_name():
    after, _ = rotor_record(600, seed=12, load=(0.05, 1.0))
    found = diagnosed(rotor_record(400, seed=11)[0], after)
    assert found.verdict == "external disturbance"
    assert all(proof.verdict == "rejected" for proof in found.proofs)


@pytest.mark.slow  # tests/cli/test_watch.py
def test_an_alarm_without_an_effect_cannot_be_told():
    found = diagnosed(None, rotor_record(400, seed=13)[0])
    assert found.verdict == "cannot tell" and "the alarm was a false one" in found.message


@pytest.mark.parametrize(
    ("load", "is_slow"), [pytest.param((0.0, 1.0), False, marks=pytest.mark.slow), ((0.15, 1.0), True)]
)
def test_how_slow_loads_are(load, is_slow):
    record, _ = rotor_record(400, seed=4, load=load)
    limit = slowest_load(without_noises(model()), load_sites(model()), [record], "zoh")
    assert limit == pytest.approx((50.0 if is_slow else 5.0) * record.period)
