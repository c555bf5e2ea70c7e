"""`__Daest(...)` behind declarations."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from daest.errors import ModelError, Place
from daest.model.flat import FlatModel

Compile = Callable[..., FlatModel]


def test_annotations_amid_strings_comments_and_lists(compiled: Compile) -> None:
    flat = compiled(
        """model M
        parameter Real a = 1, b(min = 0, unit = "m", start = 3) = 2 "it, \\"annotation(__Daest(x))\\"; " /*
        , ; */
          annotation(Dialog(group = "x, y)", tab = {1, 2}),
                     // __Daest(estimate = false)
                     __Daest(estimate = true, scale = "log", max = 10*a)), c = 3;
        parameter Real d[2](each min = 0) = {4, 5} annotation(__Daest(estimate = true, min = {1, 2}));
        Real x(start = 1);
        output Real y annotation(__Daest(std = 0.1*a, estimate = false));
        equation der(x) = -a*b*c*d[1]*d[2]*x; y = x; end M;"""
    )
    marks = {p.name: (p.estimate, p.scale, p.min, p.max) for p in flat.parameters}
    assert marks == {
        "a": (False, "auto", None, None),
        "b": (True, "log", 0, 10),
        "c": (False, "auto", None, None),
        "d[1]": (True, "auto", 1, None),
        "d[2]": (True, "auto", 2, None),
    }
    output = flat.outputs[0]
    assert (output.noise_std, output.estimate_noise) == (0.1, False)


def test_annotation_of_a_component_class_holds_for_every_instance(compiled: Compile) -> None:
    flat = compiled(
        """model M model A parameter Real k = 1 annotation(__Daest(estimate = true)); Real x;
        equation der(x) = -k*x; end A; A a, b(k = 2); end M;"""
    )
    assert [(p.name, p.value, p.estimate) for p in flat.parameters] == [("a.k", 1, True), ("b.k", 2, True)]


def test_a_formula_given_to_a_component_takes_the_place_of_the_value_that_was_marked(
    compiled: Compile,
) -> None:
    flat = compiled(
        """model M model A parameter Real k = 1 annotation(__Daest(estimate = true)); Real x;
        equation der(x) = -k*x; end A; parameter Real r = 3 annotation(__Daest(estimate = true));
        A a(k = 2*r); end M;"""
    )
    assert [(p.name, p.value, p.estimate) for p in flat.parameters] == [("r", 3, True)]
    assert [p.name for p in flat.derived_parameters] == ["a.k"]


@pytest.mark.parametrize(
    ("declaration", "what", "remedy"),
    [
        ("parameter Real k = 1 annotation(__Daest(estimat = true));", "`estimat`", "`estimate`"),
        ('parameter Real k = 1 annotation(__Daest(scale = "lg"));', '"lg"', '"log"'),
        ("parameter Real k = 1 annotation(__Daest(estimate = 3));", "true or false", "estimate = true"),
        ("parameter Real k = 1 annotation(__Daest(estimate));", "expected `=`", "estimate = true"),
        ("parameter Real k = 1 annotation(__Daest(noise = true));", "parameter `k`", "estimate"),
        (
            "parameter Real j = 1; parameter Real k = 2*j annotation(__Daest(estimate = true));",
            "2*j",
            "computed",
        ),
        ("parameter Real k = 1; Real z = 1 annotation(__Daest(estimate = true));", "`z`", "parameter"),
        ("parameter Real k = 1; output Real z = 1 annotation(__Daest(std = -1));", "-1", "positive"),
        ("parameter Real k = 1; output Real z = 1 annotation(__Daest(std = sigma));", "sigma", "spelling"),
        (
            "parameter Real k = 1; input Real w annotation(__Daest(noise = true, intensity = -1));",
            "-1",
            "positive",
        ),
    ],
)
def test_wrong_annotation(compiled: Compile, declaration: str, what: str, remedy: str) -> None:
    with pytest.raises(ModelError) as caught:
        compiled(f"model M\n  {declaration}\n  Real x;\nequation\n  der(x) = -k*x;\nend M;")
    error = caught.value
    assert error.code == "model-annotation"
    assert what in error.what and remedy in error.remedy
    assert isinstance(error.where, Place) and error.where.line == 2


def test_annotation_of_a_class_is_refused(compiled: Compile) -> None:
    """It had been passed over, and nothing was estimated."""
    with pytest.raises(ModelError) as caught:
        compiled(
            """model M
              parameter Real k = 1;
              Real x;
            equation
              der(x) = -k*x;
              annotation(Icon(), __Daest(estimate = {k}));
            end M;"""
        )
    error = caught.value
    assert error.code == "model-annotation" and "at the class" in error.what
    assert isinstance(error.where, Place) and error.where.line == 6
