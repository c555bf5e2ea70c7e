"""Compiling Modelica text in tests."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from daest.model.flat import FlatModel
from daest.modelica.compile import compile_model

MODELS = Path(__file__).parent / "models"


@pytest.fixture
def compiled(tmp_path: Path) -> Callable[..., FlatModel]:
    """`compiled(text, class_name=None, …)` writes the text to Model.mo and compiles it."""

    def compile_text(text: str | bytes, class_name: str | None = None, **options: object) -> FlatModel:
        path = tmp_path / "Model.mo"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return compile_model(path, class_name, **options)  # type: ignore[arg-type]

    return compile_text
