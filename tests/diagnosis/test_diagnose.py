"""Diagnoses from end to end on small records whose truth is known."""

from dataclasses import dataclass, replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from hidden_plants import (
    DAMPING,
    INERTIA,
    PERIOD,
    library,
    model,
    rotor_null,
    rotor_record,
    some_effects,
    torque_steps,
)
from scipy.signal import cont2discrete, dlsim, tf2ss

from daest.diagnosis.built_in.chosen import _is_new_signal
from daest.diagnosis.built_in.trials import Prepared
from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.examine import _told_by_rest
from daest.diagnosis.improve import improve
from daest.diagnosis.options import DiagnoseOptions
from daest.diagnosis.recordings.holds import says_more, unsettled_hold
from daest.diagnosis.refits import attempts, in_use
from daest.diagnosis.refits import search as search_module
from daest.diagnosis.refits import stages as stages_module
from daest.diagnosis.refits.attempts import proof_by_attempts
from daest.diagnosis.refits.rivals import _without_unseen_scales
from daest.diagnosis.refits.search import Search
from daest.diagnosis.refits.stages import Stages
from daest.errors import EstimationError
from daest.estimation.fitting.records import part_of
from daest.model.diagnosis import Candidate, FreeForm
from daest.model.experiment import Experiment
from daest.modelica.effects.attach import attach
from daest.modelica.effects.catalogue import find_effect
from daest.modelica.places.sites import sites
from daest.report.diagnosis_figures import diagnosis_figure

STATIC = (
    "CoulombFriction",
    "QuadraticDrag",
    "Unbalance",
    "ConstantLoad",
    "DeadZone",
    "Gain",
    "AsymmetricFriction",
)


def options(*effects, **more):
    return DiagnoseOptions(effects=effects or STATIC, hold="zoh", jobs=1, **more)


def diagnosed(record, *effects, **more):
    return diagnose(model(), library(), [record], options=options(*effects, **more))


def accepted(found):
    return {p.candidate.effect.name for p in found.proofs if p.verdict != "rejected"}


@pytest.mark.parametrize(
    "seed", [1, pytest.param(2, marks=pytest.mark.slow), pytest.param(3, marks=pytest.mark.slow)]
)
def test_nothing_is_found_where_nothing_is_missing(seed):
    found = diagnosed(rotor_record(600, seed=seed)[0])
    assert found.verdict == "nothing missing" and not accepted(found)
    assert "It would have shown" in found.message


@pytest.mark.slow  # tests/cli/test_diagnose_command.py
def test_coulomb_friction_is_named_with_its_size():
    found = diagnosed(rotor_record(600, seed=5, coulomb=lambda phi: 0.15)[0])
    assert found.verdict == "supported" and accepted(found) == {"CoulombFriction"}
    best = found.proofs[0]
    size = next(p for p in best.fit.parameters if p.name.endswith("tau_c"))
    assert size.value == pytest.approx(0.15, rel=0.1)
    assert abs(size.value - 0.15) < 3.5 * size.std_error
    assert {best.candidate.site.name, *best.equivalent} == {"rotor.flange_a", "bearing"}
    # The baseline soaks the friction up in its damping; the effect gives the damping back.
    damping = {p.name: p.value for p in found.baseline.parameters}["d"]
    assert damping > 0.4
    assert {p.name: p.value for p in best.fit.parameters}["d"] == pytest.approx(0.3, rel=0.1)


@pytest.mark.slow
def test_friction_is_a_term_of_a_bare_equation():
    record, _ = rotor_record(1200, seed=5, coulomb=lambda phi: 0.15)
    chosen = options("CoulombFriction", "QuadraticDrag", "DeadZone")
    found = diagnose(model("BareRotor"), library(), [record], options=chosen)
    assert found.verdict == "supported" and accepted(found) == {"CoulombFriction"}
    assert found.proofs[0].candidate.site.name == "1:w"
    size = next(p for p in found.proofs[0].fit.parameters if p.name.endswith("tau_c"))
    assert size.value == pytest.approx(0.15, rel=0.1)


@pytest.mark.slow
def test_drag_is_named_or_in_the_set():
    found = diagnosed(rotor_record(1200, seed=6, torque=lambda w, phi: -0.15 * w * abs(w))[0])
    assert found.verdict in ("supported", "cannot tell") and "QuadraticDrag" in accepted(found)


