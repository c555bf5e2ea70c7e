"""Learned loads: what no effect of the library explains, built into the model as a curve and refitted.

The one-step curve of a free form is read off the null, whose parameters have taken their part of the effect.
Here the curve, straight lines between knots, becomes part of the model, and its values are estimated together
with the parameters by maximum likelihood.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import casadi as ca
import numpy as np

from daest.diagnosis.answers.formulas import formula
from daest.diagnosis.built_in.settled import FAILURES, better_of, fit_by_simulation, settled
from daest.diagnosis.comparison.compare import compare_models
from daest.diagnosis.comparison.trial import Candidate as Trialled
from daest.diagnosis.evidence.proof import Reference
from daest.diagnosis.evidence.unseen import compared, foreseen, foretold_drift, judged
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import Null, period_of, refit
from daest.diagnosis.null_model.null_observer import NullObserver
from daest.diagnosis.screening.free_forms import TURN, internal_variables
from daest.errors import DaestError
from daest.estimation.fitting.records import n_observed
from daest.model.diagnosis import Curve, FreeForm, LearnedLoad
from daest.model.experiment import Experiment
from daest.model.fit import FitResult
from daest.model.flat import FlatModel
from daest.model.holds import Hold
from daest.model.parts import Parameter
from daest.modelica.effects.attach import names_of
from daest.modelica.flat.clock import clock_unit
from daest.modelica.places.balances import slopes_near_start
from daest.systems.reduction.reduce import reduce_index

COMPONENT = "learned"
MOST_KNOTS = 20
BAND = 1.96  # standard deviations to either side of a 95 % band
UNCERTAIN = " No value of the curve is certain: it shares its course with parameters refitted with it."
FEWEST_BETWEEN = 20  # samples between two knots that get another one between them


def learned_load(
    null: Null,
    run: NullObserver,
    baseline: FitResult,
    form: FreeForm,
    validation: Sequence[Experiment] = (),
    reference: Reference | None = None,
) -> LearnedLoad | None:
    """The load of `form` as a part of the null's model; None where its variable depends on it at once, as an
    acceleration does on a torque, or is not there with the inputs as they are held now, as a speed that is
    the slope of one.

    The curve's values are refitted with the estimated parameters, with more and more knots while that pays
    by BIC; where no refit succeeds, they are those of the form. `baseline` is the null's fit on the same
    terms; where there is a `reference`, the curve must foresee unseen data better than that.
    """
    course = _courses(null, run, form)
    if course is None:
        return None
    start, row = _curve(form, course), null.places[form.load].row
    if _is_loop(null, with_curve(null.flat, row, start)):
        return None
    sign, before = load_sign(null.flat, row), _validation_errors(baseline)
    found = _fitted(null, row, start, validation, baseline.log_likelihood)
    if found is None:
        flat = with_curve(null.flat, row, start)
        theta = {p.name: p.value for p in flat.parameters}
        after = _simulated(flat, validation, null.hold)
        return LearnedLoad(form, start, theta, None, before, after, sign, _no_better(before, after))
    n_measured = n_observed(null.experiments)
    while True:
        curve, fit = found
        finer = _finer(curve, course[form.variable])
        n_more = finer.x.size - curve.x.size
        if n_more == 0 or finer.x.size > MOST_KNOTS:
            break
        finer_must_reach = fit.log_likelihood + 0.5 * n_more * np.log(n_measured)
        found = _fitted(null, row, finer, validation, finer_must_reach)
        if found is None:
            break
    if reference is None or not validation:
        return LearnedLoad(form, curve, fit.theta, fit, before, _validation_errors(fit), sign)
    flat = with_curve(null.flat, row, curve)
    told, against = fit, ""
    found_settled = settled(null, fit, flat, reduce_index(flat), null.experiments, validation)
    if found_settled is not None:
        white, observer = found_settled
        ahead = compared(reference.foreseen, foreseen(observer, validation), period_of(null.experiments))
        told = white
        if not reference.adds_up:
            told = better_of(white, fit_by_simulation(null, white, flat, null.experiments, validation))
        drift = foretold_drift(observer, validation) if reference.adds_up else None
        clock = clock_unit(null.flat)
        against, _, _ = judged(
            ahead,
            reference.fit,
            told,
            reference.adds_up,
            holding=reference.holding,
            clock=clock,
            drift=drift,
        )
        own = [p.name for p in told.parameters if p.name not in null.estimated]
        curve = _of_fit(curve, own, told)
    before = _validation_errors(reference.fit)
    return LearnedLoad(form, curve, told.theta, told, before, _validation_errors(told), sign, against)


def _no_better(before: Mapping[str, float | None], after: Mapping[str, float | None]) -> str:
    """Why unseen data speak against a curve that no refit bears out; empty where it simulates an output of
    them better by more than what is the same."""
    pairs = [(b, after.get(name)) for name, b in before.items() if b is not None]
    known = [(b, a) for b, a in pairs if a is not None]
    if known and all(a >= (1.0 - GATES.same_unseen_error) * b for b, a in known):
        return "the simulation of unseen data gets no better"
    return ""


def _is_loop(null: Null, flat: FlatModel) -> bool:
    try:
        return null.explicit.is_symbolic and not reduce_index(flat).is_symbolic
    except DaestError:
        return True


def helps(learned: LearnedLoad) -> bool:
    """Whether a curve that was refitted in the model makes the simulation of unseen data clearly better."""
    pairs = [(b, learned.after.get(name)) for name, b in learned.before.items()]
    ratios = [a / b for b, a in pairs if b and a is not None]
    return learned.fit is not None and bool(ratios) and max(ratios) <= GATES.max_clear_ratio


def said(learned: LearnedLoad) -> str:
    """What the curve does to the validation error, as a sentence that follows others."""
    how = "With the curve, refitted, in the model" if learned.fit else "With the curve in the model"
    pairs = {
        name: (before, after)
        for name, before in learned.before.items()
        if before is not None and (after := learned.after.get(name)) is not None
    }
    if not pairs:
        return ""
    parts = [f"{name} {before:.3g} -> {after:.3g}" for name, (before, after) in pairs.items()]
    worse = all(after >= before for before, after in pairs.values())
    warning = ", no better: take the curve as a hint, not as a model" if worse else ""
    loose = "" if _has_certain_value(learned.curve) else UNCERTAIN
    return f" {how}: validation error (rms) {', '.join(parts)}{warning}.{loose}{_formula_said(learned)}"


def with_formula(learned: LearnedLoad) -> LearnedLoad:
    """The load with the short formula for its curve, where there is one that the data show."""
    form, fit = learned.form, learned.fit
    n, correlation = learned.curve.x.size, None
    # The values of the curve are the last parameters of the model with it.
    if fit is not None and all(".y[" in name for name in fit.correlation_names[-n:]):
        correlation = fit.correlation[-n:, -n:]
    found = formula(learned.curve, form.unit, form.variable_unit, correlation)
    is_shown = found is not None and any(abs(c.value) > BAND * c.std_error for c in found.coefficients)
    return replace(learned, formula=found if is_shown else None)


def _formula_said(learned: LearnedLoad) -> str:
    found = learned.formula
    if found is None:
        return ""
    errors = ", ".join(f"± {c.std_error:.2g} {c.unit}".rstrip() for c in found.coefficients)
    return (
        f" A short formula for the curve: {found.text} ({errors}; {found.n_numbers} in place of "
        f"{learned.curve.x.size} numbers, which leaves {100.0 * found.left:.0f} % of it)."
    )


def _has_certain_value(curve: Curve) -> bool:
    """Whether the band of 95 % leaves out zero anywhere."""
    return bool(np.any(np.abs(curve.y) > BAND * curve.std))


def _fitted(
    null: Null, row: int, start: Curve, validation: Sequence[Experiment], least: float
) -> tuple[Curve, FitResult] | None:
    """The curve and the fit of a search from `start`; None where it fails or does not end above the
    log-likelihood `least`."""
    flat = with_curve(null.flat, row, start)
    own = tuple(p.name for p in flat.parameters[len(null.flat.parameters) :])
    try:
        fit = refit(flat, reduce_index(flat), (*null.estimated, *own), null, validation=validation)
    except FAILURES:
        return None
    return (_of_fit(start, own, fit), fit) if fit.log_likelihood > least else None


def _validation_errors(fit: FitResult) -> dict[str, float | None]:
    found = fit.simulated.get("validation")
    return {} if found is None else dict(found.rms)


def _simulated(flat: FlatModel, experiments: Sequence[Experiment], hold: Hold) -> dict[str, float | None]:
    silent = replace(flat, noises=tuple(replace(w, intensity=0.0) for w in flat.noises))
    try:
        comparison = compare_models([Trialled(flat.name, silent, 0, hold)], list(experiments))
    except FAILURES:
        return {}
    return dict(comparison.models[0].simulation.rms)


# The curve --------------------------------------------------------------------------------------------------


def _courses(null: Null, run: NullObserver, form: FreeForm) -> dict[str, np.ndarray] | None:
    """The variables of the form along all experiments; None where one of them stands still or is unknown."""
    names = [name for name in (form.variable, form.sign_of) if name]
    runs = [internal_variables(null, run, i, names) for i in range(len(null.experiments))]
    if not all(name in one for one in runs for name in names):
        return None
    return {name: np.concatenate([one[name] for one in runs]) for name in names}


def _curve(form: FreeForm, course: Mapping[str, np.ndarray]) -> Curve:
    """The form's curve at distinct knots."""
    sign_width = 0.0
    if form.sign_of:
        sign_width = (
            GATES.learned_sharper * GATES.soft_sign * float(np.sqrt(np.mean(course[form.sign_of] ** 2)))
        )
    kept = np.append(True, np.diff(form.x) > GATES.same_knot * np.ptp(form.x))
    return Curve(
        variable=form.variable,
        sign_of=form.sign_of,
        sign_width=sign_width,
        period=TURN if form.over_a_turn else 0.0,
        x=form.x[kept],
        y=form.w[kept],
        std=form.std[kept],
    )


