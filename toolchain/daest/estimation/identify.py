"""Identify: unknown parameters and noises of a model from recordings. Report (2), (3)-(8).

What nonlinear models need is loaded where there is one: a fit of a linear model begins a tenth of a second
earlier.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from daest.errors import EstimationError
from daest.estimation.fitting.coordinates import log_likelihood
from daest.estimation.fitting.profile import Tell, check_profile_names, silent
from daest.estimation.fitting.result import fit_result
from daest.estimation.fitting.setup import NO_INFLUENCE, Setup, changing_together, check_jumps, setup_of
from daest.estimation.gates import FIT
from daest.estimation.linear.linear_fit import absorbed_by_starts, linear_ends, linear_start, needed_slopes
from daest.model.experiment import Experiment
from daest.model.fit import FitResult, IdentifyOptions
from daest.model.flat import Dynamics, FlatModel, Model, events_refused
from daest.model.holds import Hold
from daest.model.linear import StateSpaceFamily
from daest.systems.events.modes import in_starting_mode
from daest.systems.linear.state_space import state_space_family
from daest.systems.reduction.input_slopes import acting_slopes, slope_note
from daest.systems.reduction.reduce import dynamics
from daest.systems.reduction.redundant import good_everywhere

LINEARISED = "the model is nonlinear: its linearisation was identified"
WOKEN = "{} did nothing at the start values: the others were estimated first"
ELIMINATED = "no multiple shooting: the initial states of a linear model are eliminated exactly"


def identify(
    model: Model | StateSpaceFamily,
    experiments: Sequence[Experiment],
    options: IdentifyOptions | None = None,
    validation: Sequence[Experiment] = (),
    tell: Tell = silent,
) -> FitResult:
    """Find the parameters of `model` that explain `experiments`, with their uncertainty.

    "oe" minimises the simulation error (2), weighted by maximum likelihood; "pem" maximises the
    likelihood of the one-step predictions of the Kalman filter, process and measurement noise included.
    Default: "pem" for a model that declares process noise, else "oe". Initial states are estimated per
    experiment; those of validation records too. `tell` hears what is being done. Raises EstimationError
    (codes in `estimation.setup`, `jumps`, `priors` and `profile`) and DataError.
    """
    began = time.perf_counter()
    if isinstance(model, FlatModel):
        check_jumps(model)
        model = in_starting_mode(model)
    family = model if isinstance(model, StateSpaceFamily) else state_space_family(model)
    setup = setup_of(family, experiments, validation, options or IdentifyOptions())
    check_profile_names(setup.options.profile, setup.unknowns)
    if isinstance(model, Model) and (model.events is not None or not family.is_affine):
        return _nonlinear_fit(model, setup, tell, began)
    slopes = [] if setup.options.hold else needed_slopes(family, setup.unknowns)
    straight = slope_note(family.input_names, slopes)
    notes = (*([] if family.is_affine else [LINEARISED]), *straight, *setup.notes)
    setup = replace(setup, notes=(*notes, *([ELIMINATED] if setup.options.shooting else [])))
    return fit_result(setup, linear_ends(family, setup, tell), tell, began)


def tied_parameters(
    model: FlatModel, experiments: Sequence[Experiment], hold: Hold | None = None
) -> tuple[str, ...]:
    """Estimated parameters that can change together at the values of the model without any effect on the
    outputs, that first which the data would know best if the others were known; none where there are none,
    or where nothing can be simulated."""
    piece = None
    try:
        family = state_space_family(model)
        setup = setup_of(family, experiments, (), IdentifyOptions(method="oe", hold=hold))
        if family.is_affine:
            setup, _, start = linear_start(family, setup)
        else:
            from daest.estimation.nonlinear.identify_nonlinear import nonlinear_start
            from daest.estimation.nonlinear.nonlinear_start import whole_and_piece, with_hold

            setup, problem, z = nonlinear_start(good_everywhere(dynamics(model)), setup)
            problem, z = with_hold(problem, z, setup.options)
            start, piece = whole_and_piece(problem, z)
    except EstimationError:
        return ()
    if start is None:
        return ()
    weights = dict(
        zip((c.name for c in setup.unknowns.coordinates), np.diagonal(start.information), strict=True)
    )
    together = changing_together(setup.unknowns, start, piece)
    return tuple(sorted(together, key=lambda name: -weights[name]))


def absorbed_parameters(
    model: FlatModel, experiments: Sequence[Experiment], hold: Hold | None = None
) -> tuple[str, ...]:
    """Estimated parameters of a linear model that move the outputs at its values, but not otherwise than free
    initial states do; none where nothing can be simulated."""
    try:
        family = state_space_family(model)
        if not family.is_affine:
            return ()
        setup = setup_of(family, experiments, (), IdentifyOptions(method="oe", hold=hold))
        setup, problem, start = linear_start(family, setup)
    except EstimationError:
        return ()
    return () if start is None else absorbed_by_starts(setup, problem, start)


def searched(
    family: StateSpaceFamily, experiments: Sequence[Experiment], options: IdentifyOptions
) -> tuple[float, dict[str, float]]:
    """The log-likelihood and all parameters at the end of the search of `identify` for a linear model: no
    uncertainty, no agreement. Raises as `identify`."""
    setup = setup_of(family, experiments, (), options)
    ends = linear_ends(family, setup, silent)
    unknowns, best = ends.problem.unknowns, ends.found[0]
    theta = unknowns.values(best.z)[0]
    names = family.parameter_names
    return log_likelihood(unknowns, best), dict(zip(names, theta.tolist(), strict=True))


def _nonlinear_fit(model: Model, setup: Setup, tell: Tell, began: float) -> FitResult:
    from daest.estimation.nonlinear.ekf_likelihood import identify_by_ekf
    from daest.estimation.nonlinear.identify_nonlinear import identify_nonlinear

    if model.events is not None and setup.method == "pem":
        raise events_refused("a prediction from sample to sample")
    explicit = dynamics(model)
    explicit = explicit if model.events is not None else good_everywhere(explicit)
    if setup.options.hold is None:
        slopes = acting_slopes(explicit, setup.unknowns.parameter_names(), setup.unknowns.theta)
        straight = slope_note(model.input_names, [d.index for d in slopes])
        setup = replace(setup, notes=(*straight, *setup.notes))
    # States that constraints tie have no observer with a constant gain.
    by_ekf = setup.options.likelihood == "ekf" or explicit.invariants is not None
    search = identify_by_ekf if setup.method == "pem" and by_ekf else identify_nonlinear
    try:
        fit = search(explicit, setup, tell)
    except EstimationError as error:
        if error.code != NO_INFLUENCE:
            raise
        fit = _woken(partial(search, explicit), explicit, setup, tell, error)
    return replace(fit, seconds=time.perf_counter() - began)


def _woken(
    search: Callable[[Setup, Tell], FitResult],
    explicit: Dynamics,
    setup: Setup,
    tell: Tell,
    error: EstimationError,
) -> FitResult:
    """The fit from where all parameters act, found with those held that do nothing at the start values:
    the rim of a tank that the start values never fill is reached once the others are right, or is lower than
    they have it. Raises `error` where they do nothing there, either, and where the data do not ask for what
    they do elsewhere."""
    from daest.estimation.nonlinear.identify_nonlinear import awake_start

    idle, unknowns = str(error.where), setup.unknowns
    rest = tuple(c for c in unknowns.coordinates if c.name not in idle.split(", "))
    if not rest:
        raise error
    tell(f"{idle}: nothing at the start values depends on it; estimating the others first")
    first = replace(setup.options, second_look=False, profile=())
    held = replace(setup, unknowns=replace(unknowns, coordinates=rest), options=first, validation=())
    try:
        without = search(held, tell)
        found = {c.name: without.theta[c.name] for c in rest}
        begun = replace(setup, unknowns=unknowns.started_at(found), notes=(*setup.notes, WOKEN.format(idle)))
        awake = awake_start(explicit, begun)
        if awake is None:
            raise error
        fit = search(awake, tell)
    except EstimationError:
        raise error from None
    if awake is not begun and fit.log_likelihood < without.log_likelihood + FIT.worthwhile_gain:
        raise error
    given = {c.name: c.initial for c in unknowns.coordinates}
    told = tuple(replace(p, initial=given.get(p.name, p.initial)) for p in fit.parameters)
    return replace(fit, parameters=told)
