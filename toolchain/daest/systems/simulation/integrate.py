"""Integration of an explicit model along a recording, with exact sensitivities of the computed solution.

The method is Radau IIA (order 5, L-stable). With a C compiler it runs as `radau.c`, compiled together with
the model's CasADi functions, with adaptive steps. Without one, CasADi's collocation integrator interprets the
same method with a fixed number of steps per sample interval: slower, and less exact where the model is stiff.
An affine model on a uniform time grid is sampled exactly instead (`affine_steps`), at a fraction of the work,
and so is a chain of states that the inputs alone drive, such as a dead time (`driven_chain`).
Between samples the inputs are held (zoh), run straight (foh) or on cubic curves (smooth).
"""

from __future__ import annotations

import ctypes
import functools
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, singledispatch
from typing import Any

import casadi as ca
import numpy as np

from daest.model.flat import Dynamics, ExplicitModel, events_refused
from daest.model.holds import SMOOTH, Hold, held_inputs, interval_ends, spline_slopes
from daest.model.linear import StateSpaceFamily
from daest.numerics.compiler import (
    FAST,
    MOST_LINES,
    build_object,
    build_shared,
    effort,
    if_compiler,
    pointer,
    processor_flags,
    text_of,
)
from daest.numerics.generated import generated
from daest.numerics.projection import pull
from daest.numerics.watched import watched
from daest.systems.events.event_functions import EventFunctions
from daest.systems.events.event_update import HybridError
from daest.systems.events.hybrid import Inputs, follow
from daest.systems.events.integration import (
    FAILURES,
    Correction,
    IntegrationError,
    Run,
    Trajectory,
    are_alike,
)
from daest.systems.linear.affine_steps import DrivenBy, Gain, Steps, affine_steps
from daest.systems.linear.linearize import has_affine_dynamics
from daest.systems.linear.state_space import family_without_variables, stacked_inputs
from daest.systems.linear.uneven_steps import uneven_steps
from daest.systems.reduction.input_slopes import refuse_derivatives
from daest.systems.simulation.chain_runs import RunsBesideChain, have_driven_chain
from daest.systems.simulation.driven_chain import DrivenChain, driven_chain, rest_functions
from daest.systems.simulation.sensor_laws import relative_slopes, sensor_laws
from daest.systems.simulation.trailing_chain import TrailingChain, trailing_chain
from daest.systems.simulation.trailing_runs import Tail, TrailingRuns, may_trail
from daest.systems.tolerances import SOLVER

# Steps over a whole record, however they fall between its samples. A search gives a trajectory up early: one
# that takes this many belongs to parameters that make the model far faster than the record.
SEARCH_STEPS, SEARCH_STEPS_PER_SAMPLE = 20_000, 50
ALL_STEPS = 2_000_000_000  # of a simulation, which stops where its end is out of reach
MOST_COMPILED = 32  # integrators that are kept for models with the same functions
INTERPRETED_STEPS = 4  # per sample interval, without a C compiler
# Of the integrator: its parts as functions of their own run as fast, compiled in three fifths of the time;
# without what a compiler joins and orders inside of them, they run 3 % faster, compiled in five sixths of
# that.
APART = (
    "-fno-inline-functions-called-once",
    "-fno-tree-slp-vectorize",
    "-fno-schedule-insns2",
    "-fno-gcse",
)


def search_steps(n_samples: int) -> int:
    """Steps after which a search gives up a trajectory of n samples."""
    return SEARCH_STEPS + SEARCH_STEPS_PER_SAMPLE * n_samples


class Integrator(ABC):
    """A model ready to be integrated: `names` are the parameters that sensitivities are computed for."""

    explicit: Dynamics
    names: tuple[str, ...]

    @property
    def is_compiled(self) -> bool:
        return True

    @property
    def n_directions(self) -> int:
        return len(self.names) + self.explicit.n_states

    @abstractmethod
    def trajectory(self, run: Run) -> Trajectory:
        """States, outputs and sensitivities of a prepared run."""

    def trajectories(self, runs: Sequence[Run]) -> list[Trajectory]:
        """Those of several runs. Raises IntegrationError for the first that fails."""
        return [self.trajectory(run) for run in runs]

    @abstractmethod
    def method(self, rtol: float, hold: Hold) -> str:
        """How trajectories are computed at this tolerance, for the reader."""


@dataclass(frozen=True)
class EquationIntegrator(Integrator):
    """Functions of a model with equations; one that has events is followed from event to event."""

    explicit: ExplicitModel
    names: tuple[str, ...]
    rhs: ca.Function  # (x, ū, theta, t) -> f, ∂f/∂x
    sens: ca.Function  # (x, ū, theta, t) -> ∂f/∂x, ∂f/∂θ_names
    out: ca.Function  # (x, ū, theta, t) -> h, ∂h/∂x, ∂h/∂θ_names
    library: ctypes.CDLL | None  # None: interpreted by CasADi
    hold: ca.Function | None = None  # (x, ū, theta, t) -> g, ∂g/∂x, ∂g/∂θ_names by rows: invariants g = 0
    events: tuple[EventFunctions, np.ndarray] | None = None  # with the owner of each root function
    bend: ca.Function | None = None  # (x, ū, theta, t) -> s, ∂s/∂x, ∂s/∂θ_names: see `sensor_laws`

    def __reduce__(self) -> tuple:
        # A library belongs to its process; another one loads it anew.
        return _again, (self.explicit, self.names, self.is_compiled)

    @property
    def is_compiled(self) -> bool:
        return self.library is not None

    def trajectory(self, run: Run) -> Trajectory:
        if self.events is not None:
            return _run_hybrid(self, run)
        return _run_interpreted(self, run) if self.library is None else _run_radau(self, [run])[0]

    def trajectories(self, runs: Sequence[Run]) -> list[Trajectory]:
        if self.events is not None or self.library is None or not are_alike(runs):
            return super().trajectories(runs)
        return _run_radau(self, runs)

    def method(self, rtol: float, hold: Hold) -> str:
        how = f"adaptive steps, rtol {rtol:g}" if self.is_compiled else "fixed steps"
        held = "" if self.explicit.invariants is None else ", projected on the constraints"
        return f"Radau IIA order 5, {how}, {hold}{held}"


