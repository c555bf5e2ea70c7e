"""Runs of a model with a chain of states that inputs drive: the chain by exact steps, then the others, for
which its signals are inputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from daest.systems.events.integration import FAILURES, Correction, IntegrationError, Run, Trajectory
from daest.systems.simulation.driven_chain import PARTS, DrivenChain, Driving, driving, parts_of_inputs
from daest.systems.tolerances import SOLVER

PLACES = np.arange(PARTS) / PARTS  # at which the parts of an interval begin


def have_driven_chain(chain: DrivenChain, runs: Sequence[Run]) -> bool:
    """Whether no sample of runs that are alike corrects the chain: no noise of the model reaches it. The
    longest interval is no gap, whose parts would be too long for a straight line."""
    if not all(_is_gapless(run.time) for run in runs):
        return False
    one = runs[0].correction
    if one is None:
        return True
    gains = [run.correction.gain for run in runs if run.correction is not None]
    if one.gain.ndim == 2:  # shared
        gains = [one.gain[None]]
    return not chain.alone and not any(_reaches(chain, part, runs[0].scale) for part in (*gains, one.slopes))


def _is_gapless(time: np.ndarray) -> bool:
    intervals = np.diff(time)
    middle = intervals.size // 2  # np.median takes several times as long
    typical = np.partition(intervals, middle)[middle] if intervals.size else 0.0
    return bool(intervals.size and np.max(intervals) <= SOLVER.longest_interval * typical)


def _reaches(chain: DrivenChain, gain: np.ndarray, scale: np.ndarray) -> bool:
    """Whether gains (k, n_states, n_y) move the chain, in units of the sizes of the states."""
    moved = np.abs(gain) / scale[:, None]
    least = SOLVER.uncorrected * np.max(moved, initial=0.0)
    return bool(np.max(moved[:, chain.members], initial=0.0) > least)


@dataclass(frozen=True)
class _Parts:
    """What drives the others on every part of every interval of all runs: the time at which it begins, and as
    those of a `Run` their inputs."""

    time: np.ndarray
    u0: np.ndarray
    u1: np.ndarray
    bent: np.ndarray | None


@dataclass(frozen=True)
class RunsBesideChain:
    """Runs that are alike, each with a driven chain; `columns` are the positions of the parameters that its
    others are integrated for, of which the runs ask for the first."""

    chain: DrivenChain
    runs: Sequence[Run]
    columns: list[int]

    @cached_property
    def made(self) -> Driving:
        """What the chain does in all runs, one behind the other. Raises IntegrationError where that is not
        finite."""
        one = self.runs[0]
        lengths = [np.diff(run.time) for run in self.runs]
        starts = np.array([run.x0[self.chain.members] for run in self.runs])
        with np.errstate(over="ignore", invalid="ignore"):
            found = driving(
                self.chain, one.theta, self.columns, lengths, self._inputs, starts, one.directions > 0
            )
        if not all(
            np.all(np.isfinite(part)) for part in (found.states, found.start, found.end, found.sampled)
        ):
            raise IntegrationError(FAILURES[3], float(one.time[0]))
        return found

    def rests(self) -> list[Run]:
        """The runs of the states behind the chain, in PARTS of every interval."""
        rows = self._rows
        gain = self._gain_of_rest
        return [self._rest(run, *at, gain) for run, at in zip(self.runs, rows, strict=True)]

    def joined(self, found: Sequence[Trajectory]) -> list[Trajectory]:
        """The trajectories of all states from those `found` of the others."""
        return [
            self._whole(run, one, samples)
            for run, one, (samples, _) in zip(self.runs, found, self._rows, strict=True)
        ]

    @cached_property
    def _rows(self) -> list[tuple[slice, slice]]:
        """The samples and the intervals of every run."""
        ends = np.cumsum([run.time.size for run in self.runs]).tolist()
        rows = []
        for number, (run, end) in enumerate(zip(self.runs, ends, strict=True)):
            start = end - run.time.size
            rows.append((slice(start, end), slice(start - number, end - number - 1)))
        return rows

    @cached_property
    def _gain_of_rest(self) -> tuple[np.ndarray, np.ndarray] | None:
        """The gain (n_rest, n_y) on the states behind the chain, with its slopes, where it is one for all."""
        given = self.runs[0].correction
        if given is None or given.gain.ndim == 3:
            return None
        return given.gain[self.chain.rest], given.slopes[:, self.chain.rest]

    @cached_property
    def _inputs(self) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Those of all runs, and their bends."""
        u0, u1 = (np.concatenate([getattr(run, name) for run in self.runs]) for name in ("u0", "u1"))
        bends = [run.bent for run in self.runs if run.bent is not None]
        return u0, u1, np.concatenate(bends) if bends else None

    @cached_property
    def _inputs_of_rests(self) -> _Parts:
        made, (given_0, given_1, given_bent) = self.made, self._inputs
        u0, u1, bent = parts_of_inputs((given_0, given_1, given_bent))
        starts, ends = [u0, made.start], [u1, made.end]
        if self.chain.is_shown:
            first = np.concatenate([made.sampled[samples][:-1] for samples, _ in self._rows])
            shown = np.repeat(first[:, None], PARTS, axis=1)
            starts, ends = [*starts, shown], [*ends, shown]
        begun = np.concatenate([run.time[:-1] for run in self.runs])[:, None]
        time = begun + np.concatenate([np.diff(run.time) for run in self.runs])[:, None] * PLACES
        u0, u1 = (np.concatenate(part, axis=2).reshape(PARTS * begun.size, -1) for part in (starts, ends))
        if bent is not None:
            more = np.zeros((*bent.shape[:3], u0.shape[1] - bent.shape[3]))
            bent = np.concatenate([bent, more], axis=3).reshape(u0.shape[0], 2, -1)
        return _Parts(time.ravel(), u0, u1, bent)

    def _rest(
        self, run: Run, samples: slice, intervals: slice, gain: tuple[np.ndarray, np.ndarray] | None
    ) -> Run:
        chain, driven = self.chain, self._inputs_of_rests
        n, last = run.time.size, self.made.sampled[samples.stop - 1 : samples.stop]
        parts = slice(PARTS * intervals.start, PARTS * intervals.stop)
        # What outputs show at a sample is the signal itself.
        u_last = np.hstack([run.u_last, last, last] if chain.is_shown else [run.u_last, last])
        given = run.correction
        if given is not None:
            seen = np.full((PARTS * (n - 1) + 1, given.measurements.shape[1]), np.nan)
            seen[::PARTS] = given.measurements
            if gain is None:
                every = np.repeat(given.gain[..., chain.rest, :], PARTS, axis=0)[: seen.shape[0]]
                given = Correction(seen, every, given.slopes[:, chain.rest])
            else:
                given = Correction(seen, *gain)
        n_chosen, n_rest = len(self.columns) + chain.members.size, chain.rest.size
        return replace(
            run,
            time=np.append(driven.time[parts], run.time[-1]),
            u0=driven.u0[parts],
            u1=driven.u1[parts],
            u_last=u_last,
            bent=None if driven.bent is None else driven.bent[parts],
            x0=np.ascontiguousarray(run.x0[chain.rest]),
            directions=n_chosen + n_rest + run.by_gain if run.directions else 0,
            by_parameter=n_chosen if run.directions else 0,
            atol=np.ascontiguousarray(run.atol[chain.rest]),
            scale=run.scale[chain.rest],
            correction=given,
        )

    def _whole(self, run: Run, found: Trajectory, samples: slice) -> Trajectory:
        chain, n = self.chain, run.time.size
        states = np.empty((n, run.x0.size))
        states[:, chain.rest], states[:, chain.members] = found.states[::PARTS], self.made.states[samples]
        outputs, sens = found.outputs[::PARTS].copy(), np.empty((n, found.outputs.shape[1], 0))
        for j, i in chain.alone:
            outputs[:, j] = self.made.states[samples, i]
        if run.directions:
            sens = self._sensitivities(run, found.sensitivities[::PARTS], samples)
        return Trajectory(states, outputs, sens, found.n_steps)

    def _sensitivities(self, run: Run, sens: np.ndarray, samples: slice) -> np.ndarray:
        """The sensitivities `sens` (n_samples, n_y, …) of the run of the others, with those of outputs that
        the chain alone makes, in the order of the parameters asked for, the states of the model and the
        gains."""
        chain = self.chain
        n_chosen, n_rest = len(self.columns) + chain.members.size, chain.rest.size
        by_state = np.empty(run.x0.size, dtype=int)
        by_state[chain.members] = len(self.columns) + np.arange(chain.members.size)
        by_state[chain.rest] = n_chosen + np.arange(n_rest)
        order = [*range(run.by_parameter), *by_state, *range(n_chosen + n_rest, sens.shape[2])]
        own = [*chain.driven(self.columns), *range(len(self.columns), n_chosen)]
        for j, i in chain.alone:
            sens[:, j, own] = self.made.slopes[:, samples, i].T
        return np.ascontiguousarray(sens[:, :, order])
