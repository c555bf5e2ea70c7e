"""The comparison of an FMU's sources is made once for each content and point."""

import fmu_models as models
import numpy as np
import pytest
from fmu_archives import changed

from daest.fmu import kept_check, serialization
from daest.fmu.kept_check import kept_cross_check
from daest.fmu.linearize import cross_check_fmu, linearize_fmu

THETA = np.array(models.geared_drive().theta_values)


@pytest.fixture
def n_made(monkeypatch, tmp_path):
    """Numbers of how many comparisons were made, one for each of them."""
    monkeypatch.setenv("DAEST_CACHE", str(tmp_path / "cache"))
    made = []

    def count(*arguments):
        made.append(len(made) + 1)
        return cross_check_fmu(*arguments)

    monkeypatch.setattr(kept_check, "cross_check_fmu", count)
    return made


def check(path, theta=THETA, at=None):
    return kept_cross_check(path, theta, at, [linearize_fmu(path, theta, at)])


def test_the_second_comparison_is_the_first(drive_fmu, n_made):
    first = check(drive_fmu)
    assert check(drive_fmu) == first == cross_check_fmu(drive_fmu, THETA)
    assert n_made == [1]


def test_other_values_and_another_point_are_compared_anew(drive_fmu, n_made):
    name = models.geared_drive().unknowns[0].name
    check(drive_fmu)
    check(drive_fmu, 1.1 * THETA)
    check(drive_fmu, at={name: 0.1})
    check(drive_fmu, at={name: 0.2})
    assert n_made == [1, 2, 3, 4]


def test_an_fmu_that_was_made_wrong_in_the_meantime_is_noticed(drive_fmu, tmp_path, n_made):
    path = tmp_path / "drive.fmu"
    path.write_bytes(drive_fmu.read_bytes())
    assert check(path)["largest"] < 1e-8
    flat = models.geared_drive()
    wrong = type(flat)(**{**flat.__dict__, "residual": flat.residual * 1.001})
    files = {f"{serialization.FOLDER}/{n}": t.encode() for n, t in serialization.serialize(wrong).items()}
    changed(drive_fmu, path, replace=files)
    assert check(path)["largest"] == pytest.approx(1e-3, rel=0.01)


def test_a_damaged_comparison_is_made_anew(drive_fmu, tmp_path, n_made):
    first = check(drive_fmu)
    (kept,) = (tmp_path / "cache" / "cross_checks").iterdir()
    kept.write_bytes(kept.read_bytes()[:-3])
    assert check(drive_fmu) == first
    assert n_made == [1, 2]


def test_an_fmu_with_nothing_to_compare_leaves_nothing(drive_fmu, tmp_path, n_made):
    path = changed(drive_fmu, tmp_path / "bare.fmu", drop=["binaries/"])
    assert check(path) == {} == check(path)
    assert n_made == [1, 2]
