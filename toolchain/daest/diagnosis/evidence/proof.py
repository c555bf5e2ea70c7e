"""Proof: a candidate built into the model, everything refitted, gates before ranking."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from daest.diagnosis.built_in.dead_times import DELAY
from daest.diagnosis.built_in.late_signals import is_late
from daest.diagnosis.built_in.settled import LOST, better_of, fit_by_simulation, settled
from daest.diagnosis.built_in.trials import Prepared
from daest.diagnosis.evidence.answered_inputs import answers_output
from daest.diagnosis.evidence.free_starts import misfit, steady_misfit
from daest.diagnosis.evidence.law_values import ahead_of
from daest.diagnosis.evidence.open_loop import (
    Simulated,
    errors_in_pieces,
    in_use,
    leaves_an_output,
    rivals_in_use,
    simulated_errors,
    speaks_for,
)
from daest.diagnosis.evidence.ranking import least_hope, says_less
from daest.diagnosis.evidence.reasons import (
    beyond_recordings,
    in_place_of_a_parameter,
    is_absent_at_once,
    is_history,
    lag_too_short,
    not_determined,
    other_dynamics,
    same_in_machine,
    too_slow,
    undriven,
    unexplained,
    unforeseen,
    vanished,
    weak,
    without_evidence,
    without_form,
    wrong_law,
)
from daest.diagnosis.evidence.unseen import (
    Foreseen,
    Innovations,
    compared,
    confirmed,
    foreseen,
    foretold_drift,
    innovations,
    is_worse,
    judged,
    unconfirmed,
)
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import Null, grown, loads_of, period_of, refitted
from daest.diagnosis.null_model.null_observer import NullObserver, run_null
from daest.diagnosis.screening.candidates import brings_time
from daest.diagnosis.screening.disturbance import SmoothedLoad, smoothed_at
from daest.diagnosis.screening.free_forms import free_forms
from daest.diagnosis.screening.within_sample import acts_later
from daest.errors import DaestError
from daest.estimation.fitting.records import longest_duration, n_observed, part_of
from daest.estimation.nonlinear.identify_nonlinear import Refit
from daest.model.diagnosis import Ahead, Candidate, Confirmed, FreeForm, InUse, Load, Proof
from daest.model.experiment import Experiment
from daest.model.fit import FitResult, error_ratios
from daest.model.flat import ExplicitModel, FlatModel, with_equations
from daest.modelica.flat.clock import clock_unit
from daest.modelica.places.balances import needs_position
from daest.numerics.statistics import chi2
from daest.numerics.tables import turned
from daest.systems.linear.linearize import has_affine_dynamics
from daest.systems.reduction.reduce import reduce_index

LONGER = 2  # searches that go on where one has come to its limit
LONG = 10_000  # samples, from which a search of a model that bends, or by shooting, takes a part first, ...
SHORTER = 4  # ... a fourth of every recording
CALM = 1e-6  # of the null's intensities of the loads, from which a search starts that needs none of them


@dataclass(frozen=True)
class Reference:
    """The model as it is, without coloured loads: what a law must foresee unseen data better than.
    `adds_up` tells that its simulation is dead reckoning, except of the outputs `holding`, else `simulated`
    are the errors of that and `opened` is the fit by simulation, where there is one, from which laws are
    looked for in open loop; `innovations` are those of the unseen data beside its loads."""

    fit: FitResult
    foreseen: Foreseen | None = None
    adds_up: bool = False
    innovations: Innovations | None = None
    simulated: Simulated | None = None
    holding: tuple[str, ...] = ()
    opened: FitResult | None = None

    @property
    def start_in_use(self) -> FitResult:
        """Where laws are looked for in open loop from."""
        return self.opened or self.fit


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
    """The refit of one candidate on `experiments`, the null's with the signals that the effect needs; pursued
    no further where it falls far behind the `leader`, unless its simulation has come further, or it is late
    by a time that the innovations have told: beside loads of the size that the null has, the search begins
    far below that. Raises what `refit` raises."""
    explicit = prepared.reduced()
    fed = replace(null, experiments=tuple(experiments))
    hopeless = least_hope(leader, prepared.trial.candidate)
    is_told_late = is_late(prepared.trial.candidate) and prepared.simulation is None
    hopeless = -np.inf if is_told_late or prepared.simulated > hopeless else hopeless
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
    """The judgement of a candidate whose search has ended: against the null refitted the same way, and by
    unseen data against the `reference`. The `leader` is the best supported candidate so far: one that is far
    behind it, and does not simulate unseen data better, is judged in brief.

    `run` is the null's observer, `load` its largest load and `form` the curve that it follows best;
    `n_screened` candidates were searched. Raises what the observer raises.
    """
    judge = _Judge(null, null_fit, found, tuple(validation), run, load, n_screened, leader, form, reference)
    return judge.proof()


@dataclass(frozen=True)
class _Told:
    """What the gates say of a law before what it leaves is looked at: the first `reason` against it, empty
    where there is none, and on what it stands. `final` are the estimates without loads, `vague` why the data
    determine none of its parameters, `unseen_form` why they show too little of its form."""

    reason: str
    fit: FitResult
    final: FitResult | None = None
    ahead: tuple[Ahead, ...] = ()
    confirmed: Confirmed = field(default_factory=Confirmed)
    in_use: InUse = field(default_factory=InUse)
    ratios: tuple[float, ...] = ()
    vague: str = ""
    unseen_form: str = ""
    is_open: bool = False
    is_told: bool = False
    is_curve: bool = False
    is_shown: bool = False


class _Refused(NamedTuple):
    """Why a law is not the right one, all of it empty where it is: the `reason` that counts, that a law with
    states only comes `near`, that a lag is `too_short` to be told, and that what it leaves is a part of what
    an `other` law says, too."""

    reason: str
    near: str = ""
    too_short: str = ""
    other: str = ""


@dataclass(frozen=True)
class _Judge:
    """A candidate whose search has ended, and what it is judged by: the arguments of `proof_of`."""

    null: Null
    null_fit: FitResult
    found: Searched
    validation: tuple[Experiment, ...]
    run: NullObserver
    load: SmoothedLoad | None
    n_screened: int
    leader: Proof | None
    form: FreeForm | None
    reference: Reference | None

    @property
    def prepared(self) -> Prepared:
        return self.found.prepared

    @property
    def candidate(self) -> Candidate:
        return self.prepared.trial.candidate

    @cached_property
    def fed(self) -> Null:
        """The null with the signals that the effect needs."""
        return replace(self.null, experiments=self.found.experiments)

    @cached_property
    def with_effect(self) -> Null:
        prepared, found = self.prepared, self.found
        return grown(self.fed, prepared.flat, found.explicit, found.refit.fit, found.experiments)

    @cached_property
    def observer(self) -> NullObserver:
        """That of the model with the effect."""
        return run_null(self.with_effect)

    @cached_property
    def explained(self) -> float:
        """Share of the loads that is gone."""
        after = None if self.load is None else self.observer
        return _explained(self.null_fit, self.with_effect, after, self.load)

    @cached_property
    def n_own(self) -> int:
        return self.prepared.n_unknowns(self.null.estimated) - self._n_never_recorded

    @property
    def _n_never_recorded(self) -> int:
        """How many of the states that a dead time begins with cannot follow anything: what went in before the
        first sample comes out while it lasts, which is as many samples."""
        candidate = self.candidate
        if candidate.effect.class_name != DELAY:
            return 0
        lasts = self.found.refit.fit.theta[f"{candidate.name}.{candidate.effect.sizes[0].name}"]
        n_samples = int(np.ceil(lasts / period_of(self.found.experiments)))
        return max(candidate.n_memory - max(n_samples, 1), 0)

    @cached_property
    def delta_bic(self) -> float:
        return bic_gain(self.found.gain, self.n_own, self.null)

    @cached_property
    def p_value(self) -> float:
        chance = self.n_screened * chi2.sf(2.0 * max(self.found.gain, 0.0), self.n_own)
        return float(min(1.0, chance))

    def proof(self) -> Proof:
        found, candidate, explained = self.found, self.candidate, self.explained
        told = self._unlikely() or self._in_brief() or self._gated()
        left = None if told.reason else _left(self.null, self.with_effect, self.observer)
        refused = _Refused(told.reason) if left is None else self._against_rest(told, left)
        reason = refused.reason
        vague = told.vague or not_determined(candidate, told.final or told.fit, self._before, gain=found.gain)
        return Proof(
            candidate=candidate,
            flat=self.prepared.flat.with_theta(told.fit.theta),
            fit=told.fit,
            delta_log_likelihood=found.gain,
            delta_bic=self.delta_bic,
            p_value=self.p_value,
            explained=explained,
            equivalent=tuple(c.site.name for c in self.prepared.trial.alike),
            not_separable_from=(),
            verdict="rejected" if reason else "supported",
            reason=reason,
            left=left,
            final=told.final,
            ahead=told.ahead,
            is_open=bool(reason) and told.is_open,
            is_vague=bool(told.vague) and reason == told.vague,
            takes_little=bool(reason) and reason == unexplained(explained, told.ratios),
            is_any_dynamics=bool(refused.too_short) and reason == refused.too_short,
            comes_near=bool(refused.near) and reason == refused.near,
            is_other_law=bool(refused.other),
            is_known=not told.unseen_form and not vague and not self._is_before_unseen(told),
            confirmed=told.confirmed,
            adds_up=self.reference is not None and self.reference.adds_up,
            holding=() if self.reference is None else self.reference.holding,
            in_use=told.in_use,
            is_shown=told.is_shown,
            inside="" if reason else same_in_machine(self.with_effect, candidate, told.final or told.fit),
        )

    def _is_before_unseen(self, told: _Told) -> bool:
        """Whether a lag or dead time is so long that what it does to the unseen data is mostly what was
        before these began, which may follow any transient."""
        return bool(self.validation and too_slow(self.validation, self.candidate, told.final or told.fit))

    @property
    def _before(self) -> FitResult:
        """The fit of the model as it is, without loads where there is one."""
        return self.null_fit if self.reference is None else self.reference.fit

    def _unlikely(self) -> _Told | None:
        """Refused by the likelihood of the recordings; None where that speaks for the law."""
        fit = self.found.refit.fit
        reason = without_evidence(self.found.gain, self.delta_bic, self.p_value, self.n_screened)
        if fit.log_likelihood < self.prepared.useless:
            reason = reason or "the same law, started otherwise, explains the data better"
        return _Told(reason, self.found.refit.simulated(self.validation)) if reason else None

    def _in_brief(self) -> _Told | None:
        """Refused beside a likelier law; None where there is none, or this one may be a rival of it."""
        fit = self.found.refit.fit
        is_hopeless = fit.log_likelihood < least_hope(self.leader, self.candidate)
        likelier = self.leader if is_hopeless or says_less(self.leader, self.candidate, fit) else None
        likelier = likelier or _better_simpler(self.prepared, fit, self.delta_bic)
        if likelier is None:
            return None
        final, ahead, reason = self._beside(likelier)
        return _Told(reason, fit, final, ahead) if reason else None

    def _beside(self, leader: Proof) -> tuple[FitResult | None, tuple[Ahead, ...], str]:
        """A first pass without coloured loads, what it does to the prediction of unseen data, and why a
        candidate that is far less likely than the `leader` is no rival of it by unseen data either
        (`_unseen_ratio`); None and empty where it may be one."""
        null, refit, reference, validation = self.fed, self.found.refit, self.reference, self.validation
        if reference is None or not validation:
            return None, (), ""
        flat, explicit = self.prepared.flat, self.found.explicit
        found = settled(null, refit.fit, flat, explicit, null.experiments, validation, is_rough=True)
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

    def _gated(self) -> _Told:
        """By unseen data, by what the data determine of the law, and by what it says of the load."""
        candidate, prepared, explicit = self.candidate, self.prepared, self.found.explicit
        refit, reference = self.found.refit, self.reference
        told = Confirmed()
        if reference is not None and self.validation:
            told = confirmed(reference.innovations, innovations(self.observer, self.validation))
        final, ahead, against, is_told = self._on_unseen(told)
        is_told = is_told and not _is_any_level(self.fed, prepared, reference)
        fit = refit.fit if final else refit.simulated(self.validation)
        last, used, is_shown = final or fit, InUse(), False
        if self.validation and not ahead and not against:
            against = unforeseen(last)
        if reference is not None and not against:
            used = used_by(self.fed, prepared, final, self.validation, reference)
            is_shown = speaks_for(used, self.n_own) and not leaves_an_output(
                self.explained, refit.fit, reference.fit, last
            )
        ratios = tuple(
            error_ratios((reference.fit if reference else self.null_fit).simulated, last.simulated)
        )
        vague = not_determined(candidate, last, self._before, gain=self.found.gain)
        gone = against or vanished(candidate, last)
        # A time constant of which the recordings show nothing is an integral and stands for a constant load.
        unseen_form = "" if gone else without_form(self.with_effect, candidate, last)
        is_open = not (gone or unseen_form or vague)
        if is_open:
            unseen_form = beyond_recordings(self.with_effect, candidate, last)
            is_open = not is_history(self.fed.experiments, candidate, last)
        reason = gone or unseen_form or vague
        reason = reason or in_place_of_a_parameter(candidate, last, self._before, ratios)
        is_all = self._is_nearly_all(ratios)
        seen = final if final and (is_shown or is_all) else fit
        reason = reason or weak(prepared, seen, self._before, self.found.gain)
        adds_up = self.reference is not None and self.reference.adds_up
        reason = reason or acts_later(self.run, candidate, last, self._before, adds_up=adds_up)
        reason = reason or answers_output(self.null, candidate, last)
        alone = grown(self.fed, prepared.flat, explicit, last, self.found.experiments)
        reason = reason or undriven(alone)
        if not reason:
            reason = _of_its_start(self.null, alone, candidate, reference)
            is_open = is_open and not reason  # what states gain by how they begin stands in no law's way
        reason = reason or _of_levels(self.fed, prepared, explicit, final, self.validation, reference)
        if not reason and not (self._says_all or is_told or is_shown or is_all):
            reason = unexplained(self.explained, ratios)
        if not reason and not (is_told or is_all):
            reason = unconfirmed(self.explained, ahead, told)
        return _Told(
            reason, fit, final, ahead, told, used, ratios, vague, unseen_form,
            is_open, is_told, self._says_all, is_shown,
        )  # fmt: skip

    def _on_unseen(self, told: Confirmed) -> tuple[FitResult | None, tuple[Ahead, ...], str, bool]:
        """The estimates without coloured loads, what they do to the prediction of unseen data, why these
        speak against the effect (empty where they do not), and whether most of the error is gone."""
        null, refit, reference, validation = self.fed, self.found.refit, self.reference, self.validation
        if reference is None or not validation:
            return None, (), "", False
        flat, explicit = self.prepared.flat, self.found.explicit
        against_by = partial(judged, clock=clock_unit(null.flat))
        found = settled(null, refit.fit, flat, explicit, null.experiments, validation)
        if found is None:
            simulation = refit.simulated(validation)
            against, _, is_told = against_by(
                (), reference.fit, simulation, reference.adds_up, told, holding=reference.holding
            )
            return None, (), against, is_told
        white, observer = found
        ahead = compared(reference.foreseen, foreseen(observer, validation), period_of(null.experiments))
        if reference.adds_up or any(is_worse(one) for one in ahead):
            final = white
        else:
            alone = fit_by_simulation(null, white, flat, null.experiments, validation, refit)
            final = better_of(white, alone)
        drift = foretold_drift(observer, validation) if reference.adds_up else None
        against, _, is_told = against_by(
            ahead, reference.fit, final, reference.adds_up, told, holding=reference.holding, drift=drift
        )
        if against and not reference.adds_up and not any(is_worse(one) for one in ahead):
            steady = _steady_ratio(null, flat, explicit, final, validation, reference)
            against, _, is_told = against_by(ahead, reference.fit, final, False, told, steady)
        return final, ahead, against, is_told

    @property
    def _says_all(self) -> bool:
        """Whether the law says all that the load has to do with any variable: it need not explain more of it
        than a part."""
        form = self.form
        says_all = (
            form is not None
            and form.p_value < GATES.rest_level
            and self.found.gain >= form.log_likelihood_gain
        )
        return says_all and self.explained >= GATES.min_curve_explained

    def _is_nearly_all(self, ratios: Sequence[float]) -> bool:
        """Whether errors of the simulation add up, and the law takes nearly all of them away on unseen data.
        Unknown loads do what is slow as well as the law does, so that its share of them says little, and
        what is fast and small looks large beside its gain."""
        adds_up = self.reference is not None and self.reference.adds_up
        return adds_up and bool(ratios) and max(ratios) <= GATES.max_adding_ratio

    def _against_rest(self, told: _Told, left: FreeForm) -> _Refused:
        """Why the law is not the right one by what it leaves."""
        gain, reason, near, too_short, other = self.found.gain, "", "", "", ""
        if self.candidate.is_dynamic:
            reason = near = other_dynamics(left, gain, told.ratios)
            too_short = "" if reason else lag_too_short(self.null, self.candidate, told.fit)
            reason = reason or too_short
        if told.is_curve and not told.is_told and not told.is_shown and _is_much_left(left, gain):
            reason = unexplained(self.explained, told.ratios)
        is_most = _is_most_of_it(self.explained, told.ratios, told.is_told, gain, left)
        if not reason and not is_most and not self._is_nearly_all(told.ratios):
            says_most = self._says_all or not unexplained(self.explained, told.ratios)
            reason = other = wrong_law(self.null, self.run, self.prepared, told.fit, gain, left, says_most)
        return _Refused(reason, near, too_short, other)


def _of_its_start(null: Null, model: Null, candidate: Candidate, reference: Reference | None) -> str:
    """Why an effect is not there that lives on how its own states begin, and not on what drives them: a mass
    of nothing that rings for ever from the first sample on is a sine of any origin. Empty where it does not.
    Of bodies alone: at rest they move with what they hang on, while a wall may be at any temperature. Where
    errors of the simulation add up, by those of the predictions."""
    if not candidate.effect.n_states or not needs_position(candidate.effect.domain):
        return ""
    if reference is None:
        return ""
    without = grown(null, null.flat, null.explicit, reference.fit, null.experiments)
    std = model.measurement_std
    before, after, rested = (
        _missed(_at_rest(one, component), std)
        if reference.adds_up
        else misfit(one, one.experiments, std, component)
        for one, component in ((without, None), (model, None), (model, candidate.name))
    )
    if before is None or after is None or rested is None or after >= before:
        return ""
    if before - rested >= GATES.min_driven_gain * (before - after):
        return ""
    return "it lives on how its own states begin: started at rest it does little of that"


def _missed(model: Null, std: np.ndarray) -> float:
    """Sum of the squared errors one sample ahead, relative to the `std` (n_y,) of the outputs."""
    run = run_null(model)
    errors = np.concatenate([one.whitened for one in run.observed]) @ np.linalg.inv(turned(run.root))
    return float(np.sum((errors / std) ** 2))


def _at_rest(model: Null, component: str | None) -> Null:
    """The model whose experiments begin with the states of a component at zero, if there is one."""
    starts = []
    for start in model.fit.initial_states:
        rests = np.array([name.partition(".")[0] == component for name in start.names])
        starts.append(replace(start, values=np.where(rests, 0.0, start.values)))
    return replace(model, fit=replace(model.fit, initial_states=tuple(starts)))


def _of_levels(
    null: Null,
    prepared: Prepared,
    explicit: ExplicitModel,
    final: FitResult | None,
    validation: Sequence[Experiment],
    reference: Reference | None,
) -> str:
    """Why a law of the time alone is no drift, where it simulates unseen data no better beside a constant
    load of each recording: a recording at another level comes later, too. Empty where it does, or where that
    cannot be told."""
    if final is None or reference is None or reference.adds_up or not validation or not null.loads:
        return ""
    if not brings_time(null.flat, prepared.flat):
        return ""
    ratio = _steady_ratio(null, prepared.flat, explicit, final, validation, reference)
    if ratio is None or ratio < 1.0:
        return ""
    return (
        "it stands for another level of the unseen data: beside a constant load of each recording it "
        f"simulates them {ratio:.3g} times worse"
    )


def _is_any_level(null: Null, prepared: Prepared, reference: Reference | None) -> bool:
    """Whether unseen data at another level would be foreseen better by a law whether it acts or not: by any
    drift towards that level, where errors of the simulation add up and the level cannot be asked of it
    (`_of_levels`)."""
    return reference is not None and reference.adds_up and brings_time(null.flat, prepared.flat)


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
    loads, which refused it. Where an `accepted` law shows by its simulation that something is missing, it is
    enough to say as much: which law it is is no question of chance."""
    explicit = prepared.reduced()
    used = used_by(null, prepared, found, validation, reference)
    n_own = prepared.n_unknowns(null.estimated)
    is_shown = speaks_for(used, n_own) or (
        accepted is not None and rivals_in_use(used, n_own, accepted.in_use, accepted.candidate.n_unknowns)
    )
    # What is left without memory is noise, however much of it the loads have taken.
    is_partial = leaves_an_output(beside.explained, beside.fit, reference.fit, found)
    is_shown = is_shown and (used.leaves_noise or not is_partial)
    # That any lag or delay as short would do is no question of how much better the simulation is.
    refused = not is_shown or beside.is_any_dynamics
    # Better by more than chance is a part of another law, too, if it leaves most of the error.
    refused = refused or (beside.is_other_law and used.ratio >= GATES.max_most_ratio)
    refused = refused or beside.delta_log_likelihood < -GATES.hopeless_log_likelihood
    candidate = prepared.trial.candidate
    refused = refused or bool(weak(prepared, found, reference.fit, used.gain))
    refused = refused or is_absent_at_once(candidate, beside.fit, found)
    # That the simulation is better by more than chance speaks for a kink at a place that is hardly known.
    least = GATES.min_significance
    refused = refused or bool(not_determined(candidate, found, reference.fit, least, used.gain))
    model = grown(null, prepared.flat, explicit, found, null.experiments)
    refused = refused or bool(undriven(model))
    refused = refused or bool(without_form(model, candidate, found))
    refused = refused or bool(beyond_recordings(model, candidate, found))
    p_value = float(min(1.0, n_screened * chi2.sf(2.0 * max(used.gain, 0.0), n_own)))
    if refused or p_value > GATES.max_chance:
        return beside
    if _of_its_start(null, model, candidate, reference):
        return beside
    if _of_levels(null, prepared, explicit, found, validation, reference):
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
        comes_near=False,
        inside=same_in_machine(model, candidate, found),
    )


