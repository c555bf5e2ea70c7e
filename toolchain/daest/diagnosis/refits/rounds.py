"""Further rounds: an accepted effect goes into the model, and what is beside it is proved anew."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from daest.diagnosis.built_in.settled import FAILURES
from daest.diagnosis.built_in.trials import Trial, prepare, with_kinks_bounded
from daest.diagnosis.evidence.proof import bic_gain
from daest.diagnosis.evidence.stand import Stand, quiet, reference_of
from daest.diagnosis.evidence.unseen import compared, innovations, is_worse
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import Null, grown, open_inputs, period_of, refit, refitted
from daest.diagnosis.null_model.null_observer import run_null
from daest.diagnosis.refits.attempts import found_somehow
from daest.diagnosis.refits.search import Search
from daest.diagnosis.screening.candidates import fed, with_law
from daest.diagnosis.screening.disturbance import place_gains, smoothed_load
from daest.diagnosis.screening.free_forms import forms_of
from daest.estimation.linear.hold_search import with_turned
from daest.model.diagnosis import Candidate, Proof
from daest.model.fit import error_ratios
from daest.numerics.parallel import called, workers


def accept(stand: Stand, proof: Proof, jobs: int = 1) -> Stand:
    """The stand with the effect of `proof` in the model, and the inputs held as the model with the effect has
    it. With two `jobs`, its two fits run together."""
    null = stand.null
    model = _held_better(with_law(null, proof), proof)
    validation = fed(stand.validation, proof.candidate)
    # The refit of the proof has not predicted the unseen data, by which a later round sees that it is at the
    # noise of the sensors.
    fits: list[Callable[[], Any]] = [
        partial(refit, model.flat, model.explicit, model.estimated, model, validation=validation),
        partial(reference_of, model, proof.fit, validation),
    ]
    with workers(jobs) as pool:
        baseline, reference = (o.get() for o in pool.map(called, fits, seconds=stand.baseline.seconds))
    if reference is not None and proof.final is not None:
        # What was told of the effect stays true of the model that holds it.
        ratios = error_ratios(reference.fit.simulated, proof.final.simulated)
        if ratios and np.mean(np.square(ratios)) < 1.0:
            reference = replace(reference, fit=proof.final)
    began = time.perf_counter()
    return Stand(stand.declared, model, baseline, validation, began, reference, tied=stand.tied)


def _held_better(null: Null, proof: Proof) -> Null:
    """The null with one input after the other held as the model with the effect of `proof` has it."""
    names = open_inputs(null, proof.delta_log_likelihood)
    for name in names:
        hold = with_turned(null.hold, name, names)
        least = null.fit.log_likelihood + GATES.min_hold_gain
        turned = replace(null, hold=hold, recorded_hold=hold)
        with quiet(), suppress(*FAILURES):
            # Where the parameters have bent to the other hold, the first pass does not come all the way.
            hopeless = least - GATES.hopeless_log_likelihood
            fit = refitted(null.flat, null.explicit, null.estimated, turned, hopeless=hopeless).fit
            if fit.log_likelihood > least:
                null = grown(turned, null.flat, null.explicit, fit, null.experiments)
    return null


def with_kinks(stand: Stand, candidates: Sequence[Candidate]) -> Stand | None:
    """The stand with the kinks of effects in its model as round as the recordings have them, where that is
    worth their parameters and foresees unseen data no worse; None where it is not, or they are so already.
    Beside an effect that was found later, an earlier one shows its kink at last, and what is left at it would
    look like a further law."""
    null = stand.null
    names = [f"{c.name}.{p.name}" for c in candidates for p in c.effect.parameters if p.role == "sharpness"]
    known = set(null.flat.parameter_names)
    kinks = [name for name in names if name in known and name not in null.estimated]
    if not kinks:
        return None
    with quiet():
        flat = with_kinks_bounded(null.flat, candidates)
        explicit = replace(null.explicit, flat=flat)
        fit = refit(flat, explicit, (*null.estimated, *kinks), null, validation=stand.validation)
        gain = fit.log_likelihood - stand.baseline.log_likelihood
        if bic_gain(gain, len(kinks), null) < GATES.min_bic_gain:
            return None
        model = grown(null, flat, explicit, fit, null.experiments)
        reference = reference_of(model, fit, stand.validation)
    if reference is not None and stand.reference is not None:
        ahead = compared(stand.reference.foreseen, reference.foreseen, period_of(null.experiments))
        if any(is_worse(one) for one in ahead):
            return None
    return replace(stand, null=model, baseline=fit, reference=reference, began=time.perf_counter())


def proved_again(stand: Stand, proof: Proof, values: Mapping[str, float]) -> Proof:
    """The proof of the same effect beside another model, that of `stand`, started from the parameter `values`
    of a fit. Raises what refits raise."""
    candidate = proof.candidate
    # A kink that was rounded beside what stands no longer there is as sharp again as it was found.
    own = {
        p.name: values.get(f"{candidate.name}.{p.name}") if p.estimate or p.role != "sharpness" else None
        for p in candidate.effect.parameters
    }
    shape = {name: v for name in candidate.shape if (v := own[name]) is not None}
    shaped = replace(candidate, shape={**candidate.shape, **shape})
    trial = Trial(shaped, tuple(own[p.name] or p.start for p in candidate.effect.sizes), ())
    found = proved_beside(stand, trial, values)
    return replace(found, equivalent=proof.equivalent, not_separable_from=proof.not_separable_from)


def gains_beside(
    stand: Stand, first: Proof, trial: Trial, values: Mapping[str, float], sharper: float = 1.0
) -> bool:
    """Whether a further effect, the `trial`, makes the model with that of `first` as much likelier as
    evidence must: a refit from the parameter `values` without the judgement of `proved_beside`. Raises what
    refits raise."""
    null = stand.null
    with quiet():
        model = with_law(null, first)
        begun = model.flat.with_theta({n: values[n] for n in model.estimated if n in values})
        prepared = prepare(begun, model.estimated, trial, sharper=sharper)
        model = replace(model, experiments=fed(model.experiments, trial.candidate))
        fit = refitted(prepared.flat, prepared.reduced(), prepared.names, model).fit
    gain = fit.log_likelihood - first.fit.log_likelihood
    return bic_gain(gain, prepared.n_unknowns(model.estimated), model) >= GATES.min_bic_gain


def proved_beside(stand: Stand, trial: Trial, values: Mapping[str, float], sharper: float = 1.0) -> Proof:
    """The proof of one candidate in the model of `stand`, whose parameters start from `values` where these
    have them; its kinks are `sharper` than those of the trial. Raises what refits raise."""
    null = stand.null
    with quiet():
        run = run_null(null)
        load = smoothed_load(null, run, place_gains(null, run))
        form = next(iter(forms_of(null, run)), None)
        if stand.reference is not None and stand.validation:
            known = replace(stand.reference, innovations=innovations(run, stand.validation))
            stand = replace(stand, reference=known)
        flat = null.flat.with_theta({n: values[n] for n in null.estimated if n in values})
        prepared = prepare(flat, null.estimated, trial, sharper=sharper)
        return found_somehow(Search(stand, run, load, form, 1), prepared)
