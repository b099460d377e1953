"""Does the promise hold? A study asks for an error many times over, each time with seeds of its own.

    python benchmarks/promise.py STUDY --lab LAB [--repeats 300] [--finest 300] [--backend warp --device cuda:0]
    [--discharges-per-bed N | auto] [--shard I/N] [--out FILE]

Every repeat follows the study's stopping rule with the numerics that were chosen, and reports W with the half width
that labbook prints: that of the interval, and the bound of the bias. Held against it is the finest answer: the mean
of `--finest` runs with the stated stiffness and a quarter of the law's usual step. Its own error is common to all
repeats. So they are held as well against W without any step: W + b dt^2 is fitted to the runs of all steps. A scene
that was not calibrated gets its pilot first. Runs that are there are not run again; with --shard only a part of them
is made, so that several processes may share them. What the same error costs with the usual numerics is worked out from
runs with these. Seeds are taken in their order, so that no run enters two repeats.

With --discharges-per-bed every repeat has as many discharges of each of its beds, or the cheapest number. Its seeds are
a block of their own, all repeats are looked at in turns, and only the runs that they propose are made. The first
discharges of all these beds are also taken as repeats of the rule with a bed for every run, for the cost of both.
Beside it stands the papers' way: a bed of a rain for every run, the usual step, double precision. Of both, what one
number takes of the device is the wall time of all beats over the numbers that came of them.
"""

import argparse
import json
import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from labbook import Lab, Study
from labbook.accuracy import Choice
from labbook.backend import load as load_backend
from labbook.backend.machine import hardware
from labbook.campaign import Assignment, Generation, History, Replicates, Trial
from labbook.lab.catalogue import Catalogue
from labbook.lab.packings import PackingRecord
from labbook.lab.records import RunRecord
from labbook.plan.beds import filling_cost
from labbook.plan.demand import PointDemand, stopping_rule
from labbook.plan.plan import flow_rates
from labbook.results.points import by_seed
from labbook.run.runner import Runner
from labbook.stats import Decision, Pooled, StoppingRule, pool
from labbook.stats.nested import Design, by_bed, shares
from labbook.study import load

FINER = 0.25
"""Step of the finest answer, in parts of the law's usual one."""
MOST = 10_000
"""Runs of one point that a study may ask for."""
SAVED = 600.0
"""Seconds between two checkpoints: a run takes a few, and hundreds that go on at once would be saved all the time."""


@dataclass(frozen=True)
class Reported:
    """What one repeat says: W with the half width of its interval, from `runs` beds, with `discharges` of each."""

    value: float
    half_width: float
    runs: int
    discharges: int = 1


@dataclass(frozen=True)
class Cost:
    """Grain-steps of one discharge and of one filling, and seconds of the device for both, means over all runs."""

    discharge: float
    filling: float
    seconds: float


def repeats(rates: Sequence[float], rule: StoppingRule) -> list[Reported]:
    """Repeats of the rule on consecutive runs; runs that are left over at the end decide nothing."""
    found, at = [], 0
    while at + rule.first <= len(rates):
        n = rule.first
        while (decision := rule.decide(rates[at : at + n])).additional:
            n += decision.additional
            if at + n > len(rates):
                return found
        assert decision.pooled is not None
        found.append(Reported(decision.pooled.value, decision.pooled.half_width, n))
        at += n
    return found


Number = tuple[int, int]
"""Seed of a bed, and number of the discharge of that."""


@dataclass
class Repeat:
    """One repeat as it stands. `before`: the seed before its first bed; `rates`: W [kg/s] of its runs that have one."""

    before: int
    design: Design
    rates: dict[Number, float] = field(default_factory=dict)
    decision: Decision | None = None

    @property
    def numbers(self) -> list[Number]:
        """All its runs."""
        beds, discharges = range(1, self.design.beds + 1), range(1, self.design.discharges + 1)
        return [(self.before + bed, number) for bed in beds for number in discharges]

    def look(self, rule: StoppingRule, scatter: float, filling: float | None) -> None:
        """Take a look at its runs, all of which are there: its next design, or the decision at its end."""
        trials = tuple(
            Trial({}, seed, f"{seed} {number}", "", self._numbers((seed, number)), number)
            for seed, number in self.numbers
        )
        done = Generation(0, (Assignment({}, self.design.beds, self.design.discharges),), "", trials)
        strategy = Replicates.of(rule=rule, scatter=scatter, filling=filling)
        proposal = strategy.propose(History(None, (done,), (), 1))
        if proposal.state == "end":
            self.decision = proposal.decision
        for assigned in proposal.assignments:
            self.design = Design(assigned.replicates, assigned.discharges)

    def _numbers(self, number: Number) -> dict[str, float]:
        return {"flow_rate": self.rates[number]} if number in self.rates else {}


