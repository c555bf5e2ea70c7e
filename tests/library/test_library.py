"""The Modelica library: every class compiles, has units and descriptions, and keeps its signs."""

from __future__ import annotations

import json
import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from frequency_response import finite_modes, response, rest

from daest.model.flat import FlatModel
from daest.modelica.compile import compile_model
from daest.quantities import parse_unit

PROJECT = Path(__file__).resolve().parents[2]
LIBRARY = PROJECT / "modelica" / "Daest"
MODELS = Path(__file__).parent / "models"
EXAMPLES = PROJECT / "examples"
MODEL_FILES = sorted([*MODELS.glob("*.mo"), *EXAMPLES.glob("*/*.mo")])
# Complex frequencies where transfer functions are compared; the order of the models' time constants.
FREQUENCIES = (0.3 + 0.2j, 2.0j, -0.1 + 7.0j)
# Connectors and effects of amounts, whose unit the place tells.
AMOUNTS = ("a_term.", "decay.")


def qualified_name(file: Path) -> str:
    return ".".join(file.relative_to(LIBRARY.parent).with_suffix("").parts)


def declared_kind(file: Path) -> str:
    """The words before the name of the class: `model`, `partial model`, `connector`, `package`..."""
    found = re.search(r"^((?:partial )?(?:model|block|connector|package)) \w+", file.read_text(), re.M)
    assert found, f"no class in {file}"
    return found[1]


# Effects have tests of their own.
CLASS_FILES = [
    file
    for file in sorted(LIBRARY.rglob("*.mo"))
    if declared_kind(file) in ("model", "block") and LIBRARY / "Effects" not in file.parents
]


@cache
def compiled(file: Path) -> FlatModel:
    return compile_model(file)


def flat_of(name: str) -> FlatModel:
    return compiled(MODELS / f"{name}.mo")


# --- completeness ----------------------------------------------------------------------------------


@pytest.mark.parametrize("file", CLASS_FILES, ids=qualified_name)
def test_every_class_is_used_by_a_model(file: Path) -> None:
    pattern = re.compile(re.escape(qualified_name(file)) + r"\b")
    users = [model for model in MODEL_FILES if pattern.search(model.read_text())]
    assert users, f"no model uses {qualified_name(file)}"
    assert compiled(users[0]).n > 0


@pytest.mark.parametrize("file", MODEL_FILES, ids=lambda file: file.stem)
def test_models_are_regular_and_described(file: Path) -> None:
    flat = compiled(file)
    assert np.isfinite(list(response(flat, 0.31 + 0.17j).values())).all()
    for item in (*flat.unknowns, *flat.inputs, *flat.noises, *flat.parameters, *flat.outputs):
        assert item.description, f"{item.name} has no description"
        is_of_any = file.stem == "Signals" or item.name.startswith(AMOUNTS)
        assert item.unit or is_of_any, f"{item.name} has no unit"
        parse_unit(item.unit)  # raises where the unit is not readable


def test_intensities_have_the_unit_of_the_noise_squared_times_time() -> None:
    squared = {"N.m": "N2.m2.s", "N": "N2.s", "V": "V2.s", "A": "A2.s", "W": "W2.s", "m3/s": "m6/s"}
    seen = set()
    for file in sorted((LIBRARY / "Noise").glob("White?*.mo")):
        text = file.read_text()
        (intensity,) = re.findall(r'intensity\(unit = "([^"]*)"', text)
        (noise,) = re.findall(r'Real w\(unit = "([^"]*)"', text)
        assert intensity == squared[noise], file
        seen.add(noise)
    assert seen == set(squared)


def test_package_order_lists_every_class() -> None:
    for order in LIBRARY.rglob("package.order"):
        children = {f.stem for f in order.parent.glob("*.mo")} - {"package"}
        children |= {f.name for f in order.parent.iterdir() if f.is_dir()}
        assert sorted(order.read_text().split()) == sorted(children), order


def test_files_are_plain_text_in_packages() -> None:
    for file in LIBRARY.rglob("*.mo"):
        assert not file.read_bytes().startswith(b"\xef\xbb\xbf")
        assert (file.parent / "package.mo").is_file()


