"""The verdict: one of a closed list, with the sentence that says why."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from daest.diagnosis.null import Null
from daest.diagnosis.proof import is_significant
from daest.diagnosis.screen import NullObserver
from daest.model.diagnosis import FreeForm, PlaceGain, Proof, Screen, VerdictName
from daest.model.fit import FitResult, FittedParameter, error_ratios
from daest.model.flat import FlatModel
from daest.numerics.statistics import whiteness_p_value

TO_NOISE = 1.03  # simulation error relative to the one-step error that is as good as it gets
CERTAIN = 1e-3  # corrected p-value of the screen below which something is missing, named or not
LOAD_GAIN = 10.0  # log-likelihood that a load must buy to be a finding
EXPECTED_NOISE = 10.0  # times the declared intensity: noise up to that is what the model expects
WHITE_LEVEL = 1e-4  # p-value below which the innovations of the null are certainly not white
NEAR = 10.0  # BIC gain above which a rejected candidate is worth a word
SOME = 0.2  # share of the load below which no law is near to the one that is missing
FORESEEN = 0.6  # of the error on unseen data, below which a rejected candidate is worth a word, too
ALIKE = 1.1  # ratio of errors on unseen data that tells no candidates apart
CHANGED = 3.0  # standard errors that a refitted parameter must move to be off


@dataclass(frozen=True)
class Evidence:
    """All that the verdict rests on."""

    flat: FlatModel
    null: Null
    run: NullObserver
    baseline: FitResult
    screen: Screen
    proofs: tuple[Proof, ...]
    gains: tuple[PlaceGain, ...]
    form: FreeForm | None  # the one that the load of the null follows best
    fitted: Mapping[str, float]


@dataclass(frozen=True)
class Decided:
    name: VerdictName
    message: str
    next_experiment: str = ""


def decide(evidence: Evidence) -> Decided:
    """The verdict. A claim needs a candidate that passed every gate of the proof."""
    accepted = [p for p in evidence.proofs if p.verdict != "rejected"]
    if len(accepted) == 1:
        return Decided("supported", _supported(evidence, accepted[0]))
    if accepted:
        return _cannot_tell(accepted)
    if _simulates_to_noise(evidence):
        return _nothing(evidence)
    form = evidence.form
    is_related = form is not None and form.p_value < CERTAIN
    if evidence.screen.p_value > CERTAIN and not is_related and not _has_unexpected_load(evidence):
        return _nothing(evidence)
    if form is not None and is_related:
        return _unknown(evidence, form)
    if _is_coloured(evidence):
        return Decided(
            "unknown effect",
            "Something dynamic is missing: the prediction errors stay correlated in time although loads "
            f"were admitted at {_load_places(evidence)}, and no effect of the library explains them.",
            "Excite the machine over a wider band of frequencies, and measure a motion or a current between.",
        )
    near = [p for p in evidence.proofs if p.delta_bic > NEAR]
    if evidence.screen.p_value < CERTAIN and near:
        return _not_proven(evidence, near)
    return Decided(
        "external disturbance",
        f"An unexplained load acts at {_load_places(evidence)}, but it is related to no variable of the "
        "model and no effect of the library explains it.",
        "Repeat the same experiment: what comes back in the same way belongs to the machine.",
    )


def _supported(evidence: Evidence, proof: Proof) -> str:
    values = ", ".join(
        f"{p.name.partition('.')[2]} = {p.value:.4g} ± {p.std_error:.2g} {_unit(p)}".rstrip()
        if p.std_error is not None
        else f"{p.name.partition('.')[2]} = {p.value:.4g} {_unit(p)}".rstrip()
        for p in proof.fit.parameters
        if p.name.startswith(f"{proof.candidate.name}.")
    )
    text = f"{proof.candidate.label}: {values}; supported."
    if proof.equivalent:
        text += f" The sensors cannot tell it from the same effect at {_listed(proof.equivalent)}."
    if proof.left is not None and is_significant(proof.left, proof.delta_log_likelihood):
        text += f" Something else is missing besides: what is left follows {proof.left.label}."
    ratio = _error_ratio(evidence, proof)
    return text + _errors(evidence, proof) + _foreseen(evidence, proof, FORESEEN * min(ratio, 1.0))


def _unit(parameter: FittedParameter) -> str:
    return "" if parameter.unit == "1" else parameter.unit


def _errors(evidence: Evidence, proof: Proof) -> str:
    """Validation errors before and after, per output."""
    before, after = evidence.baseline.simulated.get("validation"), proof.fit.simulated.get("validation")
    if before is None or after is None:
        return ""
    parts = [
        f"{name} {b:.3g} -> {after.rms[name]:.3g}"
        for name, b in before.rms.items()
        if b is not None and after.rms.get(name) is not None
    ]
    return f" Validation error (rms): {', '.join(parts)}." if parts else ""


def _cannot_tell(accepted: list[Proof]) -> Decided:
    names = [p.candidate.label for p in accepted]
    differ = {p.candidate.site.name for p in accepted}
    separate = (
        "Run the machine slowly and at several constant speeds, and with amplitudes from small to large: "
        "friction, elasticity and play differ there most."
        if len(differ) == 1
        else f"Measure a motion, torque or current between {_listed(tuple(differ))}."
    )
    return Decided(
        "cannot tell",
        f"One of {_listed(tuple(names))} is missing; these data do not separate them.",
        separate,
    )


def _not_proven(evidence: Evidence, near: list[Proof]) -> Decided:
    reasons = "; ".join(f"{p.candidate.label}: {p.reason}" for p in near[:2])
    return Decided(
        "cannot tell",
        f"Something is missing (p = {evidence.screen.p_value:.1g} for the whole search), but these data do "
        f"not prove what. {reasons}.",
        "Record longer and with larger amplitudes: the effect is small beside the noise and the loads of "
        "this record.",
    )


def _simulates_to_noise(evidence: Evidence) -> bool:
    """Whether the simulation is as good as the one-step prediction on data it has not seen: then nothing acts
    on the machine that the model does not know, whatever small loads the likelihood likes to have."""
    simulated, one_step = (
        part.get("validation") for part in (evidence.baseline.simulated, evidence.baseline.one_step)
    )
    if simulated is None or one_step is None:
        return False
    pairs = [(rms, one_step.rms.get(name)) for name, rms in simulated.rms.items()]
    return all(rms is not None and other is not None and rms <= TO_NOISE * other for rms, other in pairs)


def _has_unexpected_load(evidence: Evidence) -> bool:
    """Whether the data ask for a load that the model's declared noise does not account for."""
    declared = max((n.intensity or 0.0 for n in evidence.flat.noises), default=0.0)
    for gain, load in zip(evidence.gains, evidence.null.loads, strict=True):
        # The correlation function size² exp(-|τ|/T) has the spectral density 2 size² T at low frequency.
        if (
            gain.log_likelihood_gain > LOAD_GAIN
            and 2.0 * load.size**2 * load.time_constant > EXPECTED_NOISE * declared
        ):
            return True
    return False


