"""Detect faults of one column from its values: saturation, a stuck sensor, outliers, drop-outs.

Every rule looks for something that a healthy signal does not do. Where rest, steps or the limits of a
command look the same as a fault, no finding is reported.

Time stamps have faults of their own: duplicates, steps back, gaps, jumps, jitter. Two columns may hold the
same quantity, or a motion and its rate, late or upside down; machines lag and turn things round, too, so
that what pairs show are notes, not warnings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from daest.data.limits import DATA
from daest.lists import first_few
from daest.model.experiment import Finding, Level, Role
from daest.quantities import converts

NEXT_LEVELS = 5  # beside a limit, that it is compared with
NEIGHBOURS = 12  # samples on either side of a spike
SPAN = 4  # samples of a third difference
WRITTEN_DECIMALS = 6  # at most, of a reading
FEWEST_DROPS = 3  # to one and the same value
MOST_STRETCHES = 5  # of a fault, whose times are told


@dataclass(frozen=True)
class Samples:
    """The finite values (n,) of a column at their times, in `clock`; `driven` (n,) says when an input of
    the model was not zero, None where no input is known."""

    name: str
    role: Role | None
    time: np.ndarray
    values: np.ndarray
    driven: np.ndarray | None = None
    clock: str = "s"

    def part(self, kept: np.ndarray) -> Samples:
        """Those that are `kept`, (n,) of bool: these themselves, with what is known of them, if all are."""
        if np.all(kept):
            return self
        driven = None if self.driven is None else self.driven[kept]
        return replace(self, time=self.time[kept], values=self.values[kept], driven=driven)

    @cached_property
    def levels(self) -> tuple[np.ndarray, np.ndarray]:
        """Different values, and how often each stands."""
        return np.unique(self.values, return_counts=True)

    @cached_property
    def runs(self) -> tuple[np.ndarray, np.ndarray]:
        """First index and length of every run of equal values."""
        return equal_runs(self.values)

    @cached_property
    def steps(self) -> np.ndarray:
        """Sizes of the changes from sample to sample, without those that are none."""
        steps = np.abs(np.diff(self.values))
        return steps[steps > 0]

    @cached_property
    def large_step(self) -> float:
        """The size that nine of ten changes do not reach."""
        return float(np.quantile(self.steps, 0.9))

    @cached_property
    def spikes(self) -> tuple[np.ndarray, float]:
        """What a median filter of five samples takes away, and the size beyond which it is a spike."""
        from scipy.ndimage import median_filter

        rest = self.values - median_filter(self.values, 5, mode="nearest")
        sizes = np.abs(rest)
        usual = 1.4826 * float(np.median(sizes))
        # Not between two values: among few samples the next one may be the spike.
        rare = max(float(np.quantile(sizes, 1 - DATA.rare, method="lower")), self.resolution or 0.0)
        return rest, max(DATA.spike * usual, DATA.spike_beyond * rare)

    @cached_property
    def resolution(self) -> float | None:
        """Distance of the lattice on which the values stand; None where they do not. Steps of a converter
        that are written with a few digits are equal to the last of these alone."""
        gaps = np.diff(self.levels[0])
        if gaps.size == 0:
            return None
        smallest = float(np.quantile(gaps, 0.05))
        digit = last_digit(self.levels[0])
        if digit > DATA.digit_of_step * smallest:
            digit = 0.0
        step = float(np.mean(gaps[gaps <= smallest + 2.0 * digit])) if digit else smallest
        ratio = gaps / step
        off = np.maximum(np.abs(ratio - np.round(ratio)) - digit / step, 0.0)
        return step if float(np.max(off / np.maximum(ratio, 1.0))) < DATA.lattice else None

    @cached_property
    def noise(self) -> float | None:
        """Standard deviation of white noise on the signal; None where none shows, or times are uneven."""
        if unevenness(self.time) > DATA.uneven_clock:
            return None
        moving = self.values[np.append(True, np.diff(self.values) != 0)]
        third = np.diff(moving, 3)
        if third.size < DATA.told_values:
            return None
        changes = float(np.mean(third[1:] * third[:-1] < 0))
        # The third difference of white noise has 20 times its variance.
        size = 1.4826 * float(np.median(np.abs(third))) / np.sqrt(20.0)
        step = self.resolution or 0.0
        least = max(
            DATA.noise_steps * step, DATA.written_digits * float(np.quantile(np.abs(self.values), 0.99))
        )
        return size if changes > DATA.white_changes and size > least else None


def equal_runs(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First index and length of every run of equal values (n,)."""
    starts = np.append(0, np.nonzero(np.diff(values))[0] + 1)
    return starts, np.diff(np.append(starts, values.size))


