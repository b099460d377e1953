"""The section on walls, from stresses that Janssen's law gives."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from labbook.checks.verify.materials import D, G, hertz, scene
from labbook.fit import FitError
from labbook.fit.janssen import vertical_stress
from labbook.measure.wall_stress import WallStresses
from labbook.report.walls import balance, choice, force_table, front_and_back, janssen_table
from labbook.results.walls import PooledWalls
from labbook.scene import CylinderSilo, WedgeHopper
from labbook.stats import Pooled

BINS, SIZE, LENGTH, RATIO, DENSITY = 25, 2 * D, 0.03, 0.6, 1500.0
RADIUS = 10 * D
SECTION, PERIMETER = np.pi * RADIUS**2, 2 * np.pi * RADIUS
SURFACE = BINS * SIZE
FRICTION = SECTION / (PERIMETER * LENGTH * RATIO)


def stresses(noise: float, seed: int, shear: float = 1.0) -> WallStresses:
    """Of a cylinder with a bottom of one bin: Janssen's law with noise in each bin."""
    rng = np.random.default_rng(seed)
    low = SIZE * np.arange(BINS)
    depth = SURFACE - low - SIZE / 2
    vertical = vertical_stress("J1", depth, LENGTH)
    normal = RATIO * DENSITY * G * vertical * (1 + noise * rng.normal(size=BINS))
    up = shear * FRICTION * RATIO * DENSITY * G * vertical * (1 + noise * rng.normal(size=BINS))
    area = PERIMETER * SIZE
    weight = DENSITY * G * SECTION * SURFACE
    rest = np.zeros((BINS + 1, 3))
    rest[:BINS, 0], rest[:BINS, 1], rest[BINS, 0] = normal * area, up * area, weight - (up * area).sum()
    force = np.array([[0, 0, rest[:BINS, 1].sum()], [0, 0, rest[BINS, 0]]])
    none, three = np.full((BINS + 1, 3), np.nan), np.full((2, 3), np.nan)
    areas, above = np.append(np.full(BINS, area), SECTION), np.append(DENSITY * G * SECTION * depth, np.nan)
    ends = {"low": np.append(low, 0.0), "high": np.append(low + SIZE, RADIUS), "area": areas, "rest_area": areas}
    at_rest = {"rest": rest, "rest_contacts": np.full(BINS + 1, 100.0), "rest_sliding": np.full(BINS + 1, 50.0)}
    values: dict[str, Any] = {
        "names": np.array(["side", "bottom"]), "coordinates": np.array(["height", "radius"]),
        "upright": np.array([True, False]), "friction": np.array([0.5, 0.5]), "wall": np.repeat([0, 1], [BINS, 1]),
        **ends, **at_rest, "flow": none, "flow_error": none, "flow_contacts": none[:, 0], "flow_sliding": none[:, 0],
        "weight_above": above, "rest_force": force, "rest_torque": 0 * force, "rest_point": 0 * force,
        "flow_force": three, "flow_torque": three, "flow_point": three, "time": np.zeros(1),
        "wall_force": force[None], "opening_time": np.zeros(0), "opening": np.zeros((0, BINS + 1)),
        "peaks": np.full(5, np.nan), "weight": weight, "section": SECTION, "perimeter": PERIMETER, "density": DENSITY,
        "surface": SURFACE, "floor": 0.0, "gravity": G, "window": np.full(2, np.nan),
    }  # fmt: skip
    return WallStresses(**values)


def pooled(*beds: WallStresses, container: Any = None) -> PooledWalls:
    container = container or CylinderSilo(diameter=2 * RADIUS, height=0.3, orifice=4 * D)
    point = SimpleNamespace(scene=scene(1000, hertz(), container, G))
    numbers = {"stress_ratio": Pooled(0.6, 0.01, 0.03, 3), "wall_friction": Pooled(0.4, 0.01, 0.03, 3)}
    result = SimpleNamespace(point=point, label="", pooled=numbers)
    return PooledWalls(cast(Any, result), tuple((bed,) for bed in beds))


def test_the_vertical_stress_is_that_of_the_law():
    found = stresses(0.0, 0)
    depth = SURFACE - SIZE * (np.arange(BINS) + 0.5)
    expected = DENSITY * G * vertical_stress("J1", depth, LENGTH)
    assert found.vertical_stress()[: BINS - 1] == pytest.approx(expected[:-1], rel=0.02), "bins are coarse"
    assert np.isnan(found.vertical_stress()[BINS])
    assert found.lowest == pytest.approx(RADIUS)


