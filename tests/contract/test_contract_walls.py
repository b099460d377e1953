"""Members with more walls than a grain can be near: a floor of tiles, and walls far away."""

from itertools import pairwise

import numpy as np
import pytest
from labbook_reference import Backend
from platforms import Bundled, identical

from labbook.backend import Overflow
from labbook.backend.probes import Contacts
from labbook.checks.verify.materials import D, G, hertz
from labbook.checks.verify.symmetry import DT, SOFT
from labbook.scene import Plane, Primitives, Scene, Spheres, Spherocylinders, Strip, Wall
from labbook.scene.packing import Packing

TILE, TILES = D / 2, 40
"""Width of a tile [m]; a rod of 2 d is near no more than eight, all that there is room for."""
BEATS, STEPS, SPEED = 6, 250, 1.5
"""Of which a body slides over 5 d at this speed [m/s], ten tiles."""
ROUNDINGS = 5000
"""Allowed differences of positions [d] and velocities [m/s]: 1500 steps round a force three times each."""
SHAPES = {
    "sphere": Spheres(diameter=D, density=2500, count=1),
    "rod": Spherocylinders(diameter=D, length=2 * D, density=2500, count=1),
}
PLANE = Wall(name="floor", shape=Plane(point=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0)))


def tiled(shape: str) -> Scene:
    """A body on a floor of strips that meet edge to edge."""
    edges = TILE * (np.arange(TILES + 1) - TILES / 2)
    tiles = [Strip(start=(a, 0.0), end=(b, 0.0)) for a, b in pairwise(edges.tolist())]
    walls = tuple(Wall(name=f"tile-{k}", shape=tile) for k, tile in enumerate(tiles))
    law = hertz(shear_modulus=SOFT, friction=0.3)
    return Scene(grains=SHAPES[shape], contact=law, container=Primitives(parts=walls), gravity=G)


