"""Eleven machines of text books with hidden effects and small faults, and models that are written of them.

They are simulated by the classical scheme of Runge and Kutta, which shares nothing with daest. A machine is a
class: its fields are the true values under the names that the parameters of its model have, then sizes of its
effects, without which it is what the model says. The model starts from other values.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from wrong_models_study import NAMES

FAULTS = ("none", "drift", "quantised", "coloured", "gain")
DRIFT = 0.03  # part of its value by which a parameter moves over the recording
GAIN = 0.01  # part by which the first input is larger than recorded

Curve = Callable[[int, float, np.random.Generator], np.ndarray]


# Inputs -----------------------------------------------------------------------------------------------------


def levels(size: float, seconds: float, lowest: float = -1.0) -> Curve:
    """Random levels from `lowest` to 1 times `size`, each for about so many seconds."""

    def curve(n: int, period: float, rng: np.random.Generator) -> np.ndarray:
        hold = max(1, int(seconds / period))
        values = rng.uniform(lowest, 1.0, n // hold + 2)
        u = np.repeat(values, rng.integers(max(1, hold // 2), 2 * hold + 1, values.size))
        while u.size < n:
            u = np.concatenate([u, np.full(hold, rng.uniform(lowest, 1.0))])
        return size * u[:n]

    return curve


def sine(mean: float, size: float, seconds: float) -> Curve:
    return lambda n, period, _rng: mean + size * np.sin(2 * np.pi * period * np.arange(n) / seconds)


def weather(mean: float, size: float, seconds: float) -> Curve:
    """The temperature of a day, and slow noise."""

    def curve(n: int, period: float, rng: np.random.Generator) -> np.ndarray:
        slow = np.convolve(rng.standard_normal(n + 200), np.ones(200) / 14, "valid")[:n]
        return sine(mean, size, seconds)(n, period, rng) + slow

    return curve


def sun(size: float, seconds: float) -> Curve:
    """The positive half of a sine, behind clouds."""

    def curve(n: int, period: float, rng: np.random.Generator) -> np.ndarray:
        clear = np.maximum(sine(0.0, size, seconds)(n, period, rng), 0.0)
        return clear * np.repeat(rng.uniform(0.2, 1.0, n // 36 + 2), 36)[:n]

    return curve


# Laws -------------------------------------------------------------------------------------------------------


def sign(value: float, sharp: float) -> float:
    """The sign, that changes over `sharp`."""
    return math.tanh(value / sharp)


def beyond(value: float, limit: float) -> float:
    """What a value has beyond limits of either sign."""
    return max(value - limit, 0.0) + min(value + limit, 0.0)


def within(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)


def squared(value: float) -> float:
    """The square with the sign of the value."""
    return value * abs(value)


def root(level: float) -> float:
    """The root of a level, with a finite slope at nothing."""
    return math.sqrt(max(level, 0.0) + 1e-9)


# Machines ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Effect:
    """Its size as value of the field of its name, and the laws of the library that are this effect; `why`
    there is more than one."""

    size: float
    names: tuple[str, ...]
    why: str = ""


DRY = NAMES["coulomb"]
HOLDS_DRY = "laws that contain dry friction"
ONE_SIDED = "the input reaches its upper limit alone"


@dataclass
class Machine:
    """What all machines have, times in s. `noise` are the standard deviations of the outputs by name,
    `drifting` is the parameter that the fault "drift" moves."""

    name: ClassVar[str]
    model: ClassVar[str]
    period: ClassVar[float]
    samples: ClassVar[int] = 3000
    substeps: ClassVar[int]
    start: ClassVar[tuple[float, ...]]
    inputs: ClassVar[dict[str, Curve]]
    measured: ClassVar[tuple[int, ...]]  # states
    noise: ClassVar[dict[str, float]]
    drifting: ClassVar[str]
    effects: ClassVar[dict[str, Effect]]

    def rates(self, x: Sequence[float], u: Sequence[float]) -> list[float]:
        """Derivatives of the states."""
        raise NotImplementedError

    def outputs(self, x: Sequence[float]) -> list[float]:
        """What sensors without noise measure."""
        return [x[k] for k in self.measured]


@dataclass
class QuarterCar(Machine):
    name = "car"
    model = """model QuarterCar "Quarter of a car on a road"
  parameter Real ms(unit = "kg") = 350;
  parameter Real mu(unit = "kg") = 45;
  parameter Real ks(unit = "N/m", min = 0) = 20000 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real cs(unit = "N.s/m", min = 0) = 1200 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real kt(unit = "N/m") = 190000;
  input Real zr(unit = "m");
  output Real zb(unit = "m");
  output Real zw(unit = "m");
  Real zs(unit = "m");
  Real vs(unit = "m/s");
  Real zu(unit = "m");
  Real vu(unit = "m/s");
  Real F(unit = "N");
