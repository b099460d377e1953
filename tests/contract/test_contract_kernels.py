"""Kernels with all features in, which tests share, move grains as those that have in only what a scene needs.

All other tests of the contract hold the compiled backends to account on the former, on a processor; users' runs are of
the latter. The scenes here leave out, between them, every feature that may be left out.
"""

from dataclasses import replace

import numpy as np
import pytest
from labbook_dem.features import ALWAYS
from labbook_dem.walls import WALLS
from platforms import specialised

from labbook.backend.probes import Contacts
from labbook.checks.verify.materials import D, G, hertz, linear
from labbook.checks.verify.symmetry import DT, SOFT
from labbook.scene import Frustum, Kind, Plane, Primitives, Scene, Spheres, Spherocylinders, Wall
from labbook.scene.packing import Packing

STEPS = 100
SPEED = 0.5
"""Of grains that are about to collide, in each direction [m/s]: 3 sqrt(g d), so that all do within the 2.5 ms."""
ROUNDINGS = 1500
"""Allowed differences of positions [d], velocities [sqrt(g d)] and spins [sqrt(g/d)], in roundings of forces.

Both kernels take the same operations; of some the compiler fuses or orders others. A force of contact takes 16 of them,
a grain has up to 12 contacts, and within 2.5 ms collisions amplify a difference by e twice (`test_compare_engines`):
16 * 12 * e^2 = 1400. A force that one kernel lacked, or had wrong in its third digit, would be 10^8 roundings away.
"""
SMOOTH = {"friction": 0.0, "rolling_friction": 0.0}
ROD = Spherocylinders(diameter=D, length=2 * D, density=2500, count=27)
SIZES = (Kind(name="large", share=0.5), Kind(name="small", share=0.5, diameter=0.8 * D, density=7800))


def free() -> Scene:
    """Smooth spheres and nothing else."""
    return Scene(grains=Spheres(diameter=D, density=2500, count=27), contact=linear(**SMOOTH), container=Primitives())


def in_a_tube() -> Scene:
    """Spheres of two kinds with friction, which roll freely, within a tube over a cone."""
    tube = Frustum(lower=(2.2 * D, -0.01), upper=(2.2 * D, 0.1))
    cone = Frustum(lower=(0.0, -1.8 * D), upper=(2.2 * D, -1.4 * D))
    walls = Primitives(parts=(Wall(name="tube", shape=tube), Wall(name="cone", shape=cone)))
    grains = Spheres(diameter=D, density=2500, count=27, kinds=SIZES)
    return Scene(grains=grains, contact=hertz(shear_modulus=SOFT, rolling_friction=0.0), container=walls, gravity=G)


def on_springs() -> Scene:
    """Spheres over a plane, with rolling springs."""
    floor = Wall(name="floor", shape=Plane(point=(0.0, 0.0, -1.52 * D), normal=(0.0, 0.0, 1.0)))
    law = hertz(shear_modulus=SOFT, rolling_friction=0.2, rolling_model="epsd")
    grains = Spheres(diameter=D, density=2500, count=27)
    return Scene(grains=grains, contact=law, container=Primitives(parts=(floor,)), gravity=G)


def over_a_floor() -> Scene:
    """Smooth rods over a plane."""
    floor = Wall(name="floor", shape=Plane(point=(0.0, 0.0, -3.02 * D), normal=(0.0, 0.0, 1.0)))
    return Scene(grains=ROD, contact=linear(**SMOOTH), container=Primitives(parts=(floor,)), gravity=G)


def crowd(scene: Scene) -> Packing:
    """27 grains on a lattice, nearly touching, at random velocities and spins; rods stand upright."""
    rng = np.random.default_rng(1)
    x = 1.02 * D * np.stack(np.meshgrid(*[(-1.0, 0.0, 1.0)] * 3), axis=-1).reshape(-1, 3)
    v, omega = rng.normal(size=(2, 27, 3)) * np.array([SPEED, SPEED / D])[:, None, None]
    start = Packing(x=x, v=v, omega=omega)
    if isinstance(scene.grains, Spherocylinders):
        return replace(start, x=x * [1.0, 1.0, 2.0], q=np.tile([1.0, 0.0, 0.0, 0.0], (27, 1)))
    if scene.grains.varied:
        kind = rng.permutation(27) % 2
        return replace(start, kind=kind, diameter=np.where(kind == 0, D, 0.8 * D))
    return start


