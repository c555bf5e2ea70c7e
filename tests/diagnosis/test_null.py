"""The null against records with a known load."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hidden_plants import library, model, quiet, rotor_null, rotor_record, rubbing, some_effects

from daest.data.prepare import resample
from daest.diagnosis import examine as examining
from daest.diagnosis.comparison.compare import compare_models
from daest.diagnosis.comparison.trial import Candidate
from daest.diagnosis.diagnose import diagnose
from daest.diagnosis.evidence import stand as stands
from daest.diagnosis.evidence.proof import Reference
from daest.diagnosis.evidence.stand import begin, without_noises
from daest.diagnosis.examine import examine
from daest.diagnosis.gates import GATES
from daest.diagnosis.null_model import null as nulls
from daest.diagnosis.null_model.loads import load_sites
from daest.diagnosis.null_model.null import (
    fit_null,
    known_values,
    near_given,
    open_hold,
    period_of,
    refit,
    with_other_hold,
)
from daest.diagnosis.options import DiagnoseOptions
from daest.diagnosis.recordings.holds import better_hold
from daest.errors import EstimationError, ModelError
from daest.estimation.identify import identify
from daest.model.experiment import Experiment
from daest.model.fit import Agreement, IdentifyOptions
from daest.model.parts import Prior
from daest.modelica.compile import compile_model, compile_text
from daest.modelica.effects.attach import attach
from daest.modelica.places.sites import sites
from daest.systems.reduction.reduce import reduce_index
from daest.systems.simulation.integrate import integrate, integrator


@cache
def null_with_a_load():
    return rotor_null(rotor_record(1500, seed=4, load=(0.15, 1.0), noise=0.0)[0])[0]


def test_size_and_time_constant_of_a_coloured_load():
    null = null_with_a_load()
    (load,) = null.loads
    assert load.place == "rotor.flange_a"
    assert load.size == pytest.approx(0.15, rel=0.3)
    assert load.time_constant == pytest.approx(1.0, rel=0.6)
    assert null.measurement_std == pytest.approx([0.005], rel=0.1)


def test_parameters_and_their_errors_are_right_with_a_load():
    null = null_with_a_load()
    found = {p.name: p for p in null.fit.parameters}
    assert null.estimated == ("J", "d")
    for name, true in (("J", 0.5), ("d", 0.3)):
        assert abs(found[name].value - true) < 3.5 * found[name].std_error
        assert found[name].std_error < 0.15 * true


def test_parameter_whose_name_begins_as_that_of_a_load_is_one_of_the_model():
    text = b"""model Mass
  parameter Real load_m(unit = "kg", min = 0) = 2 annotation(__Daest(estimate = true));
  parameter Real d(unit = "N.s/m", min = 0) = 1;
  input Real f(unit = "N");
  output Real v(unit = "m/s", start = 0, fixed = true);
equation
  load_m*der(v) = f - d*v;