@dataclass(frozen=True)
class ExactIntegrator(Integrator):
    """A model of which all or a part takes exact steps; `stepped` takes the runs that these do not serve."""

    explicit: ExplicitModel
    names: tuple[str, ...]

    def __reduce__(self) -> tuple:
        return _again, (self.explicit, self.names, True)

    @cached_property
    def stepped(self) -> EquationIntegrator:
        return _stepping(self.explicit, self.names, compiled=True, runs_once=False)


@dataclass(frozen=True)
class AffineIntegrator(ExactIntegrator):
    """A model with affine dynamics, by exact steps."""

    family: StateSpaceFamily

    def trajectory(self, run: Run) -> Trajectory:
        steps = _exact_steps(self, run) if _has_exact_steps(run) else None
        return self.stepped.trajectory(run) if steps is None else _run_exactly(steps, run)

    def method(self, rtol: float, hold: Hold) -> str:
        return f"exact steps of an affine model, {hold}"


@dataclass(frozen=True)
class ApartIntegrator(ExactIntegrator):
    """A model with a chain of states that takes exact steps; the functions of `beside` are those of the rest,
    for the parameters of `begun`, which begin with `names`."""

    beside: EquationIntegrator
    begun: tuple[str, ...]

    def trajectory(self, run: Run) -> Trajectory:
        return self.trajectories([run])[0]

    @property
    def columns(self) -> list[int]:
        """The positions of the parameters that the rest is integrated for."""
        return self.explicit.flat.parameter_columns(self.begun)


@dataclass(frozen=True)
class ChainIntegrator(ApartIntegrator):
    """A model with a chain of states that inputs alone drive."""

    chain: DrivenChain

    def trajectories(self, runs: Sequence[Run]) -> list[Trajectory]:
        if not are_alike(runs) or not have_driven_chain(self.chain, runs):
            return self.stepped.trajectories(runs)
        beside = RunsBesideChain(self.chain, runs, self.columns)
        return beside.joined(_run_radau(self.beside, beside.rests()))

    def method(self, rtol: float, hold: Hold) -> str:
        n = self.chain.members.size
        return f"exact steps of {n} states that inputs drive, {self.beside.method(rtol, hold)} for the others"


@dataclass(frozen=True)
class TrailingIntegrator(ApartIntegrator):
    """A model with a chain of states that nothing else feels."""

    chain: TrailingChain

    def trajectories(self, runs: Sequence[Run]) -> list[Trajectory]:
        if not are_alike(runs) or not may_trail(runs):
            return self.stepped.trajectories(runs)
        trailing = TrailingRuns(self.chain, runs, self.columns)
        return trailing.joined(_run_radau(self.beside, trailing.rests(), trailing.tail))

    def method(self, rtol: float, hold: Hold) -> str:
        n = self.chain.members.size
        return f"exact steps of {n} states behind the others, {self.beside.method(rtol, hold)} for these"


@singledispatch
def integrator(
    explicit: Dynamics,
    names: Sequence[str] = (),
    *,
    compiled: bool = True,
    runs_once: bool = False,
) -> Integrator:
    """Build the functions of `explicit` once; compile them if a C compiler is found, they are not too long
    for it and `compiled` is set, with less effort where they are wanted for one run (`runs_once`).

    The start, every sample and every corrected state are projected onto the invariants of the model, if it
    has any. Raises ModelError `unknown-parameter` for a name that is no parameter.
    """
    raise NotImplementedError(type(explicit).__name__)


@integrator.register
def _of_equations(
    explicit: ExplicitModel,
    names: Sequence[str] = (),
    *,
    compiled: bool = True,
    runs_once: bool = False,
) -> Integrator:
    family = _affine_family(explicit) if compiled and not runs_once else None
    if family is not None:
        return AffineIntegrator(explicit, tuple(names), family)
    apart = _with_chain(explicit, tuple(names)) if compiled and not runs_once else None
    return apart or _stepping(explicit, names, compiled, runs_once)


def _stepping(
    explicit: ExplicitModel, names: Sequence[str], compiled: bool, runs_once: bool
) -> EquationIntegrator:
    known = _compiled_for_more(explicit, tuple(names)) if compiled else None
    if known is not None:
        return known
    rhs, sens, out, hold, bend = _model_functions(explicit, tuple(names))
    library, events, root = None, None, None
    if explicit.flat.events is not None:
        functions = EventFunctions(explicit)
        root, owners = functions.roots()
        events = functions, owners
    if compiled:
        near = explicit.near
        driven = (rhs, sens, out) if near is None else _near_functions(explicit, near, tuple(names))
        level = "-O1" if runs_once else "-O2"
        rates = _rates_alone(explicit, near)
        library = if_compiler(lambda: _compile(rates, *driven, hold, root, bend, level))
    made = EquationIntegrator(explicit, tuple(names), rhs, sens, out, library, hold, events, bend)
    if library is not None and not runs_once:
        _compiled[_functions_of(explicit)] = made  # which keeps the functions: no others take their numbers
        while len(_compiled) > MOST_COMPILED:
            del _compiled[next(iter(_compiled))]
    return made


_compiled: dict[tuple, EquationIntegrator] = {}
_families: dict[tuple, tuple[ExplicitModel, StateSpaceFamily | None]] = {}


