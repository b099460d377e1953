"""Few grains, none, too many in one place, and grains of very unlike sizes."""

import math
from collections.abc import Iterator

import numpy as np

from labbook.backend.probes import Ledger, Sample
from labbook.checks.stress.case import Ending, StressCase, within
from labbook.checks.stress.watch import RunOutcome, follow, one_line, refused, sound
from labbook.checks.verify.case import limited
from labbook.checks.verify.collision import duration
from labbook.checks.verify.gas import elastic_energy
from labbook.checks.verify.materials import LAWS, D, G, scene
from labbook.checks.verify.platform import MemberStart, Platform, grains_at
from labbook.scene import Bodies, Kind, Primitives, Scene, Spheres
from labbook.scene.packing import Packing
from labbook.scene.sizes import SMALLEST_PART
from labbook.scene.timescales import largest_stable_step

SOFT = {"hertz-mindlin": {"shear_modulus": 1e5}, "linear": {"normal_stiffness": 200.0}}
MOTION = Sample(fields=("x", "v"))


def _short(part: str, run_outcome: RunOutcome) -> Ending:
    """Accept a named error only if it says that lists are too short, and names the remedy."""
    outcome = "named error" if run_outcome.guard == "room" and "numerics.skin" in run_outcome.message else "failed"
    return Ending(part, outcome, one_line(run_outcome.message))


def _sizes(platform: Platform) -> Iterator[Ending]:
    """Small spheres fly at a large one from all sides, without gravity and walls."""
    for law in LAWS:
        for ratio in (2, 4, 10):
            here = _two_sizes(law, ratio)
            start = _surrounded(here, ratio)
            dt = 0.2 * largest_stable_step(here)
            steps = math.ceil(IMPACT_TIME / dt / 10)
            outcome = follow(platform, MemberStart(here, dt, start), 10, steps, [Ledger()])
            part = f"{law}, 1:{ratio}, {len(start) - 1} small grains"
            if outcome.guard:
                yield _short(part, outcome)
                continue
            table, own = sound(outcome).rows(Ledger()), Bodies.of(here.grains, start)
            push = float(own.mass @ np.linalg.norm(start.v, axis=1))
            last = [float(table[k][-1]) for k in ("px", "py", "pz")]
            change = float(np.linalg.norm(last - own.mass @ start.v)) / push
            # rounding of a sum of a few hundred terms, in another order than here
            yield within(platform, part, "momentum", change, limited(1e-13, steps=500))
            before = 0.5 * float(own.mass @ np.sum(start.v**2, axis=1))
            gained = float(table["kinetic"].max()) / before - 1
            yield within(platform, part, "energy gained", gained, limited(1e-12, roundings=1, steps=16))
            lost = float(table["kinetic"][-1]) / before
            # e = 0.2 leaves e^2 of a head-on impact with a body that hardly moves, and neighbours push one another
            yield within(platform, part, "energy left", lost, limited(0.1))
    small = SMALLEST_PART / 2
    kinds = (Kind(name="large", share=0.5), Kind(name="small", share=0.5, diameter=small * D))

    def create_grains() -> Spheres:
        return Spheres(diameter=D, density=2500, count=2, kinds=kinds)

    yield refused(f"1:{1 / small:g}", create_grains, "kinds: the diameter of small", (ValueError,))


IMPACT_TIME = 2e-3
"""Time [s] after which all small grains have hit the large one and left it."""


def _two_sizes(law: str, ratio: float) -> Scene:
    kinds = (Kind(name="large", share=0.5), Kind(name="small", share=0.5, diameter=D / ratio))
    grains = Spheres(diameter=D, density=2500, count=1000, kinds=kinds)
    return Scene(grains=grains, contact=LAWS[law](), container=Primitives(), gravity=0.0)


def _surrounded(here: Scene, ratio: float) -> Packing:
    """Place small spheres on a spiral round the large one, no closer than their diameter to each other."""
    small = D / ratio
    shell = 0.5 * (D + small)
    count = int(0.6 * math.pi * (2 * shell / small) ** 2 / 4) * 2
    shell += 0.3 * D  # beyond every list
    z = 1 - (2 * np.arange(count) + 1) / count
    turn = math.pi * (1 + math.sqrt(5)) * np.arange(count)
    out = np.column_stack([np.sqrt(1 - z**2) * np.cos(turn), np.sqrt(1 - z**2) * np.sin(turn), z])
    x = np.concatenate([np.zeros((1, 3)), shell * out])
    v = np.concatenate([np.zeros((1, 3)), -1.0 * out])
    kind = np.array([0, *[1] * count])
    return Packing(x=x, v=v, omega=np.zeros_like(x), diameter=np.where(kind == 0, D, small), kind=kind)


