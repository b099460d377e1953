"""What a plan says of a study: done, missing, partial, stale, why, and what is ahead."""

import json
import time

import numpy as np
import pytest
from labbook_toy import Backend
from toy_lab import carry_out, start, study, study_file
from typer.testing import CliRunner

from labbook.backend import Unsupported
from labbook.cli import build
from labbook.lab import Catalogue
from labbook.lab.provenance import provenance
from labbook.lab.records import Coverage, StopRule
from labbook.plan.coverage import finished, shortfall
from labbook.plan.demand import demands
from labbook.plan.forecast import DEFAULT_SPEED, discharge_time, forecast
from labbook.plan.plan import Planner

BACKEND = Backend().capabilities
STOP = StopRule(discharged=0.6, max_time=10.0, stall=1.0)
CROSSING = '{"kind":"crossing","plane":0.0}'


def plan(asked, lab, backend=BACKEND):
    return Planner(asked, Catalogue(lab), backend).plan()


def coverage(**changes) -> Coverage:
    had = {"duration": 2.0, "steps": 1000, "grains": 100, "crossed": 60, "last_crossing": 1.99, "stop": STOP}
    return Coverage.model_validate({**had, "guards": {"speed_limit": 100.0}, "probes": (CROSSING,), **changes})


@pytest.mark.parametrize(
    ("outcome", "had", "asked", "lacks"),
    [
        ("finished", {}, {}, ""),
        ("finished", {}, {"discharged": 0.61}, "finished after 2 s"),
        ("finished", {}, {"discharged": 0.4}, ""),
        ("emptied", {"crossed": 99}, {"discharged": 1.0}, ""),
        ("time-limit", {"crossed": 10}, {}, "out of time after 2 s"),
        ("time-limit", {"crossed": 10, "duration": 10.0, "last_crossing": 9.9}, {}, ""),
        (
            "time-limit",
            {"crossed": 10, "duration": 10.0, "last_crossing": 9.9},
            {"max_time": 11.0},
            "out of time after 10 s",
        ),
        ("clogged", {"crossed": 10, "last_crossing": 1.0}, {}, ""),
        ("clogged", {"crossed": 10, "last_crossing": 1.0}, {"stall": 1.5}, "clogged after 2 s"),
        ("diverged", {"crossed": 10}, {}, ""),
        ("diverged", {"crossed": 10, "guards": {"speed_limit": 10.0}}, {}, "diverged with another speed_limit"),
        ("finished", {"probes": ()}, {}, "not observed"),
        ("finished", {"crossed": 50, "bed_height": 0.2}, {"fill_height": 0.1}, ""),
        ("finished", {"crossed": 50, "bed_height": 0.2}, {"fill_height": 0.09}, "finished after 2 s"),
        ("finished", {"crossed": 50}, {"fill_height": 0.1}, "finished after 2 s"),
    ],
)
def test_demand_minus_coverage(outcome, had, asked, lacks):
    stop = STOP.model_copy(update=asked)
    found = shortfall(outcome, coverage(**had), stop, {"speed_limit": 100.0}, frozenset({CROSSING}))
    assert found.startswith(lacks)
    assert bool(found) == bool(lacks)


