"""Hypotheses that are pursued side by side, and effects that later ones make superfluous."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from hidden_plants import library, model, prove, rubbing, some_effects

from daest.diagnosis import improve as improving
from daest.diagnosis.built_in.trials import Trial, prepare, with_kinks_bounded
from daest.diagnosis.hypotheses import extended, hypothesis, rebuilt, searched, together
from daest.diagnosis.null_model.null_observer import run_null
from daest.diagnosis.options import DiagnoseOptions
from daest.diagnosis.refits import rounds as refitting
from daest.diagnosis.refits.rounds import proved_again
from daest.diagnosis.screening.candidates import pairs
from daest.diagnosis.screening.disturbance import place_gains, smoothed_load
from daest.errors import EstimationError
from daest.model.diagnosis import Ahead, Diagnosis, Screen, Screened, Step
from daest.model.fit import Agreement
from daest.modelica.places.sites import sites


@cache
def proof_of(name):
    """Of an effect on the rotor's shaft, in a recording with dry friction alone."""
    stand = rubbing()
    candidate = next(c for c in pairs(some_effects(name), sites(model())) if c.site.name == "rotor.flange_a")
    shape = {p.name: 0.01 for p in candidate.effect.parameters if p.role == "sharpness"}
    trial = Trial(replace(candidate, name=f"hidden_{name}", shape=shape), (0.1,), ())
    run = run_null(stand.null)
    load = smoothed_load(stand.null, run, place_gains(stand.null, run))
    prepared = prepare(stand.null.flat, stand.null.estimated, trial)
    return prove(stand.null, stand.baseline, prepared, stand.null.experiments, stand.validation, run, load)


@cache
def friction_beside_drag():
    """The proof of friction in a model that has drag already."""
    friction = proof_of("CoulombFriction")
    beside = refitting.accept(rubbing(), replace(proof_of("QuadraticDrag"), verdict="supported"))
    return proved_again(beside, friction, friction.told.theta)


def found(proofs, verdict="cannot tell"):
    stand = rubbing()
    return Diagnosis(
        verdict, "said", stand.told, tuple(proofs), Screen((), None, 1.0, 0, ()), (), None, None, "", 1.0
    )


@pytest.fixture
def rounds(monkeypatch):
    """`improve` with the rounds given: a function of the accepted effects to the proofs of the next round."""

    def run(next_proofs, **choices):
        asked = []

        def examine(stand, *_):
            inside = [
                n for n in ("CoulombFriction", "QuadraticDrag") if f"hidden_{n}" in str(stand.null.estimated)
            ]
            asked.append(inside)
            return next_proofs(inside)

        monkeypatch.setattr(improving, "begin", lambda *_: rubbing())
        monkeypatch.setattr(searched, "examine", examine)
        for room in (searched, together):
            monkeypatch.setattr(room, "helps", lambda *_: True)
        monkeypatch.setattr(searched, "better_hold", lambda *_: None)
        monkeypatch.setattr(improving, "unsettled_hold", lambda *_: None)
        result = improving.improve(model(), library(), [], (), DiagnoseOptions(), **choices)
        return result, asked

    return run


@pytest.mark.parametrize(
    "end, more",
    [
        pytest.param("nothing missing", [], marks=pytest.mark.slow),
        ("unknown effect", [["QuadraticDrag"]]),
    ],
    ids=("done", "dead end"),
)
def test_both_of_two_effects_that_are_not_separable_are_pursued(rounds, end, more):
    drag, friction = (
        replace(proof_of(n), verdict="not separable", not_separable_from=("the other",))
        for n in ("QuadraticDrag", "CoulombFriction")
    )

    def next_round(inside):
        return found([], end) if inside else found([drag, friction])

    result, asked = rounds(next_round)
    # The one that the data show is ahead at once, though the other came first, which is taken up again where
    # something is missing still.
    assert asked == [[], ["CoulombFriction"], *more]
    assert [s.proof.candidate.effect.name for s in result.steps if s.proof] == ["CoulombFriction"]
    assert result.steps[1].remark == "not separable from the other" and result.reason == "said"