def test_readme_lists_every_class() -> None:
    """Effects apart, which `daest effects` and the reference list: of these it has every package."""
    readme = (PROJECT / "modelica" / "README.md").read_text()
    rows = dict(re.findall(r"^\| `([\w.]+)` \| (.*) \|$", readme, re.M))
    for file in CLASS_FILES:
        package, _, name = qualified_name(file).removeprefix("Daest.").rpartition(".")
        if package.startswith("Effects."):
            assert package.removesuffix(".Interfaces") in rows
            continue
        if package == "Noise":
            name = re.sub(r"^(White|Coloured)(?=\w)", "", name)
        assert re.search(rf"\b{name}\b", rows[package]), (
            f"{qualified_name(file)} is not in modelica/README.md"
        )


# --- the Modelica Standard Library -----------------------------------------------------------------

# Public names (parameters, connectors, variables) of the classes of the Modelica Standard Library 4.
MSL_NAMES = json.loads((Path(__file__).parent / "msl_names.json").read_text())


@pytest.mark.parametrize(
    "file",
    [
        f
        for f in CLASS_FILES
        if not qualified_name(f).startswith(("Daest.Noise", "Daest.Hydraulic", "Daest.Terms"))
    ],
    ids=qualified_name,
)
def test_names_are_those_of_the_standard_library(file: Path) -> None:
    standard = MSL_NAMES[qualified_name(file).replace("Daest.", "Modelica.", 1)]
    public = re.split(r"^(?:protected|equation)\b", file.read_text(), flags=re.M)[0]
    declared = re.findall(r"^  (?:parameter )?[A-Z][\w.]* (\w+)(?=[ (;])", public, re.M)
    assert not set(declared) - set(standard)


@pytest.mark.parametrize("name", ["servo/Servo", "emps/Emps", "zone/Zone", "quarter_car/QuarterCar"])
def test_examples_move_to_the_standard_library_by_their_prefix(name: str) -> None:
    """All classes of an example but noise exist in the Standard Library: replacing the prefix is enough."""
    text = (EXAMPLES / f"{name}.mo").read_text()
    used = set(re.findall(r"\bDaest\.[\w.]+", text))
    moved = {n.replace("Daest.", "Modelica.", 1) for n in used if not n.startswith("Daest.Noise.")}
    known = {*MSL_NAMES, "Modelica.Units.SI", "Modelica.Blocks.Interfaces.RealOutput"}
    assert len(moved) >= 5
    assert moved <= known


# --- signs: transfer functions and steady states in closed form ------------------------------------


@pytest.mark.parametrize("s", FREQUENCIES)
def test_circuit(s: complex) -> None:
    R, C, shunt, L = 3.0, 0.5, 4.0, 0.7
    low_pass, divider = 1 / (1 + s * R * C), 1 / (1 + s * L / shunt)
    coloured = 2 * np.sqrt(2 * 5) / (1 + 5 * s)
    expected = {
        ("u", "v_c"): low_pass,
        ("u", "i_c"): s * C * low_pass,
        ("u", "phi_c"): low_pass,
        ("white_voltage.w", "v_c"): -low_pass,
        ("coloured_voltage.w", "v_c"): -coloured * low_pass,
        ("j", "i_l"): divider,
        ("white_current.w", "i_l"): -divider,
        ("coloured_current.w", "i_l"): -coloured * divider,
        ("j", "v_c"): 0,
        ("u", "i_3"): 0,
    }
    found = response(flat_of("Circuit"), s)
    for pair, value in expected.items():
        assert found[pair] == pytest.approx(value, rel=1e-10, abs=1e-12), pair


def test_circuit_at_rest() -> None:
    state = rest(flat_of("Circuit"), {"u": 2.0, "j": 0.5})
    assert state["v_c"] == pytest.approx(2.0)
    assert state["i_l"] == pytest.approx(0.75)  # signal and constant source add up
    assert state["i_3"] == pytest.approx(2.5)  # from the battery's positive pin
    assert state["battery.p.i"] == pytest.approx(-2.5)  # and so out of it


