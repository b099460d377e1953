"""Loops over grains and contacts, compiled. Each thread sums into arrays of its own.

Grains: the Gaussian is a product of factors of x, y and z, so that a grain costs an exponential a row and a column, not
a cell; the cut-off ball is kept exactly by the range of columns of each row. Contacts: the integral of the cut-off
Gaussian along a line is one of error functions between the ends of the part within the ball, at every cell. About an
axis each deposit is repeated at the azimuths from which it can be seen.
"""

import math

import numpy as np
from numba import njit, prange

_STEPS = 256  # of the table of erf, a unit: cubic Hermite between them is exact to 1e-12
ERF = np.array([math.erf(k / _STEPS) for k in range(4 * _STEPS)])
SLOPE = np.array([2 / math.sqrt(math.pi) * math.exp(-((k / _STEPS) ** 2)) / _STEPS for k in range(4 * _STEPS)])


@njit(cache=True)
def _cells(at, reach, low, step, n):
    """First and one past the last cell whose middles lie within `reach` of `at`."""
    first = math.ceil((at - reach - low) / step - 0.5)
    last = math.floor((at + reach - low) / step - 0.5) + 1
    return max(0, first), min(n, last)


@njit(cache=True)
def _erf(x, table, slope):
    """erf for |x| < 3.9, from its table."""
    size = abs(x) * _STEPS
    k = int(size)
    t = size - k
    a, b, da, db = table[k], table[k + 1], slope[k], slope[k + 1]
    value = a + t * (da + t * (3 * (b - a) - 2 * da - db + t * (2 * (a - b) + da + db)))
    return value if x >= 0 else -value


# grains on a lattice


@njit(cache=True)
def _spread(x, values, scale, low, step, omega, reach, ex, out):
    """Add scale · Gaussian about x · values [F] to out [F, nz, ny, nx], and return 0.

    With scale 0 nothing is added, and the sum of the Gaussian over cells is returned: the scale that normalizes it.
    """
    nz, ny, nx = out.shape[1:]
    flat = step[1] == 0
    j0, j1 = (0, 1) if flat else _cells(x[1], reach, low[1], step[1], ny)
    k0, k1 = _cells(x[2], reach, low[2], step[2], nz)
    half = 0.5 / (omega * omega)
    total = 0.0
    for k in range(k0, k1):
        dz = low[2] + (k + 0.5) * step[2] - x[2]
        for j in range(j0, j1):
            dy = 0.0 if flat else low[1] + (j + 0.5) * step[1] - x[1]
            left = reach * reach - dz * dz - dy * dy
            if left < 0:
                continue
            a, b = _cells(x[0], math.sqrt(left), low[0], step[0], nx)
            w = math.exp(-(dz * dz + dy * dy) * half)
            if scale == 0:
                for c in range(a, b):
                    total += w * ex[c]
                continue
            for f in range(values.shape[0]):
                q = scale * w * values[f]
                row = out[f, k, j]
                for c in range(a, b):
                    row[c] += q * ex[c]
    return total


@njit(cache=True, parallel=True)
def on_lattice(x, values, low, step, omega, reach, amplitude, normalised, out):
    """Deposit values [n, F] of grains at x [n, 3] on a lattice; out [threads, F, nz, ny, nx].

    A layer has step[1] = 0: y then counts for nothing. `normalised`: the kernel of each grain sums to `amplitude` over
    the cells, whatever part of it lies outside.
    """
    threads, nx = out.shape[0], out.shape[4]
    for t in prange(threads):
        ex = np.empty(nx)
        for i in range(t, x.shape[0], threads):
            a, b = _cells(x[i, 0], reach, low[0], step[0], nx)
            for c in range(a, b):
                d = low[0] + (c + 0.5) * step[0] - x[i, 0]
                ex[c] = math.exp(-0.5 * d * d / (omega * omega))
            scale = amplitude
            if normalised:
                total = _spread(x[i], values[i], 0.0, low, step, omega, reach, ex, out[t])
                scale = amplitude / total if total > 0 else 0.0
            if scale > 0:
                _spread(x[i], values[i], scale, low, step, omega, reach, ex, out[t])


# grains about an axis


@njit(cache=True)
def azimuths(r, omega):
    """Equal parts, an even number, of the circle of radius r that a mean over the azimuth is taken of.

    At most omega apart: the sum over a Gaussian of width omega then differs from its integral by 2 e^{-2 pi^2}.
    """
    return 2 * max(8, math.ceil(math.pi * r / omega))


