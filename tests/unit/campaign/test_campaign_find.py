"""The goal `find`: simulated campaigns keep the promise; faults of studies, clogged points, budgets, values out of
reach."""

import json
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from labbook_toy import Backend
from toy_lab import carry_out, labbook, study_file

from labbook.campaign import Campaign, Find, Generation, Trial
from labbook.campaign.campaign import Proposed
from labbook.campaign.goal import HELD_OUT, DeviceTime
from labbook.lab import Catalogue, LabFolder
from labbook.lab.campaigns import CampaignFile
from labbook.results.find import find
from labbook.scene.quantities import duration
from labbook.study import StudyError, load

KEY = "container.orifice"
d = 3e-3


def hole(D: float) -> float:
    """Beverloo's law of a hole with another k than the trend that is taken off [kg/s]."""
    return 0.58 * 2500 * math.sqrt(9.81) * (D - 1.7 * d) ** 2.5


def friction(mu: float) -> float:
    return 0.03 * math.exp(-0.35 * (1 - math.exp(-mu / 0.25)))


class Toy:
    """A study with one swept key, and runs that scatter by 2.2 %: 17 % of the variance are of beds."""

    def __init__(self, law, values, key: str = KEY, seed: int = 1, clogs=lambda x, seed: False):
        scene = SimpleNamespace(
            container=SimpleNamespace(outlet_form="hole"), grains=SimpleNamespace(equivalent_diameter=d)
        )
        self.study = SimpleNamespace(
            points=[SimpleNamespace(at={key: x}, scene=scene) for x in values],
            units={key: "m" if key == KEY else ""},
            discharges_per_bed=1,
            accuracy=SimpleNamespace(max_replicates=100),
        )
        self.law, self.key, self.clogs, self.rng = law, key, clogs, np.random.default_rng(seed)
        self.beds: dict[int, float] = {}
        self.runs: dict[tuple[float, int], Trial] = {}

    def run(self, at, seed: int) -> Trial:
        x = at[self.key]
        if (x, seed) not in self.runs:
            bed = self.beds.setdefault(seed, self.rng.normal())
            noise = 0.022 * (math.sqrt(0.17) * bed + math.sqrt(0.83) * self.rng.normal())
            stuck = self.clogs(x, seed)
            numbers = {} if stuck else {"flow_rate": self.law(x) * math.exp(noise)}
            self.runs[x, seed] = Trial(at, seed, f"{x} {seed}", "clogged" if stuck else "finished", numbers)
        return self.runs[x, seed]

    def evaluate(self, generation: Generation) -> tuple[Trial, ...]:
        return tuple(self.run(one.at, seed) for one in generation.assignments for seed in range(1, one.replicates + 1))

    def campaign(
        self, target: float, within: float = 0.01, budget: int | None = None, device_time: float | None = None
    ) -> Campaign:
        limits = {"budget": budget, "device_time": device_time}
        goal = Find(key=self.key, quantity="flow_rate", target=target, within=within, **limits)
        campaign = Campaign(goal, self.study)
        campaign.advance(self.evaluate)
        return campaign


def answer(campaign: Campaign) -> float:
    """The setting [SI, or mm as m] with which the campaign has ended."""
    assert campaign.ended is not None
    number, unit, *_ = campaign.ended.split()
    return float(number) * (1e-3 if unit == "mm" else 1)


@pytest.mark.slow
@pytest.mark.parametrize(("repeats", "fewest"), [(40, 34), pytest.param(200, 182, marks=pytest.mark.ring)])
def test_the_promise_is_kept(repeats, fewest):
    """A9: campaigns for 1 %. At 95 % it is kept in 190 +- 3 of 200, and in 182 or more with a probability of 99 %; of
    40 in 34 or more. Where the scatter of 2.2 % is known, 24 runs are needed on average; 1.35 times as many here."""
    rng, reached, tested, runs = np.random.default_rng(11), 0, 0, []
    for k in range(repeats):
        toy, D = Toy(hole, (0.018, 0.06), seed=k), rng.uniform(0.02, 0.057)
        campaign = toy.campaign(hole(D))
        reached += abs(hole(answer(campaign)) / hole(D) - 1) <= 0.01
        tested += "Promise kept" in (campaign.ended or "")
        runs.append(len(toy.runs) - HELD_OUT)
    assert reached >= fewest
    assert tested >= fewest
    assert np.mean(runs) < 1.35 * 24


