"""daest: from a Modelica model and a recording to parameters, states and the physics that the model lacks.

The functions are called as the commands are, take files or what is in memory, and return values that print
as the command does:

    fit = daest.identify("Servo.mo", "servo.csv", split=0.5)  # or a DataFrame, or {"time": t, "u": u, ...}
    print(fit)
    print(daest.compare("Servo.mo", "run2.csv", fit))
    estimate = daest.filter("Servo.mo", "run2.csv", fit, measure=["phi"])
    print(daest.diagnose("Servo.mo", "servo.csv"))

identify, compare, filter, diagnose, improve, simulate, linearize, noise and check take `source`, a
daest.Source, for columns, units and classes that are called otherwise. Behind them are the steps, from
one value to the next:

    flat = daest.compile_model("Servo.mo")
    dae = daest.linearize(flat)
    form = daest.split(dae)
    report = daest.noise_report(dae, form)
    data = daest.read_experiments(["servo.csv"], [daest.Signal("u", "V")], [daest.Signal("phi", "rad")])
    fit = daest.identify(flat, data, daest.IdentifyOptions(split=0.5))

`help(daest.identify)` tells what a function takes, and `daest explain CODE` what an error means.

Names are imported when they are first used, so that `import daest` loads nothing numerical.
"""

from __future__ import annotations

import importlib
from typing import Any

__version__ = "0.1.0"

# Public name -> the module that defines it, in the order in which the names are used.
_PUBLIC = {
    # a model from Modelica, or out of an FMU
    "compile_model": "daest.modelica.compile",
    "with_values": "daest.modelica.change",
    "declare": "daest.modelica.change",
    "export_fmu": "daest.fmu.export",
    "load_fmu": "daest.fmu.load",
    "symbolic_model": "daest.fmu.load",
    # the linear DAE and its standard form
    "linearize": "daest.front",
    "linearize_fmu": "daest.fmu.linearize",
    "linear_dae_function": "daest.systems.linear.linearize",
    "split": "daest.systems.linear.split",
    "noise": "daest.front",
    "noise_report": "daest.systems.linear.noise",
    "poles": "daest.systems.linear.transfer",
    "transfer_functions": "daest.systems.linear.transfer",
    # ordinary differential equations
    "reduce_index": "daest.systems.reduction.reduce",
    "initial_point": "daest.systems.reduction.initialize",
    "state_space_family": "daest.systems.linear.state_space",
    "state_space": "daest.systems.linear.state_space",
    "sample": "daest.systems.linear.state_space",
    "simulate": "daest.front",
    # recordings
    "Experiment": "daest.model.experiment",
    "Signal": "daest.data.read",
    "read_experiments": "daest.data.read",
    "load_project": "daest.data.project",
    "Source": "daest.front",
    "check": "daest.front",
    "check_experiment": "daest.data.check",
    "resample": "daest.data.prepare",
    # estimates
    "IdentifyOptions": "daest.model.fit",
    "Prior": "daest.model.parts",
    "identify": "daest.front",
    "fitted_model": "daest.estimation.fitting.fitted",
    "InitialState": "daest.model.estimates",
    "FilterOptions": "daest.model.estimates",
    "filter": "daest.front",
    "run_filter": "daest.estimation.filter",
    # models side by side, and what they lack
    "Candidate": "daest.diagnosis.comparison.trial",
    "compare": "daest.front",
    "compare_models": "daest.diagnosis.comparison.compare",
    "effect_library": "daest.modelica.effects.catalogue",
    "find_effect": "daest.modelica.effects.catalogue",
    "attach": "daest.modelica.effects.attach",
    "extend_model": "daest.modelica.effects.extend",
    "diagnose": "daest.front",
    "improve": "daest.front",
    # what goes wrong
    "DaestError": "daest.errors",
}

__all__ = [*_PUBLIC]


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'daest' has no attribute '{name}'")
    value = getattr(importlib.import_module(_PUBLIC[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*_PUBLIC, "__version__"])
