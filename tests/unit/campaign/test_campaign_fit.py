"""The goal `fit`: simulated campaigns keep the promise; beds go to both ends; laws that miss; faults of studies."""

import math
import re
from types import SimpleNamespace

import numpy as np
import pytest
from labbook_toy import Backend
from toy_lab import carry_out, labbook, study_file

from labbook.campaign import Campaign, FitLaw, Generation, Trial
from labbook.campaign.campaign import Proposed
from labbook.campaign.goal import HELD_OUT
from labbook.lab import Catalogue
from labbook.results.find import find
from labbook.scene import HertzMindlin, Scene, Spheres
from labbook.scene.round_silos import CylinderSilo
from labbook.study import StudyError, load

KEY, C, K, d = "container.orifice", 0.58, 1.4, 3e-3
SCENE = Scene(
    grains=Spheres(diameter=d, density=2500, count=1000),
    contact=HertzMindlin(shear_modulus=1e8, poisson_ratio=0.25, friction=0.5, restitution=0.2),
    container=CylinderSilo(diameter=0.12, height=0.5, orifice=0.03),
)


def beverloo(D: float) -> float:
    """Of a hole [kg/s]."""
    return C * 2500 * math.sqrt(9.81) * (D - K * d) ** 2.5


class Toy:
    """A study of outlets from 18 to 60 mm, and runs that scatter by 2.2 %: 17 % of the variance are of beds."""

    def __init__(self, law=beverloo, values=(0.018, 0.06), seed: int = 1):
        self.study = SimpleNamespace(
            points=[SimpleNamespace(at={KEY: D}, scene=SCENE) for D in values],
            units={KEY: "m"},
            discharges_per_bed=1,
            accuracy=SimpleNamespace(max_replicates=200),
        )
        self.law, self.rng = law, np.random.default_rng(seed)
        self.beds: dict[int, float] = {}
        self.runs: dict[tuple[float, int], Trial] = {}

    def run(self, at, seed: int) -> Trial:
        D = at[KEY]
        if (D, seed) not in self.runs:
            bed = self.beds.setdefault(seed, self.rng.normal())
            noise = 0.022 * (math.sqrt(0.17) * bed + math.sqrt(0.83) * self.rng.normal())
            self.runs[D, seed] = Trial(
                at, seed, f"{D} {seed}", "finished", {"flow_rate": self.law(D) * math.exp(noise)}
            )
        return self.runs[D, seed]

    def evaluate(self, generation: Generation) -> tuple[Trial, ...]:
        return tuple(self.run(one.at, seed) for one in generation.assignments for seed in range(1, one.replicates + 1))

    def campaign(self, part: float = 0.02, budget: int | None = None) -> Campaign:
        goal = FitLaw(law="beverloo_3d", errors={"C_particle": part, "k": part}, budget=budget)
        campaign = Campaign(goal, self.study)
        campaign.advance(self.evaluate)
        return campaign


def parameters(ended: str | None) -> tuple[float, float]:
    found = re.search(r"C_particle = ([\d.]+) ±.*? k = ([\d.]+) ±", ended or "")
    return (float(found[1]), float(found[2])) if found else (math.nan, math.nan)


@pytest.mark.slow
@pytest.mark.parametrize(("repeats", "fewest"), [(30, 25), pytest.param(200, 182, marks=pytest.mark.ring)])
def test_the_promise_is_kept(repeats, fewest):
    """A9: k and C to 2 % at 95 %, in 182 or more of 200 with a probability of 99 %, in 25 or more of 30. A grid of five
    outlets takes 120 runs for k to 2 %: three quarters of these are allowed."""
    reached, tested, runs = 0, 0, []
    for seed in range(repeats):
        toy = Toy(seed=seed)
        campaign = toy.campaign()
        ours = parameters(campaign.ended)
        reached += abs(ours[0] / C - 1) <= 0.02 and abs(ours[1] / K - 1) <= 0.02
        tested += "Promise kept" in (campaign.ended or "")
        runs.append(len(toy.runs) - 2 * HELD_OUT)
    assert reached >= fewest
    assert tested >= fewest
    assert np.mean(runs) < 0.75 * 120


