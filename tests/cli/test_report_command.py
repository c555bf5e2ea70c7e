"""`daest report`: the parts of the page, what is said of those that are missing, that texts of the user are
harmless, and that a browser shows it without a complaint."""

from __future__ import annotations

import json
import re
import shutil
from contextlib import chdir
from itertools import product
from pathlib import Path

import html5lib
import numpy as np
import pytest
from lag_data import LAG, PROJECT, recording, write_csv, write_lag

from daest.cli.main import run
from daest.model.holds import hold_text
from daest.report.documents.fit import FitDocument
from daest.report.documents.parts import facts

EVIL = "<script>alert('x')</script><img src=x onerror=alert(1)>"
HELD = PROJECT + 'hold = "zoh"\n'
PARTS = (
    "comparison",
    "failures",
    "diagnosis",
    "experiment",
    "ledger",
    "modelica",
    "estimation",
    "residuals",
    "filter",
    "noise",
    "model",
    "origin",
)
SEARCHED = ("diagnosis", "experiment", "ledger", "modelica")  # parts that only a search makes
MOST_BYTES = 6_000_000
NAMESPACE = "{http://www.w3.org/1999/xhtml}"


@pytest.fixture
def project(folder):
    (folder / "daest.toml").write_text(HELD)
    return folder


def write_project(folder: Path) -> None:
    write_lag(folder)
    (folder / "daest.toml").write_text(HELD)


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """What the quick commands leave in the folder of the project."""
    made = tmp_path_factory.mktemp("told")
    write_project(made)
    with chdir(made):
        assert [run([command]) for command in ("identify", "noise", "compare", "filter")] == [0] * 4
    return made / "results"


@pytest.fixture
def told(project, results):
    """A project in which the quick commands have run."""
    shutil.copytree(results, project / "results")
    return project


def keep_only(folder: Path, *names: str) -> None:
    """Of the results, those that the test is about: a plot of any other takes its time."""
    for file in (folder / "results").iterdir():
        if file.is_file() and file.name.partition(".")[0] not in names:
            file.unlink()


@pytest.fixture(scope="module")
def page(results):
    """The page on what the quick commands leave."""
    with chdir(results.parent):
        assert run(["report", "-o", "page.html"]) == 0
    return results.parent / "page.html"


def parsed(path: Path):
    """The tree of a page that an HTML5 parser finds without fault."""
    return html5lib.HTMLParser(strict=True).parse(path.read_text(encoding="utf-8"))


def elements(tree, name: str):
    return list(tree.iter(NAMESPACE + name))


def text_of(tree, part: str) -> str:
    (section,) = [e for e in elements(tree, "section") if e.get("id") == part]
    return " ".join(" ".join(section.itertext()).split())


def is_missing(tree, part: str) -> bool:
    return "Not here yet:" in text_of(tree, part)


def test_summary_says_what_is_missing(told, daest):
    keep_only(told, "fit", "filter", "estimates")
    code, out, _ = daest("report")
    assert code == 0 and "report.html" in out and "not in it: What is missing: the diagnosis" in out
    assert "daest diagnose makes it" in out and "daest identify makes it" not in out
    document = json.loads(daest("report", "--format", "json")[1])
    present = {part["id"]: part["present"] for part in document["parts"]}
    assert present["filter"] and not present["ledger"]
    assert document["bytes"] == (told / "report.html").stat().st_size
    assert daest("report", "-o", "-")[1].startswith("<!DOCTYPE html>")


def test_nothing_to_report_on(tmp_path, monkeypatch, daest):
    monkeypatch.chdir(tmp_path)
    code, out, err = daest("report")
    assert code == 2 and "error[report-nothing]" in err and out == ""
    assert not list(tmp_path.iterdir())


def test_a_new_project_has_its_model_and_is_told_what_to_run(project, daest):
    assert daest("report")[0] == 0
    tree = parsed(project / "report.html")
    assert [e.get("id") for e in elements(tree, "section")] == list(PARTS)
    assert not is_missing(tree, "model")
    made_by = {"noise": "noise", "estimation": "identify", "comparison": "compare", "filter": "filter"}
    made_by |= {"diagnosis": "diagnose", "ledger": "improve", "modelica": "improve"}
    for part, command in made_by.items():
        assert is_missing(tree, part) and f"daest {command}" in text_of(tree, part)
    assert "T*der(x) = k*u - x" in text_of(tree, "model")


