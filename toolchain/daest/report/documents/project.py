"""The documents of commands that set up, show and explain a project."""

from __future__ import annotations

from typing import Annotated, Any, NotRequired, TypedDict

from daest.report.documents.check import FindingEntry
from daest.report.documents.compare import CompareDocument
from daest.report.documents.fit import FitDocument
from daest.report.documents.noise import NoiseDocument


class RecordedFinding(FindingEntry):
    recording: str


class Clock(TypedDict):
    name: str
    n_samples: int
    start: float
    stop: float
    period: Annotated[float | None, "null where the clock is uneven"]
    clock: Annotated[str, "unit of the times"]


class InitDocument(TypedDict):
    """A new daest.toml."""

    file: str
    model: str
    inputs: Annotated[dict[str, str | None], "column by name in the model; null where none fits"]
    outputs: dict[str, str | None]
    doubtful: Annotated[list[str], "names in the model whose column was matched by less than its name"]
    estimate: list[str]
    proposed: Annotated[list[str], "of them those that are proposed because the model marks none"]
    noises: list[str]
    time: Annotated[str | None, "column of the time where it is not called so"]
    units: Annotated[dict[str, str], "of columns, from their names"]
    unread_units: Annotated[dict[str, str], "of columns, not understood, where some signal has no column"]
    recordings: Annotated[list[Clock], "their clocks, as they will be read"]
    findings: list[RecordedFinding]


class Part(TypedDict):
    id: str
    title: str
    present: bool
    missing: Annotated[str | None, "what makes a part that is not there"]


class ReportDocument(TypedDict):
    """The page that was written, and which parts it has."""

    path: str
    bytes: int
    parts: list[Part]
    notes: NotRequired[list[str]]


class Example(TypedDict):
    name: str
    description: str
    has_recording: bool


class DemoDocument(TypedDict):
    """Shipped examples, or one that was run."""

    examples: NotRequired[list[Example]]
    folder: NotRequired[str]
    identify: NotRequired[FitDocument | None]
    compare: NotRequired[CompareDocument | None]
    noise: NotRequired[NoiseDocument | None]


class ExplainDocument(TypedDict):
    """What messages mean."""

    codes: dict[str, str]


class SchemaDocument(TypedDict):
    """JSON Schemas of commands."""

    schemas: dict[str, dict[str, Any]]


class AppDocument(TypedDict):
    """Where the live page is served."""

    address: Annotated[str, "with the token; whoever knows it can start commands in the folder"]
    folder: str


class CompletionDocument(TypedDict):
    """Shell completion."""

    shell: str
    script: str