@pytest.mark.parametrize(
    ("outcome", "had", "usual", "lacks"),
    [
        ("clogged", {"crossed": 10, "last_crossing": 0.0}, {"stall": 2.5}, ""),
        ("clogged", {"crossed": 10, "last_crossing": 0.0}, {"stall": 5.0}, "clogged after 2 s"),
        ("time-limit", {"crossed": 10}, {"max_time": 3.0}, ""),
        ("time-limit", {"crossed": 10}, {"max_time": 5.0}, "out of time after 2 s"),
        ("diverged", {"crossed": 10}, {"speed_limit": 150.0}, ""),
        ("diverged", {"crossed": 10}, {"speed_limit": 60.0}, ""),
        ("diverged", {"crossed": 10}, {"speed_limit": 3000.0}, "diverged with another speed_limit"),
        ("finished", {"recording": 0.01}, {"recording": 0.008}, ""),
        ("finished", {"recording": 0.01}, {"recording": 0.004}, "has frames every 10 ms"),
    ],
)
def test_what_a_study_leaves_out_need_be_met_within_a_factor_of_two(outcome, had, usual, lacks):
    """Runs of older versions, which had other defaults, are not run again; but where a default says otherwise by more
    than that, as in low gravity, they are."""
    times = {"stall": 9.0, "max_time": 90.0, **usual}
    guards, recording = {"speed_limit": times.pop("speed_limit", 100.0)}, times.pop("recording", None)
    stop, unstated = STOP.model_copy(update=times), frozenset({"stall", "max_time", "recording", "speed_limit"})
    found = shortfall(outcome, coverage(**had), stop, guards, frozenset(), recording, unstated)
    assert found.startswith(lacks)
    assert bool(found) == bool(lacks)
    assert shortfall(outcome, coverage(**had), stop, guards, frozenset(), recording) or "speed_limit" in usual


@pytest.mark.parametrize(
    ("had", "asked", "lacks"),
    [
        (None, 0.01, "not recorded"),
        (0.01, 0.01, ""),
        (0.01, None, ""),
        (0.01, 0.02, ""),
        (0.0109, 0.01, ""),
        (0.0115, 0.005, "has frames every 11.5 ms, not every 5 ms: runs again for its recording"),
        (0.0115, 0.001, "has frames every 11.5 ms, not every 1 ms: runs again for its recording"),
        (0.0115, 0.0115, ""),
    ],
)
@pytest.mark.parametrize("every_frame", [False, True])
def test_a_finer_recording_will_do(had, asked, lacks, every_frame):
    """And one in the whole beats of older runs, where these are as asked to 10 %."""
    found = coverage(recording=had, every_frame=every_frame)
    assert shortfall("finished", found, STOP, {}, frozenset(), asked) == lacks


@pytest.mark.parametrize("duration", [0.3, 0.4, 0.401, 0.5, 1.2, 7.0])
def test_an_older_recording_has_every_second_or_fourth_frame(duration):
    """It was thinned to 200 frames, evenly from the opening on: those that were kept tell how far they are apart."""
    frames = np.arange(1, int(duration / 2e-3 * (1 + 1e-12)) + 1)
    kept, stride = frames, 1
    while kept[-1] // stride > 200:
        stride *= 2
    kept = frames[frames % stride == 0]
    assert len(kept) <= 200
    had = coverage(recording=2e-3, duration=duration)
    assert had.frame_interval == pytest.approx(2e-3 * np.diff(kept)[0])
    assert had.model_copy(update={"every_frame": True}).frame_interval == 2e-3
    assert ("every_frame" in had.model_dump_json()) is False, "nothing new is stored of it"
    lacks = shortfall("finished", had, STOP, {}, frozenset(), 2e-3)
    assert bool(lacks) == (stride > 1)


def test_first_the_first_seed_of_all_points(tmp_path):
    order = [(demand.seed, demand.point.index) for demand in demands(study(tmp_path), 2)]
    assert order == [(1, 0), (1, 1), (2, 0), (2, 1)]


def test_nothing_there_is_all_missing(tmp_path):
    made = plan(study(tmp_path), tmp_path / "lab")
    assert dict(made.counts()) == {"missing": 4}
    assert len(made.fillings) == 2
    assert not (tmp_path / "lab").exists(), "planning makes nothing"


def test_states_come_with_reasons(tmp_path):
    lab = tmp_path / "lab"
    carry_out(study(tmp_path, replicates=1), lab)
    made = plan(study(tmp_path), lab)
    assert dict(made.counts()) == {"done": 2, "missing": 2}
    assert {item.outcome for item in made.items if item.state == "done"} == {"finished"}
    longer = plan(study(tmp_path, "stop: {discharged: 90 %}", replicates=1), lab)
    assert dict(longer.counts()) == {"partial": 2}
    assert "requested: 90 %" in longer.items[0].reason
    filmed = plan(study(tmp_path, "record: {every: 4 ms}", replicates=1), lab)
    assert {(item.state, item.reason) for item in filmed.items} == {("partial", "not recorded")}
    stale = plan(study(tmp_path, replicates=1), lab, Backend(version=2).capabilities)
    assert {(item.state, item.reason) for item in stale.items} == {
        ("stale", "made by version 1 of toy, now at version 2")
    }


