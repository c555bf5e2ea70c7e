"""From the ends of the searches of a nonlinear model to estimates, uncertainty, noise levels, agreement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from daest.estimation.fitting.coordinates import objective, prior_precisions
from daest.estimation.fitting.identifiability import (
    Scores,
    are_coloured,
    covariance,
    output_error_covariance,
    scores,
    std_errors,
    unseen_directions,
    without_influence,
)
from daest.estimation.fitting.profile import Searched
from daest.estimation.fitting.result import (
    COLOURED,
    FOLLOWING,
    End,
    Told,
    agreement_of,
    bound_of,
    common_period,
    fitted_initial_state,
)
from daest.estimation.fitting.search import Found
from daest.estimation.fitting.setup import Setup
from daest.estimation.gates import FIT
from daest.estimation.nonlinear.gain_family import Levels
from daest.estimation.nonlinear.noise_levels import Ending, average_along
from daest.estimation.nonlinear.nonlinear_start import at_rest, begun_best, consistent_states, limits
from daest.estimation.nonlinear.observer import AverageModel
from daest.estimation.nonlinear.shooting import whole_errors
from daest.estimation.nonlinear.trajectories import Errors, TrajectoryProblem, prediction_errors
from daest.model.experiment import Experiment
from daest.model.fit import Agreement, FittedNoise
from daest.model.flat import Dynamics

AGREEMENT_ITERATIONS = 10  # of the search for the initial states that an agreement is judged from
SWITCHES = (
    "the model changes at events, so that its likelihood may have valleys of its own between them, and "
    "intervals that are too narrow in a wrong one: compare the ends from several starts (--starts 8)"
)
TOO_LARGE = (
    "{:.0f} % of the samples are missing: after each, a predictor with a constant gain errs more than it "
    "knows, and takes that for noise; --likelihood ekf tells noises without this excess"
)


@dataclass(frozen=True)
class NonlinearEnds:
    """Where the searches ended, best first. Simulations that validate begin with the states `at_rest` at
    zero: they stand for noise."""

    setup: Setup
    ends: list[Ending]
    at_rest: Sequence[str] = ()

    @property
    def best(self) -> Ending:
        return self.ends[0]

    @property
    def found(self) -> list[Found]:
        return [end.found for end in self.ends]

    @property
    def levels(self) -> Levels:
        """Of the noises: without a gain the errors are measurement noise, with one those behind it."""
        return self._levels(_judged_errors(self.best)[0])

    def _levels(self, errors: Errors) -> Levels:
        std = np.sqrt(np.diagonal(errors.covariance))
        return self.best.levels or Levels(np.full(self.setup.intensity.size, np.nan), std)

    @property
    def searched(self) -> Searched | None:
        best = self.best
        if best.cut is not None:
            return None
        return Searched(objective(best.problem), self.setup.unknowns, *limits(best.problem), best.found)

    def agreements(self, experiments: tuple[Experiment, ...] | None = None) -> tuple[Agreement, Agreement]:
        """Of simulations and of one-step predictions; None: with the recordings that were fitted."""
        simulated = self.agreement(experiments, with_gain=False)
        if not self.best.problem.is_predictor and not self.at_rest:
            return simulated, simulated  # without a gain, predictions are simulations
        return simulated, self.agreement(experiments, with_gain=True)

    def agreement(
        self,
        experiments: tuple[Experiment, ...] | None,
        *,
        with_gain: bool,
        iterations: int = AGREEMENT_ITERATIONS,
    ) -> Agreement:
        """From the best initial state of each experiment, parameters held, which is searched in so many
        `iterations` over whole recordings."""
        end, problem = self.best, self.best.problem
        names = problem.model.explicit.flat.output_names
        is_fitted, experiments = experiments is None, experiments or problem.experiments
        measured = [e.outputs for e in experiments]
        if end.cut is not None and is_fitted:
            return agreement_of(names, measured, whole_errors(end.cut)[0].errors)
        problem = replace(problem, gain=problem.gain if with_gain else None, experiments=experiments)
        rests = np.zeros((len(experiments), problem.n_states), dtype=bool)
        if not with_gain:
            rests = problem.long_past(end.found.z)
        if is_fitted and (with_gain or end.problem.gain is None) and not np.any(rests):
            # What was searched: the initial states are the best ones.
            errors = prediction_errors(problem, end.found.z)
            return agreement_of(names, measured, None if errors is None else errors.errors)
        problem = problem.held_at(end.found.z)
        if is_fitted:
            z = end.found.z[len(self.setup.unknowns.coordinates) :]
        else:
            z = (consistent_states(problem, np.zeros(0)) / problem.state_scale).ravel()
            if not with_gain:
                rests = rests | np.isin(problem.model.explicit.state_names, self.at_rest)
        problem, found = begun_best(problem, *at_rest(problem, z, rests), iterations, is_near=is_fitted)
        errors = None if found is None else prediction_errors(problem, found.z)
        return agreement_of(names, measured, None if errors is None else errors.errors)

    def judged(self) -> tuple[End, Told]:
        """By report (2): inverse information, or the sandwich for coloured residuals of a simulation."""
        setup, end = self.setup, self.best
        problem, unknowns, found = end.problem, end.problem.unknowns, end.found
        n = len(unknowns.coordinates)
        explicit = problem.model.explicit
        errors, parts = _judged_errors(end)
        slopes = unknowns.slopes(found.z[:n])
        bounds = [bound_of(c, z) for c, z in zip(unknowns.coordinates, found.z[:n], strict=True)]
        information = np.sum([np.tensordot(s.slopes, s.slopes, ((1, 2), (1, 2))) for s in parts], axis=0)
        observed = [np.isfinite(e.outputs) for e in problem.experiments]
        in_z = information * np.outer(slopes, slopes) + np.diag(prior_precisions(unknowns))
        is_off = np.array([b is None for b in bounds], dtype=bool)
        free = ~without_influence(in_z, setup.n_observed) & is_off
        notes = list(end.notes)
        if explicit.flat.events is not None and len(self.ends) == 1:
            notes.append(SWITCHES)
        if setup.method == "oe":
            uncertain = output_error_covariance(parts, observed, slopes, free, prior_precisions(unknowns))
            cov_z = uncertain.covariance
            if uncertain.is_coloured:
                notes.append(COLOURED)
        else:
            cov_z = covariance(in_z, free)
            if are_coloured([s.residuals for s in parts], observed):
                notes.append(FOLLOWING)
            missing = 1.0 - float(np.mean(np.concatenate(observed)))
            if np.any(setup.estimate_intensity) and missing > FIT.many_missing:
                notes.append(TOO_LARGE.format(100.0 * missing))
        cov = cov_z * np.outer(slopes, slopes)
        values = unknowns.natural(found.z[:n])
        average = average_along(problem, found.z)
        names = explicit.state_names
        states = zip(problem.experiments, problem.initial_states(found.z), parts, strict=True)
        told = Told(
            declared=explicit.flat.parameters,
            theta=problem.theta(found.z),
            noises=_fitted_noises(setup, explicit, self._levels(errors)),
            noise_model="white",
            initial_states=tuple(
                fitted_initial_state(e.name, names, x0, part, cov) for e, x0, part in states
            ),
            period=common_period(problem.experiments),
            hold=problem.hold,
            notes=tuple(notes),
            unseen=() if average is None else _unseen(average, explicit),
        )
        return End(unknowns, values, cov, std_errors(cov, values), bounds, in_z), told


def _unseen(average: AverageModel, explicit: Dynamics) -> tuple[str, ...]:
    """What no output sees. What events assign is left out: it does not evolve as A says."""
    flat, names = explicit.flat, explicit.state_names
    changed = () if flat.events is None else flat.events.assignments
    assigned = {flat.unknowns[one.unknown].name for one in changed if one.is_real}
    own = [i for i, name in enumerate(names) if name not in assigned]
    kept = tuple(names[i] for i in own)
    return unseen_directions(average.A[np.ix_(own, own)], average.C[:, own], average.period, kept)


def _judged_errors(end: Ending) -> tuple[Errors, list[Scores]]:
    if end.cut is not None:
        return whole_errors(end.cut, with_slopes=True)
    errors = prediction_errors(end.problem, end.found.z, with_slopes=True)
    assert errors is not None
    return errors, _all_scores(end.problem, errors)


def _all_scores(problem: TrajectoryProblem, errors: Errors) -> list[Scores]:
    """Whitened residuals with slopes per unit of the parameters, initial states projected out."""
    n = len(problem.unknowns.coordinates)
    root = np.linalg.inv(np.linalg.cholesky(errors.covariance)).T
    parts = []
    for error, trajectory in zip(errors.errors, errors.trajectories, strict=True):
        observed = np.isfinite(error)
        change = np.where(observed, -trajectory.sensitivities.transpose(2, 0, 1), 0.0) @ root
        residuals = np.where(observed, error, 0.0) @ root
        parts.append(scores(residuals, -change[n:], change[:n]))
    return parts


def _fitted_noises(setup: Setup, explicit: Dynamics, levels: Levels) -> tuple[FittedNoise, ...]:
    flat, std = explicit.flat, levels.measurement_std
    per_output = max(setup.n_observed / max(std.size, 1), 1.0)
    process = (
        FittedNoise(w.name, "process", float(q), None, w.unit, bool(estimated), None)
        for w, q, estimated in zip(flat.noises, levels.intensity, setup.estimate_intensity, strict=True)
        if np.isfinite(q)
    )
    measurement = (
        FittedNoise(
            o.name,
            "measurement",
            float(s),
            float(s / np.sqrt(2.0 * per_output)) if estimated else None,
            o.unit,
            bool(estimated),
            None,
        )
        for o, s, estimated in zip(flat.outputs, std, setup.estimate_std, strict=True)
    )
    return (*process, *measurement)