# With the model, which keeps its functions: no others take their numbers.
_chained: dict[tuple, tuple[ExplicitModel, ChainIntegrator | TrailingIntegrator | None]] = {}


def _with_chain(
    explicit: ExplicitModel, names: tuple[str, ...]
) -> ChainIntegrator | TrailingIntegrator | None:
    """The integrator of a model with a chain that inputs drive, or with one that nothing else feels; None for
    one without, or without a compiler."""
    key = _functions_of(explicit)
    known = _chained[key][1] if key in _chained else None
    if key not in _chained or (known is not None and known.begun[: len(names)] != names):
        known = _made_beside_chain(explicit, names) or _made_before_chain(explicit, names)
        _chained[key] = explicit, known
        while len(_chained) > MOST_COMPILED:
            del _chained[next(iter(_chained))]
    return None if known is None else replace(known, explicit=explicit, names=names)


def _made_beside_chain(explicit: ExplicitModel, names: tuple[str, ...]) -> ChainIntegrator | None:
    columns = explicit.flat.parameter_columns(names)
    chain = driven_chain(explicit)
    if chain is None:
        return None
    made = rest_functions(explicit, chain, columns)
    functions = made.rate, made.rhs, made.sens, made.out
    library = if_compiler(lambda: _compile(*functions, None, None, made.bend, "-O2"))
    if library is None:
        return None
    beside = EquationIntegrator(explicit, names, made.rhs, made.sens, made.out, library, bend=made.bend)
    return ChainIntegrator(explicit, names, beside, names, chain)


def _made_before_chain(explicit: ExplicitModel, names: tuple[str, ...]) -> TrailingIntegrator | None:
    chain = trailing_chain(explicit)
    if chain is None:
        return None
    rhs, sens, out, _, _ = _model_functions(chain.model, names)
    rates, n_c = _rates_alone(chain.model, None), chain.members.size
    library = if_compiler(lambda: _compile(rates, rhs, sens, out, None, None, None, "-O2", n_c))
    if library is None:
        return None
    before = EquationIntegrator(chain.model, names, rhs, sens, out, library)
    return TrailingIntegrator(explicit, names, before, names, chain)


def _affine_family(explicit: ExplicitModel) -> StateSpaceFamily | None:
    """The matrices of a model with affine dynamics and no invariants; None for others."""
    key = _functions_of(explicit)
    if key not in _families:
        is_affine = explicit.invariants is None and has_affine_dynamics(explicit)
        _families[key] = explicit, family_without_variables(explicit) if is_affine else None
        while len(_families) > MOST_COMPILED:
            del _families[next(iter(_families))]
    return _families[key][1]


def _functions_of(explicit: ExplicitModel) -> tuple:
    functions = (explicit.rhs, explicit.outputs, explicit.invariants)
    laws = sensor_laws(explicit)
    own = () if laws is None else laws.key
    return *(hash(f) for f in functions), *explicit.flat.parameter_names, own


def _compiled_for_more(explicit: ExplicitModel, names: tuple[str, ...]) -> EquationIntegrator | None:
    """The integrator of the same functions that was compiled last, if its parameters begin with `names`: its
    code tells the sensitivities to the first of them, too."""
    known = _compiled.get(_functions_of(explicit))
    if known is None or known.events is not None or known.names[: len(names)] != names:
        return None
    return replace(known, explicit=explicit, names=names)


def _again(explicit: ExplicitModel, names: tuple[str, ...], compiled: bool) -> Integrator:
    return integrator(explicit, names, compiled=compiled)


def _model_functions(
    explicit: ExplicitModel, names: tuple[str, ...]
) -> tuple[ca.Function, ca.Function, ca.Function, ca.Function | None, ca.Function | None]:
    columns = explicit.flat.parameter_columns(names)
    kind: Any = ca.SX if explicit.is_symbolic else ca.MX
    n_u, n_v, n_w = (explicit.rhs.numel_in(i) for i in (1, 2, 3))
    x, ubar, t = kind.sym("x", explicit.n_states), kind.sym("u", n_u + n_v), kind.sym("t")
    # The chosen parameters stand apart: a library model may have hundreds of others.
    theta, chosen = kind.sym("theta", len(explicit.flat.parameters)), kind.sym("chosen", len(columns))
    whole = kind(theta)
    for position, column in enumerate(columns):
        whole[column] = chosen[position]
    at = (x, ubar[:n_u], ubar[n_u:], kind.zeros(n_w), whole, t)
    f, h = explicit.rhs(*at), explicit.outputs(*at)
    results = {
        "daest_rhs": [f, ca.jacobian(f, x)],
        "daest_sens": [ca.jacobian(f, x), ca.jacobian(f, chosen)],
        "daest_out": [h, ca.jacobian(h, x), ca.jacobian(h, chosen)],
    }
    if explicit.invariants is not None:
        g = explicit.invariants(*at)
        results["daest_hold"] = [g, ca.jacobian(g, x).T, ca.jacobian(g, chosen).T]
    laws = sensor_laws(explicit)
    if laws is not None:
        s, _ = relative_slopes(explicit, laws, at)
        results["daest_bend"] = [s, ca.jacobian(s, x), ca.jacobian(s, chosen)]
    if not columns:
        del results["daest_sens"]
    inner = [
        ca.Function(f"inner_{name}", [x, ubar, chosen, theta, t], list(map(ca.densify, expressions)))
        for name, expressions in results.items()
    ]
    parts = {
        name: ca.Function(
            name, [x, ubar, theta, t], part.call([x, ubar, theta[columns], theta, t], True, False)
        )
        for name, part in zip(results, inner, strict=True)
    }
    rhs = parts["daest_rhs"]
    slopes = parts.get("daest_sens") or _slopes_alone(rhs)
    return rhs, slopes, parts["daest_out"], parts.get("daest_hold"), parts.get("daest_bend")


