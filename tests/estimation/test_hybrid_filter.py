"""Filters of models with events: against the exact Kalman filter of a sampled loop, finite differences, and
motions simulated with noise."""

from pathlib import Path

import numpy as np
import pytest

from daest.errors import EstimationError
from daest.estimation.filter import run_filter
from daest.estimation.streaming.online_filter import online_filter
from daest.model.estimates import FilterOptions, InitialState, Sample
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_text
from daest.systems.events.hybrid import Inputs
from daest.systems.events.modes import in_starting_mode
from daest.systems.events.passages import Passages
from daest.systems.reduction.reduce import reduce_index
from daest.systems.simulation.integrate import integrator

LOOP = """model Loop "A sampled PI controller beside a continuous plant"
  Real x(start = 0, fixed = true);
  discrete Real u(start = 0, fixed = true);
  discrete Real sum(start = 0, fixed = true);
  input Real r;
  input Real w annotation(__Daest(noise = true, intensity = 0.01));
  output Real y = x annotation(__Daest(std = 0.05));
equation
  der(x) = -x + u + w;
  when sample(0, 0.1) then
    sum = pre(sum) + 0.3*(r - x);
    u = 2*(r - x) + sum;
  end when;
end Loop;
"""

BLOCK = """model Block "A mass on a rough table: it sticks, or slides to either side"
  Real v(start = 0, fixed = true);
  Real s(start = 0, fixed = true);
  Integer mode(start = 0, fixed = true);
  input Real u;
  input Real w annotation(__Daest(noise = true, intensity = 0.02));
  output Real y = s annotation(__Daest(std = 0.005));
equation
  der(v) = if mode == 0 then 0 else u + w - mode;
  der(s) = v;
  when pre(mode) == 0 and u > 1 then
    mode = 1;
  elsewhen pre(mode) == 1 and v < 0 then
    mode = 0;
  elsewhen pre(mode) == 0 and u < -1 then
    mode = -1;
  elsewhen pre(mode) == -1 and v > 0 then
    mode = 0;
  end when;
end Block;
"""

DT, TICK = 0.025, 4  # seconds, and samples between two ticks of the controller


@pytest.fixture(scope="module")
def loop():
    return compile_text(LOOP.encode(), Path("Loop.mo"))


@pytest.fixture(scope="module")
def block():
    return compile_text(BLOCK.encode(), Path("Block.mo"))


def experiment(t, u, y, name):
    return Experiment("recording", t, u[:, None], y[:, None], (name,), ("y",))


def column(found, name):
    return found.values[:, found.names.index(name)]


def loop_recording(n):
    """A recording of the loop by its exact discretisation, and the exact Kalman filter of it: estimates and
    standard deviations of (x, u, sum), and log p(y)."""
    rng, t = np.random.default_rng(0), np.arange(n) * DT
    r, decay = np.where(t % 4 < 2, 1.0, 0.0), np.exp(-DT)
    q = 0.01 * (1 - decay**2) / 2
    F = np.array([[decay, 1 - decay, 0], [0, 1, 0], [0, 0, 1]])
    tick = np.array([[1, 0, 0], [-2.3, 0, 1], [-0.3, 0, 1]])
    truth, mean, cov, likelihood = np.zeros(3), np.zeros(3), np.zeros((3, 3)), 0.0
    y, means, stds = np.empty(n), np.empty((n, 3)), np.empty((n, 3))
    for k in range(n):
        if k % TICK == 0:
            shift = np.array([0, 2.3, 0.3]) * r[k]
            truth, mean, cov = tick @ truth + shift, tick @ mean + shift, tick @ cov @ tick.T
        y[k] = truth[0] + 0.05 * rng.standard_normal()
        s = cov[0, 0] + 0.05**2
        likelihood -= 0.5 * ((y[k] - mean[0]) ** 2 / s + np.log(2 * np.pi * s))
        gain = cov[:, 0] / s
        mean, cov = mean + gain * (y[k] - mean[0]), cov - np.outer(gain, cov[0])
        means[k], stds[k] = mean, np.sqrt(np.diag(cov))
        truth = F @ truth + np.array([np.sqrt(q), 0, 0]) * rng.standard_normal()
        mean, cov = F @ mean, F @ cov @ F.T + np.diag([q, 0, 0])
    return experiment(t, r, y, "r"), means, stds, likelihood


