"""OpenModelica's compiler as another way from Modelica to an FMU, or to Base Modelica, where it is installed.

One script, one process: load the model and the libraries that it names, build, tell the errors. Its FMUs are
then used as those of any other tool.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from daest.errors import ModelError, Place
from daest.files import passing_folder, run_program
from daest.modelica.language.library import library_entries, library_name, library_roots
from daest.modelica.language.outline import class_heads, tokens, within

BUILD_SECONDS = 1800.0
"""Nobody waits longer for OpenModelica than this."""

SHOWN_LINES = 20
"""Of its complaint, this many lines are shown."""

FMI_VERSION = "2.0"
"""OpenModelica's FMI 3.0 export lacks directional derivatives, its FMI 2.0 export has them."""

ITS_OWN_LIBRARY = "Modelica"
"""It comes with OpenModelica, which loads it only when it is told to."""

_MESSAGE = re.compile(
    r"^(?:\[(?P<file>.+):(?P<line>\d+):(?P<column>\d+)-\d+:\d+:\w+\] )?"
    r"(?P<kind>Error|Warning|Notification): ",
    re.MULTILINE,
)
_BUILD_ERROR = re.compile(r"\berror\b|undefined reference", re.IGNORECASE)
_NOT_BUILT = "Error building simulator"
_NO_NETWORK = ("Curl error for URL", "Failed to download package index")
"""It looks for an index of libraries on the network, which a build does not need."""


@dataclass(frozen=True)
class OmcJob:
    """What OpenModelica is asked for: a class of the file `path`, whose text is `text`; `libraries` are
    folders that contain libraries, MODELICAPATH and the bundled library come after them."""

    path: Path
    text: bytes
    class_name: str
    libraries: tuple[Path, ...] = ()


def find_omc() -> Path:
    """The program: the environment variable OMC, else `omc` on the path. Raises ModelError `omc-missing`."""
    found = shutil.which(os.environ.get("OMC") or "omc")
    if found is None:
        raise ModelError(
            "omc-missing",
            "OpenModelica's compiler omc was not found",
            remedy="Install OpenModelica, or set the environment variable OMC to its program omc.",
        )
    return Path(found)


def fmu_by_omc(job: OmcJob) -> bytes:
    """The Model Exchange FMU (FMI 2.0) of a class, with directional derivatives if it can be built with them.
    Raises ModelError `omc-missing` or `omc-failed`."""
    build = f'buildModelFMU({job.class_name}, version="{FMI_VERSION}", fmuType="me", fileNamePrefix="model");'
    try:
        return _made(
            job, f'setCommandLineOptions("-d=-disableDirectionalDerivatives");\n{build}', "model.fmu"
        )
    except ModelError as problem:
        if _NOT_BUILT not in problem.what:
            raise
        # The C code of the derivatives may call functions that are written nowhere (tables of the MSL).
        return _made(job, build, "model.fmu")


def base_modelica_by_omc(job: OmcJob) -> bytes:
    """The class as Base Modelica: one flat text. Raises ModelError `omc-missing` or `omc-failed`."""
    command = (
        'setCommandLineOptions("--baseModelica");\n'
        f'writeFile("model.bmo", instantiateModel({job.class_name}));'
    )
    return _made(job, command, "model.bmo")


def omc_script(job: OmcJob, command: str) -> str:
    """The script: search path, model, libraries, `command`, and what went wrong.

    OpenModelica loads by itself only libraries that the model `uses`; the others that it names are asked for
    one by one. Raises ModelError `model-library` for a folder of libraries that does not exist.
    """
    file = job.path.resolve()
    folders = library_roots(job.libraries)
    path = os.pathsep.join(str(_searched(folder)) for folder in folders)
    lines = [
        f'setModelicaPath("{_quoted(path)}" + "{os.pathsep}" + getModelicaPath());',
        f'loadFile("{_quoted(str(_outermost(file) if within(job.text) else file))}");',
        *(f"loadModel({name});" for name in _named_libraries(job, folders)),
        *(f'loadFile("{_quoted(str(neighbour))}");' for neighbour in _named_neighbours(job, file)),
    ]
    return "\n".join([*lines, command, "getErrorString();"]) + "\n"


