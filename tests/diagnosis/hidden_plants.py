"""A rotor with something hidden in it: records from a simulator that shares nothing with daest.

Sub-stepped Euler-Maruyama; dry friction is set-valued (implicit: the speed is brought to zero and held)."""

import math
from functools import cache
from pathlib import Path

import numpy as np

from daest.diagnosis.evidence.proof import proof_of, searched
from daest.diagnosis.evidence.stand import begin, without_noises
from daest.diagnosis.null_model.null import fit_null
from daest.diagnosis.null_model.null_observer import run_null
from daest.diagnosis.options import DiagnoseOptions
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_model
from daest.modelica.effects.catalogue import effect_library
from daest.modelica.places.sites import sites

MODELS = Path(__file__).parent / "models"
INERTIA, DAMPING, PERIOD, NOISE, SENSOR = 0.5, 0.3, 0.05, 1e-4, 0.005


@cache
def model(name="Rotor"):
    return compile_model(MODELS / f"{name}.mo")


@cache
def library():
    return effect_library()


def some_effects(*names):
    """Of the rotor's domain and of signals."""
    return tuple(e for e in library() if e.name in names and e.domain in ("rotational", "signal"))


def torque_steps(n, seed, amplitude=1.0):
    levels = np.random.default_rng([seed, 1]).uniform(-amplitude, amplitude, n // 20 + 1)
    return np.repeat(levels, 20)[:n]


def rotor_record(
    n=1000,
    seed=0,
    *,
    coulomb=lambda phi: 0.0,
    torque=lambda w, phi: 0.0,
    load=(0.0, 1.0),
    noise=NOISE,
    drive=lambda u: u,
    measured=lambda y: y,
    feedback=0.0,
    substeps=10,
):
    """Record, and the truth {w, phi, load} at the samples. `coulomb` is the size of dry friction, `torque`
    what else acts, `load` (standard deviation, time constant) of an external load, `feedback` the gain of a
    controller that turns the steps into reference angles."""
    rng = np.random.default_rng(seed)
    u = torque_steps(n, seed)
    dt = PERIOD / substeps
    memory = float(np.exp(-dt / load[1]))
    kicks = rng.standard_normal((n, substeps)) * np.sqrt(noise * dt) / INERTIA
    pushes = rng.standard_normal((n, substeps)) * load[0] * np.sqrt(1.0 - memory**2)
    errors = SENSOR * rng.standard_normal(n)
    w = phi = d = 0.0
    # Lists of floats: the loop is that of Python, in which numbers of numpy take three times as long.
    shocks = [list(zip(*pair, strict=True)) for pair in zip(kicks.tolist(), pushes.tolist(), strict=True)]
    y, truth = np.zeros(n), np.zeros((n, 3))
    for k in range(n):
        truth[k] = w, phi, d
        y[k] = measured(phi) + errors[k]
        if feedback:
            u[k] = feedback * (u[k] - y[k]) - 0.2 * feedback * w
        given = float(drive(u[k]))
        for kick, push in shocks[k]:
            d = memory * d + push
            free = w + dt * (given - DAMPING * w + torque(w, phi) + d) / INERTIA + kick
            after = math.copysign(max(abs(free) - dt * coulomb(phi) / INERTIA, 0.0), free)
            phi += dt * (w + after) / 2.0
            w = after
    record = Experiment("record", PERIOD * np.arange(n), u[:, None], y[:, None], ("u",), ("phi",))
    return record, dict(zip(("w", "phi", "load"), truth.T, strict=True))


def rotor_null(record):
    """The fitted null of the rotor, and its observer's run."""
    flat = model()
    nodes = [s for s in sites(flat) if s.kind == "node"]
    null = fit_null(without_noises(flat), nodes, (record,), "zoh")
    return null, run_null(null)


@cache
def quiet():
    """Null and run of a record with nothing missing."""
    return rotor_null(rotor_record(600, seed=1)[0])


@cache
def rubbing():
    """Stand (baseline refitted) of a record with Coulomb friction of 0.15 N.m, with validation data."""
    whole, _ = rotor_record(1200, seed=2, coulomb=lambda phi: 0.15)
    return begin(model(), [whole], [], DiagnoseOptions(hold="zoh"))


def prove(null, null_fit, prepared, experiments, validation, run, load, n_screened=1, **words):
    """The refit of one candidate on the experiments, judged."""
    found = searched(null, null_fit, prepared, experiments, words.get("leader"))
    return proof_of(null, null_fit, found, validation, run, load, n_screened, **words)
