"""Finding places in ascending lists."""

from labbook_numba.kernels.features import kernel


@kernel
def first_at_least(ascending, first, last, value):
    """Where in ascending[first:last] the first number is that is not below `value`; `last` if there is none."""
    while first < last:
        middle = (first + last) // 2
        if ascending[middle] < value:
            first = middle + 1
        else:
            last = middle
    return first
