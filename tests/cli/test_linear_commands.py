"""`daest linearize` and `daest noise` on models that are small enough to know by heart."""

import json

import numpy as np
import pytest
import scipy.io

POLE, GAIN = -1 / 0.4, 1.0 / 0.4  # of k / (T s + 1) with the values of the source, highest power alone

CIRCLE = """\
model Circle "Two equations that forbid noise: x is differentiated twice"
  input Real u(start = 0);
  input Real w annotation(__Daest(noise = true, intensity = 1e-3));
  output Real y;
  Real x(start = 0);
  Real v;
equation
  x = u + w;
  v = der(x);
  y = v;
end Circle;
"""


def test_poles_transfer_function_and_parameters(folder, daest):
    code, out, _ = daest("linearize", "Lag.mo", "--format", "json")
    document = json.loads(out)
    assert code == 0 and document["schema"] == "daest/linearize/1" and document["source"] == "symbolic"
    assert document["inputs"] == ["u"] and document["outputs"] == ["y"] and document["n_dynamic"] == 1
    assert document["poles"] == [pytest.approx([POLE, 0.0])]
    (transfer,) = document["transfer_functions"]
    assert transfer["num"] == pytest.approx([GAIN]) and transfer["den"] == pytest.approx([1.0, -POLE])
    assert {p["name"]: p["value"] for p in document["parameters"]} == {"T": 0.4, "k": 1.0}
    assert {tuple(entry["parameters"]) for entry in document["theta"]} == {("T",), ("k",)}
    assert [equation["place"] for equation in document["equations"]] == ["Lag.mo:8"]


def test_values_of_parameters(folder, daest):
    moved = json.loads(daest("linearize", "Lag.mo", "--set", "T=0.1", "--format", "json")[1])
    assert moved["poles"][0][0] == pytest.approx(-10.0)
    (folder / "at.json").write_text('{"parameters": {"T": {"value": 0.2}}}')
    moved = json.loads(daest("linearize", "Lag.mo", "--at", "at.json", "--format", "json")[1])
    assert moved["poles"][0][0] == pytest.approx(-5.0)


def test_arrays_are_the_matrices(folder, daest):
    document = json.loads(daest("linearize", "Lag.mo", "--format", "json")[1])
    assert daest("linearize", "Lag.mo", "-o", "lag.npz")[0] == 0
    assert daest("linearize", "Lag.mo", "-o", "lag.mat")[0] == 0
    arrays, matlab = np.load(folder / "lag.npz"), scipy.io.loadmat(folder / "lag.mat")
    for name in ("E", "J", "K", "C", "D"):
        assert np.array_equal(arrays[name], np.array(document[name]))
        assert np.array_equal(matlab[name], np.array(document[name]))
    assert list(arrays["unknowns"]) == document["unknowns"]


def test_document_in_a_file_and_expressions_in_text(folder, daest):
    code, out, _ = daest("linearize", "Lag.mo", "-o", "lag.json")
    assert code == 0 and out == ""
    assert json.loads((folder / "lag.json").read_text())["schema"] == "daest/linearize/1"
    text = daest("linearize", "Lag.mo", "--symbolic")[1]
    assert "u -> y:  (2.5) / (s + 2.5)" in text and "-2.5" in text and "Entries that depend" in text


def test_noise_on_a_forbidden_equation_is_1(folder, daest):
    (folder / "Circle.mo").write_text(CIRCLE)
    code, out, _ = daest("noise", "Circle.mo", "--format", "json", "--plot", "n.png")
    document = json.loads(out)
    assert code == 1 and document["schema"] == "daest/noise/1"
    assert document["annotated"][0]["name"] == "w" and document["annotated"][0]["admissible"] is False
    assert document["n_forbidden"] >= 1 and document["annotated"][0]["advice"]
    assert (folder / "n.png").read_bytes().startswith(b"\x89PNG")
    code, text, _ = daest("noise", "Circle.mo")
    assert code == 1 and "No white noise here" in text and "NO" in text


def test_places_that_are_asked_for(folder, daest):
    code, out, _ = daest("noise", "Lag.mo", "--format", "json")
    assert code == 0 and json.loads(out)["n_forbidden"] == 0
    code, out, _ = daest("noise", "Lag.mo", "--at", "0", "--format", "json")
    assert code == 0 and json.loads(out)["asked"][0]["admissible"] is True


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["linearize", "Lag.mo", "--set", "z=1"], "parameter-unknown"),
        (["linearize", "Lag.mo", "--at", "none.json"], "results-unreadable"),
        (["linearize", "Lag.mo", "--at", "empty.json"], "at-without-values"),
        (["noise", "Lag.mo", "--at", "nowhere"], "noise-place-unknown"),
        (["linearize"], "model-not-given"),
        (["noise", "None.fmu"], "model-missing"),
    ],
)
def test_refusals(folder, daest, arguments, code):
    (folder / "empty.json").write_text("{}")
    status, out, err = daest(*arguments)
    assert status == 2 and out == "" and f"error[{code}]" in err and "help: " in err
