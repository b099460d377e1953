"""How runs end, what is kept of them, and what a longer or wider demand does with them."""

import time
from dataclasses import replace

import numpy as np
import pytest
from labbook_toy import Backend, Ensemble
from toy_lab import arrays, carry_out, study, study_file

from labbook.backend import Overflow, Spec
from labbook.catalogue import Catalogue, Lab, RunRecord
from labbook.catalogue.index import Index
from labbook.catalogue.packings import load_packing
from labbook.catalogue.record import Observe
from labbook.catalogue.tables import read_checkpoint
from labbook.cli.run import report
from labbook.plan.plan import Planner
from labbook.report.analysis import analyse
from labbook.runner.board import Board
from labbook.runner.filling import FillJob
from labbook.runner.job import Bench
from labbook.runner.progress import counts
from labbook.runner.recording import frame_rows
from labbook.runner.watch import View
from labbook.study import load


def records(lab) -> dict[tuple[str, int], RunRecord]:
    found = [RunRecord.read(folder) for folder in (lab / "runs").iterdir()]
    return {(record.label, record.seed): record for record in found}


def outcomes(summary) -> list[str]:
    return sorted(summary.tally.ran.values())


def test_a_study_is_carried_out_once(tmp_path):
    asked = study(tmp_path)
    first = carry_out(asked, tmp_path / "lab")
    assert outcomes(first) == ["finished"] * 4
    assert first.tally.packings == 2, "flat bottoms share one packing a seed"
    again = carry_out(asked, tmp_path / "lab")
    assert not again.tally.ran
    assert not again.tally.packings
    assert again.work_done == 0
    assert not list((tmp_path / "lab/work").iterdir())


def test_a_run_knows_how_it_came_about(tmp_path):
    asked = study(tmp_path)
    carry_out(asked, tmp_path / "lab")
    record = records(tmp_path / "lab")["orifice 24 mm", 2]
    assert record.study == "toy-study"
    assert record.at == {"container.orifice": 0.024}
    assert record.scene == asked.points[1].scene
    assert record.coverage.discharged >= asked.window.end
    assert record.physics["restitution_asked"] == 0.2
    told = record.provenance
    assert told["seed"] == 2
    assert told["precision"] == "double"
    assert {"commit", "dirty", "packages", "processor", "threads", "machine", "wall_time"} <= told.keys()
    assert told["packages"]["numpy"] == np.__version__
    assert told["grain_steps_per_second"] > 0
    (session,) = record.sessions
    assert (session.from_step, session.to_step) == (0, record.coverage.steps)
    left = record.coverage.crossed
    mean = (2 * record.coverage.grains - left) / 2
    assert session.grain_steps == pytest.approx(record.coverage.steps * mean, rel=0.02)


def test_finished_runs_give_their_data(tmp_path):
    asked = study(tmp_path)
    carry_out(asked, tmp_path / "lab")
    finished = Catalogue(tmp_path / "lab").finished(asked, "toy")
    assert [(run.point.index, run.seed) for run in finished] == [(0, 1), (0, 2), (1, 1), (1, 2)]
    for run in finished:
        data = run.data()
        crossing = data.tables["crossing"]
        assert len(crossing["id"]) == run.record.coverage.crossed == len(np.unique(crossing["id"]))
        assert np.all(np.diff(crossing["time"]) > 0)
        assert crossing["time"][-1] == run.record.coverage.last_crossing <= data.duration
        assert len(data.start) == 200
        assert "member" not in crossing


def test_an_outlet_that_clogs_leaves_a_censored_waiting_time(tmp_path):
    asked = study(tmp_path, "stop: {stall: 0.5 s}", orifices="[8, 24]", replicates=1)
    carry_out(asked, tmp_path / "lab")
    found = records(tmp_path / "lab")
    assert found["orifice 24 mm", 1].outcome == "finished"
    clogged = found["orifice 8 mm", 1]
    assert clogged.outcome == "clogged"
    assert clogged.coverage.waiting >= 0.5
    assert clogged.coverage.crossed == 200 // 3


def test_a_run_out_of_time_is_interrupted_and_goes_on_when_more_is_asked(tmp_path):
    short = study(tmp_path, "stop: {max_time: 20 ms}", replicates=1)
    carry_out(short, tmp_path / "lab")
    assert {record.outcome for record in records(tmp_path / "lab").values()} == {"interrupted"}
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
    summary = carry_out(asked, tmp_path / "lab", engine=Backend(fails=18))
    assert outcomes(summary) == ["diverged", "finished"]
    failed = records(tmp_path / "lab")["orifice 18 mm", 1]
    assert failed.failure is not None
    assert failed.failure.guard == "overlap"
    assert 0 <= failed.failure.grain < 200
    assert failed.coverage.steps <= failed.failure.step < failed.coverage.steps + 100, "the last good beat is kept"
    kept = read_checkpoint(Lab(tmp_path / "lab").run(failed.run_key) / "checkpoint.npz")
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


