"""Large trains of inertias as equations, without a Modelica compiler: what it makes of the models `Chain`
and `Rigid` of `tests/systems/models`, which takes it minutes above 20 000 equations. All inertias and springs
have one inertia, stiffness and damping."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise

import casadi as ca

from daest.model.flat import FlatModel
from daest.model.parts import Equation, Output, Parameter, Variable

INERTIA, STIFFNESS, DAMPING = 0.1, 10.0, 0.1  # of every inertia [kg.m2] and spring [N.m/rad, N.m.s/rad]


@dataclass
class Train:
    """Unknowns, parameters and equations under way."""

    xi: dict[str, ca.SX] = field(default_factory=dict)
    rates: dict[str, ca.SX] = field(default_factory=dict)
    flows: set[str] = field(default_factory=set)
    theta: dict[str, tuple[ca.SX, float]] = field(default_factory=dict)
    equations: list[tuple[Equation, ca.SX]] = field(default_factory=list)

    def unknowns(self, owner: str, *names: str) -> list[ca.SX]:
        for name in (f"{owner}.{name}" for name in names):
            self.xi[name], self.rates[name] = ca.SX.sym(name), ca.SX.sym(f"der({name})")
        return [self.xi[f"{owner}.{name}"] for name in names]

    def flange(self, name: str) -> tuple[ca.SX, ca.SX]:
        """Angle and torque of a flange."""
        phi, tau = self.unknowns(name, "phi", "tau")
        self.flows.add(f"{name}.tau")
        return phi, tau

    def parameter(self, name: str, value: float) -> ca.SX:
        return self.theta.setdefault(name, (ca.SX.sym(name), value))[0]

    def equal(self, owner: str, *residuals: ca.SX) -> None:
        for residual in residuals:
            self.equations.append((Equation(str(residual), "component", owner), residual))

    def connect(self, one: str, other: str) -> None:
        both = f"{one}, {other}"
        phi = self.xi[f"{one}.phi"] - self.xi[f"{other}.phi"]
        tau = self.xi[f"{one}.tau"] + self.xi[f"{other}.tau"]
        self.equations += [
            (Equation(str(phi), "connection", both), phi),
            (Equation(str(tau), "flow", both), tau),
        ]

    def inertia(self, name: str) -> None:
        (phi_a, tau_a), (phi_b, tau_b) = self.flange(f"{name}.flange_a"), self.flange(f"{name}.flange_b")
        phi, w, a = self.unknowns(name, "phi", "w", "a")
        J, rate = self.parameter("J", INERTIA), self.rates
        self.equal(
            name,
            phi - phi_a,
            phi - phi_b,
            w - rate[f"{name}.phi"],
            a - rate[f"{name}.w"],
            J * a - tau_a - tau_b,
        )

    def spring(self, name: str) -> None:
        (phi_a, tau_a), (phi_b, tau_b) = self.flange(f"{name}.flange_a"), self.flange(f"{name}.flange_b")
        phi, w, a, tau, elastic, damped = self.unknowns(
            name, "phi_rel", "w_rel", "a_rel", "tau", "tau_c", "tau_d"
        )
        c, d = self.parameter("c", STIFFNESS), self.parameter("d", DAMPING)
        self.equal(
            name,
            phi - phi_b + phi_a, w - self.rates[f"{name}.phi_rel"], a - self.rates[f"{name}.w_rel"],
            tau_b - tau, tau_a + tau, elastic - c * phi, damped - d * w, tau - elastic - damped,
        )  # fmt: skip

    def flat(self, name: str, u: ca.SX, output: ca.SX) -> FlatModel:
        return FlatModel(
            name=name,
            unknowns=tuple(Variable(each, is_flow=each in self.flows) for each in self.xi),
            inputs=(Variable("u"),),
            noises=(),
            parameters=tuple(Parameter(each, value) for each, (_, value) in self.theta.items()),
            outputs=(Output("phi"),),
            equations=tuple(equation for equation, _ in self.equations),
            derivatives=ca.vertcat(*self.rates.values()),
            xi=ca.vertcat(*self.xi.values()),
            u=u,
            w=ca.SX(0, 1),
            theta=ca.vertcat(*(symbol for symbol, _ in self.theta.values())),
            time=ca.SX.sym("time"),
            residual=ca.vertcat(*(residual for _, residual in self.equations)),
            output_expressions=output,
        )


def train(name: str, n: int) -> FlatModel:
    """n inertias with springs between them (`Chain`), or rigidly coupled (`Rigid`), a torque at one end and a
    spring to the ground at the other."""
    made, u = Train(), ca.SX.sym("u")
    _, tau = made.flange("torque.flange")
    support, given = made.unknowns("torque", "phi_support", "tau")
    made.equal("torque", support, tau + given, given - u)
    links = [f"inertia[{i + 1}]" for i in range(n)]
    springs = [f"spring[{i + 1}]" for i in range(n)] if name == "Chain" else ["spring"]
    for link in links:
        made.inertia(link)
    for spring in springs:
        made.spring(spring)
    phi, _ = made.flange("fixed.flange")
    made.equal("fixed", phi)
    parts = (
        [part for pair in zip(links, springs, strict=True) for part in pair]
        if name == "Chain"
        else [*links, *springs]
    )
    made.connect("torque.flange", f"{parts[0]}.flange_a")
    for left, right in pairwise(parts):
        made.connect(f"{left}.flange_b", f"{right}.flange_a")
    made.connect(f"{parts[-1]}.flange_b", "fixed.flange")
    return made.flat(name, u, made.xi[f"{links[-1]}.phi"])
