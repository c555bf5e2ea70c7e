"""Machines whose speed is measured and whose angle is not: in bare equations, where effects bring the angle
along, and from components, where no output sees it."""

from dataclasses import replace

import numpy as np
import pytest
from hidden_plants import model, rotor_record, some_effects

from daest.diagnosis.null_model.null import fit_null
from daest.diagnosis.null_model.null_observer import run_null
from daest.diagnosis.screening.candidates import attachable, pairs, with_shapes
from daest.diagnosis.screening.disturbance import place_gains, smoothed_load
from daest.diagnosis.screening.responses import _responses, size_names
from daest.diagnosis.screening.size_slopes import sizes_of
from daest.modelica.places.sites import sites
from daest.systems.reduction.reduce import reduce_index

NAMES = ("SpeedRotor", "SpeedMachine")
EFFECTS = ("Unbalance", "CoulombFriction")


def speed_record(n=250, **hidden):
    record, truth = rotor_record(n, seed=3, **hidden)
    noise = 0.02 * np.random.default_rng(5).standard_normal(n)
    return replace(record, outputs=(truth["w"] + noise)[:, None], output_names=("w",))


def null_of(name):
    nodes = [s for s in sites(model(name)) if s.kind in ("node", "equation")]
    null = fit_null(model(name), nodes, (speed_record(coulomb=lambda phi: 0.1),), "zoh")
    return null, run_null(null)


@pytest.mark.slow
def test_responses_to_angles_are_the_same_in_equations_and_from_components():
    found = []
    for name in NAMES:
        null, run = null_of(name)
        one, filtered = null.experiments[0], run.observed[0].filtered
        states = dict(zip(run.state_names, filtered.T, strict=True))
        candidates = pairs(some_effects(*EFFECTS), sites(model(name)))
        shaped, _ = with_shapes(null.flat, candidates, one.time, states, one.inputs)
        place = next(c.site.name for c in shaped if c.effect.name == "Unbalance")
        chosen = [c for c in shaped if c.site.name == place]
        usable, refused, explicit = attachable(null.flat, chosen)
        assert not refused
        names = [name for c in usable for name in size_names(c)]
        responses = _responses(null, run, explicit, sizes_of(explicit, names))
        found.append(
            {
                (c.effect.name, round(c.shape.get("phi_0", 0.0), 6)): r
                for c, r in zip(usable, responses, strict=True)
            }
        )
        load = smoothed_load(null, run, place_gains(null, run))
        assert load is not None and np.all(np.isfinite(load.values))
    bare, machine = found
    assert bare.keys() == machine.keys() and len(bare) > 2
    for key, response in bare.items():
        # The machine's angle is filtered, the bare one is the integral of the filtered speed.
        assert np.linalg.norm(response - machine[key]) < 0.05 * np.linalg.norm(response), key


def test_what_turns_on_and_on_is_held_by_no_spring():
    """At 3 rad/s a spring is wound by 30 turns within 63 s."""
    flat = model("SpeedRotor")
    candidates = pairs(some_effects("ReturnSpring", "Unbalance"), sites(flat))
    for seconds, is_held in ((60.0, True), (66.0, False)):
        time = np.linspace(0.0, seconds, 200)
        states = {name: np.full(200, 3.0) for name in reduce_index(flat).state_names}
        shaped, refused = with_shapes(flat, candidates, time, states, np.zeros((200, len(flat.inputs))))
        found = {c.effect.name for c in shaped}
        assert found == ({"ReturnSpring", "Unbalance"} if is_held else {"Unbalance"})
        assert bool(refused) is not is_held
