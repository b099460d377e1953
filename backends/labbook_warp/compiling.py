"""Kernels that members will need are compiled before they come, in threads: on a GPU, NVRTC compiles several modules at
once."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from threading import Semaphore, Thread
from types import ModuleType

import warp as wp

from labbook.backend import Expected, Spec
from labbook.backend.machine import cores
from labbook_warp import room
from labbook_warp.parameters import same_material

_compiling: dict[ModuleType, Thread] = {}
"""Threads that compile a module, or have."""
_mixed: set[Spec] = set()
"""Specs whose members differ in material, though the first ones may not: all have the same kernels."""
_free = Semaphore(cores())


def precompile(members: Sequence[Expected], device: wp.Device, lanes: int | None) -> None:
    """Begin to compile what these members need. lanes: see `labbook_warp.stage.Stage`."""
    _mixed.update(spec for spec, some in _by_spec(members).items() if not _uniform(some))
    for module in modules(members, device, lanes) if device.is_cuda else ():
        if module not in _compiling:
            thread = Thread(target=_compile, args=(module, device), name="labbook-compiling", daemon=True)
            thread.start()
            _compiling[module] = thread


def modules(members: Sequence[Expected], device: wp.Device, lanes: int | None) -> Iterator[ModuleType]:
    """The kernels that these members need, in ensembles with room for all of a Spec."""
    for spec, some in _by_spec(members).items():
        cap = max(room.rounded(one.scene.grains.count) for one in some)
        sizes = replace(room.empty(spec, sum(one.count for one in some)), cap=cap)
        yield room.suitable(spec, sizes, _uniform(some), room.lanes(sizes, device, lanes))


def mixed(spec: Spec) -> bool:
    """Tell if members of a Spec are expected to differ in material."""
    return spec in _mixed


def _by_spec(members: Sequence[Expected]) -> dict[Spec, list[Expected]]:
    by_spec: dict[Spec, list[Expected]] = {}
    for one in members:
        by_spec.setdefault(one.spec, []).append(one)
    return by_spec


def _uniform(members: Sequence[Expected]) -> bool:
    return same_material((one.scene, one.numerics) for one in members)


def _compile(module: ModuleType, device: wp.Device) -> None:
    """Leave compiled kernels in Warp's cache. They are not loaded: another thread may be capturing a graph."""
    with _free, suppress(Exception):  # Warp keeps the error, and raises it again when the kernels are loaded
        wp.compile_aot_module(module, device)


def wait_for(module: ModuleType) -> None:
    """Wait until kernels are compiled, if a thread is at it."""
    if module in _compiling:
        _compiling[module].join()


def going() -> bool:
    """Whether a thread compiles now."""
    return any(thread.is_alive() for thread in _compiling.values())
