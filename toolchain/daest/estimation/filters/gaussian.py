"""The extended and the unscented Kalman filter of a nonlinear model, and their smoothers."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from scipy.linalg import block_diag

from daest.estimation.filter_engines.ekf import EkfRun, run_ekf
from daest.estimation.filter_engines.filter_task import Task
from daest.estimation.filter_engines.interpreted import project
from daest.estimation.filter_engines.nonlinear_smoother import Joint, filtered_joint, smooth_ekf, smooth_ukf
from daest.estimation.filter_engines.ukf import UkfRun, run_ukf
from daest.estimation.filters.case import Case, Estimates
from daest.estimation.filters.local import discrete_names, discrete_slots, prepared
from daest.systems.simulation.local_linear import internal_function, internal_names

CHUNK = 1000  # samples whose internal variables are evaluated at once


def estimate(case: Case, name: str) -> Estimates:
    """Raises EstimationError `output-white-noise`, `filter-singular-innovation`, and those of `prepared`."""
    ready = prepared(case)
    task, smooth = ready.task, case.options.smooth
    run = _extended if name == "ekf" else _unscented
    innovations, nis, log_likelihood, joint, modes = run(task, smooth)
    joint = joint if task.model.hold is None or not smooth else _held(task, joint)
    values, std = _inside(task, joint, modes)
    n = task.model.n_states
    own = np.diagonal(joint.cov, axis1=1, axis2=2)[:, n:]
    return Estimates(
        names=(*internal_names(task.model.explicit), *discrete_names(task.model.explicit)),
        values=np.hstack([values, discrete_values(task, modes)]),
        std=np.hstack([std, np.full((len(std), len(discrete_names(task.model.explicit))), np.nan)]),
        noise_values=joint.mean[:, n:],
        noise_std=np.sqrt(np.maximum(own, 0.0)),
        innovations=innovations[:, [case.model.output_names.index(n) for n in case.measure]],
        nis=float(np.sum(nis)),
        n_innovations=int(np.isfinite(task.data.outputs).sum()),
        log_likelihood=log_likelihood,
        messages=ready.notes,
    )


def discrete_values(task: Task, modes: np.ndarray | None) -> np.ndarray:
    """Values of the discrete variables in the modes of a filter (n_samples, n_discrete)."""
    if modes is None:
        return np.empty((task.data.time.size, 0))
    return modes[:, discrete_slots(task.model.explicit)]


def _extended(task: Task, smooth: bool) -> tuple[np.ndarray, np.ndarray, float, Joint, np.ndarray | None]:
    """Innovations, their squares per sample, log p(y), the estimates, and the modes (`EkfRun.modes`)."""
    run = run_ekf(task.model, task.data, task.theta, task.noise, task.start, task.longest)
    joint = smooth_ekf(run, task.data, task.noise) if smooth else _filtered(task, run)
    white = run.innovations / np.sqrt(run.variances)
    return run.innovations, np.nansum(white**2, axis=1), run.log_likelihood, joint, run.modes


def _unscented(task: Task, smooth: bool) -> tuple[np.ndarray, np.ndarray, float, Joint, np.ndarray | None]:
    run = run_ukf(task.model, task.data, task.theta, task.noise, task.start, task.longest)
    joint = smooth_ukf(run, task.data, task.noise) if smooth else _filtered(task, run)
    return run.innovations, run.nis, run.log_likelihood, joint, run.modes


def _filtered(task: Task, run: EkfRun | UkfRun) -> Joint:
    return filtered_joint(task.data, task.noise, run.filtered, run.filtered_cov)


def _held(task: Task, joint: Joint) -> Joint:
    """Smoothed estimates on the constraints again: the smoother moves them along straight lines."""
    n = task.model.n_states
    mean, cov = joint.mean.copy(), joint.cov.copy()
    for k, time in enumerate(task.data.time):
        mean[k, :n], _, along = project(task, mean[k, :n], cov[k, :n, :n], task.data.u0[k], float(time))
        whole = block_diag(along, np.eye(mean.shape[1] - n))
        cov[k] = whole @ cov[k] @ whole.T
    return Joint(mean, cov)


def _inside(task: Task, joint: Joint, modes: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Internal variables and their standard deviations (n_samples, n_v), by their slopes at the estimate."""
    explicit, n = task.model.explicit, task.model.n_states
    kind: Any = ca.SX if explicit.is_symbolic else ca.MX
    arguments = [kind.sym(f"a{i}", explicit.rhs.numel_in(i)) for i in range(6)]
    value = internal_function(explicit)(*arguments)
    slopes = ca.densify(ca.jacobian(value, ca.vertcat(arguments[0], arguments[3])))
    function = ca.Function("inside", arguments, [value, slopes])
    samples, n_v, n_u = task.data.time.size, value.numel(), len(explicit.flat.inputs)
    values, std = np.empty((samples, n_v)), np.empty((samples, n_v))
    for first in range(0, samples, CHUNK):
        rows = slice(first, min(first + CHUNK, samples))
        count = rows.stop - rows.start
        ubar, mean = task.data.u0[rows], joint.mean[rows]
        columns = [mean[:, :n].T, ubar[:, :n_u].T, ubar[:, n_u:].T, mean[:, n:].T]
        theta = ca.repmat(ca.DM(task.theta), 1, count) if modes is None else ca.DM(modes[rows].T)
        found = function.map(count)(*columns, theta, task.data.time[rows][None])
        values[rows] = np.array(found[0]).T
        explicit.raise_failure()
        J = np.array(found[1]).reshape(n_v, count, -1).transpose(1, 0, 2)
        std[rows] = np.sqrt(
            np.maximum(np.einsum("kvi,kij,kvj->kv", J, joint.cov[rows], J, optimize=True), 0.0)
        )
    return values, std
