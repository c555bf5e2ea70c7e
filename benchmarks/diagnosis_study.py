"""Seeded calibration of `diagnose`: false alarms, hits and power, on records whose truth is known.

    python benchmarks/diagnosis_study.py [--case NAME ...] [--runs N] [--seed N] [--samples N] [--jobs N]
                                         [--cluster ADDRESS] [--json FILE] [--table FILE] [--peers] [--list]

Two plants (a rotor whose angle is measured; a spring servo with two sensors), three excitations and three
sizes take turns with the seed. The records come from simulators of this file: sub-stepped Euler-Maruyama with
set-valued friction, which shares nothing with daest. A case is one of the groups `nothing`, `load`, `effects`
and `outside`, or one effect by its name.

`--json FILE` keeps one line per run; runs that are in it are not done again, so that a long study can be
done in slices. `--table docs/rates.json` writes the rates that the documentation shows (`--runs 0` makes no
further run). `--peers` adds what a user would do by hand, on the same records of the rotor: STLSQ
regression (pySINDy where installed) of the smoothed residual on a library, and stepwise output-error refits
ranked by BIC.

Rates come with 95 % limits of Clopper and Pearson. Runs are the same in processes (`--jobs`) and on a Dask
cluster (`--cluster`), whose workers must find this file: PYTHONPATH=benchmarks dask worker ADDRESS.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache, partial
from itertools import groupby
from pathlib import Path

import numpy as np
from scipy.signal import savgol_filter
from scipy.stats import beta

from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.options import DiagnoseOptions
from daest.errors import DaestError
from daest.machine import described
from daest.model.diagnosis import Diagnosis, FreeForm
from daest.model.experiment import Experiment
from daest.model.flat import FlatModel
from daest.modelica.compile import compile_model
from daest.modelica.effects.catalogue import effect_library
from daest.numerics.parallel import Outcome, workers

EXCITATIONS = ("steps", "noise", "sweep")
SIZES = (0.3, 0.6, 1.0)
SUBSTEPS = 20
SERVO = Path(__file__).resolve().parents[1] / "examples" / "servo" / "Servo.mo"
ROTOR = """
model Rotor "A torque turns a rotor against viscous friction; its angle is measured"
  import Daest.Units.SI;
  parameter SI.Inertia J(min = 0) = 0.5 annotation(__Daest(estimate = true, scale = "log"));
  parameter SI.RotationalDampingConstant d(min = 0) = 0.3 annotation(__Daest(estimate = true, scale = "log"));
  Daest.Blocks.Interfaces.RealInput u(unit = "N.m");
  Daest.Blocks.Interfaces.RealOutput phi(unit = "rad") annotation(__Daest(std = 0.005));
  Daest.Mechanics.Rotational.Sources.Torque drive;
  Daest.Mechanics.Rotational.Components.Inertia rotor(J = J);
  Daest.Mechanics.Rotational.Components.Damper bearing(d = d);
  Daest.Mechanics.Rotational.Components.Fixed housing;
  Daest.Mechanics.Rotational.Sensors.AngleSensor encoder;
  Daest.Noise.WhiteTorque disturbance(intensity = 1e-4);
equation
  connect(u, drive.tau);
  connect(drive.flange, rotor.flange_a);
  connect(rotor.flange_b, bearing.flange_a);
  connect(bearing.flange_b, housing.flange);
  connect(rotor.flange_b, encoder.flange);
  connect(disturbance.flange, rotor.flange_b);
  connect(encoder.phi, phi);
