"""Velocities that are set between beats: in free space, above the speed limit, not finite, and of absent grains."""

import math
from collections.abc import Iterator

import numpy as np

from labbook.backend import Failed
from labbook.backend.probes import Ledger
from labbook.checks.stress.case import Ending, StressCase, within
from labbook.checks.stress.watch import GUARDS, one_line, refused
from labbook.checks.verify.case import limited
from labbook.checks.verify.materials import LAWS, D, G, scene
from labbook.checks.verify.platform import MemberStart, Platform, grains_at
from labbook.scene import Primitives

DT, STEPS = 1e-5, 400
V = np.array([0.3, -0.1, 0.2])


def _pushed(platform: Platform) -> Iterator[Ending]:
    """Two grains fall side by side; after a beat the first one is pushed."""
    if not platform.backend.capabilities.breaks:
        yield Ending("", "unsupported", "the backend cannot set velocities; leave restart out")
        return
    here = scene(2, LAWS["hertz-mindlin"](), Primitives(), G)
    start = MemberStart(here, DT, grains_at([[0.0, 0.0, 0.0], [5 * D, 0.0, 0.0]]))
    with platform.admitted([start], STEPS, [Ledger()]) as admitted:
        ensemble, (member,) = admitted.ensemble, admitted.members
        ensemble.advance(1)
        before = ensemble.packing(member)
        ensemble.set_velocities(member, np.array([0]), V[None])
        ensemble.advance(3)
        after, steps = ensemble.packing(member), 3 * STEPS
        fallen = np.array([0.0, 0.0, -G * DT**2 * steps * (steps + 1) / 2])
        error = np.abs(after.x[0] - before.x[0] - V * steps * DT - fallen).max() / np.linalg.norm(V * steps * DT)
        yield within(
            platform, "the grain", "leapfrog in free fall", float(error), limited(1e-11, roundings=10, steps=steps)
        )
        time = 4 * STEPS * DT
        error = abs(float(after.x[1, 2]) / (-0.5 * G * time**2) - 1)
        yield within(platform, "its neighbour", "free fall", error, limited(1e-11, steps=steps))

        def absent() -> None:
            ensemble.set_velocities(member, np.array([2]), np.zeros((1, 3)))

        yield refused("a grain that is not there", absent, "not in the scene", (ValueError,))
    for part, speed in (("above the speed limit", 1e4), ("not a number", math.nan), ("infinite", math.inf)):
        yield _guarded(platform, start, part, speed)


def _guarded(platform: Platform, start: MemberStart, part: str, speed: float) -> Ending:
    """Check that a guard reports the velocity and keeps the state in which it was set."""
    with platform.admitted([start], STEPS, [Ledger()]) as admitted:
        ensemble, (member,) = admitted.ensemble, admitted.members
        ensemble.advance(1)
        positions, step = ensemble.packing(member).x, ensemble.status(member).step
        ensemble.set_velocities(member, np.array([0]), np.array([[speed, 0.0, 0.0]]))
        failed = next((event for event in ensemble.advance(1) if isinstance(event, Failed)), None)
        if failed is None:
            return Ending(part, "failed", "silence: no guard reported anything")
        if failed.guard not in GUARDS or ensemble.status(member).step != step:
            return Ending(part, "failed", one_line(failed.message))
        ensemble.set_velocities(member, np.array([0]), np.zeros((1, 3)))
        unmoved = np.array_equal(ensemble.packing(member).x, positions)
        return Ending(part, "named error" if unmoved else "failed", one_line(failed.message))


CASES = [
    StressCase(
        name="pushed-grains",
        attempt="velocities set between beats: free fall, above the speed limit, not finite, "
        "of grains that are not there",
        oracle="exact free fall, also of a neighbour; the speed and state guards; an error on unknown grains",
        run=_pushed,
    )
]
