"""The page on how results are verified names commands and tests that exist, and every oracle."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "verification.md").read_text(encoding="utf-8")
HELPERS = {"exact.py", "dae_problems.py"}  # that print no table


def test_what_the_page_names_exists():
    named = re.findall(r"((?:benchmarks|tests)/[\w/]+\.(?:py|md))", PAGE)
    assert len(named) > 15
    assert [name for name in named if not (ROOT / name).is_file()] == []


def test_every_oracle_is_on_the_page():
    oracles = {path.name for path in (ROOT / "benchmarks" / "oracles").glob("*.py")} - HELPERS
    assert {name for name in oracles if f"benchmarks/oracles/{name}" not in PAGE} == set()
