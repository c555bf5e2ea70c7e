"""What a simulation leaves of a recording, of any colour: the residual is whitened by an autoregression, and
candidates are scored, refitted, refused and told from their rivals by it. The verdict is told by the rules of
every diagnosis (`verdict.decide`)."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from daest.diagnosis.answers.decided import Decided, Evidence, foreseen_by
from daest.diagnosis.answers.verdict import decide
from daest.diagnosis.gates import GATES
from daest.diagnosis.options import REFIT_SECONDS, DiagnoseOptions, Progress
from daest.diagnosis.refits.stages import TIME_IS_UP
from daest.diagnosis.screening.scores import projected, scored
from daest.errors import DaestError, EstimationError
from daest.estimation.identify import identify
from daest.model.diagnosis import Candidate, Diagnosis, Proof, Screen, Screened, Unproved
from daest.model.experiment import Experiment
from daest.model.fit import FitResult, FittedParameter, IdentifyOptions, error_ratios
from daest.model.flat import Model
from daest.numerics.parallel import done_by, workers
from daest.numerics.statistics import chi2, ljung_box
from daest.systems.events.integration import IntegrationError

MOST_ORDER = 8  # of the autoregression that whitens the residual
WHITE_LAGS = 20
SHARES = (1.0, 0.3, 0.0)  # of the size that one step from the null gives, where a refit starts


def screened(
    candidates: Sequence[Candidate],
    slopes: Sequence[np.ndarray],
    responses: Sequence[Sequence[Sequence[np.ndarray]]],
    residuals: Sequence[np.ndarray],
    seed: int,
    skipped: tuple[tuple[str, str], ...] = (),
) -> Screen:
    """Candidates scored on the whitened residual beyond the parameters, each with the share of the residual
    that it would explain as it is.

    Per recording: slopes (d, n, n_y) of the simulation along parameters and initial states, residuals (n,
    n_y); `responses` of each candidate, to each of its sizes, per recording (n, n_y).
    """
    filters = autoregression(residuals)
    spread = spreads(residuals, filters)
    weight = weights(residuals, spread)
    directions = [[table[k] for table in slopes] for k in range(slopes[0].shape[0])]
    flat = [one for candidate in responses for one in candidate]
    ends = np.cumsum([0, *(len(candidate) for candidate in responses)]).tolist()
    rows = [slice(a, b) for a, b in pairwise(ends)]

    def whitened(tables: Sequence[Sequence[np.ndarray]]) -> np.ndarray:
        return finite([white(one, filters) * weight for one in tables])

    def plain(tables: Sequence[Sequence[np.ndarray]]) -> np.ndarray:
        return finite([np.concatenate([(part / spread).ravel() for part in one]) for one in tables])

    base, least = whitened(directions), float(np.sqrt(GATES.fmu_absorbed_share))
    screen = scored(
        candidates, rows, whitened([residuals])[0], base, base, whitened(flat), skipped, seed, least
    )
    own = shares(plain(flat), plain([residuals]), plain(directions))
    known = {id(c): float(np.max(own[r], initial=0.0)) for c, r in zip(candidates, rows, strict=True)}
    entries = tuple(replace(entry, share=known[id(entry.candidate)]) for entry in screen.entries)
    return replace(screen, entries=entries)


def worth_a_refit(entries: Sequence[Screened], most: int) -> list[Screened]:
    """The best by score if any is significant, since one step from the null ranks like laws badly; and those
    that would explain most of the residual as it is, which a filter for its colour would take for colour."""
    found = [entry for entry in entries if not entry.absorbed]
    by_score = found[:most] if found and found[0].p_value < GATES.fmu_level else []
    slow = [entry for entry in found if (entry.share or 0.0) >= GATES.fmu_min_share]
    by_share = sorted(slow, key=lambda entry: -(entry.share or 0.0))[:most]
    return [*by_score, *(entry for entry in by_share if not any(entry is other for other in by_score))]


def refusal(
    gain: float,
    size: FittedParameter,
    validation_gain: float,
    share: float,
    n_values: int,
    n_trials: int,
) -> str:
    """Why an effect is not accepted, empty if it is. gain: of log-likelihood; validation_gain: relative fall
    of the error on validation data; share: what it leaves of what could be foreseen of the residual."""
    most = GATES.fmu_max_foreseen
    if 2 * gain <= np.log(n_values) + 2 * np.log(n_trials):
        return "it gains no more likelihood than chance would in such a search"
    if size.std_error is None or abs(size.value) < GATES.fmu_min_significance * size.std_error:
        return "its size cannot be told from zero"
    if validation_gain <= GATES.fmu_min_validation_gain:
        return "it does not lower the error on validation data"
    if share > most:
        return f"it leaves {share:.0%} of what can be foreseen of the residual, more than {most:.0%}"
    return ""


def refuse_gaps(experiments: Sequence[Experiment], what: str) -> None:
    """Raises EstimationError `diagnose-gaps`; `what` is the model, in words."""
    for experiment in experiments:
        if not np.all(np.isfinite(experiment.outputs)):
            raise EstimationError(
                "diagnose-gaps",
                f"{experiment.name} has missing samples, and the residual of {what} is whitened in time",
                remedy="choose a part without gaps (--from, --to), or resample it",
            )


def autoregression(residuals: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Coefficients of the whitening filter of every output, order by BIC. Shapes: residuals (n, n_y) per
    recording; a filter (order + 1,) per output."""
    filters = []
    for j in range(residuals[0].shape[1]):
        best: tuple[float, np.ndarray] | None = None
        for order in range(MOST_ORDER + 1):
            rows = [lagged(e[:, j], order) for e in residuals if e.shape[0] > 4 * MOST_ORDER]
            if not rows:
                break
            X, y = np.vstack([r[0] for r in rows]), np.concatenate([r[1] for r in rows])
            a = np.linalg.lstsq(X, y, rcond=None)[0] if order else np.zeros(0)
            variance = float(np.mean((y - X @ a) ** 2)) + np.finfo(float).tiny
            bic = y.size * np.log(variance) + order * np.log(y.size)
            if best is None or bic < best[0]:
                best = (bic, np.concatenate([[1.0], -a]))
        filters.append(np.ones(1) if best is None else best[1])
    return filters