def _searched(folder: Path) -> Path:
    """The folder to search for a library: the one above where `folder` is the library itself."""
    return folder.parent if (folder / "package.mo").is_file() else folder


def _outermost(file: Path) -> Path:
    """The package.mo of the outermost package that is stored around `file`, else the file itself."""
    folder = file.parent
    if not (folder / "package.mo").is_file():
        return file
    while (folder.parent / "package.mo").is_file():
        folder = folder.parent
    return folder / "package.mo"


def _named_libraries(job: OmcJob, folders: Iterable[Path]) -> list[str]:
    """The libraries of the folders, and of OpenModelica itself, whose names stand in the text."""
    known = {library_name(entry) for folder in folders for entry in library_entries(folder)}
    return sorted((known | {ITS_OWN_LIBRARY}) & _foreign_names(job.text))


def _named_neighbours(job: OmcJob, file: Path) -> list[Path]:
    """Files beside a file of its own whose classes the text names."""
    if within(job.text):
        return []
    names = _foreign_names(job.text)
    return [entry for entry in sorted(file.parent.glob("*.mo")) if entry.stem in names and entry != file]


def _foreign_names(text: bytes) -> set[str]:
    """Names in the text, without those of its own classes."""
    own = {head.name.partition(".")[0] for head in class_heads(text)}
    return {token.text for token in tokens(text) if token.kind == "name"} - own


def _quoted(text: str) -> str:
    """For a string of the script, where a backslash begins an escape."""
    return text.replace("\\", "\\\\").replace('"', '\\"')


def _made(job: OmcJob, command: str, file: str) -> bytes:
    """The content of `file`, which `command` makes in a folder of its own."""
    program = find_omc()
    with passing_folder("daest-omc-") as work:
        (work / "build.mos").write_text(omc_script(job, command), encoding="utf-8")
        try:
            done = run_program([str(program), "build.mos"], work, BUILD_SECONDS)
        except (OSError, subprocess.TimeoutExpired) as problem:
            raise _failed(job, f"it did not run: {problem}") from problem
        made = work / file
        if done.returncode != 0 or not made.is_file() or made.stat().st_size == 0:
            raise _failed(job, done.stdout + done.stderr or f"it ended with {done.returncode}")
        return made.read_bytes()


def _failed(job: OmcJob, said: str) -> ModelError:
    """The error of what OpenModelica said: its complaints alone where it makes any, at the place of the first
    in the user's file."""
    said = re.sub(r'(\\)?"', lambda quote: '"' if quote[1] else "", said)
    found = list(_MESSAGE.finditer(said))
    ends = [*(match.start() for match in found[1:]), len(said)]
    complaints = [
        (match, said[match.start() : end].strip())
        for match, end in zip(found, ends, strict=bool(found))
        if match["kind"] == "Error" and not said[match.end() :].startswith(_NO_NETWORK)
    ]
    shown = [line for text in dict.fromkeys(text for _, text in complaints) for line in _essence(text)]
    words = shown[:SHOWN_LINES] or [line for line in said.splitlines() if line.strip()][-SHOWN_LINES:]
    own = [match for match, _ in complaints if match["file"] and Path(match["file"]) == job.path.resolve()]
    return ModelError(
        "omc-failed",
        f"OpenModelica made nothing of `{job.class_name}`:\n" + "\n".join(words),
        where=Place(str(job.path), int(own[0]["line"]), int(own[0]["column"])) if own else str(job.path),
        remedy="Correct what it says; libraries are looked for in the folders of -L, those of MODELICAPATH, "
        "and its own.",
    )


def _essence(complaint: str) -> list[str]:
    """The lines of a complaint; of the log of a C compiler those that tell errors."""
    first, *rest = complaint.splitlines()
    if len(rest) < SHOWN_LINES:
        return [first, *rest]
    return [first, *(line for line in rest if _BUILD_ERROR.search(line))]