@pytest.mark.parametrize(
    ("verdict", "factor", "is_asked"),
    [("supported", 0.9, True), ("supported", 0.1, False), ("rejected", 0.9, False), ("rejected", 1.1, True)],
)
def test_another_law_is_begun_with_where_something_is_missing_still(
    rounds, monkeypatch, verdict, factor, is_asked
):
    friction, drag = (proof_of(n) for n in ("CoulombFriction", "QuadraticDrag"))
    friction = replace(friction, verdict="supported", delta_log_likelihood=100.0, delta_bic=100.0)
    gains = {"delta_log_likelihood": 100.0 * factor, "delta_bic": 100.0 * factor, "is_known": True}
    monkeypatch.setattr(searched, "proved_beside", lambda *_: replace(drag, verdict=verdict, **gains))
    leading = [Screened(p.candidate, 9.0, (0.1,), 1e-9, False, 0.1) for p in (drag, friction)]
    screen = Screen(tuple(leading), np.eye(2), 1e-9, 2, ())

    def next_round(inside):
        return replace(found([] if inside else [friction], "unknown effect"), screen=screen)

    _, asked = rounds(next_round)
    assert (["QuadraticDrag"] in asked) == is_asked


def test_an_effect_that_may_stand_for_a_given_value_is_told_with_what_to_do(rounds):
    answer = "another value of `B`, 12 ± 0.05 instead of the 10 that is given"
    law = replace(
        proof_of("CoulombFriction"),
        verdict="not separable",
        not_separable_from=(answer,),
        given_values=("B",),
    )
    result, _ = rounds(lambda inside: found([], "unknown effect") if inside else found([law]))
    assert result.reason == (
        "said CoulombFriction at rotor.flange_a may stand for another value of `B`: before it is believed, "
        "estimate that, too (`B = { estimate = true }` under [parameters] of daest.toml), and repeat this."
    )


def test_improvement_ends_at_its_limit(rounds):
    friction = replace(proof_of("CoulombFriction"), verdict="supported")
    result, asked = rounds(lambda inside: found([] if inside else [friction]), most_effects=1)
    assert len(asked) == 1 and "limit of 1 effects" in result.reason


def test_round_without_anything_to_search_ends_with_the_last_one(rounds):
    friction = replace(proof_of("CoulombFriction"), verdict="supported")

    def next_round(inside):
        if inside:
            raise EstimationError("diagnose-no-candidate", "none")
        return found([friction], "supported")

    result, _ = rounds(next_round)
    assert result.last.verdict == "supported" and "No other effect" in result.reason


@pytest.mark.slow
def test_effect_that_a_later_one_makes_superfluous_is_taken_out(rounds):
    """Drag comes first and stands for the friction; beside the friction nothing of it is left."""
    drag = replace(proof_of("QuadraticDrag"), verdict="supported")

    def next_round(inside):
        if not inside:
            return found([drag], "supported")
        if inside == ["QuadraticDrag"]:
            return found([replace(friction_beside_drag(), verdict="supported")], "supported")
        return found([], "nothing missing")

    result, asked = rounds(next_round)
    assert asked == [[], ["QuadraticDrag"], ["CoulombFriction"]]
    (step,) = [s for s in result.steps if s.proof]
    assert step.proof.candidate.effect.name == "CoulombFriction"
    assert "QuadraticDrag at rotor.flange_a is no longer needed and was taken out" in step.remark
    assert result.last.verdict == "nothing missing"
    own = "hidden_CoulombFriction.tau_c"
    alone = proof_of("CoulombFriction").told.theta[own]
    assert step.proof.told.theta[own] == pytest.approx(alone, rel=0.1)


