"""A gain or an offset that the screen leaves out, where a law that bends nothing says most."""

from types import SimpleNamespace

import pytest

from daest.diagnosis.answers.told_laws import _of_both
from daest.diagnosis.evidence.reasons import NO_BEND, STRAIGHT
from daest.diagnosis.refits.rivals import straight_laws

GAIN, OFFSET = STRAIGHT
SATURATION = "Daest.Effects.Signals.Saturation"


def candidate(law: str, site: str) -> SimpleNamespace:
    effect = SimpleNamespace(class_name=law, null_values={"size": 0.0})
    return SimpleNamespace(effect=effect, site=site, label=f"{law.rpartition('.')[2]} at {site}")


def proof(law: str, site: str, gain: float, reason: str) -> SimpleNamespace:
    return SimpleNamespace(
        candidate=candidate(law, site),
        verdict="rejected" if reason else "supported",
        reason=reason,
        delta_log_likelihood=gain,
        delta_bic=2.0 * gain,
        fit=SimpleNamespace(log_likelihood=gain),
        in_use=SimpleNamespace(gain=0.0),
    )


@pytest.mark.parametrize(
    ("reason", "asked"),
    [
        (f"{NO_BEND}: it is a gain of 0.941 and an offset of 0.007", [(GAIN, "q"), (OFFSET, "q")]),
        ("unseen data are foreseen no better", []),
        ("", []),
    ],
)
def test_what_the_likeliest_law_is_without_a_bend_is_asked_for(reason, asked):
    """A pump that delivers 6 % less had been an external disturbance: of a gain of it, parameters do 99 %."""
    candidates = [candidate(law, site) for law in (GAIN, OFFSET, SATURATION) for site in ("q", "level")]
    proofs = [proof(SATURATION, "q", 40.0, reason), proof(SATURATION, "level", 10.0, "too little")]
    found = straight_laws(candidates, proofs)
    assert [(one.candidate.effect.class_name, one.candidate.site) for one in found] == asked
    assert all(one.sizes == (0.0,) for one in found)


@pytest.mark.parametrize(
    ("site", "gain", "is_told"), [("T5", 60.0, True), ("T5", 31.0, False), ("T4", 60.0, False)]
)
def test_gain_is_told_with_the_offset_that_a_law_without_its_bend_has(site, gain, is_told):
    """A thermometer off in both: the gain of it is accepted, and a saturation that takes both says more."""
    straight = f"{NO_BEND}: it is a gain of 0.911 and an offset of 1.34"
    accepted = proof(GAIN, "T5", 30.0, "")
    proofs = [accepted, proof(SATURATION, site, gain, straight), proof(OFFSET, "T5", 90.0, "unseen data are")]
    said = _of_both(SimpleNamespace(proofs=proofs), accepted)
    assert bool(said) is is_told
    assert not said or said.startswith(
        " Gain and offset are off together: Saturation at T5 says more (BIC 60)"
    )
    assert not said or said.endswith(f"but {straight}.")
