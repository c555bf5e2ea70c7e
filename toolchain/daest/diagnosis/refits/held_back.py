"""Laws that a lag of a sensor, or another law, holds back.

A speed that a controller forms from differences of an encoder comes some samples late. An unknown load takes
this error for a force; a law in place of that load foresees the next samples worse, however right it is, and
the lag alone foresees later ones worse for want of the law. Both are refused, although each would stand
beside the other. What is missing is then looked for once more, with the lag in the model.

So is it with two laws of which one spoils what the other simulates: what takes most of a load, and makes the
recordings far likelier than all that is accepted, may be of no certain size without loads, since a constant
that is missing as well is simulated by it.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from daest.diagnosis.built_in.settled import FAILURES
from daest.diagnosis.evidence.proof import bic_gain
from daest.diagnosis.evidence.reasons import crossed, is_significant, told_values
from daest.diagnosis.evidence.stand import Stand
from daest.diagnosis.gates import GATES
from daest.diagnosis.options import DiagnoseOptions
from daest.diagnosis.refits.rounds import accept, proved_again
from daest.model.diagnosis import Diagnosis, Proof
from daest.model.fit import FitResult, FittedParameter, error_ratios
from daest.numerics.deadline import OutOfTimeError, until
from daest.numerics.statistics import chi2

MOST_INSTEAD = 3  # lags of other signals that are tried beside a law


def lags_in_the_way(found: Diagnosis) -> list[Proof]:
    """The refused lags of signals, with as few states as any and the likeliest first, beside which a refused
    law of another kind may be accepted: such a lag makes the recordings likelier than any law does, and what
    it leaves follows a variable or was not looked at, since it foresees unseen data worse, or the simulation
    of these is far better with a law, or far from them with the lag. Empty where something is accepted, but
    for what explains far less than a lag does, for a law of another kind that its simulation alone shows
    and that leaves errors far from the noise, and for a parameter that changes, which may do the work of
    several laws, or there is no such lag."""
    proofs = [p for p in found.proofs if not p.candidate.is_of_parameter]
    outdoing = {p.candidate.label for p in proofs if p.verdict == "rejected" and _is_dynamics_of_signal(p)}
    accepted = [
        proof
        for proof in proofs
        if proof.verdict != "rejected" and not outdoing & set(proof.not_separable_from)
    ]
    if not all(
        proof.is_by_use and _leaves_errors(proof) and not _is_dynamics_of_signal(proof) for proof in accepted
    ):
        return []
    # By its simulation a law is likelier than that of the model, and not than a lag beside loads; one with
    # states of which the data show too little follows whatever a lag does.
    laws = [p for p in proofs if not (p.candidate.is_dynamic or p.is_by_use or _is_anything(p))]
    # Beside a lag that leaves nothing, none that is less likely has held anything back.
    enough = [p for p in proofs if _is_dynamics_of_signal(p) and not _leaves_anything(p)]
    least = max((p.delta_bic for p in (*laws, *enough)), default=0.0)
    is_shown = bool(accepted) or any(_is_shown(found, p) for p in laws)
    likely = [
        p
        for p in proofs
        if _is_dynamics_of_signal(p)
        and p.delta_bic > max(least, GATES.min_told_bic_gain)
        and (is_shown or _leaves_anything(p))
    ]
    fewest = min((p.candidate.effect.n_states for p in likely), default=0)
    return sorted(
        (p for p in likely if p.candidate.effect.n_states == fewest), key=lambda p: p.delta_bic, reverse=True
    )


def laws_in_the_way(found: Diagnosis) -> list[Proof]:
    """The refused laws, the likeliest first, that take most of the load, with a size that is certain beside
    loads, and against which nothing speaks but that it is not certain without them; empty where something is
    accepted that is as likely, or leaves no errors."""
    proofs = [p for p in found.proofs if not p.candidate.is_of_parameter]
    accepted = [p for p in found.proofs if p.verdict != "rejected"]
    if not all(_leaves_errors(p) for p in accepted):
        return []
    least = max((p.delta_bic for p in accepted), default=0.0) + GATES.min_told_bic_gain
    return sorted(
        (
            p
            for p in proofs
            if p.verdict == "rejected"
            and (p.is_vague or p.is_open)
            and not p.candidate.is_dynamic
            and not p.is_by_use
            and p.delta_bic > least
            and p.explained >= GATES.min_explained
            and _is_certain_beside_loads(p)
        ),
        key=lambda p: p.delta_bic,
        reverse=True,
    )


def is_seen_beside(stand: Stand, first: Proof, last: Proof, options: DiagnoseOptions) -> bool:
    """Whether a law that was refused in the model of `stand`, the `first`, is accepted there beside the
    `last`, which was accepted beside it; not, where the time is up before that is known."""
    with suppress(OutOfTimeError, *FAILURES), until(options.until):
        alone = proved_again(stand, last, last.fit.theta)
        return proved_again(accept(stand, alone, options.jobs), first, last.fit.theta).verdict != "rejected"
    return False


def is_needed_beside(stand: Stand, lag: Proof, law: Proof, options: DiagnoseOptions) -> bool:
    """Whether a refused `lag` is a part of what is missing beside the `law` that was accepted beside it: it
    is accepted in the model with that law, or unseen data are simulated worse without it. Another one rounds
    the form of a law that is not quite right. It is, too, where the time is up before that is known."""
    with suppress(OutOfTimeError, *FAILURES), until(options.until):
        alone = proved_again(stand, law, law.fit.theta)
        ratios = error_ratios(alone.told.simulated, law.told.simulated)
        if not ratios or min(ratios) < 1.0:
            return True
        return proved_again(accept(stand, alone, options.jobs), lag, law.fit.theta).verdict != "rejected"
    return True


def without(second: Diagnosis, lag: Proof) -> Diagnosis:
    """The diagnosis beside a `lag` that nothing proves: with the law that was accepted there, and what is
    said of the lag."""
    label = lag.candidate.label
    kept = [p for p in second.proofs if p.verdict != "rejected" and p.candidate.label != label]
    refused = replace(lag, reason="unseen data are simulated as well without it, beside the law")
    others = [p for p in second.proofs if p.verdict == "rejected"]
    message = second.message.partition(f" {label} (")[0]
    message += (
        f" With {label} in the model besides the recordings are likelier, and unseen data are simulated no "
        "better: nothing proves it, and what is fast there may be the form of the law."
    )
    return replace(second, message=message, proofs=(*kept, refused, *others))


def _is_certain_beside_loads(proof: Proof) -> bool:
    return any(_is_known(p) for p in _sizes_in(proof.fit, proof))


def _sizes_in(fit: FitResult, law: Proof) -> list[FittedParameter]:
    """The sizes of a law in a fit of a model that holds it."""
    names = {f"{law.candidate.name}.{p.name}" for p in law.candidate.effect.sizes}
    return [p for p in fit.parameters if p.name in names]


def lag_instead(stand: Stand, others: Sequence[Proof], law: Proof, options: DiagnoseOptions) -> Proof | None:
    """The one of the first of some `others` lags that the model of `stand` should have in place of the
    likeliest one, beside which the `law` was accepted; None where the recordings are no likelier with any.
    Alone, a lag of a sensor also rounds what the missing law does, and so it may lead that of an input."""
    found: list[tuple[float, Proof]] = []
    if law.is_by_use:  # its fit is that of a simulation
        return None
    with suppress(OutOfTimeError), until(options.until):
        for other in others[:MOST_INSTEAD]:
            with suppress(*FAILURES):
                again = proved_again(accept(stand, other, options.jobs), law, law.fit.theta)
                found.append((again.fit.log_likelihood, other))
    best = max(found, key=lambda one: one[0], default=None)
    gain = 0.0 if best is None else 2.0 * (best[0] - law.fit.log_likelihood)
    return best[1] if best is not None and gain > GATES.min_bic_gain else None


def _is_anything(proof: Proof) -> bool:
    """Whether a law has states of its own, and is not told from any other."""
    return bool(proof.candidate.effect.n_states) and not proof.is_known


def _is_dynamics_of_signal(proof: Proof) -> bool:
    """Whether a law brings a signal dynamics of its own, such as a lag."""
    return proof.candidate.is_dynamic and proof.candidate.is_of_signal


def _leaves_anything(proof: Proof) -> bool:
    return _leaves_a_form(proof) or _leaves_errors(proof)


def _leaves_a_form(proof: Proof) -> bool:
    """Whether what a lag leaves follows a variable, or may."""
    return proof.left is None or is_significant(proof.left, 0.0)


def _leaves_errors(proof: Proof) -> bool:
    """Whether unseen data are simulated with errors far above the noise of a sensor."""
    noise = {n.name: n.value for n in proof.fit.noises if n.kind == "measurement"}
    unseen = proof.told.simulated.get("validation")
    left = {} if unseen is None else unseen.rms
    return any(name in noise and error > GATES.max_noise_left * noise[name] for name, error in left.items())


def _is_shown(found: Diagnosis, proof: Proof) -> bool:
    """Whether the simulation with a refused law foresees unseen data far better than that without."""
    if not proof.is_known or proof.delta_bic < GATES.min_told_bic_gain:
        return False
    ratios = error_ratios(found.baseline.simulated, proof.told.simulated)
    return max(ratios, default=np.inf) < GATES.max_told_ratio


def _is_gone(lag: Proof, law: Proof) -> bool:
    """Whether nothing is left of the lag, or what stands in its place, beside the law that was accepted
    there. A whole simulation tells the time of a short lag roughly, by errors that last; the time that
    predictions tell, and it confirms, is there."""
    own = _sizes_in(law.told, lag)
    beside_loads = {p.name: p for p in law.fit.parameters if _is_known(p)}
    return bool(own) and not any(
        _is_known(p) or (p.name in beside_loads and _is_within(p, beside_loads[p.name])) for p in own
    )


def _is_known(parameter: FittedParameter) -> bool:
    return bool(parameter.std_error and abs(parameter.value) > GATES.min_significance * parameter.std_error)


def _is_within(rough: FittedParameter, other: FittedParameter) -> bool:
    """Whether an estimate is within its standard error of another one, and off zero by more than that."""
    error = rough.std_error or 0.0
    return abs(rough.value - other.value) <= error < abs(rough.value)


def _simulates_worse(both: Proof, stand: Stand) -> bool:
    """Whether unseen data are simulated no better with a law and a lag than without, where errors do not add
    up: whatever they gain beside loads, they are not what the machine does."""
    if stand.reference is None or stand.reference.adds_up:
        return False
    ratios = error_ratios(stand.told.simulated, both.told.simulated)
    return bool(ratios) and float(np.mean(np.square(ratios))) >= 1.0


def foresees_no_better(law: Proof, alone: Diagnosis) -> bool:
    """Whether the `law` beside a lag leaves most of the errors of simulated unseen data that one which is
    accepted `alone` leaves: what is far above the noise of a sensor does not come from the lag, then."""
    accepted = [p for p in alone.proofs if p.verdict != "rejected"]
    ratios = [error_ratios(p.told.simulated, law.told.simulated) for p in accepted]
    return any(max(one) > GATES.max_most_ratio for one in ratios if one)


def told_beside(first: Proof, stand: Stand, beside: Stand) -> Proof:
    """The proof of a law by the model of `beside`, that of `stand` with the law."""
    gain = beside.baseline.log_likelihood - stand.baseline.log_likelihood
    n_own = first.candidate.n_unknowns
    return replace(
        first,
        fit=beside.baseline,
        delta_log_likelihood=gain,
        delta_bic=bic_gain(gain, n_own, stand.null),
        p_value=float(chi2.sf(2.0 * max(gain, 0.0), n_own)),
        verdict="supported",
        reason="",
        final=beside.told,
    )


def with_both(second: Diagnosis, first: Proof, stand: Stand, alone: Diagnosis) -> Diagnosis | None:
    """The `second` diagnosis, beside a lag or another law that was put in the `first`, with this told; None
    where it accepts nothing, nothing beside which that is still there and what it is called, or nothing with
    which unseen data are simulated any better than by the model of `stand`, or far better than by what is
    accepted `alone`."""
    accepted = [proof for proof in second.proofs if proof.verdict != "rejected"]
    if not accepted or _is_gone(first, accepted[0]) or _simulates_worse(accepted[0], stand):
        return None
    if crossed(first.candidate, accepted[0].told):
        return None
    if foresees_no_better(accepted[0], alone):
        return None
    first = replace(first, final=accepted[0].told)  # beside what had held it back
    known = {proof.candidate.label for proof in alone.proofs if proof.verdict != "rejected"}
    shown = "it shows" if accepted[0].candidate.label in known else "each of both shows"
    message = (
        f"{second.message} {first.candidate.label} ({told_values(first)}) is missing besides: {shown} only "
        "beside the other, and errors are told beside it."
    )
    others = [proof for proof in second.proofs if proof.verdict == "rejected"]
    return replace(second, message=message, proofs=(*accepted, first, *others))
