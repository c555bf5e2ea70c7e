"""The events of an explicit model as functions of its states."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from daest.model.events import Events
from daest.model.flat import ExplicitModel
from daest.numerics.evaluator import Evaluator

PARTS = ("values", "wholes", "conditions", "assigned", "sources", "restarted", "samples", "starts")


@dataclass(frozen=True)
class EventPoint:
    """What `EventFunctions.at` tells of one instant; the names are those of `Events`."""

    values: np.ndarray
    wholes: np.ndarray
    conditions: np.ndarray
    assigned: np.ndarray
    sources: np.ndarray
    restarted: np.ndarray
    samples: np.ndarray
    starts: np.ndarray


class Instant(NamedTuple):
    """Where a model is: states x (n_states,), inputs and their derivatives ū (n_ū,), θ (n_theta,), time t
    [s], and the `tears` (n_tears,) from which its loops are solved, NaN or none where they are not known."""

    x: np.ndarray
    ubar: np.ndarray
    theta: np.ndarray
    t: float
    tears: np.ndarray


@dataclass(frozen=True)
class EventFunctions:
    """Functions of the events of `explicit`, in its arguments (x, ū, θ, t). Where the model has Newton
    iterations a last argument of every function of CasADi is the guess from which they start
    (`ExplicitModel.near`): a loop with several solutions keeps the one that it is at."""

    explicit: ExplicitModel

    @property
    def events(self) -> Events:
        assert self.explicit.flat.events is not None
        return self.explicit.flat.events

    def at(self, instant: Instant, active: np.ndarray, ticks: np.ndarray) -> EventPoint:
        """Everything at one instant. Shapes: active (n_conditions,), ticks (n_ticks,)."""
        made = self._at(*instant[:4], active, ticks, *self._guess(instant))
        return EventPoint(*[m if name in _TABLES else m.ravel() for name, m in zip(PARTS, made, strict=True)])

    def variables(self, instant: Instant) -> tuple[np.ndarray, np.ndarray]:
        """ξ (n,) and ∂ξ/∂x (n, n_states)."""
        value, slopes = self._called(self._variables, instant)
        return value.ravel(), slopes

    def rates(self, instant: Instant) -> np.ndarray:
        """ẋ (n_states,)."""
        return self._called(self._rates, instant)[0].ravel()

    def outputs(self, instant: Instant) -> tuple[np.ndarray, np.ndarray]:
        """y (n_y,) and the tears of the loops there."""
        value, found = self._called(self._outputs, instant)
        return value.ravel(), found.ravel()

    def _called(self, function: Evaluator, instant: Instant) -> list[np.ndarray]:
        return function(*instant[:4], *self._guess(instant))

    def _guess(self, instant: Instant) -> tuple[np.ndarray, ...]:
        """The last argument of the functions, where they have it."""
        n = self.explicit.n_tears
        if not n:
            return ()
        return (instant.tears if instant.tears.size else np.full(n, np.nan),)

    def derivatives(
        self, name: str, instant: Instant, active: np.ndarray, ticks: np.ndarray
    ) -> list[np.ndarray]:
        """Slopes along x, ū, θ and t of what `Events` calls `name`: restarted, assigned, sources, values,
        wholes or samples. Shapes: active (n_conditions,), ticks (n_ticks,)."""
        return self._slopes[name](*instant[:4], active, ticks, *self._guess(instant))

    # Which switches need to be watched ----------------------------------------------------------------------

    @cached_property
    def timed(self) -> np.ndarray:
        """Of each relation, then of each whole part: whether it moves in proportion to time alone."""
        flat, events = self.explicit.flat, self.events
        held = {one.unknown for one in events.assignments}
        moving = [flat.xi[i] for i in range(flat.n) if i not in held]
        others = ca.vertcat(flat.u, flat.derivatives, *moving)
        watched = ca.vertcat(events.values, events.wholes)
        slopes = ca.jacobian(watched, flat.time) if watched.numel() else ca.SX(0, 1)
        return np.array(
            [
                not ca.depends_on(watched[i], others) and not ca.depends_on(slopes[i], flat.time)
                for i in range(watched.numel())
            ],
            dtype=bool,
        )

    def clock(self, instant: Instant) -> tuple[np.ndarray, np.ndarray]:
        """Values at time zero and slopes along time of relations, then of whole parts."""
        value, slope = self._clock(*instant[:3], *self._guess(instant))
        return value.ravel(), slope.ravel()

    def roots(self) -> tuple[ca.Function, np.ndarray]:
        """(x, ū, θ, t) -> functions whose signs tell when a relation or a whole part changes, and which one
        each belongs to: relations first, then of every whole part the next number and the last one."""
        return self._roots

    def root_values(self, instant: Instant) -> np.ndarray:
        """The values of `roots` (n_roots,)."""
        return self._called(self._root_values, instant)[0].ravel()

    def root_slopes(self, instant: Instant) -> list[np.ndarray]:
        """The values of `roots` (n_roots, 1) and their slopes along x, ū and t."""
        return self._called(self._root_slopes, instant)

    @cached_property
    def _root_slopes(self) -> Evaluator:
        roots, owners = self._roots
        symbols = [ca.MX.sym(f"s{i}", *roots.size_in(i)) for i in range(roots.n_in())]
        g = roots(*symbols) if owners.size else ca.MX(0, 1)
        slopes = [ca.densify(ca.jacobian(g, symbols[i])) for i in (0, 1, 3)]
        return Evaluator(ca.Function("root_slopes", symbols, [ca.densify(g), *slopes]))

    # Building them ------------------------------------------------------------------------------------------

    @cached_property
    def _root_values(self) -> Evaluator:
        return Evaluator(self._roots[0])

    @cached_property
    def _roots(self) -> tuple[ca.Function, np.ndarray]:
        kind, symbols, xi, rates = self._point()
        events, n = self.events, len(self.events.relations)
        at = [rates, xi, *self._flat_arguments(symbols)]
        values = self._expression("values", at)
        wholes = self._expression("wholes", at)
        rows, owners = [], []
        for i in range(n):
            if not self.timed[i]:
                rows.append(values[i])
                owners.append(i)
        for i, one in enumerate(events.whole_parts):
            if not self.timed[n + i]:
                rows += [wholes[i] - symbols[2][one.slot] - 1, symbols[2][one.slot] - wholes[i]]
                owners += [n + i, n + i]
        g = ca.vertcat(kind(0, 1), *rows)
        return ca.Function("daest_root", symbols, [ca.densify(g)]), np.array(owners, dtype=int)

    def _point(self) -> tuple[Any, list[Any], Any, Any]:
        """Symbols (x, ū, θ, t) and perhaps the guess, ξ and ξ' of them."""
        explicit = self.explicit
        kind: Any = ca.SX if explicit.is_symbolic else ca.MX
        n_u, n_v = explicit.rhs.numel_in(1), explicit.rhs.numel_in(2)
        x, ubar, t = kind.sym("x", explicit.n_states), kind.sym("u", n_u + n_v), kind.sym("t")
        theta = kind.sym("theta", len(explicit.flat.parameters))
        at = (x, ubar[:n_u], ubar[n_u:], kind.zeros(explicit.rhs.numel_in(3)), theta, t)
        guess, derivatives = [], explicit.variable_derivatives
        if explicit.near_variables is None or explicit.near_derivatives is None:
            xi = explicit.variables(*at)
        else:
            guess, derivatives = [kind.sym("guess", explicit.n_tears)], explicit.near_derivatives
            xi = explicit.near_variables(*at, *guess)[0]
        rates = derivatives(*at, *guess) if self._needs_rates else kind.zeros(explicit.flat.n)
        return kind, [x, ubar, theta, t, *guess], xi, rates

    @cached_property
    def _needs_rates(self) -> bool:
        used = ca.vertcat(*[ca.vec(getattr(self.events, name)) for name in PARTS])
        return bool(ca.depends_on(used, self.explicit.flat.derivatives))

    def _flat_arguments(self, symbols: list[Any]) -> list[Any]:
        """(u, w, θ, t) of the flat model."""
        _, ubar, theta, t = symbols[:4]
        n_u = len(self.explicit.flat.inputs)
        kind = type(t)
        return [ubar[:n_u], kind.zeros(len(self.explicit.flat.noises)), theta, t]

    def _expression(self, name: str, at: list[Any], switches: list[Any] | None = None) -> Any:
        flat, events = self.explicit.flat, self.events
        symbols = [
            flat.derivatives,
            flat.xi,
            flat.u,
            flat.w,
            flat.theta,
            flat.time,
            events.active,
            events.ticks,
        ]
        function = ca.Function(name, symbols, [getattr(events, name)])
        kind = type(at[1])
        chosen = switches or [kind.zeros(events.active.numel()), kind.zeros(events.ticks.numel())]
        return function(*at, *chosen)

    def _whole(self) -> tuple[list[Any], dict[str, Any]]:
        """Symbols (x, ū, θ, t, active, ticks) and perhaps the guess, and all `PARTS`."""
        kind, symbols, xi, rates = self._point()
        switches = [
            kind.sym("active", self.events.active.numel()),
            kind.sym("ticks", self.events.ticks.numel()),
        ]
        at = [rates, xi, *self._flat_arguments(symbols)]
        parts = {name: self._expression(name, at, switches) for name in PARTS}
        return [*symbols[:4], *switches, *symbols[4:]], parts

    @cached_property
    def whole(self) -> ca.Function:
        """(x, ū, θ, t, active, ticks) -> all `PARTS`."""
        symbols, parts = self._whole()
        return ca.Function("events", symbols, [ca.densify(parts[name]) for name in PARTS])

    @cached_property
    def _at(self) -> Evaluator:
        return Evaluator(self.whole)

    @cached_property
    def _clock(self) -> Evaluator:
        return Evaluator(self.along_time)

    @cached_property
    def _slopes(self) -> dict[str, Evaluator]:
        symbols, parts = self._whole()
        parts["restarted"] = parts["restarted"][:, 1]
        parts["samples"] = ca.vec(parts["samples"].T)
        found = {}
        for name in ("restarted", "assigned", "sources", "values", "wholes", "samples"):
            slopes = [ca.densify(ca.jacobian(parts[name], symbol)) for symbol in symbols[:4]]
            found[name] = Evaluator(ca.Function(f"slopes_of_{name}", symbols, slopes))
        return found

    @cached_property
    def _variables(self) -> Evaluator:
        _, symbols, xi, _ = self._point()
        slopes = ca.densify(ca.jacobian(xi, symbols[0]))
        return Evaluator(ca.Function("variables", symbols, [ca.densify(xi), slopes]))

    @cached_property
    def _rates(self) -> Evaluator:
        return self._of_near(self.explicit.rhs, 0)

    @cached_property
    def _outputs(self) -> Evaluator:
        return self._of_near(self.explicit.outputs, 1)

    def _of_near(self, plain: ca.Function, number: int) -> Evaluator:
        """The function `plain`, or that number of `near`, in the arguments used here: its value and the
        tears."""
        near = self.explicit.near
        function = plain if near is None else near[number]
        n, n_u, n_v, n_w, n_theta = (function.numel_in(i) for i in range(5))
        x, ubar = ca.MX.sym("x", n), ca.MX.sym("u", n_u + n_v)
        theta, t = ca.MX.sym("theta", n_theta), ca.MX.sym("t")
        guess = [] if near is None else [ca.MX.sym("guess", self.explicit.n_tears)]
        value = function.call([x, ubar[:n_u], ubar[n_u:], ca.MX.zeros(n_w), theta, t, *guess])
        results = [ca.densify(value[0]), value[1] if near is not None else ca.MX(0, 1)]
        return Evaluator(ca.Function("near", [x, ubar, theta, t, *guess], results))

    @cached_property
    def along_time(self) -> ca.Function:
        """(x, ū, θ) -> values at time zero and slopes along time of relations, then of whole parts."""
        kind, symbols, xi, rates = self._point()
        at = [rates, xi, *self._flat_arguments(symbols)]
        watched = ca.vertcat(self._expression("values", at), self._expression("wholes", at))
        slope = ca.jacobian(watched, symbols[3])
        zero = [ca.substitute(part, symbols[3], kind(0)) for part in (watched, slope)]
        return ca.Function("clock", [*symbols[:3], *symbols[4:]], [ca.densify(part) for part in zero])


_TABLES = ("restarted", "samples")