@pytest.mark.slow
def test_dead_zone_of_the_drive_is_found_at_the_input():
    dead = lambda u: np.sign(u) * max(abs(u) - 0.2, 0.0)  # noqa: E731
    found = diagnosed(rotor_record(1200, seed=7, drive=dead)[0], "DeadZone", "CoulombFriction")
    assert accepted(found) == {"DeadZone"}
    assert found.proofs[0].candidate.site.name == "u"


@pytest.mark.slow  # test_verdict.py; its curve: test_learned.py
def test_effect_outside_the_library_gets_a_curve_and_no_name():
    record, _ = rotor_record(800, seed=8, coulomb=lambda phi: 0.2)
    found = diagnosed(record, "Unbalance", "ConstantLoad", "Gain")
    assert found.verdict == "unknown effect" and not accepted(found)
    formula = found.learned.formula
    assert "rotor.w" in formula.text and formula.text in found.message and formula.left < 0.2
    curve = found.disturbance
    assert curve.variable == "rotor.w" and curve.place == "rotor.flange_a"
    values = {p.name: p.value for p in found.baseline.parameters}
    # What is left of the friction when the damping has taken its part.
    true = -0.2 * np.tanh(curve.x / 0.02) + (values["d"] - 0.3) * curve.x
    clear = np.abs(curve.x) > 0.1
    assert np.mean(np.abs(curve.w - true)[clear] < 3.0 * curve.std[clear]) >= 0.9
    assert np.corrcoef(curve.w[clear], true[clear])[0, 1] > 0.9


@pytest.mark.parametrize("seed", [11, pytest.param(12, marks=pytest.mark.slow)])
def test_external_load_is_no_effect(seed):
    found = diagnosed(rotor_record(800, seed=seed, load=(0.15, 1.0))[0])
    assert found.verdict in ("external disturbance", "nothing missing") and not accepted(found)


@pytest.mark.slow  # test_slow_loads.py
def test_constant_load_is_named_where_nothing_holds_the_angle():
    # A slow load takes it, so that one sample ahead the innovations show nothing.
    found = diagnosed(rotor_record(800, seed=14, torque=lambda w, phi: -0.05)[0])
    assert found.verdict == "supported" and accepted(found) == {"ConstantLoad"}
    torque = next(p for p in found.proofs[0].fit.parameters if p.name.endswith("tau_0"))
    assert abs(torque.value - 0.05) < 3.5 * torque.std_error < 0.025
    entry = next(e for e in found.screen.entries if e.candidate.effect.name == "ConstantLoad")
    assert entry.p_value > 0.05


class Bristles:
    """Dry friction with elastic presliding (Dahl), as a torque over the path."""

    def __init__(self, tau, deflection):
        self.tau, self.deflection, self.z, self.last = tau, deflection, 0.0, 0.0

    def __call__(self, w, phi):
        step, self.last = phi - self.last, phi
        self.z += (step - abs(step) * self.z) / self.deflection
        return -self.tau * self.z


@pytest.mark.slow  # what is left out: the test below
def test_bristles_are_named_without_the_excess_that_they_do_not_have():
    record, _ = rotor_record(800, seed=21, torque=Bristles(0.15, 0.3))
    found = diagnosed(record, "LuGreFriction", "CoulombFriction", "QuadraticDrag")
    assert found.verdict == "supported" and accepted(found) == {"LuGreFriction"}
    values = {p.name.rpartition(".")[2]: p for p in found.proofs[0].told.parameters}
    assert "b" not in values and "w_st" not in values
    for name, true in (("tau_c", 0.15), ("phi_b", 0.3)):
        assert abs(values[name].value - true) < 3.0 * values[name].std_error < 0.3 * true


