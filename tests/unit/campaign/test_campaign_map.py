"""The goal `map`: the promise is kept in simulated campaigns; mistakes of studies; the same proposals each time."""

from dataclasses import replace
from types import SimpleNamespace

import pytest
from learning import ANGLE, FRICTION, KEYS, OUTLET, RANGES, SyntheticStudy, hopper, maps
from toy_lab import labbook, study, study_file

from labbook.campaign import Campaign, Generation, Map
from labbook.campaign.campaign import Proposed
from labbook.study import StudyError

pytest.importorskip("sklearn")
GOAL = "adapt: {map: {flow_rate: 10 %, over: [container.orifice, grains.density], on: 90 %}, budget: 400 runs}"
SWEEP = "sweep: {container.orifice: '[18, 30] mm', grains.density: '[1500, 3000] kg/m^3'}"


def synthetic(law=hopper, seed: int = 1, stops: float = 0.0) -> SyntheticStudy:
    """A study that sweeps friction, angle and outlet."""
    made = SyntheticStudy(law, seed, stops)
    scene = made.study.points[0].scene
    ends = zip(*(RANGES[key] for key in KEYS), strict=True)
    made.study.points = [SimpleNamespace(at=dict(zip(KEYS, end, strict=True)), scene=scene) for end in ends]
    return made


@pytest.fixture(scope="module")
def mapped() -> tuple[SyntheticStudy, Campaign]:
    """A map to 5 %, with a tenth of the runs clogged or diverged."""
    there = synthetic(stops=0.1)
    return there, there.campaign(Map(quantity="flow_rate", error=0.05, over=KEYS, on=0.95))


def test_it_ends_with_the_test_of_its_promise(mapped):
    there, campaign = mapped
    assert "Promise kept: the residuals of" in campaign.lines[-1]
    assert "flow_rate is known to 5 %" in campaign.lines[-1]
    assert len(campaign.generations[-1].assignments) == 32
    before = {tuple(one.at.items()) for g in campaign.generations[:-1] for one in g.assignments}
    assert not before & {tuple(one.at.items()) for one in campaign.generations[-1].assignments}
    assert len(there.trials) < 150


def test_it_proposes_the_same_from_any_generation_on(mapped):
    """A8: killed after any generation, with what was kept or without."""
    there, whole = mapped
    for number in range(len(whole.generations)):
        kept = Proposed(tuple(Generation(g.number, g.assignments, g.reason) for g in whole.generations[:number]))
        again = Campaign(whole.strategy, there.study, kept)
        again.advance(there.evaluate)
        assert (again.generations, again.ended) == (whole.generations, whole.ended)


def test_every_generation_has_new_runs(mapped):
    _, campaign = mapped
    beds: dict[tuple, int] = {}
    for generation in campaign.generations:
        for one in generation.assignments:
            assert one.replicates > beds.get(tuple(one.at.items()), 0)
            beds[tuple(one.at.items())] = one.replicates


def test_a_range_that_clogs_has_no_map():
    campaign = synthetic(stops=0.9).campaign(Map(quantity="flow_rate", error=0.05, over=KEYS, on=0.95))
    assert "runs clogged, so the others are a biased sample" in (campaign.ended or "")


def test_a_broken_promise_is_told(mapped):
    """Held-out runs that give 20 % more than the map."""
    there, campaign = mapped
    held = {tuple(one.at.items()) for one in campaign.generations[-1].assignments}
    withheld = [trial for trial in there.trials if tuple(trial.at.items()) in held]
    trials = [trial for trial in there.trials if tuple(trial.at.items()) not in held]
    high = [replace(one, numbers={name: 1.2 * value for name, value in one.numbers.items()}) for one in withheld]
    assert isinstance(campaign.strategy, Map)
    assert "Promise kept" in campaign.strategy.verdict(there.study, trials, withheld)
    assert "Promise not kept" in campaign.strategy.verdict(there.study, trials, high)


def test_a_budget_ends_it():
    goal = Map(quantity="flow_rate", error=0.01, over=KEYS, on=0.95, budget=120)
    assert "the budget of 120 runs does not allow more" in (synthetic().campaign(goal).ended or "")


@pytest.mark.ring
def test_from_yaml_to_its_end(tmp_path):
    """On the toy backend, whose flow rate is proportional to the density and known against the outlet."""
    path = study_file(tmp_path, GOAL, count=160)
    text = path.read_text().replace('sweep:\n  container.orifice: "[18, 24] mm"\n', f"{SWEEP}\n")
    path.write_text(text)
    options = ("--lab", tmp_path / "lab", "--backend", "toy")
    plan = labbook("plan", path, *options).output
    assert (
        "Goal: flow_rate to 10 % (half width of the 95 % interval) on 90 % of the range of container.orifice, " in plan
    )
    ended = labbook("run", path, *options).output
    assert "Promise kept" in ended


@pytest.mark.parametrize(
    ("goal", "message"),
    [
        ("{over: [container.orifice]}", "one quantity with its error"),
        ("{flow_rate: 2 %}", "one quantity with its error"),
        ("{speed: 2 %, over: [container.orifice]}", "adapt.map.speed: this is no quantity"),
        ("{flow_rate: 200 %, over: [container.orifice]}", "adapt.map.flow_rate: 200 %: a fraction from 0.001 to 1"),
        ("{flow_rate: 2 %, over: [container.orifice], on: 0 %}", "adapt.map.on: 0 %: a fraction from 0.1"),
        ("{flow_rate: 2 %, over: 3}", "adapt.map.over: a list of swept keys is needed"),
        ("{flow_rate: 2 %, over: [contact.friction]}", "the range of contact.friction is that of `sweep`"),
        ("{flow_rate: 2 %, over: [contact.friction]}", "container.orifice is swept as well"),
        ("{packing_fraction: 2 %, over: [container.orifice]}", "packing_fraction is not measured"),
    ],
)
def test_mistakes_are_told(tmp_path, goal, message):
    with pytest.raises(StudyError) as error:
        study(tmp_path, f"adapt: {{map: {goal}}}")
    assert message in str(error.value)


@pytest.mark.ring
def test_the_promise_is_kept():
    """A9: maps of three keys to 2 % on 95 % of the range: in 26 or more of 30 at 95 %, with a probability of 98 %. The
    grid has 1920 runs."""
    assert {FRICTION, ANGLE, OUTLET} == {*KEYS}
    figures = maps(30)
    assert figures["kept"] >= 26
    assert figures["runs"] < 240
