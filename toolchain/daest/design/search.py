"""The best input of every family within the limits, and the free input that a gradient makes of them."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import csr_matrix, diags, vstack

from daest.design.aims import Aim
from daest.design.safety import Guard
from daest.design.signals import FAMILIES, KEEPS_LOWEST, SMALLER, Shape, with_piece, within
from daest.model.design import Limits, Played

FREE = "free"
MOST_ROUNDS = 40  # of the gradient search
LEAST_GAIN = 1e-3  # of the merit, relative, in a round: less ends it
KNOTS = 24  # of a free input where the gradient is not known
PROBED = 0.02  # of the range of an input, by which a knot is moved to find its slope
LONGEST_PIECE = 8  # pieces of that part of the length are exchanged, and shorter ones
MOST_FAILED = 200  # exchanges in turn that help nothing: the last ones
SHORTEST = 1e-3  # share of a step that is still tried
SHARE_OF_FAMILIES = 0.6  # of the time budget
FAMILY_OF_FORM = ("multisine", "chirp")


@dataclass(frozen=True)
class Budget:
    """Until when a search may go on, by the clock of the process."""

    ends: float

    @property
    def is_over(self) -> bool:
        return time.perf_counter() >= self.ends

    def half(self) -> Budget:
        """Of the time that is left."""
        now = time.perf_counter()
        return Budget(now + 0.5 * (self.ends - now))


def best_of_families(aim: Aim, limits: Limits, guard: Guard, seed: int, budget: Budget) -> list[Played]:
    """One entry per family, best first; those that cannot keep the limits last, with the reason."""
    queues = {name: _tried(name, limits, seed) for name in FAMILIES}
    best: dict[str, tuple[float, str, np.ndarray]] = {}
    refused: dict[str, str] = {}
    while queues:
        for name in list(queues):
            entry = next(queues[name], None)
            if entry is None or (budget.is_over and name in best):
                del queues[name]
                continue
            shape, inputs = entry
            safe = guard.kept_safe(inputs, limits)
            if safe is None:
                refused[name] = "leaves the safe range at any amplitude"
                continue
            merit = aim.merit(safe)
            if merit > best.get(name, (-np.inf,))[0]:
                best[name] = (merit, shape.name, safe)
    entries = [_played(aim, limits, name, *best[name]) for name in best]
    for name in FAMILIES:
        if name not in best:
            why = refused.get(name, "keeps no limit of the band")
            entries.append(Played(name, "", float("nan"), None, {}, why))
    sign = -1.0 if aim.higher_is_better else 1.0
    return sorted(entries, key=lambda p: (p.inputs is None, sign * p.value if p.inputs is not None else 0.0))


def _tried(name: str, limits: Limits, seed: int) -> Iterator[tuple[Shape, np.ndarray]]:
    """Shapes at the whole amplitude, then at smaller ones."""
    if limits.band[0] > 0.0 and name not in KEEPS_LOWEST:
        return
    for amplitude in (1.0, *SMALLER):
        for shape in FAMILIES[name](limits, seed):
            inputs = within(limits, shape.signal, amplitude, keeps_form=name in FAMILY_OF_FORM)
            told = shape.name if amplitude == 1.0 else f"{shape.name}, {100 * amplitude:.0f} % of the range"
            yield Shape(told, shape.signal), inputs


def _played(aim: Aim, limits: Limits, name: str, merit: float, shape: str, inputs: np.ndarray) -> Played:
    names = [one.name for one in limits.inputs]
    rms = dict(zip(names, np.std(inputs, axis=0).tolist(), strict=True))
    return Played(name, shape, aim.value(merit), inputs, rms)


def free_input(aim: Aim, limits: Limits, guard: Guard, start: Played, budget: Budget) -> Played:
    """The input that conditional gradient steps (Frank and Wolfe 1956) make of `start`.

    A step goes towards the input that a linear program finds best along the gradient within amplitude and
    rate; it is shortened until the merit grows and the safe ranges hold. Where the gradient is known by
    differences alone, pieces are exchanged besides.
    """
    assert start.inputs is not None
    if limits.band[0] > 0.0:
        return Played(FREE, "", float("nan"), None, {}, "does not keep a band that begins above 0 Hz")
    inputs, merit = start.inputs, aim.merit(start.inputs)
    coarse = _hats(limits)
    if np.isinf(limits.band[1]) and aim.gradient(inputs) is None:
        inputs, merit = _exchanged(aim, limits, guard, inputs, merit, budget.half())
    for _ in range(MOST_ROUNDS):
        slopes = aim.gradient(inputs)
        basis = None if slopes is not None and np.isinf(limits.band[1]) else coarse
        if slopes is None:
            slopes = _probed(aim.focused(inputs), limits, inputs, coarse, budget)
        elif basis is not None:
            slopes = basis @ slopes
        if slopes is None or not np.any(slopes):
            break
        step = _towards(limits, inputs, slopes, basis)
        found = None if step is None else _along(aim, guard, inputs, merit, step)
        if found is None:
            break
        gained, (inputs, merit) = found[1] - merit, found
        if gained < LEAST_GAIN * max(1.0, abs(merit)) or budget.is_over:
            break
    return _played(aim, limits, FREE, merit, f"from {start.family}: {start.shape}", inputs)


def _exchanged(
    aim: Aim, limits: Limits, guard: Guard, inputs: np.ndarray, merit: float, budget: Budget
) -> tuple[np.ndarray, float]:
    """The input with random pieces set to random levels wherever that is better (the exchange of Fedorov
    1972), until the time is over or nothing helps any more."""
    rng = np.random.default_rng(0)
    n, n_u = inputs.shape
    failed = 0
    while failed < MOST_FAILED and not budget.is_over:
        column = int(rng.integers(n_u))
        first = int(rng.integers(n))
        size = int(np.exp(rng.uniform(0.0, np.log(max(n / LONGEST_PIECE, 2.0)))))
        piece = slice(first, first + size)
        tried = with_piece(limits, inputs, column, piece, _level(rng))
        value = aim.merit(tried) if guard.is_safe(tried) else -np.inf
        if value > merit:
            inputs, merit, failed = tried, value, 0
        else:
            failed += 1
    return inputs, merit


def _level(rng: np.random.Generator) -> float:
    """Between the lowest (0) and the highest (1) value, and often one of them."""
    return float(np.clip(rng.uniform(-0.5, 1.5), 0.0, 1.0))


def _along(
    aim: Aim, guard: Guard, inputs: np.ndarray, merit: float, step: np.ndarray
) -> tuple[np.ndarray, float] | None:
    """The first of ever shorter steps that is safe and better."""
    share = 1.0
    while share >= SHORTEST:
        tried = inputs + share * step
        if guard.is_safe(tried):
            value = aim.merit(tried)
            if value > merit:
                return tried, value
        share *= 0.5
    return None


def _hats(limits: Limits) -> csr_matrix:
    """Hat functions (n_knots, n_samples) over knots as near as the band allows."""
    n = limits.time.size
    knots = KNOTS if np.isinf(limits.band[1]) else int(2.0 * limits.band[1] * limits.length)
    at = np.linspace(0, n - 1, max(2, min(knots, n)))
    rows = [np.interp(np.arange(n), at, unit) for unit in np.eye(at.size)]
    return csr_matrix(np.array(rows))


def _probed(
    aim: Aim, limits: Limits, inputs: np.ndarray, hats: csr_matrix, budget: Budget
) -> np.ndarray | None:
    """∂merit/∂knot (n_knots, n_u) by differences, inwards where a limit is reached; None out of time."""
    slopes, merit = np.zeros((hats.shape[0], len(limits.inputs))), aim.merit(inputs)
    for m in range(hats.shape[0]):
        hat = hats[m].toarray()[0]
        for i, one in enumerate(limits.inputs):
            if budget.is_over:
                return None
            move = PROBED * one.half * (-1.0 if inputs[np.argmax(hat), i] > one.middle else 1.0)
            if move == 0.0:
                continue
            tried = inputs.copy()
            tried[:, i] += move * hat
            value = aim.merit(tried)
            slopes[m, i] = (value - merit) / move if np.isfinite(value) else 0.0
    return slopes


def _towards(
    limits: Limits, inputs: np.ndarray, slopes: np.ndarray, basis: csr_matrix | None
) -> np.ndarray | None:
    """The change (n_samples, n_u) within amplitude and rate that is best along `slopes`, one column after
    another: of the samples, or of the knots of `basis`."""
    step = np.zeros_like(inputs)
    for i, one in enumerate(limits.inputs):
        column, gradient = inputs[:, i], slopes[:, i]
        if basis is None and np.isinf(one.rate):
            step[:, i] = np.where(gradient > 0.0, one.high, one.low) - column
            step[gradient == 0.0, i] = 0.0
            continue
        spread = diags(np.ones(column.size)) if basis is None else basis.T
        rows, most = [spread, -spread], [one.high - column, column - one.low]
        if np.isfinite(one.rate):
            change = spread[1:] - spread[:-1] if basis is not None else _differences(column.size)
            reach = one.rate * limits.period
            rows += [change, -change]
            most += [reach - np.diff(column), reach + np.diff(column)]
        found = linprog(
            -gradient,
            A_ub=vstack([csr_matrix(r) for r in rows]),
            b_ub=np.maximum(np.concatenate(most), 0.0),
            bounds=(None, None),
            method="highs",
        )
        if found.status != 0:
            return None
        step[:, i] = found.x if basis is None else basis.T @ found.x
    return step


def _differences(n: int) -> csr_matrix:
    return csr_matrix(diags([-np.ones(n - 1), np.ones(n - 1)], [0, 1], shape=(n - 1, n)))
