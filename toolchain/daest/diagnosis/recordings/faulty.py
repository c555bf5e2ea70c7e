"""What is known of a recording that may be all that its model does not match: sensors that stand still, drop
out or jump, values between their readings, and values that are those of an input."""

from __future__ import annotations

from collections.abc import Sequence

from daest.data.check import check_experiment
from daest.data.faults import clock_findings
from daest.estimation.fitting.signals import is_constant
from daest.lists import first_few
from daest.model.experiment import Experiment, Finding

FAULTS = ("check-stuck", "check-dropouts", "check-outliers", "check-interpolated", "check-copied")
EXPLAINED = ("nothing missing", "parameters off", "supported")  # verdicts that say what the data show
EMPTY = "Leave the cells of these samples empty, as missing, and diagnose again."
PAUSE = "check-clock-jump"
PAUSED = "Make two recordings of it, cut where the clock pauses, and diagnose again."
MOST_TOLD = 3


def faults_told(experiments: Sequence[Experiment]) -> str:
    """A sentence on the faults of outputs in the recordings, which may be what is missing; empty where there
    are none."""
    texts = _faults(experiments)
    return f" It may be faults of the recording: {texts}." if texts else ""


def pauses_told(experiments: Sequence[Experiment]) -> str:
    """A sentence on the pauses of recordings whose inputs move, in which these may have done anything; empty
    where there are none."""
    driven = [e for e in experiments if not all(is_constant(u) for u in e.inputs.T)]
    texts = _listed([f for e in driven for f in clock_findings(e.time) if f.code == PAUSE])
    return f" It may be what the inputs did unseen: {texts}." if texts else ""


def faults_counted(verdict: str, fitted: Sequence[Experiment], unseen: Sequence[Experiment]) -> str:
    """A sentence on faults of the recordings, which sizes and errors count. Where the data are not explained,
    those of `unseen` ones alone: a load that acts in those `fitted` is none of their faults."""
    if verdict == "supported":
        return faults_beside([*fitted, *unseen])
    return faults_in_errors([*fitted, *unseen] if verdict in EXPLAINED else unseen)


def faults_beside(experiments: Sequence[Experiment]) -> str:
    """The same beside a law, whose sizes and errors they bend."""
    return _counted("Its sizes and errors", experiments)


def faults_in_errors(experiments: Sequence[Experiment]) -> str:
    """The same where the model lacks nothing: they are in its errors, and in the noise that these are held
    against."""
    return _counted("The errors", experiments)


def _counted(what: str, experiments: Sequence[Experiment]) -> str:
    texts = _faults(experiments)
    return f" {what} count faults of the recording: {texts}. {EMPTY}" if texts else ""


def _faults(experiments: Sequence[Experiment]) -> str:
    """The faults of outputs in the recordings, listed; empty where there are none."""
    names = {name for e in experiments for name in e.output_names}
    found = [f for e in experiments for f in check_experiment(e).findings if f.code in FAULTS]
    return _listed([f for f in found if f.column in names])


def _listed(findings: Sequence[Finding]) -> str:
    texts = list(dict.fromkeys(one.sentence for one in findings))
    return first_few(texts, MOST_TOLD, separator="; ")
