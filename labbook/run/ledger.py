"""The ledger of a run or a filling: what its guards saw, and the balance of its grains."""

import math

import numpy as np

from labbook.backend import Status
from labbook.backend.probes import Table
from labbook.lab.records import RunLedger
from labbook.scene import Packing, Scene

_DROPPED = 5
"""Lengths of a grain below the outlet by which all have been dropped, so that they fall no farther."""


def ledger(
    scene: Scene, status: Status, end: Packing, start: Packing | None = None, crossings: Table | None = None
) -> RunLedger:
    """What is known of a member that is at `end`, where it stands as `status` says.

    start: what it began with; None of a filling, which begins with all grains in the air. crossings: the rows of all
    that passed the plane of the outlet, if there is one. A grain that is back in the container since is inside.
    """
    plane = scene.container.outlet_plane
    above = end.x[:, 2] >= (-math.inf if plane is None else plane)
    held = scene.container.inside(end.x) & inside_moving(scene, end.x, status.time)
    assert end.ids is not None
    inside, behind = end.ids[above & held], end.ids[above & ~held]
    passed = np.zeros(0, np.int64) if crossings is None else np.asarray(crossings["id"])
    astray = passed[:0]
    if crossings is not None and len(passed):
        astray = passed[~scene.container.lets_out(np.column_stack([crossings[axis] for axis in "xyz"]))]
    outside = np.union1d(behind, np.setdiff1d(astray, inside))
    return RunLedger(
        overlap=status.deepest,
        speed=status.fastest,
        expected_speed=None if start is None else expected_speed(scene, start),
        started=scene.grains.count if start is None else len(start),
        inside=len(inside),
        left=len(np.setdiff1d(passed, np.union1d(inside, outside))),
        outside=len(outside),
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
    """Speed [m/s] that gravity gives a grain from the top of the start, and from a push as large as any of its speeds,
    on its way to where it is dropped; and that of the fastest wall."""
    plane = scene.container.outlet_plane if scene.sink is None else scene.sink
    size = scene.grains.extent
    low = float(start.x[:, 2].min()) if plane is None else plane - _DROPPED * size
    fall = 2 * scene.gravity * (float(start.x[:, 2].max()) - low)
    push = float(np.max(np.sum(start.v**2, axis=1)))
    reach = float(np.hypot(start.x[:, 0], start.x[:, 1]).max())
    moving = max((wall.speed(reach) for wall in scene.container.walls()), default=0.0)
    return math.sqrt(fall + push) + moving
