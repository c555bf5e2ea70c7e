"""What a model foresees of data that it has not seen, at every horizon.

The observer of a model runs over the validation data, is then left alone for as many samples as the horizon
says, and takes up again: one run per horizon. Two models are compared stretch by stretch, so that chance is
told from progress whatever the colour of the errors, and where they differ: an overflow that is seldom
reached tells nothing of the rest of the record.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from daest.diagnosis.evidence.free_starts import best_start
from daest.diagnosis.evidence.reasons import unexplained
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import with_noise
from daest.diagnosis.null_model.null_observer import ATOL_OF_SCALE, RTOL, NullObserver, run_null
from daest.errors import DaestError
from daest.estimation.fitting.records import longest_duration
from daest.estimation.nonlinear.observer import observer, sampled_average
from daest.model.diagnosis import Ahead, Confirmed
from daest.model.experiment import Experiment
from daest.model.fit import FitResult, error_ratios, follows_all
from daest.numerics.tables import turned
from daest.quantities import spoken_duration
from daest.systems.events.integration import Correction, IntegrationError
from daest.systems.simulation.integrate import Integrator, integrate, integrator

HORIZONS = (1, 3, 10, 30, 100)  # samples, as far as LONGEST allows
LONGEST = 0.1  # of the shortest recording
TAKES_UP = 20  # samples for which the observer follows the data before it is left alone again
UNSEEN = 1e-9  # share of a direction that is new to the outputs, below which it is rounding
FEWEST_STRETCHES = 5
DRIFT_STEPS = 200  # in which a covariance is followed over a recording
CORRECTED = (0.03, 0.1, 0.3)  # of an innovation, by observers that follow more closely than the fit asks for
LOUDER = 10.0 ** np.arange(-12, 13)  # times the loads of the fit
SIMULATED_WORSE = "the simulation of unseen data gets"


@dataclass(frozen=True)
class Foreseen:
    """Errors of every stretch at every horizon (samples), each (n_stretches, length, n_y), NaN where nothing
    was measured; `kept` are those of values that stay what they were before the stretch."""

    errors: dict[int, np.ndarray]
    kept: dict[int, np.ndarray]


def foreseen(run: NullObserver, experiments: Sequence[Experiment]) -> Foreseen | None:
    """The validation `experiments` foreseen by the observer `run`, or by one that follows them more closely
    where that loses them, as far ahead as it can be integrated; None where it cannot at all."""
    followed = _best_followed(run, experiments)
    if followed is None:
        return None
    shortest = min(e.n_samples for e in experiments)
    errors = {1: followed.errors}
    with suppress(IntegrationError):
        for h in HORIZONS:
            if 1 < h <= LONGEST * shortest:
                errors[h] = _ahead(followed, experiments, h)
    kept = {h: _all_kept(experiments, h) for h in errors}
    return Foreseen(errors, kept)


def _ahead(followed: _Followed, experiments: Sequence[Experiment], horizon: int) -> np.ndarray:
    """Errors (n_stretches, length, n_y) over `horizon` samples by the observer that `followed` the data. That
    of a machine which falls over has no time to spare for being left alone: where it foresees no better than
    values that stay, those of louder loads are asked, too. Raises IntegrationError."""
    own = _ahead_by(followed, experiments, horizon)
    root = followed.run.root

    def size(errors: np.ndarray) -> float:
        return float(np.nanmean((errors @ root.T) ** 2))

    if size(own) <= size(_all_kept(experiments, horizon)) or not _falls_over(followed.run):
        return own
    found = [own]
    for run in _louder(followed.run):
        with suppress(IntegrationError):
            found.append(_ahead_by(replace(followed, run=run), experiments, horizon))
    return min(found, key=size)


def _ahead_by(followed: _Followed, experiments: Sequence[Experiment], horizon: int) -> np.ndarray:
    model = integrator(followed.run.null.explicit)
    pairs = zip(experiments, followed.starts, strict=True)
    return np.concatenate([_stretches(followed.run, model, e, x0, horizon) for e, x0 in pairs])


def _all_kept(experiments: Sequence[Experiment], horizon: int) -> np.ndarray:
    return np.concatenate([_kept(e.outputs, horizon) for e in experiments])


def _falls_over(run: NullObserver) -> bool:
    """Whether an error of the model left alone grows many times within the records."""
    modes = seen_modes(run, range(len(run.average.C)))
    return bool(np.any(modes.real > -slowest_decay(run.null.experiments)))


@dataclass(frozen=True)
class Innovations:
    """Of every stretch of unseen data, whitened as `run_null` does: (n_stretches, length, n_y), NaN where
    nothing was measured, and the logarithm of the density's scale."""

    white: np.ndarray
    log_scale: float


