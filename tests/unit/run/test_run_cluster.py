"""A study on the workers of a Dask cluster: the same bits as one process, whatever becomes of workers."""

import os
import random
import signal
import threading
import time
from pathlib import Path

import pytest
from labbook_toy import Backend
from toy_lab import ROOT, arrays, carry_out, labbook, start, study, study_file

from labbook.lab import Catalogue, LabFolder
from labbook.lab.index import Index
from labbook.lab.records import Observe
from labbook.plan.plan import Planner
from labbook.run.cluster import Batch, Cluster, Task, TaskResult, read, write
from labbook.run.cluster import carry_out as on_worker
from labbook.run.slurm import expected
from labbook.study import load

distributed = pytest.importorskip("distributed", reason="Dask is not installed: pip install 'labbook[cluster]'")
FOLDERS = os.pathsep.join([*map(str, (ROOT, ROOT / "backends", ROOT / "tests/toy")), os.environ.get("PYTHONPATH", "")])


def files(lab):
    """The bits of all runs and packings of a lab."""
    return {f"{kind}/{one.name}": arrays(one) for kind in ("runs", "packings") for one in (lab / kind).iterdir()}


def task(asked, **given) -> Task:
    """All runs of a study."""
    repeats = {point.index: tuple((seed, 1) for seed in range(1, asked.replicates + 1)) for point in asked.points}
    stated = expected(asked, Backend().capabilities)
    fixed = {"packings": {}, "runs": {}, "works": {}, "slice": 300.0, "stop": "never"}
    return Task(asked, "toy", "cpu", **{"expected": stated, "repeats": repeats, **fixed, **given})


def coordinator(asked, lab):
    """One that has no cluster, with its index, and all runs of the study as one batch."""
    made = Cluster(asked, LabFolder(lab), "toy", "nowhere")
    made.problems, made.observe = {}, Observe.of(asked.measure, asked.window)
    index = Index(made.lab)
    from labbook.lab import Catalogue

    catalogue = Catalogue(made.lab)
    plan = Planner(asked, catalogue, Backend().capabilities).plan()
    catalogue.close()
    return made, index, Batch(plan.items)


def test_a_task_gives_back_all_that_one_process_makes(tmp_path):
    asked = study(tmp_path)
    back = on_worker(task(asked))
    carry_out(asked, tmp_path / "whole")
    made, index, batch = coordinator(asked, tmp_path / "lab")
    made.store_result(index, back, batch)
    index.close()
    assert not made.problems
    assert files(tmp_path / "lab") == files(tmp_path / "whole")
    assert not carry_out(asked, tmp_path / "lab").tally.ran


@pytest.mark.ring
def test_a_task_whose_time_is_over_gives_back_checkpoints_and_the_next_goes_on(tmp_path, monkeypatch):
    monkeypatch.setattr("labbook.run.cluster.STOP_INTERVAL", 0.1)
    monkeypatch.setenv("LABBOOK_TOY_DELAY", "0.05")
    asked = study(tmp_path, replicates=1)
    given = {"packings": {}, "runs": {}, "works": {}}
    made, index, batch = coordinator(asked, tmp_path / "lab")
    slices, resumed = 0, 0
    while True:
        back = on_worker(task(asked, slice=1.0, **given))
        made.store_result(index, back, batch)
        slices, resumed = slices + 1, resumed + back.resumed
        given = {
            "packings": {one.name: read(one) for one in (tmp_path / "lab/packings").glob("*")},
            "runs": {one.name: read(one) for one in (tmp_path / "lab/runs").glob("*")},
            "works": {name: read(tmp_path / "lab/work" / name) for name in LabFolder(tmp_path / "lab").working()},
        }
        if len(given["runs"]) == 2:
            break
        assert slices < 50
    index.close()
    assert slices > 2
    assert resumed
    assert LabFolder(tmp_path / "lab").working() == []
    monkeypatch.setenv("LABBOOK_TOY_DELAY", "0")
    carry_out(asked, tmp_path / "whole")
    assert files(tmp_path / "lab") == files(tmp_path / "whole")


def test_a_worker_with_another_version_refuses(tmp_path):
    stated = expected(study(tmp_path), Backend().capabilities).replace("toy-1", "toy-9")
    assert "toy-9 is now toy-1 on a worker" in on_worker(task(study(tmp_path), expected=stated)).refused


@pytest.mark.parametrize("name", ["../x.npz", "/etc/x", "", ".."])
def test_files_that_lead_out_of_their_folder_are_refused(name, tmp_path):
    with pytest.raises(Exception, match="not the name of a file"):
        write(tmp_path / "folder", {name: b""})


def test_what_was_not_asked_for_or_is_damaged_is_not_put_in_place(tmp_path):
    asked = study(tmp_path, replicates=1)
    back = on_worker(task(asked))
    made, index, batch = coordinator(asked, tmp_path / "lab")
    (one, other), (packing,) = sorted(back.runs), back.packings
    batch.items = [item for item in batch.items if item.keys.run == one]
    spoilt = {**back.runs[one], "run.json": back.runs[one]["run.json"][:-20]}
    made.store_result(index, TaskResult(back.packings, {one: spoilt, other: back.runs[other]}), batch)
    assert [path.name for path in (tmp_path / "lab/packings").iterdir()] == [packing]
    assert not list((tmp_path / "lab").glob("runs/*"))
    assert "run.json" in next(iter(made.problems))
    index.close()


