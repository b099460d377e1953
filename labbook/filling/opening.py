"""Opening the outlet: a packing made in the closed container becomes the start of the discharge."""

from dataclasses import replace

import numpy as np

from labbook.scene import Scene, Strip, Wall
from labbook.scene.packing import Packing

_STRAIGHT = 1e-9  # of a strip's length: how far off its line a point may lie


def opened(packing: Packing, closed: Scene, scene: Scene) -> Packing:
    """`packing`, made in `closed`, as the start of `scene`: the same state, its wall springs renamed or
    dropped.

    A wall that both containers have keeps its springs. A plate of the closed container that the open one has
    in parts (a flat bottom) hands each spring to the part that the grain stands on; where nothing is left
    under the grain (the outlet, its lid) the spring is gone with the wall.
    """
    after = {wall.name: wall for wall in scene.container.walls()}
    before = {wall.name: wall for wall in closed.container.walls()}
    new = [wall for name, wall in after.items() if name not in before and isinstance(wall.shape, Strip)]
    names = np.array(packing.wall_name, "U40")
    kept = np.ones(len(names), bool)
    for at in np.flatnonzero(~np.isin(names, list(after))):
        part = _part_under(before.get(str(names[at])), new, packing.x[packing.wall_grain[at]])
        kept[at] = part is not None
        names[at] = part or names[at]
    return replace(
        packing,
        wall_name=names[kept],
        wall_grain=packing.wall_grain[kept],
        wall_spring=packing.wall_spring[kept],
        wall_part=packing.wall_part[kept],
        wall_rolling=None if packing.wall_rolling is None else packing.wall_rolling[kept],
    )


def _part_under(wall: Wall | None, parts: list[Wall], x: np.ndarray) -> str | None:
    """Name of the strip among `parts` that lies on `wall` where a grain at `x` [m] touches it."""
    if wall is None or not isinstance(wall.shape, Strip):
        return None
    start, along = np.array(wall.shape.start), np.array(wall.shape.end) - wall.shape.start
    foot = start + along * ((x[[0, 2]] - start) @ along) / (along @ along)
    for part in parts:
        assert isinstance(part.shape, Strip)
        begin, run = np.array(part.shape.start), np.array(part.shape.end) - part.shape.start
        length = run @ run
        at, off = (
            (foot - begin) @ run / length,
            abs(along[0] * run[1] - along[1] * run[0]) / np.sqrt(length * (along @ along)),
        )
        aside = np.linalg.norm(foot - begin - at * run)
        if 0 <= at <= 1 and off < _STRAIGHT and aside < _STRAIGHT * np.sqrt(length):
            return part.name
    return None
