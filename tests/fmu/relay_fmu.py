"""FMUs of `fmi2_relay.c`, whose outputs depend on what events and steps have left behind."""

import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from daest.numerics.compiler import build_shared

DESCRIPTION = """<fmiModelDescription fmiVersion="2.0" modelName="Relay" guid="{relay}"
 numberOfEventIndicators="INDICATORS"><ModelExchange modelIdentifier="relay"/>
<ModelVariables>
<ScalarVariable name="x" valueReference="0"><Real start="0"/></ScalarVariable>
<ScalarVariable name="der(x)" valueReference="1"><Real derivative="1"/></ScalarVariable>
<ScalarVariable name="u" valueReference="2" causality="input"><Real start="0"/></ScalarVariable>
<ScalarVariable name="y" valueReference="3" causality="output"><Real/></ScalarVariable>
</ModelVariables>
<ModelStructure><Outputs><Unknown index="4"/></Outputs><Derivatives><Unknown index="2"/></Derivatives>
</ModelStructure></fmiModelDescription>"""
STEP = 1e-4


def relay(folder, memory):
    """The FMU, with RELAY, STUCK, UNREAD, CLOCK, STEPS or DELAY for its memory."""
    if not sys.platform.startswith("linux"):
        pytest.skip("built for Linux")
    source = (Path(__file__).parent / "fmi2_relay.c").read_text()
    library = build_shared(source, "relay", ("-O1", f"-DMEMORY={memory}"))
    path = Path(folder) / "relay.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        indicators = int(memory in ("RELAY", "STUCK", "UNREAD"))
        archive.writestr("modelDescription.xml", DESCRIPTION.replace("INDICATORS", str(indicators)))
        archive.write(library, "binaries/linux64/relay.so")
    return path


def expected(memory, time, u):
    """y(t) with straight lines between the samples of u, by short steps of the exact law between them."""
    fine = np.arange(0.0, time[-1] + STEP / 2, STEP)
    inputs = np.interp(fine, time, u)
    x, m, y = 0.0, 1.0, np.empty(fine.size)
    for k, t in enumerate(fine):
        if memory in ("RELAY", "STUCK", "UNREAD"):
            m = -1.0 if x > 0.5 else 1.0 if x < -0.5 else m
        elif memory == "DELAY":
            m = np.interp(t - 0.4, time, u) if t > 0.4 else 0.0
        else:
            m = (-1.0) ** int(t / 0.4 + 1e-9)
        y[k] = x + m
        middle = m + inputs[k] + 0.5 * (inputs[min(k + 1, fine.size - 1)] - inputs[k])
        x += (1.0 - np.exp(-STEP)) * (middle - x)
    return y[np.round(time / STEP).astype(int)]