@pytest.mark.parametrize("s", FREQUENCIES)
def test_components_are_terms_of_equations(s: complex) -> None:
    found = response(flat_of("Terms"), s)
    assert found["F", "y_s"] == pytest.approx(1 / (2 * s**2 + 7), rel=1e-10)
    assert found["F", "y_v"] == pytest.approx(1 / (2 * s + 11), rel=1e-10)
    assert found["M", "y_phi"] == pytest.approx(1 / (3 * s**2 + 13), rel=1e-10)
    assert found["M", "y_w"] == pytest.approx(1 / (3 * s + 17), rel=1e-10)
    assert found["P", "y_T"] == pytest.approx(1 / (4 * s + 19), rel=1e-10)
    assert found["Q", "y_p"] == pytest.approx(1 / (5 * s + 2), rel=1e-10)
    assert found["dose", "y_a"] == pytest.approx(1 / (s + 43), rel=1e-10)
    assert found["I", "y_u"] == pytest.approx(1 / (6 * s + 4), rel=1e-10)
    assert found["U", "y_i"] == pytest.approx(1 / (0.7 * s + 23), rel=1e-10)
    assert found["U", "y_j"] == pytest.approx(1 / 29, rel=1e-10)
    assert found["B", "y_q"] == pytest.approx(1 / (37 * s + 31), rel=1e-10)
    assert found["B", "y_q2"] == pytest.approx(1 / (37 * s + 41), rel=1e-10)


@pytest.mark.parametrize("s", FREQUENCIES)
def test_voice_coil_pushes_coil_and_housing_apart(s: complex) -> None:
    R, k, m, M, d = 2.0, 3.0, 0.5, 4.0, 6.0
    # m s v1 = k i, (M s + d) v2 = -k i, R i = u - k (v1 - v2)
    current = 1 / (R + k**2 / (m * s) + k**2 / (M * s + d))
    found = response(flat_of("VoiceCoil"), s)
    assert found["u", "v_coil"] == pytest.approx(k * current / (m * s), rel=1e-10)
    assert found["u", "v_housing"] == pytest.approx(-k * current / (M * s + d), rel=1e-10)


@pytest.mark.parametrize("s", FREQUENCIES)
def test_rotor(s: complex) -> None:
    J, c, d, ratio = 2.0, 5.0, 0.3, 3.0
    angle = 1 / (J * s**2 + d * s + c)
    shaft = 0.6 * s + 7
    drive = 1 / (1 + s / (2 * np.pi * 0.4))
    coloured = 2 * np.sqrt(2 * 5) / (1 + 5 * s)
    expected = {
        ("tau", "phi"): ratio * angle,
        ("tau", "w"): ratio * s * angle,
        ("tau", "a"): ratio * s**2 * angle,
        ("tau", "phi_rel"): ratio * angle,
        ("tau", "w_rel"): ratio * s * angle,
        ("tau", "tau_shaft"): ratio,
        ("white.w", "phi"): angle,
        ("coloured.w", "phi"): coloured * angle,
        ("w_drive", "phi_driven"): drive / s * shaft / (1.5 * s**2 + shaft),
        ("w_drive", "phi"): 0,
    }
    found = response(flat_of("Rotor"), s)
    for pair, value in expected.items():
        assert found[pair] == pytest.approx(value, rel=1e-10, abs=1e-12), pair


@pytest.mark.parametrize("s", FREQUENCIES)
def test_slider(s: complex) -> None:
    m, c, d = 2.0, 5.0, 0.3
    position = 1 / (m * s**2 + d * s + c)
    rope = 0.6 * s + 7
    coloured = 2 * np.sqrt(2 * 5) / (1 + 5 * s)
    expected = {
        ("f", "s"): position,
        ("f", "v"): s * position,
        ("f", "a"): s**2 * position,
        ("f", "s_rel"): -position,
        ("f", "v_rel"): -s * position,
        ("f", "f_rod"): 1,
        ("white.w", "s"): position,
        ("coloured.w", "s"): coloured * position,
        ("v_drive", "s_driven"): 1 / s * rope / (1.5 * s**2 + rope),
    }
    found = response(flat_of("Slider"), s)
    for pair, value in expected.items():
        assert found[pair] == pytest.approx(value, rel=1e-10, abs=1e-12), pair


