"""Opening the outlet: a packing made in the closed container becomes the start of the discharge."""

from dataclasses import replace

import numpy as np

from labbook.scene import Scene, Wall
from labbook.scene.packing import Packing


def start_of_discharge(packing: Packing, closed: Scene, scene: Scene) -> Packing:
    """Convert a packing of the closed container to the start of the discharge: wall springs are renamed or dropped.

    A wall of both containers keeps its springs. If a plate of the closed container is split in the open one (a flat
    bottom), each spring goes to the part below its grain. Without a part below (the outlet, its lid) it is dropped.

    Args:
        packing: Packing made in `closed`.
        closed: Closed scene.
        scene: Open scene.
    """
    after = {wall.name: wall for wall in scene.container.walls()}
    before = {wall.name: wall for wall in closed.container.walls()}
    new = [wall for name, wall in after.items() if name not in before]
    names = np.array(packing.wall_name, "U40")
    has_wall = np.isin(names, list(after))
    for name in np.unique(names[~has_wall]):
        at = np.flatnonzero(names == name)
        names[at] = _parts_under(before.get(str(name)), new, packing.x[packing.wall_grain[at]])
        has_wall[at] = names[at] != ""
    return replace(
        packing,
        wall_name=names[has_wall],
        wall_grain=packing.wall_grain[has_wall],
        wall_spring=packing.wall_spring[has_wall],
        wall_part=packing.wall_part[has_wall],
        wall_rolling=None if packing.wall_rolling is None else packing.wall_rolling[has_wall],
    )


def _parts_under(wall: Wall | None, parts: list[Wall], x: np.ndarray) -> np.ndarray:
    """Names of the parts that continue a wall at the contact points of grains at `x` [m], shape [n, 3].

    Empty for a grain without such a part.
    """
    names = np.full(len(x), "", "U40")
    if wall is None:
        return names
    for part in parts:
        names[wall.shape.continued(part.shape, x) & (names == "")] = part.name
    return names
