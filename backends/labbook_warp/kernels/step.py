"""One step of all grains: gather forces, kick, drift, predict; events on the way."""

from __future__ import annotations

from labbook_dem.images import image
from labbook_dem.motion import drift, kick, predict
from labbook_dem.words import dot, func, narrow, real, rounded, wide, wide3

from labbook_warp.kernels.bodies import inverse_inertia, inverse_mass
from labbook_warp.kernels.forces import forces, listed
from labbook_warp.kernels.shape import (
    Grain,
    Private,
    angular_velocity,
    at_rest,
    complete,
    grain,
    max_speed2,
    moved,
    private,
    store,
)
from labbook_warp.kernels.system import Material, System, entry, material
from labbook_warp.kernels.words import (
    APART,
    BAD_FORCE,
    BAD_OVERLAP,
    BAD_SPEED,
    BAD_STATE,
    CLUMPS,
    COLUMNS,
    CROSSING,
    LANES,
    LEDGER,
    NO_NUMBER,
    ORIENTED,
    OUTLET,
    PARKED,
    PREFETCH,
    REPORTED,
    SHARED,
    WORDS,
    Bits,
    Longs,
    Words,
    hot_kernel,
    int64,
    kernel,
    load_bits,
    load_int,
    load_real,
    load_word,
    prefetch_lists,
    quotient,
    store_word,
    this_thread,
    wait_for_all,
    widen,
    wp,
)


@func
def record_failure(a: System, s: int, i: int, now: int64, code: int, value: real):
    """Record the first failure of a member: smallest step, then kind, then grain, whatever the order of threads.

    The member goes on until the next check, so that all failures of a step compete for the minimum.
    """
    failure = (now << wp.int64(26)) | (wp.int64(code) << wp.int64(24)) | wp.int64(a.ids[i])
    # a value that a later thread undercuts stays in the row of its own grain, where nobody reads it
    if failure < wp.atomic_min(a.fail, s, failure):
        a.bad[i] = wide(value)


@func
def check_speed(a: System, m: Material, s: int, i: int, now: int64, speed2: real, has_spin: bool):
    """Record a failure of row i with the square of a speed [m^2/s^2], or that it is the fastest so far; has_spin: its
    spin is a number."""
    # written so that NaN fails too
    if not speed2 <= m.speed_limit2 or not has_spin:
        code = BAD_STATE
        if speed2 > m.speed_limit2:
            code = BAD_SPEED
        record_failure(a, s, i, now + wp.int64(1), code, wp.sqrt(speed2))
    elif speed2 > load_real(a.most_speed2, s):  # rarely true: saves the atomic
        wp.atomic_max(a.most_speed2, s, speed2)


@func
def record_crossing(a: System, plane: wide, dt: wide, s: int, i: int, now: int64, z_before: wide, g: Grain):
    """Record the first passage of grain i through the member's plane. z_before: height [m] a step ago."""
    a.gone[i] = 1
    row = COLUMNS * wp.atomic_add(a.crossed, 0, 1)
    fraction = wide(0.0)
    if z_before > g.x[2]:
        fraction = min(max((z_before - plane) / (z_before - g.x[2]), wide(0.0)), wide(1.0))
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
    if CLUMPS:
        for c in range(4):
            a.cross[row + 13 + c] = a.turned[i][c]


@func
def advance(
    a: System, q: Words, m: Material, s: int, i: int, now: int64, g: Grain, rounding: real, force: wide3, torque: wide3
):  # fmt: skip
    """Move grain i by one step and write it to q (leapfrog; `labbook_dem.motion`).

    Record its passage, failure and work too, and park it once it is far below the outlet.

    rounding: error of its vertical velocity so far [m/s]; force: of contacts, without weight [N]; torque [N m].
    """
    kick_dt = m.dt
    if now == wp.int64(0):
        kick_dt = wide(0.5) * m.dt  # the first kick brings velocities from a whole to a half step
    gravity = wide3(wide(0.0), wide(0.0), wide(-1.0)) * m.gravity
    acc = force * inverse_mass(a, m, i) + gravity
    turn_acc = torque * inverse_inertia(a, m, i)
    v0 = widen(g.v) + wide3(wide(0.0), wide(0.0), wide(rounding))
    w0 = widen(g.w)
    v2 = wide3(kick(v0[0], acc[0], kick_dt), kick(v0[1], acc[1], kick_dt), kick(v0[2], acc[2], kick_dt))
    v1 = narrow(v2)
    rounding = rounded(v2[2] - wide(v1[2]))
    w2 = wide3(kick(w0[0], turn_acc[0], kick_dt), kick(w0[1], turn_acc[1], kick_dt), kick(w0[2], turn_acc[2], kick_dt))
    if LEDGER:
        half_dt = wide(0.5) * kick_dt
        w_mid = angular_velocity(m, g, w0 + turn_acc * half_dt)
        a.work[i] = a.work[i] + (dot(force, v0 + acc * half_dt) + dot(torque, w_mid)) * kick_dt
    x1 = wide3(drift(g.x[0], v2[0], m.dt), drift(g.x[1], v2[1], m.dt), drift(g.x[2], v2[2], m.dt))
    x1 = image(x1, m.period)
    u1 = narrow(wide3(predict(v2[0], acc[0], m.dt), predict(v2[1], acc[1], m.dt), predict(v2[2], acc[2], m.dt)))
    new = moved(m, g, x1, v1, w2, u1, turn_acc)
    if CROSSING:
        plane = a.domain[s].plane
        if x1[2] < plane:
            if a.gone[i] == 0:
                record_crossing(a, plane, m.dt, s, i, now, g.x[2], new)
    if OUTLET:
        if x1[2] < a.domain[s].drop:  # far below the outlet: it touches no grain that is still counted
            wp.atomic_add(a.left, s, 1)
            # its last contacts no longer count
            a.held[i] = wp.uint32(0)
            a.wall_held[i] = wp.uint32(0)
            if LEDGER:
                a.deep[i] = wide(0.0)
            new = at_rest(new, wide(PARKED))
            rounding = real(0.0)
    speed2 = max_speed2(m, new)
    check_speed(a, m, s, i, now, speed2, dot(new.w, new.w) >= real(0.0))
    store(a, q, i, new, rounding)


