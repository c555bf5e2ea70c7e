"""The exported estimator as an FMU, in fmpy, against the filter of whole recordings."""

from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy import fmi2, fmi3
from test_estimator_c import NONLINEAR, PLANT, agree, record

from daest.estimation.filter import run_filter
from daest.estimation.streaming.estimator import estimator_model
from daest.fmu.estimator_fmu import export_estimator_fmu
from daest.model.estimates import FilterOptions, InitialState
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_model

VERSIONS = ("3.0", "2.0")


@pytest.fixture(scope="module")
def plant(tmp_path_factory):
    path = tmp_path_factory.mktemp("model") / "Plant.mo"
    path.write_text(PLANT)
    return compile_model(path)


@pytest.fixture(scope="module")
def fmus(plant, tmp_path_factory):
    folder = tmp_path_factory.mktemp("fmu")
    model = estimator_model(plant, 0.1, hold="zoh")
    found = {}
    for version in VERSIONS:
        result = export_estimator_fmu(model, folder / f"{version}.fmu", version=version)
        assert result.validation == ()
        found[version] = (result.path, fmpy.extract(str(result.path), str(folder / version)))
    return found


class Importer:
    """A minimal master: samples in, estimates out."""

    def __init__(self, path: Path, unpacked: str) -> None:
        description = fmpy.read_model_description(str(path))
        self.is_3 = description.fmiVersion == "3.0"
        kind = fmi3.FMU3Slave if self.is_3 else fmi2.FMU2Slave
        self.fmu = kind(
            guid=description.guid if not self.is_3 else description.instantiationToken,
            unzipDirectory=unpacked,
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="e",
        )
        self.reference = {v.name: v.valueReference for v in description.modelVariables}
        self.flags = {v.name for v in description.modelVariables if v.type == "Boolean"}
        self.outputs = [v.name for v in description.modelVariables if v.causality == "output"]
        self.fmu.instantiate()

    def start(self, **values: float) -> "Importer":
        if not self.is_3:
            self.fmu.setupExperiment(startTime=0.0)
        self.fmu.enterInitializationMode()
        self.set(values)
        self.fmu.exitInitializationMode()
        return self

    def set(self, values) -> None:
        for name, value in values.items():
            references = [self.reference[name]]
            if name in self.flags:
                self.fmu.setBoolean(references, [bool(value)])
            elif self.is_3:
                self.fmu.setFloat64(references, [float(value)])
            else:
                self.fmu.setReal(references, [float(value)])

    def get(self) -> dict[str, float]:
        read = self.fmu.getFloat64 if self.is_3 else self.fmu.getReal
        return dict(zip(self.outputs, read([self.reference[n] for n in self.outputs]), strict=True))

    def step(self, experiment, k) -> dict[str, float]:
        y = experiment.outputs[k]
        self.set({"u": experiment.inputs[k, 0]})
        for name, value in zip(experiment.output_names, y, strict=True):
            self.set({name: np.nan_to_num(value), f"valid_{name}": np.isfinite(value)})
        following = experiment.time[k + 1] if k + 1 < experiment.time.size else experiment.time[k] + 0.1
        self.fmu.doStep(experiment.time[k], following - experiment.time[k])
        return self.get()

    def run(self, experiment, first=0) -> list[dict[str, float]]:
        return [self.step(experiment, k) for k in range(first, experiment.time.size)]

    def close(self) -> None:
        self.fmu.terminate()
        self.fmu.freeInstance()


def table(rows) -> dict[str, np.ndarray]:
    found = {name.removeprefix("estimate."): np.array([row[name] for row in rows]) for name in rows[0]}
    return {name: np.where(np.isfinite(v), v, np.nan) for name, v in found.items()}


