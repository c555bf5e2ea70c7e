"""Nonlinear identification of plants beside the project: simulated ones whose truth is known, with set-valued
friction and impacts that are not our equations, and measured ones of the literature."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import butter, filtfilt

from daest.data.read import Signal, read_experiments
from daest.errors import EstimationError
from daest.estimation.identify import identify
from daest.model.experiment import Experiment
from daest.model.fit import IdentifyOptions
from daest.modelica.compile import compile_model, compile_text

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
ROTATIONAL, TRANSLATIONAL = "Daest.Effects.Rotational", "Daest.Effects.Translational"
NOISE = {"omega": 0.02, "phi": 0.01}
NOISE_SHARE = 1.03  # rms over the noise of the sensor, when nothing but that noise is left

FRICTION = (
    f"{ROTATIONAL}.CoulombFriction friction(tau_c = 0.001, w_s = 0.1);",
    "connect(friction.flange, motor.flange_b);",
)
PLAY = (
    f"{ROTATIONAL}.Backlash play(gap = 0.05, phi_s = 1e-3, c = c, d = d);",
    "connect(play.flange_a, gear.flange_b); connect(play.flange_b, disc.flange_a);",
)
HARDENING = (
    f"{ROTATIONAL}.HardeningSpring hard(c3 = 1);",
    "connect(hard.flange_a, gear.flange_b); connect(hard.flange_b, disc.flange_a);",
)
WEIGHT = (f"{ROTATIONAL}.Unbalance weight(mgr = 0.05);", "connect(weight.flange, disc.flange_b);")
NAMES_OF_EFFECTS = {
    "tc_m": "friction.tau_c",
    "gap": "play.gap",
    "c3": "hard.c3",
    "mgr": "weight.mgr",
    "phi_off": "weight.phi_0",
}


def extended(text, name, parts):
    """Text of a model that extends `name` by (declaration, connections)."""
    declared, connected = ("\n  ".join(part[i] for part in parts) for i in (0, 1))
    return (
        f"{text}\nmodel Extended\n  extends {name};\n  {declared}\nequation\n  {connected}\nend Extended;\n"
    )


def compiled(tmp_path, text, class_name):
    path = tmp_path / "Plant.mo"
    path.write_text(text)
    return compile_model(path, class_name)


def servo_record(shared_data, key):
    path = next((shared_data / "servo_lab" / "known").glob(f"{key}_*.csv"))
    signals = [Signal("omega", "rad/s"), Signal("phi", "rad")]
    (experiment,) = read_experiments([path], [Signal("u", "V")], signals)
    return experiment, json.loads(path.with_suffix(".json").read_text())


def assert_nothing_but_noise_left(fit):
    """A fit of 98 %, or as much as the noise of the sensor allows."""
    validation = fit.simulated["validation"]
    for name, std in NOISE.items():
        assert validation.fit_percent[name] >= 98.0 or validation.rms[name] < NOISE_SHARE * std, name


@pytest.mark.slow
@pytest.mark.parametrize(
    ("key", "parts"),
    [("k2", (FRICTION,)), ("k4", (HARDENING,)), ("k5", (WEIGHT,)), ("k6", (FRICTION, HARDENING))],
)
def test_true_effect_leaves_the_noise_and_is_found_with_its_size(shared_data, tmp_path, key, parts):
    experiment, truth = servo_record(shared_data, key)
    servo = (EXAMPLES / "servo" / "Servo.mo").read_text()
    flat = compiled(tmp_path, extended(servo, f"Servo(R = {truth['parameters']['R']})", parts), "Extended")
    effects = {NAMES_OF_EFFECTS[name]: entry["value"] for name, entry in truth["effects"].items()}
    options = IdentifyOptions(
        method="oe", split=0.5, hold="zoh", estimate=("d", "c", "J1", "J2", "k", *effects)
    )
    fit = identify(flat, [experiment], options)
    assert fit.status == "converged"
    assert_nothing_but_noise_left(fit)
    for p in fit.parameters:
        true = effects.get(p.name, truth["parameters"].get(p.name))
        assert p.value == pytest.approx(true, rel=0.05)
        assert abs(p.value - true) < 3.0 * p.std_error, p.name


@pytest.mark.slow
def test_backlash_of_the_library_has_the_size_of_the_gap(shared_data, tmp_path):
    """Its spring pulls back on leaving contact, that of the plant does not: the gap comes out 0.8 % small."""
    experiment, truth = servo_record(shared_data, "k3")
    servo = (EXAMPLES / "servo" / "Servo.mo").read_text()
    flat = compiled(tmp_path, extended(servo, f"Servo(R = {truth['parameters']['R']})", (PLAY,)), "Extended")
    estimate = ("d", "c", "J1", "J2", "k", "play.gap")
    options = IdentifyOptions(method="oe", split=0.5, hold="zoh", estimate=estimate)
    fit = identify(flat, [experiment], options)
    assert min(fit.simulated["validation"].fit_percent.values()) > 98.0
    assert fit.theta["play.gap"] == pytest.approx(truth["effects"]["gap"]["value"], rel=0.02)


@pytest.mark.slow
def test_backlash_that_never_pulls_is_found_within_its_uncertainty(shared_data, tmp_path):
    experiment, truth = servo_record(shared_data, "k3")
    servo = (EXAMPLES / "servo" / "Servo.mo").read_text()
    spring = "Daest.Mechanics.Rotational.Components.SpringDamper spring(c = c, d = d)"
    assert spring in servo
    play = "Daest.Mechanics.Rotational.Components.ElastoBacklash spring(c = c, d = d, b = 0.05)"
    text = servo.replace(spring, play).replace("= 4.31617", f"= {truth['parameters']['R']}")
    estimate = ("d", "c", "J1", "J2", "k", "spring.b")
    options = IdentifyOptions(method="oe", split=0.5, hold="zoh", estimate=estimate)
    fit = identify(compiled(tmp_path, text, "Servo"), [experiment], options)
    assert_nothing_but_noise_left(fit)
    for p in fit.parameters:
        true = truth["effects"]["gap"]["value"] if p.name == "spring.b" else truth["parameters"][p.name]
        assert abs(p.value - true) < 3.0 * p.std_error, p.name


# The positioning system: measured, closed loop. M. Janot, M. Gautier, M. Brunot (2019)

COULOMB = (
    f"{TRANSLATIONAL}.CoulombFriction dry(f_c = 10, v_s = 1e-3);",
    "connect(dry.flange, carriage.flange_b);",
)
ONE_SIDED = (
    f"{TRANSLATIONAL}.AsymmetricDamper more(d = 5, direction = -1);",
    "connect(more.flange, carriage.flange_b);",
)


def positioning_fit(shared_data, tmp_path, parts, *names):
    signals = [Signal("force", "N", "motor_force_N")], [Signal("position", "m", "position_m")]
    folder = shared_data / "emps"
    train, test = (read_experiments([folder / f], *signals)[0] for f in ("train.csv", "test_pulses.csv"))
    text = extended((EXAMPLES / "emps" / "Emps.mo").read_text(), "Emps", parts)
    options = IdentifyOptions(method="pem", hold="zoh", estimate=("M", "Fv", "offset", *names))
    return identify(compiled(tmp_path, text, "Extended"), [train], options, [test])


@pytest.mark.slow
def test_positioning_system_with_coulomb_friction_agrees_with_the_literature(shared_data, tmp_path):
    """By one-step predictions, which a closed loop leaves unbiased."""
    fit = positioning_fit(shared_data, tmp_path, (COULOMB,), "dry.f_c")
    assert fit.status == "converged"
    published = {"M": (95.11, 0.01), "Fv": (203.5, 0.03), "dry.f_c": (20.39, 0.03), "offset": (-3.16, 0.1)}
    for name, (value, tolerance) in published.items():
        assert fit.theta[name] == pytest.approx(value, rel=tolerance), name


PUBLISHED = {"M": 95.11, "Fv": 203.5, "dry.f_c": 20.39, "offset": -3.16}
DERIVED, JUDGED = 100.0, 10.0  # Hz: low-pass before the position is derived twice, and of the force error


def force_error(shared_data, theta):
    """Relative error of the force that a motion asks for, from the derived position alone."""
    table = np.genfromtxt(shared_data / "emps" / "train.csv", delimiter=",", names=True)
    period = np.median(np.diff(table["time_s"]))

    def low_pass(signal, frequency):
        return filtfilt(*butter(4, frequency * 2 * period), signal)

    v = np.gradient(low_pass(table["position_m"], DERIVED), period)
    sign = np.tanh(v / 1e-3)
    force = theta["M"] * np.gradient(v, period) + theta["Fv"] * v + theta["offset"] + theta["dry.f_c"] * sign
    force += theta.get("more.d", 0.0) * v * (1 - sign) / 2
    measured = table["motor_force_N"]
    return np.linalg.norm(low_pass(measured - force, JUDGED)) / np.linalg.norm(low_pass(measured, JUDGED))


@pytest.mark.slow
def test_friction_that_differs_by_direction_predicts_better(shared_data, tmp_path):
    """Published: the error of the force falls from 4.08 % to 3.11 %."""
    plain = positioning_fit(shared_data, tmp_path, (COULOMB,), "dry.f_c")
    sided = positioning_fit(shared_data, tmp_path, (COULOMB, ONE_SIDED), "dry.f_c", "more.d")
    errors = [force_error(shared_data, theta) for theta in (PUBLISHED, plain.theta, sided.theta)]
    assert errors[0] == pytest.approx(0.0408, rel=0.05)
    assert errors[1] == pytest.approx(errors[0], rel=0.01)
    assert errors[2] < 0.0311
    assert sided.log_likelihood > plain.log_likelihood + 100.0
    rms = [fit.simulated["validation"].rms["position"] for fit in (plain, sided)]
    assert rms[1] < 0.75 * rms[0]


# The free swing of a small servo: measured, uneven times, quantised. Duclusaud et al., ICRA 2025

SWING = """
model Swing "Pendulum on a geared servo that is switched off"
  parameter Real J(unit = "kg.m2", min = 0) = 0.006 annotation(__Daest(estimate = true));
  parameter Real d(unit = "N.m.s/rad", min = 0) = 0.01 annotation(__Daest(estimate = true));
  parameter Real zero(unit = "rad") = 0 "Reading of the encoder with the pendulum at rest"
    annotation(__Daest(estimate = true));
  parameter Real tc(unit = "N.m", min = 0) = 0.02;
  constant Real mgl(unit = "N.m") = 0.49*9.81*0.1;
  Real w(unit = "rad/s", start = 0);
  output Real phi(unit = "rad", start = 0);
