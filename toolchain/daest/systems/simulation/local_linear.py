"""The functions that Gaussian filters of an explicit model need, built once and compiled when a compiler is
found.

`numerics/substep.c` and `numerics/local_filter.c` hold the filters, `numerics/local_linear.c` the loops over
samples; this module writes the model's part of that program.
"""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import singledispatch
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from daest.errors import EstimationError
from daest.model.flat import Dynamics, ExplicitModel, events_refused
from daest.numerics.compiler import effort, loaded, processor_flags, text_of
from daest.numerics.generated import generated
from daest.systems.simulation.gaussian_average import averaged
from daest.systems.simulation.integrate import EquationIntegrator, integrator

_WORK = ("arg", "res", "iw", "w")


@dataclass(frozen=True)
class LocalModel:
    """A model ready to be filtered; `names` are the parameters that derivatives are computed for.

    ū = (u, v). Matrices come out row by row, as one column. `library` None: interpreted.
    """

    explicit: Dynamics
    names: tuple[str, ...]
    flow: ca.Function  # (x, ū, dū/dt, theta, t, P) -> E f, its ∂/∂x, ramp, ∂f/∂w; P (n, n): covariance of x
    see: ca.Function  # (x, ū, theta, t) -> h, ∂h/∂x
    dflow: ca.Function | None  # (…, dx, dp, dP) -> differentials of the results of flow
    dsee: ca.Function | None
    hold: ca.Function | None  # (x, ū, theta, t) -> g, ∂g/∂x: invariants g = 0
    dhold: ca.Function | None
    inside: ca.Function | None  # (x, ū, theta, t) -> internal variables
    library: ctypes.CDLL | None
    engine: EquationIntegrator | None = None  # that follows the events of a model which has some

    @property
    def n_states(self) -> int:
        return self.explicit.n_states

    @property
    def n_outputs(self) -> int:
        return len(self.explicit.flat.outputs)

    @property
    def n_noises(self) -> int:
        return len(self.explicit.flat.noises)

    @property
    def n_inside(self) -> int:
        return 0 if self.inside is None else self.inside.numel_out(0)


@singledispatch
def local_model(
    explicit: Dynamics,
    names: Sequence[str] = (),
    *,
    tangents: bool = False,
    inside: bool = False,
    compiled: bool = True,
) -> LocalModel:
    """Build the functions of `explicit`.

    `tangents`: with derivatives along parameters `names`, noises and initial states; `inside`: with the
    internal variables (all unknowns, then the outputs that are no unknowns). Every estimate is projected onto
    the invariants of the model, if it has any.

    Raises ModelError `unknown-parameter`; EstimationError `output-white-noise` where an output contains white
    noise directly.
    """
    raise NotImplementedError(type(explicit).__name__)


@local_model.register
def _of_equations(
    explicit: ExplicitModel,
    names: Sequence[str] = (),
    *,
    tangents: bool = False,
    inside: bool = False,
    compiled: bool = True,
) -> LocalModel:
    if explicit.flat.events is not None and tangents:
        raise events_refused("a likelihood of predictions")
    parts = _Parts.of(explicit, tuple(names))
    _refuse_direct_noise(explicit)
    flow, see = parts.flow(), parts.see()
    dflow = (
        parts.differential("daest_dflow", flow, ("x", "ubar", "slope", "theta", "t", "P"), "P")
        if tangents
        else None
    )
    dsee = parts.differential("daest_dsee", see, ("x", "ubar", "theta", "t")) if tangents else None
    hold = None if explicit.invariants is None else parts.hold(explicit.invariants)
    dhold = (
        parts.differential("daest_dhold", hold, ("x", "ubar", "theta", "t")) if tangents and hold else None
    )
    variables = parts.inside() if inside else None
    outer = parts.outer
    dflow, dsee, hold, dhold, variables = (
        None if f is None else outer(f) for f in (dflow, dsee, hold, dhold, variables)
    )
    model = LocalModel(
        explicit, tuple(names), outer(flow), outer(see), dflow, dsee, hold, dhold, variables, library=None
    )
    if explicit.flat.events is not None:
        engine = integrator(explicit)
        assert isinstance(engine, EquationIntegrator)
        return replace(model, engine=engine)
    if not compiled:
        return model
    # Derivatives make the code long: a compiler takes twice as long at -O3, for every candidate anew.
    return replace(model, library=_load(_source(model), "-O3" if model.dflow is None else "-O2"))