@pytest.mark.parametrize(
    ("unseen", "held"),
    [(("w_st",), {"w_st": 0.1, "b": 0.0}), (("phi_b", "w_st"), {}), ((), {})],
    ids=["excess", "bristles", "none"],
)
def test_law_goes_on_without_a_scale_that_the_recordings_do_not_show(monkeypatch, unseen, held):
    """What is larger at low speed is nothing where no speed is high; bristles are not bristles without their
    deflection."""
    null = rotor_null(rotor_record(200, seed=21)[0])[0]
    effect = find_effect("Rotational.LuGreFriction")
    (site,) = [s for s in sites(null.flat) if s.name == "rotor.flange_a" and s.kind == "node"]
    candidate = Candidate(effect, site, "effect_1", {"phi_b": 0.3, "b": 0.5, "w_st": 0.1})
    values = {"tau_c": 0.1, "phi_b": 0.3, "b": 0.06, "w_st": 0.1}
    flat = attach(null.flat, effect, site, "effect_1", values)
    fitted = [replace(null.fit.parameters[0], name=f"effect_1.{n}", value=v) for n, v in values.items()]
    fit = replace(null.fit, parameters=tuple(fitted))
    proof = SimpleNamespace(candidate=candidate, flat=flat, fit=fit, told=fit)
    found = {name: (values[name], 0.01) for name in unseen}
    monkeypatch.setattr("daest.diagnosis.refits.rivals.unseen_scales", lambda *_: found)
    assert _without_unseen_scales(null, proof) == held


@pytest.mark.slow
def test_strong_white_torque_is_no_effect():
    found = diagnosed(rotor_record(1200, seed=13, noise=30e-4)[0])
    assert found.verdict in ("external disturbance", "nothing missing") and not accepted(found)


@pytest.mark.slow
def test_expected_noise_is_no_finding():
    """The declared intensity of the model is what it expects."""
    found = diagnosed(rotor_record(1200, seed=14, noise=4e-4)[0])
    assert found.verdict == "nothing missing"


@pytest.mark.slow
def test_wrong_gain_of_the_encoder_is_no_friction():
    """Inertia and damping take it all: the model has no other scale."""
    found = diagnosed(rotor_record(1000, seed=15, measured=lambda phi: 1.2 * phi)[0])
    assert found.verdict == "nothing missing"
    assert {p.name: p.value for p in found.baseline.parameters}["J"] == pytest.approx(0.5 / 1.2, rel=0.1)


@pytest.mark.slow  # test_verdict.py
def test_values_that_the_data_contradict_are_off():
    found = diagnosed(rotor_record(1000, seed=1)[0], "CoulombFriction", fitted={"J": 0.6, "d": 0.3})
    assert found.verdict == "parameters off" and "J = 0.6 given" in found.message


@pytest.mark.slow
def test_closed_loop_record_gives_no_false_name():
    found = diagnosed(rotor_record(1000, seed=16, feedback=2.0)[0])
    assert not accepted(found)


@pytest.mark.slow
def test_friction_is_found_in_closed_loop():
    found = diagnosed(rotor_record(1200, seed=17, feedback=2.0, coulomb=lambda phi: 0.15)[0])
    assert "CoulombFriction" in accepted(found)


@pytest.mark.slow
def test_two_effects_are_found_in_two_rounds():
    record, _ = rotor_record(
        1600, seed=18, coulomb=lambda phi: 0.15, torque=lambda w, phi: -0.3 * np.sin(phi)
    )
    effects = ("CoulombFriction", "Unbalance", "ConstantLoad")
    found = improve(model(), library(), [record], options=options(*effects))
    names = [s.proof.candidate.effect.name for s in found.steps if s.proof]
    assert sorted(names) == ["CoulombFriction", "Unbalance"]
    errors = [s.fit.simulated["validation"].rms["phi"] for s in found.steps]
    assert errors == sorted(errors, reverse=True)
    assert found.last.verdict in ("nothing missing", "external disturbance")
    assert errors[-1] < errors[0] / 5.0


@pytest.mark.slow  # test_screen.py (that the model estimates already)
def test_the_only_effect_is_added_once():
    record, _ = rotor_record(700, seed=5, coulomb=lambda phi: 0.15)
    found = improve(model("BareRotor"), library(), [record], options=options("CoulombFriction"))
    assert [s.proof.candidate.site.name for s in found.steps if s.proof] == ["1:w"]
    assert found.last.screen.entries == () and found.last.screen.n_screened == 0
    (label, reason) = found.last.screen.skipped[0]
    assert label == "CoulombFriction at 1:w" and "already" in reason
    figure = diagnosis_figure(found.last, {"phi": "rad"})
    assert " ".join(figure.get_suptitle().split()).endswith(found.last.message)


