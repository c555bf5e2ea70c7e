"""Figures show what the results say, with a name and a unit on every axis."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

from daest.model.comparison import Comparison, Horizon, ModelTrial, ResidualTest
from daest.model.estimates import FilterResult, NisSummary, OutputComparison, ProcessNoiseEstimate
from daest.model.experiment import Experiment, Simulation
from daest.model.fit import Agreement, FitResult, FittedParameter
from daest.model.linear import LinearDAE
from daest.model.noise import NoisePlace, NoiseReport
from daest.model.parts import Equation, Variable
from daest.report import figures as style
from daest.report.comparison_figure import comparison_figure
from daest.report.diagnosis_figures import staircase_figure
from daest.report.figures import save, shown_range
from daest.report.frequency_figure import linear_figure
from daest.report.groups import component, grouped, owner, stretches
from daest.report.result_figures import filter_figure, fit_figure, simulation_figure
from daest.report.structure_figure import noise_figure
from daest.systems.linear.transfer import TransferFunction

UNIT = re.compile(r"\[[^\]]+\]")
NUMBER = re.compile(r"[\u2212-]?[\d.]+|\$.*\$")
TIME = np.arange(400) * 0.01
Y = np.sin(5 * TIME)[:, None]


def labelled(figure) -> bool:
    """Every axis with numbers on it has a label with a unit."""
    figure.canvas.draw()
    for ax in figure.get_axes():
        for axis, side in ((ax.xaxis, "labelbottom"), (ax.yaxis, "labelleft")):
            shown = axis.get_tick_params().get(side, True)
            ticks = [tick.get_text() for tick in axis.get_ticklabels() if tick.get_text()]
            numbers = any(NUMBER.fullmatch(tick) for tick in ticks)
            if shown and numbers and not UNIT.search(axis.get_label_text()):
                return False
    return True


def test_a_bare_axis_is_noticed():
    from daest.report.figures import figure

    drawn = figure(2.0)
    ax = drawn.subplots()
    ax.plot([0, 1], [0, 1])
    ax.set_xlabel("time [s]")
    assert not labelled(drawn)
    ax.set_ylabel("speed [m/s]")
    assert labelled(drawn)


@pytest.fixture
def run() -> Experiment:
    return Experiment("run", TIME, np.zeros((400, 1)), Y, ("u",), ("y",))


@pytest.fixture
def comparison(run) -> Comparison:
    agreement = Agreement({"y": 90.0}, {"y": 0.1})
    tests = {
        "whiteness": {"y": ResidualTest(99.0, 9.0, 0.0, False)},
        "input_independence": {"y": ResidualTest(1.0, 9.0, 0.4, True)},
    }
    rng = np.random.default_rng(0)
    trial = ModelTrial(
        "M",
        2,
        agreement,
        agreement,
        -1.0,
        3.0,
        (0.9 * Y,),
        (Y,),
        tests=tests,
        verdict="falsified",
        growth=(Horizon(1, 0.01, {"y": 0.01}), Horizon(10, 0.1, {"y": 0.5})),
        residuals=(rng.standard_normal((400, 1)),),
    )
    return Comparison((run,), ("y",), ("V",), (trial,))


def test_comparison_shows_time_errors_spectrum_tests(comparison):
    figure = comparison_figure(comparison)
    values, errors, spectrum, white, growth, verdicts = figure.get_axes()
    assert labelled(figure)
    assert np.allclose(errors.get_lines()[0].get_ydata(), 0.1 * Y[:, 0])
    measured, error = spectrum.get_lines()
    peak = measured.get_xdata()[np.argmax(measured.get_ydata())]
    assert peak == pytest.approx(5 / (2 * np.pi), abs=1.0)
    assert np.allclose(error.get_ydata(), 0.1 * measured.get_ydata(), rtol=1e-6)
    assert growth.get_yscale() == "log" and white.get_xlabel() == "lag [s]"
    near = replace(comparison.models[0], growth=(Horizon(1, 0.01, {"y": 0.09}),))
    level = comparison_figure(replace(comparison, models=(near,))).get_axes()[4]
    assert level.get_ylim() == pytest.approx((0.0, 0.11))  # over the dashed line of the simulation, 0.1
    assert [t.get_text() for t in verdicts.texts] == ["failed, p < 1e-12", "passed, p = 0.4"]
    assert values.get_title(loc="left") == "run"


def test_every_recording_has_its_own_fit(run, comparison):
    (trial,) = comparison.models
    other = replace(run, name="other")
    two = replace(trial, simulated=(0.9 * Y, 0.5 * Y), growth=())
    figure = comparison_figure(replace(comparison, experiments=(run, other), models=(two,)))
    labels = [ax.get_legend_handles_labels()[1][-1] for ax in figure.get_axes() if ax.get_title(loc="left")]
    assert labels == ["M (90.0 %)", "M (50.0 %)"]
    assert not any("predictions" in ax.get_title() for ax in figure.get_axes())


def fit(std_error: float | None = 0.1) -> FitResult:
    """Two parameters, of which the second is correlated with the first."""
    parameters = (
        FittedParameter("c", 2.0, std_error, 1.0, "N/m", None, None, None),
        FittedParameter("d", 0.5, 0.2, 1.0, "N.s/m", 0.0, None, "min"),
    )
    import inspect

    given = {
        "method": "oe",
        "status": "converged",
        "message": "",
        "parameters": parameters,
        "correlation_names": ("c", "d"),
        "correlation": np.array([[1.0, 0.8], [0.8, 1.0]]),
    }
    needed = [
        p.name
        for p in inspect.signature(FitResult).parameters.values()
        if p.default is inspect.Parameter.empty and p.name not in given
    ]
    return FitResult(**given, **dict.fromkeys(needed))


def test_fit_shows_intervals_and_correlations(comparison):
    figure = fit_figure(fit(), comparison)
    intervals, correlations = figure.get_axes()[:2]
    assert [t.get_text() for t in intervals.get_yticklabels()] == ["c", "d"]
    bars = [line for line in intervals.get_lines() if line.get_marker() == "|"]
    assert max(line.get_xdata()[0] for line in bars) == pytest.approx(100 * 1.96 * 0.2 / 0.5)
    assert "2 ± 0.2 N/m" in [t.get_text() for t in intervals.texts]
    assert intervals.get_title() == "at a bound: d"
    assert {t.get_text() for t in correlations.texts} == {"0.80"}


def test_what_the_data_do_not_determine_has_no_interval():
    texts = [t.get_text() for t in fit_figure(fit(None), None).get_axes()[0].texts]
    assert "not determined" in texts and not any("N/m" in t and "N.s/m" not in t for t in texts)


def test_filter_shows_band_and_what_was_not_used(run):
    std = np.full((400, 1), 0.1)
    std[0] = np.inf
    noise = ProcessNoiseEstimate((), (), np.zeros((400, 0)), np.zeros((400, 0)))
    result = FilterResult(
        kind="ekf",
        smoothed=False,
        names=("y",),
        units=("V",),
        time=TIME,
        values=Y.copy(),
        std=std,
        output_names=(),
        innovations=np.zeros((400, 0)),
        nis=NisSummary(1.0, 0.9, 1.1, 400),
        log_likelihood=0.0,
        measure=("x",),
        compared={"y": OutputComparison(87.5, 0.1, 400)},
        process_noise=noise,
        steady_after=None,
        noise="white",
        hold="zoh",
    )
    figure = filter_figure(result, run)
    (ax,) = figure.get_axes()
    assert labelled(figure) and ax.get_ylabel() == "y [V]" and "87.5 %" in ax.get_title(loc="left")
    assert "inside 0.9 to 1.1" in figure.get_suptitle()
    low, high = ax.get_ylim()
    assert low < -1.0 and high > 1.0 and high < 2.0


def test_a_wild_start_does_not_hide_the_rest():
    value = np.concatenate([[1e6, -1e5], np.sin(TIME * 10)])
    std = np.concatenate([[1e6, 1e5], np.full(400, 0.01)])
    low, high = shown_range(value, std, np.zeros(0))
    assert -1.5 < low < -1.0 and 1.0 < high < 1.5
    assert shown_range(np.full(3, np.nan), np.full(3, np.inf), np.zeros(0)) == pytest.approx((-0.1, 1.1))


@pytest.mark.parametrize("sparse", [False, True])
def test_structure_by_component(sparse):
    origins = ("a", "b", "a, b", "a.flange")
    kinds = ("component", "component", "connection", "unconnected")
    equations = tuple(Equation(f"e{i}", *e) for i, e in enumerate(zip(kinds, origins, strict=True)))
    unknowns = tuple(Variable(name) for name in ("a.x", "b.x", "a.v", "top"))
    E = np.diag([1.0, 0.0, 0.0, 0.0])
    J = np.eye(4)
    none = np.zeros((4, 0))
    form = sp.csr_array if sparse else np.asarray
    dae = LinearDAE(
        equations, unknowns, (), (), (), (), form(E), form(J), none, none, *[np.zeros((0, 4))],
        np.zeros((0, 0)), np.zeros((0, 0)), np.zeros(4), np.zeros(0),
    )  # fmt: skip
    places = tuple(NoisePlace(e.text, (i,), i != 3, 0.0, 0, (), (), "") for i, e in enumerate(equations))
    asked = (NoisePlace("w", (3,), False, 1.0, 1, (), (), ""),)
    report = NoiseReport(equations, places, (), asked, 1, 1, (), ())
    figure = noise_figure(dae, report)
    (ax,) = figure.get_axes()
    assert [t.get_text() for t in ax.get_yticklabels()] == ["a", "b", "connections"]
    assert [t.get_text() for t in ax.get_xticklabels()] == ["a", "b", "top level"]
    # The fourth equation stands second, beside the other of its component.
    (band,) = ax.patches
    assert (band.get_y(), band.get_height()) == (0.5, 1.0)
    pattern_of_J, pattern_of_E = ax.collections
    assert pattern_of_J.get_offsets().tolist() == [[0, 0], [2, 2], [1, 3], [3, 1]]
    assert pattern_of_E.get_offsets().tolist() == [[0, 0]]
    assert "1 of 4 equations" in ax.get_title()


def test_groups():
    assert [component(o) for o in ("motor", "a.p, b.n", "")] == ["motor", "connections", "top level"]
    ends = ("gear.inertia.flange_b", "load.flange_b", "flange")
    assert [component(o, "unconnected") for o in ends] == ["gear.inertia", "load", "top level"]
    assert owner("motor.w") == "motor" and owner("u") == "top level"
    assert grouped(["a", "b", "a", "c", "b"]) == [0, 2, 1, 4, 3]
    assert stretches([True, True, False]) == [(True, 0, 2), (False, 2, 3)] and stretches([]) == []


def test_frequency_response_of_a_lag():
    lag = TransferFunction("u", "y", (3.0,), (1.0, 2.0))
    figure = linear_figure([lag], np.array([-2.0 + 0j]), {"u": "V", "y": "rad"})
    magnitude, phase, poles = figure.get_axes()
    assert labelled(figure) and magnitude.get_ylabel() == "gain [(rad)/(V)]"
    hertz, gain = magnitude.get_lines()[0].get_data()
    assert np.allclose(gain, 3.0 / np.hypot(2 * np.pi * hertz, 2.0))
    corner = np.argmin(np.abs(2 * np.pi * hertz - 2.0))
    assert phase.get_lines()[0].get_ydata()[corner] == pytest.approx(-45.0, abs=1.0)
    assert poles.get_lines()[0].get_data() == ([-2.0], [0.0])


def test_an_output_that_nothing_moves_is_told():
    silent = TransferFunction("u", "y", (0.0,), (1.0,))
    poles = np.array([-1.0 + 9.9j, -1.0 - 9.9j])
    magnitude, _, plane = linear_figure([silent], poles, {}).get_axes()
    assert [t.get_text() for t in magnitude.texts] == ["no input moves y here"]
    assert plane.get_ylim()[1] > 10.0


@pytest.mark.parametrize("poles", [[], [0.0], [1.0 + 1.0j, 1.0 - 1.0j]])
def test_poles_at_rest_unstable_or_absent(poles, tmp_path):
    figure = linear_figure([], np.array(poles, dtype=complex), {})
    save(figure, tmp_path / "poles.svg")
    assert ("unstable" in (tmp_path / "poles.svg").read_text()) == (len(poles) == 2)


def test_simulation_shows_inputs_outputs_and_measurements(run):
    simulation = Simulation(
        "M", TIME, np.ones((400, 1)), np.zeros((400, 0)), 0.9 * Y, np.zeros((400, 0)), np.zeros((400, 0)),
        ("u",), (), ("y",), (), (), {"u": "V", "y": "rad"}, "zoh", "exact",
    )  # fmt: skip
    figure = simulation_figure(simulation, run)
    inputs, outputs = figure.get_axes()
    assert labelled(figure) and inputs.get_ylabel() == "u [V]" and outputs.get_ylabel() == "y [rad]"
    assert inputs.get_lines()[0].get_drawstyle() == "steps-post"
    measured, simulated = outputs.get_lines()[:2]
    assert np.allclose(simulated.get_ydata(), 0.9 * measured.get_ydata())


def test_staircase_falls():
    steps = [
        {"added": None, "at": None, "rms": {"validation": {"y": 0.2}}},
        {"added": "Drag", "at": "axle", "rms": {"validation": {"y": 0.02}}},
    ]
    figure = staircase_figure({"steps": steps, "outputs": {"y": "V"}})
    (ax,) = figure.get_axes()
    assert labelled(figure) and [t.get_text() for t in ax.texts] == ["0.2", "0.02"]
    assert ax.get_xticklabels()[1].get_text() == "+ Drag\nat axle"


def test_the_same_figure_is_the_same_file(tmp_path):
    for name in "ab":
        drawn = style.figure(2.0)
        drawn.subplots().plot(TIME, Y, label="speed")
        drawn.legend()
        for suffix in (".png", ".pdf"):
            save(drawn, tmp_path / f"{name}{suffix}")
    for suffix in (".png", ".pdf"):
        one, other = (tmp_path / f"{name}{suffix}" for name in "ab")
        assert one.read_bytes() == other.read_bytes() and one.stat().st_size > 5000


@pytest.mark.parametrize(
    ("seconds", "label", "numbers"),
    [
        (90.0, "time [s]", ["0", "20", "40", "60", "80"]),
        (10 * 3600.0, "time [h]", ["0", "2", "4", "6", "8", "10"]),
        (12 * 86400.0, "time [d]", ["0", "2", "4", "6", "8", "10", "12"]),
        (4000 * 86400.0, "time [d]", ["0"]),
    ],
)
def test_long_recordings_are_drawn_over_hours_or_days(seconds, label, numbers) -> None:
    figure = style.figure(2.0)
    ax = figure.subplots()
    ax.plot([0.0, seconds], [0.0, 1.0])
    style.time_axis(ax)
    figure.canvas.draw()
    low, high = ax.get_xlim()
    places = zip(ax.get_xticks(), ax.get_xticklabels(), strict=True)
    shown = [text.get_text() for place, text in places if low <= place <= high]
    assert ax.get_xlabel() == label and set(numbers) <= set(shown) and len(shown) <= 12


def test_logarithmic_axis_has_few_numbers() -> None:
    figure = style.figure(2.0)
    for ax, ends in zip(figure.subplots(1, 3), ([2e-4, 4e-3], [1e-9, 1.0], [0.052, 0.096]), strict=True):
        ax.barh([0, 1], ends)
        style.logarithmic(ax)
    figure.canvas.draw()
    for ax in figure.axes:
        low, high = ax.get_xlim()
        shown = [t.get_text() for t in ax.get_xticklabels(which="both") if low <= t.get_position()[0] <= high]
        assert 2 <= sum(map(bool, shown)) <= 5, shown
