"""Plates with a thick, rounded edge, and lips of outlets: distances, shape, limits, keys."""

import itertools
import math

import numpy as np
import pytest
from labbook_dem.dispatch import PlainWall
from labbook_dem.words import vec3
from pydantic import ValidationError

from labbook.filling.opening import start_of_discharge
from labbook.lab.identity import scene_key
from labbook.scene import ConicalSilo, CylinderSilo, HertzMindlin, Scene, Spheres, Spherocylinders, WedgeHopper
from labbook.scene.geometry import Bounds
from labbook.scene.packing import Packing
from labbook.scene.thick_plate import Lip, ThickPlate

SLANT = math.radians(55)
CONTAINERS = [
    CylinderSilo(diameter=0.1, height=0.3, orifice=0.03, lip=Lip(radius=4e-3)),
    CylinderSilo(diameter=0.1, height=0.3, orifice=0.03, lip=Lip(thickness=8e-3)),
    ConicalSilo(diameter=0.1, height=0.3, orifice=0.03, angle=SLANT, lip=Lip(radius=4e-3, thickness=12e-3)),
    WedgeHopper(width=0.1, height=0.3, orifice=0.03, thickness=0.01, angle=SLANT, gap=0.02, lip=Lip(radius=3e-3)),
    WedgeHopper(width=0.1, height=0.3, orifice=0.03, thickness=0.01, lip=Lip(radius=3e-3, thickness=9e-3)),
]


def plates(container) -> list[ThickPlate]:
    return [wall.shape for wall in container.walls() if isinstance(wall.shape, ThickPlate)]


def scene(container, grains=None) -> Scene:
    grains = grains or Spheres(diameter=3e-3, density=2500, count=10)
    return Scene(grains=grains, contact=HertzMindlin(shear_modulus=1e7, poisson_ratio=0.25), container=container)


@pytest.mark.parametrize("container", CONTAINERS)
def test_the_surface_lies_at_a_distance_of_zero_and_begins_on_the_thin_plate(container):
    thin = {wall.name: wall.shape for wall in container.model_copy(update={"lip": None}).walls()}
    names = [wall.name for wall in container.walls() if isinstance(wall.shape, ThickPlate)]
    for name, plate in zip(names, plates(container), strict=True):
        profile = np.array([(u, 0.0, z) for u, z in plate.profile])
        assert np.abs(plate.distance(profile)).max() < 1e-12
        upper = np.array([(u, 0.0, z) for u, z in plate.upper_side])
        assert np.abs(thin[name].distance(upper)).max() < 1e-12
        low = min(z for _, z in plate.profile)
        assert low == pytest.approx(-container.lip.height(getattr(container, "angle", math.pi / 2)))


@pytest.mark.parametrize("container", CONTAINERS)
def test_the_orifice_is_the_narrowest_width(container):
    """Along the edge, by the outlines that pictures show."""
    edges = [u - getattr(container, "eccentricity", 0.0) for plate in plates(container) for u, _ in plate.profile]
    assert min(map(abs, edges)) == pytest.approx(container.orifice / 2, abs=1e-12)
    wide = max(abs(x) for x in np.linspace(0, 0.05, 5001) if container.lets_out(_at(container, x))[0])
    angle = getattr(container, "angle", math.pi / 2)
    at_plane = [abs(p[0] - getattr(container, "eccentricity", 0.0)) for p in _crossings_of_zero(plates(container)[0])]
    assert wide == pytest.approx(min(at_plane), abs=2e-4)  # chords of 7.5 deg
    assert wide == pytest.approx(container.orifice / 2 + container.lip.widening(angle), abs=2e-5)


def _at(container, x: float) -> np.ndarray:
    return np.array([[x + getattr(container, "eccentricity", 0.0), 0.0, 0.0]])


def _crossings_of_zero(plate: ThickPlate) -> list[tuple[float, float]]:
    found = []
    for (u, z), (u1, z1) in itertools.pairwise(plate.profile):
        if max(z, z1) >= -1e-15 and min(z, z1) <= 0 and (z != z1):
            found.append((u + (u1 - u) * (0 - z) / (z1 - z), 0.0))
    return found


@pytest.mark.parametrize("container", CONTAINERS)
def test_contacts_have_the_nearest_point_of_the_surface(container):
    """Formulas of the backends against a dense outline of the surface; the outline's chords set the tolerance."""
    rng = np.random.default_rng(1)
    for plate in plates(container):
        wall = PlainWall(plate)
        u = plate.edge[0] + rng.uniform(-8e-3, 8e-3, 200)
        z = rng.uniform(-8e-3, 8e-3, 200)
        phi = rng.uniform(-math.pi, math.pi, 200) if plate.turned else np.zeros(200)
        x = np.column_stack([u * np.cos(phi), u * np.sin(phi) if plate.turned else rng.uniform(-1, 1, 200), z])
        outside = plate.distance(x) > 0
        dense = _dense(plate)
        for place, r, height in zip(x[outside], u[outside], z[outside], strict=True):
            distance, normal = wall.distance(vec3(*place))
            assert distance == pytest.approx(plate.distance(place[None])[0], abs=1e-15)
            nearest = dense[np.argmin(np.hypot(dense[:, 0] - abs(r), dense[:, 1] - height))] if plate.turned else (
                dense[np.argmin(np.hypot(dense[:, 0] - r, dense[:, 1] - height))])  # fmt: skip
            foot = np.array([place[0] - distance * normal.x, place[1] - distance * normal.y])
            foot_u = np.hypot(*foot) if plate.turned else foot[0]
            assert distance <= math.hypot(nearest[0] - (abs(r) if plate.turned else r), nearest[1] - height) + 1e-9
            assert foot_u == pytest.approx(nearest[0], abs=2e-4)
            assert place[2] - distance * normal.z == pytest.approx(nearest[1], abs=2e-4)
            assert math.hypot(normal.x, normal.y, normal.z) == pytest.approx(1, abs=1e-12)