equation
  der(zs) = vs;
  der(zu) = vu;
  F = ks*(zu - zs) + cs*(vu - vs);
  ms*der(vs) = F;
  mu*der(vu) = kt*(zr - zu) - F;
  zb = zs;
  zw = zu;
end QuarterCar;
"""
    period = 0.005
    substeps = 4
    start = (0.0, 0.0, 0.0, 0.0)
    inputs: ClassVar = {"zr": levels(0.03, 0.25)}
    measured = (0, 2)
    noise: ClassVar = {"zb": 2e-4, "zw": 2e-4}
    drifting = "ks"
    effects: ClassVar = {
        "friction": Effect(120.0, DRY, HOLDS_DRY),
        "hardening": Effect(4e6, ("HardeningSpring",)),
        "damper": Effect(800.0, ("AsymmetricDamper",)),
        "stop": Effect(6e4, ("EndStop",)),
    }
    ms: float = 350.0
    mu: float = 45.0
    ks: float = 18e3
    cs: float = 1400.0
    kt: float = 190e3
    friction: float = 0.0  # of the damper [N]
    hardening: float = 0.0  # [N/m3]
    damper: float = 0.0  # that is added where body and wheel part [N.s/m]
    stop: float = 0.0  # stiffness beyond 25 mm [N/m]

    def rates(self, x: Sequence[float], u: Sequence[float]) -> list[float]:
        zs, vs, zu, vu = x
        deflection, speed = zu - zs, vu - vs
        force = self.ks * deflection + self.cs * speed
        force += self.friction * sign(speed, 1e-2)
        force += self.hardening * deflection**3
        force += self.damper * min(speed, 0.0)
        force += self.stop * beyond(deflection, 0.025)
        return [vs, force / self.ms, vu, (self.kt * (u[0] - zu) - force) / self.mu]


@dataclass
class Hoist(Machine):
    name = "hoist"
    model = """model Hoist "Drum, rope and a balanced cabin"
  parameter Real J(unit = "kg.m2", min = 0) = 1.5 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real r(unit = "m") = 0.3;
  parameter Real k(unit = "N/m", min = 0) = 50000 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real c(unit = "N.s/m") = 900;
  parameter Real m(unit = "kg") = 300;
  parameter Real b(unit = "N.m.s/rad", min = 0) = 5 annotation(__Daest(estimate = true, scale = "log"));
  input Real tau(unit = "N.m");
  output Real n(unit = "rad/s");
  output Real s(unit = "m/s");
  Real w(unit = "rad/s");
  Real d(unit = "m");
  Real v(unit = "m/s");
  Real T(unit = "N");
equation
  der(d) = r*w - v;
  T = k*d + c*(r*w - v);
  J*der(w) = tau - b*w - r*T;
  m*der(v) = T;
  n = w;
  s = v;
