"""Rods at walls of triangles, one rod and wall at a time; compiled only for scenes that have both."""

import numpy as np
from labbook_dem.mesh import (
    K_ALONG,
    K_FEATURE,
    K_NORMAL,
    K_OLDER,
    K_OVERLAP,
    K_SPRING,
    OVER,
    SPRING_KEY,
    mesh_springs,
    mesh_vector,
)
from labbook_dem.mesh_rods import mesh_rod_contacts
from labbook_dem.poses import outwards
from labbook_dem.words import wide

from labbook_numba.kernels.features import FRICTION, POSES, WALL_PARTS, int64, kernel
from labbook_numba.kernels.mesh_walls import grain_in_frame
from labbook_numba.kernels.poses import pose_now
from labbook_numba.state import Params, State


@kernel
def measure_rod_at_mesh(st: State, p: Params, w, k):
    """Measure the contacts of the rod of entry k with mesh w.

    Distance, unit normal and position along the rod go to st.near, at the place of the spring; the contacts stay in
    st.touch. Returns the mask of touching places, and that of places with an older spring.
    """
    i = st.wall_grain[k]
    near, touch = st.near, st.touch
    x, a = grain_in_frame(st, w, i)
    count = mesh_rod_contacts(
        p.mesh_features, p.mesh_conditions, st.mesh_near, int64(st.mesh_first[k]), int64(st.mesh_first[k + 1]),
        x, a, p.half, p.radius, touch,
    )  # fmt: skip
    if count == OVER:
        count = 1
        touch[0, K_OVERLAP] = np.inf  # more contacts than there is room for: the guard stops the run
    for n in range(count):
        touch[n, K_SPRING] = n
        touch[n, K_OLDER] = wide(0.0)
    if FRICTION:
        base = int64(k) * int64(WALL_PARTS)
        mesh_springs(p.mesh_features, touch, count, int64(st.wall_held[k]), st.wall_spring, base)
    now = 0
    older = 0
    for n in range(count):
        index = int64(touch[n, K_SPRING])
        normal = mesh_vector(touch, n, K_NORMAL)
        if POSES:
            normal = outwards(st.pose, pose_now(st), w, normal)
        near[index * 5] = p.radius - touch[n, K_OVERLAP]
        near[index * 5 + 1] = normal.x
        near[index * 5 + 2] = normal.y
        near[index * 5 + 3] = normal.z
        near[index * 5 + 4] = touch[n, K_ALONG]
        now |= 1 << index
        older |= int64(touch[n, K_OLDER]) << index
    return now, older


@kernel
def key_rod_springs(st: State, k, now):
    """Write the features of the contacts in st.touch beside their springs; now: mask with a bit for each contact."""
    n = 0
    while now != 0:
        row = int64(k) * int64(WALL_PARTS) + int64(st.touch[n, K_SPRING])
        st.wall_spring[row, SPRING_KEY] = st.touch[n, K_FEATURE]
        # clears the lowest bit: one turn for each contact
        now &= now - 1
        n += 1
