"""Effects that a diagnosis found, as Modelica: the user's model extended, with the values of the fit."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np

from daest.diagnosis.answers.learned import helps
from daest.diagnosis.comparison.compare import follower
from daest.diagnosis.comparison.trial import Candidate as Trialled
from daest.diagnosis.comparison.trial import agreement
from daest.errors import ModelError
from daest.estimation.fitting.records import in_model_order
from daest.model.diagnosis import Candidate, Diagnosis, Improvement, LearnedLoad, Proof
from daest.model.experiment import Experiment
from daest.model.flat import FlatModel
from daest.model.holds import Hold
from daest.modelica.change import declare
from daest.modelica.compile import compile_model
from daest.modelica.effects.attach import free_name, names_of
from daest.modelica.effects.extend import CurveText, Extension, extend_by_curve, extend_model
from daest.modelica.places.sites import find_site, number_of

NO_TEXT = "an FMU holds equations, not the Modelica text that could be extended"
LOAD_FILE = "unknown_effect.mo"
DIGITS = 8  # of a fitted value in a written model


@dataclass(frozen=True)
class Written:
    """A model as Modelica, or the `reason` why there is none. `columns` are the recorded signals that supply
    its new inputs, by input."""

    extension: Extension | None
    reason: str = ""
    columns: Mapping[str, str] = field(default_factory=dict)

    @property
    def text(self) -> str | None:
        return None if self.extension is None else self.extension.text


def written_proof(
    path: Path,
    class_name: str | None,
    proof: Proof,
    libraries: Sequence[str | Path] = (),
    names: Mapping[str, str] | None = None,
    target: Path | None = None,
) -> Written:
    """Class `class_name` of `path` extended by the effect of `proof`.

    Effect and model take the values of the proof's fit. `names` are the components that stand in the file for
    those of the proof's model, for effects that were added before; `target` is the file that the text is
    meant for.
    """
    if path.suffix != ".mo":
        return Written(None, NO_TEXT)
    try:
        return _written(path, class_name, proof, libraries, names or {}, target)
    except ModelError as problem:
        return Written(None, f"{problem.what}. {problem.remedy}".strip())


def _written(
    path: Path,
    class_name: str | None,
    proof: Proof,
    libraries: Sequence[str | Path],
    names: Mapping[str, str],
    target: Path | None,
) -> Written:
    flat = compile_model(path, class_name, libraries)
    candidate = proof.candidate
    is_own = candidate.effect.is_of_variable
    inputs = {
        signal: with_names(column, names) if is_own else _identifier(column, flat)
        for signal, column in candidate.inputs.items()
    }
    extension = extend_model(
        path,
        class_name,
        candidate.effect,
        find_site(
            flat,
            with_names(candidate.site.name, names),
            candidate.effect,
            number_of(proof.flat, candidate.site, candidate.effect),
        ),
        values=_own_values(proof),
        inputs=inputs,
        input_units=candidate.input_units,
        parameters=_changed(flat, proof.told.theta, names),
        held=_held(proof),
        libraries=libraries,
        target=target,
    )
    columns = {} if is_own else {inputs[s]: column for s, column in candidate.inputs.items()}
    return Written(extension, columns=columns)


def _changed(flat: FlatModel, theta: Mapping[str, float], names: Mapping[str, str]) -> dict[str, float]:
    """The values of a fit that differ from those of the model."""
    found = {with_names(name, names): value for name, value in theta.items()}
    return {p.name: _short(found[p.name]) for p in flat.parameters if found.get(p.name, p.value) != p.value}


def written_load(
    path: Path,
    class_name: str | None,
    learned: LearnedLoad,
    libraries: Sequence[str | Path] = (),
    names: Mapping[str, str] | None = None,
    target: Path | None = None,
    columns: Mapping[str, str] | None = None,
) -> Written:
    """Class `class_name` of `path` extended by the curve of `learned`, with the values of its fit; the other
    arguments are as in `written_proof`, `columns` as in `Written`."""
    if path.suffix != ".mo":
        return Written(None, NO_TEXT)
    known, curve = names or {}, learned.curve
    inputs = {column: name for name, column in (columns or {}).items()}
    try:
        flat = compile_model(path, class_name, libraries)
        load = CurveText(
            place=with_names(learned.form.place, known),
            x=inputs.get(curve.variable) or with_names(curve.variable, known),
            x_knots=[_short(x) for x in curve.x],
            y=[_short(learned.sign * y) for y in curve.y],
            s=inputs.get(curve.sign_of) or with_names(curve.sign_of, known),
            s_s=_short(curve.sign_width),
            period=curve.period,
        )
        changed = _changed(flat, learned.theta, known)
        extension = extend_by_curve(
            path, class_name, load, parameters=changed, libraries=libraries, target=target
        )
    except ModelError as problem:
        return Written(None, f"{problem.what}. {problem.remedy}".strip())
    return Written(extension, columns=columns or {})


def _own_values(proof: Proof) -> dict[str, float]:
    """Values of the effect's parameters by their own names; those that its component gives stay with it."""
    candidate, theta = proof.candidate, proof.told.theta
    own = [p.name for p in candidate.effect.parameters if p.role != "given"]
    return {name: _short(theta[key]) for name in own if (key := f"{candidate.name}.{name}") in theta}


