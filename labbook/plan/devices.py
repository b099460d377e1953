"""Devices of a machine as the option `--device` names them, how fast they are, and how many runs each holds."""

import sys
from collections import Counter
from collections.abc import Iterable, Sequence

from labbook.backend import Backend, Unsupported, absent
from labbook.backend.machine import cores
from labbook.plan.demand import PointDemand
from labbook.plan.forecast import rate_of
from labbook.plan.plan import PointPlan
from labbook.plan.possible import specified

_ENOUGH, _LEAST = 1_000_000, 16
"""Grains and members of an ensemble from which on a GPU takes hardly more grain-steps per second with more of them."""


def named(devices: str, backend: Backend) -> tuple[str, ...]:
    """The devices that `cuda:0,cuda:1`, `cuda:all` or `cuda:all,cpu` names. Raises Unsupported for one named twice, or
    where there is none of a kind."""
    found: list[str] = []
    for name in (one.strip() for one in devices.split(",")):
        kind, _, which = name.partition(":")
        if which != "all":
            found.append(name)
            continue
        there = [device.alias for device in backend.survey().devices if device.alias.partition(":")[0] == kind]
        if not there:
            raise absent(backend, name)
        found += there
    if twice := [name for name, times in Counter(found).items() if times > 1]:
        raise Unsupported("--device", f"{twice[0]} is named twice; name each device once")
    return tuple(found)


def speeds(devices: Sequence[str], backend: Backend, points: Sequence[PointDemand]) -> tuple[float, ...]:
    """Grain-steps per second that each device is foreseen to take with all its lanes full; only ratios count."""
    scene, numerics = points[0].scene, points[0].numerics
    name, shape = backend.capabilities.name, scene.grains.shape
    return tuple(
        (cores() if device == "cpu" else 1) / rate_of(name, device, shape, numerics.precision).of(scene.grains.count)
        for device in devices
    )


def slots(backend: Backend, device: str, points: Iterable[PointPlan]) -> int:
    """One on a CPU, where every core has a lane; else as many as the device holds of the point that needs most."""
    if device == "cpu":
        return 1
    fits = []
    for shared in (point.shared for point in points):
        filling, discharge = specified(backend, shared)
        for spec, scene in ((filling, shared.closed), (discharge, shared.scene)):
            fits.append(backend.capacity(spec, scene, device))
    return min((fit for fit in fits if fit is not None), default=sys.maxsize)


def enough(points: Iterable[PointPlan]) -> int:
    """Members of an ensemble, at most. With those of more a GPU would take no more grain-steps per second, and other
    beds would not be filled, or written, meanwhile."""
    grains = max((point.shared.scene.grains.count for point in points), default=1)
    return max(_LEAST, _ENOUGH // grains)
