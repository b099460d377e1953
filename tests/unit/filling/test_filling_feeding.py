"""Where grains that left come back: above the bed, free of it, of walls and of one another."""

# a packing need not have ids, orientations and diameters; those of these tests do
# pyright: reportOptionalMemberAccess=false, reportOptionalSubscript=false, reportArgumentType=false
# pyright: reportAttributeAccessIssue=false, reportCallIssue=false, reportOptionalOperand=false

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import KDTree

from labbook.filling import Feeder, PlacingError, Refill, place, refill
from labbook.scene import (
    BedTop,
    ConicalSilo,
    CylinderSilo,
    Feed,
    HertzMindlin,
    Packing,
    Scene,
    Spheres,
    Spherocylinders,
    Uniform,
    WedgeHopper,
)
from labbook.scene.orientation import axes, distances

D = 3e-3
FLAT = WedgeHopper(width=0.06, height=0.4, thickness=1.01 * D, orifice=0.024)
STEEP = FLAT.model_copy(update={"angle": math.radians(30)})
ROUND = CylinderSilo(diameter=0.03, height=0.4, orifice=0.012)
CONE = ConicalSilo(diameter=0.03, height=0.4, angle=math.radians(45), orifice=0.012)
EQUAL = Spheres(diameter=D, density=2500, count=120)
GRADED = EQUAL.model_copy(update={"size": Uniform(smallest=D / 3)})
RODS = Spherocylinders(diameter=D, length=2.5 * D, density=2500, count=60)


def fed(container, grains=EQUAL) -> Scene:
    law = HertzMindlin(shear_modulus=1e7, poisson_ratio=0.25)
    return Scene(grains=grains, contact=law, container=container, feed=Feed(kind="reinject"))


def without(packing: Packing, away: np.ndarray) -> Packing:
    """The same without the grains `away`, as if they had left."""
    kept = ~np.isin(packing.ids, away)
    own = {name: array[kept] for name in ("q", "diameter", "kind") if (array := getattr(packing, name)) is not None}
    return Packing(packing.x[kept], packing.v[kept], packing.omega[kept], ids=packing.ids[kept], **own)


SCENES = [
    *((fed(container), "rain") for container in (FLAT, STEEP, ROUND, CONE)),
    (fed(FLAT), "planar"),
    (fed(ROUND, GRADED), "rain"),
    (fed(CylinderSilo(diameter=0.05, height=0.6, orifice=0.03), RODS), "rain"),
]


def returning(feeder: Feeder, there: Packing, beat: int) -> Packing | None:
    return refill([Refill(feeder, BedTop.of(there, feeder.floor), beat)])[0]


@pytest.mark.parametrize(("scene", "fill"), SCENES)
def test_grains_come_back_free_of_all_others(scene, fill):
    start = place(scene.close(), fill, 1)
    away = np.arange(0, len(start), 3)
    feeder, there = Feeder(scene, start, fill, 1), without(start, away)
    back = returning(feeder, there, 5)
    assert back is not None
    assert np.array_equal(back.ids, away), "all of them find a place"
    half, radius = scene.grains.half_length, scene.grains.radius
    own = start.rows(back.ids)
    size = np.full(len(start), 2 * radius) if start.diameter is None else start.diameter
    assert back.diameter is None or np.array_equal(back.diameter, start.diameter[own])
    everyone = np.concatenate([back.x, there.x])
    radii = np.concatenate([size[own], size[start.rows(there.ids)]]) / 2
    a = np.concatenate([axes(back.q), axes(there.q)]) if back.q is not None else np.zeros_like(everyone)
    pairs = KDTree(everyone).query_pairs(2 * (half + radius), output_type="ndarray")
    i, j = pairs[pairs[:, 0] < len(back)].T
    apart = (
        distances(everyone[i] - everyone[j], a[i], a[j], half)
        if half
        else np.linalg.norm(everyone[i] - everyone[j], axis=1)
    )
    assert (apart > radii[i] + radii[j]).all()
    for wall in scene.container.walls():
        for end in (back.x + half * a[: len(back)], back.x - half * a[: len(back)]):
            assert (wall.shape.distance(end) > radii[: len(back)]).all()
    top = (start.x[:, 2] + size[start.rows(start.ids)] / 2).max()
    assert (back.x[:, 2] > top).all()
    assert not back.v.any()
    assert not back.omega.any()
    assert fill != "planar" or not back.x[:, 1].any()


