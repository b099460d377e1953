"""Walls, one a module, named by the types of scenes (`labbook.scene.walls.WALL_SHAPES`).

A wall of labbook's own has its formulas in the module of its name here, and a wall of another package in the module
that its type states in `physics`.

The module of a wall called WALL defines, with `_` for `-` in names:

* `parameters(shape)`, the host's: the numbers that describe the wall, as many as it needs
* `WALL_distance(p..., x)`: distance [m] of the point x from the wall, and the unit normal from the wall to the point
* `PARTS`: points, the parts of a rod, at which a rod may touch it: 2, or 4 of a wall with edges
* `WALL_rod(p..., x, a, ...)`: of one part of a rod: distance [m], unit normal, and position on the segment [m];
  not of a wall whose type says `spheres_only`
* `WALL_edge(p..., x, part)`, of a wall with edges: distance [m] of x from the edge that part 2 or 3 lies across
* `WALL_edges(p..., x, a, half, radius)`, where both edges are best found together: met, on, other, back, which are
  distance [m] and place on the segment [m] of part 2, and of part 3

p... are the numbers in their order, as their annotations take them up: `wide` one, `wide3` three, and `section` two,
x and z of a vector without y. `WALL_rod` takes besides, by these names, what it needs of: half the length of the
segment, `half` [m]; `radius` [m]; `part`; and what `WALL_edges` gave. `labbook_dem.dispatch` writes the functions that
call these for the walls of a scene.

Parts 0 and 1 of a rod are its ends, the spheres at -half and +half, where these are over the wall; 2 and 3 are edges
that it lies across. The distance of a part that is not there is 1e9 m. A sphere is a rod with half = 0, and has one
part at a time.

A rod that lies across an edge, one end on the plate, is carried by that end and by the edge. An edge counts by as much
as it is deeper in the rod than the line between the overlaps of the ends: so it takes over where an end slides off the
plate, and nothing of it is left where both ends are on the plate; the force is continuous.
"""

from collections.abc import Iterator, Mapping

from labbook.scene.walls import WALL_SHAPES
from labbook_dem.formulas import Formulas, identifier


class _ByDistance(Mapping[str, type]):
    """Walls by kind, without those of triangles, whose contacts `labbook_dem.mesh` computes."""

    def __getitem__(self, kind: str) -> type:
        if kind == MESH:
            raise KeyError(kind)
        return WALL_SHAPES[kind]

    def __iter__(self) -> Iterator[str]:
        return (kind for kind in WALL_SHAPES if kind != MESH)

    def __len__(self) -> int:
        return len(WALL_SHAPES) - 1


MESH = "mesh"
"""The kind of walls of triangles."""


def _required(kind: str) -> tuple[str, ...]:
    name = identifier(kind)
    rods = () if WALL_SHAPES[kind].spheres_only else (f"{name}_rod",)
    return "parameters", "PARTS", f"{name}_distance", *rods


WALLS = Formulas("wall", __name__, _ByDistance(), _required)
"""Modules of the walls by kind."""
MESH_NUMBER = 1000
"""By which kernels know walls of triangles."""


def number(kind: str) -> int:
    """Number by which kernels identify a kind of walls."""
    return MESH_NUMBER if kind == MESH else list(WALLS).index(kind)
