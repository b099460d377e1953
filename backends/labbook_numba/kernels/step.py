"""One step of all grains, and many steps in one call."""

from labbook_dem.motion import drift, kick, predict
from labbook_dem.words import dot, sqrt, wide, wide3
from labbook_numba.kernels.features import (
    BAD_OVERLAP,
    BAD_SPEED,
    BAD_STATE,
    CROSSED,
    CROSSING,
    DONE,
    FAIL_GRAIN,
    FAIL_VALUE,
    GRAINS,
    GROW,
    LEAVING,
    LEDGER,
    MOVED,
    OUTLET,
    STEP,
    WORK,
    kernel,
    uint64,
)
from labbook_numba.kernels.forces import load, pair_forces, store, wall_forces
from labbook_numba.kernels.neighbours import rebuild
from labbook_numba.state import Params, State


@kernel
def integrate(st: State, p: Params):
    """Kick, drift and predict all grains; clear forces; note crossings. Gives the square of the largest speed."""
    n = uint64(st.count[GRAINS])
    step = st.count[STEP]
    dt = wide(p.dt)
    kick_dt = dt if step > 0 else wide(0.5) * dt  # the first kick brings v from a whole to a half step
    per_mass = wide(1.0) / p.mass
    per_inertia = wide(1.0) / p.inertia
    zero = wide(0.0)
    fastest = zero
    work = zero
    leaving = 0
    for i in range(n):
        x = load(st.x, i)
        v = load(st.v, i)
        w = load(st.w, i)
        f = load(st.f, i)
        t = load(st.t, i)
        a = wide3(f.x * per_mass, f.y * per_mass, f.z * per_mass - p.gravity)
        b = t * per_inertia
        v1 = kick(v, a, kick_dt)
        w1 = kick(w, b, kick_dt)
        x1 = drift(x, v1, dt)
        store(st.v, i, v1)
        store(st.w, i, w1)
        store(st.x, i, x1)
        store(st.u, i, predict(v1, a, dt))
        store(st.o, i, predict(w1, b, dt))
        none = wide3(zero, zero, zero)
        store(st.f, i, none)
        store(st.t, i, none)
        if LEDGER:
            work += wide(0.5) * kick_dt * (dot(f, v + v1) + dot(t, w + w1))
        v2 = dot(v1, v1)
        if CROSSING:
            if x1.z < p.plane and st.gone[i] == 0:
                st.gone[i] = 1
                row = st.count[CROSSED]
                st.count[CROSSED] += 1
                part = (x.z - p.plane) / (x.z - x1.z) if x.z > x1.z else zero
                c = st.cross
                c[row, 0] = st.ids[i]
                c[row, 1] = step + 1
                c[row, 2] = (step + min(max(part, zero), wide(1.0))) * dt
                c[row, 3] = x1.x
                c[row, 4] = x1.y
                c[row, 5] = x1.z
                c[row, 6] = v1.x
                c[row, 7] = v1.y
                c[row, 8] = v1.z
                c[row, 9] = w1.x
                c[row, 10] = w1.y
                c[row, 11] = w1.z
        if OUTLET and x1.z < p.drop:
            leaving += 1
        if not v2 <= fastest:  # so that a NaN is taken over, too
            fastest = v2
            st.count[FAIL_GRAIN] = i
    st.count[STEP] = step + 1
    st.count[LEAVING] = leaving
    if LEDGER:
        st.sums[WORK] += work
    return fastest


@kernel
def advance(st: State, p: Params, target):
    """Take steps up to step `target`; DONE, or why not. After GROW and longer arrays it may be called again."""
    limit2 = p.speed_limit * p.speed_limit
    leavers = st.count[LEAVING] > 0  # so that grains far below the outlet go, even when nothing else moves
    while st.count[STEP] < target and st.count[GRAINS] > 0:
        if leavers or st.sums[MOVED] >= wide(0.5) * p.skin:
            leavers = False
            if not rebuild(st, p):
                return GROW
        if not pair_forces(st, p):
            return BAD_OVERLAP
        if not wall_forces(st, p):
            return BAD_OVERLAP
        fastest2 = integrate(st, p)
        if not fastest2 <= limit2:
            st.sums[FAIL_VALUE] = sqrt(fastest2)
            return BAD_SPEED if fastest2 > limit2 else BAD_STATE
        st.sums[MOVED] += sqrt(fastest2) * p.dt
    return DONE
