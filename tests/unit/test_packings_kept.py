"""Packings that were read lately are kept in memory, until something in their folder changes."""

import os
import time

import numpy as np
import pytest
from toy_lab import carry_out, study

from labbook.lab import Unreadable, packings
from labbook.lab.packings import read_packing


@pytest.fixture
def folder(tmp_path, monkeypatch):
    carry_out(study(tmp_path, count=50, orifices="[24]", replicates=1), tmp_path / "lab")
    monkeypatch.setattr(packings, "_lately", type(packings._lately)())
    (made,) = (tmp_path / "lab/packings").iterdir()
    return made


def written(folder, ago):
    """Let the files of a folder have been written so long ago [s]."""
    for file in folder.iterdir():
        os.utime(file, (time.time() - ago,) * 2)


def test_a_packing_is_read_once_and_cannot_be_written_to(folder):
    written(folder, 60)
    first = read_packing(folder)
    assert read_packing(folder) is first
    with pytest.raises(ValueError, match="read-only"):
        first[1].x[0] = 0.0


def test_a_packing_that_was_written_to_is_read_again(folder):
    written(folder, 60)
    read_packing(folder)
    file = folder / packings.ARRAYS
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)
    written(folder, 30)
    with pytest.raises(Unreadable):
        read_packing(folder)


def test_a_packing_that_was_only_just_written_is_not_kept(folder):
    written(folder, 0)
    assert read_packing(folder) is not read_packing(folder)
    assert not packings._lately


def test_a_packing_that_was_made_here_is_read_once_for_the_index_and_not_for_its_runs(tmp_path, monkeypatch):
    monkeypatch.setattr(packings, "_lately", type(packings._lately)())
    read, of = packings._read, []

    def noted(folder, key):
        of.extend([folder] if folder.exists() else [])
        return read(folder, key)

    monkeypatch.setattr(packings, "_read", noted)
    carry_out(study(tmp_path, count=50, orifices="[24, 30]", replicates=2), tmp_path / "lab")
    made = sorted((tmp_path / "lab/packings").iterdir())
    assert sorted(of) == made
    for folder in made:
        record, packing = read_packing(folder)
        other, again = read(folder, None)
        assert record.model_copy(update={"seal": other.seal}) == other
        for name, array in again.arrays().items():
            mine = packing.arrays()[name]
            assert array.dtype == mine.dtype, name
            np.testing.assert_array_equal(mine, array, name)
        assert not packing.x.flags.writeable


def test_the_packings_read_last_are_kept_up_to_a_number_of_grains(folder, tmp_path, monkeypatch):
    copies = [tmp_path / f"copies-{k}" / folder.name for k in range(3)]
    for copy in copies:
        copy.mkdir(parents=True)
        for file in folder.iterdir():
            (copy / file.name).write_bytes(file.read_bytes())
        written(copy, 60)
    monkeypatch.setattr(packings, "_KEPT", 100)  # two packings of 50
    first, second, third = map(read_packing, copies)
    assert read_packing(copies[2]) is third
    assert read_packing(copies[1]) is second
    assert read_packing(copies[0]) is not first
    assert read_packing(copies[1]) is second, "it was read after the third"
    np.testing.assert_array_equal(read_packing(copies[0])[1].x, first[1].x)