@pytest.mark.slow
def test_every_phase_of_a_periodic_effect_is_tried():
    found = diagnosed(
        rotor_record(1000, seed=20, torque=lambda w, phi: -0.2 * np.sin(3.0 * phi))[0], "CoggingTorque"
    )
    assert accepted(found) == {"CoggingTorque"}
    values = {p.name.rpartition(".")[2]: p.value for p in found.proofs[0].fit.parameters}
    assert found.proofs[0].candidate.shape["n"] == 3.0 and values["tau_k"] == pytest.approx(0.2, rel=0.15)


@pytest.mark.slow
def test_validation_data_of_its_own_are_used():
    whole, _ = rotor_record(1200, seed=5, coulomb=lambda phi: 0.15)
    parts = [part_of(whole, 0, 600), part_of(whole, 600, 1200)]
    halves = diagnosed(whole, "CoulombFriction")
    given = diagnose(model(), library(), parts[:1], parts[1:], options("CoulombFriction"))
    assert given.proofs[0].delta_bic == pytest.approx(halves.proofs[0].delta_bic, rel=1e-6)


@pytest.mark.slow  # tests/cli/test_diagnose_command.py
def test_restriction_to_places():
    found = diagnosed(rotor_record(600, seed=1)[0], places=("u",))
    assert {e.candidate.site.name for e in found.screen.entries} == {"u"}


def test_too_short_a_record_is_refused():
    with pytest.raises(EstimationError) as caught:
        diagnosed(rotor_record(75, seed=1)[0])
    assert caught.value.code == "diagnose-too-short" and "100 samples" in caught.value.remedy
    assert "more of the 75 that there are estimate: --split 0.67" in caught.value.remedy
    with pytest.raises(EstimationError) as caught:
        diagnosed(rotor_record(52, seed=1)[0])
    assert "--split" not in caught.value.remedy
    assert "100 samples in all (50% of them are kept for validation; 56 where it is 10%)" in (
        caught.value.remedy
    )
    whole = rotor_record(75, seed=1)[0]
    with pytest.raises(EstimationError) as caught:  # what validates is there: half as many are enough
        diagnose(model(), library(), [part_of(whole, 0, 25)], [part_of(whole, 25, 75)], options())
    assert "at least 50 samples beside those that validate" in caught.value.remedy


def test_samples_that_are_asked_for_count_the_share_that_is_kept_back():
    """Fifty samples are enough to diagnose from, and not with those that validate among them."""
    whole = rotor_record(50, seed=1)[0]
    parts = part_of(whole, 0, 40), replace(part_of(whole, 40, 50), name="record (validation)")
    with pytest.raises(EstimationError) as caught:
        diagnose(model(), library(), parts[:1], parts[1:], options())
    assert "at least 63 samples in all (20% of them are kept for validation" in caught.value.remedy


def test_share_that_is_enough_is_one_of_the_time_of_the_same_recordings():
    record = rotor_record(75, seed=1)[0]
    step = record.time[1] - record.time[0]
    paused = replace(record, time=record.time + np.where(np.arange(75) < 40, 0.0, 25.0 * step))
    with pytest.raises(EstimationError) as caught:
        diagnosed(paused)
    assert "more of the 75 that there are estimate: --split 0.75" in caught.value.remedy
    parts = part_of(record, 0, 37), replace(part_of(record, 37, 75), name="other run")
    with pytest.raises(EstimationError) as caught:  # which --split would leave out
        diagnose(model(), library(), parts[:1], parts[1:], options("CoulombFriction"))
    assert "--split" not in caught.value.remedy


def test_outputs_that_never_change_are_refused():
    record, _ = rotor_record(600, seed=1)
    still = replace(record, outputs=np.full_like(record.outputs, 0.3))
    with pytest.raises(EstimationError) as caught:
        diagnosed(still)
    assert caught.value.code == "diagnose-unseen" and "never change" in caught.value.what


@pytest.mark.slow  # test_screen.py
def test_unknown_effect_name_leaves_no_candidate():
    with pytest.raises(EstimationError) as caught:
        diagnosed(rotor_record(600, seed=1)[0], "NoSuchEffect")
    assert caught.value.code == "diagnose-no-candidate"