end Rotor;
"""


@dataclass(frozen=True)
class Case:
    """What is hidden in a plant: `full` are the values of the simulator at size 1, those in `scaled` shrink
    with the size. `names` and `sites` are the effects and places that count as right, none where no effect
    may be named. `without` are effects taken out of the library."""

    name: str
    group: str
    plant: str
    full: dict[str, float] = field(default_factory=dict)
    scaled: tuple[str, ...] = ()
    names: tuple[str, ...] = ()
    sites: tuple[str, ...] = ()
    without: tuple[str, ...] = ()

    def values(self, size: float) -> dict[str, float]:
        return {key: value * (size if key in self.scaled else 1.0) for key, value in self.full.items()}


SHAFT = ("rotor.flange_a", "rotor.flange_b", "bearing", "drive.flange")
MOTOR = (
    "motor.flange_a",
    "motor.flange_b",
    "emf.flange",
    "gear.flange_a",
    "gear.flange_b",
    "spring.flange_a",
)
DISC = ("disc.flange_a", "disc.flange_b", "spring.flange_b")


def _rotor(
    name: str, key: str, value: float, effect: str, sites: Sequence[str] = SHAFT, **more: float
) -> Case:
    names = (effect, *ALIASES.get(effect, ()))
    return Case(f"rotor-{name}", "effects", "rotor", {key: value, **more}, (key,), names, (*sites, "u"))


def _servo(name: str, key: str, value: float, effect: str, sites: Sequence[str]) -> Case:
    names = (effect, *ALIASES.get(effect, ()))
    return Case(f"servo-{name}", "effects", "servo", {key: value}, (key,), names, tuple(sites))


# The same law under another name: cogging once per turn, a constant torque added to the drive's.
ALIASES = {"Unbalance": ("CoggingTorque",), "ConstantLoad": ("Offset",)}
CASES = (
    Case("nothing-rotor", "nothing", "rotor"),
    Case("nothing-servo", "nothing", "servo"),
    Case("load-rotor", "load", "rotor", {"load": 0.1, "load_T": 1.0}, ("load",)),
    Case("load-servo", "load", "servo", {"load": 0.05, "load_T": 0.5}, ("load",)),
    _rotor("coulomb", "coulomb", 0.15, "CoulombFriction"),
    _rotor("stribeck", "stribeck", 0.12, "StribeckFriction"),
    _rotor("asymmetric", "forward", 0.2, "AsymmetricFriction"),
    _rotor("drag", "drag", 0.1, "QuadraticDrag"),
    _rotor("unbalance", "unbalance", 0.3, "Unbalance"),
    _rotor("cogging", "cogging", 0.2, "CoggingTorque", n=3.0),
    _rotor("constant", "constant", 0.15, "ConstantLoad"),
    _rotor("deadzone", "deadzone", 0.4, "DeadZone"),
    _rotor("saturation", "cut", 0.4, "Saturation"),
    _rotor("endstop", "stop", 3.0, "EndStop"),
    _servo("coulomb-motor", "coulomb_1", 0.6, "CoulombFriction", MOTOR),
    _servo("coulomb-disc", "coulomb_2", 0.1, "CoulombFriction", DISC),
    _servo("drag-disc", "drag", 0.02, "QuadraticDrag", DISC),
    _servo("unbalance-disc", "unbalance", 0.2, "Unbalance", DISC),
    _servo("hardening", "c3", 10.0, "HardeningSpring", ("spring",)),
    _servo("backlash", "gap", 0.1, "Backlash", ("spring",)),
    _servo("constant", "constant", 0.1, "ConstantLoad", DISC),
    _servo("deadzone", "deadzone", 1.5, "DeadZone", ("u",)),
    _servo("saturation", "cut", 2.0, "Saturation", ("u",)),
    _servo("brushes", "brush", 0.8, "BrushVoltageDrop", ("resistor.p", "resistor.n", "emf.p", "source.p")),
    Case("outside-position-friction", "outside", "rotor", {"bumpy": 0.2}, ("bumpy",)),
    Case("outside-deadzone", "outside", "rotor", {"deadzone": 0.5}, ("deadzone",), without=("DeadZone",)),
)


# Records ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Truth:
    """The record, and the true motion of the rotor: speed, angle, acceleration and hidden torque (n,)."""

    experiment: Experiment
    signals: dict[str, np.ndarray] = field(default_factory=dict)


def excitation(kind: str, n: int, period: float, slow: float, rng: np.random.Generator) -> np.ndarray:
    """Input within ±1 that is constant over a sample; `slow` [s] is about the plant's own time."""
    t = np.arange(n) * period
    if kind == "steps":
        hold = max(int(slow / period), 1)
        return np.repeat(rng.uniform(-1.0, 1.0, n // hold + 1), hold)[:n]
    if kind == "noise":
        memory = np.exp(-period / (0.3 * slow))
        x, u = 0.0, np.zeros(n)
        for i, e in enumerate(rng.standard_normal(n)):
            x = memory * x + np.sqrt(1.0 - memory**2) * e
            u[i] = np.clip(0.5 * x, -1.0, 1.0)
        return u
    low, high = 0.1 / slow, 1.5 / slow
    turns = low * t + (high - low) * t**2 / (2.0 * t[-1])
    return np.sin(2.0 * np.pi * turns + rng.uniform(0.0, 6.28)) * (0.7 + 0.3 * np.sin(0.37 * t / slow))


def driven(u: np.ndarray, values: dict[str, float]) -> np.ndarray:
    """Input after dead zone and saturation (as shares of the largest input for `cut`)."""
    half = values.get("deadzone", 0.0) / 2.0
    u = np.sign(u) * np.maximum(np.abs(u) - half, 0.0)
    limit = np.max(np.abs(u)) - values.get("cut", 0.0)
    return np.clip(u, -limit, limit)


def soft(value: float, threshold: float) -> float:
    """Implicit Euler step of dry friction: the speed is brought towards zero, and held there."""
    return max(value - threshold, 0.0) if value > 0.0 else min(value + threshold, 0.0)


def rotor_truth(case: Case, kind: str, size: float, n: int, seed: int) -> Truth:
    values = case.values(size)
    get = values.get
    rng = np.random.default_rng(seed)
    J, d, period = 0.5, 0.3, 0.05
    u = excitation(kind, n, period, 1.0, rng)
    given = driven(u, values)
    dt = period / SUBSTEPS
    kicks = rng.standard_normal((n, SUBSTEPS)) * np.sqrt(1e-4 * dt)
    memory = np.exp(-dt / get("load_T", 1.0))
    pushes = rng.standard_normal((n, SUBSTEPS)) * get("load", 0.0) * np.sqrt(1.0 - memory**2)
    w, phi, load = 0.0, 0.0, 0.0
    rows = np.zeros((n, 4))
    for k in range(n):
        rows[k, :2] = w, phi
        for j in range(SUBSTEPS):
            load = memory * load + pushes[k, j]
            smooth = (
                -get("drag", 0.0) * w * abs(w)
                - get("unbalance", 0.0) * np.sin(phi)
                - get("cogging", 0.0) * np.sin(get("n", 1.0) * phi)
                - get("constant", 0.0)
                - get("stop", 0.0) * (max(phi - 1.0, 0.0) + min(phi + 1.0, 0.0))
                + load
            )
            dry = (
                get("coulomb", 0.0)
                + get("stribeck", 0.0) * (1.0 + 1.5 * np.exp(-((w / 0.3) ** 2)))
                + (get("forward", 0.0) if w > 0.0 else 0.0)
                + get("bumpy", 0.0) * (1.0 + 0.8 * np.sin(phi))
            )
            free = w + (dt * (given[k] - d * w + smooth) + kicks[k, j]) / J
            after = soft(free, dt * dry / J)
            if j == 0:
                hidden = smooth - J * (free - after) / dt + given[k] - u[k]
                rows[k, 2:] = (after - w) / dt - kicks[k, j] / J / dt, hidden
            phi += dt * (w + after) / 2.0
            w = after
    y = rows[:, 1] + 0.005 * rng.standard_normal(n)
    record = Experiment(case.name, np.arange(n) * period, u[:, None], y[:, None], ("u",), ("phi",))
    return Truth(record, dict(zip(("w", "phi", "a", "hidden"), rows.T, strict=True)) | {"u": u})


def servo_truth(case: Case, kind: str, size: float, n: int, seed: int) -> Truth:
    values = case.values(size)
    get = values.get
    rng = np.random.default_rng(seed)
    period = 0.01
    J1, J2, c, d, torque, R = 6.3e-6 * 900, 0.02, 1.5, 0.02, 30 * 0.06, 4.31617
    u = 6.0 * excitation(kind, n, period, 0.5, rng)
    sag = excitation("steps", n, period, 0.8, np.random.default_rng([seed, 1]))  # of the supply, recorded
    given = driven(u, values) - get("bias", 0.0) - get("sag", 0.0) * sag
    dt = period / SUBSTEPS
    kicks = rng.standard_normal((n, SUBSTEPS)) * np.sqrt(1e-6 * dt)
    memory = np.exp(-dt / get("load_T", 1.0))
    pushes = rng.standard_normal((n, SUBSTEPS)) * get("load", 0.0) * np.sqrt(1.0 - memory**2)
    half = get("gap", 0.0) / 2.0
    w1 = a1 = w2 = a2 = load = 0.0
    y = np.zeros((n, 2))
    for k in range(n):
        y[k] = w1, a2
        for j in range(SUBSTEPS):
            load = memory * load + pushes[k, j]
            x, rate = a1 - a2, w1 - w2
            twist = soft(x, half)
            spring = c * twist + get("c3", 0.0) * twist**3 + d * rate * (abs(x) >= half)
            if spring * x < 0.0 and half > 0.0:
                spring = 0.0  # a gap cannot pull
            voltage = given[k] - torque * w1
            current = soft(voltage, get("brush", 0.0)) / R
            smooth = (
                load
                - get("drag", 0.0) * w2 * abs(w2)
                - get("unbalance", 0.0) * np.sin(a2)
                - get("constant", 0.0)
            )
            drag = get("drag_1", 0.0) * w1 * abs(w1) + get("unbalance_1", 0.0) * np.sin(a1)
            n1 = soft(w1 + dt * (torque * current - spring - drag) / J1, dt * get("coulomb_1", 0.0) / J1)
            n2 = soft(w2 + (dt * (spring + smooth) + kicks[k, j]) / J2, dt * get("coulomb_2", 0.0) / J2)
            a1 += dt * (w1 + n1) / 2.0
            a2 += dt * (w2 + n2) / 2.0
            w1, w2 = n1, n2
    y += rng.standard_normal((n, 2)) * (0.02, 0.01)
    record = Experiment(case.name, np.arange(n) * period, u[:, None], y, ("u",), ("omega", "phi"))
    return Truth(replace(record, extra={"sag": sag}) if "sag" in values else record)


TRUTHS = {
    "rotor": rotor_truth,
    "servo": servo_truth,
}


# One run ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Run:
    """The outcome of one record. `right`: an effect was named, and the truth is among the names. `curve` is
    the share of the measured curve's bins that hold the truth within 3 standard deviations. `peers` are the
    names that the other methods give, empty where they find nothing."""

    case: str
    group: str
    plant: str
    excitation: str
    size: float
    seed: int
    samples: int
    verdict: str
    claimed: tuple[str, ...]
    is_right: bool
    curve: float | None
    p_value: float | None
    seconds: float
    peers: dict[str, str] = field(default_factory=dict)
    peer_seconds: dict[str, float] = field(default_factory=dict)

    @property
    def key(self) -> tuple:
        return self.case, self.seed, self.samples


@cache
def model(plant: str) -> FlatModel:
    if plant == "servo":
        return compile_model(SERVO)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "Rotor.mo"
        path.write_text(ROTOR, encoding="utf-8")
        return compile_model(path)


Task = tuple[str, int, int, bool]  # name of the case, seed, samples, whether the other methods run too


def one_run(task: Task) -> Run:
    name, seed, samples, with_peers = task
    case = next(case for case in CASES if case.name == name)
    warnings.simplefilter("ignore")
    kind, size = EXCITATIONS[seed % 3], SIZES[seed // 3 % 3]
    # Cases must not share their noise: a seed of its own from name and number.
    own = int(np.random.SeedSequence([seed, *case.name.encode()]).generate_state(1)[0])
    truth = TRUTHS[case.plant](case, kind, size, samples, own)
    library = [effect for effect in effect_library() if effect.name not in case.without]
    flat = model(case.plant)
    began = time.perf_counter()
    try:
        found = diagnose(flat, library, [truth.experiment], options=DiagnoseOptions(jobs=1))
    except DaestError as error:
        found = None
        verdict, claimed, right, curve, p_value = f"error {error.code}", (), False, None, None
    seconds = time.perf_counter() - began
    if found is not None:
        accepted = [p for p in found.proofs if p.verdict != "rejected"]
        verdict, claimed = found.verdict, tuple(p.candidate.label for p in accepted)
        right = any(
            p.candidate.effect.name in case.names
            and bool({p.candidate.site.name, *p.candidate.site.aliases, *p.equivalent} & set(case.sites))
            for p in accepted
        )
        curve = curve_match(found, truth)
        p_value = found.screen.p_value
    peers, peer_seconds = {}, {}
    if with_peers and case.plant == "rotor":
        half = len(truth.experiment.time) // 2
        for name, method in PEERS.items():
            began = time.perf_counter()
            peers[name] = method(truth.experiment, half)
            peer_seconds[name] = round(time.perf_counter() - began, 3)
    return Run(
        case.name, case.group, case.plant, kind, size, seed, samples, verdict, claimed, right, curve, p_value,
        round(seconds, 2), peers, peer_seconds,
    )  # fmt: skip


def curve_match(found: Diagnosis, truth: Truth) -> float | None:
    """Share of bins in which the true mean load lies within 3 standard deviations of the measured curve."""
    form, signals = found.disturbance, truth.signals
    if form is None or found.verdict != "unknown effect" or not signals:
        return None
    half = signals["w"].size // 2
    J, d = (found.baseline.theta[name] for name in ("J", "d"))
    # Refitted parameters have taken their part of the hidden torque.
    left = (signals["hidden"] + (J - 0.5) * signals["a"] + (d - 0.3) * signals["w"])[:half]
    known = {"w": "rotor.w", "phi": "rotor.phi", "u": "u", "a": "rotor.a"}
    names = {model_name: name for name, model_name in known.items()}
    if form.variable not in names or (form.sign_of and form.sign_of not in names):
        return 0.0
    x = signals[names[form.variable]][:half]
    sign = np.sign(signals[names[form.sign_of]][:half]) if form.sign_of else 1.0
    # The truth as the same curve: harmonics of an angle that turns round, else straight lines.
    rows = harmonics if turns_round(form) else partial(lines_between, form.x)
    true = rows(form.x) @ np.linalg.lstsq(rows(x) * np.reshape(sign, (-1, 1)), left, rcond=None)[0]
    return float(np.mean(np.abs(true - form.w) < 3.0 * form.std))


def turns_round(form: FreeForm) -> bool:
    return form.variable_unit == "rad" and np.isclose(2.0 * form.x[-1] - form.x[-2] - form.x[0], 2.0 * np.pi)


def harmonics(x: np.ndarray) -> np.ndarray:
    return np.column_stack([np.ones_like(x), *(f(k * x) for k in (1, 2, 3) for f in (np.cos, np.sin))])


def lines_between(knots: np.ndarray, x: np.ndarray) -> np.ndarray:
    return np.column_stack([np.interp(x, knots, row) for row in np.eye(knots.size)])


# Peers ------------------------------------------------------------------------------------------------------

LAWS: dict[str, Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]] = {
    "ConstantLoad": lambda w, phi, u: np.ones_like(w),
    "CoulombFriction": lambda w, phi, u: np.tanh(w / 0.02),
    "AsymmetricFriction": lambda w, phi, u: (1.0 + np.tanh(w / 0.02)) / 2.0,
    "QuadraticDrag": lambda w, phi, u: w * np.abs(w),
    "cubic": lambda w, phi, u: w**3,
    "Unbalance": lambda w, phi, u: np.sin(phi),
    "CoggingTorque": lambda w, phi, u: np.sin(3.0 * phi),
    "spring": lambda w, phi, u: phi,
    "u|u|": lambda w, phi, u: u * np.abs(u),
    "DeadZone": lambda w, phi, u: u - np.sign(u) * np.maximum(np.abs(u) - 0.2, 0.0),
}
# The best of windows 9, 15, 21 and thresholds 0.02 to 0.2 on seeds 0 to 8 of these very records: in favour of
# the regression. Both thresholds are shown, since hits are bought with false alarms.
WINDOW = 9
THRESHOLDS = (0.05, 0.1)  # rad/s2, on columns of unit size
ALPHA = 0.05


def smoothed_regression(experiment: Experiment, half: int, threshold: float) -> str:
    """STLSQ of the unexplained acceleration on the library, angle and input smoothed alike; u and w are
    in the library too, which corrects inertia and damping. The largest term that is no parameter, or empty.

    The acceleration stands on the left alone: with it among the columns the regression would only find the
    equation of the nominal model again.
    """
    period = experiment.time[1] - experiment.time[0]
    y, u = experiment.outputs[:half, 0], experiment.inputs[:half, 0]
    phi, w, a = (savgol_filter(y, WINDOW, 3, deriv=k, delta=period) for k in (0, 1, 2))
    # A derivative in the middle of two held inputs sees their mean.
    u = savgol_filter((u + np.r_[u[0], u[:-1]]) / 2.0, WINDOW, 3)
    # Asymmetric friction is half of constant load and Coulomb friction: no column of its own.
    laws = {name: law for name, law in LAWS.items() if name != "AsymmetricFriction"}
    names = ["u", "w", *laws]
    table = np.column_stack([u, w, *(law(w, phi, u) for law in laws.values())])
    left = a - (u - 0.3 * w) / 0.5
    inner = slice(WINDOW, half - WINDOW)
    table, left = table[inner], left[inner]
    terms = stlsq(table / np.sqrt(np.mean(table**2, axis=0)), left, threshold)
    effects = {name: abs(x) for name, x in zip(names, terms, strict=True) if x and name not in ("u", "w")}
    return max(effects, key=lambda name: effects[name]) if effects else ""


def stlsq(table: np.ndarray, target: np.ndarray, threshold: float) -> np.ndarray:
    """Sequentially thresholded ridge regression: pySINDy's, or the same algorithm where it is missing."""
    try:
        from pysindy import STLSQ
    except ImportError:
        kept = np.ones(table.shape[1], dtype=bool)
        x = np.zeros(table.shape[1])
        for _ in range(20):
            own = table[:, kept]
            x = np.zeros(table.shape[1])
            x[kept] = np.linalg.solve(own.T @ own + ALPHA * np.eye(own.shape[1]), own.T @ target)
            kept = np.abs(x) >= threshold
        return np.where(kept, x, 0.0)
    found = STLSQ(threshold=threshold, alpha=ALPHA).fit(table, target[:, None])
    return np.asarray(found.coef_).ravel()


def stepwise_output_error(experiment: Experiment, half: int) -> str:
    """Refits of the simulation with one effect at a time, independent errors; the effect with the lowest BIC
    if it lies below the plain model's, else empty."""
    y, u = experiment.outputs[:half, 0], experiment.inputs[:half, 0]
    period = float(experiment.time[1] - experiment.time[0])
    bic = {"": output_error_bic(y, u, period, None)}
    bic |= {name: output_error_bic(y, u, period, law) for name, law in LAWS.items()}
    return min(bic, key=lambda name: bic[name])


def output_error_bic(y: np.ndarray, u: np.ndarray, period: float, law: Callable | None) -> float:
    """Levenberg-Marquardt over inertia, damping, initial state and the effect's size."""
    p = np.array([0.5, 0.3, y[0], (y[5] - y[0]) / (5.0 * period), 0.0][: 4 if law is None else 5])
    steps = 1e-5 * np.eye(p.size)
    damping, cost = 1e-3, np.inf
    for _ in range(25):
        runs = simulated(np.vstack([p, p + steps]), u, period, law)
        error = y - runs[0]
        cost = float(error @ error)
        slopes = (runs[1:] - runs[0]) / 1e-5
        normal = slopes @ slopes.T
        for _ in range(8):
            move = np.linalg.solve(normal + damping * np.diag(np.diag(normal) + 1e-12), slopes @ error)
            left = y - simulated((p + move)[None], u, period, law)[0]
            if float(left @ left) < cost:
                break
            damping *= 5.0
        else:
            break
        gain = cost - float(left @ left)
        p, damping, cost = p + move, damping / 5.0, float(left @ left)
        if gain < 1e-6 * cost:
            break
    return y.size * np.log(cost / y.size) + p.size * np.log(y.size)


def simulated(p: np.ndarray, u: np.ndarray, period: float, law: Callable | None) -> np.ndarray:
    """Angles (k, n) for parameter rows p (k, 4 or 5), by Heun's method with four steps a sample."""
    J, d, phi, w = (p[:, i].copy() for i in range(4))
    J = np.maximum(J, 1e-3)
    angles = np.zeros((p.shape[0], u.size))
    dt = period / 4.0

    def rate(w: np.ndarray, phi: np.ndarray, torque: float) -> np.ndarray:
        extra = 0.0 if law is None else p[:, 4] * law(w, phi, np.full_like(w, torque))
        return (torque - d * w - extra) / J

    with np.errstate(over="ignore", invalid="ignore"):
        for k, torque in enumerate(u):
            angles[:, k] = phi
            for _ in range(4):
                first = rate(w, phi, torque)
                ahead = w + dt * first
                second = rate(ahead, phi + dt * w, torque)
                phi = phi + dt * (w + ahead) / 2.0
                w = w + dt * (first + second) / 2.0
    return np.nan_to_num(angles, nan=1e6, posinf=1e6, neginf=-1e6)


PEERS: dict[str, Callable[[Experiment, int], str]] = {
    f"smoothed regression, threshold {t}": partial(smoothed_regression, threshold=t) for t in THRESHOLDS
} | {"stepwise output error": stepwise_output_error}
# Names that count as right for the peers besides the case's own.
SPANNED = {"rotor-asymmetric": ("CoulombFriction",)}


# Report -----------------------------------------------------------------------------------------------------


def limits(hits: int, runs: int) -> tuple[float, float]:
    """Two-sided 95 % limits of Clopper and Pearson."""
    low = 0.0 if hits == 0 else float(beta.ppf(0.025, hits, runs - hits + 1))
    high = 1.0 if hits == runs else float(beta.ppf(0.975, hits + 1, runs - hits))
    return low, high


@dataclass(frozen=True)
class Rate:
    """How many of the runs of a group had an outcome, with 95 % limits."""

    group: str
    what: str
    hits: int
    runs: int

    @property
    def limits(self) -> tuple[float, float]:
        return limits(self.hits, self.runs)

    def __str__(self) -> str:
        if not self.runs:
            return f"  {self.what}: no runs"
        low, high = self.limits
        share = 100 * self.hits / self.runs
        return (
            f"  {self.what}: {self.hits}/{self.runs} = {share:.1f} % ({100 * low:.1f} to {100 * high:.1f} %)"
        )


GROUPS = {
    "nothing": "nothing missing",
    "load": "coloured external load",
    "effects": "one hidden effect",
    "outside": "effect outside the library",
}
CALM = ("nothing missing", "parameters off")


def rates(runs: Sequence[Run]) -> list[Rate]:
    """What is asked of each group that was run."""
    found = []

    def ask(group: str, what: str, among: Sequence[Run], hit: Callable[[Run], bool]) -> None:
        if any(r.group == group for r in runs):
            found.append(Rate(GROUPS[group], what, sum(map(hit, among)), len(among)))

    nothing, load, effects, outside = ([r for r in runs if r.group == group] for group in GROUPS)
    ask("nothing", "other verdicts", nothing, lambda r: r.verdict not in CALM)
    ask("nothing", "an effect named", nothing, lambda r: bool(r.claimed))
    calm = ("external disturbance", "nothing missing")
    ask("load", "external disturbance or nothing missing", load, lambda r: r.verdict in calm)
    ask("load", "an effect named", load, lambda r: bool(r.claimed))
    ask("effects", "right where claimed", [r for r in effects if r.claimed], lambda r: r.is_right)
    for size in SIZES:
        some = [r for r in effects if r.size == size]
        ask("effects", f"right of all, size {size}", some, lambda r: r.is_right)
    unknown = [r for r in outside if r.verdict == "unknown effect"]
    ask("outside", "no false name", outside, lambda r: not r.claimed)
    ask("outside", "unknown effect", outside, lambda r: r.verdict == "unknown effect")
    what = "its curve holds the truth in 80 % of the bins"
    ask("outside", what, unknown, lambda r: (r.curve or 0.0) >= 0.8)
    return found


def report(runs: Sequence[Run]) -> str:
    """All rates as text."""
    lines = [f"{len(runs)} runs, {np.median([r.seconds for r in runs]):.1f} s each (median)"]
    for group, members in groupby(rates(runs), key=lambda r: r.group):
        lines += [group, *map(str, members)]
        if group == GROUPS["effects"]:
            lines += _by_case([r for r in runs if r.group == "effects"])
    lines.append("verdicts by case")
    for case in dict.fromkeys(r.case for r in runs):
        counts = Counter(r.verdict for r in runs if r.case == case)
        lines.append(f"  {case}: " + ", ".join(f"{name} {n}" for name, n in counts.most_common()))
    for method, members in groupby(peer_rates(runs), key=lambda r: r.group):
        lines += [f"{method} each, records of the rotor", *map(str, members)]
    return "\n".join(lines)


def table(runs: Sequence[Run]) -> dict:
    """All rates as a document; `right` of a case is None where no effect may be named."""
    named = {case.name: bool(case.names) for case in CASES}
    cases = []
    for name in sorted({r.case for r in runs}, key=list(named).index):
        some = [r for r in runs if r.case == name]
        cases.append(
            {
                "case": name,
                "group": GROUPS[some[0].group],
                "runs": len(some),
                "right": sum(r.is_right for r in some) if named[name] else None,
                "verdicts": dict(Counter(r.verdict for r in some).most_common()),
            }
        )
    return {
        "n_runs": len(runs),
        "samples": sorted({r.samples for r in runs}),
        "sizes": SIZES,
        "seconds": round(float(np.median([r.seconds for r in runs])), 1),
        "rates": _entries(rates(runs)),
        "peers": _entries(peer_rates(runs)),
        "cases": cases,
    }


def _entries(found: Iterable[Rate]) -> list[dict]:
    return [
        asdict(r) | dict(zip(("low", "high"), (round(x, 4) for x in r.limits), strict=True))
        for r in found
        if r.runs
    ]


def _by_case(runs: Sequence[Run]) -> list[str]:
    lines = []
    for case in dict.fromkeys(r.case for r in runs):
        some = [r for r in runs if r.case == case]
        wrong = Counter(name for r in some if r.claimed and not r.is_right for name in r.claimed)
        text = f"  {case}: right {sum(r.is_right for r in some)} of {len(some)}"
        lines.append(text + (f"; instead {', '.join(wrong)}" if wrong else ""))
    return lines


def peer_rates(runs: Sequence[Run]) -> list[Rate]:
    """daest and the other methods on the records where all of them ran; the method is the group."""
    some = [r for r in runs if r.peers.keys() >= PEERS.keys()]
    names = {case.name: case.names for case in CASES}
    spanned = {name: (*own, *SPANNED.get(name, ())) for name, own in names.items()}
    methods: dict[str, Callable[[Run], tuple[bool, bool, float]]] = {
        name: lambda r, name=name: (
            bool(r.peers[name]),
            r.peers[name] in spanned[r.case],
            r.peer_seconds[name],
        )
        for name in PEERS
    }
    methods["daest"] = lambda r: (bool(r.claimed), r.is_right, r.seconds)
    found = []
    for name, outcome in methods.items() if some else ():
        quiet = [outcome(r) for r in some if not names[r.case]]
        hidden = [outcome(r) for r in some if names[r.case]]
        method = f"{name}, {np.median([outcome(r)[2] for r in some]):.2f} s"
        found.append(
            Rate(method, "names an effect that is not there", sum(c for c, _, _ in quiet), len(quiet))
        )
        found.append(Rate(method, "right effect of all", sum(h for _, h, _ in hidden), len(hidden)))
    return found


# Command ----------------------------------------------------------------------------------------------------


def chosen(wanted: Iterable[str], cases: Sequence[Case] = CASES) -> list[Case]:
    found = [case for case in cases if not wanted or {case.name, case.group} & set(wanted)]
    unknown = set(wanted) - {case.name for case in cases} - {case.group for case in cases}
    if unknown:
        raise SystemExit(f"no case {', '.join(sorted(unknown))}; see --list")
    return found


def kept(path: Path | None) -> list[Run]:
    if path is None or not path.exists():
        return []
    return [_restored(json.loads(line)) for line in path.read_text(encoding="utf-8").splitlines()]


def keep(path: Path | None, _number: int, outcome: Outcome[Run]) -> None:
    if outcome.error is not None:
        return
    run = outcome.get()
    found = f"{run.verdict} {', '.join(run.claimed)}"
    print(f"{run.case} {run.seed} {run.excitation} {run.size}: {found}", flush=True)
    if path:
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(asdict(run)) + "\n")


def _restored(content: dict) -> Run:
    return Run(**{**content, "claimed": tuple(content["claimed"])})


def arguments(description: str, table: str) -> argparse.ArgumentParser:
    """The options that studies of records share; `table` is the file of rates in the documentation."""
    parser = argparse.ArgumentParser(description=description.partition("\n")[0])
    parser.add_argument("--case", action="append", default=[], help="group or case; may be repeated")
    parser.add_argument("--runs", type=int, default=9, help="of each case")
    parser.add_argument("--seed", type=int, default=0, help="of the first run")
    parser.add_argument("--samples", type=int, default=1600, help="of a record; half are for validation")
    parser.add_argument("--jobs", type=int, default=1, help="runs at a time on this machine")
    parser.add_argument("--json", type=Path, help="file that keeps the runs")
    parser.add_argument("--table", type=Path, help=f"file for the rates, as {table}")
    parser.add_argument("--list", action="store_true", help="name the cases and end")
    return parser


def main() -> None:
    parser = arguments(__doc__, "docs/rates.json")
    parser.add_argument("--cluster", help="address of a Dask cluster that runs them instead")
    parser.add_argument("--peers", action="store_true", help="other methods on the same records")
    options = parser.parse_args()
    cases = chosen(options.case)
    if options.list:
        print("\n".join(f"{case.group:8} {case.name}" for case in cases))
        return
    print(described(), flush=True)
    runs = kept(options.json)
    done = {run.key for run in runs}
    tasks = [
        (case.name, seed, options.samples, options.peers)
        for seed in range(options.seed, options.seed + options.runs)
        for case in cases
        if (case.name, seed, options.samples) not in done
    ]
    with workers(options.jobs, options.cluster) as pool:
        arrived = partial(keep, options.json)
        runs += [outcome.get() for outcome in pool.map(one_run, tasks, arrived=arrived)]
    if runs:
        print(report(runs))
        if options.table:
            options.table.write_text(
                json.dumps({**table(runs), "measured": described()}, indent=1) + "\n", encoding="utf-8"
            )


if __name__ == "__main__":
    import diagnosis_study  # what belongs to __main__ is unknown to other processes

    diagnosis_study.main()
