"""GivenForm: what a model without equations offers instead of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np

if TYPE_CHECKING:
    from daest.model.explicit import ExplicitModel
    from daest.model.flat import FlatModel
    from daest.model.linear import LinearDAE, StateSpaceFamily


class GivenForm(Protocol):
    """The form in which a model is given from outside, such as the binary of an FMU.

    Its `FlatModel` has names, units and values, and NaN for every residual: each step that would take its
    functions from the equations asks here. `hides_states`: only simulations can be had.
    """

    hides_states: bool

    @property
    def may_jump(self) -> bool:
        """Answers may depend on more than time, states and inputs: on discrete variables that events have
        changed, or on steps that it has heard of."""

    @property
    def method(self) -> str:
        """How simulations are computed."""

    @property
    def is_affine(self) -> bool: ...

    def has_affine_dynamics(self, flat: FlatModel) -> bool:
        """Rates and outputs are affine, whatever the other variables are."""

    def with_noises(self, flat: FlatModel, noises: Mapping[str, float | None]) -> FlatModel:
        """The model with white noise of the given intensities at its places, by name."""

    def explicit(self, flat: FlatModel) -> ExplicitModel: ...

    def linearize(self, flat: FlatModel, theta: np.ndarray, at: Mapping[str, float] | None) -> LinearDAE: ...

    def family(self, flat: FlatModel, at: Mapping[str, float] | None) -> StateSpaceFamily: ...

    def start(
        self, flat: FlatModel, theta: np.ndarray, u: np.ndarray, time: float, given: Mapping[str, float]
    ) -> np.ndarray:
        """Initial states (n_states,)."""

    def integrate(
        self, flat: FlatModel, names: tuple[str, ...], drive: Any, options: Mapping[str, Any]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """States, outputs and sensitivities as in `systems.integrate.Trajectory`."""

    def variables_along(
        self,
        flat: FlatModel,
        time: np.ndarray,
        ubar: np.ndarray,
        theta: np.ndarray,
        states: np.ndarray,
        hold: Literal["zoh", "foh"],
    ) -> np.ndarray:
        """All internal variables (n_samples, n) along states (n_samples, n_states)."""

    def raise_failure(self) -> None:
        """Raise the error that a CasADi function of `explicit` met; its value was NaN."""

    def local_functions(self, flat: FlatModel) -> tuple[Any, Any]:
        """`flow` and `see` of `systems.local_linear.LocalModel`."""
