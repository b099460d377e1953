"""Thin plate round the z axis: a segment in the plane of radius and height, revolved.

rim: its lower end as (radius, 0, z); along: unit direction from there as (radial, 0, axial) with a radial part of at
least zero; length of the segment. The lower end is an edge that grains roll over.
"""

import math

from labbook.scene import Frustum
from labbook_dem.words import dot, func, real, rounded, section, sqrt, wide, wide3

PARTS = 4


@func
def frustum_over(rim: section, along: section, x: wide3):
    """Coordinate [m] of x up the plate; negative beyond the rim. It is convex along a straight line."""
    return (sqrt(x.x * x.x + x.y * x.y) - rim.x) * along.x + (x.z - rim.z) * along.z


@func
def frustum_distance(rim: section, along: section, length: wide, x: wide3):
    """Distance [m] of x from the nearest point of the plate, and the unit normal from there to x."""
    zero = wide(0.0)
    unity = wide(1.0)
    rho = sqrt(x.x * x.x + x.y * x.y)
    dr = rho - rim.x
    dz = x.z - rim.z
    at = min(max(dr * along.x + dz * along.z, zero), length)
    dr = dr - along.x * at
    dz = dz - along.z * at
    distance = sqrt(dr * dr + dz * dz)
    inverse = unity / distance if distance > zero else zero
    outwards = dr * inverse / rho if rho > zero else zero
    return distance, wide3(x.x * outwards, x.y * outwards, dz * inverse)


@func
def leaves_plate(rim: section, along: section, x: wide3, a: wide3, half: wide):
    """Position [m] on the segment of the first point beyond the rim, seen from the end at -half.

    A convex function falls to its first zero: Newton's steps come from the left and never pass it. They are computed in
    `real`, except for a last one in `wide`, which removes the rounding error up to its square.
    """
    zero = real(0.0)
    radius = rounded(rim.x)
    out = rounded(along.x)
    # how far beyond the rim is (rho^2 - R^2)/(rho + R): a small difference of squares, which is taken in wide
    beyond0 = rounded(x.x * x.x + x.y * x.y - rim.x * rim.x)
    beyond1 = rounded(x.x * a.x + x.y * a.y)
    beyond2 = rounded(a.x * a.x + a.y * a.y)
    up0 = rounded((x.z - rim.z) * along.z)
    up1 = rounded(a.z * along.z)
    ends = rounded(half)
    near = real(1e-6) * ends
    s = -ends
    slope = zero
    moved = ends
    left = int(8)
    while left > 0 and moved > near:
        beyond = beyond0 + s * (beyond1 + beyond1 + s * beyond2)
        rho = max(sqrt(max(beyond + radius * radius, zero)), real(1e-12))
        clearance = beyond / (rho + radius) * out + (up0 + s * up1)
        slope = (beyond1 + s * beyond2) / rho * out + up1
        step = clearance / slope if slope < zero else -ends - ends
        to = min(s - step, ends) if clearance > zero else s
        moved = to - s
        s = to
        left = left - 1
    step = rounded(frustum_over(rim, along, x + a * wide(s))) / slope if slope < zero else zero
    return min(max(wide(s) - wide(step), -half), half)


@func
def pull(s: real, ca: real, radius: real, passes: real, a2: real, b2: real):
    """Function g of `nearest_to_rim` at s, and distance rho from the axis there [m]: rho^2 = b2 + a2 (s - passes)^2."""
    t = s - passes
    rho = max(sqrt(b2 + a2 * t * t), real(1e-12))
    return s + ca - radius * (a2 * t) / rho, rho


@func
def nearest_to_rim(rim: section, x: wide3, a: wide3, first: wide, last: wide):
    """Position [m] of the first minimum between `first` and `last` of the distance from the rim.

    Half the derivative of its square is g(s) = s + c.a - R rho'(s), c = x - (0, 0, z). rho'' is largest where the
    segment passes the axis, and R rho'' = 1 at both ends m, n of the stretch on which g falls: g rises and is concave
    before m, rises and is convex behind n. There Newton's steps come from `first`, here from `last`, and never pass a
    zero. They are computed in `real`, except for a last one in `wide`, which removes the rounding error.
    """
    zero = real(0.0)
    unity = real(1.0)
    tiny = real(1e-12)
    radius = rounded(rim.x)
    begin = rounded(first)
    end = rounded(last)
    ca = rounded(dot(x, a) - rim.z * a.z)
    # `pull` is wrong of rods within 1e-6 of upright, which the last step puts right
    a2 = max(rounded(a.x * a.x + a.y * a.y), tiny)
    passes = -rounded(x.x * a.x + x.y * a.y) / a2
    across = rounded(x.x * a.y - x.y * a.x)
    b2 = across * across / a2
    reach = sqrt(max((radius * a2 * b2) ** (real(2.0) / real(3.0)) - b2, zero) / a2)
    m = min(passes - reach, end)
    n = passes + reach
    # g at `first` and at m
    at_first, rho = pull(begin, ca, radius, passes, a2, b2)
    at_m, rho = pull(m, ca, radius, passes, a2, b2)
    before = m > begin and at_m >= zero
    low = begin if before else max(begin, n)
    high = m if before else end
    s = low if before else high
    slope = zero
    near = real(1e-6) * (end - begin)
    moved = end - begin
    left = int(8)
    while left > 0 and moved > near:
        g, rho = pull(s, ca, radius, passes, a2, b2)
        slope = unity - radius * a2 * b2 / (rho * rho * rho)
        step = g / slope if slope > tiny else zero
        to = min(max(s - step, low), high) if before or g > zero else s
        moved = abs(to - s)
        s = to
        left = left - 1
    at = wide(s)
    px = x.x + a.x * at
    py = x.y + a.y * at
    left_over = (
        at + (dot(x, a) - rim.z * a.z) - rim.x * (px * a.x + py * a.y) / max(sqrt(px * px + py * py), wide(1e-12))
    )
    step = rounded(left_over) / slope if slope > tiny else zero
    return first if at_first >= zero else min(max(at - wide(step), first), last)