equation
  w = der(phi);
  J*der(w) = -mgl*sin(phi - zero) - d*w - tc*tanh(w/0.05);
end Swing;
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "viscous", "dry"),
    [
        pytest.param("kp100", 63.6, 70.2, id="small"),
        pytest.param("kp800", 84.8, 88.4, id="large"),
    ],
)
def test_free_swing_fits_better_than_a_quick_look_and_friction_shows(
    shared_data, tmp_path, name, viscous, dry
):
    with (shared_data / "bam_xl330" / f"{name}_lift_and_drop.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["torque_enable"] == "0"]
    time = np.array([float(row["time_s"]) for row in rows])
    angle = np.array([[float(row["position_rad"])] for row in rows])
    assert np.ptp(np.diff(time)) > 1e-4
    experiment = Experiment(name, time, np.zeros((time.size, 0)), angle, (), ("phi",))
    flat = compiled(tmp_path, SWING, "Swing")
    plain = identify(flat, [experiment], IdentifyOptions(method="oe", fix={"tc": 0.0}))
    rubbing = identify(flat, [experiment], IdentifyOptions(method="oe", estimate=("J", "d", "zero", "tc")))
    fits = [fit.simulated["estimation"].fit_percent["phi"] for fit in (plain, rubbing)]
    assert fits[0] > viscous and fits[1] > max(dry, fits[0] + 5.0)
    assert rubbing.theta["J"] == pytest.approx(0.49 * 0.1**2, rel=0.6)  # and the inertia of the gear


def test_step_before_the_first_sample():
    """The input is constant over the recording, and the output settles: both parameters show."""
    text = b"""model Lag
      parameter Real k = 1 annotation(__Daest(estimate = true));
      parameter Real T(min = 0) = 1 annotation(__Daest(estimate = true, scale = "log"));
      input Real u; Real x(start = 0); output Real y;
    equation
      T*der(x) = k*u - x; y = x;
    end Lag;
    """
    time = 0.05 * np.arange(200)
    noise = np.random.default_rng(4).normal(0.0, 0.01, time.size)
    y = 3.0 * 2.0 * (1.0 - np.exp(-time / 1.7)) + noise
    u = np.full((time.size, 1), 2.0)
    record = Experiment("step", time, u, y[:, None], ("u",), ("y",))
    fit = identify(compile_text(text, Path("Lag.mo")), [record], IdentifyOptions(method="oe"))
    for p in fit.parameters:
        assert abs(p.value - {"k": 3.0, "T": 1.7}[p.name]) < 4.0 * p.std_error < 0.05
    for rest in (6.0 + noise, np.full(time.size, 6.0)):
        with pytest.raises(EstimationError, match="the input u is constant"):
            still = Experiment("still", time, u, rest[:, None], ("u",), ("y",))
            identify(compile_text(text, Path("Lag.mo")), [still])


CAR = """model Car
  parameter Real m(unit = "kg", min = 0) = 1300 annotation(__Daest(estimate = true));
  parameter Real c0(unit = "N") = 0 annotation(__Daest(estimate = true));
  parameter Real c1(unit = "N.s/m", min = 0) = 20 annotation(__Daest(estimate = true));
  input Real F(unit = "N");
  input Real slope(unit = "rad");
  output Real v(unit = "m/s", start = 16);
equation
  m*der(v) = F - c0 - c1*v - 9.81*m*LAW;
end Car;
"""


@pytest.mark.parametrize("law", ["slope", "sin(slope)"])
def test_force_that_starts_at_zero_is_found_in_few_steps(law):
    """In units of 1 N a search would creep: no coordinate moves by more than a few units in one step."""
    rng, h, n = np.random.default_rng(4), 0.5, 800
    F, slope = np.repeat(rng.uniform(-1500, 4200, n // 20), 20), 0.05 * np.sin(0.04 * np.arange(n))
    v = np.empty(n)
    v[0] = 16.0
    force = F - 830.0 - 9.81 * 1480.0 * (slope if law == "slope" else np.sin(slope))
    decay = np.exp(-11.0 / 1480.0 * h)
    for k in range(n - 1):
        v[k + 1] = decay * v[k] + (1.0 - decay) * force[k] / 11.0
    y = v + 0.05 * rng.normal(size=n)
    record = Experiment("car", h * np.arange(n), np.c_[F, slope], y[:, None], ("F", "slope"), ("v",))
    flat = compile_text(CAR.replace("LAW", law).encode(), Path("Car.mo"), "Car")
    fit = identify(flat, [record], IdentifyOptions(second_look=False, max_iterations=15))
    truth = {"m": 1480.0, "c0": 830.0, "c1": 11.0}
    assert (fit.status, fit.hold) == ("converged", "zoh")
    for p in fit.parameters:
        assert abs(p.value - truth[p.name]) < 4.0 * p.std_error
