"""The verdict where unknown loads act and no law is accepted: what the loads follow, and what comes near."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from daest.diagnosis.answers.decided import (
    AGAIN,
    LONGER,
    SEVERAL,
    WIDER_BAND,
    Decided,
    Evidence,
    error_ratio,
    foreseen_by,
    listed,
    reasons_told,
    told_fits,
)
from daest.diagnosis.answers.told_laws import errors_told, importance_told
from daest.diagnosis.evidence.driven_errors import are_driven
from daest.diagnosis.evidence.load_starts import LoadStart, takes_over
from daest.diagnosis.evidence.noise_level import simulates_to_noise
from daest.diagnosis.evidence.open_loop import simulated_errors
from daest.diagnosis.evidence.reasons import told_values
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import Null, at_fit, slowest_at
from daest.diagnosis.null_model.null_observer import NullObserver
from daest.estimation.fitting.signals import still_share
from daest.estimation.gates import FIT
from daest.model.diagnosis import (
    FreeForm,
    PlaceGain,
    Proof,
)
from daest.model.fit import FitResult, error_ratios
from daest.model.flat import FlatModel
from daest.numerics.statistics import whiteness_p_value
from daest.quantities import spoken_duration


@dataclass(frozen=True)
class Loads:
    """The rest where unknown loads stand beside the model as it is. `form` is what the load follows best,
    `against_form` why unseen data speak against a curve over its variable, `not_asked` why they
    were not asked, `starts` those that begin with the recording from nowhere. `without` is the fit without
    them."""

    flat: FlatModel
    null: Null
    run: NullObserver
    gains: tuple[PlaceGain, ...]
    form: FreeForm | None
    against_form: str = ""
    not_asked: str = ""
    starts: tuple[LoadStart, ...] = ()
    without: FitResult | None = None

    @cached_property
    def are_driven(self) -> bool | None:
        """Whether the errors of the simulation `without` loads follow what drives the model; None where that
        is not known."""
        if self.without is None:
            return None
        errors = simulated_errors(at_fit(self.null, self.without), ())
        return None if errors is None else are_driven(self.null.experiments, errors.fitted)

    @property
    def is_related(self) -> bool:
        return self.form is not None and self.form.p_value < GATES.missing_level

    def is_explained(self, evidence: Evidence) -> bool:
        return not self.starts and self.is_silent(evidence)

    def is_silent(self, evidence: Evidence) -> bool:
        """Whether nothing is left to explain but how the recording begins."""
        return simulates_to_noise(self.null, evidence.baseline, evidence.told) or (
            not self._is_unobserved
            and evidence.screen.p_value > GATES.missing_level
            and not self.is_related
            and not _has_unexpected_load(self)
        )

    @property
    def _is_unobserved(self) -> bool:
        """Whether loads act that no observer follows, and what they do is left in what the screen saw."""
        is_followed = bool(np.any(self.run.gain)) or not np.any(self.null.intensity)
        return not is_followed and _is_coloured(self)

    def verdict(self, evidence: Evidence) -> Decided:
        if self.starts and self.is_silent(evidence):
            return _of_starts(evidence, self.starts)
        return _of_loads(evidence, self)


def _of_loads(evidence: Evidence, loads: Loads) -> Decided:
    short = [p for p in evidence.proofs if p.is_any_dynamics]
    form = loads.form
    may_be_curve = loads.is_related and not loads.against_form
    nearest = _nearest_dynamics(evidence, short, form if may_be_curve else None)
    if nearest is not None:
        return _comes_near(evidence, nearest)
    if short:
        return _any_dynamics(evidence, short)
    if form is not None and loads.is_related:
        return _no_law(evidence, loads, form) if loads.against_form else _unknown(evidence, loads, form)
    if _is_coloured(loads):
        return _undriven(evidence, loads) if _is_undriven(evidence, loads) else _dynamic(evidence, loads)
    near = [p for p in evidence.proofs if p.delta_bic > GATES.min_told_bic_gain]
    if evidence.screen.p_value < GATES.missing_level and near:
        return _not_proven(evidence, near)
    slow = slowest_at(loads.null, _largest_load(loads).group)
    if slow is not None:
        return _too_slow_to_tell(evidence, loads, slow)
    return Decided(
        "external disturbance",
        f"An unexplained load acts at {_load_places(loads)}, but it is related to no variable of the "
        "model and no effect of the library explains it." + foreseen_by(evidence, None),
        AGAIN,
    )


def _too_slow_to_tell(evidence: Evidence, loads: Loads, time_constant: float) -> Decided:
    """An external disturbance that may as well be none: with a load that comes and goes hardly once, its
    relation to any variable is told by hardly one sample."""
    slow = spoken_duration(time_constant, evidence.clock)
    return Decided(
        "external disturbance",
        f"An unexplained load acts at {_load_places(loads)}, and no effect of the library explains it. It "
        f"changes so slowly (over {slow} and more) that these recordings hardly tell whether it follows a "
        "variable of the model." + foreseen_by(evidence, None),
        f"Record for several times as long, and change what the machine does every {slow} or so: a law "
        "comes back with its variable, a load from outside does not.",
    )


def _of_starts(evidence: Evidence, starts: Sequence[LoadStart]) -> Decided:
    """Loads that begin with the recording, and effects that would do the same: nothing else is missing."""
    begun = listed(
        tuple(
            f"a load at {start.load.place} that begins with the recording ({start.value:.3g} "
            f"{start.load.unit}, gone by a factor e after "
            f"{spoken_duration(start.load.time_constant, evidence.clock)})"
            for start in starts
        )
    )
    instead = [p for p in evidence.proofs if any(takes_over(start, p) for start in starts)]
    again = "Record again with several steps, up and down, from a machine that has been at rest for long."
    if not instead:
        return Decided(
            "external disturbance",
            f"The data ask for {begun}: the machine was left with something that the model does not have.",
            again,
            is_of_starts=True,
        )
    labels = tuple(p.candidate.label for p in instead)
    would = "; ".join(f"{p.candidate.label}: {told_values(p)}" for p in instead)
    alike = "a load that begins with the recording does the same"
    others = {p.candidate.label: tuple(n for n in labels if n != p.candidate.label) for p in instead}
    proofs = tuple(
        replace(p, verdict="not separable", reason=alike, not_separable_from=others[p.candidate.label])
        if p.candidate.label in others
        else p
        for p in evidence.proofs
    )
    return Decided(
        "cannot tell",
        f"Either {listed(labels)} is missing, or {begun} acts: these data do not separate them ({would}).",
        again,
        proofs,
    )


def _nearest_dynamics(evidence: Evidence, short: Sequence[Proof], form: FreeForm | None) -> Proof | None:
    """The likeliest lag or delay that leaves something dynamic, where that does away with most of the load
    and is clearly likelier than those that are too `short` to be told apart and than a curve of the `form`
    that the load follows, if unseen data do not speak against that; None where there is none."""
    others = [0.0, *(p.delta_bic for p in short)]
    if form is not None:
        others.append(2.0 * form.log_likelihood_gain)
    near = [p for p in evidence.proofs if p.comes_near and p.explained >= GATES.min_explained]
    best = max(near, key=lambda p: p.delta_bic, default=None)
    return best if best is not None and best.delta_bic > max(others) + GATES.min_bic_gain else None


def _comes_near(evidence: Evidence, near: Proof) -> Decided:
    """A lag or a delay that does most of what is missing, and not all."""
    return Decided(
        "unknown effect",
        f"Something dynamic is missing: {near.candidate.label} comes nearest ({told_values(near)}), but what "
        f"it leaves still follows {'something' if near.left is None else near.left.label}."
        + errors_told(evidence, near)
        + importance_told(evidence, near),
        WIDER_BAND,
        is_dynamic=True,
    )


def _dynamic(evidence: Evidence, loads: Loads) -> Decided:
    """Errors that stay correlated in time, as slow noise of a sensor makes them, too. The nearest law is one
    that a simulation of unseen data does not speak against: beside loads, anything that lasts gains
    likelihood."""
    near = _nearest(evidence, 1.0 + GATES.max_simulated_loss)
    text = (
        "Something dynamic is missing, or the noise of a sensor is slow: the prediction errors stay "
        f"correlated in time although loads were admitted at {_load_places(loads)}, and no effect of the "
        "library explains them."
    )
    if near is not None:
        text += f" {near.candidate.label} comes nearest ({told_values(near)}), but {near.reason}."
        text += errors_told(evidence, near)
    return Decided("unknown effect", text + foreseen_by(evidence, near), WIDER_BAND, is_by_colour=True)


def _is_undriven(evidence: Evidence, loads: Loads) -> bool:
    """Whether errors that last are none of dynamics that the model lacks: nothing that moves it tells them,
    and no effect of the library does, or makes a simulation of unseen data clearly better."""
    if evidence.screen.p_value < GATES.missing_level:
        return False
    if any(error_ratio(evidence, p) < GATES.max_clear_ratio for p in evidence.proofs):
        return False
    return loads.are_driven is False


def _undriven(evidence: Evidence, loads: Loads) -> Decided:
    """Errors that stay correlated in time, whatever the machine does."""
    return Decided(
        "external disturbance",
        "The prediction errors stay correlated in time although loads were admitted at "
        f"{_load_places(loads)}, but what the simulation leaves follows neither the inputs nor the outputs: "
        "it is the slow noise of a sensor, or a load from outside, and no dynamics that the model lacks."
        + foreseen_by(evidence, None),
        AGAIN,
        is_by_colour=True,
    )


def _any_dynamics(evidence: Evidence, short: Sequence[Proof]) -> Decided:
    """Lags, delays and other stores that do away with what is missing, and are too short to be told from one
    another. Those that the data speak clearly against are told apart."""
    best = short[0]
    near = [p for p in short if best.delta_bic - p.delta_bic <= GATES.min_bic_gain]
    labels = listed(tuple(p.candidate.label for p in near))
    would = f"{labels if len(near) == 1 else f'any of {labels}'} would do ({told_values(best)})"
    behind = [f"{p.candidate.label} (BIC {best.delta_bic - p.delta_bic:.0f})" for p in short if p not in near]
    return Decided(
        "unknown effect",
        f"Something dynamic is missing, and it is fast: {would}, but {best.reason}."
        + (f" Clearly less likely: {', '.join(behind)}." if behind else "")
        + errors_told(evidence, best)
        + importance_told(evidence, best),
        WIDER_BAND,
        is_dynamic=True,
    )


def _no_law(evidence: Evidence, loads: Loads, form: FreeForm) -> Decided:
    """A load that seems to follow a variable, though no curve over it foresees anything."""
    near = _nearest(evidence)
    text = (
        f"An unexplained load acts at {_load_places(loads)}. It seems to follow {form.label} (p = "
        f"{form.p_value:.1g}), but with a curve over that in the model {loads.against_form}: it is noise "
        "or a load from outside, or a law that this recording does not show well enough."
    )
    return Decided(
        "external disturbance",
        text + _told_nearest(near) + foreseen_by(evidence, near),
        AGAIN,
    )


def _not_proven(evidence: Evidence, near: list[Proof]) -> Decided:
    return Decided(
        "cannot tell",
        f"Something is missing (p = {evidence.screen.p_value:.1g} for the whole search), but these data do "
        f"not prove what. {reasons_told(near)}.",
        SEVERAL if any(_foresees_an_output(evidence, p) for p in near) else LONGER,
    )


def _foresees_an_output(evidence: Evidence, proof: Proof) -> bool:
    """Whether a simulation of unseen data with the law is far better in one output, so that what is missing
    is not small beside noise: of two effects each makes one better, and is refused for what the other
    leaves."""
    before, after = told_fits(evidence, proof)
    return min(error_ratios(before.simulated, after.simulated), default=np.inf) < GATES.max_told_ratio


def _has_unexpected_load(loads: Loads) -> bool:
    """Whether the data ask for a load that the model's declared noise does not account for."""
    declared = max((n.intensity or 0.0 for n in loads.flat.noises), default=0.0)
    for gain, load in zip(loads.gains, loads.null.loads, strict=True):
        # The correlation function size² exp(-|τ|/T) has the spectral density 2 size² T at low frequency.
        if (
            gain.log_likelihood_gain > GATES.min_load_gain
            and 2.0 * load.size**2 * load.time_constant > GATES.expected_noise * declared
        ):
            return True
    return False


