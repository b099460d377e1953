"""What is kept of runs, and how many there are."""

import numpy as np
import pytest
from toy_lab import arrays, carry_out, study, unsealed
from toy_records import outcomes, records
from toy_results import analyse

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Sample, describe_probe
from labbook.lab import Catalogue, RunRecord
from labbook.measure.trajectories import Trajectories
from labbook.plan.coverage import finished
from labbook.plan.demand import Conflict
from labbook.run.discharge import parse_film
from labbook.run.frame_rows import frame_rows
from labbook.run.job import Job


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
    runs = finished(Catalogue(tmp_path / "lab"), asked, "toy")
    assert [(run.point.index, run.seed) for run in runs] == [(0, 1), (0, 2), (1, 1), (1, 2)]
    for run in runs:
        data = run.data()
        crossing = data.tables["crossing"]
        assert len(crossing["id"]) == run.record.coverage.crossed == len(np.unique(crossing["id"]))
        assert np.all(np.diff(crossing["time"]) > 0)
        assert crossing["time"][-1] == run.record.coverage.last_crossing <= data.duration
        assert len(data.start) == 200
        assert "member" not in crossing


@pytest.mark.parametrize("every", [2.0, 0.7, 0.125, 5.3])
def test_recorded_runs_have_the_frames_that_were_asked_and_others_none(tmp_path, every):
    """Beats last 2 ms, of steps of 10 us."""
    asked = study(tmp_path, f"record: {{every: {every} ms, replicates: 1}}", count=100)
    carry_out(asked, tmp_path / "lab")
    carry_out(study(tmp_path, count=100), tmp_path / "unrecorded")
    for run in finished(Catalogue(tmp_path / "lab"), asked, "toy"):
        frames, data = run.recording(), run.data()
        assert "sample" not in data.tables
        assert "film" not in data.tables
        assert (frames is None) == (run.seed > 1)
        if frames is not None:
            assert frames["x"].dtype == np.float32
            steps = np.unique(frames["step"])
            wanted = np.arange(len(steps)) * every / 0.01
            assert np.abs(steps - wanted).max() <= 0.5
            assert wanted[-1] + every / 0.01 > run.record.coverage.steps - 0.5, "to the end"
            trajectories = Trajectories.of(data)
            assert trajectories is not None
            assert trajectories.time[0] == 0
            assert data.start.ids is not None
            assert np.array_equal(trajectories.x[0], data.start.x[np.argsort(data.start.ids)].astype(np.float32))
            assert run.record.coverage.frame_interval == pytest.approx(every * 1e-3)
        other = tmp_path / "unrecorded/runs" / run.entry.run_key
        recorded = {name: array for name, array in arrays(run.folder).items() if "recording" not in name}
        assert recorded == {name: array for name, array in arrays(other).items() if "recording" not in name}


def test_long_recordings_are_whole_also_when_continued(tmp_path):
    def every(*more):
        return study(
            tmp_path, "record: {every: 1.9 ms, replicates: 1}", *more, replicates=1, orifices="[10, 24]", count=400
        )

    carry_out(every("stop: {max_time: 0.5 s}"), tmp_path / "lab")
    asked = every("stop: {max_time: 1.2 s}")
    assert carry_out(asked, tmp_path / "lab").tally.resumed
    (run, _) = finished(Catalogue(tmp_path / "lab"), asked, "toy")
    frames = run.recording()
    assert frames is not None
    assert list(np.unique(frames["step"])) == list(range(0, 120_001, 190))
    carry_out(asked, tmp_path / "whole")
    assert arrays(run.folder) == arrays(tmp_path / "whole/runs" / run.entry.run_key)


def test_many_frames_do_not_wait_in_memory_for_the_next_save(tmp_path, monkeypatch):
    monkeypatch.setattr("labbook.run.execution._MOST_UNSAVED", 3 * 10**5)
    unsaved, write = [], Job._write
    monkeypatch.setattr(Job, "_write", lambda job, checkpoint: (unsaved.append(job.unsaved), write(job, checkpoint)))
    asked = study(tmp_path, "record: {every: 0.1 ms, replicates: 1}", replicates=1, orifices="[24]", count=100)
    carry_out(asked, tmp_path / "lab", checkpoint_every=1e9)
    one_beat = 20 * 100 * 44 * 2  # frames, grains, bytes of a row; twice that
    assert len(unsaved) > 1
    assert 3 * 10**5 <= max(unsaved) < 3 * 10**5 + one_beat
    carry_out(asked, tmp_path / "other")
    (run,) = (tmp_path / "lab/runs").iterdir()
    assert arrays(run) == arrays(tmp_path / "other/runs" / run.name)