@pytest.mark.parametrize("s", FREQUENCIES)
def test_wall(s: complex) -> None:
    C, inner, outer = 50.0, 0.2, 0.4
    per_watt = 1 / (C * s + 1 / inner + 1 / outer)
    coloured = 2 * np.sqrt(2 * 5) / (1 + 5 * s)
    expected = {
        ("P", "T"): per_watt,
        ("T_out", "T"): per_watt / outer,
        ("P", "T_rel"): per_watt,
        ("P", "Q"): -per_watt / inner,
        ("white.w", "T"): per_watt,
        ("coloured.w", "T"): coloured * per_watt,
        ("T_c", "T_mid"): 0.25,
    }
    found = response(flat_of("Wall"), s)
    for pair, value in expected.items():
        assert found[pair] == pytest.approx(value, rel=1e-10, abs=1e-12), pair


def test_wall_at_rest() -> None:
    state = rest(flat_of("Wall"), {"T_out": 275.0, "P": 20.0, "T_c": 20.0})
    wall = (295 / 0.2 + 275 / 0.4 + 10 + 20) / (1 / 0.2 + 1 / 0.4)
    assert state["T"] == pytest.approx(wall)
    assert state["T_rel"] == pytest.approx(wall - 295)
    assert state["Q"] == pytest.approx((295 - wall) / 0.2)
    assert state["T_mid"] == pytest.approx(0.75 * 4 + 0.25 * 20)
    assert state["middle.port.T"] == pytest.approx(state["T_mid"] + 273.15)


@pytest.mark.parametrize("s", FREQUENCIES)
def test_reservoir(s: complex) -> None:
    A, rho_g, R = 0.02, 1e4, 1e6
    level = 1 / (A * s + rho_g / R)
    coloured = 2 * np.sqrt(2 * 5) / (1 + 5 * s)
    expected = {
        ("q", "level"): level,
        ("q", "p"): rho_g * level,
        ("q", "q_out"): rho_g / R * level,
        ("white.w", "level"): level,
        ("coloured.w", "level"): coloured * level,
    }
    found = response(flat_of("Reservoir"), s)
    for pair, value in expected.items():
        assert found[pair] == pytest.approx(value, rel=1e-10), pair


def test_reservoir_at_rest() -> None:
    state = rest(flat_of("Reservoir"), {"q": 0.002})
    assert state["q_out"] == pytest.approx(0.002)
    assert state["p"] == pytest.approx(500 + 1e6 * 0.002)
    assert state["level"] == pytest.approx(0.25)


@pytest.mark.parametrize("s", FREQUENCIES)
def test_signals(s: complex) -> None:
    closed = 4 / (s + 4)
    found = response(flat_of("Signals"), s)
    assert found["u", "y"] == pytest.approx(closed, rel=1e-10)
    assert found["white.w", "y"] == pytest.approx(closed, rel=1e-10)
    assert found["coloured.w", "y"] == pytest.approx(2 * np.sqrt(10) / (1 + 5 * s) * closed, rel=1e-10)


def test_source_signals() -> None:
    state = rest(flat_of("Signals"), {})  # at time = 0
    assert state["total"] == pytest.approx(3 + 7 + 2 * np.sin(0.5))


def test_springs_at_rest() -> None:
    rotor = rest(flat_of("Rotor"), {"tau": 0.4})
    assert rotor["phi"] == pytest.approx(0.5 + 0.2 + (3 * 0.4 - 1.5) / 5)
    assert rotor["phi_rel"] == pytest.approx(rotor["phi"] - 0.5)
    assert rotor["spring.tau"] == pytest.approx(3 * 0.4 - 1.5)
    slider = rest(flat_of("Slider"), {"f": 0.4})
    centre = 1 - 0.1 - 0.25 + (0.4 - 1.5) / 5
    assert slider["s"] == pytest.approx(centre - 0.1 - 0.3)
    assert slider["s_rel"] == pytest.approx(0.25 - (0.4 - 1.5) / 5)
    assert slider["s_driven"] == pytest.approx(slider["drive.s"] + 0.1)
    assert slider["spring.f"] == pytest.approx(-(0.4 - 1.5))  # compressed by the load: negative


