"""Refits of candidates: right sizes, every gate, and the ranking."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hidden_plants import library, model, prove, quiet, rotor_record, rubbing, some_effects

from daest.diagnosis.built_in import settled as settling
from daest.diagnosis.built_in.certainty import certainty_of, known_products
from daest.diagnosis.built_in.settled import settled
from daest.diagnosis.built_in.trials import (
    Trial,
    _inside,
    at_full_size,
    clipping_trials,
    from_simulation,
    prepare,
    trials,
)
from daest.diagnosis.evidence import proof as proving
from daest.diagnosis.evidence import reasons
from daest.diagnosis.evidence.free_starts import steady_misfit
from daest.diagnosis.evidence.proof import _is_much_left, with_steady_error
from daest.diagnosis.evidence.ranking import best_accepted, least_hope, ranked
from daest.diagnosis.evidence.reasons import (
    NOT_SIGNIFICANT,
    _tells_otherwise,
    beyond_recordings,
    is_history,
    is_significant,
    lag_too_short,
    not_determined,
    same_in_machine,
    straight,
    told_values,
    too_fast,
    too_slow,
    too_slow_for_its_size,
    unexplained,
    unforeseen,
    weak,
    without_evidence,
    wrong_law,
)
from daest.diagnosis.evidence.refused_beside import _ends_in_a_simpler_law, without_imitations
from daest.diagnosis.evidence.same_laws import is_linear_law
from daest.diagnosis.evidence.stand import begin, reference_of
from daest.diagnosis.evidence.unseen import SIMULATED_WORSE
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import grown
from daest.diagnosis.null_model.null_observer import run_null
from daest.diagnosis.options import DiagnoseOptions
from daest.diagnosis.recordings import holds as holding
from daest.diagnosis.refits.course import _possible, _with_better_kinks, _with_second_tries
from daest.diagnosis.screening.candidates import pairs
from daest.diagnosis.screening.clipping import Clip, clips_of, with_clipped_sensors
from daest.diagnosis.screening.disturbance import place_gains, smoothed_load
from daest.diagnosis.screening.free_forms import covers, free_forms
from daest.diagnosis.screening.responses import law_response
from daest.diagnosis.screening.screen import screen
from daest.model.diagnosis import Ahead, Candidate, Confirmed, FreeForm, InUse, Screen, Screened
from daest.model.experiment import Experiment
from daest.model.fit import Agreement, Choice, error_ratios
from daest.modelica.compile import compile_text
from daest.modelica.effects.attach import attach
from daest.modelica.effects.catalogue import find_effect
from daest.modelica.places.sites import sites
from daest.systems.reduction.reduce import reduce_index


@cache
def screened():
    stand = rubbing()
    effects = some_effects("CoulombFriction", "QuadraticDrag")
    return screen(stand.null, run_null(stand.null), pairs(effects, sites(model())))


def test_sizes_of_what_was_not_refitted_are_possible_ones():
    share, friction = (some_effects(name)[0] for name in ("AbsoluteValueSensor", "CoulombFriction"))
    place = sites(model())[0]
    for effect, size, told in ((share, 2327.0, 1.0), (friction, -0.3, 0.0), (friction, 2.0, 2.0)):
        assert _possible(Trial(Candidate(effect, place, "e"), (size,), ())) == (told,)


def test_long_recordings_are_searched_in_parts_first(monkeypatch):
    """Most of the way to the same end."""
    stand, lengths = rubbing(), []
    trial = next(t for t in trials(screened(), 1.0, 5) if t.candidate.effect.name == "CoulombFriction")
    prepared = prepare(stand.null.flat, stand.null.estimated, trial)
    found = proving.refitted

    def watched(flat, explicit, names, null, **options):
        lengths.append(sum(e.n_samples for e in null.experiments))
        return found(flat, explicit, names, null, **options)

    monkeypatch.setattr(proving, "refitted", watched)
    whole = proving._refit(stand.null, prepared, reduce_index(prepared.flat), -np.inf, -np.inf).fit
    n_samples, again = lengths[0], len(lengths)
    monkeypatch.setattr(proving, "LONG", n_samples)
    parted = proving._refit(stand.null, prepared, reduce_index(prepared.flat), -np.inf, -np.inf).fit
    assert lengths[:again] == [n_samples] * again
    assert lengths[again] == -(-n_samples // proving.SHORTER) and lengths[again + 1] == n_samples
    assert parted.log_likelihood == pytest.approx(whole.log_likelihood, abs=0.1)


@cache
def proved(name="CoulombFriction", lead=None):
    stand = rubbing()
    trial = next(t for t in trials(screened(), 1.0, 5) if t.candidate.effect.name == name)
    prepared = prepare(stand.null.flat, stand.null.estimated, trial)
    run = run_null(stand.null)
    return prepared, prove(
        stand.null,
        stand.baseline,
        prepared,
        stand.null.experiments,
        stand.validation,
        run,
        smoothed_load(stand.null, run, place_gains(stand.null, run)),
        screened().n_screened,
        leader=None if lead is None else further_ahead(proved()[1], lead),
        reference=stand.reference,
    )


def further_ahead(proof, lead):
    fit = replace(proof.fit, log_likelihood=proof.fit.log_likelihood + lead)
    return replace(proof, fit=fit, ahead=tuple(replace(a, ratio=0.5 * a.ratio) for a in proof.ahead))


@pytest.mark.slow
def test_candidate_far_behind_a_supported_one_is_judged_after_a_first_pass():
    lead = 2.0 * GATES.hopeless_log_likelihood
    (_, full), (_, brief) = proved(), proved("CoulombFriction", lead)
    behind = full.fit.log_likelihood + lead - brief.fit.log_likelihood
    assert brief.verdict == "rejected" and not brief.is_open and brief.left is None
    assert brief.reason == (
        f"{full.candidate.label} explains the data far better (log-likelihood {behind:.0f})"
    )
    before, after = (p.final.theta[f"{p.candidate.name}.tau_c"] for p in (full, brief))
    assert after == pytest.approx(before, rel=0.02)


@pytest.mark.parametrize(("simulated", "is_pursued"), [(-np.inf, False), (900.0, False), (1100.0, True)])
def test_search_that_a_simulation_promises_much_is_pursued_beside_a_leader(
    monkeypatch, simulated, is_pursued
):
    """It begins beside loads of the size of the null's, far below: the lag of a thermometer, 119.8 of 120 s
    by its simulation, had been given up beside play, which was then supported."""
    asked = []

    def refit(null, prepared, explicit, hopeless, null_likelihood):
        asked.append(hopeless)
        return SimpleNamespace(fit=SimpleNamespace(log_likelihood=0.0))

    stand, (prepared, full) = rubbing(), proved()
    lead = 1000.0 + GATES.hopeless_log_likelihood - full.fit.log_likelihood
    monkeypatch.setattr(proving, "_refit", refit)
    one = replace(prepared, simulated=simulated)
    proving.searched(stand.null, stand.baseline, one, stand.null.experiments, further_ahead(full, lead))
    assert np.isinf(asked[0]) == is_pursued and (is_pursued or asked[0] == pytest.approx(1000.0))


@pytest.mark.parametrize("begun_by_simulation", [False, True])
def test_search_of_a_lag_that_the_innovations_show_is_pursued_beside_a_leader(
    monkeypatch, begun_by_simulation
):
    """It begins at the time that they show, far below: a thermometer 3 s late had been a share of the
    torque in its reading."""
    asked = []

    def refit(null, prepared, explicit, hopeless, null_likelihood):
        asked.append(hopeless)
        return SimpleNamespace(fit=SimpleNamespace(log_likelihood=0.0))

    stand, (prepared, full) = rubbing(), proved()
    lags = pairs(some_effects("Lag"), sites(stand.null.flat))
    trial = replace(prepared.trial, candidate=next(c for c in lags if c.site.kind == "output"))
    monkeypatch.setattr(proving, "_refit", refit)
    one = replace(prepared, trial=trial, simulation=full.fit if begun_by_simulation else None)
    proving.searched(stand.null, stand.baseline, one, stand.null.experiments, further_ahead(full, 1000.0))
    assert np.isinf(asked[0]) != begun_by_simulation


@pytest.mark.slow  # of less gain: the test below
def test_richer_law_below_the_simple_one_is_judged_in_brief():
    stand, (prepared, full) = rubbing(), proved()
    run = run_null(stand.null)
    load = smoothed_load(stand.null, run, place_gains(stand.null, run))
    given = (stand.null.experiments, stand.validation, run, load)

    def after(lead):
        once_more = replace(prepared, simpler=further_ahead(full, lead))
        return prove(stand.null, stand.baseline, once_more, *given, reference=stand.reference)

    below, above = after(1.0), after(-1.0)
    reason = f"{full.candidate.label} explains the data better with fewer parameters (log-likelihood 1)"
    assert below.verdict == "rejected" and below.reason == reason and below.left is None
    assert above.reason == full.reason and above.verdict == full.verdict
    assert above.final.theta == full.final.theta


def test_richer_law_that_gains_less_than_its_parameters_cost_is_judged_in_brief():
    stand, (prepared, full) = rubbing(), proved()
    simple = further_ahead(full, -1.0)
    run = run_null(stand.null)
    given = (stand.null.experiments, stand.validation, run, None)

    def after(ahead):
        worth = replace(simple, delta_bic=full.delta_bic + ahead)
        return prove(
            stand.null, stand.baseline, replace(prepared, simpler=worth), *given, reference=stand.reference
        )

    costly, as_good = after(GATES.same_bic + 1.0), after(GATES.same_bic - 1.0)
    assert costly.verdict == "rejected" and not costly.is_open
    assert costly.reason == f"{simple.candidate.label} says nearly as much with fewer parameters"
    assert as_good.reason != costly.reason


def test_loads_of_the_null_that_lead_astray_give_way_to_those_beside_the_effect(monkeypatch):
    """A kink that has become sharp may have no way from the loads that the null needed."""
    stand, (prepared, proof) = rubbing(), proved()
    flat = prepared.flat
    given = (stand.null, proof.fit, flat, reduce_index(flat), stand.null.experiments, stand.validation)
    usual, _ = settled(*given)
    judged: list = []
    of_all = settling._has_run_away

    def first_one_has(fit, experiments):
        judged.append(fit)
        return len(judged) == 1 or of_all(fit, experiments)

    monkeypatch.setattr(settling, "_has_run_away", first_one_has)
    again, _ = settled(*given)
    assert len({id(fit) for fit in judged}) == 2
    for one, other in zip(usual.parameters, again.parameters, strict=True):
        assert abs(one.value - other.value) < 0.1 * one.std_error


def test_size_of_coulomb_friction_and_parameters_are_right():
    _, proof = proved()
    found = {p.name.rpartition(".")[2]: p for p in proof.fit.parameters}
    for name, true in (("tau_c", 0.15), ("J", 0.5), ("d", 0.3)):
        assert found[name].value == pytest.approx(true, rel=0.1)
        assert abs(found[name].value - true) < 3.5 * found[name].std_error
    assert proof.verdict == "supported" and proof.reason == ""
    assert proof.explained > 0.5 and proof.delta_bic > 20.0 and proof.p_value < 1e-6
    assert not is_significant(proof.left, proof.delta_log_likelihood)


def test_validation_error_falls_to_the_noise_of_the_plant():
    stand, (_, proof) = rubbing(), proved()
    before = stand.baseline.simulated["validation"].rms["phi"]
    assert proof.told.simulated["validation"].rms["phi"] < before / 3.0


def test_proof_keeps_its_values_in_the_model():
    _, proof = proved()
    values = {p.name: p.value for p in proof.flat.parameters}
    assert all(values[name] == value for name, value in proof.fit.theta.items())


def test_equal_places_are_one_trial():
    found = trials(screened(), 1.0, 5)
    names = [t.candidate.effect.name for t in found]
    assert len(set(names)) == len(names)
    coulomb = next(t for t in found if t.candidate.effect.name == "CoulombFriction")
    assert {coulomb.candidate.site.name, *(c.site.name for c in coulomb.alike)} == {
        "bearing",
        "rotor.flange_a",
    }


def entry(candidate, score, p_value, absorbed=False):
    return Screened(candidate, score, (0.1,), p_value, absorbed, 0.1)


def test_trials_are_significant_not_absorbed_and_not_too_many():
    rotor = {e.name: e for e in some_effects("CoulombFriction", "QuadraticDrag", "Unbalance", "ConstantLoad")}
    candidates = [next(c for c in pairs([e], sites(model()))) for e in rotor.values()]
    entries = tuple(
        entry(c, 5.0 - i, p, absorbed)
        for i, (c, p, absorbed) in enumerate(
            zip(candidates, (0.001, 0.001, 0.01, 0.2), (False, True, False, False), strict=True)
        )
    )
    found = Screen(entries, np.eye(4), 0.001, 4, ())
    assert [t.candidate for t in trials(found, 0.05, 5)] == [candidates[0], candidates[2]]
    assert [t.candidate for t in trials(found, 0.05, 1)] == [candidates[0]]
    # A share of an input in a sensor stands beside those, and only the first.
    crossing = [
        replace(
            candidates[k], effect=replace(candidates[k].effect, class_name="X", is_of_driving=True), site=site
        )
        for k, site in enumerate(sites(model())[:2])
    ]
    ahead = tuple(entry(one, 6.0, 0.001) for one in crossing)
    found = Screen((*ahead, *entries), np.eye(6), 0.001, 6, ())
    assert [t.candidate for t in trials(found, 0.05, 1)] == [crossing[0], candidates[0]]


def changed_size(fit, **changes):
    parameters = tuple(replace(p, **changes) if p.name.endswith("tau_c") else p for p in fit.parameters)
    return replace(fit, parameters=parameters)


@pytest.mark.parametrize(
    "gain, delta_bic, p_value, reason",
    [
        (-20.0, -50.0, 1.0, "the search lost its way: it ends 20 below"),
        (10.0, 9.0, 1e-6, "likelihood gains too little"),
        (30.0, 50.0, 0.01, "finds as much by chance"),
        (30.0, 50.0, 1e-6, ""),
    ],
)
def test_evidence(gain, delta_bic, p_value, reason):
    found = without_evidence(gain, delta_bic, p_value, 100)
    assert reason in found and bool(reason) == bool(found)


@pytest.mark.parametrize(
    "changes, reason",
    [
        ({"at_bound": "min"}, "rests at its bound"),
        ({"std_error": None}, "do not determine its size"),
        ({"std_error": 1.0}, "not significant"),
        ({}, ""),
    ],
)
def test_sizes_that_prove_nothing(changes, reason):
    prepared, proof = proved()
    found = weak(prepared, changed_size(proof.fit, **changes), proof.fit)
    assert reason in found and bool(reason) == bool(found)


def test_search_that_came_to_its_limit_goes_on(monkeypatch):
    """To have come to a limit is a reason to go on, not to refuse."""
    stand, (prepared, first) = rubbing(), proved()
    asked = []

    def short(flat, *arguments, **options):
        asked.append(flat)
        value = first.fit.log_likelihood - (5.0 if len(asked) == 1 else 0.0)
        fit = replace(first.fit, status="iteration limit", log_likelihood=value)
        return SimpleNamespace(fit=fit, simulated=lambda validation: fit)

    monkeypatch.setattr("daest.diagnosis.evidence.proof.refitted", short)
    run = run_null(stand.null)
    proof = prove(stand.null, stand.baseline, prepared, stand.null.experiments, stand.validation, run, None)
    assert len(asked) == 3, "as long as it gains"
    assert {p.name: p.value for p in asked[1].parameters}["J"] == first.fit.theta["J"]
    assert proof.fit.log_likelihood == first.fit.log_likelihood and proof.verdict == "supported"


def test_falling_simulation_error_asks_for_less_explanation():
    assert unexplained(0.4, [0.6, 0.7]) == ""
    assert "explains only 40 %" in unexplained(0.4, [0.6, 0.8])
    assert "explains only 5 %" in unexplained(0.05, [0.6])


def test_unseen_data_have_the_last_word():
    stand, (prepared, first) = rubbing(), proved()
    assert first.final is not None and all(one.ratio < 1.0 for one in first.ahead)
    run = run_null(stand.null)

    def verdict(reference):
        return prove(
            stand.null, stand.baseline, prepared, stand.null.experiments, stand.validation, run, None,
            reference=reference,
        )  # fmt: skip

    # A model that foresees as well already, at all horizons, leaves nothing to be supported.
    with_effect = grown(
        stand.null, prepared.flat, reduce_index(prepared.flat), first.fit, stand.null.experiments
    )
    as_good = reference_of(with_effect, first.fit, stand.validation)
    assert "no better" in verdict(as_good).reason or "worse" in verdict(as_good).reason
    assert not verdict(as_good).is_open


def test_law_that_lives_on_how_its_states_begin_is_in_no_law_s_way(monkeypatch):
    """Of a camera on a servo, a hysteresis that only its first state moved kept dry friction from a claim."""
    stand, (prepared, _) = rubbing(), proved()
    run = run_null(stand.null)

    def judged():
        return prove(
            stand.null, stand.baseline, prepared, stand.null.experiments, stand.validation, run, None
        )

    monkeypatch.setattr(proving, "_of_levels", lambda *_: "it is so")
    assert judged().is_open
    monkeypatch.setattr(proving, "_of_its_start", lambda *_: "it lives on its start")
    alone = judged()
    assert alone.reason == "it lives on its start" and not alone.is_open


def test_ratios_of_simulation_errors():
    stand, (_, proof) = rubbing(), proved()
    before, after = stand.baseline.simulated, proof.told.simulated
    (ratio,) = error_ratios(before, after)
    assert ratio < 0.4
    assert error_ratios(after, before) == [pytest.approx(1.0 / ratio)]
    assert error_ratios({}, after) == []


@pytest.mark.parametrize(
    ("name", "kind", "share", "reason"),
    [
        ("OneSidedLimit", "input", 0.05, "leaves the signal nearly as it is"),
        ("OneSidedLimit", "input", 0.9, ""),
        ("AbsoluteValueSensor", "output", 0.5, "a sensor loses the sign, or it does not"),
        ("AbsoluteValueSensor", "output", 0.95, ""),
    ],
)
def test_share_that_is_another_law_is_weak(name, kind, share, reason):
    """A small share of what lies beyond a limit at the end of the range is a gain and an offset; half a
    sensor of magnitude is a sensor that shows one direction."""
    prepared, proof = proved()
    bent = next(c for c in pairs(some_effects(name), sites(model())) if c.site.kind == kind)
    own = replace(proof.fit.parameters[-1], name=f"{bent.name}.share", value=share, std_error=0.005)
    fit = replace(proof.fit, parameters=(*proof.fit.parameters, own))
    found = weak(replace(prepared, trial=replace(prepared.trial, candidate=bent)), fit, proof.fit)
    assert reason in found and bool(reason) == bool(found)


@pytest.mark.parametrize(
    ("name", "limit", "gain"),
    [
        ("Saturation", 1e-6, "0.1"),
        ("Saturation", 0.5, ""),
        ("OneSidedLimit", 0.3, ""),
        ("OneSidedLimit", 99.0, "0.1"),
    ],
)
def test_limit_that_the_signal_is_always_beyond_is_a_gain(name, limit, gain):
    """Nine tenths of all that is cut, by the values of the fit and not by those that it began with."""
    stand = rubbing()
    cut = next(c for c in pairs(some_effects(name), sites(model())) if c.site.kind == "input")
    begun = attach(stand.null.flat, cut.effect, cut.site, cut.name, {"share": 0.5, "limit": 0.7})
    values = {f"{cut.name}.share": 0.9, f"{cut.name}.limit": limit}
    fit = replace(stand.baseline, theta={**stand.baseline.theta, **values})
    found = straight(grown(stand.null, begun, reduce_index(begun), fit, stand.null.experiments), cut, fit)
    said = f"the recordings show no bend of it: it is a gain of {gain} and an offset of "
    assert found.startswith(said) if gain else not found, found


@pytest.mark.parametrize(
    ("name", "values", "is_shut"),
    [
        ("Play", {"width": 50.0}, True),  # wider than all that the signal does
        ("Play", {"width": 0.2}, False),
        ("DeadZone", {"width": 50.0}, True),
        ("DeadZone", {"width": 0.2}, False),
        ("Offset", {"b": 50.0}, False),
        ("Gain", {"g": -1.0}, False),  # says just that
    ],
)
def test_law_through_which_nothing_of_a_signal_comes_is_any_cut(name, values, is_shut):
    stand = rubbing()
    law = next(c for c in pairs(some_effects(name), sites(model())) if c.site.kind == "input")
    flat = attach(stand.null.flat, law.effect, law.site, law.name, values)
    own = {f"{law.name}.{key}": value for key, value in values.items()}
    fit = replace(stand.baseline, theta={**stand.baseline.theta, **own})
    grown_null = grown(stand.null, flat, reduce_index(flat), fit, stand.null.experiments)
    said = reasons.beyond_recordings(grown_null, law, fit)
    assert ("nothing of" in said) == is_shut, said


@pytest.mark.parametrize(
    ("name", "values", "level", "is_straight"),
    [
        ("QuadraticGain", {"a": 0.1}, 0.0, False),
        ("QuadraticGain", {"a": 0.001}, 1000.0, True),  # the readings of a thermometer, in kelvin
        ("DeadZone", {"width": 0.1}, 1000.0, False),  # its width is the offset
    ],
)
def test_bend_far_from_zero_that_the_recordings_show_straight_is_a_gain(name, values, level, is_straight):
    """a u^2 about a level U is 2 a U u - a U^2 but for a share of u's range over U, squared."""
    stand = rubbing()
    moved = [replace(e, inputs=e.inputs + level) for e in stand.null.experiments]
    bent = next(c for c in pairs(some_effects(name), sites(model())) if c.site.kind == "input")
    flat = attach(stand.null.flat, bent.effect, bent.site, bent.name, values)
    own = {f"{bent.name}.{key}": value for key, value in values.items()}
    fit = replace(stand.baseline, theta={**stand.baseline.theta, **own})
    found = straight(grown(stand.null, flat, reduce_index(flat), fit, moved), bent, fit)
    assert found.startswith("the recordings show no bend of it: it is a gain of 3 ") == is_straight, found


