"""The document of `daest noise`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal, NotRequired, TypedDict

import numpy as np
import scipy.sparse as sp

from daest.model.linear import LinearDAE
from daest.model.noise import NoiseAlong, NoiseReport
from daest.report.documents.parts import (
    Decision,
    EquationEntry,
    Of,
    decision_entry,
    entry,
    equation_entry,
)

ManyNames = Annotated[int, "how many such unknowns there are; of an equation at most 100 are named"]


class Judged(TypedDict):
    admissible: bool
    projection_norm: float
    order: NotRequired[int]
    differentiated: Annotated[list[str], "unknowns that would contain differentiated noise"]
    n_differentiated: ManyNames
    white_outputs: NotRequired[list[str]]
    advice: str


class JudgedEquation(EquationEntry, Judged):
    pass


class JudgedNoise(Judged):
    name: str
    equations: list[int]


class JudgedAlong(TypedDict):
    index: NotRequired[int]
    equations: NotRequired[list[int]]
    name: str
    admissible: Annotated[bool, "at every point"]
    admissible_at_start: Annotated[bool, Of("at_start")]
    forbidden_share: Annotated[float, "share of the points"]
    first_time: Annotated[float | None, "s"]
    largest_norm: float
    differentiated: Annotated[list[str], Of("verdict.differentiated")]
    n_differentiated: Annotated[ManyNames, Of("verdict.n_differentiated")]
    advice: Annotated[str, Of("verdict.advice")]


class Unjudged(TypedDict):
    time: float
    reason: str


class Structure(TypedDict):
    n_dynamic: int
    index: int


class Generic(TypedDict):
    of: Annotated[
        Literal["parameters", "numbers"],
        "for almost every value of the parameters, or of the numbers in equations without parameters",
    ]
    index: int
    n_dynamic: int
    forbidden: Annotated[list[int], "equations that may not carry white noise"]
    noises: Annotated[list[str], "noises of the model that are not admissible"]


class ModeEntry(TypedDict):
    mode: Annotated[str, "relations and discrete variables that the equations contain, with their values"]
    share: Annotated[float, "share of the samples"]
    first_time: Annotated[float, "s"]
    structures: Annotated[list[Structure], "empty where the linearised model is regular nowhere in the mode"]
    n_forbidden: Annotated[int, "equations that may not carry white noise at some point of the mode"]
    forbidden: Annotated[list[str], "noises of the model and places asked for that are not admissible"]


class Along(TypedDict):
    times: list[float]
    unjudged: list[Unjudged]
    structures: list[Structure]
    same_everywhere: bool
    equations: list[JudgedAlong]
    annotated: list[JudgedAlong]
    asked: list[JudgedAlong]
    all_admissible: bool
    generic: Annotated[Generic | None, "the exact verdict that holds at most points; null where none exists"]
    generic_points: Annotated[int, "how many points that is"]
    modes: Annotated[list[ModeEntry], "of a model with events, those that occur"]


class Differs(TypedDict):
    what: Literal["index", "n_dynamic", "equations", "noises"]
    reason: str
    equations: list[int]
    noises: list[str]


class NoiseDocument(TypedDict):
    """Which equations may carry white noise (Theorem 3.1)."""

    n_equations: int
    n_dynamic: int
    index: int
    N_singular_values: list[float]
    equations: list[JudgedEquation]
    n_forbidden: int
    annotated: list[JudgedNoise]
    asked: list[JudgedNoise]
    all_admissible: bool
    tolerance: float | None
    generic: Annotated[
        Generic | None, "the verdict by exact arithmetic; null where the numbers are results of rounding"
    ]
    differs: Annotated[
        list[Differs],
        Of("differences"),
        "where the verdict at these values is another one than `generic`, and why",
    ]
    undecided: Annotated[list[str], "what rounding errors could turn; empty where exact arithmetic decides"]
    decisions: list[Decision]
    along: NotRequired[Annotated[Along, "with --along: verdicts at points of a trajectory"]]


class Unknown(TypedDict):
    name: str
    unit: str


class Pattern(TypedDict):
    unknowns: list[Unknown]
    E: list[list[int]]
    J: list[list[int]]


def document(report: NoiseReport, along: NoiseAlong | None = None) -> NoiseDocument:
    """JSON-ready verdicts of Theorem 3.1: per equation, per noise of the model (`annotated`), per place that
    was asked for (`asked`). `equations` of a noise are indices into `equations`, from 0.

    `generic` is the exact verdict, `differs` tells where and why the one here is another, `undecided` what
    rounding errors could turn. `along` holds the verdicts at the points of a trajectory, where they were
    asked for."""
    equations = enumerate(zip(report.equations, report.places, strict=True))
    judged = entry(
        NoiseDocument,
        report,
        n_equations=len(report.equations),
        equations=[
            {**equation_entry(i, equation), **entry(Judged, place)} for i, (equation, place) in equations
        ],
        decisions=[decision_entry(decision) for decision in report.decisions],
    )
    if along is not None:
        judged["along"] = along_document(along)
    return judged


def along_document(along: NoiseAlong) -> Along:
    """The verdicts along a trajectory: all noises and places that were asked for, and of the equations those
    that are not admissible everywhere."""
    return entry(
        Along,
        along,
        unjudged=[{"time": time, "reason": reason} for time, reason in along.unjudged],
        structures=_structures(along.structures),
        modes=[entry(ModeEntry, mode, structures=_structures(mode.structures)) for mode in along.modes],
        equations=[
            entry(JudgedAlong, place, index=i) for i, place in enumerate(along.places) if not place.admissible
        ],
    )


def _structures(found: Sequence[tuple[int, int]]) -> list[Structure]:
    return [{"n_dynamic": n, "index": index} for n, index in found]


def structure(dae: LinearDAE) -> Pattern:
    """Unknowns with their units, and the places [row, column] of E and J that are not zero."""
    places = {name: np.column_stack(sp.csr_array(getattr(dae, name)).nonzero()) for name in ("E", "J")}
    return entry(Pattern, dae, **places)
