"""The json documents of `daest diagnose` and `daest improve`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, NotRequired, TypeAlias, TypedDict

import numpy as np

from daest.diagnosis.answers.written import LOAD_FILE, Written, is_step
from daest.diagnosis.built_in.certainty import KnownProduct, known_products
from daest.model.diagnosis import (
    Candidate,
    CandidateVerdict,
    Diagnosis,
    FreeForm,
    Improvement,
    LearnedLoad,
    Proof,
    Screened,
    Step,
    Unproved,
    VerdictName,
)
from daest.model.fit import FitResult
from daest.model.holds import Hold
from daest.report.documents.parts import (
    ByOutput,
    ByPart,
    Errors,
    MadeOf,
    Of,
    Uncertain,
    entry,
    errors_entry,
)

SCREENED = 20  # entries of the screen that are listed
AS_IT_IS = (
    "The model as it is: its parameters refitted together with unknown loads (white noise in the errors told "
    "here), then simulated without them; daest compare takes the values of daest identify, or those of the "
    "model."
)

FIXED = (
    "The model as it is, simulated without the unknown loads beside which laws are compared: its parameters "
    "are held, since none is to be estimated, or since the loads would take over what the inputs do; then "
    "they are those of a fit by simulation."
)


_Class = TypedDict("_Class", {"class": NotRequired[Annotated[str, Of("candidate.effect.class_name")]]})


Effect = Annotated[str, Of("candidate.effect.name")]
Site = Annotated[str, Of("candidate.site.name")]


class Baseline(Errors):
    remark: NotRequired[Annotated[str, "how the errors were found, where that is not as in a comparison"]]


class AheadEntry(TypedDict):
    seconds: float
    samples: int
    ratio: Annotated[float, "error on unseen data, that far ahead, relative to that without the effect"]
    certainty: Annotated[float, "standard errors by which it is better"]


KnownProducts: TypeAlias = Annotated[
    dict[str, Uncertain],
    "of sizes that the data do not determine with a parameter of the model, or ratios (c/J)",
]


class CandidateEntry(_Class):
    effect: Effect
    at: Site
    equivalent_places: Annotated[list[str], Of("equivalent")]
    inputs: NotRequired[Annotated[dict[str, str], Of("candidate.inputs")]]
    parameters: dict[str, Uncertain]
    known_products: NotRequired[KnownProducts]
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
    same_as: NotRequired[Annotated[list[str], "laws that are the same equation on these recordings"]]
    model: str | None
    model_reason: NotRequired[str]


class ScreenedEntry(TypedDict):
    effect: Effect
    at: Site
    inputs: NotRequired[Annotated[dict[str, str], Of("candidate.inputs")]]
    score: float | None
    p_value: float | None
    sizes: dict[str, float | None]
    detectable: float | None
    unit: Annotated[str, Of("candidate.size_unit")]
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
    rms_before: Annotated[
        ByOutput, Of("before"), "errors of the simulation on validation data without the load"
    ]
    rms: Annotated[ByOutput, Of("after"), "errors with the load"]


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
    added: Annotated[str | None, Of("candidate.effect.name")]
    at: Annotated[str | None, Of("candidate.site.name")]
    inputs: NotRequired[Annotated[dict[str, str], Of("candidate.inputs")]]
    component: NotRequired[Annotated[str | None, Of("candidate.name")]]
    equivalent_places: NotRequired[Annotated[list[str], Of("equivalent")]]
    fit_percent: ByPart
    rms: ByPart
    disturbance: NotRequired[Curve | None]
    verdict: str
    remark: NotRequired[str]
    log_likelihood: NotRequired[float | None]
    parameters: dict[str, Uncertain]
    known_products: NotRequired[KnownProducts]
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
    hold: NotRequired[Annotated[Hold | None, "what the inputs do between the samples of the recordings"]]


def document(
    diagnosis: Diagnosis, models: Mapping[str, Written] | None = None, load: Written | None = None
) -> DiagnoseDocument:
    """`models`: the extended models by candidate name; `load`: the model with the learned load."""
    written = models or {}
    candidates = [_candidate(proof, written.get(proof.candidate.name)) for proof in diagnosis.proofs]
    return entry(
        DiagnoseDocument,
        diagnosis,
        baseline=_baseline(diagnosis),
        candidates=[*candidates, *(_without_refit(one) for one in diagnosis.unproved)],
        screen=entry(
            ScreenEntry,
            diagnosis.screen,
            best=[_screened(one) for one in diagnosis.screen.entries[:SCREENED]],
            skipped=[{"candidate": label, "reason": reason} for label, reason in diagnosis.screen.skipped],
        ),
        disturbance=_disturbance(diagnosis, load),
    )


def _baseline(diagnosis: Diagnosis) -> Baseline:
    errors = errors_entry(diagnosis.baseline.simulated)
    if not diagnosis.has_loads:
        return {**errors}
    return {**errors, "remark": FIXED if diagnosis.is_held else AS_IT_IS}


def _screened(one: Screened) -> ScreenedEntry:
    sizes = zip((p.name for p in one.candidate.effect.sizes), one.sizes, strict=True)
    return entry(ScreenedEntry, one, sizes=dict(sizes))


def _disturbance(diagnosis: Diagnosis, load: Written | None) -> Disturbance | None:
    form = diagnosis.disturbance
    if form is None:
        return None
    return entry(
        Disturbance,
        form,
        **_curve(form),
        learned=None if diagnosis.learned is None else _learned(diagnosis.learned),
        model=None if load is None else load.text,
        model_reason="" if load is None else load.reason,
    )


def _learned(learned: LearnedLoad) -> Learned:
    """The curve as it stands in the model; a value that the data do not determine has no error."""
    curve, fit = learned.curve, learned.fit
    return entry(
        Learned,
        learned,
        refitted=fit is not None,
        curve=np.column_stack([curve.x, curve.y, curve.std]),
        period=curve.period or None,
        sign_width=curve.sign_width or None,
        model_parameters=[] if fit is None else [p for p in fit.parameters if ".y[" not in p.name],
    )


def _curve(form: FreeForm) -> dict[str, object]:
    """What the entry of a free form has besides its fields."""
    return {"sign_of": form.sign_of or None, "curve": np.column_stack([form.x, form.w, form.std])}


def _known_products(candidate: Candidate, fit: FitResult) -> dict[str, KnownProduct]:
    return {p.name: p for p in known_products(candidate, fit)}


def _candidate(proof: Proof, model: Written | None) -> CandidateEntry:
    prefix = f"{proof.candidate.name}."
    fitted = {p.name.removeprefix(prefix): p for p in proof.told.parameters if p.name.startswith(prefix)}
    settings = {n.removeprefix(prefix): v for n, v in proof.told.theta.items() if n.startswith(prefix)}
    return entry(
        CandidateEntry,
        proof,
        parameters=fitted,
        known_products=_known_products(proof.candidate, proof.told),
        model_parameters=[p for p in proof.told.parameters if not p.name.startswith(prefix)],
        settings=settings,
        **errors_entry(proof.told.simulated),
        refitted=True,
        model=None if model is None else model.text,
        model_reason="" if model is None else model.reason,
    )


def _without_refit(one: Unproved) -> CandidateEntry:
    """A leader of the screen that was not refitted, with the sizes that the screen gives it."""
    candidate = one.candidate
    sizes = zip(candidate.effect.sizes, one.sizes, strict=True)
    return entry(
        CandidateEntry,
        one,
        parameters={
            p.name: {"value": size, "std_error": None, "unit": candidate.units.get(p.name, p.unit)}
            for p, size in sizes
        },
        model_parameters={},
        fit_percent={"estimation": {}},
        rms={"estimation": {}},
        delta_log_likelihood=None,
        delta_bic=None,
        explained=None,
        ahead=[],
        refitted=False,
        verdict="rejected",
        not_separable_from=[],
        model=None,
        model_reason="",
    )


def improvement_document(
    improvement: Improvement,
    files: Mapping[int, str] | None = None,
    load: Written | None = None,
) -> Ledger:
    """`files`: name of the written model by step; `load` as in `document`, for the last round. A curve that
    unseen data bear out is the last step of the ledger."""
    steps = [_step(step, (files or {}).get(i)) for i, step in enumerate(improvement.steps)]
    if is_step(load, improvement.last):
        steps.append(_curve_step(improvement.last, load))
    return entry(Ledger, improvement, steps=steps, final=document(improvement.last, load=load))


def _curve_step(last: Diagnosis, load: Written) -> StepEntry:
    """The load that no law is, as the last step: its curve in the model."""
    learned, extension = last.learned, load.extension
    assert learned is not None and learned.fit is not None and extension is not None
    return entry(
        StepEntry,
        learned.form,
        added=extension.effect,
        at=learned.form.place,
        component=extension.component,
        inputs={},
        equivalent_places=[],
        verdict=last.verdict,
        **errors_entry(learned.fit.simulated),
        disturbance=entry(Curve, learned.form, **_curve(learned.form)),
        remark=f"a curve over {learned.form.label}, which no law of the library is",
        log_likelihood=learned.fit.log_likelihood,
        parameters=[p for p in learned.fit.parameters if ".y[" not in p.name],
        known_products={},
        model=LOAD_FILE,
    )


def _step(step: Step, model: str | None) -> StepEntry:
    """A round; the first has the model as it was, and therefore no effect."""
    proof = step.proof
    form = None if step.diagnosis is None else step.diagnosis.disturbance
    none: dict[str, object] = dict.fromkeys(("added", "at", "component"))
    none |= {"equivalent_places": [], "verdict": "baseline", "inputs": {}}
    return entry(
        StepEntry,
        proof,
        **(none if proof is None else {}),
        **errors_entry(step.fit.simulated),
        disturbance=None if form is None else entry(Curve, form, **_curve(form)),
        remark=step.remark,
        log_likelihood=step.fit.log_likelihood,
        parameters=step.fit.parameters,
        known_products={} if proof is None else _known_products(proof.candidate, step.fit),
        model=model,
    )