@pytest.mark.parametrize(
    ("name", "values", "is_same"),
    [
        ("QuadraticGain", {"a": -0.05}, True),
        ("QuadraticGain", {"a": -3.0}, False),  # reads less where there is more
        ("Saturation", {"share": 0.5, "limit": 0.3}, True),
        ("Saturation", {"share": 1.0, "limit": 0.3}, True),  # its readings go on beyond
        ("DeadZone", {"width": 0.4, "u_s": 1e-4}, True),  # hardly ever inside of it
        ("DeadZone", {"width": 4.0, "u_s": 1e-4}, False),  # tells nothing inside
        ("AbsoluteValueSensor", {"share": 1.0}, False),  # tells no sign
        ("Gain", {"g": 0.4}, False),  # does not bend
        ("Drift", {"r": 0.01}, False),  # is no function of the signal
    ],
)
def test_sensor_that_bends_and_tells_all_is_a_machine_that_bends(name, values, is_same):
    """z = g(y) of y' = f(y, u) is the machine z' = g'(y) f(y, u); a signal before the machine is none."""
    stand = rubbing()
    found = [c for c in pairs(some_effects(name), sites(model())) if c.site.kind in ("input", "output")]
    assert found
    for bent in found:
        flat = attach(stand.null.flat, bent.effect, bent.site, bent.name, values)
        own = {f"{bent.name}.{key}": value for key, value in values.items()}
        fit = replace(stand.baseline, theta={**stand.baseline.theta, **own})
        bends = grown(stand.null, flat, reduce_index(flat), fit, stand.null.experiments)
        said = same_in_machine(bends, bent, fit)
        expected = f"a machine that bends alike before {bent.site.name}"
        assert said == (expected if is_same and bent.site.kind == "output" else "")


MUG = b"""model Mug "Hot water"
  parameter Real G(unit = "W/K", min = 0) = 0.4 annotation(__Daest(estimate = true, scale = "log"));
  input Real T_room(unit = "degC");
  output Real T(unit = "degC", start = 98, fixed = false);
equation
  1000*der(T) = -G*(T - T_room)LOSS;
end Mug;
"""


@pytest.mark.parametrize(
    ("effect", "loss", "room", "is_same"),
    [
        ("Lag", "", 0.0, True),
        ("Lag", "", 5.0, False),  # a room that moves tells a thermometer from a wall
        ("Lag", " - 0.01*T^2", 0.0, False),  # no sum of decays
        ("Offset", "", 0.0, False),
    ],
)
def test_lag_of_the_only_sensor_of_what_nothing_drives_is_any_store(effect, loss, room, is_same):
    """Two decays from unknown starts are those of a thermometer behind a mug as well as of a warm handle."""
    flat = compile_text(MUG.replace(b"LOSS", loss.encode()), Path("Mug.mo"))
    time = np.arange(100) * 60.0
    rooms = 22.0 + room * np.sin(time / 600.0)
    run = Experiment("run", time, rooms[:, None], np.zeros((100, 1)), ("T_room",), ("T",))
    (late,) = (c for c in pairs(some_effects(effect), sites(flat)) if c.site.kind == "output")
    known = attach(flat, late.effect, late.site, late.name, {})
    model = SimpleNamespace(flat=known, explicit=reduce_index(known), experiments=(run,))
    assert reasons._is_one_more_store(model, late) is is_same


@pytest.mark.parametrize(
    ("levels", "every", "limit", "is_same"),
    [
        ((0.0, 1.0), 20, 0.5, True),
        ((1.0, 2.0, 1.0, 0.0), 20, 0.5, True),  # up and down by one size
        ((0.0, 1.0, 0.0, 2.0), 20, 0.5, False),  # the larger step takes longer
        ((0.0, 1.0), 1, 0.5, False),  # turns back on its ramp
    ],
)
def test_limited_rate_of_equal_steps_is_a_dead_time_or_lags(levels, every, limit, is_same):
    """A square wave shows ramps of one length: no sample tells that a larger step would take longer."""
    flat = compile_text(MUG.replace(b"LOSS", b""), Path("Mug.mo"))
    time = np.arange(200.0)
    room = np.resize(np.repeat(levels, every), 200)
    run = Experiment("run", time, room[:, None], np.zeros((200, 1)), ("T_room",), ("T",))
    (slow,) = (c for c in pairs(some_effects("RateLimit"), sites(flat)) if c.site.kind == "input")
    model = SimpleNamespace(flat=flat, experiments=(run,))
    told = SimpleNamespace(theta={f"{slow.name}.limit": limit})
    expected = "a dead time or lags that smooth T_room, whose steps are all of one size, over 2 s"
    assert same_in_machine(model, slow, told) == (expected if is_same else "")


def test_readings_of_a_sensor_that_cuts_are_noise_beyond_its_limit():
    """A force of 14 kN is none of a load cell that shows 10 kN: what slips there is the machine."""
    noise = 0.05 * np.random.default_rng(1).normal(size=600)
    moved = 3.0 * np.sin(0.05 * np.arange(600))
    shown = np.clip(moved, -2.0, 2.0)
    limits = reasons._limits(moved, shown)
    assert limits == pytest.approx((-2.0, 2.0), abs=1e-6)
    assert not reasons._moves_beyond(shown + noise, limits)
    assert not reasons._moves_beyond(np.clip(moved, -2.001, 2.001), limits), "a level that the search missed"
    assert reasons._moves_beyond(0.8 * moved + 0.2 * shown + noise, limits)
    held = shown + 0.05 * np.sin(0.2 * np.arange(600)) * (np.abs(moved) > 2.0)
    assert reasons._moves_beyond(held, limits), "a controller that sways about its set point"
    for other in (np.abs(moved), moved - shown, 0.0 * moved):
        assert reasons._limits(moved, other) == (-np.inf, np.inf)


def test_sensor_that_bends_beside_a_straight_one_of_the_same_signal_is_no_machine(monkeypatch):
    """If the machine bent, both would show it; a tachometer tells another signal, which a bent machine turns
    out otherwise, too."""
    bent = next(c for c in pairs(some_effects("QuadraticGain"), sites(model())) if c.site.kind == "output")
    phi = np.cumsum(np.random.default_rng(3).normal(size=500))
    outputs = [SimpleNamespace(name="phi"), SimpleNamespace(name="y")]
    machine = SimpleNamespace(flat=SimpleNamespace(outputs=outputs), experiments=())
    bend = SimpleNamespace(along=phi)
    for y, tells in ((3.0 - 2.0 * phi, True), (np.gradient(phi), False), (np.full(500, 3.0), False)):
        run = SimpleNamespace(outputs=np.column_stack([phi - 0.05 * phi * np.abs(phi), y]))
        monkeypatch.setattr(reasons, "free_runs", lambda *_, run=run: (run,))
        assert _tells_otherwise(machine, bent, bend) == tells


def test_same_law_at_a_place_that_the_sensors_see_alike_is_not_in_the_way():
    """A lag at a sensor, behind which the loads come in, beside the same lag at the input."""
    _, proof = proved()
    moved = replace(proof.candidate, site=replace(proof.candidate.site, name="elsewhere"))
    twin = replace(
        proof,
        candidate=moved,
        equivalent=(proof.candidate.site.name,),
        delta_log_likelihood=3.0 * proof.delta_log_likelihood,
        verdict="rejected",
        reason="it is shaky",
        is_open=True,
    )
    assert ranked([proof, twin])[0].verdict == "supported"
    assert ranked([proof, replace(twin, equivalent=())])[0].verdict == "rejected"
    # Other estimates are another explanation.
    other = changed_size(twin.told, value=2.0)
    assert ranked([proof, replace(twin, fit=other, final=other)])[0].verdict == "rejected"


def test_law_that_leaves_load_and_errors_gives_way_to_one_that_takes_the_load():
    """A ripple of a shank that hangs in the air by a constant torque, which a slow load says as well."""
    _, proof = proved()
    told = proof.told
    seen = told.simulated["validation"]

    def with_errors(ratio, lasts):
        unseen = replace(seen, rms={name: ratio * rms for name, rms in seen.rms.items()})
        unseen = replace(unseen, white={name: rms / lasts for name, rms in unseen.rms.items()})
        return replace(told, simulated={**told.simulated, "validation": unseen})

    lasting = with_errors(1.0, 100.0)
    ripple = replace(proof, explained=0.0, fit=lasting, final=lasting, adds_up=False)
    near = with_errors(0.05, 5.0)
    constant = replace(
        ripple,
        candidate=replace(proof.candidate, name="other"),
        delta_log_likelihood=-1.0,
        delta_bic=-6.0,
        explained=0.76,
        fit=near,
        final=near,
        verdict="rejected",
        reason="the likelihood gains too little",
    )

    def verdict(ripple, constant):
        return next(p.verdict for p in ranked([ripple, constant]) if p.candidate.name != "other")

    assert verdict(ripple, constant) == "rejected"
    assert verdict(replace(ripple, explained=0.8), constant) == "supported"
    assert verdict(ripple, replace(constant, explained=0.2)) == "supported"  # it takes no load either
    assert verdict(ripple, replace(constant, delta_log_likelihood=-50.0)) == "supported"  # it is lost
    far = with_errors(0.8, 5.0)
    assert verdict(ripple, replace(constant, fit=far, final=far)) == "supported"
    passing = with_errors(1.0, 1.2)
    assert verdict(replace(ripple, fit=passing, final=passing), constant) == "supported"
    elsewhere = replace(constant.candidate, site=replace(proof.candidate.site, name="elsewhere"))
    assert verdict(ripple, replace(constant, candidate=elsewhere)) == "supported"


def test_size_as_large_as_it_can_be_is_no_weakness():
    prepared, proof = proved()
    assert weak(prepared, changed_size(proof.fit, at_bound="max", std_error=None), proof.fit) == ""


