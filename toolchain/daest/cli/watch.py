"""`daest watch`: whether a model still holds for the machine that runs beside it."""

from __future__ import annotations

import json
import sys
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from daest.cli.follow import Stream, StreamOptions, open_stream, stream_options, told_at_the_end
from daest.cli.given import Files, files
from daest.cli.options import (
    DataOptions,
    ModelOptions,
    data_options,
    example,
    gathered,
    kind_option,
    measure_option,
    model_options,
    seed_option,
    set_option,
)
from daest.cli.output import note, with_schema
from daest.cli.publish import publisher
from daest.diagnosis.gates import GATES
from daest.errors import DaestError

if TYPE_CHECKING:
    from daest.estimation.streaming.watch import Alarm, Watch
    from daest.model.estimates import Sample

AVERAGE_RUN = 100_000.0  # samples between false alarms, where nothing else is asked for
WINDOW = 2000  # samples after a change from which it is diagnosed
FEWEST = 2 * GATES.min_samples  # samples without which nothing is diagnosed: half of them validate


@dataclass(frozen=True)
class WatchOptions:
    """What is asked of a watch; `average_run` in samples, `window` too."""

    average_run: float = AVERAGE_RUN
    reference: Path | None = None
    diagnoses: bool = False
    window: int = WINDOW
    fails: bool = False
    mqtt: str | None = None
    form: str = "json"


_watch_options = gathered(
    "watch",
    WatchOptions,
    click.option(
        "--average-run",
        type=click.FloatRange(min=1000.0),
        default=AVERAGE_RUN,
        metavar="SAMPLES",
        help="Mean number of samples between two false alarms (default: 100000).",
    ),
    click.option(
        "--reference",
        metavar="FILE",
        type=click.Path(path_type=Path),
        help="A recording in which the model held as well as it can: alarms are changes against it.",
    ),
    click.option("--diagnose", "diagnoses", is_flag=True, help="Name what is missing since the change."),
    click.option(
        "--window",
        type=click.IntRange(min=FEWEST),
        default=WINDOW,
        metavar="SAMPLES",
        help="Samples after the change that --diagnose looks at (default: 2000).",
    ),
    click.option("--fail-on-alarm", "fails", is_flag=True, help="Exit with 1 after an alarm."),
    click.option("--mqtt", metavar="ADDRESS", help="Publish the events there, too: mqtt://HOST:PORT/TOPIC."),
    click.option(
        "--format",
        "form",
        type=click.Choice(["text", "json"]),
        default="json",
        help="One JSON object, or one sentence, for each event (default: json).",
    ),
)


@click.command(
    "watch",
    epilog=example(
        "daest watch night.csv --idle 1 --fail-on-alarm",
        "tail -f machine.csv | daest watch --reference run1.csv --diagnose",
    ),
)
@files("[MODEL] [DATA]")
@set_option
@measure_option
@kind_option(["time-varying", "stationary", "ekf", "ukf"])
@_watch_options
@stream_options
@model_options
@data_options
@seed_option
def command(
    files: Files,
    settings: Mapping[str, float],
    measure: tuple[str, ...],
    kind: str | None,
    watch: WatchOptions,
    stream: StreamOptions,
    model_options: ModelOptions,
    data_options: DataOptions,
    seed: int,
) -> int:
    """Whether the model still holds, along a stream: stdin, or the file DATA that grows.

    A filter runs along; sequential tests look at its innovations. Every event is one line on stdout: started,
    alarm, diagnosis, ended.
    """
    project = model_options.project()
    opened = open_stream(
        project,
        files.model,
        model_options,
        data_options,
        files.recording,
        measure,
        kind,
        stream,
        settings,
    )
    charts = _watch(opened, watch, seed)
    folders = model_options.folders(project)
    with publisher(watch.mqtt) as publish, told_at_the_end(opened.tally):
        n_alarms = _watched(
            opened, charts, watch, folders, seed, _teller(watch.form, charts.threshold, publish)
        )
    return 1 if n_alarms and watch.fails else 0


def _watch(stream: Stream, options: WatchOptions, seed: int) -> Watch:
    """The charts with their threshold: of white innovations, or of those of the reference."""
    import numpy as np

    from daest.cli.recordings import signals, words_of
    from daest.data.read import read_experiments, select_outputs
    from daest.estimation.streaming.change import Usual, threshold_for, usual_of
    from daest.estimation.streaming.watch import QUIET, Watch

    names = stream.online.output_names
    usual = Usual.white(len(names))
    if options.reference is not None:
        project = stream.project
        names_of = signals(stream.flat, project)
        experiment = read_experiments([options.reference], *names_of, **words_of(project, stream.flat))[0]
        recorded = select_outputs(experiment, names)
        usual = usual_of(np.array([e.whitened for e in stream.estimates_of(recorded)]))
    # The samples after an alarm that raise no other one are a part of what is promised.
    return Watch(names, usual, threshold_for(usual, options.average_run - QUIET, seed))


Tell = Callable[..., None]


def _teller(form: str, threshold: float, publish: Callable[[str], None]) -> Tell:
    """A function that writes an event as one line to stdout, flushed, and publishes it."""

    def tell(event: str, time: float | None, **more: Any) -> None:
        plain: dict[str, Any] = {
            "time": time, "event": event, "output": None, "statistic": None, "threshold": threshold,
            "since": None, "effect": None,
        }  # fmt: skip
        content = with_schema({**plain, **more}, "watch")
        text = json.dumps(content, ensure_ascii=False, allow_nan=False)
        publish(text)
        sys.stdout.write((text if form == "json" else _sentence(content)) + "\n")
        sys.stdout.flush()

    return tell