end Hoist;
"""
    period = 0.01
    substeps = 10
    start = (0.0, 0.0, 0.0)
    inputs: ClassVar = {"tau": levels(250.0, 1.0)}
    measured = (0, 2)
    noise: ClassVar = {"n": 0.02, "s": 0.005}
    drifting = "k"
    effects: ClassVar = {
        "friction": Effect(60.0, DRY, HOLDS_DRY),
        "drag": Effect(60.0, ("QuadraticDrag",)),
        "weight": Effect(400.0, ("ConstantLoad", "Gravity"), "a weight is a constant load"),
    }
    J: float = 2.0
    r: float = 0.3
    k: float = 60e3
    c: float = 900.0
    m: float = 300.0
    b: float = 4.0
    friction: float = 0.0  # of the drum [N.m]
    drag: float = 0.0  # of the air at the cabin [N.s2/m2]
    weight: float = 0.0  # that is not balanced [N]

    def rates(self, x: Sequence[float], u: Sequence[float]) -> list[float]:
        w, d, v = x
        rope = self.k * d + self.c * (w * self.r - v)
        drum = u[0] - self.b * w - rope * self.r - self.friction * sign(w, 2e-2)
        cabin = rope - self.drag * squared(v) - self.weight
        return [drum / self.J, w * self.r - v, cabin / self.m]


@dataclass
class Cylinder(Machine):
    name = "cylinder"
    model = """model Cylinder "Valve, oil, piston and a mass that glides"
  parameter Real A(unit = "m2") = 1e-3;
  parameter Real E(unit = "Pa/m3", min = 0) = 8e9 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real kq(unit = "m3/(s.V)", min = 0) = 4e-5 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real m(unit = "kg", min = 0) = 80 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real b(unit = "N.s/m", min = 0) = 1100 annotation(__Daest(estimate = true, scale = "log"));
  input Real u(unit = "V");
  output Real dp(unit = "Pa");
  output Real y(unit = "m/s");
  Real p(unit = "Pa");
  Real v(unit = "m/s");
equation
  der(p) = E*(kq*u - A*v);
  m*der(v) = A*p - b*v;
  dp = p;
  y = v;
end Cylinder;
"""
    period = 0.004
    substeps = 20
    start = (0.0, 0.0)
    inputs: ClassVar = {"u": levels(8.0, 0.5)}
    measured = (0, 1)
    noise: ClassVar = {"dp": 3e3, "y": 3e-3}
    drifting = "E"
    effects: ClassVar = {
        "dead zone": Effect(1.2, ("DeadZone",)),
        "saturation": Effect(5.0, ("Saturation",)),
        "leak": Effect(2.5e-11, ("Leak", "Leakage"), "both are a flow in proportion to the pressure"),
        "friction": Effect(180.0, DRY, HOLDS_DRY),
    }
    A: float = 1e-3
    E: float = 1e10
    kq: float = 5e-5
    m: float = 80.0
    b: float = 900.0
    dead_zone: float = 0.0  # of the valve [V]
    saturation: float = math.inf  # of the valve [V]
    leak: float = 0.0  # past the piston [m3/(s.Pa)]
    friction: float = 0.0  # [N]

    def rates(self, x: Sequence[float], u: Sequence[float]) -> list[float]:
        p, v = x
        valve = within(beyond(u[0], self.dead_zone), self.saturation)
        flow = self.kq * valve - self.A * v - self.leak * p
        force = self.A * p - self.b * v - self.friction * sign(v, 2e-3)
        return [self.E * flow, force / self.m]


@dataclass
class DCMotor(Machine):
    name = "dc"
    model = """model DCMotor
  parameter Real R(unit = "Ohm", min = 0) = 1 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real L(unit = "H") = 2e-3;
  parameter Real k(unit = "N.m/A", min = 0) = 0.055 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real J(unit = "kg.m2", min = 0) = 2.5e-4 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real b(unit = "N.m.s/rad", min = 0) = 3e-4 annotation(__Daest(estimate = true, scale = "log"));
  input Real u(unit = "V");
  output Real c(unit = "A");
  output Real n(unit = "rad/s");
  Real i(unit = "A");
  Real w(unit = "rad/s");
equation
  L*der(i) = u - R*i - k*w;
  J*der(w) = k*i - b*w;
  c = i;
  n = w;
