"""Wall primitives, one a module: `WALL_distance(p..., x)` gives the distance [m] of a point from the wall and the unit
normal from the wall to the point; `parameters(shape)` is the host's: the six numbers that describe the wall.

A rod touches a wall at up to four points, its parts: 0 and 1 are its ends, the spheres at -h and +h, where these are
over the wall; 2 and 3 are edges that it lies across. `WALL_rod(p..., x, a, half, radius, part)` gives of one part the
distance from the wall, the unit normal, and s, where on the segment it is; the distance of a part that is not there is
1e9 m. That of a frustum takes, instead of the radius, both edges as `frustum_rims` finds them: they are found together.
A sphere is a rod with half = 0, and has one part at a time.

A rod that lies across an edge, one end on the plate, is carried by that end and by the edge. An edge counts by as much
as it is deeper in the rod than the line between the overlaps of the ends: so it takes over where an end slides off the
plate, and nothing of it is left where both ends are on the plate; the force is continuous.
"""
