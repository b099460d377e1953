"""Contact forces in the frames of a recorded run, from the overlaps of its grains."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from labbook.backend import Backend, BackendMissing, load_to_plan
from labbook.backend.numerics import Numerics
from labbook.export.frames import Frame
from labbook.measure import RunData
from labbook.scene import Packing, Scene


class NoForces(Exception):
    """Contact forces of a run are not known; the message says why and what to do."""


class PairForces(NamedTuple):
    """Contacts between grains in one frame.

    Attributes:
        ends: Centres of both grains [m], shape [k, 2, 3].
        size: Elastic normal forces [N], shape [k].
    """

    ends: np.ndarray
    size: np.ndarray


def pair_forces(backend: Backend, scene: Scene, numerics: Numerics, start: Packing, frame: Frame) -> PairForces:
    """Contact forces between grains in a frame.

    Args:
        backend: Backend that made the run, whose contact law counts.
        scene: What was simulated.
        numerics: Its numerics.
        start: The packing that the run started from.
        frame: The frame. Recorded places are known to some 1e-8 m, and so are overlaps.

    Raises:
        NoForces: The backend cannot tell.
    """
    table = backend.elastic_forces(scene, numerics, packing_of(start, frame), frame.time, walls=False)
    if table is None:
        name = backend.capabilities.name
        raise NoForces(f"the backend {name} does not tell contact forces; use another colour, such as speed")
    between = np.flatnonzero(table["j"] >= 0)
    order = np.argsort(frame.ids)
    i, j = (order[np.searchsorted(frame.ids, table[side][between], sorter=order)] for side in "ij")
    size = np.sqrt(sum(np.asarray(table[axis])[between] ** 2 for axis in ("fx", "fy", "fz")))
    return PairForces(np.stack([frame.x[i], frame.x[j]], axis=1).astype(float), np.asarray(size, float))


def packing_of(start: Packing, frame: Frame) -> Packing:
    """Make a packing at rest of a frame.

    Args:
        start: Packing that the run started from, with sizes and kinds of the grains.
        frame: Frame.

    Returns:
        Packing of the grains of the frame.
    """
    rows = start.rows(frame.ids)
    q = None
    if frame.q is not None:
        q = np.asarray(frame.q, float)
        q /= np.linalg.norm(q, axis=1)[:, None]
    x = frame.x.astype(float)
    sizes = {name: array[rows] for name in ("diameter", "kind") if (array := getattr(start, name)) is not None}
    return Packing(x=x, v=np.zeros_like(x), omega=np.zeros_like(x), ids=frame.ids, q=q, **sizes)


def forces_of(backend: str, data: RunData) -> Callable[[Frame], PairForces] | None:
    """Make the function that computes contact forces in frames of a run.

    Args:
        backend: Name of the backend that made the run.
        data: Run.

    Returns:
        Function of a frame; None if the backend is not installed or does not tell contact forces.
    """
    try:
        made_by = load_to_plan(backend)
    except BackendMissing:
        return None
    if made_by.elastic_forces(data.scene, data.numerics, data.start.subset(np.arange(0)), walls=False) is None:
        return None
    return partial(pair_forces, made_by, data.scene, data.numerics, data.start)


def scale_of(forces: Sequence[PairForces]) -> float:
    """Find the upper end of a scale of forces.

    Args:
        forces: Contacts of frames.

    Returns:
        Force [N] that one contact in a hundred exceeds, in the frame where it is largest; 1 without contacts.
    """
    return max((float(np.quantile(frame.size, 0.99)) for frame in forces if len(frame.size)), default=0.0) or 1.0