end DCMotor;
"""
    period = 0.001
    substeps = 10
    start = (0.0, 0.0)
    inputs: ClassVar = {"u": levels(15.0, 0.08)}
    measured = (0, 1)
    noise: ClassVar = {"c": 0.05, "n": 0.5}
    drifting = "k"
    effects: ClassVar = {
        "brush": Effect(0.7, ("BrushVoltageDrop",)),
        "friction": Effect(0.02, DRY, HOLDS_DRY),
        "fan": Effect(1.5e-6, ("QuadraticDrag",)),
    }
    R: float = 1.2
    L: float = 2e-3
    k: float = 0.06
    J: float = 3e-4
    b: float = 2e-4
    brush: float = 0.0  # voltage that the brushes take [V]
    friction: float = 0.0  # of the shaft [N.m]
    fan: float = 0.0  # [N.m.s2/rad2]

    def rates(self, x: Sequence[float], u: Sequence[float]) -> list[float]:
        i, w = x
        voltage = u[0] - self.R * i - self.k * w - self.brush * sign(i, 2e-2)
        torque = self.k * i - self.b * w - self.friction * sign(w, 0.3) - self.fan * squared(w)
        return [voltage / self.L, torque / self.J]


@dataclass
class ThreeZones(Machine):
    name = "zones"
    model = """model ThreeZones
  parameter Real C1(unit = "J/K", min = 0) = 7e5 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real C2(unit = "J/K") = 6e5;
  parameter Real C3(unit = "J/K") = 7e5;
  parameter Real G1(unit = "W/K", min = 0) = 70 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real G2(unit = "W/K", min = 0) = 35 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real G3(unit = "W/K", min = 0) = 55 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real K(unit = "W/K", min = 0) = 100 annotation(__Daest(estimate = true, scale = "log"));
  input Real Q1(unit = "W");
  input Real Ta(unit = "degC");
  input Real sun(unit = "W/m2");
  input Real Q3(unit = "W");
  output Real y1(unit = "degC");
  output Real y2(unit = "degC");
  output Real y3(unit = "degC");
  Real T1(unit = "degC", start = 18);
  Real T2(unit = "degC", start = 18);
  Real T3(unit = "degC", start = 18);
equation
  C1*der(T1) = Q1 - G1*(T1 - Ta) - K*(T1 - T2);
  C2*der(T2) = -G2*(T2 - Ta) + K*(T1 - T2) + K*(T3 - T2);
  C3*der(T3) = Q3 - G3*(T3 - Ta) - K*(T3 - T2);
  y1 = T1;
  y2 = T2;
  y3 = T3;
end ThreeZones;
"""
    period = 600.0
    samples = 2400
    substeps = 2
    start = (18.0, 18.0, 18.0, 18.0)  # the last is the wall
    inputs: ClassVar = {
        "Q1": levels(2500.0, 14400.0, 0.1),
        "Ta": weather(3.0, 6.0, 86400.0),
        "sun": sun(300.0, 86400.0),
        "Q3": levels(2000.0, 20000.0, 0.1),
    }
    measured = (0, 1, 2)
    noise: ClassVar = {"y1": 0.05, "y2": 0.05, "y3": 0.05}
    drifting = "G1"
    effects: ClassVar = {
        "saturation": Effect(1800.0, ("Saturation", "OneSidedLimit"), ONE_SIDED),
        "sun": Effect(
            0.9,
            ("MeasuredHeatGain", "MeasuredHeatFlow", "MeasuredInput"),
            "all are heat in proportion to the measured sun",
        ),
        "gain": Effect(350.0, ("ConstantHeatGain",)),
        "wall": Effect(120.0, ("ExtraHeatCapacity",)),
    }
    C1: float = 8e5
    C2: float = 6e5
    C3: float = 7e5
    G1: float = 60.0
    G2: float = 40.0
    G3: float = 50.0
    K: float = 90.0
    saturation: float = math.inf  # of the first heater [W]
    sun: float = 0.0  # window of the second zone [m2]
    gain: float = 0.0  # of people and machines in the second zone [W]
    wall: float = 0.0  # between the first zone and a wall of 2.5 MJ/K [W/K]

    def rates(self, x: Sequence[float], u: Sequence[float]) -> list[float]:
        T1, T2, T3, wall = x
        heater, outside, sun, Q3 = u
        to_wall = self.wall * (T1 - wall)
        Q1 = min(heater, self.saturation) - self.G1 * (T1 - outside) - self.K * (T1 - T2) - to_wall
        Q2 = -self.G2 * (T2 - outside) + self.K * (T1 - T2) + self.K * (T3 - T2)
        Q2 += self.sun * sun + self.gain
        Q3 = Q3 - self.G3 * (T3 - outside) - self.K * (T3 - T2)
        return [Q1 / self.C1, Q2 / self.C2, Q3 / self.C3, to_wall / 2.5e6]


@dataclass
class ThreeTanks(Machine):
    name = "tanks3"
    model = """model ThreeTanks
  parameter Real A(unit = "m2") = 0.015;
  parameter Real k(unit = "m2/s", min = 0) = 3e-4 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real ko(unit = "m2/s", min = 0) = 4e-4 annotation(__Daest(estimate = true, scale = "log"));
  input Real q(unit = "m3/s");
  output Real y1(unit = "m");
  output Real y2(unit = "m");
  output Real y3(unit = "m");
  Real h1(unit = "m", start = 0.5);
  Real h2(unit = "m", start = 0.4);
  Real h3(unit = "m", start = 0.3);
