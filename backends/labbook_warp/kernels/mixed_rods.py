"""A rod's state in seven words: position and orientation in double, velocities and momenta in single."""

from __future__ import annotations

from labbook_dem.words import func, real, struct, vec3, wide3

from labbook_warp.kernels.words import Words, halved, joined, load_again, load_word, store_word, wide4, word


@struct
class Spot:
    """Where a rod is, and the word that also holds the first of how it moves."""

    x: wide3  # [m]
    q: wide4  # unit quaternion (w, x, y, z)
    last: word


@func
def spot(p: Words, i: int):
    """Where grain i is. Loads by threads side by side are scattered, and none is made twice."""
    a = load_word(p, i * 7)
    b = load_word(p, i * 7 + 1)
    c = load_word(p, i * 7 + 2)
    d = load_word(p, i * 7 + 3)
    s = Spot()
    s.x = wide3(joined(a[0], a[1]), joined(a[2], a[3]), joined(b[0], b[1]))
    s.q = wide4(joined(b[2], b[3]), joined(c[0], c[1]), joined(c[2], c[3]), joined(d[0], d[1]))
    s.last = d
    return s


@func
def motion(p: Words, i: int, s: Spot):
    """Of grain i: velocity [m/s] and reduced angular momentum [rad/s] half a step before, and both predicted for now."""
    e = load_word(p, i * 7 + 4)
    f = load_word(p, i * 7 + 5)
    g = load_word(p, i * 7 + 6)
    return vec3(s.last[2], s.last[3], e[0]), vec3(e[1], e[2], e[3]), vec3(f[0], f[1], f[2]), vec3(f[3], g[0], g[1])


@func
def turning_again(p: Words, i: int):
    """Orientation and momentum of grain i, loaded anew: only the end of a step needs them as they stand here."""
    b = load_again(p, i * 7 + 1)
    c = load_again(p, i * 7 + 2)
    d = load_again(p, i * 7 + 3)
    e = load_again(p, i * 7 + 4)
    q = wide4(joined(b[2], b[3]), joined(c[0], c[1]), joined(c[2], c[3]), joined(d[0], d[1]))
    return q, vec3(e[1], e[2], e[3])


@func
def rest(p: Words, i: int):
    """What rounding has kept from the vertical velocity [m/s]; see `mixed`."""
    g = load_word(p, i * 7 + 6)
    return g[2]


@func
def put(p: Words, i: int, x: wide3, q: wide4, v: vec3, w: vec3, u: vec3, y: vec3, more: real):
    """Write the state of grain i: w and y are its momentum and the predicted one."""
    store_word(p, i * 7, word(halved(x[0], 0), halved(x[0], 1), halved(x[1], 0), halved(x[1], 1)))
    store_word(p, i * 7 + 1, word(halved(x[2], 0), halved(x[2], 1), halved(q[0], 0), halved(q[0], 1)))
    store_word(p, i * 7 + 2, word(halved(q[1], 0), halved(q[1], 1), halved(q[2], 0), halved(q[2], 1)))
    store_word(p, i * 7 + 3, word(halved(q[3], 0), halved(q[3], 1), v[0], v[1]))
    store_word(p, i * 7 + 4, word(v[2], w[0], w[1], w[2]))
    store_word(p, i * 7 + 5, word(u[0], u[1], u[2], y[0]))
    store_word(p, i * 7 + 6, word(y[1], y[2], more, real(0.0)))
