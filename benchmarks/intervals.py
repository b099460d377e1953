"""Coverage of the intervals that labbook prints, in simulation: a row for each interval and case.

    python benchmarks/intervals.py [--scale 1] [--out benchmarks/results/2026-11-27-coverage.json]
    python benchmarks/intervals.py --table benchmarks/results/2026-11-27-coverage.json

Each case draws data whose truth is known by construction, gives them to the estimator that reports use, and counts how
often its interval holds the truth. Data are normal unless a case states otherwise: a bed adds `mean * scatter * z`.
`--scale` multiplies the number of draws. The second command prints the table of docs/accuracy.md. With the default it
takes five minutes on one core.
"""

import argparse
import csv
import json
import math
import re
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from scipy import signal

from labbook.accuracy.regression import Observation, regress
from labbook.fit import LAWS, Context, FitResult, fit
from labbook.measure.steady import steady_flow
from labbook.papers.fan2023.laws import TERMS, fit_approach
from labbook.papers.pongo2022.rotation import ROTATION, Rotation
from labbook.results.points import FLOW_RATE
from labbook.stats import Pooled, StoppingRule, pool
from labbook.stats.bootstrap import bootstrap_all
from labbook.stats.effects import predict_effect
from labbook.stats.equivalence import tost
from labbook.stats.nested import by_bed, of_beds
from labbook.stats.pooling import student
from labbook.stats.ratio import independent_ratio, paired_ratio
from labbook.stats.stopping import FEWEST, looks
from labbook.stats.trend import trend

SILO = Context(d=3e-3, rho_p=2500, rho_b=1425.0, Z=3.03e-3, g=9.81)
EIGHT = np.array([18, 21, 24, 30, 36, 45, 52.5, 60]) * 1e-3
FOUR = EIGHT[[0, 3, 5, 7]]
SCATTER = 0.02
"""Between beds, of W."""
RESULTS = Path(__file__).parent / "results"
STORED = {
    "2026-11-23-promise-runs-h200.csv": 10.682,
    "2026-11-24-promise-flat-runs-h200.csv": 18.6943,
    "2026-11-24-promise-inclined-pilot-runs-h200.csv": 6.0418,
    "2026-11-24-promise-inclined-runs-h200.csv": 14.0975,
}
"""Runs of `benchmarks/promise.py`, and the step [us] of which there are thousands."""
TRUE = {
    "beverloo": (np.array([math.log(0.58), 1.55]), {"k": 1.55, "C_particle": 0.58}),
    "exponential": (np.array([-1.0, 0.25]), {"kappa": 0.25 / SILO.d}),
    "power": (np.array([-2.0, 1.8]), {"n": 1.8}),
    "janda": (np.array([0.0, 0.5, math.log(6.0)]), {"alpha1": 0.5, "alpha2_over_d": 6.0}),
}


@dataclass(frozen=True)
class Case:
    """How many of `draws` intervals at `nominal` confidence hold the truth; `runs`: their mean number if it varies."""

    interval: str
    case: str
    nominal: float
    coverage: float
    draws: int
    runs: float | None = None

    @property
    def error(self) -> float:
        """Standard error of the coverage."""
        return math.sqrt(max(self.coverage * (1 - self.coverage), 0.25 / self.draws) / self.draws)


def holds(interval: Pooled, truth: float) -> bool:
    """Decide whether an interval holds the truth."""
    return interval.low <= truth <= interval.high


def counted(interval: str, case: str, draws: int, draw: Callable[[], bool], nominal: float = 0.95) -> Case:
    """Repeat a draw that tells if its interval holds the truth."""
    return Case(interval, case, nominal, sum(draw() for _ in range(draws)) / draws, draws)


def means(rng: np.random.Generator, scale: float) -> Iterator[Case]:
    """Means over beds: of normal and of skewed numbers, with several discharges of each bed."""
    draws = round(6000 * scale)
    for n in (2, 3, 5, 8):
        yield counted("mean, Student", f"{n} replicates", draws, lambda n=n: holds(pool(rng.standard_normal(n)), 0))
        yield counted(
            "mean, Student", f"{n} replicates, skewness 0.71", draws,
            lambda n=n: holds(pool((rng.gamma(8, size=n) - 8) / math.sqrt(8)), 0),
        )  # fmt: skip

    def nested(beds: int, discharges: int, share: float) -> bool:
        of_bed, flow = rng.standard_normal(beds), rng.standard_normal((beds, discharges))
        values = math.sqrt(share) * of_bed[:, None] + math.sqrt(1 - share) * flow
        runs = [(bed, float(value)) for bed in range(beds) for value in values[bed]]
        return holds(pool(of_beds(by_bed(runs))), 0)

    for share in (0.0, 0.15, 0.5):
        for beds, discharges in ((3, 2), (5, 3)):
            case = f"{beds} beds of {discharges} discharges, {share:.0%} of the variance of the bed"
            yield counted("mean of nested beds", case, draws, partial(nested, beds, discharges, share))


