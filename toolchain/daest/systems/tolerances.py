"""The tolerances of the solvers: integration, initial values, constraints. The page on trust shows them."""

from __future__ import annotations

from dataclasses import dataclass

from daest.model.thresholds import JUDGEMENT, ROUNDING, Thresholds, threshold


@dataclass(frozen=True)
class SolverTolerances(Thresholds):
    """The tolerances. `rows` tells of each what stands beside its value."""

    search_rtol: float = threshold(
        1e-6,
        "relative",
        "local error of a step of the integration in a fit; that of a whole stable run is of this size",
        JUDGEMENT,
    )
    simulation_rtol: float = threshold(
        1e-8, "relative", "local error of a step of the integration in a simulation", JUDGEMENT
    )
    cvode_rtol: float = threshold(
        1e-7,
        "relative",
        "local error of CVODE on an FMU in a fit: differences of runs must mean something",
        JUDGEMENT,
    )
    atol_of_scale: float = threshold(
        1e-2,
        "share",
        "of rtol times the nominal value of a state: its absolute tolerance",
        JUDGEMENT,
    )
    projected_step: float = threshold(
        1e-3,
        "absolute tolerances",
        "that a step onto the constraints of a model is long, when their projection ends",
        JUDGEMENT,
    )
    projected_to_rounding: float = threshold(
        1e-13,
        "nominal values",
        "that a step onto the constraints of a model is long, when that of single samples ends",
        ROUNDING,
    )
    equal_steps: float = threshold(
        1e-9, "relative", "difference of sample intervals within which they are one length", ROUNDING
    )
    initial_condition: float = threshold(
        1e-9, "relative", "error of a condition on the start, to the size of its terms (floor 1)", ROUNDING
    )
    independent_conditions: float = threshold(
        1e-10,
        "singular value",
        "of conditions on the start with rows scaled to 1, above which they are independent",
        ROUNDING,
    )


SOLVER = SolverTolerances()
