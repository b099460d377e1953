"""Replicates until enough runs have stopped: proposals from the study and complete generations alone."""

import numpy as np
import pytest
from labbook_toy import Backend
from toy_lab import carry_out, labbook, study_file

from labbook.campaign import Generation, History, Stops, Trial
from labbook.campaign.stops import COUNT
from labbook.lab import Catalogue
from labbook.plan.advice import foresee
from labbook.results.find import find
from labbook.stats.rates import PooledRate, events_needed
from labbook.study import load


def history(*counts):
    trials = tuple(Trial({}, seed, f"{seed:04d}", "clogged", {COUNT: n}) for seed, n in enumerate(counts, 1))
    return History(None, (Generation(0, (), "", trials),), (), 1)


def test_replicates_are_added_as_stops_come():
    strategy = Stops.of(error=0.2, cap=400)
    go = strategy.propose(history(*[1, 0, 0, 1]))
    assert [one.replicates for one in go.assignments] == [8], "few stops order no more than as many again"
    go = strategy.propose(history(*[1] * 80))
    assert [one.replicates for one in go.assignments] == [97]
    assert strategy.propose(history(*[1] * 97)).state == "end"
    assert [one.replicates for one in strategy.propose(history(0, 0)).assignments] == [4]
    never = Stops.of(error=0.2, cap=3).propose(history(0, 0, 0))
    assert never.state == "end"
    assert "upper bound" in never.reason
    several = Stops.of(error=0.2, cap=400).propose(history(*[30] * 3))
    assert [one.replicates for one in several.assignments] == [4]


def test_the_error_that_is_requested_is_reached():
    """Simulated: campaigns of runs of 300 grains at most; 97 stops leave a standard error of a tenth."""
    rng, q, strategy, errors = np.random.default_rng(2), 1 / 300, Stops.of(error=0.2, cap=1000), []
    for _ in range(200):
        sizes = rng.geometric(q, 1000)
        stopped, passed, n = sizes <= 300, np.minimum(sizes, 300), 8
        while (proposal := strategy.propose(history(*stopped[:n].astype(float)))).state == "go":
            n = proposal.assignments[0].replicates
        errors.append(stopped[:n].sum() / passed[:n].sum() / q - 1)
    assert np.std(errors) < 0.11
    assert abs(np.mean(errors)) < 0.03
    assert np.mean(np.abs(errors) < 0.2) > 0.92


@pytest.mark.slow
def test_a_study_adds_runs_until_its_stops_are_counted(tmp_path):
    """On the toy, whose grains stop with a probability of 1 in 30; the plan counts them, and a second run adds none."""
    lines = ("window: {start: 0.15, end: 0.6}", "stop: {stall: 0.5 s}", "accuracy: {clogging: 50 %}")
    path = study_file(tmp_path, *lines, count=120, orifices="[12]", replicates=6)
    path.write_text(
        path.read_text().replace("[flow_rate]", "[clogging]").replace("steps_per_beat: 200", "steps_per_beat: 2000")
    )
    asked = load(path)
    backend, lab = Backend(clogs=lambda ratio: 1 / 30), tmp_path / "lab"
    before = foresee(asked, Catalogue(lab), backend, "cpu").lines()
    assert any("Up to 100 replicates per point, until 16 stops are counted (q to 50 %)" in line for line in before)
    assert any("16 stops are needed" in line for line in before)
    summary = carry_out(asked, lab, backend=backend)
    (point,) = find(asked, Catalogue(lab), "toy").points
    q = point.pooled["clogging_probability"]
    assert isinstance(q, PooledRate)
    assert q.events >= events_needed(0.5)
    assert q.low < 1 / 30 < q.high
    assert len(point.runs) < 60
    assert any("of 16 stops for 50 %" in line for line in summary.lines())
    assert not carry_out(asked, lab, backend=backend).tally.ran


def test_an_error_of_what_is_not_measured_is_refused(tmp_path):
    path = study_file(tmp_path, "window: {start: 0.15, end: 0.6}", "accuracy: {clogging: 20 %}")
    ended = labbook("plan", path, "--lab", tmp_path / "lab", check=False)
    assert "add clogging to measure" in ended.output