equation
  A*der(h1) = q - k*(h1 - h2);
  A*der(h2) = k*(h1 - h2) - k*(h2 - h3);
  A*der(h3) = k*(h2 - h3) - ko*h3;
  y1 = h1;
  y2 = h2;
  y3 = h3;
end ThreeTanks;
"""
    period = 2.0
    samples = 2400
    substeps = 4
    start = (0.5, 0.4, 0.3)
    inputs: ClassVar = {"q": levels(2.6e-4, 120.0, 0.1)}
    measured = (0, 1, 2)
    noise: ClassVar = {"y1": 0.004, "y2": 0.004, "y3": 0.004}
    drifting = "k"
    effects: ClassVar = {
        "dead zone": Effect(0.8e-4, ("DeadZone",)),
        "saturation": Effect(2.2e-4, ("Saturation", "OneSidedLimit"), ONE_SIDED),
        "root": Effect(2.2e-4, ("FreeOutlet",)),
        "leak": Effect(8e-5, ("FreeOutlet",)),
        "overflow": Effect(2e-3, ("Overflow",)),
    }
    A: float = 0.015
    k: float = 4e-4
    ko: float = 3e-4
    dead_zone: float = 0.0  # of the pump [m3/s]
    saturation: float = math.inf  # of the pump [m3/s]
    root: float = 0.0  # the outlet as a hole in place of a long pipe [m2.5/s]
    leak: float = 0.0  # a hole in the second tank [m2.5/s]
    overflow: float = 0.0  # over the rim of the first tank at 0.9 m [m2/s]

    def rates(self, x: Sequence[float], u: Sequence[float]) -> list[float]:
        h1, h2, h3 = x
        pump = min(beyond(u[0], self.dead_zone), self.saturation) - self.overflow * max(h1 - 0.9, 0.0)
        first, second = self.k * (h1 - h2), self.k * (h2 - h3)
        outlet = self.root * root(h3) if self.root else self.ko * h3
        lost = self.leak * root(h2)
        return [(pump - first) / self.A, (first - second - lost) / self.A, (second - outlet) / self.A]


@dataclass
class Filter(Machine):
    name = "filter"
    model = """model Filter "Coil, capacitor and a load"
  parameter Real L(unit = "H", min = 0) = 8e-4 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real C(unit = "F", min = 0) = 2.4e-4 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real R(unit = "Ohm", min = 0) = 9 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real r(unit = "Ohm", min = 0) = 0.2 annotation(__Daest(estimate = true, scale = "log"));
  input Real u(unit = "V");
  output Real c(unit = "A");
  output Real y(unit = "V");
  Real i(unit = "A");
  Real v(unit = "V");
equation
  L*der(i) = u - r*i - v;
  C*der(v) = i - v/R;
  c = i;
  y = v;
