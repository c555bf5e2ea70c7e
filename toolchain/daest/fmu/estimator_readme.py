"""README of an exported estimator: how to use it, and what it costs."""

from __future__ import annotations

from daest.fmu.estimator_code import EstimatorModel
from daest.model.holds import hold_text

CALLS = 1600  # bytes of stack for the calls themselves; gcc -fstack-usage on three kinds of filters


def readme(model: EstimatorModel, *, is_float: bool) -> str:
    """Sizes are those of the arrays; operations are counted from the loops, and where the filter is nonlinear
    from the functions of the model, too."""
    size = 4 if is_float else 8
    word = "float" if is_float else "double"
    parameters = ", ".join(f"`{name}`" for name in model.parameters) if model.is_tunable else "none: numbers"
    cost = model.form.cost(model)
    counted = [("operations, expected step", f"about {cost['operations']} multiplications a sample")]
    if "resampling" in cost:
        counted += [("operations, a new step length", f"about {cost['resampling']} multiplications more")]
    operations = "\n".join(f"| {name} | {text} |" for name, text in counted)
    single = (
        "\nAdd `-fsingle-precision-constant` on a processor without double precision.\n" if is_float else ""
    )
    return f"""# Estimator of {model.name}

{model.form.word} in C99, without dependencies, allocation or global data; `{word}` throughout.

    cc -std=c99 -O2 -o replay estimator.c estimator_model.c main.c -lm
    ./replay RECORDING.csv > estimates.csv
{single}
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
| inputs between samples | {hold_text(model.hold)} |
| expected step | {model.period:.9g} s; any other is followed when it comes |
| memory, one instance | about {cost["memory"] * size} bytes |
| stack | about {cost["stack"] * size + CALLS} bytes |
{operations}

The estimates are those of `daest filter` on the same samples from the same start. A missing output
(`valid[j] = 0`) and steps of any length are allowed. The start is the one of estimator_model.c, or given with
`estimator_set_state`. White noise that reaches a variable directly is held over the last step.
"""


def _listed(names: tuple[str, ...]) -> str:
    return ", ".join(f"`{name}`" for name in names) or "none"