@pytest.mark.parametrize("is_worse", [False, True])
def test_likelier_effect_takes_the_place_of_one_that_has_stood_for_it(rounds, is_worse):
    """Drag comes first though others could not be told from it; beside it friction, which is what acts, is
    refused since unseen data are foreseen no better."""
    drag = replace(proof_of("QuadraticDrag"), verdict="supported", not_separable_from=("friction",))
    ahead = (Ahead(10, 0.1, 1.2 if is_worse else 1.0, -9.0 if is_worse else 0.1),)

    def next_round(inside):
        if not inside:
            return found([drag], "supported")
        if inside == ["QuadraticDrag"]:
            refused = replace(friction_beside_drag(), verdict="rejected", reason="no better", ahead=ahead)
            return found([refused])
        return found([], "nothing missing")

    result, asked = rounds(next_round)
    (step,) = [s for s in result.steps if s.proof]
    if is_worse:
        assert asked == [[], ["QuadraticDrag"]] and step.proof is drag
        return
    assert asked == [[], ["QuadraticDrag"], ["CoulombFriction"]]
    assert step.proof.candidate.effect.name == "CoulombFriction" and step.proof.verdict == "supported"
    assert "in place of QuadraticDrag at rotor.flange_a, which had stood for it" in step.remark


def path(bic, rms, adds_up=False, steps=None):
    agreement = {"validation": Agreement({}, {"y": rms})}
    told = SimpleNamespace(simulated=agreement)
    stand = SimpleNamespace(told=told, reference=SimpleNamespace(adds_up=adds_up))
    return SimpleNamespace(stand=stand, bic=bic, steps=steps or (f"of {bic}, {rms}",))


def test_unseen_data_come_before_the_likelihood(monkeypatch):
    doubted: list = []
    monkeypatch.setattr(hypothesis, "doubtful_steps", lambda steps: [0] if steps in doubted else [])
    likely, foresees = path(-1000.0, 1.0), path(-900.0, 0.5)
    assert hypothesis._is_ahead(foresees, likely) and not hypothesis._is_ahead(likely, foresees)
    alike = path(-900.0, 0.99)
    assert hypothesis._is_ahead(likely, alike) and not hypothesis._is_ahead(alike, likely)
    # Where a simulation is dead reckoning, it says nothing.
    reckoned = path(-900.0, 0.5, adds_up=True)
    assert hypothesis._is_ahead(path(-1000.0, 1.0, adds_up=True), reckoned)
    close = path(-1003.0, 1.0)
    assert not hypothesis._is_ahead(close, likely) and hypothesis.leading([likely, close]) == [likely, close]
    assert hypothesis.leading([likely, alike, foresees]) == [foresees]
    # Three laws may do what two others do: these are not to be clearly likelier.
    long, short = path(-1000.0, 1.0, steps=(0, 1, 2, 3)), path(-1003.0, 1.0, steps=(0, 1, 2))
    assert hypothesis.leading([long, short])[0] is short and not hypothesis._is_ahead(long, short)
    assert not hypothesis._is_ahead(path(-999.0, 1.0, steps=(0, 1, 2)), long)
    assert not hypothesis._is_ahead(path(-1003.0, 1.2, steps=(0, 1, 2)), long)
    # What an effect makes likelier of which nothing is known any more is no better for it.
    doubted.append(likely.steps)
    assert not hypothesis._is_ahead(likely, alike) and hypothesis.leading([alike, likely]) == [alike, likely]
    assert hypothesis._is_ahead(foresees, likely)


def test_lists_that_explain_all_as_well_are_told():
    """A loss of cells that grows with their square, and what their growth lacks, had been named alone beside
    the death of cells and an inflow of sugar."""

    def ended(*labels, verdict="nothing missing"):
        steps = [SimpleNamespace(proof=None)] + [
            SimpleNamespace(proof=SimpleNamespace(candidate=SimpleNamespace(label=label))) for label in labels
        ]
        return hypothesis.Hypothesis(
            None, tuple(steps), SimpleNamespace(verdict=verdict), "Nothing is missing."
        )

    best = ended("Drag at w", "Offset at u")
    others = [ended("Friction at w", "Load at w"), ended("Offset at u", "Drag at w"), ended("Lag at u")]
    assert searched._beside_others([best, *others]).reason == (
        "Nothing is missing. These data do not tell this list from Friction at w, then Load at w or Lag at u."
    )
    assert searched._beside_others([best, ended("Lag at u", verdict="unknown effect")]) is best
    open_ended = ended("Drag at w", verdict="unknown effect")
    assert searched._beside_others([open_ended, *others]) is open_ended


