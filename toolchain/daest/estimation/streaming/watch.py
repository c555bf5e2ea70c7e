"""Does the model still hold? Alarms from the innovations of a filter that runs along a stream."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from daest.data.prepare import on_clock
from daest.estimation.streaming.change import (
    CHARTS,
    ChartState,
    Usual,
    crossing,
    restarted,
    start_of_charts,
    update_charts,
)
from daest.estimation.streaming.online import OnlineFilter
from daest.model.estimates import Estimate, Sample
from daest.model.experiment import Experiment

QUIET = 500  # samples after an alarm in which crossings belong to it


@dataclass(frozen=True)
class Alarm:
    """At `time` [s] the model no longer held: the sum `chart` of `output` passed the threshold with
    `statistic` [nats]; it had grown since the time `since` [s]."""

    time: float
    output: str
    chart: str
    statistic: float
    since: float


@dataclass(frozen=True)
class WatchState:
    """The charts, and how many samples ago the last alarm was (None: there was none)."""

    charts: ChartState
    age: int | None = None


@dataclass(frozen=True)
class Watch:
    """Charts with a threshold. Crossings within QUIET samples after an alarm belong to it; a change that
    lasts longer is told again, so that no false alarm hides a true one."""

    output_names: tuple[str, ...]
    usual: Usual
    threshold: float

    def begin(self) -> WatchState:
        return WatchState(start_of_charts(self.usual))

    def look(self, state: WatchState, estimate: Estimate) -> tuple[WatchState, Alarm | None]:
        """The state after one more estimate, and the alarm that it raises."""
        if estimate.nis_dof == 0:
            return state, None
        charts = update_charts(state.charts, estimate.whitened, estimate.time, self.usual)
        found = crossing(charts, self.threshold)
        age = None if state.age is None else state.age + 1
        if found is None:
            return WatchState(charts, age), None
        charts = restarted(charts, estimate.time)
        if age is not None and age < QUIET:
            return WatchState(charts, age), None
        after = WatchState(charts, 0)
        output, chart = self.output_names[found.output], CHARTS[found.chart]
        return after, Alarm(estimate.time, output, chart, found.statistic, found.since)


def before_change(samples: Iterable[Sample], alarm: Alarm) -> list[Sample]:
    """The samples that came well before the change. It may have begun earlier than its sum grew, by as much
    as the sum took to pass the threshold."""
    begins = 2.0 * alarm.since - alarm.time
    return [sample for sample in samples if sample.time < begins]


def recording_of(samples: Sequence[Sample], online: OnlineFilter) -> Experiment:
    """The samples, in the names of the filter that they came to."""
    recorded = Experiment(
        "stream",
        np.array([sample.time for sample in samples]),
        np.array([sample.inputs for sample in samples]),
        np.array([sample.outputs for sample in samples]),
        online.input_names,
        online.output_names,
        {},
        (),
    )
    return on_clock(recorded)