def _dense(plate: ThickPlate) -> np.ndarray:
    """Points of the whole outline: all round both lines at the radius."""
    points: list[np.ndarray] = []
    angles = np.linspace(0, 2 * math.pi, 1441)
    circle = plate.radius * np.column_stack([np.cos(angles), np.sin(angles)])
    for start, end in ((plate.far, plate.edge), (plate.edge, plate.foot)):
        points += [start + circle, end + circle]
        along = np.subtract(end, start)
        if (length := np.hypot(*along)) > 0:
            normal = np.array([-along[1], along[0]]) / length * plate.radius
            line = np.linspace(start, end, 4001)
            points += [line + normal, line - normal]
    everywhere = np.concatenate(points)
    away = plate.distance(np.column_stack([everywhere[:, 0], np.zeros(len(everywhere)), everywhere[:, 1]]))
    return everywhere[away > -1e-9]


def test_a_closed_silo_has_no_lip_and_the_open_one_goes_on_below_it():
    silo = CONTAINERS[2]
    assert silo.sink == pytest.approx(-12e-3)
    assert silo.close().lip is None
    assert silo.close().sink is None
    plain = silo.model_copy(update={"lip": None, "sink": None})
    assert scene_key(scene(silo).close()) == scene_key(scene(plain).close()), "they share beds"
    deeper = ConicalSilo(diameter=0.1, height=0.3, orifice=0.03, angle=SLANT, lip=Lip(radius=4e-3), sink=-0.05)
    assert deeper.sink == -0.05


def test_a_lip_that_changes_nothing_is_none():
    plain = CylinderSilo(diameter=0.1, height=0.3, orifice=0.03)
    thin = CylinderSilo(diameter=0.1, height=0.3, orifice=0.03, lip=Lip())
    assert thin == plain
    assert scene_key(scene(thin)) == scene_key(scene(plain))
    assert scene_key(scene(CONTAINERS[0])) != scene_key(scene(plain))
    assert "lip" not in plain.model_dump()


def test_springs_of_a_flat_bottom_go_to_its_parts_with_a_lip():
    """Beside the rounded edge they stay; those over the edge and the outlet vanish."""
    hopper = CONTAINERS[4]
    flat = hopper.close()
    x = np.array([[-0.04, 0, 1.5e-3], [-0.016, 0, 1.5e-3], [0.0, 0, 1.5e-3], [0.03, 0, 1.5e-3]])
    springs = np.ones((4, 3))
    packing = Packing(
        x=x, v=np.zeros((4, 3)), omega=np.zeros((4, 3)), wall_name=np.array(["bottom"] * 4, "U40"),
        wall_grain=np.arange(4), wall_spring=springs, wall_part=np.zeros(4, int),
    )  # fmt: skip
    grains = Spheres(diameter=3e-3, density=2500, count=4)
    start = start_of_discharge(packing, scene(flat, grains), scene(hopper, grains))
    assert start.wall_name.tolist() == ["bottom-left", "bottom-right"]
    assert start.wall_grain.tolist() == [0, 3]


@pytest.mark.parametrize(
    ("lip", "reason"),
    [
        ({"radius": 4e-3, "thickness": 7e-3}, "no room for a radius of 4 mm; use at least 8 mm"),
        ({"radius": 36e-3}, "leaves nothing of the bottom; use less than 35 mm"),
    ],
)
def test_impossible_lips_are_refused(lip, reason):
    with pytest.raises(ValidationError, match=reason.split(";")[0]):
        CylinderSilo(diameter=0.1, height=0.3, orifice=0.03, lip=Lip(**lip))


def test_rods_have_no_contacts_with_lips():
    rods = Spherocylinders(diameter=3e-3, length=9e-3, density=2500, count=10)
    with pytest.raises(ValidationError, match="no contacts with rods"):
        scene(CONTAINERS[0], rods)


def test_pictures_have_the_lip():
    box = Bounds((-0.1, -0.005, -0.1), (0.1, 0.005, 0.3))
    for container in CONTAINERS:
        for plate in plates(container):
            mesh = plate.mesh(box)
            assert mesh is not None
            assert np.abs(plate.distance(mesh.vertices)).max() < 1e-9
            assert plate.section()
            assert plate.mirrored().mirrored() == plate