class Nested:
    """Repeats with several discharges of each bed, all of one scene and one lab."""

    def __init__(self, study: Study, lab: Lab, rule: StoppingRule, scatter: float, count: int, discharges: str):
        self.study, self.lab, self.rule, self.scatter = study, lab, rule, scatter
        self.auto = discharges == "auto"
        self._demand = PointDemand(study, study.points[0])
        self._backend = load_backend(lab.backend)
        first = Design(rule.first, 1 if self.auto else int(discharges))
        self.repeats = [Repeat(n * rule.cap, first) for n in range(count)]
        self._made_here, self._stepping = 0, 0.0

    def run(self) -> None:
        """Make all runs of all repeats, look by look."""
        done = set[Number]()
        while going := [one for one in self.repeats if one.decision is None]:
            new = [number for one in going for number in one.numbers if number not in done]
            print(f"{len(going)} repeats go on; {len(new)} runs", file=sys.stderr, flush=True)
            rates = self._made(new)
            done |= {*new}
            for one in going:
                one.rates |= {number: rates[number] for number in one.numbers if number in rates}
                one.look(self.rule, self.scatter, self._filling(one) if self.auto else None)

    def _made(self, numbers: Sequence[Number]) -> dict[Number, float]:
        """W of these runs, made now where they are missing."""
        runner = Runner(self.study, self.lab.lab_folder, self._backend, self.lab.device, SAVED, repeats={0: numbers})
        summary = runner.run()
        self._made_here += len(summary.tally.ran)
        self._stepping += summary.stepping
        if summary.stopped:
            raise SystemExit("stopped: the same command goes on from here")
        keys = {number: self._keys(number)[0] for number in numbers}
        with closing(Catalogue(self.lab.lab_folder)) as catalogue:
            rates = flow_rates(self.study, catalogue, list(keys.values()))
        return {number: rates[key] for number, key in keys.items() if key in rates}

    def _keys(self, number: Number) -> tuple[str, str]:
        """Keys of a run and of its packing."""
        keys = self._demand.run(*number).keys(self._backend.capabilities)
        return keys.run, keys.packing

    def _filling(self, repeat: Repeat) -> float:
        return filling_cost(self.lab.lab_folder, (self._keys(number) for number in repeat.numbers if number[1] == 1))

    @property
    def reported(self) -> list[Reported]:
        """What the repeats say; without those none of whose runs flowed."""
        ended = [(one.decision.pooled, one.design) for one in self.repeats if one.decision is not None]
        return [
            Reported(pooled.value, pooled.half_width, design.beds, design.discharges)
            for pooled, design in ended
            if pooled is not None
        ]

    @property
    def seconds(self) -> float | None:
        """Wall time of all beats [s] over the repeats; None if the lab had some of the runs before."""
        made = sum(len(one.numbers) for one in self.repeats)
        return self._stepping / len(self.repeats) if self._made_here == made else None

    @property
    def rates(self) -> dict[Number, float]:
        """W of all runs."""
        return {number: rate for one in self.repeats for number, rate in one.rates.items()}

    def cost(self) -> Cost:
        """What the runs took, by those of the first repeats."""
        keys = [self._keys(number) for one in self.repeats[:_SAMPLE] for number in one.numbers]
        return cost_of(self.lab, (key for key, _ in keys), (key for _, key in keys))


_SAMPLE = 20
"""Repeats whose records are read for the cost."""


def rates_of(study: Study, lab: Lab) -> list[float]:
    """W [kg/s] of every run of the only point of a study, run now where it is missing."""
    if lab.run(study, checkpoint_every=SAVED).stopped:
        raise SystemExit("stopped: the same command goes on from here")
    (point,) = lab.results(study).points
    rates = by_seed(point, "flow_rate")
    return [rates[seed] for seed in sorted(rates)]


def cost(study: Study, lab: Lab) -> Cost:
    """What the runs of a study took."""
    (point,) = lab.results(study, False).points
    return cost_of(lab, (run.run_key for run in point.runs), (run.packing_key for run in point.runs))


def cost_of(lab: Lab, run_keys: Iterable[str], packing_keys: Iterable[str]) -> Cost:
    """What runs and packings with these keys took."""
    runs = [RunRecord.read(lab.lab_folder.run(key)) for key in run_keys]
    beds = [PackingRecord.read(lab.lab_folder.packing(key)) for key in dict.fromkeys(packing_keys)]
    mean = [np.mean([sum(one.grain_steps for one in record.sessions) for record in kind]) for kind in (runs, beds)]
    return Cost(float(mean[0]), float(mean[1]), float(np.mean([one.wall_time for one in (*runs, *beds)])))


