"""Area or volume of a disc, a sphere or a rod within a rectangle, a box or an upright ring.

Areas are exact. Volumes are sums over exact areas (spheres) or exact lengths of lines (rods), by quadrature.
"""

import numpy as np

_ORDER = 48
_AT_ONCE = 128
"""Spheres whose discs are clipped together: few calls, and what they hold stays in a core's cache."""
_RADII, _ANGLES = 12, 24
"""Lines along a rod, over its cross-section. The error is below 2e-2 of a rod where a face cuts it lengthwise,
else below 1e-2, and averages out over rods. Whole rods are exact to round-off."""


def disc_in_rectangle(
    x: np.ndarray,
    z: np.ndarray,
    radius: np.ndarray | float,
    low: tuple[float, float],
    high: tuple[float, float],
) -> np.ndarray:
    """Compute the exact area of discs within a rectangle.

    Args:
        x: Abscissas of the centres [m].
        z: Ordinates of the centres [m], of the shape of x.
        radius: Radii [m], of the shape of x, or one for all.
        low: Lower left corner of the rectangle [m].
        high: Upper right corner [m].

    Returns:
        Areas [m^2], of the shape of x.
    """
    radius = np.asarray(radius, float)
    safe = np.where(radius > 0, radius, 1.0)
    # the four corners share two abscissas and two ordinates: of each the segments are found once
    left, right = _side((low[0] - x) / safe), _side((high[0] - x) / safe)
    below, above = _chord((low[1] - z) / safe), _chord((high[1] - z) / safe)
    whole = _unit_disc_below(right, above) - _unit_disc_below(left, above) - _unit_disc_below(right, below)
    return np.where(radius > 0, radius**2, 0.0) * _clip(whole + _unit_disc_below(left, below), 0, np.pi)