def test_results_are_shown_with_their_numbers(page, results):
    tree = parsed(page)
    present = [part for part in PARTS if not is_missing(tree, part)]
    assert present == [part for part in PARTS if part not in SEARCHED]
    fit = json.loads((results / "fit.json").read_text())
    for parameter in fit["parameters"].values():
        assert f"{parameter['value']:.6g}" in text_of(tree, "estimation")
    for fact in facts(FitDocument, fit):
        assert fact in text_of(tree, "estimation")
    assert hold_text(fit["hold"]) in text_of(tree, "estimation")
    digest = next(f["sha256"] for f in fit["made_from"]["files"] if f["path"] == "run1.csv")
    assert digest[:16] in text_of(tree, "origin") and "unchanged" in text_of(tree, "origin")


@pytest.mark.slow  # test_several_models.py
def test_several_models_are_numbered_and_their_tests_side_by_side(told, daest):
    keep_only(told, "fit")
    name = "Lag_with_a_name_that_is_much_longer_than_a_telephone_is_wide"
    (told / "Long.mo").write_text(LAG.replace("model Lag", f"model {name}").replace("end Lag", f"end {name}"))
    code, _, err = daest("compare", "Lag.mo", "Long.mo")
    assert code == 0, err
    assert daest("report")[0] == 0
    tree = parsed(told / "report.html")
    models = json.loads((told / "results" / "comparison.json").read_text())["models"]
    for part in ("comparison", "residuals"):
        for i, model in enumerate(models, 1):
            assert f"{i} {model['name']}" in text_of(tree, part).replace("_ ", "_")
    text = text_of(tree, "residuals")
    tests = [test for model in models for by_output in model["tests"].values() for test in by_output.values()]
    assert text.count("passed") == sum(test["pass"] for test in tests)
    assert text.count("failed") == sum(not test["pass"] for test in tests)
    (section,) = [e for e in elements(tree, "section") if e.get("id") == "comparison"]
    bars = [e.get("style") for e in elements(section, "span") if e.get("class") == "fill"]
    largest = max(model["rms"]["y"] for model in models)
    parts = [f"width: {round(100.0 * model['rms']['y'] / largest, 1)}%" for model in models]
    assert bars == parts
    assert len(elements(section, "wbr")) >= name.count("_")


def test_page_is_one_file_of_bearable_size(page):
    assert page.stat().st_size < MOST_BYTES
    tree = parsed(page)
    for element in tree.iter():
        if not isinstance(element.tag, str):
            continue
        for name in ("src", "href", "action", "data", "poster", "srcset"):
            value = element.get(name)
            assert value is None or value.startswith(("#", "data:")), (element.tag, value)
    for style in elements(tree, "style"):
        assert "url(" not in style.text and "@import" not in style.text


def test_series_of_the_plots_are_those_of_the_results(page, results):
    tree = parsed(page)
    scripts = [s for s in elements(tree, "script") if s.get("data-plot")]
    targets = {s.get("data-plot") for s in scripts}
    assert {"plot-structure", "plot-parameters", "plot-compare-0", "plot-filter", "plot-white-0"} <= targets
    item = next(s.text for s in scripts if s.get("data-plot") == "plot-compare-0")
    assert json.loads(item)["doc"]["roots"]
    ids = {e.get("id") for e in elements(tree, "div")}
    assert targets <= ids
    with np.load(results / "comparison.npz") as series:
        assert series["0.measured"].shape == (300, 1) == series["0.0.simulated"].shape


def test_texts_of_the_user_are_harmless(folder, daest):
    evil = LAG.replace('"Time constant"', json.dumps(EVIL)).replace("First-order lag", EVIL.replace('"', ""))
    (folder / "Lag.mo").write_text(evil)
    (folder / "daest.toml").write_text(HELD.replace("run2.csv", "</script><b>.csv"))
    (folder / "</script><b>.csv").parent.mkdir(exist_ok=True)
    write_csv(folder / "</script><b>.csv", *recording(300, 2))
    for command in ("identify", "compare", "filter", "report"):
        code, _, err = daest(command)
        assert code == 0, err
    tree = parsed(folder / "report.html")
    assert EVIL in "".join(elements(tree, "main")[0].itertext())
    assert not elements(tree, "img") and not elements(tree, "b")
    assert not [
        s for s in elements(tree, "script") if "alert('x')" in (s.text or "") and not s.get("data-plot")
    ]


def test_texts_inside_results_are_harmless(told, daest):
    keep_only(told, "fit")
    path = told / "results" / "fit.json"
    document = json.loads(path.read_text())
    document["message"] = EVIL
    document["parameters"][EVIL] = document["parameters"].pop("T")
    path.write_text(json.dumps(document))
    assert daest("report")[0] == 0
    page = (told / "report.html").read_text()
    assert "<script>alert" not in page and "<img" not in page
    parsed(told / "report.html")