@dataclass(frozen=True)
class _Followed:
    """Experiments that an observer follows: the state (n_x,) that each begins with, and the errors one sample
    ahead of all stretches (n_stretches, length, n_y)."""

    run: NullObserver
    starts: tuple[np.ndarray, ...]
    errors: np.ndarray

    def misfit(self, root: np.ndarray) -> float:
        """Mean squared error, whitened with the `root` (n_y, n_y); inf without a measured value."""
        white = self.errors @ root.T
        count = int(np.isfinite(white).sum())
        return float(np.nansum(white**2)) / count if count else np.inf


def _best_followed(run: NullObserver, experiments: Sequence[Experiment]) -> _Followed | None:
    """By the observer, if it follows these data as it does those of its fit; else by the one that follows
    them best among it and those of the same model with louder loads; None where none can be integrated.

    A law that leaves no load has an observer that corrects nothing. Over data that the parameters were not
    fitted to, the smallest error of theirs adds up, in a motion that turns over to more than any law would
    explain. What is judged is the law: how well it foresees from a state that is known.
    """
    own = _followed(run, experiments)
    if own is not None and own.misfit(run.root) <= GATES.max_misfit:
        return own
    found = [own, *(_followed(one, experiments) for one in _louder(run))]
    return min((one for one in found if one is not None), key=lambda one: one.misfit(run.root), default=None)


def _followed(run: NullObserver, experiments: Sequence[Experiment]) -> _Followed | None:
    model = integrator(run.null.explicit)
    starts, errors = [], []
    for experiment in experiments:
        try:
            starts.append(best_start(run.null, model, experiment, run.gain, run.root))
            errors.append(_stretches(run, model, experiment, starts[-1], 1))
        except IntegrationError:
            return None
    return _Followed(run, tuple(starts), np.concatenate(errors))


def _louder(run: NullObserver) -> Iterator[NullObserver]:
    """Observers that correct the outputs by CORRECTED shares of their innovations, by louder loads."""
    null, std = run.null, np.sqrt(np.diag(np.linalg.inv(run.root.T @ run.root)))
    loads = {f"{load.name}.w" for load in null.loads}
    is_load = np.array([w.name in loads for w in null.flat.noises], dtype=bool)
    base = null.intensity if np.any(null.intensity[is_load] > 0.0) else np.where(is_load, 1.0, null.intensity)
    wanted = list(CORRECTED)
    for factor in LOUDER:
        intensity = np.where(is_load, np.maximum(factor * base, null.intensity), null.intensity)
        found = observer(run.average, intensity, std)
        corrected = 0.0 if found is None else float(np.max(np.diag(run.average.C @ found.gain)))
        if corrected < wanted[0]:
            continue
        wanted = [share for share in wanted if share > corrected]
        with suppress(DaestError, RuntimeError, np.linalg.LinAlgError):
            yield run_null(with_noise(null, intensity, std))
        if not wanted:
            return


def is_silent(told: Confirmed) -> bool:
    """Whether a law makes too little of a difference in unseen data to be told from its absence."""
    return told.expected < GATES.min_expected_gain and told.certainty > -GATES.likelier_significance


def is_likelier(told: Confirmed) -> bool:
    return told.certainty > GATES.likelier_significance


def _is_denied(told: Confirmed) -> bool:
    """Whether a law changes predictions of unseen data enough to tell, and these are no likelier for it:
    beside a level of its own in each recording it may simulate them better by chance."""
    return np.isfinite(told.expected) and not is_silent(told) and not is_likelier(told)