def _side(a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Clip the side x = a to the unit circle, and integrate the half chord from 0 to it."""
    a = _clip(a, -1, 1)
    return a, _half_segment(a)


def _chord(b: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Clip the chord y = b to the unit circle; with the abscissa c of its right end, and the integral from 0 to c."""
    b = _clip(b, -1, 1)
    c = np.sqrt(1 - b**2)
    return b, c, _half_segment(c)


def _unit_disc_below(
    side: tuple[np.ndarray, np.ndarray], chord: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> np.ndarray:
    """Area of the part of the unit disc with x < a and y < b."""
    (a, to_a), (b, c, to_c) = side, chord
    hi = _clip(a, -c, c)
    to_hi = _half_segment(hi)
    under_line = b * (hi + c) + to_hi + to_c
    beside = 2 * (to_a + np.pi / 4) - 2 * (to_hi + to_c)
    return under_line + np.where(b > 0, beside, 0.0)


def _clip(x: np.ndarray, low: np.ndarray | float, high: np.ndarray | float) -> np.ndarray:
    """Clip as np.clip does, which takes several times as long for short arrays."""
    return np.minimum(np.maximum(x, low), high)


def _half_segment(x: np.ndarray) -> np.ndarray:
    """Integral of sqrt(1 - t^2) from 0 to x."""
    return (x * np.sqrt(1 - x**2) + np.arcsin(x)) / 2


def sphere_in_box(
    centre: np.ndarray, radius: np.ndarray | float, low: tuple[float, float, float], high: tuple[float, float, float]
) -> np.ndarray:
    """Compute the volume of spheres within a box.

    Discs clipped in x and z are exact; they are summed along y by Gauss-Legendre quadrature of order 48 in the
    polar angle. The error is below 1e-4 of a sphere where faces cut it, and round-off for whole ones.

    Args:
        centre: Centres [m], shape [n, 3].
        radius: Radii [m], shape [n], or one for all.
        low: Corner of the box with the smallest coordinates [m].
        high: Opposite corner [m].

    Returns:
        Volumes [m^3], shape [n].
    """
    x, y, z = np.asarray(centre, float).T
    radius = np.broadcast_to(np.asarray(radius, float), len(x))
    start = np.arcsin(_clip((low[1] - y) / radius, -1, 1))
    stop = np.arcsin(_clip((high[1] - y) / radius, -1, 1))
    nodes, weights = np.polynomial.legendre.leggauss(_ORDER)
    middle, half = (start + stop) / 2, (stop - start) / 2
    volume = np.zeros(len(x))
    for first in range(0, len(x), _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        cosine = np.cos(middle[some] + half[some] * nodes[:, None])
        area = disc_in_rectangle(x[some], z[some], radius[some] * cosine, (low[0], low[2]), (high[0], high[2]))
        for term in weights[:, None] * half[some] * area * radius[some] * cosine:
            volume[some] += term
    return volume


def lens(distance: np.ndarray, radius: np.ndarray, around: float) -> np.ndarray:
    """Compute the exact area of the intersection of discs with one large disc.

    Args:
        distance: Distances of the centres [m], shape [n].
        radius: Radii of the discs [m], shape [n].
        around: Radius of the large disc [m].

    Returns:
        Areas [m^2], shape [n].
    """
    r, R = np.broadcast_to(np.asarray(radius, float), np.shape(distance)), around
    whole = np.pi * np.minimum(np.maximum(r, 0), R) ** 2
    cut = (distance > abs(R - r)) & (distance < R + r)
    s = np.where(cut, distance, 1.0)
    small = np.where(cut, r, 1.0)
    # distance of the common chord from either centre, over the radius there
    a = np.clip((s**2 + small**2 - R**2) / (2 * s * small), -1, 1)
    # 1e-300: the inner radius of a ring may be 0
    b = np.clip((s**2 + R**2 - small**2) / (2 * s * max(R, 1e-300)), -1, 1)
    segments = small**2 * (np.arccos(a) - a * np.sqrt(1 - a**2)) + R**2 * (np.arccos(b) - b * np.sqrt(1 - b**2))
    return np.where(cut, segments, np.where(distance >= R + r, 0.0, whole))


def sphere_in_ring(
    centre: np.ndarray,
    radius: np.ndarray | float,
    inner: float,
    outer: float,
    low: float,
    high: float,
) -> np.ndarray:
    """Compute the volume of spheres within an upright ring about the z axis.

    Horizontal discs are clipped exactly; they are summed along z as in `sphere_in_box`, with the same error.

    Args:
        centre: Centres [m], shape [n, 3].
        radius: Radii [m], shape [n], or one for all.
        inner: Inner radius of the ring [m].
        outer: Outer radius [m].
        low: Height of its lower face [m].
        high: Height of its upper face [m].

    Returns:
        Volumes [m^3], shape [n].
    """
    off, z = np.hypot(centre[:, 0], centre[:, 1]), np.asarray(centre[:, 2], float)
    start = np.arcsin(np.clip((low - z) / radius, -1, 1))
    stop = np.arcsin(np.clip((high - z) / radius, -1, 1))
    nodes, weights = np.polynomial.legendre.leggauss(_ORDER)
    middle, half = (start + stop) / 2, (stop - start) / 2
    volume = np.zeros(len(z))
    for node, weight in zip(nodes, weights, strict=True):
        disc = radius * np.cos(middle + half * node)
        volume += weight * half * (lens(off, disc, outer) - lens(off, disc, inner)) * disc
    return volume


def rod_in_box(
    centre: np.ndarray,
    axis: np.ndarray,
    radius: float,
    half_length: float,
    low: tuple[float, float, float],
    high: tuple[float, float, float],
) -> np.ndarray:
    """Compute the volume of spherocylinders within a box.

    Lines along the rod are clipped exactly and summed over its cross-section.

    Args:
        centre: Centres [m], shape [n, 3].
        axis: Unit vectors along the rods, shape [n, 3].
        radius: Radius of the rods [m].
        half_length: Half length of the segment between the centres of their caps [m].
        low: Corner of the box with the smallest coordinates [m].
        high: Opposite corner [m].

    Returns:
        Volumes [m^3], shape [n].
    """
    volume = np.zeros(len(centre))
    for offset, reach, weight in _lines(axis, radius, half_length):
        first, last = -reach * np.ones(len(centre)), reach * np.ones(len(centre))
        for c in range(3):
            from_low, to_high = _between(centre[:, c] + offset[:, c], axis[:, c], low[c], high[c])
            first, last = np.maximum(first, from_low), np.minimum(last, to_high)
        volume += weight * np.maximum(last - first, 0)
    return volume


def rod_in_ring(
    centre: np.ndarray,
    axis: np.ndarray,
    radius: float,
    half_length: float,
    inner: float,
    outer: float,
    low: float,
    high: float,
) -> np.ndarray:
    """Compute the volume of spherocylinders within an upright ring about the z axis.

    The ring is that of `sphere_in_ring`, the rods are those of `rod_in_box`.

    Returns:
        Volumes [m^3], shape [n].
    """
    volume = np.zeros(len(centre))
    for offset, reach, weight in _lines(axis, radius, half_length):
        x = centre + offset
        first, last = _between(x[:, 2], axis[:, 2], low, high)
        first, last = np.maximum(first, -reach), np.minimum(last, reach)
        volume += weight * (_within(x, axis, outer, first, last) - _within(x, axis, inner, first, last))
    return volume


def _lines(axis: np.ndarray, radius: float, half_length: float):
    """Yield lines along rods that fill their cross-section.

    Each has its offset from the centre [m], shape [n, 3], its reach to either side [m], and its share of the area
    [m^2].

    The distance of a line from the axis is r sin(a). The angles a are Gaussian nodes, in which the length of a line,
    2 (half_length + r cos(a)), is smooth: the lines of a whole rod add up to its volume.
    """
    # a coordinate axis far from that of the rod: a cross product of nearly parallel vectors loses digits
    helper = np.where(np.abs(axis[:, :1]) < 0.6, np.array([1.0, 0, 0]), np.array([0, 1.0, 0]))
    normal = np.cross(axis, helper)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    binormal = np.cross(axis, normal)
    nodes, weights = np.polynomial.legendre.leggauss(_RADII)
    polar = np.pi / 4 * (1 + nodes)
    weights = np.pi / 4 * weights * np.sin(polar) * np.cos(polar) * radius**2 * 2 * np.pi / _ANGLES
    for ring, (angle, weight) in enumerate(zip(polar, weights, strict=True)):
        off, reach = radius * np.sin(angle), half_length + radius * np.cos(angle)
        # every second ring is turned by half a step, so that a face along the rod does not cut lines of all rings at
        # once
        for turn in 2 * np.pi * (np.arange(_ANGLES) + (ring % 2) / 2) / _ANGLES:
            yield off * (np.cos(turn) * normal + np.sin(turn) * binormal), reach, weight


def _between(at: np.ndarray, along: np.ndarray, low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    """Smallest and largest t with low <= at + t along <= high; the first exceeds the second if there is none."""
    flat = np.abs(along) < 1e-12
    slope = np.where(flat, 1.0, along)
    a, b = (low - at) / slope, (high - at) / slope
    inside = (at >= low) & (at <= high)
    first = np.where(flat, np.where(inside, -np.inf, np.inf), np.minimum(a, b))
    last = np.where(flat, np.where(inside, np.inf, -np.inf), np.maximum(a, b))
    return first, last


def _within(x: np.ndarray, axis: np.ndarray, around: float, first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Length [m] of the lines x + t axis from t = first to last within the cylinder of the radius `around` [m]."""
    a = axis[:, 0] ** 2 + axis[:, 1] ** 2
    b = x[:, 0] * axis[:, 0] + x[:, 1] * axis[:, 1]
    c = x[:, 0] ** 2 + x[:, 1] ** 2 - around**2
    upright = a < 1e-12
    square = b**2 - a * c
    root = np.sqrt(np.maximum(square, 0))
    a = np.where(upright, 1.0, a)
    enter = np.where(upright, np.where(c < 0, -np.inf, np.inf), np.where(square > 0, (-b - root) / a, np.inf))
    leave = np.where(upright, np.where(c < 0, np.inf, -np.inf), np.where(square > 0, (-b + root) / a, -np.inf))
    return np.maximum(np.minimum(last, leave) - np.maximum(first, enter), 0)
