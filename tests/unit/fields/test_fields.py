"""Coarse-graining against direct sums, conservation laws and known motions."""

import math

import numpy as np
import pytest
from scipy import integrate

from labbook.fields import ContactRows, GrainRows, Layer, Ring, Space, axes, coarse_grain, contacts_of, grains_of
from labbook.fields.kernel import CUTOFF, amplitude

OMEGA = 1.5e-3
LAYER = Layer((-0.02, 0.02), (0.0, 0.03), 80, 60, depth=3e-3)
SPACE = Space((-0.02, 0.02), (-0.02, 0.02), (0.0, 0.03), 40, 40, 30)
RING = Ring(0.02, (0.0, 0.03), 40, 60)
GRIDS = [LAYER, SPACE, RING]


def named(grid):
    return type(grid).__name__.lower()


def grains(x, v=None, axis=None, frames=1):
    x = np.atleast_2d(np.asarray(x, float))
    return GrainRows(x, np.zeros_like(x) if v is None else v, 2e-5, 1e-8, frames, axis)


def inside(n, seed=0, margin=CUTOFF * OMEGA):
    """Grains at random whose kernels lie within every grid."""
    rng = np.random.default_rng(seed)
    r, turn = (0.02 - margin) * np.sqrt(rng.uniform(0, 1, n)), rng.uniform(0, 2 * np.pi, n)
    return np.column_stack([r * np.cos(turn), r * np.sin(turn), rng.uniform(margin, 0.03 - margin, n)])


def phi(distance, dimensions):
    inside = distance <= CUTOFF * OMEGA
    return amplitude(OMEGA, dimensions) * np.exp(-(distance**2) / (2 * OMEGA**2)) * inside


def known(array):
    """A field that is there."""
    assert array is not None
    return array


def rotation(angle):
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def test_the_kernel_integrates_to_one():
    for n, shell in ((2, lambda r: 2 * math.pi * r), (3, lambda r: 4 * math.pi * r**2)):
        total, _ = integrate.quad(lambda r: phi(r, n) * shell(r), 0, CUTOFF * OMEGA, epsabs=0)  # noqa: B023
        assert total == pytest.approx(1, rel=1e-9)
    with pytest.raises(ValueError, match="positive"):
        amplitude(0.0, 3)


@pytest.mark.parametrize("grid", GRIDS, ids=named)
def test_mass_in_the_field_is_mass_in_the_box(grid):
    x = inside(300)
    assert coarse_grain(grid, OMEGA, grains(x)).mass == pytest.approx(300 * 2e-5, rel=1e-3)
    near_walls = np.vstack([x, [[0.0199, 0, 1e-4], [0, -0.019, 0.0299]]])
    kept = coarse_grain(grid, OMEGA, grains(near_walls), normalised=True)
    assert kept.mass == pytest.approx(302 * 2e-5, rel=1e-12)
    lost = coarse_grain(grid, OMEGA, grains(near_walls))
    assert lost.mass < 301.9 * 2e-5


