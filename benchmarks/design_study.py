"""What designed recordings keep of what they promise: simulated by scipy, which shares nothing with daest.

    python benchmarks/design_study.py errors --runs 60         predicted against obtained standard errors
    python benchmarks/design_study.py rivals --runs 20         laws that a first recording cannot tell apart
    python benchmarks/design_study.py feedback --runs 40       standard errors of an unstable plant, held
    python benchmarks/design_study.py peers                    a D-optimal input beside pydex
    python benchmarks/design_study.py fermenter --runs 8       runs until a growth law is known

`--json FILE` keeps the result.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.signal import cont2discrete

from daest.design.aims import ParameterAim
from daest.design.design import Task, design
from daest.design.effects import Rival, leaving, rival_aim, with_effect
from daest.design.prepared import Subject, estimated_names, explainer
from daest.design.signals import multisine, random_binary, within
from daest.diagnosis.gates import GATES
from daest.errors import DaestError
from daest.estimation.identify import identify
from daest.machine import described
from daest.model.design import Limits, Range
from daest.model.experiment import Experiment
from daest.model.fit import IdentifyOptions
from daest.modelica.closed_loop import closed_loop
from daest.modelica.compile import compile_model
from daest.modelica.effects.catalogue import find_effects
from daest.modelica.places.sites import find_site

ROOT = Path(__file__).resolve().parents[1]
SERVO = {"d": 0.02, "c": 1.5, "J1": 6.3e-6, "J2": 0.02, "k": 0.06}
RESISTANCE, RATIO = 4.31617, 30.0
INERTIA, DAMPING, NOISE, PERIOD = 0.1, 0.12, 0.05, 0.05
LAWS = {
    "CoulombFriction": ("tau_c", lambda w, s: s * np.tanh(w / 0.01)),
    "ConstantLoad": ("tau_0", lambda w, s: s),
    "QuadraticDrag": ("k", lambda w, s: s * w * abs(w)),
}


def servo_matrices(d, c, J1, J2, k):
    J = J1 * RATIO**2
    A = [[0, 1, 0, 0], [-c / J, -(d + (RATIO * k) ** 2 / RESISTANCE) / J, c / J, d / J]]
    A += [[0, 0, 0, 1], [c / J2, d / J2, -c / J2, -d / J2]]
    return np.array(A), np.array([[0], [RATIO * k / RESISTANCE / J], [0], [0]])


def servo_outputs(u, period, noise, rng):
    """Speed and angle of the servo under a held voltage and a white torque of intensity `noise`."""
    A, B = servo_matrices(**SERVO)
    Ad, Bd, *_ = cont2discrete((A, B, np.eye(4), np.zeros((4, 1))), period, "zoh")
    G = np.array([[0.0], [0.0], [0.0], [1.0 / SERVO["J2"]]])
    both = expm(np.block([[-A, noise * G @ G.T], [np.zeros((4, 4)), A.T]]) * period)
    values, vectors = np.linalg.eigh(both[4:, 4:].T @ both[:4, 4:])
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    x, states = np.zeros(4), []
    for voltage in u:
        states.append(x)
        x = Ad @ x + Bd[:, 0] * voltage + root @ rng.standard_normal(4)
    return np.array(states)[:, [1, 2]] + rng.standard_normal((len(u), 2)) * [0.02, 0.01]


def errors(runs: int, seed: int) -> dict:
    """Ratio of the obtained spread to the predicted standard error, by noise of the process and parameter."""
    result = {}
    for noise in (0.0, 1e-4):
        flat = compile_model(ROOT / "examples" / "servo" / "Servo.mo").with_theta(SERVO | {"R": RESISTANCE})
        flat = replace(flat, noises=tuple(replace(w, intensity=noise) for w in flat.noises))
        allowed = Limits((Range("u", "V", -5.0, 5.0),), 10.0, 0.01, band=(0.0, 8.0), hold="zoh")
        subject = Subject(flat, estimated_names(flat), unknown_noise=True)
        driven = explainer(subject, allowed.period, "zoh")
        p = len(driven.coordinates)
        aim = ParameterAim(driven, tuple(range(5)), "D", np.zeros((p, p)))
        found = design(Task(aim, (subject,), allowed, is_short=True))
        options = IdentifyOptions(hold="zoh", method="pem" if noise else "oe", second_look=False)
        values = []
        for run in range(runs):
            y = servo_outputs(found.inputs[:, 0], 0.01, noise, np.random.default_rng([seed, run]))
            recording = Experiment("r", allowed.time, found.inputs, y, ("u",), ("omega", "phi"))
            values.append([q.value for q in identify(flat, [recording], options).parameters])
        spread = np.std(values, axis=0, ddof=1)
        predicted = found.expected.std_errors
        result[f"noise {noise:g}"] = {
            n: float(s / predicted[n]) for n, s in zip(predicted, spread, strict=True)
        }
        print(noise, found.families[0].family, result[f"noise {noise:g}"], flush=True)
    return {
        "obtained over predicted": result,
        "runs": runs,
        "standard error of a ratio": (2.0 * runs) ** -0.5,
    }


FALL = """\
model Fall "Runs away when left alone; a force without a pattern acts on it"
  parameter Real a(unit = "1/s") = 3 annotation(__Daest(estimate = true));
  parameter Real b = 2 annotation(__Daest(estimate = true));
  input Real u(start = 0);
  input Real w annotation(__Daest(noise = true, intensity = 0.01));
  output Real y annotation(__Daest(std = 0.05));
  Real x(start = 0);
