"""Names that are offered in place of one that does not exist."""

import pytest

from daest.near import near_names, nearest


@pytest.mark.parametrize(
    ("name", "known", "near"),
    [
        ("omga", ["phi", "omega", "Omega2"], ["omega", "Omega2"]),
        ("J", ["J1", "J2", "R"], ["J1", "J2"]),
        ("spring.k", ["spring.c", "disc.J", "spring.kk"], ["spring.kk", "spring.c"]),
        ("c", ["spring.c", "damper.d"], ["spring.c"]),
        ("zzz", ["phi"], []),
        # Half of the letters in common is chance, not a slip of the pen.
        ("voltage", ["valve", "load", "gate"], []),
        ("temp", ["time", "mode"], []),
        ("Spring.C", ["spring.c"], ["spring.c"]),
        ("x", [], []),
    ],
)
def test_near_names_only(name, known, near):
    assert near_names(name, known) == near


def test_nearest_is_a_question_or_nothing():
    assert nearest("omga", ["phi", "omega", "Omega2"]) == "did you mean omega, Omega2?"
    assert nearest("zzz", ["phi"]) == ""
