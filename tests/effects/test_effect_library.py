"""The effect library: every class is complete, physical and readable."""

from __future__ import annotations

import textwrap
from pathlib import Path

import pytest
from effect_rig import label

from daest.errors import ModelError
from daest.modelica.effects import catalogue as effects
from daest.modelica.effects.catalogue import (
    adds_a_constant,
    adds_a_ramp,
    effect_library,
    effect_model,
    find_effect,
    find_effects,
)
from daest.modelica.language.library import library_root, library_roots
from daest.quantities import parse_unit

EFFECTS = effect_library()
FOLDER = library_root() / "Daest" / "Effects"
# Names that a signal or an amount of any unit may feed: they cannot have a unit themselves.
UNITLESS = {"Signals", "General", "Amounts"}
# Sizes of either sign: a load, an offset, the influence of a signal.
SIGNED = {"a", "Q_0", "q_0", "r_0", "tau_0", "f_0", "dp_0", "k", "b", "g", "r", "y", "c", "c3"}

MECHANICAL = frozenset(
    (
        *("CoulombFriction", "ViscousFriction", "StribeckFriction", "AsymmetricFriction", "LuGreFriction"),
        *("LoadDependentFriction", "QuadraticDrag", "ConstantLoad", "AsymmetricDamper"),
        *("HardeningSpring", "HystereticSpring", "BoucWenSpring", "Backlash", "ExtraCompliance", "EndStop"),
        *("FlexibleAppendage", "CubicSpring", "ReturnSpring", "RelaxingSpring"),
    )
)
EXPECTED = {
    "Rotational": MECHANICAL | {"Unbalance", "CoggingTorque", "ExtraInertia", "DraggedInertia"},
    "Translational": MECHANICAL | {"Gravity", "CoggingForce", "ExtraMass", "DraggedMass"},
    "Electrical": frozenset(
        [
            "Inductance",
            "SaturatingInductance",
            "BrushVoltageDrop",
            "TemperatureDependentResistance",
            "Leakage",
            "GroundLeakage",
            "GrowingCapacity",
        ]
    ),
    "Thermal": frozenset(["Radiation", "MeasuredHeatGain", "MeasuredVentilation", "WallCapacity"]),
    "Hydraulic": frozenset(
        [
            "Orifice",
            "Overflow",
            "Weir",
            "Downpipe",
            "FreeOutlet",
            "WideningTank",
            "HiddenVessel",
            "FluidInertia",
            "ConstantFlow",
            "ConstantHead",
            "LaminarGasLine",
        ]
    ),
    "Amounts": frozenset(
        ["ConstantInflow", "FirstOrderLoss", "SaturableLoss", "QuadraticLoss", "HiddenStore"]
    ),
    "Signals": frozenset(
        [
            *("DeadZone", "Saturation", "OneSidedLimit", "Offset", "Gain", "QuadraticGain", "Lag", "Delay"),
            *("AbsoluteValueSensor", "Drift", "Play", "Crosstalk", "RateLimit", "SecondOrderLag"),
        ]
    ),
    "General": frozenset(
        ["MeasuredInput", "DriftingParameter", "DependentParameter", "ExponentialParameter", "LearnedCurve"]
    ),
}
# Written for an effect that no class describes; no hypothesis themselves.
LEARNED_LOADS = {
    *("LearnedTorque", "LearnedForce", "LearnedCurrent", "LearnedHeatFlow", "LearnedFlow", "LearnedInflow")
}
MIRRORED = {
    "Unbalance": "Gravity",
    "CoggingTorque": "CoggingForce",
    "ExtraInertia": "ExtraMass",
    "DraggedInertia": "DraggedMass",
    "MeasuredTorque": "MeasuredForce",
}


def package(effect) -> str:
    return effect.class_name.split(".")[-2]


def test_library_holds_what_the_design_lists() -> None:
    held: dict[str, set[str]] = {}
    for effect in EFFECTS:
        held.setdefault(package(effect), set()).add(effect.name)
    for name, wanted in EXPECTED.items():
        assert wanted <= held[name]
    assert {MIRRORED.get(name, name) for name in held["Rotational"]} == held["Translational"]
    files = {f.stem for f in FOLDER.rglob("*.mo")} - {"package"}
    partial = {f.stem for f in FOLDER.rglob("Interfaces/*.mo")}
    assert {e.name for e in EFFECTS} == files - partial - LEARNED_LOADS


