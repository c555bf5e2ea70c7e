"""The page on the language: the same features as the models behind it, and, slowly, the same outcomes."""

import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs/language.md"
sys.path.insert(0, str(ROOT / "benchmarks"))

import language_features  # noqa: E402

SHOWN = dict(
    line.strip("| ").split(" | ")
    for line in PAGE.read_text().splitlines()
    if line.startswith("| ") and not line.startswith("| feature")
)


def test_the_page_has_the_features():
    names = [feature.name for feature in language_features.features()]
    assert list(SHOWN) == names, "run: python benchmarks/language_features.py --write docs/language.md"
    refused = {feature.name for feature in language_features.features() if feature.is_refused}
    assert {name for name, text in SHOWN.items() if text.startswith("refused")} == refused


@pytest.mark.slow
def test_the_page_is_what_the_models_do():
    assert language_features.page() == PAGE.read_text()
