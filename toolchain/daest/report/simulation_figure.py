"""A simulation: inputs and outputs over time."""

from __future__ import annotations

from typing import TYPE_CHECKING

from daest.model.experiment import Experiment
from daest.model.simulation import Simulation
from daest.report import figures as style
from daest.report.figures import LINES, MEASURED, PANEL

if TYPE_CHECKING:
    from matplotlib.figure import Figure

INPUT = "0.35"


def simulation_figure(simulation: Simulation, recording: Experiment) -> Figure:
    """Inputs above, in dark grey, held or on straight lines as the simulation took them; outputs below, with
    what `recording` has measured of them."""
    names = [*simulation.input_names, *simulation.output_names]
    names = list(dict.fromkeys(names)) or list(simulation.state_names)
    figure = style.figure(0.8 * PANEL * len(names) + 0.7)
    axes = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    for ax, name in zip(axes, names, strict=True):
        is_input = name in simulation.input_names
        steps = "steps-post" if is_input and simulation.hold == "zoh" else "default"
        color = INPUT if is_input else LINES[0]
        if name in recording.output_names:
            ax.plot(recording.time, recording.outputs[:, recording.output_names.index(name)], **MEASURED)
        ax.plot(simulation.time, simulation[name], color=color, lw=1.0, drawstyle=steps, label="simulated")
        ax.set_ylabel(style.label(name, simulation.units.get(name)))
        style.zero_line(ax)
        if name in recording.output_names:
            style.legend(ax)
    noise = "with noise" if simulation.with_noise else "without noise"
    figure.suptitle(f"{simulation.model_name}, {noise} ({simulation.method})", fontsize=9)
    axes[-1].set_xlabel("time [s]")
    return figure
