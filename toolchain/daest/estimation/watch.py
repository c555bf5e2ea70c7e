"""Does the model still hold? Alarms from the innovations of a filter that runs along a stream."""

from __future__ import annotations

from dataclasses import dataclass

from daest.estimation.change import (
    CHARTS,
    ChartState,
    Usual,
    crossing,
    restarted,
    start_of_charts,
    update_charts,
)
from daest.model.stream import Estimate

QUIET = 500  # samples without a crossing after which the model is taken to hold again


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
    """The charts, and how many samples ago they last crossed the threshold (None: the model holds)."""

    charts: ChartState
    quiet: int | None = None


@dataclass(frozen=True)
class Watch:
    """Charts with a threshold. One change gives one alarm: later crossings belong to it until QUIET samples
    have passed without any."""

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
        if found is None:
            quiet = None if state.quiet is None or state.quiet >= QUIET else state.quiet + 1
            return WatchState(charts, quiet), None
        after = WatchState(restarted(charts, estimate.time), 0)
        if state.quiet is not None:
            return after, None
        output, chart = self.output_names[found.output], CHARTS[found.chart]
        return after, Alarm(estimate.time, output, chart, found.statistic, found.since)