@pytest.mark.slow
def test_measured_column_that_pushes_is_found():
    record, _ = rotor_record(600, seed=19)
    wind = np.sin(0.7 * record.time) + 0.5 * np.sin(0.23 * record.time)
    J, d, period = 0.5, 0.3, record.time[1]
    # Linear: the answer to the wind adds up (exact for a torque held over a sample).
    decay = np.exp(-d / J * period)
    w, angle, response = 0.0, 0.0, np.zeros(record.n_samples)
    for k, torque in enumerate(0.2 * wind):
        response[k] = angle
        end = torque / d
        angle += end * period + (w - end) * (1 - decay) * J / d
        w = end + (w - end) * decay
    pushed = replace(record, outputs=record.outputs + response[:, None], extra={"wind": wind})
    found = diagnosed(pushed, "MeasuredTorque", "CoulombFriction")
    assert accepted(found) == {"MeasuredTorque"}
    size = next(p for p in found.proofs[0].fit.parameters if p.name.endswith(".k"))
    assert size.value == pytest.approx(0.2, rel=0.1)


@pytest.mark.slow
def test_law_of_a_measured_column_that_leaves_a_curve_is_refused():
    record, truth = rotor_record(1200, seed=5, coulomb=lambda phi: 0.15)
    found = diagnosed(replace(record, extra={"column": truth["w"] * abs(truth["w"])}), "MeasuredTorque")
    (proof,) = found.proofs
    assert proof.reason.startswith("another law acts there: what it leaves still follows rotor.w")


def test_effects_of_the_tests_are_in_the_library():
    assert {e.name for e in some_effects(*STATIC)} == set(STATIC)


def test_columns_that_repeat_what_is_measured_are_no_causes():
    record, _ = rotor_record(1200, seed=3)
    rng = np.random.default_rng(0)
    phi = record.outputs[:, 0]
    speed = np.gradient(phi, record.time)
    noise = rng.standard_normal(record.n_samples)
    columns = {
        "command": 3.0 * record.inputs[:, 0] + 1.0,
        "encoder": phi + 0.001 * noise,
        "speed": speed + 0.1 * np.std(speed) * noise,
        "wind": np.convolve(noise, np.ones(20), "same"),
        "still": np.full(record.n_samples, 2.0),
    }
    experiments = [replace(record, extra=columns)]
    assert [name for name in columns if _is_new_signal(name, experiments, ())] == ["wind"]


def form_over(variable, sign_of="", statistic=400.0, p_value=1e-50):
    nothing = np.zeros(1)
    return FreeForm(
        load=0, place="rotor.flange_a", variable=variable, sign_of=sign_of, unit="N.m", variable_unit="",
        statistic=statistic, degrees=8, p_value=p_value, x=nothing, w=nothing, std=nothing, over_a_turn=False,
    )  # fmt: skip


def test_unknown_effect_is_told_over_what_the_nearest_wrong_law_leaves():
    """Dry friction says most of any form with the sign of the speed; what it leaves tells the forms apart."""
    forms = (form_over("rotor.w", "", 420.0), form_over("rotor.phi", "rotor.w", 410.0))
    left = form_over("rotor.phi", "rotor.w", 300.0)
    wrong = SimpleNamespace(left=left, delta_log_likelihood=900.0)
    assert _told_by_rest(forms, [wrong]) is forms[1]
    assert _told_by_rest(forms, [SimpleNamespace(left=None, delta_log_likelihood=900.0)]) is forms[0]
    chance = SimpleNamespace(left=replace(left, p_value=0.2), delta_log_likelihood=900.0)
    assert _told_by_rest(forms, [chance]) is forms[0]
    weak = (forms[0], replace(forms[1], statistic=100.0))
    assert _told_by_rest(weak, [wrong]) is weak[0]
    assert _told_by_rest((), [wrong]) is None