def test_weak_candidate_is_not_accepted_beside_a_far_more_likely_one():
    _, proof = proved()
    strong = replace(
        proof,
        delta_log_likelihood=3.0 * proof.delta_log_likelihood,
        verdict="rejected",
        reason="it is shaky",
        is_open=True,
    )
    (first, second) = ranked([proof, strong])
    assert first.verdict == second.verdict == "rejected"
    assert any("far better" in p.reason and "it is shaky" in p.reason for p in (first, second))
    # What unseen data speak against stands in nobody's way.
    assert ranked([proof, replace(strong, is_open=False)])[0].verdict == "supported"
    # What does most of it is, whatever its parameters are.
    vague = replace(strong, is_open=False, is_vague=True)
    assert ranked([proof, vague])[0].verdict == "rejected"
    assert ranked([proof, replace(vague, explained=0.2)])[0].verdict == "supported"
    # Nor does what foresees unseen data clearly worse.
    told = strong.told
    seen = told.simulated["validation"]
    worse = replace(seen, rms={name: 1.5 * rms for name, rms in seen.rms.items()})
    poor = replace(told, simulated={**told.simulated, "validation": worse})
    shaky = replace(strong, fit=poor, final=poor, adds_up=False)
    assert ranked([replace(proof, adds_up=False), shaky])[0].verdict == "supported"
    # But what unseen data speak against and for, and far more clearly, leaves all open.
    better = replace(seen, rms={name: 0.5 * rms for name, rms in seen.rms.items()})
    good = replace(told, simulated={**told.simulated, "validation": better})
    lost = (Ahead(1, 0.01, 7.0, -60.0),)
    standing = replace(vague, explained=0.0, fit=good, final=good, adds_up=False)
    assert ranked([replace(proof, adds_up=False), standing])[0].verdict == "rejected"
    torn = replace(strong, fit=good, final=good, adds_up=False, is_open=False, ahead=lost)
    assert ranked([replace(proof, adds_up=False), torn])[0].verdict == "rejected"
    # So does what only simulates them as well, if it foresees them better in the long run.
    lasting = (Ahead(1, 0.01, 1.06, -2.8), Ahead(30, 0.3, 0.65, 2.1))
    as_good = replace(strong, adds_up=False, is_open=False, ahead=lasting)
    assert ranked([replace(proof, adds_up=False), as_good])[0].verdict == "rejected"
    passing = replace(as_good, ahead=(Ahead(1, 0.01, 1.06, -2.8), Ahead(30, 0.3, 1.02, -0.1)))
    assert ranked([replace(proof, adds_up=False), passing])[0].verdict == "supported"
    assert ranked([replace(proof, adds_up=False), replace(shaky, ahead=lasting)])[0].verdict == "supported"
    # Or what makes them clearly likelier, and likelier than the accepted law does.
    held, known = replace(proof, adds_up=False, confirmed=Confirmed(60.0, 3.5)), Confirmed(96.0, 3.3)
    assert ranked([held, replace(passing, confirmed=known)])[0].verdict == "rejected"
    assert ranked([held, replace(passing, confirmed=replace(known, certainty=1.0))])[0].verdict == "supported"
    assert ranked([held, replace(passing, confirmed=replace(known, gain=50.0))])[0].verdict == "supported"
    # Where nothing but their whole simulation speaks against it, too.
    whole = f"{SIMULATED_WORSE} 1.12 times worse"
    drifting = replace(passing, ahead=(Ahead(1, 0.01, 0.95, 5.0),), reason=whole, confirmed=known)
    assert ranked([held, drifting])[0].verdict == "rejected"
    assert ranked([held, replace(drifting, reason="it is shaky")])[0].verdict == "supported"
    assert ranked([held, replace(drifting, confirmed=replace(known, gain=50.0))])[0].verdict == "supported"


def test_law_that_its_simulation_shows_is_held_against_a_refused_one_beside_the_loads():
    """An offset of an amplifier, and the same beyond a limit that nobody knows: the simulation of a few
    independent samples gains less than the predictions of all, of one law as of the other."""
    _, proof = proved()
    used = InUse(fitted=0.35, unseen=0.58, n_independent=33.0, n_unseen=23.0, certainty=2.6)
    shown = replace(proof, in_use=used, is_by_use=True, delta_bic=22.0, delta_log_likelihood=used.gain)
    vague = replace(proof, verdict="rejected", reason="it is shaky", is_vague=True, explained=0.99)
    assert GATES.min_refused_gain * vague.delta_log_likelihood > used.gain
    assert ranked([shown, vague])[0].verdict == "supported"
    # One that gains far more beside the loads, too, is in the way.
    gain = 2.0 * proof.delta_log_likelihood
    fit = replace(vague.fit, log_likelihood=vague.fit.log_likelihood + gain)
    strong = replace(vague, fit=fit, delta_log_likelihood=vague.delta_log_likelihood + gain)
    assert ranked([shown, strong])[0].verdict == "rejected"


def test_law_that_its_simulation_shows_is_not_confirmed_less_than_one_that_simulates_worse():
    """Friction of two carts, shown by their simulation, of which no predictions are known, and a part on a
    spring that foresees unseen speeds worse, makes them likelier, and simulates them worse."""
    _, proof = proved()
    seen = proof.told.simulated["validation"]

    gain = 2.0 * proof.delta_log_likelihood

    def simulating(times):
        rms = {name: times * value for name, value in seen.rms.items()}
        likelier = proof.fit.log_likelihood + gain
        return replace(proof.told, log_likelihood=likelier, simulated={"validation": replace(seen, rms=rms)})

    used = InUse(fitted=0.35, unseen=0.58, n_independent=33.0, n_unseen=23.0, certainty=2.6)
    shown = replace(proof, in_use=used, is_by_use=True, delta_bic=22.0, delta_log_likelihood=used.gain)
    shown = replace(shown, adds_up=False, ahead=())
    part = replace(
        proof,
        verdict="rejected",
        reason="unseen data are foreseen 1.09 times worse over 0.03 s",
        fit=simulating(1.5),
        final=simulating(1.5),
        delta_log_likelihood=proof.delta_log_likelihood + gain,
        adds_up=False,
        ahead=(Ahead(1, 0.001, 1.02, -4.0), Ahead(30, 0.03, 1.09, -2.6)),
        confirmed=Confirmed(151.0, 4.2),
    )
    assert ranked([shown, part])[0].verdict == "supported"
    # It is in the way where it simulates them as well, or where the predictions of both are known.
    as_good = replace(part, fit=simulating(1.0), final=simulating(1.0))
    assert ranked([shown, as_good])[0].verdict == "rejected"
    beside_loads = replace(shown, is_by_use=False, delta_log_likelihood=proof.delta_log_likelihood)
    assert ranked([beside_loads, part])[0].verdict == "rejected"


def test_law_that_a_simulation_alone_shows_is_none_where_another_is_better_in_both():
    """A bend of the sensor beside friction and a spring: each spring is likelier, and simulates better."""
    _, proof = proved()
    seen = proof.told.simulated["validation"]

    def law(place, gain, error, **changes):
        rms = {name: error * value for name, value in seen.rms.items()}
        told = replace(proof.told, simulated={"validation": replace(seen, rms=rms)})
        site = replace(proof.candidate.site, name=place)
        return replace(
            proof,
            candidate=replace(proof.candidate, site=site, name=place),
            fit=replace(proof.fit, log_likelihood=proof.fit.log_likelihood + gain),
            final=told,
            adds_up=False,
            equivalent=(),
            **changes,
        )

    used = InUse(fitted=0.35, unseen=0.58, n_independent=33.0, n_unseen=23.0, certainty=2.6)
    bend = law("sensor", 1.0, 1.0, in_use=used, is_by_use=True, delta_bic=22.0, delta_log_likelihood=12.5)
    little = {"verdict": "rejected", "reason": "it explains only 15 % of the load", "takes_little": True}
    spring = law("disc", 15.0, 0.97, delta_bic=16.0, delta_log_likelihood=15.0, explained=0.15, **little)
    found = ranked([bend, spring])
    assert [p.verdict for p in found] == ["rejected", "rejected"]
    assert "simulates unseen data better and is likelier" in next(p.reason for p in found if p.is_by_use)
    # Not where it simulates worse, is less likely, or something else speaks against it.
    others = (
        law("disc", 15.0, 1.01, delta_bic=16.0, delta_log_likelihood=15.0, explained=0.15, **little),
        law("disc", 0.5, 0.97, delta_bic=-5.0, delta_log_likelihood=0.5, explained=0.15, **little),
        replace(spring, takes_little=False),
    )
    for other in others:
        assert [p.verdict for p in ranked([bend, other])] == ["supported", "rejected"]
    beside_loads = replace(bend, is_by_use=False, delta_bic=200.0, delta_log_likelihood=104.0)
    assert ranked([beside_loads, spring])[0].verdict == "supported"


def test_richer_law_that_rests_at_a_bound_is_the_simple_one():
    _, simple = proved()
    rich = next(e for e in some_effects("LuGreFriction"))
    size = next(p for p in simple.fit.parameters if p.name.startswith(simple.candidate.name))
    shape = replace(size, name=f"{simple.candidate.name}.b", at_bound="min")
    fit = replace(simple.fit, parameters=(*simple.fit.parameters, shape))
    refused = replace(simple, candidate=replace(simple.candidate, effect=rich), fit=fit)
    assert _ends_in_a_simpler_law(refused, simple)
    inside = replace(fit, parameters=(*simple.fit.parameters, replace(shape, at_bound=None)))
    assert not _ends_in_a_simpler_law(replace(refused, fit=inside), simple)
    assert not _ends_in_a_simpler_law(simple, refused)
    # So it is where the sensors see both places alike, and not at another one.
    site = simple.candidate.site
    behind = replace(simple, candidate=replace(simple.candidate, site=replace(site, name="behind")))
    assert _ends_in_a_simpler_law(replace(refused, equivalent=("behind",)), behind)
    assert not _ends_in_a_simpler_law(replace(refused, equivalent=()), replace(behind, equivalent=()))


def test_law_of_which_no_size_is_known_leaves_a_known_one_open():
    _, simple = proved()
    own = next(p for p in simple.told.parameters if p.name.startswith(simple.candidate.name))
    shape = replace(own, name=f"{simple.candidate.name}.T", value=5.0 * (own.std_error or 0.0))
    unknown = replace(own, std_error=abs(own.value))
    spring = next(e for e in some_effects("RelaxingSpring"))

    def fitted(size, gain):
        others = tuple(p for p in simple.fit.parameters if p is not own and p.name != own.name)
        fit = replace(simple.fit, parameters=(*others, size, shape))
        wide = replace(simple.candidate.effect.parameters[0], name="T", role="shape", estimate=True)
        sizes = (simple.candidate.effect.sizes[0], wide)
        candidate = replace(simple.candidate, effect=replace(spring, parameters=sizes))
        more = {"delta_log_likelihood": gain, "delta_bic": 2.0 * gain - 10.0, "ahead": simple.ahead}
        return replace(simple, candidate=candidate, fit=fit, final=fit, **more)

    nearly = simple.delta_log_likelihood / 0.8
    for law, is_open in ((fitted(unknown, nearly), True), (fitted(own, nearly), False)):
        order = ranked([simple, law])
        assert [p.verdict for p in order] == (["not separable"] * 2 if is_open else ["supported", "rejected"])
        assert order[0].candidate is (simple if is_open else law).candidate
    far = fitted(unknown, simple.delta_log_likelihood / 0.6)
    assert [p.verdict for p in ranked([simple, far])] == ["supported", "rejected"]


def test_size_that_was_not_estimated_is_no_claim():
    prepared, proof = proved()
    fit = replace(proof.fit, parameters=proof.fit.parameters[:2])
    assert "was not estimated" in weak(prepared, fit, proof.fit)


def test_ranking():
    _, proof = proved()
    likelihood, bic = proof.delta_log_likelihood, proof.delta_bic
    other_law = replace(proof.candidate.effect, class_name="Other")
    elsewhere = replace(proof.candidate, effect=other_law, site=replace(proof.candidate.site, name="bearing"))
    close = replace(proof, candidate=elsewhere, delta_log_likelihood=likelihood - 2.5, delta_bic=bic - 5.0)
    far = replace(proof, delta_log_likelihood=likelihood - 3.5, delta_bic=bic - 7.0)
    failed = replace(proof, delta_bic=proof.delta_bic + 100.0, verdict="rejected", reason="no")
    assert [p.verdict for p in ranked([far, failed, proof])] == ["supported", "rejected", "rejected"]
    order = ranked([failed, close, far, proof])
    assert [p.verdict for p in order] == ["not separable", "not separable", "rejected", "rejected"]
    assert best_accepted(order) is order[0] and best_accepted([failed]) is None
    assert order[0].delta_bic == proof.delta_bic and order[0].not_separable_from == (close.candidate.label,)
    assert "explains the data better" in next(p for p in order if p.delta_bic == far.delta_bic).reason
    assert ranked([]) == ()


def law_told(name, delta_log_likelihood, **own):
    """The proof of a law, of signals at an input, with values and standard errors of its own parameters."""
    _, proof = proved()
    effect = next(e for e in library() if e.name == name and e.domain != "translational")
    place = next(s for s in sites(model()) if (s.kind == "input") == (effect.domain == "signal"))
    law = Candidate(effect, place, name)
    size = next(p for p in proof.fit.parameters if p.name.startswith(proof.candidate.name))
    units = {p.name: p.unit for p in law.effect.parameters}
    told = [
        replace(
            size,
            name=f"{name}.{n}",
            unit=units[n],
            value=v,
            std_error=e,
            at_bound="max" if v == 1.0 else None,
        )
        for n, (v, e) in own.items()
    ]
    others = [p for p in proof.fit.parameters if not p.name.startswith(proof.candidate.name)]
    fit = replace(proof.fit, parameters=(*others, *told))
    bic = 2.0 * delta_log_likelihood - 8.0 * law.n_unknowns
    final = None if proof.final is None else replace(proof.final, parameters=fit.parameters)
    return replace(
        proof, candidate=law, fit=fit, final=final, delta_log_likelihood=delta_log_likelihood, delta_bic=bic
    )


@pytest.mark.parametrize(
    ("length", "size", "gain", "verdict"),
    [
        ((1e-5, 4e-5), 1.2, 240.0, "not separable"),
        ((1e-3, 4e-5), 1.2, 240.0, "rejected"),  # its loop closes over a length that the data know
        ((1e-5, 4e-5), 1.5, 240.0, "rejected"),  # another size
        ((1e-5, 4e-5), 1.2, 100.0, "rejected"),  # most of what it does is not friction
    ],
)
def test_loop_that_closes_within_no_length_may_be_dry_friction(length, size, gain, verdict):
    loop = law_told("HystereticSpring", 300.0, tau_h=(1.21, 0.03), phi_h=length)
    friction = law_told("CoulombFriction", gain, tau_c=(size, 0.03))
    found = {p.candidate.effect.name: p.verdict for p in ranked([loop, friction])}
    assert found["CoulombFriction"] == verdict


@pytest.mark.parametrize(
    ("time", "ahead", "verdict"),
    [
        ((1e-9, 1e-5), 0.0, "rejected"),
        ((1e-3, 1e-5), 0.0, "not separable"),  # damping that the data know
        ((1e-9, 1e-5), 4.0, "not separable"),  # clearly likelier
    ],
)
def test_law_with_a_parameter_that_does_nothing_is_no_rival_of_one_without(time, ahead, verdict):
    coil = law_told("Inductance", 300.0, L=(0.35, 0.01))
    soft = law_told("ExtraCompliance", 300.0 + ahead, e=(110.0, 0.1), T=time)
    found = {p.candidate.effect.name: p for p in ranked([coil, soft])}
    assert found["ExtraCompliance"].verdict == verdict


