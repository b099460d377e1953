"""A grain's state in six words, all in double."""

from __future__ import annotations

from labbook_dem.words import func, real, struct, vec3, wide3

from labbook_warp.kernels.words import Words, load_word, store_word, word


@struct
class Spot:
    """Where a grain is, and the word that also holds the first of how it moves."""

    x: wide3  # [m]
    shared: word


@func
def spot(p: Words, i: int):
    """Where grain i is. Loads by threads side by side are scattered, and none is made twice."""
    a = load_word(p, i * 6)
    b = load_word(p, i * 6 + 1)
    s = Spot()
    s.x = wide3(a[0], a[1], b[0])
    s.shared = b
    return s


@func
def motion(p: Words, i: int, s: Spot):
    """Velocity [m/s] and angular velocity [rad/s] of grain i half a step before, and the velocity predicted for now."""
    c = load_word(p, i * 6 + 2)
    d = load_word(p, i * 6 + 3)
    e = load_word(p, i * 6 + 4)
    f = load_word(p, i * 6 + 5)
    return vec3(s.shared[1], c[0], c[1]), vec3(d[0], d[1], e[0]), vec3(e[1], f[0], f[1])


@func
def rest(p: Words, i: int):
    """Nothing: in double, rounding of the velocity does not matter."""
    return real(0.0)


@func
def put(p: Words, i: int, x: wide3, v: vec3, w: vec3, u: vec3, more: real):
    """Write the state of grain i."""
    store_word(p, i * 6, word(x[0], x[1]))
    store_word(p, i * 6 + 1, word(x[2], v[0]))
    store_word(p, i * 6 + 2, word(v[1], v[2]))
    store_word(p, i * 6 + 3, word(w[0], w[1]))
    store_word(p, i * 6 + 4, word(w[2], u[0]))
    store_word(p, i * 6 + 5, word(u[1], u[2]))