end Mass;
"""
    rng, t = np.random.default_rng(5), 0.05 * np.arange(400.0)
    f, v = np.repeat(rng.normal(size=40), 10), np.zeros(400)
    for k in range(399):
        v[k + 1] = f[k] + (v[k] - f[k]) * np.exp(-0.05 / 3.0)
    outputs = (v + 0.001 * rng.normal(size=400))[:, None]
    flat = compile_text(text, Path("Mass.mo"))
    one = Experiment("run", t, f[:, None], outputs, ("f",), ("v",))
    null = fit_null(flat, load_sites(flat), [one], "zoh")
    assert null.estimated == ("load_m",)
    (found,) = [p for p in null.fit.parameters if p.name == "load_m"]
    assert abs(found.value - 3.0) < 3.5 * found.std_error


def test_load_of_white_torque_is_as_strong_as_the_torque():
    null, _ = quiet()
    (load,) = null.loads
    # Spectral density of the load at low frequency, against the intensity of the white torque.
    assert 2 * load.size**2 * load.time_constant == pytest.approx(1e-4, rel=0.7)


def test_innovations_of_the_null_are_white():
    _, run = quiet()
    e = run.whitened
    correlation = [e[k:] @ e[:-k] / (e @ e) for k in range(1, 6)]
    assert np.max(np.abs(correlation)) < 3.5 / np.sqrt(e.size)
    assert e.std() == pytest.approx(1.0, rel=0.02)


def test_no_place_is_an_error():
    with pytest.raises(EstimationError) as caught:
        fit_null(without_noises(model()), [], (rotor_record(300)[0],), "zoh")
    assert caught.value.code == "diagnose-no-place" and "declare units" in caught.value.remedy
    still = compile_text(
        b'model D input Real v(unit = "m/s"); output Real F(unit = "N"); equation F = 3*v; end D;',
        Path("D.mo"),
    )
    with pytest.raises(EstimationError) as caught:
        fit_null(still, [], (rotor_record(300)[0],), "zoh")
    assert caught.value.code == "diagnose-no-place" and "connectors" in caught.value.remedy
    moved = compile_text(
        b'model D input Real x(unit = "m"); output Real F(unit = "N"); Real s(unit = "m"); '
        b"equation s = x; F = 3*der(s); end D;",
        Path("D.mo"),
    )
    with pytest.raises(EstimationError) as caught:
        fit_null(moved, [], (rotor_record(300)[0],), "zoh")
    assert "nor states" in caught.value.what and "connectors" in caught.value.remedy
    loose = [s for s in sites(model("TwoMass")) if s.name == "loose.flange_a"]
    with pytest.raises(EstimationError) as caught:
        fit_null(without_noises(model("TwoMass")), loose, (rotor_record(300)[0],), "zoh")
    assert caught.value.code == "diagnose-no-place" and "measure an output" in caught.value.remedy


def test_hold_of_the_inputs_is_told_by_the_likelihood_with_loads():
    """Steps of the torque are held; half a sample of delay is little beside the push of a load."""
    record, _ = rotor_record(1000, seed=4, load=(0.1, 1.0))
    null = fit_null(without_noises(model()), [s for s in sites(model()) if s.kind == "node"], [record], None)
    assert null.hold == "zoh"
    given = fit_null(
        without_noises(model()), [s for s in sites(model()) if s.kind == "node"], [record], "foh"
    )
    assert given.hold == "foh" and given.other_hold is None
    margin = null.fit.log_likelihood - given.fit.log_likelihood
    assert margin > 0.0 and null.other_hold == "foh" and null.hold_lead == pytest.approx(margin, abs=0.1)
    clear = replace(null, hold_lead=2.0 * GATES.clear_hold_gain)
    assert open_hold(clear) is None and open_hold(clear, gain=0.9 * clear.hold_lead) is None
    assert open_hold(clear, gain=1.1 * clear.hold_lead) == "foh" and open_hold(given, gain=1e9) is None


@pytest.mark.slow
def test_the_search_with_the_other_hold_begins_where_the_first_one_ended(monkeypatch):
    record, _ = rotor_record(1000, seed=4, load=(0.1, 1.0))
    places, plain, began = [s for s in sites(model()) if s.kind == "node"], nulls.identify, []

    def watched(flat, experiments, options):
        if options.method == "pem" and not options.start:  # not where the model alone simulates best
            began.append({p.name: p.value for p in flat.parameters})
        return plain(flat, experiments, options)

    monkeypatch.setattr(nulls, "identify", watched)
    null = fit_null(without_noises(model()), places, [record], None)
    given, second = began
    first = fit_null(without_noises(model()), places, [record], null.other_hold).fit
    assert second == pytest.approx(known_values(first)) and second["J"] != given["J"]
    # What is told of the search is what the user gave.
    assert {p.name: p.initial for p in null.fit.parameters} == {
        p.name: given[p.name] for p in null.fit.parameters
    }
    alone = fit_null(without_noises(model()), places, [record], null.hold).fit
    assert null.fit.log_likelihood == pytest.approx(alone.log_likelihood, abs=1e-3)
    for p in alone.parameters:
        assert null.fit.theta[p.name] == pytest.approx(p.value, abs=0.1 * (p.std_error or 0.0) + 1e-12)
    again = fit_null(without_noises(model()), places, [record], null.hold, None, None, known_values(alone))
    assert again.fit.log_likelihood == pytest.approx(alone.log_likelihood, abs=1e-3)


def test_what_rests_at_a_bound_is_no_place_to_begin():
    record, _ = rotor_record(300)
    fit = fit_null(
        without_noises(model()), [s for s in sites(model()) if s.kind == "node"], [record], "zoh"
    ).fit
    resting = replace(fit.parameters[0], at_bound="min")
    left = known_values(replace(fit, status="converged", parameters=(resting, *fit.parameters[1:])))
    assert fit.parameters[0].name not in left and left
    assert known_values(replace(fit, status="iteration limit")) == {} == known_values(None)


def test_hold_of_recordings_that_were_made_coarser():
    """Their inputs are straight lines either way, of which those of the right hold are half a sample away."""
    record, _ = rotor_record(1000, seed=4, load=(0.1, 1.0))
    straight, held = (resample(record, 2.0 * record.period, hold) for hold in ("foh", "zoh"))
    places = [s for s in sites(model()) if s.kind == "node"]
    null = fit_null(without_noises(model()), places, [straight], None, [held])
    assert (null.recorded_hold, null.hold, null.other_hold) == ("zoh", "foh", "foh")
    assert null.experiments == (held,) and null.other_experiments == (straight,)
    other = with_other_hold(null)
    assert (other.recorded_hold, other.hold, other.experiments) == ("foh", "foh", (straight,))


def test_the_fit_with_the_other_hold_is_made_once(monkeypatch):
    record, _ = rotor_record(300)
    quiet_model, places = without_noises(model()), [s for s in sites(model()) if s.kind == "node"]
    null = fit_null(quiet_model, places, [record], None)
    assert null.other_fit is not None and null.other_fit.hold == null.other_hold
    assert null.fit.log_likelihood - null.other_fit.log_likelihood == pytest.approx(null.hold_lead)
    monkeypatch.delattr(nulls, "_loaded_fit")
    again = fit_null(quiet_model, places, [record], null.other_hold, known=null.other_fit)
    assert again.fit is null.other_fit and again.hold == null.other_hold
    held = replace(quiet_model, parameters=tuple(replace(p, estimate=False) for p in quiet_model.parameters))
    with pytest.raises(NameError):  # of other unknowns it is another fit
        fit_null(held, places, [record], null.other_hold, known=null.other_fit)


def test_a_look_for_a_law_ends_where_none_can_come():
    """A simulation in pieces, or a load that begins with the recording, may still show one."""
    verdicts = [SimpleNamespace(verdict="rejected")]
    decided = SimpleNamespace(proofs=verdicts)
    plain, adding = (SimpleNamespace(reference=SimpleNamespace(adds_up=one)) for one in (False, True))
    silent, starting = SimpleNamespace(starts=()), SimpleNamespace(starts=("load",))
    assert examining._is_without_law(plain, decided, silent)
    assert not examining._is_without_law(adding, decided, silent)
    assert not examining._is_without_law(plain, decided, starting)
    verdicts.append(SimpleNamespace(verdict="not separable"))
    assert not examining._is_without_law(plain, decided, silent)


@pytest.mark.slow
def test_a_look_for_a_law_asks_nothing_once_there_is_none(monkeypatch):
    monkeypatch.delattr(examining, "other_value")
    monkeypatch.delattr(examining, "learned_load")
    stand = replace(rubbing(), reference=replace(rubbing().reference, adds_up=False))
    found = examine(stand, some_effects("Lag"), DiagnoseOptions(jobs=1), wants_law=True)
    verdicts = [proof.verdict for proof in found.proofs]
    assert set(verdicts) <= {"rejected"} and found.disturbance is None and found.learned is None


@cache
def rubbing_by_steps():
    """A recording of dry friction under a torque that is held, and the stand with the wrong hold."""
    record, _ = rotor_record(1000, seed=5, coulomb=lambda phi: 0.15)
    return record, begin(model(), [record], (), DiagnoseOptions(hold="foh", jobs=1))


@pytest.mark.slow
def test_other_hold_is_taken_once_the_effect_shows_it():
    _, stand = rubbing_by_steps()
    wrong = replace(stand, null=replace(stand.null, other_hold="zoh"))
    found = examine(wrong, some_effects("CoulombFriction"), DiagnoseOptions(jobs=1))
    assert found.proofs[0].verdict == "supported"
    assert better_hold(wrong, found.proofs) == "zoh"
    assert better_hold(stand, found.proofs) is None, "a hold that the user gave stays"


@pytest.mark.slow  # the hold that the effect shows: the test above
def test_other_hold_is_seen_in_the_first_refits():
    record, stand = rubbing_by_steps()
    result = diagnose(model(), some_effects("CoulombFriction"), [record], (), DiagnoseOptions(jobs=1))
    seen = []

    def watched(proofs):
        seen.append([proof.candidate.label for proof in proofs])
        raise StopIteration

    with pytest.raises(StopIteration):
        examine(stand, some_effects("CoulombFriction"), DiagnoseOptions(jobs=1), watched=watched)
    assert seen == [["CoulombFriction at " + result.proofs[0].candidate.site.name]]
    assert result.verdict == "supported" and result.baseline.hold == "zoh"


def test_error_of_the_model_as_it_is_is_that_of_a_comparison_with_its_refitted_values():
    stand = rubbing()
    values = stand.baseline.theta
    refitted = replace(
        model(), parameters=tuple(replace(p, value=values[p.name]) for p in model().parameters)
    )
    (trial,) = compare_models([Candidate("refitted", refitted, 0, "zoh")], stand.validation).models
    error = trial.simulation.rms["phi"]
    assert error == pytest.approx(stand.baseline.simulated["validation"].rms["phi"], rel=2e-3)
    alone = identify(
        model(), stand.null.experiments, IdentifyOptions(method="oe", hold="zoh"), stand.validation
    )
    assert abs(alone.simulated["validation"].rms["phi"] / error - 1.0) > 0.01


@pytest.mark.slow
def test_input_whose_slope_the_model_needs_is_not_held():
    flat, rng = model("Shaken"), np.random.default_rng(6)
    time = 0.02 * np.arange(300)
    z = 0.01 * np.sin(2.0 * time + 3.0 * np.sin(0.9 * time))
    plain = Experiment("shaken", time, z[:, None], np.zeros((300, 1)), ("z",), ("s",))
    explicit = reduce_index(flat)
    moved = integrate(integrator(explicit), time, plain.inputs, flat.theta_values, np.zeros(2), hold="foh")
    record = replace(plain, outputs=moved.outputs + 1e-4 * rng.standard_normal((300, 1)))
    places = [site for site in sites(flat) if site.kind == "equation"]
    null = fit_null(flat, places, (record,), None)
    assert (null.hold, null.other_hold) == ("foh", "smooth")
    assert any("derivative of input z" in note for note in identify(flat, (record,)).notes)
    with pytest.raises(ModelError) as raised:
        fit_null(flat, places, (record,), "zoh")
    assert raised.value.code == "input-derivative-hold"


TANKS = """model Tanks
  parameter Real k(min = 0) = 1.5 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real R1(unit = "Pa.s/m3", min = 0) = 3e5 annotation(__Daest(estimate = true, scale = "log"));
  parameter Real R2(unit = "Pa.s/m3", min = 0) = 3e5 annotation(__Daest(estimate = true, scale = "log"));
  input Real q(unit = "m3/s"); output Real y(unit = "Pa");
  Real p1(unit = "Pa"); Real p2(unit = "Pa");
