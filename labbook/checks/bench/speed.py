"""Speed of a backend: Fan's hopper settled and flowing, a box of spheres, rods, and members side by side.

Rates are grain-steps per second of processor time of one thread: other jobs on the machine hardly change them. Only
the gain from many cores is measured by the wall clock, as a ratio within one run. The scripts in `benchmarks` use the
same scenes.
"""

import inspect
import math
import resource
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from labbook.backend import Backend, Failed, Settled, load
from labbook.backend.machine import cores, hardware
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Crossing, Probe
from labbook.filling.opening import start_of_discharge
from labbook.filling.placing import place
from labbook.scene import (
    Box,
    CylinderSilo,
    HertzMindlin,
    LinearSpringDashpot,
    Scene,
    Spheres,
    Spherocylinders,
    WedgeHopper,
)
from labbook.scene.packing import Packing

GRAVITY = 9.81
FAN_STEP = Numerics(dt=2.5e-6)
BOX_STEP = Numerics(dt=2e-6, steps_per_beat=200)
CYLINDER_STEP = Numerics(dt=1e-6)
FILLING_STEP = 5e-6
"""Time step [s] at which cylinders are filled: 1/25 of a collision."""
SETTLED, RODS_SETTLED = 1e-6, 1e-4
"""Kinetic energy per grain [m g d] of the beds that are timed."""
OUTFLOW, RODS_OUTFLOW = 0.2, 0.1
"""Discharge [s] before a flow is timed."""
BOXES = (10_000, 100_000)
RODS = 1500
"""Few enough to settle within half a minute of processor time."""
TIMED = 12_000_000
"""Grain-steps of one timing, about."""
LONGEST = 1.5
"""Processor time [s] of one timing, about; at least one beat."""


@dataclass(frozen=True)
class Rate:
    """Millions of grain-steps per second of processor time: median and range over `repeats`."""

    case: str
    precision: str
    median: float
    low: float
    high: float
    grains: int
    repeats: int


@dataclass(frozen=True)
class BackendBench:
    """Speed of one backend on this machine.

    Args:
        backend: Name of the backend.
        hardware: Processor and memory.
        rates: Rates of the timed scenes [1e6 grain-steps per processor second].
        members: Number of members side by side.
        speed_up: Rate of `members` side by side over that of one.
        large: Rate of the largest box on all cores over that on one thread; None if the number of threads cannot be
            chosen, or no box is measured.
        memory: Peak memory of the process [MB].
    """

    backend: str
    hardware: dict[str, object]
    rates: tuple[Rate, ...]
    members: int
    speed_up: float
    large: float | None
    memory: float

    def as_dict(self) -> dict[str, object]:
        """Return plain values for JSON."""
        return asdict(self)


