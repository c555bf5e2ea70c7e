"""What only a simulation shows, and what is recorded and waits for its law."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from daest.diagnosis.built_in.chosen import chosen_candidates
from daest.diagnosis.evidence import stand as stand_module
from daest.diagnosis.evidence.open_loop import simulated_errors
from daest.diagnosis.evidence.stand import begin, reference_of
from daest.diagnosis.null_model.null import at_fit
from daest.diagnosis.options import DiagnoseOptions
from daest.diagnosis.screening.candidates import attached, fed
from daest.model.experiment import Experiment
from daest.modelica.compile import compile_text
from daest.modelica.effects.catalogue import effect_library
from daest.modelica.places.sites import sites, unused_inputs

MODELS = Path(__file__).with_name("models")


def model(name):
    return compile_text((MODELS / name).read_bytes(), Path(name))


def test_input_that_the_model_does_not_use_is_a_cause_like_a_column():
    """A sun that is declared, recorded and in no equation; its gain and its offset are none."""
    flat = model("SunnyRoom.mo")
    assert unused_inputs(flat) == ("sun",)
    rng = np.random.default_rng(1)
    records = [
        Experiment("day", np.arange(60.0), rng.standard_normal((60, 3)), rng.standard_normal((60, 1)),
                   ("Q", "Ta", "sun"), ("y",))
    ]  # fmt: skip
    found = chosen_candidates(
        effect_library(), sites(flat), records, DiagnoseOptions(), unused=unused_inputs(flat)
    )
    fed_by = {c.label for c in found if "sun" in c.inputs.values()}
    assert "MeasuredHeatGain (sun) at 0:T" in fed_by
    assert {c.label for c in found if "Ta" in c.inputs.values()} == {"Crosstalk (Ta) at y"}
    assert "Crosstalk (sun) at y" not in fed_by
    assert not any(c.site.name == "sun" for c in found)
    # The law takes the input that is there, in the recording and in the model.
    (gain,) = (c for c in found if c.label == "MeasuredHeatGain (sun) at 0:T")
    assert fed(records, gain)[0].input_names == ("Q", "Ta", "sun")
    assert attached(flat, [gain]).input_names == ("Q", "Ta", "sun")
    assert unused_inputs(attached(flat, [gain])) == ()


@pytest.mark.slow
def test_reference_keeps_the_simulation_that_unseen_data_like_less(monkeypatch):
    """Laws are looked for from the best simulation of what is fitted, and judged beside the best of unseen
    data: friction of a motor had had no screen in open loop where that was the fit beside white loads."""
    text = (MODELS / "SunnyRoom.mo").read_bytes()
    flat = compile_text(text, Path("SunnyRoom.mo"))
    rng = np.random.default_rng(5)
    heat = np.repeat(rng.uniform(0.0, 2000.0, 40), 12)
    inputs = np.column_stack([heat, np.full(480, 5.0), np.zeros(480)])
    T, course = 18.0, []
    for k in range(480):
        course.append(T)
        T += 600.0 * (heat[k] - 40.0 * (T - 5.0) + 300.0 * np.sin(k / 9.0)) / 6e5
    y = np.array(course)[:, None] + 0.05 * rng.standard_normal((480, 1))
    record = Experiment("day", 600.0 * np.arange(480.0), inputs, y, ("Q", "Ta", "sun"), ("y",))
    stand = begin(flat, [record], (), DiagnoseOptions(jobs=1))
    found = stand.reference
    assert found is not None and found.opened is not None and found.opened.method == "oe"
    worse = replace(
        found.opened.simulated["validation"],
        rms={name: 9.0 * rms for name, rms in found.opened.simulated["validation"].rms.items()},
    )
    opened = replace(found.opened, simulated={**found.opened.simulated, "validation": worse})
    monkeypatch.setattr(stand_module, "fit_by_simulation", lambda *_: opened)
    again = reference_of(stand.null, stand.baseline, stand.validation)
    assert again.fit.method == "pem" and again.opened is opened
    white = simulated_errors(at_fit(stand.null, again.fit), stand.validation)
    own = simulated_errors(at_fit(stand.null, opened), stand.validation)
    for one, other in zip(again.simulated.fitted, own.fitted, strict=True):
        assert_allclose(one, other)
    for one, other in zip(again.simulated.unseen, white.unseen, strict=True):
        assert_allclose(one, other)
    assert not np.allclose(white.unseen[0], own.unseen[0])