equation
  der(x) = a*x + b*u + w;
  y = x;
end Fall;
"""
HOLD = """\
model Hold
  input Real y;
  input Real r;
  output Real u = 4*(r - y);
end Hold;
"""


def held(reference, rng):
    """Command and output of the sampled loop: the controller acts on what the noisy sensor says."""
    a, b, x, rows = 3.0, 2.0, 0.0, []
    grown = np.exp(a * PERIOD)
    spread = np.sqrt(0.01 * (grown**2 - 1.0) / (2.0 * a))
    for r in reference:
        y = x + 0.05 * rng.standard_normal()
        u = 4.0 * (r - y)
        rows.append((u, y))
        x = grown * x + (grown - 1.0) / a * b * u + spread * rng.standard_normal()
    return np.array(rows)


def feedback(runs: int, seed: int) -> dict:
    """An unstable plant: its controller's reference is designed, the plant is estimated from command and
    output."""
    with tempfile.TemporaryDirectory() as folder:
        models = []
        for name, text in (("Fall", FALL), ("Hold", HOLD)):
            path = Path(folder) / f"{name}.mo"
            path.write_text(text)
            models.append(compile_model(path))
    plant, controller = models
    allowed = Limits(
        (Range("r", "", -1.0, 1.0),), 20.0, PERIOD, (Range("u", "", -4.0, 4.0),), (0.0, 5.0), "zoh"
    )
    subject = Subject(closed_loop(plant, controller), ("a", "b"), unknown_noise=True)
    driven = explainer(subject, allowed.period, "zoh")
    p = len(driven.coordinates)
    aim = ParameterAim(driven, (0, 1), "D", np.zeros((p, p)))
    found = design(Task(aim, (subject,), allowed, seconds=5.0, commanded=("u",)))
    values, reached = [], []
    for run in range(runs):
        rows = held(found.inputs[:, 0], np.random.default_rng([seed, run]))
        one = Experiment("r", allowed.time, rows[:, :1], rows[:, 1:], ("u",), ("y",))
        fit = identify(plant, [one], IdentifyOptions(hold="zoh", method="pem", second_look=False))
        values.append([q.value for q in fit.parameters])
        reached.append(np.abs(rows[:, 0]).max())
    spread = dict(zip(("a", "b"), np.std(values, axis=0, ddof=1), strict=True))
    predicted = {name: found.expected.std_errors[name] for name in spread}
    return {
        "predicted": predicted,
        "obtained over predicted": {name: float(spread[name] / predicted[name]) for name in spread},
        "mean": np.mean(values, axis=0).tolist(),
        "largest command, median": float(np.median(reached)),
        "family": found.families[0].family,
        "runs": runs,
        "standard error of a ratio": (2.0 * runs) ** -0.5,
    }


def speeds(law, size, torque, rng):
    """Speed of the rotor under a held torque, with a hidden law."""
    w, result = 0.0, []
    for tau in torque:
        result.append(w)

        def rate(_, x, tau=tau):
            return [(tau - DAMPING * x[0] - LAWS[law][1](x[0], size)) / INERTIA]

        w = float(solve_ivp(rate, (0.0, PERIOD), [w], method="LSODA", rtol=1e-8, atol=1e-10).y[0, -1])
    return np.array(result)[:, None] + NOISE * rng.standard_normal((len(torque), 1))


def recording(name, inputs, law, size, rng):
    time = PERIOD * np.arange(len(inputs))
    return Experiment(name, time, inputs, speeds(law, size, inputs[:, 0], rng), ("tau",), ("w",))


def rotor():
    return compile_model(ROOT / "tests" / "design" / "models" / "Rotor.mo")


def grown(flat, law, size):
    effect = next(e for e in find_effects(law) if e.domain == "rotational")
    return with_effect(flat, effect, find_site(flat, "rotor.flange_a", effect), {LAWS[law][0]: size}, {})


def names_of(law):
    return ("J", "d", f"effect.{LAWS[law][0]}")


def fits(models, recordings):
    """Of every law, refitted to all recordings."""
    return {
        law: identify(flat, recordings, IdentifyOptions(estimate=names_of(law), method="oe", hold="zoh"))
        for law, flat in models.items()
    }


def decided(found):
    """The law that is ahead of all others by the margin, None where none is."""
    order = sorted(found, key=lambda law: -found[law].log_likelihood)
    ahead = found[order[0]].log_likelihood - found[order[1]].log_likelihood
    return order[0] if ahead > 0.5 * GATES.same_bic else None


def of_power(shape, allowed, rms):
    """The signal at the rms of another input, as far as the amplitude allows."""
    signal = within(allowed, shape.signal, keeps_form=True)
    return signal * min(1.0, rms / float(np.std(signal)))


def rivals(runs: int, seed: int) -> dict:
    """Laws that a recording in one direction leaves open; then a short designed one, with small torques."""
    flat, rows = rotor(), []
    allowed = Limits((Range("tau", "N.m", -0.12, 0.12),), 3.0, PERIOD, hold="zoh")
    for run in range(runs):
        rng = np.random.default_rng([seed, run])
        law = ("CoulombFriction", "ConstantLoad")[run % 2]
        size = float(np.exp(rng.uniform(np.log(0.04), np.log(0.12))))
        first = rng.uniform(0.3, 0.6, 25).repeat(20)[:481, None]
        start = recording("first", first, law, size, rng)
        models = {name: grown(flat, name, 0.05) for name in LAWS}
        before = fits(models, [start])
        if decided(before) is not None:
            rows.append({"law": law, "size": size, "first": decided(before) == law})
            continue
        best = max(fit.log_likelihood for fit in before.values())
        left = [
            Rival(
                name,
                leaving(models[name].with_theta(fit.theta), fit.simulated["estimation"].rms),
                names_of(name),
            )
            for name, fit in before.items()
            if fit.log_likelihood > best - 0.5 * GATES.same_bic
        ]
        aim, subjects = rival_aim(left, allowed, [first], 0.5 * GATES.same_bic, 0)
        found = design(Task(aim, subjects, allowed, (first,)))
        rms = float(np.std(found.inputs))
        played = {
            "designed": found.inputs,
            "multisine": of_power(list(multisine(allowed, run))[1], allowed, rms),
            "random binary": of_power(list(random_binary(allowed, run))[1], allowed, rms),
        }
        row = {"law": law, "size": size, "first": None, "expected": found.expected.value, "rms": rms}
        for name, inputs in played.items():
            second = recording("second", inputs, law, size, np.random.default_rng([seed, run, 1]))
            row[name] = decided(fits(models, [start, second]))
        rows.append(row)
        print(row, flush=True)
    open_cases = [row for row in rows if "designed" in row]
    right = {
        name: sum(row[name] == row["law"] for row in open_cases)
        for name in ("designed", "multisine", "random binary")
    }
    wrong = {
        name: sum(row[name] not in (None, row["law"]) for row in open_cases)
        for name in ("designed", "multisine", "random binary")
    }
    return {"cases": len(open_cases), "decided rightly": right, "decided wrongly": wrong, "rows": rows}


FERMENTER = """\
model Fermenter "Fed-batch fermenter whose growth law is open"
  parameter Real a(unit = "1/h", min = 0) = 0.3 annotation(__Daest(estimate = true));
  parameter Real b(min = 0) = 0.5 annotation(__Daest(estimate = true));
  parameter Real Y(min = 0) = 0.5;
  input Real F(unit = "l/h", start = 0.05);
  output Real x annotation(__Daest(std = 0.1));
  output Real s annotation(__Daest(std = 0.1));
  Real X(start = 1, fixed = true); Real S(start = 3, fixed = true); Real V(start = 5, fixed = true);
  Real mu(unit = "1/h");
