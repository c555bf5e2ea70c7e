"""Pictures of comparisons of any number of models, outputs and recordings: names of any length leave room for
the panels, nothing runs out of the picture or over something else, and the errors tell at a glance."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from daest.model.comparison import Comparison, Finding, Horizon, ModelTrial, ResidualTest
from daest.model.experiment import Experiment
from daest.model.fit import Agreement
from daest.report.comparison_figure import comparison_figure
from daest.report.figures import model_lines, wrapped

TIME = np.arange(400) * 0.01
NAMES = (
    "Machine",
    "Machine_CoulombFriction",
    "Machine_CoulombFriction_AsymmetricDamper",
    "Machine_CoulombFriction_AsymmetricDamper_HardeningSpring_Backlash_LuGreFriction_Learned",
    "ThermohydraulicMachineWithoutAnyPlaceWhereItsNameCouldBeBroken",
)
OUTPUTS = ("phi", "omega", "machine.drive.output_shaft.flange_a.tau", "T")
KINDS = ("whiteness", "input_independence", "variable_independence", "nis")


def finding(output: str) -> Finding:
    text = (
        f"85 % of the one-step error of {output} while machine.left.carriage.v < -0.03 m/s (50 % of the time)"
    )
    where = ("region", "one-step", "machine.left.carriage.v", "m/s", None, -0.03)
    return Finding(output, *where, 0.85, 0.5, 1e-9, text)


def trial(name: str, share: float, runs: list[np.ndarray], outputs: tuple[str, ...]) -> ModelTrial:
    """A model that leaves `share` of the signals; more than a tenth fails all tests."""
    rms = {o: share * float(np.sqrt(np.mean([y[:, i] ** 2 for y in runs]))) for i, o in enumerate(outputs)}
    agreement = Agreement(dict.fromkeys(outputs, 100.0 * (1.0 - share)), rms)
    test = ResidualTest(9.0, 8.0, 0.0, False) if share > 0.1 else ResidualTest(1.0, 8.0, 0.4, True)
    rng = np.random.default_rng(0)
    growth = (Horizon(1, 0.01, dict.fromkeys(outputs, 0.01)), Horizon(9, 0.09, dict.fromkeys(outputs, 0.3)))
    return ModelTrial(
        name,
        2,
        agreement,
        agreement,
        -1.0,
        3.0,
        tuple((1.0 - share) * y for y in runs),
        tuple(runs),
        tests={kind: dict.fromkeys(outputs, test) for kind in KINDS},
        verdict="falsified" if share > 0.1 else "not falsified",
        where=tuple(finding(o) for o in outputs),
        growth=growth,
        residuals=tuple(rng.standard_normal(y.shape) for y in runs),
    )


def compared(n_models: int, n_outputs: int = 1, n_runs: int = 1) -> Comparison:
    """Every model leaves 0.3 of what the model before it leaves."""
    outputs = OUTPUTS[:n_outputs]
    sizes = 10.0 ** np.arange(n_outputs)
    runs = [np.sin(np.outer(TIME + r, 3.0 + np.arange(n_outputs))) * sizes for r in range(n_runs)]
    experiments = tuple(
        Experiment(f"recording_of_the_machine_{r}", TIME, np.zeros((400, 0)), y, (), outputs)
        for r, y in enumerate(runs)
    )
    names = [NAMES[m % len(NAMES)] for m in range(n_models)]
    if n_models == 1:
        names = [NAMES[3]]
    models = tuple(trial(name, 0.3**m, runs, outputs) for m, name in enumerate(names))
    return Comparison(experiments, outputs, ("N.m/rad",) * n_outputs, models)


@pytest.mark.parametrize(
    ("n_models", "n_outputs", "n_runs"),
    [
        pytest.param(1, 1, 1, marks=pytest.mark.slow),
        pytest.param(2, 1, 3, marks=pytest.mark.slow),
        pytest.param(1, 2, 2, marks=pytest.mark.slow),
        pytest.param(4, 1, 1, marks=pytest.mark.slow),
        (2, 1, 1),
        pytest.param(3, 2, 3, marks=pytest.mark.slow),
        pytest.param(8, 4, 1, marks=pytest.mark.slow),
    ],
)
def test_names_leave_room_and_stay_in_the_picture(n_models, n_outputs, n_runs):
    figure = comparison_figure(compared(n_models, n_outputs, n_runs))
    figure.draw_without_rendering()
    whole, room = figure.bbox, 2.0  # pixels of rounding
    for ax in figure.get_axes():
        if not ax.get_visible():
            continue
        assert ax.get_window_extent().width > 0.4 * whole.width / max(3, n_runs)
        assert ax.get_window_extent().height > 0.2 * figure.dpi
        labels = [*ax.get_yticklabels(), ax.xaxis.label, ax.yaxis.label, ax.title, ax._left_title, *ax.texts]
        legend = ax.get_legend()
        boxes = [t.get_window_extent() for t in labels if t.get_text()]
        boxes += [legend.get_window_extent()] if legend else []
        for box in boxes:
            assert box.x0 > -room and box.x1 < whole.x1 + room, ax.get_ylabel()
            assert box.y0 > -room and box.y1 < whole.y1 + room, ax.get_ylabel()
        if legend:
            assert legend.get_window_extent().y0 > ax.get_window_extent().y1 - room
            assert not legend.get_window_extent().overlaps(ax._left_title.get_window_extent()) or (
                not ax._left_title.get_text()
            )


@pytest.mark.slow
def test_names_of_models_stand_below_each_other():
    figure = comparison_figure(compared(8))
    figure.draw_without_rendering()
    key = figure.get_axes()[0]
    boxes = [tick.get_window_extent() for tick in key.get_yticklabels()]
    assert all(below.y1 < above.y0 for above, below in itertools.pairwise(boxes))
    assert [tick.get_text().replace("\n", "") for tick in key.get_yticklabels()][:2] == [
        "1  Machine",
        "2  Machine_CoulombFriction",
    ]


def test_the_first_panel_tells_the_error_from_model_to_model():
    key, values, errors, enlarged = comparison_figure(compared(4)).get_axes()[:4]
    sizes = [float(line.get_xdata()[0]) for line in key.get_lines() if line.get_marker() == "o"]
    np.testing.assert_allclose(sizes[0] * 0.3 ** np.arange(4), sizes, rtol=1e-12)
    assert key.get_xscale() == "log" and key.texts[0].get_text() == f"{sizes[0]:.3g}"
    labels = values.get_legend_handles_labels()[1]
    assert labels[0] == "measured" and [label.split(" ")[0] for label in labels[1:]] == list("1234")
    best = max(abs(line.get_ydata()).max() for line in errors.get_lines()[-2:-1])
    assert best < enlarged.get_ylim()[1] < 10.0 * best < errors.get_ylim()[1]


def test_an_unknown_error_says_so():
    comparison = compared(3)
    lost = replace(comparison.models[1].simulation, rms={"phi": None})
    models = (comparison.models[0], replace(comparison.models[1], simulation=lost), comparison.models[2])
    key = comparison_figure(replace(comparison, models=models)).get_axes()[0]
    assert key.texts[1].get_text() == "unknown"


def test_errors_of_one_size_are_not_drawn_twice():
    comparison = compared(2)
    assert not any("enlarged" in ax.get_ylabel() for ax in comparison_figure(comparison).get_axes())


def test_tests_are_a_matrix_with_verdicts():
    figure = comparison_figure(compared(4, 2))
    (matrix,) = [ax for ax in figure.get_axes() if ax.get_title().startswith("residual tests")]
    texts = [t.get_text() for t in matrix.texts]
    assert texts.count("failed, p < 1e-12") == texts.count("passed, p = 0.4") == 2 * 2 * len(KINDS)
    assert texts.count("falsified") == texts.count("not falsified") == 2
    assert [t.get_text() for t in matrix.get_yticklabels()][:3] == ["1  phi", "1  omega", "2  phi"]


def test_long_names_are_broken_where_they_can_be():
    assert wrapped("Emps_CoulombFriction", 34) == "Emps_CoulombFriction"
    assert wrapped("Emps_CoulombFriction_Learned", 16) == "Emps_\nCoulombFriction_\nLearned"
    assert wrapped("a.b c", 3) == "a.b\nc" and wrapped("abcdefgh", 3) == "abc\ndef\ngh"
    assert wrapped("", 5) == ""


def test_models_are_told_apart():
    lines = [tuple(line.values()) for line, _ in zip(model_lines(), range(18), strict=False)]
    assert len(set(lines)) == 18
