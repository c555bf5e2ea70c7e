"""Parameters that change with a variable of the model, or with time: a resistance that falls as it warms.

The first term of such a dependence is an effect of the library, which is tried where no other law explains
what is missing: there are as many of them as parameters times variables, and most have a physical law that
says the same and more.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from itertools import product

import casadi as ca
import numpy as np

from daest.diagnosis.built_in.trials import Trial
from daest.diagnosis.evidence.law_values import errors_last
from daest.diagnosis.evidence.same_laws import is_same_load
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import Null
from daest.diagnosis.null_model.null_observer import NullObserver
from daest.diagnosis.screening.free_forms import internal_variables
from daest.diagnosis.screening.screen import screen
from daest.errors import EstimationError
from daest.model.diagnosis import Candidate, Proof, Screen
from daest.model.effects import Effect
from daest.model.flat import Model
from daest.modelica.effects.attach import free_name, names_of
from daest.modelica.places.sites import changeable

LASTS = "what it leaves of a simulation lasts"
LINEAR = "Daest.Effects.General.DependentParameter"
MOST_PAIRS = 200  # of parameters and variables, which are tried
MOST_DEPENDENCES = 5  # of them, which are refitted
DIGITS = 0.1  # of the spread of a variable, to which its middle is told


def dependence_screen(
    null: Null, run: NullObserver, candidates: Sequence[Candidate], seed: int
) -> Screen | None:
    """Scores of `dependences`; None where there are none, or none can be attached."""
    if not candidates:
        return None
    try:
        return screen(null, run, candidates, seed)
    except EstimationError:
        return None


def dependences(
    null: Null, run: NullObserver, declared: Model, library: Sequence[Effect]
) -> tuple[Candidate, ...]:
    """Every parameter of the `declared` model beside every variable that it may change with, from the middle
    that this has in the recordings, in the form of which all are to first order (`_forms`); and beside the
    time. None of a model with too many parameters."""
    places = changeable(declared)
    if len(places) > MOST_PAIRS:
        return ()
    middles = _middles(null, run, most=MOST_PAIRS // max(len(places), 1))
    taken: Collection[str] = names_of(null.flat)
    found: list[Candidate] = []
    for effect, (name, middle), site in product(_forms(library)[:1], middles.items(), places):
        middles_of = {p.name: middle for p in effect.parameters if p.signal_unit == "z"}
        found.append(Candidate(effect, site, "", middles_of, {effect.inputs[0]: name}))
    with_time = [e for e in library if e.attach == "parameter" and not e.is_of_variable]
    found += [Candidate(effect, site, "") for effect, site in product(with_time, places)]
    return tuple(
        replace(one, name=free_name(f"dependence_{number}", taken)) for number, one in enumerate(found, 1)
    )


def leading(found: Screen) -> list[Trial]:
    """The first few of a screen that are significant. Those that the innovations do not tell apart are each
    tried: a permeability that falls with the salt and an osmotic pressure that grows with the flow do the
    same for a small change alone."""
    seen = [e for e in found.entries if not e.absorbed and e.p_value <= GATES.screen_level]
    return [Trial(e.candidate, e.sizes, ()) for e in seen[:MOST_DEPENDENCES]]


def in_other_forms(told: Sequence[Proof], known: Sequence[Proof], library: Sequence[Effect]) -> list[Trial]:
    """The likeliest of the parameters that change in the other forms that it may change in. One that says
    what a law among the `known` ones says is that law, of which no other form is known."""
    of_variable = [p for p in told if p.candidate.effect.is_of_variable]
    own = [p for p in of_variable if not any(is_same_load(p, law) for law in known)]
    best = max(own, key=lambda p: p.delta_bic, default=None)
    if best is None or best.delta_bic < GATES.min_bic_gain:
        return []
    one = best.candidate
    others = [effect for effect in _forms(library) if effect != one.effect]
    return [
        Trial(replace(one, effect=effect, name=f"{one.name}_{number}"), best.sizes, ())
        for number, effect in enumerate(others, 2)
    ]


def refused_where_errors_last(proofs: Sequence[Proof]) -> list[Proof]:
    """The laws, without parameters that change and leave errors of a simulation that last, where no law of
    the library is accepted: the first term of any dependence does some of what any effect does. Such a one
    comes near."""
    return [
        replace(p, verdict="rejected", reason=LASTS)
        if p.verdict != "rejected" and p.candidate.is_of_parameter and errors_last(p)
        else p
        for p in proofs
    ]


def _forms(library: Sequence[Effect]) -> list[Effect]:
    """How a parameter may change with a variable, linear first: near its middle every one is that."""
    forms = [effect for effect in library if effect.is_of_variable]
    return sorted(forms, key=lambda effect: effect.class_name != LINEAR)


def _middles(null: Null, run: NullObserver, most: int) -> dict[str, float]:
    """The means of the variables that move in all recordings, at most as many: measured ones, states,
    inputs. Not those of effects that were put in: no machine changes with what its sensor makes of it."""
    combined = _combined(null)
    courses = [
        internal_variables(null, run, i)
        | {name: one.output(name) for name in combined if name in one.output_names}
        for i, one in enumerate(null.experiments)
    ]
    loads = {load.name for load in null.loads}
    states = [name for name in null.explicit.state_names if name not in loads]
    measured = [y.name() for y in ca.vertsplit(null.flat.output_expressions) if y.is_symbolic()]
    wanted = dict.fromkeys((*measured, *combined, *states, *null.experiments[0].input_names))
    own = [name for name in wanted if name.partition(".")[0] not in null.flat.attached]
    shared = [name for name in own if all(name in course for course in courses)]
    whole = {name: np.concatenate([course[name] for course in courses]) for name in shared[:most]}
    return {name: _rounded(float(np.nanmean(x)), float(np.nanstd(x))) for name, x in whole.items()}


def _combined(null: Null) -> list[str]:
    """Measured outputs that say more than one variable: the stroke of a spring, between the heights of its
    ends. What is in proportion to one, as a speed in rpm, is that one."""
    flat = null.flat
    variables, constants = {*flat.unknown_names, *flat.input_names}, set(flat.parameter_names)
    found = []
    for output, expression in zip(flat.outputs, ca.vertsplit(flat.output_expressions), strict=True):
        names = {symbol.name() for symbol in ca.symvar(expression)} - constants
        is_own = not any(name.partition(".")[0] in flat.attached for name in names)
        if len(names) > 1 and names <= variables and is_own:
            found.append(output.name)
    return found


def _rounded(middle: float, spread: float) -> float:
    """The mean of a variable to so many digits as its spread asks for."""
    step = 10.0 ** np.floor(np.log10(DIGITS * spread)) if spread > 0.0 else 1.0
    return float(f"{round(middle / step) * step:.12g}")
