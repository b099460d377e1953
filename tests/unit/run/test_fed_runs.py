"""Runs of beds that are fed: they end when they are precise, and go on where they were."""

from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from labbook_toy import Backend
from toy_lab import arrays, carry_out, study
from toy_records import outcomes, records
from toy_results import analyse
from wrong_study import BASE, problems

from labbook.backend import Unsupported
from labbook.lab import Catalogue, LabFolder, identity
from labbook.lab.records import Precise, StopRule
from labbook.lab.runs import open_run
from labbook.plan.coverage import finished
from labbook.plan.demand import PointDemand
from labbook.plan.forecast import discharge_time, discharge_work, disk_of
from labbook.plan.plan import Planner
from labbook.run.runner import Runner
from labbook.stats.stopping import FIRST_LOOK

FED = "feed: {kind: reinject}"
TO = "accuracy: {{flow_rate: {}}}"
LONG = "stop: {max_time: 30 s}"


pytestmark = pytest.mark.slow


def fed(folder, *more, **changes):
    asked = study(folder, FED, *more, **{"orifices": "[24]", "replicates": 1, "count": 100, **changes})
    return asked.change({"numerics.steps_per_beat": 2000})


def only(lab):
    (record,) = records(lab).values()
    return record


def test_a_run_ends_when_its_own_statistics_are_precise(tmp_path):
    """One bed is enough: the interval comes from within its run, and holds the rate at which toy grains leave."""
    asked = fed(tmp_path, TO.format("2 %"), LONG)
    summary = carry_out(asked, tmp_path / "lab")
    assert outcomes(summary) == ["precise"]
    record = only(tmp_path / "lab")
    assert record.coverage.crossed >= FIRST_LOOK + 50
    assert record.coverage.discharged == record.coverage.crossed / 100 > 6, "in masses of the bed"
    choice = asked.points[0].choice
    assert choice is not None
    assert 0.01 < choice.remainder < 0.02, "the bias of its step takes a part of the error"
    assert record.coverage.stop.precise == Precise(flow_rate=choice.remainder, start=0.5)
    assert record.coverage.duration < 30
    (point,) = analyse(asked, finished(Catalogue(tmp_path / "lab"), asked, "toy")).points
    assert point.flow_rate is not None
    assert point.flow_rate.n == 1
    assert 0 < point.flow_rate.relative <= 0.02
    assert point.precise
    assert point.remark == ""
    true = 0.6 * 2500 * np.sqrt(9.81) * (0.024 - 1.4 * 3e-3) ** 1.5 * 1.01 * 3e-3
    assert abs(point.flow_rate.value / true - 1) < 0.03
    assert not carry_out(asked, tmp_path / "lab").tally.ran


def test_more_precision_goes_on_from_there_and_less_is_there_already(tmp_path):
    lab, alone = tmp_path / "lab", tmp_path / "alone"
    carry_out(fed(tmp_path, TO.format("3 %"), LONG), lab)
    first = only(lab).coverage
    finer = carry_out(fed(tmp_path, TO.format("1 %"), LONG), lab)
    assert finer.tally.resumed == 1
    assert outcomes(finer) == ["precise"]
    assert only(lab).coverage.crossed > first.crossed
    assert not carry_out(fed(tmp_path, TO.format("5 %"), LONG), lab).tally.ran
    assert outcomes(carry_out(fed(tmp_path, TO.format("1 %"), LONG), alone)) == ["precise"]
    key = only(lab).run_key
    assert arrays(lab / "runs" / key) == arrays(alone / "runs" / key), "the same bits as in one go"


def test_of_another_start_up_it_goes_on(tmp_path):
    carry_out(fed(tmp_path, TO.format("3 %"), LONG), tmp_path / "lab")
    asked = fed(tmp_path, TO.format("3 %"), LONG, "window: {start: 0.9}")
    assert asked.window.start == 0.9
    (item,) = Planner(asked, Catalogue(tmp_path / "lab"), Backend().capabilities).plan().items
    assert item.state == "partial"
    assert "precise after" in item.reason