# --- the servos ------------------------------------------------------------------------------------


def servo_speed(s: complex, d: float, c: float, J1: float, J2: float, R: float, k: float) -> complex:
    """Voltage to speed after the gear of ratio 30: report (10) for a motor in normal polarity."""
    numerator = 30 * k * (J2 * s**2 + d * s + c)
    return numerator / (
        900 * R * J1 * J2 * s**3
        + (900 * J2 * k**2 + 900 * R * J1 * d + J2 * R * d) * s**2
        + (900 * d * k**2 + 900 * R * J1 * c + J2 * R * c) * s
        + 900 * c * k**2
    )


def servo_angle(s: complex, d: float, c: float, J1: float, J2: float, R: float, k: float) -> complex:
    """Voltage to the angle of the disc: one more pole at 0."""
    return servo_speed(s, d, c, J1, J2, R, k) * (d * s + c) / (J2 * s**2 + d * s + c) / s


SERVOS = {
    "report": (EXAMPLES / "report_servo" / "Servo.mo", 54, 2),
    "example": (EXAMPLES / "servo" / "Servo.mo", 65, 3),
    "index 3": (MODELS / "ServoIndex3.mo", 75, 3),
}


@pytest.mark.parametrize("name", SERVOS)
def test_servo_has_the_transfer_functions_of_the_report(name: str) -> None:
    file, n_equations, _ = SERVOS[name]
    flat = compiled(file)
    assert flat.n == n_equations
    values = {p.name: p.value for p in flat.parameters}
    theta = {key: values[key] for key in ("d", "c", "J1", "J2", "R", "k")}
    if name == "report":  # reversed poles: u drives the motor with the opposite sign, and k is negative
        assert theta["k"] == -0.060
    sign = -1 if name == "report" else 1
    for s in FREQUENCIES:
        found = response(flat, s)
        assert found["u", "omega"] == pytest.approx(sign * servo_speed(s, **theta), rel=1e-8)
        assert found["u", "phi"] == pytest.approx(sign * servo_angle(s, **theta), rel=1e-8)


@pytest.mark.parametrize("name", SERVOS)
def test_servo_has_four_dynamic_modes(name: str) -> None:
    flat = compiled(SERVOS[name][0])
    theta = {p.name: p.value for p in flat.parameters}
    d, c, J1, J2, R, k = (theta[key] for key in ("d", "c", "J1", "J2", "R", "k"))
    cubic = [
        900 * R * J1 * J2,
        900 * J2 * k**2 + 900 * R * J1 * d + J2 * R * d,
        900 * d * k**2 + 900 * R * J1 * c + J2 * R * c,
        900 * c * k**2,
    ]
    expected = np.sort_complex([0, *np.roots(cubic)])
    found = finite_modes(flat)
    assert found.shape == (4,)
    np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-7)


@pytest.mark.parametrize("s", FREQUENCIES)
def test_moved_ends_carry_what_hangs_on_them(s: complex) -> None:
    found = response(flat_of("Shaken"), s)
    w = 2.0 * np.pi * 0.4
    bessel = 1.0 / (1.0 + 1.3617 * s / w + 0.618 * (s / w) ** 2)
    assert found["z", "s"] == pytest.approx((7 + 0.6 * s) / (1.5 * s**2 + 0.6 * s + 7), rel=1e-9)
    assert found["angle", "phi"] == pytest.approx(
        bessel * (3 + 0.2 * s) / (0.8 * s**2 + 0.2 * s + 3), rel=1e-9
    )
    assert found["z", "phi"] == found["angle", "s"] == 0.0
