"""Where a rod is nearest to a rim, sought in single precision: as both backends compile it, right to 1e-9 m."""

import math
from types import ModuleType

import numpy as np
import pytest
from labbook_dem import generated, source, words
from labbook_dem.walls import frustum

pytestmark = pytest.mark.compiles

HALF, RIM, LENGTH = 7e-3, 30e-3, 65e-3  # of a rod of 20 mm x 6 mm, of an outlet and its plate [m]
DEEP = 1e-5  # m, by which each rod overlaps what it is nearest to: a violent hit
COUNT = 1000
BOUND = 1e-9  # m; a static overlap of such rods is 3e-8
MOSTLY = 1e-12  # m, in 98 % of all cases: next to nothing is lost but where two minima merge

PLATES = {"plate": (1.0, 0.0), "cone": (math.sqrt(0.5), math.sqrt(0.5)), "tube": (0.0, 1.0)}
"""Direction of a plate from its rim: radial, axial."""

LOOPS = {
    "numba": """
@njit
def run(out, c, a, along, radius):
    for k in range(len(out)):
        x, p = wide3(c[k, 0], c[k, 1], c[k, 2]), wide3(a[k, 0], a[k, 1], a[k, 2])
        rim, out_along = wide3({rim}, 0.0, 0.0), wide3(along[0], 0.0, along[1])
        met, s, other, back = frustum_edges(rim, out_along, {length}, x, p, {half}, radius[k])
        out[k, 0], out[k, 1], out[k, 2], out[k, 3] = met, s, other, back
""",
    "warp": """
@wp.kernel
def run(out: wp.array2d(dtype=wide), c: Wides3, a: Wides3, radial: wide, axial: wide, radius: Wides):
    k = wp.tid()
    rim = wide3(wide({rim}), wide(0.0), wide(0.0))
    along = wide3(radial, wide(0.0), axial)
    met, s, other, back = frustum_edges(rim, along, wide({length}), c[k], a[k], wide({half}), radius[k])
    out[k, 0] = met
    out[k, 1] = s
    out[k, 2] = other
    out[k, 3] = back
""",
}


def rods() -> tuple[np.ndarray, np.ndarray]:
    """Centres near the rim and axes: half of them nearly level, and some that only just reach over it."""
    rng = np.random.default_rng(4)
    angle = rng.uniform(0, 2 * np.pi, COUNT)
    rho = RIM + rng.normal(size=COUNT) * 6e-3
    c = np.stack([rho * np.cos(angle), rho * np.sin(angle), rng.normal(size=COUNT) * 3e-3], axis=1)
    a = rng.normal(size=(COUNT, 3))
    a[::2, 2] *= 0.02
    level = slice(0, COUNT, 10)  # along the rim, touching the circle from outside, from 10 nm to 1 mm deep
    deep = np.geomspace(1e-8, 1e-3, len(angle[level]))
    c[level, :2] = (RIM - deep)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)[level]
    a[level] = np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=1)[level]
    return c, a / np.linalg.norm(a, axis=1)[:, None]


def module(dialect: ModuleType, backend: str, folder) -> ModuleType:
    loop = LOOPS[backend].format(rim=RIM, length=LENGTH, half=HALF)
    text = source.generate(dialect.header("mixed"), {}, [frustum]) + loop
    return generated.load(f"rims_mixed_{backend}", text, folder)


def by_numba(folder, c, a, along, radius) -> np.ndarray:
    pytest.importorskip("numba")
    from labbook_numba import dialect

    out = np.empty((len(c), 4))
    module(dialect, "numba", folder).run(out, c, a, np.array(along), radius)
    return out


def by_warp(folder, c, a, along, radius) -> np.ndarray:
    wp = pytest.importorskip("warp", reason="Warp is not installed: pip install 'labbook[warp]'")
    from labbook_warp import dialect

    wp.config.quiet = True
    wp.config.kernel_cache_dir = str(folder / "cache")
    out = wp.zeros((len(c), 4), dtype=wp.float64, device="cpu")
    vectors = [wp.array(v, dtype=wp.vec3d, device="cpu") for v in (c, a)]
    direction = [wp.float64(x) for x in along]
    inputs = [out, *vectors, *direction, wp.array(radius, dtype=wp.float64, device="cpu")]
    wp.launch(module(dialect, "warp", folder).run, dim=len(c), inputs=inputs, device="cpu")
    return out.numpy()


def plate(along) -> tuple[words.vec3, words.vec3, float]:
    return words.vec3(RIM, 0.0, 0.0), words.vec3(along[0], 0.0, along[1]), LENGTH


def in_double(c, a, along, radius) -> np.ndarray:
    """By plain Python."""
    vectors = zip(*([words.vec3(*v) for v in one] for one in (c, a)), radius, strict=True)
    return np.array([frustum.frustum_edges(*plate(along), x, p, HALF, r) for x, p, r in vectors])


def thickness(c, a, along) -> np.ndarray:
    """Radii with which rods touch: the smallest distance from the plate of any of their points, and DEEP more."""
    on = np.linspace(-HALF, HALF, 400)
    points = c[:, None, :] + on[None, :, None] * a[:, None, :]
    off = [[frustum.frustum_distance(*plate(along), words.vec3(*x))[0] for x in rod] for rod in points]
    return np.min(off, axis=1) + DEEP


@pytest.mark.parametrize("along", PLATES.values(), ids=PLATES)
@pytest.mark.parametrize("compiled", [by_numba, by_warp])
def test_distances_from_a_rim_lose_nothing_to_single(compiled, along, tmp_path):
    c, a = rods()
    radius = thickness(c, a, along)
    found, plain = compiled(tmp_path, c, a, along, radius), in_double(c, a, along, radius)
    for column in (0, 2):
        here, there = found[:, column], plain[:, column]
        touching = np.minimum(here, there) < radius - BOUND
        assert touching.sum() > 10
        error = np.abs(here - there)[touching]  # of one that only one of them finds, 1e9
        assert error.max() <= BOUND
        assert np.quantile(error, 0.98) <= MOSTLY
        assert np.abs(found - plain)[touching, column + 1].max() <= 1e-6  # where on the segment
