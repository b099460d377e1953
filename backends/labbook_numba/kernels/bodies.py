"""Properties of grains: equal for all, by a parameter, or rows of State.body: radius, mass, inertia and kind."""

from labbook_dem.words import VARIED, func, real, wide

from labbook_numba.kernels.blocks import C0, MI, MJ, RI, RJ, TI, TJ
from labbook_numba.kernels.features import BODY, COEFFICIENTS, KINDS, STRIDE, int64, kernel, uint64
from labbook_numba.lanes import put, spread
from labbook_numba.rows import columns, rows_at


@func
def radius_of(body, i, radius):
    """Radius of grain i [m]; `radius` if all are the same."""
    return body[i, 0] if VARIED else radius


@func
def mass_of(body, i, mass):
    """Mass of grain i [kg]; `mass` if all are the same."""
    return body[i, 1] if VARIED else mass


@func
def inertia_of(body, i, inertia):
    """Moment of inertia of grain i [kg m^2]; `inertia` if all are the same."""
    return body[i, 2] if VARIED else inertia


@func
def rolling_inertia(inertia, slender):
    """Smallest moment of inertia [kg m^2], which limits rolling resistance: for rods, that about the axis."""
    # a torque about the axis would turn a rod fastest, and limits the stable step of rolling resistance
    return real(inertia / (wide(1.0) + slender))


@func
def kind_of(body, i):
    """Number of the species of grain i."""
    return int64(body[i, 3]) if VARIED else int64(0)


@func
def eight_reaches(body, i, j, start, reach2):
    """Squares of the contact distances [m^2] of eight listed pairs; `reach2` if all grains are the same."""
    if VARIED:
        radii_i, _, _, _ = columns(rows_at(body, i, start, BODY, uint64(0)))
        radii_j, _, _, _ = columns(rows_at(body, j, start, BODY, uint64(0)))
        sums = radii_i + radii_j
        return sums * sums
    return spread(reach2)


@kernel
def gather_bodies(body, i, j, b, count, pairs):
    """Copy radius, mass and moment of inertia of i into columns, and for `pairs` those of j."""
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
    """Copy the coefficients of contacts by species into columns: of a wall from row `first` of the table on, or of
    `pairs`."""
    for t in range(count):
        table_row = kind_of(body, i[t])
        table_row = table_row * int64(KINDS) + kind_of(body, j[t]) if pairs else first + table_row
        for c in range(COEFFICIENTS):
            b[C0 + uint64(c) * STRIDE + t] = real(table[table_row, c])
