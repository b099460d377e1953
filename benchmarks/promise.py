"""Does the promise hold? A study asks for an error many times over, each time with seeds of its own.

    python benchmarks/promise.py STUDY --lab LAB [--repeats 300] [--finest 300] [--backend warp --device cuda:0]
    [--shard I/N] [--out FILE]

Every repeat follows the study's stopping rule with the numerics that were chosen, and reports W with the half width
that labbook prints: that of the interval, and the bound of the bias. Held against it is the finest answer: the mean
of `--finest` runs with the stated stiffness and a quarter of the law's usual step. Its own error is common to all
repeats. So they are held as well against W without any step: W + b dt^2 is fitted to the runs of all steps. A scene
that was not calibrated gets its pilot first. Runs that are there are not run again; with --shard only a part of them
is made, so that several processes may share them. What the same error costs with the usual numerics is worked out from
runs with these. Seeds are taken in their order, so that no run enters two repeats.
"""

import argparse
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from labbook import Lab, Study
from labbook.accuracy import Choice
from labbook.backend.machine import hardware
from labbook.lab.packings import PackingRecord
from labbook.lab.records import RunRecord
from labbook.plan.demand import stopping_rule
from labbook.results.points import by_seed
from labbook.stats import StoppingRule, pool
from labbook.study import load

FINER = 0.25
"""Step of the finest answer, in parts of the law's usual one."""
MOST = 10_000
"""Runs of one point that a study may ask for."""
SAVED = 600.0
"""Seconds between two checkpoints: a run takes a few, and hundreds that go on at once would be saved all the time."""


@dataclass(frozen=True)
class Reported:
    """What one repeat says: W with the half width of its interval, from `runs` runs."""

    value: float
    half_width: float
    runs: int


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
        while (decision := rule.decide(rates[at : at + n])).more:
            n += decision.more
            if at + n > len(rates):
                return found
        assert decision.pooled is not None
        found.append(Reported(decision.pooled.value, decision.pooled.half_width, n))
        at += n
    return found


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
    runs = [RunRecord.read(lab.place.run(run.run_key)) for run in point.runs]
    beds = [PackingRecord.read(lab.place.packing(key)) for key in {run.packing_key for run in point.runs}]
    mean = [np.mean([sum(one.grain_steps for one in record.sessions) for record in kind]) for kind in (runs, beds)]
    return Cost(float(mean[0]), float(mean[1]), float(np.mean([one.wall_time for one in (*runs, *beds)])))


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
    return study.change({"accuracy": None, "replicates": seeds, **{f"numerics.{k}": v for k, v in numerics.items()}})


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
    parser.add_argument("--backend", default="numba")
    parser.add_argument("--device", default="cpu")
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
    if given.shard:
        for name, many in (("chosen", seeds), ("finest", given.finest), ("usual", given.usual)):
            lab.run(with_seeds(study, many, by[name]), checkpoint_every=SAVED, shard=given.shard)
        return
    while True:
        rates = {choice.dt: rates_of(with_seeds(study, seeds, by["chosen"]), lab)}
        if len(found := repeats(rates[choice.dt], rule)) >= asked or seeds >= MOST:
            break
        seeds = min(MOST, math.ceil(seeds * max(1.1, 1.1 * asked / max(len(found), 1))))
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
        "cost": asdict(cost(with_seeds(study, seeds, by["chosen"]), lab)),
        "usual_cost": asdict(cost(usual, lab)),
        "usual_runs": needed,
    }
    told["cost_ratio"] = _work(told["cost"], mean_runs) / _work(told["usual_cost"], needed)
    print(json.dumps(told, indent=2))
    if given.out:
        given.out.parent.mkdir(parents=True, exist_ok=True)
        given.out.write_text(json.dumps(told, indent=2) + "\n", encoding="utf-8")


def _work(cost: dict, runs: float) -> float:
    """Grain-steps of as many runs, each with a filling of its own."""
    return runs * (cost["discharge"] + cost["filling"])


if __name__ == "__main__":
    main()
