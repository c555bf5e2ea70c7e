"""An FMU without equations as a `Model`, and its answers to what models are asked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from daest.errors import EstimationError
from daest.fmu import words
from daest.fmu.binary_form import BinaryForm
from daest.fmu.binary_functions import model_function, raise_failure
from daest.fmu.semi_explicit import linearize_semi_explicit, refuse_hidden
from daest.model.flat import Dynamics, Model
from daest.model.holds import Hold
from daest.model.linear import LinearDAE, StateSpaceFamily
from daest.model.parts import NoiseInput
from daest.modelica.change import with_noises
from daest.systems.events.integration import Run, Trajectory
from daest.systems.linear.linearize import has_affine_dynamics, is_affine_model, linearize
from daest.systems.linear.state_space import family_along
from daest.systems.reduction.initialize import initial_point, start_arguments
from daest.systems.reduction.reduce import dynamics
from daest.systems.simulation.integrate import Integrator, integrator
from daest.systems.simulation.local_linear import LocalModel, local_model
from daest.systems.simulation.simulate import values_along


@dataclass(frozen=True, kw_only=True)
class BinaryModel(Model):
    """Names, units, start values and parameter values of an FMU; `form` asks its binary."""

    form: BinaryForm

    def refuse_hidden_states(self, what: str) -> None:
        refuse_hidden(self.form.model, what)


@dataclass(frozen=True, kw_only=True)
class BinaryDynamics(Dynamics):
    """An FMU as ẋ = f with CasADi functions that ask the binary; derivatives with respect to θ are not among
    them."""

    flat: BinaryModel

    @property
    def may_jump(self) -> bool:
        return self.flat.form.may_jump

    @property
    def check_if_stopped(self) -> str:
        if not self.flat.form.hides_states:
            return ""
        return "; an FMU that steps by itself may want samples at multiples of its own step: --resample"

    def raise_failure(self) -> None:
        raise_failure()


@dataclass(frozen=True)
class BinaryIntegrator(Integrator):
    """By the compiled integrator where the FMU has no events, else (or where that gives up) by CVODE."""

    explicit: BinaryDynamics
    names: tuple[str, ...]

    def trajectory(self, run: Run) -> Trajectory:
        flat = self.explicit.flat
        with_states = self.explicit.outputs.numel_out(0) > len(flat.outputs)
        return Trajectory(*flat.form.integrate(flat, self.names, run, with_states), n_steps=0)

    def method(self, rtol: float, hold: Hold) -> str:
        return f"{self.explicit.flat.form.method}, {hold}"


def binary_model(path: str | Path) -> BinaryModel:
    """The FMU at `path` as a model. Errors as `fmu.load.load_fmu` and `semi_explicit_form`."""
    form = BinaryForm(path)
    fmu = form.model
    unknowns = (*form.form.states, *form.form.variables)
    inputs, _, noises = words.inputs_and_noises(fmu)
    inner = [fmu.variables[vr] for vr in unknowns]
    return BinaryModel(
        name=fmu.model_name or fmu.path.stem,
        equations=words.explicit_equations(inner, len(form.form.states)),
        **words.declared(fmu, unknowns, inputs, noises, form.form.outputs, form.parameter_starts().tolist()),
        source=str(fmu.path),
        form=form,
    )


@with_noises.register
def _with_noises(model: BinaryModel, noises: Mapping[str, float | None]) -> BinaryModel:
    """White noise enters at inputs and at state derivatives, called by the name of the state. ModelError
    `noise-place-unknown`."""
    units = {v.name: v.unit for v in model.inputs}
    present = {w.name: w for w in model.noises}
    for name, intensity in noises.items():
        known = present.get(name) or NoiseInput(name, unit=units.get(name, ""), estimate=intensity is None)
        present[name] = replace(known, intensity=intensity)
    changed = replace(model, noises=tuple(present.values()))
    model.form.noise_places(changed)
    return changed


@is_affine_model.register
def _is_affine(model: BinaryModel) -> bool:
    return model.form.is_affine


@linearize.register
def _linearized(
    model: BinaryModel, theta: np.ndarray | None = None, at: Mapping[str, float] | None = None
) -> LinearDAE:
    dae = linearize_semi_explicit(model.form.model, model.checked_theta(theta), at, allow_directional=True)
    return replace(dae, parameters=model.parameters)


@dynamics.register
def _dynamics(model: BinaryModel) -> BinaryDynamics:
    form = model.form
    sizes = form.sizes(model)
    n_x = len(form.form.states)
    outputs = np.array(form.output_rows(model), dtype=int)
    n_inner = len(model.unknowns)
    names = tuple(v.name for v in model.unknowns[:n_x])
    nothing = np.full(n_inner - n_x, np.nan)

    def values(*arguments: np.ndarray) -> np.ndarray:
        return form.with_noise(model, *arguments)

    def slopes(*arguments: np.ndarray) -> tuple[np.ndarray, ...]:
        return form.blocks(model, *arguments)

    # The rates stand first, then the variables; unknowns are the states themselves, then the variables.
    def unknowns(*arguments: np.ndarray) -> np.ndarray:
        return np.concatenate([arguments[0], values(*arguments)[n_x:]])

    def unknown_slopes(*arguments: np.ndarray) -> list[np.ndarray]:
        return [_with_identity(block[n_x:], i, n_x) for i, block in enumerate(slopes(*arguments))]

    return BinaryDynamics(
        flat=model,
        state_names=names,
        state_units=tuple(v.unit for v in model.unknowns[:n_x]),
        input_derivatives=form.input_derivatives(model),
        rhs=model_function(
            "rhs", sizes, n_x, lambda *a: values(*a)[:n_x], lambda *a: [b[:n_x] for b in slopes(*a)]
        ),
        variables=model_function("variables", sizes, n_inner, unknowns, unknown_slopes),
        variable_derivatives=model_function(
            "variable_derivatives", sizes, n_inner,
            lambda *a: np.concatenate([values(*a)[:n_x], nothing]), None,
        ),
        outputs=model_function(
            "outputs", sizes, outputs.size,
            lambda *a: unknowns(*a)[outputs], lambda *a: [b[outputs] for b in unknown_slopes(*a)],
        ),
        is_symbolic=False,
    )  # fmt: skip


def _with_identity(block: np.ndarray, argument: int, n_x: int) -> np.ndarray:
    """Rows of the states themselves before those of the variables."""
    own = np.eye(n_x) if argument == 0 else np.zeros((n_x, block.shape[1]))
    return np.vstack([own, block])


@has_affine_dynamics.register
def _has_affine_dynamics(explicit: BinaryDynamics) -> bool:
    return explicit.flat.form.has_affine_dynamics(explicit.flat)


@family_along.register
def _family(explicit: BinaryDynamics, at: Mapping[str, float] | None = None) -> StateSpaceFamily:
    return explicit.flat.form.family(explicit, at)


@initial_point.register
def _initial_point(
    explicit: BinaryDynamics,
    theta: np.ndarray | None = None,
    u0: np.ndarray | None = None,
    v0: np.ndarray | None = None,
    t0: float = 0.0,
    given: Mapping[str, float] | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """After the FMU's own initialisation."""
    u, v, _, values, _ = start_arguments(explicit, theta, u0, v0, t0)
    ubar, form = np.concatenate([u, v]), explicit.flat.form
    x = form.start(explicit.flat, values, ubar, t0, given or {})
    return x, form.variables_along(explicit.flat, np.array([t0]), ubar[None], values, x[None], "zoh")[0]