def _unknown(evidence: Evidence, loads: Loads, form: FreeForm) -> Decided:
    nearest = _nearest(evidence)
    place = _group(loads.gains[form.load])
    if loads.not_asked:
        text = (
            f"An unexplained load acts at {place}. It seems to follow {form.label} (p = {form.p_value:.1g}), "
            "and the curve is given, but unseen data were not asked whether that is a law or noise: "
            f"{loads.not_asked}."
        )
    else:
        text = (
            f"An effect that the library does not hold acts at {place}: the unexplained load follows "
            f"{form.label} (p = {form.p_value:.1g}); the curve is given."
        )
    text += _told_nearest(nearest) + foreseen_by(evidence, nearest)
    record = f"Record {form.variable} over a wider range, slowly and in both directions, to tell its form."
    return Decided("unknown effect", text, record)


def _nearest(evidence: Evidence, most: float = np.inf) -> Proof | None:
    """The likeliest law that may be told as the nearest to what acts, of those with at `most` that part of
    the error of simulated unseen data; None where there is none."""
    return next((p for p in evidence.proofs if _may_be_near(p) and not error_ratio(evidence, p) > most), None)


def _told_nearest(proof: Proof | None) -> str:
    """A sentence on the nearest law; empty where there is none."""
    return f" The nearest of the library is {proof.candidate.label}, but {proof.reason}." if proof else ""