def _sentence(event: dict[str, Any]) -> str:
    at = "" if event["time"] is None else f"{event['time']:g} s: "
    if event["event"] == "started":
        run, threshold = event["average_run"], event["threshold"]
        return (
            f"{at}watching {', '.join(event['outputs'])} with the {event['kind']} filter; one false alarm in "
            f"{run:g} samples (threshold {threshold:.3g} nats)"
        )
    if event["event"] == "alarm":
        return (
            f"{at}ALARM: the model no longer holds in {event['output']} since {event['since']:g} s "
            f"({event['change']}, {event['statistic']:.3g} nats)"
        )
    if event["event"] == "diagnosis":
        return f"{at}diagnosis: {' '.join(event['message'].split())}"
    return f"{at}ended after {event['n_samples']} samples with {event['n_alarms']} alarms"


def _watched(
    stream: Stream, watch: Watch, options: WatchOptions, folders: tuple[Path, ...], seed: int, tell: Tell
) -> int:
    """Run to the end of the stream; the number of alarms."""
    state = watch.begin()
    recent: deque[Sample] = deque(maxlen=2 * options.window if options.diagnoses else 1)
    pending: Alarm | None = None
    n_alarms, n_pending, time = 0, 0, None

    def begun_anew() -> None:
        nonlocal state
        state = watch.begin()

    try:
        for one in stream.followed(begun_anew):
            if time is None:
                tell(
                    "started", one.sample.time, average_run=options.average_run, kind=stream.online.kind,
                    outputs=list(watch.output_names),
                )  # fmt: skip
            time = one.sample.time
            recent.append(one.sample)
            state, alarm = watch.look(state, one.estimate)
            if alarm is not None:
                n_alarms += 1
                _tell_alarm(alarm, tell)
                n_pending = 1 if pending is None else n_pending + 1
                pending = pending or (alarm if options.diagnoses else None)
            if pending is not None and _is_full(pending, recent, options.window):
                _tell_diagnosis(stream, recent, pending, n_pending > 1, folders, seed, time, tell)
                pending = None
        if pending is not None:
            _tell_diagnosis(stream, recent, pending, n_pending > 1, folders, seed, time, tell)
    except KeyboardInterrupt:
        tell("ended", time, n_samples=stream.tally.n_samples, n_alarms=n_alarms)
        raise
    tell("ended", time, n_samples=stream.tally.n_samples, n_alarms=n_alarms)
    return n_alarms


def _tell_alarm(alarm: Alarm, tell: Tell) -> None:
    tell(
        "alarm", alarm.time, output=alarm.output, statistic=alarm.statistic, since=alarm.since,
        change=alarm.chart,
    )  # fmt: skip


def _is_full(alarm: Alarm, recent: deque[Sample], window: int) -> bool:
    """Whether enough samples have come since the change."""
    if len(recent) < window:
        return False
    return recent[-window].time >= alarm.since or recent[0].time > alarm.since


def _tell_diagnosis(
    stream: Stream,
    recent: deque[Sample],
    alarm: Alarm,
    lasts: bool,
    folders: tuple[Path, ...],
    seed: int,
    time: float | None,
    tell: Tell,
) -> None:
    """What is missing in the samples since the change. A diagnosis that fails is told as one."""
    from daest.estimation.streaming.watch import before_change

    samples = [sample for sample in recent if sample.time >= alarm.since]
    if len(samples) < FEWEST:
        message = f"{len(samples)} samples came after the change, too few to diagnose it (at least {FEWEST})"
        tell("diagnosis", time, since=alarm.since, verdict="cannot tell", message=message)
        return
    note(f"diagnosing {len(samples)} samples since {alarm.since:g} s")
    try:
        found = _diagnosed(stream, before_change(recent, alarm), samples, lasts, folders, seed)
    except DaestError as problem:
        tell("diagnosis", time, since=alarm.since, verdict="cannot tell", message=problem.what)
        return
    best = next((p.candidate for p in found.proofs if p.verdict == "supported"), None)
    tell(
        "diagnosis",
        time,
        since=alarm.since,
        output=alarm.output,
        verdict=found.verdict,
        message=found.message,
        effect=None if best is None else best.effect.name,
        at=None if best is None else best.site.name,
    )


def _diagnosed(
    stream: Stream,
    before: Sequence[Sample],
    after: Sequence[Sample],
    lasts: bool,
    folders: tuple[Path, ...],
    seed: int,
) -> Any:
    from daest.diagnosis.changed import diagnose_change
    from daest.diagnosis.options import DiagnoseOptions
    from daest.estimation.streaming.watch import recording_of
    from daest.modelica.effects.catalogue import effect_library

    options = DiagnoseOptions(
        hold=stream.hold,
        seed=seed,
        fitted={p.name: p.value for p in stream.flat.parameters},
    )
    usual = recording_of(before, stream.online) if len(before) >= GATES.min_samples else None
    changed = recording_of(after, stream.online)
    return diagnose_change(stream.flat, effect_library(folders), usual, changed, options, lasts)