def internal_names(explicit: Dynamics) -> tuple[str, ...]:
    """Names of the internal variables: all unknowns, then the outputs that are no unknowns."""
    unknowns = explicit.flat.unknown_names
    return unknowns + tuple(o.name for o in explicit.flat.outputs if o.name not in unknowns)


def internal_function(explicit: Dynamics) -> ca.Function:
    """(x, u, v, w, theta, t) -> values of `internal_names`."""
    arguments = _arguments(explicit)
    unknowns = set(explicit.flat.unknown_names)
    extra = [i for i, o in enumerate(explicit.flat.outputs) if o.name not in unknowns]
    outputs = explicit.outputs(*arguments)
    values = ca.vertcat(explicit.variables(*arguments), *(outputs[i] for i in extra))
    return ca.Function("internal", arguments, [ca.densify(values)])


def _arguments(explicit: Dynamics) -> list[Any]:
    return explicit.rhs.sx_in() if explicit.is_symbolic else explicit.rhs.mx_in()


def _refuse_direct_noise(explicit: ExplicitModel) -> None:
    arguments = _arguments(explicit)
    rows = ca.jacobian_sparsity(explicit.outputs(*arguments), arguments[3]).get_triplet()[0]
    if rows:
        name = explicit.flat.outputs[rows[0]].name
        raise EstimationError(
            "output-white-noise",
            f"the output {name} contains white noise directly, which no filter of a nonlinear model weighs",
            where=name,
            remedy="measure another variable, or pass the noise through a lag (coloured noise)",
        )


@dataclass(frozen=True)
class _Parts:
    """Symbols of the functions; `chosen` are the parameters `names`, which stand apart from the others."""

    explicit: ExplicitModel
    columns: tuple[int, ...]
    symbols: dict[str, Any]

    @classmethod
    def of(cls, explicit: ExplicitModel, names: tuple[str, ...]) -> _Parts:
        columns = tuple(explicit.flat.parameter_columns(names))
        kind = ca.SX if explicit.is_symbolic else ca.MX
        n_u, n_v, n_w, n_theta = (explicit.rhs.numel_in(i) for i in (1, 2, 3, 4))
        sizes = {
            "x": explicit.n_states,
            "ubar": n_u + n_v,
            "slope": n_u + n_v,
            "w": n_w,
            "chosen": len(names),
        }
        symbols = {name: kind.sym(name, size) for name, size in {**sizes, "theta": n_theta, "t": 1}.items()}
        symbols["P"] = kind.sym("P", sizes["x"], sizes["x"])
        return cls(explicit, columns, symbols)

    def at(self) -> tuple[Any, ...]:
        """Arguments of the functions of the explicit model, the chosen parameters in their places."""
        s = self.symbols
        theta = type(s["theta"])(s["theta"])
        for position, column in enumerate(self.columns):
            theta[column] = s["chosen"][position]
        n_u = len(self.explicit.flat.inputs)
        return s["x"], s["ubar"][:n_u], s["ubar"][n_u:], s["w"], theta, s["t"]

    def function(self, name: str, arguments: Sequence[str], results: list[Any]) -> ca.Function:
        """Of the named arguments and the chosen parameters, without noise."""
        s = self.symbols
        dense = [ca.densify(r) for r in results]
        noisy = ca.Function(f"{name}_noisy", [*(s[a] for a in arguments), s["chosen"], s["w"]], dense)
        given = [s[a] for a in arguments] + [s["chosen"]]
        quiet = noisy.call([*given, type(s["w"]).zeros(s["w"].numel())], True, False)
        return ca.Function(name, given, quiet, [*arguments, "chosen"], _results(quiet))

    def flow(self) -> ca.Function:
        """Sharp steps are averaged over the distribution of the state, except in models with Newton loops."""
        s = self.symbols
        f = self.explicit.rhs(*self.at())
        f = averaged(f, s["x"], s["P"]) if self.explicit.is_symbolic else f
        moving = ca.vertcat(s["ubar"], s["t"])
        ramp = ca.jtimes(f, moving, ca.vertcat(s["slope"], 1))
        results = [f, _matrix(f, s["x"]), ramp, _matrix(f, s["w"])]
        return self.function("daest_flow", ("x", "ubar", "slope", "theta", "t", "P"), results)

    def see(self) -> ca.Function:
        h = self.explicit.outputs(*self.at())
        return self.function("daest_see", ("x", "ubar", "theta", "t"), [h, _matrix(h, self.symbols["x"])])

    def hold(self, invariants: ca.Function) -> ca.Function:
        g = invariants(*self.at())
        return self.function("daest_hold", ("x", "ubar", "theta", "t"), [g, _matrix(g, self.symbols["x"])])

    def inside(self) -> ca.Function:
        values = internal_function(self.explicit)(*self.at())
        return self.function("daest_inside", ("x", "ubar", "theta", "t"), [values])

    def differential(
        self, name: str, function: ca.Function, arguments: Sequence[str], *also: str
    ) -> ca.Function:
        """Along x, the chosen parameters, and `also` these arguments."""
        s = self.symbols
        kind = type(s["x"])
        dx, dp = kind.sym("dx", s["x"].numel()), kind.sym("dp", len(self.columns))
        more = [kind.sym(f"d{a}", *s[a].shape) for a in also]
        given = [s[a] for a in arguments] + [s["chosen"]]
        results = function.call(given, True, False)
        whole = ca.vertcat(*[ca.vec(r) for r in results])
        moved = ca.vertcat(s["x"], s["chosen"], *(ca.vec(s[a]) for a in also))
        change = ca.densify(ca.jtimes(whole, moved, ca.vertcat(dx, dp, *map(ca.vec, more))))
        ends = np.cumsum([0, *(r.numel() for r in results)]).tolist()
        parts = [change[a:b] for a, b in pairwise(ends)]
        names = [*arguments, "chosen", "dx", "dp", *(f"d{a}" for a in also)]
        return ca.Function(name, [*given, dx, dp, *more], parts, names, _results(parts))

    def outer(self, function: ca.Function) -> ca.Function:
        """The function of all parameters: the chosen ones are read from theta."""
        s = self.symbols
        arguments = [type(s["x"]).sym(f"a{i}", *function.size_in(i)) for i in range(function.n_in())]
        named = [function.name_in(i) for i in range(function.n_in())]
        chosen, theta = named.index("chosen"), arguments[named.index("theta")]
        outer = arguments[:chosen] + arguments[chosen + 1 :]
        inner = [*arguments[:chosen], theta[list(self.columns)], *arguments[chosen + 1 :]]
        return ca.Function(function.name(), outer, function.call(inner, True, False))


