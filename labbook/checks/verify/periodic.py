"""Periodic sides: collisions across them, other places of the box, frames that move along y, a post, and momentum."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from labbook.backend.probes import Ledger
from labbook.checks.verify.case import Case, limited
from labbook.checks.verify.collision import duration, oblique
from labbook.checks.verify.materials import D, G, hertz, scene
from labbook.checks.verify.platform import MemberStart, Platform, Trajectory, grains_at, require
from labbook.checks.verify.rods import ROD, rods
from labbook.filling.placing import place
from labbook.scene import Box, Frustum, Scene, SurfaceChange, Wall
from labbook.scene.orientation import turned_to
from labbook.scene.packing import Packing
from labbook.scene.periodic import nearest_images

PERIOD = 3.3 * D
PAIRS = 6
COUNT = 40
SOFT = 1e6
"""Shear modulus [Pa]; with it DT is a tenth of the Rayleigh time."""
DT = 2.5e-5
STREAM = 1.0
"""Speed [m/s] of the frame: in 25 ms its grains cross the sides two or three times."""
LEDGER = Ledger(every=1)


def _apart(period: float) -> Box:
    return Box(width=2.0, depth=period, height=2.0, periodic="y")


def _across(platform: Platform, of: Scene, start: Packing, dt: float, steps: int) -> Mapping[str, float]:
    """Differences between collisions of PAIRS pairs at y = 0 and at the sides, relative to the largest values."""
    period = of.container.period
    shifted = replace(start, x=nearest_images(start.x + np.array([0.0, period / 2, 0.0]), period))
    second = shifted.x[PAIRS:, 1] * shifted.x[:PAIRS, 1]
    require(bool((second < 0).any()), "no pair lies across the sides")
    here, there = platform.run_all([MemberStart(of, dt, packing) for packing in (start, shifted)], 1, steps)
    turned = np.abs(here.end.omega - start.omega).max() / np.abs(here.end.omega).max()
    require(bool(turned > 0.01), "the pairs did not collide")
    branch = [nearest_images(motion.end.x[PAIRS:] - motion.end.x[:PAIRS], period) for motion in (here, there)]
    return {
        "velocity": _difference(here.end.v, there.end.v),
        "angular velocity": _difference(here.end.omega, there.end.omega),
        "branch": _difference(*branch),
    }


def _difference(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.abs(a - b).max() / np.abs(a).max())


def _spheres(platform: Platform) -> Mapping[str, float]:
    start = oblique(PAIRS, 0.2, seed=2)
    middle = (start.x[PAIRS:] + start.x[:PAIRS]) / 2
    start = replace(start, x=start.x - np.tile(middle * [0.0, 1.0, 0.0], (2, 1)))
    of = scene(2 * PAIRS, hertz(), _apart(PERIOD))
    dt = duration(of, 0.2) / 100
    return _across(platform, of, start, dt, 600)


def _rods(platform: Platform) -> Mapping[str, float]:
    """Rods that lie nearly along x and meet off their centres."""
    rng = np.random.default_rng(5)
    centres = np.array([[6 * ROD.extent * (k - PAIRS / 2), 0.0, 0.5] for k in range(PAIRS)])
    half = np.column_stack([rng.uniform(-0.4, 0.4, PAIRS), np.full(PAIRS, 0.6), np.zeros(PAIRS)]) * ROD.diameter
    v = np.column_stack([rng.normal(size=PAIRS) * 0.05, np.full(PAIRS, 0.2), rng.normal(size=PAIRS) * 0.05])
    along = np.array([1.0, 0.0, 0.0]) + rng.normal(size=(2 * PAIRS, 3)) * [0.0, 0.03, 0.03]
    start = Packing(
        x=np.concatenate([centres - half, centres + half]), v=np.concatenate([v, -v]),
        omega=rng.normal(size=(2 * PAIRS, 3)), q=turned_to(along / np.linalg.norm(along, axis=1)[:, None]),
    )  # fmt: skip
    soft = {"normal_stiffness": 2e3, "friction": 0.5, "restitution": 0.6, "rolling_friction": 0.01}
    return _across(platform, rods(2 * PAIRS, _apart(2.2 * ROD.extent), **soft), start, 6e-6, 1500)


def _bed() -> tuple[Scene, Packing]:
    """Grains that fall between periodic sides; walls have no friction, and so no force along y."""
    smooth = SurfaceChange(friction=0.0, rolling_friction=0.0)
    silo = Box(width=4 * D, depth=PERIOD, height=40 * D, periodic="y")
    of = scene(COUNT, hertz(shear_modulus=SOFT), silo, G, all=smooth)
    return of, place(of, "gas", 1)


def _frames(platform: Platform) -> Mapping[str, float]:
    of, start = _bed()
    along = np.array([0.0, 1.0, 0.0])
    shifted = replace(start, x=nearest_images(start.x + 0.37 * PERIOD * along, PERIOD))
    moving = replace(shifted, v=start.v + STREAM * along)
    errors = {}
    for name, steps in (("5 ms", 200), ("25 ms", 1000)):
        at = [platform.run(MemberStart(of, DT, packing), 1, steps).end for packing in (start, shifted, moving)]
        for frame, end, away in (("shifted", at[1], 0.0), ("moving", at[2], STREAM * DT * steps)):
            error = nearest_images(_by_id(end) - _by_id(at[0]) - (0.37 * PERIOD + away) * along, PERIOD)
            errors[f"{frame}, after {name}"] = float(np.abs(error).max() / D)
    return errors


def _by_id(packing: Packing) -> np.ndarray:
    return packing.x[np.argsort(_ids(packing))]


def _ids(packing: Packing) -> np.ndarray:
    assert packing.ids is not None
    return packing.ids


def _part(platform: Platform) -> Mapping[str, float]:
    """Spheres fly across the sides, in either sense, and meet a post in the middle of the box from behind."""
    post = Wall(name="post", shape=Frustum(lower=(D, 0.0), upper=(D, 10 * D)))
    of = scene(
        2, hertz(shear_modulus=SOFT, friction=0.0, restitution=1.0), _apart(8 * D).model_copy(update={"parts": (post,)})
    )
    x = np.array([[0.0, 2 * D, 4 * D], [0.0, -2.2 * D, 6 * D]])  # of two lengths of way, and far from each other
    start = grains_at(x, [[0.0, 0.5, 0.0], [0.0, -0.5, 0.0]])
    end = platform.run(MemberStart(of, 0.4 * DT, start), 1, 3500).end
    v = end.v[np.argsort(_ids(end))]
    return {"v'/v + 1": float(np.abs(v / 0.5 + start.v / 0.5)[:, 1].max())}


def _momentum(platform: Platform) -> Mapping[str, float]:
    of, start = _bed()
    motion = platform.run(MemberStart(of, DT, start), 20, 100, [LEDGER])
    p = of.grains.mass * np.abs(start.v).sum()
    return {"p_y": _largest_change(motion, "py") / p, "outside the box": _outside(motion)}


def _largest_change(motion: Trajectory, name: str) -> float:
    column = motion.rows(LEDGER)[name]
    require(float(motion.rows(LEDGER)["touching"][-1]) > COUNT, "the grains do not touch")
    return float(np.abs(column - motion.scene.grains.mass * _start_sum(motion)).max())


def _start_sum(motion: Trajectory) -> float:
    return float(_bed()[1].v[:, 1].sum())


def _outside(motion: Trajectory) -> float:
    return float(max(0.0, np.abs(motion.end.x[:, 1]).max() - PERIOD / 2) / D)


# positions are rounded to 1e-16 of the period at each of a thousand steps, and overlaps are 1e-3 of it
_AS_IN_THE_MIDDLE = {
    name: limited(1e-11, roundings=16 * 100, steps=600) for name in ("velocity", "angular velocity", "branch")
}
CASES = [
    Case(
        name="periodic-collision",
        statement="two spheres collide across periodic sides as they do in the middle: friction, damping, rolling",
        source="translation along y",
        measures=_AS_IN_THE_MIDDLE,
        run=_spheres,
    ),
    Case(
        name="periodic-rods",
        statement="two rods collide across periodic sides as they do in the middle",
        source="translation along y",
        measures=_AS_IN_THE_MIDDLE,
        run=_rods,
    ),
    Case(
        name="periodic-frames",
        statement="a bed between periodic sides, displaced along y, or moving along y at 1 m/s: the same motion",
        source="Galilei's principle",
        # as renumbering
        measures={
            f"{frame}, after {time}": limited(limit, "d", roundings=roundings, steps=steps)
            for frame in ("shifted", "moving")
            for time, limit, roundings, steps in (("5 ms", 1e-12, 8, 200), ("25 ms", 1e-9, 8000, 1000))
        },
        run=_frames,
    ),
    Case(
        name="periodic-part",
        statement="spheres that cross periodic sides meet what stands in the box: v' = -v from a smooth post",
        source="an elastic impact on a wall at rest",
        measures={"v'/v + 1": limited(1e-4)},
        run=_part,
    ),
    Case(
        name="periodic-momentum",
        statement="without a wall across y, a bed keeps its momentum along y; centres of grains stay in the box",
        source="Newton's third law",
        measures={"p_y": limited(5e-14, steps=2000), "outside the box": limited(0.0, "d")},
        run=_momentum,
    ),
]
