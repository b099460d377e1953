"""The contract holds for rolling springs: packings and checkpoints keep them, and all backends compute the same."""

# packings of these tests have rolling springs
# pyright: reportOptionalMemberAccess=false, reportOptionalSubscript=false, reportArgumentType=false

from dataclasses import replace

import numpy as np
import pytest
from platforms import identical

from labbook.backend import load
from labbook.checks.verify.materials import D, G, hertz
from labbook.checks.verify.symmetry import DT, SOFT
from labbook.filling import place, start_of_discharge
from labbook.scene import Kind, Scene, Spheres, WedgeHopper
from labbook.scene.packing import Packing

KINDS = (Kind(name="large", share=0.5), Kind(name="small", share=0.5, diameter=0.8 * D, density=7800))


def hopper(kinds=()) -> Scene:
    law = hertz(shear_modulus=SOFT, rolling_friction=0.2, rolling_model="epsd", rolling="rolling")
    silo = WedgeHopper(width=10 * D, height=60 * D, thickness=1.01 * D, angle=1.0, orifice=4 * D)
    return Scene(
        grains=Spheres(diameter=D, density=2500, count=40, kinds=kinds), contact=law, container=silo, gravity=G
    )


# kernels for both at once are compiled for this module alone; mixtures and rolling springs have tests of their own
UNLIKE = pytest.param("unlike", marks=pytest.mark.ring)


@pytest.fixture(scope="module", params=["equal", UNLIKE])
def bed(request, platform):
    """Grains that have fallen into the closed hopper, its outlet now open; numerics, and an ensemble for it."""
    if request.param == "unlike" and platform.second:
        pytest.skip("mixtures are checked in one precision of a backend on a processor")
    scene = hopper(KINDS if request.param == "unlike" else ())
    closed, numerics = scene.close(), platform.numerics(DT / 2, steps_per_beat=250)
    ensemble = platform.backend.open(platform.backend.specialise(closed, numerics), 1, platform.device)
    member = ensemble.admit(closed, numerics, place(closed, "gas", 1))
    ensemble.advance(26)
    start = start_of_discharge(ensemble.packing(member), closed, scene)
    ensemble.close()
    ensemble = platform.backend.open(platform.backend.specialise(scene, numerics), 2, platform.device)
    yield scene, numerics, start, ensemble
    ensemble.close()


def test_a_packing_has_the_torques_of_its_contacts(bed):
    scene, _, start, _ = bed
    assert len(start.pairs) > 15
    assert len(start.wall_grain) > 20
    torques = np.linalg.norm(np.vstack([start.pair_rolling, start.wall_rolling]), axis=1)
    weight = scene.grains.mass * G
    assert 0.001 < np.median(torques) / (0.2 * D / 2 * weight) < 10, "they bear torques of the order of mu_r R m g"


def test_a_packing_begins_with_its_rolling_springs(bed):
    """What a member reads out at step 0 is what it was given; the first step then advances it."""
    scene, numerics, start, ensemble = bed
    member = ensemble.admit(scene, numerics, start)
    again = ensemble.packing(member)
    ensemble.retire(member)
    rounding = float(np.finfo(np.float32 if numerics.precision == "mixed" else np.float64).eps)
    for one, other in zip(ordered(again), ordered(start), strict=True):
        np.testing.assert_allclose(one, other, rtol=rounding, atol=0)


def test_they_decide_how_it_goes_on(bed):
    scene, numerics, start, ensemble = bed
    none = replace(start, pair_rolling=None, wall_rolling=None)
    members = [ensemble.admit(scene, numerics, one) for one in (start, none)]
    ensemble.advance(1)
    with_, without = (ensemble.packing(member) for member in members)
    for member in members:
        ensemble.retire(member)
    assert not np.array_equal(with_.omega, without.omega)


def test_a_checkpoint_keeps_them_bit_for_bit(bed):
    """Also across rebuilds and with grains leaving."""
    scene, numerics, start, ensemble = bed
    one = ensemble.admit(scene, numerics, start)
    ensemble.advance(8)
    halfway = ensemble.checkpoint(one)
    ensemble.advance(20)
    end = ensemble.packing(one)
    ensemble.retire(one)
    assert len(end) < len(start), "grains have left"
    assert np.abs(end.pair_rolling).max() > 0
    other = ensemble.admit(scene, numerics, halfway)
    ensemble.advance(20)
    assert identical(ensemble.packing(other), end)
    ensemble.retire(other)


def ordered(packing: Packing) -> tuple[np.ndarray, np.ndarray]:
    """Torques of pairs and at walls, in an order that does not depend on rows."""
    pairs = packing.ids[packing.pairs]
    sign = np.where(pairs[:, 0] < pairs[:, 1], 1.0, -1.0)[:, None]
    pairs = np.sort(pairs, axis=1)
    walls = np.lexsort((packing.wall_name, packing.ids[packing.wall_grain]))
    return (sign * packing.pair_rolling)[np.lexsort(pairs.T)], packing.wall_rolling[walls]


def test_it_moves_grains_as_the_reference_does(bed, platform):
    """A hundred steps from one packing. Each of some ten forces on a grain is off by roundings, which steps add up."""
    scene, numerics, start, ensemble = bed
    how = numerics.model_copy(update={"steps_per_beat": 100})
    ended = []
    for backend, precision, device in (
        (platform.backend, platform.precision, platform.device),
        (load("reference"), "double", "cpu"),
    ):
        mine = how.model_copy(update={"precision": precision})
        ensemble = backend.open(backend.specialise(scene, mine), 1, device)
        member = ensemble.admit(scene, mine, start)
        ensemble.advance(1)
        ended.append(ensemble.packing(member))
        ensemble.close()
    found, expected = ended
    rounding = float(np.finfo(np.float32 if platform.precision == "mixed" else np.float64).eps)
    assert len(found.pairs) == len(expected.pairs)
    assert np.abs(found.x - expected.x).max() / D < 1000 * rounding
    assert np.abs(found.omega - expected.omega).max() / np.sqrt(G / D) < 1e5 * rounding
    scale = 0.2 * D / 2 * scene.grains.mass * G
    for one, other in zip(ordered(found), ordered(expected), strict=True):
        assert np.abs(one - other).max() / scale < 1e5 * rounding
        assert np.abs(other).max() > 0.1 * scale
