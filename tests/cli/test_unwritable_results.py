"""Where `results/` cannot be written the result is told all the same, and the one error comes after it."""

import json

import pytest
from cart_data import CART, write_recording
from cart_data import recording as cart_recording
from lag_data import PROJECT


@pytest.fixture
def closed(folder):
    """A project whose results cannot be written: their folder is a file (root may write anywhere else)."""
    (folder / "daest.toml").write_text(PROJECT)
    (folder / "results").write_text("in the way")
    return folder


def assert_told(err: str, file: str) -> None:
    assert err.count("error[") == 1 and "error[output-unwritable]" in err and f"results/{file}" in err
    assert "Traceback" not in err and "the fit is in" not in err and "diagnosis is in" not in err


def test_identify(closed, daest):
    code, out, err = daest("identify")
    assert code == 2 and "Parameters" in out and "validation" in out
    assert_told(err, "fits/Lag.json")
    assert "copy of the project" in err
    code, out, err = daest("identify", "--format", "json")
    assert code == 2 and json.loads(out)["parameters"]["k"]["value"] == pytest.approx(2.0, rel=0.05)
    assert_told(err, "fits/Lag.json")


def test_filter(closed, daest):
    code, out, err = daest("filter", "run2.csv")
    assert code == 2 and "filter, log-likelihood" in out
    assert_told(err, "estimates.csv")


def test_compare_keeps_nothing_and_says_so(closed, daest):
    code, out, err = daest("compare", "--refit")
    assert code == 0 and "one-step errors are" in out
    assert "the fit of Lag is not kept" in err and "not kept for daest report" in err


@pytest.mark.slow  # the other commands: the tests above
@pytest.mark.parametrize(
    ("command", "friction", "begins", "file"),
    [
        ("diagnose", 0.0, "Nothing missing.", "diagnosis.json"),
        ("improve", 0.0, "Nothing added.", "improve"),
    ],
)
def test_search(closed, daest, command, friction, begins, file):
    (closed / "daest.toml").unlink()
    (closed / "Cart.mo").write_text(CART)
    write_recording(closed / "run.csv", cart_recording(600, 1, friction))
    arguments = ("run.csv", "--model", "Cart.mo", "--hold", "zoh", "--effect", "CoulombFriction")
    code, out, err = daest(command, *arguments, "--at", "cart.flange_a", "--jobs", "1")
    assert code == 2 and out.startswith(begins)
    assert_told(err, file)
    assert "staircase.png are in" not in out
    assert (closed / "results").read_text() == "in the way"
