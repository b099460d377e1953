"""What is read off fields: means above an orifice, the kind of flow, and the acceleration of grains."""

import numpy as np
import pytest

from labbook.fields import GrainRows, Layer, Ring, coarse_grain, orifice_means, pattern_of
from labbook.measure.acceleration import acceleration_profile

OMEGA, G = 1.5e-3, 9.81


def even(spacing, radius=0.03, height=0.05):
    """A lattice in space."""
    span, up = np.arange(-radius, radius, spacing), np.arange(-0.01, height, spacing)
    x, y, z = (axis.ravel() for axis in np.meshgrid(span, span, up))
    keep = np.hypot(x, y) < radius
    return np.column_stack([x, y, z])[keep]


def test_orifice_means_of_known_fields():
    """A swirl that sinks, of rods that lie radially but for a part of their length upwards."""
    x = even(OMEGA)
    r = np.hypot(x[:, 0], x[:, 1]).clip(1e-12)
    outwards = np.column_stack([x[:, 0] / r, x[:, 1] / r, np.zeros(len(x))])
    outwards[r < 1e-9] = [1, 0, 0]
    axis = 0.8 * outwards + [0, 0, 0.6]
    v = np.column_stack([-30 * x[:, 1], 30 * x[:, 0], np.full(len(x), -0.25)])
    volume = 0.6 * OMEGA**3
    fields = coarse_grain(Ring(0.02, (0, 0.03), 40, 60), OMEGA, GrainRows(x, v, 1e-5, volume, 1, axis))
    found = orifice_means(fields, 0.03, 0.01)
    assert found["packing_fraction"] == pytest.approx(0.6, rel=5e-3)
    assert found["v_z"] == pytest.approx(-0.25, rel=1e-9)
    # a rigid turn has fluctuations within a kernel: rho (turn omega)^2 of two components, less what is cut off
    assert found["kinetic_pressure"] == pytest.approx(2 * 1e-5 / OMEGA**3 * (30 * OMEGA) ** 2, rel=0.02)
    assert found["O_rr"] + found["O_tt"] + found["O_zz"] == pytest.approx(1, rel=1e-12)
    assert found["O_zz"] == pytest.approx(0.36, rel=1e-6)
    assert found["O_rr"] > 0.6 > 0.1 > found["O_tt"]
    assert found["S"] == pytest.approx(0.95, abs=0.05)


def test_orifice_means_look_above_the_orifice_only():
    x = np.array([[0.004, 0, 0.005], [0.004, 0, 0.025], [-0.015, 0, 0.005]])
    v = np.array([[0, 0, -1.0], [0, 0, -5.0], [0, 0, -7.0]])
    fields = coarse_grain(Layer((-0.02, 0.02), (0, 0.03), 80, 60, 3e-3), 5e-4, GrainRows(x, v, 1.0, 1e-8, 1))
    assert orifice_means(fields, 0.006, 0.01, centre=0.004)["v_z"] == pytest.approx(-1)
    assert orifice_means(fields, 0.006, 0.01, centre=-0.015)["v_z"] == pytest.approx(-7)
    with pytest.raises(ValueError, match="no grain"):
        orifice_means(fields, 0.004, 0.01, centre=0.012)
    with pytest.raises(ValueError, match="finer grid"):
        orifice_means(fields, 1e-5, 0.01, centre=1e-9)


def bed(speed):
    x, z = (axis.ravel() for axis in np.meshgrid(np.arange(-0.05, 0.05, OMEGA), np.arange(0, 0.1, OMEGA)))
    x = np.column_stack([x, np.zeros(len(x)), z])
    v = np.column_stack([np.zeros((len(x), 2)), -speed(x[:, 0], x[:, 2])])
    return coarse_grain(Layer((-0.05, 0.05), (0, 0.1), 50, 50, 3e-3), OMEGA, GrainRows(x, v, 1e-5, 1e-8, 1))


def test_nothing_of_a_plug_is_stagnant_and_of_a_channel_what_rests_beside_it():
    plug = pattern_of(bed(lambda x, z: np.full(len(x), 0.02)))
    assert plug.fraction == 0
    np.testing.assert_allclose(plug.sinking, 0.02, rtol=1e-9)
    channel = pattern_of(bed(lambda x, z: np.where(abs(x) < 0.02, 0.1, 0.0)))
    # the kernel smears the edge: 4 % of the channel's speed, a tenth of the plug's, is reached 1.75 omega outside
    assert channel.fraction == pytest.approx(0.6 - 2 * 1.75 * OMEGA / 0.1, abs=0.03)
    # wedges at rest in the corners, 2 cm wide and 3 cm high; a tenth of the speed is reached 1.34 omega inside
    wedge = pattern_of(bed(lambda x, z: np.where(z > 0.03 * (abs(x) - 0.03) / 0.02, 0.1, 0.0)), top=0.03)
    assert wedge.fraction == pytest.approx(0.2 - 2 * 0.036 * 1.34 * OMEGA / 3e-3, abs=0.02)
    with pytest.raises(ValueError, match="no bed"):
        pattern_of(bed(lambda x, z: x), bottom=1.0)