@pytest.mark.slow
def test_other_keys_are_found_as_well():
    """The friction that gives a flow rate within 2 %, in 30 campaigns: 25 or more at 95 % with 99 %."""
    rng, kept = np.random.default_rng(12), 0
    for k in range(30):
        mu = rng.uniform(0.1, 0.6)
        campaign = Toy(friction, (0.05, 0.9), "contact.friction", k).campaign(friction(mu), 0.02)
        kept += abs(friction(answer(campaign)) / friction(mu) - 1) <= 0.02
    assert kept >= 25


def test_it_proposes_the_same_from_any_generation_on():
    """A8: killed after any generation, with what was kept or without."""
    toy = Toy(hole, (0.018, 0.06))
    whole = toy.campaign(hole(0.03))
    for number in range(len(whole.generations)):
        kept = Proposed(tuple(Generation(g.number, g.assignments, g.reason) for g in whole.generations[:number]))
        again = Campaign(whole.strategy, toy.study, kept)
        again.advance(toy.evaluate)
        assert (again.generations, again.ended) == (whole.generations, whole.ended)


def test_runs_are_those_of_a_study_with_that_number():
    """Settings are numbers of a few digits: a study that states one in mm shares the runs."""
    whole = Toy(hole, (0.018, 0.06)).campaign(hole(0.0333))
    settings = [1e3 * float(one.at[KEY]) for one in whole.assignments]
    assert all(float(f"{x:.4g}") == pytest.approx(x, rel=1e-12) for x in settings)


def test_the_sweep_is_where_it_starts():
    toy = Toy(hole, (0.018, 0.025, 0.03, 0.04, 0.05))
    first = toy.campaign(hole(0.03)).generations[0]
    assert [one.at[KEY] for one in first.assignments] == [0.018, 0.025, 0.03, 0.04, 0.05]


def test_held_out_beds_are_new():
    toy = Toy(hole, (0.018, 0.06))
    campaign = toy.campaign(hole(0.03))
    last = campaign.generations[-1]
    before = {seed for x, seed in toy.runs if x != last.assignments[0].at[KEY]}
    assert len(last.assignments) == 1
    assert max(before) <= last.assignments[0].replicates - HELD_OUT
    assert f"{HELD_OUT} held-out beds" in campaign.lines[-1]
    assert campaign.lines[0].startswith("Goal: container.orifice with flow_rate = 444.3 g/s within 1 %. 8 beds over")


def test_a_broken_promise_is_reported():
    """Beds from the seeds that are held out on flow 6 % faster."""

    plain = Toy(hole, (0.018, 0.06)).campaign(hole(0.03), 0.02)
    latest = plain.generations[-1].assignments[0].replicates - HELD_OUT

    class Drifting(Toy):
        def run(self, at, seed):
            trial = super().run(at, seed)
            faster = 1.06 if seed > latest else 1.0
            return Trial(at, seed, trial.key, "finished", {"flow_rate": trial.numbers["flow_rate"] * faster})

    toy = Drifting(hole, (0.018, 0.06))
    ended = toy.campaign(hole(0.03), 0.02).ended
    assert ended is not None
    assert "Promise not kept (2 %)" in ended


def test_clogged_points_take_no_part():
    """Outlets below 26 mm always clog; one run in ten does elsewhere (A7)."""
    rng = np.random.default_rng(4)
    toy = Toy(hole, (0.018, 0.06), clogs=lambda x, seed: x < 0.026 or rng.random() < 0.05)
    campaign = toy.campaign(hole(0.035), 0.02)
    assert abs(hole(answer(campaign)) / hole(0.035) - 1) < 0.03
    assert "Promise kept" in campaign.lines[-1]
    never = Toy(hole, (0.018, 0.06), clogs=lambda x, seed: True).campaign(hole(0.035))
    assert never.ended == "no point over the range has a flow_rate without a clogged run; change `sweep`"


def test_a_value_beyond_the_range_is_not_sought():
    toy = Toy(hole, (0.018, 0.03))
    campaign = toy.campaign(hole(0.06))
    assert len(toy.runs) == 8
    assert campaign.ended is not None
    assert "is not reached within the range; change `sweep`" in campaign.ended


def test_a_budget_ends_it():
    toy = Toy(hole, (0.018, 0.06))
    campaign = toy.campaign(hole(0.03), budget=24)
    assert len(toy.runs) <= 24
    assert campaign.ended is not None
    assert campaign.ended.startswith("the budget of 24 runs does not allow more, and the promise is not reached")
    assert ", at most 24" in campaign.lines[0]


