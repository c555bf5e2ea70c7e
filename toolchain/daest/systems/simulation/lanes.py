"""The compiled loop of the particle filter, `numerics/particles.c`: several particles at once, one in each
lane of a vector."""

from __future__ import annotations

import ctypes
import functools
from typing import Any

import casadi as ca

from daest.numerics.compiler import effort, loaded, processor_flags, text_of
from daest.numerics.generated import generated
from daest.systems.simulation.lane_code import lane_function
from daest.systems.simulation.local_linear import LocalModel, slope_pattern

MOST_STATES = 20  # of a model whose matrices, with lanes, stay in the caches and on the stack of a thread
# LEFT_OUT: ten digits of means and covariances are far more than a path of random numbers can tell.
_LANES_OF_SUBSTEP = """
#define real lanes_t
#define scalar double
#define LARGEST(v) lanes_largest(v)
#define IS_FINITE(v) lanes_finite(v)
#define MAGNITUDE(v) lanes_fabs(v)
#define GREATER(a, b) lanes_fmax(a, b)
#define ROOT(v) lanes_sqrt(v)
#define LEFT_OUT 1e-10
#include <stdlib.h>
"""


def lane_library(model: LocalModel) -> ctypes.CDLL | None:
    """The loop for this model; None where it has invariants or events, too many states, or is interpreted."""
    if model.library is None or model.hold is not None or model.n_states > MOST_STATES:
        return None
    return _load(_source(model))


def _source(model: LocalModel) -> str:
    flow, point_flow = model.flow, _without_spread(model.flow)
    look = _of_outputs("daest_look", model.see)
    sizes = {"NX": model.n_states, "NU": flow.numel_in(1), "NW": model.n_noises, "NY": model.n_outputs}
    header = "".join(f"#define {name} {value}\n" for name, value in sizes.items())
    header += f"#define SLOPES {slope_pattern(model)}\n"
    functions = [
        lane_function("model_flow", flow, (0, 5)),
        lane_function("model_point_flow", point_flow, (0,)),
        lane_function("model_see", model.see, (0,)),
        lane_function("model_look", look, (0,)),
    ]
    own = generated((flow, point_flow, model.see, look))
    texts = [own, header, text_of("lanes.c"), *functions, _LANES_OF_SUBSTEP]
    return "".join([*texts, text_of("substep.c"), text_of("particles.c")])


def _without_spread(flow: ca.Function) -> ca.Function:
    """The flow at a point: its last argument, the covariance, is zero."""
    kind: Any = ca.SX if flow.is_a("SXFunction") else ca.MX
    given = [kind.sym(f"a{i}", *flow.size_in(i)) for i in range(flow.n_in() - 1)]
    results = flow.call([*given, kind.zeros(*flow.size_in(flow.n_in() - 1))], True, False)
    return ca.Function("daest_point_flow", given, [ca.densify(r) for r in results])


def _of_outputs(name: str, see: ca.Function) -> ca.Function:
    """The outputs alone, without their slopes."""
    kind: Any = ca.SX if see.is_a("SXFunction") else ca.MX
    given = [kind.sym(f"a{i}", *see.size_in(i)) for i in range(see.n_in())]
    return ca.Function(name, given, [ca.densify(see.call(given, True, False)[0])])


@functools.lru_cache(maxsize=64)
def _load(source: str) -> ctypes.CDLL | None:
    # A square root that need not tell errors is one instruction for all lanes.
    flags = (effort(source, "-O3"), "-fno-math-errno", *processor_flags(widest=True))
    return loaded(source, "particles", flags)
