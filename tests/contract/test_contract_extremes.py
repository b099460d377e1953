"""The largest overlap and speed that a member has had: of all its steps, whatever came between them."""

import math
from dataclasses import replace

import numpy as np
import pytest
from platforms import identical

from labbook.backend import Failed, Status
from labbook.backend.probes import Ledger
from labbook.checks.verify.collision import PHASES, duration, head_on
from labbook.checks.verify.materials import D, G, floor, hertz, linear, room, scene
from labbook.checks.verify.platform import MemberStart, grains_at
from labbook.scene import Primitives

BEATS, LEDGER = 6, Ledger()


def test_an_elastic_impact_is_as_deep_as_its_energy_says(platform):
    """All kinetic energy of the relative motion, m* u^2/2, is in the spring of Hertz, 8/15 E* sqrt(R*) delta^(5/2), at
    the largest overlap. A step of 1/400 of the impact samples that to some (pi/400)^2."""
    law, speed = hertz(restitution=1.0), 0.5
    glass = scene(2 * PHASES, law, room())
    grains = glass.grains
    energy, modulus = grains.mass / 4 * speed**2, law.shear_modulus / (1 - law.poisson_ratio)
    deepest = (energy * 15 / (8 * modulus * math.sqrt(grains.radius / 2))) ** 0.4
    dt = duration(glass, speed) / 400
    motion = platform.run(MemberStart(glass, dt, head_on(speed, dt)), 10, 50, (LEDGER,))
    assert motion.rows(LEDGER)["max_overlap"][-1] == 0.0  # the pairs have parted
    assert motion.status.deepest == pytest.approx(deepest / D, rel=1e-4)


def test_a_falling_grain_is_as_fast_as_its_height_says(platform):
    """sqrt(2 g h); velocities are those of half steps, and the floor brakes only once it carries the weight."""
    height, dt = 10 * D, 5e-6
    falls = scene(1, linear(), Primitives(parts=(floor(),)), G)
    top = math.sqrt(2 * G * height)
    steps = math.ceil(1.5 * top / G / dt)  # it has bounced by then, and is slower
    motion = platform.run(
        MemberStart(falls, dt, grains_at([0.0, 0.0, height + D / 2], [0.0, 0.0, 0.0])), steps // 500, 500, ()
    )
    assert np.linalg.norm(motion.end.v) < 0.5 * top
    assert motion.status.fastest == pytest.approx(top, abs=2 * G * dt, rel=1e-6)


def ran(silo, beats: int, **numerics) -> tuple[Status, list[Failed]]:
    with silo.ensemble(numerics=silo.numerics(**numerics), probes=()) as ensemble:
        member = ensemble.admit(silo.scene, silo.numerics(**numerics), silo.start)
        events = ensemble.advance(beats)
        return ensemble.status(member), [event for event in events if isinstance(event, Failed)]


@pytest.fixture(scope="module")
def uninterrupted(silo):
    return ran(silo, BEATS)[0]


@pytest.mark.parametrize("guard", ["overlap", "speed"])
def test_they_are_what_the_guards_see(silo, uninterrupted, guard):
    """A limit just above lets the member pass, and one just below stops it."""
    most = uninterrupted.deepest if guard == "overlap" else uninterrupted.fastest
    passed, failures = ran(silo, BEATS, **{f"{guard}_limit": most * (1 + 1e-6)})
    assert not failures
    assert (passed.deepest, passed.fastest) == (uninterrupted.deepest, uninterrupted.fastest)
    stopped, failures = ran(silo, BEATS, **{f"{guard}_limit": most * (1 - 1e-5)})
    assert [failure.guard for failure in failures] == [guard]
    assert (stopped.deepest if guard == "overlap" else stopped.fastest) < most  # that of the last good beat


def test_they_only_grow(silo):
    with silo.ensemble(probes=()) as ensemble:
        member = silo.admit(ensemble)
        assert (ensemble.status(member).deepest, ensemble.status(member).fastest) == (0.0, 0.0)
        seen = []
        for _ in range(BEATS):
            ensemble.advance(1)
            seen.append(ensemble.status(member))
        for name in ("deepest", "fastest"):
            values = [getattr(status, name) for status in seen]
            assert values == sorted(values)
            assert values[0] > 0


def test_they_go_on_from_a_checkpoint(silo, uninterrupted):
    with silo.ensemble(probes=()) as first:
        member = silo.admit(first)
        first.advance(2)
        checkpoint = first.checkpoint(member)
    with silo.ensemble(probes=()) as second:
        silo.admit(second)
        second.advance(1)
        restored = silo.admit(second, checkpoint)  # beside a member that has seen less
        second.advance(BEATS - 2)
        assert second.status(restored) == uninterrupted


def test_a_checkpoint_that_tells_nothing_of_them_leaves_them_unknown(silo):
    """Those that older versions left: the motion goes on, bit for bit."""
    with silo.ensemble(probes=()) as ensemble:
        member = silo.admit(ensemble)
        ensemble.advance(2)
        checkpoint = ensemble.checkpoint(member)
        older = silo.admit(ensemble, replace(checkpoint, arrays=silo.platform.older(checkpoint.arrays)))
        ensemble.advance(2)
        again = silo.admit(ensemble, ensemble.checkpoint(older))
        for one in (older, again):
            assert (ensemble.status(one).deepest, ensemble.status(one).fastest) == (None, None)
            assert identical(ensemble.packing(one), ensemble.packing(member))