equation
  mu = LAW;
  der(X) = mu*X - X*F/V;
  der(S) = (20 - S)*F/V - mu*X/Y;
  der(V) = F;
  x = X; s = S;
end Fermenter;
"""
GROWTH = {  # of the anchor arXiv 2604.01231 the true law, and peers of it
    "Monod": "a*S/(b + S)",
    "Tessier": "a*(1 - exp(-S/b))",
    "Contois": "a*S/(b*X + S)",
    "Moser": "a*S^2/(b^2 + S^2)",
    "linear": "0.1*a*S + 0.1*b",
}
FEED = Limits((Range("F", "l/h", 0.0, 0.3),), 15.0, 0.5, (Range("S", "", 0.02, 15.0),), (0.0, np.inf), "zoh")


def fermented(feed, rng):
    """Biomass and substrate under a held feed, with Monod's law."""
    state, rows = np.array([1.0, 3.0, 5.0]), []
    for F in feed:
        rows.append(state[:2])

        def rate(_, y, F=F):
            mu = 0.35 * y[1] / (0.6 + y[1])
            return [mu * y[0] - y[0] * F / y[2], (20.0 - y[1]) * F / y[2] - mu * y[0] / 0.5, F]

        state = solve_ivp(rate, (0.0, FEED.period), state, method="LSODA", rtol=1e-8, atol=1e-10).y[:, -1]
    return np.array(rows) + 0.1 * rng.standard_normal((len(feed), 2))