def test_without_an_accuracy_or_too_late_it_ends_by_time(tmp_path):
    summary = carry_out(fed(tmp_path, "stop: {max_time: 2 s}"), tmp_path / "lab")
    assert outcomes(summary) == ["time-limit"]
    record, data = open_run(tmp_path / "lab" / "runs" / only(tmp_path / "lab").run_key)
    assert record.coverage.duration == pytest.approx(2.0)
    assert len(data.tables["crossing"]["id"]) == record.coverage.crossed > 100
    late = carry_out(fed(tmp_path, TO.format("0.1 %"), "stop: {max_time: 3 s}"), tmp_path / "lab")
    assert outcomes(late) == ["time-limit"]
    assert late.tally.resumed == 1


def test_a_window_opens_after_the_start_up_and_has_no_end(tmp_path):
    asked = fed(tmp_path, "stop: {max_time: 2 s}")
    carry_out(asked, tmp_path / "lab")
    (point,) = analyse(asked, finished(Catalogue(tmp_path / "lab"), asked, "toy")).points
    measured = point.runs[0].measured["flow_rate"]
    assert "ended within" not in measured.note
    assert measured.window.startswith("0.5 to ")
    crossed = only(tmp_path / "lab").coverage.crossed
    assert float(measured.window.split()[2]) == pytest.approx(crossed / 100, rel=0.01)


def test_a_clogged_run_is_clogged(tmp_path):
    """A toy outlet narrower than 3 d clogs for good."""
    asked = fed(tmp_path, TO.format("2 %"), orifices="[8]")
    assert outcomes(carry_out(asked, tmp_path / "lab")) == ["clogged"]


def test_replicates_are_as_many_as_stated_and_pooled_between_runs(tmp_path):
    asked = fed(tmp_path, TO.format("3 %"), LONG, replicates=3)
    assert outcomes(carry_out(asked, tmp_path / "lab")) == ["precise"] * 3
    (point,) = analyse(asked, finished(Catalogue(tmp_path / "lab"), asked, "toy")).points
    values = [run.measured["flow_rate"].value for run in point.runs]
    assert point.flow_rate is not None
    assert point.flow_rate.error == pytest.approx(np.std(values, ddof=1) / np.sqrt(3))
    assert len(set(values)) == 3


def test_lanes_change_no_bit(tmp_path):
    asked = fed(tmp_path, TO.format("3 %"), LONG, replicates=3)
    for name, lanes in (("one", 1), ("two", 2)):
        Runner(asked, LabFolder(tmp_path / name), Backend(), workers=lanes).run()
    for folder in (tmp_path / "one" / "runs").iterdir():
        assert arrays(folder) == arrays(tmp_path / "two" / "runs" / folder.name)


class Counting(Backend):
    """The toy on a device whose members are read together; counts what is read of several members, by beat."""

    def __init__(self):
        super().__init__()
        self.capabilities = replace(self.capabilities, devices=("cpu", "cuda:0"))
        self.together, self.alone = list[int](), 0

    def open(self, spec, slots=None, device="cpu"):
        ensemble, backend, within = super().open(spec, None, "cpu"), self, list[int]()
        packing = ensemble.packing

        @contextmanager
        def reading(members):
            within.append(0)
            yield
            backend.together.append(within.pop())

        def read(member):
            backend.alone += not within
            within[-1:] = [number + 1 for number in within[-1:]]
            return packing(member)

        ensemble.reading, ensemble.packing = reading, read
        return ensemble


def test_members_that_lack_grains_are_read_together_and_only_those(tmp_path):
    """Of six members side by side; in a beat a grain leaves a few of them."""
    asked = fed(tmp_path, "stop: {max_time: 0.3 s}", replicates=6, orifices="[14]").change(
        {"numerics.steps_per_beat": 200}
    )
    backend = Counting()
    Runner(asked, LabFolder(tmp_path / "device"), backend, device="cuda:0").run()
    assert backend.alone == 0
    several = [count for count in backend.together if count > 1]
    crossed = sum(record.coverage.crossed for record in records(tmp_path / "device").values())
    assert len(several) > 10
    assert sum(backend.together) <= crossed + 3 * 6, "a read for each grain that left, one for the picture, and the end"
    carry_out(asked, tmp_path / "core")
    for folder in (tmp_path / "core" / "runs").iterdir():
        assert arrays(folder) == arrays(tmp_path / "device" / "runs" / folder.name)


