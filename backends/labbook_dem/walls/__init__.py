"""Wall primitives, one a module: `distance(p..., x)` gives the distance [m] of a point from the wall and the unit
normal from the wall to the point; `parameters(shape)` is the host's: the six numbers that describe the wall."""
