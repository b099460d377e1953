"""One step of all grains, and many steps in one call."""

from labbook_dem.words import sqrt, wide

from labbook_numba.kernels.clumps import collect_loads
from labbook_numba.kernels.features import (
    ANY_WALLS,
    BAD_OVERLAP,
    BAD_SPEED,
    BAD_STATE,
    CLUMPS,
    CROSSED,
    CROSSING,
    DEEPEST,
    DONE,
    FAIL_GRAIN,
    FAIL_VALUE,
    FASTEST2,
    FIRST,
    GRAINS,
    LAST,
    LEAVING,
    LEDGER,
    MAX_OVERLAP,
    MOVED,
    ORIENTED,
    OUTLET,
    OVERLAP,
    POSES,
    REBUILD,
    SPEED,
    STEP,
    WORK,
    Q,
    V,
    W,
    X,
    entry,
    kernel,
    uint64,
)
from labbook_numba.kernels.meet import domain_maximum
from labbook_numba.kernels.pairs import pair_forces
from labbook_numba.kernels.shape import contact_work, move, wall_forces
from labbook_numba.state import Params, State


@kernel
def largest_or_nan(first, last, speed2, bits):
    """Largest of speed2[first:last], or NaN if one is NaN: by their bits, since a maximum of integers vectorises."""
    largest = bits[0] - bits[0]
    for i in range(uint64(first), uint64(last)):
        largest = max(largest, bits[i] & 0x7FFFFFFFFFFFFFFF)
    bits[last] = largest  # `speed2` has one spare place, and a domain has an array of its own
    return speed2[last]


@kernel
def record_leavers(st: State, p: Params, dt):
    """Record first passages through p.plane; count the grains far enough below the outlet to be dropped."""
    step = st.count[STEP]
    leaving = 0
    g = st.grains
    first, last = uint64(st.domain[FIRST]), uint64(st.domain[LAST])
    if CLUMPS:
        g = st.clumps
        first, last = first // uint64(len(p.spheres)), last // uint64(len(p.spheres))
    for i in range(first, last):
        z = g[i, X + 2]
        sphere = i
        if CLUMPS:
            sphere = i * uint64(len(p.spheres))
        if CROSSING and z < p.plane and st.gone[sphere] == 0:
            st.gone[sphere] = 1
            row = st.count[CROSSED]
            st.count[CROSSED] += 1
            # positions drift with a constant velocity in a step, so that the time of passage is exact
            before = z - g[i, V + 2] * dt
            fraction = (before - p.plane) / (before - z) if before > z else wide(0.0)
            c = st.cross
            c[row, 0] = st.ids[sphere]
            c[row, 1] = step + 1
            c[row, 2] = (step + min(max(fraction, wide(0.0)), wide(1.0))) * dt
            for axis in range(3):
                c[row, 3 + axis] = g[i, X + axis]
                c[row, 6 + axis] = g[i, V + axis]
                c[row, 9 + axis] = g[i, W + axis]
            if ORIENTED or CLUMPS:
                for column in range(4):
                    c[row, 12 + column] = g[i, Q + column]
        if OUTLET and z < p.drop:
            leaving += 1
    st.count[LEAVING] = leaving


@kernel
def integrate(st: State, p: Params):
    """Advance the domain's grains by one step; return the square of the largest speed [m^2/s^2], or NaN."""
    dt = wide(p.dt)
    # the first kick brings velocities from a whole to a half step
    kick_dt = dt if st.count[STEP] > 0 else wide(0.5) * dt
    if LEDGER:
        st.sums[WORK] += contact_work(st, p, kick_dt)
    move(st, p, kick_dt, dt)
    if CROSSING or OUTLET:
        record_leavers(st, p, dt)
    st.count[STEP] += 1
    return largest_or_nan(st.domain[FIRST], st.domain[LAST], st.speed2, st.speed_bits)


@entry
def advance(st: State, p: Params, target):
    """Take steps up to step `target`; return DONE, or the code of what stopped it. After REBUILD the host rebuilds and
    calls again.

    If `target` is the present step, the forces and torques of now are left in loads, and springs are advanced: readings
    call it so, on a copy of the state. The threads of all domains of a scene call it together and return the same code.
    """
    limit2 = p.speed_limit * p.speed_limit
    reading = st.count[STEP] == target
    while (reading or st.count[STEP] < target) and st.count[GRAINS] > 0:
        # written so that NaN asks for a rebuild too
        if not st.sums[MOVED] < wide(0.5) * p.skin:
            return REBUILD
        pair_forces(st, p)
        if ANY_WALLS:
            wall_forces(st, p)
        if CLUMPS:
            collect_loads(st, p)
        if reading:
            return DONE
        overlap = domain_maximum(st, OVERLAP, st.sums[MAX_OVERLAP])
        # all domains compare the same value, so all return at the same step
        if not overlap <= p.overlap_limit:
            st.sums[FAIL_VALUE] = overlap
            return BAD_OVERLAP
        st.sums[DEEPEST] = max(st.sums[DEEPEST], overlap)
        fastest2 = domain_maximum(st, SPEED, integrate(st, p))
        if not fastest2 <= limit2:
            st.sums[FAIL_VALUE] = sqrt(fastest2)
            for i in range(st.domain[FIRST], st.domain[LAST]):
                if not st.speed2[i] <= limit2:
                    st.count[FAIL_GRAIN] = st.ids[i]
            return BAD_SPEED if fastest2 > limit2 else BAD_STATE
        st.sums[FASTEST2] = max(st.sums[FASTEST2], fastest2)
        fastest = sqrt(fastest2)
        if POSES:  # the lists of meshes leave room for the motion of both
            fastest = max(fastest, p.part_speed)
        st.sums[MOVED] += fastest * p.dt
    return DONE
