"""The geometry that walls and containers answer: each answer against the others, by the distance from walls and by
which points are inside. Vertices and ends of lines lie on a wall to rounding; a volume counted at N random points has
a standard error of at most 1/(2 sqrt N) of the box."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from labbook.scene import (
    Box,
    ConicalSilo,
    CylinderSilo,
    Frustum,
    Plane,
    Primitives,
    Strip,
    Wall,
    WedgeHopper,
)
from labbook.scene.container_shape import ContainerShape
from labbook.scene.geometry import Bounds, contour, extent, stands_over
from labbook.scene.walls import AT_REST, WallShape

SIZE = 0.1
ROUNDING = 1e-12
BED = Bounds((-SIZE, -0.3 * SIZE, -SIZE), (SIZE, 0.4 * SIZE, 2 * SIZE))
places = st.floats(-SIZE, SIZE).map(lambda x: round(x, 6))
lengths = st.floats(0.01 * SIZE, SIZE).map(lambda x: round(x, 6))
points = st.tuples(places, places)
planes = st.builds(
    lambda point, normal: Plane(point=point, normal=normal),
    st.tuples(places, places, places),
    st.one_of(
        st.sampled_from([(1, 0, 0), (0, -1, 0), (0, 0, 1), (0, 0, -2), (1, 0, 0.5), (0, 1, 1)]),
        st.tuples(*[st.floats(0.1, 1)] * 3),
    ),
)
strips = st.builds(lambda a, b: (a, b), points, points).filter(lambda ends: math.dist(*ends) > 0.01 * SIZE)
strips = strips.map(lambda ends: Strip(start=ends[0], end=ends[1]))
frustums = st.builds(lambda r, z, dr, dz: ((r, z), (r + dr, z + dz)), lengths, places, lengths | st.just(0.0), places)
frustums = frustums.filter(lambda ends: math.dist(*ends) > 0.01 * SIZE)
frustums = frustums.map(lambda ends: Frustum(lower=ends[0], upper=ends[1]))
plates = st.one_of(strips, frustums)
hoppers = st.builds(
    lambda orifice, angle, gap: WedgeHopper(
        width=SIZE, height=4 * SIZE, thickness=0.2 * SIZE, orifice=orifice * SIZE, angle=angle,
        gap=gap * (1 - orifice) * SIZE / 2,
    ),
    st.floats(0.05, 0.9), st.floats(0.3, math.pi / 2 - 0.01) | st.just(math.pi / 2), st.floats(0, 1),
)  # fmt: skip
cones = st.builds(
    lambda orifice, angle: ConicalSilo(diameter=SIZE, height=4 * SIZE, orifice=orifice * SIZE, angle=angle),
    st.floats(0.05, 0.9), st.floats(0.3, 1.5),
)  # fmt: skip
cylinders = st.builds(lambda d: CylinderSilo(diameter=SIZE, height=4 * SIZE, orifice=d * SIZE), st.floats(0.05, 0.9))
boxes = st.builds(lambda w, d, lid: Box(width=w, depth=d, height=SIZE, lid=lid), lengths, lengths, st.booleans())
containers = st.one_of(hoppers, cones, cylinders, boxes)
few = settings(max_examples=25)  # a property takes less than a second


def sampled(bounds: Bounds, n=20_000) -> np.ndarray:
    return np.random.default_rng(7).uniform(bounds.low, bounds.high, (n, 3))


@few
@given(st.one_of(planes, plates))
def test_meshes_and_sections_lie_on_their_wall(shape):
    mesh = shape.mesh(BED)
    if mesh is not None:
        assert np.abs(shape.distance(mesh.vertices)).max() < ROUNDING
        assert set(mesh.triangles.ravel()) <= set(range(len(mesh.vertices)))
        finite = np.where(np.isfinite(shape.bounds.low), shape.bounds.low, -np.inf)
        assert (mesh.vertices >= finite - ROUNDING).all()
        assert (mesh.vertices <= np.array(shape.bounds.high) + ROUNDING).all()
    for (x0, z0), (x1, z1) in shape.section(BED):
        line = np.linspace((x0, 0, z0), (x1, 0, z1), 5)
        assert np.abs(shape.distance(line)).max() < ROUNDING


@few
@given(st.one_of(planes, plates))
def test_a_plane_cut_out_of_a_mesh_is_the_section_of_the_wall(shape):
    """Facets of a frustum lie within it by r (1 - cos(pi/96)), less than 0.0006 r."""
    mesh = shape.mesh(BED)
    for line in mesh.section() if mesh is not None else ():
        ends = np.array([(x, 0.0, z) for x, z in line])
        assert np.abs(shape.distance(ends)).max() < 0.0006 * 2 * SIZE


@few
@given(plates)
def test_bounds_are_those_that_follow_from_the_distance(shape):
    found = extent(shape.distance)
    assert np.allclose(found.low, shape.bounds.low, atol=1e-7)
    assert np.allclose(found.high, shape.bounds.high, atol=1e-7)


@few
@given(planes)
def test_a_plane_limits_what_is_inside_only_across_an_axis(plane):
    """From its distance alone: the half-space in front of it."""
    limits, here = plane.enclosed, [k for k in range(3) if plane.normal[k]]
    ends = np.array([limits.low, limits.high])
    assert np.isfinite(ends).sum() == (len(here) == 1)
    if len(here) == 1:
        side = 0 if plane.normal[here[0]] > 0 else 1
        assert ends[side, here[0]] == plane.point[here[0]]


@few
@given(st.one_of(planes, plates))
def test_symmetries_leave_the_distance_as_it_is(shape):
    x = sampled(BED, 200)
    if "axial" in shape.symmetries:
        turned = np.column_stack([np.hypot(x[:, 0], x[:, 1]), 0 * x[:, 0], x[:, 2]])
        assert np.allclose(shape.distance(x), shape.distance(turned), atol=ROUNDING)
    if "planar" in shape.symmetries and not (shape.half_space and shape.normal[1]):
        assert np.allclose(shape.distance(x), shape.distance(x * (1, 0, 1)), atol=ROUNDING)
    mirrored = shape.mirrored()
    assert np.allclose(mirrored.distance(x * (-1, 1, 1)), shape.distance(x), atol=ROUNDING)


@few
@given(plates)
def test_what_stands_over_a_plate_is_found_by_its_distance_too(shape):
    """But for points within 1e-6 of its size from its edges."""
    bounds, x = shape.bounds, sampled(BED, 300)
    u = np.hypot(x[:, 0], x[:, 1]) if "axial" in shape.symmetries else x[:, 0]
    ends = [end[0] for end in shape.section()[0]]
    assume(abs(ends[0] - ends[1]) > 0.02 * SIZE)
    rise = (bounds.high[2] - bounds.low[2]) / abs(ends[0] - ends[1])
    assume(rise < 5)  # by steps as long as the distance, steep plates take many
    clear = np.min([np.abs(u - end) for end in ends], axis=0) > 1e-4 * SIZE
    clear &= shape.distance(x) > 1e-4 * SIZE
    assert np.array_equal(stands_over(shape.distance, bounds, x)[clear], shape.carries(x)[clear])
    assert not (shape.carries(x) & shape.covers(x)).any()


@few
@given(containers, st.floats(0.2, 3.0))
def test_the_volume_below_a_height_is_that_of_the_points_inside(container: ContainerShape, part):
    """Within five standard errors; above the bottom it grows by the area."""
    bounds, z = container.bounds, part * SIZE
    box = Bounds(bounds.low, (bounds.high[0], bounds.high[1], min(z, bounds.high[2])))
    z = box.high[2]
    x = sampled(box)
    share = container.inside(x).mean()
    whole = math.prod(box.size)
    volume = container.volume_below(z)
    assert volume is not None
    assert abs(volume - share * whole) < 5 * 0.5 / math.sqrt(len(x)) * whole
    assert container.area is not None
    above = container.volume_below(4 * SIZE + z) or 0.0
    straight = max(z, container.rise)
    assert above - (container.volume_below(straight) or 0.0) == pytest.approx(
        container.area * (4 * SIZE + z - straight)
    )


@few
@given(containers)
def test_bounds_spans_and_walls_of_a_container_agree(container: ContainerShape):
    bounds = container.bounds
    x = sampled(Bounds((-SIZE, -SIZE, -SIZE), (SIZE, SIZE, SIZE)))
    inside = x[container.inside(x)]
    assert (inside >= np.array(bounds.low) - ROUNDING).all()
    assert (inside[:, :2] <= np.array(bounds.high[:2]) + ROUNDING).all()
    for z in np.linspace(0.01 * SIZE, 0.9 * SIZE, 7):
        span = container.span(z)
        assert span is not None
        row = np.array([(u, 0.0, z) for u in np.linspace(-SIZE, SIZE, 501)])
        row = row[np.abs(row[:, :1] - span).min(axis=1) > 1e-9]
        assert np.array_equal(container.inside(row), (row[:, 0] > span[0]) & (row[:, 0] < span[1]))
    shapes = {wall.name: wall.shape for wall in container.walls()}
    for name, mesh in container.mesh(BED).items():
        assert np.abs(shapes[name].distance(mesh.vertices)).max() < ROUNDING
    for line in container.section():
        for end in line:
            here = np.array([(end[0], 0.0, end[1])])
            assert min(abs(shape.distance(here)[0]) for shape in shapes.values()) < ROUNDING


@few
@given(st.one_of(hoppers, cones, cylinders))
def test_what_lies_on_the_lid_of_an_outlet_is_let_out(container):
    (outlet,) = container.outlets
    assert outlet.lid is not None
    x = sampled(Bounds((-SIZE / 2, -SIZE / 2, 0.0), (SIZE / 2, SIZE / 2, 0.0)), 2000)
    x[:, 1] *= min(1.0, container.front_to_back / SIZE)
    assert np.array_equal(container.lets_out(x), outlet.lid.distance(x) < ROUNDING)
    across = outlet.centre + outlet.width * np.array([-0.499, 0.499])
    assert container.lets_out(np.array([(u, 0.0, 0.0) for u in across])).all()


class Tube(WallShape):
    """A wall of another package, of which nothing but its distance is known: a tube with two round ends, which holds
    grains inside."""

    physics = "elsewhere"
    kind: str = "tube"
    radius: float
    length: float

    def distance(self, x: np.ndarray) -> np.ndarray:
        axis = np.clip(x[:, 2], self.radius, self.radius + self.length)
        return self.radius - np.linalg.norm(x - np.stack([0 * axis, 0 * axis, axis], axis=1), axis=1)


class Ring(WallShape):
    """Another, a thin hoop that stands upright in the plane y = 0."""

    physics = "elsewhere"
    kind: str = "ring"
    radius: float

    def distance(self, x: np.ndarray) -> np.ndarray:
        return np.hypot(np.hypot(x[:, 0], x[:, 2]) - self.radius, x[:, 1])


def test_a_wall_of_which_only_the_distance_is_known_has_bounds_mesh_and_section():
    tube = Tube.of(kind="tube", radius=0.02, length=0.05)
    assert tube.bounds.low == pytest.approx((-0.02, -0.02, 0.0), abs=1e-7)
    assert tube.bounds.high == pytest.approx((0.02, 0.02, 0.09), abs=1e-7)
    assert tube.enclosed == tube.bounds
    assert tube.ground == pytest.approx(0, abs=1e-7)
    mesh = tube.mesh(BED)
    assert mesh is not None
    assert np.abs(tube.distance(mesh.vertices)).max() < 1e-9
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()
    assert area == pytest.approx(4 * math.pi * 0.02**2 + 2 * math.pi * 0.02 * 0.05, rel=0.01), "chords are shorter"
    length = sum(math.dist(*line) for line in tube.section())
    assert length == pytest.approx(2 * math.pi * 0.02 + 2 * 0.05, rel=0.01)


def test_a_thin_wall_of_which_only_the_distance_is_known_has_a_mesh_that_lies_on_it():
    ring = Ring.of(kind="ring", radius=0.03)
    mesh = contour(ring.distance, ring.bounds)
    assert mesh is not None
    assert np.abs(ring.distance(mesh.vertices)).max() < 1e-5
    assert np.ptp(mesh.vertices, axis=0) == pytest.approx((0.06, 0, 0.06), abs=1e-4)
    assert all(ring.enclosed.endless), "it holds nothing in"


def lid(name, start, end, z=0.0):
    return Wall.of(name=name, shape=Strip(start=(start, z), end=(end, z)), motion=AT_REST, opens="start", moves=None)


def outlets(*parts) -> list[str]:
    container = Primitives(parts=parts, outlet_plane=0.0)
    assert container.outlets == container.close().outlets
    return [outlet.name for outlet in container.outlets]


def test_lids_that_lie_apart_in_the_outlet_plane_are_outlets():
    assert outlets() == ["outlet"]
    assert outlets(lid("a", -0.03, -0.01)) == ["outlet"], "one needs no name"
    assert outlets(lid("a", -0.03, -0.01), lid("b", 0.01, 0.03)) == ["a", "b"]
    assert outlets(lid("a", -0.03, -0.01), lid("b", -0.01, 0.03)) == ["outlet"], "two halves of one lid"
    assert outlets(lid("a", -0.03, -0.01), lid("b", 0.01, 0.03), lid("gate", -0.02, 0.02, z=0.2)) == ["a", "b"]
