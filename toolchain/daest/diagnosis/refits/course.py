"""The course of the proof: which candidates are refitted, in which order, and when the others need not be."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf

from daest.diagnosis.answers.decided import Evidence
from daest.diagnosis.answers.unexplained import Loads
from daest.diagnosis.built_in.dead_times import DELAY
from daest.diagnosis.built_in.late_signals import LAG, SECOND_ORDER, is_late, late_signals
from daest.diagnosis.built_in.slow_loads import said_by_loads
from daest.diagnosis.built_in.trials import Prepared, Trial, clipping_trials, n_seats, trials
from daest.diagnosis.evidence.law_values import errors_last, leaves_load_and_errors
from daest.diagnosis.evidence.near_given import fit_near_given
from daest.diagnosis.evidence.open_loop import open_screen
from daest.diagnosis.evidence.pieces import in_pieces
from daest.diagnosis.evidence.ranking import (
    best_accepted,
    best_start,
    could_compete,
    is_settled,
    leader_of,
    leaves_something,
    most_likely,
    ranked,
)
from daest.diagnosis.evidence.reasons import is_significant, may_be_a_bend
from daest.diagnosis.evidence.stand import Stand
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model.null import are_driven_off
from daest.diagnosis.options import DiagnoseOptions, Progress
from daest.diagnosis.refits.dependences import (
    MOST_DEPENDENCES,
    dependence_screen,
    dependences,
    in_other_forms,
    leading,
    refused_where_errors_last,
)
from daest.diagnosis.refits.dynamic_fits import DynamicFits, best_dynamic
from daest.diagnosis.refits.rivals import (
    alike_elsewhere,
    begun_by_the_other,
    from_other_sizes,
    kinked_elsewhere,
    laws_at_its_place,
    leading_late,
    no_richer_ones,
    not_begun_by,
    other_bends,
    other_forms,
    own_law_elsewhere,
    reduced_laws,
    richer_laws,
    rounded,
    second_order_for,
    shortest_of,
    signal_laws,
    simpler_laws,
    simplest_first,
    straight_laws,
    told_apart,
    told_as_second_order,
    told_from_places,
    told_from_second_order,
    with_held_shapes,
    with_likelier_lags,
)
from daest.diagnosis.refits.search import Search
from daest.diagnosis.refits.stages import (
    MOST_IN_PIECES,
    MOST_IN_USE,
    TIME_IS_UP,
    DynamicTasks,
    Stages,
    in_time,
    is_same,
)
from daest.diagnosis.screening.disturbance import SmoothedLoad
from daest.model.diagnosis import Candidate, Proof, Screen, Unproved
from daest.model.effects import Effect, Site
from daest.model.fit import FitResult, error_ratios
from daest.modelica.effects.catalogue import adds_a_constant, adds_a_ramp
from daest.numerics.deadline import OutOfTimeError, until
from daest.numerics.parallel import Workers

MORE_TRIALS = 4  # where none of those is accepted, or the best leaves a curve over some variable
MOST_CONSTANTS = 2  # loads and offsets, of all that are simulated in the end
FIRST_TRIALS = 2  # are refitted in any case, the second one alone where the first is not supported


@dataclass(frozen=True)
class Course:
    """Refits of the best of the `candidates`, in stages: `screens` are that of the innovations and that in
    open loop, if there is one; `loads` is what the null needs, `load` the largest of that. `watched` sees the
    first refits, best first, and may end the course by what it raises. `simulated` are fits that the `pool`
    may have begun."""

    stand: Stand
    loads: Loads
    load: SmoothedLoad | None
    screens: tuple[Screen, Screen | None]
    candidates: Sequence[Candidate]
    library: Sequence[Effect]
    options: DiagnoseOptions
    progress: Progress
    watched: Callable[[Sequence[Proof]], None]
    pool: Workers
    simulated: DynamicTasks | None = None

    def proofs(self) -> tuple[tuple[Proof, ...], tuple[Unproved, ...], bool]:
        """The best candidates refitted: the first few, those that lead the screen in open loop, and of the
        others those that could compete with them; the leaders of the screen that were not, each with the
        reason; and whether the time sufficed."""
        options, (found, used) = self.options, self.screens
        wanted = trials(found, GATES.screen_level, options.most_trials + MORE_TRIALS)
        wanted, n_used = _with_leaders(wanted, used)
        most = n_seats(wanted, options.most_trials)
        stages = self._stages()
        fits, proofs = self._of_leaders(stages, wanted[:most], n_used)
        proofs = self._with_further_leaders(stages, proofs, wanted[most:])
        proofs = self._with_simpler_laws(stages, proofs)
        proofs = self._with_straight_laws(stages, proofs)
        proofs = self._with_other_forms(stages, proofs)
        proofs = self._with_storage(stages, proofs)
        proofs = self._with_late_signals_begun_anew(stages, proofs)
        proofs = self._with_lag_told_apart(stages, proofs)
        proofs = self._with_dead_time_for_lag(stages, proofs)
        proofs = self._with_second_order(stages, proofs)
        proofs = self._with_dependences(stages, proofs)
        proofs = stages.shown_in_use(proofs)
        proofs = self._with_leaders_in_use(stages, proofs)
        proofs = self._with_dependences_in_use(stages, proofs)
        proofs = self._with_leaders_near_given(proofs)
        proofs = stages.with_simulations(with_likelier_lags(proofs))
        proofs = stages.steadied(proofs)
        order = ranked(proofs)
        if all(p.candidate.is_of_parameter for p in order if p.verdict != "rejected"):
            # The law of the library beside which one was told has not stood.
            order = ranked(refused_where_errors_last(order))
        is_whole = not stages.late and None not in fits
        return order, _unproved(found, wanted, order, stages.failed, stages.present), is_whole

    def in_pieces(self, proofs: Sequence[Proof]) -> tuple[tuple[Proof, ...], bool]:
        """All laws with those that a simulation in pieces shows, best first, where no law is accepted,
        something is left to explain, and the errors of a whole simulation add up; and whether the time
        sufficed."""
        reference = self.stand.reference
        if reference is None or not reference.adds_up or not self._is_open(proofs):
            return tuple(proofs), True
        self.progress("simulating pieces of the records")
        with suppress(OutOfTimeError), until(self.options.until):
            pieces = in_pieces(self.stand, self.loads.run)
            if pieces is None or pieces.reference is None:
                return tuple(proofs), True
            candidates = (*self.candidates, *self._dependences)
            used = open_screen(pieces.null, pieces.reference.start_in_use, candidates, self.options.seed)
            leaders = [] if used is None else _leaders_in_use(used, MOST_IN_PIECES)
            stages = self._stages()
            found = stages.shown_by_leaders(pieces, leaders, proofs)
            return ranked(refused_where_errors_last(found)), not stages.late
        return tuple(proofs), False

    def _stages(self, stand: Stand | None = None) -> Stages:
        loads, found = self.loads, self.screens[0]
        search = Search(stand or self.stand, loads.run, self.load, loads.form, found.n_screened)
        return Stages(search, self.pool, self.options, self.progress, simulated=self.simulated)

    def _of_leaders(
        self, stages: Stages, wanted: Sequence[Trial], n_used: int
    ) -> tuple[list[DynamicFits | None], list[Proof]]:
        """The fits of effects with states; and the proofs of those and of the first trials, of which `n_used`
        lead a screen."""
        null, found = self.stand.null, self.screens[0]
        clips = self.options.clips([*null.experiments, *self.stand.validation])
        given = clipping_trials(null, self.candidates, clips)
        leading = stages.prepared(wanted)
        chosen, richer = simplest_first(leading)
        n_used = sum(any(one is other for other in chosen) for one in leading[:n_used])
        fits = stages.dynamic(self.candidates)
        ahead, dynamic = stages.by_what_they_simulate(best_dynamic(null, in_time(fits)))
        late = late_signals(null, self.loads.run, self.candidates)
        dynamic += stages.prepared(_untried(late.lags, [one.trial.candidate for one in (*ahead, *dynamic)]))
        proofs: list[Proof] = []
        for one in ahead:
            proofs += stages.proved([one], proofs)[0]
        if proofs:
            self.watched(ranked(proofs))
        # Those whose runs are short lead: beside them, the others need not be pursued as far.
        n_first = min(max(n_used, 1 if fits else FIRST_TRIALS), len(chosen))
        quick, slow = _by_states(chosen[:n_first])
        first = [*stages.prepared(given), *quick]
        if len(first) == 1:
            stages.compile_ahead(first[0], dynamic)
        proofs += stages.proved(first, proofs)[0]
        proofs += stages.proved(slow, proofs)[0]
        rest = chosen[n_first:FIRST_TRIALS]
        if rest and leader_of(proofs) is None:
            proofs += stages.proved(rest, proofs)[0]
            rest = []
        proofs = stages.proved(dynamic, proofs)[0] + proofs
        said: list[Proof] = []
        leader = leader_of(proofs)
        if leader is None or leaves_load_and_errors(leader):
            accounting = said_by_loads(null, self.loads.run, found)
            untried = _untried(accounting, [p.candidate for p in proofs])
            said = stages.proved(stages.prepared(untried), proofs)[0]
            proofs += said
        if not is_settled(ranked(proofs)):
            dead_times = _untried(late.dead_times, [proof.candidate for proof in proofs])
            proofs = stages.proved(stages.prepared(dead_times), proofs)[0] + proofs
        self.watched(ranked(proofs))
        best = best_accepted(ranked(proofs))
        others = [*chosen[max(FIRST_TRIALS, n_first) :], *not_begun_by(best, richer)]
        rest += [p for p in _left(others, said) if could_compete(p.trial, best, found)]
        proofs += stages.proved(rest, proofs)[0]
        return fits, stages.second_tries(proofs, found)

    def _with_further_leaders(
        self, stages: Stages, proofs: list[Proof], wanted: Sequence[Trial]
    ) -> list[Proof]:
        """All laws, with the `wanted` further ones where the first of the screen do not settle it, but for
        those that were refitted as what the loads stand for."""
        if is_settled(ranked(proofs)):
            return proofs
        untried = _untried(wanted, [proof.candidate for proof in proofs])
        proofs += stages.proved(stages.prepared(untried), proofs)[0]
        return stages.second_tries(proofs, self.screens[0])

    def _with_simpler_laws(self, stages: Stages, proofs: list[Proof]) -> list[Proof]:
        """All laws, with parts of the most likely one where that is refused, and with those that bend a
        signal as the accepted one does, or a likelier one that turns it back, plainer ones at its place, its
        own law at others, or without shapes of a refused one that the data do not show."""
        found = self.screens[0]
        best = most_likely(proofs)
        if best is not None and best.verdict == "rejected":
            proofs += stages.proved(stages.prepared(simpler_laws(best, found, proofs)), proofs)[0]
            proofs = stages.second_tries(proofs, found)
        best = best_accepted(ranked(proofs))
        bends = other_bends(best, found, proofs)
        if bends:
            proofs = stages.second_tries(proofs + stages.proved(stages.prepared(bends), ())[0], found)
            best = best_accepted(ranked(proofs))
        if best is not None:
            others = signal_laws(best, found, proofs) + laws_at_its_place(best, found, proofs)
            others += own_law_elsewhere(best, found, proofs) + alike_elsewhere(best, found, proofs)
            proofs += stages.proved(stages.prepared(others), ())[0]
            again = stages.proved(stages.prepared(from_other_sizes(best, found, proofs)), ())[0]
            return told_from_places(_with_second_tries(proofs, again))
        held = with_held_shapes(self.stand.null, proofs)
        again = stages.proved([] if held is None else [held], ())[0]
        accepted = {p.candidate.name: p for p in again if p.verdict != "rejected"}
        return [accepted.get(p.candidate.name, p) for p in proofs]

    def _with_straight_laws(self, stages: Stages, proofs: list[Proof]) -> list[Proof]:
        """All laws, with the gain and the offset that one without a bend is, where no law is accepted."""
        if best_accepted(ranked(proofs)) is not None or self.options.is_over:
            return proofs
        untried = _untried(straight_laws(self.candidates, proofs), [proof.candidate for proof in proofs])
        return proofs + stages.proved(stages.prepared(untried), ())[0]

    def _with_other_forms(self, stages: Stages, proofs: list[Proof]) -> list[Proof]:
        """All laws, with the best one in other forms: its kink rounded otherwise, with fewer parameters, and
        as a part of richer laws where it leaves something."""
        null, found = self.stand.null, self.screens[0]
        best = best_start(ranked(proofs))
        if best is not None:
            doubted = [best] if leaves_something(best) else []
            doubted += no_richer_ones(best, proofs)
            proofs = _with_better_kinks(proofs, stages.proved(rounded(null, doubted), ())[0])
            best = best_start(ranked(proofs))
        if best is not None:
            elsewhere = kinked_elsewhere(best, proofs)
            proofs = _with_better_kinks(proofs, stages.proved(rounded(null, elsewhere), ())[0])
            best = best_start(ranked(proofs))
        if best is not None and leaves_something(best):
            again = stages.proved(other_forms(null, best), ())[0]
            proofs = _with_second_tries(proofs, again)
            best = best_start(ranked(proofs))
        if best is not None and best.verdict != "rejected":
            again = stages.proved(reduced_laws(null, best, found), ())[0]
            proofs = _with_second_tries(proofs, again)
            best = best_start(ranked(proofs))
        if best is not None and leaves_something(best):
            # They start from the best: a first pass that is worse has only not come back to it yet.
            richer = richer_laws(null, self.loads.run, best, self.library, proofs)
            proofs = _with_second_tries(proofs, stages.proved(richer, ())[0])
        return proofs

    def _with_storage(self, stages: Stages, proofs: list[Proof]) -> list[Proof]:
        """All laws, with effects with states that a simulation shows, where no law is accepted and something
        is left to explain; beside a model that is not affine, whose lags no other stage simulates, also where
        the accepted one leaves most of it: what delays a sensor is play to some."""
        found = self.screens[0]
        is_open = self._is_open(proofs)
        if is_open:
            proofs += stages.proved(stages.storage(found, self.candidates, proofs), proofs)[0]
        if is_open or self._leaves_most(proofs):
            proofs += stages.proved(stages.bent(found, self.candidates, proofs), proofs)[0]
        return proofs

    def _with_late_signals_begun_anew(self, stages: Stages, proofs: list[Proof]) -> list[Proof]:
        """All laws; the likeliest lags and dead times once more, each from where the other at its signal has
        ended, where no law is accepted. To first order they are the same, and beside loads that take what
        one does not say the parameters may have gone where only the loads follow."""
        if best_accepted(ranked(proofs)) is not None or self.options.is_over:
            return proofs
        return _with_second_tries(proofs, stages.proved(begun_by_the_other(self.stand.null, proofs), ())[0])

    def _with_lag_told_apart(self, stages: Stages, proofs: list[Proof]) -> list[Proof]:
        """All laws; a lag that is short beside the model is one all the same where the recordings tell its
        form: a dead time at its signal is far less likely. To second order in frequency a lag is
        1/(1 + s T + b s² T²) with b = 0, a dead time with b = 1/2, a flexible part with more than 1/4."""
        lag = shortest_of(LAG, proofs)
        if lag is None or best_accepted(ranked(proofs)) is not None or self.options.is_over:
            return proofs
        late = self._dead_times_for(lag)
        untried = _untried(late, [proof.candidate for proof in proofs])
        every = [*proofs, *stages.proved(stages.prepared(untried), ())[0]]
        dead_times = [p for p in every if any(is_same(one, p.candidate) for one in late)]
        told = told_apart(lag, dead_times, GATES.min_told_lag)
        return [told if p is lag else p for p in every]

    def _with_dead_time_for_lag(self, stages: Stages, proofs: list[Proof]) -> list[Proof]:
        """All laws, with the dead time at the signal of an accepted lag: the innovations, which are asked at
        a few times only, may show more of a lag where it is a dead time between these."""
        best = best_accepted(ranked(proofs))
        if best is None or best.candidate.effect.class_name != LAG or self.options.is_over:
            return proofs
        untried = _untried(self._dead_times_for(best), [proof.candidate for proof in proofs])
        return [*proofs, *stages.proved(stages.prepared(untried), proofs)[0]]

    def _with_second_order(self, stages: Stages, proofs: list[Proof]) -> list[Proof]:
        """All laws, with the lag of second order at the signal of the lag or dead time that leads. A short
        dead time is accepted where lags of both orders, and so a flexible part, are far less likely; that of
        second order where both others are."""
        late = leading_late(best_accepted(ranked(proofs)), proofs)
        named = set(self.options.effects)
        is_asked = not named or bool({SECOND_ORDER, SECOND_ORDER.rpartition(".")[2]} & named)
        if late is None or not is_asked or self.options.is_over:
            return proofs
        begun = second_order_for(self.stand.null, late)
        rivals = [] if begun is None else stages.proved([begun], ())[0]
        others = [p for p in proofs if is_late(p.candidate) and p.places & late.places]
        told = told_from_second_order(late, rivals, others)
        return [
            *(told if p is late else p for p in proofs),
            *(told_as_second_order(p, others) for p in rivals),
        ]

    def _with_dependences(self, stages: Stages, proofs: list[Proof]) -> list[Proof]:
        """All laws, with the parameters that change with a variable and lead the screen of these, where no
        law is accepted and something is left to explain, or the accepted one leaves errors that last, and no
        other law takes those: it is asked next."""
        best = best_accepted(ranked(proofs))
        leaves_errors = best is not None and _leaves(best) and not any(_is_next(p, best) for p in proofs)
        if not (self._is_open(proofs) or (leaves_errors and not self.options.is_over)):
            return proofs
        found = dependence_screen(self.stand.null, self.loads.run, self._dependences, self.options.seed)
        if found is None:
            return proofs
        stages = replace(stages, search=stages.search.among_more(found.n_screened))
        told = stages.proved(stages.prepared(leading(found)), proofs)[0]
        others = stages.prepared(in_other_forms(told, proofs, self.library))
        told += stages.proved(others, proofs)[0]
        return [*proofs, *(told if best is not None else refused_where_errors_last(told))]

    @cached_property
    def _dependences(self) -> tuple[Candidate, ...]:
        """The parameters that may change with a variable or with time."""
        self.progress("screening parameters that change with a variable")
        return dependences(self.stand.null, self.loads.run, self.stand.declared, self.library)

    def _with_dependences_in_use(self, stages: Stages, proofs: list[Proof]) -> list[Proof]:
        """All laws, with the parameters that change and lead a screen in open loop, where still no law is
        accepted, or one that its simulation alone shows leaves errors that last: what goes slowly from one
        value to another is left to the loads, one sample ahead. Where none leads, the first is simulated all
        the same: errors that add up count as few samples to a screen."""
        reference = self.stand.reference
        if reference is None or reference.simulated is None:
            return proofs
        best = best_accepted(ranked(proofs))
        leaves_errors = best is not None and best.is_by_use and _leaves(best)
        if not (self._is_open(proofs) or (leaves_errors and not self.options.is_over)):
            return proofs
        null, seed = self.stand.null, self.options.seed
        used = (
            open_screen(null, reference.start_in_use, self._dependences, seed) if self._dependences else None
        )
        if used is None:
            return proofs
        leaders = _leaders_in_use(used, MOST_DEPENDENCES) or trials(used, 1.0, len(used.entries))[:1]
        found = stages.shown_by_leaders(self.stand, leaders, proofs)
        return found if best is not None else refused_where_errors_last(found)

    def _dead_times_for(self, lag: Proof) -> list[Trial]:
        """The dead time at the signal of a lag, from the time of that."""
        return [
            Trial(one, lag.sizes, ())
            for one in self.candidates
            if one.effect.class_name == DELAY and one.site == lag.candidate.site
        ]

    def _with_leaders_in_use(self, stages: Stages, proofs: list[Proof]) -> list[Proof]:
        """All laws, with those that lead the screen in open loop and that a simulation shows, where nothing
        is accepted that is enough: a load that takes any course leaves no dead zone of a pump anything to do,
        nor dry friction. Constants come first, which no screen of errors that last can tell: they count as
        one sample there. Where no law is accepted and none leads, the first few are simulated all the
        same."""
        reference, used = self.stand.reference, self.screens[1]
        if used is None or reference is None or reference.simulated is None or self.options.is_over:
            return proofs
        best = best_accepted(ranked(proofs))
        if best is None and not self._is_open(proofs):
            return proofs
        if best is not None and _is_enough(best, reference.fit):
            return proofs
        leaders = trials(used, GATES.in_use_level, len(used.entries))
        every = trials(used, 1.0, len(used.entries))
        constants = [trial for trial in every if adds_a_constant(trial.candidate.effect)][:MOST_CONSTANTS]
        others = _without_constants(leaders)
        if best is None and not others:
            # Errors that a few steps of an input leave count as few samples: no law stands out among many.
            others = _without_constants(every)[:MOST_IN_USE]
        judged = [p.candidate for p in proofs if p.verdict != "rejected" or p.in_use.n_independent]
        constants += _untried(self._constants_for(others), [one.candidate for one in constants])
        wanted = _untried([*constants, *others], judged)
        proofs = stages.shown_by_leaders(self.stand, wanted[:MOST_IN_PIECES], proofs)
        beside = _laws_beside_constant(used, proofs)
        return stages.shown_by_leaders(self.stand, beside, proofs) if beside else proofs

    def _with_leaders_near_given(self, proofs: list[Proof]) -> list[Proof]:
        """All laws, with those that a simulation shows of the leaders of the screen in open loop near the
        given values of the parameters, where what is missing has driven these off and no law is accepted that
        is enough: a simulation in pieces where the errors of whole records add up."""
        reference, declared = self.stand.reference, self.stand.declared
        given = {p.name: p.value for p in declared.parameters if p.name in self.stand.null.estimated}
        if reference is None or not are_driven_off(reference.start_in_use.theta, given):
            return proofs
        if not (self._is_open(proofs) or self._leaves_most(proofs)):
            return proofs
        stand = in_pieces(self.stand, self.loads.run) if reference.adds_up else self.stand
        if stand is None or stand.reference is None or stand.reference.simulated is None:
            return proofs
        near = fit_near_given(stand.null, given)
        used = None if near is None else open_screen(stand.null, near, self.candidates, self.options.seed)
        if used is None:
            return proofs
        leaders = _leaders_in_use(used, MOST_IN_PIECES)
        begun = replace(stand, reference=replace(stand.reference, opened=near))
        # Refits from where the model was driven off to are no starts.
        others = [p for p in proofs if p.verdict != "rejected" or _untried(leaders, [p.candidate]) == leaders]
        stages = self._stages(None if reference.adds_up else begun)
        found = stages.shown_by_leaders(begun, leaders, others)
        names = {proof.candidate.name for proof in found}
        return [*(p for p in proofs if p.candidate.name not in names), *found]

    def _constants_for(self, others: Sequence[Trial]) -> list[Trial]:
        """The constants where ramps lead: over one recording a ramp is much of a constant. The screens may
        leave a constant to the parameters, to which a growing store gives nearly all that it does."""
        sites = [trial.candidate.site for trial in others if adds_a_ramp(trial.candidate.effect)]
        entries = [e for e in self.screens[0].entries if adds_a_constant(e.candidate.effect)]
        return [Trial(e.candidate, e.sizes, ()) for e in entries if e.candidate.site in sites]

    def _leaves_most(self, proofs: Sequence[Proof]) -> bool:
        """Whether the accepted law takes little of the errors of a simulation, and what it leaves lasts."""
        best, reference = best_accepted(ranked(proofs)), self.stand.reference
        if best is None or reference is None or self.options.is_over:
            return False
        ratios = error_ratios(reference.fit.simulated, best.told.simulated)
        takes_most = bool(ratios) and max(ratios) <= GATES.max_most_ratio
        return not takes_most and errors_last(best)

    def _is_open(self, proofs: Sequence[Proof]) -> bool:
        """Whether no law is accepted, something is left to explain, and there is time for it."""
        stand = self.stand
        evidence = Evidence(
            stand.baseline, self.screens[0], tuple(proofs), self.options.fitted, self.loads, stand.told
        )
        is_explained = self.loads.is_explained(evidence)
        return best_accepted(ranked(proofs)) is None and not is_explained and not self.options.is_over


def _is_enough(best: Proof, before: FitResult) -> bool:
    """Whether a law stands alone, beside the loads, and makes the simulation of unseen data clearly better
    than `before`: what it leaves of that is for the next law. One that its simulation alone shows has its
    rivals among the laws that were refused beside loads, as it was."""
    ratios = error_ratios(before.simulated, best.told.simulated)
    is_better = bool(ratios) and max(ratios) <= GATES.max_clear_ratio
    return best.verdict == "supported" and not best.is_by_use and is_better


def _leaves(best: Proof) -> bool:
    """Whether a parameter that changes may be what acts beside or instead of an accepted law: that leaves
    errors that last, or little of them with a kink that may be a smooth bend."""
    return errors_last(best) or may_be_a_bend(best)


def _is_next(other: Proof, best: Proof) -> bool:
    """Whether a law at another place that pays for its parameters takes most of the errors of an output that
    the best one leaves: they are missing together, and it is asked for beside that one."""
    if other.candidate.site.name in best.places:
        return False
    ratios = error_ratios(best.told.simulated, other.told.simulated)
    return other.delta_bic > GATES.min_bic_gain and min(ratios, default=1.0) < GATES.max_most_ratio


def _laws_beside_constant(used: Screen, proofs: Sequence[Proof]) -> list[Trial]:
    """The other laws without states at the place of the constant that takes most of the errors of a
    simulation away: no screen of errors that last tells them, and much of a loss of heat is a constant."""
    near = [p for p in proofs if adds_a_constant(p.candidate.effect) and p.in_use.n_independent]
    best = min(near, key=lambda proof: proof.in_use.ratio, default=None)
    if best is None or best.in_use.ratio >= GATES.max_most_ratio or best.in_use.leaves_noise:
        return []
    found: dict[str, Trial] = {}
    for entry in used.entries:
        one = entry.candidate
        is_there = one.site == best.candidate.site and not one.effect.is_of_driving
        if is_there and not (one.effect.n_states or one.is_dynamic):
            found.setdefault(one.effect.class_name, Trial(one, entry.sizes, ()))
    return _untried(list(found.values()), [p.candidate for p in proofs])[:MOST_IN_PIECES]


def _without_constants(trials: Sequence[Trial]) -> list[Trial]:
    """The trials but those of laws that add a constant."""
    return [trial for trial in trials if not adds_a_constant(trial.candidate.effect)]


def _untried(trials: Sequence[Trial], tried: Sequence[Candidate]) -> list[Trial]:
    """The trials but those of laws that are tried already."""
    return [trial for trial in trials if not any(is_same(trial, candidate) for candidate in tried)]


def _left(prepared: Sequence[Prepared], said: Sequence[Proof]) -> list[Prepared]:
    """The prepared trials but those of laws that were refitted as what the loads stand for."""
    return [one for one in prepared if _untried([one.trial], [proof.candidate for proof in said])]


def _by_states(chosen: Sequence[Prepared]) -> tuple[list[Prepared], list[Prepared]]:
    """The trials without states of their own, and those with; of these the first alone leads
    where none is without."""
    quick = [one for one in chosen if not one.trial.candidate.effect.n_states]
    slow = [one for one in chosen if one.trial.candidate.effect.n_states]
    return (quick, slow) if quick else (slow[:1], slow[1:])


def _with_leaders(wanted: Sequence[Trial], used: Screen | None) -> tuple[tuple[Trial, ...], int]:
    """The trials, behind the first of them those that lead the screen in open loop; and how many of the
    first ones that makes."""
    if used is None:
        return tuple(wanted), 1
    leaders = [replace(trial, is_seen_in_use=True) for trial in _leaders_in_use(used)]
    marked = [
        replace(trial, is_seen_in_use=any(is_same(one, trial.candidate) for one in leaders))
        for trial in wanted
    ]
    first = marked[:1]
    known = [trial for trial in marked[1:] if trial.is_seen_in_use]
    new = [one for one in leaders if not any(is_same(one, trial.candidate) for trial in marked)]
    rest = [trial for trial in marked[1:] if not trial.is_seen_in_use]
    ahead = (*first, *known, *new)
    return (*ahead, *rest), len(ahead)


def _leaders_in_use(used: Screen, most: int = MOST_IN_USE) -> list[Trial]:
    """The first `most` that lead the screen in open loop; of the laws that bend one signal the first alone,
    which the others follow where it is accepted (`signal_laws`)."""
    found: list[Trial] = []
    bent: list[Site] = []
    for trial in trials(used, GATES.in_use_level, len(used.entries)):
        one = trial.candidate
        bends = one.is_of_signal and not one.is_dynamic and not one.effect.is_of_driving
        if not (bends and one.site in bent):
            found.append(trial)
        bent += [one.site] if not one.effect.is_of_driving else []
    return found[: n_seats(found, most)]


def _with_second_tries(proofs: Sequence[Proof], again: Sequence[Proof]) -> list[Proof]:
    """All laws, each once: of two refits of one law at one place, from different starts, the likelier."""

    def law(proof: Proof) -> tuple[str, str]:
        return proof.candidate.effect.class_name, proof.candidate.site.name

    tried = {law(proof) for proof in again}
    likeliest = {
        law(proof): proof
        for proof in sorted((*proofs, *again), key=lambda p: p.fit.log_likelihood)
        if law(proof) in tried
    }
    return [*(p for p in proofs if law(p) not in tried), *likeliest.values()]


def _with_better_kinks(proofs: Sequence[Proof], rounded: Sequence[Proof]) -> list[Proof]:
    """All laws, those with estimated kinks in place of the same ones without where they are worth their
    parameters, and are not refused for what the others are not: a kink may become so sharp that no observer
    follows it. A law that is refused for what it leaves is so with another kink that leaves the same."""
    better = {
        proof.candidate.name: _as_refused(proof, before)
        for proof in rounded
        for before in proofs
        if before.candidate.name == proof.candidate.name
        and proof.delta_bic > before.delta_bic
        and _standing(proof) >= _standing(before)
    }
    return [better.get(proof.candidate.name, proof) for proof in proofs]


def _as_refused(rounded: Proof, before: Proof) -> Proof:
    """The proof with a rounded kink, refused where the same law without was for a form that it leaves, and
    this one leaves it as significantly."""
    if before.verdict != "rejected" or before.left is None or rounded.left is None:
        return rounded
    forms = [(form.load, form.variable, form.sign_of) for form in (before.left, rounded.left)]
    if forms[0] != forms[1] or not is_significant(rounded.left, rounded.delta_log_likelihood):
        return rounded
    return replace(rounded, verdict="rejected", reason=before.reason, is_open=before.is_open)


def _standing(proof: Proof) -> int:
    """2 where a law is accepted, 1 where it is refused though nothing speaks against it, else 0."""
    return 2 if proof.verdict != "rejected" else int(proof.is_open)


def _unproved(
    found: Screen,
    wanted: Sequence[Trial],
    proofs: Sequence[Proof],
    failed: Sequence[tuple[Trial, str]],
    present: Collection[str] = (),
) -> tuple[Unproved, ...]:
    """Leaders of the screen without a refit, and other candidates whose refit failed, of which the model
    holds those `present`."""
    entries = {entry.candidate.name: entry for entry in found.entries}
    result = []
    reasons = {trial.candidate.name: (trial, reason) for trial, reason in failed}
    best = best_accepted(proofs)
    for trial in wanted:
        if trial.candidate.name in reasons:
            continue
        reason = "not refitted: others came first"
        if best is not None:
            reason = f"not refitted: {best.candidate.label} says what it could say"
        reasons[trial.candidate.name] = (trial, reason)
    broken = {trial.candidate.name for trial, _ in failed}
    for name, (trial, reason) in reasons.items():
        if any(is_same(trial, p.candidate) for p in proofs):
            continue
        entry = entries.get(name)
        result.append(
            Unproved(
                candidate=trial.candidate,
                equivalent=tuple(c.site.name for c in trial.alike),
                score=0.0 if entry is None else entry.score,
                p_value=1.0 if entry is None else entry.p_value,
                sizes=_possible(trial),
                reason=reason,
                has_failed=name in broken,
                is_late=reason == TIME_IS_UP,
                is_present=name in present,
            )
        )
    return tuple(sorted(result, key=lambda u: -u.score))


def _possible(trial: Trial) -> tuple[float, ...]:
    """The sizes by the screen, which knows no limits, within those that they can have."""
    limits = [
        (-inf if p.min is None else p.min, inf if p.max is None else p.max)
        for p in trial.candidate.effect.sizes
    ]
    return tuple(min(max(size, low), high) for size, (low, high) in zip(trial.sizes, limits, strict=True))