@dataclass(frozen=True)
class Plainly:
    """What the papers' way takes: grain-steps and wall time of beats [s] of one run with its filling; W [kg/s]."""

    grain_steps: float
    seconds: float
    flow_rate: Pooled


def as_in_papers(study: Study, lab: Lab, usual: float, beds: int) -> Plainly:
    """Make as many runs, each from its own bed of a rain, by the usual step and in double precision."""
    numerics = {"dt": f"{usual!r} s", "stiffness_scale": "1", "precision": "double"}
    plain = with_seeds(study.change({"fill.kind": "rain"}), beds, numerics)
    summary = Runner(plain, lab.lab_folder, load_backend(lab.backend), lab.device, SAVED).run()
    if summary.stopped:
        raise SystemExit("stopped: the same command goes on from here")
    return Plainly(summary.work_done / beds, summary.stepping / beds, pool(rates_of(plain, lab)))


def steps(choice: Choice) -> dict[str, dict[str, str]]:
    """Numerics as they were chosen, the finest, and the usual."""
    assert choice.usual is not None
    return {
        "chosen": {"dt": f"{choice.dt!r} s", "stiffness_scale": f"{choice.stiffness_scale!r}"},
        "finest": {"dt": f"{FINER * choice.usual!r} s", "stiffness_scale": "1"},
        "usual": {"dt": f"{choice.usual!r} s", "stiffness_scale": "1"},
    }


def with_seeds(study: Study, seeds: int, numerics: dict[str, str]) -> Study:
    """The study with that many runs by these numerics, and no requested error."""
    alone = {"accuracy": None, "discharges_per_bed": 1, "replicates": seeds}
    return study.change({**alone, **{f"numerics.{k}": v for k, v in numerics.items()}})


def without_step(rates: dict[float, list[float]]) -> tuple[float, float]:
    """W [kg/s] at dt = 0 and its standard error, from W + b dt^2 by the means at two or more steps [s]."""
    pooled = [pool(each) for each in rates.values()]
    weights = [1 / one.error for one in pooled]
    fit, covariance = np.polyfit(np.square(list(rates)), [one.value for one in pooled], 1, w=weights, cov="unscaled")
    return float(fit[1]), float(np.sqrt(covariance[1, 1]))


