"""What the GPU backend says of a member that a guard has stopped."""

from collections.abc import Sequence

import numpy as np
import pytest

pytest.importorskip("warp")

from labbook_warp import stage
from rods_on_warp import sharing

from labbook.backend import Failed
from labbook.backend.numerics import Numerics
from labbook.scene import LinearSpringDashpot, Plane, Primitives, Scene, Spheres, Wall
from labbook.scene.packing import Packing

pytestmark = pytest.mark.compiles

D = 3e-3
PRECISIONS = ["double", "mixed"]


def spheres(x: Sequence[Sequence[float]], v: Sequence[Sequence[float]], dt: float, precision: str) -> list[Failed]:
    """Spheres above a plane floor; x and v in diameters. What becomes of them in two beats."""
    grains = Spheres(diameter=D, density=2500, count=len(x))
    law = LinearSpringDashpot(normal_stiffness=2e5 * grains.mass * 9.81 / D, friction=0.5, restitution=0.5)
    floor = Wall(name="floor", shape=Plane(point=(0, 0, 0), normal=(0, 0, 1)))
    scene = Scene(grains=grains, contact=law, container=Primitives(parts=(floor,)))
    how = Numerics.model_validate({"dt": dt, "precision": precision, "steps_per_beat": 100})
    backend = sharing()
    start = Packing(x=np.array(x) * D, v=np.array(v) * D, omega=np.zeros((len(x), 3)))
    ensemble = backend.open(backend.specialise(scene, how), 1, "cpu")
    ensemble.admit(scene, how, start)
    events = ensemble.advance(2)
    ensemble.close()
    return [event for event in events if isinstance(event, Failed)]


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("upside_down", [False, True])
def test_of_grains_that_fail_in_the_same_step_that_with_the_smallest_id_is_named(precision, upside_down):
    """Whichever a thread comes upon first; and by how much it overlaps, not the others, nor itself later."""
    x = [(0, 0, 1.0), (0, 0, 1.7), (0, 0, 4.0), (0, 0, 4.6)]
    (event,) = spheres(x[::-1] if upside_down else x, [(0, 0, 0)] * 4, 1e-6, precision)
    assert (event.guard, event.step, event.grain) == ("overlap", 0, 0)
    assert f"overlaps by {0.4 if upside_down else 0.3:g} d, more than numerics.overlap_limit" in event.message


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("speed", [12, 15])  # m/s
def test_a_failure_that_late_lists_have_caused_is_none(precision, speed, monkeypatch):
    """A grain that runs into others between two checks, unseen, has not failed, if it would not with fresh lists."""
    x = [(0, 0, 0.5), (1.2, 0, 0.5), (0.02, 0, 5.5), (4, 0, 0.5)]
    v = [(0, 0, 0), (0, 0, 0), (0, 0, -speed / D), (0, 0, 0)]
    found = []
    for every in (50, 1):
        monkeypatch.setattr(stage, "check_interval", lambda *_, every=every: every)
        found.append([(event.guard, event.step, event.grain) for event in spheres(x, v, 25e-6, precision)])
    assert found[0] == found[1]


@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("speed", [1e4, 1e6])  # m/s
def test_a_grain_that_runs_into_the_floor_is_named_for_its_speed(precision, speed):
    """Not for what becomes of it in the next step: the floor pushes it back with a force beyond all numbers."""
    x, v = [(0, 0, 0.5), (2, 0, 0.5), (4, 0, 0.52)], [(0, 0, 0), (0, 0, 0), (0, 0, -speed / D)]
    (event,) = spheres(x, v, 25e-6, precision)
    assert (event.guard, event.step, event.grain) == ("speed", 1, 2)
    assert f"moves at {speed:g} m/s" in event.message