@pytest.mark.parametrize("effect", EFFECTS, ids=label)
def test_effect_is_described_with_units(effect) -> None:
    assert effect.description and effect.documentation and " = " in effect.law
    assert effect.documentation.endswith(".")
    for item in (*effect.parameters, *effect_model(effect).unknowns):
        assert item.description, item.name
        parse_unit(item.unit)  # raises where the unit is not readable
        measured = effect.name.startswith("Measured") and item.name in ("u", "k")
        assert item.unit or measured or package(effect) in UNITLESS, f"{item.name} has no unit"


@pytest.mark.parametrize("effect", EFFECTS, ids=label)
def test_sizes_have_a_null_and_physical_bounds(effect) -> None:
    assert effect.sizes
    for parameter in effect.parameters:
        name = parameter.name.partition("[")[0]
        low, high = parameter.min, parameter.max
        assert (low is None or low <= parameter.start) and (high is None or parameter.start <= high)
        if parameter.role == "size":
            assert parameter.null == 0 and parameter.estimate
            assert low == 0 or (low is None and name in SIGNED) or (effect.name == "Gain" and low == -1)
        if parameter.role == "sharpness":
            assert not parameter.estimate and parameter.scale_of and low is not None and low > 0
        if parameter.role == "given":
            assert parameter.given_from
        if parameter.scale_of:
            variable = parameter.scale_of.removesuffix("/time")
            assert variable in {"time", "sample", *(x.name for x in effect_model(effect).unknowns)}
        if not parameter.scale_of:
            assert all((low is None or low <= v) and (high is None or v <= high) for v in parameter.grid)


@pytest.mark.parametrize("domain", ["Rotational", "Translational"])
def test_springs_between_parts_harden_or_soften_as_those_to_the_housing(domain) -> None:
    for name in ("HardeningSpring", "CubicSpring"):
        (size,) = [p for p in find_effect(f"Daest.Effects.{domain}.{name}").parameters if p.name == "c3"]
        assert size.min is None or size.min < 0, f"{domain}.{name}"


@pytest.mark.parametrize("effect", EFFECTS, ids=label)
def test_models_are_open_by_their_connectors_alone(effect) -> None:
    model = effect_model(effect)
    open_ends = len(effect.inputs) + (1 if effect.domain == "signal" else len(effect.connectors))
    assert len(model.unknowns) - len(model.equations) == open_ends
    assert model.function.size1_out(0) == len(model.equations)


def test_states_and_dynamics() -> None:
    found = {effect.class_name.removeprefix("Daest.Effects."): effect for effect in EFFECTS}
    states = {name: effect.n_states for name, effect in found.items() if effect.n_states}
    one = ["LuGreFriction", "HystereticSpring", "BoucWenSpring", "RelaxingSpring"]
    expected = {f"{domain}.{name}": 1 for domain in ("Rotational", "Translational") for name in one}
    expected |= dict.fromkeys(("Electrical.Inductance", "Electrical.SaturatingInductance", "Signals.Lag"), 1)
    expected |= {"Hydraulic.FluidInertia": 1}
    expected |= {"Electrical.TemperatureDependentResistance": 1, "Signals.Delay": 10}
    expected |= {"Rotational.FlexibleAppendage": 2, "Translational.FlexibleAppendage": 2}
    expected |= {"Rotational.DraggedInertia": 1, "Translational.DraggedMass": 1}
    expected |= {
        "Electrical.VoltageRelaxation": 1,
        "Thermal.ExtraHeatCapacity": 1,
        "Hydraulic.HiddenVessel": 1,
    }
    expected |= {
        "Thermal.WallCapacity": 1,
        "Signals.Play": 1,
        "Signals.RateLimit": 1,
        "Signals.SecondOrderLag": 2,
    }
    assert {effect.name for effect in EFFECTS if effect.is_rival} == {"SecondOrderLag"}
    expected |= {"Amounts.HiddenStore": 1, "Hydraulic.HiddenVessel": 1}
    assert states == expected
    dynamic = {effect.name for effect in EFFECTS if effect.is_dynamic}
    assert dynamic == {
        *("ExtraInertia", "ExtraMass", "ExtraCompliance", "Inductance", "SaturatingInductance"),
        *("Lag", "Delay", "SecondOrderLag", "GrowingCapacity", "WideningTank", "FluidInertia"),
    }
    assert {effect.name for effect in EFFECTS if effect.is_of_store} == {"GrowingCapacity", "WideningTank"}


# --- classes of one's own ---------------------------------------------------------------------------

WIND = """\
model WindLoad "Wind against an arm"
  extends Daest.Effects.Rotational.Interfaces.PartialFriction;
  parameter Real k(unit = "N.m.s2/rad2", min = 0) = 0.01 "Torque per squared speed"
    annotation(__Daest(estimate = true, role = "size", null = 0));
equation
  tau = -k*w*abs(w);
  annotation(__Daest(effect = true, attach = "connector", law = "tau = -k*w*|w|"));
end WindLoad;
"""


