"""OpenModelica's compiler as another way from Modelica to an FMU, or to Base Modelica, where it is installed.

One script, one process: load the libraries and the model, build, tell the errors. Its FMUs are then used as
those of any other tool.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

from daest.errors import ModelError

BUILD_SECONDS = 1800.0
"""Nobody waits longer for OpenModelica than this."""

SHOWN_LINES = 20
"""Of its complaint, this many lines are shown."""

FMI_VERSION = "2.0"
"""OpenModelica's FMI 3.0 export lacks directional derivatives, its FMI 2.0 export has them."""


@dataclass(frozen=True)
class OmcJob:
    """What OpenModelica is asked for: the class of the file `path`, and the folders of `libraries`."""

    path: Path
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
    """The Model Exchange FMU (FMI 2.0) of a class. Raises ModelError `omc-missing` or `omc-failed`."""
    command = (
        'setCommandLineOptions("-d=-disableDirectionalDerivatives");\n'
        f'buildModelFMU({job.class_name}, version="{FMI_VERSION}", fmuType="me", fileNamePrefix="model");'
    )
    return _made(job, command, "model.fmu")


def base_modelica_by_omc(job: OmcJob) -> bytes:
    """The class as Base Modelica: one flat text. Raises ModelError `omc-missing` or `omc-failed`."""
    command = (
        'setCommandLineOptions("--baseModelica");\n'
        f'writeFile("model.bmo", instantiateModel({job.class_name}));'
    )
    return _made(job, command, "model.bmo")


def omc_script(job: OmcJob, command: str) -> str:
    """The script: search path, model, `command`, and what went wrong."""
    lines = []
    if job.libraries:
        path = os.pathsep.join(str(folder.resolve()) for folder in job.libraries)
        lines.append(f'setModelicaPath("{_quoted(path)}" + "{os.pathsep}" + getModelicaPath());')
    lines += [f'loadFile("{_quoted(str(job.path.resolve()))}");', command, "getErrorString();"]
    return "\n".join(lines) + "\n"


def _quoted(text: str) -> str:
    """For a string of the script, where a backslash begins an escape."""
    return text.replace("\\", "\\\\").replace('"', '\\"')


def _made(job: OmcJob, command: str, file: str) -> bytes:
    """The content of `file`, which `command` makes in a folder of its own."""
    program = find_omc()
    with tempfile.TemporaryDirectory(prefix="daest-omc-") as work:
        (Path(work) / "build.mos").write_text(omc_script(job, command), encoding="utf-8")
        try:
            done = subprocess.run(
                [str(program), "build.mos"],
                cwd=work,
                capture_output=True,
                text=True,
                errors="replace",
                timeout=BUILD_SECONDS,
            )
        except (OSError, subprocess.TimeoutExpired) as problem:
            raise _failed(job, f"it did not run: {problem}") from problem
        made = Path(work) / file
        if done.returncode != 0 or not made.is_file() or made.stat().st_size == 0:
            words = [line for line in (done.stdout + done.stderr).splitlines() if line.strip('" \t')]
            raise _failed(job, "\n".join(words[-SHOWN_LINES:]) or f"it ended with {done.returncode}")
        return made.read_bytes()


def _failed(job: OmcJob, words: str) -> ModelError:
    return ModelError(
        "omc-failed",
        f"OpenModelica made nothing of `{job.class_name}`:\n{words}",
        where=str(job.path),
        remedy="Correct what it says; libraries are looked for in the folders of -L and in its own.",
    )
