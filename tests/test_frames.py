"""Results as DataFrames, Datasets, python-control systems and tables of a notebook: the same numbers, small
and escaped."""

from __future__ import annotations

import sys
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import control
import numpy as np
import pandas as pd
import pytest
import xarray as xr

import daest
from daest.errors import ConfigError
from daest.model.shown import MOST_ROWS

SERVO = Path(__file__).resolve().parents[1] / "examples" / "servo"
SIGNALS = [daest.Signal("u", "V")], [daest.Signal("omega", "rad/s"), daest.Signal("phi", "rad")]
LARGEST = 20_000  # characters of a table in a notebook


@pytest.fixture(scope="module")
def flat():
    return daest.compile_model(SERVO / "Servo.mo")


@pytest.fixture(scope="module")
def frame():
    return pd.read_csv(SERVO / "servo.csv").iloc[:1000]


@pytest.fixture(scope="module")
def recording(frame):
    return daest.read_experiments([frame], *SIGNALS)[0]


@pytest.fixture(scope="module")
def fit(flat, recording):
    return daest.identify(flat, [recording], daest.IdentifyOptions(split=0.5, hold="zoh"))


@pytest.fixture(scope="module")
def fitted(flat, fit):
    return daest.with_values(flat, fit.theta)


@pytest.fixture(scope="module")
def filtered(fitted, recording, fit):
    stds = np.array([n.value for n in fit.noises if n.kind == "measurement"])
    family = daest.state_space_family(fitted)
    return daest.run_filter(
        family,
        recording,
        "time-varying",
        daest.FilterOptions(
            theta=fitted.theta_values, process_intensity=np.array([1e-6]), measurement_cov=stds**2, hold="zoh"
        ),
    )


def test_a_frame_is_read_like_its_file(frame, recording, tmp_path):
    frame.to_csv(tmp_path / "run.csv", index=False)
    from_file = daest.read_experiments([tmp_path / "run.csv"], *SIGNALS)[0]
    for name in ("time", "inputs", "outputs"):
        assert np.array_equal(getattr(from_file, name), getattr(recording, name))


def test_recordings_go_out_and_in_again(recording):
    out = recording.to_frame()
    assert out.index.name == "time" and list(out.columns) == ["u", "omega", "phi"]
    again = daest.read_experiments([out], *SIGNALS)[0]
    assert np.array_equal(again.outputs, recording.outputs) and again.time == pytest.approx(recording.time)
    data = recording.to_xarray()
    assert isinstance(data, xr.Dataset) and data.sizes == {"time": 1000}
    assert np.array_equal(daest.read_experiments([data], *SIGNALS)[0].outputs, recording.outputs)


def test_parameters(fit):
    table = fit.to_frame()
    assert list(table.index) == [p.name for p in fit.parameters]
    assert table.loc["k", "value"] == fit.theta["k"] and table.loc["k", "unit"] == "N.m/A"


def test_filter_and_simulation(fitted, recording, filtered):
    table, data = filtered.to_frame(), filtered.to_xarray()
    column = filtered.names.index("spring.tau")
    assert np.array_equal(table["spring.tau"], filtered.values[:, column], equal_nan=True)
    assert np.array_equal(data["spring.tau.std"], filtered.std[:, column])
    assert data["spring.tau"].attrs["units"] == table.attrs["units"]["spring.tau"] == "N.m"
    simulation = daest.simulate(fitted, recording, hold="zoh")
    assert np.array_equal(simulation.to_frame()["phi"], simulation["phi"])
    assert simulation.to_xarray()["omega"].attrs["units"] == "rad/s"


def test_control_has_the_same_frequency_response(flat):
    model = daest.state_space(daest.state_space_family(flat), flat.theta_values)
    system = model.to_control()
    assert isinstance(system, control.StateSpace)
    assert (system.input_labels, system.output_labels) == (["u"], ["omega", "phi"])
    assert system.state_labels == list(model.state_names)
    s = 3.0j
    expected = model.C @ np.linalg.solve(s * np.eye(model.A.shape[0]) - model.A, model.B) + model.D
    assert system(s) == pytest.approx(expected)
    dae = daest.linearize(flat)
    functions = {(g.input, g.output): g for g in daest.transfer_functions(dae, daest.split(dae))}
    phi = functions["u", "phi"]
    assert system(s)[1, 0] == pytest.approx(np.polyval(phi.num, s) / np.polyval(phi.den, s), rel=1e-6)


def values(flat, recording, fit, fitted, filtered):
    dae = daest.linearize(flat)
    comparison = daest.compare_models([daest.Candidate(flat.name, fitted, 5, "zoh")], [recording])
    return {
        "fit": fit,
        "filter": filtered,
        "recording": recording,
        "comparison": comparison,
        "noise": daest.noise_report(dae),
        "dae": dae,
        "state space": daest.state_space(daest.state_space_family(flat), flat.theta_values),
        "check": daest.check_experiment(recording),
    }


class Balanced(HTMLParser):
    """Counts open tags, and collects the text."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.seen: set[str] = set()
        self.text = ""

    def handle_starttag(self, tag, attrs):
        self.open.append(tag)
        self.seen.add(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


def test_tables_of_a_notebook(flat, recording, fit, fitted, filtered):
    for name, value in values(flat, recording, fit, fitted, filtered).items():
        html, markdown = value._repr_html_(), value._repr_markdown_()
        parser = Balanced()
        parser.feed(html)
        assert not parser.open and parser.seen <= {"p", "table", "thead", "tbody", "tr", "th", "td"}, name
        assert 20 < len(html) < LARGEST and 20 < len(markdown) < LARGEST, name
        rows = [line for line in markdown.splitlines() if line.startswith("|")]
        assert len(rows) <= 2 * (MOST_ROWS + 2) and all(row.endswith("|") for row in rows)
    assert f"<td>k</td><td>{fit.theta['k']:.5g}</td>" in fit._repr_html_()


def test_everything_is_escaped(fit):
    bad = replace(fit, message="<script>alert(1)</script> | a\nb")
    assert "<script>" not in bad._repr_html_() and "&lt;script&gt;" in bad._repr_html_()
    assert "<script>" not in bad._repr_markdown_().replace("\\<", "") and "\\|" in bad._repr_markdown_()


@pytest.mark.parametrize(("module", "method"), [("pandas", "to_frame"), ("xarray", "to_xarray")])
def test_what_to_install(recording, monkeypatch, module, method):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ConfigError) as caught:
        getattr(recording, method)()
    assert caught.value.code == "needs-package" and "daest[frames]" in str(caught.value)