def _refit(
    null: Null,
    prepared: Prepared,
    explicit: ExplicitModel,
    hopeless: float,
    least: float,
) -> Refit:
    """The refit, which goes on where a search has come to its limit; `least` is the log-likelihood of the
    null."""
    start = replace(null, fit=prepared.similar or prepared.refit or null.fit)
    if prepared.simulation is not None:
        start = replace(null, fit=_calm(null.fit, prepared.simulation))
    begun, start = _begun_on_a_part(prepared, explicit, start)
    explicit = explicit if begun is prepared.flat else replace(explicit, flat=begun)
    found = refitted(begun, explicit, prepared.names, start, hopeless=hopeless, least=least - LOST)
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
    parts = shortened(start.experiments)
    if parts is start.experiments or has_affine_dynamics(explicit):
        return prepared.flat, start
    try:
        fit = refitted(prepared.flat, explicit, prepared.names, replace(start, experiments=parts)).fit
    except DaestError:
        return prepared.flat, start
    return prepared.flat.with_theta(fit.theta), replace(start, fit=fit)


def shortened(experiments: tuple[Experiment, ...]) -> tuple[Experiment, ...]:
    """The first parts of long recordings; short ones as they are."""
    if sum(e.n_samples for e in experiments) < LONG:
        return experiments
    return tuple(part_of(e, 0, -(-e.n_samples // SHORTER)) for e in experiments)


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


def used_by(
    null: Null,
    prepared: Prepared,
    final: FitResult | None,
    validation: Sequence[Experiment],
    reference: Reference,
) -> InUse:
    """What the simulation says of the law at its estimates without loads, where these are fitted to it."""
    if final is None or final.method != "oe":
        return InUse()
    return simulated_at(null, prepared, final, validation, reference)


def simulated_at(
    null: Null, prepared: Prepared, final: FitResult, validation: Sequence[Experiment], reference: Reference
) -> InUse:
    """What the simulation says of the law at any estimates without loads."""
    if reference.simulated is None:
        return InUse()
    flat = prepared.flat.with_theta(final.theta)
    model = grown(null, flat, replace(prepared.reduced(), flat=flat), final, null.experiments)
    before = reference.simulated
    if before.starts is None:
        return in_use(before, simulated_errors(model, validation))
    used = in_use(before, errors_in_pieces(model, validation, before))
    return replace(used, piece=longest_duration(null.experiments))


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
