"""On a GPU runs go on while other beds settle and grains are placed: no more at once than there is memory for."""

import threading
from dataclasses import replace
from typing import Any

import labbook_toy
import pytest
from toy_lab import arrays, carry_out, study, study_file

from labbook.lab import Catalogue, LabFolder
from labbook.lab.packings import PackingRecord
from labbook.lab.records import RunRecord
from labbook.run import ensemble_worker, finalizing, job_queue
from labbook.run.ensemble_worker import EnsembleWorker
from labbook.run.fill import FillJob
from labbook.run.stopping import StopRequest
from labbook.run.watch import NullWatcher
from labbook.study import load


class Device(labbook_toy.Backend):
    """The toy backend on a device of its own, whose memory holds `holds` members of 200 grains."""

    def __init__(self, holds):
        super().__init__()
        self.capabilities = replace(self.capabilities, devices=("cpu", "cuda:0"))
        self.holds, self.most = holds, 0

    def capacity(self, spec, scene, device):
        assert device == "cuda:0"
        return self.holds and self.holds * 200 // scene.grains.count

    def open(self, spec, slots=None, device="cpu"):
        ensemble, backend = super().open(spec, None, "cpu"), self
        admit = ensemble.admit

        def counted(*given, **options):
            member = admit(*given, **options)
            backend.most = max(backend.most, len(ensemble.glasses))
            return member

        ensemble.admit = counted
        return ensemble


@pytest.mark.parametrize(("holds", "most"), [(1, 1), (3, 3), (None, 4)])
def test_as_many_runs_at_once_as_fit(tmp_path, holds, most):
    backend = Device(holds)
    summary = carry_out(study(tmp_path), tmp_path / "lab", backend=backend, device="cuda:0")
    assert len(summary.tally.ran) == 4
    assert backend.most == most


def test_the_point_that_needs_most_decides(tmp_path):
    path = study_file(tmp_path, orifices="[24]", replicates=3)
    path.write_text(path.read_text().replace("sweep:\n", 'sweep:\n  grains.count: "[100, 200]"\n'))
    backend = Device(2)
    summary = carry_out(load(path), tmp_path / "lab", backend=backend, device="cuda:0")
    assert len(summary.tally.ran) == 6
    assert backend.most == 2, "four of 100 grains would fit, but one of 200 may come next"


def test_runs_that_are_recorded_go_on_beside_those_that_are_not(tmp_path):
    backend = Device(None)
    asked = study(tmp_path, "record: {every: 4 ms, replicates: 1}", orifices="[24]", replicates=4)
    summary = carry_out(asked, tmp_path / "lab", backend=backend, device="cuda:0")
    assert len(summary.tally.ran) == 4
    assert backend.most == 4, "two waves, where one takes them all"
    assert len([*(tmp_path / "lab").rglob("recording.npz")]) == 1


class Small(Device):
    """Its memory is taken by another program once there are members: an allocation fails whenever more than two of them
    take a beat, after the first few beats."""

    def __init__(self):
        super().__init__(None)
        self.refused = 0

    def open(self, spec, slots=None, device="cpu"):
        ensemble, backend, taken = super().open(spec, slots, device), self, 0
        advance = ensemble.advance

        def tight(beats=1):
            nonlocal taken
            taken += 1
            if len(ensemble.glasses) > 2 and taken > 2:
                backend.refused += 1
                raise MemoryError(f"cuda:0 has no memory for {len(ensemble.glasses)} members: none; use fewer grains")
            return advance(beats)

        ensemble.advance = tight
        return ensemble


def test_runs_for_which_memory_runs_out_later_go_on_with_fewer_at_once(tmp_path):
    told, alone = list[str](), tmp_path / "alone"

    class Told(NullWatcher):
        def tell(self, line: str) -> None:
            told.append(line)

    backend = Small()
    asked = study(tmp_path, replicates=4)
    summary = carry_out(asked, tmp_path / "lab", backend=backend, device="cuda:0", watcher=Told(), checkpoint_every=0)
    assert backend.refused
    assert summary.failed == ()
    assert len(summary.tally.ran) == 8
    words = [line for line in told if "has no memory" in line]
    assert len(words) == backend.refused
    assert all(len(line.splitlines()) == 1 and "at once" in line and "--device cuda:all" in line for line in words)
    carry_out(asked, alone)
    for kind in ("runs", "packings"):
        for folder in sorted((alone / kind).iterdir()):
            assert arrays(tmp_path / "lab" / kind / folder.name) == arrays(folder)


def test_one_run_that_memory_has_no_room_for_fails_by_itself(tmp_path, monkeypatch):
    def none(*_):
        raise MemoryError("cuda:0 has no memory for 1 members: none; use fewer grains")

    monkeypatch.setattr(labbook_toy.Ensemble, "advance", none)
    summary = carry_out(study(tmp_path, orifices="[24]"), tmp_path / "lab", backend=Device(None), device="cuda:0")
    assert len(summary.failed) == 2
    assert all("use fewer grains" in why for why in summary.failed)


@pytest.fixture
def turns(monkeypatch):
    """Kinds, members and threads of all turns of a run."""
    found = []
    turn = EnsembleWorker._run_beat

    def noted(self, new, use):
        took = turn(self, new, use)
        found.append((set(self.kinds), len(self.jobs), threading.current_thread(), self.opened))
        return took

    monkeypatch.setattr(EnsembleWorker, "_run_beat", noted)
    return found


