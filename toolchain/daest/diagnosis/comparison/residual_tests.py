"""Tests of one-step errors against what they should be: white, independent of what drives the model, of the
predicted size.

All tests of a model share one level, by Holm's procedure (S. Holm, Scandinavian Journal of Statistics 6,
1979); where the tables break (short records, many lags) the share of the level that each test gets is read
off a bootstrap.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from daest.diagnosis.gates import GATES
from daest.model.comparison import ResidualTest
from daest.numerics.statistics import autoregression, chi2, ljung_box, norm, weighted_past

WHITENESS_LAGS = 30  # at most; fewer where the record is short
SAMPLES_PER_LAG = 10
INPUT_LAGS = (0, 1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)  # samples
FEEDBACK_LAGS = 10
VARIABLE_LAGS = (0, 4)  # samples after the prediction of the variable
MOST_VARIABLES = 6
SHORTEST = 20  # observed samples below which nothing is tested


@dataclass(frozen=True)
class Sequences:
    """All recordings one after the other, with a gap between them that no lag crosses.

    `residuals` (n, n_y) are one-step errors over their predicted standard deviation, zero where not
    `observed`. `inputs` (n, n_u) and `variables` (n, n_v), predicted before the sample, are zero in the
    gaps. `within` (n,) is False there. `slopes` (p, n, n_y) of the residuals over parameters with covariance
    `parameter_cov` (p, p). `acts_at_once`: inputs move outputs of the same sample. `n_estimation` samples
    gave the noise levels; None: they are exact. `known_noise` (n_y,): levels not read off these very
    residuals.
    """

    residuals: np.ndarray
    observed: np.ndarray
    inputs: np.ndarray
    variables: np.ndarray
    within: np.ndarray
    slopes: np.ndarray
    parameter_cov: np.ndarray
    acts_at_once: bool
    n_estimation: int | None
    known_noise: np.ndarray


@dataclass(frozen=True)
class RawTest:
    """A statistic, its p-value from the tables, and the acceptance band (low, high) at any level; a band of
    two sides is one around 1."""

    statistic: float
    p_value: float
    band: Callable[[float], tuple[float, float]]
    two_sided: bool = False


Raw = Mapping[str, Mapping[str, RawTest]]  # by test and output


def joined(
    residuals: Sequence[np.ndarray],
    inputs: Sequence[np.ndarray],
    variables: Sequence[np.ndarray],
    slopes: Sequence[np.ndarray],
    parameter_cov: np.ndarray | None,
    *,
    acts_at_once: bool,
    n_estimation: int | None,
    known_noise: np.ndarray,
) -> Sequences:
    """One array per recording (n_samples, …), residuals NaN where missing. Inputs are centred, variables
    divided by their rms."""
    gap = max(*INPUT_LAGS, *VARIABLE_LAGS, WHITENESS_LAGS)
    whole = _with_gaps(residuals, gap, np.nan)
    p = len(slopes[0]) if slopes and parameter_cov is not None else 0
    by_sample = [np.moveaxis(s, 0, -1).reshape(s.shape[1], -1) for s in slopes] if p else []
    stacked = _with_gaps(by_sample, gap, 0.0) if p else np.zeros((len(whole), 0))
    return Sequences(
        residuals=np.nan_to_num(whole),
        observed=np.isfinite(whole),
        inputs=_with_gaps([_centred(u) for u in inputs], gap, 0.0),
        variables=_standardised(_with_gaps(variables, gap, 0.0)),
        within=_with_gaps([np.ones((len(r), 1)) for r in residuals], gap, 0.0)[:, 0] > 0.0,
        slopes=np.moveaxis(stacked.reshape(len(whole), whole.shape[1], p), -1, 0),
        parameter_cov=np.zeros((0, 0)) if parameter_cov is None or not p else parameter_cov,
        acts_at_once=acts_at_once,
        n_estimation=n_estimation,
        known_noise=known_noise,
    )


def residual_tests(sequences: Sequences, names: Sequence[str]) -> tuple[Raw, dict[str, RawTest]]:
    """(tests by name and output, feedback by output); outputs with fewer than SHORTEST values are left out.

    whiteness: Ljung-Box. input_independence: correlation with past inputs. variable_independence: with the
    model's own predicted variables, their squares and signs, and their mean. nis: mean of the squared
    residuals. feedback: correlation with those parts of future inputs that past inputs do not tell. It is a
    closed-loop record's mark, no error of the model.
    """
    tests: dict[str, dict[str, RawTest]] = {
        "whiteness": {}, "input_independence": {}, "variable_independence": {}, "nis": {}
    }  # fmt: skip
    feedback = {}
    for j, name in enumerate(names):
        if sequences.observed[:, j].sum() < SHORTEST:
            continue
        returned = _feedback(sequences, j)
        if returned is not None:
            feedback[name] = returned
        is_closed = returned is not None and returned.p_value < GATES.residual_level
        tests["whiteness"][name] = _whiteness(sequences, j)
        past = _past_inputs(sequences, first=1 if is_closed or not sequences.acts_at_once else 0)
        features = _variable_features(sequences, first=1 if is_closed else 0)
        for kind, regressors in (("input", past), ("variable", features)):
            found = _independence(sequences, j, regressors)
            if found is not None:
                tests[f"{kind}_independence"][name] = found
        if sequences.known_noise[j]:
            tests["nis"][name] = _nis(sequences, j)
    return tests, feedback


def judged(raw: Raw, level: float | None = None) -> dict[str, dict[str, ResidualTest]]:
    """Tests with limits: by Holm's procedure over all, or every test at `level` (from a bootstrap)."""
    p_values = sorted(test.p_value for by_output in raw.values() for test in by_output.values())
    if level is None and p_values:
        rejected = 0
        while rejected < len(p_values) and p_values[rejected] < GATES.residual_level / (
            len(p_values) - rejected
        ):
            rejected += 1
        # What is rejected stays so at the level of the first test that is not.
        level = GATES.residual_level / max(len(p_values) - rejected, 1)
    return {
        kind: {name: with_limit(test, level or GATES.residual_level) for name, test in by_output.items()}
        for kind, by_output in raw.items()
    }


