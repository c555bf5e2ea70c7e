"""Values, outputs, noises and places of a compiled model."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from daest.errors import ModelError
from daest.model.flat import FlatModel
from daest.modelica.change import declare, with_values
from daest.modelica.compile import compile_model
from daest.modelica.places.place_names import resolve_place

MODELS = Path(__file__).parent / "models"


@pytest.fixture(scope="module")
def servo() -> FlatModel:
    return compile_model(MODELS / "Servo54.mo")


def test_new_values(servo: FlatModel) -> None:
    changed = with_values(servo, {"disc.J": 2e-4, "J1": 5e-6})
    values = {p.name: p.value for p in changed.parameters}
    assert (values["disc.J"], values["J1"], values["spring.c"]) == (2e-4, 5e-6, 0.0362)
    assert {p.name: p.value for p in servo.parameters}["disc.J"] == 3.66e-4
    assert compile_model(MODELS / "Servo54.mo", overrides={"J1": 5e-6}).parameters[0].value == 5e-6


@pytest.mark.parametrize(
    ("values", "code", "words"),
    [
        ({"motor.J": 1.0}, "parameter-derived", "computed from `J1`"),
        ({"motr.J": 1.0}, "parameter-unknown", "`motor.J`"),
        ({"R": 1.0}, "parameter-unknown", "`resistor.R`"),
        ({"disc.J": -1.0}, "parameter-outside-bounds", "below its min = 0"),
        ({"disc.J": float("nan")}, "parameter-outside-bounds", "finite"),
    ],
)
def test_values_that_cannot_be_set(servo: FlatModel, values: dict[str, float], code: str, words: str) -> None:
    with pytest.raises(ModelError) as caught:
        with_values(servo, values)
    assert caught.value.code == code
    assert words in str(caught.value)


def test_intensity_and_std_follow_the_parameters_that_hold_them(tmp_path: Path) -> None:
    path = tmp_path / "M.mo"
    path.write_text(
        """model M parameter Real q = 1e-3, s = 0.1; Real x(start = 1);
        input Real w annotation(__Daest(noise = true, intensity = q));
        output Real y = x annotation(__Daest(std = s)); equation der(x) = -x + w; end M;"""
    )
    flat = with_values(compile_model(path), {"q": 0.5, "s": 0.25})
    assert (flat.noises[0].intensity, flat.outputs[0].noise_std) == (0.5, 0.25)


@pytest.mark.parametrize(
    ("place", "text"),
    [
        ("3", "resistor.R*resistor.i = resistor.v"),
        ("motor.flange_a.tau", "emf.flange.tau + motor.flange_a.tau = 0"),
        ("motor.flange_a", "emf.flange.tau + motor.flange_a.tau = 0"),
        ("disc.flange_b", "disc.flange_b.tau = 0"),
        ("emf.w", "emf.w = der(emf.flange.phi)"),
        ("spring.tau", "spring.tau = spring.c*spring.phi_rel"),
    ],
)
def test_places(servo: FlatModel, place: str, text: str) -> None:
    assert [servo.equations[i].text for i in resolve_place(servo, place)] == [text]


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("motor.w", ["17: motor.w = der(motor.phi)", "18: motor.a = der(motor.w)"]),
        ("u", ["7: source.v = u"]),
        ("disc.x", ["`disc.w`"]),
        ("54", ["0 to 53"]),
    ],
)
def test_places_that_mean_no_single_equation(servo: FlatModel, place: str, words: list[str]) -> None:
    with pytest.raises(ModelError) as caught:
        resolve_place(servo, place)
    assert caught.value.code == "model-place"
    assert all(word in caught.value.remedy for word in words)


def test_declared_noise_enters_its_equation(servo: FlatModel) -> None:
    flat = declare(
        servo,
        noises={"motor.flange_a.tau": 1e-3, "disc.flange_b": None},
        estimate_noise={"disc.flange_b": True},
    )
    assert [(w.intensity, w.unit, w.estimate) for w in flat.noises] == [
        (1e-3, "N.m", False),
        (None, "N.m", True),
    ]
    slope = ca.Function("f", [flat.xi, flat.theta], [ca.jacobian(flat.residual, flat.w)])(0, 0).full()
    expected = np.zeros((54, 2))
    expected[resolve_place(servo, "motor.flange_a"), 0] = -1
    expected[resolve_place(servo, "disc.flange_b"), 1] = -1
    np.testing.assert_array_equal(slope, expected)
    again = declare(flat, noises={"motor.flange_a.tau": 2e-3})
    assert len(again.noises) == 2 and again.noises[0].intensity == 2e-3


def test_declared_outputs_and_estimates(servo: FlatModel) -> None:
    flat = declare(
        servo,
        outputs={"phi": "phi", "speed": "motor.w"},
        estimate=["spring.c"],
        noise_std={"speed": 0.5},
        estimate_noise={"phi": False},
    )
    assert [(y.name, y.unit, y.noise_std, y.estimate_noise) for y in flat.outputs] == [
        ("phi", "rad", None, False),
        ("speed", "rad/s", 0.5, True),
    ]
    assert str(flat.output_expressions) == "[disc.phi, motor.w]"
    assert {p.name for p in flat.parameters if p.estimate} == {"J1", "spring.c"}
    assert {p.name for p in declare(servo, estimate={"J1": False}).parameters if p.estimate} == set()


@pytest.mark.parametrize(
    ("what", "code"),
    [
        ({"outputs": ["disc.angle"]}, "output-unknown"),
        ({"noise_std": {"disc.phi": 1.0}}, "output-unknown"),
        ({"noise_std": {"phi": 0.0}}, "noise-std"),
        ({"estimate": ["motor.J"]}, "parameter-derived"),
        ({"estimate_noise": {"psi": True}}, "noise-unknown"),
        ({"noises": {"disc.phi": 1.0}}, "model-place"),
    ],
)
def test_declarations_that_do_not_fit(servo: FlatModel, what: dict[str, object], code: str) -> None:
    with pytest.raises(ModelError) as caught:
        declare(servo, **what)  # type: ignore[arg-type]
    assert caught.value.code == code
