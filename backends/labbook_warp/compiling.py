"""Compilation ahead of time, in threads: on a GPU, NVRTC compiles several modules at once."""

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
"""Threads that compile a module, or have compiled it."""
_mixed: set[Spec] = set()
"""Specs whose members differ in material, so that all use the same kernels even if the first ones do not differ."""
_workers = Semaphore(cores())


def precompile(members: Sequence[Expected], device: wp.Device, lanes: int | None) -> None:
    """Start compiling the kernels that these members need. lanes: see `labbook_warp.stage.Stage`."""
    _mixed.update(spec for spec, some in _by_spec(members).items() if not _uniform(some))
    for module in modules(members, device, lanes) if device.is_cuda else ():
        if module not in _compiling:
            thread = Thread(target=_compile, args=(module, device), name="labbook-compiling", daemon=True)
            thread.start()
            _compiling[module] = thread


def modules(members: Sequence[Expected], device: wp.Device, lanes: int | None) -> Iterator[ModuleType]:
    """Yield the kernel modules of these members, for ensembles with room for all members of a Spec."""
    for spec, some in _by_spec(members).items():
        cap = max(room.rounded(member.scene.grains.count) for member in some)
        sizes = replace(room.empty(spec, sum(member.count for member in some)), cap=cap)
        yield room.suitable(spec, sizes, _uniform(some), room.lanes(sizes, device, lanes))


def mixed(spec: Spec) -> bool:
    """Return True if members of a Spec are expected to differ in material."""
    return spec in _mixed


def _by_spec(members: Sequence[Expected]) -> dict[Spec, list[Expected]]:
    by_spec: dict[Spec, list[Expected]] = {}
    for member in members:
        by_spec.setdefault(member.spec, []).append(member)
    return by_spec


def _uniform(members: Sequence[Expected]) -> bool:
    return same_material((member.scene, member.numerics) for member in members)


def _compile(module: ModuleType, device: wp.Device) -> None:
    """Compile into Warp's cache, without loading: another thread may be capturing a graph."""
    with _workers, suppress(Exception):  # Warp keeps the error, and raises it again when the kernels are loaded
        wp.compile_aot_module(module, device)


def wait_for(module: ModuleType) -> None:
    """Wait for the thread that compiles a module, if any."""
    if module in _compiling:
        _compiling[module].join()


def any_running() -> bool:
    """Return True while a thread compiles."""
    return any(thread.is_alive() for thread in _compiling.values())
