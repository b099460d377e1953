"""How far the stop rule lets a bed discharge, and whether the window ends by then."""

import math
from collections.abc import Iterator
from pathlib import Path

from labbook.filling.bed import bed_height
from labbook.lab.folder import Lab
from labbook.lab.packings import load_packing
from labbook.lab.records import Unreadable
from labbook.run.demand import PointDemand
from labbook.run.plan import Item, Plan
from labbook.scene import Scene
from labbook.study.applicable import flat_area

PACKED = 0.55
"""Packing fraction that is assumed of a bed before there is one."""
_NAMED = 3


def height_ahead(scene: Scene) -> float | None:
    """Height [m] that the bed of a flat-bottomed silo will have at a packing fraction of PACKED; None of other
    containers."""
    area = flat_area(scene.container)
    if area is None:
        return None
    return scene.grains.count * scene.grains.volume / (PACKED * area)


def reach(shared: PointDemand, height: float | None = None) -> float:
    """Discharged fraction at which the stop rule ends a run whose bed is `height` [m] high (None: as foreseen)."""
    stop, height = shared.stop, height or height_ahead(shared.scene)
    if stop.fill_height is None or height is None:
        return stop.discharged
    return min(stop.discharged, max(0.0, 1 - stop.fill_height / height))


def cut_short(plan: Plan, lab: Lab) -> Iterator[str]:
    """Problems, with file, key and remedy: beds that fall to stop.fill_height before the window ends. Heights are
    those of packings that are there, and foreseen of others."""
    end = plan.study.window.end
    known: dict[str, float | None] = {}
    lowest: dict[PointDemand, tuple[float, float | None]] = {}
    for item in plan.items:
        shared = item.demand.shared
        if shared.stop.fill_height is None:
            continue
        if item.keys.packing not in known:
            known[item.keys.packing] = _height(item, lab)
        height = known[item.keys.packing]
        there = reach(shared, height)
        if there < min(end, lowest.get(shared, (math.inf, None))[0]):
            lowest[shared] = there, height
    if lowest:
        yield _told(plan.study.path, end, lowest)


def _height(item: Item, lab: Lab) -> float | None:
    """Height [m] of the bed of a run, None if its packing is not there."""
    if not item.packed:
        return None
    scene = item.demand.point.scene
    try:
        packing = load_packing(lab.packing(item.keys.packing))
    except Unreadable:
        return None
    return bed_height(scene.grains, packing, scene.container.outlet_plane or 0.0)


def _told(file: Path, end: float, lowest: dict[PointDemand, tuple[float, float | None]]) -> str:
    shared, (there, height) = min(lowest.items(), key=lambda one: one[1][0])
    stop, tall = shared.stop.fill_height, height or height_ahead(shared.scene)
    assert stop is not None
    assert tall is not None
    labels = [one.point.label for one in lowest]
    more = f" and {len(labels) - _NAMED} other points" if len(labels) > _NAMED else ""
    start = shared.study.window.start
    earlier = f" a window.end below {there:.2f}," if there > start + 0.01 else ""
    how = "is" if height else f"will be, at a packing fraction of {PACKED},"
    return (
        f"{file}: stop.fill_height: the bed {how} {tall * 1e3:.3g} mm high and has fallen to {stop * 1e3:.4g} mm with "
        f"{there:.0%} discharged, before the window ends (window.end, {end:g}), at {'; '.join(labels[:_NAMED])}{more}\n"
        f"    remedy: use a stop.fill_height below {(1 - end) * tall * 1e3:.3g} mm,{earlier} or more grains"
    )
