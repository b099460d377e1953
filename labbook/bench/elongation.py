"""What long grains cost: the same volume of grain from a sphere to a rod ten times as long as thick.

Beds in Pongo's cylinder over a turning bottom, in discharge, at the step that they are filled with: lists are rebuilt
every few tens of steps, and finding neighbours counts as much as it does in a study.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

from labbook.backend import Backend, load
from labbook.backend.probes import Crossing
from labbook.bench import batch, rate
from labbook.bench.batch import CYLINDER_STEP, FILLING_STEP, flowing
from labbook.bench.hardware import hardware
from labbook.bench.scenes import elongated
from labbook.filling.placing import place

ASPECT_RATIOS = (1.0, 2.0, 3.3, 5.0, 10.0)
RODS, OF_A_GPU, MEMBERS = 1000, 10_000, 64
"""Grains of a bed on a core, and on a GPU; beds side by side there."""
BEATS = 5  # of a timing on a GPU


@dataclass(frozen=True)
class Elongated:
    """One aspect ratio, length over diameter. cost: of a grain-step [ns], median of some timings: processor time on a
    core, and on a GPU time of the wall clock; grains: that were left at the end."""

    aspect_ratio: float
    members: int
    grains: int
    cost: float
    low: float
    high: float


@dataclass(frozen=True)
class ElongationBench:
    """What one backend does on one device."""

    backend: str
    device: str
    hardware: dict[str, object]
    cases: tuple[Elongated, ...]

    def as_dict(self) -> dict[str, object]:
        """For JSON."""
        return asdict(self)


def run(
    name: str = "numba",
    device: str = "cpu",
    repeats: int = 7,
    say: Callable[[str], None] = lambda _: None,
    aspect_ratios: Sequence[float] = ASPECT_RATIOS,
    grains: int | None = None,
) -> ElongationBench:
    """Measure the backend called `name` on `device`. Takes a few minutes on a core, and less on a large GPU."""

    backend = load(name)
    grains = grains or (RODS if device == "cpu" else OF_A_GPU)
    cases = []
    for aspect_ratio in aspect_ratios:
        say(f"L/d = {aspect_ratio:g}")
        cases.append(_case(backend, device, aspect_ratio, grains, repeats))
    return ElongationBench(name, device, hardware(), tuple(cases))


def _case(backend: Backend, device: str, aspect_ratio: float, grains: int, repeats: int) -> Elongated:
    scene, how = elongated(aspect_ratio, grains), CYLINDER_STEP.model_copy(update={"dt": FILLING_STEP})
    closed = scene.close()
    bed = flowing(backend, device, f"L/d = {aspect_ratio:g}", scene, closed, place(closed, "gas", 1), how)
    if device == "cpu":
        one = rate.timed(backend, bed.name, scene, bed.numerics, bed.start, repeats, [Crossing(0.0)])
        return Elongated(aspect_ratio, 1, one.grains, 1e3 / one.median, 1e3 / one.high, 1e3 / one.low)
    timings = [batch.timed(backend, device, bed, MEMBERS, BEATS) for _ in range(repeats)]
    costs = sorted(1 / timing.rate for timing in timings)
    return Elongated(aspect_ratio, MEMBERS, timings[0].grains, costs[repeats // 2], costs[0], costs[-1])
