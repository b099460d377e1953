"""Either backend moves rods as the reference does, contact by contact, and lists every pair that touches."""

from dataclasses import replace

import labbook_reference
import numpy as np
import pytest
from labbook_reference.member import Run
from platforms import Bundled, platforms, sharing, where
from rods_in_silo import ROUNDING, D, advanced, numerics, silo, trough

from labbook.backend.probes import Contacts, Ledger, Sample
from labbook.filling.placing import place
from labbook.scene import Frustum, HertzMindlin, Plane, Primitives, Scene, Strip, SurfaceMotion, Wall
from labbook.scene.orientation import axes, distances
from labbook.scene.packing import Packing

pytestmark = pytest.mark.compiles

FAR = 10.0  # m, height at which no rod is
BEYOND_REACH = (
    Wall(name="roof", shape=Plane(point=(0, 0, FAR), normal=(0, 0, -1))),
    Wall(name="shelf", shape=Strip(start=(-1, FAR), end=(1, FAR))),
)
RING = Wall(name="ring", shape=Frustum(lower=(1, FAR), upper=(2, FAR)), motion=SurfaceMotion(spin=1.0))
RIGHT = 1e-9  # m, to which distances of rods are right, in either precision: test_dem_segments_mixed
PROBES = Contacts(), Sample(fields=("x", "q")), Ledger()


def compiled_once(scene: Scene, platform: Bundled) -> Scene:
    """The scene with one law, an outlet and every kind of wall, of which one turns.

    A backend so compiles one set of kernels for all of them. In its first precision it shares them with the contract of
    rods, which has linear springs; in the other one the law is that of Hertz.
    """
    hertz = HertzMindlin(shear_modulus=2e6, poisson_ratio=0.25, friction=0.5, rolling_friction=0.01, restitution=0.5)
    walls = scene.container.walls()
    has = {wall.shape.kind for wall in walls}
    further = [wall for wall in BEYOND_REACH if wall.shape.kind not in has]
    return scene.model_copy(
        update={
            "contact": hertz if platform.second else scene.contact,
            "container": Primitives(parts=(*walls, *further, RING), outlet_plane=-FAR),
        }
    )


def run(platform: Bundled, scene: Scene, start: Packing, beats: int, **further):
    """One member, advanced: its packing and rows."""
    how = numerics(platform.precision, overlap_limit=1.0, **further)
    return advanced(platform.backend, scene, how, start, beats, PROBES, platform.device)


@pytest.fixture(
    scope="module",
    params=[
        where(sharing(platform), once=True) for platform in platforms() if platform.device == "cpu" and platform.lists
    ],
)
def platform(request) -> Bundled:
    return request.param


@pytest.fixture(scope="module")
def bed(platform: Bundled) -> Packing:
    """Rods that have fallen into the closed silo and still move."""
    closed = silo(40).close()
    return run(platform, compiled_once(closed, platform), place(closed, "gas", 1), 100)[0]


def spring_by_contact(packing: Packing, scene: Scene) -> dict[tuple, np.ndarray]:
    """Springs of a packing by the keys that the reference has for contacts."""
    names = [wall.name for wall in scene.container.walls()]
    walls = zip(packing.wall_grain, packing.wall_name, packing.wall_part, packing.wall_spring, strict=True)
    stored = {(int(i), int(j)): s for (i, j), s in zip(packing.pairs, packing.pair_spring, strict=True)}
    return stored | {(int(g), names.index(str(name)), int(part)): s for g, name, part, s in walls}


@pytest.mark.slow
@pytest.mark.parametrize("scene", [silo(40), trough()], ids=["frustums", "planes and strips"])
def test_rods_move_as_in_the_reference(platform, scene, bed):
    """A hundred steps of rods in motion: pairs, ends at sides and on plates, one of which turns, and edges."""
    rng = np.random.default_rng(2)
    start = replace(
        bed,
        v=bed.v + rng.normal(0, 0.1, bed.v.shape), omega=bed.omega + rng.normal(0, 5, bed.v.shape),
        pairs=np.zeros((0, 2), np.int64), pair_spring=np.zeros((0, 3)), wall_grain=np.zeros(0, np.int64),
        wall_name=np.zeros(0, "U40"), wall_spring=np.zeros((0, 3)), wall_part=np.zeros(0, np.int64),
    )  # fmt: skip
    scene = compiled_once(scene, platform)
    touched = edges = 0
    how = numerics("double", overlap_limit=1.0, steps_per_beat=1)
    plain = Run.started(labbook_reference.Backend.capabilities, scene, how, (), start)
    for _ in range(100):
        plain.beat()
        touched = max(touched, sum(len(key) == 2 for key in plain.springs))
        edges = max(edges, sum(len(key) == 3 and key[2] > 1 for key in plain.springs))
    assert touched > 10
    assert edges > 2
    found, _ = run(platform, scene, start, 4, steps_per_beat=25)
    assert found.q is not None
    assert plain.q is not None
    assert plain.failure is None
    rounding = ROUNDING[platform.precision]
    assert np.abs(found.x - plain.x).max() < rounding * np.abs(plain.x - start.x).max()
    assert np.abs(axes(found.q) - axes(plain.q)).max() < rounding
    stored = spring_by_contact(found, scene)
    assert set(stored) == set(plain.springs)
    size = max(np.linalg.norm((s.x, s.y, s.z)) for s in plain.springs.values())
    for key, s in plain.springs.items():
        assert np.abs(stored[key] - (s.x, s.y, s.z)).max() < 10 * rounding * size, key


@pytest.mark.slow
def test_all_pairs_that_touch_are_listed(platform, bed):
    """Rows of contacts against the distances of all pairs."""
    _, tables = run(platform, compiled_once(silo(40).close(), platform), bed, 8)
    contacts, sample, ledger = (tables[probe] for probe in PROBES)
    assert ledger["rebuilds"][-1] > ledger["rebuilds"][0]
    seen = 0
    for step in np.unique(sample["step"]):
        now, rows = sample["step"] == step, contacts["step"] == step
        x = np.stack([sample[axis][now] for axis in "xyz"], axis=1)
        a = axes(np.stack([sample["q" + axis][now] for axis in "wxyz"], axis=1))
        i, j = np.triu_indices(len(x), 1)
        near = distances(x[i] - x[j], a[i], a[j], 1.15 * D) - D
        listed = set(zip(contacts["i"][rows].tolist(), contacts["j"][rows].tolist(), strict=True))
        for k in np.flatnonzero(np.abs(near) > RIGHT):
            assert ((i[k], j[k]) in listed) == (near[k] < 0)
            seen += int(near[k] < 0)
    assert seen > 100