def test_fits_to_the_mean_of_beds_give_the_law_with_errors_between_beds():
    walls = pooled(*(stresses(0.1, seed) for seed in range(4)))
    fit = walls.fits["rest"]["J1"]
    length = fit.parameters["length"]
    between = walls.error_between_beds("rest", "J1", "length")
    assert length.low < LENGTH < length.high
    assert 0 < between < 0.1 * LENGTH
    assert abs(length.value - LENGTH) < 4 * between
    assert fit.friction == pytest.approx(FRICTION, rel=0.1)
    assert "J1" in walls.preferred()
    table = janssen_table(walls)
    assert [row[:2] for row in table.rows] == [("at rest", "J1"), ("at rest", "J2"), ("at rest", "J3")]
    assert "K at rest: 0.6 ± 0.01" in choice(walls)


def test_rows_have_the_stresses_of_bins_with_errors_over_beds():
    beds = [stresses(0.1, seed) for seed in range(4)]
    rows = list(pooled(*beds).rows())
    assert [row["wall"] for row in rows] == ["side"] * BINS + ["bottom"]
    own = np.array([bed.rest[3] / bed.rest_area[3] for bed in beds])
    assert (rows[3]["normal_rest"], rows[3]["shear_rest"]) == pytest.approx(own[:, :2].mean(axis=0))
    assert rows[3]["shear_rest_error"] == pytest.approx(own[:, 1].std(ddof=1) / 2)
    assert (rows[3]["from"], rows[3]["to"]) == pytest.approx((3 * SIZE, 4 * SIZE))
    assert (rows[3]["contacts_rest"], rows[3]["sliding_rest"]) == (100, 50)
    assert np.isnan(rows[3]["normal_flow"])


def test_peaks_by_time_of_the_mean_are_those_of_beds_and_that_of_their_mean():
    """Two beds whose peaks come one after the other: the peak of their mean is lower than the mean of the peaks."""
    plain, time = stresses(0.0, 0), np.linspace(0, 1, 5)
    beds = []
    for late in (1, 3):
        factor = np.ones(5)
        factor[late] = 1.4
        opening = factor[:, None] * np.where(plain.on_upright, plain.rest[:, 0], 0.0)
        peaks = np.array([1.8, 1.6, 1.4, np.nan, np.nan])
        beds.append(replace(plain, opening_time=time, opening=opening, peaks=peaks * (1 + 0.1 * (late == 3))))
    rows = list(pooled(*beds).peak_rows())
    unit = np.sqrt(D / G)
    assert [row["filter_time"] for row in rows] == pytest.approx([unit, 2.5 * unit, 5 * unit], rel=1e-3)
    assert [row["peak"] for row in rows] == pytest.approx([1.89, 1.68, 1.47])
    assert rows[0]["error"] == pytest.approx(0.09)
    assert rows[2]["peak_of_mean"] == pytest.approx(1.2)
    assert np.isnan(rows[0]["peak_of_mean"])


def test_weight_and_forces_are_in_words():
    walls = pooled(stresses(0.0, 1), stresses(0.0, 2))
    assert balance(walls).startswith("Balance of weight at rest: vertical forces of all walls are 1.00000 M g")
    carried = 1 - stresses(0.0, 1).rest[BINS, 0] / stresses(0.0, 1).weight
    side, bottom = force_table(walls).rows
    assert side[:3] == ("side", "at rest", f"{100 * carried:.1f} % ± 0.0 %")
    assert bottom[0] == "bottom"
    assert front_and_back(walls) == ""


def test_walls_that_carry_nothing_are_not_fitted():
    with pytest.raises(FitError, match="carry no weight"):
        _ = pooled(stresses(0.0, 1, shear=-0.1)).fits


def test_front_and_back_of_a_layer_are_judged_by_what_they_carry():
    hopper = WedgeHopper(width=0.1, height=0.3, thickness=1.01 * D, orifice=0.02)
    for shear, words in ((1.0, f"Z/(2 K μ) = {1.01 * 3 / 0.5:.3g} mm"), (0.1, "Side walls and bottom carry the rest")):
        bed = stresses(0.0, 1, shear)
        layer = WallStresses(**{**vars(bed), "names": np.array(["front", "bottom"])})
        assert words in front_and_back(pooled(layer, container=hopper))