@integrator.register
def _integrator(
    explicit: BinaryDynamics, names: Sequence[str] = (), *, compiled: bool = True, runs_once: bool = False
) -> Integrator:
    explicit.flat.parameter_columns(names)  # refuses others
    return BinaryIntegrator(explicit, tuple(names))


@values_along.register
def _values_along(
    explicit: BinaryDynamics,
    time: np.ndarray,
    ubar: np.ndarray,
    theta: np.ndarray,
    states: np.ndarray,
    hold: Hold,
    w: np.ndarray | None = None,
    tears: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Outputs of an FMU are variables. Noise that reaches them directly is left out."""
    model = explicit.flat
    variables = model.form.variables_along(model, time, ubar, theta, states, hold)
    return variables[:, model.form.output_rows(model)], variables


@local_model.register
def _local_model(
    explicit: BinaryDynamics,
    names: Sequence[str] = (),
    *,
    tangents: bool = False,
    inside: bool = False,
    compiled: bool = True,
) -> LocalModel:
    """An FMU has slopes at points, and no more: `flow` and `see` are functions of numbers."""
    if tangents or inside:
        raise EstimationError(
            "given-form-without-tangents",
            f"{explicit.flat.name} has no equations, and a particle filter or a likelihood by the extended "
            "Kalman filter needs them",
            remedy="use --kind ekf or ukf; identify with --method oe, or --method pem and its observer",
        )
    flow, see = explicit.flat.form.local_functions(explicit.flat)
    return LocalModel(explicit, (), flow, see, None, None, None, None, None, library=None)
