"""The points at which two segments, the hearts of two rods, are closest.

Bare closest points jump from one end to the other as rods turn through parallel. So |c + s a - t b|^2 + eps (s^2 + t^2)
is minimised instead over |s|, |t| <= h: strictly convex, hence its minimum is one point, continuous in c, a and b.
Rods that are d apart and tilted by eps h/d lose most by it: a distance of eps h^2/(2 d), 0.8e-9 m for 20 mm x 6 mm with
eps = 2e-7. eps has no unit: nothing depends on the size of rods.

The first guess at s is the quotient of a small difference, which is taken in `wide`; what follows from it may be
`real`. The branch is evaluated in `wide` at the s and t so found, near a minimum, where their errors count to second
order.

Every expression is odd or even under an exchange of the two rods, term by term, as in `labbook_dem.spheres`. A compiler
that fuses products and sums keeps that only where it is given the two rods in the same order.
"""

from labbook_dem.words import cross, dot, func, narrow, real, rounded, wide, wide3


@func
def in_turn(ab: real, ca: real, cb: real, free: real, sin2: real, half: real):
    """s and t [m] of the minimum: s free, then clamped, t for that s, and s again for that t.

    ab = a.b, ca = c.a, cb = c.b, sin2 = |a x b|^2; free = ab cb - (1 + eps) ca. With two unknowns, these three clamps
    find the minimum within the limits, as without eps in Ericson, Real-Time Collision Detection (2005), section 5.1.9.
    """
    eps = real(2e-7)
    inverse = real(1.0) / (real(1.0) + eps)
    s = free / (sin2 + eps * (real(2.0) + eps))
    s = min(max(s, -half), half)
    t = min(max((cb + ab * s) * inverse, -half), half)
    s = min(max((ab * t - ca) * inverse, -half), half)
    return s, t


@func
def closest_from(c: wide3, a: wide3, b: wide3, half: wide, first: bool):
    """s and t of `closest`, to within rounding, at half the work: i is taken first, or j.

    Asked of either rod, with `first` true for one of them, Warp's compilers give the same s and t to the last bit.
    """
    one = wide(1.0)
    ab = dot(a, b)
    ca = dot(c, a)
    cb = dot(c, b)
    mine = ca if first else -cb
    yours = cb if first else -ca
    free = ab * yours - (one + wide(2e-7)) * mine
    # 1 - (a.b)^2 is wrong by 1e-16, nothing beside eps
    s, t = in_turn(rounded(ab), rounded(mine), rounded(yours), rounded(free), rounded(one - ab * ab), rounded(half))
    return s if first else t, t if first else s


@func
def closest(c: wide3, a: wide3, b: wide3, half: wide):
    """s, t [m] of the closest points x_i + s a and x_j + t b, and the branch from the second to the first [m].

    c = x_i - x_j [m]; a, b: unit axes; half: half the length of both segments [m].
    """
    one = wide(1.0) + wide(2e-7)
    ab = dot(a, b)
    ca = dot(c, a)
    cb = dot(c, b)
    across = cross(narrow(a), narrow(b))
    sin2 = dot(across, across)
    s, t = in_turn(real(ab), real(ca), real(cb), real(ab * cb - one * ca), sin2, real(half))
    u, r = in_turn(real(ab), real(-cb), real(-ca), real(one * cb - ab * ca), sin2, real(half))
    # both are the minimum; their mean does not know which rod came first
    s_mean = wide(0.5) * (wide(s) + wide(r))
    t_mean = wide(0.5) * (wide(t) + wide(u))
    return s_mean, t_mean, c + (a * s_mean - b * t_mean)
