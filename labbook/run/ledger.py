"""Ledger of a run or a filling: extremes that guards saw, and the balance of its grains."""

import math

import numpy as np

from labbook.backend import Status
from labbook.backend.probes import Table
from labbook.lab.records import RunLedger
from labbook.scene import Packing, Scene

_FALL_BELOW_OUTLET = 5
"""Depth below the outlet, in lengths of a grain, at which all grains have been removed, so that they fall no
farther."""


def ledger(
    scene: Scene, status: Status, end: Packing, start: Packing | None = None, crossings: Table | None = None
) -> RunLedger:
    """Make the ledger of a member.

    Args:
        scene: Scene of the member.
        status: Its last status.
        end: Its last packing.
        start: Its start; None of a filling, which starts with all grains in the air.
        crossings: Rows of all crossings of the outlet plane, if there is one. A grain that is back in the container
            counts as inside.
    """
    source = end if start is None else start
    assert source.ids is not None
    waiting = source.ids[:0] if source.waiting is None else source.ids[source.waiting]
    end = end.entered
    plane = scene.container.outlet_plane
    above = end.x[:, 2] >= (-math.inf if plane is None else plane)
    is_within = scene.container.inside(end.x) & inside_moving(scene, end.x, status.time)
    assert end.ids is not None
    inside, behind_wall = end.ids[above & is_within], end.ids[above & ~is_within]
    crossed = np.zeros(0, np.int64) if crossings is None else np.asarray(crossings["id"])
    beside_outlet = crossed[:0]
    if crossings is not None and len(crossed):
        positions = np.column_stack([crossings[axis] for axis in "xyz"])
        beside_outlet = crossed[~scene.container.lets_out(positions, scene.grains.radius)]
    outside = np.union1d(behind_wall, np.setdiff1d(beside_outlet, inside))
    return RunLedger(
        overlap=status.deepest,
        speed=status.fastest,
        expected_speed=None if start is None else expected_speed(scene, start),
        started=scene.grains.count if start is None else len(start),
        inside=len(inside),
        left=len(np.setdiff1d(crossed, np.union1d(inside, outside))),
        outside=len(outside),
        waiting=len(np.setdiff1d(waiting, np.union1d(end.ids, crossed))),
    )


def inside_moving(scene: Scene, x: np.ndarray, time: float) -> np.ndarray:
    """Points of x [m], shape [n, 3], on the side of the grains of all parts that move, where these are at a time [s]
    after the opening, shape [n]. A part that has vanished holds no grain."""
    inside = np.ones(len(x), bool)
    for wall in scene.container.walls():
        if wall.is_posed and (wall.removal is None or time < wall.removal):
            pose = wall.poses(np.array([time]))
            inside &= wall.shape.inside((x - pose.shift[0]) @ pose.turn[0])
    return inside


def expected_speed(scene: Scene, start: Packing) -> float:
    """Largest speed [m/s] that a grain can reach without an error: free fall from the top of the start to the height
    where it is removed, with the largest initial speed, plus the speed of the fastest wall."""
    plane = scene.container.outlet_plane if scene.sink is None else scene.sink
    size = scene.grains.extent
    lowest = float(start.x[:, 2].min()) if plane is None else plane - _FALL_BELOW_OUTLET * size
    fall = 2 * scene.gravity * (float(start.x[:, 2].max()) - lowest)
    push = float(np.max(np.sum(start.v**2, axis=1)))
    reach = float(np.hypot(start.x[:, 0], start.x[:, 1]).max())
    moving = max((wall.speed(reach) for wall in scene.container.walls()), default=0.0)
    return math.sqrt(fall + push) + moving