@func
def copy_words(p: Words, q: Words, i: int):
    """Copy the shared state of grain i."""
    for k in range(WORDS):
        store_word(q, i * WORDS + k, load_word(p, i * WORDS + k))


@hot_kernel
def step(a: System, p: Words, q: Words, slot: int, first: int, some: int, arrived: Bits):
    """Step `first` of this beat from state p to state q, for the members from slot `slot` on.

    With several threads a grain (few grains), a launch takes `some` steps from `first` on, from p to q and back: each
    begins when all threads have finished the one before.
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
            if PREFETCH > 0:
                prefetch_lists(a.spring, a.nbr, entry(a, s, a.near, 0, r), a.cap, PREFETCH)
            if g.x[2] > wide(0.5) * wide(PARKED):
                hidden = Private()
                if SHARED:  # with many grains it is loaded below: it would occupy registers during `forces`
                    hidden = private(a, p, i)
                now = a.step[s] + wp.int64(first + k)
                force, torque, springs, wall_springs, deepest = forces(a, p, m, s, r, lane, g, near, True)
                overlaps_valid = deepest <= m.overlap_limit
                if not overlaps_valid:
                    code = BAD_OVERLAP
                    if deepest == real(NO_NUMBER):
                        code = BAD_FORCE
                    record_failure(a, s, i, now, code, deepest)
                if lane == 0 and overlaps_valid:
                    if deepest > load_real(a.most_deep, s):  # rarely true: saves the atomic
                        wp.atomic_max(a.most_deep, s, deepest)
                    if springs != near.springs:
                        a.held[i] = springs
                    if not APART:
                        if wall_springs != load_bits(a.wall_held, i):
                            a.wall_held[i] = wall_springs
                    if LEDGER:
                        a.deep[i] = wide(deepest)
                    if CLUMPS:  # which move once all spheres have their forces (`clumps.move_clumps`)
                        a.sphere_force[i] = force
                        a.sphere_torque[i] = torque
                    else:
                        if not SHARED:
                            hidden = private(a, p, i)
                        advance(a, q, m, s, i, now, complete(g, hidden), hidden.rounding, force, torque)
            else:
                if lane == 0:
                    copy_words(p, q, i)


@kernel
def copy_states(a: System, p: Words, q: Words):
    """Copy the shared states of running members from p to q, after an odd number of steps."""
    i = wp.tid()
    s = i // a.cap
    if i - s * a.cap < a.rows[s]:
        copy_words(p, q, i)


@kernel
def finish_beat(a: System, steps: int, report: Longs):
    """Advance the step counter, write the beat's flags to `report` for the host, reset them."""
    s = wp.tid()
    if a.rows[s] > 0:
        a.step[s] = a.step[s] + wp.int64(steps)
    first = 1 + REPORTED * s
    report[first] = a.fail[s]
    report[first + 1] = wp.int64(a.late[s])
    report[first + 2] = wp.int64(a.overflow[3 * s])
    report[first + 3] = wp.int64(a.overflow[3 * s + 1])
    report[first + 4] = wp.int64(a.overflow[3 * s + 2])
    report[first + 5] = wp.int64(a.left[s])
    a.fail[s] = (wp.int64(1) << wp.int64(62)) - wp.int64(1)  # NO_FAILURE
    a.late[s] = 0
    for k in range(3):
        a.overflow[3 * s + k] = 0
    if s == 0:
        report[0] = wp.int64(a.crossed[0])
        a.crossed[0] = 0
