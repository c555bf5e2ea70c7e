"""FlatModels built by hand, equation by equation, for tests that must not depend on the Modelica compiler."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from itertools import pairwise

import casadi as ca

from daest.errors import Place
from daest.model.flat import FlatModel
from daest.model.parts import Equation, NoiseInput, Output, Parameter, Variable

FUNCTIONS = {"sin": ca.sin, "cos": ca.cos, "exp": ca.exp, "sqrt": ca.sqrt, "tanh": ca.tanh}
NAME = re.compile(r"der\(\s*([A-Za-z_][\w.]*)\s*\)|(?<![\w.])[A-Za-z_][\w.]*")


@dataclass
class Draft:
    """Equations of a model as text, collected component by component."""

    name: str
    parameters: dict[str, float] = field(default_factory=dict)
    unknowns: list[str] = field(default_factory=list)
    inputs: list[str] = field(default_factory=list)
    noises: dict[str, float | None] = field(default_factory=dict)
    outputs: dict[str, str] = field(default_factory=dict)  # name -> expression
    equations: list[Equation] = field(default_factory=list)
    starts: dict[str, float] = field(default_factory=dict)

    def component(self, origin: str, unknowns: str, equations: list[str]) -> None:
        """`unknowns` are local names, prefixed by `origin` here and in `equations`; others are global."""
        local = unknowns.split()
        self.unknowns += [f"{origin}.{name}" for name in local]
        for text in equations:
            full = NAME.sub(lambda m: _prefixed(m, origin, set(local)), text)
            self._add(full, "component", origin)

    def equation(self, text: str) -> None:
        self._add(text, "component", "")

    def connect(self, potential: str, flow: str, *connectors: str) -> None:
        """A connection set: potentials equal along the chain, flows sum to zero."""
        for a, b in pairwise(connectors):
            self._add(f"{a}.{potential} = {b}.{potential}", "connection", f"{a}, {b}")
        kind = "flow" if len(connectors) > 1 else "unconnected"
        total = " + ".join(f"{c}.{flow}" for c in connectors)
        self._add(f"{total} = 0", kind, ", ".join(connectors))

    def _add(self, text: str, kind: str, origin: str) -> None:
        place = Place(f"{self.name}.mo", len(self.equations) + 1)
        self.equations.append(Equation(text, kind, origin, place))

    def flat(self) -> FlatModel:
        symbols = {n: ca.SX.sym(n) for n in self._names()}
        ders = {n: ca.SX.sym(f"der({n})") for n in self.unknowns}
        residual = [_value(e.text, symbols, ders) for e in self.equations]

        def stack(names: list[str]) -> ca.SX:
            return ca.vertcat(ca.SX(0, 1), *[symbols[n] for n in names])

        return FlatModel(
            name=self.name,
            unknowns=tuple(Variable(n, start=self.starts.get(n)) for n in self.unknowns),
            inputs=tuple(Variable(n, start=self.starts.get(n)) for n in self.inputs),
            noises=tuple(NoiseInput(n, i) for n, i in self.noises.items()),
            parameters=tuple(Parameter(n, v) for n, v in self.parameters.items()),
            outputs=tuple(Output(n) for n in self.outputs),
            equations=tuple(self.equations),
            derivatives=ca.vertcat(ca.SX(0, 1), *[ders[n] for n in self.unknowns]),
            xi=stack(self.unknowns),
            u=stack(self.inputs),
            w=stack(list(self.noises)),
            theta=stack(list(self.parameters)),
            time=symbols["time"],
            residual=ca.vertcat(ca.SX(0, 1), *residual),
            output_expressions=ca.vertcat(
                ca.SX(0, 1), *[_value(t, symbols, ders) for t in self.outputs.values()]
            ),
        )

    def _names(self) -> list[str]:
        return ["time", *self.unknowns, *self.inputs, *self.noises, *self.parameters]


def _prefixed(match: re.Match, origin: str, local: set[str]) -> str:
    text, inner = match.group(0), match.group(1)
    if inner:
        return f"der({origin}.{inner})" if inner in local else text
    return f"{origin}.{text}" if text in local else text


def _value(text: str, symbols: dict[str, ca.SX], ders: dict[str, ca.SX]) -> ca.SX:
    """lhs - rhs of an equation, or the value of an expression."""
    used: dict[str, ca.SX] = {}

    def replace(match: re.Match) -> str:
        if match.group(0) in FUNCTIONS:
            return match.group(0)
        used[f"v{len(used)}"] = ders[match.group(1)] if match.group(1) else symbols[match.group(0)]
        return f"v{len(used) - 1}"

    parts = [NAME.sub(replace, side) for side in text.split("=")]
    values = [eval(part, {"__builtins__": {}}, {**used, **FUNCTIONS}) for part in parts]
    return ca.SX(values[0] - values[1] if len(values) == 2 else values[0])


SERVO = {"d": 5.43e-4, "c": 0.0362, "J1": 3.0e-6, "J2": 3.66e-4, "R": 4.5, "k": -0.06}
"""Initial values of Table 1 of the report, SI units."""

INERTIA = [
    "phi = flange_a.phi",
    "phi = flange_b.phi",
    "w = der(phi)",
    "a = der(w)",
]
INERTIA_UNKNOWNS = "phi w a flange_a.phi flange_a.tau flange_b.phi flange_b.tau"
COMPLIANT = ["phi_rel = flange_b.phi - flange_a.phi", "flange_b.tau = tau", "flange_a.tau = -tau"]
COMPLIANT_UNKNOWNS = "phi_rel tau flange_a.phi flange_a.tau flange_b.phi flange_b.tau"
ONE_PORT = ["v = p.v - n.v", "0 = p.i + n.i", "i = p.i"]
ONE_PORT_UNKNOWNS = "v i p.v p.i n.v n.i"


def report_servo(star: bool = False, noises: dict[str, str] | None = None, **values: float) -> FlatModel:
    """The servo of the report from separate components: 54 equations, index 2 in the spring.

    `star` writes three-way connections as pairs with the gear and the disc instead of as chains. `noises`
    maps a noise to the text of the equation that it is added to.
    """
    return servo_draft(star, noises, **values).flat()


def servo_draft(star: bool = False, noises: dict[str, str] | None = None, **values: float) -> Draft:
    m = Draft("ReportServo", parameters={**SERVO, "n": 30.0, **values}, inputs=["u"])
    m.component("resistor", ONE_PORT_UNKNOWNS, [*ONE_PORT, "R*i = v"])
    m.component("source", ONE_PORT_UNKNOWNS, [*ONE_PORT, "v = u"])
    m.component("ground", "p.v p.i", ["p.v = 0"])
    m.component(
        "emf",
        "v i w p.v p.i n.v n.i flange.phi flange.tau",
        [*ONE_PORT, "w = der(flange.phi)", "k*w = v", "flange.tau = -k*i"],
    )
    m.component("motor", INERTIA_UNKNOWNS, [*INERTIA, "J1*a = flange_a.tau + flange_b.tau"])
    m.component(
        "gear",
        "flange_a.phi flange_a.tau flange_b.phi flange_b.tau",
        ["flange_a.phi = n*flange_b.phi", "0 = n*flange_a.tau + flange_b.tau"],
    )
    m.component("spring", COMPLIANT_UNKNOWNS, [*COMPLIANT, "tau = c*phi_rel"])
    m.component(
        "damper", COMPLIANT_UNKNOWNS + " w_rel", [*COMPLIANT, "w_rel = der(phi_rel)", "tau = d*w_rel"]
    )
    m.component("disc", INERTIA_UNKNOWNS, [*INERTIA, "J2*a = flange_a.tau + flange_b.tau"])
    m.connect("v", "i", "source.n", "resistor.p")  # reversed: k is negative, as in the report
    m.connect("v", "i", "resistor.n", "emf.p")
    m.connect("phi", "tau", "emf.flange", "motor.flange_a")
    m.connect("phi", "tau", "motor.flange_b", "gear.flange_a")
    m.connect("phi", "tau", "disc.flange_b")
    before, after = (
        ("gear.flange_b", "spring.flange_a", "damper.flange_a"),
        (
            "spring.flange_b",
            "damper.flange_b",
            "disc.flange_a",
        ),
    )
    if star:
        before, after = (
            ("spring.flange_a", "gear.flange_b", "damper.flange_a"),
            (
                "spring.flange_b",
                "disc.flange_a",
                "damper.flange_b",
            ),
        )
    chains = [
        ("v", "i", "emf.n", "source.p", "ground.p"),
        ("phi", "tau", *before),
        ("phi", "tau", *after),
    ]
    for potential, flow, *connectors in chains:
        m.connect(potential, flow, *connectors)
    m.outputs = {"omega": "motor.w/n", "phi": "disc.phi"}
    for noise, text in (noises or {}).items():
        add_noise(m, noise, text)
    return m


def library_servo(**values: float) -> FlatModel:
    """The same servo as library components write it: supports, accelerations, sensors and a spring-damper
    with relative acceleration, which makes the index 3."""
    m = Draft("LibraryServo", parameters={**SERVO, "n": 30.0, **values}, inputs=["u"])
    m.component("resistor", ONE_PORT_UNKNOWNS + " R_actual", [*ONE_PORT, "R_actual = R", "v = R*i"])
    m.component("source", ONE_PORT_UNKNOWNS, [*ONE_PORT, "v = u"])
    m.component("ground", "p.v p.i", ["p.v = 0"])
    m.component(
        "emf",
        "v i phi w tau p.v p.i n.v n.i flange.phi flange.tau support.phi support.tau",
        [
            *ONE_PORT,
            "phi = flange.phi - support.phi",
            "w = der(phi)",
            "k*w = v",
            "tau = -k*i",
            "flange.tau = tau",
            "support.tau = -tau",
        ],
    )
    m.component("emfMount", "flange.phi flange.tau", ["flange.phi = 0"])
    m.component("motor", INERTIA_UNKNOWNS, [*INERTIA, "J1*a = flange_a.tau + flange_b.tau"])
    m.component(
        "gear",
        "phi_a phi_b flange_a.phi flange_a.tau flange_b.phi flange_b.tau support.phi support.tau",
        [
            "phi_a = flange_a.phi - support.phi",
            "phi_b = flange_b.phi - support.phi",
            "phi_a = n*phi_b",
            "0 = n*flange_a.tau + flange_b.tau",
            "support.tau = -flange_a.tau - flange_b.tau",
        ],
    )
    m.component("gearMount", "flange.phi flange.tau", ["flange.phi = 0"])
    m.component(
        "spring",
        COMPLIANT_UNKNOWNS + " w_rel a_rel tau_c tau_d",
        [
            *COMPLIANT,
            "w_rel = der(phi_rel)",
            "a_rel = der(w_rel)",
            "tau_c = c*phi_rel",
            "tau_d = d*w_rel",
            "tau = tau_c + tau_d",
        ],
    )
    m.component("disc", INERTIA_UNKNOWNS, [*INERTIA, "J2*a = flange_a.tau + flange_b.tau"])
    m.component("speed", "w flange.phi flange.tau", ["w = der(flange.phi)", "flange.tau = 0"])
    m.component("angle", "phi flange.phi flange.tau", ["phi = flange.phi", "flange.tau = 0"])
    m.connect("v", "i", "source.n", "resistor.p")
    m.connect("v", "i", "resistor.n", "emf.p")
    m.connect("v", "i", "emf.n", "source.p", "ground.p")
    m.connect("phi", "tau", "emf.support", "emfMount.flange")
    m.connect("phi", "tau", "gear.support", "gearMount.flange")
    m.connect("phi", "tau", "emf.flange", "motor.flange_a")
    m.connect("phi", "tau", "motor.flange_b", "gear.flange_a")
    m.connect("phi", "tau", "gear.flange_b", "spring.flange_a", "speed.flange")
    m.connect("phi", "tau", "spring.flange_b", "disc.flange_a")
    m.connect("phi", "tau", "disc.flange_b", "angle.flange")
    m.outputs = {"omega": "speed.w", "phi": "angle.phi"}
    return m.flat()


def servo_polynomials(
    d: float, c: float, J1: float, J2: float, R: float, k: float, n: float = 30.0
) -> tuple[list[float], list[float]]:
    """Numerator and denominator, highest power first, from voltage to the speed after the gear: report (10).

    Derived by hand: J1 n² R s² + n² k² s acts on the gear angle beside the spring and disc. With n = 30 the
    coefficients are those of the report.
    """
    num = [-n * k * J2, -n * k * d, -n * k * c]
    den = [
        n**2 * R * J1 * J2,
        n**2 * J2 * k**2 + n**2 * R * J1 * d + J2 * R * d,
        n**2 * d * k**2 + n**2 * R * J1 * c + J2 * R * c,
        n**2 * c * k**2,
    ]
    return num, den


def add_noise(draft: Draft, noise: str, text: str, intensity: float | None = 1e-3) -> None:
    """Add a white noise to the right hand side of the equation with this text."""
    index = [e.text for e in draft.equations].index(text)
    old = draft.equations[index]
    draft.noises[noise] = intensity
    draft.equations[index] = Equation(f"{text} + {noise}", old.kind, old.origin, old.place)
