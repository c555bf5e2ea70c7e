"""A gain or an offset that the screen leaves out, where a law that bends nothing says most."""

from types import SimpleNamespace

import pytest

from daest.diagnosis.reasons import NO_BEND
from daest.diagnosis.rivals import STRAIGHT, straight_laws

GAIN, OFFSET = STRAIGHT
SATURATION = "Daest.Effects.Signals.Saturation"


def candidate(law: str, site: str) -> SimpleNamespace:
    return SimpleNamespace(effect=SimpleNamespace(class_name=law, null_values={"size": 0.0}), site=site)


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