def innovations(run: NullObserver, experiments: Sequence[Experiment]) -> Innovations | None:
    """Prediction errors one sample ahead of the validation `experiments`; None where the observer `run`
    cannot be integrated there.

    Most of what a small law does to a measured value is far below the noise of that value; the likelihood of
    these adds up what it does to all of them."""
    followed = _best_followed(run, experiments)
    if followed is None:
        return None
    root = followed.run.root
    return Innovations(followed.errors @ root.T, float(np.log(np.diag(root)).sum()))


def confirmed(before: Innovations | None, after: Innovations | None) -> Confirmed:
    """The gain of `after` over `before`, and what it would be if `after` were right: half of the squared
    difference between the predictions."""
    if before is None or after is None or before.white.shape[0] < FEWEST_STRETCHES:
        return Confirmed()
    gain = _log_density(after) - _log_density(before)
    error = float(np.std(gain, ddof=1)) * float(np.sqrt(gain.size))
    total = float(np.sum(gain))
    expected = 0.5 * float(np.nansum((after.white - before.white) ** 2))
    return Confirmed(total, total / error if error > 0.0 else 0.0, expected)


def _log_density(found: Innovations) -> np.ndarray:
    """Of every stretch (n_stretches,)."""
    return np.nansum(found.log_scale - 0.5 * np.sum(found.white**2, axis=2), axis=1)


def compared(before: Foreseen | None, after: Foreseen | None, period: float) -> tuple[Ahead, ...]:
    """Both at every horizon; empty where one of them is unknown."""
    if before is None or after is None:
        return ()
    found = []
    for h, old in before.errors.items():
        if h not in after.errors:
            break
        without, with_effect, kept = _where_they_differ(old, after.errors[h], before.kept[h])
        if without.size < FEWEST_STRETCHES or not np.mean(without) > 0.0:
            continue
        gain = without - with_effect
        error = float(np.std(gain, ddof=1)) / np.sqrt(gain.size)
        found.append(
            Ahead(
                samples=h,
                seconds=h * period,
                ratio=float(np.sqrt(np.mean(with_effect) / np.mean(without))),
                certainty=float(np.mean(gain)) / error if error > 0.0 else 0.0,
                kept=float(np.sqrt(np.mean(kept) / np.mean(without))),
            )
        )
    return tuple(found)


