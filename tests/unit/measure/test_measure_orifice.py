"""Means above an orifice and contact stress, from made-up frames with known answers."""

import math
from dataclasses import replace

import numpy as np
import pytest

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Contacts, Crossing, Sample, Zone
from labbook.fields import orifice_mean
from labbook.measure import MEASURES, MeasureError, RunData
from labbook.measure.acceleration import AccelerationProfile
from labbook.measure.stress import contact_pressure, stress_fields
from labbook.scene import Box, CylinderSilo, LinearSpringDashpot, Scene, Spherocylinders
from labbook.scene.packing import Packing
from labbook.study.schema import Window

D, SPEED, G = 0.06, 0.3, 9.8
ROD = Spherocylinders(diameter=6e-3, length=20e-3, density=620, count=4000)
RATE = 500.0
WINDOW = Window(start=0.1, end=0.5, gap=1.0, interval=0.05, layer=0.01)


def scene(grains: Spherocylinders = ROD) -> Scene:
    silo = CylinderSilo(diameter=0.19, height=0.5, orifice=D, rotation=0.32)
    law = LinearSpringDashpot(normal_stiffness=1e5, friction=0.5, restitution=0.9)
    return Scene(grains=grains, contact=law, container=silo, gravity=G)


def lattice(spacing: float, radius: float = 0.055, low: float = -0.03, high: float = 0.15) -> np.ndarray:
    along, up = np.arange(-radius, radius, spacing), np.arange(low, high, spacing)
    x, y, z = (axis.ravel() for axis in np.meshgrid(along, along, up, indexing="ij"))
    return np.column_stack([x, y, z])


def frames(x: np.ndarray, times, v=(0.0, 0.0, -SPEED), q=(1.0, 0.0, 0.0, 0.0), **more) -> dict[str, np.ndarray]:
    """Grains at x and v in every frame; q and v may be given for each grain."""
    n = len(x)
    q, v = np.broadcast_to(q, (n, 4)), np.broadcast_to(v, (n, 3))
    once = {"id": np.arange(n), "x": x[:, 0], "y": x[:, 1], "z": x[:, 2], "vx": v[:, 0], "vy": v[:, 1], "vz": v[:, 2]}
    once |= dict(zip(("qw", "qx", "qy", "qz"), q.T, strict=True)) | more
    table = {name: np.tile(column, len(times)) for name, column in once.items()}
    return {"step": np.repeat(np.arange(len(times)), n), "time": np.repeat(times, n), **table}


def run_of(here: Scene, **tables) -> RunData:
    """A run from which grains left evenly, 500 a second."""
    n = here.grains.count
    left = {"time": np.arange(1, 0.6 * n) / RATE, "id": np.arange(int(0.6 * n) - 1)}
    start = Packing(x=np.zeros((n, 3)), v=np.zeros((n, 3)), omega=np.zeros((n, 3)))
    return RunData(here, Numerics(dt=1e-6), 1, start, "finished", 0.6 * n / RATE, {"crossing": left, **tables})


def acceleration_of(run: RunData, window) -> AccelerationProfile | None:
    return AccelerationProfile.of(MEASURES["orifice"].evaluate(run, window))


def numbers(name: str, run: RunData) -> dict[str, float]:
    return {m.quantity: m.value for m in MEASURES[name].evaluate(run, WINDOW).numbers}


TIMES = np.arange(0, 4.8, 0.1)


def test_upright_rods_that_sink_together():
    spacing = 0.012
    found = numbers("orifice", run_of(scene(), zone=frames(lattice(spacing), TIMES)))
    assert found["orifice_O_zz"] == pytest.approx(1)
    assert found["orifice_S"] == pytest.approx(1)
    assert found["orifice_O_rr"] == pytest.approx(0, abs=1e-12)
    assert found["orifice_v_z"] == pytest.approx(-SPEED)
    assert found["orifice_kinetic_pressure"] == pytest.approx(0, abs=1e-9)
    # a lattice 12 mm wide seen through a kernel of 5 mm is even to a per cent
    assert found["orifice_packing_fraction"] == pytest.approx(ROD.volume / spacing**3, rel=0.02)


def test_a_run_without_a_window_says_so_and_not_that_it_has_few_frames():
    run = run_of(scene(), zone=frames(lattice(0.012), TIMES))
    few = {name: column[:100] for name, column in run.tables["crossing"].items()}
    few = replace(run, tables={**run.tables, "crossing": few})
    (found,) = MEASURES["orifice"].evaluate(few, WINDOW).numbers
    flow = MEASURES["flow_rate"].evaluate(few, WINDOW).numbers[0]
    assert found.note == flow.note == "too few grains: 100 of 4000 left, fewer than 60 in the window"
    seldom = {name: column[: 12 * len(lattice(0.012))] for name, column in run.tables["zone"].items()}
    (found,) = MEASURES["orifice"].evaluate(replace(run, tables={**run.tables, "zone": seldom}), WINDOW).numbers
    assert "frames while grains flowed within the window, fewer than 8" in found.note


