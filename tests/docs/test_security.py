"""The page on security names tests that exist."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "security.md").read_text(encoding="utf-8")
NAMED = re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", PAGE)


def test_the_tests_that_the_page_names_exist():
    assert len(NAMED) > 20
    for file, name in NAMED:
        tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
        assert name in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}, (file, name)


def test_each_row_of_a_promise_names_one():
    rows = [line for line in PAGE.splitlines() if line.startswith("| ") and not line.startswith("|---")]
    promises = [row for row in rows if not row.rstrip("| ").endswith("Test")]
    assert len(promises) == len(NAMED)
