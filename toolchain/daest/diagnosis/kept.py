"""Steps and proofs kept as files while a diagnosis runs, so that an interrupted run goes on where it was."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import time
import types
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import casadi as ca
import numpy as np

from daest.cache import cache_folder, forget_unused, keep_content, kept_content
from daest.diagnosis.built_in.trials import Prepared
from daest.errors import ConfigError, DaestError
from daest.model.diagnosis import Proof
from daest.model.experiment import Experiment
from daest.model.flat import FlatModel, Model
from daest.numerics.parallel import packed, program, unpacked

Step = TypeVar("Step")

DIGITS = 6  # of a value that count: the last ones change from one machine to another
WORTH_KEEPING = 0.5  # seconds that a step must have taken
MOST_STEPS = 40  # that are kept; the oldest leave
_WORDS = ("place", "description")  # of a declaration
_LEFT_OUT = ("candidate", "flat")  # of a proof: known before it is made


@dataclass(frozen=True)
class KeptProofs:
    """Proofs as JSON files of `folder`, called by a hash of `run` (what the whole run rests on) and of the
    model that is refitted. `whole_file` opens a file that is written whole or not at all."""

    folder: Path
    run: str
    whole_file: Callable[[Path], AbstractContextManager[Path]]

    def found(self, prepared: Prepared) -> Proof | None:
        """The proof of an earlier run."""
        try:
            return _restored(prepared, json.loads(self._path(prepared).read_text(encoding="utf-8")))
        except (
            OSError,
            ValueError,
            KeyError,
            TypeError,
            RecursionError,
        ):  # missing, or damaged: it is made anew
            return None

    def keep(self, prepared: Prepared, proof: Proof) -> None:
        """Write the proof; a folder that cannot be written is no reason to end a diagnosis."""
        kept = [f.name for f in dataclasses.fields(proof) if f.name not in _LEFT_OUT]
        content = {"about": self._about(proof), **{name: _plain(getattr(proof, name)) for name in kept}}
        with contextlib.suppress(ConfigError), self.whole_file(self._path(prepared)) as temporary:
            temporary.write_text(json.dumps(content), encoding="utf-8")

    def _about(self, proof: Proof) -> dict[str, Any]:
        """For readers that look on while a diagnosis runs."""
        told = proof.told.simulated
        return {
            "run": self.run,
            "effect": proof.candidate.effect.name,
            "at": proof.candidate.site.name,
            "rms": dict(told["validation" if "validation" in told else "estimation"].rms),
            "delta_bic": proof.delta_bic,
            "verdict": proof.verdict,
            "reason": proof.reason,
        }

    def step(self, name: str, parts: Sequence[Any], flat: Model, make: Callable[[], Step]) -> Step:
        """What `make` returns, or what it returned for the same run, `parts` and model in an earlier one. It
        is kept with the compiled libraries: what is read there is executed, which results of others must
        not be."""
        values = [(p.name, f"{p.value:.{DIGITS}g}") for p in flat.parameters]
        folder = cache_folder() / "diagnosis"
        file = folder / f"{_digest(self.run, name, *parts, values, *_equations(flat))}.pickle"
        content = kept_content(file)
        if content is not None:
            with contextlib.suppress(Exception):  # of other packages: it is made anew
                return unpacked(content)
        began = time.monotonic()
        made = make()
        if time.monotonic() - began > WORTH_KEEPING:
            with contextlib.suppress(DaestError, OSError):
                keep_content(file, packed(made))
                forget_unused(folder, MOST_STEPS)
        return made

    def _path(self, prepared: Prepared) -> Path:
        return self.folder / f"{_digest(self.run, *_model_parts(prepared))}.json"


def run_digest(
    flat: Model,
    experiments: Iterable[Experiment],
    validation: Iterable[Experiment],
    options: Sequence[Any],
) -> str:
    """Hash of the program, the model with all that it declares, the recordings and the options of a run.

    Where a declaration stands, and what it says in words, changes no result and is left out.
    """
    parts: list[Any] = [program(), *_equations(flat), *options]
    parts += [_declared(one) for group in _declarations(flat) for one in group]
    for one in (*experiments, None, *validation):
        if one is not None:
            columns = [one.time, one.inputs, one.outputs, *one.extra.values()]
            parts += [one.name, tuple(one.extra), *(np.ascontiguousarray(c).tobytes() for c in columns)]
        else:
            parts.append("validation")
    return _digest(*parts)


def _declarations(flat: Model) -> Iterator[Sequence[Any]]:
    """Variables, noises, parameters and outputs, and what happens at events."""
    yield from (flat.unknowns, flat.inputs, flat.noises, flat.parameters, flat.outputs)
    if flat.events is not None:
        for group in vars(flat.events).values():
            yield group if isinstance(group, tuple) else ()


def _declared(one: Any) -> Any:
    if not dataclasses.is_dataclass(one):
        return one
    fields = [f.name for f in dataclasses.fields(one) if f.name not in _WORDS]
    return type(one).__name__, *(getattr(one, name) for name in fields)


def _model_parts(prepared: Prepared) -> list[Any]:
    """What tells one refit of a run from another, rounds of `improve` included."""
    flat, trial = prepared.flat, prepared.trial
    values = [(p.name, f"{p.value:.{DIGITS}g}") for p in flat.parameters]
    labels = [trial.candidate.label, *(c.label for c in trial.alike)]
    return [prepared.names, labels, values, prepared.by_shooting, *_equations(flat)]


def _equations(flat: Model) -> list[Any]:
    if not isinstance(flat, FlatModel):
        return [e.text for e in flat.equations]
    symbols = [flat.derivatives, flat.xi, flat.u, flat.w, flat.theta, flat.time]
    results = [flat.residual, flat.output_expressions, flat.initial_residual]
    if flat.events is not None:
        expressions = {name: e for name, e in vars(flat.events).items() if isinstance(e, ca.SX)}
        symbols += [expressions.pop(name) for name in ("active", "ticks")]
        results += expressions.values()
    return [ca.Function("model", symbols, results).serialize()]


def _digest(*parts: Any) -> str:
    found = hashlib.sha256()
    for part in parts:
        content = part if isinstance(part, bytes) else repr(part).encode()
        found.update(f"{len(content)} ".encode())
        found.update(content)
    return found.hexdigest()[:32]


# Values and JSON --------------------------------------------------------------------------------------------


def _restored(prepared: Prepared, content: Mapping[str, Any]) -> Proof:
    hints = typing.get_type_hints(Proof)
    known = {name: _value(hints[name], content[name]) for name in hints if name not in _LEFT_OUT}
    flat = prepared.flat.with_theta(known["fit"].theta)
    if not {p.name for p in known["fit"].parameters} <= {p.name for p in flat.parameters}:
        raise ValueError("proof of the effect in another model, which the file does not hold")
    return Proof(candidate=prepared.trial.candidate, flat=flat, **known)


def _plain(value: Any) -> Any:
    """Nested dataclasses and arrays as JSON has them (NaN included)."""
    if dataclasses.is_dataclass(value):
        return {f.name: _plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, Mapping):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    return value.item() if isinstance(value, np.generic) else value


def _value(kind: Any, content: Any) -> Any:
    """The value of type `kind` that `_plain` wrote. Raises KeyError or TypeError for other content."""
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if content is None or kind is Any:
        return content
    if dataclasses.is_dataclass(kind):
        hints = typing.get_type_hints(kind)
        return typing.cast(Any, kind)(**{name: _value(hints[name], content[name]) for name in hints})
    if kind is np.ndarray:
        return np.array(content, dtype=float)
    if origin is tuple:
        return tuple(_value(arguments[0], entry) for entry in content)
    if origin is dict:
        return {key: _value(arguments[1], entry) for key, entry in content.items()}
    if origin in (typing.Union, types.UnionType):
        return _value(next(a for a in arguments if a is not type(None)), content)
    return content