@pytest.mark.parametrize("grid", GRIDS, ids=named)
def test_fields_are_means_over_frames(grid):
    x, v = inside(50), np.random.default_rng(1).standard_normal((50, 3))
    one = coarse_grain(grid, OMEGA, grains(x, v))
    two = coarse_grain(grid, OMEGA, grains(np.vstack([x, x]), np.vstack([v, v]), frames=2), threads=1)
    for name in ("density", "momentum", "flux"):
        np.testing.assert_allclose(getattr(two, name), getattr(one, name), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("grid", GRIDS, ids=named)
def test_unlike_grains_weigh_what_they_are(grid):
    """Fields of two kinds together are sums of those of each alone."""
    x, v = inside(60), np.random.default_rng(5).standard_normal((60, 3))
    large = np.arange(60) < 25
    mass, volume = np.where(large, 2e-5, 3e-6), np.where(large, 1e-8, 2e-9)
    both = coarse_grain(grid, OMEGA, GrainRows(x, v, mass, volume, 1))
    alone = [
        coarse_grain(grid, OMEGA, GrainRows(x[one], v[one], float(mass[one][0]), float(volume[one][0]), 1))
        for one in (large, ~large)
    ]
    for name in ("density", "packing_fraction", "momentum", "flux", "number"):
        total = np.sum([getattr(one, name) for one in alone], axis=0)
        np.testing.assert_allclose(getattr(both, name), total, rtol=1e-9, atol=1e-12 * abs(total).max())
    turned = coarse_grain(grid, OMEGA, GrainRows(x, v, mass, volume, 1, np.tile([0.0, 0.0, 1.0], (60, 1))))
    np.testing.assert_allclose(turned.density, both.density, rtol=1e-12)
    np.testing.assert_allclose(known(turned.axes)[2, 2], both.number, rtol=1e-9, atol=1e-9 * both.number.max())


def test_a_layer_is_a_direct_sum():
    rng = np.random.default_rng(2)
    x = rng.uniform((-0.022, -1e-4, -0.002), (0.022, 1e-4, 0.032), (40, 3))
    v = rng.standard_normal((40, 3))
    found = coarse_grain(LAYER, OMEGA, grains(x, v))
    z, across = LAYER.points
    for row, column in rng.integers(0, (60, 80), (30, 2)):
        weight = phi(np.hypot(across[column] - x[:, 0], z[row] - x[:, 2]), 2) / LAYER.depth * 2e-5
        assert found.density[row, column] == pytest.approx(weight.sum(), rel=1e-9, abs=1e-9)
        np.testing.assert_allclose(found.momentum[:, row, column], weight @ v, rtol=1e-9, atol=1e-9)
        flux = np.einsum("n,na,nb->ab", weight, v, v)
        np.testing.assert_allclose(found.flux[:, :, row, column], flux, rtol=1e-9, atol=1e-9)
        if weight.sum() > 0:
            v0 = weight @ v / weight.sum()
            kinetic = np.einsum("n,na,nb->ab", weight, v - v0, v - v0)
            np.testing.assert_allclose(found.kinetic_stress[:, :, row, column], kinetic, atol=1e-9 * flux.max())
            assert found.kinetic_pressure[row, column] == pytest.approx(np.trace(kinetic), abs=1e-9 * flux.max())


def test_rings_are_means_over_the_azimuth_in_cylindrical_axes():
    """Against direct sums at 720 azimuths, turned into the axes of each."""
    rng = np.random.default_rng(3)
    x, v = inside(25, seed=3, margin=1e-3), rng.standard_normal((25, 3))
    x[0, :2] = 0.0  # on the axis
    l = rng.standard_normal((25, 3))
    l /= np.linalg.norm(l, axis=1)[:, None]
    found = coarse_grain(RING, OMEGA, grains(x, v, axis=l))
    r, z = RING.points
    for at_r, at_z in [(0, 30), (1, 20), (3, 40), *rng.integers(0, (40, 60), (12, 2))]:
        density, momentum, flux, directions = 0.0, np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3))
        for angle in np.linspace(0, 2 * np.pi, 720, endpoint=False):
            turned = rotation(-angle)
            apart = np.linalg.norm(x @ turned.T - [r[at_r], 0, z[at_z]], axis=1)
            weight, u, k = phi(apart, 3) * 2e-5 / 720, v @ turned.T, l @ turned.T
            density += weight.sum()
            momentum += weight @ u
            flux += np.einsum("n,na,nb->ab", weight, u, u)
            directions += np.einsum("n,na,nb->ab", weight, k, k) / 2e-5
        scale = found.density.max()
        # the cut-off, e^-8 of the peak, is what few azimuths see differently from many
        assert found.density[at_r, at_z] == pytest.approx(density, rel=2e-3, abs=1e-4 * scale)
        np.testing.assert_allclose(found.momentum[:, at_r, at_z], momentum, atol=4e-4 * scale)
        np.testing.assert_allclose(found.flux[:, :, at_r, at_z], flux, atol=4e-4 * scale)
        np.testing.assert_allclose(known(found.axes)[:, :, at_r, at_z], directions, atol=4e-4 * scale / 2e-5)


def test_rotating_everything_rotates_the_fields():
    rng = np.random.default_rng(4)
    x, v = inside(60, seed=4), rng.standard_normal((60, 3))
    before = coarse_grain(RING, OMEGA, grains(x, v))
    turn = rotation(1.234)
    after = coarse_grain(RING, OMEGA, grains(x @ turn.T, v @ turn.T))
    for name in ("density", "velocity", "kinetic_stress"):
        a, b = getattr(before, name), getattr(after, name)
        np.testing.assert_allclose(b, a, rtol=1e-8, atol=1e-8 * np.nanmax(abs(a)))
    quarter = rotation(np.pi / 2)
    one = coarse_grain(SPACE, OMEGA, grains(x, v))
    other = coarse_grain(SPACE, OMEGA, grains(x @ quarter.T, v @ quarter.T))
    # what was at (x, y) is at (-y, x): arrays have y before x
    np.testing.assert_allclose(other.density, one.density.transpose(0, 2, 1)[:, :, ::-1], atol=1e-9 * one.density.max())
    turned = np.einsum("ab,b...->a...", quarter, one.momentum).transpose(0, 1, 3, 2)[:, :, :, ::-1]
    np.testing.assert_allclose(other.momentum, turned, atol=1e-9 * abs(one.momentum).max())


