"""Promises of `labbook calibrate` and of the goal `map`, in simulation: how often they are kept, and what they cost.

    python benchmarks/learning.py coverage --repeats 200
    python benchmarks/learning.py stops --repeats 200
    python benchmarks/learning.py map --repeats 200
    python benchmarks/learning.py twins --repeats 12 --lab twins --backend warp --device cuda:0 --at-once 4

`coverage`: parameters are drawn from their priors, measured values from the law, and a whole campaign follows with runs
of its own and an emulator of its own. The figures are how often 95 % regions and intervals hold the parameters,
standard deviations over those of an emulator without error, which no grid has, and ranks of the parameters among 99
draws of the posterior (Talts et al., arXiv:1804.06788). `stops`: the same, with a
tenth of the runs clogged or diverged at random. `map`: a key of friction, one of an angle, and the outlet.
`twins`: the measured values are means of runs with a friction drawn from the prior. All twins share one lab, and so the
first runs of their calibrations.
"""

import argparse
import math
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from types import SimpleNamespace
from typing import Any

import numpy as np

from labbook.campaign import Campaign, Generation, Map, Trial
from labbook.campaign.calibrate import Calibrate, Prior
from labbook.campaign.inference import Inference, Measurement
from labbook.campaign.space import sobol

SCATTER = 0.022
MEASURED = 0.02
OUTLETS = (0.018, 0.03, 0.045)
FRICTION, ROLLING = "contact.friction", "contact.rolling_friction"
ANGLE, OUTLET = "container.angle", "container.orifice"
d = 3e-3


def flow(friction, rolling, D):
    """Flow rate [kg/s], with C and k that depend on two frictions."""
    C = 0.5 + 0.2 * np.exp(-friction / 0.25) + 0.05 * np.exp(-rolling / 0.02)
    k = 1.3 + 0.5 * friction / (friction + 0.3) + 3 * rolling
    return C * 1500 * math.sqrt(9.81) * d * (D - k * d) ** 1.5


def fraction(friction, rolling):
    """Packing fraction."""
    return 0.64 - 0.05 * friction / (friction + 0.2) - 0.35 * rolling


class SyntheticStudy:
    """A study without a lab, whose runs are draws from a law. `stops`: part of the runs without a number."""

    def __init__(self, law, seed, stops=0.0):
        container: Any = SimpleNamespace(outlet_form="slot")
        scene = SimpleNamespace(container=container, grains=SimpleNamespace(equivalent_diameter=d))
        self.study = SimpleNamespace(
            points=[SimpleNamespace(at={}, scene=scene)],
            units={OUTLET: "m"},
            discharges_per_bed=1,
            accuracy=SimpleNamespace(max_replicates=100),
        )
        self.law, self.stops, self.rng = law, stops, np.random.default_rng(seed)
        self.runs = {}

    def run(self, at, seed):
        key = (*sorted(at.items()), seed)
        if key not in self.runs:
            number = f"{len(self.runs):05d}"
            numbers = {
                name: value * math.exp(scatter * self.rng.normal()) for name, (value, scatter) in self.law(at).items()
            }
            outcome = "finished"
            if self.rng.random() < self.stops:
                outcome, numbers = ("clogged", {name: 0.7 * value for name, value in numbers.items()}) if (
                    self.rng.random() < 0.5) else ("diverged", {})  # fmt: skip
            self.runs[key] = Trial(at, seed, number, outcome, numbers)
        return self.runs[key]

    def evaluate(self, generation: Generation):
        return tuple(
            self.run(setting.at, seed)
            for setting in generation.assignments
            for seed in range(1, setting.replicates + 1)
        )

    def campaign(self, goal) -> Campaign:
        campaign = Campaign(goal, self.study)
        campaign.advance(self.evaluate)
        return campaign

    @property
    def trials(self):
        return list(self.runs.values())


PRIORS = {FRICTION: Prior(low=0.1, high=0.9), ROLLING: Prior(low=0.001, high=0.1, logarithmic=True)}


def flow_and_fraction(at):
    """Flow rate and packing fraction with their scatter."""
    mu, rolling = at[FRICTION], at[ROLLING]
    return {"flow_rate": (flow(mu, rolling, at[OUTLET]), SCATTER), "packing_fraction": (fraction(mu, rolling), 0.004)}


