"""Proof: a candidate built into the model, everything refitted, gates before ranking."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from daest.diagnosis.disturbance import SmoothedLoad, smoothed_at
from daest.diagnosis.free_forms import free_forms
from daest.diagnosis.gates import GATES
from daest.diagnosis.null import Null, grown, loads_of, period_of, refitted
from daest.diagnosis.open_loop import Simulated, in_use, says_more_in_use, simulated_errors, speaks_for
from daest.diagnosis.ranking import ahead_of, least_hope
from daest.diagnosis.reasons import (
    LOST,
    lag_too_short,
    not_determined,
    other_dynamics,
    out_of_reach,
    undriven,
    unexplained,
    vanished,
    weak,
    without_evidence,
    without_form,
    wrong_law,
)
from daest.diagnosis.screen import NullObserver, run_null
from daest.diagnosis.settled import settled, simulated
from daest.diagnosis.trials import Prepared
from daest.diagnosis.unseen import (
    Foreseen,
    Innovations,
    compared,
    confirmed,
    foreseen,
    innovations,
    is_worse,
    judged,
    misfit,
    steady_misfit,
)
from daest.errors import DaestError
from daest.estimation.identify_nonlinear import Refit
from daest.estimation.records import n_observed, part_of
from daest.model.diagnosis import Ahead, Candidate, Confirmed, FreeForm, InUse, Load, Proof
from daest.model.experiment import Experiment
from daest.model.fit import FitResult, error_ratios
from daest.model.flat import ExplicitModel, FlatModel, with_equations
from daest.modelica.balances import needs_position
from daest.numerics.statistics import chi2
from daest.systems.linearize import has_affine_dynamics
from daest.systems.reduce import reduce_index

LONGER = 2  # searches that go on where one has come to its limit
LONG = 10_000  # samples, from which a search of a model that bends begins with a part, ...
SHORTER = 4  # ... a fourth of every recording
CALM = 1e-6  # of the null's intensities of the loads, from which a search starts that needs none of them


@dataclass(frozen=True)
class Reference:
    """The model as it is, without coloured loads: what a law must foresee unseen data better than.
    `adds_up` tells that its simulation is dead reckoning, else `simulated` are the errors of that;
    `innovations` are those of the unseen data beside its loads."""

    fit: FitResult
    foreseen: Foreseen | None = None
    adds_up: bool = False
    innovations: Innovations | None = None
    simulated: Simulated | None = None


def prove(
    null: Null,
    null_fit: FitResult,
    prepared: Prepared,
    experiments: Sequence[Experiment],
    validation: Sequence[Experiment],
    run: NullObserver,
    load: SmoothedLoad | None,
    n_screened: int = 1,
    leader: Proof | None = None,
    form: FreeForm | None = None,
    reference: Reference | None = None,
) -> Proof:
    """Refit one candidate and judge it against the null refitted the same way, and by unseen data against the
    `reference`. The `leader` is the best supported candidate so far: one that is far behind it, and does not
    simulate unseen data better, is judged in brief.

    `run` is the null's observer, `load` its largest load and `form` the curve that it follows best;
    `experiments` are the null's with the signals that the effect needs; `n_screened` candidates were
    searched. Raises what `refit` raises.
    """
    found = searched(null, null_fit, prepared, experiments, leader)
    return proof_of(null, null_fit, found, validation, run, load, n_screened, leader, form, reference)


@dataclass(frozen=True)
class Searched:
    """The end of the search for one candidate, on the `experiments` that feed its effect, and its `gain` in
    log-likelihood over the null, before it is judged."""

    prepared: Prepared
    explicit: ExplicitModel
    experiments: tuple[Experiment, ...]
    refit: Refit
    gain: float


def searched(
    null: Null,
    null_fit: FitResult,
    prepared: Prepared,
    experiments: Sequence[Experiment],
    leader: Proof | None = None,
) -> Searched:
    """The refit of one candidate, as `prove` judges it. Raises what `refit` raises."""
    explicit = prepared.reduced()
    fed = replace(null, experiments=tuple(experiments))
    hopeless = least_hope(leader, prepared.trial.candidate)
    refit = _refit(fed, prepared, explicit, hopeless, null_fit.log_likelihood)
    gain = refit.fit.log_likelihood - null_fit.log_likelihood
    return Searched(prepared, explicit, fed.experiments, refit, float(gain))


def proof_of(
    null: Null,
    null_fit: FitResult,
    found: Searched,
    validation: Sequence[Experiment],
    run: NullObserver,
    load: SmoothedLoad | None,
    n_screened: int = 1,
    leader: Proof | None = None,
    form: FreeForm | None = None,
    reference: Reference | None = None,
) -> Proof:
    """The judgement of a candidate whose search has ended; arguments and errors as those of `prove`."""
    prepared, explicit, experiments = found.prepared, found.explicit, found.experiments
    refit, gain, hopeless = found.refit, found.gain, least_hope(leader, prepared.trial.candidate)
    fed, fit = replace(null, experiments=experiments), found.refit.fit
    n_own = prepared.n_unknowns(null.estimated)
    delta_bic = bic_gain(gain, n_own, null)
    with_effect = grown(fed, prepared.flat, explicit, fit, experiments)
    # Without a load the observer waits until the gates that need none are passed.
    after = None if load is None else run_null(with_effect)
    explained = _explained(null_fit, with_effect, after, load)
    p_value = float(min(1.0, n_screened * chi2.sf(2.0 * max(gain, 0.0), n_own)))
    reason = without_evidence(gain, delta_bic, p_value, n_screened)
    if fit.log_likelihood < prepared.useless:
        reason = reason or "the same law, started otherwise, explains the data better"
    final: FitResult | None = None
    ahead: tuple[Ahead, ...] = ()
    told = Confirmed()
    is_open = is_curve = is_told = is_shown = False
    used = InUse()
    unseen_form = vague = ""
    before = null_fit if reference is None else reference.fit
    ahead_of_it = leader if fit.log_likelihood < hopeless else None
    ahead_of_it = ahead_of_it or _better_simpler(prepared, fit, delta_bic)
    if not reason and ahead_of_it is not None:
        final, ahead, reason = _in_brief(fed, refit, prepared, explicit, validation, ahead_of_it, reference)
    if not reason:
        after = after or run_null(with_effect)
        if reference is not None and validation:
            told = confirmed(reference.innovations, innovations(after, validation))
        final, ahead, against, is_told = _on_unseen(
            fed, refit, prepared, explicit, told, validation, reference
        )
        fit = fit if final else refit.simulated(validation)
        if reference is not None and not against:
            used = _in_use(fed, prepared, explicit, final, validation, reference)
            is_shown = speaks_for(used, n_own)
        ratios = error_ratios((reference.fit if reference else null_fit).simulated, (final or fit).simulated)
        # A law that says all that the load has to do with any variable need not explain more of the load.
        says_all = form is not None and form.p_value < GATES.rest_level and gain >= form.log_likelihood_gain
        is_curve = says_all and explained >= GATES.min_curve_explained
        vague = not_determined(prepared.trial.candidate, final or fit, before)
        undetermined = vanished(prepared.trial.candidate, final or fit) or vague
        if not against and not undetermined:
            formless = without_form(with_effect, prepared.trial.candidate, final or fit)
            is_open = not formless
            unseen_form = formless or out_of_reach(with_effect, prepared.trial.candidate, final or fit)
        reason = against or undetermined or unseen_form
        reason = reason or weak(prepared, final if is_shown and final else fit, before)
        alone = grown(fed, prepared.flat, explicit, final or fit, experiments)
        reason = reason or undriven(alone) or _of_its_start(null, alone, prepared.trial.candidate, reference)
        if not reason and not is_curve and not is_told and not is_shown:
            reason = unexplained(explained, ratios)
    elif final is None:
        fit = refit.simulated(validation)
    left = None if reason else _left(null, with_effect, after or run_null(with_effect))
    near = too_short = ""
    if left is not None:
        if prepared.trial.candidate.is_dynamic:
            reason = near = other_dynamics(left, gain)
            too_short = "" if reason else lag_too_short(null, prepared.trial.candidate, fit)
            reason = reason or too_short
        if is_curve and not is_told and not is_shown and _is_much_left(left, gain):
            reason = unexplained(explained, ratios)
        if not reason and not _is_most_of_it(explained, ratios, is_told, gain, left):
            reason = wrong_law(null, run, prepared, fit, gain, left)
    return Proof(
        candidate=prepared.trial.candidate,
        flat=prepared.flat.with_theta(fit.theta),
        fit=fit,
        delta_log_likelihood=gain,
        delta_bic=delta_bic,
        p_value=p_value,
        explained=explained,
        equivalent=tuple(c.site.name for c in prepared.trial.alike),
        not_separable_from=(),
        verdict="rejected" if reason else "supported",
        reason=reason,
        left=left,
        final=final,
        ahead=ahead,
        is_open=bool(reason) and is_open,
        is_vague=bool(vague) and reason == vague,
        is_any_dynamics=bool(too_short) and reason == too_short,
        comes_near=bool(near) and reason == near,
        is_known=not unseen_form and not not_determined(prepared.trial.candidate, final or fit, before),
        confirmed=told,
        adds_up=reference is not None and reference.adds_up,
        in_use=used,
        is_shown=is_shown,
    )


def _of_its_start(null: Null, model: Null, candidate: Candidate, reference: Reference | None) -> str:
    """Why an effect is not there that lives on how its own states begin, and not on what drives them: a mass
    of nothing that rings for ever from the first sample on is a sine of any origin. Empty where it does not.
    Of bodies alone: at rest they move with what they hang on, while a wall may be at any temperature."""
    if not candidate.effect.n_states or not needs_position(candidate.effect.domain):
        return ""
    if reference is None or reference.adds_up:
        return ""
    without = grown(null, null.flat, null.explicit, reference.fit, null.experiments)
    std = model.measurement_std
    before = misfit(without, null.experiments, std)
    after = misfit(model, model.experiments, std)
    rested = misfit(model, model.experiments, std, candidate.name)
    if before is None or after is None or rested is None or after >= before:
        return ""
    if before - rested >= GATES.min_driven_gain * (before - after):
        return ""
    return "it lives on how its own states begin: started at rest it does little of that"


def _better_simpler(prepared: Prepared, fit: FitResult, delta_bic: float) -> Proof | None:
    """The simpler law that a candidate contains, where the candidate's search ended below it, or gained less
    than its further parameters cost."""
    simpler = prepared.simpler
    if simpler is None:
        return None
    is_worse = delta_bic < simpler.delta_bic - GATES.same_bic
    return simpler if is_worse or fit.log_likelihood < simpler.fit.log_likelihood else None


def may_be_likelier(
    null: Null,
    found: Searched,
    other: Proof,
    validation: Sequence[Experiment],
    reference: Reference | None,
) -> bool:
    """Whether the end of a search may make the recordings and the unseen data together likelier than `other`
    does, however it is judged. Raises what the observer raises."""
    told = Confirmed()
    if reference is not None and validation:
        model = grown(
            replace(null, experiments=found.experiments),
            found.prepared.flat,
            found.explicit,
            found.refit.fit,
            found.experiments,
        )
        told = confirmed(reference.innovations, innovations(run_null(model), validation))
    most = found.gain + max(told.gain, 0.0)
    return not most <= other.delta_log_likelihood + other.confirmed.gain


def bic_gain(gain: float, n_more: int, null: Null) -> float:
    """What a gain in log-likelihood is worth by the criterion of Bayes with that many more parameters."""
    n_measured = n_observed(null.experiments)
    return float(2.0 * gain - n_more * np.log(n_measured))


def by_simulation(
    null: Null,
    prepared: Prepared,
    beside: Proof,
    found: FitResult,
    validation: Sequence[Experiment],
    reference: Reference,
    n_screened: int,
    accepted: Proof | None = None,
) -> Proof:
    """The proof of a law by the simulation `found`, with the evidence of that, where it speaks for the law by
    more than chance, and the law does not destroy what the observer foresees; else that `beside` the
    loads, which refused it. Where an `accepted` law shows that something bends the signal, it is enough to
    say more than that one: which law it is is no question of chance."""
    explicit = prepared.reduced()
    used = _in_use(null, prepared, explicit, found, validation, reference)
    n_own = prepared.n_unknowns(null.estimated)
    is_shown = speaks_for(used, n_own) or (accepted is not None and says_more_in_use(used, accepted.in_use))
    refused = not is_shown or beside.delta_log_likelihood < -GATES.hopeless_log_likelihood
    candidate = prepared.trial.candidate
    refused = refused or bool(weak(prepared, found, reference.fit))
    model = grown(null, prepared.flat, explicit, found, null.experiments)
    refused = refused or bool(undriven(model))
    refused = refused or bool(without_form(model, candidate, found) or out_of_reach(model, candidate, found))
    p_value = float(min(1.0, n_screened * chi2.sf(2.0 * max(used.gain, 0.0), n_own)))
    if refused or p_value > GATES.max_chance:
        return beside
    if _of_its_start(null, model, candidate, reference):
        return beside
    return replace(
        beside,
        delta_log_likelihood=used.gain,
        delta_bic=used.bic(n_own),
        in_use=used,
        is_shown=True,
        is_by_use=True,
        p_value=p_value,
        verdict="supported",
        reason="",
        final=found,
        ahead=(),
        is_open=False,
    )


def _in_brief(
    null: Null,
    refit: Refit,
    prepared: Prepared,
    explicit: ExplicitModel,
    validation: Sequence[Experiment],
    leader: Proof,
    reference: Reference | None,
) -> tuple[FitResult | None, tuple[Ahead, ...], str]:
    """A first pass without coloured loads, what it does to the prediction of unseen data, and why a candidate
    that is far less likely than the `leader` is no rival of it by unseen data either (`_unseen_ratio`); None
    and empty where it may be one."""
    if reference is None or not validation:
        return None, (), ""
    found = settled(null, refit.fit, prepared.flat, explicit, null.experiments, validation, is_rough=True)
    if found is None:
        return None, (), ""
    rough, observer = found
    ahead: tuple[Ahead, ...] = ()
    if leader.adds_up:
        ahead = compared(reference.foreseen, foreseen(observer, validation), period_of(null.experiments))
        errors = ahead_of(leader.ahead, ahead)
        may_be_rival = not errors or errors[max(errors)] < 1.0
    else:
        ratios = error_ratios(leader.told.simulated, rough.simulated)
        is_worse_in_one = max(ratios, default=0.0) > 1.0 + GATES.clear_unseen_error
        may_be_rival = not ratios or (not is_worse_in_one and float(np.mean(np.square(ratios))) < 1.0)
    if may_be_rival:
        return None, (), ""
    behind = leader.fit.log_likelihood - refit.fit.log_likelihood
    if behind < 0.0:
        return rough, ahead, f"{leader.candidate.label} says nearly as much with fewer parameters"
    much = "far better" if behind > GATES.hopeless_log_likelihood else "better with fewer parameters"
    reason = f"{leader.candidate.label} explains the data {much} (log-likelihood {behind:.0f})"
    return rough, ahead, reason


def _refit(
    null: Null,
    prepared: Prepared,
    explicit: ExplicitModel,
    hopeless: float,
    least: float,
) -> Refit:
    """The refit, which goes on where a search has come to its limit; `least` is the log-likelihood of the
    null."""
    start = null if prepared.similar is None else replace(null, fit=prepared.similar)
    if prepared.simulation is not None:
        start = replace(null, fit=_calm(null.fit, prepared.simulation))
    begun, start = _begun_on_a_part(prepared, explicit, start)
    explicit = explicit if begun is prepared.flat else replace(explicit, flat=begun)
    found = refitted(begun, explicit, prepared.names, start, hopeless=hopeless)
    for _ in range(LONGER):
        fit = found.fit
        if fit.status != "iteration limit" or fit.log_likelihood < max(hopeless, least):
            break
        flat = prepared.flat.with_theta(fit.theta)
        longer = refitted(flat, reduce_index(flat), prepared.names, replace(null, fit=fit))
        if longer.fit.log_likelihood <= fit.log_likelihood:
            break
        found = longer
    return found


def _begun_on_a_part(prepared: Prepared, explicit: ExplicitModel, start: Null) -> tuple[FlatModel, Null]:
    """The model and the null from which the refit of a model that bends starts: of long recordings those of a
    search over their first parts, since most of the way does not need them whole."""
    n_samples = sum(e.n_samples for e in start.experiments)
    if n_samples < LONG or has_affine_dynamics(explicit):
        return prepared.flat, start
    parts = tuple(part_of(e, 0, -(-e.n_samples // SHORTER)) for e in start.experiments)
    try:
        fit = refitted(prepared.flat, explicit, prepared.names, replace(start, experiments=parts)).fit
    except DaestError:
        return prepared.flat, start
    return prepared.flat.with_theta(fit.theta), replace(start, fit=fit)


def _calm(null_fit: FitResult, simulation: FitResult) -> FitResult:
    """The fit of a simulation with the null's loads in it, but hardly any of them: from loads as large as the
    null needs, a search takes the effect for one of them."""
    loads = [replace(n, value=CALM * n.value) for n in null_fit.noises if n.kind == "process"]
    measured = [n for n in simulation.noises if n.kind == "measurement"]
    return replace(simulation, noises=(*loads, *measured))


def has_lost_its_way(found: Searched, simulation: FitResult | None = None) -> bool:
    """Whether the search ended below the null, which the law contains, or below a simulation's fit, which is
    the law without any load."""
    least = -np.inf if simulation is None else simulation.log_likelihood
    return found.gain < -LOST or found.refit.fit.log_likelihood < least - LOST


def is_below_null(proof: Proof) -> bool:
    """Whether all searches for a law have ended below the null, which the law contains."""
    return proof.delta_log_likelihood < -LOST


def _on_unseen(
    null: Null,
    refit: Refit,
    prepared: Prepared,
    explicit: ExplicitModel,
    told: Confirmed,
    validation: Sequence[Experiment],
    reference: Reference | None,
) -> tuple[FitResult | None, tuple[Ahead, ...], str, bool]:
    """The estimates without coloured loads, what they do to the prediction of unseen data, why these speak
    against the effect (empty where they do not), and whether most of the error is gone."""
    if reference is None or not validation:
        return None, (), "", False
    found = settled(null, refit.fit, prepared.flat, explicit, null.experiments, validation)
    if found is None:
        against, _, is_told = judged((), reference.fit, refit.simulated(validation), reference.adds_up, told)
        return None, (), against, is_told
    white, observer = found
    ahead = compared(reference.foreseen, foreseen(observer, validation), period_of(null.experiments))
    if reference.adds_up or any(is_worse(one) for one in ahead):
        final = white
    else:
        final = simulated(null, white, prepared.flat, null.experiments, validation, refit)
    against, _, is_told = judged(ahead, reference.fit, final, reference.adds_up, told)
    if against and not reference.adds_up and not any(is_worse(one) for one in ahead):
        steady = _steady_ratio(null, prepared.flat, explicit, final, validation, reference)
        against, _, is_told = judged(ahead, reference.fit, final, False, told, steady)
    return final, ahead, against, is_told


def _steady_ratio(
    null: Null,
    flat: FlatModel,
    explicit: ExplicitModel,
    final: FitResult,
    validation: Sequence[Experiment],
    reference: Reference,
) -> float | None:
    """Of the errors of the simulated unseen data, with to without the effect, where every recording has a
    constant load of its own; None where one of the two cannot be simulated."""
    before, after = (
        steady_misfit(null, known, dynamics, validation)
        for known, dynamics in (
            (null.flat.with_theta(reference.fit.theta), null.explicit),
            (flat.with_theta(final.theta), explicit),
        )
    )
    return float(np.sqrt(after / before)) if before and after is not None else None


def with_steady_error(null: Null, proof: Proof, validation: Sequence[Experiment]) -> Proof:
    """The proof with the error of its simulation of unseen data where each recording has a constant load of
    its own, if it can be simulated so: the zero of a sensor is elsewhere on every machine, and a stop on one
    side alone makes up for it where a law that is alike on both sides does not."""
    if proof.final is None:
        return proof
    flat = with_equations(proof.flat, "a simulation").with_theta(proof.final.theta)
    misfit = steady_misfit(null, flat, reduce_index(flat), validation)
    return proof if misfit is None else replace(proof, steady_error=float(np.sqrt(misfit)))


def _left(null: Null, with_effect: Null, after: NullObserver) -> FreeForm | None:
    """The form that the load follows best which is left beside the effect, over variables of the model as it
    was."""
    known = [v.name for v in (*null.flat.unknowns, *null.flat.inputs)]
    forms = free_forms(with_effect, after, known)
    return forms[0] if forms else None


def _in_use(
    null: Null,
    prepared: Prepared,
    explicit: ExplicitModel,
    final: FitResult | None,
    validation: Sequence[Experiment],
    reference: Reference,
) -> InUse:
    """What the simulation says of the law at its estimates without loads."""
    if final is None or final.method != "oe" or reference.simulated is None:
        return InUse()
    flat = prepared.flat.with_theta(final.theta)
    found = simulated_errors(null, flat, replace(explicit, flat=flat), final, null.experiments, validation)
    return in_use(reference.simulated, found)


def _is_most_of_it(
    explained: float, ratios: Sequence[float], is_told: bool, gain: float, left: FreeForm
) -> bool:
    """Whether the effect does away with most of the load and of the simulation error, or of the error on
    unseen data at some horizon and with more than it leaves. No law is exact on a real machine: what it
    leaves is then a finding of its own, and no reason to doubt it."""
    if is_told and left.log_likelihood_gain < GATES.max_rest * gain:
        return True
    return explained >= GATES.min_explained and bool(ratios) and max(ratios) <= GATES.max_simulated_ratio


def _is_much_left(left: FreeForm, gain: float) -> bool:
    """Whether the rest of the load follows a variable, and is more, beside the law's gain in log-likelihood,
    than a second and smaller effect."""
    return left.p_value < GATES.rest_level and left.log_likelihood_gain >= GATES.max_rest * gain


def _explained(
    null_fit: FitResult, null: Null, run: NullObserver | None, before: SmoothedLoad | None
) -> float:
    """Share of the unexplained loads that is gone with the effect in the model: of their sizes in the noise
    model, or of the smoothed course (rms) of the one that matters most, whichever is more. 1 where the null
    needed no load: there was none to explain.

    Sizes also hold fast ripple that no effect removes, though not what is faster than the load was; the
    smoothed course, where two effects are missing, also holds the other one.
    """
    if before is None or run is None:
        return 1.0
    first = loads_of(null_fit, null.places)
    was, now = (
        np.array([_slow_size(one, load.time_constant) for one, load in zip(loads, first, strict=True)])
        for loads in (first, loads_of(null.fit, null.places))
    )
    left = np.minimum(now / np.where(was > 0.0, was, np.inf), 1.0)
    shares = [float(1.0 - np.sum(was**2 * left) / np.sum(was**2)) if np.any(was > 0.0) else 1.0]
    after = smoothed_at(null, run, before.index)
    size = float(np.sqrt(np.mean(before.values**2)))
    if after is not None and size > 0.0:
        shares.append(1.0 - float(np.sqrt(np.mean(after.values**2))) / size)
    return max(shares)


def _slow_size(load: Load, time_constant: float) -> float:
    """rms of the part of a load below the corner frequency of another with that time constant."""
    return load.size * float(np.sqrt(2.0 / np.pi * np.arctan(load.time_constant / time_constant)))
