"""Whether the model as it is fits elsewhere as well: what is missing bends its likelihood beside loads.

The lag of an actuator and the time in which a body comes to rest may change places: from the command to the
speed it is the same, but loads and laws act on another body, and the right law is refused there.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

from daest.diagnosis.built_in.settled import FAILURES
from daest.diagnosis.evidence.stand import Stand, quiet, without_noises
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import are_elsewhere, known_values
from daest.diagnosis.options import DiagnoseOptions
from daest.diagnosis.recordings.holds import is_unsettled
from daest.estimation.identify import identify
from daest.model.diagnosis import Diagnosis
from daest.model.fit import IdentifyOptions

ELSEWHERE = "nothing was accepted: once more with parameters as a simulation has them"


def led_elsewhere(stand: Stand, found: Diagnosis, options: DiagnoseOptions) -> DiagnoseOptions | None:
    """The options for a second look near the parameters to which the simulation of the model alone leads;
    None where something was accepted, or they are those beside loads."""
    null = stand.null
    if options.near or options.is_over or not null.estimated or not is_unsettled(found):
        return None
    with suppress(*FAILURES), quiet():
        alone = identify(
            without_noises(stand.declared),
            null.experiments,
            IdentifyOptions(method="oe", hold=null.hold, estimate=null.estimated),
        )
        near = known_values(alone)
        if are_elsewhere(near, null.fit.theta, null.estimated):
            return replace(options, tried=null.recorded_hold or null.hold, near=near)
    return None


def is_apart(there: Stand, stand: Stand) -> bool:
    """Whether a search from elsewhere has ended elsewhere, and its likelihood is not hopeless beside that of
    the model as it was."""
    lead = stand.null.fit.log_likelihood - there.null.fit.log_likelihood
    apart = are_elsewhere(there.null.fit.theta, stand.null.fit.theta, stand.null.estimated)
    return apart and lead < GATES.hopeless_log_likelihood