def test_effect_is_doubtful_once_no_size_of_it_is_certain():
    proof = proof_of("CoulombFriction")
    own = f"{proof.candidate.name}.tau_c"

    def after(**changes):
        parameters = [replace(p, **changes) if p.name == own else p for p in proof.fit.parameters]
        return Step(None, replace(proof.fit, parameters=tuple(parameters)), None, "")

    first = Step(proof, proof.fit, found([proof]), "supported")
    asis = Step(None, proof.fit, None, "")
    assert hypothesis.doubtful_steps([asis, first, after()]) == []
    assert hypothesis.doubtful_steps([asis, first, after(value=0.1, std_error=0.05)]) == [1]
    assert hypothesis.doubtful_steps([asis, first, after(std_error=None)]) == [1]
    # A size is certain, too, where its ratio to a parameter is.
    scale = next(p for p in proof.fit.parameters if not p.name.startswith(proof.candidate.name))
    blurred = replace(scale, std_error=0.5 * scale.value)
    both = (blurred, replace(scale, name=own, value=0.1, std_error=0.05))
    names, together = (scale.name, own), np.full((2, 2), 0.9999)
    beside = replace(proof.fit, parameters=both, correlation_names=names, correlation=together)
    unknown = replace(asis, fit=replace(proof.fit, parameters=(blurred,)))
    assert hypothesis.doubtful_steps([unknown, first, Step(None, beside, None, "")]) == []
    # What the recordings themselves show needs no size.
    assert hypothesis.doubtful_steps([asis, replace(first, diagnosis=None), after(std_error=None)]) == []


@pytest.mark.parametrize(
    ("std_error", "bic", "verdict", "is_taken"),
    [
        (0.02, -1010.0, "supported", True),
        (0.02, -990.0, "supported", False),  # less likely with the simpler law
        (0.02, -1010.0, "rejected", False),  # beside which the last effect is none
        (0.001, -1010.0, "supported", False),  # all of the richer law is certain
    ],
)
def test_simpler_law_takes_the_place_of_one_that_had_bent(monkeypatch, std_error, bic, verdict, is_taken):
    """A Stribeck curve stands for dry friction and a drag; beside the drag nothing is left of its form."""
    simple, last = proof_of("CoulombFriction"), replace(proof_of("QuadraticDrag"), verdict=verdict)
    candidate = replace(simple.candidate, effect=next(iter(some_effects("StribeckFriction"))), name="rich")
    rich = replace(simple, candidate=candidate)
    own = replace(simple.fit.parameters[-1], name=candidate.estimated[1], value=0.03, std_error=std_error)
    fit = replace(simple.fit, parameters=(own,))
    first = Step(rich, rich.fit, found([rich, replace(simple, verdict="rejected")]), "supported")
    steps = (Step(None, rich.fit, None, ""), first, Step(last, fit, found([last]), "supported"))
    bent = path(-1000.0, 1.0, steps=steps)
    other = hypothesis.Hypothesis(bent.stand, steps)
    monkeypatch.setattr(hypothesis.Hypothesis, "bic", bic)
    asked = []
    monkeypatch.setattr(rebuilt, "_rebuilt", lambda _, __, *which: asked.append(which) or other)
    task = SimpleNamespace(first=steps[:1], progress=lambda _: None)
    taken = rebuilt.with_simpler(task, bent)
    assert asked == ([] if std_error < 0.01 else [(1, replace(simple, verdict="rejected"))])
    assert (taken is not bent) == is_taken
    if is_taken:
        assert "in place of StribeckFriction at rotor.flange_a, which had bent to QuadraticDrag" in (
            taken.steps[1].remark
        )


