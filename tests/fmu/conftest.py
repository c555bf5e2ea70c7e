"""FMUs that several tests of this folder read; exported once."""

from pathlib import Path

import fmu_models as models
import pytest

from daest.fmu.export import export_fmu


@pytest.fixture(scope="session")
def drive_fmu(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("fmu") / "drive.fmu"
    export_fmu(models.geared_drive(), path)
    return path


@pytest.fixture(scope="session")
def tank_fmu(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("fmu") / "tank.fmu"
    export_fmu(models.tank(), path)
    return path