@func
def frustum_part(rim: section, along: section, length: wide, x: wide3, a: wide3, half: wide, part: int, on: wide):
    """Distance [m] of an end of a rod from the plate below it, unit normal, and position on the segment [m].

    on: position of an edge on the segment; for parts 2 and 3, the point whose normal is returned.
    """
    s = on if part > 1 else (half if part == 1 else -half)
    p = x + a * s
    distance, normal = frustum_distance(rim, along, length, p)
    there = part > 1 or (frustum_over(rim, along, p) >= wide(0.0) and (part == 0 or half > wide(0.0)))
    return (distance if there else wide(1e9)), normal, s


@func
def rim_met(
    rim: section, along: section, length: wide, x: wide3, a: wide3, half: wide, radius: wide, s: wide, two: bool
):  # fmt: skip
    """Distance [m] from the rim of the minimum at s, the first from the end at -half; two: there is another one.

    It is larger by the overlap that the ends carry while they are over the plate. An end at the far side of the hole,
    with a minimum of its own, counts already as it comes near.
    """
    zero = wide(0.0)
    unity = wide(1.0)
    distance, _ = frustum_distance(rim, along, length, x + a * s)
    near, _ = frustum_distance(rim, along, length, x - a * half)
    far, _ = frustum_distance(rim, along, length, x + a * half)
    near_over = unity if frustum_over(rim, along, x - a * half) >= zero else zero
    far_over = min(max(unity + frustum_over(rim, along, x + a * half) / radius, zero), unity)
    far_over = far_over if two or far_over >= unity else zero
    to_far = (s + half) / (half + half) if half > zero else zero
    carried = (unity - to_far) * near_over * max(radius - near, zero) + to_far * far_over * max(radius - far, zero)
    return distance + carried


@func
def is_across(rim: section, along: section, x: wide3, a: wide3, half: wide, first: wide, last: wide, at: wide):
    """True if the stretch from `first` to `last` of the segment is beyond the rim, tested at its point `at`."""
    return first <= last and frustum_over(rim, along, x + a * at) <= wide(1e-9) * (rim.x + half)


@func
def two_minima(s: wide, back: wide, half: wide):
    """True if the minima at s and at `back`, from searches from the two ends, are different."""
    return back - s > wide(1e-3) * half


@func
def frustum_edges(rim: section, along: section, length: wide, x: wide3, a: wide3, half: wide, radius: wide):
    """Distances [m] from the rim of a rod that lies across it, and positions on the segment, of part 2 and of part 3.

    On the stretch of the segment beyond the rim, part 2 is the first minimum of the distance from the end at -half,
    part 3 the first from the other end, if it is a different one. There are at most two; a missing one has 1e9 m.
    """
    absent = wide(1e9)
    zero = wide(0.0)
    first = leaves_plate(rim, along, x, a, half)
    last = -leaves_plate(rim, along, x, -a, half)
    if not is_across(rim, along, x, a, half, first, last, first):
        return absent, zero, absent, zero
    s = nearest_to_rim(rim, x, a, first, last)
    back = -nearest_to_rim(rim, x, -a, -last, -first)
    both = two_minima(s, back, half)
    met = rim_met(rim, along, length, x, a, half, radius, s, both)
    second_met = absent
    if both:
        second_met = rim_met(rim, along, length, x, -a, half, radius, -back, both)
    return met, s, second_met, back


@func
def frustum_edge(rim: section, along: section, length: wide, x: wide3, part: int):
    """Distance [m] of x from the rim, the edge of both parts 2 and 3."""
    dr = sqrt(x.x * x.x + x.y * x.y) - rim.x
    dz = x.z - rim.z
    return sqrt(dr * dr + dz * dz)


@func
def frustum_rod(
    rim: section, along: section, length: wide, x: wide3, a: wide3, half: wide, part: int, met: wide, on: wide,
    other: wide, back: wide,
):  # fmt: skip
    """Distance [m] of a part of a rod from the plate, unit normal, and position on the segment; see `walls`.

    x: centre [m]; a: unit axis; half: half the length of the segment [m]. met, on, other, back: both edges, from
    `frustum_edges`.
    """
    distance, normal, s = frustum_part(rim, along, length, x, a, half, part, on if part == 2 else back)
    return (distance if part < 2 else (met if part == 2 else other)), normal, s


def parameters(shape: Frustum) -> tuple[float, ...]:
    """Lower end (radius, z) [m], unit direction (radial, axial), length [m]."""
    (r, z), (r1, z1) = shape.lower, shape.upper
    length = math.hypot(r1 - r, z1 - z)
    return r, z, (r1 - r) / length, (z1 - z) / length, length