def lagged(e: np.ndarray, order: int) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the last `order` values before each sample from MOST_ORDER on, and these samples. Shapes: e
    (n,); rows (n - MOST_ORDER, order), samples (n - MOST_ORDER,)."""
    columns = [e[MOST_ORDER - k : e.size - k] for k in range(1, order + 1)]
    X = np.column_stack(columns) if columns else np.zeros((e.size - MOST_ORDER, 0))
    return X, e[MOST_ORDER:]


def white(tables: Sequence[np.ndarray], filters: Sequence[np.ndarray]) -> np.ndarray:
    """All recordings and outputs whitened, one after the other, (m,)."""
    parts = []
    for table in tables:
        for j, taps in enumerate(filters):
            parts.append(np.convolve(table[:, j], taps)[: table.shape[0]][MOST_ORDER:])
    return np.concatenate(parts)


def finite(rows: Sequence[np.ndarray]) -> np.ndarray:
    """Rows (k, m); one that is not finite everywhere is zero."""
    table = np.array(rows).reshape(len(rows), -1)
    return np.where(np.all(np.isfinite(table), axis=1, keepdims=True), table, 0.0)


def shares(responses: np.ndarray, residual: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Shares of the squared residual (1, m) that responses (k, m) explain beyond the parameters, (k,)."""
    own, left = projected(responses, directions)[0], projected(residual, directions)[0][0]
    sizes = np.sum(own**2, axis=1) * float(left @ left)
    return np.where(sizes > 0.0, (own @ left) ** 2 / np.where(sizes > 0.0, sizes, 1.0), 0.0)


def spreads(residuals: Sequence[np.ndarray], filters: Sequence[np.ndarray]) -> np.ndarray:
    """Standard deviations of the whitened residual of every output, (n_y,)."""
    found = [
        np.std(np.concatenate([np.convolve(e[:, j], taps)[: e.shape[0]][MOST_ORDER:] for e in residuals]))
        for j, taps in enumerate(filters)
    ]
    return np.array([s or 1.0 for s in found])


def weights(residuals: Sequence[np.ndarray], spreads: np.ndarray) -> np.ndarray:
    """1 / standard deviation of the whitened residual of every output, in the order of `white`. Shapes:
    residuals (n, n_y) per recording, spreads (n_y,)."""
    parts = [np.full(e.shape[0] - MOST_ORDER, 1.0 / s) for e in residuals for s in spreads]
    return np.concatenate(parts)


def log_likelihood(errors: Sequence[np.ndarray]) -> float:
    """Gaussian, of the innovations of the autoregression of the errors, up to a constant. Shapes: errors
    (n, n_y) per recording."""
    total = 0.0
    for j, taps in enumerate(autoregression(errors)):
        white = np.concatenate([np.convolve(e[:, j], taps)[: e.shape[0]][MOST_ORDER:] for e in errors])
        total -= 0.5 * white.size * np.log(np.mean(white**2) + np.finfo(float).tiny)
    return float(total)


