"""The symbolic model that travels inside an FMU."""

import json

import casadi as ca
import fmu_models as models
import numpy as np
import pytest
from fmu_archives import changed, member

from daest.errors import FmuError
from daest.fmu import serialization
from daest.fmu.load import symbolic_model
from daest.systems.linear.linearize import linear_dae_function

WORDS = f"{serialization.FOLDER}/{serialization.WORDS}"
EXPRESSIONS = f"{serialization.FOLDER}/{serialization.EXPRESSIONS}"
TABLES = (
    "unknowns",
    "inputs",
    "noises",
    "parameters",
    "outputs",
    "equations",
    "derived_parameters",
    "name",
    "source",
)


@pytest.mark.parametrize(
    ("fixture", "build"), [("drive_fmu", models.geared_drive), ("tank_fmu", models.tank)]
)
def test_comes_back_equal_to_the_bit(request, fixture, build):
    flat, back = build(), symbolic_model(request.getfixturevalue(fixture))
    for name in TABLES:
        assert getattr(back, name) == getattr(flat, name)
    theta = flat.theta_values * 1.37
    for one, other in zip(linear_dae_function(flat)(theta), linear_dae_function(back)(theta), strict=True):
        assert one.sparsity() == other.sparsity()
        assert np.array_equal(one.toarray(), other.toarray())


def test_residual_and_derived_values_are_the_same_functions(drive_fmu):
    rng = np.random.default_rng(3)
    flat, back = models.geared_drive(), symbolic_model(drive_fmu)
    point = [rng.normal(size=size) for size in (9, 9, 1, 1, 5, 1)]
    values = []
    for m in (flat, back):
        symbols = [m.derivatives, m.xi, m.u, m.w, m.theta, m.time]
        values.append(ca.Function("f", symbols, [m.residual, m.output_expressions, m.derived_values])(*point))
    for one, other in zip(*values, strict=True):
        assert np.array_equal(one.toarray(), other.toarray())


def test_fmu_without_the_folder_has_none(drive_fmu, tmp_path):
    assert symbolic_model(changed(drive_fmu, tmp_path / "x.fmu", drop=[serialization.FOLDER])) is None


def damaged(drive_fmu, what):
    words, text = json.loads(member(drive_fmu, WORDS)), member(drive_fmu, EXPRESSIONS)
    if what == "one letter":
        text = text[:-1] + ("a" if text[-1] != "a" else "b")
    elif what == "other alphabet":
        text = text[:100] + "\x00\xff" + text[100:]
    elif what == "cut off":
        text = text[: len(text) // 2]
    elif what == "other function":
        x = ca.SX.sym("x")
        text = ca.Function("flat", [x], [x]).serialize()
        words["sha256"] = serialization.hashlib.sha256(text.encode()).hexdigest()
    elif what == "fewer names":
        words["unknowns"].pop()
    elif what == "no json":
        return {WORDS: b"{", EXPRESSIONS: text.encode()}
    elif what == "foreign schema":
        words["schema"] = "else/1"
    return {WORDS: json.dumps(words).encode(), EXPRESSIONS: text.encode()}


@pytest.mark.parametrize(
    "what",
    ["one letter", "other alphabet", "cut off", "other function", "fewer names", "no json", "foreign schema"],
)
def test_damage_is_told_and_never_used(drive_fmu, tmp_path, what):
    path = changed(drive_fmu, tmp_path / "x.fmu", replace=damaged(drive_fmu, what))
    with pytest.raises(FmuError) as caught:
        symbolic_model(path)
    assert caught.value.code == "symbolic-model-damaged"
