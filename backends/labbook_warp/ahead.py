"""Kernels that members will need are compiled before they come, in threads: for a GPU, several modules together take
hardly longer than one."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from threading import Thread
from types import ModuleType

import warp as wp

from labbook.backend import Expected, Spec
from labbook_warp import room
from labbook_warp.parameters import same_material

_going: dict[ModuleType, Thread] = {}
"""What is being compiled, or was."""


def foresee(members: Sequence[Expected], device: wp.Device, lanes: int | None) -> None:
    """Begin to compile what these members need, if they come all at once. lanes: see `labbook_warp.stage.Stage`."""
    if device.is_cuda:
        Thread(target=_begin, args=(members, device, lanes), name="labbook-ahead", daemon=True).start()


def _begin(members: Sequence[Expected], device: wp.Device, lanes: int | None) -> None:
    for module in modules(members, device, lanes):
        if module not in _going:
            _going[module] = Thread(target=_compile, args=(module, device), name="labbook-ahead", daemon=True)
            _going[module].start()


def modules(members: Sequence[Expected], device: wp.Device, lanes: int | None) -> list[ModuleType]:
    """The kernels that these members need, if those of a Spec come all at once."""
    by_spec: dict[Spec, list[Expected]] = {}
    for one in members:
        by_spec.setdefault(one.spec, []).append(one)
    found = []
    for spec, some in by_spec.items():
        cap = max(room.rounded(one.scene.grains.count) for one in some)
        sizes = replace(room.empty(spec, sum(one.count for one in some)), cap=cap)
        uniform = same_material((one.scene, one.numerics) for one in some)
        found.append(room.suitable(spec, sizes, uniform, room.lanes(sizes, device, lanes)))
    return found


def _compile(module: ModuleType, device: wp.Device) -> None:
    """Leave compiled kernels in Warp's cache. They are not loaded: another thread may be capturing a graph."""
    with suppress(Exception):  # whoever needs them gets it again
        wp.compile_aot_module(module, device)


def wait_for(module: ModuleType) -> None:
    """Wait until kernels are compiled, if a thread is at it."""
    if module in _going:
        _going[module].join()
