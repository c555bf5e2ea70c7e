"""The machines of the study of text books are what their models say, and its counts are right."""

import sys

import numpy as np
import pytest
from test_rates import ROOT, loaded

import daest
from daest.diagnosis.evidence.stand import begin
from daest.diagnosis.options import DiagnoseOptions
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_model
from daest.modelica.effects.catalogue import effect_library

QUICK = ("zones", "pendulum", "shaft")


@pytest.fixture(scope="module")
def study():
    before = set(sys.modules)
    sys.path.insert(0, str(ROOT / "benchmarks"))
    yield loaded("benchmarks/textbook_machines_study.py")
    sys.path.remove(str(ROOT / "benchmarks"))
    for name in {one for one in set(sys.modules) - before if "stud" in one or "textbook" in one}:
        del sys.modules[name]


@pytest.mark.parametrize(
    "name",
    [
        *QUICK,
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in ("car", "hoist", "cylinder", "dc", "tanks3", "filter", "heater", "train")
        ),
    ],
)
def test_a_machine_without_effects_is_its_model_at_the_true_values(study, tmp_path, name):
    machine = study.with_effects(name, ())
    study.write(tmp_path, machine, *np.zeros((2, 1, 1)))
    model = compile_model(tmp_path / "Machine.mo")
    n, rng = 200, np.random.default_rng(1)
    u = np.column_stack([curve(n, machine.period, rng) for curve in machine.inputs.values()])
    y = sys.modules["textbook_machines"].simulated(machine, u)
    time = machine.period * np.arange(n)
    record = Experiment("run", time, u, y, tuple(machine.inputs), tuple(machine.noise))
    theta = np.array([getattr(machine, parameter.name) for parameter in model.parameters])
    run = daest.simulate(model, record, theta=theta, hold="zoh")
    error = np.column_stack([run[output] for output in machine.noise]) - y
    assert np.abs(error / list(machine.noise.values())).max() < 0.02


@pytest.mark.slow
def test_loads_hide_no_better_values_of_a_resonance_that_is_sampled_slowly(study, tmp_path):
    case, every = study.NAMED["shaft nothing"], 20
    machine, rng = study.with_effects("shaft", ()), case.rng(102)
    fault = sys.modules["textbook_machines"].FAULTS[int(rng.integers(5))]
    u, y = sys.modules["textbook_machines"].recording(machine, fault, rng, every)
    study.write(tmp_path, machine, u, y, every)
    time = every * machine.period * np.arange(len(u))
    record = Experiment("run", time, u, y, tuple(machine.inputs), tuple(machine.noise))
    stand = begin(compile_model(tmp_path / "Machine.mo"), [record], [], DiagnoseOptions())
    assert stand.null.fit.theta["k"] == pytest.approx(machine.k, rel=0.01)


def test_names_of_effects_are_laws_and_their_sizes_change_the_machine(study):
    laws = {effect.name for effect in effect_library()}
    for name, machine in study.MACHINES.items():
        for effect, hidden in machine.effects.items():
            assert set(hidden.names) <= laws
            assert bool(hidden.why) == (len(hidden.names) > 1)
            assert study.with_effects(name, (effect,)) != study.with_effects(name, ())


def run(study, case, fault, *claimed, verdict="supported"):
    return study.Run(case, 1, fault, verdict, claimed, 1.0)


def test_alternatives_of_a_diagnosis_count_once_and_effects_of_improve_each(study):
    told = [
        (run(study, "car friction", "none", "CoulombFriction at 2:F", "EndStop at 2:F"), {"right": 1}),
        (run(study, "car friction", "gain", "Gain at zr"), {"small faults": 1}),
        (run(study, "car friction", "none", "Gain at zr"), {"wrong": 1}),
        (run(study, "car nothing", "gain", "Gain at zb"), {"wrong": 1}),
        (run(study, "car friction", "none", verdict="unknown effect"), {"missed": 1}),
        (run(study, "car nothing", "none", verdict="nothing missing"), {}),
        (run(study, "car friction", "none", verdict="stop: init"), {"stops": 1}),
        (
            run(study, "car friction+stop", "gain", "EndStop at 2:F", "Gain at zr", "Lag at zb"),
            {"right": 1, "small faults": 1, "missed": 1, "wrong": 1},
        ),
    ]
    for one, wanted in told:
        assert {what: n for what, n in study.counts(one).items() if n} == wanted
    last = study.table([one for one, _ in told]).splitlines()[-1].split()
    assert last == ["all", "8", "7", "2", "2", "2", "3", "1", "8", "s"]


def test_a_kept_run_is_read_again(study, tmp_path, capsys):
    kept = run(study, "train slope", "drift", "Offset at F", "Gravity at 0:v")
    study.keep(tmp_path / "runs.jsonl", 0, study.Outcome(kept))
    assert study.kept(tmp_path / "runs.jsonl") == [kept]
    assert "train slope 1 drift: 1 right" in capsys.readouterr().out


def test_documents_of_the_commands_become_labels(study):
    candidates = [
        {"effect": "Offset", "at": "F", "verdict": "supported", "same_as": ["Gravity at 0:v"]},
        {"effect": "Lag", "at": "y", "verdict": "rejected", "same_as": []},
    ]
    found = study.diagnosed({"verdict": "supported", "candidates": candidates})
    assert found == ("supported", ("Offset at F", "Gravity at 0:v"))
    steps = [{"added": None, "at": None}, {"added": "Lag", "at": "y"}]
    ledger = {"final": {"verdict": "nothing missing"}, "steps": steps}
    assert study.improved(ledger) == ("nothing missing", ("Lag at y",))