@pytest.mark.parametrize(
    ("time", "ahead", "verdict"),
    [
        ((1.6e-5, 0.5e-5), 15.0, "not separable"),
        ((1.6e-5, 0.1e-5), 15.0, "rejected"),  # a time that the data know
        ((1.6e-5, 0.5e-5), 25.0, "rejected"),  # no parameter so near zero gains that
        ((1.6e-5, 0.5e-5), 40.0, "rejected"),  # the simple law gains clearly less
    ],
)
def test_law_is_no_further_ahead_than_its_parameter_is_off_zero(time, ahead, verdict):
    coil = law_told("Inductance", 1000.0, L=(0.35, 0.01))
    soft = law_told("ExtraCompliance", 1000.0 + ahead, e=(110.0, 0.1), T=time)
    elsewhere = replace(soft.candidate.site, name="emf.flange")
    soft = replace(soft, candidate=replace(soft.candidate, site=elsewhere))
    found = {p.candidate.effect.name: p.verdict for p in ranked([coil, soft])}
    assert found["Inductance"] == verdict


def test_law_that_says_what_a_short_lag_says_is_something_fast():
    short = {"verdict": "rejected", "reason": "it is short", "is_any_dynamics": True}
    lag = replace(law_told("Lag", 300.0, T=(5e-4, 5e-5)), **short)
    coil = replace(law_told("Inductance", 300.0, L=(9e-4, 1e-4)), delta_bic=lag.delta_bic)
    cross = replace(law_told("Crosstalk", 296.0, k=(-0.1, 0.01)), delta_bic=lag.delta_bic - 7.0)
    found = {p.candidate.effect.name: p for p in ranked([lag, coil, cross])}
    assert all(p.verdict == "rejected" for p in found.values())
    assert (
        found["Inductance"].is_any_dynamics and "says as much, but it is short" in found["Inductance"].reason
    )
    assert (
        not found["Crosstalk"].is_any_dynamics and "says more, but it is short" in found["Crosstalk"].reason
    )
    likelier = replace(cross, delta_bic=lag.delta_bic - 5.0)
    assert ranked([lag, likelier])[0].verdict == "supported"


@pytest.mark.parametrize(
    ("explained", "is_known", "verdict"),
    [(0.97, False, "supported"), (0.9, False, "rejected"), (0.97, True, "rejected")],
)
def test_law_beyond_the_recordings_is_not_in_the_way_of_one_that_explains_nearly_all(
    explained, is_known, verdict
):
    constant = replace(law_told("Offset", 40.0, b=(1.0, 0.01)), explained=explained)
    limit = law_told("OneSidedLimit", 90.0, share=(0.01, 0.001), limit=(10.0, 0.5))
    beyond = replace(limit, verdict="rejected", reason="it lies beyond", is_open=True, is_known=is_known)
    found = {p.candidate.effect.name: p for p in ranked([constant, replace(beyond, explained=1.0)])}
    assert found["Offset"].verdict == verdict
    assert not found["Offset"].reason or "but it lies beyond" in found["Offset"].reason


@pytest.mark.parametrize(
    ("reason", "place", "verdict"),
    [
        (f"{reasons.NO_BEND}: it is a gain of 0.911 and an offset of 1.34", "", "supported"),
        (f"{reasons.NO_BEND}: it is a gain of 0.911 and an offset of 1.34", "elsewhere", "rejected"),
        ("it is shaky", "", "rejected"),
    ],
)
def test_law_without_its_bend_is_not_in_the_way_of_the_gain_that_it_is(reason, place, verdict):
    """A thermometer that is off in gain and offset together: a law with two parameters takes both."""
    gain = replace(law_told("Gain", 40.0, g=(-0.05, 0.002)), explained=0.3)
    limit = law_told("Saturation", 90.0, share=(0.1, 0.01), limit=(18.0, 2.0))
    site = replace(limit.candidate.site, name=place or limit.candidate.site.name)
    straight = replace(
        limit,
        candidate=replace(limit.candidate, site=site),
        verdict="rejected",
        reason=reason,
        is_open=True,
        explained=0.8,
    )
    found = {p.candidate.effect.name: p for p in ranked([gain, straight])}
    assert found["Gain"].verdict == verdict


@pytest.mark.parametrize(("error", "verdict"), [(0.5, "rejected"), (0.7, "supported")])
def test_lag_beside_a_short_one_that_simulates_unseen_data_far_better_is_none(error, verdict):
    seen = law_told("Lag", 300.0, T=(2e-2, 1e-3))
    whole = next(iter(seen.told.simulated.values()))
    unseen = replace(seen.told.simulated.get("validation", whole), rms=dict.fromkeys(whole.rms, 1.0))
    lag = replace(seen, final=replace(seen.told, simulated={"validation": unseen}))
    near = replace(unseen, rms=dict.fromkeys(unseen.rms, error))
    short = replace(law_told("Delay", 250.0, T=(2e-2, 1e-3)), verdict="rejected", reason="it is short")
    short = replace(short, is_any_dynamics=True, final=replace(lag.told, simulated={"validation": near}))
    found = {p.candidate.effect.name: p for p in ranked([lag, short])}
    assert found["Lag"].verdict == verdict and not found["Lag"].is_any_dynamics
    assert not found["Lag"].reason or "far better, but it is short" in found["Lag"].reason


@pytest.mark.parametrize(
    ("share", "verdict"), [(0.996, "not separable"), (1.0, "not separable"), (0.9, "rejected")]
)
def test_a_share_that_is_all_of_it_is_no_parameter_beside_other_laws(share, verdict):
    """A limit on one side and a dead zone of which the recording shows one side do the same."""
    zone = law_told("DeadZone", 300.0, width=(1.6, 0.04))
    limit = law_told("OneSidedLimit", 300.2, share=(share, 0.006), limit=(0.01, 0.01))
    assert limit.delta_bic < zone.delta_bic - GATES.same_bic
    found = {p.candidate.effect.name: p.verdict for p in ranked([zone, limit])}
    assert found["OneSidedLimit"] == verdict
    assert found["DeadZone"] == ("supported" if verdict == "rejected" else "not separable")


@pytest.mark.parametrize("why", ["is_any_dynamics", "comes_near"])
@pytest.mark.parametrize(("ahead", "verdict"), [(0.0, "rejected"), (20.0, "supported")])
def test_flexible_part_that_says_no_more_than_a_refused_lag_is_refused(ahead, verdict, why):
    _, friction = proved()
    flexible = pairs(some_effects("FlexibleAppendage"), sites(model()))[0]
    lag = replace(friction, verdict="rejected", reason="it is short", **{why: True})
    rich = replace(
        friction,
        candidate=flexible,
        delta_bic=lag.delta_bic + ahead,
        delta_log_likelihood=friction.delta_log_likelihood * (1.0 + ahead),
    )
    found = next(p for p in ranked([rich, lag]) if p.candidate is flexible)
    assert found.verdict == verdict
    assert not found.reason or found.reason == (
        f"{lag.candidate.label} says as much with fewer parameters, but it is short"
    )
    # One with as few unknowns is no imitation, unless something is late by it as well.
    play = pairs(some_effects("Play"), sites(model()))[0]
    late = next(p for p in ranked([replace(rich, candidate=play), lag]) if p.candidate is play)
    assert late.verdict == verdict
    same = replace(rich, candidate=friction.candidate)
    assert any(p.verdict == "supported" for p in ranked([same, lag]))


@pytest.mark.parametrize(
    ("share", "nearer", "why", "verdict"),
    [
        (0.9, 1.0, "is_any_dynamics", "rejected"),
        (0.7, 1.0, "is_any_dynamics", "supported"),
        (0.9, 0.7, "is_any_dynamics", "supported"),
        (0.9, 1.0, "comes_near", "supported"),
    ],
)
def test_flexible_part_that_gains_little_beyond_a_short_lag_is_refused(share, nearer, why, verdict):
    """A belt that creeps was a part that swings on the motor, though a lag of the table simulates as well."""
    _, friction = proved()
    flexible = pairs(some_effects("FlexibleAppendage"), sites(model()))[0]
    gain = friction.delta_log_likelihood
    lag = replace(friction, verdict="rejected", reason="it is short", **{why: True})
    known = friction.told.simulated["validation"]
    simulated = {"validation": replace(known, rms={y: nearer * e for y, e in known.rms.items()})}
    rich = replace(
        friction,
        candidate=flexible,
        delta_bic=lag.delta_bic + 30.0,
        delta_log_likelihood=gain / share,
        final=replace(friction.told, simulated=simulated),
    )
    found = next(p for p in ranked([rich, lag]) if p.candidate is flexible)
    assert found.verdict == verdict
    much = "says nearly as much with fewer parameters"
    assert not found.reason or found.reason == f"{lag.candidate.label} {much}, but it is short"


@pytest.mark.parametrize(
    ("more", "nearer", "verdict"),
    [(0.01, 1.0, "rejected"), (0.5, 1.0, "supported"), (0.01, 0.7, "supported")],
)
def test_law_that_its_simulation_shows_is_held_against_a_short_lag_by_what_both_gain_beside_loads(
    more, nearer, verdict
):
    """The melt of a furnace whose thermometer is late had a wall with a store of its own: its simulation
    gained far more than the lag beside loads, where it gained as little."""
    _, friction = proved()
    flexible = pairs(some_effects("FlexibleAppendage"), sites(model()))[0]
    lag = replace(friction, verdict="rejected", reason="it is short", is_any_dynamics=True)
    known = friction.told.simulated["validation"]
    simulated = {"validation": replace(known, rms={y: nearer * e for y, e in known.rms.items()})}
    gain = friction.delta_log_likelihood
    shown = replace(
        friction,
        candidate=flexible,
        fit=replace(friction.fit, log_likelihood=friction.fit.log_likelihood + more * gain),
        final=replace(friction.told, simulated=simulated),
        delta_log_likelihood=12.0 * gain,
        delta_bic=24.0 * gain,
        is_by_use=True,
    )
    assert without_imitations([shown, lag])[0].verdict == verdict
    # Of a lag that its simulation shows, too, the gains are of one kind.
    assert without_imitations([shown, replace(lag, is_by_use=True)])[0].verdict == "supported"


@pytest.mark.parametrize(("ahead", "verdict"), [(0.0, "rejected"), (20.0, "supported")])
def test_limit_of_a_rate_that_says_no_more_than_a_lag_whose_time_nobody_knows_is_refused(ahead, verdict):
    """Dry friction beside a flexible part had been a limit of the rate of the input."""
    limit = law_told("RateLimit", 300.0, share=(0.99, 0.02), limit=(1.4, 0.15))
    unknown = "the data determine none of its sizes"
    lag = replace(law_told("Lag", 300.0 - ahead, T=(0.5, 0.21)), verdict="rejected", reason=unknown)
    found = next(p for p in ranked([limit, replace(lag, is_vague=True)]) if p.candidate is limit.candidate)
    assert found.verdict == verdict
    assert not found.reason or found.reason.endswith(f"but {unknown}")
    assert ranked([limit, lag])[0].candidate is limit.candidate
    # A time that is known, though not as well as is asked for, is no better.
    weak = replace(lag, reason=f"{NOT_SIGNIFICANT} (0.5 ± 0.14 s)")
    assert next(p for p in ranked([limit, weak]) if p.candidate is limit.candidate).verdict == verdict
    # What acts at once is no such lag, however unlikely: an offset of a motor's voltage had been refused so.
    offset = law_told("Offset", 280.0, b=(0.5, 0.02))
    found = ranked([offset, replace(lag, is_vague=True)])
    assert next(p for p in found if p.candidate is offset.candidate).verdict == "supported"


@pytest.mark.parametrize(("behind", "is_rival"), [(4.5, True), (5.5, False)])
def test_another_law_that_foresees_unseen_data_as_well_is_a_rival_until_it_is_far_less_likely(
    behind, is_rival
):
    """BIC gains that differ by less than 10 are no very strong evidence (Kass and Raftery 1995)."""
    _, proof = proved()
    other = replace(
        proof,
        candidate=replace(proof.candidate, effect=replace(proof.candidate.effect, class_name="Other")),
        flat=proof.flat,
        delta_log_likelihood=proof.delta_log_likelihood - behind,
        delta_bic=proof.delta_bic - 2.0 * behind,
    )
    assert ranked([other, proof])[0].verdict == ("not separable" if is_rival else "supported")


@pytest.mark.parametrize(("errors", "is_rival"), [((0.73, 1.13), True), ((0.95, 1.13), False)])
def test_another_law_that_foresees_unseen_data_better_in_the_mean_over_the_outputs_is_a_rival(
    errors, is_rival
):
    """Though it foresees one of them worse, and is less likely by what is no very strong evidence."""
    _, proof = proved()

    def with_errors(law, *rms):
        seen = {"validation": Agreement({}, dict(zip(("x", "y"), rms, strict=True)))}
        return replace(law, adds_up=True, ahead=(), final=replace(law.told, simulated=seen))

    other = replace(
        proof,
        candidate=replace(proof.candidate, effect=replace(proof.candidate.effect, class_name="Other")),
        delta_log_likelihood=proof.delta_log_likelihood - 4.5,
        delta_bic=proof.delta_bic - 9.0,
    )
    found = ranked([with_errors(other, *errors), with_errors(proof, 1.0, 1.0)])
    assert found[0].verdict == ("not separable" if is_rival else "supported")


@pytest.mark.parametrize(
    ("behind", "moved", "is_one"), [(0.5, 0.5, True), (0.5, 2.0, False), (3.5, 0.0, False)]
)
def test_one_effect_at_two_places_that_data_hardly_tell_apart_is_one_answer(behind, moved, is_one):
    """With the same estimates: what it is is known, where it is not."""
    _, proof = proved()
    site = replace(proof.candidate.site, name="gear")
    own = set(proof.candidate.estimated)
    fit = replace(
        proof.told,
        parameters=tuple(
            replace(p, value=p.value + moved * np.sqrt(2.0) * p.std_error) if p.name in own else p
            for p in proof.told.parameters
        ),
    )
    other = replace(
        proof,
        candidate=replace(proof.candidate, site=site),
        fit=fit,
        final=fit,
        delta_log_likelihood=proof.delta_log_likelihood - behind,
        delta_bic=proof.delta_bic - 2.0 * behind,
    )
    first, second = ranked([other, proof])
    assert first.verdict == ("supported" if is_one or behind > 3.0 else "not separable")
    assert first.equivalent == ((*proof.equivalent, "gear") if is_one else proof.equivalent)
    assert ("do not tell it from the same effect" in second.reason) == is_one


def test_a_law_shown_by_its_simulation_is_compared_by_that():
    """The gain beside loads of one law says nothing against the gain of another without them."""
    _, proof = proved()
    law = replace(proof.candidate.effect, class_name="Other")
    shown = replace(proof, candidate=replace(proof.candidate, effect=law), is_by_use=True)
    used = InUse(fitted=0.8, unseen=0.8, n_independent=100.0, n_unseen=100.0)
    shown = replace(shown, delta_bic=proof.delta_bic + 100.0, in_use=used)
    better, worse = (replace(proof, in_use=replace(used, fitted=gain, unseen=gain)) for gain in (0.9, 0.6))
    n_own = len(proof.candidate.estimated)
    best, second = better.in_use.bic(n_own), used.bic(n_own)
    assert ranked([shown, better])[0].delta_bic == pytest.approx(best)
    assert ranked([shown, worse])[0].delta_bic == pytest.approx(second)
    assert ranked([replace(shown, verdict="rejected", reason="no"), better])[0].delta_bic == proof.delta_bic
    refused = replace(better, verdict="rejected", reason="it leaves something")
    assert ranked([shown, refused])[0].delta_bic == pytest.approx(second)
    is_open = replace(refused, is_open=True, is_shown=True)
    assert ranked([shown, is_open])[0].delta_bic == pytest.approx(best)
    hardly = replace(is_open, in_use=replace(used, fitted=0.81, unseen=0.81))
    assert [p.delta_bic for p in ranked([shown, hardly]) if p.verdict != "rejected"] == [
        pytest.approx(second)
    ]
    # Errors that last longer count as fewer samples, and are the smaller ones here.
    slow = replace(better, in_use=replace(better.in_use, n_independent=30.0, n_unseen=30.0))
    # Of those that say as much the one that takes more of the load is first.
    alike = replace(shown.candidate, site=replace(shown.candidate.site, name="bearing"), name="alike")
    both = [
        replace(shown, explained=0.02),
        replace(shown, candidate=alike, explained=0.0, in_use=replace(used, fitted=used.fitted + 0.002)),
    ]
    assert [p.explained for p in ranked(both)] == [0.02, 0.0]
    assert ranked(both)[0].delta_bic < ranked(both)[1].delta_bic
    first, last = ranked([shown, slow])
    assert slow.in_use.bic(n_own) < second and slow.in_use.bic(n_own) == pytest.approx(first.delta_bic)
    assert last.delta_bic < first.delta_bic
    # A law that does away with the error of one output of two.
    one = replace(worse, in_use=replace(worse.in_use, apart=(1.2, 1.2)))
    assert ranked([shown, one])[0].candidate is one.candidate


