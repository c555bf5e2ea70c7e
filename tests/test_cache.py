"""The folder of what can be made again: it does not grow without end, and keeps what is in use."""

import os
import time

import pytest

from daest.cache import forget_unused, was_used

OLD = time.time() - 86_400


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("DAEST_CACHE", str(tmp_path))


def folder_of(tmp_path, n_files, size=1):
    """Files of `size` bytes, one second apart, the last written being the newest; all of them a day old."""
    folder = tmp_path / "kept"
    folder.mkdir()
    for i in range(n_files):
        (folder / f"{i:03}").write_bytes(bytes(size))
        os.utime(folder / f"{i:03}", (OLD + i, OLD + i))
    return folder


def names(folder):
    return sorted(file.name for file in folder.iterdir())


def test_too_many_entries_leave_the_newest_three_quarters(tmp_path):
    folder = folder_of(tmp_path, 9)
    forget_unused(folder, most_entries=8)
    assert names(folder) == [f"{i:03}" for i in range(3, 9)]
    forget_unused(folder, most_entries=8)
    assert len(names(folder)) == 6


def test_too_many_bytes_count_in_folders_too(tmp_path):
    folder = folder_of(tmp_path, 2)
    (folder / "large").mkdir()
    (folder / "large" / "inside").write_bytes(bytes(1000))
    os.utime(folder / "large", (OLD - 1, OLD - 1))
    forget_unused(folder, most_entries=8, most_bytes=500)
    assert names(folder) == ["000", "001"]


def test_what_was_used_stays(tmp_path):
    folder = folder_of(tmp_path, 4)
    was_used(folder / "000")
    forget_unused(folder, most_entries=3)
    assert names(folder) == ["000", "003"]


def test_what_is_in_use_stays_although_there_is_too_much(tmp_path):
    folder = folder_of(tmp_path, 4)
    for file in folder.iterdir():
        was_used(file)
    forget_unused(folder, most_entries=1)
    assert len(names(folder)) == 4


def test_folders_of_others_and_the_cache_itself_are_left_alone(tmp_path, monkeypatch):
    folder = folder_of(tmp_path, 4)
    for cache in (tmp_path / "elsewhere", folder, folder / "000"):
        monkeypatch.setenv("DAEST_CACHE", str(cache))
        forget_unused(folder, most_entries=1, most_bytes=1)
        assert len(names(folder)) == 4


def test_a_folder_that_is_not_there_is_no_error(tmp_path):
    forget_unused(tmp_path / "nowhere", most_entries=1)
    was_used(tmp_path / "nowhere")