def with_limit(test: RawTest, level: float) -> ResidualTest:
    low, high = test.band(level)
    return ResidualTest(
        statistic=test.statistic,
        limit=high if not test.two_sided or test.statistic >= 1.0 else low,
        p_value=test.p_value,
        passed=bool(low <= test.statistic <= high),
        band=(low, high) if test.two_sided else None,
    )


def _whiteness(sequences: Sequences, j: int) -> RawTest:
    observed = sequences.observed[:, j]
    lags = int(np.clip(observed.sum() // SAMPLES_PER_LAG, 1, WHITENESS_LAGS))
    return _chi_square(ljung_box(sequences.residuals[:, j], observed, lags), lags)


def _nis(sequences: Sequences, j: int) -> RawTest:
    """Mean of the squares; its variance allows for correlation among them and for estimated levels."""
    observed = sequences.observed[:, j]
    squares = sequences.residuals[observed, j] ** 2
    mean, n = float(squares.mean()), squares.size
    A, cov = autoregression((squares - mean)[:, None])
    # Spectrum at zero of the autoregression; 2 for independent Gaussian residuals.
    variance = max(2.0, float(cov[0, 0] / (1.0 - A.sum()) ** 2))
    estimated = 0.0 if sequences.n_estimation is None else n / sequences.n_estimation
    std = float(np.sqrt(variance / n * (1.0 + estimated)))
    p_value = float(2.0 * norm.sf(abs(mean - 1.0) / std))
    return RawTest(mean, p_value, lambda level: _around_one(std * float(norm.isf(level / 2))), True)


def _around_one(width: float) -> tuple[float, float]:
    """1 ± width, as far as a mean of squares can go."""
    return max(1.0 - width, 0.0), 1.0 + width


def _independence(sequences: Sequences, j: int, regressors: np.ndarray) -> RawTest | None:
    """g = Σ φ[k] e[k] over predetermined φ (q, n): gᵀ cov(g)⁻¹ g is chi-square.

    Residuals that are not white are whitened by their own autoregression, and φ with them. cov(g) includes
    what the uncertainty of the parameters does to the residuals.
    """
    seen = sequences.observed[:, j]
    e = sequences.residuals[:, j]
    phi = regressors * seen
    size = np.sqrt(np.mean(phi**2, axis=1))
    phi = phi[size > 0.0] / size[size > 0.0, None]
    phi = phi[: max(int(GATES.max_regressors * seen.sum()), 1)]
    if not phi.size or not np.any(e):
        return None
    A, cov = autoregression(e[:, None])
    whitener = np.concatenate([[1.0], -A[:, 0, 0]])
    e, phi = weighted_past(whitener, e), weighted_past(whitener, phi)
    variance = phi @ phi.T * float(cov[0, 0])
    if sequences.parameter_cov.size:
        moved = phi @ weighted_past(whitener, sequences.slopes[:, :, j] * seen).T
        variance = variance + moved @ sequences.parameter_cov @ moved.T
    return _quadratic(phi @ e, variance)


def _quadratic(g: np.ndarray, variance: np.ndarray) -> RawTest | None:
    size = np.sqrt(np.diagonal(variance))
    kept = size > 0.0
    if not kept.any():
        return None
    g, size = g[kept] / size[kept], size[kept]
    values, vectors = np.linalg.eigh(variance[np.ix_(kept, kept)] / np.outer(size, size))
    used = values > GATES.test_rank * values[-1]
    return _chi_square(float(np.sum((vectors[:, used].T @ g) ** 2 / values[used])), int(used.sum()))


def _chi_square(statistic: float, degrees: int) -> RawTest:
    return RawTest(
        statistic, float(chi2.sf(statistic, degrees)), lambda level: (0.0, float(chi2.isf(level, degrees)))
    )


def _past_inputs(sequences: Sequences, first: int) -> np.ndarray:
    """Inputs of `first` and more samples before, (q, n)."""
    lags = [lag for lag in INPUT_LAGS if lag >= first]
    return _rows([_lagged(u, lag, sequences.within) for lag in lags for u in sequences.inputs.T], sequences)


def _variable_features(sequences: Sequences, first: int) -> np.ndarray:
    """A constant, and every variable with its square and sign, of predictions `first` and more samples
    before, (q, n). In closed loop, what an input of the same sample moves knows the error of that sample."""
    rows = [sequences.within.astype(float)]
    lags = [max(lag, first) for lag in VARIABLE_LAGS]
    for v in sequences.variables.T[:MOST_VARIABLES]:
        for feature in (v, v**2 - 1.0, np.sign(v)):
            rows += [_lagged(feature * sequences.within, lag, sequences.within) for lag in lags]
    return _rows(rows, sequences)


def _feedback(sequences: Sequences, j: int) -> RawTest | None:
    first = 1 if sequences.acts_at_once else 0
    future = [
        _lagged(u, -lag, sequences.within) for lag in range(first, FEEDBACK_LAGS) for u in sequences.inputs.T
    ]
    past = _past_inputs(sequences, first=1)
    rows = _rows(future, sequences)
    if not rows.size:
        return None
    size = np.sqrt(np.mean(rows**2, axis=1))
    told = np.linalg.lstsq(past.T, rows.T, rcond=None)[0].T @ past
    news = rows - told
    # What is left of an input that its own past tells completely is rounding.
    is_new = np.sqrt(np.mean(news**2, axis=1)) > np.sqrt(GATES.test_rank) * size
    return _independence(sequences, j, news[is_new]) if is_new.any() else None


def _rows(rows: list[np.ndarray], sequences: Sequences) -> np.ndarray:
    return np.array(rows) if rows else np.zeros((0, sequences.within.size))


def _lagged(row: np.ndarray, lag: int, within: np.ndarray) -> np.ndarray:
    """row[k - lag] at k, zero where that is not in the same recording."""
    if lag == 0:
        return row
    result = np.zeros_like(row)
    if lag > 0:
        result[lag:] = row[:-lag]
    else:
        result[:lag] = row[-lag:]
    return result * within


def _with_gaps(parts: Sequence[np.ndarray], gap: int, value: float) -> np.ndarray:
    spacer = np.full((gap, parts[0].shape[1]), value)
    pieces = [piece for part in parts for piece in (part, spacer)]
    return np.concatenate(pieces[:-1])


def _centred(columns: np.ndarray) -> np.ndarray:
    """Columns less their means; a constant is exactly zero, where its mean leaves rounding."""
    moves = np.ptp(columns, axis=0) > 0.0
    return (columns - columns.mean(axis=0)) * moves


def _standardised(columns: np.ndarray) -> np.ndarray:
    """Columns over their rms; zeros stay, and their sign keeps its meaning."""
    size = np.sqrt(np.mean(columns**2, axis=0))
    return columns / np.where(size > 0.0, size, 1.0)