SCENES = {"free": free, "in a tube": in_a_tube, "on springs": on_springs, "over a floor": over_a_floor}
"""Further scenes than the silo, which has planes and strips, friction and rolling resistance."""


@pytest.fixture
def sharing(silo):
    if not silo.platform.wide:
        pytest.skip("each scene has kernels of its own on this backend, in tests too, or there are none")
    return silo


def taken_from(silo, name: str) -> tuple[Scene, Packing]:
    if name == "silo":
        return silo.scene, silo.start
    scene = SCENES[name]()
    return scene, crowd(scene)


def moved(silo, platform, scene: Scene, start: Packing) -> tuple[Packing, bool]:
    """Where the grains are after STEPS, and whether a wall was seen to push one."""
    numerics = silo.numerics(steps_per_beat=2)
    with silo.ensemble(scene, numerics, (Contacts(),), 1, platform) as ensemble:
        member = ensemble.admit(scene, numerics, start)
        assert not ensemble.advance(STEPS // 2)
        (contacts,) = ensemble.drain().values()
        return ensemble.packing(member), bool((contacts["wall"] >= 0).any())


RARE = {*SCENES}
"""Scenes whose own kernels no other test needs, and which take twenty seconds to a minute to compile: in the ring."""


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.ring] * (name in RARE)) for name in ("silo", *SCENES)]
)
def test_they_move_grains_as_specialised_ones_do(sharing, name):
    if name not in ("silo", "free") and sharing.platform.second:
        pytest.skip("mixtures and rods are compared in one precision")
    scene, start = taken_from(sharing, name)
    (wide, _), (own, at_a_wall) = (
        moved(sharing, s, scene, start) for s in (sharing.platform, specialised(sharing.platform))
    )
    # where all fell freely there would be nothing to see
    pushed = np.linalg.norm(own.v - start.v + [0, 0, scene.gravity * STEPS * DT], axis=1) > 0.01
    assert pushed.sum() > len(start) / 2
    assert at_a_wall == (name != "free")
    limit = ROUNDINGS * sharing.rounding
    assert np.abs(wide.x - own.x).max() / D < limit
    assert np.abs(wide.v - own.v).max() / np.sqrt(G * D) < limit
    assert np.abs(wide.omega - own.omega).max() / np.sqrt(G / D) < limit


def test_they_leave_out_every_feature(sharing):
    numerics, backend = sharing.numerics(), specialised(sharing.platform).backend
    features = {name: backend.specialise(taken_from(sharing, name)[0], numerics) for name in ("silo", *SCENES)}
    out = {name: {switch for switch in ALWAYS if not spec.feature(switch)} for name, spec in features.items()}
    out = {name: switches | set(WALLS) - set(features[name].feature("walls")) for name, switches in out.items()}
    every = {*ALWAYS, *WALLS}
    assert out["silo"] == {"MOVING", "frustum", "thick-plate", "CROSSING", "LEDGER"}
    assert out["free"] == every, "of a scene with nothing but grains"
    assert out["in a tube"] >= {"ROLLING", "plane", "strip", "OUTLET"}
    assert out["on springs"] >= {"ROLLING", "strip", "frustum"}
    assert out["over a floor"] == every - {"plane", "ANY_WALLS"}
    shared = {name: sharing.platform.backend.specialise(taken_from(sharing, name)[0], numerics) for name in out}
    # rolling resistance with springs is in place of that without
    assert [name for name, spec in shared.items() if spec.feature("ROLLING_SPRING")] == ["on springs"]
    assert all(
        spec.feature(switch) != (switch == "ROLLING" and name == "on springs")
        for name, spec in shared.items()
        for switch in ALWAYS
    )
    assert all(set(spec.feature("walls")) == set(WALLS) for spec in shared.values())
