"""Where Modelica libraries are looked for."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from daest.errors import ModelError

_PACKAGE = Path(__file__).resolve().parent.parent


def library_root() -> Path:
    """The folder that contains `Daest/package.mo`: inside the installed package, or `modelica/` of a
    checkout.

    Raises ModelError when the installation holds neither."""
    candidates = (_PACKAGE / "library", _PACKAGE.parent.parent / "modelica")
    for candidate in candidates:
        if (candidate / "Daest" / "package.mo").is_file():
            return candidate
    raise ModelError(
        "model-library",
        "the bundled library Daest is missing from this installation",
        where=str(candidates[0]),
        remedy="Install daest again.",
    )


def library_roots(libraries: Sequence[str | Path] = ()) -> tuple[Path, ...]:
    """Folders to search: `libraries`, then MODELICAPATH, then the bundled library. Raises ModelError for a
    folder of `libraries` that does not exist."""
    found = [Path(folder).expanduser() for folder in libraries]
    for folder in found:
        if not folder.is_dir():
            raise ModelError(
                "model-library",
                f"there is no library folder {folder}",
                where=str(folder),
                remedy="Give -L the folder that contains the library's own folder.",
            )
    path = os.environ.get("MODELICAPATH", "").split(os.pathsep)
    found += [Path(folder) for folder in path if folder and Path(folder).is_dir()]
    if all(not (folder / "Daest" / "package.mo").is_file() for folder in found):
        found += [root for root in (_bundled(),) if root is not None]
    return tuple(dict.fromkeys(folder.resolve() for folder in found))


def _bundled() -> Path | None:
    try:
        return library_root()
    except ModelError:
        return None