def _near_functions(
    explicit: ExplicitModel, near: tuple[ca.Function, ca.Function], names: tuple[str, ...]
) -> tuple[ca.Function, ca.Function, ca.Function]:
    """What `_model_functions` makes for the C code, of a model whose loops are solved from a guess, the last
    argument; the first function tells its tears behind the slopes."""
    columns = explicit.flat.parameter_columns(names)
    n_u, n_v, n_w = (explicit.rhs.numel_in(i) for i in (1, 2, 3))
    x, ubar, t = ca.MX.sym("x", explicit.n_states), ca.MX.sym("u", n_u + n_v), ca.MX.sym("t")
    theta, chosen = ca.MX.sym("theta", len(explicit.flat.parameters)), ca.MX.sym("chosen", len(columns))
    guess = ca.MX.sym("guess", near[0].numel_in(6))
    whole = ca.MX(theta)
    for position, column in enumerate(columns):
        whole[column] = chosen[position]
    (f, tears), (h, _) = (part(x, ubar[:n_u], ubar[n_u:], ca.MX.zeros(n_w), whole, t, guess) for part in near)
    if explicit.of_tears is None:
        slopes = [ca.jacobian(f, x), ca.jacobian(f, chosen)]
        shown = [h, ca.jacobian(h, x), ca.jacobian(h, chosen)]
    else:
        rates, outputs = _slopes_at_tears(explicit, explicit.of_tears, columns)
        at = (x, ubar, chosen, theta, t, tears)
        slopes, shown = list(rates.call(at, True, False)), list(outputs.call(at, True, False))
    results = {"daest_rhs": [f, slopes[0], tears], "daest_sens": slopes, "daest_out": shown}
    parts = []
    for name, expressions in results.items():
        dense = list(map(ca.densify, expressions))
        inner = ca.Function(f"inner_{name}", [x, ubar, chosen, theta, t, guess], dense)
        values = inner.call([x, ubar, theta[columns], theta, t, guess], True, False)
        parts.append(ca.Function(name, [x, ubar, theta, t, guess], values))
    return parts[0], parts[1], parts[2]


def _slopes_at_tears(
    explicit: ExplicitModel, of_tears: tuple[ca.Function, ca.Function, ca.Function], columns: list[int]
) -> tuple[ca.Function, ca.Function]:
    """(x, ū, chosen, theta, t, tears) -> ∂f/∂x, ∂f/∂θ_chosen and -> h, ∂h/∂x, ∂h/∂θ_chosen, θ_chosen those in
    `columns`, where the tears τ solve 0 = g: by the theorem of the implicit function
    df/dx = ∂f/∂x - ∂f/∂τ (∂g/∂τ)⁻¹ ∂g/∂x. One solution of the loop then serves all slopes."""
    n_u, n_v, n_w = (explicit.rhs.numel_in(i) for i in (1, 2, 3))
    x, ubar, t = ca.SX.sym("x", explicit.n_states), ca.SX.sym("u", n_u + n_v), ca.SX.sym("t")
    theta, chosen = ca.SX.sym("theta", len(explicit.flat.parameters)), ca.SX.sym("chosen", len(columns))
    tears = ca.SX.sym("tears", of_tears[2].numel_out(0))
    whole = ca.SX(theta)
    for position, column in enumerate(columns):
        whole[column] = chosen[position]
    f, h, g = (part(x, ubar[:n_u], ubar[n_u:], ca.SX.zeros(n_w), whole, t, tears) for part in of_tears)
    matrix = ca.densify(ca.jacobian(g, tears))
    inverse = ca.adj(matrix) / ca.det(matrix)
    moved = [-ca.mtimes(inverse, ca.jacobian(g, symbols)) for symbols in (x, chosen)]

    def slopes(value: ca.SX) -> list[ca.SX]:
        by_tears = ca.jacobian(value, tears)
        own = (ca.jacobian(value, symbols) for symbols in (x, chosen))
        return [part + ca.mtimes(by_tears, move) for part, move in zip(own, moved, strict=True)]

    at = [x, ubar, chosen, theta, t, tears]
    return ca.Function("slopes_of_rates", at, slopes(f)), ca.Function(
        "slopes_of_outputs", at, [h, *slopes(h)]
    )


def _rates_alone(explicit: ExplicitModel, near: tuple[ca.Function, ca.Function] | None) -> ca.Function:
    """(x, ū, theta, t) -> f, which most evaluations of an implicit step ask for; of a model whose loops are
    solved from a guess (x, ū, theta, t, guess) -> f, tears."""
    kind: Any = ca.SX if explicit.is_symbolic and near is None else ca.MX
    n_u, n_v, n_w, n_theta = (explicit.rhs.numel_in(i) for i in (1, 2, 3, 4))
    x, ubar = kind.sym("x", explicit.n_states), kind.sym("u", n_u + n_v)
    theta, t = kind.sym("theta", n_theta), kind.sym("t")
    at = (x, ubar[:n_u], ubar[n_u:], kind.zeros(n_w), theta, t)
    if near is None:
        return ca.Function("daest_rate", [x, ubar, theta, t], [ca.densify(explicit.rhs(*at))])
    guess = ca.MX.sym("guess", near[0].numel_in(6))
    f, tears = near[0](*at, guess)
    return ca.Function("daest_rate", [x, ubar, theta, t, guess], [ca.densify(f), tears])


def _slopes_alone(rhs: ca.Function) -> ca.Function:
    """(x, ū, theta, t) -> ∂f/∂x and no columns: the code of `rhs` is not written twice."""
    arguments = rhs.mx_in()
    slopes = rhs.call(arguments, False, True)[1]
    return ca.Function("daest_sens", arguments, [slopes, ca.MX(slopes.size1(), 0)])


