"""Following a stream: samples come in line by line, the filter runs beside, its memory is kept for a restart.

`daest filter --follow` writes the estimates; `daest watch` looks at the innovations.
"""

from __future__ import annotations

import csv
import io
import json
import math
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from hashlib import sha256
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from daest.cli.lines import lines_of, source_name
from daest.cli.options import DataOptions, ModelOptions, gathered
from daest.cli.output import note, warn, whole_file
from daest.errors import ConfigError, DataError, EstimationError, Place

if TYPE_CHECKING:
    from daest.data.project import Project
    from daest.data.stream import LineFormat
    from daest.estimation.streaming.online import Memory, OnlineFilter
    from daest.model.estimates import Estimate, Sample
    from daest.model.experiment import Experiment
    from daest.model.flat import Model
    from daest.model.holds import Hold

TOLD = 10  # bad lines that are told one by one; the rest is counted
KEEP_EVERY = 1.0  # seconds between two writings of the memory
TIMED = 10_000  # last samples whose latency is summarised
LONG_GAP = 10_000  # expected steps after which a nonlinear filter starts anew: it would integrate all of them


@dataclass(frozen=True)
class StreamOptions:
    """Options of a stream: where its memory is kept, the expected step [s], and when a file has ended."""

    state: Path | None = None
    step: float | None = None
    idle: float | None = None


stream_options = gathered(
    "stream",
    StreamOptions,
    click.option(
        "--state",
        metavar="FILE",
        type=click.Path(path_type=Path),
        help="Keep the memory of the filter there, and go on from it after a restart.",
    ),
    click.option(
        "--step",
        type=click.FloatRange(min=0.0, min_open=True),
        metavar="SECONDS",
        help="Expected time between two samples (default: between the first two).",
    ),
    click.option(
        "--idle",
        type=click.FloatRange(min=0.0),
        metavar="SECONDS",
        help="End when a followed file has not grown for so long (default: never).",
    ),
)


@dataclass(frozen=True)
class Followed:
    """One sample of a stream with its estimate."""

    sample: Sample
    estimate: Estimate


