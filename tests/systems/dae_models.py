"""Flat models built by hand, equation by equation, as a Modelica compiler would list them."""

from __future__ import annotations

import casadi as ca

from daest.errors import Place
from daest.model.flat import FlatModel
from daest.model.parts import Equation, NoiseInput, Output, Parameter, Variable


class FlatBuilder:
    """Collects the parts of a FlatModel; the equation's line is its number."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.symbols: dict[str, ca.SX] = {}
        self.rates: dict[str, ca.SX] = {}
        self.unknowns: list[Variable] = []
        self.inputs: list[Variable] = []
        self.noises: list[NoiseInput] = []
        self.parameters: list[Parameter] = []
        self.outputs: list[tuple[Output, ca.SX]] = []
        self.equations: list[tuple[Equation, ca.SX]] = []
        self.initial: list[tuple[Equation, ca.SX]] = []
        self.time = ca.SX.sym("time")

    def __getitem__(self, name: str) -> ca.SX:
        return self.symbols[name]

    def der(self, name: str) -> ca.SX:
        return self.rates[name]

    def unknown(self, name: str, unit: str = "", **attributes) -> ca.SX:
        self.unknowns.append(Variable(name, unit, **attributes))
        self.rates[name] = ca.SX.sym(f"der({name})")
        return self._symbol(name)

    def input(self, name: str, unit: str = "") -> ca.SX:
        self.inputs.append(Variable(name, unit, start=0.0))
        return self._symbol(name)

    def noise(self, name: str, intensity: float | None = None) -> ca.SX:
        self.noises.append(NoiseInput(name, intensity))
        return self._symbol(name)

    def parameter(self, name: str, value: float, **attributes) -> ca.SX:
        self.parameters.append(Parameter(name, value, **attributes))
        return self._symbol(name)

    def output(self, name: str, expression: ca.SX, std: float | None = None) -> None:
        self.outputs.append((Output(name, noise_std=std), expression))

    def equation(self, text: str, lhs, rhs=0, kind="component", origin: str = "") -> None:
        place = Place(f"{self.name}.mo", len(self.equations) + 1)
        self.equations.append((Equation(text, kind, origin or self.name, place), ca.SX(lhs - rhs)))

    def initial_equation(self, text: str, lhs, rhs=0) -> None:
        self.initial.append((Equation(text, "component", self.name), ca.SX(lhs - rhs)))

    def connect(self, potentials: list[str], flows: list[str]) -> None:
        """Potentials equal pair by pair, flows sum to zero."""
        for other in potentials[1:]:
            text = f"{potentials[0]} = {other}"
            self.equation(text, self[potentials[0]], self[other], "connection", text)
        total = sum((self[name] for name in flows[1:]), self[flows[0]])
        self.equation(" + ".join(flows) + " = 0", total, 0, "flow")

    def _symbol(self, name: str) -> ca.SX:
        self.symbols[name] = ca.SX.sym(name)
        return self.symbols[name]

    def build(self) -> FlatModel:
        def column(parts) -> ca.SX:
            return ca.vertcat(ca.SX(0, 1), *parts)

        return FlatModel(
            name=self.name,
            unknowns=tuple(self.unknowns),
            inputs=tuple(self.inputs),
            noises=tuple(self.noises),
            parameters=tuple(self.parameters),
            outputs=tuple(output for output, _ in self.outputs),
            equations=tuple(equation for equation, _ in self.equations),
            derivatives=column(self.rates[v.name] for v in self.unknowns),
            xi=column(self[v.name] for v in self.unknowns),
            u=column(self[v.name] for v in self.inputs),
            w=column(self[v.name] for v in self.noises),
            theta=column(self[v.name] for v in self.parameters),
            time=self.time,
            residual=column(residual for _, residual in self.equations),
            output_expressions=column(expression for _, expression in self.outputs),
            initial_equations=tuple(equation for equation, _ in self.initial),
            initial_residual=column(residual for _, residual in self.initial),
        )


def _one_port(b: FlatBuilder, name: str) -> None:
    for pin in ("p", "n"):
        b.unknown(f"{name}.{pin}.v", "V")
        b.unknown(f"{name}.{pin}.i", "A")
    b.unknown(f"{name}.v", "V")
    b.unknown(f"{name}.i", "A")
    b.equation(f"{name}.v = p.v - n.v", b[f"{name}.v"], b[f"{name}.p.v"] - b[f"{name}.n.v"])
    b.equation(f"{name}.i = p.i", b[f"{name}.i"], b[f"{name}.p.i"])
    b.equation(f"{name}: p.i + n.i = 0", b[f"{name}.p.i"] + b[f"{name}.n.i"])


def _flanges(b: FlatBuilder, name: str, flanges: tuple[str, ...] = ("flange_a", "flange_b")) -> None:
    for flange in flanges:
        b.unknown(f"{name}.{flange}.phi", "rad")
        b.unknown(f"{name}.{flange}.tau", "N.m", is_flow=True)


def _inertia(b: FlatBuilder, name: str, parameter: str, value: float, torque: ca.SX | float = 0.0) -> None:
    inertia = b.parameter(parameter, value, unit="kg.m2")
    _flanges(b, name)
    phi = b.unknown(f"{name}.phi", "rad", start=0.0)
    speed = b.unknown(f"{name}.w", "rad/s", start=0.0)
    b.unknown(f"{name}.a", "rad/s2")
    a_tau, b_tau = b[f"{name}.flange_a.tau"], b[f"{name}.flange_b.tau"]
    b.equation(f"{name}.phi = flange_a.phi", phi, b[f"{name}.flange_a.phi"])
    b.equation(f"{name}.phi = flange_b.phi", phi, b[f"{name}.flange_b.phi"])
    b.equation(f"{name}.w = der(phi)", speed, b.der(f"{name}.phi"))
    b.equation(f"{name}.a = der(w)", b[f"{name}.a"], b.der(f"{name}.w"))
    b.equation(f"{name}: J*a = tau", inertia * b[f"{name}.a"], a_tau + b_tau + torque)


def servo(with_noise: bool = False) -> FlatModel:
    """The report's servo: source, resistor, EMF, ground, rotor, gear, spring and damper in parallel, disc.

    Outputs omega (speed after the gear) and phi (angle of the disc). Noise: torque on the disc."""
    b = FlatBuilder("Servo")
    u = b.input("u", "V")
    resistance, k = b.parameter("R", 4.6), b.parameter("k", 0.06)
    ratio, c, d = b.parameter("n", 30.0), b.parameter("c", 0.0362), b.parameter("d", 5.43e-4)
    for name in ("source", "resistor"):
        _one_port(b, name)
    b.equation("source.v = u", b["source.v"], u)
    b.equation("R*i = v", resistance * b["resistor.i"], b["resistor.v"])
    _one_port(b, "emf")
    _flanges(b, "emf", ("flange",))
    b.unknown("emf.w", "rad/s")
    b.equation("emf.w = der(flange.phi)", b["emf.w"], b.der("emf.flange.phi"))
    b.equation("k*w = v", k * b["emf.w"], b["emf.v"])
    b.equation("flange.tau = -k*i", b["emf.flange.tau"], -k * b["emf.i"])
    b.unknown("ground.p.v")
    b.unknown("ground.p.i")
    b.equation("ground.p.v = 0", b["ground.p.v"])
    _inertia(b, "rotor", "J1", 3e-6)
    _flanges(b, "gear")
    b.equation("flange_a.phi = n*flange_b.phi", b["gear.flange_a.phi"], ratio * b["gear.flange_b.phi"])
    b.equation(
        "0 = n*flange_a.tau + flange_b.tau", 0, ratio * b["gear.flange_a.tau"] + b["gear.flange_b.tau"]
    )
    for name, law in (("spring", c), ("damper", d)):
        _flanges(b, name)
        relative = b.unknown(f"{name}.phi_rel", "rad")
        tau = b.unknown(f"{name}.tau", "N.m")
        b.equation(f"{name}.phi_rel", relative, b[f"{name}.flange_b.phi"] - b[f"{name}.flange_a.phi"])
        b.equation(f"{name}.flange_b.tau = tau", b[f"{name}.flange_b.tau"], tau)
        b.equation(f"{name}.flange_a.tau = -tau", b[f"{name}.flange_a.tau"], -tau)
        rate = relative if name == "spring" else b.der("damper.phi_rel")
        b.equation(f"{name} law", tau, law * rate)
    _inertia(b, "disc", "J2", 3.66e-4, b.noise("w_disc", 1e-6) if with_noise else 0.0)
    b.connect(["source.p.v", "resistor.p.v"], ["source.p.i", "resistor.p.i"])
    b.connect(["resistor.n.v", "emf.p.v"], ["resistor.n.i", "emf.p.i"])
    b.connect(["emf.n.v", "source.n.v", "ground.p.v"], ["emf.n.i", "source.n.i", "ground.p.i"])
    b.connect(["emf.flange.phi", "rotor.flange_a.phi"], ["emf.flange.tau", "rotor.flange_a.tau"])
    b.connect(["rotor.flange_b.phi", "gear.flange_a.phi"], ["rotor.flange_b.tau", "gear.flange_a.tau"])
    three = ("gear.flange_b", "spring.flange_a", "damper.flange_a")
    b.connect([f"{f}.phi" for f in three], [f"{f}.tau" for f in three])
    three = ("spring.flange_b", "damper.flange_b", "disc.flange_a")
    b.connect([f"{f}.phi" for f in three], [f"{f}.tau" for f in three])
    b.equation("disc.flange_b.tau = 0", b["disc.flange_b.tau"], kind="unconnected")
    b.output("omega", b["rotor.w"] / ratio, std=0.01)
    b.output("phi", b["disc.phi"], std=0.001)
    return b.build()


def rc_pair() -> FlatModel:
    """Two capacitors and two resistors driven by a voltage: a two-state linear model with a closed form.

    C1 der(v1) = (u - v1)/R1 - (v1 - v2)/R2 + w,  C2 der(v2) = (v1 - v2)/R2."""
    b = FlatBuilder("RcPair")
    u, w = b.input("u", "V"), b.noise("w", 1e-3)
    r1, r2 = b.parameter("R1", 2.0), b.parameter("R2", 3.0)
    c1, c2 = b.parameter("C1", 0.5), b.parameter("C2", 0.25)
    v1, v2 = b.unknown("v1", "V", start=0.0, fixed=True), b.unknown("v2", "V", start=1.0, fixed=True)
    i1, i2 = b.unknown("i1", "A"), b.unknown("i2", "A")
    b.equation("R1*i1 = u - v1", r1 * i1, u - v1)
    b.equation("R2*i2 = v1 - v2", r2 * i2, v1 - v2)
    b.equation("C1*der(v1) = i1 - i2 + w", c1 * b.der("v1"), i1 - i2 + w)
    b.equation("C2*der(v2) = i2", c2 * b.der("v2"), i2)
    b.output("y", v2, std=0.05)
    return b.build()


def pendulum(x: float = 0.6, y: float = -0.8) -> FlatModel:
    """A point mass on a rod in Cartesian coordinates, with friction in the joint and a push u: index 3."""
    b = FlatBuilder("Pendulum")
    push, mass, length = b.input("u", "N"), b.parameter("m", 0.5), b.parameter("L", 1.0)
    px, py = b.unknown("x", "m", start=x, fixed=True), b.unknown("y", "m", start=y)
    vx, vy = b.unknown("vx", "m/s", start=0.0, fixed=True), b.unknown("vy", "m/s", start=0.0)
    force = b.unknown("F", "N/m")
    b.equation("der(x) = vx", b.der("x"), vx)
    b.equation("der(y) = vy", b.der("y"), vy)
    b.equation("m*der(vx) = -F*x - 0.2*vx + u", mass * b.der("vx"), -force * px - 0.2 * vx + push)
    b.equation("m*der(vy) = -F*y - 0.2*vy - m*9.81", mass * b.der("vy"), -force * py - 0.2 * vy - mass * 9.81)
    b.equation("x^2 + y^2 = L^2", px**2 + py**2, length**2)
    b.output("angle", ca.atan2(px, -py))
    return b.build()


def driven_position(noise_at: str = "") -> FlatModel:
    """A mass whose position is the input, pulled by a spring to a second mass: needs u' and u''.

    `noise_at`: "position" puts white noise on the position, which differentiates it; "force" on the force."""
    b = FlatBuilder("Driven")
    u, w = b.input("u", "m"), b.noise("w", 1e-4) if noise_at else ca.SX(0)
    mass, c = b.parameter("m", 2.0), b.parameter("c", 8.0)
    s1, v1, a1, force = b.unknown("s1"), b.unknown("v1"), b.unknown("a1"), b.unknown("f")
    s2, v2 = b.unknown("s2", start=0.0, fixed=True), b.unknown("v2", start=0.0, fixed=True)
    b.equation("s1 = u", s1, u + (w if noise_at == "position" else 0))
    b.equation("v1 = der(s1)", v1, b.der("s1"))
    b.equation("a1 = der(v1)", a1, b.der("v1"))
    b.equation("m*a1 = f + c*(s2 - s1)", mass * a1, force + c * (s2 - s1) + (w if noise_at == "force" else 0))
    b.equation("der(s2) = v2", b.der("s2"), v2)
    b.equation("m*der(v2) = c*(s1 - s2) - v2", mass * b.der("v2"), c * (s1 - s2) - v2)
    b.output("force", force)
    b.output("s2", s2)
    return b.build()


def cubic_loop() -> FlatModel:
    """A capacitor discharged through a cubic resistor: a nonlinear algebraic equation z + z^3 = x."""
    b = FlatBuilder("Cubic")
    u, a = b.input("u"), b.parameter("a", 1.0)
    x, z, y = b.unknown("x", start=2.0, fixed=True), b.unknown("z"), b.unknown("q")
    b.equation("der(x) = u - z", b.der("x"), u - z)
    b.equation("q + a*z^3 = x", y + a * z**3, x)
    b.equation("q = z", y - z, 0.1 * ca.sin(y))
    b.output("y", z)
    return b.build()


def resistor_ladder(n: int) -> FlatModel:
    """n nodes in a chain of resistors between two capacitors, every node also tied to a distant one: a linear
    loop that cannot be solved node by node."""
    b = FlatBuilder("Ladder")
    u, conductance = b.input("u"), b.parameter("g", 0.7)
    left, right = b.unknown("left", start=0.0, fixed=True), b.unknown("right", start=0.0, fixed=True)
    nodes = [b.unknown(f"v{i}") for i in range(n)]
    chain = [left, *nodes, right]
    for i in range(1, n + 1):
        current = conductance * (chain[i - 1] - chain[i]) + 2.0 * (chain[i + 1] - chain[i])
        far = chain[(i + 3) % len(chain)]
        b.equation(f"node {i}", current + 0.3 * (far - chain[i]))
    b.equation("left", b.der("left"), u - left + conductance * (nodes[0] - left))
    b.equation("right", b.der("right"), 2.0 * (nodes[-1] - right))
    b.output("y", right)
    return b.build()


def rigid_train(n_masses: int) -> FlatModel:
    """Masses in groups of three, rigid inside a group, springs between groups: large, index 3."""
    b = FlatBuilder("Train")
    u, c = b.input("u"), b.parameter("c", 5.0)
    for i in range(n_masses):
        b.unknown(f"m{i}.s", "m")
        b.unknown(f"m{i}.v", "m/s")
        b.unknown(f"m{i}.a", "m/s2")
        b.unknown(f"f{i}", "N")  # force on the left end of mass i
    for i in range(n_masses):
        right = b[f"f{i + 1}"] if i + 1 < n_masses else 0
        b.equation(f"v{i}", b[f"m{i}.v"], b.der(f"m{i}.s"))
        b.equation(f"a{i}", b[f"m{i}.a"], b.der(f"m{i}.v"))
        b.equation(f"newton {i}", (1.0 + 0.1 * i) * b[f"m{i}.a"], b[f"f{i}"] - right)
        if i == 0:
            b.equation("f0 = u", b["f0"], u)
        elif i % 3 == 0:
            stretch = b[f"m{i - 1}.s"] - b[f"m{i}.s"]
            rate = b[f"m{i - 1}.v"] - b[f"m{i}.v"]
            b.equation(f"spring {i}", b[f"f{i}"], c * stretch + 0.1 * rate)
        else:
            b.equation(f"rigid {i}", b[f"m{i}.s"], b[f"m{i - 1}.s"])
    b.output("y", b[f"m{n_masses - 1}.s"])
    return b.build()