class Timed(Toy):
    """A toy whose runs take `seconds` of a device each, and as much for the filling of each seed."""

    seconds: float | None = 10.0

    def run(self, at, seed: int) -> Trial:
        trial = super().run(at, seed)
        return replace(trial, device_time={trial.key: self.seconds, f"filling {seed}": self.seconds})


def test_a_device_time_ends_it_and_chooses_nothing():
    """What is proposed does not depend on the times; with half the speed there are fewer generations of the same."""
    free = Timed(hole, (0.018, 0.06)).campaign(hole(0.03))
    ends = {}
    for seconds in (10.0, 20.0):
        toy = Timed(hole, (0.018, 0.06))
        toy.seconds = seconds
        campaign = toy.campaign(hole(0.03), device_time=400.0)
        assert campaign.ended is not None
        assert "the budget of 7 min of device time does not allow more" in campaign.ended
        ends[seconds] = len(campaign.generations)
        for own, other in zip(campaign.generations, free.generations, strict=False):
            assert own.assignments == other.assignments
        used = DeviceTime.of(trial for of in campaign.generations for trial in of.trials or ())
        assert used.total == seconds * (len(toy.runs) + len({seed for _, seed in toy.runs})), "each filling once"
        assert used.total <= 400
        assert campaign.ended.endswith(f"{duration(used.total)} of 7 min of device time used")
    assert 1 <= ends[20.0] < ends[10.0] < len(free.generations)


def test_enough_device_time_changes_nothing_but_the_account():
    free = Timed(hole, (0.018, 0.06)).campaign(hole(0.03))
    rich = Timed(hole, (0.018, 0.06)).campaign(hole(0.03), device_time=1e5)
    assert [of.assignments for of in rich.generations] == [of.assignments for of in free.generations]
    assert rich.ended is not None
    assert free.ended is not None
    assert rich.ended.startswith(f"{free.ended}; ")
    assert all("of device time used" in of.reason for of in rich.generations[1:])


def test_runs_without_a_device_time_are_counted_and_said():
    """Runs of an older lab have none: nothing is assumed for them, and each reason says how many there are."""
    toy = Timed(hole, (0.018, 0.06))
    toy.seconds = None
    campaign = toy.campaign(hole(0.03), device_time=400.0)
    number = len(toy.runs)
    assert campaign.ended is not None
    assert "Promise kept" in campaign.ended
    assert campaign.ended.endswith(f"0 s of 7 min of device time used, not counting {number} runs without a recorded "
                                   "device time")  # fmt: skip


@pytest.mark.parametrize(("again", "says"), [(1000.0, "does not allow"), (0.1, "Promise kept")])
def test_a_time_that_changed_does_not_change_what_was_stored(again, says):
    """A8: runs that were lost and made again take another time. What was stored stays, and what follows is the same or
    an end; a promise that seems kept is tested in any case."""
    toy = Timed(hole, (0.018, 0.06))
    whole = toy.campaign(hole(0.03), device_time=2000.0).generations
    toy.seconds = again
    for number in range(1, len(whole) + 1):
        kept = Proposed(tuple(Generation(of.number, of.assignments, of.reason) for of in whole[:number]))
        after = Campaign(Find(key=KEY, quantity="flow_rate", target=hole(0.03), within=0.01, device_time=2000.0),
                         toy.study, kept)  # fmt: skip
        after.advance(toy.evaluate)
        assert [of.assignments for of in after.generations] == [
            of.assignments for of in whole[: len(after.generations)]
        ]
        assert after.ended is not None
        assert ("Promise kept" if number >= len(whole) - 1 else says) in after.ended


def asked(folder, adapt: str, orifices: str = "[15, 30]", *more: str):
    return study_file(folder, f"adapt: {adapt}", "window: {start: 0.15, end: 0.6}", *more, orifices=orifices)


FIND = "{find: {container.orifice: {flow_rate: 28 g/s, within: 3 %}}, budget: 60 runs}"


def test_a_study_states_it(tmp_path):
    goal = load(asked(tmp_path, FIND)).adapt
    assert goal is not None
    assert goal == Find(key=KEY, quantity="flow_rate", target=0.028, within=0.03, budget=60)
    for stated, runs, seconds in (
        ("10 min", None, 600.0),
        ("{runs: 60, device_time: 2 h}", 60, 7200.0),
        ("60", 60, None),
    ):
        timed = load(asked(tmp_path, FIND.replace("60 runs", stated))).adapt
        assert timed == goal.model_copy(update={"budget": runs, "device_time": seconds})
    assert "device_time" not in goal.model_dump(), "keys of campaigns in older labs stay"
    without = load(asked(tmp_path, FIND)).change({"adapt.budget": None}).adapt
    assert without == Find(key=KEY, quantity="flow_rate", target=0.028, within=0.03)