def last_digit(values: np.ndarray) -> float:
    """What one is worth in the last decimal with which the values (n,) are written; zero where they have more
    decimals than anybody writes of a reading."""
    for decimals in range(WRITTEN_DECIMALS + 1):
        if np.all(np.abs(values - np.round(values, decimals)) < 1e-9 * np.maximum(np.abs(values), 1e-3)):
            return float(10.0**-decimals)
    return 0.0


def column_findings(samples: Samples, n_missing: int) -> list[Finding]:
    """What is wrong with a column of which `n_missing` further values are missing."""
    is_absurd = absurd(samples.values)
    if np.any(is_absurd):
        rest = samples.part(~is_absurd)
        return [_absurd_finding(samples, is_absurd), *column_findings(rest, n_missing)]
    found = _missing(samples, n_missing)
    n_levels = samples.levels[0].size
    if n_levels == 1:
        level: Level = "warning" if samples.role == "output" else "note"
        text = f"is constant at {samples.values[0]:.6g}"
        return [*found, Finding("check-constant", level, samples.name, text)]
    if samples.values.size < DATA.told_values:
        return found
    if n_levels <= DATA.switch_levels:
        return found if samples.role == "input" else found + _outliers(samples, beyond_all=True)
    if samples.role == "input":
        return found + _saturation(samples)
    # A value that a signal drops to, or is limited to, is neither an outlier nor where a sensor got stuck.
    special = _drops(samples) or _saturation(samples)
    spikes = [] if special and special[0].code == "check-dropouts" else _outliers(samples)
    bursts = [] if special or spikes else _bursts(samples)
    return [*found, *special, *spikes, *bursts, *([] if special else _stuck(samples)), *_coarse(samples)]


def absurd(values: np.ndarray) -> np.ndarray:
    """Which of the values (n,) no signal of their kind takes: single ones beyond all others by orders of
    magnitude. Commands and pulses stay within these."""
    if values.size < DATA.absurd_values:
        return np.zeros(values.size, dtype=bool)
    low, middle, high = np.quantile(values, (0.05, 0.5, 0.95), method="nearest")
    scale = max(high / 2 - low / 2, abs(middle))
    limit = DATA.absurd * scale if 0.0 < scale < DATA.absurd_unit / DATA.absurd else DATA.absurd_unit
    found = np.abs(values / 2 - middle / 2) > limit / 2
    return found if np.count_nonzero(found) <= max(DATA.rare * values.size, 1) else np.zeros_like(found)


def _absurd_finding(samples: Samples, found: np.ndarray) -> Finding:
    first, count = int(np.argmax(found)), int(np.count_nonzero(found))
    text = (
        f"has {count} value(s) beyond all others by orders of magnitude, {samples.values[first]:.6g} at "
        f"{samples.time[first]:.6g} s first; they are left out of what follows"
    )
    return Finding("check-outliers", "warning", samples.name, text, float(samples.time[first]), count)


def _missing(samples: Samples, n_missing: int) -> list[Finding]:
    if not n_missing:
        return []
    share = n_missing / (n_missing + samples.values.size)
    level: Level = "warning" if share > DATA.many_missing or samples.role == "input" else "note"
    text = f"lacks {n_missing} value(s), {100 * share:.2g} %"
    return [Finding("check-missing", level, samples.name, text, count=n_missing)]


def suspected_limits(samples: Samples, pile: float) -> list[Finding]:
    """The limits of a measurement as `column_findings` finds them, but from `pile` times more samples than at
    the next levels on."""
    if (
        samples.values.size < DATA.told_values
        or samples.levels[0].size <= DATA.switch_levels
        or _drops(samples)
    ):
        return []
    return _saturation(samples, pile)


def _saturation(samples: Samples, pile: float = DATA.limit_pile) -> list[Finding]:
    values, (levels, counts) = samples.values, samples.levels
    found = []
    for at_end, name in ((-1, "upper"), (0, "lower")):
        limit, count = levels[at_end], counts[at_end]
        others = _usual_count(levels, counts) if at_end else _usual_count(-levels[::-1], counts[::-1])
        # Zero is where many signals rest: a flow, the sun, a duty cycle.
        if (
            limit == 0
            or count < max(DATA.switch_levels, DATA.at_limit * values.size)
            or count < pile * others
        ):
            continue
        starts, lengths = samples.runs
        at_limit = (values[starts] == limit) & (lengths >= 2)
        visits = _visits(samples, limit, starts[at_limit])
        if visits < 2 or _edge(samples, starts[at_limit], lengths[at_limit]) < DATA.limit_edge:
            continue
        share = 100 * count / values.size
        text = f"stays at its {name} limit {limit:.6g} in {share:.2g} % of the samples ({visits} times)"
        level: Level = "warning" if samples.role == "output" else "note"
        first = float(samples.time[starts[at_limit][0]])
        found.append(Finding("check-saturation", level, samples.name, text, first, int(count)))
    return found