def test_recorded_runs_keep_frames_and_others_do_not(tmp_path):
    asked = study(tmp_path, "record: {every: 2 ms, replicates: 1}")
    carry_out(asked, tmp_path / "lab")
    for run in Catalogue(tmp_path / "lab").finished(asked, "toy"):
        frames = run.recording()
        assert "sample" not in run.data().tables
        if run.seed > 1:
            assert frames is None
            continue
        assert frames is not None
        assert frames["x"].dtype == np.float32
        times = np.unique(frames["time"])
        assert len(times) <= 200
        assert np.allclose(np.diff(times), 2e-3 * round(np.diff(times)[0] / 2e-3))


def test_long_recordings_are_thinned_evenly_also_when_continued(tmp_path):
    def every(*more):
        return study(
            tmp_path, "record: {every: 2 ms, replicates: 1}", *more, replicates=1, orifices="[10, 24]", count=400
        )

    carry_out(every("stop: {max_time: 0.5 s}"), tmp_path / "lab")
    (run, _) = Catalogue(tmp_path / "lab").finished(every("stop: {max_time: 0.5 s}"), "toy")
    frames = run.recording()
    assert frames is not None
    assert np.allclose(np.diff(np.unique(frames["time"])), 4e-3)
    asked = every("stop: {max_time: 1.2 s}")
    carry_out(asked, tmp_path / "lab")
    (run, _) = Catalogue(tmp_path / "lab").finished(asked, "toy")
    frames = run.recording()
    assert frames is not None
    assert np.allclose(np.diff(np.unique(frames["time"])), 8e-3)
    carry_out(asked, tmp_path / "whole")
    assert arrays(run.folder) == arrays(tmp_path / "whole/runs" / run.run_key)


def test_a_missing_observable_is_run_again_and_nothing_is_lost(tmp_path):
    carry_out(study(tmp_path, replicates=1), tmp_path / "lab")
    before = {key: record.run_key for key, record in records(tmp_path / "lab").items()}
    summary = carry_out(study(tmp_path, "record: {every: 4 ms, replicates: 1}", replicates=1), tmp_path / "lab")
    assert set(summary.tally.ran) == set(before.values()), "probes are coverage: the keys stay"
    assert summary.tally.resumed == 0
    assert not carry_out(study(tmp_path, replicates=1), tmp_path / "lab").tally.ran


def test_replicates_are_added_until_the_flow_rate_is_precise_enough(tmp_path):
    asked = study(tmp_path, "accuracy: {flow_rate: 2 %, max_replicates: 30}", replicates=2, orifices="[24]", count=400)
    summary = carry_out(asked, tmp_path / "lab")
    (point,) = summary.points
    assert point.decision is not None
    assert point.decision.ended == "tolerance"
    assert point.decision.pooled is not None
    assert point.decision.pooled.relative <= 0.02
    assert 3 < point.decision.pooled.n <= 30
    assert len(Catalogue(tmp_path / "lab").finished(asked, "toy")) == point.decision.pooled.n


def test_a_cap_on_replicates_is_kept_and_reported(tmp_path):
    asked = study(tmp_path, "accuracy: {flow_rate: 0.01 %, max_replicates: 4}", replicates=2, orifices="[24]")
    (point,) = carry_out(asked, tmp_path / "lab").points
    assert point.decision is not None
    assert point.decision.ended == "cap"
    assert len(point.items) == 4


def test_lanes_do_not_change_a_bit(tmp_path):
    asked = study(tmp_path, "record: {every: 4 ms, replicates: 1}")
    for lanes in (1, 3):
        carry_out(asked, tmp_path / str(lanes), lanes=lanes, checkpoint_every=0.03 if lanes == 1 else 1e9)
    for folder in ("runs", "packings"):
        keys = sorted(path.name for path in (tmp_path / "1" / folder).iterdir())
        assert keys == sorted(path.name for path in (tmp_path / "3" / folder).iterdir())
        for key in keys:
            assert arrays(tmp_path / "1" / folder / key) == arrays(tmp_path / "3" / folder / key)