@njit(cache=True)
def _harmonics(r, rho, cosines, low, step, z, omega, reach, ez, k):
    """k [3, nz]: means over the azimuth d of phi cos(m d) between (r, .) and (rho, z), m = 0, 1, 2; its filled cells.

    `cosines`: of the angles from 0 to pi at which phi is seen; `ez`: the Gaussian along z.
    """
    half = 0.5 / (omega * omega)
    last = len(cosines) - 1
    nearest = (r - rho) * (r - rho)
    if nearest > reach * reach:
        return 0, 0
    k0, k1 = _cells(z, math.sqrt(reach * reach - nearest), low, step, k.shape[1])
    k[:, k0:k1] = 0.0
    for node in range(last + 1):
        cos = cosines[node]
        apart = r * r + rho * rho - 2 * r * rho * cos
        if apart > reach * reach:
            break
        a, b = _cells(z, math.sqrt(reach * reach - apart), low, step, k.shape[1])
        w = math.exp(-apart * half) * (0.5 if node in (0, last) else 1.0) / last
        w1, w2 = w * cos, w * (2 * cos * cos - 1)
        for c in range(max(a, k0), min(b, k1)):
            k[0, c] += w
            k[1, c] += w1
            k[2, c] += w2
    for m in range(3):
        for c in range(k0, k1):
            k[m, c] *= ez[c]
    return k0, k1


@njit(cache=True, parallel=True)
def about_axis(rho, z, values, orders, radial, vertical, omega, reach, amplitude, normalised, out):
    """Deposit values [n, F] of grains at (rho, z) on rings; out [threads, F, nr, nz].

    values[.., f] are multiplied by the mean over the azimuth d, from the grain to the point, of phi cos(m d) with
    m = orders[f]. `radial`: width of a ring; `vertical`: (low, step). `normalised`: phi times the volumes of the rings
    sums to `amplitude`.
    """
    threads, nr, nz = out.shape[0], out.shape[2], out.shape[3]
    low, step = vertical
    highest = azimuths((nr - 0.5) * radial, omega) // 2 + 1
    cosines, nodes = np.ones((nr, highest)), np.empty(nr, np.int64)
    for p in range(nr):
        n = azimuths((p + 0.5) * radial, omega)
        nodes[p] = n // 2 + 1
        for node in range(nodes[p]):
            cosines[p, node] = math.cos(2 * math.pi * node / n)
    for t in prange(threads):
        k, ez = np.zeros((3, nz)), np.zeros(nz)
        for i in range(t, len(rho), threads):
            r0, r1 = _cells(rho[i], reach, 0.0, radial, nr)
            a, b = _cells(z[i], reach, low, step, nz)
            for c in range(a, b):
                d = low + (c + 0.5) * step - z[i]
                ez[c] = math.exp(-0.5 * d * d / (omega * omega))
            scale = amplitude
            if normalised:
                total = 0.0
                for p in range(r0, r1):
                    r = (p + 0.5) * radial
                    cosines_of_ring = cosines[p, : nodes[p]]
                    k0, k1 = _harmonics(r, rho[i], cosines_of_ring, low, step, z[i], omega, reach, ez, k)
                    total += 2 * math.pi * r * radial * step * k[0, k0:k1].sum()
                scale = amplitude / total if total > 0 else 0.0
            for p in range(r0, r1):
                cosines_of_ring = cosines[p, : nodes[p]]
                k0, k1 = _harmonics((p + 0.5) * radial, rho[i], cosines_of_ring, low, step, z[i], omega, reach, ez, k)
                for f in range(values.shape[1]):
                    q = scale * values[i, f]
                    row, part = out[t, f, p], k[orders[f]]
                    for c in range(k0, k1):
                        row[c] += q * part[c]


# contacts


@njit(cache=True)
def _along(px, py, pz, bx, by, bz, length, omega, reach, erf, slope):
    """Integral over s from 0 to 1 of the cut-off Gaussian (without its amplitude) at distance |p - s b|."""
    square = px * px + py * py + pz * pz
    if length <= 1e-9 * omega:
        return math.exp(-0.5 * square / (omega * omega)) if square <= reach * reach else 0.0
    at = (px * bx + py * by + pz * bz) / length
    across = max(square - at * at, 0.0)
    left = reach * reach - across
    if left <= 0:
        return 0.0
    half = math.sqrt(left)
    start, stop = max(-at, -half), min(length - at, half)
    if stop <= start:
        return 0.0
    unit = 1 / (math.sqrt(2.0) * omega)
    part = _erf(stop * unit, erf, slope) - _erf(start * unit, erf, slope)
    return math.exp(-across * unit * unit) * math.sqrt(math.pi / 2) * omega / length * part


