"""README of an exported estimator: how to use it, and what it costs."""

from __future__ import annotations

from daest.fmu.estimator_code import EstimatorModel


def readme(model: EstimatorModel, *, is_float: bool) -> str:
    """Sizes are those of the arrays; operations are counted from the loops of estimator.c."""
    size = 4 if is_float else 8
    word = "float" if is_float else "double"
    parameters = ", ".join(f"`{name}`" for name in model.parameters) if model.is_tunable else "none: numbers"
    return f"""# Estimator of {model.name}

A Kalman filter in C99, without dependencies, allocation or global data; `{word}` throughout.

    cc -std=c99 -O2 -o replay estimator.c estimator_model.c main.c -lm
    ./replay RECORDING.csv > estimates.csv

| file | what |
|---|---|
| `estimator.h` | the interface; the only header to include |
| `estimator.c` | the filter |
| `estimator_model.c`, `estimator_sizes.h` | this model |
| `main.c` | replays a CSV; leave it out on the target |

| | |
|---|---|
| inputs | {_listed(model.inputs)} |
| outputs (measured) | {_listed(model.outputs)} |
| estimated | {_listed(model.values)} |
| tunable parameters | {parameters} |
| white noises | {_listed(model.noises)} |
| inputs between samples | {"straight lines" if model.hold == "foh" else "held"} |
| expected step | {model.period:.9g} s; any other is sampled exactly when it comes |
| memory, one instance | about {_bytes(model) * size} bytes |
| stack | about {_stack(model) * size + 1000} bytes |
| operations, equal steps | about {_operations(model)} multiplications a sample |
| operations, a new step length | about {_sampling(model)} multiplications more |

The estimates are those of `daest filter` on the same samples. A missing output (`valid[j] = 0`) and steps of
any length are allowed. The start is unknown, or given with `estimator_set_state`. White noise that reaches a
variable directly is held over the last step.
"""


def _listed(names: tuple[str, ...]) -> str:
    return ", ".join(f"`{name}`" for name in names) or "none"


def _bytes(model: EstimatorModel) -> int:
    """Numbers in `Estimator`."""
    s = model.sizes
    n, nb, w, y, v, q, p = (s[f"EST_{k}"] for k in ("NX", "NUB", "NW", "NY", "NV", "NQ", "NP"))
    matrices = n * (n + nb + w + 1) + y * (n + nb + w + 1) + v * (n + w + nb + 1)
    sampled = 2 * n * n + 2 * n * nb + n + y * y + n * y + w * y + w
    update = y * (1 + q + y + n) + p * (p + 1)
    return (
        matrices
        + sampled
        + update
        + n * (n + q + 1)
        + p * (p + 1)
        + 2 * v
        + 4 * y
        + nb
        + w
        + s["EST_NTHETA"]
        + 10
    )


def _stack(model: EstimatorModel) -> int:
    """Numbers in the arrays of the deepest function."""
    s = model.sizes
    n, nb, w, y, q, p = (s[f"EST_{k}"] for k in ("NX", "NUB", "NW", "NY", "NQ", "NP"))
    sampling = 6 * n * n + n * nb + n * w
    predict = 5 * n * n + 5 * n * y + y * y + n * (q + 1)
    told = 2 * (n + w) * y + (n + w) * (q + 1) + 2 * q * q + q + y * (q + 4 * y + n) + 2 * p * p + p
    return max(sampling, predict, told + 2 * q * q + q)


def _operations(model: EstimatorModel) -> int:
    """Multiplications of update, prediction and telling once the start is known."""
    s = model.sizes
    n, nb, w, y, v = (s[f"EST_{k}"] for k in ("NX", "NUB", "NW", "NY", "NV"))
    z = n + w
    update = y * n * (n + y + 1) + y**3
    predict = 2 * n**3 + 5 * n * n * y + 4 * n * y * y + n * (n + 2 * nb + y)
    told = z * y * (n + 2 * y) + v * (n * n + z * (y + 2) + nb)
    return 2 * update + predict + told


def _sampling(model: EstimatorModel) -> int:
    n = model.sizes["EST_NX"]
    return 2 * 12 * n**3 + 5 * n**3 * 4 + n * n * model.sizes["EST_NUB"] * 2