def draw_measurements(truth, rng, error=MEASURED, discrepancy=0.0) -> tuple[Measurement, ...]:
    """Measured values of `flow_and_fraction` at all outlets, and the packing fraction at the last."""
    values = []
    for D in OUTLETS:
        value = flow(truth[0], truth[1], D) * math.exp(math.hypot(error, discrepancy) * rng.normal())
        values.append(Measurement(quantity="flow_rate", at={OUTLET: D}, value=value, error=error * value))
    value = fraction(truth[0], truth[1]) * math.exp(math.hypot(0.005, discrepancy) * rng.normal())
    return (*values, Measurement(quantity="packing_fraction", at={OUTLET: D}, value=value, error=0.005 * value))


def coverage(repeats: int, stops: float = 0.0, discrepancy: float = 0.0) -> dict[str, float]:
    """Calibrate to `repeats` drawn truths, and count how often regions and intervals hold them."""
    rng = np.random.default_rng(3)
    in_region, in_intervals, runs, complete, ranks, promises, shares, widths = [], [], [], [], [], [], [], []
    for number in range(repeats):
        u = rng.uniform(size=2)
        goal = Calibrate(parameters=PRIORS, measurements=(), discrepancy=discrepancy, accuracy={})
        truth = [float(axis.value(x)) for axis, x in zip(goal.axes, u, strict=True)]
        goal = goal.model_copy(update={"measurements": draw_measurements(truth, rng, discrepancy=discrepancy)})
        synthetic = SyntheticStudy(flow_and_fraction, [number, 5], stops)
        campaign = synthetic.campaign(goal)
        inference: Inference = goal.infer(synthetic.study, synthetic.trials)
        posterior = inference.posterior
        density = math.exp(float(inference.log_likelihood(u[None])[0]) - inference._largest)
        in_region.append(density >= posterior.threshold(0.95))
        low, high = posterior.quantiles(np.array([0.025, 0.975]))
        in_intervals.append((low <= u) & (u <= high))
        draws = posterior.samples(99, rng)
        likelihoods = inference.log_likelihood(np.vstack([u, draws]))
        ranks.append([*(draws < u).sum(axis=0), int((likelihoods[1:] < likelihoods[0]).sum())])
        runs.append(len(synthetic.trials))
        shares.append(inference.share)
        widths.append(np.sqrt(np.diag(posterior.covariance) / np.diag(inference.exact.covariance)))
        promises.append("Promise kept" in (campaign.ended or ""))
        complete.append(not inference.lacking())
        if number % 20 == 19:
            print(f"{number + 1}: region {np.mean(in_region):.3f}, runs {np.mean(runs):.0f}", flush=True)
    from scipy.stats import chi2

    figures = {"repeats": repeats, "region": np.mean(in_region), "runs": np.mean(runs), "most runs": np.max(runs),
               "share": np.mean(shares), "answers": np.mean(complete), "promise kept": np.mean(promises)}  # fmt: skip
    for index, name in enumerate((FRICTION, ROLLING)):
        figures[f"interval of {name}"] = np.mean([inside[index] for inside in in_intervals])
        figures[f"sd of {name} over that of an exact emulator"] = np.mean([width[index] for width in widths])
    for index, name in enumerate((FRICTION, ROLLING, "log-likelihood")):
        counts = np.histogram([rank[index] for rank in ranks], bins=20, range=(-0.5, 99.5))[0]
        expected = repeats / 20
        figures[f"p of ranks, {name}"] = chi2.sf(((counts - expected) ** 2 / expected).sum(), 19)
    return {name: float(value) for name, value in figures.items()}


KEYS = (FRICTION, ANGLE, OUTLET)
RANGES = {FRICTION: (0.1, 0.9), ANGLE: (15.0, 90.0), OUTLET: (0.018, 0.06)}


def hopper(at):
    """Flow rate from a hopper of an angle [deg] with its scatter."""
    mu, angle, D = (at[key] for key in KEYS)
    C = (0.52 + 0.2 * math.exp(-mu / 0.22)) * (1 + 0.28 * math.exp(-(angle - 15) / 18))
    k = 1.5 + 0.5 * mu / (mu + 0.3)
    return {"flow_rate": (C * 1500 * math.sqrt(9.81) * d * (D - k * d) ** 1.5, SCATTER)}