def with_far_walls(scene: Scene, many: int) -> Scene:
    """The scene with so many planes more, a metre below."""
    planes = [Plane(point=(0.0, 0.0, -1.0 - 1e-3 * k), normal=(0.0, 0.0, 1.0)) for k in range(many)]
    far = tuple(Wall(name=f"far-{k}", shape=plane) for k, plane in enumerate(planes))
    parts = (*far[: many // 2], *scene.container.walls(), *far[many // 2 :])
    return scene.model_copy(update={"container": Primitives(parts=parts)})


def sliding(scene: Scene) -> Packing:
    """The body lies on the floor, a rod askew, and slides."""
    askew = np.array([[np.cos(0.4), np.sin(0.4), 0.0, 0.0]])  # from upright by 0.8 rad
    half = scene.grains.overhang
    z = D / 2 + half * np.cos(0.8) + 1e-6
    q = askew if half else None
    return Packing(x=np.array([[0.3 * TILE, 0.0, z]]), v=np.array([[SPEED, 0.1, 0.0]]), omega=np.zeros((1, 3)), q=q)


def end(platform: Bundled, scene: Scene, start=None, beats: int = BEATS):
    """Packing and checkpoint after so many beats."""
    numerics = platform.numerics(DT, steps_per_beat=STEPS)
    ensemble = platform.backend.open(platform.backend.specialise(scene, numerics, (Contacts(),)), 1, platform.device)
    try:
        member = ensemble.admit(scene, numerics, sliding(scene) if start is None else start)
        assert not ensemble.advance(beats)
        (table,) = ensemble.drain().values()
        return ensemble.packing(member), ensemble.checkpoint(member), table
    finally:
        ensemble.close()


# rods at many walls compile kernels that no other test needs; test_reference_rods has their walls
@pytest.fixture(scope="module", params=["sphere", pytest.param("rod", marks=pytest.mark.ring)])
def shape(request, platform: Bundled) -> str:
    if {"sphere": "sphere", "rod": "spherocylinder"}[request.param] not in platform.backend.capabilities.shapes:
        pytest.skip("it has no such grains")
    if request.param == "rod" and platform.second:
        pytest.skip("rods are checked in one precision of a backend on a processor")
    return request.param


@pytest.fixture(scope="module")
def slid(platform: Bundled, shape: str):
    return end(platform, tiled(shape))


def test_a_body_slides_over_many_tiles_as_in_plain_python(platform: Bundled, shape: str, slid):
    plain = Bundled(Backend(), "double", "cpu")
    expected, _, _ = end(plain, tiled(shape))
    found, _, contacts = slid
    assert len(np.unique(contacts["wall"])) >= 3, "else nothing was handed over"
    assert expected.x[0, 0] > 8 * TILE
    limit = ROUNDINGS * float(np.finfo(np.float32 if platform.precision == "mixed" else np.float64).eps)
    assert np.abs(found.x - expected.x).max() / D < limit
    assert np.abs(found.v - expected.v).max() / SPEED < limit
    assert found.wall_name.tolist() == expected.wall_name.tolist()


def test_they_go_on_from_a_checkpoint_bit_for_bit(platform: Bundled, shape: str, slid):
    _, half_way, _ = end(platform, tiled(shape), beats=BEATS // 2)
    again, _, _ = end(platform, tiled(shape), half_way, BEATS - BEATS // 2)
    assert identical(again, slid[0])


def test_walls_that_no_grain_comes_near_change_no_bit(platform: Bundled, shape: str):
    scene = tiled(shape).model_copy(update={"container": Primitives(parts=(PLANE,))})
    few, _, _ = end(platform, scene)
    many, _, _ = end(platform, with_far_walls(scene, 2 * TILES))
    if platform.precision == "double":
        assert identical(few, many)
    else:  # another kernel, of which products and sums may be fused elsewhere
        assert np.abs(few.x - many.x).max() / D < ROUNDINGS * np.finfo(np.float32).eps
    assert abs(few.v[0, 0] - SPEED) > 0.01, "it was braked"


def test_springs_at_walls_come_along_in_a_packing(platform: Bundled, shape: str):
    scene = with_far_walls(tiled(shape).model_copy(update={"container": Primitives(parts=(PLANE,))}), 2 * TILES)
    first, _, _ = end(platform, scene, beats=2)
    assert first.wall_name.tolist().count("floor") == len(first.wall_name) > 0
    again, _, _ = end(platform, scene, first, 0)
    assert again.wall_name.tolist() == first.wall_name.tolist()
    assert again.wall_spring == pytest.approx(first.wall_spring, rel=1e-6)


def test_a_body_near_more_walls_than_there_is_room_for_is_told(platform: Bundled, shape: str):
    walls = tuple(PLANE.model_copy(update={"name": f"floor-{k}"}) for k in range(TILES))
    scene = tiled(shape).model_copy(update={"container": Primitives(parts=walls), "gravity": 0.0})
    told = ""
    try:
        end(platform, scene, beats=1)
    except Overflow as error:
        told = str(error)
    assert bool(told) == platform.crowds
    assert not told or ("near 40 walls, more than" in told and "use a thinner numerics.skin" in told)


def test_one_beside_a_member_with_more_walls_goes_on_alone(platform: Bundled, shape: str):
    """An eccentric outlet at the side wall has a plate less than others of the same study; a study that was
    interrupted may go on with these alone."""
    one = tiled(shape).model_copy(update={"container": Primitives(parts=(PLANE,))})
    more = with_far_walls(one, 3)
    numerics = platform.numerics(DT, steps_per_beat=STEPS)
    spec = platform.backend.specialise(one, numerics, (Contacts(),))
    assert spec == platform.backend.specialise(more, numerics, (Contacts(),)), "they share an ensemble"
    together = platform.backend.open(spec, 2, platform.device)
    try:
        together.admit(more, numerics, sliding(more))
        member = together.admit(one, numerics, sliding(one))
        assert not together.advance(BEATS // 2)
        half_way = together.checkpoint(member)
    finally:
        together.close()
    again, _, _ = end(platform, one, half_way, BEATS - BEATS // 2)
    whole, _, _ = end(platform, one)
    assert identical(again, whole)
