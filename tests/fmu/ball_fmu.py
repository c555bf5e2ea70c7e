"""FMUs of the ball in `fmi2_ball.c`: well-behaved, with events, for Co-Simulation, or with a trap."""

import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
import scipy.integrate

from daest.numerics.compiler import build_shared

DESCRIPTION = """<fmiModelDescription fmiVersion="2.0" modelName="Ball" guid="{ball}"
 numberOfEventIndicators="INDICATORS" generationTool="test">
<KIND modelIdentifier="ball" canHandleVariableCommunicationStepSize="true"/>
<ModelVariables>
<ScalarVariable name="h" valueReference="0"><Real start="1" unit="m"/></ScalarVariable>
<ScalarVariable name="v" valueReference="1"><Real start="0" unit="m/s"/></ScalarVariable>
<ScalarVariable name="der(h)" valueReference="2"><Real derivative="1"/></ScalarVariable>
<ScalarVariable name="der(v)" valueReference="3"><Real derivative="2"/></ScalarVariable>
<ScalarVariable name="u" valueReference="4" causality="input"><Real start="0" unit="m/s2"/></ScalarVariable>
<ScalarVariable name="y" valueReference="5" causality="output"><Real unit="m"/></ScalarVariable>
<ScalarVariable name="w" valueReference="6"><Real unit="m/s"/></ScalarVariable>
<ScalarVariable name="d" valueReference="7" causality="parameter" variability="fixed">
<Real start="0.1" min="0" unit="1/m"/></ScalarVariable>
<ScalarVariable name="e" valueReference="8" causality="parameter" variability="tunable"><Real start="0.7"/>
</ScalarVariable>
<ScalarVariable name="g" valueReference="9" causality="parameter" variability="tunable">
<Real start="9.81" unit="m/s2"/></ScalarVariable>
</ModelVariables>
<ModelStructure><Outputs><Unknown index="6"/></Outputs>
<Derivatives><Unknown index="3"/><Unknown index="4"/></Derivatives></ModelStructure>
</fmiModelDescription>"""


def ball(folder, kind="ModelExchange", **flags):
    """The FMU, compiled with the flags BOUNCE, SWITCH, TRAP, TRAP_TIME."""
    if not sys.platform.startswith("linux"):
        pytest.skip("built for Linux")
    source = (Path(__file__).parent / "fmi2_ball.c").read_text()
    defines = tuple(f"-D{name}={value}" for name, value in flags.items())
    library = build_shared(source, "ball", ("-O1", *defines))
    path = Path(folder) / "ball.fmu"
    indicators = "1" if "BOUNCE" in flags else "0"
    with zipfile.ZipFile(path, "w") as archive:
        text = DESCRIPTION.replace("KIND", kind).replace("INDICATORS", indicators)
        archive.writestr("modelDescription.xml", text)
        archive.write(library, "binaries/linux64/ball.so")
    return path


def fall(time, u, d=0.1, g=9.81, h0=1.0, v0=0.0):
    """h(t), v(t) under straight lines between the samples of u, by an independent integrator."""

    def rate(t, x):
        return [x[1], -g - d * x[1] * abs(x[1]) + np.interp(t, time, u)]

    options = {"method": "DOP853", "rtol": 1e-10, "atol": 1e-12, "max_step": time[1] - time[0]}
    return scipy.integrate.solve_ivp(rate, (time[0], time[-1]), [h0, v0], t_eval=time, **options).y
