"""Checks before anything runs: abilities of backend and device, containers that leak while filled, and too fast
surfaces."""

import math
from collections.abc import Iterable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from labbook.backend import Backend, Spec, Unsupported, absent
from labbook.filling.leaks import Leak, leak
from labbook.filling.placing import STARTS
from labbook.filling.room import PlacingError, Room
from labbook.plan.demand import Conflict, PointDemand
from labbook.scene import Scene, TriangleMesh, Wall
from labbook.scene.quantities import format_distinct, span


def check(backend: Backend, device: str, points: Iterable[PointDemand]) -> None:
    """Check that `backend` can make the runs of `points` on `device`.

    It computes the keys of points too, while their walls are in memory: it is cheapest before a plan.

    Raises:
        Unsupported: The backend or the device cannot do it.
        Conflict: A container cannot be used.
        MeasureError: A measure does not fit a scene.
    """
    capabilities = backend.capabilities
    if device.split(":")[0] not in {name.split(":")[0] for name in capabilities.devices}:
        raise absent(backend, device)
    if device not in {installed.alias for installed in backend.survey().devices}:
        raise absent(backend, device)
    for shared in points:
        if shared.scene.feed is not None and not capabilities.feeds:
            raise Unsupported("feed", f"the backend {capabilities.name} cannot feed grains back; leave feed out")
        if shared.scene.restart is not None and not capabilities.breaks:
            raise Unsupported("restart", f"the backend {capabilities.name} cannot break arches; leave restart out")
        specified(backend, shared)
        check_container(shared)


def specified(backend: Backend, shared: PointDemand) -> tuple[Spec, Spec]:
    """Return the Specs of the filling and the discharge of a point. Raises Unsupported."""
    specs = shared.specs
    if specs is None or specs[0] is not backend:
        closed = shared.closed
        shared.identify(closed)  # while the walls of both scenes are at hand
        filling = backend.specialise(shared.lifted or closed, shared.filling_numerics, ())
        discharge = backend.specialise(shared.scene, shared.numerics, shared.declared)
        specs = shared.specs = _shared_instance(backend, filling, discharge)
    return specs[1], specs[2]


@lru_cache(maxsize=1024)
def _shared_instance(*specs: Any) -> tuple[Any, ...]:
    """Return one object for all equal arguments: 100 000 points need few."""
    return specs


def check_container(shared: PointDemand) -> None:
    """Check that the container of a point can be filled, keeps its grains, and moves slowly enough.

    Raises:
        Conflict: It cannot; the message has file, key and remedy.
    """
    fault = _leaks(shared) or _surface_too_fast(shared) or _lifted_too_fast(shared) or _moves_badly(shared)
    if fault:
        raise Conflict(f"{shared.study.path}: {fault}")


def leak_of(shared: PointDemand) -> Leak | None:
    """Find a place where the container of a point may lose grains during the filling; None if there is none, or if
    containers of its kind are always closed. Raises PlacingError."""
    if shared.scene.container.closes or not shared.scene.container.outlets:
        return None
    return leak(shared.closed, STARTS[shared.point.fill.kind].flat)


def _leaks(shared: PointDemand) -> str | None:
    try:
        hole = leak_of(shared)
    except PlacingError as error:
        return f"container.parts: {error}"
    if hole is None or not hole.certain:
        return None
    return (
        f"container.outlet_plane: grains reach it while the container is filled, at {hole.position_text}, so the "
        "discharge would start without them\n    remedy: close the outlet by a part with opens: start (it stands "
        "while filling and vanishes at the opening), or by a wall"
    )


def _surface_too_fast(shared: PointDemand) -> str | None:
    scene, limit = shared.scene, shared.numerics.speed_limit
    moving = [wall for wall in scene.container.walls() if not wall.is_static]
    for wall in moving:
        reach = _reach(scene, wall)
        if wall.speed(reach) <= limit:
            continue
        speed, bound = format_distinct(wall.speed(reach), limit)
        key, remedy = "container.parts[].motion", "use a slower motion"
        if wall.moves is not None:
            return (
                f"container.parts[].moves: the part {wall.name} moves at up to {speed} m/s, faster than "
                f"numerics.speed_limit ({bound} m/s) allows any grain\n    remedy: use a slower motion, or raise "
                "numerics.speed_limit"
            )
        if scene.container.spin_key is not None:
            fastest = limit / (2 * math.pi * reach)
            key, remedy = f"container.{scene.container.spin_key}", f"use at most {math.floor(fastest * 1e3) / 1e3:g} Hz"
        return (
            f"{key}: the surface of {wall.name} moves at {speed} m/s, faster than numerics.speed_limit ({bound} m/s) "
            f"allows any grain\n    remedy: {remedy}, or raise numerics.speed_limit"
        )
    return None