def test_one_equation_under_two_names_is_one_answer():
    _, proof = proved()
    other = replace(
        proof, candidate=replace(proof.candidate, site=replace(proof.candidate.site, name="bearing"))
    )
    first, second = ranked([proof, other])
    assert first.verdict == "supported" and first.not_separable_from == ()
    assert first.same_as == (second.candidate.label,) and second.same_as == ()
    assert second.verdict == "rejected" and "same equation" in second.reason
    another = replace(other.candidate.effect, class_name="Daest.Effects.Rotational.LuGreFriction")
    law = replace(other.candidate, effect=another)
    apart = replace(other, candidate=law, delta_log_likelihood=proof.delta_log_likelihood - 0.5)
    assert [p.verdict for p in ranked([proof, apart])] == ["not separable", "not separable"]
    # Two searches for the same end apart by a share of what they gain.
    gain = proof.delta_log_likelihood
    near = [replace(apart, delta_log_likelihood=gain - share * abs(gain)) for share in (0.0009, 0.0011)]
    assert 0.0009 * gain > 0.05
    assert [ranked([proof, one])[0].verdict for one in near] == ["supported", "not separable"]
    # What is lost needs no second connector.
    between = replace(proof.candidate.effect, connectors=(*proof.candidate.effect.connectors, "flange_b"))
    joined = replace(
        proof, candidate=replace(other.candidate, effect=between), delta_bic=proof.delta_bic + 1e-3
    )
    assert [(p.candidate.site.name, p.verdict) for p in ranked([joined, proof])] == [
        (proof.candidate.site.name, "supported"),
        ("bearing", "rejected"),
    ]
    # Of two with as many of both the linear one.
    line, cube = (
        next(e for e in library() if e.name == name) for name in ("ViscousFriction", "QuadraticDrag")
    )
    assert is_linear_law(line) and not is_linear_law(cube)
    cube = replace(cube, parameters=line.parameters)
    likelier, straight = (
        replace(one, candidate=replace(one.candidate, effect=effect), delta_bic=proof.delta_bic + more)
        for one, effect, more in ((other, cube, 1e-3), (proof, line, 0.0))
    )
    assert ranked([likelier, straight])[0].candidate.effect is line
    # An offset is the name for a dead zone that the recordings never enter, whatever came first.
    more = (*proof.candidate.effect.parameters, proof.candidate.effect.parameters[0])
    richer = replace(
        other,
        candidate=replace(other.candidate, effect=replace(other.candidate.effect, parameters=more)),
        fit=replace(
            other.fit, parameters=(*other.fit.parameters[:-1], replace(other.fit.parameters[-1], value=9.0))
        ),
        delta_log_likelihood=proof.delta_log_likelihood + 0.02,
        delta_bic=proof.delta_bic + 0.04,
    )
    assert [(p.candidate.site.name, p.verdict) for p in ranked([richer, proof])] == [
        (proof.candidate.site.name, "supported"),
        ("bearing", "rejected"),
    ]


def test_sensor_that_is_known_to_clip_is_tried():
    stand = rubbing()
    own = pairs(some_effects("Saturation", "CoulombFriction"), sites(model()))
    (trial,) = clipping_trials(stand.null, own, {"phi": Clip(2.5)})
    assert trial.candidate.effect.name == "Saturation" and trial.candidate.site.name == "phi"
    assert trial.candidate.shape["limit"] == 2.5
    values = {p.name: p.value for p in prepare(stand.null.flat, stand.null.estimated, trial).flat.parameters}
    assert values[f"{trial.candidate.name}.limit"] == 2.5 and values[f"{trial.candidate.name}.share"] > 0.9
    assert clipping_trials(stand.null, own, {}) == ()
    assert clipping_trials(stand.null, own, {"phi": Clip(2.5, is_certain=True)}) == ()


def test_sensor_that_is_certain_to_clip_is_a_part_of_the_model():
    saturation = some_effects("Saturation")
    found = with_clipped_sensors(model(), saturation, {"phi": Clip(2.5, True), "w": Clip(1.0, True)})
    (law,) = found.laws
    assert law.site.name == "phi" and law.shape["limit"] == 2.5
    parameters = {p.name: p for p in found.flat.parameters}
    assert parameters[f"{law.name}.share"].value == 1.0
    assert not any(p.estimate for name, p in parameters.items() if name.startswith(law.name))
    assert with_clipped_sensors(found.flat, saturation, {"phi": Clip(2.5, True)}).laws == ()
    assert with_clipped_sensors(model(), saturation, {"phi": Clip(2.5)}).laws == ()
    assert with_clipped_sensors(model(), (), {"phi": Clip(2.5, True)}).laws == ()


def test_clipping_sensors_are_seen_in_the_recordings():
    rng = np.random.default_rng(0)
    time = 0.05 * np.arange(2000)
    y = np.column_stack([3.0 * np.sin(0.9 * time), np.cos(0.9 * time)]) + 0.02 * rng.standard_normal(
        (2000, 2)
    )
    smooth = np.minimum(3.0 * np.sin(0.9 * time), 2.5)
    y[:, 0] = np.minimum(y[:, 0], 2.5)
    u = np.zeros((2000, 1))
    noisy = Experiment("noisy", time, u, y, ("u",), ("phi", "w"))
    assert clips_of([noisy]) == {"phi": Clip(2.5, is_certain=True)}
    # An end stop looks the same where no noise is seen.
    still = Experiment("still", time, u, smooth[:, None], ("u",), ("phi",))
    assert clips_of([still]) == {"phi": Clip(2.5)}
    # Noise and steps as coarse as it spread what is cut over two levels: the sensor is tried, no more.
    rng = np.random.default_rng(3)
    true = np.clip(2.0 + 0.9 * np.sin(0.9 * time) + 0.3 * np.sin(2.3 * time), 0.0, 2.7)
    read = np.minimum(true + 0.015 * rng.standard_normal(time.size), 2.7)
    steps = replace(still, outputs=0.03 * np.round(read / 0.03)[:, None])
    assert clips_of([steps]) == {"phi": Clip(pytest.approx(2.7))}
    free = 2.0 + 0.9 * np.sin(0.9 * time) + 0.3 * np.sin(2.3 * time) + 0.015 * rng.standard_normal(time.size)
    assert clips_of([replace(still, outputs=0.03 * np.round(free / 0.03)[:, None])]) == {}
    # A switch, and a record of a few samples, tell of no limit.
    switch = replace(still, outputs=np.where(np.sin(time) > 0.0, 2.5, -2.5)[:, None])
    constant = replace(still, outputs=np.full((2000, 1), 2.5))
    assert clips_of([switch]) == clips_of([constant]) == {}
    assert DiagnoseOptions().clips([noisy]) == clips_of([noisy])
    assert DiagnoseOptions(clipped={}).clips([noisy]) == {}


def test_sensor_that_comes_to_its_limit_once_in_each_recording_is_seen_in_all_of_them():
    time = 0.05 * np.arange(2000)
    y = 3.0 * np.sin(2 * np.pi * time / 100.0) + 0.004 * np.random.default_rng(1).standard_normal(2000)
    whole = Experiment("run", time, np.zeros((2000, 1)), np.minimum(y, 0.8)[:, None], ("u",), ("phi",))
    again = replace(whole, time=time + 100.0)
    assert clips_of([whole]) == {} and clips_of([whole, again]) == {"phi": Clip(0.8, is_certain=True)}


def test_law_of_which_nothing_is_known_is_out_of_the_way_where_its_form_is_not_seen(monkeypatch):
    """A relaxation over days in a recording of minutes is an integral, and that a constant load."""
    said = "the recordings show too little of its form"
    vague = "the data determine none of its parameters"
    monkeypatch.setattr(proving, "not_determined", lambda *_, **__: vague)
    _, vague = proved.__wrapped__()
    monkeypatch.setattr(proving, "without_form", lambda *given: said)
    _, formless = proved.__wrapped__()
    assert vague.is_vague and not vague.is_open
    assert formless.reason == said and not formless.is_vague and not formless.is_open
    assert not formless.is_known


def test_what_lasts_as_long_as_the_unseen_data_is_not_known_by_them(monkeypatch):
    """Most of what a dead time does there was before they began, and that may follow any transient."""
    asked = []

    def slow(experiments, *given):
        asked.append(tuple(experiments))
        return "too long"

    monkeypatch.setattr(proving, "too_slow", slow)
    _, proof = proved.__wrapped__()
    assert not proof.is_known and proof.verdict == "supported"
    assert asked == [tuple(rubbing().validation)]


def test_store_of_no_size_is_not_known_by_the_time_in_which_its_own_start_dies_out():
    """A wall that takes no heat and begins at a million degrees is a load that decays."""
    _, proof = proved()
    wall = replace(proof.candidate, effect=find_effect("Thermal.ExtraHeatCapacity"))
    of = next(p for p in proof.fit.parameters if p.name.startswith(f"{proof.candidate.name}."))

    def told(size, std_error):
        values = {"G": (size, std_error), "T": (1.7e5, 3.8e4)}
        own = (
            replace(of, name=f"{wall.name}.{name}", value=value, std_error=error, unit="")
            for name, (value, error) in values.items()
        )
        return replace(proof.fit, parameters=tuple(own), correlation_names=(), correlation=np.zeros((0, 0)))

    assert not_determined(wall, told(0.5, 0.05), proof.fit) == ""
    assert "none of its sizes (G = 5.9e-07 ± 0.25)" in not_determined(wall, told(5.9e-7, 0.25), proof.fit)


def test_law_of_which_nothing_is_known_is_no_finding():
    _, proof = proved()
    own = f"{proof.candidate.name}.tau_c"

    def told(**changes):
        fit = proof.fit
        parameters = [replace(p, **changes) if p.name == own else p for p in fit.parameters]
        return replace(fit, parameters=tuple(parameters))

    assert not_determined(proof.candidate, proof.fit, proof.fit) == ""
    assert not_determined(proof.candidate, told(at_bound="max", std_error=None), proof.fit) == ""
    vague = not_determined(proof.candidate, told(value=0.15, std_error=0.06), proof.fit)
    assert vague == "the data determine none of its parameters (tau_c = 0.15 ± 0.06 N.m)"
    unknown = not_determined(proof.candidate, told(value=0.15, std_error=None), proof.fit)
    assert "tau_c = 0.15 N.m" in unknown
    # One parameter that is known is enough: a level from which a law acts, say.
    rich = next(e for e in some_effects("StribeckFriction"))
    size = next(p for p in proof.fit.parameters if p.name == own)
    shapes = (replace(size, name=f"{proof.candidate.name}.w_st", value=0.1, std_error=0.01),)
    vaguer = replace(proof.fit, parameters=(replace(size, std_error=None), *shapes))
    assert not_determined(replace(proof.candidate, effect=rich), vaguer, proof.fit) == ""


@pytest.mark.parametrize(
    ("name", "limit", "is_known"),
    [
        ("RateLimit", (0.15, 0.071), False),
        ("RateLimit", (0.15, 0.01), True),
        ("Saturation", (0.9, 0.5), False),
        ("Saturation", (0.9, 0.1), True),
        ("Saturation", (0.01, 0.1), True),  # a place at nothing, seen within the reach of the signal
    ],
)
def test_share_of_what_lies_beyond_an_unknown_limit_is_no_size(name, limit, is_known):
    _, proof = proved()
    law = next(c for c in pairs(some_effects(name), sites(model())) if c.site.kind == "input")
    rounded = {p.name: p.grid[0] for p in law.effect.parameters if p.role == "sharpness"}  # a reach of 1
    law = replace(law, shape=rounded)
    one = replace(proof.fit.parameters[-1], at_bound="", min=0.0)
    share = replace(one, name=f"{law.name}.share", value=1.0, std_error=None, at_bound="max")
    own = replace(one, name=f"{law.name}.limit", value=limit[0], std_error=limit[1])
    fit = replace(proof.fit, parameters=(share, own))
    said = not_determined(law, fit, proof.fit)
    assert said.startswith("the data do not determine its amount (limit = ") != is_known
    assert bool(said) != is_known


def test_torque_is_known_by_its_ratio_where_no_sensor_tells_the_scale_of_all_torques():
    """tau_c = 0.15 ± 0.06 N.m and J within the same 40 %, their ratio within 6 %: there is friction."""
    _, proof = proved()
    own, candidate = f"{proof.candidate.name}.tau_c", proof.candidate

    def told(correlation, **changes):
        fit = proof.fit
        J = next(p for p in fit.parameters if p.name == "J")
        vague = {own: {"value": 0.15, "std_error": 0.06}, "J": {"std_error": 0.4 * J.value, "min": 0.0}}
        parameters = tuple(replace(p, **(vague.get(p.name, {}) | changes)) for p in fit.parameters)
        i, j = (fit.correlation_names.index(name) for name in (own, "J"))
        known = np.eye(len(fit.correlation_names))
        known[i, j] = known[j, i] = correlation
        return replace(fit, parameters=parameters, correlation=known)

    vague = told(0.0)

    def certainty(fit, effect=candidate.effect, before=vague):
        parameter = next(p for p in fit.parameters if p.name == own)
        return certainty_of(replace(candidate, effect=effect), fit, parameter, effect.sizes[0], before)

    assert certainty(told(0.99)) == pytest.approx(1.0 / (0.4 * np.sqrt(2.0 * 0.01)))
    assert not_determined(candidate, told(0.99), vague) == ""
    # Nothing in common, or with a parameter that may vanish: the size stands for itself.
    assert certainty(told(0.0)) == pytest.approx(2.5)
    assert certainty(told(0.99, min=None)) == pytest.approx(2.5)
    assert "tau_c = 0.15 ± 0.06 N.m" in not_determined(candidate, told(0.0), vague)
    # A lag that is long beside another time is no longer for that.
    assert certainty(told(0.99), replace(candidate.effect, is_dynamic=True)) == pytest.approx(2.5)
    # Where J was known before, the law only shares with it what was its own.
    sharp = proof.fit
    assert certainty(told(0.99), before=sharp) == pytest.approx(2.5)
    # What bends a signal is there where its product with a gain is known: a thrust may be all of the square.
    bend = replace(candidate.effect.sizes[0], signal_unit="1/u")
    bent = replace(candidate.effect, parameters=(bend,))
    assert certainty(told(-0.99), bent, sharp) == pytest.approx(1.0 / (0.4 * np.sqrt(2.0 * 0.01)))
    assert certainty(told(-0.99, min=None), bent, sharp) == pytest.approx(1.0 / (0.4 * np.sqrt(2.0 * 0.01)))
    assert certainty(told(0.99), bent, sharp) == pytest.approx(2.5)
    assert "tau_c = 0.15 ± 0.06 N.m" in not_determined(candidate, told(0.99), sharp)

    # What is known is told: the product, or the ratio, with its unit and its error.
    (product,) = known_products(replace(candidate, effect=bent), told(-0.99))
    J = proof.fit.theta["J"]
    assert (product.name, product.unit) == ("tau_c*J", "N.m3.kg")
    assert product.value == pytest.approx(0.15 * J)
    assert product.std_error == pytest.approx(0.15 * J * 0.4 * np.sqrt(2.0 * 0.01))
    (ratio,) = known_products(candidate, told(0.99))
    assert (ratio.name, ratio.value) == ("tau_c/J", pytest.approx(0.15 / J))
    assert known_products(candidate, told(0.0)) == ()
    said = told_values(replace(proof, fit=told(0.99), final=None))
    assert said.startswith("tau_c = 0.15 ± 0.06 N.m, tau_c/J = ")