PRESSED = 0.45
"""Distance of neighbours in the cluster [d]: 56 centres lie within d and the skin of a list."""


def _crowd(platform: Platform) -> Iterator[Ending]:
    """A cubic cluster pressed together flies apart: elastic and frictionless, its stored energy becomes kinetic."""
    sites = np.stack(np.meshgrid(*[np.arange(5.0)] * 3), -1).reshape(-1, 3)
    for law in LAWS:
        elastic = {"restitution": 1, "friction": 0, "rolling_friction": 0}
        here = scene(len(sites), LAWS[law](**elastic, **SOFT[law]), Primitives())
        x = PRESSED * D * (sites - 2)
        apart = np.linalg.norm(x[:, None] - x[None], axis=2)[np.triu_indices(len(x), 1)]
        overlap = D - apart[apart < D]
        stored = float(elastic_energy(here, overlap, np.zeros(len(overlap), bool)).sum())
        dt = duration(here, 1.0) / 2000
        run_outcome = follow(platform, MemberStart(here, dt, grains_at(x)), 10, 500)
        part = f"{law}, within the overlap limit"
        if run_outcome.guard == "room":
            yield _short(part, run_outcome)
        else:
            outcome = "named error" if run_outcome.guard == "overlap" else "failed"
            yield Ending(part, outcome, one_line(run_outcome.message or "silence: no guard has named the overlaps"))
        run_outcome = follow(platform, MemberStart(here, dt, grains_at(x), numerics={"overlap_limit": 1.0}), 10, 500)
        part = f"{law}, without an overlap limit"
        if run_outcome.guard:
            yield _short(part, run_outcome)
            continue
        kinetic = 0.5 * here.grains.mass * float(np.sum(sound(run_outcome).end.v ** 2))
        yield within(
            platform, part, "|kinetic/stored - 1|", abs(kinetic / stored - 1), limited(1e-4, roundings=1e3, steps=5e3)
        )


def _few(platform: Platform) -> Iterator[Ending]:
    """One grain falls freely from the start: leapfrog is exact where the force is constant."""
    here = scene(1, LAWS["linear"](), Primitives(), G)
    dt, steps = 1e-5, 20_000
    outcome = follow(platform, MemberStart(here, dt, grains_at([[0.0, 0.0, 0.0]], [[0.3, 0.0, 0.0]])), 4, steps // 4)
    time = steps * dt
    end = sound(outcome).end
    fallen = max(abs(float(end.x[0, 2]) / (-0.5 * G * time**2) - 1), abs(float(end.x[0, 0]) / (0.3 * time) - 1))
    yield within(platform, "one grain", "free fall", fallen, limited(1e-11, steps=steps))
    none = np.zeros((0, 3))

    def admit() -> RunOutcome:
        return follow(platform, MemberStart(here, dt, Packing(x=none, v=none, omega=none)), 2, 100)

    def create_grains() -> Spheres:
        return Spheres(diameter=D, density=2500, count=0)

    yield refused("no grain in the scene", create_grains, "count", (ValueError,))
    yield refused("no grain in the packing", admit, "packing: it has no grains", (ValueError,))


CASES = [
    StressCase(
        name="few-grains",
        attempt="one grain in free space; none in the scene, or in the packing",
        oracle="exact free fall; a named error before anything runs",
        run=_few,
    ),
    StressCase(
        name="crowd",
        attempt="125 grains pressed into a cluster with 56 near neighbours each",
        oracle="kinetic energy = stored energy; the overlap guard, or an error on full lists",
        run=_crowd,
    ),
    StressCase(
        name="size-ratio",
        attempt="a sphere surrounded by smaller ones, down to d/10, and one of d/20",
        oracle="momentum; energy does not grow; an error on small sizes or full lists",
        run=_sizes,
    ),
]
