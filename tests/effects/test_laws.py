"""The laws of the effects against closed forms in NumPy, and their signs: friction takes energy."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from effect_rig import label, law, rig, rig_sites

from daest.model.effects import Effect
from daest.model.flat import FlatModel
from daest.modelica.compile import compile_text
from daest.modelica.effects.attach import attach
from daest.modelica.effects.catalogue import effect_library, find_effect
from daest.modelica.places.sites import find_site, fits
from daest.systems.simulation.simulate import simulate

Law = Callable[[dict[str, float]], float]
RNG_SEED = 7
N_POINTS = 8
G_N, SIGMA = 9.80665, 5.670374419e-8


def ramp(x: float, width: float) -> float:
    return (x + np.hypot(x, width)) / 2


def curve(x: float, values: list[float]) -> float:
    """Straight lines through `values` at equal distances over -1 … 1."""
    return float(np.interp(x, np.linspace(-1, 1, len(values)), values))


# Rotational laws; the translational ones are the same with other letters (see `mirrored`).
FRICTION: dict[str, Law] = {
    "ViscousFriction": lambda v: -v["d"] * v["w"],
    "CoulombFriction": lambda v: -v["tau_c"] * np.tanh(v["w"] / v["w_s"]),
    "StribeckFriction": lambda v: (
        -v["tau_c"] * (1 + v["b"] * np.exp(-((v["w"] / v["w_st"]) ** 2))) * np.tanh(v["w"] / v["w_s"])
    ),
    "AsymmetricFriction": lambda v: (
        -v["tau_d"] * np.tanh(v["w"] / v["w_s"]) * (1 + v["direction"] * np.tanh(v["w"] / v["w_s"])) / 2
    ),
    "AsymmetricDamper": lambda v: -v["d"] * v["w"] * (1 + v["direction"] * np.tanh(v["w"] / v["w_s"])) / 2,
    "QuadraticDrag": lambda v: -v["k"] * v["w"] * np.hypot(v["w"], v["w_s"]),
}
MECHANICAL: dict[str, Law] = {
    **FRICTION,
    "ConstantLoad": lambda v: -v["tau_0"],
    "EndStop": lambda v: (
        -v["c"] * (ramp(v["phi"] - v["phi_max"], v["phi_s"]) - ramp(v["phi_min"] - v["phi"], v["phi_s"]))
    ),
    "LearnedFriction": lambda v: -curve(v["w"] / v["w_max"], knots(v, "y")),
    "LearnedSpring": lambda v: -curve(v["phi"] / v["phi_max"], knots(v, "y")),
    "HardeningSpring": lambda v: v["c3"] * v["phi_rel"] ** 3,
    "CubicSpring": lambda v: -v["c3"] * (v["phi"] - v.get("phi_0", v.get("s_0"))) ** 3,
    "ReturnSpring": lambda v: -v["c"] * (v["phi"] - v.get("phi_0", v.get("s_0"))),
    "FlexibleAppendage": lambda v: (
        v.get("J", v.get("m", 0.0))
        * ((2 * np.pi / v["T"]) ** 2 * v["z"] + 4 * np.pi * v["zeta"] / v["T"] * v["r"])
    ),
    "DraggedInertia": lambda v: v["J"] * v["r"] / v["T"],
    "DraggedMass": lambda v: v["m"] * v["r"] / v["T"],
    "LuGreFriction": lambda v: -v["tau_c"] * v["z"],
    "HystereticSpring": lambda v: v["tau_h"] * v["z"],
    "BoucWenSpring": lambda v: v["tau_h"] * v["z"],
    "RelaxingSpring": lambda v: v["c"] * v["x"],
}
OTHERS: dict[str, tuple[str, Law]] = {
    "Unbalance": ("tau", lambda v: -v["mgr"] * np.sin(v["phi"] + v["phi_0"])),
    "CoggingTorque": ("tau", lambda v: -v["tau_k"] * np.sin(v["n"] * v["phi"] + v["phi_0"])),
    "MeasuredTorque": ("tau", lambda v: v["k"] * v["u"]),
    "MeasuredForce": ("f", lambda v: v["k"] * v["u"]),
    "Gravity": ("f", lambda v: -v["m"] * G_N * np.sin(v["slope"])),
    "CoggingForce": ("f", lambda v: -v["f_k"] * np.sin(2 * np.pi * v["s"] / v["p"] + v["phi_0"])),
    "BrushVoltageDrop": ("v", lambda v: v["V_b"] * np.tanh(v["i"] / v["i_s"])),
    "TemperatureDependentResistance": ("v", lambda v: v["r"] * v["x"] * v["i"]),
    "VoltageRelaxation": ("v", lambda v: v["R"] * v["x"]),
    "LearnedVoltage": ("v", lambda v: curve(v["i"] / v["i_max"], knots(v, "y"))),
    "MeasuredVoltage": ("v", lambda v: v["k"] * v["u"]),
    "Inductance": ("v", lambda v: v["L"] * v["der_i"]),
    "SaturatingInductance": ("psi", lambda v: v["L"] * v["i_sat"] * np.tanh(v["i"] / v["i_sat"])),
    "Leakage": ("i", lambda v: v["G"] * v["v"]),
    "GroundLeakage": ("i", lambda v: v["G"] * v["v"]),
    "GrowingCapacity": ("i", lambda v: v["k"] * v["v"] * v["der_v"]),
    "WideningTank": ("q", lambda v: -v["k"] * v["p"] * v["der_p"]),
    "Radiation": ("Q_flow", lambda v: v["Gr"] * SIGMA * (v["port_a.T"] ** 4 - v["port_b.T"] ** 4)),
    "Conduction": ("Q_flow", lambda v: v["G"] * v["dT"]),
    "ExtraHeatCapacity": ("Q_flow", lambda v: -v["G"] * v["z"]),
    "HiddenVessel": ("q", lambda v: -v["G"] * v["z"]),
    "WallCapacity": (
        "Q_flow",
        lambda v: v["G"] * ((1 - v["share"]) * v["port_a.T"] + v["share"] * v["port_b.T"] - v["T_w"]),
    ),
    "ConstantHeatGain": ("Q_flow", lambda v: v["Q_0"]),
    "HeatLoss": ("Q_flow", lambda v: -v["G"] * (v["port.T"] - v["T_0"])),
    "RadiationLoss": ("Q_flow", lambda v: -v["Gr"] * 5.670374419e-8 * (v["port.T"] ** 4 - v["T_0"] ** 4)),
    "MeasuredHeatGain": ("Q_flow", lambda v: v["A"] * v["u"]),
    "MeasuredSurroundings": ("Q_flow", lambda v: -v["G"] * (v["port.T"] - v["u"])),
    "MeasuredHeatFlow": ("Q_flow", lambda v: v["k"] * v["u"]),
    "MeasuredVentilation": ("Q_flow", lambda v: v["k"] * v["u"] * v["dT"]),
    "Orifice": ("dp", lambda v: v["k"] * v["q"] * np.hypot(v["q"], v["q_s"])),
    "ConstantHead": ("dp", lambda v: v["dp_0"]),
    "FluidInertia": ("dp", lambda v: v["L"] * v["der_q"]),
    "Overflow": ("q", lambda v: -v["k"] * ramp(v["p"] - v["p_max"], v["p_s"])),
    "Weir": ("q", lambda v: v["k"] * ramp(v["p"] - v["p_max"], v["p_s"])),
    "Downpipe": ("q", lambda v: v["k"] * np.sqrt(ramp(v["p"] - v["p_0"], v["p_s"]) / v["p_1"])),
    "FreeOutlet": ("q", lambda v: -v["k"] * np.sqrt(ramp(v["p"] - v["p_0"], v["p_s"]) / v["p_1"])),
    "TurbulentLine": (
        "q",
        lambda v: v["k"] * v["dp"] / np.sqrt(v["p_1"] * np.hypot(v["dp"], v["p_s"])),
    ),
    "LaminarLine": ("q", lambda v: v["G"] * v["dp"]),
    "LaminarGasLine": ("q", lambda v: v["b"] * (v["port_a.p"] ** 2 - v["port_b.p"] ** 2)),
    "ConstantFlow": ("q", lambda v: v["q_0"]),
    "Leak": ("q", lambda v: -v["G"] * v["p"]),
    "MeasuredFlow": ("q", lambda v: v["k"] * v["u"]),
    "ConstantInflow": ("r", lambda v: v["r_0"]),
    "FirstOrderLoss": ("r", lambda v: -v["k"] * v["x"]),
    "SaturableLoss": ("r", lambda v: -v["r_max"] * v["x"] / (v["x_h"] + abs(v["x"]))),
    "QuadraticLoss": ("r", lambda v: -v["k"] * v["x"] * abs(v["x"])),
    "HiddenStore": ("r", lambda v: -v["k"] * (v["x"] - v["z"])),
    "DeadZone": (
        "y",
        lambda v: ramp(v["u"] - v["width"] / 2, v["u_s"]) - ramp(-v["u"] - v["width"] / 2, v["u_s"]),
    ),
    "Saturation": (
        "y",
        lambda v: (
            v["u"] - v["share"] * (ramp(v["u"] - v["limit"], v["u_s"]) - ramp(-v["u"] - v["limit"], v["u_s"]))
        ),
    ),
    "OneSidedLimit": (
        "y",
        lambda v: v["u"] - v["share"] * v["side"] * ramp(v["side"] * (v["u"] - v["limit"]), v["u_s"]),
    ),
    "RateLimit": ("y", lambda v: v["u"] - v["share"] * v["z"] * (v["z"] / v["h"]) ** 4),
    "Offset": ("y", lambda v: v["u"] + v["b"]),
    "Gain": ("y", lambda v: (1 + v["g"]) * v["u"]),
    "QuadraticGain": ("y", lambda v: v["u"] * (1 + v["a"] * np.hypot(v["u"], v["u_s"]))),
    "Drift": ("y", lambda v: v["u"] + v["r"] * v["time"]),
    "AbsoluteValueSensor": ("y", lambda v: v["u"] + v["share"] * (np.hypot(v["u"], v["u_s"]) - v["u"])),
    "Play": (
        "y",
        lambda v: (
            v["u"]
            + ramp(v["z"] - v["width"] / 2, v["u_s"])
            - ramp(v["z"] + v["width"] / 2, v["u_s"])
            + v["width"] / 2
        ),
    ),
    "MeasuredInput": ("y", lambda v: v["u"] + v["k"] * v["z"]),
    "Crosstalk": ("y", lambda v: v["u"] + v["k"] * v["z"]),
    "LearnedCurve": ("y", lambda v: v["u"] + curve(v["u"] / v["u_max"], knots(v, "c"))),
}


LETTERS = (("phi_rel", "s_rel"), ("phi", "s"), ("tau", "f"), ("w", "v"))


def knots(values: dict[str, float], array: str) -> list[float]:
    return [values[f"{array}[{i}]"] for i in range(1, 10)]


def mirrored(name: str) -> str:
    """The translational name of a rotational variable: `w_st` -> `v_st`."""
    head, _, tail = name.partition("_")
    for old, new in LETTERS:
        if name == old or (head == old and tail):
            return new + name[len(old) :]
    return name


def closed_forms() -> list[tuple[Effect, str, Law]]:
    found = []
    for effect in effect_library():
        if effect.domain == "rotational" and effect.name in MECHANICAL:
            found.append((effect, "tau", MECHANICAL[effect.name]))
        elif effect.domain == "translational" and effect.name in MECHANICAL:
            form = MECHANICAL[effect.name]
            rotational = {mirrored(name): name for name in ROTATIONAL_NAMES}
            found.append(
                (effect, "f", lambda v, f=form, n=rotational: f({n.get(k, k): x for k, x in v.items()}))
            )
        elif effect.name in OTHERS:
            found.append((effect, *OTHERS[effect.name]))
    return found


ROTATIONAL_NAMES = (
    *("w", "phi", "phi_rel", "w_s", "w_st", "w_max", "tau_c", "tau_d", "tau_0", "tau_h", "phi_s", "phi_max"),
    *("phi_min",),
)


@cache
def attached(class_name: str) -> tuple[FlatModel, Effect]:
    effect = next(e for e in effect_library() if e.class_name == class_name)
    site = next(s for s in rig_sites() if fits(effect, s))
    return attach(rig(), effect, site, name="x"), effect


def random_values(flat: FlatModel, effect: Effect, rng: np.random.Generator) -> dict[str, float]:
    """Values around one for the variables, near the start values for the parameters."""
    names = [x.name.removeprefix("x.") for x in flat.unknowns if x.name.startswith("x.")]
    values = {name: float(rng.normal()) for name in (*names, *(f"der_{n}" for n in names), "time")}
    for parameter in effect.parameters:
        factor = float(rng.uniform(0.5, 1.5)) if parameter.name != "direction" else float(rng.choice([-1, 1]))
        values[parameter.name] = (parameter.start or 1.0) * factor
    return values


LAWS = closed_forms()


@pytest.mark.parametrize(
    ("effect", "result", "form"), LAWS, ids=[f"{label(effect)}-{result}" for effect, result, _ in LAWS]
)
def test_law(effect: Effect, result: str, form: Law) -> None:
    flat, effect = attached(effect.class_name)
    rng = np.random.default_rng(RNG_SEED)
    for _ in range(N_POINTS):
        values = random_values(flat, effect, rng)
        got = law(flat, "x", result, **{k: v for k, v in values.items() if k != result})
        assert got == pytest.approx(form(values), rel=1e-9, abs=1e-12)


def test_all_effects_with_an_explicit_law_are_covered() -> None:
    covered = {effect.class_name for effect, *_ in closed_forms()}
    others = {e.name for e in effect_library() if e.class_name not in covered}
    assert others == {
        *("Backlash", "LoadDependentFriction", "ExtraInertia", "ExtraMass", "ExtraCompliance"),
        *(
            "DriftingParameter",
            "DependentParameter",
            "ExponentialParameter",
            "Lag",
            "Delay",
            "SecondOrderLag",
        ),
    }


@pytest.mark.parametrize("domain", ["Rotational", "Translational"])
def test_backlash(domain: str) -> None:
    """The spring c*x and the effect together are c*play(x), and the damper behind the play loses contact
    with it."""
    flat, _ = attached(f"Daest.Effects.{domain}.Backlash")
    q, f, v = ("phi", "tau", "w") if domain == "Rotational" else ("s", "f", "v")
    parameters = {"gap": 0.4, f"{q}_s": 1e-3, "lift": 1.0}
    # The rig gives c of its spring, and d where it has a damper.
    c, d = (8.0, 0.3) if domain == "Rotational" else (40.0, 0.0)
    for x in np.linspace(-1, 1, 41):
        inner = law(flat, "x", f"{q}_c", x=x, **parameters)
        play = np.sign(x) * max(0.0, abs(x) - 0.2)
        assert inner == pytest.approx(play, abs=1e-3)  # rounded over q_s
        rate = 1.7
        torque = law(flat, "x", f, x=x, **{f"{q}_c": inner, f"{v}_rel": rate}, **parameters)
        contact = 0.0 if abs(x) < 0.2 else 1.0
        if abs(abs(x) - 0.2) > 0.01:
            assert torque == pytest.approx(c * (inner - x) + d * (contact - 1) * rate, abs=2e-3 * c)


@pytest.mark.parametrize("domain", ["Rotational", "Translational"])
def test_load_dependent_friction(domain: str) -> None:
    flat, _ = attached(f"Daest.Effects.{domain}.LoadDependentFriction")
    f, v = ("tau", "w") if domain == "Rotational" else ("f", "v")
    small = {f"{v}_s": 1e-6, f"{f}_s": 1e-6}
    for load, speed in [(2.0, 1.0), (-2.0, 1.0), (2.0, -1.0), (-3.0, -1.0)]:
        friction = law(flat, "x", f, load=load, mu=0.1, **{v: speed}, **small)
        assert friction == pytest.approx(-0.1 * abs(load) * np.sign(speed))
    assert law(flat, "x", "load", **{f"flange_a.{f}": 3.0, f"flange_b.{f}": -1.0}) == pytest.approx(2.0)


@pytest.mark.parametrize("name", FRICTION)
@pytest.mark.parametrize("domain", ["Rotational", "Translational"])
def test_friction_takes_energy(domain: str, name: str) -> None:
    flat, effect = attached(f"Daest.Effects.{domain}.{name}")
    rng = np.random.default_rng(RNG_SEED)
    speed, torque = ("w", "tau") if domain == "Rotational" else ("v", "f")
    lost = []
    for _ in range(N_POINTS):
        values = random_values(flat, effect, rng)
        values[speed] *= 10 ** rng.uniform(-3, 1)
        values.pop(torque)
        lost.append(-law(flat, "x", torque, **values) * values[speed])
    assert min(lost) >= 0 and max(lost) > 0


@pytest.mark.parametrize(("name", "size"), [("LuGreFriction", "tau_c"), ("HystereticSpring", "tau_h")])
def test_hysteresis_takes_energy_over_a_cycle(name: str, size: str) -> None:
    """∫ torque·speed over cycles is what is lost: positive, and for slow cycles of any frequency the same
    (Dahl's loop: torque (1 - e^(-2 r)) … of the size, for strokes of r = amplitude/deflection)."""
    flat, effect = attached(f"Daest.Effects.Rotational.{name}")
    width, speed_name = ("phi_b", "w") if name == "LuGreFriction" else ("phi_h", "w_rel")
    values = {size: 2.0, width: 0.1, "w_s": 1e-4, "b": 0.0, "w_st": 1.0}
    rate = next(e for e in effect.law.split(", ") if "der(z)" in e)
    assert rate.startswith(f"{width}*der(z) = {speed_name}")
    losses = [cycle_loss(values[size], values[width], period) for period in (1.0, 5.0)]
    assert losses[0] == pytest.approx(losses[1], rel=1e-3) and losses[0] > 0
    row = next(e.text for e in flat.equations if "der(x.z)" in e.text)
    expected = f"x.{width}*der(x.z) = x.{speed_name} - x.{speed_name}*tanh(x.{speed_name}/x.w_s)*x.z"
    assert row.startswith(expected)


def cycle_loss(size: float, width: float, period: float, amplitude: float = 0.3, steps: int = 20000) -> float:
    """Energy lost in the second of two cycles of the loop's differential equation, solved exactly per
    step."""
    time = np.linspace(0, 2 * period, 2 * steps + 1)
    angle = amplitude * np.sin(2 * np.pi * time / period)
    z, lost = 0.0, 0.0
    for i, step in enumerate(np.diff(angle)):
        after = np.sign(step) + (z - np.sign(step)) * np.exp(-abs(step) / width)
        if i >= steps:
            lost += size * (z + after) / 2 * step
        z = after
    return lost


@pytest.mark.parametrize("omega", [1.0, 4.0, 8.0])
def test_a_dead_time_shifts_what_goes_through_it(omega):
    text = b"model M input Real u(start = 0); output Real y; equation y = 2*u; end M;"
    flat = compile_text(text, Path("M.mo"))
    effect = find_effect("Signals.Delay")
    behind = attach(flat, effect, find_site(flat, "u", effect), values={"T": 0.8})
    time = np.linspace(0.0, 20.0, 8001)
    found = simulate(behind, (time, np.sin(omega * time)[:, None]))["y"]
    late = time > 4.0
    assert np.allclose(found[late], 2.0 * np.sin(omega * (time[late] - 0.8)), atol=2e-4)
