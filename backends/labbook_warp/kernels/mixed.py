"""A grain's state in four words: position in double, velocities and spin in single."""

from __future__ import annotations

from labbook_dem.words import func, real, struct, vec3, wide3

from labbook_warp.kernels.words import Words, halved, joined, load_word, store_word, word


@struct
class Spot:
    """Where a grain is, and the word that also holds the first of how it moves."""

    x: wide3  # [m]
    shared: word


@func
def spot(p: Words, i: int):
    """Where grain i is. Loads by threads side by side are scattered, and none is made twice."""
    a = load_word(p, i * 4)
    b = load_word(p, i * 4 + 1)
    s = Spot()
    s.x = wide3(joined(a[0], a[1]), joined(a[2], a[3]), joined(b[0], b[1]))
    s.shared = b
    return s


@func
def motion(p: Words, i: int, s: Spot):
    """Velocity [m/s] and angular velocity [rad/s] of grain i half a step before, and the velocity predicted for now."""
    c = load_word(p, i * 4 + 2)
    d = load_word(p, i * 4 + 3)
    return vec3(s.shared[2], s.shared[3], c[0]), vec3(c[1], c[2], c[3]), vec3(d[0], d[1], d[2])


@func
def rest(p: Words, i: int):
    """What rounding has kept from the vertical velocity [m/s]: gravity's small kicks would be rounded all one way."""
    d = load_word(p, i * 4 + 3)
    return d[3]


@func
def put(p: Words, i: int, x: wide3, v: vec3, w: vec3, u: vec3, more: real):
    """Write the state of grain i."""
    store_word(p, i * 4, word(halved(x[0], 0), halved(x[0], 1), halved(x[1], 0), halved(x[1], 1)))
    store_word(p, i * 4 + 1, word(halved(x[2], 0), halved(x[2], 1), v[0], v[1]))
    store_word(p, i * 4 + 2, word(v[2], w[0], w[1], w[2]))
    store_word(p, i * 4 + 3, word(u[0], u[1], u[2], more))
