"""One step of all grains: gather forces, kick, drift, predict; events on the way."""

from __future__ import annotations

from labbook_dem.motion import drift, kick, predict
from labbook_dem.words import dot, func, narrow, real, rounded, wide, wide3

from labbook_warp.kernels.bodies import per_inertia, per_mass
from labbook_warp.kernels.forces import forces, listed
from labbook_warp.kernels.shape import Grain, Own, at_rest, grain, moved, own, pace2, spinning, store, whole
from labbook_warp.kernels.system import Material, System, entry, material
from labbook_warp.kernels.words import (
    APART,
    ASKED,
    BAD_FORCE,
    BAD_OVERLAP,
    BAD_SPEED,
    BAD_STATE,
    COLUMNS,
    CROSSING,
    LANES,
    LEDGER,
    NO_NUMBER,
    ORIENTED,
    OUTLET,
    PARKED,
    REPORTED,
    SHARED,
    WORDS,
    Bits,
    Longs,
    Words,
    ask_for_lists,
    hot_kernel,
    int64,
    kernel,
    load_bits,
    load_int,
    load_real,
    load_word,
    quotient,
    store_word,
    this_thread,
    wait_for_all,
    widen,
    wp,
)


@func
def fails(a: System, s: int, i: int, now: int64, code: int, value: real):
    """Note the first failure of a member: smallest step, then code, then grain, whichever thread comes first.

    The member goes on until the next check, so that all that fail in the same step are heard.
    """
    word = (now << wp.int64(26)) | (wp.int64(code) << wp.int64(24)) | wp.int64(a.ids[i])
    if word < wp.atomic_min(a.fail, s, word):
        a.bad[i] = wide(value)


@func
def crosses(a: System, plane: wide, dt: wide, s: int, i: int, now: int64, before: wide, g: Grain):
    """Record the first passage of grain i through the member's plane. before: z [m] a step ago."""
    a.gone[i] = 1
    row = COLUMNS * wp.atomic_add(a.crossed, 0, 1)
    fraction = wide(0.0)
    if before > g.x[2]:
        fraction = min(max((before - plane) / (before - g.x[2]), wide(0.0)), wide(1.0))
    a.cross[row] = wide(s)
    a.cross[row + 1] = wide(a.ids[i])
    a.cross[row + 2] = wide(now + wp.int64(1))
    a.cross[row + 3] = (wide(now) + fraction) * dt
    for c in range(3):
        a.cross[row + 4 + c] = g.x[c]
        a.cross[row + 7 + c] = wide(g.v[c])
        a.cross[row + 10 + c] = wide(g.spin[c])
    if ORIENTED:
        for c in range(4):
            a.cross[row + 13 + c] = g.q[c]


@func
def advance(a: System, q: Words, m: Material, s: int, i: int, now: int64, g: Grain, more: real, f: wide3, t: wide3):
    """Move grain i by one step and write it to q. more: what rounding has kept from its vertical velocity so far."""
    kick_dt = m.dt
    if now == wp.int64(0):
        kick_dt = wide(0.5) * m.dt  # the first kick brings velocities from a whole to a half step
    weight = wide3(wide(0.0), wide(0.0), wide(-1.0)) * m.gravity
    acc = f * per_mass(a, m, i) + weight
    turn_acc = t * per_inertia(a, m, i)
    v0 = widen(g.v) + wide3(wide(0.0), wide(0.0), wide(more))
    w0 = widen(g.w)
    v2 = wide3(kick(v0[0], acc[0], kick_dt), kick(v0[1], acc[1], kick_dt), kick(v0[2], acc[2], kick_dt))
    v1 = narrow(v2)
    more = rounded(v2[2] - wide(v1[2]))
    w2 = wide3(kick(w0[0], turn_acc[0], kick_dt), kick(w0[1], turn_acc[1], kick_dt), kick(w0[2], turn_acc[2], kick_dt))
    if LEDGER:
        half = wide(0.5) * kick_dt
        half_way = spinning(m, g, w0 + turn_acc * half)
        a.work[i] = a.work[i] + (dot(f, v0 + acc * half) + dot(t, half_way)) * kick_dt
    x1 = wide3(drift(g.x[0], v2[0], m.dt), drift(g.x[1], v2[1], m.dt), drift(g.x[2], v2[2], m.dt))
    u1 = narrow(wide3(predict(v2[0], acc[0], m.dt), predict(v2[1], acc[1], m.dt), predict(v2[2], acc[2], m.dt)))
    new = moved(m, g, x1, v1, w2, u1, turn_acc)
    if CROSSING:
        plane = a.place[s].plane
        if x1[2] < plane:
            if a.gone[i] == 0:
                crosses(a, plane, m.dt, s, i, now, g.x[2], new)
    if OUTLET:
        if x1[2] < a.place[s].drop:  # nothing that is still to be counted touches it
            wp.atomic_add(a.left, s, 1)
            # what it touched at last is not counted any more
            a.held[i] = wp.uint32(0)
            a.wall_held[i] = wp.uint32(0)
            if LEDGER:
                a.deep[i] = wide(0.0)
            new = at_rest(new, wide(PARKED))
            more = real(0.0)
    fast2 = pace2(m, new)
    if not fast2 <= m.speed2 or not dot(new.w, new.w) >= real(0.0):
        code = BAD_STATE
        if fast2 > m.speed2:
            code = BAD_SPEED
        fails(a, s, i, now + wp.int64(1), code, wp.sqrt(fast2))
    elif fast2 > load_real(a.most_speed2, s):
        wp.atomic_max(a.most_speed2, s, fast2)
    store(a, q, i, new, more)


