"""A grain's state in four words: position in double, velocities and spin in single."""

from __future__ import annotations

from labbook_dem.words import func, real, vec3, wide3

from labbook_warp.kernels.words import Words, halved, joined, load_word, store_word, word


@func
def position(p: Words, i: int):
    """x [m] of grain i."""
    a = load_word(p, i * 4)
    b = load_word(p, i * 4 + 1)
    return wide3(joined(a[0], a[1]), joined(a[2], a[3]), joined(b[0], b[1]))


@func
def velocity(p: Words, i: int):
    """v [m/s] half a step before."""
    b = load_word(p, i * 4 + 1)
    c = load_word(p, i * 4 + 2)
    return vec3(b[2], b[3], c[0])


@func
def spin(p: Words, i: int):
    """Angular velocity [rad/s] half a step before."""
    c = load_word(p, i * 4 + 2)
    return vec3(c[1], c[2], c[3])


@func
def predicted(p: Words, i: int):
    """v [m/s] predicted for now."""
    d = load_word(p, i * 4 + 3)
    return vec3(d[0], d[1], d[2])


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
