"""How runs end, and what a longer demand does with them."""

import errno
import os
import threading
import time
from importlib import import_module
from types import SimpleNamespace

import numpy as np
import pytest
from labbook_toy import Backend
from toy_lab import arrays, carry_out, study, study_file
from toy_records import outcomes, records
from toy_results import analyse

from labbook.backend import Overflow
from labbook.lab import Catalogue, LabFolder
from labbook.lab.folder import DiskFull
from labbook.lab.packings import load_packing
from labbook.lab.tables import read_checkpoint
from labbook.plan.coverage import finished
from labbook.plan.plan import Planner
from labbook.run.discharge import DischargeJob
from labbook.study import load


def test_an_outlet_that_clogs_leaves_a_censored_waiting_time(tmp_path):
    asked = study(tmp_path, "stop: {stall: 0.5 s}", orifices="[8, 24]", replicates=1)
    carry_out(asked, tmp_path / "lab")
    found = records(tmp_path / "lab")
    assert found["orifice 24 mm", 1].outcome == "finished"
    clogged = found["orifice 8 mm", 1]
    assert clogged.outcome == "clogged"
    assert clogged.coverage.waiting >= 0.5
    assert clogged.coverage.crossed == 200 // 3


def test_a_run_out_of_time_says_so_and_goes_on_when_more_is_asked(tmp_path):
    short = study(tmp_path, "stop: {max_time: 20 ms}", replicates=1)
    carry_out(short, tmp_path / "lab")
    assert {record.outcome for record in records(tmp_path / "lab").values()} == {"time-limit"}
    longer = study(tmp_path, replicates=1)
    summary = carry_out(longer, tmp_path / "lab")
    assert outcomes(summary) == ["finished"] * 2
    assert summary.tally.resumed == 2
    carry_out(longer, tmp_path / "whole")
    for (label, seed), record in records(tmp_path / "lab").items():
        assert [session.from_step for session in record.sessions] == [0, 2000], (label, seed)
        assert arrays(tmp_path / "lab/runs" / record.run_key) == arrays(tmp_path / "whole/runs" / record.run_key)
    assert not list((tmp_path / "lab/work").iterdir())


def test_a_bed_that_has_fallen_to_the_asked_height_is_done(tmp_path):
    lab, sizes = tmp_path / "lab", {"replicates": 1, "orifices": "[24, 30]"}
    carry_out(study(tmp_path, **sizes), tmp_path / "other")
    packing = load_packing(next((tmp_path / "other/packings").iterdir()))
    height = 2 * packing.x[:, 2].mean()
    halved = study(tmp_path, f"stop: {{fill_height: {height / 2 * 1e3} mm}}", **sizes)
    assert outcomes(carry_out(halved, lab)) == ["finished"] * 2
    for record in records(lab).values():
        assert record.coverage.bed_height == pytest.approx(height)
        assert 0.5 <= record.coverage.discharged < 0.55
    assert not carry_out(halved, lab).tally.ran
    high = study(tmp_path, f"stop: {{fill_height: {height * 1e3} mm}}", replicates=2, orifices="[24, 30]")
    assert any("not above stop.fill_height" in line for line in carry_out(high, tmp_path / "third").tally.failed)


def test_what_is_emptied_is_done_whatever_is_asked(tmp_path):
    asked = study(tmp_path, "stop: {discharged: 1}", replicates=1, orifices="[24, 30]")
    carry_out(asked, tmp_path / "lab")
    found = records(tmp_path / "lab")
    assert {record.coverage.discharged for record in found.values()} == {1.0}
    longer = study(tmp_path, "stop: {max_time: 99 s}", replicates=1, orifices="[24, 30]")
    assert not carry_out(longer, tmp_path / "lab").tally.ran