@pytest.mark.parametrize(("kind", "n"), [("ekf", 120), ("ukf", 40)])
def test_a_sampled_loop_is_filtered_exactly(loop, kind, n):
    recording, means, stds, likelihood = loop_recording(n)
    start = InitialState(np.zeros(3), np.zeros((3, 3)))
    found = run_filter(loop, recording, kind, FilterOptions(hold="zoh", initial=start))
    columns = [found.names.index(name) for name in ("x", "u", "sum")]
    assert found.values[:, columns] == pytest.approx(means, abs=1e-10)
    assert found.std[:, columns] == pytest.approx(stds, abs=1e-10)
    assert found.log_likelihood == pytest.approx(likelihood, abs=1e-7)


@pytest.mark.slow  # ekf and ukf: above; particles: test_particle.py
def test_particles_follow_the_ticks(loop):
    recording, means, stds, _ = loop_recording(26)
    start = InitialState(np.zeros(3), np.zeros((3, 3)))
    options = FilterOptions(hold="zoh", initial=start, n_particles=60, seed=1)
    found = run_filter(loop, recording, "particle", options)
    error = (column(found, "u") - means[:, 1])[1:] / stds[1:, 1].max()
    assert np.max(np.abs(error)) < 1.0  # 60 particles: an eighth of a standard deviation, and its extremes


def test_a_linear_filter_says_which_ones_follow_events(loop):
    recording, *_ = loop_recording(10)
    with pytest.raises(EstimationError) as caught:
        run_filter(loop, recording, "stationary")
    assert caught.value.code == "filter-events"
    assert "ekf" in caught.value.remedy
    with pytest.raises(EstimationError) as caught:
        online_filter(loop, 0.025, "stationary")
    assert caught.value.code == "filter-events"


def rough_table(seed, n=201, parts=100):
    """A recording of the block in small steps, its speed and its mode."""
    rng, t = np.random.default_rng(seed), np.linspace(0, 10, n)
    u, dt = 2 * np.sin(2 * t), t[1] / parts
    s = v = 0.0
    mode, speed, place, modes = 0, np.empty(n), np.empty(n), np.empty(n)
    for k in range(n):
        speed[k], place[k], modes[k] = v, s, mode
        for _ in range(parts):
            mode = int(np.sign(u[k])) if mode == 0 and abs(u[k]) > 1 else mode
            before = v
            if mode:
                v += (u[k] - mode) * dt + np.sqrt(0.02 * dt) * rng.standard_normal()
                s += 0.5 * (before + v) * dt
                if v * mode < 0:
                    v, mode = 0.0, 0
    y = place + 0.005 * rng.standard_normal(n)
    return experiment(t, u, y, "u"), speed, modes


def test_a_block_that_sticks_and_slides(block):
    recording, speed, modes = rough_table(0)
    start = InitialState(np.zeros(2), np.zeros((2, 2)))
    found = run_filter(block, recording, None, FilterOptions(hold="zoh", initial=start))
    assert found.kind == "ekf"
    assert 0.8 < found.nis.mean < 1.25  # 201 innovations
    assert np.mean(column(found, "mode") == modes) > 0.95
    sticks = (column(found, "mode") == 0) & (modes == 0)
    std = found.std[:, found.names.index("v")]
    assert np.all(std[sticks] < 1e-6)
    assert np.sqrt(np.mean((column(found, "v") - speed) ** 2)) < 0.1
    smooth = run_filter(block, recording, "ekf", FilterOptions(hold="zoh", initial=start, smooth=True))
    assert np.mean(smooth.std[:, smooth.names.index("s")]) < np.mean(found.std[:, found.names.index("s")])