@pytest.mark.slow
def test_work_that_was_cut_short_is_partial(tmp_path):
    path, lab = study_file(tmp_path), tmp_path / "lab"
    process = start("run", path, "--lab", lab, "--backend", "toy", "--checkpoint-every", 0.01, delay=0.02)
    deadline = time.monotonic() + 30
    while not (list((lab / "packings").glob("*")) and list((lab / "work").glob("*/progress.json"))):
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.01)
    process.kill()
    process.communicate()
    made = plan(study(tmp_path), lab)
    assert "started, goes on from its checkpoint" in {item.reason for item in made.items}


def test_a_forecast_rests_on_recorded_speeds(tmp_path):
    asked, lab = study(tmp_path), tmp_path / "lab"
    machine = provenance("cpu")["machine"]
    ahead = forecast(plan(asked, lab), Catalogue(lab), machine, "cpu", 2)
    assert ahead.speed == pytest.approx(DEFAULT_SPEED)
    assert "assumed" in ahead.basis
    assert ahead.seconds == pytest.approx(ahead.grain_steps / DEFAULT_SPEED / 2)
    carry_out(asked, lab)
    rates = Catalogue(lab).runs().rate
    more = plan(study(tmp_path, replicates=3), lab)
    ahead = forecast(more, Catalogue(lab), machine, "cpu", 2)
    assert ahead.speed == pytest.approx(rates.median())
    assert "4 runs" in ahead.basis
    done = forecast(plan(asked, lab), Catalogue(lab), machine, "cpu", 2)
    assert (done.seconds, done.disk) == (0, 0)


def test_the_forecast_of_a_discharge_is_of_the_right_size(tmp_path):
    """The toy's flow follows the same law with nearly the same constants, so the times must be close."""
    asked, lab = study(tmp_path, replicates=1), tmp_path / "lab"
    carry_out(asked, lab)
    for run in finished(Catalogue(lab), asked, "toy"):
        demand = next(one for one in demands(asked, 1) if one.point.index == run.point.index)
        assert discharge_time(demand.shared) == pytest.approx(run.record.coverage.duration, rel=0.25)


def test_what_the_backend_lacks_is_said_before_anything_runs(tmp_path):
    asked = study_file(tmp_path)
    asked.write_text(asked.read_text().replace("numerics: {", "numerics: {precision: mixed, "))
    for verb in ("plan", "run"):
        done = CliRunner().invoke(build(), [verb, str(asked), "--lab", str(tmp_path / "lab"), "--backend", "toy"])
        assert done.exit_code == 1
        assert "numerics.precision" in done.output
    assert not list((tmp_path / "lab").glob("*/*"))
    with pytest.raises(Unsupported):
        carry_out(study(tmp_path), tmp_path / "lab", device="cuda")


def test_the_plan_in_json(tmp_path):
    carry_out(study(tmp_path, replicates=1), tmp_path / "lab")
    path = study_file(tmp_path)
    done = CliRunner().invoke(
        build(), ["plan", str(path), "--lab", str(tmp_path / "lab"), "--backend", "toy", "--json"]
    )
    assert done.exit_code == 0
    found = json.loads(done.output)
    assert found["counts"] == {"done": 2, "missing": 2}
    assert found["packings_missing"] == 1
    assert found["forecast"]["seconds"] > 0
    assert [run["seed"] for run in found["runs"]] == [1, 1, 2, 2]
    assert (
        CliRunner().invoke(build(), ["plan", str(path), "--lab", str(tmp_path / "lab"), "--backend", "toy"]).exit_code
        == 0
    )