def test_a_feed_is_part_of_what_is_simulated(tmp_path):
    scene, plain = (s.points[0].scene for s in (fed(tmp_path), study(tmp_path, orifices="[24]", count=100)))
    assert identity.scene_key(scene) != identity.scene_key(plain)
    assert identity.scene_key(scene.close()) == identity.scene_key(plain.close()), "they share packings"
    assert "feed" not in plain.model_dump_json()
    assert identity.scene_key(scene.model_copy(update={"feed": None})) == identity.scene_key(plain)


def test_a_backend_that_cannot_put_grains_back_is_told(tmp_path):
    backend = Backend()
    backend.capabilities = replace(backend.capabilities, feeds=False)
    with pytest.raises(Unsupported, match="feed: the backend toy cannot feed grains back"):
        carry_out(fed(tmp_path), tmp_path / "lab", backend=backend)


def test_a_bed_that_fills_the_silo_is_told(tmp_path):
    asked = fed(tmp_path, count=1000).change({"container.height": "40 mm"})
    (why,) = carry_out(asked, tmp_path / "lab").tally.failed
    assert "raise container.height" in why


def test_a_forecast_goes_by_precision_or_by_time(tmp_path):
    coarse, fine, timed = (
        PointDemand(asked, asked.points[0])
        for asked in (fed(tmp_path, TO.format("4 %")), fed(tmp_path, TO.format("2 %")), fed(tmp_path, LONG))
    )
    assert discharge_time(timed) == 30
    assert 3 < discharge_time(fine) / discharge_time(coarse) < 4.1, "four times the grains, and the start-up"
    assert discharge_work(timed) == pytest.approx(100 * 30 / 1e-5)
    assert 0 < disk_of(coarse.run(1)) < disk_of(fine.run(1)) < 1e9


@pytest.mark.parametrize(
    ("more", "key", "message", "remedy"),
    [
        (
            "stop: {discharged: 0.7}",
            "stop.discharged",
            "never falls",
            "accuracy.flow_rate is reached, or at stop.max_time",
        ),
        ("stop: {fill_height: 10 mm}", "stop.fill_height", "never falls", "leave it out"),
        ("window: {end: 0.5}", "window.end", "closes when the run ends", "window.start"),
        ("stop: {discharged: 1}\nwindow: {after: 1 s, until: 2 s}", "window.after", "opens after", "window.start"),
    ],
)
def test_what_makes_no_sense_of_a_fed_bed_is_told(tmp_path, more, key, message, remedy):
    text = BASE + FED + "\n" + more + "\n"
    found = next(problem for problem in problems(tmp_path, text) if problem.key == key)
    assert message in found.message
    assert remedy in found.remedy
    assert found.line == text.splitlines().index(more.splitlines()[-1] if key != "stop.discharged" else more) + 1


def test_it_takes_a_silo_and_all_points(tmp_path):
    box = BASE.partition("container:")[0] + "container: {kind: box, width: 50 mm, depth: 50 mm, height: 1 m}\n" + FED
    (found,) = [problem for problem in problems(tmp_path, box + "\nmeasure: [packing]\n") if problem.key == "feed"]
    assert "a box has no outlet" in found.message
    (found,) = problems(tmp_path, BASE + "feed: {kind: rain}\n")
    assert (found.key, "reinject" in found.remedy) == ("feed.kind", True)


def test_how_a_stop_rule_compares():
    stop = StopRule(discharged=float("inf"), max_time=1.0, stall=1.0)
    assert stop.fed
    assert StopRule.model_validate_json(stop.as_stored()) == stop, "infinite, as it is stored"
    one = stop.model_copy(update={"precise": Precise(flow_rate=0.01, start=0.5)})
    two = stop.model_copy(update={"precise": Precise(flow_rate=0.02, start=0.5)})
    other = stop.model_copy(update={"precise": Precise(flow_rate=0.02, start=0.3)})
    assert one.as_precise(two)
    assert not two.as_precise(one)
    assert not one.as_precise(other)
    assert not stop.as_precise(one)
    assert not one.as_precise(stop)
    assert "precise" not in stop.as_stored().decode()
