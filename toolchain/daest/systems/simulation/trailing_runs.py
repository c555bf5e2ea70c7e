"""Runs of a model with a chain of states that nothing else feels: the compiled integration of the others,
which takes the chain along from sample to sample."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from daest.numerics.compiler import pointer
from daest.systems.events.integration import Correction, Run, Trajectory
from daest.systems.simulation.driven_chain import parts_of_inputs
from daest.systems.simulation.trailing_chain import PARTS, TrailingChain, trailing_steps
from daest.systems.tolerances import SOLVER


class Tail(ctypes.Structure):
    """What `radau.c` knows of the chain, by the names there; `kept` are the arrays that it points to."""

    _fields_ = (
        *((name, ctypes.c_long) for name in ("parts", "n_by", "gain_stride")),
        *(
            (name, ctypes.c_void_p)
            for name in (
                "by", "transition", "drive", "shown", "gain", "gain_slopes", "start", "start_sens", "states"
            )
        ),
    )  # fmt: skip
    kept: list[np.ndarray | None]


def may_trail(runs: Sequence[Run]) -> bool:
    """Whether all intervals of all runs are of one length."""
    lengths = np.concatenate([np.diff(run.time) for run in runs])
    return bool(lengths.size and np.ptp(lengths) <= SOLVER.equal_steps * lengths.mean())


@dataclass(frozen=True)
class TrailingRuns:
    """Runs that are alike, each with a chain behind it; `columns` are the positions of the parameters that
    the others are integrated for, of which the runs ask for the first."""

    chain: TrailingChain
    runs: Sequence[Run]
    columns: list[int]

    def rests(self) -> list[Run]:
        """The runs of the states before the chain, in PARTS of every interval."""
        return [self._rest(run) for run in self.runs]

    @cached_property
    def states(self) -> np.ndarray:
        """Those of the chain in all runs (n_samples, n_c), which `tail` has filled."""
        return np.empty((sum(run.time.size for run in self.runs), self.chain.members.size))

    @cached_property
    def tail(self) -> Tail:
        one, chain = self.runs[0], self.chain
        n_c, at = chain.members.size, chain.members
        period = float(one.time[-1] - one.time[0]) / max(one.time.size - 1, 1)
        steps = trailing_steps(chain, one.theta, period)
        by = {column: place for place, column in enumerate(self.columns[: one.by_parameter])}
        wanted = [i for i, column in enumerate(chain.by) if column in by]
        rows = [0, *(1 + i for i in wanted)]
        start_sens = np.zeros((n_c, one.directions))
        if one.directions:
            first = one.by_parameter + chain.rest.size
            start_sens[:, first : first + n_c] = np.eye(n_c)
        gain, slopes, stride = None, None, 0
        if one.correction is not None:
            given = [run.correction for run in self.runs if run.correction is not None]
            varies = one.correction.gain.ndim == 3
            gain = np.concatenate([g.gain for g in given]) if varies else one.correction.gain
            gain, slopes = _with_signal(gain[..., at, :]), _with_signal(one.correction.slopes[:, at])
            stride = gain[0].size if varies else 0
        arrays = [
            np.array([by[chain.by[i]] for i in wanted], dtype=ctypes.c_long),
            np.ascontiguousarray(steps.transition[rows]),
            np.ascontiguousarray(steps.drive[rows]),
            np.vstack([chain.shown, np.zeros(n_c)]),
            gain,
            slopes,
            np.array([run.x0[at] for run in self.runs]),
            start_sens,
            self.states,
        ]
        made = Tail(PARTS, len(wanted), stride, *map(pointer, arrays))
        made.kept = arrays
        return made

    def joined(self, found: Sequence[Trajectory]) -> list[Trajectory]:
        """The trajectories of all states from those `found` of the others."""
        ends = np.cumsum([run.time.size for run in self.runs])
        parts = np.split(self.states, ends[:-1])
        return [self._whole(run, one, c) for run, one, c in zip(self.runs, found, parts, strict=True)]

    def _rest(self, run: Run) -> Run:
        rest, n = self.chain.rest, run.time.size
        u0, u1, bent = parts_of_inputs((run.u0, run.u1, run.bent))
        time = run.time[:-1, None] + np.diff(run.time)[:, None] * (np.arange(PARTS) / PARTS)
        given = run.correction
        if given is not None:
            seen = np.full((PARTS * (n - 1) + 1, given.measurements.shape[1] + 1), np.nan)
            seen[::PARTS, :-1] = given.measurements
            gain = given.gain[..., rest, :]
            if gain.ndim == 3:
                gain = np.repeat(gain, PARTS, axis=0)[: seen.shape[0]]
            given = Correction(seen, _with_signal(gain), _with_signal(given.slopes[:, rest]))
        return replace(
            run,
            time=np.append(time.ravel(), run.time[-1]),
            u0=np.ascontiguousarray(u0.reshape(PARTS * (n - 1), -1)),
            u1=np.ascontiguousarray(u1.reshape(PARTS * (n - 1), -1)),
            bent=None if bent is None else np.ascontiguousarray(bent.reshape(PARTS * (n - 1), 2, -1)),
            x0=np.ascontiguousarray(run.x0[rest]),
            atol=np.ascontiguousarray(run.atol[rest]),
            scale=run.scale[rest],
            correction=given,
        )

    def _whole(self, run: Run, found: Trajectory, c: np.ndarray) -> Trajectory:
        chain = self.chain
        states = np.empty((run.time.size, run.x0.size))
        states[:, chain.rest], states[:, chain.members] = found.states[::PARTS], c
        outputs = np.ascontiguousarray(found.outputs[::PARTS, :-1])
        sens = np.empty((*outputs.shape, 0))
        if run.directions:
            by_state = np.empty(run.x0.size, dtype=int)
            by_state[[*chain.rest, *chain.members]] = run.by_parameter + np.arange(run.x0.size)
            gains = range(run.directions - run.by_gain, run.directions)
            order = [*range(run.by_parameter), *by_state, *gains]
            sens = np.ascontiguousarray(found.sensitivities[::PARTS, :-1][..., order])
        return Trajectory(states, outputs, sens, found.n_steps)


def _with_signal(gain: np.ndarray) -> np.ndarray:
    """Gains (..., n, n_y) for the outputs and the signal, which nothing measures."""
    return np.ascontiguousarray(np.pad(gain, [(0, 0)] * (gain.ndim - 1) + [(0, 1)]))
