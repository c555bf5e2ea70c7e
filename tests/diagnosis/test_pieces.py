"""Machines whose simulation drifts away, judged by simulations of pieces of their records."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from daest.diagnosis.answers.told_laws import nearest_in_pieces
from daest.diagnosis.built_in.trials import prepare, trials
from daest.diagnosis.evidence import free_starts
from daest.diagnosis.evidence.beside_starts import Started
from daest.diagnosis.evidence.open_loop import Simulated, in_use, open_screen
from daest.diagnosis.evidence.pieces import FEWEST_PIECES, in_pieces
from daest.diagnosis.evidence.stand import begin
from daest.diagnosis.null_model.null_observer import run_null
from daest.diagnosis.options import DiagnoseOptions
from daest.diagnosis.refits import course as course_module
from daest.diagnosis.refits.course import Course
from daest.diagnosis.refits.in_use import proof_in_open_loop, tried_in_open_loop
from daest.diagnosis.refits.search import Search
from daest.diagnosis.screening.candidates import keeping_order, pairs
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_text
from daest.modelica.effects.catalogue import find_effect
from daest.modelica.places.sites import sites
from daest.numerics.deadline import OutOfTimeError
from daest.systems.simulation.integrate import integrator

CART = b"""model Cart
  parameter Real m(unit = "kg", min = 0) = 2;
  parameter Real d(unit = "N.s/m", min = 0) = 4 annotation(__Daest(estimate = true, scale = "log"));
  input Real u(unit = "N");
  Real s(unit = "m", start = 0);
  Real v(unit = "m/s", start = 0);
  output Real y(unit = "m") annotation(__Daest(std = 0.001));
equation
  der(s) = v;
  m*der(v) = u - d*v;
  y = s;
