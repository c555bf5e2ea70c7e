"""One error tree, and the catalogue of message codes behind ``daest explain``.

Every error says what happened, where (file, line, column, variable) and how to mend it. A command shows it
as one message and ends with exit code 2; a program catches `DaestError` and reads its fields.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Place:
    """A position in a user's file; line and column count from 1."""

    file: str
    line: int | None = None
    column: int | None = None

    def __str__(self) -> str:
        parts = [self.file]
        if self.line is not None:
            parts.append(str(self.line))
            if self.column is not None:
                parts.append(str(self.column))
        return ":".join(parts)


class DaestError(Exception):
    """Something could not be done. `code` is a key of `EXPLANATIONS`; `remedy` says what to do."""

    def __init__(self, code: str, what: str, *, where: Place | str | None = None, remedy: str = "") -> None:
        super().__init__(what)
        self.code = code
        self.what = what
        self.where = where
        self.remedy = remedy

    def __str__(self) -> str:
        lines = [f"error[{self.code}]: {self.what}"]
        if self.where is not None:
            lines.append(f"  --> {self.where}")
        if self.remedy:
            lines.append(f"  help: {self.remedy}")
        return "\n".join(lines)

    def __reduce__(self) -> tuple:
        return _rebuild, (type(self), self.code, self.what, self.where, self.remedy)


def _rebuild(
    kind: type[DaestError], code: str, what: str, where: Place | str | None, remedy: str
) -> DaestError:
    return kind(code, what, where=where, remedy=remedy)


class ModelError(DaestError):
    """The Modelica source, or the model made from it, cannot be used."""


class FmuError(DaestError):
    """An FMU cannot be written, read or run."""


class DataError(DaestError):
    """A recording cannot be used."""


class ConfigError(DaestError):
    """`daest.toml` or an option of a command is wrong."""


class EstimationError(DaestError):
    """The data and the model do not allow the estimate that was asked for."""


class NumericalError(DaestError):
    """A computation has no reliable answer; the message names the decision that failed."""


EXPLANATIONS: dict[str, str] = {
    # Sorted by code. Each text: what it means, why it matters, what to do.
    "input-derivative-hold": (
        "The model needs the time derivative of an input, and the input is taken as constant between "
        "samples (zero-order hold), which has none: it would jump at every sample. Use first-order hold."
    ),
    "input-derivative-order": (
        "The index reduction needs a second or higher time derivative of an input. From samples only the "
        "slope between two of them is known, so the model cannot be sampled. Make that derivative itself "
        "the input of the model, or feed the input through a lag."
    ),
    "output-white-noise": (
        "White noise reaches a measured output without passing a state. Sampled white noise has no finite "
        "variance; the output would carry no information. Hold the noise over a sample, or put a lag (a "
        "noise with a bandwidth) between the noise and the output."
    ),
    "unit-incompatible": (
        "A recorded signal has a unit of another dimension than the model variable it is matched with, so "
        "no conversion exists. Either the wrong column is mapped, or the unit in the header or in the model "
        "is wrong. Units are never ignored."
    ),
    "unit-unknown": (
        "A unit is written in a way that is not understood. Units follow Modelica: products with a dot, "
        "powers as digits, one slash, brackets behind it for a product: N.m, kg.m2, W/(m2.K), rad/s2, degC, "
        "1."
    ),
}