def test_other_hold_is_tried_where_something_is_missing_and_nothing_accepted(monkeypatch):
    monkeypatch.setattr("daest.diagnosis.recordings.holds.are_alike", lambda _: False)
    stand = SimpleNamespace(
        null=SimpleNamespace(hold="foh", other_hold="zoh", hold_lead=20.0),
        baseline=SimpleNamespace(log_likelihood=100.0),
    )
    refused = SimpleNamespace(verdict="rejected", is_any_dynamics=False)
    named = SimpleNamespace(verdict="supported", is_any_dynamics=False)

    def hold(verdict, proof, learned=None):
        return unsettled_hold(stand, SimpleNamespace(proofs=(proof,), verdict=verdict, learned=learned))

    assert hold("unknown effect", refused) == "zoh"
    assert hold("nothing missing", refused) is None and hold("supported", named) is None
    # A load that was learned, foresees unseen data and is no better with the other hold settles it.
    assert hold("unknown effect", refused, SimpleNamespace(keeps_hold=True, against="")) is None
    assert hold("unknown effect", refused, SimpleNamespace(keeps_hold=False, against="")) == "zoh"
    assert hold("unknown effect", refused, SimpleNamespace(keeps_hold=True, against="no better")) == "zoh"
    # Smooth curves are no half sample away from straight lines.
    stand.null.other_hold = "smooth"
    assert hold("unknown effect", refused) is None
    # What is accepted with it must fit better than the model as it is with the hold before.
    named.fit = SimpleNamespace(log_likelihood=105.0)
    assert not says_more([refused, named], [refused], stand)
    named.fit.log_likelihood = 120.0
    assert says_more([refused, named], [refused], stand) and not says_more([refused], [refused], stand)
    # Nor is it told beside a lag that fits better with that hold and is too short to be told from others.
    fit = SimpleNamespace(log_likelihood=115.0)
    short = SimpleNamespace(verdict="rejected", is_any_dynamics=True, fit=fit)
    assert not says_more([refused, named], [refused, short], stand)


def test_effect_with_states_is_tried_until_it_is_better_than_its_simulation(monkeypatch):
    effect = SimpleNamespace(is_dynamic=True, sizes=(), parameters=())
    site = SimpleNamespace(kind="node")
    candidate = SimpleNamespace(effect=effect, site=site, shape={})
    trial = SimpleNamespace(candidate=candidate, alike=(), is_seen_in_use=False)
    null, tried = SimpleNamespace(flat=None, estimated=()), []
    ends = {"loads": 50.0, "calm": 90.0, "small": 130.0, "beside the refit": 125.0}
    gentle = ("small", "beside the refit")
    judged = []

    def searched(_, start):
        tried.append(start if start in gentle else "calm" if start.simulation else "loads")
        end = ends[tried[-1]]
        fit = SimpleNamespace(log_likelihood=end)
        return SimpleNamespace(gain=end - 100.0, refit=SimpleNamespace(fit=fit))

    def proof_of(_, found):
        judged.append(found.gain)
        return SimpleNamespace(fit=found.refit.fit, final=None)

    def end(simulation):
        tried.clear()
        judged.clear()
        baseline = SimpleNamespace(log_likelihood=100.0)
        search = SimpleNamespace(stand=SimpleNamespace(null=null, baseline=baseline))
        first = Prepared(trial, None, (), simulation=SimpleNamespace(log_likelihood=simulation))
        return proof_by_attempts(search, first).fit.log_likelihood

    monkeypatch.setattr(attempts, "end_of_search", searched)
    monkeypatch.setattr(search_module, "judged_end", proof_of)
    monkeypatch.setattr(attempts, "prepare", lambda *_, share, sharper: "small")
    monkeypatch.setattr(attempts, "_beside_refit", lambda *_: "beside the refit")
    monkeypatch.setattr(attempts, "_back_within_reach", lambda *_: [])
    assert end(40.0) == 130.0 and tried == ["loads", "calm", "small"]
    ends["loads"] = 110.0
    assert end(40.0) == 110.0 and tried == ["loads"]
    # A simulation that is likelier than the null needs no load; none may end below it.
    ends["calm"] = 120.0
    assert end(115.0) == 120.0 and tried == ["calm"]
    assert end(140.0) == 130.0 and tried == ["calm", "loads", *gentle]
    assert judged == [30.0]  # the likeliest end alone