def fermenter(runs: int, seed: int) -> dict:
    """After a first run at two constant feeds: further runs until Monod's law is ahead of all others by the
    margin, of designed feeds, multisines and random binary ones."""
    models = {}
    with tempfile.TemporaryDirectory() as folder:
        for law, text in GROWTH.items():
            path = Path(folder) / "Fermenter.mo"
            path.write_text(FERMENTER.replace("LAW", text))
            models[law] = compile_model(path)
    options = IdentifyOptions(estimate=("a", "b"), method="oe", hold="zoh")
    known = fed_for_parameters(models["Monod"].with_theta({"a": 0.35, "b": 0.6}))
    print(known, flush=True)
    rows = []
    for run in range(runs):
        row = {}
        for kind in ("designed", "multisine", "random binary"):
            feeds = [np.where(FEED.time < 8.0, 0.03, 0.06)[:, None]]
            played: list[Experiment] = []
            for number in range(MOST_RUNS + 1):
                rng = np.random.default_rng([seed, run, number])
                y = fermented(feeds[number][:, 0], rng)
                played.append(Experiment(str(number), FEED.time, feeds[number], y, ("F",), ("x", "s")))
                found = {law: identify(flat, played, options) for law, flat in models.items()}
                said = decided(found)
                if said is not None:
                    break
                feeds.append(next_feed(kind, models, found, feeds, (run, number)))
            row[kind] = (said, number)
        rows.append(row)
        print(row, flush=True)
    return {"rows": rows, "times the best standard error": known}


