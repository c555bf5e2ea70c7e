"""Candidates that can be attached beside each other, in the order in which they can."""

from types import SimpleNamespace

from daest.diagnosis.screening import candidates
from daest.errors import ModelError


def test_candidates_that_are_solved_in_the_order_in_which_they_were_tried_are_kept(monkeypatch):
    """An orifice may be solved behind another effect and not before it; what cannot be built is left out."""
    store, plain, broken = (
        SimpleNamespace(name=name, label=name, effect=SimpleNamespace(is_of_store=name == "store"))
        for name in ("store", "plain", "broken")
    )

    def built(_, given):
        names = [c.name for c in given]
        if "broken" in names or names == ["store", "plain"]:
            raise ModelError("singular-after-reduction", "depend on each other")
        return names

    monkeypatch.setattr(candidates, "with_possible_values", lambda given: (tuple(given), ()))
    monkeypatch.setattr(candidates, "explicit_at_null", built)
    kept, refused, whole = candidates.attachable(None, [store, plain, broken])
    assert [c.name for c in kept] == ["plain", "store"] == whole
    assert refused == (("broken", "depend on each other"),)
