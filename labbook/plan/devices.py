"""Devices of `--device`: names, speeds, and number of members that each holds."""

import sys
from collections import Counter
from collections.abc import Iterable, Sequence

from labbook.backend import Backend, Unsupported, absent
from labbook.backend.machine import cores
from labbook.plan.demand import PointDemand
from labbook.plan.forecast import rate_of
from labbook.plan.plan import PointPlan
from labbook.plan.possible import specified

_SATURATING_GRAINS, _MIN_MEMBERS = 1_000_000, 16
"""Number of grains, and minimum number of members, of an ensemble at which the throughput of a GPU saturates."""


def parse_devices(devices: str, backend: Backend) -> tuple[str, ...]:
    """Parse device names such as `cuda:0,cuda:1`, `cuda:all` or `cuda:all,cpu`.

    Raises:
        Unsupported: A device is named twice, or none of a kind exists.
    """
    names: list[str] = []
    for name in (part.strip() for part in devices.split(",")):
        kind, _, number = name.partition(":")
        if number != "all":
            names.append(name)
            continue
        aliases = [device.alias for device in backend.survey().devices if device.alias.partition(":")[0] == kind]
        if not aliases:
            raise absent(backend, name)
        names += aliases
    if duplicates := [name for name, times in Counter(names).items() if times > 1]:
        raise Unsupported("--device", f"{duplicates[0]} is named twice; name each device once")
    return tuple(names)


def speeds(devices: Sequence[str], backend: Backend, points: Sequence[PointDemand]) -> tuple[float, ...]:
    """Forecast the grain-steps per second of each device with all workers busy.

    The scene is that of the first point: only ratios matter.
    """
    scene, numerics = points[0].scene, points[0].numerics
    name, shape = backend.capabilities.name, scene.grains.shape
    return tuple(
        (cores() if device == "cpu" else 1) / rate_of(name, device, shape, numerics.precision).of(scene.grains.count)
        for device in devices
    )


def slots(backend: Backend, device: str, points: Iterable[PointPlan]) -> int:
    """Number of members that a worker of a device steps together.

    It is 1 on a CPU, where every core has a worker; else as many as fit for the point that needs most memory, and
    sys.maxsize if the backend knows no limit.
    """
    if device == "cpu":
        return 1
    capacities = []
    for shared in (point.shared for point in points):
        filling, discharge = specified(backend, shared)
        for spec, scene in ((filling, shared.closed), (discharge, shared.scene)):
            capacities.append(backend.capacity(spec, scene, device))
    # Fillings and runs of all points share the device in turn, so the largest member decides.
    return min((capacity for capacity in capacities if capacity is not None), default=sys.maxsize)


def largest_ensemble(points: Iterable[PointPlan]) -> int:
    """Maximum number of members of an ensemble: more would not raise the throughput of a GPU, and other beds would
    wait."""
    grains = max((point.shared.scene.grains.count for point in points), default=1)
    return max(_MIN_MEMBERS, _SATURATING_GRAINS // grains)
