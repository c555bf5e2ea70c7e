"""Connections between variables whose declared units contradict each other are told, others are not."""

import pytest

MODEL = """\
connector Electric
  Real v(unit = "V");
  flow Real i(unit = "A");
end Electric;
connector Other
  Real v(unit = "{unit}");
  flow Real i(unit = "A");
end Other;
model Source
  parameter Real R(unit = "Ohm") = 2;
  input Real e(unit = "V");
  Electric p;
equation
  p.v = e + R*p.i;
end Source;
model Store
  parameter Real C(unit = "F") = 3;
  Other q;
equation
  C*der(q.v) = q.i;
end Store;
model Joined
  input Real u(unit = "V");
  output Real y(unit = "V");
  Source source(e = u);
  Store store;
equation
  connect(source.p, store.q);
  y = store.q.v;
end Joined;
"""


@pytest.mark.parametrize("unit", ["N", "rad/s", "A"])
def test_units_of_different_dimensions_are_told_once(folder, daest, unit):
    (folder / "Joined.mo").write_text(MODEL.format(unit=unit))
    code, out, err = daest("linearize", "Joined.mo", "--class", "Joined")
    assert code == 0 and "Poles" in out
    assert err.count("warning[unit-contradiction]") == 1
    assert f"`source.p.v` [V] with `store.q.v` [{unit}]" in err and "Joined.mo:28" in err


@pytest.mark.parametrize("unit", ["V", "mV", "W/A", "J/C", "", "bananas"])
def test_units_that_agree_or_say_nothing_are_not(folder, daest, unit):
    (folder / "Joined.mo").write_text(MODEL.format(unit=unit))
    code, _, err = daest("linearize", "Joined.mo", "--class", "Joined")
    assert code == 0 and "unit-contradiction" not in err


def test_many_are_counted():
    from daest.modelica.flat.connected_units import sentence

    assert sentence(list("abcde")).endswith("connects a, b, c and 2 more")
