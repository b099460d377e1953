"""The stands of the bundled backends, for tests that take every one of them.

The CPU backend takes ten seconds to compile a kernel, twenty for rods. On these stands its kernels have all features in
(walls of every kind, moving ones, rolling, ...), so that all scenes of one law, shape and precision share a kernel.
`tests/contract/test_contract_kernels.py` compares them with those that users' runs have, which `specialised` gives.
"""

from dataclasses import replace

import numpy as np
import pytest

from labbook.backend import BackendMissing, Unsupported, installed, load
from labbook.backend.probes import Table
from labbook.scene import LinearSpringDashpot, Primitives, Scene, Spheres
from labbook.scene.packing import Packing
from labbook.verify.stand import Stand

BUNDLED = ("numba", "reference", "warp")
FIRST = {"numba": "double", "reference": "double", "warp": "mixed"}
"""The precision in which a backend takes every check; those that say so it takes in no other on a processor."""


def stands() -> list[Stand]:
    """One for each bundled backend that is there, in each of its precisions, on each of its devices."""
    found = []
    for name in sorted(set(installed()).intersection(BUNDLED)):
        try:
            backend = load(name)
        except BackendMissing:
            continue
        if name == "numba":
            backend = type(backend)(wide=True)  # pyright: ignore[reportCallIssue]
        can = backend.capabilities
        found += [Stand(backend, precision, device) for precision in sorted(can.precisions) for device in can.devices]
    return found


def specialised(stand: Stand) -> Stand:
    """The stand with kernels that have in only what each scene needs, as in users' runs."""
    return replace(stand, backend=load(stand.backend.capabilities.name))


def lists(stand: Stand) -> bool:
    """Whether its backend keeps lists of neighbours, which it rebuilds."""
    return stand.backend.capabilities.name != "reference"


def second(stand: Stand) -> bool:
    """Whether a stand is the backend in its other precision, on a processor."""
    return stand.device == "cpu" and stand.precision != FIRST[stand.backend.capabilities.name]


def where(stand: Stand):
    """The stand as a parameter; skipped where its device is missing. The reference is slow: it takes the long way."""
    name, reason = f"{stand.backend.capabilities.name}-{stand.precision}-{stand.device}", missing(stand)
    marks = [pytest.mark.skip(reason=reason)] if reason else [] if lists(stand) else [pytest.mark.ring]
    return pytest.param(stand, id=name, marks=marks)


def missing(stand: Stand) -> str | None:
    """Why the device of a stand cannot be used here; None if it can."""
    free = Scene(
        grains=Spheres(diameter=1e-3, density=1e3, count=1),
        contact=LinearSpringDashpot(normal_stiffness=1),
        container=Primitives(),
    )
    try:
        stand.backend.open(stand.backend.specialise(free, stand.numerics(1e-6)), 1, stand.device).close()
    except Unsupported as reason:
        return reason.remedy
    return None


def identical(a: Packing | Table, b: Packing | Table) -> bool:
    """Whether two packings, or two tables, agree in every bit of every array, but for the number of the member."""
    first, second = (
        {name: array for name, array in (p.arrays() if isinstance(p, Packing) else p).items() if name != "member"}
        for p in (a, b)
    )
    return set(first) == set(second) and all(_same_bits(first[name], second[name]) for name in first)


def _same_bits(a: np.ndarray, b: np.ndarray) -> bool:
    return (a.dtype, a.shape, a.tobytes()) == (b.dtype, b.shape, b.tobytes())
