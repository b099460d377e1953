"""Speed of an engine on Fan's hopper: settled and flowing, one member and one a core, memory, and time to start.

Rates are grain-steps per second of processor time, summed over threads: other jobs on the machine cost little. Only
the scaling over members is taken from the wall clock, and is a ratio within one run.
"""

import os
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass

from labbook import backend
from labbook.backend import Crossing, Ensemble, Failed, Member, Settled
from labbook.bench.scenes import FAN_STEP, fan
from labbook.protocol.opening import opened
from labbook.protocol.packing import Packing
from labbook.protocol.placing import place
from labbook.scene import Scene

SETTLED = 1e-6  # kinetic energy per grain [m g d] of the bed that is timed
OUTFLOW = 0.2  # s of discharge before the flow is timed


@dataclass(frozen=True)
class Rate:
    """Millions of grain-steps per second of processor time: median and range over `repeats`."""

    case: str
    median: float
    low: float
    high: float
    grains: int
    repeats: int


@dataclass(frozen=True)
class EngineBench:
    """What one engine does on this machine."""

    backend: str
    hardware: dict[str, object]
    rates: tuple[Rate, ...]
    members: int
    speed_up: float
    memory: float
    first_step: float
    compile: float

    def as_dict(self) -> dict[str, object]:
        """For JSON; rates in 1e6 grain-steps per processor second, memory in MB, times in s."""
        return asdict(self)


def run(
    name: str = "numba", repeats: int = 7, say: Callable[[str], None] = lambda _: None, grains: int = 3000
) -> EngineBench:
    """Measure the engine called `name` on Fan's hopper with `grains`. Takes about two minutes with 3000."""
    from labbook.bench.hardware import hardware

    engine = backend.load(name)
    scene, step = fan(grains=grains), FAN_STEP
    closed = scene.close()
    say(f"settling {grains} grains")
    began = time.perf_counter()
    still = engine.open(engine.specialise(closed, step), 1)
    bed = still.admit(closed, step, place(closed, "gas", 1), settled_below=SETTLED)
    first = still.advance(1)
    if any(isinstance(event, Failed) for event in first):
        raise RuntimeError("the bed did not settle: its first beat failed")
    compiled = time.perf_counter() - began
    _settle(still)
    packing = still.packing(bed)
    say("timing the settled bed")
    rates = [_rate("fan settled", still, [bed], 4, repeats)]
    still.close()
    say("timing the discharge")
    probes = (Crossing(0.0),)
    start = opened(packing, closed, scene)
    flow = engine.open(engine.specialise(scene, step, probes), 1)
    flowing = flow.admit(scene, step, start)
    flow.advance(round(OUTFLOW / step.beat))
    rates.append(_rate("fan flowing", flow, [flowing], 4, repeats))
    flow.close()
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3  # peak; Linux counts in KiB
    say("timing members side by side")
    members = _cores()
    speed_up = _speed_up(engine, scene, packing, members)
    say("timing a fresh start")
    return EngineBench(name, hardware(), tuple(rates), members, speed_up, memory, _first_step(name), compiled)


def _settle(ensemble: Ensemble) -> None:
    while True:
        for event in ensemble.advance(4):
            if isinstance(event, Failed):
                raise RuntimeError(f"the bed did not settle: {event.message}")
            if isinstance(event, Settled):
                return


def _rate(case: str, ensemble: Ensemble, members: list[Member], beats: int, repeats: int) -> Rate:
    rates = []
    for _ in range(repeats):
        before = [ensemble.status(member) for member in members]
        began = time.process_time()
        ensemble.advance(beats)
        spent = time.process_time() - began
        after = [ensemble.status(member) for member in members]
        done = sum((b.step - a.step) * (a.grains + b.grains) / 2 for a, b in zip(before, after, strict=True))
        rates.append(done / spent / 1e6)
    grains = ensemble.status(members[0]).grains
    return Rate(case, statistics.median(rates), min(rates), max(rates), grains, repeats)


def _speed_up(engine: backend.Backend, scene: Scene, packing: Packing, members: int) -> float:
    """Throughput of `members` settled members over that of one, by the wall clock: median of five pairs."""
    closed, step = scene.close(), FAN_STEP
    spec = engine.specialise(closed, step)
    one, many = engine.open(spec, 1), engine.open(spec, members)
    one.admit(closed, step, packing)
    for _ in range(members):
        many.admit(closed, step, packing)
    ratios = []
    for _ in range(5):
        spent = []
        for ensemble in (one, many):
            began = time.perf_counter()
            ensemble.advance(4)
            spent.append(time.perf_counter() - began)
        ratios.append(members * spent[0] / spent[1])
    one.close()
    many.close()
    return statistics.median(ratios)


def _first_step(name: str) -> float:
    """Wall time [s] from the start of a fresh process to the engine's first step, kernels cached: best of three."""
    code = f"from labbook.bench.engine import first_step; first_step({name!r})"
    times = []
    for _ in range(3):
        began = time.perf_counter()
        subprocess.run([sys.executable, "-c", code], check=True)
        times.append(time.perf_counter() - began)
    return min(times)


def first_step(name: str) -> None:
    """Take one step of Fan's settling hopper."""
    closed, step = fan().close(), FAN_STEP.model_copy(update={"steps_per_beat": 1})
    engine = backend.load(name)
    ensemble = engine.open(engine.specialise(closed, step), 1)
    ensemble.admit(closed, step, place(closed, "gas", 1))
    ensemble.advance(1)
    ensemble.close()


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
