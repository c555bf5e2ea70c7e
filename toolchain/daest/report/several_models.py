"""What a figure of several models has besides: which number and colour each has, how its error compares with
that of the others, and which tests it passed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from daest.model.comparison import Comparison, ResidualTest
from daest.report import figures as style
from daest.report.console import probability
from daest.report.figures import ALARM, LINE, QUIET, SMALL

if TYPE_CHECKING:
    from matplotlib.axes import Axes

TESTS = {
    "whiteness": "white",
    "input_independence": "independent\nof inputs",
    "variable_independence": "independent\nof variables",
    "nis": "of the\npredicted size",
}
NAME = 34  # characters of a line of a model's name
UNDER = 26  # characters of a line under a panel beside others
BESIDE = 3  # outputs beside each other
DECADE = 10.0  # ratio of errors from which their axis is logarithmic
CELL = 0.24  # inches of height of a row of the matrix


def numbers(comparison: Comparison) -> list[str]:
    """What stands for every model away from the key: its number, or its name where it is the only one."""
    if len(comparison.models) == 1:
        return [comparison.models[0].name]
    return [str(place) for place in range(1, len(comparison.models) + 1)]


def key_height(comparison: Comparison) -> float:
    """Height of `draw_key` in inches."""
    return sum(_key_heights(comparison)) + 0.2


def _key_heights(comparison: Comparison) -> list[float]:
    """Of every row of panels in inches: the first has room for the names."""
    n = len(comparison.models)
    lines = max(name.count("\n") + 1 for name in _names(comparison))
    others = -(-len(comparison.output_names) // BESIDE) - 1
    return [0.55 + n * max(CELL, LINE * lines + 0.04)] + others * [0.55 + n * CELL]


def draw_key(comparison: Comparison, part: Any) -> None:
    """Number, name and colour of every model with the rms error of its simulation, a panel per output."""
    n, heights = len(comparison.output_names), _key_heights(comparison)
    columns = min(n, BESIDE)
    names = _names(comparison)
    axes = part.subplots(len(heights), columns, squeeze=False, height_ratios=heights)
    for i, ax in enumerate(axes.flat):
        if i >= n:
            ax.set_visible(False)
            continue
        _draw_errors(comparison, i, ax)
        named = names if i == 0 else numbers(comparison) if i % columns == 0 else [""] * len(names)
        ax.set_yticks(range(len(names)), named, fontsize=SMALL)
        for tick, line in zip(ax.get_yticklabels(), style.model_lines(), strict=False):
            tick.set_color(line["color"])
    part.suptitle("models, and the error of their simulation over all recordings", fontsize=9)


def _names(comparison: Comparison) -> list[str]:
    return [
        f"{number}  {style.wrapped(model.name, NAME)}"
        for number, model in zip(numbers(comparison), comparison.models, strict=True)
    ]


def _draw_errors(comparison: Comparison, i: int, ax: Axes) -> None:
    output = comparison.output_names[i]
    errors = [model.simulation.rms[output] for model in comparison.models]
    low, high, scale = _limits([e for e in errors if e is not None and e > 0.0])
    ax.set_xscale(scale)
    ax.set_xlim(low, high)
    for place, (error, line) in enumerate(zip(errors, style.model_lines(), strict=False)):
        if error is not None:
            ax.plot([low, error], [place, place], lw=2.5, alpha=0.5, solid_capstyle="butt", **line)
            ax.plot(error, place, color=line["color"], marker="o", ms=5)
        shown, at = ("unknown", low) if error is None else (f"{error:.3g}", max(error, low))
        ax.annotate(shown, (at, place), (6, 0), textcoords="offset points", va="center", fontsize=SMALL)
    ax.set_ylim(len(errors) - 0.5, -0.5)
    ax.tick_params(labelsize=SMALL)
    named = style.label(f"rms error, {output}", comparison.output_units[i])
    ax.set_xlabel(style.wrapped(named, UNDER if len(comparison.output_names) > 1 else 3 * UNDER), fontsize=8)


def _limits(errors: Sequence[float]) -> tuple[float, float, str]:
    """Limits of an axis that leave room for numbers beside the points, and its scale."""
    if errors and max(errors) > DECADE * min(errors):
        decades = max(errors) / min(errors)
        return min(errors) / decades**0.2, max(errors) * decades**0.4, "log"
    return 0.0, 1.4 * max(errors, default=1.0), "linear"


def spread(comparison: Comparison, i: int) -> tuple[float, float]:
    """Largest and smallest rms error of the simulation of output `i`; 0 and 0 where none is known."""
    found = [model.simulation.rms[comparison.output_names[i]] for model in comparison.models]
    known = [e for e in found if e is not None and e > 0.0]
    return (max(known), min(known)) if known else (0.0, 0.0)


def matrix_height(comparison: Comparison) -> float:
    """Height of `draw_matrix` in inches."""
    return 0.8 + CELL * len(list(_rows(comparison)))


def draw_matrix(comparison: Comparison, ax: Axes) -> None:
    """A row per model and output, a column per residual test with its p-value, and the verdicts."""
    from matplotlib.patches import Rectangle

    kinds = [kind for kind in TESTS if any(model.tests.get(kind) for model in comparison.models)]
    rows = list(_rows(comparison))
    for row, (_, tests, verdict, _) in enumerate(rows):
        for column, kind in enumerate(kinds):
            if (test := tests.get(kind)) is not None:
                color = QUIET if test.passed else ALARM
                box = Rectangle((column - 0.5, row - 0.5), 1, 1, fc=color, alpha=0.45, ec="white", lw=1.5)
                ax.add_patch(box)
                ax.text(column, row, _outcome(test), ha="center", va="center", fontsize=SMALL)
        ax.text(len(kinds), row, verdict, ha="center", va="center", fontsize=SMALL)
    ax.set_xlim(-0.5, len(kinds) + 0.5)
    ax.set_ylim(len(rows) - 0.5, -0.5)
    ax.set_xticks(range(len(kinds) + 1), [*(TESTS[kind] for kind in kinds), "verdict"], fontsize=SMALL)
    ax.set_yticks(range(len(rows)), [label for label, *_ in rows], fontsize=SMALL)
    for tick, (*_, color) in zip(ax.get_yticklabels(), rows, strict=True):
        tick.set_color(color)
    ax.tick_params(length=0)
    ax.xaxis.tick_top()
    ax.spines[:].set_visible(False)
    ax.set_title("residual tests: the one-step errors are …", fontsize=9)


def _outcome(test: ResidualTest) -> str:
    return f"{'passed' if test.passed else 'failed'}, {probability(test.p_value)}"


def _rows(comparison: Comparison) -> Iterator[tuple[str, dict[str, ResidualTest], str, str]]:
    """Label, tests by kind, verdict (once per model) and colour."""
    outputs: Sequence[str] = comparison.output_names
    for number, model, line in zip(numbers(comparison), comparison.models, style.model_lines(), strict=False):
        for i, output in enumerate(outputs):
            label = f"{number}  {output}" if len(outputs) > 1 else number
            tests = {kind: found[output] for kind, found in model.tests.items() if output in found}
            verdict = (model.verdict or "not tested") if i == 0 else ""
            yield label, tests, verdict, line["color"]
