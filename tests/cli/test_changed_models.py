"""Models that have changed since their fit: every command that takes values from it says so, and how to go
on."""

import json
import shutil
from contextlib import chdir

import pytest
from cart_data import CART, write_recording
from cart_data import recording as cart_recording
from lag_data import LAG, PROJECT, write_lag

from daest.cli.main import run

MOVED = LAG.replace('Real k(unit = "1") = 1.0', 'Real k(unit = "1") = 3.0')
WHAT = "Lag has changed since the fit"


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """A fit to run1."""
    made = tmp_path_factory.mktemp("fitted")
    write_lag(made)
    (made / "daest.toml").write_text(PROJECT + 'hold = "zoh"\n')
    with chdir(made):
        assert run(["identify"]) == 0
    return made / "results"


@pytest.fixture
def kept(folder, results):
    """The folder with that fit."""
    (folder / "daest.toml").write_text(PROJECT + 'hold = "zoh"\n')
    shutil.copytree(results, folder / "results")
    return folder


@pytest.fixture
def moved(kept):
    """The same, and then another value in the model."""
    (kept / "Lag.mo").write_text(MOVED)
    return kept


def said(notes: list[str]) -> str:
    """The note on the changed model, of which there is one."""
    (note,) = (note for note in notes if WHAT in note)
    return note


def notes_of_compare(daest) -> list[str]:
    code, out, err = daest("compare", "--format", "json")
    assert code == 0, err
    return json.loads(out)["models"][0]["notes"]


def test_compare_says_so_and_keeps_to_the_fit(kept, daest):
    before = json.loads(daest("compare", "--format", "json")[1])["models"][0]
    assert not any(WHAT in note for note in before["notes"])
    (kept / "Lag.mo").write_text(MOVED)
    after = json.loads(daest("compare", "--format", "json")[1])["models"][0]
    assert after["rms"] == before["rms"]
    note = said(after["notes"])
    assert "k is 3 and was 1" in note and "T is" not in note and "equations" not in note
    assert "run daest identify again" in note and "fit.json and " in note
    assert "k is 3 and was 1" in " ".join(daest("compare")[1].split())


@pytest.mark.parametrize("command", ["filter", "simulate", "report"])
def test_other_commands_say_so(command, moved, daest):
    code, out, err = daest(command, "--format", "json")
    assert code == 0, err
    assert "k is 3 and was 1" in said(json.loads(out)["notes"])
    assert "k is 3 and was 1" in said(err.splitlines())


@pytest.mark.slow  # the other commands: above
@pytest.mark.parametrize(("name", "is_taken"), [("other.csv", True), ("one.csv", False)])
def test_diagnose_says_so_where_it_takes_the_values(tmp_path, monkeypatch, daest, name, is_taken):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "Cart.mo").write_text(CART)
    for seed, file in enumerate(("one.csv", "other.csv")):
        write_recording(tmp_path / file, cart_recording(420, seed))
    model = ("--model", "Cart.mo", "--hold", "zoh", "--format", "json")
    assert daest("identify", "one.csv", *model)[0] == 0
    (tmp_path / "Cart.mo").write_text(CART.replace("= 1.3", "= 1.2"))
    code, out, err = daest("diagnose", name, "--effect", "HardeningSpring", *model)
    assert code == 0, err
    for notes in (json.loads(out)["notes"], err.splitlines()):
        said = any("has changed since the fit" in n and "m is 1.2 and was 1.3" in n for n in notes)
        assert said is is_taken


def test_the_page_says_so(moved, daest):
    assert daest("report")[0] == 0
    assert "k is 3 and was 1" in (moved / "report.html").read_text("utf-8")


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("k*u - x", "k*u - x^3", "its equations are others"),
        ("y = x;", "y = 2*x;", "the output y is another"),
    ],
)
def test_equations_and_outputs(old, new, what, kept, daest):
    (kept / "Lag.mo").write_text(LAG.replace(old, new))
    note = said(notes_of_compare(daest))
    assert what in note and " and was " not in note


def test_values_of_the_project(kept, daest):
    with (kept / "daest.toml").open("a") as project:
        project.write("[parameters]\nT = { start = 0.7 }\n")
    assert "T is 0.7 and was 0.4" in said(notes_of_compare(daest))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("Time constant", "Time it takes"),
        ("equation", "  // a remark\nequation"),
        ("std = 0.02", "std = 0.03"),
    ],
)
def test_words_and_noises_are_no_change(old, new, kept, daest):
    assert LAG.count(old) == 1
    (kept / "Lag.mo").write_text(LAG.replace(old, new))
    assert not any(WHAT in note for note in notes_of_compare(daest))


def test_both_ways_on_that_are_named(moved, daest):
    assert daest("identify")[0] == 0
    assert not any(WHAT in note for note in notes_of_compare(daest))
    (moved / "Lag.mo").write_text(LAG)
    named = said(notes_of_compare(daest)).partition("or remove ")[2].partition(" to use")[0]
    for path in named.split(" and "):
        (moved / path).unlink()
    assert "no fit found" in notes_of_compare(daest)[0]


def test_a_held_value_of_the_command_is_no_change(kept, daest):
    assert daest("identify", "--fix", "k=1.5")[0] == 0
    assert not any(WHAT in note for note in notes_of_compare(daest))


def test_silent_about_fits_without_fingerprint(moved, daest):
    for path in (moved / "results" / "fit.json", moved / "results" / "fits" / "Lag.json"):
        document = json.loads(path.read_text())
        del document["model"]["fingerprint"]
        path.write_text(json.dumps(document))
    assert not any(WHAT in note for note in notes_of_compare(daest))
