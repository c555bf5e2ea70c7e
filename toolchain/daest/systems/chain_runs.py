"""Runs of a model with a chain of states that inputs drive: the chain by exact steps, then the others, for
which its signals are inputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from daest.systems.driven_chain import PARTS, DrivenChain, Driving, driving, parts_of_inputs
from daest.systems.integration import FAILURES, Correction, IntegrationError, Run, Trajectory
from daest.systems.tolerances import SOLVER


def has_driven_chain(chain: DrivenChain, run: Run) -> bool:
    """Whether no sample corrects the chain: no noise of the model reaches it. The longest interval is no gap,
    whose parts would be too long for a straight line."""
    intervals = np.diff(run.time)
    if not intervals.size or np.max(intervals) > SOLVER.longest_interval * np.median(intervals):
        return False
    if run.correction is not None:
        if chain.alone:
            return False
        gain = run.correction.gain
        for one in (gain if gain.ndim == 3 else gain[None], run.correction.slopes):
            moved = np.abs(one) / run.scale[:, None]
            least = SOLVER.uncorrected * np.max(moved, initial=0.0)
            if np.max(moved[:, chain.members], initial=0.0) > least:
                return False
    return True


def _is_finite(part: np.ndarray) -> bool:
    """Whether all of an array of any shape is."""
    return bool(np.all(np.isfinite(part)))


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
        u0, u1 = (np.concatenate(part) for part in zip(*((run.u0, run.u1) for run in self.runs), strict=True))
        bends = [run.bent for run in self.runs if run.bent is not None]
        inputs = u0, u1, np.concatenate(bends) if bends else None
        lengths = [np.diff(run.time) for run in self.runs]
        starts = np.array([run.x0[self.chain.members] for run in self.runs])
        with np.errstate(over="ignore", invalid="ignore"):
            found = driving(self.chain, one.theta, self.columns, lengths, inputs, starts, one.directions > 0)
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

    def _rest(
        self, run: Run, samples: slice, intervals: slice, gain: tuple[np.ndarray, np.ndarray] | None
    ) -> Run:
        chain, made = self.chain, self.made
        n, last = run.time.size, made.sampled[samples.stop - 1 : samples.stop]
        u0, u1, bent = parts_of_inputs((run.u0, run.u1, run.bent))
        u_last = np.hstack([run.u_last, last])
        u0 = np.concatenate([u0, made.start[intervals]], axis=2)
        u1 = np.concatenate([u1, made.end[intervals]], axis=2)
        if chain.is_shown:  # what outputs show at a sample is the signal itself
            shown = np.repeat(made.sampled[samples][:-1, None], PARTS, axis=1)
            u0, u1 = np.concatenate([u0, shown], axis=2), np.concatenate([u1, shown], axis=2)
            u_last = np.hstack([u_last, last])
        if bent is not None:
            bent = np.concatenate([bent, np.zeros((*bent.shape[:3], u0.shape[2] - bent.shape[3]))], axis=3)
            bent = np.ascontiguousarray(bent.reshape(-1, 2, u0.shape[2]))
        parts = run.time[:-1, None] + np.diff(run.time)[:, None] * np.arange(PARTS) / PARTS
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
            time=np.append(parts.ravel(), run.time[-1]),
            u0=np.ascontiguousarray(u0.reshape(-1, u0.shape[2])),
            u1=np.ascontiguousarray(u1.reshape(-1, u1.shape[2])),
            u_last=u_last,
            bent=bent,
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
