"""The FMU of `hostile.c`, built when it is needed."""

import zipfile
from pathlib import Path

from daest.numerics.compiler import build_shared

Y = 3
DESCRIPTION = """<fmiModelDescription fmiVersion="2.0" modelName="Hostile" guid="{h}"
 numberOfEventIndicators="0">
<ModelExchange modelIdentifier="hostile"/>
<ModelVariables>
<ScalarVariable name="h" valueReference="0"><Real start="1"/></ScalarVariable>
<ScalarVariable name="der(h)" valueReference="1"><Real derivative="1"/></ScalarVariable>
<ScalarVariable name="u" valueReference="2" causality="input"><Real start="0"/></ScalarVariable>
<ScalarVariable name="y" valueReference="3" causality="output"><Real/></ScalarVariable>
<ScalarVariable name="k" valueReference="4" causality="parameter" variability="tunable"><Real start="1"/>
</ScalarVariable>
</ModelVariables><ModelStructure><Outputs><Unknown index="4"/></Outputs>
<Derivatives><Unknown index="2"/></Derivatives></ModelStructure></fmiModelDescription>"""


def hostile(folder: Path, deed: int, place: Path | str = "", port: int = 9) -> Path:
    """The FMU that does `deed`."""
    source = (Path(__file__).parent / "hostile.c").read_text()
    flags = ("-O1", f"-DDEED={deed}", f'-DPLACE="{place}"', f"-DPORT={port}", "-pthread")
    library = build_shared(source, "hostile", flags)
    path = folder / "hostile.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", DESCRIPTION)
        archive.write(library, "binaries/linux64/hostile.so")
    return path
