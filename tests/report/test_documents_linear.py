"""Documents of `daest linearize` and `daest noise`: keys of the contract, plain JSON, numbers that fit the
values."""

from __future__ import annotations

import json

import casadi as ca
import numpy as np
import pytest

from daest.errors import Place
from daest.model.flat import FlatModel
from daest.model.parts import Equation, NoiseInput, Output, Parameter, Variable
from daest.report.documents import linearize as linearize_documents
from daest.report.documents import noise as noise_documents
from daest.report.texts import linearize as linearize_texts
from daest.report.texts import noise as noise_texts
from daest.systems.linear.linearize import linearize, theta_entries
from daest.systems.linear.noise import noise_report
from daest.systems.linear.split import split
from daest.systems.linear.transfer import transfer_functions


@pytest.fixture
def flat() -> FlatModel:
    """phi' = omega, m omega' = u - d omega + w, copy = phi + v, rate = copy': v would be differentiated."""
    der, xi = ca.SX.sym("der", 4), ca.SX.sym("xi", 4)
    u, w, theta = ca.SX.sym("u"), ca.SX.sym("w", 2), ca.SX.sym("theta", 2)
    phi, omega, copy, rate = ca.vertsplit(xi)
    m, d = ca.vertsplit(theta)
    texts = ["der(phi) = omega", "m*der(omega) = u - d*omega + w", "copy = phi + v", "rate = der(copy)"]
    residual = [der[0] - omega, m * der[1] - (u - d * omega + w[0]), copy - (phi + w[1]), rate - der[2]]
    return FlatModel(
        name="Cart",
        unknowns=(Variable("phi", "a"), Variable("omega", "b"), Variable("copy"), Variable("rate")),
        inputs=(Variable("u", "N"),),
        noises=(NoiseInput("w", 1.0), NoiseInput("v", 1.0)),
        parameters=(Parameter("m", 2.0, "kg", min=0.0), Parameter("d", 0.5, estimate=True)),
        outputs=(Output("y"),),
        equations=tuple(
            Equation(t, "component", "cart", Place("Cart.mo", i + 3)) for i, t in enumerate(texts)
        ),
        derivatives=der,
        xi=xi,
        u=u,
        w=w,
        theta=theta,
        time=ca.SX.sym("t"),
        residual=ca.vertcat(*residual),
        output_expressions=phi,
    )


def plain(document: dict) -> dict:
    """Through strict JSON: fails on NaN, infinity and numpy numbers."""
    return json.loads(json.dumps(document, allow_nan=False))


def test_linearize_document(flat: FlatModel) -> None:
    dae = linearize(flat)
    form = split(dae)
    found = plain(
        linearize_documents.document(
            dae, form, transfer_functions(dae, form), theta_entries(flat), {"a - b": 1e-12, "largest": 1e-12}
        )
    )
    contract = (
        "equations unknowns inputs outputs noises units parameters E J K B C D n_equations n_dynamic index "
        "poles transfer_functions theta source cross_check"
    )
    assert set(contract.split()) <= set(found)
    assert found["equations"][1] == {
        "index": 1,
        "text": "m*der(omega) = u - d*omega + w",
        "kind": "component",
        "origin": "cart",
        "place": "Cart.mo:4",
    }
    assert found["E"] == dae.E.tolist() and found["units"]["phi"] == "a"
    assert (found["n_equations"], found["n_dynamic"], found["index"]) == (4, 2, 2)
    np.testing.assert_allclose(found["poles"], [[-0.25, 0.0], [0.0, 0.0]], atol=1e-12)
    (function,) = found["transfer_functions"]
    np.testing.assert_allclose(function["num"], [0.5], rtol=1e-12)
    np.testing.assert_allclose(function["den"], [1.0, 0.25, 0.0], rtol=1e-12)
    assert {(e["matrix"], e["expression"]) for e in found["theta"]} == {("E", "m"), ("J", "-d")}
    assert found["cross_check"] == 1e-12 and found["cross_checks"] == {"a - b": 1e-12}
    assert found["parameters"][0] == {
        "name": "m",
        "value": 2.0,
        "unit": "kg",
        "min": 0.0,
        "max": None,
        "estimate": False,
    }


def test_noise_document(flat: FlatModel) -> None:
    found = plain(noise_documents.document(noise_report(linearize(flat), at=["w", 2])))
    contract = "n_equations n_dynamic index N_singular_values equations n_forbidden annotated decisions"
    assert set(contract.split()) <= set(found)
    assert [e["index"] for e in found["equations"] if not e["admissible"]] == [2]
    assert found["n_forbidden"] == 1
    bad = found["equations"][2]
    assert (
        bad["place"] == "Cart.mo:5"
        and bad["differentiated"] == ["rate"]
        and "rate = der(copy)" in bad["advice"]
    )
    assert [(a["name"], a["equations"], a["admissible"]) for a in found["annotated"]] == [
        ("w", [1], True),
        ("v", [2], False),
    ]
    assert [a["admissible"] for a in found["asked"]] == [True, False]
    assert found["all_admissible"] is False
    assert all(set(d) >= {"what", "singular_values", "threshold", "rank", "gap"} for d in found["decisions"])


def test_words_where_there_is_nothing(flat: FlatModel) -> None:
    document = noise_documents.document(noise_report(linearize(flat)))
    bare = {**document, "annotated": [], "n_forbidden": 0}
    shown = noise_texts.text(bare)
    assert "all of them may carry white noise" in shown and "Noise of the model\n  none: declare it" in shown
    assert "; 1 equation may not carry white noise" in noise_texts.text(document)
    dae = linearize(flat)
    form = split(dae)
    found = linearize_documents.document(dae, form, transfer_functions(dae, form), theta_entries(flat))
    zero = {"input": "u", "output": "y", "num": [0.0], "den": [1.0]}
    assert "u -> y:  0\n" in linearize_texts.text({**found, "transfer_functions": [zero]})