def _finer(curve: Curve, course: np.ndarray) -> Curve:
    """The curve with one more knot in every wide interval that holds enough samples, as many of them on both
    sides of it."""
    ends = curve.x
    if curve.period:
        course = curve.x[0] + np.mod(course - curve.x[0], curve.period)
        ends = np.append(curve.x, curve.x[0] + curve.period)
    between = [course[(course > a) & (course < b)] for a, b in pairwise(ends)]
    added = [
        float(np.median(inside))
        for (a, b), inside in zip(pairwise(ends), between, strict=True)
        if inside.size >= FEWEST_BETWEEN and b - a > GATES.wide_interval * np.ptp(curve.x)
    ]
    x = np.union1d(curve.x, added)
    y = np.interp(x, curve.x, curve.y, period=curve.period or None)
    return replace(curve, x=x, y=y, std=np.full(x.size, np.nan))


def _of_fit(start: Curve, own: Sequence[str], fit: FitResult) -> Curve:
    found = {p.name: p for p in fit.parameters}
    std = [found[name].std_error for name in own]
    return replace(
        start,
        y=np.array([fit.theta[name] for name in own]),
        std=np.array([np.nan if one is None else one for one in std]),
    )


def with_curve(flat: FlatModel, row: int, curve: Curve) -> FlatModel:
    """`flat` with the load of `curve` subtracted in equation `row`; its values are the last parameters,
    `learned.y[1]` and so on."""
    symbols = {v.name: x for v, x in zip(flat.unknowns, ca.vertsplit(flat.xi), strict=True)}
    symbols |= {v.name: x for v, x in zip(flat.inputs, ca.vertsplit(flat.u), strict=True)}
    name = _free_name(flat)
    y = ca.SX.sym(f"{name}.y", curve.y.size)
    load = _interpolated(symbols[curve.variable], curve, y)
    if curve.sign_of:
        load *= ca.tanh(symbols[curve.sign_of] / curve.sign_width)
    residual = ca.SX(flat.residual)
    residual[row] -= load
    # One unit of the search for all values: some of them are near zero.
    size = float(np.sqrt(np.mean(curve.y**2))) or 1.0
    values = tuple(
        Parameter(f"{name}.y[{i + 1}]", float(value), description="load at a knot", nominal=size)
        for i, value in enumerate(curve.y)
    )
    return replace(
        flat,
        parameters=(*flat.parameters, *values),
        theta=ca.vertcat(flat.theta, y),
        residual=residual,
    )


