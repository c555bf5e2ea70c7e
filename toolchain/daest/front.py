"""The steps of the commands as Python functions: `daest.identify("Servo.mo", "servo.csv")`.

Every function here takes its model as a path (.mo, .bmo, .fmu) or as a model that is compiled already, and
its recordings as paths, pandas DataFrames, xarray Datasets, mappings of arrays ({"time": t, "u": u, "phi":
phi}), or Experiments. One recording need not stand in a list. Results print as the command of the same name
does.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Literal, TypeAlias

import daest.report.printed  # noqa: F401  results print as the commands do
from daest.cli.models import load_model
from daest.data.check import check_experiment, check_table
from daest.data.prepare import Preparation, split_all
from daest.data.project import Project
from daest.data.read import Signal, measured_names, read_experiments, read_source, select_outputs, with_units
from daest.diagnosis import diagnose as diagnosing
from daest.diagnosis import improve as improving
from daest.diagnosis.comparison import compare as comparing
from daest.diagnosis.comparison.trial import Candidate, fitted_candidate
from daest.diagnosis.options import DiagnoseOptions
from daest.errors import ConfigError
from daest.estimation import identify as identifying
from daest.estimation.filter import run_filter
from daest.estimation.fitting.fitted import fitted_model
from daest.estimation.fitting.profile import silent
from daest.model.comparison import Comparison
from daest.model.defaults import MOST_EFFECTS
from daest.model.diagnosis import Diagnosis, Improvement
from daest.model.effects import Effect
from daest.model.estimates import FilterOptions, FilterResult
from daest.model.experiment import DataCheck, Experiment, Simulation
from daest.model.fit import FitResult, IdentifyOptions
from daest.model.flat import Model, with_equations
from daest.model.holds import Hold
from daest.model.linear import LinearDAE, StateSpaceFamily
from daest.model.noise import NoiseReport
from daest.modelica.change import with_outputs, with_values
from daest.modelica.effects.catalogue import effect_library
from daest.modelica.flat.clock import model_clock
from daest.modelica.flat.guesses import begun_as_recorded
from daest.near import near_names
from daest.systems.linear import linearize as linearizing
from daest.systems.linear.noise import noise_report
from daest.systems.simulation import simulate as simulating

HALF = 0.5
AnyModel: TypeAlias = str | Path | Model
AnyData: TypeAlias = Any  # a path, DataFrame, Dataset, mapping of arrays, Experiment, or a sequence of those


@dataclass(frozen=True)
class Source:
    """How models and recordings are read, in the words of daest.toml.

    `class_name` is the class of a file that holds several, `libraries` are folders of Modelica libraries,
    `values` give parameters values. `inputs` and `outputs` map names of the model to columns that are called
    otherwise, `time` names the column of the time, `units` the units of columns whose header has none.
    `start` and `stop` [s] cut a recording, `period` [s] resamples it, `detrend` removes mean or trend.
    """

    class_name: str | None = None
    libraries: Sequence[str | Path] = ()
    values: Mapping[str, float] = field(default_factory=dict)
    inputs: Mapping[str, str] = field(default_factory=dict)
    outputs: Mapping[str, str] = field(default_factory=dict)
    time: str | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    start: float | None = None
    stop: float | None = None
    period: float | None = None
    detrend: Literal["none", "mean", "linear"] = "none"

    def model(self, model: AnyModel) -> Model:
        """The model with `values`, from a file where it is a path. Raises ConfigError and ModelError."""
        if isinstance(model, str | Path):
            project = Project(Path(), outputs=self.outputs)
            loaded = load_model(project, Path(model), self.class_name, [Path(p) for p in self.libraries])
        else:
            loaded = model
        return with_values(loaded, self.values) if self.values else loaded

    def recordings(
        self, flat: Model, data: AnyData, *, is_driven: bool = False
    ) -> tuple[Model, list[Experiment]]:
        """The model with its measured outputs alone, and the recordings; where the model `is_driven`, all of
        its outputs. Raises DataError."""
        sources = _each(data)
        if sources and all(isinstance(one, Experiment) for one in sources):
            return begun_as_recorded(flat, sources), sources
        experiments = read_experiments(
            sources,
            [Signal(v.name, v.unit, self.inputs.get(v.name)) for v in flat.inputs],
            [Signal(y.name, y.unit, self.outputs.get(y.name)) for y in flat.outputs],
            Preparation(self.start, self.stop, self.period, self.detrend),
            outputs_required=not is_driven,
            time=self.time,
            units=self.units,
            clock=model_clock(flat),
        )
        if is_driven:
            return begun_as_recorded(flat, experiments), experiments
        names = measured_names(experiments)
        flat = begun_as_recorded(with_outputs(flat, names), experiments)
        return flat, [select_outputs(e, names) for e in experiments]


def identify(
    model: AnyModel | StateSpaceFamily,
    data: AnyData,
    options: IdentifyOptions | None = None,
    validation: AnyData = (),
    tell: Callable[[str], None] = silent,
    *,
    source: Source | None = None,
    **choices: Any,
) -> FitResult:
    """Estimate parameters of a model from recordings, with their uncertainty; as `daest identify`.

        fit = daest.identify("Servo.mo", "servo.csv", split=0.5, fix={"R": 4.6})
        print(fit)                    # the text of the command
        fit.theta                     # {name: value} of all parameters
        fit.to_frame()                # the table as a DataFrame

    `choices` are the fields of IdentifyOptions (`method`, `estimate`, `fix`, `start`, `prior`, `hold`,
    `split`, `starts`, `seed`, ...), `source` says how files are read. `tell` hears what is being done. Raises
    EstimationError, DataError, ModelError and ConfigError, all of them DaestError.

        >>> source = daest.Source(stop=2.0)
        >>> fit = daest.identify("Servo.mo", "servo.csv", source=source)
        >>> fit.status, [p.name for p in fit.parameters]
        ('converged', ['d', 'c', 'J1', 'J2', 'k'])
    """
    options = _chosen(options or IdentifyOptions(), choices, "identify")
    if isinstance(model, StateSpaceFamily):
        return identifying.identify(model, data, options, validation, tell)
    source = source or Source()
    flat, experiments = source.recordings(source.model(model), data)
    validating = _same_outputs(source, flat, validation)
    return identifying.identify(flat, experiments, options, validating, tell)


def simulate(
    model: Any,
    data: AnyData,
    *,
    source: Source | None = None,
    **choices: Any,
) -> Simulation:
    """Drive a model with the inputs of one recording; as `daest simulate`.

        run = daest.simulate("Servo.mo", "servo.csv", source=daest.Source(values={"k": 0.067}))
        run["phi"], run.time          # trajectories as arrays
        run.to_frame()

    `choices` are those of the engine: `theta`, `hold`, `noise`, `seed`, ... Raises DaestError.

        >>> run = daest.simulate("Servo.mo", "servo.csv", source=daest.Source(stop=2.0))
        >>> run["phi"].shape
        (201,)
    """
    if not isinstance(model, str | Path | Model) or isinstance(data, Experiment):
        flat = model if not isinstance(model, str | Path) else (source or Source()).model(model)
        return simulating.simulate(flat, data, **choices)
    source = source or Source()
    flat, experiments = source.recordings(source.model(model), data, is_driven=True)
    return simulating.simulate(flat, _one(experiments, "simulate"), **choices)


def linearize(
    model: AnyModel,
    theta: Any = None,
    at: Mapping[str, float] | None = None,
    *,
    source: Source | None = None,
) -> LinearDAE:
    """E, J, K, B, C and D of a model, with names, units and places; as `daest linearize`.

    `theta` are parameter values in the order of the model (None: its own), `at` is the operating point of a
    nonlinear model by name. Raises ModelError.

        >>> dae = daest.linearize(flat)
        >>> dae.E.shape
        (65, 65)
    """
    return linearizing.linearize((source or Source()).model(model), theta, at=at)


def noise(
    model: AnyModel | LinearDAE,
    at: Sequence[int | str] = (),
    tolerance: float | None = None,
    *,
    source: Source | None = None,
) -> NoiseReport:
    """Which equations may carry white noise, and why the others may not; as `daest noise`.

    `at` names places that are asked for besides; up to the projection norm `tolerance` equations are called
    admissible (None: decided without units). Raises ModelError.

        >>> daest.noise(flat).n_forbidden
        18
    """
    dae = model if isinstance(model, LinearDAE) else linearize(model, source=source)
    return noise_report(dae, at=at, tolerance=tolerance)


def check(data: AnyData, *, source: Source | None = None) -> DataCheck:
    """Faults of one recording: its clock, its columns, and pairs of them; as `daest check`. Raises
    DataError.

        >>> daest.check("servo.csv").warnings
        ()
    """
    one = _one(_each(data), "check")
    if isinstance(one, Experiment):
        return check_experiment(one)
    source = source or Source()
    return check_table(with_units(read_source(one), source.units), {}, source.time)


def filter(
    model: AnyModel,
    data: AnyData,
    fit: FitResult | None = None,
    kind: str | None = None,
    *,
    source: Source | None = None,
    **choices: Any,
) -> FilterResult:
    """States and all internal variables with their uncertainty along one recording; as `daest filter`.

        estimate = daest.filter("Servo.mo", "servo.csv", fit, measure=["phi"])
        estimate["omega"], estimate.std("omega")

    Parameters and noise are those of `fit`, else of the model. `choices` are the fields of FilterOptions
    (`measure`, `smooth`, `hold`, ...). Raises DaestError.

        >>> estimate = daest.filter("Servo.mo", "servo.csv", fit, measure=["phi"], source=source)
        >>> estimate.kind, estimate.values.shape
        ('time-varying', (201, 67))
    """
    source = source or Source()
    flat, experiments = source.recordings(source.model(model), data)
    defaults = FilterOptions() if fit is None else FilterOptions(hold=fit.hold)
    options = _chosen(defaults, choices, "filter")
    fitted = flat if fit is None else fitted_model(flat, fit)
    return run_filter(fitted, _one(experiments, "filter"), kind, options)


def compare(
    models: Any,
    data: AnyData,
    fits: FitResult | Sequence[FitResult | None] | None = None,
    *,
    hold: Hold | None = None,
    bootstrap: int = 0,
    seed: int = 0,
    source: Source | None = None,
) -> Comparison:
    """Models side by side on the same recordings, with the parameters of their fits; as `daest compare`.

        daest.compare(["Servo.mo", "Friction.mo"], "run2.csv", [fit, other_fit])

    A model without a fit keeps its values. `hold` is that of the fit, else "foh". Raises DaestError, and
    ConfigError `compare-missing-output` where the models have not the same outputs.

        >>> daest.compare("Servo.mo", "servo.csv", fit, source=source).models[0].verdict
        'not falsified'
    """
    source = source or Source()
    flats = [source.model(one) for one in _each(models)]
    results = [fits] * len(flats) if fits is None or isinstance(fits, FitResult) else list(fits)
    measured, experiments = source.recordings(flats[0], data)
    names = measured.output_names
    candidates = [_candidate(flat, result, names, hold) for flat, result in zip(flats, results, strict=True)]
    return comparing.compare_models(
        candidates, experiments, bootstrap=bootstrap, seed=seed, jobs=os.cpu_count() or 1
    )


def diagnose(
    model: AnyModel,
    *arguments: Any,
    validation: AnyData = (),
    options: DiagnoseOptions | None = None,
    progress: Callable[[str], None] = silent,
    source: Source | None = None,
    **choices: Any,
) -> Diagnosis:
    """Which physical effect a model lacks, where, and how sure that is; as `daest diagnose`.

        found = daest.diagnose("Servo.mo", "servo.csv", effects=("CoulombFriction",))
        print(found)

    `arguments` are the recordings, behind the effects to be tried where not those of the library are meant;
    `validation`, `options` and `progress` may follow. Without `validation` the second half of every recording
    validates. `choices` are the fields of DiagnoseOptions (`effects`, `places`, `hold`, `seed`, ...). Raises
    DaestError.

        >>> friction = {"effects": ("CoulombFriction",), "places": ("disc",)}
        >>> daest.diagnose("Servo.mo", "servo.csv", **friction, source=daest.Source(stop=4.0)).verdict
        'nothing missing'
    """
    library, data, rest = _library_first(arguments, source)
    given: list[Any] = [validation, options, progress]
    given[: len(rest)] = rest
    validation, options, progress = given
    case = _case(source, model, data, validation, _chosen(options or DiagnoseOptions(), choices, "diagnose"))
    return diagnosing.diagnose(case.flat, library, *case.searched, progress)


def improve(
    model: AnyModel,
    *arguments: Any,
    validation: AnyData = (),
    options: DiagnoseOptions | None = None,
    most_effects: int = MOST_EFFECTS,
    progress: Callable[[str], None] = silent,
    source: Source | None = None,
    **choices: Any,
) -> Improvement:
    """Diagnose a model and add the effect, again and again, until nothing is missing or nothing helps; as
    `daest improve`, which also writes the models.

    Takes what `diagnose` takes, and the largest number of effects before `progress`. Raises DaestError.

        >>> found = daest.improve("Servo.mo", "servo.csv", **friction, source=daest.Source(stop=4.0))
        >>> found.last.verdict
        'nothing missing'
    """
    library, data, rest = _library_first(arguments, source)
    given: list[Any] = [validation, options, most_effects, progress]
    given[: len(rest)] = rest
    validation, options, most_effects, progress = given
    case = _case(source, model, data, validation, _chosen(options or DiagnoseOptions(), choices, "improve"))
    flat = with_equations(case.flat, "an extended model")
    return improving.improve(flat, library, *case.searched, most_effects, progress)


@dataclass(frozen=True)
class _Case:
    """A model, and what the search for an effect takes: estimation and validation records, and options."""

    flat: Model
    searched: tuple[list[Experiment], list[Experiment], DiagnoseOptions]


def _case(
    source: Source | None, model: AnyModel, data: AnyData, validation: AnyData, options: DiagnoseOptions
) -> _Case:
    source = source or Source()
    flat, experiments = source.recordings(source.model(model), data)
    validating = _same_outputs(source, flat, validation)
    if not validating:
        experiments, validating = split_all(experiments, Preparation(split=HALF))
    return _Case(flat, (experiments, validating, options))


def _library_first(
    arguments: Sequence[Any], source: Source | None
) -> tuple[tuple[Effect, ...], AnyData, Sequence[Any]]:
    """The effects, the recordings, and the arguments behind them."""
    if not arguments:
        raise TypeError("a recording is missing: daest.diagnose(model, data)")
    if isinstance(arguments[0], list | tuple) and _is_library(arguments[0]):
        return tuple(arguments[0]), arguments[1], arguments[2:]
    folders = () if source is None else tuple(Path(folder) for folder in source.libraries)
    return effect_library(folders), arguments[0], arguments[1:]


def _is_library(values: Sequence[Any]) -> bool:
    return bool(values) and all(hasattr(value, "class_name") for value in values)


def _candidate(flat: Model, fit: FitResult | None, names: Sequence[str], hold: Hold | None) -> Candidate:
    present = set(flat.output_names)
    missing = [name for name in names if name not in present]
    if missing:
        raise ConfigError(
            "compare-missing-output",
            f"{flat.name} has no output {', '.join(missing)}",
            remedy="compare models with the same outputs",
        )
    chosen = with_outputs(flat, names)
    if fit is None:
        return Candidate(flat.name, chosen, 0, hold or "foh")
    return fitted_candidate(chosen, fit, hold)


def _same_outputs(source: Source, flat: Model, data: AnyData) -> list[Experiment]:
    """Recordings with the outputs that the model has."""
    return source.recordings(flat, data)[1] if len(_each(data)) else []


def _each(data: Any) -> list[Any]:
    """The sources of a list or a tuple, or the only one."""
    return list(data) if isinstance(data, list | tuple) else [data]


def _one(found: Sequence[Any], name: str) -> Any:
    if len(found) != 1:
        raise ConfigError(
            "files-too-many",
            f"daest.{name} takes one recording, and {len(found)} are given",
            remedy="call it once for each",
        )
    return found[0]


def _chosen(options: Any, choices: Mapping[str, Any], name: str) -> Any:
    """The options with the choices put in. Raises TypeError for a name that is none of its fields."""
    known = [f.name for f in fields(options)]
    for choice in choices:
        if choice not in known:
            near = near_names(choice, known, 1)
            hint = f"did you mean '{near[0]}'?" if near else f"it takes {', '.join(known)}"
            raise TypeError(f"daest.{name} has no option '{choice}'; {hint}")
    return replace(options, **choices)
