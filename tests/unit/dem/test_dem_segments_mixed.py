"""Closest points with guesses in single precision, as both backends compile them: distances are right to 1e-9 m."""

import math
from types import ModuleType

import numpy as np
import pytest
from labbook_dem import generated, segments, source, words
from scipy.optimize import lsq_linear

pytestmark = pytest.mark.compiles

HALF, D = 7e-3, 6e-3  # a rod of 20 mm x 6 mm
BOUND = 1e-9  # m, of which the regularisation takes 0.8; a static overlap of such rods is 3e-8
TILTS = (0.0, *np.geomspace(1e-9, 0.3, 60))
EACH = 12
CALLS = {
    "closest": "s, t, away = closest(x, p, q, half)",
    "closest_from": "s, t = closest_from(x, p, q, half, True); away = x + p * wide(s) - q * wide(t)",
    "swapped": "t, s = closest_from(-x, q, p, half, False); away = x + p * wide(s) - q * wide(t)",
}
"""Loops by name, and how each finds s, t and the branch; the last asks of the other rod."""

LOOPS = {
    "numba": """
@njit
def run_{name}(out, c, a, b, half):
    for k in range(len(out)):
        x = wide3(c[k, 0], c[k, 1], c[k, 2])
        p = wide3(a[k, 0], a[k, 1], a[k, 2])
        q = wide3(b[k, 0], b[k, 1], b[k, 2])
        {call}
        out[k, 0], out[k, 1], out[k, 2], out[k, 3], out[k, 4] = s, t, away.x, away.y, away.z
""",
    "warp": """
@wp.kernel
def run_{name}(out: wp.array2d(dtype=wide), c: Wides3, a: Wides3, b: Wides3, half: wide):
    k = wp.tid()
    x = c[k]
    p = a[k]
    q = b[k]
    {call}
    out[k, 0] = wide(s)
    out[k, 1] = wide(t)
    out[k, 2] = away[0]
    out[k, 3] = away[1]
    out[k, 4] = away[2]
""",
}


def units(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=1)[:, None]


TILT = np.repeat(TILTS, EACH)
END_TO_END = np.arange(len(TILT)) % 4 == 0
ROUNDED = HALF * 2.0**-24  # m, by which the half length in single is wrong


def near_parallel() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Branches between centres and axes of rods that touch, or nearly: end to end, else side by side, shifted along."""
    rng = np.random.default_rng(3)
    n = len(TILT)
    a = units(rng.normal(size=(n, 3)))
    b = np.where(rng.random((n, 1)) < 0.5, 1, -1) * units(a + TILT[:, None] * units(rng.normal(size=(n, 3))))
    across = units(np.cross(a, rng.normal(size=(n, 3))))
    apart = D * rng.uniform(0.98, 1.02, (n, 1))
    beside = apart * across + rng.uniform(-2, 2, (n, 1)) * HALF * a
    on_end = (2 * HALF + apart) * a
    return np.where(END_TO_END[:, None], on_end, beside), a, b


def exact(c: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Distances [m] by a least-squares solver with bounds, in units of the half length."""

    def one(c, a, b):
        found = lsq_linear(np.column_stack([a, -b]), -c / HALF, bounds=(-1, 1), method="bvls", tol=1e-15)
        return HALF * np.sqrt(2 * found.cost)

    return np.array([one(*rods) for rods in zip(c, a, b, strict=True)])


def module(dialect: ModuleType, backend: str, folder) -> ModuleType:
    loops = "".join(LOOPS[backend].format(name=name, call=call) for name, call in CALLS.items())
    text = source.generate(dialect.header("mixed"), {}, [segments]) + loops
    return generated.load(f"segments_mixed_{backend}", text, folder)


def by_numba(folder, c, a, b) -> dict[str, np.ndarray]:
    pytest.importorskip("numba")
    from labbook_numba import dialect

    made, found = module(dialect, "numba", folder), {}
    for name in CALLS:
        found[name] = np.empty((len(c), 5))
        getattr(made, f"run_{name}")(found[name], c, a, b, HALF)
    return found


def by_warp(folder, c, a, b) -> dict[str, np.ndarray]:
    wp = pytest.importorskip("warp", reason="Warp is not installed: pip install 'labbook[warp]'")
    from labbook_warp import dialect

    wp.config.quiet = True
    wp.config.kernel_cache_dir = str(folder / "cache")
    made, found = module(dialect, "warp", folder), {}
    vectors = [wp.array(v, dtype=wp.vec3d, device="cpu") for v in (c, a, b)]
    for name in CALLS:
        out = wp.zeros((len(c), 5), dtype=wp.float64, device="cpu")
        wp.launch(getattr(made, f"run_{name}"), dim=len(c), inputs=[out, *vectors, wp.float64(HALF)], device="cpu")
        found[name] = out.numpy()
    return found


def in_double(c, a, b) -> np.ndarray:
    """Distances [m] by plain Python."""
    vectors = zip(*([words.vec3(*v) for v in one] for one in (c, a, b)), strict=True)
    branches = [segments.closest(x, p, q, HALF)[2] for x, p, q in vectors]
    return np.array([math.sqrt(words.dot(away, away)) for away in branches])


@pytest.mark.parametrize("compiled", [by_numba, by_warp])
def test_distances_near_parallel_are_those_of_a_constrained_minimisation(compiled, tmp_path):
    """And single takes nothing from double but what the length loses: its small difference is not taken in single."""
    rods = near_parallel()
    c, a, b = rods
    expected = exact(*rods)
    lost = 2 * ROUNDED * np.where(END_TO_END, 1, TILT) + 1e-15  # ends that are so much nearer, as the branch sees it
    results, plain = compiled(tmp_path, *rods), in_double(*rods)
    for name, found in results.items():
        s, t, away = found[:, :1], found[:, 1:2], found[:, 2:]
        distance = np.linalg.norm(away, axis=1)
        assert np.abs(found[:, :2]).max() <= HALF + ROUNDED, name
        # the branch is that of the points given, whatever these are
        assert np.abs(away - (c + s * a - t * b)).max() < 1e-16, name
        assert np.abs(distance - expected).max() <= BOUND, name
        more = np.abs(distance - plain) / lost
        assert more.max() <= 1, f"{name}: {more.max()} at a tilt of {TILT[more.argmax()]}"
    if compiled is by_warp:  # the CPU backend asks once a pair
        assert np.array_equal(results["closest_from"][:, :2], results["swapped"][:, :2]), "asked of either rod"
    points = results["closest_from"][:, :2]
    assert np.array_equal(points, points.astype(np.float32)), "these were taken in single"
