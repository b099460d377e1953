"""What a rod shows to others, in nine words, all in double."""

from __future__ import annotations

from labbook_dem.words import func, struct, vec3, wide3

from labbook_warp.kernels.words import Words, load_word, store_word, word


@struct
class Spot:
    """Where a rod is."""

    x: wide3  # [m]
    axis: wide3  # unit vector


@func
def spot(p: Words, i: int):
    """Where grain i is."""
    a = load_word(p, i * 9)
    b = load_word(p, i * 9 + 1)
    c = load_word(p, i * 9 + 2)
    s = Spot()
    s.x = wide3(a[0], a[1], b[0])
    s.axis = wide3(b[1], c[0], c[1])
    return s


@func
def motion(p: Words, i: int, s: Spot):
    """Velocity [m/s] and angular velocity [rad/s] of grain i half a step before, and both predicted for now."""
    d = load_word(p, i * 9 + 3)
    e = load_word(p, i * 9 + 4)
    f = load_word(p, i * 9 + 5)
    g = load_word(p, i * 9 + 6)
    h = load_word(p, i * 9 + 7)
    k = load_word(p, i * 9 + 8)
    return vec3(d[0], d[1], e[0]), vec3(e[1], f[0], f[1]), vec3(g[0], g[1], h[0]), vec3(h[1], k[0], k[1])


@func
def put(p: Words, i: int, x: wide3, axis: wide3, v: vec3, w: vec3, u: vec3, y: vec3):
    """Write what grain i shows: w and y are its angular velocity and the predicted one."""
    store_word(p, i * 9, word(x[0], x[1]))
    store_word(p, i * 9 + 1, word(x[2], axis[0]))
    store_word(p, i * 9 + 2, word(axis[1], axis[2]))
    store_word(p, i * 9 + 3, word(v[0], v[1]))
    store_word(p, i * 9 + 4, word(v[2], w[0]))
    store_word(p, i * 9 + 5, word(w[1], w[2]))
    store_word(p, i * 9 + 6, word(u[0], u[1]))
    store_word(p, i * 9 + 7, word(u[2], y[0]))
    store_word(p, i * 9 + 8, word(y[1], y[2]))
