"""Rivals of a law: richer and simpler ones for the same."""

from dataclasses import replace
from functools import cache

from hidden_plants import model, rubbing, some_effects

from daest.diagnosis.candidates import pairs
from daest.diagnosis.disturbance import place_gains, smoothed_load
from daest.diagnosis.proof import could_compete, prepare, prove, trials
from daest.diagnosis.rivals import richer_laws, simpler_laws
from daest.diagnosis.screen import run_null, screen
from daest.modelica.sites import sites

LAWS = some_effects("CoulombFriction", "StribeckFriction", "QuadraticDrag", "Unbalance")


@cache
def proved(name):
    stand = rubbing()
    run = run_null(stand.null)
    found = screen(stand.null, run, pairs(LAWS, sites(model())))
    trial = next(t for t in trials(found, 1.0, 9) if t.candidate.effect.name == name)
    load = smoothed_load(stand.null, run, place_gains(stand.null, run))
    proof = prove(
        stand.null,
        stand.baseline,
        prepare(stand.null.flat, stand.null.estimated, trial),
        stand.null.experiments,
        stand.validation,
        run,
        load,
    )
    return found, run, proof


def test_simple_law_is_tried_where_a_rich_one_was_first():
    found, _, proof = proved("StribeckFriction")
    simple = simpler_laws(proof, found, [proof])
    assert [t.candidate.effect.name for t in simple] == ["CoulombFriction"]
    assert simple[0].candidate.site == proof.candidate.site
    assert {c.site.name for c in simple[0].alike} == set(proof.equivalent)
    tried = replace(proof, candidate=simple[0].candidate)
    assert simpler_laws(proof, found, [proof, tried]) == ()


def test_rich_law_starts_from_the_fit_of_the_simple_one():
    _, run, proof = proved("CoulombFriction")
    (rich,) = richer_laws(rubbing().null, run, proof, LAWS, [proof])
    assert rich.trial.candidate.effect.name == "StribeckFriction"
    start = {p.name: p.value for p in rich.flat.parameters}
    assert start[f"{rich.trial.candidate.name}.tau_c"] == proof.fit.theta[f"{proof.candidate.name}.tau_c"]


def test_unlike_responses_do_not_compete_once_nothing_is_left():
    found, _, proof = proved("CoulombFriction")
    strong = replace(proof, delta_log_likelihood=5000.0)
    by_name = {t.candidate.effect.name: t for t in trials(found, 1.0, 9)}
    assert not could_compete(by_name["Unbalance"], strong, found)
    assert could_compete(by_name["Unbalance"], None, found)
    assert could_compete(by_name["Unbalance"], replace(strong, left=None), found)
    assert could_compete(by_name["Unbalance"], replace(proof, delta_log_likelihood=50.0), found)