@dataclass(frozen=True)
class FirstLook(StoppingRule):
    """The stopping rule with another first look."""

    look: int = FEWEST

    @property
    def first(self) -> int:
        """Replicates before the first look."""
        return min(self.look, self.cap)


def sequential(rng: np.random.Generator, scale: float) -> Iterator[Case]:
    """`accuracy.flow_rate`, by the tolerance in standard deviations of a run, and by the first look."""
    draws = round(2000 * scale)
    for tolerance, cap in ((0.2, 200), (0.5, 100), (0.8, 100), (1.2, 100), (2.0, 100), (3.5, 100), (0.5, 12)):
        for look in (3, FEWEST, 10):
            rule, runs, hits = FirstLook(0.01 * tolerance, 2, cap, look=look), 0, 0
            for _ in range(draws):
                values = 1 + 0.01 * rng.standard_normal(cap)
                n, decision = 0, rule.decide([])
                while decision.additional:
                    n += decision.additional
                    decision = rule.decide(values[:n])
                assert decision.pooled is not None
                hits, runs = hits + holds(decision.pooled, 1), runs + n
            case = f"tolerance {tolerance:g} standard deviations, at most {cap} runs"
            name = "sequential rule" if look == FEWEST else f"sequential rule with a first look at {look}"
            yield Case(name, case, 0.95, hits / draws, draws, runs / draws)


def fitted(rng: np.random.Generator, law: str, D: np.ndarray, misfit: float, replicates: int) -> FitResult:
    """Fit a law to points that lie off it by `misfit` times the error of their replicates."""
    W = LAWS[law].flow(D, TRUE[law][0], SILO) * np.exp(misfit * SCATTER / math.sqrt(3) * rng.standard_normal(len(D)))
    runs = W * (1 + SCATTER * rng.standard_normal((replicates, len(D))))
    errors = runs.std(axis=0, ddof=1) / math.sqrt(replicates)
    return fit(LAWS[law], D, runs.mean(axis=0), errors, SILO, [replicates] * len(D))


def fits(rng: np.random.Generator, scale: float) -> Iterator[Case]:
    """Parameters, joint regions and bands of fitted laws, with and without misfit."""
    for law, most in (("beverloo", 300), ("exponential", 800), ("power", 800)):
        draws = round(most * scale)
        for D in (FOUR, EIGHT):
            for misfit in (0, 1, 2, 4, 8):
                some = [fitted(rng, law, D, misfit, 3) for _ in range(draws)]
                case = f"{len(D)} outlets, misfit {misfit} times the error"
                for name, truth in TRUE[law][1].items():
                    inside = [one.parameters[name].low <= truth <= one.parameters[name].high for one in some]
                    yield Case(f"{name} of {law}", case, 0.95, float(np.mean(inside)), draws)
                if law == "beverloo":
                    together = [one.together(TRUE[law][1]) > 0.05 for one in some]
                    yield Case("joint region of C and k", case, 0.95, float(np.mean(together)), draws)
                    yield from bands(rng, some, case, misfit)
    draws = round(200 * scale)
    some = [fitted(rng, "janda", EIGHT, 0, 5) for _ in range(draws)]
    for name, truth in TRUE["janda"][1].items():
        inside = [one.parameters[name].low <= truth <= one.parameters[name].high for one in some]
        yield Case(f"{name} of janda", "8 outlets, 5 replicates, no misfit", 0.95, float(np.mean(inside)), draws)


def bands(rng: np.random.Generator, some: list[FitResult], case: str, misfit: float) -> Iterator[Case]:
    """The band of a law, and that of one more point: of three more seeds, as far off the law as the others."""
    at = np.array([33e-3])
    truth = float(LAWS["beverloo"].flow(at, TRUE["beverloo"][0], SILO)[0])
    law, point = [], []
    for one in some:
        _, low, high = one.band(at)
        law.append(low[0] <= truth <= high[0])
        _, low, high = one.band(at, new_point=True)
        off = math.exp(misfit * SCATTER / math.sqrt(3) * rng.standard_normal())
        fresh = truth * off * (1 + SCATTER * rng.standard_normal(3)).mean()
        point.append(low[0] <= fresh <= high[0])
    yield Case("band of Beverloo's law", case, 0.95, float(np.mean(law)), len(some))
    yield Case("band of one more point", case, 0.95, float(np.mean(point)), len(some))