def test_runs_go_on_while_other_beds_settle_with_the_same_bits(tmp_path, turns, monkeypatch):
    monkeypatch.setattr(job_queue, "PLACE_AHEAD_GRAINS", 1)
    monkeypatch.setattr(finalizing, "_PLACED_AHEAD", 2)
    asked = study(tmp_path, replicates=8, orifices="[24]")
    carry_out(asked, tmp_path / "cpu")
    turns.clear()
    is_placed: Any = FillJob.is_placed.fget
    late = property(lambda job: is_placed(job) and (job.demand.seed < 5 or any("run" in kinds for kinds, *_ in turns)))
    monkeypatch.setattr(FillJob, "is_placed", late)
    summary = carry_out(asked, tmp_path / "gpu", backend=Device(None), device="cuda:0")
    assert summary.complete
    folders = [path.relative_to(tmp_path / "cpu") for path in (tmp_path / "cpu").glob("[rp]*s/*")]
    assert len(folders) == 16
    assert all(arrays(tmp_path / "gpu" / folder) == arrays(tmp_path / "cpu" / folder) for folder in folders)
    kinds = [kind for (kind,), *_ in turns]
    assert "packing" in kinds[kinds.index("run") :]
    assert len({thread for *_, thread, _ in turns}) == 1, "one thread uses the device"
    assert {opened for *_, opened in turns} == {8}, "ensembles are laid out once"


def test_fillings_are_placed_ahead_but_not_all(tmp_path, monkeypatch):
    monkeypatch.setattr(job_queue, "PLACE_AHEAD_GRAINS", 1)
    monkeypatch.setattr(finalizing, "_PLACED_AHEAD", 1)
    waiting = []
    place_ahead = job_queue.JobQueue.place_ahead

    def noted(self):
        place_ahead(self)
        waiting.append(len(self.being_placed))

    monkeypatch.setattr(job_queue.JobQueue, "place_ahead", noted)
    monkeypatch.setattr("labbook.run.runner.cores", lambda: 3)
    assert carry_out(
        study(tmp_path, replicates=8, orifices="[24]"), tmp_path / "lab", backend=Device(None), device="cuda:0"
    ).complete
    assert max(waiting) == 3


def test_a_stop_gives_back_the_beds_that_are_being_placed(tmp_path, monkeypatch):
    monkeypatch.setattr(job_queue, "PLACE_AHEAD_GRAINS", 1)
    request, verdict = StopRequest(), FillJob.verdict

    def stopped(self, events):
        request.requested = True
        return verdict(self, events)

    monkeypatch.setattr(FillJob, "verdict", stopped)
    asked = study(tmp_path, replicates=8, orifices="[24]")
    carry_out(asked, tmp_path / "lab", backend=Device(None), device="cuda:0", request=request)
    assert not [*(tmp_path / "lab/work").glob("*.lock")], "no key is held"
    monkeypatch.undo()
    assert carry_out(asked, tmp_path / "lab", backend=Device(None), device="cuda:0").complete


@pytest.mark.parametrize("holds", [1, 2, 3])
def test_lanes_share_the_memory_of_a_device(tmp_path, turns, monkeypatch, holds):
    """Where there is no room for both ensembles, the one without members makes way."""
    opened, closed = [], labbook_toy.Ensemble.close
    backend = Device(holds)
    monkeypatch.setattr(backend, "open", lambda *given: opened.append(Device.open(backend, *given)) or opened[-1])
    monkeypatch.setattr(labbook_toy.Ensemble, "close", lambda self: opened.remove(self) or closed(self))
    most, turn = [], EnsembleWorker._run_beat

    def counted(self, *given):
        took = turn(self, *given)
        most.append(sum(len(ensemble.glasses) for ensemble in opened))
        return took

    monkeypatch.setattr(EnsembleWorker, "_run_beat", counted)
    asked = study(tmp_path, replicates=4, orifices="[24]")
    assert carry_out(asked, tmp_path / "lab", backend=backend, device="cuda:0").complete
    assert max(most) == holds
    assert {kind for (kind,), *_ in turns} == {"packing", "run"}


def test_members_share_the_time_of_a_device(tmp_path, monkeypatch):
    """The wall time of all beats, but for each first one, in which kernels are compiled, is that of runs and fillings
    together; it is shared by grain-steps, and the index has it."""
    beats, beat = [], EnsembleWorker._run_beat

    def run_beat(worker, *words):
        result = beat(worker, *words)
        beats.append((len(worker.jobs), result.compiling, result.wall))
        return result

    monkeypatch.setattr(EnsembleWorker, "_run_beat", run_beat)
    monkeypatch.setattr(ensemble_worker, "_prepared", set())
    asked, lab = study(tmp_path), tmp_path / "lab"
    assert carry_out(asked, lab, backend=Device(None), device="cuda:0").complete
    assert sum(compiling for _, compiling, _ in beats) in (1, 2), "one for each Spec"
    assert max(members for members, *_ in beats) > 1
    records = [kind.read(path) for kind, folder in ((RunRecord, "runs"), (PackingRecord, "packings"))
               for path in (lab / folder).iterdir()]  # fmt: skip
    times = [record.device_time or 0.0 for record in records]
    assert sum(times) == pytest.approx(sum(wall for _, compiling, wall in beats if not compiling), rel=1e-9)
    for record, time in zip(records, times, strict=True):
        assert 0 < time < record.wall_time, "others were stepped at the same time"
    catalogue = Catalogue(LabFolder(lab))
    indexed = catalogue.device_times(
        (path.name for path in (lab / "runs").iterdir()), (path.name for path in (lab / "packings").iterdir())
    )
    assert sorted(indexed.values(), key=str) == sorted(times, key=str)
    for entry in catalogue.entries(path.name for path in (lab / "runs").iterdir()):
        assert entry.device_time == indexed[entry.run_key]
        assert entry.filling_time == indexed[entry.packing_key]