def test_most_beds_are_at_both_ends():
    """A fifth is inside. ln W is a straight line against u = 1/(D - k d). For its slope both ends are worth the same,
    and for its value at u = 0, which is C, the wide end is worth more."""
    toy = Toy()
    campaign, beds = toy.campaign(), {}
    for generation in campaign.generations[:-1]:
        beds |= {one.at[KEY]: one.replicates for one in generation.assignments}
    inside = sum(number for D, number in beds.items() if D not in (0.018, 0.06))
    assert len(beds) == 8
    assert inside <= 0.35 * sum(beds.values())
    assert 0.6 < beds[0.018] / beds[0.06] < 1.6


def test_it_proposes_the_same_from_any_generation_on():
    toy = Toy()
    whole = toy.campaign(0.04)
    for number in range(len(whole.generations)):
        kept = Proposed(tuple(Generation(g.number, g.assignments, g.reason) for g in whole.generations[:number]))
        again = Campaign(whole.strategy, toy.study, kept)
        again.advance(toy.evaluate)
        assert (again.generations, again.ended) == (whole.generations, whole.ended)


def test_outlets_below_the_range_of_the_law_are_left_out():
    first = Toy(values=(0.012, 0.06)).campaign(0.05).generations[0]
    assert min(float(one.at[KEY]) for one in first.assignments) == pytest.approx(6 * d)


def test_a_law_that_misses_is_given_up():
    """An exponential in place of Beverloo's law."""
    campaign = Toy(lambda D: 0.02 * math.exp(D / 0.012)).campaign()
    assert campaign.ended is not None
    assert campaign.ended.startswith("beverloo_3d misses the points (p = ")


def test_the_plan_states_rule_and_runs():
    toy = Toy()
    rule = toy.campaign(budget=60)
    assert len(toy.runs) <= 60
    assert rule.lines[0].startswith("Goal: C_particle to 2 % and k to 2 % of beverloo_3d")
    assert "16 beds over the range" in rule.lines[0]
    assert "at most 60" in rule.lines[0]
    assert rule.ended is not None
    assert rule.ended.startswith("the budget of 60 runs does not allow more")


def asked(folder, adapt: str, orifices: str = "[19, 40]"):
    return study_file(folder, f"adapt: {adapt}", "window: {start: 0.15, end: 0.6}", orifices=orifices, count=200)


@pytest.mark.parametrize(("adapt", "says"), [
    ("{fit: {}}", "adapt.fit: one law with errors of its parameters is needed"),
    ("{fit: {beverlo: {k: 1 %}}}", "there is no such law"),
    ("{fit: {beverloo: {kk: 1 %}}}", "the law has no such parameter"),
    ("{fit: {beverloo: {k: 1 mm}}}", "a number without unit is needed"),
    ("{fit: {beverloo: {k: 300 %}}}", "a fraction from 0.0001 to 1 is needed"),
    ("{fit: {beverloo: {C: 1 %}}}", "C rests on the packing fraction"),
    ("{fit: {beverloo_3d: {k: 1 %}}}", "beverloo_3d is a law for a hole"),
])  # fmt: skip
def test_what_is_wrong_is_named(tmp_path, adapt, says):
    with pytest.raises(StudyError) as caught:
        load(asked(tmp_path, adapt))
    assert says in str(caught.value)


def test_a_range_below_the_law_is_refused(tmp_path):
    with pytest.raises(StudyError, match="no range in which the law is meant to hold"):
        load(asked(tmp_path, "{fit: {beverloo: {k: 2 %}}}", "[10, 15]"))


@pytest.mark.slow
def test_from_yaml_to_the_report(tmp_path, one_format):
    """On the toy backend, whose outlets follow Beverloo's law with C = 0.6, of the grains' density, and k = 1.4."""
    path, lab = asked(tmp_path, "{fit: {beverloo: {C_particle: 20 %, k: 20 %}}}"), tmp_path / "lab"
    study = load(path)
    carry_out(study, lab, backend=Backend())
    results = find(study, Catalogue(lab), "toy")
    assert "Promise kept" in results.campaign[-1]
    ours = parameters(results.campaign[-1])
    assert ours == (pytest.approx(0.6, rel=0.2), pytest.approx(1.4, rel=0.2))
    labbook("report", path, "--lab", lab, "--backend", "toy")
    assert "Promise kept" in (lab / "reports/toy-study/report.html").read_text(encoding="utf-8")
