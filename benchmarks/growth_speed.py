"""How processor time grows with samples, states, parameters, candidates and equations: p of seconds ~ size^p,
fitted over the larger half of the sizes. Part of `speed.py`."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import nonlinear_speed as servo
import numpy as np
import size
from diagnosis_speed import screened
from filter_speed import chain, record
from timed import in_turn

import daest
from daest.diagnosis.screening.screen import screen
from daest.estimation.filter_engines.ekf import ekf_likelihood
from daest.estimation.filter_engines.filter_task import Noise, Start
from daest.estimation.filter_engines.filter_task import record as prepared
from daest.estimation.filter_engines.kalman import kalman_filter
from daest.estimation.identify import identify
from daest.model.estimates import InitialState
from daest.model.experiment import Experiment
from daest.model.fit import IdentifyOptions
from daest.numerics.threads import one_thread
from daest.systems.simulation.integrate import integrate, integrator
from daest.systems.simulation.local_linear import local_model

SAMPLES = (1000, 3000, 10_000, 30_000, 100_000, 300_000)
STATES = (4, 10, 20, 50, 100, 200)
PARAMETERS = (1, 2, 4, 8, 16)
LINKS = (59, 118, 294, 588, 1176, 2941, 5882)  # of a train, 17 equations each
PART = (1 / 8, 1 / 4, 1 / 2, 1.0)  # of the candidates of the embedded example
MASSES = """
model Masses "A row of masses between springs, each of its own stiffness"
  constant Integer n = 16;
  parameter Real k[n](each unit = "N/m") = fill(100.0, n);
  Real x[n](each unit = "m", each start = 0, each fixed = true);
  Real v[n](each unit = "m/s", each start = 0, each fixed = true);
  input Real u(unit = "N");
  output Real first(unit = "m") = x[1];
  output Real last(unit = "m") = x[n];
equation
  for i in 1:n loop
    der(x[i]) = v[i];
    der(v[i]) = (if i == 1 then u else k[i - 1]*(x[i - 1] - x[i]))
      - (if i == n then k[n]*x[n] else k[i]*(x[i] - x[i + 1])) - 0.5*v[i];
  end for;
end Masses;
"""


@dataclass(frozen=True)
class Growth:
    """Seconds of processor time of `step` by the number of `what`."""

    step: str
    what: str
    sizes: tuple[float, ...]
    seconds: tuple[float, ...]

    @property
    def exponent(self) -> float:
        half = len(self.sizes) // 2
        x, y = np.log(self.sizes[half:]), np.log(self.seconds[half:])
        return float(np.polyfit(x, y, 1)[0])


def _timed(run: Callable[[], object], repeat: int = 3) -> float:
    with one_thread():
        return in_turn([run], repeat)[0]


def filters() -> Iterator[Growth]:
    def seconds(n: int, n_samples: int) -> float:
        model = chain(n)
        experiment, known = record(model, n_samples, 0.0), InitialState.known(np.zeros(n), 1.0)
        return _timed(lambda: kalman_filter(model, experiment, known))

    found = tuple(seconds(4, n_samples) for n_samples in SAMPLES)
    yield Growth("Kalman filter, 4 states", "samples", SAMPLES, found)
    found = tuple(seconds(n, 500) for n in STATES)
    yield Growth("Kalman filter, 500 samples", "states", STATES, found)
    explicit = servo.servo()
    theta, model = explicit.flat.theta_values, local_model(explicit)
    noise, start = Noise(np.array([1e-4, 1e-4]), np.array([1e-2, 1e-4])), Start(np.zeros(4), 0.01 * np.eye(4))
    times = []
    for n_samples in SAMPLES[:-1]:
        t, u = servo.drive(n_samples)
        y = integrate(integrator(explicit), t, u, theta, np.zeros(4), hold="zoh", rtol=servo.RTOL).outputs
        y = y + np.array([0.1, 0.01]) * np.random.default_rng(1).standard_normal(y.shape)
        data = prepared(model, t, u, y, "zoh")
        times.append(_timed(lambda data=data: ekf_likelihood(model, data, theta, noise, start)))
    yield Growth("extended filter of a servo", "samples", SAMPLES[:-1], tuple(times))


def fits() -> Iterator[Growth]:
    """An iteration of identify, whose likelihood has an exact gradient."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "Masses.mo"
        path.write_text(MASSES, encoding="utf-8")
        flat = daest.compile_model(path)
    t = 0.02 * np.arange(2000)
    u = np.sign(np.sin(0.7 * t) + np.sin(1.9 * t))[:, None]
    rng = np.random.default_rng(2)
    run = daest.simulate(
        flat, Experiment("masses", t, u, np.full((t.size, 2), np.nan), ("u",), ("first", "last"))
    )
    y = np.column_stack([run["first"], run["last"]]) + 1e-4 * rng.standard_normal((t.size, 2))
    recording = Experiment("masses", t, u, y, ("u",), ("first", "last"))

    def per_iteration(n: int) -> float:
        names = tuple(f"k[{i + 1}]" for i in range(n))
        options = IdentifyOptions(
            "oe", estimate=names, start=dict.fromkeys(names, 101.0), hold="zoh", second_look=False
        )
        iterations = []
        seconds = _timed(lambda: iterations.append(identify(flat, [recording], options).n_iterations), 1)
        return seconds / max(iterations)

    found = tuple(per_iteration(n) for n in PARAMETERS)
    yield Growth("an iteration of identify, 32 states, 2000 samples", "parameters", PARAMETERS, found)