@dataclass
class Tally:
    """What happened to the lines of a stream, and the latencies of the last samples [s]."""

    n_samples: int = 0
    n_bad: int = 0
    n_done: int = 0
    n_gaps: int = 0
    seconds: deque[float] = field(default_factory=lambda: deque(maxlen=TIMED))

    def sentence(self) -> str:
        parts = [f"{self.n_samples} samples"]
        if self.seconds:
            ordered = sorted(self.seconds)
            median, late = ordered[len(ordered) // 2], ordered[int(0.99 * (len(ordered) - 1))]
            parts.append(f"latency {1e3 * median:.3g} ms (99 % below {1e3 * late:.3g} ms)")
        if self.n_done:
            parts.append(f"{self.n_done} were done before")
        if self.n_bad:
            parts.append(f"{self.n_bad} lines were no samples")
        if self.n_gaps:
            parts.append(f"{self.n_gaps} gaps after which the filter started anew")
        return "; ".join(parts)


@dataclass(frozen=True)
class Stream:
    """A stream that has begun: the fitted model with the outputs of the stream, its filter and its format.
    `first` are the lines that were read to know them."""

    flat: Model
    online: OnlineFilter
    format: LineFormat
    first: tuple[tuple[int, str], ...]
    rest: Iterator[tuple[int, str]]
    state: Path | None
    tally: Tally
    digest: str
    period: float
    project: Project
    hold: Hold

    def estimates_of(self, experiment: Experiment) -> Iterator[Estimate]:
        """The estimates of a whole recording, from the start of the filter."""
        from daest.model.estimates import Sample

        memory = self.online.begin()
        for k, at in enumerate(experiment.time.tolist()):
            sample = Sample(at, experiment.inputs[k], experiment.outputs[k])
            memory, estimate = self.online.advance(memory, sample)
            yield estimate

    def followed(self, on_gap: Callable[[], None] = lambda: None) -> Iterator[Followed]:
        """Samples with their estimates as they come. A line that is no sample is told and left out. The
        memory is kept about every KEEP_EVERY seconds and at the end, whatever ends it. `on_gap` hears that
        the filter started anew."""
        memory = self._kept()
        written = time.monotonic()
        try:
            for number, line in chain(self.first, self.rest):
                began = time.perf_counter()
                sample = self._sample(line, number, memory)
                if sample is None:
                    continue
                if self._is_long_gap(memory, sample):
                    note(f"a gap from {memory.time:g} s to {sample.time:g} s: the filter starts anew")
                    self.tally.n_gaps += 1
                    memory = self.online.begin()
                    on_gap()
                memory, estimate = self.online.advance(memory, sample)
                self.tally.n_samples += 1
                yield Followed(sample, estimate)
                self.tally.seconds.append(time.perf_counter() - began)
                if time.monotonic() - written > KEEP_EVERY:
                    self._keep(memory)
                    written = time.monotonic()
        finally:
            self._keep(memory)

    def _sample(self, line: str, number: int, memory: Memory) -> Sample | None:
        """The sample of a line; None where it is none, or was done before."""
        try:
            sample = self.format.sample(line, number)
            if math.isfinite(memory.time) and sample.time <= memory.time:
                if self.tally.n_samples == 0:
                    self.tally.n_done += 1
                    return None
                raise DataError(
                    "stream-line",
                    f"the time goes from {memory.time:.10g} s to {sample.time:.10g} s",
                    where=Place(self.format.source, number),
                )
            return sample
        except DataError as problem:
            self.tally.n_bad += 1
            if self.tally.n_bad <= TOLD:
                warn(problem.code, f"{problem.where}: {problem.what}; it is left out")
            elif self.tally.n_bad == TOLD + 1:
                warn(problem.code, "further lines that are no samples are counted, and told at the end")
            return None

    def _is_long_gap(self, memory: Memory, sample: Sample) -> bool:
        """A linear model is sampled exactly over any gap."""
        if self.online.kind in ("time-varying", "stationary") or not math.isfinite(memory.time):
            return False
        return bool(sample.time - memory.time > LONG_GAP * self.period)

    def _keep(self, memory: Memory) -> None:
        if self.state is None or not math.isfinite(memory.time):
            return
        import numpy as np

        with (
            whole_file(self.state, "name another file with --state") as temporary,
            temporary.open("wb") as file,
        ):
            np.savez(file, digest=np.array(self.digest), **self.online.stored(memory))  # type: ignore[arg-type]

    def _kept(self) -> Memory:
        """The memory of --state, or that before the first sample. Raises ConfigError `stream-state`."""
        if self.state is None or not self.state.exists():
            return self.online.begin()
        import numpy as np

        try:
            with np.load(self.state, allow_pickle=False) as arrays:
                found = {name: arrays[name] for name in arrays.files}
            if str(found.pop("digest", "")) != self.digest:
                raise ValueError("it belongs to another model, fit or kind of filter")
            memory = self.online.restored(found)
        except Exception as problem:  # a damaged file can fail in any way
            raise ConfigError(
                "stream-state",
                f"the memory of the filter cannot be taken up: {str(problem).splitlines()[0]}",
                where=Place(str(self.state)),
                remedy="remove the file to start anew, or name another with --state",
            ) from problem
        note(f"going on after {memory.time:g} s, as {self.state} has it")
        return memory


def open_stream(
    project: Project,
    model: Path | None,
    model_options: ModelOptions,
    data_options: DataOptions,
    data: Path | None,
    measure: Sequence[str],
    kind: Any,
    options: StreamOptions,
    settings: Mapping[str, float] | None = None,
) -> Stream:
    """Read the model with its fit, and the begin of the stream, and make the filter.

    Raises ConfigError `stream-option`, DataError of the header, `stream-empty`, and what `online_filter`
    raises."""
    from daest.cli.models import with_settings
    from daest.cli.recordings import signals, words_of
    from daest.data.stream import line_format
    from daest.estimation.streaming.online_filter import online_filter
    from daest.model.estimates import FilterOptions
    from daest.modelica.change import with_outputs

    _refuse(data_options, kind)
    flat, hold = _with_its_fit(project, model, model_options, data_options)
    flat = with_settings(flat, settings or {})
    source = source_name(data)
    lines = lines_of(data, options.idle)
    number, header = next(lines, (0, ""))
    if not number:
        raise _empty(source, "no line came")
    names = signals(flat, project)
    form = line_format(header, source, *names, **words_of(project, flat), number=number)
    for name in measure:
        if name not in form.output_names:
            raise EstimationError(
                "filter-unknown-output",
                f"the stream has no output {name} of the model",
                where=name,
                remedy=f"it has {', '.join(form.output_names)}",
            )
    form = form.with_outputs(list(dict.fromkeys(measure)) or form.output_names)
    flat = with_outputs(flat, form.output_names)
    first = [] if form.separator is not None else [(number, header)]
    period = options.step
    if period is None:
        first, period = _two(form, first, lines)
    online = online_filter(flat, period, kind, FilterOptions(hold=hold))
    for text in online.notes:
        note(text)
    described = json.dumps(
        [online.kind, list(online.names), list(online.output_names), hold,
         [p.value for p in flat.parameters], [w.intensity for w in flat.noises],
         [y.noise_std for y in flat.outputs]]
    )  # fmt: skip
    digest = sha256(described.encode()).hexdigest()[:32]
    return Stream(
        flat, online, form, tuple(first), lines, options.state, Tally(), digest, period, project, hold
    )


def _with_its_fit(
    project: Project, model: Path | None, model_options: ModelOptions, data_options: DataOptions
) -> tuple[Model, Any]:
    """The model with its fit, if there is one, and the hold of its inputs."""
    from daest.cli.models import model_source
    from daest.cli.results import with_fit

    source = model_source(project, model)
    flat, fit = with_fit(project, source, model_options.load(project, source))
    return flat, data_options.chosen_hold(project, flat, (), fit.document if fit else None)


@contextmanager
def told_at_the_end(tally: Tally) -> Iterator[None]:
    """The sentence of the tally on stderr, whatever ends the stream."""
    try:
        yield
    finally:
        note(tally.sentence())


def needs_stream(options: StreamOptions) -> None:
    """Refuse options of a stream where there is none. Raises ConfigError `stream-option`."""
    given = {"--state": options.state, "--step": options.step, "--idle": options.idle}
    wrong = [name for name, value in given.items() if value is not None]
    if wrong:
        raise ConfigError(
            "stream-option",
            f"{', '.join(wrong)} belongs to a stream",
            remedy="add --follow, or leave it out",
        )


def refuse_whole(options: Mapping[str, bool]) -> None:
    """Refuse options, by name and whether they were given, that need a whole recording. Raises ConfigError
    `stream-option`."""
    wrong = [name for name, is_given in options.items() if is_given]
    if wrong:
        raise ConfigError(
            "stream-option",
            f"{', '.join(wrong)} needs a whole recording, and a stream has none",
            remedy="leave it out, or filter the recording without --follow",
        )


def _refuse(options: DataOptions, kind: Any) -> None:
    given = {
        "--from": options.start, "--to": options.stop, "--resample": options.period,
        "--detrend": options.detrend,
    }  # fmt: skip
    refuse_whole(
        {**{name: value is not None for name, value in given.items()}, "--kind particle": kind == "particle"}
    )


def _two(
    form: LineFormat, first: list[tuple[int, str]], lines: Iterator[tuple[int, str]]
) -> tuple[list[tuple[int, str]], float]:
    """Lines up to the second sample, and the step between the first two. Raises DataError `stream-empty`."""
    times: list[float] = []
    kept: list[tuple[int, str]] = []
    for number, line in chain(first, lines):
        kept.append((number, line))
        try:
            now = form.sample(line, number).time
        except DataError:
            if len(kept) > TOLD:
                break
            continue
        if times and now > times[-1]:
            return kept, now - times[-1]
        times.append(now)
    raise _empty(
        form.source, f"{len(kept)} lines came, and not two samples among them from which to know the step"
    )


def _empty(source: str, what: str) -> DataError:
    return DataError(
        "stream-empty",
        what,
        where=Place(source),
        remedy="a stream begins with a CSV header (time, inputs, outputs) or with JSON objects that have "
        "these "
        "keys; the expected step can be given with --step",
    )


def write_estimates(stream: Stream, only: Sequence[str], form: str) -> None:
    """One line per sample to stdout, flushed: CSV with a header, or JSON objects.

    Raises EstimationError `filter-unknown-variable`."""
    from daest.report.documents.filter import chosen_columns

    online = stream.online
    shown = chosen_columns(online.names, list(only) or None)
    names = [online.names[i] for i in shown]
    innovations = [f"innovation.{name}" for name in online.output_names]
    if form == "text":
        columns = chain.from_iterable((name, f"{name}.std") for name in names)
        _print(_csv_line(["time", *columns, *innovations, "nis"]))
    for one in stream.followed():
        e = one.estimate
        pairs = list(chain.from_iterable((e.values[i], e.std[i]) for i in shown))
        if form == "text":
            cells = (_cell(v) for v in (*pairs, *e.innovations, e.nis))
            _print(",".join((f"{e.time:.12g}", *cells)))
            continue
        content = {
            "time": e.time,
            "estimates": {
                n: {"value": _number(v), "std": _number(s)}
                for n, v, s in zip(names, pairs[::2], pairs[1::2], strict=True)
            },
            "innovations": dict(zip(online.output_names, map(_number, e.innovations), strict=True)),
            "nis": _number(e.nis),
            "log_likelihood": _number(e.log_likelihood),
        }
        _print(json.dumps(content, ensure_ascii=False))


def _number(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _cell(value: float) -> str:
    return f"{value:.12g}" if math.isfinite(value) else ""


def _csv_line(cells: Sequence[str]) -> str:
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="").writerow(cells)
    return buffer.getvalue()


def _print(line: str) -> None:
    """To stdout at once. A reader that has gone ends the command (BrokenPipeError)."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()
