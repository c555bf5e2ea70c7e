"""Figures of a diagnosis and of an improvement."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from daest.model.diagnosis import Diagnosis, FreeForm, LearnedLoad, Screened
from daest.model.fit import FitResult
from daest.report import figures as style
from daest.report.console import probability
from daest.report.figures import BAND, LINES, PANEL, QUIET, SMALL

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

BARS = 12  # of the screen
WRAPPED = 105  # characters of a line of the message
LINE = 0.15  # inches of height of a line of the message
DECADE = 10.0  # ratio of errors from which their axis is logarithmic
RELATED = 1e-3  # p-value of a curve below which it is drawn


def diagnosis_figure(diagnosis: Diagnosis, units: Mapping[str, str]) -> Figure:
    """Scores of the screen, validation errors of the candidates that were refitted, and the unexplained load
    against the variable that explains it best. `units` are those of the outputs."""
    curve = diagnosis.disturbance
    drawn = curve is not None and curve.p_value < RELATED
    heights = (
        [0.5 + 0.22 * BARS] + ([PANEL + 0.4] if diagnosis.proofs else []) + ([1.6 * PANEL] if drawn else [])
    )
    lines = [diagnosis.verdict.capitalize(), *textwrap.wrap(diagnosis.message, WRAPPED)]
    figure = style.figure(sum(heights) + 0.3 + LINE * len(lines))
    figure.suptitle("\n".join(lines), fontsize=9)
    parts = style.parts(figure, heights)
    _draw_scores(diagnosis, parts.pop(0).subplots())
    if diagnosis.proofs:
        _draw_errors(diagnosis, units, parts.pop(0))
    if curve is not None and drawn:
        _draw_curve(curve, diagnosis.learned, parts.pop(0).subplots())
    return figure


def _draw_scores(diagnosis: Diagnosis, ax: Axes) -> None:
    """The best shape of every effect at every place; candidates that were accepted in colour."""
    best: dict[str, Screened] = {}
    for entry in diagnosis.screen.entries:
        best.setdefault(entry.candidate.label, entry)
    labels = list(best)[:BARS]
    accepted = {p.candidate.label for p in diagnosis.proofs if p.verdict != "rejected"}
    colors = [LINES[0] if label in accepted else QUIET for label in labels]
    ax.barh(range(len(labels)), [best[label].score for label in labels], color=colors)
    ax.set_yticks(range(len(labels)), labels, fontsize=7)
    ax.set_ylim(max(len(labels), 1) - 0.4, -0.6)
    ax.set_xlabel("score of the screen [standard deviations]")
    ax.set_title("all candidates, screened (colour: not rejected after its refit)", fontsize=9)


def _draw_errors(diagnosis: Diagnosis, units: Mapping[str, str], part: Any) -> None:
    labels = ["as it is", *(p.candidate.label for p in diagnosis.proofs)]
    fits = [diagnosis.baseline, *(p.told for p in diagnosis.proofs)]
    accepted = [False, *(p.verdict != "rejected" for p in diagnosis.proofs)]
    axes = part.subplots(1, len(units), sharey=True, squeeze=False)[0]
    errors = {
        name: [np.nan if (v := _validation_rms(fit, name)) is None else v for fit in fits] for name in units
    }
    known = {name: [value for value in values if value > 0.0] for name, values in errors.items()}
    # All axes alike: side by side, bars of two kinds would be compared as if they were of one.
    is_wide = any(values and max(values) > DECADE * min(values) for values in known.values())
    for ax, (name, unit) in zip(axes, units.items(), strict=True):
        ax.barh(range(len(labels)), errors[name], color=[LINES[0] if a else QUIET for a in accepted])
        ax.axvline(errors[name][0], color="black", lw=0.8, ls="--")
        if is_wide and known[name]:
            style.logarithmic(ax)
        scale = ", logarithmic" if ax.get_xscale() == "log" else ""
        ax.set_xlabel(f"validation rms {name} [{unit or '1'}]{scale}")
        ax.set_ylim(len(labels) - 0.4, -0.6)
    axes[0].set_yticks(range(len(labels)), labels, fontsize=SMALL)
    part.suptitle("the best, refitted (dashed: the model as it is)", fontsize=9)


def _validation_rms(fit: FitResult, output: str) -> float | None:
    return fit.simulated["validation"].rms.get(output) if "validation" in fit.simulated else None


def _draw_curve(curve: FreeForm, learned: LearnedLoad | None, ax: Axes) -> None:
    low, high = curve.w - BAND * curve.std, curve.w + BAND * curve.std
    ax.fill_between(curve.x, low, high, color=LINES[0], alpha=0.25, lw=0, label="95 %")
    ax.plot(curve.x, curve.w, color=LINES[0], lw=1.2, marker=".", label=f"load at {curve.place}")
    if learned is not None and learned.fit is not None:
        own = learned.curve
        ax.plot(own.x, own.y, color=LINES[1], lw=1.2, marker=".", label="refitted in the model")
    style.zero_line(ax)
    ax.set_xlabel(f"{curve.variable} [{curve.variable_unit or '1'}]")
    where = f", where {curve.sign_of} > 0" if curve.sign_of else ""
    ax.set_ylabel(f"unexplained load [{curve.unit or '1'}]{where}", fontsize=8)
    style.legend(ax, f"the load follows {curve.label} ({probability(curve.p_value, 1)})")


def staircase_figure(document: Mapping[str, Any]) -> Figure:
    """The document of an improvement: validation error of every output from step to step, with what was
    added."""
    steps, outputs = document["steps"], document["outputs"]
    figure = style.figure(1.3 * PANEL * len(outputs) + 0.4)
    axes = figure.subplots(len(outputs), 1, sharex=True, squeeze=False)[:, 0]
    for ax, (name, unit), color in zip(axes, outputs.items(), style.colors(), strict=False):
        errors = [step["rms"].get("validation", {}).get(name) for step in steps]
        _draw_stairs(ax, [np.nan if e is None else e for e in errors], color)
        ax.set_ylabel(f"rms error {name} [{unit or '1'}]")
    labels = ["as it is" if s["added"] is None else f"+ {s['added']}\nat {s['at']}" for s in steps]
    axes[-1].set_xticks(range(len(steps)), labels, fontsize=8)
    axes[0].set_title("simulation error on validation data", fontsize=9)
    return figure


def _draw_stairs(ax: Axes, errors: list[float], color: str) -> None:
    edges = np.arange(len(errors) + 1) - 0.5
    ax.stairs(errors, edges, color=color, lw=1.6, fill=False, baseline=None)
    ax.stairs(errors, edges, color=color, alpha=0.2, fill=True)
    for i, error in enumerate(errors):
        if np.isfinite(error):
            ax.annotate(
                f"{error:.3g}", (i, error), (0, 3), textcoords="offset points", ha="center", fontsize=8
            )
    ax.set_xlim(edges[0], edges[-1])
    ax.set_ylim(0.0, 1.2 * max([e for e in errors if np.isfinite(e)], default=1.0))