def main() -> None:
    """Run, count, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("study", type=Path)
    parser.add_argument("--lab", type=Path, required=True)
    parser.add_argument("--repeats", type=int, default=300)
    parser.add_argument("--finest", type=int, default=300)
    parser.add_argument("--usual", type=int, default=50)
    parser.add_argument("--plain", type=int, default=300, help="runs by the papers' way, beside --discharges-per-bed")
    parser.add_argument("--backend", default="numba")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--discharges-per-bed", metavar="N", help="several discharges of each bed: a number, or auto")
    parser.add_argument("--shard", metavar="I/N", help="only make this part of the runs")
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    lab = Lab(given.lab, given.backend, given.device)
    study = lab.pilot(load(given.study))
    (point,) = study.points
    choice = point.choice
    if choice is None or choice.usual is None:
        raise SystemExit(f"{given.study}: no numerics are chosen: {point.unchosen or 'it states them'}")
    rule = stopping_rule(study, point)
    by = steps(choice)
    foreseen = rule.forecast(choice.scatter)
    asked, seeds = given.repeats, min(MOST, math.ceil(1.2 * given.repeats * foreseen))
    nested = None
    if given.discharges_per_bed:
        if given.shard:
            raise SystemExit("--discharges-per-bed: all runs are made by one process; leave out --shard")
        one_bed = with_seeds(study, 1, by["chosen"])
        nested = Nested(one_bed, lab, rule, choice.scatter, asked, given.discharges_per_bed)
        nested.run()
    if given.shard:
        for name, many in (("chosen", seeds), ("finest", given.finest), ("usual", given.usual)):
            lab.run(with_seeds(study, many, by[name]), checkpoint_every=SAVED, shard=given.shard)
        return
    while nested is None:
        rates = {choice.dt: rates_of(with_seeds(study, seeds, by["chosen"]), lab)}
        if len(found := repeats(rates[choice.dt], rule)) >= asked or seeds >= MOST:
            break
        seeds = min(MOST, math.ceil(seeds * max(1.1, 1.1 * asked / max(len(found), 1))))
    if nested is not None:
        first = [rate for (_, number), rate in sorted(nested.rates.items()) if number == 1]
        rates, found = {choice.dt: first}, nested.reported
    found = found[:asked]
    finest = with_seeds(study, given.finest, by["finest"])
    usual = with_seeds(study, given.usual, by["usual"])
    rates |= {FINER * choice.usual: rates_of(finest, lab), choice.usual: rates_of(usual, lab)}
    truth, scatter = pool(rates[FINER * choice.usual]), pool(rates[choice.usual])
    limit, limit_error = without_step(rates)
    wide = [one.half_width + choice.bias.bound * one.value for one in found]

    def inside(reference: float) -> int:
        return sum(abs(one.value - reference) <= width for one, width in zip(found, wide, strict=True))

    mean_runs = float(np.mean([one.runs for one in found]))
    plain = StoppingRule(choice.tolerance, study.replicates, 10_000)
    needed = plain.forecast(scatter.error * math.sqrt(scatter.n) / scatter.value)
    told = {
        "study": study.name,
        "date": f"{datetime.now(UTC):%Y-%m-%d}",
        "hardware": hardware(),
        "backend": given.backend,
        "device": given.device,
        "choice": {k: v for k, v in asdict(choice).items() if k != "bias"} | {"bias": asdict(choice.bias)},
        "repeats": len(found),
        "inside": inside(truth.value),
        "inside_without_step": inside(limit),
        "mean_half_width": float(np.mean(wide)) / truth.value,
        "mean_runs": mean_runs,
        "foreseen_runs": foreseen,
        "finest": asdict(truth),
        "without_step": {"value": limit, "error": limit_error},
        "bias_found": float(np.mean([one.value for one in found])) / truth.value - 1,
        "cost": asdict(cost(with_seeds(study, seeds, by["chosen"]), lab) if nested is None else nested.cost()),
        "usual_cost": asdict(cost(usual, lab)),
        "usual_runs": needed,
    }
    work = float(np.mean([_work(told["cost"], one.runs, one.discharges) for one in found]))
    told["cost_ratio"] = work / _work(told["usual_cost"], needed)
    if nested is not None:
        told["nested"] = _nested(nested, told["cost"], work, choice, truth.value)
        plainly = as_in_papers(study, lab, choice.usual, given.plain)
        told["papers_way"] = _beside(plainly, plain, work, nested.seconds)
    print(json.dumps(told, indent=2))
    if given.out:
        given.out.parent.mkdir(parents=True, exist_ok=True)
        given.out.write_text(json.dumps(told, indent=2) + "\n", encoding="utf-8")


def _work(cost: Mapping[str, float], beds: float, discharges: float = 1) -> float:
    """Grain-steps of as many beds, each with its filling and as many discharges."""
    return beds * (discharges * cost["discharge"] + cost["filling"])


def _beside(plainly: Plainly, rule: StoppingRule, work: float, seconds: float | None) -> dict:
    """Cost of a number by the papers' way, of as many runs as the rule takes by their scatter, and of ours over it."""
    rate = plainly.flow_rate
    runs = rule.forecast(rate.error * math.sqrt(rate.n) / rate.value)
    return {
        "a_run": asdict(plainly),
        "runs": runs,
        "grain_steps": runs * plainly.grain_steps,
        "device_seconds": runs * plainly.seconds,
        "ours": {"grain_steps": work, "device_seconds": seconds},
        "grain_steps_over_it": work / (runs * plainly.grain_steps),
        "device_seconds_over_it": None if seconds is None else seconds / (runs * plainly.seconds),
    }


def _nested(nested: Nested, cost: Mapping[str, float], work: float, choice: Choice, truth: float) -> dict:
    """Designs of the repeats, the share of the bed in the variance of W over all of them, and what the same rule takes
    with a bed for every run, by the first discharges of the same beds."""
    beds = by_bed((seed, rate) for (seed, _), rate in sorted(nested.rates.items()))
    first = [values[0] for values in beds.values()]
    plain = repeats(first, nested.rule)
    inside = sum(abs(one.value - truth) <= one.half_width + choice.bias.bound * one.value for one in plain)
    alone = float(np.mean([_work(cost, one.runs) for one in plain])) if plain else math.nan
    several = {seed: values for seed, values in beds.items() if len(values) > 1 and (seed, 1) in nested.rates}
    kicked = [math.fsum(values[1:]) / (len(values) - 1) / values[0] - 1 for values in several.values()]
    return {
        "discharges": "auto" if nested.auto else nested.repeats[0].design.discharges,
        "mean_discharges": float(np.mean([one.design.discharges for one in nested.repeats])),
        "ended": {how: sum(one.decision is not None and one.decision.ended == how for one in nested.repeats)
                  for how in ("tolerance", "cap", "nothing")},
        "share_of_the_bed": asdict(shares(several)) if several else None,
        "kicked_over_first": asdict(pool(kicked)) if kicked else None,
        "grain_steps": work,
        "a_bed_for_every_run": {"repeats": len(plain), "inside": inside, "grain_steps": alone,
                                "mean_runs": float(np.mean([one.runs for one in plain])) if plain else math.nan},
        "over_a_bed_for_every_run": work / alone,
    }  # fmt: skip


if __name__ == "__main__":
    main()