@pytest.mark.parametrize(("adapt", "says"), [
    ("{find: {}}", "adapt.find: one swept key with what it shall give is needed"),
    ("{find: {container.orifice: {flow_rate: 28 g/s}}}", "one quantity and `within` are needed"),
    ("{find: {container.orifice: {flow_rate: 28 mm, within: 1 %}}}", "a quantity in kg/s is needed"),
    ("{find: {container.orifice: {flow_rate: 28 g/s, within: 200 %}}}", "a fraction from 0.0001 to 1 is needed"),
    ("{find: {container.orifice: {flow: 28 g/s, within: 1 %}}}", "this is no quantity that is pooled over beds"),
    ("{find: {container.orifice: {packing_fraction: 0.6, within: 1 %}}}", "add packing to measure"),
    ("{find: {container.angle: {flow_rate: 28 g/s, within: 1 %}}}", "the study sweeps container.orifice"),
    ("{find: {container.orifice: {flow_rate: 28 g/s, within: 1 %}}, budget: 3}", "adapt.budget"),
    ("{find: {container.orifice: {flow_rate: 28 g/s, within: 1 %}}, budget: 10 mm}", "10 mm: a quantity in s is"),
    ("{find: {container.orifice: {flow_rate: 28 g/s, within: 1 %}}, budget: {}}", "runs or device_time is needed"),
    ("{budget: 30}", "0 strategies are named, and one is needed"),
])  # fmt: skip
def test_what_is_wrong_is_named(tmp_path, adapt, says):
    with pytest.raises(StudyError) as caught:
        load(asked(tmp_path, adapt))
    assert says in str(caught.value)
    assert "toy.yaml:" in str(caught.value)


def test_one_value_is_no_range(tmp_path):
    with pytest.raises(StudyError, match=r"one value of container\.orifice, which is no range"):
        load(asked(tmp_path, FIND, "[24]"))


@pytest.mark.slow
def test_from_yaml_to_the_report(tmp_path, one_format):
    """On the toy backend, where 0.6 rho sqrt(g) (D - 1.4 d)^1.5 over the depth is 28 g/s at 20 mm."""
    path, lab = asked(tmp_path, FIND.replace("60 runs", "{runs: 60, device_time: 1 h}")), tmp_path / "lab"
    planned = labbook("plan", path, "--lab", lab, "--backend", "toy").output
    assert "Goal: container.orifice with flow_rate = 28 g/s within 3 %" in planned
    assert "at most 60 runs and 60 min of device time" in planned
    plain = json.loads(labbook("plan", path, "--lab", lab, "--backend", "toy", "--json").stdout)
    assert plain["campaign"][0].startswith("Goal: container.orifice with flow_rate = 28 g/s within 3 %")
    assert not (lab / "campaigns").exists()
    study = load(path)
    carry_out(study, lab, backend=Backend())
    results = find(study, Catalogue(lab), "toy")
    assert "Promise kept (3 %)" in results.campaign[-1]
    assert results.campaign[-1].endswith("of 60 min of device time used"), "each run has its time"
    assert f"{answer_of(results.campaign[-1]):.3g}" in ("19.8", "19.9", "20", "20.1", "20.2")
    labbook("report", path, "--lab", lab, "--backend", "toy")
    page = (lab / "reports/toy-study/report.html").read_text(encoding="utf-8")
    assert page.count("Promise kept (3 %)") >= 2, "in the box, and where points were chosen"
    assert '"campaign": [' in labbook("fit", path, "--lab", lab, "--backend", "toy", "--json").output
    # without its file, the same follows from the runs; runs are those of a grid with these outlets
    assert study.adapt is not None
    file = CampaignFile(LabFolder(lab), study, study.adapt, "toy").path
    record = file.read_text()
    file.unlink()
    assert not carry_out(study, lab, backend=Backend()).tally.ran
    assert file.read_text() == record
    widths = ", ".join(f"{1e3 * float(point.point.at[KEY]):.12g}" for point in results.points)
    grid = study_file(tmp_path, "window: {start: 0.15, end: 0.6}", orifices=f"[{widths}]")
    assert not carry_out(load(grid), lab, backend=Backend()).tally.ran


def answer_of(line: str) -> float:
    return float(line.removeprefix("find has ended: ").split()[0])
