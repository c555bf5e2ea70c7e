"""Slips in daest.toml: what is told names the slip, not the rule of the grammar that the parser missed."""

import tomllib

import pytest

from daest.data.project import fault


@pytest.mark.parametrize(
    ("text", "what", "remedy", "line"),
    [
        ("[model]\nsource = Servo.mo", "no quotes", 'source = "Servo.mo"', 2),
        ("[model]\nsource = ", "'source' has no value", "put #", 2),
        ("a = yes", "'yes'", "a = true", 1),
        ("a = True # set", "'True'", "a = true", 1),
        ("a = 1,5", "comma", "1.5", 1),
        ("a = [1; 2]", "list is not closed", "commas", 1),
        ("a = { b = 1\n c = 2 }", "{ is not closed", "one line", 1),
        ('a = "x\nb = 1', "text is not closed", "quote", 1),
        ("a = 'x", "text is not closed", "quote", 1),
        ("[a\nb = 1", "section is not closed", "[section]", 1),
        ("disc phi = 3", "no value", "quotes", 1),
        ("[a]\nx = 1\n[a]\ny = 2", "section stands twice", "first", 3),
        ("x = 1\nx = 2\ny = 3", "value already", "keep one", 2),
        ("a = { x = 1, x = 2 }", "twice in { }", "keep one", 1),
        ('p = "C:\\users\\x"', "backslash", "with /", 1),
        ('p = "data\\old"', "backslash", "with /", 1),
        ("= 3", "neither", "#", 1),
        ("x = 3 kg", "behind a value", "quotes", 1),
        ("x = [run1.csv]", "no value", "text", 1),
        ('x = "\x01"', "character", "again", 1),
    ],
)
def test_slips_are_named(text, what, remedy, line):
    with pytest.raises(tomllib.TOMLDecodeError) as raised:
        tomllib.loads(text)
    found = fault(str(raised.value), text)
    assert what in found.what and remedy in found.remedy and found.line == line


def test_what_is_not_known_is_passed_on():
    found = fault("A new rule (at line 2, column 7)", "a = 1\nb = 2")
    assert found.what == "not valid TOML: A new rule" and (found.line, found.column) == (2, 7)