def _visits(samples: Samples, limit: float, starts: np.ndarray) -> int:
    """How often a signal comes to `limit`, where runs of it begin at `starts` (n,): a signal at rest between
    two steps of its converter flickers from one to the other, and has not left in between."""
    away = np.abs(samples.values - limit) > 1.5 * (samples.resolution or 0.0)
    return int(np.unique(np.cumsum(away)[starts]).size)


def _usual_count(levels: np.ndarray, counts: np.ndarray) -> float:
    """How many samples stand at a level below the last one: in the mean over the next ones, or over the most
    frequent ones near by. A reading that is the mean of a few coarse ones stands at rare levels between."""
    near = counts[:-1][levels[:-1] > levels[-1] - DATA.limit_near * (levels[-1] - levels[0])]
    most = np.sort(near)[-NEXT_LEVELS:] if near.size > NEXT_LEVELS else counts[-1 - NEXT_LEVELS : -1]
    return float(most.mean())


def _edge(samples: Samples, starts: np.ndarray, lengths: np.ndarray) -> float:
    """Median slope just outside the runs, in units of the median step: a signal that comes to rest is slow
    there, a held one has no slope, a clipped one moves as ever."""
    before = starts[starts >= 2]
    ends = starts + lengths
    after = ends[ends < samples.values.size - 1]
    values = samples.values
    slopes = np.append(
        np.abs(values[before - 1] - values[before - 2]), np.abs(values[after + 1] - values[after])
    )
    return float(np.median(slopes) / np.median(samples.steps)) if slopes.size else 0.0


def _stuck(samples: Samples) -> list[Finding]:
    starts, lengths = samples.runs
    values = samples.values
    suspects = np.nonzero(lengths >= DATA.stuck_run)[0]
    if samples.noise is not None:
        equal = (values.size - starts.size - int((lengths[suspects] - 1).sum())) / values.size
        stuck = suspects if equal < DATA.stuck_elsewhere else suspects[:0]
        stuck = stuck[_is_dead(samples, starts[stuck], lengths[stuck])]
    else:
        ends = starts + lengths
        inside = suspects[ends[suspects] < values.size]
        jumps = np.abs(values[ends[inside]] - values[starts[inside]])
        largest = np.sort(samples.steps)[: -max(1, inside.size)].max(initial=np.inf)
        stuck = inside[(jumps > DATA.stuck_jump * largest) & (values[starts[inside]] != 0)]
    stuck = stuck[_is_driven(samples, starts[stuck], lengths[stuck])]
    if not stuck.size:
        return []
    longest = stuck[np.argmax(lengths[stuck])]
    last = starts[longest] + lengths[longest] - 1
    duration = samples.time[last] - samples.time[starts[longest]]
    text = f"stands still at {values[starts[longest]]:.6g} for {duration:.4g} s, every digit the same"
    if stuck.size > 1:
        text += f" ({stuck.size} such stretches)"
    at = float(samples.time[starts[stuck[0]]])
    return [Finding("check-stuck", "warning", samples.name, text, at, int(stuck.size))]