def _nothing(evidence: Evidence) -> Decided:
    moved = _moved(evidence)
    if moved:
        return Decided(
            "parameters off",
            f"No effect is missing, but the data contradict the given values: {', '.join(moved)}. "
            "Refit the model.",
        )
    seen = [e for e in evidence.screen.entries if not e.absorbed and np.isfinite(e.detectable)]
    smallest: dict[str, str] = {}
    for entry in seen:
        size = entry.candidate.effect.sizes[0]
        label = f"{entry.candidate.effect.name} at {entry.candidate.site.name}"
        unit = "" if entry.candidate.size_unit == "1" else entry.candidate.size_unit
        smallest.setdefault(label, f"{label} from {size.name} = {entry.detectable:.2g} {unit}".rstrip())
    shown = "; ".join(list(smallest.values())[:4])
    return Decided(
        "nothing missing",
        f"Nothing is missing at this noise level: none of {evidence.screen.n_screened} candidates was "
        f"supported (p = {evidence.screen.p_value:.2g} for the whole search). It would have shown, for "
        f"instance: {shown}.",
    )


def _moved(evidence: Evidence) -> list[str]:
    """Parameters of an earlier fit that these data contradict."""
    result = []
    for p in evidence.baseline.parameters:
        given = evidence.fitted.get(p.name)
        if given is None or not p.std_error:
            continue
        if abs(p.value - given) > CHANGED * p.std_error:
            result.append(
                f"{p.name} = {given:.4g} given, {p.value:.4g} ± {p.std_error:.2g} {p.unit} found".rstrip()
            )
    return result


