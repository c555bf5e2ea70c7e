"""What `daest diagnose` will ask of an effect, for the design of recordings that are to show it."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca

from daest.design.drawn import Required
from daest.design.loads import Loads
from daest.diagnosis.evidence.unseen import FEWEST_STRETCHES, HORIZONS, LONGEST, TAKES_UP
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.loads import load_places, load_sites
from daest.model.flat import FlatModel
from daest.model.parts import NoiseInput


def required(n_candidates: int) -> Required:
    """Of an effect among so many candidates."""
    return Required(
        evidence=GATES.min_bic_gain,
        chance=GATES.max_chance,
        n_candidates=n_candidates,
        foreseen=GATES.likelier_significance,
        silent=GATES.min_expected_gain,
        stretch=TAKES_UP,
        fewest=FEWEST_STRETCHES,
        noticed=GATES.same_unseen_error,
        tolerated=GATES.max_simulated_loss,
        clear=GATES.max_clear_ratio,
        horizon=HORIZONS[-1],
        longest=LONGEST,
        acting=GATES.acting_share,
    )


def beside_loads(flat: FlatModel) -> tuple[FlatModel, Loads]:
    """The model with a noise of no size wherever the null of a diagnosis admits an unknown load, and these
    loads."""
    places = load_places(flat, load_sites(flat))
    names = tuple(place.load for place in places)
    w, residual = ca.SX.sym("load", len(places)), ca.SX(flat.residual)
    for i, place in enumerate(places):
        residual[place.row] -= w[i]
    loaded = replace(
        flat,
        noises=(*flat.noises, *(NoiseInput(name, intensity=0.0) for name in names)),
        w=ca.vertcat(flat.w, w),
        residual=residual,
    )
    return loaded, Loads(names, GATES.shortest_load, GATES.longest_load)
