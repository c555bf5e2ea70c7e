"""What `diagnose` says of machines whose models are wrong in small ways besides: five plants, four domains.

    python benchmarks/wrong_models_study.py [--case NAME ...] [--runs N] [--seed N] [--samples N] [--jobs N]
                                            [--json FILE] [--table FILE] [--list]

No model of a real machine is right but for one effect. Here every recording has two small faults that the
model does not know, drawn from FAULTS, and one of the effects of its plant or none. Plants are integrated by
LSODA of scipy, which shares nothing with daest. A case is `PLANT effect`, `PLANT nothing`, or a plant, the
group of its cases. `--json FILE` keeps one line per run; runs that are in it are not done again.
"""

from __future__ import annotations

import json
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from diagnosis_study import SIZES, arguments, chosen
from scipy.integrate import solve_ivp
from scipy.stats import beta

from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.options import DiagnoseOptions
from daest.errors import DaestError
from daest.machine import described
from daest.model.experiment import Experiment
from daest.model.flat import FlatModel
from daest.modelica.compile import compile_model
from daest.modelica.effects.catalogue import effect_library
from daest.numerics.parallel import Outcome, workers

SHARP = 1e-3  # of a speed over which the sign of friction changes in the simulator
NAMES = {  # a law that contains the true one is no wrong name
    "coulomb": ("CoulombFriction", "StribeckFriction", "LuGreFriction"),
    "drag": ("QuadraticDrag",),
    "unbalance": ("Unbalance", "CoggingTorque"),
    "constant": ("ConstantLoad", "ConstantHeatGain", "Offset"),
    "dead zone": ("DeadZone",),
    "saturation": ("Saturation",),
    "overflow": ("Overflow",),
    "offset": ("Offset",),
    "measured": ("MeasuredHeatFlow", "MeasuredHeatGain", "MeasuredInput"),
}


@dataclass(frozen=True)
class Plant:
    """A model of daest and its truth: `rates(x, u, drift, push)` with the push of an effect, `outputs` as
    columns of the states, their noise, amplitude and offset of the input, period and time scale [s]."""

    model: str
    period: float
    scale: float
    amplitude: float
    offset: float
    n_states: int
    rates: Callable[..., list[float]]
    outputs: tuple[int, ...]
    noise: float
    effects: dict[str, float]  # full size by effect
    start: tuple[float, ...]


def _sign(v: float) -> float:
    return float(np.tanh(v / SHARP))


def _rotor(x: Any, u: float, drift: float, push: float) -> list[float]:
    return [x[1], (u - 0.3 * drift * x[1] + push) / 0.5]


def _cart(x: Any, u: float, drift: float, push: float) -> list[float]:
    return [x[1], (u - 150.0 * x[0] - 4.0 * drift * x[1] + push) / 2.0]


def _tanks(x: Any, u: float, drift: float, push: float) -> list[float]:
    return [0.04 * u - x[0] / 30.0 / drift, x[0] / 30.0 / drift - x[1] / 40.0 + push]


def _rooms(x: Any, u: float, drift: float, push: float) -> list[float]:
    through = 20.0 * (x[0] - x[1])
    return [
        (u - through - 30.0 * drift * (x[0] - 5.0) + push) / 4e5,
        (through - 15.0 * (x[1] - 5.0)) / 8e5,
    ]


def _motor(x: Any, u: float, drift: float, push: float) -> list[float]:
    return [(0.06 * (u - 0.06 * x[0]) / 2.0 - 2e-4 * drift * x[0] + push) / 1e-4]


def _bare(name: str, body: str) -> str:
    return f"model {name}\n{body}\nend {name};\n"


def _estimated(name: str, value: float, unit: str) -> str:
    note = 'annotation(__Daest(estimate = true, scale = "log"))'
    return f'  parameter Real {name}(unit = "{unit}", min = 0) = {value} {note};'


