"""Opening the outlet: a packing made in the closed container becomes the start of the discharge."""

from dataclasses import replace

import numpy as np

from labbook.scene import Scene, Wall
from labbook.scene.packing import Packing


def opened(packing: Packing, closed: Scene, scene: Scene) -> Packing:
    """`packing`, made in `closed`, as the start of `scene`: the same state, its wall springs renamed or
    dropped.

    A wall that both containers have keeps its springs. A plate of the closed container that the open one has
    in parts (a flat bottom) hands each spring to the part that the grain stands on; where nothing is left
    under the grain (the outlet, its lid) the spring is gone with the wall.
    """
    after = {wall.name: wall for wall in scene.container.walls()}
    before = {wall.name: wall for wall in closed.container.walls()}
    new = [wall for name, wall in after.items() if name not in before]
    names = np.array(packing.wall_name, "U40")
    kept = np.isin(names, list(after))
    for name in np.unique(names[~kept]):
        at = np.flatnonzero(names == name)
        names[at] = _parts_under(before.get(str(name)), new, packing.x[packing.wall_grain[at]])
        kept[at] = names[at] != ""
    return replace(
        packing,
        wall_name=names[kept],
        wall_grain=packing.wall_grain[kept],
        wall_spring=packing.wall_spring[kept],
        wall_part=packing.wall_part[kept],
        wall_rolling=None if packing.wall_rolling is None else packing.wall_rolling[kept],
    )


def _parts_under(wall: Wall | None, parts: list[Wall], x: np.ndarray) -> np.ndarray:
    """Names of those among `parts` that continue `wall` where grains at `x` [m], shape [n, 3], touch it; empty where
    there is none."""
    names = np.full(len(x), "", "U40")
    if wall is None:
        return names
    for part in parts:
        names[wall.shape.continued(part.shape, x) & (names == "")] = part.name
    return names
