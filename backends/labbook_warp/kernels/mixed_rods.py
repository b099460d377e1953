"""What a rod shows to others, in six words: position and axis in double, velocities and spins in single."""

from __future__ import annotations

from labbook_dem.words import func, struct, vec3, wide3

from labbook_warp.kernels.words import Words, halved, joined, load_word, store_word, word


@struct
class Spot:
    """Where a rod is."""

    x: wide3  # [m]
    axis: wide3  # unit vector


@func
def spot(p: Words, i: int):
    """Where grain i is."""
    a = load_word(p, i * 6)
    b = load_word(p, i * 6 + 1)
    c = load_word(p, i * 6 + 2)
    s = Spot()
    s.x = wide3(joined(a[0], a[1]), joined(a[2], a[3]), joined(b[0], b[1]))
    s.axis = wide3(joined(b[2], b[3]), joined(c[0], c[1]), joined(c[2], c[3]))
    return s


@func
def motion(p: Words, i: int, s: Spot):
    """Velocity [m/s] and angular velocity [rad/s] of grain i half a step before, and both predicted for now."""
    d = load_word(p, i * 6 + 3)
    e = load_word(p, i * 6 + 4)
    f = load_word(p, i * 6 + 5)
    return vec3(d[0], d[1], d[2]), vec3(d[3], e[0], e[1]), vec3(e[2], e[3], f[0]), vec3(f[1], f[2], f[3])


@func
def put(p: Words, i: int, x: wide3, axis: wide3, v: vec3, w: vec3, u: vec3, y: vec3):
    """Write what grain i shows: w and y are its angular velocity and the predicted one."""
    store_word(p, i * 6, word(halved(x[0], 0), halved(x[0], 1), halved(x[1], 0), halved(x[1], 1)))
    store_word(p, i * 6 + 1, word(halved(x[2], 0), halved(x[2], 1), halved(axis[0], 0), halved(axis[0], 1)))
    store_word(p, i * 6 + 2, word(halved(axis[1], 0), halved(axis[1], 1), halved(axis[2], 0), halved(axis[2], 1)))
    store_word(p, i * 6 + 3, word(v[0], v[1], v[2], w[0]))
    store_word(p, i * 6 + 4, word(w[1], w[2], u[0], u[1]))
    store_word(p, i * 6 + 5, word(u[2], y[0], y[1], y[2]))
