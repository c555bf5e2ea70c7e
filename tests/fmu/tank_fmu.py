"""The FMU of the tank in `fmi3_tank.c`."""

import zipfile
from pathlib import Path

import numpy as np
import scipy.integrate

from daest.numerics.compiler import build_shared

H, U, Y, K = 1, 3, 4, 5
TANK = """<fmiModelDescription fmiVersion="3.0" modelName="Tank" instantiationToken="{tank}">
<ModelExchange modelIdentifier="tank" ONCE/>
<ModelVariables>MORE<Float64 name="time" valueReference="0" causality="independent"/>
<Float64 name="h" valueReference="1" start="1"/><Float64 name="der(h)" valueReference="2" derivative="1"/>
<Float64 name="u" valueReference="3" causality="input" start="0"/>
<Float64 name="y" valueReference="4" causality="output"/>
<Float64 name="k" valueReference="5" causality="parameter" variability="tunable" start="0.5"/>
</ModelVariables><ModelStructure><Output valueReference="4"/>
<ContinuousStateDerivative valueReference="2"/></ModelStructure></fmiModelDescription>"""


def tank(folder, only_once=False, more="", **flags):
    """The FMU, compiled with ONLY_ONCE and the flags given."""
    source = (Path(__file__).parent / "fmi3_tank.c").read_text()
    defines = tuple(f"-D{name}={value}" for name, value in flags.items())
    library = build_shared(source, "tank", ("-O1", f"-DONLY_ONCE={int(only_once)}", *defines))
    once = 'canBeInstantiatedOnlyOncePerProcess="true"' if only_once else ""
    path = Path(folder) / "tank.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", TANK.replace("ONCE", once).replace("MORE", more))
        archive.write(library, "binaries/x86_64-linux/tank.so")
    return path


def levels(k, time, h0=1.0):
    """h(t) from h0 with the inflow 0.3, by an independent integrator."""

    def rate(t, h):
        return 0.3 - k * np.sqrt(h)

    return scipy.integrate.solve_ivp(rate, (0, time[-1]), [h0], t_eval=time, rtol=1e-10, atol=1e-12).y[0]
