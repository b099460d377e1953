"""Whether an engine can do what is planned, asked before anything runs."""

from collections.abc import Iterable

from labbook.backend import Backend, Surveys, Unsupported
from labbook.plan.plan import PointPlan


def check(backend: Backend, device: str, points: Iterable[PointPlan]) -> None:
    """Whether `backend` can do all that is planned, on `device`. Raises Unsupported."""
    can = backend.capabilities
    if device.split(":")[0] not in {known.split(":")[0] for known in can.devices}:
        raise Unsupported("--device", f"the engine {can.name} has no {device} here; it has {', '.join(can.devices)}")
    if isinstance(backend, Surveys):
        there = [found.alias for found in backend.survey().devices]
        if device not in there:
            remedy = f"there is no device {device} here; there is {', '.join(there) or 'none'}"
            raise Unsupported("--device", remedy)
    for point in points:
        shared = point.shared
        film = (shared.film,) if shared.film else ()
        backend.specialise(shared.closed, shared.numerics, ())
        backend.specialise(shared.scene, shared.numerics, tuple(dict.fromkeys((*shared.probes, *film))))