Extent = Literal["quick", "usual", "full"]
"""`quick`: only Fan's hopper. `usual`: boxes and rods in double too. `full`: rods in every precision."""


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

    Most of the time goes into compiling: of the CPU backend 4 scenes if `quick`, 7 if `usual`, 9 if `full`.
    """
    whole = load(name)
    backend = on_one_thread(whole) or whole
    every = sorted(backend.capabilities.precisions)
    scene = fan(grains=grains)
    closed = scene.close()
    say(f"settling {grains} grains")
    packing = settle(backend, closed, FAN_STEP, SETTLED)
    rates = _settled_and_flowing(backend, "fan", scene, FAN_STEP, packing, repeats, say, every, OUTFLOW)
    for count in boxes if extent != "quick" else ():
        say(f"timing a box of {count}")
        stack, at_rest = box(count)
        rates.append(time_member(backend, "box at rest", stack, BOX_STEP, at_rest, repeats))
    can = backend.capabilities
    if extent != "quick" and "spherocylinder" in can.shapes and "frustum" in can.walls:
        silo, filling = cylinder(rods=True, grains=rods), CYLINDER_STEP.model_copy(update={"dt": FILLING_STEP})
        say(f"settling {rods} rods")
        bed = settle(backend, silo.close(), filling, RODS_SETTLED)
        rod_precisions = every if extent == "full" else ["double"]
        rates += _settled_and_flowing(
            backend, "rods", silo, CYLINDER_STEP, bed, repeats, say, rod_precisions, RODS_OUTFLOW
        )
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3  # peak; Linux counts in KiB
    say("timing members side by side")
    members = cores()
    speed_up = members * _time_ratio(backend, backend, (closed, FAN_STEP, packing), members)
    large = None
    if on_one_thread(whole) is not None and extent != "quick":
        say("timing one large scene on all cores")
        stack, at_rest = box(max(boxes))
        large = _time_ratio(backend, whole, (stack, BOX_STEP, at_rest), 1)
    return BackendBench(name, hardware(), tuple(rates), members, speed_up, large, memory)


def _settled_and_flowing(
    backend: Backend,
    name: str,
    scene: Scene,
    step: Numerics,
    bed: Packing,
    repeats: int,
    say: Callable[[str], None],
    precisions: Sequence[str],
    outflow: float,
) -> list[Rate]:
    """Measure the rates of a bed in the closed container, and of its discharge after `outflow` [s]."""
    closed = scene.close()
    start = start_of_discharge(bed, closed, scene)
    rates = []
    for precision in precisions:
        numerics = step.model_copy(update={"precision": precision})
        say(f"timing the settled bed, {precision} (compiles)")
        rates.append(time_member(backend, f"{name} settled", closed, numerics, bed, repeats))
        say(f"timing its discharge, {precision} (compiles)")
        rates.append(time_member(backend, f"{name} flowing", scene, numerics, start, repeats, [Crossing(0.0)], outflow))
    return rates


def on_one_thread(backend: Backend) -> Backend | None:
    """Return the same backend with one thread a member; None if its number of threads cannot be chosen."""
    maker: Any = type(backend)
    return maker(threads=1) if "threads" in inspect.signature(maker).parameters else None


def settle(backend: Backend, closed: Scene, numerics: Numerics, below: float) -> Packing:
    """Let grains of the scene `closed` fall from a gas of seed 1 until they settle.

    `below`: mean kinetic energy per grain [m g d] at which they count as settled.
    """
    return advance_until(backend, "cpu", closed, numerics, place(closed, "gas", 1), settled_below=below)


def advance_until(
    backend: Backend,
    device: str,
    scene: Scene,
    numerics: Numerics,
    start: Packing,
    settled_below: float | None = None,
    outflow: float = 0.0,
) -> Packing:
    """Advance `start` until it has settled, or else for `outflow` [s]."""
    ensemble = backend.open(backend.specialise(scene, numerics), 1, device)
    bed = ensemble.admit(scene, numerics, start, settled_below=settled_below)
    while settled_below is not None or ensemble.status(bed).time < outflow:
        events = ensemble.advance(4 if settled_below else 1)
        if failed := [event for event in events if isinstance(event, Failed)]:
            raise RuntimeError(f"a bed cannot be made: {failed[0].message}")
        if any(isinstance(event, Settled) for event in events):
            break
    packing = ensemble.packing(bed)
    ensemble.close()
    return packing


def time_member(
    backend: Backend,
    case: str,
    scene: Scene,
    numerics: Numerics,
    start: Packing,
    repeats: int,
    probes: Sequence[Probe] = (),
    after: float = 0.0,
) -> Rate:
    """Measure the rate of one member from `after` [s] on.

    The first two beats are not timed: the first may compile kernels, and the second gives the number of beats to time.
    """
    ensemble = backend.open(backend.specialise(scene, numerics, probes), 1)
    member = ensemble.admit(scene, numerics, start)
    ensemble.advance(max(1, round(after / numerics.beat)))
    began = time.process_time()
    ensemble.advance(1)
    beat = max(time.process_time() - began, 1e-6)
    beats = max(1, min(TIMED // (len(start) * numerics.steps_per_beat), round(LONGEST / beat)))
    rates = []
    for _ in range(repeats):
        before = ensemble.status(member)
        began = time.process_time()
        events = ensemble.advance(beats)
        if failed := [event for event in events if isinstance(event, Failed)]:
            raise RuntimeError(f"{case}: {failed[0].message}")
        spent = time.process_time() - began
        now = ensemble.status(member)
        rates.append((now.step - before.step) * (before.grains + now.grains) / 2 / spent / 1e6)
    grains = ensemble.status(member).grains
    ensemble.close()
    return Rate(case, numerics.precision, statistics.median(rates), min(rates), max(rates), grains, repeats)


def _time_ratio(reference: Backend, candidate: Backend, bed: tuple[Scene, Numerics, Packing], members: int) -> float:
    """Wall-clock time of one member with `reference`, over that of `members` with `candidate`: median of five."""
    scene, step, start = bed
    pair = [
        reference.open(reference.specialise(scene, step), 1),
        candidate.open(candidate.specialise(scene, step), members),
    ]
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


# scenes


def fan(grains: int = 3000) -> Scene:
    """Flat-bottomed quasi-2D hopper of Fan et al. 2023: 3 mm spheres, Hertz-Mindlin, an orifice of 30 mm."""
    return Scene(
        grains=Spheres(diameter=3e-3, density=2500, count=grains),
        contact=HertzMindlin(
            shear_modulus=1e8, poisson_ratio=0.25, friction=0.5, rolling_friction=0.01, restitution=0.2
        ),
        container=WedgeHopper(width=0.1, height=0.4, thickness=3.03e-3, orifice=0.03),
    )


def cylinder(rods: bool, grains: int = 10_000) -> Scene:
    """The silo of Pongo et al. 2022 with an orifice of 54 mm, whose bottom turns at 0.32 Hz.

    rods: 20 mm x 6 mm, else spheres of the same volume; linear law, stiffness 2e5 m g/d.
    """
    if rods:
        return pongo(Spherocylinders(diameter=6e-3, length=20e-3, density=620, count=grains))
    return pongo(Spheres(diameter=9.9e-3, density=620, count=grains))


def pongo(grains: Spheres | Spherocylinders, diameter: float = 0.19) -> Scene:
    """`cylinder` with other grains, in a silo of another diameter [m]."""
    stiffness = 2e5 * grains.mass * 9.8 / grains.diameter
    return Scene(
        grains=grains,
        contact=LinearSpringDashpot(normal_stiffness=stiffness, friction=0.5, restitution=0.9),
        container=CylinderSilo(diameter=diameter, height=2.0, orifice=0.054, rotation=0.32),
        gravity=9.8,
    )


def box(grains: int) -> tuple[Scene, Packing]:
    """Spheres stacked in a box, each above another and beside four, at rest: three contacts a grain.

    More than a random bed has, so that the rate is no better than there. Linear law with friction.
    """
    d = 3e-3
    across = round((grains / 1.25) ** (1 / 3))
    layers = math.ceil(grains / across**2)
    apart = d * (1 - 1e-5)
    sites = np.stack(np.meshgrid(*(np.arange(k) for k in (layers, across, across)), indexing="ij"), -1).reshape(-1, 3)
    x = (sites[:grains, ::-1] + 0.5) * apart - [across * apart / 2, across * apart / 2, 0.0]
    spheres = Spheres(diameter=d, density=2500, count=grains)
    scene = Scene(
        grains=spheres,
        contact=LinearSpringDashpot(
            normal_stiffness=2e5 * spheres.mass * GRAVITY / d, friction=0.5, rolling_friction=0.0, restitution=0.2
        ),
        container=Box(width=across * apart, depth=across * apart, height=2 * layers * d),
    )
    return scene, Packing(x=x, v=np.zeros_like(x), omega=np.zeros_like(x))
