"""Lanes share the work of a study, and progress tells how far it is."""

import math
import time
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

from labbook_toy import Backend, Ensemble
from toy_lab import arrays, carry_out, study, study_file
from toy_records import outcomes

from labbook.backend import Spec
from labbook.lab import Catalogue, LabFolder
from labbook.lab.index import Index
from labbook.lab.records import Observe
from labbook.plan.plan import Planner
from labbook.run import execution
from labbook.run.fill import FillJob
from labbook.run.job import Job, JobContext
from labbook.run.job_queue import JobQueue
from labbook.run.progress import counts
from labbook.run.stopping import StopRequest
from labbook.run.watch import NullWatcher, View
from labbook.study import load


def test_lanes_do_not_change_a_bit(tmp_path):
    asked = study(tmp_path, "record: {every: 4 ms, replicates: 1}")
    for lanes in (1, 3):
        carry_out(asked, tmp_path / str(lanes), workers=lanes, checkpoint_every=0.03 if lanes == 1 else 1e9)
    for folder in ("runs", "packings"):
        keys = sorted(path.name for path in (tmp_path / "1" / folder).iterdir())
        assert keys == sorted(path.name for path in (tmp_path / "3" / folder).iterdir())
        for key in keys:
            assert arrays(tmp_path / "1" / folder / key) == arrays(tmp_path / "3" / folder / key)


def test_saving_that_takes_long_is_done_seldom(tmp_path, monkeypatch):
    save, saved = Job.save, []
    monkeypatch.setattr(Job, "save", lambda job, *member: saved.append(job) or save(job, *member))
    asked = study(tmp_path, orifices="[24]", replicates=2)
    carry_out(asked, tmp_path / "short", workers=1, checkpoint_every=0)
    often = len(saved)
    saved.clear()
    monkeypatch.setattr(execution, "_SAVING_ALLOWANCE", 0.0)
    monkeypatch.setattr(execution, "_SAVING_SHARE", 1e-6)  # so that the next save is hours away
    carry_out(asked, tmp_path / "long", workers=1, checkpoint_every=0)
    assert len(saved) == 1 < often


def test_saving_takes_its_part_of_the_time_and_the_longest_unsaved_come_first(monkeypatch):
    now: list[float] = [0.0]
    saved: list[str] = []

    class Slow:
        unsaved = 0

        def save(self, ensemble, member):
            saved.append(member)
            now[0] += 10

    monkeypatch.setattr(execution, "time", SimpleNamespace(perf_counter=lambda: now[0]))
    nothing: Any = None
    carrying: Any = execution.Execution(
        nothing, nothing, Backend(), "cpu", 0, 1, 1, nothing, StopRequest(), print, execution.CHECKPOINT_EVERY
    )
    lane = SimpleNamespace(ensemble=object(), saving=0.0, jobs={member: Slow() for member in "abcd"})
    carrying._last_saved = dict.fromkeys(lane.jobs.values(), 0.0)
    for turn in range(100):
        now[0] = max(now[0], 40.0 * turn)
        carrying._save(lane)
        assert lane.saving == 10 * len(saved)
        assert 10 * (len(saved) - 1) <= max(execution._SAVING_ALLOWANCE, execution._SAVING_SHARE * now[0])
    assert saved == list("abcd" * 5)  # one in 200 s
    now[0], carrying._checkpoint_every = 1e6, 1e9  # there is time, and none is due
    carrying._save(lane)
    assert len(saved) == 20


def test_a_job_that_needs_another_spec_is_begun_once_to_learn_that(tmp_path, monkeypatch):
    begun = []
    begin = FillJob.begin
    monkeypatch.setattr(FillJob, "begin", lambda job: begun.append(job.key) or begin(job))
    asked, backend, lab = study(tmp_path), Backend(), LabFolder(tmp_path / "lab")
    catalogue, index = Catalogue(lab), Index(lab)
    try:
        planner = Planner(asked, catalogue, backend.capabilities)
        board = JobQueue(
            JobContext(lab, backend, "cpu"), planner, index, Observe(measure=asked.measure, start=0, end=1)
        )
        board.load_plan(planner.plan())
        other = Spec(backend="toy", features=(), steps_per_beat=7)
        assert [list(board.jobs(other)) for _ in range(5)] == [[]] * 5
        assert len(begun) == len(set(begun)) == 2, "two packings"
        started = next(board.jobs())
        assert started.spec != other
        board.drop(started.job)
    finally:
        catalogue.close()
        index.close()


def test_progress_tells_runs_from_packings(tmp_path, monkeypatch):
    monkeypatch.setattr(execution, "_STOP_INTERVAL", 0.0)  # after every beat, whatever the clock says
    monkeypatch.setattr(execution, "_REPORT_SHARE", math.inf)
    seen = []

    class Watch(NullWatcher):
        def show(self, view: View) -> None:
            made = [len(list((tmp_path / "lab" / name).glob("*"))) for name in ("packings", "runs")]
            seen.append((view.fillings_left, view.runs_done, *made, [one.phase for one in view.going].count("writing")))

    carry_out(study(tmp_path), tmp_path / "lab", watcher=Watch(), workers=1)
    assert len({left for left, *_ in seen}) > 1, "it was looked at while packings were being made, and later"
    for left, done, packings, runs, writing in seen:  # what is being written may be in its folder already
        assert 0 <= left - (2 - packings) <= writing
        assert 0 <= runs - done <= writing


def test_progress_in_words():
    view = View(0, 12, 2, going=(), elsewhere=0, work_done=0.0, work_left=1.0, rate=0.0)
    assert counts(view) == "0/12 runs, 2 packings first"
    assert counts(replace(view, fillings_left=1)) == "0/12 runs, 1 packing first"
    assert counts(replace(view, runs_done=3, fillings_left=0)) == "3/12 runs"


class Compiling(Backend):
    """Compiles at the first beat of a Spec, which must not happen twice at once."""

    def __init__(self):
        super().__init__()
        self.ready, self.at_it, self.clashes = set(), 0, 0

    def open(self, spec, slots=None, device="cpu"):
        return CompilingEnsemble(self, spec, slots)


class CompilingEnsemble(Ensemble):
    def advance(self, beats=1):
        backend = self._backend
        if self._spec not in backend.ready:
            backend.clashes += backend.at_it > 0
            backend.at_it += 1
            time.sleep(0.1)
            backend.at_it -= 1
            backend.ready.add(self._spec)
        return super().advance(beats)


def test_lanes_leave_compiling_at_the_first_beat_to_one_of_them(tmp_path):
    backend = Compiling()
    # a number of steps that no other test has: what was used before in this process is known
    asked = study_file(tmp_path, replicates=4)
    asked.write_text(asked.read_text().replace("steps_per_beat: 200", "steps_per_beat: 187"))
    summary = carry_out(load(asked), tmp_path / "lab", backend=backend, workers=4)
    assert outcomes(summary) == ["finished"] * 8
    assert len(backend.ready) == 2
    assert backend.clashes == 0