def test_product_is_known_where_size_and_gain_lie_far_apart_in_two_fits():
    """A bend without a slope: a and the gain k run along a valley, a = -0.1 or 1.8, a*k = 0.0012 in both."""
    _, proof = proved()
    candidate = proof.candidate
    bend = replace(candidate.effect.sizes[0], signal_unit="1/u")
    bent = replace(candidate, effect=replace(candidate.effect, parameters=(bend,)))
    one = next(p for p in proof.fit.parameters if p.name == "J")
    own, k = f"{candidate.name}.{bend.name}", "J"
    beside = {own: 1.8, k: 0.00125 / 1.8}

    def told(share, product=0.00125):
        choice = Choice({**beside, k: product / 1.8}, share)
        raw = replace(one, name=own, value=-0.1, std_error=0.15), replace(one, value=-0.012, std_error=0.018)
        widened = (replace(p, std_error=float(np.hypot(p.std_error, choice.of(p))), min=None) for p in raw)
        turned = np.array([[1.0, -0.9999], [-0.9999, 1.0]])
        return replace(
            proof.fit,
            parameters=tuple(widened),
            correlation_names=(own, k),
            correlation=turned,
            choice=choice,
        )

    (alone,) = known_products(bent, told(0.0))
    assert alone.value == pytest.approx(0.0012)
    assert alone.std_error == pytest.approx(0.0012 * 1.5 * np.sqrt(2e-4))
    (known,) = known_products(bent, told(0.3))
    assert known.std_error == pytest.approx(np.hypot(alone.std_error, 0.3 * 5e-5), rel=1e-6)
    assert known_products(bent, told(0.3, product=0.004)) == ()
    assert not_determined(bent, told(0.3), proof.fit) == ""
    assert not_determined(bent, told(0.3, product=0.004), proof.fit) != ""
    # A ratio to a scale that the other fit has at nothing says nothing.
    ratio = replace(candidate, effect=replace(candidate.effect, parameters=(replace(bend, signal_unit=""),)))
    lost = replace(told(0.3), choice=Choice({own: 1.8, k: 0.0}, 0.3))
    (size, scale) = lost.parameters
    scale = replace(scale, value=0.012, min=0.0)
    assert known_products(ratio, replace(lost, parameters=(size, scale))) == ()


def test_of_two_equal_lags_the_likelihood_tells():
    """0.15 ± 0.06 s twice, their product within 6 %: nobody knows which is which, and both are there."""
    _, proof = proved()
    own = f"{proof.candidate.name}.tau_c"
    lag = replace(proof.candidate, effect=replace(proof.candidate.effect, is_dynamic=True))

    def told(second, unit="N.m", correlation=-0.99):
        fit = proof.fit
        values = {own: {"value": 0.15, "std_error": 0.06}}
        values["J"] = {"value": second, "std_error": 0.4 * second, "min": 0.0, "unit": unit}
        parameters = tuple(replace(p, **values.get(p.name, {})) for p in fit.parameters)
        i, j = (fit.correlation_names.index(name) for name in (own, "J"))
        known = np.eye(len(fit.correlation_names))
        known[i, j] = known[j, i] = correlation
        return replace(fit, parameters=parameters, correlation=known)

    def certainty(fit, gain=50.0):
        parameter = next(p for p in fit.parameters if p.name == own)
        return certainty_of(lag, fit, parameter, lag.effect.sizes[0], proof.fit, gain)

    assert certainty(told(0.16)) == pytest.approx(10.0)
    assert not_determined(lag, told(0.16), proof.fit, gain=50.0) == ""
    # Beside unknown loads the likelihood may be sure of what the estimates that are told leave open.
    loose = told(0.16, correlation=-0.7)  # the product within 31 %, 3.2 standard errors off zero
    assert certainty(loose) == pytest.approx(2.5)
    assert not_determined(lag, loose, proof.fit, gain=50.0) != ""
    # Their sum may be all that is known, which fixes the product of equal ones besides: one lag would do.
    assert certainty(told(0.16), gain=2.0) == pytest.approx(2.5)
    assert not_determined(lag, told(0.16), proof.fit, gain=2.0) != ""
    (product,) = known_products(lag, told(0.16))
    assert (product.name, product.unit, product.value) == ("tau_c*J", "N2.m2", pytest.approx(0.024))
    # Times that are told apart do not change places, nor does a time with what is none.
    assert certainty(told(0.6)) == pytest.approx(2.5)
    assert certainty(told(0.16, "kg.m2")) == pytest.approx(2.5)


def test_a_place_or_a_phase_is_not_known_by_being_off_zero():
    """A weight of 1.3 ± 4.1 N.m half a turn round, and a rim at 120 ± 18 kPa over which anything flows."""
    _, proof = proved()
    size = next(p for p in proof.fit.parameters if p.name.startswith(proof.candidate.name))

    def unknown(effect_name, least=GATES.min_place_significance, **values):
        effect = next(e for e in library() if e.name == effect_name)
        candidate = replace(proof.candidate, effect=effect)
        own = [
            replace(size, name=f"{candidate.name}.{name}", value=value, std_error=error, at_bound=None)
            for name, (value, error) in values.items()
        ]
        return not_determined(candidate, replace(proof.fit, parameters=tuple(own)), proof.fit, least)

    assert "mgr = 1.3" in unknown("Unbalance", mgr=(1.3, 4.1), phi_0=(3.07, 0.23))
    assert unknown("Unbalance", mgr=(1.3, 0.1), phi_0=(3.07, 0.23)) == ""
    swing = {"J": (2.4, 3.9), "T": (57.0, 88.0), "zeta": (0.58, 0.11)}
    assert "zeta" not in unknown("FlexibleAppendage", **swing) != ""
    assert unknown("FlexibleAppendage", **{**swing, "T": (57.0, 2.0)}) == ""
    assert "p_max" in unknown("Overflow", k=(6.4, 4e5), p_max=(1.2e5, 1.8e4))
    assert unknown("Overflow", k=(6.4, 4e5), p_max=(4.9e4, 80.0)) == ""
    shown = GATES.min_significance  # where a simulation that is better by more than chance speaks for the law
    assert unknown("Overflow", shown, k=(6.4, 4e5), p_max=(1.2e5, 1.8e4)) == ""
    assert "p_max" in unknown("Overflow", shown, k=(6.4, 4e5), p_max=(1.2e5, 9e4))


def test_the_stop_that_is_never_reached_is_told_as_that():
    _, proof = proved()
    size = next(p for p in proof.fit.parameters if p.name.startswith(proof.candidate.name))
    stops = replace(proof.candidate, effect=next(e for e in library() if e.name == "EndStop"))
    values = {"c": (3e5, 4e3), "phi_max": (0.22, 1e-4), "phi_min": (-4.4e8, 6.4e8)}
    own = tuple(
        replace(size, name=f"{stops.name}.{name}", value=value, std_error=error, unit="rad")
        for name, (value, error) in values.items()
    )
    fit = replace(proof.fit, parameters=own)
    said = told_values(replace(proof, candidate=stops, fit=fit, final=None))
    assert "phi_max = 0.22" in said and said.endswith("phi_min not reached")


@pytest.mark.parametrize(
    ("name", "places", "is_told"),
    [
        ("EndStop", {"phi_max": 0.22, "phi_min": -0.3}, True),
        (
            "EndStop",
            {"phi_max": 0.5, "phi_min": 0.3},
            True,
        ),  # both on one side of where the angle counts from
        ("EndStop", {"phi_max": 0.22, "phi_min": -4.4e8}, True),  # never reached
        ("EndStop", {"phi_max": -13.2, "phi_min": 12.7}, False),  # of a motor behind its controller: a spring
        ("OneSidedLimit", {"limit": -1.0}, True),
    ],
)
def test_stops_without_room_between_them_are_none(name, places, is_told):
    effect = next(e for e in library() if e.name == name)
    law = SimpleNamespace(effect=effect, name="stop")
    told = SimpleNamespace(theta={f"stop.{place}": value for place, value in places.items()})
    said = reasons.crossed(law, told)
    assert (said == "") is is_told, said
    assert is_told or "phi_max (-13.2) lies below its phi_min (12.7)" in said


def test_a_place_near_nothing_is_told_where_the_recordings_reach_far_beyond_it():
    _, proof = proved()
    size = next(p for p in proof.fit.parameters if p.name.startswith(proof.candidate.name))
    effect = next(e for e in library() if e.name == "OneSidedLimit")
    drain = replace(proof.candidate, effect=effect, shape={"u_s": 9e-5})  # of 0.009 m/d that are drained
    values = {"share": (0.98, 0.012), "limit": (-2.5e-4, 3.9e-4)}
    own = tuple(
        replace(size, name=f"{drain.name}.{name}", value=value, std_error=error, unit="m/d")
        for name, (value, error) in values.items()
    )
    near = replace(proof, candidate=drain, fit=replace(proof.fit, parameters=own), final=None)
    assert "limit = -0.00025 ± 0.00039 m/d" in told_values(near)
    anywhere = replace(own[1], std_error=0.02)
    far = replace(near, fit=replace(proof.fit, parameters=(own[0], anywhere)))
    assert told_values(far).endswith("limit not reached")


def test_how_often_a_law_repeats_is_told_where_it_was_counted():
    _, proof = proved()
    cogging = next(e for e in library() if e.name == "CoggingTorque")
    counted = replace(proof.candidate, effect=cogging, shape={"n": 18.0})
    assert told_values(replace(proof, candidate=counted)).endswith("n = 18")


def test_parameter_that_is_lost_beside_loads_is_found_again():
    prepared, proof = proved()
    assert proof.final is not None and from_simulation(prepared, proof) is None
    theta = {**proof.fit.theta, "J": 1e-5 * proof.fit.theta["J"]}
    known = replace(prepared, explicit=prepared.reduced())
    again = from_simulation(known, replace(proof, fit=replace(proof.fit, theta=theta)))
    assert again is not None and again.names == prepared.names and again.explicit is None
    values = {p.name: p.value for p in again.flat.parameters}
    assert {name: values[name] for name in again.names} == pytest.approx(
        {name: proof.final.theta[name] for name in again.names}
    )
    # A refit that has ended below the estimates without loads, which it contains, has stopped on its way.
    below = replace(proof.fit, log_likelihood=proof.final.log_likelihood - 50.0)
    calm = from_simulation(known, replace(proof, fit=below))
    assert calm is not None and calm.simulation is proof.final


def test_sensor_is_tried_near_its_full_size_from_where_the_user_began():
    stand = rubbing()
    own = pairs(some_effects("Saturation", "CoulombFriction"), sites(model()))
    (cut,) = clipping_trials(stand.null, own, {"phi": Clip(2.5)})
    made = [one() for one in at_full_size(stand.null, prepare(stand.null.flat, stand.null.estimated, cut))]
    values = [{p.name: p.value for p in one.flat.parameters} for one in made]
    name = cut.candidate.name
    assert [v[f"{name}.share"] for v in values] == pytest.approx([0.9, 0.99])
    assert values[0][f"{name}.u_s"] > values[1][f"{name}.u_s"], "wide kinks first"
    begun = {p.name: p.initial for p in stand.null.fit.parameters}
    assert values[0]["J"] == begun["J"]
    assert at_full_size(stand.null, proved()[0]) == (), "friction is no sensor"


def test_law_of_a_simulation_is_none_beside_one_that_the_loads_leave_far_likelier():
    """A dead zone that simulates a little better than a sensor without sign, far likelier beside loads."""
    _, proof = proved()
    used = InUse(fitted=0.6, unseen=0.9, n_independent=40.0, n_unseen=30.0, certainty=3.0)
    poor = replace(proof.fit, log_likelihood=proof.fit.log_likelihood - 200.0)
    name = replace(proof.candidate, name="effect_other")
    bent = replace(proof, candidate=name, fit=poor, in_use=used, is_by_use=True, is_shown=True)
    first, second = ranked([bent, proof])
    assert first.verdict == "supported" and not first.is_by_use
    assert second.verdict == "rejected" and "far better" in second.reason
    near = replace(bent, fit=replace(poor, log_likelihood=proof.fit.log_likelihood - 20.0))
    little = replace(used, fitted=0.05, unseen=0.05, certainty=0.5)
    assert ranked([near, replace(proof, in_use=little)])[0].candidate is name, "much may go into the loads"


@pytest.mark.parametrize(("behind", "n_told"), [(0.0, 1), (23.0, 2)])
def test_law_of_a_simulation_is_not_alone_where_predictions_speak_for_another_by_more(behind, n_told):
    """A free outlet simulates two tanks, of which a conductance drifts, a little better than the dead zone of
    their pump, a constant flow, and is far less likely beside loads."""
    _, proof = proved()
    used = InUse(fitted=2.65, unseen=1.67, n_independent=38.0, n_unseen=23.3, certainty=6.9)
    flow = replace(proof, in_use=used, is_by_use=True, adds_up=False, ahead=(), equivalent=())
    outlet = replace(
        flow,
        candidate=replace(
            flow.candidate, name="effect_other", site=replace(flow.candidate.site, name="other")
        ),
        fit=replace(flow.fit, log_likelihood=flow.fit.log_likelihood - behind),
        in_use=replace(used, fitted=2.88, unseen=2.0),
    )
    found = [p for p in ranked([outlet, flow]) if p.verdict != "rejected"]
    assert found[0].candidate is outlet.candidate and len(found) == n_told


@pytest.mark.parametrize(
    ("behind", "error", "verdict"), [(15.0, 2.0, "rejected"), (5.0, 2.0, ""), (15.0, 1.05, "")]
)
def test_law_of_a_simulation_is_none_beside_one_that_is_better_both_ways(behind, error, verdict):
    """The lag of a sensor with twice the noise of it, beside what a resistance lacks: gains of two kinds."""
    _, proof = proved()
    used = InUse(fitted=2.0, unseen=2.0, n_independent=400.0, n_unseen=400.0, certainty=9.0)
    told = {
        part: replace(one, rms={name: error * rms for name, rms in one.rms.items()})
        for part, one in proof.told.simulated.items()
    }
    lag = replace(
        proof,
        candidate=replace(proof.candidate, name="effect_other"),
        fit=replace(proof.fit, log_likelihood=proof.fit.log_likelihood - behind),
        final=replace(proof.told, simulated=told),
        in_use=used,
        is_by_use=True,
    )
    found = next(p for p in ranked([lag, replace(proof, in_use=InUse())]) if p.candidate is lag.candidate)
    assert ("simulates unseen data better" in found.reason) == bool(verdict)


@pytest.mark.parametrize(("share", "verdict"), [(0.05, "supported"), (300.0, "rejected")])
def test_law_of_a_simulation_that_leaves_all_its_parameters_open_is_none(monkeypatch, share, verdict):
    """A wall of hardly any conductance and any time constant simulates a part of a day better."""
    stand, (prepared, beside) = rubbing(), proved()
    used = InUse(fitted=0.6, unseen=0.9, n_independent=40.0, n_unseen=30.0, certainty=5.0)
    monkeypatch.setattr(proving, "used_by", lambda *_: used)
    monkeypatch.setattr(proving, "weak", lambda *_: "")
    own = f"{prepared.trial.candidate.name}."
    parameters = tuple(
        replace(p, std_error=share * p.value) if p.name.startswith(own) else p
        for p in beside.final.parameters
    )
    found = replace(beside.final, parameters=parameters)
    refused = replace(beside, verdict="rejected", reason="open")
    shown = proving.by_simulation(stand.null, prepared, refused, found, stand.validation, stand.reference, 1)
    assert shown.verdict == verdict


