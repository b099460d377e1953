"""Clumps of spheres as grains of a scene: mass and moments of the union, body frame, faults."""

import math

import numpy as np
import pytest
from labbook_dem.features import capabilities, specialise
from pydantic import ValidationError

from labbook.backend import Unsupported
from labbook.backend.numerics import Numerics
from labbook.scene import Box, Clumps, LinearSpringDashpot, Scene, Spheres, Spherocylinders
from labbook.scene.drawing import svg
from labbook.scene.hulls import overlapping, upper_reach
from labbook.scene.orientation import random_turns, rotated
from labbook.scene.sphere_union import principal, union_properties

R = 1.5e-3
AXES = [np.array([0.0, 0, 1]), np.array([1.0, 0, 0]), np.array([0.36, 0.48, 0.8])]


def pair(apart: float, axis: np.ndarray) -> tuple[tuple[float, float, float], ...]:
    at = (apart / 2 * axis).tolist()
    return (-at[0], -at[1], -at[2]), (at[0], at[1], at[2])


def lens(apart: float) -> tuple[float, float, float]:
    """Volume of the union of two spheres of radius R, and its moments across and along the line of centres at density
    1, by the polynomial f(z) = R^2 - (z - a)^2, the squared radius of the section of one half, a = apart/2: V =
    2 pi int f, I_along = pi int f^2, I_across = 2 pi int (f^2/4 + z^2 f), from 0 to a + R."""
    f = np.polynomial.Polynomial([R**2 - (apart / 2) ** 2, apart, -1.0])
    z = np.polynomial.Polynomial([0.0, 1.0])

    def integral(p):
        return p.integ()(apart / 2 + R) - p.integ()(0)

    return (2 * math.pi * integral(f), 2 * math.pi * integral(f * f / 4 + z * z * f), math.pi * integral(f * f))


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("apart", [0.1 * R, R, 1.98 * R, 2 * R])
def test_two_spheres_have_the_volume_and_moments_of_their_union(apart, axis):
    union = union_properties(pair(apart, axis), (R, R))
    volume, across, along = lens(apart)
    # twelve digits are kept
    assert volume == pytest.approx(8 * math.pi * R**3 / 3 - math.pi * (4 * R + apart) * (2 * R - apart) ** 2 / 12)
    assert union.volume == pytest.approx(volume, rel=1e-11)
    assert union.moments == pytest.approx((across, across, along), rel=1e-11)
    assert union.centre == pytest.approx((0, 0, 0), abs=1e-11 * R)
    assert np.abs(union.axes[2]) == pytest.approx(axis, abs=1e-11)
    assert union.bare == pytest.approx(((2 * R + apart) / (4 * R),) * 2, rel=1e-6)  # caps, by their heights


def test_the_centre_of_unequal_spheres_that_touch_is_that_of_their_masses():
    union = union_properties(((0.0, 0, 0), (0.0, 1.5 * R, 0)), (R, R / 2))
    assert union.centre[1] == pytest.approx(1.5 * R / 9, rel=1e-11)
    assert union.volume == pytest.approx(4 / 3 * math.pi * R**3 * 9 / 8, rel=1e-11)


def test_the_quadrature_of_eight_spheres_has_converged_and_agrees_with_random_points():
    rng = np.random.default_rng(3)
    centres, radii = rng.normal(size=(8, 3)) * 0.7 * R, rng.uniform(0.6, 1, 8) * R
    given = tuple(map(tuple, centres.tolist())), tuple(radii.tolist())
    union, finer = union_properties(*given), union_properties(*given, 48)
    assert union.volume == pytest.approx(finer.volume, rel=1e-11)
    assert union.moments == pytest.approx(finer.moments, rel=1e-11)
    points = rng.uniform(-4 * R, 4 * R, (400_000, 3))
    inside = np.any([np.sum((points - c) ** 2, axis=1) < r * r for c, r in zip(centres, radii, strict=True)], axis=0)
    body = (points[inside] - union.centre) @ np.array(union.axes).T
    volume = inside.mean() * (8 * R) ** 3
    second = body.T @ body / len(body) * volume
    error = 5 / math.sqrt(inside.sum())  # five standard errors
    assert union.volume == pytest.approx(volume, rel=error)
    assert np.diag(np.trace(second) * np.eye(3) - second) == pytest.approx(union.moments, rel=error)
    assert np.abs(second - np.diag(np.diag(second))).max() < error * np.trace(second)


def test_axes_that_symmetry_leaves_open_are_those_of_the_study():
    a = 0.6 * R
    tetrahedron = ((a, a, a), (a, -a, -a), (-a, a, -a), (-a, -a, a))
    assert union_properties(tetrahedron, (R,) * 4).axes == ((1, 0, 0), (0, 1, 0), (0, 0, 1))


def test_principal_axes_are_a_right_handed_frame_that_diagonalises():
    rng = np.random.default_rng(1)
    for _ in range(50):
        root = rng.normal(size=(3, 3))
        matrix = root @ root.T
        values, axes = principal(matrix)
        assert axes @ matrix @ axes.T == pytest.approx(np.diag(values), abs=1e-10 * np.trace(matrix))
        assert np.linalg.det(axes) == pytest.approx(1)
        assert values == pytest.approx(np.linalg.eigvalsh(matrix), rel=1e-9)


def clump(**changed) -> Clumps:
    given = {"diameter": "3 mm", "centres": [["0 d", "0 d", "-0.4 d"], "[0, 0, 0.4] d"], "density": "1200 kg/m^3"}
    return Clumps.model_validate({**given, "count": 5, **changed}, context={"units": "required"})


