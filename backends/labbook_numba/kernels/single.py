"""One grain or contact at a time: reading vectors and springs, writing rows."""

from labbook_dem.words import func, narrow, real, wide, wide3

from labbook_numba.kernels.features import kernel


@func
def load(a, i, c):
    """The vector that starts at column c of row i."""
    return wide3(a[i, c], a[i, c + 1], a[i, c + 2])


@func
def spring_of(spring, held, k):
    """The spring of entry k; none if it is not held."""
    kept = wide(held[k])
    return narrow(wide3(spring[k, 0] * kept, spring[k, 1] * kept, spring[k, 2] * kept))


@func
def advance_of(held, k, dt):
    """By how much the spring of entry k is to be advanced [s]."""
    return real(0.5) * dt * (real(1.0) + real(held[k]))


@kernel
def write_row(out, row, i, j, wall, force, branch):
    """Write one row."""
    out[row, 0] = i
    out[row, 1] = j
    out[row, 2] = wall
    out[row, 3] = force.x
    out[row, 4] = force.y
    out[row, 5] = force.z
    out[row, 6] = branch.x
    out[row, 7] = branch.y
    out[row, 8] = branch.z