def maps(repeats: int, error: float = 0.02) -> dict[str, float]:
    """Map a flow rate over three keys `repeats` times. A promise is kept if the map is off by no more than the error on
    95 % of 1024 settings all over the range."""
    within_error, passed, runs, shares = [], [], [], []
    goal = Map(quantity="flow_rate", error=error, over=KEYS, on=0.95)
    for number in range(repeats):
        synthetic = SyntheticStudy(hopper, [number, 8])
        scene = synthetic.study.points[0].scene
        ends = zip(*(RANGES[key] for key in KEYS), strict=True)
        synthetic.study.points = [SimpleNamespace(at=dict(zip(KEYS, end, strict=True)), scene=scene) for end in ends]
        campaign = synthetic.campaign(goal)
        test_count = len(campaign.generations[-1].assignments)
        emulator, _, trend = goal.emulator(synthetic.study, synthetic.trials[:-test_count])
        units = sobol(1024, 3, stream=11)
        truth = []
        for u in units:
            at = {axis.key: float(axis.value(x)) for axis, x in zip(goal.axes(synthetic.study), u, strict=True)}
            truth.append(math.log(hopper(at)["flow_rate"][0]) - trend.at(at))
        off = np.abs(np.expm1(emulator.at(units)[0] - truth))
        shares.append(float(np.mean(off <= error)))
        within_error.append(shares[-1] >= 0.95)
        passed.append("Promise kept" in (campaign.ended or ""))
        runs.append(len(synthetic.trials))
        if number % 20 == 19:
            print(f"{number + 1}: kept {np.sum(within_error)}, runs {np.mean(runs):.0f}", flush=True)
    figures = {"repeats": repeats, "kept": np.sum(within_error), "test passed": np.sum(passed), "runs": np.mean(runs),
               "most runs": np.max(runs), "share within the error": np.mean(shares)}  # fmt: skip
    return {name: float(value) for name, value in figures.items()}


TWIN: dict[str, Any] = {
    "about": "A twin: runs with a friction drawn from the prior stand for an experiment",
    "grains": {"shape": "sphere", "diameter": "3 mm", "density": "2500 kg/m^3", "count": 400},
    "contact": {"law": "hertz-mindlin", "shear_modulus": "2 MPa", "poisson_ratio": 0.25, "friction": 0.5,
                "restitution": 0.5, "rolling_friction": 0.02},
    "container": {"kind": "wedge-hopper", "width": "60 mm", "height": "300 mm", "thickness": "1.01 d",
                  "orifice": "24 mm"},
    "fill": {"kind": "dense", "settled_below": 1e-3},
    "window": {"start": 0.15, "end": 0.6},
    "measure": ["flow_rate"],
}  # fmt: skip
TWIN_OUTLETS = ("18 mm", "24 mm", "30 mm")
TWIN_BEDS = 8
"""Beds of a measured value. Their seeds are not those of the first runs of a calibration, whose beds would be alike."""


def _twin(grains: int) -> dict[str, Any]:
    return {**TWIN, "grains": {**TWIN["grains"], "count": grains}}