end Filter;
"""
    period = 5e-5
    substeps = 8
    start = (0.0, 0.0)
    inputs: ClassVar = {"u": levels(12.0, 2e-3)}
    measured = (0, 1)
    noise: ClassVar = {"c": 0.03, "y": 0.05}
    drifting = "C"
    effects: ClassVar = {
        "saturating": Effect(2.5, ("SaturatingInductance",)),
        "drop": Effect(0.7, ("BrushVoltageDrop",)),
    }
    L: float = 1e-3
    C: float = 2e-4
    R: float = 8.0
    r: float = 0.25
    saturating: float = math.inf  # current at which half of the inductance is left [A]
    drop: float = 0.0  # of a contact [V]

    def rates(self, x: Sequence[float], u: Sequence[float]) -> list[float]:
        i, v = x
        inductance = self.L / (1.0 + (i / self.saturating) ** 2)
        voltage = u[0] - self.r * i - v - self.drop * sign(i, 2e-2)
        return [voltage / inductance, (i - v / self.R) / self.C]


@dataclass
class Pendulum(Machine):
    name = "pendulum"
    model = """model Pendulum
  parameter Real J(unit = "kg.m2", min = 0) = 0.015 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real b(unit = "N.m.s/rad", min = 0) = 0.04 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real mgl(unit = "N.m", min = 0) = 0.35 annotation(__Daest(estimate = true, scale = "log"));
  input Real tau(unit = "N.m");
  output Real angle(unit = "rad");
  Real th(unit = "rad");
  Real w(unit = "rad/s");
equation
  der(th) = w;
  J*der(w) = tau - b*w - mgl*sin(th);
  angle = th;
end Pendulum;
"""
    period = 0.01
    substeps = 10
    start = (0.0, 0.0)
    inputs: ClassVar = {"tau": levels(0.5, 0.5)}
    measured = (0,)
    noise: ClassVar = {"angle": 0.005}
    drifting = "b"
    effects: ClassVar = {
        "friction": Effect(0.06, DRY, HOLDS_DRY),
        "drag": Effect(0.03, ("QuadraticDrag",)),
        "spring": Effect(0.25, ("ReturnSpring",)),
        "stop": Effect(6.0, ("EndStop",)),
        "offset": Effect(0.09, ("ConstantLoad", "Offset"), "the motor's own torque acts at the same place"),
    }
    J: float = 0.02
    b: float = 0.03
    mgl: float = 0.4
    friction: float = 0.0  # of the bearing [N.m]
    drag: float = 0.0  # of the air [N.m.s2/rad2]
    spring: float = 0.0  # to the housing [N.m/rad]
    stop: float = 0.0  # stiffness beyond 0.9 rad [N.m/rad]
    offset: float = 0.0  # of the torque [N.m]

    def rates(self, x: Sequence[float], u: Sequence[float]) -> list[float]:
        th, w = x
        torque = u[0] + self.offset - self.b * w - self.mgl * math.sin(th)
        torque -= self.friction * sign(w, 5e-2) + self.drag * squared(w)
        torque -= self.spring * th + self.stop * beyond(th, 0.9)
        return [w, torque / self.J]


@dataclass
class Heater(Machine):
    name = "heater"
    model = """model Heater "Stirred tank that water flows through"
  parameter Real V(unit = "m3", min = 0) = 0.016 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real rc(unit = "J/(m3.K)") = 4.18e6;
  input Real q(unit = "m3/s");
  input Real P(unit = "W");
  input Real Tin(unit = "degC");
  output Real y(unit = "degC");
  Real T(unit = "degC", start = 20);
equation
  V*rc*der(T) = q*rc*(Tin - T) + P;
  y = T;