def test_beat_and_seed_decide_where():
    scene = fed(FLAT)
    start = place(scene.close(), "rain", 1)
    there = without(start, np.arange(10))
    feeder = Feeder(scene, start, "rain", 1)
    first, again = returning(feeder, there, 3), returning(Feeder(scene, start, "rain", 1), there, 3)
    assert np.array_equal(first.x, again.x)
    assert not np.array_equal(first.x, returning(feeder, there, 4).x)
    assert not np.array_equal(first.x, returning(Feeder(scene, start, "rain", 2), there, 3).x)
    assert returning(feeder, start, 3) is None


@pytest.mark.parametrize("scene", [fed(FLAT), fed(CylinderSilo(diameter=0.05, height=0.6, orifice=0.03), RODS)])
def test_beds_that_are_refilled_together_do_not_see_each_other(scene):
    """Beds of one room, of another one, and a full one: each gets what it gets alone, to the last bit."""
    beds = []
    for seed, within in [(1, scene), (2, scene), (3, fed(ROUND)), (4, scene)]:
        start = place(within.close(), "rain", seed)
        there = start if seed == 4 else without(start, np.arange(0, len(start), 1 + seed))
        beds.append(Refill(Feeder(within, start, "rain", seed), BedTop.of(there), 7))
    together = refill(beds)
    assert [grains is None for grains in together] == [False, False, False, True]
    for bed, grains in zip(beds[:3], together, strict=False):
        alone = refill([bed])[0]
        assert np.array_equal(grains.x, alone.x)
        assert np.array_equal(grains.ids, alone.ids)
        assert grains.q is None or np.array_equal(grains.q, alone.q)


def test_they_are_spread_evenly_and_fall_a_short_way():
    """Of 40 grains in 20 d width the highest are put up within some four layers."""
    scene = fed(FLAT)
    start = place(scene.close(), "rain", 1)
    feeder, there = Feeder(scene, start, "rain", 1), without(start, np.arange(40))
    x = np.concatenate([returning(feeder, there, beat).x for beat in range(1, 40)])
    assert x[:, 2].max() < feeder.level + 8 * D
    assert abs(x[:, 0].mean()) < 4 * 0.06 / math.sqrt(12 * len(x))


def test_grains_that_find_no_place_wait():
    """Side walls leave room for some layers only; those that are up there already keep others out."""
    scene = fed(FLAT)
    start = place(scene.close(), "rain", 1)
    level = start.x[:, 2].max() + D / 2
    low = fed(FLAT.model_copy(update={"height": float(level) + 4.01 * D}))
    away = np.arange(100)
    there = without(start, away)
    feeder = Feeder(low, start, "rain", 1)
    first = returning(feeder, there, 1)
    assert 20 < len(first) < 100
    assert (first.x[:, 2] < low.container.height).all()
    both = replace(
        there,
        **{name: np.concatenate([getattr(there, name), getattr(first, name)]) for name in ("x", "v", "omega", "ids")},
    )
    second = returning(feeder, both, 2)
    assert second is None or len(second) < 10


def test_without_room_above_the_bed_it_is_refused():
    scene = fed(FLAT)
    start = place(scene.close(), "rain", 1)
    low = fed(FLAT.model_copy(update={"height": float(start.x[:, 2].max())}))
    with pytest.raises(PlacingError, match=r"no room for fed grains; raise container\.height"):
        Feeder(low, start, "rain", 1)