def test_a_job_that_needs_another_spec_is_begun_once_to_learn_that(tmp_path, monkeypatch):
    begun = []
    begin = FillJob.begin
    monkeypatch.setattr(FillJob, "begin", lambda job: begun.append(job.key) or begin(job))
    asked, engine, lab = study(tmp_path), Backend(), Lab(tmp_path / "lab")
    catalogue, index = Catalogue(lab), Index(lab)
    try:
        planner = Planner(asked, catalogue, engine.capabilities)
        board = Board(Bench(lab, engine, "cpu"), planner, index, Observe(measure=asked.measure, start=0, end=1))
        board.pin(planner.plan())
        other = Spec(engine="toy", features=(), steps_per_beat=7)
        assert [board.next(other) for _ in range(5)] == [None] * 5
        assert len(begun) == len(set(begun)) == 2, "two packings"
        started = board.next()
        assert started is not None
        assert started.spec != other
        board.dropped(started.job)
    finally:
        catalogue.close()
        index.close()


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

    summary = carry_out(study(tmp_path), tmp_path / "lab", engine=Small())
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
    assert report(summary)[0].startswith("2 of 2 runs done"), "a shared run counts once"
    assert [(run.point.index, run.seed) for run in Catalogue(lab).finished(asked, "toy")] == [
        (0, 1),
        (0, 2),
        (1, 1),
        (1, 2),
    ]


def test_a_shared_run_that_diverged_is_not_handed_to_and_fro(tmp_path):
    summary = carry_out(twins(tmp_path, replicates=1), tmp_path / "lab", engine=Backend(fails=24))
    assert outcomes(summary) == ["diverged"]


def test_progress_tells_runs_from_packings(tmp_path):
    seen = []

    class Watch:
        def show(self, view: View) -> None:
            made = [len(list((tmp_path / "lab" / name).glob("*"))) for name in ("packings", "runs")]
            seen.append((view.fillings_left, view.runs_done, *made))

    carry_out(study(tmp_path), tmp_path / "lab", engine=Backend(delay=0.1), watcher=Watch(), lanes=1)
    assert len({left for left, *_ in seen}) > 1, "it was looked at while packings were being made, and later"
    for left, done, packings, runs in seen:
        assert (left, done) == (2 - packings, runs)


def test_progress_in_words():
    view = View(0, 12, 2, going=(), elsewhere=0, work_done=0.0, work_left=1.0, rate=0.0)
    assert counts(view) == "0/12 runs, 2 packings first"
    assert counts(replace(view, fillings_left=1)) == "0/12 runs, 1 packing first"
    assert counts(replace(view, runs_done=3, fillings_left=0)) == "3/12 runs"


def test_a_run_that_no_grain_left_has_seen_none_and_says_so(tmp_path):
    asked, lab = study(tmp_path, "stop: {max_time: 4 ms}", orifices="[12]", replicates=1), tmp_path / "lab"
    carry_out(asked, lab)
    (run,) = Catalogue(lab).finished(asked, "toy")
    assert run.record.coverage.crossed == 0
    assert len(run.data().tables["crossing"]["time"]) == 0
    (point,) = analyse(asked, [run]).points
    rate = point.runs[0].measured["flow_rate"]
    assert np.isnan(rate.value)
    assert "too few grains: 0 of 200 left" in rate.note
    longer = study(tmp_path, orifices="[12]", replicates=1)
    assert carry_out(longer, lab).tally.resumed == 1
    (run,) = Catalogue(lab).finished(longer, "toy")
    assert len(run.data().tables["crossing"]["time"]) == run.record.coverage.crossed > 0


class Compiling(Backend):
    """Compiles at the first beat of a Spec, which must not happen twice at once."""

    def __init__(self):
        super().__init__()
        self.compiled, self.compiling, self.clashes = set(), 0, 0

    def open(self, spec, slots=None, device="cpu"):
        return CompilingEnsemble(self, spec, slots)


class CompilingEnsemble(Ensemble):
    def advance(self, beats=1):
        engine = self._backend
        if self._spec not in engine.compiled:
            engine.clashes += engine.compiling > 0
            engine.compiling += 1
            time.sleep(0.1)
            engine.compiling -= 1
            engine.compiled.add(self._spec)
        return super().advance(beats)


def test_lanes_leave_compiling_at_the_first_beat_to_one_of_them(tmp_path):
    engine = Compiling()
    # a number of steps that no other test has: what was used before in this process is known
    asked = study_file(tmp_path, replicates=4)
    asked.write_text(asked.read_text().replace("steps_per_beat: 200", "steps_per_beat: 187"))
    summary = carry_out(load(asked), tmp_path / "lab", engine=engine, lanes=4)
    assert outcomes(summary) == ["finished"] * 8
    assert len(engine.compiled) == 2
    assert engine.clashes == 0


def test_frames_are_kept_in_single_precision_but_for_their_names_and_times():
    rows = {"step": np.array([7], np.int64), "time": np.array([0.1]), "i": np.array([3]), "j": np.array([-1])}
    kept = frame_rows({**rows, "wall": np.array([2]), "fx": np.array([1 / 3]), "id": np.array([9])})
    assert {name: column.dtype for name, column in kept.items()} == {
        "step": np.int64,
        "time": np.float64,
        "i": np.int32,
        "j": np.int32,
        "wall": np.int16,
        "fx": np.float32,
        "id": np.int32,
    }
    assert abs(kept["fx"][0] - 1 / 3) < 1e-7 / 3
    assert kept["time"][0] == 0.1
