"""Velocities of flows made by hand: a parabola over a hole, and a zone that two kinds of grains pass at two speeds."""

import math
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Crossing, Slab
from labbook.measure import MEASURES, MeasureError, RunData
from labbook.measure.velocities import BINS, OutletVelocities, Velocities
from labbook.report.velocities import outlet_table, zone_table
from labbook.results.velocities import outlet_profile
from labbook.scene import Box, CylinderSilo, HertzMindlin, Packing, Scene, Spheres
from labbook.scene.container_shape import VelocityZone
from labbook.stats import pool
from labbook.study.schema import Window

N, D, RADIUS, FASTEST, SLOWEST = 20000, 3e-3, 0.02, 0.5, 0.2
ZONE = VelocityZone(name="core", low=(-0.01, -0.01, 0.05), high=(0.01, 0.01, 0.07))
KINDS = ({"name": "light", "share": 0.5}, {"name": "heavy", "share": 0.5, "density": 9000.0})
WINDOW = Window(start=0.0, end=1.0)


def silo(zones=(ZONE,), kinds=KINDS) -> Scene:
    grains = Spheres.model_validate({"diameter": D, "density": 2500.0, "count": N, "kinds": kinds})
    container = CylinderSilo(diameter=0.1, height=0.4, orifice=2 * RADIUS, zones=zones)
    return Scene(grains=grains, contact=HertzMindlin(shear_modulus=1e7, poisson_ratio=0.25), container=container)


def speed(rho: np.ndarray) -> np.ndarray:
    """Of the grains in the plane of the hole [m/s]."""
    return FASTEST - (FASTEST - SLOWEST) * (rho / RADIUS) ** 2


def by_hand(seed: int = 1, fall: float = -0.1, outcome: str = "finished", shift: float = 0.0) -> RunData:
    """Grains that fill the plane of the hole evenly cross it as often as they are fast; those of the second kind, the
    heavy ones, pass the zone at twice the speed `fall` of the light ones. shift: of all velocities in the zone."""
    rng = np.random.default_rng(seed)
    rho = RADIUS * np.sqrt(rng.random(4 * N))
    rho = rho[rng.random(len(rho)) < speed(rho) / FASTEST][:N]
    angle, ids = rng.uniform(0, 2 * math.pi, N), np.arange(N)
    zero = np.zeros(N)
    crossing = {"time": 1e-3 * (1 + ids), "id": ids, "x": rho * np.cos(angle), "y": rho * np.sin(angle), "z": zero}
    crossing |= {"vx": zero, "vy": zero, "vz": -speed(rho)}
    kind = ids % 2
    few, frames = 40, 50
    step = np.repeat(np.arange(frames), few)
    grain = rng.integers(0, N, few * frames)
    place = rng.uniform((-0.02, -0.02, 0.03), (0.02, 0.02, 0.09), (few * frames, 3))
    inside = np.all(np.abs(place - [0, 0, 0.06]) <= 0.01, axis=1)
    slab = {"id": grain, "step": step, "time": 0.3 * step + 0.1, **{axis: place[:, k] for k, axis in enumerate("xyz")}}
    slab |= {"vx": np.where(inside, 0.02, 9.0), "vy": 0 * grain}
    slab |= {"vz": np.where(inside, fall * (1 + kind[grain]) + shift, 9.0)}
    start = Packing(x=np.zeros((N, 3)), v=np.zeros((N, 3)), omega=np.zeros((N, 3)), kind=kind)
    tables = {"crossing": crossing, "slab": slab}
    return RunData(silo(), Numerics(dt=1e-5), seed, start, outcome, 30.0, tables)


def test_the_profile_over_the_outlet_is_that_of_the_grains_in_its_plane():
    """Their mean over the hole is (FASTEST + SLOWEST)/2, that of the grains that cross is larger; errors of 20 000
    grains are 0.2 % of the mean and 0.6 % in a ring."""
    run = by_hand()
    evaluation = Velocities().evaluate(run, WINDOW)
    profile = OutletVelocities.of(evaluation)
    assert profile is not None
    assert profile.edges[-1] == RADIUS
    assert np.diff(profile.edges**2) == pytest.approx(RADIUS**2 / BINS)
    middle = np.sqrt((profile.edges[1:] ** 2 + profile.edges[:-1] ** 2) / 2)
    assert profile.velocity[0] == pytest.approx(speed(middle), rel=0.01)
    numbers = {number.quantity: number for number in evaluation.numbers}
    mean = numbers["velocity_outlet"]
    assert mean.value == pytest.approx((FASTEST + SLOWEST) / 2, rel=0.01)
    assert abs(mean.value - (FASTEST + SLOWEST) / 2) < 4 * mean.error < 0.01
    crossed = float(-run.tables["crossing"]["vz"].mean())
    assert crossed > 1.03 * mean.value
    density = profile.flux[0] / profile.velocity[0]
    assert density == pytest.approx(density.mean(), rel=0.05), "grains fill the plane evenly"
    assert profile.grains[1:].sum() == profile.grains[0].sum()