def _where_they_differ(
    old: np.ndarray, new: np.ndarray, kept: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean squared errors (n,) of two models, and of values that are `kept`, over the stretches that hold
    GATES.acting_share of the squared difference between the models, which knows nothing of who is right.
    Every output counts alike."""
    with np.errstate(invalid="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a stretch without a measured value
        size = np.nanmean(old**2, axis=(0, 1))
        seen = size > 0.0
        parts = (old, new, kept, new - old)
        sizes = np.array([np.nanmean(one[:, :, seen] ** 2 / size[seen], axis=(1, 2)) for one in parts])
    a, b, still, apart = sizes[:, np.all(np.isfinite(sizes), axis=0)]
    order = np.argsort(-apart)
    share = np.cumsum(apart[order])
    n = int(np.searchsorted(share, GATES.acting_share * share[-1])) + 1 if share.size else 0
    chosen = order[: max(n, FEWEST_STRETCHES)]
    return a[chosen], b[chosen], still[chosen]


def is_worse(one: Ahead) -> bool:
    """Clearly, where the model without the effect foresees more than that nothing changes. A sensor that is
    quiet or coarse beside what moves in a sample is foreseen best by its last value: an observer that hangs
    on it is no machine."""
    return (
        one.kept > 1.0
        and one.ratio > 1.0 + GATES.same_unseen_error
        and one.certainty < -GATES.unseen_significance
    )


def is_better(one: Ahead) -> bool:
    return one.ratio < 1.0 - GATES.same_unseen_error and one.certainty > GATES.unseen_significance


def unconfirmed(explained: float, ahead: Sequence[Ahead], told: Confirmed) -> str:
    """Why a law that takes less than half of the load is not what is missing, though it says all that the
    load has to do with any variable: unseen data are foreseen clearly better over no horizon, and are no
    likelier. Empty where one of these speaks for it, or nothing is known of them."""
    little = unexplained(explained, ())
    if not little or not ahead or any(map(is_better, ahead)) or is_likelier(told):
        return ""
    return f"{little}, and unseen data are foreseen clearly better over no time"


def judged(
    ahead: Sequence[Ahead],
    before: FitResult,
    after: FitResult,
    adds_up: bool,
    told: Confirmed | None = None,
    steady: float | None = None,
    holding: Sequence[str] = (),
    clock: str = "s",
    drift: Mapping[str, float] | None = None,
) -> tuple[str, bool, bool]:
    """Why unseen data speak against the effect (empty where they do not), whether they speak clearly for it,
    and whether it does away with most of the error at some horizon. `adds_up` tells that the whole
    simulation is dead reckoning, which counts for an effect, not against it, unless the model did without
    it what the machine did and does so no longer; `told` is what their likelihood says, and `steady` the
    ratio of the errors of simulations in which every recording has a constant load of its own
    (`steady_misfit`), where it is smaller than that without, the law does not cost the simulation of its own
    recordings as much, and predictions of unseen data are known and their likelihood does not deny it.
    Errors of the outputs `holding` do not add up where others do: no effect may simulate one of them
    clearly worse, where the simulation stays near enough to what was measured for its initial states to
    be those of the machine. `clock` is what the model counts time in, `drift` the `foretold_drift` of the
    model with the law: a simulation that strays no further does not contradict it, as near as one without
    the law may have come by chance."""
    ratios = error_ratios(before.simulated, after.simulated)
    whole = _together(ratios)
    told = told or Confirmed()
    is_followed = bool(ahead) or np.isfinite(told.expected)
    is_excused = is_followed and not _is_denied(told) and not _costs_its_own(before, after)
    whole = min(whole, steady) if steady is not None and is_excused else whole
    if not ahead and not ratios:
        return "", True, False
    better = [one for one in ahead if is_better(one)]
    worse = [one for one in ahead if is_worse(one)]
    best = min([one.ratio for one in better], default=1.0)
    # An effect that changes no error matters to nobody, however likely it makes the data.
    shows = min([*(one.ratio for one in ahead), whole], default=1.0) < 1.0 - GATES.same_unseen_error
    speaks = is_silent(told) or (is_likelier(told) and shows)
    held = _ratios_of(before, after, holding) if adds_up else []
    # Beside an angle that drifts away the speed is simulated as well as ever, and tells as much.
    is_shown = min(whole, _together([ratio for ratio, _ in held] or [np.inf])) < GATES.max_clear_ratio
    is_clear = bool(better) or is_shown or speaks
    if worse:
        one = max(worse, key=lambda a: a.ratio)
        over = spoken_duration(one.seconds, clock)
        return f"unseen data are foreseen {one.ratio:.3g} times worse over {over}", False, False
    most = 1.0 + (GATES.max_simulated_loss if speaks else GATES.same_unseen_error)
    has_held = (
        whole > GATES.max_followed_ratio and _is_followed(before) and not _strays_as_foretold(after, drift)
    )
    if ratios and whole > most and not (adds_up and is_clear and not has_held):
        return f"{SIMULATED_WORSE} {whole:.3g} times worse", False, False
    lost = max(held, default=(0.0, ""))
    if lost[0] > 1.0 / GATES.max_clear_ratio and not _is_elsewhere(after):
        return f"the simulation of {lost[1]} of unseen data gets {lost[0]:.3g} times worse", False, False
    if not is_clear:
        return "unseen data are foreseen no better", False, False
    return "", True, min(best, whole if whole == whole else 1.0) < GATES.max_most_ratio


def foretold_drift(run: NullObserver, experiments: Sequence[Experiment]) -> dict[str, float]:
    """The error (rms) of a simulation of the longest experiment, by output, that the intensities of the
    model's own noises foretell where its initial states are known: their covariance along its average
    linearisation, dP/dt = A P + P A' + G Q G'. Empty where that is not finite."""
    null = run.null
    period = longest_duration(experiments) / DRIFT_STEPS
    std = np.sqrt(np.diag(np.linalg.inv(run.root.T @ run.root)))
    with np.errstate(over="ignore", invalid="ignore"):
        sampled = sampled_average(replace(run.average, period=period), null.intensity, std)
        cov, variances = np.zeros_like(sampled.process_cov), []
        for _ in range(DRIFT_STEPS):
            cov = sampled.transition @ cov @ turned(sampled.transition) + sampled.process_cov
            variances.append(np.diag(sampled.output @ cov @ turned(sampled.output)))
        found = np.sqrt(np.mean(variances, axis=0))
    return (
        dict(zip(null.flat.output_names, found.tolist(), strict=True)) if np.all(np.isfinite(found)) else {}
    )


def _strays_as_foretold(fit: FitResult, drift: Mapping[str, float] | None) -> bool:
    """Whether a simulation of unseen data is no further off, in any output, than its own noises make it."""
    unseen = fit.simulated.get("validation")
    if not drift or unseen is None:
        return False
    return all(
        error is not None and error <= GATES.max_foretold_ratio * drift[name]
        for name, error in unseen.rms.items()
    )


def _together(ratios: Sequence[float]) -> float:
    """One ratio of errors for those of all outputs; NaN without any."""
    return float(np.sqrt(np.mean(np.square(ratios)))) if ratios else np.nan


def _costs_its_own(before: FitResult, after: FitResult) -> bool:
    """Whether a law makes the simulation of the recordings that it was fitted to clearly worse: it does not
    take another level of the unseen ones for that. Loads that are constant in each recording do what the zero
    of any sensor does, and leave open which of several sensors is off."""
    return (
        _together(error_ratios(before.simulated, after.simulated, "estimation")) > 1.0 / GATES.max_clear_ratio
    )


def _ratios_of(before: FitResult, after: FitResult, names: Sequence[str]) -> list[tuple[float, str]]:
    """Errors of some outputs of simulated unseen data relative to what they were, where both are known, and
    their names."""
    old, new = (fit.simulated.get("validation") for fit in (before, after))
    if old is None or new is None:
        return []
    pairs = [(name, old.rms.get(name), new.rms.get(name)) for name in names]
    return [(b / a, name) for name, a, b in pairs if a and b is not None]


def _is_elsewhere(fit: FitResult) -> bool:
    """Whether a simulation of the unseen data is at other places than the machine: its initial states were
    bent to that."""
    unseen = fit.simulated.get("validation")
    percents = [] if unseen is None else list(unseen.fit_percent.values())
    return any(p is not None and p < 100.0 * (1.0 - GATES.free_runaway) for p in percents)


def _is_followed(fit: FitResult) -> bool:
    """Whether a simulation does nearly all that every output of the unseen data does."""
    return follows_all(fit.simulated, "validation", GATES.min_followed_fit)


def adds_up(run: NullObserver) -> bool:
    """Whether the outputs see a mode that keeps errors for longer than the records are: an angle that nothing
    holds, say. Where only the speed is measured, such an angle does nothing to the simulation."""
    return _keep_errors(run, range(len(run.average.C)))


def steady_outputs(run: NullObserver) -> tuple[str, ...]:
    """Names of the outputs that see no mode that keeps errors, whatever others see: the twist of a shaft that
    turns freely, say. What is simulated of them counts beside an angle that drifts away."""
    names = run.null.flat.output_names
    return tuple(name for row, name in enumerate(names) if not _keep_errors(run, [row]))


def _keep_errors(run: NullObserver, rows: Sequence[int]) -> bool:
    """Whether the outputs of these rows see a mode that keeps errors for longer than the records are."""
    return bool(np.any(seen_modes(run, rows).real > slowest_decay(run.null.experiments)))


def slowest_decay(experiments: Sequence[Experiment]) -> float:
    """The real part [1/s] above which a mode keeps errors for longer than the records are."""
    return -1.0 / (GATES.steady_duration * longest_duration(experiments))


def seen_modes(run: NullObserver, rows: Sequence[int]) -> np.ndarray:
    """Eigenvalues (n,) [1/s] of the model's own dynamics, without its loads, that the outputs of these rows
    see."""
    loads = {load.name for load in run.null.loads}
    own = [i for i, name in enumerate(run.state_names) if name not in loads]
    if not own:
        return np.zeros(0)
    return np.linalg.eigvals(
        _seen_dynamics(run.average.A[np.ix_(own, own)], run.average.C[np.ix_(rows, own)])
    )


def _seen_dynamics(A: np.ndarray, C: np.ndarray) -> np.ndarray:
    """A (n, n) on the smallest invariant subspace that outputs C (n_y, n) see, by Arnoldi's recursion."""
    basis: list[np.ndarray] = []
    waiting = list(C)
    while waiting and len(basis) < A.shape[0]:
        row = waiting.pop(0)
        size = np.linalg.norm(row)
        for _ in range(2):  # once more against rounding
            for known in basis:
                row = row - (known @ row) * known
        rest = np.linalg.norm(row)
        if rest > UNSEEN * size:
            basis.append(row / rest)
            waiting.append(basis[-1] @ A)
    q = np.array(basis).reshape(len(basis), A.shape[0])
    return q @ A @ q.T


def _stretches(
    run: NullObserver, model: Integrator, experiment: Experiment, x0: np.ndarray, horizon: int
) -> np.ndarray:
    """Errors (n_stretches, length, n_y) over `horizon` samples without the data, between stretches in which
    the observer follows them."""
    is_left = _left_alone(experiment.n_samples, horizon)
    gains = np.broadcast_to(run.gain, (is_left.size, *run.gain.shape))
    if horizon > 1:
        gains = np.where(is_left[:, None, None], 0.0, gains)
    made = integrate(
        model, experiment.time, experiment.inputs, run.null.theta, x0, hold=run.null.hold,
        correction=Correction(experiment.outputs, np.ascontiguousarray(gains)),
        rtol=RTOL, atol_of_scale=ATOL_OF_SCALE, state_scale=run.sizes,
    )  # fmt: skip
    return _in_stretches(experiment.outputs - made.outputs, horizon)


def _kept(y: np.ndarray, horizon: int) -> np.ndarray:
    """Errors (n_stretches, length, n_y) of outputs (n, n_y) that stay over a stretch what was measured last
    before it; NaN before the first value."""
    is_left = _left_alone(len(y), horizon)
    told = np.isfinite(y) & (~is_left[:, None] if horizon > 1 else True)
    last = np.maximum.accumulate(np.where(told, np.arange(len(y))[:, None], -1))
    last = np.vstack([np.full((1, y.shape[1]), -1), last[:-1]])
    return _in_stretches(y - np.where(last < 0, np.nan, np.take_along_axis(y, last, 0)), horizon)


def _left_alone(n: int, horizon: int) -> np.ndarray:
    """The samples (n,) over which nothing corrects an observer that takes up between them."""
    follows = TAKES_UP if horizon > 1 else 0
    return np.arange(n) % (follows + horizon) >= follows


def _in_stretches(errors: np.ndarray, horizon: int) -> np.ndarray:
    """The errors (n, n_y) of the samples left alone as (n_stretches, length, n_y), without the first stretch,
    in which the observer settles. A recording that is shorter than a stretch is one, filled up with NaN."""
    round_length = (TAKES_UP if horizon > 1 else 0) + horizon
    if horizon == 1:  # in batches, so that a stretch is a stretch
        round_length = TAKES_UP
    missing = max(round_length - len(errors), 0)
    errors = np.pad(errors, ((0, missing), (0, 0)), constant_values=np.nan)
    n, is_left = len(errors), _left_alone(len(errors), horizon)
    first = round_length if n > 4 * round_length else 0
    starts = range(first, n - round_length + 1, round_length)
    parts = [errors[a : a + round_length][is_left[a : a + round_length]] for a in starts]
    return np.array(parts).reshape(len(parts), int(is_left[:round_length].sum()), errors.shape[1])
