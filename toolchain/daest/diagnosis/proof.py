"""Proof: the best candidates built into the model, everything refitted, gates before ranking."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from daest.diagnosis.candidates import scaled_by
from daest.diagnosis.clipping import SATURATION, Clip
from daest.diagnosis.disturbance import SmoothedLoad, smoothed_at
from daest.diagnosis.free_forms import covers, free_forms
from daest.diagnosis.gates import GATES
from daest.diagnosis.null import Null, grown, loads_of, period_of, refitted
from daest.diagnosis.open_loop import (
    Simulated,
    driven_share,
    in_use,
    largest_values,
    says_more_in_use,
    simulated_errors,
    speaks_for,
)
from daest.diagnosis.screen import NullObserver, law_response, run_null
from daest.diagnosis.settled import FAR, settled, simulated
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
from daest.model.diagnosis import Ahead, Candidate, Confirmed, FreeForm, InUse, Load, Proof, Screen
from daest.model.effects import EffectParameter
from daest.model.experiment import Experiment
from daest.model.fit import FitResult, FittedParameter, error_ratios
from daest.model.flat import ExplicitModel, FlatModel, with_equations
from daest.modelica.attach import attach
from daest.modelica.balances import needs_position
from daest.modelica.place_units import units_at
from daest.numerics.statistics import chi2
from daest.quantities import spoken_duration
from daest.systems.reduce import reduce_index

LONGER = 2  # searches that go on where one has come to its limit
LOST = (
    5.0  # log-likelihood below that of the null, which a law contains, from which a search has lost its way
)
PLACED = 0.5  # of what its variable reaches, from which a shape is looked for as a place along it
CUT = 0.99  # share of what is beyond the limit that a clipping sensor is taken to cut, at first
NEARLY = 0.9  # share of its full size, at first, of a law whose kinks are rounded widely
CLIPPED_WITHIN = 0.01  # of the limit, over which its edge is rounded in the screen
GENTLE = 0.1  # of the size by the screen, from which a search is tried again
CALM = 1e-6  # of the null's intensities of the loads, from which a search starts that needs none of them
SHARPER = 0.3  # the proof rounds kinks over this part of what the screen rounds them over


@dataclass(frozen=True)
class Trial:
    """A candidate, its sizes by the screen, and the places where these sensors would see it alike. One that
    leads the screen in open loop (`is_seen_in_use`) may show itself there alone."""

    candidate: Candidate
    sizes: tuple[float, ...]
    alike: tuple[Candidate, ...]
    is_seen_in_use: bool = False


def trials(screen: Screen, level: float, most: int) -> tuple[Trial, ...]:
    """The best candidates that are significant at `level`, at most `most`, each at its best shape; the same
    effect at a place that the sensors see alike is the same trial. A law with states of its own waits where
    one without them has its response: where that leaves something, richer laws are tried."""
    chosen: list[Trial] = []
    taken: set[int] = set()
    entries = screen.entries
    for i, entry in enumerate(entries):
        if len(chosen) == most:
            break
        if i in taken or entry.absorbed or entry.p_value > level:
            continue
        effect = entry.candidate.effect.class_name
        same = [j for j in range(len(entries)) if entries[j].candidate.effect.class_name == effect]
        near = [j for j in same if abs(screen.correlation[i, j]) > GATES.same_place_correlation]
        own_site = [j for j in same if entries[j].candidate.site == entry.candidate.site]
        places = {entries[j].candidate.site.name: entries[j].candidate for j in near if j not in own_site}
        # Other shapes at a place that is taken are found by the refit.
        taken.update(near, own_site)
        taken.update(j for j in same if entries[j].candidate.site.name in places)
        if entry.candidate.effect.n_states and _has_bare_twin(screen, i):
            continue
        # Among places that the sensors see alike, the first of the model speaks for all.
        group = [entries[j] for j in (i, *near) if entries[j].score >= GATES.same_score * entry.score]
        first = min(group, key=lambda e: _position(e.candidate))
        places.setdefault(entry.candidate.site.name, entry.candidate)
        places.pop(first.candidate.site.name, None)
        chosen.append(Trial(first.candidate, first.sizes, tuple(places.values())))
    return tuple(chosen)


def _has_bare_twin(screen: Screen, number: int) -> bool:
    """Whether a candidate without states of its own, at the same place, has the response of an entry."""
    entries = screen.entries
    return any(
        other.candidate.site == entries[number].candidate.site
        and not other.candidate.effect.n_states
        and abs(screen.correlation[number, j]) > GATES.same_place_correlation
        for j, other in enumerate(entries)
    )


def moved(trial: Trial, number: int) -> Trial:
    """The trial at one of the places where the sensors would see it alike."""
    other = trial.alike[number]
    rest = (*trial.alike[:number], *trial.alike[number + 1 :])
    return replace(trial, candidate=other, alike=(trial.candidate, *rest))


def clipping_trials(
    null: Null, candidates: Sequence[Candidate], clipped: Mapping[str, Clip]
) -> tuple[Trial, ...]:
    """Sensors that may cut at the limits where the recordings are known to stay: `clipped`, by output."""
    found = []
    for candidate in candidates:
        clip = clipped.get(candidate.site.name)
        if candidate.effect.class_name != SATURATION or candidate.site.kind != "output":
            continue
        if clip is None or clip.is_certain or not clip.limit:
            continue
        reach = max(abs(clip.limit), 1e-12)
        shape = {
            p.name: reach * (CLIPPED_WITHIN if p.role == "sharpness" else 1.0)
            for p in candidate.effect.parameters
            if p.role in ("shape", "sharpness")
        }
        units = units_at(null.flat, candidate.effect, candidate.site)
        placed = replace(candidate, name=f"{candidate.name}_0", shape=shape, units=units)
        found.append(Trial(placed, (CUT,) * len(candidate.effect.sizes), ()))
    return tuple(found)


def could_compete(trial: Trial, best: Proof | None, screen: Screen) -> bool:
    """Whether a candidate may come near the best accepted one, to judge by their scores.

    Where the best leaves nothing, its response is all that is missing, and a candidate whose response has the
    correlation ρ with it gains about ρ² of what it gains.
    """
    if best is None or best.left is None or is_significant(best.left, best.delta_log_likelihood):
        return True
    if _may_be_of_the_kink(best, trial.candidate):
        return True
    names = [entry.candidate.name for entry in screen.entries]
    if not {best.candidate.name, trial.candidate.name} <= set(names):
        return True
    correlation = screen.correlation[names.index(best.candidate.name), names.index(trial.candidate.name)]
    return bool((1.0 - correlation**2) * best.delta_log_likelihood < GATES.hopeless_log_likelihood)


def _position(candidate: Candidate) -> tuple[int, ...]:
    """Place in the order of the search, which is that of the library and of the model."""
    return tuple(int(part) for part in candidate.name.split("_")[1:] if part.isdigit())


@dataclass(frozen=True)
class Prepared:
    """A candidate model ready for its search, which starts from the noise and the initial states of
    `similar`, if there is a fit of a simpler law, or of `simulation`, if it comes from one, else from the
    null's. One that `has_loop` is solved by iterations at every point, and takes longest. A refit below the
    log-likelihood `useless` says less than one of the same law that is known: it is not judged further. One
    that says less than the accepted `simpler` law, which it contains and was started from, is judged in
    brief. One that is `by_shooting` starts from a simulation by multiple shooting. `simulated` is the
    log-likelihood of the simulation that its values are from, if they are."""

    trial: Trial
    flat: FlatModel
    names: tuple[str, ...]
    similar: FitResult | None = None
    simulation: FitResult | None = None
    has_loop: bool = False
    useless: float = -np.inf
    simpler: Proof | None = None
    by_shooting: bool = False
    simulated: float = -np.inf


def prepare(
    flat: FlatModel, estimated: Sequence[str], trial: Trial, share: float = 1.0, sharper: float = SHARPER
) -> Prepared:
    """`flat` with the effect attached, sizes started from a `share` of the screen's estimate, kinks `sharper`
    than in the screen."""
    candidate = trial.candidate
    effect = candidate.effect
    sharp = {
        p.name: sharper * candidate.shape[p.name]
        for p in effect.parameters
        if p.role == "sharpness" and p.name in candidate.shape
    }
    sizes = {
        p.name: (p.null or 0.0) + share * (size - (p.null or 0.0))
        for p, size in zip(effect.sizes, trial.sizes, strict=True)
    }
    inside = {p.name: _inside(sizes[p.name], p.min, p.max) for p in effect.sizes}
    values = {**candidate.shape, **sharp, **inside}
    grown = attach(flat, effect, candidate.site, candidate.name, values, candidate.inputs)
    return Prepared(trial, grown, (*estimated, *candidate.estimated))


def _inside(value: float, low: float | None, high: float | None) -> float:
    """A start value off its bounds, since a search in logarithms cannot leave zero."""
    if low is not None and high is not None and not low < value < high:
        return low + (0.1 if value <= low else 0.9) * (high - low)
    if low is not None and value <= low:
        return low + 0.1 * max(abs(value), abs(low), 1e-3)
    if high is not None and value >= high:
        return high - 0.1 * max(abs(value), abs(high), 1e-3)
    return value


def at_full_size(null: Null, prepared: Prepared) -> tuple[Callable[[], Prepared], ...]:
    """Makers of the candidate near its full size, with the parameters that the null's search began with,
    rounded as in the screen and sharper; none for one that is not a share in what a sensor shows.

    Half a sensor of magnitude is worse than none, so that a search from a small share ends there; and beside
    loads that imitate a sensor, the null's parameters may have gone anywhere. A sharp kink makes a likelihood
    of many valleys."""
    trial, effect = prepared.trial, prepared.trial.candidate.effect
    is_share = all(p.max is not None and p.min == p.null and p.start == p.max for p in effect.sizes)
    if trial.candidate.site.kind != "output" or not is_share or prepared.similar is not None:
        return ()
    begun = {p.name: p.initial for p in null.fit.parameters if p.name in null.estimated}
    flat, made = null.flat.with_theta(begun), []
    for sharper, share in ((1.0, NEARLY), (SHARPER, CUT)):
        nulls = [p.null or 0.0 for p in effect.sizes]
        sizes = tuple(low + share * (p.start - low) for p, low in zip(effect.sizes, nulls, strict=True))
        full = replace(trial, sizes=sizes)
        made.append(partial(prepare, flat, null.estimated, full, sharper=sharper))
    return tuple(made)


def from_simulation(prepared: Prepared, proof: Proof) -> Prepared | None:
    """The candidate of `proof` at its estimates without loads, where the refit beside them has lost a
    parameter that those keep: a load that is free enough does without an input, say, and nothing can be told
    of a model that has none. None where nothing is lost."""
    if proof.final is None:
        return None
    kept = {name: proof.final.theta[name] for name in prepared.names if name in proof.final.theta}
    apart = [proof.fit.theta[name] / value for name, value in kept.items() if value]
    if not any(0.0 < ratio < 1.0 / FAR for ratio in apart):
        return None
    flat = with_equations(proof.flat, "a refit")
    known = {p.name: p for p in flat.parameters}
    inside = {name: _inside(value, known[name].min, known[name].max) for name, value in kept.items()}
    trial = replace(prepared.trial, candidate=proof.candidate)
    return replace(prepared, trial=trial, flat=flat.with_theta(inside), simulation=None)


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
    explicit = reduce_index(prepared.flat)
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
    n_own = len(prepared.names) - len(null.estimated)
    delta_bic = bic_gain(gain, n_own, null)
    with_effect = grown(fed, prepared.flat, explicit, fit, experiments)
    # Without a load the observer waits until the gates that need none are passed.
    after = None if load is None else run_null(with_effect)
    explained = _explained(null_fit, with_effect, after, load)
    p_value = float(min(1.0, n_screened * chi2.sf(2.0 * max(gain, 0.0), n_own)))
    reason = _without_evidence(gain, delta_bic, p_value, n_screened)
    if fit.log_likelihood < prepared.useless:
        reason = reason or "the same law, started otherwise, explains the data better"
    final: FitResult | None = None
    ahead: tuple[Ahead, ...] = ()
    told = Confirmed()
    is_open = is_curve = is_told = is_shown = False
    used = InUse()
    unseen_form = ""
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
        undetermined = _vanished(prepared.trial.candidate, final or fit)
        undetermined = undetermined or _undetermined(prepared.trial.candidate, final or fit)
        if not against and not undetermined:
            formless = _formless(with_effect, prepared.trial.candidate, final or fit)
            is_open = not formless
            unseen_form = formless or _out_of_reach(with_effect, prepared.trial.candidate, final or fit)
        reason = against or undetermined or unseen_form
        reason = reason or _weak(prepared, final if is_shown and final else fit)
        alone = grown(fed, prepared.flat, explicit, final or fit, experiments)
        reason = reason or _undriven(alone) or _of_its_start(null, alone, prepared.trial.candidate, reference)
        if not reason and not is_curve and not is_told and not is_shown:
            reason = _unexplained(explained, ratios)
    elif final is None:
        fit = refit.simulated(validation)
    left = None if reason else _left(null, with_effect, after or run_null(with_effect))
    too_short = ""
    if left is not None:
        if prepared.trial.candidate.is_dynamic:
            reason = _other_dynamics(left, gain)
            too_short = "" if reason else _too_short(null, prepared.trial.candidate, fit)
            reason = reason or too_short
        if is_curve and left.p_value < GATES.rest_level and not is_told and not is_shown:
            reason = _unexplained(explained, ratios)
        if not reason and not _is_most_of_it(explained, ratios, is_told, gain, left):
            reason = _wrong_law(null, run, prepared, fit, gain, left)
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
        is_any_dynamics=bool(too_short) and reason == too_short,
        is_known=not unseen_form and not _undetermined(prepared.trial.candidate, final or fit),
        confirmed=told,
        adds_up=reference is not None and reference.adds_up,
        in_use=used,
        is_shown=is_shown,
    )


def _undriven(model: Null) -> str:
    """Why nothing can be told of a model that its inputs hardly move; empty where they do, or none moves.

    What acts instead is unknown, and all forces may be larger together. Noise in a recorded input has the
    same effect: the fit does without it."""
    share = driven_share(model)
    if share is None or share >= GATES.min_driven:
        return ""
    return f"the recorded inputs move the model by {share:.1%} of what its outputs do: no size can be told"


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
    n_observed = sum(int(np.isfinite(e.outputs).sum()) for e in null.experiments)
    return float(2.0 * gain - n_more * np.log(n_observed))


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
    explicit = reduce_index(prepared.flat)
    used = _in_use(null, prepared, explicit, found, validation, reference)
    n_own = len(prepared.names) - len(null.estimated)
    is_shown = speaks_for(used, n_own) or (accepted is not None and says_more_in_use(used, accepted.in_use))
    refused = not is_shown or beside.delta_log_likelihood < -GATES.hopeless_log_likelihood
    candidate = prepared.trial.candidate
    refused = refused or bool(_weak(prepared, found))
    model = grown(null, prepared.flat, explicit, found, null.experiments)
    refused = refused or bool(_undriven(model))
    refused = refused or bool(_formless(model, candidate, found) or _out_of_reach(model, candidate, found))
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


def least_hope(leader: Proof | None, candidate: Candidate) -> float:
    """The log-likelihood below which the refit of another `candidate` is not pursued."""
    if leader is None or _may_be_of_the_kink(leader, candidate):
        return -np.inf
    return leader.fit.log_likelihood - GATES.hopeless_log_likelihood


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
        errors = _ahead_of(leader.ahead, ahead)
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
    found = refitted(prepared.flat, explicit, prepared.names, start, hopeless=hopeless)
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


def _wrong_law(
    null: Null, run: NullObserver, prepared: Prepared, fit: FitResult, gain: float, left: FreeForm
) -> str:
    """Why the law is not the right one: what it leaves follows a variable, and a single curve over that
    variable would say all that the law says, too. Empty where the rest is small, unrelated, or the law of
    something else that is missing besides; and where the law is such a curve itself and says more than the
    rest does: then it is right but for details, which are named."""
    if not is_significant(left, gain) or (not left.sign_of and gain > left.log_likelihood_gain):
        return ""
    try:
        response = law_response(null, run, prepared.trial.candidate, fit.theta)
    except DaestError:
        # A law with states of its own has no response. One that stands for dry friction, too, is a curve with
        # the sign of the speed in the main.
        is_covered = prepared.similar is not None and bool(left.sign_of)
    else:
        is_covered = covers(null, run, left, response) >= GATES.min_covered
    if not is_covered:
        return ""
    return f"another law acts there: what it leaves still follows {left.label} (p = {left.p_value:.1g})"


def _other_dynamics(left: FreeForm, gain: float) -> str:
    """Why a law that changes the order of the model only stands for another one; empty where it is right. A
    slow motion takes a lag, a delay or a flexible part for each other, and only the right one leaves
    nothing."""
    if left.p_value >= GATES.dynamics_level or left.log_likelihood_gain <= GATES.max_rest_of_dynamics * gain:
        return ""
    return (
        "something dynamic is missing that it only comes near to: what it leaves still follows "
        f"{left.label} (p = {left.p_value:.1g})"
    )


def _too_short(null: Null, candidate: Candidate, fit: FitResult) -> str:
    """Why a lag or a delay is no finding of its own beside the model as `fit` has it; empty where it is long
    enough to be one."""
    times = [fit.theta[f"{candidate.name}.{p.name}"] for p in candidate.effect.sizes if p.unit == "s"]
    if not times:
        return ""
    run = run_null(replace(null, flat=null.flat.with_theta(fit.theta)))
    loads = {load.name for load in null.loads}
    own = [i for i, name in enumerate(run.state_names) if name not in loads]
    fastest = max(np.abs(np.linalg.eigvals(run.average.A[np.ix_(own, own)])), default=0.0)
    if max(times) * fastest >= GATES.min_lag:
        return ""
    return (
        f"{spoken_duration(max(times))} is short beside the fastest time constant of the model "
        f"({spoken_duration(1.0 / fastest)}): "
        "a lag, a delay or a flexible part would do as well"
    )


def is_significant(left: FreeForm, gain: float) -> bool:
    """Whether what is left beside an effect that gained `gain` in log-likelihood is worth a further look."""
    return left.p_value < GATES.rest_level and left.log_likelihood_gain > GATES.max_rounding_rest * gain


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


def _without_evidence(gain: float, delta_bic: float, p_value: float, n_screened: int) -> str:
    """Why the likelihood says too little; empty where it says enough."""
    if gain < -LOST:
        return f"the search lost its way: it ends {-gain:.0f} below the likelihood of the model as it is"
    if delta_bic < GATES.min_bic_gain:
        return f"the likelihood gains too little for its parameters (BIC gain {delta_bic:.1f})"
    if p_value > GATES.max_chance:
        return f"a search over {n_screened} candidates finds as much by chance (p = {p_value:.1g})"
    return ""


def _weak(prepared: Prepared, fit: FitResult) -> str:
    """Why its shape or its sizes prove nothing; empty where they do."""
    candidate = prepared.trial.candidate
    found = {p.name: p for p in fit.parameters}
    for shape in (p for p in candidate.effect.parameters if p.role == "shape"):
        own = found.get(f"{candidate.name}.{shape.name}")
        if own is not None and own.at_bound:
            return f"its {shape.name} rests at its bound ({own.at_bound} = {own.value:.4g})"
    reasons = []
    for parameter in candidate.effect.sizes:
        size = found.get(f"{candidate.name}.{parameter.name}")
        if size is None:
            continue
        # Beside estimated shapes a size alone tells little: there the likelihood ratio has spoken.
        shares = sum(p.estimate for p in candidate.effect.parameters) > len(candidate.effect.sizes)
        least = GATES.min_dynamic_significance if candidate.is_dynamic else GATES.min_significance
        certainty = _certainty(candidate, fit, size, parameter)
        reason = _weak_size(size, parameter.null or 0.0, 0.0 if shares else least, certainty)
        if not reason:
            return ""
        reasons.append(reason)
    return "; ".join(reasons) or "its size was not estimated"


def _vanished(candidate: Candidate, told: FitResult) -> str:
    """Why the law is not there, where without coloured loads its sizes go to where it does nothing: what
    foresees unseen data better are then the other parameters. Empty where one stays."""
    found = {p.name: p for p in told.parameters}
    sizes = [(found.get(f"{candidate.name}.{p.name}"), p.null or 0.0) for p in candidate.effect.sizes]
    reasons = [
        _weak_size(size, null, 0.0, np.inf)
        for size, null in sizes
        if size is not None and size.at_bound and abs(size.value - null) < abs(size.initial - null)
    ]
    if not reasons or len(reasons) < len(sizes) or not all(reasons):
        return ""
    return f"without unknown loads {'; '.join(reasons)}"


def _undetermined(candidate: Candidate, told: FitResult) -> str:
    """Why the law is not the one that the data show, where they determine none of its parameters: it then
    stands for any law that does the same in these data. Empty where at least one of them is known."""
    law = {
        f"{candidate.name}.{p.name}": p for p in candidate.effect.parameters if p.role in ("size", "shape")
    }
    own = [p for p in told.parameters if p.name in law]
    unknown = [
        told_value(p)
        for p in own
        if not _is_known(p, law[p.name], _certainty(candidate, told, p, law[p.name]))
    ]
    if not own or len(unknown) < len(own):
        return ""
    return f"the data determine none of its parameters ({', '.join(unknown)})"


def _formless(model: Null, candidate: Candidate, told: FitResult) -> str:
    """Why the law is not what its name says, where a length or speed over which it has its form is so large
    that the recordings show a part of the form alone, which may belong to any other: a third of a period is a
    cubic spring beside a constant force. Empty where it is not."""
    scaled = [p for p in _scaled(candidate) if not _is_place(p)]
    reached = (
        largest_values(grown(model, model.flat, model.explicit, told, model.experiments)) if scaled else {}
    )
    for p in scaled:
        value = abs(told.theta[f"{candidate.name}.{p.name}"])
        most = reached.get(scaled_by(candidate, p), np.inf)
        if value > GATES.max_scale * most:
            return f"the recordings (to {most:.4g}) show too little of its form ({p.name} = {value:.4g})"
    return ""


def _out_of_reach(model: Null, candidate: Candidate, told: FitResult) -> str:
    """Why the law is not what its name says, where its places along a variable, such as a rim or a stop, lie
    beyond all that the variable comes to in the simulation: the law then lives on how its kink is rounded.
    Empty where it does not."""
    places = {p.name: f"{candidate.name}.{p.scale_of}" for p in _scaled(candidate) if _is_place(p)}
    if not places:
        return ""
    reached = largest_values(grown(model, model.flat, model.explicit, told, model.experiments))
    beyond = ""
    for name, variable in places.items():
        value, most = abs(told.theta[f"{candidate.name}.{name}"]), reached.get(variable, np.inf)
        if value <= GATES.max_place * most:
            return ""
        beyond = f"its {name} ({value:.4g}) lies beyond all that the recordings reach ({most:.4g})"
    return beyond


def _scaled(candidate: Candidate) -> list[EffectParameter]:
    """The shapes of the effect that are estimated and lie along one of its variables."""
    return [p for p in candidate.effect.parameters if p.role == "shape" and p.estimate and p.scale_of]


def _is_place(parameter: EffectParameter) -> bool:
    """Whether a shape along a variable is a place there: it is looked for near the end of its reach."""
    return PLACED <= max(map(abs, parameter.grid), default=0.0) < 1.0


def _is_known(parameter: FittedParameter, declared: EffectParameter, certainty: float) -> bool:
    if declared.role == "size" and parameter.at_bound == "max" and (declared.null or 0.0) < parameter.value:
        return True  # as much of the effect as there can be
    return certainty >= GATES.min_significance


def _certainty(
    candidate: Candidate, told: FitResult, own: FittedParameter, declared: EffectParameter
) -> float:
    """How many standard errors a parameter of a law is off its null. A size counts by its ratio to a
    parameter of the model, too, where that cannot vanish: torques whose scale no sensor tells are as
    uncertain as this scale, each of them, and none of them is zero for that. Not the size of a law that
    changes the order of the model, whose ratios to other times are no scales. 0 where nothing is known."""
    null, error = declared.null or 0.0, own.std_error
    if error is None:
        return 0.0
    alone = abs(own.value - null) / error if error else np.inf
    if declared.role != "size" or null or candidate.effect.is_dynamic or not own.value:
        return alone
    names, cov = told.covariance()
    known = dict(zip(names, range(len(names)), strict=True))
    if own.name not in known:
        return alone
    scales = [
        p
        for p in told.parameters
        if p.name in known
        and not p.name.startswith(f"{candidate.name}.")
        and p.min is not None
        and p.min >= 0.0 < p.value
    ]
    i, found = known[own.name], alone
    for p in scales:
        j = known[p.name]
        relative = np.array([1.0 / own.value, -1.0 / p.value])
        spread = float(relative @ cov[np.ix_([i, j], [i, j])] @ relative)
        found = max(found, float(1.0 / np.sqrt(spread)) if spread > 0.0 else 0.0)
    return found


def told_value(parameter: FittedParameter) -> str:
    """The parameter of an effect with its uncertainty, as messages tell it."""
    error = "" if parameter.std_error is None else f" ± {parameter.std_error:.2g}"
    unit = "" if parameter.unit == "1" else parameter.unit
    return f"{parameter.name.partition('.')[2]} = {parameter.value:.4g}{error} {unit}".rstrip()


def _unexplained(explained: float, ratios: Sequence[float]) -> str:
    """Why the effect does away with too little of the load; empty where it does with enough."""
    if explained >= (
        GATES.min_partly_explained
        if ratios and max(ratios) <= GATES.max_simulated_ratio
        else GATES.min_explained
    ):
        return ""
    return f"it explains only {100 * explained:.0f} % of the unexplained load"


def _weak_size(size: FittedParameter, null: float, least: float, certainty: float) -> str:
    if size.at_bound == "max" and null < size.value:
        return ""  # as much of the effect as there can be
    if size.at_bound:
        return f"its size rests at its bound ({size.at_bound} = {size.value:.4g})"
    if size.std_error is None:
        return "the data do not determine its size"
    if certainty < least:
        return f"its size is not significant ({size.value:.4g} ± {size.std_error:.2g} {size.unit})"
    return ""


def ranked(proofs: Sequence[Proof]) -> tuple[Proof, ...]:
    """Best first. Accepted candidates that are rivals of the best (`_is_rival`) are not separable from it: of
    them, those come first that foresee unseen data clearly better, then the likeliest. A law that the best
    one only rounds otherwise (`_is_rounded_otherwise`) is not separable from it, either. Where a refused one
    is far more likely, none is the explanation."""
    order = sorted(_on_one_basis(proofs), key=lambda p: (p.verdict == "rejected", -p.delta_bic))
    accepted = [p for p in order if p.verdict == "supported"]
    if not accepted:
        return tuple(order)
    best = _simplest(accepted)
    stronger = _far_more_likely(order, best)
    if stronger is not None:
        worse = stronger.delta_bic - best.delta_bic
        better = f"{stronger.candidate.label} explains the data far better (BIC {worse:.0f})"
        reason = f"{better}, but {stronger.reason}"
        return tuple(
            p if p.verdict == "rejected" else replace(p, verdict="rejected", reason=reason) for p in order
        )
    close = [p for p in accepted if _is_rival(p, best)]
    same = [p for p in accepted if p is not best and _is_same_equation(p, best)]
    close = [p for p in close if p not in same]
    nested = [p for p in close if _is_same_beside_a_load(p, best)]
    close = [p for p in close if p not in nested]
    twins = [p for p in close if p is not best and _is_twin(p, best)]
    close = [p for p in close if p not in twins]
    doubted = [p for p in order if p not in close and _is_rounded_otherwise(p, best)]
    close += doubted
    result = []
    for proof in order:
        if proof.verdict == "rejected" and proof not in doubted:
            result.append(proof)
        elif proof in twins:
            reason = f"the data do not tell it from the same effect at {best.candidate.site.name}"
            result.append(replace(proof, verdict="rejected", reason=reason))
        elif proof in nested:
            reason = f"beside a constant load it says no more than {best.candidate.label}"
            result.append(replace(proof, verdict="rejected", reason=reason))
        elif proof in close:
            others = tuple(p.candidate.label for p in close if p is not proof)
            alike = tuple(p.candidate.site.name for p in twins if proof is best)
            result.append(
                replace(
                    proof,
                    equivalent=(*proof.equivalent, *(name for name in alike if name not in proof.equivalent)),
                    not_separable_from=others,
                    verdict="not separable" if others else "supported",
                    reason="",
                    same_as=tuple(p.candidate.label for p in same) if proof is best else (),
                )
            )
        else:
            worse = best.delta_bic - proof.delta_bic
            if proof in same:
                reason = f"it is the same equation as {best.candidate.label}"
                result.append(replace(proof, verdict="rejected", reason=reason))
                continue
            reason = f"{best.candidate.label} explains the data better (BIC {worse:.0f})"
            if worse < 0.0:
                reason = f"{best.candidate.label} says nearly as much with fewer parameters"
            result.append(replace(proof, verdict="rejected", reason=reason))
    return tuple(sorted(result, key=partial(_place, best)))


def _on_one_basis(proofs: Sequence[Proof]) -> list[Proof]:
    """Where a law is accepted for what its simulation gains, all that are accepted count by that: with an
    observer, much of the same law goes into the loads, and its gain is another one. An open law that its
    simulation shows more clearly than all of them is then accepted, too, whatever it leaves for the loads.

    All count for as many independent samples, the fewest of any. How many a law has goes with how long its
    errors last: one that leaves slow ones alone would gain less than one that leaves more of every kind."""
    if not any(p.is_by_use and p.verdict != "rejected" for p in proofs):
        return list(proofs)
    known = [p.in_use for p in proofs if _is_compared(p) and p.in_use.n_independent]
    fewest = min(used.n_independent for used in known), min(used.n_unseen for used in known)
    found = [_by_use(p, *fewest) if _is_compared(p) else p for p in proofs]
    pairs = list(zip(proofs, found, strict=True))
    least = GATES.same_bic + max(
        new.delta_bic for old, new in pairs if old.verdict != "rejected" and new.is_by_use
    )
    return [old if old.verdict == "rejected" and new.delta_bic <= least else new for old, new in pairs]


def _is_compared(proof: Proof) -> bool:
    """Whether a law counts by its simulation where laws do: one that is accepted, or open and shown by it."""
    return proof.verdict != "rejected" or (proof.is_open and proof.is_shown)


def _by_use(proof: Proof, n_independent: float, n_unseen: float) -> Proof:
    """The proof with the evidence of its simulation for that many independent samples; as it is where that
    is unknown."""
    if not proof.in_use.n_independent:
        return proof
    used = replace(proof.in_use, n_independent=n_independent, n_unseen=n_unseen)
    return replace(
        proof,
        delta_log_likelihood=used.gain,
        delta_bic=used.bic(len(proof.candidate.estimated)),
        verdict="supported",
        reason="",
        is_by_use=True,
    )


def _place(best: Proof, proof: Proof) -> tuple[bool, float, int, float]:
    """What a proof is ranked by, smallest first. Of laws that foresee unseen data clearly better and alike,
    the one with the fewest parameters of any kind is first."""
    ratio = 1.0 if proof.verdict == "rejected" or _is_vague(proof, best) else _unseen_ratio(best, proof)
    n_parameters = len(proof.candidate.effect.parameters) if ratio < GATES.max_rival_error else 0
    ratio = round(min(ratio, GATES.max_rival_error), 2)
    return proof.verdict == "rejected", ratio, n_parameters, -proof.delta_bic


def _is_same_equation(one: Proof, other: Proof) -> bool:
    """Whether two laws do the same under two names: as a heat flow into a node and a gain in proportion to
    it; or as an offset and a dead zone of which the recordings show one side alone."""
    if abs(one.delta_log_likelihood - other.delta_log_likelihood) > GATES.same_equation:
        return False
    values, others = (_values_of_model(p) for p in (one, other))
    return len(_own_sizes(one)) == len(_own_sizes(other)) and all(
        abs(a.value - b.value) <= GATES.same_equation * (a.std_error or 0.0)
        for a, b in zip(values, others, strict=True)
    )


def _is_same_beside_a_load(richer: Proof, simple: Proof) -> bool:
    """Whether a law goes beyond one for the same quantity by parameters that only make up for a constant
    load: where each recording has one, both foresee unseen data alike."""
    if simple.steady_error is None or richer.steady_error is None:
        return False
    units, others = ([p.unit for p in law.candidate.effect.sizes] for law in (richer, simple))
    return (
        units == others
        and len(_own_sizes(richer)) > len(_own_sizes(simple))
        and richer.steady_error > (1.0 - GATES.same_unseen_error) * simple.steady_error
    )


def _is_twin(one: Proof, other: Proof) -> bool:
    """Whether two laws are the same effect at two places that the data hardly tell apart, with the same
    estimates: which effect it is is known, where it is not."""
    if one.candidate.effect.class_name != other.candidate.effect.class_name:
        return False
    if abs(one.delta_log_likelihood - other.delta_log_likelihood) > GATES.same_fit_elsewhere:
        return False
    values, others = ({p.name.rpartition(".")[2]: p for p in _told_of_effect(law)} for law in (one, other))
    return values.keys() == others.keys() and all(
        a.unit == others[name].unit and _agree(a, others[name]) for name, a in values.items()
    )


def _told_of_effect(proof: Proof) -> list[FittedParameter]:
    return [p for p in proof.told.parameters if p.name in proof.candidate.estimated]


def _agree(a: FittedParameter, b: FittedParameter) -> bool:
    """Whether two estimates are within one standard error of their difference."""
    return abs(a.value - b.value) <= np.hypot(a.std_error or 0.0, b.std_error or 0.0)


def _values_of_model(proof: Proof) -> list[FittedParameter]:
    """The parameters but those of the effect, which each law counts in its own unit."""
    own = f"{proof.candidate.name}."
    return [p for p in proof.fit.parameters if not p.name.startswith(own)]


def best_accepted(proofs: Sequence[Proof]) -> Proof | None:
    """The first of `ranked` proofs that is accepted, be it separable from others or not; None where all are
    rejected."""
    return next((p for p in proofs if p.verdict != "rejected"), None)


def _far_more_likely(order: Sequence[Proof], best: Proof) -> Proof | None:
    """A refused candidate beside which the best accepted one explains little; not one that foresees unseen
    data clearly worse: it owes its likelihood to what does not last. One that unseen data speak against where
    their predictions are compared, and for where their simulation is, contradicts itself: until it is known
    why, none is the explanation."""
    refused = [p for p in order if p.verdict == "rejected" and (_is_in_the_way(p, best) or _is_torn(p, best))]
    strongest = max(refused, key=lambda p: p.delta_log_likelihood, default=None)
    if (
        strongest is None
        or GATES.min_refused_gain * strongest.delta_log_likelihood < best.delta_log_likelihood
    ):
        return None
    return strongest


def _is_in_the_way(refused: Proof, best: Proof) -> bool:
    if not refused.is_open or _ends_in_a_simpler_law(refused, best):
        return False
    return _is_likelier_part(refused, best) or not _unseen_ratio(refused, best) < GATES.max_rival_error


def _ends_in_a_simpler_law(refused: Proof, best: Proof) -> bool:
    """Whether a law with more parameters at the place of the best one has come to a bound of one of them: it
    is the same law there, rounded otherwise, and no other that acts."""
    own = f"{refused.candidate.name}."
    rests = any(p.at_bound for p in refused.fit.parameters if p.name.startswith(own))
    more = len(refused.candidate.estimated) > len(best.candidate.estimated)
    unit = refused.candidate.effect.sizes[0].unit == best.candidate.effect.sizes[0].unit
    return rests and more and unit and refused.candidate.site == best.candidate.site


def _is_likelier_part(refused: Proof, best: Proof) -> bool:
    """Whether the best law is the sum of another one and something besides, and yet less likely than that
    alone: what it owes to the other part belongs to a third effect that the model lacks, too."""
    one, other = refused.candidate, best.candidate
    is_part = one.effect.name in other.effect.sum_of and one.site == other.site
    return is_part and refused.delta_bic > best.delta_bic + GATES.same_bic


def _is_torn(refused: Proof, best: Proof) -> bool:
    """Whether predictions of unseen data speak against a law, and their simulation for it."""
    is_refuted = any(is_worse(one) for one in refused.ahead)
    return is_refuted and _unseen_ratio(best, refused) < GATES.max_rival_error


def _is_rival(one: Proof, best: Proof) -> bool:
    """Whether an accepted law is not put aside by the best one: it is as likely; or it foresees unseen data
    clearly better, which counts where the rest of the model is not right either. One that goes beyond the
    best by parameters that nobody knows is a rival where they make it likelier: without them it is the best
    one, which no data could tell it from. A law that is better in one output and worse in another is missing
    besides."""
    if _is_of_the_kink(one, best):
        return False
    if _is_vague(one, best):
        return one.delta_bic > best.delta_bic
    return (
        abs(best.delta_bic - one.delta_bic) <= GATES.same_bic
        or _unseen_ratio(best, one) < GATES.max_rival_error
        or _is_as_good(best, one)
    )


def _is_as_good(best: Proof, one: Proof) -> bool:
    """Whether another law with as many parameters foresees unseen data as well, and is not very much less
    likely: the drift of a sensor and a constant load on a body that turns freely."""
    is_other = best.candidate.effect.class_name != one.candidate.effect.class_name
    if not is_other or len(_own_sizes(best)) != len(_own_sizes(one)):
        return False
    is_likely = abs(best.delta_bic - one.delta_bic) <= GATES.min_bic_gain
    if one.adds_up:
        ratios = list(_ahead_of(best.ahead, one.ahead).values())
    else:
        ratios = list(error_ratios(best.told.simulated, one.told.simulated))
    return is_likely and bool(ratios) and all(abs(r - 1.0) <= GATES.same_unseen_error for r in ratios)


def _ahead_of(best: Sequence[Ahead], one: Sequence[Ahead]) -> dict[int, float]:
    """Errors of predictions of unseen data relative to those of the best law, by horizon in samples, where
    both are known."""
    known = {a.samples: a.ratio for a in best}
    return {a.samples: a.ratio / known[a.samples] for a in one if a.samples in known}


def _unseen_ratio(best: Proof, one: Proof) -> float:
    """Error of `one` on unseen data relative to that of `best`: of the whole simulation, or of predictions at
    the longest horizon where the simulation is dead reckoning. inf where it is unknown, or an output gets
    worse. A law that is better by no more than a constant load is not better: where it is known, that with
    one counts (`with_steady_error`)."""
    if one.adds_up:
        ahead = _ahead_of(best.ahead, one.ahead)
        return ahead[max(ahead)] if ahead else np.inf
    ratios = error_ratios(best.told.simulated, one.told.simulated)
    if not ratios or max(ratios) > 1.0 + GATES.same_unseen_error:
        return np.inf
    whole = float(np.sqrt(np.mean(np.square(ratios))))
    if best.steady_error and one.steady_error is not None:
        return max(whole, one.steady_error / best.steady_error)
    return whole


def _is_vague(richer: Proof, simple: Proof) -> bool:
    """Whether a law at the place of a simple one goes beyond it by parameters of which the data leave one
    undetermined: it may stand for the way in which the simple law is rounded."""
    known = {p.name.rpartition(".")[2] for p in _own_sizes(simple)}
    more = [p for p in _own_sizes(richer) if p.name.rpartition(".")[2] not in known]
    return (
        richer.candidate.site == simple.candidate.site
        and len(_own_sizes(richer)) > len(known)
        and simple.delta_log_likelihood > GATES.min_vague_gain * richer.delta_log_likelihood
        and any(p.at_bound or abs(p.value) < GATES.min_significance * (p.std_error or np.inf) for p in more)
    )


def _is_of_the_kink(richer: Proof, simple: Proof) -> bool:
    """Whether a law at the place of a simple one for the same quantity has its form within what its own kink
    is rounded over: it says how the kink is, which is sharper than either is rounded, and no more."""
    gains_enough = simple.delta_log_likelihood > GATES.min_kinked_gain * richer.delta_log_likelihood
    return gains_enough and _may_be_of_the_kink(richer, simple.candidate)


def _is_rounded_otherwise(simple: Proof, best: Proof) -> bool:
    """Whether a law that is refused, or less likely, may be so for nothing but how its kink is rounded."""
    least = GATES.min_kinked_gain if simple.verdict == "rejected" else GATES.min_doubted_gain
    gains_enough = simple.delta_log_likelihood > least * best.delta_log_likelihood
    return gains_enough and _may_be_of_the_kink(best, simple.candidate)


def _may_be_of_the_kink(richer: Proof, simple: Candidate) -> bool:
    one = richer.candidate
    is_beyond = len(one.estimated) > len(simple.estimated)
    is_alike = one.site == simple.site and one.effect.sizes[0].unit == simple.effect.sizes[0].unit
    return is_beyond and is_alike and _has_form_in_kink(richer)


def _has_form_in_kink(proof: Proof) -> bool:
    effect, theta = proof.candidate.effect, proof.told.theta
    value = {p.name: theta.get(f"{proof.candidate.name}.{p.name}", np.nan) for p in effect.parameters}
    kinks = {p.scale_of: value[p.name] for p in effect.parameters if p.role == "sharpness"}
    forms = [p for p in _scaled(proof.candidate) if p.scale_of in kinks]
    return any(abs(value[p.name]) < GATES.max_form_in_kink * kinks[p.scale_of] for p in forms)


def _own_sizes(proof: Proof) -> list[FittedParameter]:
    return [p for p in proof.fit.parameters if p.name.startswith(f"{proof.candidate.name}.")]


def _simplest(accepted: Sequence[Proof]) -> Proof:
    """The best by BIC, or one at the same place with fewer parameters that gains nearly as much: with much
    data, the way in which a law is rounded is significant, too (`_is_of_the_kink`). Of laws that are the same
    on these data, the one with the fewest parameters of any kind, and then with the fewest connectors: what
    runs over is lost, as long as nothing tells where it goes."""
    same = [p for p in accepted if p is accepted[0] or _is_same_equation(p, accepted[0])]
    best = min(same, key=lambda p: (len(p.candidate.effect.parameters), len(p.candidate.effect.connectors)))
    simpler = [
        p
        for p in accepted
        if _is_same_beside_a_load(best, p)
        or _is_of_the_kink(best, p)
        or (
            p.candidate.site == best.candidate.site
            and len(p.fit.parameters) < len(best.fit.parameters)
            and (
                p.delta_log_likelihood > GATES.min_simpler_gain * best.delta_log_likelihood
                or _is_vague(best, p)
            )
        )
    ]
    return min(simpler, key=lambda p: len(p.fit.parameters), default=best)