end Cart;
"""
PERIOD, SUBSTEPS = 0.02, 20


def record(friction, seed, n=1200, shaken=0.0):
    """The position of the cart under steps of a force, with set-valued dry friction [N], shaken by noise."""
    rng = np.random.default_rng(seed)
    force = np.repeat(rng.normal(0.0, 6.0, n // 40 + 1), 40)[:n]
    h, s, v, measured = PERIOD / SUBSTEPS, 0.0, 0.0, []
    for u in force:
        measured.append(s)
        for _ in range(SUBSTEPS):
            free = v + h * (u - 4.0 * v) / 2.0 + shaken * np.sqrt(h) * rng.standard_normal()
            v = np.sign(free) * max(abs(free) - h * friction / 2.0, 0.0)
            s += h * v
    y = np.array(measured) + rng.normal(0.0, 1e-3, n)
    return Experiment("run", PERIOD * np.arange(n), force[:, None], y[:, None], ("u",), ("y",))


@cache
def case(friction, shaken):
    flat = compile_text(CART, Path("Cart.mo"))
    both = [record(friction, seed, shaken=shaken) for seed in (1, 2)]
    stand = begin(flat, both[:1], both[1:], DiagnoseOptions(hold="zoh"))
    run = run_null(stand.null)
    pieces = in_pieces(stand, run)
    assert pieces is not None
    return flat, stand, run, pieces


@cache
def shown(effect, friction, shaken):
    """The search for an effect at the cart, and what the pieces of its records say of that."""
    flat, stand, run, pieces = case(friction, shaken)
    candidates = keeping_order(
        stand.null.flat, stand.null.explicit, pairs([find_effect(effect)], sites(flat))
    )
    used = open_screen(pieces.null, pieces.reference.fit, candidates, 0)
    trial = trials(used, 1.0, 1)[0]
    search = Search(stand, run, None, None, len(candidates), pieces=pieces)
    return search, tried_in_open_loop(search, prepare(stand.null.flat, stand.null.estimated, trial))


@cache
def proved_friction():
    search, found = shown("Translational.CoulombFriction", 1.5, 0.02)
    return proof_in_open_loop(search, found, None)


@pytest.mark.slow
def test_pieces_do_not_drift():
    _, stand, _, pieces = case(1.5, 0.02)
    assert stand.reference.adds_up
    assert not pieces.reference.adds_up
    assert pieces.reference.fit.method == "oe"
    for whole, parts in (
        (stand.null.experiments, pieces.null.experiments),
        (stand.validation, pieces.validation),
    ):
        assert len(parts) >= FEWEST_PIECES
        assert np.array_equal(np.concatenate([e.outputs for e in parts]), whole[0].outputs)
    drifted = stand.reference.fit.simulated["validation"].rms["y"]
    assert pieces.reference.fit.simulated["validation"].rms["y"] < 0.5 * drifted


def test_dry_friction_is_shown_by_pieces():
    assert shown("Translational.CoulombFriction", 1.5, 0.02)[1].is_clear
    proof = proved_friction()
    assert proof.verdict == "supported"
    assert proof.is_by_use
    size = proof.final.theta[f"{proof.candidate.name}.f_c"]
    assert size == pytest.approx(1.5, abs=0.15)
    # What is told of it is the simulation of the whole records.
    stand = case(1.5, 0.02)[1]
    told = proof.final.simulated["validation"].rms["y"]
    assert told < 0.5 * stand.reference.fit.simulated["validation"].rms["y"]
    assert len(proof.final.initial_states) == len(stand.null.experiments)


@pytest.mark.parametrize(
    "effect",
    [
        "CoulombFriction",
        *(pytest.param(n, marks=pytest.mark.slow) for n in ("QuadraticDrag", "ConstantLoad")),
    ],
)
def test_noise_is_no_law_in_pieces(effect):
    _, found = shown(f"Translational.{effect}", 0.0, 0.3)
    assert found is None or not (found.is_near or found.is_clear)


def test_starts_count_for_nothing():
    """A law whose start lasts longer than that of the model takes from slow errors of any origin."""
    rng, time = np.random.default_rng(0), np.linspace(0.0, 1.0, 200)
    short, slow = (np.exp(-time / T)[:, None, None] for T in (0.02, 2.0))

    def pair(drifts, is_driven):
        noise, driven = 0.01 * rng.standard_normal((200, 1)), np.sin(9.0 * time)[:, None] * is_driven
        left = drifts * slow[:, :, 0] + driven + noise
        return Started(left, short, {}), Started(noise, np.dstack([short, slow]), {})

    def compared(is_driven):
        pairs = [pair(rng.standard_normal(), is_driven) for _ in range(8)]
        before, after = ([one[i] for one in pairs] for i in (0, 1))
        simulations = []
        for parts in (before, after):
            errors = tuple(one.errors for one in parts)
            starts = tuple(parts[:4]), tuple(parts[4:])
            simulations.append(Simulated(errors[:4], errors[4:], starts))
        return in_use(*simulations), in_use(*(replace(one, starts=None) for one in simulations))

    beside, as_it_is = compared(is_driven=0.0)
    assert as_it_is.ratio < 0.1 and beside.ratio == pytest.approx(1.0, abs=0.01)
    driven, _ = compared(is_driven=1.0)
    assert driven.ratio < 0.05


def test_pieces_of_which_starts_can_do_most_tell_nothing():
    rng = np.random.default_rng(0)

    def simulation(size, n_directions):
        parts = [
            Started(size * rng.standard_normal((40, 1)), rng.standard_normal((40, 1, n_directions)), {})
            for _ in range(8)
        ]
        errors = tuple(one.errors for one in parts)
        return Simulated(errors[:4], errors[4:], (tuple(parts[:4]), tuple(parts[4:])))

    assert in_use(simulation(1.0, 2), simulation(0.1, 4)).ratio < 0.2
    assert not in_use(simulation(1.0, 10), simulation(0.1, 12)).n_independent


def test_start_of_an_affine_model_is_looked_for_once(monkeypatch):
    """It has one optimum: what grows over short windows ends there, too."""
    _, _, _, pieces = case(1.5, 0.02)
    null, piece = pieces.null, pieces.null.experiments[0]
    windows, search = [], free_starts._searched_start

    def watched(*given):
        windows.append(given[-1])
        return search(*given)

    monkeypatch.setattr(free_starts, "_searched_start", watched)
    model, root = integrator(null.explicit), np.diag(1.0 / null.measurement_std)
    given = null, model, piece, np.zeros((len(null.explicit.state_names), 1)), root
    once = free_starts.best_start(*given)
    assert windows == sorted(windows) and windows[0] == min(piece.n_samples, free_starts.START_SAMPLES)
    monkeypatch.setattr(free_starts, "AffineIntegrator", ())
    assert free_starts.best_start(*given) == pytest.approx(once, rel=1e-6, abs=1e-9)


def test_law_that_comes_near_is_told_and_not_claimed():
    search, found = shown("Translational.CoulombFriction", 1.5, 0.02)
    vague = replace(found, used=replace(found.used, unseen=2.0 * np.log(1.25), certainty=1.0))
    assert vague.is_near and not vague.is_clear
    assert not replace(vague, is_known=False).is_near
    refused = replace(proved_friction(), verdict="rejected")
    proof = proof_in_open_loop(search, vague, refused)
    assert proof.verdict == "rejected"
    said = nearest_in_pieces([proof])
    assert f"{proof.candidate.label} comes nearest" in said and "removes 20 % of their error" in said
    for verdict in ("supported", "not separable"):
        assert not nearest_in_pieces([proof, replace(proof, verdict=verdict)])
    # A mass of nothing that swings is a sine of any origin.
    unknown = tuple(replace(p, std_error=None) for p in proof.told.parameters)
    assert not nearest_in_pieces([replace(proof, final=replace(proof.told, parameters=unknown))])


def test_pieces_for_which_the_time_does_not_suffice_change_nothing(monkeypatch):
    def late(*_):
        raise OutOfTimeError

    monkeypatch.setattr(course_module, "in_pieces", late)
    course = SimpleNamespace(
        stand=SimpleNamespace(reference=SimpleNamespace(adds_up=True)),
        loads=SimpleNamespace(run=None),
        options=DiagnoseOptions(),
        progress=lambda _: None,
        _is_open=lambda _: True,
    )
    assert Course.in_pieces(course, []) == ((), False)
    course.stand.reference.adds_up = False
    assert Course.in_pieces(course, []) == ((), True)
