"""The text of a new daest.toml, with a comment on everything that may need a decision."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import PurePath

from daest.data.match import Match, is_called_time
from daest.data.table import is_time, split_header
from daest.model.flat import Model
from daest.model.parts import Parameter

_HEAD = """\
# What daest knows beside the model. Options on the command line come before what stands here.
# Paths count from the folder of this file; units are those of the model."""
_VALIDATING = {"test", "testing", "val", "valid", "validate", "validation", "holdout", "unseen"}


@dataclass(frozen=True)
class Draft:
    """What a new daest.toml is written from. `source` and `data` are paths relative to the file; `columns`
    are all columns of the recording. `split` is the share of the recordings that estimates; None where the
    last one validates as a whole."""

    flat: Model
    source: str
    class_name: str | None
    libraries: tuple[str, ...]
    data: tuple[str, ...]
    inputs: tuple[Match, ...]
    outputs: tuple[Match, ...]
    columns: tuple[str, ...]
    time: str | None = None  # column of the time, where none is called so
    units: Mapping[str, str] = field(default_factory=dict)  # of columns, from their names
    chosen: frozenset[str] = frozenset()  # parameters of which the file says more than the model
    proposed: tuple[str, ...] = ()  # parameters that are estimated because the model marks none
    split: float | None = 0.5
    clock: str = "s"  # in what the model counts time


def project_text(draft: Draft) -> str:
    """A complete daest.toml. What could not be matched stands there as a comment to be completed."""
    sections = [_HEAD, *_model(draft), *_data(draft), *_parameters(draft), *_noise(draft.flat)]
    return "\n".join(sections) + "\n"


def _model(draft: Draft) -> Iterator[str]:
    yield f"\n[model]\nsource = {_text(draft.source)}"
    if draft.class_name:
        yield f"class = {_text(draft.class_name)}"
    if draft.libraries:
        yield f"libraries = {_list(draft.libraries)}"


def _data(draft: Draft) -> Iterator[str]:
    yield "\n[data]"
    kept_back = _kept_back_by_name(draft.data)
    if kept_back:
        yield f"estimate = {_list([file for file in draft.data if file not in kept_back])}"
        yield f"validate = {_list(kept_back)}  # by their names: please check"
    elif draft.data and draft.split is None:
        yield f"estimate = {_list(draft.data[:-1])}"
        yield f"validate = {_list(draft.data[-1:])}  # whole: halves of a decay are not alike"
    elif draft.data:
        yield f"estimate = {_list(draft.data)}"
        part = "half" if draft.split == 0.5 else f"{draft.split:.0%}, since half is too short,"
        estimates = "estimates" if draft.split == 0.5 else "estimate"
        rest = f"the first {part} {estimates}, the rest validates"
        yield f'split = {draft.split:g}  # {rest}; or: validate = ["other.csv"]'
    else:
        yield '# estimate = ["run.csv"]\n# split = 0.5  # or: validate = ["other.csv"]'
    if draft.columns:
        yield f"# columns: {', '.join(draft.columns)}"
    if draft.time is not None:
        how = "name" if is_called_time(draft.time) else "values"
        yield f"time = {_text(draft.time)}  # found by its {how}: please check"
    elif draft.columns and not any(is_time(split_header(column)[0]) for column in draft.columns):
        yield '# time = "?"  # no column is called so'
    yield f"# from, to [{draft.clock}], resample [{draft.clock}], detrend (none, mean, linear)"
    yield "# hold (zoh, foh, smooth, zoh(NAME, ...)): inputs between their samples"
    yield from _mapping("inputs", draft.inputs)
    yield from _mapping("outputs", draft.outputs)
    if draft.units:
        yield "\n[data.units]  # column = unit, by names: please check"
        for column, unit in draft.units.items():
            yield f"{toml_key(column)} = {_text(unit)}"


