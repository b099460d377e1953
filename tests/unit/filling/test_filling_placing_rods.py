"""Where rods, and grains in round silos, start."""

import math

import numpy as np
import pytest
from scipy.optimize import lsq_linear
from scipy.spatial import KDTree

from labbook.filling import PlacingError, place, start_of_discharge
from labbook.lab.tables import read_table, write_table
from labbook.scene import (
    ConicalSilo,
    CylinderSilo,
    LinearSpringDashpot,
    Packing,
    Primitives,
    Scene,
    Spheres,
    Spherocylinders,
)
from labbook.scene.orientation import axes, distances, random_turns

D, LENGTH = 6e-3, 20e-3
HALF = (LENGTH - D) / 2
SILOS = {
    "cylinder": CylinderSilo(diameter=0.1, height=0.5, orifice=0.04),
    "cone": ConicalSilo(diameter=0.1, height=0.5, orifice=0.04, angle=math.radians(30)),
}


def scene(container, rods=True, count=400) -> Scene:
    kind = {"diameter": D, "density": 620.0, "count": count}
    grains = Spherocylinders(length=LENGTH, **kind) if rods else Spheres(**kind)
    return Scene(grains=grains, contact=LinearSpringDashpot(normal_stiffness=200.0), container=container)


def turned(packing: Packing) -> np.ndarray:
    assert packing.q is not None
    return packing.q


@pytest.mark.parametrize("kind", ["gas", "rain", pytest.param("dense", marks=pytest.mark.slow)])
@pytest.mark.parametrize("silo", SILOS)
@pytest.mark.parametrize("rods", [True, False])
def test_grains_start_inside_and_touch_nothing(kind, silo, rods):
    closed = scene(SILOS[silo], rods).close()
    start = place(closed, kind, 1)
    assert len(start) == 400
    reach = HALF * axes(turned(start)) if rods else np.zeros((400, 3))
    ends = np.concatenate([start.x - reach, start.x + reach])
    rho, z = np.hypot(ends[:, 0], ends[:, 1]), ends[:, 2]
    assert rho.max() <= 0.05 - D / 2
    assert z.min() >= D / 2
    if silo == "cone":
        above = (z * math.tan(math.radians(30)) - (rho - 0.02)) * math.cos(math.radians(30))
        assert above.min() >= D / 2 * (1 - 1e-12)
    i, j = KDTree(start.x).query_pairs(LENGTH, output_type="ndarray").T
    a = axes(turned(start)) if rods else np.tile([0.0, 0, 1], (400, 1))
    assert distances(start.x[i] - start.x[j], a[i], a[j], HALF if rods else 0.0).min() >= D


def test_distances_of_segments_are_those_of_a_bounded_least_squares_fit():
    rng = np.random.default_rng(1)
    a, b = axes(random_turns(rng, 300)), axes(random_turns(rng, 300))
    b[:50] = a[:50]  # parallel ones
    c = rng.normal(size=(300, 3)) * 0.01
    found = distances(c, a, b, HALF)
    for k in range(300):
        fit = lsq_linear(np.column_stack([a[k], -b[k]]), -c[k] / HALF, bounds=(-1, 1), method="bvls", tol=1e-14)
        assert found[k] == pytest.approx(HALF * math.sqrt(2 * fit.cost), abs=1e-8)


def test_orientations_are_random_and_those_of_a_seed():
    """The mean of a a^T is a third of the unit matrix; the standard error of a diagonal element is 0.3/sqrt(n)."""
    a = axes(random_turns(np.random.default_rng(2), 20_000))
    assert np.abs(a.T @ a / len(a) - np.eye(3) / 3).max() < 5 * 0.3 / math.sqrt(len(a))
    closed = scene(SILOS["cylinder"]).close()
    one, same, other = (turned(place(closed, "rain", seed)) for seed in (2, 2, 3))
    assert np.array_equal(one, same)
    assert not np.array_equal(one, other)


def test_a_round_container_without_a_bottom_cannot_be_filled():
    side = SILOS["cylinder"].walls()[:1]
    with pytest.raises(PlacingError, match="no room"):
        place(scene(Primitives(parts=side), count=1).close(), "gas", 1)


def test_packings_with_rods_are_stored_mirrored_and_opened(tmp_path):
    closed, silo = scene(SILOS["cylinder"]).close(), scene(SILOS["cylinder"])
    start = place(closed, "gas", 1)
    springs = {
        "wall_grain": np.array([0, 0, 3]), "wall_name": np.array(["bottom", "bottom", "side"], "U40"),
        "wall_spring": np.ones((3, 3)), "wall_part": np.array([0, 1, 1]),
    }  # fmt: skip
    packing = Packing(x=start.x, v=start.v, omega=start.omega, q=start.q, **springs)
    write_table(tmp_path / "packing.npz", packing.arrays())
    again = Packing(**read_table(tmp_path / "packing.npz"))
    assert np.array_equal(turned(again), turned(packing))
    assert again.wall_part.tolist() == [0, 1, 1]
    mirror = packing.mirrored()
    assert axes(turned(mirror)) == pytest.approx(axes(turned(packing)) * [-1, 1, 1], abs=1e-15)
    assert mirror.wall_part.tolist() == [0, 1, 1]
    assert start_of_discharge(packing, closed, silo).wall_part.tolist() == [0, 1, 1]
    with pytest.raises(ValueError, match="no unit quaternion in row 0"):
        Packing(x=start.x, v=start.v, omega=start.omega, q=2 * turned(start))
