"""The json documents of `daest diagnose` and `daest improve`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from daest.diagnosis.written import Written
from daest.model.diagnosis import Diagnosis, FreeForm, Improvement, LearnedLoad, Proof, Step
from daest.model.fit import Agreement, FitResult

SCREENED = 20  # entries of the screen that are listed
AS_IT_IS = (
    "The model as it is: its parameters refitted together with unknown loads, then simulated without them; "
    "daest compare takes the values of daest identify, or those of the model."
)


def document(
    diagnosis: Diagnosis, models: Mapping[str, Written] | None = None, load: Written | None = None
) -> dict[str, Any]:
    """`models`: the extended models by candidate name; `load`: the model with the learned load."""
    return {
        "verdict": diagnosis.verdict,
        "message": diagnosis.message,
        "baseline": {**_errors(diagnosis.baseline), "remark": AS_IT_IS},
        "candidates": [_candidate(p, (models or {}).get(p.candidate.name)) for p in diagnosis.proofs],
        "screen": {
            "p_value": diagnosis.screen.p_value,
            "n_screened": diagnosis.screen.n_screened,
            "best": [
                {
                    "effect": e.candidate.effect.name,
                    "at": e.candidate.site.name,
                    "score": e.score,
                    "p_value": e.p_value,
                    "sizes": dict(zip((p.name for p in e.candidate.effect.sizes), e.sizes, strict=True)),
                    "detectable": e.detectable,
                    "unit": e.candidate.size_unit,
                }
                for e in diagnosis.screen.entries[:SCREENED]
            ],
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


def _disturbance(diagnosis: Diagnosis, load: Written | None) -> dict[str, Any] | None:
    curve = _curve(diagnosis.disturbance)
    if curve is None:
        return None
    return curve | {
        "learned": None if diagnosis.learned is None else _learned(diagnosis.learned),
        "model": None if load is None else load.text,
        "model_reason": "" if load is None else load.reason,
    }


def _learned(learned: LearnedLoad) -> dict[str, Any]:
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
        "model_parameters": {
            name: {"value": p.value, "std_error": p.std_error, "unit": p.unit} for name, p in physical.items()
        },
        "rms_before": dict(learned.before),
        "rms": dict(learned.after),
    }


def _curve(curve: FreeForm | None) -> dict[str, Any] | None:
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


def _candidate(proof: Proof, model: Written | None) -> dict[str, Any]:
    candidate = proof.candidate
    prefix = f"{candidate.name}."
    return {
        "effect": candidate.effect.name,
        "class": candidate.effect.class_name,
        "at": candidate.site.name,
        "equivalent_places": list(proof.equivalent),
        "inputs": dict(candidate.inputs),
        "parameters": {
            p.name.removeprefix(prefix): {"value": p.value, "std_error": p.std_error, "unit": p.unit}
            for p in proof.fit.parameters
            if p.name.startswith(prefix)
        },
        "model_parameters": {
            p.name: {"value": p.value, "std_error": p.std_error, "unit": p.unit}
            for p in proof.fit.parameters
            if not p.name.startswith(prefix)
        },
        **_errors(proof.fit),
        "delta_log_likelihood": proof.delta_log_likelihood,
        "delta_bic": proof.delta_bic,
        "p_value": proof.p_value,
        "explained": proof.explained,
        "verdict": proof.verdict,
        "reason": proof.reason,
        "not_separable_from": list(proof.not_separable_from),
        "model": None if model is None else model.text,
        "model_reason": "" if model is None else model.reason,
    }


def _errors(fit: FitResult) -> dict[str, Any]:
    return {
        "fit_percent": {part: _agreement(a, "fit_percent") for part, a in fit.simulated.items()},
        "rms": {part: _agreement(a, "rms") for part, a in fit.simulated.items()},
    }


def _agreement(agreement: Agreement, kind: str) -> dict[str, float | None]:
    return dict(getattr(agreement, kind))


def improvement_document(
    improvement: Improvement,
    files: Mapping[int, str] | None = None,
    models: Mapping[str, Written] | None = None,
    load: Written | None = None,
) -> dict[str, Any]:
    """`files`: name of the written model by step; `models` and `load` as in `document`, for the last
    round."""
    return {
        "steps": [_step(step, (files or {}).get(i)) for i, step in enumerate(improvement.steps)],
        "final": document(improvement.last, models, load),
        "reason": improvement.reason,
    }


def _step(step: Step, model: str | None) -> dict[str, Any]:
    proof = step.proof
    row: dict[str, Any] = {
        "added": None if proof is None else proof.candidate.effect.name,
        "at": None if proof is None else proof.candidate.site.name,
        "component": None if proof is None else proof.candidate.name,
        "equivalent_places": [] if proof is None else list(proof.equivalent),
        **_errors(step.fit),
        "disturbance": None if step.diagnosis is None else _curve(step.diagnosis.disturbance),
        "verdict": "baseline" if proof is None else proof.verdict,
        "remark": step.remark,
        "log_likelihood": step.fit.log_likelihood,
        "parameters": {
            p.name: {"value": p.value, "std_error": p.std_error, "unit": p.unit} for p in step.fit.parameters
        },
        "model": model,
    }
    if proof is not None:
        row |= {"delta_bic": proof.delta_bic, "p_value": proof.p_value, "explained": proof.explained}
    return row