def _may_be_near(proof: Proof) -> bool:
    """Whether a law may be told as the nearest to what acts: it gains likelihood, the data show it, it does
    away with a part of the load, and unseen data do not speak plainly against it."""
    worst = max((a.ratio for a in proof.ahead), default=0.0)
    is_seen = proof.is_known and proof.explained > GATES.min_told_explained
    return is_seen and proof.delta_bic > GATES.min_told_bic_gain and worst < GATES.max_nearest_ratio


def _is_coloured(loads: Loads) -> bool:
    """Whether the null leaves innovations that are certainly not white, and not by the steps of a sensor: one
    that stands still from sample to sample rounds what is between, and its errors last."""
    p_values = [
        whiteness_p_value(o.whitened[:, j], np.isfinite(o.whitened[:, j]))
        for experiment, o in zip(loads.null.experiments, loads.run.observed, strict=True)
        for j in range(o.whitened.shape[1])
        if still_share(experiment.outputs[:, j]) < FIT.max_still
    ]
    return bool(p_values) and min(p_values) * len(p_values) < GATES.white_level


def _load_places(loads: Loads) -> str:
    return _group(_largest_load(loads))


def _largest_load(loads: Loads) -> PlaceGain:
    """The place whose load the data ask for most."""
    return max(loads.gains, key=lambda g: g.log_likelihood_gain)


def _group(gain: PlaceGain) -> str:
    others = (
        f" (or {listed(gain.group[1:])}, which the sensors cannot tell apart)" if len(gain.group) > 1 else ""
    )
    return f"{gain.group[0]}{others}"
