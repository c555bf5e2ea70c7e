"""An estimator as C99: sizes, functions of the model, names and the start, beside the fixed program of
`fmu/estimator/`. `estimator_linear` and `estimator_nonlinear` write what differs.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import casadi as ca
import numpy as np

from daest.errors import EstimationError
from daest.model.flat import FlatModel
from daest.model.holds import ZOH, held_inputs

_EXPORTED = re.compile(r"^CASADI_SYMBOL_EXPORT (?:[^\n]*\}\n|.*?^\}\n)", re.S | re.M)
_NAMED = re.compile(
    r"^CASADI_SYMBOL_EXPORT int (\w+)\(const casadi_real\*\*.*?\n  return (casadi_f\d+)\(", re.M
)
_DEFINED = re.compile(r"^static [^\n(\[]*\b(casadi_\w+)(?:\[[^\n]*;\n|\([^\n]*\}\n|\(.*?^\}\n)", re.S | re.M)
_INNER = re.compile(r"^(static int casadi_f\d+\([^)]*\)) \{", re.M)
_HELPER = re.compile(r"^(?=(?:casadi_real|casadi_int|void|int) casadi_\w+\()", re.M)
_CONSTANT = re.compile(
    r"""/\*.*?\*/|"(?:\\.|[^"\\\n])*"|\bR_\([^()]*\)"""
    r"""|(?<![\w.])((?:\d+\.\d*|\.\d+)(?:[eE][-+]?\d+)?|\d+[eE][-+]?\d+)(?![\w.])""",
    re.S,
)
_PROLOGUE_ENDS = "#define CASADI_SYMBOL_EXPORT\n  #endif\n#endif\n"


class EstimatorForm(Protocol):
    """What kinds of estimators do not share. `word` names the filter; `is_tunable`: parameters can change."""

    @property
    def word(self) -> str: ...

    @property
    def is_tunable(self) -> bool: ...

    @property
    def sizes(self) -> dict[str, int]:
        """Compile-time constants besides those of `EstimatorModel.sizes`."""

    @property
    def constants(self) -> dict[str, str]:
        """More of them, as C expressions."""

    def program(self) -> dict[str, str]:
        """Name -> text of the fixed files."""

    def functions(self, model: EstimatorModel) -> str:
        """C text of the functions of the model, and of `estimator_start`."""

    def cost(self, model: EstimatorModel) -> dict[str, int]:
        """`memory` of an instance and `stack`, in numbers, `operations` a sample and, where a new step
        length costs more, `resampling`: how many."""


@dataclass(frozen=True)
class EstimatorModel:
    """What an estimator is made of. `values` are the internal variables that it tells; `intensity` (n_w,) and
    `std` (n_y,) the noise levels, `period` [s] the expected step, `scale` (n,) the size of each state."""

    flat: FlatModel
    state_names: tuple[str, ...]
    state_units: tuple[str, ...]
    slopes: tuple[int, ...]
    theta: np.ndarray
    intensity: np.ndarray
    std: np.ndarray
    scale: np.ndarray
    period: float
    hold: str
    values: tuple[str, ...]
    form: EstimatorForm

    @property
    def name(self) -> str:
        return self.flat.name

    @property
    def inputs(self) -> tuple[str, ...]:
        return self.flat.input_names

    @property
    def outputs(self) -> tuple[str, ...]:
        return self.flat.output_names

    @property
    def noises(self) -> tuple[str, ...]:
        return self.flat.noise_names

    @property
    def parameters(self) -> tuple[str, ...]:
        return self.flat.parameter_names

    @property
    def is_tunable(self) -> bool:
        """Whether the parameters can be changed while it runs."""
        return self.form.is_tunable

    @property
    def sizes(self) -> dict[str, int]:
        return {
            "EST_NX": len(self.state_names),
            "EST_NU": len(self.inputs),
            "EST_NUB": len(self.inputs) + len(self.slopes),
            "EST_NW": len(self.noises),
            "EST_NY": len(self.outputs),
            "EST_NV": len(self.values),
            "EST_NTHETA": len(self.parameters) if self.is_tunable else 0,
            "EST_FOH": int(self.hold != ZOH),
            **self.form.sizes,
        }


def all_values(flat: FlatModel) -> tuple[str, ...]:
    """Internal variables, then the outputs that are none of them."""
    names = flat.unknown_names
    return names + tuple(y.name for y in flat.outputs if y.name not in names)


def chosen_values(flat: FlatModel, only: Sequence[str]) -> tuple[str, ...]:
    """The variables `only`, all of them without any. Raises EstimationError `filter-unknown-variable`."""
    known = all_values(flat)
    for name in only:
        if name not in known:
            raise EstimationError(
                "filter-unknown-variable",
                f"the model has no variable {name}",
                where=name,
                remedy=f"it has {', '.join(known[:8])}",
            )
    return tuple(dict.fromkeys(only)) or known


def estimator_files(model: EstimatorModel, *, is_float: bool = False) -> dict[str, str]:
    """Name -> text of the C files. In single precision every constant of the estimator is single, too: a
    double one would draw the arithmetic around it into double precision, which small controllers only
    emulate. The program that replays a file stays in double precision."""
    found = {
        **model.form.program(),
        "estimator_sizes.h": _sizes(model, is_float),
        "estimator_model.c": _model(model),
    }
    if not is_float:
        return found
    return {name: text if name == "main.c" else _in_single_precision(text) for name, text in found.items()}