def ratios(rng: np.random.Generator, scale: float) -> Iterator[Case]:
    """Ratios of two points: of seeds that they share, and of independent runs."""
    draws = round(6000 * scale)

    def paired(n: int, common: float, confidence: float) -> bool:
        seeds = math.sqrt(common) * rng.standard_normal(n)
        above, below = (m * (1 + 0.05 * (seeds + math.sqrt(1 - common) * rng.standard_normal(n))) for m in (0.8, 1.0))
        return holds(paired_ratio(above, below, confidence), 0.8)

    def independent(n: int, m: int) -> bool:
        above, below = pool(0.8 * (1 + 0.05 * rng.standard_normal(n))), pool(1 + 0.02 * rng.standard_normal(m))
        return holds(independent_ratio(above, below), 0.8)

    for n in (3, 5, 10):
        for common in (0.0, 0.5):
            case = f"{n} pairs, {common:.0%} of the variance shared"
            yield counted("ratio of pairs", case, draws, partial(paired, n, common, 0.95))
        yield counted("ratio of pairs, 90 %", f"{n} pairs, 50% of the variance shared", draws,
                      partial(paired, n, 0.5, 0.9), 0.9)  # fmt: skip
        yield counted("ratio of independent means", f"{n} and 3 runs of unequal scatter", draws,
                      partial(independent, n, 3))  # fmt: skip


def equivalence(rng: np.random.Generator, scale: float) -> Iterator[Case]:
    """The 90 % interval of a difference, and false findings of equivalence at a difference of the margin."""
    draws = round(3000 * scale)
    for n in (3, 6, 12):
        inside, wrong = 0, 0
        for _ in range(draws):
            test = tost(rng.standard_normal(n), 1.0 + rng.standard_normal(n), 1.0)
            inside, wrong = inside + (test.low <= 1.0 <= test.high), wrong + test.equivalent
        yield Case("difference of two settings, 90 %", f"{n} runs of each", 0.9, inside / draws, draws)
        yield Case(
            "no false equivalence", f"{n} runs of each, difference at the margin", 0.95, 1 - wrong / draws, draws
        )


def effects(rng: np.random.Generator, scale: float) -> Iterator[Case]:
    """Bias of numerics: in a scene that was calibrated, and in one more."""
    draws = round(1000 * scale)
    for scenes in (3, 4, 5, 8, 21):
        for spread in (0.0, 0.5, 1.0, 3.0, 10.0):

            def one(scenes: int = scenes, spread: float = spread) -> bool:
                errors = rng.uniform(0.7, 1.4, scenes)
                measured = rng.normal(0, spread, scenes) + rng.normal(0, errors)
                value, half = predict_effect(measured.tolist(), (errors**2).tolist())
                return abs(rng.normal(0, spread) - value) < half

            case = f"{scenes} scenes that scatter by {spread:g} times their errors"
            yield counted("bias of an uncalibrated scene", case, draws, one)

    def own(curvature: float) -> bool:
        runs = []
        for bed in range(15):
            level = rng.normal(0, 0.017)
            for overlap, step in ((0.001, 0.02), (0.001, 0.06), (0.003, 0.04), (0.006, 0.06), (0.013, 0.06)):
                rate = math.exp(level + 2.0 * overlap + curvature * overlap**2 + rng.normal(0, 0.01))
                runs.append(Observation(str(bed), 0.001, overlap, step, rate))
        slopes = regress(runs, curved=curvature != 0)
        half = student(0.95, slopes.freedom) * math.sqrt(slopes.covariance[0, 0])
        return bool(abs(slopes.values[0] - 2.0) < half)

    for curvature in (0.0, -400.0):
        case = "15 beds of 5 settings" + (", ln W not linear in the overlap" if curvature else "")
        yield counted("slope of ln W of a calibrated scene", case, round(400 * scale), partial(own, curvature))


def bootstraps(rng: np.random.Generator, scale: float) -> Iterator[Case]:
    """The hierarchical bootstrap behind profiles: the exponent of a power law, unweighted, from all seeds."""
    draws = round(150 * scale)
    for outlets in (4, 8):
        for n in (3, 5):
            log_D = np.log(np.linspace(6, 20, outlets))

            def exponent(points: list[list[float]], log_D: np.ndarray = log_D) -> tuple[float]:
                return (float(np.polyfit(log_D, np.log([np.mean(p) for p in points]), 1)[0]),)

            def one(n: int = n, log_D: np.ndarray = log_D, exponent: Callable = exponent) -> bool:
                W = np.exp(1.5 * log_D)[:, None] * (1 + 0.03 * rng.standard_normal((len(log_D), n)))
                (found,) = bootstrap_all(W.tolist(), exponent, draws=200, seed=int(rng.integers(1 << 30)))
                return holds(found, 1.5)

            yield counted("bootstrap over seeds", f"{outlets} outlets of {n} seeds", draws, one)