def test_a_lag_that_its_simulation_shows_refuses_no_other_law(monkeypatch):
    """What came near beside loads, and is accepted without them, stands beside others as they are; what any
    lag as short would do is no more certain in a simulation."""
    stand, (prepared, beside) = rubbing(), proved()
    used = InUse(fitted=0.6, unseen=0.9, n_independent=40.0, n_unseen=30.0, certainty=5.0)
    monkeypatch.setattr(proving, "used_by", lambda *_: used)
    monkeypatch.setattr(proving, "weak", lambda *_: "")

    def shown(**why):
        refused = replace(beside, verdict="rejected", reason="it leaves something dynamic", **why)
        given = (prepared, refused, beside.final, stand.validation, stand.reference, 1)
        return proving.by_simulation(stand.null, *given)

    lag = shown(comes_near=True)
    assert lag.verdict == "supported" and not lag.comes_near and not lag.inside
    monkeypatch.setattr(proving, "same_in_machine", lambda *_: "the machine before it")
    assert shown().inside == "the machine before it"  # of a sensor, as beside loads
    short = shown(is_any_dynamics=True)
    assert short.verdict == "rejected" and short.is_any_dynamics


@pytest.mark.parametrize(("unseen", "verdict"), [(0.4, "rejected"), (0.9, "supported")])
def test_part_of_another_law_is_not_shown_by_a_simulation_that_it_leaves_most_of(
    monkeypatch, unseen, verdict
):
    """A detent at one place, read as cogging: 15 % of the error, by more than chance."""
    stand, (prepared, beside) = rubbing(), proved()
    used = InUse(fitted=0.6, unseen=unseen, n_independent=40.0, n_unseen=30.0, certainty=5.0)
    monkeypatch.setattr(proving, "used_by", lambda *_: used)
    monkeypatch.setattr(proving, "weak", lambda *_: "")
    refused = replace(beside, verdict="rejected", reason="another law acts there", is_other_law=True)
    given = (prepared, refused, beside.final, stand.validation, stand.reference, 1)
    assert proving.by_simulation(stand.null, *given).verdict == verdict


@pytest.mark.parametrize(("ratio", "is_refused"), [(0.9, False), (1.1, True), (None, False)])
def test_drift_must_drift_beside_a_constant_load_of_each_recording(monkeypatch, ratio, is_refused):
    """What simulates unseen data better since they are at another level is no drift."""
    stand = rubbing()
    reference = replace(stand.reference, adds_up=False)
    (effect,) = some_effects("Drift")
    (site,) = [s for s in sites(model()) if s.kind == "output"]
    drifting = attach(stand.null.flat, effect, site, "drift", {"r": 0.01})
    monkeypatch.setattr(proving, "_steady_ratio", lambda *_: ratio)

    def reason(flat):
        own = SimpleNamespace(flat=flat)
        return proving._of_levels(
            stand.null, own, stand.null.explicit, stand.told, stand.validation, reference
        )

    assert ("another level" in reason(drifting)) == is_refused
    assert not reason(proved()[0].flat), "friction knows no time"


def test_what_a_drift_foresees_is_no_evidence_where_errors_add_up():
    """The unseen half of a ramp lies at another level, and any drift goes there."""
    stand = rubbing()
    (effect,) = some_effects("Drift")
    (site,) = [s for s in sites(model()) if s.kind == "output"]
    drifting = SimpleNamespace(flat=attach(stand.null.flat, effect, site, "drift", {"r": 0.01}))
    counting, holding = (replace(stand.reference, adds_up=adds_up) for adds_up in (True, False))
    assert proving._is_any_level(stand.null, drifting, counting)
    assert not proving._is_any_level(stand.null, drifting, holding), "its level is asked of the simulation"
    assert not proving._is_any_level(stand.null, proved()[0], counting), "friction knows no time"
    assert not proving._is_any_level(stand.null, drifting, None)


def test_law_that_says_all_of_a_curve_may_leave_a_smaller_effect():
    points = np.zeros(2)
    left = FreeForm(0, "rotor.flange", "rotor.w", "", "N.m", "rad/s", 44.0, 4, 1e-5, points, points, points)
    assert left.log_likelihood_gain == 20.0
    assert not _is_much_left(left, 220.0), "friction beside a sensor without sign"
    assert _is_much_left(left, 40.0)
    assert not _is_much_left(replace(left, p_value=0.1), 40.0)


def test_without_a_load_everything_is_explained():
    stand, (prepared, _) = rubbing(), proved()
    run = run_null(stand.null)
    proof = prove(stand.null, stand.baseline, prepared, stand.null.experiments, stand.validation, run, None)
    assert proof.explained == 1.0 and proof.left is not None


def test_sizes_start_off_their_bounds():
    assert _inside(-0.5, 0.0, None) == pytest.approx(0.05)
    assert _inside(0.0, 0.0, None) > 0.0
    assert _inside(2.0, None, 1.0) < 1.0
    assert _inside(0.3, 0.0, 1.0) == 0.3


def test_kinks_are_sharper_in_the_proof_than_in_the_screen():
    stand = rubbing()
    candidate = next(
        t.candidate for t in trials(screened(), 1.0, 5) if t.candidate.effect.name == "CoulombFriction"
    )
    prepared = prepare(stand.null.flat, stand.null.estimated, Trial(candidate, (-0.2,), ()))
    values = {p.name: p.value for p in prepared.flat.parameters}
    assert values[f"{candidate.name}.w_s"] == pytest.approx(0.3 * candidate.shape["w_s"])
    assert values[f"{candidate.name}.tau_c"] > 0.0


@cache
def misread():
    """Friction that depends on the angle, read as Coulomb friction."""
    record, _ = rotor_record(2000, seed=12, coulomb=lambda phi: 0.2 * (1.0 + 0.8 * np.sin(phi)))
    stand = begin(model(), [record], (), DiagnoseOptions(hold="zoh"))
    run = run_null(stand.null)
    load = smoothed_load(stand.null, run, place_gains(stand.null, run))
    found = screen(stand.null, run, pairs(some_effects("CoulombFriction"), sites(model())))
    prepared = prepare(stand.null.flat, stand.null.estimated, trials(found, 1.0, 1)[0])
    return stand, run, prepared, prove(
        stand.null, stand.baseline, prepared, stand.null.experiments, stand.validation, run, load,
        reference=stand.reference,
    )  # fmt: skip


@pytest.mark.slow
def test_law_that_leaves_a_curve_which_would_say_all_is_refused(monkeypatch):
    stand, run, prepared, proof = misread()
    assert proof.delta_bic > 20.0, "Coulomb friction looks very likely"
    assert proof.verdict == "rejected"
    fit = proof.fit
    after = grown(stand.null, prepared.flat, reduce_index(prepared.flat), fit, stand.null.experiments)
    left = free_forms(after, run_null(after), ["rotor.phi", "rotor.w", "u"])[0]
    assert left.label == "rotor.phi and the sign of rotor.w"
    assert "still follows rotor.phi" in wrong_law(
        stand.null, run, prepared, fit, proof.delta_log_likelihood, left
    )
    # A small rest is how a law is rounded.
    assert wrong_law(stand.null, run, prepared, fit, 100.0 * left.log_likelihood_gain, left) == ""
    # A curve over one variable is right in the main where it says most of what is missing.
    alone, gain = replace(left, sign_of=""), 1.5 * left.log_likelihood_gain
    monkeypatch.setattr(reasons, "covers", lambda *_: 0.9)
    assert wrong_law(stand.null, run, prepared, fit, gain, alone) == ""
    assert wrong_law(stand.null, run, prepared, fit, gain, alone, says_most=False)


@pytest.mark.parametrize(("speed", "first"), [(0.008, "CoulombFriction"), (0.03, "StribeckFriction")])
def test_bump_of_friction_within_what_its_sign_is_rounded_over_is_how_the_sign_is(speed, first):
    """Friction that sticks is steeper than a rounded sign: a bump that is as narrow makes it so."""
    _, simple = proved()
    (effect,) = some_effects("StribeckFriction")
    own = {f"{simple.candidate.name}.{name}": value for name, value in (("w_st", speed), ("w_s", 0.01))}
    fit = replace(simple.told, theta={**simple.told.theta, **own})
    rich = replace(
        simple,
        candidate=replace(simple.candidate, effect=effect),
        fit=fit,
        final=fit,
        delta_log_likelihood=1.2 * simple.delta_log_likelihood,
        delta_bic=1.2 * simple.delta_bic,
    )
    found = ranked([rich, simple])
    assert [p.verdict for p in found] == ["supported", "rejected"]
    assert found[0].candidate.effect.name == first
    refused = ranked([rich, replace(simple, verdict="rejected", reason="unseen data are foreseen worse")])
    assert [p.verdict for p in refused] == (
        ["not separable"] * 2 if first == "CoulombFriction" else ["supported", "rejected"]
    )
    less = replace(simple, delta_log_likelihood=0.6 * rich.delta_log_likelihood)
    assert [p.verdict for p in ranked([rich, less])] == [p.verdict for p in refused]
    # Nor does the other end the search for the simple law because that is far less likely.
    assert np.isinf(least_hope(rich, simple.candidate)) == (first == "CoulombFriction")


def test_curve_over_another_variable_does_not_cover_the_law():
    stand, run, prepared, proof = misread()
    response = law_response(stand.null, run, prepared.trial.candidate, proof.fit.theta)
    forms = {f.label: f for f in free_forms(stand.null, run)}
    assert covers(stand.null, run, forms["rotor.phi and the sign of rotor.w"], response) > 0.9
    assert covers(stand.null, run, forms["rotor.phi"], response) < 0.3


def test_law_with_fewer_parameters_is_preferred_when_it_says_as_much():
    _, simple = proved()
    more = (*simple.fit.parameters, simple.fit.parameters[0])
    rich = replace(
        simple,
        fit=replace(simple.fit, parameters=more),
        delta_log_likelihood=1.01 * simple.delta_log_likelihood,
        delta_bic=simple.delta_bic + 20.0,
    )
    first, second = ranked([rich, simple])
    assert first.candidate == simple.candidate and len(first.fit.parameters) < len(more)
    assert first.verdict == "supported"
    assert second.verdict == "rejected" and "nearly as much with fewer parameters" in second.reason
    better = replace(rich, delta_log_likelihood=1.2 * simple.delta_log_likelihood)
    assert len(ranked([simple, better])[0].fit.parameters) == len(more)
    # A richer law that has bent to the recordings alone is contradicted by unseen data.
    bent = replace(better, confirmed=Confirmed(-30.0, -2.5, 40.0))
    straight = replace(simple, confirmed=Confirmed(5.0, 1.0, 20.0))
    assert len(ranked([straight, bent])[0].fit.parameters) < len(more)
    assert len(
        ranked([straight, replace(bent, confirmed=Confirmed(-10.0, -2.5, 40.0))])[0].fit.parameters
    ) == len(more)


@pytest.mark.parametrize(("std_error", "worse"), [(4.6, 8.0), (None, 8.0), (4.6, 3.0)])
def test_law_that_is_less_likely_is_no_rival_by_parameters_that_nobody_knows(std_error, worse):
    """However little less: without them it is the simple law, which no data could tell it from."""
    simple = replace(proved()[1], adds_up=False)
    shape = replace(
        simple.fit.parameters[0], name=f"{simple.candidate.name}.b", value=1.3, std_error=std_error
    )
    before = simple.told.simulated["validation"]
    better = {**simple.told.simulated, "validation": replace(before, rms={"phi": 0.8 * before.rms["phi"]})}
    rich = replace(
        simple,
        candidate=replace(
            simple.candidate, effect=replace(simple.candidate.effect, name="Richer", class_name="Richer")
        ),
        fit=replace(simple.fit, parameters=(*simple.fit.parameters, shape)),
        final=replace(simple.told, simulated=better),
        delta_log_likelihood=simple.delta_log_likelihood + 1.0,
        delta_bic=simple.delta_bic - worse,
    )
    assert [p.verdict for p in ranked([rich, simple])] == ["supported", "rejected"]
    # What simulates unseen data far better is another law: the root of a level is no constant flow.
    far = {**better, "validation": replace(before, rms={"phi": 0.3 * before.rms["phi"]})}
    other = replace(rich, final=replace(simple.told, simulated=far))
    verdicts = [(p.candidate.effect.name, p.verdict) for p in ranked([other, simple])]
    if worse <= GATES.same_bic:
        assert verdicts == [("Richer", "not separable"), (simple.candidate.effect.name, "not separable")]
    else:
        assert verdicts[0] == (simple.candidate.effect.name, "supported")
    elsewhere = replace(
        rich, candidate=replace(rich.candidate, site=replace(rich.candidate.site, name="bearing"))
    )
    assert [p.verdict for p in ranked([elsewhere, simple])] == ["not separable", "not separable"]


@pytest.mark.parametrize(("std_error", "verdict"), [(4.6, "not separable"), (0.1, "rejected")])
def test_law_whose_other_parameters_nobody_knows_does_not_win_over_the_simple_one(std_error, verdict):
    _, simple = proved()
    shape = replace(
        simple.fit.parameters[0], name=f"{simple.candidate.name}.b", value=1.3, std_error=std_error
    )
    rich = replace(
        simple,
        candidate=replace(
            simple.candidate, effect=replace(simple.candidate.effect, name="Richer", class_name="Richer")
        ),
        fit=replace(simple.fit, parameters=(*simple.fit.parameters, shape)),
        delta_log_likelihood=1.05 * simple.delta_log_likelihood,
        delta_bic=simple.delta_bic + 12.0,
    )
    proofs = {p.candidate.effect.name: p for p in ranked([rich, simple])}
    assert proofs[simple.candidate.effect.name].verdict == verdict
    assert proofs["Richer"].verdict == ("supported" if verdict == "rejected" else verdict)
    # Where one law was refitted twice, it is named once.
    worse = replace(rich, fit=replace(rich.fit, log_likelihood=rich.fit.log_likelihood - 3.0))
    for first, second in ((worse, rich), (rich, worse)):
        kept = _with_second_tries([first, simple], [second])
        assert [p for p in kept if p.candidate.effect.name == "Richer"] == [rich] and simple in kept
        names = [p.not_separable_from for p in ranked(kept) if p.verdict == "not separable"]
        assert all(len(set(others)) == len(others) for others in names)


def test_law_that_foresees_unseen_data_better_is_a_rival_of_a_likelier_one_and_comes_first():
    likely = replace(proved()[1], adds_up=False)
    agreement = likely.told.simulated["validation"]

    def elsewhere(factor, **more):
        errors = {name: factor * value for name, value in agreement.rms.items()}
        simulated = {**likely.told.simulated, "validation": replace(agreement, rms=errors)}
        return replace(
            likely,
            candidate=replace(likely.candidate, site=replace(likely.candidate.site, name=f"{factor}")),
            final=replace(likely.told, simulated=simulated),
            delta_log_likelihood=likely.delta_log_likelihood - 20.0,
            delta_bic=likely.delta_bic - 40.0,
            **more,
        )

    own = likely.candidate.site.name
    assert [p.verdict for p in ranked([likely, elsewhere(0.97)])] == ["supported", "rejected"]
    order = ranked([likely, elsewhere(0.97), elsewhere(0.8), elsewhere(0.7)])
    assert [p.candidate.site.name for p in order[:3]] == ["0.7", "0.8", own]
    assert [p.verdict for p in order] == ["not separable"] * 3 + ["rejected"]
    # Where the whole simulation is dead reckoning, predictions at the longest horizon count.
    reckons, longest = replace(likely, adds_up=True), max(a.samples for a in likely.ahead)
    order = ranked([reckons, elsewhere(0.7, adds_up=True)])
    assert [p.verdict for p in order] == ["supported", "rejected"]
    ahead = tuple(replace(a, ratio=(0.5 if a.samples == longest else 1.0) * a.ratio) for a in likely.ahead)
    order = ranked([reckons, replace(elsewhere(1.3, adds_up=True), ahead=ahead)])
    assert [p.candidate.site.name for p in order] == ["1.3", own]

    # What is better in one output and worse in another is missing besides, and no rival.
    def told(one, **rms):
        simulated = {**one.told.simulated, "validation": replace(agreement, rms=rms)}
        return replace(one, final=replace(one.told, simulated=simulated))

    before = told(likely, phi=1.0, omega=1.0)
    for omega, verdict in ((1.1, "supported"), (0.99, "not separable")):
        assert ranked([before, told(elsewhere(1.0), phi=0.3, omega=omega)])[0].verdict == verdict

    # By a constant load of each recording alone it is no rival.
    steady = replace(likely, steady_error=1.0)
    for error, verdict in ((1.0, "supported"), (0.8, "not separable")):
        assert ranked([steady, elsewhere(0.7, steady_error=error)])[0].verdict == verdict


