"""A linear estimator as C99: sizes, matrices as functions of the parameters, names and the start, beside the
fixed program of `fmu/estimator/`.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import casadi as ca
import numpy as np

from daest.errors import EstimationError, FmuError
from daest.model.flat import FlatModel
from daest.model.linear import StateSpaceFamily

FIXED = ("estimator.h", "estimator.c", "main.c")
_MATRICES = ("A", "B", "G", "b", "C", "D", "H", "d")
_HELPER = re.compile(r"^casadi_real casadi_\w+\([^\n]*\{(?:[^\n]*\}\n|.*?^\}\n)", re.S | re.M)
_HEAD = re.compile(r"static int casadi_f0\((.*?)\) ?\{", re.S)


@dataclass(frozen=True)
class EstimatorStart:
    """The first state: mean (n,), cov (n, n), sensitivity (n, q) to the unknown part, of which the outputs
    determine the first `n_known`; `log_density` of the flat prior, `scale` (n,): the size of each state."""

    mean: np.ndarray
    cov: np.ndarray
    sensitivity: np.ndarray
    n_known: int
    log_density: float
    scale: np.ndarray


@dataclass(frozen=True)
class EstimatorModel:
    """What a linear estimator is made of. `values` are the internal variables that it tells; `intensity`
    (n_w,) and `std` (n_y,) the noise levels, `period` [s] the expected step; `held`: white noise reaches an
    output."""

    name: str
    family: StateSpaceFamily
    theta: np.ndarray
    intensity: np.ndarray
    std: np.ndarray
    period: float
    hold: str
    held: bool
    values: tuple[str, ...]
    start: EstimatorStart

    @property
    def inputs(self) -> tuple[str, ...]:
        return tuple(v.name for v in self.family.inputs)

    @property
    def outputs(self) -> tuple[str, ...]:
        return tuple(y.name for y in self.family.outputs)

    @property
    def noises(self) -> tuple[str, ...]:
        return tuple(w.name for w in self.family.noises)

    @property
    def parameters(self) -> tuple[str, ...]:
        return tuple(p.name for p in self.family.parameters)

    @property
    def is_tunable(self) -> bool:
        """Whether the matrices are computed from the parameters, or are numbers."""
        return bool(self.family.matrices.is_a("SXFunction"))

    @property
    def sizes(self) -> dict[str, int]:
        n_u, n_q = len(self.inputs), self.start.sensitivity.shape[1]
        return {
            "EST_NX": len(self.family.state_names),
            "EST_NU": n_u,
            "EST_NUB": n_u + len(self.family.input_derivatives),
            "EST_NW": len(self.noises),
            "EST_NY": len(self.outputs),
            "EST_NV": len(self.values),
            "EST_NQ": n_q,
            "EST_NP": self.start.n_known,
            "EST_NTHETA": len(self.parameters) if self.is_tunable else 0,
            "EST_FOH": int(self.hold == "foh"),
            "EST_HELD": int(self.held),
        }


def refuse_given(flat: FlatModel) -> None:
    """Raises FmuError `fmu-no-equations` for a model without equations."""
    if flat.given is not None:
        raise FmuError(
            "fmu-no-equations",
            "an estimator can be exported from a model with equations alone",
            where=flat.name,
            remedy="use the Modelica source, or an FMU of daest export",
        )


def all_values(family: StateSpaceFamily) -> tuple[str, ...]:
    """Internal variables, then the outputs that are none of them."""
    names = tuple(v.name for v in family.unknowns)
    return names + tuple(y.name for y in family.outputs if y.name not in names)


def chosen_values(family: StateSpaceFamily, only: Sequence[str]) -> tuple[str, ...]:
    """The variables `only`, all of them without any. Raises EstimationError `filter-unknown-variable`."""
    known = all_values(family)
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
    """Name -> text of the C files."""
    room = files("daest.fmu").joinpath("estimator")
    fixed = {name: room.joinpath(name).read_text(encoding="utf-8") for name in FIXED}
    return {**fixed, "estimator_sizes.h": _sizes(model, is_float), "estimator_model.c": _model(model)}


def _sizes(model: EstimatorModel, is_float: bool) -> str:
    lines = [f"/* Sizes of the estimator of {_comment(model.name)}. */", "#ifndef ESTIMATOR_SIZES_H"]
    lines += ["#define ESTIMATOR_SIZES_H", *(["#define ESTIMATOR_FLOAT"] if is_float else [])]
    lines += [f"#define {name} {value}" for name, value in model.sizes.items()]
    sources = [str(source) for source, _ in model.family.input_derivatives] or ["0"]
    lines += [f"#define EST_SLOPES {{{', '.join(sources)}}}", "#endif"]
    return "\n".join(lines) + "\n"


def _model(model: EstimatorModel) -> str:
    start = model.start
    parts = [
        f"/* The model {_comment(model.name)}, generated by daest: names, start values, matrices. */",
        '#include "estimator.h"\n\n#include <string.h>',
        _names("inputs", model.inputs),
        _names("outputs", model.outputs),
        _names("values", model.values),
        _names("noises", model.noises),
        _names("parameters", model.parameters if model.is_tunable else ()),
        "extern const est_real estimator_scale[];",
        _numbers("const est_real estimator_scale", start.scale),
        *(
            _numbers(f"static const est_real START_{name}", values)
            for name, values in (
                ("THETA", model.theta if model.is_tunable else np.zeros(0)),
                ("INTENSITY", model.intensity),
                ("STD", model.std),
                ("MEAN", start.mean),
                ("COV", start.cov.ravel()),
                ("SENS", start.sensitivity.ravel()),
            )
        ),
        _matrices(model),
        _STARTED.format(
            period=repr(float(model.period)),
            n_known=start.n_known,
            n_open=start.sensitivity.shape[1] - start.n_known,
            log_density=repr(float(start.log_density)),
        ),
    ]
    return "\n".join(parts)


_STARTED = """
void estimator_start(Estimator *e) {{
    memcpy(e->theta, START_THETA, sizeof e->theta);
    memcpy(e->intensity, START_INTENSITY, sizeof e->intensity);
    memcpy(e->noise_std, START_STD, sizeof e->noise_std);
    memcpy(e->mean, START_MEAN, sizeof e->mean);
    memcpy(e->cov, START_COV, sizeof e->cov);
    memcpy(e->sens, START_SENS, sizeof e->sens);
    e->period = (est_real){period};
    e->n_known = {n_known};
    e->n_open = {n_open};
    e->log_density = (est_real){log_density};
}}
"""


def _matrices(model: EstimatorModel) -> str:
    """`estimator_matrices`: computed from the parameters, or numbers."""
    function = _matrix_function(model)
    names = (*_MATRICES, "V")
    if not model.is_tunable:
        values = [np.array(value).ravel() for value in function.call([model.theta])]
        arrays = [_numbers(f"static const est_real FIXED_{n}", v) for n, v in zip(names, values, strict=True)]
        copies = [f"    memcpy(m->{n}, FIXED_{n}, sizeof m->{n});" for n in names]
        head = "int estimator_matrices(const est_real *theta, EstMatrices *m) {\n    (void)theta;"
        return "\n".join([*arrays, head, *copies, "    return EST_OK;", "}"])
    results = ", ".join(f"m->{name}" for name in names)
    return f"""{_generated(function)}