equation
  1e-4*der(p1) = k*q - p1/R1; 1e-4*der(p2) = p1/R1 - p2/R2;
  y = p2;
end Tanks;
"""


@pytest.mark.slow  # no load that can be fitted: below
def test_equal_start_values_of_two_tanks_are_no_stop(tmp_path):
    """Where they are equal, two tanks and their pump move the second level alike to first order; that is
    no reason to stop."""
    (tmp_path / "Tanks.mo").write_text(TANKS)
    flat = compile_model(tmp_path / "Tanks.mo")
    rng = np.random.default_rng(3)
    n, period = 400, 2.0
    q = np.repeat(rng.uniform(0.0, 0.1, n // 20), 20)
    p, y = np.zeros(2), np.empty(n)
    for k in range(n):
        y[k] = p[1] + 20.0 * rng.standard_normal()
        for _ in range(20):
            first = p[0] / 2e5
            p = p + period / 20 * np.array([q[k] - first, first - p[1] / 5e5]) / 1e-4
    record = Experiment("run", period * np.arange(n), q[:, None], y[:, None], ("q",), ("y",))
    nodes = [site for site in sites(flat) if site.kind == "equation"]
    assert begin(flat, [record], [record], DiagnoseOptions(hold="zoh")).tied == ()
    found = {x.name: x.value for x in fit_null(flat, nodes, [record], "zoh").fit.parameters}
    assert sorted((found["R1"], found["R2"])) == pytest.approx([2e5, 5e5], rel=0.1)


@pytest.mark.parametrize(
    "record",
    [{"n": 600, "seed": 1}, pytest.param({"n": 1000, "seed": 4, "noise": 1e-2}, marks=pytest.mark.slow)],
)
def test_what_only_rescales_estimated_parameters_gains_nothing(record):
    """A gain at the input makes the inertia and the friction that much larger, and says nothing else."""
    null, _ = rotor_null(rotor_record(**record)[0])
    baseline = refit(null.flat, null.explicit, null.estimated, null)
    (gain,) = some_effects("Gain")
    place = next(s for s in sites(null.flat) if s.name == "u")
    scaled = attach(null.flat, gain, place, "scaled", {})
    fit = refit(scaled, reduce_index(scaled), (*null.estimated, "scaled.g"), null)
    assert fit.log_likelihood - baseline.log_likelihood < 0.5


DRUM = b"""model Drum "A tyre on a drum, with a relaxation length"
  parameter Real sigma(unit = "m", min = 0) = 0.4 annotation(__Daest(estimate = true));
  parameter Real mu(unit = "1", min = 0) = 8 annotation(__Daest(estimate = true));
  input Real alpha(unit = "rad");
  input Real v(unit = "m/s");
  input Real Fz(unit = "N");
  output Real F(unit = "N");
  Real a(unit = "rad", start = 0);
