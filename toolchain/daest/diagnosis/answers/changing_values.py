"""Parameters of a model that may change with time, where a law of the time alone was accepted.

What a heat source seems to lose from hour to hour, a conductance may gain: a zero that drifts and a parameter
that changes differ only where the machine works at other levels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from daest.diagnosis.answers.held_values import OtherValue, most_telling
from daest.diagnosis.built_in.settled import FAILURES
from daest.diagnosis.evidence.stand import Stand
from daest.diagnosis.null_model.null_observer import NullObserver
from daest.diagnosis.screening.candidates import attached, brings_time
from daest.diagnosis.screening.responses import size_names
from daest.model.diagnosis import Candidate, Proof
from daest.model.effects import Effect
from daest.model.flat import FlatModel
from daest.modelica.places.sites import changeable
from daest.systems.reduction.reduce import reduce_index

CHANGE = "DriftingParameter"


@dataclass(frozen=True)
class ChangingValue(OtherValue):
    """A parameter that changes with time by `percent` ± `error` of its value over the first recording."""

    name: str = ""
    percent: float = 0.0
    error: float = 0.0

    @property
    def answer(self) -> str:
        others = " or ".join(f"`{name}`" for name in self.alike)
        which = f"`{self.name}` (or {others}, which the sensors see alike)" if others else f"`{self.name}`"
        return f"a change of {which} with time, by {self.percent:.3g} ± {self.error:.2g} % over the recording"

    @property
    def given(self) -> tuple[str, ...]:
        return ()  # no value of it would say as much

    @property
    def advice(self) -> str:
        return f"see whether `{self.name}` can change before an effect is believed"

    @property
    def settled_by(self) -> str:
        return (
            "Record at other levels of the inputs: what a signal loses with time stays the same there, what "
            f"`{self.name}` does grows with them."
        )


def changing_value(
    stand: Stand, run: NullObserver, law: Proof, library: Sequence[Effect]
) -> ChangingValue | None:
    """The parameter whose change with time shows most in the innovations, estimated, where the accepted `law`
    is one of the time alone; None where it is not, or a changing parameter itself, and where none shows, can
    be estimated or certainly changes."""
    null = stand.null
    effect = next((one for one in library if one.name == CHANGE), None)
    if effect is None or not isinstance(law.flat, FlatModel) or not brings_time(null.flat, law.flat):
        return None
    if law.candidate.is_of_parameter:
        return None
    places = changeable(stand.declared)
    changes = {site.name: Candidate(effect, site, f"change_{i}", {}) for i, site in enumerate(places)}
    try:
        flat = attached(null.flat, tuple(changes.values()))
        inner = replace(null, flat=flat, explicit=reduce_index(flat))
    except FAILURES:
        return None
    rates = {name: of for of, one in changes.items() for name in size_names(one)}
    found = most_telling(replace(stand, null=inner), run, tuple(rates))
    if found is None or not found.parameter.std_error:
        return None
    time = null.experiments[0].time
    share = 100.0 * float(time[-1] - time[0])
    return ChangingValue(
        found.parameter, found.held, found.delta_bic, found.ratios,
        tuple(rates[r] for r in found.alike), found.is_all, rates[found.parameter.name],
        share * found.parameter.value, share * found.parameter.std_error,
    )  # fmt: skip
