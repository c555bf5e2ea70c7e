"""Lists in sentences."""

import pytest

from daest.lists import first_few


@pytest.mark.parametrize(
    ("texts", "most", "total", "told"),
    [
        ([], 2, None, ""),
        (["a"], 2, None, "a"),
        (["a", "b"], 2, None, "a, b"),
        (["a", "b", "c"], 2, None, "a, b and 1 more"),
        (["a", "b"], 12, 5, "a, b and 3 more"),
    ],
)
def test_the_rest_is_counted(texts, most, total, told):
    assert first_few(texts, most, total) == told


def test_another_separator():
    assert first_few(["a, b", "c", "d"], 2, separator="; ") == "a, b; c and 1 more"