def fed_for_parameters(flat) -> dict:
    """The value of the best feed of every family, for the parameters of Monod's law and the yield, over
    24 h, to that of the best of all."""
    allowed = replace(FEED, length=24.0)
    subject = Subject(flat, ("a", "b", "Y"))
    driven = explainer(subject, allowed.period, "zoh")
    aim = ParameterAim(driven, (0, 1, 2), "D", np.zeros((3, 3)))
    found = design(Task(aim, (subject,), allowed, seconds=15.0))
    return {p.family: p.value / found.families[0].value for p in found.families if p.inputs is not None}


MOST_RUNS = 5


def next_feed(kind, models, found, feeds, key):
    if kind != "designed":
        shapes = list((multisine if kind == "multisine" else random_binary)(FEED, 10 * key[0] + key[1]))
        return within(FEED, shapes[key[1] % len(shapes)].signal, keeps_form=True)
    best = max(fit.log_likelihood for fit in found.values())
    left = [
        Rival(law, models[law].with_theta(fit.theta), ("a", "b"))
        for law, fit in found.items()
        if fit.log_likelihood > best - 0.5 * GATES.same_bic
    ]
    aim, subjects = rival_aim(left, FEED, feeds, 0.5 * GATES.same_bic, 0)
    return design(Task(aim, subjects, FEED, tuple(feeds), seconds=5.0, is_short=True)).inputs


def peers() -> dict:
    """The law y = V u / (K + u) over 0 ≤ u ≤ 1, whose D-optimal designs measure half at u = 1 and half at
    u = K / (2K + 1)."""
    path = ROOT / "tests" / "design" / "models" / "Saturating.mo"
    subject = Subject(compile_model(path), ("V", "K"))
    allowed = Limits((Range("u", "", 0.0, 1.0),), 20.0, 0.1, hold="zoh")
    driven = explainer(subject, allowed.period, "zoh")
    aim = ParameterAim(driven, (0, 1), "D", np.zeros((2, 2)))
    found = design(Task(aim, (subject,), allowed))
    K = 0.3
    best = np.where(np.arange(allowed.time.size) % 2, 1.0, K / (2 * K + 1))[:, None]
    result = {
        "ours": found.families[0].value,
        "family": found.families[0].family,
        "analytic": aim.value(aim.merit(best)),
    }
    try:
        result["pydex"] = by_pydex(aim, allowed, K)
    except (ImportError, DaestError) as problem:
        result["pydex"] = f"not run: {problem}"
    return result


def by_pydex(aim, allowed, K):
    """The value of the design of pydex (Kusumo et al. 2022) on a grid of levels, played in turn."""
    from pydex.core.designer import Designer  # type: ignore[import-not-found]

    def simulate(ti_controls, model_parameters):
        V, half = model_parameters
        return np.array([V * ti_controls[0] / (half + ti_controls[0])])

    designer = Designer()
    designer.simulate = simulate
    designer.model_parameters = [1.0, K]
    designer.ti_controls_candidates = np.linspace(0.0, 1.0, 201)[:, None]
    designer.initialize(verbose=0)
    designer.design_experiment(designer.d_opt_criterion, write=False, package="scipy", optimizer="SLSQP")
    efforts = np.asarray(designer.efforts).ravel()
    counts = np.round(efforts / efforts.sum() * allowed.time.size).astype(int)
    levels = np.repeat(np.linspace(0.0, 1.0, 201), counts)
    inputs = np.resize(levels, allowed.time.size)[:, None]
    return {"value": aim.value(aim.merit(inputs)), "levels": np.linspace(0, 1, 201)[efforts > 1e-3].tolist()}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("part", choices=["errors", "rivals", "feedback", "peers", "fermenter"])
    parser.add_argument("--runs", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    parts = {"errors": errors, "rivals": rivals, "feedback": feedback, "fermenter": fermenter}
    result = peers() if given.part == "peers" else parts[given.part](given.runs, given.seed)
    text = json.dumps({**result, "machine": described()}, indent=2)
    print(text)
    if given.json:
        given.json.write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
