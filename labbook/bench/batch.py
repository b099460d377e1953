"""Speed of many members at once, in real discharge: rebuilds, outflow and the visits of the host included.

Scenes: Fan's hopper (3000 spheres, Hertz-Mindlin), a silo in three dimensions (10 000 spheres, linear law), and Pongo's
cylinder over a turning bottom with 10 000 spheres and with 10 000 rods. What is varied from the case that all share:
members, precision, skin, and, where the backend has them, threads a grain.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from labbook.backend import Backend, Failed, Load, Settled, Weighed, load
from labbook.backend.numerics import Numerics
from labbook.backend.probes import Crossing
from labbook.bench.hardware import hardware
from labbook.bench.scenes import FAN_STEP, cylinder, fan, silo
from labbook.filling.opening import opened
from labbook.filling.placing import place
from labbook.scene import Scene
from labbook.scene.packing import Packing

SETTLED = 1e-4  # kinetic energy per grain [m g d] of the beds that are opened
OUTFLOW = 0.1  # s of discharge before it is timed
SILO_STEP = Numerics(dt=2e-6, skin=0.1)
CYLINDER_STEP = Numerics(dt=1e-6)
FILLING_STEP = 5e-6  # s, at which cylinders are filled and opened: 1/25 of a collision
MEMBERS = (1, 2, 4, 8, 16, 64, 256)
SKINS = (0.07, 0.1, 0.15, 0.25)
LANES = (1, 2, 4, 8)


@dataclass(frozen=True)
class Timing:
    """One case: `rate` in 1e9 grain-steps per second of the wall clock, `step` in microseconds."""

    scene: str
    members: int
    grains: int
    precision: str
    skin: float
    rate: float
    step: float
    load: Load | None

    @property
    def fraction(self) -> float | None:
        """Part of the measured copy bandwidth that the bytes which must move come to."""
        load = self.load
        return load.bytes * self.rate * 1e9 / load.bandwidth if load and load.bandwidth else None


@dataclass(frozen=True)
class BatchBench:
    """What one backend does on one device."""

    backend: str
    device: str
    hardware: dict[str, object]
    timings: tuple[Timing, ...]

    def as_dict(self) -> dict[str, object]:
        """For JSON."""
        cases = [{**asdict(timing), "fraction": timing.fraction} for timing in self.timings]
        return {**asdict(self), "timings": cases}


@dataclass(frozen=True)
class Bed:
    """A silo that flows."""

    name: str
    scene: Scene
    numerics: Numerics
    start: Packing


def run(
    name: str = "warp",
    device: str = "cuda:0",
    say: Callable[[str], None] = lambda _: None,
    members: Sequence[int] = MEMBERS,
    beats: int = 3,
) -> BatchBench:
    """Measure the backend called `name` on `device`. Takes some three minutes on a large GPU."""

    backend = load(name)
    timings = []
    for bed in _beds(backend, device, say):
        for count in members:
            say(f"{bed.name}: {count} members")
            timings.append(timed(backend, device, bed, count, beats))
        many = max(count for count in members if count <= 64)
        for precision in sorted(backend.capabilities.precisions - {"mixed"}):
            say(f"{bed.name}: {precision}")
            timings.append(timed(backend, device, bed, many, beats, precision=precision))
        for skin in SKINS:
            say(f"{bed.name}: skin {skin} d")
            timings.append(timed(backend, device, bed, many, beats, skin=skin))
        for lanes in LANES:
            say(f"{bed.name}: {lanes} threads a grain")
            maker: Any = type(backend)  # the lanes of a backend that has them are an argument of its own
            timings.append(timed(maker(lanes=lanes), device, bed, 1, beats))
    return BatchBench(name, device, hardware(), tuple(timings))


def _beds(backend: Backend, device: str, say: Callable[[str], None]) -> Iterator[Bed]:
    def bed(name: str, *parts: Any) -> Bed:
        say(f"{name}: settling")
        return flowing(backend, device, name, *parts)

    yield bed("fan", fan(), fan().close(), place(fan().close(), "gas", 1), FAN_STEP)
    yield bed("silo", *silo(), SILO_STEP)
    for rods in (False, True):
        scene = cylinder(rods)
        closed, name = scene.close(), "rods" if rods else "cylinder"
        yield bed(name, scene, closed, place(closed, "gas", 1), CYLINDER_STEP, FILLING_STEP)


def flowing(
    backend: Backend, device: str, name: str, scene: Scene, closed: Scene, start: Packing, numerics: Numerics,
    filling: float | None = None,
) -> Bed:  # fmt: skip
    """The bed to which `start` settles, OUTFLOW after it is opened. filling: another step [s] to use until then."""
    how = numerics.model_copy(update={"precision": "mixed"})
    coarse = how.model_copy(update={"dt": filling or how.dt})
    bed = _advanced(backend, device, closed, coarse, start, SETTLED)
    return Bed(name, scene, how, _advanced(backend, device, scene, coarse, opened(bed, closed, scene)))


def _advanced(
    backend: Backend, device: str, scene: Scene, numerics: Numerics, start: Packing, settled: float | None = None
) -> Packing:  # fmt: skip
    """What `start` has become when it has settled, or else after OUTFLOW."""
    ensemble = backend.open(backend.specialise(scene, numerics), 1, device)
    bed = ensemble.admit(scene, numerics, start, settled_below=settled)
    while settled is not None or ensemble.status(bed).time < OUTFLOW:
        events = ensemble.advance(10 if settled else 1)
        if failed := [event for event in events if isinstance(event, Failed)]:
            raise RuntimeError(f"a bed cannot be made: {failed[0].message}")
        if any(isinstance(event, Settled) for event in events):
            break
    packing = ensemble.packing(bed)
    ensemble.close()
    return packing


def timed(backend: Backend, device: str, bed: Bed, members: int, beats: int, **numerics: object) -> Timing:
    """Speed of `members` copies of a bed over `beats` beats. numerics: what to change in the bed's."""
    how = bed.numerics.model_copy(update=numerics)
    ensemble = backend.open(backend.specialise(bed.scene, how, [Crossing(0.0)]), members, device)
    handles = [ensemble.admit(bed.scene, how, bed.start) for _ in range(members)]
    ensemble.advance(1)
    before = [ensemble.status(handle) for handle in handles]
    began = time.perf_counter()
    ensemble.advance(beats)
    ensemble.drain()
    spent = time.perf_counter() - began
    after = [ensemble.status(handle) for handle in handles]
    done = sum((b.step - a.step) * (a.grains + b.grains) / 2 for a, b in zip(before, after, strict=True))
    timing = Timing(
        scene=bed.name,
        members=members,
        grains=after[0].grains,
        precision=how.precision,
        skin=how.skin,
        rate=done / spent / 1e9,
        step=spent / (beats * how.steps_per_beat) * 1e6,
        load=ensemble.load() if isinstance(ensemble, Weighed) else None,
    )
    ensemble.close()
    return timing