int estimator_matrices(const est_real *theta, EstMatrices *m) {{
    const est_real *arg[1];
    est_real *res[{len(names)}] = {{{results}}};
    arg[0] = theta;
    return casadi_f0(arg, res) ? EST_NOT_FINITE : EST_OK;
}}"""


def _matrix_function(model: EstimatorModel) -> ca.Function:
    """theta -> the matrices row by row, V last; of the chosen variables."""
    family = model.family
    kind: Any = ca.SX if model.is_tunable else ca.MX
    theta = kind.sym("theta", family.matrices.numel_in(0))
    A, B, G, b, C, D, H, d, X, U, W, x0 = family.matrices.call([theta], True, False)
    unknowns = [v.name for v in family.unknowns]
    rows = []
    for name in model.values:
        if name in unknowns:
            i = unknowns.index(name)
            rows.append(ca.horzcat(X[i, :], W[i, :], U[i, :], x0[i]))
        else:
            i = model.outputs.index(name)
            rows.append(ca.horzcat(C[i, :], H[i, :], D[i, :], d[i]))
    V = ca.vertcat(*rows)
    flat = [ca.densify(ca.vec(ca.densify(m).T)) for m in (A, B, G, b, C, D, H, d, V)]
    return ca.Function("matrices", [theta], flat)


def _generated(function: ca.Function) -> str:
    """The body of a scalar function as C, with the helpers that it calls; nothing else of what CasADi writes,
    most of which nobody calls."""
    generator = ca.CodeGenerator("model", {"with_header": False})
    generator.add(function)
    text = generator.dump()
    helpers = _HELPER.findall(text)
    body = text[text.index("static int casadi_f0(") : text.index("CASADI_SYMBOL_EXPORT int matrices(")]
    body = _HEAD.sub("static int casadi_f0(const est_real **arg, est_real **res) {", body)
    shared = [re.sub("^casadi_real", "static casadi_real", one) for one in helpers]
    return "\n".join(["#include <math.h>", "#define casadi_real est_real", *shared, body])


def _names(kind: str, names: Sequence[str]) -> str:
    entries = ", ".join([*(_text(name) for name in names), "0"])
    return f"const char *const estimator_{kind}[] = {{{entries}}};"


def _numbers(declared: str, values: np.ndarray) -> str:
    """A constant array, with one entry where there is none."""
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
