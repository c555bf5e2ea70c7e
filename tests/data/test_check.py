"""The data check: faults that are put into simulated recordings are seen, and healthy recordings give no
warning."""

import re

import numpy as np
import pytest
from scipy.signal import chirp, lfilter, lsim

from daest.data.check import check_experiment, check_table
from daest.data.faults import Samples, clock_findings, column_findings
from daest.data.read import read_table
from daest.data.table import Column, Table
from daest.model.experiment import Experiment

PERIOD = 0.01
N = 4000


def excitation(kind, rng, n=N):
    time = PERIOD * np.arange(n)
    if kind == "multisine":
        phases = rng.uniform(0, 2 * np.pi, 12)
        return np.sum(
            [np.sin(2 * np.pi * f * time + p) for f, p in zip(np.arange(1, 13) / 4, phases, strict=True)],
            axis=0,
        )
    if kind == "binary":
        return np.repeat(rng.choice([-1.0, 1.0], n // 20 + 1), 20)[:n]
    if kind == "steps":
        return np.repeat(rng.normal(size=n // 100 + 1), 100)[:n]
    if kind == "chirp":
        return chirp(time, 0.1, time[-1], 8.0)
    if kind == "noise":
        return lfilter([0.2], [1, -0.8], rng.normal(size=n))
    return np.where((time > 5) & (time < 25), np.sin(time), 0.0)  # rest, motion, rest


def response(u, rng):
    """Position and speed of a damped oscillator under `u`, by scipy."""
    w, d = rng.uniform(3, 15), rng.uniform(0.1, 0.8)
    time = PERIOD * np.arange(u.size)
    system = ([[0, 1], [-(w**2), -2 * d * w]], [[0], [w**2]], np.eye(2), np.zeros((2, 1)))
    return lsim(system, u, time)[1].T


def friction(u):
    """Position and speed of a mass that stands still until the force exceeds the friction."""
    x, v = np.zeros(u.size), np.zeros(u.size)
    for i in range(1, u.size):
        force = 4 * u[i - 1] - np.sign(v[i - 1]) * 1.5 - 0.5 * v[i - 1]
        stands = v[i - 1] == 0 and abs(4 * u[i - 1]) < 1.5
        new = (
            0.0
            if stands
            else v[i - 1] + PERIOD * (force if v[i - 1] else 4 * u[i - 1] - np.sign(u[i - 1]) * 1.5)
        )
        v[i] = 0.0 if v[i - 1] * new < 0 else new
        x[i] = x[i - 1] + PERIOD * v[i]
    return x, v


KINDS = ("multisine", "binary", "steps", "chirp", "noise", "rest")


def healthy(seed):
    """Columns of a recording without fault, as sensors and recorders of many sorts write it."""
    rng = np.random.default_rng(seed)
    u = excitation(KINDS[seed % len(KINDS)], rng)
    position, speed = friction(u) if seed % 4 == 3 else response(u, rng)
    columns = {"u": u}
    for name, clean in (("position", position), ("speed", speed)):
        size = np.ptp(clean)
        noisy = clean + rng.choice([0.0, 0.001, 0.01, 0.05]) * size * rng.normal(size=N)
        counts = rng.choice([0, 256, 4096, 65536])
        columns[name] = np.round(noisy / (size / counts)) * (size / counts) if counts else noisy
    digits = rng.choice([6, 9, 16])
    return {name: np.array([float(f"{v:.{digits}g}") for v in values]) for name, values in columns.items()}


def warnings_of(columns, time=None, roles=None):
    time = PERIOD * np.arange(N) if time is None else time
    table = Table(
        "run.csv", (Column("time", "s", time), *(Column(n, None, v) for n, v in columns.items())), None
    )
    return check_table(table, roles or {"u": "input", "position": "output", "speed": "output"}).warnings


def false_alarms(seeds):
    return {seed: [f.sentence for f in found] for seed in seeds if (found := warnings_of(healthy(seed)))}


def test_healthy_recordings_give_no_warning():
    assert not false_alarms(range(12))


@pytest.mark.slow
def test_rate_of_false_warnings():
    """With 0 of 600, at most 0.5 % of such recordings are warned of (95 %)."""
    alarms = false_alarms(range(1000, 1600))
    assert not alarms, alarms


def clipped(y, rng):
    limit = np.quantile(y, 0.93)
    return np.minimum(y, limit)


def stuck(y, rng):
    at = rng.integers(1000, 2500)
    y[at : at + 300] = y[at]
    return y


def spiked(y, rng):
    y[rng.choice(np.arange(100, N - 100), 5, replace=False)] += 2 * np.ptp(y)
    return y


def dropped(y, rng):
    value = -3 * np.ptp(y)
    for at in rng.choice(np.arange(100, N - 100, 50), 6, replace=False):
        y[at : at + rng.integers(1, 6)] = value
    return y


def often_dropped(y, rng):
    """A plug that is loose: some 2 % of the samples."""
    value = y.min() - np.ptp(y)
    for at in rng.choice(np.arange(100, N - 100, 20), N // 100, replace=False):
        y[at : at + rng.integers(1, 4)] = value
    return y


def coarse(y, rng):
    step = np.ptp(y) / 20
    return np.round(y / step) * step


def lost(y, rng):
    y[1000:2000] = np.nan
    return y


FAULTS = {
    "check-saturation": clipped,
    "check-stuck": stuck,
    "check-outliers": spiked,
    "check-dropouts": dropped,
    "check-missing": lost,
    "check-constant": lambda y, rng: np.full_like(y, 2.5),
}


def noisy_recording(seed, kind="multisine", noise=0.005):
    rng = np.random.default_rng(seed)
    u = excitation(kind, rng)
    y = response(u, rng)[0]
    return rng, u, y + noise * np.ptp(y) * rng.normal(size=N)


@pytest.mark.parametrize("code", FAULTS)
def test_fault_is_seen(code):
    """In every one of ten recordings, and nothing else is said."""
    for seed in range(10):
        rng, u, y = noisy_recording(seed, ("multisine", "noise")[seed % 2])
        found = warnings_of({"u": u, "position": FAULTS[code](y, rng)})
        assert [f.code for f in found] == [code], (seed, found)
        assert found[0].column == "position"


def test_many_drops_are_no_limit():
    for seed in range(10):
        rng, u, y = noisy_recording(seed, ("multisine", "noise")[seed % 2])
        found = warnings_of({"u": u, "position": often_dropped(y, rng)})
        assert [f.code for f in found] == ["check-dropouts"], (seed, found)


def test_coarse_steps_are_seen():
    for seed in range(10):
        rng, u, y = noisy_recording(seed, noise=0.0)
        found = warnings_of({"u": u, "position": coarse(y, rng)})
        assert [(f.code, f.count) for f in found] == [("check-quantised", 20)]


def warmed(step=0.32258, quiet=70, n=600):
    """A thermometer at rest between two steps of its converter, then warmed and left to cool twice, written
    with two decimals; its noise is less than a step."""
    rng = np.random.default_rng(3)
    heats = np.repeat([0.0, 1.0, 0.0, 1.0, 0.0], [quiet, 120, 140, 120, n - 380 - quiet])
    warm = 21.7 + lfilter([0.35], [1.0, -0.985], heats)
    return np.round(np.round((warm + 0.08 * rng.normal(size=n)) / step) * step, 2)


def test_steps_of_a_converter_are_seen_through_the_digits_they_are_written_with():
    samples = Samples("T", "output", 4.0 * np.arange(600), warmed())
    assert samples.resolution == pytest.approx(0.3226, abs=2e-3)
    assert samples.noise is None


def test_rest_between_two_steps_of_a_converter_is_no_limit():
    """The one below is where the machine begins, and it is never colder."""
    samples = Samples("T", "output", 4.0 * np.arange(600), warmed())
    assert "check-saturation" not in [one.code for one in column_findings(samples, 0)]


def test_small_faults_are_found_where_and_as_many_as_they_are():
    _, u, y = noisy_recording(3)
    y[2000] += 60 * 0.005 * np.ptp(y)
    (finding,) = warnings_of({"u": u, "position": y})
    assert finding.code == "check-outliers" and finding.count == 1 and finding.at == pytest.approx(20.0)


def test_a_wrong_pulse_count_of_a_sensor_with_few_steps_is_found_and_a_switch_is_none():
    """A wheel whose speed is told in steps of 8.6 rpm, at rest before it turns; a valve that opens once."""
    rng = np.random.default_rng(0)
    speed = 8.6 * np.round(np.where(np.arange(N) < 300, 0, 10.5 + 0.6 * rng.normal(size=N)))
    valve = np.where(np.arange(N) == 700, 1.0, 0.0)
    assert np.unique(speed).size <= 10
    assert not warnings_of({"speed": speed}) and not warnings_of({"position": valve})
    speed[500] = 1482.0
    (finding,) = warnings_of({"speed": speed})
    assert finding.code == "check-outliers" and finding.count == 1 and finding.at == pytest.approx(5.0)


@pytest.mark.parametrize("is_pulse", [False, True])
def test_a_sensor_that_is_off_for_a_while_is_found_unless_an_input_tells_why(is_pulse):
    """A plug that was touched for 0.4 s; a voltage that falls by as much while a current flows."""
    for seed in range(10):
        rng, u, y = noisy_recording(seed)
        at = int(rng.integers(500, 3000))
        y[at : at + 40] += 4 * np.ptp(y)
        pulse = np.zeros(N)
        pulse[at : at + 40] = 3.0 * is_pulse
        found = warnings_of({"u": pulse if is_pulse else u, "position": y})
        assert [one.code for one in found] == ([] if is_pulse else ["check-outliers"]), (seed, found)
        if not is_pulse:
            assert found[0].count == 40 and found[0].at == pytest.approx(PERIOD * at)


def test_bursts_are_found_where_and_as_many_as_they_are():
    """Spikes beside each other, which a median filter leaves; a ramp goes on meanwhile."""
    for seed in range(10):
        rng, u, y = noisy_recording(seed, ("multisine", "noise")[seed % 2])
        for at in (600, 1500, 2200):
            y[at : at + 12] += np.ptp(y) * rng.normal(size=12)
        (finding,) = warnings_of({"u": u, "position": y})
        assert finding.code == "check-outliers" and finding.at == pytest.approx(6.0, abs=0.05)
        assert 24 <= finding.count <= 40 and "jumps to and fro" in finding.text, (seed, finding)


def test_edges_of_a_sensor_that_is_read_at_every_second_sample_are_no_bursts():
    """A wire that shortens within 25 samples, its length refreshed at every second one."""
    for seed in range(10):
        rng = np.random.default_rng(seed)
        time = np.arange(N // 2) * 2.0
        length = 1000.0 * np.tanh((time - 600.0) / 8.0) - 900.0 * np.tanh((time - 2200.0) / 8.0)
        y = np.repeat(length, 2) + rng.normal(size=N)
        assert not warnings_of({"length": y}), seed


def counted_twice(seed, sizes=(0.4, 0.3, 0.2)):
    """A wheel that runs down, whose pulses are counted twice in three stretches; its speed is smoothed."""
    rng = np.random.default_rng(seed)
    speed = 300.0 * np.exp(-np.arange(N) / rng.uniform(1500, 3000))
    raw = speed + rng.normal(size=N)
    for at, size in zip((500, 1500, 2600), sizes, strict=True):
        raw[at : at + 24] += 300.0 * size * np.repeat(rng.permutation([0.0, 0.0, 1.0, 1.0, 2.0, 2.0]), 4)
    return rng, lfilter([0.15], [1, -0.85], raw - raw[0]) + raw[0]


def test_an_output_that_runs_off_and_back_is_told_with_its_times():
    for seed in range(10):
        _, speed = counted_twice(seed)
        (finding,) = warnings_of({"speed": speed})
        assert finding.code == "check-outliers" and "runs off and back by up to" in finding.text, (
            seed,
            finding,
        )
        assert finding.at == pytest.approx(5.0, abs=0.1) and finding.count <= 3 * 60
        for at in (5.0, 15.0, 26.0):
            starts = [float(x) for x in re.findall(r"([0-9.]+) to [0-9.]+ s", finding.text)]
            assert min(abs(start - at) for start in starts) < 0.2, (seed, finding.text)


def test_an_output_that_moves_with_an_input_or_stays_where_it_was_pushed_is_none():
    for seed in range(5):
        _, speed = counted_twice(seed, (0.0, 0.0, 0.0))
        pushed = speed + 60.0 * lfilter([0.15], [1, -0.85], np.arange(N) > 1500)
        assert not warnings_of({"speed": pushed}), seed
        pulse = np.zeros(N)
        pulse[1500:1525] = 1.0
        driven = speed + 240.0 * lfilter([0.15], [1, -0.85], pulse)
        assert not warnings_of({"u": pulse, "speed": driven}), seed
        assert [f.code for f in warnings_of({"speed": driven})] == ["check-outliers"], seed


def test_a_limited_command_and_a_held_input_are_no_faults():
    _, u, y = noisy_recording(1)
    columns = {"u": np.clip(u, -1.5, 1.5), "position": y}
    assert not warnings_of(columns)
    table = Table(
        "run.csv", (Column("time", "s", PERIOD * np.arange(N)), Column("u", None, columns["u"])), None
    )
    notes = check_table(table).findings
    assert [f.code for f in notes] == ["check-saturation"] * 2 and {f.level for f in notes} == {"note"}


@pytest.mark.parametrize(
    ("first", "input_at_first", "is_told"),
    [(0.0, 0.0, True), (0.0, 1.0, False), (46.5, 0.0, False)],
)
def test_a_zero_before_the_first_reading_is_told(first, input_at_first, is_told):
    """A cooker logs 0 degC before its sensor answers; a quick machine may begin at rest and be driven."""
    time = np.arange(400.0)
    temp = np.round(40.0 + 7.25 * np.exp(-time / 150.0), 2)
    temp[0] = first
    duty = np.where(time > 200, 0.1 * np.sin(time / 9.0), input_at_first)
    record = Experiment("run", time, duty[:, None], temp[:, None], ("duty",), ("temp",))
    texts = [f.text for f in check_experiment(record).findings if f.code == "check-outliers"]
    assert any("no reading yet" in text for text in texts) is is_told, texts


@pytest.mark.parametrize(("of_model", "unit"), [("degC", None), ("m", "in"), (None, "in")])
def test_an_ending_of_a_name_is_no_unit_where_the_model_has_another_quantity(of_model, unit):
    time = PERIOD * np.arange(N)
    table = Table("run.csv", (Column("time", "s", time), Column("T_in", None, np.sin(time))), None)
    units = {"T_in": of_model} if of_model else {}
    (column,) = check_table(table, {"T_in": "input"}, units=units).columns
    assert column.unit == unit


CLOCKS = {
    "check-clock-gap": lambda t: np.delete(t, [50, 51, 200]),
    "check-clock-jump": lambda t: np.where(t > 5, t + 30, t),
    "check-clock-duplicate": lambda t: np.where(np.arange(t.size) == 300, np.roll(t, 1), t),
    "check-clock-order": lambda t: np.concatenate([t[:500], t[:500]]),
    "check-clock-rate": lambda t: np.concatenate([t[:500], t[499] + 1.25 * (t[1:501])]),
    "check-clock-jitter": lambda t: t + PERIOD * np.random.default_rng(1).uniform(-0.3, 0.3, t.size),
}


@pytest.mark.parametrize("code", CLOCKS)
def test_clock(code):
    time = CLOCKS[code](PERIOD * np.arange(1000))
    codes = [finding.code for finding in clock_findings(time)]
    assert code in codes and set(codes) <= {code, "check-clock-gap"}


def test_a_clock_of_few_digits_changes_no_rate():
    """Steps of 0.2 and 0.21 s, of which the halves have a few more of the one or of the other."""
    steps = np.concatenate([np.full(500, 0.2048), np.full(500, 0.2052)])
    time = np.round(np.cumsum(steps), 2)
    medians = [np.median(half) for half in np.split(np.diff(time)[1:].round(2), [499])]
    assert medians == [0.2, 0.21]
    assert not [finding for finding in clock_findings(time) if finding.code == "check-clock-rate"]


def test_an_input_that_changes_in_a_pause_of_the_clock_is_told():
    """A logger that sleeps for half a minute while the heater is switched off."""
    time = PERIOD * np.arange(N)
    values = np.where(np.arange(N) < N // 2, 5.0, 1.0) + 0.1 * np.sin(time)
    u = np.where(np.arange(N) < N // 4, 0.0, values)
    late = np.where(np.arange(N) < N // 2, time, time + 100 * PERIOD)

    def told(clock, role="input"):
        table = Table("run.csv", (Column("time", "s", clock), Column("u", None, u)), None)
        found = check_table(table, {"u": role}).findings
        return [f for f in found if f.code == "check-input-unseen"]

    (one,) = told(late)
    assert one.column == "u" and one.at == pytest.approx(time[N // 2 - 1])
    assert "changes from 5" in one.text and f"pauses for {101 * PERIOD:.4g} s" in one.text
    assert not told(time) and not told(late, "output")
    # A pause in which it stays tells nothing.
    assert not told(np.where(np.arange(N) < N // 3, time, time + 100 * PERIOD))


def test_times_with_too_few_digits_are_told():
    """What a table with three digits makes of a camera with 120 pictures a second, from 1 s on."""
    time = np.array([float(f"{t:.2e}") for t in np.arange(1200) / 120.0])
    said = next(f.text for f in clock_findings(time) if f.code == "check-clock-duplicate")
    assert "written in steps of 0.01, too coarse for samples that are 0.00833 apart" in said
    once = np.where(np.arange(1000) == 300, PERIOD * 299, PERIOD * np.arange(1000))
    assert "too coarse" not in clock_findings(once)[0].text


def test_gaps_are_counted():
    (finding,) = clock_findings(np.delete(PERIOD * np.arange(1000), [50, 51, 200]))
    assert "3 sample(s) in 2 gap(s)" in finding.sentence and finding.at == pytest.approx(0.49)


def test_healthy_clocks():
    rng = np.random.default_rng(5)
    assert not clock_findings(PERIOD * np.arange(1000))
    assert not clock_findings(np.round(0.0333333 * np.arange(1000), 3))
    assert not clock_findings(PERIOD * np.arange(1000) + 1e-5 * rng.normal(size=1000))
    assert {f.level for f in clock_findings(np.cumsum(rng.exponential(0.01, 1000)))} <= {"note", "warning"}
    assert not [f for f in clock_findings(np.cumsum(rng.uniform(0.5, 1.5, 1000))) if f.level == "warning"]


def pairs(**columns):
    parts = tuple(Column(n.partition("__")[0], u, v) for n, (u, v) in columns.items())
    table = Table("run.csv", (Column("time", "s", PERIOD * np.arange(N)), *parts), None)
    return [(f.code, f.column, f.sentence) for f in check_table(table).findings]


@pytest.mark.parametrize("is_dead", [False, True])
def test_a_machine_that_rests_anywhere_is_no_stuck_sensor(is_dead):
    """An encoder stands still for 0.4 s twice. A machine that sticks goes on from there by single steps."""
    step = 3.8e-4
    noise = 5 * np.random.default_rng(0).normal(size=N)
    counts = np.round(2.0 / step * np.sin(0.008 * np.arange(N)) + noise)
    for at in (600, 1700):
        counts[at : at + 40] = counts[at]
        if not is_dead:
            counts[at - 1] = counts[at] + 1
            counts[at + 40 :] += counts[at] + 1 - counts[at + 40]
    assert [f.code for f in warnings_of({"q": np.round(step * counts, 6)})] == ["check-stuck"] * is_dead


def test_a_machine_that_rests_is_no_stuck_sensor_where_two_encoders_are_added():
    """The body of a car over its wheel: the sum moves by the difference of both steps, too, far less than
    by one of them when what sticks goes on."""
    rng = np.random.default_rng(0)
    heights = np.zeros(N)
    for step, leaves in ((2.2e-6, 0), (4.87e-6, 1)):
        counts = np.round(2e-3 / step * np.sin(0.011 * np.arange(N)) + rng.normal(size=N))
        for at in (600, 1700):
            counts[at - 1 : at + 40] = counts[at]
            counts[at - 1] += leaves
            counts[at + 40 :] += counts[at] + leaves - counts[at + 40]
        heights += step * counts
    assert not warnings_of({"z": np.round(heights, 9)})


@pytest.mark.parametrize("is_dead", [False, True])
def test_a_machine_that_often_rests_has_no_sensor_that_dies_as_often(is_dead):
    """A cylinder moves from place to place, noise on its position while it moves. A sensor that dies holds
    its value beside a machine that goes on; at rest the next sample is near."""
    rng = np.random.default_rng(1)
    position = np.sin(0.01 * np.arange(N)) + 0.003 * rng.normal(size=N)
    for at in range(200, N - 100, 400):
        position[at : at + 60] = position[at]
        if not is_dead:
            position[at + 60 :] += position[at] - position[at + 60] + 0.002
    assert [f.code for f in warnings_of({"x": position})] == ["check-stuck"] * is_dead


@pytest.mark.parametrize("is_driven", [False, True])
def test_a_machine_that_nothing_drives_is_no_stuck_sensor(is_driven):
    """A motor with noise on its speed while it turns, and at once at rest where its valve closes."""
    valve = np.repeat(np.arange(N // 100) % 5 - 2, 100)
    noise = 0.05 * np.random.default_rng(2).normal(size=valve.size)
    speed = np.where(valve != 0, valve + noise, 0.04)
    u = valve + 3.0 * is_driven
    columns = {"u": np.resize(u, N), "speed": np.resize(speed, N)}
    assert [f.code for f in warnings_of(columns)] == ["check-stuck"] * is_driven


def test_lag_and_polarity_between_columns():
    rng = np.random.default_rng(2)
    u = excitation("multisine", rng)
    position, speed = response(u, rng)
    noise = 1e-3 * rng.normal(size=N)
    assert not pairs(x=("m", position), v=("m/s", speed + noise))
    (found,) = pairs(x=("m", position), v=("m/s", -speed + noise))
    assert found[:2] == ("check-polarity", "v") and "rate of x with the opposite sign" in found[2]
    (found,) = pairs(a=("rad", position), b=("deg", np.rad2deg(np.roll(position, 7)) + 100 * noise))
    assert found[:2] == ("check-lag", "b") and "follows a by 0.07 s" in found[2]
    (found,) = pairs(x=("m", position), u=("V", position))
    assert found[:2] == ("check-computed", "u") and "is a copy of x: it holds nothing new" in found[2]


GOOD_RECORDS = ("servo_lab/*/*.csv", "zone_lab/*.csv", "emps/*.csv", "bam_xl330/*.csv")


def codes(**columns):
    """Codes of the findings by column, of columns without gaps over a regular time."""
    made = [Column(name, unit, values) for name, (unit, values) in columns.items()]
    time = PERIOD * np.arange(made[0].values.size)
    table = Table("made.csv", (Column("time", "s", time), *made), None)
    return {(finding.code, finding.column) for finding in check_table(table).findings}


def test_columns_that_are_computed_from_others():
    rng = np.random.default_rng(5)
    position, speed = response(excitation("noise", rng), rng)
    position = np.round(position + rng.normal(size=N) * 1e-3, 6)
    quotient = np.round(np.diff(position, prepend=position[0]) / PERIOD, 6)
    late = np.round(2.5 * np.roll(position, 7), 6)
    late[:7] = late[7]
    found = codes(x=("m", position), v=("m/s", quotient), c=(None, late))
    assert ("check-computed", "v") in found and ("check-computed", "c") in found
    measured = speed + rng.normal(size=N) * 1e-3 * np.std(speed) * 5
    again = position + rng.normal(size=N) * 1e-3
    assert not {code for code, _ in codes(x=("m", position), v=("m/s", measured), c=("m", again))} & {
        "check-computed"
    }


def test_angle_that_begins_again_after_a_turn():
    time = PERIOD * np.arange(N)
    heading = 1000.0 * np.sin(2.0 * np.pi * time / time[-1]) + np.random.default_rng(1).normal(size=N)
    wrapped = (heading + 180.0) % 360.0 - 180.0
    assert ("check-wrapped", "a") in codes(a=("deg", wrapped))
    assert ("check-wrapped", "a") in codes(a=("rad", np.radians(wrapped) + np.pi))
    assert ("check-wrapped", "a") not in codes(a=("deg", heading))
    assert ("check-wrapped", "a") not in codes(a=("m", wrapped))
    switched = 150.0 * np.sign(np.sin(20.0 * np.pi * time / time[-1] + 0.1))
    assert ("check-wrapped", "a") not in codes(a=("deg", switched))
    assert ("check-wrapped", "a") not in codes(a=("deg", np.random.default_rng(2).uniform(-180, 180, N)))


def test_angle_of_a_recording_is_known_by_the_unit_of_its_output():
    time = PERIOD * np.arange(N)
    heading = np.degrees(
        np.arctan2(np.sin(5.0 * time / time[-1] * np.pi), np.cos(5.0 * time / time[-1] * np.pi))
    )
    record = Experiment("made", time, np.zeros((N, 0)), heading[:, None], (), ("a",))
    assert "check-wrapped" in {f.code for f in check_experiment(record, units={"a": "deg"}).findings}
    assert "check-wrapped" not in {f.code for f in check_experiment(record).findings}


def test_few_samples_and_many_turns():
    time = PERIOD * np.arange(N)
    assert ("check-turns", "a") in codes(a=("deg", 360 * 574 * time / time[-1]), b=("m", time))
    assert ("check-turns", "a") not in codes(a=("deg", 360 * 20 * time / time[-1]), b=("m", 1000 * time))
    assert ("check-few-samples", None) in codes(a=("m", np.arange(15.0)))
    assert ("check-few-samples", None) not in codes(a=("m", np.arange(60.0)))


@pytest.mark.slow  # simulated ones: the tests above
def test_measured_recordings_give_no_warning(shared_data):
    paths = [path for pattern in GOOD_RECORDS for path in sorted(shared_data.glob(pattern))]
    assert len(paths) >= 20
    found = {path.name: [f.sentence for f in check_table(read_table(path)).warnings] for path in paths}
    assert not {name: warnings for name, warnings in found.items() if warnings}


def test_clipping_is_seen_on_coarse_steps():
    """Few steps make every value frequent: the limit stands out against the steps below it."""
    rng = np.random.default_rng(0)
    time = np.arange(1600.0)
    slow = np.convolve(rng.normal(size=1700), np.exp(-np.arange(100) / 30.0), "valid")[:1600]
    y = 0.6 * slow / slow.std() + 0.03 * rng.normal(size=1600)
    cut = np.round(np.minimum(y, np.quantile(y, 0.85)) / 0.06) * 0.06

    def told(values):
        return [f.code for f in column_findings(Samples("y", "output", time, values), 0)]

    assert told(cut) == ["check-saturation"]
    assert told(np.round(y / 0.06) * 0.06) == []
    # A sine stays longest where it turns.
    assert "check-saturation" not in told(np.round(np.sin(0.02 * time) / 0.06) * 0.06)


def test_stamps_of_six_digits_have_the_period_of_their_clock():
    stamps = np.array([float(f"{t:.6g}") for t in 0.02196954 * np.arange(1300)])
    columns = (Column("time", "s", stamps), Column("u", None, np.sin(stamps)))
    found = check_table(Table("run", columns, None), {"u": "input"})
    assert found.period == pytest.approx(0.02196954, rel=1e-6)
    assert "check-clock-jitter" not in [finding.code for finding in found.findings]


def between_readings(every, decimals, rng, n=2000):
    """A slow output with noise, read at every `every`-th of `n` rows and interpolated to the others."""
    slow = lfilter([0.01], [1, -0.99], rng.normal(size=n)) + rng.normal(0, 0.01, n)
    rows = np.append(np.arange(0, n, every), n - 1)
    return np.interp(np.arange(n), rows, np.round(slow[rows], decimals))


def told_interpolated(u, y):
    found = warnings_of({"u": u, "y": y}, PERIOD * np.arange(y.size), {"u": "input", "y": "output"})
    return [one for one in found if one.code == "check-interpolated"]


@pytest.mark.parametrize(("every", "decimals"), [(3, 3), (7, 4), (7, 12)])
def test_an_output_between_the_readings_of_a_slower_logger_is_told(every, decimals):
    rng = np.random.default_rng(3)
    (found,) = told_interpolated(rng.normal(size=2000), between_readings(every, decimals, rng))
    assert found.column == "y"
    assert f"every {every} samples ({every * PERIOD:.4g} s)" in found.text


def test_a_machine_that_its_input_drives_straight_on_was_not_interpolated():
    u = np.repeat(np.random.default_rng(4).normal(size=200), 10)
    assert not told_interpolated(u, PERIOD * np.cumsum(u))  # a tank without an outlet, without noise


def test_steps_of_a_converter_and_a_motion_to_and_fro_were_not_interpolated():
    rng, time = np.random.default_rng(5), np.arange(2000)
    assert not told_interpolated(rng.normal(size=2000), np.round(np.sin(time / 200), 2))
    assert not told_interpolated(rng.normal(size=2000), np.abs(time % 20 - 10.0))


def told_copied(pipe, air):
    roles = {"pipe": "input", "air": "output"}
    found = warnings_of({"pipe": pipe, "air": air}, PERIOD * np.arange(air.size), roles)
    return [one for one in found if one.code == "check-copied"]


def test_cells_of_an_input_that_were_filled_in_from_an_output_are_told():
    rng = np.random.default_rng(8)
    air = np.round(20.0 + np.cumsum(rng.normal(size=400)) / 10.0, 1)
    pipe = np.round(40.0 + rng.normal(size=400), 1)
    filled = np.where(np.arange(400) // 100 % 2 == 0, air, pipe)
    (found,) = told_copied(filled, air)
    assert found.column == "air" and found.count == 200 and "the input pipe" in found.text


def test_sensors_that_are_alike_and_those_at_rest_are_no_copies():
    rng = np.random.default_rng(8)
    air = np.round(20.0 + np.cumsum(rng.normal(size=400)) / 10.0, 1)
    near = np.round(air + 0.1 * rng.normal(size=400), 1)
    rest = np.where(np.arange(400) < 200, 20.0, air)
    for pipe, values in ((near, air), (np.where(np.arange(400) < 200, 20.0, 30.0), rest)):
        assert not told_copied(pipe, values)