def twins(
    repeats: int,
    lab: str,
    backend: str = "numba",
    device: str = "cpu",
    batch: int = 128,
    at_once: int = 1,
    grains: int = 400,
) -> dict[str, float]:
    """Calibrate the friction of twins. The outlet in the middle is held out, and is predicted.

    `at_once`: number of processes that calibrate.
    """
    import labbook

    frictions = [round(float(mu), 3) for mu in np.random.default_rng(21).uniform(0.1, 0.9, repeats)]
    sweep = {FRICTION: frictions, OUTLET: list(TWIN_OUTLETS)}
    truth = labbook.define(_twin(grains), name="truth", sweep=sweep, replicates=2 * TWIN_BEDS)
    place = labbook.Lab(lab, backend, device)
    place.run(truth, progress=False)
    values: dict[float, list[dict[str, Any]]] = {mu: [] for mu in frictions}
    for point in place.results(truth, progress=False).points:
        runs = [run for run in point.runs if run.seed > TWIN_BEDS and run.counted]
        beds = [run.measured["flow_rate"].value for run in runs if "flow_rate" in run.measured]
        entry = {"at": {OUTLET: f"{1e3 * float(point.point.at[OUTLET]):.12g} mm"}, "value": f"{np.mean(beds)!s} kg/s",
                 "error": f"{np.std(beds, ddof=1) / math.sqrt(len(beds))!s} kg/s"}  # fmt: skip
        values[float(point.point.at[FRICTION])].append(entry)
    jobs = [(number, mu, values[mu], lab, backend, device, batch, grains) for number, mu in enumerate(frictions)]
    ends = [_calibrate_twin(*jobs[0])]  # the first one makes the runs that all have in common
    with ProcessPoolExecutor(at_once, mp_context=get_context("spawn")) as pool:
        ends += pool.map(_calibrate_twin, *zip(*jobs[1:], strict=True)) if len(jobs) > 1 else ()
    inside, predicted, runs, kept = zip(*ends, strict=True)
    figures = {"twins": repeats, "inside": np.sum(inside), "predicted": np.sum(predicted), "runs": np.mean(runs),
               "promise kept": np.sum(kept)}  # fmt: skip
    return {name: float(value) for name, value in figures.items()}


def _calibrate_twin(
    number: int,
    friction: float,
    values: list[dict[str, Any]],
    lab: str,
    backend: str,
    device: str,
    batch: int,
    grains: int,
) -> tuple[bool, bool, int, bool]:
    """Calibrate one twin: friction inside, held-out value inside, runs, promise kept."""
    import labbook

    place, start = labbook.Lab(lab, backend, device), time.time()
    section = {"parameters": {FRICTION: {"uniform": [0.1, 0.9]}}, "discrepancy": 0, "batch": batch,
               "predict": [{OUTLET: TWIN_OUTLETS[1]}]}  # fmt: skip
    twin = labbook.define(_twin(grains), name=f"twin-{number}", sweep={OUTLET: list(TWIN_OUTLETS)},
                          reference={"source": "twin", "flow_rate": values}, calibrate=section)  # fmt: skip
    summary = place.run(twin, progress=False)
    calibration = place.results(twin, progress=False).calibration()
    interval, (prediction,) = calibration.parameters[FRICTION], calibration.predictions
    inside, runs = interval.low <= friction <= interval.high, len(calibration.inference.trials)
    kept = "Promise kept" in summary.campaign[-1]
    print(f"{friction}: {interval.median:.3f} ({interval.low:.3f} to {interval.high:.3f}), held-out W "
          f"{'inside' if prediction.agrees else 'outside'}, {runs} runs, promise {'' if kept else 'not '}kept, "
          f"{time.time() - start:.0f} s", flush=True)  # fmt: skip
    return inside, bool(prediction.agrees), runs, kept


def main() -> None:
    """Print the figures of one case."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("case", choices=("coverage", "stops", "map", "twins"))
    parser.add_argument("--repeats", type=int, default=200)
    parser.add_argument("--lab", default="twins", help="lab of the twins")
    parser.add_argument("--backend", default="numba", help="backend of the twins")
    parser.add_argument("--device", default="cpu", help="device of the twins")
    parser.add_argument("--batch", type=int, default=128, help="runs of a round of a twin")
    parser.add_argument("--grains", type=int, default=400, help="grains of a twin")
    parser.add_argument("--at-once", type=int, default=1, help="twins that are calibrated at once")
    options, start = parser.parse_args(), time.time()
    cases = {
        "coverage": lambda: coverage(options.repeats),
        "stops": lambda: coverage(options.repeats, 0.1),
        "map": lambda: maps(options.repeats),
        "twins": lambda: twins(
            options.repeats,
            options.lab,
            options.backend,
            options.device,
            options.batch,
            options.at_once,
            options.grains,
        ),
    }
    figures = cases[options.case]()
    for name, value in figures.items():
        print(f"{name}: {value:.4g}")
    print(f"seconds: {time.time() - start:.0f}")


if __name__ == "__main__":
    main()
