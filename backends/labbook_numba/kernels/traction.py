"""Sums over contacts with walls, in bins; see `labbook_dem.traction`."""

import numpy as np
from labbook_dem.traction import bin_of, components, friction_of, moment, slides
from labbook_dem.words import real, wide3

from labbook_numba.kernels.blocks import row_of
from labbook_numba.kernels.bodies import kind_of
from labbook_numba.kernels.features import ANY_WALLS, KINDS, X, entry
from labbook_numba.kernels.shape import normal_now, walls_now
from labbook_numba.kernels.transfer import load
from labbook_numba.state import Params, State


@entry
def wall_sums(st: State, p: Params, bins, fraction, force_unit, torque_unit, rows, sums):
    """Add up the contacts with walls in integer quanta; bins, sums: see `BinTable`; rows: scratch for the contacts of a
    grain."""
    dt = real(p.dt)
    if not ANY_WALLS:
        return
    for w in range(len(p.wall_kind)):
        along = int(bins[w, 0])
        for k in range(st.wall_first[w], st.wall_first[w + 1]):
            i = st.wall_grain[k]
            x = load(st.grains, i, X)
            friction = friction_of(row_of(p.wall_c, w * KINDS + kind_of(st.body, i)))
            for row in range(walls_now(st, p, w, k, dt, rows, 0)):
                force = wide3(rows[row, 3], rows[row, 4], rows[row, 5])
                point = x + wide3(rows[row, 6], rows[row, 7], rows[row, 8])
                normal = normal_now(st, p, w, k, row, rows)
                first = int(bins[w, 4])
                at = first + bin_of(along, bins[w, 1], bins[w, 2], int(bins[w, 3]), point)
                torque = moment(point, force)
                pressed, up, across = components(along, force, normal, point)
                # integers, in quanta: their sums do not depend on the order of contacts or on the number of threads
                sums[at, 0] += 1
                sums[at, 1] += slides(force, normal, friction, fraction)
                sums[at, 2] += np.rint(force.x / force_unit)
                sums[at, 3] += np.rint(force.y / force_unit)
                sums[at, 4] += np.rint(force.z / force_unit)
                sums[at, 5] += np.rint(torque.x / torque_unit)
                sums[at, 6] += np.rint(torque.y / torque_unit)
                sums[at, 7] += np.rint(torque.z / torque_unit)
                sums[at, 8] += np.rint(pressed / force_unit)
                sums[at, 9] += np.rint(up / force_unit)
                sums[at, 10] += np.rint(across / force_unit)
                sums[at, 11] += np.rint(point.x * pressed / torque_unit)
                sums[at, 12] += np.rint(point.y * pressed / torque_unit)
                sums[at, 13] += np.rint(point.z * pressed / torque_unit)