@njit(cache=True, parallel=True)
def lines_on_lattice(x, b, values, low, step, omega, reach, amplitude, erf, slope, out):
    """Deposit values [n, F] spread along lines from x [n, 3] to x + b; out [threads, F, nz, ny, nx]."""
    threads, (nz, ny, nx) = out.shape[0], out.shape[2:]
    flat = step[1] == 0
    for t in prange(threads):
        for i in range(t, x.shape[0], threads):
            bx, by, bz = b[i, 0], 0.0 if flat else b[i, 1], b[i, 2]
            length = math.sqrt(bx * bx + by * by + bz * bz)
            c0, c1 = _cells(x[i, 0] + 0.5 * bx, reach + 0.5 * abs(bx), low[0], step[0], nx)
            k0, k1 = _cells(x[i, 2] + 0.5 * bz, reach + 0.5 * abs(bz), low[2], step[2], nz)
            j0, j1 = 0, 1
            if not flat:
                j0, j1 = _cells(x[i, 1] + 0.5 * by, reach + 0.5 * abs(by), low[1], step[1], ny)
            for k in range(k0, k1):
                pz = low[2] + (k + 0.5) * step[2] - x[i, 2]
                for j in range(j0, j1):
                    py = 0.0 if flat else low[1] + (j + 0.5) * step[1] - x[i, 1]
                    for c in range(c0, c1):
                        px = low[0] + (c + 0.5) * step[0] - x[i, 0]
                        w = amplitude * _along(px, py, pz, bx, by, bz, length, omega, reach, erf, slope)
                        if w > 0:
                            for f in range(values.shape[1]):
                                out[t, f, k, j, c] += w * values[i, f]


@njit(cache=True, parallel=True)
def lines_about_axis(x, b, tensors, radial, vertical, omega, reach, amplitude, erf, slope, out):
    """Deposit tensors [n, 3, 3] spread along lines from x [n, 3] to x + b; out [threads, 9, nr, nz].

    Tensors and lines are in the cylindrical axes of the middle of each line, which lies at azimuth 0.
    """
    threads, nr, nz = out.shape[0], out.shape[2], out.shape[3]
    low, step = vertical
    for t in prange(threads):
        turned = np.empty((3, 3))
        for i in range(t, x.shape[0], threads):
            length = math.sqrt(b[i, 0] ** 2 + b[i, 1] ** 2 + b[i, 2] ** 2)
            rho = x[i, 0] + 0.5 * b[i, 0]
            wide = reach + 0.5 * length
            r0, r1 = _cells(rho, wide, 0.0, radial, nr)
            k0, k1 = _cells(x[i, 2] + 0.5 * b[i, 2], reach + 0.5 * abs(b[i, 2]), low, step, nz)
            for p in range(r0, r1):
                r = (p + 0.5) * radial
                n = azimuths(r, omega)
                for node in range(n):
                    cos, sin = math.cos(2 * math.pi * node / n), math.sin(2 * math.pi * node / n)
                    px, py = r * cos - x[i, 0], r * sin - x[i, 1]
                    if (r * cos - rho) ** 2 + (r * sin) ** 2 > wide * wide:
                        continue
                    _turn(tensors[i], cos, sin, turned)
                    for c in range(k0, k1):
                        pz = low + (c + 0.5) * step - x[i, 2]
                        w = _along(px, py, pz, b[i, 0], b[i, 1], b[i, 2], length, omega, reach, erf, slope)
                        if w > 0:
                            w *= amplitude / n
                            for f in range(9):
                                out[t, f, p, c] += w * turned[f // 3, f % 3]


@njit(cache=True)
def _turn(a, cos, sin, out):
    """Tensor `a` in axes turned by an angle about the third."""
    for j in range(3):
        out[0, j] = cos * a[0, j] + sin * a[1, j]
        out[1, j] = -sin * a[0, j] + cos * a[1, j]
        out[2, j] = a[2, j]
    for i in range(3):
        u, v = out[i, 0], out[i, 1]
        out[i, 0] = cos * u + sin * v
        out[i, 1] = -sin * u + cos * v
