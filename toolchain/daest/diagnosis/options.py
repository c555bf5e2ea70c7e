"""How a diagnosis is made: what is searched for, where refits run, and what keeps them."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, TypeVar

from daest.diagnosis.built_in.trials import Prepared
from daest.diagnosis.screening.clipping import Clip, clips_of
from daest.model.diagnosis import Proof
from daest.model.experiment import Experiment
from daest.model.fit import FitResult
from daest.model.flat import Model
from daest.model.holds import Hold

MOST_TRIALS = 5
REFIT_SECONDS = 3.0  # times that of the model as it is: a refit has more parameters, and is judged besides

Progress = Callable[[str], None]


Step = TypeVar("Step")


class Keeper(Protocol):
    """Keeps proofs, so that an interrupted run goes on where it was."""

    def found(self, prepared: Prepared) -> Proof | None: ...

    def keep(self, prepared: Prepared, proof: Proof) -> None: ...

    def step(self, name: str, parts: Sequence[Any], flat: Model, make: Callable[[], Step]) -> Step: ...


@dataclass(frozen=True)
class DiagnoseOptions:
    """`effects` and `places` restrict the search by name. `hold` None takes the better one; `tried` is
    one that a search which begins again tries, and may leave. `fitted` are parameter values of an
    earlier fit, which the data may contradict. Refits run in `jobs` processes where that is worth while,
    or on the Dask `cluster` at an address, with the same results; `keeper` knows those of an earlier
    run. `clipped` are the limits at which outputs stay, by output (None: as the experiments show them):
    a sensor that cuts is tried there first, or taken for granted where it is certain. `held` are the
    experiments and the validation data to take for the hold "zoh" where all of them are coarser than the
    recordings: straight lines then stand for what was held. `slowest_load` limits the time constants of
    unknown loads [s], where it is known how slow they are (None: the length of the record does). `near`
    are parameter values that are known from the other hold, from which the search of the model as it is
    begins, and `known` is the fit with the hold that is tried, where there is one. After `time_limit` seconds
    no further refit is made, and those that run are given up: from the moment `until` of `time.monotonic`
    on."""

    effects: tuple[str, ...] = ()
    places: tuple[str, ...] = ()
    hold: Hold | None = None
    tried: Hold | None = None
    seed: int = 0
    jobs: int = 2
    cluster: str | None = None
    most_trials: int = MOST_TRIALS
    fitted: Mapping[str, float] = field(default_factory=dict)
    keeper: Keeper | None = None
    clipped: Mapping[str, Clip] | None = None
    held: tuple[Sequence[Experiment], Sequence[Experiment]] | None = None
    slowest_load: float | None = None
    near: Mapping[str, float] = field(default_factory=dict)
    known: FitResult | None = None
    time_limit: float = math.inf
    until: float = math.inf

    def begun(self) -> DiagnoseOptions:
        """The options with the time running."""
        until = min(self.until, time.monotonic() + self.time_limit)
        return replace(self, time_limit=math.inf, until=until)

    @property
    def is_over(self) -> bool:
        return time.monotonic() >= self.until

    def clips(self, experiments: Sequence[Experiment]) -> Mapping[str, Clip]:
        """`clipped`, or what the experiments themselves show."""
        return clips_of(experiments) if self.clipped is None else self.clipped

    def step(self, name: str, parts: Sequence[Any], flat: Model, make: Callable[[], Step]) -> Step:
        """What `make` returns, now or in an earlier run that was interrupted."""
        return make() if self.keeper is None else self.keeper.step(name, parts, flat, make)
