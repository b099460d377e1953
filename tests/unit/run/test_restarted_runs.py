"""Runs whose arches are broken: they go on after stops, count each, and have the same bits when they were cut short."""

from dataclasses import replace

import numpy as np
import pytest
from labbook_toy import Backend
from toy_lab import arrays, carry_out, labbook, study_file
from toy_records import outcomes, records

from labbook.backend import Unsupported
from labbook.lab import Catalogue, LabFolder
from labbook.lab.identity import scene_key
from labbook.lab.runs import open_run
from labbook.measure.clogging import transient
from labbook.results.clogging import clogging
from labbook.results.find import find
from labbook.run.runner import Runner
from labbook.stats.rates import PooledRate
from labbook.study import load

FED, BREAK = "feed: {kind: reinject}", "restart: {kind: break}"
Q = 1 / 25


def restarted(folder, *more, **changes):
    """A study of the toy whose outlets stop with the probability Q after each grain."""
    path = study_file(folder, FED, BREAK, *more, **{"count": 120, "orifices": "[12]", "replicates": 1, **changes})
    text = path.read_text().replace("steps_per_beat: 200", "steps_per_beat: 2000")
    path.write_text(text.replace("[flow_rate]", "[flow_rate, clogging]"))
    return load(path)


def clogs(probability=Q):
    return Backend(clogs=lambda ratio: probability)


@pytest.mark.slow
def test_from_a_study_to_the_report_the_probability_is_that_of_the_backend(tmp_path):
    """Runs of 10 s with some twenty stops; the number is within its interval, and W is that while flowing."""
    asked = restarted(tmp_path, "stop: {max_time: 10 s}", replicates=2)
    summary = carry_out(asked, tmp_path / "lab", backend=clogs())
    assert outcomes(summary) == ["time-limit", "time-limit"]
    results = find(asked, Catalogue(tmp_path / "lab"), "toy")
    ((point,),) = [one.points for one in clogging(results)]
    q = point.probability
    assert isinstance(q, PooledRate)
    assert q.events > 15
    assert q.low < Q < q.high
    true = 0.6 * 2500 * np.sqrt(9.81) * (0.012 - 1.4 * 3e-3) ** 1.5 * 1.01 * 3e-3
    assert point.flowing is not None
    assert point.flowing.value == pytest.approx(true, rel=0.1)
    assert point.result.flow_rate is not None
    assert point.result.flow_rate.value == pytest.approx(true, rel=0.1), "time at rest is left out"
    assert point.consecutive.low < 0 < point.consecutive.high
    for record in records(tmp_path / "lab").values():
        waits = np.array([time - stopped for stopped, time in record.coverage.restarts])
        assert (waits > 0.34).all(), "20 sqrt(d/g) and at most a beat more"
        assert (waits < 0.34 + 2 * 0.02).all()
        table = open_run(LabFolder(tmp_path / "lab").run(record.run_key))[1].tables
        stopped = table["restart"]["stopped"]
        assert np.isin(stopped, table["crossing"]["time"]).all()
        first = table["crossing"]["time"].searchsorted(stopped, "right")
        sizes = np.diff([0, *first])
        assert (sizes >= 1).all()
        assert q.exposure > transient(asked.points[0].scene)


@pytest.mark.slow
def test_cut_short_and_gone_on_it_has_the_bits_of_one_in_one_go(tmp_path):
    """By a run that was extended, whose state is that at its end, and by its work folder."""
    short, long = (restarted(tmp_path, f"stop: {{max_time: {time} s}}") for time in (3, 6))
    carry_out(short, tmp_path / "lab", backend=clogs())
    extended = carry_out(long, tmp_path / "lab", backend=clogs())
    assert extended.tally.resumed == 1
    carry_out(long, tmp_path / "alone", backend=clogs())
    (record,) = records(tmp_path / "alone").values()
    assert len(record.coverage.restarts) > 3
    (other,) = records(tmp_path / "lab").values()
    assert other.coverage.restarts == record.coverage.restarts
    folders = [LabFolder(tmp_path / lab).run(record.run_key) for lab in ("lab", "alone")]
    assert arrays(folders[0]) == arrays(folders[1])


def test_restart_is_in_the_key_only_where_it_is_stated(tmp_path):
    plain, fed = (load(study_file(tmp_path, *lines, orifices="[12]")) for lines in ((), (FED,)))
    keys = [scene_key(one.points[0].scene) for one in (plain, fed, restarted(tmp_path))]
    waits = restarted(tmp_path).change({"restart.wait": "0.4 s"}).points[0].scene
    assert len({*keys, scene_key(waits)}) == 4
    assert "restart" not in fed.points[0].scene.model_dump(mode="json")


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ((BREAK,), "state feed: {kind: reinject}"),
        ((FED, "restart: {kind: break, wait: 3 s}"), "before an arch is broken"),
        ((FED, "restart: {kind: shake}"), "break"),
    ],
)
def test_restarts_that_cannot_be_are_refused(tmp_path, lines, message):
    path = study_file(tmp_path, *lines)
    assert message in labbook("plan", path, "--lab", tmp_path / "lab", check=False).output.replace("\n", " ")


def test_a_backend_that_cannot_set_velocities_is_refused(tmp_path):
    backend = clogs()
    backend.capabilities = replace(backend.capabilities, breaks=False)
    with pytest.raises(Unsupported, match="cannot break arches"):
        Runner(restarted(tmp_path), LabFolder(tmp_path / "lab"), backend).run()


def test_a_still_outlet_ends_a_run_early_where_that_is_stated(tmp_path):
    """Grains of the toy do not move; a run that ended so covers no study that waits for the stall."""
    early = load(study_file(tmp_path, "window: {start: 0.15, end: 0.6}", "stop: {still: true}", orifices="[12]"))
    early = early.change({"replicates": 1, "numerics.steps_per_beat": 2000})
    patient = early.change({"stop": {"stall": "1.5 s"}})
    assert outcomes(carry_out(early, tmp_path / "lab", backend=clogs())) == ["clogged"]
    (record,) = records(tmp_path / "lab").values()
    assert 0.34 < record.coverage.waiting < 0.34 + 2 * 0.02
    assert not carry_out(early, tmp_path / "lab", backend=clogs()).tally.ran
    assert carry_out(patient, tmp_path / "lab", backend=clogs()).tally.resumed == 1
    (record,) = records(tmp_path / "lab").values()
    assert record.coverage.waiting >= 1.5
    assert not carry_out(early, tmp_path / "lab", backend=clogs()).tally.ran, "a longer wait covers a shorter one"


def test_still_beside_a_restart_is_refused(tmp_path):
    path = study_file(tmp_path, FED, BREAK, "stop: {still: true}")
    assert "before its arch is broken" in labbook("plan", path, "--lab", tmp_path / "lab", check=False).output