def test_a_study_states_centres_in_diameters_or_in_other_units():
    assert clump() == clump(centres=["[0, 0, -1.2] mm", ["0 mm", "0 mm", "1.2 mm"]])
    assert '"diameters"' not in clump().model_dump_json()


def test_mass_and_sizes_follow_from_the_union_wherever_the_study_puts_its_origin():
    grains = clump(diameters=["3 mm", "2.4 mm"])
    moved = clump(diameters=["3 mm", "2.4 mm"], centres=["[5, 5, -1.2] mm", "[5, 5, 1.2] mm"])
    assert grains.mass == pytest.approx(1200 * grains.volume)
    for name in ("mass", "inertia", "inertia_axis", "largest_inertia", "reach", "extent"):
        assert getattr(moved, name) == pytest.approx(getattr(grains, name), rel=1e-10), name
    assert grains.extent == pytest.approx(2.4e-3 + 1.5e-3 + 1.2e-3)
    assert grains.finest == 2.4e-3
    assert grains.elongated
    assert not grains.round
    moments = [sphere.radius**3 * sphere.centre[2] for sphere in grains.spheres]
    assert moments[0] < 0 < moments[1]


def test_a_clump_of_one_sphere_is_a_sphere_to_the_last_bit():
    alone = clump(centres=["[1, 2, 3] mm"])
    sphere = Spheres(diameter=3e-3, density=1200, count=5)
    for name in ("mass", "volume", "inertia", "inertia_axis", "reach", "extent", "equivalent_diameter", "round"):
        assert getattr(alone, name) == getattr(sphere, name), name
    assert alone.spheres[0].centre == (0, 0, 0)


@pytest.mark.parametrize(("changed", "message"), [
    ({"centres": ["[0, 0, 0] d", "[0, 0, 1.1] d"]}, "sphere 2 is apart from the first one"),
    ({"centres": ["[0, 0, 0] d", "[0, 0, 0] d"]}, "sphere 2 lies within sphere 1"),
    ({"diameters": ["3 mm"]}, "there are 2 centres and 1 diameters"),
    ({"diameters": ["2 mm", "2 mm"]}, "the largest sphere has 2 mm, and grains.diameter is 3 mm"),
    ({"diameters": ["3 mm", "0.2 mm"]}, "less than d/10"),
    ({"centres": []}, "at least 1 item"),
    ({"centres": [["0 d", "0 d", f"{0.1 * k} d"] for k in range(9)]}, "at most 8 items"),
    ({"centres": [[0, 0, 0], [0, 0, 1e-3]]}, "the unit is missing"),
])  # fmt: skip
def test_impossible_clumps_are_refused(changed, message):
    with pytest.raises(ValidationError, match=message):
        clump(**changed)


def test_mean_width_bounds_what_clumps_exclude():
    rods = Spherocylinders(diameter=3e-3, length=1.8 * 3e-3, density=1200, count=5)
    assert clump().crowding == pytest.approx(1.4**3, rel=1e-5)  # mean width of a segment of 0.8 d: 0.4 d, and d
    assert clump().crowding > rods.crowding


def test_clumps_overlap_if_any_of_their_spheres_do():
    grains, rng = clump(centres=["[0, 0, 0] d", "[0.8, 0, 0] d", "[0, 0.7, 0.3] d"]), np.random.default_rng(2)
    n = 300
    branch, q, second = rng.normal(size=(n, 3)) * 3e-3, random_turns(rng, n), random_turns(rng, n)
    expected = []
    for k in range(n):
        first = [branch[k] + rotated(q[k : k + 1], s.centre)[0] for s in grains.spheres]
        others = [rotated(second[k : k + 1], s.centre)[0] for s in grains.spheres]
        expected.append(min(math.dist(a, b) for a in first for b in others) < 3e-3)
    assert overlapping(grains, branch, q, second, 3e-3).tolist() == expected
    assert 0.2 < np.mean(expected) < 0.95


def test_the_height_of_a_turned_clump_is_that_of_its_highest_sphere():
    grains = clump(diameters=["3 mm", "2.4 mm"])
    upright, upside_down = np.array([[1.0, 0, 0, 0]]), np.array([[0.0, 1, 0, 0]])
    low, high = grains.spheres
    assert np.asarray(upper_reach(grains, 1.5e-3, upright))[0] == pytest.approx(high.centre[2] + high.radius)
    assert np.asarray(upper_reach(grains, 1.5e-3, upside_down))[0] == pytest.approx(low.radius - low.centre[2])


def scene(**law) -> Scene:
    contact = LinearSpringDashpot.model_validate({"normal_stiffness": 500, "friction": 0.5, **law})
    return Scene(grains=clump(), contact=contact, container=Box(width=0.05, depth=0.05, height=0.1))


def test_a_scene_of_clumps_is_described_and_drawn_sphere_by_sphere():
    assert "5 clumps (d = 3 mm, L = 5.4 mm)" in repr(scene())
    drawn = svg(clump(count=40), Box(width=0.012, depth=0.012, height=0.1)).count("h0")
    one_row = svg(Spheres(diameter=3e-3, density=1200, count=40), Box(width=0.012, depth=0.012, height=0.1)).count("h0")
    assert drawn > one_row / 2
    assert drawn % 2 == 0


def test_clumps_have_no_rolling_springs():
    with pytest.raises(ValidationError, match="clumps have no rolling springs"):
        scene(rolling_model="epsd", rolling_friction=0.1)


def test_a_backend_without_clumps_refuses_them_by_name():
    can = capabilities("plain", 1, frozenset({"double"}), ("cpu",))
    with pytest.raises(Unsupported, match=r"grains\.shape: the backend plain has no clump; .*--backend numba"):
        specialise(can, scene(), Numerics(dt=1e-6), ())
