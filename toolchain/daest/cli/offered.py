"""Values that the shell completes: names out of the daest.toml and the results here, and effects.

Only small files are read, so that a Tab takes no longer than the interpreter.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

Completion = Callable[..., list[str]]
PROJECT = Path("daest.toml")
DIAGNOSIS = Path("results") / "diagnosis.json"


def _offered(names: Callable[[], list[str]], behind: str = "") -> Completion:
    def complete(_context: Any, _parameter: Any, begun: str) -> list[str]:
        return [name + behind for name in names() if name.startswith(begun)]

    return complete


def _read(path: Path, parse: Callable[[str], Any]) -> dict[str, Any]:
    """The content of a file; nothing where it is not there or damaged: a completion says nothing."""
    try:
        content = parse(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}


def _table(content: dict[str, Any], *keys: str) -> list[str]:
    for key in keys:
        inner = content.get(key)
        content = inner if isinstance(inner, dict) else {}
    return list(content)


def _project() -> dict[str, Any]:
    import tomllib  # only a Tab waits for it

    return _read(PROJECT, tomllib.loads)


def _parameters() -> list[str]:
    return _table(_project(), "parameters")


def _outputs() -> list[str]:
    return _table(_project(), "data", "outputs")


def _places() -> list[str]:
    """Places where the last diagnosis refitted something."""
    candidates = _read(DIAGNOSIS, json.loads).get("candidates")
    entries = candidates if isinstance(candidates, list) else []
    found = [entry["at"] for entry in entries if isinstance(entry, dict) and isinstance(entry.get("at"), str)]
    return list(dict.fromkeys(found))


def _effects() -> list[str]:
    from daest.errors import ModelError
    from daest.modelica.language.library import library_root

    try:
        folder = library_root() / "Daest" / "Effects"
    except ModelError:
        return []
    names = {path.stem for path in folder.glob("*/*.mo")} - {"package"}
    return sorted(name for name in names if not name.startswith("Partial"))


parameters = _offered(_parameters)
assigned_parameters = _offered(_parameters, "=")
outputs = _offered(_outputs)
places = _offered(_places)
effects = _offered(_effects)