def _free_name(flat: FlatModel) -> str:
    taken, name, number = names_of(flat), COMPONENT, 1
    while name in taken:
        number += 1
        name = f"{COMPONENT}{number}"
    return name


def _interpolated(x: ca.SX, curve: Curve, y: ca.SX) -> ca.SX:
    """Straight lines between the knots, as PartialLearnedLoad of the library has them."""
    if curve.period:
        x = curve.x[0] + _remainder(x - curve.x[0], curve.period)
    value = y[0]
    for k in range(curve.x.size - 1):
        value += (y[k + 1] - y[k]) * _ramp(x, curve.x[k], curve.x[k + 1])
    if curve.period:
        value += (y[0] - y[curve.x.size - 1]) * _ramp(x, curve.x[-1], curve.x[0] + curve.period)
    return value


def _remainder(x: ca.SX, period: float) -> ca.SX:
    return x - period * ca.floor(x / period)


def _ramp(x: ca.SX, first: float, last: float) -> ca.SX:
    return ca.fmax(0.0, ca.fmin(1.0, (x - first) / (last - first)))


def load_sign(flat: FlatModel, row: int) -> float:
    """1 where a load subtracted in equation `row` flows into the components that meet there, -1 where its
    negative does."""
    flows = [i for i, v in enumerate(flat.unknowns) if v.is_flow]
    # A factor may hold parameters, as that of what flows into `l*der(x) = ...` does.
    slopes = slopes_near_start(flat)[row] if flows else np.zeros(0)
    present = [i for i in flows if slopes[i]]
    # A connector of a composite component has its flow with the other sign in the sum inside of it.
    inner = max(present, key=lambda i: flat.unknowns[i].name.count("."), default=None)
    return -1.0 if inner is not None and slopes[inner] < 0.0 else 1.0
