"""Threads that step one scene together: how they wait for each other, and agree."""

import numpy as np
from labbook_dem.words import func

from labbook_numba.kernels.features import BROKEN, NUMBER, PARTS, kernel
from labbook_numba.meeting import arrive, arrived, give_way
from labbook_numba.state import State


@kernel
def meet(meetings, parts):
    """Wait until all parts are here, or will never be; whether they are."""
    goal = (arrive(meetings) // parts + 1) * parts
    while arrived(meetings) < goal:
        give_way()
    return arrived(meetings) < BROKEN


@kernel
def largest_told(part, told, meetings, column, value):
    """The largest of the values of all parts; a NaN if one is among them, or if a part has failed and will not come.

    No guard lets a NaN pass: all parts end. A part may tell another value in the same column when all have agreed on
    something else in between.
    """
    parts = part[PARTS]
    if parts > 1:
        told[part[NUMBER], column] = value
        if not meet(meetings, parts):
            return np.nan
        for k in range(parts):
            other = told[k, column]
            if other != other:
                return other
            value = max(value, other)
    return value


@func
def agree(st: State, column, value):
    """The largest of the values of all parts, or a NaN if one is among them; `column`: what they are of."""
    return largest_told(st.part, st.told, st.meetings, column, value)