ROTOR = _bare(
    "Rotor",
    "\n".join(
        (
            _estimated("J", 0.4, "kg.m2"),
            _estimated("d", 0.4, "N.m.s/rad"),
            '  input Real u(unit = "N.m"); output Real y(unit = "rad");',
            '  Real phi(unit = "rad"); Real w(unit = "rad/s");',
            "equation\n  der(phi) = w;\n  J*der(w) = u - d*w;\n  y = phi;",
        )
    ),
)
CART = _bare(
    "Cart",
    "\n".join(
        (
            _estimated("m", 1.6, "kg"),
            _estimated("k", 120.0, "N/m"),
            _estimated("d", 5.0, "N.s/m"),
            '  input Real u(unit = "N"); output Real y(unit = "m");',
            '  Real s(unit = "m"); Real v(unit = "m/s");',
            "equation\n  der(s) = v;\n  m*der(v) = u - k*s - d*v;\n  y = s;",
        )
    ),
)
TANKS = """model Tanks
  import Daest.Units.SI;
  parameter Real k(unit = "m3/(s.V)", min = 0) = 0.05 annotation(__Daest(estimate = true, scale = "log"));
  parameter SI.HydraulicResistance R1(min = 0) = 3.5e5 annotation(__Daest(estimate = true, scale = "log"));
  parameter SI.HydraulicResistance R2(min = 0) = 3.5e5 annotation(__Daest(estimate = true, scale = "log"));
  Daest.Blocks.Interfaces.RealInput u(unit = "V", start = 0);
  Daest.Blocks.Interfaces.RealOutput y(unit = "m");
  Daest.Blocks.Math.Gain gain(k = k);
  Daest.Hydraulic.Sources.PrescribedFlow pump;
  Daest.Hydraulic.Components.Tank upper(A = 1);
  Daest.Hydraulic.Components.LinearResistance drain(R = R1);
  Daest.Hydraulic.Components.Tank lower(A = 1);
  Daest.Hydraulic.Components.LinearResistance outlet(R = R2);
  Daest.Hydraulic.Sources.FixedPressure ambient;
  Daest.Hydraulic.Sensors.LevelSensor sensor;
equation
  connect(u, gain.u); connect(gain.y, pump.q); connect(pump.port, upper.inlet);
  connect(upper.outlet, drain.port_a); connect(drain.port_b, lower.inlet);
  connect(lower.outlet, outlet.port_a); connect(outlet.port_b, ambient.port);
  connect(lower.outlet, sensor.port); connect(sensor.level, y);
end Tanks;
"""
ROOMS = _bare(
    "Rooms",
    "\n".join(
        (
            _estimated("C1", 5e5, "J/K"),
            _estimated("C2", 6e5, "J/K"),
            _estimated("G12", 25.0, "W/K"),
            _estimated("G1", 25.0, "W/K"),
            _estimated("G2", 20.0, "W/K"),
            '  input Real u(unit = "W"); output Real y(unit = "degC"); output Real y2(unit = "degC");',
            '  Real T1(unit = "degC", start = 18); Real T2(unit = "degC", start = 18);',
            "equation\n  C1*der(T1) = u - G12*(T1 - T2) - G1*(T1 - 5);",
            "  C2*der(T2) = G12*(T1 - T2) - G2*(T2 - 5);\n  y = T1;\n  y2 = T2;",
        )
    ),
)
MOTOR = _bare(
    "Motor",
    "\n".join(
        (
            _estimated("J", 8e-5, "kg.m2"),
            _estimated("d", 3e-4, "N.m.s/rad"),
            '  parameter Real c(unit = "N.m/A") = 0.06; parameter Real R(unit = "Ohm") = 2;',
            '  input Real u(unit = "V"); output Real y(unit = "rad/s"); Real w(unit = "rad/s");',
            "equation\n  J*der(w) = c*(u - c*w)/R - d*w;\n  y = w;",
        )
    ),
)
PLANTS = {
    "rotor": Plant(
        ROTOR, 0.05, 1.7, 1.0, 0.0, 2, _rotor, (0,), 0.005,
        {"coulomb": 0.2, "drag": 0.2, "unbalance": 0.4, "dead zone": 0.3, "constant": 0.3}, (0.0, 0.0),
    ),
    "cart": Plant(
        CART, 0.02, 0.1, 20.0, 0.0, 2, _cart, (0,), 2e-4,
        {"coulomb": 2.0, "drag": 6.0, "dead zone": 5.0, "constant": 5.0}, (0.0, 0.0),
    ),
    "tanks": Plant(
        TANKS, 2.0, 30.0, 2.5, 3.0, 2, _tanks, (1,), 0.03,
        {"overflow": 0.2, "saturation": 0.5, "dead zone": 1.0}, (3.0, 4.0),
    ),
    "rooms": Plant(
        ROOMS, 300.0, 1e4, 800.0, 900.0, 2, _rooms, (0, 1), 0.05,
        {"measured": 1.0, "constant": 200.0, "saturation": 0.5, "dead zone": 300.0}, (18.0, 18.0),
    ),
    "motor": Plant(
        MOTOR, 0.005, 0.05, 8.0, 0.0, 1, _motor, (0,), 0.3,
        {"coulomb": 0.03, "drag": 2e-6, "dead zone": 1.5, "offset": 1.0}, (0.0,),
    ),
}  # fmt: skip
FAULT_NAMES = {  # a name for a fault that is there is no wrong name
    "lag": ("Lag", "Delay"),
    "flexible": ("Lag", "Delay", "SecondOrderLag", "ExtraCompliance"),
    "gain": ("Gain",),
    "drift": ("Drift", "DriftingParameter"),
}
FAULTS = ("drift", "lag", "quantised", "coloured", "gain", "flexible", "jitter", "loop")
NOTHING = "nothing"


