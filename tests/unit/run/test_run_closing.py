"""What members of an ensemble leave is written and measured by other threads, while the ensemble goes on."""

import threading
import time
from dataclasses import dataclass

import pandas as pd
import pytest
from labbook_toy import Backend, Ensemble
from toy_lab import arrays, carry_out, study
from toy_records import outcomes

from labbook.filling import PlacingError, place
from labbook.lab import Catalogue
from labbook.lab.folder import DiskFull, LabFolder
from labbook.lab.index import Index, run_rows
from labbook.lab.records import RunRecord, Unreadable
from labbook.lab.runs import picture
from labbook.plan.plan import Planner
from labbook.run import discharge, execution, finalizing, job_queue, runner
from labbook.run.discharge import DischargeJob, RunOutput
from labbook.run.helper import HelperLost, HelperProcess, idle_helpers
from labbook.run.job import JobFailed, JobOutput, LabEntry
from labbook.run.watch import NullWatcher


@pytest.fixture
def together(monkeypatch):
    """One ensemble takes all jobs, and several threads write what they leave, as on a GPU."""
    monkeypatch.setattr(runner, "slots", lambda *_: 100)
    monkeypatch.setattr(
        runner.Runner, "_make_finalizers", lambda _: [finalizing.Finalizer(alone=False) for _ in range(3)]
    )


def test_what_is_written_by_other_threads_is_the_same_in_every_bit(tmp_path, together):
    asked = study(tmp_path, "record: {every: 4 ms, replicates: 1}", replicates=4)
    carry_out(asked, tmp_path / "many", workers=1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runner, "slots", lambda *_: 1)
        patch.setattr(runner.Runner, "_make_finalizers", lambda _: [finalizing.Finalizer(alone=True)])
        carry_out(asked, tmp_path / "one", workers=1)
    for folder in ("runs", "packings"):
        keys = {path.name for path in (tmp_path / "one" / folder).iterdir()}
        assert keys == {path.name for path in (tmp_path / "many" / folder).iterdir()}
        for key in keys:
            assert arrays(tmp_path / "one" / folder / key) == arrays(tmp_path / "many" / folder / key)
    one, many = (Catalogue(tmp_path / name).measurements() for name in ("one", "many"))
    keys = ["run_key", "measure", "quantity"]
    one, many = (found.sort_values(keys, ignore_index=True) for found in (one, many))
    pd.testing.assert_frame_equal(one, many, check_exact=True)


def test_runs_are_written_by_other_processes_but_the_first_of_each_thread(tmp_path, together, monkeypatch):
    here, there = [], []
    put, aside = JobOutput.put, HelperProcess.put
    monkeypatch.setattr(JobOutput, "put", lambda self: here.append(self.key) or put(self))
    monkeypatch.setattr(HelperProcess, "put", lambda self, kept: there.append(kept.key) or aside(self, kept))
    summary = carry_out(study(tmp_path, replicates=4), tmp_path / "lab", workers=1)
    assert summary.complete
    assert len(here) == 3
    assert len(there) > 3
    assert not {*here} & {*there}


def test_what_a_process_that_is_killed_was_given_is_written_here(tmp_path, together, monkeypatch, caplog):
    killed, aside = [], HelperProcess.put

    def kill(self, kept):
        if not killed:
            killed.append(kept.key)
            self._process.kill()
        return aside(self, kept)

    monkeypatch.setattr(HelperProcess, "put", kill)
    asked = study(tmp_path, replicates=4)
    assert carry_out(asked, tmp_path / "lab", workers=1).complete
    assert len(killed) == 1
    assert "written by this process, as no process beside it could be used" in caplog.text
    assert carry_out(asked, tmp_path / "lab", workers=1).tally.ran == {}, "nothing was left to do"


def test_a_process_killed_while_it_measures_loses_no_run(tmp_path, together, monkeypatch, caplog):
    """The run is in the lab by then, and what was saved of it in its work folder is gone."""
    killed, last, put, entry = [], {}, HelperProcess.put, HelperProcess.entry

    def noted(self, kept):
        last[self] = kept
        put(self, kept)

    def kill(self):
        if not killed and isinstance(last[self], RunOutput):
            killed.append(last[self].key)
            self._process.kill()
            self._process.stdout.read()
        return entry(self)

    monkeypatch.setattr(HelperProcess, "put", noted)
    monkeypatch.setattr(HelperProcess, "entry", kill)
    asked = study(tmp_path, replicates=4)
    assert carry_out(asked, tmp_path / "lab", workers=1, checkpoint_every=0.0).complete
    assert len(killed) == 1
    assert "measured by this process, as no process beside it could be used" in caplog.text
    assert carry_out(asked, tmp_path / "lab", workers=1).tally.ran == {}, "nothing was left to do"


