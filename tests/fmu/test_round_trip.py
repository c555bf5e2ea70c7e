"""The exported examples with their equations taken out give the same as their source."""

from pathlib import Path

import numpy as np
import pytest
from fmu_archives import changed

from daest.fmu.binary_model import binary_model
from daest.fmu.export import export_fmu
from daest.modelica.compile import compile_model
from daest.systems.linear.linearize import is_affine_model, linearize
from daest.systems.linear.split import split
from daest.systems.simulation.simulate import simulate

EXAMPLES = Path(__file__).parents[2] / "examples"
MODELS = sorted(path for folder in EXAMPLES.iterdir() for path in folder.glob("*.mo"))


@pytest.mark.slow
@pytest.mark.parametrize("path", MODELS, ids=lambda p: f"{p.parent.name}/{p.stem}")
def test_an_example_through_its_binary_alone(path, tmp_path):
    source = compile_model(path, None, ())
    export_fmu(source, tmp_path / "full.fmu")
    alone = binary_model(changed(tmp_path / "full.fmu", tmp_path / "alone.fmu", drop=["extra/"]))
    assert is_affine_model(alone) == is_affine_model(source)
    expected, found = (np.sort_complex(np.linalg.eigvals(split(linearize(m)).A)) for m in (source, alone))
    assert np.allclose(found, expected, rtol=1e-9, atol=1e-9 * np.max(np.abs(expected), initial=0.0))
    time = 0.01 * np.arange(200)
    start = np.array([v.start or 0.0 for v in source.inputs])
    u = start + 0.1 * np.cumsum(np.random.default_rng(1).standard_normal((200, start.size)), axis=0)
    one, other = simulate(source, (time, u)), simulate(alone, (time, u))
    size = np.max(np.abs(one.outputs), axis=0)
    assert np.allclose(other.outputs, one.outputs, rtol=1e-6, atol=1e-6 * np.max(size))