def screens() -> Iterator[Growth]:
    null, run, candidates = screened()
    sizes = tuple(int(part * len(candidates)) for part in PART)
    chosen = np.random.default_rng(3).permutation(len(candidates))
    parts = [[candidates[i] for i in chosen[:n]] for n in sizes]
    found = tuple(_timed(lambda part=part: screen(null, run, part), 1) for part in parts)
    yield Growth("screen, 8000 samples", "candidates", sizes, found)


def equations() -> Iterator[Growth]:
    models = [size.model("long chain", n) for n in LINKS]
    found = tuple(_timed(lambda dae=dae: size.by_sparse_form(dae), 1) for dae in models)
    yield Growth("noise verdict of a train", "equations", tuple(dae.n for dae in models), found)


def growths() -> Iterator[Growth]:
    for part in (filters, fits, screens, equations):
        yield from part()


def drawn(found: list[Growth], path: Path) -> None:
    """Times over sizes, both in decades, one panel for each."""
    import matplotlib

    matplotlib.use("svg")
    matplotlib.rcParams["svg.hashsalt"] = "daest"
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullFormatter

    figure = Figure(figsize=(9.0, 5.4), layout="constrained")
    for axes, one in zip(figure.subplots(2, -(-len(found) // 2)).flat, found, strict=False):
        axes.loglog(one.sizes, one.seconds, "o-", color="#1f5fa8", markersize=4)
        half = len(one.sizes) // 2
        ends = np.array(one.sizes)[[half, -1]]
        line = one.seconds[-1] * (ends / one.sizes[-1]) ** one.exponent
        axes.loglog(ends, line, "--", color="#b03a2e", label=f"{one.what}$^{{{one.exponent:.2f}}}$")
        axes.set_title(one.step, fontsize=8)
        for values, axis, limits in (
            (one.sizes, axes.xaxis, axes.set_xlim),
            (one.seconds, axes.yaxis, axes.set_ylim),
        ):
            axis.set_minor_formatter(NullFormatter())
            limits(
                10.0 ** np.floor(np.log10(min(values))) * 0.8, 10.0 ** np.ceil(np.log10(max(values))) * 1.25
            )
        axes.set_xlabel(one.what, fontsize=8)
        axes.set_ylabel("processor time [s]", fontsize=8)
        axes.tick_params(labelsize=7)
        axes.legend(fontsize=7, frameon=False)
        axes.grid(visible=True, which="major", linewidth=0.3)
    figure.savefig(path, metadata={"Date": None})
