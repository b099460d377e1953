"""Whether grains can leave a container of single walls while it is filled: gaps of known width, in every symmetry.

A sphere passes a gap that is wider than its diameter, and no narrower one. The grid has 12 nodes in a diameter, so gaps
from 15 % too narrow and from 15 % too wide are told apart.
"""

import numpy as np
import pytest

from labbook.filling import PlacingError
from labbook.filling.leaks import leak
from labbook.scene import Frustum, HertzMindlin, Plane, Primitives, Scene, Spheres, Spherocylinders, Strip, Wall
from labbook.scene.walls import AT_REST, WallShape

D = 3e-3
WIDE, NARROW = 1.15 * D, 0.85 * D


def plane(name, point, normal):
    return Wall(name=name, shape=Plane(point=point, normal=normal))


def strip(name, start, end, **more):
    return Wall(name=name, shape=Strip(start=start, end=end), **more)


def ring(name, lower, upper, **more):
    return Wall(name=name, shape=Frustum(lower=lower, upper=upper), **more)


def closed(*parts, grains=None, count=300, outlet: float | None = 0.0):
    grains = grains or Spheres(diameter=D, density=2500, count=count)
    law = HertzMindlin(shear_modulus=1e7, poisson_ratio=0.25)
    return Scene(grains=grains, contact=law, container=Primitives(parts=parts, outlet_plane=outlet)).close()


def sides(depth=1.01 * D):
    return (
        plane("front", (0, -depth / 2, 0), (0, 1, 0)),
        plane("back", (0, depth / 2, 0), (0, -1, 0)),
        plane("left", (-12 * D, 0, 0), (1, 0, 0)),
        plane("right", (12 * D, 0, 0), (-1, 0, 0)),
    )


def slot(gap, depth=1.01 * D, at=3 * D):
    """A floor with a gap about x = `at`."""
    return (*sides(depth), strip("a", (-12 * D, 0), (at - gap / 2, 0)), strip("b", (at + gap / 2, 0), (12 * D, 0)))


def cone(gap):
    """Its hole is `gap` wide."""
    return ring("side", (9 * D, 9 * D), (9 * D, 40 * D)), ring("cone", (gap / 2, 0), (9 * D, 9 * D))


def tilted(gap):
    """A slot with a wall that has no symmetry: the grid fills the space."""
    return (*slot(gap, depth=4 * D), plane("tilted", (-12 * D, 0, 0), (1, 0.5, 0.2)))


@pytest.mark.parametrize("container", [slot, cone])
def test_gaps_as_wide_as_a_grain_are_found(container):
    found = leak(closed(*container(WIDE)))
    assert found is not None
    assert found.certain
    assert leak(closed(*container(NARROW))) is None


@pytest.mark.slow
def test_without_a_symmetry_the_grid_is_coarser_and_tells_less():
    found = leak(closed(*tilted(1.4 * D)))
    assert found is not None
    assert found.certain
    assert leak(closed(*tilted(0.7 * D))) is None


def test_a_leak_is_told_where_it_is():
    found = leak(closed(*slot(2 * D)))
    assert found is not None
    assert abs(found.at[0] - 3 * D) <= D / 4
    assert found.at[2] == 0


def test_a_gap_that_the_grid_cannot_judge_is_undecided():
    found = leak(closed(*slot(D)))
    assert found is not None
    assert not found.certain


def test_the_smallest_grains_and_the_diameter_of_rods_count():
    from labbook.scene import Uniform

    mixed = Spheres(diameter=D, density=2500, count=300, sizes=Uniform(smallest=D / 2))
    found = leak(closed(*slot(0.7 * D), grains=mixed))
    assert found is not None
    assert found.certain
    rods = Spherocylinders(diameter=D, length=3 * D, density=2500, count=300)
    found = leak(closed(*slot(WIDE), grains=rods))
    assert found is not None
    assert found.certain
    assert leak(closed(*slot(NARROW), grains=rods)) is None


def test_what_opens_closes_while_filling():
    lid = strip("lid", (1 * D, 0), (5 * D, 0), opens="start")
    assert leak(closed(*slot(4 * D), lid)) is None
    short = strip("lid", (1 * D, 0), (3.5 * D, 0), opens="start")
    found = leak(closed(*slot(4 * D), short))
    assert found is not None
    assert 3.5 * D < found.at[0] < 5 * D


def test_a_roof_over_the_outlet_hides_nothing_unless_it_is_tight():
    below = [strip("l", (-12 * D, 6 * D), (0, 9 * D)), strip("r", (0, 9 * D), (12 * D, 6 * D))]
    assert leak(closed(*slot(3 * D), *below)) is not None, "grains start under it, above the floor"
    shelf = [strip("shelf", (-12 * D, 6 * D), (12 * D, 6 * D), opens="start")]
    assert leak(closed(*slot(3 * D), *shelf)) is None


def test_without_an_outlet_plane_there_is_nothing_to_reach():
    assert leak(closed(*slot(3 * D), outlet=None)) is None


class Ball(WallShape):
    """A wall of another package: a ball that plugs the outlet."""

    physics = "elsewhere"
    kind: str = "ball"
    radius: float

    def distance(self, x: np.ndarray) -> np.ndarray:
        return np.abs(np.linalg.norm(x - (3 * D, 0, 0), axis=1) - self.radius)


@pytest.mark.slow
def test_walls_of_other_packages_count_by_their_distance():
    def plugged(radius):
        ball = Wall.of(name="ball", shape=Ball(radius=radius), motion=AT_REST, opens=None, moves=None)
        scene, walls = closed(*slot(4 * D, depth=3 * D)), slot(4 * D, depth=3 * D)
        more = {"closed": False, "sink": None, "planes": ()}
        silo = Primitives.of(kind="primitives", parts=(*walls, ball), outlet_plane=0.0, **more)
        return scene.model_copy(update={"container": silo})

    assert leak(plugged(2.5 * D)) is None
    found = leak(plugged(0.5 * D))
    assert found is not None
    assert found.certain


def test_what_has_no_room_says_so():
    with pytest.raises(PlacingError, match="across"):
        leak(closed(strip("floor", (-1, 0), (1, 0))))


def test_large_containers_without_a_symmetry_stay_undecided():
    high = [strip("left-side", (-12 * D, 0), (-12 * D, 4000 * D)), strip("right-side", (12 * D, 0), (12 * D, 4000 * D))]
    assert leak(closed(*slot(NARROW), *high)) is None, "upright walls end nothing"
    far = plane("tilted", (-1000 * D, 0, 0), (1, 0.5, 0.2))
    floor = strip("floor", (-500 * D, 0), (500 * D, 0))
    walls = [plane("l", (-500 * D, 0, 0), (1, 0, 0)), plane("r", (500 * D, 0, 0), (-1, 0, 0))]
    depth = [plane("f", (0, -50 * D, 0), (0, 1, 0)), plane("b", (0, 50 * D, 0), (0, -1, 0))]
    found = leak(closed(floor, *walls, *depth, far, count=10**5))
    assert found is not None
    assert not found.certain, "a grid of MOST nodes is too coarse for it"
    assert found.spacing > D
