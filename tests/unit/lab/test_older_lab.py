"""A lab of an earlier version is read as it stands: same keys, same bytes, nothing run again.

`tests/toy/older_lab` was written when files, and the code, said `engine` for a backend; files still do.
"""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from toy_lab import labbook, study_file

from labbook.backend import Checkpoint
from labbook.checks.compare.verdict import Verdict
from labbook.lab import Catalogue, LabFolder, identity
from labbook.lab.packings import PackingRecord
from labbook.lab.records import RunRecord
from labbook.lab.runs import open_run
from labbook.lab.tables import read_checkpoint, write_checkpoint
from labbook.scene import HertzMindlin

OLDER = Path(__file__).parents[2] / "toy/older_lab"
(RUN,) = (OLDER / "runs").iterdir()
(PACKING,) = (OLDER / "packings").iterdir()
VERDICT = OLDER / "compare/toy-study/toy-twin.json"


@pytest.mark.parametrize(
    ("kind", "path"),
    [(RunRecord, RUN / "run.json"), (PackingRecord, PACKING / "packing.json"), (Verdict, VERDICT)],
)
def test_what_is_read_is_written_with_the_same_bytes(kind, path):
    assert kind.model_validate_json(path.read_bytes()).as_stored() == path.read_bytes()


def test_keys_come_out_as_they_were():
    record, made = RunRecord.read(RUN), PackingRecord.read(PACKING)
    assert record.backend == made.backend == json.loads((RUN / "run.json").read_text())["engine"] == "toy"
    assert record.versions == made.versions == {}, "as of all that was made before laws had versions"
    scene, closed = (identity.scene_key(one.scene, one.versions) for one in (record, made))
    assert (scene, closed) == (record.scene_key, made.closed_key)
    packing = identity.packing_key(closed, made.filling, made.numerics, made.backend, made.cache_version)
    assert packing == PACKING.name == record.packing_key
    experiment = identity.experiment_key(scene, packing)
    assert experiment == record.experiment_key
    assert identity.run_key(experiment, record.numerics, record.backend, record.cache_version) == RUN.name
    assert identity.lineage_key(scene, closed, made.filling, record.numerics, "toy") == record.lineage_key
    assert open_run(RUN)[0] == record  # which looks at all keys, tables and the checkpoint


def test_a_checkpoint_names_its_backend_where_it_always_did(tmp_path):
    assert read_checkpoint(RUN / "checkpoint.npz").backend == "toy"
    write_checkpoint(tmp_path / "checkpoint.npz", Checkpoint("toy", 1, {"x": np.zeros(2)}))
    with np.load(tmp_path / "checkpoint.npz") as stored:
        assert str(stored["_meta"]) == '{"engine": "toy", "cache_version": 1}'


def test_nothing_is_run_again(tmp_path, monkeypatch):
    """As long as the contact law is that of the lab."""
    monkeypatch.setattr(HertzMindlin, "version", 1)
    lab = tmp_path / "lab"
    shutil.copytree(OLDER, lab)
    study = study_file(tmp_path, count=30, orifices="[24]", replicates=1)
    before = (lab / "runs" / RUN.name / "run.json").stat().st_mtime_ns
    ended = labbook("run", study, "--lab", lab, "--backend", "toy", check=False)
    assert "1 of 1 runs done" in ended.stdout
    assert ended.exit_code == 1, "30 grains give no flow rate"
    assert [folder.name for folder in (lab / "runs").iterdir()] == [RUN.name]
    assert (lab / "runs" / RUN.name / "run.json").stat().st_mtime_ns == before
    times = Catalogue(LabFolder(lab)).device_times([RUN.name], [PACKING.name])
    assert times == {RUN.name: None, PACKING.name: None}, "absent, and not 0"
    (entry,) = Catalogue(LabFolder(lab)).entries([RUN.name])
    assert entry.device_time == RunRecord.read(lab / "runs" / RUN.name).wall_time
    (row,) = json.loads(labbook("runs", "--lab", lab, "--json").stdout)
    assert (row["run_key"], row["backend"], row["outcome"]) == (RUN.name, "toy", "finished")
    shown = labbook("compare", study, "--backends", "toy,twin", "--show", "--lab", lab, "--json", check=False)
    assert [cost["backend"] for cost in json.loads(shown.stdout)["costs"]] == ["toy", "twin"]


def test_runs_by_an_older_version_of_the_law_are_stale_and_stay(tmp_path):
    """The older lab was made by version 1 of hertz-mindlin, in which sliding contacts carried too little friction."""
    lab = tmp_path / "lab"
    shutil.copytree(OLDER, lab)
    study = study_file(tmp_path, count=30, orifices="[24]", replicates=1)
    labbook("reindex", "--lab", lab)
    why = "law hertz-mindlin version 1, now 2: sliding contacts carry mu F_n"
    (item,) = json.loads(labbook("plan", study, "--lab", lab, "--backend", "toy", "--json").stdout)["runs"]
    assert (item["state"], item["reason"]) == ("stale", why)
    assert f"1 of 1 run is stale: {why}." in labbook("fit", study, "--lab", lab, "--backend", "toy").stdout
    assert "1 of 1 runs done" in labbook("run", study, "--lab", lab, "--backend", "toy", check=False).stdout
    assert "stale" not in labbook("fit", study, "--lab", lab, "--backend", "toy").stdout
    (made,) = {folder.name for folder in (lab / "runs").iterdir()} - {RUN.name}
    assert RunRecord.read(lab / "runs" / made).versions == {"law hertz-mindlin": 2}
    assert RunRecord.read(lab / "runs" / made).lineage_key != RunRecord.read(RUN).lineage_key
    assert open_run(lab / "runs" / RUN.name)[0] == RunRecord.read(RUN)