def test_law_whose_searches_all_end_below_the_null_is_tried_with_blunter_kinks(monkeypatch):
    """The camera on a servo: the gains of one average linearisation suit a machine that sticks and slips
    badly, so that every search with a sharp kink ended below the model as it is."""
    size = SimpleNamespace(name="f_c", role="size", null=0.0, is_share=False)
    effect = SimpleNamespace(sizes=(size,), parameters=(size, SimpleNamespace(name="v_s", role="sharpness")))
    candidate = SimpleNamespace(effect=effect, site=SimpleNamespace(kind="node"), shape={"v_s": 0.03})
    trial = SimpleNamespace(candidate=candidate, alike=(), is_seen_in_use=False)
    roundings = []

    def searched(_, start):
        roundings.append(start)
        gain = 18.0 if start == 3.0 else -19.0
        return SimpleNamespace(gain=gain, refit=SimpleNamespace(fit=SimpleNamespace(log_likelihood=gain)))

    monkeypatch.setattr(attempts, "end_of_search", searched)
    monkeypatch.setattr(search_module, "judged_end", lambda _, found: SimpleNamespace(gain=found.gain))
    monkeypatch.setattr(attempts, "prepare", lambda *_, share, sharper: sharper)
    monkeypatch.setattr(attempts, "as_prepared", lambda _: 0.3)
    monkeypatch.setattr(attempts, "_beside_refit", lambda *_: 1.0)
    monkeypatch.setattr(attempts, "_back_within_reach", lambda *_: [])
    monkeypatch.setattr(attempts, "_found_again", lambda _search, _prepared, best: best)
    null = SimpleNamespace(flat=None, estimated=())
    search = SimpleNamespace(stand=SimpleNamespace(null=null))
    assert proof_by_attempts(search, Prepared(trial, None, ())).gain == 18.0
    assert roundings == [0.3, 1.0, 1.0, 3.0]  # the blunt one last, and only since the others are lost
    candidate.shape = {}
    roundings.clear()
    assert proof_by_attempts(search, Prepared(trial, None, ())).gain == -19.0 and roundings == [0.3, 1.0, 1.0]


def test_stop_that_a_search_has_put_beyond_all_that_is_reached_is_tried_again_within_it(monkeypatch):
    """Two stops at 0.014 of 0.026 m, of which the search has stepped over the end with the lower one."""
    effect = next(e for e in library() if e.class_name == "Daest.Effects.Translational.EndStop")
    candidate = SimpleNamespace(name="e", effect=effect, shape={"s_s": 2.6e-4})
    names = ("k", "e.c", "e.s_max", "e.s_min")

    def ended(s_min, log_likelihood=10.0):
        flat = SimpleNamespace(
            parameters=[SimpleNamespace(name=n, min=None, max=None) for n in names],
            with_theta=lambda values: values,
        )
        started = Prepared(SimpleNamespace(candidate=candidate), flat, names)
        theta = dict(zip(names, (7.0, 6e5, 0.014, s_min), strict=True))
        fit = SimpleNamespace(theta=theta, log_likelihood=log_likelihood)
        return SimpleNamespace(prepared=started, refit=SimpleNamespace(fit=fit))

    search = SimpleNamespace(leader=None)
    monkeypatch.setattr(attempts, "least_hope", lambda *_: 0.0)
    (again,) = attempts._back_within_reach(search, ended(-0.15))
    assert again.flat == {"k": 7.0, "e.c": 6e5, "e.s_max": 0.014, "e.s_min": pytest.approx(-0.013)}
    assert not attempts._back_within_reach(search, ended(-0.014))
    assert not attempts._back_within_reach(search, ended(-0.15, log_likelihood=-10.0))


def test_shooting_waits_until_nothing_else_explains_the_data(monkeypatch):
    effect = SimpleNamespace(class_name="Rub")

    def proof(site, gain, left=1.0):
        candidate = SimpleNamespace(effect=effect, site=SimpleNamespace(name=site), name=site)
        form = SimpleNamespace(p_value=left, log_likelihood_gain=0.5 * abs(gain))
        verdict = "supported" if gain > 0.0 else "rejected"
        return SimpleNamespace(
            candidate=candidate, places={site}, delta_log_likelihood=gain, verdict=verdict, left=form
        )

    def shot(self, again, _):
        tried.extend(one.trial.candidate.name for one in again)
        assert all(one.by_shooting for one in again)
        return [proof("a", 50.0)] if again else [], []

    def tries(best):
        tried.clear()
        trial = SimpleNamespace(candidate=proof("a", -9.0).candidate)
        first = Prepared(trial, None, ())
        late = proof("u", -9.0).candidate
        late.effect = SimpleNamespace(class_name="Daest.Effects.Signals.Delay")
        lost = [first, replace(first, similar="another"), Prepared(SimpleNamespace(candidate=late), None, ())]
        stages = Stages(None, None, None, None, lost=lost)
        proofs = [p for p in (best, proof("a", -9.0)) if p is not None]
        found = stages.second_tries(proofs, SimpleNamespace(entries=()))
        assert not stages.lost
        return {p.candidate.name: p.delta_log_likelihood for p in found}

    tried = []
    monkeypatch.setattr(Stages, "proved", shot)
    monkeypatch.setattr(stages_module, "ranked", lambda proofs: proofs)
    assert tries(None) == {"a": 50.0} and tried == ["a"]
    # The best one leaves a form that matters, or nothing.
    assert tries(proof("b", 90.0, left=1e-9)) == {"b": 90.0, "a": 50.0}
    assert tries(proof("b", 90.0)) == {"b": 90.0, "a": -9.0} and not tried