def test_order_of_each_instant_and_of_their_mean():
    """Rods stand in every other frame and lie along x in the rest: those have S = 1, and 1/2 once averaged around the
    axis; the mean tensor has 1/2 along z and 1/4 across."""
    x = lattice(0.012)
    directions = ((1.0, 0.0, 0.0, 0.0), (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0))
    parts = [frames(x, [time], q=directions[k % 2]) for k, time in enumerate(TIMES)]
    zone = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    zone["step"] = np.repeat(np.arange(len(TIMES)), len(x))
    found = numbers("orifice", run_of(scene(), zone=zone))
    share = found["orifice_O_zz"]  # frames within the window need not be even in number
    assert share == pytest.approx(0.5, abs=0.03)
    assert found["orifice_S_of_mean"] == pytest.approx(share, abs=0.01)
    assert found["orifice_S"] == pytest.approx(share + (1 - share) / 2, abs=0.01)


def test_a_finer_kernel_takes_less_of_the_mean_motion_for_fluctuations():
    """Speeds that grow with height fluctuate within a kernel, and a quarter as much within half of it."""
    x = lattice(0.006, high=0.05)
    v = np.column_stack([np.zeros(len(x)), np.zeros(len(x)), -20.0 * x[:, 2]])
    sphere = Spherocylinders(diameter=9.9e-3, length=9.9e-3, density=620, count=4000)
    found = numbers("orifice", run_of(scene(sphere), zone=frames(x, TIMES[8:20], v=v)))
    ratio = found["orifice_kinetic_pressure_fine"] / found["orifice_kinetic_pressure"]
    assert ratio == pytest.approx(0.25, rel=0.05)


def test_rods_that_lie_radially_or_around_the_axis():
    x = lattice(0.012) + np.array([0.003, 0.002, 0])
    angle = np.arctan2(x[:, 1], x[:, 0])
    for turned, first, second in ((0.0, "O_rr", "O_tt"), (math.pi / 2, "O_tt", "O_rr")):
        # the z axis turned onto (cos a, sin a, 0): a quarter turn about (-sin a, cos a, 0)
        a = angle + turned
        q = np.column_stack([np.ones(len(x)), -np.sin(a), np.cos(a), np.zeros(len(x))]) / math.sqrt(2)
        found = numbers("orifice", run_of(scene(), zone=frames(x, TIMES, q=q)))
        assert found["orifice_O_zz"] == pytest.approx(0, abs=1e-12)
        # the axis itself is within a kernel of grains on all of its sides
        assert found[f"orifice_{first}"] > 0.75 > 0.25 > found[f"orifice_{second}"]
        assert found["orifice_O_rr"] + found["orifice_O_tt"] == pytest.approx(1)


def test_spheres_have_no_orientation():
    sphere = Spherocylinders(diameter=9.9e-3, length=9.9e-3, density=620, count=4000)
    found = numbers("orifice", run_of(scene(sphere), zone=frames(lattice(0.012), TIMES)))
    assert not {name for name in found if "_O_" in name or name.endswith("_S")}
    assert found["orifice_v_z"] == pytest.approx(-SPEED)


def test_frames_outside_the_window_and_in_gaps_do_not_count():
    x = lattice(0.012)
    parts = [frames(x, [time], v=(0, 0, -speed)) for time, speed in ((0.1, 5), (1, 0.2), (2.5, 7), (3.4, 0.4), (5, 9))]
    parts = [{**part, "step": part["step"] + k} for k, part in enumerate(parts)]
    zone = {name: np.concatenate([part[name] for part in parts] * 8) for name in parts[0]}
    zone["step"] = np.concatenate([part["step"] + 10 * k for k in range(8) for part in parts])
    run = run_of(scene(), zone=zone)
    times = np.concatenate([np.linspace(0.01, 2, 1000), np.linspace(3.2, 5, 1400)])  # nothing from 2 to 3.2 s
    run.tables["crossing"] = {"time": times, "id": np.arange(len(times))}  # pyright: ignore[reportIndexIssue]
    assert numbers("orifice", run)["orifice_v_z"] == pytest.approx(-0.3)


def test_free_fall_from_pairs_of_frames_fifty_milliseconds_apart():
    """Pairs 0.2 s apart; every grain falls by g, also the ones that leave the zone below."""
    x = lattice(0.006, radius=0.02)
    parts = []
    for k, start in enumerate(np.arange(0.9, 3.8, 0.2)):
        for place, after in enumerate((0.0, 0.05)):
            moved = x - [0, 0, SPEED * after + G * after**2 / 2]
            part = frames(moved, [start + after], v=(0, 0, -SPEED - G * after))
            kept = part["z"] >= -0.02
            parts.append({name: c[kept] + (2 * k + place if name == "step" else 0) for name, c in part.items()})
    zone = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    run = run_of(scene(), zone=zone)
    profile = acceleration_of(run, WINDOW)
    assert profile is not None
    assert profile.interval == pytest.approx(0.05)
    np.testing.assert_allclose(profile.acceleration, -G, rtol=1e-9)
    assert profile.left > 0.05
    assert numbers("orifice", run)["free_fall_height"] == pytest.approx(2 * D)


