"""Stages of the proof: some candidates refitted together, against the best of the stages before."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import numpy as np

from daest.diagnosis.built_in.late_signals import is_late
from daest.diagnosis.built_in.settled import FAILURES
from daest.diagnosis.built_in.trials import Prepared, Trial, moved, prepare
from daest.diagnosis.evidence.law_values import is_simpler
from daest.diagnosis.evidence.proof import is_below_null, with_steady_error
from daest.diagnosis.evidence.ranking import best_accepted, could_compete, is_settled, leader_of, ranked
from daest.diagnosis.evidence.stand import Stand, quiet
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import Null
from daest.diagnosis.options import REFIT_SECONDS, DiagnoseOptions, Progress
from daest.diagnosis.refits.ahead import ONE_COMPILATION, compilations
from daest.diagnosis.refits.attempts import proof_by_attempts
from daest.diagnosis.refits.dynamic_fits import (
    DynamicFits,
    Simulation,
    bent_fits,
    best_dynamic,
    best_simulation,
    dynamic_fits,
    nominal_simulation,
    storage_fits,
)
from daest.diagnosis.refits.in_use import (
    InOpenLoop,
    proof_in_open_loop,
    shown_in_use,
    tried_in_open_loop,
    with_simulation,
)
from daest.diagnosis.refits.search import MOST_PLACES, Search
from daest.errors import DaestError
from daest.estimation.fitting.records import n_observed
from daest.model.diagnosis import Candidate, Proof, Screen
from daest.model.fit import FitResult, follows_all
from daest.model.flat import with_equations
from daest.numerics.parallel import Outcome, Workers, called, done_by
from daest.systems.linear.linearize import has_affine_dynamics

TIME_IS_UP = "it was not refitted: the time was up"
DYNAMIC_PARTS = 3  # tasks that the fits of the effects with states are
MOST_IN_USE = 3  # trials that lead the screen in open loop
MOST_IN_PIECES = 6  # that lead that of a simulation in pieces, which takes little time
LOOP = 3  # times the time of a run where a loop is solved by iterations at every point


@dataclass(frozen=True)
class DynamicTasks:
    """Fits by simulation of effects that change the order of the model, which ask for the `null` alone: they
    may begin before anything else is known. `made` are the tasks by the labels of their effects."""

    null: Null
    made: dict[tuple[str, ...], list[Callable[[], DynamicFits]]] = field(default_factory=dict)

    @cached_property
    def simulation(self) -> Simulation | None:
        """The fit of the model as it is, from which they start."""
        with quiet():
            return best_simulation(self.null)

    def of(self, wanted: Sequence[Candidate]) -> list[Callable[[], DynamicFits]]:
        """The fits of some effects in a few parts, the same ones whenever they are asked for; none where the
        model as it is has no simulation to start from."""
        if not wanted or self.simulation is None:
            return []
        size = -(-len(wanted) // DYNAMIC_PARTS)
        parts = [wanted[i : i + size] for i in range(0, len(wanted), size)]
        labels = tuple(candidate.label for candidate in wanted)
        return self.made.setdefault(labels, [partial(_dynamic, self.null, p, self.simulation) for p in parts])


@dataclass(frozen=True)
class Stages:
    """Refits stage by stage. What is clearly worse than the best of the stages before is cut short: what runs
    beside it makes no difference, so that the result does not depend on the number of workers. Trials for
    which the time does not suffice are `late`, candidates that no search from the screen has found `lost`."""

    search: Search
    pool: Workers
    options: DiagnoseOptions
    progress: Progress
    failed: list[tuple[Trial, str]] = field(default_factory=list)
    present: set[str] = field(default_factory=set)
    late: list[Trial] = field(default_factory=list)
    lost: list[Prepared] = field(default_factory=list)
    simulated: DynamicTasks | None = None

    def prepared(self, found: Iterable[Trial]) -> list[Prepared]:
        """The trials that can be built into the model, of the places where the sensors would see them alike
        at the first without an implicit loop, else at the first of all."""
        null, result = self.search.stand.null, []
        for trial in found:
            reason, built = "", None
            for number in range(-1, min(len(trial.alike), MOST_PLACES)):
                try:
                    here = prepare(null.flat, null.estimated, trial if number < 0 else moved(trial, number))
                    here = replace(here, explicit=here.reduced())
                    is_explicit = not null.explicit.is_symbolic or here.reduced().is_symbolic
                except DaestError as error:
                    reason = reason or error.what
                    if error.code == "effect-present":
                        self.present.add(trial.candidate.name)
                    continue
                if is_explicit or built is None:
                    built = replace(here, has_loop=not is_explicit)
                if is_explicit:
                    break
            if built is None:
                self.failed.append((trial, f"it cannot be built into the model: {reason}"))
            else:
                result.append(built)
        return result

    def proved(
        self, stage: Sequence[Prepared], before: Sequence[Proof], beside: Sequence[Callable[[], Any]] = ()
    ) -> tuple[list[Proof], list[Any]]:
        """Proofs of the candidates that can be refitted, and the results of the tasks `beside` them. What
        cannot be refitted is put down in `failed`; a task without a result has None."""
        search = replace(self.search, leader=leader_of(before))
        keeper = self.options.keeper
        known = {i: p for i, one in enumerate(stage) if keeper and (p := keeper.found(one))}
        # The longest first, so that no worker is left with one alone in the end.
        missing = sorted((i for i in range(len(stage)) if i not in known), key=lambda i: -_length(stage[i]))
        tasks: list[Callable[[], Any]] = [
            *(partial(proof_by_attempts, search, stage[i]) for i in missing),
            *beside,
        ]

        def arrived(number: int, outcome: Outcome[Any]) -> None:
            if keeper and number < len(missing) and outcome.error is None:
                keeper.keep(stage[missing[number]], outcome.get())

        seconds = REFIT_SECONDS * self.search.stand.baseline.seconds
        for i in missing:
            self.progress(f"refitting with {stage[i].trial.candidate.label}")
        outcomes = done_by(self.pool, called, tasks, self.options.until, seconds=seconds, arrived=arrived)
        for number, i in enumerate(missing):
            if number not in outcomes:
                self.late.append(stage[i].trial)
                self.failed.append((stage[i].trial, TIME_IS_UP))
            elif isinstance(outcomes[number].error, FAILURES):
                what = _what(outcomes[number].error)
                if not stage[i].by_shooting:
                    self.failed.append((stage[i].trial, f"it could not be refitted: {what}"))
                self.lost.append(stage[i])
            else:
                known[i] = outcomes[number].get()
        self.lost.extend(stage[i] for i in sorted(known) if _has_fallen_short(stage[i], known[i]))
        others = [outcomes[i].get() if i in outcomes else None for i in range(len(missing), len(tasks))]
        return [known[i] for i in sorted(known)], others

    def compile_ahead(self, leader: Prepared, following: Sequence[Prepared]) -> None:
        """Let other processes compile what the refits run, while this one pursues that of the `leader`."""
        tasks = compilations(self.search.stand.null, leader, following)
        self.pool.begin(called, tasks, seconds=ONE_COMPILATION)

    def second_tries(self, proofs: Sequence[Proof], found: Screen) -> list[Proof]:
        """All laws, those that are `lost` from the start of a simulation by multiple shooting, which takes
        longer than all other searches, as long as they may still be what is missing: none that is far from an
        accepted law that leaves nothing. How late a signal is, shifts of the recordings tell: a dead time has
        its states at the start of every segment besides, and takes longest."""
        best = best_accepted(ranked(proofs))
        names = {entry.candidate.name for entry in found.entries}
        is_told = best is not None and best.candidate.name not in names and is_settled([best])
        again = [
            replace(one, by_shooting=True)
            for one in self.lost
            if one.similar is None and one.simulation is None and not one.by_shooting
            if not is_late(one.trial.candidate)
            if not is_told and could_compete(one.trial, best, found)
        ]
        self.lost.clear()
        result = list(proofs)
        for proof in self.proved(again, proofs)[0]:
            same = next((p for p in result if _is_same_law(proof, p)), None)
            if same is None or proof.delta_log_likelihood > same.delta_log_likelihood:
                result = [*(p for p in result if p is not same), proof]
        self.lost.clear()
        return result

    @property
    def simulation(self) -> Simulation | None:
        """The fit of the model as it is by its simulation, from which those of effects with states start."""
        return self.dynamics.simulation

    @cached_property
    def dynamics(self) -> DynamicTasks:
        return self.simulated or DynamicTasks(self.search.stand.null)

    def dynamic(self, candidates: Sequence[Candidate]) -> list[DynamicFits | None]:
        """The fits of the effects that change the order of the model, in a few parts, None where the time did
        not suffice; none where there are no such effects. Dead times are fitted where a lag shows itself."""
        wanted, simplest = dynamic_effects(candidates)
        fits = self._dynamic(simplest)
        shown = {one.trial.candidate.site for part in in_time(fits) for _, one in part}
        return [*fits, *self._dynamic([c for c in wanted if c not in simplest and c.site in shown])]

    def _dynamic(self, wanted: Sequence[Candidate]) -> list[DynamicFits | None]:
        tasks = self.dynamics.of(wanted)
        return self.proved((), (), tasks)[1] if tasks else []

    def by_what_they_simulate(self, dynamic: Sequence[Prepared]) -> tuple[list[Prepared], list[Prepared]]:
        """Effects with states whose simulation leaves so little of the errors of the model as it is that they
        lead all other candidates; and the others."""
        if self.simulation is None:
            return [], list(dynamic)
        n_measured = n_observed(self.search.stand.null.experiments)
        least = self.simulation[0] - n_measured * np.log(GATES.max_leading_ratio)
        ahead = [one for one in dynamic if one.simulated > least]
        return ahead, [one for one in dynamic if one.simulated <= least]

    def storage(
        self, found: Screen, candidates: Sequence[Candidate], proofs: Sequence[Proof]
    ) -> tuple[Prepared, ...]:
        """Effects with states of their own that a simulation shows and no refit has come to."""
        wanted = [c for c in _with_states(candidates, proofs) if not c.is_dynamic]
        if not wanted or self.simulation is None:
            return ()
        with quiet():
            null = self.search.stand.null
            return best_dynamic(null, [storage_fits(null, found, wanted, self.simulation)])

    def bent(
        self, found: Screen, candidates: Sequence[Candidate], proofs: Sequence[Proof]
    ) -> tuple[Prepared, ...]:
        """Effects with states beside a model that is not affine, those that its simulation shows. Laws with
        kinks, such as friction with bristles, are left to the screen."""
        null, reference = self.search.stand.null, self.search.stand.reference
        if reference is None or has_affine_dynamics(null.explicit):
            return ()
        wanted = [
            c
            for c in _with_states(candidates, proofs)
            if not any(p.role == "sharpness" for p in c.effect.parameters)
        ]
        with quiet():
            nominal = nominal_simulation(null, reference.fit) if wanted else None
        # Where errors add up, a simulation tells of a lag only if it follows the machine all the same.
        if nominal is None or (reference.adds_up and not _follows(nominal)):
            return ()
        simplest = [c for c in wanted if not _says_more_of_signal(c, wanted)]
        parts = self._simulated(simplest, found, nominal)
        lags = [pair for part in parts for pair in part]
        shown = {prepared.trial.candidate.site for _, prepared in lags}
        richer = [c for c in wanted if c not in simplest and c.site in shown]
        return best_dynamic(null, [*parts, *self._simulated(richer, found, nominal, lags)])

    def _simulated(
        self, wanted: Sequence[Candidate], found: Screen, nominal: FitResult, lags: DynamicFits = ()
    ) -> list[DynamicFits]:
        """`bent_fits` of each of the wanted effects; without those for which the time does not suffice."""
        for candidate in wanted:
            self.progress(f"simulating with {candidate.label}")
        null = self.search.stand.null
        parts = self.proved((), (), [partial(_bent, null, found, one, nominal, lags) for one in wanted])[1]
        return [part for part in parts if part is not None]

    def shown_in_use(self, proofs: Sequence[Proof]) -> list[Proof]:
        """All laws; those that are likelier than what is accepted, and refused since a load is left beside
        them, by their simulation where that shows them: beside a load that may take any course a law keeps
        no more than the load leaves it, a stiffening spring half of its size."""
        null, reference = self.search.stand.null, self.search.stand.reference
        if reference is None or reference.simulated is None or reference.adds_up or self.options.is_over:
            return list(proofs)
        best = best_accepted(ranked(proofs))
        # What a simulation gains is no measure of what is gained beside loads.
        least = GATES.min_bic_gain if best is None or best.is_by_use else best.delta_bic
        doubted = [
            p
            for p in sorted(proofs, key=lambda p: -p.delta_bic)
            if p.is_open and p.explained < GATES.min_explained and p.delta_bic > least
        ]
        tasks = []
        known = None if best is None or not best.is_by_use else best
        wanted = {p.candidate.name: p for p in (*doubted[:MOST_IN_USE], *_beside_in_use(best, proofs))}
        for proof in wanted.values():
            self.progress(f"simulating with {proof.candidate.label}")
            tasks.append(partial(shown_in_use, self.search, _as_refitted(null, proof), proof, known))
        found = self.proved((), proofs, tasks)[1] if tasks else []
        shown = {p.candidate.name: p for p in found if p is not None}
        return [shown.get(p.candidate.name, p) for p in proofs]

    def shown_by_leaders(
        self, records: Stand, leaders: Sequence[Trial], proofs: Sequence[Proof]
    ) -> list[Proof]:
        """All laws, with those that lead the screen of the simulation over `records`, which may be pieces of
        the ones that there are: those that are clear there by that simulation, or say as much as an accepted
        law that stands on one; and where there are none, the nearest with what it says."""
        search = self.search if records is self.search.stand else replace(self.search, pieces=records)
        tasks, known = [], {}
        for one in leaders:
            refitted = next((p for p in proofs if is_same(one, p.candidate)), None)
            ready = (
                self.prepared([one]) if refitted is None else [_as_refitted(self.search.stand.null, refitted)]
            )
            self.progress(f"simulating{' pieces' if search.pieces else ''} with {one.candidate.label}")
            tasks += [partial(tried_in_open_loop, search, prepared) for prepared in ready]
            known.update({prepared.trial.candidate.name: refitted for prepared in ready})
        found = [one for one in self.proved((), proofs, tasks)[1] if one is not None] if tasks else []
        found = self._without_imitations(search, found, proofs)
        near = sorted((one for one in found if one.is_near), key=lambda one: -one.bic)
        best = best_accepted(ranked(proofs))
        rival = best if best is not None and best.is_by_use else None
        told = [one for one in near if one.is_clear or one.rivals(rival)] or near[:1]
        again = [
            partial(proof_in_open_loop, search, one, known[one.prepared.trial.candidate.name], rival)
            for one in told
        ]
        judged = [p for p in self.proved((), proofs, again)[1] if p is not None] if again else []
        names = {p.candidate.name for p in judged}
        return [*(p for p in proofs if p.candidate.name not in names), *judged]

    def _without_imitations(
        self, search: Search, found: Sequence[InOpenLoop], proofs: Sequence[Proof]
    ) -> list[InOpenLoop]:
        """What was found in pieces, without clear laws with states that say no more there than a simpler lag
        which is too short to be told from others, or only comes near. Such a lag is refused
        beside loads, and no screen has it: its own simulation in pieces alone compares with that of a law."""
        storing = [one for one in found if one.is_clear and one.prepared.trial.candidate.effect.n_states]
        lags = [p for p in proofs if p.is_any_dynamics or p.comes_near] if storing else []
        fewest = min((p.candidate.n_unknowns for p in lags), default=0)
        tasks = [
            partial(tried_in_open_loop, search, _as_refitted(self.search.stand.null, p))
            for p in lags
            if p.candidate.n_unknowns == fewest
        ]
        short = [one for one in self.proved((), proofs, tasks)[1] if one is not None] if tasks else []
        return [
            one
            for one in found
            if all(one is not law for law in storing) or not any(_says_as_much(lag, one) for lag in short)
        ]

    def with_simulations(self, proofs: Sequence[Proof]) -> list[Proof]:
        """All laws; where one is accepted for what its simulation gains, the other accepted ones with what
        theirs does: what is gained beside loads is no measure of it, and of two laws that are the same
        equation here the one that was refitted beside them had lost by far."""
        accepted = [p for p in proofs if p.verdict != "rejected"]
        untold = [p for p in accepted if not p.in_use.n_independent]
        if not untold or not any(p.is_by_use for p in accepted) or self.options.is_over:
            return list(proofs)
        stand = self.search.stand
        tasks = [partial(with_simulation, stand, _as_refitted(stand.null, p), p) for p in untold]
        found = {p.candidate.name: p for p in self.proved((), proofs, tasks)[1] if p is not None}
        return [found.get(p.candidate.name, p) for p in proofs]

    def steadied(self, proofs: Sequence[Proof]) -> list[Proof]:
        """All laws; those that are not separable with the errors of unseen data beside constant loads, by
        which they may be."""
        null, validation = self.search.stand.null, self.search.stand.validation
        close = {p.candidate.name for p in ranked(proofs) if p.verdict == "not separable" and not p.adds_up}
        if not validation or not close or not null.loads or self.options.is_over:
            return list(proofs)
        tasks = [
            partial(with_steady_error, null, proof, validation)
            for proof in proofs
            if proof.candidate.name in close
        ]
        found = {p.candidate.name: p for p in self.proved((), proofs, tasks)[1] if p is not None}
        return [found.get(p.candidate.name, p) for p in proofs]


def is_same(trial: Trial, candidate: Candidate) -> bool:
    """Whether a candidate is the trial, of the same variables, at its place or at one that the sensors see
    alike."""
    wanted = trial.candidate
    places = {wanted.site.name, *(c.site.name for c in trial.alike)}
    is_law = wanted.effect.class_name == candidate.effect.class_name and wanted.inputs == candidate.inputs
    return is_law and candidate.site.name in places


def _says_as_much(simple: InOpenLoop, other: InOpenLoop) -> bool:
    """Whether a law that is simpler says as much in pieces as another one."""
    few, many = (one.prepared.trial.candidate for one in (simple, other))
    return is_simpler(few, many) and other.bic <= simple.bic + GATES.same_bic


def _as_refitted(null: Null, proof: Proof) -> Prepared:
    """The candidate of a proof, ready to be searched for from where its refit has ended."""
    candidate = proof.candidate
    flat = with_equations(proof.flat, "a simulation").with_theta(proof.fit.theta)
    return Prepared(Trial(candidate, proof.sizes, ()), flat, (*null.estimated, *candidate.estimated))


def dynamic_effects(candidates: Sequence[Candidate]) -> tuple[list[Candidate], list[Candidate]]:
    """The candidates that change the order of the model, and those of them that say least of their signal."""
    wanted = [c for c in candidates if c.is_dynamic and not c.inputs]
    return wanted, [c for c in wanted if not _says_more_of_signal(c, wanted)]


def _dynamic(null: Null, wanted: Sequence[Candidate], simulation: Simulation) -> DynamicFits:
    with quiet():
        return dynamic_fits(null, wanted, simulation)


def _bent(
    null: Null, found: Screen, candidate: Candidate, nominal: FitResult, lags: DynamicFits
) -> DynamicFits:
    with quiet():
        return bent_fits(null, found, [candidate], nominal, lags)


def _says_more_of_signal(candidate: Candidate, others: Sequence[Candidate]) -> bool:
    """Whether another candidate delays the same signal with fewer states: where a lag is nothing, no dead
    time is worth its simulations."""
    return candidate.is_of_signal and any(
        other.is_of_signal
        and other.site == candidate.site
        and other.effect.n_states < candidate.effect.n_states
        for other in others
    )


def _follows(fit: FitResult) -> bool:
    """Whether a simulation says most of what every output does."""
    return follows_all(fit.simulated, "estimation", GATES.min_driven_fit)


def _beside_in_use(best: Proof | None, proofs: Sequence[Proof]) -> list[Proof]:
    """The refused laws that bend a signal as the accepted `best` one does: loads take from a dead zone what
    they leave to a gain that grows with the signal, and a simulation has none."""
    if best is None or not best.candidate.is_of_signal or best.candidate.is_dynamic:
        return []
    return [
        p
        for p in proofs
        if p.verdict == "rejected"
        and p.candidate.is_of_signal
        and not p.candidate.is_dynamic
        and not p.in_use.n_independent
    ]


def _with_states(candidates: Sequence[Candidate], proofs: Sequence[Proof]) -> list[Candidate]:
    """The candidates with states, their own or those that they add to the model, that need no further signal
    and that no refit has come to."""
    tried = {p.candidate.label for p in proofs if p.delta_bic > GATES.min_bic_gain}
    return [
        c for c in candidates if (c.is_dynamic or c.effect.n_states) and not c.inputs and c.label not in tried
    ]


def _length(prepared: Prepared) -> int:
    """How long a refit takes beside others, roughly: what it multiplies its runs by, and their number."""
    return (LOOP if prepared.has_loop else 1) * len(prepared.names)


def in_time(fits: Sequence[DynamicFits | None]) -> list[DynamicFits]:
    """The fits for which the time sufficed."""
    return [part for part in fits if part is not None]


def _has_fallen_short(prepared: Prepared, proof: Proof) -> bool:
    """Whether all searches for a law have ended below the null, which it contains, or far below what it does
    already near the null, where the screen promises something there."""
    promised = GATES.min_kept_promise * prepared.trial.promised
    return is_below_null(proof) or (promised > 0.0 and proof.delta_log_likelihood < promised)


def _is_same_law(one: Proof, other: Proof) -> bool:
    """Whether two proofs are of one effect at one place, or at places that the sensors see alike."""
    is_same = one.candidate.effect.class_name == other.candidate.effect.class_name
    return is_same and bool(one.places & other.places)


def _what(error: Exception | None) -> str:
    return error.what if isinstance(error, DaestError) else f"the search fails numerically ({error})"