def foreseen(errors: Sequence[np.ndarray], others: Sequence[np.ndarray]) -> float:
    """How much of the residual could be foreseen from its own past: its mean square beyond that of the
    innovations, in units of the latter, over all outputs. As innovations counts the smaller of both.
    Shapes: errors and others (n, n_y) per recording."""
    floors = [spreads(some, autoregression(some)) ** 2 for some in (errors, others)]
    squares = np.mean(np.concatenate(errors) ** 2, axis=0)
    return float(np.sum(np.maximum(squares / np.minimum(*floors) - 1.0, 0.0)))


def beside_starts(sensitivities: np.ndarray, n_parameters: int, number: int, n_recordings: int) -> np.ndarray:
    """∂ŷ/∂(parameters, initial states of all recordings), (d, n, n_y), of recording `number`, whose
    `sensitivities` (n, n_y, n_parameters + n_x) are those along the parameters and its own initial states."""
    own = sensitivities.transpose(2, 0, 1)
    n_x = own.shape[0] - n_parameters
    table = np.zeros((n_parameters + n_x * n_recordings, *own.shape[1:]))
    table[:n_parameters] = own[:n_parameters]
    at = n_parameters + number * n_x
    table[at : at + n_x] = own[n_parameters:]
    return table


def fitted_null(
    flat: Model,
    quiet: Model,
    estimation: Sequence[Experiment],
    validation: Sequence[Experiment],
    options: DiagnoseOptions,
    step: str,
) -> FitResult:
    """The fit of the model as it is, `quiet` without its noises, by its simulation; kept as `step`. Raises
    what identification raises."""
    fitting = IdentifyOptions(
        method="oe", hold=options.hold, seed=options.seed, jobs=options.jobs, cluster=options.cluster
    )
    return options.step(step, (), flat, lambda: identify(quiet, estimation, fitting, validation))


@dataclass(frozen=True)
class Leader:
    """An entry of the screen that is worth a refit, and the other places at which it does the same."""

    entry: Screened
    alike: tuple[str, ...] = ()

    @property
    def label(self) -> str:
        return self.entry.candidate.label


def refitted(
    proof: Callable[[Leader], Proof],
    leaders: Sequence[Leader],
    flat: Model,
    baseline: FitResult,
    options: DiagnoseOptions,
    progress: Progress,
    step: str,
) -> tuple[tuple[Proof, ...], tuple[Unproved, ...]]:
    """The proofs of the leaders, in several processes, each now or of an earlier run as `step`; and the
    leaders with which the model could not be refitted, or was not for want of time."""
    for leader in leaders:
        progress(f"refitting with {leader.label}")
    work, seconds = partial(_kept, proof, flat, options, step), REFIT_SECONDS * baseline.seconds
    with workers(options.jobs, options.cluster) as pool:
        outcomes = done_by(pool, work, leaders, options.until, seconds=seconds)
    proofs: list[Proof] = []
    failed: list[Unproved] = []
    for number, leader in enumerate(leaders):
        outcome = outcomes.get(number)
        if outcome is None:
            failed.append(replace(_unproved(leader), reason=TIME_IS_UP, is_late=True))
        elif isinstance(outcome.error, IntegrationError | DaestError):
            failed.append(_unproved(leader))
        else:
            proofs.append(outcome.get())
    return tuple(proofs), tuple(failed)


def _kept(
    proof: Callable[[Leader], Proof], flat: Model, options: DiagnoseOptions, step: str, leader: Leader
) -> Proof:
    return options.step(step, (leader.label,), flat, lambda: proof(leader))


def _unproved(leader: Leader) -> Unproved:
    entry, reason = leader.entry, "the model could not be refitted with it"
    return Unproved(entry.candidate, leader.alike, entry.score, entry.p_value, entry.sizes, reason, True)