def test_a_guard_ends_one_run_and_others_go_on(tmp_path):
    asked = study(tmp_path, replicates=1)
    summary = carry_out(asked, tmp_path / "lab", backend=Backend(fails=18))
    assert outcomes(summary) == ["diverged", "finished"]
    failed = records(tmp_path / "lab")["orifice 18 mm", 1]
    assert failed.failure is not None
    assert failed.failure.guard == "overlap"
    assert 0 <= failed.failure.grain < 200
    assert failed.coverage.steps <= failed.failure.step < failed.coverage.steps + 100, "the last good beat is kept"
    kept = read_checkpoint(LabFolder(tmp_path / "lab").run(failed.run_key) / "checkpoint.npz")
    assert kept.arrays["count"][0] == failed.coverage.steps
    assert not carry_out(asked, tmp_path / "lab").tally.ran, "it is deterministic: it is not run again"
    other = study(tmp_path, replicates=1)
    wider = [p.numerics.model_copy(update={"overlap_limit": 0.5}) for p in other.points]
    points = tuple(
        type(p)(p.index, p.scene, p.fill, n, p.at, p.label) for p, n in zip(other.points, wider, strict=True)
    )
    object.__setattr__(other, "points", points)
    again = carry_out(other, tmp_path / "lab")
    assert again.tally.resumed == 1, "under another guard it goes on from its last good state"
    assert records(tmp_path / "lab")["orifice 18 mm", 1].outcome == "finished"


def test_a_filling_that_does_not_settle_says_what_to_do_and_goes_on_when_allowed(tmp_path):
    hasty = study(tmp_path, "fill: {max_time: 2 ms}")
    summary = carry_out(hasty, tmp_path / "lab")
    assert len(summary.tally.failed) == 2
    assert all("fill.max_time" in why for why in summary.tally.failed)
    assert not summary.tally.ran
    patient = carry_out(study(tmp_path), tmp_path / "lab")
    assert outcomes(patient) == ["finished"] * 4
    carry_out(study(tmp_path), tmp_path / "whole")
    for key in (path.name for path in (tmp_path / "whole/packings").iterdir()):
        assert arrays(tmp_path / "lab/packings" / key) == arrays(tmp_path / "whole/packings" / key)


def test_an_overflow_fails_its_run_loudly_and_others_go_on(tmp_path):
    class Small(Backend):
        def open(self, spec, slots=None, device="cpu"):
            ensemble = super().open(spec, slots, device)
            drain = ensemble.drain

            def full():
                rows = drain()
                if any(x < 0.012 for table in rows.values() for x in np.abs(table["x"])) and self.overflows:
                    self.overflows -= 1
                    raise Overflow("crossings: 1 row for 2")
                return rows

            ensemble.drain = full
            return ensemble

        overflows = 1

    summary = carry_out(study(tmp_path), tmp_path / "lab", backend=Small())
    assert outcomes(summary) == ["finished"] * 3
    (why,) = summary.tally.failed
    assert "crossings: 1 row for 2" in why
    assert len(carry_out(study(tmp_path), tmp_path / "lab").tally.ran) == 1


TWINS = 'sweep: {numerics.speed_limit: "[50, 100] m/s"}'
"""A guard is no part of a run's key: both points ask for the same runs."""


def twins(folder, **changes):
    path = study_file(folder, **changes)
    swept = path.read_text().split("sweep:")[1].split("replicates")[0]
    path.write_text(path.read_text().replace(f"sweep:{swept}", f"{TWINS}\n"))
    return load(path)


def test_points_that_share_a_run_are_all_done_when_it_is(tmp_path):
    asked, lab = twins(tmp_path), tmp_path / "lab"
    ahead = Planner(asked, Catalogue(lab), Backend().capabilities).plan()
    assert len({item.keys.run for item in ahead.items}) == len(ahead.todo) == 2
    summary = carry_out(asked, lab)
    assert outcomes(summary) == ["finished"] * 2
    assert [[item.state for item in point.items] for point in summary.points] == [["done"] * 2] * 2
    assert summary.lines()[0].startswith("2 of 2 runs done"), "a shared run counts once"
    assert [(run.point.index, run.seed) for run in finished(Catalogue(lab), asked, "toy")] == [
        (0, 1),
        (0, 2),
        (1, 1),
        (1, 2),
    ]


