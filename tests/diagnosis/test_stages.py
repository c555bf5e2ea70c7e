"""The order in which candidates are refitted."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from daest.diagnosis.built_in import trials as trials_module
from daest.diagnosis.built_in.trials import Prepared, Trial, n_seats
from daest.diagnosis.gates import GATES
from daest.diagnosis.options import DiagnoseOptions
from daest.diagnosis.refits import course as course_module
from daest.diagnosis.refits import stages as stages_module
from daest.diagnosis.refits.course import Course, _by_states, _left
from daest.diagnosis.refits.stages import DynamicTasks, Stages, _has_fallen_short, is_same
from daest.model.diagnosis import InUse
from daest.model.fit import Agreement


def prepared(n_states: int = 0, simulated: float = -np.inf, site: str = "u", is_dynamic: bool = False) -> Any:
    effect = SimpleNamespace(n_states=n_states)
    candidate = SimpleNamespace(
        effect=effect, site=site, is_dynamic=is_dynamic, inputs=(), is_of_signal=True, label=f"{n_states}"
    )
    trial = SimpleNamespace(candidate=candidate)
    return replace(Prepared(cast(Any, trial), cast(Any, None), ()), simulated=simulated)


def stages(simulation: tuple[float, dict[str, float]]) -> Stages:
    experiments = (SimpleNamespace(outputs=np.zeros((1000, 1))),)
    search = SimpleNamespace(stand=SimpleNamespace(null=SimpleNamespace(experiments=experiments)))
    tasks = DynamicTasks(cast(Any, search).stand.null)
    tasks.__dict__["simulation"] = simulation
    nothing = cast(Any, None)
    return Stages(cast(Any, search), nothing, nothing, nothing, simulated=tasks)


def test_laws_with_states_come_second() -> None:
    slow, quick, other = prepared(2), prepared(), prepared(1)
    assert _by_states([slow, quick, other]) == ([quick], [slow, other])
    assert _by_states([slow, other]) == ([slow], [other])
    assert _by_states([]) == ([], [])


def test_what_the_loads_stand_for_is_not_refitted_again() -> None:
    def placed(name: str, place: str, alike: tuple[str, ...] = ()) -> Any:
        def candidate(at: str) -> Any:
            return SimpleNamespace(
                effect=SimpleNamespace(class_name=name), site=SimpleNamespace(name=at), inputs={}
            )

        trial = SimpleNamespace(candidate=candidate(place), alike=tuple(candidate(at) for at in alike))
        return SimpleNamespace(trial=trial, candidate=trial.candidate)

    leak, other, elsewhere = (
        placed("Leakage", "cap"),
        placed("Gain", "cap"),
        placed("Leakage", "coil", ("y",)),
    )
    assert _left([leak, other, elsewhere], [placed("Leakage", "cap")]) == [other, elsewhere]
    assert _left([leak, other, elsewhere], [placed("Leakage", "y")]) == [leak, other]
    assert _left([leak], []) == [leak]


def test_effect_that_leaves_little_of_the_simulation_leads() -> None:
    # Errors that are a third of what they were gain n log(3).
    third, most = prepared(simulated=-5000.0 + 1000 * np.log(3.0)), prepared(simulated=-4990.0)
    assert np.log(3.0) > -np.log(GATES.max_leading_ratio)
    assert stages((-5000.0, {})).by_what_they_simulate([most, third]) == ([third], [most])


def test_dead_times_are_fitted_where_a_lag_shows_itself(monkeypatch: Any) -> None:
    lags = [prepared(1, site=site, is_dynamic=True) for site in ("u", "y")]
    delays = [prepared(10, site=site, is_dynamic=True) for site in ("u", "y")]
    wanted = [one.trial.candidate for one in (*delays, *lags)]
    fitted: list[str] = []

    def fits(_null: Any, part: Any, _simulation: Any) -> list[tuple[float, Any]]:
        fitted.extend(f"{c.label} at {c.site}" for c in part)
        return [(0.0, one) for one in lags if one.trial.candidate in part and one.trial.candidate.site == "u"]

    def proved(_self: Any, _stage: Any, _before: Any, tasks: Any) -> Any:
        return [], [task() for task in tasks]

    monkeypatch.setattr(stages_module, "_dynamic", fits)
    monkeypatch.setattr(Stages, "proved", proved)
    found = stages((0.0, {})).dynamic(wanted)
    assert fitted == ["1 at u", "1 at y", "10 at u"]
    assert [one for part in found if part for _, one in part] == [lags[0]]


def test_a_model_that_was_reduced_is_not_reduced_again(monkeypatch: Any) -> None:
    asked: list[Any] = []

    def reduced(flat: Any) -> Any:
        asked.append(flat)
        return "anew"

    monkeypatch.setattr(trials_module, "reduce_index", reduced)
    one = prepared()
    assert one.reduced() == "anew" and len(asked) == 1
    assert replace(one, explicit=cast(Any, "before")).reduced() == "before" and len(asked) == 1


def test_fits_that_were_begun_are_those_that_are_asked_for() -> None:
    tasks, candidates = (
        DynamicTasks(cast(Any, None)),
        [prepared(site=place).trial.candidate for place in "uvw"],
    )
    tasks.__dict__["simulation"] = (0.0, {})
    begun = tasks.of(candidates)
    assert begun and all(one is other for one, other in zip(begun, tasks.of(candidates), strict=True))
    assert DynamicTasks(cast(Any, None)).of([]) == []


@pytest.mark.parametrize(
    "gain, is_lost", [(-6.0, True), (-4.3, True), (20.0, True), (40.0, False), (2000.0, False)]
)
def test_refit_that_gains_far_less_than_the_screen_foresaw_has_lost_its_way(gain, is_lost):
    prepared = SimpleNamespace(trial=Trial(None, (1.0,), (), promised=125.0))
    assert _has_fallen_short(prepared, SimpleNamespace(delta_log_likelihood=gain)) == is_lost


def test_one_of_the_laws_that_bend_a_signal_leads_the_screen_in_open_loop(monkeypatch: Any) -> None:
    """Three ways to bend the input of an arm left no refit for its weight, which came next. A share of that
    input in a sensor takes no seat."""

    def trial(label: str, site: str, of_signal: bool, is_dynamic: bool = False) -> Any:
        effect = SimpleNamespace(is_of_driving=label == "Crosstalk")
        kind = {"is_of_signal": of_signal, "is_dynamic": is_dynamic, "effect": effect}
        return SimpleNamespace(candidate=SimpleNamespace(label=label, site=site, **kind))

    seen = (
        trial("Crosstalk", "phi", True),
        trial("QuadraticGain", "u", True),
        trial("OneSidedLimit", "u", True),
        trial("Lag", "u", True, is_dynamic=True),
        trial("Unbalance", "arm", False),
        trial("CubicSpring", "arm", False),
    )
    monkeypatch.setattr(course_module, "trials", lambda *_: seen)
    found = course_module._leaders_in_use(cast(Any, SimpleNamespace(entries=seen)))
    assert [one.candidate.label for one in found] == ["Crosstalk", "QuadraticGain", "Lag", "Unbalance"]
    assert n_seats(seen, 1) == 2 and n_seats(seen, 5) == n_seats(seen, 9) == len(seen)


@pytest.mark.parametrize(("gain", "is_left"), [(500.0, False), (480.0, True)])
def test_law_with_states_in_pieces_is_compared_with_short_lags(
    monkeypatch: Any, gain: float, is_left: bool
) -> None:
    """A relaxation of a resistance too short to be seen is any lag, and no screen has a lag."""

    def found(label: str, bic: float, n_states: int, estimated: tuple[str, ...]) -> Any:
        candidate = SimpleNamespace(
            label=label, effect=SimpleNamespace(n_states=n_states), estimated=estimated, n_unknowns=2
        )
        one = SimpleNamespace(trial=SimpleNamespace(candidate=candidate))
        return SimpleNamespace(prepared=one, is_clear=True, bic=bic)

    lag, law = found("lag", gain, 1, ("T",)), found("relaxation", 490.0, 1, ("R", "T"))
    other = found("friction", 100.0, 0, ("f",))
    proof = SimpleNamespace(
        candidate=lag.prepared.trial.candidate, is_any_dynamics=True, comes_near=False, lag=lag
    )
    monkeypatch.setattr(stages_module, "_as_refitted", lambda _null, p: p.lag)
    monkeypatch.setattr(stages_module, "tried_in_open_loop", lambda _search, prepared: prepared)
    made = stages((0.0, {}))
    run = cast(Any, lambda _stage, _before, tasks: ([], [task() for task in tasks]))
    monkeypatch.setattr(Stages, "proved", lambda _self, *given: run(*given))
    left = made._without_imitations(cast(Any, None), [law, other], cast(Any, [proof]))
    assert left == ([law, other] if is_left else [other])


def law(
    label: str, ratio: float = 0.5, judged: float = 0.0, verdict: str = "rejected", by_use: bool = False
) -> Any:
    told = SimpleNamespace(simulated={"validation": Agreement({}, {"y": 2.0 * ratio})})
    candidate = SimpleNamespace(label=label, name=label)
    used = InUse(n_independent=judged)
    return SimpleNamespace(candidate=candidate, told=told, verdict=verdict, in_use=used, is_by_use=by_use)


@pytest.mark.parametrize(
    ("proofs", "wanted", "n_leaders"),
    [
        # Refused beside loads and never simulated, and never refitted: both lead the screen in open loop.
        ([law("friction")], ["load", "friction", "dead zone"], 2),
        # What a simulation was asked for is not asked again.
        ([law("friction", judged=80.0)], ["load", "dead zone"], 2),
        # What is accepted and makes the simulation of unseen data clearly better ends it; what does not, does
        # not, and neither do laws that are not told apart.
        ([law("outlet", 0.85, verdict="supported")], None, 2),
        ([law("outlet", 0.95, verdict="supported"), law("friction")], ["load", "friction", "dead zone"], 2),
        ([law("outlet", 0.6, verdict="not separable"), law("dead zone", 0.6, 9.0)], ["load", "friction"], 2),
        # What is accepted by its simulation alone has its rivals there.
        ([law("friction", 0.6, 9.0, "supported", by_use=True)], ["load", "dead zone"], 2),
        # A constant that was simulated is not, either.
        ([law("load", judged=5.0)], ["friction", "dead zone"], 2),
        # Where nothing is accepted and none leads, the first few are.
        ([law("friction")], ["load", "friction", "dead zone", "spring"], 0),
        ([law("outlet", 0.6, verdict="not separable"), law("friction")], ["load"], 0),
    ],
)
def test_leaders_in_open_loop_are_simulated_where_nothing_is_enough(
    monkeypatch: Any, proofs: Any, wanted: Any, n_leaders: int
) -> None:
    every = [
        SimpleNamespace(candidate=SimpleNamespace(label=name, effect=name, site=name), sizes=(0.0,))
        for name in ("friction", "dead zone", "load", "spring", "lag")
    ]
    leaders = every[:n_leaders]
    # A constant comes first, though the screen in open loop cannot tell it.
    monkeypatch.setattr(course_module, "trials", lambda _, level, __: leaders if level < 1.0 else every)
    monkeypatch.setattr(course_module, "adds_a_constant", lambda effect: effect == "load")
    monkeypatch.setattr(course_module, "is_same", lambda one, other: one.candidate.label == other.label)
    monkeypatch.setattr(course_module, "ranked", lambda given: given)
    monkeypatch.setattr(Course, "_is_open", lambda *_: True)
    before = SimpleNamespace(simulated={"validation": Agreement({}, {"y": 2.0})})
    stand = SimpleNamespace(reference=SimpleNamespace(simulated="errors", fit=before))
    nothing = cast(Any, None)
    used, found = SimpleNamespace(entries=leaders), SimpleNamespace(entries=[])
    monkeypatch.setattr(course_module, "adds_a_ramp", lambda _: False)
    course = Course(
        cast(Any, stand), nothing, nothing, cast(Any, (found, used)), (), (), DiagnoseOptions(), nothing,
        nothing, nothing,
    )  # fmt: skip
    asked: list[Any] = []

    def shown(records: Any, trials: Any, before: Any) -> list[Any]:
        assert records is stand and before is proofs
        asked.extend(one.candidate.label for one in trials)
        return []

    found = course._with_leaders_in_use(cast(Any, SimpleNamespace(shown_by_leaders=shown)), proofs)
    assert (found, asked) == ((proofs, []) if wanted is None else ([], wanted))


def test_laws_beside_a_constant_that_comes_near_are_simulated(monkeypatch: Any) -> None:
    """Much of a loss of heat is a constant, and no screen of errors that last tells one from the other."""

    def entry(name: str, site: str, n_states: int = 0) -> Any:
        effect = SimpleNamespace(class_name=name, n_states=n_states, is_of_driving=False)
        candidate = SimpleNamespace(label=f"{name} at {site}", effect=effect, site=site, is_dynamic=False)
        return SimpleNamespace(candidate=candidate, sizes=(1.0,))

    def simulated(entry: Any, unseen: float, leaves_noise: bool = False) -> Any:
        used = InUse(n_independent=40.0, unseen=unseen, leaves_noise=leaves_noise)
        return SimpleNamespace(candidate=entry.candidate, in_use=used)

    monkeypatch.setattr(course_module, "adds_a_constant", lambda effect: effect.class_name == "gain")
    monkeypatch.setattr(course_module, "is_same", lambda one, other: one.candidate.label == other.label)
    gain, elsewhere = entry("gain", "wall"), entry("gain", "room")
    others = [entry("loss", "wall"), entry("loss", "wall"), entry("store", "wall", 1), entry("loss", "room")]
    used = cast(Any, SimpleNamespace(entries=[elsewhere, gain, *others]))

    def asked(*proofs: Any) -> list[str]:
        return [t.candidate.label for t in course_module._laws_beside_constant(used, proofs)]

    assert asked(simulated(gain, 3.0), simulated(elsewhere, 1.0)) == ["loss at wall"]
    assert asked(simulated(gain, 0.3)) == []  # it takes a part
    assert asked(simulated(gain, 3.0, leaves_noise=True)) == []
    assert asked(simulated(gain, 3.0), simulated(others[0], 0.0)) == []


def test_constant_is_simulated_where_a_ramp_leads(monkeypatch: Any) -> None:
    """A screen may leave a constant to the parameters: it has no trial there, the one at its place has."""

    def entry(label: str, site: str) -> Any:
        candidate = SimpleNamespace(label=label, effect=label, site=site)
        return SimpleNamespace(candidate=candidate, sizes=(2.0,))

    monkeypatch.setattr(course_module, "adds_a_constant", lambda effect: effect == "offset")
    monkeypatch.setattr(course_module, "adds_a_ramp", lambda effect: effect == "drift")
    entries = [entry("drift", "inflow"), entry("offset", "level"), entry("offset", "inflow")]
    nothing = cast(Any, None)
    course = Course(
        nothing, nothing, nothing, cast(Any, (SimpleNamespace(entries=entries), None)), (), (),
        DiagnoseOptions(), nothing, nothing, nothing,
    )  # fmt: skip
    others = cast(Any, [entry("drift", "inflow"), entry("play", "level")])
    found = course._constants_for(others)
    assert [(one.candidate.label, one.candidate.site, one.sizes) for one in found] == [
        ("offset", "inflow", (2.0,))
    ]
    assert course._constants_for(others[1:]) == []


@pytest.mark.parametrize("is_enough", [False, True])
def test_a_law_that_the_loads_stand_for_is_not_refitted_once_more(monkeypatch: Any, is_enough: bool) -> None:
    """An offset of an input stood twice among the names of a surge tank."""

    def law(name: str) -> Any:
        return SimpleNamespace(candidate=SimpleNamespace(name=name, label=name))

    monkeypatch.setattr(course_module, "is_same", lambda one, other: one.candidate.label == other.label)
    monkeypatch.setattr(course_module, "ranked", lambda given: given)
    monkeypatch.setattr(course_module, "is_settled", lambda _: is_enough)
    doing = SimpleNamespace(
        prepared=lambda wanted: wanted,
        proved=lambda stage, before: (list(stage), []),
        second_tries=lambda proofs, found: proofs,
    )
    nothing = cast(Any, None)
    screens = cast(Any, (None, None))
    course = Course(nothing, nothing, nothing, screens, (), (), DiagnoseOptions(), nothing, nothing, nothing)
    proofs = [law("leak"), law("offset")]
    after = course._with_further_leaders(cast(Any, doing), proofs, [law("offset"), law("gain")])
    assert [p.candidate.name for p in after] == ["leak", "offset", *([] if is_enough else ["gain"])]


@pytest.mark.parametrize(
    ("left", "white", "verdict", "is_looked_for"),
    [
        (1.6, 0.1, "supported", True),
        (0.4, 0.1, "supported", False),  # most of the errors are gone
        (1.6, 1.5, "supported", False),  # what is left has no memory
        (1.6, 0.1, "rejected", False),
    ],
)
def test_effects_with_states_are_looked_for_where_an_accepted_law_leaves_most(
    monkeypatch: Any, left: float, white: float, verdict: str, is_looked_for: bool
) -> None:
    monkeypatch.setattr(course_module, "ranked", lambda given: given)
    before = SimpleNamespace(simulated={"validation": Agreement({}, {"y": 2.0})})
    stand = SimpleNamespace(reference=SimpleNamespace(fit=before))
    told = SimpleNamespace(simulated={"validation": Agreement({}, {"y": left}, {"y": white})})
    play = SimpleNamespace(verdict=verdict, told=told)
    nothing = cast(Any, None)
    course = Course(
        cast(Any, stand), nothing, nothing, nothing, (), (), DiagnoseOptions(), nothing, nothing, nothing
    )
    assert course._leaves_most(cast(Any, [play])) is is_looked_for


def test_a_refit_from_estimates_without_loads_has_the_names_of_its_own_place():
    """A law that was found at a place which the sensors see alike is another component."""
    law, there = SimpleNamespace(name="effect_4_1"), SimpleNamespace(name="effect_9_1")
    prepared = SimpleNamespace(trial=SimpleNamespace(candidate=law), names=("effect", "effect_4_1.k"))
    assert trials_module._names_at(prepared, there) == ("effect", "effect_9_1.k")


def test_law_of_another_variable_is_another_law() -> None:
    """At one place of one class: heat of the sun and heat of a second window are no law twice."""

    def law(site: str, **inputs: str) -> Any:
        effect = SimpleNamespace(class_name="MeasuredHeat")
        return SimpleNamespace(effect=effect, site=SimpleNamespace(name=site), inputs=inputs)

    trial = Trial(law("room", q="sun"), (1.0,), (law("wall", q="sun"),))
    assert is_same(trial, law("room", q="sun")) and is_same(trial, law("wall", q="sun"))
    assert not is_same(trial, law("room", q="window")) and not is_same(trial, law("corridor", q="sun"))
