"""Small models for the FMU tests, built by hand so that the tests do not depend on the Modelica compiler."""

import casadi as ca
import numpy as np
import scipy.integrate
import scipy.linalg

from daest.errors import Place
from daest.model.flat import FlatModel
from daest.model.parts import DerivedParameter, Equation, NoiseInput, Output, Parameter, Variable


def geared_drive() -> FlatModel:
    """Two inertias behind a gear, a spring with damper, a third inertia: index 3, four states.

    motor.J motor.a = tau + w - torque, motor.phi = n gear.phi, gear torque n torque, spring to disc.phi.
    """
    names = [
        "motor.phi",
        "motor.w",
        "motor.a",
        "gear.phi",
        "gear.tau",
        "torque",
        "spring.tau",
        "disc.phi",
        "disc.w",
    ]
    units = ["rad", "rad/s", "rad/s2", "rad", "N.m", "N.m", "N.m", "rad", "rad/s"]
    xi, dxi = _symbols(names), _symbols([f"der({n})" for n in names])
    u, w, t = ca.SX.sym("tau"), ca.SX.sym("w"), ca.SX.sym("time")
    theta = _symbols(["J1", "J2", "c", "d", "n"])
    J1, J2, c, d, n = ca.vertsplit(theta)
    phi1, w1, a1, phi2, tau2, torque, spring, phi3, w3 = ca.vertsplit(xi)
    rows = [
        (w1 - dxi[0], "motor.w = der(motor.phi)"),
        (a1 - dxi[1], "motor.a = der(motor.w)"),
        (J1 * a1 - (u + w - torque), "motor.J*motor.a = tau + w - torque"),
        (phi1 - n * phi2, "motor.phi = n*gear.phi"),
        (tau2 - n * torque, "gear.tau = n*torque"),
        (tau2 - spring, "gear.tau = spring.tau"),
        (
            spring - (c * (phi2 - phi3) + d * (dxi[3] - w3)),
            "spring.tau = c*(gear.phi - disc.phi) + d*(der(gear.phi) - disc.w)",
        ),
        (w3 - dxi[7], "disc.w = der(disc.phi)"),
        (J2 * dxi[8] - spring, "J2*der(disc.w) = spring.tau"),
    ]
    return FlatModel(
        name="Lab.GearedDrive",
        description="Motor, gear, spring & disc",
        unknowns=tuple(
            Variable(
                name,
                unit,
                f"Value of {name}",
                start=0.1 if name == "disc.phi" else None,
                place=Place("Drive.mo", i + 3),
            )
            for i, (name, unit) in enumerate(zip(names, units, strict=True))
        ),
        inputs=(Variable("tau", "N.m", "Motor torque", start=0.0, min=-1.0, max=1.0, nominal=0.1),),
        noises=(NoiseInput("w", 1e-4, "N.m", "Torque noise", estimate=True),),
        parameters=(
            Parameter("J1", 0.02, "kg.m2", "Motor inertia", min=0.0),
            Parameter("J2", 0.5, "kg.m2", "Disc inertia", min=1e-9, estimate=True, scale="log"),
            Parameter("c", 3.0, "N.m/rad", "Stiffness", min=0.0, estimate=True),
            Parameter("d", 0.2, "N.m.s/rad", "Damping", min=0.0),
            Parameter("n", 5.0, "1", "Gear ratio"),
        ),
        outputs=(
            Output("disc.w", "rad/s", "Speed of the disc", noise_std=0.01),
            Output("y", "deg", 'Angle of the disc, with "quotes" < & >', estimate_noise=False),
        ),
        equations=tuple(
            Equation(text, "component", text.split(".")[0], Place("Drive.mo", 20 + i, 3))
            for i, (_, text) in enumerate(rows)
        ),
        derivatives=dxi,
        xi=xi,
        u=u,
        w=w,
        theta=theta,
        time=t,
        residual=ca.vertcat(*[row for row, _ in rows]),
        output_expressions=ca.vertcat(w3, phi3 * 180 / np.pi),
        derived_parameters=(DerivedParameter("k_total", "c*n", "N.m/rad"),),
        derived_values=ca.vertcat(c * n),
        source="Drive.mo",
    )


def _symbols(names: list[str]) -> ca.SX:
    return ca.vertcat(*[ca.SX.sym(name) for name in names])


def tank() -> FlatModel:
    """A nonlinear model with an algebraic variable: q = k sqrt(h² + 0.01), der(h) = sin(t) u - q/area."""
    names = ["h[1]", "q"]
    xi, dxi = _symbols(names), _symbols(["der(h)", "der(q)"])
    u, t, theta = ca.SX.sym("u"), ca.SX.sym("time"), _symbols(["area", "k"])
    rows = [dxi[0] * theta[0] - (ca.sin(t) * u - xi[1]), xi[1] - theta[1] * ca.sqrt(xi[0] ** 2 + 0.01)]
    texts = ["area*der(h[1]) = sin(time)*u - q", "q = k*sqrt(h[1]^2 + 0.01)"]
    return FlatModel(
        name="Tank",
        unknowns=(Variable("h[1]", "m", start=0.5), Variable("q", "m3/s")),
        inputs=(Variable("u", "m3/s", start=0.25),),
        noises=(),
        parameters=(Parameter("area", 2.0, "m2"), Parameter("k", 0.3)),
        outputs=(Output("level", "m"),),
        equations=tuple(Equation(text, "component", "") for text in texts),
        derivatives=dxi,
        xi=xi,
        u=u,
        w=ca.SX(0, 1),
        theta=theta,
        time=t,
        residual=ca.vertcat(*rows),
        output_expressions=xi[0] + 0 * t,
    )


def drive_state_space(J1=0.02, J2=0.5, c=3.0, d=0.2, n=5.0):
    """ẋ = A x + B τ for x = (gear.phi, der(gear.phi), disc.phi, disc.w), written down by hand."""
    inertia = n * n * J1
    A = np.array([[0, 1, 0, 0], [-c, -d, c, d], [0, 0, 0, 1], [c, d, -c, -d]], dtype=float)
    A[1] /= inertia
    A[3] /= J2
    return A, np.array([0, n / inertia, 0, 0])


def drive_response(time, offset, slope, phi0, **parameters):
    """Exact x(t) for τ = offset + slope t: matrix exponential of the plant and the ramp together."""
    A, B = drive_state_space(**parameters)
    joint = np.zeros((6, 6))
    joint[:4, :4], joint[:4, 4], joint[4, 5] = A, B, 1.0
    start = np.array([0, 0, phi0, 0, offset, slope])
    return np.array([(scipy.linalg.expm(joint * t) @ start)[:4] for t in time])


def tank_response(time, u, h0=0.5, area=2.0, k=0.3):
    """The tank by an independent integrator (Radau, tolerance 1e-11)."""

    def rate(t, h):
        return (np.sin(t) * u - k * np.sqrt(h**2 + 0.01)) / area

    return scipy.integrate.solve_ivp(
        rate, (time[0], time[-1]), [h0], "LSODA", time, rtol=1e-11, atol=1e-12
    ).y[0]