def test_a_shared_run_that_diverged_is_not_handed_to_and_fro(tmp_path):
    summary = carry_out(twins(tmp_path, replicates=1), tmp_path / "lab", backend=Backend(fails=24))
    assert outcomes(summary) == ["diverged"]


def test_a_run_that_no_grain_left_has_seen_none_and_says_so(tmp_path):
    asked, lab = study(tmp_path, "stop: {max_time: 4 ms}", orifices="[12]", replicates=1), tmp_path / "lab"
    carry_out(asked, lab)
    (run,) = finished(Catalogue(lab), asked, "toy")
    assert run.record.coverage.crossed == 0
    assert len(run.data().tables["crossing"]["time"]) == 0
    (point,) = analyse(asked, [run]).points
    rate = point.runs[0].measured["flow_rate"]
    assert np.isnan(rate.value)
    assert "too few grains: 0 of 200 left" in rate.note
    longer = study(tmp_path, orifices="[12]", replicates=1)
    assert carry_out(longer, lab).tally.resumed == 1
    (run,) = finished(Catalogue(lab), longer, "toy")
    assert len(run.data().tables["crossing"]["time"]) == run.record.coverage.crossed > 0


@pytest.mark.parametrize("step", ["job.Job.begin", "job_queue.JobQueue._is_in_lab", "runner.Planner.refresh"])
def test_what_fails_at_a_beginning_gives_its_claim_back(tmp_path, monkeypatch, step):
    """A claim that is kept would let the next call in the same process wait for ever."""

    def full(self, *_):
        if list((tmp_path / "lab/work").glob("*.lock")):  # a claim is held
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return begun(self, *_)

    asked = study(tmp_path, orifices="[24]", replicates=1)
    module, name = step.split(".", 1)
    owner = getattr(import_module(f"labbook.run.{module}"), name.split(".")[0])
    method = name.split(".")[1]
    begun = getattr(owner, method)
    with monkeypatch.context() as patch:
        patch.setattr(owner, method, full)
        with pytest.raises(DiskFull):
            carry_out(asked, tmp_path / "lab")
    assert not list((tmp_path / "lab/work").glob("*.lock"))
    assert outcomes(carry_out(asked, tmp_path / "lab", workers=1)) == ["finished"]


def test_a_full_disk_ends_when_no_kernel_is_at_work_any_more(tmp_path, monkeypatch):
    """Threads of lanes are no part of what Python waits for at its end."""
    at_work, quick = set(), []

    class Slow(Backend):
        def open(self, spec, slots=None, device="cpu"):
            ensemble = super().open(spec, slots, device)
            advance = ensemble.advance

            def advances(beats=1):
                lane = threading.get_ident()
                quick.append(lane)
                at_work.add(lane)
                time.sleep(0.0 if lane == quick[0] else 0.5)
                at_work.discard(lane)
                return advance(beats)

            ensemble.advance = advances
            return ensemble

    asked = study(tmp_path, orifices="[24]", replicates=2)
    carry_out(asked, tmp_path / "before", backend=Slow(), workers=1)  # so that no lane has yet to prepare
    quick.clear()
    monkeypatch.setattr("labbook.lab.journal.write_bytes", no_room)
    with pytest.raises(DiskFull):
        carry_out(asked, tmp_path / "lab", backend=Slow(), workers=2, checkpoint_every=0)
    assert not at_work


def no_room(path, *_, **__):
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))


@pytest.mark.parametrize(("now", "last", "idle"), [(0.15, 0.0, -0.05), (0.5, 0.1, 0.3), (0.5, 0.4, 0.1)])
def test_a_run_waits_for_grains_only_after_its_last_part_has_vanished(now, last, idle):
    """Else a lid that opens later than `stop.stall` would count as a clog."""
    job = SimpleNamespace(status=SimpleNamespace(time=now), _last_crossing=last, _removal_times=[0.1, 0.2])
    waits = vars(DischargeJob)["_idle_time"].fget(job)
    assert waits == pytest.approx(idle)