def _in_single_precision(text: str) -> str:
    """The C text with the suffix f at every floating constant that has none; comments, strings and what the
    macro R_ suffixes stay as they are."""
    return _CONSTANT.sub(lambda found: found[0] if found[1] is None else f"{found[1]}f", text)


def _sizes(model: EstimatorModel, is_float: bool) -> str:
    lines = [f"/* Sizes of the estimator of {_comment(model.name)}. */", "#ifndef ESTIMATOR_SIZES_H"]
    lines += ["#define ESTIMATOR_SIZES_H", *(["#define ESTIMATOR_FLOAT"] if is_float else [])]
    lines += [f"#define {name} {value}" for name, value in (model.sizes | model.form.constants).items()]
    sources = [str(source) for source in model.slopes] or ["0"]
    lines.append(f"#define EST_SLOPES {{{', '.join(sources)}}}")
    kept = [str(int(is_held)) for is_held in held_inputs(model.hold, model.inputs)] or ["0"]
    lines += [f"#define EST_KEPT {{{', '.join(kept)}}}", "#endif"]
    return "\n".join(lines) + "\n"


def _model(model: EstimatorModel) -> str:
    parts = [
        f"/* The model {_comment(model.name)}, generated by daest: names, start values, functions. */",
        '#include "estimator.h"\n\n#include <string.h>',
        _names("inputs", model.inputs),
        _names("outputs", model.outputs),
        _names("values", model.values),
        _names("noises", model.noises),
        _names("parameters", model.parameters if model.is_tunable else ()),
        "extern const est_real estimator_scale[];",
        numbers("const est_real estimator_scale", model.scale),
        numbers("static const est_real START_THETA", model.theta if model.is_tunable else np.zeros(0)),
        numbers("static const est_real START_INTENSITY", model.intensity),
        numbers("static const est_real START_STD", model.std),
        model.form.functions(model),
    ]
    return "\n".join(parts)


def starting(model: EstimatorModel, lines: Sequence[str]) -> str:
    """`estimator_start`, with `lines` for the first state."""
    shared = [
        "memcpy(e->theta, START_THETA, sizeof e->theta);",
        "memcpy(e->intensity, START_INTENSITY, sizeof e->intensity);",
        "memcpy(e->noise_std, START_STD, sizeof e->noise_std);",
        "memcpy(e->mean, START_MEAN, sizeof e->mean);",
        "memcpy(e->cov, START_COV, sizeof e->cov);",
        f"e->period = (est_real){float(model.period)!r};",
    ]
    body = "".join(f"    {line}\n" for line in (*shared, *lines))
    return f"\nvoid estimator_start(Estimator *e) {{\n{body}}}\n"


def generated(functions: Sequence[ca.Function]) -> str:
    """The functions as C under their own names, with the helpers that they call; nothing else of what CasADi
    writes, most of which nobody calls."""
    generator = ca.CodeGenerator("model", {"with_header": False})
    for function in functions:
        generator.add(function)
    text = generator.dump()
    text = text[text.index(_PROLOGUE_ENDS) + len(_PROLOGUE_ENDS) :]
    arguments = "(const est_real **arg, est_real **res, casadi_int *iw, est_real *w, int mem)"
    named = [
        f"int {name}{arguments};\nint {name}{arguments} {{\n  return {inner}(arg, res, iw, w, mem);\n}}"
        for name, inner in _NAMED.findall(text)
    ]
    body = _HELPER.sub("static ", _EXPORTED.sub("", text))
    body = _INNER.sub(r"\1 {\n  (void)arg, (void)res, (void)iw, (void)w, (void)mem;", body)
    body = _without_unused("\n".join([body, *named]))
    math = "#ifdef ESTIMATOR_FLOAT\n#include <tgmath.h>\n#else\n#include <math.h>\n#endif"
    return "\n".join([math, "#define casadi_real est_real", _INTEGER, _LOCAL_POINTERS, body])


def _without_unused(text: str) -> str:
    """Without static definitions whose names occur nowhere else."""
    while True:
        used = Counter(re.findall(r"casadi_\w+", text))
        unused = [found[0] for found in _DEFINED.finditer(text) if used[found[1]] == 1]
        if not unused:
            return text
        for definition in unused:
            text = text.replace(definition, "")


# CasADi leaves pointers to local numbers in the list of arguments that it was given, where nobody reads them.
_LOCAL_POINTERS = """#if defined(__GNUC__) && !defined(__clang__) && __GNUC__ >= 12
#pragma GCC diagnostic ignored "-Wdangling-pointer"
#endif"""
_INTEGER = "#ifndef casadi_int\n#define casadi_int long long int\n#endif"


def _names(kind: str, names: Sequence[str]) -> str:
    entries = ", ".join([*(_text(name) for name in names), "0"])
    return f"const char *const estimator_{kind}[] = {{{entries}}};"


def numbers(declared: str, values: np.ndarray) -> str:
    """A constant array, with one entry where there is none. An array of any shape, row by row."""
    entries = [repr(float(v)) for v in np.asarray(values).ravel()] or ["0"]
    return f"{declared}[{len(entries)}] = {{{', '.join(entries)}}};"


def _text(name: str) -> str:
    escaped = name.replace("\\", "\\\\").replace('"', '\\"').replace("?", "\\?")
    return (
        '"'
        + "".join(c if 32 <= ord(c) < 127 else "".join(f"\\{b:03o}" for b in c.encode()) for c in escaped)
        + '"'
    )


def _comment(name: str) -> str:
    return name.replace("*/", "* /")
