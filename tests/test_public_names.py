"""`import daest`: every public name exists and is documented, and nothing is loaded before it is used."""

import ast
import inspect
import subprocess
import sys
from pathlib import Path

import pytest

import daest

NUMERICAL = ("casadi", "numpy", "scipy", "pandas", "matplotlib", "rumoca", "fmpy", "control", "click")


@pytest.mark.parametrize("name", daest.__all__)
def test_public_name_is_documented(name):
    value = getattr(daest, name)
    assert value.__name__ == name
    text = inspect.getdoc(value)
    assert text and len(text.split()) >= 5
    # The words that dataclasses write by themselves are no documentation.
    assert not text.startswith(f"{name}(")


def test_editors_know_the_types_of_all_names():
    stub = ast.parse((Path(daest.__file__).parent / "__init__.pyi").read_text(encoding="utf-8"))
    imports = [node for node in stub.body if isinstance(node, ast.ImportFrom)]
    told = {alias.asname: (node.module, alias.name) for node in imports for alias in node.names}
    assert told == {name: (module, name) for name, module in daest._PUBLIC.items()}
    assert (Path(daest.__file__).parent / "py.typed").is_file()


def test_import_loads_nothing_numerical():
    script = f"import sys, daest; print([m for m in {NUMERICAL!r} if m in sys.modules])"
    result = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"


def test_names_are_listed_and_others_refused():
    assert set(daest.__all__) <= set(dir(daest))
    with pytest.raises(AttributeError, match="no attribute 'compile_modle'"):
        daest.compile_modle  # noqa: B018
