"""Vertical stress in a bed from its contacts: a column of grains whose contact forces are those of Janssen's law."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

pytest.importorskip("numba")

from labbook.backend.numerics import Numerics
from labbook.backend.probes import TRACTION_SUMS, Contacts, Crossing, Sample
from labbook.checks.verify.materials import D, G, hertz, scene
from labbook.checks.verify.platform import grains_at
from labbook.fit.janssen import vertical_stress
from labbook.measure import MEASURES, MeasureError, RunData
from labbook.measure.bulk_stress import BulkStress, SectionForces
from labbook.measure.wall_stress import WallStress, WallStresses, bin_width
from labbook.report.walls import agreement
from labbook.results.walls import PooledWalls
from labbook.scene import CylinderSilo, Frustum, Primitives, Wall
from labbook.study.schema import Window

COUNT, LENGTH = 60, 20 * D
RADIUS = 3 * D
CYLINDER = Primitives(
    parts=(
        Wall(name="side", shape=Frustum(lower=(RADIUS, 0.0), upper=(RADIUS, 0.3))),
        Wall(name="bottom", shape=Frustum(lower=(0.0, 0.0), upper=(RADIUS, 0.0))),
    )
)
SECTION = np.pi * RADIUS**2
SCENE = scene(COUNT, hertz(), CYLINDER, G)
WEIGHT = SCENE.grains.mass * G
HEIGHT = D * (0.5 + np.arange(COUNT))
"""Of the centres."""
CARRIED = WEIGHT * LENGTH / D * -np.expm1(-D * np.arange(COUNT, 0, -1) / LENGTH)
"""Force of the contact below each grain, by J1 at the depths of the contacts."""
SHEAR = np.append(CARRIED[1:], 0.0) + WEIGHT - CARRIED
"""Force of the side on each grain, by its balance."""
TIMES = (0.0, 0.6, 0.9)


def column(shear: float = 1.0) -> RunData:
    """The column at rest in three frames, of which two are in the second half. shear: factor of the sums of the side,
    which only those see."""
    x = np.column_stack([np.zeros((COUNT, 2)), HEIGHT])
    zero, ids = np.zeros(COUNT), np.arange(COUNT)
    below = {"i": ids, "j": ids - 1, "wall": np.where(ids == 0, 1, -1), "fx": zero, "fy": zero, "fz": CARRIED}
    below |= {"bx": zero, "by": zero, "bz": np.where(ids == 0, -D / 2, -D)}
    side = {"i": ids, "j": zero - 1, "wall": zero, "fx": zero, "fy": zero, "fz": SHEAR}
    side |= {"bx": zero + D / 2, "by": zero, "bz": zero}
    contacts = {name: np.concatenate([below[name], side[name]]) for name in below}
    sample = {"id": ids, **{axis: x[:, k] for k, axis in enumerate("xyz")}, **dict.fromkeys(("vx", "vy", "vz"), zero)}
    bins = (HEIGHT / bin_width(SCENE)).astype(int)
    sums = {"wall": np.append(0 * bins, 1), "bin": np.append(bins, 0)}
    sums |= {name: np.zeros(COUNT + 1) for name in TRACTION_SUMS}
    sums |= {"along": np.append(shear * SHEAR, 0.0), "normal": np.append(2 * SHEAR, CARRIED[0])}
    sums |= {"fz": np.append(shear * SHEAR, CARRIED[0]), "contacts": np.ones(COUNT + 1)}
    tables = {"contacts": contacts, "sample": sample, "traction": sums}
    tables = {
        name: {
            **{key: np.tile(column, len(TIMES)) for key, column in rows.items()},
            "time": np.repeat(TIMES, len(next(iter(rows.values())))),
            "step": np.repeat(np.arange(len(TIMES)), len(next(iter(rows.values())))),
        }
        for name, rows in tables.items()
    }
    return RunData(SCENE, Numerics(dt=1.0, steps_per_beat=1), 1, grains_at(x), "time-limit", 1.0, tables)


def forces(run: RunData) -> SectionForces:
    found = SectionForces.of(BulkStress().evaluate(run, Window()))
    assert found is not None
    return found


def pooled(*runs: RunData) -> PooledWalls:
    evaluations = [WallStresses.of(WallStress().evaluate(run, Window())) for run in runs]
    result = SimpleNamespace(point=SimpleNamespace(scene=SCENE), label="", pooled={})
    beds = tuple((bed,) for bed in evaluations if bed is not None)
    return PooledWalls(cast(Any, result), beds, tuple((forces(run),) for run in runs))


def test_the_field_of_the_contacts_is_the_stress_of_the_law():
    """Between two planes of contacts the force is that of the law there: coarse-graining over d/2 changes a stress that
    varies over 20 d by (d/2)^2/(2 (20 d)^2), 3e-4, and the sum over steps of d adds as much."""
    found = forces(column())
    inside = (found.z > 3 * D) & (found.z < D * COUNT - 3 * D)
    expected = WEIGHT / D * vertical_stress("J1", D * COUNT - found.z[inside], LENGTH)
    assert inside.sum() > 100
    assert found.force[inside] == pytest.approx(expected, rel=3e-3)
    above = WEIGHT / D * (D * COUNT - found.z[inside])
    assert found.weight_above[inside] == pytest.approx(above, rel=0.03), "grains are a diameter high"
    assert found.frames == 2, "that of the opening is not in the second half"
    (load,) = BulkStress().evaluate(column(), Window()).numbers
    half = COUNT / 2
    assert load.value == pytest.approx(LENGTH / D / half * -np.expm1(-half * D / LENGTH), rel=0.01)


def test_both_sources_agree_and_give_the_screening_length():
    """To half a percent of the mean: the shear of a bin of 2 d is spread evenly over it."""
    walls = pooled(column(), column())
    stress = walls.vertical
    assert stress is not None
    assert stress.ratio == pytest.approx((1, 0), abs=5e-3)
    assert stress.largest < 5e-3
    assert stress.z.min() > RADIUS
    assert stress.field[0] * SECTION == pytest.approx(np.interp(stress.z, HEIGHT - D / 2, CARRIED), rel=5e-3)
    length = stress.fits["J1"].parameters["length"]
    assert length.value == pytest.approx(LENGTH, rel=0.02)
    rows = list(walls.vertical_rows())
    assert [row["z"] for row in rows] == stress.z.tolist()
    assert rows[0]["field"] == pytest.approx(rows[0]["walls"], rel=5e-3)
    assert "at 25 heights" in agreement(stress)


def test_walls_that_miss_a_part_of_the_shear_are_seen():
    """With 80 % of the shear the walls leave more to the bed than its contacts carry."""
    stress = pooled(column(shear=0.8)).vertical
    assert stress is not None
    weight = np.interp(stress.z, HEIGHT - D / 2, WEIGHT * np.arange(COUNT, 0, -1))
    carried = np.interp(stress.z, HEIGHT - D / 2, CARRIED)
    expected = carried.mean() / (weight - 0.8 * (weight - carried)).mean()
    assert expected < 0.9
    assert stress.ratio[0] == pytest.approx(expected, rel=0.01)


def test_scenes_and_runs_without_what_it_needs_are_refused():
    still = scene(5, hertz(), CYLINDER, 0.0)
    with pytest.raises(MeasureError, match="no gravity"):
        MEASURES["bulk_stress"].check(still)
    run = column()
    with pytest.raises(MeasureError, match="recorded no contacts"):
        BulkStress().evaluate(RunData(SCENE, run.numerics, 1, run.start, "time-limit", 1.0, {}), Window())
    silo = scene(5000, hertz(), CylinderSilo(diameter=0.06, height=0.3, orifice=0.02), G)
    crossing, sample, contacts = BulkStress().probes(silo, Numerics(dt=1e-6))
    assert isinstance(crossing, Crossing)
    assert isinstance(sample, Sample)
    assert isinstance(contacts, Contacts)
    assert sample.every == contacts.every
