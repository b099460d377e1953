"""Threads that step one scene together: how they wait for each other, and agree."""

import numpy as np
from labbook_dem.words import func

from labbook_numba.kernels.features import BROKEN, DOMAINS, NUMBER, kernel
from labbook_numba.meeting import arrive, arrived, give_way
from labbook_numba.state import State


@kernel
def meet(meetings, domains):
    """Wait until all domains are here, or will never be; whether they are."""
    goal = (arrive(meetings) // domains + 1) * domains
    while arrived(meetings) < goal:
        give_way()
    return arrived(meetings) < BROKEN


@kernel
def largest_told(domain, told, meetings, column, value):
    """The largest of the values of all domains; a NaN if one is among them, or if a domain has failed.

    No guard lets a NaN pass: all domains end. A domain may tell another value in the same column when all have agreed
    on something else in between.
    """
    domains = domain[DOMAINS]
    if domains > 1:
        told[domain[NUMBER], column] = value
        if not meet(meetings, domains):
            return np.nan
        for k in range(domains):
            other = told[k, column]
            if other != other:
                return other
            value = max(value, other)
    return value


@func
def agree(st: State, column, value):
    """The largest of the values of all domains, or a NaN if one is among them; `column`: what they are of."""
    return largest_told(st.domain, st.told, st.meetings, column, value)