end Heater;
"""
    period = 4.0
    samples = 2400
    substeps = 4
    start = (20.0, 20.0)  # the last is the sensor
    inputs: ClassVar = {
        "q": levels(2e-4, 300.0, 0.1),
        "P": levels(6000.0, 200.0, 0.1),
        "Tin": sine(12.0, 4.0, 2000.0),
    }
    noise: ClassVar = {"y": 0.05}
    drifting = "V"
    effects: ClassVar = {
        "loss": Effect(35.0, ("HeatLoss",)),
        "boost": Effect(600.0, ("ConstantHeatGain", "Offset"), "an offset of the power is a constant heat"),
        "lag": Effect(25.0, ("Lag",)),
    }
    V: float = 0.02
    rc: float = 4.18e6
    loss: float = 0.0  # through the wall to 20 degC [W/K]
    boost: float = 0.0  # of a second heater that is always on [W]
    lag: float = 0.0  # of the sensor [s]

    def rates(self, x: Sequence[float], u: Sequence[float]) -> list[float]:
        T, sensor = x
        q, P, Tin = u
        heat = q * self.rc * (Tin - T) + P - self.loss * (T - 20.0) + self.boost
        return [heat / (self.V * self.rc), (T - sensor) / self.lag if self.lag else 0.0]

    def outputs(self, x: Sequence[float]) -> list[float]:
        return [x[1] if self.lag else x[0]]


@dataclass
class Train(Machine):
    name = "train"
    model = """model Train
  parameter Real m(unit = "kg", min = 0) = 3.5e4 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real c(unit = "N.s/m", min = 0) = 700 annotation(__Daest(estimate = true, scale = "log"));
  input Real F(unit = "N");
  output Real y(unit = "m/s");
  Real v(unit = "m/s");
equation
  m*der(v) = F - c*v;
  y = v;
end Train;
"""
    period = 0.5
    samples = 2400
    substeps = 10
    start = (0.0,)
    inputs: ClassVar = {"F": levels(2.5e4, 30.0)}
    measured = (0,)
    noise: ClassVar = {"y": 0.05}
    drifting = "c"
    effects: ClassVar = {
        "drag": Effect(45.0, ("QuadraticDrag",)),
        "friction": Effect(2500.0, DRY, HOLDS_DRY),
        "slope": Effect(3000.0, ("ConstantLoad", "Offset", "Gravity"), "all are a constant force on it"),
        "saturation": Effect(1.6e4, ("Saturation",)),
    }
    m: float = 4e4
    c: float = 600.0
    drag: float = 0.0  # of the air [N.s2/m2]
    friction: float = 0.0  # [N]
    slope: float = 0.0  # weight along the line [N]
    saturation: float = math.inf  # of the drive [N]

    def rates(self, x: Sequence[float], u: Sequence[float]) -> list[float]:
        v = x[0]
        force = within(u[0], self.saturation) - self.c * v
        force -= self.drag * squared(v) + self.friction * sign(v, 2e-2) + self.slope
        return [force / self.m]


@dataclass
class Shaft(Machine):
    name = "shaft"
    model = """model Shaft "Motor, elastic shaft and load"
  parameter Real J1(unit = "kg.m2") = 2e-3;
  parameter Real J2(unit = "kg.m2", min = 0) = 5e-3 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real k(unit = "N.m/rad", min = 0) = 25 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real c(unit = "N.m.s/rad") = 0.02;
  parameter Real b1(unit = "N.m.s/rad", min = 0) = 0.012 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real b2(unit = "N.m.s/rad", min = 0) = 0.012 annotation(__Daest(estimate = true, scale = "log"));
  input Real tau(unit = "N.m");
  output Real n1(unit = "rad/s");
  output Real n2(unit = "rad/s");
  Real w1(unit = "rad/s");
  Real w2(unit = "rad/s");
  Real d(unit = "rad");
  Real T(unit = "N.m");
equation
  der(d) = w1 - w2;
  T = k*d + c*(w1 - w2);
  J1*der(w1) = tau - b1*w1 - T;
  J2*der(w2) = T - b2*w2;
  n1 = w1;
  n2 = w2;