def _lifted_too_fast(shared: PointDemand) -> str | None:
    mobilise, limit = shared.point.fill.mobilise, shared.filling_numerics.speed_limit
    if mobilise is None or mobilise.velocity <= limit:
        return None
    return (
        f"fill.mobilise.velocity: {mobilise.velocity:g} m/s is faster than numerics.speed_limit ({limit:g} m/s) allows "
        "any grain\n    remedy: use a slow motion, such as 0.01 sqrt(g d)"
    )


def _moves_badly(shared: PointDemand) -> str | None:
    """Describe the fault of a part that moves too quickly for the time step or out of the container, or vanishes too
    late."""
    dt = shared.numerics.dt
    for wall in shared.scene.container.walls():
        if wall.removal is not None and wall.removal >= shared.stop.max_time:
            return (
                f"container.parts[].opens: the part {wall.name} vanishes {span(wall.removal)} after the opening, and "
                f"runs end at {span(shared.stop.max_time)}\n    remedy: use an earlier time, or raise stop.max_time"
            )
        if wall.moves is None:
            continue
        vibration = wall.moves.vibration
        if vibration is not None and dt * vibration.frequency * STEPS_OF_A_PERIOD > 1:
            period = span(1 / vibration.frequency)
            return (
                f"container.parts[].moves.vibration: the part {wall.name} vibrates with a period of {period}; "
                f"numerics.dt ({span(dt)}) is more than 1/{STEPS_OF_A_PERIOD} of it\n    remedy: use a smaller "
                "numerics.dt or a lower frequency"
            )
        outside = moves_out(shared.scene, wall, shared.stop.max_time)
        if outside is not None:
            return (
                f"container.parts[].moves: the part {wall.name} leaves the container at {outside.axis} = "
                f"{1e3 * outside.at:.4g} mm, {span(outside.time)} after the opening\n    remedy: use a slower motion, "
                f"or end runs earlier (stop.max_time is {span(shared.stop.max_time)})"
            )
    return None


STEPS_OF_A_PERIOD = 50
"""Minimum number of steps in a period of a vibration."""


class Outside(NamedTuple):
    """Point where a part leaves a container: axis, position of the wall on it [m], and time [s]."""

    axis: str
    at: float
    time: float


def moves_out(scene: Scene, wall: Wall, end: float) -> Outside | None:
    """Find the first place where a moving part leaves the box that the other walls enclose, until `end` [s]; None if it
    stays.

    Sides on which it is outside at the opening, and sides without an enclosing wall, do not count.
    """
    if wall.moves is None or not isinstance(wall.shape, TriangleMesh):
        return None
    box = _box_around(scene, wall)
    vertices, slack = wall.shape.surface.vertices, 1e-3 * scene.grains.diameter
    times = wall.moves.sampled(end)

    def beyond(time: float) -> np.ndarray:
        """Distance [m] by which the part reaches beyond each side, shape [6]."""
        assert wall.moves is not None
        positions = wall.moves.poses(np.array([time])).positions(0, vertices)
        return np.concatenate([box.low - positions.min(axis=0), positions.max(axis=0) - box.high])

    stays = beyond(0.0) <= slack
    previous = 0.0
    for time in times.tolist():
        if (beyond(time)[stays] > slack).any():
            for _ in range(30):  # bisection of the time of exit, to 1e-9 of the sampling interval
                middle = (previous + time) / 2
                previous, time = (previous, middle) if (beyond(middle)[stays] > slack).any() else (middle, time)
            side = int(np.argmax(np.where(stays, beyond(time), -math.inf)))
            return Outside("xyz"[side % 3], float(np.concatenate(box)[side]), time)
        previous = time
    return None


class _Box(NamedTuple):
    low: np.ndarray
    high: np.ndarray


def _box_around(scene: Scene, part: Wall) -> _Box:
    """Box [m] that the walls other than `part` enclose; infinite on open sides. Built-in containers bound it
    horizontally."""
    container = scene.container
    low, high = np.full(3, -math.inf), np.full(3, math.inf)
    for wall in container.walls():
        if wall.name != part.name:
            low, high = np.maximum(low, wall.shape.enclosed.low), np.minimum(high, wall.shape.enclosed.high)
    if container.own_walls:
        low[:2] = np.maximum(low[:2], container.bounds.low[:2])
        high[:2] = np.minimum(high[:2], container.bounds.high[:2])
    return _Box(low, high)


def _reach(scene: Scene, wall: Wall) -> float:
    """Largest distance [m] from the axis x = y = 0 at which grains touch a wall."""
    if math.isfinite(wall.shape.reach):
        return wall.shape.reach
    try:
        room = Room(scene.container.close(), 0.0)
    except PlacingError:  # which is an error of its own
        return 0.0
    return math.hypot(max(map(abs, room.x)), max(map(abs, room.y)))