def test_an_error_of_another_process_comes_back_as_it_was(tmp_path):
    lab = LabFolder(tmp_path / "lab")
    process = HelperProcess()
    try:
        with pytest.raises(DiskFull) as full:
            process.put(Failing(lab, "key", lab.run("key"), "run", "full"))
        assert str(full.value) == str(DiskFull(tmp_path))
        with pytest.raises(JobFailed, match="starts from step 0"):
            process.put(Failing(lab, "key", lab.run("key"), "run", "unreadable"))
        weightless = study(tmp_path).points[0].scene.model_copy(update={"gravity": 0.0}).close()
        with pytest.raises(PlacingError, match="a filling needs gravity"):
            process.call(place, weightless, "rain", 1)
        with pytest.raises(HelperLost, match="cannot pickle"):
            process.put(Failing(lab, "key", lab.run("key"), "run", threading.Lock()))
    finally:
        process.end()


@dataclass(frozen=True)
class Failing(JobOutput):
    """What cannot be written."""

    how: object

    def fill_folder(self, folder):
        if self.how == "full":
            raise DiskFull(self.lab.folder.parent)
        raise Unreadable("rows: damaged")

    def entry(self):
        return LabEntry(({}, []))

    reread = entry


def test_an_ensemble_goes_on_while_a_run_is_written(tmp_path, together, monkeypatch):
    beats, entered, went_on = [0], [], []
    advance, kept = Ensemble.advance, DischargeJob.output

    def counted(self, *given):
        beats[0] += 1
        return advance(self, *given)

    def slow(self, verdict, left):
        if not entered:  # the first run to end: others have beats to go
            entered.append(self)
            before, until = beats[0], time.monotonic() + 20
            while beats[0] < before + 2 and time.monotonic() < until:
                time.sleep(0.001)
            went_on.append(beats[0] >= before + 2)
        return kept(self, verdict, left)

    monkeypatch.setattr(Ensemble, "advance", counted)
    monkeypatch.setattr(DischargeJob, "output", slow)
    summary = carry_out(study(tmp_path, orifices="[18, 36]"), tmp_path / "lab", workers=1)
    assert went_on == [True]
    assert outcomes(summary) == ["finished"] * 4