def test_law_that_says_more_by_a_constant_load_alone_is_the_simpler_one():
    """A cube about a place of its own, where the sensor has an offset, beside one about zero."""
    simple = replace(proved()[1], adds_up=False, steady_error=1.0)
    own = simple.candidate.name
    extra = replace(next(p for p in simple.fit.parameters if p.name.startswith(f"{own}.")), name=f"{own}.s_0")
    fit = replace(simple.fit, parameters=(*simple.fit.parameters, extra))
    place = replace(simple.candidate, site=replace(simple.candidate.site, name="elsewhere"))
    gains = {
        "delta_log_likelihood": simple.delta_log_likelihood + 4.0,
        "delta_bic": simple.delta_bic + 2.0,
    }
    richer = replace(simple, candidate=place, fit=fit, final=fit, **gains)
    order = ranked([replace(richer, steady_error=0.999), simple])
    assert [p.verdict for p in order] == ["supported", "rejected"] and order[0].candidate is simple.candidate
    assert "beside a constant load it says no more than" in order[1].reason
    order = ranked([replace(richer, steady_error=0.9), simple])
    assert [p.verdict for p in order] == ["not separable"] * 2


def test_error_beside_constant_loads_is_that_of_noise_where_an_offset_is_all_that_is_missing():
    stand, proof = rubbing(), proved()[1]
    known = with_steady_error(stand.null, proof, stand.validation).steady_error
    moved = [replace(e, outputs=e.outputs + 0.1) for e in stand.validation]
    assert with_steady_error(stand.null, proof, moved).steady_error == pytest.approx(known, rel=0.05)
    assert with_steady_error(stand.null, replace(proof, final=None), moved).steady_error is None


def test_error_beside_constant_loads_of_a_law_of_a_recorded_signal_takes_that_signal():
    stand, proof = rubbing(), proved()[1]
    (effect,) = some_effects("MeasuredTorque")
    site = proof.candidate.site
    flat = attach(stand.null.flat, effect, site, "push", {"k": 0.0}, {"u": "wind"})
    pushed = replace(
        proof, flat=flat, candidate=Candidate(effect, site, "push", inputs={"u": "wind"}), final=stand.told
    )
    windy = [replace(e, extra={"wind": np.sin(e.time)}) for e in stand.validation]
    found = with_steady_error(stand.null, pushed, windy).steady_error
    plain = steady_misfit(
        stand.null,
        stand.null.flat.with_theta(stand.told.theta),
        stand.null.explicit,
        [one.driven_by(["wind"]) for one in windy],
    )
    assert found == pytest.approx(np.sqrt(plain), rel=1e-3)


def test_as_much_as_chance_finds_is_no_proof(monkeypatch):
    stand, (prepared, _) = rubbing(), proved()
    run = run_null(stand.null)
    # What is refused before anything is asked of the loads needs no observer.
    monkeypatch.delattr("daest.diagnosis.evidence.proof.run_null")
    proof = prove(
        stand.null, stand.baseline, prepared, stand.null.experiments, stand.validation, run, None,
        n_screened=10**80,
    )  # fmt: skip
    assert proof.p_value == 1.0 and proof.verdict == "rejected" and "by chance" in proof.reason


@pytest.mark.parametrize("T, is_short", [(0.1, True), (1.0, False)])
def test_lag_shorter_than_anything_in_the_model_is_no_finding(T, is_short):
    _, run = quiet()  # a rotor of 0.5 / 0.3 s
    lag = next(c for c in pairs(some_effects("Lag"), sites(model())) if c.site.name == "u")
    fit = SimpleNamespace(theta={f"{lag.name}.T": T})
    assert bool(lag_too_short(run.null, lag, fit)) == is_short
    # The size is told where the candidate is, from another fit, maybe.
    assert not is_short or lag_too_short(run.null, lag, fit).startswith("its time is short beside")
    friction = pairs(some_effects("CoulombFriction"), sites(model()))[0]
    assert lag_too_short(run.null, friction, SimpleNamespace(theta={f"{friction.name}.tau_c": 0.1})) == ""


@pytest.mark.parametrize("share, is_all", [(0.2, False), (0.3, True)])
def test_delay_of_what_keeps_its_level_is_its_own_history(share, is_all):
    """Ten states over most of a recording may follow any transient: no rival of a law that acts in it."""
    moved = quiet()[1].null.experiments
    still = [replace(e, inputs=np.full_like(e.inputs, 2.0)) for e in moved]
    longest = max(e.time[-1] - e.time[0] for e in moved)
    at = {c.site.kind: c for c in pairs(some_effects("Delay"), sites(model()))}
    for experiments, kind, expected in (
        (still, "input", is_all),
        (moved, "input", False),
        (still, "output", False),
    ):
        fit = SimpleNamespace(theta={f"{at[kind].name}.T": share * longest})
        assert is_history(experiments, at[kind], fit) == expected


@pytest.mark.parametrize(
    "size, share, is_refused", [(98.0, 2.5, True), (98.0, 0.1, False), (2.0, 2.5, False)]
)
def test_spring_of_unknown_size_that_relaxes_for_longer_than_the_recordings_is_none(size, share, is_refused):
    """A damper of any stiffness takes up a slow load from outside, and all masses and springs with it."""
    _, run = quiet()
    longest = max(e.time[-1] - e.time[0] for e in run.null.experiments)
    spring = Candidate(find_effect("Rotational.ExtraCompliance"), sites(model())[0], "e")
    own = (
        SimpleNamespace(name="e.e", value=34.0, std_error=size),
        SimpleNamespace(name="e.T", value=share * longest, std_error=0.1),
    )
    fit = SimpleNamespace(parameters=own, theta={p.name: p.value for p in own})
    assert bool(too_slow_for_its_size(run.null.experiments, spring, fit)) == is_refused
    assert bool(beyond_recordings(run.null, spring, fit)) == is_refused


@pytest.mark.parametrize(
    "samples, error, is_refused",
    [(0.1, 10.0, True), (0.1, 0.01, False), (0.1, None, True), (5.0, 10.0, False)],
)
def test_mass_that_is_dragged_along_within_a_sample_is_one_more_mass(samples, error, is_refused):
    """The mass of the model is estimated, too: nothing tells the two apart but how a sample is read."""
    _, run = quiet()
    period = float(np.median(np.diff(run.null.experiments[0].time)))
    dragged = Candidate(find_effect("Rotational.DraggedInertia"), sites(model())[0], "e")
    own = (
        SimpleNamespace(name="e.J", value=1.361, std_error=0.045, unit="kg.m2"),
        SimpleNamespace(name="e.T", value=samples * period, std_error=error and error * period, unit="s"),
    )
    fit = SimpleNamespace(parameters=own, theta={p.name: p.value for p in own})
    assert bool(too_fast(run.null.experiments, dragged, fit)) == is_refused
    assert bool(beyond_recordings(run.null, dragged, fit)) == is_refused


@pytest.mark.parametrize("share, is_long", [(0.2, False), (0.3, True), (1.5, True)])
def test_delay_of_a_good_part_of_the_recordings_is_no_finding(share, is_long):
    _, run = quiet()
    longest = max(e.time[-1] - e.time[0] for e in run.null.experiments)
    delay = next(c for c in pairs(some_effects("Delay"), sites(model())) if c.site.name == "u")
    fit = SimpleNamespace(theta={f"{delay.name}.T": share * longest})
    assert bool(too_slow(run.null.experiments, delay, fit)) == is_long
    gain = next(c for c in pairs(some_effects("Gain"), sites(model())) if c.site.name == "u")
    assert too_slow(run.null.experiments, gain, SimpleNamespace(theta={f"{gain.name}.g": 1e6})) == ""


def test_likelier_lag_that_only_comes_near_is_asked_for_the_hold_of_each_input(monkeypatch):
    """A late probe that a held input half explains leaves half a sample of delay there: as if the blower were
    late, which explains less."""
    _, proof = proved()
    likelier = replace(proof.fit, log_likelihood=proof.fit.log_likelihood + 36.0)
    near = replace(proof, verdict="rejected", reason="something dynamic", comes_near=True, fit=likelier)
    assert holding._asked([proof, near]) == [proof, near]
    assert holding._asked([proof, replace(near, comes_near=False)]) == [proof]
    assert holding._asked([proof, replace(near, fit=proof.fit)]) == [proof]
    # What its simulation alone has got accepted may have bent to the wrong hold: the next law is asked, too.
    assert holding._runner_up([proof, near]) == []
    shown, other = replace(proof, is_by_use=True), replace(near, comes_near=False)
    assert holding._runner_up([shown, near]) == [] and holding._runner_up([other, shown]) == [other]
    # It speaks for the other hold where it is likelier with that than itself and the best are with this one.
    least = []
    with monkeypatch.context() as patched:
        patched.setattr(holding, "_better_hold_of", lambda _null, _proof, before: least.append(before))
        assert holding.better_hold(rubbing(), [shown, other]) is None
    assert least == [shown.fit.log_likelihood, likelier.log_likelihood]
    monkeypatch.setattr(holding, "open_inputs", lambda *_: ("air", "feed"))
    null = replace(rubbing().null, hold="zoh(air)", other_hold="zoh(air, feed)", hold_lead=4.0)
    asked = [{one.hold for one in holding._otherwise(null, p)} for p in (proof, near)]
    assert asked[0] == {"zoh(air, feed)"} and "foh" in asked[1]


def test_law_with_which_unseen_data_cannot_be_simulated_is_confirmed_by_nothing():
    """A half saturation below zero has a pole at a concentration that the unseen data reach."""
    _, proof = proved()
    assert unforeseen(proof.told) == ""
    assert unforeseen(replace(proof.told, simulated={})) == "", "nothing was asked"
    without = {"validation": Agreement({"phi": None}, {"phi": None})}
    assert "confirm nothing" in unforeseen(replace(proof.told, simulated=without))


def test_kink_too_sharp_for_any_observer_does_not_take_the_place_of_a_rounder_one():
    _, proof = proved()
    sharp = replace(proof, delta_bic=proof.delta_bic + 50.0)
    assert _with_better_kinks([proof], [sharp]) == [sharp]
    refused = replace(sharp, verdict="rejected", reason="unseen data are foreseen 5 times worse over 1 s")
    assert _with_better_kinks([proof], [refused]) == [proof]
    both = replace(proof, verdict="rejected")
    assert _with_better_kinks([both], [refused]) == [refused]


def test_rounder_kink_makes_no_law_of_what_was_refused_for_a_form_that_it_leaves():
    _, proof = proved()
    form = SimpleNamespace(load=0, variable="phi", sign_of="w", p_value=1e-50, log_likelihood_gain=90.0)
    wrong = replace(proof, verdict="rejected", reason="another law acts there", left=form)
    round_one = replace(proof, delta_bic=proof.delta_bic + 50.0, delta_log_likelihood=300.0, left=form)
    (found,) = _with_better_kinks([wrong], [round_one])
    assert found.verdict == "rejected" and found.reason == wrong.reason
    for left in (replace_form(form, variable="w"), replace_form(form, log_likelihood_gain=10.0), None):
        cured = replace(round_one, left=left)
        assert _with_better_kinks([wrong], [cured]) == [cured]


def replace_form(form, **changes):
    return SimpleNamespace(**{**vars(form), **changes})


def test_law_on_the_other_side_of_a_limit_is_not_put_aside():
    """A gain of a sensor that hardly moves takes 58 % of a load, its offset 42 %: as likely, as good."""
    _, proof = proved()
    gain = replace(proof, explained=0.58, adds_up=False)
    other_law = replace(proof.candidate.effect, class_name="Other")
    offset = replace(
        gain,
        candidate=replace(proof.candidate, effect=other_law),
        delta_bic=proof.delta_bic - 1.0,
        explained=0.42,
        verdict="rejected",
        reason=unexplained(0.42, ()),
        takes_little=True,
    )
    assert [p.verdict for p in ranked([gain, offset])] == ["not separable"] * 2
    seen = proof.told.simulated["validation"]
    worse = replace(seen, rms={name: 1.1 * rms for name, rms in seen.rms.items()})
    poor = replace(proof.told, simulated={**proof.told.simulated, "validation": worse})
    for other in (
        replace(offset, takes_little=False),
        replace(offset, explained=0.2),
        replace(offset, delta_bic=proof.delta_bic - 2.0 * GATES.same_bic),
        replace(offset, fit=poor, final=poor),
    ):
        assert [p.verdict for p in ranked([gain, other])] == ["supported", "rejected"]


def test_dead_zone_with_wide_corners_is_not_told_from_another_bend():
    """Of 1.8 V with corners over 0.5 V, for a thrust that goes with the square of its command."""
    _, proof = proved()
    laws = {e.name: e for e in library()}
    at = replace(proof.candidate.site, name="u", kind="input")

    def law(name, gain, **values):
        candidate = replace(proof.candidate, effect=laws[name], site=at)
        theta = {**proof.fit.theta, **{f"{candidate.name}.{n}": value for n, value in values.items()}}
        fit, final = (replace(one, theta=theta) for one in (proof.fit, proof.told))
        likelihood = gain * proof.delta_log_likelihood
        return replace(
            proof,
            candidate=candidate,
            fit=fit,
            final=final,
            delta_log_likelihood=likelihood,
            delta_bic=gain * 200,
        )

    square = law("QuadraticGain", 0.9, a=8.7, u_s=0.02)
    wide, sharp = (law("DeadZone", 1.0, width=1.78, u_s=kink) for kink in (0.54, 0.02))
    assert [p.verdict for p in ranked([wide, square])] == ["not separable"] * 2
    assert [p.verdict for p in ranked([sharp, square])] == ["supported", "rejected"]
    assert [p.verdict for p in ranked([wide, law("QuadraticGain", 0.5, a=8.7)])] == ["supported", "rejected"]


@pytest.mark.parametrize(("samples", "free"), [(0.3, 2), (1.0, 2), (2.5, 4), (40.0, 11)])
def test_dead_time_begins_with_no_more_than_went_into_it_before(samples, free):
    """One number a sample: a dead time of one sample is charged as the lag is that says the same."""
    null = rubbing().null
    delay = next(c for c in pairs(some_effects("Delay"), sites(model())) if c.site.name == "u")
    prepared = prepare(null.flat, null.estimated, Trial(delay, (0.01,), ()))
    period = null.experiments[0].period
    fit = SimpleNamespace(theta={f"{delay.name}.T": samples * period})
    found = SimpleNamespace(
        prepared=prepared, refit=SimpleNamespace(fit=fit), experiments=null.experiments, gain=100.0
    )
    judge = proving._Judge(null, null.fit, found, (), None, None, 1, None, None, None)
    assert judge.n_own == free


@pytest.mark.parametrize(
    ("adds_up", "ratio", "is_refused"), [(True, 0.1, False), (True, 0.5, True), (False, 0.1, True)]
)
def test_law_of_nearly_all_errors_that_add_up_is_no_other(monkeypatch, adds_up, ratio, is_refused):
    """The areas of a piston before a position that nothing holds: unknown loads do the same, and a short lag
    that is missing besides says more than the law does beside them."""
    prepared, proof = proved()
    monkeypatch.setattr(proving, "wrong_law", lambda *_: "another law acts there")
    found = SimpleNamespace(prepared=prepared, gain=20.0)
    reference = SimpleNamespace(adds_up=adds_up)
    judge = proving._Judge(None, None, found, (), None, None, 1, None, None, reference)
    judge.__dict__["explained"] = 0.2
    told = proving._Told("", proof.fit, ratios=(ratio,), is_told=True)
    points = np.zeros(2)
    left = FreeForm(0, "rotor.flange", "rotor.w", "", "N.m", "rad/s", 64.0, 4, 1e-5, points, points, points)
    assert bool(judge._against_rest(told, left)[0]) == is_refused
