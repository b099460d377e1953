"""A rod's state in ten words, all in double."""

from __future__ import annotations

from labbook_dem.words import func, real, struct, vec3, wide3

from labbook_warp.kernels.words import Words, load_again, load_word, store_word, wide4, word


@struct
class Spot:
    """Where a rod is, and the word that also holds the first of how it moves."""

    x: wide3  # [m]
    q: wide4  # unit quaternion (w, x, y, z)
    last: word


@func
def spot(p: Words, i: int):
    """Where grain i is. Loads by threads side by side are scattered, and none is made twice."""
    a = load_word(p, i * 10)
    b = load_word(p, i * 10 + 1)
    c = load_word(p, i * 10 + 2)
    d = load_word(p, i * 10 + 3)
    s = Spot()
    s.x = wide3(a[0], a[1], b[0])
    s.q = wide4(b[1], c[0], c[1], d[0])
    s.last = d
    return s


@func
def motion(p: Words, i: int, s: Spot):
    """Of grain i: velocity [m/s] and reduced angular momentum [rad/s] half a step before, and both predicted for now."""
    e = load_word(p, i * 10 + 4)
    f = load_word(p, i * 10 + 5)
    g = load_word(p, i * 10 + 6)
    h = load_word(p, i * 10 + 7)
    k = load_word(p, i * 10 + 8)
    n = load_word(p, i * 10 + 9)
    return (
        vec3(s.last[1], e[0], e[1]),
        vec3(f[0], f[1], g[0]),
        vec3(g[1], h[0], h[1]),
        vec3(k[0], k[1], n[0]),
    )


@func
def turning_again(p: Words, i: int):
    """Orientation and momentum of grain i, loaded anew: only the end of a step needs them as they stand here."""
    b = load_again(p, i * 10 + 1)
    c = load_again(p, i * 10 + 2)
    d = load_again(p, i * 10 + 3)
    f = load_again(p, i * 10 + 5)
    g = load_again(p, i * 10 + 6)
    return wide4(b[1], c[0], c[1], d[0]), vec3(f[0], f[1], g[0])


@func
def rest(p: Words, i: int):
    """Nothing: in double, rounding of the velocity does not matter."""
    return real(0.0)


@func
def put(p: Words, i: int, x: wide3, q: wide4, v: vec3, w: vec3, u: vec3, y: vec3, more: real):
    """Write the state of grain i: w and y are its momentum and the predicted one."""
    store_word(p, i * 10, word(x[0], x[1]))
    store_word(p, i * 10 + 1, word(x[2], q[0]))
    store_word(p, i * 10 + 2, word(q[1], q[2]))
    store_word(p, i * 10 + 3, word(q[3], v[0]))
    store_word(p, i * 10 + 4, word(v[1], v[2]))
    store_word(p, i * 10 + 5, word(w[0], w[1]))
    store_word(p, i * 10 + 6, word(w[2], u[0]))
    store_word(p, i * 10 + 7, word(u[1], u[2]))
    store_word(p, i * 10 + 8, word(y[0], y[1]))
    store_word(p, i * 10 + 9, word(y[2], real(0.0)))
