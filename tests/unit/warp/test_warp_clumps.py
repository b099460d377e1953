"""Clumps on the GPU backend: members of clumps of several numbers of spheres side by side, and threads that share."""

from dataclasses import replace

import numpy as np
import pytest
from platforms import identical

pytest.importorskip("warp")

import warp as wp
from labbook_warp import Backend
from rods_on_warp import sharing

from labbook.backend.numerics import Numerics
from labbook.backend.probes import Contacts, Crossing, Ledger, Sample
from labbook.checks.verify.clumps import SEED, D
from labbook.checks.verify.platform import rows_of
from labbook.filling.placing import place
from labbook.scene import Clumps, CylinderSilo, LinearSpringDashpot, Packing, Scene

pytestmark = pytest.mark.compiles

CHAIN = Clumps(
    diameter=D, centres=tuple((0.0, 0.0, 0.4 * D * k) for k in range(5)), density=1300, count=24
)  # fmt: skip
SEEDS = SEED.model_copy(update={"count": 30})
LAW = LinearSpringDashpot(normal_stiffness=400, friction=0.5, rolling_friction=0.05, restitution=0.5)
PROBES = Sample(fields=("x", "omega", "q")), Crossing(), Ledger(), Contacts(every=20)


def silo(grains: Clumps) -> Scene:
    return Scene(grains=grains, contact=LAW, container=CylinderSilo(diameter=6 * D, height=0.4, orifice=4 * D))


def numerics(precision: str) -> Numerics:
    return Numerics.model_validate({"dt": 2e-5, "precision": precision, "steps_per_beat": 100})


def thrown(scene: Scene) -> Packing:
    """Clumps that fall into the closed silo."""
    start = place(scene.close(), "gas", 1)
    return replace(start, v=np.tile([0.0, 0.0, -0.5], (len(start), 1)))


def ends(backend: Backend, scenes, precision: str, beats: int = 25, device: str = "cpu"):
    """Packings, checkpoints and drained rows of members side by side, each of which starts with `thrown` grains."""
    how = numerics(precision)
    ensemble = backend.open(backend.specialise(scenes[0], how, PROBES), None, device)
    try:
        members = [ensemble.admit(scene, how, thrown(scene)) for scene in scenes]
        assert not ensemble.advance(beats)
        tables = ensemble.drain()
        rows = [{probe: rows_of(table, member) for probe, table in tables.items()} for member in members]
        return [(ensemble.packing(member), ensemble.checkpoint(member)) for member in members], rows
    finally:
        ensemble.close()


@pytest.mark.ring
def test_members_of_several_numbers_of_spheres_share_a_launch():
    """Each in the bits that it has alone: seeds of three spheres and chains of five."""
    scenes = [silo(SEEDS), silo(CHAIN), silo(SEEDS)]
    together, rows = ends(sharing(), scenes, "mixed")
    for k in (0, 1):
        ((alone, stored),), (own,) = ends(sharing(), [scenes[k]], "mixed")
        assert identical(together[k][0], alone)
        assert len(alone.pairs) > 2
        assert len(alone) < scenes[k].grains.count, "some have left"
        assert np.array_equal(together[k][1].arrays["clump_m"], stored.arrays["clump_m"])
        for probe in PROBES:
            assert identical(rows[k][probe], own[probe]), probe
    assert identical(together[0][0], together[2][0])


@pytest.mark.ring
def test_a_checkpoint_of_other_clumps_is_refused():
    ((_, stored),), _ = ends(sharing(), [silo(SEEDS)], "mixed", beats=2)
    how, scene, backend = numerics("mixed"), silo(CHAIN), sharing()
    spec = backend.specialise(scene, how, PROBES)
    assert spec.features == backend.specialise(silo(SEEDS), how, PROBES).features
    ensemble = backend.open(spec, None, "cpu")
    shuffled = {**stored.arrays, "ids": stored.arrays["ids"][::-1].copy()}
    for of, arrays in ((scene, stored.arrays), (silo(SEEDS), shuffled)):
        with pytest.raises(ValueError, match=r"(grains of|spheres of clumps)"):
            ensemble.admit(of, how, replace(stored, arrays=arrays))
    ensemble.close()


@pytest.mark.gpu
@pytest.mark.parametrize("precision", ["double", "mixed"])
def test_threads_that_share_a_sphere_change_no_bit(precision):
    if not wp.is_cuda_available():
        pytest.skip("no GPU")
    scenes = [silo(SEEDS), silo(CHAIN)]
    one, four = (ends(Backend(lanes=lanes), scenes, precision, device="cuda:0")[0] for lanes in (1, 4))
    for (alone, _), (shared, _) in zip(one, four, strict=True):
        assert len(alone.pairs) > 2
        assert identical(alone, shared)
