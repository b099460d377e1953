"""Speed of a backend: Fan's hopper settled and flowing, a box of spheres, rods, what its switches save, its start.

Rates are grain-steps per second of processor time, of one thread: other jobs on the machine cost little. Only what many
cores gain is taken from the wall clock, and is a ratio within one run.
"""

import inspect
import os
import resource
import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, Literal

from labbook.backend import Backend, load
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Crossing
from labbook.bench.beds import settled
from labbook.bench.hardware import hardware
from labbook.bench.rate import TIMED, Rate, timed
from labbook.bench.rods import RODS, has_rods, rod_rates
from labbook.bench.savings import Saving, savings
from labbook.bench.scenes import BOX_STEP, FAN_STEP, box, fan
from labbook.bench.starting import Starting, starting
from labbook.filling.opening import opened
from labbook.scene import Scene
from labbook.scene.packing import Packing

SETTLED = 1e-6  # kinetic energy per grain [m g d] of the bed that is timed
OUTFLOW = 0.2  # s of discharge before the flow is timed
BOXES = (10_000, 100_000)


@dataclass(frozen=True)
class BackendBench:
    """What one backend does on this machine. `savings`: by the switches of the settled bed, in double; none unless all
    is measured.

    `speed_up`: of `members` side by side over one; `large`: of the largest box on all cores over one thread, None if
    the backend has no say in that or no box is measured.
    """

    backend: str
    hardware: dict[str, object]
    rates: tuple[Rate, ...]
    savings: tuple[Saving, ...]
    members: int
    speed_up: float
    large: float | None
    memory: float
    starting: Starting

    def as_dict(self) -> dict[str, object]:
        """For JSON; rates in 1e6 grain-steps per processor second, memory in MB, times in s."""
        return asdict(self)


Extent = Literal["quick", "usual", "full"]
"""`quick`: only Fan's hopper, and the start. `usual`: boxes and rods in double too. `full`: rods in every precision and
what switches save too."""


def run(
    name: str = "numba",
    repeats: int = 5,
    say: Callable[[str], None] = lambda _: None,
    extent: Extent = "usual",
    grains: int = 3000,
    boxes: tuple[int, ...] = BOXES,
    rods: int = RODS,
) -> BackendBench:
    """Measure the backend called `name` on Fan's hopper with `grains`, on `boxes`, and on `rods` where it has them.

    Most of the time goes into compiling: of the CPU backend 5 scenes if `quick`, 8 if `usual`, 17 if `full`.
    """

    whole = load(name)
    backend = on_one_thread(whole) or whole
    scene = fan(grains=grains)
    closed = scene.close()
    say(f"settling {grains} grains")
    packing = settled(backend, closed, FAN_STEP, SETTLED)
    rates = []
    for precision in sorted(backend.capabilities.precisions):
        numerics = FAN_STEP.model_copy(update={"precision": precision})
        say(f"timing the settled bed, {precision} (compiles)")
        rates.append(timed(backend, "fan settled", closed, numerics, packing, repeats))
        start = opened(packing, closed, scene)
        say(f"timing its discharge, {precision} (compiles)")
        rates.append(timed(backend, "fan flowing", scene, numerics, start, repeats, [Crossing(0.0)], OUTFLOW))
    for count in boxes if extent != "quick" else ():
        say(f"timing a box of {count}")
        stack, at_rest = box(count)
        rates.append(timed(backend, "box at rest", stack, BOX_STEP, at_rest, repeats))
    if has_rods(backend) and extent != "quick":
        precisions = sorted(backend.capabilities.precisions) if extent == "full" else ["double"]
        rates += rod_rates(backend, repeats, say, rods, precisions)
    saved = savings(backend, closed, packing, repeats, say) if extent == "full" else ()
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3  # peak; Linux counts in KiB
    say("timing members side by side")
    members = _cores()
    bed = closed, FAN_STEP, packing
    speed_up = members * _quicker(backend, backend, bed, members)
    large = None
    if on_one_thread(whole) is not None and extent != "quick":
        say("timing one large scene on all cores")
        stack, at_rest = box(max(boxes))
        large = _quicker(backend, whole, (stack, BOX_STEP, at_rest), 1)
    say("timing a fresh start (compiles)")
    fresh = starting(name, 1 if extent == "quick" else 3)
    return BackendBench(name, hardware(), tuple(rates), saved, members, speed_up, large, memory, fresh)


def on_one_thread(backend: Backend) -> Backend | None:
    """The same backend, with one thread a member; None if it has no such choice."""
    maker: Any = type(backend)
    return maker(threads=1) if "threads" in inspect.signature(maker).parameters else None


def _quicker(
    one: Backend, other: Backend, bed: tuple[Scene, Numerics, Packing], members: int
) -> float:  # fmt: skip
    """Wall-clock time of one member with the backend `one`, over that of `members` with `other`: median of five."""
    scene, step, start = bed
    pair = [one.open(one.specialise(scene, step), 1), other.open(other.specialise(scene, step), members)]
    for ensemble, count in zip(pair, (1, members), strict=True):
        for _ in range(count):
            ensemble.admit(scene, step, start)
        ensemble.advance(1)
    ratios = []
    beats = max(1, TIMED // 4 // (len(start) * step.steps_per_beat))
    for _ in range(5):
        spent = []
        for ensemble in pair:
            began = time.perf_counter()
            ensemble.advance(beats)
            spent.append(time.perf_counter() - began)
        ratios.append(spent[0] / spent[1])
    for ensemble in pair:
        ensemble.close()
    return statistics.median(ratios)


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