def lattice(spacing):
    x, z = np.meshgrid(np.arange(-0.05, 0.05, spacing), np.arange(-0.02, 0.05, spacing))
    return np.column_stack([x.ravel(), np.zeros(x.size), z.ravel()])


def test_uniform_shear_gives_its_gradient():
    """And the kinetic stress that a gradient has by itself: rho rate^2 times the kernel's mean square width."""
    x, rate = lattice(OMEGA / 2), 40.0
    v = np.column_stack([rate * x[:, 2], np.zeros(len(x)), np.zeros(len(x))])
    found = coarse_grain(LAYER, OMEGA, grains(x, v))
    z, _ = LAYER.points
    np.testing.assert_allclose(
        found.velocity[0], np.broadcast_to(rate * z[:, None], LAYER.shape), atol=2e-3 * rate * OMEGA
    )
    width = OMEGA**2 * (1 - CUTOFF**2 / 2 * math.exp(-(CUTOFF**2) / 2) / (1 - math.exp(-(CUTOFF**2) / 2)))
    np.testing.assert_allclose(found.kinetic_stress[0, 0], found.density * rate**2 * width, rtol=0.01)
    np.testing.assert_allclose(found.density, 2e-5 / (OMEGA / 2) ** 2 / LAYER.depth, rtol=2e-3)


def test_directions_at_random_have_no_order_and_parallel_ones_all():
    rng = np.random.default_rng(5)
    l = rng.standard_normal((40_000, 3))
    l /= np.linalg.norm(l, axis=1)[:, None]
    x = np.repeat(inside(1), 40_000, axis=0)
    order = coarse_grain(SPACE, OMEGA, grains(x, axis=l))
    np.testing.assert_allclose(np.nanmean(np.trace(order.orientation)), 1, rtol=1e-12)
    assert np.nanmax(order.nematic_order) == pytest.approx(1 / 3, abs=0.01)
    same = coarse_grain(
        SPACE, OMEGA, grains(x[:5], axis=np.tile([0.6, 0.0, 0.8], (5, 1)) * [[1], [-1], [1], [-1], [1]])
    )
    np.testing.assert_allclose(np.nanmin(same.nematic_order), 1, rtol=1e-12)
    with pytest.raises(ValueError, match="no orientation"):
        _ = coarse_grain(SPACE, OMEGA, grains(x[:5])).orientation


def pairs(n, seed):
    """Contacts at random: centres, branches a diameter long, forces along and across them."""
    rng = np.random.default_rng(seed)
    x = inside(n, seed, margin=CUTOFF * OMEGA + 3e-3)
    b = rng.standard_normal((n, 3))
    b *= 3e-3 / np.linalg.norm(b, axis=1)[:, None]
    return x, b, -b + 2e-3 * rng.standard_normal((n, 3))


def test_contact_stress_is_the_line_integral_of_the_kernel():
    x, b, f = pairs(6, 6)
    found = known(coarse_grain(LAYER, OMEGA, grains(x), ContactRows(x, b, f, 1)).contact_stress)
    z, across = LAYER.points
    for row, column in [(25, 40), (30, 35), (33, 44), (28, 48)]:
        expected = np.zeros((3, 3))
        for start, branch, force in zip(x, b, f, strict=True):

            def along(s, start=start, branch=branch, row=row, column=column):
                at = start + s * branch
                return float(phi(np.hypot(across[column] - at[0], z[row] - at[2]), 2)) / LAYER.depth

            part, _ = integrate.quad(along, 0, 1, limit=400, epsrel=1e-8)
            expected -= np.outer(force, branch) * part
        np.testing.assert_allclose(found[:, :, row, column], expected, rtol=1e-5, atol=1e-5 * abs(found).max())


def test_the_divergence_of_the_stress_is_the_force_density():
    """d_b P_ab = - sum F_i phi(r - r_i), whatever the forces: so a static packing's stress balances gravity."""
    x, b, f = pairs(30, 7)
    both = grains(np.vstack([x, x + b]), np.vstack([f, -f]))
    density = coarse_grain(LAYER, OMEGA, both).momentum / both.mass
    stress = known(coarse_grain(LAYER, OMEGA, both, ContactRows(x, b, f, 1)).contact_stress)
    z, across = LAYER.points
    divergence = np.gradient(stress[:, 2], z, axis=1) + np.gradient(stress[:, 0], across, axis=2)
    # central differences of a Gaussian over a third of its width
    np.testing.assert_allclose(divergence[:, 2:-2, 2:-2], -density[:, 2:-2, 2:-2], atol=0.05 * abs(density).max())
    assert np.sqrt(np.mean((divergence + density) ** 2)) < 0.01 * abs(density).max()