def _is_driven(samples: Samples, starts: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Which runs of equal values, (n_runs,) bool, are not those of a machine at rest: for most of the run
    some input is not zero. Any run, where no input is known."""
    if samples.role != "output" or samples.driven is None:
        return np.ones(starts.size, dtype=bool)
    counts = np.append(0, np.cumsum(samples.driven))
    return (counts[starts + lengths] - counts[starts]) >= DATA.driven_run * lengths


def _is_dead(samples: Samples, starts: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Which runs of equal values, (n_runs,) bool, are those of a dead sensor and not of a machine at rest.

    A machine comes to rest and leaves it in small steps, anywhere in those of its converter; a dead sensor
    falls to zero in a large one, or holds a value from which the machine has gone on: where that is often,
    further than it mostly goes in a step."""
    sizes = np.abs(np.diff(samples.values, prepend=samples.values[0], append=samples.values[-1]))
    into, out_of = sizes[starts], sizes[starts + lengths]
    falls = np.minimum(into, out_of) > DATA.stuck_jump * samples.large_step
    smallest = float(np.quantile(samples.steps, DATA.smallest_steps))
    holds = np.maximum(into, out_of) > DATA.held_jump * smallest
    if starts.size > DATA.often_held and np.median(out_of) < DATA.held_often * samples.large_step:
        holds[:] = False
    return np.where(samples.values[starts] == 0, falls, holds)


def _outliers(samples: Samples, beyond_all: bool = False) -> list[Finding]:
    """Single samples that stand off while their neighbours agree; `beyond_all`: far from all others, as must
    be in a signal with few levels, which is a switch or a sensor with large steps."""
    rest, limit = samples.spikes
    values = samples.values
    spikes = np.nonzero(np.abs(rest) > limit)[0]
    spikes = spikes[(spikes >= 2) & (spikes < values.size - 2)]
    # The values on both sides must agree: an edge is no spike.
    apart = np.abs(values[spikes + 2] - values[spikes - 2])
    spikes = spikes[apart < DATA.neighbours_agree * np.abs(rest[spikes])]
    spikes = np.array(
        [i for i in spikes if abs(rest[i]) > DATA.spike_steps * _steps_around(values, i)], dtype=int
    )
    if beyond_all and spikes.size:
        others = np.delete(values, spikes)
        low, high = float(others.min()), float(others.max())
        off = np.maximum(low - values[spikes], values[spikes] - high)
        spikes = spikes[off > DATA.spike_beyond * (high - low)]
    if not spikes.size or spikes.size > max(DATA.rare * values.size, 1):
        return []
    worst = spikes[np.argmax(np.abs(rest[spikes]))]
    at = f"{samples.time[worst]:.6g} {samples.clock}"
    text = f"has {spikes.size} outlier(s), the largest {values[worst]:.6g} at {at}"
    return [
        Finding("check-outliers", "warning", samples.name, text, float(samples.time[spikes[0]]), spikes.size)
    ]


def _bursts(samples: Samples) -> list[Finding]:
    """Stretches in which a signal with visible noise jumps to and fro much further than elsewhere, and goes
    on as before: of a loose plug, or a radio beside the cable. Such spikes, beside each other, pass a median
    filter. Steps and impacts of a machine show in few third differences."""
    if samples.noise is None:
        return []
    third = np.diff(samples.values, 3) / np.sqrt(20.0)
    sizes = np.abs(third)
    loud = _stretches(np.flatnonzero(sizes > DATA.spike * samples.noise))
    found = [p for p in loud if _is_burst(third, p) and _turns_back(samples.values, p)]
    inside = np.zeros(sizes.size, dtype=bool)
    for part in found:
        inside[part[0] : part[-1] + 1] = True
    usual = sizes[~inside].max(initial=0.0)
    found = [part for part in found if sizes[part].max() > DATA.spike_beyond * usual]
    stretches = [(int(part[0]) + SPAN - 1, int(part[-1])) for part in found]
    count = sum(last - first + 1 for first, last in stretches)
    if not stretches or count > DATA.burst * samples.values.size:
        return []
    worst = max(float(np.ptp(samples.values[first : last + 1])) for first, last in stretches)
    at = float(samples.time[stretches[0][0]])
    text = f"jumps to and fro by up to {worst:.4g} in {count} samples ({len(stretches)} time(s)), noise "
    text += f"{samples.noise:.3g} elsewhere"
    return [Finding("check-outliers", "warning", samples.name, text, at, count)]


def displaced(samples: Samples, others: Sequence[np.ndarray]) -> list[Finding]:
    """A stretch of an output that is off by far, between a jump and one back while none of the `others`, the
    columns (n,), jumps: of a plug that was touched. A pulse of an input shows in that, and a machine that
    is knocked does not come back in one sample."""
    values, changes = samples.values, np.diff(samples.values)
    if samples.role != "output" or values.size < DATA.told_values:
        return []
    *_, usual, _, _ = np.sort(np.abs(changes))
    first, last = np.sort(np.argsort(np.abs(changes))[-2:])
    jump, back, count = changes[first], changes[last], int(last - first)
    if min(abs(jump), abs(back)) <= DATA.stuck_jump * usual or not SPAN <= count <= DATA.burst * values.size:
        return []
    if abs(jump + back) >= DATA.neighbours_agree * abs(jump):
        return []
    if any(_jumps_at(other, at) for other in others for at in (first, last)):
        return []
    at, end = (float(samples.time[k + 1]) for k in (first, last))
    text = (
        f"is off by {jump:.4g} at {at:.6g} {samples.clock} for {end - at:.4g} {samples.clock}, in {count} "
        "samples between a jump and one back that no other column tells of"
    )
    return [Finding("check-outliers", "warning", samples.name, text, at, count)]


def no_reading_yet(samples: Samples, others: Sequence[np.ndarray]) -> list[Finding]:
    """Zeros with which an output begins and from which it jumps to all that follows, while no input is at
    work and none of the `others`, the columns (n,), jumps: a logger that had no reading yet."""
    values, (starts, lengths) = samples.values, samples.runs
    if samples.role != "output" or values.size < DATA.told_values or starts.size < 2 or values[0] != 0.0:
        return []
    count = int(lengths[0])
    if count > DATA.longest_drop or np.count_nonzero(values == 0.0) > count:
        return []
    changes = np.abs(np.diff(values))
    usual = float(changes[count:].max(initial=0.0))
    if usual == 0.0 or changes[count - 1] <= DATA.stuck_jump * usual:
        return []
    if samples.driven is not None and np.any(samples.driven[:count]):
        return []  # a quick machine, at rest before its input came
    if any(_jumps_at(other, count - 1) for other in others):
        return []
    after = f"{samples.time[count]:.6g} {samples.clock}"
    text = (
        f"begins with 0 in {count} sample(s) and jumps to {values[count]:.6g}, by more than "
        f"{DATA.stuck_jump:g} times as much as ever after, while no input acts: no reading yet? If so, "
        f"begin at {after} (from)"
    )
    return [Finding("check-outliers", "warning", samples.name, text, float(samples.time[0]), count)]


def excursions(samples: Samples, others: Sequence[np.ndarray]) -> list[Finding]:
    """Stretches in which an output runs off and comes back on a smooth way, in steps far larger than all
    others, while none of the `others`, the columns (n,), moves: pulses that were counted twice and smoothed
    afterwards. A machine that is knocked does not go on as before, and an impact is over in a few samples."""
    if samples.role != "output" or samples.steps.size < DATA.told_values:
        return []
    values, sizes = samples.values, np.abs(np.diff(samples.values))
    loud = np.flatnonzero(sizes > DATA.stuck_jump * samples.large_step)
    parts = np.split(loud, np.flatnonzero(np.diff(loud) > 4 * NEIGHBOURS) + 1) if loud.size else []
    parts = [part for part in parts if part[0] >= NEIGHBOURS and part[-1] + 1 + NEIGHBOURS <= sizes.size]
    ends = [(int(part[0]) - NEIGHBOURS, int(part[-1]) + 1 + NEIGHBOURS) for part in parts]
    outside = np.ones(sizes.size, dtype=bool)
    for first, last in ends:
        outside[first:last] = False
    usual = float(sizes[outside].max(initial=0.0))
    found = [
        (int(part[0]) + 1, int(part[-1]))
        for part, (first, last) in zip(parts, ends, strict=True)
        if part.size >= 2 * SPAN
        and sizes[part].max() > DATA.spike_beyond * usual
        and abs(values[last] - values[first])
        < DATA.neighbours_agree * float(np.ptp(values[first : last + 1]))
        and not any(_moves_in(other, first, last) for other in others)
    ]
    count = sum(last - first + 1 for first, last in found)
    if not found or usual == 0.0 or count > DATA.off_in_all * values.size:
        return []
    worst = max(float(np.ptp(values[first : last + 1])) for first, last in found)
    times = samples.time
    told = [f"{times[a]:.6g} to {times[b]:.6g} {samples.clock}" for a, b in found]
    where = first_few(told, MOST_STRETCHES)
    text = f"runs off and back by up to {worst:.4g} in {count} samples ({where}), "
    text += f"where it moves by no more than {usual:.3g} from sample to sample elsewhere"
    return [Finding("check-outliers", "warning", samples.name, text, float(samples.time[found[0][0]]), count)]


def _moves_in(values: np.ndarray, first: int, last: int) -> bool:
    """Whether a column (n,) moves by much of its range from sample `first` to `last`. What is missing may
    have."""
    known, part = values[np.isfinite(values)], values[first : last + 1]
    reach = DATA.jump_beside * (float(np.ptp(known)) if known.size else 0.0)
    return not np.all(np.isfinite(part)) or (reach > 0.0 and float(np.ptp(part)) >= reach)


def _jumps_at(values: np.ndarray, at: int) -> bool:
    """Whether a column (n,) moves by much of its range from sample `at` on, or one sample beside that. What
    is missing may have."""
    known = values[np.isfinite(values)]
    reach = DATA.jump_beside * (float(np.ptp(known)) if known.size else 0.0)
    there = np.abs(np.diff(values))[max(at - 1, 0) : at + 2]
    return not np.all(np.isfinite(there)) or bool(np.any(there[there > 0.0] >= reach))


def _stretches(loud: np.ndarray) -> list[np.ndarray]:
    """The indices `loud` (n,) of third differences, ascending, in groups of those that share samples: such
    a difference spans four."""
    return np.split(loud, np.flatnonzero(np.diff(loud) > SPAN) + 1) if loud.size else []


def _turns_back(values: np.ndarray, loud: np.ndarray) -> bool:
    """Whether the values at `loud` third differences go to and fro: a sensor that is refreshed at every
    second sample jumps at each of those, and goes on in one direction, as the machine does."""
    part = values[loud[0] : loud[-1] + SPAN]
    way = float(np.sum(np.abs(np.diff(part))))
    return abs(float(part[-1] - part[0])) < DATA.goes_on * way


def _is_burst(third: np.ndarray, loud: np.ndarray) -> bool:
    """Whether white noise alone makes the third differences at `loud`: many after each other, mostly of other
    signs. A step or an impact makes as many as one difference spans, at most."""
    inside = third[loud[0] : loud[-1] + 1]
    return loud.size >= 2 * SPAN and float(np.mean(inside[1:] * inside[:-1] < 0)) > DATA.white_changes


def _steps_around(values: np.ndarray, i: int) -> float:
    """The largest step among the neighbours of sample `i`, the two on either side left out."""
    before, after = values[max(0, i - NEIGHBOURS) : i - 1], values[i + 2 : i + 1 + NEIGHBOURS]
    return float(max(np.abs(np.diff(part)).max(initial=0.0) for part in (before, after)))


def _drops(samples: Samples) -> list[Finding]:
    """Short visits to one and the same value, far from what stands before and after. How far signals jump is
    told without that value: drops that are many are no rare samples."""
    values, counts = samples.levels
    return _drops_beyond(samples, samples) or [
        found
        for level, count in ((values[0], counts[0]), (values[-1], counts[-1]))
        if FEWEST_DROPS <= count <= DATA.many_drops * samples.values.size
        for found in _drops_beyond(samples, samples.part(samples.values != level))
    ]


def _drops_beyond(samples: Samples, usual: Samples) -> list[Finding]:
    """Such visits, farther than the `usual` samples jump."""
    starts, lengths = samples.runs
    levels = samples.values[starts]
    edges = np.abs(np.diff(levels))
    depth = np.minimum(edges[:-1], edges[1:])
    deep = depth > DATA.spike_beyond * usual.large_step
    if np.count_nonzero(deep) < FEWEST_DROPS:  # before the sizes of spikes, which take long to find
        return []
    deep &= depth > usual.spikes[1]
    inner = 1 + np.flatnonzero(deep & (lengths[1:-1] <= DATA.longest_drop))
    starts, lengths, depth = starts[inner], lengths[inner], depth[inner - 1]
    before, there, after = levels[inner - 1], levels[inner], levels[inner + 1]
    dropped = np.abs(after - before) < DATA.neighbours_agree * depth
    targets, counts = np.unique(there[dropped], return_counts=True)
    if not targets.size or counts.max() < FEWEST_DROPS or counts.max() < 0.8 * counts.sum():
        return []
    target = targets[np.argmax(counts)]
    which = dropped & (there == target)
    text = f"drops out to {target:.6g} {counts.max()} times, {int(lengths[which].sum())} samples in all"
    first = float(samples.time[starts[which][0]])
    return [Finding("check-dropouts", "warning", samples.name, text, first, int(counts.max()))]


def _coarse(samples: Samples) -> list[Finding]:
    step = samples.resolution
    if step is None or float(np.mean(samples.steps < 1.5 * step)) < DATA.single_steps:
        return []
    low, high = samples.levels[0][[0, -1]]
    n_steps = round((high - low) / step)
    level: Level = "warning" if n_steps < DATA.coarse else "note"
    text = f"is quantised in steps of {step:.4g}, {n_steps} in its range: its errors are no white noise"
    return [Finding("check-quantised", level, samples.name, text, count=n_steps)]


def clock_findings(time: np.ndarray, clock: str = "s") -> list[Finding]:
    """What is wrong with the times (n_samples,) in `clock`, NaN where a row has none."""
    known = time[np.isfinite(time)]
    found = _unreadable_times(time, known)
    steps = np.diff(known)
    found += _order(known, steps)
    forward = steps > 0
    if forward.sum() < DATA.clock_steps:
        return found
    step = float(np.median(steps[forward]))
    spread = unevenness(known)
    found += _long_steps(known, steps, step, spread, clock)
    if spread > DATA.uneven_clock:
        low, high = np.quantile(steps[forward], [0.01, 0.99])
        text = f"ticks unevenly: steps of {low:.4g} {clock} to {high:.4g} {clock}, median {step:.4g} {clock}"
        found.append(Finding("check-clock-jitter", "note", None, text))
    else:
        found += _rate(known, steps)
    return found


def unevenness(time: np.ndarray) -> float:
    """Spread of the steps of increasing times (n_samples,), relative to their median: that of the more uneven
    half, because a clock that changes its rate once is even before and after. A step over samples that were
    lost counts as so many."""
    steps = np.diff(time)
    steps = steps[steps > 0]
    if steps.size:
        with np.errstate(over="ignore"):  # times may be anything
            steps = steps / np.maximum(np.round(steps / np.median(steps)), 1.0)
    halves = np.array_split(steps, 2)
    quantiles = [np.quantile(half, [0.05, 0.5, 0.95]) for half in halves if half.size]
    return max((float(0.5 * (high - low) / step) for low, step, high in quantiles), default=0.0)


def _unreadable_times(time: np.ndarray, known: np.ndarray) -> list[Finding]:
    n = time.size - known.size
    return [Finding("check-clock-order", "warning", None, f"is missing in {n} row(s)", count=n)] if n else []


def _order(time: np.ndarray, steps: np.ndarray) -> list[Finding]:
    found = []
    for code, which, text in (
        ("check-clock-duplicate", steps == 0, "stands still in {} row(s): two samples have one time"),
        ("check-clock-order", steps < 0, "goes back {} time(s)"),
    ):
        rows = np.nonzero(which)[0]
        if rows.size:
            at = float(time[rows[0] + 1])
            said = text.format(rows.size) + (
                _rounding(time, steps) if code == "check-clock-duplicate" else ""
            )
            found.append(Finding(code, "warning", None, said, at, int(rows.size)))
    return found


def _rounding(time: np.ndarray, steps: np.ndarray) -> str:
    """What to do about times that were written with too few digits for the samples; else nothing."""
    later = steps[np.argmax(steps == 0) :]
    is_still = later == 0
    unit = float(np.median(later[~is_still])) if not is_still.all() else 0.0
    if unit <= 0 or np.mean(is_still) < DATA.rounded_stamps:
        return ""
    whole = later / unit
    if np.mean(np.abs(whole - np.round(whole)) < DATA.grid) < 1.0 - DATA.rounded_stamps:
        return ""
    apart = float(time[-1] - time[0]) / steps.size
    return (
        f"; the times are written in steps of {unit:.3g}, too coarse for samples that are {apart:.3g} apart: "
        "number the rows instead, and multiply by that"
    )


def _long_steps(time: np.ndarray, steps: np.ndarray, step: float, spread: float, clock: str) -> list[Finding]:
    jumps = np.nonzero(steps > DATA.pause * step)[0]
    found = []
    if jumps.size:
        text = (
            f"jumps by {steps[jumps].max():.4g} {clock} where a step is {step:.4g} {clock}: "
            "a pause, or two recordings"
        )
        found.append(
            Finding("check-clock-jump", "warning", None, text, float(time[jumps[0]]), int(jumps.size))
        )
    long = np.flatnonzero((steps >= 1.5 * step) & (steps <= DATA.pause * step))
    ratio = steps[long] / step
    whole = np.round(ratio)
    is_gap = (whole >= 2) & (np.abs(ratio - whole) < DATA.lost_samples)
    gaps = long[is_gap]
    if gaps.size and spread < DATA.uneven_clock:
        lost = int(np.sum(whole[is_gap] - 1))
        text = (
            f"leaves out about {lost} sample(s) in {gaps.size} gap(s), "
            f"the longest {steps[gaps].max():.4g} {clock}"
        )
        found.append(Finding("check-clock-gap", "warning", None, text, float(time[gaps[0]]), int(gaps.size)))
    return found


def _usual_step(steps: np.ndarray) -> float:
    """Mean of the steps, (n,) s, without gaps: the median of those of 0.2 and 0.21 s is one by chance."""
    going = steps[steps > 0]
    return float(np.mean(going[going < 1.5 * np.median(going)]))


def _rate(time: np.ndarray, steps: np.ndarray) -> list[Finding]:
    middle = steps.size // 2
    first, second = _usual_step(steps[:middle]), _usual_step(steps[middle:])
    if abs(first - second) <= DATA.clock_drift * min(first, second):
        return []
    text = f"changes its rate: a step is {first:.4g} s in the first half and {second:.4g} s in the second"
    return [Finding("check-clock-rate", "warning", None, text, float(time[middle]))]


MOST_COLUMNS = 16  # that are compared with each other
ENOUGH = 20_000  # samples that tell whether a column is computed
LONGEST = 200_000  # samples of columns that are compared


@dataclass(frozen=True)
class Series:
    """Values (n,) without gaps on a uniform grid of times, and their unit."""

    name: str
    unit: str
    values: np.ndarray


def pair_findings(series: Sequence[Series], period: float, clock: str = "s") -> list[Finding]:
    """Lags and opposite signs between the columns, sampled every `period` in `clock`, and columns that are
    computed from others."""
    shown = [s for s in series if s.values.size <= LONGEST and np.ptp(s.values) > 0][:MOST_COLUMNS]
    found = [finding for a, b in combinations(shown, 2) for finding in _computed(a, b, period, clock)]
    for a, b in combinations([s for s in shown if s.unit], 2):
        if converts(a.unit, b.unit):
            found += _compared(a, b, _centred(a.values), _centred(b.values), "", period, clock)
        elif converts(f"({a.unit})/s", b.unit):
            found += _compared(a, b, *_with_integral(a, b), "the rate of ", period, clock)
        elif converts(f"({b.unit})/s", a.unit):
            found += _compared(b, a, *_with_integral(b, a), "the rate of ", period, clock)
    return found


def _computed(a: Series, b: Series, period: float, clock: str) -> list[Finding]:
    """A column that holds nothing new beside another one: the same values, scaled or late, or the difference
    quotients of them."""
    a, b = replace(a, values=a.values[:ENOUGH]), replace(b, values=b.values[:ENOUGH])
    if min(np.unique(a.values).size, np.unique(b.values).size) < DATA.paired_samples:
        return []  # a switch or a constant
    for early, late in ((a, b), (b, a)):
        if _is_difference(early.values, late.values):
            return [_nothing_new(late, f"is the difference quotient of {early.name}, computed")]
    x, y = _centred(a.values), _centred(b.values)
    lags, correlation = _correlation(x, y)
    lag = int(lags[np.argmax(np.abs(correlation))])
    n = x.size - abs(lag)
    if n < DATA.paired_samples or _left(x[max(-lag, 0) :][:n], y[max(lag, 0) :][:n]) > DATA.computed:
        return []
    late, early = (b, a) if lag >= 0 else (a, b)
    after = f", {abs(lag) * period:.4g} {clock} late" if lag else ""
    return [_nothing_new(late, f"is a copy of {early.name}{after}")]


def _nothing_new(column: Series, what: str) -> Finding:
    text = (
        f"{what}: it holds nothing new; as two outputs they would be counted twice, and an input that is one "
        "of an output is made by a controller (a closed loop)"
    )
    return Finding("check-computed", "note", column.name, text)


def _is_difference(motion: np.ndarray, rate: np.ndarray) -> bool:
    """Whether the rate is the difference of the motion: forward, backward, or over two steps."""
    steps = np.diff(motion)
    pairs = ((steps, rate[:-1]), (steps, rate[1:]), (motion[2:] - motion[:-2], rate[1:-1]))
    return steps.size > DATA.paired_samples and any(_left(x, y) < DATA.computed for x, y in pairs)


def _left(x: np.ndarray, y: np.ndarray) -> float:
    """Share of the standard deviation of y that a straight line of x leaves; 1 where one of them is
    constant."""
    x, y = _centred(x), _centred(y)
    sizes = np.linalg.norm(x), np.linalg.norm(y)
    if not min(sizes) > 0.0:
        return 1.0
    return float(np.linalg.norm(y / sizes[1] - x / sizes[0] * np.sign(x @ y)))


def _with_integral(motion: Series, rate: Series) -> tuple[np.ndarray, np.ndarray]:
    """The motion and the integral of the rate, both without their trend: an offset of the rate drifts."""
    integral = np.append(0.0, np.cumsum(0.5 * (rate.values[1:] + rate.values[:-1])))
    return _detrended(motion.values), _detrended(integral)


def _compared(
    a: Series, b: Series, x: np.ndarray, y: np.ndarray, how: str, period: float, clock: str
) -> list[Finding]:
    lags, correlation = _correlation(x, y)
    best = int(np.argmax(np.abs(correlation)))
    at_best, at_zero = float(correlation[best]), float(correlation[np.nonzero(lags == 0)[0][0]])
    found: list[Finding] = []
    if at_best**2 < DATA.same_columns:
        return found
    if at_best < 0:
        text = f"is {how}{a.name} with the opposite sign"
        found.append(Finding("check-polarity", "note", b.name, text))
    if lags[best] != 0 and 1 - at_best**2 < DATA.better_lag * (1 - at_zero**2):
        late, early = (b, a) if lags[best] > 0 else (a, b)
        by = f"{abs(lags[best]) * period:.4g} {clock}"
        text = f"follows {early.name} by {by}: the machine, or clocks that differ"
        found.append(Finding("check-lag", "note", late.name, text))
    return found


def _correlation(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lags (samples by which y is late) and the correlation at each.

    By the transforms of NumPy: `scipy.signal` takes half a second to import."""
    most = max(1, int(DATA.longest_lag * x.size))
    n = 1 << (x.size + y.size - 1).bit_length()  # long enough that the ends do not meet
    whole = np.fft.irfft(np.fft.rfft(y, n) * np.conj(np.fft.rfft(x, n)), n)
    lags = np.arange(-most, most + 1)
    return lags, whole[lags] / (np.linalg.norm(x) * np.linalg.norm(y))


def _centred(values: np.ndarray) -> np.ndarray:
    return values - values.mean()


def _detrended(values: np.ndarray) -> np.ndarray:
    """Without the straight line of least squares."""
    rest, time = _centred(values), _centred(np.arange(values.size, dtype=float))
    return rest - time * (time @ rest) / max(time @ time, 1.0)
