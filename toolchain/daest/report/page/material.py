"""What a report is made of: the documents and series of `results/`, the model, and the files behind them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from daest.model.flat import Model

Document = Mapping[str, Any]
Series = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Traced:
    """A file that a result was made from. `state` is "same" while its content is what it was then, else
    "changed" or "missing"."""

    role: str
    path: str
    sha256: str
    state: str
    used_by: tuple[str, ...]  # commands


@dataclass(frozen=True)
class Material:
    """Content of a report; what no command has left yet is None or empty.

    `flat` is the model of daest.toml with the values of its fit. `sources` are the texts of models by file
    name: `base` is the one that the others extend. `trace` are the files behind the results, `versions` the
    programs that made them, by command.
    """

    title: str
    version: str
    flat: Model | None = None
    noise: Document | None = None
    fit: Document | None = None
    comparison: Document | None = None
    comparison_series: Series = field(default_factory=dict)
    filter: Document | None = None
    filter_series: Series = field(default_factory=dict)
    diagnosis: Document | None = None
    design: Document | None = None
    design_series: Series = field(default_factory=dict)
    ledger: Document | None = None
    base: str | None = None
    sources: Mapping[str, str] = field(default_factory=dict)
    trace: tuple[Traced, ...] = ()
    versions: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()  # what could not be read, as sentences