def test_a_disk_that_is_full_ends_all_and_the_next_command_goes_on(tmp_path, together, monkeypatch):
    asked = study(tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr("labbook.run.discharge.PICTURE", "/dev/full")
        patch.setattr(idle_helpers, "take", unable)
        with pytest.raises(DiskFull):
            carry_out(asked, tmp_path / "lab", workers=1)
    assert not list((tmp_path / "lab").glob("runs/*"))
    summary = carry_out(asked, tmp_path / "lab", workers=1)
    assert summary.complete
    for thread in threading.enumerate():
        if thread.name == "labbook-closing":
            thread.join(60)  # its process may still be starting
            assert not thread.is_alive()


def unable():
    raise HelperLost("no process can be begun")


def test_jobs_that_hold_too_many_grains_are_waited_for(tmp_path, together, monkeypatch):
    monkeypatch.setattr(finalizing, "MAX_HELD_GRAINS", 250)  # one job of 200 grains, and no second one
    at_once, most = [0], [0]
    put = finalizing.Finalizer.finalize
    lock = threading.Lock()

    def counted(self, kept):
        with lock:
            at_once[0] += 1
            most[0] = max(most[0], at_once[0])
        time.sleep(0.02)
        found = put(self, kept)
        with lock:
            at_once[0] -= 1
        return found

    monkeypatch.setattr(finalizing.Finalizer, "finalize", counted)
    assert carry_out(study(tmp_path, replicates=4), tmp_path / "lab", workers=1).complete
    assert most == [1]


def test_a_run_that_is_written_is_told(tmp_path, together, monkeypatch):
    monkeypatch.setattr(execution, "_STOP_INTERVAL", 0.0)
    monkeypatch.setattr(execution, "_REPORT_SHARE", float("inf"))
    put = finalizing.Finalizer.finalize
    monkeypatch.setattr(finalizing.Finalizer, "finalize", lambda *given: (time.sleep(0.05), put(*given))[1])
    seen = set()

    class Watch(NullWatcher):
        def show(self, view):
            seen.update((one.phase, one.says) for one in view.going)

    carry_out(study(tmp_path), tmp_path / "lab", watcher=Watch(), workers=1, backend=Backend())
    assert ("writing", ("writing and measuring",)) in seen


def test_grains_that_other_processes_place_are_those_placed_here(tmp_path, together, monkeypatch):
    asked = study(tmp_path, replicates=4)
    carry_out(asked, tmp_path / "here", workers=1)
    monkeypatch.setattr(job_queue, "PLACE_AHEAD_GRAINS", 1)
    placed, call = [], HelperProcess.call

    def noted(self, function, *given):
        placed.append(given[2])
        return call(self, function, *given)

    monkeypatch.setattr(HelperProcess, "call", noted)
    carry_out(asked, tmp_path / "there", workers=1)
    assert len(placed) == len(list((tmp_path / "there/packings").iterdir())) > 1
    for folder in (tmp_path / "here/packings").iterdir():
        assert arrays(folder) == arrays(tmp_path / "there/packings" / folder.name)


def test_a_process_killed_while_it_places_loses_no_filling(tmp_path, together, monkeypatch, caplog):
    monkeypatch.setattr(job_queue, "PLACE_AHEAD_GRAINS", 1)
    killed, call = [], HelperProcess.call

    def kill(self, function, *given):
        if not killed:
            killed.append(given)
            self._process.kill()
        return call(self, function, *given)

    monkeypatch.setattr(HelperProcess, "call", kill)
    assert carry_out(study(tmp_path, replicates=4), tmp_path / "lab", workers=1).complete
    assert "placed by this process, as no process beside it could be used" in caplog.text


def test_looks_at_runs_do_not_grow_with_the_square_of_the_replicates(tmp_path, monkeypatch):
    looks, look = [], Planner._item
    monkeypatch.setattr(Planner, "_item", lambda self, *given: looks.append(1) or look(self, *given))
    cost = {}
    monkeypatch.setattr(runner, "slots", lambda *_: 100)
    for replicates in (4, 16):
        looks.clear()
        asked = study(tmp_path, replicates=replicates, orifices="[24]", count=50)
        carry_out(asked, tmp_path / f"lab-{replicates}", workers=1)
        cost[replicates] = len(looks)
    assert cost[16] <= 4 * cost[4]


def test_runs_that_end_together_enter_the_index_in_one_transaction(tmp_path):
    lab = LabFolder(tmp_path / "lab")
    carry_out(study(tmp_path, replicates=3, orifices="[24, 30]", count=50), lab.folder)
    rows = {lab.run(path.name): run_rows(lab.run(path.name), None) for path in lab.runs.iterdir()}
    index, written = Index(lab), []
    began = index._transaction
    index._transaction = lambda: written.append(1) or began()
    before = Catalogue(lab).measurements()
    assert index.put_runs(rows) == dict.fromkeys(rows)
    assert len(written) == 1
    odd = next(iter(rows))
    rows[odd][0]["label"] = "\ud800"  # which no database takes
    problems = index.put_runs(rows)
    assert [folder for folder, problem in problems.items() if problem] == [odd], "the others are stored"
    index.close()
    assert set(before["run_key"]) - set(Catalogue(lab).measurements()["run_key"]) == {odd.name}


def test_beds_of_the_first_seeds_are_drawn_and_of_those_that_clog(tmp_path, monkeypatch):
    monkeypatch.setattr(discharge, "PICTURED", 2)
    lab = LabFolder(tmp_path / "lab")
    carry_out(study(tmp_path, replicates=3, orifices="[6, 24]", count=50), lab.folder)
    drawn = {}
    for folder in lab.runs.iterdir():
        record = RunRecord.read(folder)
        drawn[record.outcome, record.seed] = picture(folder) is not None
    assert drawn == {
        **{("clogged", seed): True for seed in (1, 2, 3)},
        **{("finished", seed): seed <= 2 for seed in (1, 2, 3)},
    }