def test_about_an_axis_as_well():
    x, b, f = pairs(30, 8)
    both = grains(np.vstack([x, x + b]), np.vstack([f, -f]))
    density = coarse_grain(RING, OMEGA, both).momentum / both.mass
    p = known(coarse_grain(RING, OMEGA, both, ContactRows(x, b, f, 1)).contact_stress)
    r, z = RING.points
    out = r[:, None]
    upward = np.gradient(out * p[2, 0], r, axis=0) / out + np.gradient(p[2, 2], z, axis=1)
    outward = np.gradient(out * p[0, 0], r, axis=0) / out - p[1, 1] / out + np.gradient(p[0, 2], z, axis=1)
    inner = (slice(6, -2), slice(2, -2))  # 1/r magnifies differences near the axis
    for found, expected in ((upward, density[2]), (outward, density[0])):
        np.testing.assert_allclose(found[inner], -expected[inner], atol=0.05 * abs(expected).max())


def test_a_column_at_rest_carries_its_weight():
    """Ten spheres on each other on a floor: the stress over any plane holds up what is above it."""
    d, m, g, n = 3e-3, 2e-5, 9.81, 10
    x = np.column_stack([np.zeros(n), np.zeros(n), d / 2 + d * np.arange(n)])
    weight_above = m * g * np.arange(n, 0, -1)
    force = np.column_stack([np.zeros(n), np.zeros(n), weight_above])  # on each grain, from below
    branch = np.tile([0, 0, -d], (n, 1)) * np.where(np.arange(n) == 0, 0.5, 1.0)[:, None]  # the first to the floor
    grid = Layer((-0.01, 0.01), (-0.01, 0.04), 80, 200, depth=d)
    found = coarse_grain(grid, OMEGA, grains(x), ContactRows(x, branch, force, 1))
    z, _ = grid.points
    area = (grid.x[1] - grid.x[0]) / grid.nx * grid.depth
    carried = known(found.contact_stress)[2, 2].sum(axis=1) * area
    above = np.array([(found.density[k:].sum() * area * (z[1] - z[0])) * g for k in range(len(z))])
    well_above_the_floor = z > CUTOFF * OMEGA
    np.testing.assert_allclose(carried[well_above_the_floor], above[well_above_the_floor], atol=0.02 * n * m * g)


def test_rows_of_tables_become_grains_and_contacts():
    sample = {"step": [10, 10, 20, 20], "time": [0.1, 0.1, 0.2, 0.2], "id": [7, 3, 3, 7]}
    sample |= {"x": [7.0, 3, 3, 7], "y": [0.0] * 4, "z": [1.0, 1, 2, 2]} | {v: [0.0] * 4 for v in ("vx", "vy", "vz")}
    sample |= {"qw": [1.0] * 4, "qx": [0.0] * 4, "qy": [0.0] * 4, "qz": [0.0] * 4}
    sample = {name: np.array(column) for name, column in sample.items()}
    made = grains_of(sample, 1.0, 2.0, 0.15, 0.25)
    assert made.frames == 1
    assert made.x[:, 0].tolist() == [3, 7]
    assert known(made.axis).tolist() == [[0, 0, 1], [0, 0, 1]]
    contact = {"step": [20, 10], "time": [0.2, 0.1], "i": [7, 3], "j": [3, -1]}
    contact |= {name: [0.1, 0.2] for name in ("fx", "fy", "fz", "bx", "by", "bz")}
    contact = {name: np.array(column) for name, column in contact.items()}
    lines = contacts_of(contact, sample, 0.0, 1.0)
    assert lines.frames == 2
    assert lines.x.tolist() == [[7, 0, 2], [3, 0, 1]]
    with pytest.raises(ValueError, match="no frame"):
        grains_of(sample, 1.0, 2.0, 0.5, 1.0)
    with pytest.raises(ValueError, match="equally often"):
        contacts_of(contact | {"step": np.array([20, 15])}, sample, 0.0, 1.0)


def test_axes_are_those_of_the_rotations():
    from scipy.spatial.transform import Rotation

    turns = Rotation.from_rotvec(3 * np.random.default_rng(1).standard_normal((20, 3)))
    found = axes(turns.as_quat(scalar_first=True))
    np.testing.assert_allclose(found, turns.apply([0, 0, 1]), atol=1e-12)


@pytest.mark.parametrize("make", [lambda: Layer((1, 0), (0, 1), 5, 5, 1), lambda: Ring(0.1, (0, 1), 0, 5)])
def test_empty_grids_are_refused(make):
    with pytest.raises(ValueError, match="at least one cell"):
        make()
