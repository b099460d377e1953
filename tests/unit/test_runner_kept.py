"""What is kept of runs, and how many there are."""

import numpy as np
import pytest
from toy_lab import arrays, carry_out, study, unsealed
from toy_records import outcomes, records
from toy_results import analyse

from labbook.lab import Catalogue
from labbook.run.coverage import finished
from labbook.run.discharge import frame_rows


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


def test_recorded_runs_keep_frames_and_others_do_not(tmp_path):
    asked = study(tmp_path, "record: {every: 2 ms, replicates: 1}")
    carry_out(asked, tmp_path / "lab")
    for run in finished(Catalogue(tmp_path / "lab"), asked, "toy"):
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
    (run, _) = finished(Catalogue(tmp_path / "lab"), every("stop: {max_time: 0.5 s}"), "toy")
    frames = run.recording()
    assert frames is not None
    assert np.allclose(np.diff(np.unique(frames["time"])), 4e-3)
    asked = every("stop: {max_time: 1.2 s}")
    carry_out(asked, tmp_path / "lab")
    (run, _) = finished(Catalogue(tmp_path / "lab"), asked, "toy")
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
    assert len(finished(Catalogue(tmp_path / "lab"), asked, "toy")) == point.decision.pooled.n


def test_a_run_that_diverged_is_no_replicate_whose_flow_rate_counts(tmp_path):
    lab, rule = tmp_path / "lab", "accuracy: {flow_rate: 70 %, max_replicates: 6}"
    asked = study(tmp_path, rule, replicates=2, orifices="[24]")
    assert len(carry_out(asked, lab).tally.ran) == 3, "as few as the rule looks at"
    file = lab / "runs" / records(lab)["orifice 24 mm", 2].run_key / "run.json"
    file.write_text(unsealed(file.read_text()).replace('"outcome": "finished"', '"outcome": "diverged"'))
    summary = carry_out(asked, lab)
    assert len(summary.tally.ran) == 1, "in its place"
    (point,) = summary.points
    assert point.decision is not None
    assert point.decision.pooled is not None
    (found,) = analyse(asked, finished(Catalogue(lab), asked, "toy")).points
    assert found.outcomes == {"finished": 3, "diverged": 1}
    assert found.flow_rate == point.decision.pooled, "the rule and the report pool the same runs"
    assert found.flow_rate is not None
    assert found.flow_rate.n == 3


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
