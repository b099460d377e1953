"""Packings that were read lately are kept in memory, until something in their folder changes."""

import os
import shutil
import time
from pathlib import Path

import numpy as np
import pytest
from toy_lab import arrays, carry_out, labbook, study, study_file

from labbook.lab import Unreadable, packings
from labbook.lab.packings import read_packing
from labbook.lab.tables import read_table, write_table

OLDER = Path(__file__).parents[2] / "toy/older_lab"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    carry_out(study(tmp_path, count=50, orifices="[24]", replicates=1), tmp_path / "lab")
    monkeypatch.setattr(packings, "cache", type(packings.cache)())
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
    assert not packings.cache


def test_a_packing_that_was_made_here_is_read_neither_for_the_index_nor_for_its_runs(tmp_path, monkeypatch):
    monkeypatch.setattr(packings, "cache", type(packings.cache)())
    read, of = packings.read_checked, []

    def noted(folder, key):
        of.extend([folder] if folder.exists() else [])
        return read(folder, key)

    monkeypatch.setattr(packings, "read_checked", noted)
    carry_out(study(tmp_path, count=50, orifices="[24, 30]", replicates=2), tmp_path / "lab")
    made = sorted((tmp_path / "lab/packings").iterdir())
    assert of == []
    for folder in made:
        record, packing = read_packing(folder)
        other, again = read(folder, None)
        assert record.model_copy(update={"seal": other.seal, "arrays": other.arrays}) == other
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
    monkeypatch.setattr(packings, "MOST_GRAINS", 100)  # two packings of 50
    first, second, third = map(read_packing, copies)
    assert read_packing(copies[2]) is third
    assert read_packing(copies[1]) is second
    assert read_packing(copies[0]) is not first
    assert read_packing(copies[1]) is second, "it was read after the third"
    np.testing.assert_array_equal(read_packing(copies[0])[1].x, first[1].x)


@pytest.mark.parametrize("change", [lambda x: x * 1e6, lambda x: 0 * x + x[0], lambda x: x + 1e-16])
def test_a_packing_whose_grains_were_moved_is_named_and_made_again(tmp_path, change):
    """The file is a whole one, of a packing that could be: only its seal tells."""
    asked, lab = study(tmp_path, count=50, orifices="[24]", replicates=1), tmp_path / "lab"
    carry_out(asked, lab)
    (folder,) = (lab / "packings").iterdir()
    before, file = arrays(folder), folder / packings.ARRAYS
    moved = read_table(file)
    write_table(file, moved | {"x": change(moved["x"])})
    told = f"{file}: it was changed after it was written"
    assert told in labbook("status", "--lab", lab).output.replace("\n", "")
    assert told in labbook("reindex", "--lab", lab).output
    assert carry_out(asked, lab).failed == ()
    assert arrays(folder) == before


def test_packings_from_before_there_were_seals_are_read_and_sealed_by_reindex(tmp_path):
    shutil.copytree(OLDER, tmp_path / "lab")
    (folder,) = (tmp_path / "lab/packings").iterdir()
    before = {file.name: file.read_bytes() for file in folder.iterdir()}
    labbook("run", study_file(tmp_path, count=30, orifices="[24]", replicates=1), "--lab", tmp_path / "lab",
            "--backend", "toy", check=False)  # fmt: skip
    assert {file.name: file.read_bytes() for file in folder.iterdir()} == before
    older = read_packing(folder)[0]
    labbook("reindex", "--lab", tmp_path / "lab")
    after = (folder / "packing.json").read_bytes()
    record = read_packing(folder)[0]
    assert record.seal is not None
    assert record.arrays is not None
    assert record.model_copy(update={"seal": None, "arrays": None}) == older
    assert (folder / packings.ARRAYS).read_bytes() == before[packings.ARRAYS]
    labbook("reindex", "--lab", tmp_path / "lab")
    assert (folder / "packing.json").read_bytes() == after
    moved = read_table(folder / packings.ARRAYS)
    write_table(folder / packings.ARRAYS, moved | {"v": moved["v"] + 1e-9})
    with pytest.raises(Unreadable, match="wrong checksum"):
        read_packing(folder)
    assert not list((tmp_path / "lab/work").iterdir())