def test_the_zone_holds_what_reaches_into_the_means():
    tall = scene(ROD.model_copy(update={"count": 10_000}))
    crossing, zone = MEASURES["orifice"].observed(tall, Numerics(dt=5e-6), WINDOW)
    assert crossing == Crossing(0.0)
    assert isinstance(zone, Zone)
    reach = 4 * ROD.equivalent_diameter / 2
    assert zone.radius >= D / 2 + reach
    assert zone.low <= -reach
    assert zone.high >= 0.01 + reach
    assert zone.core >= D / 4
    assert zone.top >= 2 * D
    assert zone.again * 5e-3 == pytest.approx(0.05)
    assert zone.every > 2 * zone.again
    # a small silo that is soon empty: frames follow each other evenly
    small = scene(Spherocylinders(diameter=6e-3, length=20e-3, density=620, count=700))
    _, fast = MEASURES["orifice"].observed(small, Numerics(dt=5e-6), WINDOW)
    assert isinstance(fast, Zone)
    assert fast.again == 0
    assert 1 <= fast.every * 5e-3 / 0.005 < 10


def test_what_cannot_be_measured_is_told():
    boxed = scene().model_copy(update={"container": Box(width=0.1, depth=0.1, height=0.1)})
    for name in ("orifice", "contact_stress"):
        with pytest.raises(MeasureError, match="cylinder-silo"):
            MEASURES[name].probes(boxed, Numerics(dt=1e-6))
        with pytest.raises(MeasureError, match="run it again"):
            MEASURES[name].evaluate(run_of(scene()), WINDOW)
    few = numbers("orifice", run_of(scene(), zone=frames(lattice(0.012), TIMES[:9])))
    assert math.isnan(few["orifice_v_z"])
    assert acceleration_of(run_of(scene(), zone=frames(lattice(0.012), TIMES[:0])), WINDOW) is None


def test_means_of_a_clogged_run_are_kept_apart():
    clogged = replace(run_of(scene(), zone=frames(lattice(0.012), TIMES)), outcome="clogged")
    found = numbers("orifice", clogged)
    assert found["orifice_v_z_flowing"] == pytest.approx(-SPEED)
    assert all(name.endswith("_flowing") for name in found)
    assert acceleration_of(clogged, WINDOW) is None


@pytest.mark.slow
def test_contact_stress_of_columns_that_press_on_each_other():
    """A lattice of spacing a whose vertical neighbours push each other with F: sigma_zz = F/a^2, its trace is that."""
    a, force = 0.01, 2e-3
    x = lattice(a, radius=0.09, low=0.005, high=0.2)
    here, n = scene(), int(np.unique(x[:, 2]).size)
    i = np.flatnonzero(np.arange(len(x)) % n < n - 1)  # z runs fastest
    times, ones = np.arange(0.9, 4, 0.5), np.ones(len(i))
    rows = {"i": i, "j": i + 1, "wall": -ones, "bx": 0 * ones, "by": 0 * ones, "bz": a * ones}
    rows |= {"fx": 0 * ones, "fy": 0 * ones, "fz": -force * ones}
    table = {name: np.tile(column, len(times)) for name, column in rows.items()}
    table |= {"step": np.repeat(np.arange(len(times)), len(i)), "time": np.repeat(times, len(i))}
    run = run_of(here, sample=frames(x, times), contacts=table)
    fields, count = stress_fields(run, WINDOW) or (None, 0)
    assert fields is not None
    assert 3 <= count <= len(times)
    inside = np.ix_(fields.grid.points[0] < 0.05, (fields.grid.points[1] > 0.05) & (fields.grid.points[1] < 0.15))
    pressure = contact_pressure(fields)
    assert pressure[inside].mean() == pytest.approx(force / a**2 / 3, rel=0.01)
    found = numbers("contact_stress", run)
    assert found["orifice_contact_pressure"] == pytest.approx(float(orifice_mean(fields, pressure, D, 0.01)))
    assert 0.3 < found["bed_contact_pressure"] / (force / a**2 / 3) < 1  # less where nothing presses from beyond
    probes = MEASURES["contact_stress"].probes(here, Numerics(dt=1e-6))
    assert [type(probe) for probe in probes] == [Crossing, Sample, Contacts]
    assert probes[1].every == probes[2].every  # pyright: ignore[reportAttributeAccessIssue]