@func
def pass_on(p: Words, q: Words, i: int):
    """Copy what grain i shows."""
    for k in range(WORDS):
        store_word(q, i * WORDS + k, load_word(p, i * WORDS + k))


@hot_kernel
def step(a: System, p: Words, q: Words, slot: int, first: int, some: int, arrived: Bits):
    """Step `first` of this beat, for the members from slot `slot` on: from p to q.

    Where threads share grains, which then are few, `some` steps from `first` on, from p to q and back: each begins when
    all threads have ended the one before.
    """
    thread = this_thread(wp.tid())
    i = slot * a.cap + thread // LANES
    lane = thread % LANES
    s = quotient(i, a.cap)
    r = i - s * a.cap
    steps = int(1)
    if SHARED:
        steps = some
        even = p
        odd = q
    for k in range(steps):
        if SHARED:
            if k > 0:
                wait_for_all(arrived)
            p = wp.where(k % 2 == 1, odd, even)
            q = wp.where(k % 2 == 1, even, odd)
        if r < load_int(a.rows, s):
            m = material(a, s)
            near = listed(a, s, r, lane)
            g = grain(p, m, i)
            if ASKED > 0:
                ask_for_lists(a.spring, a.nbr, entry(a, s, a.near, 0, r), a.cap, ASKED)
            if g.x[2] > wide(0.5) * wide(PARKED):
                o = Own()
                if SHARED:  # where grains are many, it would occupy registers meanwhile
                    o = own(a, p, i)
                now = a.step[s] + wp.int64(first + k)
                f, t, held, wall_held, deepest = forces(a, p, m, s, r, lane, g, near, True)
                sound = deepest <= m.deepest
                if not sound:
                    code = BAD_OVERLAP
                    if deepest == real(NO_NUMBER):
                        code = BAD_FORCE
                    fails(a, s, i, now, code, deepest)
                if lane == 0 and sound:
                    if deepest > load_real(a.most_deep, s):  # rarely: hardly any contact is the deepest there ever was
                        wp.atomic_max(a.most_deep, s, deepest)
                    if held != near.held:
                        a.held[i] = held
                    if not APART:
                        if wall_held != load_bits(a.wall_held, i):
                            a.wall_held[i] = wall_held
                    if LEDGER:
                        a.deep[i] = wide(deepest)
                    if not SHARED:
                        o = own(a, p, i)
                    advance(a, q, m, s, i, now, whole(g, o), o.rest, f, t)
            else:
                if lane == 0:
                    pass_on(p, q, i)


@kernel
def bring(a: System, p: Words, q: Words):
    """Copy what grains of running members show from p to q, after an odd number of steps."""
    i = wp.tid()
    s = i // a.cap
    if i - s * a.cap < a.rows[s]:
        pass_on(p, q, i)


@kernel
def end(a: System, steps: int, told: Longs):
    """Count the steps of a beat; tell what happened in it, so that the host reads it at once; and forget it."""
    s = wp.tid()
    if a.rows[s] > 0:
        a.step[s] = a.step[s] + wp.int64(steps)
    at = 1 + REPORTED * s
    told[at] = a.fail[s]
    told[at + 1] = wp.int64(a.late[s])
    told[at + 2] = wp.int64(a.overflow[3 * s])
    told[at + 3] = wp.int64(a.overflow[3 * s + 1])
    told[at + 4] = wp.int64(a.overflow[3 * s + 2])
    told[at + 5] = wp.int64(a.left[s])
    a.fail[s] = (wp.int64(1) << wp.int64(62)) - wp.int64(1)  # NO_FAILURE
    a.late[s] = 0
    for k in range(3):
        a.overflow[3 * s + k] = 0
    if s == 0:
        told[0] = wp.int64(a.crossed[0])
        a.crossed[0] = 0