def _held(proof: Proof) -> tuple[str, ...]:
    """The parameters of the effect that its library would estimate and the fit did not: a limit that was read
    off the recordings."""
    candidate, fitted = proof.candidate, {p.name for p in proof.told.parameters}
    estimated = (p.name for p in candidate.effect.parameters if p.estimate)
    return tuple(name for name in estimated if f"{candidate.name}.{name}" not in fitted)


def _short(value: float) -> float:
    """The value with as many digits as a reader can use."""
    return float(f"{value:.{DIGITS}g}")


def _identifier(column: str, flat: FlatModel) -> str:
    """A name for the input that a column supplies: the column's where Modelica and the model allow it."""
    base = re.sub(r"\W", "_", column, flags=re.ASCII)
    base = base if base[:1].isalpha() else f"u_{base}"
    taken = names_of(flat) - set(flat.input_names)
    return free_name(base, taken)


def written_steps(
    path: Path,
    class_name: str | None,
    improvement: Improvement,
    folder: Path,
    libraries: Sequence[str | Path] = (),
) -> tuple[dict[int, Written], dict[str, str]]:
    """The models of an improvement by the number of the step, each extending the former, and the names that
    the components of the effects have in them.

    They are written into `folder`, since each is read again for the next, as `step_file` names them. From the
    first one on that cannot be written there are none.
    """
    models: dict[int, Written] = {}
    names: dict[str, str] = {}
    columns: dict[str, str] = {}
    for number, step in enumerate(improvement.steps):
        if step.proof is None:
            continue
        target = folder / step_file(number, step.proof.candidate)
        found = written_proof(path, class_name, step.proof, libraries, names, target)
        columns |= found.columns
        models[number] = replace(found, columns=dict(columns))
        if found.extension is None:
            missing = Written(None, f"it would extend the model of step {number}, which could not be written")
            later = range(number + 1, len(improvement.steps))
            return models | dict.fromkeys(later, missing), names
        target.write_text(found.extension.text, encoding="utf-8")
        names[step.proof.candidate.name] = found.extension.component
        path, class_name = target, found.extension.class_name
    return models, names


def offered_load(
    path: Path,
    class_name: str | None,
    improvement: Improvement,
    models: Mapping[int, Written],
    names: Mapping[str, str],
    folder: Path,
    libraries: Sequence[str | Path] = (),
) -> Written | None:
    """The last model of an improvement with the load that its last round could not name; None where there is
    none. `models` and `names` are those of `written_steps`, whose files are in `folder`."""
    learned = improvement.last.learned
    if learned is None:
        return None
    columns: Mapping[str, str] = {}
    if models:
        number = max(models)
        proof, last = improvement.steps[number].proof, models[number]
        if last.extension is None or proof is None:
            return Written(None, f"it would extend the model of step {number}, which could not be written")
        path, class_name = folder / step_file(number, proof.candidate), last.extension.class_name
        columns = last.columns
    return written_load(path, class_name, learned, libraries, names, folder / LOAD_FILE, columns)


def is_step(load: Written | None, last: Diagnosis) -> TypeGuard[Written]:
    """Whether the `load` of the last round is written, and its curve simulates unseen data clearly better: it
    is the last step of an improvement, of no law of the library."""
    learned = last.learned
    if load is None or load.extension is None or learned is None or last.verdict != "unknown effect":
        return False
    return not learned.against and helps(learned)


def step_file(number: int, candidate: Candidate) -> str:
    """Name of the file of one step."""
    return f"step{number}_{candidate.effect.name}.mo"


def simulated_rms(
    flat: FlatModel,
    outputs: Sequence[str],
    columns: Mapping[str, str],
    experiments: Sequence[Experiment],
    hold: Hold,
) -> dict[str, float | None]:
    """Errors (rms) of the model's `outputs`, simulated without noise from the best initial states; its inputs
    that the experiments lack are their recorded `columns`."""
    silent = replace(flat, noises=tuple(replace(w, intensity=0.0) for w in flat.noises))
    model = declare(silent, outputs=list(outputs))
    driven = [in_model_order(_driven(e, flat.input_names, columns), model) for e in experiments]
    found = follower(Trialled(flat.name, model, 0, hold), driven)(model.theta_values)
    return dict(agreement(model, driven, found).rms)


def _driven(experiment: Experiment, names: Sequence[str], columns: Mapping[str, str]) -> Experiment:
    known = dict(zip(experiment.input_names, experiment.inputs.T, strict=True))
    found = [known[n] if n in known else np.nan_to_num(experiment.extra[columns[n]]) for n in names]
    inputs = np.column_stack(found) if found else experiment.inputs
    return replace(experiment, inputs=inputs, input_names=tuple(names))


def with_names(content: Any, names: Mapping[str, str]) -> Any:
    """A document or text with components called as in the written models."""
    if isinstance(content, str):
        words = "|".join(map(re.escape, names))
        return re.sub(rf"\b(?:{words})\b", lambda found: names[found[0]], content) if names else content
    if isinstance(content, Mapping):
        return {with_names(key, names): with_names(value, names) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [with_names(value, names) for value in content]
    return content
