"""The matrices that a filter meets along a record: one set per step length and pattern of present outputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from daest.errors import EstimationError
from daest.estimation.gates import FIT
from daest.model.estimates import Modes
from daest.model.experiment import Experiment
from daest.model.linear import DiscreteModel

Models = DiscreteModel | Sequence[DiscreteModel] | Mapping[float, DiscreteModel]

LONG_RUN = 64  # samples with the same matrices that are worth a treatment of their own
FEW_COLUMNS = 8  # of many small matrices, which are summed one after the other


def models_by_interval(model: Models, time: np.ndarray) -> tuple[list[DiscreteModel], np.ndarray]:
    """Distinct models and, for every sample, which of them leads to the next one (the last repeats its
    predecessor). Raises EstimationError `filter-uneven-samples` where there is no model for a step of the
    record. Shapes: time and the second result (n_samples,)."""
    steps = np.diff(time)
    if isinstance(model, DiscreteModel):
        models, which = [model], np.zeros(steps.size, dtype=int)
    elif isinstance(model, Mapping):
        models = sorted(model.values(), key=lambda m: m.period)
        lengths = np.array([m.period for m in models])
        which = np.searchsorted((lengths[1:] + lengths[:-1]) / 2, steps)  # the nearest
    else:
        models = list({id(m): m for m in model}.values())
        position = {id(m): i for i, m in enumerate(models)}
        which = np.array([position[id(m)] for m in model], dtype=int)[: steps.size]
    if which.size != steps.size:
        raise EstimationError(
            "filter-uneven-samples", f"{which.size} models for {steps.size} intervals of the record"
        )
    one = len(models) == 1
    periods = np.full(1, models[0].period) if one else np.array([m.period for m in models])[which]
    deviation = np.abs(steps - periods)
    late = np.flatnonzero(deviation > FIT.model_period * periods)
    late = late[deviation[late] > 1e-9 * np.abs(time[1:][late])]  # times themselves are rounded
    if late.size:
        k = int(late[0])
        raise EstimationError(
            "filter-uneven-samples",
            f"the step from {time[k]:.9g} s to {time[k + 1]:.9g} s is {steps[k]:.9g} s long, "
            f"the sampled model is for {periods[0 if one else k]:.9g} s",
            remedy="give one sampled model per step length",
        )
    return models, np.append(which, which[-1] if which.size else 0)


def modes_of(models: list[DiscreteModel], which: np.ndarray, outputs: np.ndarray) -> Modes:
    """One set of matrices per distinct pair of model and present outputs. Shapes: which (n_samples,), outputs
    (n_samples, n_y)."""
    present = ~np.isnan(outputs)
    if len(models) == 1 and np.all(present):
        first, index = np.zeros(1, dtype=np.int64), np.zeros(which.size, dtype=np.int64)
    else:
        code = which
        for column in present.T:  # renumbered at every output, so that codes stay small
            _, code = np.unique(code * 2 + column, return_inverse=True)
        _, first, index = np.unique(code, return_index=True, return_inverse=True)
    mask = present[first]
    chosen = [models[i] for i in which[first]]
    rows = mask.astype(float)
    R = np.stack([m.measurement_cov for m in chosen]) * rows[:, :, None] * rows[:, None, :]
    R += np.eye(mask.shape[1]) * (1.0 - rows[:, :, None])
    return Modes(
        transition=np.stack([m.transition for m in chosen]),
        output=np.stack([m.output for m in chosen]) * rows[:, :, None],
        process_cov=np.stack([m.process_cov for m in chosen]),
        cross_cov=np.stack([m.cross_cov for m in chosen]) * rows[:, None, :],
        measurement_cov=R,
        noise_cov=np.stack([m.noise_cov for m in chosen]),
        noise_process_cov=np.stack([m.noise_process_cov for m in chosen]),
        noise_measurement_cov=np.stack([m.noise_measurement_cov for m in chosen]) * rows[:, None, :],
        present=mask,
        model=which[first],
        index=index,
    )


def has_equal_steps(time: np.ndarray) -> bool:
    """Whether one sampled model serves the whole record; times are rounded. Shapes: time (n_samples,)."""
    steps = np.diff(time)
    mean = float((time[-1] - time[0]) / max(steps.size, 1))
    return bool(np.all(np.abs(steps - mean) <= 1e-6 * mean + 1e-9 * abs(float(time[-1]))))


def by_index(matrices: np.ndarray, index: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """matrices[index[k]] @ rows[k] for all k, (n_samples, m); long runs of one index are one product."""
    if matrices.shape[0] == 1:
        return rows @ matrices[0].T
    result = np.empty((rows.shape[0], matrices.shape[1]))
    edges = np.flatnonzero(np.diff(index)) + 1
    starts, stops = np.concatenate([[0], edges]), np.concatenate([edges, [index.size]])
    is_long = stops - starts >= LONG_RUN
    for begin, end in zip(starts[is_long], stops[is_long], strict=True):
        result[begin:end] = rows[begin:end] @ matrices[index[begin]].T
    short = np.repeat(~is_long, stops - starts)
    if np.all(short) and np.array_equal(index, np.arange(matrices.shape[0])):
        return _each(matrices, rows)  # one matrix for each sample, as in a transient: none is copied
    result[short] = _each(matrices[index[short]], rows[short])
    return result


def _each(matrices: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """matrices[k] @ rows[k] for all k, (n_samples, m), column by column where these are few."""
    n = rows.shape[1]
    if not 0 < n <= FEW_COLUMNS:
        return np.asarray(np.einsum("kij,kj->ki", matrices, rows))
    result = matrices[:, :, 0] * rows[:, :1]
    for j in range(1, n):
        result += matrices[:, :, j] * rows[:, j : j + 1]
    return result


def known_parts(
    models: list[DiscreteModel], which: np.ndarray, experiment: Experiment
) -> tuple[np.ndarray, np.ndarray]:
    """D ū + d (n_samples, n_y) and Γ0 ū[k] + Γ1 ū[k+1] + γ (n_samples, n); the last sample has no next
    one."""
    now = experiment.inputs
    known = _affine([m.feedthrough for m in models], [m.output_offset for m in models], which, now)
    drive = _affine([m.input_now for m in models], [m.drift for m in models], which, now)
    if any(np.any(m.input_next) for m in models):
        following = np.concatenate([now[1:], now[-1:]])
        drive = drive + by_index(np.stack([m.input_next for m in models]), which, following)
    return known, drive


def _affine(
    matrices: list[np.ndarray], offsets: list[np.ndarray], which: np.ndarray, rows: np.ndarray
) -> np.ndarray:
    """matrices[which[k]] @ rows[k] + offsets[which[k]]; one shared zero when all of them are zero."""
    if not any(np.any(part) for part in (*matrices, *offsets)):
        return np.broadcast_to(0.0, (rows.shape[0], offsets[0].size))
    result = by_index(np.stack(matrices), which, rows)
    result += offsets[0] if len(offsets) == 1 else np.stack(offsets)[which]
    return result


def select_outputs(model: DiscreteModel, rows: np.ndarray) -> DiscreteModel:
    """The model with the outputs `rows` only. Shapes: rows (n_rows,)."""
    fields = dict(model.__dict__)
    for name in ("output", "feedthrough", "output_offset"):
        fields[name] = fields[name][rows]
    for name in ("cross_cov", "noise_measurement_cov"):
        fields[name] = fields[name][:, rows]
    fields["measurement_cov"] = model.measurement_cov[np.ix_(rows, rows)]
    return DiscreteModel(**fields)


def mode_model(modes: Modes, mode: int) -> DiscreteModel:
    n, n_y = modes.transition.shape[1], modes.output.shape[1]
    return DiscreteModel(
        transition=modes.transition[mode],
        input_now=np.zeros((n, 0)),
        input_next=np.zeros((n, 0)),
        drift=np.zeros(n),
        output=modes.output[mode],
        feedthrough=np.zeros((n_y, 0)),
        output_offset=np.zeros(n_y),
        process_cov=modes.process_cov[mode],
        measurement_cov=modes.measurement_cov[mode],
        cross_cov=modes.cross_cov[mode],
        noise_cov=modes.noise_cov[mode],
        noise_process_cov=modes.noise_process_cov[mode],
        noise_measurement_cov=modes.noise_measurement_cov[mode],
        period=1.0,
        hold="zoh",
    )