equation
  sigma/v*der(a) = alpha - a;
  F = mu*Fz*a;
end Drum;
"""


def test_loads_have_places_in_a_model_that_says_nothing_at_rest():
    flat = compile_text(DRUM, Path("Drum.mo"))
    rng, n = np.random.default_rng(1), 600
    inputs = np.column_stack([np.repeat(rng.uniform(-0.1, 0.1, n // 20), 20), *np.full((2, n), 10.0)])
    inputs[:, 2] += np.repeat(rng.uniform(2000.0, 4000.0, n // 30), 30)
    a = np.zeros(n)
    for k in range(n - 1):
        a[k + 1] = inputs[k, 0] + (a[k] - inputs[k, 0]) * np.exp(-0.01 * inputs[k, 1] / 0.5)
    y = (9.0 * inputs[:, 2] * a + rng.normal(size=n))[:, None]
    record = Experiment("run", 0.01 * np.arange(n), inputs, y, ("alpha", "v", "Fz"), ("F",))
    # Without a speed the rate is not finite, without a load the tyre has no force: there was no place.
    null = fit_null(flat, load_sites(flat), [record], "zoh")
    found = {x.name: x.value for x in null.fit.parameters}
    assert [found["sigma"], found["mu"]] == pytest.approx([0.5, 9.0], rel=0.01)


def test_what_the_data_leave_open_stays_near_the_given_values():
    """A prior of a decade about each, and none where the user has one or the scale is linear."""
    flat = model()
    near = near_given(flat)
    known = {p.name: p for p in near.parameters}
    of_flat = {p.name: p for p in flat.parameters}
    marked = [p for p in flat.parameters if p.estimate and p.scale == "log"]
    assert marked and all(known[p.name].prior.mean == p.value for p in marked)
    assert all(known[p.name].prior is None for p in flat.parameters if not p.estimate)
    own = replace(marked[0], prior=Prior(1.0, 0.1))
    given = replace(flat, parameters=tuple(own if p.name == own.name else p for p in flat.parameters))
    assert next(p for p in near_given(given).parameters if p.name == own.name).prior == own.prior
    assert near_given(near) == near and of_flat.keys() == known.keys()


def test_nonlinear_null_is_the_better_of_two_searches(monkeypatch):
    """The second one starts from loads that are hardly more than white noise."""
    one, _ = rotor_record(400, seed=3)
    starts = []

    def identified(flat, experiments, options):
        starts.append(dict(options.start))
        return SimpleNamespace(log_likelihood=7.0 if options.start else 5.0)

    monkeypatch.setattr(nulls, "identify", identified)
    first = SimpleNamespace(log_likelihood=6.0)
    options = IdentifyOptions()
    better = nulls._from_faster_loads(first, model(), [one], options, ("load_1.T",))
    period = period_of([one])
    assert better.log_likelihood == 7.0 and starts == [{"load_1.T": nulls.FASTER_LOAD * period}]
    first = SimpleNamespace(log_likelihood=8.0)
    assert nulls._from_faster_loads(first, model(), [one], options, ("load_1.T",)) is first
    assert nulls.GATES.shortest_load < nulls.FASTER_LOAD


def test_nonlinear_null_is_searched_from_the_values_of_the_simulation_too(monkeypatch):
    """Beside given values that are a little off, a fast load is an optimum of its own."""
    one, _ = rotor_record(400, seed=3)
    asked = []

    def identified(flat, experiments, options):
        asked.append((options.method, options.estimate, dict(options.start)))
        return SimpleNamespace(log_likelihood=7.0, theta={"J": 0.02, "load_1.T": 1.0})

    monkeypatch.setattr(nulls, "identify", identified)
    options = IdentifyOptions(method="pem", estimate=("J", "load_1.T"), bounds={"load_1.T": (0.1, 9.0)})
    first = SimpleNamespace(log_likelihood=6.0)
    better = nulls._from_simulation(first, model(), [one], options, ("J",))
    assert better.log_likelihood == 7.0
    assert asked == [("oe", ("J",), {}), ("pem", ("J", "load_1.T"), {"J": 0.02})]
    likelier = SimpleNamespace(log_likelihood=8.0)
    assert nulls._from_simulation(likelier, model(), [one], options, ("J",)) is likelier
    assert nulls._from_simulation(first, model(), [one], options, ()) is first


def test_a_kept_screen_is_of_one_choice_of_holds():
    """With the hold given, a search must not go on from one in which the other hold was open."""
    stand, parts = rubbing(), []

    class NotedError(Exception):
        pass

    class Keeper:
        def step(self, name, own, flat, make):
            parts.append((name, tuple(map(str, own))))
            raise NotedError

    options = DiagnoseOptions(effects=("CoulombFriction",), keeper=Keeper())
    for other in (None, "zoh"):
        with pytest.raises(NotedError):
            examine(replace(stand, null=replace(stand.null, other_hold=other)), library(), options)
    assert parts[0][0] == parts[1][0] == "screen" and parts[0] != parts[1]


def test_values_beside_which_no_load_can_be_fitted_leave_the_null_as_it_was(monkeypatch):
    """A simulation that all but ends at zero mass: the parameters are not held there."""
    record = rotor_record(1200, seed=2, coulomb=lambda phi: 0.15)[0]
    monkeypatch.setattr(stands, "_simulated_better", lambda flat, null, reference: flat)
    found, asked = fit_null, []

    def refused(*given, **options):
        asked.append(given)
        if len(asked) > 1:
            raise EstimationError("identify-no-start", "it cannot be simulated")
        return found(*given, **options)

    monkeypatch.setattr(stands, "fit_null", refused)
    stand = begin(model(), [record], [], DiagnoseOptions(hold="zoh"))
    assert len(asked) == 2
    assert stand.null.estimated == ("J", "d") and stand.reference is not None


@pytest.mark.parametrize(
    ("beside_loads", "simulated", "is_held"),
    [
        (0.3, 1e-9, False),  # without friction, to a torque that nobody knows of
        (300.0, 0.3, True),  # loads have taken over what the inputs do
        (300.0, 3e-7, False),  # from a start that is far off for both
        (3e8, 1e-3, True),
        (0.3, 0.2, True),
    ],
)
def test_parameters_are_not_held_where_a_simulation_has_bent_to_what_is_missing(
    beside_loads, simulated, is_held, monkeypatch
):
    """A constant torque on a rotor whose angle nothing holds: a simulation that drifts as it does has a
    bearing without friction, and beside that a gain of the torque was what is missing."""
    monkeypatch.setattr(stands, "falls_over", lambda explicit, experiments: False)

    def fit(d, percent, error):
        agreement = Agreement({"phi": percent}, {"phi": error})
        return SimpleNamespace(theta={"J": 0.5, "d": d}, simulated={"estimation": agreement})

    null = SimpleNamespace(
        estimated=("J", "d"),
        fit=fit(beside_loads, 11.0, 2.9),
        alone=fit(simulated, 85.0, 0.47),
        explicit=None,
        experiments=(),
    )
    reference = SimpleNamespace(adds_up=True, fit=null.fit)
    held = stands._simulated_better(model().with_theta({"J": 0.5, "d": 0.3}), null, reference)
    assert (held is not None) == is_held
    assert held is None or not any(p.estimate for p in held.parameters)


@pytest.mark.parametrize(
    ("adds_up", "percent", "is_driven"), [(False, 10.0, True), (True, 10.0, False), (True, 80.0, True)]
)
def test_a_simulation_that_follows_the_recording_is_taken_though_its_errors_add_up(
    adds_up, percent, is_driven
):
    """The voltage of a battery: nothing holds its charge, and loads had made the capacity six times smaller,
    and a law of the wrong sign of what they left."""
    followed = Agreement({"phi": percent}, {"phi": 1.0})
    fit = replace(quiet()[0].fit, simulated={"estimation": followed})
    assert stands._is_driven(Reference(fit, adds_up=adds_up)) == is_driven


def test_a_refit_begins_with_some_noise_at_every_sensor():
    """A load may have taken the noise of a sensor that it reaches at once; no search comes back from none."""
    null, _ = quiet()
    silent = tuple(replace(n, value=1e-12) if n.kind == "measurement" else n for n in null.fit.noises)
    moved = np.std(null.experiments[0].outputs)
    taken = replace(null, fit=replace(null.fit, noises=silent))
    assert taken.measurement_std == pytest.approx(1e-12)
    assert taken.starting_std == pytest.approx(GATES.least_noise * moved)
    assert null.starting_std == pytest.approx(null.measurement_std)


def test_loads_of_a_model_whose_values_are_all_given_have_time_constants_that_no_data_tell(monkeypatch):
    """Nothing is left to be found but noises: it had been refused, with a word to mark a parameter."""
    flat = without_noises(model())
    given = replace(flat, parameters=tuple(replace(p, estimate=False) for p in flat.parameters))
    found = nulls.identify

    def open_times(loaded, experiments, options):
        if not options.fix:
            times = ", ".join(options.bounds)
            raise EstimationError("identify-not-identifiable", "the data leave them open", where=times)
        return found(loaded, experiments, options)

    monkeypatch.setattr(nulls, "identify", open_times)
    places = [s for s in sites(given) if s.kind == "node"]
    null = fit_null(given, places, [rotor_record(600, seed=4, load=(0.15, 1.0))[0]], "zoh")
    assert null.estimated == () and null.loads[0].size == pytest.approx(0.2, rel=0.5)


def test_without_unknown_parameters_noises_are_found_where_that_is_asked_for():
    flat = without_noises(model())
    record = rotor_record(600, seed=4)[0]
    with pytest.raises(EstimationError, match="no parameter"):
        identify(flat, [record], IdentifyOptions(estimate=(), method="oe", hold="zoh"))
    fit = identify(flat, [record], IdentifyOptions(estimate=(), method="oe", hold="zoh", noises_alone=True))
    assert fit.parameters == () and fit.noises[0].estimated and fit.noises[0].value > 0.0