def test_law_seen_in_use_is_tried_at_every_place_that_the_screen_sees_alike(monkeypatch):
    """Before a pump that cannot draw, and behind a sensor: alike at size zero alone."""
    likelihood = {"level": -1401.0, "u": -713.0, "valve": -713.2, "leak": -900.0}
    effect = SimpleNamespace(sizes=(), inputs=(), is_dynamic=False)

    def at(name):
        candidate = SimpleNamespace(name=name, effect=effect, site=SimpleNamespace(name=name), inputs=())
        flat = SimpleNamespace(with_theta=lambda _: None)
        return SimpleNamespace(trial=SimpleNamespace(candidate=candidate), flat=flat, names=(), place=name)

    @dataclass(frozen=True)
    class Found:
        candidate: object
        verdict: str = "rejected"
        delta_log_likelihood: float = 0.0
        fit: object = None
        equivalent: tuple[str, ...] = ("u", "valve", "leak")

    def fitted(stand, reference, prepared, begun=None):
        # From where the law ends at the first place it comes no further than there.
        value = likelihood[prepared.place] if begun is None else min(likelihood[prepared.place], -1300.0)
        return SimpleNamespace(log_likelihood=value, theta={})

    def judged(null, prepared, beside, *_):
        assert beside.candidate is prepared.trial.candidate
        return replace(beside, verdict=verdict)

    @dataclass(frozen=True)
    class Loads:
        experiments: tuple[()] = ()

    null = Loads()
    stand = SimpleNamespace(null=null, validation=(), reference=SimpleNamespace(simulated=1))
    search = Search(stand, None, None, None, 4)
    others = [partial(at, name) for name in ("u", "valve", "leak")]
    monkeypatch.setattr(in_use, "at_other_places", lambda *_: others)
    monkeypatch.setattr(in_use, "_fitted_in_use", fitted)
    monkeypatch.setattr(in_use, "_beside_loads", lambda _, there: Found(there.trial.candidate))
    monkeypatch.setattr(in_use, "by_simulation", judged)
    monkeypatch.setattr(in_use, "fed", lambda experiments, _: experiments)
    first = at("level")
    beside, verdict = Found(first.trial.candidate), "supported"
    shown = in_use.shown_in_use(search, first, beside)
    assert shown.candidate.site.name == "u" and shown.equivalent == ("valve",)
    # One that no simulation shows stays where it was, refused.
    verdict = "rejected"
    assert in_use.shown_in_use(search, first, beside) is beside


def behind(numerator, denominator, seed):
    """A rotor behind a filter of its torque: exact for an input that is held."""
    system = cont2discrete(
        tf2ss(numerator, np.polymul(denominator, [INERTIA, DAMPING, 0.0])), PERIOD, method="zoh"
    )
    u = torque_steps(1200, seed)
    _, y, _ = dlsim(system, u[:, None])
    y += 0.01 * np.random.default_rng(seed).standard_normal(y.shape)
    return Experiment("run", PERIOD * np.arange(u.size), u[:, None], y, ("u",), ("phi",))


@pytest.mark.slow
def test_lag_is_named_and_what_only_looks_like_one_is_not():
    lag = diagnosed(behind([1.0], [0.8, 1.0], 4), "Lag")
    assert accepted(lag) == {"Lag"}
    size = next(p for p in lag.proofs[0].told.parameters if p.name.endswith(".T"))
    assert size.value == pytest.approx(0.8, rel=0.1)
    short = diagnosed(behind([1.0], [0.2, 1.0], 4), "Lag")
    assert not accepted(short) and "short beside the fastest time constant" in short.proofs[0].reason


@pytest.mark.slow
def test_a_flexible_shaft_is_no_lag():
    flexible = diagnosed(behind([9.0], [1.0, 3.0, 9.0], 4), "Lag")
    assert not accepted(flexible) and flexible.verdict not in ("nothing missing", "parameters off")
    reason = flexible.proofs[0].reason
    assert "something dynamic is missing" in reason or "is not significant" in reason
