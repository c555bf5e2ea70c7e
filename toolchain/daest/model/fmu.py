"""FMU values: what the archive says about itself, and what an export wrote."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal


@dataclass(frozen=True)
class FmuVariable:
    """A Float64 (FMI 2: Real) variable; all names that share its value reference are in `aliases`.

    `derivative_of` is the value reference of the variable whose time derivative this is. `nominal` is never
    0. `annotations` maps the type of a vendor annotation to its text.
    """

    name: str
    value_reference: int
    causality: str
    variability: str
    initial: str | None = None
    unit: str = ""
    description: str = ""
    start: float | None = None
    min: float | None = None
    max: float | None = None
    nominal: float | None = None
    derivative_of: int | None = None
    aliases: tuple[str, ...] = ()
    annotations: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Residual:
    """A residual variable and the value references it depends on (None: on everything)."""

    value_reference: int
    dependencies: tuple[int, ...] | None = None


@dataclass(frozen=True)
class DaeManifest:
    """What the layered standard fmi-ls-dae adds: value references throughout. `enable` is None in early
    drafts.
    """

    version: str
    enable: int | None
    algebraic: tuple[int, ...]
    residuals: tuple[Residual, ...]
    derivatives: tuple[int, ...] = ()  # state derivatives that the FMU computes itself (semi-explicit form)


@dataclass(frozen=True)
class FmuModel:
    """The description of an FMU. Variables are merged by value reference.

    `states`, `derivatives` (in the same order), `inputs`, `outputs` and `parameters` are value references;
    `platforms` the folders below `binaries` that hold the library. `kind` "co-simulation" is an FMU that
    offers nothing else: it has no states that could be seen. `reports_steps`: it wants to hear of every step
    of the integrator. `only_once`: a process can hold one instance alone.
    """

    path: Path
    fmi_version: str
    model_name: str
    model_identifier: str
    token: str
    variables: Mapping[int, FmuVariable]
    states: tuple[int, ...]
    derivatives: tuple[int, ...]
    inputs: tuple[int, ...]
    outputs: tuple[int, ...]
    parameters: tuple[int, ...]
    platforms: tuple[str, ...]
    provides_directional_derivatives: bool
    n_event_indicators: int
    manifest: DaeManifest | None
    has_symbolic_model: bool
    notes: tuple[str, ...] = ()
    kind: Literal["exchange", "co-simulation"] = "exchange"
    reports_steps: bool = False
    only_once: bool = False

    def named(self, name: str) -> FmuVariable | None:
        """The variable of that name or alias."""
        for variable in self.variables.values():
            if name == variable.name or name in variable.aliases:
                return variable
        return None


@dataclass(frozen=True)
class ExportResult:
    """What `export_fmu` wrote. `validation` holds the messages of fmpy's validator (empty: none)."""

    path: Path
    model_name: str
    platforms: tuple[str, ...]
    n_equations: int
    structural_index: int
    n_differentiations: int
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    input_derivatives: tuple[str, ...]
    noises: tuple[str, ...]
    outputs: tuple[str, ...]
    parameters: tuple[str, ...]
    validation: tuple[str, ...]
    seconds: float
    fmi_version: str = "3.0"

    @property
    def n_states(self) -> int:
        """States that the integrator of whoever imports the FMU sees."""
        return len(self.states)


@dataclass(frozen=True)
class EstimatorExport:
    """What an export of an estimator wrote: `form` "fmu" or "c"; `values` are the variables that it
    estimates, `validation` the messages of fmpy's validator (empty: none)."""

    path: Path
    model_name: str
    form: str
    fmi_version: str | None
    platforms: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    values: tuple[str, ...]
    validation: tuple[str, ...]
    seconds: float
