"""The platforms of the bundled backends, for tests that take every one of them.

The CPU backend takes ten seconds to compile a kernel, twenty for rods. On these stands its kernels have all features in
(walls of every kind, moving ones, rolling, ...), so that all scenes of one law, shape and precision share a kernel.
`tests/contract/test_contract_kernels.py` compares them with those that users' runs have, which `specialised` gives.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from labbook.backend import BackendMissing, Unsupported, installed, load
from labbook.backend.probes import Table
from labbook.checks.verify.platform import Platform
from labbook.scene import LinearSpringDashpot, Primitives, Scene, Spheres
from labbook.scene.packing import Packing


@dataclass(frozen=True)
class Bundled(Platform):
    """A platform of a bundled backend, and what tests must know of it."""

    first: str = "double"
    """The precision in which it takes every check; those that say so it takes in no other on a processor."""
    lists: bool = True
    """Whether its backend keeps lists of neighbours, which it rebuilds."""
    wide: bool = False
    """Whether its kernels have all features in, so that tests share them."""
    crowds: bool = False
    """Whether a grain has room for so many near walls only, and says so where there are more."""
    older: Callable[[Mapping[str, np.ndarray]], Mapping[str, np.ndarray]] = dict
    """The arrays of a checkpoint as its backend left them before it kept largest overlaps and speeds."""
    part: float = 1.0
    """Part of the grains and beats of long tests that it takes. Less than one: it is slow, and takes the long way."""

    @property
    def second(self) -> bool:
        """Whether it is the backend in its other precision, on a processor."""
        return self.device == "cpu" and self.precision != self.first


def _without(arrays: Mapping[str, np.ndarray], *names: str) -> dict[str, np.ndarray]:
    return {name: array for name, array in arrays.items() if name not in names}


BUNDLED: Mapping[str, Mapping[str, Any]] = {
    "numba": {"wide": True, "older": lambda arrays: {**arrays, "sums": arrays["sums"][:4]}},
    "reference": {"lists": False, "part": 0.6, "older": lambda arrays: _without(arrays, "deepest", "fastest")},
    "warp": {"first": "mixed", "crowds": True, "older": lambda arrays: _without(arrays, "most")},
}
"""What the platforms of each bundled backend are like."""


def platforms() -> list[Bundled]:
    """One for each bundled backend that is there, in each of its precisions, on each of its devices."""
    found = []
    for name in sorted(set(installed()).intersection(BUNDLED)):
        traits = BUNDLED[name]
        try:
            backend: Any = load(name)
        except BackendMissing:
            continue
        if traits.get("wide"):
            backend = type(backend)(wide=True)
        can = backend.capabilities
        ways = [(precision, device) for precision in sorted(can.precisions) for device in can.devices]
        found += [Bundled(backend, precision, device, **traits) for precision, device in ways]
    return found


def sharing(platform: Bundled) -> Bundled:
    """The platform with kernels that tests share, on a processor: with all features in. On a GPU kernels are compiled
    for each scene, in tests as in users' runs."""
    if platform.wide or platform.device != "cpu" or platform.part < 1:
        return platform
    backend: Any = type(platform.backend)
    return replace(platform, backend=backend(wide=True), wide=True)


def specialised(platform: Bundled) -> Bundled:
    """The platform with kernels that have in only what each scene needs, as in users' runs."""
    return replace(platform, backend=load(platform.backend.capabilities.name), wide=False)


def where(platform: Bundled, slow: pytest.MarkDecorator = pytest.mark.ring, *, once: bool = False):
    """The platform as a parameter; skipped where its device is missing. `slow`: mark of a slow platform. `once`: the
    second precision of a backend is in the ring, since its kernels are compiled for these tests alone."""
    marks = []
    if reason := missing(platform):
        marks.append(pytest.mark.skip(reason=reason))
    if platform.part < 1:
        marks.append(slow)
    if once and platform.second:
        marks.append(pytest.mark.ring)
    return pytest.param(
        platform, id=f"{platform.backend.capabilities.name}-{platform.precision}-{platform.device}", marks=marks
    )


def missing(platform: Platform) -> str | None:
    """Why the device of a platform cannot be used here; None if it can."""
    free = Scene(
        grains=Spheres(diameter=1e-3, density=1e3, count=1),
        contact=LinearSpringDashpot(normal_stiffness=1),
        container=Primitives(),
    )
    try:
        platform.backend.open(platform.backend.specialise(free, platform.numerics(1e-6)), 1, platform.device).close()
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
