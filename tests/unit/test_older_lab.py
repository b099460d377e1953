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
from labbook.compare.verdict import Verdict
from labbook.lab import identity
from labbook.lab.packings import PackingRecord
from labbook.lab.records import RunRecord
from labbook.lab.runs import open_run
from labbook.lab.tables import read_checkpoint, write_checkpoint

OLDER = Path(__file__).parents[1] / "toy/older_lab"
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
    scene, closed = identity.scene_key(record.scene), identity.scene_key(made.scene)
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


def test_nothing_is_run_again(tmp_path):
    lab = tmp_path / "lab"
    shutil.copytree(OLDER, lab)
    study = study_file(tmp_path, count=30, orifices="[24]", replicates=1)
    before = (lab / "runs" / RUN.name / "run.json").stat().st_mtime_ns
    ended = labbook("run", study, "--lab", lab, "--backend", "toy", check=False)
    assert "1 of 1 runs done" in ended.stdout
    assert ended.exit_code == 1, "30 grains give no flow rate"
    assert [folder.name for folder in (lab / "runs").iterdir()] == [RUN.name]
    assert (lab / "runs" / RUN.name / "run.json").stat().st_mtime_ns == before
    (row,) = json.loads(labbook("runs", "--lab", lab, "--json").stdout)
    assert (row["run_key"], row["backend"], row["outcome"]) == (RUN.name, "toy", "finished")
    shown = labbook("compare", study, "--backends", "toy,twin", "--show", "--lab", lab, "--json", check=False)
    assert [cost["backend"] for cost in json.loads(shown.stdout)["costs"]] == ["toy", "twin"]
