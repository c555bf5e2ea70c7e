"""An FMU without equations as a model: its functions are asked of the binary, in its own process."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from daest.errors import FmuError, ModelError
from daest.fmu import words
from daest.fmu.binary_functions import PointFunction, parameter_function, raise_failure
from daest.fmu.description import base_and_order
from daest.fmu.drive import Drive, Law, law_table
from daest.fmu.engine import Followed, Plan, engine_library
from daest.fmu.load import load_fmu
from daest.fmu.points import DIFFERENCE_FLOOR, central_differences, difference, long_points, moved_points
from daest.fmu.runner import Points, Runner, Simulated, refused
from daest.fmu.semi_explicit import (
    TRUST,
    SemiExplicitForm,
    is_affine_there,
    jacobians,
    refuse_hidden,
    semi_explicit_form,
)
from daest.model.flat import Dynamics, InputDerivative, Model
from daest.model.fmu import FmuModel
from daest.model.holds import Hold, interval_ends
from daest.model.linear import StateSpaceFamily
from daest.systems.events.integration import IntegrationError, Run
from daest.systems.linear.state_space import family_of
from daest.systems.simulation.integrate import search_steps
from daest.systems.tolerances import SOLVER

# Relative step of the differences of simulations: far above the error of the integrator, far
# below what bends.
SIMULATION_STEP = 1e-3
# Relative step of the differences of matrices in the parameters.
PARAMETER_STEP = 1e-5
# Steps, and the first and last time [s] of them, after which an FMU that remembers steps answers otherwise.
HEARD_STEPS, HEARD_TIMES = 64, (1e-3, 1e4)
# States that differ by less than this share of their range are those of one simulation.
SAME_STATES = 1e-4
TINY = float(np.finfo(float).tiny)


@dataclass(frozen=True)
class Slopes:
    """(ẋ, z) at a point with its derivatives: values (n,), by_x (n, n_x), by_drivers (n, n_d), by_time (n,);
    n = n_x + n_z. First axes may be added (sets of parameters, points)."""

    values: np.ndarray
    by_x: np.ndarray
    by_drivers: np.ndarray
    by_time: np.ndarray


# States (n, n_x), outputs (n, n_y), sensitivities (n, n_y, directions).
Integrated = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True)
class _Task:
    """What is integrated: theta, x0, rtol and atol (n_states,), `columns` are the parameters that slopes are
    wanted for, `size_steps` (n_laws,) small changes of the sizes of laws, `scale` (n_states,) the sizes of
    the states."""

    flat: Model
    columns: tuple[int, ...]
    theta: np.ndarray
    x0: np.ndarray
    rtol: float
    atol: np.ndarray
    scale: np.ndarray
    has_slopes: bool
    size_steps: np.ndarray
    insists: bool  # where the compiled integrator gives up, CVODE tries


class BinaryForm:
    """The functions of an FMU, asked of its binary. Its process starts with the first question, and stays."""

    def __init__(self, path: str | Path) -> None:
        self.model: FmuModel = load_fmu(path)
        self.hides_states = self.model.kind == "co-simulation"
        self.form: SemiExplicitForm = semi_explicit_form(self.model)
        self._runner: Runner | None = None
        self._method = "CVODE (BDF)"  # of the last integration
        self._last_slopes: tuple[tuple, Slopes] | None = None
        self._affine_rows: dict[tuple[int, ...], bool] = {}  # answers of `has_affine_dynamics`
        self._columns = {
            name: i
            for i, vr in enumerate((*self.form.states, *self.form.variables))
            for name in (self.model.variables[vr].name, *self.model.variables[vr].aliases)
        }

    def __reduce__(self) -> tuple:
        return BinaryForm, (self.model.path,)

    @property
    def runner(self) -> Runner:
        raise_failure()
        if self._runner is None:
            self._runner = Runner(self.model)
        return self._runner

    def parameter_starts(self) -> np.ndarray:
        """Start values; what the description leaves out is asked of the FMU itself. Shapes: (n_theta,)."""
        starts = np.array(
            [np.nan if (s := self.model.variables[vr].start) is None else s for vr in self.model.parameters]
        )
        unknown = [vr for vr, start in zip(self.model.parameters, starts, strict=True) if np.isnan(start)]
        if unknown:
            nowhere = Points((), np.zeros((1, 0)), np.zeros((1, 0)), np.zeros(1))
            found = self.runner.evaluate(nowhere, unknown)
            starts[np.isnan(starts)] = np.nan_to_num(found.values[0, 0])
        return starts

    @property
    def method(self) -> str:
        return "the FMU's own steps" if self.hides_states else f"{self._method} on the FMU"

    @cached_property
    def is_affine(self) -> bool:
        """ẋ and all variables are affine in states and inputs, and do not depend on time."""
        if self.hides_states or self.model.n_event_indicators:
            return False
        return is_affine_there(self.runner, self.form, ((), np.zeros((1, 0)))) and not self._remembers_steps

    def has_affine_dynamics(self, flat: Model) -> bool:
        """ẋ and the outputs are affine, whatever the other variables are."""
        if self.is_affine or self.hides_states or self.model.n_event_indicators:
            return self.is_affine
        n_x = len(self.form.states)
        rows = (*range(n_x), *sorted({row for row in self.output_rows(flat) if row >= n_x}))
        if rows not in self._affine_rows:
            found = is_affine_there(self.runner, self.form, ((), np.zeros((1, 0))), rows)
            self._affine_rows[rows] = found and not self._remembers_steps
        return self._affine_rows[rows]

    @cached_property
    def _remembers_steps(self) -> bool:
        """What the FMU answers depends on completed steps, as in a delay. Asked of models that can be
        evaluated everywhere, along arbitrary steps over short and long times."""
        if not self.model.reports_steps:
            return False
        random = np.random.default_rng(0)
        x, u = (random.standard_normal((HEARD_STEPS, len(n))) for n in (self.form.states, self.form.drivers))
        points = Points(self.form.drivers, u, x, np.geomspace(*HEARD_TIMES, HEARD_STEPS))
        try:
            return self.runner.hears_steps(points, self.form.variables)
        except FmuError:
            return True

    @cached_property
    def may_jump(self) -> bool:
        """What the FMU answers may depend on more than time, states and inputs: on discrete variables that
        events have changed, or on steps that it has heard of."""
        if self.is_affine or self.hides_states:
            return False
        nowhere = Points((), np.zeros((1, 0)), np.zeros((1, 0)), np.zeros(1))
        has_events = self.model.n_event_indicators > 0 or self.model.reports_steps
        return has_events or self.runner.evaluate(nowhere, ()).has_time_events

    @cached_property
    def trusts_directional(self) -> bool:
        """The FMU declares directional derivatives, has them of all variables, and they agree with
        differences at its start."""
        if not self.model.provides_directional_derivatives or self.hides_states:
            return False
        x = self._start_states(self.parameter_starts(), np.zeros(len(self.form.drivers)), 0.0)
        none = ((), np.zeros((1, 0)))
        found, _ = jacobians(self.runner, self.form, x, np.zeros(len(self.form.drivers)), True, none)
        if found.directional is None or not found.is_complete:
            return False
        return difference([found.directional], [found.differences], DIFFERENCE_FLOOR) <= TRUST

    def family(self, explicit: Dynamics, at: Mapping[str, float] | None) -> StateSpaceFamily:
        """Matrices by differences of the binary, and their derivatives by differences in θ. All NaN, without
        states, for Co-Simulation: names and noises are known, and no filter can be made of it."""
        flat = explicit.flat
        x, u = self._point(flat, at)

        def matrices(theta: np.ndarray) -> list[np.ndarray]:
            return self._matrices(flat, theta[None], x, u)[0]

        def derivatives(theta: np.ndarray, columns: tuple[int, ...]) -> list[np.ndarray]:
            """∂M/∂θ_i for every matrix, (n_columns, *shape)."""
            sets, steps = self._moved_parameters(flat, theta, columns, PARAMETER_STEP)
            found = self._matrices(flat, sets, x, u)
            up, down = found[0::2], found[1::2]
            return [
                np.array([(a[k] - b[k]) / (2 * h) for a, b, h in zip(up, down, steps, strict=True)])
                for k in range(len(found[0]))
            ]

        shapes = [m.shape for m in self._matrices(flat, flat.theta_values[None], x, u)[0]]
        function = parameter_function(len(flat.parameters), shapes, matrices)
        return family_of(explicit, function, self.has_affine_dynamics(flat), derivatives)

    def start(
        self, flat: Model, theta: np.ndarray, u: np.ndarray, time: float, given: Mapping[str, float]
    ) -> np.ndarray:
        """States (n_states,) after the initialisation of the FMU at theta (n_theta,) and u (n_u,), at the
        time [s]; `given` ones by name in their place."""
        names = [v.name for v in flat.unknowns[: len(self.form.states)]]
        unknown = [name for name in given if name not in names]
        if unknown:
            raise ModelError(
                "unknown-variable",
                f"the FMU has no state {unknown[0]} to start",
                remedy=f"its states are {', '.join(names)}" if names else "it shows no states",
            )
        drivers = np.zeros(len(self.form.drivers))
        drivers[: u.size] = u
        x = self._start_states(theta, drivers, time)
        return np.array([given.get(name, value) for name, value in zip(names, x, strict=True)])

    def integrate(
        self, flat: Model, names: Sequence[str], run: Run, with_states: bool = False,
        laws: tuple[Law, ...] = (), size_steps: np.ndarray | None = None,
    ) -> Integrated:  # fmt: skip
        """By the compiled integrator where the FMU has no events, else (or where that gives up) by CVODE.
        `with_states` puts the states behind the outputs. The slopes are those by the parameters `names`, by
        the sizes of the `laws`, with small changes `size_steps` (n_laws,), and by the initial states. Raises
        IntegrationError, at once where a law makes the model run away."""
        columns = tuple(flat.parameter_columns(names)) if run.directions else ()
        steps = np.zeros(len(laws)) if size_steps is None else size_steps
        task = _Task(
            flat, columns, run.theta, run.x0, run.rtol, run.atol, run.scale,
            run.directions > 0, steps, not laws,
        )  # fmt: skip
        references = (*self.form.states, *self.form.variables)
        read = [references[row] for row in self.output_rows(flat)]
        read += self.form.states if with_states else ()
        request = replace(self.drive(run.time, run.u0, run.u1, run.u_last, read), laws=laws, bent=run.bent)
        if run.correction is not None:
            request = replace(request, measurements=run.correction.measurements, gain=run.correction.gain)
        return self._integrated(task, request)

    def _integrated(self, task: _Task, request: Drive) -> Integrated:
        is_possible = self._has_no_events and not (self.model.only_once and task.has_slopes)
        if is_possible and request.time.size > 1:
            found = self._followed(task, request)
            if found is not None:
                self._method = f"Radau IIA order 5, rtol {task.rtol:g}"
                return found
        self._method = f"CVODE (BDF), rtol {min(task.rtol, SOLVER.cvode_rtol):g}"
        return self._simulated_apart(task, request)

    @property
    def _has_no_events(self) -> bool:
        return not (self.hides_states or self.model.n_event_indicators) and bool(self.form.states)

    def _followed(self, task: _Task, request: Drive) -> Integrated | None:
        """With the slopes of the computed solution, from differences at its points."""
        sets, steps = self._moved_parameters(task.flat, task.theta, task.columns, PARAMETER_STEP)
        sizes, size_steps = _moved_sizes(task, request)
        sets = np.vstack([task.theta[None], sets, np.repeat(task.theta[None], len(sizes), axis=0)])
        still = np.tile([law.size for law in request.laws], (1 + 2 * steps.size, 1))
        request = replace(request, rtol=task.rtol)
        plan = self._plan(task, request, np.concatenate([steps, size_steps]), np.vstack([still, sizes]))
        found = plan and self.runner.follow(request, self._parameters(sets), task.x0, plan)
        if found == "gave up" and not task.insists:
            raise IntegrationError(
                "the model moves much faster than the record, or is not smooth", float(request.time[0])
            )
        return (found.states, found.values, found.slopes) if isinstance(found, Followed) else None

    def _simulated_apart(self, task: _Task, request: Drive) -> Integrated:
        """By CVODE, with central differences of whole simulations, all in one request."""
        request = replace(request, rtol=min(task.rtol, SOLVER.cvode_rtol))
        theta, x0 = task.theta, task.x0
        own = np.array([law.size for law in request.laws])
        if not task.has_slopes:
            return _with_differences(self.simulated(request, theta[None], x0[None]), np.zeros(0))
        moved, steps = self._moved_parameters(task.flat, theta, task.columns, SIMULATION_STEP)
        sizes, size_steps = _moved_sizes(task, request)
        turned, more = _moved_states(x0, task.scale, SIMULATION_STEP)
        n, after = 1 + len(moved), len(sizes) + len(turned)
        sets = np.vstack([theta[None], moved, np.repeat(theta[None], after, axis=0)])
        starts = np.vstack([np.repeat(x0[None], n + len(sizes), axis=0), turned])
        all_sizes = np.vstack([np.tile(own, (n, 1)), sizes, np.tile(own, (len(turned), 1))])
        found = self.simulated(request, sets, starts, all_sizes)
        return _with_differences(found, np.concatenate([steps, size_steps, more]))

    def _plan(self, task: _Task, request: Drive, steps: np.ndarray, law_sizes: np.ndarray) -> Plan | None:
        fmi, n_x = int(self.model.fmi_version[0]), len(self.form.states)
        library = engine_library(
            fmi, n_x, len(request.inputs), steps.size, len(request.read), request.u_last.size,
            len(request.laws),
        )  # fmt: skip
        if library is None:
            return None
        most = search_steps(request.time.size)
        scale = np.abs(task.scale)
        return Plan(
            str(library), steps, scale, task.atol, most, task.has_slopes, law_table(request.laws), law_sizes
        )

    def variables_along(
        self,
        flat: Model,
        time: np.ndarray,
        ubar: np.ndarray,
        theta: np.ndarray,
        states: np.ndarray,
        hold: Hold,
    ) -> np.ndarray:
        """States and read variables (n_samples, n) along states (n_samples, n_states) under ubar
        (n_samples, n_ū) at the times (n_samples,) [s]."""
        n_u = len(flat.inputs)
        names = flat.input_names
        ends = np.hstack([interval_ends(ubar[:, :n_u], hold, names), ubar[:-1, n_u:]])
        request = self.drive(time, ubar[:-1], ends, ubar[-1], self.form.variables)
        if self.hides_states:
            return self.simulated(request, theta[None], None).values[0]
        if self.may_jump:
            again = self.simulated(request, theta[None], states[:1])
            if np.all(np.abs(again.states[0] - states) <= SAME_STATES * np.ptp(states, axis=0) + TINY):
                return np.hstack([states, again.values[0]])
        drivers = np.zeros((time.size, len(self.form.drivers)))
        drivers[:, : ubar.shape[1]] = ubar
        points = Points(self.form.drivers, drivers, states, time)
        found = self.runner.evaluate(
            points, self.form.variables, self._parameters(theta[None]),
            settle="each" if self.model.n_event_indicators else False,
        )  # fmt: skip
        return np.hstack([states, found.values[0]])

    def local_functions(self, flat: Model) -> tuple[Any, Any]:
        refuse_hidden(self.model, "filter")
        n_x = len(self.form.states)
        rows = np.array(self.output_rows(flat), dtype=int)
        n_w = len(flat.noises)

        def flow(
            x: np.ndarray,
            ubar: np.ndarray,
            slope: np.ndarray,
            theta: np.ndarray,
            t: np.ndarray,
            *_: np.ndarray,
        ) -> list:
            # Of first order: f is not averaged over the covariance, which comes last.
            found = self._slopes(theta, x, ubar, float(t[0]))
            ramp = found.by_drivers[:n_x, : ubar.size] @ slope + found.by_time[:n_x]
            by_w = self._by_noise(flat, found.by_drivers)[:n_x]
            return [found.values[:n_x], found.by_x[:n_x].ravel(), ramp, by_w.reshape(n_x * n_w)]

        def see(x: np.ndarray, ubar: np.ndarray, theta: np.ndarray, t: np.ndarray) -> list:
            found = self._slopes(theta, x, ubar, float(t[0]))
            values = np.concatenate([x, found.values[n_x:]])[rows]
            by_x = np.vstack([np.eye(n_x), found.by_x[n_x:]])[rows]
            return [values, by_x.ravel()]

        return PointFunction(flow), PointFunction(see)

    # ---------------------------------------------------------------------------------------- pieces

    def sizes(self, flat: Model) -> tuple[int, ...]:
        n_v = len(self.input_derivatives(flat))
        return (len(self.form.states), len(flat.inputs), n_v, len(flat.noises), len(flat.parameters), 1)

    def input_derivatives(self, flat: Model) -> tuple[InputDerivative, ...]:
        """Inputs of the FMU that are derivatives of others, in the order of its references."""
        names = flat.input_names
        _, rates, _ = words.inputs_and_noises(self.model)
        found = []
        for reference in rates:
            base, order = base_and_order(self.model.variables[reference].name)
            found.append(InputDerivative(names.index(base), order))
        return tuple(found)

    def output_rows(self, flat: Model) -> list[int]:
        """Positions of the outputs among states and variables. ModelError `output-unknown`."""
        missing = [o.name for o in flat.outputs if o.name not in self._columns]
        if missing:
            raise ModelError(
                "output-unknown",
                f"the FMU has no variable {missing[0]}",
                where=str(self.model.path),
                remedy="name an output or a continuous variable of the FMU",
            )
        return [self._columns[o.name] for o in flat.outputs]

    def _parameters(self, sets: np.ndarray) -> tuple[tuple[int, ...], np.ndarray]:
        """The parameters that differ anywhere from the FMU's own start values, and their values."""
        starts = np.array(
            [np.nan if (s := self.model.variables[vr].start) is None else s for vr in self.model.parameters]
        )
        sets = np.asarray(sets, dtype=float).reshape(len(sets), starts.size)
        chosen = np.flatnonzero(np.any(sets != starts, axis=0))
        return tuple(self.model.parameters[i] for i in chosen), sets[:, chosen]

    def _start_states(self, theta: np.ndarray, drivers: np.ndarray, time: float) -> np.ndarray:
        """States after the FMU's own initialisation."""
        n_x = len(self.form.states)
        if not n_x:
            return np.zeros(0)
        none = np.zeros((0, drivers.size))
        drive = Drive(np.array([time]), self.form.drivers, none, none, drivers, ())
        found = self.runner.simulate(drive, self._parameters(theta[None]))
        if found.stopped is not None:
            raise refused(self.model, found.stopped.reason)
        return found.states[0, 0]

    def drive(
        self, time: np.ndarray, u0: np.ndarray, u1: np.ndarray, u_last: np.ndarray, read: Sequence[int]
    ) -> Drive:
        """Inputs u0 and u1 (n_samples - 1, n_u) at both ends of the intervals of time (n_samples,) [s],
        u_last (n_u,), and what is to be read."""
        inputs = self.form.inputs
        return Drive(time, inputs, u0, u1, np.ravel(u_last), tuple(read))

    def simulated(
        self,
        request: Drive,
        sets: np.ndarray,
        starts: np.ndarray | None,
        sizes: np.ndarray | None = None,
    ) -> Simulated:
        """Simulations at parameters (s, p) from starts (s, n_x), with sizes (s, n_laws) of the laws of
        the request. Raises IntegrationError."""
        starts = None if self.hides_states else starts
        found = self.runner.simulate(request, self._parameters(sets), starts, sizes)
        if found.stopped is not None:
            raise IntegrationError(found.stopped.reason, found.stopped.time)
        return found

    def _point(self, flat: Model, at: Mapping[str, float] | None) -> tuple[np.ndarray, np.ndarray]:
        """States and drivers that matrices are computed at: zero for an affine model."""
        drivers = np.zeros(len(self.form.drivers))
        if self.is_affine:
            return np.zeros(len(self.form.states)), drivers
        at = dict(at or {})
        for i, given in enumerate(flat.inputs):
            drivers[i] = at.get(given.name, given.start or 0.0)
        x = self._start_states(flat.theta_values, drivers, 0.0)
        names = [v.name for v in flat.unknowns[: x.size]]
        return np.array([at.get(n, value) for n, value in zip(names, x, strict=True)]), drivers

    def _moved_parameters(
        self, flat: Model, theta: np.ndarray, columns: Sequence[int], share: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Parameter values moved up and down, one after the other, (2 n_columns, p), and the steps."""
        sets, steps = [], []
        for column in columns:
            parameter = flat.parameters[column]
            size = max(abs(theta[column]), abs(parameter.nominal or 0.0)) or 1.0
            steps.append(share * size)
            for sign in (1.0, -1.0):
                moved = theta.copy()
                moved[column] += sign * steps[-1]
                sets.append(moved)
        return np.array(sets).reshape(len(sets), theta.size), np.array(steps)

    def _matrices(
        self, flat: Model, sets: np.ndarray, x: np.ndarray, drivers: np.ndarray
    ) -> list[list[np.ndarray]]:
        """A, B, G, b, C, D, H, d, X, U, W, x0 for every set of parameters."""
        n_x, rows = x.size, np.array(self.output_rows(flat), dtype=int)
        n_u = len(self.form.inputs)
        if self.hides_states:
            return [_unknown_matrices(flat, n_u) for _ in sets]
        all_slopes = self._slopes_of_sets(sets, x, drivers, self.has_affine_dynamics(flat))
        result = []
        for found in all_slopes:
            by_w = self._by_noise(flat, found.by_drivers)
            A, B, G = found.by_x[:n_x], found.by_drivers[:n_x, :n_u], by_w[:n_x]
            X = np.vstack([np.eye(n_x), found.by_x[n_x:]])
            U = np.vstack([np.zeros((n_x, n_u)), found.by_drivers[n_x:, :n_u]])
            W = np.vstack([np.zeros((n_x, by_w.shape[1])), by_w[n_x:]])
            inner = np.concatenate([x, found.values[n_x:]])
            b = found.values[:n_x] - A @ x - B @ drivers[:n_u]
            x0 = inner - X @ x - U @ drivers[:n_u]
            result.append(
                [A, B, G, b[:, None], X[rows], U[rows], W[rows], x0[rows][:, None], X, U, W, x0[:, None]]
            )
        return result

    def _slopes_of_sets(
        self, sets: np.ndarray, x: np.ndarray, drivers: np.ndarray, exact: bool
    ) -> list[Slopes]:
        """Slopes without time at one point for many sets of parameters, in one request. `exact`: over long
        steps, for an affine model."""
        point, n_x = np.concatenate([x, drivers]), x.size
        nominal = [self.model.variables[vr].nominal for vr in (*self.form.states, *self.form.drivers)]
        moved = (long_points if exact else moved_points)(point, nominal)
        rows = np.vstack([point, moved])
        values = self._rows(sets, rows[:, :n_x], rows[:, n_x:], np.zeros(len(rows)))
        slopes = []
        for table in values:
            jacobian = central_differences(moved, table[1:])
            slopes.append(Slopes(table[0], jacobian[:, :n_x], jacobian[:, n_x:], np.zeros(table.shape[1])))
        return slopes

    def _rows(self, sets: np.ndarray, x: np.ndarray, drivers: np.ndarray, time: np.ndarray) -> np.ndarray:
        """(ẋ, z) of every set at every point, (s, m, n_x + n_z). FmuError `fmu-call-failed`,
        `fmu-co-simulation-only`."""
        refuse_hidden(self.model, "function of its states")
        found = self.runner.evaluate(
            Points(self.form.drivers, drivers, x, time), self.form.variables, self._parameters(sets),
            rates=True, settle=self.model.n_event_indicators > 0,
        )  # fmt: skip
        if found.problem is not None and not np.all(np.isfinite(found.values)):
            raise refused(self.model, found.problem)
        n_z = len(self.form.variables)
        return np.concatenate([found.values[:, :, n_z:], found.values[:, :, :n_z]], axis=2)

    def _slopes(self, theta: np.ndarray, x: np.ndarray, ubar: np.ndarray, time: float) -> Slopes:
        """Values and slopes at one point, time included. The last answer is kept: a filter asks for several
        functions at the same point."""
        key = (theta.tobytes(), x.tobytes(), ubar.tobytes(), time)
        if self._last_slopes is None or self._last_slopes[0] != key:
            self._last_slopes = key, self._slopes_asked(theta, x, ubar, time)
        return self._last_slopes[1]

    def _slopes_asked(self, theta: np.ndarray, x: np.ndarray, ubar: np.ndarray, time: float) -> Slopes:
        """In one request for the values and, where the FMU has them, one for its derivatives."""
        drivers = np.zeros(len(self.form.drivers))
        drivers[: ubar.size] = ubar
        point = np.concatenate([x, drivers, [time]])
        references = (*self.form.states, *self.form.drivers)
        nominal = [self.model.variables[vr].nominal for vr in references]
        n_x, n = x.size, point.size
        directional = self.trusts_directional
        moved = moved_points(point, [*nominal, 1.0])
        moved = moved[-2:] if directional else moved
        rows = np.vstack([point, moved])
        values = self._rows(theta[None], rows[:, :n_x], rows[:, n_x : n - 1], rows[:, -1])[0]
        if not directional:
            jacobian = central_differences(moved, values[1:])
            return Slopes(values[0], jacobian[:, :n_x], jacobian[:, n_x:-1], jacobian[:, -1])
        by_time = (values[1] - values[2]) / (rows[1, -1] - rows[2, -1])
        jacobian = self.runner.differentiate(
            Points(self.form.drivers, drivers[None], x[None], np.array([time])),
            (*self.form.rates, *self.form.variables), references, self._parameters(theta[None]),
        )[0, 0]  # fmt: skip
        return Slopes(values[0], jacobian[:, :n_x], jacobian[:, n_x:], by_time)

    def noise_places(self, flat: Model) -> list[tuple[bool, int]]:
        """For every noise, whether it adds to a driver, and to which; else to which rate. ModelError
        `noise-place-unknown`."""
        drivers = {self.model.variables[vr].name: i for i, vr in enumerate(self.form.drivers)}
        states = {v.name: i for i, v in enumerate(flat.unknowns[: len(self.form.states)])}
        places = []
        for noise in flat.noises:
            name = noise.name.removeprefix("der(").removesuffix(")")
            if noise.name in drivers:
                places.append((True, drivers[noise.name]))
            elif name in states:
                places.append((False, states[name]))
            else:
                raise _no_noise_place(noise.name, [*drivers, *(f"der({s})" for s in states)], self.model)
        return places

    def _by_noise(self, flat: Model, by_drivers: np.ndarray) -> np.ndarray:
        """∂(ẋ, z)/∂w (n, n_w)."""
        columns = np.zeros((by_drivers.shape[0], len(flat.noises)))
        for k, (is_driver, i) in enumerate(self.noise_places(flat)):
            if is_driver:
                columns[:, k] = by_drivers[:, i]
            else:
                columns[i, k] = 1.0
        return columns

    def with_noise(
        self, flat: Model, x: np.ndarray, u: np.ndarray, v: np.ndarray, w: np.ndarray,
        theta: np.ndarray, time: np.ndarray,
    ) -> np.ndarray:  # fmt: skip
        """Rates and read variables (n,) at the states x (n_states,), inputs u (n_u,), their derivatives v
        (n_v,) and noises w (n_w,)."""
        drivers = np.zeros(len(self.form.drivers))
        drivers[: u.size + v.size] = np.concatenate([u, v])
        added = np.zeros(len(self.form.states))
        for (is_driver, i), value in zip(self.noise_places(flat), w, strict=True):
            (drivers if is_driver else added)[i] += value
        row = self._rows(theta[None], x[None], drivers[None], np.ravel(time))[0, 0]
        row[: x.size] += added
        return row

    def blocks(
        self, flat: Model, x: np.ndarray, u: np.ndarray, v: np.ndarray, w: np.ndarray,
        theta: np.ndarray, time: np.ndarray,
    ) -> tuple[np.ndarray, ...]:  # fmt: skip
        """∂(ẋ, z)/∂(x, u, v, w, θ, t); that with respect to θ is not given, and zero."""
        found = self._slopes(theta, x, np.concatenate([u, v]), float(np.ravel(time)[0]))
        by_w = self._by_noise(flat, found.by_drivers)
        n = found.values.size
        by_u, by_v = found.by_drivers[:, : u.size], found.by_drivers[:, u.size : u.size + v.size]
        return found.by_x, by_u, by_v, by_w, np.zeros((n, theta.size)), found.by_time[:, None]


def _unknown_matrices(flat: Model, n_u: int) -> list[np.ndarray]:
    """A, B, G, b, C, D, H, d, X, U, W, x0 without states: NaN but for the noises, which enter nowhere."""
    n_w, n_y, n = len(flat.noises), len(flat.outputs), len(flat.unknowns)
    shapes = [(0, 0), (0, n_u), (0, n_w), (0, 1), (n_y, 0), (n_y, n_u), (n_y, n_w), (n_y, 1)]
    shapes += [(n, 0), (n, n_u), (n, n_w), (n, 1)]
    noise_columns = (2, 6, 10)
    return [np.zeros(s) if i in noise_columns else np.full(s, np.nan) for i, s in enumerate(shapes)]


def _with_differences(found: Simulated, steps: np.ndarray) -> Integrated:
    """The first solution, with central differences of the others, which were moved by `steps`."""
    values = found.values
    changes = (values[1::2] - values[2::2]) / (2 * steps)[:, None, None]
    return found.states[0], values[0], np.moveaxis(changes, 0, 2)


def _moved_sizes(task: _Task, request: Drive) -> tuple[np.ndarray, np.ndarray]:
    """Sizes of the laws moved up and down, one after the other, (2 n_laws, n_laws), and the steps; none
    without slopes."""
    n = len(request.laws)
    if not task.has_slopes:
        return np.zeros((0, n)), np.zeros(0)
    moves = np.repeat(np.diag(task.size_steps), 2, axis=0) * np.tile([[1.0], [-1.0]], (n, 1))
    return np.array([law.size for law in request.laws]).reshape(1, n) + moves, task.size_steps


def _moved_states(x0: np.ndarray, scale: np.ndarray | None, share: float) -> tuple[np.ndarray, np.ndarray]:
    sizes = np.ones(x0.size) if scale is None else np.abs(scale)
    steps = share * np.maximum(np.abs(x0), sizes)
    moved = np.repeat(x0[None], 2 * x0.size, axis=0)
    for i, step in enumerate(steps):
        moved[2 * i, i] += step
        moved[2 * i + 1, i] -= step
    return moved, steps


def _no_noise_place(name: str, places: Sequence[str], model: FmuModel) -> ModelError:
    return ModelError(
        "noise-place-unknown",
        f"`{name}` is no place for white noise in this FMU",
        where=str(model.path),
        remedy=f"white noise can enter at its inputs and state derivatives: {', '.join(places[:12])}",
    )