def _compile(
    rate: ca.Function,
    rhs: ca.Function,
    sens: ca.Function,
    out: ca.Function,
    hold: ca.Function | None,
    root: ca.Function | None,
    bend: ca.Function | None,
    wanted: str,
    n_trailing: int = 0,
) -> ctypes.CDLL | None:
    if root is not None and not root.numel_out(0):
        root = None
    functions = [f for f in (rate, rhs, sens, out, hold, root, bend) if f is not None]
    most = (str(max(getattr(f, f"sz_{kind}")() for f in functions)) for kind in ("arg", "res", "iw", "w"))
    chosen = sens.numel_out(1) // max(rhs.numel_in(0), 1)
    sizes = f"const casadi_int daest_work[4] = {{{', '.join(most)}}}, daest_n_chosen = {chosen};\n"
    constants = {
        "NX": rhs.numel_in(0),
        "NU": rhs.numel_in(1),
        "NY": out.numel_out(0),
        "NT": rhs.numel_out(2) if rhs.n_out() > 2 else 0,
        "NG": 0 if hold is None else hold.numel_out(0),
        "NR": 0 if root is None else root.numel_out(0),
        "BENT": int(bend is not None),
        "NC": n_trailing,
    }
    return _load(generated(functions) + sizes, _driver(constants), wanted)


_FUNCTIONS = ("rate", "rhs", "sens", "out", "hold", "root", "bend")


def _driver(constants: Mapping[str, int]) -> str:
    """The integrator for all models of the same sizes, which are in another file."""
    arguments = "(const double **, double **, casadi_int *, double *, int)"
    lines = [f"#define {name} {value}" for name, value in constants.items()]
    lines += ["#define casadi_int long long int", "extern const casadi_int daest_work[4], daest_n_chosen;"]
    lines += [f"int daest_{name}{arguments};" for name in _FUNCTIONS]
    names = ("project.c", "radau.c") if constants["NG"] else ("radau.c",)
    return "\n".join((*lines, *map(text_of, names)))


@functools.lru_cache(maxsize=64)
def _load(source: str, driver: str, wanted: str) -> ctypes.CDLL | None:
    if source.count("\n") > MOST_LINES:
        return None
    common = build_object(driver, "radau", (*_flags(driver, wanted), *APART))
    return ctypes.CDLL(str(build_shared(source, "integrator", _flags(source, wanted), objects=(common,))))


def _flags(source: str, wanted: str) -> tuple[str, ...]:
    level = effort(source, wanted)
    return (level, *(FAST if level == wanted == "-O2" else ()), *processor_flags())


