"""daest.toml: what a project says about its model, its recordings, its parameters and its noise.

A text that is no TOML is told with what is wrong with it and how to mend it, not with what the parser says.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Literal

from daest.data.prepare import Preparation
from daest.data.table import raise_collected
from daest.errors import ConfigError, DaestError, Place
from daest.files import FOLDER, why_no_file
from daest.model.holds import Hold, is_hold
from daest.model.parts import Prior
from daest.near import nearest

FILE_NAME = "daest.toml"
Scale = Literal["auto", "linear", "log"]

# Section -> key -> what it says. In `parameters` and `noise` the keys are those of one entry.
KEYS: dict[str, dict[str, str]] = {
    "model": {
        "source": "the model, a `.mo` or `.bmo` file or an `.fmu`",
        "class": "its class, where the file holds several",
        "libraries": "folders of Modelica libraries, searched before MODELICAPATH",
    },
    "data": {
        "estimate": "recordings to identify from, each one an experiment",
        "validate": "recordings to judge by",
        "split": "instead of validate: the share of each recording that is identified from, the rest judges",
        "inputs": 'a table, model name = "column", or "-column" for the column with its sign turned',
        "outputs": "the same; only outputs named here are measured",
        "time": "column of the time, where it is not called `time`, `time_s`, `time_ms`, …",
        "units": 'a table, column = "unit", where a header names none',
        "from": "time in s from which a recording is used",
        "to": "time in s up to which it is used",
        "resample": "sampling period in s to resample to, behind a filter against aliasing",
        "detrend": '"none", "mean" or "linear": what is taken off every signal',
        "hold": '"zoh", "foh", "smooth" or "zoh(NAME, ...)": what inputs do between samples',
    },
    "parameters": {
        "estimate": "true or false",
        "start": "where the search for an estimated parameter starts",
        "value": "the value of a parameter that is not estimated",
        "min": "lower bound",
        "max": "upper bound",
        "scale": '"auto", "linear" or "log": in what the search moves',
        "prior": "`{ mean = .., std = .. }`: what is known beforehand",
    },
    "noise.process": {
        "intensity": "two-sided spectral density, unit² s",
        "estimate": "true or false",
    },
    "noise.measurement": {
        "std": "standard deviation of one sample",
        "estimate": "true or false",
    },
}


@dataclass(frozen=True)
class ParameterSetting:
    """The settings of one parameter in daest.toml. None: the model decides. `value` is the start value of an
    estimated parameter and the value of any other, in the unit of the model; `is_start`: it was given as
    where a search begins. A value that is given, and not as a start, holds the parameter unless
    `estimate = true` or a prior stands beside it."""

    estimate: bool | None = None
    value: float | None = None
    min: float | None = None
    max: float | None = None
    scale: Scale | None = None
    prior: Prior | None = None
    is_start: bool = False


@dataclass(frozen=True)
class NoiseSetting:
    """The settings of one noise in daest.toml. None: the model decides. `size` is the intensity (two-sided
    density, unit² s) of a process noise, or the standard deviation of one sample of a measurement."""

    size: float | None = None
    estimate: bool | None = None


@dataclass(frozen=True)
class Project:
    """A daest.toml. Paths are resolved against `folder`; `inputs` and `outputs` map model names to columns.
    `file` is None where no daest.toml exists and everything comes from the command line."""

    folder: Path
    file: Path | None = None
    source: Path | None = None
    class_name: str | None = None
    libraries: tuple[Path, ...] = ()
    estimate: tuple[Path, ...] = ()
    validate: tuple[Path, ...] = ()
    inputs: Mapping[str, str] = field(default_factory=dict)
    outputs: Mapping[str, str] = field(default_factory=dict)
    time: str | None = None  # column of the time, where it is not called so
    units: Mapping[str, str] = field(default_factory=dict)  # of columns whose header names none
    preparation: Preparation = field(default_factory=Preparation)
    hold: Hold | None = None
    parameters: Mapping[str, ParameterSetting] = field(default_factory=dict)
    process_noise: Mapping[str, NoiseSetting] = field(default_factory=dict)
    measurement_noise: Mapping[str, NoiseSetting] = field(default_factory=dict)

    @property
    def results(self) -> Path:
        """The folder of the results, beside daest.toml."""
        return self.folder / "results"


def load_project(path: Path | str | None = None) -> Project:
    """The project of `path` (a daest.toml or its folder), by default of the current folder, where it may be
    absent.

    Raises ConfigError with all problems of the file at once: `config-missing`, `config-syntax`,
    `config-unknown-key`, `config-type`, `config-value`.

        >>> daest.load_project().source is None
        True
    """
    file = Path(path) if path is not None else Path(FILE_NAME)
    if why_no_file(file) == FOLDER:
        file = file / FILE_NAME
    if (why := why_no_file(file)) is not None:
        if path is None and not os.path.lexists(file):
            return Project(Path())
        raise ConfigError(
            "config-missing",
            f"the project file {why}",
            where=Place(str(file)),
            remedy="write one with: daest init MODEL DATA",
        )
    text = _decoded(file)
    return _Reader(file, text).project(_parsed(file, text))


def _decoded(file: Path) -> str:
    try:
        return file.read_bytes().decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ConfigError(
            "config-syntax", "the file is not UTF-8 text", where=Place(str(file)), remedy="save it as UTF-8"
        ) from error


def _parsed(file: Path, text: str) -> dict[str, Any]:
    import tomllib  # which a command without daest.toml need not wait for

    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        found = fault(str(error), text)
        place = Place(str(file), found.line, found.column)
        raise ConfigError("config-syntax", found.what, where=place, remedy=found.remedy) from error
    except RecursionError as error:
        raise ConfigError(
            "config-syntax",
            "not valid TOML: brackets are nested too deeply",
            where=Place(str(file)),
            remedy="see https://toml.io for the syntax",
        ) from error


_PATHS = 'a list of paths, as in ["run1.csv"]'
_NUMBER = "a number"
_FLAG = "true or false"
_TEXT = "a text in quotes"


class _Reader:
    """Reads one file and collects its problems."""

    def __init__(self, file: Path, text: str) -> None:
        self.file = file
        self.lines = text.splitlines()
        self.problems: list[DaestError] = []

    def project(self, content: dict[str, Any]) -> Project:
        self._known(content, "", tuple(dict.fromkeys(name.partition(".")[0] for name in KEYS)))
        model = self._section(content, "model", tuple(KEYS["model"]))
        data = self._section(content, "data", tuple(KEYS["data"]))
        noise = self._section(content, "noise", ("process", "measurement"))
        folder = self.file.parent
        preparation = self._preparation(data)
        parameters = self._settings(content, "parameters", self._parameter)
        project = Project(
            folder=folder,
            file=self.file,
            source=self._path(model, "model", "source"),
            class_name=self._value(model, "model", "class", str, _TEXT),
            libraries=self._paths(model, "model", "libraries"),
            estimate=self._paths(data, "data", "estimate"),
            validate=self._paths(data, "data", "validate"),
            inputs=self._map(data, "inputs"),
            outputs=self._map(data, "outputs"),
            time=self._value(data, "data", "time", str, _TEXT),
            units=self._map(data, "units"),
            preparation=preparation,
            hold=self._hold(data),
            parameters=parameters,
            process_noise=self._settings(noise, "process", partial(self._noise, "intensity"), "noise."),
            measurement_noise=self._settings(noise, "measurement", partial(self._noise, "std"), "noise."),
        )
        if project.validate and preparation.split is not None:
            self._problem(
                "config-value", "both validate and split are given", "data", "split", "keep one of them"
            )
        raise_collected(self.problems, str(self.file))
        return project

    def _preparation(self, data: dict[str, Any]) -> Preparation:
        numbers = {key: self._number(data, "data", key) for key in ("from", "to", "resample", "split")}
        kind: Any = self._choice(data, "data", "detrend", ("none", "mean", "linear")) or "none"
        try:
            return Preparation(numbers["from"], numbers["to"], numbers["resample"], kind, numbers["split"])
        except ConfigError as error:
            key = error.code.removeprefix("option-")
            self.problems.append(
                ConfigError(error.code, error.what, where=self._place("data", key), remedy=error.remedy)
            )
            return Preparation()

    def _parameter(self, section: str, name: str, entry: dict[str, Any]) -> ParameterSetting:
        self._known(entry, f"{section}.{name}", tuple(KEYS["parameters"]))
        place = f"{section}.{name}"
        start, value = self._number(entry, place, "start"), self._number(entry, place, "value")
        if start is not None and value is not None:
            self._problem(
                "config-value", f"'{name}' has a start and a value", place, "value", "keep one of them"
            )
        estimate, prior = self._value(entry, place, "estimate", bool, _FLAG), self._prior(entry, place, name)
        is_held = estimate is None and value is not None and prior is None
        setting = ParameterSetting(
            estimate=False if is_held else estimate,
            value=start if start is not None else value,
            min=self._number(entry, place, "min"),
            max=self._number(entry, place, "max"),
            scale=self._choice(entry, place, "scale", ("auto", "linear", "log")),
            prior=prior,
            is_start=start is not None,
        )
        self._check_bounds(name, place, setting)
        return setting

    def _prior(self, entry: dict[str, Any], place: str, name: str) -> Prior | None:
        """`prior = { mean = .., std = .. }`."""
        given = entry.get("prior")
        if given is None:
            return None
        if not isinstance(given, dict):
            self._wrong_type(place, "prior", "a table, as in { mean = 1.0, std = 0.1 }")
            return None
        inner = f"{place}.prior"
        for key in given.keys() - {"mean", "std"}:
            what = f"'{key}' is not known in the prior of '{name}'"
            self._problem("config-unknown-key", what, place, "prior", "known are mean, std")
        mean, std = self._number(given, inner, "mean"), self._number(given, inner, "std")
        problem = None
        if mean is None or std is None:
            problem = f"the prior of '{name}' has no {'mean' if mean is None else 'std'}"
        elif not (math.isfinite(mean) and math.isfinite(std) and std > 0.0):
            problem = f"the prior of '{name}' needs a finite mean and a std above 0"
        if problem is not None:
            self._problem("config-value", problem, place, "prior", "as in prior = { mean = 1.0, std = 0.1 }")
            return None
        assert mean is not None and std is not None
        return Prior(mean, std)

    def _check_bounds(self, name: str, place: str, setting: ParameterSetting) -> None:
        low = -math.inf if setting.min is None else setting.min
        high = math.inf if setting.max is None else setting.max
        if low >= high:
            self._problem(
                "config-value", f"'{name}' has min {low:g} not below max {high:g}", place, "min", "swap them"
            )
        elif setting.value is not None and not low <= setting.value <= high:
            what = f"the start {setting.value:g} of '{name}' lies outside its bounds {low:g} to {high:g}"
            self._problem("config-value", what, place, "start", "move the start or the bound")

    def _noise(self, size: str, section: str, name: str, entry: dict[str, Any]) -> NoiseSetting:
        place = f"{section}.{name}"
        self._known(entry, place, tuple(KEYS[section]))
        number = self._number(entry, place, size)
        if number is not None and number < 0:
            self._problem(
                "config-value", f"the {size} of '{name}' is negative", place, size, "give 0 or more"
            )
        return NoiseSetting(number, self._value(entry, place, "estimate", bool, _FLAG))

    def _settings(self, parent: dict[str, Any], key: str, read: Any, prefix: str = "") -> dict[str, Any]:
        table = parent.get(key, {})
        if not isinstance(table, dict):
            self._wrong_type(prefix.rstrip("."), key, "a section")
            return {}
        found = {}
        for name, entry in _flattened(table, _is_part_of_a_name):
            if isinstance(entry, dict):
                found[name] = read(f"{prefix}{key}", name, entry)
            else:
                self._wrong_type(f"{prefix}{key}", name, "a table, as in { value = 1.0 }")
        return found

    def _section(self, content: dict[str, Any], name: str, keys: tuple[str, ...]) -> dict[str, Any]:
        section = content.get(name, {})
        if not isinstance(section, dict):
            self._wrong_type("", name, "a section")
            return {}
        self._known(section, name, keys)
        return section

    def _known(self, entries: dict[str, Any], section: str, keys: tuple[str, ...]) -> None:
        for key in entries:
            if key not in keys:
                where = f" in [{section}]" if section else ""
                remedy = nearest(key, keys) or f"known are {', '.join(keys)}"
                self._problem("config-unknown-key", f"'{key}' is not known{where}", section, key, remedy)

    def _value(self, entries: dict[str, Any], section: str, key: str, kind: type, wanted: str) -> Any:
        value = entries.get(key)
        if value is None or isinstance(value, kind):
            return value
        self._wrong_type(section, key, wanted)
        return None

    def _number(self, entries: dict[str, Any], section: str, key: str) -> float | None:
        value = entries.get(key)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, int | float) or math.isnan(value):
            self._wrong_type(section, key, _NUMBER)
            return None
        return float(value)

    def _choice(self, entries: dict[str, Any], section: str, key: str, choices: tuple[str, ...]) -> Any:
        value = entries.get(key)
        if value is None or value in choices:
            return value
        self._wrong_type(section, key, "one of " + ", ".join(f'"{choice}"' for choice in choices))
        return None

    def _hold(self, data: dict[str, Any]) -> Hold | None:
        value = data.get("hold")
        if value is None or (isinstance(value, str) and is_hold(value)):
            return value
        self._wrong_type("data", "hold", 'one of "zoh", "foh", "smooth", "zoh(NAME, ...)"')
        return None

    def _path(self, entries: dict[str, Any], section: str, key: str) -> Path | None:
        value = self._value(entries, section, key, str, _TEXT)
        return None if value is None else self.file.parent / value

    def _paths(self, entries: dict[str, Any], section: str, key: str) -> tuple[Path, ...]:
        value = entries.get(key, [])
        listed = [value] if isinstance(value, str) else value
        if not isinstance(listed, list) or not all(isinstance(item, str) for item in listed):
            self._wrong_type(section, key, _PATHS)
            return ()
        return tuple(self.file.parent / item for item in listed)

    def _map(self, data: dict[str, Any], key: str) -> dict[str, str]:
        table = data.get(key, {})
        pairs = (
            dict(_flattened(table, lambda entry: isinstance(entry, dict)))
            if isinstance(table, dict)
            else None
        )
        if pairs is None or not all(isinstance(column, str) for column in pairs.values()):
            self._wrong_type("data", key, 'model names and columns, as in { u = "voltage" }')
            return {}
        return pairs

    def _wrong_type(self, section: str, key: str, wanted: str) -> None:
        where = f" in [{section}]" if section else ""
        self._problem("config-type", f"'{key}'{where} is not {wanted}", section, key, f"give {wanted}")

    def _problem(self, code: str, what: str, section: str, key: str, remedy: str) -> None:
        self.problems.append(ConfigError(code, what, where=self._place(section, key), remedy=remedy))

    def _place(self, section: str, key: str) -> Place:
        return Place(str(self.file), _line_of(self.lines, section, key))


def _flattened(
    table: dict[str, Any], is_part: Callable[[Any], bool], prefix: str = ""
) -> Iterator[tuple[str, Any]]:
    """Pairs of dotted name and entry: an unquoted `spring.c = {...}` nests in TOML and means the quoted
    name. `is_part` tells the tables that are a part of a name from entries."""
    for key, entry in table.items():
        if is_part(entry):
            yield from _flattened(entry, is_part, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", entry


def _is_part_of_a_name(entry: Any) -> bool:
    """A table of tables, unless it is the setting `{ prior = { mean = .., std = .. } }`."""
    if not isinstance(entry, dict) or not entry or not all(isinstance(v, dict) for v in entry.values()):
        return False
    return set(entry) != {"prior"} or any(isinstance(v, dict) for v in entry["prior"].values())


def _line_of(lines: list[str], section: str, key: str) -> int | None:
    """The line where `key` of `section` is written, else the line of the section, else None.

    tomllib tells no positions; this looks for the words and may miss unusual spellings, in which case the
    message goes without a line.
    """
    parts = section.split(".", 1)
    current, section_line = "", None
    for number, line in enumerate(lines, start=1):
        header = re.match(r"\s*\[\s*([^\]]*?)\s*\]", line)
        if header:
            current = header[1].replace('"', "")
            if current in (section, key, f"{section}.{key}".strip(".")):
                section_line = section_line or number
            continue
        assigned = re.match(r"\s*([^=]+?)\s*=", line)
        name = assigned[1].replace('"', "") if assigned else ""
        full = f"{current}.{name}".strip(".")
        if full == f"{section}.{key}".strip(".") or (
            full == section and re.search(rf"\b{re.escape(key)}\b", line)
        ):
            return number
        if full == section and len(parts) > 1:
            section_line = section_line or number
    return section_line


_AT = re.compile(r" \(at (?:line (?P<line>\d+), column (?P<column>\d+)|end of document)\)$")
_ASSIGNED = re.compile(r"^\s*(?P<key>[^=#]+?)\s*=\s*(?P<value>[^#]*?)\s*(?:#.*)?$")
_COMMA = re.compile(r"=\s*-?\d+,\d+\s*(?:#|$)")
_FLAGS = {"yes": "true", "no": "false", "on": "true", "off": "false", "True": "true", "False": "false"}


@dataclass(frozen=True)
class Fault:
    """What is wrong, how to mend it, and where: line and column count from 1, None where the text ends."""

    what: str
    remedy: str
    line: int | None
    column: int | None


def fault(message: str, text: str) -> Fault:
    """The fault behind `message`, which tomllib raised for `text`."""
    at = _AT.search(message)
    said = _AT.sub("", message)
    lines = text.splitlines()
    line = int(at["line"]) if at is not None and at["line"] else None
    column = int(at["column"]) if at is not None and at["column"] else None
    line = line or len(lines) or None
    shown = lines[line - 1] if line is not None and line <= len(lines) else ""
    what, remedy = _of_line(said, shown) or _of_message(said)
    return Fault(what, remedy, line, column)


def _of_line(said: str, shown: str) -> tuple[str, str] | None:
    """The usual slips, which the line itself tells better than the parser."""
    assigned = _ASSIGNED.match(shown)
    if said.startswith("Unescaped") or ("\\" in shown and "hex" in said):
        return (
            "a backslash in a text has a meaning of its own",
            'write paths with /, as in "data/run1.csv", or in single quotes',
        )
    if _COMMA.search(shown):
        return "a number has a comma", "write a point: 1.5"
    if assigned is None:
        return None
    key, value = assigned["key"], assigned["value"]
    if not value:
        return f"'{key}' has no value", f"write one behind the =, or put # before {key}"
    if value in _FLAGS:
        return f"'{value}' is no value", f"write {key} = {_FLAGS[value]}"
    if said == "Invalid value" and re.match(r"[A-Za-z_./~]", value):
        return f"the text {value} has no quotes", f'write {key} = "{value}"'
    return None


_QUOTES = "a text or a name with a dot, a space or a sign stands in quotes"
_FAULTS = (
    ("Expected '=' after a key", "a name has no value", f"write NAME = VALUE; {_QUOTES}"),
    ("Invalid value", "this is no value", 'values are 1.5, "text", true, false, ["list"] or { name = 1.5 }'),
    ("Invalid statement", "this is neither [section] nor NAME = VALUE", "put # before a remark"),
    ("Invalid initial character", "this is no name", f"write NAME = VALUE; {_QUOTES}"),
    ("Cannot overwrite", "a name stands here that has a value already", "keep one of the two"),
    ("Duplicate inline", "a name stands twice in { }", "keep one of the two"),
    ("Cannot redefine|Cannot mutate", "a name stands here that has a value already", "keep one of the two"),
    ("Cannot declare", "a section stands twice", "move the lines of the second into the first"),
    ("Unclosed array", "a list is not closed", "write commas between its elements and ] behind the last"),
    ("Unclosed inline", "a { is not closed on its line", "write it on one line, with } at its end"),
    ("Unterminated|Expected \"'\"|character '.n'", "a text is not closed", "write its quote at its end, too"),
    ("character", "a character stands here that no text may hold", "remove it, and type the line again"),
    ("Expected newline", "something stands behind a value", f"write one NAME = VALUE a line; {_QUOTES}"),
    ("Expected '\\]", "the name of a section is not closed", f"write [section]; {_QUOTES}"),
    ("date", "this is no date", "write dates in quotes"),
)


def _of_message(said: str) -> tuple[str, str]:
    for pattern, what, remedy in _FAULTS:
        if re.search(pattern, said):
            return what, remedy
    return f"not valid TOML: {said}", "see https://toml.io for the syntax"