# Each file and each damage once; the other pairs among the slow tests.
DAMAGED = [
    ("{", "fit.json"), ("[]", "comparison.json"), ('{"schema": "x"}', "filter.json"), ("[]", "noise.json"),
]  # fmt: skip
PAIRS = product(("{", "[]", '{"schema": "x"}'), ("fit.json", "comparison.json", "filter.json", "noise.json"))


@pytest.mark.parametrize(
    ("content", "name"),
    [pytest.param(*pair, marks=() if pair in DAMAGED else pytest.mark.slow) for pair in PAIRS],
)
def test_damaged_results_are_named(told, daest, name, content):
    keep_only(told, name.partition(".")[0])
    (told / "results" / name).write_text(content)
    code, _, err = daest("report")
    assert code == 2 and "error[results-unreadable]" in err and "Traceback" not in err
    assert not (told / "report.html").exists()


def test_series_that_are_gone_are_named(told, daest):
    (told / "results" / "comparison.npz").unlink()
    code, _, err = daest("report")
    assert code == 2 and "comparison.npz" in err and "daest compare" in err


def test_a_file_that_changed_since_is_told(told, daest):
    keep_only(told, "fit")
    write_csv(told / "run1.csv", *recording(400, 7))
    (told / "run2.csv").unlink()
    assert daest("report")[0] == 0
    said = text_of(parsed(told / "report.html"), "origin")
    assert "changed" in said and "missing" in said


def test_a_model_that_cannot_be_read_leaves_the_rest(told, daest):
    keep_only(told, "fit")
    (told / "Lag.mo").write_text("model Lag\n")
    assert daest("report")[0] == 0
    tree = parsed(told / "report.html")
    assert is_missing(tree, "model") and not is_missing(tree, "estimation")
    assert "The model cannot be read" in " ".join(tree.itertext())


def test_diagnosis_and_ledger(told, daest):
    """Documents of a diagnosis and an improvement, as those commands write them."""
    results = told / "results"
    (results / "improve").mkdir()
    model = LAG + '\nmodel Lag_Drag "Lag with drag"\n  extends Lag;\nend Lag_Drag;\n'
    (results / "improve" / "step1_Drag.mo").write_text(model)
    curve = {
        "place": "axle",
        "variable": "x",
        "unit": "N",
        "variable_unit": "V",
        "label": "x",
        "p_value": 1e-9,
        "curve": [[-1.0, -2.0, 0.1], [0.0, 0.0, 0.1], [1.0, 2.0, 0.1]],
    }
    diagnosis = {
        "verdict": "supported",
        "message": "Drag at axle.",
        "baseline": {"rms": {"validation": {"y": 0.2}}},
        "candidates": [
            {
                "effect": "Drag",
                "at": "axle",
                "equivalent_places": ["wheel"],
                "parameters": {"k": {"value": 2.0, "std_error": 0.1, "unit": "N"}},
                "rms": {"validation": {"y": 0.02}},
                "delta_bic": 99.0,
                "verdict": "supported",
                "reason": "",
                "model": model,
            }
        ],
        "screen": {"best": [{"effect": "Drag", "at": "axle", "score": 9.0}]},
        "disturbance": curve,
        "outputs": {"y": "V"},
        "next_experiment": "",
    }
    steps = [
        {"added": None, "at": None, "component": None, "rms": {"validation": {"y": 0.2}}, "parameters": {}},
        {
            "added": "Drag",
            "at": "axle",
            "component": "drag",
            "rms": {"validation": {"y": 0.02}},
            "delta_bic": 99.0,
            "parameters": {"drag.k": {"value": 2.0, "std_error": 0.1, "unit": "N"}},
            "disturbance": curve,
            "model": "step1_Drag.mo",
        },
    ]
    ledger = {"steps": steps, "outputs": {"y": "V"}, "reason": "Nothing is missing."}
    (results / "diagnosis.json").write_text(json.dumps(diagnosis))
    (results / "improve" / "ledger.json").write_text(json.dumps(ledger))
    assert daest("report")[0] == 0
    tree = parsed(told / "report.html")
    assert [part for part in PARTS if is_missing(tree, part)] == ["experiment"]
    assert "k = 2 ± 0.1 N" in text_of(tree, "ledger") and "Drag" in text_of(tree, "diagnosis")
    marked = [e for e in elements(tree, "span") if e.get("class") == "hll"]
    said = ["".join(e.itertext()).strip() for e in marked]
    assert said == ['model Lag_Drag "Lag with drag"', "extends Lag;", "end Lag_Drag;"]
    plots = {s.get("data-plot") for s in elements(tree, "script")}
    assert {"plot-screen", "plot-curve", "plot-curve-1", "plot-staircase-0"} <= plots