def _kept_back_by_name(files: Sequence[str]) -> list[str]:
    """The recordings whose file names say that they are for validation (`run_test.csv`, `validation2.csv`);
    none where all do."""
    named = [file for file in files if _VALIDATING & set(re.findall(r"[a-z]+", PurePath(file).stem.lower()))]
    return named if len(named) < len(files) else []


def _mapping(kind: str, matches: Sequence[Match]) -> Iterator[str]:
    if not matches:
        return
    yield f"\n[data.{kind}]  # model name = column"
    for match in matches:
        unit = f"[{match.signal.unit}]" if match.signal.unit else ""
        if match.column is None:
            yield f'# {toml_key(match.signal.name)} = "?"  {f"# {unit}" if unit else ""}'.rstrip()
        else:
            doubt = "" if match.how == "name" else f" matched by {match.how}: please check"
            remark = f"{unit}{doubt}".strip()
            yield f"{toml_key(match.signal.name)} = {_text(match.column)}{f'  # {remark}' if remark else ''}"


def _parameters(draft: Draft) -> Iterator[str]:
    yield "\n[parameters]  # value; or estimate = true with start, min, max, scale (linear, log, auto)"
    if draft.proposed:
        yield "# The model marks none as unknown. Those with a unit of their own are proposed (all where none"
        yield "# has one), of such that no recording could tell apart the first: please check."
    for parameter in (p for p in draft.flat.parameters if not p.is_memory):
        shown = "" if parameter.estimate or parameter.name in draft.chosen else "# "
        remark = _remark(parameter.unit, parameter.description)
        yield f"{shown}{toml_key(parameter.name)} = {_setting(parameter)}{remark}"


def _setting(parameter: Parameter) -> str:
    if not parameter.estimate:
        return f"{{ value = {parameter.value:.12g} }}"
    parts = ["estimate = true", f"start = {parameter.value:.12g}"]
    if parameter.min is not None:
        parts.append(f"min = {parameter.min:.12g}")
    if parameter.max is not None:
        parts.append(f"max = {parameter.max:.12g}")
    parts.append(f'scale = "{parameter.scale}"')
    if parameter.prior is not None:
        parts.append(f"prior = {{ mean = {parameter.prior.mean:.12g}, std = {parameter.prior.std:.12g} }}")
    return f"{{ {', '.join(parts)} }}"


def _noise(flat: Model) -> Iterator[str]:
    yield "\n[noise.process]  # white noise: intensity = two-sided density, unit^2 s"
    for noise in flat.noises:
        if noise.intensity is None:
            key = toml_key(noise.name)
            yield f"# {key} = {{ intensity = 1e-6, estimate = true }}{_remark(noise.unit, '')}"
        else:
            body = f"intensity = {noise.intensity:.12g}, estimate = {str(noise.estimate).lower()}"
            yield f"{toml_key(noise.name)} = {{ {body} }}{_remark(noise.unit, noise.description)}"
    if not flat.noises:
        yield '# "component.flange.tau" = { intensity = 1e-6, estimate = true }'
    yield "\n[noise.measurement]  # std of one sample"
    for output in flat.outputs:
        std = "" if output.noise_std is None else f"std = {output.noise_std:.12g}, "
        estimate = f"estimate = {str(output.estimate_noise).lower()}"
        yield f"{toml_key(output.name)} = {{ {std}{estimate} }}{_remark(output.unit, '')}"


def _remark(unit: str, description: str) -> str:
    words = " ".join(part for part in (f"[{unit}]" if unit else "", " ".join(description.split())) if part)
    return f"  # {words}" if words else ""


def toml_key(name: str) -> str:
    """A name as a key of TOML: in quotes where it is no plain word.

    >>> toml_key("c"), toml_key("spring.c")
    ('c', '"spring.c"')
    """
    return name if name.isidentifier() and name.isascii() else _text(name)


def _text(value: str) -> str:
    # A JSON string is a TOML basic string.
    return json.dumps(value, ensure_ascii=False)


def _list(values: Sequence[str]) -> str:
    return f"[{', '.join(_text(value) for value in values)}]"