def _unknown(evidence: Evidence, form: FreeForm) -> Decided:
    nearest = next((p for p in evidence.proofs if p.delta_bic > NEAR and p.explained > SOME), None)
    text = (
        f"An effect that the library does not hold acts at {_group(evidence.gains[form.load])}: the "
        f"unexplained load follows {form.label} (p = {form.p_value:.1g}); the curve is given."
    )
    if nearest is not None:
        text += f" The nearest of the library is {nearest.candidate.label}, but {nearest.reason}."
    text += _foreseen(evidence, nearest)
    record = f"Record {form.variable} over a wider range, slowly and in both directions, to tell its form."
    return Decided("unknown effect", text, record)


def _foreseen(evidence: Evidence, named: Proof | None, limit: float = FORESEEN) -> str:
    """The rejected candidates other than `named` whose error on unseen data is below `limit` times that of
    the model as it is, those about as good as the best of them, as a sentence; empty where there is none. An
    unknown load that is free enough takes the likelihood from a law that is right; a simulation has no such
    load."""
    others = [p for p in evidence.proofs if p is not named and p.verdict == "rejected"]
    ratios = [_error_ratio(evidence, proof) for proof in others]
    best = min(ratios, default=np.inf)
    if not best < limit:
        return ""
    found = [proof for proof, ratio in zip(others, ratios, strict=True) if ratio <= ALIKE * best]
    names, verb = (
        _listed(tuple(p.candidate.label for p in found)),
        "foresees" if len(found) == 1 else "foresee",
    )
    return (
        f" {names} {verb} the validation data far better (error times {best:.2g}) and may be what acts "
        f"there, although {found[0].reason}."
    )


def _error_ratio(evidence: Evidence, proof: Proof) -> float:
    """Error of the candidate on unseen data relative to that of the model as it is, of the output where it is
    largest; inf where it is unknown."""
    return max(error_ratios(evidence.baseline.simulated, proof.fit.simulated), default=np.inf)


def _is_coloured(evidence: Evidence) -> bool:
    """Whether the null leaves innovations that are certainly not white."""
    p_values = [
        whiteness_p_value(o.whitened[:, j], np.isfinite(o.whitened[:, j]))
        for o in evidence.run.observed
        for j in range(o.whitened.shape[1])
    ]
    return min(p_values) * len(p_values) < WHITE_LEVEL


def _load_places(evidence: Evidence) -> str:
    found = [g for g in evidence.gains if g.log_likelihood_gain > LOAD_GAIN] or list(evidence.gains)
    return _group(max(found, key=lambda g: g.log_likelihood_gain))


def _group(gain: PlaceGain) -> str:
    others = (
        f" (or {_listed(gain.group[1:])}, which the sensors cannot tell apart)" if len(gain.group) > 1 else ""
    )
    return f"{gain.group[0]}{others}"


def _listed(names: tuple[str, ...], most: int = 4) -> str:
    shown = list(names[:most])
    rest = len(names) - len(shown)
    if rest:
        shown.append(f"{rest} more")
    return shown[0] if len(shown) == 1 else ", ".join(shown[:-1]) + " and " + shown[-1]
