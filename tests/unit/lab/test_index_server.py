"""The index of a lab on a PostgreSQL server: the same answers, from a real one."""

import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from toy_lab import ROOT, labbook, study_file
from toy_server import postgres, programs

from labbook.lab import Catalogue, LabError, LabFolder, NoCatalogue, server
from labbook.lab.index import Index

pytest.importorskip("psycopg")


def needs_server(test):
    """A mark of tests that take a real server."""
    absent = pytest.mark.skipif(programs() is None, reason="needs PostgreSQL: apt-get install postgresql")
    return pytest.mark.ring(pytest.mark.slow(absent(test)))


OF_FILES = (
    "test_made_again_it_is_the_same", "test_one_of_another_version_is_made_again_by_whoever_writes",
    "test_a_damaged_one_is_made_again", "test_a_run_that_was_not_indexed_is_found",
    "test_no_room_for_the_index_is_one_line",
    "test_a_lab_that_nobody_can_write_to_is_read_without_the_log_of_its_index",
    "test_a_lost_or_damaged_evaluation_is_made_again", "test_a_lab_that_cannot_be_written_to_is_read_all_the_same",
)  # fmt: skip
"""Tests of the file itself, or that read its tables before anybody else does."""


@pytest.fixture(scope="module")
def url():
    with postgres() as address:
        yield address


def small(folder: Path, replicates: int = 2) -> Path:
    """A study of two points."""
    return study_file(folder, count=60, orifices="[24, 30]", replicates=replicates)


def answers(lab: Path, asked: Path) -> dict[str, str]:
    """What the command line says of a lab, whatever its path."""
    words = {"runs": ("runs", "--json"), "fit": ("fit", asked, "--backend", "toy"),
             "plan": ("plan", asked, "--backend", "toy")}  # fmt: skip
    said = {name: labbook(*asking, "--lab", lab).output.replace(str(lab), "LAB") for name, asking in words.items()}
    return said | {"measured": Catalogue(lab).measurements().to_csv()}


@needs_server
def test_it_answers_as_the_file_does_there_and_back(url, tmp_path):
    lab, asked = tmp_path / "lab", small(tmp_path)
    labbook("run", asked, "--lab", lab, "--backend", "toy")
    before = answers(lab, asked)
    assert "4 runs and " in labbook("reindex", "--lab", lab, "--index", url).output
    assert not (lab / "catalogue.db").exists()
    assert answers(lab, asked) == before
    more = small(tmp_path, 3)
    assert "6 of 6 runs done" in labbook("run", more, "--lab", lab, "--backend", "toy").output
    after = answers(lab, more)
    labbook("reindex", "--lab", lab, "--index", "file")
    assert (lab / "catalogue.db").exists()
    assert not (lab / "catalogue.url").exists()
    assert answers(lab, more) == after


@needs_server
def test_a_copy_does_not_write_into_the_index_of_its_original(url, tmp_path):
    lab, asked = tmp_path / "lab", small(tmp_path)
    labbook("run", asked, "--lab", lab, "--backend", "toy")
    labbook("reindex", "--lab", lab, "--index", url)
    other = shutil.copytree(lab, tmp_path / "other")
    with pytest.raises(NoCatalogue, match="is missing; make it again: labbook reindex"):
        Catalogue(other)
    shutil.rmtree(next((other / "runs").iterdir()))
    Index(LabFolder(other)).close()
    assert Catalogue(other).counts() == {"finished": 3}
    assert Catalogue(lab).counts() == {"finished": 4}


@needs_server
def test_many_write_at_once(url, tmp_path):
    lab, asked = tmp_path / "lab", small(tmp_path)
    labbook("run", asked, "--lab", lab, "--backend", "toy")
    labbook("reindex", "--lab", lab, "--index", url)
    before = answers(lab, asked)

    def write(_worker: int) -> None:
        index = Index(LabFolder(lab))
        for folder in sorted((lab / "runs").iterdir()):
            assert index.add_run(folder) is None
        index.close()

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(write, range(16)))
    assert answers(lab, asked) == before


@needs_server
def test_the_tests_of_the_index_pass_on_a_server(url):
    """Those of this folder that ask most of it, each lab of theirs with its index there."""
    names = ("test_lab_index", "test_import", "test_storage", "test_measured_once", "test_suspect", "test_lab_model")
    env = {**os.environ, "LABBOOK_TEST_SERVER": url, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    files = [str(ROOT / f"tests/unit/lab/{name}.py") for name in names]
    chosen = " and ".join(f"not {name}" for name in OF_FILES)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:xdist", "-p", "no:cacheprovider", "-p", "on_server",
         "-m", "not ring", "-k", chosen, *files],
        cwd=ROOT, env=env, capture_output=True, text=True, timeout=1500,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-5000:]
    assert int(done.stdout.split(" passed")[0].split()[-1].lstrip("=")) > 100


def test_a_server_that_is_not_there_is_one_line_and_the_lab_goes_home(tmp_path):
    lab, asked = tmp_path / "lab", small(tmp_path)
    labbook("run", asked, "--lab", lab, "--backend", "toy", check=False)  # too few grains for a flow rate
    before = {path.name for path in lab.glob("catalogue.*")}
    nowhere = "postgresql://me:secret@127.0.0.1:1/silos"
    ended = labbook("reindex", "--lab", lab, "--index", nowhere, check=False)
    assert ended.exit_code == 1
    assert "no index can be made at postgresql://me:***@127.0.0.1:1/silos" in ended.output
    assert {path.name for path in lab.glob("catalogue.*")} == before, "nothing changed"
    (lab / "catalogue.url").write_text(f'{{"url": "{nowhere}", "name": "x"}}')
    ended = labbook("status", "--lab", lab, check=False)
    assert ended.exit_code == 1
    assert len(ended.output.strip().splitlines()) == 1
    assert "--index file" in ended.output
    assert "secret" not in ended.output
    ended = labbook("reindex", "--lab", lab, "--index", "file")
    assert "could not be removed" in ended.output
    assert "4 runs and" in ended.output
    assert Catalogue(lab).counts() == {"finished": 4}


@pytest.mark.parametrize("told", ["", "[]", "{}", '{"url": "x"}', "postgresql://here"])
def test_a_file_that_says_nothing_of_use_is_named_with_what_to_do(tmp_path, told):
    (tmp_path / "catalogue.url").write_text(told)
    with pytest.raises(LabError, match=r"catalogue.url does not say where the index is .*--index postgresql"):
        server.address(LabFolder(tmp_path))
    assert labbook("reindex", "--lab", tmp_path, "--index", "file").output.startswith("0 runs and 0 packings")
    assert server.address(LabFolder(tmp_path)) is None


@pytest.mark.parametrize("wrong", ["sqlite:///here.db", "mysql://host/silos", "a server", ""])
def test_only_the_address_of_a_postgresql_server_is_taken(tmp_path, wrong):
    with pytest.raises(LabError, match=r"give postgresql://HOST/DATABASE, or file"):
        server.move_to(LabFolder(tmp_path), wrong)
    assert not list(tmp_path.iterdir())


def test_addresses_of_copies_differ(tmp_path):
    (tmp_path / "catalogue.url").write_text('{"url": "postgresql://host/silos", "name": "abc"}')
    copy = shutil.copytree(tmp_path, tmp_path / "copy")
    mine, other = server.address(LabFolder(tmp_path)), server.address(LabFolder(copy))
    assert mine
    assert other
    assert mine.url == other.url
    assert mine.schema != other.schema
    assert server.address(LabFolder(tmp_path)) == mine