def interval_inputs(
    explicit: Dynamics, time: np.ndarray, inputs: np.ndarray, hold: Hold, theta: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """ū = (u, v) at the two ends of each sample interval, each (n_samples - 1, n_ū).

    inputs (n_samples, n_u). A first derivative that the model needs is, at the samples, the central
    difference of a foh input, as in `stacked_inputs`, the slope of the spline of a smooth one, and zero for a
    held one. Raises what `refuse_derivatives` raises.
    """
    refuse_derivatives(explicit, hold, theta)
    return inputs_at_ends(explicit, time, inputs, hold)


def inputs_at_ends(
    explicit: Dynamics, time: np.ndarray, inputs: np.ndarray, hold: Hold
) -> tuple[np.ndarray, np.ndarray]:
    """What `interval_inputs` returns, each (n_samples - 1, n_ū); derivatives that the samples do not have, of
    held inputs or of a higher order, are zero where the model needs them. Shapes: time (n_samples,), inputs
    (n_samples, n_u)."""
    start, end = inputs[:-1], interval_ends(inputs, hold, explicit.flat.input_names)
    if not explicit.input_derivatives:
        return start, end
    slopes = slopes_at_samples(explicit, time, inputs, hold)
    return np.hstack([start, slopes[:-1]]), np.hstack([end, slopes[1:]])


def _has_slope(explicit: Dynamics, hold: Hold) -> np.ndarray:
    """1 for each input derivative (n_v,) that samples have, 0 for one of a held input or a higher order."""
    held = held_inputs(hold, explicit.flat.input_names)
    return np.array([d.order == 1 and not held[d.index] for d in explicit.input_derivatives], dtype=float)


def slopes_at_samples(explicit: Dynamics, time: np.ndarray, inputs: np.ndarray, hold: Hold) -> np.ndarray:
    """Input derivatives (n_samples, n_v) at the samples of `inputs` (n_samples, n_u): of splines where they
    are smooth, else by central differences; zero where samples have none. On straight lines either side has a
    derivative of its own, half a sample early or late."""
    derivatives = tuple((d.index, d.order) for d in explicit.input_derivatives)
    slopes = stacked_inputs(inputs, time, derivatives, hold)[:, inputs.shape[1] :]
    return slopes * _has_slope(explicit, hold)


def follows_curves(explicit: Dynamics) -> bool:
    """Whether integrations of a model follow smooth inputs between their samples; models with events are
    driven straight."""
    return not isinstance(explicit, ExplicitModel) or explicit.flat.events is None


def input_bends(explicit: Dynamics, time: np.ndarray, inputs: np.ndarray, hold: Hold) -> np.ndarray | None:
    """a and b (n_samples - 1, 2, n_ū) of r (1 - r) (a + b r), by which ū leaves the straight line at the part
    r of each interval; None where it does not. inputs (n_samples, n_u); those behind the inputs of the model
    run straight. The derivative of a foh input bends so that its mean over an interval is the slope there."""
    sources = [d.index for d in explicit.input_derivatives]
    moves = _has_slope(explicit, hold)
    if time.size < 2 or (hold != SMOOTH and not moves.any()):
        return None
    named, steps, first = len(explicit.flat.inputs), np.diff(time)[:, None], inputs.shape[1]
    bent = np.zeros((time.size - 1, 2, first + len(sources)))
    if hold != SMOOTH:
        start, end = inputs_at_ends(explicit, time, inputs, hold)
        mean = np.diff(inputs[:, sources], axis=0) / steps - 0.5 * (start + end)[:, first:]
        bent[:, 0, first:] = 6.0 * mean * moves
        return bent
    slopes, rise = spline_slopes(inputs[:, :named], time), np.diff(inputs[:, :named], axis=0)
    bent[:, 0, :named] = steps * slopes[:-1] - rise
    bent[:, 1, :named] = 2.0 * rise - steps * (slopes[:-1] + slopes[1:])
    bent[:, 0, first:] = 3.0 * bent[:, 1, sources] / steps  # of the derivative, a parabola
    return bent


@dataclass(frozen=True)
class Record:
    """What drives a model over a record: `time` (n_samples,), ū at the two ends of every interval, `u0` and
    `u1` (n_samples - 1, n_ū), and at the last sample, `u_last` (1, n_ū); `bent` (n_samples - 1, 2, n_ū): see
    `input_bends`. All are contiguous."""

    time: np.ndarray
    u0: np.ndarray
    u1: np.ndarray
    u_last: np.ndarray
    bent: np.ndarray | None


def record(explicit: Dynamics, time: np.ndarray, inputs: np.ndarray, hold: Hold) -> Record:
    """That of recorded `inputs` (n_samples, n_u) at `time` (n_samples,)."""
    u0, u1 = inputs_at_ends(explicit, time, inputs, hold)
    u_last = inputs[-1:] if u1.shape[0] == 0 else np.hstack([inputs[-1:], u1[-1:, inputs.shape[1] :]])
    time, u0, u1, u_last = (np.ascontiguousarray(a, dtype=float) for a in (time, u0, u1, u_last))
    return Record(time, u0, u1, u_last, input_bends(explicit, time, inputs, hold))


def integrate(
    model: Integrator,
    time: np.ndarray,
    inputs: np.ndarray,
    theta: np.ndarray,
    x0: np.ndarray,
    *,
    hold: Hold = "foh",
    sensitivities: bool = False,
    by_parameter: bool = True,
    correction: Correction | None = None,
    rtol: float = SOLVER.search_rtol,
    atol_of_scale: float = SOLVER.atol_of_scale,
    state_scale: np.ndarray | None = None,
    max_steps: int | None = None,
    tell: Callable[[float], object] | None = None,
) -> Trajectory:
    """States and outputs at `time` (n_samples,) from x0 (n_states,) under the recorded `inputs` (n_samples,
    n_u).

    theta: all parameters. `correction` turns the simulation into the one-step predictor of an observer.
    `state_scale` (n_states,): sizes that count as large for each state (default 1); the absolute tolerance is
    `rtol` times `atol_of_scale` of them. Directions of the sensitivities: `model.names` unless `by_parameter`
    is unset, then the initial states, then those along which the gain of the correction changes. `max_steps`
    over the whole record (default: `search_steps`).
    `tell` hears of the time that a long run has reached; an exception in it ends the run.
    Raises IntegrationError with the time it stopped at.
    """
    refuse_derivatives(model.explicit, hold, theta)
    (made,) = integrate_all(
        model, [record(model.explicit, time, inputs, hold)], theta, x0[None], [correction],
        sensitivities=sensitivities, by_parameter=by_parameter, rtol=rtol, atol_of_scale=atol_of_scale,
        state_scale=state_scale, max_steps=max_steps, tell=tell,
    )  # fmt: skip
    return made


def integrate_all(
    model: Integrator,
    records: Sequence[Record],
    theta: np.ndarray,
    x0: np.ndarray,
    corrections: Sequence[Correction | None],
    *,
    sensitivities: bool = False,
    by_parameter: bool = True,
    rtol: float = SOLVER.search_rtol,
    atol_of_scale: float = SOLVER.atol_of_scale,
    state_scale: np.ndarray | None = None,
    max_steps: int | None = None,
    tell: Callable[[float], object] | None = None,
) -> list[Trajectory]:
    """As `integrate`, over several `records` with the same parameters, each with its correction, from the
    rows of x0 (n_records, n_states). Many short ones cost little more than one long one. Raises
    IntegrationError for the first that fails."""
    n_states = x0.shape[1]
    scale = np.ones(n_states) if state_scale is None else np.maximum(np.abs(state_scale), 1e-30)
    theta, x0 = (np.ascontiguousarray(a, dtype=float) for a in (theta, x0))
    n_parameters = len(model.names) if sensitivities and by_parameter else 0
    atol = rtol * atol_of_scale * scale
    runs = []
    for one, start, correction in zip(records, x0, corrections, strict=True):
        n_gain = correction.slopes.shape[0] if sensitivities and correction is not None else 0
        directions = n_parameters + n_states + n_gain if sensitivities else 0
        most = search_steps(one.time.size) if max_steps is None else max_steps
        runs.append(
            Run(
                one.time, one.u0, one.u1, one.u_last, one.bent, theta, start, directions, n_parameters,
                n_gain, rtol, atol, scale, correction, most, tell,
            )
        )  # fmt: skip
    found = model.trajectories(runs) if runs else []
    return [_with_directions(made, run) for made, run in zip(found, runs, strict=True)]


def _with_directions(made: Trajectory, run: Run) -> Trajectory:
    """Of an engine without a choice, which tells the slopes by the parameters, too, those asked for."""
    more = made.sensitivities.shape[2] - run.directions
    return replace(made, sensitivities=made.sensitivities[:, :, more:]) if more else made


def _run_hybrid(model: EquationIntegrator, run: Run) -> Trajectory:
    """With events."""
    if run.correction is not None:
        raise events_refused("a prediction from sample to sample")
    inputs = Inputs(run.time, run.u0, run.u1, run.u_last)
    try:
        made = follow(
            model, inputs, run.theta, run.x0, None,
            directions=model.n_directions if run.directions else 0,
            rtol=run.rtol, atol=run.atol, max_steps=run.max_steps,
        )  # fmt: skip
    except HybridError as error:
        raise IntegrationError(error.what, float(run.time[0])) from error
    return Trajectory(made.states, made.outputs, made.sensitivities, made.n_steps, made.theta, made.tears)


def _run_radau(model: EquationIntegrator, runs: Sequence[Run], tail: Tail | None = None) -> list[Trajectory]:
    """The trajectories of runs that are `alike`, by one call, with the `tail` behind them. Raises
    IntegrationError for the first that fails."""
    assert model.library is not None
    one, many = runs[0], len(runs) > 1
    n_y, sizes = model.out.numel_out(0), np.array([run.time.size for run in runs])
    ends = np.cumsum(sizes)
    n, k = int(ends[-1]), model.explicit.n_tears
    states, outputs = np.empty((n, one.x0.size)), np.empty((n, n_y))
    sens, seen = np.empty((n, n_y, one.directions)), np.full((n, k), np.nan)
    steps, reached = np.full(len(runs), -1, dtype=ctypes.c_long), np.zeros(3)
    start = np.ascontiguousarray(one.start_sensitivities)
    y, gain, stride, slopes = None, None, 0, None
    if one.correction is not None:
        given = [run.correction for run in runs if run.correction is not None]
        slopes = one.correction.slopes
        y = np.ascontiguousarray(np.concatenate([g.measurements for g in given]), dtype=float)
        varies = one.correction.gain.ndim == 3
        gain = np.concatenate([g.gain for g in given]) if varies else one.correction.gain
        gain = np.ascontiguousarray(gain, dtype=float)
        stride = gain[0].size if varies else 0

    def joined(name: str) -> np.ndarray:
        parts = [getattr(run, name) for run in runs]
        return np.concatenate(parts) if many else parts[0]

    columns = (joined("time"), joined("u0"), joined("u1"), joined("u_last"))
    bent = None if one.bent is None else joined("bent")
    lengths = sizes.astype(ctypes.c_long)
    most = np.array([run.max_steps for run in runs], dtype=ctypes.c_long)
    arguments = (
        ctypes.c_long(len(runs)), pointer(lengths), *map(pointer, (*columns, bent, one.theta, joined("x0"))),
        ctypes.c_int(one.directions), ctypes.c_int(one.by_parameter), pointer(start),
        pointer(y), pointer(gain), ctypes.c_long(stride), pointer(slopes), ctypes.c_int(one.by_gain),
        ctypes.c_double(one.rtol), pointer(one.atol), pointer(most),
        *map(pointer, (states, outputs, sens, steps, reached, seen)),
        None if tail is None else ctypes.byref(tail),
    )  # fmt: skip
    status = _watched(model.library.daest_simulate, arguments, reached, one.tell)
    if status:
        taken = steps[steps >= 0][-1]
        raise IntegrationError(FAILURES[status].format(steps=taken, next=reached[1]), float(reached[0]))
    rows = [slice(end - size, end) for size, end in zip(sizes.tolist(), ends.tolist(), strict=True)]
    return [
        Trajectory(states[r], outputs[r], sens[r], int(taken), tears=seen[r])
        for r, taken in zip(rows, steps, strict=True)
    ]


def _watched(
    simulate: Callable[..., int],
    arguments: tuple,
    reached: np.ndarray,
    tell: Callable[[float], object] | None,
) -> int:
    if tell is None:
        return simulate(*arguments)

    def stop() -> None:
        reached[2] = 1.0

    return watched(lambda: simulate(*arguments), lambda: tell(float(reached[0])), stop)


def _has_exact_steps(run: Run) -> bool:
    """Whether one gain corrects samples of which no value is missing; inputs that bend do so over intervals
    of one length."""
    if run.time.size < 2 or run.x0.size == 0:
        return False
    is_gapless = run.correction is None or (
        run.correction.gain.ndim == 2 and bool(np.all(np.isfinite(run.correction.measurements)))
    )
    return is_gapless and (run.bent is None or _has_equal_steps(run.time))


def _has_equal_steps(time: np.ndarray) -> bool:
    """Whether all intervals are of one length to rounding. Rounded times are not: unlike a filter, an
    integration takes them as they are."""
    intervals = np.diff(time)
    return bool(np.ptp(intervals) <= SOLVER.equal_steps * intervals.mean())


def _exact_steps(model: AffineIntegrator, run: Run) -> Steps | None:
    """The steps of a run; None where adaptive ones cost less."""
    names, given = model.names[: run.by_parameter], run.correction
    inputs = DrivenBy(run.u0, run.u1, np.vstack([run.u0, run.u_last]), run.bent)
    gain = None if given is None else Gain(given.measurements, given.gain, given.slopes)
    if not _has_equal_steps(run.time):
        return uneven_steps(model.family, run.theta, names, np.diff(run.time), inputs, gain)
    period = float(run.time[-1] - run.time[0]) / (run.time.size - 1)
    return affine_steps(model.family, run.theta, names, period, inputs, gain)


def _run_exactly(steps: Steps, run: Run) -> Trajectory:
    with np.errstate(over="ignore", invalid="ignore"):
        along = steps.states(run.x0)
        states = steps.at_samples(along)
        outputs = steps.outputs(states)
        if not (np.all(np.isfinite(states)) and np.all(np.isfinite(outputs))):
            raise IntegrationError(FAILURES[3], float(run.time[0]))
        slopes = steps.slopes(along, outputs) if run.directions else None
    n, n_y = outputs.shape
    sens = np.empty((n, n_y, 0)) if slopes is None else slopes.transpose(1, 2, 0)
    return Trajectory(states, outputs, sens, n - 1)


def _run_interpreted(model: EquationIntegrator, run: Run) -> Trajectory:
    """Interval by interval, so that corrections can be applied between them."""
    step = _collocation(model)
    n, n_states, n_y = run.time.size, run.x0.size, model.out.numel_out(0)
    states, outputs = np.empty((n, n_states)), np.empty((n, n_y))
    sens = np.empty((n, n_y, run.directions))
    S, x = run.start_sensitivities, run.x0.copy()
    n_p = run.by_parameter
    x, S = _projected(model, run, run.u0[0] if n > 1 else run.u_last[0], run.time[0], x, S)
    for i in range(n):
        states[i] = x
        u = run.u0[i] if i + 1 < n else run.u_last[0]
        h, C, h_theta = (np.array(part) for part in model.out(x, u, run.theta, run.time[i]))
        outputs[i] = h.ravel()
        if run.directions:
            sens[i] = C @ S
            sens[i][:, :n_p] += h_theta[:, :n_p]
        if run.correction is not None:
            x, S = _correct(model, run, i, x, S, outputs[i], sens[i])
            x, S = _projected(model, run, u, run.time[i], x, S)
        if i + 1 == n:
            break
        ends = np.concatenate([[run.time[i], run.time[i + 1]], run.u0[i], run.u1[i]])
        try:
            x_next, transition, drive = (np.array(part) for part in step(x, run.theta, ends))
        except RuntimeError as error:
            raise IntegrationError("the Newton iteration did not converge", float(run.time[i])) from error
        if not np.all(np.isfinite(x_next)):
            raise IntegrationError(FAILURES[3], float(run.time[i]))
        x = x_next.ravel()
        S = transition @ S
        if run.directions:
            S[:, :n_p] += drive[:, :n_p]
        x, S = _projected(model, run, run.u1[i], run.time[i + 1], x, S)
    return Trajectory(states, outputs, sens, INTERPRETED_STEPS * (n - 1))


def _projected(
    model: EquationIntegrator, run: Run, u: np.ndarray, time: float, x: np.ndarray, S: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """State and sensitivities on the invariants of the model, by shortest steps in sizes of the states."""
    if model.hold is None:
        return x, S

    def invariants(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        g, R, _ = (np.array(part) for part in model.hold(at, u, run.theta, time))  # type: ignore[misc]
        return g.ravel(), R.T

    pulled = pull(invariants, x, run.atol, SOLVER.projected_step)
    by_p = np.array(model.hold(pulled.x, u, run.theta, time)[2])
    change = pulled.slopes @ S
    if run.directions:
        change[:, : run.by_parameter] += by_p.T[:, : run.by_parameter]
    return pulled.x, S - pulled.gain @ change


def _correct(
    model: EquationIntegrator,
    run: Run,
    i: int,
    x: np.ndarray,
    S: np.ndarray,
    predicted: np.ndarray,
    predicted_sens: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    assert run.correction is not None
    gain = run.correction.gain[i] if run.correction.gain.ndim == 3 else run.correction.gain
    measured = run.correction.measurements[i]
    there = np.isfinite(measured)
    innovation, change = measured - predicted, predicted_sens
    if model.bend is not None:
        u = run.u0[i] if i + 1 < run.time.size else run.u_last[0]
        slope, by_x, by_theta = (np.array(part) for part in model.bend(x, u, run.theta, run.time[i]))
        bent = by_x @ S
        bent[:, : run.by_parameter] += by_theta[:, : run.by_parameter]
        change = slope * change - np.where(there, innovation, 0.0)[:, None] * bent
        innovation = slope.ravel() * innovation
    gain, innovation = gain[:, there], innovation[there]
    S = S - gain @ change[there]
    if run.by_gain:
        S[:, -run.by_gain :] += (run.correction.slopes[:, :, there] @ innovation).T
    return x + gain @ innovation, S


def _collocation(model: EquationIntegrator) -> ca.Function:
    """(x, theta, ends) -> x after the interval, ∂x/∂x0, ∂x/∂θ_names; ends = (t0, t1, ū at t0, ū at t1)."""
    n_states, n_u, n_theta = (model.rhs.numel_in(i) for i in range(3))
    x, ends, theta = ca.MX.sym("x", n_states), ca.MX.sym("ends", 2 + 2 * n_u), ca.MX.sym("theta", n_theta)
    part = ca.MX.sym("t")  # 0 … 1 over the interval
    u = ends[2 : 2 + n_u] + part * (ends[2 + n_u :] - ends[2 : 2 + n_u])
    span = ends[1] - ends[0]
    rate = span * model.rhs(x, u, theta, ends[0] + part * span)[0]
    options: Any = {
        "collocation_scheme": "radau",
        "interpolation_order": 3,
        "number_of_finite_elements": INTERPRETED_STEPS,
        "rootfinder": "newton",
    }
    dae: Any = {"x": x, "p": ca.vertcat(ends, theta), "t": part, "ode": rate}
    flow = ca.integrator("over_interval", "collocation", dae, 0, 1, options)
    end = flow(x0=x, p=ca.vertcat(ends, theta))["xf"]
    columns = model.explicit.flat.parameter_columns(model.names)
    by_theta = ca.jacobian(end, theta)[:, columns] if columns else ca.MX.zeros(n_states, 0)
    return ca.Function("interval", [x, theta, ends], [end, ca.jacobian(end, x), by_theta])
