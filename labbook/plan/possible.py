"""Refusals before anything runs: of what a backend or a device cannot do, of containers from which grains leave while
they are filled, and of surfaces faster than any grain may be."""

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
from labbook.scene.quantities import span, told_apart


def check(backend: Backend, device: str, points: Iterable[PointDemand]) -> None:
    """Check that `backend` can do all that is asked, on `device`. Raises Unsupported, Conflict or MeasureError.

    It costs least before a plan: it makes keys, too, while the walls of a point are at hand.
    """
    can = backend.capabilities
    if device.split(":")[0] not in {known.split(":")[0] for known in can.devices}:
        raise absent(backend, device)
    if device not in {found.alias for found in backend.survey().devices}:
        raise absent(backend, device)
    for shared in points:
        if shared.scene.feed is not None and not can.feeds:
            raise Unsupported("feed", f"the backend {can.name} cannot feed grains back; leave feed out")
        if shared.scene.restart is not None and not can.breaks:
            raise Unsupported("restart", f"the backend {can.name} cannot break arches; leave restart out")
        specified(backend, shared)
        check_container(shared)


def specified(backend: Backend, shared: PointDemand) -> tuple[Spec, Spec]:
    """Return the sets of features of the filling and the discharge of a point. Raises Unsupported."""
    found = shared.specs
    if found is None or found[0] is not backend:
        closed = shared.closed
        shared.identify(closed)  # while the walls of both scenes are at hand
        filling = backend.specialise(shared.lifted or closed, shared.filled_by, ())
        discharge = backend.specialise(shared.scene, shared.numerics, shared.declared)
        found = shared.specs = _same(backend, filling, discharge)
    return found[1], found[2]


@lru_cache(maxsize=1024)
def _same(*specs: Any) -> tuple[Any, ...]:
    """The same object for all that are equal: 100 000 points need few."""
    return specs


def check_container(shared: PointDemand) -> None:
    """Raises Conflict, with file, key and remedy, if the container of a point cannot be filled, loses grains meanwhile,
    or has a surface beyond `numerics.speed_limit`."""
    fault = _leaks(shared) or _too_fast(shared) or _lifted_too_fast(shared) or _astray(shared)
    if fault:
        raise Conflict(f"{shared.study.path}: {fault}")


def leak_of(shared: PointDemand) -> Leak | None:
    """Where the container of a point may lose grains while it is filled; None where it cannot, or where containers are
    closed by themselves. Raises PlacingError."""
    if shared.scene.container.closes or not shared.scene.container.outlets:
        return None
    return leak(shared.closed, STARTS[shared.point.fill.kind].flat)


def _leaks(shared: PointDemand) -> str | None:
    try:
        found = leak_of(shared)
    except PlacingError as error:
        return f"container.parts: {error}"
    if found is None or not found.certain:
        return None
    return (
        f"container.outlet_plane: grains reach it while the container is filled, at {found.place}, so the discharge "
        "would start without them\n    remedy: close the outlet by a part with opens: start (it stands while filling "
        "and vanishes at the opening), or by a wall"
    )


def _too_fast(shared: PointDemand) -> str | None:
    scene, limit = shared.scene, shared.numerics.speed_limit
    moving = [wall for wall in scene.container.walls() if not wall.is_static]
    for wall in moving:
        reach = _reach(scene, wall)
        if wall.speed(reach) <= limit:
            continue
        speed, most = told_apart(wall.speed(reach), limit)
        key, remedy = "container.parts[].motion", "use a slower motion"
        if wall.moves is not None:
            return (
                f"container.parts[].moves: the part {wall.name} moves at up to {speed} m/s, faster than "
                f"numerics.speed_limit ({most} m/s) allows any grain\n    remedy: use a slower motion, or raise "
                "numerics.speed_limit"
            )
        if scene.container.spin_key is not None:
            fastest = limit / (2 * math.pi * reach)
            key, remedy = f"container.{scene.container.spin_key}", f"use at most {math.floor(fastest * 1e3) / 1e3:g} Hz"
        return (
            f"{key}: the surface of {wall.name} moves at {speed} m/s, faster than numerics.speed_limit ({most} m/s) "
            f"allows any grain\n    remedy: {remedy}, or raise numerics.speed_limit"
        )
    return None


def _lifted_too_fast(shared: PointDemand) -> str | None:
    mobilise, limit = shared.point.fill.mobilise, shared.filled_by.speed_limit
    if mobilise is None or mobilise.velocity <= limit:
        return None
    return (
        f"fill.mobilise.velocity: {mobilise.velocity:g} m/s is faster than numerics.speed_limit ({limit:g} m/s) allows "
        "any grain\n    remedy: use a slow motion, such as 0.01 sqrt(g d)"
    )


def _astray(shared: PointDemand) -> str | None:
    """Fault of a part that moves too quickly for the time step, or out of the container, or that vanishes too late."""
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
                f"container.parts[].moves.vibration: the part {wall.name} vibrates with a period of {period}, of which "
                f"numerics.dt ({span(dt)}) is more than a part of {STEPS_OF_A_PERIOD}\n    remedy: use a smaller "
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
"""Steps in a period of a vibration, at least."""


class Outside(NamedTuple):
    """Time [s] at which a part leaves a container, and place: the axis, and that of the wall on it [m]."""

    axis: str
    at: float
    time: float


def moves_out(scene: Scene, wall: Wall, end: float) -> Outside | None:
    """First place at which a part that moves leaves the box that the other walls enclose, until `end` [s]; None if it
    stays. Sides on which it stands outside at the opening, and sides without a wall that encloses, do not count."""
    if wall.moves is None or not isinstance(wall.shape, TriangleMesh):
        return None
    box = _box_around(scene, wall)
    vertices, slack = wall.shape.surface.vertices, 1e-3 * scene.grains.diameter
    times = wall.moves.sampled(end)

    def beyond(time: float) -> np.ndarray:
        """Distance [m] by which the part reaches beyond each side, shape [6]."""
        assert wall.moves is not None
        places = wall.moves.poses(np.array([time])).places(0, vertices)
        return np.concatenate([box.low - places.min(axis=0), places.max(axis=0) - box.high])

    stays = beyond(0.0) <= slack
    before = 0.0
    for time in times.tolist():
        if (beyond(time)[stays] > slack).any():
            for _ in range(30):
                middle = (before + time) / 2
                before, time = (before, middle) if (beyond(middle)[stays] > slack).any() else (middle, time)
            side = int(np.argmax(np.where(stays, beyond(time), -math.inf)))
            return Outside("xyz"[side % 3], float(np.concatenate(box)[side]), time)
        before = time
    return None


class _Box(NamedTuple):
    low: np.ndarray
    high: np.ndarray


def _box_around(scene: Scene, part: Wall) -> _Box:
    """Box [m] that the walls beside a part enclose, infinite where they leave it open. Containers of a kind bound it
    on all sides but up and down."""
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
    """Distance [m] from the axis x = y = 0 out to which grains touch a wall, at most."""
    if math.isfinite(wall.shape.reach):
        return wall.shape.reach
    try:
        room = Room(scene.container.close(), 0.0)
    except PlacingError:  # which is an error of its own
        return 0.0
    return math.hypot(max(map(abs, room.x)), max(map(abs, room.y)))
