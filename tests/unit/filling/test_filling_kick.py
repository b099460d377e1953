"""The kick of a further discharge: its size, what it leaves alone, and what decides it."""

from dataclasses import replace

import numpy as np
import pytest

from labbook.filling import Kick, kick_grains
from labbook.filling.kick import SPEED, VERSION
from labbook.scene import HertzMindlin, Scene, Spheres, WedgeHopper
from labbook.scene.packing import Packing

COUNT, D, G = 3000, 3e-3, 9.81


def scene() -> Scene:
    return Scene(
        grains=Spheres(diameter=D, density=2500, count=COUNT),
        contact=HertzMindlin(shear_modulus=1e8, poisson_ratio=0.25, friction=0.5, restitution=0.2),
        container=WedgeHopper(width=0.1, height=0.4, thickness=3.03e-3, orifice=0.03),
    )


def bed(plane: bool = False) -> Packing:
    rng = np.random.default_rng(0)
    x, v, omega = rng.random((3, COUNT, 3))
    if plane:
        x[:, 1] = 0.4
        v[:, 1] = 0
    springs = {"pairs": np.array([[0, 1]]), "pair_spring": np.ones((1, 3))}
    return Packing(x=x, v=1e-6 * v, omega=1e-3 * omega, **springs)


def test_velocities_have_the_size_that_is_stated():
    change = kick_grains(bed(), scene(), Kick(2), 1).v - bed().v
    scale = 1e-3 * np.sqrt(G * D)
    # of n normal numbers the standard deviation is known to 1/sqrt(2 n), the mean to 1/sqrt(n): four of each
    assert change.std(axis=0) == pytest.approx(scale, rel=4 / np.sqrt(2 * COUNT))
    assert np.abs(change.mean(axis=0)).max() < 4 * scale / np.sqrt(COUNT)
    assert np.abs(np.corrcoef(change.T) - np.eye(3)).max() < 4 / np.sqrt(COUNT)
    assert pytest.approx(1e-3) == SPEED


def test_nothing_but_velocities_changes():
    start, found = bed(), kick_grains(bed(), scene(), Kick(2), 1)
    for name in ("x", "omega", "ids", "pairs", "pair_spring"):
        assert np.array_equal(getattr(found, name), getattr(start, name))


def test_a_bed_in_a_plane_stays_in_it():
    found = kick_grains(bed(plane=True), scene(), Kick(2), 1)
    assert not found.v[:, 1].any()
    assert found.v[:, 0].any()


def test_seed_and_number_decide_and_nothing_else():
    def drawn(kick: Kick, seed: int) -> bytes:
        return kick_grains(bed(), scene(), kick, seed).v.tobytes()

    assert drawn(Kick(2), 1) == drawn(Kick(2), 1)
    others = [
        drawn(kick, seed) for kick in (Kick(2), Kick(3), replace(Kick(2), version=VERSION + 1)) for seed in (1, 2)
    ]
    assert len(set(others)) == len(others)


@pytest.mark.parametrize(("discharge", "version"), [(1, 1), (0, 1), (2, 0), (2**31, 1)])
def test_the_first_discharge_has_no_kick(discharge, version):
    with pytest.raises(ValueError, match="no discharge has this kick"):
        Kick(discharge, version)