@pytest.mark.slow
def test_a_designed_experiment(told, daest):
    """Its input as a plot, what it promises beside what there is, and the safe range."""
    keep_only(told, "fit")
    limits = ("--limit", "u=-1.5,1.5", "--limit", "y=-4,4", "--length", "10", "--seconds", "0.5")
    assert daest("design", *limits, "-o", "input.csv")[0] == 0
    assert daest("report")[0] == 0
    tree = parsed(told / "report.html")
    text = text_of(tree, "experiment")
    found = json.loads((told / "results" / "design.json").read_text())
    assert found["message"] in text and "input.csv" in text
    for part in ("predicted", "present", "together"):
        for error in found[part]["std_errors"].values():
            assert f"{error:.3g}" in text
    assert "Safe ranges" in text and all(f["name"] in text for f in found["families"])
    played = np.genfromtxt(told / "input.csv", delimiter=",", skip_header=1)
    kept = np.load(told / "results" / "design.npz")
    np.testing.assert_allclose(kept["inputs"][:, 0], played[:, 1], rtol=1e-6, atol=1e-9)
    assert 'data-plot="plot-experiment"' in (told / "report.html").read_text()


def test_the_last_round_of_an_improvement_is_a_diagnosis(told, daest):
    keep_only(told)
    results = told / "results"
    (results / "improve").mkdir()
    final = {
        "verdict": "unknown effect",
        "message": "Something unknown.",
        "baseline": {"rms": {}},
        "candidates": [],
        "screen": {"best": []},
        "disturbance": None,
        "outputs": {"y": "V"},
        "next_experiment": "Shake it.",
    }
    step = {"added": None, "at": None, "component": None, "rms": {"validation": {"y": 0.2}}, "parameters": {}}
    ledger = {"steps": [step], "outputs": {"y": "V"}, "reason": "Unknown.", "final": final}
    (results / "improve" / "ledger.json").write_text(json.dumps(ledger))
    assert daest("report")[0] == 0
    tree = parsed(told / "report.html")
    assert "unknown effect" in text_of(tree, "diagnosis") and "Shake it." in text_of(tree, "diagnosis")
    assert is_missing(tree, "modelica") and "has found nothing to add" in text_of(tree, "modelica")


def test_palette_is_seen_on_both_grounds():
    from daest.report.page.plots import COLORS, MEASURED

    style = (Path(__file__).parents[2] / "toolchain/daest/report/page/style.css").read_text()
    grounds = re.findall(r"--surface: (#\w+)", style)
    inks = re.findall(r"--ink: (#\w+)", style)
    softs = re.findall(r"--soft: (#\w+)", style)
    assert len(grounds) == 3
    for ground, ink, soft in zip(grounds, inks, softs, strict=True):
        assert min(contrast(ground, ink), contrast(ground, soft)) >= 4.5
        assert min(contrast(ground, color) for color in (*COLORS, MEASURED)) >= 3.0


def contrast(one: str, other: str) -> float:
    """Contrast of WCAG 2.1."""

    def luminance(color: str) -> float:
        parts = np.array([int(color[i : i + 2], 16) for i in (1, 3, 5)]) / 255
        linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
        return float(linear @ [0.2126, 0.7152, 0.0722])

    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.browser
def test_a_browser_shows_it_without_complaint(page, watched):
    watched.page.goto(page.as_uri())
    watched.page.wait_for_selector("html[data-ready]", timeout=20_000)
    for width, scheme in watched.screens():
        assert watched.fits(), width
        ground = watched.page.evaluate("getComputedStyle(document.body).backgroundColor")
        assert ground == ("rgb(255, 255, 255)" if scheme == "light" else "rgb(17, 22, 29)")
    assert watched.complaints == []
    assert watched.requests and watched.loaded_from_outside == []


@pytest.mark.browser
def test_keyboard_moves_and_zooms(page, browser):
    shown = browser.new_page()
    shown.goto(page.as_uri())
    shown.wait_for_selector("html[data-ready]", timeout=20_000)
    start = "Bokeh.documents.flatMap(d => [...d.all_models]).find(m => m.name === 'compare').x_range"
    shown.focus("#plot-compare-0")
    before = shown.evaluate(f"[{start}.start, {start}.end]")
    shown.keyboard.press("+")
    zoomed = shown.evaluate(f"[{start}.start, {start}.end]")
    assert zoomed[1] - zoomed[0] == pytest.approx(0.8 * (before[1] - before[0]))
    shown.keyboard.press("ArrowRight")
    moved = shown.evaluate(f"[{start}.start, {start}.end]")
    assert moved[0] - zoomed[0] == pytest.approx(0.1 * (zoomed[1] - zoomed[0]))
    shown.keyboard.press("0")
    shown.wait_for_timeout(300)
    assert shown.evaluate(f"[{start}.start, {start}.end]") == pytest.approx(before)
    shown.close()