@pytest.mark.ring
def test_an_address_where_nobody_answers_is_named(tmp_path):
    ended = labbook("run", study_file(tmp_path), "--lab", tmp_path / "lab", "--backend", "toy", "--cluster",
                    "tcp://127.0.0.1:9", check=False)  # fmt: skip
    assert ended.exit_code == 1
    assert "no scheduler answers at tcp://127.0.0.1:9" in ended.output


def test_parts_of_a_study_are_not_given_to_a_cluster(tmp_path):
    words = ("run", study_file(tmp_path), "--backend", "toy", "--cluster", "tcp://127.0.0.1:9", "--shard", "1/2")
    assert "leave out --shard and --base" in labbook(*words, check=False).output


@pytest.fixture
def cluster(monkeypatch):
    """Three worker processes, which only this machine reaches."""
    monkeypatch.setenv("PYTHONPATH", FOLDERS)
    monkeypatch.setenv("LABBOOK_TOY_DELAY", "0.02")
    with distributed.LocalCluster(
        n_workers=3, threads_per_worker=1, processes=True, host="127.0.0.1", dashboard_address=None
    ) as made:
        yield made


@pytest.mark.ring
@pytest.mark.slow
def test_workers_that_are_killed_at_random_cost_no_bit(tmp_path, cluster):
    path = study_file(
        tmp_path, "accuracy: {flow_rate: 2 %, max_replicates: 5}", "record: {every: 5 ms, replicates: 1}",
        replicates=3, orifices="[18, 21, 24, 30]",
    )  # fmt: skip
    asked, killed, over = load(path), [], threading.Event()

    def kill():
        rng = random.Random(3)
        while not over.wait(3.0):
            pids = [one.pid for one in cluster.workers.values() if one.pid]
            if pids and len(killed) < 6:
                killed.append(rng.choice(pids))
                os.kill(killed[-1], signal.SIGKILL)

    killer = threading.Thread(target=kill, daemon=True)
    killer.start()
    try:
        summary = Cluster(asked, LabFolder(tmp_path / "lab"), "toy", cluster.scheduler_address, slice=5.0).run()
    finally:
        over.set()
        killer.join()
    assert len(killed) >= 3
    assert summary.done == summary.requested
    assert not summary.failed
    carry_out(asked, tmp_path / "whole")
    assert files(tmp_path / "lab") == files(tmp_path / "whole")
    assert LabFolder(tmp_path / "lab").working() == []


@pytest.mark.ring
def test_workers_share_one_campaign(tmp_path, cluster):
    """What is proposed, and its reasons, are those of one process; each run and filling has its device time."""
    goal = "adapt: {find: {container.orifice: {flow_rate: 28 g/s, within: 3 %}}}"
    asked = load(study_file(tmp_path, goal, "window: {start: 0.15, end: 0.6}", orifices="[15, 30]"))
    alone = carry_out(asked, tmp_path / "alone")
    shared = Cluster(asked, LabFolder(tmp_path / "lab"), "toy", cluster.scheduler_address, slice=5.0).run()
    assert "Promise kept" in alone.campaign[-1]
    assert shared.campaign == alone.campaign
    keys = [[sorted(one.name for one in (tmp_path / lab / kind).iterdir()) for kind in ("runs", "packings")]
            for lab in ("alone", "lab")]  # fmt: skip
    assert keys[0] == keys[1]
    assert None not in Catalogue(LabFolder(tmp_path / "lab")).device_times(*keys[1]).values()


@pytest.mark.ring
@pytest.mark.slow
def test_ctrl_c_brings_checkpoints_home_and_one_machine_goes_on_from_them(tmp_path, cluster):
    path, lab = study_file(tmp_path, replicates=2), tmp_path / "lab"
    given = ("run", path, "--lab", lab, "--backend", "toy", "--cluster", cluster.scheduler_address)
    process = start(*given)
    end = time.monotonic() + 60
    while process.poll() is None and not any("carry" in str(v) or v for v in _processing(cluster)):
        assert time.monotonic() < end
        time.sleep(0.1)
    time.sleep(3)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=90)
    assert process.returncode == 130, out + err
    assert "Stopped early; everything is saved" in out
    out, err = start("run", path, "--lab", lab, "--backend", "toy").communicate(timeout=90)
    assert "4 of 4 runs done" in out, out + err
    assert "continued from a checkpoint" in out
    carry_out(load(path), tmp_path / "whole")
    assert files(lab) == files(tmp_path / "whole")


def _processing(cluster):
    with distributed.Client(cluster.scheduler_address, set_as_default=False) as client:
        return list(client.processing().values())


@pytest.mark.ring
@pytest.mark.slow
def test_a_cluster_of_this_machine_is_started_by_its_verb(tmp_path):
    process = start("cluster", "local", "--workers", 2)
    try:
        assert process.stdout is not None
        address = process.stdout.readline().split()[-1]
        path = study_file(Path(tmp_path))
        ended = labbook("run", path, "--lab", tmp_path / "lab", "--backend", "toy", "--cluster", address)
        assert "4 of 4 runs done" in ended.stdout
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=30)


@pytest.mark.slow
@pytest.mark.ring
def test_ctrl_c_ends_a_cluster_of_this_machine_without_words_of_its_workers():
    """A terminal sends it to all processes."""
    psutil = pytest.importorskip("psutil")
    process = start("cluster", "local", "--workers", 2)
    assert process.stdout is not None
    assert process.stdout.readline().startswith("Scheduler: ")
    assert process.stdout.readline().startswith("In another terminal: ")
    workers = psutil.Process(process.pid).children(recursive=True)
    assert len(workers) >= 2
    for one in (*workers, process):
        one.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out, err) == (0, "Ended\n", "")