def test_a_model_that_cannot_be_fitted_again_ends_the_improvement_and_loses_nothing(rounds, monkeypatch):
    friction = replace(proof_of("CoulombFriction"), verdict="supported")

    def fails(*_):
        raise EstimationError("identify-no-start", "it cannot be simulated")

    monkeypatch.setattr(extended, "accept", fails)
    result, _ = rounds(lambda _: found([friction], "supported"))
    assert [s.proof for s in result.steps] == [None]
    assert "no further fit of the model with it ends" in result.reason


def test_no_kink_is_fitted_that_no_recording_shows():
    prepared = prepare(
        rubbing().null.flat,
        rubbing().null.estimated,
        Trial(proof_of("CoulombFriction").candidate, (0.1,), ()),
    )
    (bounded,) = [
        p
        for p in with_kinks_bounded(prepared.flat, [prepared.trial.candidate]).parameters
        if p.name == "hidden_CoulombFriction.w_s"
    ]
    assert bounded.min == pytest.approx(0.01 * 0.01) and bounded.value > bounded.min


@pytest.mark.parametrize(
    ("std_error", "rms", "is_refused"), [(None, 1.35, True), (None, 1.0, False), (1e-3, 1.35, False)]
)
def test_effect_that_leaves_nothing_of_an_earlier_one_simulates_no_worse(std_error, rms, is_refused):
    """A lag of a sensor left nothing of the walls of a heated box, and the error was 1.35 times larger."""
    proof = proof_of("CoulombFriction")
    own = f"{proof.candidate.name}.tau_c"
    fit = replace(
        proof.fit,
        parameters=tuple(
            replace(p, std_error=std_error) if p.name == own else p for p in proof.fit.parameters
        ),
    )
    first = Step(proof, proof.fit, found([proof]), "supported")
    asis = Step(None, proof.fit, None, "")
    before = path(0.0, 1.0, steps=(asis, first))
    further = Step(proof_of("QuadraticDrag"), fit, found([proof]), "supported")
    after = path(-1.0, rms, steps=(asis, first, further))
    assert extended.displaces(before, after) == is_refused
    if is_refused:
        said = extended.displaced(before, after)
        assert "leaves nothing certain of CoulombFriction at rotor.flange_a" in said and "1.35 times" in said


@pytest.mark.parametrize(
    ("adds_up", "factor", "is_told"), [(True, 2.0, True), (False, 2.0, False), (True, 1.0, False)]
)
def test_ledger_tells_that_a_simulation_gets_worse_though_a_law_is_supported(adds_up, factor, is_told):
    proof = replace(proof_of("CoulombFriction"), adds_up=adds_up)
    step = Step(proof, proof.told, found([proof]), "supported")
    better = replace(proof.told, simulated=scaled(proof.told.simulated, 1.0 / factor))
    before = hypothesis.Hypothesis(SimpleNamespace(told=better), ())
    said = extended._noted(before, hypothesis.Hypothesis(SimpleNamespace(), (step,))).steps[-1].remark
    assert said.startswith("supported") and ("add up, gets 2 times worse" in said) == is_told


@cache
def with_friction():
    """The stand with friction in its model."""
    return refitting.accept(rubbing(), replace(proof_of("CoulombFriction"), verdict="supported"))


@pytest.mark.parametrize(("certainty", "is_taken"), [(-9.0, False), (-0.1, True)])
def test_kinks_are_not_refitted_where_unseen_data_are_foreseen_worse_by_it(monkeypatch, certainty, is_taken):
    friction, stand = proof_of("CoulombFriction"), with_friction()
    monkeypatch.setattr(refitting, "bic_gain", lambda *_: 100.0)
    monkeypatch.setattr(refitting, "compared", lambda *_: (Ahead(10, 0.1, 1.2, certainty),))
    assert (refitting.with_kinks(stand, [friction.candidate]) is not None) == is_taken


def scaled(simulated, factor):
    return {
        name: replace(part, rms={y: factor * value for y, value in part.rms.items()})
        for name, part in simulated.items()
    }


