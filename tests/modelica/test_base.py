"""Base Modelica in the form that OpenModelica 1.28 writes: names in quotes, records and functions before the
model."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy.linalg

from daest.errors import ModelError
from daest.modelica.compile import compile_model
from daest.modelica.forms.dialect import without_quotes
from daest.systems.linear.linearize import linearize

OSCILLATOR = (Path(__file__).parent / "models" / "Oscillator.bmo").read_text()


@pytest.fixture
def base(tmp_path):
    def write(text: str):
        path = tmp_path / "Drive.bmo"
        path.write_text(text)
        return path

    return write


def test_names_without_quotes_in_a_text_of_the_same_length():
    text, names = without_quotes(OSCILLATOR.encode())
    assert len(text) == len(OSCILLATOR) and text.count(b"\n") == OSCILLATOR.count("\n")
    assert b"it's driven" in text and text.count(b"'") == 1
    assert set(names.shown.values()) == {
        "Drive", "Drive.law", "x", "y", "Limits", "low", "m", "mass.m", "bus.u", "bus.s", "mass.s", "mass.v",
        "mass.flange[1].f",
    }  # fmt: skip
    assert names.restored(text.decode()) == OSCILLATOR.replace("'", "").replace("its d", "it's d")


def test_ordinary_modelica_is_left_alone():
    source = b"model M Real 'a.b'; end M;"
    text, names = without_quotes(source)
    assert text == source and names.restored("_00") == "_00" and names.model("P.M") == "P.M"


def test_variables_of_a_function_are_protected(base):
    law = """    output Real 'y';
    Real 'a[1]'(min = 0.0, max = 9.0) = 2.0;
    Real 'b';
    input Real 'z' = 0.0;
  algorithm
    'b' := 'a[1]' * 'x';
    'y' := 'b' + 'z';
"""
    text = OSCILLATOR.replace("    output Real 'y';\n  algorithm\n    'y' := 2.0 * 'x';\n", law)
    plain, _ = without_quotes(text.encode())
    assert (plain.count(b"protected "), plain.count(b"public ")) == (1, 1)
    dae = linearize(compile_model(base(text)))
    poles = scipy.linalg.eigvals(dae.J, dae.E)
    assert np.allclose(sorted(poles[np.isfinite(poles)], key=lambda pole: pole.imag), [-2j, 2j])


def test_a_name_that_is_in_use_is_not_given_again():
    text, names = without_quotes(b"//! base 0.1.0\nmodel 'M' Real '_00', _00, 'x'; end 'M';")
    assert text.split().count(b"_00,") == 1 and "_00" not in names.shown and len(names.shown) == 3


def test_a_model_has_the_names_units_and_places_of_its_text(base):
    flat = compile_model(base(OSCILLATOR))
    assert flat.name == "Drive" and flat.description == "A mass on a spring: it's driven"
    assert [v.name for v in flat.inputs] == ["bus.u"] and [v.name for v in flat.outputs] == ["bus.s"]
    assert [(p.name, p.unit) for p in flat.parameters] == [("m", "kg")]
    assert [v.name for v in flat.unknowns] == ["mass.s", "mass.v", "mass.flange[1].f"]
    dae = linearize(flat)
    poles = scipy.linalg.eigvals(dae.J, dae.E)
    assert np.allclose(sorted(poles[np.isfinite(poles)], key=lambda pole: pole.imag), [-2j, 2j])
    assert [(e.text, e.place.line) for e in flat.equations] == [
        ("mass.v = der(mass.s)", 24),
        ("mass.m*der(mass.v) = bus.u - mass.flange[1].f", 25),
        ("mass.flange[1].f = Drive.law(mass.s)", 26),
    ]


def test_the_class_may_be_named_without_quotes(base):
    assert compile_model(base(OSCILLATOR), "Drive").name == "Drive"
    with pytest.raises(ModelError) as caught:
        compile_model(base(OSCILLATOR), "Servo")
    assert caught.value.code == "model-unknown-class" and "The file has: Drive." in caught.value.remedy


def test_other_classes_of_the_package_are_not_asked_for(base):
    table = "class 'Table'\n    extends ExternalObject;\n  end 'Table';\n\n  record"
    assert compile_model(base(OSCILLATOR.replace("record", table, 1))).name == "Drive"


def test_errors_tell_the_names_of_the_text(base):
    wrong = OSCILLATOR.replace("'bus.s' = 'mass.s';", "'bus.s' = 'spring.s';")
    with pytest.raises(ModelError) as caught:
        compile_model(base(wrong))
    assert caught.value.code == "model-unknown-name" and "`spring.s`" in caught.value.what
