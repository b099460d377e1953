"""How many runs go on at once in one lane."""

import sys
from collections.abc import Iterable

from labbook.backend import Backend, Rationed
from labbook.plan.plan import PointPlan


def slots(backend: Backend, device: str, points: Iterable[PointPlan]) -> int:
    """One on a CPU, where every core has a lane; else as many as the device holds of the point that needs most."""
    if device == "cpu":
        return 1
    if not isinstance(backend, Rationed):
        return sys.maxsize
    fits = []
    for shared in (point.shared for point in points):
        for scene, probes in ((shared.closed, ()), (shared.scene, shared.probes)):
            spec = backend.specialise(scene, shared.numerics, probes)
            fits.append(backend.capacity(spec, scene, device))
    return min((fit for fit in fits if fit is not None), default=sys.maxsize)
