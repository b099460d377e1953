"""The index is made again beside the old one, and one row that cannot be kept stops nothing else."""

import os
import shutil
from collections.abc import Callable

import pytest
from toy_lab import carry_out, labbook, study

from labbook.lab import Catalogue, LabFolder, NoCatalogue
from labbook.lab import database as tables
from labbook.lab import index as indexing
from labbook.lab.index import Index

ALL = {"finished": 4}


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    folder = tmp_path_factory.mktemp("finished")
    carry_out(study(folder), folder / "lab")
    return folder / "lab"


@pytest.fixture
def lab(finished, tmp_path):
    return shutil.copytree(finished, tmp_path / "lab")


def counted(lab) -> dict[str, int]:
    found = Catalogue(lab)
    try:
        return found.counts() | {"packings": found.packing_count()}
    finally:
        found.close()


def killed(act: Callable[[], None]) -> None:
    """Carry out what ends its process, in one of its own."""
    pid = os.fork()
    if pid == 0:
        try:
            act()
        finally:
            os._exit(1)
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 9, "it was not killed where it should have been"


def made_again(lab, until: int) -> Callable[[], None]:
    """Make the index again, and be killed when so many runs were indexed."""
    return lambda: (
        Index(LabFolder(lab), again=True, tick=lambda done, _: os._exit(9) if done == until else None) and None
    )


def test_readers_see_the_old_index_until_the_new_one_is_whole(lab):
    whole, seen = counted(lab), []
    Index(LabFolder(lab), again=True, tick=lambda *_: seen.append(counted(lab))).close()
    assert seen == [whole] * 4
    assert counted(lab) == whole == ALL | {"packings": 2}


@pytest.mark.parametrize("until", range(1, 5))
def test_killed_it_leaves_the_old_index_and_the_next_one_is_whole(lab, until):
    whole = counted(lab)
    killed(made_again(lab, until))
    assert counted(lab) == whole
    assert labbook("reindex", "--lab", lab).output == "4 runs and 2 packings indexed\n"
    assert counted(lab) == whole
    assert not list(lab.glob("catalogue.db.new*"))


@pytest.mark.parametrize("version", ["this", "another"])
def test_killed_while_the_two_change_places_it_leaves_one_of_them(lab, monkeypatch, version):
    whole, exchanged = counted(lab), tables.replace_tables

    def half(*arguments) -> None:
        exchanged(*arguments)
        os._exit(9)  # before the transaction ends

    if version == "another":
        with tables.open_engine(LabFolder(lab), read_only=False).connect() as connection:
            connection.execute(tables.about.update().values(schema_version=1))
            connection.commit()
    monkeypatch.setattr(tables, "replace_tables", half)
    killed(made_again(lab, 0))
    if version == "this":
        assert counted(lab) == whole
    else:
        with pytest.raises(NoCatalogue, match="another version"):
            counted(lab)
    monkeypatch.undo()
    Index(LabFolder(lab)).close()
    assert counted(lab) == whole


def test_killed_before_there_is_any_it_leaves_none_that_is_shorter(lab):
    whole = counted(lab)
    tables.remove_file(LabFolder(lab).catalogue)
    killed(lambda: Index(LabFolder(lab), tick=lambda done, _: os._exit(9) if done == 2 else None) and None)
    with pytest.raises(NoCatalogue, match="make it again"):
        counted(lab)
    Index(LabFolder(lab)).close()
    assert counted(lab) == whole


def test_a_run_that_ends_meanwhile_is_never_missing(lab, monkeypatch):
    """It is indexed in the old index after the new one was begun, and is in both when they have changed places."""
    last = sorted((lab / "runs").iterdir())[-1]
    last.rename(lab / "elsewhere")
    Index(LabFolder(lab)).close()
    exchange, seen = indexing.replace_index, []

    def late(*arguments) -> None:
        (lab / "elsewhere").rename(last)
        other = Index(LabFolder(lab))
        other.close()
        exchange(*arguments)
        seen.append(counted(lab))

    monkeypatch.setattr(indexing, "replace_index", late)
    made = Index(LabFolder(lab), again=True)
    made.close()
    assert seen == [ALL | {"packings": 2}]
    assert made.report.runs == 3, "the other process has indexed the fourth"


@pytest.mark.parametrize("wrong", [{"machine": {"a": 1}}, {"seed": 2**70}, {"label": "\udcff"}, {"outcome": None}])
def test_a_row_that_cannot_be_kept_is_one_red_row_with_its_name(lab, tmp_path, monkeypatch, wrong):
    """Whatever a record may say that is not foreseen."""
    victim = sorted((lab / "runs").iterdir())[1].name
    rows = indexing.run_rows

    def odd(folder, observe):
        row, measured = rows(folder, observe)
        return row | (wrong if folder.name == victim else {}), measured

    monkeypatch.setattr(indexing, "run_rows", odd)
    ended = labbook("reindex", "--lab", lab)
    assert "4 runs and 2 packings indexed" in ended.output
    assert f"runs/{victim}/run.json: it cannot be indexed: " in ended.output
    assert counted(lab) == {"finished": 3, "unreadable": 1, "packings": 2}
    assert "3 finished" in labbook("status", "--lab", lab).output
    assert counted(lab)["unreadable"] == 1
    monkeypatch.undo()
    assert "3 runs imported" not in labbook("import", lab, "--lab", tmp_path / "new").output
    assert counted(tmp_path / "new") == ALL | {"packings": 2}


def test_a_packing_whose_row_cannot_be_kept_stops_nothing(lab, monkeypatch):
    victim = sorted((lab / "packings").iterdir())[0].name
    row = indexing.packing_row
    odd = {"machine": {"a": 1}}
    monkeypatch.setattr(
        indexing, "packing_row", lambda folder: row(folder) | (odd if folder.name == victim else {})
    )  # fmt: skip
    ended = labbook("reindex", "--lab", lab)
    assert f"packings/{victim}/packing.json: it cannot be indexed: " in ended.output
    assert counted(lab)["packings"] == 2


@pytest.mark.parametrize("target", ["nowhere", "itself", "folder"])
def test_a_link_in_place_of_a_run_is_named_and_the_run_made_again(lab, tmp_path, target):
    asked = study(tmp_path)
    victim = sorted((lab / "runs").iterdir())[0]
    victim.rename(tmp_path / "kept")
    victim.symlink_to({"nowhere": tmp_path / "nothing", "itself": victim, "folder": tmp_path / "kept"}[target])
    ended = labbook("reindex", "--lab", lab)
    assert f"{victim / 'run.json'}: it is a link" in ended.output
    summary = carry_out(asked, lab)
    assert summary.failed == ()
    assert counted(lab) == ALL | {"packings": 2}
    assert not victim.is_symlink()
    assert (tmp_path / "kept/run.json").exists(), "what is elsewhere stays"