def approaches(rng: np.random.Generator, scale: float) -> Iterator[Case]:
    """limit - depth exp(-rate s*) of Fan et al.'s outlets beside a wall; an interval without ends holds anything."""
    draws, s = round(600 * scale), np.linspace(0, 0.9, 8)
    truth = dict(zip(TERMS, (0.39, 0.12, 3.74), strict=True))
    hits = dict.fromkeys(TERMS, 0)
    for _ in range(draws):
        y = truth["limit"] - truth["depth"] * np.exp(-truth["rate"] * s) + 0.006 * rng.standard_normal(len(s))
        parameters = fit_approach(s.tolist(), y.tolist()).parameters
        for name in TERMS:
            low, high = parameters[name].low, parameters[name].high
            hits[name] += not math.isfinite(high - low) or low <= truth[name] <= high
    for name in TERMS:
        yield Case(f"{name} of an approach", "8 distances from the wall", 0.95, hits[name] / draws, draws)


@dataclass(frozen=True)
class Window:
    """A window by parts of the discharged mass."""

    start: float = 0.15
    end: float = 0.6
    timed: bool = False


def crossings(rng: np.random.Generator, kind: str, n: int) -> np.ndarray:
    """Times of n grains at a rate of 1: regular with jitter, or of a rate with a memory of ten grains."""
    if kind == "regular":
        return np.sort(np.arange(n) + 0.5 * rng.standard_normal(n)) + 3
    waits = rng.exponential(1, n)
    if kind == "with a memory":
        surge = np.asarray(signal.lfilter([1], [1, -0.9], rng.standard_normal(n + 100) * math.sqrt(0.19)))[100:]
        waits = waits * np.exp(0.2 * surge)
    return waits.cumsum()


def slowest(rng: np.random.Generator, scale: float) -> Iterator[Case]:
    """The frequency at which the flow over a rotating bottom is smallest, by means over seeds."""
    frequencies, truth, draws = (0.0, 0.16, 0.32, 0.64, 1.28), (1.0, 0.8, 0.7, 0.78, 0.9), round(300 * scale)

    def one(n: int, scatter: float) -> bool:
        seeds = 0.5 * scatter * rng.standard_normal(n)
        points = []
        for f, mean in zip(frequencies, truth, strict=True):
            values = mean * (1 + seeds + scatter * rng.standard_normal(n))
            runs = [
                SimpleNamespace(seed=s, counted=True, measured={FLOW_RATE: SimpleNamespace(value=float(value))})
                for s, value in enumerate(values)
            ]
            points.append(SimpleNamespace(at={ROTATION: f}, runs=runs, pooled={FLOW_RATE: pool(values)}))
        found = Rotation(tuple(points)).minimum(FLOW_RATE)
        return found is not None and found.low <= 0.32 <= found.high

    for n in (3, 6):
        for scatter in (0.03, 0.1):
            yield counted("frequency of the minimum, 90 %", f"{n} seeds that scatter by {scatter:.0%}", draws,
                          partial(one, n, scatter), 0.9)  # fmt: skip


def series(rng: np.random.Generator, scale: float) -> Iterator[Case]:
    """The drift of a run, steady runs that are not called trending, and the mean of one long run of a fed silo."""
    draws = round(1500 * scale)
    for kind in ("regular", "random", "with a memory"):
        flows = [steady_flow(crossings(rng, kind, 2000), 2000, Window()) for _ in range(draws)]
        tests = [flow.trend for flow in flows if flow is not None]
        plain = [one.p >= 0.01 for one in tests]
        yield Case("steady runs with p of the trend test above 0.01", kind, 0.99, float(np.mean(plain)), len(plain))
    for drift in (0.0, 0.1):
        for n in (3, 5):

            def one(n: int = n, drift: float = drift) -> bool:
                x = (np.arange(12) + 0.5) / 12 - 0.5
                drifts = [trend(1 + drift * x + 0.04 * rng.standard_normal(12)).drift for _ in range(n)]
                return holds(pool(drifts), drift)

            yield counted("drift of W", f"{n} replicates, drift {drift:.0%}", draws, one)


