"""Why a law that was refitted is not the one that acts: each reason a sentence, empty where it is none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from daest.diagnosis.built_in.certainty import KnownProduct, bends, certainty_of, is_bend, known_products
from daest.diagnosis.built_in.late_signals import LAG
from daest.diagnosis.built_in.settled import LOST
from daest.diagnosis.built_in.trials import Prepared
from daest.diagnosis.evidence.free_starts import free_runs
from daest.diagnosis.evidence.open_loop import driven_share, largest_values, values_along
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import Null, grown
from daest.diagnosis.null_model.null_observer import NullObserver, run_null
from daest.diagnosis.screening.candidates import scaled_by, scaled_shapes
from daest.diagnosis.screening.free_forms import covers
from daest.diagnosis.screening.responses import law_response
from daest.errors import DaestError
from daest.estimation.fitting.records import longest_duration
from daest.estimation.fitting.signals import is_constant
from daest.model.diagnosis import Candidate, FreeForm, Proof
from daest.model.effects import EffectParameter
from daest.model.experiment import Experiment
from daest.model.fit import FitResult, FittedParameter, most_lasting
from daest.modelica.flat.clock import clock_unit
from daest.modelica.places.balances import needs_position
from daest.quantities import spoken_duration, with_unit
from daest.systems.linear.linearize import has_affine_dynamics

ABSOLUTE_VALUE = "Daest.Effects.Signals.AbsoluteValueSensor"
GAIN = "Daest.Effects.Signals.Gain"
TURNS_BACK = "it turns its signal back"
PLAY = "Daest.Effects.Signals.Play"
RATE_LIMIT = "Daest.Effects.Signals.RateLimit"
ALONG = 200  # values of a signal at which a bend of it is looked at
PLACED = 0.5  # of what its variable reaches, from which a shape is looked for as a place along it


def unmoved(fitted: Sequence[Experiment], validation: Sequence[Experiment]) -> str:
    """Why unseen data confirm nothing in which no input of any recording changes, and no output beside what
    it does in the `fitted` ones: they tell one level of every output, which any law with a parameter more may
    hit. Empty where something changes."""
    inputs = [signal for e in validation for signal in e.inputs.T]
    if not validation or not all(is_constant(signal) for signal in inputs):
        return ""
    spread = _spread(np.concatenate([e.outputs for e in fitted]))
    moves = np.array([_spread(e.outputs) for e in validation])
    if np.any(moves > GATES.standing_share * spread):
        return ""
    return "the unseen data stand still and confirm no law"


def _spread(outputs: np.ndarray) -> np.ndarray:
    """The standard deviation (n_y,) of outputs (n_samples, n_y), zero where none was measured."""
    seen = np.isfinite(outputs)
    count = np.maximum(seen.sum(axis=0), 1)
    values = np.where(seen, outputs, 0.0)
    mean = values.sum(axis=0) / count
    return np.sqrt(np.sum(np.where(seen, outputs - mean, 0.0) ** 2, axis=0) / count)


def unforeseen(told: FitResult) -> str:
    """Why unseen data confirm nothing of a law with which none of their outputs can be simulated, as `told`
    has it: a pole that its parameters came to lies there. Empty where one can."""
    unseen = told.simulated.get("validation")
    if unseen is None or any(rms is not None for rms in unseen.rms.values()):
        return ""
    return "with it unseen data cannot be simulated, and confirm nothing"


def undriven(model: Null) -> str:
    """Why nothing can be told of a model that its inputs hardly move; empty where they do, or none moves.

    What acts instead is unknown, and all forces may be larger together. Noise in a recorded input has the
    same effect: the fit does without it."""
    share = driven_share(model)
    if share is None or share >= GATES.min_driven:
        return ""
    return f"the recorded inputs move the model by {share:.1%} of what its outputs do: no size can be told"


def without_evidence(gain: float, delta_bic: float, p_value: float, n_screened: int) -> str:
    """Why the likelihood says too little; empty where it says enough."""
    if gain < -LOST:
        return f"the search lost its way: it ends {-gain:.0f} below the likelihood of the model as it is"
    if delta_bic < GATES.min_bic_gain:
        return f"the likelihood gains too little for its parameters (BIC gain {delta_bic:.1f})"
    if p_value > GATES.max_chance:
        return f"a search over {n_screened} candidates finds as much by chance (p = {p_value:.1g})"
    return ""


def weak(prepared: Prepared, fit: FitResult, before: FitResult, gain: float = 0.0) -> str:
    """Why its shape or its sizes prove nothing; empty where they do. `before` is the fit without the law, the
    `gain` in log-likelihood what the law brings."""
    candidate = prepared.trial.candidate
    found = {p.name: p for p in fit.parameters}
    for shape in (p for p in candidate.effect.parameters if p.role == "shape"):
        own = found.get(f"{candidate.name}.{shape.name}")
        if own is not None and own.at_bound:
            return f"its {shape.name} rests at its bound ({own.at_bound} = {own.value:.4g})"
    reasons = []
    for parameter in candidate.effect.sizes:
        size = found.get(f"{candidate.name}.{parameter.name}")
        if size is None:
            continue
        if parameter.is_share and size.value < GATES.min_share:
            reasons.append(f"{parameter.name} = {size.value:.2g} leaves the signal nearly as it is")
            continue
        if candidate.effect.class_name == ABSOLUTE_VALUE and size.value < GATES.min_lost_sign:
            reasons.append(f"{parameter.name} = {size.value:.2g}: a sensor loses the sign, or it does not")
            continue
        # Beside estimated shapes a size alone tells little: there the likelihood ratio has spoken.
        shares = sum(p.estimate for p in candidate.effect.parameters) > len(candidate.effect.sizes)
        least = GATES.min_dynamic_significance if candidate.is_dynamic else GATES.min_significance
        certainty = certainty_of(candidate, fit, size, parameter, before, gain)
        reason = _weak_size(size, parameter.null or 0.0, 0.0 if shares else least, certainty)
        if not reason:
            return ""
        reasons.append(reason)
    return "; ".join(reasons) or "its size was not estimated"


def vanished(candidate: Candidate, told: FitResult) -> str:
    """Why the law is not there, where without coloured loads its sizes go to where it does nothing: what
    foresees unseen data better are then the other parameters. Empty where one stays."""
    found = {p.name: p for p in told.parameters}
    sizes = [(found.get(f"{candidate.name}.{p.name}"), p.null or 0.0) for p in candidate.effect.sizes]
    reasons = [
        _weak_size(size, null, 0.0, np.inf)
        for size, null in sizes
        if size is not None and size.at_bound and abs(size.value - null) < abs(size.initial - null)
    ]
    if not reasons or len(reasons) < len(sizes) or not all(reasons):
        return ""
    return f"without unknown loads {'; '.join(reasons)}"


def is_absent_at_once(candidate: Candidate, beside: FitResult, told: FitResult) -> bool:
    """Whether a share of another signal in a reading is known to be another one `beside` loads than in the
    simulation that is `told`. Loads act on what is stored, and take over nothing that jumps with that signal:
    what follows it later only is a store that nobody knows."""
    if candidate.site.kind != "output" or not candidate.inputs or candidate.effect.n_states:
        return False
    loaded = {p.name: p for p in beside.parameters}
    pairs = [
        (loaded[p.name], p)
        for p in told.parameters
        if p.name.startswith(f"{candidate.name}.") and p.name in loaded
    ]
    return any(
        abs(p.value) > GATES.elsewhere * abs(one.value)
        and abs(p.value - one.value)
        > GATES.min_significance * np.hypot(p.std_error or np.inf, one.std_error or np.inf)
        for one, p in pairs
    )


def not_determined(
    candidate: Candidate,
    told: FitResult,
    before: FitResult,
    least_of_place: float = GATES.min_place_significance,
    gain: float = 0.0,
) -> str:
    """Why the law is not the one that the data show, where they determine none of its parameters: it then
    stands for any law that does the same in these data. Empty where at least one of them is known. A phase
    says nothing alone: half a turn of it is another sign of the size; nor does a ratio, such as the damping
    of what swings with an unknown mass and period, nor the time constant of a store of no size, which
    does what its own start does; nor the share of a law that has its amount in another parameter, such as a
    limit: all of nothing that is known is nothing. `before` is the fit without the law, `least_of_place` how
    many standard errors a place stands off zero where it is known, and the `gain` in log-likelihood what the
    law brings."""
    # Of a mass that swings, the period is seen; a wall may be at any temperature when the recording begins.
    stores = bool(candidate.effect.n_states) and not needs_position(candidate.effect.domain)
    roles = ("size",) if stores else ("size", "shape")
    law = {
        f"{candidate.name}.{p.name}": p
        for p in candidate.effect.parameters
        if p.role in roles and not _is_phase(p) and not _is_ratio(p)
    }
    own = [p for p in told.parameters if p.name in law]
    unknown = [
        told_value(p)
        for p in own
        if not _is_known(
            p, law[p.name], certainty_of(candidate, told, p, law[p.name], before, gain), least_of_place
        )
    ]
    if not own or len(unknown) < len(own):
        return _of_no_amount(candidate, told)
    what = "none of its sizes" if stores else "none of its parameters"
    return f"the data determine {what} ({', '.join(unknown)})"


def _of_no_amount(candidate: Candidate, told: FitResult) -> str:
    """Why the law is not known, where it has its amount in shapes beside a share, such as a limit, and the
    data determine none of these: all of what lies beyond a limit may be cut, and the limit be anywhere. A
    place is known within the reach of its variable, too, since it may be at nothing there. Empty where one is
    known, or there are none."""
    shapes = {f"{candidate.name}.{p.name}": p for p in candidate.effect.parameters if p.role == "shape"}
    own = [p for p in told.parameters if p.name in shapes]
    if not own or not all(p.is_share for p in candidate.effect.sizes):
        return ""
    for p in own:
        reach = reach_of(candidate, shapes[p.name]) if is_place(shapes[p.name]) else 0.0
        if p.std_error is not None and GATES.min_significance * p.std_error <= max(abs(p.value), reach):
            return ""
    return f"the data do not determine its amount ({', '.join(told_value(p) for p in own)})"


def in_place_of_a_parameter(
    candidate: Candidate, told: FitResult, before: FitResult, ratios: Sequence[float]
) -> str:
    """Why a lag or dead time of a signal is nothing that the model lacks, where it does what one of the
    estimated parameters did, which was known in the fit `before` and beside it is nothing, as far as that was
    known: the time constant of a store that has moved in front of it changes the noise alone. Of two equal
    lags either may be anything, and is not nothing. Empty where it is none of that, or where a simulation of
    unseen data has become clearly better; `ratios` are of its errors, with to without."""
    if not (candidate.is_dynamic and candidate.is_of_signal) or not ratios:
        return ""
    if min(ratios) < GATES.max_clear_ratio:
        return ""
    after = {p.name: p for p in told.parameters}
    for was in before.parameters:
        now = after.get(was.name)
        if now is None or not was.std_error or now.std_error is None:
            continue
        was_known = abs(was.value) > GATES.min_significance * was.std_error
        if was_known and abs(now.value) < min(was.std_error, now.std_error):
            return (
                f"it does what {was.name} did, which is {told_number(now)} beside it and {told_number(was)} "
                "without, and simulates unseen data no better"
            )
    return ""


def without_form(model: Null, candidate: Candidate, told: FitResult) -> str:
    """Why the law is not what its name says, where a length or speed over which it has its form is so large
    that the recordings show a part of the form alone, which may belong to any other: a third of a period is a
    cubic spring beside a constant force. Empty where it is not."""
    for name, (value, most) in unseen_scales(model, candidate, told).items():
        return f"the recordings (to {most:.4g}) show too little of its form ({name} = {value:.4g})"
    return ""


def unseen_scales(model: Null, candidate: Candidate, told: FitResult) -> dict[str, tuple[float, float]]:
    """The lengths and speeds over which the law has its form that are far beyond what the recordings reach:
    by name the value and that reach."""
    scaled = [p for p in scaled_shapes(candidate) if not is_place(p)]
    if not scaled:
        return {}
    run = grown(model, model.flat, model.explicit, told, model.experiments)
    reached = largest_values(run)
    found = {}
    for p in scaled:
        value = abs(told.theta[f"{candidate.name}.{p.name}"])
        variable = scaled_by(candidate, p)
        most = _half_way(run, variable) if p.periods_over else reached.get(variable, np.inf)
        if value > GATES.max_scale * most:
            found[p.name] = (value, most)
    return found


def _half_way(run: Null, variable: str) -> float:
    """Half of the way that a variable covers in the simulation: where a law has a phase, the origin is free,
    and a motion to one side of it shows half of what one to both sides does."""
    values = values_along(run, [variable])
    return np.inf if values is None else 0.5 * float(np.ptp(values))


def may_be_a_bend(proof: Proof) -> bool:
    """Whether a law with a kink at a place, such as a stop, leaves errors of a simulation of unseen data that
    last: a smooth bend of the same course, as of an air spring, is as well one with a kink in its middle."""
    is_kinked = any(is_place(p) for p in scaled_shapes(proof.candidate))
    return is_kinked and most_lasting(proof.told.simulated)[1] >= GATES.told_rest_of_set


def out_of_reach(model: Null, candidate: Candidate, told: FitResult) -> str:
    """Why the law is not what its name says, where its places along a variable, such as a rim or a stop, lie
    beyond all that the variable comes to in the simulation: the law then lives on how its kink is rounded.
    Empty where it does not."""
    places = {p.name: f"{candidate.name}.{p.scale_of}" for p in scaled_shapes(candidate) if is_place(p)}
    if not places:
        return ""
    reached = largest_values(grown(model, model.flat, model.explicit, told, model.experiments))
    beyond = ""
    for name, variable in places.items():
        value, most = abs(told.theta[f"{candidate.name}.{name}"]), reached.get(variable, np.inf)
        if value <= GATES.max_place * most:
            return ""
        beyond = f"its {name} ({value:.4g}) lies beyond all that the recordings reach ({most:.4g})"
    return beyond


def crossed(candidate: Candidate, told: FitResult) -> str:
    """Why a law between two places along a variable, such as a pair of stops, is not what its name says,
    where the upper one lies below the lower one: it then pushes everywhere, as a spring does. Empty where
    there is room between them."""
    places = [p for p in scaled_shapes(candidate) if is_place(p)]
    for upper in (p for p in places if min(p.grid) > 0.0):
        for lower in (p for p in places if max(p.grid) < 0.0 and p.scale_of == upper.scale_of):
            high, low = (told.theta[f"{candidate.name}.{p.name}"] for p in (upper, lower))
            if high < low:
                ends = f"its {upper.name} ({high:.4g}) lies below its {lower.name} ({low:.4g})"
                return f"{ends}, so that it acts everywhere"
    return ""


def too_slow(experiments: Sequence[Experiment], candidate: Candidate, told: FitResult) -> str:
    """Why a lag or a delay is not what its name says, where its time is such a share of the recordings that
    these hardly show the signal come back: most of it is then what was before they began, or an integral.
    Empty where it is not."""
    times = [told.theta[f"{candidate.name}.{p.name}"] for p in candidate.effect.sizes if p.unit == "s"]
    most = GATES.longest_load * longest_duration(experiments)
    if not candidate.is_dynamic or max(times, default=0.0) <= most:
        return ""
    longest = max(times)
    clock = next(candidate.units.get(p.name) or p.unit for p in candidate.effect.sizes if p.unit == "s")
    shown = spoken_duration(most, clock)
    return f"{spoken_duration(longest, clock)} is too long for recordings that show up to {shown}"


def too_slow_for_its_size(experiments: Sequence[Experiment], candidate: Candidate, told: FitResult) -> str:
    """Why a law that relaxes is not what its name says, where the data determine none of its sizes, and its
    time is too long for the recordings: a spring that relaxes within a minute is a damper over a second,
    as stiff as one likes, and takes up any slow load. Empty where it is not."""
    shapes = [p for p in candidate.effect.parameters if p.role == "shape" and p.unit == "s"]
    if not candidate.is_dynamic or not shapes:
        return ""
    found = {p.name: p for p in told.parameters}
    sizes = [(found.get(f"{candidate.name}.{p.name}"), p.null or 0.0) for p in candidate.effect.sizes]
    if any(size is None or _stands_off(size, null) for size, null in sizes):
        return ""
    most = GATES.longest_load * longest_duration(experiments)
    for p in shapes:
        value = told.theta[f"{candidate.name}.{p.name}"]
        if value > most:
            clock = candidate.units.get(p.name) or p.unit
            shown = f"{spoken_duration(value, clock)} for recordings that show up to "
            return f"{p.name} is too long ({shown}{spoken_duration(most, clock)}) and its size unknown"
    return ""


def too_fast(experiments: Sequence[Experiment], candidate: Candidate, told: FitResult) -> str:
    """Why a law that follows with a time of its own is not what its name says, where that time is below the
    sampling of all recordings and not known: at once, a mass that is dragged along is one more mass, which an
    estimated parameter is, too. Empty where it is not."""
    shapes = {f"{candidate.name}.{p.name}": p for p in candidate.effect.parameters if p.role == "shape"}
    own = [p for p in told.parameters if p.name in shapes and shapes[p.name].unit == "s"]
    if not candidate.effect.n_states or not own:
        return ""
    period = min(float(np.median(np.diff(e.time))) for e in experiments)
    for p in own:
        if p.value < period and (p.std_error is None or p.value < GATES.min_significance * p.std_error):
            every = spoken_duration(period, candidate.units.get(shapes[p.name].name) or "s")
            return f"{told_value(p)} is below the sampling, {every}, and not known: it acts at once"
    return ""


def _stands_off(size: FittedParameter, null: float) -> bool:
    """Whether a size is certainly not at its null."""
    return bool(size.std_error) and abs(size.value - null) >= GATES.min_significance * (size.std_error or 0.0)


def is_history(experiments: Sequence[Experiment], candidate: Candidate, told: FitResult) -> bool:
    """Whether a lag or a delay is all made of what was before the recordings began: it is too slow for them,
    and its input keeps its level in all of them. It may follow any transient, and is no rival of a law."""
    at_input = candidate.site.kind == "input"
    rests = at_input and all(is_constant(e.input(candidate.site.name)) for e in experiments)
    return rests and bool(too_slow(experiments, candidate, told))


def shut(model: Null, candidate: Candidate, told: FitResult) -> str:
    """Why a law at a signal is not what its name says, where next to nothing of the signal comes through it
    in the recordings, such as play that is wider than all that the signal does: whatever cuts the signal off
    does the same. What a state of the law began with may come in the first half of them. Empty where
    something comes through; a gain of nothing says just that."""
    if not candidate.is_of_signal or candidate.effect.class_name == GAIN:
        return ""
    along = _along(model, candidate, told)
    if along is None:
        return ""
    parts = _by_record(model, along)
    if candidate.effect.n_states:
        parts = [part[:, part.shape[1] // 2 :] for part in parts]
    moves = np.concatenate([part - np.mean(part, axis=1, keepdims=True) for part in parts], axis=1)
    u, y = np.linalg.norm(moves, axis=1)
    if y >= GATES.absorbed_share * u:
        return ""
    return f"nothing of {candidate.site.name} comes through it in the recordings, as through any cut"


def creeping(model: Null, candidate: Candidate, told: FitResult) -> str:
    """Why play at a signal is not what its name says, where the rounding of its kinks lets the follower creep
    within the width, by much of what the play itself holds back: whatever relaxes does that. Empty where the
    follower rests."""
    if candidate.effect.class_name != PLAY:
        return ""
    along = _along(model, candidate, told)
    if along is None:
        return ""
    half = 0.5 * _width(candidate, told)
    crept, held = 0.0, 0.0
    for u, y in _by_record(model, along):
        resting = _resting(u, y[0], half)
        crept += float(np.sum((y - resting) ** 2))
        held += float(np.sum((u - resting - np.mean(u - resting)) ** 2))
    if crept <= GATES.max_crept**2 * held:
        return ""
    return f"its follower creeps within the width ({2.0 * half:.4g}), which whatever relaxes does as well"


def turned_back(model: Null, candidate: Candidate, told: FitResult) -> str:
    """Why a gain that falls with its signal is not what its name says, where less comes through the more goes
    in over much of what the recordings reach: the first term of a bend does not hold that far, and whatever
    holds a signal back where it begins largest does the same. Empty where more comes through all along, or
    little less."""
    if not any(is_bend(p) for p in candidate.effect.sizes):
        return ""
    along = _along(model, candidate, told)
    if along is None:
        return ""
    u, y = np.abs(along)
    summit = int(np.argmax(y))
    if y[np.argmax(u)] >= (1.0 - GATES.max_turned) * y[summit]:
        return ""
    return f"{TURNS_BACK} beyond {u[summit]:.3g} (recorded to {u.max():.3g}), as no gain does"


def too_wide(model: Null, candidate: Candidate, told: FitResult) -> str:
    """Why play at a signal is not what its name says, where it is wider than all that the signal does in the
    recordings: a follower that was pushed once is never pushed back, and where each piece of a record has a
    start of its own, some steps pass and others do not. Empty where the signal passes the width."""
    if candidate.effect.class_name != PLAY:
        return ""
    along = _along(model, candidate, told)
    width = _width(candidate, told)
    most = np.inf if along is None else float(np.ptp(along[0]))
    return "" if width < most else f"it is wider ({width:.4g}) than all that the signal does ({most:.4g})"


def _width(candidate: Candidate, told: FitResult) -> float:
    """Of a play, in the unit of its signal."""
    return abs(told.theta[f"{candidate.name}.width"])


def _resting(u: np.ndarray, first: float, half: float) -> np.ndarray:
    """What comes out of play (n,) where u (n,) goes in: it begins at `first` and rests until u is `half` of
    its width away."""
    y, one = np.empty_like(u), first
    for k, value in enumerate(u):
        one = min(max(one, value - half), value + half)
        y[k] = one
    return y


NOT_SIGNIFICANT = "its size is not significant"
NO_BEND = "the recordings show no bend of it"
STRAIGHT = (GAIN, "Daest.Effects.Signals.Offset")  # what a law without its bend is


def straight(model: Null, candidate: Candidate, told: FitResult) -> str:
    """Why a law that bends a signal at places along it, or everywhere, is not what its name says, where the
    recordings show it straight: a gain with an offset, which other parameters may be, too. Empty where it
    bends. Of a dead zone from whose one side alone the recordings are, the offset is the width: it stays."""
    bend = _bend(model, candidate, told) if bends(candidate) else None
    if bend is None or bend.rest >= GATES.absorbed_share * bend.size:
        return ""
    return f"{NO_BEND}: it is a gain of {1.0 + bend.slope:.3g} and an offset of {bend.offset:.3g}"


def same_in_machine(model: Null, candidate: Candidate, told: FitResult) -> str:
    """What a law that bends a sensor may be as well where every reading tells one value and no other output
    tells the same signal: in terms of the readings the equations are those of a machine whose gains and
    losses bend along. A sensor that cuts is one, too, where its readings move on beyond the limit. A lag of
    the only sensor is one more store, as long as no input moves. A rate that is limited is a smoothing over
    one time, as dead time and lags are, where all steps of the input are of one size. Empty where it is none
    such."""
    if candidate.site.kind == "input":
        return _smoothing(model, candidate, told)
    if candidate.site.kind == "output" and _is_one_more_store(model, candidate):
        return f"a further store in the machine before {candidate.site.name}"
    bend = _bend(model, candidate, told) if candidate.site.kind == "output" else None
    if bend is None or bend.rest < GATES.absorbed_share * bend.size:
        return ""
    cuts = any(p.is_share for p in candidate.effect.sizes)
    if not bend.is_monotone and not (cuts and _moves_beyond(_readings(model, candidate), bend.limits)):
        return ""
    if _tells_otherwise(grown(model, model.flat, model.explicit, told, model.experiments), candidate, bend):
        return ""
    return f"a machine that bends alike before {candidate.site.name}"


def _smoothing(model: Null, candidate: Candidate, told: FitResult) -> str:
    """The linear laws that do to an input of equal steps what a limited rate does: its ramps take one time,
    and each has ended before the next one begins. Empty where that is not so."""
    if candidate.effect.class_name != RATE_LIMIT:
        return ""
    limit = told.theta[f"{candidate.name}.limit"]
    sizes, apart = [np.empty(0)], [np.empty(0)]
    for one in model.experiments:
        changes = np.diff(one.input(candidate.site.name))
        at = np.flatnonzero(changes)
        sizes.append(np.abs(changes[at]))
        apart.append(np.diff(one.time[at]))
    steps = np.concatenate(sizes)
    if not steps.size or np.ptp(steps) > GATES.absorbed_share * steps.max():
        return ""
    lasts = float(steps.max()) / limit
    if np.concatenate(apart).min(initial=np.inf) < lasts:
        return ""
    over = spoken_duration(lasts, clock_unit(model.flat))
    return (
        f"a dead time or lags that smooth {candidate.site.name}, whose steps are all of one size, over {over}"
    )


def _is_one_more_store(model: Null, candidate: Candidate) -> bool:
    """Whether a lag of the only sensor stands for any store more: where nothing drives a machine with affine
    dynamics, all that its sensor shows are decays from unknown starts, one for each store, and a store beside
    one of the machine gives another decay as well as one behind it does."""
    if candidate.effect.class_name != LAG or len(model.flat.outputs) > 1:
        return False
    if not all(is_constant(u) for e in model.experiments for u in e.inputs.T):
        return False
    return has_affine_dynamics(model.explicit)


def _limits(u: np.ndarray, shown: np.ndarray) -> tuple[float, float]:
    """The least and the largest value that is `shown` of u, both (n,), where it stands still at that end of
    u; endless where it does not, or falls anywhere."""
    grid, order = np.linspace(u.min(), u.max(), ALONG), np.argsort(u)
    values = np.interp(grid, u[order], shown[order])
    slopes = np.diff(values) / np.diff(grid)
    rises = bool(np.all(slopes > -GATES.least_slope)) and np.ptp(values) > GATES.absorbed_share * np.ptp(u)
    low, high = (rises and slope < GATES.least_slope for slope in (slopes[0], slopes[-1]))
    return float(values[0]) if low else -np.inf, float(values[-1]) if high else np.inf


def _readings(model: Null, candidate: Candidate) -> np.ndarray:
    """Those of the output of a law (n,), one experiment after the other."""
    row = [y.name for y in model.flat.outputs].index(candidate.site.name)
    return np.concatenate([one.outputs[:, row] for one in model.experiments])


def _moves_beyond(readings: np.ndarray, limits: tuple[float, float]) -> bool:
    """Whether readings (n,) beyond the limits of what a law lets a sensor show are no noise: they go further
    than where a search may have missed the limits, and change little from sample to sample."""
    low, high = limits
    beyond = np.maximum(readings - high, low - readings)
    is_beyond = beyond > 0.0
    pairs = is_beyond[1:] & is_beyond[:-1]
    if np.count_nonzero(pairs) < GATES.min_beyond_limit:
        return False
    spread = float(np.var(beyond[is_beyond]))
    steps = float(np.mean(np.diff(beyond)[pairs] ** 2)) / 2.0
    reach = float(np.sqrt(np.mean(beyond[is_beyond] ** 2)))
    return reach > GATES.absorbed_share * np.std(readings) and steps < GATES.max_cut_noise * spread


def _tells_otherwise(bent: Null, candidate: Candidate, bend: _Bend) -> bool:
    """Whether another output tells the signal before a law that bends an output, as it is."""
    others = [i for i, y in enumerate(bent.flat.outputs) if y.name != candidate.site.name]
    runs = free_runs(bent, bent.experiments) if others else ()
    if not runs:
        return False
    return any(_is_line(np.concatenate([run.outputs[:, i] for run in runs]), bend.along) for i in others)


def _is_line(y: np.ndarray, u: np.ndarray) -> bool:
    """Whether y is a straight line in u, both (n,), that falls or rises."""
    slope, _, rest = _line(u, y)
    return bool(abs(slope) * np.std(u) > 0.0 and rest < GATES.absorbed_share * np.linalg.norm(y - np.mean(y)))


def _line(u: np.ndarray, y: np.ndarray) -> tuple[float, float, float]:
    """Slope and offset of the straight line of least squares in u for y, both (n,), and the norm of what it
    leaves."""
    slope, offset = np.linalg.lstsq(np.column_stack([u, np.ones_like(u)]), y)[0]
    return float(slope), float(offset), float(np.linalg.norm(y - slope * u - offset))


@dataclass(frozen=True)
class _Bend:
    """How a law changes its signal `along` (n,) the recordings: the `limits` of what comes out, `size` (norm)
    of the change, the straight line nearest to it, `rest` (norm) of the change beside that, and whether what
    comes out tells what goes in."""

    along: np.ndarray
    limits: tuple[float, float]
    size: float
    slope: float
    offset: float
    rest: float
    is_monotone: bool


def _bend(model: Null, candidate: Candidate, told: FitResult) -> _Bend | None:
    """None for a law with states or of another place than a signal, and where nothing can be simulated."""
    if not candidate.is_of_signal or candidate.is_dynamic:
        return None
    along = _along(model, candidate, told)
    if along is None:
        return None
    u, change = along[0], along[1] - along[0]
    size = float(np.linalg.norm(change))
    return _Bend(u, _limits(u, along[1]), size, *_line(u, change), _tells_one(u, change))


def _along(model: Null, candidate: Candidate, told: FitResult) -> np.ndarray | None:
    """What goes into a law at a signal and what comes out (2, n) in the simulation of the recordings; None
    where it cannot be simulated."""
    names = [f"{candidate.name}.{one}" for one in candidate.effect.connectors]
    along = values_along(grown(model, model.flat, model.explicit, told, model.experiments), names)
    return along if along is not None and np.all(np.isfinite(along)) else None


def _by_record(model: Null, along: np.ndarray) -> list[np.ndarray]:
    """What `_along` tells (2, n), for each of the recordings."""
    ends = np.cumsum([one.n_samples for one in model.experiments])
    return np.split(along, ends[:-1], axis=1)


def _tells_one(u: np.ndarray, change: np.ndarray) -> bool:
    """Whether every value of u + change tells one of u, both (n,): the change is a function of u, and the sum
    grows with u all along, but for where it stands still and next to nothing of the change is: a dead zone
    that is passed at the start alone."""
    grid = np.linspace(u.min(), u.max(), ALONG)
    order = np.argsort(u)
    shown = np.interp(grid, u[order], change[order])
    is_function = np.linalg.norm(np.interp(u, grid, shown) - change) < GATES.absorbed_share * np.linalg.norm(
        change
    )
    slopes = 1.0 + np.diff(shown) / np.diff(grid)
    tells = slopes > GATES.least_slope
    if not is_function or np.all(tells):
        return bool(is_function)
    cell = np.clip(np.searchsorted(grid, u, side="right") - 1, 0, slopes.size - 1)
    untold = float(np.sum(change[~tells[cell]] ** 2))
    return bool(np.all(slopes > -GATES.least_slope) and untold < GATES.max_untold * np.sum(change**2))


def beyond_recordings(model: Null, candidate: Candidate, told: FitResult) -> str:
    """Why the law lies beyond what the recordings reach or show; empty where it does not."""
    reason = crossed(candidate, told) or out_of_reach(model, candidate, told)
    reason = reason or too_slow(model.experiments, candidate, told)
    reason = reason or too_slow_for_its_size(model.experiments, candidate, told)
    reason = reason or too_fast(model.experiments, candidate, told)
    reason = reason or shut(model, candidate, told) or too_wide(model, candidate, told)
    reason = reason or creeping(model, candidate, told) or turned_back(model, candidate, told)
    return reason or straight(model, candidate, told)


def is_place(parameter: EffectParameter) -> bool:
    """Whether a shape along a variable is a place there: it is looked for near the end of its reach."""
    return PLACED <= max(map(abs, parameter.grid), default=0.0) < 1.0


def _is_phase(parameter: EffectParameter) -> bool:
    """Whether a shape is an angle that counts from nowhere."""
    return parameter.role == "shape" and parameter.unit == "rad" and not parameter.scale_of


def _is_ratio(parameter: EffectParameter) -> bool:
    """Whether a shape is a pure number and no number of periods, which is seen where it is right."""
    is_number = parameter.unit == "1" and not parameter.scale_of and not parameter.periods_over
    return parameter.role == "shape" and is_number


def _is_known(
    parameter: FittedParameter, declared: EffectParameter, certainty: float, least_of_place: float
) -> bool:
    if declared.role == "size" and parameter.at_bound == "max" and (declared.null or 0.0) < parameter.value:
        return True  # as much of the effect as there can be
    return certainty >= (least_of_place if is_place(declared) else GATES.min_significance)


def told_value(parameter: FittedParameter) -> str:
    """The parameter of an effect with its uncertainty, as messages tell it."""
    return _told(parameter.name.partition(".")[2], parameter)


def _told(name: str, one: FittedParameter | KnownProduct) -> str:
    return f"{name} = {told_number(one)}"


def told_number(one: FittedParameter | KnownProduct) -> str:
    """A value with its uncertainty and unit, as messages tell it."""
    error = "" if one.std_error is None else f" ± {one.std_error:.2g}"
    return with_unit(f"{one.value:.4g}{error}", one.unit)


def told_values(proof: Proof) -> str:
    """The parameters of a law with their uncertainties, and what is known of them beside others alone, as
    messages tell them: of a place that may be anywhere, as the one of two stops that is never reached, no
    more than that; and the number of periods in a turn that the screen has found."""
    own = f"{proof.candidate.name}."
    places = {own + p.name: p for p in proof.candidate.effect.parameters if is_place(p)}

    def said(p: FittedParameter) -> str:
        is_open = p.name in places and _is_anywhere(p, reach_of(proof.candidate, places[p.name]))
        return f"{p.name.removeprefix(own)} not reached" if is_open else told_value(p)

    told = [said(p) for p in proof.told.parameters if p.name.startswith(own)]
    told += [*_told_periods(proof.candidate), *_told_middles(proof.candidate)]
    return ", ".join(told + [_told(p.name, p) for p in known_products(proof.candidate, proof.told)])


def _is_anywhere(place: FittedParameter, reach: float) -> bool:
    """Whether a place along a variable may be at nothing and beyond all that the variable reaches: one that
    is known to be near nothing, as where a drain dries up, is a place like others."""
    if place.std_error is None:
        return False
    return place.std_error > abs(place.value) and abs(place.value) + place.std_error > reach


def reach_of(candidate: Candidate, place: EffectParameter) -> float:
    """How far the recordings take the variable that a place lies on, as the rounding of the law's kink over
    the same variable has it; 0 where the law has none."""
    for p in candidate.effect.parameters:
        if p.role == "sharpness" and p.scale_of == place.scale_of and p.grid and p.name in candidate.shape:
            return abs(candidate.shape[p.name]) / p.grid[0]
    return 0.0


def _told_periods(candidate: Candidate) -> list[str]:
    """What the screen, and no fit, has counted: how often a law repeats."""
    counted = [p for p in candidate.effect.parameters if p.periods_over and not p.estimate]
    return [f"{p.name} = {candidate.shape.get(p.name, p.start):.4g}" for p in counted]


def _told_middles(candidate: Candidate) -> list[str]:
    """Where a parameter that changes with a variable has its value."""
    middles = [p for p in candidate.effect.parameters if p.signal_unit == "z"]
    return [
        f"{p.name} = {with_unit(f'{candidate.shape[p.name]:.4g}', candidate.units[p.name])}" for p in middles
    ]


def unexplained(explained: float, ratios: Sequence[float]) -> str:
    """Why the effect does away with too little of the load; empty where it does with enough."""
    if explained >= (
        GATES.min_partly_explained
        if ratios and max(ratios) <= GATES.max_simulated_ratio
        else GATES.min_explained
    ):
        return ""
    return f"it explains only {100 * explained:.0f} % of the unexplained load"


def _weak_size(size: FittedParameter, null: float, least: float, certainty: float) -> str:
    if size.at_bound == "max" and null < size.value:
        return ""  # as much of the effect as there can be
    if size.at_bound:
        return f"its size rests at its bound ({size.at_bound} = {size.value:.4g})"
    if size.std_error is None:
        return "the data do not determine its size"
    if certainty < least:
        asked = f"{certainty:.2g} of the {least:g} standard errors that are asked for"
        return f"{NOT_SIGNIFICANT} ({told_number(size)}: {asked})"
    return ""


def wrong_law(
    null: Null,
    run: NullObserver,
    prepared: Prepared,
    fit: FitResult,
    gain: float,
    left: FreeForm,
    says_most: bool = True,
) -> str:
    """Why the law is not the right one: what it leaves follows a variable, and a single curve over that
    variable would say all that the law says, too. Empty where the rest is small, unrelated, or the law of
    something else that is missing besides; and where the law is such a curve itself, says more than the
    rest does and `says_most` of the load or of the error: then it is right but for details, which are
    named."""
    is_in_the_main = says_most and not left.sign_of and gain > left.log_likelihood_gain
    if is_in_the_main or not is_significant(left, gain):
        return ""
    try:
        response = law_response(null, run, prepared.trial.candidate, fit.theta)
    except DaestError:
        # A law with states of its own has no response. One that stands for dry friction, too, is a curve with
        # the sign of the speed in the main.
        is_covered = prepared.similar is not None and bool(left.sign_of)
    else:
        is_covered = covers(null, run, left, response) >= GATES.min_covered
    if not is_covered:
        return ""
    return f"another law acts there: what it leaves still follows {left.label} (p = {left.p_value:.1g})"


def other_dynamics(left: FreeForm, gain: float, ratios: Sequence[float]) -> str:
    """Why a law that changes the order of the model only stands for another one; empty where it is right. A
    slow motion takes a lag, a delay or a flexible part for each other, and only the right one leaves
    nothing; or little, where unseen data are simulated much better with it (`ratios` of the errors, with to
    without it), beside what else a machine does."""
    is_confirmed = bool(ratios) and max(ratios) <= GATES.max_simulated_ratio
    share = GATES.max_rounding_rest if is_confirmed else GATES.max_rest_of_dynamics
    if left.p_value >= GATES.dynamics_level or left.log_likelihood_gain <= share * gain:
        return ""
    return (
        "something dynamic is missing that it only comes near to: what it leaves still follows "
        f"{left.label} (p = {left.p_value:.1g})"
    )


def lag_too_short(null: Null, candidate: Candidate, fit: FitResult) -> str:
    """Why a lag or a delay is no finding of its own beside the model as `fit` has it; empty where it is long
    enough to be one, or where the model has no time constant: no states, or nothing but integrators."""
    times = [fit.theta[f"{candidate.name}.{p.name}"] for p in candidate.effect.sizes if p.unit == "s"]
    if not times:
        return ""
    run = run_null(replace(null, flat=null.flat.with_theta(fit.theta)))
    loads = {load.name for load in null.loads}
    own = [i for i, name in enumerate(run.state_names) if name not in loads]
    fastest = max(np.abs(np.linalg.eigvals(run.average.A[np.ix_(own, own)])), default=0.0)
    ratio = max(times) * fastest
    if ratio >= GATES.min_lag or (min(times) > 0.0 and ratio < np.finfo(float).eps):
        return ""
    shortest = spoken_duration(1.0 / fastest, clock_unit(null.flat))
    return (
        f"its time is short beside the fastest time constant of the model ({shortest}): a lag, a delay or a "
        "flexible part would do as well"
    )


def is_significant(left: FreeForm, gain: float) -> bool:
    """Whether what is left beside an effect that gained `gain` in log-likelihood is worth a further look."""
    return left.p_value < GATES.rest_level and left.log_likelihood_gain > GATES.max_rounding_rest * gain
