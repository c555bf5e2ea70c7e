"""The json documents of `daest diagnose` and `daest improve`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, NotRequired, TypedDict

import numpy as np

from daest.diagnosis.written import Written
from daest.model.diagnosis import (
    CandidateVerdict,
    Diagnosis,
    Formula,
    FreeForm,
    Improvement,
    LearnedLoad,
    Proof,
    Screened,
    Step,
    Unproved,
    VerdictName,
)
from daest.report.documents.parts import (
    ByOutput,
    ByPart,
    Errors,
    MadeOf,
    Uncertain,
    errors_entry,
    uncertain_entry,
)

SCREENED = 20  # entries of the screen that are listed
AS_IT_IS = (
    "The model as it is: its parameters refitted together with unknown loads (white noise in the errors told "
    "here), then simulated without them; daest compare takes the values of daest identify, or those of the "
    "model."
)


_Class = TypedDict("_Class", {"class": NotRequired[str]})


class Baseline(Errors):
    remark: NotRequired[Annotated[str, "how the errors were found, where that is not as in a comparison"]]


class AheadEntry(TypedDict):
    seconds: float
    samples: int
    ratio: Annotated[float, "error on unseen data, that far ahead, relative to that without the effect"]
    certainty: Annotated[float, "standard errors by which it is better"]


class CandidateEntry(_Class):
    effect: str
    at: str
    equivalent_places: list[str]
    inputs: NotRequired[dict[str, str]]
    parameters: dict[str, Uncertain]
    model_parameters: NotRequired[dict[str, Uncertain]]
    settings: NotRequired[
        Annotated[dict[str, float], "all parameters of the effect, those that were not estimated too"]
    ]
    fit_percent: ByPart
    rms: ByPart
    delta_log_likelihood: NotRequired[float | None]
    delta_bic: float | None
    p_value: float | None
    explained: NotRequired[float | None]
    ahead: NotRequired[list[AheadEntry]]
    refitted: NotRequired[
        Annotated[
            bool, "false: a leader of the screen without a refit; sizes are the screen's, `reason` says why"
        ]
    ]
    verdict: CandidateVerdict
    reason: NotRequired[str]
    not_separable_from: list[str]
    model: str | None
    model_reason: NotRequired[str]


class ScreenedEntry(TypedDict):
    effect: str
    at: str
    score: float | None
    p_value: float | None
    sizes: dict[str, float | None]
    detectable: float | None
    unit: str
    share: NotRequired[
        Annotated[float | None, "of the squared residual that it would explain (FMUs without equations)"]
    ]


class Skipped(TypedDict):
    candidate: str
    reason: str


class ScreenEntry(TypedDict):
    p_value: float | None
    n_screened: int
    best: list[ScreenedEntry]
    skipped: list[Skipped]


class PlaceEntry(TypedDict):
    group: list[str]
    log_likelihood_gain: float | None
    size: NotRequired[float | None]
    unit: NotRequired[str]


class CoefficientEntry(TypedDict):
    term: Annotated[str, "what it is multiplied by; 1 for a constant"]
    value: float
    std_error: float
    unit: str


class FormulaEntry(TypedDict):
    text: Annotated[str, "the load, over variables of the model"]
    coefficients: list[CoefficientEntry]
    n_numbers: Annotated[int, "coefficients, thresholds and decay lengths"]
    left: Annotated[float, "share of the curve, in its standard errors, that the formula leaves"]


class Learned(TypedDict):
    refitted: Annotated[bool, "false: no refit succeeded, the curve is that of `disturbance`"]
    curve: Annotated[list[list[float | None]], "x, load, standard error; straight lines between"]
    period: NotRequired[Annotated[float | None, "of the curve, in the unit of the variable"]]
    sign_width: NotRequired[Annotated[float | None, "the load is multiplied by tanh(sign_of/sign_width)"]]
    model_parameters: NotRequired[dict[str, Uncertain]]
    formula: NotRequired[Annotated[FormulaEntry | None, "short formula for the curve; null: there is none"]]
    rms_before: Annotated[ByOutput, "errors of the simulation on validation data without the load"]
    rms: Annotated[ByOutput, "errors with the load"]


class Curve(TypedDict):
    place: NotRequired[str | None]
    variable: NotRequired[str | None]
    unit: NotRequired[str]
    variable_unit: NotRequired[str]
    sign_of: NotRequired[str | None]
    label: NotRequired[str]
    p_value: NotRequired[float | None]
    curve: Annotated[list[list[float | None]], "x, disturbance, standard deviation"]


class Disturbance(Curve):
    learned: NotRequired[Learned | None]
    model: NotRequired[Annotated[str | None, "Modelica text of the model with the load"]]
    model_reason: NotRequired[str]


class DiagnoseDocument(MadeOf):
    """Which physical effect a model lacks."""

    verdict: VerdictName
    message: str
    baseline: Baseline
    candidates: list[CandidateEntry]
    screen: NotRequired[ScreenEntry]
    places: list[PlaceEntry]
    disturbance: Disturbance | None
    next_experiment: str
    seconds: float


class StepEntry(TypedDict):
    added: str | None
    at: str | None
    component: NotRequired[str | None]
    equivalent_places: NotRequired[list[str]]
    fit_percent: ByPart
    rms: ByPart
    disturbance: NotRequired[Curve | None]
    verdict: str
    remark: NotRequired[str]
    log_likelihood: NotRequired[float | None]
    parameters: dict[str, Uncertain]
    model: str | None
    delta_bic: NotRequired[float | None]
    p_value: NotRequired[float | None]
    explained: NotRequired[float | None]
    model_reason: NotRequired[str]
    model_rms: NotRequired[ByOutput | None]


class Ledger(MadeOf):
    steps: list[StepEntry]
    final: DiagnoseDocument
    reason: NotRequired[str]


class ImproveDocument(Ledger):
    """Effects added one by one."""

    folder: str
    unknown_effect: NotRequired[
        Annotated[str | None, "file of the model with the load that no effect explains"]
    ]


def document(
    diagnosis: Diagnosis, models: Mapping[str, Written] | None = None, load: Written | None = None
) -> DiagnoseDocument:
    """`models`: the extended models by candidate name; `load`: the model with the learned load."""
    return {
        "verdict": diagnosis.verdict,
        "message": diagnosis.message,
        "baseline": _baseline(diagnosis),
        "candidates": [
            *(_candidate(p, (models or {}).get(p.candidate.name)) for p in diagnosis.proofs),
            *(_without_refit(u) for u in diagnosis.unproved),
        ],
        "screen": {
            "p_value": diagnosis.screen.p_value,
            "n_screened": diagnosis.screen.n_screened,
            "best": [_screened(entry) for entry in diagnosis.screen.entries[:SCREENED]],
            "skipped": [{"candidate": label, "reason": reason} for label, reason in diagnosis.screen.skipped],
        },
        "places": [
            {
                "group": list(g.group),
                "log_likelihood_gain": g.log_likelihood_gain,
                "size": g.size,
                "unit": g.unit,
            }
            for g in diagnosis.places
        ],
        "disturbance": _disturbance(diagnosis, load),
        "next_experiment": diagnosis.next_experiment,
        "seconds": diagnosis.seconds,
    }


def _baseline(diagnosis: Diagnosis) -> Baseline:
    errors = errors_entry(diagnosis.baseline.simulated)
    return {**errors, "remark": AS_IT_IS} if diagnosis.has_loads else {**errors}


def _screened(entry: Screened) -> ScreenedEntry:
    candidate = entry.candidate
    return {
        "effect": candidate.effect.name,
        "at": candidate.site.name,
        "score": entry.score,
        "p_value": entry.p_value,
        "sizes": dict(zip((p.name for p in candidate.effect.sizes), entry.sizes, strict=True)),
        "detectable": entry.detectable,
        "unit": candidate.size_unit,
        "share": entry.share,
    }


def _disturbance(diagnosis: Diagnosis, load: Written | None) -> Disturbance | None:
    curve = _curve(diagnosis.disturbance)
    if curve is None:
        return None
    return {
        **curve,
        "learned": None if diagnosis.learned is None else _learned(diagnosis.learned),
        "model": None if load is None else load.text,
        "model_reason": "" if load is None else load.reason,
    }


def _learned(learned: LearnedLoad) -> Learned:
    """The curve as it stands in the model; a value that the data do not determine has no error."""
    curve, fit = learned.curve, learned.fit
    std = [float(s) if np.isfinite(s) else None for s in curve.std]
    values = [[float(x), float(y), s] for x, y, s in zip(curve.x, curve.y, std, strict=True)]
    physical = {} if fit is None else {n.name: n for n in fit.parameters if ".y[" not in n.name}
    return {
        "refitted": fit is not None,
        "curve": values,
        "period": curve.period or None,
        "sign_width": curve.sign_width or None,
        "model_parameters": {name: uncertain_entry(p) for name, p in physical.items()},
        "formula": None if learned.formula is None else _formula(learned.formula),
        "rms_before": dict(learned.before),
        "rms": dict(learned.after),
    }


def _formula(found: Formula) -> FormulaEntry:
    return {
        "text": found.text,
        "coefficients": [
            {"term": c.term, "value": c.value, "std_error": c.std_error, "unit": c.unit}
            for c in found.coefficients
        ],
        "n_numbers": found.n_numbers,
        "left": found.left,
    }


def _curve(curve: FreeForm | None) -> Curve | None:
    if curve is None:
        return None
    return {
        "place": curve.place,
        "variable": curve.variable,
        "unit": curve.unit,
        "variable_unit": curve.variable_unit,
        "sign_of": curve.sign_of or None,
        "label": curve.label,
        "p_value": curve.p_value,
        "curve": [list(map(float, row)) for row in zip(curve.x, curve.w, curve.std, strict=True)],
    }


def _candidate(proof: Proof, model: Written | None) -> CandidateEntry:
    candidate = proof.candidate
    prefix = f"{candidate.name}."
    return {
        "effect": candidate.effect.name,
        "class": candidate.effect.class_name,
        "at": candidate.site.name,
        "equivalent_places": list(proof.equivalent),
        "inputs": dict(candidate.inputs),
        "parameters": {
            p.name.removeprefix(prefix): uncertain_entry(p)
            for p in proof.told.parameters
            if p.name.startswith(prefix)
        },
        "model_parameters": {
            p.name: uncertain_entry(p) for p in proof.told.parameters if not p.name.startswith(prefix)
        },
        "settings": {
            name.removeprefix(prefix): value
            for name, value in proof.told.theta.items()
            if name.startswith(prefix)
        },
        **errors_entry(proof.told.simulated),
        "delta_log_likelihood": proof.delta_log_likelihood,
        "delta_bic": proof.delta_bic,
        "p_value": proof.p_value,
        "explained": proof.explained,
        "ahead": [
            {"seconds": a.seconds, "samples": a.samples, "ratio": a.ratio, "certainty": a.certainty}
            for a in proof.ahead
        ],
        "refitted": True,
        "verdict": proof.verdict,
        "reason": proof.reason,
        "not_separable_from": list(proof.not_separable_from),
        "model": None if model is None else model.text,
        "model_reason": "" if model is None else model.reason,
    }


def _without_refit(one: Unproved) -> CandidateEntry:
    """A leader of the screen that was not refitted, with the sizes that the screen gives it."""
    candidate = one.candidate
    sizes = zip(candidate.effect.sizes, one.sizes, strict=True)
    return {
        "effect": candidate.effect.name,
        "class": candidate.effect.class_name,
        "at": candidate.site.name,
        "equivalent_places": list(one.equivalent),
        "inputs": dict(candidate.inputs),
        "parameters": {
            p.name: {"value": size, "std_error": None, "unit": candidate.units.get(p.name, p.unit)}
            for p, size in sizes
        },
        "model_parameters": {},
        "fit_percent": {"estimation": {}},
        "rms": {"estimation": {}},
        "delta_log_likelihood": None,
        "delta_bic": None,
        "p_value": one.p_value,
        "explained": None,
        "ahead": [],
        "refitted": False,
        "verdict": "rejected",
        "reason": one.reason,
        "not_separable_from": [],
        "model": None,
        "model_reason": "",
    }


def improvement_document(
    improvement: Improvement,
    files: Mapping[int, str] | None = None,
    models: Mapping[str, Written] | None = None,
    load: Written | None = None,
) -> Ledger:
    """`files`: name of the written model by step; `models` and `load` as in `document`, for the last
    round."""
    return {
        "steps": [_step(step, (files or {}).get(i)) for i, step in enumerate(improvement.steps)],
        "final": document(improvement.last, models, load),
        "reason": improvement.reason,
    }


def _step(step: Step, model: str | None) -> StepEntry:
    proof = step.proof
    row: StepEntry = {
        "added": None if proof is None else proof.candidate.effect.name,
        "at": None if proof is None else proof.candidate.site.name,
        "component": None if proof is None else proof.candidate.name,
        "equivalent_places": [] if proof is None else list(proof.equivalent),
        **errors_entry(step.fit.simulated),
        "disturbance": None if step.diagnosis is None else _curve(step.diagnosis.disturbance),
        "verdict": "baseline" if proof is None else proof.verdict,
        "remark": step.remark,
        "log_likelihood": step.fit.log_likelihood,
        "parameters": {p.name: uncertain_entry(p) for p in step.fit.parameters},
        "model": model,
    }
    if proof is not None:
        row["delta_bic"] = proof.delta_bic
        row["p_value"] = proof.p_value
        row["explained"] = proof.explained
    return row
