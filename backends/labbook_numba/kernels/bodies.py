"""What the grains are: all alike, by a parameter, or each by its row of State.body: radius, mass, inertia and kind."""

from labbook_dem.words import VARIED, func, real, wide

from labbook_numba.kernels.blocks import C0, MI, MJ, RI, RJ, TI, TJ
from labbook_numba.kernels.features import BODY, COEFFICIENTS, KINDS, STRIDE, int64, kernel, uint64
from labbook_numba.lanes import put, spread
from labbook_numba.rows import columns, rows_at


@func
def radius_of(body, i, radius):
    """Radius of grain i [m]; `radius` where all are alike."""
    return body[i, 0] if VARIED else radius


@func
def mass_of(body, i, mass):
    """Mass of grain i [kg]; `mass` where all are alike."""
    return body[i, 1] if VARIED else mass


@func
def inertia_of(body, i, inertia):
    """Moment of inertia of grain i [kg m^2]; `inertia` where all are alike."""
    return body[i, 2] if VARIED else inertia


@func
def rolling_inertia(inertia, slender):
    """The smallest moment of inertia [kg m^2], by which rolling resistance is limited: of rods, that about the axis."""
    return real(inertia / (wide(1.0) + slender))


@func
def kind_of(body, i):
    """Number of the kind of grain i."""
    return int64(body[i, 3]) if VARIED else int64(0)


@func
def eight_reaches(body, i, j, start, reach2):
    """Squares of the distances [m] at which eight listed pairs touch; `reach2` where all are alike."""
    if VARIED:
        one, _, _, _ = columns(rows_at(body, i, start, BODY, uint64(0)))
        other, _, _, _ = columns(rows_at(body, j, start, BODY, uint64(0)))
        both = one + other
        return both * both
    return spread(reach2)


@kernel
def gather_bodies(body, i, j, b, count, pairs):
    """Radius, mass and moment of inertia of i, and if these are `pairs` of j, into columns."""
    for t in range(uint64(0), count, uint64(8)):
        radius, mass, inertia, _ = columns(rows_at(body, i, t, BODY, uint64(0)))
        put(b, RI + t, radius)
        put(b, MI + t, mass)
        put(b, TI + t, inertia)
        if pairs:
            radius, mass, inertia, _ = columns(rows_at(body, j, t, BODY, uint64(0)))
            put(b, RJ + t, radius)
            put(b, MJ + t, mass)
            put(b, TJ + t, inertia)


@kernel
def gather_coefficients(table, first, body, i, j, b, count, pairs):
    """Coefficients of the contacts' kinds: of a wall from row `first` of the table on, or of `pairs`."""
    for t in range(count):
        at = kind_of(body, i[t])
        at = at * int64(KINDS) + kind_of(body, j[t]) if pairs else first + at
        for c in range(COEFFICIENTS):
            b[C0 + uint64(c) * STRIDE + t] = real(table[at, c])