@pytest.mark.parametrize("verdict", ["supported", "cannot tell"])
def test_round_that_the_time_cuts_short_adds_what_leads_all_others(rounds, verdict):
    friction = replace(proof_of("CoulombFriction"), verdict="supported")
    result, asked = rounds(lambda _: replace(found([friction], verdict), is_whole=False))
    assert asked == [[]] and result.reason.startswith("The time was up before all candidates of a round")
    added = [s.proof.candidate.effect.name for s in result.steps if s.proof]
    assert added == (["CoulombFriction"] if verdict == "supported" else [])


@pytest.mark.parametrize(
    ("refused", "gains"),
    [((), True), pytest.param(("QuadraticDrag",), True, marks=pytest.mark.slow), ((), False)],
)
def test_pair_is_added_where_each_is_accepted_beside_the_other(rounds, monkeypatch, refused, gains):
    proofs = {name: proof_of(name) for name in ("CoulombFriction", "QuadraticDrag")}
    entries = tuple(SimpleNamespace(candidate=p.candidate, sizes=(0.1,)) for p in proofs.values())

    def beside(stand, trial, values, sharper):
        name = trial.candidate.effect.name
        is_alone = "hidden" not in str(stand.null.estimated)
        is_accepted = not is_alone and name not in refused
        return replace(proofs[name], verdict="supported" if is_accepted else "rejected", reason="too little")

    monkeypatch.setattr(together, "promising_pairs", lambda _: [] if beside.done else [entries])
    monkeypatch.setattr(together, "proved_beside", beside)
    monkeypatch.setattr(together, "gains_beside", lambda *_: gains)
    judged = []
    monkeypatch.setattr(
        together,
        "without_superfluous",
        lambda _, path: judged.append(hypothesis.labels_of(path)) or path,
    )
    beside.done = False

    def next_round(inside):
        beside.done = bool(inside)
        return found([], "cannot tell")

    result, _ = rounds(next_round)
    added = [step for step in result.steps if step.proof]
    assert [s.proof.candidate.effect.name for s in added] == (list(proofs) if gains and not refused else [])
    if gains and not refused:
        assert added[0].remark == "only together with QuadraticDrag at rotor.flange_a"
        assert added[0].proof.verdict == "supported" and added[0].proof.reason == ""
    # What was added before may be superfluous beside both.
    assert len(judged) == (1 if added else 0)


@pytest.mark.parametrize("is_known", [True, False])
def test_step_whose_sizes_another_fit_does_not_determine_says_so(is_known):
    """The ledger tells the values of that fit: errors larger than sizes would stand beside *supported*."""
    stand, proof = rubbing(), proof_of("CoulombFriction")
    steps = (Step(None, stand.told, None, ""), Step(proof, proof.told, None, "supported"))
    blurred = tuple(
        replace(p, std_error=20.0 * abs(p.value)) if p.name.startswith("hidden_") else p
        for p in proof.told.parameters
    )
    told = proof.told if is_known else replace(proof.told, parameters=blurred)
    again = SimpleNamespace(null=stand.null, baseline=proof.fit, told=told)
    last = rebuilt.refitted(hypothesis.Hypothesis(stand, steps), again, "refitted: held").steps[-1]
    assert last.remark.startswith("supported; refitted: held")
    assert last.remark.endswith("with which the data determine none of its parameters") != is_known


@pytest.mark.parametrize(
    ("before", "after", "helps"),
    [
        ((0.208, 2.85), (0.029, 2.91), True),  # the second output waits for another effect
        ((0.208, 2.85), (0.195, 2.91), False),
        ((0.208, 2.85), (0.029, 3.4), False),  # which it makes worse
        ((0.208, 2.85), (0.029, 4.0), False),
        ((0.208, 2.85), (0.208, 2.85), False),
    ],
)
def test_an_effect_helps_that_makes_all_errors_together_clearly_smaller(monkeypatch, before, after, helps):
    monkeypatch.setattr(hypothesis, "is_likelier", lambda told: False)

    def simulated(rms):
        named = dict(zip(("u", "ocv"), rms, strict=True))
        return SimpleNamespace(simulated={"validation": Agreement({}, named)})

    proof = SimpleNamespace(told=simulated(after), ahead=(), confirmed=None)
    assert hypothesis.helps(simulated(before), proof) == helps