# Each kind and each model once; the other pairs among the slow tests.
@pytest.mark.parametrize(
    ("kind", "case"),
    [
        pytest.param("ekf", "loop", marks=pytest.mark.slow),
        pytest.param("ukf", "block", marks=pytest.mark.slow),
        pytest.param("ukf", "loop", marks=pytest.mark.slow),
        ("ekf", "block"),
    ],
)
def test_sample_by_sample_the_filter_is_that_of_the_record(request, kind, case):
    """Also where the memory was kept in a file on the way: the mode is a part of it."""
    flat, recording = request.getfixturevalue(case), loop_recording(36)[0]
    size = 3
    if case == "block":
        whole, size = rough_table(0, n=101)[0], 2
        recording = experiment(whole.time[:60], whole.inputs[:60, 0], whole.outputs[:60, 0], "u")
    options = FilterOptions(hold="zoh", initial=InitialState(np.zeros(size), 0.01 * np.eye(size)))
    known = run_filter(flat, recording, kind, options)
    online = online_filter(flat, float(np.diff(recording.time)[0]), kind, options)
    memory, found = online.begin(), []
    for k, time in enumerate(recording.time):
        if k in (7, 33):
            memory = online.restored({n: v.copy() for n, v in online.stored(memory).items()})
        memory, one = online.advance(memory, Sample(time, recording.inputs[k], recording.outputs[k]))
        found.append(one)
    assert online.names == known.names
    values = np.array([one.values for one in found])
    assert np.nanmax(np.abs(values - known.values) / (1e-3 + np.nan_to_num(known.std))) < 1e-6
    assert found[-1].log_likelihood == pytest.approx(known.log_likelihood, rel=1e-7)
    assert sum(one.nis for one in found) == pytest.approx(known.nis.mean * len(found), rel=1e-6)


def passages_under(block, *levels):
    """The block under inputs held for half a second each."""
    u = np.array(levels)[:, None]
    time = 0.5 * np.arange(len(levels) + 1)
    engine = integrator(reduce_index(in_starting_mode(block)))
    return Passages(engine, Inputs(time, u, u, u[-1:]), 1e-10, np.full(2, 1e-12), 10_000)


def test_a_passage_has_the_slopes_of_its_differences(block):
    """Through an interval in which the block comes to rest: ∂x(end)/∂x(start)."""
    passages = passages_under(block, 0.5, 2.0, -0.9)

    def ends(change):
        x, mode, _ = passages.start(block.theta_values, None)
        for k in (0, 1):
            x, _ = passages.agreed(k, x, np.eye(2), mode)
            x, _ = passages.over(k, x, mode)
        x, _ = passages.agreed(2, x, np.eye(2), mode)
        return passages.over(2, x + change, mode)

    _, legs = ends(np.zeros(2))
    assert any(leg.jump is not None for leg in legs)
    slope = np.eye(2)
    for leg in legs:
        slope = leg.transition @ slope
        slope = slope if leg.jump is None else leg.jump @ slope
    step = 1e-5
    rows = [(ends(step * e)[0] - ends(-step * e)[0]) / (2 * step) for e in np.eye(2)]
    assert slope == pytest.approx(np.array(rows).T, abs=1e-6)
    assert np.min(np.abs(np.linalg.eigvals(slope))) < 1e-9  # a block at rest has lost what it was


def test_an_estimate_beyond_a_switch_returns_or_passes_it(block):
    passages = passages_under(block, 0.5, 2.0, 2.0, -0.9)
    names = list(passages.functions.explicit.state_names)
    v, slot = names.index("v"), next(a.slot for a in block.events.assignments if a.name == "mode")
    x, mode, _ = passages.start(block.theta_values, None)
    for k in (0, 1):
        x, _ = passages.agreed(k, x, np.eye(2), mode)
        x, _ = passages.over(k, x, mode)
    assert mode.theta[slot] == 1
    x[v] = -0.01
    held, turn = passages.agreed(2, x, np.eye(2), mode)
    assert mode.theta[slot] == 1  # it is pushed forward: the measurement took it too far
    assert held[v] == pytest.approx(0.0, abs=1e-9)
    assert turn == pytest.approx(np.eye(2))
    passed, turn = passages.agreed(3, x, np.eye(2), mode)
    assert mode.theta[slot] == 0  # it slows down: it has come to rest a moment ago
    assert passed[v] == pytest.approx(0.0, abs=1e-12)
    assert turn[v] == pytest.approx(0.0, abs=1e-12)