@pytest.mark.parametrize("every", ["0.7 ms", "2 ms", "5.3 ms"])
def test_a_resumed_run_has_the_frames_of_an_uninterrupted_one(tmp_path, monkeypatch, every):
    """It is killed right after a save, twice; beats last 2 ms."""
    asked = study(tmp_path, f"record: {{every: {every}, replicates: 1}}", replicates=1, orifices="[24]", count=100)
    write, lab = Job._write, tmp_path / "lab"

    class Killed(BaseException):
        pass

    for _ in range(2):
        saves = iter((False, False, True))

        def save(job, checkpoint, saves=saves):
            write(job, checkpoint)
            if job.kind == "run" and next(saves):
                raise Killed

        monkeypatch.setattr(Job, "_write", save)
        with pytest.raises(Killed):
            carry_out(asked, lab, checkpoint_every=0.0)
    monkeypatch.setattr(Job, "_write", write)
    assert carry_out(asked, lab).tally.resumed == 1
    carry_out(asked, tmp_path / "whole")
    (run,) = (lab / "runs").iterdir()
    assert len(RunRecord.read(run).sessions) == 3
    assert arrays(run) == arrays(tmp_path / "whole/runs" / run.name)


def test_a_recording_that_is_too_coarse_is_made_again_and_nothing_else_changes(tmp_path):
    def every(time):
        return study(tmp_path, f"record: {{every: {time}, replicates: 1}}", replicates=1, orifices="[24]", count=100)

    lab = tmp_path / "lab"
    carry_out(every("20 ms"), lab)
    (before,) = (lab / "runs").iterdir()
    kept = arrays(before)
    for closer, steps in (("1 ms", 100), ("19 ms", 100), ("4 ms", 100), ("0.3 ms", 30)):
        summary = carry_out(every(closer), lab)
        assert bool(summary.tally.ran) == (closer in ("1 ms", "0.3 ms"))
        assert not summary.tally.packings
        (run,) = finished(Catalogue(lab), every(closer), "toy")
        frames = run.recording()
        assert frames is not None
        assert run.folder == before, "the time between frames is part of no key"
        assert set(np.diff(np.unique(frames["step"]))) == {steps}
    after = arrays(before)
    assert {name: array for name, array in after.items() if "recording" not in name} == {
        name: array for name, array in kept.items() if "recording" not in name
    }


def test_frames_that_steps_cannot_give_are_refused(tmp_path):
    with pytest.raises(
        Conflict, match=r"toy.yaml: record.every: .*25 us is 2.5 steps of 10 us(.|\n)*use 0.1 ms or more"
    ):
        carry_out(study(tmp_path, "record: {every: 25 us}"), tmp_path / "lab")


def test_an_older_unfinished_recording_goes_on_in_its_beats():
    """Its state names a probe that counted beats."""
    older = describe_probe(Sample(fields=("x", "v", "q"), every=3))
    numerics = Numerics(dt=1e-5, steps_per_beat=200)
    film = parse_film(older, numerics)
    assert film is not None
    assert film.fields == ("x", "v", "q")
    assert list(film.steps(1e-5, 1, 2000)) == [600, 1200, 1800]
    assert parse_film(describe_probe(film), numerics) == film
    assert parse_film(None, numerics) is None


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
    assert 5 <= point.decision.pooled.n <= 30
    assert len(finished(Catalogue(tmp_path / "lab"), asked, "toy")) == point.decision.pooled.n


def test_a_run_that_diverged_is_no_replicate_whose_flow_rate_counts(tmp_path):
    lab, rule = tmp_path / "lab", "accuracy: {flow_rate: 70 %, max_replicates: 8}"
    asked = study(tmp_path, rule, replicates=2, orifices="[24]")
    assert len(carry_out(asked, lab).tally.ran) == 5, "as few as the rule looks at"
    file = lab / "runs" / records(lab)["orifice 24 mm", 2].run_key / "run.json"
    file.write_text(unsealed(file.read_text()).replace('"outcome": "finished"', '"outcome": "diverged"'))
    summary = carry_out(asked, lab)
    assert len(summary.tally.ran) == 1, "in its place"
    (point,) = summary.points
    assert point.decision is not None
    assert point.decision.pooled is not None
    (found,) = analyse(asked, finished(Catalogue(lab), asked, "toy")).points
    assert found.outcomes == {"finished": 5, "diverged": 1}
    assert found.flow_rate == point.decision.pooled, "the rule and the report pool the same runs"
    assert found.flow_rate is not None
    assert found.flow_rate.n == 5


def test_a_point_whose_runs_have_no_flow_rate_is_given_up(tmp_path):
    """Of 100 grains too few leave in the window for a rate."""
    asked = study(tmp_path, "accuracy: {flow_rate: 5 %, max_replicates: 40}", orifices="[24]", count=100)
    summary = carry_out(asked, tmp_path / "lab")
    assert len(summary.tally.ran) == 6
    assert "orifice 24 mm: none of 6 runs has a flow rate, so no more are made" in repr(summary)


def test_a_cap_on_replicates_is_kept_and_reported(tmp_path):
    asked = study(tmp_path, "accuracy: {flow_rate: 0.01 %, max_replicates: 4}", replicates=2, orifices="[24]")
    (point,) = carry_out(asked, tmp_path / "lab").points
    assert point.decision is not None
    assert point.decision.ended == "cap"
    assert len(point.items) == 4


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