def judged(
    leader: Leader,
    flat: Model,
    fit: FitResult,
    baseline: FitResult,
    errors: Sequence[np.ndarray],
    residuals: Sequence[np.ndarray],
    n_trials: int,
) -> Proof:
    """The proof of a leader whose `fit` leaves `errors` (n, n_y) per recording where the model as it is, by
    `baseline`, leaves `residuals`; `n_trials` candidates were screened."""
    candidate = leader.entry.candidate
    n_sizes, n = len(leader.entry.sizes), sum(e.size for e in errors)
    gain = log_likelihood(errors) - log_likelihood(residuals)
    better = _validation_gain(baseline, fit)
    share = foreseen(errors, residuals) / (foreseen(residuals, errors) or 1.0)
    first = f"{candidate.name}.{candidate.effect.sizes[0].name}"
    size = next(p for p in fit.parameters if p.name == first)
    reason = refusal(gain, size, better, share, n, n_trials)
    return Proof(
        candidate=candidate,
        flat=flat,
        fit=fit,
        delta_log_likelihood=gain,
        delta_bic=2 * gain - n_sizes * float(np.log(n)),
        p_value=leader.entry.p_value,
        explained=max(0.0, better),
        equivalent=leader.alike,
        not_separable_from=(),
        verdict="rejected" if reason else "supported",
        reason=reason,
    )


def _validation_gain(before: FitResult, after: FitResult) -> float:
    """Mean over the outputs of the relative fall of the simulation error on unseen data."""
    falls = [1.0 - ratio for ratio in error_ratios(before.simulated, after.simulated)]
    return float(np.mean(falls)) if falls else 0.0


@dataclass(frozen=True)
class Residual:
    """The rest where a simulation leaves a residual of any colour. `is_noise` tells whether it is white, or
    that of declared noise; `what` is the model, in words."""

    is_noise: Callable[[], bool]
    what: str = "model"

    def is_explained(self, _evidence: Evidence) -> bool:
        return self.is_noise()

    def verdict(self, evidence: Evidence) -> Decided:
        return Decided(
            "external disturbance",
            "The residual is coloured, and no law that was tried explains it: a load from outside, or "
            f"something else inside the {self.what}." + foreseen_by(evidence, None),
            "Measure what may act on the plant, and add the column to the recording.",
        )


def diagnosis_of(evidence: Evidence, baseline: FitResult, remarks: str, began: float) -> Diagnosis:
    """The diagnosis of a model whose loads are not modelled; `remarks` follow the message, `began` is when it
    began by the clock `time.perf_counter`."""
    decided = decide(replace(evidence, proofs=_told_apart(evidence.proofs)))
    return Diagnosis(
        verdict=decided.name,
        message=f"{decided.message} {remarks}".rstrip(),
        baseline=baseline,
        proofs=decided.proofs,
        unproved=evidence.unproved,
        screen=evidence.screen,
        places=(),
        disturbance=None,
        validation=baseline.simulated.get("validation"),
        next_experiment=decided.next_experiment,
        seconds=time.perf_counter() - began,
        has_loads=False,
    )


def _told_apart(proofs: Sequence[Proof]) -> tuple[Proof, ...]:
    """The proofs, best first, those that are supported told from the best of them."""
    ranked = sorted(proofs, key=lambda p: -p.delta_log_likelihood)
    supported = [p for p in ranked if p.verdict == "supported"]
    if not supported:
        return tuple(ranked)
    best, least = supported[0], supported[0].delta_log_likelihood - GATES.fmu_same_log_likelihood
    close = [p for p in supported if p.delta_log_likelihood > least]
    return tuple(_beside_the_best(p, best, close) if p.verdict == "supported" else p for p in ranked)


def _beside_the_best(proof: Proof, best: Proof, close: Sequence[Proof]) -> Proof:
    """A supported proof beside those that are as good as the best."""
    if not any(proof is one for one in close):
        behind = best.delta_log_likelihood - proof.delta_log_likelihood
        reason = f"{best.candidate.label} explains more: {behind:.1f} log-likelihood units"
        return replace(proof, verdict="rejected", reason=reason)
    if len(close) == 1:
        return proof
    others = tuple(p.candidate.label for p in close if p is not proof)
    return replace(proof, verdict="not separable", not_separable_from=others)


def is_white(residuals: Sequence[np.ndarray]) -> bool:
    """Ljung-Box of every output, all together at GATES.fmu_level. Shapes: residuals (n, n_y) per
    recording."""
    long = [e - e.mean(axis=0) for e in residuals if e.shape[0] > 2 * WHITE_LAGS]
    p_values = [1.0]
    for j in range(residuals[0].shape[1]):
        moving = [e[:, j] for e in long if np.any(e[:, j])]
        q = sum(ljung_box(x, np.ones(x.size, dtype=bool), WHITE_LAGS) for x in moving)
        p_values.append(float(chi2.sf(q, WHITE_LAGS * len(moving))) if moving else 1.0)
    return min(p_values) >= GATES.fmu_level / (len(p_values) - 1)