def test_loads_and_offsets_add_a_constant() -> None:
    """Not what depends on where or how fast the machine is, on the time, or on the law's own signal."""
    found = {package(effect) + "." + effect.name for effect in effect_library() if adds_a_constant(effect)}
    assert found == {
        "Rotational.ConstantLoad",
        "Translational.ConstantLoad",
        "Thermal.ConstantHeatGain",
        "Hydraulic.ConstantFlow",
        "Hydraulic.ConstantHead",
        "Amounts.ConstantInflow",
        "Signals.Offset",
    }


def test_a_drift_adds_a_ramp() -> None:
    """Not a parameter that drifts, which acts by what it multiplies."""
    assert [effect.name for effect in effect_library() if adds_a_ramp(effect)] == ["Drift"]


def written(folder: Path, text: str) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "WindLoad.mo").write_text(textwrap.dedent(text))
    return folder


def test_class_of_ones_own(tmp_path) -> None:
    folder = written(tmp_path / "mine", WIND)
    effect = find_effect("WindLoad", [folder])
    assert effect.class_name == "WindLoad" and effect.domain == "rotational" and effect.has_support
    assert len(effect_library([folder])) == len(EFFECTS) + 1
    assert len(effect_library()) == len(EFFECTS)


def test_class_that_speaks_of_a_support_and_has_none(tmp_path) -> None:
    text = WIND.replace("PartialFriction", "PartialFlange").replace("k*w*abs(w)", "k*sin(phi)")
    text = text.replace("N.m.s2/rad2", "N.m")
    effect = find_effect("WindLoad", [written(tmp_path / "mine", "// without useSupport\n" + text)])
    assert not effect.has_support


def test_the_bundled_classes_are_compiled_once(monkeypatch) -> None:
    compiled = []
    flat = effects._flat
    monkeypatch.setattr(effects, "_flat", lambda *job: compiled.append(job) or flat(*job))
    roots = library_roots(())
    sources = [source for file in sorted(FOLDER.rglob("*.mo")) for source in effects._marked(file)]
    assert len(effects._supported(effects._all_together(sources, roots), sources)) == len(EFFECTS)
    assert len(compiled) == 1


def test_a_changed_class_is_read_again(tmp_path) -> None:
    folder = written(tmp_path / "mine", WIND)
    assert find_effect("WindLoad", [folder]).sizes[0].start == 0.01
    written(folder, WIND.replace("= 0.01", "= 0.02"))
    assert find_effect("WindLoad", [folder]).sizes[0].start == 0.02


@pytest.mark.parametrize(
    ("change", "code", "says"),
    [
        (('"connector"', '"conector"'), "effect-annotation", "attach"),
        (('law = "tau = -k*w*|w|"', "dynamic = false"), "effect-annotation", "law"),
        (('role = "size", ', ""), "effect-annotation", "no parameter makes the effect vanish"),
        (('role = "size"', 'role = "sise"'), "model-annotation", "WindLoad.mo"),
        (('"connector"', '"series"'), "effect-annotation", "2 connectors"),
        (("effect = true, ", "effect = true, kind = 2, "), "effect-annotation", "kind"),
        (("effect = true, ", "effect = true, turns = -2, "), "effect-annotation", "turns"),
        (("effect = true, ", "effect = true, turns = true, "), "effect-annotation", "turns"),
        (("tau = -k*w*abs(w)", "tau = -k*v*abs(w)"), "model-unknown-name", "WindLoad"),
    ],
)
def test_wrong_class_of_ones_own(tmp_path, change, code, says) -> None:
    assert change[0] in WIND
    folder = written(tmp_path / "mine", WIND.replace(*change))
    with pytest.raises(ModelError) as caught:
        effect_library([folder])
    problem = caught.value
    assert problem.code == code
    assert says in str(problem) and "WindLoad" in str(problem)


def test_unknown_and_ambiguous_names() -> None:
    with pytest.raises(ModelError, match="CoulombFriction") as caught:
        find_effects("CoulombFrition")
    assert caught.value.code == "effect-unknown" and "Did you mean CoulombFriction" in str(caught.value)
    with pytest.raises(ModelError) as caught:
        find_effect("CoulombFriction")
    assert caught.value.code == "effect-ambiguous"
    assert find_effect("Rotational.CoulombFriction").domain == "rotational"
    assert {e.domain for e in find_effects("CoulombFriction")} == {"rotational", "translational"}