end Shaft;
"""
    period = 0.002
    substeps = 8
    start = (0.0, 0.0, 0.0)
    inputs: ClassVar = {"tau": levels(0.8, 0.15)}
    measured = (0, 2)
    noise: ClassVar = {"n1": 0.1, "n2": 0.1}
    drifting = "k"
    effects: ClassVar = {
        "friction": Effect(0.12, DRY, HOLDS_DRY),
        "drag": Effect(4e-4, ("QuadraticDrag",)),
        "play": Effect(0.03, ("Backlash",)),
        "hardening": Effect(6000.0, ("HardeningSpring",)),
    }
    J1: float = 2e-3
    J2: float = 6e-3
    k: float = 30.0
    c: float = 0.02
    b1: float = 0.01
    b2: float = 0.015
    friction: float = 0.0  # of the load [N.m]
    drag: float = 0.0  # of the load [N.m.s2/rad2]
    play: float = 0.0  # to either side [rad]
    hardening: float = 0.0  # [N.m/rad3]

    def rates(self, x: Sequence[float], u: Sequence[float]) -> list[float]:
        w1, d, w2 = x
        touches = abs(d) >= self.play
        torque = self.k * beyond(d, self.play) + self.hardening * d**3
        torque += self.c * (w1 - w2) if touches else 0.0
        load = torque - self.b2 * w2 - self.friction * sign(w2, 5e-2) - self.drag * squared(w2)
        return [(u[0] - self.b1 * w1 - torque) / self.J1, w1 - w2, load / self.J2]


KINDS = (QuarterCar, Hoist, Cylinder, DCMotor, ThreeZones, ThreeTanks, Filter, Pendulum, Heater, Train, Shaft)
MACHINES: dict[str, type[Machine]] = {kind.name: kind for kind in KINDS}


def with_effects(name: str, effects: Sequence[str]) -> Machine:
    """A machine with these effects in their sizes."""
    kind = MACHINES[name]
    return kind(**{effect.replace(" ", "_"): kind.effects[effect].size for effect in effects})


# Recordings -------------------------------------------------------------------------------------------------


def recording(
    machine: Machine, fault: str, rng: np.random.Generator, every: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """Inputs and outputs (samples, signals) as they are recorded, in periods `every` times as long."""
    n, period = machine.samples // every, machine.period * every
    u = np.column_stack([curve(n, period, rng) for curve in machine.inputs.values()])
    y = simulated(machine, u, fault, every)
    noise = rng.standard_normal(y.shape)
    if fault == "coloured":
        for k in range(1, n):
            noise[k] = 0.7 * noise[k - 1] + 0.71 * noise[k]
    std = np.array(list(machine.noise.values()))
    y = y + std * noise
    if fault == "quantised":
        y = np.round(y / (2 * std)) * 2 * std
    return u, y


def simulated(machine: Machine, u: np.ndarray, fault: str = "none", every: int = 1) -> np.ndarray:
    """Outputs (samples, outputs) without noise; inputs keep their values between the samples."""
    x, y = list(machine.start), []
    value = getattr(machine, machine.drifting)
    used = u * np.array([1.0 + GAIN, *np.ones(u.shape[1] - 1)]) if fault == "gain" else u
    for k, now in enumerate(used.tolist()):
        y.append(machine.outputs(x))
        if fault == "drift":
            setattr(machine, machine.drifting, value * (1.0 + DRIFT * (k / len(u) - 0.5)))
        for _ in range(every * machine.substeps):
            x = stepped(machine, x, now, machine.period / machine.substeps)
    setattr(machine, machine.drifting, value)
    return np.array(y)


def stepped(machine: Machine, x: list[float], u: list[float], dt: float) -> list[float]:
    """The states after a step of the classical scheme of Runge and Kutta."""
    k1 = machine.rates(x, u)
    k2 = machine.rates([a + dt / 2 * b for a, b in zip(x, k1, strict=True)], u)
    k3 = machine.rates([a + dt / 2 * b for a, b in zip(x, k2, strict=True)], u)
    k4 = machine.rates([a + dt * b for a, b in zip(x, k3, strict=True)], u)
    slopes = zip(x, k1, k2, k3, k4, strict=True)
    return [a + dt / 6 * (b + 2 * c + 2 * d + e) for a, b, c, d, e in slopes]
