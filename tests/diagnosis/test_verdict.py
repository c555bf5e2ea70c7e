"""Every verdict of the closed list, reached by made-up evidence."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from hidden_plants import model, rubbing, some_effects

from daest.diagnosis import examine
from daest.diagnosis.answers import nothing, told_laws
from daest.diagnosis.answers.changing_values import ChangingValue
from daest.diagnosis.answers.decided import OTHER_AMPLITUDES, WIDER_BAND, Decided, Evidence
from daest.diagnosis.answers.held_values import OtherValue
from daest.diagnosis.answers.parts import Parts
from daest.diagnosis.answers.unexplained import Loads
from daest.diagnosis.answers.verdict import AT_ONCE, MOVING, beside_parts, beside_value, decide
from daest.diagnosis.evidence.noise_level import RECORDED
from daest.diagnosis.evidence.reasons import unmoved
from daest.diagnosis.gates import GATES
from daest.diagnosis.recordings.holds import says_as_much
from daest.diagnosis.recordings.recorded_late import EarlierInputs
from daest.diagnosis.screening.candidates import pairs
from daest.diagnosis.without_equations.coloured import Residual
from daest.model.diagnosis import Ahead, FreeForm, InUse, Load, PlaceGain, Proof, Screen, Screened, Unproved
from daest.model.fit import Agreement, FittedParameter
from daest.modelica.places.sites import sites

WHITE = np.random.default_rng(0).standard_normal((800, 1))
COLOURED = np.cumsum(WHITE, axis=0)


@cache
def candidate(name):
    return next(c for c in pairs(some_effects(name), sites(model())) if c.site.name == "rotor.flange_a")


def fit(simulated=1.0, one_step=0.5, parameters=()):
    return replace(
        rubbing().baseline,
        parameters=tuple(parameters),
        simulated=dict.fromkeys(RECORDED, Agreement({"phi": 90.0}, {"phi": simulated})),
        one_step=dict.fromkeys(RECORDED, Agreement({"phi": 99.0}, {"phi": one_step})),
    )


def proof(name="CoulombFriction", verdict="supported", simulated=0.1):
    own = candidate(name)
    size = FittedParameter(f"{own.name}.tau_c", 0.15, 0.01, 0.01, "N.m", 0.0, None, None)
    return Proof(
        own, model(), fit(simulated, parameters=[size]), 50.0, 95.0, 1e-9, 0.8, (), (), verdict,
        "" if verdict == "supported" else "no",
    )  # fmt: skip


def evidence(
    *, proofs=(), p_value=1e-6, gain=100.0, size=0.1, simulated=1.0, innovations=WHITE, related=False,
    parameters=(), fitted=None, observer=1.0, time_constant=1.0,
):  # fmt: skip
    entry = Screened(candidate("CoulombFriction"), 6.0, (0.1,), p_value, False, 0.02)
    load = Load("load_1", "rotor.flange_a", ("rotor.flange_a",), time_constant, size, "N.m")
    x = np.linspace(-1.0, 1.0, 16)
    form = FreeForm(
        0, "rotor.flange_a", "rotor.w", "", "N.m", "rad/s", 80.0, 8, 1e-9 if related else 0.3, x, np.sign(x),
        0.1 + 0 * x,
    )  # fmt: skip
    record = SimpleNamespace(
        time=np.linspace(0.0, 900.0, 900), outputs=np.arange(900.0)[:, None], median_step=1.0
    )
    loads = Loads(
        model(),
        SimpleNamespace(
            loads=(load,),
            experiments=(record,),
            slowest=None,
            intensity=np.ones(1),
        ),
        SimpleNamespace(observed=(SimpleNamespace(whitened=innovations),), gain=observer * np.ones((1, 1))),
        (PlaceGain(("rotor.flange_a", "bearing"), gain, size, "N.m"),),
        form,
    )
    baseline, screen = fit(simulated, parameters=parameters), Screen((entry,), np.eye(1), p_value, 12, ())
    return Evidence(baseline, screen, tuple(proofs), fitted or {}, loads)


def test_one_accepted_candidate_is_supported_with_its_numbers():
    found = decide(evidence(proofs=[proof(), proof("QuadraticDrag", "rejected")]))
    assert found.name == "supported"
    assert "tau_c = 0.15 ± 0.01 N.m" in found.message
    assert "phi 1 -> 0.1" in found.message and "QuadraticDrag" not in found.message


def test_bent_sensor_that_a_bent_machine_equals_is_not_told_from_it():
    inside = "a machine that bends alike before phi"
    found = decide(evidence(proofs=[replace(proof(), inside=inside), proof("QuadraticDrag", "rejected")]))
    assert found.name == "cannot tell" and inside in found.message and "tau_c = 0.15 ± 0.01" in found.message
    assert "phi 1 -> 0.1" in found.message and "sensor" in found.next_experiment
    first, second = found.proofs
    assert first.verdict == "not separable" and first.not_separable_from == (inside,)
    assert second.verdict == "rejected"
    others = [replace(proof(), inside=inside), proof("QuadraticDrag")]
    assert inside in decide(evidence(proofs=others)).message


@pytest.mark.parametrize(
    ("errors", "adds_up", "is_claimed"),
    [
        ((0.24, 1.25), False, False),  # a law that takes errors from one output and gives them to another
        ((0.24, 1.05), False, True),
        ((0.24, 1.25), True, True),  # what is measured of the second is dead reckoning
        ((1.3, 1.2), False, True),  # all together: that is for the gates of the proof
    ],
)
def test_law_that_spoils_an_output_is_no_claim(errors, adds_up, is_claimed):
    """A free outlet of a vacuum chamber, whose walls hold gas, had been supported though the pressure in the
    lock was simulated 1.24 times worse."""
    names = ("p", "q")

    def simulating(*rms):
        both = Agreement(dict.fromkeys(names, 90.0), dict(zip(names, rms, strict=True)))
        return replace(fit(), simulated=dict.fromkeys(RECORDED, both))

    law = replace(proof(), final=simulating(*errors), adds_up=adds_up, holding=("p",) if adds_up else ())
    known = replace(evidence(proofs=[law]), told=simulating(1.0, 1.0))
    found = decide(known)
    assert found.name == ("supported" if is_claimed else "cannot tell")
    if not is_claimed:
        assert "simulation of q of unseen data gets 1.25 times worse" in found.message
        assert "given values" in found.next_experiment
        assert [p.verdict for p in found.proofs] == ["not separable"]


def test_law_is_no_claim_beside_a_given_value_of_which_another_says_as_much():
    known = evidence(proofs=[proof(), proof("QuadraticDrag", "rejected")])
    other = OtherValue(FittedParameter("J", 0.5, 0.01, 0.02, "kg.m2", 0.0, None, None), 0.4, 50.0, (0.1,))
    value = "`J`, 0.5 ± 0.01 kg.m2 instead of the 0.4 kg.m2 that is given"
    found = beside_value(known, decide(known), other)
    assert found.name == "cannot tell" and "`J`" in found.next_experiment
    assert found.message.startswith(
        "CoulombFriction at rotor.flange_a would do (tau_c = 0.15 ± 0.01 N.m), but "
    )
    assert f"another value of {value}, says as much: estimate it, too (`J = " in found.message
    assert "phi 1 -> 0.1" in found.message
    first, second = found.proofs
    assert first.verdict == "not separable" and first.not_separable_from == (f"another value of {value}",)
    assert first.given_values == ("J",)
    assert second is known.proofs[1]


@pytest.mark.parametrize("more", [20.0, 3.0])
def test_sum_of_two_laws_is_no_claim_where_its_parts_are_likelier(more):
    known = evidence(proofs=[proof(), proof("QuadraticDrag", "rejected")])
    told = "Drag at rotor.flange_a (k = 1 ± 0.1) and Load at rotor.flange_a (b = 2 ± 0.1)"
    parts = Parts(("Drag at rotor.flange_a", "Load at rotor.flange_a"), told, more, are_known=True)
    found = beside_parts(known, decide(known), known.proofs[0], parts)
    assert found.name == "cannot tell" and told in found.message
    first, second = found.proofs
    is_aside = more > GATES.min_bic_gain
    assert first.verdict == ("rejected" if is_aside else "not separable")
    assert first.stands_for == (parts.labels if is_aside else ())
    assert ("BIC 20" in found.message, "tau_c = 0.15" in found.message) == (is_aside, not is_aside)
    assert second is known.proofs[1]


def test_one_of_several_laws_beside_such_a_value_keeps_the_others():
    known = evidence(proofs=[proof(), proof("QuadraticDrag")])
    rate = FittedParameter("change_0.r", 1e-5, 1e-6, 0.1, "1/s", 0.0, None, None)
    other = ChangingValue(rate, 0.0, 50.0, (0.1,), ("c",), name="J", percent=3.0, error=0.3)
    found = beside_value(known, decide(known), other)
    assert found.name == "cannot tell" and "QuadraticDrag" in found.message
    change = (
        "A change of `J` (or `c`, which the sensors see alike) with time, by 3 ± 0.3 % over the recording"
    )
    assert f"{change}, says as much: see whether `J` can change" in found.message
    assert [p.given_values for p in found.proofs] == [other.given, other.given]


def test_loads_that_no_observer_follows_are_not_nothing():
    assert decide(evidence(p_value=0.5, gain=0.0, innovations=COLOURED)).name == "nothing missing"
    assert decide(evidence(p_value=0.5, gain=0.0, observer=0.0)).name == "nothing missing"
    found = decide(evidence(p_value=0.5, gain=0.0, innovations=COLOURED, observer=0.0))
    assert found.name == "unknown effect" and found.is_by_colour


def test_nearest_law_is_named_where_errors_stay_correlated():
    """But none that makes a simulation of unseen data worse."""
    refused = replace(proof(verdict="rejected", simulated=0.8), reason="what it leaves lasts")
    worse = replace(refused, final=fit(simulated=2.0), delta_bic=refused.delta_bic + 10.0)
    parts = {"p_value": 0.5, "gain": 0.0, "innovations": COLOURED, "observer": 0.0}
    found = decide(evidence(proofs=[worse, refused], **parts))
    assert found.name == "unknown effect" and found.is_by_colour
    told = f"{refused.candidate.label} comes nearest (tau_c = 0.15"
    assert told in found.message and "but what it leaves lasts." in found.message
    assert "phi 1 -> 0.8" in found.message
    assert "nearest" not in decide(evidence(proofs=[worse], **parts)).message


def test_laws_that_would_have_shown_are_different_ones():
    """One law at four places that the sensors see alike had been all of them."""
    laws = pairs(some_effects("CoulombFriction", "QuadraticDrag"), sites(model()))
    entries = tuple(Screened(one, 1.0, (0.1,), 0.5, False, 0.02) for one in laws)
    screen = Screen(entries, np.eye(len(entries)), 0.5, len(entries), ())
    found = decide(replace(evidence(p_value=0.5, gain=0.0), screen=screen))
    assert len(entries) > 2 and found.name == "nothing missing"
    assert found.message.count("CoulombFriction") == found.message.count("QuadraticDrag") == 1


def test_the_output_is_named_of_which_a_law_removes_most():
    def with_current(told, rms):
        both = Agreement({"i": 90.0, **told.simulated["validation"].fit_percent}, {"i": rms, "phi": 1.0})
        return replace(told, simulated={**told.simulated, "validation": both})

    law = proof()
    law = replace(law, fit=with_current(law.fit, 0.2))
    known = evidence(proofs=[law])
    known = replace(known, baseline=with_current(known.baseline, 0.8))
    assert "removes 75 % of the error of the whole simulation of i." in decide(known).message


def test_what_a_simulation_leaves_is_told_where_it_is_many_times_the_noise():
    said = "leaves of phi is 4 times its error one sample ahead: something else is missing, or acts besides."
    known = evidence(proofs=[proof(simulated=2.0)], simulated=9.0)
    assert said in decide(known).message
    assert said not in decide(evidence(proofs=[proof(simulated=1.0)], simulated=9.0)).message
    adding = replace(known, proofs=(replace(known.proofs[0], adds_up=True),))
    assert said not in decide(adding).message
    steady = replace(known, proofs=(replace(known.proofs[0], adds_up=True, holding=("phi",)),))
    assert said in decide(steady).message


def with_white(law, white):
    both = Agreement({"phi": 90.0}, {"phi": 1.0}, {"phi": white})
    return replace(law, fit=replace(law.fit, simulated=dict.fromkeys(RECORDED, both)))


def test_errors_that_last_are_told_where_no_load_tells_them():
    said = "leaves of phi lasts: it is 5 times its part without memory, so that something else is missing"
    known = [with_white(proof(), white) for white in (0.2, 0.5, None)]
    told = [decide(evidence(proofs=[law], simulated=9.0)).message for law in known]
    assert said in told[0]
    assert "lasts" not in told[1] + told[2]


def untried(score, p_value=1e-9):
    return Unproved(
        candidate("QuadraticDrag"), (), score, p_value, (0.1,), "it could not be refitted: too stiff", True
    )


def test_leader_that_could_not_be_tried_forbids_any_other_claim():
    found = decide(replace(evidence(proofs=[proof()]), unproved=(untried(31.0),)))
    assert found.name == "cannot tell"
    assert "QuadraticDrag" in found.message and "too stiff" in found.message
    (left,) = found.proofs
    assert left.verdict == "not separable" and left.not_separable_from == (candidate("QuadraticDrag").label,)
    assert "daest extend" in found.next_experiment
    # What says less than the one that is supported forbids nothing.
    assert decide(replace(evidence(proofs=[proof()]), unproved=(untried(5.0),))).name == "supported"
    assert (
        decide(replace(evidence(proofs=[proof()]), unproved=(untried(31.0, p_value=0.01),))).name
        == "supported"
    )


def test_what_the_model_holds_with_given_values_is_to_be_estimated_and_not_added():
    there = replace(untried(31.0), reason="the model contains it already: `d`", is_present=True)
    found = decide(replace(evidence(proofs=[proof()]), unproved=(there,)))
    assert found.name == "cannot tell"
    assert "--estimate" in found.next_experiment and "daest extend" not in found.next_experiment


def test_law_that_leaves_much_is_no_claim_beside_one_that_says_ten_times_as_much():
    """A dead zone of a pump had been an outlet of a tank, far behind a limit of the pump that was refused."""
    small = proof(simulated=0.9)
    white = Agreement({"phi": 90.0}, {"phi": 0.9}, {"phi": 0.05})
    told = replace(small.fit, simulated=dict.fromkeys(RECORDED, white))
    left = replace(evidence().rest.form, p_value=1e-9, statistic=90.0)
    small = replace(small, fit=told, left=left)
    other = replace(proof("QuadraticDrag", "rejected", simulated=1.0), delta_bic=20.0 * small.delta_bic)
    found = decide(evidence(proofs=[small, other]))
    assert found.name == "cannot tell" and "QuadraticDrag" in found.message
    for known in (replace(small, left=None), replace(small, fit=proof(simulated=0.9).fit)):
        assert decide(evidence(proofs=[known, other])).name == "supported"
    near = replace(other, delta_bic=5.0 * small.delta_bic)
    assert decide(evidence(proofs=[small, near])).name == "supported"


def test_a_law_that_is_left_open_is_told_by_all_names_that_it_has_there():
    """A drum coasts down: dry friction, gravity and a constant load are one equation, and the set named the
    first of them alone."""
    same = replace(proof("CoulombFriction"), same_as=("Unbalance at rotor", "ConstantLoad at rotor"))
    label = same.candidate.label
    told = f"{label} (here the same equation as Unbalance at rotor and ConstantLoad at rotor)"
    assert f"One of {told} and " in decide(evidence(proofs=[same, proof("QuadraticDrag")])).message
    beside = decide(replace(evidence(proofs=[same]), unproved=(untried(31.0),)))
    assert beside.message.startswith(f"{told} would do, but ")


def test_leader_that_could_not_be_tried_forbids_no_claim_that_gained_far_more():
    """The screen foresees s² / 2, here 162 of a gain of 1000 that leaves nothing."""
    left = replace(evidence().rest.form, p_value=0.5, statistic=1.0)
    settled = replace(proof(), delta_log_likelihood=1000.0, left=left)
    assert decide(replace(evidence(proofs=[settled]), unproved=(untried(18.0),))).name == "supported"
    assert decide(replace(evidence(proofs=[settled]), unproved=(untried(31.0),))).name == "cannot tell"


def test_leader_that_could_not_be_tried_is_named_where_nothing_else_is_found():
    found = decide(replace(evidence(related=True), unproved=(untried(31.0),)))
    assert found.name == "cannot tell" and "QuadraticDrag" in found.message


def test_leader_that_was_not_begun_in_time_is_no_work_for_the_user():
    late = replace(untried(31.0), is_late=True)
    found = decide(replace(evidence(related=True), unproved=(late,)))
    assert "same command again" in found.next_experiment and "QuadraticDrag" in found.next_experiment


def test_leader_that_was_not_begun_in_time_forbids_a_claim_with_a_lower_score_too():
    """Many refits go beyond what the screen foresees; but none to four times of it."""
    late = replace(untried(5.0), is_late=True, reason="it was not refitted: the time was up")
    found = decide(replace(evidence(proofs=[proof()]), unproved=(late,)))
    assert found.name == "cannot tell" and "may say as much" in found.message
    left = replace(evidence().rest.form, p_value=0.5, statistic=1.0)
    settled = replace(proof(), delta_log_likelihood=1000.0, left=left)
    assert decide(replace(evidence(proofs=[settled]), unproved=(late,))).name == "supported"


def test_what_pieces_show_is_told_as_theirs():
    used = InUse(
        fitted=1.0, unseen=2.0 * np.log(2.0), n_independent=40.0, n_unseen=30.0, certainty=4.0, piece=0.5
    )
    shown = replace(proof(), ahead=(), is_by_use=True, in_use=used)
    said = decide(evidence(proofs=[shown])).message
    assert "50 % of the error of simulations over 0.5 s, each from a start of its own," in said
    assert "unseen data simulated better by 4 standard errors" in said
    adding = replace(proof(simulated=1.6), ahead=(), is_by_use=True, in_use=used)
    assert "each from a start of its own. The error of" in decide(evidence(proofs=[adding])).message


def test_curve_that_foresees_nothing_is_no_effect():
    assert decide(evidence(related=True)).name == "unknown effect"
    known = evidence(related=True)
    loads = replace(known.rest, against_form="unseen data are foreseen no better")
    found = decide(replace(known, rest=loads))
    assert found.name == "external disturbance"
    assert "rotor.w" in found.message and "foreseen no better" in found.message


def test_importance_and_certainty_are_told_apart():
    far = replace(proof(), ahead=(Ahead(1, 0.05, 0.9, 4.0), Ahead(10, 0.5, 0.4, 3.0)))
    said = decide(evidence(proofs=[far])).message
    assert "removes 60 % of the error of predictions 0.5 s ahead and 90 % of that of the whole" in said
    assert "BIC gain 95 over 12 candidates, unseen data foreseen better by 4 standard errors" in said
    level = replace(proof(), ahead=(Ahead(1, 0.05, 1.0, -0.05),))
    assert "12 candidates, unseen data foreseen no better" in decide(evidence(proofs=[level])).message


def test_equivalent_places_are_told():
    found = decide(evidence(proofs=[replace(proof(), equivalent=("bearing",))]))
    assert "cannot tell it from the same effect at bearing" in found.message


@pytest.mark.parametrize(
    ("domain", "told"), [("thermal", "temperature"), ("electrical", "voltage"), ("signal", "one by one")]
)
@pytest.mark.parametrize("other", ["b", "a, b"])
def test_experiment_that_separates_places_measures_what_there_is_to_measure(domain, told, other):
    apart = [
        replace(p, candidate=replace(p.candidate, site=replace(p.candidate.site, name=name, domain=domain)))
        for p, name in ((proof(), "a"), (proof("QuadraticDrag"), other))
    ]
    found = decide(evidence(proofs=tuple(apart)))
    assert (
        found.name == "cannot tell" and told in found.next_experiment and "a and b" in found.next_experiment
    )


def test_two_accepted_candidates_are_a_set_with_the_experiment_that_separates_them():
    found = decide(evidence(proofs=[proof(), proof("QuadraticDrag", "not separable")]))
    assert found.name == "cannot tell"
    assert "CoulombFriction" in found.message and "QuadraticDrag" in found.message
    assert "several constant speeds" in found.next_experiment


def test_a_set_tells_what_each_of_its_laws_leaves():
    def told(*whites):
        names = ("CoulombFriction", "QuadraticDrag")
        laws = [with_white(proof(name), white) for name, white in zip(names, whites, strict=True)]
        return decide(evidence(proofs=laws, simulated=9.0)).message

    lasts = "leaves of phi lasts: it is 1.6 times its part without memory, so that something else is missing"
    assert lasts in told(0.62, 0.6) and "It may be none of them." in told(0.62, 0.6)
    assert "phi 9 -> 1" in told(0.62, 0.95)
    assert "none of them" not in told(0.62, 0.95)


def test_places_that_differ_ask_for_a_sensor_between_them():
    other = replace(proof(), candidate=replace(candidate("CoulombFriction"), site=sites(model())[1]))
    found = decide(evidence(proofs=[proof(), other]))
    assert found.name == "cannot tell" and found.next_experiment.startswith("Measure")


def test_simulation_down_to_the_noise_is_nothing_missing_whatever_the_load():
    found = decide(evidence(simulated=0.5, related=True))
    assert found.name == "nothing missing"
    assert "CoulombFriction at rotor.flange_a from tau_c = 0.02 N.m" in found.message


@pytest.mark.parametrize(
    ("refused", "name", "said"),
    [
        (0, "nothing missing", "The search has seen something (p = 1e-09), but it hardly matters"),
        (1, "cannot tell", "Something small is missing (p = 1e-09"),
    ],
)
def test_a_sure_search_is_told_where_a_simulation_is_as_good_as_predictions(refused, name, said):
    proofs = refused * [proof(verdict="rejected")]
    found = decide(evidence(proofs=proofs, simulated=0.5, p_value=1e-9))
    assert found.name == name and said in found.message
    off = FittedParameter("J", 0.5, 0.01, 0.02, "kg.m2", 0.0, None, None)
    told = decide(evidence(proofs=proofs, simulated=0.5, p_value=1e-9, parameters=[off], fitted={"J": 0.4}))
    assert told.name == "parameters off" and "p = 1e-09" in told.message
    quiet = decide(evidence(proofs=proofs, simulated=0.5, p_value=0.1)).message
    assert "Nothing is missing at this noise level" in quiet and "seen something" not in quiet


def test_shares_of_more_than_all_are_not_told_as_what_would_have_shown():
    share = next(c for c in pairs(some_effects("Saturation"), sites(model())))
    other = Screened(candidate("CoulombFriction"), 1.0, (0.1,), 0.5, False, 0.02)
    entries = (Screened(share, 2.0, (0.1,), 0.5, False, 100.0), other)
    shown = nothing._smallest([e for e in entries if not nothing._is_beyond(e)])
    assert shown == "CoulombFriction at rotor.flange_a from tau_c = 0.02 N.m"
    of_number = replace(share, shape={"limit": 7.76}, units={"limit": "1"})
    assert nothing._of_form(of_number) == " (limit = 7.76)"


@pytest.mark.parametrize(("detectable", "name"), [(500.0, "cannot tell"), (0.3, "nothing missing")])
def test_recordings_that_would_not_show_a_cut_signal_tell_nothing(detectable, name):
    """Of a core in saturation it had been said that nothing is missing: a share of 510 would be seen."""
    known = evidence(p_value=0.3, gain=5.0)
    saturation = pairs(some_effects("Saturation"), sites(model()))[0]
    cut = replace(known.screen.entries[0], candidate=saturation, detectable=detectable)
    found = decide(replace(known, screen=replace(known.screen, entries=(*known.screen.entries, cut))))
    assert found.name == name and f"from share = {detectable:.2g}" in found.message


def test_unseen_data_that_show_less_than_those_of_the_fit_are_no_proof_of_silence():
    known = evidence(simulated=0.5, related=True)
    agreements = {**known.baseline.simulated, "estimation": Agreement({"phi": 90.0}, {"phi": 3.0})}
    assert decide(replace(known, baseline=replace(known.baseline, simulated=agreements))).name != (
        "nothing missing"
    )


def test_weak_search_and_small_load_are_nothing_missing():
    assert decide(evidence(p_value=0.3, gain=5.0)).name == "nothing missing"
    # The load that the declared white torque makes up for: 2 size² T of 1e-4 N².m².s.
    assert decide(evidence(p_value=0.3, size=np.sqrt(0.5e-4))).name == "nothing missing"


@pytest.mark.parametrize(
    ("one_step", "simulated", "name"),
    [(4.0, 4.0, "cannot tell"), (4.0, 1.2, "nothing missing"), (1.2, 4.0, "nothing missing")],
    ids=("both", "an observer that seeks its start", "a simulation that runs away"),
)
def test_unseen_data_that_contradict_the_model_are_not_silent(one_step, simulated, name):
    """A heater that is cut in the second half alone: the first tells of nothing."""
    found = evidence(p_value=0.4, gain=1.0)

    def both(unseen):
        return {
            "estimation": Agreement({"phi": 99.0}, {"phi": 1.0}),
            "validation": Agreement({"phi": 80.0}, {"phi": unseen}),
        }

    baseline = replace(found.baseline, one_step=both(one_step), simulated=both(simulated))
    decided = decide(replace(found, baseline=baseline))
    assert decided.name == name
    assert ("phi is 4 there and 1 in the fit" in decided.message) == (name == "cannot tell")
    # A vent that is first opened there.
    known, unknown = (
        FittedParameter(n, 6.0, e, e, "W/K", 0.0, None, None) for n, e in (("c", 0.1), ("kv", 4.5))
    )
    told = decide(replace(found, baseline=replace(baseline, parameters=(known, unknown))))
    said = "hardly tell `kv` (± 75 %), which may be all that it is."
    assert (said in told.message) == (name == "cannot tell")


def test_contradicted_parameter_is_off():
    moved = FittedParameter("J", 0.7, 0.01, 0.5, "kg.m2", 0.0, None, None)
    found = decide(evidence(p_value=0.5, gain=0.0, parameters=[moved], fitted={"J": 0.5}))
    assert found.name == "parameters off" and "J = 0.5 given, 0.7 ± 0.01 kg.m2 found" in found.message
    within = decide(evidence(p_value=0.5, gain=0.0, parameters=[moved], fitted={"J": 0.68}))
    assert within.name == "nothing missing"


@pytest.mark.parametrize("cause", [{"p_value": 1e-6, "gain": 0.0}, {"p_value": 0.5, "gain": 100.0}])
def test_unnamed_effect_that_follows_a_variable_is_unknown(cause):
    found = decide(evidence(related=True, **cause))
    assert found.name == "unknown effect"
    assert "follows rotor.w (p = 1e-09)" in found.message
    assert "bearing, which the sensors cannot tell apart" in found.message


def test_coloured_innovations_say_that_something_dynamic_is_missing():
    found = decide(evidence(innovations=COLOURED))
    assert found.name == "unknown effect" and "dynamic" in found.message
    assert "or the noise of a sensor is slow" in found.message


@pytest.mark.parametrize("p_value", [0.5, 1e-6])
def test_coloured_innovations_that_nothing_drives_are_a_disturbance(monkeypatch, p_value):
    monkeypatch.setattr(Loads, "are_driven", False)
    found = decide(evidence(innovations=COLOURED, p_value=p_value))
    is_any_effect = p_value < GATES.missing_level
    assert found.name == ("unknown effect" if is_any_effect else "external disturbance")
    assert found.is_by_colour


@pytest.mark.parametrize("simulated, name", [(1.0, "external disturbance"), (0.8, "unknown effect")])
def test_what_a_law_simulates_better_is_no_disturbance(monkeypatch, simulated, name):
    """The drag of a fan behind slow noise of the sensors: refused beside loads, it simulates better."""
    monkeypatch.setattr(Loads, "are_driven", False)
    law = proof("QuadraticDrag", "rejected", simulated)
    assert decide(evidence(proofs=[law], innovations=COLOURED, p_value=0.5)).name == name


def test_lags_too_short_to_be_told_apart_say_that_something_fast_is_missing():
    refused = replace(proof(verdict="rejected"), is_any_dynamics=True, reason="it is short")
    found = decide(evidence(proofs=[refused], related=True))
    assert found.name == "unknown effect" and "dynamic" in found.message
    assert (
        "CoulombFriction at rotor.flange_a would do (tau_c = 0.15 ± 0.01 N.m), but it is short"
        in found.message
    )


@pytest.mark.parametrize(("behind", "told"), [(4.0, "any of CoulombFriction"), (58.0, "Clearly less likely")])
def test_of_short_lags_those_that_the_data_speak_against_are_told_apart(behind, told):
    short = replace(proof(verdict="rejected"), is_any_dynamics=True, reason="it is short", delta_bic=88.0)
    other = replace(proof("QuadraticDrag", "rejected"), is_any_dynamics=True, delta_bic=88.0 - behind)
    found = decide(evidence(proofs=[short, other], related=True))
    assert found.name == "unknown effect" and told in found.message
    assert ("QuadraticDrag at rotor.flange_a (BIC 58)" in found.message) == (behind > 10.0)


@pytest.mark.parametrize("gain", [40.0, 400.0])
def test_lag_that_does_most_is_told_before_shorter_ones_and_curves_that_do_less(gain):
    short = replace(proof("QuadraticDrag", "rejected"), is_any_dynamics=True, reason="it is short")
    near = replace(proof(verdict="rejected"), comes_near=True, explained=0.9, delta_bic=gain, reason="less")
    found = decide(evidence(proofs=[near, short], related=True))
    assert found.name == "unknown effect" and "Something dynamic is missing" in found.message
    told = "CoulombFriction at rotor.flange_a comes nearest (tau_c = 0.15 ± 0.01 N.m)"
    assert (told in found.message) == (gain > 100.0)


def test_lag_that_does_most_is_told_where_nothing_else_is_to_be_compared():
    near = replace(proof(verdict="rejected"), comes_near=True, explained=0.9, delta_bic=40.0, reason="less")
    found = decide(evidence(proofs=[near], p_value=0.1))
    assert (
        found.name == "unknown effect" and "CoulombFriction at rotor.flange_a comes nearest" in found.message
    )
    little = decide(evidence(proofs=[replace(near, explained=0.2)], p_value=0.1))
    assert little.name == "external disturbance"


@pytest.mark.parametrize(("held", "name"), [(1, "unknown effect"), (5, "external disturbance")])
def test_errors_that_the_steps_of_a_sensor_make_last_are_no_dynamics(held, name):
    """A thermometer that moves by a quarter of a kelvin every five samples."""
    known = evidence(innovations=COLOURED)
    values = np.repeat(np.arange(180.0), 5)[:900] if held > 1 else np.arange(900.0)
    null = replace_outputs(known.rest.null, values[:, None])
    assert decide(replace(known, rest=replace(known.rest, null=null))).name == name


def replace_outputs(null, outputs):
    record = SimpleNamespace(**{**vars(null.experiments[0]), "outputs": outputs})
    return SimpleNamespace(**{**vars(null), "experiments": (record,)})


@pytest.mark.parametrize(
    ("inputs", "outputs", "is_still"),
    [
        (np.zeros(9), np.full(9, 0.3), True),
        (np.zeros(9), 0.3 + 0.01 * np.sin(np.arange(9.0)), True),  # beside an output that moved by one
        (np.arange(9.0), np.full(9, 0.3), False),  # dry friction that holds
        (np.zeros(9), 0.3 ** np.arange(9.0), False),  # a free decay
    ],
)
def test_unseen_data_in_which_nothing_moves_confirm_no_law(inputs, outputs, is_still):
    fitted = SimpleNamespace(outputs=np.array([0.0, 2.0, np.nan])[:, None])
    unseen = SimpleNamespace(inputs=inputs[:, None], outputs=outputs[:, None])
    still = unmoved([fitted], [unseen])
    assert bool(still) == is_still
    found = decide(replace(evidence(proofs=[proof()]), still=still))
    assert found.name == ("cannot tell" if is_still else "supported")
    assert (found.next_experiment == MOVING) == is_still
    assert (found.proofs[0].reason == "the unseen data stand still and confirm no law") == is_still


@pytest.mark.parametrize(
    ("earlier", "p_value", "name"),
    [(20.0, 1e-6, "supported"), (60.0, 1e-6, "cannot tell"), (60.0, 0.5, "nothing missing")],
)
def test_what_says_no_more_than_inputs_that_act_before_they_are_recorded_is_no_law(earlier, p_value, name):
    """The proof gains 95 by BIC for a parameter; earlier inputs take none."""
    gain = 0.0 if name == "nothing missing" else 100.0
    found = replace(evidence(proofs=[proof()], p_value=p_value, gain=gain), earlier=EarlierInputs(earlier))
    decided = decide(found)
    assert decided.name == name
    is_told = name != "supported"
    assert ("before they are recorded: no law comes before its cause" in decided.message) == is_told
    assert (decided.next_experiment == AT_ONCE) == is_told
    assert (decided.proofs[0].verdict == "rejected") == is_told


def test_inputs_that_are_many_samples_late_are_told_with_the_time():
    late = EarlierInputs(60.0, 5, 0.05, ("u", "v"))
    decided = decide(replace(evidence(proofs=[proof()]), earlier=late))
    assert decided.name == "cannot tell" and "if `u` and `v` act 0.05 s before" in decided.message
    assert "by as much, 0.05 s" in decided.next_experiment
    alone = decide(replace(evidence(proofs=[proof()]), earlier=replace(late, names=("u",))))
    assert "if `u` acts 0.05 s before" in alone.message


def test_unrelated_load_is_external():
    found = decide(evidence())
    assert found.name == "external disturbance" and found.next_experiment.startswith("Repeat")


@pytest.mark.parametrize(("time_constant", "is_slow"), [(225.0, True), (220.0, False)])
def test_a_load_as_slow_as_can_be_is_not_said_to_be_unrelated(time_constant, is_slow):
    """Of a record of 900 s: such a load comes and goes hardly once."""
    found = decide(evidence(time_constant=time_constant))
    assert found.name == "external disturbance"
    assert (
        "so slowly (over 3.75 min and more) that these recordings hardly tell" in found.message
    ) == is_slow
    assert ("related to no variable" in found.message) != is_slow
    assert found.next_experiment.startswith("Record for several times as long") == is_slow


def test_rejected_proofs_are_no_claim():
    found = decide(evidence(proofs=[proof(verdict="rejected")], p_value=0.1))
    assert found.name == "external disturbance"


def test_significant_search_without_a_proof_cannot_tell():
    found = decide(evidence(proofs=[proof(verdict="rejected")]))
    assert found.name == "cannot tell" and "CoulombFriction at rotor.flange_a: no" in found.message
    assert "longer" in found.next_experiment


def test_nearest_law_of_the_library_is_named_beside_an_unknown_effect():
    found = decide(evidence(proofs=[proof(verdict="rejected")], related=True))
    assert found.name == "unknown effect" and "nearest of the library is CoulombFriction" in found.message
    far = replace(proof(verdict="rejected"), explained=0.1)
    assert "nearest" not in decide(evidence(proofs=[far], related=True)).message


@pytest.mark.parametrize("against", ["", "unseen data are foreseen no better"])
def test_law_that_unseen_data_speak_plainly_against_is_not_the_nearest(against):
    """A saturation at the largest input of the records that were fitted, in records with a larger one."""
    worse = replace(proof(verdict="rejected"), ahead=(Ahead(1, 0.05, 1.1, -1.0), Ahead(10, 0.5, 24.0, -9.0)))
    other = replace(proof("QuadraticDrag", "rejected"), ahead=(Ahead(1, 0.05, 1.1, -1.0),))
    known = evidence(proofs=[worse, other], related=True)
    message = decide(replace(known, rest=replace(known.rest, against_form=against))).message
    assert "nearest of the library is QuadraticDrag" in message
    alone = evidence(proofs=[worse], related=True)
    assert "nearest" not in decide(replace(alone, rest=replace(alone.rest, against_form=against))).message


def test_a_rejected_law_that_foresees_unseen_data_is_named_beside_an_unknown_effect():
    """The smaller error of two, or both where they are alike; none that is above 0.6 of the model's;
    none twice."""
    good, better = (
        replace(proof(name, "rejected", simulated), explained=0.1)
        for name, simulated in (("QuadraticDrag", 0.4), ("CoulombFriction", 0.3))
    )
    message = decide(evidence(proofs=[good, better], related=True)).message
    assert "CoulombFriction at rotor.flange_a foresees the validation data far better" in message
    assert "(error times 0.3)" in message and "although no." in message and "QuadraticDrag" not in message
    alike = replace(good, fit=fit(0.31))
    message = decide(evidence(proofs=[alike, better], related=True)).message
    assert "QuadraticDrag at rotor.flange_a and CoulombFriction at rotor.flange_a foresee the" in message
    again = replace(better, fit=fit(0.31))
    message = decide(evidence(proofs=[better, again], related=True)).message
    assert " CoulombFriction at rotor.flange_a foresees the validation data" in message, "in two forms"
    poor = replace(proof("CoulombFriction", "rejected", 0.6), explained=0.1)
    assert "foresees" not in decide(evidence(proofs=[poor], related=True)).message
    accepted = decide(evidence(proofs=[proof(simulated=0.9), good]))
    assert accepted.name == "supported" and "QuadraticDrag at rotor.flange_a foresees" in accepted.message
    accepted = decide(evidence(proofs=[proof(simulated=0.6), good]))
    assert "foresees" not in accepted.message
    near = decide(evidence(proofs=[proof(verdict="rejected")], related=True)).message
    assert near.count("CoulombFriction") == 1


@pytest.mark.parametrize("against", ["", "unseen data are foreseen 2 times worse over 1 s"])
def test_law_that_the_data_do_not_show_is_neither_the_nearest_nor_told_to_foresee(against):
    """It stands for any other that does the same, whether the curve holds on unseen data or not."""
    vague = [
        replace(proof(verdict="rejected", simulated=simulated), is_known=False) for simulated in (0.3, 0.9)
    ]
    found = evidence(proofs=vague, related=True)
    message = decide(replace(found, rest=replace(found.rest, against_form=against))).message
    assert "foresees" not in message and "nearest" not in message
    known = replace(found, proofs=tuple(replace(p, is_known=True) for p in vague))
    assert "nearest" in decide(replace(known, rest=replace(known.rest, against_form=against))).message


@pytest.mark.parametrize(("simulated", "is_small"), [(0.4, False), (0.95, True)])
def test_only_what_no_law_simulates_better_is_called_small_beside_noise(simulated, is_small):
    """A dead time and a store of heat, each refused for what the other leaves, had been called small beside
    the noise, of which they were the sixtyfold."""
    refused = replace(proof(verdict="rejected", simulated=simulated), is_known=False)
    found = decide(evidence(proofs=[refused]))
    assert found.name == "cannot tell" and "do not prove what" in found.message
    assert ("effect is small" in found.next_experiment) == is_small


def test_a_law_that_explains_little_beside_a_rejected_one_is_not_what_is_missing():
    """A stop is no hardening spring, though it passes every gate, where a part of a sine does far better."""
    other = replace(proof("QuadraticDrag", "rejected", 0.1), delta_bic=400.0)
    found = decide(evidence(proofs=[proof(simulated=0.8), other]))
    assert found.name == "cannot tell" and "larger amplitudes" in found.next_experiment
    assert "QuadraticDrag at rotor.flange_a explains far more (BIC gain 400" in found.message
    left = next(p for p in found.proofs if p.candidate.effect.name == "CoulombFriction")
    assert left.verdict == "not separable" and left.not_separable_from == (other.candidate.label,)
    # Neither a likelihood that is no simulation forbids the claim, nor the other way round.
    for one in (replace(other, fit=fit(0.7)), replace(other, delta_bic=150.0)):
        assert decide(evidence(proofs=[proof(simulated=0.8), one])).name == "supported"


@pytest.mark.parametrize(
    ("ahead", "name"),
    [
        ((Ahead(30, 3.0, 0.5, 2.9),), "cannot tell"),
        ((Ahead(30, 3.0, 0.5, 1.5),), "supported"),  # by no more than chance
        ((Ahead(30, 3.0, 0.5, 2.9), Ahead(100, 10.0, 1.2, -4.0)), "supported"),
        ((Ahead(30, 3.0, 0.9, 2.9),), "supported"),
    ],
)
def test_a_rejected_law_that_foresees_far_better_may_simulate_worse(ahead, name):
    """A late sensor of a vehicle with drag: the drag that the model lacks adds up in the simulation with the
    lag, and a voltage that relaxes, which explains less than half of what the lag does, had been named."""
    lag = replace(proof("QuadraticDrag", "rejected", 1.4), delta_bic=400.0, ahead=ahead)
    found = decide(evidence(proofs=[proof(simulated=0.9), lag]))
    assert found.name == name
    assert ("error of predictions of unseen data times 0.5" in found.message) == (name == "cannot tell")


@pytest.mark.parametrize(
    ("taken", "error", "gain", "name"),
    [
        (0.4, 0.1, 23.0, "cannot tell"),
        (0.1, 0.1, 23.0, "supported"),  # takes hardly more of the load than what is accepted
        (0.4, 0.6, 23.0, "supported"),  # simulates little better
        (0.4, 0.1, -80.0, "supported"),  # the recording is less likely with it
    ],
)
def test_a_law_that_takes_nothing_is_no_claim_beside_one_that_takes_and_simulates(taken, error, gain, name):
    """A servo that sticks just short of its goal: a potentiometer that saturates there was a claim."""
    rests = replace(proof(simulated=0.7), explained=0.06)
    stop = replace(
        proof("QuadraticDrag", "rejected", error), delta_bic=gain, explained=taken, reason="it is so"
    )
    found = decide(evidence(proofs=[rests, stop]))
    assert found.name == name
    assert ("simulates unseen data far better (error times 0.1)" in found.message) == (name == "cannot tell")
    # Nothing is left that `improve` would put into the model.
    assert all(p.verdict == "rejected" for p in found.proofs) == (name == "cannot tell")


def test_second_effect_behind_a_supported_one_is_told():
    form = evidence(related=True).rest.form
    found = decide(evidence(proofs=[replace(proof(), left=form)]))
    assert found.name == "supported" and "Something else is missing besides" in found.message


@pytest.mark.parametrize(("one_step_of_fit", "name"), [(0.95, "nothing missing"), (0.5, "unknown effect")])
def test_an_observer_that_takes_long_to_find_the_start_hides_nothing(one_step_of_fit, name):
    """The simulation of unseen data is as good as their one-step prediction; this is the noise of the
    sensors only where it is as good as on the data of the fit."""
    found = evidence(related=True)
    agreements = {
        "estimation": Agreement({"phi": 99.0}, {"phi": one_step_of_fit}),
        "validation": Agreement({"phi": 90.0}, {"phi": 1.0}),
    }
    found = replace(found, baseline=replace(found.baseline, one_step=agreements))
    assert decide(found).name == name


def test_another_hold_is_kept_only_where_it_has_a_law_that_says_as_much():
    def with_likelihood(value, verdict="supported"):
        own = proof(verdict=verdict)
        return replace(own, fit=replace(own.fit, log_likelihood=value))

    first = (with_likelihood(10.0),)
    assert says_as_much([with_likelihood(12.0)], first)
    assert not says_as_much([with_likelihood(8.0)], first)
    assert not says_as_much([with_likelihood(12.0, "rejected")], first)
    assert not says_as_much([], first)


def simulated(is_noise, **known):
    """Evidence of a diagnosis by simulation: of an FMU, or of a model with events."""
    return replace(evidence(**known), rest=Residual(lambda: is_noise, "FMU"), is_closed=True)


def test_fmu_is_judged_by_the_rules_of_equations():
    assert decide(simulated(True)).name == "nothing missing"
    assert decide(simulated(False)).name == "external disturbance"
    assert decide(simulated(False, proofs=[proof()])).name == "supported"
    moved = FittedParameter("J", 2.0, 0.01, 1.0, "kg.m2", None, None, None)
    assert decide(simulated(True, parameters=(moved,), fitted={"J": 1.0})).name == "parameters off"
    untold = decide(replace(simulated(False, proofs=[proof()]), unproved=(untried(31.0),)))
    assert untold.name == "cannot tell"
    assert "daest extend" not in untold.next_experiment, "nothing can be put into an FMU"


@pytest.mark.parametrize(("adds_up", "holding"), [(False, ()), (True, ()), (True, ("v",))])
def test_a_simulation_that_gets_worse_is_told_as_worse(monkeypatch, adds_up, holding):
    errors = [Agreement({}, {"phi": 1.0, "v": 0.4}), Agreement({}, {"phi": 1.57, "v": 0.1})]
    monkeypatch.setattr(told_laws, "error_ratio", lambda evidence, proof: 1.57)
    fits = [SimpleNamespace(simulated={"validation": agreement}) for agreement in errors]
    monkeypatch.setattr(told_laws, "told_fits", lambda evidence, proof: fits)
    ahead = (Ahead(50, 0.2, 0.28, 9.0),)
    proof = SimpleNamespace(ahead=ahead, adds_up=adds_up, is_by_use=False, holding=holding)
    text = told_laws.importance_told(SimpleNamespace(clock="s"), proof)
    assert "removes 72 % of the error of predictions 0.2 s ahead." in text
    assert "whole simulation gets 1.57 times larger" in text and ("it adds up" in text) == adds_up
    assert ("; that of v, which does not, gets 75 % smaller." in text) == bool(holding)


@pytest.mark.parametrize("asked", [WIDER_BAND, OTHER_AMPLITUDES, "Wait."])
@pytest.mark.parametrize("inputs", [(), ("u",)])
def test_a_model_without_inputs_is_not_to_be_driven(asked, inputs):
    """What cools down in a mug has no input to excite; where it begins can be chosen."""
    null = SimpleNamespace(flat=SimpleNamespace(inputs=inputs))
    decided = Decided("unknown effect", "Something dynamic is missing.", asked)
    told = examine._next_experiment(SimpleNamespace(null=null), decided, SimpleNamespace(seed=0))
    is_other = not inputs and asked != "Wait."
    assert (told != asked) == is_other and told.startswith("Begin from other states") == is_other