def test_velocities_in_a_zone_are_means_over_its_grains_and_of_each_kind():
    numbers = {number.quantity: number for number in Velocities().evaluate(by_hand(), WINDOW).numbers}
    assert numbers["velocity_x_core"].value == pytest.approx(0.02)
    assert numbers["velocity_y_core"].value == 0
    assert numbers["velocity_z_core_of_light"].value == pytest.approx(-0.1)
    assert numbers["velocity_z_core_of_heavy"].value == pytest.approx(-0.2)
    mean = numbers["velocity_z_core"]
    assert mean.value == pytest.approx(-0.15, abs=4 * mean.error)
    assert 0 < mean.error < 0.02, "some 80 grains with a spread of 0.05"
    declared = {quantity.name for quantity in Velocities().quantities(silo())}
    assert numbers.keys() <= declared
    clogged = {number.quantity for number in Velocities().evaluate(by_hand(outcome="clogged"), WINDOW).numbers}
    assert clogged == {f"{name}_flowing" for name in numbers}
    few = Velocities().evaluate(RunData(silo(), Numerics(dt=1e-5), 1, by_hand().start, "finished", 1.0, {
        name: {key: column[:5] for key, column in table.items()} for name, table in by_hand().tables.items()
    }), WINDOW)  # fmt: skip
    assert {number.quantity for number in few.numbers} == numbers.keys()
    assert all(math.isnan(number.value) for number in few.numbers)


def test_beds_are_pooled_with_intervals():
    runs = []
    for seed in (1, 2, 3):
        evaluation = Velocities().evaluate(by_hand(seed, shift=0.01 * seed), WINDOW)
        runs.append(SimpleNamespace(counted=True, measures=("velocities",), seed=seed,
                                    evaluation=lambda _, own=evaluation: own, numbers=evaluation.numbers))  # fmt: skip
    names = [number.quantity for number in runs[0].numbers]
    pooled = {name: pool([run.numbers[place].value for run in runs]) for place, name in enumerate(names)}
    result = cast(Any, SimpleNamespace(runs=runs, label="", pooled=pooled, point=SimpleNamespace(scene=silo())))
    profile = outlet_profile(result)
    assert profile is not None
    assert profile.names == ("all", "light", "heavy")
    own = [OutletVelocities.of(run.evaluation(None)) for run in runs]
    values = np.array([bed.velocity[0, 3] for bed in own if bed is not None])
    assert profile.velocity[0, 3] == pytest.approx(values.mean())
    assert profile.error[0, 3] == pytest.approx(values.std(ddof=1) / math.sqrt(3))
    assert profile.half_width[0, 3] == pytest.approx(4.303 * profile.error[0, 3], rel=1e-3), "Student's t of 3 beds"
    rows = list(profile.rows())
    assert len(rows) == 3 * BINS
    zones = zone_table([result]).rows
    assert [row[1:3] for row in zones] == [("core", "all"), ("core", "light"), ("core", "heavy")]
    assert [cell.replace("−", "-") for cell in zones[1][7:]] == ["-80.0 ± 5.8", "-104.8 to -55.2"]
    assert outlet_table([result]).rows[0][0] == "the only point"


def test_zones_need_a_slab_and_scenes_one_outlet():
    crossing, slab = MEASURES["velocities"].probes(silo(), Numerics(dt=1e-6))
    assert isinstance(crossing, Crossing)
    assert isinstance(slab, Slab)
    assert (slab.low, slab.high) == (0.05, 0.07)
    assert len(MEASURES["velocities"].probes(silo(zones=()), Numerics(dt=1e-6))) == 1
    run = by_hand()
    with pytest.raises(MeasureError, match="no grains in zones"):
        Velocities().evaluate(RunData(silo(), run.numerics, 1, run.start, "finished", 1.0,
                                      {"crossing": run.tables["crossing"]}), WINDOW)  # fmt: skip
    box = silo().model_copy(update={"container": Box(width=0.1, depth=0.1, height=0.2)})
    with pytest.raises(MeasureError, match="needs an outlet"):
        MEASURES["velocities"].check(box)
