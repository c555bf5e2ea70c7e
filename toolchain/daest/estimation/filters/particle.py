"""The particle filter of a nonlinear model, and its smoother."""

from __future__ import annotations

import numpy as np

from daest.estimation.filter_engines.filter_task import Task
from daest.estimation.filter_engines.hybrid_filter import HybridPoints
from daest.estimation.filter_engines.particle import (
    ContinuousPoints,
    ParticleRun,
    run_particles,
    smooth_particles,
)
from daest.estimation.filters.case import Case, Estimates
from daest.estimation.filters.local import discrete_names, prepared
from daest.systems.simulation.local_linear import internal_names


def estimate(case: Case, name: str) -> Estimates:
    """Raises EstimationError `particle-collapse` and those of `prepared`."""
    ready, options = prepared(case, inside=True), case.options
    task = ready.task
    points, time = points_of(task), task.data.time
    run = run_particles(
        points,
        task.data.outputs,
        task.noise.variance,
        points.start,
        options.n_particles,
        options.seed,
        options.proposal,
        time,
    )
    notes = (*ready.notes, *_notes(run, time))
    states, weights, rows = run.points, run.weights, None
    if options.smooth:
        found = smooth_particles(points, run, options.seed)
        states, rows = found.states, found.rows
        weights = np.full(states.shape[:2], 1.0 / states.shape[1])
        if not found.is_simulated:
            why = "Particles have modes" if points.has_memory else "Process noise does not reach every state"
            notes += (f"{why}: smoothed by the ancestral lines of the particles.",)
    inside = [
        points.inside(k, states[k], weights[k], None if rows is None else rows[k]) for k in range(time.size)
    ]
    values, std = (np.array(part) for part in zip(*inside, strict=True))
    steps = np.append(task.data.steps, task.data.steps[-1])
    noise_std = np.sqrt(task.noise.intensity / steps[:, None])
    unknown = np.full_like(noise_std, np.nan)
    return Estimates(
        names=(*internal_names(task.model.explicit), *discrete_names(task.model.explicit)),
        values=values,
        std=std,
        noise_values=unknown if options.smooth else np.zeros_like(noise_std),
        noise_std=unknown if options.smooth else noise_std,
        innovations=run.innovations[:, [case.model.output_names.index(n) for n in case.measure]],
        nis=float(np.sum(run.nis)),
        n_innovations=int(np.isfinite(task.data.outputs).sum()),
        log_likelihood=run.log_likelihood,
        effective=run.effective,
        messages=notes,
    )


def points_of(task: Task) -> ContinuousPoints | HybridPoints:
    """The particles of a task, which keep a mode each where the model has events."""
    return ContinuousPoints(task) if task.model.engine is None else HybridPoints(task)


def _notes(run: ParticleRun, time: np.ndarray) -> tuple[str, ...]:
    size = run.weights.shape[1]
    least, median = run.effective.min(), np.median(run.effective)
    notes = [f"Effective sample size: median {median:.0f} of {size}, least {least:.0f}."]
    if run.collapsed.size:
        notes.append(
            f"The particles collapse at {run.collapsed.size} samples, first at t = "
            f"{time[run.collapsed[0]]:g} s: estimates there rest on a few of them. Use more particles or "
            "larger noise."
        )
    return tuple(notes)
