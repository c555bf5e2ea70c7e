"""Tables that stand in files: text as the Modelica Standard Library describes it, CSV, MATLAB."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.io
from scipy.io.matlab import MatReadError

from daest.files import why_no_file

LARGEST = 200_000_000  # bytes of a file that is read
URI = "modelica://"

_BESIDE = "Name the file of the table; a relative name is looked for beside the file of the model."
_HEADER = re.compile(r"^\s*(?:double|float)\s+(\w+)\s*\(\s*(\d+)\s*,\s*(\d+)\s*\)", re.MULTILINE)
_SEPARATOR = re.compile(r"[\s,;]+")


class TableFileError(ValueError):
    """A file with a table that is not there or cannot be read; `remedy` says what to do."""

    def __init__(self, what: str, remedy: str) -> None:
        super().__init__(what)
        self.remedy = remedy


@dataclass(frozen=True)
class Folders:
    """Where a model looks for files: the folder of its own file, and those of libraries by their names."""

    own: Path = Path()
    libraries: tuple[tuple[str, Path], ...] = ()

    def file(self, name: str) -> Path:
        """The file that a name or an URI `modelica://Library/path` means; a relative name is one in the own
        folder. Raises TableFileError for a library that is not there."""
        if not name.startswith(URI):
            return self.own / name
        library, _, inside = name.removeprefix(URI).partition("/")
        folder = dict(self.libraries).get(library.partition(".")[0])
        if folder is None:
            raise TableFileError(
                f"the library of `{name}` is not there", "Give the folder that contains the library by -L."
            )
        return folder.joinpath(*library.split(".")[1:], inside)


def read_table(file: Path, name: str, delimiter: str = ",", n_header_lines: int = 0) -> np.ndarray:
    """The matrix `name` of a file, float (n_rows, n_columns); the one matrix of a .csv, whose lines are
    divided by the `delimiter` behind `n_header_lines`. Raises TableFileError."""
    try:
        if (kind := why_no_file(file)) is not None:
            raise TableFileError(f"the table's file {file} {kind}", _BESIDE)
        if file.stat().st_size > LARGEST:
            raise TableFileError(
                f"the table's file {file} has more than {LARGEST} bytes", "Shorten the table."
            )
        match file.suffix.lower():
            case ".mat":
                found = _of_matlab(file, name)
            case ".csv":
                found = _of_csv(file, delimiter, n_header_lines)
            case _:
                found = _of_text(file, name)
    except OSError as problem:
        raise TableFileError(
            f"the table's file {file} cannot be read: {problem.strerror or problem}", _BESIDE
        ) from None
    if not np.all(np.isfinite(found)):
        raise TableFileError(f"the table `{name}` of {file} has values that are no numbers", "Fill the gaps.")
    return found


def _of_text(file: Path, name: str) -> np.ndarray:
    """`double name(rows, columns)` and as many numbers behind it; what follows # is a comment."""
    text = file.read_bytes().decode("utf-8", errors="replace")
    found = list(_HEADER.finditer(text))
    heads = {head[1]: head for head in found}
    if name not in heads:
        listed = (
            f"It has: {', '.join(heads)}." if heads else "A table begins with: double NAME(ROWS, COLUMNS)"
        )
        raise TableFileError(f"there is no table `{name}` in {file}", listed)
    head = heads[name]
    shape = int(head[2]), int(head[3])
    line = text.count("\n", 0, head.end()) + 1
    end = min((one.start() for one in found if one.start() > head.start()), default=len(text))
    _, _, behind = text[head.end() : end].partition("\n")
    numbers: list[float] = []
    try:
        for words in _values(behind):
            line += 1
            numbers += map(float, words)
            if len(numbers) >= shape[0] * shape[1]:
                return np.array(numbers[: shape[0] * shape[1]]).reshape(shape)
    except ValueError as problem:
        raise TableFileError(f"{file}, line {line}: {problem}", "Write numbers there.") from None
    raise TableFileError(
        f"the table `{name}` of {file} has {len(numbers)} numbers for {shape[0]} x {shape[1]}",
        "Mend its size or its rows.",
    )


def _values(text: str) -> Iterator[list[str]]:
    """The words of each line in front of a comment."""
    for line in text.splitlines():
        yield [word for word in _SEPARATOR.split(line.partition("#")[0]) if word]


def _of_csv(file: Path, delimiter: str, n_header_lines: int) -> np.ndarray:
    try:
        return np.loadtxt(file, delimiter=delimiter, skiprows=n_header_lines, ndmin=2, encoding="utf-8")
    except ValueError as problem:
        raise TableFileError(
            f"{file}: {problem}", "Give its delimiter and its nHeaderLines in the block of the table."
        ) from None


def _of_matlab(file: Path, name: str) -> np.ndarray:
    try:
        found = scipy.io.loadmat(file, variable_names=[name])
    except NotImplementedError:
        raise TableFileError(
            f"{file} is a MATLAB file of version 7.3", "Save it by: save(name, '-v7')"
        ) from None
    except (MatReadError, ValueError, TypeError, KeyError, IndexError) as problem:
        raise TableFileError(f"{file} is no MATLAB file: {problem}", "Save it anew.") from None
    matrix = found.get(name)
    if not isinstance(matrix, np.ndarray) or matrix.ndim != 2 or matrix.dtype.kind not in "fiu":
        listed = ", ".join(one for one, _, _ in scipy.io.whosmat(file))
        raise TableFileError(f"there is no matrix `{name}` in {file}", f"It has: {listed or 'none'}.")
    return matrix.astype(float)