@dataclass(frozen=True)
class Case:
    group: str
    name: str


@dataclass(frozen=True)
class Run:
    case: str
    seed: int
    samples: int
    faults: tuple[str, ...]
    size: float
    verdict: str
    claimed: tuple[str, ...]
    seconds: float

    @property
    def is_right(self) -> bool:
        return bool(set(self.claimed) & set(NAMES.get(self.case.partition(" ")[2], ())))

    @property
    def names_fault(self) -> bool:
        """Whether one of the small faults is named, which is none of the counted effects and there."""
        return bool(set(self.claimed) & {n for f in self.faults for n in FAULT_NAMES.get(f, ())})


CASES = [Case(p, f"{p} {e}") for p, plant in PLANTS.items() for e in (NOTHING, *plant.effects)]


def _excitation(plant: Plant, n: int, rng: np.random.Generator) -> np.ndarray:
    """Random steps that last about the time scale, half the time with a slow sine."""
    hold = max(int(plant.scale / plant.period), 4)
    steps = np.repeat(rng.uniform(-1.0, 1.0, n // hold + 2), hold)[:n]
    if rng.random() < 0.5:
        steps = 0.6 * steps + 0.6 * np.sin(2 * np.pi * np.arange(n) / (8 * hold))
    return plant.offset + plant.amplitude * steps


def recording(plant: Plant, effect: str, size: float, faults: Sequence[str], n: int, seed: int) -> Experiment:
    """A recording with an effect of that part of its full size, and the faults."""
    rng = np.random.default_rng(seed)
    u = _excitation(plant, n, rng)
    full = size * plant.effects.get(effect, 0.0)
    time_ = plant.period * np.arange(n)
    if "jitter" in faults:
        time_[1:-1] += 0.05 * plant.period * rng.uniform(-1, 1, n - 2)
    sun = np.maximum(400.0 * np.sin(2 * np.pi * time_ / 86400.0) * rng.uniform(0.5, 1.0), 0.0)
    corner = 5.0 / plant.scale  # of what is flexible, five times the bandwidth
    lag = 0.01 * plant.scale
    used = np.empty(n)

    def rates(t: float, z: np.ndarray, k: int, command: float) -> list[float]:
        x = z[: plant.n_states]
        drift = 1.0 + (0.05 * t / time_[-1] if "drift" in faults else 0.0)
        driven = z[-2] if "flexible" in faults else command
        driven *= 1.02 if "gain" in faults else 1.0
        if effect == "dead zone":
            driven = np.sign(driven) * max(abs(driven) - full, 0.0)
        if effect == "offset":
            driven += full
        if effect == "saturation" and plant.rates is _rooms:
            driven = min(driven, plant.offset + (0.9 - full) * plant.amplitude)
        push = _push(effect, full, x, sun[k])
        own = plant.rates(x, driven, drift, push)
        second = corner**2 * (command - z[-2]) - 1.0 * corner * z[-1]
        return [*own, (x[plant.outputs[0]] - z[plant.n_states]) / lag, z[-1], second]

    z = np.array([*plant.start, plant.start[plant.outputs[0]], u[0], 0.0])
    states = np.empty((n, z.size))
    for k in range(n):
        states[k] = z
        measured = z[plant.outputs[0]]
        used[k] = u[k]
        if "loop" in faults:
            size_y = plant.amplitude * LOOP[plant.rates.__name__]
            used[k] -= size_y * (measured - plant.start[plant.outputs[0]])
        if k + 1 < n:
            found = solve_ivp(
                rates, (time_[k], time_[k + 1]), z, method="LSODA", rtol=1e-6, atol=1e-9, args=(k, used[k])
            )
            z = found.y[:, -1]
    first = states[:, plant.n_states] if "lag" in faults else states[:, plant.outputs[0]]
    y = np.column_stack([first, *(states[:, j] for j in plant.outputs[1:])])
    if effect == "saturation" and plant.rates is _tanks:
        top = np.quantile(y, 1.0 - 0.2 * size)
        y = np.minimum(y, top)
    noise = rng.standard_normal(y.shape)
    if "coloured" in faults:
        for k in range(1, n):
            noise[k] = 0.8 * noise[k - 1] + 0.6 * noise[k]
    y = y + plant.noise * noise
    if effect == "saturation" and plant.rates is _tanks:
        y = np.minimum(y, top)
    if "quantised" in faults:
        y = 2.0 * plant.noise * np.round(y / (2.0 * plant.noise))
    names = ("y", "y2")[: y.shape[1]]
    extra = {"sun": sun} if plant.rates is _rooms else {}
    regular = plant.period * np.arange(n)  # the clock of the file knows nothing of its jitter
    return Experiment("run", regular, used[:, None], y, ("u",), names, extra)


LOOP = {"_rotor": 0.3, "_cart": 1.0, "_tanks": 0.05, "_rooms": 0.02, "_motor": 0.002}


def _push(effect: str, full: float, x: np.ndarray, sun: float) -> float:
    if effect == "coulomb":
        return -full * _sign(x[-1])
    if effect == "drag":
        return -full * x[-1] * abs(x[-1])
    if effect == "unbalance":
        return -full * float(np.sin(x[0]))
    if effect == "constant":
        return full
    if effect == "overflow":
        return -full * max(x[-1] - 5.0, 0.0)
    if effect == "measured":
        return full * sun
    return 0.0


@cache
def compiled(plant: str) -> FlatModel:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "Plant.mo"
        path.write_text(PLANTS[plant].model, encoding="utf-8")
        return compile_model(path)


def one_run(task: tuple[str, int, int]) -> Run:
    name, seed, samples = task
    plant_name, _, effect = name.partition(" ")
    number = next(k for k, case in enumerate(CASES) if case.name == name)
    plant, rng = PLANTS[plant_name], np.random.default_rng([seed, 7, number])
    faults = tuple(sorted(rng.choice(FAULTS, 2, replace=False).tolist()))
    size = SIZES[seed % len(SIZES)] if effect != NOTHING else 0.0
    record = recording(plant, effect, size, faults, samples, seed)
    began = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            found = diagnose(compiled(plant_name), effect_library(), [record], (), DiagnoseOptions(jobs=1))
            verdict: str = found.verdict
            told = [p for p in found.proofs if p.verdict != "rejected"]
            same = [label.partition(" at ")[0] for p in told for label in p.same_as]
            claimed = tuple(dict.fromkeys([*(p.candidate.effect.name for p in told), *same]))
        except DaestError as error:
            verdict, claimed = f"stop: {error.code}", ()
        except Exception as error:  # a crash is a finding of the study
            verdict, claimed = f"crash: {type(error).__name__}", ()
    return Run(name, seed, samples, faults, size, verdict, claimed, time.perf_counter() - began)


def kept(path: Path | None) -> list[Run]:
    if path is None or not path.exists():
        return []
    lines = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
    return [Run(**{**one, "claimed": tuple(one["claimed"]), "faults": tuple(one["faults"])}) for one in lines]


def keep(path: Path | None, _number: int, outcome: Outcome[Run]) -> None:
    run = outcome.get()
    said = ", ".join(run.claimed)
    print(f"{run.case} {run.seed} {run.size} {'+'.join(run.faults)}: {run.verdict} {said}", flush=True)
    if path:
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(asdict(run)) + "\n")


def _rate(what: str, hits: int, runs: int) -> dict[str, Any]:
    low, high = (
        0.0 if hits == 0 else float(beta.ppf(0.025, hits, runs - hits + 1)),
        1.0 if hits == runs else float(beta.ppf(0.975, hits + 1, runs - hits)),
    )
    return {"what": what, "hits": hits, "runs": runs, "low": round(low, 4), "high": round(high, 4)}


def table(runs: Sequence[Run]) -> dict[str, Any]:
    """Rates over all plants and by plant: names where nothing is hidden, wrong names, right names where one
    is claimed, power by size, recordings without a verdict."""

    def rates(some: Sequence[Run]) -> list[dict[str, Any]]:
        quiet = [r for r in some if r.size == 0.0]
        hidden = [r for r in some if r.size > 0.0]
        claims = [r for r in hidden if r.claimed]
        entries = [
            (
                "names what is not there, nothing hidden",
                sum(bool(r.claimed) and not r.names_fault for r in quiet),
                len(quiet),
            ),
            ("names a small fault, nothing hidden", sum(r.names_fault for r in quiet), len(quiet)),
            (
                "names what is not there, an effect hidden",
                sum(not r.is_right and not r.names_fault for r in claims),
                len(hidden),
            ),
            ("right effect among those named", sum(r.is_right for r in claims), len(claims)),
            *(
                (f"names the right effect, size {s}", sum(r.is_right for r in hidden if r.size == s),
                 sum(r.size == s for r in hidden))
                for s in SIZES
            ),
            ("no verdict (stop or crash)", sum(":" in r.verdict for r in some), len(some)),
        ]  # fmt: skip
        return [_rate(*entry) for entry in entries if entry[2]]

    return {
        "n_runs": len(runs),
        "samples": sorted({r.samples for r in runs}),
        "rates": rates(runs),
        "plants": {p: rates([r for r in runs if r.case.startswith(f"{p} ")]) for p in PLANTS},
        "verdicts": {
            c.name: dict(Counter(r.verdict for r in runs if r.case == c.name))
            for c in CASES
            if any(r.case == c.name for r in runs)
        },
    }


def main() -> None:
    options = arguments(__doc__, "docs/wrong_models_rates.json").parse_args()
    cases = chosen(options.case, CASES)
    if options.list:
        print("\n".join(case.name for case in cases))
        return
    print(described(), flush=True)
    runs = kept(options.json)
    done = {(run.case, run.seed, run.samples) for run in runs}
    seeds = range(options.seed, options.seed + options.runs)
    wanted = [(case.name, seed, options.samples) for seed in seeds for case in cases]
    tasks = [task for task in wanted if task not in done]
    with workers(options.jobs, None) as pool:
        arrived = partial(keep, options.json)
        runs += [outcome.get() for outcome in pool.map(one_run, tasks, arrived=arrived)]
    if runs:
        found = table(runs)
        for entry in found["rates"]:
            print(f"{entry['what']}: {entry['hits']} of {entry['runs']}")
        if options.table:
            options.table.write_text(
                json.dumps({**found, "measured": described()}, indent=1) + "\n", encoding="utf-8"
            )


if __name__ == "__main__":
    import wrong_models_study  # what belongs to __main__ is unknown to other processes

    wrong_models_study.main()