def fed(rng: np.random.Generator, scale: float) -> Iterator[Case]:
    """One long run of a fed silo, stopped at the look at which its own interval was narrow enough."""
    draws, most = round(400 * scale), 20_000
    for kind in ("regular", "random", "with a memory"):
        hits, truth = 0, 1.0 if kind != "with a memory" else 1 / math.exp(0.02)
        for _ in range(draws):
            times, n = crossings(rng, kind, most), 1200
            seen = 0
            while True:
                flow = steady_flow(times[:n], n, Window(0.0, 1.0))
                assert flow is not None
                if n == most or (looks(n) > seen and flow.precision <= 0.03):
                    break
                seen, n = looks(n), min(most, int(1.5 * n) + 1)
            hits += abs(flow.rate - truth) <= flow.precision * flow.rate
        yield Case("one run of a fed silo, 3 %", kind, 0.95, hits / draws, draws)


def stored(rng: np.random.Generator, scale: float) -> Iterator[Case]:
    """`accuracy.flow_rate` to 1 % by the runs of two hoppers, each used once an order; the truth is the mean of
    all runs of a hopper and step."""
    orders = math.ceil(20 * scale)
    for file, dt in STORED.items():
        with (RESULTS / file).open(encoding="utf-8") as lines:
            rates = np.array([float(row["W_g_per_s"]) for row in csv.DictReader(lines) if float(row["dt_us"]) == dt])
        for look in (3, FEWEST, 10):
            rule, hits, runs, answers = FirstLook(0.01, 2, 400, look=look), 0, 0, 0
            for _ in range(orders):
                shuffled, at = rng.permutation(rates), 0
                while at + 400 <= len(shuffled):
                    n, decision = 0, rule.decide([])
                    while decision.additional:
                        n += decision.additional
                        decision = rule.decide(shuffled[at : at + n])
                    assert decision.pooled is not None
                    hits += holds(decision.pooled, float(rates.mean()))
                    runs, answers, at = runs + n, answers + 1, at + n
            name = "sequential rule on stored runs"
            name += "" if look == FEWEST else f" with a first look at {look}"
            yield Case(name, f"{len(rates)} runs of {file}", 0.95, hits / answers, answers, runs / answers)


GROUPS = (means, sequential, fits, ratios, equivalence, effects, bootstraps, approaches, slowest, series, fed, stored)


def simulated(scale: float, names: list[str]) -> list[Case]:
    """All cases, or those of groups by their names; each group has its own random numbers."""
    found = []
    for number, group in enumerate(GROUPS):
        if names and group.__name__ not in names:
            continue
        start = time.perf_counter()
        found += group(np.random.default_rng([20261127, number]), scale)
        print(f"{group.__name__}: {time.perf_counter() - start:.0f} s", flush=True)
    return found


def table(found: list[Case]) -> str:
    """The table of docs/accuracy.md: a row for each interval, with its smallest and largest coverage over the cases."""
    lines = ["| interval | cases | nominal | coverage | lowest at |", "|---|---|---|---|---|"]
    for name in dict.fromkeys(one.interval for one in found):
        of = [one for one in found if one.interval == name]
        least, most = min(of, key=lambda one: one.coverage), max(of, key=lambda one: one.coverage)
        span = f"{least.coverage:.1%} to {most.coverage:.1%}" if len(of) > 1 else f"{least.coverage:.1%}"
        error = f" ± {max(one.error for one in of):.1%}"
        lines.append(f"| {name} | {len(of)} | {least.nominal:.0%} | {span}{error} | {least.case} |")
    return re.sub(r"(?<=\d)%", " %", "\n".join(lines))


def main() -> None:
    """Simulate, or print the table of a file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scale", type=float, default=1.0, help="factor on the number of draws")
    parser.add_argument("--out", type=Path, help="JSON to write")
    parser.add_argument("--table", type=Path, help="JSON to print as a table, without simulating")
    parser.add_argument("--groups", nargs="*", default=[], help="only these groups; other rows of --out stay")
    given = parser.parse_args()
    if given.table:
        print(table([Case(**row) for row in json.loads(given.table.read_text(encoding="utf-8"))["cases"]]))
        return
    found = simulated(given.scale, given.groups)
    print(table(found))
    if given.out:
        if given.groups and given.out.is_file():
            before = [Case(**row) for row in json.loads(given.out.read_text(encoding="utf-8"))["cases"]]
            names = {one.interval for one in found}
            found = [*(one for one in before if one.interval not in names), *found]
        rows = [asdict(one) for one in found]
        given.out.write_text(json.dumps({"scale": given.scale, "cases": rows}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