def test_sparse_grains_that_fall_are_of_the_bed_and_what_is_above_it_or_below_the_outlet_is_not():
    x, z = (axis.ravel() for axis in np.meshgrid(np.arange(-0.05, 0.05, OMEGA), np.arange(-0.02, 0.08, OMEGA)))
    column = np.arange(len(x)) % 10
    there = (abs(x) > 0.015) & (z >= 0) | (abs(x) < 0.015) & ((z > 0.03) | (column < 4))  # 0.4 above the outlet
    x = np.column_stack([x, np.zeros(len(x)), z])[there]
    v = np.tile([0, 0, -0.1], (len(x), 1))
    fields = coarse_grain(Layer((-0.05, 0.05), (-0.03, 0.1), 50, 65, 3e-3), 2 * OMEGA, GrainRows(x, v, 1e-5, 1e-8, 1))
    z, x = fields.grid.points
    found = pattern_of(fields).bed
    assert found[np.ix_((z > 0.003) & (z < 0.075), abs(x) < 0.045)].mean() > 0.99
    assert not found[z < 0].any()
    assert not found[z > 0.08 + 3 * OMEGA].any()


def frames(z0, v0, times, accelerate, floor=-np.inf):
    rows = []
    for step, t in enumerate(times):
        z, v = accelerate(z0, v0, t)
        there = z > floor
        n = there.sum()
        row = [np.full(n, step), np.full(n, t), np.flatnonzero(there), np.zeros(n), np.zeros(n), z[there], v[there]]
        rows.append(np.column_stack(row))
    table = dict(zip(("step", "time", "id", "x", "y", "z", "vz"), np.concatenate(rows).T, strict=True))
    return {**table, "id": table["id"].astype(int), "step": table["step"].astype(int)}


def free_fall(z0, v0, t):
    return z0 + v0 * t - G * t**2 / 2, v0 - G * t


@pytest.mark.parametrize("interval", [0.05, 0.005])
def test_free_fall_is_g_at_every_height_also_of_grains_that_leave(interval):
    rng = np.random.default_rng(1)
    table = frames(
        rng.uniform(0, 0.1, 400), rng.uniform(-0.3, 0, 400), np.arange(0, 0.2, 0.005), free_fall, floor=-0.006
    )
    found = acceleration_profile(
        table, interval=interval, radius=0.01, edges=np.linspace(0, 0.1, 6), gravity=G, end=0.1
    )
    np.testing.assert_allclose(found.acceleration, -G, rtol=1e-9)
    assert found.interval == pytest.approx(interval)
    assert (found.left > 0.2) == (interval == 0.05)


def test_grains_that_are_put_back_on_top_have_fallen_freely_until_then():
    def put_back(z0, v0, t):
        z, v = free_fall(z0, v0, t)
        left = z < -0.006
        rest = (v0 + np.sqrt(v0**2 + 2 * G * (z0 + 0.006))) / G  # when it left
        return np.where(left, 0.2 - G * (t - rest) ** 2 / 2, z), np.where(left, -G * (t - rest), v)

    rng = np.random.default_rng(2)
    table = frames(rng.uniform(0, 0.06, 400), rng.uniform(-0.3, 0, 400), np.arange(0, 0.15, 0.005), put_back)
    found = acceleration_profile(table, interval=0.05, radius=0.01, edges=np.linspace(0, 0.06, 6), gravity=G, end=0.1)
    np.testing.assert_allclose(found.acceleration, -G, rtol=1e-9)
    assert found.left > 0.2


def test_it_is_binned_by_the_height_of_the_start_and_within_the_radius():
    z0 = np.array([0.01, 0.03, 0.03])
    table = frames(z0, np.zeros(3), np.arange(0, 0.02, 0.005), lambda z, v, t: (z, v - np.array([1.0, 2.0, 9.0]) * t))
    table["x"] = np.where(table["id"] == 2, 0.02, 0.0)
    found = acceleration_profile(table, interval=0.005, radius=0.01, edges=np.array([0, 0.02, 0.04]), gravity=G)
    assert found.acceleration == pytest.approx([-1, -2])
    assert found.count.tolist() == [3, 3]
    aside = acceleration_profile(
        table, interval=0.005, radius=0.001, edges=np.array([0, 0.04]), gravity=G, centre=0.02, planar=True
    )
    assert aside.acceleration == pytest.approx([-9])
    with pytest.raises(ValueError, match="apart"):
        acceleration_profile(table, interval=0.5, radius=0.01, edges=np.array([0, 0.04]), gravity=G)