def _results(values: list[Any]) -> list[str]:
    return [f"r{i}" for i in range(len(values))]


def _matrix(value: Any, by: Any) -> Any:
    """∂value/∂by row by row, as one column."""
    return ca.vec(ca.densify(ca.jacobian(value, by).T))


def _source(model: LocalModel) -> str:
    every = (model.flow, model.see, model.dflow, model.dsee, model.hold, model.dhold, model.inside)
    functions = [f for f in every if f is not None]
    sizes = {
        "NX": model.n_states,
        "NU": model.flow.numel_in(1),
        "NW": model.n_noises,
        "NY": model.n_outputs,
        "NG": 0 if model.hold is None else model.hold.numel_out(0),
        "NP": len(model.names),
        "NV": model.n_inside,
        **{f"SZ_{w.upper()}": max(getattr(f, f"sz_{w}")() for f in functions) for w in _WORK},
    }
    flags = [("TANGENTS", model.dflow), ("INSIDE", model.inside)]
    header = "".join(f"#define {name} {value}\n" for name, value in sizes.items())
    header += "".join(f"#define {name}\n" for name, function in flags if function is not None)
    header += f"#define EVERY_LEVEL\n#define SLOPES {slope_pattern(model)}\n"
    texts = ["project.c"] if model.hold is not None else []
    drivers = map(text_of, ("substep.c", *texts, "local_filter.c", "local_linear.c"))
    return generated(functions) + header + "".join(drivers)


def slope_pattern(model: LocalModel) -> str:
    """Row by row 1 where ∂f/∂x of the flow may differ from zero, and 0 elsewhere, as C writes an array."""
    pattern = ca.DM(model.flow.jac_sparsity(0, 0), 1).full()
    return ", ".join(str(int(entry)) for entry in pattern.ravel())


@functools.lru_cache(maxsize=64)
def _load(source: str, wanted: str) -> ctypes.CDLL | None:
    return loaded(source, "local_linear", (effort(source, wanted), *processor_flags()))
