"""What changed in a machine that its model described until then."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.evidence.stand import without_noises
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.loads import load_sites
from daest.diagnosis.null_model.null import slowest_load
from daest.diagnosis.options import DiagnoseOptions
from daest.errors import DaestError
from daest.model.diagnosis import Diagnosis, Proof
from daest.model.effects import Effect
from daest.model.experiment import Experiment
from daest.model.flat import FlatModel, Model

UNNAMED = ("nothing missing", "parameters off", "external disturbance")


def diagnose_change(
    model: Model,
    library: Sequence[Effect],
    before: Experiment | None,
    after: Experiment,
    options: DiagnoseOptions,
    lasts: bool = False,
) -> Diagnosis:
    """What is missing `after` a change that sequential tests told; `lasts`: told more than once.

    The diagnosis admits unknown loads of any time constant, and a load that acts slowly can stand for many a
    small effect, alone or with parameters that are a little off. Where no effect is named for that, the
    recording `before` the change tells how slow the loads of this machine are, and the change is diagnosed
    beside loads that are no slower. Raises as `diagnose`.
    """
    found = diagnose(model, library, [after], (), options)
    limit = None if _is_named(found) else _slowest(model, before, options)
    if limit is not None:
        found = _better(
            found, diagnose(model, library, [after], (), replace(options, slowest_load=limit)), limit
        )
    return _cannot_tell(found, lasts) if found.verdict == "nothing missing" else found


def _is_named(found: Diagnosis) -> bool:
    return found.verdict not in UNNAMED and not (found.verdict == "cannot tell" and _open(found))


def _open(found: Diagnosis) -> list[Proof]:
    """The laws of which one is missing, where the data do not separate them."""
    return [proof for proof in found.proofs if proof.verdict == "not separable"]


def _slowest(model: Model, before: Experiment | None, options: DiagnoseOptions) -> float | None:
    """The limit for the time constants of the loads [s]; None where it cannot be told."""
    if before is None or before.n_samples < GATES.min_samples:
        return None
    if not isinstance(model, FlatModel) or model.events is not None:
        return None
    try:
        return slowest_load(without_noises(model), load_sites(model), [before], options.hold)
    except DaestError:
        return None


def _better(first: Diagnosis, second: Diagnosis, limit: float) -> Diagnosis:
    """The second diagnosis where it names one of those that the first left open, or where that was silent."""
    told = [p for p in second.proofs if p.verdict == "supported"] or _open(second)
    left = {proof.candidate.effect.class_name for proof in _open(first)}
    says_more = bool(told) and (not left or {p.candidate.effect.class_name for p in told} < left)
    seconds = first.seconds + second.seconds
    if not says_more or second.verdict not in ("supported", "cannot tell"):
        return replace(first, seconds=seconds)
    known = f" Before the change no unknown load was slower than {limit:.2g} s, and none is admitted here."
    return replace(second, message=second.message + known, seconds=seconds)


def _cannot_tell(found: Diagnosis, lasts: bool) -> Diagnosis:
    """The innovations have told a change that no effect explains better than parameters and noise which are
    estimated anew."""
    what = "no longer holds as it is" if lasts else "may no longer hold, or the alarm was a false one"
    text = f"The model {what}; the samples since the change do not tell what is missing. {found.message}"
    return replace(found, verdict="cannot tell", message=text)