@pytest.mark.parametrize("version", VERSIONS)
def test_estimates_are_those_of_the_recording(plant, fmus, version):
    importer = Importer(*fmus[version]).start()
    experiment = record(True)
    rows = importer.run(experiment)
    importer.close()
    known = run_filter(plant, experiment, options=FilterOptions(hold="zoh"))
    assert {"estimate.y", "y.std", "v", "v.std", "innovation.y", "nis", "log_likelihood"} <= set(rows[0])
    agree(table(rows), known, 1e-9, known.names)
    assert [row["sample_time"] for row in rows] == list(experiment.time)


@pytest.mark.parametrize("version", VERSIONS)
def test_a_saved_state_goes_on_where_it_was(fmus, version):
    importer, experiment = Importer(*fmus[version]).start(), record(False)
    for k in range(60):
        importer.step(experiment, k)
    state = importer.fmu.getFMUState()
    content = importer.fmu.serializeFMUState(state)
    whole = table(importer.run(experiment, 60))
    importer.close()
    other = Importer(*fmus[version]).start()
    other.fmu.setFMUState(other.fmu.deserializeFMUState(content))
    again = table(other.run(experiment, 60))
    other.close()
    for name, values in whole.items():
        np.testing.assert_array_equal(again[name], values, err_msg=name)


@pytest.mark.parametrize("version", VERSIONS)
def test_known_start_and_knobs(plant, fmus, version):
    start = {"start_known": True, "start.s": 0.4, "start.s.std": 0.2, "start.v.std": 0.5}
    experiment = record(True)
    states = [
        name.removeprefix("start.")
        for name in Importer(*fmus[version]).reference
        if name.startswith("start.")
    ]
    names = [name for name in states if not name.endswith(".std")]
    mean = np.array([0.4 if name == "s" else 0.0 for name in names])
    std = np.array([{"s": 0.2, "v": 0.5}.get(name, 1.0) for name in names])
    importer = Importer(*fmus[version]).start(**start, **{"start.turn.std": 1.0}, c=6.0)
    rows = importer.run(experiment)
    importer.close()
    options = FilterOptions(hold="zoh", initial=InitialState.known(mean, std))
    known = run_filter(plant.with_theta({"c": 6.0}), experiment, options=options)
    agree(table(rows), known, 1e-9, ("s", "v", "turn"))


@pytest.mark.parametrize("version", VERSIONS)
def test_a_step_back_is_an_error(fmus, version):
    importer, experiment = Importer(*fmus[version]).start(), record(True)
    importer.step(experiment, 3)
    with pytest.raises(Exception, match=r"(?i)dostep"):
        importer.step(experiment, 2)
    importer.fmu.freeInstance()


@pytest.mark.slow  # in C: test_estimator_c.py
@pytest.mark.parametrize(("version", "kind"), [("3.0", "ekf"), ("2.0", "ukf")])
def test_a_nonlinear_filter(tmp_path, version, kind):
    """Of a model with an algebraic loop; missing samples, uneven steps."""
    path = tmp_path / "Diode.mo"
    path.write_text(NONLINEAR["Diode"])
    flat, rng, n = compile_model(path), np.random.default_rng(1), 80
    time = np.cumsum(rng.uniform(0.03, 0.2, n))
    y = rng.normal(size=(n, 1))
    y[rng.uniform(size=y.shape) < 0.2] = np.nan
    experiment = Experiment("r", time, np.repeat(rng.normal(size=n // 5), 5)[:, None], y, ("u",), ("y",))
    model = estimator_model(flat, 0.1, kind, longest=0.025)
    result = export_estimator_fmu(model, tmp_path / "e.fmu", version=version)
    assert result.validation == ()
    start = {"start_known": True, "start.v": 0.3, "start.v.std": 0.2, "start.q": 0.1, "start.q.std": 0.4}
    importer = Importer(result.path, fmpy.extract(str(result.path), str(tmp_path / "u"))).start(**start)
    rows = table(importer.run(experiment))
    importer.close()
    initial = InitialState.known(np.array([0.3, 0.1]), np.array([0.2, 0.4]))
    known = run_filter(flat, experiment, kind, FilterOptions(initial=initial, longest=0.025))
    agree(rows, known, 1e-9, ("v", "q", "i", "y"))
